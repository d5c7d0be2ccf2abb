use super::*;

#[test]
fn a_solver_finds_right_outputs_at_every_point() {
    let host = Host::of_kind(&example::with_input(), MODEL_EXCHANGE);
    let length = starts()[0];
    host.set_up(0.25);
    assert_eq!(host.enter(), Status::Ok);
    assert_eq!(host.set(&[SPEED], &[1.0]), Status::Ok);
    assert_eq!(host.outputs(), expected(length, 1.0, 0.25), "Initialization Mode");
    assert_eq!(host.exit(), Status::Ok);
    assert_eq!(host.state(), InstanceState::Event);
    let mut info = EventInfo { values_of_continuous_states_changed: 1, ..EventInfo::default() };
    assert_eq!(unsafe { fmi2NewDiscreteStates(host.c, &mut info) }, Status::Ok);
    assert_eq!(info, EventInfo::default(), "nothing is left to do");
    assert_eq!(host.set(&[LENGTH], &[0.12]), Status::Ok, "a tunable parameter at an event");
    assert_eq!(host.outputs(), expected(0.12, 1.0, 0.25));
    assert_eq!(host.go_on(), Status::Ok);
    let (mut event, mut end);
    for time in [0.5, 0.4, 1.0, 0.75, 3.0, 1.5] {
        assert_eq!(host.set_time(time), Status::Ok);
        assert_eq!(host.set(&[SPEED], &[time]), Status::Ok);
        assert_eq!(host.outputs(), expected(0.12, time, time));
        (event, end) = (1, 1);
        // of the change of `speed`, and of the training range's end
        let warned = time == 0.5 || time == 3.0;
        let status = unsafe { fmi2CompletedIntegratorStep(host.c, 1, &mut event, &mut end) };
        assert_eq!((status, host.warned()), (Status::Ok, warned), "{time}");
        assert_eq!((event, end), (0, 0));
    }
    assert_eq!(unsafe { fmi2EnterEventMode(host.c) }, Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 1.5, 1.5));
    assert_eq!(host.go_on(), Status::Ok);
    assert_eq!(host.terminate(), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 1.5, 1.5));
}

#[test]
fn a_solver_may_look_past_the_stop_time_and_back() {
    let host = Host::of_kind(&example::surrogate(), MODEL_EXCHANGE);
    assert_eq!(host.set_up_until(0.0, 1.0), Status::Ok);
    assert_eq!((host.enter(), host.exit(), host.go_on()), (Status::Ok, Status::Ok, Status::Ok));
    assert_eq!(host.set_time(1.25), Status::Ok);
    assert_eq!(host.set_time(0.5), Status::Ok);
    assert_eq!(unsafe { fmi2EnterEventMode(host.c) }, Status::Ok);
    assert_eq!(host.go_on(), Status::Ok);
    for time in [0.5 - 1e-13, -1e-6, 0.4] {
        assert_eq!(host.set_time(time), Status::Ok, "{time}");
        assert_eq!(host.outputs(), expected(starts()[0], starts()[1], time));
    }
    assert!(host.messages().is_empty());
    for time in [f64::NAN, f64::INFINITY] {
        let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::ContinuousTime);
        assert_eq!(host.set_time(time), Status::Error, "{time}");
    }
}

#[test]
fn a_solver_may_try_values_of_tunable_parameters() {
    let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::ContinuousTime);
    assert_eq!(host.set(&[LENGTH], &[0.12]), Status::Ok, "tunable");
    assert_eq!(host.outputs(), expected(0.12, starts()[1], 0.0));
    assert_eq!((host.set(&[LENGTH], &[9.0]), host.messages().len()), (Status::Ok, 0), "only tried");
    assert_eq!((host.complete(), host.warned()), (Status::Ok, true), "accepted");
    assert_eq!(host.set(&[SPEED], &[1.0]), Status::Error);
    assert!(
        host.message().contains("`speed` (value reference 2) is fixed and cannot be set in state `Continuous-Time")
    );
}

