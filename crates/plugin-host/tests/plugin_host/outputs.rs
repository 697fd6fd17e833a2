//! Tests of outputs on disk. They check an output's folder after its plugin has succeeded, failed,
//! panicked, been cancelled or violated a rule.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use lumistack_core::{Cancel, Collector, NoProgress, Progress, Task};
use lumistack_plugin_host::{HostError, Origin, OutputContext, Plugin, Registry, Time, run_output, with_output};
use lumistack_plugin_testkit::{Sample, same_outputs, samples};
use serde_json::{Value, json};

use crate::common;

#[path = "../../examples/lumistack_plugin_faulty.rs"]
mod faulty;

struct Bench {
    folder: tempfile::TempDir,
    registry: Registry,
    sample: Sample,
    warnings: Collector,
    cancel: Cancel,
}

impl Bench {
    fn new() -> Self {
        let mut registry = Registry::built_in().unwrap();
        registry.add(Plugin::compiled_in(&faulty::PLUGIN).unwrap()).unwrap();
        Self::with(registry)
    }

    /// Makes a bench with the plugin `faulty` loaded from a library.
    fn loaded() -> Self {
        let mut registry = Registry::built_in().unwrap();
        registry.load(&common::paths(vec![common::example("faulty")]));
        assert!(registry.failed().is_empty(), "{:?}", registry.failed());
        let (_, origin) = registry.entries().find(|(info, _)| info.id == "faulty").unwrap();
        assert_eq!(*origin, Origin::Library(common::example("faulty")));
        Self::with(registry)
    }

    fn with(registry: Registry) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let sample = samples().swap_remove(0);
        Self { folder, registry, sample, warnings: Collector::default(), cancel: Cancel::default() }
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("run/outputs/faulty")
    }

    fn write_to(
        &self,
        id: &str,
        params: Value,
        out_dir: &Path,
        progress: &dyn Progress,
    ) -> Result<Vec<PathBuf>, HostError> {
        let task = Task { progress, warnings: &self.warnings, cancel: &self.cancel };
        let (display, data) = (&self.sample.display, self.sample.data());
        let context = OutputContext { display, data, time: Time::default(), out_dir, task };
        run_output(&self.registry, id, &params, context)
    }

    fn write(&self, params: Value) -> Result<Vec<PathBuf>, HostError> {
        self.write_to("faulty", params, &self.out(), &NoProgress)
    }

    /// Returns the contents of all files in the bench's folder by path, hidden files included.
    fn tree(&self) -> BTreeMap<String, String> {
        let mut files = BTreeMap::new();
        let mut folders = vec![self.folder.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                let name = path.strip_prefix(self.folder.path()).unwrap().to_string_lossy().replace('\\', "/");
                if path.is_dir() {
                    files.insert(format!("{name}/"), String::new());
                    folders.push(path);
                } else {
                    files.insert(name, fs::read_to_string(&path).unwrap());
                }
            }
        }
        files
    }
}

#[test]
fn a_plugin_that_works_leaves_its_files_and_nothing_else() {
    let bench = Bench::new();
    let files = bench.write(json!({})).unwrap();
    assert_eq!(files, ["sub0/f.txt", "sub1/f.txt", "sub2/f.txt"].map(PathBuf::from));
    let tree = bench.tree();
    assert_eq!(tree["run/outputs/faulty/sub1/f.txt"], "1 of 3");
    let names: Vec<&str> = tree.keys().map(String::as_str).filter(|name| !name.ends_with('/')).collect();
    let listing = "run/outputs/faulty/.lumistack-files.json";
    let all = ["sub0/f.txt", "sub1/f.txt", "sub2/f.txt"].map(|file| format!("run/outputs/faulty/{file}"));
    assert_eq!(names, [listing, &all[0], &all[1], &all[2]]);
}

/// Cancels at the first progress step.
struct StopAtFirstStep<'a>(&'a Cancel);

impl Progress for StopAtFirstStep<'_> {
    fn begin(&self, _stage: &str, _total: u64, _unit: &str) {}
    fn advance(&self, _steps: u64, _note: &str) {
        self.0.cancel();
    }
    fn end(&self) {}
}

