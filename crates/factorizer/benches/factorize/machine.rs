//! The best rates of the machine: multiply-adds per second, and bytes read per second, on all
//! threads.
//!
//! Both rates are measured repeatedly, between the timings that they are compared with. The best
//! value is taken, since other programs can only lower it.

use std::hint::black_box;
use std::time::Instant;

use lumistack_simd::{Backend, Function, Kernel, Lanes};
use rayon::prelude::*;

/// Number of independent sums per thread. It exceeds latency × number of multiply-add units of
/// common x86-64 cores, so that all units are busy. All sums fit into 16 registers.
const SUMS: usize = 12;
/// Number of multiply-adds per sum in one measurement, which takes some 20 ms.
const ROUNDS: u64 = 6_000_000;
/// Number of values of the array that is read, 512 MiB: far more than most caches hold.
const VALUES: usize = 64 << 20;

/// Rates, in the order of their measurement.
#[derive(Default)]
pub struct Rates(Vec<f64>);

impl Rates {
    /// Returns the best rate.
    pub fn best(&self) -> f64 {
        self.0.iter().copied().fold(0.0, f64::max)
    }

    /// Returns the median rate as a fraction of the best rate. Other programs on the machine lower
    /// this fraction.
    pub fn median_share(&self) -> f64 {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).map_or(0.0, |median| median / self.best())
    }
}

/// The rates of this machine.
pub struct Machine {
    pub threads: usize,
    /// Name of the vector instructions that multiply and add.
    pub instructions: String,
    /// Multiply-adds per second, counted per lane.
    pub multiply_adds: Rates,
    /// Bytes read per second.
    pub bandwidth: Rates,
    lanes: usize,
    work: Function<MultiplyAdds>,
    values: Vec<u64>,
}

impl Machine {
    pub fn new() -> Self {
        let backend = Backend::best();
        Self {
            threads: rayon::current_num_threads(),
            instructions: backend.to_string(),
            multiply_adds: Rates::default(),
            bandwidth: Rates::default(),
            lanes: backend.lanes(),
            work: backend.function::<MultiplyAdds>(),
            // every value is written once, so that every page is in memory
            values: (0..VALUES as u64).into_par_iter().collect(),
        }
    }

    /// Measures the rate of multiply-adds and the bandwidth once more.
    pub fn measure(&mut self) {
        let begin = Instant::now();
        // SAFETY: the kernel has no requirements
        rayon::broadcast(|_| unsafe { (self.work)(ROUNDS) });
        let operations = ROUNDS as f64 * (SUMS * self.lanes * self.threads) as f64;
        self.multiply_adds.0.push(operations / begin.elapsed().as_secs_f64());

        let begin = Instant::now();
        let total: u64 = self.values.par_chunks(VALUES / self.threads).map(sum).reduce(|| 0, u64::wrapping_add);
        black_box(total);
        self.bandwidth.0.push((8 * VALUES) as f64 / begin.elapsed().as_secs_f64());
    }
}

fn sum(values: &[u64]) -> u64 {
    // Eight independent sums keep the additions from waiting for one another. So memory limits the
    // rate, even where vectors are short.
    let mut sums = [0u64; 8];
    for chunk in values.chunks_exact(8) {
        sums.iter_mut().zip(chunk).for_each(|(sum, value)| *sum = sum.wrapping_add(*value));
    }
    sums.iter().fold(0, |total, sum| total.wrapping_add(*sum))
}

/// A loop of multiply-adds.
struct MultiplyAdds;

impl Kernel for MultiplyAdds {
    type Args<'a> = u64;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(rounds: u64) {
        // SAFETY: the machine has the instruction set of V
        unsafe {
            let (factor, addend) = (V::splat(black_box(0.999)), V::splat(black_box(0.001)));
            let mut sums = [factor; SUMS];
            for _ in 0..rounds {
                for sum in &mut sums {
                    *sum = sum.mul_add(factor, addend);
                }
            }
            black_box(sums);
        }
    }
}
