//! Lists the dependencies of the program and their licences: as a text with all licences, and as a
//! bill of materials (CycloneDX).

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::build::Target;
use crate::tools::{Outcome, command, output_of, root};

/// Arguments of cargo for the released packages of every target. Dependencies that only builds or
/// tests need are ignored.
const RELEASED: [&[&str]; 2] = [
    &["--package", "lumistack-cli", "--features", "panels"],
    &["--package", "lumistack-python", "--features", "panels"],
];

/// Arguments of cargo for the WebAssembly modules of the pages, which the command also contains.
const VIEWER: &[&str] = &["--package", "lumistack-web"];
const PAGES: [&[&str]; 2] = [VIEWER, &["--package", "lumistack-web-solver"]];
const WASM: &str = "wasm32-unknown-unknown";

/// A Rust package in the program.
struct Part {
    name: String,
    version: String,
    /// SPDX expression.
    licence: String,
    authors: Vec<String>,
    /// SHA-256 of the registry's file; `None` for Lumistack's own packages.
    sum: Option<String>,
    folder: PathBuf,
    /// `name version` of the part's dependencies.
    uses: BTreeSet<String>,
}

/// All parts, by `name version`.
pub struct Licences(BTreeMap<String, Part>);

/// Collects the packages (parts) of programs and modules for some targets, by cargo.
pub fn collect(targets: &[Target]) -> Outcome<Licences> {
    let of_targets = targets.iter().flat_map(|target| RELEASED.map(|words| (words, target.triple)));
    described(of_targets.chain(PAGES.map(|words| (words, WASM))).map(in_target).collect::<Outcome<Vec<_>>>()?.concat())
}

/// Collects the packages of the viewer's module.
pub fn of_viewer() -> Outcome<Licences> {
    described(in_target((VIEWER, WASM))?)
}

/// Looks up cargo's data about the packages with these ids.
fn described(ids: Vec<String>) -> Outcome<Licences> {
    // Read the packages from cargo's metadata and their checksums from the lock file.
    let said = output_of(command("cargo").args(["metadata", "--format-version", "1", "--locked"]));
    let metadata: Value =
        serde_json::from_str(&said.ok_or("cargo metadata failed")?).map_err(|error| error.to_string())?;
    let lock = std::fs::read_to_string(root().join("Cargo.lock")).map_err(|error| format!("Cargo.lock: {error}"))?;
    let sums = sums(&lock);
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let packages: Vec<&Value> = metadata["packages"].as_array().into_iter().flatten().collect();
    let id = |package: &Value| format!("{} {}", text(&package["name"]), text(&package["version"]));
    let of_cargo: HashMap<&str, String> =
        packages.iter().map(|package| (package["id"].as_str().unwrap_or_default(), id(package))).collect();
    let nodes = metadata["resolve"]["nodes"].as_array().into_iter().flatten();
    // Find the dependencies between the packages, for the bill of materials.
    let mut uses: HashMap<String, BTreeSet<String>> = nodes
        .filter_map(|node| {
            let of = of_cargo.get(node["id"].as_str()?)?.clone();
            let on = node["dependencies"].as_array()?.iter().filter_map(|on| of_cargo.get(on.as_str()?).cloned());
            Some((of, on.filter(|on| ids.contains(on)).collect()))
        })
        .collect();
    let parts = packages.into_iter().filter(|package| ids.contains(&id(package))).map(|package| {
        let id = id(package);
        let authors = package["authors"].as_array().into_iter().flatten().map(&text).collect();
        let part = Part {
            name: text(&package["name"]),
            version: text(&package["version"]),
            licence: text(&package["license"]).replace('/', " OR "),
            authors,
            sum: sums.get(&id).cloned(),
            folder: PathBuf::from(text(&package["manifest_path"])).parent().unwrap_or(Path::new("")).to_owned(),
            uses: uses.remove(&id).unwrap_or_default(),
        };
        (id, part)
    });
    let licences = Licences(parts.collect());
    licences.check().map(|()| licences)
}

/// Returns `name version` of all packages that the packages `words` need on a target.
fn in_target((words, triple): (&[&str], &str)) -> Outcome<Vec<String>> {
    let mut tree = command("cargo");
    tree.arg("tree").args(words).args(["--locked", "--edges", "normal", "--prefix", "none", "--target", triple]);
    let said = output_of(&mut tree).ok_or("cargo tree failed")?;
    let ids = said.lines().filter_map(|line| {
        let (name, rest) = line.split_once(" v")?;
        Some(format!("{name} {}", rest.split(' ').next()?))
    });
    Ok(ids.collect())
}

/// Returns the checksums of a lock file, by `name version`.
fn sums(lock: &str) -> HashMap<String, String> {
    let packages = lock.split("[[package]]").skip(1);
    let value = |package: &str, key: &str| {
        let line = package.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(" = "))?;
        Some(line.trim_matches('"').to_owned())
    };
    packages
        .filter_map(|package| {
            let id = format!("{} {}", value(package, "name")?, value(package, "version")?);
            Some((id, value(package, "checksum")?))
        })
        .collect()
}

