//! Builds the documentation as a web site in `target/site`.

use std::path::PathBuf;

use crate::tools::{self, Outcome, command, install, output_of, run};

/// The package for pip that converts Markdown.
const TOOLS: [&str; 2] = ["--only-binary=:all:", "markdown==3.*"];

/// Builds the site, and checks every link between its pages.
pub fn build() -> Outcome {
    let python = tools::python()?;
    if output_of(command(&python).args(["-c", "import markdown"])).is_none() {
        install(&python, &TOOLS)?;
    }
    let site: PathBuf = tools::root().join("target/site");
    run(command(&python).arg("xtask/site/build.py").arg(&site))
}
