//! `lumistack preview`: serves the browser simulator of a run on a local port.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use lumistack_core::Task;
use lumistack_pipeline::{PipelineError, Registry, update_preview};
use serde_json::json;

use crate::args::Preview;
use crate::console::say;
use crate::server::{Server, Site, listen, port_of, serve};
use crate::solve_page;

/// Path of a preview's index, relative to the preview's folder.
const PREVIEW_JSON: &str = "stack/preview.json";
/// Interval at which files are checked for changes.
const LOOK: Duration = Duration::from_secs(1);

/// A preview and its run.
struct Source {
    /// The preview's folder.
    site: PathBuf,
    /// The run whose preview this program writes; `None` for a preview that exists already.
    run: Option<PathBuf>,
    /// The run's files and the preview's files when they were last compared.
    seen: Mutex<Option<(Files, Files)>>,
}

pub(crate) fn preview_command(
    args: &Preview,
    registry: &Registry,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let Some(dir) = &args.dir else { return solve_command(args, json, task) };
    let source = source_of(dir, task)?;
    source.refresh(registry, task)?;
    let server = announced(args, &source.site, json, task)?;
    let (mut looked, mut stamp) = (Instant::now(), stamp_of(&source.site));
    serve(&server, Site { root: &source.site, live: None }, || {
        if looked.elapsed() >= LOOK {
            looked = Instant::now();
            if let Err(error) = source.refresh(registry, task) {
                // The run may be incomplete while it is written. So this error is a warning, and a
                // later check finds the complete run.
                task.warn("preview", error.to_string());
            }
            stamp = stamp_of(&source.site);
        }
        (!task.cancel.is_cancelled()).then(|| stamp.clone())
    });
    Ok(())
}

/// Serves the page that solves light fields in the browser. The program contains the files of this
/// page.
fn solve_command(args: &Preview, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let page = solve_page::write()?;
    let server = announced(args, page.path(), json, task)?;
    serve(&server, Site { root: page.path(), live: None }, || (!task.cancel.is_cancelled()).then(String::new));
    Ok(())
}

/// Starts a server for a folder, prints its address and opens a browser.
fn announced(args: &Preview, site: &Path, json: bool, task: Task<'_>) -> Result<Server, PipelineError> {
    let server = listen(args.port).map_err(|error| {
        PipelineError::option("--port", "N", "a free port of this machine", format!("{} ({error})", args.port))
    })?;
    let address = format!("http://localhost:{}/", port_of(&server));
    if json {
        say!("{}", json!({"event": "serving", "address": address, "preview": site}));
    } else {
        say!("{address}   (Ctrl-C ends it)");
    }
    if !args.no_open
        && let Err(error) = opener::open_browser(&address)
    {
        task.warn("preview", format!("the browser did not open ({error}); open {address} yourself"));
    }
    Ok(server)
}

/// Finds the preview to serve for a folder. It is the folder itself, or the first preview among a
/// run's outputs. For a run without previews, [`Source::refresh`] writes one. A sequence is shown
/// by its first time step, since the page shows a still.
fn source_of(dir: &Path, task: Task<'_>) -> Result<Source, PipelineError> {
    if dir.join(PREVIEW_JSON).is_file() {
        return Ok(Source { site: dir.to_owned(), run: None, seen: Mutex::default() });
    }
    // A run may have written previews as outputs. Only one of them can be shown.
    let mut written = outputs_of(dir).into_iter();
    if let Some(site) = written.next() {
        let others: Vec<String> = written.map(|site| site.display().to_string()).collect();
        if !others.is_empty() {
            let text = format!(
                "the page shows the preview {}; the run has other previews: {}",
                site.display(),
                others.join(", ")
            );
            task.warn("preview", text);
        }
        return Ok(Source { site, run: None, seen: Mutex::default() });
    }
    if dir.join("layers/stack.json").is_file() {
        return Ok(Source { site: dir.join("preview"), run: Some(dir.to_owned()), seen: Mutex::default() });
    }
    // The folder may be a sequence, which is shown by its first time step.
    let times = times_of(dir);
    if let Some(first) = times.first() {
        let source = source_of(first, task)?;
        if let Some(last) = times.get(1).and_then(|_| times.last()) {
            let text = format!(
                "the page shows the first of {} time steps; `lumistack preview {}` shows the last time step; each time step has its own folder",
                times.len(),
                last.display()
            );
            task.warn("preview", text);
        }
        return Ok(source);
    }
    let found = match std::fs::metadata(dir) {
        Err(error) => error.to_string(),
        Ok(data) if !data.is_dir() => "a file".into(),
        Ok(_) => "a folder with neither stack/preview.json nor layers/stack.json".into(),
    };
    Err(PipelineError::value(dir, "folder", "the folder of a run or of a preview", found))
}

