//! Sizes and weights of a model of samples.

use super::{ModelSources, array, double, graph::GraphSources, operations::Operations, real};
use metafmu_runtime::{Ports, Sampling, Surrogate};

const NAMES: [&str; 8] = [
    "model_advance",
    "model_hidden",
    "model_sample_time",
    "model_start",
    "model_support_fading",
    "model_support_ranges",
    "model_support_samples",
    "model_support_settling",
];

pub fn part(surrogate: &Surrogate, sampling: &Sampling) -> ModelSources {
    let ports = surrogate.ports();
    let Ports { parameters, starts, inputs, .. } = ports;
    let [past_outputs, past_inputs] = sampling.history;
    let graph = GraphSources::of(&surrogate.program().graph);
    let samples = samples(surrogate, sampling);
    let of_step = Operations { arithmetic: operations(sampling, &ports, samples), ..Operations::default() };
    let (numbers, past_starts) = (sampling.numbers(&ports), sampling.past_starts(&ports));
    ModelSources {
        header: "discrete.h",
        defines: graph.defines,
        names: [&NAMES[..], &graph.names].concat(),
        sizes: [
            vec![
                ("PARAMETER_COUNT", parameters, ""),
                ("DRIVEN_COUNT", inputs, "inputs that are neither parameter nor start"),
                ("PAST_STARTS", past_starts, "those whose value before the start counts"),
                ("FIRST_DRIVEN", parameters + starts, "the first of them"),
                ("SAMPLE_SIZE", numbers, "outputs, and what is hidden"),
                (
                    "PAST_OUTPUTS",
                    past_outputs.max(1) * numbers,
                    "numbers that are remembered of outputs and of what is hidden",
                ),
                ("PAST_INPUTS", past_inputs * inputs, "and of inputs"),
                ("FED_BACK", past_outputs * numbers, "of the former those that count"),
                ("MEAN_COUNT", sampling.support.as_ref().map_or(0, |_| past_starts), "inputs that are averaged"),
                ("FEATURE_COUNT", features(sampling), "of a transition from sample to sample"),
            ],
            graph.sizes,
        ]
        .concat(),
        remark: (graph.operations.times(samples, of_step))
            .remark("A step of model_time_step takes", "discrete.c and graph.c have"),
        data: data(sampling) + &graph.data,
    }
}

/// Number of features of a transition; none if the support of the training is not known.
fn features(sampling: &Sampling) -> usize {
    sampling.support.as_ref().map_or(0, |support| support.ranges.len())
}

/// Samples in the step that hosts are told.
fn samples(surrogate: &Surrogate, sampling: &Sampling) -> f64 {
    (surrogate.metadata().time_step / sampling.step).ceil().max(1.0)
}

/// Multiplications, additions and divisions of a step over `samples` samples, without the graph. `discrete.c` has the formula.
fn operations(sampling: &Sampling, ports: &Ports, samples: f64) -> f64 {
    samples * (5 * (ports.inputs + ports.outputs) + 5 + 8 * features(sampling)) as f64 + 8.0
}

fn data(sampling: &Sampling) -> String {
    let mut text = format!("\nconst double model_sample_time = {};\n", double(sampling.step));
    // C has no empty arrays
    let hidden = if sampling.hidden.is_empty() { vec![0.0] } else { sampling.hidden.clone() };
    array(&mut text, "const Real model_hidden", &hidden);
    if let Some(support) = &sampling.support {
        array(&mut text, "const Real model_support_ranges", support.ranges.as_flattened());
        text.push_str(&format!(
            "\nconst Real model_support_samples = {};\nconst Real model_support_fading = {};\n\
             const Real model_support_settling = {};\n",
            real(support.samples),
            real(support.fading()),
            real(sampling.settling()),
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::example;

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let recorded = example::recorded();
        let sampling = recorded.program().sampling().unwrap();
        assert_eq!(samples(&recorded, sampling), 1.0);
        assert_eq!(operations(sampling, &recorded.ports(), 3.0), f64::from(3 * (5 * 2 + 5) + 8));
        // the linear part, six columns, layers of 6 to 5 to 1, an output, a sum
        let graph = GraphSources::of(&recorded.program().graph);
        assert_eq!(graph.operations.arithmetic, f64::from(2 * 6 + 6 * 2 + 2 * (6 * 5 + 5) + 2 + 1));
    }
}
