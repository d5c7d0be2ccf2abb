//! Speed of a surrogate beside that of its source.

use crate::{diagnostics::numbers::number, project::Project, source::setting::SourceSetting};
use metafmu_runtime::Surrogate;
use serde::{Deserialize, Serialize};

/// Speed of a surrogate beside that of its source: both make the same test runs with the same output step, alternately
/// on one core. The source has the loosest setting whose error is no larger than the surrogate's. Its set-up before the
/// first step does not count, but for a program that is started for each run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Speed {
    /// Seconds the source takes for a simulated second.
    pub source: f64,
    /// Seconds the surrogate takes for a simulated second.
    pub surrogate: f64,
    /// Speed-up, the former divided by the latter.
    pub speed_up: f64,
    /// Output step of both in s.
    pub output_step: f64,
    /// Number of test runs.
    pub runs: usize,
    /// Setting of the source.
    pub setting: SourceSetting,
    /// Root mean square error of the source in these runs relative to the standard deviation, of the worst output. The
    /// truth is the source with the setting of the study.
    pub source_error: f64,
    /// Relative error of the surrogate in these runs.
    pub surrogate_error: f64,
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
        let Self { source, surrogate, speed_up, .. } = self;
        let [source, surrogate] = [source, surrogate].map(|seconds| number(1e3 * seconds));
        let speed_up = number(*speed_up);
        format!("{speed_up} times as fast as its source: {surrogate} ms for a simulated second, the source {source} ms")
    }

    /// Conditions of the comparison as text.
    pub fn conditions(&self) -> String {
        let Self { output_step, runs, setting, source_error, surrogate_error, .. } = self;
        let (step, surrogate_error) = (number(*output_step), number(100.0 * surrogate_error));
        let runs = if *runs == 1 { "one test run".to_owned() } else { format!("{runs} test runs") };
        let source_error = number(100.0 * source_error);
        let setting = match setting {
            SourceSetting::Tolerance(_) | SourceSetting::StepsPerRow(_) if self.source_error == 0.0 => {
                format!("the source as in the study: {}, as looser ones have larger errors", setting.describe())
            }
            SourceSetting::Tolerance(_) | SourceSetting::StepsPerRow(_) => {
                format!("the source with {}, whose error is {source_error} %", setting.describe())
            }
            SourceSetting::Fixed => "the source as in the study, as it has no looser setting of its accuracy".into(),
        };
        format!(
            "both with outputs every {step} s, alternately in {runs}; the surrogate's RMS error there is {surrogate_error} % of the standard \
             deviation; {setting}"
        )
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

impl Project<'_> {
    /// Reads the cost of a surrogate from `metrics.json`; none if it has not been measured.
    pub(super) fn load_cost(&self, surrogate: &Surrogate) -> Option<Cost> {
        #[derive(Deserialize)]
        struct Measured {
            content_digest: String,
            #[serde(flatten)]
            cost: Cost,
        }
        let measured: Measured = serde_json::from_slice(&std::fs::read(self.metrics()).ok()?).ok()?;
        (measured.content_digest == surrogate.metadata().provenance.content_digest).then_some(measured.cost)
    }
}
