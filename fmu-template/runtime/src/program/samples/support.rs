//! Training ranges of the outputs that a model feeds back, and of the inputs that drove it.

use crate::{
    FormatError,
    check::{expect_finite, expect_shape},
};

/// Smallest distance that counts as outside, relative to the width of a range.
pub(super) const NEGLIGIBLE: f64 = 0.003;

/// Ranges of the transitions in training. The features of the transition from sample k to sample k + 1 are
///
/// ```text
/// u[k],  s[k] = s[k - 1] + (u[k] - s[k - 1]) / M,  u[k] - u[k - 1],  y[k + 1],  y[k + 1] - y[k]
/// ```
///
/// `s` is the average of the inputs. A constant input at an end of its range never leaves the range, but its average leaves that of inputs
/// that change. A model with one past input has no features of inputs. The distance of a transition is that of its farthest feature from the
/// feature's range, relative to the width of the range. Errors made outside are fed back, so a distance lasts: it fades by a factor
/// `exp(-1 / M)` from sample to sample, and ends where it is negligible. Measured outputs end it sooner, see [`Sampling::settling`](super::Sampling::settling).
#[derive(Clone, Debug, PartialEq)]
pub struct Support {
    /// Smallest and largest value of each feature.
    pub ranges: Vec<[f64; 2]>,
    /// `M`, at least 1.
    pub samples: f64,
}

/// Values that determine the features of a transition.
#[derive(Clone, Copy, Debug)]
pub struct Transition<'a> {
    /// Averages of the inputs; empty with one past input.
    pub means: &'a [f64],
    /// Inputs at the previous sample and at this one, one for each average.
    pub inputs: [&'a [f64]; 2],
    /// Outputs at the sample and at the next one.
    pub outputs: [&'a [f64]; 2],
}

impl<'a> Transition<'a> {
    /// The features, in order. Does not allocate.
    pub fn features(&self) -> impl Iterator<Item = f64> + 'a {
        let Self { means, inputs: [before, at], outputs: [now, next] } = *self;
        let changes = |from: &'a [f64], to: &'a [f64]| to.iter().zip(from).map(|(to, from)| to - from);
        let of_inputs = at.iter().chain(means).copied().chain(changes(before, at));
        of_inputs.chain(next.iter().copied()).chain(changes(now, next))
    }
}

impl Support {
    /// The support of transitions with these features; `samples`: see [`Support::samples`].
    pub fn of(transitions: impl IntoIterator<Item = Vec<f64>>, samples: f64) -> Self {
        let mut ranges: Vec<[f64; 2]> = Vec::new();
        for features in transitions {
            ranges.resize(features.len(), [f64::INFINITY, f64::NEG_INFINITY]);
            for ([min, max], value) in ranges.iter_mut().zip(features) {
                (*min, *max) = (min.min(value), max.max(value));
            }
        }
        Self { ranges, samples }
    }

    /// Averages of the inputs after one more sample: `s[k]` from `s[k - 1]` and `u[k]`.
    pub fn average(&self, means: &mut [f64], inputs: &[f64]) {
        means.iter_mut().zip(inputs).for_each(|(mean, input)| *mean += (input - *mean) / self.samples);
    }

    /// Checks the number of features, and that ranges and `M` are valid.
    ///
    /// # Errors
    /// A [`FormatError`].
    pub(super) fn check(&self, features: usize) -> Result<(), FormatError> {
        expect_shape("support.ranges", &[self.ranges.len()], &[features])?;
        expect_finite("support.ranges", self.ranges.iter().flatten().copied())?;
        let is_in_order = self.ranges.iter().all(|[min, max]| min <= max);
        let fits = self.samples.is_finite() && self.samples >= 1.0;
        if fits && is_in_order { Ok(()) } else { Err(FormatError::Support) }
    }

    /// Factor by which a distance fades from sample to sample.
    pub fn fading(&self) -> f64 {
        (-1.0 / self.samples).exp()
    }

