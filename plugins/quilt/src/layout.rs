//! The layout of a quilt, and the suffix of its name.
//!
//! A quilt is one picture with a tile for each view. View 0, the leftmost view, is the tile at the
//! bottom left. The next views are to the right of view 0, then in the rows above. Tiles have
//! ⌊width / columns⌋ × ⌊height / rows⌋ pixels and start at the bottom left. If the quilt's sizes do
//! not divide evenly, the remaining pixels at the top and right are black. The name ends in
//! `_qs<columns>x<rows>a<aspect>`. The aspect is the width over the height of a view as a viewer
//! sees it, which may differ from the aspect of its tile.

use lumistack_plugin::PluginError;

use crate::devices::Device;

/// The layout of a quilt.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// [columns, rows] of the quilt's pixels.
    pub size: [usize; 2],
    /// Number of columns of views in the quilt.
    pub columns: usize,
    /// Number of rows of views in the quilt.
    pub rows: usize,
    /// Width over height of one view.
    pub aspect: f64,
}

/// The values of a quilt's layout that the job sets; 0 stands for a value that it does not set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Given {
    /// Columns and rows of views.
    pub views: [usize; 2],
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// Width over height of one view.
    pub aspect: f64,
}

impl Layout {
    /// Returns the layout of a device's quilt. Without a device, returns the layout for `views`
    /// views of `view_size` = [columns, rows] pixels. Values of `given` other than 0 replace the
    /// values of the device or of the views.
    ///
    /// # Errors
    /// If only one of columns and rows is given, or a tile has no pixel.
    pub fn new(
        device: Option<&Device>,
        given: Given,
        views: usize,
        view_size: [usize; 2],
    ) -> Result<Self, PluginError> {
        let refused = |text: String| Err(PluginError::Refused(text));
        let [columns, rows] = match (given.views, device) {
            ([0, 0], Some(device)) => [device.columns, device.rows],
            ([0, 0], None) => squarest(views, view_size),
            ([columns, rows], _) if columns > 0 && rows > 0 => [columns, rows],
            ([columns, rows], _) => {
                return refused(format!(
                    "parameters `columns` and `rows`: expected two numbers above 0, or 0 for both, found {columns} and {rows}"
                ));
            }
        };
        let natural = device.map_or([columns * view_size[0], rows * view_size[1]], |device| device.quilt);
        let size = [0, 1].map(|axis| if given.size[axis] > 0 { given.size[axis] } else { natural[axis] });
        if size[0] < columns || size[1] < rows {
            let [width, height] = size;
            return refused(format!(
                "parameters `width` and `height`: expected at least {columns} × {rows} pixels, one for every view, found {width} × {height}"
            ));
        }
        let own = view_size[0] as f64 / view_size[1] as f64;
        let aspect = if given.aspect > 0.0 { given.aspect } else { device.map_or(own, |device| device.aspect) };
        Ok(Self { size, columns, rows, aspect })
    }

    /// Returns the number of views in the quilt.
    pub fn views(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns [columns, rows] of a tile.
    pub fn tile(&self) -> [usize; 2] {
        [self.size[0] / self.columns, self.size[1] / self.rows]
    }

    /// Returns [column, row] of the top left pixel of a view's tile.
    pub fn corner(&self, view: usize) -> [usize; 2] {
        let tile = self.tile();
        [view % self.columns * tile[0], self.size[1] - (view / self.columns + 1) * tile[1]]
    }

    /// Returns the suffix of the file's name. The suffix states the aspect with up to five
    /// decimals, which distinguish views whose sizes differ by one pixel.
    pub fn suffix(&self) -> String {
        let rounded = (self.aspect * 1e5).round() / 1e5;
        format!("_qs{}x{}a{rounded}", self.columns, self.rows)
    }
}

/// Returns the columns and rows of tiles for which a quilt of `views` views is nearest to a square.
fn squarest(views: usize, view_size: [usize; 2]) -> [usize; 2] {
    let skew = |columns: usize| {
        let [width, height] = [columns * view_size[0], views / columns * view_size[1]];
        (width as f64 / height as f64).ln().abs()
    };
    let divisors = (1..=views).filter(|columns| views.is_multiple_of(*columns));
    let columns = divisors.min_by(|&a, &b| skew(a).total_cmp(&skew(b))).unwrap_or(1);
    [columns, views / columns]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::devices::devices;

    #[test]
    fn views_go_from_the_bottom_left_to_the_right_and_up() {
        let layout = Layout { size: [19, 9], columns: 3, rows: 2, aspect: 1.5 };
        assert_eq!((layout.tile(), layout.views()), ([6, 4], 6));
        assert_eq!([0, 2, 3, 5].map(|view| layout.corner(view)), [[0, 5], [12, 5], [0, 1], [12, 1]]);
    }

    #[test]
    fn names_have_digits_enough() {
        let suffix = |aspect| Layout { size: [8, 6], columns: 8, rows: 6, aspect }.suffix();
        assert_eq!(suffix(0.75), "_qs8x6a0.75");
        assert_eq!(suffix(0.5625), "_qs8x6a0.5625");
        assert_eq!(suffix(16.0 / 9.0), "_qs8x6a1.77778");
        assert_eq!(suffix(1.0), "_qs8x6a1");
    }

    #[test]
    fn without_a_device_nothing_is_scaled() {
        let layout = |given, views| Layout::new(None, given, views, [160, 100]).unwrap();
        let of = |views| {
            let layout = layout(Given::default(), views);
            ([layout.columns, layout.rows], layout.size)
        };
        assert_eq!(of(48), ([6, 8], [960, 800]));
        assert_eq!(of(5), ([1, 5], [160, 500]));
        assert_eq!(of(1), ([1, 1], [160, 100]));
        assert_eq!(layout(Given::default(), 6).aspect, 1.6);
        let given = Given { views: [4, 3], size: [0, 999], aspect: 1.5 };
        assert_eq!(layout(given, 5), Layout { size: [640, 999], columns: 4, rows: 3, aspect: 1.5 });
        let one = Layout::new(None, Given { views: [4, 0], ..Given::default() }, 5, [160, 100]);
        assert!(one.unwrap_err().to_string().contains("expected two numbers above 0, or 0 for both"));
        let small = Layout::new(None, Given { views: [4, 4], size: [3, 9], aspect: 0.0 }, 5, [160, 100]);
        assert!(small.unwrap_err().to_string().contains("at least 4 × 4"));
    }

    #[test]
    fn a_device_has_its_own_quilt() {
        let portrait = devices().iter().find(|device| device.id == "portrait");
        let layout = Layout::new(portrait, Given::default(), 5, [160, 100]).unwrap();
        assert_eq!(layout, Layout { size: [3360, 3360], columns: 8, rows: 6, aspect: 0.75 });
        assert_eq!(layout.tile(), [420, 560]);
    }
}
