//! Learns equations of motion of a program that gives its mass matrix.

use super::{
    learned::{self, Examples, SAME, encoded, held_out, invalid, network_columns},
    solver,
    state_space::asked,
};
use crate::{
    Error, Result,
    dataset::Dataset,
    dynamics::{ENOUGH, EquationSamples, FittedMassMatrix, MassMatrixProblem, acceleration_error},
    kinds::{
        follower::Checkpoints,
        learning::{Beginning, LearningMethod, Trained},
        record::{Candidate, DICTIONARY, DICTIONARY_AND_NETWORK, MethodRecord, MotionRecord, TrainingRecord},
    },
    project::Project,
    source::{driven::Driven, worker::WorkerModel},
    surrogate,
    training::{EpochRecord, StopReason},
};
use metafmu_runtime::{
    Dynamics, Integration, Motion, Program, Rows, Shown, StatePoint,
    dictionary::{Dictionary, Factor},
    function_set::{NetworkColumn, NetworkTerm},
};
use std::{ops::Range, time::Instant};

/// Equations of motion of a program.
pub(super) struct EquationsWithMassMatrix;

impl LearningMethod for EquationsWithMassMatrix {
    fn check(&self, project: &Project) -> Result<()> {
        let (driven, model) = asked(project)?;
        AskedProgram::new(project, driven, model).map(|_| ())
    }

    fn learn(&self, project: &Project, dataset: &Dataset, begin: &Beginning) -> Result<Trained> {
        train(project, dataset, &Checkpoints::new(project, begin.resume)?)
    }
}

/// Asks the program for its equations, learns them, chooses how the solver integrates them.
fn train(project: &Project, dataset: &Dataset, checkpoints: &Checkpoints) -> Result<Trained> {
    let study = &project.study;
    let (driven, model) = asked(project)?;
    let began = Instant::now();
    let program = AskedProgram::new(project, driven, model)?;
    let states = program.random_states()?;
    let mut learned = program.learn(&states, checkpoints)?;
    let best = learned::chosen(&learned.records, &study.dynamics);
    let (Candidate { name, error, .. }, dynamics) = learned.candidates.swap_remove(best);
    let positions = &learned.fitted.positions;
    let motion = Motion {
        dynamics,
        positions: program.shown.positions(positions)?.into(),
        windings: program.shown.windings(program.coordinates()),
        reactions: None,
        actuator_states: 0,
        outputs: program.shown.outputs.clone(),
    };
    let n = program.coordinates();
    let ranges = study.states.iter().enumerate().map(|(state, (name, options))| {
        let is_free = state < n && (!motion.depends_on(state) || options.goes_around(name));
        (!is_free).then_some([options.min, options.max])
    });
    let ranges: Vec<Option<[f64; 2]>> = ranges.collect();
    let assemble = |integration: Integration| {
        let program = Program::of_motion(motion.clone(), integration);
        surrogate::assemble_with_states(study, (dataset, learned.fitted.rows), (driven, &ranges), program)
    };
    let velocities: Vec<Option<[f64; 2]>> =
        study.states.values().enumerate().map(|(k, state)| (k >= n).then_some([state.min, state.max])).collect();
    let (surrogate, solver) = solver::choose(project, dataset, (driven, &velocities), error, assemble)?;
    let mut candidates = learned.records;
    candidates.sort_by(|a, b| a.error.total_cmp(&b.error));
    let FittedMassMatrix { order, rows, error, .. } = learned.fitted;
    let record = MotionRecord {
        harmonics: order[0],
        powers: order[1],
        products: [motion.dynamics.function_set().dictionary().products(), positions.products()],
        error,
        reactions: None,
        candidates,
        exported: name,
        // a program is not asked for states outside its sampled ones
        corners: None,
        solver,
    };
    let description = record.describe();
    let record = TrainingRecord::solved(rows, began.elapsed().as_secs_f64(), MethodRecord::Motion(record)).with_epochs(
        learned.history.len(),
        learned.best_epoch,
        learned.stopped,
    );
    project.finish(format_args!(
        "learned equations of motion from {rows} configurations in {:.1} s by {description}",
        record.train_seconds
    ));
    Ok(Trained { surrogate, history: learned.history, record })
}

/// Equations of a program.
struct AskedProgram<'a> {
    project: &'a Project<'a>,
    model: &'a WorkerModel,
    /// Ranges of parameters, inputs, coordinates and velocities.
    parameters: Vec<[f64; 2]>,
    inputs: Vec<[f64; 2]>,
    states: Vec<[f64; 2]>,
    shown: ShownOutputs,
    /// Flags of parameters, inputs, coordinates and velocities: true for those that change accelerations, masses or learned outputs.
    used: Vec<bool>,
}

