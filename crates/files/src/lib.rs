//! Reads files that the user or another file names.
//!
//! A name may stand for anything: a device that never ends, a pipe without a writer, a file of
//! terabytes, a secret in another folder. This crate opens only regular files. Before it reads a
//! whole file, it compares the file's size with a limit. A file may contain names of other files. A
//! [`Folder`] can refuse names that lead out of the file's folder. Readers of input files use this
//! crate.
//!
//! A web page has no file system. Files that were dropped on the page are held in memory (`hold`),
//! and the same readers read them.

#[cfg(not(target_arch = "wasm32"))]
mod disk;
#[cfg(target_arch = "wasm32")]
mod memory;

use std::fmt;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

#[cfg(not(target_arch = "wasm32"))]
use disk as system;
#[cfg(target_arch = "wasm32")]
use memory as system;

#[cfg(target_arch = "wasm32")]
pub use memory::hold;
pub use system::File;

/// Largest file that is read whole, bytes: 16 GiB.
pub const MAX_FILE_BYTES: u64 = 16 << 30;
/// Size of the largest text (job, display, index) that is read whole, bytes: 64 MiB.
pub const MAX_TEXT_BYTES: u64 = 64 << 20;

/// Opens a regular file for reading.
///
/// # Errors
/// The errors of [`std::fs::File::open`]. Also if the path leads to anything but a regular file.
pub fn open(path: &Path) -> io::Result<File> {
    system::open(path)
}

/// Returns the length of an open file, bytes.
///
/// # Errors
/// If the operating system cannot return the length.
pub fn length(file: &File) -> io::Result<u64> {
    system::length(file)
}

/// Returns true if the path leads to a regular file.
pub fn is_file(path: &Path) -> bool {
    system::is_file(path)
}

/// Returns true if the path leads to a folder, false if it leads to a file.
///
/// # Errors
/// If no file or folder has this path.
pub fn is_folder(path: &Path) -> io::Result<bool> {
    system::is_folder(path)
}

/// Returns the paths of all entries of a folder, sorted.
///
/// # Errors
/// If the folder cannot be listed.
pub fn list(folder: &Path) -> io::Result<Vec<PathBuf>> {
    system::list(folder)
}

/// Reads a regular file of at most [`MAX_FILE_BYTES`].
///
/// # Errors
/// The errors of [`read_at_most`].
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    read_at_most(path, MAX_FILE_BYTES)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// The errors of [`open`]. Also if the file is larger than `most`, cannot be read, or does not fit
/// in memory.
pub fn read_at_most(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let length = length(&file)?;
    let too_large = |length: u64| {
        let message = format!("expected a file of at most {most} bytes, found {length}");
        io::Error::new(ErrorKind::FileTooLarge, message)
    };
    if length > most {
        return Err(too_large(length));
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(length).map_err(|_| too_large(length))?)?;
    // limit the read too: files of the system, as in /proc, state no length, and other files may
    // grow
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_large(bytes.len() as u64)) } else { Ok(bytes) }
}

/// Reads a regular UTF-8 file of at most [`MAX_TEXT_BYTES`].
///
/// # Errors
/// The errors of [`read_at_most`], and if the content is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read_at_most(path, MAX_TEXT_BYTES)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        io::Error::new(ErrorKind::InvalidData, format!("expected UTF-8 text, found an invalid byte at position {at}"))
    })
}

/// The folder of a file, in which the names that the file contains are looked up.
#[derive(Clone, Debug)]
pub struct Folder {
    base: PathBuf,
    /// Folders that names may not leave, with all links resolved: the file's folder, and the folder
    /// of the target if the file is a link. Empty if names may lead anywhere.
    inside: Vec<PathBuf>,
}

