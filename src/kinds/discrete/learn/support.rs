//! Domain of validity of a discrete-time model: the transitions of its training.

use super::direct::DirectEffects;
use crate::{
    dataset::{Dataset, Run},
    evaluation::RollOut,
    study::Study,
};
use metafmu_runtime::{Evaluator, Sampling, Support, Surrogate};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Run length over the time in which inputs are averaged, which is also the shortest time in which a distance fades.
const PARTS: f64 = 20.0;
/// Share of the rows of runs like those of the training that are to be inside.
const INSIDE: f64 = 0.995;
/// Largest widening of a range at each end, relative to its width. Errors beyond the range of an output grow and last; a model that is wrong
/// everywhere has no domain.
const WIDEST: f64 = 0.01;
/// Smallest variance of a component, relative to that of a feature.
const LEAST_VARIANCE: f64 = 1e-8;
const BISECTIONS: usize = 16;
/// Share of an output's range by which past samples are changed to see how long the model remembers it.
const DISTURBANCE: f64 = 0.05;
/// Number of runs in which that is seen, and the share of them that are to have forgotten it.
const DISTURBED_RUNS: usize = 20;
const FORGOTTEN: f64 = 0.9;

/// Support of the transitions in all runs, without `direct` effects. `inputs`: `true` if inputs are among the features. `ranges`: stated ranges of the inputs, which
/// replace those of the training where they are finite.
///
/// Each range spans the recorded outputs, with the hidden states of `surrogate` in its simulation of the run. Ranges are then widened so that the
/// simulation of a run is inside the ranges of the other runs in most of its rows.
pub(super) fn support(
    study: &Study,
    dataset: &Dataset,
    direct: &DirectEffects,
    (surrogate, inputs): (&Surrogate, bool),
    ranges: impl Iterator<Item = [f64; 2]>,
) -> Support {
    let evaluator = Evaluator::new(surrogate);
    let counts = Counts {
        inputs: dataset.inputs.len(),
        outputs: dataset.outputs.len(),
        hidden: surrogate.program().sampling().map_or(0, |sampling| sampling.hidden.len()),
    };
    let samples = (study.time.stop / study.time.step / PARTS).max(1.0);
    let watched = if inputs { counts.inputs } else { 0 };
    let mut support =
        Support { inputs: watched, ranges: Vec::new(), components: Vec::new(), samples, lasting: samples };
    let starts = study.parameters.len() + counts.outputs;
    let has_starts = surrogate.program().sampling().is_some_and(|sampling| sampling.history[1] > 1);
    let motions: Vec<SimulatedRun> = (dataset.runs.par_iter())
        .map(|run| SimulatedRun {
            recorded: direct.without(run, counts.inputs),
            // the past of given rows is not known
            before: if run.times[0] < 0.0 || !has_starts {
                &run.inputs[..counts.inputs]
            } else {
                &run.parameters[starts..]
            },
            simulated: simulated(surrogate, &evaluator, (run, direct), counts),
        })
        .collect();
    support.components = components(&support, &motions, counts);
    let extremes: Vec<Ranges> = motions.par_iter().map(|motion| motion.extremes(&support, counts)).collect();
    support.ranges = of_all(&extremes, None);
    let settling = surrogate.program().sampling().map_or(0.0, Sampling::settling);
    let width: Vec<f64> = support.ranges.iter().map(|[min, max]| max - min).collect();
    let widths = [&width[4 * watched..][..counts.outputs], &width[4 * watched + 2 * counts.outputs..][..counts.hidden]];
    support.lasting = samples.max(lasting(surrogate, &evaluator, dataset, &widths.concat()));
    let widening = widening(&support, settling, &motions, &extremes, counts);
    for ([min, max], width) in support.ranges.iter_mut().zip(&width) {
        (*min, *max) = (*min - widening * width, *max + widening * width);
    }
    for ([low, high], [min, max]) in support.ranges.iter_mut().zip(ranges).take(watched) {
        (*low, *high) = (if min.is_finite() { min } else { *low }, if max.is_finite() { max } else { *high });
    }
    support
}

#[derive(Clone, Copy)]
struct Counts {
    inputs: usize,
    outputs: usize,
    hidden: usize,
}

/// Smallest and largest value of each measure.
type Ranges = Vec<[f64; 2]>;

