//! Learns equations of motion from a mechanism.

use super::{
    learned::{self, Candidate},
    motion_networks::{Learned, learn},
    project::Project,
    solver::{self, SolverRecord},
    train::{Checkpoints, Trained, TrainingRecord},
};
use crate::{
    Result,
    dataset::Dataset,
    dynamics::FittedReactions,
    source::{Source, driven::Driven},
    surrogate,
};
use metafmu_runtime::{Integration, Model, Motion, Surrogate, dictionary::Factor};
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
    /// How the solver integrates.
    pub solver: SolverRecord,
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
        let Self { harmonics, powers, products: [equations, positions], error, solver, .. } = self;
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
             in positions, error {error:.1e} at unseen configurations{reactions}{forces}{compared}; {}",
            solver.describe()
        )
    }
}

/// Tolerance of the roll-outs that show how large velocities become.
const ROUGH: f64 = 1e-8;

/// Learns the equations of motion, and chooses how the solver integrates them.
pub(super) fn train(project: &Project, dataset: &Dataset, checkpoints: &Checkpoints) -> Result<Trained> {
    let study = &project.study;
    let Source::Simulation(simulation) = &project.source else {
        return Err(study.refusal("source", "recorded runs cannot be asked for their equations of motion"));
    };
    let (Some(driven), Some(mechanism)) = (simulation.driven(), study.mechanism()) else {
        return Err(study.refusal("source", "expected a mechanism"));
    };
    let region = driven.region().ok_or_else(|| study.refusal("source", "expected a mechanism"))?;
    let began = Instant::now();
    let learned = learn(project, dataset, (mechanism, driven, region), checkpoints)?;
    for driver in driven.drivers().iter().enumerate().filter(|(index, _)| !learned.dynamics.is_driven_by(*index)) {
        project.warn(format_args!("input {} acts on nothing", driver.1.variable.name));
    }
    let n = study.states.len();
    let rough = Integration::ErrorControlled { tolerance: ROUGH, longest: study.time.step };
    let unlimited = assemble(project, dataset, driven, &learned, (rough, &[]))?;
    let reached = solver::velocity_ranges(project, &unlimited, &dataset.runs, n..2 * n);
    // forces were learned in a range
    let range = |(k, reached): (usize, [f64; 2])| {
        let of_forces = learned.velocities.as_ref().filter(|_| learned.dynamics.extrapolates(k));
        of_forces.map_or(reached, |ranges| ranges[k])
    };
    let velocities: Vec<[f64; 2]> = reached.into_iter().enumerate().map(range).collect();
    let of_states: Vec<_> = std::iter::repeat_n(None, n).chain(velocities.iter().copied().map(Some)).collect();
    let of_equations = learned.error();
    let (surrogate, solver) = solver::choose(project, dataset, (driven, &of_states), of_equations, |integration| {
        assemble(project, dataset, driven, &learned, (integration, &velocities))
    })?;
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
        solver,
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

/// The surrogate with an integration and ranges of the velocities.
fn assemble(
    project: &Project,
    dataset: &Dataset,
    driven: &Driven,
    learned: &Learned,
    (integration, velocities): (Integration, &[[f64; 2]]),
) -> Result<Surrogate> {
    let Learned { fitted, dynamics, positions, rows, .. } = learned;
    let motion = Motion {
        dynamics: dynamics.clone(),
        positions: positions.clone(),
        windings: fitted.windings.clone(),
        reactions: fitted.reactions.as_ref().map(|fitted| fitted.reactions.clone()),
        outputs: fitted.outputs.clone(),
        integration,
    };
    let factors: Vec<Factor> = dynamics.law().dictionary().factors().collect();
    let ranges = project.study.states.iter().enumerate().map(|(column, (name, options))| {
        // the torque of a spring on a joint is another one a turn later
        let is_periodic = factors[column] == Factor::Angle && options.goes_around(name);
        let is_limited = motion.depends_on(column) && !is_periodic;
        is_limited.then_some([options.min, options.max])
    });
    let ranges: Vec<Option<[f64; 2]>> = ranges.chain(velocities.iter().copied().map(Some)).collect();
    let model = Model::Motion(Box::new(motion));
    surrogate::assemble_with_states(&project.study, (dataset, *rows), (driven, &ranges), model)
}
