//! `lumistack new`: writes a job file with comments, from three answers or options.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use lumistack_pipeline::{DisplayJob, PipelineError, Registry, presets, schema};
use serde_json::json;

use crate::console::{say, tell};
use crate::groups::DEFAULT_DISPLAY;
use crate::questions::{Questions, asks};

pub(crate) const EXAMPLES: &str = "Examples:\n  lumistack new      asks questions, and writes job.toml into this folder\n  lumistack new figurine/job.toml --scene figurine.glb --no-questions\n      asks nothing, and uses the default display and outputs\n\n\
    The command also writes job.schema.json next to the job file. Editors use this schema to complete and check keys. Existing files are never replaced.";

/// Default outputs.
const OUTPUTS: &str = "images,web_simulator";

#[derive(Debug, ClapArgs)]
pub(crate) struct New {
    /// The file to write
    #[arg(default_value = "job.toml")]
    pub(crate) file: PathBuf,
    /// Scene that the job renders: .gltf, .glb, USD, .blend, .obj, .ply, .spz, .sog or meta.json
    #[arg(long, value_name = "FILE")]
    pub(crate) scene: Option<PathBuf>,
    /// Display: a name that `lumistack displays` lists, or a display file [default:
    /// paper-three-layer]
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) display: Option<String>,
    /// Ids of the output plugins [default: images,web_simulator]
    #[arg(long, value_name = "ID,...", value_delimiter = ',')]
    pub(crate) outputs: Option<Vec<String>>,
    /// Use defaults instead of asking; --scene is required
    #[arg(long, conflicts_with = "questions")]
    pub(crate) no_questions: bool,
    /// Ask questions even if standard input is not a terminal
    #[arg(long)]
    pub(crate) questions: bool,
}

pub(crate) fn new_command(args: &New, registry: &Registry, json: bool) -> Result<(), PipelineError> {
    let asks = asks(args.questions, args.no_questions);
    let mut stdin = std::io::stdin().lock();
    let mut questions = Questions { command: "new", input: if asks { Some(&mut stdin) } else { None } };
    let text = job_text(args, registry, &mut questions)?;
    create(&args.file, &text)?.then_some(()).ok_or_else(|| taken(&args.file))?;
    let schema = args.file.with_file_name(SCHEMA);
    let rules = serde_json::to_string_pretty(&schema::job(registry)).expect("a schema is JSON");
    create(&schema, &format!("{rules}\n"))?;
    if json {
        say!("{}", json!({ "event": "done", "job": args.file.to_string_lossy() }));
    } else {
        say!("{}", args.file.display());
        tell!("next: {} run {}", crate::program::name(), args.file.display());
    }
    Ok(())
}

/// Name of the schema file next to the job file.
const SCHEMA: &str = "job.schema.json";

/// Writes a new file. Returns false if a file of this name exists.
fn create(path: &Path, text: &str) -> Result<bool, PipelineError> {
    let failed = |source| PipelineError::Write { path: path.to_owned(), source };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    match std::fs::File::create_new(path) {
        Ok(mut file) => file.write_all(text.as_bytes()).map(|()| true).map_err(failed),
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => Ok(false),
        Err(source) => Err(failed(source)),
    }
}

fn taken(file: &Path) -> PipelineError {
    PipelineError::value(file, "file", "a path without a file", "a file")
}

