//! Finds cycles in a crate: files that use each other, directly or through other files. Cycles are
//! bad: a reader who wants to understand one file of a cycle must also read all its other files.
//!
//! A file uses another file if its code names an item that the other file defines. `use`
//! declarations and full paths are followed through re-exports to the definition. Re-exports, `mod`
//! lines and tests are not regarded as uses.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Attribute, File, Item, ItemMod, ItemUse, UseTree, Visibility};

/// Path of a module or item from the crate's root.
type Names = Vec<String>;

/// One file, with its inline modules.
struct Source {
    path: PathBuf,
    /// Path of its module.
    module: Names,
    /// Names that `use` declarations import, each with its path from the crate's root.
    known: BTreeMap<String, Names>,
    /// Modules of glob imports.
    globs: Vec<Names>,
    /// Paths from the crate's root of all items that the code names.
    named: BTreeSet<Names>,
    /// Items that the file defines.
    defined: BTreeSet<String>,
}

/// Finds the cycles of the crate with the root file `root`. Each cycle has two lists: its files,
/// and one line for every use between two of these files.
pub fn of_crate(root: &Path) -> Result<Vec<[Vec<String>; 2]>, String> {
    let mut files = BTreeMap::new();
    read(root, Vec::new(), &mut files)?;
    // For every file, find the files that it uses. Store one used item of every used file as an
    // example.
    let edges: BTreeMap<&Names, BTreeMap<Names, String>> = files
        .iter()
        .map(|(module, source)| {
            let used = source.named.iter().filter_map(|path| Some((home_of(&files, path, 0)?, path.join("::"))));
            (module, used.filter(|(home, _)| home != module).collect())
        })
        .collect();
    // Find the files that each file uses directly or through others.
    let reached = |from: &Names| -> BTreeSet<Names> {
        let (mut seen, mut todo) = (BTreeSet::new(), vec![from.clone()]);
        while let Some(module) = todo.pop() {
            for next in edges.get(&module).into_iter().flat_map(BTreeMap::keys) {
                if seen.insert(next.clone()) {
                    todo.push(next.clone());
                }
            }
        }
        seen
    };
    let reach: BTreeMap<&Names, BTreeSet<Names>> = edges.keys().map(|module| (*module, reached(module))).collect();
    let folder = root.parent().unwrap_or(Path::new(""));
    let name = |module: &Names| files[module].path.strip_prefix(folder).unwrap_or(root).display().to_string();
    // A file that reaches itself is in a cycle. The cycle consists of all files that this file
    // reaches and that also reach this file.
    let mut circles = BTreeSet::new();
    for (module, seen) in reach.iter().filter(|(module, seen)| seen.contains(**module)) {
        let back = |other: &Names| seen.contains(other) && reach[other].contains(*module);
        let members: Vec<&Names> = edges.keys().copied().filter(|other| back(other)).collect();
        let uses = members.iter().flat_map(|from| {
            let within = edges[from].iter().filter(|(to, _)| back(to));
            within.map(|(to, by)| format!("{} uses {}: {by}", name(from), name(to)))
        });
        circles.insert([members.iter().map(|module| name(module)).collect(), uses.collect()]);
    }
    Ok(circles.into_iter().collect())
}

/// Reads a file and the files of its modules.
fn read(path: &Path, module: Names, files: &mut BTreeMap<Names, Source>) -> Result<(), String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let file: File = syn::parse_file(&text).map_err(|error| format!("{}: {error}", path.display()))?;
    let is_root = matches!(path.file_stem().and_then(|stem| stem.to_str()), Some("lib" | "main" | "mod"));
    let folder = if is_root { path.with_file_name("") } else { path.with_extension("") };
    let mut reader = Reader {
        source: Source {
            path: path.to_owned(),
            module: module.clone(),
            known: BTreeMap::new(),
            globs: Vec::new(),
            named: BTreeSet::new(),
            defined: BTreeSet::new(),
        },
        inner: Vec::new(),
        children: Vec::new(),
    };
    reader.visit_file(&file);
    let children = std::mem::take(&mut reader.children);
    files.insert(module.clone(), reader.source);
    for (name, place) in children {
        let child = match place {
            Some(place) => path.with_file_name(place),
            None => {
                let plain = folder.join(format!("{name}.rs"));
                if plain.is_file() { plain } else { folder.join(&name).join("mod.rs") }
            }
        };
        let module = module.iter().cloned().chain([name]).collect();
        read(&child, module, files)?;
    }
    Ok(())
}

