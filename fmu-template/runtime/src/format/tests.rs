use super::*;
use crate::{Activation, Bounds, Encoding, Precision, Role, Variability, example};

#[test]
fn a_file_gives_the_surrogate_back_and_the_same_bytes_again() {
    let single = example::with_precision(&[7, 3], Activation::Sigmoid, Precision::Single);
    let series = example::series(&[7, 3], Activation::Tanh, Precision::Double);
    let encoded = [&single, &series].map(example::encoded);
    let surrogates =
        [example::surrogate(), example::with_input(), example::with_arrays(), example::with_bounds(), single, series];
    for surrogate in surrogates.into_iter().chain(encoded) {
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
fn a_plain_encoding_is_what_a_file_without_the_field_means() {
    let text = |surrogate: &Surrogate| serde_json::to_string(surrogate.metadata()).unwrap();
    assert!(!text(&example::surrogate()).contains("encoding"));
    let encoded = text(&example::encoded(&example::surrogate()));
    assert!(encoded.contains(r#""start":0.14,"encoding":{"nominal":[0.14,0.1,0.2]}}"#), "{encoded}");
    assert!(encoded.contains(r#""encoding":"periodic"}"#), "{encoded}");
}

#[test]
fn encodings_that_make_no_sense_are_refused_by_name() {
    let surrogate = example::encoded(&example::surrogate());
    let refused = |change: &dyn Fn(&mut Metadata)| {
        let mut metadata = surrogate.metadata().clone();
        change(&mut metadata);
        Surrogate::new(metadata, surrogate.model().clone()).unwrap_err().to_string()
    };
    let values =
        |values: &'static [f64]| refused(&|metadata| metadata.inputs[0].encoding = Encoding::Nominal(values.into()));
    let sense = |input: &str, expected: &str| format!("variable `{input}`: its encoding makes no sense, {expected}");
    for wrong in [&[][..], &[0.1], &[0.1, 0.2, 0.1], &[0.1, f64::NAN, 0.2], &[0.1, f64::INFINITY]] {
        assert_eq!(values(wrong), sense("length", "nominal values are at least two, finite and distinct"), "{wrong:?}");
    }
    let range = "the range is from the smallest to the largest nominal value";
    assert_eq!(values(&[0.1, 0.14, 0.3]), sense("length", range));
    let start = refused(&|metadata| metadata.inputs[0].start = 0.15);
    assert_eq!(start, sense("length", "the start is one of the nominal values"));
    let period = refused(&|metadata| metadata.inputs[1].max = metadata.inputs[1].min);
    assert_eq!(period, sense("speed", "a period is longer than zero"));
    let time = refused(&|metadata| metadata.inputs[2].encoding = Encoding::Periodic);
    assert_eq!(time, sense("time", "the time is its own column"));
    // six columns, and with another encoding as many as are left
    let columns = |found: &str, expected: &str| format!("tensor `input_mean` has shape {found}, expected {expected}");
    assert_eq!(refused(&|metadata| metadata.inputs[1].encoding = Encoding::Plain), columns("[6]", "[5]"));
    let fewer = refused(&|metadata| {
        metadata.inputs[0].encoding = Encoding::Nominal(vec![0.1, 0.2]);
        metadata.inputs[0].start = 0.1;
    });
    assert_eq!(fewer, columns("[6]", "[5]"));
    let text = serde_json::to_string(surrogate.metadata()).unwrap();
    for unknown in [r#""spiral""#, r#"{"nominal":["a"]}"#, "3"] {
        let text = text.replace(r#""periodic""#, unknown);
        assert!(serde_json::from_str::<Metadata>(&text).is_err(), "{unknown}");
    }
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
    Surrogate::new(metadata, surrogate.model().clone())
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
    assert_eq!(of(&["x", "y", "x"]), "array `swapped`: output `x` is duplicated");
    assert_eq!(
        refused(&|metadata| metadata.outputs[1].unit = "mm".into()),
        "array `position`: output `y` is in `mm`, expected `m` as the first element"
    );
    for name in ["length", "x", "position"] {
        let twice = refused(&|metadata| metadata.arrays[1].name = name.into());
        assert_eq!(twice, format!("variable `{name}` is duplicated"));
    }
}

#[test]
fn error_bounds_that_make_no_sense_are_refused() {
    let refused = |coverage: f64, half_widths: &[f64]| {
        let bounds = Bounds { coverage, runs: 100, half_widths: half_widths.into() };
        changed(|metadata| metadata.bounds = Some(bounds)).unwrap_err().to_string()
    };
    assert_eq!(refused(0.9, &[0.1]), "1 error bounds, expected 2: one for each output");
    assert_eq!(refused(1.0, &[0.1, 0.2]), "error bounds: coverage 1 makes no sense");
    assert_eq!(refused(0.9, &[0.1, -0.2]), "error bounds: half-width -0.2 makes no sense");
    assert_eq!(refused(0.9, &[f64::NAN, 0.2]), "error bounds: half-width NaN makes no sense");
    let taken = changed(|metadata| {
        metadata.bounds = example::with_bounds().bounds().cloned();
        metadata.inputs[0].name = "x_bound".into();
    });
    assert_eq!(taken.unwrap_err().to_string(), "variable `x_bound` is duplicated");
}

#[test]
fn value_references_of_bounds_follow_the_arrays() {
    assert_eq!([0, 1].map(|output| example::with_bounds().bound_value_reference(output)), [11, 12]);
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
    no_damage_panics(&example::with_arrays());
    no_damage_panics(&example::series(&[3], Activation::Tanh, Precision::Double));
}

fn no_damage_panics(surrogate: &Surrogate) {
    let bytes = surrogate.to_bytes().unwrap();
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

fn good() -> Vec<u8> {
    example::surrogate().to_bytes().unwrap()
}

/// The error of the example's file with a changed description.
fn described(from: &str, to: &str) -> FormatError {
    let bytes = good();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    assert!(header.contains(from), "{from} is not in {header}");
    rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..])
}

fn rebuilt(header: &str, data: &[u8]) -> FormatError {
    let length = (header.len() as u64).to_le_bytes();
    Surrogate::from_bytes(&[&length, header.as_bytes(), data].concat()).unwrap_err()
}

/// The error of the example's parts after a change of them.
fn assembled(change: impl Fn(&mut Metadata, &mut Scaling, &mut Vec<Layer>)) -> FormatError {
    let surrogate = example::surrogate();
    let mut metadata = surrogate.metadata().clone();
    let ScaledNetwork { mut scaling, mut layers } = surrogate.network().unwrap().clone();
    change(&mut metadata, &mut scaling, &mut layers);
    Surrogate::new(metadata, Model::Network(ScaledNetwork { scaling, layers })).unwrap_err()
}

#[test]
fn a_file_reads_back_as_the_same_surrogate_and_writes_the_same_bytes() {
    let mut surrogate = example::surrogate();
    let mut metadata = surrogate.metadata().clone();
    // numbers whose shortest decimals a careless reader gets wrong in the last bit
    metadata.outputs[0].min = -113.09733552923255;
    metadata.outputs[1].max = 9.869604401089358e22;
    surrogate = Surrogate::new(metadata, surrogate.model().clone()).unwrap();
    let bytes = surrogate.to_bytes().unwrap();
    let again = Surrogate::from_bytes(&bytes).unwrap();
    assert_eq!(again, surrogate);
    assert!(again.to_bytes().unwrap() == bytes);
}

#[test]
fn a_file_cut_short_anywhere_is_refused() {
    let bytes = good();
    for length in (0..bytes.len()).step_by(7).chain([bytes.len() - 1]) {
        assert!(matches!(Surrogate::from_bytes(&bytes[..length]), Err(FormatError::Container(_))), "{length}");
    }
    assert!(matches!(Surrogate::from_bytes(b"no container at all"), Err(FormatError::Container(_))));
}

#[test]
fn a_container_of_another_program_is_told_apart() {
    assert!(matches!(described("\"metafmu\":", "\"other\":"), FormatError::NoMetadata));
    let header = r#"{"weight":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
    assert!(matches!(rebuilt(header, &[0; 4]), FormatError::NoMetadata));
}

#[test]
fn a_description_that_is_wrong_is_refused_with_its_reason() {
    for (from, to, says) in [
        (r#"\"time_step\":0.01"#, r#"\"time_step\":\"x\""#, "expected f64"),
        (r#"\"time_step\":0.01,"#, "", "missing field `time_step`"),
        (r#"\"time_step\""#, r#"\"colour\":1,\"time_step\""#, "unknown field `colour`"),
        (r#"\"tanh\""#, r#"\"softmax\""#, "unknown variant `softmax`"),
        (r#"\"format\":1"#, r#"\"format\":2"#, "model file format 2, expected 1"),
        (r#"{\"format\""#, r#"{{\"format\""#, "metadata entry"),
    ] {
        let message = described(from, to).to_string();
        assert!(message.contains(says), "{message}");
    }
}

#[test]
fn tensors_that_are_missing_unknown_or_of_the_wrong_kind_are_named() {
    let missing = described("layers.1.bias", "layers.1.bius");
    assert!(matches!(missing, FormatError::MissingTensor { name } if name == "layers.1.bias"));
    // without its weight, the second layer is not looked for, and what is left of it means nothing
    let unknown = described("layers.1.weight", "layers.7.weight");
    assert!(matches!(unknown, FormatError::UnknownTensor { name } if name == "layers.1.bias"));
    let kind = described(r#""layers.0.bias":{"dtype":"F32""#, r#""layers.0.bias":{"dtype":"I32""#);
    assert!(matches!(kind, FormatError::Type { name, found, .. } if name == "layers.0.bias" && found == "I32"));
    let shape = described(r#""dtype":"F32","shape":[16,3]"#, r#""dtype":"F32","shape":[48]"#);
    assert!(matches!(shape, FormatError::Shape { name, .. } if name == "layers.0.weight"));
    let shape = described(r#""dtype":"F32","shape":[16,3]"#, r#""dtype":"F32","shape":[3,16]"#);
    assert!(matches!(shape, FormatError::Shape { found, expected, .. } if found == [3, 16] && expected == [3, 3]));
}

#[test]
fn numbers_that_cannot_be_are_located() {
    let error = assembled(|_, _, layers| layers[1].weight[5] = f32::NAN);
    assert!(matches!(error, FormatError::NotFinite { name, index: 5, .. } if name == "layers.1.weight"));
    let error = assembled(|_, scaling, _| scaling.output_mean[1] = f64::INFINITY);
    assert!(matches!(error, FormatError::NotFinite { name, index: 1, .. } if name == "output_mean"));
    let error = assembled(|_, scaling, _| scaling.input_scale[2] = 0.0);
    assert!(matches!(error, FormatError::NotPositive { name, index: 2, .. } if name == "input_scale"));
    let error = assembled(|_, scaling, _| scaling.input_mean.truncate(1));
    assert!(matches!(error, FormatError::Shape { name, .. } if name == "input_mean"));
    assert!(matches!(assembled(|_, _, layers| layers.clear()), FormatError::MissingTensor { .. }));
}

#[test]
fn variables_that_cannot_be_are_named() {
    let error = assembled(|metadata, _, _| metadata.inputs.clear());
    assert!(matches!(error, FormatError::NoVariables { what: "inputs" }));
    let error = assembled(|metadata, _, _| metadata.outputs.clear());
    assert!(matches!(error, FormatError::NoVariables { what: "outputs" }));
    let error = assembled(|metadata, _, _| metadata.outputs[1].name = "length".into());
    assert!(matches!(error, FormatError::DuplicateVariable { name } if name == "length"));
    let error = assembled(|metadata, _, _| metadata.inputs[1].min = 7.0);
    assert!(matches!(error, FormatError::EmptyRange { name, .. } if name == "speed"));
    let error = assembled(|metadata, _, _| metadata.inputs[1].start = 7.0);
    assert!(matches!(error, FormatError::StartOutsideRange { name, .. } if name == "speed"));
    let error = assembled(|metadata, _, _| metadata.inputs[1].role = metadata.inputs[2].role);
    assert!(matches!(error, FormatError::SeveralTimes { count: 2 }));
    let error = assembled(|metadata, _, _| metadata.time_step = 0.0);
    assert!(matches!(error, FormatError::TimeStep { .. }));
    let error = assembled(|metadata, _, _| metadata.provenance.content_digest = "abc".into());
    assert!(matches!(error, FormatError::Digest { .. }));
}

fn series() -> Surrogate {
    example::series(&[5, 3], Activation::Tanh, Precision::Double)
}

#[test]
fn a_series_is_a_file_whose_tensors_have_the_instant_in_front() {
    let bytes = series().to_bytes().unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    for (name, shape) in [
        ("instants", &[4][..]),
        ("input_mean", &[4, 2]),
        ("layers.0.weight", &[4, 5, 2]),
        ("layers.1.bias", &[4, 3]),
        ("layers.2.weight", &[4, 2, 3]),
        ("output_scale", &[4, 2]),
    ] {
        assert_eq!(file.tensor(name).unwrap().shape(), shape, "{name}");
    }
    let Model::Series { networks, .. } = series().model().clone() else { unreachable!("it is a series") };
    let third: Vec<f32> = elements(&file.tensor("layers.1.weight").unwrap().data()[2 * 60..][..60], f32::from_le_bytes);
    assert_eq!(third, networks[2].layers[1].weight);
}

/// The error of the example series' file with a changed header.
fn series_described(from: &str, to: &str) -> String {
    let bytes = series().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    assert!(header.contains(from), "{from} is not in {header}");
    rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string()
}

#[test]
fn tensors_of_a_series_that_are_missing_or_of_the_wrong_shape_are_named() {
    // without its instants it is taken for a single network, with a dimension too many
    let other = series_described("\"instants\":", "\"instance\":");
    assert_eq!(other, "tensor `input_mean` has shape [4, 2], expected [4]");
    let count = series_described(r#""F32","shape":[4,5,2]"#, r#""F32","shape":[2,10,2]"#);
    assert_eq!(count, "tensor `layers.0.weight` has shape [2, 10, 2], expected [4, 10, 2]");
    let dimensions = series_described(r#""F32","shape":[4,5,2]"#, r#""F32","shape":[20,2]"#);
    assert_eq!(dimensions, "tensor `layers.0.weight` has shape [20, 2], expected [20, 2, 1]");
    let turned = series_described(r#""F32","shape":[4,5,2]"#, r#""F32","shape":[4,2,5]"#);
    assert_eq!(turned, "instant 0: tensor `layers.0.weight` has shape [2, 5], expected [2, 2]");
    assert_eq!(series_described("layers.2.bias", "layers.2.bius"), "tensor `layers.2.bias` is missing");
}

#[test]
fn a_series_that_makes_no_sense_is_refused() {
    type Change<'a> = &'a dyn Fn(&mut Metadata, &mut Vec<f64>, &mut Vec<ScaledNetwork>);
    let changes: [(&str, Change); 9] = [
        ("no input is the time", &|metadata, _, _| {
            (metadata.inputs[2].role, metadata.inputs[2].name) = (Role::Input, "load".into());
        }),
        ("no input beside the time", &|metadata, _, _| drop(metadata.inputs.drain(..2))),
        ("1 instants, expected at least 2", &|_, instants, _| instants.truncate(1)),
        ("tensor `instants`, element 2: NaN is not finite", &|_, instants, _| instants[2] = f64::NAN),
        ("tensor `instants`, element 2: 0.5 is not above 0.5", &|_, instants, _| instants[2] = 0.5),
        ("3 networks, expected 4, one for each instant", &|_, _, networks| networks.truncate(3)),
        ("instant 3: tensor `output_scale`, element 1: 0 is not positive", &|_, _, networks| {
            networks[3].scaling.output_scale[1] = 0.0;
        }),
        ("instant 1: tensor `layers.0.bias`, element 4: NaN is not finite", &|_, _, networks| {
            networks[1].layers[0].bias[4] = f32::NAN;
        }),
        ("instant 2: layers of sizes [2], expected [5, 3, 2] as at the first instant", &|_, _, networks| {
            networks[2].layers = vec![Layer { inputs: 2, outputs: 2, weight: vec![0.0; 4], bias: vec![0.0; 2] }];
        }),
    ];
    for (expected, change) in changes {
        let surrogate = series();
        let mut metadata = surrogate.metadata().clone();
        let Model::Series { mut instants, mut networks } = surrogate.model().clone() else {
            unreachable!("it is a series")
        };
        change(&mut metadata, &mut instants, &mut networks);
        let message = Surrogate::new(metadata, Model::Series { instants, networks }).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}
