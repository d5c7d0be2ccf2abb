//! Runs that are driven by other kinds of signals than those of the study.

use crate::evaluation::SignalKind;
use std::collections::HashMap;

/// Kind of the signals of some runs, by the bits of their points; all others have those of the study.
#[derive(Clone, Debug, Default)]
pub struct Kinds(pub(super) HashMap<Vec<u64>, (SignalKind, Corner)>);

/// Corner of the ranges of inputs, by number; corner `2 k + 1` is opposite corner `2 k`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Corner(pub(super) usize);

impl Corner {
    /// Returns true if an input is at the upper end of its range.
    pub fn is_high(self, input: usize) -> bool {
        let Self(number) = self;
        let bit = number.checked_shr(input as u32 + 1).unwrap_or(0) & 1;
        (bit ^ number) & 1 == 1
    }
}

impl Kinds {
    /// Kind of the run of a point; with [`SignalKind::Ends`] the corner of the inputs.
    pub fn of(&self, point: &[f64]) -> (SignalKind, Corner) {
        let signals = (SignalKind::Signals, Corner::default());
        if self.0.is_empty() { signals } else { self.0.get(&bits(point)).copied().unwrap_or(signals) }
    }
}

pub(super) fn bits(point: &[f64]) -> Vec<u64> {
    point.iter().map(|value| value.to_bits()).collect()
}
