//! Choice among nonlinear state spaces with hidden states, which are fitted to whole simulations ([`crate::discrete`]).
//!
//! A training begins with a linear state space; the penalty of the distance from it falls step by step. Order, functions and penalty are those
//! with the best simulations in a cross-validation.

mod export;
mod start;

use super::{DiscreteSamples, LearnedDiscrete, standardized};
use crate::{
    Error, Result,
    dataset::Run,
    discrete::{CountedRuns, Features, Goal, Limits, Saturation, Signals, Simulated, StateShape, correct, overwriting},
    project::{Event, Project},
    training::StopReason,
};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use start::LinearStart;
use std::{ops::Range, sync::atomic::Ordering};

/// States for each output.
const ORDERS: [usize; 6] = [1, 2, 3, 4, 5, 6];
/// Functions in the order of their cost.
const KINDS: [Nonlinearity; 4] =
    [Nonlinearity::OutputProducts(3), Nonlinearity::Products(2), Nonlinearity::Products(3), Nonlinearity::Nodes(6)];
/// Penalties of the square of the distance from the linear state space, for each error.
const PENALTIES: [f64; 12] = [1.0, 0.3, 0.1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10];
/// Share of the width of hidden states' ranges by which simulations may leave them, where they diverge otherwise.
const MARGIN: f64 = 0.5;
/// Largest standardized difference of a common start from its outputs, if the gain changes.
const FARTHEST: f64 = 1.0;
/// Linear state spaces of an order that get functions: those with the smallest errors.
const CONTINUED: usize = 2;
/// Penalty of the linear state space.
const LEAST: f64 = 1e-8;
/// Number of penalties without a better cross-validation after which the others are skipped.
const PATIENCE: usize = 4;
/// Share of the error of a simpler state space, below which another one is better.
const BETTER: f64 = 0.98;
/// Standardized error of an exact setting, which ends the search: among better ones, rounding would decide.
const EXACT: f64 = 1e-9;
/// Iterations with a penalty, and of the linear state space with each of the stretches.
const ITERATIONS: usize = 15;
/// Iterations with all rows of many.
const LAST_ITERATIONS: usize = 60;
const STRETCHES: [usize; 3] = [8, 64, usize::MAX];
/// Rows that choose; of more, each run has its first ones. The model that is chosen is fitted to all.
const ROWS: usize = 5000;
/// Minimum number of rows of a run where it is cut.
const SHORTEST: usize = 500;
/// Parts of the cross-validation, and runs up to which each is a part.
const FOLDS: usize = 5;
const FEW_RUNS: usize = 8;
/// Coefficients at most, and share of the budget for all trainings.
const MOST: usize = 400;
const BUDGET: f64 = 1.0 / 6.0;
/// Multiplications of trainings in a second of two cores.
const RATE: f64 = 1e10;

/// Functions of a state space.
#[derive(Clone, Copy, Debug)]
enum Nonlinearity {
    Linear,
    /// Products of outputs and inputs up to a degree.
    OutputProducts(u8),
    /// Products of all columns up to a degree.
    Products(u8),
    /// Number of nodes.
    Nodes(usize),
}

/// Setting that the cross-validation chooses.
#[derive(Clone, Debug)]
struct Setting {
    saturation: Saturation,
    order: usize,
    kind: Nonlinearity,
    penalty: f64,
}

