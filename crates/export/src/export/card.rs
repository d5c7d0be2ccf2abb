//! The model card in every FMU, `documentation/index.html`: its function, its ranges of validity, its accuracy, and its
//! origin. One small page without anything to load.

use super::{
    describe::known,
    reference::{OPTIONS_FILE, RESULT_FILE},
};
use crate::{
    diagnostics::numbers::counted,
    evaluation::{Accuracy, Horizon, KindCoverage, RollOuts, TestRows, Verdict},
    html::{self, LOOK, escape},
    report::{
        Drawn, ranges,
        readable::{self, number},
    },
    study::{ExportOptions, FmuInterface, FmuPort, NameStyle},
};
use metafmu_runtime::{
    Bounds, BuiltIn, Clock, Encoding, Graph, Input, Integration, Layer, Motion, Output, Precision, Program, Role,
    Sampling, State, Surrogate, Tunability,
    dictionary::Dictionary,
    function_set::NetworkTerm,
    graph::{Elementwise, Step},
};

const STYLE: &str = "\
body{max-width:52rem;margin:0 auto;padding:.8rem 1rem 3rem}\
h1{font-size:1.5rem;line-height:1.2;margin:0}h2{font-size:1.15rem;margin:2rem 0 .3rem}p{margin:.5rem 0}\
table{width:100%}th,td{padding:.3rem .8rem .3rem 0}\
td.n,td.r{font-variant-numeric:tabular-nums;white-space:nowrap}code{font-size:.9em}\
figure{margin:1.5rem 0;max-width:35rem}figure svg{display:block;width:100%;height:auto}.d,figcaption{color:var(--dim)}\
h1,p,li,code,.d,figcaption{overflow-wrap:anywhere}td:first-child{min-width:4rem}\
@media(max-width:40rem){table{font-size:.85rem}td.r{white-space:normal}th,td{padding-right:.5rem}}@media(max-width:22rem){table{font-size:.75rem}}\
@media print{body{max-width:none;font-size:10pt}figure,tr{break-inside:avoid}h2{break-after:avoid}}";

/// The page; the same surrogate and options always give the same text.
pub fn card(surrogate: &Surrogate, about: &ExportOptions, accuracy: Option<&Accuracy>, figures: &[Drawn]) -> String {
    let metadata = surrogate.metadata();
    let name = escape(&metadata.name);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\"><title>{name}</title>\n\
         <meta name=\"viewport\" content=\"width=device-width\"><style>{LOOK}{STYLE}</style></head>\n<body>\n<h1>{name}</h1>\n"
    );
    let verdict = accuracy.and_then(|accuracy| accuracy.verdict.as_ref());
    page.push_str(&verdict.map_or(String::new(), |verdict| html::verdict(verdict, usize::MAX)));
    if !metadata.description.is_empty() {
        line(&mut page, &format!("<p>{}</p>", escape(&metadata.description)));
    }
    line(
        &mut page,
        &format!(
            "<p>This FMU is {} that stands in for a simulation model. {}{}.</p>",
            what(surrogate.program()),
            match surrogate.program().clock {
                Clock::Continuous(_) =>
                    "It integrates its states, driven by its inputs; any communication step size will do",
                Clock::Sampled(_) =>
                    "It is discrete-time, driven by its inputs; between samples outputs are linear in time, and any \
                     communication step size will do",
                Clock::Static if surrogate.time_column().is_none() => {
                    "It computes its outputs directly from its inputs and parameters, any step size will do"
                }
                Clock::Static => {
                    "It computes its outputs directly from its inputs, parameters and the time, any step size will do"
                }
            },
            match verdict {
                Some(Verdict { accepted: true, .. }) => {
                    format!(", and it is valid only within the ranges below{}", unchanged(surrogate))
                }
                _ => String::new(),
            }
        ),
    );
    page.push_str(&ranges(surrogate, verdict.is_none_or(|verdict| verdict.accepted)));
    accuracy_table(&mut page, surrogate, accuracy);
    for Drawn { caption, svg, .. } in figures {
        line(&mut page, &format!("<figure>{svg}<figcaption>{}</figcaption></figure>", escape(caption)));
    }
    variables(&mut page, surrogate, about.names);
    measured(surrogate, about, &mut page);
    domain(surrogate, about, &mut page);
    provenance(&mut page, surrogate, about);
    page.push_str("</body>\n</html>\n");
    page
}