/// Row, and relative distance of a measure from its range there.
type Stray = (usize, f64);

/// A run, and the model's simulation of it.
struct SimulatedRun<'a> {
    /// The run without direct effects.
    recorded: Run,
    /// Inputs before the first row.
    before: &'a [f64],
    /// Outputs without direct effects and hidden states of the rows that could be simulated.
    simulated: Vec<f64>,
}

impl SimulatedRun<'_> {
    /// Calls a function with the row and the measures of each transition of the recorded or of the simulated outputs. Recorded outputs have the
    /// hidden states of the simulation: without them there is no transition.
    fn transitions(&self, support: &Support, counts: Counts, is_recorded: bool, mut each: impl FnMut(usize, &[f64])) {
        let Counts { inputs, outputs, hidden } = counts;
        let mut memory = vec![0.0; support.memory()];
        support.begin(&mut memory, self.before);
        let mut measures = vec![0.0; support.measures(outputs, hidden)];
        let numbers = outputs + hidden;
        let simulated = |row: usize| &self.simulated[row * numbers..][..numbers];
        let shown = |row: usize| match is_recorded {
            true => &self.recorded.outputs[row * outputs..][..outputs],
            false => &simulated(row)[..outputs],
        };
        let rows = if is_recorded && hidden == 0 { self.recorded.times.len() } else { self.simulated.len() / numbers };
        for row in 0..rows.saturating_sub(1) {
            let hidden = if hidden > 0 { &simulated(row + 1)[outputs..] } else { &[] };
            let input = &self.recorded.inputs[row * inputs..][..inputs];
            support.measure(&mut memory, input, [shown(row), shown(row + 1)], hidden, &mut measures);
            each(row, &measures);
        }
    }

    fn extremes(&self, support: &Support, counts: Counts) -> Ranges {
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; support.measures(counts.outputs, counts.hidden)];
        self.transitions(support, counts, true, |_, measures| {
            for ([min, max], value) in ranges.iter_mut().zip(measures) {
                (*min, *max) = (min.min(*value), max.max(*value));
            }
        });
        ranges
    }
}

/// Number of samples after which the model has forgotten a disturbance of its past. The largest deviation of an output,
/// relative to its width, has then fallen to a third for good. At most the length of a run.
fn lasting(surrogate: &Surrogate, evaluator: &Evaluator, dataset: &Dataset, widths: &[f64]) -> f64 {
    let samples = surrogate.program().sampling().map_or(1, |sampling| sampling.history[0].max(1));
    let of_run = |run: &Run| -> usize {
        let start = run.times.partition_point(|time| *time < 0.0);
        let rows = run.times.len() - start;
        let outputs = surrogate.outputs().len();
        let along = |disturbance: &[f64]| -> Vec<f64> {
            let mut roll_out = RollOut::along(surrogate, evaluator, run);
            let mut found = Vec::new();
            for row in 0..run.times.len() {
                let Some((_, results)) = roll_out.at(row) else { break };
                if row >= start {
                    found.extend(&results[..outputs]);
                }
                if row == start {
                    roll_out.disturb((0..samples).flat_map(|_| disturbance.iter().copied()));
                }
            }
            found
        };
        let usual = along(&[]);
        let of_number = |number: usize| {
            let disturbance: Vec<f64> = (0..widths.len())
                .map(|other| if other == number { DISTURBANCE * widths[other] } else { 0.0 })
                .collect();
            let disturbed = along(&disturbance);
            let pairs = usual.chunks(outputs).zip(disturbed.chunks(outputs)).skip(1);
            let deviations: Vec<f64> = pairs
                .map(|(usual, disturbed)| {
                    let of_outputs = usual.iter().zip(disturbed).zip(widths);
                    of_outputs.map(|((usual, disturbed), width)| (disturbed - usual).abs() / width).fold(0.0, f64::max)
                })
                .collect();
            let largest = deviations.iter().copied().fold(0.0, f64::max);
            deviations.iter().rposition(|deviation| *deviation > largest / std::f64::consts::E).map_or(0, |row| row + 1)
        };
        (0..widths.len()).map(of_number).max().unwrap_or(0).min(rows)
    };
    let every = dataset.runs.len().div_ceil(DISTURBED_RUNS).max(1);
    let runs: Vec<&Run> = dataset.runs.iter().step_by(every).collect();
    let mut found: Vec<usize> = runs.into_par_iter().map(of_run).collect();
    found.sort_unstable();
    let place = ((found.len() as f64 * FORGOTTEN) as usize).min(found.len().saturating_sub(1));
    found.get(place).map_or(1.0, |samples| *samples as f64)
}

