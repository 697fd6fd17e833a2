//! Converts implicit shapes, curves and points of a scene package to triangles.

use glam::{Vec3, Vec4};
use lumistack_core::Task;

use crate::curves::{Basis, Curves, Data, Interpolation, Wrap, colored_balls, tessellate};
use crate::error::Fault;
use crate::geometry::Geometry;
use crate::implicit::{Axis, capsule, cone, cube, cylinder, plane, sphere};
use crate::package::{Array, CurvesEntry, Package, PointsEntry, Primvar, SolidEntry};
use crate::polygons::UvNames;
use crate::spacing::{self, Rule};

/// Rule for the width of curves without widths. With this rule, some ground stays visible between
/// hairs.
const CURVES: Rule = Rule { of_spacing: 0.25, largest: 0.005, smallest: 0.0001 };
/// Rule for the width of points without widths. With this rule, the balls of neighbouring points
/// nearly touch.
const POINTS: Rule = Rule { of_spacing: 0.75, largest: 0.02, smallest: 0.0001 };
/// Width, in units of the prim's space, of curves or points without widths. It applies if all
/// points coincide, so that they have no spacing.
const WIDTH: f32 = 1.0;
/// Largest number of points of a prim that are shown: each becomes a ball of 128 triangles.
const MOST_POINTS: usize = 1 << 18;

/// Makes the triangles of a shape that a formula describes.
pub(crate) fn solid(entry: &SolidEntry) -> Result<Geometry, Fault> {
    let axis = match entry.axis.as_str() {
        "x" => Axis::X,
        "y" => Axis::Y,
        _ => Axis::Z,
    };
    if let Some(size) = entry.sizes.iter().find(|size| !(size.is_finite() && **size >= 0.0)) {
        return Err(Fault::new(&entry.place, "sizes that are finite and ≥ 0", size));
    }
    Ok(match (entry.solid.as_str(), entry.sizes.as_slice()) {
        ("sphere", &[radius]) => sphere(radius),
        ("cube", &[size]) => cube(size),
        ("cylinder", &[radius, height]) => cylinder(radius, radius, height, axis),
        ("cylinder", &[top, bottom, height]) => cylinder(top, bottom, height, axis),
        ("cone", &[radius, height]) => cone(radius, height, axis),
        ("capsule", &[radius, height]) => capsule(radius, radius, height, axis),
        ("capsule", &[top, bottom, height]) => capsule(top, bottom, height, axis),
        ("plane", &[width, length]) => plane(width, length, axis),
        (other, sizes) => {
            return Err(Fault::new(
                &entry.place,
                "a known shape with the right number of sizes",
                format!("{other} {sizes:?}"),
            ));
        }
    })
}

/// Reads rows of one to four numbers as a flat list; also returns the length of a row.
fn reals(package: &Package<'_>, array: &Array, place: &str) -> Result<(Vec<f32>, usize), Fault> {
    let width = array.shape.get(1).copied().unwrap_or(1);
    let values = match width {
        1 => package.reals::<1>(array, place)?.into_flattened(),
        2 => package.reals::<2>(array, place)?.into_flattened(),
        3 => package.reals::<3>(array, place)?.into_flattened(),
        _ => package.reals::<4>(array, place)?.into_flattened(),
    };
    match values.iter().all(|value| value.is_finite()) {
        true => Ok((values, width)),
        false => Err(Fault::new(place, "finite numbers", "NaN or infinity")),
    }
}

fn points(package: &Package<'_>, array: &Option<Array>, place: &str) -> Result<Vec<Vec3>, Fault> {
    let Some(array) = array else { return Ok(Vec::new()) };
    let (values, width) = reals(package, array, place)?;
    match width {
        3 => Ok(values.as_chunks::<3>().0.iter().map(|&point| Vec3::from(point)).collect()),
        _ => Err(Fault::new(place, "points of three coordinates", width)),
    }
}

/// Returns the width of curves or points without widths, and warns about it. `found` is the width
/// that follows from the spacing or from the bounding box; `None` if the box has no extent.
fn width_by_spacing(kind: &str, found: Option<f32>, place: &str, task: Task<'_>) -> f32 {
    let message = match found {
        Some(width) => {
            format!(
                "the {kind} have no widths; the width {width} follows from their spacing, or from their bounding box"
            )
        }
        None => format!("the {kind} have no widths, and all points coincide; the width {WIDTH} is used"),
    };
    task.warn(place, message);
    found.unwrap_or(WIDTH)
}

fn interpolation(name: &str) -> Interpolation {
    match name {
        "constant" => Interpolation::Constant,
        "uniform" => Interpolation::Uniform,
        "varying" => Interpolation::Varying,
        _ => Interpolation::Vertex,
    }
}

/// The values of an attribute of curves or points, to which a [`Data`] refers.
struct Owned {
    values: Vec<f32>,
    width: usize,
    interpolation: Interpolation,
}

impl Owned {
    fn data(&self) -> Data<'_> {
        Data { values: &self.values, width: self.width, interpolation: self.interpolation }
    }

    /// Reads a primvar by name and expands its indices.
    fn primvar(package: &Package<'_>, primvars: &[Primvar], name: &str, place: &str) -> Option<Self> {
        let primvar = primvars.iter().find(|primvar| primvar.name == name)?;
        let (mut values, width) = reals(package, &primvar.values, place).ok()?;
        if let Some(indices) = &primvar.indices {
            let indices = package.integers(indices, place).ok()?;
            let value = |index: i64| values.get(usize::try_from(index).ok()?.checked_mul(width)?..)?.get(..width);
            values = indices.into_iter().map(value).collect::<Option<Vec<_>>>()?.concat();
        }
        Some(Self { values, width, interpolation: interpolation(&primvar.interpolation) })
    }
}

