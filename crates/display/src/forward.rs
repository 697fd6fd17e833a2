//! The forward model: the light that a display emits. [`Formation`] has the equations, which hold
//! for each colour channel separately.
//!
//! The response of the layers' hardware changes the stored values, and rays read the changed values
//! ([`LayerStack::effective`]). A [`Simulator`] computes the changed values once and then renders
//! any number of views.
//!
//! The simple version reads four pixels of a layer for every ray. The fast version processes whole
//! runs (`Reads::Runs`). In a run, neighbouring rays read neighbouring pixels, one pixel per ray.
//! Both versions give the same bits. Rays form such runs under nearest sampling at equal pitch, and
//! in views whose rays hit the layer's pixel centres. The rays of a seen picture also form runs.

use std::borrow::Cow;

use lumistack_core::Tensor;

use crate::area::AreaMap;
use crate::{BacklightTap, Display, FieldGeometry, Formation, LayerStack, Missing, Projection, RayMap, Tap, ViewGrid};

/// A pixel of a seen picture is scored if the rays of at least this fraction of its area are valid.
pub const LEAST_SHARE: f32 = 0.5;

/// The light that the display emits in one view, with one ray per pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct EmittedView {
    /// Emitted radiance L̃, `[row][col][rgb]`; an adapted viewer sees it divided by the stack's
    /// brightness. In the views of [`Simulator::view`], invalid rays have radiance 0.
    pub radiance: Tensor<3>,
    /// True for a valid ray, `[row][col]`: false if the ray misses the lenslets, or a layer that
    /// the display's [`Missing`] rule requires.
    pub valid: Vec<bool>,
}

/// A picture as an eye sees it: every pixel is the mean over its area.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenView {
    /// Mean of the emitted radiance L̃ over the part of the pixel's area whose rays are valid,
    /// `[row][col][rgb]`. It is 0 if no ray of the pixel is valid. An adapted viewer sees the
    /// radiance divided by the stack's brightness.
    pub radiance: Tensor<3>,
    /// Fraction of the pixel's area with valid rays, 0..1, `[row][col]` row-major. The remaining
    /// rays miss the lenslets, or a layer that the display's [`Missing`] rule requires.
    pub share: Vec<f32>,
}

impl From<SeenView> for EmittedView {
    /// Marks a pixel as valid for scores if its rays are valid over at least [`LEAST_SHARE`] of its
    /// area.
    fn from(seen: SeenView) -> Self {
        Self { radiance: seen.radiance, valid: seen.share.iter().map(|share| *share >= LEAST_SHARE).collect() }
    }
}

/// A display that shows a stack. The stack must fit the display ([`LayerStack::check`]).
#[derive(Clone, Debug)]
pub struct Simulator<'a> {
    display: &'a Display,
    /// The stack's values after the response of the layers' hardware.
    stack: Cow<'a, LayerStack>,
}

impl<'a> Simulator<'a> {
    /// Applies the response of the layers' hardware, which is the same for all views.
    pub fn new(display: &'a Display, stack: &'a LayerStack) -> Self {
        Self { display, stack: stack.effective(display) }
    }

    /// Returns the seen picture along slope (s_x, s_y): a parallel projection, as an eye far away
    /// sees it.
    pub fn from_slope(&self, slope: [f64; 2]) -> SeenView {
        self.seen_from(&ViewGrid::single(Projection::Oblique, slope))
    }

    /// Returns the seen picture from an eye at (x, y, z) millimetres in display space, z > 0.
    pub fn from_eye(&self, eye_mm: [f64; 3]) -> SeenView {
        let [x, y, z] = eye_mm;
        self.seen_from(&ViewGrid::single(Projection::Perspective { distance_mm: z }, [x / z, y / z]))
    }

    /// Returns the seen picture of a view grid with a single view.
    pub fn seen_from(&self, view: &ViewGrid) -> SeenView {
        self.seen(&self.display.field_pixels().with_grid(view.clone()), [0, 0])
    }