/// The reason why a name cannot be resolved to a file.
#[derive(Debug)]
pub enum Refusal {
    /// The operating system refused, or the name does not lead to a regular file.
    Io(io::Error),
    /// The name leads out of the folder that it may not leave.
    Outside {
        /// The path that the name leads to, with all links resolved.
        found: PathBuf,
        /// The folder that the name may not leave.
        folder: PathBuf,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::Outside { found, folder } => {
                write!(f, "the path leads to {}, outside of the folder {}", found.display(), folder.display())
            }
        }
    }
}

impl std::error::Error for Refusal {}

impl From<io::Error> for Refusal {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl Folder {
    /// Returns the folder of `file`. Names in the file may lead out of this folder.
    pub fn anywhere(file: &Path) -> Self {
        Self { base: file.parent().unwrap_or(Path::new("")).to_owned(), inside: Vec::new() }
    }

    /// Returns the folder of `file`. Names in the file may not lead out of this folder, neither by
    /// `..` nor by a link. If the file is a link, names may also lead into the folder of its
    /// target.
    ///
    /// # Errors
    /// If the file does not exist.
    pub fn around(file: &Path) -> io::Result<Self> {
        let anywhere = Self::anywhere(file);
        let here = if anywhere.base.as_os_str().is_empty() { Path::new(".") } else { &anywhere.base };
        let mut inside = vec![system::canonical(here)?];
        if let Some(target) = system::canonical(file)?.parent()
            && !inside.iter().any(|folder| target.starts_with(folder))
        {
            inside.push(target.to_owned());
        }
        Ok(Self { inside, ..anywhere })
    }

    /// Returns the path to which a name leads. The path may be outside of the folder.
    pub fn path_of(&self, name: impl AsRef<Path>) -> PathBuf {
        self.base.join(name)
    }

    /// Returns the path to which a name leads. If names may not lead out of the folder, checks that
    /// the path is inside it.
    ///
    /// # Errors
    /// If names may not lead out of the folder, and the name leads out of it or to no file.
    pub fn resolve(&self, name: impl AsRef<Path>) -> Result<PathBuf, Refusal> {
        let path = self.path_of(name);
        if let Some(folder) = self.inside.first() {
            let found = system::canonical(&path)?;
            if !self.inside.iter().any(|folder| found.starts_with(folder)) {
                return Err(Refusal::Outside { found, folder: folder.clone() });
            }
        }
        Ok(path)
    }

    /// Reads the regular file of a name, if it has at most `most` bytes.
    ///
    /// # Errors
    /// The errors of [`resolve`](Self::resolve) and [`read_at_most`].
    pub fn read(&self, name: impl AsRef<Path>, most: u64) -> Result<Vec<u8>, Refusal> {
        Ok(read_at_most(&self.resolve(name)?, most)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_within_the_limit_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, b"12345").unwrap();
        assert_eq!(read(&path).unwrap(), b"12345");
        assert_eq!(read_at_most(&path, 5).unwrap(), b"12345");
        let error = read_at_most(&path, 4).unwrap_err().to_string();
        assert_eq!(error, "expected a file of at most 4 bytes, found 5");
        let error = read(folder.path()).unwrap_err().to_string();
        assert_eq!(error, "expected a regular file, found a folder");
        std::fs::write(&path, b"a\xE9").unwrap();
        let error = read_text(&path).unwrap_err().to_string();
        assert_eq!(error, "expected UTF-8 text, found an invalid byte at position 1");
    }

    /// Without the check before the file is opened, the pipe would block this test for ever, and
    /// the device would fill memory.
    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_are_refused_at_once() {
        let error = read(Path::new("/dev/zero")).unwrap_err().to_string();
        assert_eq!(error, "expected a regular file, found a device");
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        if std::process::Command::new("mkfifo").arg(&pipe).status().is_ok_and(|status| status.success()) {
            assert_eq!(open(&pipe).unwrap_err().to_string(), "expected a regular file, found a pipe");
        }
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert_eq!(open(&socket).unwrap_err().to_string(), "expected a regular file, found a socket");
    }

