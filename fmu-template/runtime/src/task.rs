//! Tasks of a graph: outputs or derivatives at a point.

/// Task at a point.
pub(crate) enum Task<'a> {
    /// The outputs.
    Outputs(&'a mut [f64]),
    /// First derivatives of the outputs, and second ones if there is a slice for them, along a curve with the first and
    /// second derivatives `rates`.
    Series { rates: [&'a [f64]; 2], first: &'a mut [f64], second: Option<&'a mut [f64]> },
    /// `J^T weights`.
    Adjoint { weights: &'a [f64], gradient: &'a mut [f64] },
}