    /// Returns the view `view` = [view_y, view_x] of a geometry, with one ray through the centre of
    /// each pixel, as in the solvers' objective. `map` is the [`RayMap`] of this display and
    /// geometry.
    pub fn view(&self, map: &RayMap, geometry: &FieldGeometry, view: [usize; 2]) -> EmittedView {
        let (rows, cols) = (geometry.rows, geometry.cols);
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
        let mut valid = vec![true; rows * cols];
        let mut lines = Lines::new(self, map, view);
        for row in 0..rows {
            let sum = lines.emitted(row);
            for (col, (pixel, sum)) in
                radiance.block_mut([row]).chunks_exact_mut(3).zip(sum.chunks_exact(3)).enumerate()
            {
                valid[row * cols + col] = ray_is_valid(map, self.display.missing, view, row, col);
                if valid[row * cols + col] {
                    pixel.iter_mut().zip(sum).for_each(|(value, sum)| *value = *sum as f32);
                }
            }
        }
        EmittedView { radiance, valid }
    }

    /// Returns the seen picture of a view: for every pixel of `geometry`, the mean emission along
    /// the rays of the view through the pixel's area. The mean is exact. Layers consist of squares
    /// of constant value. Pixels are cut at the edges of these squares, of lenslets and of bins.
    pub fn seen(&self, geometry: &FieldGeometry, view: [usize; 2]) -> SeenView {
        let area = AreaMap::new(self.display, geometry, view);
        let missing = self.display.missing;
        let mut sums = vec![0.0f64; 3 * geometry.cols];
        let mut shares = vec![0.0f64; geometry.cols];
        let mut radiance = Tensor::zeros(["row", "col", "rgb"], [geometry.rows, geometry.cols, 3]);
        let mut share = Vec::with_capacity(geometry.rows * geometry.cols);
        let mut lines = Lines::new(self, &area.map, [0, 0]);
        for (row, cuts) in area.y.chunk_by(|a, b| a.pixel == b.pixel).enumerate() {
            sums.fill(0.0);
            shares.fill(0.0);
            // sum the emission along the rays of each pixel's parts, weighted by the parts' area
            let first = area.y.partition_point(|cut| cut.pixel < row as u32);
            for (number, cut_y) in cuts.iter().enumerate() {
                let line = lines.emitted(first + number);
                for (i, (cut_x, emitted)) in area.x.iter().zip(line.chunks_exact(3)).enumerate() {
                    if ray_is_valid(&area.map, missing, [0, 0], first + number, i) {
                        let (col, weight) = (cut_x.pixel as usize, cut_x.share * cut_y.share);
                        shares[col] += weight;
                        sums[3 * col..3 * col + 3].iter_mut().zip(emitted).for_each(|(sum, e)| *sum += weight * e);
                    }
                }
            }
            for ((pixel, sums), share) in
                radiance.block_mut([row]).chunks_exact_mut(3).zip(sums.chunks_exact(3)).zip(&shares)
            {
                if *share > 0.0 {
                    pixel.iter_mut().zip(sums).for_each(|(value, sum)| *value = (sum / share) as f32);
                }
            }
            share.extend(shares.iter().map(|share| *share as f32));
        }
        SeenView { radiance, share }
    }
}

/// Computes the emission of one view row by row, in storage that all rows share.
struct Lines<'a> {
    simulator: &'a Simulator<'a>,
    map: &'a RayMap,
    view: [usize; 2],
    reads: Vec<Reads<'a>>,
    formed: Vec<f32>,
    sum: Vec<f64>,
}

impl<'a> Lines<'a> {
    fn new(simulator: &'a Simulator<'a>, map: &'a RayMap, view: [usize; 2]) -> Self {
        let reads: Vec<Reads> = map.layers.iter().map(|layer| Reads::of(layer.x.of_view(view[1]))).collect();
        let cols = map.layers.first().map_or_else(
            || map.backlight.as_ref().map_or(0, |map| map.x(view[1]).len()),
            |layer| layer.x.of_view(view[1]).len(),
        );
        Self { simulator, map, view, reads, formed: vec![0.0; cols * 3], sum: vec![0.0; cols * 3] }
    }

