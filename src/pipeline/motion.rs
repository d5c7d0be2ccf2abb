//! Learns equations of motion from a mechanism.

use super::{
    learned::{self, Candidate},
    motion_networks::{Learned, learn},
    project::Project,
    train::{Trained, TrainingRecord},
};
use crate::{
    Result,
    dataset::{Dataset, Run},
    dynamics::FittedReactions,
    evaluation::{OFF, predict_all, predict_off},
    source::{Source, driven::Driven},
    surrogate,
};
use metafmu_runtime::{Evaluator, Model, Motion, Output, Surrogate};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What was learned of the equations of motion of a mechanism.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MotionRecord {
    /// Highest harmonic of the angles in the dictionary, which is found by least squares.
    pub harmonics: usize,
    /// Highest power of the other coordinates and of the parameters.
    pub powers: usize,
    /// Products of sines, cosines and powers with a coefficient: those of the equations of motion and of the positions.
    pub products: [usize; 2],
    /// Largest error of any function of the dictionary at unseen configurations, relative to the largest value of the function.
    pub error: f64,
    /// Of the forces of joints and springs among the outputs, which have a dictionary of their own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reactions: Option<ReactionRecord>,
    /// Of forces that are not linear in the velocities, which a network gives: root mean square error at unseen states, relative to their
    /// standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_error: Option<f64>,
    /// The ways to learn the equations that were compared, the best first; none if the dictionary is exact.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub candidates: Vec<Candidate>,
    /// The one that is exported: `dictionary`, `network` or `dictionary and network`.
    #[serde(default = "dictionary")]
    pub exported: String,
    /// Largest step of the solver, in seconds.
    pub solver_step: f64,
    /// Error of a start, in all states, that changes the outputs of a training run as much as halving that step does.
    pub solver_error: f64,
}

/// What was learned of forces of joints and springs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReactionRecord {
    /// Highest harmonic of the angles.
    pub harmonics: usize,
    /// Highest power of the other coordinates and of the parameters.
    pub powers: usize,
    /// Products of sines, cosines and powers with a coefficient.
    pub products: usize,
    /// Largest error of any function at unseen configurations, relative to its largest value.
    pub error: f64,
}

/// Error of a function, relative to its largest value, from which on the equations are not those of the mechanism; with networks that of
/// the accelerations, relative to their standard deviation.
const POOR: f64 = 0.01;

fn dictionary() -> String {
    learned::DICTIONARY.into()
}

impl MotionRecord {
    /// What is wrong with the equations.
    pub(super) fn problem(&self) -> Option<String> {
        self.problem_of_equations().or_else(|| self.problem_of_reactions())
    }

    fn problem_of_reactions(&self) -> Option<String> {
        let reactions = self.reactions.as_ref()?;
        // also of what is not a number
        let is_good = reactions.error <= POOR;
        (!is_good).then(|| {
            format!(
                "the learned forces of joints, drivers and springs are off by {:.1e} of their largest value at unseen configurations, expected \
                 at most {POOR}: they are no sums of sines, cosines and powers, or the ranges are too wide",
                reactions.error
            )
        })
    }

    fn problem_of_equations(&self) -> Option<String> {
        if let Some(exported) = self.candidates.iter().find(|candidate| candidate.name == self.exported) {
            // also of what is not a number
            let is_good = exported.error <= POOR;
            return (!is_good).then(|| {
                format!(
                    "the learned accelerations or positions are off by {:.1e} of their standard deviation at unseen states, expected \
                     at most {POOR}: more `sampling.states`, smaller ranges or a larger network may help",
                    exported.error
                )
            });
        }
        (self.error > POOR).then(|| {
            format!(
                "the learned equations of motion are off by {:.1e} of their largest value at unseen configurations, expected at most \
                 {POOR}: they are no sums of sines, cosines and powers, or the ranges are too wide",
                self.error
            )
        })
    }

