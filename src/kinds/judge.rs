//! The verdict on a surrogate by its accuracy, its training and its FMUs.

use super::{
    record::{MethodRecord, TrainingRecord},
    registry::of,
};
use crate::{
    Result, acceptance,
    evaluation::{AcceptanceCheck, Accuracy, Findings, Reason, Verdict, comparison::Comparison},
    project::Project,
    study::Study,
};
use metafmu_runtime::Surrogate;

impl Project<'_> {
    /// Reads how the training went.
    ///
    /// # Errors
    /// [`Error::Stale`](crate::Error::Stale) if the record is missing or damaged.
    pub fn load_training_record(&self) -> Result<TrainingRecord> {
        self.load_json(&self.training_record(), "metafmu train")
    }

    /// The verdict on a surrogate with this accuracy on the test runs, or on the unseen rows. `validation`: problems of its FMUs.
    pub(crate) fn judge(
        &self,
        surrogate: &Surrogate,
        training: &TrainingRecord,
        accuracy: &Accuracy,
        comparison: Option<&Comparison>,
        validation: Vec<Reason>,
    ) -> Verdict {
        // the candidates of a static map are no baselines: the best of them is exported
        let (measured, comparison) = match accuracy.rows {
            Some(_) => ("unseen rows", None),
            None => ("test runs", comparison),
        };
        let mut others = findings(&self.study, training);
        others.problems.extend(validation);
        acceptance::judge(&self.study, surrogate, (accuracy, measured), comparison, others)
    }
}

/// Findings on the training and the solver, regardless of the accuracy.
pub(crate) fn findings(study: &Study, training: &TrainingRecord) -> Findings {
    let of_training = |cause: String| Reason::new(AcceptanceCheck::Training, "", cause);
    let mut findings = Findings { advice: of(study).advice(study, training), ..Findings::default() };
    findings.problems.extend(training.problems(study).into_iter().map(of_training));
    findings.limits.extend(training.method.as_ref().and_then(MethodRecord::limit).map(of_training));
    if let Some(solver) = training.method.as_ref().and_then(MethodRecord::solver) {
        solver.add_to(&mut findings);
    }
    findings
}
