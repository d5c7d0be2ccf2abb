//! Programs with continuous states whose graphs are not equations of motion alone.

use crate::{CommunicationStep, Drive, Evaluator, Graph, Integration, Program, Surrogate, example, graph::Step};

/// mu, starts, force, states.
const POINT: [f64; 6] = [1.2, 0.0, 0.0, 0.3, 0.8, -0.5];

#[test]
fn results_are_the_equations() {
    for surrogate in [example::oscillator(None), example::oscillator_by_graph()] {
        let mut evaluator = Evaluator::new(&surrogate);
        let mut results = [0.0; 3];
        evaluator.evaluate(&POINT, &mut results);
        let [mu, _, _, u, x, v] = POINT;
        let expected = [x, v, mu * (1.0 - x * x) * v - x + u];
        assert!(results.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-14), "{results:?} {expected:?}");
    }
}

#[test]
fn derivatives_are_those_of_finite_differences_with_and_without_an_added_function() {
    let by_network = example::oscillator(Some(example::residual_network()));
    for surrogate in [example::oscillator(None), by_network, example::oscillator_by_graph()] {
        let mut evaluator = Evaluator::new(&surrogate);
        let (direction, bend) = ([0.4, 1.0, 1.0, -0.7, 0.2, 0.9], [0.1, 0.0, 0.0, 0.3, -0.6, 0.2]);
        let (mut along, mut first, mut second) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        evaluator.directional(&POINT, &direction, &mut along);
        evaluator.along_curve(&POINT, [&direction, &bend], [&mut first, &mut second]);
        let mut at = |h: f64| {
            let point: [f64; 6] = std::array::from_fn(|k| POINT[k] + h * (direction[k] + 0.5 * h * bend[k]));
            let mut results = [0.0; 3];
            evaluator.evaluate(&point, &mut results);
            results
        };
        let h = 1e-4;
        let [before, here, after] = [at(-h), at(0.0), at(h)];
        for k in 0..3 {
            let slope = (after[k] - before[k]) / (2.0 * h);
            let bent = (after[k] - 2.0 * here[k] + before[k]) / (h * h);
            assert!((first[k] - slope).abs() < 1e-6 && along[k] == first[k], "{k}: {} {slope}", first[k]);
            assert!((second[k] - bent).abs() < 1e-5, "{k}: {} {bent}", second[k]);
        }
        let (weights, mut gradient) = ([0.5, -1.0, 2.0], [0.0; 6]);
        evaluator.adjoint(&POINT, &weights, &mut gradient);
        let forwards: f64 = weights.iter().zip(along).map(|(weight, along)| weight * along).sum();
        let backwards: f64 = gradient.iter().zip(direction).map(|(gradient, along)| gradient * along).sum();
        assert!((forwards - backwards).abs() < 1e-13);
    }
}

#[test]
fn both_methods_reach_the_same_state() {
    let none = [0.0; 6];
    let by_network = example::oscillator(Some(example::residual_network()));
    for surrogate in [example::oscillator(None), by_network, example::oscillator_by_graph()] {
        let reach = |integration: Integration| {
            let mut evaluator = Evaluator::new(&example::integrated(&surrogate, integration));
            let mut point = POINT;
            let drive = Drive { rates: [&none, &none], clamp: None };
            evaluator.advance(&mut point, CommunicationStep::of(1.5), drive).unwrap();
            point
        };
        let fixed = reach(Integration::Fixed { step: 0.005 });
        let adaptive = reach(Integration::ErrorControlled { tolerance: 1e-12, longest: 1.0 });
        assert!(
            (4..6).all(|k| (fixed[k] - adaptive[k]).abs() < 1e-9 && fixed[k] != POINT[k]),
            "{fixed:?} {adaptive:?}"
        );
    }
}

#[test]
fn the_solver_integrates_scaled_equations_of_motion() {
    let crane = example::crane();
    let Program { graph: Graph { inputs, steps }, clock } = crane.program();
    let Step::Motion { motion, .. } = &steps[0] else { unreachable!("the crane moves") };
    let moved = |of| Step::Motion { of, motion: motion.clone() };
    let standardize = Step::Standardize { of: 0, mean: vec![0.125; *inputs], scale: vec![2.0; *inputs] };
    let rescale = |of| Step::Rescale { of, mean: vec![0.25; 11], scale: vec![2.0; 11] };
    let same: fn(f64) -> f64 = |x| x;
    for (steps, before, after) in [
        (vec![standardize.clone(), moved(1)], (|x| (x - 0.125) / 2.0) as fn(f64) -> f64, same),
        (vec![moved(0), rescale(1)], same, |y| 0.25 + 2.0 * y),
        (vec![standardize, moved(1), rescale(2)], |x| (x - 0.125) / 2.0, |y| 0.25 + 2.0 * y),
    ] {
        let program = Program { graph: Graph { inputs: *inputs, steps }, clock: clock.clone() };
        let mut evaluator = Evaluator::new(&Surrogate::new(crane.metadata().clone(), program).unwrap());
        let point = [1.4, 0.0, 0.3, 0.0, 0.0, 3.0, 0.4, 0.9, -1.2, 2.0];
        let (mut expected, mut found) = ([0.0; 11], [0.0; 11]);
        Evaluator::new(&crane).evaluate(&point.map(before), &mut expected);
        let expected = expected.map(after);
        evaluator.evaluate(&point, &mut found);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-13), "{found:?} {expected:?}");
        let (mut reached, none, step) = (point, [0.0; 10], 1e-6);
        let drive = Drive { rates: [&none, &none], clamp: None };
        evaluator.advance(&mut reached, CommunicationStep::of(step), drive).unwrap();
        for (state, rate) in (6..10).zip(&expected[7..]) {
            let found = (reached[state] - point[state]) / step;
            assert!((found - rate).abs() < 1e-4, "{state}: {found} {rate}");
        }
    }
}
