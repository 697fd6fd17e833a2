//! Makes the views of a quilt, from left to right, from the submitted data.
//!
//! The viewing zone is divided into N equal parts, and view i of N is at the centre of part i. If
//! the data have A views per row, view i is at the index
//!
//! ```text
//! a_i = (i + ½) / N · A − ½
//! ```
//!
//! among the views of the data. For N = A this is view i of the data. A layer stack is simulated at
//! position a_i. A light field has views only at whole numbers.

use std::borrow::Cow;

use lumistack_plugin::display::{FieldGeometry, Projection};
use lumistack_plugin::serde::{Deserialize, Serialize};
use lumistack_plugin::{FieldInput, PluginError, StackInput, ViewPoint};

/// Handling of positions at which a light field has no view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub enum Missing {
    /// Use the nearest view.
    Nearest,
    /// Blend the two neighbouring views.
    Blend,
    /// Return an error that states the number of views to render.
    Refuse,
}

/// The way in which a view of the quilt was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub enum Made {
    /// The view was simulated from a layer stack, at the view's position.
    Simulated,
    /// The view was copied from the light field, which has a view at this position.
    Exact,
    /// The nearest view of the light field was copied.
    Nearest,
    /// The two neighbouring views of the light field were blended.
    Blend,
}

/// The source of views.
#[derive(Clone, Copy)]
pub enum Source<'a> {
    /// A stack, whose views are simulated and divided by β.
    Stack(&'a StackInput<'a>),
    /// A light field, whose views of one row are used.
    Field(&'a FieldInput<'a>),
}

/// Largest distance from a view of the data, in units of views, at which a position is regarded as
/// the position of that view.
const SAME_PLACE: f64 = 1e-6;

/// Returns the positions a_i of `count` views of a quilt, among the `available` views per row of
/// the data.
pub fn places(count: usize, available: usize) -> Vec<f64> {
    (0..count).map(|i| (i as f64 + 0.5) / count as f64 * available as f64 - 0.5).collect()
}

/// Returns the index of the row of views to use; there are `rows` rows. The result is `given`, or
/// the central row if `given` is negative. If there are two central rows, it is the upper one.
///
/// # Errors
/// If there is no such row.
pub fn row_of(rows: usize, given: i64) -> Result<usize, PluginError> {
    match usize::try_from(given) {
        Err(_) => Ok((rows - 1) / 2),
        Ok(row) if row < rows => Ok(row),
        Ok(row) => Err(PluginError::Refused(format!(
            "parameter `view_row`: expected a row of views from -1 to {}, found {row}",
            rows - 1
        ))),
    }
}

impl Source<'_> {
    /// Returns the pixels and views of the source.
    pub fn geometry(&self) -> &FieldGeometry {
        match self {
            Self::Stack(stack) => stack.target(),
            Self::Field(field) => field.geometry(),
        }
    }

    /// Returns the index of the row of views to use; see [`row_of`].
    ///
    /// # Errors
    /// If there is no such row.
    pub fn row(&self, given: i64) -> Result<usize, PluginError> {
        row_of(self.geometry().grid.slope_y.len(), given)
    }

    /// Makes the view at the position `place` in the row of views `row`. Returns its linear values
    /// `[row][col][rgb]`, the way in which it was made, and its slope.
    ///
    /// # Errors
    /// Under [`Missing::Refuse`] if a light field has no such view; otherwise the host's errors.
    pub fn view(&self, place: f64, row: usize, missing: Missing) -> Result<(Vec<f32>, Made, [f64; 2]), PluginError> {
        let grid = &self.geometry().grid;
        let slope_y = grid.slope_y[row];
        match self {
            Self::Stack(stack) => {
                let slope = [slope_at(&grid.slope_x, place), slope_y];
                let from = match grid.projection {
                    Projection::Oblique => ViewPoint::Slope(slope),
                    Projection::Perspective { distance_mm } => {
                        ViewPoint::Eye([slope[0] * distance_mm, slope[1] * distance_mm, distance_mm])
                    }
                };
                let factor = (1.0 / stack.brightness()) as f32;
                let values = stack.simulate(from)?.to_vec().into_iter().map(|value| value * factor).collect();
                Ok((values, Made::Simulated, slope))
            }
            Self::Field(field) => {
                // A light field has views only at whole positions.
                let last = grid.slope_x.len() - 1;
                let nearest = (place.round().max(0.0) as usize).min(last);
                let own = (field.view([row, nearest])?, [grid.slope_x[nearest], slope_y]);
                if (place - nearest as f64).abs() < SAME_PLACE {
                    return Ok((own.0.to_vec(), Made::Exact, own.1));
                }
                match missing {
                    Missing::Refuse => Err(PluginError::Refused("the light field has no view at this position".into())),
                    Missing::Nearest => Ok((own.0.to_vec(), Made::Nearest, own.1)),
                    Missing::Blend => {
                        let place = place.clamp(0.0, last as f64);
                        let first = (place.floor() as usize).min(last.saturating_sub(1));
                        let t = (place - first as f64) as f32;
                        let [a, b] = [first, (first + 1).min(last)].map(|view| field.view([row, view]));
                        let (a, b) = (a?.to_vec(), b?.to_vec());
                        let mixed = a.iter().zip(&b).map(|(a, b)| a + t * (b - a)).collect();
                        Ok((mixed, Made::Blend, [slope_at(&grid.slope_x, place), slope_y]))
                    }
                }
            }
        }
    }
}

