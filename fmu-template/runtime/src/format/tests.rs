use super::*;
use crate::{
    Bounds, BuiltIn, Encoding, Given, Integration, Precision, Quantity, Reactions, Role, Shown, Variability,
    dictionary::{Dictionary, Factor},
    example,
};

#[test]
fn a_file_gives_the_surrogate_back_and_the_same_bytes_again() {
    let single = example::with_precision(&[7, 3], Activation::Sigmoid, Precision::Single);
    let per_instant = example::per_instant(&[7, 3], Activation::Tanh, Precision::Double);
    let encoded = [&single, &per_instant].map(example::encoded);
    let surrogates = [
        example::surrogate(),
        example::with_input(),
        example::with_arrays(),
        example::with_bounds(),
        single,
        per_instant,
    ];
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
        assert!(Metadata::read(serde_json::from_str(&text).unwrap()).is_err(), "{unknown}");
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
        assert_eq!(Role::read(serde_json::from_str(text).unwrap()).unwrap(), role);
    }
}

#[test]
fn names_of_the_variables_every_fmu_adds_are_refused() {
    for built_in in BuiltIn::ALWAYS {
        let changes: [&dyn Fn(&mut Metadata); 2] =
            [&|metadata| metadata.outputs[0].name = built_in.name().into(), &|metadata| {
                metadata.arrays[1].name = built_in.name().into()
            }];
        for change in changes {
            let refused = changed(change).unwrap_err();
            assert!(matches!(&refused, FormatError::ReservedName { name } if name == built_in.name()), "{refused}");
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
fn a_value_reference_is_the_position_in_the_table_of_variables() {
    let references = |surrogate: &Surrogate, quantities: &[Quantity]| {
        quantities.iter().map(|&quantity| surrogate.variables().reference(quantity)).collect::<Vec<_>>()
    };
    let quantities = [
        Quantity::Input(2),
        Quantity::Output(1),
        Quantity::BuiltIn(BuiltIn::DomainPolicy),
        Quantity::BuiltIn(BuiltIn::DomainDistance),
        Quantity::BuiltIn(BuiltIn::Time),
        Quantity::Array(0),
        Quantity::Bound(1),
    ];
    let with_bounds = references(&example::with_bounds(), &quantities);
    assert_eq!(with_bounds, [Some(2), Some(4), Some(5), Some(7), None, Some(8), Some(11)]);
    let without_time = changed(|metadata| {
        metadata.inputs[2].role = Role::Input;
        metadata.inputs[2].name = "load".into();
    });
    let without_time = references(&without_time.unwrap(), &quantities);
    assert_eq!(without_time, [Some(2), Some(4), Some(5), Some(7), Some(8), Some(9), None]);
    let surrogate = example::with_bounds();
    let table: Vec<_> = surrogate.variables().iter().map(|(_, v)| (v.name.as_str(), v.only_fmi3)).collect();
    assert_eq!(
        table,
        [
            ("length", false),
            ("speed", false),
            ("time", false),
            ("x", false),
            ("y", false),
            ("domain_policy", false),
            ("in_domain", false),
            ("domain_distance", false),
            ("position", true),
            ("swapped", true),
            ("x_bound", false),
            ("y_bound", false),
        ]
    );
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
        let bounds = Bounds { coverage, runs: 100, times: Vec::new(), half_widths: half_widths.into() };
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
    no_damage_panics(&example::per_instant(&[3], Activation::Tanh, Precision::Double));
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
    Surrogate::new(metadata, Model::Response(Map::Network(ScaledNetwork { scaling, layers }))).unwrap_err()
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
        (r#"\"format\":4"#, r#"\"format\":1"#, "format 1, expected 4: an older metafmu wrote it; make it again"),
        (r#"\"format\":4"#, r#"\"format\":5"#, "format 5, expected 4: a newer metafmu wrote it; use that one"),
        (r#"\"model\":"#, r#"\"module\":"#, "the field `model` is missing"),
        (r#"\"response\""#, r#"\"impulse\""#, "unknown variant `impulse`"),
        (r#"\"identity\"]"#, r#"\"identity\",\"tanh\"]"#, "tensor `outputs.layers.2.weight` is missing"),
        (
            r#"\"map\":\"network\",\"activations\":[\"tanh\",\"identity\"]"#,
            r#"\"map\":\"graph\""#,
            "`outputs.graph.steps` is missing",
        ),
        (r#"{\"format\""#, r#"{{\"format\""#, "metadata entry"),
    ] {
        let message = described(from, to).to_string();
        assert!(message.contains(says), "{message}");
    }
}

#[test]
fn tensors_that_are_missing_unknown_or_of_the_wrong_kind_are_named() {
    let missing = described("layers.1.bias", "layers.1.bius");
    assert!(matches!(missing, FormatError::MissingTensor { name } if name == "outputs.layers.1.bias"));
    // with one activation less, the last layer is not looked for
    let unknown = described(r#"[\"tanh\",\"identity\"]"#, r#"[\"tanh\"]"#);
    assert!(matches!(unknown, FormatError::UnknownTensor { name } if name == "outputs.layers.1.bias"));
    let kind = described(r#""outputs.layers.0.bias":{"dtype":"F32""#, r#""outputs.layers.0.bias":{"dtype":"I32""#);
    assert_eq!(kind.to_string(), "tensor `outputs.layers.0.bias` is of type I32, expected F32 or F64");
    let shape = described(r#""dtype":"F32","shape":[16,3]"#, r#""dtype":"F32","shape":[48]"#);
    assert!(matches!(shape, FormatError::Shape { name, .. } if name == "outputs.layers.0.weight"));
    let shape = described(r#""dtype":"F32","shape":[16,3]"#, r#""dtype":"F32","shape":[3,16]"#);
    assert!(matches!(shape, FormatError::Shape { found, expected, .. } if found == [3, 16] && expected == [3, 3]));
}

#[test]
fn numbers_that_cannot_be_are_located() {
    let error = assembled(|_, _, layers| set(&mut layers[1].weight, 5, f32::NAN));
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

/// Puts another number in its place.
fn set(numbers: &mut Numbers, index: usize, value: f32) {
    let mut values = numbers.as_single().unwrap().to_vec();
    values[index] = value;
    *numbers = values.into();
}

fn per_instant() -> Surrogate {
    example::per_instant(&[5, 3], Activation::Tanh, Precision::Double)
}

#[test]
fn a_network_for_each_instant_is_a_file_whose_tensors_have_the_instant_in_front() {
    let bytes = per_instant().to_bytes().unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    for (name, shape) in [
        ("instants", &[4][..]),
        ("outputs.input_mean", &[4, 2]),
        ("outputs.layers.0.weight", &[4, 5, 2]),
        ("outputs.layers.1.bias", &[4, 3]),
        ("outputs.layers.2.weight", &[4, 2, 3]),
        ("outputs.output_scale", &[4, 2]),
    ] {
        assert_eq!(file.tensor(name).unwrap().shape(), shape, "{name}");
    }
    let Model::PerInstant { networks, .. } = per_instant().model().clone() else {
        unreachable!("it has networks for instants")
    };
    let third: Vec<f32> =
        elements(&file.tensor("outputs.layers.1.weight").unwrap().data()[2 * 60..][..60], f32::from_le_bytes);
    assert_eq!(networks[2].layers[1].weight, third.into());
}

/// The error of such a file with a changed header.
fn per_instant_described(from: &str, to: &str) -> String {
    let bytes = per_instant().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    assert!(header.contains(from), "{from} is not in {header}");
    rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string()
}

#[test]
fn tensors_for_each_instant_that_are_missing_or_of_the_wrong_shape_are_named() {
    let missing = per_instant_described("\"instants\":", "\"instance\":");
    assert_eq!(missing, "tensor `instants` is missing");
    let response = per_instant_described("per-instant", "response");
    assert_eq!(response, "tensor `outputs.input_mean` has shape [4, 2], expected [4]");
    let count = per_instant_described(r#""F32","shape":[4,5,2]"#, r#""F32","shape":[2,10,2]"#);
    assert_eq!(count, "tensor `outputs.layers.0.weight` has shape [2, 10, 2], expected [4, 10, 2]");
    let dimensions = per_instant_described(r#""F32","shape":[4,5,2]"#, r#""F32","shape":[20,2]"#);
    assert_eq!(dimensions, "tensor `outputs.layers.0.weight` has shape [20, 2], expected [20, 2, 1]");
    let turned = per_instant_described(r#""F32","shape":[4,5,2]"#, r#""F32","shape":[4,2,5]"#);
    assert_eq!(turned, "instant 0: tensor `layers.0.weight` has shape [2, 5], expected [2, 2]");
    assert_eq!(per_instant_described("layers.2.bias", "layers.2.bius"), "tensor `outputs.layers.2.bias` is missing");
}

#[test]
fn networks_for_instants_that_make_no_sense_is_refused() {
    type Change<'a> = &'a dyn Fn(&mut Metadata, &mut Vec<f64>, &mut Vec<ScaledNetwork>);
    let changes: [(&str, Change); 10] = [
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
            set(&mut networks[1].layers[0].bias, 4, f32::NAN);
        }),
        ("instant 2: layers of sizes [2], expected [5, 3, 2] as at the first instant", &|_, _, networks| {
            let (weight, bias) = (vec![0.0f32; 4].into(), vec![0.0f32; 2].into());
            networks[2].layers = vec![Layer { inputs: 2, outputs: 2, weight, bias, activation: Activation::Identity }];
        }),
        ("instant 3: layer 1 has another activation than at the first instant", &|_, _, networks| {
            networks[3].layers[1].activation = Activation::Relu;
        }),
    ];
    for (expected, change) in changes {
        let surrogate = per_instant();
        let mut metadata = surrogate.metadata().clone();
        let Model::PerInstant { mut instants, mut networks } = surrogate.model().clone() else {
            unreachable!("it has networks for instants")
        };
        change(&mut metadata, &mut instants, &mut networks);
        let message = Surrogate::new(metadata, Model::PerInstant { instants, networks }).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

/// The crane's model file with other tensors: what is wrong with it.
fn crane_with(change: impl Fn(&mut Motion)) -> String {
    let surrogate = example::crane();
    let Model::Motion(mut motion) = surrogate.model().clone() else { unreachable!("the crane moves") };
    change(&mut motion);
    let surrogate = Surrogate::new(surrogate.metadata().clone(), Model::Motion(motion));
    surrogate.map_or_else(|error| error.to_string(), |_| "nothing".into())
}

#[test]
fn a_motion_survives_the_round_trip_with_and_without_networks() {
    let moved = example::with_prescribed_trolley(&example::crane());
    for surrogate in [
        example::crane(),
        moved,
        example::crane_with_networks(),
        example::crane_with_reactions(),
        example::crane_with_efforts(),
    ] {
        let surrogate = surrogate.sealed().unwrap();
        let bytes = surrogate.to_bytes().unwrap();
        assert_eq!(Surrogate::from_bytes(&bytes).unwrap(), surrogate);
        for length in (0..bytes.len()).step_by(97) {
            assert!(Surrogate::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
        // any byte that is another is noticed: by the reader or by the digest
        for position in (8..bytes.len()).step_by(31) {
            let mut damaged = bytes.clone();
            damaged[position] ^= 4;
            assert!(Surrogate::from_bytes(&damaged).is_err(), "byte {position}");
        }
    }
}

#[test]
fn networks_of_a_motion_that_make_no_sense_are_refused() {
    let bytes = example::crane_with_networks().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    let tensors: Value = serde_json::from_str(header).unwrap();
    // another whole number at a place of a tensor
    for (name, index, number, expected) in [
        ("law.network.columns", 0, 3, "tensor `network.columns`, element 0: 3, expected less than 3"),
        ("law.network.columns", 1, 3, "tensor `law.network.columns`, element 1: 3 is not known"),
        ("law.network.outputs", 5, 12, "tensor `network.outputs`, element 5: 12, expected less than 12"),
        ("positions.network.activations", 0, 7, "tensor `positions.network.activations`, element 0: 7 is not known"),
        ("forces.network.columns", 10, 6, "tensor `network.columns`, element 5: 6, expected less than 6"),
        ("forces.network.outputs", 0, 2, "tensor `network.outputs`, element 0: 2, expected less than 2"),
    ] {
        let begin = 8 + length + tensors[name]["data_offsets"][0].as_u64().unwrap() as usize + 4 * index;
        let mut damaged = bytes.clone();
        damaged[begin..begin + 4].copy_from_slice(&u32::to_le_bytes(number));
        let found = Surrogate::from_bytes(&damaged).unwrap_err().to_string();
        assert_eq!(found, expected);
    }
    for (from, to, expected) in [
        ("forces.network.outputs", "forces.network.output", "tensor `forces.network.outputs` is missing"),
        ("law.network.input_mean", "law.network.input_means", "tensor `law.network.input_mean` is missing"),
        ("positions.network.layers.1.bias", "positions.network.layers.1.bia", "`positions.network.layers.1.bias`"),
    ] {
        let found = rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string();
        assert!(found.contains(expected), "{found}");
    }
}

#[test]
fn efforts_that_make_no_sense_are_refused() {
    let bytes = example::crane_with_efforts().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    for (tensor, element, value, expected) in [
        ("efforts.steps", 1, 77, "tensor `efforts.steps`, element 0: 77, expected less than 8"),
        ("efforts.steps", 0, 12, "tensor `efforts.steps`, element 0: 12 is not known"),
        ("efforts.steps", 3, 900, "tensor `efforts.steps`, element 3: 900 is not known"),
        ("efforts.steps", 0, 5, "formula, step 0: 0 values, expected 2"),
        // table 1 has two arguments
        ("efforts.steps", 0, 4, "formula, step 0: 0 values, expected 2"),
        ("efforts.tables.1.kinds", 1, 3, "tensor `efforts.tables.1.kinds`, element 1: 3 is not known"),
        ("efforts.tables.1.kinds", 1, 2, "a periodic lookup table, element 4: its ends differ"),
        ("efforts.inputs", 0, 2, "tensor `inputs` has shape [1, 4, 1, 0], expected [1, 4, 2, 0]"),
        (
            "efforts.inputs",
            0,
            4_000_000_000,
            "tensor `efforts.inputs`, element 0: 4000000000, expected less than 65536",
        ),
    ] {
        let mut damaged = bytes.clone();
        let offset = header[tensor]["data_offsets"][0].as_u64().unwrap() as usize + 4 * element;
        damaged[8 + length + offset..][..4].copy_from_slice(&u32::to_le_bytes(value));
        let found = Surrogate::from_bytes(&damaged).unwrap_err().to_string();
        assert_eq!(found, expected, "{tensor} {element}");
    }
}

/// Two forces that are zero.
fn reactions(coordinates: usize, inputs: usize) -> Result<Reactions, FormatError> {
    let functions = 2 * Reactions::functions_of_each(coordinates, inputs);
    Reactions::new(coordinates, inputs, Dictionary::new(&[Factor::Angle; 3], functions, &[]).unwrap())
}

#[test]
fn reactions_of_other_shapes_are_refused() {
    let functions = |count: usize| Dictionary::new(&[Factor::Angle; 2], count, &[]).unwrap();
    for (found, expected) in [
        (Reactions::new(2, 1, functions(10)), "tensor `reactions` has shape [10], expected [18]"),
        (Reactions::new(2, 1, functions(0)), "tensor `reactions` has shape [0], expected [9]"),
        (reactions(4, 1), "tensor `reactions` has shape [3], expected [4]"),
    ] {
        assert_eq!(found.unwrap_err().to_string(), expected);
    }
    let bytes = example::crane_with_reactions().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    let found = rebuilt(&header.replacen("reactions.exponents", "reactions.exponent", 1), &bytes[8 + length..]);
    assert_eq!(found.to_string(), "tensor `reactions.exponents` is missing");
}

#[test]
fn a_motion_that_makes_no_sense_is_refused() {
    for (expected, change) in [
        ("nothing", &(|_: &mut Motion| {}) as &dyn Fn(&mut Motion)),
        ("tensor `shown`, element 2: 7, expected less than 3", &|motion| motion.outputs[2] = Shown::Velocity(7)),
        ("tensor `shown`, element 1: 0, expected less than 0", &|motion| motion.outputs[1] = Shown::Reaction(0)),
        ("tensor `shown`, element 1: 2, expected less than 2", &|motion| {
            motion.reactions = Some(reactions(2, 1).unwrap());
            motion.outputs[1] = Shown::Reaction(2);
        }),
        ("tensor `reactions` has shape [2, 0, 3], expected [2, 1, 3]", &|motion| {
            motion.reactions = Some(reactions(2, 0).unwrap());
        }),
        ("tensor `shown` has shape [6], expected [7]", &|motion| motion.outputs.truncate(6)),
        ("tensor `windings` has shape [5], expected [6]", &|motion| motion.windings.truncate(5)),
        ("tensor `windings`, element 1: NaN is not finite", &|motion| motion.windings[1] = f64::NAN),
        ("time step 0 is not positive", &|motion| motion.integration = Integration::Fixed { step: 0.0 }),
        ("the tolerance NaN of the solver is not positive", &|motion| {
            motion.integration = Integration::ErrorControlled { tolerance: f64::NAN, longest: 0.1 };
        }),
    ] {
        let found = crane_with(change);
        assert!(found.starts_with(expected), "{found} instead of {expected}");
    }
    let mut bytes = example::with_prescribed_trolley(&example::crane()).to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    bytes[8 + length + header["law.prescribed"]["data_offsets"][0].as_u64().unwrap() as usize] = 2;
    let found = Surrogate::from_bytes(&bytes).unwrap_err().to_string();
    assert_eq!(found, "tensor `prescribed`, element 0: 2, expected less than 2");
    let bytes = example::crane().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    assert!(!header.contains("prescribed"), "{header}");
    for (from, to, expected) in [
        ("motion", "response", "a motion has dictionaries, and only a motion"),
        ("positions.windings", "positions.winding", "tensor `positions.windings` is missing"),
        ("\\\"map\\\":\\\"dictionary\\\"", "\\\"map\\\":\\\"graph\\\"", "a motion has dictionaries, and only a motion"),
    ] {
        assert!(header.contains(from), "{from} is not in {header}");
        let found = rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string();
        assert!(found.contains(expected), "{found}");
    }
}

#[test]
fn a_state_space_survives_the_round_trip_with_and_without_a_network() {
    for network in [None, Some(example::residual_network())] {
        let surrogate = example::oscillator(network).sealed().unwrap();
        let bytes = surrogate.to_bytes().unwrap();
        assert_eq!(Surrogate::from_bytes(&bytes).unwrap(), surrogate);
        for length in (0..bytes.len()).step_by(97) {
            assert!(Surrogate::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
    }
}

#[test]
fn a_state_space_that_makes_no_sense_is_refused() {
    for (expected, change) in [
        ("nothing", &(|_: &mut StateSpace| {}) as &dyn Fn(&mut StateSpace)),
        ("tensor `results.given`, element 2: 1, expected less than 1", &|space| space.results[2] = Given::Function(1)),
        ("tensor `results.given`, element 0: 2, expected less than 2", &|space| space.results[0] = Given::State(2)),
        ("tensor `results.given` has shape [2], expected [3]", &|space| space.results.truncate(2)),
        ("tensor `inputs` has shape [1, 2, 1, 0], expected [2, 2, 1, 0]", &|space| space.counts[0] = 2),
        ("time step 0 is not positive", &|space| space.integration = Integration::Fixed { step: 0.0 }),
    ] {
        let surrogate = example::oscillator(Some(example::residual_network()));
        let Model::StateSpace(mut space) = surrogate.model().clone() else { unreachable!("it has states") };
        change(&mut space);
        let found = Surrogate::new(surrogate.metadata().clone(), Model::StateSpace(space));
        let found = found.map_or_else(|error| error.to_string(), |_| "nothing".into());
        assert!(found.starts_with(expected), "{found} instead of {expected}");
    }
}

#[test]
fn models_of_samples_and_by_graphs_survive_the_round_trip() {
    let recorded = example::recorded();
    let Model::Discrete(mut discrete) = recorded.model().clone() else { unreachable!("it is discrete") };
    discrete.map = None;
    let linear = Surrogate::new(recorded.metadata().clone(), Model::Discrete(discrete)).unwrap();
    for surrogate in [recorded, linear, example::cell(), example::oscillator_by_graph()] {
        let surrogate = surrogate.sealed().unwrap();
        let bytes = surrogate.to_bytes().unwrap();
        assert_eq!(Surrogate::from_bytes(&bytes).unwrap(), surrogate);
        for length in (0..bytes.len()).step_by(97) {
            assert!(Surrogate::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
    }
}

#[test]
fn a_discrete_model_that_makes_no_sense_is_refused() {
    for (expected, change) in [
        ("nothing", &(|_: &mut Discrete| {}) as &dyn Fn(&mut Discrete)),
        ("tensor `inputs` has shape [1, 2, 1, 0], expected [0, 2, 1, 0]", &|discrete| discrete.counts[0] = 0),
        ("tensor `inputs` has shape [1, 2, 1, 0], expected [1, 3, 2, 0]", &|discrete| discrete.counts[1] = 2),
        ("tensor `outputs` has shape [2], expected [1]", &|discrete| discrete.counts[2] = 2),
        ("the list of past inputs is empty", &|discrete| discrete.history[1] = 0),
        ("tensor `linear.weights` has shape [6], expected [7]", &|discrete| discrete.history[0] = 3),
        ("tensor `linear.constants` has shape [0], expected [1]", &|discrete| discrete.constants.clear()),
        ("tensor `linear.weights`, element 1: NaN is not finite", &|discrete| discrete.weights[1] = f64::NAN),
        ("time step 0 is not positive", &|discrete| discrete.step = 0.0),
        ("tensor `linear.weights` has shape [6], expected [16]", &|discrete| discrete.hidden.push(0.0)),
        ("tensor `hidden.start`, element 0: inf is not finite", &|discrete| {
            (discrete.hidden, discrete.constants) = (vec![f64::INFINITY], vec![0.0; 2]);
            discrete.weights.clear();
        }),
    ] {
        let surrogate = example::recorded();
        let Model::Discrete(mut discrete) = surrogate.model().clone() else { unreachable!("it is discrete") };
        change(&mut discrete);
        let found = Surrogate::new(surrogate.metadata().clone(), Model::Discrete(discrete));
        let found = found.map_or_else(|error| error.to_string(), |_| "nothing".into());
        assert!(found.starts_with(expected), "{found} instead of {expected}");
    }
    let bytes = example::recorded().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    for (from, to, expected) in [
        ("sample.time", "sample.tim", "tensor `sample.time` is missing"),
        (
            "\\\"map\\\":\\\"network\\\"",
            "\\\"map\\\":\\\"dictionary\\\"",
            "a discrete model has a linear part, a network or a graph",
        ),
    ] {
        assert!(header.contains(from), "{from} is not in {header}");
        let found = rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string();
        assert!(found.contains(expected), "{found}");
    }
}
