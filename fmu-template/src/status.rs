//! Results of calls other than success. Messages state the expected and the found value; the adapter prepends the name
//! of the function.

use crate::state::InstanceState;
use metafmu_runtime::exact;

/// Smallest size of a communication step that is not zero, in seconds: shorter ones cannot be divided in double precision.
pub(crate) const SMALLEST_STEP: f64 = 1e-30;

/// Status of a call and severity of a message; the numbers of `fmi2Status` and `fmi3Status`. No call returns `Warning`:
/// many hosts end a simulation on every status but OK. FMI 3.0 advises them to: "For production environments warnings
/// should be treated like errors unless they can be safely ignored."
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(crate) enum Status {
    Ok,
    Warning,
    Discard,
    Error,
    Fatal,
}

/// The call was carried out and returns OK, but the user should know: the message is logged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum Warning {
    #[error(
        "variable `{name}`: {value} is outside {valid}; outputs are {instead} (said once a run)",
        value = exact(*value)
    )]
    OutsideDomain { name: String, value: f64, valid: String, instead: &'static str },
    #[error(
        "variable `{name}`: changed from {from} to {to} during the run; outputs are those of a run that has had {to} \
         since its start (said once a run)",
        from = exact(*from), to = exact(*to)
    )]
    Changed { name: String, from: f64, to: f64 },
    #[error(
        "the inputs are in their ranges, but {distance:.3} of the ranges away from where training data are near; outputs are extrapolated \
         (said once a run)"
    )]
    FarFromData { distance: f64 },
    #[error("log category `{found}` is unknown, expected one of {expected}")]
    UnknownCategory { found: String, expected: String },
}

/// The call was not carried out, and nothing was changed: a host that continues all the same finds the instance as it was, unless the
/// [run has ended](Refusal::ends_run).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum Refusal {
    #[error("not allowed in state `{state}`, only in {}", list(.legal))]
    IllegalState { state: InstanceState, legal: Vec<InstanceState> },
    #[error("argument `{argument}` is a null pointer")]
    NullPointer { argument: &'static str },
    #[error("argument `{argument}`: {length} elements do not fit into memory")]
    Length { argument: &'static str, length: usize },
    #[error("argument `{argument}`: {found} elements, expected {expected}")]
    Count { argument: &'static str, found: usize, expected: usize },
    #[error("value reference {reference} is unknown, expected at most {last}")]
    UnknownReference { reference: u32, last: u32 },
    #[error("value reference {reference} is unknown: no variable has it")]
    UnusedReference { reference: u32 },
    #[error("{count} variables of type {kind} asked for, but there are none of this type")]
    NoVariableOfType { kind: &'static str, count: usize },
    #[error(
        "variable `{name}` (value reference {reference}) has no start value: it can be read from Initialization Mode on"
    )]
    NoStartValue { name: String, reference: u32 },
    #[error("variable `{name}` (value reference {reference}) is of type {found}, not {asked}")]
    WrongType { name: String, reference: u32, found: &'static str, asked: &'static str },
    #[error("variable `{name}` (value reference {reference}) is an output and cannot be set")]
    SetOutput { name: String, reference: u32 },
    #[error("variable `{name}` (value reference {reference}) is computed and cannot be set")]
    SetComputed { name: String, reference: u32 },
    #[error(
        "variable `{name}` (value reference {reference}) is a state and cannot be set: set parameter `{name}_start` before the \
         simulation runs, or the state in Continuous-Time Mode"
    )]
    SetState { name: String, reference: u32 },
    #[error("variable `{name}` (value reference {reference}) is the independent variable and cannot be set")]
    SetTime { name: String, reference: u32 },
    #[error("parameter `{name}` (value reference {reference}) is {variability} and cannot be set in state `{state}`")]
    SetParameter { name: String, reference: u32, variability: &'static str, state: InstanceState },
    #[error("variable `{name}` (value reference {reference}): {value} is not finite")]
    ValueNotFinite { name: String, reference: u32, value: f64, status: Status },
    #[error("parameter `domain_policy`: {found}, expected 0 (warn), 1 (clamp) or 2 (error)", found = exact(*found))]
    Policy { found: f64 },
    #[error("variable `{name}`: {value} is outside {valid}, and domain_policy is 2", value = exact(*value))]
    OutsideDomain { name: String, value: f64, valid: String, status: Status },
    #[error(
        "variable `{name}`: {to} instead of {from} as at the start of the run, and domain_policy is 2",
        from = exact(*from), to = exact(*to)
    )]
    Changed { name: String, from: f64, to: f64, status: Status },
    #[error(
        "the inputs are in their ranges, but {distance:.3} of the ranges away from where training data are near, and domain_policy is 2"
    )]
    FarFromData { distance: f64, status: Status },
    #[error("inputs or parameters have been changed during the run, which domain_policy 2 forbids")]
    ChangedBefore,
    #[error("variable `{name}` (value reference {reference}) is no {expected}")]
    NotDifferentiable { name: String, reference: u32, expected: &'static str },
    #[error("derivatives of order {found} are not available, expected 1 to {max}")]
    Order { found: i32, max: u32 },
    #[error(
        "there are no derivatives of outputs with respect to time: they are linear between samples, and bend there"
    )]
    NoOutputDerivatives,
    #[error("argument `{argument}`: {value} is not finite")]
    NotFinite { argument: &'static str, value: f64 },
    #[error("argument `{argument}`: {value} is not finite; the states stay what they were")]
    StateNotFinite { argument: &'static str, value: f64 },
    #[error("stop time {stop} is before start time {start}", start = exact(*start), stop = exact(*stop))]
    StopTime { start: f64, stop: f64 },
    #[error("the instance was made with eventModeUsed = false")]
    NoEventMode,
    #[error("communication step size {size} is negative", size = exact(*size))]
    NegativeStep { size: f64 },
    #[error("communication step size {size:e} is below {SMALLEST_STEP:e} s, the smallest one, and not zero")]
    ShortStep { size: f64 },
    #[error(
        "current communication point is {found}, expected {expected}, where the last step ended",
        found = exact(*found), expected = exact(*expected)
    )]
    CommunicationPoint { found: f64, expected: f64 },
    #[error("a step to {time} would go past the stop time {stop}", time = exact(*time), stop = exact(*stop))]
    PastStopTime { time: f64, stop: f64 },
    #[error("tolerance {found} is negative or not finite", found = exact(*found))]
    Tolerance { found: f64 },
    #[error(
        "the equations have no finite solution in this state: a formula is not defined there, a mass matrix is not positive \
         definite, or a value is too large"
    )]
    NotComputable { status: Status },
    #[error(
        "the states are not finite {after} s after the beginning of the step: the motion diverges, or reaches a state \
         in which the equations have no finite solution",
        after = exact(*after)
    )]
    Diverged { after: f64, status: Status },
    #[error("{}{of}", when(.after))]
    Implausible { after: Option<f64>, of: Implausible, status: Status },
    #[error(
        "no step of the solver is short enough {after} s after the beginning of the step: the motion diverges, or the equations \
         have a singularity",
        after = exact(*after)
    )]
    Underflow { after: f64, status: Status },
    #[error(
        "the outputs are not finite at the sample {after} s after the beginning of the step: the model diverges",
        after = exact(*after)
    )]
    OutputsDiverged { after: f64, status: Status },
    #[error(
        "communication step size {size} takes more than ten million steps of the solver, expected a smaller one",
        size = exact(*size)
    )]
    LongStep { size: f64 },
    #[error("the state belongs to another FMU, or to another FMI version or interface of this one")]
    ForeignState,
    #[error("serialized state of {found} bytes, expected {expected}")]
    StateSize { found: usize, expected: usize },
    #[error("serialized state is damaged or foreign: {reason}")]
    DamagedState { reason: &'static str },
    #[error("status information {kind} is not available: {reason}")]
    NoStatus { kind: i32, reason: &'static str },
}

/// A state that no motion leads to.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "state `{name}` is {value}, which is not plausible: expected {valid}, and at most {limit} in magnitude; the motion diverges",
    value = exact(*value),
    limit = exact(*limit)
)]
pub(crate) struct Implausible {
    pub name: String,
    pub value: f64,
    pub valid: String,
    pub limit: f64,
}

