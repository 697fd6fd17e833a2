//! Deadline 10: one job per group of units, with the plugin CommandLine, and a script that submits
//! the jobs in order. A job lists the ids of the jobs that it depends on. Deadline returns an id
//! only when it receives a job, so the exported files cannot contain the ids.

use std::fmt::Write;

use serde_json::json;

use crate::file::{File, limit_seconds, plain};
use crate::graph::{Graph, Group};

/// A script that submits the jobs. To each job, it adds the ids of the jobs on which the job
/// depends.
const SUBMIT: &str = include_str!("deadline.py");

pub(crate) fn export(graph: &Graph) -> Vec<File> {
    let groups = graph.groups();
    let stem = |number: usize| format!("{:04}_{}", number + 1, plain(groups[number].name));
    let mut files = Vec::new();
    let mut order = Vec::new();
    for (number, group) in groups.iter().enumerate() {
        let stem_of = stem(number);
        files.push(File::new(format!("{stem_of}.job"), job_info(graph, group)));
        files.push(File::new(format!("{stem_of}.plugin"), plugin_info(graph, group)));
        let inputs: Vec<String> = group.inputs.iter().map(|&input| stem(input)).collect();
        order.push(json!({ "job": stem_of, "inputs": inputs }));
    }
    let list = serde_json::to_string_pretty(&order).expect("names serialize");
    files.push(File::new("jobs.json", list + "\n"));
    files.push(File::script("submit.py", SUBMIT.into()));
    files
}

/// Joins lines, since a line of Deadline's files holds one value.
fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

fn job_info(graph: &Graph, group: &Group<'_>) -> String {
    let mut text = String::new();
    let frames = match group.units[0].block {
        Some([_, count]) => format!("1-{count}"),
        None => "1".into(),
    };
    let minutes = limit_seconds(group.seconds()).div_ceil(60);
    for (key, value) in [
        ("Plugin", "CommandLine".to_owned()),
        ("BatchName", one_line(&graph.name)),
        ("Name", one_line(&format!("{} {}", graph.name, group.name))),
        ("Frames", frames),
        ("ChunkSize", "1".into()),
        ("TaskTimeoutMinutes", minutes.to_string()),
        ("OverrideTaskFailureLimit", "true".into()),
        ("FailureDetectionTaskErrors", "3".into()),
    ] {
        let _ = writeln!(text, "{key}={value}");
    }
    text
}

fn plugin_info(graph: &Graph, group: &Group<'_>) -> String {
    let words = graph.command(&group.id_with("<STARTFRAME>"));
    // Deadline marks quotes with `<QUOTE>`. Paths of run folders do not contain this mark.
    let word = |word: &String| match word.contains(' ') {
        true => format!("<QUOTE>{}<QUOTE>", one_line(word)),
        false => one_line(word),
    };
    let arguments: Vec<String> = words[1..].iter().map(word).collect();
    format!(
        "Executable={}\nArguments={}\nShellExecute=false\nSingleFramesOnly=true\n",
        one_line(&words[0]),
        arguments.join(" ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn a_job_has_a_frame_per_block_and_follows_its_inputs() {
        let files = export(&sample());
        let text = |name: &str| &files.iter().find(|file| file.name == name).unwrap().text;
        assert!(text("0002_t0001_trace.job").contains("Frames=1-2\n"));
        let plugin = text("0002_t0001_trace.plugin");
        assert!(
            plugin.contains("Arguments=farm unit <QUOTE>/shots/a b<QUOTE> t0001/trace/<STARTFRAME>-of-2\n"),
            "{plugin}"
        );
        let list: serde_json::Value = serde_json::from_str(text("jobs.json")).unwrap();
        assert_eq!(list[6]["inputs"], json!(["0004_t0001_factorize", "0006_t0002_expose"]));
    }
}
