use super::*;

impl Host {
    fn directional(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64]) -> Result<Vec<f64>, Status> {
        let mut found = vec![f64::NAN; unknowns.len()];
        let (nu, nk, out) = (unknowns.len(), knowns.len(), found.as_mut_ptr());
        let status = unsafe {
            fmi2GetDirectionalDerivative(self.c, unknowns.as_ptr(), nu, knowns.as_ptr(), nk, seed.as_ptr(), out)
        };
        if status == Status::Ok { Ok(found) } else { Err(status) }
    }

    fn output_derivatives(&self, references: &[u32], orders: &[c_int]) -> Result<Vec<f64>, Status> {
        let mut found = vec![f64::NAN; references.len()];
        let (n, out) = (references.len(), found.as_mut_ptr());
        match unsafe { fmi2GetRealOutputDerivatives(self.c, references.as_ptr(), n, orders.as_ptr(), out) } {
            Status::Ok => Ok(found),
            status => Err(status),
        }
    }

    fn drive(&self, orders: &[c_int], values: &[f64]) -> Status {
        let references = vec![SPEED; orders.len()];
        unsafe {
            fmi2SetRealInputDerivatives(self.c, references.as_ptr(), orders.len(), orders.as_ptr(), values.as_ptr())
        }
    }
}

fn close(found: &[f64], expected: &[f64], relative: f64) {
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= relative * expected.abs().max(1.0), "{found} {expected}");
    }
}

/// Differences of the outputs; exactness is tested where the derivatives are computed.
fn difference(point: [f64; 3], direction: [f64; 3]) -> [f64; 2] {
    let at = |h: f64| expected(point[0] + h * direction[0], point[1] + h * direction[1], point[2] + h * direction[2]);
    let h = 1e-5;
    let (above, below) = (at(h), at(-h));
    [0, 1].map(|output| (above[output] - below[output]) / (2.0 * h))
}

#[test]
fn directional_derivatives_are_of_outputs_with_respect_to_inputs_parameters_and_time() {
    for kind in [CO_SIMULATION, MODEL_EXCHANGE] {
        for state in [InstanceState::Initialization, InstanceState::Terminated] {
            let host = Host::of_kind_in_state(kind, state);
            let [length, speed] = starts();
            let point = [length, speed, 0.0];
            for direction in [[0.01, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 1.0], [0.01, 0.5, -1.0]] {
                let found = host.directional(&OUTPUTS, &[LENGTH, SPEED, TIME], &direction).unwrap();
                close(&found, &difference(point, direction), 1e-7);
            }
            let both = host.directional(&OUTPUTS, &[TIME], &[1.0]).unwrap();
            assert_eq!(
                host.directional(&[VELOCITY, ANGLE, VELOCITY], &[TIME], &[1.0]).unwrap(),
                [both[1], both[0], both[1]]
            );
            assert_eq!(host.directional(&OUTPUTS, &[TIME, TIME], &[0.75, 0.25]).unwrap(), both, "seeds add up");
            assert_eq!(host.directional(&[DISTANCE], &[LENGTH, TIME], &[1.0, 1.0]).unwrap(), [0.0], "inside");
            assert_eq!(host.directional(&[], &[], &[]), Ok(vec![]));
        }
    }
}

#[test]
fn outside_the_domain_clamped_directions_have_no_effect_on_outputs() {
    let host = Host::driven();
    assert_eq!(host.set_policy(1), Status::Ok);
    assert_eq!(host.set(&[SPEED], &[7.5]), Status::Ok);
    let seed = [0.01, 1.0, 1.0];
    let found = host.directional(&[ANGLE, VELOCITY, DISTANCE], &[LENGTH, SPEED, TIME], &seed).unwrap();
    close(&found[..2], &difference([starts()[0], 5.0, 0.0], [0.01, 0.0, 1.0]), 1e-7);
    assert_eq!(found[2], 0.2, "of a range that is 5 wide");
}

#[test]
fn what_has_no_derivative_is_refused_by_name() {
    for (unknown, known, what) in [
        (LENGTH, TIME, "`length` (value reference 1) is no continuous output, state or derivative of one"),
        (ANGLE, VELOCITY, "`velocity` (value reference 5) is no input, parameter, state or time"),
        (0, TIME, "value reference 0 is unknown"),
        (9, TIME, "value reference 9 is unknown"),
        (ANGLE, 0, "value reference 0 is unknown"),
        (ANGLE, u32::MAX, "value reference 4294967295 is unknown"),
    ] {
        let host = Host::stepping();
        assert_eq!(host.directional(&[unknown], &[known], &[1.0]), Err(Status::Error));
        let message = host.message();
        assert!(message.contains(what), "{message}");
    }
    let host = Host::stepping();
    assert_eq!(host.directional(&[ANGLE], &[TIME], &[f64::NAN]), Err(Status::Error));
    for null_argument in 0..4 {
        let host = Host::stepping();
        let is = |argument| argument == null_argument;
        let (unknown, known, seed, mut out) = (ANGLE, TIME, 1.0, 0.0);
        let status = unsafe {
            fmi2GetDirectionalDerivative(
                host.c,
                if is(0) { null() } else { &unknown },
                1,
                if is(1) { null() } else { &known },
                1,
                if is(2) { null() } else { &seed },
                if is(3) { null_mut() } else { &mut out },
            )
        };
        assert_eq!(status, Status::Error);
        assert!(host.message().contains("is a null pointer"));
    }
}

