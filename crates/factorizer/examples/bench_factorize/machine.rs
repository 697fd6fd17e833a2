//! What the machine can do at best: multiply-adds per second, and bytes read from memory per second, on all threads.
//!
//! Both are measured again and again between the timings they are compared with; the best figure counts, since anything else that runs only
//! lowers them.

use std::hint::black_box;
use std::time::Instant;

use rayon::prelude::*;

/// Independent sums per thread: more than latency × multiply-add units of any core, and few enough for 16 registers.
const SUMS: usize = 12;
/// Multiply-adds of every sum in one measurement: some 20 ms.
const ROUNDS: u64 = 6_000_000;
/// Values of the array that is read, 512 MiB: far more than any cache holds.
const VALUES: usize = 64 << 20;

/// Name of the vector instructions, vector length, and a loop of multiply-adds.
type Loop = (&'static str, usize, fn(u64));

/// Rates measured one after another.
#[derive(Default)]
pub struct Rates(Vec<f64>);

impl Rates {
    /// What the machine can do.
    pub fn best(&self) -> f64 {
        self.0.iter().copied().fold(0.0, f64::max)
    }

    /// What it had to give while others ran, as a share of the best.
    pub fn median_share(&self) -> f64 {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).map_or(0.0, |median| median / self.best())
    }
}

/// Measures this machine.
pub struct Machine {
    pub threads: usize,
    /// Vector instructions that multiply and add.
    pub instructions: &'static str,
    /// Multiply-adds, lane operations per second.
    pub multiply_adds: Rates,
    /// Bytes read per second.
    pub bandwidth: Rates,
    lanes: usize,
    work: fn(u64),
    values: Vec<u64>,
}

impl Machine {
    pub fn new() -> Self {
        let (instructions, lanes, work) = best_loop();
        Self {
            threads: rayon::current_num_threads(),
            instructions,
            multiply_adds: Rates::default(),
            bandwidth: Rates::default(),
            lanes,
            work,
            // written, so that every page is there
            values: (0..VALUES as u64).into_par_iter().collect(),
        }
    }

    /// Measures once more.
    pub fn measure(&mut self) {
        let begin = Instant::now();
        rayon::broadcast(|_| (self.work)(ROUNDS));
        let operations = ROUNDS as f64 * (SUMS * self.lanes * self.threads) as f64;
        self.multiply_adds.0.push(operations / begin.elapsed().as_secs_f64());

        let begin = Instant::now();
        let total: u64 = self.values.par_chunks(VALUES / self.threads).map(sum).reduce(|| 0, u64::wrapping_add);
        black_box(total);
        self.bandwidth.0.push((8 * VALUES) as f64 / begin.elapsed().as_secs_f64());
    }
}

fn sum(values: &[u64]) -> u64 {
    // eight chains of additions: memory shall be what limits, also where vectors are short
    let mut sums = [0u64; 8];
    for chunk in values.chunks_exact(8) {
        sums.iter_mut().zip(chunk).for_each(|(sum, value)| *sum = sum.wrapping_add(*value));
    }
    sums.iter().fold(0, |total, sum| total.wrapping_add(*sum))
}

#[cfg(target_arch = "x86_64")]
fn best_loop() -> Loop {
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx512f")]
    fn wide(rounds: u64) {
        let (factor, addend) = (_mm512_set1_ps(black_box(0.999)), _mm512_set1_ps(black_box(0.001)));
        let mut sums = [factor; SUMS];
        for _ in 0..rounds {
            for sum in &mut sums {
                *sum = _mm512_fmadd_ps(*sum, factor, addend);
            }
        }
        black_box(sums);
    }

    #[target_feature(enable = "avx2,fma")]
    fn narrow(rounds: u64) {
        let (factor, addend) = (_mm256_set1_ps(black_box(0.999)), _mm256_set1_ps(black_box(0.001)));
        let mut sums = [factor; SUMS];
        for _ in 0..rounds {
            for sum in &mut sums {
                *sum = _mm256_fmadd_ps(*sum, factor, addend);
            }
        }
        black_box(sums);
    }

    if std::is_x86_feature_detected!("avx512f") {
        // SAFETY: the machine has it
        ("AVX-512", 16, |rounds| unsafe { wide(rounds) })
    } else if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
        // SAFETY: the machine has it
        ("AVX2", 8, |rounds| unsafe { narrow(rounds) })
    } else {
        ("SSE2 (multiply, then add)", 4, plain)
    }
}

#[cfg(target_arch = "aarch64")]
fn best_loop() -> Loop {
    ("NEON", 4, fused)
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn best_loop() -> Loop {
    ("compiler's choice (multiply, then add)", 4, plain)
}

/// For machines whose every vector instruction set has a fused multiply-add.
#[cfg(target_arch = "aarch64")]
fn fused(rounds: u64) {
    repeat(rounds, |sum, factor, addend| sum.mul_add(factor, addend));
}

/// For machines without.
#[cfg(not(target_arch = "aarch64"))]
fn plain(rounds: u64) {
    repeat(rounds, |sum, factor, addend| sum * factor + addend);
}

#[inline(always)]
fn repeat(rounds: u64, step: impl Fn(f32, f32, f32) -> f32) {
    let (factor, addend) = (black_box(0.999f32), black_box(0.001f32));
    let mut sums = [[factor; 4]; SUMS];
    for _ in 0..rounds {
        for sum in &mut sums {
            for lane in sum {
                *lane = step(*lane, factor, addend);
            }
        }
    }
    black_box(sums);
}