/// Equations in random states.
struct RandomStates {
    /// At `(q, p, v, u)`.
    accelerations: EquationSamples,
    masses: Rows,
}

/// Ways to learn the equations.
struct LearnedEquations {
    fitted: FittedMassMatrix,
    candidates: Vec<(Candidate, Dynamics)>,
    records: Vec<Candidate>,
    history: Vec<EpochRecord>,
    best_epoch: usize,
    stopped: StopReason,
}

/// Meaning of the outputs.
struct ShownOutputs {
    outputs: Vec<Shown>,
    /// Output that each position is learned from, or the coordinate that it is.
    positions: Vec<ShownPosition>,
}

#[derive(Clone, Copy, PartialEq)]
enum ShownPosition {
    Output(usize),
    Coordinate(usize),
}

impl<'a> AskedProgram<'a> {
    fn new(project: &'a Project, driven: &Driven, model: &'a WorkerModel) -> Result<Self> {
        let study = &project.study;
        let mut program = Self {
            project,
            model,
            parameters: study.parameters.values().map(|range| [range.min, range.max]).collect(),
            inputs: driven.drivers().iter().map(|driver| [driver.min, driver.max]).collect(),
            states: study.states.values().map(|state| [state.min, state.max]).collect(),
            shown: ShownOutputs { outputs: Vec::new(), positions: Vec::new() },
            used: Vec::new(),
        };
        program.shown = program.outputs()?;
        let (n, outputs) = (program.coordinates(), study.outputs.len());
        let masses = (0..n * (n + 1) / 2).map(|mass| 2 * n + outputs + mass);
        let labels = (n..2 * n).chain(program.shown.learned().map(|output| 2 * n + output)).chain(masses);
        let ranges = [&program.parameters[..], &program.inputs, &program.states].concat();
        program.used = learned::used(project, model, &ranges, &labels.collect::<Vec<_>>())?;
        Ok(program)
    }

    /// Flags of `(q, p)`, of those of all columns.
    fn of_configuration(&self, all: &[bool]) -> Vec<bool> {
        let (p, e, n) = (self.parameters.len(), self.inputs.len(), self.coordinates());
        [&all[p + e..p + e + n], &all[..p]].concat()
    }

    /// Flags of `(q, p, v, u)`, of those of all columns.
    fn of_forces(&self, all: &[bool]) -> Vec<bool> {
        let (p, e, n) = (self.parameters.len(), self.inputs.len(), self.coordinates());
        [&self.of_configuration(all)[..], &all[p + e + n..], &all[p..p + e]].concat()
    }

    fn coordinates(&self) -> usize {
        self.states.len() / 2
    }

    /// Derivatives, outputs and mass matrix at points of parameters, inputs and states.
    fn ask(&self, points: &Rows) -> Result<Rows> {
        learned::ask(self.project, self.model, points)
    }

    fn random_points(&self, count: usize, seed: u64) -> Rows {
        let ranges = [&self.parameters[..], &self.inputs, &self.states].concat();
        learned::random_points(&ranges, count, self.project.study.seed ^ seed)
    }

    /// Finds the meaning of the outputs from pairs of states that differ in velocities and inputs only.
    fn outputs(&self) -> Result<ShownOutputs> {
        let (study, n) = (&self.project.study, self.coordinates());
        let (p, e) = (self.parameters.len(), self.inputs.len());
        let mut points = self.random_points(2 * COMPARED, 0x4f55_5450);
        for pair in 0..COMPARED {
            let first = points[2 * pair].to_vec();
            let second = &mut points[2 * pair + 1];
            second[..p].copy_from_slice(&first[..p]);
            second[p + e..p + e + n].copy_from_slice(&first[p + e..p + e + n]);
        }
        let labels = self.ask(&points)?;
        let rates = |state: usize| {
            labels.iter().zip(&points).all(|(label, point)| same(label[state], point[p + e + n + state]))
        };
        let names: Vec<&str> = study.states.keys().map(String::as_str).collect();
        if let Some(state) = (0..n).find(|state| !rates(*state)) {
            let (coordinate, rate) = (names[state], names[n + state]);
            let message =
                format!("the derivative of `{coordinate}` is not `{rate}`, expected a coordinate with its rate");
            return Err(study.refusal(&format!("states.{rate}.rate_of"), message));
        }
        let (mut shown, mut moving) = (ShownOutputs { outputs: Vec::new(), positions: Vec::new() }, Vec::new());
        for (output, name) in study.outputs.keys().enumerate() {
            let column = 2 * n + output;
            let is = |state: usize| {
                labels.iter().zip(&points).all(|(label, point)| same(label[column], point[p + e + state]))
            };
            let values: Vec<f64> = labels.column(column).collect();
            let largest = labels.largest_magnitude(column);
            if let Some(state) = (0..2 * n).find(|state| is(*state)) {
                let position = shown.position(ShownPosition::Coordinate(state % n));
                shown.outputs.push(if state < n { Shown::Position(position) } else { Shown::Velocity(position) });
            } else if values.as_chunks::<2>().0.iter().all(|[a, b]| (a - b).abs() <= SAME * largest) {
                let position = shown.position(ShownPosition::Output(output));
                shown.outputs.push(Shown::Position(position));
            } else {
                moving.push(format!("`{name}`"));
            }
        }
        if moving.is_empty() {
            return Ok(shown);
        }
        let message = format!(
            "{} depends on rates or inputs, expected functions of the coordinates or states: outputs of equations with `rate_of`",
            moving.join(", ")
        );
        Err(study.refusal("outputs", message))
    }