impl Licences {
    /// Checks that every part states its licence.
    fn check(&self) -> Outcome {
        let silent: Vec<_> =
            self.0.iter().filter(|(_, part)| part.licence.is_empty()).map(|(id, _)| id.as_str()).collect();
        if silent.is_empty() {
            Ok(())
        } else {
            Err(format!("expected a licence for every package, found none for {}", silent.join(", ")))
        }
    }

    /// Lists the packages of other projects with their licences, then every licence text with the
    /// packages that have it.
    pub fn text(&self) -> String {
        let mut text =
            String::from("Lumistack is made of these packages of Rust. The licence of each follows its name.\n\n");
        let mut texts: BTreeMap<String, Vec<&str>> = BTreeMap::new();
        let foreign = self.0.iter().filter(|(_, part)| part.sum.is_some());
        for (id, part) in foreign {
            text += &format!("  {id}: {}\n", part.licence);
            let own = texts_in(&part.folder);
            let own = if own.is_empty() { standard(part) } else { own };
            for licence in own {
                texts.entry(licence).or_default().push(id);
            }
        }
        let mut texts: Vec<_> = texts.into_iter().collect();
        texts.sort_by_key(|(_, parts)| parts[0].to_owned());
        for (licence, parts) in texts {
            text += &format!("\n{}\n{}\n\n{}\n", "-".repeat(80), parts.join(", "), licence.trim_end());
        }
        text
    }

    /// Makes the bill of materials, as CycloneDX.
    pub fn sbom(&self) -> Value {
        let url = |id: &str| format!("pkg:cargo/{}", id.replace(' ', "@"));
        let components = self.0.iter().map(|(id, part)| {
            let mut component = json!({
                "type": "library", "bom-ref": url(id), "name": part.name, "version": part.version, "purl": url(id),
                "licenses": [{ "expression": part.licence }],
            });
            if let Some(sum) = &part.sum {
                component["hashes"] = json!([{ "alg": "SHA-256", "content": sum }]);
            }
            component
        });
        let uses = self.0.iter().map(
            |(id, part)| json!({ "ref": url(id), "dependsOn": part.uses.iter().map(|on| url(on)).collect::<Vec<_>>() }),
        );
        json!({
            "bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1,
            "metadata": { "component": {
                "type": "application", "bom-ref": "lumistack", "name": "lumistack", "version": env!("CARGO_PKG_VERSION"),
                "licenses": [{ "expression": "MIT OR Apache-2.0" }],
            } },
            "components": components.collect::<Vec<_>>(),
            "dependencies": uses.collect::<Vec<_>>(),
        })
    }
}

/// Returns the licence texts of a package.
fn texts_in(folder: &Path) -> Vec<String> {
    let is_licence = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        ["LICEN", "COPYING", "NOTICE", "UNLICENSE"].iter().any(|start| name.starts_with(start)) && path.is_file()
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut paths: Vec<_> = entries.filter(|path| is_licence(path)).collect();
    paths.sort();
    paths.iter().filter_map(|path| std::fs::read_to_string(path).ok()).map(|text| text.replace('\r', "")).collect()
}

/// Returns the licence text for a package that contains none. It is the standard text of a licence
/// that the package offers, with the package's authors.
fn standard(part: &Part) -> Vec<String> {
    let ours = |name: &str| std::fs::read_to_string(root().join(name)).unwrap_or_default();
    let text = match part.licence.as_str() {
        licence if licence.contains("Apache-2.0") => ours("LICENSE-APACHE"),
        licence if licence.contains("MIT") => {
            let text = ours("LICENSE-MIT");
            let terms = text.find("Permission is hereby").map_or("", |start| &text[start..]).to_owned();
            format!("MIT License\n\nCopyright (c) {}\n\n{terms}", part.authors.join(", "))
        }
        licence => format!("{licence}, by {}; its text is at https://spdx.org/licenses\n", part.authors.join(", ")),
    };
    vec![text]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_the_lock_file() {
        let lock = "[[package]]\nname = \"a\"\nversion = \"1.0\"\nchecksum = \"12ab\"\n\n[[package]]\nname = \"own\"\nversion = \"0.1.0\"\n";
        assert_eq!(sums(lock), HashMap::from([("a 1.0".to_owned(), "12ab".to_owned())]));
    }

    #[test]
    fn every_foreign_part_has_a_text_and_our_own_have_none() {
        let part = |name: &str, sum: Option<&str>| Part {
            name: name.into(),
            version: "1.0".into(),
            licence: "MIT".into(),
            authors: vec!["A. Author".into()],
            sum: sum.map(str::to_owned),
            folder: PathBuf::from("no such folder"),
            uses: BTreeSet::from(["b 1.0".to_owned()]),
        };
        let parts = [("a 1.0", part("a", Some("12ab"))), ("own 1.0", part("own", None))];
        let licences = Licences(parts.into_iter().map(|(id, part)| (id.to_owned(), part)).collect());
        let text = licences.text();
        assert!(
            text.contains("  a 1.0: MIT\n") && text.contains("Copyright (c) A. Author") && !text.contains("own 1.0")
        );
        assert!(text.contains("Permission is hereby granted"));
        let sbom = licences.sbom();
        assert_eq!(sbom["components"][0]["purl"], "pkg:cargo/a@1.0");
        assert_eq!(sbom["dependencies"][0]["dependsOn"][0], "pkg:cargo/b@1.0");
    }
}
