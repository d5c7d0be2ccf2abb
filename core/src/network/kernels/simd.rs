//! One source for every instruction set: a kernel is compiled once for each set the processor may have, and the best one
//! is chosen when the program runs.

#[cfg(target_arch = "x86_64")]
use super::x86::{Avx2, Avx512};
use super::{Pair, Portable, SimdLanes};

/// Work on numbers. Its fields are its arguments.
pub(crate) trait SimdKernel {
    /// Result of the work.
    type Output;

    /// Does the work with [`L`](super::SimdLanes). To be marked `#[inline(always)]`, so that it is compiled with
    /// the caller's instruction set.
    fn run<L: SimdLanes>(self) -> Self::Output;
}

/// The instruction sets the kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InstructionSet {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Baseline of every processor of the target: SSE2 or NEON.
    Portable,
}

impl InstructionSet {
    /// The best set this processor has.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
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

    /// Runs a kernel with this instruction set.
    pub(crate) fn run<K: SimdKernel>(self, kernel: K) -> K::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `InstructionSet::detect` found these features
            Self::Avx512 => unsafe { run_avx512(kernel) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above
            Self::Avx2 => unsafe { run_avx2(kernel) },
            Self::Portable => kernel.run::<Pair<Pair<Pair<Portable>>>>(),
        }
    }

    /// Every set this processor has.
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

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
fn run_avx512<K: SimdKernel>(kernel: K) -> K::Output {
    kernel.run::<Pair<Avx512>>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_avx2<K: SimdKernel>(kernel: K) -> K::Output {
    kernel.run::<Pair<Pair<Avx2>>>()
}
