//! Slopes of a function by differences, at a smooth point and near a kink.

use crate::Result;
use std::iter::zip;

/// Steps of differences relative to the magnitude of a variable. If outputs have all digits of a double, the
/// shortest are exact to 1e-9; if they have fewer, for instance those of single precision, longer ones are better.
const STEPS: [f64; 8] = [1e-5, 4e-5, 1.6e-4, 6.4e-4, 2.56e-3, 1.024e-2, 4.096e-2, LONGEST];
/// The longest of these steps.
pub(super) const LONGEST: f64 = 1.6384e-1;
/// Step at which outputs of twelve digits are a straight line, so that deviations from it are rounding.
const STRAIGHT: f64 = 1e-6;
/// Ratio of the differences between the slopes above and below at one step and at the next longer one: 1/4 where a function is smooth, 1 at
/// a kink, 4 where rounding prevails.
const AT_A_KINK: [f64; 2] = [0.6, 1.5];
/// Number of ratios in succession that show a kink.
const RATIOS: usize = 2;
/// Differences between slopes above and below that are larger than this multiple of those that rounding makes are not rounding.
const BEYOND_ROUNDING: f64 = 4.0;
/// Share of a kink that the slopes at the shortest step have at most where the kink is farther away than that step.
const RESOLVED: f64 = 0.01;

/// A derivative by differences.
#[derive(Clone, Copy, Debug)]
pub(super) struct FiniteDifference {
    /// Slope.
    pub value: f64,
    /// Uncertainty of the slope.
    pub error: f64,
    /// Slope that the last digit of the output hides.
    pub unseen: f64,
}

/// Derivatives that differences allow: one where a function is smooth, three at a kink, where the slopes above and below and their mean
/// are derivatives.
#[derive(Clone, Debug)]
pub(super) struct Slopes(Vec<FiniteDifference>);

/// A function about a point.
struct Neighborhood {
    /// Magnitude of the variable.
    magnitude: f64,
    /// Values at `-3..=3` times [`STRAIGHT`].
    straight: [f64; 7],
    /// Slopes above and below at each of [`STEPS`].
    above: [f64; STEPS.len()],
    below: [f64; STEPS.len()],
}

impl Slopes {
    /// Evaluates a function about `center`, at distances relative to the `magnitude` of its variable.
    ///
    /// # Errors
    /// Those of the function.
    pub(super) fn of(center: f64, magnitude: f64, mut function: impl FnMut(f64) -> Result<f64>) -> Result<Self> {
        let mut straight = [0.0; 7];
        for (value, step) in zip(&mut straight, -3..) {
            *value = function(center + f64::from(step) * STRAIGHT * magnitude)?;
        }
        let [mut above, mut below] = [[0.0; STEPS.len()]; 2];
        for (index, step) in STEPS.iter().enumerate() {
            // distances as they are after rounding
            let (high, low) = (center + step * magnitude, center - step * magnitude);
            above[index] = (function(high)? - straight[3]) / (high - center);
            below[index] = (straight[3] - function(low)?) / (center - low);
        }
        let about = Neighborhood { magnitude, straight, above, below };
        Ok(Self(match about.kink() {
            Some(size) => about.near_kink(size),
            None => vec![about.smooth()],
        }))
    }

    /// The derivative that is nearest to a number.
    pub(super) fn nearest(&self, found: f64) -> FiniteDifference {
        let distances = self.0.iter().map(|slope| ((slope.value - found).abs(), slope));
        *distances.min_by(|(a, _), (b, _)| a.total_cmp(b)).expect("there is at least one").1
    }

    /// Largest magnitude of the derivatives.
    pub(super) fn largest(&self) -> f64 {
        self.0.iter().fold(0.0, |largest, slope| largest.max(slope.value.abs()))
    }

    /// Largest uncertainty of the derivatives.
    pub(super) fn error(&self) -> f64 {
        self.0.iter().fold(0.0, |largest, slope| largest.max(slope.error))
    }
}

/// Largest deviation of three values in succession from a straight line.
fn bend(values: &[f64]) -> f64 {
    values.windows(3).map(|of| (of[0] - 2.0 * of[1] + of[2]).abs()).fold(0.0, f64::max)
}

