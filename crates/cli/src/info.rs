//! `lumistack info`, `plugins` and `displays`.

use std::path::Path;

use lumistack_core::Task;
use lumistack_core::config::nearest;
use lumistack_display::{Backlight, Display};
use lumistack_pipeline::{
    ImporterJob, Job, LightJob, PipelineError, PoseJob, Prediction, Registry, SceneContents, describe_light_field,
    is_blend, is_usd, lacking, load_scene, needs_of, plugin_list, plugin_text, predict, presets, refused_outputs,
};
use lumistack_scene::{Bounds, Cloud, Scene};
use lumistack_usd::VariantSet;
use serde_json::{Value, json};

use crate::args::Info;
use crate::console::say;
use crate::groups::{
    DisplayArgs, FileArgs, GeometryArgs, RenderArgs, change_display, change_importer, change_render, geometry,
    job_or_scene,
};
use crate::values::size_text;

pub(crate) fn print(args: &Info, registry: &Registry, as_json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut value = describe(args, registry, task)?;
    if args.display.is_some() {
        value["on the display"] = on_display(args, registry, task)?;
    }
    if as_json {
        say!("{value}");
    } else {
        show(&value, 0);
    }
    Ok(())
}

/// Describes a scene, light field, layer stack, run folder, display or job as JSON, like `lumistack
/// info --json`. `path` may also be the name of a display preset.
///
/// # Errors
/// If the path cannot be read, or is none of these.
pub fn describe_path(path: &Path, registry: &Registry, task: Task<'_>) -> Result<Value, PipelineError> {
    let args = Info {
        file: path.to_owned(),
        display: None,
        camera: None,
        look_from: None,
        fit_depth: None,
        files: FileArgs::default(),
        geometry: GeometryArgs::default(),
    };
    describe(&args, registry, task)
}

fn describe(args: &Info, registry: &Registry, task: Task<'_>) -> Result<Value, PipelineError> {
    let path = args.file.as_path();
    let name = path.to_string_lossy();
    if !path.exists() && presets::PRESETS.iter().any(|(preset, _)| *preset == name) {
        return Ok(display(&presets::load(&name)?));
    }
    if !path.exists() && path.components().count() == 1 && path.extension().is_none() {
        let names = presets::PRESETS.iter().map(|(preset, _)| *preset);
        let near = nearest(&name, names).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        let expected = "a file, a folder or a display preset (`lumistack displays` lists the presets)";
        return Err(PipelineError::value(path, "input", expected, format!("nothing with this name{near}")));
    }
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match extension.as_str() {
        "gltf" | "glb" => scene(args, registry, task),
        _ if is_usd(path) || is_blend(path) => scene(args, registry, task),
        other if registry.importer_of(other).is_some() => scene(args, registry, task),
        "toml" => toml(path, registry, task),
        _ if path.join("layers/stack.json").is_file() => run_folder(path),
        _ if path.join("stack.json").is_file() => stack(path),
        _ => {
            if let Some(several) = several(path) {
                return Ok(several);
            }
            let description = describe_light_field(path, &geometry(&args.geometry), task)?;
            Ok(json!({ "light field": serde_json::to_value(description).expect("descriptions serialize") }))
        }
    }
}

fn scene(args: &Info, registry: &Registry, task: Task<'_>) -> Result<Value, PipelineError> {
    let path = args.file.as_path();
    // Describe only the file's own light: without `automatic`, no scene gets the studio light.
    let light = LightJob { automatic: false, ..LightJob::default() };
    let mut importer = ImporterJob::default();
    change_importer(&mut importer, &args.files);
    let ingested = load_scene(path, &PoseJob::default(), &importer, registry, &light, None, task)?;
    let contents = ingested.contents(path, &importer, registry, task)?;
    let scene = &ingested.scene;
    let bounds = scene.bounds();
    let texels: usize = scene.images.iter().map(|image| image.width * image.height).sum();
    let mut value = json!({ "scene": {
        "file": path.to_string_lossy(),
        "triangles": scene.triangle_count(),
        "splats": splats(scene),
        "meshes": scene.meshes.len(),
        "instances": scene.instances.len(),
        "materials": scene.materials.iter().map(|material| material.name.as_str()).collect::<Vec<_>>(),
        "images": format!("{} ({:.1} megapixels)", scene.images.len(), texels as f64 / 1e6),
        "punctual lights": scene.lights.len(),
        "emissive materials": scene.materials.iter().filter(|material| material.is_emissive()).count(),
        "environment": scene.environment.is_some(),
        "cameras": scene.cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>(),
        "bounds min": bounds.min.to_array(),
        "bounds max": bounds.max.to_array(),
    }});
    let lacking = lacking(path, scene.cameras.is_empty(), !scene.is_lit() && !scene.instances.is_empty());
    if !lacking.is_empty() {
        value["scene"]["lacking"] = json!(lacking);
    }
    let choices = choices(&contents);
    if let (Some(value), Some(choices)) = (value["scene"].as_object_mut(), choices.as_object()) {
        value.extend(choices.clone());
    }
    Ok(value)
}

