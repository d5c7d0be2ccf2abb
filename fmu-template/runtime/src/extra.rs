//! The variables every FMU adds to those of the surrogate: how far its answers may be trusted.
//!
//! Their value references follow those of the outputs, see [`Surrogate::extra_value_reference`].
//!
//! [`Surrogate::extra_value_reference`]: crate::Surrogate::extra_value_reference

/// A variable every FMU has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extra {
    /// Variable name; no variable of a surrogate may have it.
    pub name: &'static str,
    /// Value reference, counted from the first one after the outputs.
    pub offset: u32,
    /// One sentence for people.
    pub description: &'static str,
    /// Type and everything that goes with it.
    pub kind: Kind,
}

/// Type of an [`Extra`] variable, with its causality, variability and range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A tunable parameter: Integer in FMI 2.0, Int32 in FMI 3.0; initial value exact.
    IntegerParameter {
        /// Value before a host sets one.
        start: i32,
        /// Smallest value.
        min: i32,
        /// Largest value.
        max: i32,
    },
    /// A discrete Boolean output, calculated.
    BooleanOutput,
    /// A continuous dimensionless output (Real in FMI 2.0, Float64 in FMI 3.0), calculated, never negative.
    RealOutput,
    /// The independent variable.
    Time,
}

/// What to do outside the training ranges; see [`DomainPolicy`].
pub const DOMAIN_POLICY: Extra = Extra {
    name: "domain_policy",
    offset: 0,
    description: "Outside the training ranges: 0 warns and extrapolates, 1 clamps to the range, 2 refuses",
    kind: Kind::IntegerParameter { start: 0, min: 0, max: 2 },
};

/// Whether every input, parameter and the time are in their training ranges, up to [`TOLERANCE`](crate::TOLERANCE), and
/// inputs and parameters have been what they were at the start of the run if the time is an input of the network.
pub const IN_DOMAIN: Extra = Extra {
    name: "in_domain",
    offset: 1,
    description: "Whether inputs, parameters and time are all in the training ranges, and inputs and parameters unchanged since the start",
    kind: Kind::BooleanOutput,
};

/// How far outside the worst one is; see [`Domain::distance`](crate::Domain::distance).
pub const DOMAIN_DISTANCE: Extra = Extra {
    name: "domain_distance",
    offset: 2,
    description: "Largest distance of an input, parameter or time from its training range, relative to the range; 0 inside",
    kind: Kind::RealOutput,
};

/// The independent variable of a surrogate that has no time column, as FMI 3.0 asks for exactly one.
pub const TIME: Extra = Extra { name: "time", offset: 3, description: "Simulation time", kind: Kind::Time };

/// Those of every FMU, by offset; [`TIME`] comes on top where no column is the time.
pub const ALL: [Extra; 3] = [DOMAIN_POLICY, IN_DOMAIN, DOMAIN_DISTANCE];

/// Values of [`DOMAIN_POLICY`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DomainPolicy {
    /// Compute anyway and warn once a run for each variable.
    #[default]
    Warn,
    /// Compute with inputs, parameters and time clamped to their ranges.
    Clamp,
    /// Refuse to leave the ranges, and to change inputs or parameters during a run.
    Error,
}

impl DomainPolicy {
    const ALL: [Self; 3] = [Self::Warn, Self::Clamp, Self::Error];

    /// The policy whose `as i32` this is.
    pub fn from_number(number: i32) -> Option<Self> {
        usize::try_from(number).ok().and_then(|index| Self::ALL.get(index)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_offsets_are_positions() {
        for (number, policy) in (0..).zip(DomainPolicy::ALL) {
            assert_eq!(policy as i32, number);
            assert_eq!(DomainPolicy::from_number(number), Some(policy));
        }
        assert_eq!([-1, 3, i32::MIN, i32::MAX].map(DomainPolicy::from_number), [None; 4]);
        assert_eq!(ALL.map(|extra| extra.offset), [0, 1, 2]);
    }
}
