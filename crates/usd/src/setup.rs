//! `lumistack setup usd`: creates a Python environment with OpenUSD.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use lumistack_core::Cancel;

use crate::UsdError;
use crate::child::{last_lines, read_end, wait};
use crate::python::{Surroundings, interpreter, own_environment};

/// Python code that prints the version of the interpreter, and fails if the version is too old.
const VERSION: &str =
    "import sys, platform; print('Python', platform.python_version()); sys.exit(sys.version_info < (3, 8))";
/// Python code that prints the version of OpenUSD, and fails if OpenUSD is missing or older than
/// the version that `python/boot.py` requires.
pub(crate) const CHECK: &str = "import sys\ntry: from pxr import Usd, Sdf\nexcept ImportError as error: sys.exit(str(error))\n\
    v = Usd.GetVersion()\n\
    if v < (0, 23, 5): sys.exit('OpenUSD %d.%02d is older than 23.05' % v[1:])\n\
    print('OpenUSD %d.%02d' % v[1:], 'with' if Sdf.FileFormat.FindByExtension('mtlx') else 'without', 'MaterialX')";

/// Options of the setup.
#[derive(Clone, Debug, Default)]
pub struct Setup {
    /// The Python that creates the environment; `None`: the first Python on PATH that is new
    /// enough.
    pub python: Option<PathBuf>,
    /// Install usd-exchange, whose OpenUSD reads MaterialX files, instead of usd-core.
    pub materialx: bool,
    /// Folder of the environment. `None`: `lumistack/python` in the user's data folder, where
    /// [`load`](crate::load) searches a Python.
    pub folder: Option<PathBuf>,
}

impl Setup {
    /// Creates the environment anew, and returns its interpreter. `say` receives lines of progress,
    /// among them the lines that pip prints to standard output.
    ///
    /// # Errors
    /// If no Python or no data folder is found, if a step fails, or if the setup is cancelled. If a
    /// step in the environment's folder fails or is cancelled, the folder is removed.
    pub fn run(&self, say: &mut dyn FnMut(&str), cancel: &Cancel) -> Result<PathBuf, UsdError> {
        let fault = |expected: &str, found: String| UsdError::Setup { expected: expected.into(), found };
        let folder = self.folder.clone().or_else(own_environment);
        let folder = folder.ok_or_else(|| {
            fault("a data folder of the user", "no absolute path in HOME, XDG_DATA_HOME or LOCALAPPDATA".into())
        })?;
        let (base, version) = self.base(cancel)?;
        let package = if self.materialx { "usd-exchange" } else { "usd-core" };
        say(&format!("{version} ({}) makes an environment in {}", base.display(), folder.display()));
        let made = self.make(&base, &folder, package, say, cancel);
        if made.is_err() {
            // remove the folder, which may be incomplete
            let _ = std::fs::remove_dir_all(&folder);
        }
        made
    }

    /// Finds the Python that creates the environment. Returns its path and its version.
    fn base(&self, cancel: &Cancel) -> Result<(PathBuf, String), UsdError> {
        let on_path = Surroundings::default().candidates().into_iter().map(|candidate| candidate.program);
        let programs: Vec<PathBuf> = match &self.python {
            Some(program) => vec![program.clone()],
            None => on_path.collect(),
        };
        let mut tried = Vec::new();
        for program in programs {
            match run(Command::new(&program).args(["-c", VERSION]), &mut |_| {}, cancel)? {
                Ok(said) => return Ok((program, said.trim().to_owned())),
                Err(found) => tried.push(format!("{}: {found}", program.display())),
            }
        }
        let expected =
            "Python 3.8 or newer on PATH (from python.org, or `apt install python3-venv`), or its name after --python";
        Err(UsdError::Setup { expected: expected.into(), found: tried.join("; ") })
    }

    fn make(
        &self,
        base: &Path,
        folder: &Path,
        package: &str,
        say: &mut dyn FnMut(&str),
        cancel: &Cancel,
    ) -> Result<PathBuf, UsdError> {
        let step = |expected: String, result: Result<String, String>| {
            result.map_err(|found| UsdError::Setup { expected, found })
        };
        let made = run(Command::new(base).args(["-m", "venv", "--clear"]).arg(folder), &mut |_| {}, cancel)?;
        step(format!("`{} -m venv` to make an environment", base.display()), made)?;
        let python = interpreter(folder);
        let mut pip = Command::new(&python);
        pip.args(["-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off", package]);
        step(format!("`pip install {package}` to succeed"), run(&mut pip, say, cancel)?)?;
        let checked = run(Command::new(&python).args(["-c", CHECK]), &mut |_| {}, cancel)?;
        let version = step(format!("`import pxr` to succeed after `pip install {package}`"), checked)?;
        say(&format!(
            "{} is ready; USD files are read by {}, unless LUMISTACK_PYTHON is set or an active environment has OpenUSD",
            version.trim(),
            python.display()
        ));
        Ok(python)
    }
}

/// Runs a program to its end. Returns its standard output, or its failure. `line` is called with
/// each line of standard output while the program runs. Output after the first MiB is not read.
pub(crate) fn run(
    command: &mut Command,
    line: &mut dyn FnMut(&str),
    cancel: &Cancel,
) -> Result<Result<String, String>, UsdError> {
    let mut child = match command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn() {
        Ok(child) => child,
        Err(error) => return Ok(Err(format!("cannot be started: {error}"))),
    };
    // Read both streams in threads, so that neither pipe blocks the program.
    let said = read_end(child.stderr.take());
    let (lines, printed) = std::sync::mpsc::channel();
    let output = child.stdout.take();
    let reader = std::thread::spawn(move || {
        for text in output.into_iter().flat_map(|output| BufReader::new(output.take(1 << 20)).lines()) {
            let Ok(text) = text else { break };
            let _ = lines.send(text);
        }
    });
    // Report lines while the program runs.
    let mut all = String::new();
    let mut take = |text: String| {
        line(text.trim());
        all.push_str(&text);
        all.push('\n');
    };
    let status = wait(&mut child, cancel, &mut || printed.try_iter().for_each(&mut take))?;
    let _ = reader.join();
    printed.try_iter().for_each(&mut take);
    let said = said.join().unwrap_or_default();
    if status.success() {
        return Ok(Ok(all));
    }
    let last = last_lines(&said, &all);
    Ok(Err(if last.is_empty() { status.to_string() } else { format!("{status}; last output: {last}") }))
}
