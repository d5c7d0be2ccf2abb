//! A surrogate with states: the crane of [`example::crane`].

use super::*;
use metafmu_runtime::{CommunicationStep, Drive, Evaluator, Integration};

const ROPE: u32 = 1;
const STARTS: [u32; 4] = [2, 3, 4, 5];
const FORCE: u32 = 6;
const LOAD: [u32; 3] = [9, 10, 11];
const STATES: [u32; 4] = [14, 15, 16, 17];
const RATES: [u32; 4] = [18, 19, 20, 21];
const POLICY: u32 = 22;

fn of_kind(kind: c_int) -> Host {
    let host = Host::of_kind(&example::crane(), kind);
    assert_eq!(host.set(&STARTS, &[0.1, 0.5, -0.2, 0.3]), Status::Ok);
    host.set_up(0.0);
    host
}

fn stepping() -> Host {
    let host = of_kind(CO_SIMULATION);
    assert_eq!((host.enter(), host.exit()), (Status::Ok, Status::Ok));
    host
}

fn solving() -> Host {
    let host = of_kind(MODEL_EXCHANGE);
    assert_eq!((host.enter(), host.exit(), host.go_on()), (Status::Ok, Status::Ok, Status::Ok));
    host
}

fn continuous_states(host: &Host) -> [f64; 4] {
    let mut states = [f64::NAN; 4];
    assert_eq!(unsafe { fmi2GetContinuousStates(host.c, states.as_mut_ptr(), 4) }, Status::Ok);
    states
}

fn derivatives(host: &Host) -> [f64; 4] {
    let mut rates = [f64::NAN; 4];
    assert_eq!(unsafe { fmi2GetDerivatives(host.c, rates.as_mut_ptr(), 4) }, Status::Ok);
    rates
}

/// States after one step of the solver, from the state of [`stepping`].
fn advanced(of: &Surrogate, force: f64, rates: [f64; 2], size: f64, tolerance: Option<f64>) -> [f64; 4] {
    let mut evaluator = Evaluator::new(of);
    let mut point = [1.5, 0.1, 0.5, -0.2, 0.3, force, 0.1, 0.5, -0.2, 0.3];
    let of_input = rates.map(|rate| {
        let mut rates = [0.0; 10];
        rates[5] = rate;
        rates
    });
    let drive = Drive { rates: [&of_input[0], &of_input[1]], clamp: None };
    let step = CommunicationStep { tolerance, ..CommunicationStep::of(size) };
    evaluator.advance(&mut point, step, drive).unwrap();
    std::array::from_fn(|k| point[6 + k])
}

#[test]
fn states_begin_with_the_parameters_for_the_start() {
    let host = of_kind(CO_SIMULATION);
    assert_eq!(host.enter(), Status::Ok);
    assert_eq!(host.try_get(STATES), Ok([0.1, 0.5, -0.2, 0.3]));
    assert_eq!(host.set(&STARTS[1..2], &[0.7]), Status::Ok);
    assert_eq!(host.try_get([STATES[1], LOAD[0]]), Ok([0.7, 0.1 + 1.5 * 0.7f64.sin()]));
    assert_eq!(host.exit(), Status::Ok);
    assert_eq!(host.set(&STARTS[1..2], &[0.8]), Status::Ok, "no time has passed");
    assert_eq!(host.try_get(STATES), Ok([0.1, 0.8, -0.2, 0.3]));
    assert_eq!(host.step(0.0, 0.01), Status::Ok);
    assert_eq!(host.set(&STARTS[1..2], &[0.8]), Status::Ok, "unchanged");
    assert_eq!(host.set(&STARTS[1..2], &[0.9]), Status::Error);
    assert!(host.message().contains("parameter `rope.angle_start` (value reference 3) is fixed and cannot be set"));
    let host = stepping();
    assert_eq!(host.set(&STATES[..1], &[1.0]), Status::Error);
    assert!(host.message().contains("is a state and cannot be set: set parameter `trolley.position_start` before"));
}

