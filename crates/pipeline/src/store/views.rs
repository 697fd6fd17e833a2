//! Cached views. The header of each file has a hash of the file's name and of the picture's size
//! and pixels.
//!
//! A stage's [stamp](super::stamps) is written last, so a run that is killed between two views has
//! no stamp. Therefore each view has a hash of its own. The hash includes the name, so a copy of
//! another view is invalid.

use std::io::Write;
use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_field_io::atomic;
use lumistack_field_io::picture::{self, Picture, Precision};
use rayon::prelude::*;

use lumistack_pathtracer::{Features, Settings, SplitView};

use super::key::KeyBuilder;
use crate::error::{PipelineError, field_error};

/// Returns the path of a view's file, or of the file with a half of its samples.
pub(crate) fn view_path(folder: &Path, view: [usize; 2], half: Option<usize>) -> PathBuf {
    let half = half.map_or("", |half| ["-a", "-b"][half]);
    folder.join(format!("view_{:02}_{:02}{half}.exr", view[0], view[1]))
}

/// Returns the path of the file with the variance of a view, or with the variance of a half of its
/// samples.
pub(crate) fn variance_path(folder: &Path, view: [usize; 2], half: Option<usize>) -> PathBuf {
    let half = half.map_or("", |half| ["-a", "-b"][half]);
    folder.join(format!("variance_{:02}_{:02}{half}.exr", view[0], view[1]))
}

/// Returns the path of a view whose diffuse and other light are separate.
pub(crate) fn split_path(folder: &Path, view: [usize; 2]) -> PathBuf {
    folder.join(format!("split_{:02}_{:02}.bin", view[0], view[1]))
}

/// Returns the path of the file with the guides of a view, or with the guides of a half of its
/// samples.
pub(crate) fn guides_path(folder: &Path, view: [usize; 2], half: Option<usize>) -> PathBuf {
    let half = half.map_or("", |half| ["-a", "-b"][half]);
    folder.join(format!("guides_{:02}_{:02}{half}.exr", view[0], view[1]))
}

/// Returns the path of the file with a view's splats.
pub(crate) fn splats_path(folder: &Path, view: [usize; 2]) -> PathBuf {
    folder.join(format!("splats_{:02}_{:02}.exr", view[0], view[1]))
}

/// Reads the splats of a view, `[row][col][r, g, b, T]` with the transmittance T. Returns `None` if
/// the file is missing or damaged.
pub(crate) fn read_splats(path: &Path, geometry: &FieldGeometry) -> Option<Vec<f32>> {
    let values = 4 * geometry.rows * geometry.cols;
    let mut read = read_picture(path, [geometry.cols, splat_rows(geometry.rows)])?;
    read.truncate(values);
    Some(read)
}

/// Writes the splats of a view, `[row][col][r, g, b, T]` with the transmittance T. The file is a
/// picture of three channels, so it has 4/3 of the view's rows.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_splats(path: &Path, light: &Tensor<3>) -> Result<(), PipelineError> {
    let [rows, cols, _] = light.shape();
    let mut values = light.data().to_vec();
    values.resize(3 * cols * splat_rows(rows), 0.0);
    write_picture(path, [cols, splat_rows(rows)], &values)
}

fn splat_rows(rows: usize) -> usize {
    (4 * rows).div_ceil(3)
}

/// Reads a view whose diffuse and other light are separate, traced with these settings; `None` if
/// the file is missing or damaged.
pub(crate) fn read_split(path: &Path, geometry: &FieldGeometry, settings: &Settings) -> Option<SplitView> {
    let (rows, cols) = (geometry.rows, geometry.cols);
    // Read no more bytes than the file should have.
    let length = (size_of::<Seal>() + rows * cols * SplitView::packed_bytes(settings)) as u64;
    if std::fs::metadata(path).ok()?.len() != length {
        return None;
    }
    let bytes = std::fs::read(path).ok()?;
    let (seal, packed) = bytes.split_first_chunk()?;
    (*seal == split_seal(path, [cols, rows], packed)).then(|| SplitView::from_bytes(packed, [rows, cols], settings))?
}

/// Writes a view whose diffuse and other light are separate: a hash, and the packed values. A light
/// field may have hundreds of such views, which all exist at the same time. Unpacked, a view would
/// take 2.6 to 2.9 times the space.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_split(path: &Path, split: &SplitView) -> Result<(), PipelineError> {
    let ([rows, cols], packed) = (split.size(), split.to_bytes());
    let seal = split_seal(path, [cols, rows], &packed);
    let write = |writer: &mut atomic::Writer<'_>| {
        writer.write_all(&seal)?;
        writer.write_all(&packed)
    };
    atomic::write(path, write).map_err(field_error)
}

/// Reads the guides of a view; `None` if the file is missing or damaged.
pub(crate) fn read_guides(path: &Path, geometry: &FieldGeometry) -> Option<Features> {
    Features::from_values(read_values(path, geometry, Features::VALUES)?)
}

/// Writes the guides of a view.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_guides(path: &Path, guides: &Features) -> Result<(), PipelineError> {
    write_values(path, guides.values())
}

/// Reads a tensor `[row][col][k]` with `count` values per pixel, of index k. Returns `None` if the
/// file is missing or damaged.
fn read_values(path: &Path, geometry: &FieldGeometry, count: usize) -> Option<Tensor<3>> {
    let [rows, cols] = [geometry.rows, geometry.cols];
    let pictures = read_picture(path, [cols, count.div_ceil(3) * rows])?;
    let mut values = Tensor::zeros(["row", "col", "k"], [rows, cols, count]);
    for (number, picture) in pictures.chunks_exact(3 * rows * cols).enumerate() {
        let taken = 3.min(count - 3 * number);
        for (to, from) in values.data_mut().chunks_exact_mut(count).zip(picture.chunks_exact(3)) {
            to[3 * number..][..taken].copy_from_slice(&from[..taken]);
        }
    }
    Some(values)
}

