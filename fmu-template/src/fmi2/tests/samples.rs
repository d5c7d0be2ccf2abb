//! A surrogate that goes on from sample to sample: [`example::recorded`].

use super::*;
use metafmu_runtime::{Program, graph::Step};

const STARTS: [u32; 2] = [1, 2];
const FORCE: u32 = 3;
const POSITION: [u32; 1] = [4];
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
