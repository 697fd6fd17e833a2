//! Builds the web site in `target/site`: the documentation, and the gallery of displays.

use std::path::PathBuf;

use crate::tools::{self, Outcome, cargo, command, install, output_of, run};
use crate::web::target_folder;

/// The package for pip that converts Markdown.
const TOOLS: [&str; 2] = ["--only-binary=:all:", "markdown==3.*"];

/// Builds the documentation alone. Checks the links between its pages, and the list of the
/// gallery's displays. Also checks that every page has a picture.
pub fn docs() -> Outcome {
    pages(false)?;
    run(command(tools::python()?).args(["xtask/site/displays.py", "--check"]))
}

/// Makes the pictures of the documentation again; all of them if no name is given. The Python of
/// the tests must have the package `lumistack`, which `cargo xtask python` installs.
pub fn pictures(names: &[&str]) -> Outcome {
    let python = tools::python()?;
    tools::poppler();
    // the pictures of panels need a program with windows, and the picture of a report shows the
    // time of a release build
    cargo(&["build", "--quiet", "--release", "--package", "lumistack-cli", "--features", "panels"])?;
    let program = target_folder()?.join("release").join(format!("lumistack{}", std::env::consts::EXE_SUFFIX));
    let mut pictures = command(&python);
    pictures.arg("xtask/site/pictures.py").arg(program).arg(tools::root().join("target/site-pictures"));
    run(pictures.args(names).env("LUMISTACK_PYTHON", &python))
}

/// Builds the documentation, and makes every display of the gallery. Uses the results of earlier
/// calls again.
pub fn build() -> Outcome {
    pages(true)?;
    cargo(&["build", "--quiet", "--package", "lumistack-cli"])?;
    let program = target_folder()?.join("debug").join(format!("lumistack{}", std::env::consts::EXE_SUFFIX));
    let root = tools::root();
    let mut displays = command(tools::python()?);
    displays.arg("xtask/site/displays.py").arg(program);
    run(displays.args([root.join("target/site-displays"), folder(), root.join("scenes"), tools::assets()]))
}

fn folder() -> PathBuf {
    tools::root().join("target/site")
}

fn pages(displays: bool) -> Outcome {
    let python = tools::python()?;
    if output_of(command(&python).args(["-c", "import markdown"])).is_none() {
        install(&python, &TOOLS)?;
    }
    let mut build = command(&python);
    build.arg("xtask/site/build.py").arg(folder());
    run(build.args(displays.then_some("--displays")))
}
