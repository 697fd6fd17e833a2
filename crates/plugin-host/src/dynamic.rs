//! Plugins in shared libraries.
//!
//! A library file is named `lumistack_plugin_<name>`, with the system's prefix and suffix. It
//! exports a function `lumistack_plugin_entry_<id>` per plugin. The host reads the name, the file
//! kind, the machine and the exports without running the library's code. The first use of a plugin
//! loads its library in a child process (see [`crate::child`]). The child never unloads the
//! library, since threads, thread-local destructors and borrowed texts of the library may outlive
//! every call.

use std::env::consts::{ARCH, DLL_PREFIX, DLL_SUFFIX};
use std::env::{split_paths, var_os};
use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::serve::Plugin;
use libloading::Library as Shared;
use lumistack_plugin::abi::{ENTRY_PREFIX, Entry};
use lumistack_plugin::is_plugin_id;
use object::{Architecture, BinaryFormat, FileKind, Object, ObjectKind, ReadCache};

use crate::child::{Launcher, Limits};
use crate::registry::Library;
use crate::{LoadError, Origin, Registry};

/// Environment variable that adds search paths, separated as in `PATH`.
const VARIABLE: &str = "LUMISTACK_PLUGIN_PATH";
/// Format of this system's libraries.
const FORMAT: BinaryFormat = if cfg!(windows) {
    BinaryFormat::Pe
} else if cfg!(target_vendor = "apple") {
    BinaryFormat::MachO
} else {
    BinaryFormat::Elf
};
/// Part of a library's file name between the system's prefix and `<name>`.
const STEM: &str = "lumistack_plugin_";

/// Search paths for plugins: first `named`, then `user`. If several plugins have one id, the first
/// is kept.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PluginPaths {
    /// Files and folders named explicitly, which must exist.
    pub named: Vec<PathBuf>,
    /// The user's plugin folder, which may be missing.
    pub user: Option<PathBuf>,
    /// Launcher of plugin processes; `None` selects the launcher of [`Launcher::set_for_process`].
    pub launcher: Option<Launcher>,
    /// Time limits of plugins; `None` reads the limits from the environment, see [`Limits`].
    pub limits: Option<Limits>,
}

impl PluginPaths {
    /// Returns the search paths in order. The paths `given` on the command line come first, then
    /// the paths in the environment variable `LUMISTACK_PLUGIN_PATH`. The folder
    /// `lumistack/plugins` in the user's data folder is the last.
    pub fn of_system(given: &[PathBuf]) -> Self {
        Self::of(given, var_os(VARIABLE), user_data())
    }

    fn of(given: &[PathBuf], variable: Option<OsString>, user_data: Option<PathBuf>) -> Self {
        let variable = variable.unwrap_or_default();
        let of_variable = split_paths(&variable).filter(|path| !path.as_os_str().is_empty());
        Self {
            named: given.iter().cloned().chain(of_variable).collect(),
            user: user_data.map(|folder| folder.join("lumistack").join("plugins")),
            ..Self::default()
        }
    }
}

/// Returns the system's folder for user data of programs. Returns `None` if the environment does
/// not name this folder by an absolute path.
fn user_data() -> Option<PathBuf> {
    let folder = |name: &str| var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    if cfg!(windows) {
        folder("APPDATA")
    } else if cfg!(target_os = "macos") {
        Some(folder("HOME")?.join("Library/Application Support"))
    } else {
        folder("XDG_DATA_HOME").or_else(|| Some(folder("HOME")?.join(".local/share")))
    }
}

