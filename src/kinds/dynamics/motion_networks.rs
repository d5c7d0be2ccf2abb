//! Networks in equations of motion: instead of the dictionary, for its residual, and instead of the equations.

use super::learned::{self, Directions, EXACT, Examples, encoded, held_out, invalid, network_columns};
use crate::{
    Result,
    dataset::Dataset,
    dynamics::{EquationSamples, Equations, FittedEquations, OfEquations, Region, acceleration_error, fit},
    kinds::{
        follower::{Checkpoints, unless_interrupted},
        record::{ACCELERATIONS, Candidate, DICTIONARY, DICTIONARY_AND_NETWORK, NETWORK},
    },
    multibody::{Mechanism, MotionError},
    project::{CountedWork, Event, Project},
    source::driven::Driven,
    training::{EpochRecord, StopReason},
    worst::worst,
};
use metafmu_runtime::{
    Dynamics, Rows,
    dictionary::{Dictionary, Factor, Term},
    function_set::{FunctionSet, NetworkColumn, NetworkTerm},
};
use std::{ops::Range, time::Instant};

/// Change of a function, relative to its largest value, that is rounding.
const UNCHANGED: f64 = 1e-9;

/// Error of random features, relative to the standard deviation of the worst function, above which a training may be
/// better.
const POOR_NODES: f64 = 1e-4;

/// States from which the standard deviation of an acceleration is found.
const STATES_OF_DEVIATION: usize = 200;

/// Equations that were learned in the way that is exported, and how.
pub(super) struct Learned {
    /// The dictionary.
    pub fitted: FittedEquations,
    /// The equations that are exported.
    pub dynamics: Dynamics,
    /// The positions that are exported.
    pub positions: FunctionSet,
    /// Ranges of the velocities, then of actuator states, if accelerations were learned in them.
    pub velocities: Option<Vec<[f64; 2]>>,
    /// All that were compared; none if the dictionary is exact.
    pub candidates: Vec<Candidate>,
    /// Which of them is exported.
    pub exported: String,
    /// Epochs of the network that is exported.
    pub history: Vec<EpochRecord>,
    /// Its best epoch.
    pub best_epoch: usize,
    /// Reason why the training ended.
    pub stopped: StopReason,
    /// Configurations that it was learned from.
    pub rows: usize,
    /// States at which the equations were compared with those of the mechanism; none if the dictionaries are exact.
    pub compared: Option<ComparedStates>,
}

/// States at which equations are compared.
pub(super) struct ComparedStates {
    /// Where they are.
    pub region: Region,
    /// Standard deviations of the exact accelerations there.
    pub deviations: Vec<f64>,
}

impl ComparedStates {
    fn new(mechanism: &Mechanism, region: Region, seed: u64) -> std::result::Result<Self, MotionError> {
        let samples = Equations::new(mechanism, &region)?.accelerations(STATES_OF_DEVIATION, seed ^ 1)?;
        Ok(Self { deviations: samples.standard_deviations(), region })
    }
}

impl Learned {
    /// Returns true if an input acts on the motion or on an actuator state.
    pub(super) fn is_driven_by(&self, input: usize) -> bool {
        let efforts = self.dynamics.efforts();
        let rates = efforts.count() - self.fitted.actuator_states..efforts.count();
        self.dynamics.is_driven_by(input) || rates.into_iter().any(|rate| efforts.follows_input(rate, input))
    }

    /// Error of the equations that are exported: of functions, relative to their largest values, or of accelerations, relative to their
    /// standard deviations.
    pub(super) fn error(&self) -> f64 {
        let exported = self.candidates.iter().find(|candidate| candidate.name == self.exported);
        exported.map_or(self.fitted.error, |candidate| candidate.error)
    }
}

