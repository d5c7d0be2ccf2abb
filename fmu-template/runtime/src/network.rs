//! Feed-forward networks as they are trained: layers, and the scaling of columns and outputs.

use crate::{
    Activation, FormatError,
    check::{expect_finite, expect_positive, expect_shape},
    simd::Real,
};

/// A feed-forward network and the scaling of its columns.
///
/// With standardized inputs `z = (x - input_mean) / input_scale` and layers `h = f(W h + b)`, `f` the activation of the
/// layer, the outputs are `y = output_mean + output_scale * h` with the `h` of the last layer.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaledNetwork {
    /// Scaling of inputs and outputs.
    pub scaling: Scaling,
    /// The layers, first to last; at least one.
    pub layers: Vec<Layer>,
}

/// Column-wise affine scaling of inputs and outputs: `standardized = (value - mean) / scale`. Input columns are those after
/// the inputs' [`Encoding`](crate::Encoding).
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Means of the input columns.
    pub input_mean: Vec<f64>,
    /// Scales of the input columns, each positive.
    pub input_scale: Vec<f64>,
    /// Means of the output columns.
    pub output_mean: Vec<f64>,
    /// Scales of the output columns, each positive.
    pub output_scale: Vec<f64>,
}

/// One dense layer, `f(W x + b)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Number of columns of `W`.
    pub inputs: usize,
    /// Number of rows of `W`.
    pub outputs: usize,
    /// `W`, row by row: shape `[outputs, inputs]`, as in PyTorch's `Linear`.
    pub weight: Numbers,
    /// `b`: shape `[outputs]`.
    pub bias: Numbers,
    /// `f`; usually the identity in the last layer.
    pub activation: Activation,
}

/// Weights or biases, in the precision in which they were trained.
#[derive(Clone, Debug, PartialEq)]
pub enum Numbers {
    /// Single precision: what metafmu trains in.
    Single(Vec<f32>),
    /// Double precision.
    Double(Vec<f64>),
}

impl Numbers {
    /// Number of elements.
    pub fn len(&self) -> usize {
        match self {
            Self::Single(values) => values.len(),
            Self::Double(values) => values.len(),
        }
    }

    /// Returns true if there are no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number `index` in double precision, which is exact for either.
    ///
    /// # Panics
    /// If there is no such number.
    pub fn get(&self, index: usize) -> f64 {
        match self {
            Self::Single(values) => values[index].into(),
            Self::Double(values) => values[index],
        }
    }

    /// All of them in double precision.
    pub fn iter(&self) -> impl Iterator<Item = f64> + '_ {
        let (single, double): (&[f32], &[f64]) = match self {
            Self::Single(values) => (values, &[]),
            Self::Double(values) => (&[], values),
        };
        single.iter().map(|value| f64::from(*value)).chain(double.iter().copied())
    }

    /// Makes sure that all are finite.
    pub(crate) fn expect_finite(&self, name: impl std::fmt::Display) -> Result<(), FormatError> {
        // whole vectors at once: nearly always they are
        let is_finite = match self {
            Self::Single(values) => values.iter().fold(true, |all, value| all & value.is_finite()),
            Self::Double(values) => values.iter().fold(true, |all, value| all & value.is_finite()),
        };
        if is_finite { Ok(()) } else { expect_finite(name, self.iter()) }
    }

    /// The numbers, if they are in single precision.
    pub fn as_single(&self) -> Option<&[f32]> {
        match self {
            Self::Single(values) => Some(values),
            Self::Double(_) => None,
        }
    }
}

impl From<Vec<f32>> for Numbers {
    fn from(values: Vec<f32>) -> Self {
        Self::Single(values)
    }
}

impl From<Vec<f64>> for Numbers {
    fn from(values: Vec<f64>) -> Self {
        Self::Double(values)
    }
}

