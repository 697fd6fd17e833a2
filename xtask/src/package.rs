//! Packages every published crate with cargo, in one call, so that the packages find each other.

use std::path::Path;

use serde_json::Value;

use crate::tools::{Outcome, command, output_of, root, run};

/// The crates for users of registries. Each has its own README, with an example, and settings for
/// docs.rs. The other published crates share `crates/README.md`.
const FOR_USERS: [&str; 8] = ["plugin-abi", "core", "display", "plugin", "gltf", "pathtracer", "factorizer", "cli"];

/// The largest number of lines of a README for users.
const SCREEN: usize = 75;

/// The largest number of keywords, and of categories, that crates.io accepts.
const MOST_WORDS: usize = 5;

/// The categories in use, which exist on crates.io.
const CATEGORIES: [&str; 12] = [
    "algorithms",
    "command-line-utilities",
    "data-structures",
    "development-tools::ffi",
    "graphics",
    "multimedia::images",
    "no-std",
    "rendering",
    "rendering::data-formats",
    "science",
    "simulation",
    "visualization",
];

/// Packages every published crate without compiling it. Fails if a key that registries need is
/// missing, or if a package lacks a file.
pub fn check() -> Outcome {
    let said = output_of(command("cargo").args(["metadata", "--format-version", "1", "--no-deps"]));
    let metadata: Value =
        serde_json::from_str(&said.ok_or("cargo metadata failed")?).map_err(|error| error.to_string())?;
    let packages = metadata["packages"].as_array().ok_or("cargo metadata lists no packages")?;
    let (published, kept): (Vec<&Value>, Vec<&Value>) = packages
        .iter()
        .partition(|package| package["publish"].as_array().is_none_or(|registries| !registries.is_empty()));
    let mut problems = Vec::new();
    for package in &published {
        let name = package["name"].as_str().unwrap_or_default();
        for key in ["description", "license", "readme", "rust_version"] {
            if package[key].as_str().is_none_or(str::is_empty) {
                problems.push(format!("{name}: expected a value for {key}, found none"));
            }
        }
        let manifest = package["manifest_path"].as_str().unwrap_or_default();
        words(package, name, &mut problems);
        if FOR_USERS.iter().any(|user| name.strip_prefix("lumistack-") == Some(user)) {
            front(package, name, Path::new(manifest), &mut problems)?;
        }
        outside(&Path::new(manifest).with_file_name("src"), 1, &mut problems)?;
    }
    if !problems.is_empty() {
        return Err(format!("package:\n  {}", problems.join("\n  ")));
    }
    let mut package = command("cargo");
    package.args(["package", "--quiet", "--workspace", "--no-verify", "--allow-dirty"]);
    for package_kept in &kept {
        package.args(["--exclude", package_kept["name"].as_str().unwrap_or_default()]);
    }
    run(&mut package)?;
    println!("package: crates in target/package: {}; crates that are not published: {}", published.len(), kept.len());
    Ok(())
}

/// Unpacks the packages of [`check`] into a new workspace, so that only packaged files are
/// available. Checks each package of [`FOR_USERS`] by itself with cargo. Installs the command from
/// its package, and runs a small job.
pub fn install() -> Outcome {
    check()?;
    let from = root().join("target/package");
    let into = from.join("unpacked");
    let failed = |error: std::io::Error| format!("{}: {error}", into.display());
    // Left-overs of another version must not be members of the workspace.
    std::fs::remove_dir_all(&into).or_else(|error| if into.exists() { Err(error) } else { Ok(()) }).map_err(failed)?;
    std::fs::create_dir_all(&into).map_err(failed)?;
    let mut names = Vec::new();
    for entry in std::fs::read_dir(&from).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if let Some(name) = package_of(&path) {
            run(command("tar").arg("-xzf").arg(&path).arg("-C").arg(&into))?;
            names.push(name);
        }
    }
    // The packages require each other from a registry, which does not have them yet. So the
    // workspace replaces them by the unpacked packages.
    let mut workspace =
        String::from("[workspace]\nresolver = \"3\"\nmembers = [\"lumistack-*\"]\n\n[patch.crates-io]\n");
    names.iter().for_each(|[name, version]| {
        workspace += &format!("{name} = {{ path = \"{name}-{version}\" }}\n");
    });
    std::fs::write(into.join("Cargo.toml"), workspace).map_err(failed)?;
    let cargo = |arguments: &[&str]| {
        let mut cargo = command("cargo");
        cargo.args(arguments).current_dir(&into).env("CARGO_TARGET_DIR", from.join("build"));
        run(&mut cargo)
    };
    // Check each package for users by itself. In one call for all packages, a package could use
    // features that only another package enables.
    for user in FOR_USERS {
        cargo(&["check", "--quiet", "--package", &format!("lumistack-{user}")])?;
    }
    let cli = names
        .iter()
        .find(|[name, _]| name == "lumistack-cli")
        .ok_or("target/package: expected lumistack-cli, found none")?;
    let installed = from.join("installed");
    let folder = format!("{}-{}", cli[0], cli[1]);
    cargo(&["install", "--quiet", "--force", "--path", &folder, "--root", &installed.to_string_lossy()])?;
    let runs = from.join("run");
    let mut job = command(installed.join("bin/lumistack"));
    job.args(["run", "scenes/still-life/job.toml", "--resolution", "84x52", "--views", "3x3", "--samples", "1"]);
    run(job.arg("--output").arg(&runs))?;
    println!(
        "package: packages for users that compile outside of this repository: {}; the installed command wrote {}",
        FOR_USERS.len(),
        runs.display()
    );
    Ok(())
}

