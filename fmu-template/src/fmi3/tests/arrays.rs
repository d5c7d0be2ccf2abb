use super::*;

// of `example::with_arrays`
const POSITION: u32 = 9;
const SWAPPED: u32 = 10;

fn host(use_as: Use) -> Host {
    let host = Host::of(&example::with_arrays(), use_as);
    assert_eq!((host.enter(0.0), host.exit()), (Status::Ok, Status::Ok));
    host
}

impl Host {
    /// As many values as asked for; NaN where none was written.
    fn read(&self, references: &[u32], size: usize) -> (Status, Vec<f64>) {
        let mut values = vec![f64::NAN; size];
        let (references, n) = (references.as_ptr(), references.len());
        let status = unsafe { fmi3GetFloat64(self.instance, references, n, values.as_mut_ptr(), size) };
        (status, values)
    }

    fn jacobian(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64], size: usize) -> (Status, Vec<f64>) {
        let (mut found, c) = (vec![f64::NAN; size], self.instance);
        let (u, k, s, out) = (unknowns.as_ptr(), knowns.as_ptr(), seed.as_ptr(), found.as_mut_ptr());
        let (nu, nk, ns) = (unknowns.len(), knowns.len(), seed.len());
        (unsafe { fmi3GetDirectionalDerivative(c, u, nu, k, nk, s, ns, out, size) }, found)
    }

    fn gradient(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64], size: usize) -> (Status, Vec<f64>) {
        let (mut found, c) = (vec![f64::NAN; size], self.instance);
        let (u, k, s, out) = (unknowns.as_ptr(), knowns.as_ptr(), seed.as_ptr(), found.as_mut_ptr());
        let (nu, nk, ns) = (unknowns.len(), knowns.len(), seed.len());
        (unsafe { fmi3GetAdjointDerivative(c, u, nu, k, nk, s, ns, out, size) }, found)
    }

    fn rates(&self, references: &[u32], orders: &[i32], size: usize) -> (Status, Vec<f64>) {
        let mut found = vec![f64::NAN; size];
        let (n, r, o) = (references.len(), references.as_ptr(), orders.as_ptr());
        (unsafe { fmi3GetOutputDerivatives(self.instance, r, n, o, found.as_mut_ptr(), size) }, found)
    }
}

#[test]
fn error_bounds_follow_the_arrays_and_depend_on_nothing() {
    let host = Host::of(&example::with_bounds(), Use::Steps);
    assert_eq!((host.enter(0.0), host.exit()), (Status::Ok, Status::Ok));
    let [x, y] = expected(starts()[0], starts()[1], 0.0);
    assert_eq!(host.read(&[12, POSITION, 11], 4), (Status::Ok, vec![0.25, x, y, 0.125]));
    let mut count = usize::MAX;
    assert_eq!(unsafe { fmi3GetNumberOfVariableDependencies(host.instance, 11, &mut count) }, Status::Ok);
    assert_eq!(count, 0);
}

#[test]
fn an_array_has_the_values_of_its_outputs_in_order() {
    for use_as in [Use::Steps, Use::StepsAndEvents, Use::Solver] {
        let host = Host::of(&example::with_arrays(), use_as);
        let [length, speed] = starts();
        let check = |length, speed, time| {
            let [x, y] = expected(length, speed, time);
            assert_eq!(host.read(&[POSITION], 2), (Status::Ok, vec![x, y]));
            assert_eq!(host.read(&[SWAPPED], 2), (Status::Ok, vec![y, x]));
        };
        assert_eq!(host.enter(0.25), Status::Ok);
        check(length, speed, 0.25);
        assert_eq!(host.set(&[LENGTH, SPEED], &[0.12, 1.0]), Status::Ok);
        check(0.12, 1.0, 0.25);
        assert_eq!(host.exit(), Status::Ok);
        if use_as == Use::Steps {
            assert_eq!(host.step(0.25, 0.5), Status::Ok);
            check(0.12, 1.0, 0.75);
        }
        assert!(host.messages().is_empty());
    }
}

#[test]
fn scalars_and_arrays_are_read_in_one_call() {
    let host = host(Use::Steps);
    let [length, speed] = starts();
    let [x, y] = expected(length, speed, 0.0);
    let references = [LENGTH, SWAPPED, DISTANCE, VELOCITY, POSITION, SWAPPED, TIME];
    assert_eq!(host.read(&references, 10), (Status::Ok, vec![length, y, x, 0.0, y, x, y, y, x, 0.0]));
}

