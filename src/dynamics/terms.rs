//! Which products a dictionary has.

use metafmu_runtime::dictionary::Factor;
use nalgebra::DMatrix;

/// The exponents of all products whose harmonics have at most the first order in sum, and whose powers at most the second.
pub(super) fn exponents(factors: &[Factor], [harmonics, powers]: [usize; 2]) -> Vec<Vec<i16>> {
    let mut all = vec![(Vec::new(), harmonics, powers)];
    for factor in factors {
        let mut next = Vec::new();
        for (exponents, harmonics, powers) in all {
            let mut add = |exponent: i16, harmonics: usize, powers: usize| {
                let mut exponents: Vec<i16> = exponents.clone();
                exponents.push(exponent);
                next.push((exponents, harmonics, powers));
            };
            add(0, harmonics, powers);
            match factor {
                Factor::Angle => {
                    for order in 1..=harmonics {
                        add(order as i16, harmonics - order, powers);
                        add(-(order as i16), harmonics - order, powers);
                    }
                }
                Factor::Power { .. } => (1..=powers).for_each(|order| add(order as i16, harmonics, powers - order)),
            }
        }
        all = next;
    }
    all.into_iter().map(|(exponents, ..)| exponents).collect()
}

/// The products at some points, shape `[points, products]`.
pub(super) fn values(factors: &[Factor], exponents: &[Vec<i16>], points: &[Vec<f64>]) -> DMatrix<f64> {
    let value = |factor: &Factor, exponent: i16, x: f64| match (factor, exponent) {
        (_, 0) => 1.0,
        (Factor::Angle, 1..) => (f64::from(exponent) * x).cos(),
        (Factor::Angle, _) => (f64::from(-exponent) * x).sin(),
        (Factor::Power { middle, half }, _) => ((x - middle) / half).powi(exponent.into()),
    };
    DMatrix::from_fn(points.len(), exponents.len(), |point, product| {
        let columns = factors.iter().zip(&exponents[product]).zip(&points[point]);
        columns.map(|((factor, exponent), x)| value(factor, *exponent, *x)).product()
    })
}
