//! Response surrogates in a study file: they have no section alone.

use super::kind::{StudyKind, without_states};
use crate::{
    diagnostics::Problems,
    study::{RunForm, Study},
};
use serde_json::Value;

/// Outputs as functions of parameters and time.
pub(super) struct ResponseStudy;

impl StudyKind for ResponseStudy {
    fn runs(&self) -> RunForm {
        RunForm { are_planned: true, ..RunForm::default() }
    }

    fn section(&self) -> Option<&'static str> {
        None
    }

    fn is_given(&self, _: &Study) -> bool {
        false
    }

    fn digested(&self, _: &Study) -> Option<Value> {
        None
    }

    fn problems_beside(&self, study: &Study) -> Problems {
        without_states(study)
    }
}
