//! The folder of a run: one owner at a time, nothing foreign replaced, no input written over.
//!
//! ```text
//! cache/lumistack.lock     locked by the operating system while a run works here, so that a dead owner holds nothing; also what marks a folder as ours
//! cache/owner.json         process and host of the owner, for messages alone
//! job.toml, display.toml   begin with a line that holds a hash of the rest: a file that somebody else wrote or changed is told from ours
//! ```

use std::ffi::OsStr;
use std::fs::{File, TryLockError};
use std::path::{Component, Path, PathBuf};
use std::time::Duration;

use lumistack_core::{Task, config};
use lumistack_display::Display;
use lumistack_plugin_host::Registry;
use serde::{Deserialize, Serialize};

use crate::clean;
use crate::error::PipelineError;
use crate::file_params;
use crate::files::{check_folder, write};
use crate::job::Job;

const LOCK: &str = "lumistack.lock";
pub(crate) const OWNER: &str = "owner.json";
/// Of a preview that is made into a run's folder, beside a run that may be at work.
const PREVIEW_LOCK: &str = "preview.lock";
const SEAL: &str = "# Written by Lumistack; the next run into this folder replaces it. BLAKE3 of the rest: ";
/// How often the owner's name is looked for: it is written a moment after the lock is taken.
const LOOKS: u32 = 25;

/// What works in a folder, which says under which names it writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// A run, with nodes or without.
    Run,
    /// Times in folders of their own.
    Sequence,
    /// Views alone.
    Views,
    /// Many designs.
    Sweep,
}

impl Work {
    /// Whether a file or folder directly in the run's folder is one that the work writes.
    fn writes(self, name: &OsStr) -> bool {
        let Some(name) = name.to_str() else { return false };
        if name == "cache" {
            return true;
        }
        match self {
            Self::Run => matches!(
                name,
                "job.toml"
                    | "display.toml"
                    | "target"
                    | "held-out"
                    | "outside"
                    | "layers"
                    | "outputs"
                    | "nodes"
                    | "report.html"
                    | "report.json"
            ),
            Self::Sequence => matches!(name, "job.toml" | "report.html" | "report.json") || is_time(name),
            Self::Views => name == "lightfield.json" || (name.starts_with("view_") && name.ends_with(".exr")),
            Self::Sweep => matches!(
                name,
                "job.toml" | "designs" | "fields" | "plots" | "proposed.toml" | "sweep.csv" | "sweep.json"
            ),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Run => "a run",
            Self::Sequence => "a sequence",
            Self::Views => "`render`",
            Self::Sweep => "a sweep",
        }
    }
}

