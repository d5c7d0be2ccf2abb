//! Roll-outs of surrogates with states: how their errors grow with time.

use super::{first_predicted, varies};
use crate::{
    dataset::{Dataset, Run},
    dynamics::Assembly,
    worst::worst,
};
use metafmu_runtime::{
    CommunicationStep, Domain, Drive, Dynamics, Evaluator, Integration, Output, Role, Shown, StepError, Surrogate,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Growth of errors along the test runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RollOuts {
    /// At a sixth of the runs' length, and at their end; once if there is no row between.
    pub horizons: Vec<Horizon>,
    /// Indices of the test runs that are chaotic: their sensitivity at the end exceeds [`CHAOTIC`], and they have not diverged.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub chaotic_runs: Vec<usize>,
    /// Indices of the test runs in which the surrogate diverges: predictions are not finite, or far outside. A diverging model is
    /// as sensitive as a chaotic motion, but a chaotic motion stays within ten widths of the outputs' ranges in training, or of the truth.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub diverged_runs: Vec<usize>,
    /// Median of the times at which an error exceeds a tenth of its output's standard deviation in the run, in seconds; none if more
    /// than half of the runs never come to that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub divergence_time: Option<f64>,
    /// Largest change of the energy without inputs over the length of a run, relative to the largest kinetic energy; none if something
    /// dissipates or drives it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy_drift: Option<f64>,
    /// Residual of the loop constraints: the largest difference between a position output and the mechanism's value at
    /// the surrogate's own coordinates, relative to the output's range; none without a mechanism or such an output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub constraint_residual: Option<f64>,
    /// Number of runs, and of those that are still finite, after ten times their length, their inputs being repeated.
    pub long_runs: [usize; 2],
}

/// Relative root mean square errors of predicted rows up to a time, each the largest over the run's outputs. The scale
/// is the root mean square of the truth around its mean or, for an output that does not vary, its range in training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Horizon {
    /// Time since the start.
    pub seconds: f64,
    /// Median over the runs.
    pub median: f64,
    /// 90 % quantile.
    pub q90: f64,
    /// Median over the runs relative to the truth of the whole run, where that varies more than up to this time.
    #[serde(default)]
    pub of_run: f64,
    /// Median and 90 % quantile for an initial state perturbed by 1e-9 in every state: the sensitivity of the motion
    /// itself.
    pub sensitivity: [f64; 2],
}

/// Perturbation of the initial state by which the sensitivity of a motion is measured.
pub const OFF: f64 = 1e-9;
/// Sensitivity of a motion, its response to an initial state perturbed by 1e-9, from which on it is chaotic.
pub const CHAOTIC: f64 = 1e-3;
/// Widths of an output's range in training by which predictions of a bounded motion may leave it.
const BOUNDED: f64 = 10.0;
/// Part of its standard deviation that an error of an output has when a roll-out has diverged.
const DIVERGED: f64 = 0.1;
/// Largest number of chaotic runs that a description names.
const NAMED_RUNS: usize = 8;
/// Steps of the solver in a run, and for each of its rows, above which the run is not computed to its end.
const MOST_STEPS: u64 = 1_000_000;
const MOST_STEPS_OF_ROW: u64 = 1000;
/// Lengths of a run after which it is to be finite.
const LENGTHS: usize = 10;
/// Runs that are rolled out so far.
const LONG_RUNS: usize = 2;

impl RollOuts {
    /// Returns true if the motion is chaotic: at least half of the `test_runs` are.
    pub fn is_chaotic(&self, test_runs: usize) -> bool {
        2 * self.chaotic_runs.len() >= test_runs.max(1)
    }

    /// Description of the chaotic runs among `test_runs`, or none.
    pub fn describe_chaos(&self, test_runs: usize) -> Option<String> {
        describe_runs(&self.chaotic_runs, test_runs, "chaotic")
    }

