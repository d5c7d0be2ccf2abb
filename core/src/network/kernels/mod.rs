//! Compute kernels: matrix products in single precision with everything that surrounds them in a network's training.
//!
//! All products are of the same kind: rows times a panel of [`WIDTH`] = 32 columns, summed up in registers over the
//! inner dimension. Three choices make this faster than a general product on networks as small as these. Weights are
//! kept in panels, so nothing is packed. Products with few inputs or outputs are not padded. A block's panel gets its
//! activation or derivative while it is in the cache nearest to the core.
//!
//! Activations are not applied in the registers of the product, although that would save a load and a store. Seven
//! activations in every tile of every instruction set took the compiler minutes, for one percent of a step.
//!
//! - [`lanes`](mod@lanes): SIMD registers of each instruction set
//! - [`simd`]: the choice of the instruction set when the program runs
//! - [`product`]: the product
//! - [`activation`]: activation functions and their derivatives
//! - [`transpose`](mod@transpose): the transpose
//! - [`layer`]: forward pass, backward pass and gradient of a layer
//! - [`batch_norm`]: normalization over the rows of a block
//! - [`matrix`]: products of small matrices
//! - [`buffer`]: memory that begins at a cache line

pub(crate) mod activation;
pub(crate) mod batch_norm;
pub(crate) mod buffer;
mod lanes;
pub(crate) mod layer;
pub(crate) mod matrix;
mod product;
mod simd;
mod transpose;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use lanes::{Pair, Portable, SimdLanes, WIDTH};
pub(crate) use product::{Left, Panel, Store, lanes, lanes_mut, product};
pub(crate) use simd::{InstructionSet, SimdKernel};
pub(crate) use transpose::transpose;
