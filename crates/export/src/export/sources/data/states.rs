//! Solver of all models with continuous states.

use super::{double, operations::Operations, table};
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
    let scales = surrogate.program().scales(surrogate.states()).into_iter().map(|scale| {
        let Scale { nominal, is_relative, limit } = scale;
        format!("{}, {is_relative}, {}", double(nominal), double(limit))
    });
    // C has no empty arrays
    table(&mut text, "const StateScale model_scales", scales, "0.0, false, 0.0");
    text
}

/// Definition that chooses the method that controls the error of steps.
pub(super) fn method(integration: Integration) -> (&'static str, String) {
    ("SOLVER_IS_IMPLICIT", u8::from(integration.is_implicit()).to_string())
}

/// Remark on the cost of a step, from the operations of the parameters' part and of a stage.
pub(super) fn remark(
    surrogate: &Surrogate,
    integration: Integration,
    [fixed, stage, _]: [Operations; 3],
    states: usize,
    driven: usize,
) -> String {
    let sub_steps = integration.parts(surrogate.metadata().time_step);
    let of_stages = stage.times(stages(sub_steps, integration, states as f64), fixed);
    let arithmetic = fixed.arithmetic + operations(sub_steps, integration, stage.arithmetic, states, driven);
    Operations { arithmetic, ..of_stages }.remark("A step of model_time_step takes", "states.c has")
}

/// Number of evaluations of the equations in `sub_steps` steps, none of which is repeated.
fn stages(sub_steps: f64, integration: Integration, states: f64) -> f64 {
    match integration {
        Integration::ErrorControlled { .. } => 6.0 * sub_steps + 1.0,
        Integration::Implicit { .. } => (8.0 + states) * sub_steps + 1.0,
        Integration::Fixed { .. } => 4.0 * sub_steps,
    }
}

/// Multiplications, additions and divisions of solver steps with given costs of a stage. `states.c` has the formula.
fn operations(sub_steps: f64, integration: Integration, stage: f64, states: usize, driven: usize) -> f64 {
    let (states, driven) = (states as f64, driven as f64);
    match integration {
        Integration::ErrorControlled { .. } => {
            sub_steps * (6.0 * stage + 86.0 * states + 30.0 * driven + 24.0) + stage + 2.0 * states + 5.0 * driven + 3.0
        }
        Integration::Implicit { .. } => {
            let of_states = 131.0 * states + states * states * (18.0 + 2.0 / 3.0 * states);
            sub_steps * ((8.0 + states) * (stage + 5.0 * driven) + of_states + 24.0) + stage + 5.0 * driven + 3.0
        }
        Integration::Fixed { .. } => sub_steps * (4.0 * stage + 30.0 * states + 20.0 * driven + 9.0) + 3.0,
    }
}

#[cfg(test)]
mod tests {
    use super::{super::tape, *};
    use metafmu_example as example;

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let oscillator = example::oscillator(None);
        let dictionary = oscillator.program().graph.dictionary().unwrap();
        let function_set = metafmu_runtime::function_set::FunctionSet::from(dictionary.clone());
        // -mu x^2 v + mu v - x + force: -mu once; x^2, x^2 v, and the force begins a sum of three more terms
        let found = tape::operations(&function_set.listing(0..1)).map(|of| of.arithmetic);
        assert_eq!(found, [2.0, 2.0 * (1 + 1 + 3) as f64, 0.0]);
        // two steps of four stages, two states, an input
        let fixed = Integration::Fixed { step: 0.005 };
        assert_eq!(operations(2.0, fixed, 100.0, 2, 1), f64::from(2 * (400 + 60 + 20 + 9) + 3));
        // of a state: six stages with one to six weights, 2 + ... + 12 and 2 each; seven weights of the error and 4; six of the result and 2
        let of_state = 42 + 12 + 14 + 4 + 12 + 2;
        let expected = 2 * (600 + 4 * of_state + 30 + 24) + 100 + 8 + 5 + 3;
        let controlled = Integration::ErrorControlled { tolerance: 1e-9, longest: 0.005 };
        assert_eq!(operations(2.0, controlled, 100.0, 4, 1), f64::from(expected));
        // the Jacobian, its factors, and eight solutions, each with sums of the stages before it
        let (jacobian, factors, solutions) = (5 * 4 + 2 * 16, 2 * 16 + 2 * 64 / 3, 8 * (2 * 16));
        let rest = f64::from(jacobian + factors + solutions + 8 * 4 * 14);
        let implicit = Integration::Implicit { tolerance: 1e-9, longest: 0.005 };
        let found = operations(1.0, implicit, 0.0, 4, 0) - 27.0;
        assert!((0.9..1.3).contains(&(found / rest)), "{found} {rest}");
    }
}