/// Writes a tensor `[row][col][k]` as several pictures, one below the other. Each picture has three
/// values of every pixel.
fn write_values(path: &Path, values: &Tensor<3>) -> Result<(), PipelineError> {
    let [rows, cols, count] = values.shape();
    let height = count.div_ceil(3) * rows;
    let mut pictures = vec![0.0; 3 * cols * height];
    for (number, picture) in pictures.chunks_exact_mut(3 * rows * cols).enumerate() {
        let taken = 3.min(count - 3 * number);
        for (to, from) in picture.chunks_exact_mut(3).zip(values.data().chunks_exact(count)) {
            to[..taken].copy_from_slice(&from[3 * number..][..taken]);
        }
    }
    write_picture(path, [cols, height], &pictures)
}

/// Reads a view with the size of the geometry; `None` if the file is missing or damaged.
pub(crate) fn read_view(path: &Path, geometry: &FieldGeometry) -> Option<Vec<f32>> {
    read_picture(path, [geometry.cols, geometry.rows])
}

/// Returns the elements of `all` that are not cached. Checking cached files takes seconds, so this
/// function shows progress. If none of the files exists, returns all elements without a check.
pub(crate) fn missing<T: Send + Sync>(
    all: Vec<T>,
    file: impl Fn(&T) -> PathBuf,
    is_kept: impl Fn(&T) -> bool + Sync,
    task: Task<'_>,
) -> Vec<T> {
    if !all.iter().any(|one| file(one).exists()) {
        return all;
    }
    task.progress.begin("kept views", all.len() as u64, "views");
    let check = |one: &T| {
        let kept = is_kept(one);
        task.progress.advance(1, "");
        kept
    };
    let kept: Vec<bool> = all.par_iter().map(check).collect();
    task.progress.end();
    all.into_iter().zip(kept).filter_map(|(one, kept)| (!kept).then_some(one)).collect()
}

/// Writes a view `[row][col][rgb]`, linear.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_view(path: &Path, picture: &Tensor<3>) -> Result<(), PipelineError> {
    let [rows, cols, _] = picture.shape();
    write_picture(path, [cols, rows], picture.data())
}

/// Writes a picture `[row][col][rgb]`, linear, of `size` = [columns, rows].
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_picture(path: &Path, size: [usize; 2], rgb: &[f32]) -> Result<(), PipelineError> {
    picture::write_exr_noted(path, size, rgb, Precision::Float, &seal(path, size, rgb)).map_err(field_error)
}

/// Reads a picture of this size; `None` if the file is missing, damaged or of another size.
pub(crate) fn read_picture(path: &Path, size: [usize; 2]) -> Option<Vec<f32>> {
    let (picture, note) = Picture::read_noted(path).ok()?;
    if picture.size() != size {
        return None;
    }
    let rgb = picture.into_linear();
    (note? == seal(path, size, &rgb)).then_some(rgb)
}

/// Hash of a view's name, size and values.
type Seal = [u8; 32];

fn split_seal(path: &Path, size: [usize; 2], packed: &[u8]) -> Seal {
    key("split", path, size).add("values", packed).bytes()
}

fn seal(path: &Path, size: [usize; 2], rgb: &[f32]) -> String {
    key("view", path, size).add_f32("rgb", rgb).finish()
}

/// Begins the hash of a file's content with the file's name and the size of the view.
fn key(kind: &str, path: &Path, size: [usize; 2]) -> KeyBuilder {
    let mut key = KeyBuilder::new(kind, &[]);
    key.add("name", path.file_name().unwrap_or_default().as_encoded_bytes()).add_json("size", &size);
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [16, 8];

    /// Returns pixel values of noise, which cannot be compressed.
    fn grain(seed: u64) -> Vec<f32> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        (0..3 * SIZE[0] * SIZE[1]).map(|_| next()).collect()
    }

    #[test]
    fn a_view_that_was_damaged_at_equal_size_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = ["view_00_00.exr", "view_00_01.exr"].map(|name| folder.path().join(name));
        write_picture(&first, SIZE, &grain(1)).unwrap();
        write_picture(&second, SIZE, &grain(2)).unwrap();
        assert_eq!(read_picture(&first, SIZE), Some(grain(1)));
        assert_eq!(read_picture(&first, [8, 16]), None);
        let bytes = std::fs::read(&first).unwrap();
        for place in [bytes.len() - 1, bytes.len() - 200, bytes.len() / 2] {
            let mut damaged = bytes.clone();
            damaged[place] ^= 1;
            std::fs::write(&first, &damaged).unwrap();
            assert_eq!(read_picture(&first, SIZE), None, "byte {place} of {}", bytes.len());
        }
        // Two pictures of the right size are invalid: a copy of another view, and a picture without
        // a hash.
        std::fs::copy(&second, &first).unwrap();
        assert_eq!(read_picture(&first, SIZE), None);
        picture::write_exr(&first, SIZE, &grain(1), Precision::Float).unwrap();
        assert_eq!(read_picture(&first, SIZE), None);
        std::fs::write(&first, bytes).unwrap();
        assert_eq!(read_picture(&first, SIZE), Some(grain(1)));
    }
}
