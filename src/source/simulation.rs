//! Runs that are simulated here: parameter values in, a run out.

use super::{
    Journal, MovingPoint, before_start, calibration_runs,
    driven::Driven,
    fmu::{self, FmuModel},
    list, wrong_unit,
};
use crate::{
    Error, Result,
    dataset::{Dataset, Run},
    diagnostics::{Problems, names::expected_one_of},
    fmi::Workers,
    integrate::{Budget, TOLERANCE},
    multibody::{Mechanism, description::MechanismOutput},
    sampling::Plan,
    study::{SourceOptions, Study},
    systems::{SYSTEMS, System},
    variable::SourceVariable,
};
use rayon::prelude::*;
use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

/// `source.max_failed` unless given.
const MAX_FAILED: f64 = 0.1;

/// What is simulated, with the study's parameters and outputs resolved.
#[derive(Clone, Debug)]
pub struct Simulation {
    model: SimulationModel,
    /// Of runs that go on from sample to sample, what outputs and inputs were before the start are such, too.
    parameters: Vec<SourceVariable>,
    inputs: Vec<SourceVariable>,
    outputs: Vec<SourceVariable>,
    /// What the points of a plan have.
    planned: Vec<String>,
    is_discrete: bool,
    times: Arc<[f64]>,
    /// Share of the runs that may fail.
    max_failed: f64,
    /// The file or the built-in system, for messages.
    source: String,
}

/// Model that is simulated.
#[derive(Clone, Debug)]
enum SimulationModel {
    /// This program.
    Equations(Box<SimulatedEquations>),
    /// An FMU.
    Fmu(Box<FmuModel>),
}

/// A run, or the reason of its failure.
pub type RunOutcome = std::result::Result<Run, String>;

impl Simulation {
    /// Finds the study's system, mechanism or FMU and in it the study's parameters, constants and outputs.
    ///
    /// # Errors
    /// [`Error::Study`] with every name the source does not know and every unit that is not the source's; the errors of an
    /// FMU that cannot be read.
    pub fn new(study: &Study) -> Result<Self> {
        let times = study.time.training_grid().into();
        let SourceOptions { system, mechanism, fmu, .. } = &study.source;
        let max_failed = study.source.max_failed.unwrap_or(MAX_FAILED);
        let source = match fmu.as_ref().or(mechanism.as_ref()) {
            Some(file) => study.beside(file).display().to_string(),
            None => system.clone().unwrap_or_default(),
        };
        let (model, parameters, outputs) = match fmu {
            Some(file) => {
                let (model, parameters, outputs) = FmuModel::new(study, &study.beside(file))?;
                (SimulationModel::Fmu(Box::new(model)), parameters, outputs)
            }
            None => {
                let (equations, parameters, outputs) = SimulatedEquations::new(study)?;
                (SimulationModel::Equations(Box::new(equations)), parameters, outputs)
            }
        };
        let planned = study.planned().map(|(name, _)| name.to_owned()).collect();
        let (inputs, is_discrete) = (Vec::new(), study.is_discrete());
        let mut simulation =
            Self { model, parameters, inputs, outputs, planned, is_discrete, times, max_failed, source };
        simulation.inputs = simulation.driven().map_or(Vec::new(), Driven::variables);
        if is_discrete {
            simulation.parameters.extend(before_start(simulation.outputs.iter().chain(&simulation.inputs)));
        }
        let kinds = calibration_runs::kinds(study, simulation.driven());
        if let Some(driven) = simulation.driven_mut() {
            driven.set_kinds(kinds);
        }
        Ok(simulation)
    }

    /// The plan of the study, whose calibration runs have further kinds of signals if inputs drive them.
    pub fn plan(&self, study: &Study) -> Plan {
        calibration_runs::plan(study, self.driven()).0
    }

    fn driven_mut(&mut self) -> Option<&mut Driven> {
        match &mut self.model {
            SimulationModel::Equations(equations) => equations.driven.as_mut(),
            SimulationModel::Fmu(model) => model.driven_mut(),
        }
    }

    /// What drives the runs, in the source's order.
    pub fn inputs(&self) -> &[SourceVariable] {
        &self.inputs
    }

    /// How runs start and what drives them, if inputs do.
    pub fn driven(&self) -> Option<&Driven> {
        match &self.model {
            SimulationModel::Equations(equations) => equations.driven.as_ref(),
            SimulationModel::Fmu(model) => model.driven(),
        }
    }

