//! What a training leaves beside the surrogate: `training.json`, and what `metrics.json` has of speed.

mod discrete;
mod motion;
mod solver;
mod speed;
mod state_space;
mod static_map;
pub(super) mod trajectories;

pub use discrete::DiscreteRecord;
pub use motion::{MotionRecord, ReactionRecord};
pub use solver::{ImplicitCost, SolverRecord};
pub use speed::Speed;
pub use state_space::StateSpaceRecord;
pub use static_map::StaticRecord;
pub use trajectories::TrajectoriesRecord;

use crate::{
    acceptance::OfTraining,
    study::{Study, StudyStructure},
    training::StopReason,
};
use serde::{Deserialize, Serialize};

/// How the training went.
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
    /// Why it ended.
    pub stopped: StopReason,
    /// Wall time of the training.
    pub train_seconds: f64,
    /// Runs that were added to the plan's to meet the study's target.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub added_runs: usize,
    /// Whether the study's target was met, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_met: Option<bool>,
    /// What is known of the method beyond that; none of a single network, or of one an instant.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub method: Option<MethodRecord>,
}

impl TrainingRecord {
    /// Whether it was stopped before its end.
    pub fn was_interrupted(&self) -> bool {
        self.stopped == StopReason::Interrupted
    }

    /// What is known of the training itself, regardless of the accuracy.
    pub fn findings(&self, study: &Study) -> OfTraining {
        OfTraining { problems: self.problems(study), advice: self.advice(study) }
    }

    fn problems(&self, study: &Study) -> Vec<String> {
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

    /// What may make the surrogate better, the surest first.
    fn advice(&self, study: &Study) -> Vec<String> {
        let Self { epochs, stopped, train_rows, .. } = self;
        if let Some(MethodRecord::StaticMap(StaticRecord { rows, .. })) = &self.method {
            return vec![format!("add rows to the table, which has {rows}")];
        }
        let longer = match stopped {
            StopReason::Interrupted => Some("continue the training that was stopped: --resume".into()),
            StopReason::Finished => Some(format!("train longer: `training.epochs` above {epochs}")),
            _ => None,
        };
        let more = match (study.structure, study.source.is_recorded()) {
            (_, true) => format!("record more runs: these have {train_rows} training rows"),
            (StudyStructure::Dynamics, false) => "more `sampling.states`, or smaller ranges".into(),
            (_, false) => {
                let runs = study.sampling.runs.map_or(String::new(), |runs| format!(" above {runs}"));
                format!("add runs: `sampling.runs`{runs}, or a `[target]`")
            }
        };
        let memory = format!("a longer memory: `discrete.history` above {}", study.discrete.history);
        let memory = (study.structure == StudyStructure::Discrete).then_some(memory);
        let larger = (*epochs > 0).then(|| "a larger network: `network.hidden`".into());
        longer.into_iter().chain([more]).chain(memory).chain(larger).collect()
    }
}

/// What is known of a training by its method; in `training.json` each has a key of its own.
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
}

impl MethodRecord {
    /// What is wrong with the equations.
    fn problem(&self) -> Option<String> {
        match self {
            Self::Motion(motion) => motion.problem(),
            Self::StateSpace(space) => space.problem(),
            Self::Trajectories(trajectories) => trajectories.problem(),
            Self::Discrete(_) | Self::StaticMap(_) => None,
        }
    }

    /// How it went, in words.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Motion(motion) => motion.describe(),
            Self::StateSpace(space) => space.describe(),
            Self::Trajectories(trajectories) => trajectories.describe(),
            Self::Discrete(discrete) => discrete.describe(),
            Self::StaticMap(map) => map.describe(),
        }
    }
}

/// A way to learn the functions.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Candidate {
    /// `dictionary`, `network`, `dictionary and network`, or of a mechanism `accelerations`; of recorded runs that of a [`DiscreteModel`](crate::study::DiscreteModel),
    /// of rows that of a [`ModelKind`](crate::study::ModelKind).
    pub name: String,
    /// Root mean square error at states that were held out, relative to the standard deviation, of the worst of what it is measured of:
    /// of an FMU the functions, of a mechanism the accelerations and the positions, of recorded runs the outputs. Of rows of the mean over the outputs.
    pub error: f64,
    /// Wall time.
    pub seconds: f64,
}

pub(super) const DICTIONARY: &str = "dictionary";
pub(super) const NETWORK: &str = "network";
pub(super) const DICTIONARY_AND_NETWORK: &str = "dictionary and network";
pub(super) const ACCELERATIONS: &str = "accelerations";

/// Candidates in words, with their errors.
pub(super) fn list(candidates: &[Candidate]) -> String {
    let words: Vec<String> =
        candidates.iter().map(|Candidate { name, error, .. }| format!("{name} {error:.1e}")).collect();
    words.join(", ")
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}
