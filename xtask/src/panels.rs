//! Builds the windows of `lumistack show`, and tests them on real compositors without hardware.
//! Only builds with the feature `window` of the crate `lumistack-plugin-panels` contain the
//! windows, since winit and wgpu compile slowly.

use crate::tools::{EVERYTHING, Outcome, apt, build_everything, command, run, skipped};

/// Programs that the tests start, each with its Debian package.
const NEEDED: [(&str, &str); 6] = [
    ("sway", "sway"),
    ("grim", "grim"),
    ("Xorg", "xserver-xorg-core"),
    ("xrandr", "x11-xserver-utils"),
    ("import", "imagemagick"),
    ("setpriv", "util-linux"),
];
/// Debian packages of libraries and drivers, each with a file that shows that it is installed.
const LIBRARIES: [(&str, &str); 4] = [
    ("/usr/lib/xorg/modules/drivers/dummy_drv.so", "xserver-xorg-video-dummy"),
    ("/usr/share/vulkan/icd.d", "mesa-vulkan-drivers"),
    ("/usr/share/doc/libvulkan1", "libvulkan1"),
    ("/usr/share/doc/libxkbcommon-x11-0", "libxkbcommon-x11-0"),
];

/// Numbers of repetitions if `full` is set: how often presentations are started, and how often a
/// solver pauses.
const FULL_TURNS: [&str; 2] = ["50", "5"];

/// Builds and tests the windows. With `full` it repeats tests that would fail only rarely, which
/// takes some minutes more.
pub fn check(full: bool) -> Outcome {
    sessions(full)?;
    stalls(full)
}

/// Tests the windows of `lumistack show` on several compositors, one after another. Other programs
/// may run meanwhile.
pub fn sessions(full: bool) -> Outcome {
    if let Err(error) = fetch() {
        skipped("panels", &format!("not tested on every compositor: {error}"));
    }
    tests("end_to_end", &["show::", "calibrate::"], full.then_some(FULL_TURNS[0]))
}

/// Tests that a solver that stalls delays no refresh. Other programs would delay refreshes too, so
/// none may run meanwhile.
pub fn stalls(full: bool) -> Outcome {
    tests("solver", &[], full.then_some(FULL_TURNS[1]))
}

fn tests(binary: &str, names: &[&str], turns: Option<&str>) -> Outcome {
    build_everything()?;
    let mut cargo = command("cargo");
    cargo.arg("test").args(EVERYTHING).args(["--test", binary]);
    cargo.args(["--", "--nocapture", "--test-threads=1"]).args(names).env("LUMISTACK_SESSIONS", "1");
    if let Some(turns) = turns {
        cargo.env("LUMISTACK_PANELS_TURNS", turns);
    }
    run(&mut cargo)
}

/// Fetches missing packages. Without them the tests of panels are skipped.
///
/// # Errors
/// If a package cannot be installed.
pub fn fetch() -> Outcome {
    let has = |program: &str| {
        std::env::var_os("PATH")
            .is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join(program).is_file()))
    };
    let programs = NEEDED.iter().filter(|(program, _)| !has(program)).map(|(_, package)| *package);
    let libraries =
        LIBRARIES.iter().filter(|(file, _)| !std::path::Path::new(file).exists()).map(|(_, package)| *package);
    let missing: Vec<&str> = programs.chain(libraries).collect();
    if missing.is_empty() { Ok(()) } else { apt(&missing, "test panels") }
}
