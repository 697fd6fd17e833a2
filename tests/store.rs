//! Stored results: damaged and stale results are made again, and `clean` removes results that are
//! not needed.
//!
//! Only one run at a time uses a folder, and files of other programs are not replaced. If an output
//! refuses a display, the error comes before the work; if an output cannot be written, only this
//! output fails.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use serde_json::Value;

use crate::common::{cached, fail, files, lumistack, report, root, serve_preview, succeed, write_test_field};

const FIELD: [&str; 4] = ["--fov", "20x20", "--pitch-mm", "3"];
const SMALL: [&str; 8] = ["--resolution", "24x16", "--samples", "1", "--iterations", "2", "--frames", "2"];

/// Writes a light field into a folder, and returns its path.
fn field(folder: &Path) -> PathBuf {
    let path = folder.join("views.npy");
    write_test_field(&path, [3, 3, 16, 24], 20.0, 3.0);
    path
}

fn factorize(field: &Path, run: &Path, iterations: u32) -> Command {
    let mut command = lumistack();
    command.arg("factorize").arg(field).arg("-o").arg(run).args(FIELD).args(["--frames", "2"]);
    command.arg("--iterations").arg(iterations.to_string());
    command
}

fn render(run: &Path) -> Command {
    let mut command = lumistack();
    command.arg("run").arg(root().join("scenes/glass/glass.gltf")).arg("-o").arg(run).args(SMALL);
    command
}

/// Writes a job of a light field; `outputs` are its tables of outputs as TOML. Returns the job's
/// path.
fn job(folder: &Path, frames: usize, outputs: &str) -> PathBuf {
    field(folder);
    let path = folder.join("my-job.toml");
    let text = format!(
        "light_field = \"views.npy\"\n{outputs}\n[geometry]\nfov_deg = [20, 20]\npitch_mm = 3.0\n\
         [display]\npreset = \"fig7-uniform\"\nframes = {frames}\n[factorize]\niterations = 2\n"
    );
    fs::write(&path, text).unwrap();
    path
}

/// Changes the last byte of a file, but neither its size nor its modification time.
fn damage(path: &Path) {
    let time = fs::metadata(path).unwrap().modified().unwrap();
    let mut bytes = fs::read(path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(path, bytes).unwrap();
    set_time(path, time);
}

fn set_time(path: &Path, time: SystemTime) {
    File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
}

/// Returns the files of a run, without the cache and without reports.
fn results(run: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let all = files(run).into_iter();
    all.filter(|(path, _)| !path.starts_with("cache") && !path.to_string_lossy().contains("report")).collect()
}

#[test]
fn results_that_were_damaged_at_equal_size_are_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let (field, run) = (field(folder.path()), folder.path().join("run"));
    succeed(&mut factorize(&field, &run, 2));
    let whole = results(&run);
    succeed(&mut factorize(&field, &run, 2));
    assert!(cached(&run, "factorize") && cached(&run, "output-images"));
    for (file, stage) in [
        ("layers/layer_0.npy", Some("factorize")),
        ("outputs/tensor-display/images/layer_0_frame_00.png", Some("output-images")),
        ("target/view_01_01.exr", None),
    ] {
        damage(&run.join(file));
        assert!(results(&run) != whole);
        succeed(&mut factorize(&field, &run, 2));
        assert!(stage.is_none_or(|stage| !cached(&run, stage)), "the damage of {file} is not detected");
        assert!(results(&run) == whole, "{file} is not as it was");
    }
}

