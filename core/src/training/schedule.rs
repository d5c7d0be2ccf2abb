//! How the learning rate changes over a training, and when one with restarts has gained enough.

use super::StopReason;
use crate::study::{Schedule, TrainingOptions};
use std::{f64::consts::PI, ops::Range};

/// Learning rate of the last step of a falling schedule, relative to the highest: small enough to settle, not wasted.
const FLOOR: f64 = 1e-4;

/// Learning rate of a one-cycle schedule's first step, relative to the highest.
const CYCLE_START: f64 = 1.0 / 25.0;

/// `training.enough` unless given.
const ENOUGH: f64 = 1e-7;

/// The first cycle of a schedule with restarts, as a share of all epochs: long enough to tell something, short enough to cost
/// little.
const FIRST_CYCLE: f64 = 1.0 / 30.0;

/// A cycle has gained something if the validation loss fell at least as this power of the cycles' epochs: by a quarter, if it is twice
/// as long as the one before.
const GAIN: f64 = 0.4;

/// A cycle may be much longer than the one before if the loss fell at least as this power.
const STEADY: f64 = 0.75;

/// Optimizer steps that a cycle has at least if it is to show that nothing is gained: fewer, of few rows, hardly move the parameters.
const TELLING_STEPS: usize = 100;

/// How much longer a cycle is than the validation loss suggests, which falls a little slower than in inverse proportion to the epochs.
const SAFETY: f64 = 1.25;

/// The epochs, counted from 0, of the cycle that a training is in, or why it ends here; `losses` are the validation losses of its
/// epochs so far, `steps` the optimizer steps of an epoch.
///
/// Only a schedule with restarts has more than one cycle. Each is twice as long as the one before, or, where the loss
/// falls steadily, as long as it takes to reach [`TrainingOptions::enough`] in inverse proportion to the epochs of a
/// cycle. The last is one that gained nothing, unless it is the second or has too few steps to judge.
pub(super) fn cycle(options: &TrainingOptions, losses: &[f64], steps: usize) -> Result<Range<usize>, StopReason> {
    let epochs = options.epochs;
    if losses.len() >= epochs {
        return Err(StopReason::Finished);
    }
    if options.schedule != Schedule::Restarts {
        return Ok(0..epochs);
    }
    let enough = options.enough.unwrap_or(ENOUGH);
    let mut cycle = 0..((FIRST_CYCLE * epochs as f64).round() as usize).max(1);
    // of the cycle before: its length and its loss
    let mut before: Option<(f64, f64)> = None;
    let mut number = 1;
    while losses.len() >= cycle.end {
        let (length, loss) = (cycle.len() as f64, losses[cycle.end - 1]);
        let power = before.map(|(shorter, larger)| (larger / loss).ln() / (length / shorter).ln());
        if loss <= enough {
            return Err(StopReason::Enough);
        }
        let tells = number > 2 && cycle.len().saturating_mul(steps) >= TELLING_STEPS;
        if tells && power.is_none_or(|power| power < GAIN) {
            return Err(StopReason::Patience);
        }
        // a shorter cycle than the last would gain nothing
        if epochs - cycle.end < cycle.len() {
            return Err(StopReason::TooFewLeft);
        }
        let needed = match power {
            Some(power) if power >= STEADY => SAFETY * length * loss / enough,
            _ => 0.0,
        };
        // an infinite number becomes the largest
        let next = (needed.ceil() as usize).max(2 * cycle.len());
        cycle = cycle.end..cycle.end.saturating_add(next).min(epochs);
        before = Some((length, loss));
        number += 1;
    }
    Ok(cycle)
}