    /// Description of the test runs in which the surrogate diverges, or none.
    pub fn describe_divergence(&self, test_runs: usize) -> Option<String> {
        describe_runs(&self.diverged_runs, test_runs, "diverging")
    }

    /// Measures the predictions of the test runs.
    pub(super) fn of(surrogate: &Surrogate, test: &Dataset, predictions: &[Vec<f64>]) -> Self {
        let evaluator = Evaluator::new(surrogate);
        let width = test.outputs.len();
        let ranges: Vec<f64> = surrogate.outputs().iter().map(|output| output.max - output.min).collect();
        // what is given is no prediction
        let first = |run: &Run| first_predicted(surrogate, run);
        let pairs = || test.runs.par_iter().zip(predictions);
        let exact = |run: &Run| tight(RollOut::along(surrogate, &evaluator, run)).predictions();
        let is_controlled = surrogate.program().integration().and_then(Integration::tolerance).is_some();
        let exact: Option<Vec<_>> = is_controlled.then(|| test.runs.par_iter().map(exact).collect());
        let exact = exact.as_deref().unwrap_or(predictions);
        let off: Vec<Vec<f64>> = test.runs.par_iter().map(|run| predict_off(surrogate, &evaluator, run)).collect();
        let rows = test.runs.iter().map(|run| run.times.len() - first(run)).max().unwrap_or(0);
        let relative = |run: &Run, truth: &[f64], found: &[f64], rows: usize| {
            let from = first(run) * width;
            relative_error(&truth[from..], &found[from..], &ranges, (rows, rows))
        };
        let sensitivities = |rows: usize| -> Vec<f64> {
            let changes = test.runs.par_iter().zip(exact).zip(&off);
            changes.map(|((run, one), other)| relative(run, one, other, rows)).collect()
        };
        let horizon = |rows: usize| {
            let errors = quantiles(pairs().map(|(run, found)| relative(run, &run.outputs, found, rows)).collect());
            let changes = quantiles(sensitivities(rows));
            let of_run = |(run, found): (&Run, &Vec<f64>)| {
                let from = first(run) * width;
                relative_error(&run.outputs[from..], &found[from..], &ranges, (rows, usize::MAX))
            };
            let [of_run, _] = quantiles(pairs().map(of_run).collect());
            let times = test.runs.iter().filter_map(|run| run.times.get(first(run) + rows - 1));
            let seconds = times.copied().fold(0.0, f64::max);
            Horizon { seconds, median: errors[0], q90: errors[1], of_run, sensitivity: changes }
        };
        // of a state at the start the first row tells nothing
        let mut lengths = vec![(rows.saturating_sub(1) / 6 + 1).max(2).min(rows.max(1)), rows.max(1)];
        lengths.dedup();
        let mut times: Vec<f64> = pairs().map(|(run, found)| divergence(run, found, first(run), &ranges)).collect();
        times.sort_by(f64::total_cmp);
        let divergence_time = times.get(times.len() / 2).copied().filter(|time| time.is_finite());
        let at_end = sensitivities(rows);
        let outputs = surrogate.outputs();
        let all = 0..test.runs.len();
        let diverged_runs: Vec<usize> =
            all.clone().filter(|&run| diverges(outputs, &test.runs[run].outputs, &predictions[run])).collect();
        let finite = |run: &&Run| RollOut::along(surrogate, &evaluator, run).repeated(LENGTHS).is_some();
        Self {
            horizons: lengths.into_iter().map(horizon).collect(),
            // NaN, of a disturbed run that ends with an error, is no sensitivity of a bounded motion
            chaotic_runs: all.filter(|run| at_end[*run] > CHAOTIC && !diverged_runs.contains(run)).collect(),
            diverged_runs,
            divergence_time,
            energy_drift: energy_drift(surrogate, &evaluator, test),
            constraint_residual: None,
            long_runs: {
                let runs = &test.runs[..test.runs.len().min(LONG_RUNS)];
                [runs.len(), runs.par_iter().filter(finite).count()]
            },
        }
    }
}

