//! Sensitivity of each output to each parameter.

use super::{
    Axis, Chart, Evaluated, Figure, ReportBlock, Section, code, escape, left_out, lines, number, output, paragraph,
    parameter, shown, table, unit, varying, words,
};
use crate::report::numbers::{SENSITIVITY_RUNS, Sensitivity};

/// Parameters in one chart.
const LINES: usize = 6;

pub fn section(evaluated: &Evaluated) -> Section {
    let sensitivities = evaluated.sensitivities();
    let runs = evaluated.test.runs.len();
    let [tests, of] = words(evaluated);
    let mut text = format!(
        "Mean magnitude of the derivative of an output with respect to {} {of}, times the {of}'s range: by how much the output \
         changes over the whole range if it were linear. Derivatives are the surrogate's own and exact.",
        if evaluated.is_of_rows() { "an" } else { "a" }
    );
    if evaluated.surrogate.inputs().iter().any(|input| input.nominal_values().is_some()) {
        text += " A nominal parameter has no derivatives and is shown as 0.";
    }
    if runs > SENSITIVITY_RUNS {
        text += &format!(" Thinned: from {SENSITIVITY_RUNS} of {runs} {tests}.");
    }
    let mut blocks = vec![paragraph(&text), overview(evaluated, &sensitivities)];
    let outputs = shown(evaluated).zip(&sensitivities).filter(|_| !evaluated.is_of_rows());
    blocks.push(ReportBlock::Figures(
        outputs.flat_map(|(output, sensitivity)| over_time(evaluated, output, sensitivity)).collect(),
    ));
    blocks.extend(left_out(evaluated));
    Section { id: "sensitivity", title: format!("Sensitivity to the {of}s"), blocks }
}

/// A row an output, a column a parameter; shares of the row's sum as bars.
fn overview(evaluated: &Evaluated, sensitivities: &[Sensitivity]) -> ReportBlock {
    let varying = varying(evaluated);
    let names = varying.iter().map(|&column| escape(parameter(evaluated, column).0));
    let headings: Vec<String> = ["output", "unit"].map(String::from).into_iter().chain(names).collect();
    let headings: Vec<&str> = headings.iter().map(String::as_str).collect();
    table(
        &headings,
        sensitivities.iter().enumerate().map(|(column, sensitivity)| {
            let (name, output_unit) = output(evaluated, column);
            let sum = sensitivity.mean.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            let cells = varying.iter().map(|&column| {
                let value = sensitivity.mean[column];
                let share = 100.0 * value / sum;
                format!("{}<div class=\"bar\"><i style=\"width:{share:.0}%\"></i></div>", number(value))
            });
            [code(name), unit(output_unit)].into_iter().chain(cells).collect()
        }),
    )
}

fn over_time(evaluated: &Evaluated, column: usize, sensitivity: &Sensitivity) -> Vec<Figure> {
    let (name, unit) = output(evaluated, column);
    let parameters = varying(evaluated).into_iter().map(|column| (column, &sensitivity.over_time[column]));
    let parameters: Vec<(usize, &Vec<f64>)> = parameters.collect();
    let times = &sensitivity.times;
    let mut figures = Vec::new();
    for (part, parameters) in parameters.chunks(LINES).enumerate() {
        let values: Vec<f64> = parameters.iter().flat_map(|(_, values)| values.iter().copied()).collect();
        let series = lines(parameters.iter().map(|(index, values)| {
            let points = times.iter().zip(*values).map(|(&t, &value)| [t, value]).collect();
            (parameter(evaluated, *index).0.to_owned(), points)
        }));
        let chart = Chart {
            x: Axis::exact("time", "s", times[0], times[times.len() - 1]),
            y: Axis::linear(&format!("change of {name}"), unit, values.into_iter().chain([0.0])),
            series,
        };
        let suffix = if part == 0 { String::new() } else { format!("-{}", part + 1) };
        let caption = format!("{name}: sensitivity to each parameter over time.");
        figures.push(Figure::new(&format!("sensitivity-{name}{suffix}"), caption, chart));
    }
    figures
}
