use super::*;
use crate::{Activation, Precision, Role, Variability, example};

#[test]
fn a_file_gives_the_surrogate_back_and_the_same_bytes_again() {
    let single = example::with_precision(&[7, 3], Activation::Sigmoid, Precision::Single);
    for surrogate in [example::surrogate(), example::with_input(), example::with_arrays(), single] {
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
        let changes: [&dyn Fn(&mut Metadata); 2] =
            [&|metadata| metadata.outputs[0].name = extra.name.into(), &|metadata| {
                metadata.arrays[1].name = extra.name.into()
            }];
        for change in changes {
            let refused = changed(change).unwrap_err();
            assert!(matches!(&refused, FormatError::ReservedName { name } if name == extra.name), "{refused}");
        }
    }
    let without_time = |array: &str| {
        changed(|metadata| {
            metadata.inputs[2].role = Role::Input;
            metadata.inputs[2].name = "load".into();
            metadata.arrays[0].name = array.into();
        })
    };
    assert_eq!(without_time("time").unwrap_err().to_string(), RESERVED_TIME);
    assert!(without_time("place").is_ok());
}

const RESERVED_TIME: &str = "variable `time`: the name is reserved for a variable that every FMU adds";

/// [`example::with_arrays`] with other metadata.
fn changed(change: impl FnOnce(&mut Metadata)) -> Result<Surrogate, FormatError> {
    let surrogate = example::with_arrays();
    let mut metadata = surrogate.metadata().clone();
    change(&mut metadata);
    Surrogate::new(metadata, surrogate.scaling().clone(), surrogate.layers().to_vec())
}

#[test]
fn a_file_without_arrays_is_written_as_before_there_were_any() {
    let text = |surrogate: Surrogate| serde_json::to_string(surrogate.metadata()).unwrap();
    assert!(!text(example::surrogate()).contains("arrays"));
    let elements = r#""arrays":[{"name":"position","description":"example array position","outputs":["x","y"]},"#;
    assert!(text(example::with_arrays()).contains(elements));
}

#[test]
fn an_array_has_the_unit_and_the_columns_of_its_outputs() {
    let surrogate = example::with_arrays();
    assert_eq!(surrogate.arrays().len(), 2);
    assert_eq!(surrogate.array_elements(0), ("m", &[0, 1][..]));
    assert_eq!(surrogate.array_elements(1), ("m", &[1, 0][..]));
}

#[test]
fn value_references_of_arrays_leave_room_for_the_time_whether_or_not_it_is_added() {
    let references = |surrogate: &Surrogate| [0, 1].map(|index| surrogate.array_value_reference(index));
    assert_eq!(references(&example::with_arrays()), [9, 10]);
    let without_time = changed(|metadata| {
        metadata.inputs[2].role = Role::Input;
        metadata.inputs[2].name = "load".into();
    });
    assert_eq!(references(&without_time.unwrap()), [9, 10]);
}

#[test]
fn arrays_that_make_no_sense_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut Metadata)| changed(change).unwrap_err().to_string();
    let of = |outputs: &'static [&str]| {
        refused(&|metadata| metadata.arrays[1].outputs = outputs.iter().map(|&name| name.into()).collect())
    };
    assert_eq!(of(&[]), "array `swapped` has 0 elements, expected at least 2");
    assert_eq!(of(&["x"]), "array `swapped` has 1 elements, expected at least 2");
    assert_eq!(of(&["x", "z"]), "array `swapped`: `z` is no output");
    assert_eq!(of(&["x", "length"]), "array `swapped`: `length` is no output");
    assert_eq!(of(&["x", "position"]), "array `swapped`: `position` is no output");
    assert_eq!(of(&["x", "y", "x"]), "array `swapped`: output `x` stands twice");
    assert_eq!(
        refused(&|metadata| metadata.outputs[1].unit = "mm".into()),
        "array `position`: output `y` is in `mm`, expected `m` as the first element"
    );
    for name in ["length", "x", "position"] {
        let twice = refused(&|metadata| metadata.arrays[1].name = name.into());
        assert_eq!(twice, format!("variable `{name}` stands twice"));
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
    let bytes = example::with_arrays().to_bytes().unwrap();
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