/// Runs the plugin with faults, wrong parameters and wrong paths. Each run must report its error,
/// and leave the bench's folder unchanged.
fn everything_goes_wrong(bench: &Bench) {
    let before = bench.tree();
    for (params, message) in [
        (json!({"fault": "fail"}), "output `faulty` failed: the ink is empty"),
        (json!({"fault": "fail late"}), "output `faulty` failed: jam"),
        (json!({"fault": "panic"}), "output `faulty` panicked, which is a mistake in the plugin: no more ink"),
        (json!({"fault": "leave open"}), "output `faulty` finished, but did not complete the files sub1/f.txt"),
        (json!({"path": "../escaped.txt"}), "output `faulty`: file `../escaped.txt`: expected a path inside"),
        (json!({"path": "/tmp/escaped.txt"}), "output `faulty`: file `/tmp/escaped.txt`: expected a path inside"),
        (json!({"path": "sub0/F.txt"}), "output `faulty`: file `sub0/F.txt` was already written"),
        (json!({"path": "sub0"}), "output `faulty` failed: cannot write `sub0`"),
        (
            json!({"path": "sub0", "fault": "ignore errors"}),
            "output `faulty` finished, but did not complete the files sub0",
        ),
        (json!({"path": "a/../../b"}), "output `faulty`: file `a/../../b`: expected a path inside"),
        (json!({"path": "C:\\a"}), "output `faulty`: file `C:\\\\a`: expected a path inside"),
        (json!({"path": "com1.txt"}), "output `faulty`: file `com1.txt`: expected a path inside"),
        (json!({"fault": "long name"}), "output `faulty`: file `nnn"),
        (json!({"fault": "panic in open"}), "output `faulty` panicked, which is a mistake in the plugin: no paper"),
        (json!({"fault": "panic late"}), "output `faulty` panicked, which is a mistake in the plugin: torn"),
        (json!({"fault": "panic in drop"}), "output `faulty` panicked, which is a mistake in the plugin: dropped"),
        (
            json!({"fault": "panic with a payload that panics"}),
            "output `faulty` panicked, which is a mistake in the plugin: a value that is not text",
        ),
        (json!({"fiels": 2}), "output `faulty`: unknown parameter `fiels`; did you mean `files`?"),
        (
            json!({"files": 10}),
            "output `faulty`: parameter `files`: expected a whole number from 0 to 9 files, found 10",
        ),
    ] {
        let error = bench.write(params).unwrap_err().to_string();
        assert!(error.starts_with(message), "{error}");
        assert_eq!(bench.tree(), before, "{message}");
    }
    let result = bench.write_to("faulty", json!({}), &bench.out(), &StopAtFirstStep(&bench.cancel));
    assert!(matches!(result, Err(HostError::Cancelled)), "{result:?}");
    assert_eq!(bench.tree(), before);
}

#[test]
fn any_failure_leaves_no_new_files() {
    for bench in [Bench::new(), Bench::loaded()] {
        everything_goes_wrong(&bench);
        assert!(bench.tree().is_empty(), "the folders above the output's folder are removed too");
    }
}

#[test]
fn any_failure_keeps_the_earlier_files() {
    for bench in [Bench::new(), Bench::loaded()] {
        bench.write(json!({"files": 2})).unwrap();
        fs::write(bench.out().join("mine.txt"), "not the plugin's").unwrap();
        everything_goes_wrong(&bench);
    }
}

/// Time for a plugin to react to cancellation.
const PATIENCE: Duration = Duration::from_secs(20);

#[test]
fn a_plugin_that_hangs_ends_after_an_interruption() {
    for bench in [Bench::new(), Bench::loaded()] {
        let start = Instant::now();
        let result = std::thread::scope(|scope| {
            let writer = scope.spawn(|| bench.write(json!({"fault": "hang"})));
            // wait until the plugin has written its first file, and hangs in its second
            while !bench.out().with_file_name(".faulty.partial").join("sub0/f.txt").exists() {
                assert!(start.elapsed() < PATIENCE && !writer.is_finished(), "the plugin hangs in its second file");
                std::thread::yield_now();
            }
            bench.cancel.cancel();
            writer.join().unwrap()
        });
        assert!(matches!(result, Err(HostError::Cancelled)), "{result:?}");
        assert!(start.elapsed() < PATIENCE);
        assert!(bench.tree().is_empty());
    }
}

#[test]
fn a_panic_in_a_thread_of_the_plugin_is_its_own() {
    for bench in [Bench::new(), Bench::loaded()] {
        assert_eq!(bench.write(json!({"fault": "panic in a thread", "files": 1})).unwrap().len(), 1);
    }
}

#[test]
fn a_loaded_plugin_writes_the_same_as_the_compiled_one() {
    let [compiled, loaded] = [Bench::new(), Bench::loaded()].map(|bench| bench.registry.get("faulty").unwrap().clone());
    // With default parameters, each of three samples has three files. For each end of the range of
    // the parameter `files`, 0 and 9, one sample is compared again. So 18 files are compared.
    assert_eq!(same_outputs(&compiled, &loaded, &[]).unwrap(), 18);
}

#[test]
fn a_new_output_replaces_the_old_one_and_keeps_files_of_others() {
    let bench = Bench::new();
    bench.write(json!({})).unwrap();
    let mine = bench.out().join("mine.txt");
    fs::write(&mine, "not the plugin's").unwrap();
    bench.write(json!({"files": 1, "path": "extra.txt"})).unwrap();
    let names: Vec<String> = bench.tree().into_keys().filter(|name| name.starts_with("run/outputs/faulty/")).collect();
    let names: Vec<&str> = names.iter().map(|name| &name["run/outputs/faulty/".len()..]).collect();
    assert_eq!(names, ["", ".lumistack-files.json", "extra.txt", "mine.txt", "sub0/", "sub0/f.txt"]);
    assert_eq!(fs::read_to_string(bench.out().join("sub0/f.txt")).unwrap(), "0 of 1");
    assert_eq!(fs::read_to_string(mine).unwrap(), "not the plugin's");
}

