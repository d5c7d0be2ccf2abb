//! The motion itself: phase plots and paths of points.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, Ink, Material, ReportBlock, Section, Shape, case, output, paragraph,
    responses::curves,
};
use crate::source::MovingPoint;

/// Largest number of charts of one kind.
const CHARTS: usize = 8;

pub fn section(material: &Material) -> Option<Section> {
    let evaluated = material.evaluated;
    let order = evaluated.runs_by_error();
    let runs = [("median", order[(order.len() - 1) / 2]), ("worst", order[order.len() - 1])];
    let mut blocks = Vec::new();
    let pairs = pairs(evaluated, runs[0].1);
    if !pairs.is_empty() {
        let shown = pairs.iter().take(CHARTS / 2);
        let figures = shown.flat_map(|&pair| runs.map(|(what, run)| phase(evaluated, what, run, pair))).collect();
        blocks.push(ReportBlock::Html("<h3>Phase plots</h3>".into()));
        blocks.push(paragraph("A quantity and its rate, in the median case and in the worst one."));
        blocks.push(ReportBlock::Figures(figures));
    }
    if !material.points.is_empty() {
        let shown = material.points.iter().take(CHARTS / 2);
        let figures = shown.flat_map(|point| runs.map(|(what, run)| path(evaluated, what, run, point))).collect();
        blocks.push(ReportBlock::Html("<h3>Paths of points</h3>".into()));
        blocks.push(paragraph("Both axes have the same scale. x points to the right, y upwards."));
        blocks.push(ReportBlock::Figures(figures));
    }
    (!blocks.is_empty()).then(|| Section { id: "motion", title: "Motion".into(), blocks })
}

/// Pairs of outputs of which the second is the rate of the first, by their units and by differences of a run.
fn pairs(evaluated: &Evaluated, run: usize) -> Vec<(usize, usize)> {
    let units: Vec<&str> = (0..evaluated.outputs()).map(|column| output(evaluated, column).1).collect();
    let quantities = (0..units.len()).filter(|&column| !units[column].contains('/'));
    quantities
        .filter_map(|quantity| {
            let rate = format!("{}/s", units[quantity]);
            let candidates = (0..units.len()).filter(|&column| units[column] == rate);
            let fits = candidates.map(|column| (column, misfit(evaluated, run, quantity, column)));
            fits.filter(|(_, misfit)| *misfit < 0.1)
                .min_by(|a, b| a.1.total_cmp(&b.1))
                .map(|(column, _)| (quantity, column))
        })
        .collect()
}

/// Mean squared difference of the differences of one output and another one, relative to the latter's spread.
fn misfit(evaluated: &Evaluated, run: usize, quantity: usize, rate: usize) -> f64 {
    let quantity: Vec<_> = evaluated.rows(run, quantity).collect();
    let rate: Vec<_> = evaluated.rows(run, rate).collect();
    let mean = rate.iter().map(|row| row.label).sum::<f64>() / rate.len() as f64;
    let (mut squares, mut spread) = (0.0, 0.0);
    for (around, row) in quantity.windows(3).zip(&rate[1.min(rate.len())..]) {
        let difference = (around[2].label - around[0].label) / (around[2].time - around[0].time);
        squares += (difference - row.label).powi(2);
        spread += (row.label - mean).powi(2);
    }
    if spread > 0.0 { squares / spread } else { f64::INFINITY }
}

fn phase(evaluated: &Evaluated, what: &str, run: usize, (quantity, rate): (usize, usize)) -> Figure {
    let ((name, unit), (rate_name, rate_unit)) = (output(evaluated, quantity), output(evaluated, rate));
    let (x_truth, x_prediction) = curves(evaluated, run, quantity);
    let (y_truth, y_prediction) = curves(evaluated, run, rate);
    let chart =
        plane([joined(&x_truth, &y_truth), joined(&x_prediction, &y_prediction)], [name, rate_name], [unit, rate_unit]);
    let caption = format!("{rate_name} over {name}, {what} case: {}.", case(evaluated, run));
    Figure::new(&format!("phase-{what}-{name}"), caption, chart)
}

/// A curve over another one.
fn joined(x: &[[f64; 2]], y: &[[f64; 2]]) -> Vec<[f64; 2]> {
    x.iter().zip(y).map(|(x, y)| [x[1], y[1]]).collect()
}

fn path(evaluated: &Evaluated, what: &str, run: usize, point: &MovingPoint) -> Figure {
    let parameters = &evaluated.test.runs[run].parameters;
    let columns: Vec<Vec<_>> = (0..evaluated.outputs()).map(|column| evaluated.rows(run, column).collect()).collect();
    let (mut truth, mut prediction) = (Vec::new(), Vec::new());
    for index in 0..columns[0].len() {
        let labels: Vec<f64> = columns.iter().map(|column| column[index].label).collect();
        let predictions: Vec<f64> = columns.iter().map(|column| column[index].prediction).collect();
        truth.push(point.position(parameters, &labels));
        prediction.push(point.position(parameters, &predictions));
    }
    let chart = plane([truth, prediction], ["x", "y"], ["m", "m"]).equal_scales();
    let name = &point.name;
    Figure::new(&format!("path-{what}-{name}"), format!("{name}, {what} case: {}.", case(evaluated, run)), chart)
}

/// Truth and prediction as curves in a plane.
fn plane(curves: [Vec<[f64; 2]>; 2], names: [&str; 2], units: [&str; 2]) -> Chart {
    let [x, y] = [0, 1].map(|axis| {
        let values = curves.iter().flatten().map(|point| point[axis]);
        Axis::linear(names[axis], units[axis], values)
    });
    let [truth, prediction] = curves;
    let series = vec![
        ChartSeries::named("truth", Ink::Black, Shape::Line(truth)),
        ChartSeries::named("prediction", Ink::Vermilion, Shape::Line(prediction)),
    ];
    Chart { x, y, series }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn a_rate_is_known_by_its_unit_and_its_values() {
        let (surrogate, mut test) = testing::exact();
        assert_eq!(pairs(&Evaluated::new(&surrogate, &test), 0), [], "the units fit, the values do not");
        for run in &mut test.runs {
            run.outputs = run.times.iter().flat_map(|&t| [t.sin(), t.cos()]).collect();
        }
        assert_eq!(pairs(&Evaluated::new(&surrogate, &test), 0), [(0, 1)]);
    }
}
