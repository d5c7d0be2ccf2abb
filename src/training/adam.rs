//! Adam: Kingma and Ba, arXiv:1412.6980, algorithm 1.

use crate::network::simd::{Kernel, Simd, fma};

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f32 = 1e-8;

/// Running means of the gradient and of its square, one value per parameter.
#[derive(Clone, Debug)]
pub(super) struct Adam {
    simd: Simd,
    steps: u64,
    mean: Vec<f32>,
    square: Vec<f32>,
}

/// `m = β1 m + (1 - β1) g`, `v = β2 v + (1 - β2) g²`, `p -= rate (m / c1) / (sqrt(v / c2) + ε)`
struct Update<'a> {
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    mean: &'a mut [f32],
    square: &'a mut [f32],
    /// `rate / c1`, with `c1 = 1 - β1^t`
    rate: f32,
    /// `1 / sqrt(c2)`, with `c2 = 1 - β2^t`
    root_correction: f32,
}

impl Adam {
    pub(super) fn new(parameters: usize) -> Self {
        Self { simd: Simd::detect(), steps: 0, mean: vec![0.0; parameters], square: vec![0.0; parameters] }
    }

    pub(super) fn step(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f64) {
        self.steps += 1;
        let correction = |beta: f64| 1.0 - beta.powf(self.steps as f64);
        let rate = (learning_rate / correction(BETA1)) as f32;
        let root_correction = correction(BETA2).sqrt().recip() as f32;
        let (mean, square) = (self.mean.as_mut_slice(), self.square.as_mut_slice());
        self.simd.run(Update { parameters, gradient, mean, square, rate, root_correction });
    }
}

impl Kernel for Update<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { parameters, gradient, mean, square, rate, root_correction } = self;
        let moments = mean.iter_mut().zip(square);
        for ((parameter, &gradient), (mean, square)) in parameters.iter_mut().zip(gradient).zip(moments) {
            *mean = fma::<FMA>((1.0 - BETA1) as f32, gradient - *mean, *mean);
            *square = fma::<FMA>((1.0 - BETA2) as f32, gradient * gradient - *square, *square);
            *parameter -= rate * *mean / fma::<FMA>(square.sqrt(), root_correction, EPSILON);
        }
    }
}
