//! Converts chains of matrices to placements.

use glam::{DAffine3, DMat4};

/// Takes one matrix from each link, in every combination, and calls `found` with the product.
/// `outer` is the leftmost factor of every product. In `links`, the last link is the outermost.
pub(crate) fn expand(outer: &DAffine3, links: &[Vec<DAffine3>], found: &mut dyn FnMut(DAffine3)) {
    let Some((last, inner)) = links.split_last() else { return found(*outer) };
    for matrix in last {
        expand(&(*outer * *matrix), inner, found);
    }
}

/// Converts a USD matrix, which multiplies row vectors. Its last column is (0, 0, 0, 1) in every
/// transform of USD.
pub(crate) fn affine(matrix: &[f64; 16]) -> DAffine3 {
    DAffine3::from_mat4(DMat4::from_cols_array(matrix))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_multiply_from_the_inside() {
        let translate = |x: f64| DAffine3::from_translation(glam::DVec3::new(x, 0.0, 0.0));
        let scale = |s: f64| DAffine3::from_scale(glam::DVec3::splat(s));
        // each of two copies is scaled about the origin by three factors, which gives six copies
        let links = vec![vec![translate(1.0), translate(2.0)], vec![scale(10.0), scale(100.0), scale(1000.0)]];
        let mut found = Vec::new();
        expand(&translate(0.5), &links, &mut |matrix| found.push(matrix.translation.x));
        assert_eq!(found, [10.5, 20.5, 100.5, 200.5, 1000.5, 2000.5]);
        let mut count = 0;
        expand(&translate(0.5), &[vec![translate(1.0)], vec![]], &mut |_| count += 1);
        assert_eq!(count, 0);
    }

    #[test]
    fn rows_of_usd_are_columns() {
        let mut matrix = [0.0; 16];
        for (i, value) in matrix.iter_mut().enumerate() {
            *value = if i % 5 == 0 { 1.0 } else { 0.0 };
        }
        matrix[12..15].copy_from_slice(&[7.0, 8.0, 9.0]);
        // the matrix maps the x axis to the y axis
        (matrix[0], matrix[1]) = (0.0, 1.0);
        let affine = affine(&matrix);
        assert_eq!(affine.transform_point3(glam::DVec3::X), glam::DVec3::new(7.0, 9.0, 9.0));
    }
}
