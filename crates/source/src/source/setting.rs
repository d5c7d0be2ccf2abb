//! Setting of a source's accuracy.

use crate::integrate::looser_tolerances;
use serde::{Deserialize, Serialize};

/// Setting of a source's accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceSetting {
    /// Tolerance of the integration of a system, a mechanism or an FMU for model exchange.
    Tolerance(f64),
    /// Number of communication steps between two rows of an FMU for co-simulation.
    StepsPerRow(usize),
    /// The only setting of a program, or of an FMU that chooses its accuracy itself.
    Fixed,
}

impl SourceSetting {
    /// The setting as text.
    pub fn describe(&self) -> String {
        match self {
            Self::Tolerance(tolerance) => format!("a tolerance of {tolerance:?}"),
            Self::StepsPerRow(1) => "one communication step a row".into(),
            Self::StepsPerRow(steps) => format!("{steps} communication steps a row"),
            Self::Fixed => "its own accuracy".into(),
        }
    }

    /// Tolerances from the loosest to the study's. Without a tolerance in the study an FMU has its own, the last setting.
    pub(super) fn tolerances_above(of_study: Option<f64>) -> Vec<Self> {
        let looser = looser_tolerances(of_study.unwrap_or(0.0)).map(Self::Tolerance);
        looser.chain([of_study.map_or(Self::Fixed, Self::Tolerance)]).collect()
    }
}