impl Registry {
    /// Adds all plugins in these paths. [`Registry::failed`] lists the errors, for example of a
    /// file that is no plugin library.
    ///
    /// This function runs no library code: the first use of a plugin loads its library, in a child
    /// process.
    pub fn load(&mut self, paths: &PluginPaths) {
        let limits = paths.limits.map_or_else(Limits::of_system, Ok).unwrap_or_else(|(variable, found)| {
            self.failed.push(LoadError::Setting { variable, found });
            Limits::default()
        });
        let launcher = paths.launcher.clone().or_else(Launcher::of_process);
        let user = paths.user.iter().filter(|folder| folder.exists());
        let mut seen = Vec::new();
        for place in paths.named.iter().chain(user) {
            let files = match libraries(place) {
                Ok(files) => files,
                Err(source) => {
                    self.failed.push(LoadError::Read { path: place.clone(), source });
                    continue;
                }
            };
            // the user's own folder may be empty
            if files.is_empty() && paths.named.contains(place) {
                self.failed.push(LoadError::NoLibraries { path: place.clone(), expected: file_name("*") });
            }
            for file in files {
                // add a file once, even if two paths lead to it
                let real = fs::canonicalize(&file).unwrap_or_else(|_| file.clone());
                if !seen.contains(&real) {
                    seen.push(real);
                    self.add_library(&file, launcher.clone(), limits);
                }
            }
        }
    }

    fn add_library(&mut self, path: &Path, launcher: Option<Launcher>, limits: Limits) {
        let ids = match name_of(path).and_then(|name| ids_of(path, name)) {
            Ok(ids) => ids,
            Err(error) => return self.failed.push(error),
        };
        for id in ids {
            match self.origin(&id).cloned() {
                Some(first) => self.failed.push(LoadError::Duplicate { path: path.into(), id, first }),
                None => self.libraries.push(Library::new(id, Origin::Library(path.into()), launcher.clone(), limits)),
            }
        }
    }
}

/// Returns `place` if it is no folder. If it is a folder, returns the paths in it that are named
/// like plugin libraries, sorted.
fn libraries(place: &Path) -> std::io::Result<Vec<PathBuf>> {
    if !fs::metadata(place)?.is_dir() {
        return Ok(vec![place.into()]);
    }
    let mut files = Vec::new();
    for entry in fs::read_dir(place)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with(&format!("{DLL_PREFIX}{STEM}")) && name.ends_with(DLL_SUFFIX) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Returns the file name of the plugin library `name`.
fn file_name(name: &str) -> String {
    format!("{DLL_PREFIX}{STEM}{name}{DLL_SUFFIX}")
}

/// Returns `<name>` from the file name `lumistack_plugin_<name>` of a library.
fn name_of(path: &Path) -> Result<String, LoadError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let own = name
        .strip_prefix(DLL_PREFIX)
        .and_then(|name| name.strip_prefix(STEM))
        .and_then(|name| name.strip_suffix(DLL_SUFFIX))
        .filter(|own| is_plugin_id(own));
    own.map(String::from).ok_or_else(|| LoadError::Name { path: path.into(), expected: file_name("NAME") })
}

/// Opens a library in this process and returns the plugin `id`. `path` is absolute, since the
/// loader searches other folders for a bare name.
pub(crate) fn open(path: &Path, id: &str) -> Result<Plugin, LoadError> {
    // SAFETY: the user named this plugin to be run; initializers of plugin libraries have no
    // preconditions.
    let library = unsafe { Shared::new(path) }
        .map_err(|error| LoadError::Open { path: path.into(), reason: loader_message(&error) })?;
    // The library is never unloaded, not even after an error.
    let library: &'static Shared = Box::leak(Box::new(library));
    let symbol = format!("{ENTRY_PREFIX}{id}");
    // SAFETY: a function of this name is a plugin's entry, by the convention of the interface.
    let entry = unsafe { library.get::<Entry>(symbol.as_bytes()) }
        .map_err(|_| LoadError::NoEntry { path: path.into(), symbol: symbol.clone() })?;
    // SAFETY: the entry function returns null or a descriptor that lives as long as the library,
    // which is never unloaded.
    let plugin = unsafe { Plugin::from_descriptor(entry()) }
        .map_err(|reason| LoadError::Descriptor { path: path.into(), reason })?;
    let found = &plugin.info().id;
    if *found == id {
        Ok(plugin)
    } else {
        Err(LoadError::OtherId { path: path.into(), expected: id.into(), found: found.clone() })
    }
}

/// Returns the system's error message, without the text that libloading adds.
fn loader_message(error: &libloading::Error) -> String {
    std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string)
}

