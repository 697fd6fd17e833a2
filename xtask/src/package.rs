//! Packages every published crate with cargo, in one call, so that the packages find each other.

use std::path::Path;

use serde_json::Value;

use crate::tools::{Outcome, command, output_of, run};

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
                problems.push(format!("{name} has no {key}"));
            }
        }
        let manifest = package["manifest_path"].as_str().unwrap_or_default();
        outside(&Path::new(manifest).with_file_name("src"), &mut problems)?;
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
    println!("package: {} crates in target/package, {} are not published", published.len(), kept.len());
    Ok(())
}

/// Reports code that includes a file from outside of its crate's folder, which the package lacks.
fn outside(folder: &Path, problems: &mut Vec<String>) -> Outcome {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            outside(&path, problems)?;
        } else if path.extension().is_some_and(|end| end == "rs") {
            let text = std::fs::read_to_string(&path).map_err(failed)?;
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            let lines =
                code.lines().enumerate().filter(|(_, line)| line.contains("include_") && line.contains("\"../../.."));
            problems.extend(lines.map(|(number, _)| {
                format!("{}:{}: includes a file from outside the crate", path.display(), number + 1)
            }));
        }
    }
    Ok(())
}
