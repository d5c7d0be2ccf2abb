//! How the learning rate changes over a training.

use crate::study::Schedule;

/// Share of the training in which the learning rate rises linearly from nearly zero.
const WARM_UP: f64 = 0.03;

/// Learning rate of the last step of a cosine schedule, relative to the highest: small enough to settle, not wasted.
const FLOOR: f64 = 1e-4;

/// Learning rate of step number `step` out of `steps`, counted from 0, relative to the highest.
///
/// Cosine: `min(1, (k + 1) / w) * (floor + (1 - floor) (1 + cos(π max(0, k - w) / (n - w))) / 2)`, with `k` the step,
/// `n` the steps and `w` the steps of the warm-up.
pub(super) fn relative_rate(schedule: Schedule, step: u64, steps: u64) -> f64 {
    match schedule {
        Schedule::Constant => 1.0,
        Schedule::Cosine => {
            let (step, steps) = (step as f64, steps as f64);
            let warm_up = (WARM_UP * steps).max(1.0);
            let rise = ((step + 1.0) / warm_up).min(1.0);
            let fraction = ((step - warm_up) / (steps - warm_up).max(1.0)).clamp(0.0, 1.0);
            rise * (FLOOR + (1.0 - FLOOR) * 0.5 * (1.0 + (std::f64::consts::PI * fraction).cos()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_constant_schedule_is_constant() {
        assert!([0, 7, 99].iter().all(|&step| relative_rate(Schedule::Constant, step, 100) == 1.0));
    }

    #[test]
    fn the_cosine_schedule_warms_up_then_falls_to_its_floor() {
        let rates: Vec<f64> = (0..1000).map(|step| relative_rate(Schedule::Cosine, step, 1000)).collect();
        assert!((rates[0] - 1.0 / 30.0).abs() < 1e-12);
        assert!(rates[..30].is_sorted());
        assert_eq!(rates[30], 1.0);
        assert!(rates[30..].is_sorted_by(|a, b| a > b));
        assert!((rates[515] - 0.5).abs() < 1e-3, "half-way after the warm-up: {}", rates[515]);
        assert!(rates[999] < 1.1e-4 && rates[999] > 1e-4, "{}", rates[999]);
    }

    #[test]
    fn a_single_step_has_a_positive_rate() {
        assert_eq!(relative_rate(Schedule::Cosine, 0, 1), 1.0);
    }
}
