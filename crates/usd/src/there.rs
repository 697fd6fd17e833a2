//! Reports which programs can read USD and Blender files on this machine, without reading a file.

use std::process::Command;

use lumistack_core::Cancel;

use crate::python::{Candidate, Surroundings};
use crate::setup::{CHECK, run};
use crate::{UsdError, blend};

/// Python code that prints the version of the module bpy, and fails if the module is missing.
const BPY: &str = "import sys\ntry: import bpy\nexcept ImportError as error: sys.exit(str(error))\n\
    print('Blender', bpy.app.version_string, 'as a module')";

/// Oldest supported version of Blender, as in `python/blend.py`.
const OLDEST_BLENDER: [u32; 2] = [4, 2];

/// `Ok` has the program that reads a kind of file, and the version of OpenUSD or Blender. If there
/// is no such program, `Err` lists the programs that were tried, each with its failure.
pub type There = Result<(String, String), Vec<String>>;

/// Finds the first Python that has a supported version of OpenUSD.
///
/// # Errors
/// If the search is cancelled.
pub fn openusd(cancel: &Cancel) -> Result<There, UsdError> {
    first_of(
        &Surroundings::of_system().candidates(),
        |candidate| {
            let mut command = Command::new(&candidate.program);
            command.args(["-c", CHECK]).env("PYTHONSAFEPATH", "1");
            command
        },
        |_| None,
        cancel,
    )
}

/// Finds the Blender that reads `.blend` files.
///
/// # Errors
/// If the search is cancelled.
pub fn blender(cancel: &Cancel) -> Result<There, UsdError> {
    first_of(
        &blend::candidates(),
        |candidate| {
            let mut command = Command::new(&candidate.program);
            match blend::is_python(&candidate.program) {
                true => command.args(["-c", BPY]).env("PYTHONSAFEPATH", "1"),
                false => command.arg("--version"),
            };
            command
        },
        too_old,
        cancel,
    )
}

/// Returns the failure of a Blender that is too old. `said` begins with "Blender" and a version.
fn too_old(said: &str) -> Option<String> {
    let number = |text: &str| text.chars().take_while(char::is_ascii_digit).collect::<String>().parse::<u32>().ok();
    let mut parts = said.strip_prefix("Blender ")?.split('.').map(number);
    let version = [parts.next()??, parts.next()??];
    let [major, minor] = OLDEST_BLENDER;
    (version < OLDEST_BLENDER).then(|| format!("{said}; {major}.{minor} is the oldest supported version"))
}

fn first_of(
    candidates: &[Candidate],
    question: impl Fn(&Candidate) -> Command,
    refusal: impl Fn(&str) -> Option<String>,
    cancel: &Cancel,
) -> Result<There, UsdError> {
    let mut tried = Vec::new();
    for candidate in candidates {
        let program = candidate.program.display().to_string();
        match run(&mut question(candidate), &mut |_| {}, cancel)? {
            Ok(said) => {
                // Blender prints its version first, and then details of its build
                let version = said.lines().next().unwrap_or_default().trim();
                match refusal(version) {
                    None => return Ok(Ok((program, version.to_owned()))),
                    Some(found) => tried.push(format!("{program} from {}: {found}", candidate.from)),
                }
            }
            Err(found) => tried.push(format!("{program} from {}: {found}", candidate.from)),
        }
    }
    Ok(Err(tried))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::child::fake;

    #[test]
    fn the_first_that_answers_is_named_and_those_before_it_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let broken = fake(folder.path(), "broken", "echo no module >&2; exit 1");
        let good = fake(folder.path(), "good", "echo Version 7; echo built on a Monday");
        let ask = |candidates: &[Candidate]| {
            first_of(candidates, |candidate| Command::new(&candidate.program), too_old, &Cancel::default()).unwrap()
        };
        let (found, version) = ask(&[broken.clone(), good]).unwrap();
        assert!(found.ends_with("good") && version == "Version 7", "{found}: {version}");
        // a Blender that is too old does not count
        let old = fake(folder.path(), "blender", "echo Blender 3.4.1; echo built on a Monday");
        let new = fake(folder.path(), "blender-4", "echo Blender 4.2.0 LTS");
        assert_eq!(ask(&[old.clone(), new]).unwrap().1, "Blender 4.2.0 LTS");
        let tried = ask(&[old]).unwrap_err();
        assert!(tried[0].contains("Blender 3.4.1; 4.2 is the oldest supported version"), "{tried:?}");
        let missing = Candidate { program: folder.path().join("nowhere"), from: "PATH", given: false };
        let tried = ask(&[broken, missing]).unwrap_err();
        assert!(tried[0].contains("broken from PATH") && tried[0].contains("no module"), "{tried:?}");
        assert!(tried[1].contains("nowhere from PATH: cannot be started"), "{tried:?}");
    }
}