    /// Values of the quantities of the mechanism or system; those of parameters are overwritten for each run.
    pub fn quantities(&self) -> &[f64] {
        match &self.model {
            SimulationModel::Equations(equations) => &equations.quantities,
            SimulationModel::Fmu(_) => &[],
        }
    }

    /// The FMU, if it is one.
    pub fn fmu(&self) -> Option<&FmuModel> {
        match &self.model {
            SimulationModel::Equations(_) => None,
            SimulationModel::Fmu(model) => Some(model),
        }
    }

    /// The parameters, in the study's order.
    pub fn parameters(&self) -> &[SourceVariable] {
        &self.parameters
    }

    /// The outputs, in the study's order.
    pub fn outputs(&self) -> &[SourceVariable] {
        &self.outputs
    }

    /// Points whose paths follow from the outputs; an FMU does not describe any.
    pub fn points(&self) -> Vec<MovingPoint> {
        let outputs: Vec<&str> = self.outputs.iter().map(|output| output.name.as_str()).collect();
        match &self.model {
            SimulationModel::Equations(equations) => {
                let SimulatedEquations { simulator, quantities, parameter_positions, .. } = &**equations;
                simulator.points(quantities, parameter_positions, &outputs)
            }
            SimulationModel::Fmu(_) => Vec::new(),
        }
    }

    /// The times of a training run's rows, in seconds; other runs are cut off at the study's `time.stop`.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Simulates one run of a system or a mechanism.
    ///
    /// # Errors
    /// [`Error::Run`] with the parameter values if the simulation fails, [`Error::Worker`] for an FMU: its runs need worker
    /// processes, see [`Simulation::run_all`].
    pub fn run(&self, parameters: &[f64]) -> Result<Run> {
        match &self.model {
            SimulationModel::Equations(equations) => {
                let outputs = equations.run(parameters, &self.times, &[]);
                let outputs = outputs.map_err(|message| self.failure(&equations.name, parameters, message))?;
                Ok(self.run_of(parameters, outputs))
            }
            SimulationModel::Fmu(_) => {
                let message = "runs of an FMU need worker processes".into();
                Err(Error::Worker { message })
            }
        }
    }

    /// Tries a run of a system or mechanism: why it fails, if that takes no longer than `limit`; none of an FMU.
    pub fn attempt(
        &self,
        point: &[f64],
        limit: Duration,
        stop: &AtomicBool,
    ) -> Option<std::result::Result<(), String>> {
        let SimulationModel::Equations(equations) = &self.model else { return None };
        let limited = SimulatedEquations { time_limit: Some(limit), ..(**equations).clone() };
        let begin = Instant::now();
        let outcome = limited.run(point, &self.times, &[stop]).map(|_| ());
        Some(if begin.elapsed() < limit { outcome } else { Ok(()) })
    }

    fn failure(&self, system: &str, parameters: &[f64], message: String) -> Error {
        Error::Run { system: system.into(), values: self.values(parameters), message }
    }

    /// The values of a point of a plan, for messages.
    pub fn values(&self, point: &[f64]) -> String {
        list(self.planned.iter().zip(point).map(|(name, value)| format!("{name} = {value}")))
    }

    /// The run of a point of a plan from its outputs, row by row. Before one that goes on from sample to sample outputs were what they are in
    /// the first row, and inputs have their start values, as before a recorded run.
    pub fn run_of(&self, point: &[f64], outputs: Vec<f64>) -> Run {
        let inputs = self.driven().map_or(Vec::new(), |driven| driven.inputs(point, &self.times));
        let mut parameters = point.to_vec();
        if self.is_discrete {
            parameters.truncate(self.parameters.len() - self.outputs.len() - self.inputs.len());
            parameters.extend_from_slice(&outputs[..self.outputs.len()]);
            parameters.extend(self.driven().iter().flat_map(|driven| driven.drivers()).map(|driver| driver.start));
        }
        Run { parameters, times: Arc::clone(&self.times), inputs, outputs }
    }

    /// The journal of a sampling of the study, in a file.
    ///
    /// # Errors
    /// As [`Journal::open`].
    pub fn journal(&self, path: &Path, study: &Study) -> Result<Journal> {
        let outputs = self.times.len() * self.outputs.len();
        Journal::open(path, &study.sampling_digest(), self.planned.len(), outputs)
    }

