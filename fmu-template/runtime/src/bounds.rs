//! Error bounds of outputs.

use crate::FormatError;
use serde::Serialize;

/// Split-conformal error bounds. On a run drawn like those that the bounds were measured on, the share `coverage` of
/// the rows is expected to satisfy `|y - prediction| <= half_width`, separately for each output. The errors of a model
/// with a state grow: there, this holds for the rows between any two consecutive `times`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// Stated share of rows, between 0 and 1.
    pub coverage: f64,
    /// Number of runs the bounds were measured on, seen neither in training nor in tests.
    pub runs: u64,
    /// Times since the start of a run, in seconds, increasing from 0, of a model with a state. Bounds are linear
    /// between them and constant after the last one. Empty: bounds do not depend on the time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub times: Vec<f64>,
    /// The bound of each output, in its unit, not negative: shape `[max(times, 1), outputs]`.
    pub half_widths: Vec<f64>,
}

impl Bounds {
    /// Bound of an output `elapsed` seconds after the start of a run. Does not allocate.
    ///
    /// # Panics
    /// If there is no such output.
    pub fn at(&self, output: usize, elapsed: f64) -> f64 {
        // the first time is zero, which a time before the start counts as
        let next = self.times.partition_point(|&time| time <= elapsed).max(1);
        if next >= self.times.len() {
            return self.half_width(output, self.times.len().saturating_sub(1));
        }
        let share = (elapsed - self.times[next - 1]) / (self.times[next] - self.times[next - 1]);
        let (before, after) = (self.half_width(output, next - 1), self.half_width(output, next));
        before + share.max(0.0) * (after - before)
    }

    /// Half width for an output at one of the times.
    #[inline]
    fn half_width(&self, output: usize, time: usize) -> f64 {
        let outputs = self.half_widths.len() / self.times.len().max(1);
        self.half_widths[time * outputs..][..outputs][output]
    }

    /// Derivative of a bound with respect to that time, of the part that follows. Does not allocate.
    ///
    /// # Panics
    /// If there is no such output.
    pub fn rate(&self, output: usize, elapsed: f64) -> f64 {
        let next = self.times.partition_point(|&time| time <= elapsed);
        let Some(&end) = self.times.get(next).filter(|_| next > 0) else { return 0.0 };
        let begin = self.times[next - 1];
        (self.at(output, end) - self.at(output, begin)) / (end - begin)
    }

    /// Largest bound of an output.
    ///
    /// # Panics
    /// If there is no such output.
    pub fn largest(&self, output: usize) -> f64 {
        let outputs = self.half_widths.len() / self.times.len().max(1);
        assert!(output < outputs, "output {output} of {outputs}");
        self.half_widths.iter().skip(output).step_by(outputs).copied().fold(0.0, f64::max)
    }

    /// Returns true if the bounds depend on the time since the start.
    pub fn grow(&self) -> bool {
        !self.times.is_empty()
    }

    /// Makes sure that there is a bound for each of `outputs` outputs, and that they make sense.
    ///
    /// # Errors
    /// [`FormatError::BoundCount`] or [`FormatError::Bound`].
    pub(crate) fn check(&self, outputs: usize) -> Result<(), FormatError> {
        let expected = outputs * self.times.len().max(1);
        if self.half_widths.len() != expected {
            return Err(FormatError::BoundCount { found: self.half_widths.len(), expected });
        }
        if !(self.coverage > 0.0 && self.coverage < 1.0) {
            return Err(FormatError::Bound { what: "coverage", found: self.coverage });
        }
        let mut before = -f64::MIN_POSITIVE;
        for (index, &time) in self.times.iter().enumerate() {
            if !(time.is_finite() && time > before && (index > 0 || time == 0.0)) {
                return Err(FormatError::Bound { what: "time", found: time });
            }
            before = time;
        }
        match self.half_widths.iter().find(|&&width| !(width.is_finite() && width >= 0.0)) {
            Some(&found) => Err(FormatError::Bound { what: "half-width", found }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_linear_between_times_and_stay_at_the_end() {
        let bounds = Bounds {
            coverage: 0.9,
            runs: 9,
            times: vec![0.0, 1.0, 3.0],
            half_widths: vec![1.0, 0.0, 2.0, 0.5, 6.0, 0.5],
        };
        bounds.check(2).unwrap();
        for (elapsed, expected) in
            [(-1.0, 1.0), (0.0, 1.0), (0.5, 1.5), (1.0, 2.0), (2.0, 4.0), (3.0, 6.0), (99.0, 6.0)]
        {
            assert_eq!(bounds.at(0, elapsed), expected, "{elapsed}");
        }
        assert_eq!([-1.0, 0.0, 0.5, 1.0, 3.0].map(|elapsed| bounds.rate(0, elapsed)), [0.0, 1.0, 1.0, 2.0, 0.0]);
        assert_eq!([bounds.at(1, 0.5), bounds.largest(0), bounds.largest(1)], [0.25, 6.0, 0.5]);
        let constant = Bounds { coverage: 0.9, runs: 9, times: Vec::new(), half_widths: vec![1.0, 2.0] };
        assert_eq!([constant.at(1, 7.0), constant.largest(0)], [2.0, 1.0]);
    }

    #[test]
    fn times_that_do_not_increase_from_zero_are_refused() {
        for (times, found) in
            [(vec![0.5, 1.0], 0.5), (vec![0.0, 0.0], 0.0), (vec![0.0, 2.0, 1.0], 1.0), (vec![-1.0, 0.0], -1.0)]
        {
            let half_widths = vec![1.0; times.len()];
            let error = Bounds { coverage: 0.9, runs: 9, times, half_widths }.check(1).unwrap_err();
            assert!(matches!(error, FormatError::Bound { what: "time", found: wrong } if wrong == found), "{error}");
        }
        let error = Bounds { coverage: 0.9, runs: 9, times: vec![0.0, f64::NAN], half_widths: vec![1.0; 2] }.check(1);
        assert!(error.is_err());
        let error = Bounds { coverage: 0.9, runs: 9, times: vec![0.0, 1.0], half_widths: vec![1.0; 2] }.check(2);
        assert!(matches!(error, Err(FormatError::BoundCount { found: 2, expected: 4 })));
    }
}
