//! Learns equations of motion from a mechanism.

use super::{project::Project, rescue, train::TrainingRecord};
use crate::{
    Result,
    dataset::Dataset,
    dynamics::{Fitted, fit},
    evaluation::predict_all,
    files,
    source::{Source, driven::Driven},
    surrogate,
    training::{StopReason, write_history},
};
use metafmu_runtime::{Motion, Surrogate};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What was found by least squares.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MotionRecord {
    /// Highest harmonic of the angles.
    pub harmonics: usize,
    /// Highest power of the other coordinates and of the parameters.
    pub powers: usize,
    /// Products of sines, cosines and powers with a coefficient: those of the equations of motion and of the positions.
    pub products: [usize; 2],
    /// Largest error of any function at unseen configurations, relative to the largest value of the function.
    pub error: f64,
    /// Largest step of the solver, in seconds.
    pub solver_step: f64,
    /// What halving that step changes in the outputs of the training runs, relative to the outputs' ranges.
    pub solver_error: f64,
}

/// Error of a function, relative to its largest value, from which on the equations are not those of the mechanism.
const POOR: f64 = 0.01;

impl MotionRecord {
    /// What is wrong with the equations.
    pub(super) fn problem(&self) -> Option<String> {
        (self.error > POOR).then(|| {
            format!(
                "the learned equations of motion are off by {:.1e} of their largest value at unseen configurations, expected at most \
                 {POOR}: they are no sums of sines, cosines and powers, or the ranges are too wide",
                self.error
            )
        })
    }
}

/// Change of the outputs by halving the solver's step that is small enough, relative to their ranges.
const SOLVER_ERROR: f64 = 1e-8;
/// The solver's step is divided so often at most.
const MOST_HALVINGS: u32 = 8;
/// Rows of a run that the solver's step is chosen by.
const SOLVER_ROWS: usize = 200;

/// Learns the equations of motion, chooses the solver's step by roll-outs along the training runs, and writes the surrogate.
pub(super) fn train(project: &Project, dataset: &Dataset) -> Result<(Surrogate, TrainingRecord)> {
    let study = &project.study;
    let Source::Simulation(simulation) = &project.source else {
        return Err(study.refusal("source", "recorded runs cannot be asked for their equations of motion"));
    };
    let (Some(driven), Some(mechanism)) = (simulation.driven(), study.mechanism()) else {
        return Err(study.refusal("source", "expected a mechanism"));
    };
    let began = Instant::now();
    let fitted = fit(mechanism, driven.region(), study.seed).map_err(|message| study.refusal("states", message))?;
    for driver in driven.drivers().iter().enumerate().filter(|(index, _)| !fitted.is_driven_by(*index)) {
        project.warn(format_args!("input {} acts on nothing", driver.1.variable.name));
    }
    let rows = 3 * fitted.terms + 50;
    let with_step = |step: f64| assemble(project, dataset, (driven, rows), &fitted, step);
    let (surrogate, solver_step, solver_error) = choose_step(dataset, study.time.step, with_step)?;
    let record = TrainingRecord {
        train_rows: rows,
        validation_runs: 0,
        epochs: 0,
        best_epoch: 0,
        stopped: StopReason::Solved,
        train_seconds: began.elapsed().as_secs_f64(),
        added_runs: 0,
        target_met: None,
        motion: Some(MotionRecord {
            harmonics: fitted.order[0],
            powers: fitted.order[1],
            products: [fitted.dynamics.law().products(), fitted.positions.products()],
            error: fitted.error,
            solver_step,
            solver_error,
        }),
    };
    project.finish(format_args!(
        "learned equations of motion from {rows} configurations in {:.1} s: harmonics up to {}, powers up to {}, {} products, error \
         {:.1e} at unseen configurations; solver steps of {solver_step} s",
        record.train_seconds,
        fitted.order[0],
        fitted.order[1],
        fitted.dynamics.law().products(),
        fitted.error,
    ));
    rescue::write(project, |project| {
        surrogate::save(&surrogate, &project.model())?;
        write_history(&project.history(), &[])?;
        files::write_json(&project.training_record(), &record)
    })?;
    Ok((surrogate, record))
}

fn assemble(
    project: &Project,
    dataset: &Dataset,
    (driven, rows): (&Driven, usize),
    fitted: &Fitted,
    step: f64,
) -> Result<Surrogate> {
    let Fitted { dynamics, positions, windings, outputs, .. } = fitted.clone();
    let is_limited: Vec<bool> = (0..dynamics.coordinates()).map(|column| fitted.depends_on(column)).collect();
    let motion = Motion { dynamics, positions, windings, outputs, step };
    surrogate::assemble_motion(&project.study, (dataset, rows), (driven, &is_limited), motion)
}

/// The surrogate with the largest step, of `largest` and what halving gives, that is small enough, and its error: what halving it again
/// changes.
fn choose_step(
    dataset: &Dataset,
    largest: f64,
    with_step: impl Fn(f64) -> Result<Surrogate>,
) -> Result<(Surrogate, f64, f64)> {
    let end = dataset.runs.first().and_then(|run| run.times.get(SOLVER_ROWS)).copied().unwrap_or(f64::INFINITY);
    let runs = dataset.clone().until(end);
    let mut step = largest;
    let mut surrogate = with_step(step)?;
    let mut rolled_out = predict_all(&surrogate, &runs);
    for halving in 1.. {
        let finer = with_step(0.5 * step)?;
        let rolled_out_finer = predict_all(&finer, &runs);
        let error = difference(&surrogate, &rolled_out, &rolled_out_finer);
        if error <= SOLVER_ERROR || halving > MOST_HALVINGS {
            return Ok((surrogate, step, error));
        }
        (surrogate, step, rolled_out) = (finer, 0.5 * step, rolled_out_finer);
    }
    unreachable!("the loop ends by itself")
}

/// Largest difference of any output, relative to its range.
fn difference(surrogate: &Surrogate, one: &[Vec<f64>], other: &[Vec<f64>]) -> f64 {
    let width = surrogate.outputs().len();
    let mut largest = 0.0f64;
    for (one, other) in one.iter().zip(other) {
        for (index, (one, other)) in one.iter().zip(other).enumerate() {
            let output = &surrogate.outputs()[index % width];
            let error = (one - other).abs() / (output.max - output.min).max(f64::MIN_POSITIVE);
            // a maximum would leave out what is not a number
            largest = if error.is_nan() { f64::INFINITY } else { largest.max(error) };
        }
    }
    largest
}