    /// Simulates a run for each point, over all cores, in the order of the points; runs that are in the journal are taken
    /// from there. `done` is called after each run; when the token of `workers` turns true, runs that have begun are abandoned. A share of the `total`
    /// that the points are all or part of may fail.
    ///
    /// # Errors
    /// [`Error::FailedRuns`] as soon as more runs have failed than may, [`Error::Interrupted`], [`Error::Io`] of the journal; of
    /// an FMU as [`FmuModel::run_all`].
    pub fn run_all(
        &self,
        points: &[Vec<f64>],
        total: usize,
        journal: &Journal,
        workers: Workers<'_>,
        done: impl Fn() + Sync,
    ) -> Result<Vec<RunOutcome>> {
        let outcomes = match &self.model {
            SimulationModel::Equations(equations) => {
                self.solve_all(equations, points, total, journal, workers.stop, done)?
            }
            SimulationModel::Fmu(model) => {
                let failed = AtomicUsize::new(0);
                let failure = |point: &[f64], reason: &str| {
                    self.allow(failed.fetch_add(1, Ordering::Relaxed) + 1, total, point, reason)
                };
                model.run_all(points, Some(journal), workers, &failure, done)?
            }
        };
        let made = |(outcome, point): (fmu::FmuOutcome, &Vec<f64>)| outcome.map(|outputs| self.run_of(point, outputs));
        Ok(outcomes.into_iter().zip(points).map(made).collect())
    }

    /// Runs begin in the order of the points, and those that have begun end, so that the same failures are too many for any
    /// number of threads.
    fn solve_all(
        &self,
        equations: &SimulatedEquations,
        points: &[Vec<f64>],
        total: usize,
        journal: &Journal,
        stop: &AtomicBool,
        done: impl Fn() + Sync,
    ) -> Result<Vec<fmu::FmuOutcome>> {
        let solve = |point: &Vec<f64>| {
            if let Some(outputs) = journal.get(point) {
                return Ok(Ok(outputs.to_vec()));
            }
            let begin = Instant::now();
            let outcome = equations.run(point, &self.times, &[stop]);
            match &outcome {
                Err(_) if stop.load(Ordering::Relaxed) => return Err(Error::Interrupted),
                Ok(outputs) => journal.keep(point, outputs, begin.elapsed())?,
                Err(_) => {}
            }
            Ok(outcome)
        };
        let (next, failed, halt) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicBool::new(false));
        let allowed = self.allowed(total);
        let run = |_: &Vec<f64>| {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if halt.load(Ordering::Relaxed) {
                return (index, None);
            }
            let outcome = if stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { solve(&points[index]) };
            let has_memory = match &outcome {
                Ok(Ok(_)) => true,
                Ok(Err(_)) => failed.fetch_add(1, Ordering::Relaxed) < allowed,
                Err(_) => false,
            };
            if !has_memory {
                halt.store(true, Ordering::Relaxed);
            }
            done();
            (index, Some(outcome))
        };
        let mut outcomes: Vec<_> = points.par_iter().map(run).collect();
        outcomes.sort_unstable_by_key(|(index, _)| *index);
        let outcomes = outcomes.into_iter().filter_map(|(_, outcome)| outcome).collect::<Result<Vec<_>>>()?;
        let mut failures =
            points.iter().zip(&outcomes).filter_map(|(point, outcome)| Some((point, outcome.as_ref().err()?)));
        failures.nth(allowed).map_or(Ok(()), |(point, reason)| self.allow(allowed + 1, total, point, reason))?;
        Ok(outcomes)
    }

    /// How many of `total` runs may fail.
    fn allowed(&self, total: usize) -> usize {
        (self.max_failed * total as f64).floor() as usize
    }

    /// Refuses more failed runs than there may be; the last one had parameters and a reason.
    fn allow(&self, failed: usize, total: usize, point: &[f64], reason: &str) -> Result<()> {
        let (share, reason) = (self.max_failed, reason.to_owned());
        let allowed = self.allowed(total);
        if failed <= allowed {
            return Ok(());
        }
        let (source, parameters) = (self.source.clone(), self.values(point));
        Err(Error::FailedRuns { source_name: source, failed, total, allowed, share, parameters, reason })
    }

    /// Refuses more failed runs than a plan may have.
    ///
    /// # Errors
    /// [`Error::FailedRuns`].
    pub fn check_failures(&self, points: &[Vec<f64>], outcomes: &[RunOutcome]) -> Result<()> {
        let failed = points.iter().zip(outcomes).filter_map(|(point, outcome)| Some((point, outcome.as_ref().err()?)));
        let last = failed.clone().next_back();
        last.map_or(Ok(()), |(point, reason)| self.allow(failed.count(), points.len(), point, reason))
    }

    /// Runs with the names of their columns; those that failed are left out.
    pub fn dataset(&self, outcomes: Vec<RunOutcome>) -> Dataset {
        let runs = outcomes.into_iter().filter_map(std::result::Result::ok).collect();
        let (parameters, inputs) = (self.parameters.clone(), self.inputs.clone());
        Dataset { parameters, inputs, outputs: self.outputs.clone(), runs }
    }
}

