//! Inputs that drove the worst test run of a surrogate with states.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, Ink, ReportBlock, Section, Shape, paragraph, responses::time_axis,
};

pub fn section(evaluated: &Evaluated) -> Option<Section> {
    let run = *evaluated.runs_by_error().last().filter(|_| !evaluated.test.inputs.is_empty())?;
    let figures = (0..evaluated.test.inputs.len()).map(|input| figure(evaluated, input, run)).collect();
    let text = format!("Inputs of the worst test run, {run}. Between two rows an input is a straight line.");
    Some(Section {
        id: "inputs",
        title: "Inputs".into(),
        blocks: vec![paragraph(&text), ReportBlock::Figures(figures)],
    })
}

fn figure(evaluated: &Evaluated, input: usize, index: usize) -> Figure {
    let variable = &evaluated.test.inputs[input];
    let run = &evaluated.test.runs[index];
    let values = run.inputs.iter().skip(input).step_by(evaluated.test.inputs.len());
    let points: Vec<[f64; 2]> = run.times.iter().zip(values).map(|(time, value)| [*time, *value]).collect();
    let y = Axis::linear(&variable.name, &variable.unit, points.iter().map(|point| point[1]));
    let series = vec![ChartSeries::silent(Ink::Blue, Shape::Line(points))];
    let chart = Chart { x: time_axis(evaluated, index), y, series };
    Figure::new(&format!("input-{}", variable.name), format!("{} in test run {index}.", variable.name), chart)
}
