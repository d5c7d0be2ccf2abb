use super::*;

fn distance(host: &Host) -> f64 {
    let [distance] = host.try_get([DISTANCE]).unwrap();
    distance
}

#[test]
fn the_outputs_of_the_domain_follow_inputs_and_time() {
    let host = Host::driven();
    assert_eq!((host.in_domain(), distance(&host)), (true, 0.0));
    assert_eq!((host.set(&[SPEED], &[7.5]), host.warned()), (Status::Ok, true));
    assert_eq!((host.in_domain(), distance(&host)), (false, 0.5), "at once");
    assert_eq!(host.set(&[SPEED], &[2.5]), Status::Ok);
    assert_eq!((host.in_domain(), distance(&host)), (true, 0.0));
    assert_eq!(host.step(0.0, 2.0 + 1e-10), Status::Ok);
    assert!(host.in_domain() && distance(&host) > 0.0, "rounding");
    assert_eq!((host.step(2.0, 1.0), host.warned()), (Status::Ok, true));
    assert_eq!((host.in_domain(), distance(&host)), (false, 0.5));
}

#[test]
fn leaving_the_domain_is_logged_once_a_run_for_each_variable_and_returns_ok() {
    let host = Host::driven();
    let statuses = [7.0, 8.0, 2.0, 9.0].map(|value| host.set(&[SPEED], &[value]));
    assert_eq!(statuses, [Status::Ok; 4]);
    assert!(
        host.message().contains("variable `speed`: 7 is outside the training range from 0 to 5; outputs are extra")
    );
    assert_eq!((host.set(&[LENGTH], &[9.0]), host.warned()), (Status::Ok, true));
    assert_eq!(host.reset(), Status::Ok);
    host.initialize(0.0);
    assert_eq!((host.set(&[SPEED], &[7.0]), host.warned()), (Status::Ok, true));
}

#[test]
fn clamping_computes_at_the_border() {
    let host = Host::driven();
    assert_eq!(host.set_policy(1), Status::Ok);
    assert_eq!(host.set(&[LENGTH, SPEED], &[0.25, -5.0]), Status::Ok);
    assert_eq!(host.step(0.0, 3.0), Status::Ok);
    assert_eq!(host.outputs(), expected(0.2, 0.0, 2.0));
    assert_eq!(host.try_get([LENGTH, SPEED, TIME]), Ok([0.25, -5.0, 3.0]), "what was set is kept");
    assert_eq!((host.in_domain(), distance(&host)), (false, 1.0));
    assert_eq!(host.set_policy(0), Status::Ok);
    assert_eq!(host.outputs(), expected(0.25, -5.0, 3.0), "at once");
}

#[test]
fn the_policy_to_refuse_lets_nothing_leave_the_domain() {
    let refused = |leave: &dyn Fn(&Host) -> Status, what: &str| {
        let host = Host::driven();
        assert_eq!(host.set_policy(2), Status::Ok);
        let before = host.outputs();
        assert_eq!(leave(&host), Status::Error);
        let message = host.message();
        assert!(message.contains(what) && message.ends_with("domain_policy is 2"), "{message}");
        assert_eq!((host.outputs(), host.in_domain()), (before, true), "nothing changed");
    };
    refused(
        &|host| host.set(&[SPEED, LENGTH], &[1.0, 0.21]),
        "`length`: 0.21 is outside the training range from 0.1 to",
    );
    refused(&|host| host.step(0.0, 2.1), "`time`: 2.1");
    refused(
        &|host| {
            assert_eq!(unsafe { fmi2SetRealInputDerivatives(host.c, &SPEED, 1, &1, &3.0) }, Status::Ok);
            host.step(0.0, 1.0)
        },
        "`speed`: 5.5",
    );
    let host = Host::driven();
    host.set(&[LENGTH], &[9.0]);
    host.messages();
    assert_eq!(host.set_policy(2), Status::Error, "what is outside already");
    assert!(host.message().contains("`length`: 9"));
    let host = Host::new();
    assert_eq!(host.set_policy(2), Status::Ok);
    assert_eq!(host.set_up_until(-1.0, 1.0), Status::Error);
}

