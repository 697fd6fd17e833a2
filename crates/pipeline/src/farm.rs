//! Runs on many machines: units of work in one run folder that all machines share.
//!
//! ```text
//! cache/farm/plan.json           the job, its units, and the fingerprint of the code
//!                                that planned them
//! cache/farm/done/ID.json        record of a finished unit, written after its results
//! ```
//!
//! A unit checks that its worker has the same code as the plan, and waits for its input units. Then
//! it executes its steps and records that it is done.
//!
//! Every unit except the last holds a shared lock of the run folder. The folder of a time step or
//! node has a lock of its own. A unit that makes a block of pictures or a tile in such a folder
//! shares the folder's lock with other units. A unit that makes whole results in such a folder
//! holds the folder's lock exclusively. The last unit runs the whole job: it reuses all results and
//! writes the reports. It holds the lock of the run folder exclusively.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lumistack_core::Task;
use lumistack_core::config;
use lumistack_farm::{Graph, Unit};
use lumistack_plugin_host::Registry;
use serde::{Deserialize, Serialize};

use crate::engine;
use crate::error::{PipelineError, field_error};
use crate::job::Job;
use crate::plan::execute::Executor;
use crate::plan::steps::PartKind;
use crate::plan::sweep;
use crate::plan::units::{BlockSize, FINISH, units};
use crate::run::{of_run, of_sweep, plan as plan_of, run_finished, work_of};
use crate::stage::fields::Block;
use crate::store::code;
use crate::store::farm::{done_file, forget, plan_file};
use crate::store::files::{read_json, write_json};
use crate::store::folder;
use crate::store::key::{KeyBuilder, content_hash, hash};
use crate::store::lock::{Hold, UNIT_LIMIT, lock_for_unit};
use crate::store::names::Work;
use crate::store::plugin_files;

/// Length of a hash in files and messages, hexadecimal digits.
const DIGITS: usize = 16;
/// Interval between two checks for input units.
const INPUT_INTERVAL: Duration = Duration::from_millis(200);

/// Returns a hash of all code that affects results. All workers of a run must have the same hash.
pub fn code() -> String {
    let lists = [code::SCENE, code::VIEWS, code::FIELDS, code::PATTERNS, code::DESIGNS, code::PLUGINS, code::REPORTS];
    hash(lists.concat().concat().as_bytes())[..DIGITS].to_owned()
}

/// The plan of a run: its job and its units, in the form of `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FarmPlan {
    /// Hash of the job, the files that it names, the code and the units. The record of a unit is
    /// ignored if it has the id of another plan.
    pub id: String,
    /// Name of the job.
    pub name: String,
    /// Version of the program.
    pub version: String,
    /// Value of [`code`] in the program that planned the run.
    pub code: String,
    /// The units; each comes after its inputs.
    pub units: Vec<Unit>,
    /// The job as TOML, with absolute paths.
    job: String,
    /// Folder to which relative paths in parameters of plugins refer.
    #[serde(default, with = "lumistack_core::path_text::optional")]
    folder: Option<PathBuf>,
}

/// The record of a unit that is done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitDone {
    /// Id of the plan.
    plan: String,
    /// Id of the unit.
    pub id: String,
    /// Time from the start of the unit to its end, with the wait for its inputs, seconds.
    pub seconds: f64,
    /// True if the unit was done before the call of [`farm_unit`].
    pub cached: bool,
}

impl FarmPlan {
    /// Reads the plan of a run folder.
    ///
    /// # Errors
    /// If the folder has no plan. Either no run was planned there, or this machine does not share
    /// the folder.
    pub fn load(dir: &Path) -> Result<Self, PipelineError> {
        let missing = || PipelineError::NoFarmPlan { folder: dir.to_owned() };
        read_json(&plan_file(dir)).ok_or_else(missing)
    }

