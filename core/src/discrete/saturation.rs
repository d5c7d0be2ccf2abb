//! Saturation of outputs, which stay at an end of their range: of a sensor, or of a state that stops there.

use super::simulate::{Limits, Signals, StateShape};
use std::fmt;

/// Rows in a stretch at an end, and in all of them: number, and share of all rows.
const STRETCH: usize = 3;
const ROWS: usize = 10;
const SHARE: f64 = 0.005;
/// Rows at an end over those with the value next to it: fewer of a signal with few values.
const OFTEN: usize = 5;

/// Saturation of outputs, with the ends of their ranges; infinite ones if they do not saturate.
#[derive(Clone, Debug, PartialEq)]
pub enum Saturation {
    /// No saturation.
    None,
    /// Saturated sensor: the output may leave the measured range.
    Sensor(Vec<[f64; 2]>),
    /// Output that stops at the ends, as a motion at an end stop.
    Stop(Vec<[f64; 2]>),
}

impl Saturation {
    /// Saturations to compare: none, and the others if an output stays at an end of its range.
    pub fn all(runs: &[Signals], outputs: usize) -> Vec<Self> {
        let ends: Vec<[f64; 2]> = (0..outputs).map(|output| ends(runs, outputs, output)).collect();
        if ends.iter().all(|range| *range == Limits::NONE) {
            return vec![Self::None];
        }
        vec![Self::None, Self::Sensor(ends.clone()), Self::Stop(ends)]
    }

    /// Ranges of a state space of this shape.
    pub fn limits(&self, shape: &StateShape) -> Limits {
        let mut limits =
            Limits { states: vec![Limits::NONE; shape.states], measured: vec![Limits::NONE; shape.outputs] };
        match self {
            Self::None => {}
            Self::Sensor(ends) => limits.measured.copy_from_slice(ends),
            Self::Stop(ends) => limits.states[..shape.outputs].copy_from_slice(ends),
        }
        limits
    }
}

impl fmt::Display for Saturation {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::None => "",
            Self::Sensor(_) => ", saturated sensor",
            Self::Stop(_) => ", output stopped at its limit",
        })
    }
}

/// Ends of the range of an output at which it saturates.
fn ends(runs: &[Signals], outputs: usize, output: usize) -> [f64; 2] {
    let values = |run: &Signals| run.outputs.iter().skip(output).step_by(outputs).copied().collect::<Vec<f64>>();
    let runs: Vec<Vec<f64>> = runs.iter().map(values).collect();
    let high = end(&runs);
    let negative: Vec<Vec<f64>> = runs.into_iter().map(|run| run.into_iter().map(|value| -value).collect()).collect();
    [end(&negative).map_or(f64::NEG_INFINITY, |value| -value), high.unwrap_or(f64::INFINITY)]
}

/// Largest value, if it lasts in stretches of rows that do not begin a run.
fn end(runs: &[Vec<f64>]) -> Option<f64> {
    let largest = |below: f64| runs.iter().flatten().filter(|value| **value < below).copied().reduce(f64::max);
    let end = largest(f64::INFINITY)?;
    let next = largest(end)?;
    let rows: usize = runs.iter().map(Vec::len).sum();
    let beside = runs.iter().flatten().filter(|value| **value == next).count();
    let stretches = runs.iter().flat_map(|run| {
        let parts = run.chunk_by(|a, b| (*a == end) == (*b == end)).skip(1);
        parts.filter(|part| part[0] == end && part.len() >= STRETCH).map(<[f64]>::len)
    });
    let found: usize = stretches.sum();
    (found >= ROWS && found >= OFTEN * beside && found as f64 >= SHARE * rows as f64).then_some(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(limit: f64, step: f64) -> Vec<f64> {
        let value = |row: usize| ((0.05 * row as f64).sin() / step).round() * step;
        (0..1000).map(|row| if step > 0.0 { value(row) } else { (0.05 * row as f64).sin() }.min(limit)).collect()
    }

    #[test]
    fn a_signal_that_is_cut_off_saturates() {
        assert_eq!(end(&[sine(0.8, 0.0)]), Some(0.8));
        assert_eq!(end(&[sine(0.8, 0.001)]), Some(0.8));
        let run = Signals { outputs: sine(0.8, 0.0), inputs: vec![0.0; 1000], given: 1, runs: vec![0; 1000] };
        let Saturation::Stop(ends) = &Saturation::all(&[run], 1)[2] else { panic!() };
        assert_eq!(*ends, [[f64::NEG_INFINITY, 0.8]]);
    }

    #[test]
    fn rounded_signals_relays_and_rest_do_not_saturate() {
        assert_eq!(end(&[sine(2.0, 0.0)]), None);
        assert_eq!(end(&[sine(2.0, 0.01)]), None);
        assert_eq!(end(&[sine(2.0, 0.25)]), None);
        let relay = (0..1000).map(|row| f64::from(u8::from(row / 20 % 2 == 0))).collect();
        assert_eq!(end(&[relay]), None);
        let rest = (0..1000).map(|row| (200.0 - row as f64).min(0.0)).collect();
        assert_eq!(end(&[rest]), None);
    }
}
