//! The cases that are timed, and the smallest number of operations and bytes of an update.
//!
//! Operations are counted per weighted ray and colour channel, for an update of every factor. F is
//! the number of factors (layers, and the directional backlight), M the number of frames:
//!
//! ```text
//! multiplicative   F · [ M (F−2)     products of the other factors
//!                      + M           L̃
//!                      + 2M          the two sums ]        = F M (F+1)
//! block-exact      F · [ M (F−2)     products of the other factors
//!                      + M           right side
//!                      + M (M+1)/2   Gram matrix ]
//! ```
//!
//! A multiplication or multiply-add is one operation. The clamped coordinate steps, which take
//! place once per pixel, are not counted. Bytes are counted for the update of each factor. All
//! factors are read (4 bytes per value), and the target is read (half floats, 2 bytes per value).
//! The updated factor is written. The sum of these bytes is the smallest traffic of the memory bus
//! if caches keep only single rows and each factor is updated separately.

use lumistack_display::{Backlight, Display, LayerStack, LensletBacklight, LightField, Sampling, Weights};
use lumistack_factorizer::Problem;

/// Number of frames M of every case.
const FRAMES: usize = 6;
/// Brightness β of every case.
const BRIGHTNESS: f64 = 0.2;
/// Width of the display, millimetres: 840 pixels of 0.564 mm.
const WIDTH_MM: f64 = 473.76;

/// A display and its target.
pub struct Case {
    pub name: String,
    pub display: Display,
    pub target: LightField,
}

/// The paper's number of views per axis.
pub const PAPER_VIEWS: usize = 5;
/// Number of views per axis at which the outer layers, with 420 × 262 pixels, shift by about one
/// pixel from view to view. Patterns that are right at these views are also nearly right between
/// them.
pub const NATIVE_VIEWS: usize = 13;

/// Returns the display of the paper's main case with `views` views per axis: three layers, nearest
/// sampling.
pub fn three_layers(resolution: [usize; 2], views: usize) -> Display {
    let pitch_mm = WIDTH_MM / resolution[0] as f64;
    let display = Display::uniform(resolution, pitch_mm, [views; 2], [20.0; 2], &[-40.0, 0.0, 40.0], FRAMES);
    Display { brightness: BRIGHTNESS, ..display }
}

/// Returns the display of the paper's main case with bilinear sampling.
pub fn bilinear(resolution: [usize; 2]) -> Display {
    Display { sampling: Sampling::Bilinear, ..three_layers(resolution, PAPER_VIEWS) }
}

/// Returns a display with one layer in front of the paper's lenslets: 187 × 117 lenslets of 2.54 mm
/// for 840 × 525 pixels. The number of pixels per lenslet is the same at any resolution.
pub fn directional(resolution: [usize; 2]) -> Display {
    let pitch_mm = WIDTH_MM / resolution[0] as f64;
    let coarser = 840.0 / resolution[0] as f64;
    let lenslets = [187.0, 117.0].map(|count| (count / coarser).round() as usize);
    let lenslets = LensletBacklight::new(-8.5, lenslets, 2.54 * coarser, [5; 2], [48.0; 2]);
    let display = Display::uniform(resolution, pitch_mm, [5; 2], [48.0; 2], &[0.0], FRAMES);
    Display { brightness: BRIGHTNESS, backlight: Backlight::Lenslets(lenslets), ..display }
}

/// An update rule with a known number of operations.
#[derive(Clone, Copy, PartialEq)]
pub enum Update {
    Multiplicative,
    BlockExact,
}

/// Smallest number of operations and bytes of an update.
#[derive(Clone, Copy)]
pub struct Needs {
    /// Multiplications and multiply-adds.
    pub operations: f64,
    /// Bytes from and to memory.
    pub bytes: f64,
}

impl Case {
    pub fn problem(&self) -> Problem<'_> {
        Problem { display: &self.display, target: &self.target, weights: &Weights::Uniform }
    }

    /// Counts the operations and bytes of one update, by the formulas at the top of this file.
    /// `rays` is the result of [`lumistack_factorizer::Run::rays`].
    pub fn needs(&self, update: Update, rays: u64) -> Needs {
        let stack = LayerStack::filled(&self.display, 0.0);
        let values = stack.layers.iter().map(|layer| layer.data().len());
        let values: usize = values.chain(stack.emission.iter().map(|emission| emission.data().len())).sum();
        let factors = (stack.layers.len() + usize::from(stack.emission.is_some())) as f64;
        let frames = stack.frames() as f64;
        let products = frames * (factors - 2.0);
        let per_ray = match update {
            Update::Multiplicative => products + 3.0 * frames,
            Update::BlockExact => products + frames + frames * (frames + 1.0) / 2.0,
        };
        let target_bytes = 2.0 * self.target.radiance().data().len() as f64;
        Needs {
            operations: factors * per_ray * 3.0 * rays as f64,
            bytes: factors * (target_bytes + 4.0 * values as f64) + 4.0 * values as f64,
        }
    }
}
