//! What all models with continuous states have: the solver.

use super::double;
use metafmu_runtime::Surrogate;

/// External names.
pub(super) const NAMES: [&str; 8] = [
    "model_advance",
    "model_follow",
    "model_goes_around",
    "model_rates",
    "model_respond",
    "model_solver_step",
    "model_start",
    "model_turned",
];

/// Definition of the solver's longest step, in seconds.
pub(super) fn data(longest: f64) -> String {
    format!("\nconst double model_solver_step = {};\n", double(longest))
}

/// Steps of the fixed method in the step that hosts are told.
pub(super) fn sub_steps(surrogate: &Surrogate, longest: f64) -> f64 {
    (surrogate.metadata().time_step / longest * (1.0 - 1e-9)).ceil().max(1.0)
}

/// Multiplications, additions and divisions of so many steps of the fixed method, of which each has four stages of so many; the formula
/// is in `motion.c` and `state_space.c`.
pub(super) fn operations(sub_steps: f64, stage: usize, states: usize, driven: usize) -> f64 {
    sub_steps * (4 * stage + 30 * states + 20 * driven + 9) as f64 + 3.0
}
