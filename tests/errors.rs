//! Bad input gives one clear error with the file, the place in the file, the expected and the found
//! value. No partial output is left.

use std::path::Path;

use crate::common::{self, fail, lumistack, root, succeed, write_test_field};

/// Returns the text of a scene of one triangle, without its last brace. `position` selects an error
/// in the positions. `extra` has further keys of the primitive.
fn triangle(position: &str, extra: &str) -> String {
    use base64::Engine as _;
    let mut bytes = Vec::new();
    for value in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bytes.extend(value.to_le_bytes());
    }
    match position {
        "nan" => bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes()),
        "flat" => bytes[28..32].copy_from_slice(&0.0f32.to_le_bytes()),
        _ => {}
    }
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}} {extra} }}]}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 36}}],
        "buffers": [{{"byteLength": 36, "uri": "data:application/octet-stream;base64,{data}"}}]"#
    )
}

/// Runs `lumistack run` on a scene and returns the error.
fn run_fails(name: &str, content: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join(name);
    std::fs::write(&scene, content).unwrap();
    let run = folder.path().join("run");
    let text =
        fail(lumistack().arg("run").arg(&scene).arg("-o").arg(&run).args(["--resolution", "20x12", "--samples", "1"]));
    assert!(text.contains(name), "the error names the file: {text}");
    assert!(!run.join("report.html").exists() && !run.join("layers").exists());
    text
}

/// A file that only the solver reads is missing: the error comes before any view is rendered.
#[test]
fn files_of_the_solver() {
    for (option, file) in [("--weights", "none.npy"), ("--warm-start", "none/stack.json")] {
        let folder = tempfile::tempdir().unwrap();
        let (missing, run) = (folder.path().join(file.split('/').next().unwrap()), folder.path().join("run"));
        let scene = root().join("scenes/still-life/still-life.gltf");
        let text = fail(lumistack().arg("run").arg(scene).arg("-o").arg(&run).arg(option).arg(&missing));
        assert!(text.replace('\\', "/").contains(file), "the error names the file: {text}");
        assert!(!run.exists() || std::fs::read_dir(&run).unwrap().next().is_none(), "{option}: views were rendered");
    }
}

/// No ray hits a layer: the error comes before any view is rendered.
#[test]
fn displays_without_rays() {
    let folder = tempfile::tempdir().unwrap();
    let (display, run) = (folder.path().join("aside.toml"), folder.path().join("run"));
    let layer = "[[layers]]\nresolution = [20, 12]\npitch_mm = 1.0\n";
    let text = format!(
        "name = \"aside\"\nframes = 2\n[field]\nresolution = [20, 12]\npitch_mm = 1.0\nfov_deg = [20, 20]\n\
         {layer}d_mm = -10\n{layer}d_mm = 10\noffset_mm = [500, 0]\n"
    );
    std::fs::write(&display, text).unwrap();
    let scene = root().join("scenes/still-life/still-life.gltf");
    let text = fail(lumistack().arg("run").arg(scene).arg("-o").arg(&run).arg("--display").arg(&display));
    assert!(text.contains("expected at least one ray") && text.contains("hits all layers"), "{text}");
    assert!(!run.exists() || std::fs::read_dir(&run).unwrap().next().is_none(), "views were rendered");
}

