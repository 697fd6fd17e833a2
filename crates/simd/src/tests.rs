//! Compares every operation of every backend that this machine has with plain scalar code.

use crate::{Backend, Kernel, Lanes, MAX_LANES, float_from_half, nearest_half};

/// Values per operand: two of the longest vectors, so that every backend takes more than one step.
const LEN: usize = 2 * MAX_LANES;

/// Three operands.
type Operands = [[f32; LEN]; 3];
/// Name and result of every operation.
type Results = Vec<(&'static str, [f32; LEN])>;

/// Runs every operation on all operands.
struct Everything;

impl Kernel for Everything {
    type Args<'a> = &'a Operands;
    type Output = Results;

    #[inline(always)]
    unsafe fn run<V: Lanes>([a, b, c]: &Operands) -> Results {
        let mut results = Results::new();
        macro_rules! each {
            ($(|$x:ident, $y:ident, $z:ident| $name:literal: $result:expr),* $(,)?) => { $(
                let mut all = [0.0; LEN];
                for at in (0..LEN).step_by(V::COUNT) {
                    // SAFETY: The machine has the instruction set of V. LEN is a multiple of every
                    // lane count, so loads and stores stay inside the arrays.
                    unsafe {
                        let [$x, $y, $z] = [a, b, c].map(|operand| operand.as_ptr().add(at));
                        let [$x, $y, $z] = [V::load($x), V::load($y), V::load($z)];
                        let _ = ($x, $y, $z);
                        $result.store(all.as_mut_ptr().add(at));
                    }
                }
                results.push(($name, all));
            )* };
        }
        each!(
            |x, y, z| "load": x,
            |x, y, z| "splat": V::splat(1.25),
            |x, y, z| "add": x.add(y),
            |x, y, z| "sub": x.sub(y),
            |x, y, z| "mul": x.mul(y),
            |x, y, z| "div": x.div(y),
            |x, y, z| "min": x.min(y),
            |x, y, z| "max": x.max(y),
            |x, y, z| "fused_mul_add": x.fused_mul_add(y, z),
            |x, y, z| "fused_neg_mul_add": x.fused_neg_mul_add(y, z),
            |x, y, z| "mul_add": x.mul_add(y, z),
            |x, y, z| "neg_mul_add": x.neg_mul_add(y, z),
            |x, y, z| "at_most": x.where_else(x.at_most(y), z),
            |x, y, z| "below": x.where_else(x.below(y), z),
            |x, y, z| "both": x.where_else(V::both(x.below(y), y.below(z)), z),
            |x, y, z| "either": x.where_else(V::either(x.below(y), y.below(z)), z),
        );
        let mut bits = [0.0; LEN];
        for at in (0..LEN).step_by(V::COUNT) {
            // SAFETY: The machine has the instruction set of V. LEN is a multiple of every lane
            // count, so loads stay inside a and b.
            let mask = unsafe { V::bits(V::load(a.as_ptr().add(at)).below(V::load(b.as_ptr().add(at)))) };
            assert_eq!(mask.checked_shr(V::COUNT as u32).unwrap_or(0), 0, "bits above the last lane");
            (0..V::COUNT).for_each(|lane| bits[at + lane] = (mask >> lane & 1) as f32);
        }
        results.push(("bits", bits));
        // SAFETY: The machine has the instruction set of V. LEN is a multiple of every lane count,
        // so loads and stores stay inside the arrays.
        unsafe {
            let (mut moved, mut before) = ([0.0; LEN], V::splat(b[0]));
            for at in (0..LEN).step_by(V::COUNT) {
                let lanes = V::load(a.as_ptr().add(at));
                lanes.moved_up(before).store(moved.as_mut_ptr().add(at));
                before = lanes;
            }
            results.push(("moved_up", moved));
        }
        results
    }
}

/// [`Everything`], called from another kernel.
struct Caller;

impl Kernel for Caller {
    type Args<'a> = &'a Operands;
    type Output = Results;

    #[inline(always)]
    unsafe fn run<V: Lanes>(operands: &Operands) -> Results {
        // SAFETY: the machine has the instruction set of V
        unsafe { V::call::<Everything>(operands) }
    }
}

/// Reads half floats by the vectors' loads.
struct Halves;

impl Kernel for Halves {
    type Args<'a> = (&'a [u16], &'a mut [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((from, to): (&[u16], &mut [f32])) {
        for (from, to) in from.chunks_exact(V::COUNT).zip(to.chunks_exact_mut(V::COUNT)) {
            // SAFETY: the machine has the instruction set of V; both slices have COUNT values
            unsafe { V::load_half(from.as_ptr()).store(to.as_mut_ptr()) };
        }
    }
}

