//! Tests of units of work. The bytes of results do not depend on how the plan is cut into units.
//! Units run in parallel, and wrong plans are refused.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use lumistack_pipeline::{BlockSize, FarmPlan, Job, Registry, farm_plan, farm_unit, run, sweep};

use crate::compose::{SOURCE, TIMES, job, json, results, with_task};

const DISPLAY: &str = "[display]\npreset = \"paper-three-layer\"\nresolution = [20, 12]\nframes = 2\n";
const CUT: BlockSize = BlockSize { block_seconds: 1.0, blocks: Some(2) };

fn scene() -> String {
    sample("letters/letters.gltf")
}

/// Returns the line of a job that names a sample scene.
fn sample(file: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(file).canonicalize().unwrap();
    format!("scene = {:?}\n", path.to_str().unwrap())
}

fn unit(dir: &Path, id: &str, registry: &Registry) -> Result<bool, String> {
    let done = with_task(|task| farm_unit(dir, id, &[], Duration::ZERO, registry, task));
    done.map(|done| done.cached).map_err(|error| error.to_string())
}

/// Executes all units in parallel, each as soon as its inputs are done.
fn execute(job: &Job, dir: &Path, registry: &Registry) -> FarmPlan {
    let plan = with_task(|task| farm_plan(job, dir, registry, CUT, task)).unwrap();
    let waiting = Mutex::new(plan.units.clone());
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                loop {
                    let next = {
                        let mut waiting = waiting.lock().unwrap();
                        let is_ready = |inputs: &[String]| inputs.iter().all(|id| plan.done(dir, id).is_some());
                        let ready = waiting.iter().position(|unit| is_ready(&unit.inputs));
                        if waiting.is_empty() {
                            break;
                        }
                        ready.map(|place| waiting.remove(place))
                    };
                    match next {
                        Some(next) => assert_eq!(unit(dir, &next.id, registry), Ok(false), "{}", next.id),
                        None => std::thread::sleep(Duration::from_millis(5)),
                    }
                }
            });
        }
    });
    plan
}

fn ids(plan: &FarmPlan) -> Vec<&str> {
    plan.units.iter().map(|unit| unit.id.as_str()).collect()
}

#[test]
fn units_of_a_still_give_the_bytes_of_a_run() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let job = job(folder.path(), &scene(), &[DISPLAY, "[render]\nsamples = 1\n"]);
    let [one, many] = ["one", "many"].map(|name| folder.path().join(name));
    with_task(|task| run(&job, &one, &registry, None, task)).unwrap();
    let plan = execute(&job, &many, &registry);
    let expected =
        ["place", "trace/1-of-2", "trace/2-of-2", "expose", "score/1-of-2", "score/2-of-2", "factorize", "finish"];
    assert_eq!(ids(&plan), expected);
    assert_eq!(results(&one), results(&many));
    // The report after the units has the same zone score as the report of a run.
    let figure = |dir: &PathBuf| json(&dir.join("report.json"))["psnr_zone"].clone();
    assert!(figure(&one).is_number() && figure(&one) == figure(&many));

    // A finished unit is skipped, except the last unit. The last unit checks all results, and makes
    // damaged results again.
    assert_eq!(unit(&many, "trace/2-of-2", &registry), Ok(true));
    std::fs::write(many.join("layers/layer_0.npy"), "damaged").unwrap();
    assert_eq!(unit(&many, "finish", &registry), Ok(false));
    assert_eq!(results(&one), results(&many));
    // A run may change results, so after it no unit is regarded as finished.
    with_task(|task| run(&job, &many, &registry, None, task)).unwrap();
    assert!(plan.done(&many, "expose").is_none());
    let error = unit(&many, "factorize", &registry).unwrap_err();
    assert!(error.contains("unit `factorize`") && error.contains("`expose`, which is not finished"), "{error}");
}

#[test]
fn units_of_a_capture_give_the_bytes_of_a_run() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let job = job(folder.path(), &sample("dandelion/dandelion.spz"), &[DISPLAY, "views = [5, 5]\n"]);
    let [one, many] = ["one", "many"].map(|name| folder.path().join(name));
    with_task(|task| run(&job, &one, &registry, None, task)).unwrap();
    let plan = execute(&job, &many, &registry);
    assert!(ids(&plan).contains(&"trace/2-of-2"), "{:?}", ids(&plan));
    assert_eq!(results(&one), results(&many));
}