    /// Factors of coordinates and parameters; angles are harmonic or, like lengths, powers in their range.
    fn factors(&self, has_harmonics: bool) -> Vec<Factor> {
        let of_states = self.project.study.states.values().take(self.coordinates());
        let is_angle =
            of_states.map(|state| state.is_periodic() || has_harmonics && state.unit.as_deref() == Some("rad"));
        let is_angle = is_angle.chain(std::iter::repeat(false));
        let ranges = self.states[..self.coordinates()].iter().chain(&self.parameters);
        let factor = |([min, max], is_angle): (&[f64; 2], bool)| match is_angle {
            true => Factor::Angle,
            false => Factor::Power { middle: 0.5 * (min + max), half: 0.5 * (max - min) },
        };
        ranges.zip(is_angle).map(factor).collect()
    }

    /// The functions of [`MassMatrixProblem`] in random configurations: at rest, with each input at its ends, and with each velocity in
    /// both directions.
    fn configurations(&self, range: Range<usize>, is_unseen: bool) -> Result<EquationSamples> {
        let (p, e, n) = (self.parameters.len(), self.inputs.len(), self.coordinates());
        let speeds = self.speeds();
        let (mut points, mut configurations) = (Rows::default(), Rows::default());
        let seed = if is_unseen { 0x554e_5345 } else { 0x434f_4e46 };
        for point in &self.random_points(range.end, seed).part(range) {
            let mut point = point.to_vec();
            self.inputs.iter().enumerate().for_each(|(input, [min, _])| point[p + input] = *min);
            point[p + e + n..].fill(0.0);
            configurations.push(&[&point[p + e..p + e + n], &point[..p]].concat());
            points.push(&point);
            for (input, [min, max]) in self.inputs.iter().enumerate() {
                point[p + input] = *max;
                points.push(&point);
                point[p + input] = *min;
            }
            for (k, speed) in speeds.iter().enumerate() {
                for speed in [*speed, -speed] {
                    point[p + e + n + k] = speed;
                    points.push(&point);
                }
                point[p + e + n + k] = 0.0;
            }
        }
        let labels = self.ask(&points)?;
        let width = 1 + e + 2 * n;
        let functions = (0..configurations.len())
            .map(|number| self.functions(&labels.part(number * width..(number + 1) * width), &speeds))
            .collect();
        Ok(EquationSamples { points: configurations, labels: functions })
    }

    /// The functions of one configuration.
    fn functions(&self, labels: &Rows, speeds: &[f64]) -> Vec<f64> {
        let (e, n) = (self.inputs.len(), self.coordinates());
        let outputs = 2 * n..labels.width() - n * (n + 1) / 2;
        let masses = &labels[0][outputs.end..];
        let forces: Rows = labels.iter().map(|label| product(&label[outputs.end..], &label[n..2 * n])).collect();
        let by_input = |row: usize, input: usize| {
            let [min, max] = self.inputs[input];
            (forces[1 + input][row] - forces[0][row]) / (max - min)
        };
        let by_velocity = |row: usize, k: usize| {
            let [ahead, back] = [0, 1].map(|direction| forces[1 + e + 2 * k + direction][row]);
            (back - ahead) / (2.0 * speeds[k])
        };
        let at_zero = |row: usize| {
            let of_inputs = self.inputs.iter().enumerate().map(|(input, [min, _])| by_input(row, input) * min);
            forces[0][row] - of_inputs.sum::<f64>()
        };
        let mut functions = masses.to_vec();
        functions.push(0.0);
        functions.extend((0..n).map(at_zero));
        functions.extend((0..n).flat_map(|row| (0..n).map(move |k| (row, k))).map(|(row, k)| by_velocity(row, k)));
        functions.extend(
            (0..n).flat_map(|row| (0..e).map(move |input| (row, input))).map(|(row, input)| by_input(row, input)),
        );
        functions.extend(self.shown.learned().map(|output| labels[0][outputs.start + output]));
        functions
    }

