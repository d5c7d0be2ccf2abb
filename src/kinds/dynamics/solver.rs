//! Chooses how the solver inside the FMU integrates states, and measures its error where the integration is hardest.

use super::corners::{IntegrationTrial, corners};
use crate::{
    Result,
    dataset::{Dataset, Run},
    diagnostics::numbers::power,
    evaluation::{OFF, RollOut},
    kinds::record::{ImplicitCost, POOR, SolverRecord},
    project::Project,
    source::driven::Driven,
    surrogate,
    worst::worst,
};
use metafmu_runtime::{Domain, Evaluator, Integration, Metadata, Output, StepError, Surrogate};
use rayon::prelude::*;

/// Smallest and largest wanted error: a perturbation of the initial state in rad or m, rad/s or m/s. The smallest
/// applies if the equations are exact.
const LEAST_ERROR: f64 = 3e-8;
const LARGEST_ERROR: f64 = 1e-5;
/// Part of the error of the equations that the solver may add.
const PART: f64 = 0.1;
/// Tolerances that are tried: the first one, the last one, and the reference of the others.
const FIRST: f64 = 1e-6;
const LAST: f64 = 1e-12;
const REFERENCE: f64 = 1e-13;
/// Steps of the reference between two rows, at least: it must find narrow forces that another integration may step over.
const REFERENCE_STEPS: f64 = 32.0;
/// By how much a tolerance is reduced at once, at most.
const BY_ONE_ROUND: f64 = 1e-3;
/// Largest number of steps of the solver in a run; later steps are not compared.
const MOST_STEPS: u64 = 100_000;
/// How often the longest step is halved, at most, for fewer steps that are repeated.
const HALVINGS: i32 = 6;
/// Steps of the explicit method between two rows of a run above which the implicit one is tried.
const MANY_STEPS: f64 = 20.0;
/// Part of the explicit method's evaluations below which the implicit one is chosen.
const CHEAPER: f64 = 0.5;
/// Largest velocity of a coordinate that hardly moves, in rad/s or m/s.
const SLOWEST: f64 = 1e-3;
/// Safety factor on the wanted error, for motions between the corners, such as one that nearly comes to rest upright.
const RESERVE: f64 = 3.0;
/// Factor by which velocities may exceed those of the training runs.
const MARGIN: f64 = 1.5;

/// Record for equations so poor that no solver helps.
pub(super) fn unmeasured(step: f64) -> SolverRecord {
    SolverRecord {
        tolerance: Some(FIRST),
        step,
        implicit: None,
        error: f64::MAX,
        wanted: LARGEST_ERROR,
        runs: [0; 2],
        worst: String::new(),
        steps_per_second: [0.0; 2],
        slowest: String::new(),
    }
}

/// A roll-out along a run.
struct Path {
    outputs: Vec<f64>,
    /// Rows up to where a state leaves the domain, or the motion cannot be computed.
    rows: usize,
    steps: u64,
    /// Simulated time, in seconds.
    seconds: f64,
    failure: Option<StepError>,
}

/// Reference that solvers are compared with.
struct SolverReference {
    path: Path,
    /// Largest change up to each row by an initial state perturbed by [`OFF`], at least [`OFF`].
    by_start: Vec<f64>,
}

/// Ranges of velocities and actuator states, the columns `velocities` of the states. They are [`MARGIN`] times the
/// largest magnitudes in the training runs, in both directions, unless the study gives them, and contain the ranges of
/// all initial values.
pub(super) fn velocity_ranges(
    project: &Project,
    surrogate: &Surrogate,
    runs: &[Run],
    velocities: std::ops::Range<usize>,
) -> Vec<[f64; 2]> {
    let evaluator = Evaluator::new(surrogate);
    let first = surrogate.inputs().len();
    let reached = runs.par_iter().map(|run| {
        let mut roll_out = RollOut::along(surrogate, &evaluator, run);
        let mut largest = vec![0.0f64; velocities.len()];
        for row in 0..run.times.len() {
            let Some((point, _)) = roll_out.at(row) else { break };
            let values = &point[first..][velocities.clone()];
            largest.iter_mut().zip(values).for_each(|(largest, value)| *largest = largest.max(value.abs()));
        }
        largest
    });
    let reached: Vec<Vec<f64>> = reached.collect();
    let options = project.study.states.values();
    let range = |(k, state): (usize, &crate::study::StateOptions)| {
        let largest = reached.iter().map(|largest| MARGIN * largest[k]).fold(SLOWEST, f64::max);
        let is_actuator_state = k >= project.study.coordinates().count();
        let (own, start) = match is_actuator_state {
            true => (state.range(), state.start),
            false => (state.velocity_range, state.velocity),
        };
        let [min, max] = own.unwrap_or([-largest, largest]);
        let [low, high] = start.unwrap_or([min, max]);
        [min.min(low), max.max(high)]
    };
    options.enumerate().map(range).collect()
}

