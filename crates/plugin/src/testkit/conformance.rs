//! The rules of the plugin boundary as checks.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use lumistack_display::Display;
use serde_json::{Map, Value, json};
use thiserror::Error;

use crate::serve::{Output, OutputData, Plugin};
use crate::testkit::{MemoryHost, Sample, samples};
use crate::{Export, Kind, Param, PluginError, Time};

/// A rule that a plugin breaks.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{rule}: {found}")]
pub struct Broken {
    /// The rule.
    pub rule: &'static str,
    /// What happened.
    pub found: String,
}

type Files = BTreeMap<String, Vec<u8>>;

/// Checks an output plugin against every rule of the boundary that can be seen from outside, through its C functions:
/// it describes itself, declares all its parameters and refuses others, takes all its ports, gives the same files again and from any
/// thread, stops when asked, reports a full disk, leaves nothing open, and writes nowhere but through the host.
///
/// # Errors
/// The first rule that is broken.
pub fn conformance(export: &'static LazyLock<Export>) -> Result<(), Broken> {
    let plugin = rule("describes itself", Plugin::compiled_in(export))?;
    let samples: Vec<Sample> =
        samples().into_iter().filter(|sample| plugin.info().ports.contains(&sample.port())).collect();
    let surroundings = listing();
    described(&plugin)?;
    for sample in &samples {
        let files = defaults_work(&plugin, sample)?;
        same_again_from_any_thread(&plugin, sample, &files)?;
        stops_when_asked(&plugin, sample)?;
        reports_failing_host(&plugin, sample)?;
        parameters_in_range_work(&plugin, sample)?;
    }
    refuses_bad_parameters(&plugin, samples.first())?;
    can_be_abandoned(&plugin, samples.first())?;
    let added: Vec<String> = listing().difference(&surroundings).cloned().collect();
    require("bytes leave only through the host", added.is_empty(), || {
        format!("new in the working directory: {added:?}")
    })
}

fn described(plugin: &Plugin) -> Result<(), Broken> {
    let info = plugin.info();
    let version: Vec<&str> = info.version.split('.').collect();
    let numbers = version.len() == 3 && version[..2].iter().all(|part| part.parse::<u64>().is_ok());
    require("version is major.minor.patch", numbers, || info.version.clone())?;
    require("says what it does", info.doc.trim().ends_with('.'), || format!("doc {:?}, expected sentences", info.doc))
}

fn defaults_work(plugin: &Plugin, sample: &Sample) -> Result<Files, Broken> {
    let host = MemoryHost::new();
    rule("works with default parameters", write(plugin, &host, &json!({}), sample))?;
    let files = host.files();
    let presents = plugin.info().presents;
    require("an output that does not present writes something", presents || !files.is_empty(), || sample.name.into())?;
    closed(&host, "default parameters")?;
    Ok(files)
}

fn same_again_from_any_thread(plugin: &Plugin, sample: &Sample, stills: &Files) -> Result<(), Broken> {
    let again = MemoryHost::new();
    rule("works twice", write(plugin, &again, &json!({}), sample))?;
    require("writes the same bytes again", again.files() == *stills, || difference(&again.files(), stills))?;

    let sequence = |threads: bool| {
        let host = MemoryHost::new();
        let output = Output::open(plugin, &host, &json!({}), &sample.display)?;
        let submit = |index: u64| output.submit(Time { index, seconds: index as f64 / 24.0 }, sample.data());
        if threads {
            std::thread::scope(|scope| {
                let workers: Vec<_> = [1, 0].map(|index| scope.spawn(move || submit(index))).into();
                workers.into_iter().try_for_each(|worker| worker.join().expect("submit does not unwind"))
            })?;
        } else {
            submit(0)?;
            submit(1)?;
        }
        output.finish()?;
        Ok::<_, PluginError>(host.files())
    };
    let in_order = rule("takes a sequence of two times", sequence(false))?;
    let at_once = rule("takes two times at once from two threads", sequence(true))?;
    require("files do not depend on the order of times", at_once == in_order, || difference(&at_once, &in_order))
}

fn stops_when_asked(plugin: &Plugin, sample: &Sample) -> Result<(), Broken> {
    let host = MemoryHost::new();
    host.cancel();
    let result = write(plugin, &host, &json!({}), sample);
    require("returns `cancelled` when asked to stop before", result == Err(PluginError::Cancelled), || {
        format!("{result:?}")
    })?;
    closed(&host, "cancelled before")?;
    let appends = appends(plugin, sample);
    if appends > 1 {
        let host = MemoryHost::cancelled_at(0);
        let result = write(plugin, &host, &json!({}), sample);
        let prompt = result == Err(PluginError::Cancelled) || host.opened_after_cancel() == 0;
        require("opens no further file once asked to stop", prompt, || {
            format!("{} files, {result:?}", host.opened_after_cancel())
        })?;
        closed(&host, "cancelled midway")?;
    }
    Ok(())
}

fn reports_failing_host(plugin: &Plugin, sample: &Sample) -> Result<(), Broken> {
    let appends = appends(plugin, sample);
    let moments = BTreeSet::from([0, appends / 2, appends.saturating_sub(1)]);
    for append in moments.into_iter().filter(|append| *append < appends) {
        let host = MemoryHost::failing_at(append);
        let result = write(plugin, &host, &json!({}), sample);
        let told = matches!(&result, Err(PluginError::Failed(text)) if text.contains("no space left"));
        require("passes on why the host could not write", told, || format!("append {append}: {result:?}"))?;
        closed(&host, "the disk was full")?;
    }
    Ok(())
}