struct Reader {
    source: Source,
    /// Path of the inline module that is being read.
    inner: Names,
    /// Modules in other files, with the file of a `path` attribute.
    children: Vec<(String, Option<String>)>,
}

impl Reader {
    /// Converts a path in the code to a path from the crate's root. Returns `None` if the path does
    /// not begin with `crate`, `self` or `super`.
    fn whole(&self, path: &[String]) -> Option<Names> {
        let here = || self.source.module.iter().chain(&self.inner).cloned();
        let (first, rest) = path.split_first()?;
        let mut base: Names = match first.as_str() {
            "crate" => Vec::new(),
            "self" => here().collect(),
            "super" => here().take(self.source.module.len() + self.inner.len() - 1).collect(),
            _ => return None,
        };
        for name in rest {
            if name == "super" {
                base.pop();
            } else if name != "self" {
                base.push(name.clone());
            }
        }
        Some(base)
    }

    fn take(&mut self, tree: &UseTree, before: &mut Names, exported: bool) {
        match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.take(&path.tree, before, exported);
                before.pop();
            }
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.take(tree, before, exported)),
            UseTree::Name(name) => self.bring(name.ident.to_string(), &name.ident.to_string(), before, exported),
            UseTree::Rename(name) => self.bring(name.rename.to_string(), &name.ident.to_string(), before, exported),
            UseTree::Glob(_) => {
                if let Some(module) = self.whole(before) {
                    if !exported {
                        self.source.named.insert(module.clone());
                    }
                    self.source.globs.push(module);
                }
            }
        }
    }

    fn bring(&mut self, name: String, item: &str, before: &[String], exported: bool) {
        let path: Names = before.iter().cloned().chain([item.to_string()]).collect();
        // `use child::Thing` also refers to a module that this file declares
        let whole = self.whole(&path).or_else(|| {
            let declared = before.first().is_some_and(|first| self.children.iter().any(|(child, _)| child == first));
            declared.then(|| self.source.module.iter().cloned().chain(path).collect())
        });
        let Some(whole) = whole else { return };
        if !exported {
            self.source.named.insert(whole.clone());
        }
        self.source.known.entry(name).or_insert(whole);
    }
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_file(&mut self, file: &'ast File) {
        // read all `mod` lines first, since `use` declarations may precede them in the file
        for item in &file.items {
            let name = match item {
                Item::Const(item) => &item.ident,
                Item::Enum(item) => &item.ident,
                Item::Fn(item) => &item.sig.ident,
                Item::Static(item) => &item.ident,
                Item::Struct(item) => &item.ident,
                Item::Trait(item) => &item.ident,
                Item::Type(item) => &item.ident,
                Item::Union(item) => &item.ident,
                Item::Mod(item) => &item.ident,
                _ => continue,
            };
            self.source.defined.insert(name.to_string());
            if let Item::Mod(ItemMod { attrs, ident, content: None, .. }) = item
                && !for_tests(attrs)
            {
                let place = attrs.iter().find_map(|attribute| match &attribute.meta {
                    syn::Meta::NameValue(pair) if pair.path.is_ident("path") => match &pair.value {
                        syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }) => Some(text.value()),
                        _ => None,
                    },
                    _ => None,
                });
                self.children.push((ident.to_string(), place));
            }
        }
        visit::visit_file(self, file);
    }

    fn visit_item(&mut self, item: &'ast Item) {
        let attributes = match item {
            Item::Fn(item) => &item.attrs,
            Item::Impl(item) => &item.attrs,
            Item::Mod(item) => &item.attrs,
            Item::Use(item) => &item.attrs,
            _ => &Vec::new(),
        };
        if !for_tests(attributes) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        if module.content.is_some() {
            self.inner.push(module.ident.to_string());
            visit::visit_item_mod(self, module);
            self.inner.pop();
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        self.take(&item.tree, &mut Vec::new(), !matches!(item.vis, Visibility::Inherited));
    }

    /// Ignores visibilities: `pub(crate)` contains a path, but names no item.
    fn visit_visibility(&mut self, _: &'ast Visibility) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Names = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        let child = self.children.iter().any(|(child, _)| Some(child) == names.first());
        if let Some(whole) = self.whole(&names) {
            self.source.named.insert(whole);
        } else if child && names.len() > 1 && self.inner.is_empty() {
            self.source.named.insert(self.source.module.iter().cloned().chain(names).collect());
        }
        visit::visit_path(self, path);
    }
}

