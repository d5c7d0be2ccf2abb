//! The method against closed forms and published solutions.

use super::*;

/// A right-hand side.
struct Function<F>(F);

impl<F: Fn(f64, &DVector<f64>) -> DVector<f64>> ImplicitProblem for Function<F> {
    fn derivative(&mut self, t: f64, y: &DVector<f64>) -> Option<DVector<f64>> {
        Some((self.0)(t, y))
    }

    fn is_last(&mut self, _: f64, _: &DVector<f64>) -> bool {
        false
    }
}

/// Rows of a run.
fn run(
    derivative: impl Fn(f64, &DVector<f64>) -> DVector<f64>,
    initial: &[f64],
    times: &[f64],
    tolerance: f64,
) -> Vec<DVector<f64>> {
    let budget = Budget::default();
    budget.begin(times);
    let initial = DVector::from_column_slice(initial);
    let result = advance(&mut Function(derivative), initial, times, tolerance, &budget);
    assert_eq!(result.failure, None);
    assert_eq!(result.states.len(), times.len());
    result.states
}

#[test]
fn the_coefficients_integrate_polynomials_exactly() {
    for (node, weights) in NODES.iter().zip(WEIGHTS) {
        for power in 1..=STAGES as i32 {
            let sum: f64 = weights.iter().zip(NODES).map(|(weight, node)| weight * node.powi(power - 1)).sum();
            let exact = node.powi(power) / f64::from(power);
            assert!((sum - exact).abs() < 1e-15, "{power}: {sum} {exact}");
        }
    }
    // the quadrature is of order 13
    for power in 1..=2 * STAGES as i32 - 1 {
        let sum: f64 = WEIGHTS[STAGES - 1].iter().zip(NODES).map(|(weight, node)| weight * node.powi(power - 1)).sum();
        assert!((sum - 1.0 / f64::from(power)).abs() < 1e-15, "{power}");
    }
}

#[test]
fn the_eigenvectors_are_those_of_the_inverse() {
    let matrix = DMatrix::from_fn(STAGES, STAGES, |row, column| WEIGHTS[row][column]);
    let real = DVector::from_column_slice(&REAL_VECTOR);
    assert!((&matrix * &real * GAMMA - &real).amax() < 1e-14);
    assert!((DVector::from_column_slice(&REAL_ROW).dot(&real) - 1.0).abs() < 1e-13);
    for pair in 0..PAIR_COUNT {
        let complex = |[re, im]: [f64; 2]| Complex::new(re, im);
        let vector = DVector::from_iterator(STAGES, PAIR_VECTORS[pair].map(complex));
        let product = matrix.map(|value| Complex::new(value, 0.0)) * &vector * complex(PAIRS[pair]);
        assert!((product - &vector).map(|value| value.norm()).amax() < 1e-14);
        let row = DVector::from_iterator(STAGES, PAIR_ROWS[pair].map(complex));
        assert!((row.dot(&vector) - Complex::new(1.0, 0.0)).norm() < 1e-12);
    }
}

/// Prothero and Robinson (1974): `y' = -k (y - sin t) + cos t` has the solution `sin t` for every `k`.
#[test]
fn a_fast_decay_to_a_sine_is_followed() {
    let times: Vec<f64> = (0..=50).map(|row| 0.2 * f64::from(row)).collect();
    for k in [1.0, 1e3, 1e6, 1e9] {
        for tolerance in [1e-6, 1e-9, 1e-12] {
            let derivative = |t: f64, y: &DVector<f64>| DVector::from_element(1, -k * (y[0] - t.sin()) + t.cos());
            for (state, t) in run(derivative, &[0.0], &times, tolerance).iter().zip(&times) {
                let error = (state[0] - t.sin()).abs();
                assert!(error < 10.0 * tolerance, "k = {k}, tolerance {tolerance}, t = {t}: {error}");
            }
        }
    }
}

/// Robertson's reaction, whose solution at t = 40 Hairer and Wanner (1996) give; its start is a transient.
#[test]
fn a_stiff_reaction_is_that_of_the_test_set() {
    let derivative = |_: f64, y: &DVector<f64>| {
        let (a, b, c) = (0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] * y[1]);
        DVector::from_column_slice(&[-a + b, a - b - c, c])
    };
    let rows = run(derivative, &[1.0, 0.0, 0.0], &[0.0, 40.0], 1e-12);
    for (found, expected) in
        rows[1].iter().zip([0.715_827_068_718_903_6, 9.185_534_764_557_82e-6, 0.284_163_745_746_331])
    {
        assert!((found - expected).abs() < 1e-11, "{found} {expected}");
    }
}

