//! How far a surrogate's outputs may be from the truth, measured on runs that it has never seen.

use crate::{
    dataset::{Dataset, Run},
    diagnostics::numbers::counted,
    evaluation::{KindCoverage, SignalKind, first_predicted, predict},
    study::BoundsOptions,
};
use metafmu_runtime::{Bounds, Evaluator, Output, Surrogate};
use rayon::prelude::*;
use std::fmt;

/// Reason why calibration data bound no error: they are too few, or too many of their predictions are not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CalibrationError {
    /// Runs do not bound the errors of a surrogate.
    Runs {
        /// Number of runs.
        count: usize,
        /// Share of the rows to bound.
        coverage: f64,
    },
    /// Unseen rows do not bound the errors of a static map.
    Rows {
        /// Number of rows.
        count: usize,
        /// Share of the rows to bound.
        coverage: f64,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Runs { count, coverage } => {
                let verb = if *count == 1 { "does" } else { "do" };
                let runs = counted(*count, "run");
                write!(
                    f,
                    "{runs} {verb} not bound {coverage} of the rows: too few of their predictions can be computed"
                )
            }
            Self::Rows { count, coverage } => write!(
                f,
                "{count} unseen rows do not bound {coverage} of the rows: too few of their predictions are finite"
            ),
        }
    }
}

impl std::error::Error for CalibrationError {}

/// Split-conformal error bounds from `n` calibration runs: for each output the smallest `q` with
///
/// `1 / (n + 1) sum_k share of the rows of run k with |y - prediction| <= q  >=  coverage`,
///
/// as if the next run had infinite error. If the next run is exchangeable with these runs (drawn in the same way), the
/// expected share of its rows within `q` is at least `coverage`, for any surrogate. The rows of a run need not be
/// independent. The bound does not cover a particular run, nor runs from other ranges.
///
/// The errors of a surrogate that advances from its own state grow with the time since the start. Each of twenty
/// intervals therefore has its own `q` for its rows. The bound is the smallest nondecreasing function of time that is
/// nowhere below these values and is linear between the ends of the intervals.
///
/// Vovk, Gammerman, Shafer, *Algorithmic Learning in a Random World* (2005); Dunn, Wasserman, Ramdas, *Distribution-Free
/// Prediction Sets for Two-Layer Hierarchical Models* (2022), for runs with several rows each.
///
/// With `by_kind`, runs driven by different [kinds of signals](SignalKind) each have a `q`, and the bound is the largest of them. Kinds other
/// than the study's signals may drive a motion out of the ranges in which it was learned: their rows count up to there. If few of them are
/// left, the largest error takes the place of the quantile.
///
/// # Errors
/// [`CalibrationError::Runs`] if there are fewer than [`BoundsOptions::least_runs`](crate::study::BoundsOptions::least_runs),
/// or if too many predictions are not finite.
pub fn bounds(
    surrogate: &Surrogate,
    calibration: &Dataset,
    coverage: f64,
    by_kind: bool,
) -> Result<Bounds, CalibrationError> {
    let ends = if surrogate.program().has_memory() { ends(calibration) } else { vec![f64::INFINITY] };
    let width = surrogate.outputs().len();
    let mut half_widths = vec![0.0f64; ends.len() * width];
    for (kind, errors) in errors(surrogate, calibration, &ends, by_kind) {
        let of_kind: Vec<f64> = (0..half_widths.len())
            .into_par_iter()
            .map(|index| half_width(&errors[index / width], index % width, width, (coverage, kind)))
            .collect();
        half_widths.iter_mut().zip(of_kind).for_each(|(largest, of_kind)| *largest = largest.max(of_kind));
    }
    if half_widths.iter().any(|half_width| !half_width.is_finite()) {
        return Err(CalibrationError::Runs { count: calibration.runs.len(), coverage });
    }
    let runs = calibration.runs.len() as u64;
    let (times, half_widths) = match surrogate.program().has_memory() {
        true => growing(&ends, half_widths, width),
        false => (Vec::new(), half_widths),
    };
    Ok(Bounds { coverage, runs, times, half_widths })
}

