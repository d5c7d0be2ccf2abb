//! Built-in systems: those of Choi et al., *Data-driven simulation for general purpose multibody dynamics using deep
//! neural networks*, Multibody System Dynamics (2021).

use crate::integrate::{Budget, IntegrationError};

mod double_pendulum;
mod single_pendulum;
mod slider_crank;
#[cfg(test)]
mod tests;

/// A system with known equations.
#[derive(Debug)]
pub struct System {
    /// Name in a study: `source.system`.
    pub name: &'static str,
    /// One sentence for people.
    pub description: &'static str,
    /// Every quantity that may be a parameter or a constant.
    pub quantities: &'static [SystemQuantity],
    /// Every output, in the order in which `simulate` writes them.
    pub outputs: &'static [SystemOutput],
    /// Mechanism file of the system, with these quantities as parameters and these outputs, for the structure
    /// "dynamics".
    pub mechanism: &'static str,
    /// Points whose paths reports show.
    pub points: &'static [SystemPoint],
    /// The commented study that `metafmu new` writes.
    pub study: &'static str,
    /// Simulates one run. Takes values of `quantities`, evenly spaced times, the tolerance of the integration and the
    /// cost limit. Returns the rows of all outputs, one after the other.
    pub simulate: Simulate,
}

/// From quantities, times, tolerance and budget to rows of outputs, or the reason for a failure.
pub type Simulate = fn(&[f64], &[f64], f64, &Budget) -> Result<Vec<f64>, SystemError>;

/// Reason why a system cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SystemError {
    /// Another number of quantities than the system has.
    #[error("{found} quantities, expected {expected}")]
    Count {
        /// Number of given quantities.
        found: usize,
        /// Number of the system's quantities.
        expected: usize,
    },
    /// A rod that does not reach from the crank to the slider.
    #[error("the rod must be longer than the crank's radius, L/r is {ratio}")]
    ShortRod {
        /// Length of the rod, relative to the radius.
        ratio: f64,
    },
    /// Outputs that are not finite.
    #[error("the motion is not finite")]
    NotFinite,
    /// The equations of motion cannot be integrated.
    #[error(transparent)]
    Integration(#[from] IntegrationError),
}

/// A quantity of a [`System`] that may be a parameter or a constant.
#[derive(Debug)]
pub struct SystemQuantity {
    /// Name.
    pub name: &'static str,
    /// Unit; the value is in this unit.
    pub unit: &'static str,
    /// One sentence for people.
    pub description: &'static str,
    /// Value if the study does not set it.
    pub default: f64,
}

/// An output of a [`System`].
#[derive(Debug)]
pub struct SystemOutput {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// One sentence for people.
    pub description: &'static str,
}

/// A point of a [`System`] that moves in the plane.
#[derive(Debug)]
pub struct SystemPoint {
    /// Name for people.
    pub name: &'static str,
    /// The outputs that its place follows from.
    pub outputs: &'static [&'static str],
    /// Its place in metres, x to the right and y upwards, from the values of the system's quantities and of `outputs`.
    pub position: fn(&[f64], &[f64]) -> [f64; 2],
}

impl System {
    /// Error of another number of quantities than the system has.
    fn wrong_count(&self, found: usize) -> SystemError {
        SystemError::Count { found, expected: self.quantities.len() }
    }

    /// The built-in system of a name.
    pub fn of(name: &str) -> Option<&'static Self> {
        SYSTEMS.iter().copied().find(|system| system.name == name)
    }
}

/// Every built-in system.
pub static SYSTEMS: &[&System] = &[&single_pendulum::SYSTEM, &double_pendulum::SYSTEM, &slider_crank::SYSTEM];