/// Problem of Prothero and Robinson; it counts evaluations and notes the largest error inside its steps.
struct Watched {
    evaluations: usize,
    jacobians: usize,
    provides: bool,
    inside: f64,
}

/// The `k` of that problem.
const DECAY: f64 = 1e4;

impl ImplicitProblem for Watched {
    fn derivative(&mut self, t: f64, y: &DVector<f64>) -> Option<DVector<f64>> {
        self.evaluations += 1;
        Some(DVector::from_element(1, -DECAY * (y[0] - t.sin()) + t.cos()))
    }

    fn jacobian(&mut self, _: f64, _: &DVector<f64>) -> Option<DMatrix<f64>> {
        self.jacobians += 1;
        self.provides.then(|| DMatrix::from_element(1, 1, -DECAY))
    }

    fn accept(&mut self, step: &CollocationStep) -> bool {
        for share in (0..=20).map(|part| f64::from(part) / 20.0) {
            let error = (step.at(share)[0] - (step.t + share * step.size).sin()).abs();
            self.inside = self.inside.max(error);
        }
        let nodes = CollocationStep::nodes().iter().enumerate();
        for (node, share) in nodes {
            assert!((step.at_node(node) - step.at(*share)).amax() < 1e-13);
        }
        step.t + step.size >= 9.0
    }

    fn is_last(&mut self, _: f64, _: &DVector<f64>) -> bool {
        false
    }
}

#[test]
fn an_integration_is_resumed_where_it_ended_and_accurate_inside_its_steps() {
    let tolerance = 1e-9;
    let mut counts = Vec::new();
    for (provides, keeps) in [(true, true), (false, true), (false, false)] {
        let mut problem = Watched { evaluations: 0, jacobians: 0, provides, inside: 0.0 };
        let (mut y, mut memory) = (DVector::zeros(1), None);
        for row in 0..100 {
            let times = [row, row + 1].map(|row| 0.05 * f64::from(row));
            let mut result = resume(&mut problem, y, &times, tolerance, &Budget::default(), &mut memory);
            assert_eq!((result.failure, result.states.len()), (None, 2));
            y = result.states.swap_remove(1);
            assert!((y[0] - times[1].sin()).abs() < 10.0 * tolerance, "t = {}", times[1]);
            memory = memory.filter(|_| keeps);
        }
        assert!(problem.inside < 10.0 * tolerance, "{}", problem.inside);
        counts.push((problem.evaluations, problem.jacobians));
    }
    let [provided, kept, renewed] = counts[..] else { panic!("three runs") };
    // one by differences takes one more evaluation
    assert_eq!(provided.0 + kept.1, kept.0);
    assert!(kept.1 < 10 && renewed.1 >= 100 && 2 * kept.0 < renewed.0, "{counts:?}");
}

#[test]
fn a_problem_stops_at_a_step_between_two_rows() {
    let mut problem = Watched { evaluations: 0, jacobians: 0, provides: true, inside: 0.0 };
    let times = [0.0, 20.0];
    let result = resume(&mut problem, DVector::zeros(1), &times, 1e-9, &Budget::default(), &mut None);
    assert_eq!((result.failure, result.states.len()), (None, 1));
}

/// A mass on a stiff spring without damping: nothing is lost where the tolerance resolves the oscillation.
#[test]
fn an_oscillation_keeps_its_amplitude() {
    let omega = 1e3;
    let times = [0.0, 0.5, 1.0];
    let derivative = |_: f64, y: &DVector<f64>| DVector::from_column_slice(&[omega * y[1], -omega * y[0]]);
    let rows = run(derivative, &[1.0, 0.0], &times, 1e-12);
    for (row, t) in rows.iter().zip(times) {
        assert!((row[0] - (omega * t).cos()).abs() < 1e-10, "{}", row[0] - (omega * t).cos());
    }
}

#[test]
fn a_state_that_leaves_the_numbers_is_located() {
    let budget = Budget::default();
    let times = [0.0, 0.75, 1.5];
    budget.begin(&times);
    let mut problem = Function(|_: f64, y: &DVector<f64>| y.component_mul(y));
    let result = advance(&mut problem, DVector::from_element(1, 1.0), &times, 1e-9, &budget);
    assert_eq!(result.states.len(), 2);
    let failure = result.failure.unwrap();
    assert_eq!(failure.message, "no step of the implicit method is short enough for the tolerance");
    assert!((failure.t - 1.0).abs() < 1e-9, "{failure}");
}
