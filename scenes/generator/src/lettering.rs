//! Solid letters: the dots of the bitmap font, extruded to a mesh for each line of text.
//!
//! Dots that share an edge form one solid. A few large rectangles cover the front and back of a
//! solid. A dot has a side wall only where it has no neighbour; walls in one line are joined.

use glam::{DVec2, DVec3};

use crate::bitmap_font::{GLYPH_ROWS, columns, is_set};
use crate::mesh::Mesh;

/// Returns the text as a solid. The bottom left corner of its front face is the origin. Dots have
/// sides of `dot_m` metres, and the solid extends from z = 0 to z = -`depth_m`.
///
/// Texture coordinates are (0, 0) at the top left and (1, 1) at the bottom right of the front of
/// the whole line.
pub(crate) fn solid_text(text: &str, dot_m: f64, depth_m: f64) -> Mesh {
    let dots = Dots::of(text);
    let (width, height) = (dots.columns as f64 * dot_m, dots.rows as f64 * dot_m);
    let corner = |column: usize, row: usize, z: f64| DVec3::new(column as f64 * dot_m, height - row as f64 * dot_m, z);
    let mut mesh = Mesh::default();
    for [left, top, right, bottom] in dots.rectangles() {
        let (across, down) = (DVec3::X * (right - left) as f64 * dot_m, DVec3::NEG_Y * (bottom - top) as f64 * dot_m);
        mesh.append(&Mesh::rectangle(corner(left, top, 0.0), across, down));
        mesh.append(&Mesh::rectangle(corner(right, top, -depth_m), -across, down));
    }
    let inwards = DVec3::NEG_Z * depth_m;
    for wall in dots.walls() {
        let [start, end] = wall.map(|(column, row)| corner(column, row, 0.0));
        mesh.append(&Mesh::rectangle(start, inwards, end - start));
    }
    mesh.texcoords = mesh.positions.iter().map(|p| DVec2::new(p.x / width, 1.0 - p.y / height)).collect();
    mesh
}

/// A line of text as a grid of dots.
struct Dots {
    columns: usize,
    rows: usize,
    set: Vec<bool>,
}

impl Dots {
    fn of(text: &str) -> Self {
        let columns = columns(text);
        let set = (0..GLYPH_ROWS * columns).map(|k| is_set(text, k % columns, k / columns)).collect();
        Self { columns, rows: GLYPH_ROWS, set }
    }

    fn at(&self, column: isize, row: isize) -> bool {
        let inside = (0..self.columns as isize).contains(&column) && (0..self.rows as isize).contains(&row);
        inside && self.set[row as usize * self.columns + column as usize]
    }

    /// Returns disjoint rectangles [left, top, right, bottom) that cover the set dots. Each starts
    /// at an uncovered dot and grows to the right, then down.
    fn rectangles(&self) -> Vec<[usize; 4]> {
        let mut left_over = self.set.clone();
        let mut rectangles = Vec::new();
        for top in 0..self.rows {
            for left in 0..self.columns {
                let free = |column: usize, row: usize, left_over: &[bool]| left_over[row * self.columns + column];
                if !free(left, top, &left_over) {
                    continue;
                }
                let right = (left..self.columns).find(|&column| !free(column, top, &left_over)).unwrap_or(self.columns);
                let bottom = (top..self.rows)
                    .find(|&row| !(left..right).all(|column| free(column, row, &left_over)))
                    .unwrap_or(self.rows);
                for row in top..bottom {
                    left_over[row * self.columns + left..row * self.columns + right].fill(false);
                }
                rectangles.push([left, top, right, bottom]);
            }
        }
        rectangles
    }

    /// Returns the segments of the outline, as start and end corner (column, row). Seen from the
    /// front, the set dots are to the right of the direction from start to end. Neighbouring
    /// segments in one line are joined.
    fn walls(&self) -> Vec<[(usize, usize); 2]> {
        let (columns, rows) = (self.columns as isize, self.rows as isize);
        let mut walls = Vec::new();
        for row in 0..=rows {
            for (inner, outer, forward) in [(row, row - 1, true), (row - 1, row, false)] {
                for (start, end) in runs(columns, |c| self.at(c, inner) && !self.at(c, outer)) {
                    let (a, b) = ((start, row as usize), (end, row as usize));
                    walls.push(if forward { [a, b] } else { [b, a] });
                }
            }
        }
        for column in 0..=columns {
            for (inner, outer, forward) in [(column, column - 1, false), (column - 1, column, true)] {
                for (start, end) in runs(rows, |r| self.at(inner, r) && !self.at(outer, r)) {
                    let (a, b) = ((column as usize, start), (column as usize, end));
                    walls.push(if forward { [a, b] } else { [b, a] });
                }
            }
        }
        walls
    }
}

/// Returns the longest ranges [start, end) within 0..length in which `inside` is true.
fn runs(length: isize, inside: impl Fn(isize) -> bool) -> Vec<(usize, usize)> {
    let mut runs = Vec::new();
    let mut start = None;
    for k in 0..=length {
        match (start, k < length && inside(k)) {
            (None, true) => start = Some(k as usize),
            (Some(first), false) => {
                runs.push((first, k as usize));
                start = None;
            }
            _ => {}
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest difference between the volumes of a mesh and of its dots, which is due to rounding.
    const VOLUME_TOLERANCE: f64 = 1e-12;

    /// Computes the signed volume of a mesh by the divergence theorem. It is positive if all faces
    /// wind outwards.
    fn volume(mesh: &Mesh) -> f64 {
        mesh.indices
            .chunks_exact(3)
            .map(|corners| {
                let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[corners[k] as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    #[test]
    fn the_solid_has_the_volume_of_its_dots() {
        for text in ["LUMISTACK", "+0.5", "8"] {
            let mesh = solid_text(text, 0.5, 2.0);
            let dots = Dots::of(text).set.iter().filter(|dot| **dot).count();
            assert!((volume(&mesh) - dots as f64 * 0.5).abs() < VOLUME_TOLERANCE * dots as f64, "{text}");
        }
    }

    #[test]
    fn faces_wind_with_their_normals() {
        let mesh = solid_text("ABQ", 1.0, 1.0);
        for corners in mesh.indices.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[corners[k] as usize]);
            let face = (b - a).cross(c - a).normalize();
            assert!((face - mesh.normals[corners[0] as usize]).length() < 1e-12);
        }
    }
}