#[test]
fn output_derivatives_are_those_with_respect_to_time() {
    let host = Host::stepping();
    let [length, speed] = starts();
    assert_eq!(host.step(0.0, 0.75), Status::Ok);
    let found = host.output_derivatives(&[ANGLE, VELOCITY, ANGLE, VELOCITY, DISTANCE], &[1, 1, 2, 2, 1]).unwrap();
    close(&found[..2], &difference([length, speed, 0.75], [0.0, 0.0, 1.0]), 1e-8);
    let slope = |time| difference([length, speed, time], [0.0, 0.0, 1.0]);
    let (above, below) = (slope(0.75 + 1e-4), slope(0.75 - 1e-4));
    close(&found[2..4], &[0, 1].map(|output| (above[output] - below[output]) / 2e-4), 1e-5);
    assert_eq!(found[4], 0.0);
    for order in [0, -1, 3, c_int::MIN] {
        let host = Host::stepping();
        assert_eq!(host.output_derivatives(&[ANGLE], &[order]), Err(Status::Error));
        assert!(host.message().contains(&format!("order {order} are not available, expected 1 to 2")));
    }
    let host = Host::stepping();
    assert_eq!(host.output_derivatives(&[LENGTH], &[1]), Err(Status::Error));
}

#[test]
fn inputs_follow_their_derivatives_over_a_step() {
    let host = Host::driven();
    let length = starts()[0];
    assert_eq!(host.set(&[SPEED], &[2.0]), Status::Ok);
    assert_eq!(host.drive(&[1, 2], &[0.5, -0.25]), Status::Ok);
    assert_eq!(host.outputs(), expected(length, 2.0, 0.0), "they act over a step");
    assert_eq!((host.step(0.0, 1.0), host.warned()), (Status::Ok, true), "it is not constant during the run");
    assert_eq!(host.try_get([SPEED]), Ok([2.375]));
    assert_eq!(host.outputs(), expected(length, 2.375, 1.0));
    let found = host.output_derivatives(&OUTPUTS, &[1, 1]).unwrap();
    close(&found, &difference([length, 2.375, 1.0], [0.0, 0.25, 1.0]), 1e-8);
    let state = host.save();
    assert_eq!(host.drive(&[2, 1], &[0.0, 0.0]), Status::Ok);
    assert_eq!(host.step(1.0, 0.5), Status::Ok);
    assert_eq!(host.try_get([SPEED]), Ok([2.375]));
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(host.step(1.0, 1.0), Status::Ok);
    assert_eq!(host.try_get([SPEED]), Ok([2.375 + 0.25 - 0.125]), "part of the state");
    host.free_state(state);
    assert_eq!(host.reset(), Status::Ok);
    host.initialize(0.0);
    assert_eq!(host.step(0.0, 1.0), Status::Ok);
    assert_eq!(host.try_get([SPEED]), Ok([2.5]));
}

#[test]
fn only_inputs_have_derivatives_to_set() {
    for (reference, order, value, what) in [
        (LENGTH, 1, 0.0, "`length` (value reference 1) is no input"),
        (TIME, 1, 0.0, "`time` (value reference 3) is no input"),
        (ANGLE, 1, 0.0, "`angle` (value reference 4) is no input"),
        (SPEED, 0, 0.0, "order 0 are not available"),
        (SPEED, 3, 0.0, "order 3 are not available"),
        (SPEED, 1, f64::INFINITY, "inf is not finite"),
    ] {
        let host = Host::driven();
        assert_eq!(unsafe { fmi2SetRealInputDerivatives(host.c, &reference, 1, &order, &value) }, Status::Error);
        let message = host.message();
        assert!(message.contains(what), "{message}");
    }
    let host = Host::driven();
    assert_eq!(host.drive(&[1, 2], &[f64::MAX, f64::MAX]), Status::Ok);
    host.step(0.0, 1.0);
    host.step(1.0, 1.0);
    assert!(host.try_get([SPEED]).unwrap()[0].is_finite(), "an overflow does not make infinity an input");
}

#[test]
fn derivatives_allocate_nothing() {
    let host = Host::of(&example::with_network(&[128, 128], Activation::Tanh));
    host.initialize(0.0);
    let before = allocations().0;
    let mut out = [0.0; 2];
    for _ in 0..100 {
        unsafe {
            let c = host.c;
            let knowns = [LENGTH, TIME].as_ptr();
            let status =
                fmi2GetDirectionalDerivative(c, OUTPUTS.as_ptr(), 2, knowns, 2, [1.0; 2].as_ptr(), out.as_mut_ptr());
            assert_eq!(status, Status::Ok);
            let status = fmi2GetRealOutputDerivatives(c, OUTPUTS.as_ptr(), 2, [1, 2].as_ptr(), out.as_mut_ptr());
            assert_eq!(status, Status::Ok);
        }
    }
    assert_eq!(allocations().0, before);
}

#[test]
fn integers_booleans_and_constants_have_derivatives_of_zero() {
    let host = Host::stepping();
    let of_time = host.directional(&[ANGLE], &[TIME], &[1.0]).unwrap();
    assert_eq!(host.directional(&[IN_DOMAIN, ANGLE], &[TIME, POLICY], &[1.0, 1.0]), Ok(vec![0.0, of_time[0]]));
    let host = Host::of(&example::with_bounds());
    host.initialize(0.0);
    let bound = 11;
    let of_length = host.directional(&[ANGLE], &[LENGTH], &[1.0]).unwrap();
    assert_eq!(host.directional(&[bound, ANGLE], &[LENGTH], &[1.0]), Ok(vec![0.0, of_length[0]]));
}