/// Clause on inputs and parameters that were constant in each training run.
fn unchanged(surrogate: &Surrogate) -> &'static str {
    if surrogate.time_column().is_some()
        && surrogate
            .inputs()
            .iter()
            .any(|input| matches!(input.role, Role::Input | Role::Parameter(Tunability::Tunable)))
    {
        ", and as long as its inputs and parameters stay what they are at the start of a run: in each run of the \
         training they were constant"
    } else {
        ""
    }
}

/// Kind of model, as text.
fn what(program: &Program) -> &'static str {
    match &program.clock {
        Clock::Static if program.graph.is_network() || program.graph.instants().is_some() => "a neural network",
        Clock::Static if program.graph.dictionary().is_some() => "learned functions of its inputs",
        Clock::Static => of_baseline(&program.graph).map_or("a third-party model", |(what, _)| what),
        Clock::Continuous(_) if program.motion().is_some() => {
            "equations of motion with learned functions of the configuration"
        }
        Clock::Continuous(_) => "learned derivatives of states",
        Clock::Sampled(sampling) if sampling.hidden.is_empty() => "a model of recorded inputs and outputs",
        Clock::Sampled(_) => "a model with a memory",
    }
}

fn variables(page: &mut String, surrogate: &Surrogate, names: NameStyle) {
    line(page, "<h2>Variables</h2>\n<table><tr><th>Name</th><th>Kind</th><th>Range</th><th>Unit</th><th></th></tr>");
    for Input { name, role, unit, description, min, max, start, encoding } in surrogate.inputs() {
        let kind = match role {
            Role::Parameter(Tunability::Fixed) => "parameter, fixed",
            Role::Parameter(Tunability::Tunable) => "parameter, tunable",
            Role::Time => "time",
            Role::Input => "input",
            Role::Start => "parameter, state at the start",
        };
        let start = if *role == Role::Time { String::new() } else { format!(", starts at {}", number(*start)) };
        let range = match encoding {
            Encoding::Plain => format!("{} to {}", number(*min), number(*max)),
            Encoding::Nominal(values) => {
                format!("only {}", values.iter().map(|&value| number(value)).collect::<Vec<_>>().join(", "))
            }
            Encoding::Periodic => format!("periodic, {} is the same as {}", number(*max), number(*min)),
        };
        row(page, &names.of(name), kind, &format!("{range}{start}"), unit, description);
    }
    for State { name, unit, description, range, .. } in surrogate.states() {
        let range = range.map_or("any number".into(), |[min, max]| format!("{} to {}", number(min), number(max)));
        row(page, &names.of(name), "state", &range, unit, description);
    }
    for output in surrogate.outputs() {
        let Output { name, unit, description, min, max, .. } = output;
        let range = match output.constant() {
            Some(constant) => format!("constant, {}", number(constant)),
            None => format!("{} to {} in training", number(*min), number(*max)),
        };
        row(page, &names.of(name), "output", &range, unit, description);
    }
    line(page, "</table>");
}

fn row(page: &mut String, name: &str, kind: &str, range: &str, unit: &str, description: &str) {
    let (name, unit, description) = (code(name), escape(if unit.is_empty() { "-" } else { unit }), escape(description));
    let cells = format!("<td>{kind}</td><td class=\"r\">{range}</td><td>{unit}</td><td class=\"d\">{description}</td>");
    line(page, &format!("<tr><td>{name}</td>{cells}</tr>"));
}

/// A variable's name, which may be broken after an underscore or a dot where the page is narrow.
fn code(name: &str) -> String {
    format!("<code>{}</code>", escape(name).replace('_', "_<wbr>").replace('.', ".<wbr>"))
}

