//! Locks and checks the folder of a run. A folder has one owner at a time. A run neither replaces
//! files of other programs nor overwrites its inputs.

use std::path::{Component, Path, PathBuf};

use lumistack_core::Task;
use lumistack_plugin_host::Registry;

use super::files::check_folder;
use super::left_overs;
use super::lock::{FolderLock, lock_known};
use super::names::{Work, is_ours};
use super::plugin_files;
use super::settings::{is_sealed, is_written_by_us};
use crate::error::PipelineError;
use crate::job::{DisplayJob, Job};

/// Checks and locks the folder of a job, and removes left-overs of killed runs.
///
/// # Errors
/// If another process uses the folder, the work would replace a file of another program, or the
/// work would overwrite an input.
pub(crate) fn lock(
    dir: &Path,
    work: Work,
    job: &Job,
    registry: &Registry,
    task: Task<'_>,
) -> Result<FolderLock, PipelineError> {
    check_folder(dir)?;
    check_inputs(dir, work, job, registry)?;
    check_foreign(dir, work)?;
    let owned = lock_known(dir, task)?;
    left_overs::remove(dir);
    Ok(owned)
}

/// Checks that no file of another program has the name of a file that the work writes.
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

/// Checks that the work overwrites none of the job's inputs.
fn check_inputs(dir: &Path, work: Work, job: &Job, registry: &Registry) -> Result<(), PipelineError> {
    // A folder that does not exist contains no input.
    let Ok(root) = dir.canonicalize() else { return Ok(()) };
    for (role, path) in inputs(job, registry) {
        let Ok(found) = path.canonicalize() else { continue };
        let Ok(inside) = found.strip_prefix(&root) else { continue };
        let written = match inside.components().next() {
            Some(Component::Normal(first)) => work.writes(first),
            // An input may be the folder itself, except for a sequence. A sequence would write time
            // steps among the light fields that it reads.
            _ => work == Work::Sequence,
        };
        // The job file of a run folder may be run again, since the job file that replaces it has
        // all of its values.
        let own_job = role == "job file" && inside == Path::new("job.toml") && is_written_by_us(&found, true);
        if written && !own_job {
            return Err(PipelineError::Overwrites { input: path, role, folder: dir.to_owned() });
        }
    }
    Ok(())
}

/// Returns the files and folders that a job names, with their roles.
pub(crate) fn inputs(job: &Job, registry: &Registry) -> Vec<(&'static str, PathBuf)> {
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
    list.extend(named.into_iter().filter_map(|(role, path)| Some((role, path.clone()?))));
    // Add files that nodes name. Some files are listed twice, which has no effect.
    list.extend(job.paths_mut().map(|path| ("input", path.clone())));
    let displays = job.sweep.iter().flat_map(|sweep| &sweep.displays);
    let files = displays.filter_map(|text| DisplayJob::by_name_or_path(text).file);
    list.extend(files.map(|path| ("display file", job.folder.join(path))));
    let folder = job.folder.clone();
    for (_, id, params) in job.plugins_mut() {
        list.extend(plugin_files::of(registry, id, params).map(|(_, path)| ("plugin's file", folder.join(path))));
    }
    list
}

#[cfg(test)]
mod tests {
    use super::super::lock::OWNER;
    use super::super::names::LOCK;
    use super::super::settings::{with_new_seal, write_display, write_sealed};
    use super::*;
    use crate::presets;
    use lumistack_core::{Cancel, Collector, config};
    use lumistack_display::Display;

    fn job(folder: &Path) -> Job {
        Job { scene: Some(folder.join("a.glb")), ..Job::new(crate::DisplayJob::by_name_or_path("fig7-uniform")) }
    }

    fn with_task<T>(work: impl FnOnce(Task<'_>) -> T) -> T {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        work(Task::quiet(&warnings, &cancel))
    }

    fn try_take(dir: &Path, work: Work, job: &Job) -> Result<FolderLock, String> {
        let registry = Registry::built_in().unwrap();
        with_task(|task| lock(dir, work, job, &registry, task).map_err(|error| error.to_string()))
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
        // The lock file and the owner's file of a dead process do not lock the folder.
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
        // Files that the work would not replace are allowed, and also empty folders.
        std::fs::write(base.path().join("notes.txt"), "mine").unwrap();
        std::fs::create_dir(base.path().join("outputs")).unwrap();
        drop(try_take(base.path(), Work::Run, &job).unwrap());
    }

    #[test]
    fn our_own_files_are_known_until_they_change() {
        let folder = tempfile::tempdir().unwrap();
        let job = job(folder.path());
        let path = folder.path().join("job.toml");
        let accepted = || try_take(folder.path(), Work::Run, &job).map(drop);
        // An earlier version wrote job files with all defaults and without a hash. Such a file is
        // accepted until it changes.
        std::fs::write(&path, job.to_toml()).unwrap();
        assert_eq!(accepted(), Ok(()));
        std::fs::write(&path, format!("{}# mine\n", job.to_toml())).unwrap();
        assert!(accepted().is_err());
        // A file with a valid hash is accepted.
        write_sealed(&path, &job.to_toml()).unwrap();
        assert_eq!(accepted(), Ok(()));
        assert_eq!(config::parse::<Job>(&std::fs::read_to_string(&path).unwrap()).unwrap(), job);
        // The job file of a run may be run from its run folder.
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
        let after = with_new_seal(&before, &format!("{header}\n{}", calibrated.to_toml()));
        std::fs::write(&path, &after).unwrap();
        assert!(is_written_by_us(&path, false), "Lumistack calibrated it");
        write_display(&path, &display).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), after);
        // A display file is replaced if the display has changed.
        write_display(&path, &Display { frames: display.frames + 1, ..display }).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap() != after);
        assert_eq!(with_new_seal("a = 1", "a = 2"), "a = 2");
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
        // This job file is from an older version, which had fewer keys.
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
        std::fs::create_dir(dir.join("designs")).unwrap();
        std::fs::write(dir.join("designs/mine"), "mine").unwrap();
        let displays = vec!["./designs/mine".into()];
        job.sweep = Some(crate::SweepJob { displays, ..Default::default() });
        job.folder = dir.to_owned();
        assert!(try_take(dir, Work::Sweep, &job).unwrap_err().contains("display file"));
        job.sweep = None;
        let fields = Job { scene: None, light_field: Some(dir.to_owned()), ..job };
        assert!(try_take(dir, Work::Sequence, &fields).unwrap_err().contains("light field"));
        drop(try_take(dir, Work::Run, &fields).unwrap());
    }
}
