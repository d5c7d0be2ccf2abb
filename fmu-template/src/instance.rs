//! One simulation of the surrogate: the states it goes through, what may be called in which, and the values. It knows
//! neither C nor an FMI version; what it says is passed on by the adapter.

use crate::{
    answer::{Refusal, Warning},
    snapshot::{Snapshot, fingerprint},
};
use metafmu_runtime::{Evaluator, FormatError, Metadata, Role, Scratch, Surrogate, Variability};
use std::{fmt, fs, io, path::Path, path::PathBuf};

/// Where in its life an instance is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Instantiated,
    Initialization,
    StepComplete,
    Terminated,
    /// After a call was refused. The standard: "the simulation cannot be continued with this FMU instance", but for a
    /// reset or a restored state.
    Error,
    /// After a panic: nothing is known about the values any more.
    Fatal,
}

impl State {
    const ALL: [Self; 6] =
        [Self::Instantiated, Self::Initialization, Self::StepComplete, Self::Terminated, Self::Error, Self::Fatal];

    /// The state whose `as u8` this is.
    pub(crate) fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    fn allows(self, call: Call) -> bool {
        call.legal()[2 * self as usize] == b'x'
    }
}

/// The standard's names.
impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Instantiated => "instantiated",
            Self::Initialization => "Initialization Mode",
            Self::StepComplete => "stepComplete",
            Self::Terminated => "terminated",
            Self::Error => "error",
            Self::Fatal => "fatal",
        })
    }
}

/// What a host may call only in certain states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Call {
    SetDebugLogging,
    SetupExperiment,
    EnterInitializationMode,
    ExitInitializationMode,
    Terminate,
    Reset,
    GetReal,
    GetInteger,
    GetBoolean,
    GetString,
    SetReal,
    SetInteger,
    SetBoolean,
    SetString,
    GetFMUstate,
    SetFMUstate,
    FreeFMUstate,
    SerializedFMUstateSize,
    SerializeFMUstate,
    DeSerializeFMUstate,
    GetDirectionalDerivative,
    SetRealInputDerivatives,
    GetRealOutputDerivatives,
    DoStep,
    CancelStep,
    GetStatus,
    GetRealStatus,
    GetIntegerStatus,
    GetBooleanStatus,
    GetStringStatus,
}

impl Call {
    /// The table at the end of section 4.2.4 of FMI 2.0, without the states of asynchronous and of partial steps,
    /// which never occur here. Which variables may be set in which state is for [`Instance::set`] to say.
    #[rustfmt::skip]
    const fn legal(self) -> &'static [u8; 2 * State::ALL.len() - 1] {
        match self {
            //                                  Instantiated
            //                                  | Initialization
            //                                  | | StepComplete
            //                                  | | | Terminated
            //                                  | | | | Error
            //                                  | | | | | Fatal
            Self::SetDebugLogging          => b"x x x x x -",
            Self::SetupExperiment          => b"x - - - - -",
            Self::EnterInitializationMode  => b"x - - - - -",
            Self::ExitInitializationMode   => b"- x - - - -",
            Self::Terminate                => b"- - x - - -",
            Self::Reset                    => b"x x x x x -",
            Self::GetReal                  => b"- x x x x -",
            Self::GetInteger               => b"- x x x x -",
            Self::GetBoolean               => b"- x x x x -",
            Self::GetString                => b"- x x x x -",
            Self::SetReal                  => b"x x x - - -",
            Self::SetInteger               => b"x x x - - -",
            Self::SetBoolean               => b"x x x - - -",
            Self::SetString                => b"x x x - - -",
            Self::GetFMUstate              => b"x x x x x -",
            Self::SetFMUstate              => b"x x x x x -",
            Self::FreeFMUstate             => b"x x x x x -",
            Self::SerializedFMUstateSize   => b"x x x x x -",
            Self::SerializeFMUstate        => b"x x x x x -",
            Self::DeSerializeFMUstate      => b"x x x x x -",
            Self::GetDirectionalDerivative => b"- x x x x -",
            Self::SetRealInputDerivatives  => b"x x x - - -",
            Self::GetRealOutputDerivatives => b"- - x x x -",
            Self::DoStep                   => b"- - x - - -",
            Self::CancelStep               => b"- - - - - -", // only while a step runs asynchronously
            Self::GetStatus                => b"- - x x - -",
            Self::GetRealStatus            => b"- - x x - -",
            Self::GetIntegerStatus         => b"- - x x - -",
            Self::GetBooleanStatus         => b"- - x x - -",
            Self::GetStringStatus          => b"- - x x - -",
        }
    }
}

/// Why there is no instance.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LoadError {
    #[error("cannot read the model file `{path}`: {source}")]
    Unreadable { path: PathBuf, source: io::Error },
    #[error("model file `{path}`: {source}")]
    Format { path: PathBuf, source: FormatError },
    #[error(
        "the GUID is `{found}`, expected `{expected}`, which the model file `{path}` has: they do not belong together"
    )]
    Token { path: PathBuf, found: String, expected: String },
}