impl Neighborhood {
    /// Deviation of values at equal distances from a straight line.
    fn rounding(&self) -> f64 {
        bend(&self.straight)
    }

    /// Deviation on the straighter side: a kink bends the line, but not on both sides.
    fn rounding_of_sides(&self) -> f64 {
        bend(&self.straight[..4]).min(bend(&self.straight[3..])).max(self.last_digit())
    }

    fn last_digit(&self) -> f64 {
        f64::EPSILON * self.straight.iter().fold(0.0, |largest: f64, output| largest.max(output.abs()))
    }

    /// Difference between the slopes above and below a kink; none if the function is smooth, or rounding hides the kink. The slopes differ
    /// by the same at several steps in succession.
    fn kink(&self) -> Option<f64> {
        let rounding = self.rounding_of_sides();
        let jumps: Vec<f64> = zip(&self.above, &self.below).map(|(above, below)| (above - below).abs()).collect();
        let are = zip(jumps.windows(2), &STEPS).map(|(pair, step)| {
            let is_beyond = pair[0] * step * self.magnitude > BEYOND_ROUNDING * rounding;
            is_beyond && (AT_A_KINK[0]..AT_A_KINK[1]).contains(&(pair[0] / pair[1]))
        });
        let are: Vec<bool> = are.collect();
        let last = are.windows(RATIOS).position(|are| are.iter().all(|is| *is))? + RATIOS;
        Some(jumps[last])
    }

    /// Share of rounding in the derivative of one side by a step.
    fn noise(&self, step: f64) -> f64 {
        self.rounding_of_sides() / (step * self.magnitude)
    }

    /// Derivatives near a kink of this size. Where it is farther away than the shortest step that rounding leaves, that step shows the
    /// derivative. A side that is not straight has the kink in it.
    fn near_kink(&self, size: f64) -> Vec<FiniteDifference> {
        let straight = [2, 3].map(|from| (self.straight[from + 1] - self.straight[from]) / (STRAIGHT * self.magnitude));
        let shortest = (STRAIGHT, straight);
        let longer = zip(&STEPS, zip(&self.below, &self.above)).map(|(step, (below, above))| (*step, [*below, *above]));
        let steps: Vec<(f64, [f64; 2])> = std::iter::once(shortest).chain(longer).collect();
        let finest = steps.iter().position(|(step, _)| BEYOND_ROUNDING * self.noise(*step) <= RESOLVED * size);
        let finest = finest.unwrap_or(steps.len()).min(steps.len() - 2);
        let ((step, near), (_, farther)) = (steps[finest], steps[finest + 1]);
        let unseen = self.last_digit() / (step * self.magnitude);
        let slope = |value: f64, error: f64| FiniteDifference { value, error: error.max(self.noise(step)), unseen };
        let [below, above] = near;
        let mean = 0.5 * (below + above);
        let [of_below, of_above] = [0, 1].map(|side| (near[side] - farther[side]).abs());
        let is_resolved = (above - below).abs() <= RESOLVED * size;
        match [of_below, of_above].map(|change| change <= RESOLVED * size) {
            [true, false] if !is_resolved => vec![slope(below, of_below)],
            [false, true] if !is_resolved => vec![slope(above, of_above)],
            [true, true] if !is_resolved => {
                vec![slope(below, of_below), slope(mean, of_below.max(of_above)), slope(above, of_above)]
            }
            _ => vec![slope(mean, (above - below).abs())],
        }
    }