/// Outputs without direct effects and hidden states of the simulation of a run. They end at the row where an output is
/// farther from those of the run than they are from each other.
fn simulated(
    surrogate: &Surrogate,
    evaluator: &Evaluator,
    (run, direct): (&Run, &DirectEffects),
    counts: Counts,
) -> Vec<f64> {
    let Counts { inputs, outputs, hidden } = counts;
    let known = surrogate.ports().known();
    let ranges: Vec<[f64; 2]> = (0..outputs)
        .map(|output| {
            let values = run.outputs.iter().skip(output).step_by(outputs);
            let [min, max] =
                values.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(*value), max.max(*value)]);
            [2.0 * min - max, 2.0 * max - min]
        })
        .collect();
    let mut roll_out = RollOut::along(surrogate, evaluator, run);
    let mut found = Vec::new();
    for row in 0..run.times.len() {
        let Some((point, results)) = roll_out.at(row) else { break };
        let is_near = |(value, [min, max]): (&f64, &[f64; 2])| min <= value && value <= max;
        if !results[..outputs].iter().zip(&ranges).all(is_near) {
            break;
        }
        let input = &run.inputs[row * inputs..][..inputs];
        found.extend(results[..outputs].iter().enumerate().map(|(output, value)| value - direct.effect(input, output)));
        found.extend(&point[known + outputs..][..hidden]);
    }
    found
}

/// Principal components of the standardized coordinates, of unit variance, those of the largest variance first.
/// Directions without motion are dropped.
fn components(support: &Support, motions: &[SimulatedRun], counts: Counts) -> Vec<f64> {
    let first = 3 * support.inputs;
    let width = support.coordinates(counts.outputs, counts.hidden);
    let sums = |mean: &[f64]| -> (f64, Vec<f64>, DMatrix<f64>) {
        let of_motion = |motion: &SimulatedRun| {
            let (mut rows, mut sum, mut products) = (0.0, vec![0.0; width], DMatrix::zeros(width, width));
            motion.transitions(support, counts, true, |_, measures| {
                let off: Vec<f64> = measures[first..].iter().zip(mean).map(|(value, mean)| value - mean).collect();
                rows += 1.0;
                for i in 0..width {
                    sum[i] += off[i];
                    for j in 0..=i {
                        products[(i, j)] += off[i] * off[j];
                    }
                }
            });
            (rows, sum, products)
        };
        // added in the order of the runs, whatever the number of threads
        let parts: Vec<_> = motions.par_iter().map(of_motion).collect();
        parts.into_iter().fold((0.0, vec![0.0; width], DMatrix::zeros(width, width)), |all, one| {
            (all.0 + one.0, all.1.iter().zip(one.1).map(|(a, b)| a + b).collect(), all.2 + one.2)
        })
    };
    let (rows, total, _) = sums(&vec![0.0; width]);
    if rows < 2.0 {
        return Vec::new();
    }
    let mean: Vec<f64> = total.iter().map(|sum| sum / rows).collect();
    let (_, _, products) = sums(&mean);
    let deviation: Vec<f64> = (0..width).map(|i| (products[(i, i)] / rows).sqrt()).collect();
    let moves = |i: usize| deviation[i] > f64::EPSILON * mean[i].abs();
    let correlation = DMatrix::from_fn(width, width, |i, j| match moves(i) && moves(j) {
        true => products[(i.max(j), i.min(j))] / rows / (deviation[i] * deviation[j]),
        false => 0.0,
    });
    let eigen = correlation.symmetric_eigen();
    let mut order: Vec<usize> = (0..width).filter(|&i| eigen.eigenvalues[i] > LEAST_VARIANCE).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let weights = |&component: &usize| {
        let scale = eigen.eigenvalues[component].sqrt();
        let vector = eigen.eigenvectors.column(component).into_owned();
        let weight = |i: usize| if moves(i) { vector[i] / (scale * deviation[i]) } else { 0.0 };
        (0..width).map(weight).collect::<Vec<f64>>()
    };
    order.iter().flat_map(weights).collect()
}