fn accuracy_table(page: &mut String, surrogate: &Surrogate, accuracy: Option<&Accuracy>) {
    line(page, "<h2>Accuracy</h2>");
    let Some(accuracy) = accuracy else {
        return line(page, "<p>The model was not evaluated before this FMU was made.</p>");
    };
    let Accuracy { outputs, test_runs, rows, seen_until, .. } = accuracy;
    let test_rows = readable::count(accuracy.test_rows);
    let runs = format!("{} of the original model ({test_rows} rows)", counted(*test_runs, "run"));
    let measured = match (rows, seen_until) {
        (Some(TestRows::Given), _) => format!("{test_rows} rows that were given for it"),
        (Some(TestRows::OfRuns), _) => format!("{test_rows} rows of runs that took no part in training"),
        (Some(TestRows::HeldOut), _) => {
            format!("{test_rows} rows that were held out of the training and of every choice")
        }
        (Some(TestRows::CrossValidated), _) => {
            format!(
                "{test_rows} rows, each predicted by a model that was fitted in the same way without it (cross-validation)"
            )
        }
        (None, Some(stop)) => format!("{runs}, the rows up to {stop} s of which it was learned from"),
        (None, None) => format!("{runs} that took no part in training"),
    };
    let bounds = surrogate.bounds();
    let heading =
        bounds.map_or(String::new(), |bounds| format!("<th>{} bound</th>", readable::percent(bounds.coverage)));
    line(
        page,
        &format!(
            "<p>Measured on {measured}.</p>\n\
             <table><tr><th>Output</th><th>R²</th><th>RMS error</th><th>Largest error, of the range</th>{heading}</tr>"
        ),
    );
    for (column, output) in surrogate.predictions().iter().enumerate() {
        let Some(metrics) = outputs.get(&output.name) else { continue };
        let r2 = metrics.r2.map_or("constant output".into(), readable::r2);
        let (rms, largest) = (number(metrics.rms()), number(metrics.max_abs_error));
        let (name, unit) = (code(&output.name), escape(&output.unit));
        let share =
            metrics.relative_max_error.map_or(String::new(), |share| format!("<br>{} %", number(100.0 * share)));
        let bound = bounds.map(|bounds| format!("±{}", number(bounds.largest(column))));
        let cells = [r2, rms, largest + &share].into_iter().chain(bound);
        let cells: String = cells.map(|cell| format!("<td class=\"n\">{cell}</td>")).collect();
        line(page, &format!("<tr><td>{name} {unit}</td>{cells}</tr>"));
    }
    line(page, "</table>");
    for text in accuracy.noise(surrogate) {
        line(page, &format!("<p>{}.</p>", escape(&text)));
    }
    if let Some(text) = accuracy.within_two_std() {
        line(page, &format!("<p>{text}. The FMU has the standard deviations as outputs, <code>…_std</code>.</p>"));
    }
    roll_outs(page, accuracy.roll_outs.as_ref());
    if let Some(bounds @ Bounds { coverage, runs, times, .. }) = surrogate.bounds() {
        let of_output = surrogate.predictions().iter().enumerate().map(|(index, output)| {
            let unit = if output.unit.is_empty() { String::new() } else { format!(" {}", escape(&output.unit)) };
            let width = match times.as_slice() {
                [] => format!("±{}", number(bounds.largest(index))),
                // at the beginning it is hardly ever of interest
                [.., last] => {
                    [0.5 * last, *last].map(|time| format!("±{}", number(bounds.at(index, time)))).join(" and ")
                }
            };
            format!("{} {width}{unit}", code(&output.name))
        });
        let of_output = of_output.collect::<Vec<_>>().join(", ");
        let when = times.last().map_or(String::new(), |last| {
            format!(" {} s and {} s after the start, and grow over time", number(0.5 * last), number(*last))
        });
        let share = number(100.0 * coverage);
        let expected = match rows {
            Some(_) => format!(
                "{share} % of further rows inside the ranges are expected within each (conformal, from the errors of these {runs} rows)"
            ),
            None => format!(
                "Of a further run inside the ranges, {share} % of the points are expected within each (split-conformal, from {runs} separate \
                 runs)"
            ),
        };
        line(
            page,
            &format!(
                "<p>Error bounds{when}: {of_output}. {expected}. The FMU's variables <code>…_bound</code> have them, unless its interface is plain.</p>"
            ),
        );
        kinds(page, &accuracy.calibration);
    }
}

