//! Runs that are simulated here: parameter values in, a run out.

use super::{
    FailureCause, Journal, MovingMechanism, MovingPoint, RunFailure, before_start, calibration_runs,
    driven::Driven,
    list,
    setting::SourceSetting,
    worker::{RunOutputs, WorkerModel},
    wrong_unit,
};
use crate::{
    Error, Result,
    dataset::{Dataset, Run},
    diagnostics::{Problems, names::expected_one_of, numbers::exact},
    fmi::Workers,
    integrate::{Budget, TOLERANCE},
    multibody::{BodyMotion, Mechanism},
    sampling::Plan,
    study::{SourceOptions, Study},
    systems::{SYSTEMS, System},
    variable::SourceVariable,
};
use metafmu_runtime::Rows;
use rayon::prelude::*;
use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

/// Default `source.max_failed`.
const MAX_FAILED: f64 = 0.1;

/// Simulated source, with the study's parameters and outputs resolved.
#[derive(Clone, Debug)]
pub struct Simulation {
    model: SimulationModel,
    /// Parameters. For discrete-time models they include the values of outputs and inputs before the start.
    parameters: Vec<SourceVariable>,
    inputs: Vec<SourceVariable>,
    outputs: Vec<SourceVariable>,
    /// Names of the quantities in the points of a plan.
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
    /// Worker processes, for an FMU or a program.
    Apart(Box<WorkerModel>),
}

/// A run, or its failure.
pub type RunOutcome = std::result::Result<Run, RunFailure>;

