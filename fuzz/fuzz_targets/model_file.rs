//! Whatever the bytes of a model file, reading it ends with a surrogate or an error, and what was read can be evaluated
//! and is written as something that reads the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use metafmu_runtime::{Evaluator, Surrogate};

fuzz_target!(|bytes: &[u8]| {
    let Ok(surrogate) = Surrogate::from_bytes(bytes) else { return };
    let mut evaluator = Evaluator::new(&surrogate);
    let (point, mut outputs) = (vec![0.5; evaluator.columns()], vec![0.0; evaluator.results()]);
    evaluator.evaluate(&point, &mut outputs);
    evaluator.directional(&point, &point, &mut outputs);
    evaluator.adjoint(&point, &outputs, &mut point.clone());

    let written = surrogate.to_bytes().expect("what was read can be written");
    let again = Surrogate::from_bytes(&written).expect("what was written can be read");
    assert_eq!(again.to_bytes().expect("and written again"), written);
});