/// Returns the ids of the plugins that a file exports. Fails if the file is no shared library for
/// this machine, or exports no plugin. For some files of other kinds, system loaders report "no
/// such file". Therefore this function checks the kind itself.
fn ids_of(path: &Path, name: String) -> Result<Vec<String>, LoadError> {
    let read = |source| LoadError::Read { path: path.into(), source };
    let other = |found: String| LoadError::NotALibrary { path: path.into(), found };
    // check for a folder first, since Windows cannot open a folder as a file
    if fs::metadata(path).map_err(read)?.is_dir() {
        return Err(other("a folder".into()));
    }
    let file = File::open(path).map_err(read)?;
    let data = ReadCache::new(file);
    match FileKind::parse(&data) {
        // A fat Mach-O file contains one library per machine, and the loader selects one of them.
        // The exports are not read. The file is listed as one plugin, whose id is `<name>` in the
        // file's name `lumistack_plugin_<name>`.
        Ok(FileKind::MachOFat32 | FileKind::MachOFat64) => return Ok(vec![name]),
        Ok(_) => {}
        Err(_) => return Err(other("a file of another kind".into())),
    }
    let library = match object::File::parse(&data) {
        Ok(library) => library,
        Err(error) => return Err(other(format!("a damaged library: {error}"))),
    };
    // The file must be a shared library for this system and this processor.
    let (format, machine) = (library.format(), library.architecture());
    if format != FORMAT || native().is_some_and(|native| native != machine) {
        let found = format!("{machine:?} ({format:?})").to_lowercase();
        let expected = format!("{ARCH} ({FORMAT:?})").to_lowercase();
        return Err(LoadError::Machine { path: path.into(), expected, found });
    }
    let kind = library.kind();
    if kind != ObjectKind::Dynamic {
        return Err(other("an object file of another kind".into()));
    }
    // The names of the exported entry functions end with the ids.
    let exports = library.exports().map_err(|error| other(format!("a damaged library: {error}")))?;
    let names = exports.iter().filter_map(|export| std::str::from_utf8(export.name()).ok());
    // Mach-O prefixes C symbols with an underscore
    let ids = names.filter_map(|name| name.strip_prefix('_').unwrap_or(name).strip_prefix(ENTRY_PREFIX));
    let mut ids: Vec<String> = ids.filter(|id| is_plugin_id(id)).map(String::from).collect();
    ids.sort_unstable();
    if ids.is_empty() {
        return Err(LoadError::NoEntry { path: path.into(), symbol: format!("{ENTRY_PREFIX}{name}") });
    }
    Ok(ids)
}

/// Returns this machine's architecture in object files; `None` for a machine that this function
/// does not list.
fn native() -> Option<Architecture> {
    Some(match ARCH {
        "x86_64" => Architecture::X86_64,
        "x86" => Architecture::I386,
        "aarch64" => Architecture::Aarch64,
        "arm" => Architecture::Arm,
        "riscv64" => Architecture::Riscv64,
        "loongarch64" => Architecture::LoongArch64,
        "powerpc64" => Architecture::PowerPc64,
        "s390x" => Architecture::S390x,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_goes_before_the_environment_and_that_before_the_user_s_folder() {
        let given = [PathBuf::from("/a"), PathBuf::from("b")];
        let variable = std::env::join_paths(["/c", "", "/d"]).unwrap();
        let paths = PluginPaths::of(&given, Some(variable), Some("/home/u/data".into()));
        assert_eq!(paths.named, ["/a", "b", "/c", "/d"].map(PathBuf::from));
        assert_eq!(paths.user, Some("/home/u/data/lumistack/plugins".into()));
        assert_eq!(PluginPaths::of(&[], None, None), PluginPaths::default());
    }

    #[test]
    fn this_machine_has_a_name() {
        let this = File::open(std::env::current_exe().unwrap()).unwrap();
        let this = ReadCache::new(this);
        let this = object::File::parse(&this).unwrap();
        assert_eq!(Some(this.architecture()), native());
        assert_eq!(this.format(), FORMAT);
    }
}
