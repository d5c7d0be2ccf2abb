use super::*;
use metafmu_runtime::Precision;

#[test]
fn outputs_are_right_at_every_point_where_a_host_may_look() {
    for use_as in [Use::Steps, Use::StepsAndEvents] {
        let host = Host::of(&example::with_input(), use_as);
        let length = starts()[0];
        assert_eq!(host.try_get([LENGTH, SPEED]), Ok(starts()), "start values");
        assert_eq!(host.set(&[SPEED], &[1.0]), Status::Ok);
        assert_eq!(host.enter(0.25), Status::Ok);
        assert_eq!(host.outputs(), expected(length, 1.0, 0.25), "Initialization Mode");
        assert_eq!(host.exit(), Status::Ok);
        if use_as == Use::StepsAndEvents {
            assert_eq!(host.set(&[SPEED], &[2.0]), Status::Ok);
            assert_eq!(host.outputs(), expected(length, 2.0, 0.25), "fed through in Event Mode");
            assert_eq!((host.update(), host.step_mode()), (([0; 5], Status::Ok), Status::Ok));
        }
        assert_eq!(host.set(&[SPEED, LENGTH], &[3.0, 0.12]), Status::Ok);
        assert_eq!(host.outputs(), expected(0.12, 3.0, 0.25), "at once");
        assert_eq!(host.step_told(0.25, 0.5), (Status::Ok, [0; 3], 0.75));
        assert_eq!(host.outputs(), expected(0.12, 3.0, 0.75), "after a step");
        assert!(host.messages().is_empty());
    }
}

#[test]
fn a_solver_finds_right_outputs_at_every_point() {
    let host = Host::driven(Use::Solver);
    let length = starts()[0];
    assert_eq!((host.update(), host.continuous()), (([0; 5], Status::Ok), Status::Ok));
    for time in [0.5, 0.25, 9.0, 1.0] {
        assert_eq!(unsafe { fmi3SetTime(host.instance, time) }, Status::Ok);
        assert_eq!(host.set(&[SPEED], &[time]), Status::Ok);
        assert_eq!(host.outputs(), expected(length, time, time));
    }
    assert!(host.messages().is_empty(), "a solver tries what it likes");
    let (mut event, mut end) = (1, 1);
    assert_eq!(unsafe { fmi3CompletedIntegratorStep(host.instance, 1, &mut event, &mut end) }, Status::Ok);
    assert_eq!((event, end), (0, 0));
    assert!(host.message().contains("`speed`: changed from 2.5 to 1 during the run"));
    assert_eq!(host.event_mode(), Status::Ok);
    assert_eq!(host.continuous(), Status::Ok);
    assert_eq!(unsafe { fmi3SetTime(host.instance, 0.5) }, Status::Ok, "back across an event");
}

#[test]
fn numbers_of_states_and_indicators_are_zero() {
    let host = Host::in_state(Use::Solver, InstanceState::ContinuousTime);
    let (mut states, mut indicators) = (9, 9);
    unsafe {
        assert_eq!(fmi3GetNumberOfContinuousStates(host.instance, &mut states), Status::Ok);
        assert_eq!(fmi3GetNumberOfEventIndicators(host.instance, &mut indicators), Status::Ok);
        assert_eq!((states, indicators), (0, 0));
        assert_eq!(fmi3GetContinuousStates(host.instance, &mut 0.0, 1), Status::Error);
    }
    assert!(host.message().ends_with("1 elements, expected 0"));
}

#[test]
fn steps_that_make_no_sense_are_refused() {
    let (nan, infinity) = (f64::NAN, f64::INFINITY);
    for (from, size) in
        [(nan, 0.1), (infinity, 0.1), (0.0, nan), (0.0, infinity), (0.0, -0.1), (0.1, 0.1), (f64::MAX, f64::MAX)]
    {
        let host = Host::in_state(Use::Steps, InstanceState::Step);
        let (status, _, time) = host.step_told(from, size);
        assert_eq!((status, time), (Status::Error, 0.0), "{from} {size}");
        assert_eq!(host.try_get([TIME]), Ok([0.0]), "nothing changed");
    }
}

#[test]
fn a_null_result_of_a_step_is_an_error_before_time_passes() {
    for missing in 0..4 {
        let host = Host::in_state(Use::Steps, InstanceState::Step);
        let mut flags = [1; 3];
        let mut time = 0.0;
        let mut flag = |index: usize| if index == missing { null_mut() } else { &raw mut flags[index] };
        let (event, end, early) = (flag(0), flag(1), flag(2));
        let time = if missing == 3 { null_mut() } else { &raw mut time };
        assert_eq!(unsafe { fmi3DoStep(host.instance, 0.0, 0.5, 1, event, end, early, time) }, Status::Error);
        assert!(host.message().contains("is a null pointer"));
        assert_eq!(host.try_get([TIME]), Ok([0.0]));
    }
}