#[test]
fn scenes() {
    let text = run_fails("nan.gltf", format!("{}}}", triangle("nan", "")).as_bytes());
    assert!(text.contains("POSITION") && text.contains("finite"), "{text}");
    let text = run_fails("flat.gltf", format!("{}}}", triangle("flat", "")).as_bytes());
    assert!(text.contains("at least one triangle"), "{text}");
    let text = run_fails("empty.gltf", br#"{"asset": {"version": "2.0"}}"#);
    assert!(text.contains("expected") && text.contains("found"), "{text}");
    let texture = r#", "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}], "images": [{"uri": "missing.png"}]}"#;
    let text = run_fails("texture.gltf", format!("{}{texture}", triangle("", r#", "material": 0"#)).as_bytes());
    assert!(text.contains("missing.png") && text.contains("/images/0"), "{text}");
    let required = r#", "extensionsRequired": ["EXT_lights_ies"], "extensionsUsed": ["EXT_lights_ies"]}"#;
    let text = run_fails("lamp.gltf", format!("{}{required}", triangle("", "")).as_bytes());
    assert!(text.contains("EXT_lights_ies"), "{text}");
    run_fails("text.gltf", b"this is not JSON");
    run_fails("empty-file.glb", b"");
    let text = run_fails("model.obj", b"v 0 0 0");
    assert!(text.contains("model.obj"), "{text}");
    let text = run_fails("model.stl", b"solid");
    assert!(text.contains("expected a file with the extension .gltf, .glb") && text.contains("`stl`"), "{text}");
}

/// A scene file may come from an untrusted source. So the file may name only regular files in its
/// own folder, unless the user permits other folders.
#[cfg(unix)]
#[test]
fn a_scene_reads_no_files_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("scene");
    std::fs::create_dir(&inner).unwrap();
    let mut bytes = Vec::new();
    for value in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bytes.extend(value.to_le_bytes());
    }
    std::fs::write(folder.path().join("a.bin"), &bytes).unwrap();
    std::fs::write(inner.join("a.bin"), &bytes).unwrap();
    std::os::unix::fs::symlink(folder.path().join("a.bin"), inner.join("link.bin")).unwrap();
    let pipe = inner.join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let file = inner.join("scene.gltf");
    let info = |uri: &str, flags: &[&str]| {
        let text = triangle("", "");
        let (start, _) = text.split_once("data:application").unwrap();
        std::fs::write(&file, format!("{start}{uri}\"}}]}}")).unwrap();
        let mut command = lumistack();
        command.arg("info").arg(&file).args(flags);
        command
    };
    succeed(&mut info("a.bin", &[]));
    succeed(&mut info("../scene/a.bin", &[]));
    let outside = folder.path().join("a.bin");
    for uri in ["../a.bin", "link.bin", outside.to_str().unwrap()] {
        let text = fail(&mut info(uri, &[]));
        let names_all =
            text.contains("scene.gltf: /buffers/0/uri: ") && text.contains(uri) && text.contains("--allow-outside");
        assert!(names_all && text.contains("outside of the folder"), "{text}");
        succeed(&mut info(uri, &["--allow-outside"]));
    }
    // Even with `--allow-outside`, the program reads no device and no pipe. If it did, these runs
    // would never end.
    for (uri, found) in [("/dev/zero", "a device"), ("pipe", "a pipe"), ("/", "a folder")] {
        let text = fail(&mut info(uri, &["--allow-outside"]));
        assert!(text.contains(&format!("expected a regular file, found {found}")), "{text}");
    }
    // A key of the job permits its scene to read files of other folders. Paths in the job itself
    // may lead to any folder, but only to regular files.
    let job = folder.path().join("job.toml");
    let text = "scene = \"scene/scene.gltf\"\n[display]\npreset = \"paper-three-layer\"\n[importer]\nallow_outside = ";
    for (allowed, expected) in [("false", Some("importer.allow_outside = true")), ("true", None)] {
        info("../a.bin", &[]);
        std::fs::write(&job, format!("{text}{allowed}\n")).unwrap();
        let mut command = lumistack();
        command.arg("info").arg(&job).args(["--display", "paper-three-layer"]);
        match expected {
            Some(expected) => assert!(fail(&mut command).contains(expected)),
            None => _ = succeed(&mut command),
        }
    }
    for (key, name) in [("light_field", "zero.npy"), ("scene", "zero.glb"), ("scene", "zero.obj")] {
        std::os::unix::fs::symlink("/dev/zero", folder.path().join(name)).unwrap();
        let text = format!("{key} = \"{name}\"\n[display]\npreset = \"paper-three-layer\"\n");
        std::fs::write(&job, text).unwrap();
        let run = folder.path().join("run");
        let text = fail(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
        assert!(text.contains(name) && text.contains("expected a regular file, found a device"), "{text}");
    }
}

/// File names on Linux are bytes. A scene, its folder, a display and the run folder may have names
/// that are not UTF-8.
#[cfg(target_os = "linux")]
#[test]
fn names_that_are_not_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join(OsStr::from_bytes(b"sc\xE8ne"));
    std::fs::create_dir(&inner).unwrap();
    let scene = inner.join(OsStr::from_bytes(b"mod\xE8le.gltf"));
    std::fs::write(&scene, format!("{}}}", triangle("", ""))).unwrap();
    let obj = inner.join(OsStr::from_bytes(b"mod\xE8le.obj"));
    std::fs::write(&obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let display = inner.join(OsStr::from_bytes(b"\xE9cran.toml"));
    let preset = root().join("scenes/displays/paper-three-layer.toml");
    std::fs::copy(preset, &display).unwrap();
    for scene in [&scene, &obj] {
        succeed(lumistack().arg("info").arg(scene));
        succeed(lumistack().arg("info").arg(scene).arg("--json"));
    }
    succeed(lumistack().arg("info").arg(&display));
    let run = inner.join(OsStr::from_bytes(b"r\xFCn"));
    let small = ["--resolution", "20x12", "--samples", "1", "--iterations", "1"];
    succeed(
        lumistack().arg("run").arg(&scene).arg("--display").arg(&display).arg("-o").arg(&run).args(small).arg("--json"),
    );
    // the job that the run wrote refers to the same scene
    succeed(lumistack().arg("run").arg(run.join("job.toml")).arg("-o").arg(&run));
    succeed(lumistack().arg("info").arg(&run));
    let views = inner.join(OsStr::from_bytes(b"v\xFCes"));
    succeed(lumistack().arg("render").arg(&scene).arg("-o").arg(&views).args([
        "--resolution",
        "20x12",
        "--samples",
        "1",
    ]));
    succeed(lumistack().arg("info").arg(&views));
    // the names of the views in this folder are also not UTF-8
    let numbered = inner.join("numbered");
    std::fs::create_dir(&numbered).unwrap();
    let picture = image::RgbImage::from_pixel(4, 3, image::Rgb([9, 9, 9]));
    for name in [&b"vue\xE9_00_00.png"[..], b"vue\xE9_00_01.png"] {
        picture.save(numbered.join(OsStr::from_bytes(name))).unwrap();
    }
    succeed(lumistack().arg("info").arg(&numbered).args(["--fov", "20x20", "--pitch-mm", "0.5"]));
}

#[test]
fn a_truncated_glb() {
    let Some(assets) = common::assets() else { return };
    let bytes = std::fs::read(assets.join("gltf/Box/Box.glb")).unwrap();
    for length in [3, 15, 200, bytes.len() - 5] {
        let text = run_fails("box.glb", &bytes[..length]);
        assert!(text.contains("expected") && text.contains("found"), "{text}");
    }
}

#[test]
fn jobs() {
    let folder = tempfile::tempdir().unwrap();
    let job = folder.path().join("job.toml");
    let run = folder.path().join("run");
    let scene = root().join("scenes/glass/glass.gltf");
    let check = |text: &str, parts: &[&str]| {
        std::fs::write(&job, text.replace("SCENE", &scene.display().to_string().replace('\\', "/"))).unwrap();
        let error = fail(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
        for part in parts {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
        assert!(!run.exists(), "nothing is written");
    };
    let display = "[display]\npreset = \"fig7-uniform\"\n";
    check(
        &format!("scene = \"SCENE\"\n{display}[render]\nsampels = 3\n"),
        &["job.toml", "line 5, column 1", "sampels", "did you mean `samples`"],
    );
    check(&format!("scene = 3\n{display}"), &["line 1", "string"]);
    check(display, &["one of `scene`, `light_field` and `source`", "none"]);
    check(
        "scene = \"SCENE\"\n[display]\npreset = \"fig7-unifrom\"\n",
        &["fig7-unifrom", "did you mean `fig7-uniform`"],
    );
    check("scene = \"SCENE\"\n[display]\npreset = \"fig7-uniform\"\nbrightness = 2.0\n", &["brightness", "found 2"]);
    check(&format!("scene = \"SCENE\"\n{display}[factorize]\nsolver = \"magic\"\n"), &["magic", "multiplicative"]);
    check(
        &format!("scene = \"SCENE\"\n{display}[factorize]\nstart = \"randon\"\n"),
        &["randon", "did you mean `random`"],
    );
    check(&format!("scene = \"SCENE\"\n{display}[[outputs]]\nplugin = \"imagse\"\n"), &["imagse", "images"]);
    check(
        &format!("scene = \"SCENE\"\n{display}[[outputs]]\nplugin = \"images\"\nparams = {{ pgn8 = true }}\n"),
        &["pgn8", "png8"],
    );
    check(
        &format!("scene = \"SCENE\"\n{display}[[outputs]]\nplugin = \"panels\"\n"),
        &["a plugin that writes files", "`panels`, which drives panels"],
    );
    check(&format!("scene = \"nowhere.glb\"\n{display}"), &["nowhere.glb"]);
    check(&format!("scene = \"SCENE\"\n{display}[window]\ncamera = \"left\"\n"), &["window.camera", "left"]);
    check(&format!("scene = \"SCENE\"\n{display}[window]\nfrom = \"given\"\n"), &["window.centre"]);
}

#[test]
fn a_display_file_with_a_typo() {
    let folder = tempfile::tempdir().unwrap();
    let display = folder.path().join("display.toml");
    let text = std::fs::read_to_string(root().join("scenes/displays/fig7-uniform.toml")).unwrap();
    std::fs::write(&display, text.replacen("d_mm =", "d_m =", 1)).unwrap();
    let scene = root().join("scenes/glass/glass.gltf");
    let error =
        fail(lumistack().arg("run").arg(scene).arg("--display").arg(&display).arg("-o").arg(folder.path().join("run")));
    assert!(error.contains("display.toml: line") && error.contains("did you mean `d_mm`"), "{error}");
}

#[test]
fn an_output_path_that_is_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let taken = folder.path().join("taken");
    std::fs::write(&taken, "precious").unwrap();
    let scene = root().join("scenes/glass/glass.gltf");
    let error = fail(lumistack().arg("run").arg(&scene).arg("-o").arg(&taken));
    assert!(error.contains("taken: expected a folder to write to, found a file"), "{error}");
    let error = fail(lumistack().arg("render").arg(&scene).arg("-o").arg(&taken));
    assert!(error.contains("taken"), "{error}");
    assert_eq!(std::fs::read_to_string(&taken).unwrap(), "precious");
}

#[test]
fn light_fields() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let factorize = |path: &Path, flags: &[&str]| {
        let error = fail(lumistack().arg("factorize").arg(path).arg("-o").arg(&run).args(flags));
        assert!(!run.join("report.html").exists() && !run.join("layers").exists(), "{error}");
        error
    };
    // the views of this folder have different sizes, which is an error
    let views = folder.path().join("views");
    std::fs::create_dir(&views).unwrap();
    for (index, width) in [4u32, 4, 5, 4].into_iter().enumerate() {
        let path = views.join(format!("out_{:02}_{:02}_{}.0_{}.0.png", index / 2, index % 2, index / 2, index % 2));
        image::RgbImage::from_pixel(width, 3, image::Rgb([90, 80, 70])).save(path).unwrap();
    }
    let error = factorize(&views, &[]);
    assert!(error.contains("out_01_00") && error.contains('5') && error.contains('4'), "{error}");
    let error = factorize(&folder.path().join("nowhere"), &[]);
    assert!(error.contains("nowhere"), "{error}");
    let array = folder.path().join("views.npy");
    write_test_field(&array, [1, 2, 3, 4], 20.0, 3.0);
    let bytes = std::fs::read(&array).unwrap();
    std::fs::write(&array, &bytes[..bytes.len() - 10]).unwrap();
    let error = factorize(&array, &["--fov", "20x20", "--pitch-mm", "3"]);
    assert!(error.contains("views.npy"), "{error}");
    let mut broken = bytes.clone();
    let at = broken.len() - 4;
    broken[at..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&array, &broken).unwrap();
    let error = factorize(&array, &["--fov", "20x20", "--pitch-mm", "3"]);
    assert!(error.contains("views.npy") && error.contains("NaN"), "{error}");
}

#[test]
fn one_pixel_views_work() {
    let folder = tempfile::tempdir().unwrap();
    let array = folder.path().join("views.npy");
    write_test_field(&array, [2, 2, 1, 1], 20.0, 3.0);
    let run = folder.path().join("run");
    let factorize = |fov: &str| {
        let mut command = lumistack();
        let flags = ["--fov", fov, "--pitch-mm", "3", "--iterations", "5", "--display", "fig7-uniform"];
        command.arg("factorize").arg(&array).arg("-o").arg(&run).args(flags);
        command
    };
    // with one pixel and a wide field of view, no ray of an oblique view hits all layers
    let error = fail(&mut factorize("20x20"));
    assert!(error.contains("hits all layers"), "{error}");
    succeed(&mut factorize("1x1"));
    assert!(run.join("report.html").is_file());
}

#[test]
fn wrong_usage_ends_with_code_2() {
    for arguments in [vec!["run"], vec!["run", "a.glb", "--resolution", "12"], vec!["paint"], vec![]] {
        let output = lumistack().args(&arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    }
}

#[cfg(unix)]
#[test]
fn a_writer_that_fails_midway_leaves_the_old_output_whole() {
    let folder = tempfile::tempdir().unwrap();
    let array = folder.path().join("views.npy");
    write_test_field(&array, [1, 3, 20, 30], 20.0, 3.0);
    let run = folder.path().join("run");
    let flags = ["--fov", "20x20", "--pitch-mm", "3", "--frames", "2", "--display", "fig7-uniform"];
    let factorize = |iterations: &str| {
        let mut command = lumistack();
        command.arg("factorize").arg(&array).arg("-o").arg(&run).args(flags).args(["--iterations", iterations]);
        command
    };
    succeed(&mut factorize("3"));
    let before = common::files(&run.join("outputs"));
    // limit files to 2 kB, so that an output cannot be written
    let mut limited = std::process::Command::new("bash");
    let line = format!("trap '' XFSZ; ulimit -f 2; exec {:?}", factorize("4"));
    let output = limited.arg("-c").arg(line).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(before == common::files(&run.join("outputs")), "the old pictures are still there, whole");
    let stray = common::files(&run).into_iter().find(|(path, _)| path.to_string_lossy().contains(".tmp"));
    assert!(stray.is_none(), "{:?} was left behind", stray.map(|(path, _)| path));
    // the next run, without the limit, writes the new output
    succeed(&mut factorize("4"));
    assert!(before != common::files(&run.join("outputs")));
}

/// `--plan` reports what a run would refuse, before it prints a step. The error of a wrong
/// option names the place and the found value.
#[test]
fn a_plan_has_the_errors_of_a_run() {
    let scene = root().join("scenes/still-life/still-life.gltf");
    let folder = tempfile::tempdir().unwrap();
    let nameless = folder.path().join("scene");
    std::fs::write(&nameless, "{}").unwrap();
    let plan = |scene: &Path, options: &[&str]| {
        fail(lumistack().arg("run").arg(scene).args(["--plan", "--display", "paper-three-layer"]).args(options))
    };
    let cases: [(&Path, &[&str], &[&str]); 4] = [
        (&scene, &["--camera", "9"], &["window.camera: expected a camera's name", "found 9"]),
        (&scene, &["--device", "gpu:"], &["command line: factorize.device: expected", "found `gpu:`"]),
        (&scene, &["--solver", "foo"], &["command line: factorize.solver: expected one of auto", "found foo"]),
        (&nameless, &[], &["expected a file with the extension .gltf", "found no extension"]),
    ];
    for (scene, options, parts) in cases {
        let text = plan(scene, options);
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    }
    let text = succeed(lumistack().args(["farm", "plan", "--help"]));
    assert!(text.contains("[default: 1,2,10,100,1000]"), "the default has the form of the option: {text}");
}

#[test]
fn a_preview_needs_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let text = fail(lumistack().arg("preview").arg(folder.path()).arg("--no-open"));
    assert!(
        text.contains("expected the folder of a run or of a preview, found a folder with neither stack/preview.json nor layers/stack.json"),
        "{text}"
    );
    std::fs::create_dir(folder.path().join("t0001")).unwrap();
    let text = fail(lumistack().arg("preview").arg(folder.path()).arg("--no-open"));
    assert!(text.contains("t0001: folder: expected the folder of a run or of a preview"), "{text}");
    let text = fail(lumistack().arg("preview").arg(folder.path().join("nothing")).arg("--no-open"));
    assert!(text.contains("nothing: folder: expected the folder of a run or of a preview"), "{text}");
    // no server is started for a run with damaged patterns
    std::fs::create_dir(folder.path().join("layers")).unwrap();
    std::fs::write(folder.path().join("layers/stack.json"), "{").unwrap();
    let text = fail(lumistack().arg("preview").arg(folder.path()).arg("--no-open"));
    assert!(text.contains("display.toml"), "{text}");
}

/// Errors of the table `[factorize]` that are known from the job are reported before the views of a
/// scene are rendered.
#[test]
fn wrong_weights_and_eyes_are_reported_before_the_rendering() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let header = format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2), }");
    std::fs::write(at("w.npy"), [&b"\x93NUMPY\x01\x00v\x00"[..], header.as_bytes(), &[0; 16]].concat()).unwrap();
    let scene = root().join("scenes/letters/letters.gltf");
    let eye = "[[factorize.eyes]]\neye_mm = [0, 0, 600]\nsigma_mm = 30";
    for (text, expected) in [
        ("weights = \"w.npy\"".into(), "weights: expected shape [3, 3] or [3, 3, 12, 20]"),
        (format!("weights = \"w.npy\"\n{eye}"), "factorize.eyes: expected either `weights` or `eyes`, found both"),
        (eye.replace("600", "0"), "factorize.eyes[0].eye_mm: expected a position in front of the display"),
        (eye.replace("30", "0"), "factorize.eyes[0].sigma_mm: expected a finite number above 0, found 0"),
        (format!("{eye}\nweight = -1"), "factorize.eyes[0].weight: expected a finite number, 0 or more, found -1"),
        (format!("eye_floor = -1\n{eye}"), "factorize.eye_floor: expected a finite number, 0 or more, found -1"),
    ] {
        let display = "[display]\npreset = \"paper-three-layer\"\nresolution = [20, 12]\nviews = [3, 3]\n";
        std::fs::write(
            at("job.toml"),
            format!("scene = {:?}\n{display}[factorize]\n{text}\n", scene.to_str().unwrap()),
        )
        .unwrap();
        let error = fail(lumistack().arg("run").arg(at("job.toml")).arg("-o").arg(at("run")));
        assert!(error.contains(expected), "{text}: {error}");
        assert!(!at("run/cache/views").exists() && !at("run/target").exists(), "{text}");
    }
}

/// A solver that cannot find patterns for a display is refused before the views are rendered, for
/// the display of a job and for that of a node.
#[test]
fn unsuitable_solvers_are_reported_before_the_rendering() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let preset = std::fs::read_to_string(root().join("scenes/displays/paper-three-layer.toml")).unwrap();
    std::fs::write(at("rotating.toml"), format!("formation = \"polarization\"\n{preset}")).unwrap();
    let scene = root().join("scenes/letters/letters.gltf");
    let rotating = "display.file = \"rotating.toml\"\nfactorize.solver = \"multiplicative\"\n";
    let of_node = format!("display.preset = \"paper-three-layer\"\n[[nodes]]\nid = \"a\"\n{rotating}");
    for tables in [rotating.to_owned(), of_node] {
        std::fs::write(at("job.toml"), format!("scene = {:?}\n{tables}", scene.to_str().unwrap())).unwrap();
        let error = fail(lumistack().arg("run").arg(at("job.toml")).arg("-o").arg(at("run")));
        assert!(error.contains("solver multiplicative: expected layers that attenuate or emit light"), "{error}");
        assert!(!at("run/cache/views").exists() && !at("run/target").exists(), "{tables}");
    }
}