/// Name of a sequence's time: t0001.
pub(crate) fn is_time(name: &str) -> bool {
    name.strip_prefix('t').is_some_and(|digits| digits.len() >= 4 && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// A run folder that belongs to this process until it is dropped.
#[derive(Debug)]
pub(crate) struct Owned {
    lock: Option<File>,
    cache: PathBuf,
    file: &'static str,
    /// Folders that were not there before, outermost first.
    made: Vec<PathBuf>,
}

#[derive(Serialize, Deserialize)]
struct Owner {
    process: u32,
    host: String,
}

/// Takes the folder for a job after checking that the job's files, and what others put there, are safe from it; sweeps what killed runs left.
///
/// # Errors
/// When somebody else works there, something foreign has a name that the work writes, or an input lies where the work writes.
pub(crate) fn take(
    dir: &Path,
    work: Work,
    job: &Job,
    registry: &Registry,
    task: Task<'_>,
) -> Result<Owned, PipelineError> {
    check_folder(dir)?;
    check_inputs(dir, work, job, registry)?;
    check_foreign(dir, work)?;
    let owned = Owned::lock(dir, LOCK, task)?;
    clean::sweep_left_overs(dir);
    Ok(owned)
}

/// Takes a folder that is known to be a run's.
pub(crate) fn take_known(dir: &Path, task: Task<'_>) -> Result<Owned, PipelineError> {
    Owned::lock(dir, LOCK, task)
}

/// Takes the place of a run's preview, which does not disturb the run.
pub(crate) fn take_preview(dir: &Path, task: Task<'_>) -> Result<Owned, PipelineError> {
    Owned::lock(dir, PREVIEW_LOCK, task)
}

impl Owned {
    fn lock(dir: &Path, file: &'static str, task: Task<'_>) -> Result<Self, PipelineError> {
        let cache = dir.join("cache");
        let made: Vec<PathBuf> = cache.ancestors().take_while(|path| !path.exists()).map(Path::to_path_buf).collect();
        let mut owned = Self { lock: None, cache: cache.clone(), file, made: made.into_iter().rev().collect() };
        let path = cache.join(file);
        loop {
            lumistack_field_io::atomic::create_folder(&cache).map_err(crate::error::field_error)?;
            let lock = File::options().read(true).write(true).create(true).truncate(false).open(&path);
            let lock = lock.map_err(PipelineError::write(&path))?;
            match lock.try_lock() {
                Ok(()) if is_at(&lock, &path) => owned.lock = Some(lock),
                // the one before removed it with its folder
                Ok(()) => continue,
                Err(TryLockError::WouldBlock) => {
                    return Err(PipelineError::InUse { folder: dir.to_owned(), owner: owned.other() });
                }
                Err(TryLockError::Error(error)) => {
                    let text =
                        format!("this file system has no locks ({error}): make sure that only one run works here");
                    task.warn(dir.display().to_string(), text);
                }
            }
            break;
        }
        if file == LOCK {
            let host = gethostname::gethostname().to_string_lossy().into_owned();
            let owner = Owner { process: std::process::id(), host };
            let owner = serde_json::to_vec(&owner).expect("a number and a text serialize");
            write(&cache.join(OWNER), &owner)?;
        }
        Ok(owned)
    }

    /// Whom the lock belongs to, for people.
    fn other(&self) -> String {
        if self.file != LOCK {
            return "another preview".into();
        }
        let read = || -> Option<Owner> { serde_json::from_slice(&std::fs::read(self.cache.join(OWNER)).ok()?).ok() };
        let owner = (0..LOOKS).find_map(|look| {
            if look > 0 {
                std::thread::sleep(Duration::from_millis(20));
            }
            read()
        });
        owner.map_or("another process".into(), |Owner { process, host }| format!("process {process} on {host}"))
    }
}

impl Drop for Owned {
    fn drop(&mut self) {
        // somebody else's, or of a file system without locks
        if self.lock.is_none() {
            return;
        }
        if self.file == LOCK {
            let _ = std::fs::remove_file(self.cache.join(OWNER));
        }
        // a run that failed before it kept anything leaves nothing; on other systems an open file cannot be removed
        if cfg!(unix) && !self.made.is_empty() {
            let others = std::fs::read_dir(&self.cache)
                .map_or(1, |list| list.flatten().filter(|e| e.file_name() != self.file).count());
            // times and nodes that are finished stay, and so does the mark that they are ours
            let beside = self.cache.parent().and_then(|dir| std::fs::read_dir(dir).ok());
            let is_alone = beside.is_some_and(|list| list.flatten().all(|e| e.path() == self.cache));
            if others == 0 && is_alone {
                let _ = std::fs::remove_file(self.cache.join(self.file));
                for folder in self.made.iter().rev() {
                    let _ = std::fs::remove_dir(folder);
                }
            }
        }
    }
}

/// Whether an open file is still the one of this name.
fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let of = |data: std::fs::Metadata| (data.dev(), data.ino());
        file.metadata().ok().map(of) == std::fs::metadata(path).ok().map(of)
    }
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}

/// Refuses a folder in which something that Lumistack did not write has a name that the work writes.
fn check_foreign(dir: &Path, work: Work) -> Result<(), PipelineError> {
    let Ok(entries) = std::fs::read_dir(dir) else { return Ok(()) };
    let ours = is_ours(dir);
    let mut names: Vec<PathBuf> = entries.flatten().map(|entry| entry.file_name().into()).collect();
    names.sort();
    for name in names.iter().filter(|name| work.writes(name.as_os_str())) {
        let path = dir.join(name);
        let is_text = matches!(name.to_str(), Some("job.toml" | "display.toml"));
        let fine = match is_text {
            true => is_written_by_us(&path, ours),
            false => ours || is_empty_folder(&path),
        };
        if !fine {
            let changed = is_text && is_sealed(&path).is_some();
            return Err(PipelineError::Foreign { path, work: work.name(), changed });
        }
    }
    Ok(())
}

