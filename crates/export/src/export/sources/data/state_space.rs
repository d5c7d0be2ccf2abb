//! Sizes and numbers of a graph that gives outputs and derivatives of states.

use super::{ModelSources, graph::GraphSources, operations::Operations, push, states};
use metafmu_runtime::{Integration, Ports, Surrogate, graph::Step};

const NAMES: [&str; 2] = ["model_angles", "model_given_states"];

pub fn part(surrogate: &Surrogate, integration: Integration) -> ModelSources {
    let Ports { parameters, inputs, states, .. } = surrogate.ports();
    let graph = GraphSources::of(&surrogate.program().graph);
    let stage = [Operations::default(), graph.operations, Operations::default()];
    ModelSources {
        header: "state_space.h",
        defines: [graph.defines, vec![states::method(integration)]].concat(),
        names: [&states::NAMES[..], &NAMES, &graph.names].concat(),
        sizes: [
            vec![
                ("FIRST_DRIVEN", parameters + states, "the first input that is neither parameter nor start"),
                ("ARGUMENT_COUNT", 0, "with bends"),
                ("ARGUMENT_SIZE", 1, ""),
            ],
            graph.sizes,
        ]
        .concat(),
        remark: states::remark(surrogate, integration, stage, states, inputs),
        data: data(surrogate, integration) + &graph.data,
    }
}

fn data(surrogate: &Surrogate, integration: Integration) -> String {
    let program = surrogate.program();
    let states = surrogate.states().len();
    let first = program.graph.inputs - states;
    let mut text = states::data(surrogate, integration);
    let angles: Vec<String> = (0..states).map(|state| program.is_angle(first + state).to_string()).collect();
    push(&mut text, format_args!("\nconst bool model_angles[STATE_COUNT] = {{{}}};\n", angles.join(", ")));
    let given: Vec<String> = (0..surrogate.outputs().len() + states)
        .map(|result| match program.graph.steps.last() {
            Some(Step::Columns { columns }) if columns[result][0] == 0 => {
                (columns[result][1] as usize).checked_sub(first).unwrap_or(states)
            }
            _ => states,
        })
        .map(|state| state.to_string())
        .collect();
    push(&mut text, format_args!("\nconst size_t model_given_states[RESULT_COUNT] = {{{}}};\n", given.join(", ")));
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        for (surrogate, of_network) in [
            (example::oscillator(None), 0),
            // four columns, layers of 4 to 6 to 1, a rescaled output, and a sum
            (example::oscillator(Some(example::residual_network())), 4 * 2 + 2 * (4 * 6 + 6) + 2 + 1),
        ] {
            // -mu x^2 v + mu v - x + force: -mu; x^2, x^2 v, and the force begins a sum of three more terms
            let functions = 2 + 2 * (1 + 1 + 1 + 3);
            let graph = GraphSources::of(&surrogate.program().graph);
            assert_eq!(graph.operations.arithmetic, f64::from(functions + of_network));
        }
    }
}