    /// Returns the graph of units in a run folder. The command line of a unit is `command`, the
    /// folder and the unit's id. The time of a unit is measured if the unit is done, and otherwise
    /// estimated.
    pub fn graph(&self, dir: &Path, command: Vec<String>) -> Graph {
        let folder = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned()).to_string_lossy().into_owned();
        let mut units = self.units.clone();
        for unit in &mut units {
            unit.seconds = self.done(dir, &unit.id).map_or(unit.seconds, |done| done.seconds);
        }
        Graph { name: self.name.clone(), folder, command, units }
    }

    /// Returns the record of a unit, if it is done.
    pub fn done(&self, dir: &Path, id: &str) -> Option<UnitDone> {
        read_json(&done_file(dir, id)).filter(|done: &UnitDone| done.plan == self.id)
    }

    fn job(&self, maps: &[(PathBuf, PathBuf)], registry: &Registry) -> Result<Job, PipelineError> {
        let damaged = |_| {
            PipelineError::value(
                "farm plan",
                "job",
                "the text of the planned job",
                "a damaged text; plan the run again",
            )
        };
        let mut job: Job = config::parse(&self.job).map_err(damaged)?;
        for path in job.paths_mut() {
            *path = mapped(path, maps);
        }
        for (_, id, params) in job.plugins_mut() {
            let files: Vec<_> = plugin_files::of(registry, id, params).map(|(n, p)| (n.into(), p.into())).collect();
            for (name, path) in files {
                let (name, path): (String, PathBuf) = (name, path);
                params.insert(name, mapped(&path, maps).to_string_lossy().into());
            }
        }
        job.folder = self.folder.as_deref().map_or_else(PathBuf::new, |folder| mapped(folder, maps));
        Ok(job)
    }
}

/// Returns a hash of the files that a job names. The content of folders, such as light fields, is
/// not included: after a user has replaced a damaged file in a folder, finished units stay
/// finished.
fn files_key(job: &Job, registry: &Registry) -> String {
    let mut key = KeyBuilder::new("files", &[]);
    // Leave out the job file, since the plan's id already depends on the job's text.
    for (_, path) in folder::inputs(job, registry).into_iter().filter(|(role, _)| *role != "job file") {
        key.add("path", path.as_os_str().as_encoded_bytes());
        if let Ok(hash) = content_hash(&path) {
            key.add("content", hash.as_bytes());
        }
    }
    key.finish()
}

/// Maps a path of the planning machine to a path of this machine. `maps` are pairs of a folder on
/// the planning machine and a folder on this machine. The first pair whose first folder contains
/// the path is used.
fn mapped(path: &Path, maps: &[(PathBuf, PathBuf)]) -> PathBuf {
    let found = maps.iter().find_map(|(there, here)| Some(here.join(path.strip_prefix(there).ok()?)));
    found.unwrap_or_else(|| path.to_owned())
}

/// Plans a job for many machines in the job's run folder. Checks the job and locks the folder as a
/// run does. If the folder has the same plan already, its finished units stay finished.
///
/// # Errors
/// The errors of a run before its first step.
pub fn farm_plan(
    job: &Job,
    dir: &Path,
    registry: &Registry,
    block_size: BlockSize,
    task: Task<'_>,
) -> Result<FarmPlan, PipelineError> {
    // Workers may have other working folders, so all paths of the job become absolute.
    let mut job = engine::settled(job, None, task)?;
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    job.folder = absolute(&job.folder);
    let mut job = plugin_files::resolved(&job, registry)?;
    job.paths_mut().for_each(|path| *path = absolute(path));
    // Make the checks of a run before the first worker starts.
    let plan = plan_of(&job, dir, registry)?;
    let owned = folder::lock(dir, work_of(&job), &job, registry, task)?;
    Executor::new(&plan, registry, None, task).check()?;
    for part in &plan.parts {
        // Check that no other process uses the folder of a time step. Also check that the run would
        // replace no file of another program in this folder.
        if matches!(part.kind, PartKind::Time(_)) && job.sweep.is_none() {
            drop(folder::lock(&dir.join(&part.folder), Work::Run, &part.job, registry, task)?);
        }
    }
    let mut made = FarmPlan {
        id: String::new(),
        name: job.name.clone(),
        version: env!("CARGO_PKG_VERSION").into(),
        code: code(),
        units: units(&plan, block_size),
        job: job.to_toml(),
        folder: Some(job.folder.clone()),
    };
    // The id does not depend on estimates. Estimates differ between machines, and results do not
    // depend on them.
    let ids: Vec<_> = made.units.iter().map(|unit| (&unit.id, &unit.inputs, &unit.steps)).collect();
    // The id depends on the files that the job names, so that a changed scene is a new plan.
    let all = (&made.job, &made.code, ids, files_key(&job, registry));
    let all = serde_json::to_string(&all).expect("plans serialize");
    made.id = hash(all.as_bytes())[..DIGITS].to_owned();
    if FarmPlan::load(dir).is_ok_and(|old| old.id != made.id) {
        forget(dir);
    }
    // Write the plan while the lock is held.
    let place = plan_file(dir);
    lumistack_field_io::atomic::create_folder(place.parent().unwrap_or(dir)).map_err(field_error)?;
    write_json(&place, &made)?;
    drop(owned);
    Ok(made)
}