/// The surrogate with the integration that the study wants. It is fixed steps, or the largest tolerance whose error, in
/// the training runs and at the corners, is below a tenth of the error of the equations. `assemble` makes the surrogate
/// with an integration. `velocities` has the range of each state that is a velocity with one.
pub(super) fn choose(
    project: &Project,
    dataset: &Dataset,
    (driven, velocities): (&Driven, &[Option<[f64; 2]>]),
    of_equations: f64,
    assemble: impl Fn(Integration) -> Result<Surrogate>,
) -> Result<(Surrogate, SolverRecord)> {
    let study = &project.study;
    let wanted = (PART * of_equations).clamp(LEAST_ERROR, LARGEST_ERROR);
    let largest = study.time.step;
    let rows = dataset.runs.iter().map(|run| run.times.len()).max().unwrap_or(1);
    let between_rows = REFERENCE_STEPS.min(0.5 * MOST_STEPS as f64 / rows as f64).max(1.0);
    let longest = largest / between_rows;
    let reference = assemble(Integration::ErrorControlled { tolerance: REFERENCE, longest })?;
    let training = dataset.runs.iter().enumerate();
    let training =
        training.map(|(index, run)| IntegrationTrial { run: run.clone(), name: format!("training run {index}") });
    let mut trials: Vec<IntegrationTrial> = training.collect();
    trials.extend(corners(study, driven, &dataset.runs, velocities, &reference));
    let measure = IntegrationComparison::new(&reference, trials, dataset.runs.len());
    let record = match study.dynamics.solver_step {
        Some(step) => {
            let record = measure.record(Integration::Fixed { step }, wanted);
            if let Some(message) = measure.problem_of_steps(step, &record) {
                return Err(study.refusal("dynamics.solver_step", message));
            }
            record
        }
        None => {
            let (integration, implicit) = measure.chosen(largest, wanted);
            SolverRecord { implicit, ..measure.record(integration, wanted) }
        }
    };
    let program = reference.program().clone().with_integration(record.integration());
    let metadata = Metadata { solver_error: Some(record.error), ..reference.metadata().clone() };
    let surrogate = Surrogate::new(metadata, program);
    let surrogate = surrogate::seal(surrogate.map_err(|source| crate::Error::Surrogate { source })?)?;
    Ok((surrogate, record))
}

/// Comparison of integrations.
struct IntegrationComparison<'a> {
    surrogate: &'a Surrogate,
    evaluator: Evaluator,
    domain: Domain,
    trials: Vec<IntegrationTrial>,
    /// Number of those that are training runs, which come first.
    training: usize,
    references: Vec<SolverReference>,
}

impl<'a> IntegrationComparison<'a> {
    fn new(surrogate: &'a Surrogate, trials: Vec<IntegrationTrial>, training: usize) -> Self {
        let mut measure = Self {
            surrogate,
            evaluator: Evaluator::new(surrogate),
            domain: Domain::of(surrogate),
            trials,
            training,
            references: Vec::new(),
        };
        let reference = |trial: &IntegrationTrial| {
            let along = || RollOut::along(surrogate, &measure.evaluator, &trial.run);
            let domain = Some(&measure.domain);
            let path = measure.follow(along(), &trial.run, trial.run.times.len(), domain);
            let off = measure.follow(along().off(), &trial.run, path.rows, domain);
            let mut largest = OFF;
            let changes = changes(surrogate, &path.outputs, &off.outputs).into_iter();
            let by_start = changes.map(|change| {
                largest = if change.is_finite() { largest.max(change) } else { largest };
                largest
            });
            SolverReference { by_start: by_start.collect(), path }
        };
        measure.references = measure.trials.par_iter().map(reference).collect();
        measure
    }