    /// Returns the emission along the rays of a row, averaged over the frames, `[col][rgb]`.
    /// Invalid rays are included.
    fn emitted(&mut self, row: usize) -> &[f64] {
        let Self { simulator, map, view, reads, formed, sum } = self;
        let (stack, formation) = (&simulator.stack, simulator.display.formation);
        sum.fill(0.0);
        for frame in 0..stack.frames() {
            formed.fill(formation.neutral());
            for ((layer, values), reads) in map.layers.iter().zip(&stack.layers).zip(reads.iter()) {
                let tap_y = layer.y.of_view(view[0])[row];
                match formation {
                    Formation::Attenuating => combine_layer(formed, values, frame, tap_y, reads, |x, v| *x *= v),
                    _ => combine_layer(formed, values, frame, tap_y, reads, |x, v| *x += v),
                }
            }
            if formation == Formation::Polarization {
                formed.iter_mut().for_each(|formed| *formed = sin2_of_quarter_turns(*formed));
            }
            if let (Some(map), Some(emission)) = (&map.backlight, &stack.emission) {
                let (tap_y, taps_x) = (map.y(view[0])[row], map.x(view[1]));
                match formation {
                    Formation::Additive => combine_backlight(formed, emission, frame, tap_y, taps_x, |x, b| *x += b),
                    _ => combine_backlight(formed, emission, frame, tap_y, taps_x, |x, b| *x *= b),
                }
            }
            sum.iter_mut().zip(formed.iter()).for_each(|(sum, &formed)| *sum += f64::from(formed));
        }
        let frames = stack.frames() as f64;
        sum.iter_mut().for_each(|sum| *sum /= frames);
        sum
    }
}

/// Returns the seen picture along one slope. For several pictures make a [`Simulator`].
pub fn view_from_slope(display: &Display, stack: &LayerStack, slope: [f64; 2]) -> SeenView {
    Simulator::new(display, stack).from_slope(slope)
}

/// Returns the seen picture from one eye position. For several pictures make a [`Simulator`].
pub fn view_from_eye(display: &Display, stack: &LayerStack, eye_mm: [f64; 3]) -> SeenView {
    Simulator::new(display, stack).from_eye(eye_mm)
}

/// Returns true if a ray is valid. A valid ray hits the lenslets, if there are any, and under
/// [`Missing::Drop`] it hits every layer.
#[inline]
pub fn ray_is_valid(map: &RayMap, missing: Missing, view: [usize; 2], row: usize, col: usize) -> bool {
    let layers = missing == Missing::Clear
        || map
            .layers
            .iter()
            .all(|layer| !layer.y.of_view(view[0])[row].is_missed() && !layer.x.of_view(view[1])[col].is_missed());
    let backlight = map.backlight.as_ref().is_none_or(|backlight| {
        backlight.y(view[0])[row] != BacklightTap::Missed && backlight.x(view[1])[col] != BacklightTap::Missed
    });
    layers && backlight
}

/// The layer pixels that the rays of a row read.
enum Reads<'a> {
    /// Runs of neighbouring rays that read neighbouring single pixels; all other rays of the row
    /// miss the layer.
    Runs(Vec<Run>),
    /// The pixels of every ray, for rays that form no runs.
    Taps(&'a [Tap]),
}

/// The rays `first..end` read one pixel each: ray `first` reads pixel `from`, and each next ray
/// reads the next pixel.
#[derive(Clone, Copy)]
struct Run {
    first: usize,
    end: usize,
    from: usize,
}

impl<'a> Reads<'a> {
    fn of(taps: &'a [Tap]) -> Self {
        let mut runs: Vec<Run> = Vec::new();
        for (i, tap) in taps.iter().enumerate().filter(|(_, tap)| !tap.is_missed()) {
            if tap.t != 0.0 {
                return Self::Taps(taps);
            }
            match runs.last_mut() {
                Some(run) if run.end == i && run.from + (i - run.first) == tap.first as usize => run.end += 1,
                _ => runs.push(Run { first: i, end: i + 1, from: tap.first as usize }),
            }
        }
        // A call for a run of few rays costs more than reading these rays one by one.
        if runs.len() * SHORT_RUN > taps.len() { Self::Taps(taps) } else { Self::Runs(runs) }
    }
}

/// Mean number of rays per run below which rays are read one by one.
const SHORT_RUN: usize = 4;

