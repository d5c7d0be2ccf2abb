use super::*;
use metafmu_runtime::{Dynamics, dictionary::Term};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

const POWER: Factor = Factor::Power { middle: 0.0, half: 1.0 };

/// A motion of `a(q, v, u)`, by steps of Runge-Kutta's method a twentieth as long, with inputs that are linear between the rows.
fn motion_of(
    a: impl Fn(&[f64], &[f64], f64) -> Vec<f64>,
    start: (&[f64], &[f64]),
    (step, rows): (f64, usize),
    input: Option<&dyn Fn(f64) -> f64>,
) -> Trajectory {
    let n = start.0.len();
    let mut state = [start.0, start.1].concat();
    let knots: Vec<f64> = (0..=rows).map(|row| input.map_or(0.0, |input| input(step * row as f64))).collect();
    let (mut q, mut v) = (Vec::new(), Vec::new());
    let h = step / 20.0;
    for row in 0..rows {
        q.extend_from_slice(&state[..n]);
        v.extend_from_slice(&state[n..]);
        for part in 0..20 {
            let rates = |state: &[f64], later: f64| {
                let share = (f64::from(part) + later) / 20.0;
                let u = knots[row] + share * (knots[row + 1] - knots[row]);
                [state[n..].to_vec(), a(&state[..n], &state[n..], u)].concat()
            };
            let moved = |by: &[f64], h: f64| state.iter().zip(by).map(|(state, by)| state + h * by).collect::<Vec<_>>();
            let one = rates(&state, 0.0);
            let two = rates(&moved(&one, 0.5 * h), 0.5);
            let three = rates(&moved(&two, 0.5 * h), 0.5);
            let four = rates(&moved(&three, h), 1.0);
            for k in 0..2 * n {
                state[k] += h / 6.0 * (one[k] + 2.0 * two[k] + 2.0 * three[k] + four[k]);
            }
        }
    }
    let u = if input.is_some() { knots[..rows].to_vec() } else { Vec::new() };
    Trajectory { parameters: Vec::new(), step, coordinates: n, q, v, u }
}

fn double_pendulum(q: &[f64], v: &[f64], _: f64) -> Vec<f64> {
    let (sine, cosine) = (q[1] - q[0]).sin_cos();
    let mass = 2.0 - cosine * cosine;
    let side = [v[1] * v[1] * sine - 19.6 * q[0].sin(), -v[0] * v[0] * sine - 9.8 * q[1].sin()];
    vec![(side[0] - cosine * side[1]) / mass, (2.0 * side[1] - cosine * side[0]) / mass]
}

fn mbd_node() -> Trajectory {
    use std::f64::consts::PI;
    motion_of(double_pendulum, (&[0.5 * PI, 0.25 * PI], &[0.0; 2]), (4.0 / 399.0, 300), None)
}

fn equations(model: &AccelerationModel) -> &Dynamics {
    match model {
        AccelerationModel::Motion(dynamics) => dynamics,
        AccelerationModel::Functions(_) => panic!("functions, expected equations of motion"),
    }
}

fn coefficient(model: &AccelerationModel, exponents: &[i16], function: usize) -> f64 {
    let term = equations(model).function_set().dictionary().terms().find(|term: &Term| term.exponents == exponents);
    term.map_or(0.0, |term| term.coefficients[function])
}

#[test]
fn the_coefficients_of_a_double_pendulum_are_found_from_one_motion() {
    let found = fit_motion(&[Factor::Angle; 2], &[mbd_node()]).unwrap();
    assert!(found.error < 1e-6 && found.solutions == 1 && found.coefficients == 6, "{found:?}");
    // M = [2, c; c, 1] / 2 with c = cos(q1 - q2), V = -9.8 (2 cos q1 + cos q2) / 2
    let expected = [
        (&[0, 0], 0, 1.0),
        (&[1, 1], 1, 0.5),
        (&[-1, -1], 1, 0.5),
        (&[0, 0], 2, 0.5),
        (&[1, 0], 3, -9.8),
        (&[0, 1], 3, -4.9),
    ];
    for (exponents, function, expected) in expected {
        let found = coefficient(&found.model, exponents, function);
        assert!((found - expected).abs() < 1e-6, "{exponents:?}: {found} {expected}");
    }
}

