//! `include/lumistack_plugin.h` agrees with the Rust types, and a C compiler gives its structs the
//! layout of the Rust types.
//!
//! `LUMISTACK_WRITE=1 cargo test -p lumistack-plugin-abi --test header` rewrites the header.

use std::fmt::Write as _;
use std::fs;
use std::mem::{align_of, offset_of, size_of};
use std::path::{Path, PathBuf};
use std::process::Command;

use cbindgen::{Builder, Config, ExportConfig, Language, RenameRule};
use lumistack_plugin_abi as abi;

/// Constants by module. In C, the name of a constant begins with the name of its module.
const CONSTANTS: [(&str, &[&str]); 6] = [
    ("KIND", &["IMPORTER", "SOURCE", "NODE", "OUTPUT"]),
    ("PORT", &["SCENE", "LIGHT_FIELD", "LAYER_STACK", "FILE"]),
    ("DTYPE", &["F32"]),
    ("VIEW", &["SLOPE", "EYE"]),
    ("LEVEL", &["ERROR", "WARN", "INFO", "DEBUG"]),
    ("", &["ABI_MAJOR", "ABI_MINOR"]),
];

const TOP: &str = "\
/* Plugins of Lumistack, for C. Generated from the Rust types of lumistack-plugin-abi; do not edit.
 *
 * A shared library lumistack_plugin_NAME (with the system's prefix and suffix) exports for every plugin ID
 *
 *     const LumistackDescriptor *lumistack_plugin_entry_ID(void);
 *
 * A struct that may grow starts with its own size in bytes (a descriptor: with its version, then its size), and
 * grows only at its end. Set `size` of your structs to their `sizeof`, and read at most `size` bytes of the other
 * side's structs. Texts are UTF-8 with a length, never null-terminated.
 * Nothing may unwind into the caller. docs/PLUGINS.md shows a whole plugin.
 */";

fn crate_folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn header_path() -> PathBuf {
    crate_folder().join("include/lumistack_plugin.h")
}

fn generated() -> String {
    let mut export =
        ExportConfig { prefix: Some("Lumistack".into()), renaming_overrides_prefixing: true, ..Default::default() };
    for (module, names) in CONSTANTS {
        for name in names {
            let full = ["LUMISTACK", module, name].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>();
            export.rename.insert((*name).into(), full.join("_"));
        }
    }
    // cbindgen writes a type only if another item uses it, or if it is named here
    let items = ["Descriptor", "OutputVtable", "ImporterVtable", "SourceVtable", "NodeVtable"];
    export.include = items.map(String::from).to_vec();
    export.exclude = vec!["ENTRY_PREFIX".into()];
    let mut config = Config {
        language: Language::C,
        cpp_compat: true,
        include_guard: Some("LUMISTACK_PLUGIN_H".into()),
        header: Some(TOP.into()),
        no_includes: true,
        sys_includes: ["stddef.h", "stdint.h"].map(String::from).to_vec(),
        usize_is_size_t: true,
        line_length: 120,
        export,
        ..Default::default()
    };
    config.function.rename_args = RenameRule::None;
    let mut builder = Builder::new().with_config(config);
    for file in ["lib", "data", "descriptor", "host", "makers"] {
        builder = builder.with_src(crate_folder().join("src").join(format!("{file}.rs")));
    }
    let mut bytes = Vec::new();
    builder.generate().expect("the types have a form in C").write(&mut bytes);
    let text = String::from_utf8(bytes).unwrap();
    // cbindgen does not rename the constants of a struct
    without_links(&text.replace("LumistackStatus_", "LUMISTACK_STATUS_"))
}

/// Replaces the links of Rust's documentation in comments: [`a`](b::a) and [`a`] become `a`.
fn without_links(text: &str) -> String {
    let (mut plain, mut rest) = (String::new(), text);
    while let Some(start) = rest.find("[`") {
        let (before, link) = rest.split_at(start);
        let end = link.find("`]").expect("links end");
        plain += before;
        plain += &link[1..=end];
        rest = &link[end + 2..];
        if let Some(target) = rest.strip_prefix('(') {
            rest = target.split_once(')').expect("links end").1;
        }
    }
    plain + rest
}

#[test]
fn the_header_is_current() {
    let (path, wanted) = (header_path(), generated());
    if std::env::var_os("LUMISTACK_WRITE").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, &wanted).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n");
    assert!(
        found == wanted,
        "{} differs from the types; LUMISTACK_WRITE=1 cargo test -p lumistack-plugin-abi --test header writes it",
        path.display()
    );
}

/// Writes C assertions of the size of structs and the offsets of their members.
macro_rules! layout {
    ($text:ident, $($type:ident { $($member:ident),* $(,)? })*) => {$(
        writeln!($text, "_Static_assert(sizeof(Lumistack{0}) == {1}, \"{0}\");", stringify!($type), size_of::<abi::$type>()).unwrap();
        writeln!($text, "_Static_assert(_Alignof(Lumistack{0}) == {1}, \"{0}\");", stringify!($type), align_of::<abi::$type>()).unwrap();
        $(writeln!(
            $text,
            "_Static_assert(offsetof(Lumistack{0}, {1}) == {2}, \"{0}.{1}\");",
            stringify!($type), stringify!($member), offset_of!(abi::$type, $member)
        ).unwrap();)*
    )*};
}

/// Runs on Unix only, where a C compiler is present: Rust needs one there to link.
#[test]
#[cfg(unix)]
fn c_compilers_see_the_same_layout() {
    let mut text = String::from("#include \"lumistack_plugin.h\"\n");
    layout!(text,
        Str { ptr, len } Bytes { ptr, len } ErrorSink { size, context, write }
        Descriptor { abi_major, abi_minor, size, kind, ports, id, version, doc, schema_json, vtable }
        OutputVtable { size, open, submit, run, finish, close, command }
        HostServices {
            size, context, log, progress_begin, progress_advance, progress_end, is_cancelled, file_open, file_append,
            file_commit, file_abort, simulate, tell, port,
        }
        Data { size, port, context, description_json, layer_plane, emission_plane, view_plane, weight_plane }
        Plane { size, data, dtype, ndim, shape, strides, owner, release }
        Time { size, index, seconds } View { size, kind, value }
        ByteSink { size, context, write } Assets { size, context, read } ImporterVtable { size, extensions, import }
        FieldSink { size, context, geometry, view_plane } SourceVtable { size, make }
        StackSink { size, context, brightness, layer_plane, emission_plane, step, solution } NodeVtable { size, make }
    );
    for (name, value) in [
        ("ABI_MAJOR", abi::ABI_MAJOR),
        ("ABI_MINOR", abi::ABI_MINOR),
        ("KIND_OUTPUT", abi::kind::OUTPUT),
        ("KIND_IMPORTER", abi::kind::IMPORTER),
        ("PORT_LAYER_STACK", abi::port::LAYER_STACK),
        ("PORT_FILE", abi::port::FILE),
        ("DTYPE_F32", abi::dtype::F32),
        ("VIEW_EYE", abi::view::EYE),
        ("LEVEL_DEBUG", abi::level::DEBUG),
        ("STATUS_PANICKED", abi::Status::PANICKED.0 as u32),
    ] {
        writeln!(text, "_Static_assert(LUMISTACK_{name} == {value}, \"{name}\");").unwrap();
    }
    assert!(text.lines().count() > 100, "{text}");
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("layout.c");
    fs::write(&source, &text).unwrap();
    let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I"]).arg(crate_folder().join("include"));
    assert!(cc.arg(&source).status().expect("a C compiler").success(), "{text}");
}
