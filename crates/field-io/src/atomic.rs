//! Writes files so that they are complete or absent. A file is written in the target's folder under
//! another name, flushed to disk, then renamed to the target.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::time::Duration;

use crate::FieldError;

/// Prefix and suffix of the names of temporary files.
const PREFIX: &str = ".lumistack-";
const SUFFIX: &str = ".tmp";

/// The writer that `fill` of [`fn@write`] receives: buffered and seekable.
pub type Writer<'a> = BufWriter<&'a mut File>;

/// Writes a file through `fill`. If `fill` or the disk fails, the target stays unchanged and no
/// temporary file remains.
///
/// # Errors
/// If the folder does not exist, the target is a folder, or writing fails.
pub fn write(path: &Path, fill: impl FnOnce(&mut Writer<'_>) -> io::Result<()>) -> Result<(), FieldError> {
    let error = FieldError::io(path, "write");
    replace(path, fill).map_err(error)
}

/// Writes a file from bytes.
///
/// # Errors
/// As [`fn@write`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), FieldError> {
    write(path, |writer| writer.write_all(bytes))
}

/// Creates an output folder and its parents.
///
/// # Errors
/// If the path or one of its parents is a file (the message names it), or the folder cannot be
/// created.
pub fn create_folder(path: &Path) -> Result<(), FieldError> {
    for part in path.ancestors() {
        match fs::metadata(part) {
            Ok(found) if found.is_dir() => break,
            Ok(_) => return Err(FieldError::malformed(part, "output folder", "a folder or nothing", "a file")),
            Err(_) => {}
        }
    }
    fs::create_dir_all(path).map_err(FieldError::io(path, "make the folder"))
}

/// Removes a file that may be absent. Callers remove an index before they change the files that it
/// lists. So an index never lists half-written files.
///
/// # Errors
/// If the file exists and cannot be removed.
pub(crate) fn remove(path: &Path) -> Result<(), FieldError> {
    if set_aside(path).is_ok() {
        return Ok(());
    }
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(FieldError::io(path, "remove")(error)),
        _ => Ok(()),
    }
}

/// Gives a file the name of a temporary file, and removes it as soon as the system permits.
///
/// While a program has mapped a file into memory (see [`mapped`](crate::mapped)), Windows may
/// refuse to replace the file. If such a file is removed, Windows keeps its name in use. But
/// Windows can rename the file, and the program keeps the values that it has mapped. A later run
/// removes the renamed file, which has no writer (see [`is_abandoned`]).
///
/// # Errors
/// If the file is protected from writing, or the system refuses. On systems other than Windows,
/// this function always fails, since they have no such restriction.
fn set_aside(path: &Path) -> io::Result<()> {
    if !cfg!(windows) || fs::metadata(path)?.permissions().readonly() {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    rename_aside(path)
}

fn rename_aside(path: &Path) -> io::Result<()> {
    let aside = temporary_beside(folder_of(path))?.into_temp_path();
    fs::rename(path, &aside)?;
    let aside = aside.keep()?;
    let _ = fs::remove_file(aside);
    Ok(())
}

/// Returns the folder of a file, `.` for a bare name.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn replace(path: &Path, fill: impl FnOnce(&mut Writer<'_>) -> io::Result<()>) -> io::Result<()> {
    if path.is_dir() {
        return Err(io::Error::new(io::ErrorKind::IsADirectory, "a folder has the name of the file"));
    }
    let mut beside = temporary_beside(folder_of(path))?;
    // The lock shows other processes that the writer is alive; see [`is_abandoned`]. On a file
    // system without locks, no file is regarded as abandoned.
    let _ = beside.as_file().try_lock();
    {
        let mut writer = BufWriter::with_capacity(1 << 16, beside.as_file_mut());
        fill(&mut writer)?;
        writer.flush()?;
    }
    publish(beside, path)
}

/// Flushes a temporary file to disk and renames it to `path`.
pub(crate) fn publish(beside: tempfile::NamedTempFile, path: &Path) -> io::Result<()> {
    beside.as_file().sync_all()?;
    if let Err(refused) = beside.persist(path) {
        set_aside(path).map_err(|_| refused.error)?;
        refused.file.persist(path).map_err(|error| error.error)?;
    }
    sync_folder(folder_of(path));
    Ok(())
}

/// Age below which a temporary file may have a writer that has not locked it yet.
const YOUNG: Duration = Duration::from_secs(2);

