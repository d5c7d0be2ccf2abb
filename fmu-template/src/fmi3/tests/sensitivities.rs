use super::*;

impl Host {
    fn directional(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64]) -> Vec<f64> {
        let mut found = vec![f64::NAN; unknowns.len()];
        let (nu, nk, out) = (unknowns.len(), knowns.len(), found.as_mut_ptr());
        let (unknowns, knowns, seed) = (unknowns.as_ptr(), knowns.as_ptr(), seed.as_ptr());
        let status =
            unsafe { fmi3GetDirectionalDerivative(self.instance, unknowns, nu, knowns, nk, seed, nk, out, nu) };
        assert_eq!(status, Status::Ok);
        found
    }

    fn adjoint(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64]) -> Vec<f64> {
        let mut found = vec![f64::NAN; knowns.len()];
        let (nu, nk, out) = (unknowns.len(), knowns.len(), found.as_mut_ptr());
        let (unknowns, knowns, seed) = (unknowns.as_ptr(), knowns.as_ptr(), seed.as_ptr());
        let status = unsafe { fmi3GetAdjointDerivative(self.instance, unknowns, nu, knowns, nk, seed, nu, out, nk) };
        assert_eq!(status, Status::Ok);
        found
    }

    fn dependencies(&self, reference: u32) -> Vec<u32> {
        let mut count = 99;
        assert_eq!(unsafe { fmi3GetNumberOfVariableDependencies(self.instance, reference, &mut count) }, Status::Ok);
        let (mut of, mut on, mut elements, mut kinds) =
            (vec![9; count], vec![9; count], vec![9; count], vec![9; count]);
        let (a, b, c, d) = (of.as_mut_ptr(), on.as_mut_ptr(), elements.as_mut_ptr(), kinds.as_mut_ptr());
        let status = unsafe { fmi3GetVariableDependencies(self.instance, reference, a, b, c, d, count) };
        assert_eq!(status, Status::Ok);
        assert!(of.iter().chain(&elements).all(|&element| element == 0) && kinds.iter().all(|&kind| kind == 5));
        on
    }
}

#[test]
fn both_kinds_of_derivatives_are_the_same_jacobian() {
    let unknowns = [ANGLE, VELOCITY, DISTANCE];
    let knowns = [LENGTH, SPEED, TIME];
    let jacobians = |host: &Host| {
        let unit = |at: usize| [0, 1, 2].map(|index| if index == at { 1.0 } else { 0.0 });
        let by_columns = [0, 1, 2].map(|known| host.directional(&unknowns, &knowns, &unit(known)));
        let by_rows = [0, 1, 2].map(|unknown| host.adjoint(&unknowns, &knowns, &unit(unknown)));
        for (column, values) in by_columns.iter().enumerate() {
            for (row, value) in values.iter().enumerate() {
                let difference = (value - by_rows[row][column]).abs();
                assert!(difference <= 1e-13 * value.abs().max(1.0), "{row} {column}: {by_columns:?} {by_rows:?}");
            }
        }
        by_rows
    };
    let host = Host::driven(Use::Steps);
    assert_eq!(jacobians(&host)[2], [0.0; 3], "inside the domain");
    assert_eq!(host.set(&[SPEED], &[-1.0]), Status::Ok);
    assert_eq!(jacobians(&host)[2], [0.0, -0.2, 0.0]);
    assert_eq!(host.set_policy(1), Status::Ok);
    let clamped = jacobians(&host);
    assert_eq!((clamped[0][1], clamped[1][1], clamped[2][1]), (0.0, 0.0, -0.2));
    assert_ne!(clamped[0][0], 0.0);
    assert_eq!(
        host.adjoint(&[ANGLE, ANGLE], &[TIME], &[0.75, 0.25]),
        host.adjoint(&[ANGLE], &[TIME], &[1.0]),
        "seeds add up"
    );
}

#[test]
fn output_derivatives_are_the_directional_ones_along_time() {
    let host = Host::driven(Use::Steps);
    assert_eq!(host.step(0.0, 0.5), Status::Ok);
    let mut found = [0.0; 2];
    let (references, orders) = (OUTPUTS.as_ptr(), [1, 1].as_ptr());
    let status = unsafe { fmi3GetOutputDerivatives(host.instance, references, 2, orders, found.as_mut_ptr(), 2) };
    assert_eq!(status, Status::Ok);
    assert_eq!(found[..], host.directional(&OUTPUTS, &[TIME], &[1.0]));
}

