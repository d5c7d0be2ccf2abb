//! One source for every instruction set: functions generic over the use of fused multiply-add are compiled once for
//! each set the processor may have, and the best one is chosen when the program runs.

/// Eight doubles, one AVX-512 register, two AVX2 registers, four NEON registers.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Lanes(pub [f64; Lanes::WIDTH]);

impl Lanes {
    pub(crate) const WIDTH: usize = 8;
    pub(crate) const ZERO: Self = Self([0.0; Self::WIDTH]);
}

/// `a * b + c`, rounded once where the processor can (without FMA in hardware, `mul_add` would be a slow library call).
#[inline(always)]
pub(crate) fn fma<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// The instruction sets the evaluation is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Simd {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

impl Simd {
    /// The best set this processor has.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// Every set this processor has, for tests.
    #[cfg(test)]
    pub(crate) fn available() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        match Self::detect() {
            Self::Avx512 => return vec![Self::Avx512, Self::Avx2, Self::Portable],
            Self::Avx2 => return vec![Self::Avx2, Self::Portable],
            Self::Portable => {}
        }
        vec![Self::Portable]
    }
}

/// Whether the portable code may use fused multiply-add: it is part of the base instruction set of 64-bit ARM.
pub(crate) const PORTABLE_FMA: bool = cfg!(target_arch = "aarch64");
