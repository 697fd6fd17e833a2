//! `lumistack devices`, and `--device` of the commands that solve.

use std::path::Path;
use std::process::Command;

use crate::common::{cached, fail, lumistack, number, report, succeed, write_test_field};
use crate::live::{Live, write_job};

/// Largest difference between the score of a device and the score of the processor, dB.
const SAME_DB: f64 = 0.01;
/// Largest difference of the scores in a live display, dB. It is larger than [`SAME_DB`], since the
/// number of iterations per step depends on the time that an iteration takes.
const LIVE_DB: f64 = 0.3;

/// Solves a light field on a device.
fn solve(folder: &Path, run: &str, device: &str) -> Command {
    let mut command = lumistack();
    command.arg("factorize").arg(folder.join("views.npy")).arg("-o").arg(folder.join(run));
    command.args(["--fov", "20x20", "--pitch-mm", "3", "--frames", "2", "--iterations", "4", "--device", device]);
    command
}

/// Makes a folder with a light field.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_test_field(&folder.path().join("views.npy"), [3, 3, 16, 24], 20.0, 3.0);
    folder
}

#[test]
fn a_missing_device_is_one_error() {
    let folder = folder();
    // set the variable XDG_RUNTIME_DIR, since without it Mesa's drivers print an error
    let text = fail(solve(folder.path(), "run", "gpu:no such adapter").env("XDG_RUNTIME_DIR", folder.path()));
    if cfg!(feature = "gpu") {
        assert!(text.contains("expected a graphics processor whose name contains `no such adapter`, found "), "{text}");
    } else {
        assert!(text.contains("factorize.device") && text.contains("without the feature `gpu`"), "{text}");
    }
    assert!(!folder.path().join("run/layers").exists());
    let text = fail(&mut solve(folder.path(), "run", "cuda"));
    assert!(text.contains("expected `auto`, `cpu`, `gpu` or `gpu:NAME`, found `cuda`"), "{text}");
}

#[test]
fn an_adapter_solves_as_the_processor_does() {
    let json: serde_json::Value = serde_json::from_str(&succeed(lumistack().args(["devices", "--json"]))).unwrap();
    let text = succeed(lumistack().arg("devices"));
    if !cfg!(feature = "gpu") {
        assert!(json["note"].is_string() && text.contains("without the feature `gpu`"), "{json} {text}");
        return;
    }
    let Some(adapter) = json["devices"][0]["name"].as_str() else {
        lumistack_testkit::skip::skipped("no adapter with Vulkan, Metal or Direct3D 12");
        return;
    };
    assert!(text.contains(adapter), "{text}");
    let folder = folder();
    succeed(&mut solve(folder.path(), "cpu", "cpu"));
    let on_device = format!("gpu:{adapter}");
    succeed(&mut solve(folder.path(), "device", &on_device));
    let [here, there] = ["cpu", "device"].map(|run| number(&report(&folder.path().join(run)), "psnr_view"));
    assert!((here - there).abs() < SAME_DB, "{here} dB and {there} dB");
    // a cached result of the device is used for the device again, but not for the processor
    let run = folder.path().join("device");
    succeed(&mut solve(folder.path(), "device", &on_device));
    assert!(cached(&run, "factorize"));
    succeed(&mut solve(folder.path(), "device", "cpu"));
    assert!(!cached(&run, "factorize"));
}

/// Live displays also solve on the device.
#[test]
fn a_live_display_solves_on_an_adapter() {
    if !cfg!(feature = "gpu") {
        return;
    }
    let json: serde_json::Value = serde_json::from_str(&succeed(lumistack().args(["devices", "--json"]))).unwrap();
    let Some(adapter) = json["devices"][0]["name"].as_str() else {
        lumistack_testkit::skip::skipped("no adapter with Vulkan, Metal or Direct3D 12");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let job = write_job(folder.path());
    let scores = ["cpu".to_owned(), format!("gpu:{adapter}")].map(|device| {
        let mut live = Live::start(&job, &folder.path().join("run"), &["--device", &device]);
        live.state(|_| true);
        live.command(&serde_json::json!({"set": {"display.brightness": 0.4}}));
        // wait until the solve of the second content has ended, which is after 60 iterations
        let last = live.state(|state| state["content"] == 2 && state["updates"] == 60);
        live.stop();
        last["psnr_view"].as_f64().unwrap()
    });
    assert!((scores[0] - scores[1]).abs() < LIVE_DB, "{scores:?}");
}

#[test]
fn tasks_of_the_processor_alone_refuse_a_device() {
    let folder = folder();
    let job = folder.path().join("job.toml");
    let solved = "light_field = \"views.npy\"\n[geometry]\nfov_deg = [20, 20]\npitch_mm = 3.0\n\
        [display]\npreset = \"fig7-uniform\"\nframes = 2\n[factorize]\ndevice = \"gpu\"\n";
    for (command, rest, reason) in [
        ("sweep", "[sweep]\nlayers = [1, 2]\n", "designs of a sweep are solved only on the processor"),
        ("run", "tiles = [2, 1]\n", "tiles are solved only on the processor"),
    ] {
        std::fs::write(&job, format!("{solved}{rest}")).unwrap();
        let text = fail(lumistack().arg(command).arg(&job).arg("-o").arg(folder.path().join(command)));
        // A build without devices may state the missing feature as the reason.
        let unbuilt = !cfg!(feature = "gpu") && text.contains("built without the feature `gpu`");
        assert!(text.contains("factorize.device") && (unbuilt || text.contains(reason)), "{text}");
    }
}
