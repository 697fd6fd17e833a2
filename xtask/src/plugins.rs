//! Checks plugins as shared libraries, the samples for authors of plugins, and the pages about the
//! plugins' parameters.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::compiler;
use crate::tools::{EVERYTHING, Outcome, build_everything, command, output_of, root, run as run_program};

/// File with all plugins and their parameters, as `lumistack --json plugins` prints them.
const DUMP: &str = "docs/plugins.json";
/// Folder with a page for each plugin.
const PAGES: &str = "docs/plugins";
/// The crate of the tutorial for authors of plugins, which is outside of the workspace.
const SAMPLE: &str = "examples/rust-plugin";

/// Folder of the pictures of the documentation, which `cargo xtask site pictures` makes.
const PICTURES_IN: &str = "docs/pictures";
/// Plugins with the alternative texts of their pictures.
const PICTURES: [(&str, &str); 14] = [
    (
        "directional_sequence",
        "The backlight of one frame lights one direction; the layer shows the view of this direction",
    ),
    ("images", "A contact sheet with the masks of three layers in two frames"),
    ("integral_imaging", "The panel behind a lens array, and the coarse picture that an eye sees"),
    ("log_tomography", "The masks of three static layers, and the picture that an eye sees"),
    ("obj", "A teapot from an OBJ file, from three sides"),
    ("panels", "Three panels with the masks of their layers, and with the test patterns identify and crosshairs"),
    ("parallax_barrier", "A rear layer, a front layer with one pixel open in nine, and the picture that an eye sees"),
    ("quilt", "A quilt: twelve views of the still life in rows and columns"),
    ("splats", "A capture of a dandelion from three sides"),
    ("tensor_display", "The masks of three layers in one frame, and the picture that an eye sees over all frames"),
    ("test_views", "Views that show their own numbers, and views of three chequered cards at three depths"),
    ("transparencies", "Pages of a PDF: the assembly, a test chart, and the films of three layers"),
    ("two_layer_nmf", "The masks of two layers in one frame, and the picture that an eye sees over all frames"),
    ("web_simulator", "The page of the simulator shows the layers pulled apart, with rays through them"),
];

/// Builds and checks all plugins; `write` rewrites the committed pages.
pub fn run(write: bool) -> Outcome {
    // this also builds the libraries: a plugin's library is an example of its crate
    build_everything()?;
    let metadata = output_of(command("cargo").args(["metadata", "--format-version", "1", "--no-deps"]))
        .and_then(|text| serde_json::from_str::<Value>(&text).ok())
        .ok_or("cargo metadata failed")?;
    let target = PathBuf::from(metadata["target_directory"].as_str().ok_or("cargo metadata names no target folder")?);
    pages(&target.join("debug").join(format!("lumistack{EXE_SUFFIX}")), write)?;
    let folder = target.join("plugins");
    // remove the libraries of plugins that no longer exist
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for package in metadata["packages"].as_array().into_iter().flatten() {
        let manifest = Path::new(package["manifest_path"].as_str().unwrap_or_default());
        if manifest.starts_with(root().join("plugins")) {
            let name = package["name"].as_str().unwrap_or_default();
            take(&target.join("debug/examples"), name, &folder)?;
        }
    }
    sample(&target, &folder)?;
    let mut tests = command("cargo");
    tests.args(["test", "--quiet"]).args(EVERYTHING);
    tests.args(["--test", "plugin_host", "--", "--nocapture", "loaded::"]);
    run_program(tests.env("LUMISTACK_TEST_PLUGINS", &folder))
}

/// Builds the tutorial's crate outside of the workspace, tests it, and copies its library.
fn sample(target: &Path, folder: &Path) -> Outcome {
    // use the workspace's lock file, so that cargo fetches no other versions of dependencies
    let lock = root().join(SAMPLE).join("Cargo.lock");
    fs::copy(root().join("Cargo.lock"), &lock).map_err(|error| format!("{}: {error}", lock.display()))?;
    for task in ["build", "test"] {
        let mut build = command("cargo");
        build.args([task, "--quiet", "--target-dir"]).arg(target.join("sample"));
        build.arg("--manifest-path").arg(root().join(SAMPLE).join("Cargo.toml"));
        // debug information would take a fifth of the build's time
        build.env("CARGO_PROFILE_DEV_DEBUG", "false");
        // authors of plugins compile with rustc, not with the compiler of `cargo xtask ci`
        build.env_remove(compiler::WRAPPER);
        run_program(&mut build)?;
    }
    take(&target.join("sample/debug"), "lumistack-plugin-means", folder)
}

/// Copies the library of a package.
fn take(built: &Path, package: &str, folder: &Path) -> Outcome {
    let name = format!("{DLL_PREFIX}{}{DLL_SUFFIX}", package.replace('-', "_"));
    fs::copy(built.join(&name), folder.join(&name))
        .map(drop)
        .map_err(|error| format!("{}: {error}", built.join(name).display()))
}

