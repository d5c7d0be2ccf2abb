//! Values, derivatives and steps of the sources, compared with the evaluator.

use super::*;

#[test]
fn outputs_and_derivatives_are_those_of_the_evaluator() {
    for (hidden, activation) in LAYERS {
        compare_networks(&example::with_network(hidden, activation), &[]);
    }
}

#[test]
fn a_last_layer_may_have_an_activation() {
    for (hidden, activation) in LAYERS {
        compare_networks(&bent(&example::with_network(hidden, Activation::Tanh), activation), &[]);
    }
    compare_networks(&bent(&twenty_outputs(), Activation::Silu), &SANITIZERS);
}

#[test]
fn networks_for_instants_are_interpolated_as_by_the_evaluator() {
    for hidden in [&[33, 7, 50][..], &[1, 130], &[]] {
        compare_networks(&example::per_instant(hidden, Activation::Sigmoid, Precision::Double), &[]);
    }
    let surrogate = example::per_instant(&[24, 9], Activation::Tanh, Precision::Double);
    for surrogate in [bent(&surrogate, Activation::Gelu), example::encoded(&surrogate)] {
        compare_networks(&surrogate, &SANITIZERS);
    }
}

#[test]
fn the_outputs_and_derivatives_of_a_regression_are_those_of_the_evaluator() {
    let example = example::surrogate();
    for example in [&example, &example::encoded(&example)] {
        for surrogate in regressions(example).into_iter().chain([graph(example), process(example)]) {
            compare(&surrogate, [10.0, 0.03], &SANITIZERS);
        }
    }
    for surrogate in [constant(), no_tree()] {
        compare(&surrogate, [1.0, 1.0], &SANITIZERS);
    }
}

#[test]
fn nominal_and_periodic_inputs_become_the_columns_of_the_evaluator() {
    for hidden in [&[24, 9][..], &[130], &[]] {
        compare_networks(&example::encoded(&example::with_network(hidden, Activation::Tanh)), &SANITIZERS);
    }
}

#[test]
fn fused_multiply_add_changes_no_more_than_rounding() {
    compare_networks(
        &example::with_network(&[40, 40], Activation::Tanh),
        &["-O3", "-march=native", "-ffp-contract=fast"],
    );
}

/// Sources that GCC compiles for several processors, with fused multiply-add where available, beside plain ones.
#[test]
fn the_processor_changes_no_more_than_rounding() {
    for flags in [["-O3", "-ffp-contract=fast"], ["-O3", "-DMETAFMU_PLAIN"]] {
        compare_networks(&example::with_network(&[40, 40], Activation::Tanh), &flags);
        compare(&graph(&example::surrogate()), [10.0, 0.03], &flags);
        compare(&example::crane_with_networks(), [10.0, 1.0], &flags);
    }
}

#[test]
fn the_results_and_derivatives_of_a_motion_are_those_of_the_evaluator() {
    compare(&example::crane(), [1.0, 1.0], &SANITIZERS);
    compare(&example::crane(), [1.0, 1.0], &["-O3", "-march=native"]);
    compare(&example::crane_with_networks(), [10.0, 1.0], &SANITIZERS);
    compare(&example::crane_with_reactions(), [1.0, 1.0], &SANITIZERS);
    compare(&example::crane_with_efforts(), [1.0, 1.0], &SANITIZERS);
    compare(&example::crane_with_splines(), [1.0, 1.0], &SANITIZERS);
    compare(&example::crane_with_motor(), [1.0, 1.0], &SANITIZERS);
    compare(&example::with_prescribed_trolley(&example::crane_with_reactions()), [1.0, 1.0], &SANITIZERS);
    compare(&example::with_prescribed_trolley(&example::crane_with_networks()), [10.0, 1.0], &SANITIZERS);
    // no position, no input
    compare(&pushed_by_nothing(), [1.0, 1.0], &SANITIZERS);
}

#[test]
fn the_results_and_derivatives_of_a_state_space_are_those_of_the_evaluator() {
    for surrogate in [
        example::oscillator(None),
        example::oscillator(Some(example::residual_network())),
        example::oscillator_by_graph(),
        turning(Activation::Tanh),
        turning(Activation::Gelu),
        left_alone(),
        without_states(true),
        without_states(false),
    ] {
        compare(&surrogate, [1.0, 1.0], &SANITIZERS);
    }
    compare(&turning(Activation::Silu), [1.0, 1.0], &["-O3", "-march=native"]);
}

#[test]
fn the_outputs_of_a_model_of_samples_are_those_of_the_evaluator() {
    for surrogate in
        [example::recorded(), example::supported(), example::direct(), window(), two_by_two(), example::cell(), alone()]
    {
        compare(&surrogate, [1.0, 1.0], &SANITIZERS);
    }
}