/// A system or mechanism, the study's names found in it.
#[derive(Clone, Debug)]
struct SimulatedEquations {
    /// Name for messages.
    name: String,
    simulator: EquationSolver,
    /// Tolerance of the integration.
    tolerance: f64,
    /// Time limit of a run.
    time_limit: Option<Duration>,
    /// Value of each quantity; those of parameters are overwritten for each run.
    quantities: Vec<f64>,
    /// Position of each parameter among the quantities.
    parameter_positions: Vec<usize>,
    /// Position of each output among those of a simulation's rows.
    output_positions: Vec<usize>,
    /// How runs start and what drives them, if the study wants states.
    driven: Option<Driven>,
}

/// Solver of the equations.
#[derive(Clone, Debug)]
enum EquationSolver {
    System(&'static System),
    Mechanism(Arc<Mechanism>),
}

impl EquationSolver {
    /// Every quantity that may be a parameter or a constant, with its default.
    fn quantities(&self) -> Vec<(SourceVariable, f64)> {
        match self {
            Self::System(system) => {
                let quantities = system.quantities.iter();
                quantities.map(|q| (SourceVariable::new(q.name, q.unit, q.description), q.default)).collect()
            }
            Self::Mechanism(mechanism) => {
                let parameters = mechanism.parameters().iter();
                parameters.map(|(name, p)| (SourceVariable::new(name, &p.unit, &p.description), p.default)).collect()
            }
        }
    }

    /// Points whose paths follow from the outputs with these names, given the quantities' values.
    fn points(&self, quantities: &[f64], parameters: &[usize], outputs: &[&str]) -> Vec<MovingPoint> {
        match self {
            Self::System(system) => {
                let points = system.points.iter();
                points.filter_map(|point| MovingPoint::of_system(point, quantities, parameters, outputs)).collect()
            }
            Self::Mechanism(mechanism) => {
                let column = |measure: &str| {
                    let named = |name: &&str| mechanism.description().outputs.get(*name);
                    outputs.iter().position(|name| named(name).is_some_and(|output| output.measure.trim() == measure))
                };
                let point = |(_, output): (&String, &MechanismOutput)| {
                    let point = output.measure.trim().strip_suffix(".x")?;
                    Some(MovingPoint::of_outputs(point, column(&format!("{point}.x"))?, column(&format!("{point}.y"))?))
                };
                mechanism.description().outputs.iter().filter_map(point).collect()
            }
        }
    }

    /// Every output, in the order of a simulation's rows.
    fn outputs(&self) -> Vec<SourceVariable> {
        match self {
            Self::System(system) => {
                let outputs = system.outputs.iter();
                outputs.map(|output| SourceVariable::new(output.name, output.unit, output.description)).collect()
            }
            Self::Mechanism(mechanism) => mechanism.outputs().to_vec(),
        }
    }

    fn simulate(&self, quantities: &[f64], times: &[f64], tolerance: f64, budget: &Budget) -> fmu::FmuOutcome {
        match self {
            Self::System(system) => (system.simulate)(quantities, times, tolerance, budget),
            Self::Mechanism(mechanism) => mechanism.simulate(quantities, times, tolerance, budget),
        }
    }