/// State space with the smallest error in a cross-validation of the training runs and those held out. It is fitted to
/// the training runs, and with few rows to all of them as well. None if no linear one can be simulated.
///
/// # Errors
/// [`Error::Interrupted`] before the first is fitted.
pub(super) fn learn(project: &Project, samples: &DiscreteSamples) -> Result<Vec<LearnedDiscrete>> {
    let stop = project.control().stop;
    let is_stopped = || stop.load(Ordering::Relaxed);
    let runs = SearchRuns::new(samples);
    let corners = runs.corners(samples.counts[2]);
    let budget = project.study.discrete.seconds(BUDGET) * RATE;
    let common_start = start::common(samples, &project.study);
    let search = Search { samples, budget, seed: project.study.seed, is_stopped: &is_stopped, corners, common_start };
    let found = search.best(&runs);
    let Some(BestSetting { error, choice, fitted }) = found else {
        return if is_stopped() { Err(Error::Interrupted) } else { Ok(Vec::new()) };
    };
    let Setting { saturation, order, kind, penalty } = choice;
    project.event(Event::Note(format_args!(
        "state space: {} hidden states, {kind}{saturation}, penalty {penalty:.0e}, error {error:.2e} in a cross-validation",
        (order - 1) * samples.counts[2],
    )));
    let shape = search.shape(order, kind);
    // fitted to other rows; none if that does not stay finite
    let advanced = |from: &FittedStates, runs: &[Signals], is_seen: &dyn Fn(usize) -> bool, iterations: usize| {
        let (data, mut fitted) = (CountedRuns::new(runs, is_seen), from.clone());
        search.advance(&data, &shape, penalty, iterations, &mut fitted);
        let bounded = if search.is_stable(&shape, &fitted) { Some(fitted) } else { fitted.bounded(&shape, &data) };
        bounded.filter(|bounded| search.is_stable(&shape, bounded))
    };
    let model = |fitted: &FittedStates| export::model(samples, &shape, fitted.simulated());
    let of_training = |run: usize| run < samples.training.len();
    let learned = match &runs.all {
        Some(all) => model(&advanced(&fitted, all, &of_training, LAST_ITERATIONS).unwrap_or(fitted)),
        None => {
            let fitted = advanced(&fitted, &runs.few, &of_training, 0).unwrap_or(fitted);
            let refitted = advanced(&fitted, &runs.few, &|_| true, ITERATIONS);
            LearnedDiscrete { refitted: refitted.map(|refitted| Box::new(model(&refitted))), ..model(&fitted) }
        }
    };
    let stopped = if is_stopped() { StopReason::Interrupted } else { StopReason::Solved };
    // a Ctrl-C is used up: what follows is quick and uses the best model
    stop.store(false, Ordering::Relaxed);
    let unseen = (runs.all.is_none() && runs.count > 1).then_some(error);
    Ok(vec![LearnedDiscrete { stopped, unseen, ..learned }])
}

/// Runs, standardized and numbered: those of the training, then those held out.
struct SearchRuns {
    /// The rows that choose: all, or, of many, the first ones of each run.
    pieces: Vec<Signals>,
    /// These rows, with runs that follow each other as one.
    few: Vec<Signals>,
    /// All rows, unless they are few.
    all: Option<Vec<Signals>>,
    /// Number of runs, and of those of the training.
    count: usize,
    training: usize,
}

impl SearchRuns {
    fn new(samples: &DiscreteSamples) -> Self {
        let runs = samples.training.iter().chain(&samples.validation).enumerate();
        let all: Vec<Signals> = runs.map(|(number, run)| signals(samples, run, number)).collect();
        let (count, training) = (all.len(), samples.training.len());
        if all.iter().map(Signals::rows).sum::<usize>() <= ROWS {
            return Self { few: joined(&all), pieces: all, all: None, count, training };
        }
        let longest = (ROWS / count.max(1)).max(SHORTEST);
        let mut rows = 0;
        let few = all.iter().map(|run| run.cut(run.given + longest)).take_while(|run| {
            rows += run.rows() - run.given;
            rows - (run.rows() - run.given) < ROWS
        });
        let few: Vec<Signals> = few.collect();
        Self { count: few.len(), training: training.min(few.len()), pieces: few.clone(), few, all: Some(all) }
    }
}