    /// Distance after a transition, from the distance before it; `fading`: [`Support::fading`]. Does not allocate.
    pub(super) fn distance(&self, transition: &Transition, before: f64, fading: f64) -> f64 {
        let distances = transition.features().zip(&self.ranges).map(|(value, range)| distance(value, *range));
        let lasting = distances.fold(before * fading, f64::max);
        if lasting < NEGLIGIBLE { 0.0 } else { lasting.min(f64::MAX) }
    }
}

/// Distance of a value from its range, relative to the width of the range, or to the magnitude of a constant feature.
#[inline]
fn distance(value: f64, [min, max]: [f64; 2]) -> f64 {
    let width = match max - min {
        width if width > 0.0 => width,
        _ if max != 0.0 => max.abs(),
        _ => 1.0,
    };
    (min - value).max(value - max) / width
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Average of an input, its change, an output and the next one.
    type Row = [f64; 4];

    fn with<T>([mean, change, now, next]: Row, of: impl Fn(&Transition) -> T) -> T {
        of(&Transition { means: &[mean], inputs: [&[0.0], &[change]], outputs: [&[now], &[next]] })
    }

    /// An output from 0 to 10 that changes by at most 2 a sample, and an input that is 0.5 on average at most.
    fn support() -> Support {
        let rows = [[0.0, 0.0, 0.0, 2.0], [0.5, 1.0, 2.0, 0.0], [0.1, -1.0, 9.0, 10.0]];
        let support = Support::of(rows.map(|row| with(row, |transition| transition.features().collect())), 5.0);
        support.check(5).unwrap();
        support
    }

    fn distance(row: Row, before: f64) -> f64 {
        let support = support();
        with(row, |transition| support.distance(transition, before, support.fading()))
    }

    #[test]
    fn a_transition_is_outside_if_an_average_a_change_or_an_output_leaves_its_range() {
        assert_eq!(support().ranges, [[-1.0, 1.0], [0.0, 0.5], [-1.0, 1.0], [0.0, 10.0], [-2.0, 2.0]]);
        assert_eq!(distance([0.2, 0.5, 4.0, 5.0], 0.0), 0.0);
        assert_eq!(distance([1.0, 0.5, 4.0, 5.0], 0.0), 1.0);
        assert_eq!(distance([0.2, -2.0, 4.0, 5.0], 0.0), 0.5);
        assert_eq!(distance([0.2, 0.5, 9.5, 11.0], 0.0), 0.1);
        assert_eq!(distance([0.2, 0.5, 4.0, 7.0], 0.0), 0.25);
        assert_eq!(distance([0.2, 0.5, 9.5, 10.02], 0.0), 0.0, "a negligible part of the range");
        assert_eq!(distance([0.2, 0.5, 4.0, f64::INFINITY], 0.0), f64::MAX);
    }

    #[test]
    fn a_distance_fades_and_ends() {
        let inside = [0.2, 0.5, 4.0, 5.0];
        let mut lasting = distance([1.0, 0.5, 4.0, 5.0], 0.0);
        let mut samples = 0;
        while lasting > 0.0 {
            lasting = distance(inside, lasting);
            samples += 1;
        }
        assert_eq!(samples, (5.0 * (1.0 / NEGLIGIBLE).ln()).ceil() as i32);
        assert_eq!(distance([0.2, 0.5, 9.5, 11.0], 0.01), 0.1, "the larger one counts");
    }

    #[test]
    fn a_support_that_makes_no_sense_is_refused() {
        assert!(support().check(4).is_err());
        assert!(Support { samples: 0.5, ..support() }.check(5).is_err());
        assert!(Support { ranges: vec![[1.0, 0.0]; 5], samples: 5.0 }.check(5).is_err());
        assert!(Support { ranges: vec![[0.0, f64::NAN]; 5], samples: 5.0 }.check(5).is_err());
    }
}
