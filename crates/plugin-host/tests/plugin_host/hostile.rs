//! Tests with plugins that end their process or never return. The host must report the plugin and
//! the cause, and continue.

#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use lumistack_core::{Cancel, Collector, NoProgress, Task};
use lumistack_display::{Display, LayerStack};
use lumistack_plugin_host::serve::OutputData;
use lumistack_plugin_host::{
    HostError, Limits, NodeData, OutputContext, PluginPaths, Registry, Time, import_scene, make_field, make_stack,
    run_output,
};
use lumistack_plugin_testkit::{Sample, random_field, samples};
use serde_json::json;

use crate::common;

/// Longest time to load a library in these tests. It is long, since a busy machine starts processes
/// slowly.
const LOAD: Duration = Duration::from_secs(5);
/// Longest time without a sign of life in these tests.
const SILENCE: Duration = Duration::from_secs(2);

/// Builds the plugin `id` from `hostile.c` and returns its library. `kind` is the plugin's kind,
/// such as `OUTPUT`. `in_entry` selects a fault of the entry function.
fn hostile(folder: &Path, id: &str, kind: &str, in_entry: &str) -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let library = folder.join(common::file_name(id));
    let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c11", "-Wall", "-Wno-infinite-recursion", "-O0", "-shared", "-fPIC", "-I"]);
    cc.arg(here.join("../plugin-abi/include"));
    cc.arg(format!("-DNAME={id}")).arg(format!("-DKIND=LUMISTACK_KIND_{kind}"));
    cc.arg(format!("-DIN_ENTRY=\"{in_entry}\""));
    let done = cc.arg("-o").arg(&library).arg(here.join("tests/hostile.c")).status().expect("a C compiler");
    assert!(done.success());
    library
}

/// Returns a registry with the compiled-in plugins and these libraries, none of which is loaded
/// yet.
fn registry(named: &[&Path], load: Duration, silence: Duration) -> Registry {
    let mut registry = Registry::built_in().unwrap();
    let limits = Limits { load: Some(load), silence: Some(silence), grace: Duration::from_millis(500) };
    let named = named.iter().map(|path| path.to_path_buf()).collect();
    registry.load(&PluginPaths { named, user: None, launcher: Some(common::child()), limits: Some(limits) });
    assert!(registry.failed().is_empty(), "{:?}", registry.failed());
    registry
}

struct Bench {
    folder: tempfile::TempDir,
    registry: Registry,
    sample: Sample,
    warnings: Collector,
    cancel: Cancel,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let library = hostile(folder.path(), "hostile", "OUTPUT", "");
        let registry = registry(&[&library], LOAD, SILENCE);
        let sample = samples().swap_remove(0);
        Self { folder, registry, sample, warnings: Collector::default(), cancel: Cancel::default() }
    }

    fn task(&self) -> Task<'_> {
        Task { progress: &NoProgress, warnings: &self.warnings, cancel: &self.cancel }
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("outputs/hostile")
    }

    fn write(&self, fault: &str) -> Result<Vec<PathBuf>, HostError> {
        let (display, data) = (&self.sample.display, self.sample.data());
        let context = OutputContext { display, data, time: Time::default(), out_dir: &self.out(), task: self.task() };
        run_output(&self.registry, "hostile", &json!({ "fault": fault }), context)
    }

    /// Asserts that another output of the same registry still works.
    fn others_work(&self, after: &str) {
        let (display, data) = (&self.sample.display, self.sample.data());
        let out_dir = &self.folder.path().join("outputs/images");
        let context = OutputContext { display, data, time: Time::default(), out_dir, task: self.task() };
        let files = run_output(&self.registry, "images", &json!({}), context).unwrap();
        assert!(!files.is_empty() && files.iter().all(|file| out_dir.join(file).is_file()), "{after}");
        fs::remove_dir_all(out_dir).unwrap();
    }
}

/// Returns the expected message if the process ended by `cause` during the operation `doing`.
fn message(cause: &str, doing: &str) -> String {
    format!("output `hostile` failed: the plugin's process ({}) {cause} while {doing}", common::file_name("hostile"))
}

