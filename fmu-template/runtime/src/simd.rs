//! One source for every instruction set and both precisions. Functions are generic over the instruction set, `SIMD`,
//! and compiled once for each set the processor may have; the best one is chosen at run time.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;
use std::{
    fmt::Debug,
    ops::{Add, Div, Mul, Neg, Sub},
};

/// Instruction set, a parameter of generic functions: separate multiplications and additions.
pub(crate) const PLAIN: u8 = 0;
/// Fused multiply-add, and otherwise what the compiler makes of arrays.
pub(crate) const FUSED: u8 = 1;
/// AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
pub(crate) const AVX2: u8 = 2;
/// AVX-512 F and DQ, and the sets before.
pub(crate) const AVX512: u8 = 3;
/// Instruction set of every processor of the platform: fused multiply-add is in the base instruction set of 64-bit ARM.
pub(crate) const PORTABLE: u8 = if cfg!(target_arch = "aarch64") { FUSED } else { PLAIN };

/// Number type of a network's arithmetic: `f64` or `f32`, and nothing else, as the trait does not leave this crate.
pub(crate) trait Real:
    'static
    + Copy
    + Debug
    + PartialOrd
    + From<f32>
    + Into<f64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    const ZERO: Self;
    const ONE: Self;
    const IS_SINGLE: bool;
    /// Magnitudes below it become zero in weights and hidden values. Products and differences of the remaining values
    /// are never denormal, which would slow processors down severely. The flags of the host's thread that would make
    /// the processor do the same are left unchanged.
    const NEGLIGIBLE: Self;
    /// `2 log2 e`
    const TWO_LOG2_E: Self;
    /// 1.5 times two to the number of mantissa bits: a number added to it is rounded to an integer, which then stands
    /// in the low bits.
    const ROUND: Self;
    /// ln 2, or its first bits, so few that small multiples are exact.
    const LN2_HIGH: Self;
    /// The rest of ln 2, where it counts.
    const LN2_LOW: Option<Self>;
    /// The polynomial for `(2^r - 1) / r`, `|r| <= 1/2`, fitted at Chebyshev nodes: coefficients of falling powers, the
    /// first one apart.
    const EXP2: (Self, &'static [Self]);
    /// 1/n! for falling n down to 2, the first one apart; as many as count for arguments up to ln(2) / 2.
    const TAYLOR: (Self, &'static [Self]);
    /// From here on `tanh` rounds to one.
    const TANH_ONE: Self;
    /// `exp` of twice this is still finite.
    const EXP_HALF_MAX: Self;

    const INVERSE_PI: Self;
    /// π in parts: products of the first ones with small integers are (nearly) exact.
    const PI: [Self; 3];
    /// `-1/3!, 1/5!, ...`, falling, the first one apart; as many as count for arguments up to π / 2.
    const SINE: (Self, &'static [Self]);
    /// `-1/2!, 1/4!, ...`, falling, the first one apart; as many as count for arguments up to π / 2.
    const COSINE: (Self, &'static [Self]);
    /// `√(2/π)`
    const GELU_LINEAR: Self;
    /// `0.044715 √(2/π)`
    const GELU_CUBIC: Self;

    /// `sum + a * b`, lane by lane
    #[inline(always)]
    fn add_products<const SIMD: u8, const WIDTH: usize>(
        sum: &mut Lanes<Self, WIDTH>,
        a: &Lanes<Self, WIDTH>,
        b: &Lanes<Self, WIDTH>,
    ) {
        products_one_by_one::<Self, SIMD, WIDTH>(sum, a, b);
    }

    /// `sum + a * x`, lane by lane
    #[inline(always)]
    fn add_scaled<const SIMD: u8, const WIDTH: usize>(sum: &mut Lanes<Self, WIDTH>, a: &Lanes<Self, WIDTH>, x: Self) {
        products_one_by_one::<Self, SIMD, WIDTH>(sum, a, &Lanes([x; WIDTH]));
    }

    fn narrow(value: f64) -> Self;
    /// The numbers, if they are in double precision.
    fn doubles(numbers: &[Self]) -> Option<&[f64]>;
    fn doubles_mut(numbers: &mut [Self]) -> Option<&mut [f64]>;
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    fn abs(self) -> Self;
    fn copysign(self, sign: Self) -> Self;
    /// `2^k` of the integer in the low bits of `ROUND + k`.
    fn two_to_the(shifted: Self) -> Self;
    /// `self`, or `-self` if the integer `k` in the low bits of `ROUND + k` is odd.
    fn alternate(self, shifted: Self) -> Self;
}

/// `add_products` and `add_scaled` in the registers of x86-64: of loops over arrays, the compiler now and then takes registers
/// apart into single numbers.
#[cfg(target_arch = "x86_64")]
macro_rules! in_registers {
    (
        $load_512:ident, $store_512:ident, $splat_512:ident, $fused_512:ident,
        $load_256:ident, $store_256:ident, $splat_256:ident, $fused_256:ident
    ) => {
        #[inline(always)]
        fn add_products<const SIMD: u8, const WIDTH: usize>(
            sum: &mut Lanes<Self, WIDTH>,
            a: &Lanes<Self, WIDTH>,
            b: &Lanes<Self, WIDTH>,
        ) {
            const { assert!(WIDTH * size_of::<Self>() == 64) }
            let (to, from, by) = (sum.0.as_mut_ptr(), a.0.as_ptr(), b.0.as_ptr());
            match SIMD {
                // SAFETY: whoever is compiled for a set runs where `Simd::detect` found it; the arrays have 64 bytes
                AVX512 => unsafe { $store_512(to, $fused_512($load_512(from), $load_512(by), $load_512(to))) },
                // SAFETY: as above
                AVX2 => unsafe {
                    for at in [0, WIDTH / 2] {
                        let (from, by, to) = (from.add(at), by.add(at), to.add(at));
                        $store_256(to, $fused_256($load_256(from), $load_256(by), $load_256(to)));
                    }
                },
                _ => products_one_by_one::<Self, SIMD, WIDTH>(sum, a, b),
            }
        }

        #[inline(always)]
        fn add_scaled<const SIMD: u8, const WIDTH: usize>(
            sum: &mut Lanes<Self, WIDTH>,
            a: &Lanes<Self, WIDTH>,
            x: Self,
        ) {
            const { assert!(WIDTH * size_of::<Self>() == 64) }
            let (to, from) = (sum.0.as_mut_ptr(), a.0.as_ptr());
            match SIMD {
                // SAFETY: as above
                AVX512 => unsafe { $store_512(to, $fused_512($load_512(from), $splat_512(x), $load_512(to))) },
                // SAFETY: as above
                AVX2 => unsafe {
                    for at in [0, WIDTH / 2] {
                        let (from, to) = (from.add(at), to.add(at));
                        $store_256(to, $fused_256($load_256(from), $splat_256(x), $load_256(to)));
                    }
                },
                _ => products_one_by_one::<Self, SIMD, WIDTH>(sum, a, &Lanes([x; WIDTH])),
            }
        }
    };
}

impl Real for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const IS_SINGLE: bool = false;
    const NEGLIGIBLE: Self = 1e-100;
    const TWO_LOG2_E: Self = 2.0 * std::f64::consts::LOG2_E;
    const ROUND: Self = 6_755_399_441_055_744.0;
    const LN2_HIGH: Self = 0.693_147_180_369_123_8;
    const LN2_LOW: Option<Self> = Some(1.908_214_929_270_587_7e-10);
    // error at most 5e-17
    const EXP2: (Self, &'static [Self]) = (
        4.454_960_598_186_519e-10,
        &[
            7.072_585_949_269_223e-9,
            1.017_806_244_584_577_4e-7,
            1.321_544_258_792_169e-6,
            1.525_273_382_983_612e-5,
            1.540_353_044_173_605e-4,
            1.333_355_814_641_693_6e-3,
            9.618_129_107_606_888e-3,
            5.550_410_866_482_16e-2,
            0.240_226_506_959_100_97,
            std::f64::consts::LN_2,
        ],
    );
    // the first omitted term is below 1e-18 of the sum
    const TAYLOR: (Self, &'static [Self]) = (
        1.0 / 87_178_291_200.0,
        &[
            1.0 / 6_227_020_800.0,
            1.0 / 479_001_600.0,
            1.0 / 39_916_800.0,
            1.0 / 3_628_800.0,
            1.0 / 362_880.0,
            1.0 / 40_320.0,
            1.0 / 5_040.0,
            1.0 / 720.0,
            1.0 / 120.0,
            1.0 / 24.0,
            1.0 / 6.0,
            1.0 / 2.0,
        ],
    );
    const TANH_ONE: Self = 22.0;
    const EXP_HALF_MAX: Self = 350.0;
    const INVERSE_PI: Self = std::f64::consts::FRAC_1_PI;
    const PI: [Self; 3] = [3.141_592_621_803_283_7, 3.178_650_942_459_171_3e-8, 1.224_646_786_410_718_9e-16];
    // the first omitted terms are below 2e-18 and 2e-17
    const SINE: (Self, &'static [Self]) = (
        1.0 / 51_090_942_171_709_440_000.0,
        &[
            -1.0 / 121_645_100_408_832_000.0,
            1.0 / 355_687_428_096_000.0,
            -1.0 / 1_307_674_368_000.0,
            1.0 / 6_227_020_800.0,
            -1.0 / 39_916_800.0,
            1.0 / 362_880.0,
            -1.0 / 5_040.0,
            1.0 / 120.0,
            -1.0 / 6.0,
        ],
    );
    const COSINE: (Self, &'static [Self]) = (
        1.0 / 2_432_902_008_176_640_000.0,
        &[
            -1.0 / 6_402_373_705_728_000.0,
            1.0 / 20_922_789_888_000.0,
            -1.0 / 87_178_291_200.0,
            1.0 / 479_001_600.0,
            -1.0 / 3_628_800.0,
            1.0 / 40_320.0,
            -1.0 / 720.0,
            1.0 / 24.0,
            -1.0 / 2.0,
        ],
    );
    const GELU_LINEAR: Self = 0.797_884_560_802_865_4;
    const GELU_CUBIC: Self = 0.035_677_408_136_300_13;

    #[cfg(target_arch = "x86_64")]
    in_registers!(
        _mm512_loadu_pd,
        _mm512_storeu_pd,
        _mm512_set1_pd,
        _mm512_fmadd_pd,
        _mm256_loadu_pd,
        _mm256_storeu_pd,
        _mm256_set1_pd,
        _mm256_fmadd_pd
    );

    #[inline(always)]
    fn narrow(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn doubles(numbers: &[Self]) -> Option<&[f64]> {
        Some(numbers)
    }

    #[inline(always)]
    fn doubles_mut(numbers: &mut [Self]) -> Option<&mut [f64]> {
        Some(numbers)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        self.mul_add(factor, summand)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        self.copysign(sign)
    }

    #[inline(always)]
    fn two_to_the(shifted: Self) -> Self {
        Self::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52))
    }

    #[inline(always)]
    fn alternate(self, shifted: Self) -> Self {
        Self::from_bits(self.to_bits() ^ (shifted.to_bits() << 63))
    }
}

impl Real for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const IS_SINGLE: bool = true;
    const NEGLIGIBLE: Self = 1e-15;
    const TWO_LOG2_E: Self = 2.0 * std::f32::consts::LOG2_E;
    const ROUND: Self = 12_582_912.0;
    const LN2_HIGH: Self = std::f32::consts::LN_2;
    const LN2_LOW: Option<Self> = None;
    // error at most 8e-9
    const EXP2: (Self, &'static [Self]) =
        (1.546_144_8e-4, &[1.339_086_7e-3, 9.618_057e-3, 5.550_357e-2, 0.240_226_5, std::f32::consts::LN_2]);
    // the first omitted term is below 2e-8 of the sum
    const TAYLOR: (Self, &'static [Self]) =
        (1.0 / 5_040.0, &[1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 1.0 / 2.0]);
    const TANH_ONE: Self = 10.0;
    const EXP_HALF_MAX: Self = 43.0;
    const INVERSE_PI: Self = std::f32::consts::FRAC_1_PI;
    const PI: [Self; 3] = [3.140_625, 9.675_026e-4, 1.509_958e-7];
    // the first omitted terms are below 7e-10 and 7e-9
    const SINE: (Self, &'static [Self]) =
        (1.0 / 6_227_020_800.0, &[-1.0 / 39_916_800.0, 1.0 / 362_880.0, -1.0 / 5_040.0, 1.0 / 120.0, -1.0 / 6.0]);
    const COSINE: (Self, &'static [Self]) =
        (1.0 / 479_001_600.0, &[-1.0 / 3_628_800.0, 1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -1.0 / 2.0]);
    const GELU_LINEAR: Self = 0.797_884_6;
    const GELU_CUBIC: Self = 0.035_677_407;

    #[cfg(target_arch = "x86_64")]
    in_registers!(
        _mm512_loadu_ps,
        _mm512_storeu_ps,
        _mm512_set1_ps,
        _mm512_fmadd_ps,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_set1_ps,
        _mm256_fmadd_ps
    );

    #[inline(always)]
    fn narrow(value: f64) -> Self {
        value as Self
    }

    fn doubles(_: &[Self]) -> Option<&[f64]> {
        None
    }

    fn doubles_mut(_: &mut [Self]) -> Option<&mut [f64]> {
        None
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        self.mul_add(factor, summand)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        self.copysign(sign)
    }

    #[inline(always)]
    fn two_to_the(shifted: Self) -> Self {
        Self::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23))
    }

    #[inline(always)]
    fn alternate(self, shifted: Self) -> Self {
        Self::from_bits(self.to_bits() ^ (shifted.to_bits() << 31))
    }
}

#[inline(always)]
fn products_one_by_one<T: Real, const SIMD: u8, const WIDTH: usize>(
    sum: &mut Lanes<T, WIDTH>,
    a: &Lanes<T, WIDTH>,
    b: &Lanes<T, WIDTH>,
) {
    for (sum, (a, b)) in sum.0.iter_mut().zip(a.0.iter().zip(&b.0)) {
        *sum = fma::<T, SIMD>(*a, *b, *sum);
    }
}

/// Zero for what is negligible, see [`Real::NEGLIGIBLE`]; NaN stays NaN.
#[inline(always)]
pub(crate) fn flush<T: Real>(value: T) -> T {
    if value.abs() < T::NEGLIGIBLE { T::ZERO } else { value }
}

/// `a * b + c`, rounded once where the processor can (without FMA in hardware, `mul_add` would be a slow library call).
#[inline(always)]
pub(crate) fn fma<T: Real, const SIMD: u8>(a: T, b: T, c: T) -> T {
    if SIMD != PLAIN { a.mul_add(b, c) } else { a * b + c }
}

/// As many numbers as fit into 64 bytes: one AVX-512 register, two AVX2 registers, four NEON registers.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Lanes<T, const WIDTH: usize>(pub [T; WIDTH]);

impl<T: Real, const WIDTH: usize> Lanes<T, WIDTH> {
    pub(crate) const ZERO: Self = Self([T::ZERO; WIDTH]);
}

/// The numbers one after the other.
pub(crate) fn flat<T, const WIDTH: usize>(lanes: &[Lanes<T, WIDTH>]) -> &[T] {
    const { assert!(size_of::<Lanes<T, WIDTH>>() == WIDTH * size_of::<T>()) }
    // SAFETY: `Lanes` is `repr(C)` around `[T; WIDTH]` and as large as it, so the numbers lie one after the other
    unsafe { std::slice::from_raw_parts(lanes.as_ptr().cast(), lanes.len() * WIDTH) }
}

/// The numbers one after the other, to write.
pub(crate) fn flat_mut<T, const WIDTH: usize>(lanes: &mut [Lanes<T, WIDTH>]) -> &mut [T] {
    const { assert!(size_of::<Lanes<T, WIDTH>>() == WIDTH * size_of::<T>()) }
    // SAFETY: as in `flat`, and the borrow is exclusive
    unsafe { std::slice::from_raw_parts_mut(lanes.as_mut_ptr().cast(), lanes.len() * WIDTH) }
}

/// Computation that is compiled for each instruction set.
pub(crate) trait Compute {
    /// To be marked `#[inline(always)]`.
    fn run<const SIMD: u8>(self);
}

/// Runs what callers in several places share: one function for each instruction set, which the caller has.
#[inline(always)]
pub(crate) fn share<const SIMD: u8>(compute: impl Compute) {
    match SIMD {
        // SAFETY: whoever is compiled for a set runs where `Simd::detect` found it
        #[cfg(target_arch = "x86_64")]
        AVX512 => unsafe { run_avx512(compute) },
        // SAFETY: as above
        #[cfg(target_arch = "x86_64")]
        AVX2 => unsafe { run_avx2(compute) },
        _ => run_portable(compute),
    }
}

/// [`share`] with AVX2 where there is AVX-512, of what is rarely called: one function less in every FMU. The result is the
/// same, since lanes are added up in the same order.
#[inline(always)]
pub(crate) fn share_narrow<const SIMD: u8>(compute: impl Compute) {
    match SIMD {
        #[cfg(target_arch = "x86_64")]
        AVX512 => share::<AVX2>(compute),
        _ => share::<SIMD>(compute),
    }
}

#[cfg(target_arch = "x86_64")]
#[inline(never)]
#[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
fn run_avx512(compute: impl Compute) {
    compute.run::<AVX512>();
}

#[cfg(target_arch = "x86_64")]
#[inline(never)]
#[target_feature(enable = "avx2,fma")]
fn run_avx2(compute: impl Compute) {
    compute.run::<AVX2>();
}

#[inline(never)]
fn run_portable(compute: impl Compute) {
    compute.run::<PORTABLE>();
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
            // what is compiled for AVX-512 uses AVX2 and FMA too, which a virtual machine may hide
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            if avx2 && is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
                return Self::Avx512;
            }
            if avx2 {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// AVX2 instead of AVX-512, for what has few numbers at a time: it is not compiled once more. The result is the same.
    pub(crate) fn narrow(self) -> Self {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => Self::Avx2,
            other => other,
        }
    }

    /// Runs what is compiled for this set.
    #[inline]
    pub(crate) fn run(self, compute: impl Compute) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => share::<AVX512>(compute),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => share::<AVX2>(compute),
            Self::Portable => share::<PORTABLE>(compute),
        }
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
