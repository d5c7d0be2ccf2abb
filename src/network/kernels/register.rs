//! SIMD registers, and 32 numbers in as many of them as necessary.
//!
//! All matrices are worked on in pieces of [`WIDTH`] columns. [`Lanes`] is such a piece: two AVX-512 registers, four AVX2
//! registers, eight NEON or SSE2 registers. Everything above this file is written once, for `Lanes`.

/// Columns of a panel, numbers in a [`Lanes`]. Two AVX-512 registers hide the latency of what follows one after the other.
pub(crate) const WIDTH: usize = 32;

/// A SIMD register of single-precision numbers, and what one instruction (or a few) does to it.
///
/// Code for a register is only to be reached through [`Simd::run`](super::Simd::run), which has made sure that the
/// processor has the instructions.
pub(crate) trait Register: Copy {
    /// Numbers in a register.
    const LANES: usize;
    /// Rows of a product worked on together: with [`WIDTH`] columns, as many sums as registers can hold.
    const ROWS: usize;

    fn splat(value: f32) -> Self;
    /// The first [`LANES`](Self::LANES) numbers.
    fn load(from: &[f32]) -> Self;
    /// Into the first [`LANES`](Self::LANES) places.
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
    /// The sum of all numbers, in a fixed order.
    fn sum(self) -> f32;
}

/// [`WIDTH`] numbers: `N` registers.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<R, const N: usize>([R; N]);

// Loops and not closures: a closure is only inlined if the compiler likes it, and if it is not, it is not compiled with the
// caller's instruction set.
impl<R: Register, const N: usize> Lanes<R, N> {
    #[inline(always)]
    pub(crate) fn splat(value: f32) -> Self {
        Self([R::splat(value); N])
    }

    #[inline(always)]
    pub(crate) fn load(from: &[f32; WIDTH]) -> Self {
        let mut registers = [R::splat(0.0); N];
        for (register, from) in registers.iter_mut().zip(from.chunks_exact(R::LANES)) {
            *register = R::load(from);
        }
        Self(registers)
    }

    #[inline(always)]
    pub(crate) fn store(self, to: &mut [f32; WIDTH]) {
        for (register, to) in self.0.into_iter().zip(to.chunks_exact_mut(R::LANES)) {
            register.store(to);
        }
    }

    #[inline(always)]
    pub(crate) fn sqrt(mut self) -> Self {
        for register in &mut self.0 {
            *register = register.sqrt();
        }
        self
    }

    #[inline(always)]
    pub(crate) fn at_least_zero(mut self) -> Self {
        for register in &mut self.0 {
            *register = register.at_least_zero();
        }
        self
    }

    #[inline(always)]
    pub(crate) fn abs(mut self) -> Self {
        for register in &mut self.0 {
            *register = register.abs();
        }
        self
    }

    #[inline(always)]
    pub(crate) fn power_of_two(mut self) -> Self {
        for register in &mut self.0 {
            *register = register.power_of_two();
        }
        self
    }

    #[inline(always)]
    pub(crate) fn add(mut self, other: Self) -> Self {
        for (register, other) in self.0.iter_mut().zip(other.0) {
            *register = register.add(other);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn sub(mut self, other: Self) -> Self {
        for (register, other) in self.0.iter_mut().zip(other.0) {
            *register = register.sub(other);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn mul(mut self, other: Self) -> Self {
        for (register, other) in self.0.iter_mut().zip(other.0) {
            *register = register.mul(other);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn div(mut self, other: Self) -> Self {
        for (register, other) in self.0.iter_mut().zip(other.0) {
            *register = register.div(other);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn at_most(mut self, limit: Self) -> Self {
        for (register, limit) in self.0.iter_mut().zip(limit.0) {
            *register = register.at_most(limit);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn where_positive(mut self, condition: Self) -> Self {
        for (register, condition) in self.0.iter_mut().zip(condition.0) {
            *register = register.where_positive(condition);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn copysign(mut self, sign: Self) -> Self {
        for (register, sign) in self.0.iter_mut().zip(sign.0) {
            *register = register.copysign(sign);
        }
        self
    }

    #[inline(always)]
    pub(crate) fn alternate(mut self, number: Self) -> Self {
        for (register, number) in self.0.iter_mut().zip(number.0) {
            *register = register.alternate(number);
        }
        self
    }

    /// `self * factor + addend`
    #[inline(always)]
    pub(crate) fn mul_add(mut self, factor: Self, addend: Self) -> Self {
        for ((register, factor), addend) in self.0.iter_mut().zip(factor.0).zip(addend.0) {
            *register = register.mul_add(factor, addend);
        }
        self
    }

    /// The sum of all numbers, in an order that depends on the instruction set alone.
    #[inline(always)]
    pub(crate) fn sum(self) -> f32 {
        let mut total = self.0[0];
        for register in &self.0[1..] {
            total = total.add(*register);
        }
        total.sum()
    }
}

/// Four numbers, in plain Rust: SSE2 on x86-64, NEON (whose fused multiply-add is part of the base instruction set) on
/// 64-bit ARM.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; 4]);

impl Portable {
    #[inline(always)]
    fn map(self, function: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(function))
    }

    #[inline(always)]
    fn zip(self, other: Self, function: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| function(self.0[i], other.0[i])))
    }
}

impl Register for Portable {
    const LANES: usize = 4;
    // 64-bit ARM has 32 registers, x86-64 without AVX 16
    const ROWS: usize = if cfg!(target_arch = "aarch64") { 3 } else { 1 };

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 4])
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        Self([from[0], from[1], from[2], from[3]])
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[..4].copy_from_slice(&self.0);
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
        let fused = |i: usize| {
            // without fused multiply-add in hardware, `mul_add` would be a slow library call
            if cfg!(target_arch = "aarch64") {
                self.0[i].mul_add(factor.0[i], addend.0[i])
            } else {
                self.0[i] * factor.0[i] + addend.0[i]
            }
        };
        Self(std::array::from_fn(fused))
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
        (self.0[0] + self.0[2]) + (self.0[1] + self.0[3])
    }
}