#[test]
fn a_number_of_values_that_does_not_fit_is_refused_with_both_numbers() {
    for (references, sizes, expected) in [
        (&[POSITION][..], &[0, 1, 3][..], 2),
        (&[POSITION, ANGLE], &[2, 4], 3),
        (&OUTPUTS, &[1, 3], 2),
        (&[SWAPPED, POSITION], &[2, 3, 5], 4),
    ] {
        for &size in sizes {
            let host = host(Use::Steps);
            let (status, values) = host.read(references, size);
            assert_eq!(status, Status::Error);
            assert!(values.iter().all(|value| value.is_nan()), "{values:?}");
            let message = format!("fmi3GetFloat64: argument `values`: {size} elements, expected {expected}");
            assert_eq!(host.message(), message);
        }
    }
}

#[test]
fn a_call_with_one_wrong_reference_writes_nothing_at_all() {
    for (reference, message) in [
        (0, "value reference 0 is unknown: no variable has it"),
        (11, "value reference 11 is unknown, expected at most 10"),
        (u32::MAX, "value reference 4294967295 is unknown, expected at most 10"),
    ] {
        let host = host(Use::Steps);
        let (status, values) = host.read(&[ANGLE, POSITION, reference], 4);
        assert_eq!(status, Status::Error);
        assert!(values.iter().all(|value| value.is_nan()), "{reference}: {values:?}");
        assert!(host.message().ends_with(message));
    }
}

#[test]
fn null_is_fine_for_nothing_and_refused_for_an_array() {
    let refused = |call: &dyn Fn(*mut c_void) -> Status, expected: &str| {
        let host = host(Use::Steps);
        assert_eq!(call(host.instance), Status::Error);
        let message = host.message();
        assert!(message.ends_with(expected), "{message}");
    };
    let (null_values, empty) = ("`values` is a null pointer", "`values`: 0 elements, expected 2");
    let nothing = host(Use::Steps);
    unsafe {
        let c = nothing.instance;
        assert_eq!(fmi3GetFloat64(c, null(), 0, null_mut(), 0), Status::Ok);
        assert_eq!(fmi3SetFloat64(c, null(), 0, null(), 0), Status::Ok);
        assert_eq!(fmi3GetDirectionalDerivative(c, null(), 0, null(), 0, null(), 0, null_mut(), 0), Status::Ok);
        assert_eq!(fmi3GetAdjointDerivative(c, null(), 0, null(), 0, null(), 0, null_mut(), 0), Status::Ok);
        assert_eq!(fmi3GetOutputDerivatives(c, null(), 0, null(), null_mut(), 0), Status::Ok);
        refused(&|c| fmi3GetFloat64(c, &POSITION, 1, null_mut(), 2), null_values);
        refused(&|c| fmi3GetFloat64(c, &POSITION, 1, null_mut(), 0), empty);
        refused(&|c| fmi3GetFloat64(c, null(), 0, null_mut(), 2), "`values`: 2 elements, expected 0");
        refused(&|c| fmi3GetFloat64(c, null(), 1, null_mut(), 2), "`valueReferences` is a null pointer");
        refused(&|c| fmi3SetFloat64(c, &POSITION, 1, null(), 2), null_values);
        refused(&|c| fmi3GetOutputDerivatives(c, &POSITION, 1, &1, null_mut(), 0), empty);
        refused(&|c| fmi3GetOutputDerivatives(c, &POSITION, 1, &1, null_mut(), 2), null_values);
        refused(
            &|c| fmi3GetAdjointDerivative(c, &POSITION, 1, &TIME, 1, null(), 2, &mut 0.0, 1),
            "`seed` is a null pointer",
        );
    }
}