/// Describes the splats: number, degree of spherical harmonics, bounds and memory; null if there
/// are none.
fn splats(scene: &Scene) -> Value {
    if scene.placed_clouds.is_empty() {
        return Value::Null;
    }
    let mut all = Bounds::EMPTY;
    scene.splat_positions().for_each(|at| all.include(at));
    let bytes: usize = scene.clouds.iter().map(Cloud::bytes).sum();
    json!({
        "count": scene.splat_count(),
        "clouds": scene.placed_clouds.len(),
        "degree of harmonics": scene.clouds.iter().map(|cloud| cloud.degree).max(),
        "colours": scene.clouds.first().map(|cloud| format!("{:?}", cloud.encoding)),
        "bounds with stray splats min": all.min.to_array(),
        "bounds with stray splats max": all.max.to_array(),
        "memory": format!("{:.1} MB", bytes as f64 / 1e6),
    })
}

/// Lists the animations, variants and similar choices that a scene offers to a job.
fn choices(contents: &SceneContents) -> Value {
    match contents {
        SceneContents::Gltf(contents) => {
            let animation = |(name, end_s): &(String, f32)| format!("{name} ({end_s:.2} s)");
            json!({
                "animations": contents.animations.iter().map(animation).collect::<Vec<_>>(),
                "variants": contents.variants,
            })
        }
        SceneContents::Blend(contents) => {
            let [first, last] = contents.frames;
            let rate = contents.frames_per_second;
            json!({
                "frames": format!("{first} to {last} at {rate} per second ({:.2} s)", contents.duration_s()),
                "scenes": contents.scenes,
                "engine": contents.engine,
                "not supported by the path tracer": contents.lost,
            })
        }
        SceneContents::Usd(contents) => {
            let variant_set = |set: &VariantSet| {
                let selected = if set.selected.is_empty() { "none" } else { &set.selected };
                format!("{}: {} of {}", set.place, selected, set.choices.join(", "))
            };
            let time_range = contents.time_range.map(|range| {
                let [first, last] = range.time_codes;
                let rate = range.time_codes_per_second;
                format!("{first} to {last} at {rate} per second ({:.2} s)", range.duration_s())
            });
            json!({
                "time codes": time_range,
                "variant sets": contents.variant_sets.iter().map(variant_set).collect::<Vec<_>>(),
                "prims": contents.prims,
            })
        }
    }
}

/// Compares a scene's depth with a display's depth of field, and measures the scene's memory.
fn on_display(args: &Info, registry: &Registry, task: Task<'_>) -> Result<Value, PipelineError> {
    let mut job = job_or_scene(&args.file)?;
    let display = DisplayArgs { display: args.display.clone(), ..DisplayArgs::default() };
    change_display(&mut job, &display);
    let (camera, fit_depth) = (args.camera.clone(), args.fit_depth.clone());
    let look_from = args.look_from;
    let files = args.files.clone();
    change_render(&mut job, &RenderArgs { camera, fit_depth, look_from, files, ..RenderArgs::default() });
    let Prediction { depth, coverage, memory } = predict(&job, registry, task)?;
    let mut figures = depth.to_json();
    if let Some(figures) = figures.as_object_mut() {
        // Histograms are too long for this list; report.json of a run has them.
        figures.retain(|key, _| !key.ends_with("histogram"));
    }
    let megabytes = |bytes: usize| format!("{:.1} MB", bytes as f64 / 1e6);
    Ok(json!({
        "display": args.display.as_ref().map(|display| display.to_string_lossy()),
        "depth budget": depth.sentence(),
        "advice": depth.advice(),
        "depth": figures,
        "covered share of the window": coverage,
        "memory": {
            "in all": megabytes(memory.bytes()),
            "meshes and images": megabytes(memory.scene_bytes),
            "coarser levels of images": megabytes(memory.texture_bytes),
            "tree": megabytes(memory.tree_bytes),
            "corners and transforms": megabytes(memory.geometry_bytes),
            "triangles": memory.triangles,
            "triangles kept": memory.unique_triangles,
        },
    }))
}

