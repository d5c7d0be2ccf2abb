//! The surrogate prepared for evaluation.

use crate::{
    Activation, Encoder, Model, Precision, ScaledNetwork, Scaling, Surrogate,
    network::{Buffers, Network},
    regression::{Regression, RegressionScratch},
    series::{Instants, Sides},
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
    inputs: usize,
    outputs: usize,
    /// What makes columns of the inputs, if some are not what they are.
    encoder: Option<Encoder>,
    columns: usize,
    layouts: Layouts,
    /// The networks' instants, if there are several.
    instants: Option<Instants>,
    simd: Simd,
}

/// The model prepared for evaluation: networks in the precision they compute in, or a formula. Scaling is done in double
/// precision either way.
#[derive(Clone, Debug)]
enum Layouts {
    Double(Vec<Scaled<f64, 8>>),
    Single(Vec<Scaled<f32, 16>>),
    Regression(Regression),
}

/// A network laid out, with its scaling.
#[derive(Clone, Debug)]
struct Scaled<T, const WIDTH: usize> {
    scaling: Scaling,
    network: Network<T, WIDTH>,
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct Scratch {
    memory: Memory,
    sides: Option<Sides>,
    columns: Option<Columns>,
}

/// Columns of the network after the inputs' encoding: their values, rates along a curve, and adjoint derivatives.
#[derive(Clone, Debug)]
struct Columns {
    point: Vec<f64>,
    rates: [Vec<f64>; 2],
    gradient: Vec<f64>,
}

#[derive(Clone, Debug)]
enum Memory {
    Double(Buffers<f64, 8>),
    Single(Buffers<f32, 16>),
    Regression(RegressionScratch),
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
        let metadata = surrogate.metadata();
        let encoder = Encoder::of(surrogate.inputs());
        let laid_out = |networks: &[ScaledNetwork]| match metadata.precision {
            Precision::Double => Layouts::Double(laid_out(networks, metadata.activation)),
            Precision::Single => Layouts::Single(laid_out(networks, metadata.activation)),
        };
        let (layouts, instants) = match surrogate.model() {
            Model::Network(network) => (laid_out(std::slice::from_ref(network)), None),
            Model::Series { instants, networks } => {
                let time = surrogate.time_column().expect("a series has a time column");
                (laid_out(networks), Some(Instants::new(instants, encoder.first_column(time))))
            }
            Model::Regression(regression) => (Layouts::Regression(regression.clone()), None),
        };
        Self {
            inputs: metadata.inputs.len(),
            outputs: metadata.outputs.len(),
            columns: encoder.width(),
            encoder: (!encoder.is_plain()).then_some(encoder),
            layouts,
            instants,
            simd: Simd::detect(),
        }
    }

    /// Working memory that fits this evaluator.
    pub fn scratch(&self) -> Scratch {
        // the layers of all networks have the same sizes
        let memory = match &self.layouts {
            Layouts::Double(networks) => Memory::Double(networks[0].network.buffers(self.columns)),
            Layouts::Single(networks) => Memory::Single(networks[0].network.buffers(self.columns)),
            Layouts::Regression(regression) => Memory::Regression(regression.scratch()),
        };
        let sides = self.instants.is_some().then(|| Sides::new(self.columns - 1, self.outputs));
        let zeros = || vec![0.0; self.columns];
        let columns =
            self.encoder.is_some().then(|| Columns { point: zeros(), rates: [zeros(), zeros()], gradient: zeros() });
        Scratch { memory, sides, columns }
    }

    /// Outputs at one point: `inputs` has one value per input, `outputs` one per output column.
    pub fn evaluate(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut Scratch) {
        self.check_outputs(outputs);
        self.perform(inputs, Task::Outputs(outputs), scratch);
    }

    /// Directional derivative `J(inputs) direction`, exact but for rounding.
    pub fn directional(&self, inputs: &[f64], direction: &[f64], derivative: &mut [f64], scratch: &mut Scratch) {
        self.check_inputs(direction);
        self.check_outputs(derivative);
        let task = Task::Series { rates: [direction, &[]], first: derivative, second: None };
        self.perform(inputs, task, scratch);
    }

