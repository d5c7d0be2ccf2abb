//! The network beside simpler models: accuracy against cost.

use super::{
    Axis, Chart, ChartSeries, Figure, Ink, ReportBlock, Section, Shape, code, escape, number, paragraph, r2, table,
};
use crate::{
    diagnostics::numbers::counted,
    evaluation::comparison::{Comparison, ModelRow, ModelStatus},
};

/// `is_of_rows`: whether the models are the candidates of a static map.
pub fn section(comparison: &Comparison, is_of_rows: bool) -> Section {
    let Comparison { test_runs, test_rows, models, .. } = comparison;
    let what = match is_of_rows {
        true => format!("Kinds of model, compared on {test_rows} rows that they were not fitted to."),
        false => format!(
            "Simpler models, fitted to training rows of the same study and measured on the same {}, {}.",
            counted(*test_runs, "test run"),
            counted(*test_rows, "row")
        ),
    };
    let mut blocks = vec![paragraph(&format!(
        "{what} In the plots a model has its number from the table; lower and further left is better. 1 - R² is that of the output that \
         a model predicts worst."
    ))];
    blocks.push(overview(models));
    let figures = [
        (
            "predict",
            "prediction of a point, one core",
            "µs",
            1e6,
            (|row| row.predict_seconds_per_point) as fn(&ModelRow) -> Option<f64>,
        ),
        ("fit", "processor time to fit", "s", 1.0, |row| row.fit_seconds),
        ("memory", "memory of the fitted model", "kB", 1e-3, |row| row.memory_bytes.map(|bytes| bytes as f64)),
    ];
    let figures = figures.into_iter().filter_map(|(id, name, unit, scale, cost)| {
        let chart = scatter(models, name, unit, |row| cost(row).map(|cost| scale * cost))?;
        Some(Figure::new(&format!("models-{id}"), format!("Accuracy against {name}."), chart))
    });
    blocks.push(ReportBlock::Figures(figures.collect()));
    blocks.extend(scores(models));
    let title = if is_of_rows { "Kinds of model" } else { "Beside simpler models" };
    Section { id: "comparison", title: title.into(), blocks }
}

fn overview(models: &[ModelRow]) -> ReportBlock {
    let headings = ["model", "1 - R²", "prediction", "fit, CPU", "memory", "rows", "FMU", "note"];
    let rows = models.iter().enumerate().map(|(index, row)| {
        let ModelRow {
            model,
            status,
            note,
            rows,
            fit_seconds,
            predict_seconds_per_point,
            memory_bytes,
            exportable,
            ..
        } = row;
        let status = match status {
            ModelStatus::Fine => "",
            ModelStatus::Failed => "failed",
            ModelStatus::TooSlow => "too slow",
            ModelStatus::Stopped => "stopped",
        };
        let separator = if status.is_empty() || note.is_empty() { "" } else { ": " };
        vec![
            format!("<span class=\"whole\">{}. {}</span>", index + 1, code(model)),
            or_dash(misfit(row).map(number)),
            or_dash(predict_seconds_per_point.map(|seconds| format!("{}\u{a0}µs", number(1e6 * seconds)))),
            or_dash(fit_seconds.map(|seconds| format!("{}\u{a0}s", number(seconds)))),
            or_dash(memory_bytes.map(|bytes| format!("{}\u{a0}kB", number(bytes as f64 / 1e3)))),
            rows.to_string(),
            if *exportable { "yes" } else { "no" }.into(),
            format!("{status}{separator}{}", escape(note)),
        ]
    });
    table(&headings, rows)
}

fn or_dash(value: Option<String>) -> String {
    value.unwrap_or("-".into())
}

/// R² of each output.
fn scores(models: &[ModelRow]) -> Option<ReportBlock> {
    let outputs: Vec<&String> = models.iter().find(|row| !row.outputs.is_empty())?.outputs.keys().collect();
    let headings: Vec<String> =
        std::iter::once("R² of".into()).chain(outputs.iter().map(|output| escape(output))).collect();
    let measured = models.iter().filter(|row| !row.outputs.is_empty());
    let rows = measured.map(|row| {
        std::iter::once(code(&row.model))
            .chain(outputs.iter().map(|output| row.outputs.get(*output).map_or("-".into(), |accuracy| r2(accuracy.r2))))
            .collect()
    });
    let headings: Vec<&str> = headings.iter().map(String::as_str).collect();
    Some(table(&headings, rows))
}

/// Largest `1 - R²` of all outputs; none if there is none.
fn misfit(row: &ModelRow) -> Option<f64> {
    row.outputs.values().filter_map(|accuracy| accuracy.r2).map(|r2| 1.0 - r2).max_by(f64::total_cmp)
}

fn scatter(models: &[ModelRow], name: &str, unit: &str, cost: impl Fn(&ModelRow) -> Option<f64>) -> Option<Chart> {
    let places = models.iter().enumerate();
    let places: Vec<(usize, [f64; 2])> =
        places.filter_map(|(index, row)| Some((index + 1, [cost(row)?, misfit(row)?]))).collect();
    if places.is_empty() {
        return None;
    }
    // models are numbers on plates, which need room
    let [around_x, around_y] =
        [0, 1].map(|axis| places.iter().flat_map(move |(_, place)| [0.5 * place[axis], 2.0 * place[axis]]));
    let (x, y) = (Axis::log(name, unit, around_x), Axis::log("1 - R²", "", around_y));
    Some(Chart { x, y, series: vec![ChartSeries::silent(Ink::Blue, Shape::Numbered(places))] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::comparison::ModelAccuracy;

    #[test]
    fn every_model_has_a_row_and_those_with_figures_a_number_in_the_plots() {
        let row = |model: &str, status, r2: Option<f64>| ModelRow {
            model: model.into(),
            status,
            note: if r2.is_some() { String::new() } else { "a <reason>".into() },
            rows: 100,
            fit_seconds: r2.map(|_| 2.0),
            predict_seconds_per_point: r2.map(|_| 1e-6),
            memory_bytes: None,
            exportable: false,
            outputs: r2
                .into_iter()
                .map(|r2| ("theta".into(), ModelAccuracy { r2: Some(r2), mse: 1.0, max_abs_error: 2.0 }))
                .collect(),
        };
        let models = vec![
            row("network", ModelStatus::Fine, Some(0.999)),
            row("ridge", ModelStatus::Fine, Some(-0.5)),
            row("svr", ModelStatus::TooSlow, None),
        ];
        let section = section(
            &Comparison { name: "s".into(), content_digest: None, test_runs: 2, test_rows: 100, models },
            false,
        );
        let html: String = section
            .blocks
            .iter()
            .map(|block| match block {
                ReportBlock::Html(html) => html.clone(),
                ReportBlock::Figures(figures) => figures.iter().map(|figure| figure.draw().unwrap().svg).collect(),
            })
            .collect();
        for piece in [
            "1. <code>network</code>",
            "3. <code>svr</code>",
            "too slow: a &lt;reason&gt;",
            ">0.001<",
            "0.9990",
            "-0.5000",
        ] {
            assert!(html.contains(piece), "{piece} is not in {html}");
        }
        let plates = |number: usize| html.matches(&format!("fill=\"#FFFFFF\">\n{number}\n</text>")).count();
        assert_eq!([1, 2, 3].map(plates), [2, 2, 0], "in both plots, and the one without figures in none");
    }
}
