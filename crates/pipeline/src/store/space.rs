//! Disk space of cached views: their bytes per ray, and a check before views are traced.

use std::path::Path;

use lumistack_pathtracer::{Features, Settings, SplitView};

use crate::error::PipelineError;
use crate::job::Denoise;

/// Bytes of a ray in a cached view.
pub(crate) const VIEW: u64 = 3 * size_of::<f32>() as u64;
/// Bytes of a ray in a cached view of splats.
pub(crate) const SPLATS: u64 = 4 * size_of::<f32>() as u64;
/// Bytes of a ray in the guides of a denoiser.
pub(crate) const GUIDES: u64 = (Features::VALUES.next_multiple_of(3) * size_of::<f32>()) as u64;

/// Returns the number of bytes per ray of a traced view, or of a half of its samples.
pub(crate) fn traced(filter: Denoise, settings: &Settings) -> u64 {
    if filter == Denoise::Shared { SplitView::packed_bytes(settings) as u64 } else { VIEW }
}

/// Checks that the disk of a folder has room for `bytes` of views.
///
/// # Errors
/// If the disk has less free space. A disk whose free space is not known is not checked.
pub(crate) fn check(folder: &Path, bytes: u64) -> Result<(), PipelineError> {
    // some file systems do not know their size, and report 0
    match fs4::statvfs(folder).ok().filter(|disk| disk.total_space() > 0).map(|disk| disk.available_space()) {
        Some(free) if free < bytes => Err(PipelineError::value(
            folder,
            "disk space",
            format!(
                "{:.1} GB for the views that are not rendered yet; `lumistack clean --all` removes the cached views of older runs; fewer views (`render.most_views`) and fewer pixels (`--resolution`) need less space",
                bytes as f64 / 1e9
            ),
            format!("{:.1} GB", free as f64 / 1e9),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_is_too_small_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(check(folder.path(), 1).is_ok());
        let error = check(folder.path(), 1 << 62).unwrap_err().to_string();
        assert!(error.contains("disk space: expected 4611686018.4 GB for the views"), "{error}");
        assert!(check(&folder.path().join("nothing"), 1 << 62).is_ok(), "a disk that is not known is not checked");
    }
}
