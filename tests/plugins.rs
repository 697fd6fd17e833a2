//! Plugins in libraries, which the program runs in child processes. If a child process crashes,
//! ends or hangs, only its output fails.

#![cfg(unix)]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::{fail, lumistack, root, succeed};

/// Returns the file name of a plugin's library.
fn file_name(id: &str) -> String {
    format!("{}lumistack_plugin_{id}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX)
}

/// Builds a plugin that crashes, ends, hangs or prints on request.
fn hostile(folder: &Path, id: &str, in_entry: &str) {
    let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c11", "-O0", "-shared", "-fPIC", "-I"]).arg(root().join("crates/plugin-abi/include"));
    cc.arg(format!("-DNAME={id}")).arg("-DKIND=LUMISTACK_KIND_OUTPUT").arg(format!("-DIN_ENTRY=\"{in_entry}\""));
    cc.arg("-o").arg(folder.join(file_name(id))).arg(root().join("crates/plugin-host/tests/hostile.c"));
    assert!(cc.status().expect("a C compiler").success());
}

/// Makes a small job with two outputs. The plugin of one output fails in the way that `fault`
/// names.
fn job(folder: &Path, fault: &str) -> PathBuf {
    let text = format!(
        "[source]\nplugin = \"test_views\"\nparams = {{ pattern = \"cards\", depth_mm = 12 }}\n\n\
         [display]\npreset = \"fig7-uniform\"\nresolution = [30, 20]\nviews = [3, 1]\n\n[factorize]\niterations = 2\n\n\
         [[outputs]]\nplugin = \"images\"\n\n[[outputs]]\nplugin = \"hostile\"\nparams = {{ fault = \"{fault}\" }}\n"
    );
    let path = folder.join("job.toml");
    std::fs::write(&path, text).unwrap();
    path
}

fn run(folder: &Path, fault: &str) -> Command {
    let mut command = lumistack();
    command.arg("run").arg(job(folder, fault)).arg("-o").arg(folder.join("run")).arg("--plugin-path").arg(folder);
    command
}

#[test]
fn a_plugin_that_crashes_costs_its_own_output_alone() {
    let folder = tempfile::tempdir().unwrap();
    hostile(folder.path(), "hostile", "");
    let outputs = folder.path().join("run/outputs/tensor-display");
    for (fault, cause) in [
        ("submit:segfault", "ended by signal 11 (segmentation fault) while the plugin wrote `a.txt`"),
        ("submit:abort", "ended by signal 6 (abort) while the plugin wrote `a.txt`"),
        ("submit:exit", "ended itself with exit code 0 while the plugin wrote `a.txt`"),
    ] {
        let text = fail(&mut run(folder.path(), fault));
        let expected = format!("output `hostile` failed: the plugin's process ({}) {cause}", file_name("hostile"));
        assert!(text.contains(&expected), "{text}");
        assert!(outputs.join("images").is_dir() && !outputs.join("hostile").exists(), "{fault}");
    }
    // text that the plugin prints does not appear in the program's standard output
    let text = succeed(&mut run(folder.path(), "submit:print"));
    assert!(!text.contains("printed by a plugin"), "{text}");
    assert_eq!(std::fs::read_to_string(outputs.join("hostile/a.txt")).unwrap(), "written");
}

#[test]
fn silence_has_a_limit_that_can_be_set() {
    let folder = tempfile::tempdir().unwrap();
    hostile(folder.path(), "hostile", "");
    let text = fail(run(folder.path(), "submit:hang").env("LUMISTACK_PLUGIN_SILENCE_S", "1"));
    assert!(text.contains("gave no sign of life for 1 s while the plugin wrote `a.txt`, and was ended"), "{text}");
    let output = run(folder.path(), "").env("LUMISTACK_PLUGIN_SILENCE_S", "long").output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let expected = "LUMISTACK_PLUGIN_SILENCE_S: expected a number of seconds, 0 for no limit, found `long`";
    assert!(output.status.success() && text.contains(expected), "{text}");
}

#[test]
fn libraries_that_end_their_process_are_listed_with_the_cause() {
    let folder = tempfile::tempdir().unwrap();
    hostile(folder.path(), "exits", "exit");
    hostile(folder.path(), "sound", "print");
    let text = succeed(lumistack().arg("plugins").arg("--plugin-path").arg(folder.path()));
    assert!(text.contains("sound 1.0.0 (output, "), "{text}");
    let cause = format!(
        "the plugin's process ({}) ended itself with exit code 0 while the library was loaded",
        file_name("exits")
    );
    assert!(text.contains(&cause) && text.contains("images "), "{text}");
    // only `lumistack plugins` loads all libraries; other commands load only plugins that they need
    let marks = folder.path().join("marks");
    std::fs::create_dir(&marks).unwrap();
    let mut render = lumistack();
    render.arg("render").arg(root().join("scenes/letters/letters.gltf")).arg("-o").arg(folder.path().join("views"));
    render.args(["--resolution", "30x20", "--samples", "1", "--plugin-path"]).arg(folder.path());
    succeed(render.env("LUMISTACK_TEST_MARKS", &marks));
    assert_eq!(std::fs::read_dir(&marks).unwrap().count(), 0);
}

#[test]
fn ctrl_c_ends_a_plugin_that_hangs() {
    let folder = tempfile::tempdir().unwrap();
    hostile(folder.path(), "hostile", "");
    let mut program = run(folder.path(), "submit:hang")
        .env("LUMISTACK_TEST_MARKS", folder.path())
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let (mark, start) = (folder.path().join("hostile-hangs"), Instant::now());
    let plugin = loop {
        match std::fs::read_to_string(&mark) {
            Ok(pid) if pid.ends_with('\n') => break pid.trim().to_owned(),
            _ => assert!(start.elapsed() < Duration::from_secs(60) && program.try_wait().unwrap().is_none()),
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    let signal = |what: &str, pid: &str| {
        Command::new("kill").args([what, pid]).stderr(Stdio::null()).status().unwrap().success()
    };
    assert!(signal("-0", &plugin), "it is there");
    let asked = Instant::now();
    assert!(signal("-INT", &program.id().to_string()));
    assert_eq!(program.wait().unwrap().code(), Some(130));
    assert!(asked.elapsed() < Duration::from_secs(10), "{:?}", asked.elapsed());
    assert!(!signal("-0", &plugin), "process {plugin} is still there");
}
