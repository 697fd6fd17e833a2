//! Tests with files that are no usable plugins. Each such file must give one clear message, and the
//! other plugins must still work.

use std::fs;
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::process::Command;

#[cfg(unix)]
use lumistack_plugin::abi::{ABI_MAJOR, ABI_MINOR, Descriptor, OutputVtable};
use lumistack_plugin_host::{PluginPaths, Registry};

use crate::common::{self, example, file_name};

/// ELF's machine numbers, and the names of these machines in messages.
#[cfg(target_os = "linux")]
const ELF_MACHINES: [(u16, &str); 4] = [(62, "x86_64"), (183, "aarch64"), (243, "riscv"), (21, "powerpc64")];

fn load(named: &[&Path]) -> Registry {
    let mut registry = Registry::built_in().unwrap();
    registry.load(&common::paths(named.iter().map(|path| path.to_path_buf()).collect()));
    // Load all libraries, since some errors appear only when a library is loaded.
    let _ = registry.infos().count();
    registry
}

/// Loads a file, which must fail. Returns the message without the file's path.
fn failure(path: &Path) -> String {
    let registry = load(&[path]);
    let text = match registry.failed().as_slice() {
        [error] => error.to_string(),
        errors => panic!("{}: expected one error, found {errors:?}", path.display()),
    };
    assert_eq!(registry.entries().count(), Registry::built_in().unwrap().entries().count(), "nothing was added");
    let rest = text.strip_prefix(&format!("{}: ", path.display())).unwrap_or_else(|| panic!("{text} names no file"));
    rest.to_string()
}

fn write(folder: &Path, id: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(file_name(id));
    fs::write(&path, bytes).unwrap();
    path
}

/// Returns the file header of a shared library for 64-bit little-endian Linux, without the rest of
/// the library.
#[cfg(target_os = "linux")]
fn elf_header(machine: u16) -> Vec<u8> {
    let mut header = vec![0x7f, b'E', b'L', b'F', 2, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    header.extend(3u16.to_le_bytes());
    header.extend(machine.to_le_bytes());
    header.extend(1u32.to_le_bytes());
    header.extend([0; 24 + 4]);
    header.extend([64, 0, 56, 0, 0, 0, 64, 0, 0, 0, 0, 0]);
    assert_eq!(header.len(), 64);
    header
}

/// Returns the first headers of a library for 64-bit Windows, without the rest of the library.
fn pe_header() -> Vec<u8> {
    let mut header = vec![0; 0x40];
    header[..2].copy_from_slice(b"MZ");
    header[0x3c] = 0x40;
    header.extend(b"PE\0\0\x64\x86\0\0\0\0\0\0\0\0\0\0\0\0\0\0\xf0\x00\x22\x20\x0b\x02");
    header.resize(0x40 + 24 + 0xf0, 0);
    header
}

#[test]
fn files_that_are_no_libraries_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |id: &str, bytes: &[u8]| failure(&write(folder.path(), id, bytes));
    assert_eq!(at("text", b"#!/bin/sh\necho no\n"), "expected a shared library, found a file of another kind");
    assert_eq!(at("empty", b""), "expected a shared library, found a file of another kind");
    let mut cut_off = if cfg!(windows) { pe_header() } else { b"\x7fELF\x02\x01\x01 cut off here".to_vec() };
    if cfg!(windows) {
        // the header states one section, which is missing
        cut_off[0x46] = 1;
    }
    let damaged = at("damaged", &cut_off);
    assert!(damaged.starts_with("expected a shared library, found a damaged library: "), "{damaged}");
    fs::create_dir(folder.path().join(file_name("folder"))).unwrap();
    let registry = load(&[folder.path()]);
    let texts: Vec<String> = registry.failed().iter().map(ToString::to_string).collect();
    assert_eq!(texts.len(), 4, "{texts:?}");
    assert!(texts[2].ends_with("expected a shared library, found a folder"), "{texts:?}");
}

