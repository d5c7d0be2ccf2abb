//! Errors over time, over each parameter, and in the parameters' ranges.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, Ink, ReportBlock, Section, Shape, left_out, lines, output, paragraph,
    parameter, shown, varying, words,
};
use crate::report::numbers::{Binned, evenly};
use rayon::prelude::*;

/// Runs that are drawn where they lie.
const RUNS: usize = 800;
/// Largest number of pairs of parameters that are drawn.
const PAIRS: usize = 6;
/// Outputs in one chart.
const LINES: usize = 6;

pub fn section(evaluated: &Evaluated) -> Section {
    let outputs: Vec<usize> = shown(evaluated).collect();
    let [tests, of] = words(evaluated);
    let mut blocks = Vec::new();
    if !evaluated.is_of_rows() {
        let over_time = outputs.par_iter().filter_map(|&output| over_time_figure(evaluated, output)).collect();
        blocks = vec![
            ReportBlock::Html("<h3>Over time</h3>".into()),
            paragraph(
                "Root mean square and largest error of all test runs at each instant, or over a few instants where there are many.",
            ),
            ReportBlock::Figures(over_time),
        ];
    }
    if varying(evaluated).is_empty() {
        return Section { id: "errors", title: "Where the errors are".into(), blocks };
    }
    blocks.extend([
        ReportBlock::Html(format!("<h3>Over each {of}</h3>")),
        paragraph(&format!(
            "Root mean square error of the {tests} in slices of the range of each {of}, relative to the outputs' ranges."
        )),
        ReportBlock::Figures(over_parameters(evaluated)),
        ReportBlock::Html(format!("<h3>Where the worst {} lie</h3>", last_word(tests))),
    ]);
    blocks.extend(worst_runs(evaluated));
    blocks.extend(left_out(evaluated));
    Section { id: "errors", title: "Where the errors are".into(), blocks }
}

fn over_time_figure(evaluated: &Evaluated, column: usize) -> Option<Figure> {
    let (name, unit) = output(evaluated, column);
    let Binned { at, rms, largest, .. } = evaluated.over_time(column);
    // as over a parameter
    largest.iter().any(|&error| error > 0.0).then_some(())?;
    let chart = Chart {
        x: Axis::exact("time", "s", at[0], at[at.len() - 1]),
        y: Axis::log(&format!("error of {name}"), unit, rms.iter().chain(&largest).copied()),
        series: vec![
            ChartSeries::named("largest", Ink::Vermilion, line(&at, &largest)),
            ChartSeries::named("root mean square", Ink::Blue, line(&at, &rms)),
        ],
    };
    Some(Figure::new(&format!("error-time-{name}"), format!("{name}: error over time."), chart))
}

/// Values over other values.
fn line(at: &[f64], values: &[f64]) -> Shape {
    Shape::Line(at.iter().zip(values).map(|(&t, &error)| [t, error]).collect())
}

/// Errors of several outputs in one chart, relative to their ranges.
pub fn relative_over_time(evaluated: &Evaluated) -> Vec<Figure> {
    let errors: Vec<Binned> =
        (0..evaluated.outputs()).into_par_iter().map(|output| evaluated.over_time(output)).collect();
    relative(evaluated, &errors, "time", "s", "error-time")
}

fn over_parameters(evaluated: &Evaluated) -> Vec<Figure> {
    let outputs = shown(evaluated).len();
    let figures = varying(evaluated).into_par_iter().flat_map_iter(|column| {
        let (name, unit) = parameter(evaluated, column);
        let errors: Vec<Binned> = (0..outputs).map(|output| evaluated.over_parameter(output, column)).collect();
        relative(evaluated, &errors, name, unit, &format!("error-{name}"))
    });
    figures.collect()
}

fn relative(evaluated: &Evaluated, errors: &[Binned], name: &str, unit: &str, id: &str) -> Vec<Figure> {
    let numbered: Vec<(usize, &Binned)> = errors.iter().enumerate().collect();
    let mut figures = Vec::new();
    for (part, columns) in numbered.chunks(LINES).enumerate() {
        let series = lines(columns.iter().map(|(column, binned)| {
            let relative = binned.rms.iter().map(|rms| rms / evaluated.range(*column));
            let points = binned.at.iter().zip(relative).map(|(&at, rms)| [at, rms]).collect();
            (output(evaluated, *column).0.to_owned(), points)
        }));
        let points: Vec<[f64; 2]> = series
            .iter()
            .flat_map(|series| match &series.shape {
                Shape::Line(points) => points.clone(),
                _ => Vec::new(),
            })
            .collect();
        // errors of zero have no place on a logarithmic axis
        if !points.iter().any(|point| point[1] > 0.0) {
            continue;
        }
        let x: Vec<f64> = points.iter().map(|point| point[0]).collect();
        let (low, high) = super::super::axis::extent(x).unwrap_or((0.0, 1.0));
        let chart = Chart {
            x: Axis::exact(name, unit, low, high),
            y: Axis::log("RMS error / range", "", points.iter().map(|point| point[1])),
            series,
        };
        let suffix = if part == 0 { String::new() } else { format!("-{}", part + 1) };
        figures.push(Figure::new(&format!("{id}-relative{suffix}"), format!("Relative errors over {name}."), chart));
    }
    figures
}