    /// Largest velocity of each coordinate.
    fn speeds(&self) -> Vec<f64> {
        self.states[self.coordinates()..].iter().map(|[min, max]| min.abs().max(max.abs())).collect()
    }

    /// Accelerations and mass matrices in random states.
    fn random_states(&self) -> Result<RandomStates> {
        let (p, e, n) = (self.parameters.len(), self.inputs.len(), self.coordinates());
        let points = self.random_points(learned::states(&self.project.study), 0x5354_4154);
        let labels = self.ask(&points)?;
        let masses = n * (n + 1) / 2;
        let order =
            |point: &[f64]| [&point[p + e..p + e + n], &point[..p], &point[p + e + n..], &point[p..p + e]].concat();
        Ok(RandomStates {
            accelerations: EquationSamples {
                points: points.iter().map(order).collect(),
                labels: labels.iter().map(|label| &label[n..2 * n]).collect(),
            },
            masses: labels.iter().map(|label| &label[label.len() - masses..]).collect(),
        })
    }

    /// The dictionary, and a network for the forces that it leaves over.
    fn learn(&self, states: &RandomStates, checkpoints: &Checkpoints) -> Result<LearnedEquations> {
        let (study, began) = (&self.project.study, Instant::now());
        let seen = held_out(states.masses.len());
        let unseen = states.part(0..seen);
        let seen = states.part(seen..states.masses.len());
        let (fitted, factors) = self.fit()?;
        let error = acceleration_error(&fitted.dynamics, &unseen.accelerations);
        let candidate = |name: &str, error: f64, began: Instant| Candidate {
            name: name.into(),
            error,
            seconds: began.elapsed().as_secs_f64(),
        };
        let mut learned = LearnedEquations {
            candidates: vec![(candidate(DICTIONARY, error, began), fitted.dynamics.clone())],
            fitted,
            records: Vec::new(),
            history: Vec::new(),
            best_epoch: 0,
            stopped: StopReason::Solved,
        };
        if study.dynamics.tries(DICTIONARY_AND_NETWORK, error <= POOR) {
            let began = Instant::now();
            let used = self.of_forces(&self.used);
            let columns = network_columns(&factors, (0..used.len()).filter(|column| used[*column]));
            let examples = [&seen, &unseen].map(|states| states.examples(&learned.fitted.dynamics, &columns));
            let (network, outcome) = learned::train(self.project, examples.each_ref(), checkpoints)?;
            let outputs = (0..self.coordinates()).collect();
            let term = NetworkTerm::new(columns, outputs, network).map_err(invalid)?;
            let dynamics = learned.fitted.dynamics.clone().with_forces(Some(term)).map_err(invalid)?;
            let error = acceleration_error(&dynamics, &unseen.accelerations);
            learned.candidates.push((candidate(DICTIONARY_AND_NETWORK, error, began), dynamics));
            learned.best_epoch = outcome.best_epoch;
            learned.stopped = outcome.reason;
            learned.history = outcome.history;
        }
        learned.records = learned.candidates.iter().map(|(candidate, _)| candidate.clone()).collect();
        Ok(learned)
    }