    /// First and second derivative of the outputs along a curve that is at `inputs` with the derivatives `rates` (first
    /// and second), exact but for rounding.
    pub fn along_curve(&self, inputs: &[f64], rates: [&[f64]; 2], derivatives: [&mut [f64]; 2], scratch: &mut Scratch) {
        rates.iter().for_each(|rate| self.check_inputs(rate));
        derivatives.iter().for_each(|derivative| self.check_outputs(derivative));
        let [first, second] = derivatives;
        self.perform(inputs, Task::Series { rates, first, second: Some(second) }, scratch);
    }

    /// Adjoint derivative `J(inputs)^T weights`, exact but for rounding.
    pub fn adjoint(&self, inputs: &[f64], weights: &[f64], gradient: &mut [f64], scratch: &mut Scratch) {
        self.check_inputs(gradient);
        self.check_outputs(weights);
        self.perform(inputs, Task::Adjoint { weights, gradient }, scratch);
    }

    fn check_inputs(&self, inputs: &[f64]) {
        assert_eq!(inputs.len(), self.inputs, "number of inputs");
    }

    fn check_outputs(&self, outputs: &[f64]) {
        assert_eq!(outputs.len(), self.outputs, "number of outputs");
    }

    #[inline]
    fn perform(&self, inputs: &[f64], task: Task, scratch: &mut Scratch) {
        self.check_inputs(inputs);
        let Scratch { memory, sides, columns } = scratch;
        match (&self.encoder, columns) {
            (None, None) => self.compute(inputs, task, sides, memory),
            (Some(encoder), Some(columns)) => self.encode(encoder, inputs, task, columns, sides, memory),
            _ => panic!("the scratch belongs to another evaluator"),
        }
    }

    /// Does a task of the inputs with the columns after their encoding, by the chain rule.
    fn encode(
        &self,
        encoder: &Encoder,
        inputs: &[f64],
        task: Task,
        columns: &mut Columns,
        sides: &mut Option<Sides>,
        memory: &mut Memory,
    ) {
        let Columns { point, rates: [velocity, change], gradient: by_columns } = columns;
        encoder.encode(inputs, point);
        match task {
            Task::Outputs(outputs) => self.compute(point, Task::Outputs(outputs), sides, memory),
            Task::Series { rates, first, second } => {
                encoder.along_curve(point, rates, [velocity, change]);
                let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                self.compute(point, Task::Series { rates, first, second }, sides, memory);
            }
            Task::Adjoint { weights, gradient } => {
                self.compute(point, Task::Adjoint { weights, gradient: by_columns }, sides, memory);
                encoder.gradient(point, by_columns, gradient);
            }
        }
    }

    /// Does a task at the columns of the network.
    #[inline]
    fn compute(&self, columns: &[f64], task: Task, sides: &mut Option<Sides>, memory: &mut Memory) {
        match (&self.instants, sides) {
            (None, None) => self.dispatch(0, columns, task, memory),
            (Some(instants), Some(sides)) => self.interpolate(instants, columns, task, sides, memory),
            _ => panic!("the scratch belongs to another evaluator"),
        }
    }