/// Error bounds of a static map, from the errors of each output in unseen rows: as [`bounds`] of runs of a single row.
///
/// # Errors
/// [`CalibrationError::Rows`] if there are too few rows, or too many of their predictions are not finite.
pub fn bounds_of_rows(errors: &[Vec<f64>], coverage: f64) -> Result<Bounds, CalibrationError> {
    let (rows, width) = (errors.len(), errors.first().map_or(0, Vec::len));
    let of_output = |output| half_width(errors, output, width, (coverage, SignalKind::Signals));
    let half_widths: Vec<f64> = (0..width).map(of_output).collect();
    if half_widths.iter().any(|half_width| !half_width.is_finite()) {
        return Err(CalibrationError::Rows { count: rows, coverage });
    }
    Ok(Bounds { coverage, runs: rows as u64, times: Vec::new(), half_widths })
}

/// Share of the rows of each kind of signal that are within a surrogate's bounds; empty if there is one kind only.
pub fn coverage(surrogate: &Surrogate, calibration: &Dataset) -> Vec<KindCoverage> {
    let Some(bounds) = surrogate.bounds() else { return Vec::new() };
    let evaluator = Evaluator::new(surrogate);
    let width = surrogate.outputs().len();
    let of_run = |run: &Run| {
        let kind = SignalKind::of(surrogate, run);
        let mut within = vec![0.0; width];
        let errors = run_errors(surrogate, &evaluator, run, kind);
        for (time, errors) in &errors {
            for (output, error) in errors.iter().enumerate() {
                within[output] += f64::from(u8::from(*error <= bounds.at(output, *time)));
            }
        }
        (kind, errors.len() as f64, within)
    };
    let runs: Vec<(SignalKind, f64, Vec<f64>)> = calibration.runs.par_iter().map(of_run).collect();
    let of_kind = |kind: SignalKind| {
        let runs: Vec<_> = runs.iter().filter(|(found, ..)| *found == kind).collect();
        let rows: f64 = runs.iter().map(|(_, rows, _)| rows).sum();
        let share = |output: usize| runs.iter().map(|(.., within)| within[output]).sum::<f64>() / rows;
        let names = surrogate.outputs().iter().map(|output| output.name.clone());
        let within = names.enumerate().map(|(output, name)| (name, share(output))).collect();
        (rows > 0.0).then_some(KindCoverage { kind, runs: runs.len(), within })
    };
    let found: Vec<KindCoverage> = SignalKind::ALL.into_iter().filter_map(of_kind).collect();
    if found.len() > 1 { found } else { Vec::new() }
}

/// Intervals of the time since the start.
const INTERVALS: usize = 20;

/// Ends of the intervals, whose numbers of time points differ by at most one.
fn ends(calibration: &Dataset) -> Vec<f64> {
    let mut times: Vec<f64> = calibration.runs.iter().flat_map(|run| run.times.iter().copied()).collect();
    times.retain(|time| *time > 0.0);
    times.sort_unstable_by(f64::total_cmp);
    times.dedup();
    let count = INTERVALS.min(times.len());
    (1..=count).map(|interval| times[interval * times.len() / count - 1]).collect()
}

/// Errors of the rows of each run, in each interval: shape `[intervals][runs][rows, outputs]`.
type Errors = Vec<Vec<Vec<f64>>>;