fn toml(path: &Path, registry: &Registry, task: Task<'_>) -> Result<Value, PipelineError> {
    let job = match Job::load(path) {
        Ok(job) => job,
        Err(job_error) => {
            // The file is no valid job, so try to read it as a display. If this fails too, return
            // one of the two errors: the display's if the file has [[layers]], otherwise the job's.
            return match presets::load_file(path) {
                Ok(found) => Ok(display(&found)),
                Err(display_error) => {
                    let text = lumistack_files::read_text(path).unwrap_or_default();
                    Err(if text.contains("[[layers]]") { display_error } else { job_error })
                }
            };
        }
    };
    let resolved = job.resolve_display()?;
    let refused: Vec<Value> = match refused_outputs(&job, registry, task) {
        Ok(refused) => refused.iter().map(|output| format!("{}: {}", output.name, output.reason).into()).collect(),
        // A job may name input files that do not exist yet. So an error becomes a note, unless the
        // user has cancelled.
        Err(PipelineError::Cancelled) => return Err(PipelineError::Cancelled),
        Err(error) => vec![format!("not checked: {error}").into()],
    };
    let mut value =
        json!({ "job": serde_json::to_value(&job).expect("jobs serialize"), "display": display(&resolved)["display"] });
    if let Some([memory, disk]) = needs_of(&job) {
        value["memory of a run"] = format!("at most {}", size_text(memory)).into();
        // A sequence or a sweep needs disk space for all its time steps or designs. `run --plan`
        // and `sweep --plan` print the sum.
        if job.sequence.is_none() && job.sweep.is_none() {
            value["disk space of a run"] = format!("about {}", size_text(disk)).into();
        }
    }
    if !refused.is_empty() {
        value["outputs that a run would refuse"] = refused.into();
    }
    Ok(value)
}

fn display(display: &Display) -> Value {
    let backlight = match &display.backlight {
        Backlight::Uniform => json!("uniform"),
        Backlight::Lenslets(lenslets) => serde_json::to_value(lenslets).expect("backlights serialize"),
    };
    let size = display.field_pixels().size_mm();
    let name = |value: serde_json::Result<Value>| value.expect("names serialize");
    json!({ "display": {
        "name": display.name,
        "formation": name(serde_json::to_value(display.formation)),
        "frames": display.frames,
        "colour sequence": name(serde_json::to_value(display.colour_sequence)),
        "refresh": format!("{} Hz; all frames are shown {:.1} times per second", display.refresh_hz, display.period_hz()),
        "flicker": display.flicker_warning(),
        "brightness": display.brightness,
        "light field": format!(
            "{} × {} pixels of {} mm ({:.1} × {:.1} mm)",
            display.field.resolution[0], display.field.resolution[1], display.field.pitch_mm, size[0], size[1]
        ),
        "views": format!(
            "{} × {} over {}° × {}°, {}",
            display.views()[0], display.views()[1], display.field.fov_deg[0], display.field.fov_deg[1],
            name(serde_json::to_value(display.field.projection)).as_str().unwrap_or_default()
        ),
        "layers": display.layers.iter().map(|layer| format!(
            "z = {} mm: {} × {} pixels of {} mm", layer.d_mm, layer.resolution[0], layer.resolution[1], layer.pitch_mm
        )).collect::<Vec<_>>(),
        "backlight": backlight,
    }})
}

