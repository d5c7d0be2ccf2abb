use crate::{
    CommunicationStep, Domain, Drive, Evaluator, Graph, Numbers, Program, StepError, Surrogate, example, graph::Step,
};

/// Mass, starts of output and force, force; then the memory.
fn point(evaluator: &Evaluator, start: f64, force: f64) -> Vec<f64> {
    let mut point = vec![1.5, start, 0.25, force];
    point.resize(evaluator.columns(), 0.0);
    evaluator.start(&mut point);
    point
}

fn drive<'a>(rates: [&'a [f64]; 2]) -> Drive<'a> {
    Drive { rates, clamp: None }
}

/// Outputs at the samples for these forces, by the formula of [`example::recorded`] evaluated number by number.
fn expected(start: f64, forces: &[f64]) -> Vec<f64> {
    let surrogate = example::recorded();
    let (weights, constants) = linear(&surrogate);
    let network = surrogate.program().graph.called().expect("it has a network");
    assert!(network.is_network());
    let (mut y, mut u) = ([start; 2], [0.25; 3]);
    let mut outputs = vec![start];
    for force in forces {
        u = [*force, u[0], u[1]];
        let z = [y[0], y[1], u[0], u[1], u[2], 1.5];
        let linear: f64 = weights.iter().zip(z).map(|(weight, z)| weight * z).sum();
        let network = network.evaluate(&[z.to_vec()]);
        y = [constants.get(0) + linear + network[0][0], y[0]];
        outputs.push(y[0]);
    }
    outputs
}

/// Weights and constants of its linear part.
fn linear(surrogate: &Surrogate) -> (Numbers, Numbers) {
    match &surrogate.program().graph.steps[0] {
        Step::Affine { weight, bias, .. } => (weight.clone(), bias.clone()),
        other => panic!("{other:?}"),
    }
}

fn output(evaluator: &mut Evaluator, point: &[f64]) -> f64 {
    let mut results = [0.0];
    evaluator.evaluate(point, &mut results);
    results[0]
}

const FORCES: [f64; 6] = [1.0, -0.5, 0.7, 2.0, 0.0, -1.0];

#[test]
fn steps_of_a_sample_a_part_of_it_and_several_give_the_same_outputs_at_samples() {
    let mut evaluator = Evaluator::new(&example::recorded());
    let expected = expected(0.4, &FORCES);
    assert!(expected.windows(2).all(|pair| (pair[0] - pair[1]).abs() > 1e-3), "{expected:?}");
    let none = vec![0.0; evaluator.columns()];
    // the sample time is 0.1 s; sums of these steps are not exactly multiples of it
    for (parts, size) in [(1, 0.1), (2, 0.05), (3, 0.1 / 3.0), (10, 0.01)] {
        let mut point = point(&evaluator, 0.4, 0.0);
        assert_eq!(output(&mut evaluator, &point), 0.4);
        for (k, force) in FORCES.iter().enumerate() {
            point[3] = *force;
            for part in 1..=parts {
                evaluator.advance(&mut point, CommunicationStep::of(size), drive([&none, &none])).unwrap();
                // linear between samples; what the input is there does not count
                point[3] = 100.0;
                let share = f64::from(part) / f64::from(parts);
                let line = expected[k] + share * (expected[k + 1] - expected[k]);
                let found = output(&mut evaluator, &point);
                assert!((found - line).abs() < 1e-12, "{parts} {k} {part}: {found} {line}");
            }
        }
    }
    // one step over all samples with an input that is held
    let mut point = point(&evaluator, 0.4, 1.0);
    let held = super::tests::expected(0.4, &[1.0; 6]);
    evaluator.advance(&mut point, CommunicationStep::of(0.6), drive([&none, &none])).unwrap();
    assert!((output(&mut evaluator, &point) - held[6]).abs() < 1e-12);
}

