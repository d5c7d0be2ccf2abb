use super::*;

#[test]
fn outputs_are_right_at_every_point_where_a_host_may_look() {
    let host = Host::new();
    let [length, speed] = starts();
    host.set_up(0.25);
    assert_eq!(host.enter(), Status::Ok);
    assert_eq!(host.outputs(), expected(length, speed, 0.25), "start values");
    assert_eq!(host.set(&[SPEED, LENGTH], &[4.0, 0.12]), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 4.0, 0.25), "after a set in Initialization Mode");
    assert_eq!(host.exit(), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 4.0, 0.25), "at the start time");
    assert_eq!(host.step(0.25, 0.5), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 4.0, 0.75), "after a step");
    assert_eq!(host.set(&[LENGTH], &[0.18]), Status::Ok);
    assert!(host.message().contains("`length`: changed from 0.12 to 0.18 during the run"));
    assert_eq!(host.outputs(), expected(0.18, 4.0, 0.75), "after a set between steps");
    assert_eq!(host.step(0.75, 0.01), Status::Ok);
    assert_eq!(host.try_get([VELOCITY, LENGTH, TIME, SPEED, ANGLE]), {
        let [angle, velocity] = expected(0.18, 4.0, 0.76);
        Ok([velocity, 0.18, 0.76, 4.0, angle])
    });
    assert_eq!(host.terminate(), Status::Ok);
    assert_eq!(host.outputs(), expected(0.18, 4.0, 0.76), "after the end");
    assert!(host.messages().is_empty());
}

#[test]
fn parameters_set_before_initialization_count() {
    let host = Host::new();
    assert_eq!(host.set(&[LENGTH, SPEED], &[0.11, 1.0]), Status::Ok);
    host.initialize(0.0);
    assert_eq!(host.outputs(), expected(0.11, 1.0, 0.0));
}

#[test]
fn what_cannot_be_set_is_refused_by_name() {
    let refused = |reference: u32| {
        let host = Host::stepping();
        assert_eq!(host.step(0.0, 0.1), Status::Ok);
        assert_eq!(host.set(&[reference], &[1.0]), Status::Error);
        host.message()
    };
    assert!(refused(SPEED).contains("`speed` (value reference 2) is fixed and cannot be set in state `Step Mode`"));
    assert!(refused(TIME).contains("`time` (value reference 3) is the independent variable"));
    assert!(refused(ANGLE).contains("`angle` (value reference 4) is an output"));
    assert!(refused(0).contains("value reference 0 is unknown: no variable has it"));
    assert!(refused(9).contains("value reference 9 is unknown, expected at most 8"));
    assert!(refused(u32::MAX).contains("value reference 4294967295 is unknown"));
    let host = Host::stepping();
    assert_eq!((host.step(0.0, 0.1), host.set(&[TIME], &[0.1])), (Status::Ok, Status::Ok), "the present time");
    for reference in [TIME, ANGLE, 0, 9] {
        assert_eq!(Host::new().set(&[reference], &[1.0]), Status::Error, "{reference} in instantiated");
    }
}

#[test]
fn a_value_that_is_not_finite_is_refused() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let host = Host::new();
        assert_eq!(host.set(&[LENGTH], &[value]), Status::Error);
        assert!(host.message().contains(&format!("`length` (value reference 1): {value} is not finite")));
    }
}

#[test]
fn a_call_with_one_wrong_value_changes_nothing_at_all() {
    for (reference, value) in
        [(SPEED, 1.0), (TIME, 1.0), (ANGLE, 1.0), (0, 1.0), (9, 1.0), (POLICY, 7.0), (LENGTH, f64::NAN)]
    {
        let host = Host::stepping();
        assert_eq!(host.step(0.0, 0.1), Status::Ok);
        let before = host.outputs();
        assert_eq!(host.set(&[LENGTH, reference], &[0.19, value]), Status::Error);
        assert_eq!((host.try_get([LENGTH]), host.outputs()), (Ok([starts()[0]]), before));
    }
}

#[test]
fn an_unknown_value_reference_cannot_be_read() {
    for reference in [0, 9, u32::MAX] {
        let host = Host::stepping();
        assert_eq!(host.try_get([ANGLE, reference]), Err(Status::Error));
        assert!(host.message().contains(&format!("fmi2GetReal: value reference {reference} is unknown")));
    }
}