/// Executes a unit of the plan in a run folder. If the unit is already done, the function returns
/// immediately. The last unit is never skipped, since it runs the whole job.
///
/// `maps` are pairs of folders, on the planning machine and on this machine, by which the job's
/// paths are mapped. A unit waits up to `patience` for its input units, since a network file system
/// may show files late.
///
/// # Errors
/// If the folder has no plan, the plan has no such unit, or other code planned the run. Also if an
/// input unit is not done in time, another process holds the folder's lock, or the work fails or is
/// cancelled.
pub fn farm_unit(
    dir: &Path,
    id: &str,
    maps: &[(PathBuf, PathBuf)],
    patience: Duration,
    registry: &Registry,
    task: Task<'_>,
) -> Result<UnitDone, PipelineError> {
    let start = Instant::now();
    // Results of different code must not be mixed.
    let farm = FarmPlan::load(dir)?;
    if farm.code != code() {
        let plan = format!("{}, {}", farm.version, farm.code);
        let worker = format!("{}, {}", env!("CARGO_PKG_VERSION"), code());
        return Err(PipelineError::OtherCode { folder: dir.to_owned(), plan, worker });
    }
    let Some(unit) = farm.units.iter().find(|unit| unit.id == id) else {
        return Err(PipelineError::value(dir, "unit", "the id of a unit of the plan", format!("`{id}`")));
    };
    // A farm manager may execute a unit twice. The second execution returns the record of the
    // first execution, except for the last unit.
    let is_last = unit.id == FINISH;
    let before = || farm.done(dir, id).filter(|_| !is_last).map(|done| UnitDone { cached: true, ..done });
    if let Some(done) = before() {
        return Ok(done);
    }
    wait_for_inputs(&farm, dir, unit, patience, task)?;
    // The last unit runs the whole job: it reuses all results and writes the reports.
    let job = farm.job(maps, registry)?;
    if is_last {
        run_finished(&job, dir, registry, task)?;
    } else {
        let _owned = lock_for_unit(dir, Hold::Shared, UNIT_LIMIT, task)?;
        let is_sweep = job.sweep.is_some();
        let (plan, designs) = if is_sweep { of_sweep(&job, dir)? } else { (of_run(&job, dir)?, Default::default()) };
        let design = unit.kind == lumistack_farm::Kind::Design;
        match unit.block {
            Some([number, _]) if design => sweep::execute_design(&plan, &designs, &job, number, registry, task)?,
            block => {
                let block = block.and_then(Block::new);
                Executor::new(&plan, registry, None, task).execute_unit(&unit.steps, block, unit.round)?;
            }
        }
    }
    // Record the end last, so that a killed unit is not regarded as done.
    let seconds = start.elapsed().as_secs_f64();
    let done = UnitDone { plan: farm.id.clone(), id: id.to_owned(), seconds, cached: false };
    let path = done_file(dir, id);
    lumistack_field_io::atomic::create_folder(path.parent().unwrap_or(dir)).map_err(field_error)?;
    write_json(&path, &done)?;
    Ok(done)
}

fn wait_for_inputs(
    farm: &FarmPlan,
    dir: &Path,
    unit: &Unit,
    patience: Duration,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let start = Instant::now();
    loop {
        let missing: Vec<&String> = unit.inputs.iter().filter(|input| farm.done(dir, input).is_none()).collect();
        let [first, ..] = missing.as_slice() else { return Ok(()) };
        task.cancel.check()?;
        if start.elapsed() >= patience {
            let (unit, expected) = (format!("unit `{}`", unit.id), "finished input units");
            return Err(PipelineError::value(
                dir,
                unit,
                expected,
                format!("the input unit `{first}`, which is not finished"),
            ));
        }
        std::thread::sleep(INPUT_INTERVAL);
    }
}