/// Combines each `formed[col][rgb]` with the layer's value at the ray. If the ray misses the layer,
/// `formed` stays: either the layer is treated as clear, or the ray is invalid and callers ignore
/// its value.
fn combine_layer(
    formed: &mut [f32],
    values: &Tensor<4>,
    frame: usize,
    tap_y: Tap,
    reads: &Reads,
    combine: impl Fn(&mut f32, f32),
) {
    if tap_y.is_missed() {
        return;
    }
    let upper = values.block([frame, tap_y.first as usize]);
    let lower = values.block([frame, tap_y.second as usize]);
    match reads {
        Reads::Runs(runs) => {
            for &Run { first, end, from } in runs {
                let places = 3 * from..3 * (from + end - first);
                let formed = formed[3 * first..3 * end].iter_mut();
                if tap_y.t == 0.0 {
                    formed.zip(&upper[places]).for_each(|(formed, value)| combine(formed, *value));
                } else {
                    let lines = upper[places.clone()].iter().zip(&lower[places]);
                    let mixed = lines.map(|(top, bottom)| top + tap_y.t * (bottom - top));
                    formed.zip(mixed).for_each(|(formed, value)| combine(formed, value));
                }
            }
        }
        Reads::Taps(taps) => {
            for (pixel, tap) in formed.chunks_exact_mut(3).zip(*taps).filter(|(_, tap)| !tap.is_missed()) {
                let (left, right) = (3 * tap.first as usize, 3 * tap.second as usize);
                for c in 0..3 {
                    let top = upper[left + c] + tap.t * (upper[right + c] - upper[left + c]);
                    let bottom = lower[left + c] + tap.t * (lower[right + c] - lower[left + c]);
                    combine(&mut pixel[c], top + tap_y.t * (bottom - top));
                }
            }
        }
    }
}

/// Combines each `formed[col][rgb]` with the backlight's emission at the ray. The emission is 0
/// unless the taps of both axes are [`BacklightTap::Lit`].
fn combine_backlight(
    formed: &mut [f32],
    emission: &Tensor<6>,
    frame: usize,
    tap_y: BacklightTap,
    taps_x: &[BacklightTap],
    combine: impl Fn(&mut f32, f32),
) {
    for (pixel, &tap_x) in formed.chunks_exact_mut(3).zip(taps_x) {
        match (tap_x, tap_y) {
            (BacklightTap::Lit { lenslet: col, bin: bin_x }, BacklightTap::Lit { lenslet: row, bin: bin_y }) => {
                let values = emission.block([frame, bin_y as usize, bin_x as usize, row as usize, col as usize]);
                pixel.iter_mut().zip(values).for_each(|(formed, value)| combine(formed, *value));
            }
            _ => pixel.iter_mut().for_each(|formed| combine(formed, 0.0)),
        }
    }
}

