//! Records of a training beside the surrogate: `training.json`, and the speeds in `metrics.json`.

mod compliant;
mod discrete;
mod motion;
mod solver;
mod speed;
mod state_space;
mod static_map;
pub(super) mod trajectories;

pub use compliant::CompliantRecord;
pub use discrete::DiscreteRecord;
pub use motion::{CornerError, CornerRecord, MotionRecord, ReactionRecord};
pub(super) use solver::POOR;
pub use solver::{ImplicitCost, SolverRecord};
pub use speed::{Cost, Speed};
pub use state_space::StateSpaceRecord;
pub use static_map::StaticRecord;
pub use trajectories::TrajectoriesRecord;

use crate::{
    diagnostics::numbers::power,
    evaluation::{AcceptanceCheck, Findings, Reason},
    study::{Study, StudyStructure},
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
    pub(in crate::pipeline) fn solved(train_rows: usize, train_seconds: f64, method: MethodRecord) -> Self {
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
    pub(in crate::pipeline) fn with_epochs(self, epochs: usize, best_epoch: usize, stopped: StopReason) -> Self {
        Self { epochs, best_epoch, stopped, ..self }
    }

    /// Returns true if it was stopped before its end.
    pub fn was_interrupted(&self) -> bool {
        self.stopped == StopReason::Interrupted
    }

    /// Findings on the training and the solver, regardless of the accuracy.
    pub fn findings(&self, study: &Study) -> Findings {
        let of_training = |cause: String| Reason::new(AcceptanceCheck::Training, "", cause);
        let mut findings = Findings { advice: self.advice(study), ..Findings::default() };
        findings.problems.extend(self.problems(study).into_iter().map(of_training));
        findings.limits.extend(self.method.as_ref().and_then(MethodRecord::limit).map(of_training));
        if let Some(solver) = self.method.as_ref().and_then(MethodRecord::solver) {
            solver.add_to(&mut findings);
        }
        findings
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

    /// Advice that may improve the surrogate, the surest first.
    fn advice(&self, study: &Study) -> Vec<String> {
        let Self { epochs, stopped, train_rows, .. } = self;
        if let Some(MethodRecord::StaticMap(StaticRecord { rows, .. })) = &self.method {
            return vec![format!("add rows to the table, which has {rows}")];
        }
        let is_planned = study.is_compliant() && !study.source.is_recorded();
        let longer = match stopped {
            StopReason::Interrupted => Some("continue the training that was stopped: --resume".into()),
            StopReason::Finished => Some(format!("train longer: `training.epochs` above {epochs}")),
            _ => None,
        };
        let more = match (study.structure, study.source.is_recorded()) {
            (_, true) => format!("record more runs: these have {train_rows} training rows"),
            (_, false) if is_planned => "more `sampling.runs`, or motions that reach more of the ranges".into(),
            (StudyStructure::Dynamics, false) => match &self.method {
                Some(MethodRecord::Motion(motion)) if !motion.may_gain_from_states() => "smaller ranges".into(),
                _ => "more `sampling.states`, or smaller ranges".into(),
            },
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
    fn limit(&self) -> Option<String> {
        match self {
            Self::Motion(motion) => motion.limit(),
            Self::StateSpace(_) | Self::Trajectories(_) => None,
            Self::Discrete(_) | Self::StaticMap(_) | Self::Compliant(_) => None,
        }
    }

    /// Integration of the states, if there are any.
    fn solver(&self) -> Option<&SolverRecord> {
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
