//! Next points of a design: those that reduce the variance of a Gaussian process the most.
//!
//! ```text
//! gain(c) = sum over outputs s^2 sum over places p of cov(p, c)^2 / (cov(c, c) + noise^2)
//! ```
//!
//! is the decrease of the predicted variances at all places by a row at the place `c`, whatever its outputs are (active learning by Cohn (1996); Seo and
//! others (2000)). Points are chosen one after the other, each with the covariances that the ones before it leave.

use super::{OutputRows, Process, parameters};
use crate::{StandardizedRows, for_each_output};
use metafmu_core::study::baselines::GaussianProcess;
use nalgebra::{DMatrix, DVector};
use std::cmp::Ordering;

/// Places of a design, in standardized inputs.
pub struct DesignPlaces {
    /// Shape `[places, inputs]`: candidates, the planned ones first.
    pub x: Vec<f64>,
    /// Number of places that were planned before and have no outputs yet.
    pub planned: usize,
}

/// Covariances between places, given the rows, of one output.
struct PlaceCovariances {
    /// Relative to the variance of the process.
    matrix: DMatrix<f64>,
    noise: f64,
    variance: f64,
}

impl PlaceCovariances {
    /// None if the output is constant or the covariance of the rows is singular.
    fn of(model: &GaussianProcess, rows: &StandardizedRows, output: usize, x: &[f64]) -> Option<Self> {
        let parameters = parameters(model, rows, output)?;
        let all = OutputRows::of(rows, output, rows.len());
        let process = Process::new(&all, &parameters)?;
        let (noise, lengths) = parameters.split_last()?;
        let inputs = rows.inputs;
        let inverse: Vec<f64> = lengths.iter().map(|length| (-length).exp()).collect();
        let places: Vec<&[f64]> = x.chunks_exact(inputs).collect();
        let count = places.len();
        let mut beside = DMatrix::from_fn(all.len(), count, |row, place| kernel(all.row(row), places[place], &inverse));
        if !process.covariance.l_dirty().solve_lower_triangular_mut(&mut beside) {
            return None;
        }
        let mut matrix = DMatrix::from_fn(count, count, |a, b| kernel(places[a], places[b], &inverse));
        matrix.gemm_tr(-1.0, &beside, &beside, 1.0);
        Some(Self { matrix, noise: noise.exp(), variance: process.variance })
    }

    fn gain(&self, place: usize) -> f64 {
        let own = self.matrix[(place, place)].max(0.0) + self.noise;
        self.variance * self.matrix.column(place).norm_squared() / own
    }

    /// Covariances given a further row.
    fn condition(&mut self, place: usize) {
        let column: DVector<f64> = self.matrix.column(place).into_owned();
        let own = column[place].max(0.0) + self.noise;
        self.matrix.ger(-1.0 / own, &column, &column, 1.0);
    }
}

/// Gaussian kernel between two points, by the inverse of the length of each input.
fn kernel(a: &[f64], b: &[f64], inverse: &[f64]) -> f64 {
    let differences = a.iter().zip(b).zip(inverse).map(|((a, b), inverse)| (a - b) * inverse);
    (-0.5 * differences.map(|difference| difference * difference).sum::<f64>()).exp()
}

fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// A place that may be chosen next.
struct OpenPlace {
    index: usize,
    gain: f64,
    /// Square of the distance from the nearest row or chosen place.
    distance: f64,
}

impl OpenPlace {
    /// Order of preference, the best one last.
    fn compare(&self, other: &Self) -> Ordering {
        let by_gain = self.gain.total_cmp(&other.gain);
        by_gain.then(self.distance.total_cmp(&other.distance)).then(other.index.cmp(&self.index))
    }
}

