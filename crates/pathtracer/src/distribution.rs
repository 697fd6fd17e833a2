//! Discrete distributions for importance sampling. Entries are chosen by inversion of the
//! cumulative sum, so stratified numbers stay stratified.

/// Probabilities over 0..n, proportional to weights.
pub(crate) struct Distribution {
    /// Cumulative probability up to and including each entry; the last is 1.
    cumulative: Vec<f32>,
    probabilities: Vec<f32>,
    /// The interval [0, 1) has one equal part per entry. For each part, this list has the entry
    /// that the start of the part chooses. A search starts at this entry and takes constant time
    /// on average (Chen, Asau 1974).
    guide: Vec<u32>,
}

impl Distribution {
    /// Makes a distribution in proportion to weights ≥ 0; `None` when their sum is zero or not
    /// finite.
    pub(crate) fn new(weights: &[f64]) -> Option<Self> {
        let sum: f64 = weights.iter().sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let mut running = 0.0;
        let mut cumulative: Vec<f32> = weights
            .iter()
            .map(|weight| {
                running += weight / sum;
                running as f32
            })
            .collect();
        // no number below 1 may choose an entry after the last entry that has weight
        let last = weights.iter().rposition(|&w| w > 0.0)?;
        cumulative[last..].fill(1.0);
        // Probabilities are differences of the rounded sums, so that they agree with sampling up to
        // rounding.
        let probabilities =
            (0..cumulative.len()).map(|i| cumulative[i] - if i == 0 { 0.0 } else { cumulative[i - 1] }).collect();
        let parts = cumulative.len() as f32;
        let guide = (0..cumulative.len())
            .map(|part| cumulative.partition_point(|&c| c <= part as f32 / parts) as u32)
            .collect();
        Some(Self { cumulative, probabilities, guide })
    }

    /// Returns the entry that `u` in [0, 1) chooses, and `u` rescaled from the entry's interval to
    /// [0, 1).
    #[inline]
    pub(crate) fn sample(&self, u: f32) -> (usize, f32) {
        let last = self.cumulative.len() - 1;
        let part = (u * self.cumulative.len() as f32) as usize;
        let mut index = self.guide[part.min(last)] as usize;
        // rounding may start the search one entry too far, so first step back
        while index > 0 && self.cumulative[index - 1] > u {
            index -= 1;
        }
        while index < last && self.cumulative[index] <= u {
            index += 1;
        }
        let below = if index == 0 { 0.0 } else { self.cumulative[index - 1] };
        let inside = ((u - below) / self.probabilities[index]).clamp(0.0, 1.0 - f32::EPSILON);
        (index, inside)
    }

    /// Returns the probability of an entry.
    #[inline]
    pub(crate) fn probability(&self, index: usize) -> f32 {
        self.probabilities[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_follow_the_weights() {
        let distribution = Distribution::new(&[0.0, 1.0, 0.0, 3.0, 0.0]).unwrap();
        let n = 1000;
        let mut counts = [0; 5];
        for i in 0..n {
            let (index, inside) = distribution.sample(i as f32 / n as f32);
            assert!((0.0..1.0).contains(&inside));
            counts[index] += 1;
        }
        assert_eq!(counts, [0, 250, 0, 750, 0]);
        assert_eq!(distribution.sample(1.0 - f32::EPSILON / 2.0).0, 3);
        assert_eq!(distribution.probability(3), 0.75);
        assert!(Distribution::new(&[0.0, 0.0]).is_none() && Distribution::new(&[]).is_none());
    }
}