/// Returns the number of lanes, and an array after a load and a store.
struct Eight;

impl Kernel for Eight {
    type Args<'a> = [f32; 8];
    type Output = (usize, [f32; 8]);

    #[inline(always)]
    unsafe fn run<V: Lanes>(values: [f32; 8]) -> (usize, [f32; 8]) {
        let mut copy = [0.0; 8];
        // SAFETY: the machine has the instruction set of V; the copy has room for eight values, as
        // asserted
        unsafe {
            assert_eq!(V::COUNT, 8);
            V::load(values.as_ptr()).store(copy.as_mut_ptr());
        }
        (V::COUNT, copy)
    }
}

/// Returns operands of many magnitudes and signs, from a fixed sequence of numbers. Every fifth
/// value of `b` equals the value of `a` at the same index.
fn operands(seed: u32) -> Operands {
    let mut state = seed.wrapping_mul(0x9e37_79b9) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        // exponents from -20 to 20
        let exponent = 107 + state % 41;
        f32::from_bits((state & 0x8000_0000) | exponent << 23 | (state >> 8) & 0x7f_ffff)
    };
    let [mut a, mut b, mut c] = [[0.0; LEN]; 3];
    for i in 0..LEN {
        (a[i], b[i], c[i]) = (next(), next(), next());
        match i % 5 {
            0 => b[i] = a[i],
            // sums that nearly cancel show where rounding differs
            1 => c[i] = -(a[i] * b[i]),
            _ => {}
        }
    }
    [a, b, c]
}

/// Returns the expected results, computed value by value in scalar code.
fn expected([a, b, c]: &Operands, rounds_once: bool) -> Results {
    let each = |f: &dyn Fn(f32, f32, f32) -> f32| std::array::from_fn(|i| f(a[i], b[i], c[i]));
    let fused = |x: f32, y: f32, z: f32, once: bool| if once { x.mul_add(y, z) } else { x * y + z };
    let once = !cfg!(target_arch = "wasm32");
    vec![
        ("load", each(&|x, _, _| x)),
        ("splat", [1.25; LEN]),
        ("add", each(&|x, y, _| x + y)),
        ("sub", each(&|x, y, _| x - y)),
        ("mul", each(&|x, y, _| x * y)),
        ("div", each(&|x, y, _| x / y)),
        ("min", each(&|x, y, _| x.min(y))),
        ("max", each(&|x, y, _| x.max(y))),
        ("fused_mul_add", each(&|x, y, z| fused(x, y, z, once))),
        ("fused_neg_mul_add", each(&|x, y, z| fused(-x, y, z, once))),
        ("mul_add", each(&|x, y, z| fused(x, y, z, rounds_once))),
        ("neg_mul_add", each(&|x, y, z| fused(-x, y, z, rounds_once))),
        ("at_most", each(&|x, y, z| if x <= y { x } else { z })),
        ("below", each(&|x, y, z| if x < y { x } else { z })),
        ("both", each(&|x, y, z| if x < y && y < z { x } else { z })),
        ("either", each(&|x, y, z| if x < y || y < z { x } else { z })),
        ("bits", each(&|x, y, _| f32::from(u8::from(x < y)))),
        ("moved_up", std::array::from_fn(|i| if i == 0 { b[0] } else { a[i - 1] })),
    ]
}

fn assert_same(got: &Results, expected: &Results, of: &str) {
    assert_eq!(got.len(), expected.len());
    for ((name, got), (expected_name, expected)) in got.iter().zip(expected) {
        assert_eq!(name, expected_name);
        assert_eq!(got.map(f32::to_bits), expected.map(f32::to_bits), "{name} of {of}");
    }
}