#[test]
#[cfg(target_os = "linux")]
fn libraries_for_other_machines_are_recognized() {
    let folder = tempfile::tempdir().unwrap();
    let here = std::env::consts::ARCH;
    for (number, name) in ELF_MACHINES.iter().filter(|(_, name)| !here.starts_with(name)) {
        let message = failure(&write(folder.path(), "other", &elf_header(*number)));
        let expected = format!("expected a library for {here} (elf), found a library for {name}");
        assert!(message.starts_with(&expected), "{message}");
    }
    let message = failure(&write(folder.path(), "windows", &pe_header()));
    assert_eq!(message, format!("expected a library for {here} (elf), found a library for x86_64 (pe)"));
    // A library for this machine that has only a header exports no functions.
    let mine = ELF_MACHINES.iter().find(|(_, name)| here.starts_with(name));
    if let Some((number, _)) = mine {
        let message = failure(&write(folder.path(), "hollow", &elf_header(*number)));
        assert!(message.starts_with("expected the exported function `lumistack_plugin_entry_hollow`"), "{message}");
    }
    // A program is no library, even if it is for this machine.
    let program = folder.path().join(file_name("program"));
    compile(&["-no-pie", "-o"], &program, "int main(void) { return 0; }");
    assert_eq!(failure(&program), "expected a shared library, found an object file of another kind");
}

#[test]
fn names_and_places_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let misnamed = folder.path().join("faulty.so");
    fs::copy(example("faulty"), &misnamed).unwrap();
    let expected = format!(
        "expected a file named like `{}`, with NAME of lower-case letters, digits and underscores, beginning with a letter, found another name",
        file_name("NAME")
    );
    assert_eq!(failure(&misnamed), expected);
    let upper = folder.path().join(file_name("Faulty"));
    fs::copy(example("faulty"), &upper).unwrap();
    assert!(failure(&upper).starts_with("expected a file named"));
    let missing = failure(&folder.path().join("nothing"));
    assert!(missing.starts_with("cannot read this plugin library, or folder of plugin libraries: "), "{missing}");
    let empty = folder.path().join("release");
    fs::create_dir(&empty).unwrap();
    let expected = format!("expected files named like `{}`, found none; `cargo build --release` ", file_name("*"));
    assert!(failure(&empty).starts_with(&expected), "{}", failure(&empty));
    // A renamed library keeps its plugin's id, since ids come from the exported functions.
    let renamed = folder.path().join(file_name("other"));
    fs::copy(example("faulty"), &renamed).unwrap();
    let registry = load(&[&renamed]);
    assert!(registry.failed().is_empty() && registry.get("faulty").is_ok());
}

#[test]
fn an_id_that_is_taken_stays_with_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| {
        let place = folder.path().join(name);
        fs::create_dir(&place).unwrap();
        fs::copy(example("faulty"), place.join(file_name("faulty"))).unwrap();
        place
    });
    let registry = load(&[&a, &b, &a]);
    let (_, origin) = registry.entries().find(|(info, _)| info.id == "faulty").unwrap();
    assert_eq!(origin.to_string(), a.join(file_name("faulty")).display().to_string());
    let texts: Vec<String> = registry.failed().iter().map(ToString::to_string).collect();
    let [at, first] = [&b, &a].map(|place| place.join(file_name("faulty")).display().to_string());
    let expected = "expected an id that no other plugin has, found `faulty`, the id of another plugin";
    assert_eq!(texts, [format!("{at}: {expected} ({first})")]);
}

#[test]
fn the_user_s_folder_need_not_exist() {
    let folder = tempfile::tempdir().unwrap();
    let user = folder.path().join("lumistack/plugins");
    let load = || {
        let mut registry = Registry::default();
        registry.load(&PluginPaths { user: Some(user.clone()), ..common::paths(Vec::new()) });
        registry
    };
    assert_eq!((load().entries().count(), load().failed().len()), (0, 0));
    fs::create_dir_all(&user).unwrap();
    fs::copy(example("faulty"), user.join(file_name("faulty"))).unwrap();
    fs::write(user.join("notes.txt"), "not looked at").unwrap();
    assert_eq!((load().entries().count(), load().failed().len()), (1, 0));
}

