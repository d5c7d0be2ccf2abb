//! Speed of a surrogate beside that of its source.

use crate::diagnostics::numbers::number;
use metafmu_runtime::Surrogate;
use serde::{Deserialize, Serialize};

/// Speed of a surrogate beside that of its source. Both are measured one after the other on one core, on the first test run.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Speed {
    /// Seconds the source takes for a simulated second; a run is from its start to its end.
    pub source: f64,
    /// Seconds the surrogate takes for a simulated second, in steps of `time.step`.
    pub surrogate: f64,
    /// Speed-up, the former divided by the latter.
    pub speed_up: f64,
}

/// Cost of a surrogate on one core.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Cost {
    /// Seconds the surrogate takes for a row: a step of `time.step`, or a row without a time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds_per_step: Option<f64>,
    /// Speed beside that of the source, if that can be run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed: Option<Speed>,
}

impl Speed {
    /// Speed as text.
    pub fn describe(&self) -> String {
        let Self { source, surrogate, speed_up } = self;
        let [source, surrogate] = [source, surrogate].map(|seconds| number(1e3 * seconds));
        let speed_up = number(*speed_up);
        format!("{speed_up} times as fast as its source: {surrogate} ms for a simulated second, the source {source} ms")
    }

    /// Warning about a surrogate that is slower than its source, with the reason.
    pub(in crate::pipeline) fn warning(&self, surrogate: &Surrogate) -> Option<String> {
        let program = surrogate.program();
        let network = match program.motion() {
            Some(motion) => motion.has_networks(),
            None => {
                let graph = program.graph.called().unwrap_or(&program.graph);
                graph.is_network() || graph.instants().is_some()
            }
        };
        let advice = match (network, surrogate.states().is_empty()) {
            (true, false) => {
                "its networks are computed in every step of the solver: fewer `network.hidden` nodes are faster"
            }
            (true, true) => "its network is computed in every step: fewer `network.hidden` nodes are faster",
            (false, _) => "the source is a small model itself",
        };
        (self.speed_up < 1.0).then(|| format!("the surrogate is only {}; {advice}", self.describe()))
    }
}