#[test]
fn arrays_are_for_the_other_version_and_unknown_here() {
    let refused = |call: &dyn Fn(*mut c_void) -> Status, reference: u32| {
        let host = Host::of(&example::with_arrays());
        host.initialize(0.0);
        assert_eq!(host.outputs(), expected(starts()[0], starts()[1], 0.0));
        assert_eq!(call(host.c), Status::Error);
        let message = host.message();
        let unknown = format!("value reference {reference} is unknown, expected at most 8");
        assert!(message.ends_with(&unknown), "{message}");
    };
    for reference in [9, 10, 11, 12] {
        unsafe {
            refused(&|c| fmi2GetReal(c, &reference, 1, &mut 0.0), reference);
            refused(&|c| fmi2SetReal(c, &reference, 1, &0.0), reference);
            refused(&|c| fmi2GetInteger(c, &reference, 1, &mut 0), reference);
            refused(&|c| fmi2GetDirectionalDerivative(c, &reference, 1, &LENGTH, 1, &1.0, &mut 0.0), reference);
            refused(&|c| fmi2GetRealOutputDerivatives(c, &reference, 1, &1, &mut 0.0), reference);
        }
    }
}

#[test]
fn an_error_bound_is_a_constant_that_can_be_read_only() {
    let host = Host::of(&example::with_bounds());
    host.initialize(0.0);
    assert_eq!(host.try_get([12, 11]), Ok([0.25, 0.125]));
    assert_eq!(host.try_get([11, ANGLE, 12]), Ok([0.125, host.outputs()[0], 0.25]));
    let refused = |call: &dyn Fn(*mut c_void) -> Status, says: &str| {
        let host = Host::of(&example::with_bounds());
        host.initialize(0.0);
        assert_eq!(call(host.c), Status::Error);
        let message = host.message();
        assert!(message.ends_with(says), "{message}");
    };
    unsafe {
        let bound = "variable `x_bound` (value reference 11) is";
        refused(&|c| fmi2SetReal(c, &11, 1, &0.0), &format!("{bound} computed and cannot be set"));
        refused(&|c| fmi2GetBoolean(c, &11, 1, &mut 0), &format!("{bound} of type real, not Boolean"));
        refused(&|c| fmi2GetReal(c, &13, 1, &mut 0.0), "value reference 13 is unknown, expected at most 12");
        refused(&|c| fmi2GetReal(c, &10, 1, &mut 0.0), "value reference 10 is unknown: no variable has it");
    }
}

#[test]
fn a_parameter_outside_its_training_range_is_accepted_with_a_warning() {
    let host = Host::stepping();
    assert_eq!(host.set(&[LENGTH], &[0.2 * (1.0 + 1e-12)]), Status::Ok, "rounding");
    assert_eq!(host.set(&[LENGTH], &[0.25]), Status::Ok);
    let message = host.message();
    assert!(message.contains("`length`: 0.25 is outside the training range from 0.1 to 0.2"), "{message}");
    assert_eq!(host.outputs(), expected(0.25, starts()[1], 0.0));
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
}

#[test]
fn integers_and_booleans_can_be_read_and_set_as_reals() {
    let host = Host::in_state(InstanceState::Initialization);
    assert_eq!(host.try_get([IN_DOMAIN, POLICY]), Ok([1.0, 0.0]));
    assert_eq!(host.set(&[POLICY], &[1.0]), Status::Ok);
    assert_eq!(host.try_get([POLICY]), Ok([1.0]));
    for wrong in [0.5, 3.0, -1.0, 1e300] {
        assert_eq!(host.set(&[POLICY], &[wrong]), Status::Error);
        assert!(host.message().contains("expected 0 (warn), 1 (clamp) or 2 (error)"));
    }
    assert_eq!(host.set(&[IN_DOMAIN], &[1.0]), Status::Error);
    assert!(host.message().ends_with("`in_domain` (value reference 7) is computed and cannot be set"));
}

