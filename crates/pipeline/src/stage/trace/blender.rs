//! Views that the engine of a `.blend` file renders instead of our path tracer.

use std::path::Path;

use glam::DVec3;
use lumistack_core::Task;
use lumistack_display::{FieldGeometry, Projection};
use lumistack_field_io::picture::Picture;
use lumistack_scene::Window;
use lumistack_usd::{BlendContents, BlendViews, BlendWindow};

use crate::error::{PipelineError, field_error};
use crate::job::{Background, Engine, Job, RenderJob};
use crate::reader::is_blend;
use crate::stage::ingest::Ingested;
use crate::store::views::write_picture;

/// Chooses the renderer of a job's views. If the conversion of a `.blend` file loses features,
/// warnings state these features and the reason for the choice, unless the job names `blender`.
///
/// If the job names an engine, that engine renders. With `auto`, the engine of the job's `.blend`
/// file renders if three conditions hold. The conversion loses features of the scene. The file's
/// engine works on this machine. The job needs no feature that only our path tracer has, such as
/// the `variance` of views. In all other cases our path tracer renders.
pub(crate) fn engine(job: &Job, ingested: &Ingested, variance: bool, task: Task<'_>) -> Engine {
    let is_file = job.scene.as_deref().is_some_and(is_blend);
    chosen(
        &job.render,
        job.render.is_plain() && job.light.background == Background::Environment && !variance,
        ingested.blend().filter(|contents| !contents.lost.is_empty()),
        is_file,
        &ingested.scene.name,
        task,
    )
}

/// Chooses the renderer without reading files. `plain` is true if the job needs no feature that
/// only our path tracer has.
fn chosen(
    render: &RenderJob,
    plain: bool,
    losing: Option<&BlendContents>,
    is_file: bool,
    name: &str,
    task: Task<'_>,
) -> Engine {
    // If the conversion loses no features, our path tracer renders, unless the job requests
    // Blender.
    let Some(contents) = losing else {
        return if render.engine == Engine::Blender { Engine::Blender } else { Engine::Lumistack };
    };
    // Find a reason against the file's own engine.
    let why_not = match render.engine {
        Engine::Blender => return Engine::Blender,
        Engine::Lumistack => Some("`render.engine = \"lumistack\"` requests our path tracer".to_owned()),
        Engine::Auto if !plain => Some(
            "our path tracer renders the views, since the job uses `angular_filter`, `lens_deg`, `denoise`, `clamp`, `background` or variance"
                .to_owned(),
        ),
        Engine::Auto if !is_file => {
            Some("the file's own engine can render only a job whose scene is the .blend file".to_owned())
        }
        Engine::Auto => contents
            .unfit
            .as_ref()
            .map(|reason| format!("the file's own engine cannot render on this machine ({reason})")),
    };
    // If there is no reason against the file's own engine, that engine renders. Otherwise our path
    // tracer renders the converted scene, and the lost features are reported.
    let Some(reason) = why_not else {
        let engine = &contents.engine;
        let lost = contents.lost.join("; ");
        task.warn(
            name,
            format!("the file's own engine, {engine}, renders the views, since the scene has {lost}. `render.engine = \"lumistack\"` selects our path tracer, which omits or simplifies that content"),
        );
        return Engine::Blender;
    };
    for lost in &contents.lost {
        task.warn(name, format!("the scene has {lost}"));
    }
    task.warn(name, reason);
    Engine::Lumistack
}