#[test]
fn the_cause_of_a_crash_is_named_and_the_other_outputs_are_written() {
    let bench = Bench::new();
    for (fault, cause, doing) in [
        ("submit:abort", "ended by signal 6 (abort)", "the plugin wrote `a.txt`"),
        ("submit:segfault", "ended by signal 11 (segmentation fault)", "the plugin wrote `a.txt`"),
        ("submit:kill", "ended by signal 9 (kill; the system may have run out of memory)", "the plugin wrote `a.txt`"),
        ("submit:exit", "ended itself with exit code 0", "the plugin wrote `a.txt`"),
        ("before:abort", "ended by signal 6 (abort)", "the plugin processed time step 0"),
        ("open:segfault", "ended by signal 11 (segmentation fault)", "the plugin was opened"),
        ("open:exit", "ended itself with exit code 0", "the plugin was opened"),
        ("finish:abort", "ended by signal 6 (abort)", "the plugin finished"),
        (
            "submit:say and abort",
            "ended by signal 6 (abort)",
            "the plugin wrote `a.txt`; the last line that the process printed: out of ink",
        ),
        ("submit:scribble", "broke off its connection to the program", "the plugin wrote `a.txt`"),
        ("submit:close all", "broke off its connection to the program", "the plugin wrote `a.txt`"),
        ("submit:fork and abort", "ended by signal 6 (abort)", "the plugin wrote `a.txt`"),
    ] {
        let error = bench.write(fault).unwrap_err().to_string();
        assert_eq!(error, message(cause, doing), "{fault}");
        assert!(!bench.out().exists(), "{fault}");
        bench.others_work(fault);
    }
}

#[test]
fn an_overflow_of_the_stack_is_reported() {
    let bench = Bench::new();
    for fault in ["submit:overflow", "finish:overflow"] {
        let error = bench.write(fault).unwrap_err().to_string();
        // A stack overflow is reported by Rust's guard page as an abort, or by the system as a
        // segmentation fault.
        assert!(error.contains("ended by signal 6 (abort)") || error.contains("ended by signal 11"), "{error}");
        assert!(error.starts_with("output `hostile` failed: the plugin's process ("), "{error}");
        bench.others_work(fault);
    }
}

#[test]
fn a_plugin_that_hangs_is_ended() {
    let bench = Bench::new();
    for (fault, doing) in [
        ("submit:hang", "the plugin wrote `a.txt`"),
        ("submit:spin", "the plugin wrote `a.txt`"),
        ("open:hang", "the plugin was opened"),
        ("finish:hang", "the plugin finished"),
    ] {
        let start = Instant::now();
        let error = bench.write(fault).unwrap_err().to_string();
        assert_eq!(error, message("gave no sign of life for 2 s", &format!("{doing}, and was ended")), "{fault}");
        assert!((SILENCE..SILENCE + Duration::from_secs(10)).contains(&start.elapsed()), "{:?}", start.elapsed());
        bench.others_work(fault);
    }
}

#[test]
fn long_work_with_signs_of_life_is_not_disturbed() {
    let bench = Bench::new();
    let start = Instant::now();
    bench.write("slow").unwrap();
    assert!(start.elapsed() > SILENCE + Duration::from_millis(500), "the call takes longer than the limit of silence");
    assert_eq!(fs::read_to_string(bench.out().join("a.txt")).unwrap(), "written");
}

#[test]
fn the_output_of_a_plugin_does_not_disturb_the_protocol() {
    let bench = Bench::new();
    for fault in ["open:print", "submit:print", "finish:print", "close:print"] {
        bench.write(fault).unwrap();
        assert_eq!(fs::read_to_string(bench.out().join("a.txt")).unwrap(), "written", "{fault}");
    }
}

#[test]
fn a_crash_after_the_last_file_is_a_warning() {
    let bench = Bench::new();
    bench.write("close:abort").unwrap();
    assert!(bench.out().join("a.txt").is_file());
    let warnings: Vec<String> = bench.warnings.take().iter().map(ToString::to_string).collect();
    let library = common::file_name("hostile");
    let expected = format!(
        "output `hostile`: the plugin's process ({library}) ended by signal 6 (abort) while the plugin was closed"
    );
    assert_eq!(warnings, [expected]);
}

#[test]
fn the_user_can_stop_a_plugin_that_does_not_listen() {
    let bench = Bench::new();
    for fault in ["submit:hang", "submit:spin", "open:spin"] {
        let bench = Bench { cancel: Cancel::default(), ..Bench::new() };
        let start = Instant::now();
        let result = std::thread::scope(|scope| {
            let writer = scope.spawn(|| bench.write(fault));
            std::thread::sleep(Duration::from_millis(700));
            bench.cancel.cancel();
            writer.join().unwrap()
        });
        assert!(matches!(result, Err(HostError::Cancelled)), "{fault}: {result:?}");
        assert!(start.elapsed() < SILENCE, "{fault}: {:?}", start.elapsed());
        assert!(!bench.out().exists());
    }
    bench.others_work("interruptions");
}

