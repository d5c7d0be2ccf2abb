//! How often the truth is within the surrogate's error bound.

use super::{
    Axis, Chart, ChartSeries, Evaluated, Figure, Ink, ReportBlock, Section, Shape, code, left_out, number, output,
    paragraph, percent, shown, table, unit,
};
use crate::report::numbers::Binned;
use metafmu_runtime::Bounds;
use rayon::prelude::*;

pub fn section(evaluated: &Evaluated) -> Option<Section> {
    // bounds of a static map were measured on the same rows
    let bounds @ Bounds { coverage, runs, .. } = evaluated.surrogate.bounds().filter(|_| !evaluated.is_of_rows())?;
    let bounded: Vec<usize> = shown(evaluated).collect();
    let stated = *coverage;
    let text = format!(
        "The truth is expected within the bound around the prediction in {} of the rows of a further run inside the ranges \
         (split-conformal, from {runs} separate runs). This is how often it is, on the test runs: over all rows, at the worst \
         instant, and at all instants of a run.",
        percent(stated)
    );
    let coverages: Vec<Coverage> = bounded.par_iter().map(|&column| Coverage::of(evaluated, column)).collect();
    let rows = bounded.iter().zip(&coverages).map(|(&column, coverage)| {
        let (name, output_unit) = output(evaluated, column);
        let worst = coverage.over_time.within.iter().copied().fold(1.0, f64::min);
        vec![
            code(name),
            unit(output_unit),
            number(bounds.largest(column)),
            percent(coverage.rows),
            percent(worst),
            percent(coverage.runs),
        ]
    });
    let bound = if bounds.grow() { "bound at the end" } else { "bound" };
    let headings = ["output", "unit", bound, "rows within", "at the worst instant", "runs within"];
    let figures = bounded
        .iter()
        .zip(&coverages)
        .map(|(&column, coverage)| over_time(evaluated, column, stated, &coverage.over_time));
    let mut blocks = vec![paragraph(&text), table(&headings, rows), ReportBlock::Figures(figures.collect())];
    blocks.extend(left_out(evaluated));
    Some(Section { id: "coverage", title: "Error bounds".into(), blocks })
}

struct Coverage {
    over_time: Binned,
    /// Share of the rows within the bound.
    rows: f64,
    /// Share of the runs that are within it at every instant.
    runs: f64,
}

impl Coverage {
    fn of(evaluated: &Evaluated, column: usize) -> Self {
        let (mut rows, mut runs) = (0, 0);
        let count = evaluated.test.runs.len();
        for run in 0..count {
            let within =
                evaluated.rows(run, column).filter(|row| evaluated.is_within(column, row) == Some(true)).count();
            rows += within;
            runs += usize::from(within == evaluated.run_rows(run));
        }
        let over_time = evaluated.over_time(column);
        Self { over_time, rows: rows as f64 / evaluated.accuracy.test_rows as f64, runs: runs as f64 / count as f64 }
    }
}

fn over_time(evaluated: &Evaluated, column: usize, stated: f64, Binned { at, within, .. }: &Binned) -> Figure {
    let name = output(evaluated, column).0;
    let line = at.iter().zip(within).map(|(&t, &share)| [t, 100.0 * share]).collect();
    let expected = [at[0], at[at.len() - 1]].map(|t| [t, 100.0 * stated]).to_vec();
    let lowest = within.iter().copied().fold(1.0, f64::min);
    let chart = Chart {
        x: Axis::exact("time", "s", at[0], at[at.len() - 1]),
        y: Axis::exact(&format!("rows of {name} within"), "%", (100.0 * lowest - 2.0).clamp(0.0, 90.0), 101.0),
        series: vec![
            ChartSeries::named("within the bound", Ink::Blue, Shape::Line(line)),
            ChartSeries::named("expected", Ink::Vermilion, Shape::Line(expected)),
        ],
    };
    Figure::new(
        &format!("coverage-{name}"),
        format!("{name}: share of the test runs within the bound at each instant."),
        chart,
    )
}
