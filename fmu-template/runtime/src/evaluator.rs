//! The surrogate prepared for evaluation.

use crate::{
    Precision, Scaling, Surrogate,
    network::{Buffers, Network},
    simd::{PORTABLE_FMA, Real, Simd, fma},
};

/// Highest order of the outputs' derivatives along a curve: the FMU's `maxOutputDerivativeOrder`.
pub const MAX_OUTPUT_DERIVATIVE_ORDER: u32 = 2;

/// A [`Surrogate`] laid out for fast evaluation. Immutable: any number of threads may share it, each with a [`Scratch`]
/// of its own. No evaluation allocates.
///
/// Every method panics if a slice has the wrong length or the scratch belongs to another evaluator.
#[derive(Clone, Debug)]
pub struct Evaluator {
    scaling: Scaling,
    network: Layout,
    simd: Simd,
}

/// The network in the precision it computes in. Scaling is done in double precision either way.
#[derive(Clone, Debug)]
enum Layout {
    Double(Network<f64, 8>),
    Single(Network<f32, 16>),
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct Scratch(Memory);

#[derive(Clone, Debug)]
enum Memory {
    Double(Buffers<f64, 8>),
    Single(Buffers<f32, 16>),
}

/// What to compute at a point.
enum Task<'a> {
    Outputs(&'a mut [f64]),
    Series { rates: [&'a [f64]; 2], first: &'a mut [f64], second: Option<&'a mut [f64]> },
    Adjoint { weights: &'a [f64], gradient: &'a mut [f64] },
}

impl Evaluator {
    /// Lays out the weights and chooses the instruction set.
    pub fn new(surrogate: &Surrogate) -> Self {
        let network = match surrogate.metadata().precision {
            Precision::Double => Layout::Double(Network::new(surrogate)),
            Precision::Single => Layout::Single(Network::new(surrogate)),
        };
        Self { scaling: surrogate.scaling().clone(), network, simd: Simd::detect() }
    }

    /// Working memory that fits this evaluator.
    pub fn scratch(&self) -> Scratch {
        let inputs = self.scaling.input_mean.len();
        Scratch(match &self.network {
            Layout::Double(network) => Memory::Double(network.buffers(inputs)),
            Layout::Single(network) => Memory::Single(network.buffers(inputs)),
        })
    }

    /// Outputs at one point: `inputs` has one value per input column, `outputs` one per output column.
    pub fn evaluate(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut Scratch) {
        self.check_outputs(outputs);
        self.dispatch(inputs, Task::Outputs(outputs), scratch);
    }

    /// Directional derivative `J(inputs) direction`, exact but for rounding.
    pub fn directional(&self, inputs: &[f64], direction: &[f64], derivative: &mut [f64], scratch: &mut Scratch) {
        self.check_inputs(direction);
        self.check_outputs(derivative);
        let task = Task::Series { rates: [direction, &[]], first: derivative, second: None };
        self.dispatch(inputs, task, scratch);
    }

    /// First and second derivative of the outputs along a curve that is at `inputs` with the derivatives `rates` (first
    /// and second), exact but for rounding.
    pub fn along_curve(&self, inputs: &[f64], rates: [&[f64]; 2], derivatives: [&mut [f64]; 2], scratch: &mut Scratch) {
        rates.iter().for_each(|rate| self.check_inputs(rate));
        derivatives.iter().for_each(|derivative| self.check_outputs(derivative));
        let [first, second] = derivatives;
        self.dispatch(inputs, Task::Series { rates, first, second: Some(second) }, scratch);
    }

    /// Adjoint derivative `J(inputs)^T weights`, exact but for rounding.
    pub fn adjoint(&self, inputs: &[f64], weights: &[f64], gradient: &mut [f64], scratch: &mut Scratch) {
        self.check_inputs(gradient);
        self.check_outputs(weights);
        self.dispatch(inputs, Task::Adjoint { weights, gradient }, scratch);
    }

    fn check_inputs(&self, columns: &[f64]) {
        assert_eq!(columns.len(), self.scaling.input_mean.len(), "number of inputs");
    }

    fn check_outputs(&self, columns: &[f64]) {
        assert_eq!(columns.len(), self.scaling.output_mean.len(), "number of outputs");
    }

    #[inline]
    fn dispatch(&self, inputs: &[f64], task: Task, scratch: &mut Scratch) {
        self.check_inputs(inputs);
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Simd::detect` found these features
            Simd::Avx512 => unsafe { self.run_avx512(inputs, task, scratch) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above
            Simd::Avx2 => unsafe { self.run_avx2(inputs, task, scratch) },
            Simd::Portable => self.run::<PORTABLE_FMA>(inputs, task, scratch),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
    fn run_avx512(&self, inputs: &[f64], task: Task, scratch: &mut Scratch) {
        self.run::<true>(inputs, task, scratch);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2(&self, inputs: &[f64], task: Task, scratch: &mut Scratch) {
        self.run::<true>(inputs, task, scratch);
    }

    #[inline(always)]
    fn run<const FMA: bool>(&self, inputs: &[f64], task: Task, scratch: &mut Scratch) {
        match (&self.network, &mut scratch.0) {
            (Layout::Double(network), Memory::Double(buffers)) => {
                run::<f64, 8, FMA>(&self.scaling, network, inputs, task, buffers);
            }
            (Layout::Single(network), Memory::Single(buffers)) => {
                run::<f32, 16, FMA>(&self.scaling, network, inputs, task, buffers);
            }
            _ => panic!("the scratch belongs to another evaluator"),
        }
    }
}

#[inline(always)]
fn run<T: Real, const WIDTH: usize, const FMA: bool>(
    scaling: &Scaling,
    network: &Network<T, WIDTH>,
    inputs: &[f64],
    task: Task,
    buffers: &mut Buffers<T, WIDTH>,
) {
    let Scaling { input_mean, input_scale, output_mean, output_scale } = scaling;
    let standardised = inputs.iter().zip(input_mean).zip(input_scale);
    buffers.load(standardised.map(|((x, mean), scale)| (x - mean) / scale));
    match task {
        Task::Outputs(outputs) => {
            network.forward::<FMA>(buffers, outputs);
            for ((y, mean), scale) in outputs.iter_mut().zip(output_mean).zip(output_scale) {
                *y = fma::<f64, FMA>(*y, *scale, *mean);
            }
        }
        Task::Series { rates, first, mut second } => {
            for (order, rate) in (1..).zip(rates) {
                buffers.load_rates(order, rate.iter().zip(input_scale).map(|(rate, scale)| rate / scale));
            }
            network.series::<FMA>(buffers, first, second.as_deref_mut());
            let rescale = |derivative: &mut [f64]| {
                derivative.iter_mut().zip(output_scale).for_each(|(dy, scale)| *dy *= scale);
            };
            rescale(first);
            second.into_iter().for_each(rescale);
        }
        Task::Adjoint { weights, gradient } => {
            network.adjoint::<FMA>(buffers, weights.iter().zip(output_scale).map(|(weight, scale)| weight * scale));
            for ((dx, dz), scale) in gradient.iter_mut().zip(buffers.gradient()).zip(input_scale) {
                *dx = dz / scale;
            }
        }
    }
}

#[cfg(test)]
mod tests;