/// Compiles C code into a file. Every Unix machine that links Rust has a C compiler.
#[cfg(unix)]
fn compile(options: &[&str], output: &Path, code: &str) {
    let source = output.with_extension("c");
    fs::write(&source, code).unwrap();
    let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    let done = cc.args(options).arg(output).arg(&source).status().expect("a C compiler");
    assert!(done.success(), "cc on {}", source.display());
}

/// Compiles a library from C code `text`, which defines a descriptor.
#[cfg(unix)]
fn descriptor_in_c(folder: &Path, id: &str, text: &str) -> PathBuf {
    let library = folder.join(file_name(id));
    let code = format!(
        "#include <stddef.h>\n#include <stdint.h>\n\
         struct str {{ const char *ptr; size_t len; }};\n\
         struct descriptor {{ uint32_t major, minor; size_t size; uint32_t kind, ports;\n\
           struct str id, version, doc, schema; const void *vtable; }};\n\
         #define STR(t) {{ t, sizeof t - 1 }}\n\
         {text}\n"
    );
    compile(&["-shared", "-fPIC", "-o"], &library, &code);
    library
}

#[test]
#[cfg(unix)]
fn libraries_of_other_versions_are_recognized() {
    let folder = tempfile::tempdir().unwrap();
    let (size, vtable) = (size_of::<Descriptor>(), size_of::<OutputVtable>());
    let texts = "STR(\"id\"), STR(\"1.0.0\"), STR(\"A sentence.\"), STR(\"{\\\"params\\\": []}\")";
    let message = |id: &str, major: u32, minor: u32, size: usize, rest: &str| {
        let texts = texts.replace("\"id\"", &format!("\"{id}\""));
        let code = format!(
            "static const struct descriptor d = {{ {major}, {minor}, {size}, {rest} }};\n\
             const void *lumistack_plugin_entry_{id}(void) {{ return &d; }}"
        );
        failure(&descriptor_in_c(folder.path(), id, &code.replace("TEXTS", &texts)))
    };
    assert_eq!(
        message("newer", ABI_MAJOR + 1, 4, 200, "4, 4, TEXTS, 0"),
        format!(
            "expected a plugin for version {ABI_MAJOR}.{ABI_MINOR} of the plugin interface (ABI), found a plugin for version {}.4; the plugin needs a newer version of this program",
            ABI_MAJOR + 1
        )
    );
    let short = message("short", ABI_MAJOR, ABI_MINOR, 24, "4, 4, TEXTS, 0");
    let expected = format!("descriptor of version {ABI_MAJOR}.{ABI_MINOR}: expected ");
    assert!(short.starts_with(&expected) && short.ends_with("found a size of 24 bytes"), "{short}");
    let unknown = message("unknown", ABI_MAJOR, ABI_MINOR, size, "77, 4, TEXTS, 0");
    let expected = "expected kind 1 (importer), 2 (source), 3 (node) or 4 (output), found 77";
    assert_eq!(unknown, format!("plugin `unknown`: {expected}"));
    let bare = message("bare", ABI_MAJOR, ABI_MINOR, size, "4, 4, TEXTS, 0");
    assert_eq!(bare, "plugin `bare`: expected all functions of an output, found a table that lacks one");

    // the structs of a newer minor version are longer
    for (id, last, vtable) in [("same", "", vtable), ("grown", ", *more", vtable + 8)] {
        let code = format!(
            "static int open_(const void *h, struct str p, struct str d, void **i, const void *e) {{ *i = 0; return 0; }}\n\
             static int submit(void *i, const void *t, const void *d, const void *e) {{ return 0; }}\n\
             static int finish(void *i, const void *e) {{ return 0; }}\n\
             static void close_(void *i) {{ }}\n\
             static const struct {{ size_t size; const void *open, *submit, *run, *finish, *close, *command{last}; }} v =\n\
               {{ {vtable}, open_, submit, 0, finish, close_ }};\n\
             static const struct {{ struct descriptor d; uint64_t more; }} d = {{ {{ {ABI_MAJOR}, {ABI_MINOR} + 7, {size} + 8, 4, 4,\n\
               {}, &v }}, 9 }};\n\
             const void *lumistack_plugin_entry_{id}(void) {{ return &d; }}",
            texts.replace("\"id\"", &format!("\"{id}\""))
        );
        let registry = load(&[&descriptor_in_c(folder.path(), id, &code)]);
        assert!(registry.failed().is_empty(), "{:?}", registry.failed());
        assert_eq!(registry.get(id).unwrap().info().version, "1.0.0");
    }
}