    /// How it went, in words.
    pub(super) fn describe(&self) -> String {
        let Self { harmonics, powers, products: [equations, positions], error, solver_step, .. } = self;
        let Self { candidates, exported, reactions, force_error, .. } = self;
        let reactions = reactions.as_ref().map_or(String::new(), |ReactionRecord { harmonics, powers, products, error }| {
            format!(
                "; forces of joints, drivers and springs: harmonics up to {harmonics}, powers up to {powers}, {products} products, error \
                 {error:.1e}"
            )
        });
        let forces = force_error.map_or(String::new(), |error| {
            format!("; a network for forces that are not linear in the velocities, error {error:.1e} at unseen states")
        });
        let compared = match candidates.as_slice() {
            [] => String::new(),
            candidates => format!(
                "; error of the accelerations at unseen states: {}; exported: {exported}",
                learned::list(candidates)
            ),
        };
        format!(
            "least squares: harmonics up to {harmonics}, powers up to {powers}, {equations} products in the equations and {positions} \
             in positions, error {error:.1e} at unseen configurations{reactions}{forces}{compared}; solver steps of {solver_step} s"
        )
    }
}

/// Error of a start, in rad or m, rad/s or m/s, that may change the outputs of a run as much as halving the solver's step does.
const SOLVER_ERROR: f64 = 3e-8;
/// What halving divides the error by, once it is so small.
const BY_HALVING: f64 = 16.0;
const ASYMPTOTIC: f64 = 1e-6;
/// Steps of the solver in a run at most.
const MOST_STEPS: f64 = 1e6;

/// Learns the equations of motion, chooses the solver's step by roll-outs along the training runs.
pub(super) fn train(project: &Project, dataset: &Dataset) -> Result<Trained> {
    let study = &project.study;
    let Source::Simulation(simulation) = &project.source else {
        return Err(study.refusal("source", "recorded runs cannot be asked for their equations of motion"));
    };
    let (Some(driven), Some(mechanism)) = (simulation.driven(), study.mechanism()) else {
        return Err(study.refusal("source", "expected a mechanism"));
    };
    let region = driven.region().ok_or_else(|| study.refusal("source", "expected a mechanism"))?;
    let began = Instant::now();
    let learned = learn(project, dataset, (mechanism, driven, region))?;
    for driver in driven.drivers().iter().enumerate().filter(|(index, _)| !learned.dynamics.is_driven_by(*index)) {
        project.warn(format_args!("input {} acts on nothing", driver.1.variable.name));
    }
    let with_step = |step: f64| assemble(project, dataset, driven, &learned, step);
    let (surrogate, solver_step, solver_error) = choose_step(dataset, study.time.step, with_step)?;
    let Learned { fitted, dynamics, positions, rows, .. } = &learned;
    let motion = MotionRecord {
        harmonics: fitted.order[0],
        powers: fitted.order[1],
        products: [dynamics.law().dictionary().products(), positions.dictionary().products()],
        error: fitted.error,
        reactions: fitted.reactions.as_ref().map(|FittedReactions { reactions, order, error }| ReactionRecord {
            harmonics: order[0],
            powers: order[1],
            products: reactions.functions().products(),
            error: *error,
        }),
        force_error: learned.force_error,
        candidates: learned.candidates.clone(),
        exported: learned.exported.clone(),
        solver_step,
        solver_error,
    };
    let record = TrainingRecord {
        train_rows: *rows,
        validation_runs: 0,
        epochs: learned.history.len(),
        best_epoch: learned.best_epoch,
        stopped: learned.stopped,
        train_seconds: began.elapsed().as_secs_f64(),
        added_runs: 0,
        target_met: None,
        motion: Some(motion.clone()),
        state_space: None,
        trajectories: None,
        discrete: None,
    };
    project.finish(format_args!(
        "learned equations of motion from {rows} configurations in {:.1} s by {}",
        record.train_seconds,
        motion.describe()
    ));
    Ok(Trained { surrogate, history: learned.history, record })
}

