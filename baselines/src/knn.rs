//! k nearest neighbours.

use crate::{Baseline, Fitted, LibraryModel, Rows, at_least, for_each_output, svr::matrix};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use smartcore::{
    metrics::distance::Distances,
    neighbors::{
        KNNWeightFunction,
        knn_regressor::{KNNRegressor, KNNRegressorParameters},
    },
};

/// `[baselines.knn]`: the mean of the nearest training rows, weighted by the inverse of their distance in standardised
/// inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Knn {
    /// How many.
    pub neighbours: usize,
    /// At most so many rows.
    pub rows: usize,
}

impl Default for Knn {
    fn default() -> Self {
        Self { neighbours: 5, rows: 100_000 }
    }
}

impl Baseline for Knn {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &Rows, _: u64) -> Result<Fitted, String> {
        let inputs = rows.inputs;
        let x = matrix(rows.len(), inputs, rows.x.clone())?;
        let fitted = for_each_output(rows, |output| {
            let parameters = KNNRegressorParameters::default()
                .with_k(self.neighbours)
                .with_distance(Distances::euclidian())
                .with_weight(KNNWeightFunction::Distance);
            KNNRegressor::fit(&x, &rows.output(output), parameters).map_err(|error| error.to_string())
        })?;
        let predict = move |x: &[f64]| {
            let x = matrix(x.len() / inputs, inputs, x.to_vec())?;
            let one = |regressor: &KNNRegressor<f64, f64, _, Vec<f64>, _>| regressor.predict(&x);
            let outputs: Result<Vec<Vec<f64>>, _> = fitted.iter().map(one).collect();
            Ok(interleave(&outputs.map_err(|error| error.to_string())?))
        };
        Ok(Fitted::Library(LibraryModel {
            predict: Box::new(predict),
            // each output's regressor keeps the rows
            memory_bytes: (rows.outputs * rows.len() * (inputs + 1) * size_of::<f64>()) as u64,
            not_exportable: "an FMU of it would carry every training row and search them in each step",
        }))
    }

    fn problems(&self) -> Vec<(&'static str, String)> {
        let neighbours = at_least("neighbours", self.neighbours, 1);
        neighbours.into_iter().chain(at_least("rows", self.rows, self.neighbours.max(2))).collect()
    }
}

/// Columns as rows.
pub(super) fn interleave(columns: &[Vec<f64>]) -> Vec<f64> {
    let rows = columns.first().map_or(0, Vec::len);
    (0..rows).into_par_iter().flat_map_iter(|row| columns.iter().map(move |column| column[row])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::wavy_rows;

    #[test]
    fn it_is_the_weighted_mean_of_the_rows_that_a_search_through_all_finds() {
        let rows = wavy_rows(300);
        let Fitted::Library(model) = Knn::default().fit(&rows, 1).unwrap() else { panic!("no library's model") };
        let point = [0.1, -0.2, 0.3];
        let predicted = (model.predict)(&point).unwrap();
        let distance = |z: &[f64]| z.iter().zip(&point).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let mut order: Vec<(f64, usize)> = rows.x.chunks(3).enumerate().map(|(row, z)| (distance(z), row)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (output, predicted) in predicted.iter().enumerate() {
            let nearest = order.iter().take(5).map(|&(distance, row)| (1.0 / distance, rows.y[row * 2 + output]));
            let (sum, weights) = nearest.fold((0.0, 0.0), |(sum, all), (weight, y)| (sum + weight * y, all + weight));
            assert!((predicted - sum / weights).abs() < 1e-12);
        }
    }
}
