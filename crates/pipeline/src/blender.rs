//! Scenes that Blender hands over, kept between runs, and views that the engine of a `.blend` file renders instead of our path tracer.

use std::path::{Path, PathBuf};

use glam::DVec3;
use lumistack_core::Task;
use lumistack_display::{FieldGeometry, Projection};
use lumistack_field_io::picture::Picture;
use lumistack_scene::Window;
use lumistack_usd::{BlendAccount, BlendContents, BlendViews, BlendWindow, HandedOver};
use serde::{Deserialize, Serialize};

use crate::cache::KeyBuilder;
use crate::code;
use crate::error::{PipelineError, field_error};
use crate::files::{read_json, write, write_json};
use crate::ingest::{Ingested, hash, is_blend};
use crate::job::{Background, Engine, Job, RenderJob};
use crate::sealed;

/// Who renders the views of a job: who is asked for, else our path tracer, or the file's own engine where a `.blend` file has what the hand-over loses and
/// that engine can render here. Says what is lost, or why which engine is taken.
/// `variance` of the views is known of our path tracer alone.
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

/// `plain`: whether nothing is wanted that only our path tracer gives.
fn chosen(
    render: &RenderJob,
    plain: bool,
    losing: Option<&BlendContents>,
    is_file: bool,
    name: &str,
    task: Task<'_>,
) -> Engine {
    let Some(contents) = losing else {
        return if render.engine == Engine::Blender { Engine::Blender } else { Engine::Lumistack };
    };
    let why_not = match render.engine {
        Engine::Blender => return Engine::Blender,
        Engine::Lumistack => Some("`render.engine = \"lumistack\"` asks for our path tracer all the same".to_owned()),
        Engine::Auto if !plain => Some(
            "`angular_filter`, `lens_deg`, `denoise`, `clamp`, `background` and variance need our path tracer all the same"
                .to_owned(),
        ),
        Engine::Auto if !is_file => {
            Some("only a job with the .blend file as its scene can be rendered by its own engine".to_owned())
        }
        Engine::Auto => {
            contents.unfit.as_ref().map(|reason| format!("the file's own engine cannot render it here ({reason})"))
        }
    };
    let Some(reason) = why_not else {
        let engine = &contents.engine;
        let lost = contents.lost.join("; ");
        task.warn(
            name,
            format!("the file's own engine, {engine}, renders the views, since the scene has {lost}. `render.engine = \"lumistack\"` does without"),
        );
        return Engine::Blender;
    };
    for lost in &contents.lost {
        task.warn(name, format!("the scene has {lost}"));
    }
    task.warn(name, reason);
    Engine::Lumistack
}

