//! Summary of the surrogate: its kind, its accuracy, and its origin.

use super::{Material, ReportBlock, Section, code, escape, number, paragraph, percent, table, unit};
use crate::{
    diagnostics::numbers::is_proper,
    evaluation::{Accuracy, Horizon, RollOuts, TestRows},
    report::readable::{brief, count},
    study::NetworkOptions,
    surrogate::input_description,
};
use metafmu_runtime::{Clock, Graph, Role, ScaledNetwork, graph::Step};

/// One sentence on the surrogate: its kind, its outputs, and their origin.
pub fn sentence(material: &Material) -> String {
    let (from, _) = sources(material);
    let outputs = material.evaluated.outputs();
    let is = material.subject.map_or_else(|| network(material), |subject| format!("{subject} gives"));
    format!("{is} {} from {from}.", counted(outputs, "output"))
}

/// Origin of the outputs as text, and the items that were learned from.
fn sources(material: &Material) -> (String, &'static str) {
    let evaluated = material.evaluated;
    let metadata = evaluated.surrogate.metadata();
    let outputs = evaluated.outputs();
    let (from, learned) = match metadata.states.len() {
        0 if evaluated.surrogate.program().has_memory() => {
            let inputs = evaluated.test.inputs.len();
            let parameters = evaluated.test.parameters.len() - inputs - outputs;
            (list(["past outputs".into(), format!("{} in the past", counted(inputs, "input"))], parameters), "samples")
        }
        0 if evaluated.is_of_rows() => (counted(evaluated.test.parameters.len(), "input"), "rows"),
        0 => (format!("{} and the time", counted(evaluated.test.parameters.len(), "parameter")), "rows"),
        states => {
            let parameters = evaluated.test.parameters.len() - states;
            let from = list([counted(states, "state"), counted(evaluated.test.inputs.len(), "input")], parameters);
            let program = evaluated.surrogate.program();
            let of_states = program.integration().is_some() && program.motion().is_none();
            let learned = match (material.study.source.is_recorded(), of_states) {
                (true, _) => "rows",
                (_, true) => "states",
                _ => "configurations",
            };
            (from, learned)
        }
    };
    (from, learned)
}

/// Number of things as text; those there are none of have no place in a sentence.
fn counted(count: usize, what: &str) -> String {
    if count == 1 { format!("1 {what}") } else { format!("{count} {what}s") }
}