#[test]
fn libraries_that_misbehave_while_they_are_loaded_are_listed_with_the_cause() {
    let folder = tempfile::tempdir().unwrap();
    let causes = BTreeMap::from([
        ("aborts", ("abort", "ended by signal 6 (abort) while the library was loaded")),
        ("crashes", ("segfault", "ended by signal 11 (segmentation fault) while the library was loaded")),
        ("exits", ("exit", "ended itself with exit code 0 while the library was loaded")),
        ("hangs", ("hang", "gave no sign of life for 5 s while the library was loaded, and was ended")),
        ("scribbles", ("scribble", "broke off its connection to the program while the library was loaded")),
    ]);
    for (id, (fault, _)) in &causes {
        hostile(folder.path(), id, "OUTPUT", fault);
    }
    hostile(folder.path(), "sound", "OUTPUT", "print");
    let registry = registry(&[folder.path()], LOAD, SILENCE);
    // The error for a requested plugin must state the cause. The request must load no other plugin.
    let error = registry.get("aborts").unwrap_err().to_string();
    let library = |id: &str| folder.path().join(common::file_name(id)).display().to_string();
    let told = |id: &str| format!("{}: the plugin's process ({}) {}", library(id), common::file_name(id), causes[id].1);
    assert_eq!(error, format!("plugin `aborts` cannot be used: {}", told("aborts")));
    assert_eq!(registry.failed().len(), 1);
    let found: Vec<&str> = registry.infos().map(|info| info.id.as_str()).collect();
    assert!(found.contains(&"sound") && found.contains(&"images"), "{found:?}");
    let failed: Vec<String> = registry.failed().iter().map(ToString::to_string).collect();
    assert_eq!(failed, causes.keys().map(|id| told(id)).collect::<Vec<_>>());
}

#[test]
fn plugins_of_the_other_kinds_are_named_as_well() {
    let folder = tempfile::tempdir().unwrap();
    for (id, kind) in [("h_importer", "IMPORTER"), ("h_source", "SOURCE"), ("h_node", "NODE")] {
        hostile(folder.path(), id, kind, "");
    }
    let registry = registry(&[folder.path()], LOAD, SILENCE);
    assert_eq!(registry.importer_of("hostile").unwrap().id, "h_importer");
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let display = &samples()[0].display;
    let field = random_field(display).unwrap();
    for (fault, cause) in [
        ("make:abort", "ended by signal 6 (abort) while"),
        ("make:segfault", "ended by signal 11 (segmentation fault) while"),
        ("make:exit", "ended itself with exit code 0 while"),
        ("make:hang", "gave no sign of life for 2 s while"),
    ] {
        let params = json!({ "fault": fault });
        let read = |_: &str| Ok(Vec::new());
        let importer = import_scene(&registry, "h_importer", &params, "a.hostile", &read, task).map(drop);
        let source = make_field(&registry, "h_source", &params, display, Time::default(), task).map(drop);
        let node = make_stack(&registry, "h_node", &params, &NodeData::new(display, &field), task).map(drop);
        for (result, kind, doing) in [
            (importer, "importer", "the plugin read `a.hostile`"),
            (source, "source", "the plugin made a light field"),
            (node, "node", "the plugin made a layer stack"),
        ] {
            let error = result.unwrap_err().to_string();
            let library = common::file_name(&format!("h_{kind}"));
            let expected = format!("{kind} `h_{kind}` failed: the plugin's process ({library}) {cause} {doing}");
            assert!(error.starts_with(&expected), "{error}");
        }
    }
    let made = import_scene(&registry, "h_importer", &json!({}), "a.hostile", &|_| Ok(Vec::new()), task).unwrap();
    assert_eq!(made, b"{}");
}

/// Every output and every call that makes data loads the library again. If the file has changed in
/// the meantime, the error of loading it is reported at once.
#[test]
fn a_library_that_was_damaged_after_its_first_use_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let library = hostile(folder.path(), "h_importer", "IMPORTER", "");
    let (bench, importers) = (Bench::new(), registry(&[&library], LOAD, SILENCE));
    for (registry, id) in [(&bench.registry, "hostile"), (&importers, "h_importer")] {
        registry.get(id).unwrap();
    }
    let output = bench.folder.path().join(common::file_name("hostile"));
    for library in [&output, &library] {
        fs::write(library, "no library").unwrap();
    }
    let error = bench.write("").unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("output `hostile` failed: {}: cannot be loaded: ", output.display())),
        "{error}"
    );
    assert!(!bench.out().exists());
    let read = |_: &str| Ok(Vec::new());
    let made = import_scene(&importers, "h_importer", &json!({}), "a.hostile", &read, bench.task());
    let error = made.unwrap_err().to_string();
    let expected = format!("importer `h_importer` failed: {}: cannot be loaded: ", library.display());
    assert!(error.starts_with(&expected), "{error}");
}