/// Returns true if predictions of a run are not finite, or further outside the outputs' ranges in training, and outside the truth of the run, than
/// those of a bounded motion.
fn diverges(outputs: &[Output], truth: &[f64], predictions: &[f64]) -> bool {
    let width = outputs.len();
    outputs.iter().enumerate().any(|(column, output)| {
        let truth = truth.iter().skip(column).step_by(width).copied();
        let [min, max] = truth.fold([output.min, output.max], |[min, max], value| [min.min(value), max.max(value)]);
        let reach = BOUNDED * (output.max - output.min);
        // an output that did not vary in training has no width
        let is_outside = |value: f64| reach > 0.0 && (value < min - reach || value > max + reach);
        predictions.iter().skip(column).step_by(width).any(|value| !value.is_finite() || is_outside(*value))
    })
}

/// Number and indices of runs that have a property, or none.
fn describe_runs(runs: &[usize], test_runs: usize, property: &str) -> Option<String> {
    let first: Vec<String> = runs.iter().take(NAMED_RUNS).map(usize::to_string).collect();
    let more = if runs.len() > NAMED_RUNS { ", ..." } else { "" };
    let (verb, noun) = if runs.len() == 1 { ("is", "run") } else { ("are", "runs") };
    let list = format!("{noun} {}{more}", first.join(", "));
    (!runs.is_empty()).then(|| format!("{} of {test_runs} test runs {verb} {property}: {list}", runs.len()))
}

/// Fraction of a surrogate's tolerance at which its sensitivity is measured. It keeps the error of the solver
/// well below the effect of the perturbation [`OFF`].
const TIGHT: f64 = 1e-2;

fn tight(roll_out: RollOut<'_>) -> RollOut<'_> {
    let tolerance = roll_out.surrogate.program().integration().and_then(Integration::tolerance);
    let tolerance = tolerance.map(|tolerance| (TIGHT * tolerance).max(1e-13));
    RollOut { tolerance, ..roll_out }
}

/// The roll-out along a run, as [`predict`](super::predict), from an initial state perturbed by [`OFF`] in every state.
fn predict_off(surrogate: &Surrogate, evaluator: &Evaluator, run: &Run) -> Vec<f64> {
    tight(RollOut::along(surrogate, evaluator, run).off()).predictions()
}

/// Median and 90 % quantile. What is too large for a number counts as the largest one.
fn quantiles(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len() as f64) * share) as usize).copied().unwrap_or(0.0);
    [at(0.5), at(0.9)].map(|value| if value.is_nan() { f64::MAX } else { value.min(f64::MAX) })
}

/// The largest relative error of the outputs in the first `rows`. The scale is the larger variation of the truth, in
/// these rows or in the first `varying` rows; if the truth does not vary, it is the output's range in training.
fn relative_error(truth: &[f64], found: &[f64], ranges: &[f64], (rows, varying): (usize, usize)) -> f64 {
    let width = ranges.len();
    let of = |column: usize| {
        let values = |of: &[f64], rows| of.iter().skip(column).step_by(width).take(rows).copied().collect::<Vec<_>>();
        let whole = values(truth, varying.max(rows));
        let (truth, found) = (values(truth, rows), values(found, rows));
        let error: f64 = truth.iter().zip(&found).map(|(a, b)| (a - b).powi(2)).sum();
        let error = (error / truth.len().max(1) as f64).sqrt();
        let scales = [&truth, &whole].map(|truth| (varies(truth, ranges[column]), scale(truth, ranges[column])));
        let scale = match scales {
            [(true, first), (true, whole)] => first.max(whole),
            [(false, _), (true, whole)] => whole,
            [(_, first), _] => first,
        };
        if error == 0.0 { 0.0 } else { error / scale }
    };
    worst((0..width).map(of))
}