/// Renders views of the job's scene, each to its file as soon as it is finished.
///
/// # Errors
/// When the scene is no `.blend` file, Blender fails, a picture cannot be kept, or when cancelled.
pub(crate) fn render(
    job: &Job,
    window: &Window,
    geometry: &FieldGeometry,
    wanted: &[([usize; 2], &Path)],
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let Some(scene) = job.scene.as_deref().filter(|scene| is_blend(scene)) else {
        let found = job.scene.as_ref().map_or_else(|| "no scene".into(), |scene| scene.display().to_string());
        return Err(PipelineError::value("job", "render.engine", "a .blend file as the scene for `blender`", found));
    };
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

/// A hand-over that was kept: what it was made from, each file with a hash of its content.
#[derive(Serialize, Deserialize)]
struct Kept {
    account: BlendAccount,
    files: Vec<(PathBuf, String)>,
    program: Option<[u64; 2]>,
    glb: String,
    /// Of the code that asks for it and reads it: no other program takes it up.
    code: String,
}

fn code_of_scenes() -> String {
    KeyBuilder::new("scenes", code::SCENE).finish()
}

/// Whether a kept file (`blend-KEY.json` or `.glb`) belongs to a hand-over that a run would take up.
pub(crate) fn holds(path: &Path) -> bool {
    read_json::<Kept>(&path.with_extension("json")).is_some_and(|kept| kept.holds())
}

impl Kept {
    /// Whether Blender would hand over the same again.
    fn holds(&self) -> bool {
        self.code == code_of_scenes()
            && self.program.is_some()
            && self.program == lumistack_usd::file_stamp(&self.account.program)
            && self.account.missing.iter().all(|path| !path.exists())
            && self.files.iter().all(|(path, content)| content_of(path).as_ref() == Some(content))
    }
}

fn content_of(path: &Path) -> Option<String> {
    lumistack_files::read(path).ok().map(|bytes| hash(&bytes))
}

/// The scene of a `.blend` file at a time. With a folder it is kept there, and Blender is not asked again while the file, what it reads, Blender itself and
/// what we run in it are the same.
///
/// # Errors
/// When Blender hands nothing over, or what it does cannot be kept.
pub(crate) fn hand_over(
    path: &Path,
    time_s: Option<f64>,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<HandedOver, PipelineError> {
    let ask = || lumistack_usd::hand_over(path, time_s, task).map_err(PipelineError::from);
    let handed = match cache_dir {
        Some(folder) => kept_or(ask, path, time_s, &lumistack_usd::blend_surroundings(), folder)?,
        None => ask()?,
    };
    handed.account.warnings.iter().for_each(|(place, text)| task.warn(place, text));
    Ok(handed)
}

fn kept_or(
    ask: impl FnOnce() -> Result<HandedOver, PipelineError>,
    path: &Path,
    time_s: Option<f64>,
    surroundings: &str,
    folder: &Path,
) -> Result<HandedOver, PipelineError> {
    let mut key = KeyBuilder::new("blend", code::SCENE);
    let place = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    key.add("path", place.as_os_str().as_encoded_bytes()).add_json("time", &time_s);
    let key = key.add("surroundings", surroundings.as_bytes()).finish();
    let [stamp, file] = ["json", "glb"].map(|kind| folder.join(format!("blend-{}.{kind}", &key[..16])));
    if let Some(kept) = read_json::<Kept>(&stamp).filter(Kept::holds)
        && let Ok(glb) = std::fs::read(&file)
        && hash(&glb) == kept.glb
    {
        return Ok(HandedOver { glb, account: kept.account });
    }
    let before = content_of(&place);
    let handed = ask()?;
    let HandedOver { glb, account } = &handed;
    let all = [std::slice::from_ref(&place), &account.files[..]].concat();
    let files: Option<Vec<_>> = all.into_iter().map(|path| Some((path.clone(), content_of(&path)?))).collect();
    // a file that was saved meanwhile, or is gone, makes no kept result
    if let Some(files) = files.filter(|files| account.untracked.is_none() && Some(&files[0].1) == before.as_ref()) {
        let program = lumistack_usd::file_stamp(&account.program);
        let kept = Kept { account: account.clone(), files, program, glb: hash(glb), code: code_of_scenes() };
        std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
        write(&file, glb)?;
        write_json(&stamp, &kept)?;
    }
    Ok(handed)
}

fn keep(picture: &Path, geometry: &FieldGeometry, path: &Path) -> Result<(), PipelineError> {
    let size = [geometry.cols, geometry.rows];
    let read = Picture::read(picture).map_err(field_error)?;
    if read.size() != size {
        let [cols, rows] = size;
        let [found_cols, found_rows] = read.size();
        let expected = format!("{cols} × {rows} pixels from Blender");
        return Err(PipelineError::value(path, "view", expected, format!("{found_cols} × {found_rows}")));
    }
    sealed::write_picture(path, size, &read.into_linear())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::{Cancel, Collector};

    use crate::job::Denoise;

    #[test]
    fn files_with_what_our_path_tracer_cannot_show_are_rendered_by_their_own_engine() {
        let plain = BlendContents { engine: "CYCLES".into(), ..BlendContents::default() };
        let fur = BlendContents { lost: vec!["hair that our path tracer leaves out: Dog".into()], ..plain.clone() };
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
            (asked(Engine::Lumistack), Some(&fur), true, Engine::Lumistack, &["Dog", "all the same"]),
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

    /// How often Blender is asked for two hand-overs, between which something happens.
    fn asked(untracked: Option<String>, between: impl FnOnce(&Path)) -> usize {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["szene.blend", "wood.png", "blender"] {
            std::fs::write(place(name), name).unwrap();
        }
        let account = BlendAccount {
            program: place("blender"),
            files: vec![place("wood.png")],
            missing: vec![place("gone.png")],
            untracked,
            ..BlendAccount::default()
        };
        let mut count = 0;
        let mut hand_over = |time_s, surroundings: &str| {
            let ask = || {
                count += 1;
                Ok(HandedOver { glb: format!("{time_s:?}").into_bytes(), account: account.clone() })
            };
            kept_or(ask, &place("szene.blend"), time_s, surroundings, &place("cache")).unwrap()
        };
        let first = hand_over(Some(0.5), "one");
        between(folder.path());
        let second = hand_over(Some(0.5), "one");
        assert_eq!((first.glb, first.account), (second.glb, second.account));
        // another time and another Blender are other hand-overs
        let (late, other) = (hand_over(Some(1.0), "one"), hand_over(Some(0.5), "two"));
        assert_eq!((late.glb, other.glb), (b"Some(1.0)".to_vec(), b"Some(0.5)".to_vec()));
        count - 2
    }

    #[test]
    fn blender_is_asked_again_when_something_has_changed() {
        let write =
            |name: &'static str| move |folder: &Path| std::fs::write(folder.join(name), "another content").unwrap();
        assert_eq!(asked(None, |_| ()), 1);
        for name in ["szene.blend", "wood.png", "blender", "gone.png"] {
            assert_eq!(asked(None, write(name)), 2, "{name}");
        }
        assert_eq!(asked(None, |folder| std::fs::remove_file(folder.join("wood.png")).unwrap()), 2);
        let damage = |folder: &Path| {
            for file in std::fs::read_dir(folder.join("cache")).unwrap().flatten() {
                if file.path().extension().is_some_and(|kind| kind == "glb") {
                    std::fs::write(file.path(), "half").unwrap();
                }
            }
        };
        assert_eq!(asked(None, damage), 2);
        assert_eq!(asked(Some("waves: a sequence of files".into()), |_| ()), 2);
    }
}
