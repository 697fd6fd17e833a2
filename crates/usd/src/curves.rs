//! Curves as tubes and ribbons, points as balls (UsdGeomBasisCurves, UsdGeomPoints).
//!
//! A cubic segment is Σ bᵢ(t) pᵢ with the functions bᵢ of its basis. A pinned B-spline or
//! Catmull–Rom curve gets an extra point 2 p₀ − p₁ before the first point p₀, so that the curve
//! starts at p₀. In the same way, the curve gets an extra point after the last point.
//!
//! Double reflection (Wang et al. 2008) carries a vector that is perpendicular to the curve from
//! each sample to the next without twist. In a closed curve, the angle between the last and the
//! first vector is spread over the curve's length. Widths are diameters in the units of the curve's
//! space.

use std::f32::consts::TAU;

use glam::{Quat, Vec2, Vec3, Vec4};

use crate::geometry::Geometry;

/// Basis by which control points define a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Basis {
    /// Segments are straight lines.
    Linear,
    /// Segments are cubic, with four points each; neighbouring segments share a point.
    #[default]
    Bezier,
    /// Segments are cubic; in general the curve does not pass through its points.
    BSpline,
    /// Segments are cubic; the curve passes through its points.
    CatmullRom,
}

/// Treatment of the curve's ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Wrap {
    /// The curve ends with its last complete segment.
    #[default]
    Nonperiodic,
    /// The curve is closed.
    Periodic,
    /// The curve reaches its first and its last point.
    Pinned,
}

/// States for which elements of the curves an attribute has values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interpolation {
    /// All curves together have one value.
    Constant,
    /// Every curve has one value.
    Uniform,
    /// Every end of a segment has one value.
    Varying,
    /// Every point has one value.
    Vertex,
}

/// An attribute of curves. Each value has `width` numbers; missing values are 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Data<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) width: usize,
    pub(crate) interpolation: Interpolation,
}

/// All curves of one prim, with their attributes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Curves<'a> {
    pub(crate) points: &'a [Vec3],
    pub(crate) vertex_counts: &'a [i32],
    pub(crate) basis: Basis,
    pub(crate) wrap: Wrap,
    /// Diameters of the tubes, or widths of the ribbons.
    pub(crate) widths: Data<'a>,
    /// If present, the curves are ribbons with these normals, visible from both sides.
    pub(crate) normals: Option<Data<'a>>,
    /// RGB or RGBA values of the curves.
    pub(crate) colors: Option<Data<'a>>,
    /// Texture coordinates as in USD, where v points up.
    pub(crate) uvs: [Option<Data<'a>>; 2],
}

/// If the triangles of a prim's curves would exceed this number, the curves get fewer samples and
/// sides.
const MOST_TRIANGLES: usize = 2_000_000;

/// Samples per segment, and sides per tube, from the finest choice to the coarsest.
const DETAIL: [(usize, usize); 4] = [(8, 12), (6, 8), (4, 5), (2, 3)];

/// A curve that is shorter than this fraction of its largest coordinate is left out, since its
/// samples differ only by rounding.
const ROUNDING: f32 = 1e-5;

/// A sample of a curve. An attribute of the sample is a weighted sum of values at control points,
/// or of values at ends of segments.
#[derive(Clone, Debug, Default)]
struct Sample {
    /// Pairs of the index of a control point within the curve, and the weight of its value.
    points: Vec<(usize, f32)>,
    /// Pairs of the index of a segment's end within the curve, and the weight of its value.
    ends: Vec<(usize, f32)>,
}

/// Converts curves to triangles. In `face_of_triangle`, each triangle has the index of its curve.
/// Curves with too few points, or without length, are left out.
pub(crate) fn tessellate(curves: &Curves<'_>) -> Geometry {
    let segments: usize =
        curves.vertex_counts.iter().map(|&count| segment_count(curves, usize::try_from(count).unwrap_or(0))).sum();
    let triangles = |(steps, sides): (usize, usize)| segments.saturating_mul(2 * steps * sides);
    // a straight segment needs no samples between its ends
    let detail = DETAIL.map(|(steps, sides)| (if curves.basis == Basis::Linear { 1 } else { steps }, sides));
    let fits = detail.into_iter().find(|&detail| triangles(detail) <= MOST_TRIANGLES);
    let (steps, sides) = fits.unwrap_or(detail[detail.len() - 1]);
    let mut geometry = Geometry::default();
    let (mut first_point, mut first_end) = (0usize, 0usize);
    for (curve, &count) in curves.vertex_counts.iter().enumerate() {
        let count = usize::try_from(count).unwrap_or(0);
        if first_point.saturating_add(count) > curves.points.len() {
            break;
        }
        let segments = segment_count(curves, count);
        let end_count = if curves.wrap == Wrap::Periodic { segments } else { segments + 1 };
        if segments > 0 {
            let at = Place { curve, first_point, first_end, geometry: &mut geometry };
            sweep(curves, at, &samples(curves, count, segments, steps), sides);
        }
        first_point += count;
        first_end += end_count;
    }
    geometry
}

