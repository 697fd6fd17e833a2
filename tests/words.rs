//! Messages of the command: hints that work, warnings about options that replace or omit something,
//! errors with units, progress, and closed pipes.

use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common;
use crate::common::triangle::write_triangle;
use crate::common::{fail, lumistack, report, succeed};

/// Arguments of a small run. It has three frames, which would flicker on panels.
const SMALL: [&str; 10] =
    ["--resolution", "24x15", "--samples", "2", "--max-bounces", "2", "--frames", "3", "--iterations", "3"];

/// Runs a command that must succeed; returns its standard error.
fn said(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{command:?}\n{text}");
    text
}

fn run(scene: &Path, folder: &Path) -> Command {
    let mut command = lumistack();
    // Cargo also sets the variable CARGO for tests. If it were set, hints would name `cargo
    // lumistack`.
    command.env_remove("CARGO").arg("run").arg(scene).arg("-o").arg(folder).args(SMALL);
    command
}

#[test]
fn a_scene_alone_becomes_a_preview_and_the_hint_works() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_triangle(folder.path());
    let out = folder.path().join("run");
    let text = succeed(&mut run(&scene, &out));
    // the hint names the program by the path with which the test started it
    let program = env!("CARGO_BIN_EXE_lumistack");
    assert!(text.contains(&format!("Look into the display: {program} preview {}", out.display())), "{text}");
    let single =
        ["outputs", "tensor-display", "preview", "preview.html"].iter().fold(out.clone(), |at, name| at.join(name));
    assert!(
        single.is_file() && text.contains(&format!("or open the page {} by a double click", single.display())),
        "{text}"
    );
    let messages = report(&out)["warnings"].to_string();
    assert!(!messages.contains("flicker"), "these frames are not chosen for panels: {messages}");
    // if cargo started the program, the hint names the repository's alias
    let by_cargo = |command: &mut Command| {
        command.env("CARGO", "cargo").env("CARGO_PKG_NAME", "lumistack-cli");
        String::from_utf8(command.output().unwrap().stdout).unwrap()
    };
    let text = by_cargo(&mut run(&scene, &out));
    assert!(text.contains("Look into the display: cargo lumistack preview "), "{text}");
    let help = by_cargo(lumistack().args(["run", "--help"]));
    assert!(
        help.contains("Usage: cargo lumistack run ") && help.contains("\n  cargo lumistack run model.glb"),
        "{help}"
    );
    let text = fail(lumistack().env("CARGO", "cargo").env("CARGO_PKG_NAME", "lumistack-cli").args([
        "run",
        "a.glb",
        "--display",
        "papr",
    ]));
    assert!(text.contains("`cargo lumistack displays`"), "{text}");
}

#[test]
fn the_commands_of_the_readme_work_and_report_replaced_files() {
    let readme = std::fs::read_to_string(common::root().join("README.md")).unwrap();
    let line = |start: &str| {
        let line = readme.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("no {start}"));
        line.split("   ").next().unwrap().split_whitespace().skip(1).map(str::to_owned).collect::<Vec<_>>()
    };
    let folder = tempfile::tempdir().unwrap();
    std::fs::rename(write_triangle(folder.path()), folder.path().join("model.gltf")).unwrap();
    let mut render = line("lumistack render model.glb -o views");
    render[1] = "model.gltf".into();
    succeed(lumistack().current_dir(&folder).args(render).args(&SMALL[..6]).args(["--views", "5x5"]));
    let factorize = line("lumistack factorize views -o");
    let text = said(lumistack().current_dir(&folder).args(&factorize).args(&SMALL[6..]));
    assert!(!text.contains("pitch") && !text.contains("angles"), "its own geometry is kept: {text}");
    let flags = ["--pitch-mm", "3", "--fov", "30x30", "--grid", "perspective", "--distance-mm", "900"];
    let text = said(lumistack().current_dir(&folder).args(&factorize).args(&SMALL[6..]).args(flags));
    for expected in [
        "the light field's own pixel pitch, 19.7925 mm, is replaced by 3 mm (--pitch-mm)",
        "the full angles of the light field's views, 20.0° × 20.0°, are replaced by 30° × 30° (--fov)",
        "the light field states oblique views, but they are taken as perspective views (--grid)",
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    // if an option has the value that the light field already has, there is no warning
    let text = said(lumistack().current_dir(&folder).args(&factorize).args(&SMALL[6..]).args(["--fov", "20x20"]));
    assert!(!text.contains("replaced"), "{text}");
}