/// Scale of an output's errors: the standard deviation of the truth or, if it does not vary, the output's range in
/// training.
fn scale(truth: &[f64], range: f64) -> f64 {
    let squares: f64 = deviations(truth).iter().map(|value| value * value).sum();
    match varies(truth, range) {
        true => (squares / truth.len().max(1) as f64).sqrt(),
        false if range > 0.0 => range,
        false => truth.first().map(|value| value.abs()).filter(|size| *size > 0.0).unwrap_or(1.0),
    }
}

fn deviations(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter().map(|value| value - mean).collect()
}

/// Time at which a roll-out diverges whose predictions begin at row `first`; infinite if it does not.
pub(super) fn divergence(run: &Run, found: &[f64], first: usize, ranges: &[f64]) -> f64 {
    let width = ranges.len();
    let of = |column: usize| {
        let values = |of: &[f64]| of.iter().skip(column).step_by(width).skip(first).copied().collect::<Vec<_>>();
        let (truth, found) = (values(&run.outputs), values(found));
        let scale = scale(&truth, ranges[column]);
        // what is not a number has diverged
        let follows = |(a, b): (&f64, &f64)| (a - b).abs() <= DIVERGED * scale;
        let diverged = truth.iter().zip(&found).zip(&run.times[first..]).find(|((a, b), _)| !follows((*a, *b)));
        diverged.map_or(f64::INFINITY, |(_, time)| *time)
    };
    (0..width).map(of).fold(f64::INFINITY, f64::min)
}

/// Change of the energy along the test runs without their inputs.
fn energy_drift(surrogate: &Surrogate, evaluator: &Evaluator, test: &Dataset) -> Option<f64> {
    let motion = surrogate.program().motion()?;
    let dynamics = &motion.dynamics;
    if !dynamics.is_conservative() {
        return None;
    }
    let drift = |run: &Run| {
        let undriven = Run { inputs: vec![0.0; run.inputs.len()], ..run.clone() };
        let mut roll_out = RollOut::along(surrogate, evaluator, &undriven);
        let mut scratch = dynamics.scratch();
        let (mut low, mut high, mut kinetic) = (f64::INFINITY, f64::NEG_INFINITY, 0.0f64);
        for row in 0..run.times.len() {
            if roll_out.go_to(row).is_none() {
                return f64::INFINITY;
            }
            let [total, moving] = roll_out.energies(dynamics, &mut scratch);
            (low, high, kinetic) = (low.min(total), high.max(total), kinetic.max(moving));
        }
        (high - low) / kinetic.max(f64::MIN_POSITIVE)
    };
    Some(test.runs.par_iter().map(drift).reduce(|| 0.0, f64::max).min(f64::MAX))
}

/// Largest deviation of positions from those of the mechanism it was learned from, at the coordinates of the test runs'
/// roll-outs up to where they leave the domain: see [`RollOuts::constraint_residual`]. A configuration that the mechanism cannot have counts as the
/// largest number.
pub fn constraint_residual(surrogate: &Surrogate, assembly: &Assembly, test: &Dataset) -> Option<f64> {
    let motion = surrogate.program().motion()?;
    if !motion.outputs.iter().any(|shown| matches!(shown, Shown::Position(_))) {
        return None;
    }
    let (n, parameters) = (motion.dynamics.coordinates(), motion.dynamics.parameters());
    let (evaluator, domain) = (Evaluator::new(surrogate), Domain::of(surrogate));
    let ranges: Vec<f64> = surrogate.outputs().iter().map(|output| output.max - output.min).collect();
    let of_run = |run: &Run| -> Option<f64> {
        let assembled = assembly.with(&run.parameters[..parameters]).ok()?;
        let mut roll_out = RollOut::along(surrogate, &evaluator, run);
        let mut largest = 0.0f64;
        for row in 0..run.times.len() {
            // a roll-out that ends is reported elsewhere, and so is one that leaves the domain
            let Some((point, results)) = roll_out.at(row).filter(|(point, _)| domain.is_in_ranges(point)) else {
                break;
            };
            for (output, position) in assembled.positions(&point[point.len() - motion.states()..][..n]).ok()? {
                let range = if ranges[output] > 0.0 { ranges[output] } else { 1.0 };
                largest = largest.max((results[output] - position).abs() / range);
            }
        }
        Some(largest)
    };
    Some(test.runs.par_iter().map(|run| of_run(run).unwrap_or(f64::MAX)).reduce(|| 0.0, f64::max))
}

