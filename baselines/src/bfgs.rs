//! Least value of a smooth function of a few numbers within bounds: a projected quasi-Newton method with the update of Broyden, Fletcher,
//! Goldfarb and Shanno (Nocedal, Wright (2006), chapter 6). A function may be undefined in places, which the optimizers of argmin do not
//! expect, and which have no bounds.

use nalgebra::{DMatrix, DVector};

/// A point and its value.
pub struct Best {
    /// Numbers within the bounds.
    pub point: Vec<f64>,
    /// Value of the function at the point.
    pub value: f64,
}

/// A decrease below which the search ends.
const DECREASE: f64 = 1e-6;
/// Largest change of a number in a step.
const LONGEST: f64 = 2.0;
/// Halvings of a step at most.
const HALVINGS: usize = 20;

/// Searches for the least value from a start, in at most `steps` steps. The function returns its value and gradient, or None where it is undefined.
/// Returns None if it is undefined at the start.
pub fn least(
    start: Vec<f64>,
    bounds: &[[f64; 2]],
    steps: usize,
    function: impl Fn(&[f64]) -> Option<(f64, Vec<f64>)>,
) -> Option<Best> {
    let within =
        |point: DVector<f64>| DVector::from_fn(bounds.len(), |i, _| point[i].clamp(bounds[i][0], bounds[i][1]));
    let count = bounds.len();
    let mut point = within(DVector::from_vec(start));
    let (mut value, gradient) = function(point.as_slice())?;
    let mut gradient = DVector::from_vec(gradient);
    // of the inverse of the second derivatives; fresh if it is the identity
    let (mut inverse, mut is_fresh) = (DMatrix::identity(count, count), true);
    let mut step = 0;
    while step < steps {
        step += 1;
        // 0 for numbers that stay at a bound, else 1
        let free = DVector::from_fn(count, |i, _| {
            let stays = point[i] <= bounds[i][0] && gradient[i] > 0.0 || point[i] >= bounds[i][1] && gradient[i] < 0.0;
            if stays { 0.0 } else { 1.0 }
        });
        let slope = gradient.component_mul(&free);
        let mut direction = -(&inverse * &slope).component_mul(&free);
        if direction.dot(&slope) >= 0.0 {
            direction = -slope.clone();
        }
        let length = direction.amax();
        if length == 0.0 {
            break;
        }
        let mut share = (LONGEST / length).min(1.0);
        let better = (0..HALVINGS).find_map(|_| {
            let candidate = within(&point + &direction * share);
            share *= 0.5;
            let expected = slope.dot(&(&candidate - &point));
            let (found, gradient) = function(candidate.as_slice())?;
            (found <= value + 1e-4 * expected).then(|| (candidate, found, DVector::from_vec(gradient)))
        });
        let Some((next, found, slopes)) = better else {
            if is_fresh {
                break;
            }
            (inverse, is_fresh) = (DMatrix::identity(count, count), true);
            continue;
        };
        let (moved, changed, decrease) = (&next - &point, &slopes - &gradient, value - found);
        (point, value, gradient) = (next, found, slopes);
        if decrease < DECREASE {
            break;
        }
        let curvature = moved.dot(&changed);
        if curvature > 1e-10 * moved.norm() * changed.norm() {
            if is_fresh {
                inverse *= curvature / changed.norm_squared();
            }
            let product = &inverse * &changed;
            let factor = (1.0 + changed.dot(&product) / curvature) / curvature;
            inverse += &moved * moved.transpose() * factor
                - (&product * moved.transpose() + &moved * product.transpose()) / curvature;
            is_fresh = false;
        }
    }
    Some(Best { point: point.as_slice().to_vec(), value })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rosenbrock(x: &[f64]) -> Option<(f64, Vec<f64>)> {
        let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
        Some((a * a + 100.0 * b * b, vec![-2.0 * a - 400.0 * x[0] * b, 200.0 * b]))
    }

    #[test]
    fn the_least_value_of_a_curved_valley_is_found_inside_and_at_bounds() {
        let best = least(vec![-1.2, 1.0], &[[-5.0, 5.0]; 2], 200, rosenbrock).unwrap();
        assert!((best.point[0] - 1.0).abs() < 1e-2 && best.value < 1e-5, "{:?}", best.point);
        // at x = 0.5 the best y is 0.25
        let best = least(vec![-1.2, 1.0], &[[-5.0, 0.5], [-5.0, 5.0]], 200, rosenbrock).unwrap();
        assert!((best.point[0] - 0.5).abs() < 1e-9 && (best.point[1] - 0.25).abs() < 1e-3, "{:?}", best.point);
    }

    #[test]
    fn places_where_the_function_is_undefined_are_avoided() {
        let function = |x: &[f64]| (x[0] > 0.0).then(|| (x[0] - x[0].ln(), vec![1.0 - 1.0 / x[0]]));
        let best = least(vec![6.0], &[[-10.0, 10.0]], 100, function).unwrap();
        assert!((best.point[0] - 1.0).abs() < 1e-2, "{:?}", best.point);
        assert!(least(vec![-1.0], &[[-10.0, 10.0]], 100, function).is_none());
    }
}
