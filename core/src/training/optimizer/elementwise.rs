//! Optimizers that treat every parameter alike.

use super::Coefficients;
use crate::{
    network::kernels::{InstructionSet, SimdKernel, SimdLanes, WIDTH},
    study::Optimizer,
};

const EPSILON: f32 = 1e-8;

/// Magnitudes below which a mean and a mean square become zero. A step of such a mean is below the resolution of every parameter. The means
/// of a node that is never active would decay to numbers below 1e-38, which take a processor a hundred times as long.
const SMALL_MEAN: f32 = 1e-30;
const SMALL_SQUARE: f32 = 1e-36;

/// Factors of one elementwise step.
#[derive(Clone, Copy, Debug)]
pub(super) struct ElementwiseStep {
    rule: Optimizer,
    simd: InstructionSet,
    rate: f32,
    /// Share of the mean that is kept.
    momentum: f32,
    /// Share of the mean square that is replaced: `1 - β2`.
    square_share: f32,
    /// `1 / (1 - β1^t)`
    mean_correction: f32,
    /// `1 / sqrt(1 - β2^t)`
    root_correction: f32,
    /// `1 - rate * weight decay`
    kept: f32,
}

/// With the gradient `g` and the parameters `p`:
///
/// ```text
/// SGD            m = μ m + g                  p -= rate m
/// RMSprop        v = α v + (1 - α) g²         m = μ m + g / (√v + ε)    p -= rate m
/// Adam, AdamW    m = β1 m + (1 - β1) g        v = β2 v + (1 - β2) g²
///                p = (1 - rate decay) p - rate (m / c1) / (√(v / c2) + ε)
/// ```
struct Update<'a> {
    with: ElementwiseStep,
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    mean: &'a mut [f32],
    square: &'a mut [f32],
}

impl ElementwiseStep {
    /// For step number `step`, counted from 1.
    pub(super) fn new(rule: Optimizer, coefficients: &Coefficients, step: u64, learning_rate: f64) -> Self {
        let Coefficients { momentum, beta2, weight_decay, .. } = *coefficients;
        Self {
            rule,
            simd: InstructionSet::detect(),
            rate: learning_rate as f32,
            momentum: momentum as f32,
            square_share: (1.0 - beta2) as f32,
            mean_correction: correction(momentum, step) as f32,
            root_correction: correction(beta2, step).sqrt() as f32,
            kept: (1.0 - learning_rate * weight_decay) as f32,
        }
    }

    /// Updates a piece of the parameters; all slices are whole multiples of [`WIDTH`] of the same length.
    pub(super) fn update(self, parameters: &mut [f32], gradient: &[f32], mean: &mut [f32], square: &mut [f32]) {
        self.simd.run(Update { with: self, parameters, gradient, mean, square });
    }

    /// Adam's step without the learning rate: `(m / c1) / (√(v / c2) + ε)`, after the means have taken up `gradient`.
    #[inline(always)]
    pub(super) fn direction<L: SimdLanes>(&self, gradient: L, mean: &mut [f32; WIDTH], square: &mut [f32; WIDTH]) -> L {
        let (old_mean, old_square) = (L::load(mean), L::load(square));
        let new_mean = gradient.sub(old_mean).mul_add(L::splat(1.0 - self.momentum), old_mean);
        let new_square = gradient.mul(gradient).sub(old_square).mul_add(L::splat(self.square_share), old_square);
        let (new_mean, new_square) = (without_small(new_mean, SMALL_MEAN), without_small(new_square, SMALL_SQUARE));
        new_mean.store(mean);
        new_square.store(square);
        let root = new_square.sqrt().mul_add(L::splat(self.root_correction), L::splat(EPSILON));
        new_mean.mul(L::splat(self.mean_correction)).div(root)
    }

    /// `kept p - rate direction`
    pub(super) fn applied(&self, direction: f32, parameter: f32) -> f32 {
        self.kept * parameter - self.rate * direction
    }

    /// As [`applied`](Self::applied).
    #[inline(always)]
    fn apply<L: SimdLanes>(&self, direction: L, parameters: &mut [f32; WIDTH]) {
        let kept = L::load(parameters).mul(L::splat(self.kept));
        direction.mul_add(L::splat(-self.rate), kept).store(parameters);
    }
}

/// The numbers of at least a magnitude, zero for the others; NaN stays.
#[inline(always)]
fn without_small<L: SimdLanes>(numbers: L, least: f32) -> L {
    numbers.sub(numbers.where_positive(L::splat(least).sub(numbers.abs())))
}

impl SimdKernel for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { with, parameters, gradient, mean, square } = self;
        let momentum = L::splat(with.momentum);
        let parameters = parameters.as_chunks_mut::<WIDTH>().0.iter_mut().zip(gradient.as_chunks::<WIDTH>().0);
        let moments = mean.as_chunks_mut::<WIDTH>().0.iter_mut().zip(square.as_chunks_mut::<WIDTH>().0);
        for ((parameters, gradient), (mean, square)) in parameters.zip(moments) {
            let g = L::load(gradient);
            let direction = match with.rule {
                Optimizer::Adam | Optimizer::AdamW | Optimizer::Soap => with.direction(g, mean, square),
                Optimizer::Sgd => {
                    let m = without_small(momentum.mul_add(L::load(mean), g), SMALL_MEAN);
                    m.store(mean);
                    m
                }
                Optimizer::RmsProp => {
                    let v = L::load(square);
                    let v = g.mul(g).sub(v).mul_add(L::splat(with.square_share), v);
                    let v = without_small(v, SMALL_SQUARE);
                    v.store(square);
                    let m = momentum.mul_add(L::load(mean), g.div(v.sqrt().add(L::splat(EPSILON))));
                    let m = without_small(m, SMALL_MEAN);
                    m.store(mean);
                    m
                }
            };
            with.apply(direction, parameters);
        }
    }
}

/// Factor that makes up for the zeros a mean starts from.
fn correction(beta: f64, step: u64) -> f64 {
    (1.0 - beta.powf(step as f64)).recip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_without_a_gradient_become_zero_and_nan_stays() {
        for simd in InstructionSet::available() {
            for rule in [Optimizer::Adam, Optimizer::RmsProp, Optimizer::Sgd] {
                let step = ElementwiseStep {
                    rule,
                    simd,
                    rate: 1e-3,
                    momentum: 0.9,
                    square_share: 0.1,
                    mean_correction: 1.0,
                    root_correction: 1.0,
                    kept: 1.0,
                };
                let [mut parameters, mut mean, mut square] = [[0.0f32; WIDTH]; 3];
                let mut gradient = [1.0; WIDTH];
                (gradient[1], gradient[2]) = (f32::NAN, 1e-12);
                for _ in 0..2000 {
                    step.update(&mut parameters, &gradient, &mut mean, &mut square);
                    gradient[0] = 0.0;
                }
                assert_eq!((mean[0], square[0]), (0.0, 0.0), "{rule:?} {simd:?}");
                assert!(mean[1].is_nan() && parameters[1].is_nan(), "{rule:?} {simd:?}");
                assert!(mean[2] > 9e-13, "{rule:?} {simd:?}: {mean:?}");
            }
        }
    }
}