/// Renders views of the job's scene in Blender. Each file is written as soon as its view is
/// finished.
///
/// # Errors
/// If the scene is not a `.blend` file, Blender fails, a picture cannot be written, or the task is
/// cancelled.
pub(crate) fn render(
    job: &Job,
    window: &Window,
    geometry: &FieldGeometry,
    wanted: &[([usize; 2], &Path)],
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let Some(scene) = job.scene.as_deref().filter(|scene| is_blend(scene)) else {
        let found = job.scene.as_ref().map_or_else(|| "no scene".into(), |scene| scene.display().to_string());
        return Err(PipelineError::job("render.engine", "a .blend file as the scene for `blender`", found));
    };
    // Blender needs the window as a coordinate frame for its cameras, and the slopes of the views.
    let map = window.scene_from_display;
    let views = BlendViews {
        window: BlendWindow {
            centre: map.translation.to_array(),
            forward: (map.rotation * DVec3::NEG_Z).to_array(),
            up: (map.rotation * DVec3::Y).to_array(),
            width: map.scale * window.size_mm[0],
        },
        size_mm: window.size_mm,
        resolution: [geometry.cols, geometry.rows],
        distance_mm: match geometry.grid.projection {
            Projection::Oblique => None,
            Projection::Perspective { distance_mm } => Some(distance_mm),
        },
        slopes: wanted.iter().map(|(view, _)| geometry.grid.slope_at(*view, [0.0, 0.0])).collect(),
    };
    // Keep each picture immediately, so that a stopped run continues.
    let mut failed = None;
    let mut finished = |number: usize, picture: &Path| {
        if let Err(error) = keep(picture, geometry, wanted[number].1) {
            failed.get_or_insert(error);
        }
        task.progress.advance(1, "");
    };
    task.progress.begin("render in Blender", wanted.len() as u64, "views");
    let result = lumistack_usd::render_views(scene, job.pose.time_s, &views, &mut finished, task);
    task.progress.end();
    if let Some(error) = failed {
        return Err(error);
    }
    result.map_err(PipelineError::from)
}

fn keep(picture: &Path, geometry: &FieldGeometry, path: &Path) -> Result<(), PipelineError> {
    let size = [geometry.cols, geometry.rows];
    let read = Picture::read(picture).map_err(field_error)?;
    if read.size() != size {
        let [cols, rows] = size;
        let [found_cols, found_rows] = read.size();
        let expected = format!("{cols} × {rows} pixels from Blender");
        return Err(PipelineError::value(path, "view", expected, format!("{found_cols} × {found_rows} pixels")));
    }
    write_picture(path, size, &read.into_linear())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::{Cancel, Collector};

    use crate::job::Denoise;

    #[test]
    fn files_with_what_our_path_tracer_cannot_show_are_rendered_by_their_own_engine() {
        let plain = BlendContents { engine: "CYCLES".into(), ..BlendContents::default() };
        let fur =
            BlendContents { lost: vec!["hair that Lumistack's path tracer leaves out: Dog".into()], ..plain.clone() };
        let no_screen = BlendContents { unfit: Some("EEVEE needs OpenGL".into()), ..fur.clone() };
        let asked = |engine| RenderJob { engine, ..RenderJob::default() };
        let denoised = RenderJob { denoise: Denoise::Guided, ..RenderJob::default() };
        type Case<'a> = (RenderJob, Option<&'a BlendContents>, bool, Engine, &'a [&'a str]);
        let cases: [Case<'_>; 9] = [
            (asked(Engine::Auto), None, true, Engine::Lumistack, &[]),
            (asked(Engine::Auto), Some(&fur), true, Engine::Blender, &["own engine, CYCLES", "Dog"]),
            (asked(Engine::Auto), Some(&fur), false, Engine::Lumistack, &["Dog", "only a job"]),
            (asked(Engine::Auto), Some(&no_screen), true, Engine::Lumistack, &["Dog", "EEVEE needs OpenGL"]),
            (denoised, Some(&fur), true, Engine::Lumistack, &["Dog", "`denoise`"]),
            (asked(Engine::Lumistack), Some(&fur), true, Engine::Lumistack, &["Dog", "requests our path tracer"]),
            (asked(Engine::Lumistack), None, true, Engine::Lumistack, &[]),
            (asked(Engine::Blender), Some(&fur), true, Engine::Blender, &[]),
            (asked(Engine::Blender), None, true, Engine::Blender, &[]),
        ];
        for (render, losing, is_file, expected, words) in cases {
            let (warnings, cancel) = (Collector::default(), Cancel::default());
            let found =
                chosen(&render, render.is_plain(), losing, is_file, "dog.blend", Task::quiet(&warnings, &cancel));
            let said: String = warnings.take().into_iter().map(|warning| warning.message + "\n").collect();
            assert_eq!(found, expected, "{render:?}: {said}");
            assert!(words.iter().all(|word| said.contains(word)) && said.is_empty() == words.is_empty(), "{said}");
        }
    }
}