#[test]
fn null_results_of_an_update_are_errors() {
    for missing in 0..6 {
        let host = Host::in_state(Use::Solver, InstanceState::Event);
        let (mut flags, mut time) = ([1; 5], 1.0);
        let mut flag = |index: usize| if index == missing { null_mut() } else { &raw mut flags[index] };
        let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(&mut flag);
        let time = if missing == 5 { null_mut() } else { &raw mut time };
        assert_eq!(unsafe { fmi3UpdateDiscreteStates(host.instance, a, b, c, d, e, time) }, Status::Error);
        assert!(host.message().contains("is a null pointer"));
    }
}

#[test]
fn a_step_out_of_the_domain_is_discarded_and_can_be_tried_again() {
    let host = Host::in_state(Use::Steps, InstanceState::Step);
    assert_eq!(host.set_policy(2), Status::Ok);
    assert_eq!(host.step_told(0.0, 2.5), (Status::Discard, [0; 3], 0.0));
    assert!(host.message().contains("`time`: 2.5 is outside the training range from 0 to 2, and domain_policy is 2"));
    assert_eq!(host.step_told(0.0, 2.0), (Status::Ok, [0; 3], 2.0));
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Error);
}

#[test]
fn domain_variables_are_of_the_types_of_this_version() {
    let host = Host::driven(Use::Steps);
    let mut policy = -1;
    assert_eq!(unsafe { fmi3GetInt32(host.instance, &POLICY, 1, &mut policy, 1) }, Status::Ok);
    assert_eq!((policy, host.in_domain(), host.try_get([DISTANCE])), (0, 1, Ok([0.0])));
    assert_eq!(host.set(&[SPEED], &[7.5]), Status::Ok);
    assert_eq!((host.in_domain(), host.try_get([DISTANCE])), (0, Ok([0.5])));
    assert_eq!(host.set_policy(1), Status::Ok);
    assert_eq!(host.outputs(), expected(starts()[0], 5.0, 0.0));
}

#[test]
fn states_and_their_bytes_continue_to_the_last_bit() {
    let host = Host::driven(Use::Steps);
    assert_eq!(host.set(&[LENGTH, SPEED], &[0.123, 1.1]), Status::Ok);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    let state = host.save();
    let go_on = |host: &Host| {
        assert_eq!(host.step(0.1, 0.2), Status::Ok);
        host.outputs().map(f64::to_bits)
    };
    let first = go_on(&host);
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(go_on(&host), first);
    let (mut size, mut again) = (0, null_mut());
    let other = Host::of(&example::with_input(), Use::Steps);
    unsafe {
        assert_eq!(fmi3SerializedFMUStateSize(host.instance, state, &mut size), Status::Ok);
        let mut bytes = vec![0; size];
        assert_eq!(fmi3SerializeFMUState(host.instance, state, bytes.as_mut_ptr(), size), Status::Ok);
        assert_eq!(fmi3DeserializeFMUState(other.instance, bytes.as_ptr(), size, &mut again), Status::Ok);
        assert_eq!(other.restore(again), Status::Ok);
        assert_eq!(go_on(&other), first);
        let mut damaged = null_mut();
        for position in 0..size {
            bytes[position] ^= 0x41;
            let host = Host::of(&example::with_input(), Use::Steps);
            assert_eq!(fmi3DeserializeFMUState(host.instance, bytes.as_ptr(), size, &mut damaged), Status::Error);
            assert!(damaged.is_null());
            bytes[position] ^= 0x41;
        }
    }
    host.free_state(state);
    other.free_state(again);
}

#[test]
fn a_step_with_its_outputs_allocates_nothing() {
    for precision in [Precision::Double, Precision::Single] {
        for surrogate in
            [example::with_precision, example::per_instant].map(|of| of(&[128, 128], Activation::Tanh, precision))
        {
            let host = Host::of(&surrogate, Use::Steps);
            assert_eq!((host.enter(0.0), host.exit()), (Status::Ok, Status::Ok));
            assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
            let size = 1e-3;
            let before = allocations().0;
            for step in 0..1_000 {
                assert_eq!(host.step(f64::from(step) * size, size), Status::Ok);
                assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
                assert!(host.outputs()[0].is_finite() && host.in_domain() == 1);
            }
            assert_eq!(allocations().0, before);
        }
    }
}
