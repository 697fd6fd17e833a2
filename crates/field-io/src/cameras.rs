//! Folders with one picture per camera, named by row and column.
//!
//! Stanford archive: `NAME_RR_CC_<Y>_<X>[_...].png`; the numbers after row RR and column CC are the
//! camera's centre. X increases to the right and Y downwards. Views are ordered by these centres,
//! not by row and column, since the direction of CC relative to X differs between scenes. Renderers
//! that use these names may append focal length and sensor width in millimetres. Their cameras are
//! parallel, and their pictures are not shifted. Row and column numbers may have gaps, for example
//! if only every third camera of a larger set is kept.
//!
//! `RR_CC.png`: names without centres; row 0 is the topmost, column 0 the leftmost.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lumistack_core::Task;

use crate::FieldError;
use crate::geometry::{Cameras, Hints, place};
use crate::picture::{Picture, has_picture_extension};
use crate::source::{Kind, Source, Views};

/// Two centres are regarded as equal if their distance is at most this fraction of the mean
/// spacing.
const SAME_CENTRE: f64 = 1e-3;

/// Views that are pictures of one size.
#[derive(Debug)]
pub(crate) struct PictureGrid {
    files: Vec<PathBuf>,
    cols: usize,
    size: [usize; 2],
}

impl PictureGrid {
    /// Makes a grid of pictures, and reads the header of every file. `files` are listed row by row,
    /// and `views` is [vertical, horizontal].
    pub(crate) fn new(files: Vec<PathBuf>, views: [usize; 2]) -> Result<Self, FieldError> {
        let size = Picture::size_of(&files[0])?;
        for file in &files[1..] {
            let other = Picture::size_of(file)?;
            if other != size {
                return Err(FieldError::ViewSizes {
                    first: files[0].clone(),
                    first_size: size,
                    second: file.clone(),
                    second_size: other,
                });
            }
        }
        Ok(Self { files, cols: views[1], size })
    }

    pub(crate) fn size(&self) -> [usize; 2] {
        self.size
    }

    pub(crate) fn first_file(&self) -> &Path {
        &self.files[0]
    }
}

impl Views for PictureGrid {
    fn load(&mut self, view: [usize; 2]) -> Result<Vec<f32>, FieldError> {
        let file = self.file(view);
        let picture = Picture::read(&file)?;
        if picture.size() != self.size {
            let [first, second] = [self.files[0].clone(), file];
            let (first_size, second_size) = (self.size, picture.size());
            return Err(FieldError::ViewSizes { first, first_size, second, second_size });
        }
        Ok(picture.into_linear())
    }

    fn file(&self, view: [usize; 2]) -> PathBuf {
        self.files[view[0] * self.cols + view[1]].clone()
    }
}

/// Data that the name of a camera's picture contains.
#[derive(Clone, Debug, PartialEq)]
struct CameraName {
    prefix: String,
    row: u32,
    col: u32,
    /// Centre of the camera (Y, X), if the name has it.
    centre: Option<[f64; 2]>,
    /// Focal length and sensor width in millimetres, if the name has them.
    lens: Option<[f64; 2]>,
}

/// Opens the folder if its pictures are named by row and column.
pub(crate) fn source(folder: &Path, task: Task<'_>) -> Result<Option<Source>, FieldError> {
    let mut cameras = Vec::new();
    for file in pictures(folder)? {
        // the text in front of the numbers may have any encoding, so decode the name lossily
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(name) = parse_name(&stem) {
            cameras.push((name, file));
        }
    }
    let Some((first, _)) = cameras.first() else { return Ok(None) };
    // depth or disparity maps may have another prefix, so take the prefix of most names as the
    // light field's
    let mut groups = BTreeMap::<&str, usize>::new();
    cameras.iter().for_each(|(name, _)| *groups.entry(&name.prefix).or_default() += 1);
    let prefix = groups.iter().max_by_key(|(_, count)| **count).map_or(&first.prefix[..], |(prefix, _)| prefix);
    if groups.len() > 1 {
        let kept =
            if prefix.is_empty() { "without a prefix".to_owned() } else { format!("with the prefix `{prefix}`") };
        task.warn(
            place(folder),
            format!("the names of the pictures have different prefixes before the numbers of row and column; only pictures {kept} are read"),
        );
    }
    let prefix = prefix.to_string();
    cameras.retain(|(name, _)| name.prefix == prefix);
    grid(folder, cameras).map(Some)
}

