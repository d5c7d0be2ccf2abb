//! Numbers that one operation works on: a SIMD register, or two halves that are such themselves.
//!
//! All matrices are worked on in pieces of [`WIDTH`] columns: two AVX-512 registers, four AVX2 registers, eight NEON or SSE2
//! registers. Everything above this file is written once, for any [`SimdLanes`].

pub(crate) use crate::network::layout::WIDTH;

/// Numbers in single precision, and the operations that take an instruction (or a few) for each register.
///
/// Code for registers is only to be reached through [`InstructionSet::run`](super::InstructionSet::run), which has made
/// sure that the processor has the instructions.
pub(crate) trait SimdLanes: Copy {
    /// Number of lanes.
    const COUNT: usize;
    /// Rows of a product worked on together: with [`WIDTH`] columns, as many sums as registers can hold.
    const ROWS: usize;

    fn splat(value: f32) -> Self;
    /// The first [`COUNT`](Self::COUNT) numbers.
    fn load(from: &[f32]) -> Self;
    /// Into the first [`COUNT`](Self::COUNT) places.
    fn store(self, to: &mut [f32]);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    /// `self / other`, relative error below 2e-7, for `1e-30 < |other| < 1e30`.
    fn div(self, other: Self) -> Self;
    /// The square root, relative error below 2e-7 from 1e-30 to 1e30; below, something between 0 and 1e-15.
    fn sqrt(self) -> Self;
    /// `self * factor + addend`, rounded once where the processor can.
    fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// `limit` where `self > limit`, otherwise `self`, also where it is NaN.
    fn at_most(self, limit: Self) -> Self;
    /// 0 where `self < 0`, otherwise `self`, also where it is NaN.
    fn at_least_zero(self) -> Self;
    /// `self` where `condition > 0`, otherwise 0, also where the condition is NaN.
    fn where_positive(self, condition: Self) -> Self;
    fn abs(self) -> Self;
    /// The magnitude of `self` with the sign of `sign`.
    fn copysign(self, sign: Self) -> Self;
    /// `2^k` for the integer `k` in the low bits of the mantissa of `self`, `-126 <= k <= 127`.
    fn power_of_two(self) -> Self;
    /// `self`, or `-self` if the integer in the low bits of the mantissa of `number` is odd.
    fn alternate(self, number: Self) -> Self;
    /// The sum of all numbers, in an order that depends on the instruction set alone.
    fn sum(self) -> f32;
}

/// Registers with twice the numbers. Nested pairs replace an array of registers, because loops over the array are
/// slow to compile. In thousands of operations inlined into one function, they took a quarter of the crate's compile
/// time.
#[derive(Clone, Copy)]
pub(crate) struct Pair<L>(L, L);

impl<L: SimdLanes> SimdLanes for Pair<L> {
    const COUNT: usize = 2 * L::COUNT;
    const ROWS: usize = L::ROWS;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(L::splat(value), L::splat(value))
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..Self::COUNT];
        Self(L::load(from), L::load(&from[L::COUNT..]))
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..Self::COUNT];
        self.0.store(to);
        self.1.store(&mut to[L::COUNT..]);
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0.add(other.0), self.1.add(other.1))
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0.sub(other.0), self.1.sub(other.1))
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0.mul(other.0), self.1.mul(other.1))
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(self.0.div(other.0), self.1.div(other.1))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt(), self.1.sqrt())
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(self.0.mul_add(factor.0, addend.0), self.1.mul_add(factor.1, addend.1))
    }

    #[inline(always)]
    fn at_most(self, limit: Self) -> Self {
        Self(self.0.at_most(limit.0), self.1.at_most(limit.1))
    }

    #[inline(always)]
    fn at_least_zero(self) -> Self {
        Self(self.0.at_least_zero(), self.1.at_least_zero())
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        Self(self.0.where_positive(condition.0), self.1.where_positive(condition.1))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs(), self.1.abs())
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        Self(self.0.copysign(sign.0), self.1.copysign(sign.1))
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        Self(self.0.power_of_two(), self.1.power_of_two())
    }

    #[inline(always)]
    fn alternate(self, number: Self) -> Self {
        Self(self.0.alternate(number.0), self.1.alternate(number.1))
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        self.0.add(self.1).sum()
    }
}

/// Four numbers, in plain Rust: SSE2 on x86-64, NEON (whose fused multiply-add is part of the base instruction set) on
/// 64-bit ARM.
#[derive(Clone, Copy)]
pub(crate) struct Portable(f32, f32, f32, f32);

impl Portable {
    #[inline(always)]
    fn map(self, function: impl Fn(f32) -> f32) -> Self {
        Self(function(self.0), function(self.1), function(self.2), function(self.3))
    }

    #[inline(always)]
    fn zip(self, other: Self, function: impl Fn(f32, f32) -> f32) -> Self {
        Self(function(self.0, other.0), function(self.1, other.1), function(self.2, other.2), function(self.3, other.3))
    }
}

impl SimdLanes for Portable {
    const COUNT: usize = 4;
    // 64-bit ARM has 32 registers, x86-64 without AVX 16
    const ROWS: usize = if cfg!(target_arch = "aarch64") { 3 } else { 1 };

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self(value, value, value, value)
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        Self(from[0], from[1], from[2], from[3])
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[..4].copy_from_slice(&[self.0, self.1, self.2, self.3]);
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // without fused multiply-add in hardware, `mul_add` would be a slow library call
        if cfg!(target_arch = "aarch64") {
            Self(
                self.0.mul_add(factor.0, addend.0),
                self.1.mul_add(factor.1, addend.1),
                self.2.mul_add(factor.2, addend.2),
                self.3.mul_add(factor.3, addend.3),
            )
        } else {
            self.mul(factor).add(addend)
        }
    }

    #[inline(always)]
    fn at_most(self, limit: Self) -> Self {
        self.zip(limit, |x, limit| if x > limit { limit } else { x })
    }

    #[inline(always)]
    fn at_least_zero(self) -> Self {
        self.map(|x| if x < 0.0 { 0.0 } else { x })
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        self.zip(condition, |x, condition| if condition > 0.0 { x } else { 0.0 })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.map(f32::abs)
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        self.zip(sign, f32::copysign)
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        self.map(|x| f32::from_bits((x.to_bits() << 23).wrapping_add(127 << 23)))
    }

    #[inline(always)]
    fn alternate(self, number: Self) -> Self {
        self.zip(number, |x, number| f32::from_bits(x.to_bits() ^ (number.to_bits() << 31)))
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        (self.0 + self.2) + (self.1 + self.3)
    }
}
