//! Functions that all plots share: ranges of axes, decimals of tick labels, descriptions.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{Cartesian2d, ChartContext, SVGBackend};

/// Font family of the SVG's text. Machines without this font use another font.
pub const FAMILY: &str = "DejaVu Sans, sans-serif";

pub(crate) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
pub(crate) type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Adds a text description for screen readers.
pub(crate) fn described(svg: &str, label: &str) -> String {
    let label = label.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    svg.replacen("xmlns=", &format!("role=\"img\" aria-label=\"{label}\" xmlns="), 1)
}

/// Returns a range that contains all values, widened by a fraction of its width on both sides. The
/// range is never empty. `None` if there are no values.
pub(crate) fn ends(values: impl Iterator<Item = f64>, widen: f64) -> Option<[f64; 2]> {
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let width = high - low;
    match width {
        width if width < 0.0 => None,
        width if width > 1e-9 => Some([low - widen * width, high + widen * width]),
        _ => Some([low - 0.5, high + 0.5]),
    }
}

/// Returns the number of decimals that distinguishes tick labels.
pub(crate) fn digits([low, high]: [f64; 2]) -> usize {
    match high - low {
        width if width >= 8.0 => 0,
        width if width >= 0.8 => 1,
        width if width >= 0.08 => 2,
        _ => 3,
    }
}