#[test]
fn every_operation_of_every_backend_is_that_of_plain_numbers() {
    // WebAssembly with vectors has no other set.
    let first = if cfg!(all(target_arch = "wasm32", target_feature = "simd128")) { "simd128" } else { "portable" };
    assert_eq!(Backend::available()[0].to_string(), first);
    for (index, backend) in Backend::available().iter().enumerate() {
        // Portable code, the first set, rounds the product and then the sum, and so does
        // WebAssembly. All other sets round once.
        let rounds_once = index > 0 && !cfg!(target_arch = "wasm32");
        for seed in 0..100 {
            let operands = operands(seed);
            // SAFETY: the kernels make no demands
            let (direct, called, eight) = unsafe {
                (
                    backend.function::<Everything>()(&operands),
                    backend.function::<Caller>()(&operands),
                    backend.call_eight::<Everything>(&operands),
                )
            };
            let expected = expected(&operands, rounds_once);
            assert_same(&direct, &expected, &format!("{backend:?}"));
            assert_same(&called, &expected, &format!("{backend:?}, called by a kernel"));
            assert_same(&eight, &expected, &format!("eight lanes of {backend:?}"));
        }
    }
}

#[test]
fn comparisons_with_nan_are_false() {
    let mut operands = operands(1);
    operands[0].fill(f32::NAN);
    for backend in Backend::available() {
        // SAFETY: the kernel makes no demands
        let results = unsafe { backend.function::<Everything>()(&operands) };
        for (name, values) in results {
            if name == "at_most" || name == "below" {
                assert_eq!(values, operands[2], "{name} of {backend:?}");
            }
        }
    }
}

#[test]
fn every_finite_half_float_is_read_exactly() {
    // exponent 31 is infinity and NaN
    let halves: Vec<u16> = (0..=u16::MAX).filter(|half| half >> 10 & 31 != 31).collect();
    let exact = |half: u16| {
        let (exponent, mantissa) = (i32::from(half >> 10 & 31), f64::from(half & 1023));
        let magnitude = match exponent {
            0 => mantissa / 1024.0 * 2f64.powi(-14),
            _ => (1.0 + mantissa / 1024.0) * 2f64.powi(exponent - 15),
        };
        if half & 0x8000 == 0 { magnitude as f32 } else { -magnitude as f32 }
    };
    for &half in &halves {
        assert_eq!(float_from_half(half).to_bits(), exact(half).to_bits(), "{half:#x}");
    }
    for backend in Backend::available() {
        let mut read = vec![f32::NAN; halves.len()];
        // SAFETY: the kernel makes no demands
        unsafe { backend.function::<Halves>()((&halves, &mut read)) };
        for (&half, value) in halves.iter().zip(read) {
            assert_eq!(value.to_bits(), exact(half).to_bits(), "{half:#x} by {backend:?}");
        }
    }
}

#[test]
fn eight_lanes_are_eight_on_every_backend() {
    for backend in Backend::available() {
        let values = std::array::from_fn(|i| i as f32);
        // SAFETY: the kernel makes no demands
        assert_eq!(unsafe { backend.call_eight::<Eight>(values) }, (8, values), "{backend:?}");
        assert_eq!(MAX_LANES % backend.lanes(), 0);
    }
    assert_eq!(Some(&Backend::best()), Backend::available().last());
}

#[test]
fn the_nearest_half_float_is_no_farther_than_its_neighbours() {
    for bits in 0..0x7bffu16 {
        let (low, high) = (float_from_half(bits), float_from_half(bits + 1));
        let middle = 0.5 * (low + high);
        let even = bits + bits % 2;
        // an f32 has 13 more bits than a half float, so the middle of two half floats and its
        // neighbours are exact
        let around = [low, middle.next_down(), middle, middle.next_up(), high].map(nearest_half);
        assert_eq!(around, [bits, bits, even, bits + 1, bits + 1], "{bits}");
        assert_eq!(nearest_half(-low), bits | 0x8000);
    }
}
