//! Inputs that drove the test runs of a surrogate with states.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, INKS, ReportBlock, Section, Shape, paragraph, responses::time_axis,
};

/// Runs in one chart.
const RUNS: usize = 3;

pub fn section(evaluated: &Evaluated) -> Option<Section> {
    if evaluated.test.inputs.is_empty() {
        return None;
    }
    let runs = evaluated.test.runs.len().min(RUNS);
    let figures = (0..evaluated.test.inputs.len()).map(|input| figure(evaluated, input, runs)).collect();
    let text = format!("What drove the first {runs} test runs. Between two rows an input is a straight line.");
    Some(Section {
        id: "inputs",
        title: "Inputs".into(),
        blocks: vec![paragraph(&text), ReportBlock::Figures(figures)],
    })
}

fn figure(evaluated: &Evaluated, input: usize, runs: usize) -> Figure {
    let variable = &evaluated.test.inputs[input];
    let count = evaluated.test.inputs.len();
    let mut values = Vec::new();
    let series = (0..runs).map(|index| {
        let run = &evaluated.test.runs[index];
        let rows = run.times.iter().zip(run.inputs.iter().skip(input).step_by(count));
        let points: Vec<[f64; 2]> = rows.map(|(time, value)| [*time, *value]).collect();
        values.extend(points.iter().map(|point| point[1]));
        ChartSeries::named(format!("test run {index}"), INKS[index % INKS.len()], Shape::Line(points))
    });
    let series = series.collect();
    let chart = Chart { x: time_axis(evaluated, 0), y: Axis::linear(&variable.name, &variable.unit, values), series };
    Figure::new(&format!("input-{}", variable.name), format!("{}.", variable.name), chart)
}
