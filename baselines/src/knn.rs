//! k nearest neighbors.

use crate::{Baseline, BaselineError, Fitted, LibraryModel, StandardizedRows};
use metafmu_core::study::baselines::Knn;
use smartcore::{
    algorithm::neighbour::cover_tree::CoverTree,
    metrics::distance::{Distances, euclidian::Euclidian},
};

impl Baseline for Knn {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let (inputs, outputs, neighbors) = (rows.inputs, rows.outputs, self.neighbors);
        let points = rows.x.chunks(inputs).map(<[f64]>::to_vec).collect();
        // smartcore's regressor would search once for each output
        let tree = CoverTree::new(points, Distances::euclidian()).map_err(BaselineError::library)?;
        let memory_bytes = (size_of_val(rows.x.as_slice()) + size_of_val(rows.y.as_slice())) as u64;
        let y = rows.y.clone();
        Ok(Fitted::Library(LibraryModel {
            predict: Box::new(move |x: &[f64]| {
                let rows = x.chunks(inputs).map(|point| mean(&tree, point, neighbors, &y, outputs));
                rows.collect::<Result<Vec<Vec<f64>>, BaselineError>>().map(|rows| rows.concat())
            }),
            memory_bytes,
            not_exportable: "an FMU of it would carry every training row and search them in each step",
        }))
    }
}

/// Mean outputs of the nearest rows, weighted by the inverse of their distance; of rows at the very point only those count.
fn mean(
    tree: &CoverTree<Vec<f64>, Euclidian<f64>>,
    point: &[f64],
    neighbors: usize,
    y: &[f64],
    outputs: usize,
) -> Result<Vec<f64>, BaselineError> {
    let nearest = tree.find(&point.to_vec(), neighbors).map_err(BaselineError::library)?;
    let at_the_point = nearest.iter().any(|(_, distance, _)| *distance == 0.0);
    let (mut sum, mut weights) = (vec![0.0; outputs], 0.0);
    for (row, distance, _) in nearest {
        let weight = if at_the_point { f64::from(u8::from(distance == 0.0)) } else { 1.0 / distance };
        weights += weight;
        sum.iter_mut().zip(&y[row * outputs..]).for_each(|(sum, y)| *sum += weight * y);
    }
    sum.iter_mut().for_each(|sum| *sum /= weights);
    Ok(sum)
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