#[test]
fn an_array_is_an_output_and_a_real_one() {
    let refused = |state: InstanceState, call: &dyn Fn(*mut c_void) -> Status, expected: &str| {
        let host = Host::of(&example::with_arrays(), Use::Steps);
        assert_eq!(host.enter(0.0), Status::Ok);
        if state == InstanceState::Step {
            assert_eq!(host.exit(), Status::Ok);
        }
        let before = host.read(&[LENGTH, POSITION], 3).1;
        assert_eq!(call(host.instance), Status::Error);
        let message = host.message();
        assert!(message.ends_with(expected), "{message}");
        assert_eq!(host.read(&[LENGTH, POSITION], 3).1, before);
    };
    let output = "variable `position` (value reference 9) is an output and cannot be set";
    for state in [InstanceState::Initialization, InstanceState::Step] {
        unsafe {
            refused(state, &|c| fmi3SetFloat64(c, &POSITION, 1, [0.1; 2].as_ptr(), 2), output);
            refused(state, &|c| fmi3SetFloat64(c, [LENGTH, POSITION].as_ptr(), 2, [0.19; 3].as_ptr(), 3), output);
            refused(state, &|c| fmi3SetFloat64(c, [POSITION, LENGTH].as_ptr(), 2, [0.19; 3].as_ptr(), 3), output);
            refused(state, &|c| fmi3SetFloat64(c, &POSITION, 1, &0.1, 1), "`values`: 1 elements, expected 2");
            refused(
                state,
                &|c| fmi3GetFloat32(c, &POSITION, 1, [0.0; 2].as_mut_ptr(), 2),
                "there are none of this type",
            );
            refused(state, &|c| fmi3GetInt64(c, &POSITION, 1, [0; 2].as_mut_ptr(), 2), "there are none of this type");
            let of_type = "`position` (value reference 9) is of type real, not ";
            refused(state, &|c| fmi3GetInt32(c, &POSITION, 1, &mut 0, 1), &format!("{of_type}integer"));
            refused(state, &|c| fmi3SetInt32(c, &POSITION, 1, &0, 1), &format!("{of_type}integer"));
            refused(state, &|c| fmi3GetBoolean(c, &POSITION, 1, &mut 0, 1), &format!("{of_type}Boolean"));
            refused(state, &|c| fmi3SetBoolean(c, &POSITION, 1, &0, 1), &format!("{of_type}Boolean"));
        }
    }
}

#[test]
fn derivatives_of_an_array_are_those_of_its_outputs() {
    let host = Host::of(&example::with_arrays(), Use::Steps);
    assert_eq!(host.set(&[SPEED], &[-1.5]), Status::Ok, "outside, so that the distance has a derivative");
    assert_eq!((host.enter(0.0), host.exit(), host.step(0.0, 0.5)), (Status::Ok, Status::Ok, Status::Ok));
    let knowns = [LENGTH, SPEED, TIME];
    let (status, scalars) = host.jacobian(&[ANGLE, VELOCITY, DISTANCE], &knowns, &[0.5, -1.0, 2.0], 3);
    let [x, y, distance] = scalars[..] else { panic!("{scalars:?}") };
    assert!(status == Status::Ok && x != y && distance == 0.2, "{scalars:?}");
    assert_eq!(
        host.jacobian(&[SWAPPED, DISTANCE, ANGLE, POSITION], &knowns, &[0.5, -1.0, 2.0], 6),
        (Status::Ok, vec![y, x, distance, x, x, y])
    );
    assert_eq!(
        host.gradient(&[SWAPPED, DISTANCE], &knowns, &[0.5, -1.0, 2.0], 3),
        host.gradient(&[DISTANCE, ANGLE, VELOCITY], &knowns, &[2.0, -1.0, 0.5], 3)
    );
    assert_eq!(
        host.gradient(&[SWAPPED, POSITION], &[TIME], &[0.0, 0.5, 0.25, 0.0], 1),
        host.gradient(&[ANGLE], &[TIME], &[0.75], 1),
        "seeds of one output add up"
    );
    let (status, scalars) = host.rates(&[ANGLE, ANGLE, VELOCITY, VELOCITY], &[1, 2, 1, 2], 4);
    let [x1, x2, y1, y2] = scalars[..] else { panic!("{scalars:?}") };
    assert!(status == Status::Ok && x1 != x2, "{scalars:?}");
    assert_eq!(
        host.rates(&[POSITION, VELOCITY, SWAPPED, DISTANCE], &[2, 1, 1, 1], 6),
        (Status::Ok, vec![x2, y2, y1, y1, x1, 0.0])
    );
}