/// Compares the committed pages and the list of plugins with the program's output, or writes them.
fn pages(lumistack: &Path, write: bool) -> Outcome {
    let mut program = command(lumistack);
    program.args(["--json", "plugins"]);
    // without these folders of libraries the program lists only compiled-in plugins
    program.env_remove("LUMISTACK_PLUGIN_PATH").env("XDG_DATA_HOME", root().join("target/no-such-folder"));
    let said = output_of(&mut program).ok_or("`lumistack --json plugins` failed")?;
    let said: Value = serde_json::from_str(&said).map_err(|error| format!("`lumistack --json plugins`: {error}"))?;
    let mut plugins: Vec<Value> =
        said["plugins"].as_array().cloned().ok_or("`lumistack --json plugins` lists no plugins")?;
    plugins.retain(|plugin| plugin["origin"] == "compiled in");
    for plugin in plugins.iter_mut().filter_map(Value::as_object_mut) {
        plugin.remove("origin");
    }
    let dump = json!({ "schema": "lumistack/plugins", "version": 1, "plugins": plugins });
    let dump = serde_json::to_string_pretty(&dump).map_err(|error| error.to_string())? + "\n";
    let mut files = vec![(PathBuf::from(DUMP), dump)];
    for plugin in &plugins {
        let id = text(plugin, "id");
        let picture = root().join(PICTURES_IN).join(format!("{id}.jpg"));
        let described = PICTURES.iter().find(|(name, _)| *name == id).filter(|_| picture.is_file());
        let (_, described) = described.ok_or_else(|| {
            format!(
                "{}: expected this picture of the plugin, and a row with its text in PICTURES of xtask/src/plugins.rs, found at most one of them",
                picture.display()
            )
        })?;
        files.push((Path::new(PAGES).join(format!("{id}.md")), page(plugin, described)));
    }
    let stale = listed(&root().join(PAGES)).filter(|path| !files.iter().any(|(file, _)| root().join(file) == *path));
    let stale: Vec<PathBuf> = stale.collect();
    for (file, wanted) in &files {
        let path = root().join(file);
        if write {
            fs::create_dir_all(path.parent().unwrap_or(&path))
                .map_err(|error| format!("{}: {error}", path.display()))?;
            fs::write(&path, wanted).map_err(|error| format!("{}: {error}", path.display()))?;
        } else if fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n") != *wanted {
            return Err(format!(
                "{}: expected the current text of the plugins, found another text; `cargo xtask plugins --write` writes the current text",
                file.display()
            ));
        }
    }
    for path in &stale {
        if !write {
            return Err(format!(
                "{}: expected the page of a plugin, found a page without a plugin; `cargo xtask plugins --write` removes the page",
                path.display()
            ));
        }
        fs::remove_file(path).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    println!("plugins: {} pages {}", files.len() - 1, if write { "written" } else { "are current" });
    Ok(())
}

fn listed(folder: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_default()
}

/// Makes the page of one plugin.
fn page(plugin: &Value, described: &str) -> String {
    let (id, kind) = (text(plugin, "id"), text(plugin, "kind"));
    let mut page =
        format!("<!-- made by `cargo xtask plugins --write` -->\n\n# {id}\n\n{}\n\n", text(plugin, "doc").trim());
    let words = |key: &str| {
        let list = plugin[key].as_array().into_iter().flatten().filter_map(Value::as_str);
        list.map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", ")
    };
    let takes = match kind {
        "importer" => format!("files {}", words("extensions")),
        "source" => "nothing".into(),
        _ => words("ports"),
    };
    let presents = if plugin["presents"] == true { "; runs until it is closed" } else { "" };
    let _ = writeln!(page, "Kind: {kind}; takes {takes}{presents}. Version {}.", text(plugin, "version"));
    let _ = writeln!(page, "\n![{described}](../pictures/{id}.jpg)");
    let params = plugin["params"].as_array().map_or(&[][..], Vec::as_slice);
    if params.is_empty() {
        page.push_str("\nThere are no parameters.\n");
        return page;
    }
    // a parameter of the kind "file" has no default; its cell is empty
    let none = json!("");
    page.push_str("\nThese are the parameters:\n\n| parameter | default | values | meaning |\n|---|---|---|---|\n");
    for param in params {
        let unit = param["unit"].as_str().filter(|unit| *unit != "1").map_or(String::new(), |unit| format!(" {unit}"));
        let (values, meaning) = match text(param, "kind") {
            "bool" => ("`true`, `false`".into(), String::new()),
            "choice" => {
                let options = || param["options"].as_array().into_iter().flatten();
                let values = options().map(|option| format!("`{}`", text(option, "value"))).collect::<Vec<_>>();
                // end each help text with a full stop, also if it is only a name
                let helps = options().map(|option| {
                    let help = text(option, "help").trim_end_matches('.');
                    format!("`{}`: {help}.", text(option, "value"))
                });
                (values.join(", "), helps.map(|help| format!(" {help}")).collect())
            }
            "int" => (format!("{} to {}{unit}, whole", param["min"], param["max"]), String::new()),
            "float" => (format!("{} to {}{unit}", param["min"], param["max"]), String::new()),
            "file" => ("a file, or its text".into(), String::new()),
            _ => ("text".into(), String::new()),
        };
        let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
        let _ = writeln!(
            page,
            "| `{}` | `{}` | {} | {} |",
            text(param, "name"),
            param.get("default").unwrap_or(&none),
            cell(&values),
            cell(&format!("{}{meaning}", text(param, "help")))
        );
    }
    page
}
