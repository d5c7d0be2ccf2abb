use super::*;
use crate::dictionary::{Dictionary, Factor, Term};

/// A cart of 2 kg with damping 0.3, pushed by the input, and a load of 1 kg on a rope of length `l`, a parameter. The
/// columns are x, theta, l; the function set is `M = [3; l cos, l²]`, `V = -g l cos`.
fn crane() -> Dynamics {
    let factors = [Factor::Power { middle: 0.0, half: 1.0 }, Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
    let functions = Dynamics::functions(2, 1);
    let term = |exponents: [i16; 3], values: &[(usize, f64)]| {
        let mut coefficients = vec![0.0; functions];
        values.iter().for_each(|(index, value)| coefficients[*index] = *value);
        Term { exponents: exponents.to_vec(), coefficients }
    };
    let terms = [
        // M_xx, D_xx, B_x
        term([0, 0, 0], &[(0, 3.0), (6, 0.3), (10, 1.0)]),
        // M_x theta, V
        term([0, 1, 1], &[(1, 1.0), (3, -9.81)]),
        term([0, 0, 2], &[(2, 1.0)]),
    ];
    Dynamics::new(2, 1, Dictionary::new(&factors, functions, &terms).unwrap()).unwrap()
}

fn exact([_, theta]: [f64; 2], [xd, thetad]: [f64; 2], u: f64, l: f64) -> [f64; 2] {
    let (sine, cosine) = theta.sin_cos();
    let side = u - 0.3 * xd + l * thetad * thetad * sine + 9.81 * sine * cosine;
    let xdd = side / (3.0 - cosine * cosine);
    [xdd, -(xdd * cosine + 9.81 * sine) / l]
}

#[test]
fn accelerations_and_their_derivatives_are_those_of_the_crane() {
    let crane = crane();
    let mut scratch = crane.scratch();
    let (q, v, u, l) = ([0.4, 0.9], [-1.2, 2.0], 3.0, 1.4);
    let mut found = [0.0; 2];
    crane.accelerations(Point { q: &q, v: &v, u: &[u], p: &[l] }, &mut found, &mut scratch);
    let expected = exact(q, v, u, l);
    assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1e-13), "{found:?} {expected:?}");

    let direction = ([0.7, -0.2], [0.4, 1.3], [0.9], [-0.5]);
    let to = Point { q: &direction.0, v: &direction.1, u: &direction.2, p: &direction.3 };
    let mut derivative = [0.0; 2];
    crane.directional(Point { q: &q, v: &v, u: &[u], p: &[l] }, to, &mut derivative, &mut scratch);
    let along = |h: f64| {
        let moved = |at: [f64; 2], by: [f64; 2]| [at[0] + h * by[0], at[1] + h * by[1]];
        exact(moved(q, direction.0), moved(v, direction.1), u + h * direction.2[0], l + h * direction.3[0])
    };
    let (after, before) = (along(1e-5), along(-1e-5));
    for k in 0..2 {
        let expected = (after[k] - before[k]) / 2e-5;
        assert!((derivative[k] - expected).abs() < 1e-8, "{k}: {} {expected}", derivative[k]);
    }
}

