//! Learns equations of motion from the motions of a table.

use super::solver;
use crate::{
    Error, Result,
    dataset::Dataset,
    diagnostics::numbers::counted,
    dynamics::{
        identify::{AccelerationModel, Identified, fit_accelerations, fit_motion},
        trajectory::{Trajectory, disagreement},
    },
    kinds::{
        learning::{Beginning, LearningMethod, Trained},
        record::{
            ACCELERATIONS, Candidate, MethodRecord, TrainingRecord, TrajectoriesRecord,
            trajectories::{MOTION, POOR},
        },
    },
    project::Project,
    source::{Source, driven::Driven},
    study::Study,
    surrogate,
};
use metafmu_runtime::{
    Clock, FormatError, Graph, Integration, Motion, Program, Shown,
    dictionary::{Dictionary, Factor},
    graph::Given,
};
use std::time::Instant;

/// Equations of recorded motions.
pub(super) struct RecordedMotions;

impl LearningMethod for RecordedMotions {
    fn learn(&self, project: &Project, dataset: &Dataset, _: &Beginning) -> Result<Trained> {
        train(project, dataset)
    }
}

/// Learns the equations from the rows for training, chooses how the solver integrates them.
fn train(project: &Project, dataset: &Dataset) -> Result<Trained> {
    let study = &project.study;
    let (Source::Recorded(recorded), Some(driven)) = (&project.source, project.source.driven()) else {
        return Err(study.refusal("source", "expected a table"));
    };
    let began = Instant::now();
    let trajectories = recorded.learned();
    let rows = trajectories.iter().map(Trajectory::rows).sum();
    let rate_errors = rate_errors(project, driven, &trajectories);
    let mut found: Vec<FoundEquations> = Vec::new();
    let mut refused = Vec::new();
    for name in [MOTION, ACCELERATIONS] {
        let mut of_name: Vec<FoundEquations> = Vec::new();
        for angles in angles(study) {
            if project.is_stopped() {
                return Err(Error::Interrupted);
            }
            // the equations are those of the motions: other ones are not looked for
            if of_name.iter().any(|found| found.candidate.error <= GOOD) {
                break;
            }
            let columns = ColumnFactors::new(study, &trajectories, &angles);
            let began = Instant::now();
            let identified = match name {
                MOTION => fit_motion(&columns.of_motion(), &trajectories),
                _ => fit_accelerations(&columns.of_accelerations(), &trajectories),
            };
            match identified {
                Ok(identified) => {
                    let (error, seconds) = (identified.error.min(f64::MAX), began.elapsed().as_secs_f64());
                    let candidate = Candidate { name: name.into(), error, seconds };
                    of_name.push(FoundEquations { candidate, identified, columns, angles });
                }
                Err(error) => refused.push(format!("{name}: {error}")),
            }
        }
        found.extend(first_of_the_best(of_name));
    }
    let candidates: Vec<Candidate> = found.iter().map(|found| found.candidate.clone()).collect();
    let Some(FoundEquations { candidate, identified, columns, angles }) = first_of_the_best(found) else {
        refused.dedup();
        return Err(study.refusal("source.table", refused.join("; ")));
    };
    let model = |integration| {
        columns.program(study, driven, &identified.model, integration).map_err(|source| Error::Surrogate { source })
    };
    let n = study.states.len();
    let is_limited = columns.is_limited(&identified.model);
    let range = |state: usize, is_limited: bool| match study.states.get_index(state) {
        Some((_, options)) => (is_limited && !angles[state]).then_some([options.min, options.max]),
        // beyond the rows equations of motion hold, as rates enter them as they stand, and the solver is measured half as far again
        None if is_limited => driven.range(state),
        None => driven.range(state).map(wider),
    };
    let ranges: Vec<Option<[f64; 2]>> = is_limited
        .into_iter()
        .chain(std::iter::repeat(false))
        .take(2 * n)
        .enumerate()
        .map(|(k, is)| range(k, is))
        .collect();
    let assemble = |integration: Integration| {
        surrogate::assemble_with_states(study, (dataset, rows), (driven, &ranges), model(integration)?)
    };
    let of_states: Vec<_> = std::iter::repeat_n(None, n).chain(ranges[n..].iter().copied()).collect();
    let (surrogate, solver) = match candidate.error <= POOR {
        true => solver::choose(project, dataset, (driven, &of_states), candidate.error, assemble)?,
        // no tolerance is small enough for equations that diverge
        false => {
            let solver = solver::unmeasured(study.time.step);
            (assemble(solver.integration())?, solver)
        }
    };
    let exported = TrajectoriesRecord {
        exported: candidate.name.clone(),
        harmonics: identified.order[0],
        powers: identified.order[1],
        coefficients: identified.coefficients,
        solutions: identified.solutions,
        periodic: (study.states.iter().zip(&angles))
            .filter(|((_, options), is_angle)| options.periodic.is_none() && **is_angle)
            .map(|((name, _), _)| name.clone())
            .collect(),
        rate_errors,
        candidates,
        solver,
    };
    let method = MethodRecord::Trajectories(exported);
    let record = TrainingRecord::solved(rows, began.elapsed().as_secs_f64(), method);
    project.finish(format_args!(
        "learned the equations from {} in {:.1} s: {}",
        counted(rows, "row"),
        record.train_seconds,
        record.method.as_ref().map_or(String::new(), MethodRecord::describe)
    ));
    Ok(Trained { surrogate, history: Vec::new(), record })
}