/// `rows` of `unseen rows`.
fn last_word(text: &'static str) -> &'static str {
    text.rsplit(' ').next().unwrap_or(text)
}

/// All runs and the worst twentieth of them, over pairs of parameters.
fn worst_runs(evaluated: &Evaluated) -> Vec<ReportBlock> {
    let [tests, of] = words(evaluated);
    let what = last_word(tests);
    let order = evaluated.runs_by_error();
    let (good, bad) = order.split_at(order.len() - (order.len() / 20).max(1));
    let good: Vec<usize> = evenly(good.len(), RUNS).into_iter().map(|index| good[index]).collect();
    let bad_shown: Vec<usize> = evenly(bad.len(), RUNS / 4).into_iter().map(|index| bad[index]).collect();
    let varying = varying(evaluated);
    let pairs: Vec<(usize, usize)> = (varying.iter().enumerate())
        .flat_map(|(index, &a)| varying[index + 1..].iter().map(move |&b| (a, b)))
        .collect();
    let series_at = |place: &dyn Fn(usize) -> [f64; 2]| {
        let [others, worst] = [&good, &bad_shown].map(|runs| runs.iter().map(|&run| place(run)).collect());
        vec![
            ChartSeries::named(format!("other {tests}"), Ink::Grey, Shape::Circles(others)),
            ChartSeries::named(format!("worst {what}"), Ink::Vermilion, Shape::Triangles(worst)),
        ]
    };
    let mut text = format!("The {} {what} with the largest errors, a twentieth of all.", bad.len());
    if bad_shown.len() + good.len() < order.len() {
        text += &format!(" Thinned: {} of {} {what} are drawn.", bad_shown.len() + good.len(), order.len());
    }
    if pairs.len() > PAIRS {
        text += &format!(" Shown are {PAIRS} of {} pairs of {of}s.", pairs.len());
    }
    let only = varying.first().filter(|_| varying.len() == 1);
    let mut figures: Vec<Figure> = (only.into_iter().copied())
        .map(|column| {
            let errors = evaluated.run_errors();
            let y = Axis::log("RMS error / range", "", errors.iter().copied());
            let name = parameter(evaluated, column).0;
            let series = series_at(&|run| [evaluated.test.runs[run].parameters[column], errors[run]]);
            let chart = Chart { x: parameter_axis(evaluated, column), y, series };
            Figure::new(&format!("worst-{name}"), format!("Errors of the {what} over {name}."), chart)
        })
        .collect();
    figures.extend(pairs.into_iter().take(PAIRS).map(|(a, b)| {
        let (a_name, b_name) = (parameter(evaluated, a).0, parameter(evaluated, b).0);
        let series = series_at(&|run| [a, b].map(|column| evaluated.test.runs[run].parameters[column]));
        let chart = Chart { x: parameter_axis(evaluated, a), y: parameter_axis(evaluated, b), series };
        Figure::new(
            &format!("worst-{a_name}-{b_name}"),
            format!("{} over {a_name} and {b_name}.", if evaluated.is_of_rows() { "Rows" } else { "Runs" }),
            chart,
        )
    }));
    vec![paragraph(&text), ReportBlock::Figures(figures)]
}

/// Axis over the range of a parameter.
fn parameter_axis(evaluated: &Evaluated, column: usize) -> Axis {
    let (name, unit) = parameter(evaluated, column);
    let input = &evaluated.surrogate.inputs()[column];
    Axis::linear(name, unit, [input.min, input.max])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    fn figures(section: Section) -> Vec<String> {
        let of_block = |block| match block {
            ReportBlock::Html(_) => Vec::new(),
            ReportBlock::Figures(figures) => figures.into_iter().map(|figure| figure.id).collect(),
        };
        section.blocks.into_iter().flat_map(of_block).collect()
    }

    #[test]
    fn parameters_that_do_not_vary_and_errors_of_zero_have_no_charts() {
        let (surrogate, mut test) = testing::exact();
        let exact = figures(section(&Evaluated::new(&surrogate, &test)));
        assert_eq!(exact, ["worst-length-speed"], "an exact surrogate has no errors to draw");
        test.runs[3].outputs[5 * 2] -= 0.25;
        let both = figures(section(&Evaluated::new(&surrogate, &test)));
        assert_eq!(both, ["error-time-angle", "error-length-relative", "error-speed-relative", "worst-length-speed"]);
        test.runs.iter_mut().for_each(|run| run.parameters[1] = 2.0);
        let one = figures(section(&Evaluated::new(&surrogate, &test)));
        assert!(one.iter().all(|figure| !figure.contains("speed")), "{one:?}");
        assert!(
            one.contains(&"error-length-relative".to_owned()) && one.contains(&"worst-length".to_owned()),
            "{one:?}"
        );
    }
}
