//! Flamenco 3: a job type for the manager's folder `scripts`, and a job for its API.

use serde_json::json;

use crate::file::File;
use crate::graph::Graph;

/// The job type: a script by which the manager compiles a job into tasks. There is a task per unit,
/// with the dependencies of the graph.
const JOB_TYPE: &str = include_str!("flamenco.js");

pub(crate) fn export(graph: &Graph) -> Vec<File> {
    let units: Vec<_> = graph
        .units
        .iter()
        .map(|unit| {
            json!({
                "id": unit.id,
                "inputs": unit.inputs,
                "command": graph.command(&unit.id),
                "kind": unit.kind.name(),
            })
        })
        .collect();
    let job = json!({
        "name": graph.name,
        "type": "lumistack",
        "priority": 50,
        "submitter_platform": "linux",
        "settings": {
            "folder": graph.folder,
            "units": serde_json::to_string(&units).expect("units serialize"),
        },
        "metadata": { "project": graph.name },
    });
    let text = serde_json::to_string_pretty(&job).expect("jobs serialize");
    vec![File::new("lumistack.js", JOB_TYPE), File::new("job.json", text + "\n")]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    /// The command `exec` of Flamenco has no time limit, so a job states none.
    #[test]
    fn the_job_type_reads_every_value_of_a_unit() {
        let job: serde_json::Value = serde_json::from_str(&export(&sample())[1].text).unwrap();
        let units: serde_json::Value = serde_json::from_str(job["settings"]["units"].as_str().unwrap()).unwrap();
        for key in units[0].as_object().unwrap().keys() {
            assert!(JOB_TYPE.contains(&format!("unit.{key}")), "{key}");
        }
    }

    #[test]
    fn a_job_carries_its_units() {
        let job: serde_json::Value = serde_json::from_str(&export(&sample())[1].text).unwrap();
        let units: serde_json::Value = serde_json::from_str(job["settings"]["units"].as_str().unwrap()).unwrap();
        assert_eq!(units[1]["command"][4], "t0001/trace/1-of-2");
        assert_eq!(units[6]["inputs"], json!(["place"]));
    }
}
