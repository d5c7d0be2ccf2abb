//! Loss functions of the outputs' errors, and their derivatives.

use crate::study::{Loss, TrainingOptions};

/// A loss: the mean over rows and outputs of `weight[output] * function(output - target)`.
#[derive(Clone, Debug)]
pub(super) struct LossFunction {
    loss: Loss,
    delta: f32,
    /// `[outputs]`
    weights: Vec<f32>,
}

impl LossFunction {
    /// # Panics
    /// If there are weights, but not one for each output.
    pub(super) fn new(options: &TrainingOptions, outputs: usize) -> Self {
        let mut weights: Vec<f32> = options.output_weights.iter().map(|&weight| weight as f32).collect();
        if weights.is_empty() {
            weights.resize(outputs, 1.0);
        }
        assert_eq!(weights.len(), outputs, "one weight for each output");
        Self { loss: options.loss, delta: options.huber_delta as f32, weights }
    }

    /// The loss of the known outputs alone.
    pub(super) fn of(&self, known: &[bool]) -> Self {
        let weights = self.weights.iter().zip(known).map(|(weight, known)| if *known { *weight } else { 0.0 });
        Self { weights: weights.collect(), ..self.clone() }
    }

    /// Weighted sum over one row; puts `scale` times its derivatives into `deltas`.
    pub(super) fn row(&self, outputs: &[f32], targets: &[f32], scale: f32, deltas: &mut [f32]) -> f64 {
        let mut sum = 0.0;
        for (((output, target), weight), delta) in outputs.iter().zip(targets).zip(&self.weights).zip(deltas) {
            let (value, slope) = self.function(output - target);
            *delta = scale * weight * slope;
            sum += f64::from(*weight) * value;
        }
        sum
    }

    /// Value, not rounded to single precision, and derivative.
    fn function(&self, error: f32) -> (f64, f32) {
        let (exact, delta) = (f64::from(error), f64::from(self.delta));
        match self.loss {
            Loss::Mse => (exact * exact, 2.0 * error),
            Loss::Mae if error == 0.0 => (0.0, 0.0),
            Loss::Mae => (exact.abs(), error.signum()),
            Loss::Huber if error.abs() <= self.delta => (0.5 * exact * exact, error),
            Loss::Huber => (delta * (exact.abs() - 0.5 * delta), self.delta * error.signum()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_and_their_derivatives_agree_with_their_definitions() {
        let options = |loss| TrainingOptions {
            loss,
            huber_delta: 0.5,
            output_weights: vec![1.0, 2.0, 0.0],
            ..TrainingOptions::default()
        };
        for (loss, sum, slopes) in [
            (Loss::Mse, 0.0625 + 2.0 * 2.25, [0.5, -6.0, 0.0]),
            (Loss::Mae, 0.25 + 2.0 * 1.5, [1.0, -2.0, 0.0]),
            (Loss::Huber, 0.03125 + 2.0 * 0.5 * 1.25, [0.25, -1.0, 0.0]),
        ] {
            let mut deltas = [9.0; 3];
            let found =
                LossFunction::new(&options(loss), 3).row(&[1.25, 1.0, 7.0], &[1.0, 2.5, 0.0], 10.0, &mut deltas);
            assert_eq!((found, deltas), (sum, slopes.map(|slope| 10.0 * slope)), "{loss:?}");
        }
    }

    #[test]
    fn an_error_of_zero_has_no_derivative() {
        for loss in [Loss::Mse, Loss::Mae, Loss::Huber] {
            let options = TrainingOptions { loss, ..TrainingOptions::default() };
            let mut deltas = [9.0];
            assert_eq!(LossFunction::new(&options, 1).row(&[1.5], &[1.5], 1.0, &mut deltas), 0.0);
            assert_eq!(deltas, [0.0], "{loss:?}");
        }
    }
}