#[test]
fn lengths_that_do_not_fit_are_refused() {
    let refused = |call: &dyn Fn(*mut c_void) -> Status| {
        let host = Host::in_state(Use::Steps, InstanceState::Step);
        assert_eq!(call(host.instance), Status::Error);
        let message = host.message();
        assert!(message.contains("elements, expected"), "{message}");
    };
    unsafe {
        refused(&|c| fmi3GetDirectionalDerivative(c, &ANGLE, 1, &LENGTH, 1, [1.0; 2].as_ptr(), 2, &mut 0.0, 1));
        refused(&|c| fmi3GetDirectionalDerivative(c, &ANGLE, 1, &LENGTH, 1, &1.0, 1, [0.0; 2].as_mut_ptr(), 2));
        refused(&|c| fmi3GetAdjointDerivative(c, &ANGLE, 1, [LENGTH, TIME].as_ptr(), 2, &1.0, 1, &mut 0.0, 1));
        refused(&|c| fmi3GetAdjointDerivative(c, &ANGLE, 1, &LENGTH, 1, [1.0; 2].as_ptr(), 2, &mut 0.0, 1));
        refused(&|c| fmi3GetOutputDerivatives(c, &ANGLE, 1, &1, [0.0; 2].as_mut_ptr(), 2));
        refused(&|c| fmi3GetFloat64(c, &ANGLE, 1, [0.0; 2].as_mut_ptr(), 2));
        refused(&|c| fmi3SetFloat64(c, &LENGTH, 1, [0.1; 2].as_ptr(), 2));
        refused(&|c| fmi3GetInt32(c, &POLICY, 1, &mut 0, 0));
        refused(&|c| fmi3SetInt32(c, &POLICY, 1, &0, 0));
        refused(&|c| fmi3GetBoolean(c, &IN_DOMAIN, 1, &mut 0, 0));
        refused(&|c| fmi3GetFloat32(c, null(), 0, &mut 0.0, 1));
        refused(&|c| fmi3GetVariableDependencies(c, ANGLE, null_mut(), null_mut(), null_mut(), null_mut(), 0));
    }
}

#[test]
fn null_pointers_are_refused() {
    let refused = |call: &dyn Fn(*mut c_void) -> Status| {
        let host = Host::in_state(Use::Steps, InstanceState::Step);
        assert_eq!(call(host.instance), Status::Error);
        let message = host.message();
        assert!(message.contains("is a null pointer"), "{message}");
    };
    unsafe {
        refused(&|c| fmi3GetFloat64(c, null(), 1, &mut 0.0, 1));
        refused(&|c| fmi3GetFloat64(c, &ANGLE, 1, null_mut(), 1));
        refused(&|c| fmi3SetFloat64(c, null(), 1, &0.1, 1));
        refused(&|c| fmi3SetFloat64(c, &LENGTH, 1, null(), 1));
        refused(&|c| fmi3GetInt32(c, &POLICY, 1, null_mut(), 1));
        refused(&|c| fmi3GetBoolean(c, null(), 1, &mut 0, 1));
        refused(&|c| fmi3GetAdjointDerivative(c, &ANGLE, 1, &LENGTH, 1, null(), 1, &mut 0.0, 1));
        refused(&|c| fmi3GetAdjointDerivative(c, &ANGLE, 1, &LENGTH, 1, &1.0, 1, null_mut(), 1));
        refused(&|c| fmi3GetOutputDerivatives(c, &ANGLE, 1, null(), &mut 0.0, 1));
        refused(&|c| fmi3GetNumberOfVariableDependencies(c, ANGLE, null_mut()));
        refused(&|c| fmi3GetVariableDependencies(c, ANGLE, null_mut(), null_mut(), null_mut(), null_mut(), 4));
        refused(&|c| fmi3SetDebugLogging(c, 1, 1, null()));
        refused(&|c| fmi3GetFMUState(c, null_mut()));
        refused(&|c| fmi3SetFMUState(c, null_mut()));
    }
}

