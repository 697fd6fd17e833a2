//! Tests plans that combine sequences, nodes and sweeps, and executes every step of a plan alone.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_pipeline::{Job, Plan, Registry, plan, run, run_step, sweep};
use serde_json::Value;

/// Tolerance of a sweep's scores against the scores of a run, dB. Sweep and run sum the same errors
/// in different orders.
const AGREEMENT_DB: f64 = 1e-9;

const DISPLAY: &str = "[display]\npreset = \"paper-three-layer\"\nresolution = [24, 15]\nviews = [3, 3]\nframes = 2\n";
const NODES: &str = "[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\n[nodes.display]\npreset = \"fig4-two-layer\"\nframes = 1\n\
                     [[outputs]]\nplugin = \"images\"\nfrom = \"a\"\n[[outputs]]\nplugin = \"images\"\nfrom = \"light_field\"\n";
pub(crate) const SOURCE: &str = "[source]\nplugin = \"test_views\"\nparams = { pattern = \"numbers\" }\n";
pub(crate) const TIMES: &str = "[sequence]\ntimes = 2\niterations = 3\nduration_s = 0.5\n";

pub(crate) fn with_task<T>(work: impl FnOnce(Task<'_>) -> T) -> T {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    work(Task::quiet(&warnings, &cancel))
}

pub(crate) fn job(folder: &Path, head: &str, tables: &[&str]) -> Job {
    let path = folder.join("job.toml");
    std::fs::write(&path, format!("{head}\n{}[factorize]\niterations = 6\n", tables.concat())).unwrap();
    Job::load(&path).unwrap()
}

/// Returns the files in a folder and its subfolders, without the cache, job files and reports. Job
/// files contain paths, and reports contain the durations of the stages.
pub(crate) fn results(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn walk(folder: &Path, root: &Path, found: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() && name != "cache" {
                walk(&path, root, found);
            } else if path.is_file() && !name.starts_with("report.") && name != "job.toml" {
                found.insert(path.strip_prefix(root).unwrap().to_owned(), std::fs::read(&path).unwrap());
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(dir, dir, &mut found);
    found
}

pub(crate) fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn cached(plan: &Plan, id: &str) -> Option<bool> {
    plan.steps.iter().find(|step| step.id == id).unwrap_or_else(|| panic!("{id} is no step")).cached
}

/// A plan that its run would refuse has no use. So a plan and its run check plugins alike.
#[test]
fn a_plan_refuses_the_plugins_that_its_run_refuses() {
    let folder = tempfile::tempdir().unwrap();
    let registry = Registry::built_in().unwrap();
    let output = "[[outputs]]\nplugin = \"no_such_plugin\"\n";
    let node = "[[nodes]]\nid = \"a\"\nplugin = \"images\"\n";
    let params = "[[outputs]]\nplugin = \"images\"\nparams = { no_such = 1 }\n";
    for (source, wrong) in [(SOURCE, output), (SOURCE, node), (SOURCE, params), ("[source]\nplugin = \"images\"\n", "")]
    {
        let job = job(folder.path(), "", &[source, DISPLAY, wrong]);
        let run_dir = folder.path().join("run");
        let refused = with_task(|task| run(&job, &run_dir, &registry, None, task)).unwrap_err().to_string();
        let found = plan(&job, &folder.path().join("plan"), &registry).map(|_| ()).unwrap_err().to_string();
        assert_eq!(found, refused);
    }
}

#[test]
fn a_sweep_over_a_sequence_of_two_nodes() {
    let registry = Registry::built_in().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let job = job(folder.path(), "name = \"both\"", &[SOURCE, DISPLAY, NODES, TIMES]);
    let dir = folder.path().join("run");
    assert_eq!(cached(&plan(&job, &dir, &registry).unwrap(), "t0002/nodes/a/factorize"), Some(false));
    assert!(!dir.exists(), "a plan writes nothing");

    let summary = with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
    assert_eq!(summary.nodes.iter().map(|node| node.id.as_str()).collect::<Vec<_>>(), ["a", "b"]);
    assert_eq!(summary.sequence.unwrap().times, 2);
    for file in ["nodes/a/layers/stack.json", "nodes/b/layers/stack.json", "outputs/a/images/images.json"] {
        assert!(dir.join("t0002").join(file).is_file(), "{file}");
    }
    let report = json(&dir.join("report.json"));
    for (number, id) in ["a", "b"].iter().enumerate() {
        let node = &report["nodes"][number];
        assert_eq!((&node["id"], node["times"].as_array().unwrap().len()), (&Value::from(*id), 2));
        assert_eq!(node["times"][1]["iterations"], 3);
        assert!(node["psnr_change"].is_number(), "{node}");
    }
    assert_eq!(report["psnr_view"], report["nodes"][0]["psnr_view"]);

    // The next run uses all cached results, as the plan predicts.
    let found = plan(&job, &dir, &registry).unwrap();
    for id in ["t0001/source", "t0001/nodes/a/factorize", "t0002/nodes/b/factorize", "t0002/nodes/a/output-images"] {
        assert_eq!(cached(&found, id), Some(true), "{id}");
    }
    let output = found.steps.iter().find(|step| step.id == "t0002/nodes/a/output-images").unwrap();
    assert_eq!(output.writes, ["../../outputs/a"]);
    assert!(found.steps.iter().all(|step| step.memory_bytes > 0 && step.key.is_some()));
    let first = results(&dir);
    with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
    assert!(results(&dir) == first);
    assert!(
        json(&dir.join("report.json"))["nodes"][1]["times"].as_array().unwrap().iter().all(|t| t["cached"] == true)
    );

    // A time step is a graph that can be run by itself.
    let alone = folder.path().join("alone");
    let of_time = Job::load(&dir.join("t0002/job.toml")).unwrap();
    with_task(|task| run(&of_time, &alone, &registry, None, task)).unwrap();
    let (again, all) = (results(&alone), &first);
    for name in ["nodes/a/layers/layer_0.npy", "nodes/b/layers/layer_0.npy"] {
        assert!(again[Path::new(name)] == all[&Path::new("t0002").join(name)], "{name}");
    }

    // The displays of node a are the designs. Node b has its own display, so its scores are equal
    // in every row.
    let mut swept = job.clone();
    let table = lumistack_pipeline::SweepJob { frames: vec![1, 2], ..lumistack_pipeline::SweepJob::default() };
    swept.sweep = Some(table);
    let out = folder.path().join("sweep");
    let done = with_task(|task| sweep(&swept, &out, &registry, task)).unwrap();
    assert_eq!((done.designs, done.kept), (2, 0));
    let rows = json(&out.join("sweep.json"))["rows"].clone();
    let figure = |row: usize, node: usize, key: &str| rows[row]["nodes"][node][key].as_f64().unwrap();
    assert_eq!(figure(0, 1, "psnr_view_db"), figure(1, 1, "psnr_view_db"));
    assert_ne!(figure(0, 0, "psnr_view_db"), figure(1, 0, "psnr_view_db"), "{rows}");
    for (node, summed) in summary.nodes.iter().enumerate() {
        let (found, wanted) = (figure(1, node, "psnr_view_db"), summed.psnr_view);
        assert!((found - wanted).abs() < AGREEMENT_DB, "{}: {found} dB, the run has {wanted} dB", summed.id);
        assert!(figure(1, node, "psnr_worst_db") <= found);
    }
    let csv = std::fs::read_to_string(out.join("sweep.csv")).unwrap();
    assert!(csv.lines().next().unwrap().ends_with(
        ",psnr_worst_db,a_psnr_zone_db,a_psnr_view_db,a_psnr_worst_db,b_psnr_zone_db,b_psnr_view_db,b_psnr_worst_db"
    ));
    // A plan does not know if earlier sweeps have solved the designs.
    let found = plan(&swept, &out, &registry).unwrap();
    assert_eq!(cached(&found, "design-00001"), None);
    assert_eq!(found.steps.last().unwrap().writes, ["job.toml", "sweep.csv", "sweep.json", "plots"]);
    let again = with_task(|task| sweep(&swept, &out, &registry, task)).unwrap();
    assert_eq!((again.designs, again.kept), (2, 2));
}

/// A window moves through a scene in front of two displays. Each display has a report at each time
/// step.
#[test]
fn a_walk_before_two_displays() {
    let registry = Registry::built_in().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/letters/letters.gltf");
    let head = format!("name = \"walk\"\nscene = {scene:?}");
    let render = "[render]\nsamples = 1\nheld_out = 0\noutside = 0\n[report]\nzone_directions = 0\n";
    let walk = "[sequence]\ntimes = 2\niterations = 2\nturn_deg = 5.0\nreports = true\n";
    let job = job(folder.path(), &head, &[DISPLAY, render, NODES, walk]);
    let dir = folder.path().join("run");
    let summary = with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
    assert_eq!(summary.nodes.len(), 2);
    for time in ["t0001", "t0002"] {
        let graph = json(&dir.join(time).join("report.json"));
        assert_eq!(graph["nodes"].as_array().unwrap().len(), 2, "{graph}");
        assert!(dir.join(time).join("nodes/b/report.html").is_file());
    }
    let found = plan(&job, &dir, &registry).unwrap();
    for id in ["t0001/trace", "t0002/trace", "t0002/expose", "t0002/nodes/a/factorize"] {
        assert_eq!(cached(&found, id), Some(true), "{id}");
    }
    // A step whose files were damaged later is not current.
    std::fs::write(dir.join("t0002/nodes/a/layers/layer_0.npy"), "damaged").unwrap();
    assert_eq!(cached(&plan(&job, &dir, &registry).unwrap(), "t0002/nodes/a/factorize"), Some(false));
}

#[test]
fn a_sweep_over_a_walk_is_scored_over_the_zone_of_all_its_times() {
    let registry = Registry::built_in().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/letters/letters.gltf");
    let head = format!("name = \"walk\"\nscene = {scene:?}");
    // A sweep does not compress depth, so the run must not compress it either.
    let render = "[render]\nsamples = 1\nmax_bounces = 1\noutside = 0\n[window]\nfit_depth = \"off\"\n";
    let walk = "[sequence]\ntimes = 2\niterations = 2\nturn_deg = 5.0\nreports = true\n";
    let mut job = job(folder.path(), &head, &[DISPLAY, render, walk]);
    let dir = folder.path().join("run");
    with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
    let of_run = ["t0001", "t0002"].map(|time| {
        let report = json(&dir.join(time).join("report.json"));
        report["psnr_zone"].as_f64().unwrap_or_else(|| panic!("{time} has no zone score"))
    });
    assert!((of_run[0] - of_run[1]).abs() > 1e-3, "two different pictures: {of_run:?}");

    // The zone score also exists if the run writes no reports of time steps.
    job.sequence.as_mut().unwrap().reports = false;
    job.sweep = Some(lumistack_pipeline::SweepJob { frames: vec![2], ..lumistack_pipeline::SweepJob::default() });
    let done = with_task(|task| sweep(&job, &folder.path().join("sweep"), &registry, task)).unwrap();
    // The directions of both time steps have the same weight.
    let error = of_run.iter().map(|psnr| 10f64.powf(-0.1 * psnr)).sum::<f64>() / 2.0;
    let (expected, found) = (-10.0 * error.log10(), done.best.and_then(|row| row.psnr_zone_db));
    assert!(found.is_some_and(|found| (found - expected).abs() < 1e-6), "{found:?} dB, the run has {expected} dB");
}

#[test]
fn every_step_can_be_executed_alone() {
    let registry = Registry::built_in().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let job = job(folder.path(), "name = \"both\"", &[SOURCE, DISPLAY, NODES, TIMES]);
    let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
    with_task(|task| run(&job, &whole, &registry, None, task)).unwrap();
    for step in plan(&job, &parts, &registry).unwrap().steps {
        // Each step is executed alone. Its only inputs are the files in the run folder.
        with_task(|task| run_step(&job, &parts, &step.id, &registry, task)).unwrap();
    }
    assert!(results(&whole) == results(&parts));
    assert!(parts.join("report.html").is_file());
    let error = with_task(|task| run_step(&job, &parts, "t0009/factorize", &registry, task)).unwrap_err();
    assert!(error.to_string().contains("t0009/factorize"), "{error}");
}

#[test]
fn a_light_field_in_a_file_gives_what_one_in_memory_gives() {
    let registry = Registry::built_in().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/letters/letters.gltf");
    let head = format!("name = \"paged\"\nscene = {scene:?}");
    let display = "[display]\npreset = \"paper-three-layer\"\nresolution = [60, 40]\nviews = [5, 5]\nframes = 2\n";
    let report = "[report]\nzone_directions = 0\n";
    let mut found = Vec::new();
    // The light field has 60,000 rays of 32 bytes, which is more than one MiB.
    for (name, limit) in [("held", 4096), ("paged", 1)] {
        let render = format!("[render]\nsamples = 1\nmax_bounces = 1\nfield_mib = {limit}\n");
        let job = job(folder.path(), &head, &[display, &render, report]);
        let dir = folder.path().join(name);
        with_task(|task| run(&job, &dir, &registry, None, task)).unwrap();
        found.push(results(&dir));
    }
    assert!(found[0].len() > 30 && found[0].keys().eq(found[1].keys()), "{:?}", found[0].keys());
    for (path, bytes) in &found[0] {
        assert!(*bytes == found[1][path], "{}", path.display());
    }
}
