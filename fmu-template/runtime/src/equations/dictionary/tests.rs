use super::*;
use crate::formula::{Extrapolation, Interpolation};

fn term(exponents: &[i16], coefficients: &[f64]) -> Term {
    Term { exponents: exponents.to_vec(), coefficients: coefficients.to_vec() }
}

fn example() -> Dictionary {
    let factors = [Factor::Angle, Factor::Power { middle: 1.0, half: 2.0 }, Factor::Angle];
    let terms = [
        term(&[0, 0, 0], &[0.5, -1.0]),
        term(&[2, 1, 0], &[1.5, 0.0]),
        term(&[-3, 2, 1], &[-0.7, 0.2]),
        term(&[1, 3, -1], &[0.0, 2.0]),
    ];
    Dictionary::new(&factors, 2, &terms).unwrap()
}

fn formula([a, b, c]: [f64; 3]) -> [f64; 2] {
    let z = (b - 1.0) / 2.0;
    let (third, fourth) = ((3.0 * a).sin() * z * z * c.cos(), a.cos() * z.powi(3) * c.sin());
    [0.5 + 1.5 * (2.0 * a).cos() * z - 0.7 * third, -1.0 + 0.2 * third + 2.0 * fourth]
}

const POINT: [f64; 3] = [0.8, 2.3, -1.1];

/// A function of an angle, a length and a spline of the angle.
fn with_spline() -> (Dictionary, LookupTable) {
    let knots = vec![0.0, 0.7, 1.9, 3.0, 4.4, 5.1, std::f64::consts::TAU];
    let values = vec![0.0, 0.4, 1.3, 0.9, 1.8, 0.2, 0.0];
    let table = LookupTable::new(vec![knots], values, Interpolation::Cubic, Extrapolation::Periodic).unwrap();
    let splines = [SplineFactor { column: 0, table: Arc::new(table.clone()) }];
    let factors = [Factor::Angle, Factor::Power { middle: 1.0, half: 2.0 }];
    let terms = [
        term(&[0, 1, 1, 0, 0], &[0.7, 0.0]),
        term(&[-1, 0, 2, 1, 0], &[-0.4, 0.3]),
        term(&[0, 0, 0, 2, 0], &[1.1, 0.0]),
        term(&[0, 1, 0, 1, 1], &[0.0, 0.6]),
    ];
    (Dictionary::with_splines(&factors, &splines, 2, &terms).unwrap(), table)
}

