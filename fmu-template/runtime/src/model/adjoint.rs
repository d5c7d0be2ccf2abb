//! Adjoint derivatives of models that have no faster way to them than directional ones.

/// Working memory of an adjoint derivative.
#[derive(Clone, Debug, Default)]
pub(super) struct ByDirections {
    direction: Vec<f64>,
    /// Of the results.
    change: Vec<f64>,
}

impl ByDirections {
    pub(super) fn new(columns: usize, results: usize) -> Self {
        Self { direction: vec![0.0; columns], change: vec![0.0; results] }
    }

    /// `J^T weights`, by `J` times each unit vector, which `directional` gives. Does not allocate.
    pub(super) fn adjoint(
        &mut self,
        weights: &[f64],
        gradient: &mut [f64],
        mut directional: impl FnMut(&[f64], &mut [f64]),
    ) {
        let Self { direction, change } = self;
        for (column, to) in gradient.iter_mut().enumerate() {
            direction.fill(0.0);
            direction[column] = 1.0;
            directional(direction, change);
            *to = weights.iter().zip(&*change).map(|(weight, change)| weight * change).sum();
        }
    }
}