#[test]
fn inputs_follow_their_derivatives_at_samples_within_a_step_and_are_clamped() {
    let surrogate = example::recorded();
    let mut evaluator = Evaluator::new(&surrogate);
    let (mut first, mut second) = (vec![0.0; evaluator.columns()], vec![0.0; evaluator.columns()]);
    (first[3], second[3]) = (2.0, -8.0);
    let domain = Domain::new(surrogate.inputs(), surrogate.states());
    let at = |time: f64| -0.2 + 2.0 * time - 4.0 * time * time;
    for clamp in [None, Some(&domain)] {
        let mut point = point(&evaluator, 0.0, 0.0);
        point[3] = -0.2;
        let forces = [0.0, 0.1, 0.2, 0.3].map(|time| clamp.map_or(at(time), |domain| domain.clamp(3, at(time))));
        let with = Drive { rates: [&first, &second], clamp };
        evaluator.advance(&mut point, CommunicationStep::of(0.4), with).unwrap();
        let expected = expected(0.0, &forces);
        assert!((output(&mut evaluator, &point) - expected[4]).abs() < 1e-12);
    }
}

#[test]
fn steps_that_miss_samples_a_little_do_not_add_up() {
    let mut evaluator = Evaluator::new(&example::recorded());
    let none = vec![0.0; evaluator.columns()];
    let mut point = point(&evaluator, 0.4, 1.0);
    // ten million samples late by a tenth of a millionth each are a whole sample: a hundred are a hundred thousandth of one
    for _ in 0..100 {
        evaluator.advance(&mut point, CommunicationStep::of(0.1 * (1.0 + 1e-7)), drive([&none, &none])).unwrap();
    }
    let phase = *point.last().unwrap();
    assert!((phase - 1e-5).abs() < 1e-10, "{phase}");
}

#[test]
fn derivatives_are_those_of_the_line_between_samples() {
    let mut evaluator = Evaluator::new(&example::recorded());
    let none = vec![0.0; evaluator.columns()];
    let mut point = point(&evaluator, 0.4, 1.0);
    evaluator.advance(&mut point, CommunicationStep::of(0.125), drive([&none, &none])).unwrap();
    let direction: Vec<f64> =
        (0..point.len()).map(|k| if k + 1 < point.len() { 1.0 + k as f64 } else { 0.0 }).collect();
    let mut along = [0.0];
    evaluator.directional(&point, &direction, &mut along);
    let moved: Vec<f64> = point.iter().zip(&direction).map(|(value, rate)| value + 1e-3 * rate).collect();
    let slope = (output(&mut evaluator, &moved) - output(&mut evaluator, &point)) / 1e-3;
    assert!((along[0] - slope).abs() < 1e-9, "{along:?} {slope}");
    let mut gradient = vec![0.0; point.len()];
    evaluator.adjoint(&point, &[2.0], &mut gradient);
    let backwards: f64 = gradient.iter().zip(&direction).map(|(gradient, along)| gradient * along).sum();
    assert!((backwards - 2.0 * along[0]).abs() < 1e-12);
}

#[test]
fn outputs_that_diverge_are_an_error_and_the_memory_stays() {
    let surrogate = example::recorded();
    let Program { mut graph, clock } = surrogate.program().clone();
    let (weights, constants) = linear(&surrogate);
    let weights: Vec<f64> = [1e200].into_iter().chain(weights.iter().skip(1)).collect();
    graph.steps[0] = Step::Affine { of: 0, weight: weights.into(), bias: constants };
    let surrogate = Surrogate::new(surrogate.metadata().clone(), Program { graph, clock }).unwrap();
    let mut evaluator = Evaluator::new(&surrogate);
    let none = vec![0.0; evaluator.columns()];
    let mut point = point(&evaluator, 0.4, 1.0);
    let before = point.clone();
    let mut advance = |size| evaluator.advance(&mut point, CommunicationStep::of(size), drive([&none, &none]));
    assert!(matches!(advance(1.0), Err(StepError::NotFinite { after }) if (after - 0.2).abs() < 1e-12));
    assert!(matches!(advance(2e6), Err(StepError::TooManySteps)));
    assert_eq!(point, before);
}