fn when(after: &Option<f64>) -> String {
    after.map_or(String::new(), |after| format!("{} s after the beginning of the step, ", exact(after)))
}

impl Refusal {
    /// Returns true if the run cannot go on: the motion diverges, or `domain_policy` 2 forbids what the host wants.
    pub(crate) fn ends_run(&self) -> bool {
        matches!(
            self,
            Self::OutsideDomain { .. }
                | Self::Changed { .. }
                | Self::FarFromData { .. }
                | Self::ChangedBefore
                | Self::Diverged { .. }
                | Self::Implausible { .. }
                | Self::Underflow { .. }
                | Self::OutputsDiverged { .. }
        )
    }

    /// Status that the host receives.
    pub(crate) fn status(&self) -> Status {
        match self {
            // "if a status is required which cannot be retrieved by the slave it returns fmi2Discard"
            Self::NoStatus { .. } => Status::Discard,
            // a solver tries again with a smaller step
            Self::StateNotFinite { .. } => Status::Discard,
            Self::NotComputable { status } | Self::ValueNotFinite { status, .. } => *status,
            Self::Diverged { status, .. }
            | Self::OutputsDiverged { status, .. }
            | Self::Implausible { status, .. }
            | Self::Underflow { status, .. } => *status,
            Self::OutsideDomain { status, .. } | Self::FarFromData { status, .. } | Self::Changed { status, .. } => {
                *status
            }
            Self::IllegalState { state: InstanceState::Fatal, .. } => Status::Fatal,
            _ => Status::Error,
        }
    }
}

fn list(states: &[InstanceState]) -> String {
    if states.is_empty() {
        return "a state this FMU never enters".to_owned();
    }
    states.iter().map(|state| format!("`{state}`")).collect::<Vec<_>>().join(", ")
}