#[test]
fn units_of_a_sequence_of_two_nodes_give_the_bytes_of_a_run() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let nodes = "[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\n[nodes.display]\npreset = \"fig4-two-layer\"\nframes = 1\n\
                 [[outputs]]\nplugin = \"images\"\nfrom = \"a\"\n[[outputs]]\nplugin = \"images\"\nfrom = \"light_field\"\n";
    let display = format!("{DISPLAY}views = [3, 3]\n");
    let source = job(folder.path(), "name = \"both\"", &[SOURCE, &display, nodes, TIMES]);
    let [one, many] = ["one", "many"].map(|name| folder.path().join(name));
    with_task(|task| run(&source, &one, &registry, None, task)).unwrap();
    let plan = execute(&source, &many, &registry);
    assert_eq!(results(&one), results(&many));
    let of = |id: &str| plan.units.iter().find(|unit| unit.id == id).unwrap();
    let warm = &of("t0002/nodes/a/factorize").inputs;
    assert!(warm.contains(&"t0002/source".to_owned()) && warm.contains(&"t0001/nodes/a/factorize".to_owned()));
    assert_eq!(of("t0001/nodes/a/results").steps.len(), 2);
    assert_eq!(of("t0001/nodes/a/results").writes[0], "t0001/outputs/a");
    // The two reports of the sequence differ in durations and paths, so compare only a score.
    let times = |dir: &PathBuf| json(&dir.join("report.json"))["nodes"][0]["psnr_change"].clone();
    assert!(times(&one).is_number() && times(&one) == times(&many));
}

#[test]
fn units_of_a_moving_window_give_the_bytes_of_a_run() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let sequence = "[sequence]\ntimes = 3\niterations = 2\nturn_deg = 8.0\nreports = true\n";
    let views = format!("{DISPLAY}views = [3, 3]\n[render]\nsamples = 1\n");
    let job = job(folder.path(), &scene(), &[&views, sequence]);
    let [one, many] = ["one", "many"].map(|name| folder.path().join(name));
    with_task(|task| run(&job, &one, &registry, None, task)).unwrap();
    let plan = execute(&job, &many, &registry);
    assert_eq!(results(&one), results(&many));
    // Units that render views need only the placement, at every time step.
    for unit in plan.units.iter().filter(|unit| unit.block.is_some()) {
        assert_eq!(unit.inputs, ["place"], "{}", unit.id);
    }
    assert!(many.join("t0003/report.html").is_file());
}

#[test]
fn chunks_of_a_sequence_do_not_wait_for_each_other() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let sequence = "[sequence]\ntimes = 5\niterations = 2\nturn_deg = 4.0\nchunk_times = 3\nwarm_up_times = 2\n";
    let nodes = "[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\n[[outputs]]\nplugin = \"images\"\nfrom = \"a\"\n";
    let views = format!("{DISPLAY}views = [3, 3]\n[render]\nsamples = 1\n");
    for nodes in ["", nodes] {
        let job = job(folder.path(), &scene(), &[&views, sequence, nodes]);
        let [one, many] = ["one", "many"].map(|name| folder.path().join(format!("{name}{}", nodes.len())));
        with_task(|task| run(&job, &one, &registry, None, task)).unwrap();
        let plan = execute(&job, &many, &registry);
        assert_eq!(results(&one), results(&many));
        let node = if nodes.is_empty() { "" } else { "nodes/b/" };
        let inputs = |time: usize| {
            let id = format!("t000{time}/{node}factorize");
            plan.units.iter().find(|unit| unit.id == id).unwrap().inputs.clone()
        };
        // The inputs are the light fields of the warm-up and of the time step itself, not the
        // patterns of the previous time step.
        assert_eq!(inputs(4), ["t0002/expose", "t0003/expose", "t0004/expose"]);
        assert!(inputs(5).contains(&format!("t0004/{node}factorize")));
        // The job of a time step does not show a warm-up, since a time step may prefer a fresh
        // start. So check the files.
        let warm_up = many.join("cache/warm-up/t0004/t0003").join(node).join("layers/stack.json");
        assert!(warm_up.is_file() && !many.join("cache/warm-up/t0005").exists());
        // The content moves little, so chunks change the error only slightly.
        let chain = folder.path().join(format!("chain{}", nodes.len()));
        let mut whole = job.clone();
        (whole.sequence.as_mut().unwrap().chunk_times, whole.sequence.as_mut().unwrap().warm_up_times) = (None, None);
        with_task(|task| run(&whole, &chain, &registry, None, task)).unwrap();
        let error = |dir: &PathBuf| {
            let report = json(&dir.join("report.json"));
            let of = if nodes.is_empty() { &report } else { &report["nodes"][1] };
            of["times"][3]["psnr_view"].as_f64().unwrap_or_else(|| panic!("{report}"))
        };
        assert!((error(&chain) - error(&many)).abs() < 1.0, "{} {}", error(&chain), error(&many));
    }
}

