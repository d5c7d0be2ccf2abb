//! Kinds of signals that drive runs, and how error bounds hold for each.

use crate::dataset::Run;
use indexmap::IndexMap;
use metafmu_runtime::{Input, Role, Surrogate};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Kind of signal that drives a calibration run of a surrogate with inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SignalKind {
    /// The signals of the study, as in training and test runs.
    #[serde(rename = "signals")]
    Signals,
    /// Zero, from the source's own start; the start value where zero is outside the range.
    #[serde(rename = "zero input")]
    Zero,
    /// Zero, from other starts, or after signals.
    #[serde(rename = "free decay")]
    Decay,
    /// Every input constant at one of the ends of its range.
    #[serde(rename = "constant at the ends")]
    Ends,
}

/// Share of the calibration rows of one kind of signal that are within the error bounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KindCoverage {
    /// The kind.
    pub kind: SignalKind,
    /// Number of its runs.
    pub runs: usize,
    /// Share of the rows of each output.
    pub within: IndexMap<String, f64>,
}

impl SignalKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Signals, Self::Zero, Self::Decay, Self::Ends];

    /// Value of an input without a signal: zero, or its start value where zero is outside its range.
    pub fn zero([min, max]: [f64; 2], start: f64) -> f64 {
        if (min..=max).contains(&0.0) { 0.0 } else { start }
    }

    /// Kind of the signals of a run of a surrogate.
    pub fn of(surrogate: &Surrogate, run: &Run) -> Self {
        let width = run.inputs.len() / run.times.len().max(1);
        if width == 0 {
            return Self::Signals;
        }
        // inputs with signals are the last ones
        let inputs = &surrogate.inputs()[surrogate.inputs().len() - width..];
        let rows = run.times.partition_point(|time| *time < 0.0);
        let rows = &run.inputs[rows * width..];
        let all = |rows: &[f64], is: fn(&Input, f64) -> bool| {
            rows.chunks(width).all(|row| row.iter().zip(inputs).all(|(found, input)| is(input, *found)))
        };
        let is_zero = |input: &Input, found: f64| found == Self::zero([input.min, input.max], input.start);
        if all(rows, is_zero) {
            let starts = surrogate.inputs().iter().zip(&run.parameters).filter(|(input, _)| input.role == Role::Start);
            let is_own =
                surrogate.states().is_empty() || starts.into_iter().all(|(input, value)| *value == input.start);
            return if is_own { Self::Zero } else { Self::Decay };
        }
        let is_constant = rows.chunks(width).all(|row| *row == rows[..width]);
        if is_constant && all(rows, |input, found| found == input.min || found == input.max) {
            return Self::Ends;
        }
        if all(&rows[rows.len() / width / 2 * width..], is_zero) { Self::Decay } else { Self::Signals }
    }
}

impl fmt::Display for SignalKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}
