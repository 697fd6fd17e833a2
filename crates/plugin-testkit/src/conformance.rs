//! Checks whether a plugin keeps the rules of the plugin interface.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use lumistack_plugin::{Export, Kind, PluginError, Time};
use lumistack_plugin_host::serve::{Output, OutputData, Plugin, PluginKind};
use serde_json::{Map, Value, json};

use crate::makers;
use crate::memory_host::MemoryHost;
use crate::rules::{
    Broken, allowed, bad_parameters_are_refused, closed, defaults_and_ends, in_words, is_reason, require, rule, varied,
};
use crate::samples::{Sample, samples};

type Files = BTreeMap<String, Vec<u8>>;

/// Checks a compiled-in plugin; see [`conformance_of`].
///
/// # Errors
/// The first violated rule.
pub fn conformance(export: &'static LazyLock<Export>) -> Result<(), Broken> {
    conformance_but_for(export, &[])
}

/// Checks a compiled-in plugin as [`conformance`] does, but keeps the parameters named in
/// `at_default` at their defaults. Use this for parameters whose other values need too much time or
/// memory in a test.
///
/// # Errors
/// The first violated rule.
pub fn conformance_but_for(export: &'static LazyLock<Export>, at_default: &[&str]) -> Result<(), Broken> {
    conformance_of(&rule("describes itself", Plugin::compiled_in(export))?, at_default)
}

/// Checks a plugin against all rules of the plugin interface that can be observed through the
/// plugin's C functions.
///
/// An output describes itself, declares all its parameters with units and ranges, and refuses other
/// parameters. It accepts at least one sample of its ports, and gives a reason if it refuses
/// another. It produces identical files in a second run and from any thread. It stops on
/// cancellation, reports a full disk, leaves no file open, and writes through the host only. Most
/// rules are checked with default parameters, and again with switches on and choices at their last
/// option. Parameters in `at_default` keep their defaults.
///
/// A node or a source produces identical results in a second run, stops on cancellation, and
/// accepts every display or refuses it with a reason. An importer does not panic on invalid files;
/// [`import_conformance`](crate::import_conformance) checks it on real files.
///
/// # Errors
/// The first violated rule.
pub fn conformance_of(plugin: &Plugin, at_default: &[&str]) -> Result<(), Broken> {
    described(plugin)?;
    let surroundings = listing();
    match plugin.info().kind {
        PluginKind::Output => output_conformance(plugin, at_default),
        PluginKind::Node => makers::node_conformance(plugin, at_default),
        PluginKind::Source => makers::source_conformance(plugin, at_default),
        PluginKind::Importer => makers::importer_conformance(plugin),
    }?;
    let added: Vec<String> = listing().difference(&surroundings).cloned().collect();
    require("files are written only through the host", added.is_empty(), || {
        format!("new files in the working directory: {}", added.join(", "))
    })
}

fn output_conformance(plugin: &Plugin, at_default: &[&str]) -> Result<(), Broken> {
    let mut samples: Vec<Sample> =
        samples().into_iter().filter(|sample| plugin.info().ports.contains(&sample.port())).collect();
    // The plugin may refuse a sample's display with a reason, but must accept at least one sample.
    let mut reasons = Vec::new();
    samples.retain(|sample| match write(plugin, &MemoryHost::new(), &json!({}), sample) {
        Err(PluginError::Refused(reason)) => {
            reasons.push(reason);
            false
        }
        _ => true,
    });
    require("accepts a sample or refuses it with a reason", reasons.iter().all(|reason| is_reason(reason)), || {
        format!("the plugin refused a sample: {}", reasons.join("; "))
    })?;
    require("accepts at least one sample of its ports", !samples.is_empty(), || {
        format!("the plugin refused every sample: {}", reasons.join("; "))
    })?;
    for sample in &samples {
        defaults_work(plugin, sample)?;
        for params in [Some(json!({})), everything(plugin, sample, at_default)].into_iter().flatten() {
            same_again_from_any_thread(plugin, sample, &params)?;
            stops_when_asked(plugin, sample, &params)?;
            reports_failing_host(plugin, sample, &params)?;
        }
        parameters_in_range_work(plugin, sample, at_default)?;
    }
    refuses_bad_parameters(plugin, samples.first())?;
    can_be_abandoned(plugin, samples.first())
}