#[test]
fn a_fixed_parameter_waits_for_the_simulation_unless_no_time_has_passed() {
    let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::Event);
    assert_eq!(host.set(&[SPEED], &[1.0]), Status::Ok, "as in the initialization");
    assert_eq!(host.outputs(), expected(starts()[0], 1.0, 0.0));
    assert_eq!((host.go_on(), host.set_time(0.5), host.event()), (Status::Ok, Status::Ok, Status::Ok));
    assert_eq!((host.set(&[SPEED], &[1.0]), host.messages().len()), (Status::Ok, 0), "unchanged");
    assert_eq!(host.set(&[SPEED], &[2.0]), Status::Error);
    assert!(host.message().contains("`speed` (value reference 2) is fixed and cannot be set in state `Event Mode`"));
    assert!(host.in_domain());
}

#[test]
fn a_host_that_never_completes_a_step_is_refused_by_the_policy_as_well() {
    let host = Host::of_kind(&example::surrogate(), MODEL_EXCHANGE);
    assert_eq!((host.set_up_until(0.0, 2.0), host.enter(), host.exit()), (Status::Ok, Status::Ok, Status::Ok));
    assert_eq!((host.set(&[POLICY], &[2.0]), host.go_on()), (Status::Ok, Status::Ok));
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok, "only tried");
    // a solver that repeats its steps goes back
    for repeated in 1..=3 {
        let mut tried = (1..=1000).map(|step| host.set_time(f64::from(step) * 1e-3));
        assert!(tried.all(|status| status == Status::Ok), "{repeated}");
    }
    assert_eq!(host.set_time(1.001), Status::Error);
    assert!(host.message().contains("`length`: 9 is outside the training range"));
}

#[test]
fn there_are_no_states_and_no_indicators() {
    type Vector = unsafe extern "C" fn(*mut c_void, *mut f64, usize) -> Status;
    let functions: [Vector; 4] =
        [fmi2GetDerivatives, fmi2GetEventIndicators, fmi2GetContinuousStates, fmi2GetNominalsOfContinuousStates];
    for function in functions {
        let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::ContinuousTime);
        assert_eq!(unsafe { function(host.c, null_mut(), 0) }, Status::Ok);
        assert_eq!(unsafe { function(host.c, &mut 0.0, 1) }, Status::Error);
        assert!(host.message().ends_with("1 elements, expected 0"));
    }
    let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::ContinuousTime);
    assert_eq!(unsafe { fmi2SetContinuousStates(host.c, &0.0, 1) }, Status::Error);
}

#[test]
fn null_results_are_refused() {
    let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::Event);
    assert_eq!(unsafe { fmi2NewDiscreteStates(host.c, null_mut()) }, Status::Error);
    let mut flag = 1;
    for (event, end) in [(null_mut(), &raw mut flag), (&raw mut flag, null_mut())] {
        let host = Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::ContinuousTime);
        assert_eq!(unsafe { fmi2CompletedIntegratorStep(host.c, 1, event, end) }, Status::Error);
    }
}

#[test]
fn a_state_of_the_other_interface_is_foreign() {
    let (stepping, exchanging) =
        (Host::stepping(), Host::of_kind_in_state(MODEL_EXCHANGE, InstanceState::ContinuousTime));
    let state = exchanging.save();
    assert_eq!(stepping.restore(state), Status::Error);
    assert!(stepping.message().contains("to another FMI version or interface"));
    assert_eq!(stepping.deserialize(&exchanging.serialize(state)), Err(Status::Error));
    exchanging.set_time(1.0);
    assert_eq!(exchanging.restore(state), Status::Ok);
    assert_eq!((exchanging.try_get([TIME]), exchanging.state()), (Ok([0.0]), InstanceState::ContinuousTime));
    exchanging.free_state(state);
}