impl SearchRuns {
    /// Runs from the ends of the outputs' ranges with inputs and parameters at the ends and in the middle of theirs.
    fn corners(&self, outputs: usize) -> Vec<Signals> {
        let rows = self.pieces.iter().map(Signals::rows).max().unwrap_or(1);
        let columns = self.pieces.first().map_or(0, |run| run.inputs.len() / run.rows().max(1));
        let range = |of: fn(&Signals) -> &[f64], width: usize, column: usize| {
            let values = self.pieces.iter().flat_map(|run| of(run).iter().skip(column).step_by(width));
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(*value), max.max(*value)])
        };
        let at = |[min, max]: [f64; 2], share: f64| min + share * (max - min);
        let corner = |(start, share): (f64, f64)| {
            let y = (0..outputs).map(|output| at(range(|run| &run.outputs, outputs, output), start));
            let u = (0..columns).map(|column| at(range(|run| &run.inputs, columns, column), share));
            let [y, u] = [y.collect::<Vec<_>>(), u.collect()];
            Signals { outputs: y.repeat(rows), inputs: u.repeat(rows), given: 1, runs: vec![0; rows] }
        };
        [0.0, 1.0].into_iter().flat_map(|start| [0.0, 0.5, 1.0].map(|share| (start, share))).map(corner).collect()
    }
}

/// Runs that follow each other in a record as one.
fn joined(runs: &[Signals]) -> Vec<Signals> {
    let next = |run: &Signals| runs.iter().position(|next| run.is_followed_by(next));
    let nexts: Vec<Option<usize>> = runs.iter().map(next).collect();
    let mut left = vec![true; runs.len()];
    let mut whole = Vec::new();
    // first ones before others: of a circle any is first
    let (others, firsts): (Vec<_>, Vec<_>) = (0..runs.len()).partition(|run| nexts.contains(&Some(*run)));
    for first in firsts.into_iter().chain(others) {
        if !std::mem::take(&mut left[first]) {
            continue;
        }
        let (mut signals, mut last) = (runs[first].clone(), first);
        while let Some(next) = nexts[last].filter(|next| std::mem::take(&mut left[*next])) {
            signals.extend(&runs[next]);
            last = next;
        }
        whole.push(signals);
    }
    whole
}

/// Coefficients that are fitted to some runs, on the path of falling penalties.
#[derive(Clone)]
struct FittedStates {
    /// The linear state space, from which the distance counts.
    center: Vec<f64>,
    coefficients: Vec<f64>,
    /// Correction of the states by outputs that are given.
    gain: Vec<f64>,
    limits: Limits,
}

impl FittedStates {
    fn simulated(&self) -> Simulated<'_> {
        Simulated { coefficients: &self.coefficients, gain: &self.gain, limits: &self.limits }
    }

    /// Another gain. From a common start, the states after the correction by its outputs stay the same: a small change of outputs alone may excite
    /// large motions.
    fn replace_gain(&mut self, shape: &StateShape, gain: Vec<f64>) {
        let before = std::mem::replace(&mut self.gain, gain);
        let Some(first) = &shape.common_start else { return };
        let start = &mut self.coefficients[shape.places()[5].clone()];
        let mut states = start.to_vec();
        correct(&mut states, &before, &self.limits, first);
        // (1 - K) (x_y - y) is what the correction leaves of the outputs' errors
        let outputs = shape.outputs;
        let kept = DMatrix::from_fn(outputs, outputs, |row, column| {
            f64::from(u8::from(row == column)) - self.gain[row * outputs + column]
        });
        let left = DVector::from_fn(outputs, |output, _| states[output] - first[output]);
        let Some(errors) = kept.lu().solve(&left).filter(|errors| errors.amax() < FARTHEST) else { return };
        for (state, value) in start.iter_mut().enumerate() {
            let corrected: f64 = (0..outputs).map(|output| self.gain[state * outputs + output] * errors[output]).sum();
            *value = states[state] + corrected;
        }
    }

    /// State space whose hidden states stay near their ranges in these runs; none if the simulations diverge.
    fn bounded(&self, shape: &StateShape, data: &CountedRuns) -> Option<Self> {
        let mut bounded = self.clone();
        let ranges = data.ranges(shape, self.simulated())?;
        let hidden = shape.outputs..shape.states;
        for (limit, [low, high]) in bounded.limits.states[hidden.clone()].iter_mut().zip(&ranges[hidden]) {
            let margin = MARGIN * (high - low);
            *limit = [low - margin, high + margin];
        }
        Some(bounded)
    }
}