#[test]
fn viewpoints_outside_the_zone_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(&mut run(&write_triangle(folder.path()), &out));
    let picture = folder.path().join("a.png");
    let from = |flags: [&str; 2]| said(lumistack().arg("simulate").arg(&out).args(flags).arg("-o").arg(&picture));
    let text = from(["--view", "14,0"]);
    assert!(
        text.contains(
            "--view: at this viewpoint, the rays from all of the display are outside of the viewing zone of ±10° × ±10°"
        ),
        "{text}"
    );
    assert!(from(["--eye", "100,0,600"]).contains("--eye: at this viewpoint, the rays from "));
    // the viewpoints of the examples in the help text are inside the viewing zone
    let help = succeed(lumistack().args(["simulate", "--help"]));
    for flags in [["--view", "4,-2"], ["--eye", "100,0,2000"]] {
        assert!(help.contains(&flags.join(" ")), "{help}");
        assert_eq!(from(flags), "");
    }
}

#[test]
fn errors_name_types_and_places_as_the_file_does() {
    let folder = tempfile::tempdir().unwrap();
    write_triangle(folder.path());
    let job = folder.path().join("a.toml");
    let error = |text: &str| {
        std::fs::write(&job, format!("scene = \"triangle.gltf\"\n{text}")).unwrap();
        fail(lumistack().arg("run").arg(&job).arg("-o").arg(folder.path().join("out")))
    };
    let display = "[display]\npreset = \"paper-three-layer\"\n";
    for (text, expected) in [
        (
            "display = \"paper-three-layer\"".into(),
            "line 2, column 11: expected a table of keys and values, [display], found the text",
        ),
        (format!("{display}frames = 2.5"), "line 4, column 10: expected a whole number, 0 or more, found 2.5"),
        (format!("{display}resolution = [420]"), "expected a list of 2 values, found a list of length 1"),
        (format!("{display}[render]\nlens_deg = \"wide\""), "expected a number in degrees, found the text \"wide\""),
        (format!("{display}[render]\nsamples = 0"), "a.toml: render.samples: expected 1 to 65536, found 0"),
        (format!("{display}[light]\nbackground = \"blue\""), "expected `environment`, a colour such as `#202028`"),
        (
            format!("{display}[light]\nenvironment_rotation_deg = 400"),
            "light.environment_rotation_deg: expected -360 to 360",
        ),
    ] {
        let found = error(&text);
        assert!(found.contains(expected), "{expected}: {found}");
    }
    let text = fail(lumistack().arg("run").arg(folder.path()));
    assert!(text.contains("expected a scene") && text.contains("found a folder"), "{text}");
    let text = fail(lumistack().arg("run").arg(folder.path().join("missing")));
    assert!(text.contains("expected a scene") && text.contains("found no such file"), "{text}");
    let text = fail(lumistack().args(["info", "paper-three-layr"]));
    assert!(text.contains("did you mean `paper-three-layer`"), "{text}");
    let text = succeed(lumistack().arg("plugins"));
    assert!(!text.contains("Text {") && !text.contains("[File"), "{text}");
}

#[test]
fn every_part_of_a_run_shows_progress() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let text =
        succeed(run(&write_triangle(folder.path()), &out).args(["--denoise", "guided", "--samples", "4", "--json"]));
    let events: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let begun: Vec<&str> =
        events.iter().filter(|event| event["event"] == "begin").filter_map(|event| event["stage"].as_str()).collect();
    for stage in [
        "read scene",
        "prepare scene",
        "depth",
        "render",
        "guides of the denoiser",
        "denoise",
        "check the denoiser",
        "expose",
        "write light field",
        "render for the score",
        "factorize",
        "patterns",
        "simulated views",
        "preview",
        "score",
        "report",
    ] {
        assert!(begun.contains(&stage), "{stage} shows no progress: {begun:?}");
    }
    let ended = events.iter().filter(|event| event["event"] == "end").count();
    assert_eq!(ended, begun.len(), "stages follow one another");
    // a second run reads cached results, and shows progress meanwhile
    let text =
        succeed(run(&write_triangle(folder.path()), &out).args(["--denoise", "guided", "--samples", "4", "--json"]));
    let kept = text.lines().filter(|line| line.contains("\"begin\"") && line.contains("\"kept views\"")).count();
    assert_eq!(kept, 2, "views and pictures of the score: {text}");
}

