//! The rows of a study that baselines are fitted to.

use crate::StandardizedRows;
use metafmu_core::{
    dataset::{Dataset, Run},
    layout::RowLayout,
    sampling::{self, Stream},
    scaling,
};
use std::borrow::Cow;

/// All rows of the runs, parameters encoded as for the network, standardized.
pub fn rows(dataset: &Dataset, layout: &RowLayout, runs: &[&Run]) -> StandardizedRows {
    let scaling = scaling::fit(dataset, layout, runs.iter().copied());
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for run in runs {
        layout.for_each(run, |columns, outputs| {
            x.extend_from_slice(columns);
            y.extend_from_slice(outputs);
        });
    }
    StandardizedRows::new(x, y, scaling)
}

/// At most `most` of the rows, chosen at random; a smaller choice is the beginning of a larger one.
pub fn choose_rows(rows: &StandardizedRows, most: Option<usize>, seed: u64) -> Cow<'_, StandardizedRows> {
    match most {
        Some(most) if most < rows.len() => {
            let order = sampling::permutation(rows.len(), sampling::random(seed, Stream::Baselines));
            Cow::Owned(rows.choose(&order[..most]))
        }
        _ => Cow::Borrowed(rows),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Encoder, Encoding};
    use metafmu_tables::variable::SourceVariable;

    #[test]
    fn rows_are_standardized_and_fewer_are_the_first_of_more() {
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let run = |p: f64| Run {
            inputs: Vec::new(),
            parameters: vec![p],
            times: [0.0, 1.0].into(),
            outputs: vec![p, 2.0 * p],
        };
        let runs: Vec<Run> = (0..50).map(|i| run(f64::from(i))).collect();
        let dataset =
            Dataset { inputs: Vec::new(), parameters: vec![variable("p")], outputs: vec![variable("y")], runs };
        let encoder = Encoder::new([(&Encoding::Plain, 0.0, 49.0)].into_iter());
        let rows = rows(&dataset, &RowLayout::new(encoder), &dataset.runs.iter().collect::<Vec<_>>());
        assert_eq!((rows.len(), rows.inputs, rows.outputs), (100, 2, 1));
        assert!(rows.x.iter().step_by(2).sum::<f64>().abs() < 1e-12 && rows.y.iter().sum::<f64>().abs() < 1e-12);
        let (more, fewer) = (choose_rows(&rows, Some(20), 1), choose_rows(&rows, Some(5), 1));
        assert_eq!(fewer.x, more.x[..10]);
        assert_ne!(choose_rows(&rows, Some(5), 2).x, fewer.x);
        assert_eq!(*choose_rows(&rows, Some(100), 1), rows);
    }
}