fn segment_count(curves: &Curves<'_>, points: usize) -> usize {
    match (curves.basis, curves.wrap) {
        (Basis::Linear, Wrap::Periodic) => {
            if points > 2 {
                points
            } else {
                points.saturating_sub(1)
            }
        }
        (Basis::Linear, _) => points.saturating_sub(1),
        (Basis::Bezier, Wrap::Periodic) => points / 3,
        (Basis::Bezier, _) => points.saturating_sub(1) / 3,
        (_, Wrap::Periodic) => {
            if points > 2 {
                points
            } else {
                0
            }
        }
        (_, Wrap::Pinned) => points.saturating_sub(1),
        (_, Wrap::Nonperiodic) => points.saturating_sub(3),
    }
}

/// Returns the weights of the four control points of a segment at `t`, which is 0..1.
fn weights(basis: Basis, t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    match basis {
        Basis::Linear => [s, t, 0.0, 0.0],
        Basis::Bezier => [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t],
        Basis::BSpline => {
            [s * s * s, 3.0 * t * t * t - 6.0 * t * t + 4.0, 3.0 * s * s * s - 6.0 * s * s + 4.0, t * t * t]
                .map(|w| w / 6.0)
        }
        Basis::CatmullRom => {
            [-s * s * t, 2.0 + t * t * (3.0 * t - 5.0), 2.0 + s * s * (3.0 * s - 5.0), -t * t * s].map(|w| w / 2.0)
        }
    }
}

/// Returns samples from one end of a curve to the other. The last sample of a closed curve repeats
/// the first sample.
fn samples(curves: &Curves<'_>, count: usize, segments: usize, steps: usize) -> Vec<Sample> {
    let periodic = curves.wrap == Wrap::Periodic;
    let stride = if curves.basis == Basis::Bezier { 3 } else { 1 };
    // a pinned B-spline or Catmull–Rom curve starts with the extra point, which has the index −1
    let shift = match (curves.basis, curves.wrap) {
        (Basis::BSpline | Basis::CatmullRom, Wrap::Pinned) => -1,
        _ => 0,
    };
    let sample = |segment: usize, t: f32| {
        let mut sample = Sample { ends: vec![(segment, 1.0 - t), (segment + 1, t)], ..Sample::default() };
        for (i, weight) in (0..).zip(weights(curves.basis, t)).filter(|(_, weight)| *weight != 0.0) {
            let point = (stride * segment) as isize + shift + i;
            if periodic {
                sample.points.push((point.rem_euclid(count as isize) as usize, weight));
            } else if point < 0 {
                sample.points.extend([(0, 2.0 * weight), (1, -weight)]);
            } else if point as usize >= count {
                sample.points.extend([(count - 1, 2.0 * weight), (count - 2, -weight)]);
            } else {
                sample.points.push((point as usize, weight));
            }
        }
        if periodic {
            sample.ends.iter_mut().for_each(|(end, _)| *end %= segments);
        }
        sample
    };
    let mut samples: Vec<Sample> = (0..segments)
        .flat_map(|segment| (0..steps).map(move |step| (segment, step)))
        .map(|(segment, step)| sample(segment, step as f32 / steps as f32))
        .collect();
    samples.push(sample(segments - 1, 1.0));
    samples
}

/// The indices at which the data of one curve begin in the data of its prim, and the geometry that
/// receives the curve's triangles.
struct Place<'g> {
    curve: usize,
    first_point: usize,
    first_end: usize,
    geometry: &'g mut Geometry,
}