fn parameters_in_range_work(plugin: &Plugin, sample: &Sample) -> Result<(), Broken> {
    for (name, value) in plugin.info().schema.params.iter().flat_map(allowed) {
        let params = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        let host = MemoryHost::new();
        match write(plugin, &host, &params, sample) {
            // a combination may be refused, with a reason
            Ok(()) | Err(PluginError::Refused(_)) => closed(&host, &name)?,
            Err(error) => {
                return Err(Broken {
                    rule: "works with every parameter in its range",
                    found: format!("{name} = {value}, {}: {error:?}", sample.name),
                });
            }
        }
    }
    Ok(())
}

/// The plugin itself refuses what its schema does not allow: a host in another language need not have checked.
fn refuses_bad_parameters(plugin: &Plugin, sample: Option<&Sample>) -> Result<(), Broken> {
    let Some(Sample { display, .. }) = sample else { return Ok(()) };
    let params = &plugin.info().schema.params;
    let unknown = [("no_such_parameter".to_string(), json!(1))];
    for (name, value) in unknown.into_iter().chain(params.iter().flat_map(forbidden)) {
        let given = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        let result = refusal(plugin, &given.to_string(), display);
        let named = matches!(&result, Some(PluginError::Refused(text)) if text.contains(&name));
        require("refuses bad parameters by name", named, || format!("{given}: {result:?}"))?;
    }
    let result = refusal(plugin, "{", display);
    require("refuses what is not JSON", result.is_some(), || "accepted `{`".into())
}

fn can_be_abandoned(plugin: &Plugin, sample: Option<&Sample>) -> Result<(), Broken> {
    let Some(sample) = sample else { return Ok(()) };
    let host = MemoryHost::new();
    let output = rule("opens", Output::open(plugin, &host, &json!({}), &sample.display))?;
    rule("submits", output.submit(Time::default(), sample.data()))?;
    drop(output);
    closed(&host, "it was abandoned")?;
    let host = MemoryHost::new();
    let output = rule("opens", Output::open(plugin, &host, &json!({}), &sample.display))?;
    let result = output.finish();
    require("does not panic when nothing was submitted", !matches!(result, Err(PluginError::Panicked(_))), || {
        format!("{result:?}")
    })?;
    closed(&host, "nothing was submitted")
}

/// One still from open to finish.
fn write(plugin: &Plugin, host: &MemoryHost, params: &Value, sample: &Sample) -> Result<(), PluginError> {
    let output = Output::open(plugin, host, params, &sample.display)?;
    let data: OutputData<'_> = sample.data();
    output.submit(Time::default(), data)?;
    output.finish()
}

fn appends(plugin: &Plugin, sample: &Sample) -> usize {
    let host = MemoryHost::new();
    // a failure shows in the other checks
    let _ = write(plugin, &host, &json!({}), sample);
    host.appends()
}

fn refusal(plugin: &Plugin, params_json: &str, display: &Display) -> Option<PluginError> {
    Output::open_unresolved(plugin, &MemoryHost::new(), params_json, display).err()
}

/// The ends of a parameter's range.
fn allowed(param: &Param) -> Vec<(String, Value)> {
    let values = match &param.kind {
        Kind::Bool { .. } => vec![json!(false), json!(true)],
        Kind::Int { min, max, .. } => vec![json!(min), json!(max)],
        Kind::Float { min, max, .. } => vec![json!(min), json!(max)],
        Kind::Choice { options, .. } => options.iter().map(|option| json!(option.value)).collect(),
        Kind::Text { default } => vec![json!(default), json!("")],
    };
    values.into_iter().map(|value| (param.name.clone(), value)).collect()
}

/// Values of the wrong type or beyond a parameter's range.
fn forbidden(param: &Param) -> Vec<(String, Value)> {
    let values = match &param.kind {
        Kind::Bool { .. } => vec![json!("yes"), json!(1)],
        Kind::Int { min, max, .. } => {
            let beyond = [min.checked_sub(1), max.checked_add(1)].into_iter().flatten().map(|n| json!(n));
            beyond.chain([json!(0.5), json!("1")]).collect()
        }
        Kind::Float { min, max, .. } => vec![json!(min - 1.0 - min.abs()), json!(max + 1.0 + max.abs()), json!("1")],
        Kind::Choice { .. } => vec![json!("no such choice"), json!(0)],
        Kind::Text { .. } => vec![json!(0)],
    };
    values.into_iter().map(|value| (param.name.clone(), value)).collect()
}

fn closed(host: &MemoryHost, when: &str) -> Result<(), Broken> {
    let (stages, open) = host.stages();
    require("no file stays open", host.open_files().is_empty(), || format!("{when}: {:?}", host.open_files()))?;
    require("every stage of progress ends", open == 0, || format!("{when}: {open} of {stages:?} did not"))
}

fn difference(found: &Files, expected: &Files) -> String {
    let names = |files: &Files| files.keys().cloned().collect::<BTreeSet<_>>();
    let unequal: Vec<_> =
        expected.iter().filter(|(name, bytes)| found.get(*name) != Some(bytes)).map(|e| e.0).collect();
    format!("files {:?}, expected {:?}; not the same: {unequal:?}", names(found), names(expected))
}

fn listing() -> BTreeSet<String> {
    let entries = std::fs::read_dir(".").into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

fn rule<T>(rule: &'static str, result: Result<T, PluginError>) -> Result<T, Broken> {
    result.map_err(|error| Broken { rule, found: format!("{error:?}") })
}

fn require(rule: &'static str, holds: bool, found: impl FnOnce() -> String) -> Result<(), Broken> {
    if holds { Ok(()) } else { Err(Broken { rule, found: found() }) }
}
