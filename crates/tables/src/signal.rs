//! Signals: values over time of the inputs that act on a component while it runs.

use std::f64::consts::TAU;

/// A value over time.
#[derive(Clone, Debug, PartialEq)]
pub enum Signal {
    /// Constant value.
    Constant(f64),
    /// The value of the last knot that is not after the time: steps, pseudo-random binary signals, sampled data with a
    /// zero-order hold. Before the first knot, its value.
    Held(Knots),
    /// Linear between the knots, constant outside of them: ramps, sampled data with a first-order hold.
    Linear(Knots),
    /// `offset + sum of amplitude sin(2 pi frequency t + phase)`: band-limited, and smooth.
    Multisine {
        /// Its mean.
        offset: f64,
        /// The terms of the sum.
        sines: Vec<SineTerm>,
    },
    /// `offset + amplitude sin(phase(t))` with a frequency that grows linearly from `from` to `to` in `duration` seconds, and stays
    /// there.
    Chirp {
        /// Its mean.
        offset: f64,
        /// Its amplitude.
        amplitude: f64,
        /// Frequency at the start, in Hz.
        from: f64,
        /// Frequency at the end, in Hz.
        to: f64,
        /// In s.
        duration: f64,
    },
}

/// Values at time points.
#[derive(Clone, Debug, PartialEq)]
pub struct Knots {
    times: Vec<f64>,
    values: Vec<f64>,
}

/// One term of a multisine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SineTerm {
    /// Amplitude.
    pub amplitude: f64,
    /// In Hz.
    pub frequency: f64,
    /// In rad.
    pub phase: f64,
}

impl SineTerm {
    #[inline]
    fn value(&self, t: f64) -> f64 {
        self.amplitude * (TAU * self.frequency * t + self.phase).sin()
    }
}

/// Reason why values at time points make no signal.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum KnotsError {
    /// No values, or another number of values than of time points.
    #[error("{values} values at {times} instants, expected one at each, and at least one")]
    Count {
        /// Number of values.
        values: usize,
        /// Number of time points.
        times: usize,
    },
    /// A value or a time point that is not finite.
    #[error("{0}, expected a finite number")]
    NotFinite(f64),
    /// A time point that is not after the one before it.
    #[error("the instant {next} after {before}, expected them to ascend")]
    NotAscending {
        /// The time point before, in s.
        before: f64,
        /// The time point, in s.
        next: f64,
    },
}

impl Knots {
    /// Values at ascending time points, in s.
    ///
    /// # Errors
    /// [`KnotsError`]: there is no value, the numbers of values and time points differ, one is not finite, or the time
    /// points do not ascend.
    pub fn new(times: Vec<f64>, values: Vec<f64>) -> Result<Self, KnotsError> {
        if times.is_empty() || times.len() != values.len() {
            return Err(KnotsError::Count { values: values.len(), times: times.len() });
        }
        if let Some(value) = times.iter().chain(&values).find(|value| !value.is_finite()) {
            return Err(KnotsError::NotFinite(*value));
        }
        match times.windows(2).find(|pair| pair[0] >= pair[1]) {
            Some(pair) => Err(KnotsError::NotAscending { before: pair[0], next: pair[1] }),
            None => Ok(Self { times, values }),
        }
    }

    /// Number of knots that are not after a time.
    fn passed(&self, t: f64) -> usize {
        self.times.partition_point(|&time| time <= t)
    }

    fn held(&self, t: f64) -> f64 {
        self.values[self.passed(t).saturating_sub(1)]
    }

    fn linear(&self, t: f64) -> f64 {
        let next = self.passed(t);
        if next == 0 || next == self.times.len() {
            return self.held(t);
        }
        let (begin, end) = (self.times[next - 1], self.times[next]);
        let weight = (t - begin) / (end - begin);
        (1.0 - weight) * self.values[next - 1] + weight * self.values[next]
    }
}

impl Signal {
    /// Returns true if it has time points at which it is not smooth.
    pub fn has_knots(&self) -> bool {
        matches!(self, Self::Held(_) | Self::Linear(_))
    }

    /// Its value at a time in s.
    pub fn value(&self, t: f64) -> f64 {
        match self {
            Self::Constant(value) => *value,
            Self::Held(knots) => knots.held(t),
            Self::Linear(knots) => knots.linear(t),
            Self::Multisine { offset, sines } => offset + sines.iter().map(|sine| sine.value(t)).sum::<f64>(),
            Self::Chirp { offset, amplitude, from, to, duration } => {
                let (t_in, t_after) = (t.min(*duration), (t - duration).max(0.0));
                // the integral of the frequency
                let turns = from * t_in + 0.5 * (to - from) / duration * t_in * t_in + to * t_after;
                offset + amplitude * (TAU * turns).sin()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_and_linear_signals_pass_through_their_knots() {
        let knots = Knots::new(vec![0.0, 1.0, 3.0], vec![2.0, 4.0, -2.0]).unwrap();
        for (t, held, linear) in [
            (-1.0, 2.0, 2.0),
            (0.0, 2.0, 2.0),
            (0.5, 2.0, 3.0),
            (1.0, 4.0, 4.0),
            (2.0, 4.0, 1.0),
            (3.0, -2.0, -2.0),
            (9.0, -2.0, -2.0),
        ] {
            assert_eq!(Signal::Held(knots.clone()).value(t), held, "held at {t}");
            assert_eq!(Signal::Linear(knots.clone()).value(t), linear, "linear at {t}");
        }
    }

    #[test]
    fn knots_that_make_no_signal_are_refused() {
        for (times, values, expected) in [
            (vec![], vec![], "0 values at 0 instants, expected one at each, and at least one"),
            (vec![0.0], vec![1.0, 2.0], "2 values at 1 instants, expected one at each, and at least one"),
            (vec![0.0, 0.0], vec![1.0, 2.0], "the instant 0 after 0, expected them to ascend"),
            (vec![0.0, 1.0], vec![1.0, f64::NAN], "NaN, expected a finite number"),
        ] {
            assert_eq!(Knots::new(times, values).unwrap_err().to_string(), expected);
        }
    }

    #[test]
    fn the_frequency_of_a_chirp_grows_and_then_stays() {
        let chirp = Signal::Chirp { offset: 1.0, amplitude: 2.0, from: 0.5, to: 3.0, duration: 4.0 };
        // the phase turns as often as the mean of both frequencies says: 7 turns in 4 s, 3 more in the next second
        for t in [0.0, 4.0, 5.0] {
            assert!((chirp.value(t) - 1.0).abs() < 1e-12, "{t}");
        }
        let step = 1e-6;
        for (t, frequency) in [(0.0, 0.5), (4.0, 3.0), (7.0, 3.0)] {
            let slope = (chirp.value(t + step) - chirp.value(t - step)) / (2.0 * step);
            assert!((slope / (2.0 * TAU) - frequency).abs() < 1e-5, "{t}: {slope}");
        }
    }

    #[test]
    fn a_multisine_is_the_sum_of_its_terms() {
        let sine = |amplitude, frequency, phase| SineTerm { amplitude, frequency, phase };
        let signal = Signal::Multisine { offset: 0.5, sines: vec![sine(1.0, 2.0, 0.3), sine(0.2, 5.0, -1.0)] };
        let t = 0.37;
        let expected = 0.5 + (2.0 * TAU * t + 0.3).sin() + 0.2 * (5.0 * TAU * t - 1.0).sin();
        assert!((signal.value(t) - expected).abs() < 1e-15);
    }
}