/// Makes the text of a job file from options and answers.
fn job_text(args: &New, registry: &Registry, ask: &mut Questions<'_>) -> Result<String, PipelineError> {
    // Report an existing file before the first question, so that no answers are lost.
    if args.file.exists() {
        return Err(taken(&args.file));
    }
    let is_scene = |path: &Path| path.is_file() && path.to_str().is_some();
    // Take scene, display and outputs from the options, otherwise from answers.
    let scene = ask.value("--scene", "Scene file", args.scene.clone(), None, |text| {
        Some(PathBuf::from(text)).filter(|path| is_scene(path))
    })?;
    if !is_scene(&scene) {
        let found = if scene.is_dir() { "a folder" } else { "no such file, or a name that is not UTF-8" };
        return Err(PipelineError::value(&scene, "--scene", "a scene file that exists and whose name is UTF-8", found));
    }
    let known = |text: &str| DisplayJob::by_name_or_path(text).resolve();
    let question = format!("Display, one of {}, or a display file", presets::names().collect::<Vec<_>>().join(", "));
    let default = Some((DEFAULT_DISPLAY.into(), DEFAULT_DISPLAY.to_owned()));
    let display = ask.value("--display", &question, args.display.clone(), default, |text| {
        known(text).is_ok().then(|| text.to_owned())
    })?;
    known(&display)?;
    let is_output = |id: &str| writers(registry).any(|(known, _)| known == id);
    let list = |text: &str| text.split(',').map(|id| id.trim().to_owned()).collect::<Vec<_>>();
    let question = format!(
        "Outputs, one or more of {}, separated by commas",
        writers(registry).map(|(id, _)| id).collect::<Vec<_>>().join(", ")
    );
    let default = Some((OUTPUTS.into(), list(OUTPUTS)));
    let outputs = ask.value("--outputs", &question, args.outputs.clone(), default, |text| {
        Some(list(text)).filter(|ids| ids.iter().all(|id| is_output(id)))
    })?;
    if let Some(other) = outputs.iter().find(|id| !is_output(id)) {
        let expected = writers(registry).map(|(id, _)| id).collect::<Vec<_>>().join(", ");
        return Err(PipelineError::value("new", "--outputs", format!("some of {expected}"), format!("`{other}`")));
    }
    // Paths in the job are relative to its folder.
    let folder = args.file.parent().unwrap_or(Path::new(""));
    let display = match DisplayJob::by_name_or_path(&display) {
        DisplayJob { preset: Some(name), .. } => format!("preset = {}", quoted(&name)),
        _ => format!("file = {}", quoted(&seen_from(folder, Path::new(&display)))),
    };
    let mut text = TEMPLATE.replace("{scene}", &quoted(&seen_from(folder, &scene))).replace("{display}", &display);
    for (id, doc) in outputs.iter().filter_map(|id| writers(registry).find(|(known, _)| known == id)) {
        let first = doc.split_inclusive(". ").next().unwrap_or(doc).trim();
        let _ = write!(text, "\n# {first}\n[[outputs]]\nplugin = {}\n", quoted(id));
        if id == "web_simulator" {
            // The output is named `preview`, as in runs of a scene without a job file. Without a
            // title, the page would show the job's name.
            let title = scene.file_stem().unwrap_or_default().to_string_lossy();
            let _ =
                write!(text, "name = \"preview\"\n# title of the page\nparams = {{ title = {} }}\n", quoted(&title));
        }
    }
    Ok(text)
}

/// Returns the ids and descriptions of the output plugins that write files.
fn writers(registry: &Registry) -> impl Iterator<Item = (&str, &str)> {
    let outputs = registry.infos().filter(|info| json!(info.kind) == "output" && !info.presents);
    outputs.map(|info| (info.id.as_str(), info.doc.as_str()))
}

/// Returns a path as a job file in `folder` must name it: relative to the folder if the file is
/// inside, otherwise absolute. An empty `folder` is the working folder, so the path does not
/// change.
fn seen_from(folder: &Path, path: &Path) -> String {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let seen = match (folder.as_os_str().is_empty(), absolute(path).strip_prefix(absolute(folder))) {
        (true, _) => path.to_owned(),
        (false, Ok(below)) => below.to_owned(),
        (false, Err(_)) => absolute(path),
    };
    seen.to_string_lossy().into_owned()
}

fn quoted(text: &str) -> String {
    // JSON escapes the text, since JSON's escapes are also valid in TOML.
    json!(text).to_string()
}

/// The text of a job file. A key with `#` before it is not set; its value is an example.
const TEMPLATE: &str = "#:schema ./job.schema.json
# Made by `lumistack new`. `lumistack run` with this file renders the scene and solves for the display's patterns. The same command continues a stopped run.
# Paths are relative to this file. docs/JOB.md explains every key. A line with `#` before a key is an example: the key has its default, until you remove the `#`.
scene = {scene}

[display]
{display}
# pixels of the light field, columns and rows: fewer pixels are solved faster, and the display keeps its size
#resolution = [420, 262]
# number of frames that the display shows in quick succession: more frames give a better picture
#frames = 6

[window]
# direction of the viewer, degrees to the right and up; without this key, the file's camera determines the view; without a camera, the scene is seen from the front, or from a side that shows much more
#look_from = [20.0, 10.0]
# \"auto\" brings the scene into the depths that the display shows sharply; \"off\" leaves depth as it is
#fit_depth = \"auto\"

