//! Tests of a discrete-time surrogate: [`example::recorded`].

use super::*;
use metafmu_runtime::{Program, graph::Step};

const STARTS: [u32; 2] = [2, 3];
const FORCE: u32 = 4;
const POSITION: [u32; 1] = [5];
const IN_DOMAIN: u32 = 7;
// 9 is the time, of FMI 3.0
const USE_MEASURED: u32 = 10;
const MEASURED: u32 = 11;
/// In seconds.
const SAMPLE: f64 = 0.1;

fn stepping() -> Host {
    let host = Host::of(&example::recorded());
    assert_eq!(host.set(&STARTS, &[0.4, 0.25]), Status::Ok);
    host.initialize(0.0);
    host
}

#[test]
fn it_begins_with_the_parameters_for_the_start_and_is_linear_between_samples() {
    let host = stepping();
    assert_eq!(host.try_get(POSITION), Ok([0.4]));
    assert_eq!(host.set(&[FORCE], &[1.0]), Status::Ok);
    assert_eq!(host.step(0.0, 0.25 * SAMPLE), Status::Ok);
    let [quarter] = host.try_get(POSITION).unwrap();
    // an input between samples counts for none
    assert_eq!(host.set(&[FORCE], &[-3.0]), Status::Ok);
    assert_eq!(host.try_get(POSITION), Ok([quarter]));
    assert_eq!(host.step(0.25 * SAMPLE, 0.75 * SAMPLE), Status::Ok);
    let [whole] = host.try_get(POSITION).unwrap();
    assert!((quarter - (0.4 + 0.25 * (whole - 0.4))).abs() < 1e-14 && (whole - 0.4).abs() > 1e-2, "{quarter} {whole}");
}

#[test]
fn a_step_over_samples_does_not_allocate() {
    let host = stepping();
    assert_eq!(host.step(0.0, 2.5 * SAMPLE), Status::Ok);
    let before = allocations().0;
    assert_eq!((host.set(&[MEASURED], &[0.9]), use_measured(&host, true)), (Status::Ok, Status::Ok));
    assert_eq!(host.step(2.5 * SAMPLE, 3.0 * SAMPLE), Status::Ok);
    assert!(host.try_get(POSITION).is_ok());
    assert_eq!(allocations().0, before);
}

#[test]
fn there_are_no_derivatives_of_outputs_as_the_description_says() {
    let host = stepping();
    let mut slope = f64::NAN;
    assert_eq!(unsafe { fmi2GetRealOutputDerivatives(host.c, &POSITION[0], 1, &1, &mut slope) }, Status::Error);
    assert!(host.message().contains("they are linear between samples") && slope.is_nan());
}

#[test]
fn model_exchange_is_refused_with_a_sentence() {
    let folder = Folder::with(&example::recorded());
    let host = Host::instantiate(c"samples", MODEL_EXCHANGE, TOKEN, &folder.uri(), false);
    assert!(host.c.is_null());
    let message = host.message();
    assert!(message.contains("it is for co-simulation, not for model exchange"), "{message}");
}

#[test]
fn outputs_that_diverge_end_the_step_and_nothing_else() {
    let surrogate = example::recorded();
    let Program { mut graph, clock } = surrogate.program().clone();
    let Step::Affine { weight, .. } = &mut graph.steps[0] else { panic!("it has a linear part") };
    *weight = [1e200].into_iter().chain(weight.iter().skip(1)).collect::<Vec<f64>>().into();
    let surrogate = Surrogate::new(surrogate.metadata().clone(), Program { graph, clock }).unwrap();
    let host = Host::of(&surrogate);
    host.initialize(0.0);
    assert_eq!(host.step(0.0, SAMPLE), Status::Ok);
    let before: [f64; 1] = host.try_get(POSITION).unwrap();
    assert_eq!(host.step(SAMPLE, 2.0 * SAMPLE), Status::Error);
    let message = host.message();
    assert!(message.contains("the outputs are not finite at the sample 0.1 s after"), "{message}");
    assert_eq!(host.try_get(POSITION), Ok(before));
}

fn use_measured(host: &Host, on: bool) -> Status {
    unsafe { fmi2SetBoolean(host.c, &USE_MEASURED, 1, &on.into()) }
}

fn is_measured(host: &Host) -> c_int {
    let mut found = 7;
    assert_eq!(unsafe { fmi2GetBoolean(host.c, &USE_MEASURED, 1, &mut found) }, Status::Ok);
    found
}

#[test]
fn measured_outputs_count_from_the_next_sample_on_and_only_while_they_are_used() {
    let rows = |on: bool| {
        let host = stepping();
        assert_eq!((host.try_get([MEASURED]), is_measured(&host)), (Ok([0.0]), 0));
        assert_eq!(host.step(0.0, SAMPLE), Status::Ok);
        assert_eq!((host.set(&[MEASURED], &[0.9]), use_measured(&host, on)), (Status::Ok, Status::Ok));
        assert_eq!((host.try_get([MEASURED]), is_measured(&host)), (Ok([0.9]), on.into()));
        let now = host.try_get(POSITION);
        assert_eq!(host.step(SAMPLE, SAMPLE), Status::Ok);
        // the reset takes both back
        let after = host.try_get(POSITION);
        assert_eq!(host.reset(), Status::Ok);
        host.initialize(0.0);
        assert_eq!((host.try_get([MEASURED]), is_measured(&host)), (Ok([0.0]), 0));
        [now, after].map(|found: Result<[f64; 1], Status>| found.unwrap()[0])
    };
    let (used, unused) = (rows(true), rows(false));
    let host = stepping();
    assert_eq!(host.step(0.0, SAMPLE), Status::Ok);
    let now: [f64; 1] = host.try_get(POSITION).unwrap();
    assert_eq!(host.step(SAMPLE, SAMPLE), Status::Ok);
    assert_eq!([Ok(now), host.try_get(POSITION)], unused.map(|value| Ok([value])));
    assert!(used[0] == unused[0] && (used[1] - unused[1]).abs() > 0.1, "{used:?} {unused:?}");
}