/// A surrogate that follows a run: from its start, by its inputs, which are linear between two rows.
pub struct RollOut<'a> {
    surrogate: &'a Surrogate,
    /// With the parameters of the run.
    evaluator: Evaluator,
    run: &'a Run,
    /// Columns of the inputs in a point.
    inputs: Range<usize>,
    /// Parameters, starts, inputs, states.
    point: Vec<f64>,
    rates: Vec<f64>,
    constant: Vec<f64>,
    /// Outputs and the states' derivatives.
    results: Vec<f64>,
    /// Tolerance of the solver, if not the surrogate's own.
    tolerance: Option<f64>,
    /// Number of steps of the solver so far, and the largest one.
    steps: u64,
    most_steps: u64,
    /// The error that stopped it, if one did.
    failure: Option<StepError>,
}

impl<'a> RollOut<'a> {
    /// Begins at the start of a run. Its parameters are those of the surrogate, the initial values of its states or
    /// outputs, and the values of its inputs before the start, which a model of a single past sample ignores.
    pub fn along(surrogate: &'a Surrogate, evaluator: &Evaluator, run: &'a Run) -> Self {
        let inputs = run.inputs.len() / run.times.len().max(1);
        let first = surrogate.inputs().iter().filter(|input| input.role != Role::Input).count();
        let mut point = run.parameters[..first.min(run.parameters.len())].to_vec();
        point.resize(evaluator.columns(), 0.0);
        // inputs may act directly on outputs
        point[first..first + inputs].copy_from_slice(&run.inputs[..inputs]);
        evaluator.start(&mut point);
        let zeros = vec![0.0; point.len()];
        Self {
            surrogate,
            run,
            inputs: first..first + inputs,
            point,
            rates: zeros.clone(),
            constant: zeros,
            results: vec![0.0; evaluator.results()],
            evaluator: evaluator.clone(),
            tolerance: None,
            steps: 0,
            most_steps: MOST_STEPS + MOST_STEPS_OF_ROW * run.times.len() as u64,
            failure: None,
        }
    }

    /// Sets the tolerance of the solver, where the surrogate's own is not smaller.
    #[must_use]
    pub fn with_tolerance(mut self, tolerance: f64) -> Self {
        self.tolerance = Some(tolerance);
        self
    }

    /// Sets the largest number of steps of the solver, after which the motion counts as one that cannot be computed. A motion that slides
    /// along a jump of its forces would need one without end.
    #[must_use]
    pub fn with_most_steps(mut self, most_steps: u64) -> Self {
        self.most_steps = most_steps;
        self
    }

    /// Perturbs the initial state by [`OFF`] in every state.
    #[must_use]
    pub fn off(mut self) -> Self {
        self.disturb(std::iter::repeat(OFF));
        self
    }

    /// Adds to the states at the row that was reached, or to the past samples of a discrete-time model, the newest first.
    pub fn disturb(&mut self, by: impl Iterator<Item = f64>) {
        self.point[self.inputs.end..].iter_mut().zip(by).for_each(|(state, by)| *state += by);
    }

    /// Number of steps of the solver so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The reason why the motion could not be computed to the last requested row, if the solver knows.
    pub fn failure(&self) -> Option<StepError> {
        self.failure
    }

    /// The outputs at all rows: shape `[times, outputs]`. Values that cannot be computed are NaN.
    pub(super) fn predictions(mut self) -> Vec<f64> {
        let width = self.surrogate.outputs().len();
        let mut predictions = vec![f64::NAN; self.run.times.len() * width];
        for (row, predictions) in predictions.chunks_mut(width).enumerate() {
            let Some((_, results)) = self.at(row) else { break };
            predictions.copy_from_slice(&results[..width]);
        }
        predictions
    }