#[test]
fn a_step_integrates_with_the_inputs_as_they_change() {
    let host = stepping();
    assert_eq!(host.set(&[FORCE], &[2.0]), Status::Ok);
    let set_rates =
        |order: c_int, value: f64| unsafe { fmi2SetRealInputDerivatives(host.c, &FORCE, 1, &order, &value) };
    assert_eq!((set_rates(1, 3.0), set_rates(2, -4.0)), (Status::Ok, Status::Ok));
    assert_eq!(host.step(0.0, 0.05), Status::Ok);
    assert_eq!(host.try_get(STATES), Ok(advanced(&example::crane(), 2.0, [3.0, -4.0], 0.05, None)));
    assert_eq!(host.try_get([FORCE]), Ok([2.0 + 0.05 * (3.0 - 0.5 * 0.05 * 4.0)]));
    // the host's tolerance counts where it is smaller than the model's, and where steps are not fixed
    let own = Integration::ErrorControlled { tolerance: 1e-6, longest: 0.1 };
    for integration in [own, Integration::Fixed { step: 0.005 }] {
        let crane = example::integrated(&example::crane(), integration);
        let reached = |tolerance: f64| {
            let host = Host::of(&crane);
            assert_eq!(host.set(&STARTS, &[0.1, 0.5, -0.2, 0.3]), Status::Ok);
            assert_eq!(unsafe { fmi2SetupExperiment(host.c, 1, tolerance, 0.0, 0, 0.0) }, Status::Ok);
            assert_eq!((host.enter(), host.exit(), host.step(0.0, 0.5)), (Status::Ok, Status::Ok, Status::Ok));
            host.try_get(STATES).unwrap()
        };
        let [none, tight] = [None, Some(1e-9)].map(|tolerance| advanced(&crane, 0.0, [0.0; 2], 0.5, tolerance));
        assert_eq!([reached(1e-3), reached(1e-9)], [none, tight]);
        assert_eq!(none == tight, integration != own);
    }
    for tolerance in [-1.0, f64::NAN] {
        let host = Host::of(&example::crane());
        assert_eq!(unsafe { fmi2SetupExperiment(host.c, 1, tolerance, 0.0, 0, 0.0) }, Status::Error);
        assert!(host.message().contains("is negative or not finite"));
    }
}

#[test]
fn a_state_beyond_every_plausible_value_ends_the_step_with_an_error_that_names_it() {
    let limit = example::crane().states()[0].limit();
    for integration in
        [Integration::Fixed { step: 0.005 }, Integration::ErrorControlled { tolerance: 1e-6, longest: 0.1 }]
    {
        let host = Host::of(&example::integrated(&example::crane(), integration));
        assert_eq!(host.set(&STARTS, &[limit - 0.1, 0.5, 2.0, 0.3]), Status::Ok);
        assert_eq!(unsafe { fmi2SetupExperiment(host.c, 0, 0.0, 0.0, 0, 0.0) }, Status::Ok);
        assert_eq!((host.enter(), host.exit()), (Status::Ok, Status::Ok));
        assert_eq!(host.step(0.0, 0.2), Status::Error);
        let message = host.message();
        assert!(message.contains("s after the beginning of the step, state `trolley.position` is "), "{message}");
        assert!(message.contains("which is not plausible: expected the training range from "), "{message}");
    }
}