/// Returns the name and the version of a file `lumistack-NAME-VERSION.crate`.
fn package_of(path: &Path) -> Option<[String; 2]> {
    let stem = path.file_name()?.to_str()?.strip_suffix(".crate")?;
    let (name, version) = stem.rsplit_once('-')?;
    name.starts_with("lumistack-").then(|| [name.to_owned(), version.to_owned()])
}

/// Checks the keywords and categories of a package by the rules of crates.io.
fn words(package: &Value, name: &str, problems: &mut Vec<String>) {
    for key in ["keywords", "categories"] {
        let words: Vec<&str> = package[key].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        if words.is_empty() || words.len() > MOST_WORDS {
            problems.push(format!("{name}: {key}: expected 1 to {MOST_WORDS}, found {}", words.len()));
        }
        let known = |word: &str| match key {
            "categories" => CATEGORIES.contains(&word),
            _ => {
                let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
                word.len() <= 20 && word.starts_with(|c: char| c.is_ascii_alphanumeric()) && word.chars().all(plain)
            }
        };
        let expected = match key {
            "categories" => "a category of the list in package.rs",
            _ => "at most 20 lower-case letters, digits and hyphens, a letter or digit first",
        };
        let unknown = words.iter().filter(|word| !known(word));
        problems.extend(unknown.map(|word| format!("{name}: {key}: expected {expected}, found `{word}`")));
    }
}

/// Checks the README and the settings for docs.rs of a crate for users.
fn front(package: &Value, name: &str, manifest: &Path, problems: &mut Vec<String>) -> Outcome {
    if package["readme"] != "README.md" {
        problems.push(format!("{name}: readme: expected a README.md of its own, found {}", package["readme"]));
        return Ok(());
    }
    let path = manifest.with_file_name("README.md");
    let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let lines = text.lines().count();
    if lines > SCREEN {
        problems.push(format!("{}: expected at most {SCREEN} lines, found {lines}", path.display()));
    }
    for part in ["\n```", "**Units and conventions:**", "\nLicence: MIT OR Apache-2.0."] {
        if !text.contains(part) {
            problems.push(format!("{}: expected the text `{}`, found none", path.display(), part.trim_start()));
        }
    }
    if !package["metadata"]["docs"]["rs"]["targets"].is_array() {
        problems.push(format!("{name}: expected `targets` in [package.metadata.docs.rs], found none"));
    }
    // the example is tested with the crate's documentation; the command's example has its own test
    let code = manifest.with_file_name("src").join("lib.rs");
    let code = std::fs::read_to_string(&code).map_err(|error| format!("{}: {error}", code.display()))?;
    if text.contains("```rust") && !code.contains("doc = include_str!(\"../README.md\")") {
        problems.push(format!("{name}: src/lib.rs: expected a test of the example of README.md, found none"));
    }
    Ok(())
}

/// Reports code that includes a file from outside of its crate's folder, which the package lacks. A
/// symbolic link in the crate's folder is right, since cargo packages the files behind it. `depth`
/// is the number of folders between the crate's folder and the files of `folder`.
fn outside(folder: &Path, depth: usize, problems: &mut Vec<String>) -> Outcome {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            outside(&path, depth + 1, problems)?;
        } else if path.extension().is_some_and(|end| end == "rs") {
            let text = std::fs::read_to_string(&path).map_err(failed)?;
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            let above = format!("\"{}", "../".repeat(depth + 1));
            let lines = code.lines().enumerate().filter(|(_, line)| line.contains("include_") && line.contains(&above));
            problems.extend(lines.map(|(number, _)| {
                format!(
                    "{}:{}: expected an included file inside the crate, found a file outside of the crate",
                    path.display(),
                    number + 1
                )
            }));
        }
    }
    Ok(())
}