#[test]
fn views_that_were_damaged_or_exchanged_are_traced_again() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(render(&run).args(["--views", "5x5"]));
    let whole = results(&run);
    let views = fs::read_dir(run.join("cache/views")).unwrap().map(|entry| entry.unwrap().path());
    let target = views.into_iter().find(|path| path.to_string_lossy().contains("target-")).unwrap();
    succeed(render(&run).args(["--views", "5x5"]));
    assert!(cached(&run, "render"));
    // replace a view by another view, which has the same size
    fs::copy(target.join("view_00_00.exr"), target.join("view_02_02.exr")).unwrap();
    succeed(render(&run).args(["--views", "5x5"]));
    assert!(!cached(&run, "render") && results(&run) == whole);
    damage(&target.join("view_01_01.exr"));
    succeed(render(&run).args(["--views", "5x5"]));
    assert!(!cached(&run, "render") && results(&run) == whole);
}

/// If one view is damaged, all views that share light with it are traced again together, since the
/// run has deleted the split views from which they were made.
#[test]
fn views_that_share_light_are_made_again_together() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(&mut render(&run));
    let whole = results(&run);
    let views = fs::read_dir(run.join("cache/views")).unwrap().map(|entry| entry.unwrap().path());
    let target = views.into_iter().find(|path| path.to_string_lossy().contains("target-")).unwrap();
    let parts = || -> Vec<String> {
        let names = fs::read_dir(&target).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| name.starts_with("split_")).collect()
    };
    assert_eq!(parts(), ["split_01_01.bin"], "only the middle view, which the report shows, stays as a split view");
    succeed(&mut render(&run));
    assert!(cached(&run, "render"));
    for name in ["shared/view_00_02.exr", "split_01_01.bin"] {
        damage(&target.join(name));
        succeed(&mut render(&run));
        assert!(!cached(&run, "render"), "the damage of {name} is not detected");
        assert!(results(&run) == whole, "{name} changed the result");
    }
}

#[test]
fn a_preview_of_other_patterns_is_made_anew_for_any_time() {
    let folder = tempfile::tempdir().unwrap();
    let (field, run) = (field(folder.path()), folder.path().join("run"));
    succeed(&mut factorize(&field, &run, 2));
    serve_preview(&run);
    let shown = run.join("preview/stack/layer0_frame0.png");
    let first = fs::read(&shown).unwrap();
    let written = fs::metadata(&shown).unwrap().modified().unwrap();
    serve_preview(&run);
    assert_eq!(fs::metadata(&shown).unwrap().modified().unwrap(), written, "nothing has changed");
    succeed(&mut factorize(&field, &run, 9));
    set_time(&run.join("preview/stack/preview.json"), SystemTime::now() + Duration::from_secs(3600));
    serve_preview(&run);
    assert!(fs::read(&shown).unwrap() != first, "the older patterns are shown");
    damage(&shown);
    serve_preview(&run);
    assert!(image::open(&shown).is_ok());
}

/// Key in the output of `lumistack info`, under which it lists the outputs that a run would refuse.
const WOULD_REFUSE: &str = "outputs that a run would refuse";

/// Returns the table of an output `quilt` with this number of columns of views.
fn quilt(columns: usize) -> String {
    format!(
        "[[outputs]]\nplugin = \"quilt\"\nfrom = \"light_field\"\n\
         params = {{ columns = {columns}, rows = 1, missing_views = \"refuse\" }}\n"
    )
}