#[test]
fn a_bead_on_an_arm_that_is_turned_feels_the_centrifugal_force() {
    // columns: the arm's angle, the bead's radius; M = [0.1 + m r²; 0, m], V = m g r sin
    let factors = [Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
    let functions = Dynamics::functions(2, 1);
    let term = |exponents: [i16; 2], values: &[(usize, f64)]| {
        let mut coefficients = vec![0.0; functions];
        values.iter().for_each(|(index, value)| coefficients[*index] = *value);
        Term { exponents: exponents.to_vec(), coefficients }
    };
    // the input is the arm's acceleration, less twice its velocity and plus 0.5 cos; the last of D is damping along the arm
    let terms = [
        term([0, 0], &[(0, 0.1), (2, 0.5), (6, 2.0), (9, 0.3), (10, 1.0)]),
        term([0, 2], &[(0, 0.5)]),
        term([-1, 1], &[(3, 0.5 * 9.81)]),
        term([1, 0], &[(4, 0.5)]),
    ];
    let free = Dynamics::new(2, 1, Dictionary::new(&factors, functions, &terms).unwrap()).unwrap();
    let arm = free.clone().with_prescribed(&[0]).unwrap();
    let ([angle, r], [omega, rate], u): ([f64; 2], [f64; 2], f64) = ([0.7, 1.3], [2.0, -0.4], 1.7);
    let mut found = [0.0; 2];
    arm.accelerations(Point { q: &[angle, r], v: &[omega, rate], u: &[u], p: &[] }, &mut found, &mut arm.scratch());
    let expected = [u - 2.0 * omega + 0.5 * angle.cos(), r * omega * omega - 9.81 * angle.sin() - 0.3 * rate / 0.5];
    assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1e-13), "{found:?} {expected:?}");
    // without any mass of the arm, and with both prescribed, too
    let massless: Vec<Term> = terms[..1]
        .iter()
        .map(|term| {
            let mut term = term.clone();
            term.coefficients[0] = 0.0;
            term
        })
        .collect();
    let both = Dynamics::new(2, 1, Dictionary::new(&factors, functions, &massless).unwrap()).unwrap();
    for (prescribed, is_finite) in [(&[][..], false), (&[0][..], true), (&[0, 1][..], true)] {
        let both = both.clone().with_prescribed(prescribed).unwrap();
        both.accelerations(
            Point { q: &[angle, r], v: &[omega, rate], u: &[u], p: &[] },
            &mut found,
            &mut both.scratch(),
        );
        assert_eq!(found.iter().all(|value| value.is_finite()), is_finite, "{prescribed:?}: {found:?}");
    }
    assert_eq!(found, [u - 2.0 * omega, -0.3 * rate]);
    let refused = free.with_prescribed(&[1, 2]).unwrap_err().to_string();
    assert_eq!(refused, "tensor `prescribed`, element 1: 2, expected less than 2");
}

#[test]
fn energy_changes_by_what_damping_and_input_do() {
    let crane = crane();
    let (mut scratch, mut stages) = (crane.scratch(), [0.0; 16]);
    let (mut q, mut v, u, p) = ([0.0, 1.2], [0.5, 0.0], [0.0], [1.4]);
    let energy =
        |q: &[f64], v: &[f64], scratch: &mut DynamicsScratch| crane.energy(Point { q, v, u: &u, p: &p }, scratch);
    let start = energy(&q, &v, &mut scratch);
    let (mut work, h) = (0.0, 2e-4);
    for _ in 0..25_000 {
        let before = v[0];
        crane.runge_kutta_step((&mut q, &mut v), (&u, &p), h, &mut stages, &mut scratch);
        // the velocity taken as linear in the step: good to h²
        work -= 0.3 * h * (before * before + before * v[0] + v[0] * v[0]) / 3.0;
    }
    let change = energy(&q, &v, &mut scratch) - start;
    assert!(work < -0.1 && (change - work).abs() < 1e-6, "{change} {work}");
}

#[test]
fn halving_the_step_divides_the_error_by_sixteen() {
    let crane = crane();
    let (mut scratch, mut stages) = (crane.scratch(), [0.0; 16]);
    let mut after = |steps: u32| {
        let (mut q, mut v) = ([0.0, 1.2], [0.5, 0.0]);
        let h = 1.0 / f64::from(steps);
        (0..steps)
            .for_each(|_| crane.runge_kutta_step((&mut q, &mut v), (&[2.0], &[1.4]), h, &mut stages, &mut scratch));
        q[1]
    };
    let exact = after(10_000);
    let ratio = (after(200) - exact) / (after(400) - exact);
    assert!((14.0..18.0).contains(&ratio), "{ratio}");
}

#[test]
fn a_mass_that_is_not_positive_gives_no_number() {
    let factors = [Factor::Angle];
    let mut coefficients = vec![0.0; Dynamics::functions(1, 0)];
    coefficients[0] = 1.0;
    let function_set =
        Dictionary::new(&factors, coefficients.len(), &[Term { exponents: vec![1], coefficients }]).unwrap();
    let dynamics = Dynamics::new(1, 0, function_set).unwrap();
    let (mut scratch, mut found) = (dynamics.scratch(), [0.0]);
    for (q, is_finite) in [(0.3, true), (2.0, false)] {
        dynamics.accelerations(Point { q: &[q], v: &[0.1], u: &[], p: &[] }, &mut found, &mut scratch);
        assert_eq!(found[0].is_finite(), is_finite, "{q}");
    }
}

#[test]
fn a_law_of_another_shape_is_refused() {
    let function_set = Dictionary::new(&[Factor::Angle], 3, &[]).unwrap();
    assert!(Dynamics::new(1, 0, function_set.clone()).is_err() && Dynamics::new(0, 0, function_set).is_err());
}
