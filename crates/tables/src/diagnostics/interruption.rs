//! State of a build after Ctrl-C: the results that are complete, and those that are missing.

use std::fmt;

/// State of a build that Ctrl-C ended or shortened.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Interruption {
    /// The work that it stopped, for instance "runs were sampled".
    pub during: String,
    /// Results that are complete.
    pub done: Vec<String>,
    /// Results that are missing or incomplete.
    pub missing: Vec<String>,
}

/// Three lines.
impl fmt::Display for Interruption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { during, done, missing } = self;
        write!(f, "stopped by Ctrl-C while {during}\ndone: {}\nmissing: {}", listed(done), listed(missing))
    }
}

fn listed(results: &[String]) -> String {
    if results.is_empty() { "nothing".into() } else { results.join(", ") }
}
