//! Options of a run of an FMU.

use super::Inputs;
use serde::{Deserialize, Serialize};

/// Options of a run. Missing ones come from the FMU's default experiment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SimulationOptions {
    /// Start time; else the FMU's, else 0.
    pub start: Option<f64>,
    /// Stop time; else the FMU's.
    pub stop: Option<f64>,
    /// Communication step size; else the FMU's, else a 500th of the whole.
    pub step: Option<f64>,
    /// Model exchange: tolerance of a step, relative to each state and to its nominal value; else that of the FMU's default
    /// experiment, else 1e-8.
    pub tolerance: Option<f64>,
    /// Model exchange: continuous states that the run begins with, in place of those after the initialization.
    pub states: Option<Vec<f64>>,
    /// Values that variables start with, by name: 0 or 1 for a boolean.
    pub start_values: Vec<(String, f64)>,
    /// Inputs that change over time.
    pub inputs: Inputs,
    /// Co-simulation: `true` if the inputs of a communication point are set before its outputs are read, so that the
    /// inputs and outputs of a row have one time. Else the outputs at the end of a step belong to the inputs at its
    /// beginning, as in other hosts.
    pub inputs_first: bool,
    /// Names of further variables to record.
    pub record: Vec<String>,
    /// `true` if only these variables are recorded, without the outputs.
    pub record_only: bool,
}