/// Learning rate of step number `step`, counted from 0, out of the `steps` of its cycle, relative to the highest.
///
/// With `w` the steps of the warm-up (at least one, the first), `rise = min(1, (step + 1) / w)`,
/// `x = max(0, step - w) / (steps - w)` and `fall = floor + (1 - floor) (1 + cos(π x)) / 2`:
///
/// ```text
/// constant    rise
/// step        rise * 0.1^(floor(3 step / steps))
/// cosine      rise * fall, restarts too
/// one-cycle   start + (1 - start) (1 - cos(π rise)) / 2 in the warm-up, then fall
/// ```
pub(super) fn relative_rate(options: &TrainingOptions, step: usize, steps: usize) -> f64 {
    let (step, steps) = (step as f64, steps as f64);
    let share = options.warm_up.unwrap_or(match options.schedule {
        Schedule::Constant | Schedule::Step => 0.0,
        Schedule::Cosine | Schedule::Restarts => 0.03,
        Schedule::OneCycle => 0.3,
    });
    let warm_up = (share * steps).max(1.0);
    let rise = ((step + 1.0) / warm_up).min(1.0);
    let x = ((step - warm_up) / (steps - warm_up).max(1.0)).clamp(0.0, 1.0);
    let fall = FLOOR + (1.0 - FLOOR) * 0.5 * (1.0 + (PI * x).cos());
    match options.schedule {
        Schedule::Constant => rise,
        Schedule::Step => rise * 0.1f64.powf((3.0 * step / steps).floor()),
        Schedule::Cosine | Schedule::Restarts => rise * fall,
        Schedule::OneCycle if rise < 1.0 => CYCLE_START + (1.0 - CYCLE_START) * 0.5 * (1.0 - (PI * rise).cos()),
        Schedule::OneCycle => fall,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lengths of the cycles of a training whose cycles end with losses of `loss(cycle, length)`, and why it ends.
    fn cycles(epochs: usize, enough: f64, loss: impl Fn(usize, f64) -> f64) -> (Vec<usize>, StopReason) {
        let options = TrainingOptions {
            schedule: Schedule::Restarts,
            epochs,
            enough: Some(enough),
            ..TrainingOptions::default()
        };
        let (mut losses, mut lengths) = (Vec::new(), Vec::new());
        loop {
            let next = match cycle(&options, &losses, 1000) {
                Ok(next) => next,
                Err(reason) => return (lengths, reason),
            };
            assert_eq!(next.start, losses.len());
            for end in next.start + 1..next.end {
                // nothing is decided within a cycle
                losses.push(0.0);
                assert_eq!(cycle(&options, &losses, 1000), Ok(next.clone()), "{end}");
            }
            losses.push(loss(lengths.len(), next.len() as f64));
            lengths.push(next.len());
        }
    }

    #[test]
    fn the_last_cycle_is_as_long_as_it_takes() {
        let inverse = |_, length: f64| 1e-3 / length;
        assert_eq!(cycles(150, 1e-2, inverse), (vec![5], StopReason::Enough));
        assert_eq!(cycles(150, 1.5e-4, inverse), (vec![5, 10], StopReason::Enough));
        // 40 epochs would do
        assert_eq!(cycles(150, 2.5e-5, inverse), (vec![5, 10, 50], StopReason::Enough));
        assert_eq!(cycles(150, 1e-8, inverse), (vec![5, 10, 135], StopReason::Finished));
        // it falls much slower than it was thought to
        let slow = |cycle: usize, _| [1e-3, 5e-4, 1e-4, 6e-5, 5e-5][cycle];
        assert_eq!(cycles(1000, 4.5e-5, slow), (vec![33, 66, 901], StopReason::Finished));
        assert_eq!(cycles(1000, 3.5e-4, slow), (vec![33, 66, 132], StopReason::Enough));
        assert_eq!(cycles(1, 0.0, inverse), (vec![1], StopReason::Finished));
        assert_eq!(cycles(2, 0.0, inverse), (vec![1, 1], StopReason::Finished));
        for epochs in 1..200 {
            let (lengths, _) = cycles(epochs, 0.0, inverse);
            let left = epochs - lengths.iter().sum::<usize>();
            assert!(left < *lengths.last().unwrap(), "{epochs}: {lengths:?}");
        }
    }

    #[test]
    fn a_training_that_gains_nothing_ends() {
        assert_eq!(cycles(150, 1e-7, |_, _| 1e-3), (vec![5, 10, 20], StopReason::Patience));
        // the second cycle alone is not enough to tell
        let late = |cycle: usize, _| [1e-3, 1e-3, 1e-5, 1e-7][cycle];
        assert_eq!(cycles(3000, 1e-7, late), (vec![100, 200, 400, 2300], StopReason::Finished));
        // so slowly that how long it takes is unknown
        let slowly = |cycle: usize, _| [1e-3, 7e-4, 5e-4, 4.5e-4][cycle];
        assert_eq!(cycles(3000, 1e-7, slowly), (vec![100, 200, 400, 800], StopReason::Patience));
        // what is left is shorter than the last cycle
        let short = |cycle: usize, _| [1e-3, 1e-4, 2e-5][cycle];
        assert_eq!(cycles(150, 1.5e-5, short), (vec![5, 10, 84], StopReason::TooFewLeft));
    }

    #[test]
    fn a_cycle_of_few_steps_does_not_end_a_training() {
        let options = TrainingOptions { schedule: Schedule::Restarts, epochs: 300, ..TrainingOptions::default() };
        // nothing gained in cycles of 10, 20 and 40 epochs
        let losses = vec![1e-3; 70];
        assert_eq!(cycle(&options, &losses, 1), Ok(70..150));
        assert_eq!(cycle(&options, &[1e-3; 150], 1), Ok(150..300));
        assert_eq!(cycle(&options, &losses, 3), Err(StopReason::Patience));
    }

    fn rates(schedule: Schedule, warm_up: Option<f64>, steps: usize) -> Vec<f64> {
        let options = TrainingOptions { schedule, warm_up, ..TrainingOptions::default() };
        (0..steps).map(|step| relative_rate(&options, step, steps)).collect()
    }

    #[test]
    fn the_constant_schedule_is_constant_after_its_warm_up() {
        assert!(rates(Schedule::Constant, None, 100).iter().all(|&rate| rate == 1.0));
        let warmed = rates(Schedule::Constant, Some(0.1), 100);
        assert!((warmed[0] - 0.1).abs() < 1e-12 && warmed[..10].is_sorted_by(|a, b| a < b), "{warmed:?}");
        assert!(warmed[9..].iter().all(|&rate| rate == 1.0));
    }

    #[test]
    fn the_step_schedule_falls_to_a_tenth_after_each_third() {
        let rates = rates(Schedule::Step, None, 9);
        for (rate, expected) in rates.iter().zip([1.0, 1.0, 1.0, 0.1, 0.1, 0.1, 0.01, 0.01, 0.01]) {
            assert!((rate - expected).abs() < 1e-12, "{rates:?}");
        }
    }

    #[test]
    fn the_cosine_schedule_warms_up_then_falls_to_its_floor() {
        let rates = rates(Schedule::Cosine, None, 1000);
        assert!((rates[0] - 1.0 / 30.0).abs() < 1e-12);
        assert!(rates[..30].is_sorted());
        assert_eq!(rates[30], 1.0);
        assert!(rates[30..].is_sorted_by(|a, b| a > b));
        assert!((rates[515] - 0.5).abs() < 1e-3, "half-way after the warm-up: {}", rates[515]);
        assert!(rates[999] < 1.1e-4 && rates[999] > 1e-4, "{}", rates[999]);
    }

    #[test]
    fn one_cycle_rises_and_falls_along_cosines() {
        let rates = rates(Schedule::OneCycle, None, 1000);
        assert!((rates[0] - 0.04).abs() < 1e-4, "{}", rates[0]);
        assert!((rates[149] - 0.52).abs() < 1e-3, "half-way up: {}", rates[149]);
        assert!(rates[..300].is_sorted_by(|a, b| a < b));
        assert_eq!(rates[300], 1.0);
        assert!(rates[300..].is_sorted_by(|a, b| a > b));
        assert!(rates[999] < 2e-4, "{}", rates[999]);
    }

    #[test]
    fn a_single_step_has_a_positive_rate() {
        for schedule in [Schedule::Constant, Schedule::Step, Schedule::Cosine, Schedule::OneCycle] {
            assert_eq!(rates(schedule, None, 1), [1.0], "{schedule:?}");
        }
    }
}
