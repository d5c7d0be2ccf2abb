//! AVX-512 and AVX2 registers.

use super::SimdLanes;
use std::arch::x86_64::*;

/// 16 numbers; AVX-512 F and DQ.
#[derive(Clone, Copy)]
pub(crate) struct Avx512(__m512);

/// 8 numbers; AVX2 and FMA.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(__m256);

// SAFETY (of every block in both implementations): the instructions exist, because `Simd::run` has checked the processor
// before anything here is reached (see `SimdLanes`); loads and stores are of slices whose length is checked.

impl SimdLanes for Avx512 {
    const COUNT: usize = 16;
    // 16 sums, 2 columns, and the broadcasts come from memory
    const ROWS: usize = 8;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_set1_ps(value) })
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..Self::COUNT];
        // SAFETY: as said above
        Self(unsafe { _mm512_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..Self::COUNT];
        // SAFETY: as said above
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) }
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_add_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_sub_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_mul_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        // SAFETY: as said above
        // the processor's own division takes as long as ten multiplications; two corrections of its 14-bit reciprocal
        Self(unsafe {
            let reciprocal = _mm512_rcp14_ps(other.0);
            let error = _mm512_fnmadd_ps(other.0, reciprocal, _mm512_set1_ps(1.0));
            let reciprocal = _mm512_fmadd_ps(reciprocal, error, reciprocal);
            let quotient = _mm512_mul_ps(self.0, reciprocal);
            let rest = _mm512_fnmadd_ps(quotient, other.0, self.0);
            _mm512_fmadd_ps(rest, reciprocal, quotient)
        })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: as said above
        // as for the division: the 14-bit reciprocal root, the root from it, and its correction
        Self(unsafe {
            let square = _mm512_max_ps(_mm512_set1_ps(1e-32), self.0);
            let reciprocal = _mm512_rsqrt14_ps(square);
            let root = _mm512_mul_ps(square, reciprocal);
            let rest = _mm512_fnmadd_ps(root, root, square);
            _mm512_fmadd_ps(rest, _mm512_mul_ps(reciprocal, _mm512_set1_ps(0.5)), root)
        })
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_fmadd_ps(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    fn at_most(self, limit: Self) -> Self {
        // the second operand is the result where one is NaN
        // SAFETY: as said above
        Self(unsafe { _mm512_min_ps(limit.0, self.0) })
    }

    #[inline(always)]
    fn at_least_zero(self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_max_ps(_mm512_setzero_ps(), self.0) })
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(condition.0, _mm512_setzero_ps());
            _mm512_maskz_mov_ps(positive, self.0)
        })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm512_abs_ps(self.0) })
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let bit = _mm512_set1_ps(-0.0);
            _mm512_or_ps(_mm512_andnot_ps(bit, self.0), _mm512_and_ps(bit, sign.0))
        })
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let exponent = _mm512_slli_epi32::<23>(_mm512_castps_si512(self.0));
            _mm512_castsi512_ps(_mm512_add_epi32(exponent, _mm512_set1_epi32(127 << 23)))
        })
    }

    #[inline(always)]
    fn alternate(self, number: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let sign = _mm512_slli_epi32::<31>(_mm512_castps_si512(number.0));
            _mm512_xor_ps(self.0, _mm512_castsi512_ps(sign))
        })
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: as said above
        unsafe { _mm512_reduce_add_ps(self.0) }
    }
}

impl SimdLanes for Avx2 {
    const COUNT: usize = 8;
    // 12 sums, 3 broadcasts, and the columns come from memory
    const ROWS: usize = 3;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_set1_ps(value) })
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..Self::COUNT];
        // SAFETY: as said above
        Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..Self::COUNT];
        // SAFETY: as said above
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_add_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_sub_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_mul_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_div_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    fn at_most(self, limit: Self) -> Self {
        // the second operand is the result where one is NaN
        // SAFETY: as said above
        Self(unsafe { _mm256_min_ps(limit.0, self.0) })
    }

    #[inline(always)]
    fn at_least_zero(self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_max_ps(_mm256_setzero_ps(), self.0) })
    }

    #[inline(always)]
    fn where_positive(self, condition: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let positive = _mm256_cmp_ps::<_CMP_GT_OQ>(condition.0, _mm256_setzero_ps());
            _mm256_and_ps(positive, self.0)
        })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: as said above
        Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }

    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let bit = _mm256_set1_ps(-0.0);
            _mm256_or_ps(_mm256_andnot_ps(bit, self.0), _mm256_and_ps(bit, sign.0))
        })
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(self.0));
            _mm256_castsi256_ps(_mm256_add_epi32(exponent, _mm256_set1_epi32(127 << 23)))
        })
    }

    #[inline(always)]
    fn alternate(self, number: Self) -> Self {
        // SAFETY: as said above
        Self(unsafe {
            let sign = _mm256_slli_epi32::<31>(_mm256_castps_si256(number.0));
            _mm256_xor_ps(self.0, _mm256_castsi256_ps(sign))
        })
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: as said above
        unsafe {
            let four = _mm_add_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)))
        }
    }
}
