//! Functions without a known structure, by least squares: derivatives of states and outputs as sums of sines, cosines and powers.

use super::{
    EXACT, EquationSamples, FIRST_ORDER, MOST_TERMS, WORTH_IT,
    least_squares::{self, DictionaryError},
    rows, terms,
};
use metafmu_runtime::dictionary::{Dictionary, Factor};

/// Functions that were found, and how well.
#[derive(Clone, Debug)]
pub struct FittedFunctions {
    /// The functions.
    pub dictionary: Dictionary,
    /// Highest harmonic of the angles, and highest power of the others.
    pub order: [usize; 2],
    /// Largest error of any function at unseen points, relative to its largest value.
    pub error: f64,
}

/// Orders that are tried without a gain before the search ends: even functions gain by every second one only, and a product of several
/// columns by none below its own.
const PATIENCE: usize = 3;

/// Finds functions of the `used` columns from samples; the order is raised as long as unseen points gain, unless it is the `lowest` that is
/// wanted.
///
/// # Errors
/// [`DictionaryError`]: there are more columns than a dictionary of the lowest order can have, or too few samples for it.
pub fn fit_functions(
    (factors, used): (&[Factor], &[bool]),
    samples: &EquationSamples,
    unseen: &EquationSamples,
    lowest: bool,
) -> Result<FittedFunctions, DictionaryError> {
    let functions = samples.labels.width();
    let scales = (0..functions).map(|function| {
        let largest = samples.labels.largest_magnitude(function).max(unseen.labels.largest_magnitude(function));
        if largest > 0.0 { largest } else { 1.0 }
    });
    let scales: Vec<f64> = scales.collect();
    let has_angles = factors.iter().zip(used).any(|(factor, used)| *used && *factor == Factor::Angle);
    let try_order = |order: [usize; 2]| -> Option<Result<FittedFunctions, DictionaryError>> {
        let mut exponents = terms::exponents(factors, order);
        exponents.retain(|exponents| terms::uses_only(exponents, used));
        let needed = rows(&exponents);
        if exponents.len() > MOST_TERMS || needed > samples.points.len() {
            return None;
        }
        let found = least_squares::solve(factors.into(), &exponents, samples, unseen, &scales);
        Some(found.and_then(|(coefficients, error)| {
            let dictionary = least_squares::dictionary(factors.into(), &exponents, &coefficients, 0..functions)?;
            Ok(FittedFunctions { dictionary, order, error })
        }))
    };
    let [harmonics, powers] = FIRST_ORDER;
    let first = try_order([if has_angles { harmonics } else { 0 }, powers]);
    let mut best = first.unwrap_or(Err(DictionaryError::TooFewSamples))?;
    let (mut order, mut without_gain) = (best.order, 0);
    while !lowest && best.error > EXACT && without_gain < PATIENCE {
        let [harmonics, powers] = order;
        let higher = if has_angles {
            vec![[harmonics, powers + 1], [2 * harmonics, powers], [2 * harmonics, powers + 1]]
        } else {
            vec![[harmonics, powers + 1]]
        };
        let tried: Vec<FittedFunctions> = higher.into_iter().filter_map(try_order).filter_map(Result::ok).collect();
        let Some(next) = tried.into_iter().min_by(|a, b| a.error.total_cmp(&b.error)) else { break };
        order = next.order;
        if next.error < WORTH_IT * best.error {
            (best, without_gain) = (next, 0);
        } else {
            without_gain += 1;
        }
    }
    Ok(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::Rows;
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    fn samples(count: usize, seed: u64, of: impl Fn(&[f64]) -> Vec<f64>) -> EquationSamples {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let points: Rows = (0..count).map(|_| [(); 3].map(|()| 4.0 * generator.random::<f64>() - 2.0)).collect();
        let labels = points.iter().map(of).collect();
        EquationSamples { points, labels }
    }

    #[test]
    fn a_polynomial_is_found_exactly_and_an_angle_as_well() {
        let power = Factor::Power { middle: 0.0, half: 2.0 };
        // Van der Pol's oscillator, and a pendulum with a torque
        let van_der_pol = |p: &[f64]| vec![p[0] * (1.0 - p[1] * p[1]) * p[2] - p[1]];
        let pendulum = |p: &[f64]| vec![p[0] - 9.81 * p[1].sin() - 0.1 * p[2]];
        for (factors, of) in
            [([power; 3], &van_der_pol as &dyn Fn(&[f64]) -> Vec<f64>), ([power, Factor::Angle, power], &pendulum)]
        {
            let found =
                fit_functions((&factors, &[true; 3]), &samples(2000, 1, of), &samples(200, 2, of), false).unwrap();
            assert!(found.error < 1e-12 && found.dictionary.products() <= 4, "{found:?}");
        }
    }

    #[test]
    fn what_is_no_such_sum_is_approximated_and_the_error_says_how_well() {
        let friction = |p: &[f64]| vec![(5.0 * p[0]).tanh() - p[1]];
        let factors = [Factor::Power { middle: 0.0, half: 2.0 }; 3];
        let found =
            fit_functions((&factors, &[true; 3]), &samples(5000, 1, friction), &samples(500, 2, friction), false)
                .unwrap();
        assert!((1e-3..0.5).contains(&found.error), "{}", found.error);
        let few = samples(20, 1, friction);
        assert!(fit_functions((&factors, &[true; 3]), &few, &few, false).is_err());
    }
}