/// Coverage of the bounds for each kind of signal.
fn kinds(page: &mut String, calibration: &[KindCoverage]) {
    let Some(first) = calibration.first() else { return };
    let names: String = first.within.keys().map(|name| format!("<th>{}</th>", code(name))).collect();
    line(
        page,
        &format!(
            "<p>Share of the calibration runs' points within the bounds, which are the largest that any kind of signal needs; those of other kinds than \
             the study's signals count while outputs are in their ranges.</p>\n<table><tr><th>Signals</th><th>Runs</th>{names}</tr>"
        ),
    );
    for KindCoverage { kind, runs, within } in calibration {
        let shares: String =
            within.values().map(|share| format!("<td class=\"n\">{:.1} %</td>", 100.0 * share)).collect();
        line(page, &format!("<tr><td>{kind}</td><td class=\"n\">{runs}</td>{shares}</tr>"));
    }
    line(page, "</table>");
}

/// Growth of errors along roll-outs.
fn roll_outs(page: &mut String, roll_outs: Option<&RollOuts>) {
    let Some(RollOuts { horizons, .. }) = roll_outs else { return };
    line(
        page,
        "<p>Each test run set the states once, at the start, and was driven by its inputs. The table has the root mean square error up to a \
         time, relative to the spread of the run's outputs, of the worst output. Beside it stands the motion's own sensitivity: the effect of \
         an initial state perturbed by 10⁻⁹.</p>\n<table><tr><th>After</th><th>Median of the \
         runs</th><th>90 % of the runs</th><th>Perturbed by 10⁻⁹: median</th><th>90 %</th></tr>",
    );
    for Horizon { seconds, median, q90, sensitivity: [changed, changed_q90], .. } in horizons {
        let numbers = [median, q90, changed, changed_q90]
            .map(|value| format!("<td class=\"n\">{}</td>", readable::brief(*value)));
        line(page, &format!("<tr><td class=\"n\">{} s</td>{}</tr>", number(*seconds), numbers.concat()));
    }
    line(page, "</table>");
}

fn domain(surrogate: &Surrogate, about: &ExportOptions, page: &mut String) {
    line(page, "<h2>Outside the ranges</h2>");
    match about.interface {
        FmuInterface::Plain => line(
            page,
            "<p>This FMU was exported with a plain interface: it logs a warning once a run, and has no variable that says so.</p>",
        ),
        FmuInterface::Study => {
            line(page, "<table>");
            for variable in BuiltIn::ALWAYS {
                let (name, description) = (code(variable.name()), escape(variable.description(known(surrogate))));
                line(page, &format!("<tr><td>{name}</td><td>{description}</td></tr>"));
            }
            line(page, "</table>");
        }
    }
    line(
        page,
        &format!(
            "<h2>Reference run</h2>\n<p><code>{OPTIONS_FILE}</code> says what to run and with which values, \
             <code>{RESULT_FILE}</code> holds the outputs that must come out.</p>"
        ),
    );
}

/// Inputs with which a discrete-time surrogate starts from measured outputs.
fn measured(surrogate: &Surrogate, about: &ExportOptions, page: &mut String) {
    if !about.ports.contains(&FmuPort::Measured) {
        return;
    }
    let switch = BuiltIn::UseMeasured;
    let names = surrogate.outputs().iter().map(|output| measured_name(output, about.names));
    line(page, "<h2>Start from measured outputs</h2>\n<table>");
    let values = "Measured values of the outputs, held or extrapolated as other inputs";
    for (name, description) in [
        (names.collect::<Vec<_>>().join(", "), values.to_owned()),
        (code(switch.name()), escape(switch.description(known(surrogate)))),
    ] {
        line(page, &format!("<tr><td>{name}</td><td>{description}</td></tr>"));
    }
    line(page, "</table>");
}

/// The name of the input with measured values of an output.
fn measured_name(output: &Output, style: NameStyle) -> String {
    code(&Output::measured_name(&style.of(&output.name)))
}

/// Text on the model that computes the outputs.
fn model(surrogate: &Surrogate) -> String {
    let metadata = surrogate.metadata();
    let Program { graph, clock } = surrogate.program();
    let (count, network) = match (clock, graph.instants()) {
        (Clock::Continuous(integration), _) => {
            let size = match surrogate.program().motion() {
                Some(motion) => size_of_motion(motion, *integration),
                None => {
                    let functions = size_of_functions(graph, &format!("of {} states, ", surrogate.states().len()));
                    format!("{functions}; {}", integrated(*integration))
                }
            };
            return size + &accuracy_of_solver(metadata.solver_error);
        }
        (Clock::Static, _) if graph.dictionary().is_some() => return size_of_functions(graph, ""),
        (Clock::Sampled(sampling), _) => return size_of_samples(graph, sampling),
        (Clock::Static, Some((instants, functions))) => (instants.len(), functions[0].network()),
        (Clock::Static, None) => (1, graph.network()),
    };
    let Some(network) = network else {
        let size = of_baseline(graph).map(|(_, size)| format!("{size}, computed in double precision"));
        return size.unwrap_or_else(|| size_of_graph(graph));
    };
    let precision = match metadata.precision {
        Precision::Double => "double precision",
        Precision::Single => "single precision (source code in double, or single by METAFMU_SINGLE)",
    };
    let each = if count > 1 {
        format!(" in each of {count} networks, one an instant, between which outputs are interpolated in time")
    } else {
        String::new()
    };
    format!("network, {}{each}, computed in {precision}", nodes(&network.layers))
}