    fn output_count(&self) -> usize {
        match self {
            Self::System(system) => system.outputs.len(),
            Self::Mechanism(mechanism) => mechanism.outputs().len(),
        }
    }
}

impl SimulatedEquations {
    /// Also the variables of the study's parameters and outputs.
    fn new(study: &Study) -> Result<(Self, Vec<SourceVariable>, Vec<SourceVariable>)> {
        let name = study.source.system.clone();
        let simulator = match (study.mechanism(), name.as_deref().unwrap_or_default()) {
            (Some(mechanism), _) => EquationSolver::Mechanism(Arc::clone(mechanism)),
            (None, name) => EquationSolver::System(System::of(name).ok_or_else(|| {
                let known: Vec<&str> = SYSTEMS.iter().map(|system| system.name).collect();
                study.refusal("source.system", format!("no system `{name}`, {}", expected_one_of(name, &known)))
            })?),
        };
        let name = name.unwrap_or_else(|| "the mechanism".to_owned());
        let quantities = simulator.quantities().iter().map(|(_, default)| *default).collect();
        let (parameter_positions, output_positions) = (Vec::new(), Vec::new());
        let tolerance = study.source.tolerance.unwrap_or(TOLERANCE);
        let time_limit = study.source.time_limit();
        let mut equations = Self {
            name,
            simulator,
            tolerance,
            time_limit,
            quantities,
            parameter_positions,
            output_positions,
            driven: None,
        };
        let (mut parameters, mut outputs) = (Vec::new(), Vec::new());
        let mut problems = equations.resolve_inputs(study, &mut parameters);
        problems.extend(equations.resolve_outputs(study, &mut outputs));
        if let (true, EquationSolver::Mechanism(mechanism)) = (study.has_states(), &equations.simulator) {
            match Driven::new(study, mechanism, &equations.quantities, problems.is_empty()) {
                Ok(driven) => {
                    parameters.extend(driven.starts());
                    equations.driven = Some(driven);
                }
                Err(more) => problems.extend(more),
            }
        }
        study.refuse(problems)?;
        Ok((equations, parameters, outputs))
    }

    /// Outputs of a run, row by row, in the study's order; any of the flags ends it early.
    fn run(&self, parameters: &[f64], times: &[f64], stops: &[&AtomicBool]) -> fmu::FmuOutcome {
        let mut quantities = self.quantities.clone();
        for (&position, &value) in self.parameter_positions.iter().zip(parameters) {
            quantities[position] = value;
        }
        let budget = Budget::new(stops, self.time_limit);
        let rows = match (&self.driven, &self.simulator) {
            (Some(driven), EquationSolver::Mechanism(mechanism)) => {
                driven.simulate(mechanism, &quantities, parameters, times, (self.tolerance, &budget))?
            }
            _ => self.simulator.simulate(&quantities, times, self.tolerance, &budget)?,
        };
        let rows = rows.chunks(self.simulator.output_count());
        Ok(rows.flat_map(|row| self.output_positions.iter().map(|&position| row[position])).collect())
    }

    fn resolve_inputs(&mut self, study: &Study, parameters: &mut Vec<SourceVariable>) -> Problems {
        let mut problems = Problems::default();
        let quantities: Vec<SourceVariable> =
            self.simulator.quantities().into_iter().map(|(quantity, _)| quantity).collect();
        let unknown = |name: &str| {
            let known: Vec<&str> = quantities.iter().map(|quantity| quantity.name.as_str()).collect();
            format!("{} has no quantity `{name}`, {}", self.name, expected_one_of(name, &known))
        };
        for (name, &value) in &study.source.constants {
            let key = format!("source.constants.{name}");
            match quantities.iter().position(|quantity| quantity.name == *name) {
                None => problems.add(key, unknown(name)),
                Some(_) if study.parameters.contains_key(name) => {
                    problems.add(key, "is a parameter: a quantity is either constant or varied");
                }
                Some(_) if !value.is_finite() => problems.add(key, format!("{value} is not finite")),
                Some(position) => self.quantities[position] = value,
            }
        }
        for (name, parameter) in &study.parameters {
            let key = format!("parameters.{name}");
            match quantities.iter().position(|quantity| quantity.name == *name) {
                None => problems.add(key, unknown(name)),
                Some(position) => {
                    let quantity = &quantities[position];
                    problems.extend(wrong_unit(&key, parameter.unit.as_deref(), &quantity.unit));
                    self.parameter_positions.push(position);
                    let description = parameter.description.as_deref().unwrap_or(&quantity.description);
                    parameters.push(SourceVariable::new(name, &quantity.unit, description));
                }
            }
        }
        problems
    }