/// Returns a warning with advice if a light field of `available` views per row has no view at a
/// position of a quilt with `count` views. Returns `None` otherwise, for example for nine views per
/// row and a quilt of three views.
///
/// # Errors
/// Under [`Missing::Refuse`], if there is such a position.
pub fn advice(available: usize, count: usize, missing: Missing) -> Result<Option<String>, PluginError> {
    if places(count, available).iter().all(|place| (place - place.round()).abs() < SAME_PLACE) {
        return Ok(None);
    }
    let have = format!("expected {count} views per row, found {available}, so that some tiles lie between views");
    let render = format!("for one view per tile, render the light field with `views = [{count}, 1]`");
    match missing {
        Missing::Refuse => Err(PluginError::Refused(format!("{have}; {render}"))),
        Missing::Nearest => Ok(Some(format!("{have}. Every tile shows the nearest view; {render}"))),
        Missing::Blend => {
            Ok(Some(format!("{have}. Neighbouring views are blended, which shows double edges; {render}")))
        }
    }
}

/// Returns the slope at a position, linearly interpolated between views. Positions up to half a
/// view outside the outermost views are extrapolated.
fn slope_at(slopes: &[f64], place: f64) -> f64 {
    let [_, .., _] = slopes else { return slopes[0] };
    let first = (place.floor().max(0.0) as usize).min(slopes.len() - 2);
    slopes[first] + (place - first as f64) * (slopes[first + 1] - slopes[first])
}

/// Returns the fraction of a tile, 0..1, that stays black. The view has `size` pixels, and the
/// screen shows the tile with the aspect `aspect`; see [`fitted`].
pub fn black_share(size: [usize; 2], aspect: f64, fit: Fit) -> f64 {
    let own = size[0] as f64 / size[1] as f64;
    match fit {
        Fit::Contain => 1.0 - (aspect / own).min(own / aspect),
        Fit::Cover | Fit::Stretch => 0.0,
    }
}

/// Fit of a view to its tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub enum Fit {
    /// The whole view, with black bars.
    Contain,
    /// No bars; the view is cropped.
    Cover,
    /// The view is stretched to the tile.
    Stretch,
}

