//! Shows a light field without a simulated display. The picture at a position between the views is
//! a blend of the four nearest views in linear light.

use lumistack_core::colour::srgb_codes;

use crate::colour::DECODED;
use crate::{Error, err};

/// Largest size of all views together, bytes.
const LIMIT: usize = 1 << 30;

/// Views of a light field, sRGB codes `[row][col][rgba]`.
#[derive(Debug)]
pub struct Field {
    /// [rows, cols] of a view.
    pub size: [usize; 2],
    /// [rows, cols] of views.
    pub views: [usize; 2],
    codes: Vec<Option<Vec<u8>>>,
}

impl Field {
    /// Makes a light field without views; [`Self::put`] adds views. `size` is [rows, cols] of a
    /// view, `views` is [rows, cols] of views.
    ///
    /// # Errors
    /// If there are no pixels or no views, or all views together exceed 1 GiB.
    pub fn new(size: [usize; 2], views: [usize; 2]) -> Result<Self, Error> {
        let bytes =
            [size[0], size[1], views[0], views[1]].iter().try_fold(4usize, |product, n| product.checked_mul(*n));
        let (rows, cols) = (size[0], size[1]);
        if !bytes.is_some_and(|bytes| (4..=LIMIT).contains(&bytes)) {
            let found = format!("{} × {} views of {cols} × {rows} pixels", views[1], views[0]);
            return Err(err(format!(
                "light field: expected at least one pixel, and at most 1 GiB of views with 4 bytes per pixel, found {found}"
            )));
        }
        Ok(Self { size, views, codes: vec![None; views[0] * views[1]] })
    }

    /// Reads a quilt of `cols` × `rows` tiles as one row of views. View 0 is the tile at the bottom
    /// left; the views follow from left to right, then from the bottom up.
    ///
    /// # Errors
    /// If a view would have no pixel, the bytes do not match the size, or all views together exceed
    /// 1 GiB.
    pub fn from_quilt(rgba: &[u8], [width, height]: [usize; 2], [cols, rows]: [usize; 2]) -> Result<Self, Error> {
        if cols == 0 || rows == 0 || width / cols == 0 || height / rows == 0 {
            let found = format!("{width} × {height} pixels");
            return Err(err(format!(
                "quilt: expected at least one pixel for each of {cols} × {rows} views, found {found}"
            )));
        }
        if width.checked_mul(height).and_then(|n| n.checked_mul(4)) != Some(rgba.len()) {
            let found = rgba.len();
            return Err(err(format!(
                "quilt: expected 4 bytes for each of {width} × {height} pixels, found {found} bytes"
            )));
        }
        let [tile_cols, tile_rows] = [width / cols, height / rows];
        let mut field = Self::new([tile_rows, tile_cols], [1, cols * rows])?;
        for view in 0..cols * rows {
            let (left, top) = (view % cols * tile_cols, height - (view / cols + 1) * tile_rows);
            let lines = (top..top + tile_rows).flat_map(|row| &rgba[4 * (row * width + left)..][..4 * tile_cols]);
            field.codes[view] = Some(lines.copied().collect());
        }
        Ok(field)
    }

    /// Adds the view [row, col], sRGB bytes `[row][col][rgba]`.
    ///
    /// # Errors
    /// If there is no such view or it has another size.
    pub fn put(&mut self, view: [usize; 2], rgba: Vec<u8>) -> Result<(), Error> {
        let [rows, cols] = self.size;
        if view[0] >= self.views[0] || view[1] >= self.views[1] {
            let [last_y, last_x] = self.views.map(|n| n - 1);
            return Err(err(format!(
                "light field: expected a view up to row {last_y}, column {last_x}, found row {}, column {}",
                view[0], view[1]
            )));
        }
        if rgba.len() != 4 * rows * cols {
            let found = rgba.len();
            return Err(err(format!(
                "light field: expected 4 bytes for each of {cols} × {rows} pixels, found {found} bytes"
            )));
        }
        self.codes[view[0] * self.views[1] + view[1]] = Some(rgba);
        Ok(())
    }

    /// Returns the codes of a view, given by its index row by row; `None` until the view has
    /// arrived.
    pub fn codes(&self, view: usize) -> Option<&[u8]> {
        self.codes.get(view)?.as_deref()
    }

    /// Returns the indices and bilinear weights of the views around the position (u, v). u is 0..1
    /// from left to right, v is 0..1 from top to bottom. Views that have not arrived are omitted,
    /// and the remaining weights are scaled so that their sum is 1.
    pub fn blend(&self, u: f64, v: f64) -> Vec<(usize, f32)> {
        let around = |t: f64, count: usize| {
            let place = t.clamp(0.0, 1.0) * (count - 1) as f64;
            let first = (place.floor() as usize).min(count - 1);
            let t = (place - first as f64) as f32;
            [(first, 1.0 - t), ((first + 1).min(count - 1), t)]
        };
        let (ys, xs) = (around(v, self.views[0]), around(u, self.views[1]));
        let pairs = ys.iter().flat_map(|y| xs.iter().map(move |x| (y.0 * self.views[1] + x.0, y.1 * x.1)));
        let mut shares: Vec<(usize, f32)> =
            pairs.filter(|(view, share)| *share > 0.0 && self.codes(*view).is_some()).collect();
        let sum: f32 = shares.iter().map(|(_, share)| share).sum();
        shares.iter_mut().for_each(|(_, share)| *share /= sum);
        shares
    }

    /// Returns the picture at the position (u, v), sRGB bytes `[row][col][rgba]`. It is black if
    /// none of the views around the position has arrived.
    pub fn render(&self, u: f64, v: f64) -> Vec<u8> {
        let mut sum = vec![0.0f32; 4 * self.size[0] * self.size[1]];
        for (view, share) in self.blend(u, v) {
            let codes = self.codes(view).unwrap_or_default();
            sum.iter_mut().zip(codes).for_each(|(sum, code)| *sum += share * DECODED[usize::from(*code)]);
        }
        let codes = srgb_codes();
        sum.chunks_exact(4).flat_map(|p| [codes.code(p[0]), codes.code(p[1]), codes.code(p[2]), 255]).collect()
    }
}
