//! Numbers of operations of a computation in the worst case, for `model_data.h`.

use super::push;

/// Numbers of operations of a kind each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Operations {
    /// Multiplications, additions and divisions.
    pub arithmetic: f64,
    /// Sines and cosines.
    pub sines: f64,
    /// Exponential functions.
    pub exponentials: f64,
    pub comparisons: f64,
    /// Other functions of the C library.
    pub functions: f64,
    /// Activations of a network's nodes.
    pub activations: f64,
}

impl Operations {
    /// These operations `count` times, plus `others`.
    pub fn times(self, count: f64, others: Self) -> Self {
        Self {
            arithmetic: count * self.arithmetic + others.arithmetic,
            sines: count * self.sines + others.sines,
            exponentials: count * self.exponentials + others.exponentials,
            comparisons: count * self.comparisons + others.comparisons,
            functions: count * self.functions + others.functions,
            activations: count * self.activations + others.activations,
        }
    }

    /// Comment that names the origin of the operations, and the files with the formula.
    pub fn remark(&self, what: &str, formula: &str) -> String {
        let mut text = format!("\n/*\n * {what} at worst\n *\n");
        for (count, what) in [
            (self.arithmetic, "multiplications, additions and divisions"),
            (self.sines, "sines and cosines"),
            (self.exponentials, "exponentials"),
            (self.comparisons, "comparisons"),
            (self.functions, "other functions of the C library"),
            (self.activations, "activations of a network's nodes, by activation.c"),
        ] {
            if count > 0.0 {
                push(&mut text, format_args!(" *     {count} {what}\n"));
            }
        }
        text + &format!(" *\n * and {formula} the formula.\n */\n")
    }
}