    /// Goes from the row before to a row: the point there, with inputs and states, and its results; none if the motion cannot be
    /// computed.
    ///
    /// The results at a row that is given are those before it was measured: what an FMU has there.
    pub fn at(&mut self, row: usize) -> Option<(&[f64], &[f64])> {
        self.advance_to(row)?;
        self.evaluator.evaluate(&self.point, &mut self.results);
        self.measure(row);
        Some((&self.point, &self.results))
    }

    /// From the row before to a row; none if the motion cannot be computed.
    fn go_to(&mut self, row: usize) -> Option<()> {
        self.advance_to(row)?;
        self.measure(row);
        Some(())
    }

    fn advance_to(&mut self, row: usize) -> Option<()> {
        if let Some(before) = row.checked_sub(1) {
            let size = self.run.times[row] - self.run.times[before];
            self.go_from(before, row, size)?;
        }
        self.set_inputs(row);
        Some(())
    }

    /// Makes the outputs of a row before the start measured ones.
    fn measure(&mut self, row: usize) {
        let width = self.surrogate.outputs().len();
        // rows before the start tell how the run began; a table to predict may not have them
        let is_given = self.run.times[row] < 0.0 && self.run.outputs.len() > row * width;
        let given = is_given.then(|| &self.run.outputs[row * width..][..width]);
        self.evaluator.measure(&mut self.point, given);
    }

    /// Repeats the whole run `count` times; none if the motion cannot be computed to the end.
    fn repeated(mut self, count: usize) -> Option<()> {
        self.most_steps *= count as u64;
        for _ in 0..count {
            for row in 0..self.run.times.len() {
                self.go_to(row)?;
            }
        }
        Some(())
    }

    fn go_from(&mut self, before: usize, row: usize, size: f64) -> Option<()> {
        let count = self.inputs.len();
        let value = |row: usize, input: usize| self.run.inputs[row * count + input];
        for (input, column) in self.inputs.clone().enumerate() {
            self.rates[column] = (value(row, input) - value(before, input)) / size;
        }
        let drive = Drive { rates: [&self.rates, &self.constant], clamp: None };
        let all = CommunicationStep::of(size);
        let rest = u32::try_from(self.most_steps.saturating_sub(self.steps)).unwrap_or(all.most_steps);
        let step = CommunicationStep { tolerance: self.tolerance, most_steps: rest.min(all.most_steps), ..all };
        match self.evaluator.advance(&mut self.point, step, drive) {
            Ok(steps) => self.steps += u64::from(steps),
            Err(failure) => {
                self.failure = Some(failure);
                return None;
            }
        }
        Some(())
    }

    fn set_inputs(&mut self, row: usize) {
        let inputs = &self.run.inputs[row * self.inputs.len()..][..self.inputs.len()];
        self.point[self.inputs.clone()].copy_from_slice(inputs);
    }

