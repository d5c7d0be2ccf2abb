//! What a call is answered with when it is not simply fine. Messages say what was expected and what was found; the
//! adapter puts the function's name in front.

use crate::instance::State;

/// Status of a call; the numbers of `fmi2Status`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(crate) enum Status {
    Ok,
    Warning,
    Discard,
    Error,
    Fatal,
}

/// The call was carried out, but the user should know.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum Warning {
    #[error("parameter `{name}`: {value} is outside the training range from {min} to {max}; outputs are extrapolated")]
    ParameterOutsideRange { name: String, value: f64, min: f64, max: f64 },
    #[error(
        "time {time} is outside the training range from {min} to {max}; outputs are extrapolated (said once a run)"
    )]
    TimeOutsideRange { time: f64, min: f64, max: f64 },
    #[error("log category `{found}` is unknown, expected one of {expected}")]
    UnknownCategory { found: String, expected: String },
}

/// The call was not carried out, and nothing was changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum Refusal {
    #[error("not allowed in state `{state}`, only in {}", list(.legal))]
    IllegalState { state: State, legal: Vec<State> },
    #[error("argument `{argument}` is a null pointer")]
    NullPointer { argument: &'static str },
    #[error("argument `{argument}`: {length} elements do not fit into memory")]
    Length { argument: &'static str, length: usize },
    #[error("value reference {reference} is unknown, expected at most {last}")]
    UnknownReference { reference: u32, last: usize },
    #[error("{count} variables of type {kind} asked for, but all variables are of type Real")]
    NoVariableOfType { kind: &'static str, count: usize },
    #[error("variable `{name}` (value reference {reference}) is an output and cannot be set")]
    SetOutput { name: String, reference: u32 },
    #[error("variable `{name}` (value reference {reference}) is the independent variable and cannot be set")]
    SetTime { name: String, reference: u32 },
    #[error("parameter `{name}` (value reference {reference}) is fixed and cannot be set in state `{state}`")]
    SetFixed { name: String, reference: u32, state: State },
    #[error("parameter `{name}` (value reference {reference}): {value} is not finite")]
    ValueNotFinite { name: String, reference: u32, value: f64 },
    #[error("argument `{argument}`: {value} is not finite")]
    NotFinite { argument: &'static str, value: f64 },
    #[error("stop time {stop} is not after start time {start}")]
    StopTime { start: f64, stop: f64 },
    #[error("the experiment must be set up first: the start time is not known")]
    NoStartTime,
    #[error("communication step size {size} is negative")]
    NegativeStep { size: f64 },
    #[error("current communication point is {found}, expected {expected}, where the last step ended")]
    CommunicationPoint { found: f64, expected: f64 },
    #[error("a step to {time} would go past the stop time {stop}")]
    PastStopTime { time: f64, stop: f64 },
    #[error("the state belongs to another FMU")]
    ForeignState,
    #[error("serialized state of {found} bytes, expected {expected}")]
    StateSize { found: usize, expected: usize },
    #[error("serialized state is damaged or foreign: {reason}")]
    DamagedState { reason: &'static str },
    #[error("not offered: {reason}")]
    NotOffered { reason: &'static str },
    #[error("status information {kind} is not available: {reason}")]
    NoStatus { kind: i32, reason: &'static str },
}

impl Refusal {
    /// What the host is told.
    pub(crate) fn status(&self) -> Status {
        match self {
            // "if a status is required which cannot be retrieved by the slave it returns fmi2Discard"
            Self::NoStatus { .. } => Status::Discard,
            Self::IllegalState { state: State::Fatal, .. } => Status::Fatal,
            _ => Status::Error,
        }
    }
}

fn list(states: &[State]) -> String {
    if states.is_empty() {
        return "a state this FMU never enters".to_owned();
    }
    states.iter().map(|state| format!("`{state}`")).collect::<Vec<_>>().join(", ")
}