/// Returns all pictures of a folder, sorted by name.
pub(crate) fn pictures(folder: &Path) -> Result<Vec<PathBuf>, FieldError> {
    let mut files = lumistack_files::list(folder).map_err(FieldError::io(folder, "list the folder"))?;
    files.retain(|path| has_picture_extension(path) && lumistack_files::is_file(path));
    Ok(files)
}

fn parse_name(stem: &str) -> Option<CameraName> {
    let parts: Vec<&str> = stem.split('_').collect();
    let index = |part: &str| if part.bytes().all(|b| b.is_ascii_digit()) { part.parse::<u32>().ok() } else { None };
    let number = |at: usize| parts.get(at)?.parse::<f64>().ok().filter(|number| number.is_finite());
    for at in 0..parts.len().saturating_sub(1) {
        let (Some(row), Some(col)) = (index(parts[at]), index(parts[at + 1])) else { continue };
        let pair = |at: usize| Some([number(at)?, number(at + 1)?]);
        let centre = pair(at + 2);
        if centre.is_none() && at + 2 != parts.len() {
            continue;
        }
        let lens = centre.and_then(|_| pair(at + 4)).filter(|lens| lens.iter().all(|length| *length > 0.0));
        return Some(CameraName { prefix: parts[..at].join("_"), row, col, centre, lens });
    }
    None
}

fn grid(folder: &Path, cameras: Vec<(CameraName, PathBuf)>) -> Result<Source, FieldError> {
    // Index pictures by row and column. Two pictures of the same row and column are an error.
    let mut by_index = BTreeMap::<(u32, u32), (CameraName, PathBuf)>::new();
    for (name, file) in cameras {
        if let Some((_, other)) = by_index.get(&(name.row, name.col)) {
            let found = format!("also {}", other.display());
            return Err(FieldError::malformed(file, "row and column", "one picture per view", found));
        }
        by_index.insert((name.row, name.col), (name, file));
    }
    let distinct = |pick: fn(&(u32, u32)) -> u32| {
        let mut numbers: Vec<u32> = by_index.keys().map(pick).collect();
        numbers.sort_unstable();
        numbers.dedup();
        numbers
    };
    let mut rows = distinct(|key| key.0);
    let mut cols = distinct(|key| key.1);
    // Refuse a grid in which some pair of a row and a column has no picture.
    for &row in &rows {
        for &col in &cols {
            if !by_index.contains_key(&(row, col)) {
                let expected = format!("all of {} × {} views", cols.len(), rows.len());
                return Err(FieldError::malformed(
                    folder,
                    "views",
                    expected,
                    format!("none for row {row}, column {col}"),
                ));
            }
        }
    }
    // Order rows and columns by the cameras' centres, if the names contain distinct centres.
    let centres = Centres::new(&by_index, &rows, &cols);
    if let Some(centres) = &centres {
        let x = |col: &u32| centres.x[cols.binary_search(col).unwrap_or(0)];
        let y = |row: &u32| centres.y[rows.binary_search(row).unwrap_or(0)];
        let (mut sorted_cols, mut sorted_rows) = (cols.clone(), rows.clone());
        sorted_cols.sort_by(|a, b| x(a).total_cmp(&x(b)));
        sorted_rows.sort_by(|a, b| y(a).total_cmp(&y(b)));
        (cols, rows) = (sorted_cols, sorted_rows);
    }
    // Build the reader and the cameras in the order of rows and columns.
    let in_order = || rows.iter().flat_map(|row| cols.iter().map(|col| &by_index[&(*row, *col)]));
    let lens = in_order().next().and_then(|(name, _)| name.lens);
    let views = [rows.len(), cols.len()];
    let reader = PictureGrid::new(in_order().map(|(_, file)| file.clone()).collect(), views)?;
    let focal_px = lens.map(|[focal_mm, sensor_mm]| focal_mm / sensor_mm * reader.size()[0] as f64);
    let kind = if centres.is_some() { Kind::Stanford } else { Kind::Numbered };
    let positions = match centres {
        Some(centres) => centres.positions(),
        None => [middle_zero((0..views[1]).map(|i| i as f64)), middle_zero((0..views[0]).map(|i| -(i as f64)))],
    };
    let cameras = Cameras { positions, focal_px, slope_per_step: 0.0, plane_unknown: true };
    Ok(Source {
        kind,
        path: folder.to_path_buf(),
        views,
        size: reader.size(),
        hints: Hints { cameras: Some(cameras), ..Hints::default() },
        info: serde_json::Map::new(),
        reader: Box::new(reader),
    })
}