    /// The limit also holds for a file that states no length.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_of_the_system_that_states_no_length_is_cut_off() {
        let path = Path::new("/proc/self/maps");
        assert_eq!(std::fs::metadata(path).unwrap().len(), 0);
        assert!(read_at_most(path, 16).unwrap_err().to_string().starts_with("expected a file of at most 16 bytes"));
    }

    #[cfg(unix)]
    #[test]
    fn names_do_not_leave_the_folder() {
        use std::os::unix::fs::symlink;

        let outer = tempfile::tempdir().unwrap();
        let root = outer.path().join("scene");
        std::fs::create_dir_all(root.join("textures")).unwrap();
        for name in ["secret", "scene/a.gltf", "scene/textures/b.png"] {
            std::fs::write(outer.path().join(name), b"x").unwrap();
        }
        symlink(outer.path().join("secret"), root.join("link.png")).unwrap();
        symlink(root.join("textures/b.png"), root.join("inner.png")).unwrap();
        let scene = root.join("a.gltf");
        let folder = Folder::around(&scene).unwrap();
        for name in ["textures/b.png", "textures/../a.gltf", "./textures/b.png", "inner.png"] {
            assert_eq!(folder.read(name, 1).unwrap(), b"x", "{name}");
        }
        let absolute = outer.path().join("secret");
        for name in ["../secret", "link.png", "textures/../../secret", absolute.to_str().unwrap()] {
            let refusal = folder.read(name, 1).unwrap_err();
            assert!(matches!(refusal, Refusal::Outside { .. }), "{name}: {refusal}");
            assert_eq!(Folder::anywhere(&scene).read(name, 1).unwrap(), b"x", "{name}");
        }
        assert!(matches!(folder.read("none.png", 1).unwrap_err(), Refusal::Io(_)));
        // the scene may itself be a link into the folder with its textures
        symlink(&scene, outer.path().join("alias.gltf")).unwrap();
        let folder = Folder::around(&outer.path().join("alias.gltf")).unwrap();
        assert!(folder.resolve(absolute).is_ok() && folder.resolve(root.join("textures/b.png")).is_ok());
    }

    /// Windows has two separators, drives, and devices that are in every folder. `CON` would wait
    /// for input for ever.
    #[cfg(windows)]
    #[test]
    fn names_of_windows_do_not_leave_the_folder() {
        let outer = tempfile::tempdir().unwrap();
        let root = outer.path().join("scene");
        std::fs::create_dir_all(root.join("textures")).unwrap();
        for name in ["secret", "scene/a.gltf", "scene/textures/b.png"] {
            std::fs::write(outer.path().join(name), b"x").unwrap();
        }
        let scene = root.join("a.gltf");
        let folder = Folder::around(&scene).unwrap();
        for name in [r"textures\b.png", r"textures\..\a.gltf", r".\textures/b.png", "TEXTURES/B.PNG"] {
            assert_eq!(folder.read(name, 1).unwrap(), b"x", "{name}");
        }
        let absolute = outer.path().join("secret").canonicalize().unwrap();
        let verbatim = absolute.to_str().unwrap();
        let plain = verbatim.strip_prefix(r"\\?\").unwrap();
        for name in [r"..\secret", r"textures\..\..\secret", r"textures/..\../secret", verbatim, plain, &plain[2..]] {
            let refusal = folder.read(name, 1).unwrap_err();
            assert!(matches!(refusal, Refusal::Outside { .. }), "{name}: {refusal}");
            assert_eq!(Folder::anywhere(&scene).read(name, 1).unwrap(), b"x", "{name}");
        }
        for name in ["NUL", "nul", "CON", "COM1", r"\\.\NUL", r"\\.\CON", r"textures\NUL", "C:"] {
            for folder in [&folder, &Folder::anywhere(&scene)] {
                let refusal = folder.read(name, 1).expect_err(name);
                println!("{name}: {refusal}");
            }
        }
    }
}