/// If the program that reads its output has closed the pipe, `lumistack` ends without a panic and
/// without a message.
#[test]
fn a_closed_pipe_ends_quietly() {
    for arguments in
        [&["plugins"][..], &["displays"], &["completions", "bash"], &["run", "--help"], &["info", "paper-three-layer"]]
    {
        let mut child = lumistack().args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        let status = child.wait().unwrap();
        assert!(said.is_empty() && status.success(), "{arguments:?}: {status} {said}");
    }
    // a run continues even if the pipe for its messages is closed
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let mut child =
        run(&write_triangle(folder.path()), &out).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stderr.take());
    assert!(child.wait().unwrap().success() && out.join("report.html").is_file());
    // wrong usage has the exit code 2, even if the message cannot be written
    let mut child = lumistack().arg("rum").stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(2));
}

/// In a console of Windows, text that is not ASCII appears as it is. Progress uses control
/// sequences only if the console interprets them.
#[cfg(windows)]
#[test]
fn a_console_of_windows_shows_text_and_progress() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("Größe 日本");
    std::fs::create_dir(&inner).unwrap();
    let (scene, out) = (write_triangle(&inner), inner.join("run"));
    let [scene, out] = [&scene, &out].map(|path| path.to_str().unwrap());
    let words = [&["run", scene, "-o", out], &SMALL[..]].concat();
    let screen = lumistack_testkit::console::screen_of(env!("CARGO_BIN_EXE_lumistack"), &words);
    // a wide character appears once or twice in a line of the screen
    let shows = |text: &str| screen.lines.iter().any(|line| line.contains(text));
    assert!(shows("Größe 日本") || shows("Größe 日日本本"), "{screen:#?}");
    assert!(shows("PSNR") && shows("dB"), "{screen:#?}");
    assert!(shows("0.0 s") && !shows("\u{fffd}"), "{screen:#?}");
    assert!(screen.interprets || !shows("\x1b"), "{screen:#?}");
}

#[test]
fn a_plan_is_printed_and_no_work_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_triangle(folder.path());
    let out = folder.path().join("run");
    let text = succeed(run(&scene, &out).arg("--plan"));
    assert!(!out.exists(), "a plan writes nothing");
    for part in ["trace", "factorize", "output-preview", "not yet known", "number of cached steps: 0; estimated "] {
        assert!(text.contains(part), "{part} is missing:\n{text}");
    }
    succeed(&mut run(&scene, &out));
    let planned = |flags: &[&str]| -> serde_json::Value {
        let text = succeed(run(&scene, &out).args(["--plan", "--json"]).args(flags));
        serde_json::from_str(text.trim()).unwrap()
    };
    let cached = |plan: &serde_json::Value| {
        let steps = plan["steps"].as_array().unwrap().iter();
        let cached = steps.filter(|step| step["cached"] == true).map(|step| step["id"].as_str().unwrap().to_owned());
        cached.collect::<Vec<_>>()
    };
    let same = planned(&[]);
    assert_eq!(cached(&same), ["trace", "denoise", "expose", "score", "factorize", "output-images", "output-preview"]);
    assert!(same["steps"].as_array().unwrap().iter().all(|step| step["key"].as_str().unwrap().len() == 16), "{same}");
    // another number of iterations gives other patterns from the same views
    assert_eq!(cached(&planned(&["--iterations", "4"])), ["trace", "denoise", "expose", "score"]);
    assert!(cached(&planned(&["--samples", "3"])).is_empty());
    // the scene's file changes, so no result is current
    let text = std::fs::read_to_string(&scene).unwrap();
    std::fs::write(&scene, text + " ").unwrap();
    assert!(cached(&planned(&[])).is_empty());
}

#[test]
fn the_doctor_lists_present_and_missing_parts() {
    let folder = tempfile::tempdir().unwrap();
    let python = folder.path().join("no-python");
    let mut doctor = lumistack();
    doctor.arg("doctor").env("LUMISTACK_PYTHON", &python).env("LUMISTACK_OIDN", &python).env_remove("CARGO");
    let text = succeed(&mut doctor);
    let line = |what: &str| text.lines().find(|line| line.contains(what)).unwrap_or_else(|| panic!("{what}: {text}"));
    assert!(line("processor").contains(" threads, "), "{text}");
    assert!(line("USD files").trim_start().starts_with("missing") && line("USD files").contains("no-python"), "{text}");
    assert!(
        text.contains(&format!("lumistack{} setup usd", std::env::consts::EXE_SUFFIX))
            && line("denoiser oidn").trim_start().starts_with("missing"),
        "{text}"
    );
    let json = succeed(doctor.arg("--json"));
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let of = |what: &str| {
        let findings = json["findings"].as_array().unwrap().iter();
        findings.clone().find(|finding| finding["what"] == what).unwrap_or_else(|| panic!("{what}: {json}")).clone()
    };
    assert_eq!(of("USD files")["state"], "missing");
    assert!(of("memory")["help"].is_string() != (of("memory")["state"] == "good"), "{json}");
}
