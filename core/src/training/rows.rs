//! The rows a network is trained on.

use super::TrainingError;
use crate::network::Network;

/// Standardized outputs no farther than this from zero in any row are those of a column that is constant, up to rounding.
const CONSTANT: f32 = 1e-6;

/// Standardized inputs and outputs, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingRows {
    n_inputs: usize,
    n_outputs: usize,
    inputs: Vec<f32>,
    outputs: Vec<f32>,
    recurrence: Option<Recurrence>,
    tangents: Option<Tangents>,
}

/// Derivatives of the rows along some directions, which the network is to match in addition to its outputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tangents {
    /// Number of directions.
    pub directions: usize,
    /// Derivatives of the standardized inputs: shape `[rows, directions, n_inputs]`.
    pub inputs: Vec<f32>,
    /// Derivatives of the standardized outputs: shape `[rows, directions, n_outputs]`.
    pub outputs: Vec<f32>,
    /// `true` for each output whose derivatives are known; the others are ignored.
    pub known: Vec<bool>,
}

/// How the inputs of a row follow from the outputs of rows before.
#[derive(Clone, Debug, PartialEq)]
pub struct Recurrence {
    /// Number of past outputs among the inputs: the first columns, those of the row before first, then those of the row before it.
    pub history: usize,
    /// `L`: shape `[outputs, inputs + 1]`, the last ones being constants.
    pub linear: Vec<f32>,
    /// `g`: one for each output.
    pub gains: Vec<f32>,
    /// The first row of each stretch.
    pub starts: Vec<u32>,
    /// Rows of a stretch.
    pub stretch: usize,
}

impl TrainingRows {
    /// `inputs` is `[rows, n_inputs]` and `outputs` `[rows, n_outputs]`, both row by row.
    ///
    /// # Errors
    /// - [`TrainingError::Shape`] if a number of columns is zero, a row is cut short, or there are more rows of one
    ///   than of the other;
    /// - [`TrainingError::NotFinite`] at the first value that is NaN or infinite.
    pub fn new(n_inputs: usize, n_outputs: usize, inputs: Vec<f32>, outputs: Vec<f32>) -> Result<Self, TrainingError> {
        let rows = inputs.len().checked_div(n_inputs).unwrap_or(0);
        if n_inputs == 0 || n_outputs == 0 || inputs.len() != rows * n_inputs || outputs.len() != rows * n_outputs {
            let (inputs, outputs) = (inputs.len(), outputs.len());
            return Err(TrainingError::Shape { n_inputs, n_outputs, inputs, outputs });
        }
        for (what, columns, values) in [("input", n_inputs, &inputs), ("output", n_outputs, &outputs)] {
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let (row, column) = (index / columns, index % columns);
                return Err(TrainingError::NotFinite { what, row, column, value: values[index] });
            }
        }
        Ok(Self { n_inputs, n_outputs, inputs, outputs, recurrence: None, tangents: None })
    }

    /// Adds derivatives. Networks with tanh or sigmoid learn them, without normalization and dropout.
    ///
    /// # Errors
    /// As [`TrainingRows::new`].
    pub fn with_tangents(self, tangents: Tangents) -> Result<Self, TrainingError> {
        let Tangents { directions, inputs, outputs, known } = &tangents;
        let rows = Self::new(self.n_inputs, self.n_outputs, inputs.clone(), outputs.clone())?.len();
        if rows != directions * self.len() || known.len() != self.n_outputs {
            let (inputs, outputs) = (inputs.len(), outputs.len());
            return Err(TrainingError::Shape { n_inputs: self.n_inputs, n_outputs: self.n_outputs, inputs, outputs });
        }
        Ok(Self { tangents: Some(tangents), ..self })
    }

    /// Derivatives, if there are any.
    pub fn tangents(&self) -> Option<&Tangents> {
        self.tangents.as_ref()
    }

    /// Adds a recurrence: the rows are trained by stretches.
    ///
    /// # Panics
    /// If the recurrence does not fit the rows.
    pub fn with_recurrence(self, recurrence: Recurrence) -> Self {
        let Self { n_inputs, n_outputs, .. } = self;
        let rows = self.inputs.len() / n_inputs;
        let fit = recurrence.starts.iter().all(|start| *start as usize + recurrence.stretch <= rows);
        assert!(recurrence.stretch > 0 && fit, "stretches of the rows");
        assert!(recurrence.history * n_outputs <= n_inputs, "past outputs are inputs");
        assert_eq!((recurrence.linear.len(), recurrence.gains.len()), ((n_inputs + 1) * n_outputs, n_outputs));
        Self { recurrence: Some(recurrence), ..self }
    }

    /// How inputs follow from outputs of rows before, if they do.
    pub fn recurrence(&self) -> Option<&Recurrence> {
        self.recurrence.as_ref()
    }

    /// Number of training items: rows, or stretches of them.
    pub fn len(&self) -> usize {
        self.recurrence.as_ref().map_or(self.inputs.len() / self.n_inputs, |recurrence| recurrence.starts.len())
    }

    /// Number of outputs that are compared with predictions: those of all rows, or of all stretches.
    pub(super) fn targets(&self) -> usize {
        self.len() * self.n_outputs * self.recurrence.as_ref().map_or(1, |recurrence| recurrence.stretch)
    }

    /// Returns true if there are no rows, or no stretches.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of input columns.
    pub fn n_inputs(&self) -> usize {
        self.n_inputs
    }

    /// Number of output columns.
    pub fn n_outputs(&self) -> usize {
        self.n_outputs
    }

    /// `[rows, n_inputs]`
    pub fn inputs(&self) -> &[f32] {
        &self.inputs
    }

    /// `[rows, n_outputs]`
    pub fn outputs(&self) -> &[f32] {
        &self.outputs
    }

    /// A hash of all values: distinguishes data, but is not cryptographic.
    pub fn digest(&self) -> u64 {
        let sizes = [self.n_inputs as u64, self.n_outputs as u64];
        let tangents = self.tangents.iter().flat_map(|tangents| tangents.inputs.iter().chain(&tangents.outputs));
        let values = self.inputs.iter().chain(&self.outputs).chain(tangents).map(|value| u64::from(value.to_bits()));
        // the multiplier is odd, thus every step is a permutation of the state
        sizes.into_iter().chain(values).fold(0, |state: u64, value| {
            let mixed = (state ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            mixed ^ (mixed >> 29)
        })
    }

    /// Tells the processor that a row is about to be read. Shuffled rows are not in its caches, and waiting for them one
    /// after the other takes a twentieth of a step.
    pub(super) fn prefetch(&self, row: usize) {
        #[cfg(target_arch = "x86_64")]
        for begin in [&self.inputs[row * self.n_inputs], &self.outputs[row * self.n_outputs]] {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            // SAFETY: SSE is part of x86-64, and a prefetch has no effect but on speed
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(begin).cast()) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = row;
    }
}

