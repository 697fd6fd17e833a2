//! The depth of the scene compared with the depth of field of the display.

use maud::{Markup, PreEscaped, html};

use crate::depth::DepthBudget;
use crate::{ReportError, format, plot};

pub(super) fn section(budget: &DepthBudget) -> Result<Markup, ReportError> {
    let of_field = budget.depth_of_field_mm.map(|range| range.map(|z| format::number(z.round())));
    let mm = |z: f64| format::number(z.round());
    let [p2, p25, _, p75, p98] = budget.depth_mm.map(mm);
    let [median, most, largest] = budget.disparity_px.map(format::number_short);
    let plots = if budget.is_seen() {
        vec![plot::depths(budget)?, plot::disparities(budget)?, plot::bound(budget)?]
    } else {
        Vec::new()
    };
    Ok(html! {
        section id="depth" {
            h2 { "Depth" }
            @if !budget.is_seen() { p class="quiet" { "The views see no surface." } } @else {
                p {
                    @match &of_field {
                        Some([low, high]) => {
                            "The display can show the finest detail of the light field's pixels from " (low) " to " (high) " mm (positive is towards the viewer). "
                            strong { (format::percent(budget.inside)) } " of the hits in all views are in this range, and " (format::percent(budget.inside_middle)) " of the hits in the central view. "
                        }
                        None => "The display shows the finest detail of the light field's pixels at no depth. ",
                    }
                    "Half of the hits lie between " (p25) " and " (p75) " mm, 96 % between " (p2) " and " (p98) " mm."
                }
                p {
                    "Between neighbouring views the content moves by " (median) " pixels (median), by at most " (most) " pixels for 98 % of the content, and by at most " (largest) " pixels for all content. "
                    (format::percent(budget.beyond_a_pixel)) " of the content moves by more than a pixel. There a moving eye sees steps, and in-between views show double contours."
                }
                @if budget.moved_back_mm != 0.0 || budget.depth_scale != 1.0 {
                    p {
                        @if budget.moved_back_mm != 0.0 {
                            "To fit the scene, the window was moved " @if budget.moved_back_mm > 0.0 { "back" } @else { "forward" } " by " (mm(budget.moved_back_mm.abs())) " mm. "
                        }
                        @if budget.depth_scale != 1.0 {
                            "Parallax, and thereby depth, is " (format::percent(budget.depth_scale)) " of the scene's. Depths on this page are the shown depths."
                        }
                    }
                }
                div class="plots" { @for svg in &plots { (PreEscaped(svg)) } }
                p class="quiet" {
                    "A depth is the depth of the first surface along a ray, even of glass or a mirror. The bound on detail holds for continuous layers and many frames; pixels and few frames reach less."
                }
            }
        }
    })
}
