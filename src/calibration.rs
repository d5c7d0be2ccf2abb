//! How far a surrogate's outputs may be from the truth, measured on runs that it has never seen.

use crate::{dataset::Dataset, evaluation::predict};
use metafmu_runtime::{Bounds, Evaluator, Surrogate};
use rayon::prelude::*;

/// Split-conformal error bounds from `n` calibration runs: for each output the smallest `q` with
///
/// `1 / (n + 1) sum_k share of the rows of run k with |y - prediction| <= q  >=  coverage`,
///
/// as if the next run lay outside altogether. If the next run is exchangeable with these, that is drawn in the same way,
/// then the expected share of its rows within `q` is at least `coverage`, for any surrogate; the rows of a run need
/// not be independent. It says nothing about a particular run, nor about runs from other ranges.
///
/// Vovk, Gammerman, Shafer, *Algorithmic Learning in a Random World* (2005); Dunn, Wasserman, Ramdas, *Distribution-Free
/// Prediction Sets for Two-Layer Hierarchical Models* (2022), for runs with several rows each. None if there are fewer
/// than [`BoundsOptions::least_runs`](crate::study::BoundsOptions::least_runs).
pub fn bounds(surrogate: &Surrogate, calibration: &Dataset, coverage: f64) -> Option<Bounds> {
    let evaluator = Evaluator::new(surrogate);
    let width = surrogate.outputs().len();
    let errors: Vec<Vec<f64>> = calibration
        .runs
        .par_iter()
        .map(|run| {
            let predictions = predict(surrogate, &evaluator, run);
            run.outputs.iter().zip(predictions).map(|(label, prediction)| (label - prediction).abs()).collect()
        })
        .collect();
    let half_width = |column: usize| {
        let rows = errors.iter().flat_map(|errors| {
            let weight = width as f64 / errors.len() as f64;
            errors.iter().skip(column).step_by(width).map(move |&error| (error, weight))
        });
        let needed = coverage * (errors.len() + 1) as f64;
        quantile(rows.collect(), needed)
    };
    let half_widths = (0..width).into_par_iter().map(half_width).collect::<Option<Vec<f64>>>()?;
    Some(Bounds { coverage, runs: calibration.runs.len() as u64, half_widths })
}

/// Smallest value up to which the weights sum to what is needed; none if they never do.
fn quantile(mut rows: Vec<(f64, f64)>, needed: f64) -> Option<f64> {
    rows.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let sums = rows.iter().scan(0.0, |sum, &(value, weight)| {
        *sum += weight;
        Some((*sum, value))
    });
    // a run's weights sum to one up to rounding
    let mut reached = sums.filter(|&(sum, _)| sum >= needed - 1e-9 * needed);
    reached.next().map(|(_, value)| value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::Run, variable::Variable};
    use metafmu_runtime::example;
    use rand::{Rng, SeedableRng, rngs::ChaCha8Rng};

    /// Runs of the example whose labels are off by a noise that is the same in a whole run, but for its sign.
    fn runs(count: usize, seed: u64) -> Dataset {
        let surrogate = example::surrogate();
        let evaluator = Evaluator::new(&surrogate);
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move || (generator.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let variable = |name: &str| Variable::new(name, "", "");
        let runs = (0..count).map(|_| {
            let rows = 5 + (20.0 * uniform()) as usize;
            let times = (0..rows).map(|row| 0.01 * row as f64).collect();
            let mut run = Run {
                inputs: Vec::new(),
                parameters: vec![0.1 + 0.1 * uniform(), 5.0 * uniform()],
                times,
                outputs: Vec::new(),
            };
            let size = uniform();
            run.outputs = predict(&surrogate, &evaluator, &run);
            run.outputs.iter_mut().enumerate().for_each(|(i, y)| *y += if i % 3 == 0 { size } else { -2.0 * size });
            run
        });
        let runs = runs.collect();
        Dataset {
            inputs: Vec::new(),
            parameters: vec![variable("length"), variable("speed")],
            outputs: vec![variable("a"), variable("v")],
            runs,
        }
    }

    #[test]
    fn on_average_the_stated_share_of_a_fresh_runs_rows_lies_within() {
        let surrogate = example::surrogate();
        let evaluator = Evaluator::new(&surrogate);
        let fresh = runs(2000, 1);
        for (coverage, seed) in [(0.5, 2), (0.9, 3), (0.95, 4)] {
            // the mean over many calibrations: a single one is off by the luck of its runs
            let shares: Vec<f64> = (0..40)
                .map(|repeat| {
                    let bounds = bounds(&surrogate, &runs(60, seed + 100 * repeat), coverage).unwrap();
                    let within = fresh.runs.iter().map(|run| {
                        let predictions = predict(&surrogate, &evaluator, run);
                        let errors = run.outputs.iter().zip(predictions).step_by(2).map(|(y, p)| (y - p).abs());
                        let rows = run.times.len() as f64;
                        errors.filter(|&error| error <= bounds.half_widths[0]).count() as f64 / rows
                    });
                    within.sum::<f64>() / fresh.runs.len() as f64
                })
                .collect();
            let mean = shares.iter().sum::<f64>() / shares.len() as f64;
            assert!(mean > coverage - 0.005 && mean < coverage + 0.03, "{mean} for {coverage}");
        }
    }

    #[test]
    fn too_few_runs_give_no_bounds() {
        let surrogate = example::surrogate();
        assert_eq!(crate::study::BoundsOptions::least_runs(0.95), 19);
        assert!(bounds(&surrogate, &runs(18, 1), 0.95).is_none());
        let largest = bounds(&surrogate, &runs(19, 1), 0.95).unwrap();
        assert!(largest.half_widths.iter().all(|&width| width > 1.0), "{largest:?}");
    }

    #[test]
    fn the_quantile_is_the_smallest_value_with_enough_weight() {
        let rows = || vec![(3.0, 0.5), (1.0, 1.0), (2.0, 0.5)];
        for (needed, expected) in [(0.2, Some(1.0)), (1.0, Some(1.0)), (1.2, Some(2.0)), (2.0, Some(3.0)), (2.1, None)]
        {
            assert_eq!(quantile(rows(), needed), expected);
        }
    }
}
