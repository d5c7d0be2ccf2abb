//! Problems of a file by key, before their lines are known.

use super::numbers::shown;
use std::fmt::Display;

/// Mistakes in a file by dotted key; `Origin` gives them their lines.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Problems(Vec<KeyProblem>);

/// One mistake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyProblem {
    /// Dotted key, for instance `parameters.L.max`.
    pub key: String,
    /// Found and expected values.
    pub message: String,
}

impl Problems {
    /// A single problem.
    pub fn one(key: impl Into<String>, message: impl Into<String>) -> Self {
        Self(vec![KeyProblem { key: key.into(), message: message.into() }])
    }

    /// Adds a problem of a key.
    pub fn add(&mut self, key: impl Into<String>, message: impl Into<String>) {
        self.0.push(KeyProblem { key: key.into(), message: message.into() });
    }

    /// Adds a problem of a key unless its value is good.
    pub fn expect(&mut self, good: bool, key: impl Into<String>, found: impl Display, expected: &str) {
        if !good {
            self.add(key, format!("{}, expected {expected}", shown(found)));
        }
    }

    /// Adds a problem unless the value is positive and finite.
    pub fn expect_positive(&mut self, key: impl Into<String>, value: f64) {
        self.expect(value.is_finite() && value > 0.0, key, value, "a positive number");
    }

    /// Adds a problem of a key that is given where it has no effect; `belongs` says where it has one.
    pub fn expect_absent(&mut self, is_given: bool, key: impl Into<String>, belongs: &str) {
        if is_given {
            self.add(key, belongs);
        }
    }

    /// Adds the problems of a section, whose keys are within it.
    pub fn add_section(&mut self, section: &str, problems: impl IntoIterator<Item = KeyProblem>) {
        for KeyProblem { key, message } in problems {
            self.0.push(KeyProblem { key: format!("{section}.{key}"), message });
        }
    }

    /// Returns true if there are no problems.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One after the other.
    pub fn iter(&self) -> std::slice::Iter<'_, KeyProblem> {
        self.0.iter()
    }
}

impl IntoIterator for Problems {
    type Item = KeyProblem;
    type IntoIter = std::vec::IntoIter<KeyProblem>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl Extend<KeyProblem> for Problems {
    fn extend<I: IntoIterator<Item = KeyProblem>>(&mut self, problems: I) {
        self.0.extend(problems);
    }
}

impl FromIterator<KeyProblem> for Problems {
    fn from_iter<I: IntoIterator<Item = KeyProblem>>(problems: I) -> Self {
        Self(problems.into_iter().collect())
    }
}