/// Two hundred steps of a crane by each method with a force that changes, and steps that fail, in C and in Rust.
#[test]
fn the_steps_of_a_motion_are_those_of_the_evaluator() {
    for integration in [Integration::Fixed { step: 0.005 }, CONTROLLED, IMPLICIT] {
        let surrogate = example::integrated(&example::crane(), integration);
        let mut steps = Steps::of(&surrogate);
        let start = steps.start(&[1.4, 0.4, 0.9, -1.2, 2.0, 3.0]);
        for (tolerance, clamp) in [(0.0, false), (1e-7, false), (0.0, true), (1e-2, true)] {
            let mut point = start.clone();
            for index in 0..200 {
                let rates = [30.0 - 10.0 * f64::from(index % 7), 40.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, 0.02, tolerance, clamp, rates);
                point[5] += 0.02 * (rates[0] + 0.01 * rates[1]);
            }
        }
        let limit = surrogate.states()[0].limit();
        for (rope, far, size) in [(0.0, 0.4, 0.1), (1.4, 0.1 - limit, 0.2), (1.4, 0.4, 0.0), (-1.0, 0.4, 0.3)] {
            let mut point = start.clone();
            (point[0], point[6]) = (rope, far);
            steps.step(true, &mut point, size, 0.0, false, [0.0; 2]);
        }
        steps.step(true, &mut start.clone(), 1e9, 0.0, false, [0.0; 2]);
        // differences for the Jacobian magnify rounding
        let ends = steps.compare_within(if integration == IMPLICIT { 1e-10 } else { 1e-12 }, &SANITIZERS);
        assert!(ends[..800].iter().all(|end| *end == 0.0));
        assert_eq!((ends[800], ends[801], ends[802]), (1.0, 3.0, 0.0), "{integration:?}");
        assert_eq!(ends[804], 2.0);
    }
}

/// Integration with error control, whose tolerance a host may change.
const CONTROLLED: Integration = Integration::ErrorControlled { tolerance: 1e-5, longest: 0.02 };
const IMPLICIT: Integration = Integration::Implicit { tolerance: 1e-5, longest: 0.02 };

#[test]
fn the_steps_of_a_state_space_are_those_of_the_evaluator() {
    let by_network = example::oscillator(Some(example::residual_network()));
    let controlled = [&by_network, &turning(Activation::Tanh)].map(|space| example::integrated(space, CONTROLLED));
    let implicit = example::integrated(&by_network, IMPLICIT);
    for surrogate in [by_network, example::oscillator_by_graph(), implicit].into_iter().chain(controlled) {
        let mut steps = Steps::of(&surrogate);
        let start = steps.start(&[1.2, 0.8, -0.5, 0.4]);
        for (tolerance, clamp) in [(0.0, false), (1e-7, false), (0.0, true), (1e-2, true)] {
            let mut point = start.clone();
            for index in 0..200 {
                let rates = [3.0 - f64::from(index % 7), 4.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, 0.02, tolerance, clamp, rates);
                point[3] += 0.02 * (rates[0] + 0.01 * rates[1]);
            }
        }
        for (speed, size) in [(1e300, 1e5), (1.0, 0.0), (1.0, 0.3)] {
            let mut point = start.clone();
            point[5] = speed;
            steps.step(true, &mut point, size, 0.0, false, [0.0; 2]);
        }
        steps.step(true, &mut start.clone(), 1e9, 0.0, false, [0.0; 2]);
        let ends = steps.compare(&SANITIZERS);
        assert_eq!(ends[803], 2.0);
        assert!(ends[..800].iter().all(|end| *end == 0.0) && ends[800] > 0.0, "{:?}", &ends[800..]);
    }
}

/// Whole samples, parts of them, several, and such that miss samples a little.
#[test]
fn the_steps_of_a_model_of_samples_are_those_of_the_evaluator() {
    for (surrogate, inputs) in [
        (example::recorded(), &[1.3, 0.4, 0.25, 1.0][..]),
        (window(), &[0.4, 0.25, 1.0]),
        (two_by_two(), &[1.3, 0.4, -0.2, 1.0, -2.0]),
        (example::cell(), &[1.3, 0.4, 1.0]),
    ] {
        let mut steps = Steps::of(&surrogate);
        let start = steps.start(inputs);
        let driven = steps.driven();
        for (sizes, clamp) in [
            (&[0.1][..], false),
            (&[0.05], true),
            (&[0.1 / 3.0], false),
            (&[0.25, 0.37, 0.02, 0.1, 1.7], true),
            (&[0.1 * (1.0 + 1e-7), 0.1 * (1.0 - 3e-7)], false),
            (&[0.0, 1e-9, 0.1], false),
        ] {
            let mut point = start.clone();
            for (index, size) in (0..60).zip(sizes.iter().cycle()) {
                let rates = [30.0 - 10.0 * f64::from(index % 7), 40.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, *size, 0.0, clamp, rates);
                point[driven] = 4.0 * (0.37 * f64::from(index)).sin();
            }
        }
        steps.step(true, &mut start.clone(), 2e6, 0.0, false, [0.0; 2]);
        let ends = steps.compare(&SANITIZERS);
        assert!(ends[..360].iter().all(|end| *end == 0.0) && ends[360..] == [2.0]);
    }
    let surrogate = diverging();
    let mut steps = Steps::of(&surrogate);
    let start = steps.start(&[1.3, 0.4, 0.25, 1.0]);
    for size in [0.1, 0.15, 1.0] {
        steps.step(true, &mut start.clone(), size, 0.0, false, [0.0; 2]);
    }
    assert_eq!(steps.compare(&SANITIZERS), [0.0, 1.0, 1.0]);
}