#[test]
fn a_solver_sets_states_and_reads_their_derivatives() {
    let host = solving();
    assert_eq!(continuous_states(&host), [0.1, 0.5, -0.2, 0.3]);
    let mut nominals = [0.0; 4];
    assert_eq!(unsafe { fmi2GetNominalsOfContinuousStates(host.c, nominals.as_mut_ptr(), 4) }, Status::Ok);
    assert_eq!(nominals, [1.0; 4]);
    assert_eq!(unsafe { fmi2SetContinuousStates(host.c, [0.4, 0.9, -1.2, 2.0].as_ptr(), 4) }, Status::Ok);
    assert_eq!(host.set(&[FORCE], &[3.0]), Status::Ok);
    let mut evaluator = Evaluator::new(&example::crane());
    let mut results = [0.0; 11];
    let point = [1.5, 0.1, 0.5, -0.2, 0.3, 3.0, 0.4, 0.9, -1.2, 2.0];
    evaluator.evaluate(&point, &mut results);
    assert_eq!(derivatives(&host), results[7..]);
    assert_eq!(host.try_get(RATES), Ok(derivatives(&host)));
    assert_eq!(host.try_get(LOAD), Ok([results[2], results[3], results[4]]));
    for (count, why) in [(3, "3 elements, expected 4"), (5, "5 elements, expected 4")] {
        let host = solving();
        assert_eq!(unsafe { fmi2SetContinuousStates(host.c, [0.0; 5].as_ptr(), count) }, Status::Error);
        assert!(host.message().contains(why));
    }
}

#[test]
fn what_a_solver_tries_that_is_not_finite_is_discarded_and_it_goes_on() {
    let host = solving();
    let (before, rates) = (continuous_states(&host), derivatives(&host));
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let tried = [0.0, value, 0.0, 0.0];
        assert_eq!(unsafe { fmi2SetContinuousStates(host.c, tried.as_ptr(), 4) }, Status::Discard);
        assert!(host.message().contains("is not finite; the states stay what they were"));
        assert_eq!(host.set(&[FORCE], &[value]), Status::Discard);
        assert!(host.message().contains("`force` (value reference 6): "));
        assert_eq!((continuous_states(&host), derivatives(&host)), (before, rates));
    }
    assert_eq!(unsafe { fmi2SetContinuousStates(host.c, [0.4, 0.9, -1.2, 2.0].as_ptr(), 4) }, Status::Ok);
    assert_eq!((host.complete(), host.set_time(0.1)), (Status::Ok, Status::Ok));
    // no solver tries a time that is NaN
    assert_eq!(host.set_time(f64::NAN), Status::Error);
}

#[test]
fn a_solver_may_set_a_state_as_a_variable() {
    let host = solving();
    assert_eq!(host.set(&[STATES[2], FORCE, STATES[1]], &[-1.2, 3.0, 0.9]), Status::Ok);
    assert_eq!(continuous_states(&host), [0.1, 0.9, -1.2, 0.3]);
    let expected = derivatives(&host);
    let host = solving();
    assert_eq!(host.set(&[FORCE], &[3.0]), Status::Ok);
    assert_eq!(unsafe { fmi2SetContinuousStates(host.c, [0.1, 0.9, -1.2, 0.3].as_ptr(), 4) }, Status::Ok);
    assert_eq!(derivatives(&host), expected);
    // neither at an event nor in co-simulation
    assert_eq!((host.event(), host.set(&STATES[..1], &[1.0])), (Status::Ok, Status::Error));
}

#[test]
fn directional_derivatives_have_the_states_among_the_knowns() {
    let host = solving();
    let directional = |unknown: u32, known: u32| {
        let mut result = f64::NAN;
        let status = unsafe { fmi2GetDirectionalDerivative(host.c, &unknown, 1, &known, 1, &1.0, &mut result) };
        assert_eq!(status, Status::Ok, "{:?}", host.messages());
        result
    };
    // the load is at x + l sin theta
    assert_eq!((directional(LOAD[0], STATES[0]), directional(LOAD[0], STATES[1])), (1.0, 1.5 * 0.5f64.cos()));
    assert_eq!((directional(RATES[0], STATES[2]), directional(RATES[1], STATES[2])), (1.0, 0.0));
    assert_eq!(directional(LOAD[0], STARTS[0]), 0.0, "the run has begun");
    let cosine = 0.5f64.cos();
    assert!((directional(RATES[2], FORCE) - 1.0 / (3.0 - cosine * cosine)).abs() < 1e-15);
    let host = of_kind(CO_SIMULATION);
    assert_eq!(host.enter(), Status::Ok);
    let mut result = f64::NAN;
    for (unknown, expected) in [(LOAD[0], 1.5 * cosine), (STATES[1], 1.0), (STATES[0], 0.0)] {
        let status = unsafe { fmi2GetDirectionalDerivative(host.c, &unknown, 1, &STARTS[1], 1, &1.0, &mut result) };
        assert_eq!((status, result), (Status::Ok, expected), "{unknown}");
    }
}