/// [`example::cell`], one number after the other.
#[test]
fn hidden_states_go_on_as_outputs_do() {
    let surrogate = example::cell();
    let graph: &Graph = surrogate.program().graph.called().expect("it has a graph");
    let affine = |step: usize, x: &[f64; 5]| -> Vec<f64> {
        let Step::Affine { weight, bias, .. } = &graph.steps[step] else { panic!("it is affine") };
        let row = |output: usize| (0..5).map(|k| weight.get(5 * output + k) * x[k]).sum::<f64>() + bias.get(output);
        (0..3).map(row).collect()
    };
    let mut evaluator = Evaluator::new(&surrogate);
    let mut point = vec![1.5, 0.4, 0.0];
    point.resize(evaluator.columns(), 0.0);
    evaluator.start(&mut point);
    let none = vec![0.0; evaluator.columns()];
    let mut s = [0.4, 0.1, -0.2];
    for force in FORCES.iter().cycle().take(50) {
        point[2] = *force;
        let x = [s[0], s[1], s[2], *force, 1.5];
        let (gates, candidates) = (affine(0, &x), affine(2, &x));
        let new = |k: usize| candidates[k].tanh();
        s = std::array::from_fn(|k| new(k) + (s[k] - new(k)) / (1.0 + (-gates[k]).exp()));
        evaluator.advance(&mut point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
        let found = output(&mut evaluator, &point);
        assert!((found - s[0]).abs() < 1e-13, "{found} {}", s[0]);
    }
    assert!((s[1] - 0.1).abs() > 0.1, "hidden states move");
}

#[test]
fn an_output_follows_an_input_that_acts_directly_at_once() {
    let (direct, plain) = (example::direct(), example::supported());
    assert_eq!(Surrogate::from_bytes(&direct.to_bytes().unwrap()).unwrap(), direct);
    let mut evaluators = [&direct, &plain].map(Evaluator::new);
    let none = vec![0.0; evaluators[0].columns()];
    // the start is the output with the input there
    let mut points = [point(&evaluators[0], 0.4, 1.0), point(&evaluators[1], 0.2, 1.0)];
    assert_eq!(output(&mut evaluators[0], &points[0]), 0.4);
    for (k, force) in FORCES.into_iter().enumerate() {
        // measured for a while, each way
        for (place, (evaluator, point)) in evaluators.iter_mut().zip(&mut points).enumerate() {
            point[3] = force;
            let measured = 0.1 * k as f64 - 0.2 * force * place as f64;
            evaluator.measure(point, (k < 3).then_some(&[measured]));
        }
        let [found, expected] = std::array::from_fn(|place| output(&mut evaluators[place], &points[place]));
        assert!((found - (expected + 0.2 * force)).abs() < 1e-15, "{found} {expected}");
        let mut gradient = vec![0.0; evaluators[0].columns()];
        evaluators[0].adjoint(&points[0], &[1.0], &mut gradient);
        assert_eq!(gradient[3], 0.2);
        let mut derivative = [0.0];
        evaluators[0].directional(&points[0], &gradient, &mut derivative);
        assert_eq!(derivative[0], gradient.iter().map(|of| of * of).sum::<f64>());
        for (evaluator, point) in evaluators.iter_mut().zip(&mut points) {
            evaluator.advance(point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
        }
    }
}

#[test]
fn an_output_that_leaves_its_range_in_training_leaves_the_domain_though_inputs_are_in_theirs() {
    let surrogate = example::supported();
    assert_eq!(Surrogate::from_bytes(&surrogate.to_bytes().unwrap()).unwrap(), surrogate);
    let (mut evaluator, domain) = (Evaluator::new(&surrogate), Domain::of(&surrogate));
    let none = vec![0.0; evaluator.columns()];
    let mut point = point(&evaluator, 0.4, 0.3);
    assert!(domain.contains_point(&point, 0));
    let advance = |evaluator: &mut Evaluator, point: &mut [f64]| {
        evaluator.advance(point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
    };
    advance(&mut evaluator, &mut point);
    assert!(domain.contains_point(&point, 0), "{point:?}");
    // 2 m, where the training had 0.5 m at most
    evaluator.measure(&mut point, Some(&[2.0]));
    advance(&mut evaluator, &mut point);
    assert!(domain.is_in_ranges(&point) && !domain.contains_point(&point, 0));
    assert!(domain.distance(&point, 0) > 0.5 && domain.distance_derivative(&point).is_none());
}

/// [`example::recorded`] after measured positions, one number after the other: from the sample after the last of them on.
fn free_run(measured: &[f64], forces: &[f64]) -> Vec<f64> {
    let surrogate = example::recorded();
    let (weights, constants) = linear(&surrogate);
    let network = surrogate.program().graph.called().expect("it has a network");
    let (mut y, mut u) = ([0.4; 2], [0.25; 3]);
    let mut outputs = Vec::new();
    for (k, force) in forces.iter().enumerate() {
        u = [*force, u[0], u[1]];
        y[0] = measured.get(k).copied().unwrap_or(y[0]);
        let z = [y[0], y[1], u[0], u[1], u[2], 1.5];
        let linear: f64 = weights.iter().zip(z).map(|(weight, z)| weight * z).sum();
        y = [constants.get(0) + linear + network.evaluate(&[z.to_vec()])[0][0], y[0]];
        if k + 1 >= measured.len() {
            outputs.push(y[0]);
        }
    }
    outputs
}

#[test]
fn an_input_that_changes_at_each_sample_leaves_the_domain_though_each_change_is_in_its_range() {
    let surrogate = example::supported();
    let (mut evaluator, domain) = (Evaluator::new(&surrogate), Domain::of(&surrogate));
    let none = vec![0.0; evaluator.columns()];
    let mut inside = |period: usize| {
        let mut point = point(&evaluator, 0.39, 0.25);
        let mut rows = 0;
        for k in 0..40 {
            point[3] = if (k / period).is_multiple_of(2) { 0.3 } else { 0.05 };
            evaluator.advance(&mut point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
            rows += u32::from(domain.contains_point(&point, 0));
        }
        rows
    };
    // the change is 0.25 N; the average of changes, over ten samples, was at most 0.1 N
    assert_eq!(inside(10), 40);
    assert!((4..10).contains(&inside(1)), "{}", inside(1));
}

const MEASURED: [f64; 3] = [0.7, -0.2, 0.9];

#[test]
fn measured_outputs_replace_samples_while_they_are_used() {
    let mut evaluator = Evaluator::new(&example::recorded());
    let expected = free_run(&MEASURED, &FORCES);
    let unmeasured = free_run(&[], &FORCES);
    assert!((expected[0] - unmeasured[3]).abs() > 0.1 && (expected[3] - unmeasured[6 - 1]).abs() > 1e-2);
    let none = vec![0.0; evaluator.columns()];
    let measured = evaluator.measured_columns().unwrap();
    for parts in [1, 2, 5] {
        let mut point = point(&evaluator, 0.4, 0.0);
        let mut found = Vec::new();
        for (k, force) in FORCES.iter().enumerate() {
            point[3] = *force;
            point[measured.end] = f64::from(u8::from(k < MEASURED.len()));
            point[measured.start] = MEASURED.get(k).copied().unwrap_or(1e9);
            let before = output(&mut evaluator, &point);
            for part in 0..parts {
                evaluator
                    .advance(&mut point, CommunicationStep::of(0.1 / f64::from(parts)), drive([&none, &none]))
                    .unwrap();
                // between samples neither counts
                point[measured.start] = -1e9;
                point[measured.end] = f64::from(part % 2);
            }
            if let Some(measured) = MEASURED.get(k) {
                assert!((before - measured).abs() > 1e-3, "the output before is a prediction");
            }
            found.push(output(&mut evaluator, &point));
        }
        let errors = found[MEASURED.len() - 1..].iter().zip(&expected).map(|(a, b)| (a - b).abs());
        assert!(errors.fold(0.0, f64::max) < 1e-12, "{found:?} {expected:?}");
    }
}

#[test]
fn measured_outputs_follow_their_derivatives_at_samples_within_a_step() {
    let mut evaluator = Evaluator::new(&example::recorded());
    let measured = evaluator.measured_columns().unwrap();
    let (mut first, mut second) = (vec![0.0; evaluator.columns()], vec![0.0; evaluator.columns()]);
    (first[measured.start], second[measured.start]) = (2.0, -8.0);
    for (rates, line) in [([0.0, 0.0], [0.7; 4]), ([2.0, -8.0], [0.7, 0.86, 0.94, 0.94])] {
        (first[measured.start], second[measured.start]) = (rates[0], rates[1]);
        let mut point = point(&evaluator, 0.4, 1.0);
        (point[measured.start], point[measured.end]) = (0.7, 1.0);
        evaluator.advance(&mut point, CommunicationStep::of(0.4), drive([&first, &second])).unwrap();
        let found = output(&mut evaluator, &point);
        assert!((found - free_run(&line, &[1.0; 4])[0]).abs() < 1e-12, "{found}");
    }
    // what is too large for a number is an error, and the memory stays
    let mut point = point(&evaluator, 0.4, 1.0);
    (point[measured.start], point[measured.end]) = (f64::MAX, 1.0);
    (first[measured.start], second[measured.start]) = (f64::MAX, 0.0);
    let before = point.clone();
    let advanced = evaluator.advance(&mut point, CommunicationStep::of(20.0), drive([&first, &second]));
    assert!(matches!(advanced, Err(StepError::NotFinite { .. })));
    assert_eq!(point, before);
}

#[test]
fn a_correction_is_no_change_that_the_training_did_not_have_but_a_measured_value_outside_is_outside() {
    let surrogate = example::supported();
    let (mut evaluator, domain) = (Evaluator::new(&surrogate), Domain::of(&surrogate));
    let measured = evaluator.measured_columns().unwrap();
    let none = vec![0.0; evaluator.columns()];
    // positions of the training change by 0.05 m a sample and stay below 0.5 m; the prediction is 0.39 m
    for (value, is_inside) in [(0.2, true), (0.45, true), (0.7, false)] {
        let mut point = point(&evaluator, 0.4, 0.3);
        for _ in 0..5 {
            evaluator.advance(&mut point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
        }
        assert!(domain.contains_point(&point, 0));
        (point[measured.start], point[measured.end]) = (value, 1.0);
        evaluator.advance(&mut point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
        assert_eq!(domain.contains_point(&point, 0), is_inside, "{value} {}", domain.distance(&point, 0));
    }
}

#[test]
fn a_distance_ends_when_all_past_samples_are_measured() {
    let surrogate = example::supported();
    let (mut evaluator, domain) = (Evaluator::new(&surrogate), Domain::of(&surrogate));
    let none = vec![0.0; evaluator.columns()];
    let mut samples = |measured: Option<&[f64]>| {
        let mut point = point(&evaluator, 0.4, -0.6);
        let mut count = 0;
        for force in [-0.6, 0.3].into_iter().chain([0.3; 100]) {
            point[3] = force;
            evaluator.measure(&mut point, measured);
            evaluator.advance(&mut point, CommunicationStep::of(0.1), drive([&none, &none])).unwrap();
            count += u32::from(!domain.contains_point(&point, 0));
        }
        count
    };
    // the position jumps, then the force; three past forces count, that of the sample itself among them
    assert_eq!(samples(Some(&[0.39])), 2 + 2);
    assert!(samples(None) > 20);
}
