//! Open Job Description, 2023-09: a step per group of units, a task per unit.

use serde_json::{Value, json};

use crate::file::{File, limit_seconds};
use crate::graph::{Graph, Group};

/// Longest name of a step, characters.
const LONGEST_NAME: usize = 64;
/// Largest number of values of a task parameter.
const MOST_TASKS: usize = 1024;
const MIB: u64 = 1 << 20;

pub(crate) fn export(graph: &Graph) -> Vec<File> {
    let groups = graph.groups();
    let mut steps = Vec::new();
    for (number, group) in groups.iter().enumerate() {
        let needed: Vec<Value> = group
            .inputs
            .iter()
            .flat_map(|&input| parts(&groups[input], input))
            .map(|(name, _)| json!({ "dependsOn": name }))
            .collect();
        for (name, ids) in parts(group, number) {
            steps.push(step(graph, group, &name, &ids, &needed));
        }
    }
    let name: String = graph.name.chars().filter(|c| !c.is_control()).collect();
    let name: String = separated(&name).chars().take(128).collect();
    let mut parameters = vec![
        json!({
            "name": "Program",
            "type": "STRING",
            "default": graph.command.first().map_or("lumistack", String::as_str),
            "description": "The program on the workers",
        }),
        json!({
            "name": "Folder",
            // The type is not PATH, since a parameter of that type may not have an absolute
            // default.
            "type": "STRING",
            "default": graph.folder,
            "description": "The run folder, which all workers share",
        }),
    ];
    parameters.extend(arguments(graph).1);
    let template = json!({
        "specificationVersion": "jobtemplate-2023-09",
        "name": if name.is_empty() { "lumistack" } else { &name },
        "parameterDefinitions": parameters,
        "steps": steps,
    });
    let text = serde_json::to_string_pretty(&template).expect("templates serialize");
    vec![File::new("template.json", text + "\n")]
}

/// Separates equal braces in a row, since two of them begin or end an expression of Open Job
/// Description.
fn separated(text: &str) -> String {
    let mut result = String::new();
    for c in text.chars() {
        if matches!(c, '{' | '}') && result.ends_with(c) {
            result.push(' ');
        }
        result.push(c);
    }
    result
}

/// Returns the words of the command after the program, and definitions of the parameters that they
/// name. A word with two equal braces in a row becomes the value of a parameter, since Open Job
/// Description reads no expressions in this value.
fn arguments(graph: &Graph) -> (Vec<String>, Vec<Value>) {
    let (mut words, mut parameters) = (Vec::new(), Vec::new());
    for (number, word) in graph.command.iter().enumerate().skip(1) {
        if separated(word) == *word {
            words.push(word.clone());
        } else {
            let name = format!("Word{number}");
            words.push(format!("{{{{Param.{name}}}}}"));
            parameters.push(json!({ "name": name, "type": "STRING", "default": word }));
        }
    }
    (words, parameters)
}

/// Converts a group to steps; each step has a name and the ids of its units. A group with more than
/// [`MOST_TASKS`] units becomes several steps.
fn parts<'a>(group: &Group<'a>, number: usize) -> Vec<(String, Vec<&'a str>)> {
    let ids: Vec<&str> = group.units.iter().map(|unit| unit.id.as_str()).collect();
    let chunks: Vec<&[&str]> = ids.chunks(MOST_TASKS).collect();
    let count = chunks.len();
    let name = |part: usize| {
        let suffix = if count > 1 { format!(" {}", part + 1) } else { String::new() };
        let long = format!("{}{suffix}", group.name);
        match long.chars().count() <= LONGEST_NAME {
            true => long,
            false => format!("group {}{suffix}", number + 1),
        }
    };
    chunks.into_iter().enumerate().map(|(part, ids)| (name(part), ids.to_vec())).collect()
}

fn step(graph: &Graph, group: &Group<'_>, name: &str, ids: &[&str], needed: &[Value]) -> Value {
    let (first, _) = arguments(graph);
    let rest = ["{{Param.Folder}}", "{{Task.Param.Unit}}"].map(String::from);
    let mut step = json!({
        "name": name,
        "parameterSpace": {
            "taskParameterDefinitions": [{ "name": "Unit", "type": "STRING", "range": ids }],
        },
        "hostRequirements": {
            "amounts": [{ "name": "amount.worker.memory", "min": group.memory_bytes().div_ceil(MIB).max(1) }],
        },
        "script": {
            "actions": {
                "onRun": {
                    "command": "{{Param.Program}}",
                    "args": first.into_iter().chain(rest).collect::<Vec<_>>(),
                    "timeout": limit_seconds(group.seconds()),
                    "cancelation": { "mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": 30 },
                },
            },
        },
    });
    if !needed.is_empty() {
        step["dependencies"] = needed.into();
    }
    step
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn steps_are_groups_and_tasks_are_units() {
        let template: Value = serde_json::from_str(&export(&sample())[0].text).unwrap();
        let steps = template["steps"].as_array().unwrap();
        let step = |name: &str| steps.iter().find(|step| step["name"] == name).unwrap();
        let range = &step("t0001/trace")["parameterSpace"]["taskParameterDefinitions"][0]["range"];
        assert_eq!(*range, json!(["t0001/trace/1-of-2", "t0001/trace/2-of-2"]));
        assert_eq!(
            step("t0002/factorize")["dependencies"],
            json!([{"dependsOn": "t0001/factorize"}, {"dependsOn": "t0002/expose"}])
        );
        assert!(step("place").get("dependencies").is_none());
    }

    #[test]
    fn braces_of_names_and_paths_are_no_expressions() {
        let mut graph = sample();
        graph.name = "a {{{b}}}{\u{1}{".into();
        graph.command.extend(["--map", "/{{a}}=/b"].map(String::from));
        let template: Value = serde_json::from_str(&export(&graph)[0].text).unwrap();
        assert_eq!(template["name"], "a { { {b} } }{ {");
        let run = &template["steps"][0]["script"]["actions"]["onRun"];
        assert_eq!(
            run["args"],
            json!(["farm", "unit", "--map", "{{Param.Word4}}", "{{Param.Folder}}", "{{Task.Param.Unit}}"])
        );
        let parameter = &template["parameterDefinitions"][2];
        assert_eq!((&parameter["name"], &parameter["default"]), (&json!("Word4"), &json!("/{{a}}=/b")));
    }

    #[test]
    fn a_group_beyond_the_limits_is_several_steps() {
        let mut graph = sample();
        let long = "n".repeat(80);
        let count = MOST_TASKS + 5;
        let unit = graph.units[1].clone();
        let blocks = (1..=count).map(|block| crate::Unit {
            id: format!("{long}/{block}-of-{count}"),
            block: Some([block, count]),
            ..unit.clone()
        });
        graph.units.splice(1..3, blocks);
        graph.units.iter_mut().find(|unit| unit.id == "t0001/expose").unwrap().inputs =
            vec![format!("{long}/1-of-{count}")];
        let template: Value = serde_json::from_str(&export(&graph)[0].text).unwrap();
        let names: Vec<&str> =
            template["steps"].as_array().unwrap().iter().map(|step| step["name"].as_str().unwrap()).collect();
        assert_eq!(&names[..3], ["place", "group 2 1", "group 2 2"]);
        let expose = template["steps"].as_array().unwrap().iter().find(|step| step["name"] == "t0001/expose").unwrap();
        assert_eq!(expose["dependencies"], json!([{"dependsOn": "group 2 1"}, {"dependsOn": "group 2 2"}]));
    }
}