#[test]
fn that_no_data_are_near_is_said_where_the_inputs_are_used() {
    let surrogate = example::with_cover(&example::surrogate());
    let host = Host::of(&surrogate);
    host.initialize(0.0);
    // from where both are low to where both are high, by a point that is neither
    assert_eq!([host.set(&[LENGTH], &[0.12]), host.step(0.0, 0.1)], [Status::Ok; 2]);
    assert_eq!(host.set(&[LENGTH], &[0.19]), Status::Ok);
    assert!(host.warned(), "that it changes is another matter");
    let host = Host::of(&surrogate);
    host.set_up(0.0);
    assert_eq!([host.set(&[LENGTH], &[0.12]), host.set(&[SPEED], &[4.5]), host.enter()], [Status::Ok; 3]);
    assert_eq!((host.in_domain(), (100.0 * distance(&host)).round()), (false, 30.0));
    assert_eq!(host.exit(), Status::Ok);
    assert!(host.message().contains("the inputs are in their ranges, but 0.300 of the ranges away"), "once a run");
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    // policy 2 refuses to use them, and not to set one after the other
    let host = Host::of(&surrogate);
    host.set_up(0.0);
    assert_eq!([host.set_policy(2), host.enter(), host.set(&[LENGTH], &[0.12])], [Status::Ok; 3]);
    assert_eq!([host.set(&[SPEED], &[4.5]), host.set(&[LENGTH], &[0.19]), host.exit()], [Status::Ok; 3]);
    assert_eq!((host.step(0.0, 0.1), host.in_domain()), (Status::Ok, true));
    let host = Host::of(&surrogate);
    host.set_up(0.0);
    assert_eq!([host.set_policy(2), host.set(&[SPEED], &[4.5]), host.set(&[LENGTH], &[0.12])], [Status::Ok; 3]);
    assert_eq!([host.enter(), host.exit()], [Status::Ok, Status::Error]);
    assert!(host.message().ends_with("domain_policy is 2"));
}

#[test]
fn what_a_solver_tries_outside_the_domain_is_neither_refused_nor_warned_of() {
    for policy in [0, 1, 2] {
        let host = Host::solving();
        assert_eq!((host.event(), host.set_policy(policy), host.go_on()), (Status::Ok, Status::Ok, Status::Ok));
        for (time, speed) in [(0.5, 2.5), (9.0, 2.5), (0.25, 7.0), (3.81, -1.0), (0.5, 2.5)] {
            assert_eq!((host.set_time(time), host.set(&[SPEED], &[speed])), (Status::Ok, Status::Ok));
            assert_eq!(host.in_domain(), (time, speed) == (0.5, 2.5));
        }
        assert_eq!((host.complete(), host.event(), host.in_domain()), (Status::Ok, Status::Ok, true));
        assert!(host.messages().is_empty());
    }
}

#[test]
fn leaving_the_domain_is_said_where_a_solver_accepts_a_step_or_an_event_begins() {
    let accept: [fn(&Host) -> Status; 2] = [Host::complete, Host::event];
    for accept in accept {
        let host = Host::solving();
        assert_eq!(host.set_time(2.5), Status::Ok);
        assert_eq!(accept(&host), Status::Ok);
        assert!(host.message().contains("variable `time`: 2.5 is outside the training range from 0 to 2; outputs are"));
        assert_eq!(host.outputs(), expected(starts()[0], 2.5, 2.5));
    }
}

#[test]
fn the_policy_to_refuse_ends_a_run_where_a_solver_accepts_a_step_outside() {
    let accept: [fn(&Host) -> Status; 2] = [Host::complete, Host::event];
    for accept in accept {
        let host = Host::solving();
        assert_eq!((host.event(), host.set_policy(2), host.go_on()), (Status::Ok, Status::Ok, Status::Ok));
        assert_eq!((host.set_time(2.5), accept(&host)), (Status::Ok, Status::Error));
        assert!(
            host.message().contains("`time`: 2.5 is outside the training range from 0 to 2, and domain_policy is 2")
        );
    }
}