/// Learns the equations of motion of a mechanism in each way that the study wants compared.
pub(super) fn learn(
    project: &Project,
    dataset: &Dataset,
    (mechanism, driven, region): (&Mechanism, &Driven, &Region),
    checkpoints: &Checkpoints,
) -> Result<Learned> {
    let study = &project.study;
    let began = Instant::now();
    let refuse = |error: MotionError| study.refusal("states", error);
    let of_drivers = driven.drivers().iter().map(|driver| [driver.min, driver.max]);
    let starts = &driven.start()[2 * study.coordinates().count()..];
    let of_actuators =
        study.actuator_states().zip(starts).map(|((_, state), start)| state.range().unwrap_or([*start; 2]));
    let inputs = of_drivers.chain(of_actuators).collect();
    let mut region = Region { inputs, ..region.clone() };
    let fitted = fit(mechanism, &region, study.seed).map_err(refuse)?;
    let exact = fitted.error <= EXACT;
    let tries = |name: &str| study.dynamics.tries(name, exact);
    let rows = 3 * fitted.terms + 50;
    let learns_networks = [NETWORK, DICTIONARY_AND_NETWORK, ACCELERATIONS].into_iter().any(tries);
    let are_forces_exact = fitted.reactions.as_ref().is_none_or(|reactions| reactions.error <= EXACT);
    let is_compared = learns_networks || !(exact && are_forces_exact);
    if is_compared {
        region.velocities = driven.velocities(study, mechanism, &dataset.runs).map_err(refuse)?;
        let of_actuators = region.velocities.split_off(study.coordinates().count());
        region.inputs.splice(driven.drivers().len().., of_actuators);
    }
    if !learns_networks {
        let compared = is_compared.then(|| ComparedStates::new(mechanism, region, study.seed));
        return Ok(Learned {
            dynamics: fitted.dynamics.clone(),
            positions: fitted.positions.clone().into(),
            fitted,
            velocities: None,
            candidates: Vec::new(),
            exported: DICTIONARY.into(),
            history: Vec::new(),
            best_epoch: 0,
            stopped: StopReason::Solved,
            rows,
            compared: compared.transpose().map_err(refuse)?,
        });
    }
    let equations = Equations::new(mechanism, &region).map_err(refuse)?;
    let asked = Asked::new(project, &equations, checkpoints)?;
    let mut last = Last { history: Vec::new(), best_epoch: 0, stopped: StopReason::Solved };
    let known = [fitted.dynamics.function_set().dictionary().clone(), fitted.positions.clone()];
    let mut all = vec![asked.candidate((DICTIONARY, began), &fitted, known, None, [None, None])?];
    for name in [DICTIONARY_AND_NETWORK, NETWORK] {
        if tries(name) && last.stopped != StopReason::Interrupted {
            let began = Instant::now();
            let base = if name == NETWORK { asked.constants()? } else { asked.lowest()? };
            let has_earlier = !last.history.is_empty();
            let networks = asked.networks(&base, &mut last);
            let Some(networks) = unless_interrupted(project, networks, has_earlier)? else {
                last.stopped = StopReason::Interrupted;
                break;
            };
            all.push(asked.candidate((name, began), &fitted, base, None, networks)?);
        }
    }
    if tries(ACCELERATIONS) && last.stopped != StopReason::Interrupted {
        let began = Instant::now();
        let [_, positions] = asked.constants()?;
        let of_positions = asked.network(&positions, 1, &mut last)?;
        let accelerations = Some(asked.accelerations(&mut last)?);
        let base = [identity(&fitted.dynamics)?, positions];
        all.push(asked.candidate((ACCELERATIONS, began), &fitted, base, accelerations, [None, of_positions])?);
    }
    let mut candidates: Vec<Candidate> = all.iter().map(|(candidate, ..)| candidate.clone()).collect();
    let (Candidate { name: exported, .. }, dynamics, positions) =
        all.swap_remove(learned::chosen(&candidates, &study.dynamics));
    candidates.sort_by(|a, b| a.error.total_cmp(&b.error));
    let rows = if exported == DICTIONARY { rows } else { asked.seen.samples.points.len() };
    let actuators = driven.drivers().len();
    let velocities =
        (exported == ACCELERATIONS).then(|| [&region.velocities[..], &region.inputs[actuators..]].concat());
    let Last { history, best_epoch, stopped } = last;
    let deviations = asked.accelerations.standard_deviations();
    let compared = Some(ComparedStates { deviations, region });
    Ok(Learned {
        fitted,
        dynamics,
        positions,
        velocities,
        candidates,
        exported,
        history,
        best_epoch,
        stopped,
        rows,
        compared,
    })
}

/// The equations at sampled states, and the trainings so far.
struct Asked<'a> {
    project: &'a Project<'a>,
    checkpoints: &'a Checkpoints<'a>,
    equations: &'a Equations<'a>,
    factors: Vec<Factor>,
    seen: OfEquations,
    unseen: OfEquations,
    /// Accelerations at unseen states.
    accelerations: EquationSamples,
    /// Largest value of each function.
    scales: Vec<f64>,
    /// `true` if a coordinate or parameter changes a function: shape `[columns, functions]`.
    changes: Vec<Vec<bool>>,
}