#[test]
fn derivatives_of_outputs_follow_the_motion() {
    let host = stepping();
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    let [velocity, acceleration] = host.try_get([LOAD[1], LOAD[2]]).unwrap();
    let mut found = [f64::NAN; 2];
    let references = [LOAD[0], LOAD[0]];
    let status =
        unsafe { fmi2GetRealOutputDerivatives(host.c, references.as_ptr(), 2, [1, 2].as_ptr(), found.as_mut_ptr()) };
    assert_eq!(status, Status::Ok);
    assert!((found[0] - velocity).abs() < 1e-14 && (found[1] - acceleration).abs() < 1e-13, "{found:?}");
}

#[test]
fn an_input_that_is_clamped_has_no_rate() {
    let second_derivative = |rate: f64| {
        let host = stepping();
        assert_eq!(unsafe { fmi2SetInteger(host.c, &POLICY, 1, &1) }, Status::Ok);
        assert_eq!((host.set(&[FORCE], &[99.0]), host.step(0.0, 0.1)), (Status::Ok, Status::Ok));
        assert_eq!(unsafe { fmi2SetRealInputDerivatives(host.c, &FORCE, 1, &1, &rate) }, Status::Ok);
        let mut found = f64::NAN;
        assert_eq!(unsafe { fmi2GetRealOutputDerivatives(host.c, &STATES[2], 1, &2, &mut found) }, Status::Ok);
        found
    };
    assert_eq!(second_derivative(7.0), second_derivative(0.0));
}

#[test]
fn a_saved_state_goes_on_to_the_last_bit() {
    let host = stepping();
    assert_eq!((host.set(&[FORCE], &[2.0]), host.step(0.0, 0.1)), (Status::Ok, Status::Ok));
    let state = host.save();
    let bytes = host.serialize(state);
    let go_on = |host: &Host| {
        assert_eq!((host.step(0.1, 0.1), host.step(0.2, 0.05)), (Status::Ok, Status::Ok));
        host.try_get(STATES).unwrap()
    };
    let expected = go_on(&host);
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(go_on(&host), expected);
    host.free_state(state);
    let other = stepping();
    let state = other.deserialize(&bytes).unwrap();
    assert_eq!(other.restore(state), Status::Ok);
    assert_eq!(go_on(&other), expected);
    other.free_state(state);
    assert_eq!(other.reset(), Status::Ok);
    other.initialize(0.0);
    assert_eq!(other.try_get(STATES), Ok([0.0, 0.3, 0.0, 0.0]), "the start values again");
}

#[test]
fn neither_steps_nor_derivatives_allocate() {
    let (host, solver) = (stepping(), solving());
    let once = |time: f64| {
        assert_eq!(host.step(time, 0.01), Status::Ok);
        host.try_get(LOAD).unwrap();
        derivatives(&solver);
    };
    once(0.0);
    let before = allocations().0;
    (1..50).for_each(|step| once(f64::from(step) * 0.01));
    assert_eq!(allocations().0, before);
}