[light]
# number of stops by which the picture is brighter; a number below 0 makes the picture darker
#exposure_ev = 0.0
#tone = \"auto\"

[render]
# paths per pixel, summed over all views: more paths give less noise, and take longer
#zone_samples = 800

[factorize]
# iterations of the solver
#iterations = 16
";

#[cfg(test)]
mod tests {
    use std::io::BufRead;

    use clap::Parser;
    use lumistack_pipeline::Job;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        new: New,
    }

    fn text_of(words: &[&str], answers: Option<&str>) -> Result<String, PipelineError> {
        let line = Line::parse_from([&["new"], words].concat());
        let mut input = answers.map(str::as_bytes);
        let mut ask = Questions { command: "new", input: input.as_mut().map(|input| input as &mut dyn BufRead) };
        job_text(&line.new, &Registry::built_in().unwrap(), &mut ask)
    }

    fn loaded(text: &str) -> Job {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("job.toml");
        std::fs::write(&file, text).unwrap();
        let job = Job::load(&file).unwrap();
        job.check().unwrap();
        job.resolve_display().unwrap();
        job
    }

    /// A name with characters that TOML escapes. Names on Windows have no double quotes.
    const NAME: &str = if cfg!(windows) { "a 'b'.glb" } else { "a \"b\".glb" };

    fn scene() -> (tempfile::TempDir, String) {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join(NAME);
        std::fs::write(&scene, "").unwrap();
        let text = scene.to_str().unwrap().to_owned();
        (folder, text)
    }

    #[test]
    fn answers_make_a_job_whose_commented_keys_are_keys_too() {
        let (_folder, scene) = scene();
        let answers = format!("nowhere.glb\n{scene}\nfig7-uniform\nimages, quilt\n");
        let text = text_of(&["no-such-job.toml"], Some(&answers)).unwrap();
        let job = loaded(&text);
        assert_eq!(job.scene.as_deref(), Some(Path::new(&scene)));
        assert_eq!(job.display.preset.as_deref(), Some("fig7-uniform"));
        assert_eq!(job.outputs.iter().map(|output| &output.plugin).collect::<Vec<_>>(), ["images", "quilt"]);
        let keys = text.lines().filter(|line| line.starts_with('#') && line.contains(" = ")).count();
        let all = loaded(
            &text
                .lines()
                .map(|line| match line.strip_prefix('#') {
                    Some(key) if !key.starts_with([' ', ':']) => format!("{key}\n"),
                    _ => format!("{line}\n"),
                })
                .collect::<String>(),
        );
        assert_eq!((keys, all.factorize.iterations, all.display.frames), (8, Some(16), Some(6)));
    }

    #[test]
    fn a_script_gives_the_scene_and_may_give_the_rest() {
        let (folder, scene) = scene();
        let file = folder.path().join("job.toml");
        let words = [file.to_str().unwrap(), "--scene", &scene, "--no-questions"];
        let text = text_of(&words, None).unwrap();
        let escaped = NAME.replace('"', "\\\"");
        assert!(text.contains(&format!("scene = \"{escaped}\"\n")), "{text}");
        let outputs = loaded(&text).outputs;
        let names: Vec<_> = outputs.iter().map(|output| output.name().to_owned()).collect();
        assert_eq!(names, ["images", "preview"]);
        // The scene's name is the page's title.
        let params: Vec<_> = outputs.iter().map(|output| json!(output.params)).collect();
        assert_eq!(params, [json!({}), json!({ "title": NAME.trim_end_matches(".glb") })]);
        for (words, message) in [
            (&["no-such-job.toml"][..], "--scene: expected a value for this option (Scene file"),
            (&["no-such-job.toml", "--scene", "no.glb"], "found no such file"),
            (&["no-such-job.toml", "--scene", &scene, "--display", "paper-tree-layer"], "paper-three-layer"),
            (&["no-such-job.toml", "--scene", &scene, "--outputs", "panels"], "found `panels`"),
        ] {
            let error = text_of(words, None).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        std::fs::write(&file, "mine").unwrap();
        assert!(text_of(&words, None).unwrap_err().to_string().contains("a path without a file"));
        assert!(!create(&file, "other").unwrap());
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");
    }
}
