//! One simulation of the surrogate: the states it goes through and its values. It knows no C, and of the FMI version
//! only where the standards differ; what it says is passed on by the adapters.

use crate::{
    location,
    snapshot::{Snapshot, fingerprint},
    state::{InstanceState, Interface, Row, Version},
    status::{Refusal, SMALLEST_STEP, Status, Warning},
};
use metafmu_runtime::{Domain, DomainPolicy, Evaluator, FormatError, Integration, Metadata, Role, Surrogate};
use std::{collections::TryReserveError, fs, hint::black_box, io, ops::Range, path::Path, path::PathBuf};
use variables::InstanceVariables;

mod derivatives;
mod domain;
mod states;
mod updates;
mod values;
mod variables;

/// FMI version, interface and use of Event Mode, fixed at instantiation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct InstanceKind {
    pub version: Version,
    pub interface: Interface,
    /// FMI 3.0 co-simulation: `true` if the host enters Event Mode between steps.
    pub event_mode: bool,
}

/// Why there is no instance.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LoadError {
    #[error("cannot read the model file `{path}`: {source}")]
    Unreadable { path: PathBuf, source: io::Error },
    #[error("the model file `{path}` of {length} bytes does not fit into memory: {source}")]
    Memory { path: PathBuf, length: u64, source: TryReserveError },
    #[error("model file `{path}`: {source}")]
    Format { path: PathBuf, source: FormatError },
    #[error(
        "the GUID or instantiation token is `{found}`, expected `{expected}`, which the model file `{path}` has: \
         they do not belong together"
    )]
    Token { path: PathBuf, found: String, expected: String },
    #[error("this FMU is discrete-time: it is for co-simulation, not for model exchange")]
    OnlyCoSimulation,
}

/// One simulation. Shares nothing with another one.
pub(crate) struct Instance {
    kind: InstanceKind,
    metadata: Metadata,
    variables: InstanceVariables,
    domain: Domain,
    evaluator: Evaluator,
    time_column: Option<usize>,
    /// Columns that are continuous inputs: those of the model, and measured outputs.
    input_columns: Vec<usize>,
    /// Columns of measured outputs, of a discrete-time model; the one after them is 1 while they are used, else 0.
    measured: Range<usize>,
    /// Nominal values of the states.
    nominals: Vec<f64>,
    now: Snapshot,
    /// Snapshot at the start of the current communication step, for steps with intermediate updates.
    before: Snapshot,
    /// Integration of the states, for models with states.
    integration: Option<Integration>,
    /// Part of the communication step before the current step of the solver, in seconds.
    since: f64,
    /// `true` if outputs have derivatives with respect to time; those of discrete-time models have none.
    is_smooth: bool,
    /// Point where the model is evaluated: the inputs, clamped if that is the policy, and the states.
    point: Vec<f64>,
    /// Outputs and, after them, derivatives of the states. Valid unless `stale`.
    results: Vec<f64>,
    /// `true` if something changed since the results were computed; they are updated when they are read.
    stale: bool,
    /// Work space of derivatives: one vector over the columns and one over the results for each order.
    columns: [Vec<f64>; 2],
    sensitivities: [Vec<f64>; 2],
    /// Columns the host was warned of in this run. Kept out of the snapshot: a host that repeats a step is not to be
    /// warned at each attempt.
    warned: Vec<bool>,
    /// `true` if a warning was logged in this run that an input or parameter changed; `warned_of_data`: that no
    /// training data were nearby.
    warned_of_change: bool,
    warned_of_data: bool,
    /// Position of the part of the training data that was nearest last.
    near: usize,
    warnings: Vec<Warning>,
    /// Points that a solver has tried since it last completed a step, each later than all before, and the time of the last of them.
    trials: u32,
    furthest: f64,
}

/// Points later than all before that a solver may try within a step; methods of high order try some tens.
const MOST_TRIALS: u32 = 1000;

/// Maximum memory for loading: a number of bytes, and a multiple of the length of the model file. Networks take less
/// than five times that length.
const MEMORY: (usize, usize) = (1 << 18, 8);