/// Checks that two builds of one plugin have equal descriptions and produce equal results. Returns
/// the number of compared files, stacks, light fields or imports.
///
/// An output writes all samples with default parameters, and again with switches on and choices at
/// their last option. For each end of a parameter's range, it writes one sample. Other plugins make
/// results with default parameters, and for each end of a parameter's range.
///
/// # Errors
/// The first difference.
pub fn same_outputs(plugin: &Plugin, other: &Plugin, at_default: &[&str]) -> Result<usize, Broken> {
    let description = |plugin: &Plugin| serde_json::to_value(plugin.info()).unwrap_or_default();
    require("both builds describe themselves alike", description(plugin) == description(other), || {
        format!("the descriptions\n{}\nand\n{}", description(plugin), description(other))
    })?;
    if plugin.info().kind != PluginKind::Output {
        let mut all = defaults_and_ends(plugin, at_default);
        return all.try_fold(0, |count, params| Ok(count + makers::same(plugin, other, &params)?));
    }
    let samples: Vec<Sample> =
        samples().into_iter().filter(|sample| plugin.info().ports.contains(&sample.port())).collect();
    let same = |sample: &Sample, params: &Value| {
        let outcome = |plugin: &Plugin| {
            let host = MemoryHost::new();
            write(plugin, &host, params, sample).map(|()| host.files())
        };
        let (a, b) = (outcome(plugin), outcome(other));
        require("writes the same bytes", a == b, || match (&a, &b) {
            (Ok(a), Ok(b)) => format!("with {params} and the sample `{}`: {}", sample.name, difference(b, a)),
            _ => format!(
                "with {params} and the sample `{}`, the first build: {}; the second build: {}",
                sample.name,
                in_words(&a),
                in_words(&b)
            ),
        })?;
        Ok(a.map_or(0, |files| files.len()))
    };
    let mut count = 0;
    for sample in &samples {
        count += same(sample, &json!({}))?;
        if let Some(params) = everything(plugin, sample, at_default) {
            count += same(sample, &params)?;
        }
    }
    for (params, sample) in defaults_and_ends(plugin, at_default).skip(1).zip(samples.iter().cycle()) {
        count += same(sample, &params)?;
    }
    Ok(count)
}

fn described(plugin: &Plugin) -> Result<(), Broken> {
    let info = plugin.info();
    let version: Vec<&str> = info.version.split('.').collect();
    let numbers = version.len() == 3 && version[..2].iter().all(|part| part.parse::<u64>().is_ok());
    require("version is major.minor.patch", numbers, || format!("the version {}", info.version))?;
    require("describes itself in sentences", info.doc.trim().ends_with('.'), || {
        format!("a `doc` that does not end with a full stop: {}", info.doc)
    })?;
    for param in &info.schema.params {
        let named = param.unit.as_ref().is_some_and(|unit| !unit.trim().is_empty());
        let (ranged, unit) = match param.kind {
            Kind::Int { min, max, .. } => (min < max && max < i64::MAX && min > i64::MIN, named),
            Kind::Float { min, max, .. } => (min < max && min.is_finite() && max.is_finite(), named),
            _ => (true, true),
        };
        let expected = || format!("the parameter `{}`, which takes {}", param.name, param.expected());
        require("numbers have a range", ranged, expected)?;
        require("numbers have a unit (`1` for a plain number)", unit, expected)?;
    }
    Ok(())
}

/// Returns parameters with switches on and choices at their last option. The parameters are changed
/// one after another; a change is kept if the plugin accepts it together with the earlier changes.
/// `None` if no change is kept.
fn everything(plugin: &Plugin, sample: &Sample, at_default: &[&str]) -> Option<Value> {
    let mut on = Map::new();
    for param in varied(plugin, at_default) {
        let last = match &param.kind {
            Kind::Bool { .. } => json!(true),
            Kind::Choice { options, .. } => json!(options.last()?.value),
            _ => continue,
        };
        let mut more = on.clone();
        more.insert(param.name.clone(), last);
        if write(plugin, &MemoryHost::new(), &Value::Object(more.clone()), sample).is_ok() {
            on = more;
        }
    }
    (!on.is_empty()).then_some(Value::Object(on))
}

fn defaults_work(plugin: &Plugin, sample: &Sample) -> Result<(), Broken> {
    let host = MemoryHost::new();
    rule("works with default parameters", write(plugin, &host, &json!({}), sample))?;
    let files = host.files();
    let presents = plugin.info().presents;
    require("an output that does not present writes something", presents || !files.is_empty(), || sample.name.into())?;
    closed(&host, "with default parameters")
}