/// The last training.
struct Last {
    history: Vec<EpochRecord>,
    best_epoch: usize,
    stopped: StopReason,
}

impl<'a> Asked<'a> {
    fn new(project: &'a Project<'a>, equations: &'a Equations<'a>, checkpoints: &'a Checkpoints<'a>) -> Result<Self> {
        let study = &project.study;
        let refuse = |error: MotionError| study.refusal("states", error);
        let (count, seed) = (learned::states(study), study.seed ^ 0x4e45_5457);
        project.begin(CountedWork::Equations, 1);
        let unseen = held_out(count);
        let all = equations.functions(count, seed).map_err(refuse)?;
        let accelerations = equations.accelerations(unseen, seed ^ 1).map_err(refuse)?;
        let (unseen, seen) = (all.part(0..unseen), all.part(unseen..count));
        project.event(Event::End);
        Ok(Self {
            project,
            checkpoints,
            equations,
            factors: equations.factors(),
            scales: equations.scales(&all.samples),
            changes: equations.dependencies(&seen.samples).map_err(refuse)?,
            seen,
            unseen,
            accelerations,
        })
    }

    /// Ranges of the functions of the equations and of the positions.
    fn ranges(&self) -> [Range<usize>; 2] {
        let [of_equations, of_positions] = self.equations.counts();
        [0..of_equations, of_equations..of_equations + of_positions]
    }

    /// Returns true for each coordinate and parameter that changes some of these functions.
    fn depends(&self, range: &Range<usize>) -> Vec<bool> {
        self.changes.iter().map(|changed| changed[range.clone()].contains(&true)).collect()
    }

    /// Functions that are constant, as a dictionary; the others are zero.
    fn constants(&self) -> Result<[Dictionary; 2]> {
        let labels = &self.seen.samples.labels;
        let first = &labels[0];
        let constant = |function: usize| {
            let limit = UNCHANGED * self.scales[function];
            let is_constant = labels.iter().all(|label| (label[function] - first[function]).abs() <= limit);
            // a small residual of differences is no constant
            if is_constant && first[function].abs() > limit { first[function] } else { 0.0 }
        };
        let constants: Vec<f64> = (0..first.len()).map(constant).collect();
        let [of_equations, of_positions] = self.equations.counts();
        let dictionary = |range: Range<usize>| {
            let term = Term { exponents: vec![0; self.factors.len()], coefficients: constants[range.clone()].to_vec() };
            Dictionary::new(&self.factors, range.len(), &[term])
        };
        Ok([
            dictionary(0..of_equations).map_err(invalid)?,
            dictionary(of_equations..of_equations + of_positions).map_err(invalid)?,
        ])
    }

    /// Dictionaries of the lowest order.
    fn lowest(&self) -> Result<[Dictionary; 2]> {
        let depends = self.ranges().map(|range| self.depends(&range));
        let found = self.equations.lowest([&self.seen.samples, &self.unseen.samples], &depends);
        found.map_err(|message| self.project.study.refusal("states", message))
    }

    /// Networks for the residuals of dictionaries in the equations and the positions; none for a residual of zero.
    fn networks(&self, [equations, positions]: &[Dictionary; 2], last: &mut Last) -> Result<[Option<NetworkTerm>; 2]> {
        Ok([self.network(equations, 0, last)?, self.network(positions, 1, last)?])
    }

    /// One of these.
    fn network(&self, dictionary: &Dictionary, part: usize, last: &mut Last) -> Result<Option<NetworkTerm>> {
        let range = self.ranges()[part].clone();
        let rests = [&self.seen, &self.unseen].map(|asked| rest(dictionary, asked, range.clone()));
        let is_left = |function: &usize| {
            let limit = UNCHANGED * self.scales[range.start + function];
            rests[0].values.iter().any(|rest| rest[*function].abs() > limit)
        };
        let outputs: Vec<usize> = (0..dictionary.outputs()).filter(is_left).collect();
        let depends = self.depends(&range);
        let of: Vec<usize> = (0..self.factors.len()).filter(|column| depends[*column]).collect();
        if outputs.is_empty() || of.is_empty() {
            return Ok(None);
        }
        let columns = network_columns(&self.factors, of.iter().copied());
        let (known, units) = (self.equations.known(), self.equations.units());
        let examples = |asked: &OfEquations, rest: &Rest| Examples {
            inputs: encoded(&columns, &asked.samples.points),
            outputs: rest.values.select(&outputs),
            tangents: Some(Directions {
                inputs: tangents(&columns, &asked.samples.points, &units),
                outputs: rest.tangents(&outputs, &units),
                known: outputs.iter().map(|output| known[range.start + output]).collect(),
            }),
        };
        let (seen, unseen) = (examples(&self.seen, &rests[0]), examples(&self.unseen, &rests[1]));
        // what a dictionary makes of columns that do not change a function is small, but changes what it leaves over
        let changes = |column: &NetworkColumn, output: &usize| {
            dictionary.depends_on(column.of) || self.changes[column.of][range.start + output]
        };
        let of_output = |output: &usize| columns.iter().map(|column| changes(column, output)).collect();
        let depends: Vec<Vec<bool>> = outputs.iter().map(of_output).collect();
        self.learn(columns, outputs, [&seen, &unseen], &depends, last).map(Some)
    }