    /// Central difference with the smallest error estimate. The estimate is the difference from the slopes at the next
    /// shorter and the next longer step, where curvature shows. It is at least the rounding error of the outputs, because
    /// slopes might agree by chance.
    fn smooth(&self) -> FiniteDifference {
        let values: Vec<f64> = zip(&self.above, &self.below).map(|(above, below)| 0.5 * (above + below)).collect();
        let differences = zip(values.windows(3), &STEPS[1..]).map(|(of, step)| {
            let disagreement = (of[1] - of[0]).abs().max((of[2] - of[1]).abs());
            FiniteDifference {
                value: of[1],
                error: disagreement.max(self.rounding() / (step * self.magnitude)),
                unseen: self.last_digit() / (step * self.magnitude),
            }
        });
        differences.min_by(|a, b| a.error.total_cmp(&b.error)).expect("there are several steps")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tolerance of the check, relative to the largest derivative.
    const TOLERANCE: f64 = 1e-4;

    fn slopes(function: &dyn Fn(f64) -> f64) -> Slopes {
        Slopes::of(1.5, 2.0, |x| Ok(function(x))).unwrap()
    }

    /// Returns true if a claimed derivative passes.
    fn passes(slopes: &Slopes, found: f64) -> bool {
        let FiniteDifference { value, error, unseen } = slopes.nearest(found);
        (found - value).abs() <= TOLERANCE * slopes.largest() + 2.0 * error + unseen
    }

    /// A rope of stiffness 30 kN/m with a curved background of slope `slope`; it becomes taut at `1.5 + slack`.
    fn rope(slack: f64, slope: f64) -> impl Fn(f64) -> f64 {
        move |x| 3e4 * (x - 1.5 - slack).max(0.0) + slope * ((x - 1.5) + 0.4 * (x - 1.5).powi(2))
    }

    #[test]
    fn the_derivative_beside_a_kink_passes_and_others_do_not() {
        for distance in [3e-6, 1e-5, 2e-5, 3e-5, 7e-5, 1e-4, 2e-4, 3e-4, 5e-4, 1e-3, 3e-3, 1e-2, 0.1, 1.0] {
            for slope in [0.0, 50.0, 7e3] {
                for (slack, right, wrong) in [(distance, slope, slope + 3e4), (-distance, slope + 3e4, slope)] {
                    let slopes = slopes(&rope(slack, slope));
                    assert!(passes(&slopes, right), "{slack} {slope}: {slopes:?}");
                    for claimed in [wrong, 0.5 * (right + wrong), 1.01 * right + 3.0, 2.0 * right + 3.0, -right - 3.0] {
                        assert!(!passes(&slopes, claimed), "{claimed} at {slack} {slope}: {slopes:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn both_sides_and_their_mean_pass_at_a_kink_and_nothing_between() {
        for slope in [0.0, 50.0, -7e3] {
            let slopes = slopes(&rope(0.0, slope));
            for share in [0.0, 0.5, 1.0] {
                assert!(passes(&slopes, slope + share * 3e4), "{share} {slope}: {slopes:?}");
            }
            for share in [-0.02, 0.02, 0.25, 0.48, 0.75, 0.98, 1.02, 2.0] {
                assert!(!passes(&slopes, slope + share * 3e4), "{share} {slope}: {slopes:?}");
            }
        }
    }

    #[test]
    fn derivatives_of_smooth_functions_pass_and_wrong_factors_do_not() {
        let functions: [(&dyn Fn(f64) -> f64, f64); 6] = [
            (&|x: f64| x.sin(), 1.5f64.cos()),
            (&|x: f64| (40.0 * x).sin(), 40.0 * 60f64.cos()),
            (&|x: f64| (x - 1.5).powi(3) + 2.0 * x, 2.0),
            (&|x: f64| (x / 0.05).tanh(), (1.0 - 30f64.tanh().powi(2)) / 0.05),
            // a kink that is rounded within 0.001
            (&|x: f64| 0.5 * ((x - 1.5) + ((x - 1.5).powi(2) + 1e-6).sqrt()), 0.5),
            // outputs of single precision
            (&|x: f64| f64::from((3.0 * x.sin()) as f32), 3.0 * 1.5f64.cos()),
        ];
        for (index, (function, right)) in functions.into_iter().enumerate() {
            let slopes = slopes(function);
            assert!(passes(&slopes, right), "{index}: {slopes:?}");
            for factor in [-1.0, 0.0, 0.5, 0.99, 1.01, 2.0] {
                assert!(right.abs() < 1e-9 || !passes(&slopes, factor * right), "{factor} {index}: {slopes:?}");
            }
        }
    }

    #[test]
    fn kinks_of_outputs_in_single_precision_are_seen() {
        let rounded = |slack: f64| slopes(&move |x| f64::from(rope(slack, 50.0)(x) as f32));
        for (slack, right, wrong) in [(0.0, 3.005e4, 1e4), (0.0, 50.0, 2e4), (-2e-4, 3.005e4, 50.0)] {
            let slopes = rounded(slack);
            assert!(passes(&slopes, right) && !passes(&slopes, wrong), "{slack}: {slopes:?}");
        }
    }
}