#[test]
fn what_leaves_the_domain_or_cannot_be_computed_is_said() {
    // a trolley beyond its rail
    let host = stepping();
    assert_eq!(host.set(&[FORCE], &[10.0]), Status::Ok);
    assert!((0..80).all(|step| host.step(f64::from(step) * 0.1, 0.1) == Status::Ok));
    // said once
    let message = host.message();
    assert!(message.contains("variable `trolley.position`: 5"), "{message}");
    assert!(message.contains("outside the training range from -5 to 5; outputs are extrapolated"), "{message}");
    // policy 2 refuses it, and the state is as before
    let host = stepping();
    assert_eq!(unsafe { fmi2SetInteger(host.c, &POLICY, 1, &2) }, Status::Ok);
    assert_eq!(host.set(&[FORCE], &[10.0]), Status::Ok);
    let mut time = 0.0;
    let last = loop {
        let before = host.try_get(STATES).unwrap();
        if host.step(time, 0.1) != Status::Ok {
            break before;
        }
        time += 0.1;
    };
    assert!((4.0..=5.0).contains(&last[0]), "{last:?}");
    assert!(host.message().contains("and domain_policy is 2"));
    assert_eq!(host.try_get(STATES), Ok(last));
    // without a rope there is no mass
    let host = Host::of(&example::crane());
    assert_eq!(host.set(&[ROPE], &[0.0]), Status::Ok);
    host.initialize(0.0);
    host.messages();
    assert_eq!(host.step(0.0, 0.1), Status::Error);
    assert!(host.message().contains("the states are not finite"));
    // FMI 2.0 lets a solver discard what it reads, and co-simulation not
    for (kind, refused) in [(CO_SIMULATION, Status::Error), (MODEL_EXCHANGE, Status::Discard)] {
        let host = Host::of_kind(&example::crane(), kind);
        assert_eq!(host.set(&[ROPE], &[0.0]), Status::Ok);
        host.initialize(0.0);
        host.messages();
        assert_eq!(host.try_get(RATES), Err(refused));
        assert!(host.message().contains("a mass matrix is not positive definite"));
        let mut slope = 0.0;
        let status = unsafe { fmi2GetDirectionalDerivative(host.c, &RATES[2], 1, &FORCE, 1, &1.0, &mut slope) };
        assert_eq!(status, Status::Error);
        assert!(host.message().contains("a mass matrix is not positive definite"));
    }
    // a step that would take hours
    let host = stepping();
    assert_eq!(host.step(0.0, 1e9), Status::Error);
    assert!(host.message().contains("takes more than ten million steps of the solver"));
}

#[test]
fn error_bounds_grow_with_the_time_since_the_start() {
    let bounds = [26, 27];
    let at_start = 5.0;
    for kind in [CO_SIMULATION, MODEL_EXCHANGE] {
        let host = Host::of_kind(&example::with_growing_bounds(), kind);
        host.set_up(at_start);
        assert_eq!((host.enter(), host.exit()), (Status::Ok, Status::Ok));
        assert_eq!(host.try_get(bounds), Ok([0.125, 0.25]));
        // what the time is, the bounds, and the first one's derivative
        for (elapsed, expected, slope) in
            [(0.5, [0.125, 0.25], 0.0), (1.5, [0.25, 0.5], 0.25), (7.0, [0.375, 0.75], 0.0)]
        {
            let host = Host::of_kind(&example::with_growing_bounds(), kind);
            host.set_up(at_start);
            assert_eq!((host.enter(), host.exit()), (Status::Ok, Status::Ok));
            if kind == CO_SIMULATION {
                assert_eq!(host.step(at_start, elapsed), Status::Ok);
                let mut rate = f64::NAN;
                assert_eq!(unsafe { fmi2GetRealOutputDerivatives(host.c, &bounds[0], 1, &1, &mut rate) }, Status::Ok);
                assert_eq!(rate, slope, "{elapsed}");
            } else {
                assert_eq!(
                    (host.go_on(), unsafe { fmi2SetTime(host.c, at_start + elapsed) }),
                    (Status::Ok, Status::Ok)
                );
            }
            assert_eq!(host.try_get(bounds), Ok(expected), "{elapsed}");
            let mut change = f64::NAN;
            let status =
                unsafe { fmi2GetDirectionalDerivative(host.c, &bounds[0], 1, &STATES[0], 1, &1.0, &mut change) };
            assert_eq!((status, change), (Status::Ok, 0.0));
        }
    }
}