/// Returns true for a temporary file without a writer: the writer was killed or stopped, or the
/// file was set aside. Returns false in the first two seconds after the file's last change.
pub fn is_abandoned(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if !(name.starts_with(PREFIX) && name.ends_with(SUFFIX)) {
        return false;
    }
    let age = fs::symlink_metadata(path).ok().filter(|data| data.is_file()).and_then(|data| data.modified().ok());
    let is_old = age.and_then(|time| time.elapsed().ok()).is_some_and(|age| age >= YOUNG);
    is_old && File::options().write(true).open(path).is_ok_and(|file| file.try_lock().is_ok())
}

/// Creates a temporary file like the temporary files of [`fn@write`], for callers that write it
/// step by step.
pub(crate) fn temporary_beside(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    // by default only the user can read a temporary file; give it the permissions of other files,
    // since it becomes a result
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

/// Writes a folder's entries to disk, so that a rename in this folder survives a power failure.
/// Failure is not an error, since the renamed file itself is on disk.
fn sync_folder(folder: &Path) {
    if cfg!(unix)
        && let Ok(folder) = File::open(folder)
    {
        folder.sync_all().ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_writer_that_fails_midway_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_bytes(&path, b"old").unwrap();
        let error = write(&path, |writer| {
            writer.write_all(&[0; 100_000])?;
            Err(io::Error::other("disk full"))
        })
        .unwrap_err();
        assert!(error.to_string().ends_with("a.bin: cannot write: disk full"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn a_file_in_the_way_of_a_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("out");
        write_bytes(&file, b"x").unwrap();
        for path in [file.clone(), file.join("layers/deeper")] {
            let error = create_folder(&path).unwrap_err().to_string();
            assert!(error.ends_with("out: output folder: expected a folder or nothing, found a file"), "{error}");
        }
        let error = write_bytes(folder.path(), b"x").unwrap_err().to_string();
        assert!(error.contains("a folder has the name of the file"), "{error}");
        assert_eq!(names(folder.path()), ["out"]);
        create_folder(&folder.path().join("new/deeper")).unwrap();
    }

    #[test]
    fn only_files_without_a_writer_are_abandoned() {
        let folder = tempfile::tempdir().unwrap();
        let age = |path: &Path| {
            let file = File::options().write(true).open(path).unwrap();
            file.set_modified(std::time::SystemTime::now() - Duration::from_secs(60)).unwrap();
        };
        let left = folder.path().join(".lumistack-a1b2c3.tmp");
        fs::write(&left, "half").unwrap();
        assert!(!is_abandoned(&left), "a file this young may have a writer");
        age(&left);
        assert!(is_abandoned(&left));
        let other = folder.path().join("a.tmp");
        fs::write(&other, "mine").unwrap();
        age(&other);
        assert!(!is_abandoned(&other) && !is_abandoned(&folder.path().join(".lumistack-none.tmp")));
        fs::remove_file(&left).unwrap();
        write(&folder.path().join("a.bin"), |_| {
            let name = names(folder.path()).into_iter().find(|name| name.starts_with(PREFIX)).unwrap();
            let path = folder.path().join(name);
            age(&path);
            assert!(!is_abandoned(&path), "the file is being written");
            Ok(())
        })
        .unwrap();
    }

    #[test]
    fn a_file_that_is_set_aside_makes_room() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_bytes(&path, b"old").unwrap();
        rename_aside(&path).unwrap();
        assert!(names(folder.path()).is_empty(), "no program has mapped the file");
        assert!(rename_aside(&path).is_err() && names(folder.path()).is_empty(), "there is no file");
        // `set_aside` fails on other systems than Windows, and for a file that is protected from
        // writing
        write_bytes(&path, b"old").unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).unwrap();
        assert!(set_aside(&path).is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        #[cfg(windows)]
        {
            assert!(write_bytes(&path, b"new").unwrap_err().to_string().contains("a.bin: cannot write"));
            let mut permissions = fs::metadata(&path).unwrap().permissions();
            #[expect(clippy::permissions_set_readonly_false, reason = "Windows has no other permissions")]
            permissions.set_readonly(false);
            fs::set_permissions(&path, permissions).unwrap();
        }
    }

    #[cfg(unix)]
    #[test]
    fn results_are_readable_by_others() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_bytes(&path, b"x").unwrap();
        fs::write(folder.path().join("plain"), b"x").unwrap();
        let mode = |name: &str| fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("a.bin"), mode("plain"));
    }
}
