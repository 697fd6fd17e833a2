//! Tests the plugins of this repository as libraries, and the samples of the tutorial.

use std::path::PathBuf;

use lumistack_plugin_host::Registry;
use lumistack_plugin_host::serve::import;
use lumistack_plugin_testkit::{MemoryHost, conformance_of, import_conformance, same_outputs};

use crate::common;

/// The folder into which `cargo xtask plugins` builds libraries.
const FOLDER: &str = "LUMISTACK_TEST_PLUGINS";

fn load(named: Vec<PathBuf>) -> Registry {
    let mut registry = Registry::default();
    registry.load(&common::paths(named));
    // `infos` loads all libraries
    assert!(registry.infos().count() > 0);
    assert!(registry.failed().is_empty(), "{:?}", registry.failed());
    registry
}

const OBJ: &[u8] = b"mtllib a.mtl\nv 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nusemtl red\nf 1/1 2/1 3/2 4/2\n";
const MTL: &[u8] = b"newmtl red\nKd 0.8 0.1 0.05\nNs 100\nmap_Kd a b.png\n";

#[test]
fn every_plugin_is_the_same_loaded_as_compiled_in() {
    let Some(folder) = std::env::var_os(FOLDER) else {
        lumistack_testkit::skip::runs_in("plugins");
        return;
    };
    let (compiled, loaded) = (Registry::built_in().unwrap(), load(vec![folder.into()]));
    let mut compared = 0;
    for (info, origin) in loaded.entries() {
        let plugin = loaded.get(&info.id).unwrap();
        // These parameters keep their defaults, since their extreme values would take too long:
        // pictures for every device, and four billion iterations.
        let at_default: &[&str] = match info.id.as_str() {
            "quilt" => &["device"],
            "tensor_display" => &["iterations", "coarse_iterations"],
            _ => &[],
        };
        conformance_of(plugin, at_default).unwrap_or_else(|broken| panic!("{origin}: {broken}"));
        // The tutorial's samples are not compiled in, so their results are not compared.
        let Ok(same) = compiled.get(&info.id) else {
            println!("{}: keeps the rules", info.id);
            continue;
        };
        let count = same_outputs(same, plugin, at_default).unwrap_or_else(|broken| panic!("{origin}: {broken}"));
        // A presenter writes nothing, so it has no results to compare.
        assert!(count > 0 || info.presents, "{}: nothing was compared", info.id);
        if info.id == "obj" {
            let [a, b] = [same, plugin].map(|plugin| {
                import_conformance(plugin, "a.obj", &[("a.obj", OBJ), ("a.mtl", MTL)]).unwrap();
                import(plugin, &MemoryHost::new(), "{}", "a.obj", &|path| {
                    Ok(if path == "a.obj" { OBJ } else { MTL }.to_vec())
                })
            });
            assert!(a.is_ok() && a == b, "{origin}: makes another document");
        }
        println!("{}: keeps the rules; {count} results equal, byte for byte", info.id);
        compared += 1;
    }
    assert_eq!(compared, compiled.infos().count(), "every plugin that is compiled in is also loaded");
}

#[cfg(unix)]
mod c {
    use std::path::Path;
    use std::process::Command;

    use lumistack_plugin::Time;
    use lumistack_plugin_host::serve::Output;
    use lumistack_plugin_testkit::{MemoryHost, conformance_of, samples};
    use serde_json::json;

    use crate::common;

    #[test]
    fn the_sample_in_c_keeps_the_rules_and_writes_the_means() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let folder = tempfile::tempdir().unwrap();
        let library = folder.path().join(common::file_name("c_means"));
        let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
        cc.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC", "-I"]);
        cc.arg(root.join("crates/plugin-abi/include")).arg("-o").arg(&library);
        cc.arg(root.join("examples/c-plugin/lumistack_plugin_c_means.c"));
        assert!(cc.status().expect("a C compiler").success());

        let registry = super::load(vec![library]);
        let plugin = registry.get("c_means").unwrap();
        conformance_of(plugin, &[]).unwrap();

        let (host, sample) = (MemoryHost::new(), &samples()[0]);
        let output = Output::open(plugin, &host, &json!({}), &sample.display).unwrap();
        output.submit(Time::default(), sample.data()).unwrap();
        output.finish().unwrap();
        let stack = sample.stack().unwrap();
        let mut expected = Vec::new();
        for (n, layer) in stack.layers.iter().enumerate() {
            for frame in 0..stack.frames() {
                let values = layer.block([frame]);
                let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64;
                expected.push(format!("layer {n} frame {frame} mean {mean:.6}"));
            }
        }
        let text = String::from_utf8(host.files().remove("means_0000.txt").unwrap()).unwrap();
        assert_eq!(text.lines().collect::<Vec<_>>(), expected);
    }

    /// A plugin in C that passes invalid file names, lengths, handles and statuses to the host.
    const GARBAGE: &str = r#"
