//! Sizes and weights of a model of samples.

use super::{
    ModelSources, array, double,
    functions::{AddedNetwork, Cost, width, write_network},
    graph::BesideGraph,
    network::{ACTIVATIONS, BLOCK_SIZE},
    operations::Operations,
    real,
};
use metafmu_runtime::{
    Discrete, Map, Surrogate,
    law::{ColumnKind, NetworkColumn},
};

const NAMES: [&str; 10] = [
    "model_advance",
    "model_constants",
    "model_hidden",
    "model_sample_time",
    "model_samples_network",
    "model_start",
    "model_support_fading",
    "model_support_ranges",
    "model_support_samples",
    "model_weights",
];

pub fn part(surrogate: &Surrogate, discrete: &Discrete) -> ModelSources {
    let [parameters, driven, outputs] = discrete.counts;
    let [past_outputs, past_inputs] = discrete.history;
    let network = network(discrete);
    let cost = Cost::of(network.as_ref(), 0);
    let graph = BesideGraph::of(discrete.map.as_ref(), 0);
    let samples = samples(surrogate, discrete);
    let of_network = Operations {
        arithmetic: operations(discrete, &cost, samples),
        sines: 2.0 * samples * cost.angles as f64,
        activations: samples * cost.activations as f64,
        ..Operations::default()
    };
    let numbers = discrete.numbers();
    ModelSources {
        header: "discrete.h",
        defines: Vec::new(),
        names: [&ACTIVATIONS[..], &NAMES, &graph.names].concat(),
        sizes: [
            vec![
                ("PARAMETER_COUNT", parameters, ""),
                ("DRIVEN_COUNT", driven, "inputs that are neither parameter nor start"),
                ("PAST_STARTS", discrete.past_starts(), "those whose value before the start counts"),
                ("FIRST_DRIVEN", parameters + outputs + discrete.past_starts(), "the first of them"),
                ("SAMPLE_SIZE", numbers, "outputs, and what is hidden"),
                (
                    "PAST_OUTPUTS",
                    past_outputs.max(1) * numbers,
                    "numbers that are remembered of outputs and of what is hidden",
                ),
                ("PAST_INPUTS", past_inputs * driven, "and of inputs"),
                ("FED_BACK", past_outputs * numbers, "of the former those that count"),
                ("LINEAR_COLUMNS", if discrete.weights.is_empty() { 0 } else { discrete.width() }, "of W"),
                (
                    "MEAN_COUNT",
                    discrete.support.as_ref().map_or(0, |_| discrete.past_starts()),
                    "inputs that are averaged",
                ),
                ("FEATURE_COUNT", features(discrete), "of a transition from sample to sample"),
                BLOCK_SIZE,
                ("NETWORK_WIDTH", width(&network), "of the widest layer of the network"),
            ],
            graph.sizes,
        ]
        .concat(),
        remark: (graph.operations.times(samples, of_network))
            .remark("A step of model_time_step takes", "discrete.c has"),
        data: data(discrete, network.as_ref()) + &graph.data,
    }
}

/// Number of features of a transition; none if the support of the training is not known.
fn features(discrete: &Discrete) -> usize {
    discrete.support.as_ref().map_or(0, |support| support.ranges.len())
}

/// Samples in the step that hosts are told.
fn samples(surrogate: &Surrogate, discrete: &Discrete) -> f64 {
    (surrogate.metadata().time_step / discrete.step).ceil().max(1.0)
}

/// Multiplications, additions and divisions of a step over so many samples; the formula is in `discrete.c`.
fn operations(discrete: &Discrete, network: &Cost, samples: f64) -> f64 {
    let columns = if discrete.weights.is_empty() { 0 } else { discrete.width() };
    let support = 8 * features(discrete);
    let sample = network.operations + discrete.numbers() * (2 * columns + 2) + 5 * discrete.counts[1] + 5 + support;
    samples * sample as f64 + 8.0
}

/// The network, which adds to all outputs.
fn network(discrete: &Discrete) -> Option<AddedNetwork<'_>> {
    let Some(Map::Network(network)) = &discrete.map else { return None };
    Some(AddedNetwork {
        columns: (0..discrete.width()).map(|of| NetworkColumn { of, kind: ColumnKind::Plain }).collect(),
        outputs: (0..discrete.numbers()).collect(),
        network,
    })
}

fn data(discrete: &Discrete, network: Option<&AddedNetwork>) -> String {
    let mut text = format!("\nconst double model_sample_time = {};\n", double(discrete.step));
    // C has no empty arrays
    let padded = |values: &[f64]| if values.is_empty() { vec![0.0] } else { values.to_vec() };
    array(&mut text, "const Real model_weights", &padded(&discrete.weights));
    array(&mut text, "const Real model_hidden", &padded(&discrete.hidden));
    array(&mut text, "const Real model_constants", &discrete.constants);
    if let Some(support) = &discrete.support {
        array(&mut text, "const Real model_support_ranges", support.ranges.as_flattened());
        text.push_str(&format!(
            "\nconst Real model_support_samples = {};\nconst Real model_support_fading = {};\n",
            real(support.samples),
            real(support.fading()),
        ));
    }
    write_network(&mut text, "samples", network);
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Model, example};

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let recorded = example::recorded();
        let Model::Discrete(discrete) = recorded.model() else { panic!("it is discrete") };
        assert_eq!(samples(&recorded, discrete), 1.0);
        // six columns, layers of 6 to 5 to 1, in blocks of 16, an output
        let of_network = 6 * 2 + 2 * (6 + 5) * 16 + 3;
        let cost = Cost::of(network(discrete).as_ref(), 0);
        assert_eq!(operations(discrete, &cost, 3.0), f64::from(3 * (of_network + (2 * 6 + 2) + 5 + 5) + 8));
    }
}