#[test]
fn rates_by_differences_and_single_precision_are_good_enough() {
    let mut motion = mbd_node();
    let rates: Vec<Vec<f64>> =
        (0..2).map(|k| crate::dynamics::trajectory::differences(&motion.q, 2, k, motion.step)).collect();
    motion.v = (0..motion.rows()).flat_map(|row| [rates[0][row], rates[1][row]]).collect();
    let found = fit_motion(&[Factor::Angle; 2], &[motion]).unwrap();
    assert!(found.error < 1e-4, "{found:?}");
    let mut single = mbd_node();
    single.q.iter_mut().chain(&mut single.v).for_each(|value| *value = f64::from(*value as f32));
    let found = fit_motion(&[Factor::Angle; 2], &[single]).unwrap();
    assert!(found.error < 1e-5 && found.coefficients < 12, "{found:?}");
}

#[test]
fn what_nothing_couples_has_a_factor_of_its_own() {
    let pair = |q: &[f64], v: &[f64], _: f64| vec![-9.81 * q[0].sin() - 0.1 * v[0], -4.0 * q[1].sin()];
    let motion = motion_of(pair, (&[2.0, 1.0], &[0.0; 2]), (0.02, 400), None);
    let found = fit_motion(&[Factor::Angle; 2], std::slice::from_ref(&motion)).unwrap();
    assert!(found.error < 1e-6 && found.solutions > 1, "{found:?}");
    // on the orbit: the second one conserves its energy, and one motion does not say what happens with another energy
    let (q, v) = (&motion.q[700..702], &motion.v[700..702]);
    let mut accelerations = [0.0; 2];
    let point = metafmu_runtime::StatePoint { q, v, u: &[], p: &[] };
    equations(&found.model).accelerations(point, &mut accelerations, &mut equations(&found.model).scratch());
    let expected = pair(q, v, 0.0);
    assert!((0..2).all(|k| (accelerations[k] - expected[k]).abs() < 1e-4), "{accelerations:?} {expected:?}");
}

#[test]
fn an_input_is_found_with_what_it_acts_on() {
    let crane = |q: &[f64], v: &[f64], u: f64| {
        let (sine, cosine) = q[1].sin_cos();
        let x = (u - 0.3 * v[0] + 1.4 * v[1] * v[1] * sine + 9.81 * sine * cosine) / (3.0 - cosine * cosine);
        vec![x, -(x * cosine + 9.81 * sine) / 1.4]
    };
    let push = |t: f64| 3.0 * (2.0 * t).sin() + 2.0 * (5.1 * t + 1.0).sin();
    let motion = motion_of(crane, (&[0.0, 0.5], &[0.0; 2]), (0.01, 600), Some(&push));
    let found = fit_motion(&[POWER, Factor::Angle], &[motion]).unwrap();
    assert!(found.error < 1e-5 && found.coefficients <= 8, "{found:?}");
    let whole = coefficient(&found.model, &[0, 0], 0);
    // damping and input of the cart, over its mass
    for (function, expected) in [(6, 0.1), (10, 1.0 / 3.0)] {
        let found = coefficient(&found.model, &[0, 0], function) / whole;
        assert!((found - expected).abs() < 1e-4, "{function}: {found} {expected}");
    }
}

#[test]
fn a_spring_that_hardens_is_found_by_both_ways() {
    let spring = |q: &[f64], v: &[f64], _: f64| vec![-(50.0 * q[0] + 0.1 * q[0].powi(3) + 2.0 * v[0]) / 10.0];
    let motion = motion_of(spring, (&[1.0], &[0.0]), (0.01, 300), None);
    let by_motion = fit_motion(&[POWER], std::slice::from_ref(&motion)).unwrap();
    let by_functions = fit_accelerations(&[POWER; 2], std::slice::from_ref(&motion)).unwrap();
    for found in [by_motion, by_functions] {
        assert!(found.error < 1e-7, "{found:?}");
    }
}

#[test]
fn noise_shows_in_the_error() {
    let mut generator = ChaCha8Rng::seed_from_u64(1);
    let mut noisy = mbd_node();
    noisy.q.iter_mut().chain(&mut noisy.v).for_each(|value| *value += 0.1 * (generator.random::<f64>() - 0.5));
    let errors = [
        fit_motion(&[Factor::Angle; 2], std::slice::from_ref(&noisy)).map(|found| found.error),
        fit_accelerations(&[Factor::Angle, Factor::Angle, POWER, POWER], std::slice::from_ref(&noisy))
            .map(|found| found.error),
    ];
    assert!(errors.iter().all(|error| error.as_ref().map_or(true, |error| *error > 0.1)), "{errors:?}");
    let few = noisy.first(20);
    assert!(fit_motion(&[Factor::Angle; 2], &[few]).is_err());
}
