use super::{fields::Read, *};
use crate::{
    Activation, Bounds, BuiltIn, Encoding, Integration, Layer, Motion, Numbers, Precision, Quantity, Reactions, Role,
    ScaledNetwork, Scaling, Shown, Tunability,
    dictionary::{Dictionary, Factor},
    example,
    graph::Step,
};

mod motion;

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
        Surrogate::new(metadata, surrogate.program().clone()).unwrap_err().to_string()
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
    let columns = |found: &str, expected: &str| format!("tensor `graph.inputs` has shape {found}, expected {expected}");
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
        (Role::Parameter(Tunability::Tunable), r#"{"causality":"parameter","variability":"tunable"}"#),
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

const RESERVED_TIME: &str = "variable `time`: the name is reserved for a variable that the FMU adds";

/// [`example::with_arrays`] with other metadata.
fn changed(change: impl FnOnce(&mut Metadata)) -> Result<Surrogate, FormatError> {
    let surrogate = example::with_arrays();
    let mut metadata = surrogate.metadata().clone();
    change(&mut metadata);
    Surrogate::new(metadata, surrogate.program().clone())
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
fn value_references_count_the_variables_from_one() {
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
    assert_eq!(with_bounds, [Some(3), Some(5), Some(6), Some(8), None, Some(9), Some(12)]);
    let without_time = changed(|metadata| {
        metadata.inputs[2].role = Role::Input;
        metadata.inputs[2].name = "load".into();
    });
    let without_time = references(&without_time.unwrap(), &quantities);
    assert_eq!(without_time, [Some(3), Some(5), Some(6), Some(8), Some(9), Some(10), None]);
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
    let variables = surrogate.variables();
    assert_eq!((variables.get(0), variables.get(variables.reference_count())), (None, None));
    assert!(variables.iter().all(|(reference, variable)| variables.get(reference) == Some(variable)));
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
fn predicted_standard_deviations_follow_all_outputs_in_their_order() {
    let with = |stds: &[Option<u32>]| {
        let stds = stds.to_vec();
        changed(move |metadata| metadata.outputs.iter_mut().zip(stds).for_each(|(output, of)| output.std_of = of))
    };
    assert_eq!(with(&[None, None]).unwrap().predictions().len(), 2);
    let surrogate = with(&[None, Some(0)]).unwrap();
    assert_eq!((surrogate.predictions().len(), surrogate.std_column(0), surrogate.std_column(1)), (1, Some(1), None));
    assert_eq!(Surrogate::from_bytes(&surrogate.to_bytes().unwrap()).unwrap(), surrogate);
    let message = "predicted standard deviations follow all other outputs, in their order";
    for (stds, name) in [([None, Some(1)], "y"), ([Some(0), None], "x"), ([Some(0), Some(1)], "x")] {
        assert_eq!(with(&stds).unwrap_err().to_string(), format!("output `{name}`: {message}"));
    }
    // a bound for each output that predicts a quantity
    let bounds = |half_widths: &[f64]| {
        let bounds = Bounds { coverage: 0.9, runs: 100, times: Vec::new(), half_widths: half_widths.into() };
        surrogate.clone().with_bounds(bounds)
    };
    let bounded = bounds(&[0.1]).unwrap();
    assert_eq!(bounded.variables().iter().filter(|(_, v)| v.name.ends_with("_bound")).count(), 1);
    assert_eq!(bounds(&[0.1, 0.2]).unwrap_err().to_string(), "2 error bounds, expected 1: one for each output");
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
    let mut evaluator = crate::Evaluator::new(&surrogate);
    let inputs: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
    let mut outputs = vec![0.0; surrogate.outputs().len()];
    evaluator.evaluate(&inputs, &mut outputs);
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

/// A file with another whole number at a place of a tensor.
fn patched(mut bytes: Vec<u8>, tensor: &str, index: usize, number: u32) -> Vec<u8> {
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let begin = 8 + length + header[tensor]["data_offsets"][0].as_u64().unwrap() as usize + 4 * index;
    bytes[begin..begin + 4].copy_from_slice(&number.to_le_bytes());
    bytes
}

fn rebuilt(header: &str, data: &[u8]) -> FormatError {
    let length = (header.len() as u64).to_le_bytes();
    Surrogate::from_bytes(&[&length, header.as_bytes(), data].concat()).unwrap_err()
}

/// The error of the example's parts after a change of them.
fn assembled(change: impl Fn(&mut Metadata, &mut Scaling, &mut Vec<Layer>)) -> FormatError {
    let surrogate = example::surrogate();
    let mut metadata = surrogate.metadata().clone();
    let ScaledNetwork { mut scaling, mut layers } = surrogate.network().unwrap();
    change(&mut metadata, &mut scaling, &mut layers);
    Surrogate::new(metadata, Graph::from(&ScaledNetwork { scaling, layers })).unwrap_err()
}

#[test]
fn a_file_reads_back_as_the_same_surrogate_and_writes_the_same_bytes() {
    let mut surrogate = example::surrogate();
    let mut metadata = surrogate.metadata().clone();
    // numbers whose shortest decimals a careless reader gets wrong in the last bit
    metadata.outputs[0].min = -113.09733552923255;
    metadata.outputs[1].max = 9.869604401089358e22;
    surrogate = Surrogate::new(metadata, surrogate.program().clone()).unwrap();
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
        (r#"\"time_step\""#, r#"\"color\":1,\"time_step\""#, "unknown field `color`"),
        (r#"\"tunable\""#, r#"\"loose\""#, "unknown variant `loose`"),
        (r#"\"format\":7"#, r#"\"format\":6"#, "format 6, expected 7: an older metafmu wrote it; make it again"),
        (r#"\"format\":7"#, r#"\"format\":8"#, "format 8, expected 7: a newer metafmu wrote it; use that one"),
        (r#"\"clock\":"#, r#"\"clocks\":"#, "the field `clock` is missing"),
        (r#"\"static\""#, r#"\"impulse\""#, "unknown variant `impulse`"),
        (r#"\"static\""#, r#"\"continuous\""#, "tensor `solver.step` is missing"),
        (r#"\"static\""#, r#"\"sampled\""#, "tensor `samples.history` is missing"),
        (r#"{\"format\""#, r#"{{\"format\""#, "metadata entry"),
    ] {
        let message = described(from, to).to_string();
        assert!(message.contains(says), "{message}");
    }
}

#[test]
fn tensors_that_are_missing_unknown_or_of_the_wrong_kind_are_named() {
    let missing = described("graph.3.bias", "graph.3.bius");
    assert!(matches!(missing, FormatError::MissingTensor { name } if name == "graph.3.bias"));
    // a softmax in place of the last step has no tensors
    let unknown = Surrogate::from_bytes(&patched(good(), "graph.steps", 16, 5)).unwrap_err();
    assert!(matches!(unknown, FormatError::UnknownTensor { name } if name == "graph.4.mean"));
    let kind = described(r#""graph.1.bias":{"dtype":"F32""#, r#""graph.1.bias":{"dtype":"I32""#);
    assert_eq!(kind.to_string(), "tensor `graph.1.bias` is of type I32, expected F32 or F64");
    let shape = described(r#""dtype":"F32","shape":[16,3]"#, r#""dtype":"F32","shape":[48]"#);
    assert!(matches!(shape, FormatError::Shape { name, .. } if name == "graph.1.weight"));
    let shape = described(r#""dtype":"F32","shape":[16,3]"#, r#""dtype":"F32","shape":[3,16]"#);
    assert!(matches!(shape, FormatError::Shape { found, expected, .. } if found == [3, 16] && expected == [16, 3]));
}

#[test]
fn numbers_that_cannot_be_are_located() {
    let error = assembled(|_, _, layers| set(&mut layers[1].weight, 5, f32::NAN));
    assert!(matches!(error, FormatError::NotFinite { name, index: 5, .. } if name == "graph.3.weight"));
    let error = assembled(|_, scaling, _| scaling.output_mean[1] = f64::INFINITY);
    assert!(matches!(error, FormatError::NotFinite { name, index: 1, .. } if name == "graph.4.mean"));
    let error = assembled(|_, scaling, _| scaling.input_scale[2] = 0.0);
    assert!(matches!(error, FormatError::NotPositive { name, index: 2, .. } if name == "graph.0.scale"));
    let error = assembled(|_, scaling, _| scaling.input_mean.truncate(1));
    assert!(matches!(error, FormatError::Shape { name, .. } if name == "graph.inputs"));
    let error = assembled(|_, _, layers| layers.clear());
    assert!(matches!(error, FormatError::Shape { name, .. } if name == "graph.1.mean"));
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
        ("graph.0.instants", &[4][..]),
        ("graph.0.functions.steps", &[4, 7, 4]),
        ("graph.0.functions.0.mean", &[4, 2]),
        ("graph.0.functions.1.weight", &[4, 5, 2]),
        ("graph.0.functions.3.bias", &[4, 3]),
        ("graph.0.functions.5.weight", &[4, 2, 3]),
        ("graph.0.functions.6.scale", &[4, 2]),
    ] {
        assert_eq!(file.tensor(name).unwrap().shape(), shape, "{name}");
    }
    let surrogate = per_instant();
    let (_, networks) = surrogate.program().graph.instants().unwrap();
    let weights: Vec<f32> = elements(file.tensor("graph.0.functions.3.weight").unwrap().data(), f32::from_le_bytes);
    assert_eq!(networks[2].network().unwrap().layers[1].weight, weights[2 * 15..3 * 15].to_vec().into());
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
    let missing = per_instant_described("0.instants\":", "0.instance\":");
    assert_eq!(missing, "tensor `graph.0.instants` is missing");
    let of = r#""graph.0.functions.1.weight":{"dtype":"F32","shape":"#;
    let changed = |shape: &str| per_instant_described(&format!("{of}[4,5,2]"), &format!("{of}{shape}"));
    assert_eq!(changed("[4,10]"), "tensor `graph.0.functions.1.weight` has shape [10], expected [10, 1]");
    assert_eq!(changed("[4,2,5]"), "tensor `graph.0.functions.1.weight` has shape [2, 5], expected [5, 2]");
    assert_eq!(changed("[2,10,2]"), "tensor `graph.0.functions.1.weight` has shape [2, 10, 2], expected [4, 10, 2]");
    let missing = per_instant_described("functions.1.bias", "functions.1.bius");
    assert_eq!(missing, "tensor `graph.0.functions.1.bias` is missing");
}

#[test]
fn networks_for_instants_that_make_no_sense_is_refused() {
    type Change<'a> = &'a dyn Fn(&mut Metadata, &mut Vec<f64>, &mut Vec<ScaledNetwork>);
    let changes: [(&str, Change); 10] = [
        ("no input beside the time", &|metadata, _, _| drop(metadata.inputs.drain(..2))),
        ("1 instants, expected at least 2", &|_, instants, _| instants.truncate(1)),
        ("tensor `graph.0.instants`, element 2: NaN is not finite", &|_, instants, _| instants[2] = f64::NAN),
        ("tensor `graph.0.instants`, element 2: 0.5 is not above 0.5", &|_, instants, _| instants[2] = 0.5),
        ("3 networks, expected 4, one for each instant", &|_, _, networks| networks.truncate(3)),
        ("instant 3: tensor `graph.6.scale`, element 1: 0 is not positive", &|_, _, networks| {
            networks[3].scaling.output_scale[1] = 0.0;
        }),
        ("instant 1: tensor `graph.1.bias`, element 4: NaN is not finite", &|_, _, networks| {
            set(&mut networks[1].layers[0].bias, 4, f32::NAN);
        }),
        (
            "instant 2: values of lengths [2, 2, 2, 2], expected [2, 2, 5, 5, 3, 3, 2, 2] as at the first instant",
            &|_, _, networks| {
                let (weight, bias) = (vec![0.0f32; 4].into(), vec![0.0f32; 2].into());
                networks[2].layers =
                    vec![Layer { inputs: 2, outputs: 2, weight, bias, activation: Activation::Identity }];
            },
        ),
        ("instant 2: steps of other kinds or precisions than at the first instant", &|_, _, networks| {
            networks[2].layers[0].bias = vec![0.0f64; 5].into();
        }),
        ("instant 3: steps of other kinds or precisions than at the first instant", &|_, _, networks| {
            // as many numbers, but no activation between two layers
            let activation = Activation::Identity;
            networks[3].layers[1].activation = activation;
            let (weight, bias) = (vec![0.0f32; 9].into(), vec![0.0f32; 3].into());
            networks[3].layers.insert(2, Layer { inputs: 3, outputs: 3, weight, bias, activation });
        }),
    ];
    for (expected, change) in changes {
        let surrogate = per_instant();
        let mut metadata = surrogate.metadata().clone();
        let (instants, functions) = surrogate.program().graph.instants().unwrap();
        let mut instants = instants.to_vec();
        let mut networks = functions.iter().filter_map(Graph::network).collect();
        change(&mut metadata, &mut instants, &mut networks);
        let time = metadata.inputs.len() - 1;
        let graph = Graph::of_instants(time + 1, time, instants, &networks);
        let message = Surrogate::new(metadata, graph).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn derivatives_of_states_survive_the_round_trip_with_and_without_a_network() {
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
fn derivatives_of_states_that_make_no_sense_are_refused() {
    type Change<'a> = &'a dyn Fn(&mut Metadata, &mut Graph, &mut Integration);
    let results = |place: usize, column: [u32; 2]| {
        move |_: &mut Metadata, graph: &mut Graph, _: &mut Integration| {
            let Some(Step::Columns { columns }) = graph.steps.last_mut() else {
                unreachable!("the results are picked")
            };
            columns[place] = column;
        }
    };
    let changes: [(&str, Change); 9] = [
        ("nothing", &|_, _, _| {}),
        ("tensor `graph.3.columns`, element 2: 1, expected less than 1", &results(2, [3, 1])),
        ("tensor `graph.3.columns`, element 0: 4, expected less than 4", &results(0, [0, 4])),
        ("tensor `graph.steps` has shape [2], expected [3]", &|_, graph, _| {
            graph.steps[3] = Step::Columns { columns: vec![[0, 2], [0, 3]] };
        }),
        ("tensor `graph.inputs` has shape [4], expected [5]", &|metadata, _, _| {
            let more = crate::Input { name: "more".into(), ..metadata.inputs[0].clone() };
            metadata.inputs.insert(1, more);
        }),
        ("tensor `inputs` has shape [1], expected [2]", &|metadata, _, _| drop(metadata.inputs.remove(1))),
        ("the inputs of a program with a state are not parameters", &|metadata, _, _| metadata.inputs.swap(0, 1)),
        ("the inputs of a program with a state are not parameters", &|metadata, _, _| metadata.inputs.swap(2, 3)),
        ("time step 0 is not positive", &|_, _, integration| *integration = Integration::Fixed { step: 0.0 }),
    ];
    for (expected, change) in changes {
        let surrogate = example::oscillator(Some(example::residual_network()));
        let mut metadata = surrogate.metadata().clone();
        let Program { mut graph, clock } = surrogate.program().clone();
        let Clock::Continuous(mut integration) = clock else { unreachable!("it has states") };
        change(&mut metadata, &mut graph, &mut integration);
        let found = Surrogate::new(metadata, Program { graph, clock: Clock::Continuous(integration) });
        let found = found.map_or_else(|error| error.to_string(), |_| "nothing".into());
        assert!(found.starts_with(expected), "{found} instead of {expected}");
    }
}

#[test]
fn programs_of_samples_and_by_graphs_survive_the_round_trip() {
    let recorded = example::recorded();
    let Program { mut graph, clock } = recorded.program().clone();
    graph.steps.truncate(1);
    let linear = Surrogate::new(recorded.metadata().clone(), Program { graph, clock }).unwrap();
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
fn samples_that_make_no_sense_are_refused() {
    type Change<'a> = &'a dyn Fn(&mut Metadata, &mut Numbers, &mut Numbers, &mut Sampling);
    let changes: [(&str, Change); 12] = [
        ("nothing", &|_, _, _, _| {}),
        ("tensor `graph.inputs` has shape [6], expected [5]", &|metadata, _, _, _| drop(metadata.inputs.remove(0))),
        ("tensor `inputs` has shape [2], expected [3]", &|metadata, _, _, _| {
            let more = crate::Input { name: "more".into(), ..metadata.inputs[3].clone() };
            metadata.inputs.push(more);
        }),
        ("the inputs of a program with a state are not parameters", &|metadata, _, _, _| metadata.inputs.swap(2, 3)),
        ("the list of past inputs is empty", &|_, _, _, sampling| sampling.history[1] = 0),
        ("tensor `graph.inputs` has shape [6], expected [7]", &|_, _, _, sampling| sampling.history[0] = 3),
        ("tensor `graph.0.weight` has shape [6], expected [0]", &|_, _, constants, _| {
            *constants = Vec::<f64>::new().into()
        }),
        ("tensor `graph.0.weight`, element 1: NaN is not finite", &|_, weights, _, _| {
            *weights = vec![0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0].into();
        }),
        ("time step 0 is not positive", &|_, _, _, sampling| sampling.step = 0.0),
        ("tensor `graph.inputs` has shape [6], expected [8]", &|_, _, _, sampling| sampling.hidden.push(0.0)),
        ("tensor `samples.hidden`, element 0: inf is not finite", &|_, _, _, sampling| {
            sampling.hidden = vec![f64::INFINITY];
        }),
        ("tensor `samples.direct` has shape [3], expected [1]", &|_, _, _, sampling| sampling.direct = vec![0.0; 3]),
    ];
    for (expected, change) in changes {
        let surrogate = example::recorded();
        let mut metadata = surrogate.metadata().clone();
        let Program { mut graph, clock } = surrogate.program().clone();
        let Clock::Sampled(mut sampling) = clock else { unreachable!("it has samples") };
        let Step::Affine { weight, bias, .. } = &mut graph.steps[0] else { unreachable!("it has a linear part") };
        change(&mut metadata, weight, bias, &mut sampling);
        let found = Surrogate::new(metadata, Program { graph, clock: Clock::Sampled(sampling) });
        let found = found.map_or_else(|error| error.to_string(), |_| "nothing".into());
        assert!(found.starts_with(expected), "{found} instead of {expected}");
    }
    let bytes = example::recorded().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    for (from, to, expected) in [
        ("samples.time", "samples.tim", "tensor `samples.time` is missing"),
        ("sampled", "static", "tensor `samples.history` is not part of the format"),
        ("sampled", "continuous", "tensor `solver.step` is missing"),
    ] {
        assert!(header.contains(from), "{from} is not in {header}");
        let found = rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string();
        assert!(found.contains(expected), "{found}");
    }
}

#[test]
fn functions_that_a_step_calls_have_no_such_steps() {
    let bytes = example::recorded().to_bytes().unwrap();
    for kind in 12..17 {
        let found = Surrogate::from_bytes(&patched(bytes.clone(), "graph.1.function.steps", 0, kind)).unwrap_err();
        let expected = format!("tensor `graph.1.function.steps`, element 0: {kind} is not known");
        assert_eq!(found.to_string(), expected);
    }
    let of_instants = per_instant().to_bytes().unwrap();
    let found = Surrogate::from_bytes(&patched(of_instants.clone(), "graph.0.functions.steps", 4, 12)).unwrap_err();
    assert_eq!(found.to_string(), "tensor `graph.0.functions.steps`, element 4: 12 is not known");
    let found = Surrogate::from_bytes(&patched(of_instants, "graph.0.functions.steps", 60, 12)).unwrap_err();
    assert_eq!(found.to_string(), "instant 2: steps of other kinds or precisions than at the first instant");
    let found = Surrogate::from_bytes(&patched(bytes, "graph.1.function.inputs", 0, 0)).unwrap_err();
    assert_eq!(found.to_string(), "tensor `graph.inputs` has shape [0], expected [6]");
}
