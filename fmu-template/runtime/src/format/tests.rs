use super::*;
use crate::{Activation, Precision, Role, Variability, example};

#[test]
fn a_file_gives_the_surrogate_back_and_the_same_bytes_again() {
    let single = example::with_precision(&[7, 3], Activation::Sigmoid, Precision::Single);
    for surrogate in [example::surrogate(), example::with_input(), single] {
        let bytes = surrogate.to_bytes().unwrap();
        let again = Surrogate::from_bytes(&bytes).unwrap();
        assert_eq!(again, surrogate);
        assert_eq!(again.to_bytes().unwrap(), bytes);
    }
}

#[test]
fn double_precision_is_what_a_file_without_the_field_means() {
    let text = |precision| {
        let surrogate = example::with_precision(&[2], Activation::Tanh, precision);
        serde_json::to_string(surrogate.metadata()).unwrap()
    };
    assert!(!text(Precision::Double).contains("precision"));
    assert!(text(Precision::Single).contains(r#""precision":"single""#));
}

#[test]
fn roles_are_written_in_the_words_of_the_standard() {
    for (role, text) in [
        (Role::Input, r#"{"causality":"input"}"#),
        (Role::Time, r#"{"causality":"time"}"#),
        (Role::Parameter(Variability::Tunable), r#"{"causality":"parameter","variability":"tunable"}"#),
    ] {
        assert_eq!(serde_json::to_string(&role).unwrap(), text);
        assert_eq!(serde_json::from_str::<Role>(text).unwrap(), role);
    }
}

#[test]
fn names_of_the_variables_every_fmu_adds_are_refused() {
    for extra in crate::extra::ALL {
        let surrogate = example::surrogate();
        let (scaling, layers) = (surrogate.scaling().clone(), surrogate.layers().to_vec());
        let mut metadata = surrogate.metadata().clone();
        metadata.outputs[0].name = extra.name.into();
        let refused = Surrogate::new(metadata, scaling, layers).unwrap_err();
        assert!(matches!(&refused, FormatError::ReservedName { name } if name == extra.name), "{refused}");
    }
}

#[test]
fn value_references_of_the_added_variables_follow_the_outputs() {
    let surrogate = example::surrogate();
    let references = crate::extra::ALL.map(|extra| surrogate.extra_value_reference(&extra));
    assert_eq!(references, [5, 6, 7]);
}

/// Whatever a file holds, reading it ends in a surrogate that can be evaluated or in an error.
#[track_caller]
fn read(bytes: &[u8]) -> bool {
    let Ok(surrogate) = Surrogate::from_bytes(bytes) else { return false };
    let evaluator = crate::Evaluator::new(&surrogate);
    let inputs: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
    let mut outputs = vec![0.0; surrogate.outputs().len()];
    evaluator.evaluate(&inputs, &mut outputs, &mut evaluator.scratch());
    true
}

#[test]
fn no_damage_to_a_file_makes_reading_it_panic() {
    let bytes = example::surrogate().to_bytes().unwrap();
    for length in 0..bytes.len() {
        assert!(!read(&bytes[..length]), "cut to {length} bytes");
    }
    let header = 8 + u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    for position in 0..bytes.len() {
        for change in if position < header { &[0x01, 0x20, 0x80, 0xff][..] } else { &[0x80] } {
            let mut damaged = bytes.clone();
            damaged[position] ^= change;
            read(&damaged);
        }
    }
    // several bytes at once, with the multiplier of Knuth's MMIX for a generator
    let mut state = 1u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut readable = 0;
    for _ in 0..4_000 {
        let mut damaged = bytes.clone();
        for _ in 0..=random(6) {
            let end = if random(4) == 0 { bytes.len() } else { header };
            let position = random(end);
            damaged[position] = b"0123456789-eE.,:[]{}\"\\\0\xff"[random(24)];
        }
        if random(8) == 0 {
            let length = random(bytes.len());
            damaged.truncate(length);
        }
        readable += usize::from(read(&damaged));
    }
    assert!(readable > 0, "damage to the texts alone leaves a file readable");
}