/// Kind and size of a baseline, from steps that only baselines have: a mean is subtracted first, kernels are Gaussian.
fn of_baseline(graph: &Graph) -> Option<(&'static str, String)> {
    match graph.steps.as_slice() {
        [first, Step::Affine { weight, bias, .. }] if applies(first, Elementwise::Linear) => {
            Some(("a polynomial", format!("polynomial of {} terms", weight.len() / bias.len() + 1)))
        }
        [.., Step::Products { products, .. }, _] => {
            Some(("a polynomial", format!("polynomial of {} terms", products.terms())))
        }
        [first, Step::Forest { forest, .. }, last]
            if applies(first, Elementwise::Linear) && applies(last, Elementwise::Linear) =>
        {
            let size = format!("{} decision trees, {} nodes", forest.trees.len(), forest.nodes.len());
            Some(("a sum of decision trees, piecewise constant,", size))
        }
        steps => {
            let kernels = steps.windows(2).filter(|pair| applies(&pair[0], Elementwise::Gaussian));
            let kernels = kernels.map(|pair| if let Step::Affine { weight, .. } = &pair[1] { weight.len() } else { 0 });
            let count: usize = kernels.sum();
            (count > 0).then(|| ("a sum of kernels", format!("{count} kernels")))
        }
    }
}

/// Returns true if a step applies a function to each of its numbers.
fn applies(step: &Step, wanted: Elementwise) -> bool {
    matches!(step, Step::Elementwise { function, .. } if *function == wanted)
}

/// Size of a graph as text.
fn size_of_graph(graph: &Graph) -> String {
    let weights: usize = (graph.steps.iter())
        .map(|step| match step {
            Step::Affine { weight, .. } => weight.len(),
            Step::Distances { centres, .. } => centres.len(),
            Step::Forest { forest, .. } => forest.nodes.len(),
            _ => 0,
        })
        .sum();
    format!("graph of {} steps with {weights} weights, computed in double precision", graph.steps.len())
}

/// Size of the functions `of` states, inputs and parameters, as text.
fn size_of_functions(graph: &Graph, of: &str) -> String {
    let products = match graph.products() {
        0 => None,
        count => Some(format!("{count} products of sines, cosines and powers")),
    };
    let called = graph.called();
    let functions = called.map(outputs).or(graph.dictionary().map(Dictionary::outputs)).unwrap_or_default();
    let given: Vec<String> = products.into_iter().chain(called.map(of_function)).collect();
    format!("{functions} functions {of}of inputs and parameters: {}", given.join(", and "))
}

/// Number of outputs of a checked graph.
fn outputs(graph: &Graph) -> usize {
    graph.widths().ok().and_then(|widths| widths.last().copied()).unwrap_or_default()
}

/// Text on the function that computes the next outputs, and on its inputs.
fn size_of_samples(graph: &Graph, sampling: &Sampling) -> String {
    let Sampling { hidden, direct, history: [outputs, inputs], step, .. } = sampling;
    let is_linear = graph.steps.iter().any(|step| matches!(step, Step::Affine { .. }));
    let linear = is_linear.then(|| "a linear function".into());
    let given: Vec<String> = linear.into_iter().chain(graph.called().map(of_function)).collect();
    let hidden = match hidden.len() {
        0 => String::new(),
        count => format!(" and of {count} hidden states"),
    };
    let at_once = if direct.is_empty() { "" } else { ", and inputs act on outputs at once as well" };
    format!(
        "samples {step} s apart: the next outputs are {} of the parameters, the last {outputs} samples of the outputs{hidden} and the last \
         {inputs} of the inputs{at_once}; before the start nothing has moved",
        given.join(" and "),
    )
}

