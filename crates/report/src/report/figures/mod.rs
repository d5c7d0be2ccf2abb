//! The sections of a report: one file a subject, each from numbers to charts and tables.

mod accuracy;
mod beside;
mod comparison;
mod coverage;
mod errors;
mod inputs;
mod motion;
mod responses;
mod sensitivity;
mod summary;
mod training;

use super::readable::{self, number, percent};
use super::{
    Evaluated, Figure, Material, ReportBlock, Section,
    axis::Axis,
    chart::{Chart, ChartSeries, INKS, Ink, Shape},
    first::REASONS,
};
use crate::{
    evaluation::TestRows,
    html::{escape, reasons},
};
pub use beside::Beside;
pub use summary::sentence;

/// Largest number of outputs that a section shows, in the study's order.
const OUTPUTS: usize = 12;

/// Every section that has content.
pub fn sections(material: &Material) -> Vec<Section> {
    let all = [
        verdict(material),
        Some(summary::summary(material)),
        Some(accuracy::section(material.evaluated)),
        (!material.evaluated.is_of_rows()).then(|| responses::section(material.evaluated)),
        inputs::section(material.evaluated),
        motion::section(material),
        Some(errors::section(material.evaluated)),
        // its numbers are of parameters and time alone
        (!material.evaluated.surrogate.program().has_memory() && !varying(material.evaluated).is_empty())
            .then(|| sensitivity::section(material.evaluated)),
        coverage::section(material.evaluated),
        material.comparison.map(|comparison| comparison::section(comparison, material.evaluated.is_of_rows())),
        beside::section(material),
        training::section(material),
        Some(summary::provenance(material)),
    ];
    all.into_iter().flatten().collect()
}

/// All reasons of the verdict, if the first screen has only some of them.
fn verdict(material: &Material) -> Option<Section> {
    let lines = reasons(material.verdict);
    let lines: Vec<String> = (lines.len() > REASONS).then_some(lines)?;
    let lines: String = lines.iter().map(|line| format!("<li>{line}</li>\n")).collect();
    let blocks = vec![ReportBlock::Html(format!("<ul>\n{lines}</ul>"))];
    Some(Section { id: "verdict", title: "Verdict".into(), blocks })
}

/// Figures of a model card: errors over time, and the worst test run of the output with the largest error. For a static
/// map they are the predictions of that output.
pub fn card_figures(evaluated: &Evaluated) -> Vec<Figure> {
    let worst = evaluated
        .accuracy
        .outputs
        .values()
        .enumerate()
        .map(|(output, metrics)| (output, metrics.r2.unwrap_or(1.0)))
        .min_by(|a, b| a.1.total_cmp(&b.1));
    if evaluated.is_of_rows() {
        return worst.iter().map(|(output, _)| accuracy::density_figure(evaluated, *output, "density")).collect();
    }
    let mut figures = errors::relative_over_time(evaluated);
    figures.truncate(1);
    let run = evaluated.runs_by_error().last().copied();
    if let (Some((output, _)), Some(run)) = (worst, run) {
        let mut figure = responses::response(evaluated, run, output, "worst");
        figure.caption = format!("Worst test run: {}. {}", case(evaluated, run), figure.caption);
        figures.push(figure);
    }
    figures
}

/// Name and unit of an output.
fn output<'a>(evaluated: &Evaluated<'a>, output: usize) -> (&'a str, &'a str) {
    let variable = &evaluated.test.outputs[output];
    (&variable.name, &variable.unit)
}

/// Name and unit of a parameter.
fn parameter<'a>(evaluated: &Evaluated<'a>, parameter: usize) -> (&'a str, &'a str) {
    let variable = &evaluated.test.parameters[parameter];
    (&variable.name, &variable.unit)
}

/// The outputs that are shown.
fn shown(evaluated: &Evaluated) -> std::ops::Range<usize> {
    0..evaluated.outputs().min(OUTPUTS)
}

/// Words for test runs and their parameters: unseen rows and inputs for a static map.
fn words(evaluated: &Evaluated) -> [&'static str; 2] {
    if evaluated.is_of_rows() { ["unseen rows", "input"] } else { ["test runs", "parameter"] }
}

/// The parameters that differ between the test runs: the others have no charts.
fn varying(evaluated: &Evaluated) -> Vec<usize> {
    (0..evaluated.test.parameters.len())
        .filter(|column| {
            let mut values = evaluated.test.runs.iter().map(|run| run.parameters[*column]);
            values.next().is_some_and(|first| values.any(|value| value != first))
        })
        .collect()
}

/// Returns true if the truth of an output varies: a constant has neither a diagonal nor a distribution.
fn varies(evaluated: &Evaluated, output: usize) -> bool {
    evaluated.accuracy.outputs[output].r2.is_some()
}

/// Note on the outputs that are not shown because there are too many.
fn left_out(evaluated: &Evaluated) -> Option<ReportBlock> {
    let count = evaluated.outputs();
    (count > OUTPUTS)
        .then(|| ReportBlock::Html(format!("<p class=\"note\">Shown are the first {OUTPUTS} of {count} outputs.</p>")))
}

/// A run or row and its parameters: `test run 3 with L = 0.12 m, c = 0.05`.
fn case(evaluated: &Evaluated, run: usize) -> String {
    let values = evaluated.test.parameters.iter().zip(&evaluated.test.runs[run].parameters);
    let values: Vec<String> = values
        .map(|(variable, &value)| {
            format!("{} = {} {}", variable.name, number(value), variable.unit).trim_end().to_owned()
        })
        .collect();
    match evaluated.is_of_rows() {
        true => format!("{} with {}", row_of(evaluated, run), values.join(", ")),
        false => format!("test run {run} with {}", values.join(", ")),
    }
}

/// Place of an unseen row.
fn row_of(evaluated: &Evaluated, row: usize) -> String {
    let table = if evaluated.accuracy.rows == Some(TestRows::OfRuns) { "the test table" } else { "unseen.csv" };
    format!("row {} of {table}", row + 1)
}

/// Lines of equal rank: name and points of each.
fn lines(of: impl IntoIterator<Item = (String, Vec<[f64; 2]>)>) -> Vec<ChartSeries> {
    let inks = INKS.iter().cycle();
    of.into_iter().zip(inks).map(|((name, points), &ink)| ChartSeries::named(name, ink, Shape::Line(points))).collect()
}

/// A table with a heading for each column; cells are HTML.
fn table(headings: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> ReportBlock {
    let heading: String = headings.iter().map(|heading| format!("<th>{heading}</th>")).collect();
    // on a phone cells are below each other, each beside its heading
    let rows: String = rows
        .into_iter()
        .map(|cells| {
            let cells = headings
                .iter()
                .zip(&cells)
                .map(|(heading, cell)| format!("<td data-heading=\"{heading}\">{cell}</td>"));
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        })
        .collect();
    ReportBlock::Html(format!("<table class=\"wide\">\n<tr>{heading}</tr>\n{rows}</table>"))
}

fn paragraph(text: &str) -> ReportBlock {
    ReportBlock::Html(format!("<p>{}</p>", escape(text)))
}

fn code(name: &str) -> String {
    format!("<code>{}</code>", escape(name))
}

fn unit(unit: &str) -> String {
    escape(if unit.is_empty() { "-" } else { unit })
}

/// `R²` as people read it.
fn r2(value: Option<f64>) -> String {
    value.map_or("constant output".into(), readable::r2)
}