    fn resolve_outputs(&mut self, study: &Study, outputs: &mut Vec<SourceVariable>) -> Problems {
        let mut problems = Problems::default();
        let known = self.simulator.outputs();
        for (name, output) in &study.outputs {
            let key = format!("outputs.{name}");
            match known.iter().position(|known| known.name == *name) {
                None => {
                    let known: Vec<&str> = known.iter().map(|output| output.name.as_str()).collect();
                    let message = format!("{} has no output `{name}`, {}", self.name, expected_one_of(name, &known));
                    problems.add(key, message);
                }
                Some(position) => {
                    problems.extend(wrong_unit(&key, output.unit.as_deref(), &known[position].unit));
                    self.output_positions.push(position);
                    let description = output.description.as_deref().unwrap_or(&known[position].description);
                    outputs.push(SourceVariable::new(name, &known[position].unit, description));
                }
            }
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn study(from: &str, to: &str) -> Study {
        let text = SYSTEMS[0].study;
        assert!(text.contains(from));
        Study::parse(&text.replacen(from, to, 1), Path::new("s.toml")).unwrap()
    }

    #[test]
    fn every_system_has_a_study_that_it_accepts() {
        for system in SYSTEMS {
            let study = Study::parse(system.study, Path::new("s.toml")).unwrap();
            assert_eq!(study.name, system.name);
            assert_eq!(study.source.system.as_deref(), Some(system.name));
            let simulation = Simulation::new(&study).unwrap();
            let middle: Vec<f64> = study.parameters.values().map(|p| 0.5 * (p.min + p.max)).collect();
            let run = simulation.run(&middle).unwrap();
            assert_eq!(run.outputs.len(), simulation.times().len() * simulation.outputs().len());
        }
    }

    #[test]
    fn a_system_with_states_moves_as_its_equations_say() {
        // parameters, coordinates at the start, velocities there
        let pendulum: &[(&str, f64)] = &[("L", 0.17), ("c", 0.1), ("theta0", 0.7), ("thetad0", -1.3)];
        let double =
            &[("L1", 1.3), ("L2", 2.2), ("theta10", 1.1), ("theta20", -0.4), ("theta1d0", 0.2), ("theta2d0", 0.6)];
        for (name, states, outputs, point) in [
            ("single-pendulum", &["pivot.angle"][..], &["theta", "thetad", "thetadd"][..], pendulum),
            ("double-pendulum", &["upper.angle", "lower.angle"], &["theta1", "theta2", "theta1d", "theta2d"], double),
        ] {
            let (parameters, constant) = (point.len() - 2 * states.len(), if states.len() == 1 { "m" } else { "m2" });
            let list = |names: &mut dyn Iterator<Item = String>| names.collect::<Vec<_>>().join("\n");
            let text = format!(
                "name = \"s\"\nstructure = \"dynamics\"\n[source]\nsystem = \"{name}\"\nconstants = {{ {constant} = 0.8 }}\n\
                 [time]\nstop = 2\nstep = 0.05\n[parameters]\n{}\n[states]\n{}\n[outputs]\n{}\n",
                list(&mut point[..parameters].iter().map(|(name, _)| format!("{name} = {{ min = 0, max = 3 }}"))),
                list(&mut states.iter().map(|name| format!("{name} = {{ min = -3.2, max = 3.2 }}"))),
                list(&mut outputs.iter().map(|name| format!("{name} = {{}}"))),
            );
            let study = Study::parse(&text, Path::new("s.toml")).unwrap();
            let simulation = Simulation::new(&study).unwrap();
            let run = simulation.run(&point.iter().map(|(_, value)| *value).collect::<Vec<_>>()).unwrap();

            let system = System::of(name).unwrap();
            let quantities = system.quantities.iter().map(|quantity| {
                let given = point.iter().find(|(name, _)| *name == quantity.name).map(|(_, value)| *value);
                given.unwrap_or(if quantity.name == constant { 0.8 } else { quantity.default })
            });
            let quantities: Vec<f64> = quantities.collect();
            let exact = (system.simulate)(&quantities, simulation.times(), TOLERANCE, &Budget::default()).unwrap();
            assert_eq!(run.outputs.len(), exact.len());
            for (output, _) in outputs.iter().enumerate() {
                let column =
                    |values: &[f64]| values.iter().skip(output).step_by(outputs.len()).copied().collect::<Vec<_>>();
                let (run, exact) = (column(&run.outputs), column(&exact));
                let largest = exact.iter().fold(1.0f64, |largest, value| largest.max(value.abs()));
                for (run, exact) in run.iter().zip(&exact) {
                    assert!((run - exact).abs() < 1e-9 * largest, "{name}, {}: {run} {exact}", outputs[output]);
                }
            }
        }
    }

    #[test]
    fn every_mechanism_has_a_study_that_simulates() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/mechanisms");
        let names = ["single-pendulum", "double-pendulum", "slider-crank", "four-bar", "quarter-car", "scotch-yoke"];
        for name in names {
            let study = Study::load(&folder.join(format!("{name}-study.toml"))).unwrap();
            let simulation = Simulation::new(&study).unwrap();
            for end in [0.0, 0.5, 1.0] {
                let point: Vec<f64> = study.parameters.values().map(|p| p.min + end * (p.max - p.min)).collect();
                let run = simulation.run(&point).unwrap();
                assert_eq!(run.outputs.len(), simulation.times().len() * simulation.outputs().len(), "{name}");
            }
        }
    }

    #[test]
    fn the_studys_tolerance_is_that_of_the_integration() {
        let mechanism = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/mechanisms/single-pendulum-study.toml");
        let of_mechanism = std::fs::read_to_string(&mechanism).unwrap();
        for (text, path) in [(SYSTEMS[0].study, Path::new("s.toml")), (&of_mechanism, &mechanism)] {
            let run = |tolerance: &str| {
                let text = text.replacen("[source]", &format!("[source]\n{tolerance}"), 1);
                Simulation::new(&Study::parse(&text, path).unwrap()).unwrap().run(&[0.1, 0.05, 2.0]).unwrap().outputs
            };
            let (usual, same, loose) = (run(""), run("tolerance = 1e-13"), run("tolerance = 1e-6"));
            assert_eq!(usual, same);
            let difference = usual.iter().zip(&loose).map(|(usual, loose)| (usual - loose).abs()).fold(0.0, f64::max);
            assert!((1e-9..1e-2).contains(&difference), "{difference:e}");
        }
    }

    /// A slider crank whose rod is too short at some of the points.
    fn short_rods(options: &str) -> (Study, Vec<Vec<f64>>) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/mechanisms/slider-crank-study.toml");
        let text = std::fs::read_to_string(&path).unwrap().replacen("[source]", &format!("[source]\n{options}"), 1);
        let study = Study::parse(&text, &path).unwrap();
        let ratio = study.parameters.get_index_of("L_over_r").unwrap();
        let middle: Vec<f64> = study.parameters.values().map(|p| 0.5 * (p.min + p.max)).collect();
        let point = |run: usize| {
            let mut point = middle.clone();
            point[ratio] = if run % 10 == 3 { 0.6 } else { 3.0 };
            point
        };
        (study, (0..20).map(point).collect())
    }