#[test]
fn every_variable_is_of_one_type() {
    let refused = |call: unsafe fn(*mut c_void) -> Status, expected: &str| {
        let host = Host::in_state(InstanceState::Initialization);
        assert_eq!(unsafe { call(host.c) }, Status::Error);
        let message = host.message();
        assert!(message.ends_with(expected), "{message}");
    };
    refused(
        |c| unsafe { fmi2GetInteger(c, &LENGTH, 1, &mut 0) },
        "`length` (value reference 1) is of type real, not integer",
    );
    refused(
        |c| unsafe { fmi2SetInteger(c, &ANGLE, 1, &0) },
        "`angle` (value reference 4) is of type real, not integer",
    );
    refused(|c| unsafe { fmi2GetBoolean(c, &POLICY, 1, &mut 0) }, "is of type integer, not Boolean");
    refused(
        |c| unsafe { fmi2SetBoolean(c, &DISTANCE, 1, &0) },
        "`domain_distance` (value reference 8) is of type real, not Boolean",
    );
    refused(|c| unsafe { fmi2SetBoolean(c, &IN_DOMAIN, 1, &0) }, "is computed and cannot be set");
    refused(|c| unsafe { fmi2SetReal(c, &DISTANCE, 1, &0.0) }, "is computed and cannot be set");
    refused(|c| unsafe { fmi2GetInteger(c, &9, 1, &mut 0) }, "value reference 9 is unknown, expected at most 8");
    let none = "1 variables of type String asked for, but there are none of this type";
    refused(|c| unsafe { fmi2GetString(c, &LENGTH, 1, &mut null()) }, none);
    refused(|c| unsafe { fmi2SetString(c, &LENGTH, 1, &c"".as_ptr()) }, none);
}

#[test]
fn null_arrays_are_fine_when_empty_and_refused_otherwise() {
    let host = Host::stepping();
    unsafe {
        assert_eq!(fmi2GetReal(host.c, null(), 0, null_mut()), Status::Ok);
        assert_eq!(fmi2SetReal(host.c, null(), 0, null()), Status::Ok);
    }
    let refused = |call: unsafe fn(*mut c_void) -> Status, argument: &str| {
        let host = Host::stepping();
        assert_eq!(unsafe { call(host.c) }, Status::Error);
        assert!(host.message().contains(&format!("argument `{argument}` is a null pointer")));
    };
    unsafe {
        refused(|c| fmi2GetReal(c, null(), 1, &mut 0.0), "vr");
        refused(|c| fmi2GetReal(c, &LENGTH, 1, null_mut()), "value");
        refused(|c| fmi2SetReal(c, null(), 1, &0.0), "vr");
        refused(|c| fmi2SetReal(c, &LENGTH, 1, null()), "value");
        refused(|c| fmi2SetDebugLogging(c, 1, 1, null()), "categories");
        refused(|c| fmi2SetDebugLogging(c, 1, 1, [null()].as_ptr()), "categories");
        refused(|c| fmi2GetFMUstate(c, null_mut()), "FMUstate");
        refused(|c| fmi2SetFMUstate(c, null_mut()), "FMUstate");
        refused(|c| fmi2SerializedFMUstateSize(c, null_mut(), &mut 0), "FMUstate");
        refused(|c| fmi2SerializeFMUstate(c, null_mut(), null_mut(), 0), "FMUstate");
        refused(|c| fmi2DeSerializeFMUstate(c, null(), 9, &mut null_mut()), "serializedState");
        refused(|c| fmi2GetRealStatus(c, LAST_SUCCESSFUL_TIME, null_mut()), "value");
        refused(|c| fmi2GetBooleanStatus(c, TERMINATED, null_mut()), "value");
    }
}

#[test]
fn a_null_component_is_an_error_and_freeing_it_is_fine() {
    for (name, function, ..) in states::TABLE {
        if name != "EnterInitializationMode" {
            assert_eq!(function(null_mut()), Status::Error, "{name}");
        }
    }
    unsafe {
        assert_eq!(fmi2EnterInitializationMode(null_mut()), Status::Error);
        fmi2FreeInstance(null_mut());
    }
}

#[test]
fn outputs_that_overflow_are_an_error_and_the_instance_continues() {
    let host = Host::of(&example::with_network(&[8], Activation::Relu));
    host.initialize(0.0);
    let before = host.outputs();
    assert_eq!(host.set(&[LENGTH], &[1e308]), Status::Ok);
    host.messages();
    assert_eq!(host.try_get(OUTPUTS), Err(Status::Error));
    assert!(host.message().contains("a value is too large"));
    assert_eq!(host.set(&[LENGTH], &starts()[..1]), Status::Ok);
    assert_eq!(host.outputs(), before);
}