/// Returns sin²(π/2 · x) for 0 ≤ x < 1000. The sum x of the layers' values is at most the number of
/// layers. The absolute error is below 1e-6 for x ≤ 8. With `f32::sin` this function would take
/// most of the time of a view.
fn sin2_of_quarter_turns(x: f32) -> f32 {
    // An `f32` near 1.5 · 2²³ has no bits for a fraction. So the addition of `ROUND` rounds to the
    // nearest whole number of half turns.
    const ROUND: f32 = 12_582_912.0;
    let half_turns = (0.5 * x + ROUND) - ROUND;
    let angle = std::f32::consts::FRAC_PI_2 * (x - 2.0 * half_turns);
    // Sum the Taylor series of the sine. The first omitted term is at most 6e-8 for |angle| ≤ π/2.
    let s = angle * angle;
    let series = [-1.0 / 39_916_800.0, 1.0 / 362_880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0];
    (angle * series.into_iter().fold(0.0, |sum, factor| sum * s + factor)).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::tests::small_display;

    #[test]
    fn the_emitted_mean_is_the_mean_over_frames() {
        let display = small_display();
        let mut stack = LayerStack::filled(&display, 1.0);
        for (frame, value) in [0.2, 0.6].into_iter().enumerate() {
            stack.layers[1].block_mut([frame]).fill(value);
        }
        let view = view_from_slope(&display, &stack, [0.0, 0.0]);
        assert!(view.radiance.data().iter().all(|v| (v - 0.4).abs() < 1e-6));
        assert!(view.share.iter().all(|share| (share - 1.0).abs() < 1e-6));
    }

    #[test]
    fn a_dot_on_the_front_layer_moves_against_the_viewer() {
        let mut display = small_display();
        display.missing = Missing::Clear;
        let mut stack = LayerStack::filled(&display, 1.0);
        let [rows, cols] = [display.field.resolution[1], display.field.resolution[0]];
        for frame in 0..display.frames {
            stack.layers[2].block_mut([frame, rows / 2, cols / 2]).fill(0.0);
        }
        let dark = |view: &SeenView| {
            let values = view.radiance.data().iter().enumerate();
            let at = values.min_by(|a, b| a.1.total_cmp(b.1)).unwrap().0 / 3;
            (at / cols, at % cols)
        };
        let straight = dark(&view_from_slope(&display, &stack, [0.0, 0.0]));
        assert_eq!(straight, (rows / 2, cols / 2));
        // An eye further right sees the front dot further left on z = 0, and an eye further up sees
        // the dot further down.
        let right = dark(&view_from_slope(&display, &stack, [0.1, 0.0]));
        assert!(right.1 < straight.1 && right.0 == straight.0, "{right:?}");
        let up = dark(&view_from_slope(&display, &stack, [0.0, 0.1]));
        assert!(up.0 > straight.0 && up.1 == straight.1, "{up:?}");
        // a far eye on the axis has the picture of the parallel projection
        let far = view_from_eye(&display, &stack, [0.0, 0.0, 1e7]);
        let straight = view_from_slope(&display, &stack, [0.0, 0.0]);
        let differences = far.radiance.data().iter().zip(straight.radiance.data()).map(|(a, b)| (a - b).abs());
        assert!(differences.fold(0.0, f32::max) < 1e-4);
    }

    #[test]
    fn rays_that_leave_a_layer_are_dropped_or_clear() {
        let mut display = small_display();
        let stack = LayerStack::filled(&display, 0.5);
        let view = view_from_slope(&display, &stack, [0.14, 0.0]);
        assert!(view.share.contains(&0.0) && view.share.iter().any(|share| *share > 0.999));
        display.missing = Missing::Clear;
        let clear = view_from_slope(&display, &stack, [0.14, 0.0]);
        assert!(clear.share.iter().all(|share| (share - 1.0).abs() < 1e-6));
        assert!(clear.radiance.data().iter().any(|v| (*v - 0.25).abs() < 1e-6), "a ray misses one of three layers");
    }

    /// [`Reads::Runs`] and [`Reads::Taps`] give the same bits for both samplings, for rays that hit
    /// pixel centres and for rays between centres.
    #[test]
    fn whole_lines_are_read_as_single_pixels_are() {
        let (cols, rows, mut lines, mut taps) = (13, 4, 0, 0);
        let mut values = Tensor::zeros(["frame", "row", "col", "rgb"], [1, rows, cols, 3]);
        values.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = (0.37 * i as f32).sin().abs());
        for sampling in [crate::Sampling::Nearest, crate::Sampling::Bilinear] {
            for (d_mm, pitch_mm) in [(0.0, 1.0), (30.0, 1.0), (10.0, 1.0), (0.0, 0.9), (3.0, 1.3)] {
                let mut display = Display::uniform([13, 4], 1.0, [3, 3], [20.0, 20.0], &[d_mm], 1);
                display.sampling = sampling;
                display.layers[0].pitch_mm = pitch_mm;
                let map = RayMap::new(&display, &display.geometry().unwrap());
                for (view, row) in (0..3).flat_map(|view| (0..rows).map(move |row| (view, row))) {
                    let (tap_y, taps_x) = (map.layers[0].y.of_view(view)[row], map.layers[0].x.of_view(view));
                    let reads = Reads::of(taps_x);
                    if let Reads::Runs(_) = reads {
                        lines += 1
                    } else {
                        taps += 1
                    }
                    let formed = |reads: &Reads| {
                        let mut formed = vec![0.7f32; 3 * cols];
                        combine_layer(&mut formed, &values, 0, tap_y, reads, |x, v| *x *= v);
                        formed
                    };
                    assert_eq!(
                        formed(&reads),
                        formed(&Reads::Taps(taps_x)),
                        "{sampling:?} {d_mm} {pitch_mm} {view} {row}"
                    );
                }
            }
        }
        assert!(lines > 20 && taps > 20, "{lines} {taps}");
        // The list of runs is empty if all rays miss the layer, or if there are no rays.
        let missed = Tap { first: Tap::MISSED, second: Tap::MISSED, t: 0.0 };
        assert!(
            [&[][..], &[missed; 3]].iter().all(|taps| matches!(Reads::of(taps), Reads::Runs(runs) if runs.is_empty()))
        );
    }

    #[test]
    fn the_series_agrees_with_the_sine() {
        for i in 0..=80_000 {
            let x = i as f32 / 10_000.0;
            let expected = (std::f64::consts::FRAC_PI_2 * f64::from(x)).sin().powi(2);
            assert!((f64::from(sin2_of_quarter_turns(x)) - expected).abs() < 1e-6, "{x}");
        }
    }
}
