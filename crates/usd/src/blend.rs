//! `.blend` files, read by the user's Blender.
//!
//! ```text
//! .blend file ─▶ child: Blender, or a Python with bpy ─▶ scene.glb ─▶ the glTF reader
//! ```
//!
//! Blender itself opens the file, so every file that it can open is read. `scene.glb` also contains
//! lights, cameras and the world. Blender runs `python/blend.py` and modules of the Python package
//! that the Blender extension also uses. `docs/BLENDER.md` lists the contents of an export.

use std::env::var_os;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use lumistack_core::{Cancel, Task};
use serde::{Deserialize, Serialize};

use crate::UsdError;
use crate::child::{last_lines, read_end, wait};
use crate::python::{Candidate, Surroundings, on_path};

/// Extension of Blender's files.
pub const EXTENSION: &str = "blend";
/// Environment variable that names the only Blender that is tried: the program, or a Python with
/// the module bpy.
pub const VARIABLE: &str = "LUMISTACK_BLENDER";

/// Python modules that run in Blender, in the order of their imports. The Python package has them
/// as `lumistack.blender`.
const MODULES: [(&str, &str); 5] = [
    ("cameras", include_str!("../blender/cameras.py")),
    ("glb", include_str!("../blender/glb.py")),
    ("rig", include_str!("../blender/rig.py")),
    ("unshown", include_str!("../blender/unshown.py")),
    ("handover", include_str!("../blender/handover.py")),
];
/// The script that starts [`MODULES`] in Blender.
const BOOT: &str = include_str!("../python/blend.py");

/// The scenes and the animation of a `.blend` file, and the content that an export drops.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BlendContents {
    /// Names of the file's scenes. An export reads the active scene.
    pub scenes: Vec<String>,
    /// First and last frame of the active scene.
    pub frames: [i32; 2],
    /// Frames per second of the active scene.
    pub frames_per_second: f64,
    /// Name of the render engine that the active scene uses.
    pub engine: String,
    /// Messages for the user about content that renders show but the export drops. There is one
    /// message per kind of content, with the names of the objects.
    pub lost: Vec<String>,
    /// The reason why the scene's engine cannot render on this machine. `None` if the engine can
    /// render, if the export drops nothing, or if the caller requested views or only the contents.
    pub unfit: Option<String>,
}

impl BlendContents {
    /// Returns the time from the first frame to the last, in seconds.
    pub fn duration_s(&self) -> f64 {
        f64::from(self.frames[1] - self.frames[0]) / self.frames_per_second
    }
}

/// A scene that Blender exported.
#[derive(Debug)]
pub struct HandedOver {
    /// A binary glTF file that refers to no other file.
    pub glb: Vec<u8>,
    /// Blender's report on the export of this scene.
    pub account: BlendAccount,
}

/// Blender's report on an exported scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BlendAccount {
    /// Version of the Blender that exported the scene.
    pub blender: String,
    /// Path of the Blender program, or of the module bpy.
    pub program: PathBuf,
    /// Files other than the `.blend` on which the scene depends: libraries, pictures.
    pub files: Vec<PathBuf>,
    /// Files to which the scene refers, but which do not exist.
    pub missing: Vec<PathBuf>,
    /// Description of an input of the scene that is not in `files`, so that its changes cannot be
    /// detected. `None` if all inputs are files.
    pub untracked: Option<String>,
    /// Content that could not be exported: place and message.
    pub warnings: Vec<(String, String)>,
    /// The file's scenes and animation, and the content that the export drops.
    pub contents: BlendContents,
}

/// Exports a file's scene in Blender. The time is in seconds after the scene's first frame; `None`
/// stands for the saved frame. The warnings are in [`BlendAccount::warnings`].
///
/// # Errors
/// If the file cannot be opened, its path is not UTF-8, no Blender is found, Blender refuses the
/// file or fails, or the task is cancelled.
pub fn hand_over(path: &Path, time_s: Option<f64>, task: Task<'_>) -> Result<HandedOver, UsdError> {
    let folder = temporary()?;
    let account = ask(&Request::new(path, time_s, false)?, folder.path(), task.cancel)?;
    let glb = folder.path().join("scene.glb");
    let glb = std::fs::read(&glb).map_err(|source| UsdError::Io { place: glb.display().to_string(), source })?;
    Ok(HandedOver { glb, account })
}