impl Place<'_> {
    fn value<const N: usize>(&self, data: &Data<'_>, sample: &Sample) -> [f32; N] {
        let mut sum = [0.0; N];
        let mut add = |index: usize, weight: f32| {
            let start = index.saturating_mul(data.width);
            let value = data.values.get(start..start.saturating_add(data.width)).unwrap_or_default();
            sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += weight * value);
        };
        match data.interpolation {
            Interpolation::Constant => add(0, 1.0),
            Interpolation::Uniform => add(self.curve, 1.0),
            Interpolation::Varying => sample.ends.iter().for_each(|&(end, weight)| add(self.first_end + end, weight)),
            Interpolation::Vertex => {
                sample.points.iter().for_each(|&(point, weight)| add(self.first_point + point, weight))
            }
        }
        sum
    }
}

/// A rib: the cross-section of a tube, or the line across a ribbon, at one sample.
struct Rib {
    position: Vec3,
    tangent: Vec3,
    /// Unit vector perpendicular to the tangent, carried along the curve without twist.
    across: Vec3,
    radius: f32,
    /// Derivative of the radius along the curve.
    slope: f32,
    /// Arc length from the curve's start, as a fraction of the curve's length.
    along: f32,
}

fn sweep(curves: &Curves<'_>, mut place: Place<'_>, samples: &[Sample], sides: usize) {
    // Compute a rib per sample.
    let points = |sample: &Sample| {
        sample.points.iter().map(|&(point, weight)| weight * curves.points[place.first_point + point]).sum::<Vec3>()
    };
    let positions: Vec<Vec3> = samples.iter().map(points).collect();
    let radii: Vec<f32> =
        samples.iter().map(|sample| 0.5 * place.value::<1>(&curves.widths, sample)[0].max(0.0)).collect();
    let closed = curves.wrap == Wrap::Periodic && positions.first() == positions.last();
    let Some(ribs) = ribs(&positions, &radii, closed) else { return };
    // Add the vertices: a rib per sample, then the vertices of the caps.
    let first = place.geometry.positions.len();
    let count = match &curves.normals {
        Some(normals) => {
            ribbon(&mut place, normals, samples, &ribs);
            2
        }
        None => {
            tube(&mut place, &ribs, sides, closed);
            sides + 1
        }
    };
    // All vertices of a rib have the data of its sample. The vertices of the caps follow, and have
    // the data of the curve's ends.
    let added = place.geometry.positions.len() - first;
    let sample_of = |vertex: usize| match vertex / count {
        rib if rib < samples.len() => &samples[rib],
        _ if vertex - count * samples.len() < sides + 1 => &samples[0],
        _ => &samples[samples.len() - 1],
    };
    if let Some(colors) = &curves.colors {
        for vertex in 0..added {
            let [r, g, b, a] = place.value::<4>(colors, sample_of(vertex));
            place.geometry.colors.push(Vec4::new(r, g, b, if colors.width < 4 { 1.0 } else { a }));
        }
    }
    for (set, uvs) in curves.uvs.iter().enumerate() {
        let Some(uvs) = uvs else { continue };
        place.geometry.uvs[set].truncate(first);
        for vertex in 0..added {
            let [u, v] = place.value::<2>(uvs, sample_of(vertex));
            place.geometry.uvs[set].push(Vec2::new(u, 1.0 - v));
        }
    }
}