    /// The better dictionary: of harmonics, or of powers of angles.
    fn fit(&self) -> Result<(FittedMassMatrix, Vec<Factor>)> {
        let (speeds, study) = (self.speeds(), &self.project.study);
        let used = self.of_configuration(&self.used);
        let inputs: Vec<f64> = self.inputs.iter().map(|[min, max]| min.abs().max(max.abs())).collect();
        // both kinds of factors are fitted to the same samples, and more of them begin with these
        let mut asked = [EquationSamples::default(), EquationSamples::default()];
        let mut sample = |count: usize, is_unseen: bool| {
            let known = &mut asked[usize::from(is_unseen)];
            if known.points.len() < count {
                let EquationSamples { points, labels } = self.configurations(known.points.len()..count, is_unseen)?;
                known.points.extend(&points);
                known.labels.extend(&labels);
            }
            Ok::<_, Error>(known.first(count))
        };
        let mut fit = |factors: Vec<Factor>| {
            let problem = MassMatrixProblem {
                factors: &factors,
                used: &used,
                velocities: &speeds,
                inputs: &inputs,
                positions: self.shown.learned().count(),
            };
            let mut failure = None;
            let fitted = problem.fit(|count, is_unseen| {
                sample(count, is_unseen).map_err(|error| {
                    let message = error.to_string();
                    failure = Some(error);
                    message
                })
            });
            match (fitted, failure) {
                (_, Some(error)) => Err(error),
                (Err(message), None) => Err(study.refusal("states", message)),
                (Ok(fitted), None) => Ok((fitted, factors)),
            }
        };
        let (harmonics, powers) = (self.factors(true), self.factors(false));
        if harmonics == powers {
            return fit(powers);
        }
        let harmonics = fit(harmonics)?;
        if harmonics.0.error <= ENOUGH {
            return Ok(harmonics);
        }
        let powers = fit(powers)?;
        Ok(if harmonics.0.error <= powers.0.error { harmonics } else { powers })
    }
}

/// Pairs of states that show what outputs depend on.
const COMPARED: usize = 20;

/// Error of the accelerations at which a network for the residual is worth its time.
const POOR: f64 = 10.0 * ENOUGH;

fn same(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= SAME * (1.0 + expected.abs())
}

/// A symmetric matrix, given by its lower triangle, times a vector.
fn product(triangle: &[f64], vector: &[f64]) -> Vec<f64> {
    let element = |row: usize, column: usize| {
        let (row, column) = (row.max(column), row.min(column));
        triangle[row * (row + 1) / 2 + column]
    };
    let row = |row: usize| vector.iter().enumerate().map(|(column, value)| element(row, column) * value).sum();
    (0..vector.len()).map(row).collect()
}

impl ShownOutputs {
    /// Number of a position, a new one if it is not known.
    fn position(&mut self, position: ShownPosition) -> usize {
        self.positions.iter().position(|known| *known == position).unwrap_or_else(|| {
            self.positions.push(position);
            self.positions.len() - 1
        })
    }

    /// Outputs whose functions are learned, in the order of the positions.
    fn learned(&self) -> impl Iterator<Item = usize> {
        self.positions
            .iter()
            .filter_map(|position| if let ShownPosition::Output(output) = position { Some(*output) } else { None })
    }

    /// All positions: zero for a coordinate, which has a winding.
    fn positions(&self, learned: &Dictionary) -> Result<Dictionary> {
        let mut places = self.learned().enumerate().map(|(place, _)| place);
        let places: Vec<Option<usize>> = self
            .positions
            .iter()
            .map(|position| matches!(position, ShownPosition::Output(_)).then(|| places.next()).flatten())
            .collect();
        let terms = learned.terms().map(|mut term| {
            term.coefficients =
                places.iter().map(|place| place.map_or(0.0, |place| term.coefficients[place])).collect();
            term
        });
        let (factors, terms) = (learned.factors().collect::<Vec<Factor>>(), terms.collect::<Vec<_>>());
        Dictionary::new(&factors, self.positions.len(), &terms).map_err(invalid)
    }

    fn windings(&self, coordinates: usize) -> Vec<f64> {
        let winding =
            |position: &ShownPosition, k: usize| f64::from(u8::from(*position == ShownPosition::Coordinate(k)));
        self.positions.iter().flat_map(|position| (0..coordinates).map(move |k| winding(position, k))).collect()
    }
}

impl RandomStates {
    fn part(&self, range: Range<usize>) -> Self {
        Self { accelerations: self.accelerations.part(range.clone()), masses: self.masses.part(range) }
    }

    /// Forces that the equations lack: of these columns.
    fn examples(&self, dynamics: &Dynamics, columns: &[NetworkColumn]) -> Examples {
        let EquationSamples { points, labels } = &self.accelerations;
        let (n, mut scratch) = (dynamics.coordinates(), dynamics.scratch());
        let configuration = n + dynamics.parameters();
        let rest = |((point, label), mass): ((&[f64], &[f64]), &[f64])| {
            let ((q, p), (v, u)) = (point[..configuration].split_at(n), point[configuration..].split_at(n));
            let mut found = vec![0.0; n];
            dynamics.accelerations(StatePoint { q, v, u, p }, &mut found, &mut scratch);
            let missing: Vec<f64> = label.iter().zip(&found).map(|(exact, found)| exact - found).collect();
            product(mass, &missing)
        };
        Examples {
            inputs: encoded(columns, points),
            outputs: points.iter().zip(labels).zip(&self.masses).map(rest).collect(),
            tangents: None,
        }
    }
}