/// Returns a text that identifies the programs that may export a file, and the code that they run.
/// An export gives the same result if this text, [`BlendAccount::program`], the `.blend` file and
/// [`BlendAccount::files`] are unchanged, and [`BlendAccount::untracked`] is `None`.
pub fn blend_surroundings() -> String {
    let found: Vec<String> = candidates()
        .iter()
        .map(|each| {
            let place = on_path(&each.program);
            format!("{} {:?} {place:?} {:?}", each.given, each.program, place.as_deref().and_then(file_stamp))
        })
        .collect();
    format!("{MODULES:?} {BOOT} {found:?}")
}

/// Returns the length of a file in bytes, and the time of its last change in nanoseconds since
/// 1970. `None` if the system does not report them.
pub fn file_stamp(path: &Path) -> Option<[u64; 2]> {
    let known = std::fs::metadata(path).ok()?;
    let changed = known.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
    Some([known.len(), changed.as_nanos() as u64])
}

/// Lists a file's scenes and animation, and the content that an export would drop.
///
/// # Errors
/// The errors of [`hand_over`].
pub fn blend_contents(path: &Path, task: Task<'_>) -> Result<BlendContents, UsdError> {
    let folder = temporary()?;
    Ok(ask(&Request::new(path, None, true)?, folder.path(), task.cancel)?.contents)
}

/// The views that Blender renders, in the form that is passed to Blender.
#[derive(Clone, Debug, Serialize)]
pub struct BlendViews {
    /// The window in the scene, in glTF's axes.
    pub window: BlendWindow,
    /// Width and height of the window, in millimetres.
    pub size_mm: [f64; 2],
    /// Number of columns and number of rows of a view, in pixels.
    pub resolution: [usize; 2],
    /// Distance of the eyes from the window, in millimetres; `None` for oblique views.
    pub distance_mm: Option<f64>,
    /// Slope of every view: x to the right, y up.
    pub slopes: Vec<[f64; 2]>,
}

/// A window in the scene, with the arguments of `Window::given`.
#[derive(Clone, Debug, Serialize)]
pub struct BlendWindow {
    /// Centre of the window, in the scene.
    pub centre: [f64; 3],
    /// Direction in which the window's viewer looks.
    pub forward: [f64; 3],
    /// Direction that is up for the window's viewer.
    pub up: [f64; 3],
    /// Width of the window in scene units.
    pub width: f64,
}

/// Renders the views of a .blend file at one time of its animation, with the file's own engine and
/// settings. When a view is complete, `finished` receives the view's number and its file (OpenEXR,
/// linear). The file is removed when `finished` returns.
///
/// # Errors
/// The errors of [`hand_over`].
pub fn render_views(
    path: &Path,
    time_s: Option<f64>,
    views: &BlendViews,
    finished: &mut dyn FnMut(usize, &Path),
    task: Task<'_>,
) -> Result<(), UsdError> {
    let folder = temporary()?;
    let mut next = 0;
    // Take the finished views by increasing number, since Blender renders them by increasing
    // number.
    let mut collect = || {
        while next < views.slopes.len() {
            let picture = folder.path().join(format!("done_{next:05}.exr"));
            if !picture.is_file() {
                break;
            }
            finished(next, &picture);
            // A failed removal is ignored. If the pictures fill the disk, writing a picture fails.
            let _ = std::fs::remove_file(&picture);
            next += 1;
        }
    };
    let request = Request { views: Some(views), ..Request::new(path, time_s, false)? };
    ask_one_of(&candidates(), &request, folder.path(), &mut collect, task.cancel)?;
    collect();
    Ok(())
}

#[derive(Serialize)]
struct Request<'a> {
    modules: &'a [(&'a str, &'a str)],
    path: String,
    time_s: Option<f64>,
    contents_only: bool,
    views: Option<&'a BlendViews>,
}

impl<'a> Request<'a> {
    fn new(path: &Path, time_s: Option<f64>, contents_only: bool) -> Result<Self, UsdError> {
        let io = |source| UsdError::Io { place: path.display().to_string(), source };
        lumistack_files::open(path).map_err(io)?;
        let absolute = std::path::absolute(path).map_err(io)?;
        let Some(path) = absolute.to_str() else {
            let message = "expected a path in UTF-8, found another encoding";
            return Err(io(std::io::Error::new(std::io::ErrorKind::InvalidInput, message)));
        };
        Ok(Self { modules: &MODULES, path: path.to_owned(), time_s, contents_only, views: None })
    }
}

#[derive(Debug, Deserialize)]
struct Answer {
    #[serde(flatten)]
    account: BlendAccount,
    error: Option<Failure>,
}

#[derive(Debug, Deserialize)]
struct Failure {
    kind: String,
    message: String,
}