/// Returns the ribs of a curve, or `None` if the curve has no length.
fn ribs(positions: &[Vec3], radii: &[f32], closed: bool) -> Option<Vec<Rib>> {
    let last = positions.len() - 1;
    let mut lengths = vec![0.0; positions.len()];
    for i in 1..=last {
        lengths[i] = lengths[i - 1] + positions[i].distance(positions[i - 1]);
    }
    let total = lengths[last];
    let largest = positions.iter().fold(0.0f32, |largest, position| largest.max(position.abs().max_element()));
    if !(total > ROUNDING * largest && total.is_finite()) {
        return None;
    }
    // The tangent at a sample. `None` if both neighbours are at the sample's position, or if the
    // curve turns back there. The rib then takes the tangent of the previous rib. Ribs at the start
    // take the first tangent.
    let tangent = |i: usize| -> Option<Vec3> {
        let before = if i == 0 && closed {
            positions[last] - positions[last - 1]
        } else {
            positions[i] - positions[i.saturating_sub(1)]
        };
        let after =
            if i == last && closed { positions[1] - positions[0] } else { positions[(i + 1).min(last)] - positions[i] };
        (before.normalize_or_zero() + after.normalize_or_zero()).try_normalize()
    };
    // Make each rib, with the vector `across` carried from the previous rib.
    let mut ribs: Vec<Rib> = Vec::with_capacity(positions.len());
    let first_tangent = (0..=last).find_map(tangent)?;
    for i in 0..=last {
        let previous = ribs.last();
        let tangent = tangent(i).unwrap_or(previous.map_or(first_tangent, |rib| rib.tangent));
        let across = match previous {
            None => tangent.any_orthonormal_vector(),
            Some(rib) => carried(rib, positions[i], tangent),
        };
        let (low, high) = (i.saturating_sub(1), (i + 1).min(last));
        let slope = (radii[high] - radii[low]) / (lengths[high] - lengths[low]).max(f32::MIN_POSITIVE);
        let slope = slope.clamp(-100.0, 100.0);
        ribs.push(Rib { position: positions[i], tangent, across, radius: radii[i], slope, along: lengths[i] / total });
    }
    // In a closed curve, spread the angle between the last and the first `across` over the length.
    if closed {
        let (start, end) = (ribs[0].across, ribs[last].across);
        let twist = end.cross(start).dot(ribs[last].tangent).atan2(end.dot(start));
        for rib in &mut ribs {
            rib.across = Quat::from_axis_angle(rib.tangent, twist * rib.along) * rib.across;
        }
    }
    Some(ribs)
}

/// Carries the vector `across` of a rib to the next rib by two reflections, which add no twist.
fn carried(rib: &Rib, position: Vec3, tangent: Vec3) -> Vec3 {
    let reflect = |v: Vec3, mirror: Vec3| match mirror.length_squared() {
        0.0 => v,
        square => v - 2.0 / square * mirror.dot(v) * mirror,
    };
    let step = position - rib.position;
    let step = step.normalize_or_zero();
    let (across, turned) = (reflect(rib.across, step), reflect(rib.tangent, step));
    let across = reflect(across, tangent - turned);
    (across - tangent * across.dot(tangent)).try_normalize().unwrap_or_else(|| tangent.any_orthonormal_vector())
}

fn tube(place: &mut Place<'_>, ribs: &[Rib], sides: usize, closed: bool) {
    let curve = place.curve as u32;
    let geometry = &mut *place.geometry;
    let first = geometry.positions.len() as u32;
    let columns = sides as u32 + 1;
    let around = |rib: &Rib, side: usize| {
        let (sine, cosine) = (TAU * (side % sides) as f32 / sides as f32).sin_cos();
        cosine * rib.across + sine * rib.tangent.cross(rib.across)
    };
    // Add the side of the tube: one ring of vertices per rib, which is joined to the next ring.
    for rib in ribs {
        for side in 0..=sides {
            let out = around(rib, side);
            let normal = (out - rib.slope * rib.tangent).normalize_or(out);
            let uv = Vec2::new(side as f32 / sides as f32, 1.0 - rib.along);
            geometry.vertex(rib.position + rib.radius * out, normal, uv);
        }
    }
    for row in 0..ribs.len() as u32 - 1 {
        for column in 0..columns - 1 {
            let here = first + row * columns + column;
            geometry.quad([here, here + 1, here + columns + 1, here + columns], curve);
        }
    }
    if closed {
        return;
    }
    // Add the caps: discs at both ends of an open curve.
    for (rib, up) in [(&ribs[0], false), (&ribs[ribs.len() - 1], true)] {
        let normal = if up { rib.tangent } else { -rib.tangent };
        let v = 1.0 - rib.along;
        let centre = geometry.vertex(rib.position, normal, Vec2::new(0.5, v));
        let rim: Vec<u32> = (0..sides)
            .map(|side| {
                let out = around(rib, side);
                geometry.vertex(rib.position + rib.radius * out, normal, Vec2::new(side as f32 / sides as f32, v))
            })
            .collect();
        for side in (0..sides).filter(|_| rib.radius > 0.0) {
            let (a, b) = (rim[side], rim[(side + 1) % sides]);
            geometry.triangle(if up { [centre, a, b] } else { [centre, b, a] }, curve);
        }
    }
}