fn run_folder(path: &Path) -> Result<Value, PipelineError> {
    let run = lumistack_pipeline::RunFolder::open(path)?;
    let mut value = json!({ "run folder": path.display().to_string(), "display": display(&run.display)["display"] });
    if let Ok(text) = std::fs::read(path.join("report.json"))
        && let Ok(report) = serde_json::from_slice::<Value>(&text)
    {
        value["result"] = json!({
            "title": report["title"], "psnr_view": report["psnr_view"], "psnr_raw": report["psnr_raw"],
            "psnr over the zone": report["psnr_zone"],
            "psnr in between": report["held_out"]["overall_psnr_view"],
            "psnr outside": report["outside"]["overall_psnr_view"], "ssim": report["ssim"], "flip": report["flip"],
            "command": report["command"],
        });
    }
    Ok(value)
}

/// Describes the folder of a sequence, or of a run with several displays, by its report. `None` if
/// the folder has no such report.
fn several(path: &Path) -> Option<Value> {
    let text = lumistack_files::read_text(&path.join("report.json")).ok()?;
    let report: Value = serde_json::from_str(&text).ok()?;
    if !["lumistack/sequence-report", "lumistack/graph-report"].iter().any(|schema| report["schema"] == *schema) {
        return None;
    }
    let of_parts = |key: &str, name: &str| -> Vec<Value> {
        let parts = report[key].as_array().into_iter().flatten();
        parts.map(|part| json!({ "name": part[name], "psnr_view": part["psnr_view"], "psnr over the zone": part["psnr_zone"] })).collect()
    };
    let mut result = json!({
        "title": report["title"], "psnr_view": report["psnr_view"], "psnr over the zone": report["psnr_zone"],
        "flicker": report["psnr_change"], "command": report["command"],
    });
    for (key, name, text) in [("times", "name", "time steps"), ("nodes", "id", "displays")] {
        let parts = of_parts(key, name);
        if !parts.is_empty() {
            result[text] = parts.into();
        }
    }
    // With several displays, the scores of the whole report are those of the first display, so they
    // are omitted.
    if !result["displays"].is_null() {
        for key in ["psnr_view", "psnr over the zone", "flicker", "time steps"] {
            result[key] = Value::Null;
        }
    }
    Some(json!({ "run folder": path.display().to_string(), "result": result }))
}

fn stack(path: &Path) -> Result<Value, PipelineError> {
    let index = lumistack_field_io::read_stack_index(path).map_err(PipelineError::Field)?;
    Ok(json!({ "layer stack": serde_json::to_value(index).expect("indices serialize") }))
}

/// Prints keys with their values, nested by indentation.
fn show(value: &Value, depth: usize) {
    let margin = "  ".repeat(depth);
    let Value::Object(map) = value else {
        say!("{margin}{}", short(value));
        return;
    };
    for (key, value) in map {
        let key = key.replace('_', " ");
        match value {
            Value::Null => {}
            Value::Object(inner) if !inner.is_empty() => {
                say!("{margin}{key}");
                show(value, depth + 1);
            }
            Value::Array(items) if items.iter().any(|item| item.is_object() || item.is_string()) => {
                say!("{margin}{key}: {}", items.len());
                items.iter().for_each(|item| match item {
                    Value::Object(_) => {
                        say!("{margin}  -");
                        show(item, depth + 2);
                    }
                    _ => say!("{margin}  {}", short(item)),
                });
            }
            _ => say!("{margin}{key}: {}", short(value)),
        }
    }
}

fn short(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Number(number) if number.is_f64() => {
            let number = number.as_f64().unwrap_or(f64::NAN);
            let text = format!("{number:.4}");
            text.trim_end_matches('0').trim_end_matches('.').to_string()
        }
        Value::Array(items) => format!("[{}]", items.iter().map(short).collect::<Vec<_>>().join(", ")),
        Value::Bool(yes) => if *yes { "yes" } else { "no" }.into(),
        other => other.to_string(),
    }
}

pub(crate) fn print_plugins(ids: &[String], registry: &Registry, as_json: bool) -> Result<(), PipelineError> {
    if as_json {
        say!("{}", plugin_list(registry, ids)?);
    } else {
        say!("{}", plugin_text(registry, ids)?);
    }
    Ok(())
}

pub(crate) fn print_displays(as_json: bool) -> Result<(), PipelineError> {
    for (name, text) in presets::PRESETS {
        if as_json {
            say!("{}", json!({ "name": name, "display": presets::load(name)? }));
        } else {
            // The first line of the file is a comment that describes the display.
            say!("{name:28} {}", text.lines().next().unwrap_or_default().trim_start_matches("# "));
        }
    }
    Ok(())
}
