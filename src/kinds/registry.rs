//! The kinds by the structure that a study names.

use super::{
    compliant::CompliantKind, discrete::DiscreteKind, dynamics::DynamicsKind, kind::SurrogateKind,
    response::ResponseKind, static_map::StaticKind,
};
use crate::study::{Study, StudyStructure};

/// The kind of a study's surrogate.
pub fn of(study: &Study) -> &'static dyn SurrogateKind {
    match study.structure {
        StudyStructure::Response => &ResponseKind,
        StudyStructure::Dynamics => &DynamicsKind,
        StudyStructure::Discrete => &DiscreteKind,
        StudyStructure::Static => &StaticKind,
        StudyStructure::Compliant => &CompliantKind,
    }
}
