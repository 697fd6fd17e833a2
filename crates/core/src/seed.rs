//! Deterministic seeds. Every random stream is derived from the job's seed and from the labels of
//! its use (view, pixel, frame, ...). So results do not depend on the order of work or on threads.

/// Derives an independent 64-bit seed from a parent seed and the labels of a stream.
///
/// Each label passes through the finalizer of SplitMix64 (Steele, Lea, Flood 2014).
pub fn derive(seed: u64, labels: &[u64]) -> u64 {
    labels.iter().fold(mix(seed), |state, &label| mix(state ^ mix(label.wrapping_add(0x9e37_79b9_7f4a_7c15))))
}

/// Scrambles 64 bits. Different inputs give different outputs.
#[inline]
pub fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Returns a uniform number in [0, 1) from the upper 24 bits of a hash.
#[inline]
pub fn unit_f32(hash: u64) -> f32 {
    (hash >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
}

/// A small sequential generator (SplitMix64) for uses with modest demands on quality.
#[derive(Clone, Debug)]
pub struct Stream(u64);

impl Stream {
    /// Starts a stream; see [`derive()`] for seeds.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the stream in the state that it has after `numbers` more numbers.
    #[must_use]
    pub fn after(&self, numbers: u64) -> Self {
        Self(self.0.wrapping_add(numbers.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    /// Returns the next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        let value = mix(self.0);
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        value
    }

    /// Returns the next number in [0, 1).
    pub fn next_f32(&mut self) -> f32 {
        unit_f32(self.next_u64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_with_different_labels_differ() {
        let seeds = [derive(1, &[0, 1]), derive(1, &[1, 0]), derive(1, &[0]), derive(2, &[0, 1]), derive(1, &[])];
        for (i, a) in seeds.iter().enumerate() {
            assert!(seeds[i + 1..].iter().all(|b| a != b));
        }
    }

    #[test]
    fn a_stream_goes_on_from_anywhere() {
        let mut stream = Stream::new(derive(3, &[1]));
        let ahead = [0u64, 1, 7].map(|numbers| stream.after(numbers).next_u64());
        let numbers: Vec<u64> = (0..8).map(|_| stream.next_u64()).collect();
        assert_eq!(ahead, [numbers[0], numbers[1], numbers[7]]);
    }

    #[test]
    fn the_mean_of_a_stream_is_one_half() {
        let mut stream = Stream::new(derive(7, &[3]));
        let n = 100_000;
        let mean = (0..n).map(|_| f64::from(stream.next_f32())).sum::<f64>() / f64::from(n);
        // the limit is five standard errors, each 0.29 / sqrt(n) = 9e-4
        assert!((mean - 0.5).abs() < 4.6e-3, "{mean}");
    }
}
