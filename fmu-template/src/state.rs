//! Where in its life an instance is, and how a table says what may be called there.

use std::fmt;

/// Version of the standard an instance was made by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Version {
    Fmi2,
    Fmi3,
}

/// Who advances time: the FMU over a step, or a solver around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interface {
    CoSimulation,
    ModelExchange,
}

/// A mode of the standard's state machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InstanceState {
    Instantiated,
    Initialization,
    Event,
    ContinuousTime,
    Step,
    Terminated,
    /// FMI 2.0, after the run has failed. The standard: "the simulation cannot be continued with this FMU instance", but
    /// for a reset or a restored state. In FMI 3.0 this is `Terminated`.
    Error,
    /// FMI 3.0 co-simulation: within a step, while the host is called back.
    IntermediateUpdate,
    /// After a panic: nothing is known about the values any more.
    Fatal,
}

/// In which states a function may be called: one column each in the order of [`InstanceState`], separated by spaces. `x`: yes,
/// `c`: in co-simulation, `m`: in model exchange, anything else and what is missing: no.
pub(crate) type Row = &'static [u8];

impl InstanceState {
    pub(crate) const ALL: [Self; 9] = [
        Self::Instantiated,
        Self::Initialization,
        Self::Event,
        Self::ContinuousTime,
        Self::Step,
        Self::Terminated,
        Self::Error,
        Self::IntermediateUpdate,
        Self::Fatal,
    ];

    /// The state whose `as u8` this is, if an instance can be saved in it.
    pub(crate) fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied().filter(|state| *state != Self::IntermediateUpdate)
    }

    #[inline]
    pub(crate) fn allows(self, row: Row, interface: Interface) -> bool {
        match row.get(2 * self as usize) {
            Some(b'x') => true,
            Some(b'c') => interface == Interface::CoSimulation,
            Some(b'm') => interface == Interface::ModelExchange,
            _ => false,
        }
    }
}

/// The standard's names.
impl fmt::Display for InstanceState {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Instantiated => "instantiated",
            Self::Initialization => "Initialization Mode",
            Self::Event => "Event Mode",
            Self::ContinuousTime => "Continuous-Time Mode",
            Self::Step => "Step Mode",
            Self::Terminated => "terminated",
            Self::Error => "error",
            Self::IntermediateUpdate => "Intermediate Update Mode",
            Self::Fatal => "fatal",
        })
    }
}