fn assemble(project: &Project, dataset: &Dataset, driven: &Driven, learned: &Learned, step: f64) -> Result<Surrogate> {
    let Learned { fitted, dynamics, positions, velocities, rows, .. } = learned;
    let motion = Motion {
        dynamics: dynamics.clone(),
        positions: positions.clone(),
        windings: fitted.windings.clone(),
        reactions: fitted.reactions.as_ref().map(|fitted| fitted.reactions.clone()),
        outputs: fitted.outputs.clone(),
        step,
    };
    let ranges = project.study.states.iter().enumerate().map(|(column, (name, options))| {
        let is_limited = motion.depends_on(column) && !options.goes_around(name);
        is_limited.then_some([options.min, options.max])
    });
    let of_velocities = (0..dynamics.coordinates())
        .map(|column| velocities.as_ref().filter(|_| dynamics.extrapolates(column)).map(|ranges| ranges[column]));
    let ranges: Vec<Option<[f64; 2]>> = ranges.chain(of_velocities).collect();
    let model = Model::Motion(Box::new(motion));
    surrogate::assemble_with_states(&project.study, (dataset, *rows), (driven, &ranges), model)
}

/// The surrogate with the largest step, of `largest` and what halving gives, that is small enough, and its error. Errors of the solver
/// grow with those of the start, so that both are compared along the whole runs: no step is small enough for a chaotic motion's end.
pub(super) fn choose_step(
    dataset: &Dataset,
    largest: f64,
    with_step: impl Fn(f64) -> Result<Surrogate>,
) -> Result<(Surrogate, f64, f64)> {
    let ends = dataset.runs.iter().filter_map(|run| run.times.last());
    let smallest = ends.copied().fold(0.0, f64::max) / MOST_STEPS;
    let mut step = largest;
    let mut surrogate = with_step(step)?;
    let mut rolled_out = predict_all(&surrogate, dataset);
    loop {
        let finer = with_step(0.5 * step)?;
        let rolled_out_finer = predict_all(&finer, dataset);
        let evaluator = Evaluator::new(&surrogate);
        let runs = dataset.runs.par_iter().zip(&rolled_out).zip(&rolled_out_finer);
        let errors = runs.map(|((run, one), finer)| start_error(&surrogate, &evaluator, run, [one, finer]));
        let error = errors.reduce(|| 0.0, f64::max);
        if error <= ASYMPTOTIC {
            // the method has order 4, so that the shortest steps, which take the most time, need not be tried
            let further = (error / SOLVER_ERROR).max(1.0).log(BY_HALVING).ceil();
            let (step, error) = (step / further.exp2(), error / BY_HALVING.powf(further));
            return Ok((with_step(step)?, step, error));
        }
        if 0.25 * step < smallest {
            return Ok((surrogate, step, error));
        }
        (surrogate, step, rolled_out) = (finer, 0.5 * step, rolled_out_finer);
    }
}

/// The error of a start that changes the outputs of a run as much as a finer step does: the largest, over the rows, of their change over
/// the largest one so far by a start that is off by [`OFF`], times that. Changes are relative to the outputs' ranges, and those by the start
/// count as [`OFF`] at least.
fn start_error(surrogate: &Surrogate, evaluator: &Evaluator, run: &Run, [one, finer]: [&Vec<f64>; 2]) -> f64 {
    let changes = changes(surrogate, one, finer);
    let largest = changes.iter().copied().fold(0.0, f64::max);
    if largest <= SOLVER_ERROR {
        return largest;
    }
    let by_start = self::changes(surrogate, one, &predict_off(surrogate, evaluator, run));
    let mut so_far = OFF;
    let errors = changes.iter().zip(by_start).map(|(change, by_start)| {
        so_far = so_far.max(by_start);
        OFF * change / so_far
    });
    // a maximum would leave out what is not a number
    errors.fold(0.0, |largest, error| if error.is_nan() { f64::INFINITY } else { error.max(largest) })
}

/// Largest difference of any output at each row, relative to its range; infinite if it is not a number.
fn changes(surrogate: &Surrogate, one: &[f64], other: &[f64]) -> Vec<f64> {
    let range = |output: &Output| (output.max - output.min).max(f64::MIN_POSITIVE);
    let ranges: Vec<f64> = surrogate.outputs().iter().map(range).collect();
    let at_row = |(one, other): (&[f64], &[f64])| {
        let changes = one.iter().zip(other).zip(&ranges).map(|((one, other), range)| (one - other).abs() / range);
        changes.fold(0.0, |largest, change| if change.is_nan() { f64::INFINITY } else { change.max(largest) })
    };
    one.chunks(ranges.len()).zip(other.chunks(ranges.len())).map(at_row).collect()
}
