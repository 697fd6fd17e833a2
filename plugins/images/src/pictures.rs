//! The approximate picture of a directional backlight, and the choice of views to simulate.

/// Returns an approximate picture of the panel behind the lenslets, in which each lenslet is a cell
/// of bins_y × bins_x pixels.
///
/// Let a panel point be at offset u from the axis of its lenslet, of focal length f. The lenslet
/// sends the point's light to the slope s = −u/f, on the opposite side. So the leftmost slope
/// (bin_x = 0) is the rightmost pixel of the cell, seen from the front. The topmost slope (bin_y =
/// 0) is the lowest pixel. The picture has lenslet_rows · bins_y rows and lenslet_cols · bins_x
/// columns. It is approximate, since the pixels of a real panel do not divide the lenslet pitch
/// evenly. Programs that drive the panel must resample this picture.
///
/// `bins` is [bins_y, bins_x] and `lenslets` is [rows, cols]. `bin(bin_y, bin_x)` returns the
/// emission `[lenslet_row][lenslet_col][rgb]`. The picture is `[row][col][rgb]`.
///
/// # Errors
/// Those of `bin`.
pub fn backlight_picture<E>(
    bins: [usize; 2],
    lenslets: [usize; 2],
    mut bin: impl FnMut(usize, usize) -> Result<Vec<f32>, E>,
) -> Result<Vec<f32>, E> {
    let [bins_y, bins_x] = bins;
    let [rows, cols] = lenslets;
    let width = cols * bins_x;
    let mut picture = vec![0.0; 3 * rows * bins_y * width];
    for (bin_y, bin_x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
        let emission = bin(bin_y, bin_x)?;
        for (i, rgb) in emission.chunks_exact(3).enumerate() {
            let row = i / cols * bins_y + (bins_y - 1 - bin_y);
            let col = i % cols * bins_x + (bins_x - 1 - bin_x);
            picture[3 * (row * width + col)..][..3].copy_from_slice(rgb);
        }
    }
    Ok(picture)
}

/// Returns the views [view_y, view_x] at the centre and the corners of a grid of `views` = [view
/// rows, view columns], each once. If no view is exactly at the centre, the central one is the view
/// above and left of the centre.
pub fn centre_and_corners(views: [usize; 2]) -> Vec<[usize; 2]> {
    let (last_y, last_x) = (views[0] - 1, views[1] - 1);
    let mut chosen = vec![[last_y / 2, last_x / 2], [0, 0], [0, last_x], [last_y, 0], [last_y, last_x]];
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_leftmost_topmost_bin_is_the_lowest_rightmost_pixel_of_a_cell() {
        // value = 100·bin_y + 10·bin_x + lenslet
        let value = |y: usize, x: usize, lenslet: usize| (100 * y + 10 * x + lenslet) as f32;
        let picture = backlight_picture([2, 3], [1, 2], |y, x| {
            Ok::<_, ()>((0..2).flat_map(|lenslet| [value(y, x, lenslet), 0.0, 1.0]).collect())
        })
        .unwrap();
        let red: Vec<f32> = picture.chunks_exact(3).map(|rgb| rgb[0]).collect();
        let rows = [[120.0, 110.0, 100.0, 121.0, 111.0, 101.0], [20.0, 10.0, 0.0, 21.0, 11.0, 1.0]];
        assert_eq!(red, rows.concat());
        assert!(picture.chunks_exact(3).all(|rgb| rgb[1..] == [0.0, 1.0]));
    }

    #[test]
    fn the_chosen_views_are_distinct() {
        assert_eq!(centre_and_corners([5, 5]), [[0, 0], [0, 4], [2, 2], [4, 0], [4, 4]]);
        assert_eq!(centre_and_corners([1, 3]), [[0, 0], [0, 1], [0, 2]]);
        assert_eq!(centre_and_corners([1, 1]), [[0, 0]]);
    }
}
