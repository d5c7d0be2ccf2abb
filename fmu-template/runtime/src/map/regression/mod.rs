//! Models that are a formula in double precision: polynomials, forests of decision trees, sums of kernels.

mod forest;
mod kernel;
mod polynomial;
mod tensors;

use super::{
    Scaling,
    jet::{Jet, Number},
};
use crate::FormatError;
pub use forest::{Forest, LEAF, Node, Tree};
pub use kernel::{KernelMachine, KernelMachines};
pub use polynomial::Polynomial;

/// `y = mean + scale * function(z)` with `z = (x - mean) / scale`, all in double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// Scaling of inputs and outputs.
    pub scaling: Scaling,
    /// What lies between them.
    pub function: Function,
}

/// From standardised inputs to standardised outputs.
#[derive(Clone, Debug, PartialEq)]
pub enum Function {
    /// A polynomial in all inputs; a linear model is one of degree 1.
    Polynomial(Polynomial),
    /// Sums of decision trees: piecewise constant, so every derivative is 0.
    Forest(Forest),
    /// Sums of kernels around centres: support vector regression, Gaussian processes.
    Kernel(KernelMachines),
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct RegressionScratch {
    plain: Columns<f64>,
    curve: Columns<Jet>,
}

/// Numbers of one evaluation.
#[derive(Clone, Debug)]
struct Columns<N> {
    inputs: Vec<N>,
    outputs: Vec<N>,
    table: Vec<N>,
}

impl Regression {
    /// Number of input columns.
    pub fn inputs(&self) -> usize {
        self.scaling.input_mean.len()
    }

    /// Number of output columns.
    pub fn outputs(&self) -> usize {
        self.scaling.output_mean.len()
    }

    /// Makes sure that every number is finite and every index points at something.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub fn check(&self) -> Result<(), FormatError> {
        let (inputs, outputs) = (self.inputs(), self.outputs());
        if inputs == 0 {
            return Err(FormatError::NoVariables { what: "inputs" });
        }
        match &self.function {
            Function::Polynomial(polynomial) => polynomial.check(inputs, outputs),
            Function::Forest(forest) => forest.check(inputs, outputs),
            Function::Kernel(machines) => machines.check(inputs, outputs),
        }
    }

    /// Bytes of its numbers in the model file.
    pub fn bytes(&self) -> u64 {
        self.tensors().iter().map(|(.., content)| content.len() as u64).sum()
    }

    /// Working memory that fits.
    pub fn scratch(&self) -> RegressionScratch {
        let table = match &self.function {
            Function::Polynomial(polynomial) => polynomial.table_size(self.inputs()),
            Function::Forest(_) | Function::Kernel(_) => 0,
        };
        RegressionScratch {
            plain: Columns::new(self.inputs(), self.outputs(), table),
            curve: Columns::new(self.inputs(), self.outputs(), table),
        }
    }

    /// Outputs at one point. Does not allocate.
    ///
    /// # Panics
    /// If a slice has the wrong length, the scratch belongs to another model, or [`Regression::check`] fails.
    pub fn evaluate(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut RegressionScratch) {
        let Scaling { input_mean, input_scale, output_mean, output_scale } = &self.scaling;
        let columns = &mut scratch.plain;
        let standardised = inputs.iter().zip(input_mean).zip(input_scale);
        columns.inputs.iter_mut().zip(standardised).for_each(|(z, ((x, mean), scale))| *z = (x - mean) / scale);
        self.function.evaluate(columns);
        for ((y, z), (mean, scale)) in
            outputs.iter_mut().zip(&columns.outputs).zip(output_mean.iter().zip(output_scale))
        {
            *y = mean + scale * z;
        }
    }

    /// First and second derivative of the outputs along a curve; see [`crate::Evaluator::along_curve`].
    pub(crate) fn along_curve(
        &self,
        inputs: &[f64],
        rates: [&[f64]; 2],
        first: &mut [f64],
        second: Option<&mut [f64]>,
        scratch: &mut RegressionScratch,
    ) {
        let rate = |order: usize, column: usize| rates[order].get(column).copied().unwrap_or(0.0);
        self.evaluate_jets(inputs, |column| [rate(0, column), rate(1, column)], scratch);
        let outputs = scratch.curve.outputs.iter().zip(&self.scaling.output_scale);
        first.iter_mut().zip(outputs.clone()).for_each(|(dy, (z, scale))| *dy = z.first * scale);
        for (ddy, (z, scale)) in second.into_iter().flatten().zip(outputs) {
            *ddy = z.second * scale;
        }
    }

    /// `J^T weights`; see [`crate::Evaluator::adjoint`].
    pub(crate) fn adjoint(
        &self,
        inputs: &[f64],
        weights: &[f64],
        gradient: &mut [f64],
        scratch: &mut RegressionScratch,
    ) {
        for (wanted, slope) in gradient.iter_mut().enumerate() {
            self.evaluate_jets(inputs, |column| [f64::from(u8::from(column == wanted)), 0.0], scratch);
            let outputs = scratch.curve.outputs.iter().zip(&self.scaling.output_scale).zip(weights);
            *slope = outputs.map(|((z, scale), weight)| weight * scale * z.first).sum();
        }
    }

    fn evaluate_jets(&self, inputs: &[f64], rates: impl Fn(usize) -> [f64; 2], scratch: &mut RegressionScratch) {
        let Scaling { input_mean, input_scale, .. } = &self.scaling;
        let standardised = inputs.iter().zip(input_mean).zip(input_scale).enumerate();
        for (z, (column, ((x, mean), scale))) in scratch.curve.inputs.iter_mut().zip(standardised) {
            let [first, second] = rates(column);
            *z = Jet { value: (x - mean) / scale, first: first / scale, second: second / scale };
        }
        self.function.evaluate(&mut scratch.curve);
    }
}

impl Function {
    fn evaluate<N: Number>(&self, columns: &mut Columns<N>) {
        let Columns { inputs, outputs, table } = columns;
        match self {
            Self::Polynomial(polynomial) => polynomial.evaluate(inputs, outputs, table),
            Self::Forest(forest) => {
                outputs.fill(N::from(0.0));
                let add = |output: usize, more| outputs[output] = outputs[output] + N::from(more);
                forest.evaluate(|column| inputs[column].value(), add);
            }
            Self::Kernel(machines) => machines.evaluate(inputs, outputs),
        }
    }
}

impl<N: Number> Columns<N> {
    fn new(inputs: usize, outputs: usize, table: usize) -> Self {
        let zeros = |count| vec![N::from(0.0); count];
        Self { inputs: zeros(inputs), outputs: zeros(outputs), table: zeros(table) }
    }
}

#[cfg(test)]
mod tests;
