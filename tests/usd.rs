//! USD on the command line of a machine without OpenUSD: messages state how to install OpenUSD.

use std::path::Path;

use crate::common::{fail, lumistack, root, succeed};

fn file(folder: &Path) -> std::path::PathBuf {
    let path = folder.join("scene.usda");
    std::fs::write(&path, "#usda 1.0\n").unwrap();
    path
}

#[test]
fn without_python_gltf_works_and_usd_names_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let alone = |command: &mut std::process::Command| {
        command.env_clear().env("PATH", folder.path()).env("HOME", folder.path()).current_dir(folder.path());
    };
    let mut gltf = lumistack();
    alone(&mut gltf);
    let text =
        succeed(gltf.arg("info").arg(std::fs::canonicalize(root().join("scenes/letters/letters.gltf")).unwrap()));
    assert!(text.contains("triangles: "), "{text}");
    for command in [&["info"][..], &["render", "-o", "views"]] {
        let mut usd = lumistack();
        alone(&mut usd);
        let text = fail(usd.args(command).arg(file(folder.path())));
        assert!(text.contains(" setup usd`") && text.contains("python3 from PATH: cannot be started"), "{text}");
        assert!(!folder.path().join("views").join("lightfield.json").exists());
    }
    let mut setup = lumistack();
    alone(&mut setup);
    let text = fail(setup.args(["setup", "usd"]));
    assert!(text.contains("expected Python 3.8 or newer on PATH"), "{text}");
    assert!(!folder.path().join(".local/share/lumistack").exists(), "nothing is left behind");
}

#[test]
fn a_python_that_is_named_is_the_only_one_tried() {
    let folder = tempfile::tempdir().unwrap();
    let mut usd = lumistack();
    let text = fail(usd.args(["info"]).arg(file(folder.path())).env("LUMISTACK_PYTHON", "/no/such/python"));
    assert!(
        text.contains("LUMISTACK_PYTHON: expected a Python with the package usd-core, found /no/such/python"),
        "{text}"
    );
}

#[test]
fn choices_of_the_other_format_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let gltf = root().join("scenes/letters/letters.gltf");
    let job = folder.path().join("job.toml");
    let path = std::fs::canonicalize(gltf).unwrap();
    let text = format!("scene = {path:?}\n[display]\npreset = \"paper-three-layer\"\n[pose]\nvariants = [\"a=b\"]\n");
    std::fs::write(&job, text).unwrap();
    let text = fail(lumistack().arg("render").arg(&job).arg("-o").arg(folder.path().join("views")));
    assert!(text.contains("pose.variants: expected no value, since only USD has variant sets"), "{text}");
    let mut usd = lumistack();
    usd.arg("render").arg(file(folder.path())).args(["--animation", "Walk", "-o"]).arg(folder.path().join("views"));
    assert!(fail(&mut usd).contains("pose.animation: expected no value, since a USD stage has only one timeline"));
}
