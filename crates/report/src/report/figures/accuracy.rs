//! Label against prediction, and how errors are distributed.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, Ink, ReportBlock, Section, Shape, left_out, output, paragraph, shown,
    varies,
};
use crate::report::numbers::{CELLS, Density, Histogram};
use rayon::prelude::*;

pub fn section(evaluated: &Evaluated) -> Section {
    let rows = evaluated.accuracy.test_rows;
    let mut blocks = vec![paragraph(&format!(
        "Predictions against labels of all {rows} test rows, counted in {CELLS} by {CELLS} cells: the darker, the more rows. A \
         perfect surrogate is on the diagonal."
    ))];
    let outputs: Vec<usize> = shown(evaluated).filter(|&output| varies(evaluated, output)).collect();
    blocks.push(ReportBlock::Figures(
        outputs.par_iter().map(|&output| density_figure(evaluated, output, "density")).collect(),
    ));
    blocks.push(ReportBlock::Html("<h3>Distribution of the errors</h3>".into()));
    blocks.push(paragraph("How often which error occurs, on a logarithmic scale: the outer bins hold single rows."));
    blocks.push(ReportBlock::Figures(outputs.par_iter().map(|&output| histogram_figure(evaluated, output)).collect()));
    blocks.extend(left_out(evaluated));
    Section { id: "accuracy", title: "Label against prediction".into(), blocks }
}

/// `prefix` begins the figure's id.
pub fn density_figure(evaluated: &Evaluated, column: usize, prefix: &str) -> Figure {
    let Density { low, high, counts } = evaluated.density(column);
    let (name, unit) = output(evaluated, column);
    let edges: Vec<f64> = (0..=CELLS).map(|cell| low + (high - low) * cell as f64 / CELLS as f64).collect();
    let most = counts.iter().copied().max().unwrap_or(1).max(2) as f64;
    let mut cells = Vec::new();
    for (row, counts) in counts.chunks(CELLS).enumerate() {
        let shades: Vec<u32> = counts
            .iter()
            .map(|&count| if count == 0 { 0 } else { 1 + (7.0 * (count as f64).ln() / most.ln()).round() as u32 })
            .collect();
        // neighbors of one shade become one rectangle
        let mut begin = 0;
        for same in shades.chunk_by(|a, b| a == b) {
            let end = begin + same.len();
            if same[0] > 0 {
                let corners = [[edges[begin], edges[row]], [edges[end], edges[row + 1]]];
                cells.push((corners, f64::from(same[0]) / 8.0));
            }
            begin = end;
        }
    }
    let chart = Chart {
        x: Axis::exact(&format!("{name}, label"), unit, low, high),
        y: Axis::exact(&format!("{name}, prediction"), unit, low, high),
        series: vec![
            ChartSeries::silent(Ink::Grey, Shape::Line(vec![[low, low], [high, high]])),
            ChartSeries::silent(Ink::Blue, Shape::Cells(cells)),
        ],
    };
    let most = counts.iter().max().unwrap_or(&0);
    Figure::new(
        &format!("{prefix}-{name}"),
        format!("{name}: prediction against label, 1 to {most} rows a cell."),
        chart,
    )
}

fn histogram_figure(evaluated: &Evaluated, column: usize) -> Figure {
    let Histogram { reach, counts } = evaluated.histogram(column);
    let (name, unit) = output(evaluated, column);
    let edges: Vec<f64> =
        (0..=counts.len()).map(|bin| reach * (2.0 * bin as f64 / counts.len() as f64 - 1.0)).collect();
    // bars begin at the axis, which has no zero
    let floor = 0.5;
    let filled = counts.iter().enumerate().filter(|(_, count)| **count > 0);
    let bars = filled.map(|(bin, &count)| [[edges[bin], floor], [edges[bin + 1], count as f64]]).collect();
    let most = counts.iter().copied().max().unwrap_or(1) as f64;
    let mut y = Axis::log("rows", "", [1.0, most]);
    y.low = floor;
    let rms = evaluated.accuracy.outputs[column].rms();
    let mut series = vec![ChartSeries::named("test rows", Ink::Sky, Shape::Bars(bars))];
    for (index, sign) in [-1.0, 1.0].into_iter().enumerate() {
        let line = Shape::Line(vec![[sign * rms, floor], [sign * rms, y.high]]);
        series
            .push(ChartSeries { name: (index == 0).then(|| "± RMS error".into()), ink: Ink::Vermilion, shape: line });
    }
    let chart = Chart { x: Axis::exact(&format!("error of {name}"), unit, -reach, reach), y, series };
    Figure::new(&format!("histogram-{name}"), format!("{name}: distribution of the errors."), chart)
}