#[test]
fn outputs_that_refuse_the_display_do_so_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let transparencies = "[[outputs]]\nplugin = \"transparencies\"\n";
    // For a light field, the error comes before the factorization: the display is known only after
    // the light field is read.
    let path = job(folder.path(), 12, transparencies);
    let error = fail(lumistack().arg("run").arg(&path).arg("-o").arg(&run));
    assert!(error.contains("transparencies") && error.contains("12"), "{error}");
    assert!(!run.join("layers").exists(), "it was factorized first");
    let info = succeed(lumistack().arg("info").arg(&path));
    assert!(info.contains(WOULD_REFUSE) && info.contains("transparencies") && info.contains("frames = 1"), "{info}");
    // for a scene, the error comes before the path tracer renders
    let scene = root().join("scenes/glass/glass.gltf");
    fs::write(folder.path().join("bad.json"), "{}").unwrap();
    for (outputs, reason) in [
        (transparencies, "12"),
        ("[[outputs]]\nplugin = \"quilt\"\nparams = { calibration = \"bad.json\" }\n", "calibration"),
        (&quilt(9), "views = [9, 1]"),
        (
            "[[outputs]]\nplugin = \"images\"\nfrom = \"light_field\"\nparams = { atlas = true, png8 = false }\n",
            "a light field lacks",
        ),
    ] {
        let path = folder.path().join("scene.toml");
        let text = format!(
            "scene = {:?}\n{outputs}[display]\npreset = \"fig7-uniform\"\nframes = 12\n",
            scene.display().to_string()
        );
        fs::write(&path, text).unwrap();
        let output = lumistack().args(["--json", "run"]).arg(&path).arg("-o").arg(&run).output().unwrap();
        let (printed, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(1));
        assert!(error.contains(reason) && !printed.contains("\"begin\""), "{error}{printed}");
        assert!(succeed(lumistack().arg("info").arg(&path)).contains(WOULD_REFUSE));
    }
    // an output is checked with the display of the node from which it gets its patterns
    let nodes = "[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\n[nodes.display]\npreset = \"fig7-uniform\"\nframes = 7\n\
                 [[outputs]]\nplugin = \"images\"\nfrom = \"a\"\n[[outputs]]\nplugin = \"transparencies\"\nfrom = \"b\"\n";
    let error = fail(lumistack().arg("run").arg(job(folder.path(), 1, nodes)).arg("-o").arg(&run));
    assert!(error.contains("found frames = 7") && !run.join("nodes/a/layers").exists(), "{error}");
}

#[test]
fn outputs_of_a_sequence_are_checked_on_the_light_fields_of_its_times() {
    let folder = tempfile::tempdir().unwrap();
    let times = folder.path().join("times");
    fs::create_dir(&times).unwrap();
    // the light fields have 5 × 5 views, although the job's display has 3 × 3 views
    ["t1.npy", "t2.npy"].iter().for_each(|name| write_test_field(&times.join(name), [5, 5, 16, 24], 20.0, 3.0));
    for (columns, nodes, is_refused) in [
        (5, "", false),
        (3, "", true),
        (5, "[[nodes]]\nid = \"a\"\n", false),
        (3, "[[nodes]]\nid = \"a\"\n", true),
        (5, "[[nodes]]\nid = \"a\"\n[[outputs]]\nplugin = \"transparencies\"\nfrom = \"a\"\n", true),
    ] {
        let path = folder.path().join("times.toml");
        let text = format!(
            "light_field = \"times\"\n{nodes}{}[sequence]\n[geometry]\nfov_deg = [20, 20]\npitch_mm = 3.0\n\
             [display]\npreset = \"fig7-uniform\"\n",
            quilt(columns)
        );
        fs::write(&path, text).unwrap();
        let info = succeed(lumistack().arg("info").arg(&path));
        assert_eq!(info.contains(WOULD_REFUSE), is_refused, "{columns} {nodes}: {info}");
    }
}