/// A function beside others.
fn of_function(function: &Graph) -> String {
    match function.network() {
        Some(network) => format!("a network, {}", nodes(&network.layers)),
        None => format!("a {}", of_baseline(function).map_or_else(|| size_of_graph(function), |(_, size)| size)),
    }
}

/// Size of the functions in equations of motion, and their integration.
fn size_of_motion(motion: &Motion, integration: Integration) -> String {
    let Motion { dynamics, positions, reactions, .. } = motion;
    let networks = [
        beside("the equations", dynamics.function_set().network()),
        beside("positions", positions.network()),
        beside("forces", dynamics.forces()),
    ];
    let of_reactions = reactions
        .as_ref()
        .map_or(String::new(), |reactions| format!(", {} for forces", reactions.functions().products()));
    format!(
        "equations of motion in {} generalized coordinates, {} products of sines, cosines and powers ({} for positions{of_reactions}){}; {}",
        dynamics.coordinates(),
        dynamics.function_set().dictionary().products(),
        positions.dictionary().products(),
        networks.concat(),
        integrated(integration),
    )
}

/// Clause on a network beside the functions of an equation; empty without one.
fn beside(what: &str, term: Option<&NetworkTerm>) -> String {
    term.map_or(String::new(), |term| format!(", a network for {what}, {}", nodes(&term.network().layers)))
}

/// Text on the error that the solver adds to that of the equations.
fn accuracy_of_solver(error: Option<f64>) -> String {
    error.map_or(String::new(), |error| {
        format!(
            "; in the training runs, and at corners of parameters, inputs and velocities, its effect is that of an initial state perturbed by at most {}",
            readable::brief(error)
        )
    })
}

/// Integration of the states as text.
fn integrated(integration: Integration) -> String {
    match integration {
        Integration::ErrorControlled { tolerance, longest } => format!(
            "integrated with error control: each step is off by at most {} of a state's nominal value, or the host's tolerance if that is \
             smaller, and no longer than {longest} s (Dormand and Prince, order 5)",
            readable::brief(tolerance)
        ),
        Integration::Implicit { tolerance, longest } => format!(
            "integrated by an implicit method with error control (Rodas5P, order 5), as the equations are stiff: each step is off by at most \
             {} of a state's nominal value, or the host's tolerance if that is smaller, and no longer than {longest} s; a step takes nine \
             evaluations of the equations and one for each state, and solves eight systems of linear equations",
            readable::brief(tolerance)
        ),
        Integration::Fixed { step } => {
            format!("integrated in equal steps of at most {step} s (Runge-Kutta, order 4), for real time")
        }
    }
}

/// Hidden layers as text, for instance `64 + 64 tanh nodes`.
fn nodes(layers: &[Layer]) -> String {
    let hidden = &layers[..layers.len() - 1];
    let mut words: Vec<String> = Vec::new();
    for group in hidden.chunk_by(|layer, next| layer.activation == next.activation) {
        let sizes: Vec<String> = group.iter().map(|layer| layer.outputs.to_string()).collect();
        words.push(format!("{} {} nodes", sizes.join(" + "), group[0].activation.name()));
    }
    if words.is_empty() { "no hidden layer".into() } else { words.join(", ") }
}

fn provenance(page: &mut String, surrogate: &Surrogate, about: &ExportOptions) {
    let metadata = surrogate.metadata();
    let provenance = &metadata.provenance;
    line(page, "<h2>Provenance</h2>\n<table>");
    for (what, value) in [
        ("Made by", Some(provenance.tool.clone())),
        ("Model", Some(model(surrogate))),
        ("Training", Some(format!("{} rows, seed {}", provenance.train_rows, provenance.seed))),
        ("Study, SHA-256", Some(provenance.study_digest.clone())),
        ("Content of the model file, digest", Some(provenance.content_digest.clone())),
        ("Author", about.author.clone()),
        ("Copyright", about.copyright.clone()),
        ("License of the model", Some(about.license.clone().unwrap_or_else(|| "none stated".into()))),
        (
            "License of the runtime library",
            Some("MIT OR Apache-2.0, see the folder licenses beside this page; it does not cover the model".into()),
        ),
    ] {
        if let Some(value) = value {
            line(page, &format!("<tr><td>{what}</td><td class=\"d\">{}</td></tr>", escape(&value)));
        }
    }
    line(page, "</table>");
}