/// The errors of the runs of each kind of signal; without `by_kind` all are of one.
fn errors(surrogate: &Surrogate, calibration: &Dataset, ends: &[f64], by_kind: bool) -> Vec<(SignalKind, Errors)> {
    let evaluator = Evaluator::new(surrogate);
    let of_run = |run: &Run| {
        let kind = if by_kind { SignalKind::of(surrogate, run) } else { SignalKind::Signals };
        let mut errors = vec![Vec::new(); ends.len()];
        for (time, row) in run_errors(surrogate, &evaluator, run, kind) {
            // times are those of the rows, so that the last one is an end
            let interval = ends.partition_point(|end| *end < time).min(ends.len() - 1);
            errors[interval].extend(row);
        }
        (kind, errors)
    };
    let by_run: Vec<(SignalKind, Vec<Vec<f64>>)> = calibration.runs.par_iter().map(of_run).collect();
    let of_kind = |kind: SignalKind| {
        let mut by_interval = vec![Vec::new(); ends.len()];
        for (_, run) in by_run.iter().filter(|(found, _)| *found == kind) {
            by_interval.iter_mut().zip(run).for_each(|(runs, errors)| runs.push(errors.clone()));
        }
        (kind, by_interval)
    };
    let kinds = SignalKind::ALL.into_iter();
    kinds
        .filter(|kind| *kind == SignalKind::Signals || by_run.iter().any(|(found, _)| found == kind))
        .map(of_kind)
        .collect()
}

/// Times and errors of the predicted rows of a run that count: those of other signals than the study's up to where an output
/// leaves its range in training.
fn run_errors(surrogate: &Surrogate, evaluator: &Evaluator, run: &Run, kind: SignalKind) -> Vec<(f64, Vec<f64>)> {
    let width = surrogate.outputs().len();
    let predictions = predict(surrogate, evaluator, run);
    let is_inside = |(value, output): (&f64, &Output)| {
        let margin = 0.01 * (output.max - output.min) + 1e-9 * output.min.abs().max(output.max.abs());
        (output.min - margin..=output.max + margin).contains(value)
    };
    let rows = run.outputs.chunks(width).zip(predictions.chunks(width));
    let rows = run.times.iter().zip(rows).skip(first_predicted(surrogate, run));
    rows.take_while(|(_, (labels, _))| {
        kind == SignalKind::Signals || labels.iter().zip(surrogate.outputs()).all(is_inside)
    })
    .map(|(time, (labels, found))| {
        (*time, labels.iter().zip(found).map(|(label, found)| (label - found).abs()).collect())
    })
    .collect()
}

/// The bound of an output, from the errors of each run of a kind; infinite if there is none, zero of a further kind without rows.
fn half_width(runs: &[Vec<f64>], column: usize, width: usize, (coverage, kind): (f64, SignalKind)) -> f64 {
    let runs = || runs.iter().filter(|errors| !errors.is_empty());
    let rows = runs().flat_map(|errors| {
        let weight = width as f64 / errors.len() as f64;
        // what is not a number is as wrong as can be
        let finite = |error: f64| if error.is_nan() { f64::INFINITY } else { error };
        errors.iter().skip(column).step_by(width).map(move |&error| (finite(error), weight))
    });
    let (rows, count) = (rows.collect::<Vec<(f64, f64)>>(), runs().count());
    let largest = || rows.iter().map(|(error, _)| *error).fold(0.0, f64::max);
    match kind {
        SignalKind::Signals => quantile(rows, coverage * (count + 1) as f64).unwrap_or(f64::INFINITY),
        _ if count < BoundsOptions::least_runs(coverage) => largest(),
        _ => quantile(rows, coverage * (count + 1) as f64).unwrap_or(f64::INFINITY),
    }
}

/// Times and bounds, from the bound of each interval.
fn growing(ends: &[f64], mut half_widths: Vec<f64>, width: usize) -> (Vec<f64>, Vec<f64>) {
    for index in width..half_widths.len() {
        half_widths[index] = half_widths[index].max(half_widths[index - width]);
    }
    // at its begin each interval has its bound, the last one at its end, too
    half_widths.extend_from_within(half_widths.len() - width..);
    ([0.0].iter().chain(ends).copied().collect(), half_widths)
}