impl Simulation {
    /// Finds the study's system, mechanism, FMU or program and in it the study's parameters, constants and outputs.
    ///
    /// # Errors
    /// [`Error::Study`] with every name the source does not know and every unit that is not the source's; the errors of an
    /// FMU that cannot be read.
    pub fn new(study: &Study) -> Result<Self> {
        let times = study.time.training_grid().into();
        let SourceOptions { system, mechanism, fmu, command, .. } = &study.source;
        let max_failed = study.source.max_failed.unwrap_or(MAX_FAILED);
        let source = match (fmu.as_ref().or(mechanism.as_ref()), command) {
            (Some(file), _) => study.beside(file).display().to_string(),
            (None, Some(command)) => command.join(" "),
            (None, None) => system.clone().unwrap_or_default(),
        };
        let (model, parameters, outputs) = if study.source.is_run_apart() {
            let (model, parameters, outputs) = match fmu {
                Some(file) => WorkerModel::of_fmu(study, &study.beside(file))?,
                None => WorkerModel::of_program(study)?,
            };
            (SimulationModel::Apart(Box::new(model)), parameters, outputs)
        } else {
            let (equations, parameters, outputs) = SimulatedEquations::new(study)?;
            (SimulationModel::Equations(Box::new(equations)), parameters, outputs)
        };
        let planned = study.planned().map(|(name, _)| name.to_owned()).collect();
        let (inputs, is_discrete) = (Vec::new(), study.runs().are_samples);
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
            SimulationModel::Apart(model) => model.driven_mut(),
        }
    }

    /// Inputs that drive the runs, in the source's order.
    pub fn inputs(&self) -> &[SourceVariable] {
        &self.inputs
    }

    /// Initial states and inputs, if inputs drive the runs.
    pub fn driven(&self) -> Option<&Driven> {
        match &self.model {
            SimulationModel::Equations(equations) => equations.driven.as_ref(),
            SimulationModel::Apart(model) => model.driven(),
        }
    }

    /// Values of the quantities of the mechanism or system; those of parameters are overwritten for each run.
    pub fn quantities(&self) -> &[f64] {
        match &self.model {
            SimulationModel::Equations(equations) => &equations.quantities,
            SimulationModel::Apart(_) => &[],
        }
    }

    /// The model that worker processes run, if it is one.
    pub fn worker_model(&self) -> Option<&WorkerModel> {
        match &self.model {
            SimulationModel::Equations(_) => None,
            SimulationModel::Apart(model) => Some(model),
        }
    }

    /// Copy whose runs have the first rows only.
    pub fn with_rows(&self, rows: usize) -> Self {
        let rows = rows.min(self.times.len());
        let model = match &self.model {
            SimulationModel::Equations(equations) => SimulationModel::Equations(equations.clone()),
            SimulationModel::Apart(model) => SimulationModel::Apart(Box::new(model.with_rows(rows))),
        };
        Self { model, times: self.times[..rows].into(), ..self.clone() }
    }

    /// Settings of the accuracy from the loosest to the study's.
    pub fn settings(&self) -> Vec<SourceSetting> {
        match &self.model {
            SimulationModel::Equations(equations) => SourceSetting::tolerances_above(Some(equations.tolerance)),
            SimulationModel::Apart(model) => model.settings(),
        }
    }

    /// Copy with another setting of the accuracy.
    pub fn with_setting(&self, setting: SourceSetting) -> Self {
        let model = match (&self.model, setting) {
            (SimulationModel::Equations(equations), SourceSetting::Tolerance(tolerance)) => {
                SimulationModel::Equations(Box::new(SimulatedEquations { tolerance, ..(**equations).clone() }))
            }
            (SimulationModel::Equations(equations), _) => SimulationModel::Equations(equations.clone()),
            (SimulationModel::Apart(model), setting) => SimulationModel::Apart(Box::new(model.with_setting(setting))),
        };
        Self { model, ..self.clone() }
    }

    /// The parameters, in the study's order.
    pub fn parameters(&self) -> &[SourceVariable] {
        &self.parameters
    }

    /// The outputs, in the study's order.
    pub fn outputs(&self) -> &[SourceVariable] {
        &self.outputs
    }

    /// Points whose paths follow from the outputs; FMUs and programs do not describe any.
    pub fn points(&self) -> Vec<MovingPoint> {
        let outputs: Vec<&str> = self.outputs.iter().map(|output| output.name.as_str()).collect();
        match &self.model {
            SimulationModel::Equations(equations) => {
                let SimulatedEquations { simulator, quantities, parameter_positions, .. } = &**equations;
                simulator.points(quantities, parameter_positions, &outputs)
            }
            SimulationModel::Apart(_) => Vec::new(),
        }
    }

    /// Mechanism in a run with these parameters and outputs, for a picture; none of other sources, or if a repeated run has other outputs.
    pub fn moving_mechanism(&self, run: &Run) -> Option<MovingMechanism> {
        match &self.model {
            SimulationModel::Equations(equations) => {
                equations.moving_mechanism(run.parameters.get(..self.planned.len())?, &self.times, run)
            }
            SimulationModel::Apart(_) => None,
        }
    }

    /// The times of a training run's rows, in seconds; other runs are cut off at the study's `time.stop`.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Simulates one run of a system or a mechanism.
    ///
    /// # Errors
    /// [`Error::Run`] with the parameter values if the simulation fails, [`Error::Worker`] for an FMU or a program: their runs need
    /// worker processes, see [`Simulation::run_all`].
    pub fn run(&self, parameters: &[f64]) -> Result<Run> {
        match &self.model {
            SimulationModel::Equations(equations) => {
                let outputs = equations.run(parameters, &self.times, &[]);
                let outputs = outputs.map_err(|failure| self.error_of(&equations.name, parameters, failure))?;
                Ok(self.run_of(parameters, outputs))
            }
            SimulationModel::Apart(_) => {
                let message = "runs of an FMU or a program need worker processes".into();
                Err(Error::Worker { message })
            }
        }
    }

    /// Tries a run of a system or mechanism. Returns its failure, unless it only takes longer than `limit`; none for an
    /// FMU or a program.
    pub fn attempt(
        &self,
        point: &[f64],
        limit: Duration,
        stop: &AtomicBool,
    ) -> Option<std::result::Result<(), RunFailure>> {
        let SimulationModel::Equations(equations) = &self.model else { return None };
        let limited = SimulatedEquations { time_limit: Some(limit), ..(**equations).clone() };
        Some(match limited.run(point, &self.times, &[stop]) {
            Ok(_) | Err(RunFailure { cause: FailureCause::TimeLimit, .. }) => Ok(()),
            Err(failure) => Err(failure),
        })
    }

    fn error_of(&self, system: &str, parameters: &[f64], failure: RunFailure) -> Error {
        Error::Run { system: system.into(), values: self.values(parameters), message: failure.message }
    }

    /// The values of a point of a plan, for messages.
    pub fn values(&self, point: &[f64]) -> String {
        list(self.planned.iter().zip(point).map(|(name, value)| format!("{name} = {}", exact(*value))))
    }

    /// The run of a point of a plan from its outputs, row by row. Before a discrete-time run, outputs have the values
    /// of the first row, and inputs have their start values, as before a recorded run.
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

    /// Simulates a run for each point, over all cores, in the order of the points; runs in the journal are taken from
    /// the journal. `done` is called after each run. When the token of `workers` turns true, runs that have begun are
    /// abandoned. `total` is the number of all points of the plan, of which a share may fail.
    ///
    /// # Errors
    /// [`Error::FailedRuns`] as soon as more runs have failed than may, [`Error::Interrupted`], [`Error::Io`] of the journal; of
    /// an FMU or a program as [`WorkerModel::run_all`].
    pub fn run_all(
        &self,
        points: &Rows,
        total: usize,
        journal: &Journal,
        workers: Workers<'_>,
        done: impl Fn() + Sync,
    ) -> Result<Vec<RunOutcome>> {
        let outcomes = match &self.model {
            SimulationModel::Equations(equations) => {
                self.solve_all(equations, points, total, journal, workers.stop, done)?
            }
            SimulationModel::Apart(model) => {
                let failed = AtomicUsize::new(0);
                let allow = |point: &[f64], failure: &RunFailure| {
                    self.allow(failed.fetch_add(1, Ordering::Relaxed) + 1, total, point, failure)
                };
                model.run_all(points, Some(journal), workers, &allow, done)?
            }
        };
        Ok(outcomes
            .into_iter()
            .zip(points)
            .map(|(outcome, point)| outcome.map(|outputs| self.run_of(point, outputs)))
            .collect())
    }

    /// Runs begin in the order of the points, and those that have begun end, so that the same failures are too many for any
    /// number of threads.
    fn solve_all(
        &self,
        equations: &SimulatedEquations,
        points: &Rows,
        total: usize,
        journal: &Journal,
        stop: &AtomicBool,
        done: impl Fn() + Sync,
    ) -> Result<Vec<RunOutputs>> {
        let (next, failed, halt) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicBool::new(false));
        let allowed = self.allowed(total);
        let mut outcomes: Vec<_> = (0..points.len())
            .into_par_iter()
            .map(|_| {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if halt.load(Ordering::Relaxed) {
                    return (index, None);
                }
                let outcome = if stop.load(Ordering::Relaxed) {
                    Err(Error::Interrupted)
                } else {
                    self.solve(equations, &points[index], journal, stop)
                };
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
            })
            .collect();
        outcomes.sort_unstable_by_key(|(index, _)| *index);
        let outcomes = outcomes.into_iter().filter_map(|(_, outcome)| outcome).collect::<Result<Vec<_>>>()?;
        let mut failures =
            points.iter().zip(&outcomes).filter_map(|(point, outcome)| Some((point, outcome.as_ref().err()?)));
        failures.nth(allowed).map_or(Ok(()), |(point, failure)| self.allow(allowed + 1, total, point, failure))?;
        Ok(outcomes)
    }

    /// A run that the journal has, or that it keeps then.
    fn solve(
        &self,
        equations: &SimulatedEquations,
        point: &[f64],
        journal: &Journal,
        stop: &AtomicBool,
    ) -> Result<RunOutputs> {
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
    }

    /// Largest number of failed runs of `total`.
    fn allowed(&self, total: usize) -> usize {
        (self.max_failed * total as f64).floor() as usize
    }

    /// Refuses too many failed runs; with the parameters and the failure of the last one.
    fn allow(&self, failed: usize, total: usize, point: &[f64], failure: &RunFailure) -> Result<()> {
        let (share, reason) = (self.max_failed, failure.message.clone());
        let allowed = self.allowed(total);
        if failed <= allowed {
            return Ok(());
        }
        let (source, parameters) = (self.source.clone(), self.values(point));
        Err(Error::FailedRuns { source_name: source, failed, total, allowed, share, parameters, reason })
    }

    /// Refuses more failed runs than a plan allows.
    ///
    /// # Errors
    /// [`Error::FailedRuns`].
    pub fn check_failures(&self, points: &Rows, outcomes: &[RunOutcome]) -> Result<()> {
        let failed = points.iter().zip(outcomes).filter_map(|(point, outcome)| Some((point, outcome.as_ref().err()?)));
        let last = failed.clone().next_back();
        last.map_or(Ok(()), |(point, failure)| self.allow(failed.count(), points.len(), point, failure))
    }

    /// Runs with the names of their columns; failed ones are dropped.
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
    /// Initial states and inputs, if the study wants states.
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
                let own = &mechanism.description().outputs;
                let column = |measure: &str| {
                    outputs.iter().position(|name| {
                        own.get(*name).is_some_and(|output| output.measure.as_deref() == Some(measure))
                    })
                };
                mechanism
                    .description()
                    .outputs
                    .iter()
                    .filter_map(|(_, output)| {
                        let point = output.measure.as_deref()?.strip_suffix(".x")?;
                        Some(MovingPoint::of_outputs(
                            point,
                            column(&format!("{point}.x"))?,
                            column(&format!("{point}.y"))?,
                        ))
                    })
                    .collect()
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

    fn simulate(&self, quantities: &[f64], times: &[f64], tolerance: f64, budget: &Budget) -> RunOutputs {
        match self {
            Self::System(system) => Ok((system.simulate)(quantities, times, tolerance, budget)?),
            Self::Mechanism(mechanism) => Ok(mechanism.simulate(quantities, times, tolerance, budget)?),
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
        if let (true, EquationSolver::Mechanism(mechanism)) = (study.runs().start_from_states, &equations.simulator) {
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

    /// Value of each quantity in a run.
    fn quantities(&self, parameters: &[f64]) -> Vec<f64> {
        let mut quantities = self.quantities.clone();
        for (&position, &value) in self.parameter_positions.iter().zip(parameters) {
            quantities[position] = value;
        }
        quantities
    }

    /// See [`Simulation::moving_mechanism`]. Signals depend on all times of a run of the plan, of which the run has the first ones.
    fn moving_mechanism(&self, parameters: &[f64], times: &[f64], run: &Run) -> Option<MovingMechanism> {
        let EquationSolver::Mechanism(mechanism) = &self.simulator else { return None };
        let quantities = self.quantities(parameters);
        let budget = Budget::new(&[], self.time_limit);
        let motion = match &self.driven {
            Some(driven) => driven.launch(parameters, times).and_then(|launch| {
                let integration = (self.tolerance, &budget);
                mechanism.body_motion_from(&quantities, launch.start(), &launch.signals, times, integration)
            }),
            None => mechanism.body_motion(&quantities, times, self.tolerance, &budget),
        };
        let BodyMotion { mut poses, outputs } = motion.ok()?;
        let rows = outputs.chunks(self.simulator.output_count());
        let repeated = rows.flat_map(|row| self.output_positions.iter().map(|&position| row[position]));
        // a run of a table that somebody changed is not this one
        if !repeated.zip(&run.outputs).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs().max(1.0)) {
            return None;
        }
        let geometry = mechanism.geometry(&quantities)?;
        poses.truncate(run.times.len() * 3 * geometry.links.len());
        Some(MovingMechanism { geometry, poses })
    }

    /// Outputs of a run, row by row, in the study's order; any of the flags ends it early.
    fn run(&self, parameters: &[f64], times: &[f64], stops: &[&AtomicBool]) -> RunOutputs {
        let quantities = self.quantities(parameters);
        let budget = Budget::new(stops, self.time_limit);
        let rows = match (&self.driven, &self.simulator) {
            (Some(driven), EquationSolver::Mechanism(mechanism)) => {
                let (launch, integration) = (driven.launch(parameters, times)?, (self.tolerance, &budget));
                mechanism.simulate_from(&quantities, launch.start(), &launch.signals, times, integration)?
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
mod tests;