    /// All energy, and the kinetic one.
    fn energies(&self, dynamics: &Dynamics, scratch: &mut metafmu_runtime::DynamicsScratch) -> [f64; 2] {
        let n = dynamics.coordinates();
        let (q, v) = self.point[self.point.len() - 2 * n..].split_at(n);
        let point = |v| metafmu_runtime::StatePoint { q, v, u: &[], p: &self.run.parameters[..dynamics.parameters()] };
        let rest = vec![0.0; n];
        let total = dynamics.energy(point(v), scratch);
        [total, total - dynamics.energy(point(&rest), scratch)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        dynamics::{QuantityRange, Region},
        multibody::Mechanism,
        variable::SourceVariable,
    };
    use metafmu_example as example;
    use std::path::Path;

    /// The crane of [`example::crane`], with a rope that is longer by this factor.
    fn crane(longer: f64) -> Mechanism {
        let text = format!(
            r#"
            parameters.rope = {{ default = 1.5 }}
            bodies.trolley = {{ mass = 2 }}
            bodies.load = {{ mass = 1, position = [0, "-{longer} * rope"], points = {{ top = [0, "{longer} * rope"] }} }}
            joints.rail = {{ type = "prismatic", between = ["ground", "trolley"], axis = [1, 0] }}
            joints.rope = {{ type = "revolute", between = ["trolley", "load.top"] }}
            outputs.x = {{ measure = "rail.position" }}
            outputs.theta = {{ measure = "rope.angle" }}
            outputs.load_x = {{ measure = "load.x" }}
            "#
        );
        Mechanism::parse(&text, Path::new("crane.toml")).unwrap()
    }

    #[test]
    fn a_run_whose_start_decides_all_is_chaotic_and_apart_from_the_regular_ones() {
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let times: std::sync::Arc<[f64]> = (0..=200).map(|row| 0.05 * f64::from(row)).collect();
        // the load hangs, or stands upright on its rope
        let run = |angle: f64| {
            let (parameters, inputs) = (vec![1.2, 0.0, angle, 0.0, 0.0], vec![0.0; times.len()]);
            let run = Run { inputs, parameters, times: times.clone(), outputs: Vec::new() };
            let outputs = RollOut::along(&surrogate, &evaluator, &run).predictions();
            Run { outputs, ..run }
        };
        let mut runs = vec![run(0.8), run(std::f64::consts::PI), run(0.3)];
        let width = surrogate.outputs().len();
        runs[1].outputs[width * 180 + 1] += 17.0;
        runs[2].outputs[width * 180 + 1] += 0.1;
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let parameters = ["rope", "x_start", "theta_start", "speed_start", "rate_start"].map(variable).to_vec();
        let outputs = surrogate.outputs().iter().map(|output| variable(&output.name)).collect();
        let inputs = vec![variable("force")];
        let test = Dataset { inputs, parameters, outputs, runs };
        let accuracy = crate::evaluation::Accuracy::of(&surrogate, &test);
        assert_eq!(accuracy.roll_outs.unwrap().chaotic_runs, [1]);
        let [all, regular] = [&accuracy.outputs["theta"], &accuracy.regular_outputs["theta"]];
        assert!((all.max_abs_error - 17.0).abs() < 1e-12 && all.worst_run == 1, "{all:?}");
        assert!((regular.max_abs_error - 0.1).abs() < 1e-12 && regular.worst_run == 2, "{regular:?}");
        assert!((regular.mse / (0.01 / 402.0) - 1.0).abs() < 1e-9, "{regular:?}");
    }

    #[test]
    fn a_run_that_ends_with_an_error_has_failed_and_is_not_chaotic() {
        let surrogate = example::crane();
        let times: std::sync::Arc<[f64]> = (0..=20).map(|row| 0.05 * f64::from(row)).collect();
        let width = surrogate.outputs().len();
        // without a rope there is no mass matrix
        let run = |rope: f64| Run {
            inputs: vec![0.0; times.len()],
            parameters: vec![rope, 0.0, 0.8, 0.0, 0.0],
            times: times.clone(),
            outputs: vec![0.5; times.len() * width],
        };
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let parameters = ["rope", "x_start", "theta_start", "speed_start", "rate_start"].map(variable).to_vec();
        let outputs = surrogate.outputs().iter().map(|output| variable(&output.name)).collect();
        let runs = vec![run(1.2), run(0.0), run(1.5)];
        let test = Dataset { inputs: vec![variable("force")], parameters, outputs, runs };
        let accuracy = crate::evaluation::Accuracy::of(&surrogate, &test);
        let RollOuts { chaotic_runs, diverged_runs, .. } = accuracy.roll_outs.unwrap();
        assert!(chaotic_runs.is_empty() && diverged_runs == [1] && accuracy.regular_outputs.is_empty());
        assert_eq!(accuracy.outputs["theta"].worst_run, 1);
    }

    #[test]
    fn a_motion_that_leaves_all_bounds_diverges_and_is_not_chaotic() {
        // the trolley has a range of 5 m in both directions
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let times: std::sync::Arc<[f64]> = (0..=200).map(|row| 0.05 * f64::from(row)).collect();
        let run = |speed: f64| {
            let (parameters, inputs) = (vec![1.2, 0.0, std::f64::consts::PI, speed, 0.0], vec![0.0; times.len()]);
            let run = Run { inputs, parameters, times: times.clone(), outputs: Vec::new() };
            let outputs = RollOut::along(&surrogate, &evaluator, &run).predictions();
            Run { outputs, ..run }
        };
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let parameters = ["rope", "x_start", "theta_start", "speed_start", "rate_start"].map(variable).to_vec();
        let outputs = surrogate.outputs().iter().map(|output| variable(&output.name)).collect();
        // the truth stays where it is in the second run, and is as far away in the third
        let mut runs = vec![run(0.0), run(100.0), run(100.0)];
        runs[1].outputs.fill(0.5);
        let test = Dataset { inputs: vec![variable("force")], parameters, outputs, runs };
        let roll_outs = crate::evaluation::Accuracy::of(&surrogate, &test).roll_outs.unwrap();
        assert_eq!(roll_outs.diverged_runs, [1]);
        assert!(roll_outs.chaotic_runs.contains(&0) && !roll_outs.chaotic_runs.contains(&1), "{roll_outs:?}");
        let half = RollOuts { chaotic_runs: vec![0], ..roll_outs };
        assert!(half.is_chaotic(2) && !half.is_chaotic(3));
    }

    #[test]
    fn a_roll_out_ends_at_its_largest_number_of_steps() {
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let times: std::sync::Arc<[f64]> = (0..=100).map(|row| 0.05 * f64::from(row)).collect();
        let inputs = vec![0.0; times.len()];
        let run = Run { inputs, parameters: vec![1.2, 0.0, 0.8, 0.0, 0.0], times, outputs: Vec::new() };
        let mut whole = RollOut::along(&surrogate, &evaluator, &run);
        assert!((0..=100).all(|row| whole.at(row).is_some()));
        let half = whole.steps() / 2;
        let mut limited = RollOut::along(&surrogate, &evaluator, &run).with_most_steps(half);
        let rows = (0..=100).take_while(|row| limited.at(*row).is_some()).count();
        assert!((30..70).contains(&rows) && limited.steps() <= half, "{rows} rows");
        assert_eq!(limited.failure(), Some(StepError::TooManySteps));
    }

    #[test]
    fn the_residual_is_how_far_positions_are_from_those_of_the_mechanism() {
        let surrogate = example::crane();
        let times: std::sync::Arc<[f64]> = (0..=40).map(|row| 0.05 * f64::from(row)).collect();
        let (parameters, inputs) = (vec![1.2, 0.0, 0.8, 0.0, 0.0], vec![0.0; times.len()]);
        let test = Dataset {
            inputs: vec![SourceVariable::new("force", "N", "")],
            parameters: Vec::new(),
            outputs: Vec::new(),
            runs: vec![Run { inputs, parameters, times, outputs: Vec::new() }],
        };
        let region = Region {
            coordinates: vec![
                QuantityRange::new("rail.position", -5.0, 5.0),
                QuantityRange::new("rope.angle", -3.0, 3.0),
            ],
            parameters: vec![QuantityRange::new("rope", 1.0, 2.0)],
            outputs: ["x", "theta", "load_x"].map(String::from).into(),
            ..Region::default()
        };
        let residual = |mechanism: &Mechanism| {
            constraint_residual(&surrogate, &Assembly::new(mechanism, &region).unwrap(), &test).unwrap()
        };
        assert!(residual(&crane(1.0)) < 1e-14);
        // it begins at its largest angle
        let load = &surrogate.outputs()[2];
        let expected = 0.01 * 1.2 * f64::sin(0.8) / (load.max - load.min);
        let found = residual(&crane(1.01));
        assert!((found / expected - 1.0).abs() < 0.01, "{found:e} {expected:e}");
    }
}