    /// Equations are solved in this process.
    fn no_workers(stop: &AtomicBool) -> Workers<'_> {
        Workers { program: Path::new(""), stop }
    }

    #[test]
    fn runs_of_a_mechanism_may_fail_as_long_as_they_are_few() {
        let folder = tempfile::tempdir().unwrap();
        let run_all = |options: &str, total: usize| {
            let (study, points) = short_rods(options);
            let simulation = Simulation::new(&study).unwrap();
            let journal = simulation.journal(&folder.path().join("runs"), &study).unwrap();
            let outcomes = simulation.run_all(&points, total, &journal, no_workers(&AtomicBool::new(false)), || ())?;
            simulation.check_failures(&points, &outcomes)?;
            Ok::<_, Error>((outcomes.iter().map(std::result::Result::is_ok).collect(), simulation.dataset(outcomes)))
        };
        let (outcomes, dataset): (Vec<bool>, _) = run_all("", 20).unwrap();
        assert_eq!(outcomes, (0..20).map(|run| run % 10 != 3).collect::<Vec<_>>());
        assert_eq!(dataset.runs.len(), 18);
        for (options, total) in [("max_failed = 0.09", 20), ("", 10)] {
            let message = run_all(options, total).unwrap_err().to_string();
            assert!(
                message.contains(&format!("2 of {total} runs failed, at most 1 may (source.max_failed = ")),
                "{message}"
            );
            assert!(message.contains("L_over_r = 0.6: ") && message.contains("`joints."), "{message}");
        }
    }