fn line(page: &mut String, text: &str) {
    page.push_str(text);
    page.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::{AcceptanceCheck, Findings, OutputMetrics, Reason};
    use metafmu_example as example;

    #[test]
    fn a_card_has_variables_accuracy_and_license_and_loads_nothing() {
        let surrogate = example::surrogate();
        let about = ExportOptions { license: Some("<free> & open".into()), ..ExportOptions::default() };
        let metrics = |r2| OutputMetrics {
            r2,
            mse: 4e-6,
            max_abs_error: 0.0125,
            relative_max_error: Some(0.005),
            worst_run: 3,
            worst_time: 1.0,
            bound: None,
            within_bound: None,
            within_two_std: None,
            noise: None,
        };
        let accuracy = Accuracy {
            outputs: [("angle".into(), metrics(Some(0.99987))), ("velocity".into(), metrics(None))].into(),
            regular_outputs: [].into(),
            test_runs: 20,
            test_rows: 4020,
            given_rows: 0,
            content_digest: String::new(),
            roll_outs: None,
            rows: None,
            seen_until: None,
            outside: None,
            source_equations: None,
            calibration: Vec::new(),
            verdict: Some(Verdict::of(Findings::default())),
        };
        let figure =
            Drawn { id: "f".into(), caption: "truth & prediction".into(), svg: "<svg viewBox=\"0 0 1 1\"/>".into() };
        let page = card(&surrogate, &about, Some(&accuracy), &[figure]);
        for piece in [
            "<td><code>length</code></td><td>parameter, tunable</td><td class=\"r\">0.1 to 0.2, starts at 0.15</td><td>m</td>",
            "<td><code>angle</code> rad</td><td class=\"n\">0.99987</td><td class=\"n\">0.002</td><td class=\"n\">0.0125<br>0.5 %</td>",
            "20 runs of the original model (4020 rows)",
            "constant output",
            "as long as its inputs and parameters stay what they are at the start of a run",
            "&lt;free&gt; &amp; open",
            "domain_<wbr>policy",
            "<figure><svg viewBox=\"0 0 1 1\"/><figcaption>truth &amp; prediction</figcaption></figure>",
        ] {
            assert!(page.contains(piece), "{piece} is not in {page}");
        }
        assert!(!page.contains("http") && !page.contains("src="), "{page}");
        let trusted = "is valid only within the ranges";
        assert!(
            page.contains(trusted)
                && !page.contains("Rejected")
                && page.contains("<b>Valid for</b> <span><code>length</code> 0.1 to 0.2 m"),
            "{page}"
        );
        let of_rows = Accuracy { rows: Some(TestRows::HeldOut), verdict: None, ..accuracy.clone() };
        let of_rows = card(&surrogate, &about, Some(&of_rows), &[]);
        assert!(
            of_rows.contains("4020 rows that were held out of the training") && !of_rows.contains("20 runs"),
            "{of_rows}"
        );
        let unknown = card(&surrogate, &ExportOptions::default(), None, &[]);
        assert!(unknown.contains("was not evaluated") && !unknown.contains(trusted), "{unknown}");
        assert!(unknown.contains("<td>License of the model</td><td class=\"d\">none stated</td>"), "{unknown}");
        let problem = Reason::new(AcceptanceCheck::Accuracy, "angle", "R² -1 < 0");
        let advice = vec!["more runs".into()];
        let verdict = Some(Verdict::of(Findings { problems: vec![problem], advice, ..Findings::default() }));
        let rejected = card(&surrogate, &about, Some(&Accuracy { verdict, ..accuracy }), &[]);
        let (title, rest) = rejected.split_once("</h1>").unwrap();
        assert!(
            rest.starts_with(
                "\n<div class=\"verdict rejected\"><p><strong>Rejected</strong>: this surrogate is not good enough"
            ),
            "{title}{rest}"
        );
        assert!(
            rest.contains("<li>Try: more runs</li>") && page.contains("<p><strong>Good</strong>: every output"),
            "{rest}"
        );
        assert!(rest.contains("<li>angle: R² -1 &lt; 0</li>") && !rest.contains(trusted), "{rest}");
    }
}