/// One simulation. Shares nothing with another one.
pub(crate) struct Instance {
    metadata: Metadata,
    evaluator: Evaluator,
    scratch: Scratch,
    time_column: Option<usize>,
    now: Snapshot,
    /// Valid unless `stale`.
    outputs: Vec<f64>,
    /// Whether something changed since the outputs were computed; they are, when somebody asks.
    stale: bool,
    /// Kept out of the snapshot: a host that repeats a step is not to be warned at each attempt.
    warned_of_time: bool,
    warnings: Vec<Warning>,
}

/// How far, in relation to the greatest magnitude in its range, a value may be outside it: hosts add up step sizes and
/// convert units.
const RANGE_TOLERANCE: f64 = 1e-9;

impl Instance {
    /// Reads the model file in a resource directory, given the token of the description that goes with it.
    ///
    /// # Errors
    /// A [`LoadError`] that names the file.
    pub(crate) fn load(resources: &Path, token: &str) -> Result<Self, LoadError> {
        let path = resources.join("model.safetensors");
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
        let evaluator = Evaluator::new(&surrogate);
        let mut instance = Self {
            metadata: surrogate.metadata().clone(),
            scratch: evaluator.scratch(),
            evaluator,
            time_column: surrogate.time_column(),
            now: Snapshot {
                surrogate: fingerprint(token.as_bytes()),
                state: State::Instantiated,
                experiment: false,
                time: 0.0,
                stop_time: f64::INFINITY,
                inputs: Vec::new(),
            },
            outputs: vec![0.0; surrogate.outputs().len()],
            stale: true,
            warned_of_time: false,
            warnings: Vec::new(),
        };
        instance.reset();
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
    pub(crate) fn begin(&self, call: Call) -> Result<(), Refusal> {
        if self.now.state.allows(call) {
            return Ok(());
        }
        let legal = State::ALL.into_iter().filter(|state| state.allows(call)).collect();
        Err(Refusal::IllegalState { state: self.now.state, legal })
    }

    /// What the host is to be told of calls that were carried out; empty afterwards.
    pub(crate) fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.warnings)
    }

    pub(crate) fn has_warnings(&self) -> bool {
        !self.warnings.is_empty()
    }

    pub(crate) fn warn(&mut self, warning: Warning) {
        self.warnings.push(warning);
    }

    /// After a call was refused or panicked.
    pub(crate) fn fail(&mut self, state: State) {
        self.now.state = state;
    }

    /// Start time, and stop time or infinity.
    pub(crate) fn set_up_experiment(&mut self, start: f64, stop: Option<f64>) -> Result<(), Refusal> {
        finite("startTime", start)?;
        if let Some(stop) = stop {
            finite("stopTime", stop)?;
            if stop <= start {
                return Err(Refusal::StopTime { start, stop });
            }
        }
        self.now.experiment = true;
        self.now.stop_time = stop.unwrap_or(f64::INFINITY);
        self.warned_of_time = false;
        self.set_time(start);
        Ok(())
    }

    pub(crate) fn enter_initialization_mode(&mut self) -> Result<(), Refusal> {
        if !self.now.experiment {
            return Err(Refusal::NoStartTime);
        }
        self.now.state = State::Initialization;
        Ok(())
    }

    pub(crate) fn exit_initialization_mode(&mut self) {
        self.now.state = State::StepComplete;
    }

    pub(crate) fn terminate(&mut self) {
        self.now.state = State::Terminated;
    }

    /// As after instantiation: start values, time zero.
    pub(crate) fn reset(&mut self) {
        self.now.state = State::Instantiated;
        self.now.experiment = false;
        self.now.stop_time = f64::INFINITY;
        self.now.inputs.clear();
        self.now.inputs.extend(self.metadata.inputs.iter().map(|input| input.start));
        self.now.time = 0.0;
        if let Some(column) = self.time_column {
            self.now.inputs[column] = 0.0;
        }
        self.stale = true;
        self.warned_of_time = false;
    }

    /// Values of variables: input columns first, then outputs.
    #[inline]
    pub(crate) fn get(&mut self, references: &[u32], values: &mut [f64]) -> Result<(), Refusal> {
        for (value, &reference) in values.iter_mut().zip(references) {
            let index = reference as usize;
            let found = match index.checked_sub(self.now.inputs.len()) {
                None => self.now.inputs.get(index).copied(),
                Some(output) => self.outputs().get(output).copied(),
            };
            *value = found.ok_or_else(|| self.unknown(reference))?;
        }
        Ok(())
    }

    /// Sets parameters: all of them or, if one is refused, none.
    pub(crate) fn set(&mut self, references: &[u32], values: &[f64]) -> Result<(), Refusal> {
        for (&reference, &value) in references.iter().zip(values) {
            self.check_settable(reference, value)?;
        }
        for (&reference, &value) in references.iter().zip(values) {
            let column = reference as usize;
            self.now.inputs[column] = value;
            let input = &self.metadata.inputs[column];
            if outside(value, input.min, input.max) {
                let (name, min, max) = (input.name.clone(), input.min, input.max);
                self.warnings.push(Warning::ParameterOutsideRange { name, value, min, max });
            }
        }
        self.stale |= !references.is_empty();
        Ok(())
    }

    fn check_settable(&self, reference: u32, value: f64) -> Result<(), Refusal> {
        let column = reference as usize;
        let Some(input) = self.metadata.inputs.get(column) else {
            let output = self.metadata.outputs.get(column - self.metadata.inputs.len());
            let output = output.ok_or_else(|| self.unknown(reference))?;
            return Err(Refusal::SetOutput { name: output.name.clone(), reference });
        };
        let name = || input.name.clone();
        let state = self.now.state;
        match input.role {
            Role::Time => Err(Refusal::SetTime { name: name(), reference }),
            Role::Parameter(Variability::Fixed) if state == State::StepComplete => {
                Err(Refusal::SetFixed { name: name(), reference, state })
            }
            Role::Parameter(_) | Role::Input if !value.is_finite() => {
                Err(Refusal::ValueNotFinite { name: name(), reference, value })
            }
            Role::Parameter(_) | Role::Input => Ok(()),
        }
    }

    fn unknown(&self, reference: u32) -> Refusal {
        Refusal::UnknownReference { reference, last: self.metadata.inputs.len() + self.outputs.len() - 1 }
    }

    /// From communication point `from` on by `size`.
    ///
    /// `from` must be where the last step ended, or the host and this instance disagree on which steps were made: a step
    /// left out, a step repeated without restoring the state. Such a mistake is off by a good part of a step, rounding is
    /// not: hosts count steps or add them up (relative 1e-12 after a million), others count whole nanoseconds. So
    /// 1e-6 of the step and 1e-9 of the time are let pass. They do not add up, as the host's clock is adopted.
    ///
    /// The standard asks for a positive `size`; zero is accepted, since it has a clear meaning (no time passes) and hosts
    /// iterate over events by it.
    #[inline]
    pub(crate) fn do_step(&mut self, from: f64, size: f64) -> Result<(), Refusal> {
        finite("currentCommunicationPoint", from)?;
        finite("communicationStepSize", size)?;
        if size < 0.0 {
            return Err(Refusal::NegativeStep { size });
        }
        let tolerance = 1e-6 * size + 1e-9 * from.abs();
        if (from - self.now.time).abs() > tolerance {
            return Err(Refusal::CommunicationPoint { found: from, expected: self.now.time });
        }
        let time = from + size;
        finite("currentCommunicationPoint + communicationStepSize", time)?;
        // "if the environment tries to compute past stopTime the FMU has to return fmi2Error"
        if time > self.now.stop_time + tolerance {
            return Err(Refusal::PastStopTime { time, stop: self.now.stop_time });
        }
        self.set_time(time);
        Ok(())
    }

    /// The step that goes out of the trained range answers with a warning, for the computation can continue; those after
    /// it do not, as a warning without a message would be against the standard and a message a step a flood.
    #[inline]
    fn set_time(&mut self, time: f64) {
        self.now.time = time;
        let Some(column) = self.time_column else { return };
        self.now.inputs[column] = time;
        self.stale = true;
        let input = &self.metadata.inputs[column];
        if !self.warned_of_time && outside(time, input.min, input.max) {
            self.warned_of_time = true;
            self.warnings.push(Warning::TimeOutsideRange { time, min: input.min, max: input.max });
        }
    }

    /// Where the last step ended.
    pub(crate) fn time(&self) -> f64 {
        self.now.time
    }

    pub(crate) fn snapshot(&self) -> &Snapshot {
        &self.now
    }

    /// Goes on from a snapshot of any instance of this surrogate.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) -> Result<(), Refusal> {
        if snapshot.surrogate != self.now.surrogate {
            return Err(Refusal::ForeignState);
        }
        self.now.clone_from(snapshot);
        self.stale = true;
        Ok(())
    }

    #[inline]
    fn outputs(&mut self) -> &[f64] {
        if self.stale {
            self.evaluator.evaluate(&self.now.inputs, &mut self.outputs, &mut self.scratch);
            self.stale = false;
        }
        &self.outputs
    }
}

fn finite(argument: &'static str, value: f64) -> Result<(), Refusal> {
    if value.is_finite() { Ok(()) } else { Err(Refusal::NotFinite { argument, value }) }
}

fn outside(value: f64, min: f64, max: f64) -> bool {
    let tolerance = RANGE_TOLERANCE * min.abs().max(max.abs());
    value < min - tolerance || value > max + tolerance
}