/// Fits a view of `size` = [columns, rows] pixels to a tile of `tile` = [columns, rows] pixels. The
/// screen shows the tile with the aspect `aspect`. A view of the tile's size and aspect is returned
/// unchanged.
pub fn fitted(rgb: &[f32], size: [usize; 2], tile: [usize; 2], aspect: f64, fit: Fit) -> Cow<'_, [f32]> {
    let own = size[0] as f64 / size[1] as f64;
    let same = (own / aspect - 1.0).abs() < 0.5 / size[0].max(size[1]) as f64;
    if size == tile && (same || fit == Fit::Stretch) {
        return Cow::Borrowed(rgb);
    }
    // [horizontal, vertical] fraction of the tile that the view fills, and fraction of the view
    // that the tile shows
    let (mut filled, mut shown) = ([1.0, 1.0], [1.0, 1.0]);
    if !same {
        match fit {
            Fit::Contain if own > aspect => filled[1] = aspect / own,
            Fit::Contain => filled[0] = own / aspect,
            Fit::Cover if own > aspect => shown[0] = aspect / own,
            Fit::Cover => shown[1] = own / aspect,
            Fit::Stretch => {}
        }
    }
    let pixels = |side: usize, share: f64| ((side as f64 * share).round() as usize).clamp(1, side);
    let kept = [0, 1].map(|axis| pixels(size[axis], shown[axis]));
    let target = [0, 1].map(|axis| pixels(tile[axis], filled[axis]));
    let from = [0, 1].map(|axis| (size[axis] - kept[axis]) / 2);
    let part = image::ImageBuffer::<image::Rgb<f32>, _>::from_fn(kept[0] as u32, kept[1] as u32, |x, y| {
        let i = 3 * ((y as usize + from[1]) * size[0] + x as usize + from[0]);
        image::Rgb([rgb[i], rgb[i + 1], rgb[i + 2]])
    });
    let scaled = if kept == target {
        part
    } else {
        image::imageops::resize(&part, target[0] as u32, target[1] as u32, image::imageops::FilterType::Triangle)
    };
    if target == tile {
        return Cow::Owned(scaled.into_raw());
    }
    let to = [0, 1].map(|axis| (tile[axis] - target[axis]) / 2);
    let mut values = vec![0.0; 3 * tile[0] * tile[1]];
    for (row, line) in scaled.into_raw().chunks_exact(3 * target[0]).enumerate() {
        values[3 * ((row + to[1]) * tile[0] + to[0])..][..line.len()].copy_from_slice(line);
    }
    Cow::Owned(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_black_share_is_that_of_the_pixels() {
        let white = vec![1.0; 3 * 60 * 40];
        for (aspect, fit) in
            [(0.75, Fit::Contain), (3.0, Fit::Contain), (1.5, Fit::Contain), (0.75, Fit::Cover), (3.0, Fit::Stretch)]
        {
            let tile = [120, (120.0 / aspect) as usize];
            let filled = fitted(&white, [60, 40], tile, aspect, fit);
            let black = filled.iter().filter(|value| **value == 0.0).count() as f64 / filled.len() as f64;
            let share = black_share([60, 40], aspect, fit);
            assert!((black - share).abs() < 0.02, "{aspect} {fit:?}: {black} is black, expected {share}");
        }
        assert!((black_share([60, 40], 0.75, Fit::Contain) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn as_many_views_are_the_same_views() {
        assert_eq!(places(5, 5), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(places(4, 2), [-0.25, 0.25, 0.75, 1.25]);
        assert_eq!(places(1, 5), [2.0]);
        let slopes = [-0.2, 0.0, 0.2];
        for (place, slope) in [(-0.5, -0.3), (0.0, -0.2), (0.5, -0.1), (2.25, 0.25)] {
            assert!((slope_at(&slopes, place) - slope).abs() < 1e-12, "{place}");
        }
        assert_eq!(slope_at(&[0.1], -0.4), 0.1);
    }

    #[test]
    fn only_positions_without_a_view_are_reported() {
        for (available, count) in [(5, 5), (9, 3), (5, 1)] {
            assert_eq!(advice(available, count, Missing::Refuse).unwrap(), None, "{available} views, {count} tiles");
        }
        for (available, count) in [(3, 6), (9, 4), (4, 1)] {
            assert!(advice(available, count, Missing::Refuse).is_err(), "{available} views, {count} tiles");
            assert!(advice(available, count, Missing::Blend).unwrap().is_some(), "{available} views, {count} tiles");
        }
    }

    /// Returns a view whose left half is 0 and whose right half is 1.
    fn halves(size: [usize; 2]) -> Vec<f32> {
        (0..3 * size[0] * size[1]).map(|i| f32::from(u8::from(i / 3 % size[0] >= size[0] / 2))).collect()
    }

    #[test]
    fn a_wide_view_in_a_square_tile() {
        let view = halves([8, 4]);
        let red = |values: &[f32]| -> Vec<f32> { values.iter().step_by(3).copied().collect() };
        let contained = red(&fitted(&view, [8, 4], [4, 4], 1.0, Fit::Contain));
        assert_eq!(contained[..4], [0.0; 4], "a bar above");
        assert_eq!(contained[12..], [0.0; 4], "a bar below");
        assert!(contained[4] < 0.1 && contained[7] > 0.9);
        let covered = red(&fitted(&view, [8, 4], [4, 4], 1.0, Fit::Cover));
        assert_eq!(covered, [0.0, 0.0, 1.0, 1.0].repeat(4));
        let stretched = red(&fitted(&view, [8, 4], [4, 4], 1.0, Fit::Stretch));
        assert!(stretched[0] < 0.1 && stretched[3] > 0.9 && stretched[12] < 0.1 && stretched[15] > 0.9);
        // A tile with fewer columns, which the screen shows with the view's aspect, has no bars.
        let squeezed = fitted(&view, [8, 4], [4, 4], 2.0, Fit::Contain);
        assert_eq!(red(&squeezed), stretched);
        assert!(matches!(fitted(&view, [8, 4], [8, 4], 2.0, Fit::Contain), Cow::Borrowed(_)));
    }
}