/// Smallest value up to which the weights sum to `needed`; none if they never do.
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
    use crate::variable::SourceVariable;
    use metafmu_example as example;
    use rand::{Rng, SeedableRng, rngs::ChaCha8Rng};

    /// Runs of the example whose labels are off by a noise that is the same in a whole run, but for its sign.
    fn runs(count: usize, seed: u64) -> Dataset {
        let surrogate = example::surrogate();
        let evaluator = Evaluator::new(&surrogate);
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move || (generator.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let variable = |name: &str| SourceVariable::new(name, "", "");
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
                    let bounds = bounds(&surrogate, &runs(60, seed + 100 * repeat), coverage, false).unwrap();
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
    fn bounds_of_roll_outs_grow_with_the_time() {
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let mut generator = ChaCha8Rng::seed_from_u64(1);
        let mut uniform = move || (generator.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let mut runs = |count: usize| -> Vec<Run> {
            let run = |_| {
                let times: std::sync::Arc<[f64]> = (0..=100).map(|row| 0.02 * f64::from(row)).collect();
                let mut run = Run {
                    inputs: vec![0.0; times.len()],
                    parameters: vec![1.5, 0.0, 0.4 * uniform(), 0.0, 0.0],
                    times,
                    outputs: Vec::new(),
                };
                run.outputs = predict(&surrogate, &evaluator, &run);
                // an error that grows with the time, of another size in each run
                let size = uniform();
                let width = surrogate.outputs().len();
                for (row, outputs) in run.outputs.chunks_mut(width).enumerate() {
                    outputs[0] += 1e-3 * size * row as f64;
                }
                run
            };
            (0..count).map(run).collect()
        };
        let calibration = Dataset {
            inputs: vec![variable("force")],
            parameters: (0..5).map(|index| variable(&format!("p{index}"))).collect(),
            outputs: surrogate.outputs().iter().map(|output| variable(&output.name)).collect(),
            runs: runs(100),
        };
        let bounds = bounds(&surrogate, &calibration, 0.9, false).unwrap();
        assert_eq!((bounds.times.len(), bounds.times[0], bounds.times[20]), (21, 0.0, 2.0));
        // 90 % of the sizes are below 0.9: at the end of an interval of five rows it is that of its last row
        assert!((bounds.at(0, 2.0) - 0.09).abs() < 0.012, "{bounds:?}");
        assert!((bounds.at(0, 1.0) / bounds.at(0, 2.0) - 0.5).abs() < 0.07, "{bounds:?}");
        // the other outputs are right
        assert_eq!(bounds.largest(1), 0.0);
        // of fresh runs, each interval has its share
        let fresh = runs(1000);
        for interval in [0, 9, 19] {
            let rows = fresh.iter().flat_map(|run| {
                let predictions = predict(&surrogate, &evaluator, run);
                let width = surrogate.outputs().len();
                (5 * interval + 1..=5 * interval + 5)
                    .map(move |row| (run.times[row], (run.outputs[row * width] - predictions[row * width]).abs()))
            });
            let rows: Vec<(f64, f64)> = rows.collect();
            let within = rows.iter().filter(|(time, error)| *error <= bounds.at(0, *time)).count();
            let share = within as f64 / rows.len() as f64;
            assert!(share > 0.86, "{interval}: {share}");
        }
    }

    #[test]
    fn the_bound_is_the_largest_that_any_kind_of_signal_needs_inside_the_ranges() {
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let input = surrogate.inputs().last().unwrap();
        let (low, high) = (input.min, input.max);
        let times: std::sync::Arc<[f64]> = (0..=20).map(|row| 0.1 * f64::from(row)).collect();
        let width = surrogate.outputs().len();
        let run = |signal: &dyn Fn(usize) -> f64, start: f64, error: f64| {
            let mut run = Run {
                inputs: (0..times.len()).map(signal).collect(),
                parameters: vec![1.5, 0.0, start, 0.0, 0.0],
                times: times.clone(),
                outputs: Vec::new(),
            };
            run.outputs = predict(&surrogate, &evaluator, &run);
            run.outputs.iter_mut().step_by(width).for_each(|output| *output += error);
            run
        };
        // none is the example's own start
        let starts = || (0..30).map(|index| 0.011 * f64::from(index + 1));
        let steps = |row: usize| if row < 10 { 0.5 * low } else { 0.5 * high };
        let signals: Vec<Run> = starts().map(|start| run(&steps, start, 1e-4)).collect();
        let decay: Vec<Run> = starts().map(|start| run(&|_| 0.0, start, 3e-3)).collect();
        // so far out of the ranges that nothing is promised there
        let mut pushed: Vec<Run> = starts().map(|start| run(&|_| high, start, 1e-4)).collect();
        for run in &mut pushed {
            run.outputs.iter_mut().skip(10 * width).step_by(width).for_each(|output| *output += 1e6);
        }
        let runs = [signals.clone(), decay, pushed].concat();
        let kinds: Vec<SignalKind> = [0, 30, 60].map(|index| SignalKind::of(&surrogate, &runs[index])).into();
        assert_eq!(kinds, [SignalKind::Signals, SignalKind::Decay, SignalKind::Ends]);
        let dataset = |runs| Dataset { inputs: Vec::new(), parameters: Vec::new(), outputs: Vec::new(), runs };
        let largest = |runs, by_kind| bounds(&surrogate, &dataset(runs), 0.9, by_kind).unwrap().largest(0);
        assert!((largest(signals, true) - 1e-4).abs() < 1e-9);
        assert!((largest(runs.clone(), true) - 3e-3).abs() < 1e-9);
        let bounded = bounds(&surrogate, &dataset(runs.clone()), 0.9, true).unwrap();
        let found = coverage(&surrogate.with_bounds(bounded).unwrap(), &dataset(runs));
        let of_kinds: Vec<(SignalKind, usize)> = found.iter().map(|found| (found.kind, found.runs)).collect();
        assert_eq!(of_kinds, [(SignalKind::Signals, 30), (SignalKind::Decay, 30), (SignalKind::Ends, 30)]);
        // errors of the kind that decides are its bound, up to rounding
        assert_eq!([found[0].within[0], found[2].within[0]], [1.0, 1.0]);
        assert!(found[1].within[0] >= 0.9, "{found:?}");
    }

    #[test]
    fn roll_outs_that_cannot_be_computed_give_no_bounds() {
        let surrogate = example::crane();
        let times: std::sync::Arc<[f64]> = [0.0, 0.1].into();
        let outputs = vec![f64::NAN; 2 * surrogate.outputs().len()];
        let run = Run { inputs: vec![0.0; 2], parameters: vec![1.5, 0.0, 0.0, 0.0, 0.0], times, outputs };
        let dataset = Dataset { inputs: Vec::new(), parameters: Vec::new(), outputs: Vec::new(), runs: vec![run; 40] };
        let message = bounds(&surrogate, &dataset, 0.5, false).unwrap_err().to_string();
        assert!(message.ends_with("too few of their predictions can be computed"), "{message}");
    }

    #[test]
    fn rows_that_are_given_count_for_no_bound() {
        let surrogate = example::recorded();
        let evaluator = Evaluator::new(&surrogate);
        for (before, given) in [(0, 1), (3, 3)] {
            let times: Vec<f64> = (0..10 + before).map(|row| 0.1 * (f64::from(row) - f64::from(before))).collect();
            let run = Run {
                parameters: vec![1.5, 0.4, 0.25],
                times: times.clone().into(),
                inputs: vec![1.0; times.len()],
                outputs: vec![0.5; times.len()],
            };
            let errors = run_errors(&surrogate, &evaluator, &run, SignalKind::Signals);
            let counted: Vec<f64> = errors.iter().map(|(time, _)| *time).collect();
            assert_eq!(counted, times[given..]);
        }
    }

    #[test]
    fn too_few_runs_give_no_bounds() {
        let surrogate = example::surrogate();
        assert_eq!(BoundsOptions::least_runs(0.95), 19);
        let error = bounds(&surrogate, &runs(18, 1), 0.95, false).unwrap_err();
        assert_eq!(error, CalibrationError::Runs { count: 18, coverage: 0.95 });
        assert!(error.to_string().starts_with("18 runs do not bound 0.95 of the rows"), "{error}");
        let largest = bounds(&surrogate, &runs(19, 1), 0.95, false).unwrap();
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
