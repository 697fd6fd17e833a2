//! Scenes that Blender converted, cached between runs.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_usd::{BlendAccount, BlendContents, HandedOver};
use serde::{Deserialize, Serialize};

use super::code;
use super::files::{read_json, write, write_json};
use super::key::{KeyBuilder, hash};
use crate::error::PipelineError;

/// Record of a cached conversion. `files` are the files that it was made from, each with a hash of
/// its content.
#[derive(Serialize, Deserialize)]
struct CachedConversion {
    account: BlendAccount,
    files: Vec<(PathBuf, String)>,
    program: Option<[u64; 2]>,
    glb: String,
    /// Fingerprint of the code that requests and reads the conversion. A version with other code
    /// does not reuse the conversion.
    code: String,
}

fn code_of_scenes() -> String {
    KeyBuilder::new("scenes", code::SCENE).finish()
}

/// Returns true if a run would reuse a cached conversion. `path` is a file of the conversion,
/// `blend-KEY.json` or `blend-KEY.glb`.
pub(crate) fn holds(path: &Path) -> bool {
    read_json::<CachedConversion>(&path.with_extension("json")).is_some_and(|kept| kept.holds())
}

impl CachedConversion {
    /// Returns true if Blender would return the same scene again.
    fn holds(&self) -> bool {
        self.code == code_of_scenes()
            && self.program.is_some()
            && self.program == lumistack_usd::file_stamp(&self.account.program)
            && self.account.missing.iter().all(|path| !path.exists())
            && self.files.iter().all(|(path, content)| content_of(path).as_ref() == Some(content))
    }
}

fn content_of(path: &Path) -> Option<String> {
    lumistack_files::read(path).ok().map(|bytes| hash(&bytes))
}

/// Converts the scene of a `.blend` file at the time `time_s`, seconds. With a cache folder, a
/// conversion is reused until the file, its references, Blender, or our code changes.
/// A conversion with inputs that cannot be checked is not cached.
///
/// # Errors
/// If Blender returns no scene, or the cache cannot be written.
pub(crate) fn hand_over(
    path: &Path,
    time_s: Option<f64>,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<HandedOver, PipelineError> {
    let convert = || lumistack_usd::hand_over(path, time_s, task).map_err(PipelineError::from);
    let handed = match cache_dir {
        Some(folder) => kept_or(convert, path, time_s, &lumistack_usd::blend_surroundings(), folder)?,
        None => convert()?,
    };
    handed.account.warnings.iter().for_each(|(place, text)| task.warn(place, text));
    Ok(handed)
}

/// Returns the contents of a `.blend` file from its cached conversion, without running Blender;
/// `None` if no valid conversion is cached.
pub(crate) fn known(path: &Path, time_s: Option<f64>, folder: &Path) -> Option<BlendContents> {
    let [stamp, _] = cached_files(path, time_s, &lumistack_usd::blend_surroundings(), folder);
    let kept = read_json::<CachedConversion>(&stamp).filter(CachedConversion::holds)?;
    Some(kept.account.contents)
}

/// Returns the files of a cached conversion: its record and the scene.
fn cached_files(path: &Path, time_s: Option<f64>, surroundings: &str, folder: &Path) -> [PathBuf; 2] {
    // The key contains the file's path, the time, and a text that identifies Blender and our script
    // in Blender.
    let mut key = KeyBuilder::new("blend", code::SCENE);
    let place = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    key.add("path", place.as_os_str().as_encoded_bytes()).add_json("time", &time_s);
    let key = key.add("surroundings", surroundings.as_bytes()).finish();
    ["json", "glb"].map(|kind| folder.join(format!("blend-{}.{kind}", &key[..16])))
}

fn kept_or(
    convert: impl FnOnce() -> Result<HandedOver, PipelineError>,
    path: &Path,
    time_s: Option<f64>,
    surroundings: &str,
    folder: &Path,
) -> Result<HandedOver, PipelineError> {
    let place = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let [stamp, file] = cached_files(path, time_s, surroundings, folder);
    if let Some(kept) = read_json::<CachedConversion>(&stamp).filter(CachedConversion::holds)
        && let Ok(glb) = std::fs::read(&file)
        && hash(&glb) == kept.glb
    {
        return Ok(HandedOver { glb, account: kept.account });
    }
    // If no valid conversion is cached, run Blender.
    let before = content_of(&place);
    let handed = convert()?;
    let HandedOver { glb, account } = &handed;
    let all = [std::slice::from_ref(&place), &account.files[..]].concat();
    let files: Option<Vec<_>> = all.into_iter().map(|path| Some((path.clone(), content_of(&path)?))).collect();
    // Do not cache the result if an input cannot be read or cannot be checked, or if the `.blend`
    // file changed during the conversion.
    if let Some(files) = files.filter(|files| account.untracked.is_none() && Some(&files[0].1) == before.as_ref()) {
        let program = lumistack_usd::file_stamp(&account.program);
        let kept =
            CachedConversion { account: account.clone(), files, program, glb: hash(glb), code: code_of_scenes() };
        std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
        write(&file, glb)?;
        write_json(&stamp, &kept)?;
    }
    Ok(handed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the number of times that Blender runs for two conversions, between which `between`
    /// changes files.
    fn conversions(untracked: Option<String>, between: impl FnOnce(&Path)) -> usize {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["szene.blend", "wood.png", "blender"] {
            std::fs::write(place(name), name).unwrap();
        }
        let account = BlendAccount {
            program: place("blender"),
            files: vec![place("wood.png")],
            missing: vec![place("gone.png")],
            untracked,
            ..BlendAccount::default()
        };
        let mut count = 0;
        let mut hand_over = |time_s, surroundings: &str| {
            let convert = || {
                count += 1;
                Ok(HandedOver { glb: format!("{time_s:?}").into_bytes(), account: account.clone() })
            };
            kept_or(convert, &place("szene.blend"), time_s, surroundings, &place("cache")).unwrap()
        };
        let first = hand_over(Some(0.5), "one");
        between(folder.path());
        let second = hand_over(Some(0.5), "one");
        assert_eq!((first.glb, first.account), (second.glb, second.account));
        // Another time, or another version of Blender, gives another conversion.
        let (late, other) = (hand_over(Some(1.0), "one"), hand_over(Some(0.5), "two"));
        assert_eq!((late.glb, other.glb), (b"Some(1.0)".to_vec(), b"Some(0.5)".to_vec()));
        count - 2
    }

    #[test]
    fn blender_is_asked_again_when_something_has_changed() {
        let write =
            |name: &'static str| move |folder: &Path| std::fs::write(folder.join(name), "another content").unwrap();
        assert_eq!(conversions(None, |_| ()), 1);
        for name in ["szene.blend", "wood.png", "blender", "gone.png"] {
            assert_eq!(conversions(None, write(name)), 2, "{name}");
        }
        assert_eq!(conversions(None, |folder| std::fs::remove_file(folder.join("wood.png")).unwrap()), 2);
        let damage = |folder: &Path| {
            for file in std::fs::read_dir(folder.join("cache")).unwrap().flatten() {
                if file.path().extension().is_some_and(|kind| kind == "glb") {
                    std::fs::write(file.path(), "half").unwrap();
                }
            }
        };
        assert_eq!(conversions(None, damage), 2);
        assert_eq!(conversions(Some("waves: a sequence of files".into()), |_| ()), 2);
    }
}