/// Finds the folders of a sequence's time steps, `t0001` and so on; none for a still run.
fn times_of(run: &Path) -> Vec<PathBuf> {
    let names = (1..).map(|time| run.join(format!("t{time:04}")));
    names.take_while(|folder| folder.is_dir()).collect()
}

/// Finds the previews among a run's outputs, `outputs/NODE/NAME`, sorted by name.
fn outputs_of(run: &Path) -> Vec<PathBuf> {
    let folders = |path: &Path| {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect::<Vec<_>>()
    };
    let mut sites: Vec<PathBuf> = folders(&run.join("outputs"))
        .iter()
        .flat_map(|node| folders(node))
        .filter(|site| site.join(PREVIEW_JSON).is_file())
        .collect();
    sites.sort();
    sites
}

/// Finds the first preview among a run's outputs, for the hint that a run prints at its end; `None`
/// if there is no preview.
pub(crate) fn written_preview(run: &Path) -> Option<PathBuf> {
    outputs_of(run).into_iter().next()
}

impl Source {
    /// Writes the preview of a run if it is missing or shows other patterns.
    fn refresh(&self, registry: &Registry, task: Task<'_>) -> Result<(), PipelineError> {
        let Some(run) = &self.run else { return Ok(()) };
        // Contents are compared at the first call, and later only if the length or the time of a
        // file differs from the last comparison.
        let before = files_of(run, &self.site);
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.as_ref() == Some(&before) {
            return Ok(());
        }
        update_preview(run, registry, task)?;
        // If the run changed during the comparison, nothing is stored, and the next call compares
        // again.
        *seen = (files_of(run, &self.site).0 == before.0).then(|| files_of(run, &self.site));
        Ok(())
    }
}

/// Paths of files, with their length and time of modification.
type Files = Vec<(PathBuf, u64, Option<SystemTime>)>;

/// Finds the files from which a preview is made, and the files of the preview.
fn files_of(run: &Path, site: &Path) -> (Files, Files) {
    let below = |folder: PathBuf| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        entries.collect::<Vec<_>>()
    };
    let known = |mut paths: Vec<PathBuf>| -> Files {
        paths.sort();
        let of = |path: PathBuf| {
            let data = std::fs::metadata(&path).ok()?;
            Some((path, data.len(), data.modified().ok()))
        };
        paths.into_iter().filter_map(of).collect()
    };
    let settings = ["display.toml", "report.json"].map(|name| run.join(name));
    let made_from = [settings.to_vec(), below(run.join("layers")), below(run.join("target"))].concat();
    (known(made_from), known([below(site.to_owned()), below(site.join("stack"))].concat()))
}

fn modified(path: &Path) -> Option<SystemTime> {
    std::fs::metadata(path).and_then(|data| data.modified()).ok()
}

/// Returns a text that changes when the preview changes.
fn stamp_of(site: &Path) -> String {
    let since = modified(&site.join(PREVIEW_JSON)).and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
    since.map_or_else(String::new, |since| since.as_nanos().to_string())
}
