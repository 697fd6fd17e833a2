//! `lumistack doctor`: reports optional software and hardware of this machine, and how to get the
//! missing parts.

use std::path::Path;

use lumistack_core::Cancel;
use lumistack_pipeline::{PipelineError, Registry, oidn_version};
use lumistack_simd::Backend;
use lumistack_usd::{There, UsdError};
use serde_json::json;

use crate::console::say;
use crate::program;

pub(crate) const EXAMPLES: &str = "OpenUSD, Blender, Open Image Denoise, graphics processors and panels are optional. Without them, the program still turns glTF scenes into patterns, pictures and web pages.\n\n\
    Examples:\n  lumistack doctor\n  lumistack --json doctor      prints the same as one JSON object";

/// Memory or disk space that a run of the paper's size may need, MiB.
const ENOUGH_MIB: u64 = 4096;

/// The result of one check.
struct Finding {
    what: &'static str,
    found: Found,
}

enum Found {
    Good(String),
    /// The checked item works, but not well: its state, and how to improve it.
    Poor(String, String),
    /// The checked item is missing: the places that were searched, and how to get the item.
    Missing(String, String),
}

/// Checks this machine, and prints the results.
pub(crate) fn run(registry: &Registry, json: bool, cancel: &Cancel) -> Result<(), PipelineError> {
    let findings = look(registry, cancel)?;
    if json {
        let of = |finding: &Finding| {
            let (state, found, help) = parts(&finding.found);
            json!({ "what": finding.what, "state": state, "found": found, "help": help })
        };
        let findings: Vec<_> = findings.iter().map(of).collect();
        say!("{}", json!({ "event": "doctor", "version": env!("CARGO_PKG_VERSION"), "findings": findings }));
        return Ok(());
    }
    let width = findings.iter().map(|finding| finding.what.len()).max().unwrap_or(0);
    for finding in &findings {
        let (state, found, help) = parts(&finding.found);
        let mut lines = found.lines();
        say!("{state:>7}  {:width$}  {}", finding.what, lines.next().unwrap_or_default());
        lines.for_each(|line| say!("{:>7}  {:width$}  {line}", "", ""));
        if let Some(help) = help {
            say!("{:>7}  {:width$}  {}", "", "", program::hinted(help));
        }
    }
    Ok(())
}

fn parts(found: &Found) -> (&'static str, &str, Option<&str>) {
    match found {
        Found::Good(found) => ("good", found, None),
        Found::Poor(found, help) => ("poor", found, Some(help)),
        Found::Missing(found, help) => ("missing", found, Some(help)),
    }
}

fn look(registry: &Registry, cancel: &Cancel) -> Result<Vec<Finding>, PipelineError> {
    let python = "run `lumistack setup usd` to install OpenUSD, or set LUMISTACK_PYTHON to a Python that has OpenUSD; docs/USD.md has the details";
    let blender = "install Blender 4.2 or newer from blender.org, or set LUMISTACK_BLENDER to the program Blender; docs/BLENDER.md has the details";
    let found = [
        ("program", program_itself()),
        ("processor", processor()),
        ("memory", memory()),
        ("disk", disk(Path::new("."))),
        ("plugins", plugins(registry)),
        ("USD files", reader(lumistack_usd::openusd(cancel), python)?),
        (".blend files", reader(lumistack_usd::blender(cancel), blender)?),
        ("denoiser oidn", denoiser()),
        ("graphics", graphics()),
        ("panels", panels()),
    ];
    Ok(found.into_iter().map(|(what, found)| Finding { what, found }).collect())
}

fn program_itself() -> Found {
    let version = env!("CARGO_PKG_VERSION");
    let place = std::env::current_exe().map_or_else(|_| String::new(), |place| format!(", {}", place.display()));
    let found = format!("version {version}{place}");
    if cfg!(debug_assertions) {
        return Found::Poor(
            found,
            "this is a development build, about half as fast as a build by `cargo build --release`".into(),
        );
    }
    Found::Good(found)
}

fn processor() -> Found {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let best = Backend::best().to_string();
    let found = format!("{threads} threads, {best}");
    if best == "portable" && cfg!(target_arch = "x86_64") {
        let help = "a processor with AVX2 (since 2013) renders and solves several times faster";
        return Found::Poor(found, help.into());
    }
    Found::Good(found)
}

