//! The traits of vectors and of kernels.

/// A vector of [`COUNT`](Self::COUNT) values.
///
/// # Safety
/// Every method may only run where the machine has the instruction set of the type. Loads and
/// stores need `COUNT` values at the pointer, at any alignment.
#[expect(clippy::missing_safety_doc, reason = "one section for all methods, above")]
pub trait Lanes: Copy {
    /// A truth value per lane.
    type Mask: Copy;
    /// Number of values; divides [`MAX_LANES`](crate::MAX_LANES).
    const COUNT: usize;
    /// Number of vectors that fit into the machine's registers; 0 where the compiler chooses the
    /// width of a vector.
    const REGISTERS: usize;

    /// Returns `value` in all lanes.
    unsafe fn splat(value: f32) -> Self;
    /// Reads `COUNT` values.
    unsafe fn load(from: *const f32) -> Self;
    /// Reads `COUNT` finite IEEE half floats.
    unsafe fn load_half(from: *const u16) -> Self;
    /// Writes `COUNT` values.
    unsafe fn store(self, to: *mut f32);

    /// self + other.
    unsafe fn add(self, other: Self) -> Self;
    /// self − other.
    unsafe fn sub(self, other: Self) -> Self;
    /// self · other.
    unsafe fn mul(self, other: Self) -> Self;
    /// self / other.
    unsafe fn div(self, other: Self) -> Self;
    /// Returns the lesser value of each lane. The result for NaN is unspecified.
    unsafe fn min(self, other: Self) -> Self;
    /// Returns the greater value of each lane. The result for NaN is unspecified.
    unsafe fn max(self, other: Self) -> Self;
    /// Returns self · factor + addend. The result is rounded once if the instruction set has a
    /// fused multiply-add, otherwise twice.
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// Returns addend − self · factor, rounded as [`mul_add`](Self::mul_add).
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self;
    /// Returns self · factor + addend. All machines except WebAssembly round the result once, so
    /// they give the same bits. [`Portable`](crate::Portable) may call a library function for each
    /// lane.
    unsafe fn fused_mul_add(self, factor: Self, addend: Self) -> Self;
    /// Returns addend − self · factor, rounded as [`fused_mul_add`](Self::fused_mul_add).
    unsafe fn fused_neg_mul_add(self, factor: Self, addend: Self) -> Self;

    /// self ≤ other; false for NaN.
    unsafe fn at_most(self, other: Self) -> Self::Mask;
    /// self < other; false for NaN.
    unsafe fn below(self, other: Self) -> Self::Mask;
    /// a ∧ b.
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// a ∨ b.
    unsafe fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Returns `self` where the mask is true, and `other` elsewhere.
    unsafe fn where_else(self, mask: Self::Mask, other: Self) -> Self;
    /// Returns the mask as one bit per lane; lane 0 is the lowest bit.
    unsafe fn bits(mask: Self::Mask) -> u32;

    /// Returns the lanes moved up by one; lane 0 of the result is the last lane of `before`.
    #[inline(always)]
    unsafe fn moved_up(self, before: Self) -> Self {
        let mut values = [0.0f32; 2 * crate::MAX_LANES];
        // SAFETY: the caller guarantees that the machine has the instruction set; a vector has at
        // most MAX_LANES lanes
        unsafe {
            before.store(values.as_mut_ptr());
            self.store(values.as_mut_ptr().add(Self::COUNT));
            Self::load(values.as_ptr().add(Self::COUNT - 1))
        }
    }

    /// Calls another kernel with the same type of vector, so with the same instruction set. With
    /// [`Pair`](crate::Pair) the call is inlined. With other vectors it is out of line, unless the
    /// compiler finds inlining cheap.
    unsafe fn call<K: Kernel>(args: K::Args<'_>) -> K::Output;

    /// Reads an array of exactly `COUNT` values.
    #[inline(always)]
    unsafe fn from_array<const N: usize>(values: &[f32; N]) -> Self {
        const { assert!(N == Self::COUNT, "expected an array of COUNT values") };
        // SAFETY: the caller guarantees that the machine has the instruction set; the array has
        // COUNT values
        unsafe { Self::load(values.as_ptr()) }
    }

    /// Returns the lanes as an array of exactly `COUNT` values.
    #[inline(always)]
    unsafe fn to_array<const N: usize>(self) -> [f32; N] {
        const { assert!(N == Self::COUNT, "expected an array of COUNT values") };
        let mut values = [0.0; N];
        // SAFETY: the caller guarantees that the machine has the instruction set; the array has
        // COUNT values
        unsafe { self.store(values.as_mut_ptr()) };
        values
    }
}

/// A computation that is compiled once per instruction set.
pub trait Kernel {
    /// Arguments; a tuple or a struct where there are several.
    type Args<'a>;
    /// Result.
    type Output;

    /// Runs the kernel. An implementation must be `#[inline(always)]`, otherwise the vector
    /// operations become calls.
    ///
    /// # Safety
    /// The machine has `V`'s instruction set, and the arguments are as this kernel demands.
    unsafe fn run<V: Lanes>(args: Self::Args<'_>) -> Self::Output;
}

/// A kernel compiled for one instruction set. Kernels with the same arguments and results have
/// functions of the same type.
pub type Function<K> = for<'a> unsafe fn(<K as Kernel>::Args<'a>) -> <K as Kernel>::Output;