/// Equations that were found.
struct FoundEquations {
    candidate: Candidate,
    identified: Identified,
    columns: ColumnFactors,
    /// Which coordinates are angles.
    angles: Vec<bool>,
}

/// The first of those that are alike, the least error among them.
fn first_of_the_best(found: Vec<FoundEquations>) -> Option<FoundEquations> {
    let least = found.iter().map(|found| found.candidate.error).min_by(f64::total_cmp)?;
    found.into_iter().find(|found| found.candidate.error <= ALIKE * least)
}

/// Error at which other equations are not looked for.
const GOOD: f64 = 1e-6;

/// Largest number of coordinates of unknown periodicity that are tried one by one.
const MOST_ALONE: usize = 3;

/// Coordinates that may be angles: as the study states, with all combinations of those that it leaves open, or none and
/// all of them.
fn angles(study: &Study) -> Vec<Vec<bool>> {
    let known: Vec<Option<bool>> = study.states.values().map(|state| state.periodic).collect();
    let open = known.iter().filter(|known| known.is_none()).count();
    let all = (1usize << open.min(MOST_ALONE)) - 1;
    let choices = if open > MOST_ALONE { vec![0, usize::MAX] } else { (0..=all).collect() };
    let with = |choice: usize| {
        let mut number = 0..;
        let is_angle = |known: &Option<bool>| {
            known.unwrap_or_else(|| choice.checked_shr(number.next().unwrap_or(0)).unwrap_or(0) & 1 == 1)
        };
        known.iter().map(is_angle).collect()
    };
    choices.into_iter().map(with).collect()
}

/// Columns of rates that are not the derivatives of their coordinates, by the longest motion; tells them.
fn rate_errors(project: &Project, driven: &Driven, trajectories: &[Trajectory]) -> Vec<(String, f64)> {
    let Some(longest) = trajectories.iter().max_by_key(|motion| motion.rows()) else { return Vec::new() };
    let n = longest.coordinates;
    let mut errors = Vec::new();
    for (k, (name, _)) in project.study.states.iter().enumerate().filter(|(_, (_, state))| state.rate.is_some()) {
        let column = |values: &[f64]| values.iter().skip(k).step_by(n).copied().collect::<Vec<f64>>();
        let Some([found, own]) = disagreement(&column(&longest.q), &column(&longest.v), longest.step) else { continue };
        let rate = &driven.states()[n + k].name;
        project.warn(format_args!(
            "`{rate}` is not the derivative of `{name}`: they differ by {found:.1e} of its root mean square, and differences of `{name}` are \
             good to {own:.1e}; equations are learned from `{rate}` as it is, without `rate` from differences"
        ));
        errors.push((rate.clone(), found));
    }
    errors
}

/// Factor between the errors of two candidates below which the first one is taken, whose structure holds beyond the rows.
const ALIKE: f64 = 1.5;

