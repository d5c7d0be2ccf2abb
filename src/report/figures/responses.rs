//! Time responses: truth and prediction of single runs.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, INKS, Ink, ReportBlock, Section, Shape, case, escape, left_out,
    number, output, paragraph, shown,
};

/// Runs in one chart.
const CASES: usize = 5;

pub fn section(evaluated: &Evaluated) -> Section {
    let order = evaluated.runs_by_error();
    let median = order[(order.len() - 1) / 2];
    let worst = order[order.len() - 1];
    let mut blocks = Vec::new();
    for (what, id, run) in [("Median", "median", median), ("Worst", "worst", worst)] {
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
    let cases = cases(&order);
    let names: String = cases.iter().map(|&run| format!("<li>{}</li>", escape(&case(evaluated, run)))).collect();
    blocks.push(ReportBlock::Html("<h3>Several cases</h3>".into()));
    blocks.push(paragraph(
        "From the run with the smallest error to that with the largest one. Broad grey lines are the truth.",
    ));
    blocks.push(ReportBlock::Html(format!("<ol>{names}</ol>")));
    blocks.push(ReportBlock::Figures(shown(evaluated).map(|output| several(evaluated, &cases, output)).collect()));
    blocks.extend(left_out(evaluated));
    Section { id: "responses", title: "Time response".into(), blocks }
}

/// From the best run to the worst one, evenly by rank.
fn cases(order: &[usize]) -> Vec<usize> {
    super::super::numbers::evenly(order.len(), CASES).into_iter().map(|rank| order[rank]).collect()
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

fn several(evaluated: &Evaluated, cases: &[usize], column: usize) -> Figure {
    let (name, unit) = output(evaluated, column);
    let (mut truths, mut predictions) = (Vec::new(), Vec::new());
    let mut values = Vec::new();
    for ((case, &run), ink) in cases.iter().enumerate().zip(INKS) {
        let (truth, prediction) = curves(evaluated, run, column);
        values.extend(truth.iter().chain(&prediction).map(|point| point[1]));
        let first = (case == 0).then(|| "truth".to_owned());
        truths.push(ChartSeries { name: first, ink: Ink::Grey, shape: Shape::Broad(truth) });
        predictions.push(ChartSeries::named(format!("case {}", case + 1), ink, Shape::Line(prediction)));
    }
    let series = truths.into_iter().chain(predictions).collect();
    let chart = Chart { x: time_axis(evaluated, cases[0]), y: Axis::linear(name, unit, values), series };
    Figure::new(&format!("cases-{name}"), format!("{name}: {} runs.", cases.len()), chart)
}

/// Truth and prediction over time.
pub fn curves(evaluated: &Evaluated, run: usize, column: usize) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    evaluated.rows(run, column).map(|row| ([row.time, row.label], [row.time, row.prediction])).unzip()
}

pub fn time_axis(evaluated: &Evaluated, run: usize) -> Axis {
    let times = &evaluated.test.runs[run].times;
    Axis::exact("time", "s", times[0], times[times.len() - 1])
}