#[test]
fn a_parameter_or_an_input_that_changes_during_a_run_is_warned_of_once_and_leaves_the_domain_until_a_reset() {
    for (reference, name, values) in [(LENGTH, "length", [0.15000000000000002, 0.12]), (SPEED, "speed", [2.5, 1.0])] {
        let host = Host::driven();
        assert_eq!(host.set(&[reference], &[0.19]), Status::Ok, "the run has not begun to go on");
        assert_eq!(host.set(&[reference], &[values[0]]), Status::Ok);
        assert_eq!(host.step(0.0, 0.5), Status::Ok);
        assert_eq!((host.set(&[reference], &[values[0]]), host.in_domain()), (Status::Ok, true), "no change");
        assert_eq!((host.set(&[reference], &[values[1]]), host.in_domain()), (Status::Ok, false));
        let says = format!(
            "variable `{name}`: changed from {} to {} during the run; outputs are those of a run that has had {} since its \
             start (said once a run)",
            values[0], values[1], values[1]
        );
        let message = host.message();
        assert!(message.ends_with(&says), "{message}");
        assert_eq!(
            (host.set(&[reference], &[values[0]]), host.in_domain()),
            (Status::Ok, false),
            "it has been changed"
        );
        assert_eq!((host.set(&[LENGTH], &[0.11]), host.step(0.5, 0.5)), (Status::Ok, Status::Ok));
        assert_eq!(distance(&host), 0.0);
        assert!(host.messages().is_empty());
        let state = host.save();
        assert_eq!(host.reset(), Status::Ok);
        host.initialize(0.0);
        assert!(host.in_domain());
        assert_eq!((host.restore(state), host.in_domain()), (Status::Ok, false), "part of the state");
        let bytes = host.serialize(state);
        let other = Host::driven();
        let again = other.deserialize(&bytes).unwrap();
        assert_eq!((other.restore(again), other.in_domain()), (Status::Ok, false), "also as bytes");
        other.free_state(again);
        host.free_state(state);
    }
}

#[test]
fn an_input_that_follows_a_derivative_changes_during_the_run() {
    let host = Host::driven();
    assert_eq!(unsafe { fmi2SetRealInputDerivatives(host.c, &SPEED, 1, &1, &1.0) }, Status::Ok);
    assert_eq!((host.step(0.0, 0.5), host.in_domain()), (Status::Ok, false));
    assert!(host.message().contains("variable `speed`: changed from 2.5 to 3 during the run"));
}

#[test]
fn an_input_that_changes_in_model_exchange_is_warned_of_where_a_step_is_accepted() {
    let host = Host::solving();
    assert_eq!((host.set(&[SPEED], &[1.0]), host.set_time(0.5)), (Status::Ok, Status::Ok), "at the start time");
    assert_eq!((host.complete(), host.in_domain()), (Status::Ok, true));
    assert_eq!((host.set(&[SPEED], &[2.0]), host.in_domain()), (Status::Ok, false));
    assert_eq!((host.set(&[SPEED], &[1.0]), host.in_domain()), (Status::Ok, true), "it was a trial");
    assert_eq!((host.set(&[SPEED], &[3.0]), host.complete()), (Status::Ok, Status::Ok));
    assert!(host.message().contains("variable `speed`: changed from 1 to 3 during the run"));
    assert_eq!((host.set(&[SPEED], &[1.0]), host.complete(), host.in_domain()), (Status::Ok, Status::Ok, false));
}

#[test]
fn the_policy_to_refuse_lets_nothing_change_during_a_run() {
    let host = Host::driven();
    assert_eq!(
        (host.set_policy(2), host.set(&[LENGTH], &[0.12]), host.step(0.0, 0.5)),
        (Status::Ok, Status::Ok, Status::Ok)
    );
    assert_eq!(host.set(&[LENGTH], &[0.13]), Status::Error);
    assert!(
        host.message().contains("`length`: 0.13 instead of 0.12 as at the start of the run, and domain_policy is 2")
    );
    let host = Host::driven();
    assert_eq!((host.step(0.0, 0.5), host.set(&[LENGTH], &[0.12]), host.warned()), (Status::Ok, Status::Ok, true));
    assert_eq!(host.set(&[LENGTH], &[starts()[0]]), Status::Ok);
    host.messages();
    assert_eq!(host.set_policy(2), Status::Error);
    assert!(host.message().contains("have been changed during the run, which domain_policy 2 forbids"));
}