/// Half as much more in both directions as a range reaches in either.
fn wider([min, max]: [f64; 2]) -> [f64; 2] {
    let largest = 1.5 * min.abs().max(max.abs());
    [-largest, largest]
}

/// Factors of the columns of the functions.
struct ColumnFactors {
    parameters: Vec<Factor>,
    inputs: Vec<Factor>,
    coordinates: Vec<Factor>,
    rates: Vec<Factor>,
}

impl ColumnFactors {
    fn new(study: &Study, trajectories: &[Trajectory], angles: &[bool]) -> Self {
        let power = |min: f64, max: f64| Factor::Power { middle: 0.5 * (min + max), half: 0.5 * (max - min) };
        // about zero where the values are on both sides of it: products are those of the equations then
        let observed = |values: &dyn Fn(&Trajectory) -> &Vec<f64>, width: usize, column: usize| {
            let values = trajectories.iter().flat_map(|motion| values(motion).iter().skip(column).step_by(width));
            let [min, max] =
                values.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(*value), max.max(*value)]);
            match min.abs().max(max.abs()) {
                0.0 => power(-1.0, 1.0),
                largest if min <= 0.0 && max >= 0.0 || min == max => power(-largest, largest),
                _ => power(min, max),
            }
        };
        let (n, m) = (study.states.len(), study.inputs.len());
        let coordinate = |(k, is_angle): (usize, &bool)| match is_angle {
            true => Factor::Angle,
            false => observed(&|motion| &motion.q, n, k),
        };
        Self {
            parameters: study.parameters.values().map(|range| power(range.min, range.max)).collect(),
            inputs: (0..m).map(|k| observed(&|motion| &motion.u, m, k)).collect(),
            coordinates: angles.iter().enumerate().map(coordinate).collect(),
            rates: (0..n).map(|k| observed(&|motion| &motion.v, n, k)).collect(),
        }
    }

    /// Factors of the functions in equations of motion.
    fn of_motion(&self) -> Vec<Factor> {
        [self.coordinates.as_slice(), &self.parameters].concat()
    }

    /// Factors of accelerations.
    fn of_accelerations(&self) -> Vec<Factor> {
        [self.parameters.as_slice(), &self.inputs, &self.coordinates, &self.rates].concat()
    }

    /// Returns true for each coordinate, then for each rate, that functions depend on.
    fn is_limited(&self, model: &AccelerationModel) -> Vec<bool> {
        let (first, functions, count) = match model {
            AccelerationModel::Motion(dynamics) => (0, dynamics.function_set().dictionary(), self.coordinates.len()),
            AccelerationModel::Functions(functions) => {
                (self.parameters.len() + self.inputs.len(), functions.as_ref(), 2 * self.coordinates.len())
            }
        };
        (0..count).map(|k| functions.terms().any(|term| term.exponents[first + k] != 0)).collect()
    }

    /// The surrogate's program, whose outputs are states.
    fn program(
        &self,
        study: &Study,
        driven: &Driven,
        model: &AccelerationModel,
        integration: Integration,
    ) -> std::result::Result<Program, FormatError> {
        let n = self.coordinates.len();
        let state = |name: &String| driven.states().iter().position(|state| state.name == *name);
        let shown = study.outputs.keys().filter_map(state);
        Ok(match model {
            AccelerationModel::Motion(dynamics) => {
                let outputs =
                    shown.map(|state| if state < n { Shown::Position(state) } else { Shown::Velocity(state - n) });
                let motion = Motion {
                    dynamics: dynamics.as_ref().clone(),
                    positions: Dictionary::new(&self.of_motion(), n, &[])?.into(),
                    // the positions are the coordinates
                    windings: (0..n * n).map(|index| f64::from(u8::from(index / n == index % n))).collect(),
                    reactions: None,
                    actuator_states: 0,
                    outputs: outputs.collect(),
                };
                Program::of_motion(motion, integration)
            }
            AccelerationModel::Functions(functions) => {
                let derivatives = (0..n).map(|k| Given::State(n + k)).chain((0..n).map(Given::Function));
                let results: Vec<Given> = shown.map(Given::State).chain(derivatives).collect();
                let graph = Graph::of_rates(functions, None, 2 * n, &results);
                Program { graph, clock: Clock::Continuous(integration) }
            }
        })
    }
}
