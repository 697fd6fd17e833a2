//! Tabulated functions.

/// Values on an even grid over the unit cube of `D` coordinates, the first of which varies fastest.
pub(crate) struct Table<const D: usize, const V: usize> {
    nodes: [usize; D],
    pub(crate) values: Vec<[f32; V]>,
}

impl<const D: usize, const V: usize> Table<D, V> {
    /// Evaluates the function at every node; each axis has at least two nodes.
    pub(crate) fn new(nodes: [usize; D], function: impl Fn([f32; D]) -> [f32; V]) -> Self {
        let at = |index: usize| {
            let mut rest = index;
            function(nodes.map(|nodes| {
                let fraction = (rest % nodes) as f32 / (nodes - 1) as f32;
                rest /= nodes;
                fraction
            }))
        };
        Self { nodes, values: (0..nodes.iter().product()).map(at).collect() }
    }

    /// Interpolates multilinearly; coordinates are clamped to 0..1.
    #[inline]
    pub(crate) fn at(&self, at: [f32; D]) -> [f32; V] {
        let mut first = 0;
        let mut strides = [0; D];
        let mut shares = [0.0; D];
        let mut stride = 1;
        for axis in 0..D {
            let x = at[axis].clamp(0.0, 1.0) * (self.nodes[axis] - 1) as f32;
            let index = (x as usize).min(self.nodes[axis] - 2);
            shares[axis] = x - index as f32;
            strides[axis] = stride;
            first += index * stride;
            stride *= self.nodes[axis];
        }
        let mut sums = [0.0; V];
        for corner in 0..1usize << D {
            let (mut node, mut weight) = (first, 1.0);
            for axis in 0..D {
                let above = (corner >> axis) & 1;
                node += above * strides[axis];
                weight *= if above == 1 { shares[axis] } else { 1.0 - shares[axis] };
            }
            sums.iter_mut().zip(&self.values[node]).for_each(|(sum, value)| *sum += weight * value);
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Multilinear interpolation is exact for a product of linear functions, also at the ends of
    /// the ranges.
    #[test]
    fn products_of_linear_functions_are_exact() {
        let function = |[x, y, z]: [f32; 3]| [(1.0 + x) * (2.0 - y) * (0.5 + 3.0 * z), x - z];
        let table = Table::new([3, 2, 5], function);
        for at in [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.3, 0.9, 0.1], [0.5, 0.0, 0.77]] {
            let (found, expected) = (table.at(at), function(at));
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{at:?}: {found:?} {expected:?}");
        }
        assert_eq!(table.at([-1.0, 7.0, f32::INFINITY]), table.at([0.0, 1.0, 1.0]));
    }
}