pub fn summary(material: &Material) -> Section {
    let evaluated = material.evaluated;
    let Accuracy { test_runs, test_rows, .. } = &evaluated.accuracy;
    let (test_runs_text, test_rows) = (count(*test_runs), count(*test_rows));
    let metadata = evaluated.surrogate.metadata();
    let (_, learned) = sources(material);
    let is_of_rows = evaluated.is_of_rows();
    let unseen = match material.study.sampling.train_stop {
        Some(stop) => format!("of which those up to {stop} s were learned from"),
        None => "that took no part in training".into(),
    };
    let measured = match evaluated.accuracy.rows {
        Some(TestRows::CrossValidated) => {
            format!("{test_rows} rows, each predicted by a model that was fitted without it (cross-validation)")
        }
        Some(TestRows::OfRuns) => format!("{test_rows} rows of runs that took no part in training"),
        Some(_) => format!("{test_rows} rows that took part neither in the fit nor in its choices"),
        None if *test_runs == 1 => format!("1 run of the original model, {test_rows} rows, {unseen}"),
        None => format!("{test_runs_text} runs of the original model, {test_rows} rows, {unseen}"),
    };
    let train_rows = count(metadata.provenance.train_rows as usize);
    let mut blocks =
        vec![paragraph(&format!("Trained on {train_rows} {learned}. Everything here was measured on {measured}."))];
    blocks.extend(
        evaluated.accuracy.noise(evaluated.surrogate).into_iter().map(|text| paragraph(&format!("{}.", escape(&text)))),
    );
    let test_runs = *test_runs;
    blocks.extend(evaluated.accuracy.roll_outs.iter().flat_map(|found| roll_outs(found, test_runs)));
    if let Some(bounds) = evaluated.surrogate.bounds().filter(|_| is_of_rows) {
        let widths: Vec<String> = evaluated
            .surrogate
            .predictions()
            .iter()
            .enumerate()
            .map(|(index, output)| {
                format!("{} ±{} {}", output.name, number(bounds.largest(index)), output.unit).trim_end().to_owned()
            })
            .collect();
        blocks.push(paragraph(&format!(
            "Error bounds, from the errors of these rows: {}. {} of further rows inside the ranges are expected within each.",
            widths.join(", "),
            percent(bounds.coverage)
        )));
    }
    blocks.extend(evaluated.accuracy.within_two_std().map(|text| paragraph(&format!("{text}."))));
    let trust = if material.verdict.accepted { "Valid only within these ranges. " } else { "" };
    let learned = if is_of_rows { "its predictions at the rows of the table" } else { "the training runs" };
    blocks.push(paragraph(&format!("{trust}A range of an output is that of {learned}.")));
    let inputs = evaluated.surrogate.inputs().iter().map(|input| {
        let kind = match input.role {
            Role::Time => "time",
            Role::Start => "value at the start",
            Role::Input if is_of_rows || evaluated.surrogate.program().has_memory() => "input",
            Role::Input | Role::Parameter(_) => "parameter",
        };
        (&input.name, kind, input.min, input.max, &input.unit, input_description(input, evaluated.surrogate))
    });
    let outputs = evaluated.surrogate.outputs().iter();
    let outputs = outputs.map(|o| {
        let kind = if o.constant().is_some() { "output, constant" } else { "output" };
        (&o.name, kind, o.min, o.max, &o.unit, o.description.clone())
    });
    let rows = inputs.chain(outputs).map(|(name, kind, min, max, u, description)| {
        vec![code(name), kind.into(), number(min), number(max), unit(u), escape(&description)]
    });
    blocks.push(table(&["variable", "kind", "from", "to", "unit", "meaning"], rows));
    Section { id: "summary", title: "Summary".into(), blocks }
}

/// `2 states, 1 input and 3 parameters`; nothing of which there are none.
fn list(parts: [String; 2], parameters: usize) -> String {
    let parts = parts.into_iter().chain([counted(parameters, "parameter")]);
    let mut parts: Vec<String> = parts.filter(|part| !part.starts_with("0 ")).collect();
    let last = parts.pop().unwrap_or_default();
    if parts.is_empty() { last } else { format!("{} and {last}", parts.join(", ")) }
}

/// Growth of errors along roll-outs.
fn roll_outs(
    found @ RollOuts { horizons, divergence_time, energy_drift, constraint_residual, long_runs: [runs, finite], .. }: &RollOuts,
    test_runs: usize,
) -> [ReportBlock; 2] {
    let chaos = found.describe_chaos(test_runs).map_or(String::new(), |chaos| format!(" {chaos}."));
    let headings =
        ["after", "relative RMS error, median", "90 % of the runs", "start perturbed by 10⁻⁹, median", "90 %"];
    let rows = horizons.iter().map(|Horizon { seconds, median, q90, sensitivity: [changed, changed_q90], .. }| {
        let numbers = [median, q90, changed, changed_q90].map(|value| brief(*value));
        [vec![format!("{} s", number(*seconds))], numbers.to_vec()].concat()
    });
    let diverges = match divergence_time {
        Some(time) => format!("Half of the runs are off by 0.1 standard deviations within {} s", number(*time)),
        None => "Over half of the runs stay within 0.1 standard deviations of the truth".into(),
    };
    let energy = energy_drift.map_or(String::new(), |drift| match is_proper(drift) {
        true => format!(", and without inputs the energy stays within {} of the largest kinetic energy", brief(drift)),
        false => ", and without inputs the energy grows beyond all limits, or a run ends".into(),
    });
    let residual = constraint_residual.map_or(String::new(), |residual| match is_proper(residual) {
        true => format!(
            " At the same coordinates, positions differ from the mechanism's by at most {} of their ranges: closed loops are as well \
             closed as that.",
            brief(residual)
        ),
        false => " The surrogate reaches coordinates at which the mechanism cannot be assembled.".into(),
    });
    let of_runs = counted(*runs, "run");
    let text = format!(
        "The errors are those of roll-outs: the surrogate starts once and is driven by the inputs of the run. The effect of \
         an initial state perturbed by 10⁻⁹ is the motion's own sensitivity. {diverges}{energy}.{residual} {finite} of {of_runs} finite after ten times the \
         length.{chaos}"
    );
    [table(&headings, rows), paragraph(&text)]
}

