//! A library that was built against version 1.0 of the plugin interface still works, in a process
//! of its own and in this process. `tests/fixtures/abi-1.0` has its source.

use std::path::{Path, PathBuf};

use libloading::Library;
use lumistack_core::seed::Stream;
use lumistack_core::{Task, Tensor};
use lumistack_display::{LayerStack, Projection, Simulator, ViewGrid, Weights};
use lumistack_plugin::abi::{ENTRY_PREFIX, Entry, port};
use lumistack_plugin::{PluginError, Port, Time};
use lumistack_plugin_host::Registry;
use lumistack_plugin_host::serve::{LogLevel, NodeData, Output, Plugin, Services, import, make_field, make_stack};
use lumistack_plugin_testkit::{MemoryHost, Sample, random_field, samples};
use serde_json::json;

use crate::common;

/// The plugins of the library.
const IDS: [&str; 4] = ["old_importer", "old_node", "old_output", "old_source"];

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/abi-1.0")
}

/// Returns the committed library. On machines for which it was not built, this function compiles
/// its source from the fixture into `folder`.
fn library(folder: &Path) -> PathBuf {
    if cfg!(all(target_os = "linux", target_arch = "x86_64")) {
        return fixture().join("liblumistack_plugin_old.so");
    }
    let library = folder.join(common::file_name("old"));
    let mut cc = std::process::Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c11", "-O2", "-shared", "-fPIC", "-I"]).arg(fixture()).arg("-o").arg(&library);
    assert!(cc.arg(fixture().join("lumistack_plugin_old.c")).status().expect("a C compiler").success());
    library
}

/// Returns the entry function of a plugin in the library. The library stays loaded.
fn entry(library: &Path, id: &str) -> Entry {
    // SAFETY: the library has no initializers.
    let library = Box::leak(Box::new(unsafe { Library::new(library) }.unwrap()));
    // SAFETY: the source declares this function with this type.
    *unsafe { library.get::<Entry>(format!("{ENTRY_PREFIX}{id}").as_bytes()) }.unwrap()
}

/// Calls `check` twice, each time with a function that returns a plugin of the library. The first
/// function takes plugins from a registry, so they run in processes of their own. Plugins of the
/// second function run in this process.
fn in_both_ways(check: impl Fn(&dyn Fn(&str) -> Plugin)) {
    let folder = tempfile::tempdir().unwrap();
    let library = library(folder.path());
    let mut registry = Registry::default();
    registry.load(&common::paths(vec![library.clone()]));
    check(&|id| registry.get(id).unwrap().clone());
    // SAFETY: the descriptors of the library are static, and keep the rules of version 1.0.
    check(&|id| unsafe { Plugin::from_descriptor(entry(&library, id)()) }.unwrap());
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64
}

#[test]
fn the_library_states_version_1_0() {
    let folder = tempfile::tempdir().unwrap();
    let library = library(folder.path());
    for id in IDS {
        // SAFETY: the function has no arguments, and returns a static descriptor.
        let descriptor = unsafe { &*entry(&library, id)() };
        assert_eq!((descriptor.abi_major, descriptor.abi_minor), (1, 0), "{id}");
    }
    let mut registry = Registry::default();
    registry.load(&common::paths(vec![library]));
    let infos: Vec<_> = registry.infos().map(|info| info.id.as_str()).collect();
    assert_eq!(infos, IDS, "{:?}", registry.failed());
}

#[test]
fn the_old_importer_reads_files() {
    in_both_ways(|plugin| {
        let importer = plugin("old_importer");
        assert_eq!(importer.info().extensions, ["old", "older"]);
        let read = |path: &str| match path {
            "a.old" => Ok(b"{\"asset\": {\"version\": \"2.0\"}}".to_vec()),
            other => Err(PluginError::Failed(format!("no file {other}"))),
        };
        let scene = import(&importer, &MemoryHost::new(), "{}", "a.old", &read).unwrap();
        assert_eq!(scene, read("a.old").unwrap());
        let error = import(&importer, &MemoryHost::new(), "{}", "b.old", &read).unwrap_err();
        assert!(error.to_string().contains("no file b.old"), "{error}");
    });
}

#[test]
fn the_old_source_makes_a_light_field() {
    in_both_ways(|plugin| {
        let display = &samples()[0].display;
        let time = Time { index: 3, seconds: 0.75 };
        let field = make_field(&plugin("old_source"), &MemoryHost::new(), "{}", display, time).unwrap();
        let geometry = field.geometry();
        assert_eq!((geometry.rows, geometry.cols, geometry.pitch_mm), (2, 3, 0.5));
        let projection = Projection::Perspective { distance_mm: 400.0 };
        assert_eq!(geometry.grid, ViewGrid { projection, slope_x: vec![-0.1, 0.1], slope_y: vec![0.0] });
        assert_eq!(field.radiance().data(), [[0.75; 18], [1.75; 18]].as_flattened());
    });
}

/// Reverses the order of rows in every plane `[row][col][rgb]`.
fn upside_down(values: &mut [f32], rows: usize, cols: usize) {
    for plane in values.chunks_exact_mut(rows * cols * 3) {
        let turned: Vec<f32> = plane.chunks_exact(cols * 3).rev().flatten().copied().collect();
        plane.copy_from_slice(&turned);
    }
}

