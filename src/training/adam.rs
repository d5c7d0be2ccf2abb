//! Adam: Kingma and Ba, arXiv:1412.6980, algorithm 1.

use crate::network::kernels::{Kernel, Lanes, Register, Simd, WIDTH};

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f32 = 1e-8;

/// One step's factors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Adam {
    simd: Simd,
    /// `rate / c1`, with `c1 = 1 - β1^t`
    rate: f32,
    /// `1 / sqrt(c2)`, with `c2 = 1 - β2^t`
    root_correction: f32,
}

/// `m = β1 m + (1 - β1) g`, `v = β2 v + (1 - β2) g²`, `p -= rate (m / c1) / (sqrt(v / c2) + ε)`
struct Update<'a> {
    adam: Adam,
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    mean: &'a mut [f32],
    square: &'a mut [f32],
}

impl Adam {
    /// For step number `step`, counted from 1.
    pub(super) fn new(step: u64, learning_rate: f64) -> Self {
        let correction = |beta: f64| 1.0 - beta.powf(step as f64);
        let rate = (learning_rate / correction(BETA1)) as f32;
        Self { simd: Simd::detect(), rate, root_correction: correction(BETA2).sqrt().recip() as f32 }
    }

    /// Updates a piece of the parameters; all slices are whole multiples of [`WIDTH`] of the same length.
    pub(super) fn update(self, parameters: &mut [f32], gradient: &[f32], mean: &mut [f32], square: &mut [f32]) {
        self.simd.run(Update { adam: self, parameters, gradient, mean, square });
    }
}

impl Kernel for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn run<R: Register, const N: usize>(self) {
        let Self { adam: Adam { rate, root_correction, .. }, parameters, gradient, mean, square } = self;
        let splat = Lanes::<R, N>::splat;
        let (rate, root_correction, epsilon) = (splat(-rate), splat(root_correction), splat(EPSILON));
        let (share, square_share) = (splat((1.0 - BETA1) as f32), splat((1.0 - BETA2) as f32));
        let parameters = parameters.as_chunks_mut::<WIDTH>().0.iter_mut();
        let gradient = gradient.as_chunks::<WIDTH>().0;
        let moments = mean.as_chunks_mut::<WIDTH>().0.iter_mut().zip(square.as_chunks_mut::<WIDTH>().0);
        for ((parameters, gradient), (mean, square)) in parameters.zip(gradient).zip(moments) {
            let (g, m, v) = (Lanes::load(gradient), Lanes::load(mean), Lanes::load(square));
            let m = g.sub(m).mul_add(share, m);
            let v = g.mul(g).sub(v).mul_add(square_share, v);
            let step = m.div(v.sqrt().mul_add(root_correction, epsilon));
            m.store(mean);
            v.store(square);
            step.mul_add(rate, Lanes::load(parameters)).store(parameters);
        }
    }
}
