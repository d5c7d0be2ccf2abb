//! The form of the runs that a surrogate is learned from.

/// Runs that a kind of surrogate is learned from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RunForm {
    /// `true` if parameters alone determine them, whose values have a sampling plan.
    pub are_planned: bool,
    /// `true` if they start from sampled values of states.
    pub start_from_states: bool,
    /// `true` if outputs follow from the past: from states, or from samples.
    pub have_memory: bool,
    /// `true` if they are samples: inputs are constant from one row to the next.
    pub are_samples: bool,
    /// `true` if they are rows of a table, without a time.
    pub are_rows: bool,
    /// Default number of runs without a sampling plan.
    pub usual_number: usize,
}
