//! Distributes work over all threads of the current rayon pool. Without rayon, one thread does all
//! work.
//!
//! A band is one part of the output, and one thread computes it in a fixed order. So results do not
//! depend on the number of threads.

/// Calls `work(scratch, index, chunk)` for every chunk of `data`.
///
/// `init` makes a `scratch` value, which later chunks may reuse.
pub(crate) fn for_each_chunk<T: Send, S>(
    data: &mut [T],
    chunk: usize,
    init: impl Fn() -> S + Sync + Send,
    work: impl Fn(&mut S, usize, &mut [T]) + Sync + Send,
) {
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        data.par_chunks_mut(chunk)
            .enumerate()
            .with_min_len(2)
            .for_each_init(init, |scratch, (index, chunk)| work(scratch, index, chunk));
    }
    #[cfg(not(feature = "parallel"))]
    {
        let mut scratch = init();
        data.chunks_mut(chunk).enumerate().for_each(|(index, chunk)| work(&mut scratch, index, chunk));
    }
}

/// Returns `work(scratch, index)` for every index from 0 to `count` − 1, in the order of the
/// indices.
pub(crate) fn map<T: Send + Clone + Default, S>(
    count: usize,
    init: impl Fn() -> S + Sync + Send,
    work: impl Fn(&mut S, usize) -> T + Sync + Send,
) -> Vec<T> {
    let mut results = vec![T::default(); count];
    for_each_chunk(&mut results, 1, init, |scratch, index, result| result[0] = work(scratch, index));
    results
}

/// Returns true if `holds` returns true for every part of `data`.
pub(crate) fn all<T: Sync>(data: &[T], holds: impl Fn(&[T]) -> bool + Sync + Send) -> bool {
    /// Number of values of one part.
    const PART: usize = 1 << 16;
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        data.par_chunks(PART).all(holds)
    }
    #[cfg(not(feature = "parallel"))]
    {
        data.chunks(PART).all(holds)
    }
}