    /// Follows a run up to a row, or to where it leaves a domain.
    fn follow(&self, mut roll_out: RollOut, run: &Run, rows: usize, domain: Option<&Domain>) -> Path {
        let (first, width) = (self.surrogate.inputs().len(), self.surrogate.outputs().len());
        let (mut outputs, mut found) = (vec![f64::NAN; rows * width], 0);
        roll_out = roll_out.with_most_steps(MOST_STEPS);
        for row in 0..rows {
            let Some((point, results)) = roll_out.at(row) else { break };
            let is_inside = |domain: &Domain| (first..point.len()).all(|column| domain.contains(column, point[column]));
            if !domain.is_none_or(is_inside) {
                break;
            }
            outputs[row * width..][..width].copy_from_slice(&results[..width]);
            found = row + 1;
        }
        let seconds = found.checked_sub(1).map_or(0.0, |row| run.times[row] - run.times[0]);
        // a run of many steps ends earlier, which is no failure
        let failure = roll_out.failure().filter(|failure| *failure != StepError::TooManySteps);
        Path { outputs, rows: found, steps: roll_out.steps(), seconds, failure }
    }

    /// All runs with an integration, up to where those that they are compared with leave the domain.
    fn paths(&self, integration: Integration, trials: usize) -> Vec<Path> {
        let evaluator = self.evaluator.with_integration(integration);
        let pairs = self.trials[..trials].par_iter().zip(&self.references);
        pairs
            .map(|(trial, reference)| {
                let along = RollOut::along(self.surrogate, &evaluator, &trial.run);
                self.follow(along, &trial.run, reference.path.rows, None)
            })
            .collect()
    }

    /// Perturbation of the initial state that changes the outputs of a run as much as this integration does. It is
    /// [`OFF`] times the largest ratio, over the rows, of two changes: that by the integration, and the largest so far
    /// by an initial state perturbed by [`OFF`]. Changes are relative to the outputs' ranges.
    fn error(&self, trial: usize, path: &Path) -> f64 {
        let SolverReference { path: reference, by_start } = &self.references[trial];
        let width = self.surrogate.outputs().len();
        let rows = path.rows;
        if rows < reference.rows && path.failure.is_some() {
            return f64::INFINITY;
        }
        let changes = changes(self.surrogate, &reference.outputs[..rows * width], &path.outputs[..rows * width]);
        let error = worst(changes.iter().zip(by_start).map(|(change, by_start)| OFF * change / by_start));
        if error.is_nan() { f64::INFINITY } else { error }
    }

    fn errors(&self, paths: &[Path]) -> Vec<f64> {
        paths.par_iter().enumerate().map(|(trial, path)| self.error(trial, path)).collect()
    }

    /// The integration that takes the fewest evaluations, and the cost of the implicit method if that is it.
    fn chosen(&self, largest: f64, wanted: f64) -> (Integration, Option<ImplicitCost>) {
        let explicit = |tolerance: f64| Integration::ErrorControlled { tolerance, longest: largest };
        let implicit = |tolerance: f64| Integration::Implicit { tolerance, longest: largest };
        let rough = self.paths(explicit(FIRST), self.trials.len());
        if rough.iter().any(|path| path.steps as f64 > MANY_STEPS * path.rows as f64) {
            let first = self.paths(implicit(FIRST), self.trials.len());
            let (tolerance, error, paths) = self.largest_tolerance(&implicit, first, wanted);
            let cost = ImplicitCost {
                evaluations: self.evaluations_per_second(implicit(tolerance), &paths),
                explicit: self.evaluations_per_second(explicit(FIRST), &rough),
            };
            if error <= wanted && cost.evaluations < CHEAPER * cost.explicit {
                return (implicit(tolerance), Some(cost));
            }
        }
        let (tolerance, ..) = self.largest_tolerance(&explicit, rough, wanted);
        let evaluations = |longest: f64| -> u64 {
            let paths = self.paths(Integration::ErrorControlled { tolerance, longest }, self.training);
            paths.iter().map(|path| 6 * path.steps + path.rows as u64).sum()
        };
        let longest = (0..=HALVINGS).map(|halvings| largest * 0.5f64.powi(halvings));
        let longest =
            longest.map(|longest| (evaluations(longest), longest)).min_by_key(|(evaluations, _)| *evaluations);
        let longest = longest.map_or(largest, |(_, longest)| longest);
        (Integration::ErrorControlled { tolerance, longest }, None)
    }

    /// The largest tolerance that is good enough with a reserve, its error, and the runs with it; `paths` are those with the [`FIRST`] one.
    fn largest_tolerance(
        &self,
        integration: &dyn Fn(f64) -> Integration,
        mut paths: Vec<Path>,
        wanted: f64,
    ) -> (f64, f64, Vec<Path>) {
        let mut tolerance = FIRST;
        let wanted = wanted / RESERVE;
        loop {
            let error = self.errors(&paths).into_iter().fold(0.0, f64::max);
            if error <= wanted || tolerance <= LAST {
                return (tolerance, error, paths);
            }
            // the error is about proportional to it
            tolerance = rounded((tolerance * (wanted / error).max(BY_ONE_ROUND)).min(0.5 * tolerance)).max(LAST);
            paths = self.paths(integration(tolerance), self.trials.len());
        }
    }