#[test]
fn an_output_that_fails_costs_neither_report_nor_other_outputs() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    // A file has the name of the output's folder. The run finds this file only when it writes the
    // output, so only this output fails.
    succeed(
        lumistack().arg("run").arg(job(folder.path(), 2, "[[outputs]]\nplugin = \"images\"\n")).arg("-o").arg(&run),
    );
    let blocked = run.join("outputs/light_field/quilt");
    fs::create_dir_all(blocked.parent().unwrap()).unwrap();
    fs::write(&blocked, "").unwrap();
    let outputs = "[[outputs]]\nplugin = \"images\"\n[[outputs]]\nplugin = \"images\"\nfrom = \"light_field\"\n";
    let path = job(folder.path(), 2, &[&quilt(3), outputs].concat());
    let error = fail(lumistack().arg("run").arg(&path).arg("-o").arg(&run));
    let reason = "expected a folder";
    assert!(error.contains("outputs/light_field/quilt") && error.contains(reason), "{error}");
    for finished in ["outputs/tensor-display/images/images.json", "outputs/light_field/images/images.json"] {
        assert!(run.join(finished).is_file(), "{finished} is missing");
    }
    let printed = report(&run);
    let failed: Vec<&Value> =
        printed["outputs"].as_array().unwrap().iter().filter(|output| !output["failed"].is_null()).collect();
    assert!(failed.len() == 1 && failed[0]["failed"].as_str().unwrap().contains(reason), "{failed:?}");
    let html = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(html.contains("quilt was not written") && html.contains(reason));
    let output = lumistack().args(["--json", "run"]).arg(&path).arg("-o").arg(&run).output().unwrap();
    let done = String::from_utf8_lossy(&output.stdout).lines().last().unwrap().to_owned();
    let done: Value = serde_json::from_str(&done).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(done["failed_outputs"][0]["path"], "outputs/light_field/quilt", "{done}");
}

#[test]
fn a_folder_has_one_owner_and_a_dead_one_holds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let mut first = lumistack()
        .arg("run")
        .arg(root().join("scenes/still-life/still-life.gltf"))
        .arg("-o")
        .arg(&run)
        .args(["--samples", "4096"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !run.join("cache/owner.json").exists() {
        assert!(start.elapsed() < Duration::from_secs(60) && first.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(10));
    }
    let field = field(folder.path());
    let commands: [Command; 3] = [
        factorize(&field, &run, 2),
        {
            let mut command = lumistack();
            command.arg("render").arg(root().join("scenes/glass/glass.gltf")).arg("-o").arg(&run);
            command
        },
        {
            let mut command = lumistack();
            command.arg("clean").arg(&run);
            command
        },
    ];
    for mut command in commands {
        let error = fail(&mut command);
        let process = format!("process {} on ", first.id());
        assert!(error.contains(&run.display().to_string()) && error.contains(&process), "{error}");
    }
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(run.join("cache/owner.json").exists(), "it had no time to tidy up");
    succeed(&mut factorize(&field, &run, 2));
    assert!(!run.join("cache/owner.json").exists());
}

#[test]
fn neither_foreign_files_nor_inputs_are_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let path = job(here, 2, "");
    let own = here.join("job.toml");
    fs::rename(path, &own).unwrap();
    let text = fs::read_to_string(&own).unwrap();
    let error = fail(lumistack().current_dir(here).args(["run", "job.toml", "-o", "."]));
    assert!(error.contains("job.toml") && error.contains("job file"), "{error}");
    // the folder has files of another program with the names of the run's files
    let error = fail(factorize(&here.join("views.npy"), Path::new("."), 2).current_dir(here));
    assert!(error.contains("job.toml") && error.contains("did not write"), "{error}");
    assert_eq!(fs::read_to_string(&own).unwrap(), text);
    let mut names: Vec<_> = fs::read_dir(here).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["job.toml", "views.npy"], "nothing was written");
    // a job that a run wrote may be run again in its folder, even with other settings
    let run = here.join("run");
    succeed(lumistack().arg("run").arg(&own).arg("-o").arg(&run));
    succeed(lumistack().arg("run").arg(run.join("job.toml")).arg("-o").arg(&run).args(["--iterations", "3"]));
    assert!(fs::read_to_string(run.join("job.toml")).unwrap().contains("iterations = 3"));
    // if a user has changed the job by hand, the run refuses the folder
    let changed = fs::read_to_string(run.join("job.toml")).unwrap().replace("iterations = 3", "iterations = 4");
    fs::write(run.join("job.toml"), &changed).unwrap();
    let error = fail(lumistack().arg("run").arg(&own).arg("-o").arg(&run));
    assert!(error.contains("job.toml") && error.contains("changed since"), "{error}");
    assert_eq!(fs::read_to_string(run.join("job.toml")).unwrap(), changed);
    let warm = run.join("layers");
    fs::remove_file(run.join("job.toml")).unwrap();
    let error = fail(factorize(&here.join("views.npy"), &run, 2).arg("--warm-start").arg(&warm));
    assert!(error.contains("warm start") && error.contains("layers"), "{error}");
}