fn ribbon(place: &mut Place<'_>, normals: &Data<'_>, samples: &[Sample], ribs: &[Rib]) {
    let first = place.geometry.positions.len() as u32;
    for (rib, sample) in ribs.iter().zip(samples) {
        let facing = Vec3::from(place.value::<3>(normals, sample));
        let normal = (facing - rib.tangent * facing.dot(rib.tangent)).try_normalize().unwrap_or(rib.across);
        let side = rib.tangent.cross(normal);
        for u in [0.0, 1.0] {
            let position = rib.position + (2.0 * u - 1.0) * rib.radius * side;
            place.geometry.vertex(position, normal, Vec2::new(u, 1.0 - rib.along));
        }
    }
    for row in 0..ribs.len() as u32 - 1 {
        let here = first + 2 * row;
        place.geometry.quad([here, here + 1, here + 3, here + 2], place.curve as u32);
    }
}

/// Number of segments per edge of the octahedra that become the balls at points.
const BALL_PARTS: u32 = 4;

/// Returns a ball of diameter 1 with 8 parts² triangles. It is an octahedron whose edges are cut
/// into `parts` segments, and whose vertices are moved to the ball's surface.
pub(crate) fn ball(parts: u32) -> Geometry {
    let mut geometry = Geometry::default();
    for octant in 0..8 {
        let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (x, y, z) = (sign(0), sign(1), sign(2));
        let mirrored = x * y * z < 0.0;
        let vertex = |geometry: &mut Geometry, i: u32, j: u32| {
            let k = parts - i - j;
            let normal = Vec3::new(x * i as f32, y * j as f32, z * k as f32).normalize();
            geometry.vertex(0.5 * normal, normal, Vec2::splat(0.5))
        };
        let rows: Vec<Vec<u32>> =
            (0..=parts).map(|i| (0..=parts - i).map(|j| vertex(&mut geometry, i, j)).collect()).collect();
        for i in 0..parts as usize {
            for j in 0..parts as usize - i {
                let mut add =
                    |a: u32, b: u32, c: u32| geometry.triangle(if mirrored { [a, c, b] } else { [a, b, c] }, 0);
                add(rows[i][j], rows[i + 1][j], rows[i][j + 1]);
                if let Some(&inner) = rows[i + 1].get(j + 1) {
                    add(rows[i + 1][j], inner, rows[i][j + 1]);
                }
            }
        }
    }
    geometry
}