/// The network with an exact zero for outputs that are constant in the rows, as initial values are at their time point.
pub fn without_constants(network: &Network, rows: &TrainingRows) -> Network {
    let mut network = network.clone();
    for output in 0..rows.n_outputs() {
        if rows.outputs().iter().skip(output).step_by(rows.n_outputs()).all(|value| value.abs() <= CONSTANT) {
            network.clear_output(output);
        }
    }
    network
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_do_not_fit_their_columns_are_refused() {
        assert_eq!(TrainingRows::new(2, 1, vec![0.0; 6], vec![0.0; 3]).unwrap().len(), 3);
        assert!(TrainingRows::new(2, 1, Vec::new(), Vec::new()).unwrap().is_empty());
        for (n_inputs, n_outputs, inputs, outputs) in [(2, 1, 5, 2), (2, 1, 6, 2), (0, 1, 0, 3), (2, 0, 6, 0)] {
            let error = TrainingRows::new(n_inputs, n_outputs, vec![0.0; inputs], vec![0.0; outputs]).unwrap_err();
            assert_eq!(error, TrainingError::Shape { n_inputs, n_outputs, inputs, outputs });
        }
    }

    #[test]
    fn values_that_are_not_finite_are_located() {
        let error = TrainingRows::new(2, 1, vec![0.0, 1.0, 2.0, f32::INFINITY], vec![0.0; 2]).unwrap_err();
        assert_eq!(error.to_string(), "row 1, input column 1: inf is not finite");
        let error = TrainingRows::new(1, 2, vec![0.0; 2], vec![0.0, 1.0, f32::NAN, 3.0]).unwrap_err();
        assert_eq!(error.to_string(), "row 1, output column 0: NaN is not finite");
    }
}
