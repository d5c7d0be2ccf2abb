//! Run of a system: its components and their connections.

use crate::fmi::host::InterfaceKind;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Run of a system: its components, connections and recorded variables.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SystemRun {
    /// The components, in the order in which they step.
    pub components: Vec<ComponentRun>,
    /// Outputs and the inputs that take their values.
    pub connections: Vec<[Port; 2]>,
    /// Recorded variables: real numbers, integers or booleans.
    pub recorded: Vec<Port>,
    /// Further recorded variables, which are read outside the measured time of a step.
    pub watched: Vec<Port>,
    /// Position of the component whose steps are measured.
    pub measured: usize,
    /// First communication point in s.
    pub start: f64,
    /// Last communication point in s.
    pub stop: f64,
    /// Communication step size in s.
    pub step: f64,
    /// Tolerance of model exchange and of mechanisms; else 1e-8, or that of an FMU's default experiment if it is smaller.
    pub tolerance: Option<f64>,
}

/// A component of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComponentRun {
    /// Name in the system.
    pub name: String,
    /// Its file, for messages.
    pub path: PathBuf,
    /// Model that is simulated.
    pub model: ComponentModel,
    /// Values that variables start with, by name: 0 or 1 for a boolean.
    pub start_values: Vec<(String, f64)>,
    /// Tolerance of its model exchange or mechanism in place of [`SystemRun::tolerance`].
    pub tolerance: Option<f64>,
}

/// Model of a component in a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ComponentModel {
    /// An FMU.
    Fmu {
        /// The folder that it is unpacked in.
        folder: PathBuf,
        /// Who advances its time.
        interface: InterfaceKind,
    },
    /// A mechanism.
    Mechanism {
        /// The content of its file.
        text: String,
    },
}

/// A variable of a component.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Port {
    /// Position of the component.
    pub component: usize,
    /// Name of the variable: a scalar.
    pub variable: String,
}