    /// A network with random features, unless the study states how networks are trained. If that is not exact enough, a
    /// network is trained as well, and the better of both is used. `depends[output][column]`: what changes each output.
    fn learn(
        &self,
        columns: Vec<NetworkColumn>,
        outputs: Vec<usize>,
        [seen, unseen]: [&Examples; 2],
        depends: &[Vec<bool>],
        last: &mut Last,
    ) -> Result<NetworkTerm> {
        let study = &self.project.study;
        let drawn = if study.trains_networks() { None } else { learned::draw(self.project, seen, unseen, depends)? };
        let Some((network, error)) = drawn else { return self.train(columns, outputs, [seen, unseen], last) };
        let nodes = network.layers[0].outputs;
        self.project.note(format_args!(
            "{nodes} nodes with random weights, the last layer by least squares: error {error:.1e} at unseen configurations"
        ));
        let drawn = NetworkTerm::new(columns.clone(), outputs.clone(), network).map_err(invalid)?;
        if error <= POOR_NODES {
            return Ok(drawn);
        }
        let trained = self.train(columns, outputs, [seen, unseen], last)?;
        Ok(if learned::error(trained.network(), unseen) < error { trained } else { drawn })
    }

    /// The network of the accelerations.
    fn accelerations(&self, last: &mut Last) -> Result<NetworkTerm> {
        let study = &self.project.study;
        let refuse = |error: MotionError| study.refusal("states", error);
        let count = learned::states(study);
        let all = self.equations.accelerations(count, study.seed ^ 0x4143_4345).map_err(refuse)?;
        let (unseen, seen) = (all.part(0..held_out(count)), all.part(held_out(count)..count));
        let depends = self.equations.dependencies_of_accelerations(&seen).map_err(refuse)?;
        let of: Vec<usize> = (0..depends.len()).filter(|column| depends[*column]).collect();
        let largest = |row: usize| seen.labels.iter().fold(0.0f64, |largest, label| largest.max(label[row].abs()));
        let rows = 0..seen.labels[0].len();
        let scale = rows.clone().map(largest).fold(0.0, f64::max);
        let outputs: Vec<usize> = rows.filter(|row| largest(*row) > UNCHANGED * scale).collect();
        let columns = network_columns(&self.factors, of.iter().copied());
        let examples = |samples: &EquationSamples| Examples {
            inputs: encoded(&columns, &samples.points),
            outputs: samples.labels.select(&outputs),
            tangents: None,
        };
        let examples = [examples(&seen), examples(&unseen)];
        self.train(columns, outputs, examples.each_ref(), last)
    }

    fn train(
        &self,
        columns: Vec<NetworkColumn>,
        outputs: Vec<usize>,
        [seen, unseen]: [&Examples; 2],
        last: &mut Last,
    ) -> Result<NetworkTerm> {
        let (network, outcome) = learned::train(self.project, [seen, unseen], self.checkpoints)?;
        *last = Last { history: outcome.history, best_epoch: outcome.best_epoch, stopped: outcome.reason };
        NetworkTerm::new(columns, outputs, network).map_err(invalid)
    }

    /// A way to learn the equations, with its error.
    fn candidate(
        &self,
        (name, began): (&str, Instant),
        fitted: &FittedEquations,
        [equations, positions]: [Dictionary; 2],
        forces: Option<NetworkTerm>,
        [of_equations, of_positions]: [Option<NetworkTerm>; 2],
    ) -> Result<(Candidate, Dynamics, FunctionSet)> {
        let efforts = fitted.dynamics.efforts().clone();
        let dynamics = FunctionSet::new(equations, of_equations)
            .and_then(|function_set| Dynamics::with_efforts(efforts, function_set));
        let dynamics = dynamics.and_then(|dynamics| dynamics.with_forces(forces));
        let dynamics = dynamics.and_then(|dynamics| dynamics.with_prescribed(self.equations.prescribed()));
        let dynamics = dynamics.map_err(invalid)?;
        let positions = FunctionSet::new(positions, of_positions).map_err(invalid)?;
        let of_accelerations = acceleration_error(&dynamics, &self.accelerations);
        let of_positions = self.error_of_positions(&positions);
        let error = if of_accelerations >= of_positions { of_accelerations } else { of_positions };
        Ok((Candidate { name: name.into(), error, seconds: began.elapsed().as_secs_f64() }, dynamics, positions))
    }