fn is_empty_folder(path: &Path) -> bool {
    std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

/// Whether a folder is certain to be one that Lumistack made: by its lock, by what runs of before locks kept, or by a job file that says so.
pub(crate) fn is_ours(dir: &Path) -> bool {
    let cache = dir.join("cache");
    if cache.join(LOCK).is_file() || is_written_by_us(&dir.join("job.toml"), false) {
        return true;
    }
    let kept = |name: &str| {
        let stem = name.split('.').next().unwrap_or_default();
        let is_keyed = |kinds: &[&str]| {
            let keyed = stem.rsplit_once('-');
            keyed.is_some_and(|(kind, key)| {
                kinds.contains(&kind) && key.len() == 16 && key.bytes().all(|b| b.is_ascii_hexdigit())
            })
        };
        match name.rsplit_once('.') {
            Some((_, "json")) => is_keyed(&["window", "fit", "blend"]) || is_stamp(&cache.join(name)),
            Some(_) => false,
            None => is_keyed(&["target", "held-out", "outside"]) && cache.join(name).is_dir(),
        }
    };
    let any = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).any(|name| kept(&name))
    };
    // the designs of a sweep of before locks
    let is_row = |name: &str| {
        name.strip_suffix(".json").is_some_and(|key| key.len() == 24 && key.bytes().all(|b| b.is_ascii_hexdigit()))
    };
    let rows = std::fs::read_dir(dir.join("designs")).into_iter().flatten().flatten();
    any(&cache)
        || cache.join("views").is_dir()
        || rows.filter_map(|row| row.file_name().into_string().ok()).any(|name| is_row(&name))
}

/// A stamp of any version.
fn is_stamp(path: &Path) -> bool {
    #[derive(Deserialize)]
    struct AnyStamp {
        key: String,
        #[serde(rename = "files")]
        _files: Vec<serde_json::Value>,
    }
    let read = std::fs::read(path).ok().and_then(|text| serde_json::from_slice::<AnyStamp>(&text).ok());
    read.is_some_and(|stamp| stamp.key.len() == 64)
}

/// Writes `job.toml` or `display.toml`, so that it is told from what others write.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn write_sealed(path: &Path, text: &str) -> Result<(), PipelineError> {
    write(path, sealed(text).as_bytes())
}

/// Writes a run's `display.toml`. One of the same display that was calibrated since stays: patterns do not depend on that, and it took work.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn write_display(path: &Path, display: &Display) -> Result<(), PipelineError> {
    let there = std::fs::read_to_string(path).ok().and_then(|text| Display::from_toml(&text).ok());
    let nominal = display.without_panels();
    if *display == nominal && there.is_some_and(|there| there != nominal && there.without_panels() == nominal) {
        return Ok(());
    }
    write_sealed(path, &display.to_toml())
}

/// The text of a run's settings file after Lumistack itself has changed it from `before`, as calibration does: if it was as a run wrote it, it counts as
/// that again. Any other text stays as it is.
pub fn resealed(before: &str, after: &str) -> String {
    match (is_whole(before), after.strip_prefix(SEAL).and_then(|rest| rest.split_once('\n'))) {
        (Some(true), Some((_, rest))) => sealed(rest),
        _ => after.into(),
    }
}

fn sealed(text: &str) -> String {
    format!("{SEAL}{}\n{text}", blake3::hash(text.as_bytes()).to_hex())
}

/// Whether a sealed text is as it was written; `None` without a seal.
fn is_whole(text: &str) -> Option<bool> {
    let (hash, rest) = text.strip_prefix(SEAL)?.split_once('\n')?;
    Some(blake3::hash(rest.as_bytes()).to_hex().as_str() == hash.trim_end())
}

/// As [`is_whole`], of a file.
fn is_sealed(path: &Path) -> Option<bool> {
    is_whole(&std::fs::read_to_string(path).ok()?)
}

/// Whether a settings file of a run folder is as Lumistack wrote it. Those of before seals have every default written out and no comment; where the folder is
/// known to be `ours` one of an older version, which had fewer keys, will do.
fn is_written_by_us(path: &Path, ours: bool) -> bool {
    if let Some(whole) = is_sealed(path) {
        return whole;
    }
    let Ok(text) = std::fs::read_to_string(path) else { return false };
    if path.file_name() == Some(OsStr::new("job.toml")) {
        let same = config::parse::<Job>(&text).is_ok_and(|job| job.to_toml() == text);
        let tables = ["[display]", "[window]", "[light]", "[render]", "[factorize]", "[report]"];
        let begins = text.starts_with("schema = \"lumistack/job\"\nversion = 1\nname = ");
        same || (ours && begins && !text.contains('#') && tables.iter().all(|table| text.contains(table)))
    } else {
        let same = Display::from_toml(&text).is_ok_and(|display| display.to_toml() == text);
        same || (ours && text.starts_with("name = ") && !text.contains('#') && text.contains("[[layers]]"))
    }
}

