//! The verdict on a surrogate: good, usable, or rejected.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Grade of a surrogate, that of its worst output or check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Every output is as good as `accept.good` wants.
    Good,
    /// Every output is within the limits of `[accept]`, some are not good.
    Usable,
    /// Some limit of `[accept]` is missed, or a check failed.
    Rejected,
}

/// Check that a reason of a verdict comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AcceptanceCheck {
    /// Errors of the outputs, by the limits of `[accept]`.
    Accuracy,
    /// Comparison with the simpler models of the build.
    Baselines,
    /// End of the training, its target, and the error of the learned equations.
    Training,
    /// Error of the solver inside the FMU, in the training runs and at the corners of the domain.
    Solver,
    /// Motions that leave the domain.
    Domain,
    /// Error of the source's own runs.
    SourceStep,
    /// Validation of an FMU of the build.
    Validation,
}

/// Reason of a grade.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// Its check.
    pub check: AcceptanceCheck,
    /// The output or file that it is about; empty if it concerns all.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub place: String,
    /// Description of what was found and what is expected.
    pub cause: String,
}

impl Reason {
    /// A reason about an output or a file; `place` is empty if it concerns all.
    pub fn new(check: AcceptanceCheck, place: &str, cause: impl Into<String>) -> Self {
        Self { check, place: place.into(), cause: cause.into() }
    }

    /// Returns true if more or other data may help.
    pub fn is_of_learning(&self) -> bool {
        matches!(self.check, AcceptanceCheck::Accuracy | AcceptanceCheck::Baselines | AcceptanceCheck::Training)
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { place, cause, .. } = self;
        if place.is_empty() { f.write_str(cause) } else { write!(f, "{place}: {cause}") }
    }
}

/// Findings of all checks, from which the grade follows.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Reasons for a rejection.
    pub problems: Vec<Reason>,
    /// Reasons why a surrogate is usable and not good.
    pub limits: Vec<Reason>,
    /// Facts that change no grade.
    pub notes: Vec<Reason>,
    /// Changes of the study or the source that may help, the surest first.
    pub advice: Vec<String>,
}

/// Verdict on a surrogate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// `true` if it may be used: its grade is good or usable.
    pub accepted: bool,
    /// Grade of the worst output or check.
    pub grade: Grade,
    /// Reasons for a rejection.
    pub problems: Vec<Reason>,
    /// Reasons why it is not good; empty if it is rejected.
    #[serde(default)]
    pub limits: Vec<Reason>,
    /// Facts to know about any grade.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<Reason>,
    /// Changes of the study or the source that may help, one sentence each; empty if it is good.
    #[serde(default)]
    pub advice: Vec<String>,
}

impl Verdict {
    /// The verdict by these findings: rejected if there are problems, good if there are no limits either.
    pub fn of(Findings { problems, limits, notes, advice }: Findings) -> Self {
        let grade = match (problems.is_empty(), limits.is_empty()) {
            (false, _) => Grade::Rejected,
            (true, false) => Grade::Usable,
            (true, true) => Grade::Good,
        };
        let limits = if grade == Grade::Usable { limits } else { Vec::new() };
        let advice = if grade == Grade::Good { Vec::new() } else { advice };
        Self { accepted: grade != Grade::Rejected, grade, problems, limits, notes, advice }
    }

    /// First line of the verdict, without its reasons.
    pub fn title(&self) -> &'static str {
        match self.grade {
            Grade::Good => "good: every output is within the limits of [accept]",
            Grade::Usable => "usable, not good: know these limits before you use it",
            Grade::Rejected => "rejected: this surrogate is not good enough to be used",
        }
    }

    /// Reasons of the grade: problems of a rejected surrogate, limits of a usable one.
    pub fn reasons(&self) -> &[Reason] {
        if self.grade == Grade::Rejected { &self.problems } else { &self.limits }
    }

    /// Last lines of a command: the grade, its reasons, notes, and what may help.
    pub fn text(&self) -> String {
        let reasons = self.reasons().iter().map(|reason| format!("  {reason}\n"));
        let notes = self.notes.iter().map(|note| format!("  note: {note}\n"));
        let advice = self.advice.iter().map(|advice| format!("  try: {advice}\n"));
        let lines: String = reasons.chain(notes).chain(advice).collect();
        format!("\n{}\n{lines}", self.title())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grade_follows_from_problems_and_limits() {
        let of_output = |cause: &str| vec![Reason::new(AcceptanceCheck::Accuracy, "x", cause)];
        let more_runs = Findings { advice: vec!["more runs".into()], ..Findings::default() };
        let good = Verdict::of(more_runs.clone());
        assert_eq!((good.grade, good.accepted, good.advice.len()), (Grade::Good, true, 0));
        let limited = Findings { limits: of_output("R² 0.95"), ..more_runs };
        let usable = Verdict::of(limited.clone());
        assert_eq!((usable.grade, usable.accepted), (Grade::Usable, true));
        assert!(usable.text().starts_with("\nusable") && usable.text().ends_with("  x: R² 0.95\n  try: more runs\n"));
        let rejected = Verdict::of(Findings { problems: of_output("R² 0.5"), ..limited });
        assert_eq!((rejected.grade, rejected.accepted, rejected.limits.len()), (Grade::Rejected, false, 0));
        assert!(rejected.text().ends_with("used\n  x: R² 0.5\n  try: more runs\n"), "{}", rejected.text());
        let json = serde_json::to_value(&rejected).unwrap();
        assert_eq!((&json["grade"], &json["accepted"]), (&"rejected".into(), &false.into()));
        let problem = serde_json::json!({ "check": "accuracy", "place": "x", "cause": "R² 0.5" });
        assert_eq!(json["problems"], serde_json::json!([problem]));
    }

    #[test]
    fn a_note_is_shown_and_changes_no_grade() {
        let note = Reason::new(AcceptanceCheck::Domain, "", "2 of 20 test runs leave the domain");
        let noted = Verdict::of(Findings { notes: vec![note], ..Findings::default() });
        assert_eq!(noted.grade, Grade::Good);
        assert!(noted.text().ends_with("\n  note: 2 of 20 test runs leave the domain\n"), "{}", noted.text());
    }
}