    /// Root mean square error, relative to the largest value, of the worst position.
    fn error_of_positions(&self, positions: &FunctionSet) -> f64 {
        let [first, count] = self.equations.counts();
        let (mut found, mut squares) = (vec![0.0; count], vec![0.0; count]);
        for (point, label) in self.unseen.samples.points.iter().zip(&self.unseen.samples.labels) {
            positions.evaluate(point, &mut found);
            for ((sum, found), label) in squares.iter_mut().zip(&found).zip(&label[first..]) {
                *sum += (found - label) * (found - label);
            }
        }
        let rows = self.unseen.samples.points.len().max(1) as f64;
        worst(squares.iter().zip(&self.scales[first..]).map(|(sum, scale)| (sum / rows).sqrt() / scale))
    }
}

/// An identity mass matrix, the positions in the efforts, and nothing else in the equations.
fn identity(dynamics: &Dynamics) -> Result<Dictionary> {
    let (n, known) = (dynamics.coordinates(), dynamics.function_set().dictionary());
    let positions = n * (n + 1) / 2 + 1..n * (n + 1) / 2 + 1 + dynamics.efforts().positions();
    let mut terms: Vec<Term> = known.terms().collect();
    for term in &mut terms {
        let others = term.coefficients.iter_mut().enumerate().filter(|(function, _)| !positions.contains(function));
        others.for_each(|(_, coefficient)| *coefficient = 0.0);
    }
    let mut coefficients = vec![0.0; known.outputs()];
    (0..n).for_each(|row| coefficients[row * (row + 1) / 2 + row] = 1.0);
    terms.push(Term { exponents: vec![0; known.exponents()], coefficients });
    let factors: Vec<Factor> = known.factors().collect();
    Dictionary::with_splines(&factors, known.splines(), known.outputs(), &terms).map_err(invalid)
}

/// Residuals of a dictionary in some functions.
#[derive(Default)]
struct Rest {
    /// Row by row.
    values: Rows,
    /// Derivatives with respect to the coordinates: shape `[functions, coordinates]` each.
    gradients: Rows,
}

fn rest(dictionary: &Dictionary, asked: &OfEquations, range: Range<usize>) -> Rest {
    let OfEquations { samples: EquationSamples { points, labels }, gradients, .. } = asked;
    let n = gradients.width() / labels.width().max(1);
    let mut rest = Rest::default();
    for ((point, label), gradient) in points.iter().zip(labels).zip(gradients) {
        let (values, slopes) = dictionary.with_gradient(point, n);
        rest.values.push(&difference(&label[range.clone()], &values));
        rest.gradients.push(&difference(&gradient[range.start * n..range.end * n], &slopes));
    }
    rest
}

fn difference(labels: &[f64], values: &[f64]) -> Vec<f64> {
    labels.iter().zip(values).map(|(label, value)| label - value).collect()
}

impl Rest {
    /// Derivatives of some functions along each coordinate, in these units: row by row and, in a row, coordinate by coordinate.
    fn tangents(&self, outputs: &[usize], units: &[f64]) -> Rows {
        let mut tangents = Rows::default();
        for gradient in &self.gradients {
            for (k, unit) in units.iter().enumerate() {
                let along = outputs.iter().map(|output| unit * gradient[output * units.len() + k]);
                tangents.push(&along.collect::<Vec<_>>());
            }
        }
        tangents
    }
}

/// Derivatives of columns along each coordinate, in these units: row by row and, in a row, coordinate by coordinate.
fn tangents(columns: &[NetworkColumn], points: &Rows, units: &[f64]) -> Rows {
    let mut tangents = Rows::default();
    for point in points {
        for (k, unit) in units.iter().enumerate() {
            let slope = |column: &NetworkColumn| if column.of == k { unit * column.slope(point) } else { 0.0 };
            tangents.push(&columns.iter().map(slope).collect::<Vec<_>>());
        }
    }
    tangents
}