fn same_again_from_any_thread(plugin: &Plugin, sample: &Sample, params: &Value) -> Result<(), Broken> {
    // Write a still twice.
    let [once, again] = [MemoryHost::new(), MemoryHost::new()];
    rule("works twice", write(plugin, &once, params, sample))?;
    rule("works twice", write(plugin, &again, params, sample))?;
    let [stills, others] = [once.files(), again.files()];
    require("writes the same bytes again", stills == others, || difference(&others, &stills))?;

    // Write two time steps one after another, and from two threads at once.
    let sequence = |threads: bool| {
        let host = MemoryHost::new();
        let output = Output::open(plugin, &host, params, &sample.display)?;
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
    let in_order = rule("accepts a sequence of two time steps", sequence(false))?;
    let at_once = rule("accepts two time steps in parallel from two threads", sequence(true))?;
    require("files do not depend on the order of time steps", at_once == in_order, || difference(&at_once, &in_order))
}

fn stops_when_asked(plugin: &Plugin, sample: &Sample, params: &Value) -> Result<(), Broken> {
    let host = MemoryHost::new();
    host.cancel();
    let result = write(plugin, &host, params, sample);
    require("returns `cancelled` if cancelled before it begins", result == Err(PluginError::Cancelled), || {
        in_words(&result)
    })?;
    closed(&host, "after a cancellation before the begin")?;
    let appends = appends(plugin, sample, params);
    if appends > 1 {
        let host = MemoryHost::cancelled_at(0);
        let result = write(plugin, &host, params, sample);
        let noticed = result == Err(PluginError::Cancelled) || host.opened_after_cancel() == 0;
        require("returns `cancelled` if it opens a file after cancellation", noticed, || {
            format!(
                "files that were opened after the cancellation: {}; {}",
                host.opened_after_cancel(),
                in_words(&result)
            )
        })?;
        closed(&host, "after a cancellation midway")?;
    }
    Ok(())
}

fn reports_failing_host(plugin: &Plugin, sample: &Sample, params: &Value) -> Result<(), Broken> {
    let appends = appends(plugin, sample, params);
    let moments = BTreeSet::from([0, appends / 2, appends.saturating_sub(1)]);
    for append in moments.into_iter().filter(|append| *append < appends) {
        let host = MemoryHost::failing_at(append);
        let result = write(plugin, &host, params, sample);
        let description = matches!(&result, Err(PluginError::Failed(text)) if text.contains("no space left"));
        require("reports why the host cannot write", description, || {
            format!("when the host could not write append {append}, {}", in_words(&result))
        })?;
        closed(&host, "after the disk was full")?;
    }
    Ok(())
}

fn parameters_in_range_work(plugin: &Plugin, sample: &Sample, at_default: &[&str]) -> Result<(), Broken> {
    for (name, value) in varied(plugin, at_default).flat_map(allowed) {
        let params = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        let host = MemoryHost::new();
        match write(plugin, &host, &params, sample) {
            // A plugin may refuse a value with a reason, since the value may contradict other
            // parameters.
            Ok(()) => closed(&host, &format!("with {name} = {value}"))?,
            Err(PluginError::Refused(reason)) if is_reason(&reason) => {
                closed(&host, &format!("with {name} = {value}"))?;
            }
            Err(error) => {
                return Err(Broken {
                    rule: "works with every parameter in its range",
                    found: format!(
                        "with {name} = {value} and the sample `{}`, {}",
                        sample.name,
                        in_words::<()>(&Err(error))
                    ),
                });
            }
        }
    }
    Ok(())
}

fn refuses_bad_parameters(plugin: &Plugin, sample: Option<&Sample>) -> Result<(), Broken> {
    let Some(Sample { display, .. }) = sample else { return Ok(()) };
    bad_parameters_are_refused(plugin, |params| {
        Output::open_unresolved(plugin, &MemoryHost::new(), params, display).err()
    })
}

fn can_be_abandoned(plugin: &Plugin, sample: Option<&Sample>) -> Result<(), Broken> {
    let Some(sample) = sample else { return Ok(()) };
    let host = MemoryHost::new();
    let output = rule("opens", Output::open(plugin, &host, &json!({}), &sample.display))?;
    rule("submits", output.submit(Time::default(), sample.data()))?;
    drop(output);
    closed(&host, "after the output was abandoned")?;
    let host = MemoryHost::new();
    let output = rule("opens", Output::open(plugin, &host, &json!({}), &sample.display))?;
    let result = output.finish();
    require("does not panic when nothing was submitted", !matches!(result, Err(PluginError::Panicked(_))), || {
        in_words(&result)
    })?;
    closed(&host, "after nothing was submitted")
}

/// Writes one still, from open to finish.
fn write(plugin: &Plugin, host: &MemoryHost, params: &Value, sample: &Sample) -> Result<(), PluginError> {
    let output = Output::open(plugin, host, params, &sample.display)?;
    let data: OutputData<'_> = sample.data();
    output.submit(Time::default(), data)?;
    output.finish()
}

fn appends(plugin: &Plugin, sample: &Sample, params: &Value) -> usize {
    let host = MemoryHost::new();
    // Other checks detect failures, so the result is ignored.
    let _ = write(plugin, &host, params, sample);
    host.appends()
}

fn difference(found: &Files, expected: &Files) -> String {
    let names = |files: &Files| files.keys().cloned().collect::<BTreeSet<_>>();
    let unequal: Vec<_> =
        expected.iter().filter(|(name, bytes)| found.get(*name) != Some(bytes)).map(|e| e.0).collect();
    let list = |names: BTreeSet<String>| names.into_iter().collect::<Vec<_>>().join(", ");
    format!(
        "the files {}, but another call wrote {}; missing or different files: {}",
        list(names(found)),
        list(names(expected)),
        list(unequal.into_iter().cloned().collect())
    )
}

fn listing() -> BTreeSet<String> {
    let entries = std::fs::read_dir(".").into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}
