//! Runs of scenes and light fields of other projects. For a scene, the tests name a display, but
//! neither window nor light. The program chooses both, and the pictures must have content.

use crate::common::{assets, lumistack, number, report, succeed};

/// Smallest fraction of the window that the object must cover. This limit is small, since the whole
/// object is visible, and a slender object covers only a small part of a wide window.
const COVERAGE: f64 = 0.13;
/// Smallest difference between the 1st and the 99th percentile of the target's values.
const SPAN: f64 = 0.3;
/// Smallest PSNR over the whole zone at the brightness β = 0.2, dB.
const PSNR_DB: f64 = 23.0;

/// Files that need no settings except the display.
const FILES: [&str; 5] = [
    "FlightHelmet/FlightHelmet.gltf",
    "CornellBox/CornellBox.glb",
    "2CylinderEngine/2CylinderEngine.glb",
    "Lights/Lights.glb",
    "TransmissionRoughnessTest/TransmissionRoughnessTest.glb",
];

fn check(flags: &[&str]) {
    let Some(assets) = assets() else { return };
    let folder = tempfile::tempdir().unwrap();
    for file in FILES {
        let run = folder.path().join(file.split('/').next().unwrap());
        let scene = assets.join("gltf").join(file);
        succeed(
            lumistack().arg("run").arg(&scene).args(["--display", "paper-three-layer"]).arg("-o").arg(&run).args(flags),
        );
        let report = report(&run);
        let scene = &report["scene"];
        let (coverage, span) = (number(scene, "coverage"), number(scene, "target span"));
        let zone = number(&report, "psnr_zone");
        println!("{file}: coverage {coverage:.2}, span {span:.2}, psnr_zone {zone:.1} dB");
        assert!(coverage >= COVERAGE, "{file}: the object covers {coverage} of the window");
        assert!(span >= SPAN, "{file}: the target spans {span}");
        assert!(zone >= PSNR_DB, "{file}: {zone} dB");
    }
}

#[test]
fn files_with_nothing_set_small() {
    check(&["--resolution", "84x52", "--samples", "16"]);
}

/// Renders the files with the display's own resolution and number of frames.
#[test]
#[ignore = "slow: renders five scenes at 840 × 525"]
fn files_with_nothing_set() {
    check(&[]);
}

/// Solves light fields of other projects, and checks the PSNR over their views.
#[test]
fn foreign_light_fields() {
    let Some(assets) = assets() else { return };
    let folder = tempfile::tempdir().unwrap();
    for (name, flags) in [
        ("shop-9x9", ["--views", "5x5", "--resolution", "120x80"].as_slice()),
        ("quilt-4x8-solids/example02.png", &["--quilt", "4x8", "--fov", "35x1", "--resolution", "96x64"]),
    ] {
        let run = folder.path().join(name.split('/').next().unwrap());
        let mut command = lumistack();
        command.arg("factorize").arg(assets.join("lightfields").join(name)).arg("-o").arg(&run).args(flags);
        succeed(command.args(["--frames", "6", "--iterations", "50"]));
        let psnr = number(&report(&run), "psnr_view");
        println!("{name}: {psnr:.1} dB");
        assert!(psnr > 18.0, "{name}: {psnr} dB");
    }
}
