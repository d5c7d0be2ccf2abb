//! The rows a baseline is fitted to.

use metafmu_runtime::Scaling;

/// Standardized rows in double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct StandardizedRows {
    /// Number of input columns: parameters, then time.
    pub inputs: usize,
    /// Number of output columns.
    pub outputs: usize,
    /// Shape `[rows, inputs]`.
    pub x: Vec<f64>,
    /// Shape `[rows, outputs]`.
    pub y: Vec<f64>,
    /// From the columns of the study to these.
    pub scaling: Scaling,
}

impl StandardizedRows {
    /// Standardizes rows: `x` of shape `[rows, inputs]` and `y` of shape `[rows, outputs]` in the study's units.
    pub fn new(mut x: Vec<f64>, mut y: Vec<f64>, scaling: Scaling) -> Self {
        let Scaling { input_mean, input_scale, output_mean, output_scale } = &scaling;
        for (values, means, scales) in [(&mut x, input_mean, input_scale), (&mut y, output_mean, output_scale)] {
            let columns = means.iter().zip(scales).cycle();
            values.iter_mut().zip(columns).for_each(|(value, (mean, scale))| *value = (*value - mean) / scale);
        }
        Self { inputs: input_mean.len(), outputs: output_mean.len(), x, y, scaling }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.x.len() / self.inputs
    }

    /// Returns true if there are no rows.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Some of the rows, in this order.
    #[must_use]
    pub fn choose(&self, chosen: &[usize]) -> Self {
        let x = chosen.iter().flat_map(|&row| &self.x[row * self.inputs..][..self.inputs]);
        let y = chosen.iter().flat_map(|&row| &self.y[row * self.outputs..][..self.outputs]);
        Self { x: x.copied().collect(), y: y.copied().collect(), ..self.without_rows() }
    }

    fn without_rows(&self) -> Self {
        Self { x: Vec::new(), y: Vec::new(), scaling: self.scaling.clone(), ..*self }
    }

    /// Column of the outputs.
    pub fn output(&self, column: usize) -> Vec<f64> {
        self.y.iter().skip(column).step_by(self.outputs).copied().collect()
    }
}
