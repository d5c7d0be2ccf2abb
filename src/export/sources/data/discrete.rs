//! Sizes and weights of a model of samples.

use super::{
    Part, array, double,
    functions::{Cost, Term, remark, width, write_network},
    network::{ACTIVATIONS, BLOCK_SIZE},
};
use metafmu_runtime::{
    Discrete, Surrogate,
    law::{ColumnKind, NetworkColumn},
};

const NAMES: [&str; 6] =
    ["model_advance", "model_constants", "model_sample_time", "model_samples_network", "model_start", "model_weights"];

pub fn part(surrogate: &Surrogate, discrete: &Discrete) -> Part {
    let [parameters, driven, outputs] = discrete.counts;
    let [past_outputs, past_inputs] = discrete.history;
    let network = network(discrete);
    let cost = Cost::of(network.as_ref(), 0);
    let samples = samples(surrogate, discrete);
    Part {
        header: "discrete.h",
        defines: Vec::new(),
        names: [&ACTIVATIONS[..], &NAMES].concat(),
        sizes: vec![
            ("PARAMETER_COUNT", parameters, ""),
            ("DRIVEN_COUNT", driven, "inputs that are neither parameter nor start"),
            ("FIRST_DRIVEN", parameters + outputs + driven, "the first of them"),
            ("PAST_OUTPUTS", past_outputs.max(1) * outputs, "numbers that are remembered of outputs"),
            ("PAST_INPUTS", past_inputs * driven, "and of inputs"),
            ("FED_BACK", past_outputs * outputs, "of the outputs' those that count"),
            BLOCK_SIZE,
            ("NETWORK_WIDTH", width(&network), "of the widest layer of the network"),
        ],
        remark: remark(
            operations(discrete, &cost, samples),
            2.0 * samples * cost.angles as f64,
            samples * cost.activations as f64,
            "discrete.c",
        ),
        data: data(discrete, network.as_ref()),
    }
}

/// Samples in the step that hosts are told.
fn samples(surrogate: &Surrogate, discrete: &Discrete) -> f64 {
    (surrogate.metadata().time_step / discrete.step).ceil().max(1.0)
}

/// Multiplications, additions and divisions of a step over so many samples; the formula is in `discrete.c`.
fn operations(discrete: &Discrete, network: &Cost, samples: f64) -> f64 {
    let [_, driven, outputs] = discrete.counts;
    let sample = network.operations + outputs * (2 * discrete.width() + 2) + 5 * driven + 5;
    samples * sample as f64 + 8.0
}

/// The network, which adds to all outputs.
fn network(discrete: &Discrete) -> Option<Term<'_>> {
    discrete.network.as_ref().map(|network| Term {
        columns: (0..discrete.width()).map(|of| NetworkColumn { of, kind: ColumnKind::Plain }).collect(),
        outputs: (0..discrete.counts[2]).collect(),
        network,
    })
}

fn data(discrete: &Discrete, network: Option<&Term>) -> String {
    let mut text = format!("\nconst double model_sample_time = {};\n", double(discrete.step));
    array(&mut text, "const Real model_weights", &discrete.weights);
    array(&mut text, "const Real model_constants", &discrete.constants);
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