/// Returns balls at points, each with its own colour. In `face_of_triangle`, each triangle has the
/// index of its point. Points whose position or diameter is not finite, or whose diameter is not
/// above 0, are left out.
pub(crate) fn colored_balls(
    points: &[Vec3],
    diameter: impl Fn(usize) -> f32,
    color: impl Fn(usize) -> Vec4,
) -> Geometry {
    let ball = ball(BALL_PARTS);
    let mut geometry = Geometry::default();
    for (i, &point) in points.iter().enumerate() {
        let diameter = diameter(i);
        if !(diameter > 0.0 && diameter.is_finite() && point.is_finite()) {
            continue;
        }
        let first = geometry.positions.len() as u32;
        geometry.positions.extend(ball.positions.iter().map(|&position| point + diameter * position));
        geometry.normals.extend(&ball.normals);
        geometry.uvs[0].extend(&ball.uvs[0]);
        geometry.colors.resize(geometry.positions.len(), color(i));
        ball.triangles.iter().for_each(|triangle| geometry.triangle(triangle.map(|vertex| vertex + first), i as u32));
    }
    geometry
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const ONE: Data<'static> = Data { values: &[1.0], width: 1, interpolation: Interpolation::Constant };

    fn curves<'a>(points: &'a [Vec3], counts: &'a [i32], basis: Basis, wrap: Wrap) -> Curves<'a> {
        Curves { points, vertex_counts: counts, basis, wrap, widths: ONE, normals: None, colors: None, uvs: [None; 2] }
    }

    /// Returns the centres of a tube's rings.
    fn spine(geometry: &Geometry, rings: usize, sides: usize) -> Vec<Vec3> {
        (0..rings)
            .map(|ring| geometry.positions[ring * (sides + 1)..][..sides].iter().sum::<Vec3>() / sides as f32)
            .collect()
    }

    #[test]
    fn a_straight_tube_is_a_cylinder() {
        let points = [Vec3::ZERO, Vec3::new(1.0, 2.0, 2.0) / 3.0, Vec3::new(1.0, 2.0, 2.0)];
        let geometry = tessellate(&curves(&points, &[3], Basis::Linear, Wrap::Nonperiodic));
        geometry.assert_sound();
        geometry.assert_closed();
        // the cross-section has twelve sides and the area 12/2 r² sin 30°
        let base = 6.0 * 0.25 * 0.5;
        assert!((geometry.volume() - 3.0 * base).abs() < 1e-5, "{}", geometry.volume());
        assert!((geometry.area() - (2.0 * base + 3.0 * 12.0 * (PI / 12.0).sin())).abs() < 1e-5);
    }

    /// A tube of 20,000 straight segments is within the limit of triangles, so it keeps 12 sides.
    #[test]
    fn straight_segments_count_as_one_step() {
        let points: Vec<Vec3> = (0..=20_000).map(|i| Vec3::X * i as f32).collect();
        let geometry = tessellate(&curves(&points, &[20_001], Basis::Linear, Wrap::Nonperiodic));
        assert_eq!(geometry.triangles.len(), 2 * 12 * 20_000 + 2 * 12);
    }

    #[test]
    fn cubic_bases_have_the_curves_that_they_are_named_after() {
        let points: Vec<Vec3> = [(0.0, 0.0), (1.0, 2.0), (3.0, 2.0), (4.0, 0.0), (5.0, -2.0), (7.0, -2.0), (8.0, 0.0)]
            .map(|(x, y)| Vec3::new(x, y, 0.0))
            .to_vec();
        let run = |basis, wrap| {
            let geometry = tessellate(&curves(&points, &[7], basis, wrap));
            let segments = segment_count(&curves(&points, &[7], basis, wrap), 7);
            spine(&geometry, 8 * segments + 1, 12)
        };
        let close = |a: Vec3, b: Vec3| assert!(a.distance(b) < 1e-5, "{a} {b}");
        // a Bézier curve passes through every third point; at t = ½ it is (p0 + 3 p1 + 3 p2 + p3)/8
        let bezier = run(Basis::Bezier, Wrap::Nonperiodic);
        assert_eq!(bezier.len(), 17);
        close(bezier[8], points[3]);
        close(bezier[4], Vec3::new(2.0, 1.5, 0.0));
        close(bezier[16], points[6]);
        // a B-spline is (p0 + 4 p1 + p2)/6 where segments join
        let spline = run(Basis::BSpline, Wrap::Nonperiodic);
        assert_eq!(spline.len(), 33);
        close(spline[0], (points[0] + 4.0 * points[1] + points[2]) / 6.0);
        close(spline[8], (points[1] + 4.0 * points[2] + points[3]) / 6.0);
        let pinned = run(Basis::BSpline, Wrap::Pinned);
        close(pinned[0], points[0]);
        close(pinned[48], points[6]);
        // a Catmull–Rom curve passes through its points
        let catmull = run(Basis::CatmullRom, Wrap::Nonperiodic);
        close(catmull[0], points[1]);
        close(catmull[16], points[3]);
        close(catmull[4], (9.0 * (points[1] + points[2]) - points[0] - points[3]) / 16.0);
        close(run(Basis::CatmullRom, Wrap::Pinned)[0], points[0]);
        for periodic in [Basis::BSpline, Basis::CatmullRom] {
            let round = run(periodic, Wrap::Periodic);
            assert_eq!(round.len(), 57);
            close(round[0], round[56]);
        }
    }

    #[test]
    fn a_closed_tube_is_a_torus() {
        // the control points are close to a circle of radius 2
        let points: Vec<Vec3> = (0..24)
            .map(|i| TAU * i as f32 / 24.0)
            .map(|a| 2.0 * Vec3::new(a.cos(), a.sin(), 0.3 * (2.0 * a).sin()))
            .collect();
        for basis in [Basis::BSpline, Basis::Linear, Basis::CatmullRom] {
            let geometry = tessellate(&curves(&points, &[24], basis, Wrap::Periodic));
            geometry.assert_sound();
            geometry.assert_closed();
        }
        let flat: Vec<Vec3> = points.iter().map(|p| Vec3::new(p.x, p.y, 0.0)).collect();
        let torus = tessellate(&curves(&flat, &[24], Basis::CatmullRom, Wrap::Periodic));
        // by Pappus's theorem, the volume is the area of the cross-section times 2π·2
        assert!((torus.volume() / (4.0 * PI * 0.75) - 1.0).abs() < 0.01, "{}", torus.volume());
    }

    #[test]
    fn data_follow_their_interpolation() {
        let points: Vec<Vec3> = (0..8).map(|i| Vec3::new(i as f32 % 4.0, 0.0, i as f32)).collect();
        let run = |interpolation, values: &[f32]| {
            let data = Data { values, width: 1, interpolation };
            let curves = Curves { widths: data, ..curves(&points, &[4, 4], Basis::Linear, Wrap::Nonperiodic) };
            let geometry = tessellate(&curves);
            let radius = |curve: usize, ring: usize| {
                let first = curve * (4 * 13 + 2 * 13) + ring * 13;
                2.0 * geometry.positions[first].distance(points[4 * curve + ring])
            };
            [radius(0, 0), radius(0, 3), radius(1, 0), radius(1, 3)].map(|r| (r * 1e4).round() / 1e4)
        };
        assert_eq!(run(Interpolation::Constant, &[0.5]), [0.5; 4]);
        assert_eq!(run(Interpolation::Uniform, &[0.5, 0.25]), [0.5, 0.5, 0.25, 0.25]);
        let each: Vec<f32> = (1..=8).map(|i| 0.1 * i as f32).collect();
        assert_eq!(run(Interpolation::Vertex, &each), [0.1, 0.4, 0.5, 0.8]);
        assert_eq!(run(Interpolation::Varying, &each), [0.1, 0.4, 0.5, 0.8]);
        let colors = Data { values: &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0], width: 3, interpolation: Interpolation::Uniform };
        let uvs = Data { values: &[0.25, 0.75], width: 2, interpolation: Interpolation::Constant };
        let both = Curves {
            colors: Some(colors),
            uvs: [None, Some(uvs)],
            ..curves(&points, &[4, 4], Basis::Linear, Wrap::Nonperiodic)
        };
        let geometry = tessellate(&both);
        geometry.assert_sound();
        assert_eq!(
            (geometry.colors[0], geometry.colors[geometry.colors.len() - 1]),
            (Vec4::new(1.0, 0.0, 0.0, 1.0), Vec4::new(0.0, 1.0, 0.0, 1.0))
        );
        assert!(geometry.uvs[1].iter().all(|&uv| uv == Vec2::new(0.25, 0.25)));
    }

    #[test]
    fn ribbons_face_their_normals() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0];
        let normals = Data { values: &[0.0, 0.0, 1.0], width: 3, interpolation: Interpolation::Constant };
        let ribbon = Curves { normals: Some(normals), ..curves(&points, &[3], Basis::Linear, Wrap::Nonperiodic) };
        let geometry = tessellate(&ribbon);
        geometry.assert_sound();
        assert!(geometry.normals.iter().all(|&normal| normal == Vec3::Z));
        assert!((geometry.area() - 2.0).abs() < 1e-6);
    }

    #[test]
    fn balls_are_round_and_closed() {
        let ball = ball(BALL_PARTS);
        ball.assert_sound();
        ball.assert_closed();
        assert!((ball.volume() / (PI / 6.0) - 1.0).abs() < 0.1);
        let balls = colored_balls(&[Vec3::ZERO, Vec3::X, Vec3::NAN], |i| [2.0, 1.0, 1.0][i], |i| Vec4::splat(i as f32));
        balls.assert_sound();
        assert_eq!(balls.triangles.len(), 256);
        assert!((balls.volume() / ball.volume() - 9.0).abs() < 1e-3);
    }

    #[test]
    fn degenerate_curves_do_no_harm() {
        let points = vec![Vec3::ONE; 6];
        for basis in [Basis::Linear, Basis::Bezier, Basis::BSpline, Basis::CatmullRom] {
            for wrap in [Wrap::Nonperiodic, Wrap::Periodic, Wrap::Pinned] {
                for counts in [&[6][..], &[1, 2, 3], &[0, -4, 6], &[7], &[2, 2, 2], &[1; 6]] {
                    assert!(tessellate(&curves(&points, counts, basis, wrap)).triangles.is_empty());
                    // the curve turns back at some of these points, and some of them coincide
                    let bent: Vec<Vec3> = [0.0, 1.0, 1.0, 0.0, 0.0, 2.0].map(|x| Vec3::new(x, 0.0, 0.0)).to_vec();
                    let missing = Data { values: &[], width: 1, interpolation: Interpolation::Vertex };
                    for widths in [ONE, missing] {
                        let geometry = tessellate(&Curves { widths, ..curves(&bent, counts, basis, wrap) });
                        assert!(geometry.positions.iter().chain(&geometry.normals).all(|p| p.is_finite()));
                    }
                }
            }
        }
    }
}