/// Finds the module whose file defines the item at `path`, a path from the crate's root. Never
/// returns `None`, since the root module contains all paths.
fn home_of(files: &BTreeMap<Names, Source>, path: &[String], depth: usize) -> Option<Names> {
    let module = (0..=path.len()).rev().map(|count| &path[..count]).find(|module| files.contains_key(*module))?;
    let source = &files[module];
    let Some(name) = path.get(module.len()) else { return Some(module.to_vec()) };
    if depth < 16 {
        if let Some(from) = source.known.get(name) {
            let from: Names = from.iter().chain(&path[module.len() + 1..]).cloned().collect();
            return home_of(files, &from, depth + 1);
        }
        // if the name is neither defined nor imported by name, the only glob import must provide it
        if let [glob] = source.globs.as_slice()
            && !source.defined.contains(name)
        {
            let from: Names = glob.iter().chain(&path[module.len()..]).cloned().collect();
            return home_of(files, &from, depth + 1);
        }
    }
    Some(module.to_vec())
}

/// Returns true if attributes state that code is compiled only for tests.
fn for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        syn::Meta::List(list) if list.path.is_ident("cfg") => list.tokens.to_string() == "test",
        _ => false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circles(name: &str, sources: &[(&str, &str)]) -> Vec<[Vec<String>; 2]> {
        let folder = std::env::temp_dir().join(format!("circles-{}-{name}", std::process::id()));
        for (name, text) in sources {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        let found = of_crate(&folder.join("lib.rs")).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        found
    }

    #[test]
    fn circles_are_found_through_names_and_paths() {
        let lib = ("lib.rs", "mod a; mod b; pub use a::A; pub use b::B;");
        let line = [lib, ("a.rs", "use crate::A; pub struct A;"), ("b.rs", "use crate::A; pub struct B(A);")];
        assert!(circles("line", &line).is_empty());
        // both files use the root's re-export, so neither names the other file
        let both = [lib, ("a.rs", "use crate::B; pub struct A(B);"), ("b.rs", "pub struct B; fn f(_: crate::A) {}")];
        let uses = ["a.rs uses b.rs: B", "b.rs uses a.rs: A"];
        assert_eq!(circles("both", &both), [[vec!["a.rs", "b.rs"], uses.to_vec()]]);
        let parent = ("a.rs", "mod c; use c::C; pub struct A(C); pub struct D;");
        let child = ("a/c.rs", "use super::D; pub struct C(D);");
        let rest = ("b.rs", "pub struct B; #[cfg(test)] mod tests { use crate::A; }");
        let found = circles("parent", &[lib, parent, child, rest]);
        assert_eq!(found.iter().map(|[files, _]| files).collect::<Vec<_>>(), [&["a.rs", "a/c.rs"]]);
    }
}