#[test]
fn splines_and_their_derivatives_are_factors() {
    let (dictionary, table) = with_spline();
    assert_eq!((dictionary.columns(), dictionary.exponents()), (2, 5));
    assert!(dictionary.depends_on(0) && dictionary.depends_on(1));
    let mut builder = TapeBuilder::new(2, 0..0);
    let columns = [0, 1].map(Register::input);
    let written = dictionary.write(&columns, &mut builder);
    let value = written.value(0, &mut builder);
    let slopes = [0, 1].map(|column| written.slope(0, column, &mut builder));
    let other = written.value(1, &mut builder);
    let tape = builder.finish();
    let mut work = tape.work::<f64>();
    for a in [-4.2, 0.3, 2.0, 5.0, 9.7] {
        let x = [a, 1.6];
        let formula = |[a, b]: [f64; 2]| {
            let Jet { value: s, first, second } = table.series(&[Jet { value: a, first: 1.0, second: 0.0 }]);
            let z = (b - 1.0) / 2.0;
            let both = a.sin() * s * s * first;
            [0.7 * z * s - 0.4 * both + 1.1 * first * first, 0.3 * both + 0.6 * z * first * second]
        };
        let expected = formula(x);
        let (found, gradient) = dictionary.with_gradient(&x, 2);
        work.set_inputs(x.into_iter());
        tape.run(&mut work);
        for (found, expected) in
            found.iter().chain(&[work.get(value), work.get(other)]).zip(expected.iter().chain(&expected))
        {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        for (column, slope) in slopes.into_iter().enumerate() {
            let step = |by: f64| {
                let mut x = x;
                x[column] += by;
                formula(x)[0]
            };
            let expected = (step(1e-5) - step(-1e-5)) / 2e-5;
            assert!((work.get(slope) - expected).abs() < 1e-7, "{a}, {column}: {} {expected}", work.get(slope));
            assert!((gradient[column] - expected).abs() < 1e-7, "{a}, {column}");
        }
    }
}

#[test]
fn splines_without_a_column_or_derivatives_are_refused() {
    let (dictionary, table) = with_spline();
    let factors: Vec<Factor> = dictionary.factors().collect();
    let terms: Vec<Term> = dictionary.terms().collect();
    assert_eq!(Dictionary::with_splines(&factors, dictionary.splines(), 2, &terms).unwrap(), dictionary);
    let linear = LookupTable::new(
        table.axes().to_vec(),
        table.values().to_vec(),
        Interpolation::Linear,
        Extrapolation::Periodic,
    );
    for (column, table) in [(2, table), (0, linear.unwrap())] {
        let splines = [SplineFactor { column, table: Arc::new(table) }];
        assert!(Dictionary::with_splines(&factors, &splines, 2, &terms).is_err());
    }
    assert!(Dictionary::new(&factors, 2, &terms).is_err());
}

#[test]
fn values_are_those_of_the_formula() {
    let mut y = [0.0; 2];
    example().evaluate(&POINT, &mut y);
    for (found, expected) in y.iter().zip(formula(POINT)) {
        assert!((found - expected).abs() < 1e-15, "{found} {expected}");
    }
}

#[test]
fn on_a_tape_values_slopes_and_series_are_the_same() {
    let dictionary = example();
    for fixed in [0..0, 1..3, 0..1, 0..3] {
        let columns = [0, 1, 2].map(Register::input);
        let mut tape = TapeBuilder::new(3, fixed.clone());
        let written = dictionary.write(&columns, &mut tape);
        let values = [0, 1].map(|output| written.value(output, &mut tape));
        let slopes: Vec<Register> = (0..6).map(|index| written.slope(index / 3, index % 3, &mut tape)).collect();
        let tape = tape.finish();
        let (mut plain, mut series) = (tape.work(), tape.work());
        for shift in [0.0, 0.3, 0.3, -0.2] {
            // some columns keep their values while others change
            let point = [POINT[0] + shift, POINT[1] + 0.5 * shift, POINT[2] + (2.0 * shift).round()];
            let (expected, gradient) = dictionary.with_gradient(&point, 3);
            plain.inputs_mut()[..3].copy_from_slice(&point);
            tape.run(&mut plain);
            for (register, expected) in values.iter().chain(&slopes).zip(expected.iter().chain(&gradient)) {
                let found = plain.get(*register);
                assert!((found - expected).abs() < 1e-13, "{found} {expected}");
            }
            let direction = [0.3, -0.4, 1.2];
            for (k, column) in series.inputs_mut()[..3].iter_mut().enumerate() {
                *column = Jet { value: point[k], first: direction[k], second: 0.0 };
            }
            tape.run(&mut series);
            for (output, value) in values.iter().enumerate() {
                let along = |slope: &dyn Fn(usize) -> f64| (0..3).map(|k| slope(k) * direction[k]).sum::<f64>();
                let (found, expected) = (series.get(*value), along(&|k| gradient[3 * output + k]));
                assert!((found.first - expected).abs() < 1e-13, "{found:?} {expected}");
                let expected = along(&|k| series.get(slopes[3 * output + k]).first);
                assert!((found.second - expected).abs() < 1e-12, "{found:?} {expected}");
            }
        }
    }
}

#[test]
fn long_sums_are_the_same_on_a_tape() {
    // harmonics of an angle, some of them missing, and a coefficient that follows from a parameter
    let factors = [Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
    let terms: Vec<Term> = (-40..=40)
        .filter(|k| k % 7 != 3 && !(10..20).contains(k))
        .map(|k: i16| term(&[k, k.rem_euclid(3)], &[1.0 / (1.0 + f64::from(k).abs())]))
        .collect();
    let dictionary = Dictionary::new(&factors, 1, &terms).unwrap();
    let mut tape = TapeBuilder::new(2, 1..2);
    let written = dictionary.write(&[0, 1].map(Register::input), &mut tape);
    let registers = [written.value(0, &mut tape), written.slope(0, 0, &mut tape)];
    let tape = tape.finish();
    let mut work = tape.work();
    for point in [[0.4, 0.9], [2.9, 0.9], [-1.7, 0.6]] {
        work.inputs_mut()[..2].copy_from_slice(&point);
        tape.run(&mut work);
        let (y, gradient) = dictionary.with_gradient(&point, 1);
        for (register, expected) in registers.iter().zip([y[0], gradient[0]]) {
            assert!((work.get(*register) - expected).abs() < 1e-12, "{} {expected}", work.get(*register));
        }
    }
}

#[test]
fn gradients_are_those_of_finite_differences() {
    let (_, gradient) = example().with_gradient(&POINT, 3);
    let step = 1e-4;
    for column in 0..3 {
        let moved = |by: f64| {
            let mut point = POINT;
            point[column] += by;
            formula(point)
        };
        let [far, near] = [2.0, 1.0].map(|k| [moved(k * step), moved(-k * step)]);
        for output in 0..2 {
            let expected =
                (8.0 * (near[0][output] - near[1][output]) - far[0][output] + far[1][output]) / (12.0 * step);
            let found = gradient[3 * output + column];
            assert!((found - expected).abs() < 1e-11, "{output} {column}: {found} {expected}");
        }
    }
}

#[test]
fn terms_that_do_not_fit_are_refused_and_those_without_coefficients_dropped() {
    let factors = [Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
    for (factor, wrong) in [
        (factors, term(&[1], &[1.0])),
        (factors, term(&[1, 1], &[1.0, 2.0])),
        (factors, term(&[1, -1], &[1.0])),
        (factors, term(&[i16::MIN, 1], &[1.0])),
        (factors, term(&[1, 1], &[f64::NAN])),
        ([Factor::Angle, Factor::Power { middle: 0.0, half: 0.0 }], term(&[1, 1], &[1.0])),
    ] {
        assert!(Dictionary::new(&factor, 1, std::slice::from_ref(&wrong)).is_err(), "{wrong:?}");
    }
    let dictionary = Dictionary::new(&factors, 1, &[term(&[4, 2], &[0.0]), term(&[1, 0], &[2.0])]).unwrap();
    assert_eq!(dictionary.products(), 1);
}

#[test]
fn terms_give_the_dictionary_back() {
    let dictionary = example();
    let factors: Vec<Factor> = dictionary.factors().collect();
    let terms: Vec<Term> = dictionary.terms().collect();
    assert_eq!(terms[2], term(&[-3, 2, 1], &[-0.7, 0.2]));
    assert_eq!(Dictionary::new(&factors, 2, &terms).unwrap(), dictionary);
}
