//! Record of the training of a discrete-time model.

use super::Candidate;
use crate::diagnostics::numbers::power;
use serde::{Deserialize, Serialize};

/// Result of a training on runs with inputs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DiscreteRecord {
    /// Relative errors in simulations of the held-out runs, of the candidates that were tried. The best is exported unless the study
    /// says otherwise.
    pub candidates: Vec<Candidate>,
    /// The name of the one that is exported.
    pub exported: String,
    /// Number of past samples of outputs and of inputs that the model depends on.
    pub history: [usize; 2],
}

impl DiscreteRecord {
    /// Description of the training as text.
    pub(crate) fn describe(&self) -> String {
        let list: Vec<String> = self
            .candidates
            .iter()
            .map(|Candidate { name, error, .. }| format!("{name} {}", power(*error, 1)))
            .collect();
        let [outputs, inputs] = self.history;
        format!(
            "error in simulations of held-out runs: {}; exported: {} (past samples: outputs {outputs}, inputs {inputs})",
            list.join(", "),
            self.exported
        )
    }
}