/// Sizes of the hidden layers.
fn sizes(network: &ScaledNetwork) -> String {
    let sizes = network.sizes();
    let hidden: Vec<String> = sizes.iter().take(sizes.len() - 1).map(usize::to_string).collect();
    layers(&hidden, "")
}

/// Hidden layers as text; `kind` stands before "nodes".
fn layers(hidden: &[String], kind: &str) -> String {
    match hidden {
        [] => "no hidden layer".into(),
        [only] => format!("a hidden layer of {only} {kind}nodes"),
        [first, rest @ ..] if rest.iter().all(|other| other == first) => {
            format!("{} hidden layers of {first} {kind}nodes", hidden.len())
        }
        hidden => format!("hidden layers of {} {kind}nodes", hidden.join(", ")),
    }
}

/// Nodes and activation as text.
fn network(material: &Material) -> String {
    let NetworkOptions { hidden, activation, .. } = &material.study.network;
    let hidden: Vec<String> = hidden.iter().map(usize::to_string).collect();
    let activation = activation.name();
    let layers = layers(&hidden, &format!("{activation} "));
    let program = material.evaluated.surrogate.program();
    let graph = &program.graph;
    let called = graph.called();
    match &program.clock {
        Clock::Static => match graph.instants() {
            Some((instants, _)) => format!(
                "A feed-forward network for each of {} instants ({layers}), interpolated in time, gives",
                instants.len()
            ),
            None if graph.dictionary().is_some() => "Sums of products, and what networks add to them, give".into(),
            None if graph.is_network() => format!("A feed-forward network ({layers}) gives"),
            None => "A third-party model gives".into(),
        },
        Clock::Continuous(_) => match (program.motion(), called, called.and_then(Graph::network)) {
            (Some(motion), ..) => {
                let networks = if motion.has_networks() { ", feed-forward networks among them," } else { "" };
                format!("Equations of motion with learned functions of the configuration{networks} give")
            }
            (None, _, Some(network)) if graph.products() == 0 => {
                format!("States whose derivatives are those of a feed-forward network ({}) give", sizes(&network))
            }
            (None, _, Some(network)) => format!(
                "States whose derivatives are sums of products and a feed-forward network ({}) give",
                sizes(&network)
            ),
            (None, Some(_), None) => "States whose derivatives are those of a third-party model give".into(),
            (None, None, None) => "States whose derivatives are sums of products give".into(),
        },
        Clock::Sampled(_) => match (called, called.and_then(Graph::network)) {
            (_, Some(network)) => {
                format!("A linear discrete-time model and a feed-forward network ({}) give", sizes(&network))
            }
            (Some(called), None) if called.steps.iter().any(|step| matches!(step, Step::Products { .. })) => {
                "A polynomial of past samples gives".into()
            }
            (Some(_), None) => "A discrete-time third-party model gives".into(),
            (None, None) => "A linear discrete-time model gives".into(),
        },
    }
}

pub fn provenance(material: &Material) -> Section {
    let provenance = &material.evaluated.surrogate.metadata().provenance;
    let own = [
        ("Made by", provenance.tool.clone()),
        ("Study", material.study.name.clone()),
        ("Study, SHA-256", provenance.study_digest.clone()),
        ("Seed", provenance.seed.to_string()),
        ("Content of the model file, SHA-256", provenance.content_digest.clone()),
    ];
    let own = own.into_iter().map(|(name, value)| (name.to_owned(), value));
    let rows = own.chain(material.facts.iter().cloned());
    let rows: String = rows
        .map(|(name, value)| format!("<tr><td>{}</td><td class=\"long\">{}</td></tr>\n", escape(&name), escape(&value)))
        .collect();
    let blocks = vec![ReportBlock::Html(format!("<table>\n{rows}</table>"))];
    Section { id: "provenance", title: "Provenance".into(), blocks }
}