/// Result of a search.
struct BestSetting {
    /// Root mean square error in the cross-validation.
    error: f64,
    choice: Setting,
    /// State space fitted to the training runs.
    fitted: FittedStates,
}

impl BestSetting {
    fn is_exact(&self) -> bool {
        self.error < EXACT
    }
}

/// Runs of a cross-validation.
#[derive(Clone, Copy)]
struct Folds<'a> {
    /// Runs to fit to: of each part, and of the training.
    sets: &'a [CountedRuns<'a>],
    /// Number of those of the training.
    own: usize,
    /// Unseen runs of each part, simulated in different ways.
    unseen: &'a [Vec<CountedRuns<'a>>],
}

struct Search<'a> {
    samples: &'a DiscreteSamples<'a>,
    /// Multiplications of all trainings.
    budget: f64,
    seed: u64,
    is_stopped: &'a (dyn Fn() -> bool + Sync),
    /// Runs with constant inputs.
    corners: Vec<Signals>,
    /// Common start as in [`StateShape`].
    common_start: Option<Vec<f64>>,
}

impl Search<'_> {
    /// Setting with the smallest error in a cross-validation of all runs.
    fn best(&self, runs: &SearchRuns) -> Option<BestSetting> {
        let is_cross_validated = runs.all.is_none() || runs.training == runs.count;
        let folds = match is_cross_validated {
            true if runs.count <= FEW_RUNS => runs.count,
            true => FOLDS,
            false => 1,
        };
        let is_unseen = |run: usize, fold: usize| match is_cross_validated {
            // a single run is both
            true => folds == 1 || run % folds == fold,
            false => run >= runs.training,
        };
        let few = &runs.few;
        // from given rows, and within simulations of a record that is one run here
        let ways = if runs.pieces.len() == few.len() { vec![few] } else { vec![&runs.pieces, few] };
        let unseen = |fold: usize| ways.iter().map(|runs| CountedRuns::new(runs, |run| is_unseen(run, fold))).collect();
        let unseen: Vec<Vec<CountedRuns>> = (0..folds).map(unseen).collect();
        let seen = |fold: usize| CountedRuns::new(few, |run| runs.count == 1 || !is_unseen(run, fold));
        let mut sets: Vec<CountedRuns> = (0..folds).map(seen).collect();
        // of the training runs
        let own = if is_cross_validated { folds } else { 0 };
        if is_cross_validated {
            sets.push(CountedRuns::new(few, |run| run < runs.training));
        }
        let mut best = None;
        let saturations = Saturation::all(&runs.pieces, self.samples.counts[2]);
        for saturation in &saturations {
            let budget = self.budget / saturations.len() as f64;
            self.with(saturation, Folds { sets: &sets, own, unseen: &unseen }, budget, &mut best);
            if best.as_ref().is_some_and(BestSetting::is_exact) {
                break;
            }
        }
        best
    }

    /// Replaces the best setting by a better one with some saturation; the first exact one is the last.
    fn with(&self, saturation: &Saturation, folds: Folds, budget: f64, best: &mut Option<BestSetting>) {
        let Folds { sets, own, unseen } = folds;
        let count = (sets[..unseen.len()].iter().map(CountedRuns::rows).sum::<usize>() / unseen.len().max(1)) as f64;
        let setting = |order, kind, penalty: f64| Setting {
            saturation: saturation.clone(),
            order,
            kind,
            penalty: penalty * count,
        };
        let mut left = budget;
        // returns true if the best setting is exact
        let mut keep = |choice: Setting, error: f64, fitted: &[FittedStates]| {
            let is_better = |error: f64, best: &Option<BestSetting>| {
                error.is_finite() && best.as_ref().is_none_or(|best| error < BETTER * best.error)
            };
            let shape = self.shape(choice.order, choice.kind);
            if is_better(error, best) && self.is_stable(&shape, &fitted[own]) {
                *best = Some(BestSetting { error, choice, fitted: fitted[own].clone() });
            } else if choice.order > 1 && !matches!(choice.kind, Nonlinearity::Linear) {
                let bounded = fitted.iter().zip(sets).map(|(fitted, data)| fitted.bounded(&shape, data));
                let Some(bounded) = bounded.collect::<Option<Vec<_>>>() else { return false };
                let error = self.error(&shape, unseen, &bounded);
                if is_better(error, best) && self.is_stable(&shape, &bounded[own]) {
                    *best = Some(BestSetting { error, choice, fitted: bounded[own].clone() });
                }
            }
            best.as_ref().is_some_and(BestSetting::is_exact)
        };
        // one order after the other
        let mut linear: Vec<(usize, Vec<FittedStates>)> = Vec::new();
        for order in ORDERS {
            let mut of_order = Vec::new();
            for origin in start::STARTS {
                let shape = self.shape(order, Nonlinearity::Linear);
                let cost = ITERATIONS as f64 * sets.iter().map(|data| data.cost(&shape)).sum::<f64>();
                if shape.coefficients() > MOST || cost > left || (self.is_stopped)() {
                    continue;
                }
                left -= cost;
                let limits = saturation.limits(&shape);
                let Some(fitted) = self.linear(origin, folds, &shape, &limits, LEAST * count) else { continue };
                let error = self.error(&shape, unseen, &fitted);
                if keep(setting(order, Nonlinearity::Linear, LEAST), error, &fitted) {
                    return;
                }
                of_order.push((error, fitted));
            }
            of_order.sort_by(|(a, _), (b, _)| a.total_cmp(b));
            linear.extend(of_order.into_iter().take(CONTINUED).map(|(_, fitted)| (order, fitted)));
        }
        for kind in KINDS {
            for (order, linear) in &linear {
                let order = *order;
                let shape = self.shape(order, kind);
                if shape.coefficients() > MOST {
                    continue;
                }
                let mut fitted: Vec<FittedStates> = linear.iter().map(|from| self.start(&shape, kind, from)).collect();
                let (mut least, mut since) = (f64::INFINITY, 0);
                for penalty in PENALTIES {
                    if left <= 0.0 || (self.is_stopped)() || since >= PATIENCE {
                        break;
                    }
                    let step = |(fitted, data): (&mut FittedStates, &CountedRuns)| {
                        self.advance(data, &shape, penalty * count, ITERATIONS, fitted)
                    };
                    let costs: Vec<f64> = fitted.par_iter_mut().zip(sets).map(step).collect();
                    left -= costs.into_iter().sum::<f64>();
                    let error = self.error(&shape, unseen, &fitted);
                    (least, since) = if error < least { (error, 0) } else { (least, since + 1) };
                    if keep(setting(order, kind, penalty), error, &fitted) {
                        return;
                    }
                }
            }
        }
    }

    /// Root mean square error of the simulations of unseen runs, mean of the parts: that of a single hard part does not decide alone.
    fn error(&self, shape: &StateShape, unseen: &[Vec<CountedRuns>], fitted: &[FittedStates]) -> f64 {
        let of_part = |(data, fitted): (&Vec<CountedRuns>, &FittedStates)| {
            data.iter().map(|data| data.squares(shape, fitted.simulated())).sum::<f64>()
        };
        let squares: Vec<f64> = unseen.par_iter().zip(fitted).map(of_part).collect();
        let mean = |data: &Vec<CountedRuns>, squares: f64| {
            let values = data.iter().map(CountedRuns::rows).sum::<usize>().max(1) * shape.outputs;
            (squares / values as f64).sqrt()
        };
        let errors = unseen.iter().zip(squares).map(|(data, squares)| mean(data, squares));
        errors.sum::<f64>() / unseen.len() as f64
    }

    /// Returns true if simulations stay finite. They begin at the ends of the outputs' ranges, with inputs at the ends
    /// and in the middle of theirs.
    fn is_stable(&self, shape: &StateShape, fitted: &FittedStates) -> bool {
        let gain = overwriting(shape);
        CountedRuns::new(&self.corners, |_| true).is_stable(shape, Simulated { gain: &gain, ..fitted.simulated() })
    }

    /// One step of the path; returns the number of multiplications.
    fn advance(
        &self,
        data: &CountedRuns,
        shape: &StateShape,
        penalty: f64,
        iterations: usize,
        fitted: &mut FittedStates,
    ) -> f64 {
        let FittedStates { center, gain, limits, .. } = &*fitted;
        let goal = Goal { center, gain, limits, penalty, stretch: usize::MAX, iterations };
        let found = data.fit(shape, &fitted.coefficients, &goal, self.is_stopped);
        fitted.coefficients = found.coefficients;
        fitted.replace_gain(shape, data.gain(shape, fitted.simulated()));
        found.evaluations as f64 * data.cost(shape)
    }

    /// A linear state space of each set, all with the hidden states of that of the training runs; none if one diverges.
    fn linear(
        &self,
        origin: LinearStart,
        Folds { sets, own, .. }: Folds,
        shape: &StateShape,
        limits: &Limits,
        penalty: f64,
    ) -> Option<Vec<FittedStates>> {
        let training = sets.get(own)?;
        let start = start::linear(origin, self.samples, training, shape, limits)?;
        let (center, gain) = (shape.constant(), overwriting(shape));
        let fitted = |data: &CountedRuns, start: Vec<f64>, stretches: &[usize]| {
            let mut now = (f64::INFINITY, start);
            for stretch in stretches {
                let goal =
                    Goal { center: &center, gain: &gain, limits, penalty, stretch: *stretch, iterations: ITERATIONS };
                let found = data.fit(shape, &now.1, &goal, self.is_stopped);
                now = (found.value, found.coefficients);
            }
            now.0.is_finite().then_some(now.1)
        };
        let common = fitted(training, start, &STRETCHES)?;
        let of_set = |data: &CountedRuns| {
            // one that diverges in runs that the training does not see becomes stable in stretches
            let whole = fitted(data, common.clone(), &STRETCHES[2..]);
            let coefficients = whole.or_else(|| fitted(data, common.clone(), &STRETCHES))?;
            let mut fitted =
                FittedStates { center: Vec::new(), coefficients, gain: gain.clone(), limits: limits.clone() };
            fitted.replace_gain(shape, data.gain(shape, fitted.simulated()));
            Some(FittedStates { center: fitted.coefficients.clone(), ..fitted })
        };
        sets.par_iter().map(of_set).collect()
    }

    /// A linear state space with functions that have no effect yet; nodes are random.
    fn start(&self, shape: &StateShape, kind: Nonlinearity, linear: &FittedStates) -> FittedStates {
        let of_linear = StateShape { features: Features::Nodes(0), ..shape.clone() }.places();
        let places = shape.places();
        let mut center = shape.constant();
        for block in [0, 1, 5] {
            center[places[block].clone()].copy_from_slice(&linear.coefficients[of_linear[block].clone()]);
        }
        if let Nonlinearity::Nodes(_) = kind {
            let mut random = ChaCha8Rng::seed_from_u64(self.seed);
            // a sum of uniform numbers is nearly normal, on every platform the same
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let spread = (shape.columns as f64).sqrt();
            center[places[3].clone()].iter_mut().for_each(|weight| *weight = normal() / spread);
            center[places[4].clone()].iter_mut().for_each(|bias| *bias = 0.5 * normal());
        }
        FittedStates { coefficients: center.clone(), center, ..linear.clone() }
    }

    fn shape(&self, order: usize, kind: Nonlinearity) -> StateShape {
        let [parameters, inputs, outputs] = self.samples.counts;
        let (states, columns) = (order * outputs, order * outputs + inputs + parameters);
        let (features, common_start) = (kind.features(columns, outputs..states), self.common_start.clone());
        StateShape { states, outputs, columns, features, common_start }
    }
}