/// The failure of one program: a Blender, or a Python that may have bpy.
enum Failed {
    /// This program cannot read the file. The next program is tried, if one remains.
    Unfit(String),
    Final(UsdError),
}

fn temporary() -> Result<tempfile::TempDir, UsdError> {
    tempfile::tempdir().map_err(|source| UsdError::Io { place: "a temporary folder".into(), source })
}

/// Returns the programs that are tried, in this order: Blender, then Pythons that may have bpy. If
/// `LUMISTACK_BLENDER` is set, returns only its program.
pub(crate) fn candidates() -> Vec<Candidate> {
    let named = |program: PathBuf, from| Candidate { program, from, given: false };
    if let Some(program) = var_os(VARIABLE).filter(|value| !value.is_empty()) {
        return vec![Candidate { program: program.into(), from: VARIABLE, given: true }];
    }
    let mut found = vec![named("blender".into(), "PATH")];
    if cfg!(target_os = "macos") {
        found.push(named("/Applications/Blender.app/Contents/MacOS/Blender".into(), "the folder Applications"));
    }
    if cfg!(windows) {
        let folder = Path::new(r"C:\Program Files\Blender Foundation");
        let mut versions: Vec<PathBuf> =
            std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        versions.sort();
        found.extend(
            versions.iter().rev().map(|version| named(version.join("blender.exe"), "the folder Program Files")),
        );
    }
    found.extend(Surroundings::of_system().candidates().into_iter().map(|python| Candidate { given: false, ..python }));
    found
}

fn ask(request: &Request<'_>, folder: &Path, cancel: &Cancel) -> Result<BlendAccount, UsdError> {
    ask_one_of(&candidates(), request, folder, &mut || (), cancel)
}

fn ask_one_of(
    candidates: &[Candidate],
    request: &Request<'_>,
    folder: &Path,
    meanwhile: &mut dyn FnMut(),
    cancel: &Cancel,
) -> Result<BlendAccount, UsdError> {
    let mut tried = Vec::new();
    for candidate in candidates {
        let program = candidate.program.display().to_string();
        match ask_program(&candidate.program, request, folder, meanwhile, cancel) {
            Ok(answer) => return Ok(answer),
            Err(Failed::Final(error)) => return Err(error),
            Err(Failed::Unfit(found)) if candidate.given => {
                return Err(UsdError::GivenBlender { found: format!("{program}: {found}") });
            }
            Err(Failed::Unfit(found)) => tried.push(format!("{program} from {}: {found}", candidate.from)),
        }
    }
    Err(UsdError::NoBlender { file: request.path.clone(), tried })
}

fn ask_program(
    program: &Path,
    request: &Request<'_>,
    folder: &Path,
    meanwhile: &mut dyn FnMut(),
    cancel: &Cancel,
) -> Result<BlendAccount, Failed> {
    let io = |place: &Path, source| Failed::Final(UsdError::Io { place: place.display().to_string(), source });
    let (boot, asked, answered) = (folder.join("blend.py"), folder.join("request.json"), folder.join("answer.json"));
    // Write the script and the request into a folder. The folder is the only argument of the
    // script.
    std::fs::write(&boot, BOOT).map_err(|error| io(&boot, error))?;
    std::fs::write(&asked, serde_json::to_vec(request).expect("requests serialize"))
        .map_err(|error| io(&asked, error))?;
    let _ = std::fs::remove_file(&answered);
    // Run the program. Blender needs flags to run a script, and to fail if the script fails.
    let mut command = Command::new(program);
    if !is_python(program) {
        command.args(["-b", "--python-exit-code", "1", "--python"]);
    }
    command.arg(&boot).arg("--").arg(folder).env("PYTHONUTF8", "1").env("PYTHONSAFEPATH", "1");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|error| Failed::Unfit(format!("cannot be started: {error}")))?;
    let (said, printed) = (read_end(child.stderr.take()), read_end(child.stdout.take()));
    let status = wait(&mut child, cancel, meanwhile).map_err(|error| Failed::Final(error.into()))?;
    let (said, printed) = (said.join().unwrap_or_default(), printed.join().unwrap_or_default());
    // Without an answer the program's last output is the best explanation.
    let failed = |found: String| {
        let python = program.display().to_string();
        Failed::Final(UsdError::Child { file: request.path.clone(), python, found })
    };
    let Ok(text) = std::fs::read(&answered) else {
        let last = last_lines(&said, &printed);
        let last = if last.is_empty() { String::new() } else { format!("; last output: {last}") };
        let found = format!("{status}{last}");
        return Err(if is_python(program) && status.code() == Some(1) { Failed::Unfit(found) } else { failed(found) });
    };
    let answer: Answer =
        serde_json::from_slice(&text).map_err(|error| failed(format!("an unreadable answer: {error}")))?;
    match &answer.error {
        None => Ok(answer.account),
        Some(Failure { kind, message }) => Err(match kind.as_str() {
            "bpy" => Failed::Unfit(message.clone()),
            "scene" => Failed::Final(UsdError::Refused { file: request.path.clone(), message: message.clone() }),
            _ => failed(format!("an exception in lumistack's script: {message}")),
        }),
    }
}