#include "lumistack_plugin.h"
#include <string.h>
#define TEXT(text) {(const uint8_t *)(text), sizeof(text) - 1}
static const LumistackHostServices *host;
static LumistackStatus open_(const LumistackHostServices *h, LumistackStr p, LumistackStr d, void **i, const LumistackErrorSink *e) {
    (void)p, (void)d, (void)i, (void)e;
    host = h;
    return 0;
}
static LumistackStatus submit(void *i, const LumistackTime *t, const LumistackData *d, const LumistackErrorSink *e) {
    (void)i, (void)t;
    int wrong = 0;
    uint64_t file = 99;
    const LumistackStr names[] = {TEXT("../../x"), TEXT("/tmp/x"), TEXT("a//b"), TEXT(""), TEXT("\xff\xfe"), TEXT("a\nb"),
        {(const uint8_t *)"a", (size_t)-1}, {NULL, 5}, TEXT("C:\\x"), TEXT("nul")};
    for (size_t n = 0; n < sizeof names / sizeof *names; n++) wrong += host->file_open(host->context, names[n], &file, NULL) == 0;
    LumistackBytes huge = {(const uint8_t *)"x", (size_t)1 << 63}, nowhere = {NULL, 7}, fine = {(const uint8_t *)"x", 1};
    LumistackStr name = TEXT("a.txt");
    wrong += host->file_append(host->context, 12345, fine, NULL) == 0;
    wrong += host->file_open(host->context, name, &file, e) != 0;
    wrong += host->file_append(host->context, file, huge, NULL) == 0;
    wrong += host->file_append(host->context, file, nowhere, NULL) == 0;
    wrong += host->file_commit(host->context, file, e) != 0;
    wrong += host->file_commit(host->context, file, NULL) == 0;
    wrong += host->file_abort(host->context, file, NULL) == 0;
    LumistackPlane plane = {.size = 3};
    wrong += d->layer_plane(d->context, 0, 0, &plane, NULL) == 0;
    plane.size = sizeof plane;
    wrong += d->layer_plane(d->context, (size_t)-1, 0, &plane, NULL) == 0;
    wrong += d->emission_plane(d->context, 0, 0, (size_t)-1, &plane, NULL) == 0;
    LumistackView view = {.size = sizeof view, .kind = 77};
    wrong += host->simulate(host->context, d, &view, &plane, NULL) == 0;
    LumistackStr text = {(const uint8_t *)"\xff", (size_t)-1};
    host->log(host->context, 12345, text);
    host->progress_advance(host->context, (uint64_t)-1, text);
    if (e) e->write(e->context, text);
    return wrong ? -wrong : 1234;
}
static LumistackStatus finish(void *i, const LumistackErrorSink *e) { (void)i, (void)e; return -7; }
static void close_(void *i) { (void)i; }
static const LumistackOutputVtable vtable = {sizeof vtable, open_, submit, NULL, finish, close_};
static const LumistackDescriptor descriptor = {LUMISTACK_ABI_MAJOR, LUMISTACK_ABI_MINOR, sizeof descriptor, LUMISTACK_KIND_OUTPUT,
    LUMISTACK_PORT_LAYER_STACK, TEXT("garbage"), TEXT("1.0.0"), TEXT("Nonsense."), TEXT("{\"params\": []}"), &vtable};
const LumistackDescriptor *lumistack_plugin_entry_garbage(void) { return &descriptor; }
"#;

    #[test]
    fn nonsense_from_c_is_refused_piece_by_piece() {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("garbage.c");
        std::fs::write(&source, GARBAGE).unwrap();
        let library = folder.path().join(common::file_name("garbage"));
        let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
        cc.args(["-std=c11", "-Wall", "-Werror", "-Wno-overflow", "-shared", "-fPIC", "-I"]);
        cc.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../plugin-abi/include"));
        assert!(cc.arg("-o").arg(&library).arg(&source).status().expect("a C compiler").success());
        let registry = super::load(vec![library]);
        let plugin = registry.get("garbage").unwrap();
        let (host, sample) = (MemoryHost::new(), &samples()[0]);
        let output = Output::open(plugin, &host, &json!({}), &sample.display).unwrap();
        let error = output.submit(Time::default(), sample.data()).unwrap_err();
        // The plugin returns status 1234 if the host has refused all invalid arguments. Otherwise
        // it returns minus the number of wrong answers.
        assert_eq!(error.to_string(), "expected an error text, found only the status 1234");
        assert_eq!(host.files().into_keys().collect::<Vec<_>>(), ["a.txt"]);
        assert!(host.open_files().is_empty());
        assert_eq!(output.finish().unwrap_err().to_string(), "expected an error text, found only the status -7");
    }
}

/// The tutorial contains whole files, which must equal the files that the build uses.
#[test]
fn the_tutorial_shows_the_samples_as_they_are() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap().replace("\r\n", "\n");
    let tutorial = read("docs/PLUGINS.md");
    for (language, path) in [
        ("toml", "examples/rust-plugin/Cargo.toml"),
        ("rust", "examples/rust-plugin/src/lib.rs"),
        ("rust", "examples/rust-plugin/src/centre_view.rs"),
        ("c", "examples/c-plugin/lumistack_plugin_c_means.c"),
    ] {
        let shown = format!("```{language}\n{}```\n", read(path));
        assert!(tutorial.contains(&shown), "docs/PLUGINS.md does not show {path} as it is");
    }
}