/// Rates the memory that is available to programs.
fn memory() -> Found {
    let mut system = match sysinfo::System::new() {
        Ok(system) => system,
        Err(error) => {
            let help = "`lumistack run --plan` estimates the memory of a job";
            return Found::Poor(format!("not known: {error}"), help.into());
        }
    };
    system.refresh_memory();
    let (free, all) = (system.available_memory() >> 20, system.total_memory() >> 20);
    rated(
        free,
        format!("{free} MiB free of {all} MiB"),
        "the key `render.field_mib` of a job limits the memory of the light field; docs/JOB.md explains the key",
    )
}

/// Rates the free disk space of the working folder.
fn disk(folder: &Path) -> Found {
    match fs4::available_space(folder) {
        Ok(bytes) => {
            let free = bytes >> 20;
            rated(free, format!("{free} MiB free in this folder"), "`lumistack clean runs/*` removes cached results")
        }
        Err(error) => {
            Found::Poor(format!("the free space is not known: {error}"), "run the command in another folder".into())
        }
    }
}

fn rated(mib: u64, found: String, help: &str) -> Found {
    if mib < ENOUGH_MIB { Found::Poor(found, help.into()) } else { Found::Good(found) }
}

fn plugins(registry: &Registry) -> Found {
    let failed = registry.failed();
    let count = registry.infos().count();
    if failed.is_empty() {
        return Found::Good(format!("{count}"));
    }
    let reasons: Vec<String> = failed.iter().map(ToString::to_string).collect();
    Found::Poor(
        format!("{count}; number of plugin libraries that cannot be used: {}", failed.len()),
        reasons.join("; "),
    )
}

fn reader(there: Result<There, UsdError>, help: &str) -> Result<Found, PipelineError> {
    Ok(match there? {
        Ok((program, version)) => Found::Good(format!("{version}, by {program}")),
        Err(tried) => Found::Missing(tried.join("\n"), help.into()),
    })
}

fn denoiser() -> Found {
    match oidn_version() {
        Ok(version) => Found::Good(version),
        Err(_) => {
            let help = "run `pip install pyoidn`, or set LUMISTACK_OIDN to the program `oidnDenoise`; the filters `shared` and `guided` need no other program";
            Found::Missing("the program `oidnDenoise` of Open Image Denoise was not found".into(), help.into())
        }
    }
}

/// Lists the graphics processors that can compute patterns.
fn graphics() -> Found {
    let adapters = match crate::devices::found() {
        Ok(adapters) => adapters,
        Err(why) => {
            return Found::Missing(
                why,
                "the processor computes the patterns instead; docs/GPU.md has the details".into(),
            );
        }
    };
    let lines: Vec<String> = adapters.iter().map(crate::devices::line).collect();
    match adapters.iter().any(|adapter| adapter.is_hardware) {
        true => Found::Good(lines.join("\n")),
        false => Found::Missing(
            if lines.is_empty() { "no adapter with Vulkan, Metal or Direct3D 12".into() } else { lines.join("\n") },
            "the processor computes the patterns instead; docs/GPU.md has the details".into(),
        ),
    }
}

/// Lists the outputs that `lumistack show` can drive.
fn panels() -> Found {
    match crate::show::outputs() {
        Ok(outputs) if outputs.is_empty() => {
            Found::Missing("no output".into(), "docs/PANELS.md explains how panels are connected".into())
        }
        Ok(outputs) => Found::Good(format!("outputs: {}", outputs.join(", "))),
        Err(found) => Found::Missing(found, "`lumistack preview RUN` shows a display in the browser instead".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn little_room_is_told_with_what_helps() {
        let (state, found, help) = {
            let found = rated(100, "100 MiB free".into(), "clean up");
            let (state, text, help) = parts(&found);
            (state, text.to_owned(), help.map(str::to_owned))
        };
        assert_eq!((state, found.as_str(), help.as_deref()), ("poor", "100 MiB free", Some("clean up")));
        assert_eq!(parts(&rated(ENOUGH_MIB, String::new(), "")).0, "good");
    }

    #[test]
    fn what_is_not_there_is_named_with_every_try() {
        let found = reader(Ok(Err(vec!["a from PATH: no".into(), "b from PATH: neither".into()])), "get one").unwrap();
        assert_eq!(parts(&found), ("missing", "a from PATH: no\nb from PATH: neither", Some("get one")));
    }

    #[test]
    fn memory_and_disk_are_known_here() {
        for found in [memory(), disk(Path::new("."))] {
            let text = parts(&found).1;
            let (free, _) = text.split_once(" MiB free").unwrap_or_else(|| panic!("{text}"));
            assert!(free.parse::<u64>().unwrap() > 0, "{text}");
        }
        // Windows finds the disk of a folder even if the folder does not exist.
        #[cfg(unix)]
        assert!(parts(&disk(Path::new("no such folder"))).1.starts_with("the free space is not known"));
    }
}
