//! Starting patterns.
//!
//! A multiplicative rule keeps equal frames equal, and never changes an exact 0. So in every kind
//! of start, each frame has different noise, and no value is below [`FLOOR`].

use lumistack_core::seed::{Stream, derive};
use lumistack_display::{Display, Formation, Layer, LayerStack};

use crate::bands;
use crate::expand::{Rays, wanted};
use crate::line::LineOf;
use crate::plan::{Plan, TilePlace};

/// Smallest value in a start, and in the patterns of solvers with a multiplicative rule.
pub const FLOOR: f32 = 1e-4;

/// Kind of start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StartKind {
    /// Independent uniform noise in [`FLOOR`]..1. The paper does not state its start. Narrower
    /// ranges gain a few tenths of a dB in the first updates. They do not change the ranking of the
    /// solvers.
    #[default]
    Random,
    /// The noise of [`Self::Random`], blurred by 1.5 pixels and stretched to its full range.
    /// Neighbouring rays then see nearly the same values, so the first updates need not smooth the
    /// patterns.
    Smooth,
    /// Level times smooth noise; each frame has its own noise. A pixel's level is the value at
    /// which N equal factors emit the mean of βL over the pixel's rays. If layers attenuate, it is
    /// the N-th root of the mean.
    Content,
}

impl StartKind {
    /// All kinds with their names.
    pub const ALL: [(&'static str, Self); 3] =
        [("random", Self::Random), ("smooth", Self::Smooth), ("content", Self::Content)];

    /// Returns all names that select a start; the first is [`AUTO`](crate::AUTO).
    pub fn names() -> impl Iterator<Item = &'static str> {
        std::iter::once(crate::AUTO).chain(Self::ALL.iter().map(|(name, _)| *name))
    }

    /// Returns the kind with this name; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, kind)| *kind)
    }

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Smooth => "smooth",
            Self::Content => "content",
        }
    }

    /// Returns a text that helps users choose.
    pub fn doc(self) -> &'static str {
        match self {
            Self::Random => "Independent uniform noise.",
            Self::Smooth => "Noise that is blurred, so that neighbouring rays read nearly the same values.",
            Self::Content => {
                "Every pixel gets one value in all frames, derived from the mean target of its rays. Smooth noise, different in each frame, multiplies this value."
            }
        }
    }
}

/// Standard deviation of the blur of smooth noise, pixels.
const NOISE_BLUR_PX: f64 = 1.5;
/// Range of the noise that multiplies the level of a content start.
///
/// With narrow noise a start is close to the target (20 dB), and frames still diverge. PSNR
/// measured after 5 iterations (3 layers, 6 frames, β = 0.2 and 1):
///
/// | range | β = 0.2 | β = 1 |
/// |---|---|---|
/// | 0.8..1.2 | 30.0 dB | 25.8 dB |
/// | 0.4..1.4 | 29.3 dB | 25.3 dB |
/// | 0..1 | 26.0 dB | 24.2 dB |
pub(crate) const CONTENT_NOISE: [f32; 2] = [0.8, 1.2];

/// Makes starting patterns. The same problem, kind and seed give the same patterns.
pub(crate) fn start_patterns(plan: &Plan, display: &Display, kind: StartKind, seed: u64) -> LayerStack {
    let mut stack = noise(display, seed, plan.tile.as_ref());
    if kind == StartKind::Random {
        return stack;
    }
    // blur the noise and stretch it to the full range
    let response = Layer { blur_px: NOISE_BLUR_PX, ..display.layers[0].clone() }.response();
    for_each_plane(&mut stack, |plane, rows, cols, [blurred, scratch]| {
        blurred.resize(plane.len(), 0.0);
        if let Some(response) = &response {
            response.blur(rows, cols, plane, blurred, scratch);
            plane.copy_from_slice(blurred);
        }
        let range = plane.iter().fold((f32::MAX, f32::MIN), |(low, high), &v| (low.min(v), high.max(v)));
        let scale = (1.0 - FLOOR) / (range.1 - range.0).max(f32::MIN_POSITIVE);
        plane.iter_mut().for_each(|value| *value = FLOOR + (*value - range.0) * scale);
    });
    // multiply the noise by the level of each pixel
    if kind == StartKind::Content {
        let factors = plan.maps.len() as f32;
        for (n, values) in parts(&mut stack).enumerate() {
            let means = mean_target(plan, n);
            let levels: Vec<f32> = means.iter().map(|mean| level(display.formation, mean.max(0.0), factors)).collect();
            let [low, high] = CONTENT_NOISE;
            for frame in values.chunks_exact_mut(levels.len()) {
                for (value, &level) in frame.iter_mut().zip(&levels) {
                    *value = (level * (low + (high - low) * *value)).clamp(FLOOR, 1.0);
                }
            }
        }
    }
    stack
}

/// Returns the value that `factors` equal factors need to emit `mean`.
pub(crate) fn level(formation: Formation, mean: f32, factors: f32) -> f32 {
    match formation {
        Formation::Attenuating => mean.powf(1.0 / factors),
        Formation::Additive => mean / factors,
        Formation::Polarization => mean.min(1.0).sqrt().asin() * std::f32::consts::FRAC_2_PI / factors,
    }
}

/// Returns patterns of [`StartKind::Random`].
pub fn random_start(display: &Display, seed: u64) -> LayerStack {
    noise(display, seed, None)
}

