//! How the learning rate changes over a training.

use crate::study::{Schedule, TrainingOptions};
use std::f64::consts::PI;

/// Learning rate of the last step of a falling schedule, relative to the highest: small enough to settle, not wasted.
const FLOOR: f64 = 1e-4;

/// Learning rate of a one-cycle schedule's first step, relative to the highest.
const CYCLE_START: f64 = 1.0 / 25.0;

/// Cycles of a schedule with restarts, each twice as long as the one before.
const CYCLES: u32 = 5;

/// The epoch with which each cycle of a schedule with restarts ends, the last with all: `epochs (2^i - 1) / (2^5 - 1)`, rounded.
pub(super) fn cycle_ends(epochs: usize) -> Vec<usize> {
    let all = f64::from(2u32.pow(CYCLES) - 1);
    let share = |cycle: u32| f64::from(2u32.pow(cycle) - 1) / all;
    let mut ends: Vec<usize> =
        (1..=CYCLES).map(|cycle| ((epochs as f64 * share(cycle)).round() as usize).max(1)).collect();
    ends.dedup();
    ends
}

/// Learning rate of step number `step` out of `steps`, counted from 0, relative to the highest.
///
/// With `w` the steps of the warm-up (at least one, the first), `rise = min(1, (step + 1) / w)`,
/// `x = max(0, step - w) / (steps - w)` and `fall = floor + (1 - floor) (1 + cos(π x)) / 2`:
///
/// ```text
/// constant    rise
/// step        rise * 0.1^(floor(3 step / steps))
/// cosine      rise * fall
/// restarts    the same in each cycle, of which `step` and `steps` then are
/// one-cycle   start + (1 - start) (1 - cos(π rise)) / 2 in the warm-up, then fall
/// ```
pub(super) fn relative_rate(options: &TrainingOptions, step: u64, steps: u64) -> f64 {
    let (step, steps) = match options.schedule {
        Schedule::Restarts => within_cycle(options.epochs, step, steps),
        _ => (step, steps),
    };
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

/// A step's number within its cycle, and the cycle's steps.
fn within_cycle(epochs: usize, step: u64, steps: u64) -> (u64, u64) {
    let (of_epoch, mut begin) = (steps / epochs as u64, 0);
    for end in cycle_ends(epochs).into_iter().map(|end| end as u64 * of_epoch) {
        if step < end {
            return (step - begin, end - begin);
        }
        begin = end;
    }
    (step, steps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_double_and_the_last_ends_with_all_epochs() {
        assert_eq!(cycle_ends(31), [1, 3, 7, 15, 31]);
        assert_eq!(cycle_ends(150), [5, 15, 34, 73, 150]);
        assert_eq!(cycle_ends(1), [1]);
        for epochs in 1..200 {
            let ends = cycle_ends(epochs);
            assert!(ends.is_sorted_by(|a, b| a < b) && ends.last() == Some(&epochs), "{epochs}: {ends:?}");
        }
        let options = TrainingOptions { schedule: Schedule::Restarts, epochs: 31, ..TrainingOptions::default() };
        let rates: Vec<f64> = (0..3100).map(|step| relative_rate(&options, step, 3100)).collect();
        for (begin, end) in [(0, 100), (100, 300), (300, 700), (700, 1500), (1500, 3100)] {
            let warm_up = (end - begin) * 3 / 100;
            assert_eq!(rates[begin + warm_up], 1.0, "{begin}");
            assert!(rates[begin + warm_up..end].is_sorted_by(|a, b| a > b) && rates[end - 1] < 2e-3, "{begin}");
        }
    }

    fn rates(schedule: Schedule, warm_up: Option<f64>, steps: u64) -> Vec<f64> {
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