#[test]
fn outputs_do_not_depend_on_measured_ones_at_once_as_the_description_says() {
    let host = stepping();
    assert_eq!((host.set(&[MEASURED], &[0.9]), use_measured(&host, true)), (Status::Ok, Status::Ok));
    assert_eq!(host.step(0.0, 0.5 * SAMPLE), Status::Ok);
    let mut slope = f64::NAN;
    let status = unsafe { fmi2GetDirectionalDerivative(host.c, &POSITION[0], 1, &MEASURED, 1, &1.0, &mut slope) };
    assert_eq!((status, slope), (Status::Ok, 0.0));
    let before: [f64; 1] = host.try_get(POSITION).unwrap();
    assert_eq!(host.set(&[MEASURED], &[-0.9]), Status::Ok);
    assert_eq!(host.try_get(POSITION), Ok(before));
    let status = unsafe { fmi2GetDirectionalDerivative(host.c, &POSITION[0], 1, &USE_MEASURED, 1, &1.0, &mut slope) };
    assert_eq!((status, slope), (Status::Ok, 0.0), "a switch");
}

#[test]
fn measured_outputs_follow_the_derivatives_that_a_host_gives() {
    let final_position = |pieces: u32| {
        let host = stepping();
        assert_eq!((host.set(&[MEASURED], &[0.5]), use_measured(&host, true)), (Status::Ok, Status::Ok));
        assert_eq!(unsafe { fmi2SetRealInputDerivatives(host.c, &MEASURED, 1, &1, &2.0) }, Status::Ok);
        let size = 6.0 * SAMPLE / f64::from(pieces);
        for piece in 0..pieces {
            assert_eq!(host.step(f64::from(piece) * size, size), Status::Ok);
        }
        let [measured] = host.try_get([MEASURED]).unwrap();
        assert!((measured - (0.5 + 2.0 * 6.0 * SAMPLE)).abs() < 1e-12, "{measured}");
        host.try_get(POSITION).unwrap()[0]
    };
    let whole = final_position(1);
    assert!([2, 3, 6].into_iter().all(|pieces| (final_position(pieces) - whole).abs() < 1e-12));
    assert!((whole - 0.5).abs() > 0.3, "{whole}");
}

#[test]
fn values_that_measured_inputs_cannot_have_are_refused_by_name() {
    for (call, message) in [
        (
            (|host: &Host| host.set(&[MEASURED], &[f64::NAN])) as fn(&Host) -> Status,
            "`position_measured` (value reference 11): NaN is not finite",
        ),
        (|host| host.set(&[USE_MEASURED], &[f64::NAN]), "`use_measured` (value reference 10): NaN is not finite"),
        (
            |host| unsafe { fmi2SetBoolean(host.c, &MEASURED, 1, &1) },
            "`position_measured` (value reference 11) is of type real, not Boolean",
        ),
        (
            |host| unsafe { fmi2SetBoolean(host.c, &IN_DOMAIN, 1, &1) },
            "`in_domain` (value reference 7) is computed and cannot be set",
        ),
    ] {
        let host = stepping();
        assert_eq!(call(&host), Status::Error);
        let found = host.message();
        assert!(found.contains(message), "{found}");
    }
}

#[test]
fn switch_and_policy_can_be_read_and_set_as_reals() {
    let (host, other) = (stepping(), stepping());
    for host in [&host, &other] {
        assert_eq!(host.set(&[MEASURED], &[0.9]), Status::Ok);
    }
    assert_eq!((use_measured(&host, true), other.set(&[USE_MEASURED], &[1.0])), (Status::Ok, Status::Ok));
    for host in [&host, &other] {
        assert_eq!(host.step(0.0, 2.0 * SAMPLE), Status::Ok);
        assert_eq!(host.try_get([USE_MEASURED, IN_DOMAIN, POLICY]), Ok([1.0, 1.0, 0.0]));
    }
    assert_eq!(host.try_get(POSITION), other.try_get(POSITION));
    assert!(host.try_get(POSITION) != stepping().try_get(POSITION));
}

#[test]
fn a_parameter_that_is_set_at_the_start_changes_the_memory() {
    let (early, late) = (Host::of(&example::recorded()), Host::of(&example::recorded()));
    early.set_up(0.0);
    assert_eq!((early.enter(), early.set(&STARTS, &[0.4, 0.25]), early.exit()), (Status::Ok, Status::Ok, Status::Ok));
    late.initialize(0.0);
    assert_eq!(late.set(&STARTS, &[0.4, 0.25]), Status::Ok);
    assert_eq!(early.try_get(POSITION), late.try_get(POSITION));
    assert_eq!((early.step(0.0, SAMPLE), late.step(0.0, SAMPLE)), (Status::Ok, Status::Ok));
    assert_eq!(early.try_get(POSITION), late.try_get(POSITION));
}