    /// Does a task with the networks of the two instants around the moment, and takes what lies between.
    fn interpolate(&self, instants: &Instants, inputs: &[f64], task: Task, sides: &mut Sides, memory: &mut Memory) {
        let Sides { point, rates: point_rates, values, first: once, second: twice, gradient: gradients } = sides;
        let place = instants.place(inputs[instants.time()]);
        instants.others(inputs, point);
        if let Task::Outputs(outputs) = task {
            let [_, right] = values;
            self.dispatch(place.left, point, Task::Outputs(outputs), memory);
            if place.weight != 0.0 {
                self.dispatch(place.left + 1, point, Task::Outputs(right), memory);
                outputs.iter_mut().zip(right).for_each(|(left, right)| *left = place.between(*left, *right));
            }
            return;
        }
        for (side, values) in values.iter_mut().enumerate() {
            self.dispatch(place.left + side, point, Task::Outputs(values), memory);
        }
        match task {
            Task::Outputs(_) => {}
            Task::Series { rates, first, second } => {
                // of the weight along the curve
                let [rate, acceleration] =
                    rates.map(|rates| rates.get(instants.time()).map_or(0.0, |rate| place.slope * rate));
                for (to, from) in point_rates.iter_mut().zip(rates) {
                    instants.others(from, to);
                }
                for side in [0, 1] {
                    let [velocity, change] = &*point_rates;
                    let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                    let second = second.is_some().then_some(twice[side].as_mut_slice());
                    let task = Task::Series { rates, first: &mut once[side], second };
                    self.dispatch(place.left + side, point, task, memory);
                }
                for (output, first) in first.iter_mut().enumerate() {
                    let [left, right] = [0, 1].map(|side| once[side][output]);
                    *first = place.between(left, right) + rate * (values[1][output] - values[0][output]);
                }
                for (output, second) in second.into_iter().flatten().enumerate() {
                    let [left, right] = [0, 1].map(|side| twice[side][output]);
                    *second = place.between(left, right)
                        + 2.0 * rate * (once[1][output] - once[0][output])
                        + acceleration * (values[1][output] - values[0][output]);
                }
            }
            Task::Adjoint { weights, gradient } => {
                for (side, gradient) in gradients.iter_mut().enumerate() {
                    self.dispatch(place.left + side, point, Task::Adjoint { weights, gradient }, memory);
                }
                let changes = values[1].iter().zip(&values[0]).map(|(right, left)| right - left);
                let by_time = place.slope * weights.iter().zip(changes).map(|(weight, by)| weight * by).sum::<f64>();
                let mut others =
                    gradients[0].iter().zip(&gradients[1]).map(|(left, right)| place.between(*left, *right));
                for (column, gradient) in gradient.iter_mut().enumerate() {
                    *gradient = if column == instants.time() { by_time } else { others.next().unwrap_or(0.0) };
                }
            }
        }
    }

    /// Does a task with the regression or with network `index`.
    #[inline]
    fn dispatch(&self, index: usize, inputs: &[f64], task: Task, memory: &mut Memory) {
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Simd::detect` found these features
            Simd::Avx512 => unsafe { self.run_avx512(index, inputs, task, memory) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above
            Simd::Avx2 => unsafe { self.run_avx2(index, inputs, task, memory) },
            Simd::Portable => self.run::<PORTABLE_FMA>(index, inputs, task, memory),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
    fn run_avx512(&self, index: usize, inputs: &[f64], task: Task, memory: &mut Memory) {
        self.run::<true>(index, inputs, task, memory);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2(&self, index: usize, inputs: &[f64], task: Task, memory: &mut Memory) {
        self.run::<true>(index, inputs, task, memory);
    }

    #[inline(always)]
    fn run<const FMA: bool>(&self, index: usize, inputs: &[f64], task: Task, memory: &mut Memory) {
        match (&self.layouts, memory) {
            (Layouts::Double(networks), Memory::Double(buffers)) => {
                run::<f64, 8, FMA>(&networks[index], inputs, task, buffers);
            }
            (Layouts::Single(networks), Memory::Single(buffers)) => {
                run::<f32, 16, FMA>(&networks[index], inputs, task, buffers);
            }
            (Layouts::Regression(regression), Memory::Regression(scratch)) => match task {
                Task::Outputs(outputs) => regression.evaluate(inputs, outputs, scratch),
                Task::Series { rates, first, second } => regression.along_curve(inputs, rates, first, second, scratch),
                Task::Adjoint { weights, gradient } => regression.adjoint(inputs, weights, gradient, scratch),
            },
            _ => panic!("the scratch belongs to another evaluator"),
        }
    }
}

fn laid_out<T: Real, const WIDTH: usize>(networks: &[ScaledNetwork], activation: Activation) -> Vec<Scaled<T, WIDTH>> {
    let scaled = |ScaledNetwork { scaling, layers }: &ScaledNetwork| Scaled {
        scaling: scaling.clone(),
        network: Network::new(layers, activation),
    };
    networks.iter().map(scaled).collect()
}

#[inline(always)]
fn run<T: Real, const WIDTH: usize, const FMA: bool>(
    scaled: &Scaled<T, WIDTH>,
    inputs: &[f64],
    task: Task,
    buffers: &mut Buffers<T, WIDTH>,
) {
    let Scaled { scaling: Scaling { input_mean, input_scale, output_mean, output_scale }, network } = scaled;
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