    #[test]
    fn a_run_that_takes_long_ends_at_the_time_limit_and_when_it_is_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let spring = "coordinate = \"pivot.angle\"\nstiffness = 1e8\n";
        let text = include_str!("../../examples/mechanisms/single-pendulum.toml");
        let text = text.replacen("coordinate = \"pivot.angle\"\n", spring, 1);
        std::fs::write(folder.path().join("m.toml"), text).unwrap();
        let simulation = |options: &str| {
            let source = format!("mechanism = \"m.toml\"\n{options}");
            let text = SYSTEMS[0].study.replacen("system = \"single-pendulum\"", &source, 1);
            let study = Study::parse(&text, &folder.path().join("s.toml")).unwrap();
            (Simulation::new(&study).unwrap(), study)
        };
        let points = [vec![0.1, 0.05, 2.0]];
        let begin = Instant::now();
        let message = simulation("time_limit = 0.2").0.run(&points[0]).unwrap_err().to_string();
        assert!(message.contains("took longer than 200ms (source.time_limit) and came to t = 0.0"), "{message}");

        let (simulation, study) = simulation("");
        let journal = simulation.journal(&folder.path().join("runs"), &study).unwrap();
        let stop = AtomicBool::new(false);
        let outcome = std::thread::scope(|scope| {
            let outcome = scope.spawn(|| simulation.run_all(&points, 1, &journal, no_workers(&stop), || ()));
            std::thread::sleep(Duration::from_millis(200));
            stop.store(true, Ordering::Relaxed);
            outcome.join().unwrap()
        });
        assert!(matches!(outcome, Err(Error::Interrupted)), "{outcome:?}");
        assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
    }

    #[test]
    fn a_mechanisms_content_counts_for_the_digest_and_its_layout_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let digest = |mechanism: String| {
            std::fs::write(folder.path().join("m.toml"), mechanism).unwrap();
            let text = SYSTEMS[0].study.replacen("system = \"single-pendulum\"", "mechanism = \"m.toml\"", 1);
            Study::parse(&text, &folder.path().join("s.toml")).unwrap().sampling_digest()
        };
        let text = include_str!("../../examples/mechanisms/single-pendulum.toml");
        let first = digest(text.to_owned());
        assert_eq!(digest(format!("# a comment\n{text}")), first);
        assert_ne!(digest(text.replacen("inertia = 0 ", "inertia = 1 ", 1)), first);
        assert_ne!(digest(text.replacen("augmented", "embedding", 1)), first);
    }

    #[test]
    fn outputs_come_in_the_studys_order_and_constants_count() {
        let all = Simulation::new(&study("seed", "seed")).unwrap().run(&[0.1, 0.05, 2.0]).unwrap();
        let text = SYSTEMS[0].study.replace("m = 0.3", "m = 0.6");
        let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("theta = ")).collect();
        let study = Study::parse(&lines.join("\n"), Path::new("s.toml")).unwrap();
        let two = Simulation::new(&study).unwrap().run(&[0.1, 0.1, 2.0]).unwrap();
        // twice the mass and twice the damping: the same motion
        for (two, all) in two.outputs.chunks(2).zip(all.outputs.chunks(3)) {
            assert!((two[0] - all[1]).abs() < 1e-9 && (two[1] - all[2]).abs() < 1e-7);
        }
    }

    #[test]
    fn unknown_names_and_foreign_units_are_refused() {
        for (from, to, says) in [
            ("system = \"single", "system = \"triple", "no system `triple-pendulum`"),
            ("\nc = {", "\nd = {", "no quantity `d`, expected one of L, c, thetad0"),
            ("\nthetad = {", "\nomega = {", "no output `omega`"),
            ("unit = \"m\"", "unit = \"mm\"", "`mm`, expected `m`"),
            ("m = 0.3", "L = 0.3", "is a parameter"),
        ] {
            let message = Simulation::new(&study(from, to)).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
