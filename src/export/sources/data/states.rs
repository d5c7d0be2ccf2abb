//! What all models with continuous states have: the solver.

use super::{double, table};
use metafmu_runtime::{Integration, Scale, Surrogate};

/// External names.
pub(super) const NAMES: [&str; 11] = [
    "model_advance",
    "model_follow",
    "model_goes_around",
    "model_rates",
    "model_respond",
    "model_scales",
    "model_share_of_step",
    "model_solver_step",
    "model_solver_tolerance",
    "model_start",
    "model_turned",
];

/// Definition of the solver's longest step, in seconds, of its tolerance, and of the states' scales.
pub(super) fn data(surrogate: &Surrogate, integration: Integration) -> String {
    let tolerance = integration.tolerance().unwrap_or(0.0);
    let mut text = format!(
        "\nconst double model_solver_step = {};\nconst double model_solver_tolerance = {};\n",
        double(integration.longest()),
        double(tolerance)
    );
    let scales = surrogate.model().scales(surrogate.states()).into_iter().map(|scale| {
        let Scale { nominal, is_relative, limit } = scale;
        format!("{}, {is_relative}, {}", double(nominal), double(limit))
    });
    // C has no empty arrays
    table(&mut text, "const StateScale model_scales", scales, "0.0, false, 0.0");
    text
}

/// Steps of the solver in the step that hosts are told.
pub(super) fn sub_steps(surrogate: &Surrogate, integration: Integration) -> f64 {
    integration.parts(surrogate.metadata().time_step)
}

/// Evaluations of the equations in so many steps, none of which is repeated.
pub(super) fn stages(sub_steps: f64, integration: Integration) -> f64 {
    match integration {
        Integration::ErrorControlled { .. } => 6.0 * sub_steps + 1.0,
        Integration::Fixed { .. } => 4.0 * sub_steps,
    }
}

/// Multiplications, additions and divisions of so many steps with stages of so many; the formula is in `motion.c` and `state_space.c`.
pub(super) fn operations(sub_steps: f64, integration: Integration, stage: usize, states: usize, driven: usize) -> f64 {
    let (stage, states, driven) = (stage as f64, states as f64, driven as f64);
    match integration {
        Integration::ErrorControlled { .. } => {
            sub_steps * (6.0 * stage + 86.0 * states + 30.0 * driven + 24.0) + stage + 2.0 * states + 5.0 * driven + 3.0
        }
        Integration::Fixed { .. } => sub_steps * (4.0 * stage + 30.0 * states + 20.0 * driven + 9.0) + 3.0,
    }
}
