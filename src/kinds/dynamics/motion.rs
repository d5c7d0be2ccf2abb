//! Learns equations of motion from a mechanism.

use super::{
    corner_error::LearnedMotion,
    corners::{IntegrationTrial, corners},
    learned::EXACT,
    motion_networks::{ComparedStates, Learned, learn},
    solver,
};
use crate::{
    Result,
    dataset::Dataset,
    dynamics::{Equations, FittedReactions},
    kinds::{
        follower::Checkpoints,
        learning::{Beginning, LearningMethod, Trained},
        record::{CornerRecord, MethodRecord, MotionRecord, ReactionRecord, TrainingRecord},
    },
    multibody::{FreeCoordinate, Mechanism},
    project::Project,
    source::{Source, driven::Driven},
    surrogate,
};
use metafmu_runtime::{Integration, Motion, Program, Surrogate};
use std::time::Instant;

/// Tolerance of the roll-outs that show how large velocities become.
const ROUGH: f64 = 1e-8;

/// Equations of motion of a mechanism.
pub(super) struct EquationsOfMechanism;

impl LearningMethod for EquationsOfMechanism {
    fn learn(&self, project: &Project, dataset: &Dataset, begin: &Beginning) -> Result<Trained> {
        train(project, dataset, &Checkpoints::new(project, begin.resume)?)
    }
}

/// Learns the equations of motion, and chooses how the solver integrates them.
fn train(project: &Project, dataset: &Dataset, checkpoints: &Checkpoints) -> Result<Trained> {
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
    for driver in driven.drivers().iter().enumerate().filter(|(index, _)| !learned.is_driven_by(*index)) {
        project.warn(format_args!("input {} acts on nothing", driver.1.variable.name));
    }
    if learned.fitted.error > EXACT {
        warn_of_coordinates(project, mechanism);
    }
    let n = study.coordinates().count();
    let rough = Integration::ErrorControlled { tolerance: ROUGH, longest: study.time.step };
    let unlimited = assemble(project, dataset, driven, &learned, (rough, &[]))?;
    let reached = solver::velocity_ranges(project, &unlimited, &dataset.runs, n..n + study.states.len());
    // accelerations were learned in a range
    let range = |(k, reached): (usize, [f64; 2])| {
        let of_forces = learned.velocities.as_ref().filter(|_| k >= n || learned.dynamics.extrapolates(k));
        of_forces.map_or(reached, |ranges| ranges[k])
    };
    let velocities: Vec<[f64; 2]> = reached.into_iter().enumerate().map(range).collect();
    let of_states: Vec<_> = std::iter::repeat_n(None, n).chain(velocities.iter().copied().map(Some)).collect();
    let of_equations = learned.error();
    let (surrogate, solver) = solver::choose(project, dataset, (driven, &of_states), of_equations, |integration| {
        assemble(project, dataset, driven, &learned, (integration, &velocities))
    })?;
    let trials = corners(study, driven, &dataset.runs, &of_states, &surrogate);
    let corners = errors_at_corners(project, mechanism, &learned, &surrogate, &trials)?;
    let Learned { fitted, dynamics, positions, rows, .. } = &learned;
    let motion = MotionRecord {
        harmonics: fitted.order[0],
        powers: fitted.order[1],
        products: [dynamics.function_set().dictionary().products(), positions.dictionary().products()],
        error: fitted.error,
        reactions: fitted.reactions.as_ref().map(|FittedReactions { reactions, order, error }| ReactionRecord {
            harmonics: order[0],
            powers: order[1],
            products: reactions.functions().products(),
            error: *error,
        }),
        candidates: learned.candidates.clone(),
        exported: learned.exported.clone(),
        corners,
        solver,
    };
    let record = TrainingRecord::solved(*rows, began.elapsed().as_secs_f64(), MethodRecord::Motion(motion.clone()))
        .with_epochs(learned.history.len(), learned.best_epoch, learned.stopped);
    project.finish(format_args!(
        "learned equations of motion from {rows} configurations in {:.1} s by {}",
        record.train_seconds,
        motion.describe()
    ));
    Ok(Trained { surrogate, history: learned.history, record })
}

/// Errors of accelerations and forces of a surrogate along runs from corners of the domain; none if its equations are exact.
fn errors_at_corners(
    project: &Project,
    mechanism: &Mechanism,
    learned: &Learned,
    surrogate: &Surrogate,
    trials: &[IntegrationTrial],
) -> Result<Option<CornerRecord>> {
    let Some(ComparedStates { region, deviations }) = &learned.compared else { return Ok(None) };
    let study = &project.study;
    let equations = Equations::new(mechanism, region).map_err(|error| study.refusal("states", error))?;
    let parameters = study.parameters.len();
    let motion = LearnedMotion { surrogate, equations: &equations, deviations, parameters };
    Ok(motion.largest_errors(trials))
}

/// Warns of coordinates other than those that are proposed, where equations are not exact in them.
fn warn_of_coordinates(project: &Project, mechanism: &Mechanism) {
    let proposed = mechanism.free_coordinates().unwrap_or_default();
    let is_other = |proposed: &FreeCoordinate| !project.study.states.contains_key(&proposed.name);
    if proposed.iter().any(is_other) {
        let names: Vec<&str> = proposed.iter().map(|coordinate| coordinate.name.as_str()).collect();
        let names = names.join(", ");
        project.warn(format_args!("the equations are not exact in these coordinates; `metafmu new` proposes {names}"));
    }
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
        actuator_states: fitted.actuator_states,
        outputs: fitted.outputs.clone(),
    };
    let ranges = project.study.coordinates().enumerate().map(|(column, (name, options))| {
        // the torque of a spring on a joint is another one a turn later, and a network of accelerations knows one turn only
        let is_known = |turns: u32| turns == 1 || learned.velocities.is_none();
        let is_periodic = fitted.periods[column].is_some_and(is_known) && options.goes_around(name);
        let is_limited = if fitted.straight.contains(&column) {
            motion.is_limited_along(column)
        } else {
            // a straight line may be the best fit of a curve
            motion.depends_on(column)
        };
        (is_limited && !is_periodic).then_some([options.min, options.max])
    });
    let ranges: Vec<Option<[f64; 2]>> = ranges.chain(velocities.iter().copied().map(Some)).collect();
    let program = Program::of_motion(motion, integration);
    surrogate::assemble_with_states(&project.study, (dataset, *rows), (driven, &ranges), program)
}
