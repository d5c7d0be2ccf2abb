//! Time responses: truth and prediction of single runs.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, Ink, ReportBlock, Section, Shape, case, left_out, number, output,
    paragraph, shown,
};

pub fn section(evaluated: &Evaluated) -> Section {
    let order = evaluated.runs_by_error();
    let median = order[(order.len() - 1) / 2];
    let worst = order[order.len() - 1];
    let mut blocks = Vec::new();
    for (what, id, run) in [("Worst", "worst", worst), ("Median", "median", median)] {
        let error = 100.0 * evaluated.run_errors()[run];
        blocks.push(ReportBlock::Html(format!("<h3>{what} case</h3>")));
        blocks.push(paragraph(&format!(
            "{what} of all test runs by the root mean square error relative to the outputs' ranges, {} %: {}.",
            number(error),
            case(evaluated, run)
        )));
        blocks
            .push(ReportBlock::Figures(shown(evaluated).map(|output| response(evaluated, run, output, id)).collect()));
    }
    blocks.extend(left_out(evaluated));
    Section { id: "responses", title: "Time response".into(), blocks }
}

/// Truth and prediction of an output in a run; `prefix` begins the figure's id.
pub fn response(evaluated: &Evaluated, run: usize, column: usize, prefix: &str) -> Figure {
    let (name, unit) = output(evaluated, column);
    let (truth, prediction) = curves(evaluated, run, column);
    let mut values: Vec<f64> = truth.iter().chain(&prediction).map(|point| point[1]).collect();
    let mut series = Vec::new();
    let band = prediction.iter().map(|&[t, y]| evaluated.bound(column, t).map(|bound| [t, y - bound, y + bound]));
    if let Some(band) = band.collect::<Option<Vec<[f64; 3]>>>() {
        values.extend(band.iter().flat_map(|&[_, low, high]| [low, high]));
        series.push(ChartSeries::named("error bound", Ink::Sky, Shape::Band(band)));
    }
    series.push(ChartSeries::named("truth", Ink::Black, Shape::Line(truth)));
    series.push(ChartSeries::named("prediction", Ink::Vermilion, Shape::Line(prediction)));
    let chart = Chart { x: time_axis(evaluated, run), y: Axis::linear(name, unit, values), series };
    let caption = format!("{name}: RMS error {} {unit}", number(evaluated.rms(run, column)));
    Figure::new(&format!("{prefix}-{name}"), format!("{}.", caption.trim_end()), chart)
}

/// Truth and prediction over time.
pub fn curves(evaluated: &Evaluated, run: usize, column: usize) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    evaluated.rows(run, column).map(|row| ([row.time, row.label], [row.time, row.prediction])).unzip()
}

pub fn time_axis(evaluated: &Evaluated, run: usize) -> Axis {
    let times = &evaluated.test.runs[run].times;
    Axis::exact("time", "s", times[0], times[times.len() - 1])
}
