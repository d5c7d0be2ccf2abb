//! Damped steps of least squares (Levenberg 1944; Marquardt 1963).

use nalgebra::{Cholesky, DMatrix, DVector};

/// Factors of the damping after a step that gained, and after one that did not.
const DOWN: f64 = 0.2;
const UP: f64 = 4.0;
/// Smallest damping after a step that did not gain.
const LEAST: f64 = 1e-8;
/// Dampings that are tried for one step.
const TRIES: usize = 10;

/// Damping of least squares: a number that is added to the diagonal of the matrix of second derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Damping(f64);

impl Damping {
    /// A damping to begin with.
    pub fn new(value: f64) -> Self {
        Self(value)
    }

    /// Solves `(matrix + damping I) change = gradient` with growing damping until `try_change` returns a result for the change. Returns None if
    /// it rejects all changes.
    pub fn step<T>(
        &mut self,
        matrix: &DMatrix<f64>,
        gradient: &DVector<f64>,
        mut try_change: impl FnMut(DVector<f64>) -> Option<T>,
    ) -> Option<T> {
        for _ in 0..TRIES {
            let mut damped = matrix.clone();
            (0..damped.nrows()).for_each(|place| damped[(place, place)] += self.0);
            let found = Cholesky::new(damped).and_then(|factors| try_change(factors.solve(gradient)));
            if found.is_some() {
                self.0 *= DOWN;
                return found;
            }
            self.0 = (self.0 * UP).max(LEAST);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_value_of_rosenbrocks_valley_is_found() {
        // errors 10 (y - x^2) and 1 - x
        let errors = |at: &DVector<f64>| DVector::from_vec(vec![10.0 * (at[1] - at[0] * at[0]), 1.0 - at[0]]);
        let (mut at, mut damping) = (DVector::from_vec(vec![-1.2, 1.0]), Damping::new(1.0));
        for _ in 0..100 {
            let jacobian = DMatrix::from_row_slice(2, 2, &[-20.0 * at[0], 10.0, -1.0, 0.0]);
            let found = errors(&at);
            let (matrix, gradient) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&found));
            let next = damping.step(&matrix, &gradient, |change| {
                let next = &at - change;
                (errors(&next).norm_squared() < found.norm_squared()).then_some(next)
            });
            let Some(next) = next else { break };
            at = next;
        }
        assert!((at[0] - 1.0).abs() < 1e-9 && (at[1] - 1.0).abs() < 1e-9, "{at}");
    }
}