#[test]
#[cfg(unix)]
fn a_library_may_hold_several_plugins() {
    let folder = tempfile::tempdir().unwrap();
    let (size, vtable) = (size_of::<Descriptor>(), size_of::<OutputVtable>());
    let functions = format!(
        "static int open_(const void *h, struct str p, struct str d, void **i, const void *e) {{ *i = 0; return 0; }}\n\
         static int submit(void *i, const void *t, const void *d, const void *e) {{ return 0; }}\n\
         static int finish(void *i, const void *e) {{ return 0; }}\n\
         static void close_(void *i) {{ }}\n\
         static const struct {{ size_t size; const void *open, *submit, *run, *finish, *close, *command; }} v =\n\
           {{ {vtable}, open_, submit, 0, finish, close_ }};\n"
    );
    let plugin = |id: &str, told: &str| {
        format!(
            "static const struct descriptor d_{id} = {{ {ABI_MAJOR}, {ABI_MINOR}, {size}, 4, 4,\n\
               STR(\"{told}\"), STR(\"1.0.0\"), STR(\"A sentence.\"), STR(\"{{\\\"params\\\": []}}\"), &v }};\n\
             const void *lumistack_plugin_entry_{id}(void) {{ return &d_{id}; }}\n"
        )
    };
    let code = functions + &plugin("first", "first") + &plugin("second", "second") + &plugin("third", "other");
    let library = descriptor_in_c(folder.path(), "pair", &code);
    let registry = load(&[&library]);
    for id in ["first", "second"] {
        assert_eq!(registry.get(id).unwrap().info().id, id);
        assert_eq!(registry.origin(id).unwrap().to_string(), library.display().to_string());
    }
    // Only the plugin `third` has an error, and must not affect the other plugins of its library.
    let texts: Vec<String> = registry.failed().iter().map(ToString::to_string).collect();
    let expected =
        "expected the id `third`, from the name of the entry function, found the id `other` in the descriptor";
    assert_eq!(texts, [format!("{}: {expected}", library.display())]);
}

#[test]
#[cfg(unix)]
fn libraries_without_a_usable_entry_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let none = descriptor_in_c(folder.path(), "none", "int answer(void) { return 42; }");
    assert_eq!(
        failure(&none),
        "expected the exported function `lumistack_plugin_entry_none`, found no function of that name"
    );
    let null = descriptor_in_c(folder.path(), "null", "const void *lumistack_plugin_entry_null(void) { return 0; }");
    assert_eq!(failure(&null), "expected a descriptor from the plugin's entry function, found null");
    let needy = descriptor_in_c(
        folder.path(),
        "needy",
        "int not_there(void);\nconst void *lumistack_plugin_entry_needy(void) { return 0; }\nint (*const call)(void) = not_there;",
    );
    let message = failure(&needy);
    assert!(message.starts_with("cannot be loaded: ") && message.contains("not_there"), "{message}");
}
