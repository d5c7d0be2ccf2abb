//! Functions and results of a state space.

use super::{
    ModelSources,
    functions::{AddedNetwork, Cost, Laid, width, write_network},
    graph::BesideGraph,
    network::{ACTIVATIONS, BLOCK_SIZE},
    operations::Operations,
    states, table,
};
use metafmu_runtime::{
    Given, Map, StateSpace, Surrogate,
    dictionary::Factor,
    law::{ColumnKind, NetworkColumn},
};

const NAMES: [&str; 3] = ["model_functions", "model_functions_network", "model_given"];

pub fn part(surrogate: &Surrogate, space: &StateSpace) -> ModelSources {
    let [parameters, driven, states] = space.counts;
    let functions = Laid::out(&space.functions);
    let network = network(space);
    let cost = Cost::of(network.as_ref(), 0);
    let graph = BesideGraph::of(space.map.as_ref(), space.functions.outputs());
    let of_stage = Operations {
        arithmetic: stage(space, &functions, &cost) as f64,
        sines: 2.0 * (functions.angles() + cost.angles) as f64,
        activations: cost.activations as f64,
        ..Operations::default()
    };
    let of_stage = graph.operations.times(1.0, of_stage);
    let remark = if states == 0 {
        of_stage.remark("The outputs after a step take", "state_space.c has")
    } else {
        let sub_steps = states::sub_steps(surrogate, space.integration);
        let arithmetic = states::operations(sub_steps, space.integration, of_stage.arithmetic as usize, states, driven);
        let of_step = of_stage.times(states::stages(sub_steps, space.integration), Operations::default());
        Operations { arithmetic, ..of_step }.remark("A step of model_time_step takes", "state_space.c has")
    };
    ModelSources {
        header: "state_space.h",
        defines: Vec::new(),
        names: [&ACTIVATIONS[..], &states::NAMES, &NAMES, &graph.names].concat(),
        sizes: [
            vec![
                ("FIRST_DRIVEN", parameters + states, "the first input that is neither parameter nor start"),
                ("ARGUMENT_COUNT", 0, "of tables"),
                ("ARGUMENT_SIZE", 1, ""),
                ("DICTIONARY_COLUMNS", space.functions.columns(), "parameters, driven inputs and states"),
                ("ATOM_COUNT", functions.atoms().max(1), "functions of the columns"),
                BLOCK_SIZE,
                ("NETWORK_WIDTH", width(&network), "of the widest layer of the network"),
                ("FUNCTION_SIZE", functions.outputs.max(1), "number of functions, but C has no empty arrays"),
            ],
            graph.sizes,
        ]
        .concat(),
        remark,
        data: data(surrogate, space, &functions, network.as_ref()) + &graph.data,
    }
}

/// Multiplications, additions and divisions of an evaluation; the formula is in `state_space.c`.
fn stage(space: &StateSpace, functions: &Laid, network: &Cost) -> usize {
    let angles = space.functions.factors().filter(|factor| *factor == Factor::Angle).count();
    let turned = if space.map.is_some() { 5 * angles } else { 0 };
    functions.operations(0) + turned + network.operations
}

/// The network, whose columns are those of the functions, an angle being two of them, its sine and cosine.
fn network(space: &StateSpace) -> Option<AddedNetwork<'_>> {
    let columns = |(of, factor): (usize, Factor)| {
        let kinds: &[ColumnKind] = match factor {
            Factor::Angle => &[ColumnKind::Sine, ColumnKind::Cosine],
            Factor::Power { .. } => &[ColumnKind::Plain],
        };
        kinds.iter().map(move |&kind| NetworkColumn { of, kind })
    };
    let Some(Map::Network(network)) = &space.map else { return None };
    Some(AddedNetwork {
        columns: space.functions.factors().enumerate().flat_map(columns).collect(),
        outputs: (0..space.functions.outputs()).collect(),
        network,
    })
}

fn data(surrogate: &Surrogate, space: &StateSpace, functions: &Laid, network: Option<&AddedNetwork>) -> String {
    let mut text = states::data(surrogate, space.integration);
    functions.write(&mut text, "functions");
    write_network(&mut text, "functions", network);
    let given = space.results.iter().map(|given| match given {
        Given::State(state) => format!("true, {state}"),
        Given::Function(function) => format!("false, {function}"),
    });
    table(&mut text, "const Given model_given", given, "");
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Model, example};

    fn space_of_fixed_steps() -> metafmu_runtime::Integration {
        metafmu_runtime::Integration::Fixed { step: 0.005 }
    }

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        for (surrogate, of_network) in [
            (example::oscillator(None), 0),
            // four columns, layers of 4 to 6 to 1, in blocks of 16, an output
            (example::oscillator(Some(example::residual_network())), 4 * 2 + 2 * (4 + 6) * 16 + 3),
        ] {
            let Model::StateSpace(space) = surrogate.model() else { panic!("it has states") };
            // mu, force and v with one power each, x with two; mu v, mu x^2 v, x, force, each in one function
            let functions = 3 * (3 + 2) + (6 + 2) + (2 + 2) + (3 + 2) + 2 * (1 + 2);
            let (laid, network) = (Laid::out(&space.functions), network(space));
            assert_eq!(stage(space, &laid, &Cost::of(network.as_ref(), 0)), functions + of_network);
        }
        // two steps of four stages, two states, a force
        assert_eq!(states::operations(2.0, space_of_fixed_steps(), 100, 2, 1), f64::from(2 * (400 + 60 + 20 + 9) + 3));
    }
}