#[test]
fn the_old_node_makes_patterns() {
    in_both_ways(|plugin| {
        // the first sample has three layers, the second has one layer and a directional backlight
        for sample in &samples()[..2] {
            let (display, start) = (&sample.display, sample.stack().unwrap());
            let field = random_field(display).unwrap();
            let [views_y, views_x, rows, cols, _] = field.radiance().shape();
            let mut rays = Tensor::zeros(["view_y", "view_x", "row", "col"], [views_y, views_x, rows, cols]);
            let mut stream = Stream::new(5);
            rays.data_mut().fill_with(|| stream.next_f32());
            let weight = mean(rays.block([0, 0]));
            let weights = Weights::PerRay(rays);
            let node = NodeData { weights: &weights, start: Some(start), ..NodeData::new(display, &field) };
            let made = make_stack(&plugin("old_node"), &MemoryHost::new(), "{}", &node).unwrap();

            let mut expected: LayerStack = start.clone();
            for layer in &mut expected.layers {
                let [_, rows, cols, _] = layer.shape();
                upside_down(layer.data_mut(), rows, cols);
            }
            if let Some(emission) = &mut expected.emission {
                let [_, _, _, rows, cols, _] = emission.shape();
                upside_down(emission.data_mut(), rows, cols);
            }
            expected.brightness = mean(field.view([0, 0]));
            assert_eq!(made.stack, expected, "{}", sample.name);
            let [(step, _)] = &made.steps[..] else { panic!("{:?}", made.steps) };
            assert_eq!((step.iteration, step.objective, step.psnr_view), (1, weight, 30.5));
            let solution = made.solution.unwrap();
            assert_eq!((solution.solver.as_str(), solution.kkt_residual), ("flip", 0.25));

            let host = MemoryHost::new();
            host.cancel();
            let cancelled = make_stack(&plugin("old_node"), &host, "{}", &node);
            assert!(matches!(cancelled, Err(PluginError::Cancelled)), "{cancelled:?}");
        }
    });
}

/// Returns the numbers that `old_output` writes.
fn numbers(sample: &Sample, time: Time) -> Vec<f64> {
    let stack = sample.stack().unwrap();
    let mut expected = vec![f64::from(port::LAYER_STACK), time.index as f64, time.seconds];
    for layer in &stack.layers {
        expected.extend((0..stack.frames()).map(|frame| mean(layer.block([frame]))));
    }
    let simulator = Simulator::new(&sample.display, stack);
    for grid in [
        ViewGrid::single(Projection::Oblique, [0.02, -0.01]),
        ViewGrid::single(Projection::Perspective { distance_mm: 300.0 }, [10.0 / 300.0, 5.0 / 300.0]),
    ] {
        let geometry = sample.display.geometry().unwrap().with_grid(grid);
        expected.push(mean(simulator.seen(&geometry, [0, 0]).radiance.data()));
    }
    expected
}

/// A host in memory that states before `open` which data the output will receive: a layer stack.
struct WithPort(MemoryHost);

impl Services for WithPort {
    fn task(&self) -> Task<'_> {
        self.0.task()
    }

    fn warn(&self, message: &str) {
        self.0.warn(message);
    }

    fn file_open(&self, path: &str) -> Result<u64, PluginError> {
        self.0.file_open(path)
    }

    fn file_append(&self, file: u64, bytes: &[u8]) -> Result<(), PluginError> {
        self.0.file_append(file, bytes)
    }

    fn file_commit(&self, file: u64) -> Result<(), PluginError> {
        self.0.file_commit(file)
    }

    fn file_abort(&self, file: u64) -> Result<(), PluginError> {
        self.0.file_abort(file)
    }

    fn port(&self) -> Option<Port> {
        Some(Port::LayerStack)
    }
}

#[test]
fn the_old_output_writes_files() {
    in_both_ways(|plugin| {
        let (host, sample, time) = (WithPort(MemoryHost::new()), &samples()[0], Time { index: 7, seconds: 0.25 });
        let old = plugin("old_output");
        let output = Output::open(&old, &host, &json!({"gain": 0.5}), &sample.display).unwrap();
        output.submit(time, sample.data()).unwrap();
        output.finish().unwrap();
        let WithPort(host) = host;
        let files = host.files();
        assert_eq!(files.keys().collect::<Vec<_>>(), ["numbers.bin", "params.json"]);
        assert_eq!(files["params.json"], br#"{"gain":0.5}"#);
        let found: Vec<f64> =
            files["numbers.bin"].as_chunks().0.iter().map(|bytes| f64::from_ne_bytes(*bytes)).collect();
        assert_eq!(found, numbers(sample, time));
        assert_eq!(host.stages(), (vec!["planes".into()], 0));
        assert_eq!(host.messages(), [(LogLevel::Warn, "opened".into())]);

        let error = Output::open(&old, &MemoryHost::new(), &json!({"gain": 3}), &sample.display).err().unwrap();
        assert!(error.to_string().contains("gain"), "{error}");
    });
}
