//! report.json; the keys are documented at the crate's root.

use lumistack_display::Projection;
use serde_json::{Value, json};

use crate::measure::{FieldScore, Measured};
use crate::{ReportError, ReportInput};

/// Value of the key `schema`.
const SCHEMA: &str = "lumistack/report";

pub(crate) fn report(input: &ReportInput, measured: &Measured) -> Result<Value, ReportError> {
    let held_out = measured.held_out.as_ref().map(|score| {
        let mut views = views(score);
        views["overall_psnr_view"] = figure(score.psnr_view());
        views["overall_psnr_raw"] = figure(score.psnr_raw());
        views
    });
    Ok(json!({
        "schema": SCHEMA,
        "version": 1,
        "title": input.title,
        "lumistack_version": input.version,
        "command": input.command,
        "psnr_view": figure(measured.target.psnr_view()),
        "psnr_raw": figure(measured.target.psnr_raw()),
        "brightness": input.stack.brightness,
        "views": views(&measured.target),
        "held_out": held_out,
        "convergence": input.convergence.iter().map(|it| json!({
            "iteration": it.iteration,
            "objective": figure(it.objective),
            "psnr_view": figure(it.psnr_view),
            "seconds": figure(it.seconds),
        })).collect::<Vec<_>>(),
        "stages": input.stages.iter().map(|stage| json!({
            "name": stage.name,
            "seconds": figure(stage.seconds),
            "cached": stage.cached,
        })).collect::<Vec<_>>(),
        "seconds_total": figure(input.stages.iter().map(|stage| stage.seconds).sum::<f64>()),
        "display": serde_json::to_value(input.display)?,
        "settings": input.settings,
        "scene": input.scene,
        "warnings": input.warnings.iter().map(|w| json!({ "place": w.place, "message": w.message })).collect::<Vec<_>>(),
        "outputs": input.outputs.iter().map(|o| json!({ "label": o.label, "path": o.path })).collect::<Vec<_>>(),
    }))
}

/// A number, `"Infinity"`, `"-Infinity"` or null.
fn figure(value: f64) -> Value {
    match value {
        f64::INFINITY => "Infinity".into(),
        f64::NEG_INFINITY => "-Infinity".into(),
        // serde_json writes NaN as null
        finite => finite.into(),
    }
}

fn views(score: &FieldScore) -> Value {
    let geometry = &score.geometry;
    let [view_rows, view_cols] = geometry.grid.views();
    let table = |value: &dyn Fn([usize; 2]) -> f64| -> Value {
        (0..view_rows).map(|y| (0..view_cols).map(|x| figure(value([y, x]))).collect::<Value>()).collect()
    };
    let (projection, distance_mm) = match geometry.grid.projection {
        Projection::Oblique => ("oblique", None),
        Projection::Perspective { distance_mm } => ("perspective", Some(distance_mm)),
    };
    json!({
        "slope_x": geometry.grid.slope_x,
        "slope_y": geometry.grid.slope_y,
        "projection": projection,
        "distance_mm": distance_mm,
        "rows": geometry.rows,
        "cols": geometry.cols,
        "pitch_mm": geometry.pitch_mm,
        "psnr_view": table(&|view| score.view(view).psnr()),
        "counted_share": table(&|view| score.counted_share(view)),
    })
}