impl Nonlinearity {
    /// Functions of some columns, `hidden` ones among them.
    fn features(self, columns: usize, hidden: Range<usize>) -> Features {
        let products = match self {
            Self::Linear => return Features::Nodes(0),
            Self::Nodes(count) => return Features::Nodes(count),
            Self::OutputProducts(degree) => {
                Features::products(columns, degree, |column| !hidden.contains(&column), MOST)
            }
            Self::Products(degree) => Features::products(columns, degree, |_| true, MOST),
        };
        // a setting with too many products counts as too large
        products.unwrap_or(Features::Nodes(MOST))
    }
}

impl std::fmt::Display for Nonlinearity {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Linear => write!(f, "linear"),
            Self::OutputProducts(degree) => write!(f, "products of outputs and inputs up to degree {degree}"),
            Self::Products(degree) => write!(f, "products up to degree {degree}"),
            Self::Nodes(count) => write!(f, "{count} nodes"),
        }
    }
}

/// A run, standardized.
fn signals(samples: &DiscreteSamples, run: &Run, number: usize) -> Signals {
    let [of_parameters, of_inputs, of_outputs] = &samples.scales;
    let [parameters, inputs, outputs] = samples.counts;
    let p: Vec<f64> = standardized(&run.parameters[..parameters], of_parameters).collect();
    let rows = run.times.len();
    let columns = |row: usize| {
        let u = standardized(&run.inputs[row * inputs..][..inputs], of_inputs);
        u.chain(p.iter().copied()).collect::<Vec<f64>>()
    };
    let outputs_of = |row: usize| standardized(&run.outputs[row * outputs..][..outputs], of_outputs);
    Signals {
        outputs: (0..rows).flat_map(outputs_of).collect(),
        inputs: (0..rows).flat_map(columns).collect(),
        given: run.times.partition_point(|time| *time < 0.0).max(1),
        runs: vec![number; rows],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run with an output and an input, of the rows of a record.
    fn run(number: usize, rows: Range<usize>, given: usize) -> Signals {
        let values: Vec<f64> = rows.clone().map(|row| (row as f64).sin()).collect();
        Signals { outputs: values.clone(), inputs: values, given, runs: vec![number; rows.len()] }
    }

    #[test]
    fn runs_that_follow_each_other_are_one() {
        // pieces of a record of 30 rows, each with the three rows before it, and a run of another record
        let runs = [run(0, 7..21, 3), run(1, 100..110, 3), run(2, 0..11, 4), run(3, 17..30, 3)];
        let found = joined(&runs);
        assert_eq!(found.iter().map(Signals::rows).collect::<Vec<_>>(), [10, 30]);
        assert_eq!(found[0].outputs, runs[1].outputs);
        assert_eq!(found[1].outputs, run(0, 0..30, 4).outputs);
        assert_eq!(found[1].given, 4);
        let expected = [[2; 11].as_slice(), &[0; 10], &[3; 9]].concat();
        assert_eq!(found[1].runs, expected);
    }

    #[test]
    fn runs_that_repeat_each_other_end() {
        let constant =
            |number| Signals { outputs: vec![1.0; 9], inputs: vec![0.0; 9], given: 2, runs: vec![number; 9] };
        let found = joined(&[constant(0), constant(1)]);
        let mut runs: Vec<usize> = found.iter().flat_map(|signals| signals.runs.clone()).collect();
        runs.dedup();
        runs.sort_unstable();
        assert_eq!(runs, [0, 1]);
    }
}