#[test]
fn designs_are_units() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let display = format!("{DISPLAY}views = [3, 3]\n");
    let job = job(folder.path(), "", &[SOURCE, &display, "[sweep]\nframes = [1, 2]\nlayers = [2, 3]\n"]);
    let [one, many] = ["one", "many"].map(|name| folder.path().join(name));
    with_task(|task| sweep(&job, &one, &registry, task)).unwrap();
    let plan = execute(&job, &many, &registry);
    assert_eq!(ids(&plan)[1..], ["designs/1-of-4", "designs/2-of-4", "designs/3-of-4", "designs/4-of-4", "finish"]);
    assert_eq!(plan.units.last().unwrap().writes, ["job.toml", "sweep.csv", "sweep.json", "plots"]);
    assert_eq!(results(&one), results(&many));
}

#[test]
fn workers_of_other_code_and_other_folders_are_refused() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let job = job(folder.path(), "name = \"a\"", &[SOURCE, DISPLAY]);
    let dir = folder.path().join("run");
    let error = unit(&dir, "source", &registry).unwrap_err();
    assert!(error.contains("expected a run folder with a farm's plan, found none"), "{error}");
    let plan = with_task(|task| farm_plan(&job, &dir, &registry, CUT, task)).unwrap();
    assert!(unit(&dir, "t0009/source", &registry).unwrap_err().contains("the id of a unit"));
    // Change the fingerprint of the code in the plan, as if another build had planned.
    let file = dir.join("cache/farm/plan.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let (_, value) = text.split_once("\",\"value\":").unwrap();
    let value = value.strip_suffix('}').unwrap().replace(&plan.code, "0123456789abcdef");
    let hash = blake3::hash(value.as_bytes()).to_hex();
    std::fs::write(&file, format!("{{\"blake3\":\"{hash}\",\"value\":{value}}}")).unwrap();
    let error = with_task(|task| farm_unit(&dir, "source", &[], Duration::ZERO, &registry, task)).unwrap_err();
    assert!(error.is_machine_specific() && error.to_string().contains("0123456789abcdef"), "{error}");
    // Plan the same job again with this build.
    with_task(|task| farm_plan(&job, &dir, &registry, CUT, task)).unwrap();
    assert_eq!(unit(&dir, "source", &registry), Ok(false));
}

/// A changed file of a plugin's parameter makes another plan, and `--map` maps such files.
#[test]
fn a_plan_depends_on_the_files_of_its_job() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let [there, here] = ["there", "here"].map(|name| folder.path().join(name));
    let calibration = serde_json::json!({"pitch": {"value": 47.5}, "slope": {"value": -7.2}, "center": {"value": 0.5},
        "DPI": {"value": 338.0}, "screenW": {"value": 1536.0}, "screenH": {"value": 2048.0}});
    for place in [&there, &here] {
        std::fs::create_dir(place).unwrap();
        std::fs::write(place.join("visual.json"), calibration.to_string()).unwrap();
    }
    let output = "[[outputs]]\nplugin = \"quilt\"\nfrom = \"light_field\"\nparams = { calibration = \"visual.json\", columns = 3, rows = 1 }\n";
    let display = format!("{DISPLAY}views = [3, 3]\n");
    let job = job(&there, "", &[SOURCE, &display, output]);
    let dir = folder.path().join("run");
    let plan = || with_task(|task| farm_plan(&job, &dir, &registry, CUT, task)).unwrap().id;
    let first = plan();
    assert_eq!(plan(), first);
    std::fs::write(there.join("visual.json"), format!("{calibration} ")).unwrap();
    assert_ne!(plan(), first);
    // on this machine, the files are elsewhere
    std::fs::remove_dir_all(&there).unwrap();
    let maps = [(there, here)];
    let planned = FarmPlan::load(&dir).unwrap();
    for unit in &planned.units {
        let done = with_task(|task| farm_unit(&dir, &unit.id, &maps, Duration::ZERO, &registry, task));
        assert!(done.is_ok(), "{}: {:?}", unit.id, done.map_err(|error| error.to_string()));
    }
}
