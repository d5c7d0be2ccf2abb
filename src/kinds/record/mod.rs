//! Records of a training beside the surrogate: `training.json`.

mod compliant;
mod discrete;
mod motion;
mod solver;
mod state_space;
mod static_map;
pub(super) mod trajectories;

pub use compliant::CompliantRecord;
pub use discrete::DiscreteRecord;
pub use motion::{CornerError, CornerRecord, MotionRecord, ReactionRecord};
pub(super) use solver::POOR;
pub use solver::{ImplicitCost, SolverRecord};
pub use state_space::StateSpaceRecord;
pub use static_map::StaticRecord;
pub use trajectories::TrajectoriesRecord;

use crate::{
    diagnostics::numbers::{counted, power},
    study::Study,
    training::StopReason,
};
use serde::{Deserialize, Serialize};

/// Record of a training.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Rows that the network was trained on.
    pub train_rows: usize,
    /// Runs that were held out of the training.
    pub validation_runs: usize,
    /// Epochs that were done.
    pub epochs: usize,
    /// The epoch that is kept, the best on the held-out runs.
    pub best_epoch: usize,
    /// Reason why it ended.
    pub stopped: StopReason,
    /// Wall time of the training.
    pub train_seconds: f64,
    /// Processor time of the training of a network that is compared with simpler models.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub processor_seconds: Option<f64>,
    /// Runs that were added to the plan's to meet the study's target.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub added_runs: usize,
    /// `true` if the study's target was met; none without a target.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_met: Option<bool>,
    /// Record of the method; none for a single network, or for one network per instant.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub method: Option<MethodRecord>,
}

impl TrainingRecord {
    /// Record of functions that were solved for from rows, without epochs.
    pub(crate) fn solved(train_rows: usize, train_seconds: f64, method: MethodRecord) -> Self {
        Self {
            train_rows,
            validation_runs: 0,
            epochs: 0,
            best_epoch: 0,
            stopped: StopReason::Solved,
            train_seconds,
            processor_seconds: None,
            added_runs: 0,
            target_met: None,
            method: Some(method),
        }
    }

    /// The record with the epochs of networks that were trained as well.
    pub(crate) fn with_epochs(self, epochs: usize, best_epoch: usize, stopped: StopReason) -> Self {
        Self { epochs, best_epoch, stopped, ..self }
    }

    /// Returns true if it was stopped before its end.
    pub fn was_interrupted(&self) -> bool {
        self.stopped == StopReason::Interrupted
    }

    /// Problems of the training, regardless of the accuracy.
    pub(super) fn problems(&self, study: &Study) -> Vec<String> {
        let Self { epochs, stopped, target_met, method, .. } = self;
        let poor = method.as_ref().and_then(MethodRecord::problem);
        let diverged = *stopped == StopReason::Diverged;
        let diverged = diverged.then(|| format!("the training diverged after {epochs} epochs: {stopped}"));
        let short = study
            .target
            .filter(|_| *target_met == Some(false))
            .map(|target| format!("not every output reached an R² of {} on the held-out runs (target.r2)", target.r2));
        diverged.into_iter().chain(short).chain(poor).collect()
    }

    /// Description of the data, the training and its result in one line.
    pub(super) fn describe(&self, study: &Study) -> String {
        let Self { train_rows: rows, validation_runs, epochs, best_epoch, stopped, method, .. } = self;
        let held_out = counted(*validation_runs, "run");
        let Some(method) = method else {
            let all = study.training.epochs;
            return format!(
                "{rows} rows, {held_out} held out, {epochs} of {all} epochs ({stopped}), the best is {best_epoch}"
            );
        };
        let data = match method {
            MethodRecord::Motion(_) => format!("{rows} configurations"),
            MethodRecord::StateSpace(_) => format!("{rows} states"),
            MethodRecord::Trajectories(_) | MethodRecord::StaticMap(_) => format!("{rows} rows"),
            MethodRecord::Discrete(_) => format!("{rows} samples, {held_out} held out"),
            MethodRecord::Compliant(_) => format!("{rows} rows, {held_out} held out"),
        };
        format!("{data}, {}", method.describe().replace('\n', "; "))
    }
}

/// Record of a training by its method; in `training.json` each method has a separate key.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MethodRecord {
    /// Equations of motion of a mechanism.
    Motion(MotionRecord),
    /// Equations of an FMU.
    StateSpace(StateSpaceRecord),
    /// Equations from the motions of a table.
    Trajectories(TrajectoriesRecord),
    /// A discrete-time model of runs with inputs.
    Discrete(DiscreteRecord),
    /// A static map of the rows of a table.
    StaticMap(StaticRecord),
    /// The force of a flexible part.
    Compliant(CompliantRecord),
}

impl MethodRecord {
    /// Problem of the equations, if there is one.
    fn problem(&self) -> Option<String> {
        match self {
            Self::Motion(motion) => motion.problem(),
            Self::StateSpace(space) => space.problem(),
            Self::Trajectories(trajectories) => trajectories.problem(),
            Self::Discrete(_) | Self::StaticMap(_) | Self::Compliant(_) => None,
        }
    }

    /// Limit of the equations, if there is one.
    pub(super) fn limit(&self) -> Option<String> {
        match self {
            Self::Motion(motion) => motion.limit(),
            Self::StateSpace(_) | Self::Trajectories(_) => None,
            Self::Discrete(_) | Self::StaticMap(_) | Self::Compliant(_) => None,
        }
    }

    /// Integration of the states, if there are any.
    pub(super) fn solver(&self) -> Option<&SolverRecord> {
        match self {
            Self::Motion(motion) => Some(&motion.solver),
            Self::StateSpace(space) => Some(&space.solver),
            Self::Trajectories(trajectories) => Some(&trajectories.solver),
            Self::Discrete(_) | Self::StaticMap(_) | Self::Compliant(_) => None,
        }
    }

    /// Description of the training as text, in lines.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Motion(motion) => motion.describe(),
            Self::StateSpace(space) => space.describe(),
            Self::Trajectories(trajectories) => trajectories.describe(),
            Self::Discrete(discrete) => discrete.describe(),
            Self::StaticMap(map) => map.describe(),
            Self::Compliant(element) => element.describe(),
        }
    }
}

/// A way to learn the functions.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Candidate {
    /// `dictionary`, `network`, `dictionary and network`, or of a mechanism `accelerations`; of recorded runs that of a [`DiscreteModel`](crate::study::DiscreteModel),
    /// of rows that of a [`ModelKind`](crate::study::ModelKind).
    pub name: String,
    /// Root mean square error at held-out states, relative to the standard deviation. It is the largest error of the
    /// functions of an FMU, of the accelerations and positions of a mechanism, or of the outputs of recorded runs. For
    /// rows it is the mean over the outputs.
    pub error: f64,
    /// Wall time; processor time of a kind of model of rows.
    pub seconds: f64,
}

pub(super) const DICTIONARY: &str = "dictionary";
pub(super) const NETWORK: &str = "network";
pub(super) const DICTIONARY_AND_NETWORK: &str = "dictionary and network";
pub(super) const ACCELERATIONS: &str = "accelerations";

/// Candidates as text, with their errors.
pub(super) fn list(candidates: &[Candidate]) -> String {
    let words: Vec<String> =
        candidates.iter().map(|Candidate { name, error, .. }| format!("{name} {}", power(*error, 1))).collect();
    words.join(", ")
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}
