//! Finds Pythons that may read USD files.

use std::env::var_os;
use std::path::{Path, PathBuf};

/// Environment variable that names the only Python that is tried.
pub(crate) const VARIABLE: &str = "LUMISTACK_PYTHON";

/// A Python that may have OpenUSD, or a program that may read `.blend` files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Candidate {
    pub(crate) program: PathBuf,
    /// Source of the program's path, such as a variable or `PATH`, for messages.
    pub(crate) from: &'static str,
    /// True if an environment variable of Lumistack names this program.
    pub(crate) given: bool,
}

/// The environment variables and folders in which a Python is searched.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surroundings {
    pub(crate) given: Option<PathBuf>,
    /// Folders of the active virtual and conda environments.
    pub(crate) active: [Option<PathBuf>; 2],
    /// Folder of the environment that `lumistack setup usd` makes.
    pub(crate) own: Option<PathBuf>,
}

impl Surroundings {
    pub(crate) fn of_system() -> Self {
        let path = |name: &str| var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        Self {
            given: path(VARIABLE),
            active: [path("VIRTUAL_ENV"), path("CONDA_PREFIX")],
            own: own_environment().filter(|folder| folder.is_dir()),
        }
    }

    /// Returns the Pythons that are tried, in this order.
    pub(crate) fn candidates(&self) -> Vec<Candidate> {
        if let Some(program) = &self.given {
            return vec![Candidate { program: program.clone(), from: VARIABLE, given: true }];
        }
        let candidate = |program: PathBuf, from| Candidate { program, from, given: false };
        let [virtual_env, conda] = &self.active;
        let mut found: Vec<Candidate> = Vec::new();
        found.extend(virtual_env.iter().map(|folder| candidate(interpreter(folder), "the active virtual environment")));
        found.extend(conda.iter().map(|folder| candidate(conda_interpreter(folder), "the active conda environment")));
        found.extend(self.own.iter().map(|folder| candidate(interpreter(folder), "lumistack setup usd")));
        let on_path: &[&str] = if cfg!(windows) { &["python", "python3"] } else { &["python3", "python"] };
        found.extend(on_path.iter().map(|name| candidate(name.into(), "PATH")));
        found
    }
}

/// Returns the file to which a program's name refers. A name with a folder is the file's path. A
/// name without a folder is searched in the folders of `PATH`.
pub(crate) fn on_path(program: &Path) -> Option<PathBuf> {
    let file = if cfg!(windows) { program.with_extension("exe") } else { program.to_owned() };
    if file.components().count() > 1 {
        return file.is_file().then_some(file);
    }
    std::env::split_paths(&var_os("PATH")?).map(|folder| folder.join(&file)).find(|place| place.is_file())
}

/// Returns the path of the interpreter in a virtual environment.
pub(crate) fn interpreter(environment: &Path) -> PathBuf {
    if cfg!(windows) { environment.join("Scripts/python.exe") } else { environment.join("bin/python") }
}

fn conda_interpreter(environment: &Path) -> PathBuf {
    if cfg!(windows) { environment.join("python.exe") } else { environment.join("bin/python") }
}

/// Returns the environment that `lumistack setup usd` makes: `lumistack/python` in the user's data
/// folder.
pub(crate) fn own_environment() -> Option<PathBuf> {
    let folder = |name: &str| var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let data = if cfg!(windows) {
        folder("LOCALAPPDATA")
    } else if cfg!(target_os = "macos") {
        folder("HOME").map(|home| home.join("Library/Application Support"))
    } else {
        folder("XDG_DATA_HOME").or_else(|| Some(folder("HOME")?.join(".local/share")))
    };
    Some(data?.join("lumistack").join("python"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_given_python_is_the_only_one() {
        let mut surroundings = Surroundings {
            given: Some("/opt/python".into()),
            active: [Some("/venv".into()), Some("/conda".into())],
            own: Some("/data".into()),
        };
        let given = surroundings.candidates();
        assert_eq!(given.len(), 1);
        assert!(given[0].given && given[0].program == Path::new("/opt/python"));
        surroundings.given = None;
        let from: Vec<_> = surroundings.candidates().iter().map(|candidate| candidate.from).collect();
        let environments = ["the active virtual environment", "the active conda environment", "lumistack setup usd"];
        assert_eq!(from, [&environments[..], &["PATH", "PATH"]].concat());
        assert!(Surroundings::default().candidates().iter().all(|candidate| candidate.from == "PATH"));
    }
}
