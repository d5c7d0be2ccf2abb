//! Functions of numbers with their derivatives: activations, elementary functions, exponentials, jets.

pub(crate) mod activation;
pub(crate) mod combination;
pub(crate) mod decimal;
pub(crate) mod elementary;
pub(crate) mod exponential;
pub(crate) mod jet;