/// Ranges that hold those of all runs but one.
fn of_all(extremes: &[Ranges], but: Option<usize>) -> Ranges {
    let others = extremes.iter().enumerate().filter(|(run, _)| Some(*run) != but).map(|(_, ranges)| ranges);
    let mut all = vec![[f64::INFINITY, f64::NEG_INFINITY]; extremes.first().map_or(0, Vec::len)];
    for ranges in others {
        for ([min, max], [low, high]) in all.iter_mut().zip(ranges) {
            (*min, *max) = (min.min(*low), max.max(*high));
        }
    }
    all
}

/// Widening of the ranges at both ends, relative to their widths, from the simulations of the runs and the ranges of the other runs.
fn widening(support: &Support, settling: f64, motions: &[SimulatedRun], extremes: &[Ranges], counts: Counts) -> f64 {
    let fading = [support.fading(), settling];
    let of_run = |run: usize| {
        let others = of_all(extremes, Some(run));
        let mut beyond: Vec<Stray> = Vec::new();
        let mut rows = 0;
        motions[run].transitions(support, counts, false, |row, values| {
            rows = row + 1;
            for (value, ([low, high], [min, max])) in values.iter().zip(others.iter().zip(&support.ranges)) {
                let distance = (low - value).max(value - high) / (max - min);
                if distance > 0.0 && max > min {
                    beyond.push((row, distance.min(1.0)));
                }
            }
        });
        (rows, beyond)
    };
    if motions.len() < 2 {
        return 0.0;
    }
    let found: Vec<(usize, Vec<Stray>)> = (0..motions.len()).into_par_iter().map(of_run).collect();
    let rows: usize = found.iter().map(|(rows, _)| rows).sum();
    let outside = |by: f64| -> usize {
        let of_run = |(rows, beyond): &(usize, Vec<Stray>)| {
            let (mut state, mut count, mut beyond) = ([0.0; 2], 0, beyond.iter().peekable());
            for row in 0..*rows {
                let mut own = 0.0_f64;
                while let Some((_, beyond)) = beyond.next_if(|(at, ..)| *at == row) {
                    own = own.max(beyond - by);
                }
                state = Support::after(own, state, fading, false);
                count += usize::from(state[1] > 0.0);
            }
            count
        };
        found.iter().map(of_run).sum()
    };
    let is_enough = |by: f64| outside(by) as f64 <= (1.0 - INSIDE) * rows as f64;
    let mut by = 0.0;
    if !is_enough(0.0) {
        let mut low = 0.0;
        by = WIDEST;
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + by);
            if is_enough(middle) { by = middle } else { low = middle }
        }
    }
    by
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;
    use metafmu_runtime::{Clock, Graph, Program, Sampling};

    #[test]
    fn a_model_forgets_a_disturbance_as_fast_as_its_outputs_decay() {
        let recorded = example::recorded();
        let surrogate = |decay: f64| {
            // position, force and mass
            let graph = Graph::of_samples(3, vec![decay, 0.0, 0.0], vec![0.1], None);
            let sampling =
                Sampling { hidden: Vec::new(), direct: Vec::new(), history: [1, 1], step: 0.1, support: None };
            let mut metadata = recorded.metadata().clone();
            metadata.inputs.remove(2);
            Surrogate::new(metadata, Program { graph, clock: Clock::Sampled(Box::new(sampling)) }).unwrap()
        };
        let run = Run {
            parameters: vec![1.5, 0.5],
            times: (0..41).map(|row| 0.1 * f64::from(row)).collect(),
            inputs: vec![0.0; 41],
            outputs: vec![0.0; 41],
        };
        let dataset = Dataset { parameters: Vec::new(), inputs: Vec::new(), outputs: Vec::new(), runs: vec![run] };
        let forgets = |decay: f64| {
            let surrogate = surrogate(decay);
            lasting(&surrogate, &Evaluator::new(&surrogate), &dataset, &[2.0])
        };
        // 0.9^k falls to a third after 9.5 samples
        assert_eq!([0.9, 0.5, 1.0].map(forgets), [10.0, 2.0, 40.0]);
    }
}