/// Numbers of `count` places, none of them planned, in the order in which they reduce the variance. Of places with equal gains the farthest from all
/// rows is taken: without a process, which constant outputs and too few rows have not, points are only spread.
pub fn design_points(
    model: &GaussianProcess,
    rows: &StandardizedRows,
    places: &DesignPlaces,
    count: usize,
) -> Vec<usize> {
    let DesignPlaces { x, planned } = places;
    let inputs = rows.inputs;
    let places: Vec<&[f64]> = x.chunks_exact(inputs).collect();
    let by_output = match rows.len() {
        0 | 1 => Vec::new(),
        _ => for_each_output(rows, |output| Ok(PlaceCovariances::of(model, rows, output, x))).unwrap_or_default(),
    };
    let mut covariances: Vec<PlaceCovariances> = by_output.into_iter().flatten().collect();
    let distances = places.iter().map(|place| {
        let rows = rows.x.chunks_exact(inputs);
        rows.fold(f64::INFINITY, |near, row| near.min(squared_distance(row, place)))
    });
    let mut distances: Vec<f64> = distances.collect();
    let mut chosen = Vec::with_capacity(count);
    for step in 0..planned + count {
        let next = if step < *planned {
            Some(step)
        } else {
            let open = (*planned..distances.len()).filter(|index| distances[*index] > 0.0).map(|index| {
                let gain = covariances.iter().map(|of| of.gain(index)).sum();
                OpenPlace { index, gain, distance: distances[index] }
            });
            open.filter(|place| place.gain.is_finite()).max_by(OpenPlace::compare).map(|place| place.index)
        };
        let Some(next) = next else { break };
        covariances.iter_mut().for_each(|of| of.condition(next));
        for (index, near) in distances.iter_mut().enumerate() {
            *near = near.min(squared_distance(places[next], places[index]));
        }
        if step >= *planned {
            chosen.push(next);
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::Scaling;

    /// Rows of one input from 0 to 1 without a gap but one around 0.6.
    fn gapped() -> StandardizedRows {
        let x: Vec<f64> = [0.0, 0.1, 0.2, 0.3, 0.4, 0.8, 0.9, 1.0].to_vec();
        let y = x.iter().map(|x| (6.0 * x).sin()).collect();
        let one = || vec![1.0];
        let scaling =
            Scaling { input_mean: vec![0.0], input_scale: one(), output_mean: vec![0.0], output_scale: one() };
        StandardizedRows::new(x, y, scaling)
    }

    fn places() -> Vec<f64> {
        (0..=100).map(|place| f64::from(place) / 100.0).collect()
    }

    #[test]
    fn the_first_point_fills_the_gap_and_points_are_neither_repeated_nor_those_of_rows() {
        let rows = gapped();
        let chosen = design_points(&GaussianProcess::default(), &rows, &DesignPlaces { x: places(), planned: 0 }, 6);
        assert!((50..=70).contains(&chosen[0]), "{chosen:?}");
        let mut sorted = chosen.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert!(sorted.len() == 6 && chosen.iter().all(|place| !rows.x.contains(&places()[*place])), "{chosen:?}");
    }

    #[test]
    fn places_that_are_planned_are_filled_already() {
        let x = [&[0.6][..], &places()].concat();
        let chosen =
            design_points(&GaussianProcess::default(), &gapped(), &DesignPlaces { x: x.clone(), planned: 1 }, 1);
        assert!((x[chosen[0]] - 0.6).abs() > 0.04, "{}", x[chosen[0]]);
    }

    #[test]
    fn without_a_process_points_are_far_from_each_other() {
        let mut rows = gapped();
        rows.y.iter_mut().for_each(|value| *value = 0.0);
        let places = DesignPlaces { x: places(), planned: 0 };
        assert_eq!(design_points(&GaussianProcess::default(), &rows.choose(&[0]), &places, 2), [100, 50]);
    }

    #[test]
    fn gains_are_the_decrease_of_the_variances_by_a_further_row() {
        let (rows, x) = (gapped(), places());
        let before = PlaceCovariances::of(&GaussianProcess::default(), &rows, 0, &x).unwrap();
        let gain = before.gain(60);
        let mut after = PlaceCovariances::of(&GaussianProcess::default(), &rows, 0, &x).unwrap();
        after.condition(60);
        let decrease = before.variance * (before.matrix.trace() - after.matrix.trace());
        assert!((gain - decrease).abs() < 1e-9 * gain, "{gain} {decrease}");
    }
}