#[test]
fn an_error_while_files_move_into_place_is_undone() {
    let bench = Bench::new();
    bench.write(json!({"files": 2})).unwrap();
    // A file is in the place of the folder `sub2`. This is detected only when sub2/f.txt is moved,
    // after the other files.
    fs::write(bench.out().join("sub2"), "in the way").unwrap();
    let before = bench.tree();
    let error = bench.write(json!({"files": 3})).unwrap_err();
    assert!(matches!(&error, HostError::Io { path, .. } if path.ends_with("sub2/f.txt")), "{error}");
    assert_eq!(bench.tree(), before);
    fs::remove_file(bench.out().join("sub2")).unwrap();
    fs::create_dir_all(bench.out().join("sub2/f.txt")).unwrap();
    let before = bench.tree();
    assert!(matches!(bench.write(json!({"files": 3})), Err(HostError::Io { doing: "replace", .. })));
    assert_eq!(bench.tree(), before);
}

#[test]
fn files_of_a_killed_run_are_removed() {
    let bench = Bench::new();
    let left = bench.out().with_file_name(".faulty.partial");
    fs::create_dir_all(left.join("sub0")).unwrap();
    fs::write(left.join("sub0/f.txt"), "half").unwrap();
    bench.write(json!({"files": 1})).unwrap();
    assert!(!left.exists());
    assert_eq!(fs::read_to_string(bench.out().join("sub0/f.txt")).unwrap(), "0 of 1");
}

#[test]
fn a_file_where_the_folder_should_be_is_named() {
    let bench = Bench::new();
    let file = bench.folder.path().join("a.txt");
    fs::write(&file, "x").unwrap();
    let before = bench.tree();
    for out_dir in [file.clone(), file.join("out"), file.join("deep/out")] {
        let error = bench.write_to("images", json!({}), &out_dir, &NoProgress).unwrap_err();
        assert!(matches!(&error, HostError::NotAFolder { found: "a file", path } if *path == file), "{error}");
        assert_eq!(bench.tree(), before);
    }
    let error = bench.write_to("imagse", json!({}), &bench.out(), &NoProgress).unwrap_err();
    assert_eq!(error.to_string(), "unknown plugin `imagse`; did you mean `images`?");
}

#[test]
fn warnings_and_progress_reach_the_task() {
    #[derive(Default)]
    struct Recorder(Mutex<Vec<String>>);
    impl Progress for Recorder {
        fn begin(&self, stage: &str, total: u64, unit: &str) {
            self.0.lock().unwrap().push(format!("{stage} {total} {unit}"));
        }
        fn advance(&self, steps: u64, _note: &str) {
            self.0.lock().unwrap().push(format!("+{steps}"));
        }
        fn end(&self) {
            self.0.lock().unwrap().push("end".into());
        }
    }
    let (bench, recorder) = (Bench::new(), Recorder::default());
    bench.write_to("faulty", json!({"fault": "warn", "files": 2}), &bench.out(), &recorder).unwrap();
    assert_eq!(*recorder.0.lock().unwrap(), ["writing 2 files", "+1", "+1", "end"]);
    let warnings: Vec<String> = bench.warnings.take().iter().map(ToString::to_string).collect();
    assert_eq!(warnings, ["output `faulty`: low on ink"]);
}

#[test]
fn images_are_on_disk_as_they_were_submitted() {
    let bench = Bench::new();
    let out = bench.folder.path().join("pictures");
    let files = bench.write_to("images", json!({}), &out, &NoProgress).unwrap();
    assert_eq!(files.len(), 3 * 2 + 5 + 1, "layers and frames, views, manifest");
    assert!(files.iter().all(|file| out.join(file).is_file()));
    let layer = &bench.sample.stack().unwrap().layers[1];
    let picture = image::open(out.join("layer_1_frame_01.png")).unwrap().into_rgb8();
    // Layer 1 has the transfer function `linear`, so its codes are proportional to its values.
    let codes: Vec<u8> = layer.block([1]).iter().map(|value| (value * 255.0).round() as u8).collect();
    assert_eq!(picture.into_raw(), codes);
}

#[test]
fn a_sequence_goes_through_one_output() {
    let bench = Bench::new();
    let task = Task { progress: &NoProgress, warnings: &bench.warnings, cancel: &bench.cancel };
    let (out, display) = (bench.folder.path().join("sequence"), &bench.sample.display);
    let files = with_output(&bench.registry, "images", &json!({"views": "none"}), display, &out, task, |output| {
        for index in 0..2 {
            let time = Time { index, seconds: index as f64 };
            output.submit(time, bench.sample.data())?;
        }
        Ok(())
    })
    .unwrap();
    let late = files.iter().filter(|file| file.starts_with("t0001")).count();
    assert_eq!((files.len(), late), (13, 6));
}

#[test]
fn data_of_a_port_that_the_plugin_does_not_take_are_refused() {
    let mut bench = Bench::new();
    bench.sample = samples().swap_remove(2);
    let error = bench.write(json!({})).unwrap_err();
    assert_eq!(
        error.to_string(),
        "output `faulty`: expected data that `faulty` accepts (layer_stack), found light_field"
    );
    assert!(bench.tree().is_empty());
}