/// Returns patterns of [`StartKind::Random`]. For a tile, these are the tile's region of the whole
/// display's patterns.
fn noise(display: &Display, seed: u64, tile: Option<&TilePlace>) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    let sizes = sizes(&stack);
    let mut parts: Vec<&mut [f32]> = parts(&mut stack).collect();
    bands::for_each_chunk(
        &mut parts,
        1,
        || (),
        |(), part, values| {
            let stream = Stream::new(derive(seed, &[part as u64]));
            let size @ [rows, cols] = sizes[part];
            let [first, whole] = tile.map_or([[0, 0], size], |tile| tile.place[part]);
            // every row has its position in the random stream of the whole display, so tiles get
            // the same noise
            for (index, line) in values[0].chunks_exact_mut(3 * cols).enumerate() {
                let (plane, row) = (index / rows, index % rows);
                let pixel = (plane * whole[0] + first[0] + row) * whole[1] + first[1];
                let mut stream = stream.after(3 * pixel as u64);
                line.iter_mut().for_each(|value| *value = FLOOR + (1.0 - FLOOR) * stream.next_f32());
            }
        },
    );
    drop(parts);
    stack
}

/// Returns the rows and columns of a plane, for each layer and then for the lenslets.
fn sizes(stack: &LayerStack) -> Vec<[usize; 2]> {
    let layers = stack.layers.iter().map(|layer| [layer.shape()[1], layer.shape()[2]]);
    layers.chain(stack.emission.iter().map(|emission| [emission.shape()[3], emission.shape()[4]])).collect()
}

/// Returns the values of each layer, then the values of the backlight.
fn parts(stack: &mut LayerStack) -> impl Iterator<Item = &mut [f32]> {
    let layers = stack.layers.iter_mut().map(|layer| layer.data_mut());
    layers.chain(stack.emission.iter_mut().map(|emission| emission.data_mut()))
}

/// Calls `change(plane, rows, cols, buffers)` for every plane: one frame, angular bin and channel.
fn for_each_plane(stack: &mut LayerStack, change: impl Fn(&mut [f32], usize, usize, &mut [Vec<f32>; 2]) + Sync + Send) {
    let sizes = sizes(stack);
    for (values, [rows, cols]) in parts(stack).zip(sizes) {
        bands::for_each_chunk(
            values,
            rows * cols * 3,
            || (vec![0.0; rows * cols], Default::default()),
            |(plane, buffers), _, picture| {
                for channel in 0..3 {
                    let pixels = picture.chunks_exact(3);
                    plane.iter_mut().zip(pixels).for_each(|(value, pixel)| *value = pixel[channel]);
                    change(plane, rows, cols, buffers);
                    let pixels = picture.chunks_exact_mut(3);
                    plane.iter().zip(pixels).for_each(|(value, pixel)| pixel[channel] = *value);
                }
            },
        );
    }
}

/// For every pixel of a line, returns Σ βL over the rays through the pixel, and the number of rays.
/// Rows of rays whose weights are all 0 are left out, since their L may be unknown.
pub(crate) fn line_means(plan: &Plan, at: LineOf) -> Vec<[f32; 2]> {
    let map = &plan.maps[at.factor];
    let layout = &map.layout;
    let (mut sum, mut count) = (vec![0.0f32; layout.stride], vec![0.0f32; layout.stride]);
    let mut radiance = vec![0.0; plan.cols];
    for view_y in 0..plan.views[0] {
        for &(row, _) in map.rays_of_line(view_y, at.line) {
            for view_x in 0..plan.views[1] {
                for run in &plan.runs[view_x] {
                    if plan.target.count(plan.view(view_y, view_x), row as usize, run) == 0 {
                        continue;
                    }
                    let rays = Rays { channel: at.channel, view: [view_y, view_x], row: row as usize, run };
                    wanted(plan, &rays, &mut radiance[..run.len()]);
                    let ones = &plan.ones[..run.len()];
                    plan.row.scatter(&map.x[view_x], run, ones, &radiance[..run.len()], &mut sum);
                    plan.row.scatter(&map.x[view_x], run, ones, ones, &mut count);
                }
            }
        }
    }
    let columns = layout.pad..layout.pad + layout.cols();
    sum[columns.clone()].iter().zip(&count[columns]).map(|(&sum, &count)| [sum, count]).collect()
}

/// Returns the mean of βL over the rays through every pixel of factor `n`, ordered as a tensor of
/// one frame. A pixel without rays gets the mean over the rays of all pixels and channels.
fn mean_target(plan: &Plan, n: usize) -> Vec<f32> {
    let layout = &plan.maps[n].layout;
    let lines = bands::map(
        3 * layout.lines(),
        || (),
        |(), index| {
            line_means(plan, LineOf { factor: n, channel: index / layout.lines(), line: index % layout.lines() })
        },
    );
    let total =
        lines.iter().flatten().fold([0.0f64; 2], |t, [sum, count]| [t[0] + f64::from(*sum), t[1] + f64::from(*count)]);
    let overall = (total[0] / total[1].max(f64::MIN_POSITIVE)) as f32;
    let mut means = vec![0.0; 3 * layout.lines() * layout.cols()];
    for (index, row) in lines.iter().enumerate() {
        let (channel, line) = (index / layout.lines(), index % layout.lines());
        for (col, &[sum, count]) in row.iter().enumerate() {
            means[layout.tensor_offset(0, line, col) + channel] = if count > 0.0 { sum / count } else { overall };
        }
    }
    means
}
