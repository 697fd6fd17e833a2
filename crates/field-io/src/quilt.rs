//! One picture with a tile for each view.
//!
//! Quilt: `NAME_qs<columns>x<rows>[a<aspect>].ext`, horizontal parallax only. View 0, the leftmost,
//! is the bottom-left tile; views continue to the right, then upwards. The aspect is the width of a
//! view divided by its height; the view's tile may be anamorphic. The picture's size need not be a
//! multiple of the tiles: they start at the bottom left, and pixels that remain at the top and
//! right are unused.
//!
//! Tiles (by a flag): view (0, 0) is at the top left, with parallax along both axes. The picture's
//! size must be a multiple of the number of tiles.

use std::path::{Path, PathBuf};

use crate::FieldError;
use crate::geometry::{GeometryFlags, Hints};
use crate::picture::Picture;
use crate::source::{Kind, Source, Views};

/// Largest number of tiles per axis.
const TILE_LIMIT: usize = 1000;

/// Arrangement of views that the name of a quilt states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Layout {
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    pub(crate) aspect: Option<f64>,
}

/// Parses `_qs<columns>x<rows>[a<aspect>]` in a name.
pub(crate) fn layout_of(path: &Path) -> Option<Layout> {
    let stem = path.file_stem()?.to_string_lossy();
    let text = &stem[stem.rfind("_qs")? + 3..];
    let (columns, text) = leading_number(text)?;
    let (rows, text) = leading_number(text.strip_prefix('x')?)?;
    let aspect = text.strip_prefix('a').map(|text| {
        let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
        text[..end].parse::<f64>()
    });
    match aspect {
        None => Some(Layout { columns, rows, aspect: None }),
        Some(Ok(aspect)) if aspect > 0.0 => Some(Layout { columns, rows, aspect: Some(aspect) }),
        Some(_) => None,
    }
}

fn leading_number(text: &str) -> Option<(usize, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    Some((text[..end].parse().ok()?, &text[end..]))
}

struct TileViews {
    path: PathBuf,
    tile: [usize; 2],
    /// [column, row] of the top left pixel of each view in the picture. View [y, x] has the index
    /// y · cols + x.
    corners: Vec<[usize; 2]>,
    cols: usize,
    picture: Option<Picture>,
}

/// Opens a picture of tiles; flags override the arrangement in its name.
pub(crate) fn source(path: &Path, flags: &GeometryFlags) -> Result<Source, FieldError> {
    let size = Picture::size_of(path)?;
    if let Some([columns, rows]) = flags.tiles {
        let tile = tile_size(path, "--tiles", size, [columns, rows])?;
        if tile[0] * columns != size[0] || tile[1] * rows != size[1] {
            let expected = format!(
                "a picture whose width is a multiple of {columns} pixels and whose height is a multiple of {rows} pixels"
            );
            return Err(FieldError::malformed(path, "--tiles", expected, format!("{} × {}", size[0], size[1])));
        }
        let corner = |index: usize| [index % columns * tile[0], index / columns * tile[1]];
        let corners = (0..rows * columns).map(corner).collect();
        return Ok(tiled(Kind::Tiles, path, [rows, columns], tile, corners, None));
    }
    let named = layout_of(path);
    let layout = match flags.quilt {
        Some([columns, rows]) => Layout { columns, rows, aspect: named.and_then(|layout| layout.aspect) },
        None => named.ok_or_else(|| FieldError::MissingGeometry {
            path: path.into(),
            what: "the arrangement of views in the picture",
            flag: "--quilt COLUMNSxROWS (view 0 at the bottom left) or --tiles COLUMNSxROWS (view 0 at the top left), or name the picture NAME_qs8x6a0.75.png",
        })?,
    };
    let Layout { columns, rows, aspect } = layout;
    let tile = tile_size(path, "--quilt", size, [columns, rows])?;
    let corner = |view: usize| [view % columns * tile[0], size[1] - (view / columns + 1) * tile[1]];
    let corners = (0..rows * columns).map(corner).collect();
    Ok(tiled(Kind::Quilt, path, [1, rows * columns], tile, corners, aspect))
}

fn tile_size(path: &Path, flag: &str, size: [usize; 2], counts: [usize; 2]) -> Result<[usize; 2], FieldError> {
    let fits = |axis: usize| (1..=TILE_LIMIT.min(size[axis])).contains(&counts[axis]);
    if !fits(0) || !fits(1) {
        let expected = format!("1 × 1 to {} × {} tiles, at most one per pixel and 1000 per axis", size[0], size[1]);
        return Err(FieldError::malformed(path, flag, expected, format!("{} × {}", counts[0], counts[1])));
    }
    Ok([size[0] / counts[0], size[1] / counts[1]])
}

fn tiled(
    kind: Kind,
    path: &Path,
    views: [usize; 2],
    tile: [usize; 2],
    corners: Vec<[usize; 2]>,
    view_aspect: Option<f64>,
) -> Source {
    Source {
        kind,
        path: path.to_path_buf(),
        views,
        size: tile,
        hints: Hints { view_aspect, ..Hints::default() },
        info: serde_json::Map::new(),
        reader: Box::new(TileViews { path: path.to_path_buf(), tile, corners, cols: views[1], picture: None }),
    }
}

impl Views for TileViews {
    fn load(&mut self, view: [usize; 2]) -> Result<Vec<f32>, FieldError> {
        let picture = match &mut self.picture {
            Some(picture) => picture,
            empty => empty.insert(Picture::read(&self.path)?),
        };
        let corner = self.corners[view[0] * self.cols + view[1]];
        let size = picture.size();
        if corner[0] + self.tile[0] > size[0] || corner[1] + self.tile[1] > size[1] {
            let expected = "the size in the picture's header";
            return Err(FieldError::malformed(&self.path, "size", expected, format!("{} × {}", size[0], size[1])));
        }
        Ok(picture.linear_part(corner, self.tile))
    }

    fn file(&self, _view: [usize; 2]) -> PathBuf {
        self.path.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_give_columns_before_rows() {
        let layout = |name: &str| layout_of(Path::new(name)).map(|l| (l.columns, l.rows, l.aspect));
        assert_eq!(layout("a_qs8x6a0.75.png"), Some((8, 6, Some(0.75))));
        assert_eq!(layout("dir_qs1x1/a_qs11x6.jpg"), Some((11, 6, None)));
        assert_eq!(layout("a_f012_qs5x9a0.5625.png"), Some((5, 9, Some(0.5625))));
        assert_eq!(layout("a_qs5x9a0.5625_copy.png"), Some((5, 9, Some(0.5625))));
        for name in [
            "a.png",
            "a_qs.png",
            "a_qs5.png",
            "a_qsx5.png",
            "a_qs5x5a.png",
            "a_qs5x5a0.png",
            "a_qs5x99999999999999999999.png",
        ] {
            assert_eq!(layout(name), None, "{name}");
        }
    }
}
