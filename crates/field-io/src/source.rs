//! A light field on disk before its geometry is resolved: a grid of views that can be read one at a
//! time.

use std::path::PathBuf;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::FieldError;
use crate::geometry::Hints;

/// Kinds of light fields on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A folder of this project: `lightfield.json` and one OpenEXR picture per view.
    Folder,
    /// One `.npy` array.
    Array,
    /// Pictures named by row, column and camera centre, as in the Stanford archive.
    Stanford,
    /// Pictures named `RR_CC`.
    Numbered,
    /// Pictures named `input_Cam000`, as in the HCI 4D light field benchmark.
    Hci,
    /// One picture of tiles, with the leftmost view at the bottom left.
    Quilt,
    /// One picture of tiles, with the leftmost and topmost view at the top left.
    Tiles,
}

/// Reads views in the order of this crate: `view` = [view_y, view_x], where (0, 0) is leftmost and
/// topmost.
pub(crate) trait Views {
    /// Reads a view, `[row][col][rgb]`, linear, in the file's resolution.
    fn load(&mut self, view: [usize; 2]) -> Result<Vec<f32>, FieldError>;
    /// Returns the file that contains a view.
    fn file(&self, view: [usize; 2]) -> PathBuf;
}

/// A light field on disk whose headers have been read.
pub(crate) struct Source {
    pub(crate) kind: Kind,
    pub(crate) path: PathBuf,
    /// Number of views, [vertical, horizontal].
    pub(crate) views: [usize; 2],
    /// [columns, rows] of every view.
    pub(crate) size: [usize; 2],
    pub(crate) hints: Hints,
    pub(crate) info: Map<String, Value>,
    pub(crate) reader: Box<dyn Views>,
}

impl std::fmt::Debug for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Source")
            .field("kind", &self.kind)
            .field("path", &self.path)
            .field("views", &self.views)
            .finish()
    }
}

impl Source {
    /// Reverses the order of views along each axis (x, y) for which `mirror` is true.
    pub(crate) fn mirror(&mut self, mirror: [bool; 2]) {
        if mirror == [false; 2] {
            return;
        }
        let inner = std::mem::replace(&mut self.reader, Box::new(NoViews));
        self.reader = Box::new(Mirrored { inner, views: self.views, mirror });
        // Mirror the stated positions and slopes of the views, too.
        let positions = self.hints.cameras.iter_mut().flat_map(|cameras| cameras.positions.iter_mut().zip(mirror));
        let slopes = self.hints.slopes.iter_mut().zip(mirror);
        let stated = slopes.filter_map(|(slopes, mirror)| Some((slopes.as_mut()?, mirror))).chain(positions);
        for (values, _) in stated.filter(|(_, mirror)| *mirror) {
            values.reverse();
            values.iter_mut().for_each(|value| *value = -*value);
        }
    }
}

struct Mirrored {
    inner: Box<dyn Views>,
    views: [usize; 2],
    mirror: [bool; 2],
}

impl Mirrored {
    fn original(&self, [y, x]: [usize; 2]) -> [usize; 2] {
        let flip = |index: usize, count: usize, mirror: bool| if mirror { count - 1 - index } else { index };
        [flip(y, self.views[0], self.mirror[1]), flip(x, self.views[1], self.mirror[0])]
    }
}

impl Views for Mirrored {
    fn load(&mut self, view: [usize; 2]) -> Result<Vec<f32>, FieldError> {
        self.inner.load(self.original(view))
    }

    fn file(&self, view: [usize; 2]) -> PathBuf {
        self.inner.file(self.original(view))
    }
}

/// Stands in for a reader while the reader is moved into a wrapper.
struct NoViews;

impl Views for NoViews {
    fn load(&mut self, _view: [usize; 2]) -> Result<Vec<f32>, FieldError> {
        Ok(Vec::new())
    }

    fn file(&self, _view: [usize; 2]) -> PathBuf {
        PathBuf::new()
    }
}