/// A plugin of these tests creates a file when its library is loaded. This test starts a process
/// that uses one of two plugins. Afterwards only the file of the used plugin must exist.
/// Environment variables of the process name the libraries and the folder.
#[test]
fn a_library_that_is_not_requested_is_not_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let (named, other) = (hostile(folder.path(), "named", "OUTPUT", ""), hostile(folder.path(), "other", "OUTPUT", ""));
    let run = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "hostile::uses_the_plugin_named", "--nocapture"])
        .env("LUMISTACK_TEST_MARKS", folder.path())
        .env("LUMISTACK_TEST_LIBRARIES", std::env::join_paths([&named, &other]).unwrap())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    assert!(folder.path().join("named-loaded").exists());
    assert!(!folder.path().join("other-loaded").exists());
}

#[test]
#[ignore = "run by the test above, in a process of its own"]
fn uses_the_plugin_named() {
    let Some(libraries) = std::env::var_os("LUMISTACK_TEST_LIBRARIES") else { return };
    let libraries: Vec<PathBuf> = std::env::split_paths(&libraries).collect();
    let libraries: Vec<&Path> = libraries.iter().map(PathBuf::as_path).collect();
    let registry = registry(&libraries, LOAD, SILENCE);
    registry.get("named").unwrap();
    assert!(registry.origin("other").is_some());
    assert!(registry.get("others").unwrap_err().to_string().contains("did you mean `other`?"));
}

/// Planes are sent one by one and freed when the plugin releases them. So the memory of the child
/// must not grow with the number of planes.
#[test]
fn a_plugin_needs_memory_for_one_plane() {
    let folder = tempfile::tempdir().unwrap();
    let registry = registry(&[&hostile(folder.path(), "hostile", "OUTPUT", "")], LOAD, Duration::from_secs(60));
    let display = Display::uniform([1200, 800], 0.2, [3, 3], [20.0, 20.0], &[-10.0, 0.0, 10.0], 6);
    let stack = LayerStack::filled(&display, 0.5);
    let (warnings, cancel, out_dir) = (Collector::default(), Cancel::default(), folder.path().join("out"));
    let context = OutputContext {
        display: &display,
        data: OutputData::LayerStack(&stack, None),
        time: Time::default(),
        out_dir: &out_dir,
        task: Task::quiet(&warnings, &cancel),
    };
    let start = Instant::now();
    run_output(&registry, "hostile", &json!({"fault": "fetch"}), context).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    let line = fs::read_to_string(out_dir.join("a.txt")).unwrap();
    let numbers: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
    let plane = 1200.0 * 800.0 * 12.0;
    assert_eq!(numbers[0], plane * 18.0 * 4.0);
    println!("{:.0} MB in {seconds:.2} s; most memory of the process {:.0} MB", numbers[0] / 1e6, numbers[1] / 1e3);
    if cfg!(target_os = "linux") {
        // The process holds one plane and its copies in the pipe. All planes together would take
        // 207 MB.
        assert!(numbers[1] * 1024.0 < 6.0 * plane, "{} kB", numbers[1]);
    }
}

/// A killed program leaves no process behind, even if the plugin hangs.
#[test]
fn the_process_ends_with_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let library = hostile(folder.path(), "hostile", "OUTPUT", "spin");
    let mut child = Command::new(common::child().program)
        .arg(&library)
        .arg("hostile")
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(300));
    assert!(child.try_wait().unwrap().is_none(), "the plugin should hang, but its process has ended");
    drop(child.stdin.take());
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(10) {
            child.kill().unwrap();
            panic!("the process still runs although its input was closed");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_program_that_cannot_be_started_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let library = hostile(folder.path(), "hostile", "OUTPUT", "");
    let load = |launcher: Option<lumistack_plugin_host::Launcher>| {
        let mut registry = Registry::default();
        registry.load(&PluginPaths { named: vec![library.clone()], user: None, launcher, limits: None });
        registry.get("hostile").unwrap_err().to_string()
    };
    let nothing = lumistack_plugin_host::Launcher { program: "/no/such/program".into(), args: Vec::new() };
    let error = load(Some(nothing));
    assert!(error.contains("cannot start /no/such/program, the program that runs the plugin: "), "{error}");
    assert!(load(None).contains("found a program without a `Launcher`"));
    // Use a launcher whose program does not run plugins.
    let other = lumistack_plugin_host::Launcher { program: "echo".into(), args: Vec::new() };
    let error = load(Some(other));
    assert!(error.contains("ended itself with exit code 0 while the library was loaded"), "{error}");
}