/// Reads the curves of a prim and makes their triangles.
pub(crate) fn curves(
    package: &Package<'_>,
    entry: &CurvesEntry,
    uv_names: UvNames<'_>,
    task: Task<'_>,
) -> Result<Geometry, Fault> {
    let place = entry.place.as_str();
    // Read the topology.
    let points = points(package, &entry.points, place)?;
    let counts = match &entry.counts {
        Some(array) => package.integers(array, place)?,
        None => Vec::new(),
    };
    let counts: Vec<i32> = counts.into_iter().map(|count| i32::try_from(count).unwrap_or(0)).collect();
    let wanted = counts.iter().fold(0usize, |sum, &count| sum.saturating_add(usize::try_from(count).unwrap_or(0)));
    if wanted > points.len() {
        let message = format!(
            "curveVertexCounts: expected counts with a sum of at most {}, the number of points, found {wanted}; the last curves are left out",
            points.len()
        );
        task.warn(place, message);
    }
    let cubic = |name: &str| match name {
        "bezier" => Ok(Basis::Bezier),
        "bspline" => Ok(Basis::BSpline),
        "catmullRom" => Ok(Basis::CatmullRom),
        other => Err(Fault::new(place, "the basis bezier, bspline or catmullRom", other)),
    };
    let basis = if entry.curve_type == "linear" { Basis::Linear } else { cubic(&entry.curve_basis)? };
    let wrap = match entry.curve_wrap.as_str() {
        "periodic" => Wrap::Periodic,
        "pinned" => Wrap::Pinned,
        _ => Wrap::Nonperiodic,
    };
    // Read the attributes. If widths are missing, they follow from the spacing of the curves, or
    // from their bounding box.
    let list = |array: &Option<Array>, name: &str| -> Result<Option<Owned>, Fault> {
        let Some(array) = array else { return Ok(None) };
        let (values, width) = reals(package, array, place)?;
        Ok(Some(Owned { values, width, interpolation: interpolation(name) }).filter(|owned| !owned.values.is_empty()))
    };
    let widths = list(&entry.widths, &entry.widths_interpolation)?;
    let widths = widths.unwrap_or_else(|| {
        let width =
            width_by_spacing("curves", spacing::width(&middles(&points, &counts), &points, CURVES), place, task);
        Owned { values: vec![width], width: 1, interpolation: Interpolation::Constant }
    });
    let normals = list(&entry.normals, &entry.normals_interpolation)?.filter(|normals| normals.width == 3);
    let primvar = |name: &str| Owned::primvar(package, &entry.primvars, name, place);
    let colors = primvar("displayColor").filter(|colors| colors.width >= 3);
    let uvs = uv_names.map(|name| name.and_then(primvar).filter(|uvs| uvs.width == 2));
    Ok(tessellate(&Curves {
        points: &points,
        vertex_counts: &counts,
        basis,
        wrap,
        widths: widths.data(),
        normals: normals.as_ref().map(Owned::data),
        colors: colors.as_ref().map(Owned::data),
        uvs: uvs.each_ref().map(|uvs| uvs.as_ref().map(Owned::data)),
    }))
}

/// Returns the middle point of every curve. The spacing of curves is measured at their middle
/// points, since many curves may begin at the same point.
fn middles(points: &[Vec3], counts: &[i32]) -> Vec<Vec3> {
    let mut first = 0usize;
    let middle = |&count: &i32| {
        let count = usize::try_from(count).unwrap_or(0);
        let start = first;
        first = first.saturating_add(count);
        points.get(start..first).and_then(|curve| curve.get(count / 2)).copied()
    };
    counts.iter().filter_map(middle).collect()
}

/// Reads the points of a prim and makes a ball for each.
pub(crate) fn balls(package: &Package<'_>, entry: &PointsEntry, task: Task<'_>) -> Result<Geometry, Fault> {
    let place = entry.place.as_str();
    let mut points = points(package, &entry.points, place)?;
    if points.len() > MOST_POINTS {
        task.warn(place, format!("of {} points only the first {MOST_POINTS} are shown", points.len()));
        points.truncate(MOST_POINTS);
    }
    // If widths are missing, they follow from the spacing of the points, or from their bounding
    // box.
    let widths = match &entry.widths {
        Some(array) => reals(package, array, place)?.0,
        None => Vec::new(),
    };
    let mut widths = widths;
    if widths.is_empty() && !points.is_empty() {
        let width = width_by_spacing("points", spacing::width(&points, &points, POINTS), place, task);
        widths.push(width);
    }
    // A point without a width gets the first width. If there are fewer colours than points, all
    // points get the first colour.
    let colors = Owned::primvar(package, &entry.primvars, "displayColor", place).filter(|colors| colors.width >= 3);
    let each = |list: &[f32], i: usize| list.get(i).or(list.first()).copied();
    let color = |i: usize| {
        let Some(colors) = &colors else { return Vec4::ONE };
        let constant = colors.values.len() < colors.width * points.len();
        let rgb = colors.values.get(if constant { 0 } else { i * colors.width }..).unwrap_or_default();
        Vec4::new(
            each(rgb, 0).unwrap_or(1.0),
            rgb.get(1).copied().unwrap_or(1.0),
            rgb.get(2).copied().unwrap_or(1.0),
            1.0,
        )
    };
    let mut geometry = colored_balls(&points, |i| each(&widths, i).unwrap_or(WIDTH), color);
    if colors.is_none() {
        geometry.colors.clear();
    }
    Ok(geometry)
}