#[test]
fn without_a_time_of_its_own_the_surrogate_follows_every_change() {
    let surrogate = example::with_input();
    let mut metadata = surrogate.metadata().clone();
    (metadata.inputs[2].name, metadata.inputs[2].role) = ("load".into(), metadata.inputs[0].role);
    let host = Host::of(&Surrogate::new(metadata, surrogate.program().clone()).unwrap());
    host.initialize(0.0);
    assert_eq!((host.step(0.0, 0.5), host.set(&[LENGTH, SPEED], &[0.12, 1.0])), (Status::Ok, Status::Ok));
    assert_eq!((host.in_domain(), host.messages().len()), (true, 0));
}

#[test]
fn the_policy_is_a_tunable_parameter_of_three_values() {
    let host = Host::stepping();
    let get = || {
        let mut value = -1;
        assert_eq!(unsafe { fmi2GetInteger(host.c, &POLICY, 1, &mut value) }, Status::Ok);
        value
    };
    assert_eq!(get(), 0);
    for policy in [1, 2, 0] {
        assert_eq!(host.set_policy(policy), Status::Ok);
        assert_eq!(get(), policy);
    }
    for policy in [-1, 3, c_int::MAX] {
        let host = Host::stepping();
        assert_eq!(host.set_policy(policy), Status::Error);
        assert!(
            host.message().contains(&format!("`domain_policy`: {policy}, expected 0 (warn), 1 (clamp) or 2 (error)"))
        );
    }
    let host = Host::stepping();
    assert_eq!(host.set_policy(1), Status::Ok);
    let state = host.save();
    assert_eq!(host.reset(), Status::Ok);
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok, "part of the state");
    host.free_state(state);
}

/// With `length` one of 0.14, 0.1 and 0.2, and `speed` periodic.
fn encoded() -> Host {
    let host = Host::of(&example::encoded(&example::surrogate()));
    host.initialize(0.0);
    host
}

#[test]
fn a_nominal_parameter_takes_its_values_and_else_the_nearest_one() {
    let host = encoded();
    let at = |length: f64| {
        assert_ne!(host.set(&[LENGTH], &[length]), Status::Error);
        host.outputs()
    };
    assert_eq!(host.try_get([LENGTH]), Ok([0.14]));
    let [middle, least, most] = [0.14, 0.1, 0.2].map(at);
    assert!(middle != least && least != most && host.in_domain());
    assert_eq!(host.messages().len(), 0);
    assert_eq!(at(0.18), most);
    let message = host.message();
    let says = "`length`: 0.18 is outside the trained values 0.14, 0.1, 0.2; outputs are those of the nearest (said";
    assert!(message.contains(says), "{message}");
    assert_eq!((host.in_domain(), (10.0 * distance(&host)).round()), (false, 2.0));
    assert_eq!(host.set_policy(1), Status::Ok);
    assert_eq!((at(0.13), host.try_get([LENGTH])), (middle, Ok([0.13])));
    assert_eq!((at(0.1), host.set_policy(2)), (least, Status::Ok));
    host.messages();
    assert_eq!(host.set(&[LENGTH], &[0.15]), Status::Error);
    assert!(host.message().contains("`length`: 0.15 is outside the trained values 0.14, 0.1, 0.2, and domain_policy"));
}

#[test]
fn a_periodic_parameter_is_never_outside() {
    let outputs = [1.25, 6.25, -3.75, 5001.25].map(|speed| {
        let host = Host::of(&example::encoded(&example::surrogate()));
        assert_eq!(host.set_policy(2), Status::Ok);
        assert_eq!(host.set(&[SPEED], &[speed]), Status::Ok);
        host.initialize(0.0);
        assert_eq!((host.in_domain(), distance(&host), host.messages().len()), (true, 0.0, 0));
        host.outputs()
    });
    assert!(outputs.iter().all(|found| *found == outputs[0]), "{outputs:?}");
}

#[test]
fn a_step_with_encoded_inputs_does_not_allocate() {
    let host = encoded();
    let (before, _) = allocations();
    for step in 0..10 {
        host.step(0.1 * f64::from(step), 0.1);
        host.outputs();
    }
    assert_eq!(allocations().0, before);
}
