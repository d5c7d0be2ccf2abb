//! Sizes and weights of a model of samples.

use super::{ModelSources, array, double, graph::GraphSources, operations::Operations, real};
use metafmu_runtime::{Ports, Sampling, Support, Surrogate};

const NAMES: [&str; 10] = [
    "model_advance",
    "model_direct",
    "model_hidden",
    "model_sample_time",
    "model_start",
    "model_support_components",
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
            ],
            measures(sampling, &ports).sizes().to_vec(),
            graph.sizes,
        ]
        .concat(),
        remark: (graph.operations.times(samples, of_step))
            .remark("A step of model_time_step takes", "discrete.c and graph.c have"),
        data: data(sampling) + &graph.data,
    }
}

/// Numbers of values that are compared with the support of the training; zero if it is not known.
#[derive(Default)]
struct MeasureCounts {
    inputs: usize,
    coordinates: usize,
    components: usize,
    measures: usize,
}

fn measures(sampling: &Sampling, ports: &Ports) -> MeasureCounts {
    let Some(support) = &sampling.support else { return MeasureCounts::default() };
    let coordinates = support.coordinates(ports.outputs, sampling.hidden.len());
    MeasureCounts {
        inputs: support.inputs,
        coordinates,
        components: support.components.len() / coordinates,
        measures: support.ranges.len(),
    }
}

impl MeasureCounts {
    fn sizes(&self) -> [(&'static str, usize, &'static str); 5] {
        [
            ("WATCHED_COUNT", self.inputs, "inputs with features of a transition from sample to sample"),
            ("COORDINATE_COUNT", self.coordinates, "further features"),
            ("COMPONENT_COUNT", self.components, "linear combinations of the latter"),
            ("PAIRED_COUNT", self.components.min(Support::PAIRED), "components with sums and differences"),
            ("MEASURE_COUNT", self.measures, "of a transition"),
        ]
    }
}

/// Number of samples in the step that hosts receive.
fn samples(surrogate: &Surrogate, sampling: &Sampling) -> f64 {
    (surrogate.metadata().time_step / sampling.step).ceil().max(1.0)
}

/// Multiplications, additions and divisions of a step over `samples` samples, without the graph. `discrete.c` has the formula.
fn operations(sampling: &Sampling, ports: &Ports, samples: f64) -> f64 {
    let MeasureCounts { inputs, coordinates, components, measures } = measures(sampling, ports);
    let of_distance = if sampling.support.is_some() { 5 } else { 0 };
    let of_support = 8 * inputs + 2 * components * coordinates + 6 * measures + of_distance;
    samples * (5 * (ports.inputs + ports.outputs) + 5 + of_support) as f64 + 8.0
}

fn data(sampling: &Sampling) -> String {
    let mut text = format!("\nconst double model_sample_time = {};\n", double(sampling.step));
    // C has no empty arrays
    let hidden = if sampling.hidden.is_empty() { vec![0.0] } else { sampling.hidden.clone() };
    array(&mut text, "const Real model_hidden", &hidden);
    if !sampling.direct.is_empty() {
        array(&mut text, "const Real model_direct", &sampling.direct);
    }
    if let Some(support) = &sampling.support {
        array(&mut text, "const Real model_support_ranges", support.ranges.as_flattened());
        // C has no empty arrays
        let none = vec![0.0];
        let components = if support.components.is_empty() { &none } else { &support.components };
        array(&mut text, "const Real model_support_components", components);
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
    use metafmu_example as example;

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