#[test]
fn derivatives_count_arrays_by_their_elements() {
    let refused = |call: &dyn Fn(&Host) -> (Status, Vec<f64>), expected: &str| {
        let host = host(Use::Steps);
        let (status, values) = call(&host);
        assert_eq!(status, Status::Error);
        assert!(values.iter().all(|value| value.is_nan()), "{values:?}");
        let message = host.message();
        assert!(message.ends_with(expected), "{message}");
    };
    refused(&|host| host.jacobian(&[POSITION], &[TIME], &[1.0], 1), "`sensitivity`: 1 elements, expected 2");
    refused(&|host| host.jacobian(&[POSITION, ANGLE], &[TIME], &[1.0], 4), "`sensitivity`: 4 elements, expected 3");
    refused(&|host| host.gradient(&[POSITION], &[TIME], &[1.0], 1), "`seed`: 1 elements, expected 2");
    refused(&|host| host.gradient(&[POSITION], &[TIME], &[1.0; 2], 2), "`sensitivity`: 2 elements, expected 1");
    refused(&|host| host.rates(&[POSITION], &[1], 1), "`values`: 1 elements, expected 2");
    refused(&|host| host.rates(&[POSITION, SWAPPED], &[1, 3], 4), "order 3 are not available, expected 1 to 2");
    refused(&|host| host.gradient(&[POSITION], &[TIME], &[1.0, f64::NAN], 1), "`seed`: NaN is not finite");
    let known = "`position` (value reference 9) is no input, parameter, state or time";
    refused(&|host| host.jacobian(&[ANGLE], &[POSITION], &[1.0; 2], 1), known);
    refused(&|host| host.gradient(&[ANGLE], &[POSITION], &[1.0], 2), known);
    refused(&|host| host.gradient(&[11], &[TIME], &[1.0], 1), "value reference 11 is unknown, expected at most 10");
}

#[test]
fn every_element_of_an_array_depends_on_what_its_output_does() {
    let host = host(Use::Solver);
    for reference in [POSITION, SWAPPED] {
        let mut count = 0;
        assert_eq!(unsafe { fmi3GetNumberOfVariableDependencies(host.instance, reference, &mut count) }, Status::Ok);
        assert_eq!(count, 8);
        let (mut of, mut on, mut elements, mut kinds) = ([99; 8], [99; 8], [99; 8], [99; 8]);
        let (a, b, c, d) = (of.as_mut_ptr(), on.as_mut_ptr(), elements.as_mut_ptr(), kinds.as_mut_ptr());
        let status = unsafe { fmi3GetVariableDependencies(host.instance, reference, a, b, c, d, count) };
        assert_eq!(status, Status::Ok);
        assert_eq!(of, [1, 1, 1, 1, 2, 2, 2, 2]);
        assert_eq!(on, [LENGTH, SPEED, TIME, POLICY, LENGTH, SPEED, TIME, POLICY]);
        assert_eq!((elements, kinds), ([0; 8], [5; 8]));
    }
    let (mut of, mut on, mut elements, mut kinds) = ([99; 4], [99; 4], [99; 4], [99; 4]);
    let (a, b, c, d) = (of.as_mut_ptr(), on.as_mut_ptr(), elements.as_mut_ptr(), kinds.as_mut_ptr());
    assert_eq!(unsafe { fmi3GetVariableDependencies(host.instance, POSITION, a, b, c, d, 4) }, Status::Error);
    assert_eq!((of, on, elements, kinds), ([99; 4], [99; 4], [99; 4], [99; 4]));
    assert!(host.message().ends_with("`independents`: 4 elements, expected 8"));
}

#[test]
fn arrays_follow_the_time_that_is_added() {
    let surrogate = example::with_arrays();
    let mut metadata = surrogate.metadata().clone();
    (metadata.inputs[2].name, metadata.inputs[2].role) = ("load".into(), metadata.inputs[0].role);
    let surrogate = Surrogate::new(metadata, surrogate.program().clone()).unwrap();
    let host = Host::of(&surrogate, Use::Steps);
    assert_eq!((host.enter(0.5), host.exit()), (Status::Ok, Status::Ok));
    let load = surrogate.inputs()[2].start;
    let [x, y] = expected(starts()[0], starts()[1], load);
    assert_eq!(host.read(&[9, POSITION + 1, SWAPPED + 1], 5), (Status::Ok, vec![0.5, x, y, y, x]));
}

#[test]
fn steps_with_arrays_allocate_nothing() {
    let host = host(Use::Steps);
    let mut values = [0.0; 5];
    let references = [POSITION, TIME, SWAPPED];
    let before = allocations().0;
    for step in 0..1_000 {
        assert_eq!(host.step(f64::from(step) * 1e-3, 1e-3), Status::Ok);
        let status = unsafe { fmi3GetFloat64(host.instance, references.as_ptr(), 3, values.as_mut_ptr(), 5) };
        assert_eq!(status, Status::Ok);
        let (r, o) = (references.as_ptr(), [1; 3].as_ptr());
        assert_eq!(unsafe { fmi3GetOutputDerivatives(host.instance, r, 1, o, values.as_mut_ptr(), 2) }, Status::Ok);
    }
    assert_eq!(allocations().0, before);
}
