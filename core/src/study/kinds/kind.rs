//! The questions that a study asks the kind of its surrogate.

use crate::{
    diagnostics::Problems,
    study::{RunForm, Study},
};
use serde::Serialize;
use serde_json::Value;

/// Keys and sections that a study file has, where defaults depend on the kind.
#[derive(Clone, Copy, Debug)]
pub(in crate::study) struct GivenKeys {
    /// The section `network`.
    pub network: bool,
    /// `network.hidden`.
    pub hidden: bool,
    /// The section `training`.
    pub training: bool,
    /// `training.epochs`.
    pub epochs: bool,
    /// `training.clip_norm`.
    pub clip_norm: bool,
    /// `training.schedule`.
    pub schedule: bool,
    /// `training.batch`.
    pub batch: bool,
}

/// A kind of surrogate in a study file.
pub(in crate::study) trait StudyKind: Sync {
    /// The runs that it is learned from.
    fn runs(&self) -> RunForm;

    /// Its section, which other kinds do not have; none of a kind without one.
    fn section(&self) -> Option<&'static str>;

    /// Returns true if a study has options of the section.
    fn is_given(&self, study: &Study) -> bool;

    /// Problems of its section, and of others in combination with it.
    fn problems_beside(&self, study: &Study) -> Problems;

    /// Sections that no study of the kind has, by their names in the file.
    fn refused(&self, _: &dyn Fn(&str) -> bool) -> Problems {
        Problems::default()
    }

    /// Sets options that have other defaults than those of most kinds.
    fn set_defaults(&self, _: &mut Study, _: GivenKeys) {}

    /// Options of the section that decide about the surrogate, for the digest of a study; none if it has none.
    fn digested(&self, study: &Study) -> Option<Value>;
}

/// Options as part of a digest.
pub(super) fn digested(options: &impl Serialize) -> Option<Value> {
    // plain data with string keys: serialization cannot fail
    serde_json::to_value(options).ok()
}

/// Problems of states and inputs in a study whose runs parameters alone determine.
pub(super) fn without_states(study: &Study) -> Problems {
    let mut problems = Problems::default();
    problems.expect_absent(!study.states.is_empty(), "states", "belongs to the structure \"dynamics\"");
    let message = "belongs to the structures \"dynamics\" and \"discrete\"";
    problems.expect_absent(!study.inputs.is_empty(), "inputs", message);
    problems
}