/// Refuses a folder in which the work would write over what it reads.
fn check_inputs(dir: &Path, work: Work, job: &Job, registry: &Registry) -> Result<(), PipelineError> {
    // nothing lies in a folder that is not there
    let Ok(root) = dir.canonicalize() else { return Ok(()) };
    for (what, path) in inputs(job, registry) {
        let Ok(found) = path.canonicalize() else { continue };
        let Ok(inside) = found.strip_prefix(&root) else { continue };
        let written = match inside.components().next() {
            Some(Component::Normal(first)) => work.writes(first),
            // the folder itself: its times are read where times are written
            _ => work == Work::Sequence,
        };
        // a run folder's own job may be run again, with other options too: all that it says is in the job that replaces it
        let own_job = what == "job file" && inside == Path::new("job.toml") && is_written_by_us(&found, true);
        if written && !own_job {
            return Err(PipelineError::Overwrites { input: path, what, folder: dir.to_owned() });
        }
    }
    Ok(())
}

/// Every file and folder that a job reads.
fn inputs(job: &Job, registry: &Registry) -> Vec<(&'static str, PathBuf)> {
    let mut job = job.clone();
    let mut list: Vec<(&str, PathBuf)> = Vec::new();
    let named = [
        ("job file", &job.file),
        ("scene", &job.scene),
        ("light field", &job.light_field),
        ("display file", &job.display.file),
        ("environment", &job.light.environment),
        ("warm start", &job.factorize.warm_start),
        ("weights", &job.factorize.weights),
    ];
    list.extend(named.into_iter().filter_map(|(what, path)| Some((what, path.clone()?))));
    // those of nodes; what was named above is found again and changes nothing
    list.extend(job.paths_mut().map(|path| ("input", path.clone())));
    let displays = job.sweep.iter().flat_map(|sweep| &sweep.displays).filter(|name| name.ends_with(".toml"));
    list.extend(displays.map(|name| ("display file", job.folder.join(name))));
    let folder = job.folder.clone();
    for (_, id, params) in job.plugins_mut() {
        list.extend(file_params::of(registry, id, params).map(|(_, path)| ("plugin's file", folder.join(path))));
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets;
    use lumistack_core::{Cancel, Collector};

    fn job(folder: &Path) -> Job {
        Job { scene: Some(folder.join("a.glb")), ..Job::new(presets::by_name_or_path("fig7-uniform")) }
    }

    fn with_task<T>(work: impl FnOnce(Task<'_>) -> T) -> T {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        work(Task::quiet(&warnings, &cancel))
    }

    fn try_take(dir: &Path, work: Work, job: &Job) -> Result<Owned, String> {
        let registry = Registry::built_in().unwrap();
        with_task(|task| take(dir, work, job, &registry, task).map_err(|error| error.to_string()))
    }

    #[test]
    fn a_folder_has_one_owner_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("runs/a");
        let first = try_take(&run, Work::Run, &job(folder.path())).unwrap();
        let error = try_take(&run, Work::Sweep, &job(folder.path())).unwrap_err();
        let process = format!("process {} on ", std::process::id());
        assert!(error.contains(&run.display().to_string()) && error.contains(&process), "{error}");
        drop(first);
        assert!(!folder.path().join("runs").exists(), "nothing was kept, so nothing is left");
        // a dead owner's name holds nobody
        std::fs::create_dir_all(run.join("cache")).unwrap();
        std::fs::write(run.join("cache").join(LOCK), "").unwrap();
        std::fs::write(run.join("cache").join(OWNER), "{\"process\":1,\"host\":\"gone\"}").unwrap();
        let again = try_take(&run, Work::Run, &job(folder.path())).unwrap();
        assert!(try_take(&run, Work::Run, &job(folder.path())).unwrap_err().contains(&process));
        drop(again);
        assert!(is_ours(&run) && !run.join("cache").join(OWNER).exists());
    }

    #[test]
    fn foreign_files_under_our_names_are_refused_by_name() {
        let base = tempfile::tempdir().unwrap();
        let job = job(base.path());
        for (work, name) in [
            (Work::Run, "job.toml"),
            (Work::Run, "display.toml"),
            (Work::Run, "report.html"),
            (Work::Run, "layers/wood.png"),
            (Work::Run, "cache/a.txt"),
            (Work::Views, "lightfield.json"),
            (Work::Sweep, "plots/a.svg"),
            (Work::Sequence, "t0001/a.npy"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, "mine").unwrap();
            let error = try_take(folder.path(), work, &job).unwrap_err();
            let first = name.split('/').next().unwrap();
            assert!(error.contains(&folder.path().join(first).display().to_string()), "{error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing was written");
        }
        // other names are nobody's business
        std::fs::write(base.path().join("notes.txt"), "mine").unwrap();
        std::fs::create_dir(base.path().join("outputs")).unwrap();
        drop(try_take(base.path(), Work::Run, &job).unwrap());
    }

    #[test]
    fn our_own_files_are_known_until_somebody_changes_them() {
        let folder = tempfile::tempdir().unwrap();
        let job = job(folder.path());
        let path = folder.path().join("job.toml");
        let accepted = || try_take(folder.path(), Work::Run, &job).map(drop);
        // of before seals: every default written out; then sealed
        std::fs::write(&path, job.to_toml()).unwrap();
        assert_eq!(accepted(), Ok(()));
        std::fs::write(&path, format!("{}# mine\n", job.to_toml())).unwrap();
        assert!(accepted().is_err());
        write_sealed(&path, &job.to_toml()).unwrap();
        assert_eq!(accepted(), Ok(()));
        assert_eq!(config::parse::<Job>(&std::fs::read_to_string(&path).unwrap()).unwrap(), job);
        // it may be run again from where it lies
        let again = Job { file: Some(path.clone()), ..job.clone() };
        assert!(try_take(folder.path(), Work::Run, &again).is_ok());
        let text = std::fs::read_to_string(&path).unwrap().replace("seed = 1", "seed = 2");
        std::fs::write(&path, text).unwrap();
        let error = accepted().unwrap_err();
        assert!(error.contains("job.toml") && error.contains("changed"), "{error}");
        assert!(try_take(folder.path(), Work::Run, &again).unwrap_err().contains("job file"));
    }

    #[test]
    fn a_calibration_that_took_work_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("display.toml");
        let display = presets::load("fig7-uniform").unwrap();
        write_display(&path, &display).unwrap();
        let before = std::fs::read_to_string(&path).unwrap();
        let mut calibrated = display.clone();
        calibrated.layers[0].panel = Some(lumistack_display::Panel::default());
        let header = before.lines().next().unwrap();
        let after = resealed(&before, &format!("{header}\n{}", calibrated.to_toml()));
        std::fs::write(&path, &after).unwrap();
        assert!(is_written_by_us(&path, false), "Lumistack calibrated it");
        write_display(&path, &display).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), after);
        // another display is another file
        write_display(&path, &Display { frames: display.frames + 1, ..display }).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap() != after);
        assert_eq!(resealed("a = 1", "a = 2"), "a = 2");
    }

    #[test]
    fn run_folders_of_before_locks_are_accepted() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        std::fs::create_dir_all(dir.join("layers")).unwrap();
        std::fs::create_dir_all(dir.join("cache")).unwrap();
        std::fs::write(dir.join("layers/stack.json"), "{}").unwrap();
        assert!(try_take(dir, Work::Run, &job(dir)).is_err());
        let stamp = format!("{{\"key\": \"{}\", \"files\": [[\"layers/stack.json\", 2]]}}", "a".repeat(64));
        std::fs::write(dir.join("cache/factorize.json"), stamp).unwrap();
        // written by a version that had fewer keys
        let old = job(dir).to_toml().replace("seed = 1\n", "");
        std::fs::write(dir.join("job.toml"), old).unwrap();
        drop(try_take(dir, Work::Run, &job(dir)).unwrap());
    }

    #[test]
    fn inputs_are_not_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        std::fs::create_dir_all(dir.join("layers")).unwrap();
        std::fs::create_dir_all(dir.join("cache")).unwrap();
        std::fs::write(dir.join("cache").join(LOCK), "").unwrap();
        for name in ["scene.glb", "my.toml", "w.npy"] {
            std::fs::write(dir.join(name), "mine").unwrap();
        }
        let mut job = Job { scene: Some(dir.join("scene.glb")), ..job(dir) };
        job.factorize.weights = Some(dir.join("w.npy"));
        drop(try_take(dir, Work::Run, &job).unwrap());
        job.factorize.warm_start = Some(dir.join("layers"));
        let error = try_take(dir, Work::Run, &job).unwrap_err();
        assert!(error.contains("warm start") && error.contains("layers"), "{error}");
        job.factorize.warm_start = None;
        std::fs::write(dir.join("display.toml"), presets::load("fig7-uniform").unwrap().to_toml()).unwrap();
        job.display.file = Some(dir.join("display.toml"));
        assert!(try_take(dir, Work::Run, &job).unwrap_err().contains("display file"));
        job.display.file = None;
        let fields = Job { scene: None, light_field: Some(dir.to_owned()), ..job };
        assert!(try_take(dir, Work::Sequence, &fields).unwrap_err().contains("light field"));
        drop(try_take(dir, Work::Run, &fields).unwrap());
    }
}