/// Mean camera centre of each column (X, right) and of each row (Y, down). Both lists have the
/// order of the numbers in the names.
struct Centres {
    x: Vec<f64>,
    y: Vec<f64>,
}

impl Centres {
    /// Computes the centres. `None` if a name has no centre, or if two rows or two columns have the
    /// same centre.
    fn new(names: &BTreeMap<(u32, u32), (CameraName, PathBuf)>, rows: &[u32], cols: &[u32]) -> Option<Self> {
        let mut sums = (vec![0.0; cols.len()], vec![0.0; rows.len()]);
        for ((row, col), (name, _)) in names {
            let [y, x] = name.centre?;
            sums.0[cols.binary_search(col).ok()?] += x / rows.len() as f64;
            sums.1[rows.binary_search(row).ok()?] += y / cols.len() as f64;
        }
        let (x, y) = sums;
        let differ = |values: &[f64]| {
            let mut sorted = values.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted.windows(2).all(|pair| pair[1] - pair[0] > SAME_CENTRE * spacing(&sorted))
        };
        (differ(&x) && differ(&y)).then_some(Self { x, y })
    }

    /// Returns the positions in steps, right and up, in the order of this crate's views.
    fn positions(mut self) -> [Vec<f64>; 2] {
        self.x.sort_by(f64::total_cmp);
        self.y.sort_by(f64::total_cmp);
        let step = if self.x.len() > 1 { spacing(&self.x) } else { spacing(&self.y) };
        [middle_zero(self.x.iter().map(|x| x / step)), middle_zero(self.y.iter().map(|y| -y / step))]
    }
}

fn spacing(sorted: &[f64]) -> f64 {
    match sorted {
        [first, .., last] => (last - first) / (sorted.len() - 1) as f64,
        _ => 1.0,
    }
}

/// Shifts positions so that the middle between the first and the last is 0. Positions that differ
/// from a multiple of half a step by less than [`SAME_CENTRE`] are rounded to the multiple.
fn middle_zero(positions: impl Iterator<Item = f64>) -> Vec<f64> {
    let positions: Vec<f64> = positions.collect();
    let middle = 0.5 * (positions.first().unwrap_or(&0.0) + positions.last().unwrap_or(&0.0));
    let exact = |position: f64| {
        let halves = (2.0 * (position - middle)).round() / 2.0;
        if (position - middle - halves).abs() < SAME_CENTRE { halves } else { position - middle }
    };
    positions.iter().map(|&position| exact(position)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_the_archives_are_understood() {
        let name =
            |prefix: &str, row, col, centre, lens| Some(CameraName { prefix: prefix.into(), row, col, centre, lens });
        for (stem, expected) in [
            ("out_00_16_-381.909271_1103.376221", name("out", 0, 16, Some([-381.909271, 1103.376221]), None)),
            ("out_03_04_12.5_-7.25_", name("out", 3, 4, Some([12.5, -7.25]), None)),
            (
                "Original Camera_01_25_369.2_-3.5_30_36",
                name("Original Camera", 1, 25, Some([369.2, -3.5]), Some([30.0, 36.0])),
            ),
            ("00_08", name("", 0, 8, None, None)),
            ("scene_2_01_02", name("scene_2", 1, 2, None, None)),
            ("disparity", None),
            ("photo_7", None),
            ("input_Cam001", None),
        ] {
            // In "scene_2_01_02", row and column are the pair that ends the name, 01 and 02. The
            // first pair, 2 and 01, is rejected, since a single number follows it, not the two
            // numbers of a centre.
            assert_eq!(parse_name(stem), expected, "{stem}");
        }
    }
}