/// Runs `lumistack --json clean`. Returns the freed bytes by kind of file, and the bytes that
/// remain.
fn clean(dir: &Path, flags: &[&str]) -> (Vec<(String, u64)>, u64) {
    let printed = succeed(lumistack().args(["--json", "clean"]).arg(dir).args(flags));
    let printed: Value = serde_json::from_str(printed.trim()).unwrap();
    let freed = printed["freed"].as_array().unwrap().iter();
    let freed: Vec<_> =
        freed.map(|kind| (kind["kind"].as_str().unwrap().to_owned(), kind["bytes"].as_u64().unwrap())).collect();
    assert_eq!(printed["freed_bytes"].as_u64().unwrap(), freed.iter().map(|kind| kind.1).sum::<u64>());
    (freed, printed["kept_bytes"].as_u64().unwrap())
}

fn views_of(run: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(run.join("cache/views"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn unneeded_files_are_removed_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(&mut render(&run));
    let first = views_of(&run);
    // make files that a killed run would leave behind
    let old = SystemTime::now() - Duration::from_secs(3600);
    let left = [".lumistack-abc123.tmp", "cache/.lumistack-abc124.tmp", "layers/.lumistack-abc125.tmp"];
    let leave = || {
        for name in left {
            fs::write(run.join(name), [7; 1000]).unwrap();
            set_time(&run.join(name), old);
        }
        fs::create_dir_all(run.join("outputs/tensor-display/.images.partial")).unwrap();
        fs::write(run.join("outputs/tensor-display/.images.partial/a.png"), [7; 500]).unwrap();
    };
    let is_left = || left.iter().any(|name| run.join(name).exists());
    leave();
    // another run removes the left-overs of the killed run, and the views of the earlier settings
    succeed(render(&run).args(["--seed", "5"]));
    assert!(!is_left() && !run.join("outputs/tensor-display/.images.partial").exists());
    let second = views_of(&run);
    assert!(second.len() == first.len() && second.iter().all(|name| !first.contains(name)), "{first:?} {second:?}");

    let whole = results(&run);
    assert!(clean(&run, &[]).0.is_empty(), "there is nothing");
    leave();
    fs::create_dir(run.join("cache/views").join(&first[0])).unwrap();
    fs::write(run.join("cache/views").join(&first[0]).join("view_00_00.exr"), [7; 300]).unwrap();
    let expected = [("left-overs of stopped runs".to_owned(), 3500), ("views of other settings".to_owned(), 300)];
    let (freed, kept) = clean(&run, &["--dry-run"]);
    assert_eq!(freed, expected);
    assert!(is_left(), "a dry run removes nothing");
    assert_eq!(clean(&run, &[]), (freed, kept));
    assert!(!is_left() && views_of(&run) == second && results(&run) == whole);
    succeed(render(&run).args(["--seed", "5"]));
    assert!(cached(&run, "render"), "what the settings need was kept");
    assert!(!placed(&run).is_empty());
    let (freed, kept_now) = clean(&run, &["--all"]);
    assert!(freed.iter().any(|(kind, bytes)| kind == "cached views" && *bytes > 1000), "{freed:?}");
    assert_eq!(placed(&run), [""; 0], "no file of the placement is left");
    assert!(kept_now < kept && results(&run) == whole);
    succeed(render(&run).args(["--seed", "5"]));
    assert!(!cached(&run, "render") && results(&run) == whole);
    let text = succeed(lumistack().arg("clean").arg(&run).args(["--all", "--dry-run"]));
    assert!(text.contains("cached views") && text.contains("would be freed"), "{text}");
    let error = fail(lumistack().arg("clean").arg(folder.path()));
    assert!(error.contains("the folder of a run"), "{error}");
}

/// Returns the names of the cached files of the placement.
fn placed(run: &Path) -> Vec<String> {
    let files = fs::read_dir(run.join("cache")).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    files.filter(|name| ["side-", "window-", "fit-"].iter().any(|kind| name.starts_with(kind))).collect()
}

#[test]
fn sequences_sweeps_nodes_and_views_are_cleaned_too() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    // test a sequence, in which every time step has its own cached views
    let sequence = out("sequence");
    let times = |seed: &str| {
        let mut command = render(&sequence);
        succeed(command.args(["--times", "2", "--turn-deg", "10", "--seed", seed]));
    };
    times("1");
    let stale = sequence.join("t0002/cache/views/target-0123456789abcdef");
    fs::create_dir(&stale).unwrap();
    fs::write(stale.join("view_00_00.exr"), [7; 200]).unwrap();
    let whole = results(&sequence);
    assert_eq!(clean(&sequence, &[]).0, [("views of other settings".to_owned(), 200)]);
    assert!(!stale.exists());
    clean(&sequence, &["--all"]);
    assert!(results(&sequence).iter().filter(|(path, _)| !path.iter().any(|part| part == "cache")).count() > 10);
    assert!(
        whole.iter().filter(|(path, _)| !path.iter().any(|part| part == "cache")).all(|(path, bytes)| fs::read(
            sequence.join(path)
        )
        .unwrap()
            == *bytes)
    );

    // test a sweep, whose light fields are cached
    let sweep = out("sweep");
    let designs = |fov: &str| {
        let mut command = lumistack();
        command.arg("sweep").arg(root().join("scenes/glass/glass.gltf")).arg("-o").arg(&sweep);
        command.args(["--display", "fig7-uniform", "--resolution", "24x16", "--samples", "1", "--iterations", "2"]);
        succeed(command.args(["--frames", "1", "--plots", "none", "--fov", fov]));
    };
    designs("20x20");
    let table = fs::read(sweep.join("sweep.csv")).unwrap();
    fs::create_dir_all(sweep.join("fields/2/cache")).unwrap();
    fs::write(sweep.join("fields/2/cache/lumistack.lock"), "").unwrap();
    fs::write(sweep.join("fields/2/a.exr"), [7; 100]).unwrap();
    let (freed, _) = clean(&sweep, &[]);
    assert_eq!(freed, [("light fields of other settings".to_owned(), 100)]);
    clean(&sweep, &["--all"]);
    assert_eq!(fs::read(sweep.join("sweep.csv")).unwrap(), table);
    designs("20x20");
    assert_eq!(fs::read(sweep.join("sweep.csv")).unwrap(), table);

    // test a folder that `lumistack render` wrote
    let views = out("views");
    let render_views = || {
        let mut command = lumistack();
        command.arg("render").arg(root().join("scenes/glass/glass.gltf")).arg("-o").arg(&views);
        succeed(command.args(["--resolution", "24x16", "--samples", "1"]));
    };
    render_views();
    let whole = results(&views);
    let (freed, _) = clean(&views, &["--all"]);
    assert!(freed.iter().any(|(kind, _)| kind == "cached views"), "{freed:?}");
    assert!(results(&views) == whole);
    render_views();
    assert!(results(&views) == whole);

    // test a job with several nodes
    let nodes = "[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\nplugin = \"log_tomography\"\n[[outputs]]\nplugin = \"images\"\nfrom = \"a\"\n";
    let (path, run) = (job(folder.path(), 9, nodes), out("nodes"));
    succeed(lumistack().arg("run").arg(&path).arg("-o").arg(&run));
    fs::write(run.join("nodes/b/layers/.lumistack-1.tmp"), [7; 50]).unwrap();
    let whole = results(&run);
    assert_eq!(clean(&run, &[]).0, [("left-overs of stopped runs".to_owned(), 50)]);
    assert_eq!(results(&run).len(), whole.len() - 1);
}