impl Instance {
    /// Reads the model file in a folder of resources or of the whole FMU, given the token of the description that goes with it.
    ///
    /// # Errors
    /// A [`LoadError`] that names the file.
    pub(crate) fn load(resources: &Path, token: &str, kind: InstanceKind) -> Result<Self, LoadError> {
        let path = location::file(resources, "model.safetensors");
        let length = match fs::metadata(&path) {
            Ok(metadata) => metadata.len(),
            Err(source) => return Err(LoadError::Unreadable { path, source }),
        };
        if let Err(source) = check_memory(length) {
            return Err(LoadError::Memory { path, length, source });
        }
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(source) => return Err(LoadError::Unreadable { path, source }),
        };
        let surrogate = match Surrogate::from_bytes(&bytes) {
            Ok(surrogate) => surrogate,
            Err(source) => return Err(LoadError::Format { path, source }),
        };
        let expected = surrogate.instantiation_token();
        if token != expected {
            return Err(LoadError::Token { path, found: token.to_owned(), expected });
        }
        let is_smooth = surrogate.program().sampling().is_none();
        if !is_smooth && kind.interface == Interface::ModelExchange {
            return Err(LoadError::OnlyCoSimulation);
        }
        let evaluator = Evaluator::new(&surrogate);
        let metadata = surrogate.metadata();
        let (values, results) = (vec![0.0; evaluator.columns()], vec![0.0; evaluator.results()]);
        let measured = evaluator.measured_columns().unwrap_or_default();
        let input_columns = (0..metadata.inputs.len()).filter(|column| metadata.inputs[*column].role == Role::Input);
        let now = Snapshot {
            surrogate: fingerprint(format!("{token}{:?}{:?}", kind.version, kind.interface).as_bytes()),
            state: InstanceState::Instantiated,
            experiment: false,
            policy: DomainPolicy::default(),
            changed: false,
            time: 0.0,
            start_time: 0.0,
            stop_time: f64::INFINITY,
            tolerance: 0.0,
            values: values.clone(),
            at_start: values.clone(),
            rates: [values.clone(), values.clone()],
        };
        let mut instance = Self {
            kind,
            variables: InstanceVariables::new(&surrogate, kind.version),
            domain: Domain::of(&surrogate),
            evaluator,
            time_column: surrogate.time_column(),
            input_columns: input_columns.chain(measured.clone()).collect(),
            measured,
            nominals: metadata.states.iter().map(|state| state.nominal).collect(),
            before: now.clone(),
            now,
            integration: surrogate.program().integration(),
            since: 0.0,
            is_smooth,
            warned: vec![false; values.len()],
            warned_of_change: false,
            warned_of_data: false,
            near: 0,
            point: values.clone(),
            columns: [values.clone(), values],
            sensitivities: [results.clone(), results.clone()],
            results,
            stale: true,
            metadata: surrogate.into_metadata(),
            warnings: Vec::new(),
            trials: 0,
            furthest: f64::NEG_INFINITY,
        };
        instance.start();
        Ok(instance)
    }

    /// Name, variables, provenance of the surrogate.
    pub(crate) fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// To be asked before every call.
    ///
    /// # Errors
    /// [`Refusal::IllegalState`] if the present state does not allow it.
    #[inline]
    pub(crate) fn begin(&self, row: Row) -> Result<(), Refusal> {
        if self.now.state.allows(row, self.kind.interface) { Ok(()) } else { Err(self.illegal(row)) }
    }

    #[cold]
    fn illegal(&self, row: Row) -> Refusal {
        let interface = self.kind.interface;
        let legal = InstanceState::ALL
            .into_iter()
            .filter(|state| *state != InstanceState::IntermediateUpdate || self.offers_updates())
            .filter(|state| state.allows(row, interface));
        Refusal::IllegalState { state: self.now.state, legal: legal.collect() }
    }

    /// Warnings about calls that were carried out; the list is empty afterwards.
    pub(crate) fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.warnings)
    }

    pub(crate) fn has_warnings(&self) -> bool {
        !self.warnings.is_empty()
    }

    pub(crate) fn warn(&mut self, warning: Warning) {
        self.warnings.push(warning);
    }

    /// After a run that cannot go on ([`Status::Error`]) or a panic ([`Status::Fatal`]).
    pub(crate) fn fail(&mut self, status: Status) {
        match (status, self.kind.version) {
            (Status::Ok | Status::Warning | Status::Discard, _) => {}
            (Status::Error, Version::Fmi2) => self.now.state = InstanceState::Error,
            // "if any function called in super state FMU State Settable returns fmi3Error, the FMU enters Terminated"
            (Status::Error, Version::Fmi3) => self.now.state = InstanceState::Terminated,
            (Status::Fatal, _) => self.now.state = InstanceState::Fatal,
        }
    }

    // ---- Modes ---------------------------------------------------------------------------------------------------

    /// Start time, stop time if there is one, and the tolerance of the solver inside the FMU if it is to have one.
    pub(crate) fn set_up_experiment(
        &mut self,
        start: f64,
        stop: Option<f64>,
        tolerance: Option<f64>,
    ) -> Result<(), Refusal> {
        finite("startTime", start)?;
        if let Some(tolerance) = tolerance.filter(|tolerance| !(tolerance.is_finite() && *tolerance >= 0.0)) {
            return Err(Refusal::Tolerance { found: tolerance });
        }
        // a run without an end has a stop time of infinity in some hosts
        let stop = stop.filter(|stop| *stop != f64::INFINITY);
        if let Some(stop) = stop {
            finite("stopTime", stop)?;
            // a run of no length is an initialization
            if stop < start {
                return Err(Refusal::StopTime { start, stop });
            }
        }
        self.forget_warnings();
        self.set_time(start, Status::Error)?;
        self.now.experiment = true;
        self.now.start_time = start;
        self.now.stop_time = stop.unwrap_or(f64::INFINITY);
        self.now.tolerance = tolerance.unwrap_or(0.0);
        Ok(())
    }

    pub(crate) fn enter_initialization_mode(&mut self) -> Result<(), Refusal> {
        if !self.now.experiment {
            self.set_up_experiment(0.0, None, None)?;
        }
        self.now.state = InstanceState::Initialization;
        Ok(())
    }

    pub(crate) fn exit_initialization_mode(&mut self) -> Result<(), Refusal> {
        self.note_data(Status::Error)?;
        let event = self.kind.interface == Interface::ModelExchange || self.kind.event_mode;
        self.now.state = if event { InstanceState::Event } else { InstanceState::Step };
        Ok(())
    }

    pub(crate) fn enter_event_mode(&mut self) -> Result<(), Refusal> {
        if self.kind.interface == Interface::CoSimulation && !self.kind.event_mode {
            return Err(Refusal::NoEventMode);
        }
        self.accept_point()?;
        self.now.state = InstanceState::Event;
        Ok(())
    }

    pub(crate) fn enter_continuous_time_mode(&mut self) -> Result<(), Refusal> {
        self.now.state = InstanceState::ContinuousTime;
        Ok(())
    }

    pub(crate) fn enter_step_mode(&mut self) -> Result<(), Refusal> {
        self.now.state = InstanceState::Step;
        Ok(())
    }

    pub(crate) fn terminate(&mut self) -> Result<(), Refusal> {
        self.now.state = InstanceState::Terminated;
        Ok(())
    }

    /// As after instantiation: start values, time zero.
    pub(crate) fn reset(&mut self) -> Result<(), Refusal> {
        self.start();
        Ok(())
    }

    fn start(&mut self) {
        self.now.state = InstanceState::Instantiated;
        self.now.experiment = false;
        self.now.policy = DomainPolicy::default();
        self.now.changed = false;
        self.now.start_time = 0.0;
        self.now.stop_time = f64::INFINITY;
        self.now.tolerance = 0.0;
        for (value, input) in self.now.values.iter_mut().zip(&self.metadata.inputs) {
            *value = if input.role == Role::Time { 0.0 } else { input.start };
        }
        self.now.values[self.metadata.inputs.len()..].fill(0.0);
        self.initialize_states();
        self.now.at_start.copy_from_slice(&self.now.values);
        self.now.rates.iter_mut().for_each(|rates| rates.fill(0.0));
        self.now.time = 0.0;
        (self.trials, self.furthest) = (0, f64::NEG_INFINITY);
        self.stale = true;
        self.forget_warnings();
    }

    fn forget_warnings(&mut self) {
        self.warned.fill(false);
        self.warned_of_change = false;
        self.warned_of_data = false;
    }

    // ---- Time ----------------------------------------------------------------------------------------------------

    /// From communication point `from` on by `size`.
    ///
    /// `from` must be where the last step ended, or the host and this instance disagree on which steps were made: a step
    /// left out, a step repeated without restoring the state. Such a mistake is off by a good part of a step, rounding is
    /// not. Hosts count steps or add them up (relative 1e-12 after a million), others count whole nanoseconds, and some
    /// in single precision (2e-7). [`clock_tolerance`] is let pass. It does not add up, as the host's clock is adopted.
    ///
    /// The standard asks for a positive `size`; zero is accepted, since it has a clear meaning (no time passes) and hosts
    /// iterate over events by it.
    #[inline]
    pub(crate) fn do_step(&mut self, from: f64, size: f64) -> Result<(), Refusal> {
        let (time, status) = self.check_step(from, size)?;
        self.note_data(status)?;
        if self.has_memory() {
            self.advance_states(time, size, status)?;
        }
        self.set_time(time, status)?;
        for index in 0..self.input_columns.len() {
            let column = self.input_columns[index];
            self.now.values[column] = self.extrapolated(column, size);
            self.now.rates[0][column] += size * self.now.rates[1][column];
            self.stale = true;
            self.note_value(column);
        }
        Ok(())
    }

    /// Where a communication step ends, and the status of one that cannot be made.
    #[inline]
    fn check_step(&self, from: f64, size: f64) -> Result<(f64, Status), Refusal> {
        finite("currentCommunicationPoint", from)?;
        finite("communicationStepSize", size)?;
        if size < 0.0 {
            return Err(Refusal::NegativeStep { size });
        }
        if size > 0.0 && size < SMALLEST_STEP {
            return Err(Refusal::ShortStep { size });
        }
        let tolerance = clock_tolerance(from, size);
        if (from - self.now.time).abs() > tolerance {
            return Err(Refusal::CommunicationPoint { found: from, expected: self.now.time });
        }
        let time = from + size;
        finite("currentCommunicationPoint + communicationStepSize", time)?;
        // "if the environment tries to compute past stopTime the FMU has to return fmi2Error"
        if time > self.now.stop_time + tolerance {
            return Err(Refusal::PastStopTime { time, stop: self.now.stop_time });
        }
        // FMI 2.0 has Discard for a part of the step that was computed, FMI 3.0 for a step that may be tried again
        let status = if self.kind.version == Version::Fmi2 { Status::Error } else { Status::Discard };
        for &column in &self.input_columns {
            self.check_value(column, self.extrapolated(column, size), time, self.now.policy, status)?;
        }
        Ok((time, status))
    }

    /// An input that follows the derivatives the host gave, `size` later; infinite polynomials stay where they are.
    fn extrapolated(&self, column: usize, size: f64) -> f64 {
        let [first, second] = &self.now.rates;
        let value = self.now.values[column];
        let later = value + size * (first[column] + 0.5 * size * second[column]);
        if later.is_finite() { later } else { value }
    }

    /// Time of a solver around the FMU. It looks ahead and back, even past the stop time and shortly before the start: the FMU has no events,
    /// so nothing in it depends on the way.
    pub(crate) fn set_solver_time(&mut self, time: f64) -> Result<(), Refusal> {
        finite("time", time)?;
        if self.now.state == InstanceState::Instantiated {
            // the experiment begins then
            return self.set_up_experiment(time, Some(self.now.stop_time), Some(self.now.tolerance));
        }
        self.set_time(time, Status::Error)
    }

    #[inline]
    fn set_time(&mut self, time: f64, refused: Status) -> Result<(), Refusal> {
        if self.is_trial() {
            self.note_trial(time)?;
        }
        if let Some(column) = self.time_column {
            if !self.is_trial() {
                self.check_value(column, time, time, self.now.policy, refused)?;
            }
            self.now.values[column] = time;
            self.stale = true;
            if !self.is_trial() {
                self.note_value(column);
            }
        }
        self.now.time = time;
        Ok(())
    }

    /// Returns true if times and inputs are trial values of a solver. Trial values may lie outside the domain or past
    /// the stop time, and many solvers treat any status but OK as a failure. Checks wait for the point that the solver
    /// accepts.
    #[inline]
    fn is_trial(&self) -> bool {
        self.now.state == InstanceState::ContinuousTime
    }

    /// Notes a time that a solver goes to. A host that never completes a step accepts every point that it leaves behind.
    fn note_trial(&mut self, time: f64) -> Result<(), Refusal> {
        if time <= self.furthest {
            return Ok(());
        }
        self.furthest = time;
        self.trials = self.trials.saturating_add(1);
        if self.trials > MOST_TRIALS { self.check_accepted() } else { Ok(()) }
    }

    /// Accepts the point where a solver has completed a step or an event begins: here time and inputs are checked.
    pub(crate) fn accept_point(&mut self) -> Result<(), Refusal> {
        self.trials = 0;
        self.check_accepted()
    }

    fn check_accepted(&mut self) -> Result<(), Refusal> {
        if self.now.time <= self.now.start_time {
            self.now.at_start.copy_from_slice(&self.now.values);
        }
        self.expect_plausible()?;
        self.check_point(self.now.policy)?;
        self.note_data(Status::Error)?;
        (0..self.now.values.len()).for_each(|column| self.note_value(column));
        Ok(())
    }

    /// Where the last step ended.
    pub(crate) fn time(&self) -> f64 {
        self.now.time
    }

    // ---- State ---------------------------------------------------------------------------------------------------

    pub(crate) fn snapshot(&self) -> &Snapshot {
        &self.now
    }

    /// Continues from a snapshot of any instance of this surrogate, made by the same FMI version and interface.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) -> Result<(), Refusal> {
        if snapshot.surrogate != self.now.surrogate {
            return Err(Refusal::ForeignState);
        }
        self.now.copy_from(snapshot);
        (self.trials, self.furthest) = (0, self.now.time);
        self.stale = true;
        Ok(())
    }

    #[inline]
    fn update_results(&mut self) -> Result<(), Refusal> {
        if self.stale {
            self.update_point();
            self.evaluator.evaluate(&self.point, &mut self.results);
            if self.results.iter().any(|value| !value.is_finite()) {
                return Err(self.not_computable());
            }
            self.stale = false;
        }
        Ok(())
    }

    /// FMI 2.0 has Discard for reading variables in model exchange only.
    fn not_computable(&self) -> Refusal {
        let status = match (self.kind.version, self.kind.interface) {
            (Version::Fmi2, Interface::CoSimulation) => Status::Error,
            _ => Status::Discard,
        };
        Refusal::NotComputable { status }
    }

    /// Refuses derivatives that are not finite. FMI 2.0 has no Discard for them.
    fn check_derivatives(&self, found: &[f64]) -> Result<(), Refusal> {
        if found.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        let status = if self.kind.version == Version::Fmi2 { Status::Error } else { Status::Discard };
        Err(Refusal::NotComputable { status })
    }

    /// States are what they are: they cannot be clamped.
    #[inline]
    fn update_point(&mut self) {
        let clamp = self.now.policy == DomainPolicy::Clamp;
        let inputs = self.metadata.inputs.len();
        for (column, (point, &value)) in self.point.iter_mut().zip(&self.now.values).enumerate() {
            *point = if clamp && column < inputs { self.domain.clamp(column, value) } else { value };
        }
    }
}

/// How far the clocks of host and instance may be apart at a step of this size: by rounding in single precision, and by no more than a tenth of
/// the step.
#[inline]
fn clock_tolerance(from: f64, size: f64) -> f64 {
    let single = (2.5e-7 * from.abs()).min(0.1 * size);
    (1e-6 * size + 1e-9 * from.abs()).max(single)
}

/// Checks that loading will find enough memory, by a single allocation that is freed at once. A failed allocation is an
/// error here; later it would end the process, which is the host's.
fn check_memory(length: u64) -> Result<(), TryReserveError> {
    let (least, times) = MEMORY;
    let length = usize::try_from(length).unwrap_or(usize::MAX);
    let mut memory = Vec::<u8>::new();
    memory.try_reserve_exact(length.saturating_mul(times).saturating_add(least))?;
    black_box(memory);
    Ok(())
}

pub(crate) fn finite(argument: &'static str, value: f64) -> Result<(), Refusal> {
    if value.is_finite() { Ok(()) } else { Err(Refusal::NotFinite { argument, value }) }
}