    /// Evaluations of the equations in a second of simulated time; systems of linear equations count as some.
    fn evaluations_per_second(&self, integration: Integration, paths: &[Path]) -> f64 {
        let states = self.surrogate.states().len() as f64;
        let of_step = if integration.is_implicit() { 9.0 + 1.5 * states } else { 6.0 };
        let evaluations: f64 = paths.iter().map(|path| of_step * path.steps as f64 + path.rows as f64).sum();
        evaluations / paths.iter().map(|path| path.seconds).sum::<f64>().max(f64::MIN_POSITIVE)
    }

    fn record(&self, integration: Integration, wanted: f64) -> SolverRecord {
        let paths = self.paths(integration, self.trials.len());
        let errors = self.errors(&paths);
        let rates: Vec<f64> = paths.iter().map(|path| path.steps as f64 / path.seconds).collect();
        let name_of = |values: &[f64]| {
            let finite = values.iter().enumerate().filter(|(_, value)| !value.is_nan());
            let most = finite.max_by(|a, b| a.1.total_cmp(b.1)).map(|(trial, value)| (*value, trial));
            most.map_or((0.0, String::new()), |(value, trial)| (value, self.trials[trial].name.clone()))
        };
        let mut of_training: Vec<f64> =
            rates[..self.training].iter().copied().filter(|rate| rate.is_finite()).collect();
        of_training.sort_by(f64::total_cmp);
        let median = of_training.get(of_training.len() / 2).copied().unwrap_or(0.0);
        // a run that leaves the domain at once says nothing
        let rates: Vec<f64> = rates.into_iter().map(|rate| if rate.is_finite() { rate } else { f64::NAN }).collect();
        let ((error, worst), (most, slowest)) = (name_of(&errors), name_of(&rates));
        SolverRecord {
            tolerance: integration.tolerance(),
            step: integration.longest(),
            implicit: None,
            error: error.min(f64::MAX),
            wanted,
            runs: [self.training, self.trials.len() - self.training],
            worst,
            steps_per_second: [median, most],
            slowest,
        }
    }

    /// Problem of fixed steps, if there is one.
    fn problem_of_steps(&self, step: f64, record: &SolverRecord) -> Option<String> {
        if record.error <= POOR {
            return None;
        }
        let paths = self.paths(Integration::Fixed { step }, self.trials.len());
        let trial = self.trials.iter().position(|trial| trial.name == record.worst)?;
        let why = match paths[trial].failure {
            Some(StepError::Implausible { state, value, after: _ }) => {
                format!("is unstable: {} comes to {value:.1e}", self.surrogate.states()[state].name)
            }
            Some(_) => "is unstable".into(),
            None => {
                let error = power(record.error, 1);
                format!("has the effect of an initial state perturbed by {error}, expected at most {POOR}")
            }
        };
        Some(format!(
            "{step} s {why}, in a run with {}; take a shorter step, or leave it out for error control",
            record.worst
        ))
    }
}

/// A tolerance of one or three in the first digit that is not larger.
fn rounded(tolerance: f64) -> f64 {
    let exponent = (tolerance * (1.0 + 1e-9)).log10().floor();
    let parsed = |digit: u8| format!("{digit}e{exponent}").parse().unwrap_or(tolerance);
    let three: f64 = parsed(3);
    if three <= tolerance * (1.0 + 1e-9) { three } else { parsed(1) }
}

/// Largest difference of any output at each row, relative to its range; infinite for NaN.
fn changes(surrogate: &Surrogate, one: &[f64], other: &[f64]) -> Vec<f64> {
    let range = |output: &Output| (output.max - output.min).max(f64::MIN_POSITIVE);
    let ranges: Vec<f64> = surrogate.outputs().iter().map(range).collect();
    let at_row = |(one, other): (&[f64], &[f64])| {
        let changes = one.iter().zip(other).zip(&ranges).map(|((one, other), range)| (one - other).abs() / range);
        changes.fold(0.0, |largest, change| if change.is_nan() { f64::INFINITY } else { change.max(largest) })
    };
    one.chunks(ranges.len()).zip(other.chunks(ranges.len())).map(at_row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_rounded_down_to_one_or_three() {
        for (tolerance, expected) in [(1e-6, 1e-6), (2.9e-8, 1e-8), (3e-8, 3e-8), (9.9e-10, 3e-10), (1e-12, 1e-12)] {
            assert_eq!(rounded(tolerance), expected);
        }
    }
}