/// Returns true if the program's name begins with "py". Such a program is a Python, which runs the
/// script without a flag.
pub(crate) fn is_python(program: &Path) -> bool {
    program.file_name().is_some_and(|name| name.to_string_lossy().to_ascii_lowercase().starts_with("py"))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    /// Writes a script that is run instead of Blender. Its variable `last` is the last argument.
    fn fake(folder: &Path, name: &str, script: &str) -> Candidate {
        crate::child::fake(folder, name, &format!("for last; do :; done\n{script}"))
    }

    fn asked(folder: &Path, candidates: &[Candidate]) -> Result<BlendAccount, UsdError> {
        let file = folder.join("szene.blend");
        std::fs::write(&file, "BLENDER").unwrap();
        let request = Request::new(&file, Some(0.5), false).unwrap();
        ask_one_of(candidates, &request, temporary().unwrap().path(), &mut || (), &Cancel::default())
    }

    #[test]
    fn without_blender_the_message_says_what_was_tried_and_what_helps() {
        let folder = tempfile::tempdir().unwrap();
        let missing = Candidate { program: "/no/such/blender".into(), from: "PATH", given: false };
        let old = fake(
            folder.path(),
            "old-blender",
            r#"echo '{"error": {"kind": "bpy", "message": "Blender 3.4.1; 4.2 is the oldest supported version"}}' > "$last/answer.json""#,
        );
        let text = asked(folder.path(), &[missing.clone(), old]).unwrap_err().to_string();
        for part in [
            "szene.blend: .blend files are read by Blender 4.2 or newer",
            "LUMISTACK_BLENDER",
            "/no/such/blender from PATH: cannot be started",
            "old-blender from PATH: Blender 3.4.1",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let text = asked(folder.path(), &[Candidate { given: true, ..missing }]).unwrap_err().to_string();
        assert!(text.starts_with("LUMISTACK_BLENDER: expected Blender 4.2 or newer"), "{text}");
        assert!(Request::new(&folder.path().join("none.blend"), None, false).is_err());
    }

    #[test]
    fn what_goes_wrong_in_blender_is_one_message() {
        let folder = tempfile::tempdir().unwrap();
        for (name, script, expected) in [
            ("crash", "echo 'no memory' >&2; kill -SEGV $$", "last output: no memory"),
            ("garbage", r#"echo '{' > "$last/answer.json""#, "an unreadable answer"),
            (
                "refused",
                r#"echo '{"error": {"kind": "scene", "message": "File format is not supported"}}' > "$last/answer.json""#,
                "szene.blend: File format is not supported",
            ),
            (
                "exception",
                r#"echo '{"error": {"kind": "other", "message": "KeyError: x"}}' > "$last/answer.json""#,
                "an exception in lumistack's script: KeyError: x",
            ),
        ] {
            let text = asked(folder.path(), &[fake(folder.path(), name, script)]).unwrap_err().to_string();
            assert!(text.contains(expected) && text.contains("szene.blend"), "{name}: {text}");
        }
    }

    #[test]
    fn the_request_reaches_the_program_and_its_answer_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let script = r#"grep -q '"time_s":0.5' "$last/request.json" && grep -q 'def export_scene' "$last/request.json" && test -s "$last/blend.py" &&
            echo '{"blender": "9.9", "files": ["/a.png"], "warnings": [["x", "y"]], "contents": {"scenes": ["S"], "frames": [1, 25], "frames_per_second": 24.0, "engine": "CYCLES"}}' > "$last/answer.json""#;
        let account = asked(folder.path(), &[fake(folder.path(), "blender", script)]).unwrap();
        assert_eq!(account.blender, "9.9");
        assert_eq!(account.warnings, [("x".to_owned(), "y".to_owned())]);
        assert!((account.contents.duration_s() - 1.0).abs() < 1e-12);
    }
}
