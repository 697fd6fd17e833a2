//! The documentation as pages, in `target/site`.

use std::path::PathBuf;

use crate::tools::{self, Outcome, command, install, output_of, run};

/// What makes pages of Markdown, as pip takes it.
const TOOLS: [&str; 2] = ["--only-binary=:all:", "markdown==3.*"];

/// Makes the pages; every link between them is followed.
pub fn build() -> Outcome {
    let python = tools::python()?;
    if output_of(command(&python).args(["-c", "import markdown"])).is_none() {
        install(&python, &TOOLS)?;
    }
    let site: PathBuf = tools::root().join("target/site");
    run(command(&python).arg("xtask/site/build.py").arg(&site))
}
