//! The verdict on a surrogate: good, usable, or rejected.

use serde::{Deserialize, Serialize};

/// Grade of a surrogate, that of its worst output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Every output is as good as `accept.good` wants.
    Good,
    /// Every output is within the limits of `[accept]`, some are not good.
    Usable,
    /// Some limit of `[accept]` is missed.
    Rejected,
}

/// Verdict on a surrogate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// `true` if it may be used: its grade is good or usable.
    pub accepted: bool,
    /// Grade of the worst output.
    pub grade: Grade,
    /// Reasons for a rejection, one sentence each.
    pub problems: Vec<String>,
    /// Reasons why it is not good, one sentence each; empty if it is rejected.
    #[serde(default)]
    pub limits: Vec<String>,
    /// Changes of the study that may help, one sentence each; empty if it is good.
    #[serde(default)]
    pub advice: Vec<String>,
}

impl Verdict {
    /// The verdict with these problems, limits and advice: rejected if there are problems, good if there are no limits either.
    pub fn of(problems: Vec<String>, limits: Vec<String>, advice: Vec<String>) -> Self {
        let grade = match (problems.is_empty(), limits.is_empty()) {
            (false, _) => Grade::Rejected,
            (true, false) => Grade::Usable,
            (true, true) => Grade::Good,
        };
        let limits = if grade == Grade::Usable { limits } else { Vec::new() };
        let advice = if grade == Grade::Good { Vec::new() } else { advice };
        Self { accepted: grade != Grade::Rejected, grade, problems, limits, advice }
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
    pub fn reasons(&self) -> &[String] {
        if self.grade == Grade::Rejected { &self.problems } else { &self.limits }
    }

    /// Last lines of a command: the grade, its reasons, and what may help.
    pub fn text(&self) -> String {
        let reasons = self.reasons().iter().map(|reason| format!("  {reason}\n"));
        let advice = self.advice.iter().map(|advice| format!("  try: {advice}\n"));
        let lines: String = reasons.chain(advice).collect();
        format!("\n{}\n{lines}", self.title())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grade_follows_from_problems_and_limits() {
        let line = |text: &str| vec![text.to_owned()];
        let good = Verdict::of(Vec::new(), Vec::new(), line("more runs"));
        assert_eq!((good.grade, good.accepted, good.advice.len()), (Grade::Good, true, 0));
        let usable = Verdict::of(Vec::new(), line("x: R² 0.95"), line("more runs"));
        assert_eq!((usable.grade, usable.accepted), (Grade::Usable, true));
        assert!(usable.text().starts_with("\nusable") && usable.text().ends_with("  x: R² 0.95\n  try: more runs\n"));
        let rejected = Verdict::of(line("x: R² 0.5"), line("y: R² 0.95"), line("more runs"));
        assert_eq!((rejected.grade, rejected.accepted, rejected.limits.len()), (Grade::Rejected, false, 0));
        assert!(rejected.text().ends_with("used\n  x: R² 0.5\n  try: more runs\n"), "{}", rejected.text());
        let json = serde_json::to_value(&rejected).unwrap();
        assert_eq!((&json["grade"], &json["accepted"]), (&"rejected".into(), &false.into()));
    }
}