impl ScaledNetwork {
    /// Returns true if an input has a weight other than zero.
    pub fn reads(&self, input: usize) -> bool {
        self.layers.first().is_some_and(|layer| layer.weight.iter().skip(input).step_by(layer.inputs).any(|w| w != 0.0))
    }

    /// Sets the weights of some inputs to zero. Without effect on the outputs where these inputs are at their means.
    pub fn clear_inputs(&mut self, inputs: &[usize]) {
        let Some(layer) = self.layers.first_mut() else { return };
        for &input in inputs.iter().filter(|input| **input < layer.inputs) {
            match &mut layer.weight {
                Numbers::Single(values) => values.iter_mut().skip(input).step_by(layer.inputs).for_each(|w| *w = 0.0),
                Numbers::Double(values) => values.iter_mut().skip(input).step_by(layer.inputs).for_each(|w| *w = 0.0),
            }
        }
    }

    /// Sizes of the layers' outputs.
    pub fn sizes(&self) -> Vec<usize> {
        self.layers.iter().map(|layer| layer.outputs).collect()
    }

    pub(crate) fn check(&self, columns: usize, outputs: usize) -> Result<(), FormatError> {
        self.scaling.check(columns, outputs)?;
        if self.layers.is_empty() {
            return Err(FormatError::MissingTensor { name: "layers.0.weight".into() });
        }
        let mut width = columns;
        for (index, layer) in self.layers.iter().enumerate() {
            let rows = if index + 1 == self.layers.len() { outputs } else { layer.outputs };
            let (weight, bias) = (format!("layers.{index}.weight"), format!("layers.{index}.bias"));
            expect_shape(&weight, &[layer.outputs, layer.inputs], &[rows, width])?;
            expect_shape(&weight, &[layer.weight.len()], &[rows * width])?;
            expect_shape(&bias, &[layer.bias.len()], &[rows])?;
            layer.weight.expect_finite(&weight)?;
            layer.bias.expect_finite(&bias)?;
            width = rows;
        }
        Ok(())
    }
}

/// Typical magnitude of hidden values: the bound of most activations.
pub(crate) const USUAL_SIZE: f64 = 1.0;

/// Returns true if single precision adds only rounding errors to a product with columns of these magnitudes. It treats weights below 1e-15
/// as zero. Networks trained on standardized rows do not need them, but an output in coulomb may.
pub(crate) fn fits_single(weight: &Numbers, bias: &Numbers, sizes: &[f64]) -> bool {
    const SMALL: f64 = <f32 as Real>::NEGLIGIBLE as f64;
    /// Terms up to this share of the largest term of a sum are lost in rounding.
    const ROUNDING: f64 = 1e-8;
    if sizes.iter().any(|size| *size != 0.0 && *size < SMALL / ROUNDING) {
        return false;
    }
    let weights: Vec<f64> = weight.iter().collect();
    weights.chunks(sizes.len()).zip(bias.iter()).all(|(row, bias)| {
        let terms = row.iter().zip(sizes).map(|(weight, size)| (*weight, (weight * size).abs()));
        let terms: Vec<(f64, f64)> = terms.chain([(bias, bias.abs())]).collect();
        let largest = terms.iter().map(|(_, term)| *term).fold(0.0, f64::max);
        terms.iter().all(|(number, term)| number.abs() >= SMALL || *term <= ROUNDING * largest)
    })
}

impl Scaling {
    fn check(&self, inputs: usize, outputs: usize) -> Result<(), FormatError> {
        for (name, column, expected) in [
            ("input_mean", &self.input_mean, inputs),
            ("input_scale", &self.input_scale, inputs),
            ("output_mean", &self.output_mean, outputs),
            ("output_scale", &self.output_scale, outputs),
        ] {
            expect_shape(name, &[column.len()], &[expected])?;
            expect_finite(name, column.iter().copied())?;
            if name.ends_with("scale") {
                expect_positive(name, column)?;
            }
        }
        Ok(())
    }
}
