//! Tabulated functions.

use std::sync::OnceLock;

/// Values on an even grid over the unit cube of `D` coordinates, the first of which varies fastest.
///
/// A slice contains all nodes that have the same value of the last coordinate. It is computed when
/// a lookup first needs it. The last coordinate is a property of materials, such as roughness, so
/// most scenes need few slices. The computation of all slices would take most of the time of a
/// scene's first view.
pub(crate) struct Table<const D: usize, const V: usize> {
    nodes: [usize; D],
    slices: Box<[OnceLock<Slice<V>>]>,
    make: fn([usize; D], f32) -> Slice<V>,
}

/// The values at all nodes that have the same value of the last coordinate.
pub(crate) type Slice<const V: usize> = Box<[[f32; V]]>;

impl<const D: usize, const V: usize> Table<D, V> {
    /// Makes a table; each axis has at least two nodes. `make` computes the slice at a value of the
    /// last coordinate, for example by [`slice`].
    pub(crate) fn new(nodes: [usize; D], make: fn([usize; D], f32) -> Slice<V>) -> Self {
        Self { nodes, slices: (0..nodes[D - 1]).map(|_| OnceLock::new()).collect(), make }
    }

    /// Interpolates multilinearly; coordinates are clamped to 0..1.
    #[inline]
    pub(crate) fn at(&self, at: [f32; D]) -> [f32; V] {
        // find the lower corner of the cell that contains the position
        let mut first = 0;
        let mut strides = [0; D];
        let mut shares = [0.0; D];
        let mut lower = 0;
        let mut stride = 1;
        for axis in 0..D {
            let x = at[axis].clamp(0.0, 1.0) * (self.nodes[axis] - 1) as f32;
            let index = (x as usize).min(self.nodes[axis] - 2);
            shares[axis] = x - index as f32;
            if axis + 1 == D {
                lower = index;
                break;
            }
            strides[axis] = stride;
            first += index * stride;
            stride *= self.nodes[axis];
        }
        // add up the corners of the cell in the two slices on either side
        let mut sums = [0.0; V];
        for (slice, share) in [(lower, 1.0 - shares[D - 1]), (lower + 1, shares[D - 1])] {
            // at a node of the last coordinate, the other slice is not needed
            if share == 0.0 {
                continue;
            }
            let values = self.slice(slice);
            for corner in 0..1usize << (D - 1) {
                let (mut node, mut weight) = (first, 1.0);
                for axis in 0..D - 1 {
                    let above = (corner >> axis) & 1;
                    node += above * strides[axis];
                    weight *= if above == 1 { shares[axis] } else { 1.0 - shares[axis] };
                }
                weight *= share;
                sums.iter_mut().zip(&values[node]).for_each(|(sum, value)| *sum += weight * value);
            }
        }
        sums
    }

    #[inline]
    fn slice(&self, index: usize) -> &[[f32; V]] {
        self.slices[index].get_or_init(|| (self.make)(self.nodes, index as f32 / (self.nodes[D - 1] - 1) as f32))
    }
}

/// Evaluates a function at all nodes whose last coordinate is `last`, a value in 0..1.
pub(crate) fn slice<const D: usize, const V: usize>(
    nodes: [usize; D],
    last: f32,
    function: impl Fn([f32; D]) -> [f32; V],
) -> Slice<V> {
    let at = |index: usize| {
        let mut coordinates = [last; D];
        let mut rest = index;
        for axis in 0..D - 1 {
            coordinates[axis] = (rest % nodes[axis]) as f32 / (nodes[axis] - 1) as f32;
            rest /= nodes[axis];
        }
        function(coordinates)
    };
    (0..nodes[..D - 1].iter().product()).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Multilinear interpolation is exact for a product of linear functions, also at the ends of
    /// the ranges.
    #[test]
    fn products_of_linear_functions_are_exact() {
        fn function([x, y, z]: [f32; 3]) -> [f32; 2] {
            [(1.0 + x) * (2.0 - y) * (0.5 + 3.0 * z), x - z]
        }
        let table = Table::new([3, 2, 5], |nodes, last| slice(nodes, last, function));
        for at in [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.3, 0.9, 0.1], [0.5, 0.0, 0.77]] {
            let (found, expected) = (table.at(at), function(at));
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{at:?}: {found:?} {expected:?}");
        }
        assert_eq!(table.at([-1.0, 7.0, f32::INFINITY]), table.at([0.0, 1.0, 1.0]));
    }

    /// A lookup computes only the slices next to its last coordinate: one at a node, two between
    /// nodes.
    #[test]
    fn slices_are_computed_when_they_are_needed() {
        let table = Table::new([3, 5], |nodes, last| slice(nodes, last, |[x, y]| [x + 10.0 * y]));
        let made = || table.slices.iter().map(|slice| u8::from(slice.get().is_some())).collect::<Vec<_>>();
        for (last, expected) in [(0.0, [1, 0, 0, 0, 0]), (0.6, [1, 0, 1, 1, 0]), (1.0, [1, 0, 1, 1, 1])] {
            table.at([0.5, last]);
            assert_eq!(made(), expected, "{last}");
        }
    }
}