#[test]
fn variables_depend_on_what_moves_them() {
    let host = Host::in_state(Use::Solver, InstanceState::Event);
    assert_eq!(host.dependencies(ANGLE), [LENGTH, SPEED, TIME, POLICY]);
    assert_eq!(host.dependencies(VELOCITY), [LENGTH, SPEED, TIME, POLICY]);
    assert_eq!(host.dependencies(IN_DOMAIN), [LENGTH, SPEED, TIME]);
    assert_eq!(host.dependencies(DISTANCE), [LENGTH, SPEED, TIME]);
    for reference in [LENGTH, SPEED, TIME, POLICY] {
        assert_eq!(host.dependencies(reference), [0; 0]);
    }
    assert_eq!(unsafe { fmi3GetNumberOfVariableDependencies(host.instance, 9, &mut 0) }, Status::Error);
}

#[test]
fn types_and_clocks_that_do_not_exist_are_refused() {
    let refused = |state: InstanceState, call: &dyn Fn(*mut c_void) -> Status, expected: &str| {
        let host = Host::in_state(Use::StepsAndEvents, state);
        assert_eq!(call(host.instance), Status::Error);
        let message = host.message();
        assert!(message.contains(expected), "{message}");
    };
    unsafe {
        refused(
            InstanceState::Step,
            &|c| fmi3GetFloat32(c, &LENGTH, 1, &mut 0.0, 1),
            "1 variables of type Float32 asked for",
        );
        refused(InstanceState::Step, &|c| fmi3SetInt64(c, &POLICY, 1, &0, 1), "1 variables of type Int64 asked for");
        refused(
            InstanceState::Step,
            &|c| fmi3GetString(c, &POLICY, 1, &mut null(), 1),
            "1 variables of type String asked for",
        );
        refused(
            InstanceState::Step,
            &|c| fmi3GetBinary(c, &POLICY, 1, &mut 0, &mut null(), 1),
            "1 variables of type Binary",
        );
        refused(
            InstanceState::Step,
            &|c| fmi3GetInt32(c, &LENGTH, 1, &mut 0, 1),
            "`length` (value reference 1) is of type real",
        );
        refused(InstanceState::Event, &|c| fmi3GetClock(c, &POLICY, 1, &mut 0), "1 variables of type Clock asked for");
        refused(
            InstanceState::Event,
            &|c| fmi3GetIntervalDecimal(c, &POLICY, 1, &mut 0.0, &mut 0),
            "1 variables of type Clock",
        );
    }
}

#[test]
fn derivatives_by_encoded_inputs_are_those_of_differences() {
    let host = Host::of(&example::encoded(&example::surrogate()), Use::Steps);
    assert_eq!(host.set(&[LENGTH, SPEED], &[0.2, 1.3]), Status::Ok);
    assert_eq!(host.enter(0.3), Status::Ok);
    let unknowns = OUTPUTS;
    let at = |speed: f64| {
        assert_eq!(host.set(&[SPEED], &[speed]), Status::Ok);
        host.outputs()
    };
    let (above, below) = (at(1.3 + 1e-5), at(1.3 - 1e-5));
    at(1.3);
    let found = host.directional(&unknowns, &[SPEED], &[1.0]);
    for index in 0..2 {
        let difference = (above[index] - below[index]) / 2e-5;
        assert!((found[index] - difference).abs() < 1e-8 * difference.abs().max(1.0), "{} {difference}", found[index]);
        let mut seed = [0.0; 2];
        seed[index] = 1.0;
        let row = host.adjoint(&unknowns, &[LENGTH, SPEED], &seed);
        assert_eq!(row[0], 0.0);
        assert!((row[1] - found[index]).abs() < 1e-12 * found[index].abs().max(1.0));
    }
    assert_eq!(host.directional(&unknowns, &[LENGTH], &[1.0]), [0.0; 2]);
    assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
    assert_eq!(host.in_domain(), 0);
}

#[test]
fn a_bound_that_grows_has_a_derivative_with_respect_to_the_time_only() {
    let (force, time, bounds) = (6, 25, [26, 27]);
    let host = Host::of(&example::with_growing_bounds(), Use::Steps);
    assert_eq!((host.enter(0.0), host.exit(), host.step(0.0, 1.5)), (Status::Ok, Status::Ok, Status::Ok));
    assert_eq!(host.try_get(bounds), Ok([0.25, 0.5]));
    assert_eq!(host.directional(&bounds, &[force, time], &[3.0, 2.0]), [0.5, 1.0]);
    assert_eq!(host.adjoint(&bounds, &[force, time], &[1.0, 2.0]), [0.0, 1.25]);
    assert_eq!(host.dependencies(bounds[0]), [] as [u32; 0]);
}
