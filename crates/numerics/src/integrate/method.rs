//! Choice between the explicit and the implicit method during a run.

use super::Budget;
use nalgebra::{DMatrix, Schur};

/// Evaluations of the explicit method in a step: eleven, and some for steps that are repeated.
const OF_STEP: f64 = 12.0;
/// Evaluations of a stretch below which it is not checked: it costs little.
const CHEAP: u64 = 600;
/// Evaluations in steps that stability limits, one stretch after another, after which the implicit method continues.
const PATIENCE: u64 = 12_000;
/// Product of step and fastest rate above which stability limits the steps. The method is stable up to about 6; for a tolerance of 1e-6, an
/// oscillation needs steps of half as much.
const AT_LIMIT: f64 = 3.0;

/// Choice of the method for the next stretch of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct MethodChoice {
    is_stiff: bool,
    /// Evaluations in stretches that stability limited, without one in between that it did not.
    limited: u64,
    /// True if the explicit method gave up for stiffness or cost.
    is_suspect: bool,
}

impl MethodChoice {
    /// Returns true if the implicit method is to be used.
    pub fn is_stiff(self) -> bool {
        self.is_stiff
    }

    /// Uses the implicit method from now on.
    pub fn set_stiff(&mut self) {
        self.is_stiff = true;
    }

    /// Returns true if the explicit method gave up for stiffness or cost.
    pub fn is_suspect(self) -> bool {
        self.is_suspect
    }

    /// Takes note of a stretch of the explicit method: its evaluations and seconds, and if it was given up for stiffness or cost. `jacobian` is
    /// that of the equations there. Returns true if it was given up because stability limits its steps.
    pub fn note(
        &mut self,
        (evaluations, seconds): (u64, f64),
        gave_up: bool,
        jacobian: impl FnOnce() -> Option<DMatrix<f64>>,
    ) -> bool {
        self.is_suspect = gave_up;
        if evaluations < CHEAP {
            self.limited = 0;
            return false;
        }
        let step = seconds * OF_STEP / evaluations as f64;
        let is_limited = jacobian().and_then(fastest_rate).is_some_and(|rate| rate * step > AT_LIMIT);
        self.limited = if is_limited { self.limited + evaluations } else { 0 };
        self.is_stiff = self.limited >= PATIENCE || is_limited && gave_up;
        is_limited && gave_up
    }
}

/// Largest magnitude of an eigenvalue.
fn fastest_rate(jacobian: DMatrix<f64>) -> Option<f64> {
    let schur = Schur::try_new(jacobian, f64::EPSILON, 1000)?;
    Some(schur.complex_eigenvalues().iter().map(|value| value.norm()).fold(0.0, f64::max))
}

/// Begin of a part of a run, for its evaluations and its time.
pub struct Lap {
    evaluations: u64,
    t: f64,
}

impl Lap {
    /// Begins at a time.
    pub fn begin(budget: &Budget, t: f64) -> Self {
        Self { evaluations: budget.spent(), t }
    }

    /// Evaluations and seconds since the beginning.
    pub fn end(&self, budget: &Budget) -> (u64, f64) {
        (budget.spent() - self.evaluations, (budget.reached() - self.t).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An oscillator of 1e3 rad/s.
    fn oscillator() -> Option<DMatrix<f64>> {
        Some(DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -1e6, 0.0]))
    }

    #[test]
    fn the_implicit_method_is_chosen_after_long_stretches_that_stability_limits() {
        assert!((fastest_rate(oscillator().unwrap()).unwrap() - 1e3).abs() < 1e-2);
        let mut choice = MethodChoice::default();
        let mut after = |evaluations, seconds, gave_up| {
            choice.note((evaluations, seconds), gave_up, oscillator);
            choice.is_stiff()
        };
        // steps of 5 ms are too long to resolve an oscillation of a millisecond
        assert!(!after(6000, 2.5, false));
        assert!(!after(100, 2.5, false) && !after(6000, 2.5, false));
        assert!(!after(6000, 0.5, true) && !after(6000, 2.5, false));
        assert!(after(6000, 2.5, false));
        assert!(MethodChoice::default().note((6000, 2.5), true, oscillator));
    }
}
