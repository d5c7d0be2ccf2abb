use super::*;

fn distance(host: &Host) -> f64 {
    let [distance] = host.try_get([DISTANCE]).unwrap();
    distance
}

#[test]
fn the_outputs_of_the_domain_follow_inputs_and_time() {
    let host = Host::driven();
    assert_eq!((host.in_domain(), distance(&host)), (true, 0.0));
    assert_eq!(host.set(&[SPEED], &[7.5]), Status::Warning);
    assert_eq!((host.in_domain(), distance(&host)), (false, 0.5), "at once");
    assert_eq!(host.set(&[SPEED], &[2.5]), Status::Ok);
    assert_eq!((host.in_domain(), distance(&host)), (true, 0.0));
    assert_eq!(host.step(0.0, 2.0 + 1e-10), Status::Ok);
    assert!(host.in_domain() && distance(&host) > 0.0, "rounding");
    assert_eq!(host.step(2.0, 1.0), Status::Warning);
    assert_eq!((host.in_domain(), distance(&host)), (false, 0.5));
}

#[test]
fn each_variable_is_warned_of_once_a_run() {
    let host = Host::driven();
    let statuses = [7.0, 8.0, 2.0, 9.0].map(|value| host.set(&[SPEED], &[value]));
    assert_eq!(statuses, [Status::Warning, Status::Ok, Status::Ok, Status::Ok]);
    assert!(
        host.message().contains("variable `speed`: 7 is outside the training range from 0 to 5; outputs are extra")
    );
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Warning);
    assert_eq!(host.reset(), Status::Ok);
    host.initialize(0.0);
    assert_eq!(host.set(&[SPEED], &[7.0]), Status::Warning);
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
    let host = Host::of_kind_in_state(MODEL_EXCHANGE, State::Event);
    assert_eq!(host.set_policy(2), Status::Ok);
    assert_eq!(host.go_on(), Status::Ok);
    assert_eq!(host.set_time(2.5), Status::Discard, "a solver may try a smaller step");
    assert_eq!(host.set_time(1.5), Status::Ok);
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
