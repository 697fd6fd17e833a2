//! Builds report.json; the crate's root documents the keys.

use lumistack_display::Projection;
use serde_json::{Value, json};

use crate::convergence::reached;
use crate::depth::DepthBudget;
use crate::format::figure;
use crate::measure::{FieldScore, Measured};
use crate::{DenoisedView, Found, ReportError, ReportInput};

/// Value of the key `schema`.
const SCHEMA: &str = "lumistack/report";

pub(crate) fn report(input: &ReportInput, measured: &Measured, found: &Found) -> Result<Value, ReportError> {
    let others = |score: &FieldScore| {
        let mut views = views(score);
        views["overall_psnr_view"] = figure(score.psnr_view());
        views["overall_psnr_raw"] = figure(score.psnr_raw());
        views["overall_ssim"] = figure(score.mean(|view| view.ssim));
        views["overall_flip"] = figure(score.mean(|view| view.flip));
        views
    };
    let light = &found.light;
    Ok(json!({
        "schema": SCHEMA,
        "version": 1,
        "title": input.title,
        "lumistack_version": input.version,
        "command": input.command,
        "psnr_zone": input.zone.and_then(|zone| zone.score.psnr()).map(figure),
        "psnr_zone_worst_tenth": input.zone.and_then(|zone| zone.score.worst_tenth()).map(figure),
        "zone": measured.zone.as_ref().zip(input.zone).map(|(looks, zone)| json!({
            "directions": zone.score.directions.iter().map(|direction| json!({
                "slope": direction.slope,
                "psnr": (direction.pixels > 0).then(|| figure(direction.psnr())),
                "pixels": direction.pixels,
            })).collect::<Vec<_>>(),
            "ssim": figure(looks.ssim.value()),
            "flip": figure(looks.flip.value()),
        })),
        "psnr_view": figure(measured.target.psnr_view()),
        "psnr_raw": figure(measured.target.psnr_raw()),
        "ssim": figure(measured.target.mean(|view| view.ssim)),
        "flip": figure(measured.target.mean(|view| view.flip)),
        "pixels_per_degree": figure(input.pixels_per_degree),
        "brightness": input.stack.brightness,
        "light": {
            "emitted": figure(light.emitted),
            "wanted": figure(light.wanted),
            "open": figure(light.open),
            "text": light.sentence(input),
        },
        "views": views(&measured.target),
        "held_out": measured.held_out.as_ref().map(others),
        "outside": measured.outside.as_ref().map(others),
        "limits": found.limits.iter().map(|limit| json!({
            "name": limit.name,
            "decibels": limit.decibels.map(figure),
            "text": limit.text,
            "figures": limit.figures,
        })).collect::<Vec<_>>(),
        "depth": input.depth.map(DepthBudget::to_json),
        "solution": input.solution.map(|solution| json!({
            "solver": solution.solver,
            "start": solution.start,
            "coarse_levels": solution.coarse_levels,
            "kkt_residual": figure(solution.kkt_residual),
            "levels": solution.levels.map(|[continuous, rounded, reoptimized]| json!({
                "continuous": figure(continuous),
                "rounded": figure(rounded),
                "reoptimized": figure(reoptimized),
            })),
        })),
        "convergence": input.convergence.iter().map(|it| json!({
            "iteration": it.iteration,
            "objective": figure(it.objective),
            "psnr_view": figure(it.psnr_view),
            "seconds": figure(it.seconds),
        })).collect::<Vec<_>>(),
        "reached": reached(input.convergence).iter().map(|line| json!({
            "seconds": figure(line.seconds),
            "iteration": line.iteration,
            "psnr_view": figure(line.psnr_view),
        })).collect::<Vec<_>>(),
        "denoising": input.denoising.map(|denoising| {
            let pair = |pair: [f64; 2]| pair.map(figure);
            let figures = |view: &DenoisedView| json!({
                "mean": figure(view.mean),
                "mean_change": pair(view.mean_change),
                "mse_before": pair(view.mse_before),
                "mse_after": pair(view.mse_after),
            });
            let mut value = figures(&denoising.overall);
            value["name"] = denoising.name.into();
            value["views"] = denoising.views.iter().map(figures).collect();
            value
        }),
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
        "outputs": input.outputs.iter().map(|o| json!({ "label": o.label, "path": o.path, "failed": o.failed })).collect::<Vec<_>>(),
    }))
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
        "psnr_view": table(&|view| score.view(view).error.psnr()),
        "ssim": table(&|view| score.view(view).ssim.value()),
        "flip": table(&|view| score.view(view).flip.value()),
        "counted_share": table(&|view| score.counted_share(view)),
    })
}
