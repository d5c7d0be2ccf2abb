use super::*;
use crate::{
    export::{Binary, Contents, pack, validate},
    fmi::{
        Fmu, FmuInstance, Inputs, InterfaceKind, Platform, SimulationOptions, model_description::model_identifier,
        simulate,
    },
    integrate::{Budget, TOLERANCE, integrate},
    study::ExportOptions,
    surrogate::seal,
};
use metafmu_runtime::{
    Activation, BuiltIn, Clock, CommunicationStep, Domain, Drive, Dynamics, Encoder, Evaluator, Graph, Input,
    Integration, Layer, Metadata, Motion, Precision, Program, Quantity, Role, Sampling, ScaledNetwork, Scaling, Shown,
    StepError,
    dictionary::{Dictionary, Factor, Term},
    example,
    graph::{Elementwise, Forest, Given, KernelMachine, LEAF, Node, Operation, Products, Step, Tree},
};
use nalgebra::{Matrix2, SVector, Vector2};
use std::{
    collections::BTreeMap,
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Arc, Mutex, OnceLock},
};

/// Every warning is an error, as it is where real-time code is certified.
const FLAGS: [&str; 8] =
    ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror"];

/// Undefined behaviour and wrong memory accesses end the program. Not optimised, which takes a third of the time to compile: what the compiler
/// would remove is looked at as well.
const SANITIZERS: [&str; 4] = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];

const SINGLE: &str = "-DMETAFMU_SINGLE";

fn compiler() -> Command {
    Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()))
}

/// Writes the sources of a surrogate into a folder.
fn write_sources(folder: &Path, surrogate: &Surrogate, version: FmiVersion) {
    fs::create_dir_all(folder.join(FOLDER)).unwrap();
    for (name, bytes) in files(surrogate, &model_identifier(&surrogate.metadata().name), version) {
        fs::write(folder.join(name), bytes).unwrap();
    }
}

/// Compiles files of the sources, and further ones.
fn compile(folder: &Path, files: &[&str], arguments: &[&str], target: &str) -> PathBuf {
    let target = folder.join(target);
    let sources = folder.join(FOLDER);
    let output = compiler()
        .args(FLAGS)
        .args(files.iter().map(|name| sources.join(name)))
        .args(arguments)
        .arg("-I")
        .arg(&sources)
        .arg("-o")
        .arg(&target)
        .arg("-lm")
        .output()
        .expect("the tests need a C compiler `cc`, as does linking Rust; set CC if it has another name");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    target
}

/// Packs a surrogate with the given library.
fn fmu(folder: &Path, surrogate: &Surrogate, version: FmiVersion, name: &str, binary: Binary) -> PathBuf {
    let about = ExportOptions::default();
    let contents =
        Contents { version, about: &about, binaries: &[binary], accuracy: None, figures: &[], sources: false };
    let path = folder.join(name);
    fs::write(&path, pack(surrogate, &contents).unwrap()).unwrap();
    path
}

/// The FMU of a surrogate with the library compiled from its sources.
fn c_fmu(folder: &Path, surrogate: &Surrogate, version: FmiVersion) -> PathBuf {
    let binary = Binary { platform: Platform::CURRENT, bytes: library(folder, surrogate, version).into() };
    fmu(folder, surrogate, version, "c.fmu", binary)
}

/// The library compiled from the sources of a surrogate: once for all tests, which take a good part of their time to compile.
fn library(folder: &Path, surrogate: &Surrogate, version: FmiVersion) -> Vec<u8> {
    type Sources = Vec<(String, Vec<u8>)>;
    static LIBRARIES: Mutex<BTreeMap<Sources, Arc<OnceLock<Vec<u8>>>>> = Mutex::new(BTreeMap::new());
    let sources = files(surrogate, &model_identifier(&surrogate.metadata().name), version);
    let made = LIBRARIES.lock().unwrap().entry(sources).or_default().clone();
    let compile = || {
        write_sources(folder, surrogate, version);
        let library = compile(folder, &compiled(surrogate, version), &["-fPIC", "-shared"], "library");
        fs::read(library).unwrap()
    };
    made.get_or_init(compile).clone()
}

fn rust_fmu(folder: &Path, surrogate: &Surrogate, version: FmiVersion) -> PathBuf {
    let mut binaries = Binary::embedded();
    binaries.retain(|binary| binary.platform == Platform::CURRENT);
    fmu(folder, surrogate, version, "rust.fmu", binaries.remove(0))
}

/// Runs a program of the `tests` folder that calls the functions of FMI, linked with all sources.
fn run(surrogate: &Surrogate, version: FmiVersion, program: &str) {
    run_with(surrogate, version, &compiled(surrogate, version), program, &SANITIZERS, "");
}

/// Runs a program of the `tests` folder that calls the evaluator, linked with what it takes, and returns what it prints.
fn run_evaluator(surrogate: &Surrogate, program: &str, flags: &[&str], input: &str) -> String {
    let version = FmiVersion::V2;
    let mut files = compiled(surrogate, version);
    files.retain(|name| !["fmi2.c", "instance.c"].contains(name));
    run_with(surrogate, version, &files, program, flags, input)
}

fn run_with(
    surrogate: &Surrogate,
    version: FmiVersion,
    files: &[&str],
    program: &str,
    flags: &[&str],
    input: &str,
) -> String {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("program.c");
    write_sources(folder.path(), surrogate, version);
    fs::write(&source, program).unwrap();
    let program = compile(folder.path(), files, &[&[source.to_str().unwrap()], flags].concat(), "program");
    let mut child = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(input.as_bytes()).unwrap();
    drop(stdin);
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}\n{text}", output.status);
    text
}

/// Points all over the ranges and outside, the start values first.
fn points(surrogate: &Surrogate) -> Vec<Vec<f64>> {
    let inputs = surrogate.inputs().iter().map(|input| [input.min, input.max]);
    let states = surrogate.states().iter().map(|state| state.range.unwrap_or([-3.0, 3.0]));
    let mut ranges: Vec<[f64; 2]> = inputs.chain(states).collect();
    // what is remembered
    ranges.resize(Evaluator::new(surrogate).columns(), [-3.0, 3.0]);
    let point = |index: usize| {
        let column = |(column, [min, max]): (usize, &[f64; 2])| {
            let share = (0.5 + index as f64 * 0.618_033_988_749_895 * (1.0 + 0.37 * column as f64)).fract();
            min + (1.4 * share - 0.2) * (max - min)
        };
        ranges.iter().enumerate().map(column).collect()
    };
    let far = vec![ranges.iter().map(|[_, max]| max + 1e4).collect()];
    let at = |instant: &f64| {
        let mut point: Vec<f64> = point(1);
        point[surrogate.time_column().unwrap()] = *instant;
        point
    };
    let instants = surrogate.program().graph.instants();
    let of_instants = instants.iter().flat_map(|(instants, _)| instants.iter().map(at)).collect();
    [(0..300).map(point).collect(), of_instants, far].concat()
}

fn assert_close(found: &[f64], expected: &[f64], scale: f64, what: &str) {
    assert_within(1e-12, found, expected, scale, what);
}

fn assert_within(tolerance: f64, found: &[f64], expected: &[f64], scale: f64, what: &str) {
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= tolerance * scale.max(expected.abs()), "{what}: {found} {expected}");
    }
}

/// Lines of numbers.
fn numbers(text: &str) -> Vec<Vec<f64>> {
    text.lines().map(|line| line.split_whitespace().map(|word| word.parse().unwrap()).collect()).collect()
}

/// Every result and derivative of the C code, compared with the evaluator. `scales` are those of results and columns.
fn compare(surrogate: &Surrogate, scales: [f64; 2], flags: &[&str]) {
    compare_at(points(surrogate), 1e-12, surrogate, scales, flags);
}

/// The same of the code in single precision, at points that are not far away, where digits get lost.
fn compare_single(surrogate: &Surrogate, scales: [f64; 2], tolerance: f64) {
    let mut points = points(surrogate);
    points.pop();
    compare_at(points, tolerance, surrogate, scales, &[&SANITIZERS[..], &[SINGLE]].concat());
}

fn compare_at(points: Vec<Vec<f64>>, tolerance: f64, surrogate: &Surrogate, scales: [f64; 2], flags: &[&str]) {
    let input: String = points.iter().flatten().map(|value| format!("{value:e}\n")).collect();
    let text = run_evaluator(surrogate, include_str!("tests/points.c"), flags, &input);
    let rows = numbers(&text);
    assert_eq!(rows.len(), points.len());

    let mut evaluator = Evaluator::new(surrogate);
    let (columns, results) = (evaluator.columns(), evaluator.results());
    let direction: Vec<f64> = (0..columns).map(|i| 1.0 + 0.5 * i as f64).collect();
    let second_rates: Vec<f64> = (0..columns).map(|i| 0.25 - i as f64).collect();
    let weights: Vec<f64> = (0..results).map(|i| 1.0 - 2.0 * i as f64).collect();
    let mut all_at = |point: &[f64]| {
        let [mut y, mut dy, mut first, mut second] = [(); 4].map(|()| vec![0.0; results]);
        let mut gradient = vec![0.0; columns];
        evaluator.evaluate(point, &mut y);
        evaluator.directional(point, &direction, &mut dy);
        evaluator.along_curve(point, [&direction, &second_rates], [&mut first, &mut second]);
        evaluator.adjoint(point, &weights, &mut gradient);
        [y, dy, first, second, gradient].concat()
    };
    const FEW: f64 = 4.0;
    // derivatives are as large as the results over the width of the columns
    let [scale, steep] = scales;
    let scale_of = |index: usize| match index / results {
        0 => scale,
        3 => scale / steep / steep,
        _ => scale / steep,
    };
    for (point, row) in points.iter().zip(&rows) {
        let expected = all_at(point);
        // nobody computes more exactly than a few roundings of the point allow: far away they are what counts
        let mut rounding = vec![0.0; expected.len()];
        for column in 0..columns {
            let mut moved = point.clone();
            moved[column] = moved[column].next_up();
            let changes = all_at(&moved).into_iter().zip(&expected).map(|(moved, here)| (moved - here).abs());
            rounding.iter_mut().zip(changes).for_each(|(sum, change)| *sum += FEW * change);
        }
        for (index, (found, expected)) in row.iter().zip(&expected).enumerate() {
            let allowed = tolerance * scale_of(index).max(expected.abs()) + rounding[index];
            let what = index / results;
            assert!((found - expected).abs() <= allowed, "{what} at {point:?}: {found} {expected} {allowed:e}");
        }
    }
}

fn compare_networks(surrogate: &Surrogate, flags: &[&str]) {
    compare(surrogate, scales_of_networks(surrogate), flags);
}

/// The network, or the networks at all time points.
fn networks(surrogate: &Surrogate) -> Vec<ScaledNetwork> {
    let graph = &surrogate.program().graph;
    let of_instants = graph.instants().map(|(_, functions)| functions.iter().filter_map(Graph::network).collect());
    of_instants.unwrap_or_else(|| vec![graph.network().unwrap()])
}

fn scales_of_networks(surrogate: &Surrogate) -> [f64; 2] {
    let networks = networks(surrogate);
    // what is periodic or nominal has a scale of less than one
    let scalings = || networks.iter().map(|network| &network.scaling);
    let scale = scalings().flat_map(|scaling| &scaling.output_scale).copied().fold(1.0, f64::max);
    let steep = scalings().flat_map(|scaling| &scaling.input_scale).copied().fold(1.0, f64::min);
    [scale, steep]
}

/// Hidden layers and their activations.
const LAYERS: [(&[usize], Activation); 9] = [
    (&[16], Activation::Tanh),
    (&[33, 7, 50], Activation::Tanh),
    (&[1, 130], Activation::Sigmoid),
    (&[24, 24], Activation::Relu),
    (&[24, 9], Activation::Gelu),
    (&[24, 9], Activation::Silu),
    (&[24, 9], Activation::Sine),
    (&[24, 9], Activation::Identity),
    (&[], Activation::Tanh),
];

#[test]
fn outputs_and_derivatives_are_those_of_the_evaluator() {
    for (hidden, activation) in LAYERS {
        compare_networks(&example::with_network(hidden, activation), &[]);
    }
}

#[test]
fn a_last_layer_may_have_an_activation() {
    for (hidden, activation) in LAYERS {
        compare_networks(&bent(&example::with_network(hidden, Activation::Tanh), activation), &[]);
    }
    compare_networks(&bent(&twenty_outputs(), Activation::Silu), &SANITIZERS);
}

#[test]
fn networks_for_instants_are_interpolated_as_by_the_evaluator() {
    for hidden in [&[33, 7, 50][..], &[1, 130], &[]] {
        compare_networks(&example::per_instant(hidden, Activation::Sigmoid, Precision::Double), &[]);
    }
    let surrogate = example::per_instant(&[24, 9], Activation::Tanh, Precision::Double);
    for surrogate in [bent(&surrogate, Activation::Gelu), example::encoded(&surrogate)] {
        compare_networks(&surrogate, &SANITIZERS);
    }
}

#[test]
fn the_outputs_and_derivatives_of_a_regression_are_those_of_the_evaluator() {
    let example = example::surrogate();
    for example in [&example, &example::encoded(&example)] {
        for surrogate in regressions(example).into_iter().chain([graph(example)]) {
            compare(&surrogate, [10.0, 0.03], &SANITIZERS);
        }
    }
    for surrogate in [constant(), no_tree()] {
        compare(&surrogate, [1.0, 1.0], &SANITIZERS);
    }
}

/// The same with an activation after the last layers.
fn bent(surrogate: &Surrogate, activation: Activation) -> Surrogate {
    let mut networks = networks(surrogate);
    networks.iter_mut().for_each(|network| network.layers.last_mut().unwrap().activation = activation);
    let graph = match surrogate.program().graph.steps.as_slice() {
        [Step::Interpolate { column, instants, .. }] => {
            Graph::of_instants(surrogate.program().graph.inputs, *column, instants.clone(), &networks)
        }
        _ => Graph::from(&networks[0]),
    };
    Surrogate::new(surrogate.metadata().clone(), graph).unwrap()
}

/// More outputs than a block of rows has.
fn twenty_outputs() -> Surrogate {
    let surrogate = example::with_network(&[24], Activation::Tanh);
    let mut metadata = surrogate.metadata().clone();
    let mut network = surrogate.network().unwrap();
    let last = network.layers.last_mut().unwrap();
    let weights = |count: usize, from: &metafmu_runtime::Numbers| -> Vec<f64> {
        (0..count).map(|index| from.get(index % from.len()) * (0.3 + index as f64 / count as f64)).collect()
    };
    last.weight = weights(20 * 24, &last.weight).into();
    last.bias = weights(20, &last.bias).into();
    last.outputs = 20;
    network.scaling.output_mean = (0..20).map(|index| 0.1 * f64::from(index)).collect();
    network.scaling.output_scale = (1..=20).map(|index| 0.5 * f64::from(index)).collect();
    let output = |index| metafmu_runtime::Output { name: format!("y{index}"), ..metadata.outputs[0].clone() };
    metadata.outputs = (0..20).map(output).collect();
    Surrogate::new(metadata, Graph::from(&network)).unwrap()
}

/// A polynomial, a forest and kernels of the example's columns.
fn regressions(example: &Surrogate) -> [Surrogate; 3] {
    let n = Encoder::of(example.inputs()).width();
    let mut scaling = example.network().unwrap().scaling;
    if n == 3 {
        // ranges become -1 to 1
        scaling.input_scale = vec![0.05, 2.5, 1.0];
    }
    // degrees 0 to 6 in each column
    let degrees = (0..8 * n).map(|index| (index * 5 % 8).saturating_sub(index % 3) as u8 % 7).collect();
    let coefficients: Vec<f64> = (0..16).map(|index| 0.3 * (0.7 * f64::from(index)).sin()).collect();
    let leaf = |number| Node { column: LEAF, number, below: [0; 2] };
    let split = |column, number, below| Node { column, number, below };
    let nodes = vec![
        split(n as u32 - 1, 0.0, [1, 2]),
        leaf(0.25),
        split(0, -0.5, [3, 4]),
        leaf(-1.0),
        split(1, 0.25, [5, 6]),
        leaf(0.5),
        leaf(3.0),
    ];
    let trees = vec![Tree { root: 0, output: 0 }, Tree { root: 5, output: 1 }, Tree { root: 2, output: 1 }];
    let machine = |bias: f64, centres: usize| KernelMachine {
        lengths: (0..n).map(|column| 0.7 + 0.3 * column as f64).collect(),
        centres: (0..centres * n).map(|index| (1.3 * index as f64).sin()).collect(),
        weights: (0..centres).map(|index| (0.9 * index as f64).cos()).collect(),
        bias,
    };
    [
        Graph::of_polynomial(&scaling, Products { inputs: n, degrees }, &coefficients),
        Graph::of_forest(&scaling, Forest { nodes, trees }),
        Graph::of_kernels(&scaling, &[machine(0.1, 7), machine(-2.0, 0)]),
    ]
    .map(|graph| Surrogate::new(example.metadata().clone(), graph).unwrap())
}

/// A graph with steps of all kinds, and all elementwise functions.
fn graph(example: &Surrogate) -> Surrogate {
    let n = Encoder::of(example.inputs()).width();
    let numbers =
        |count: usize, factor: f64| (0..count).map(|index| (factor * index as f64).sin()).collect::<Vec<f64>>();
    let mut steps = vec![Step::Affine { of: 0, weight: numbers(4 * n, 0.7).into(), bias: numbers(4, 1.1).into() }];
    // of positive numbers, as logarithms and powers are
    steps.push(Step::Elementwise { of: 1, function: Elementwise::Softplus, parameters: Vec::new() });
    let mut sum = 2;
    for function in Elementwise::all() {
        // of all alike, or of each its own
        let rows = if sum % 2 == 0 { 1 } else { 4 };
        let parameters = numbers(rows * function.parameters(), 0.9).iter().map(|number| 0.6 + 0.3 * number).collect();
        let has_pole = matches!(function, Elementwise::Logarithm | Elementwise::Reciprocal);
        let function_of = if function.parameters() > 0 || has_pole { 2 } else { 1 };
        steps.push(Step::Elementwise { of: function_of, function, parameters });
        steps.push(Step::Combine { of: [sum, steps.len()], operation: Operation::Add });
        sum = steps.len();
    }
    steps.push(Step::Normalize { of: sum, epsilon: 0.25 });
    let standard = steps.len();
    for operation in Operation::ALL {
        steps.push(Step::Combine { of: [steps.len(), 2], operation });
    }
    steps.push(Step::Softmax { of: steps.len() });
    steps.push(Step::Distances { of: standard, centres: numbers(12, 0.4), lengths: vec![1.0, 0.5, 2.0, 1.5] });
    let distances = steps.len() as u32;
    let leaf = |number| Node { column: LEAF, number, below: [0; 2] };
    let nodes = vec![Node { column: 1, number: 0.1, below: [1, 2] }, leaf(0.25), leaf(-1.0), leaf(0.5)];
    let trees = vec![Tree { root: 0, output: 2 }, Tree { root: 3, output: 0 }];
    steps.push(Step::Forest { of: standard, forest: Forest { nodes, trees }, outputs: 3 });
    let forest = steps.len() as u32;
    let degrees = (0..12).map(|index| index * 5 % 7).collect();
    steps.push(Step::Products { of: distances as usize - 1, products: Products { inputs: 4, degrees } });
    let products = steps.len() as u32;
    steps.push(Step::Columns { columns: vec![[products, 1], [distances, 0], [0, 0], [forest, 2]] });
    steps.push(Step::Select { of: [standard, steps.len(), 1] });
    let scales = || vec![0.5, 2.0, 1.0, 1.5];
    steps.push(Step::Standardize { of: steps.len(), mean: numbers(4, 0.8), scale: scales() });
    steps.push(Step::Rescale { of: steps.len(), mean: numbers(4, 0.2), scale: scales() });
    let function = Graph {
        inputs: 4,
        steps: vec![
            Step::Affine { of: 0, weight: numbers(16, 0.6).into(), bias: numbers(4, 0.5).into() },
            Step::Elementwise { of: 1, function: Elementwise::Activation(Activation::Tanh), parameters: Vec::new() },
        ],
    };
    steps.push(Step::Call { of: steps.len(), function });
    let factors = [Factor::Angle, Factor::Power { middle: 0.5, half: 2.0 }, Factor::Angle, Factor::Angle];
    let term = |exponents: [i16; 4]| Term { exponents: exponents.to_vec(), coefficients: numbers(4, 0.9) };
    let terms = [[2, 1, 0, 0], [0, 3, -1, 0], [1, 0, 0, -2], [0; 4]].map(term);
    let dictionary = Dictionary::new(&factors, 4, &terms).unwrap();
    steps.push(Step::Dictionary { of: steps.len(), dictionary });
    steps.push(Step::Affine { of: steps.len(), weight: numbers(8, 0.3).into(), bias: numbers(2, 0.5).into() });
    Surrogate::new(example.metadata().clone(), Graph { inputs: n, steps }).unwrap()
}

/// A polynomial of degree zero.
fn constant() -> Surrogate {
    let example = example::surrogate();
    let scaling = &example.network().unwrap().scaling;
    let graph = Graph::of_polynomial(scaling, Products { inputs: 3, degrees: vec![0; 3] }, &[0.5, -0.25]);
    Surrogate::new(example.metadata().clone(), graph).unwrap()
}

fn no_tree() -> Surrogate {
    let example = example::surrogate();
    let graph = Graph::of_forest(&example.network().unwrap().scaling, Forest::default());
    Surrogate::new(example.metadata().clone(), graph).unwrap()
}

#[test]
fn nominal_and_periodic_inputs_become_the_columns_of_the_evaluator() {
    for hidden in [&[24, 9][..], &[130], &[]] {
        compare_networks(&example::encoded(&example::with_network(hidden, Activation::Tanh)), &SANITIZERS);
    }
}

#[test]
fn fused_multiply_add_changes_no_more_than_rounding() {
    compare_networks(
        &example::with_network(&[40, 40], Activation::Tanh),
        &["-O3", "-march=native", "-ffp-contract=fast"],
    );
}

/// Sources that GCC compiles for several processors, with fused multiply-add where available, beside plain ones.
#[test]
fn the_processor_changes_no_more_than_rounding() {
    for flags in [["-O3", "-ffp-contract=fast"], ["-O3", "-DMETAFMU_PLAIN"]] {
        compare_networks(&example::with_network(&[40, 40], Activation::Tanh), &flags);
        compare(&graph(&example::surrogate()), [10.0, 0.03], &flags);
        compare(&example::crane_with_networks(), [10.0, 1.0], &flags);
    }
}

#[test]
fn the_results_and_derivatives_of_a_motion_are_those_of_the_evaluator() {
    compare(&example::crane(), [1.0, 1.0], &SANITIZERS);
    compare(&example::crane(), [1.0, 1.0], &["-O3", "-march=native"]);
    compare(&example::crane_with_networks(), [10.0, 1.0], &SANITIZERS);
    compare(&example::crane_with_reactions(), [1.0, 1.0], &SANITIZERS);
    compare(&example::crane_with_efforts(), [1.0, 1.0], &SANITIZERS);
    compare(&example::with_prescribed_trolley(&example::crane_with_reactions()), [1.0, 1.0], &SANITIZERS);
    compare(&example::with_prescribed_trolley(&example::crane_with_networks()), [10.0, 1.0], &SANITIZERS);
    // no position, no input
    compare(&pushed_by_nothing(), [1.0, 1.0], &SANITIZERS);
}

/// The crane without its force, whose outputs are energies only.
fn pushed_by_nothing() -> Surrogate {
    let crane = example::crane();
    let motion = crane.program().motion().unwrap();
    let law = motion.dynamics.law().dictionary();
    let factors: Vec<_> = law.factors().collect();
    let mut terms: Vec<_> = law.terms().collect();
    terms.iter_mut().for_each(|term| term.coefficients.truncate(Dynamics::functions(2, 0)));
    let law = Dictionary::new(&factors, Dynamics::functions(2, 0), &terms).unwrap();
    let motion = Motion {
        dynamics: Dynamics::new(2, 0, law).unwrap(),
        positions: Dictionary::new(&factors, 0, &[]).unwrap().into(),
        windings: Vec::new(),
        reactions: None,
        outputs: vec![Shown::PotentialEnergy, Shown::KineticEnergy],
    };
    let mut metadata = crane.metadata().clone();
    metadata.inputs.pop();
    metadata.outputs.drain(..5);
    let integration = crane.program().integration().unwrap();
    Surrogate::new(metadata, Program::of_motion(motion, integration)).unwrap()
}

#[test]
fn the_results_and_derivatives_of_a_state_space_are_those_of_the_evaluator() {
    for surrogate in [
        example::oscillator(None),
        example::oscillator(Some(example::residual_network())),
        example::oscillator_by_graph(),
        turning(Activation::Tanh),
        turning(Activation::Gelu),
        left_alone(),
        without_states(true),
        without_states(false),
    ] {
        compare(&surrogate, [1.0, 1.0], &SANITIZERS);
    }
    compare(&turning(Activation::Silu), [1.0, 1.0], &["-O3", "-march=native"]);
}

#[test]
fn the_outputs_of_a_model_of_samples_are_those_of_the_evaluator() {
    for surrogate in [example::recorded(), example::supported(), window(), two_by_two(), example::cell(), alone()] {
        compare(&surrogate, [1.0, 1.0], &SANITIZERS);
    }
}

/// A wheel whose angle and speed are the states, by a network from sine and cosine of the angle, and from the rest: the outputs are the
/// angle and a function.
fn turning(activation: Activation) -> Surrogate {
    let oscillator = example::oscillator(None);
    let mut metadata = oscillator.metadata().clone();
    metadata.states[0].range = None;
    metadata.outputs.push(metadata.outputs[0].clone());
    metadata.outputs[1].name = "torque".into();
    let plain = Factor::Power { middle: 0.5, half: 2.0 };
    let term = |exponents: [i16; 4], coefficients: [f64; 2]| Term {
        exponents: exponents.to_vec(),
        coefficients: coefficients.to_vec(),
    };
    // of mu, force, angle, speed
    let terms = [term([1, 0, -2, 0], [-1.0, 0.5]), term([0, 1, 0, 0], [1.0, 0.0]), term([0, 0, 1, 1], [0.25, -0.125])];
    let number = |index: usize| ((index as f64 * 0.618).fract() - 0.5) as f32;
    let layer = |inputs: usize, outputs: usize, activation| Layer {
        inputs,
        outputs,
        weight: (0..inputs * outputs).map(number).collect::<Vec<f32>>().into(),
        bias: (0..outputs).map(|index| number(7 + index)).collect::<Vec<f32>>().into(),
        activation,
    };
    let network = ScaledNetwork {
        scaling: Scaling {
            input_mean: vec![1.0, 0.0, 0.1, -0.1, 0.5],
            input_scale: vec![0.5, 1.0, 0.7, 0.7, 2.0],
            output_mean: vec![0.1, -0.2],
            output_scale: vec![0.25, 0.5],
        },
        layers: vec![layer(5, 9, activation), layer(9, 6, activation), layer(6, 2, Activation::Identity)],
    };
    let dictionary = Dictionary::new(&[plain, plain, Factor::Angle, plain], 2, &terms).unwrap();
    let results = [Given::State(0), Given::Function(1), Given::State(1), Given::Function(0)];
    of_rates(metadata, Graph::of_rates(&dictionary, Some(Graph::from(&network)), 2, &results))
}

fn of_rates(metadata: Metadata, graph: Graph) -> Surrogate {
    let clock = Clock::Continuous(Integration::Fixed { step: 0.005 });
    Surrogate::new(metadata, Program { graph, clock }).unwrap()
}

/// A state that is its own derivative: no parameter, no input, no function.
fn left_alone() -> Surrogate {
    let oscillator = example::oscillator(None);
    let mut metadata = oscillator.metadata().clone();
    metadata.inputs = vec![metadata.inputs[1].clone()];
    metadata.states.truncate(1);
    let factors = [Factor::Power { middle: 0.0, half: 1.0 }];
    let dictionary = Dictionary::new(&factors, 1, &[]).unwrap();
    of_rates(metadata, Graph::of_rates(&dictionary, None, 1, &[Given::State(0), Given::State(0)]))
}

/// Functions of a force and, if there is one, a parameter, without any state.
fn without_states(has_parameter: bool) -> Surrogate {
    let oscillator = example::oscillator(None);
    let mut metadata = oscillator.metadata().clone();
    let parameters = usize::from(has_parameter);
    metadata.inputs = [&metadata.inputs[..parameters], &metadata.inputs[3..]].concat();
    metadata.states.clear();
    metadata.outputs.push(metadata.outputs[0].clone());
    metadata.outputs[1].name = "square".into();
    let factors = vec![Factor::Power { middle: 0.5, half: 2.0 }; parameters + 1];
    let term = |order: i16, coefficients: [f64; 2]| Term {
        exponents: [vec![1; parameters], vec![order]].concat(),
        coefficients: coefficients.to_vec(),
    };
    let terms = [term(1, [0.5, 0.25]), term(2, [0.0, -1.5])];
    let dictionary = Dictionary::new(&factors, 2, &terms).unwrap();
    let graph = Graph::of_rates(&dictionary, None, 0, &[Given::Function(0), Given::Function(1)]);
    Surrogate::new(metadata, graph).unwrap()
}

/// Discrete-time surrogate with this history, these weights and these constants. `change` may remove its parameter.
fn of_samples(
    history: [usize; 2],
    weights: &[f64],
    constants: &[f64],
    change: impl FnOnce(&mut Metadata),
) -> Surrogate {
    let recorded = example::recorded();
    let mut metadata = recorded.metadata().clone();
    change(&mut metadata);
    let sampling = Sampling { history, ..recorded.program().sampling().unwrap().clone() };
    let graph = Graph::of_samples(weights.len() / constants.len(), weights.to_vec(), constants.to_vec(), None);
    Surrogate::new(metadata, Program { graph, clock: Clock::Sampled(Box::new(sampling)) }).unwrap()
}

/// Nothing is fed back, and there is no parameter and no network.
fn window() -> Surrogate {
    of_samples([0, 4], &[0.4, 0.3, -0.2, 0.1], &[0.01], |metadata| drop(metadata.inputs.remove(0)))
}

/// Two inputs and two outputs, of which one past sample each counts.
fn two_by_two() -> Surrogate {
    let weights = [0.9, 0.2, 0.1, -0.1, 0.02, -0.3, 0.8, 0.05, 0.2, -0.01];
    of_samples([1, 1], &weights, &[0.01, -0.02], |metadata| {
        let again = |input: &Input, name: &str| Input { name: name.into(), ..input.clone() };
        let [position, driven] = [1, 3].map(|index| metadata.inputs[index].clone());
        // of a single past sample the inputs before the start do not count
        metadata.inputs[2] = again(&position, "speed_start");
        metadata.inputs.push(again(&driven, "wind"));
        metadata.outputs.push(metadata.outputs[0].clone());
        metadata.outputs[1].name = "speed".into();
    })
}

/// Nothing drives it, and nothing is hidden.
fn alone() -> Surrogate {
    of_samples([2, 1], &[1.2, -0.5, 0.1], &[0.01], |metadata| metadata.inputs.truncate(2))
}

/// The one that diverges at its second sample.
fn diverging() -> Surrogate {
    let recorded = example::recorded();
    let mut program = recorded.program().clone();
    let Step::Affine { weight, .. } = &mut program.graph.steps[0] else { panic!("it has a linear part") };
    let mut weights: Vec<f64> = weight.iter().collect();
    weights[0] = 1e200;
    *weight = weights.into();
    Surrogate::new(recorded.metadata().clone(), program).unwrap()
}

/// Steps as `tests/steps.c` reads them, with what the evaluator says of each.
struct Steps<'a> {
    surrogate: &'a Surrogate,
    evaluator: Evaluator,
    input: String,
    expected: Vec<Vec<f64>>,
}

impl<'a> Steps<'a> {
    fn of(surrogate: &'a Surrogate) -> Self {
        Self { surrogate, evaluator: Evaluator::new(surrogate), input: String::new(), expected: Vec::new() }
    }

    /// A point with these inputs at the start.
    fn start(&self, inputs: &[f64]) -> Vec<f64> {
        let mut point = inputs.to_vec();
        point.resize(self.evaluator.columns(), 0.0);
        self.evaluator.start(&mut point);
        point
    }

    /// The first input that is driven.
    fn driven(&self) -> usize {
        self.surrogate.inputs().iter().position(|input| input.role == Role::Input).unwrap()
    }

    /// A step with rates of the first driven input.
    fn step(&mut self, anew: bool, point: &mut [f64], size: f64, tolerance: f64, clamp: bool, rates: [f64; 2]) {
        let method = [size, tolerance, f64::from(u8::from(clamp))];
        let words = point.iter().chain(&method).chain(&rates);
        let words: Vec<String> = words.map(|value| format!("{value:e}")).collect();
        self.input += &format!("{} {}\n", u8::from(anew), words.join(" "));
        let of_columns = rates.map(|rate| {
            let mut rates = vec![0.0; point.len()];
            rates[self.driven()] = rate;
            rates
        });
        let domain = Domain::new(self.surrogate.inputs(), self.surrogate.states());
        let drive = Drive { rates: [&of_columns[0], &of_columns[1]], clamp: clamp.then_some(&domain) };
        let tolerance = Some(tolerance).filter(|tolerance| *tolerance > 0.0);
        let step = CommunicationStep { tolerance, ..CommunicationStep::of(size) };
        let (result, after) = match self.evaluator.advance(point, step, drive) {
            Ok(_) => (0.0, 0.0),
            Err(StepError::NotFinite { after }) => (1.0, after),
            Err(StepError::TooManySteps) => (2.0, 0.0),
            Err(StepError::Implausible { after, .. }) => (3.0, after),
            Err(StepError::Underflow { after }) => (4.0, after),
        };
        self.expected.push([&[result, after], &point[self.surrogate.inputs().len()..]].concat());
    }

    /// Whether the C code does the same: how steps ended, in order.
    fn compare(self, flags: &[&str]) -> Vec<f64> {
        self.compare_within(1e-12, flags)
    }

    fn compare_within(self, tolerance: f64, flags: &[&str]) -> Vec<f64> {
        let found = numbers(&run_evaluator(self.surrogate, include_str!("tests/steps.c"), flags, &self.input));
        assert_eq!(found.len(), self.expected.len());
        for (index, (found, expected)) in found.iter().zip(&self.expected).enumerate() {
            assert_within(tolerance, found, expected, 1.0, &format!("step {index}"));
        }
        self.expected.iter().map(|row| row[0]).collect()
    }
}

/// Results and all derivatives, of every kind of model, second derivatives included.
#[test]
fn in_single_precision_results_and_derivatives_are_those_of_the_evaluator_but_for_its_rounding() {
    for (hidden, activation) in LAYERS {
        let surrogate = example::with_network(hidden, activation);
        compare_single(&surrogate, scales_of_networks(&surrogate), 2e-5);
    }
    let per_instant = example::per_instant(&[24, 9], Activation::Tanh, Precision::Double);
    for surrogate in
        [per_instant, example::encoded(&bent(&example::with_network(&[24], Activation::Silu), Activation::Gelu))]
    {
        compare_single(&surrogate, scales_of_networks(&surrogate), 2e-5);
    }
    let example = example::surrogate();
    for surrogate in regressions(&example).into_iter().chain([graph(&example)]) {
        compare_single(&surrogate, [10.0, 0.03], 2e-5);
    }
    // second derivatives are differences of larger terms
    for surrogate in [
        example::crane(),
        example::crane_with_networks(),
        example::crane_with_reactions(),
        example::crane_with_efforts(),
        pushed_by_nothing(),
        example::oscillator(Some(example::residual_network())),
        turning(Activation::Gelu),
        left_alone(),
        without_states(true),
        example::with_prescribed_trolley(&example::crane()),
        example::oscillator_by_graph(),
        example::recorded(),
        example::supported(),
        example::cell(),
        window(),
    ] {
        compare_single(&surrogate, [10.0, 1.0], 2e-5);
    }
}

#[test]
fn in_single_precision_steps_are_those_of_the_evaluator_but_for_its_rounding() {
    let (crane, oscillator) = (example::crane(), example::oscillator(Some(example::residual_network())));
    let controlled = example::integrated(&crane, Integration::ErrorControlled { tolerance: 1e-5, longest: 0.005 });
    let of_crane = &[1.4, 0.4, 0.9, -1.2, 2.0, 3.0][..];
    for (surrogate, inputs) in [(&controlled, of_crane), (&crane, of_crane), (&oscillator, &[1.2, 0.8, -0.5, 0.4])] {
        let mut steps = Steps::of(surrogate);
        let start = steps.start(inputs);
        let driven = steps.driven();
        // the last tolerance is below the least of single precision
        for (tolerance, clamp) in [(0.0, false), (0.0, true), (1e-5, false), (1e-10, false)] {
            let mut point = start.clone();
            for index in 0..200 {
                let rates = [3.0 - f64::from(index % 7), 4.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, 0.02, tolerance, clamp, rates);
                point[driven] += 0.02 * (rates[0] + 0.01 * rates[1]);
            }
        }
        steps.step(true, &mut start.clone(), 1e9, 0.0, false, [0.0; 2]);
        let ends = steps.compare_within(2e-5, &[&SANITIZERS[..], &[SINGLE]].concat());
        assert!(ends[..800].iter().all(|end| *end == 0.0) && ends[800..] == [2.0]);
    }
    let surrogate = example::recorded();
    let mut steps = Steps::of(&surrogate);
    let start = steps.start(&[1.3, 0.4, 0.25, 1.0]);
    for sizes in [&[0.1][..], &[0.1 / 3.0], &[0.25, 0.37, 0.02, 0.1, 1.7], &[0.1 * (1.0 + 1e-7)]] {
        let mut point = start.clone();
        for (index, size) in (0..60).zip(sizes.iter().cycle()) {
            steps.step(index == 0, &mut point, *size, 0.0, true, [1.0, 0.0]);
            point[3] = 4.0 * (0.37 * f64::from(index)).sin();
        }
    }
    assert!(steps.compare_within(2e-5, &[&SANITIZERS[..], &[SINGLE]].concat()).iter().all(|end| *end == 0.0));
}

/// A million turns away a single has no digit left of an angle; whole turns are taken off before.
#[test]
fn in_single_precision_an_angle_may_go_around_for_long() {
    for (surrogate, inputs, angle) in [
        (example::crane(), &[1.4, 0.4, 0.9, -1.2, 2.0, 3.0][..], 7),
        (turning(Activation::Tanh), &[1.2, 0.8, -0.5, 0.4], 4),
    ] {
        let mut steps = Steps::of(&surrogate);
        let mut point = steps.start(inputs);
        let turns = 1e6 * std::f64::consts::TAU;
        for index in 0..50 {
            point[angle] += turns;
            let input: Vec<String> = point.iter().map(|value| format!("{value:e}")).collect();
            steps.input += &format!("1 {} 0.02 0 0 0 0\n", input.join(" "));
            point[angle] -= turns;
            let text = std::mem::take(&mut steps.input);
            steps.step(index == 0, &mut point, 0.02, 0.0, false, [0.0; 2]);
            steps.input = text;
            steps.expected.last_mut().unwrap()[2 + angle - surrogate.inputs().len()] += turns;
        }
        let found = numbers(&run_evaluator(&surrogate, include_str!("tests/steps.c"), &[SINGLE], &steps.input));
        for (found, expected) in found.iter().zip(&steps.expected) {
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-6 * expected.abs().clamp(1.0, 10.0), "{found} {expected}");
            }
        }
        assert_eq!(found.len(), 50);
    }
}

/// Functions with arithmetic in double precision by the instructions of this processor: those of times, turns and valid values only.
#[cfg(target_arch = "x86_64")]
#[test]
fn in_single_precision_nothing_is_computed_in_double_precision_but_times_turns_and_values() {
    let may = [
        "advance_fixed",
        "advance_with_error_control",
        "by_inputs",
        "encode",
        "encode_rates",
        "enter",
        "find_turns",
        "go_on",
        "model_advance",
        "model_evaluate",
        "model_turned",
        "nearest",
        "parts",
        "within",
    ];
    let example = example::surrogate();
    let [polynomial, forest, kernel] = regressions(&example);
    for surrogate in [
        example::encoded(&example::per_instant(&[24, 9], Activation::Tanh, Precision::Double)),
        polynomial,
        forest,
        kernel,
        graph(&example),
        example::crane_with_networks(),
        example::crane_with_reactions(),
        example::crane_with_efforts(),
        turning(Activation::Gelu),
        example::oscillator_by_graph(),
        example::recorded(),
        example::supported(),
        example::cell(),
    ] {
        let folder = tempfile::tempdir().unwrap();
        write_sources(folder.path(), &surrogate, FmiVersion::V2);
        let mut instructions = 0;
        for name in compiled(&surrogate, FmiVersion::V2) {
            if ["fmi2.c", "instance.c"].contains(&name) {
                continue;
            }
            let assembly = compile(folder.path(), &[name], &[SINGLE, "-fno-inline", "-S"], "code.s");
            let mut function = String::new();
            for line in fs::read_to_string(assembly).unwrap().lines() {
                if let Some(label) = line.strip_suffix(':').filter(|label| !label.starts_with('.')) {
                    function = label.split('.').next().unwrap().into();
                }
                let word = line.split_whitespace().next().unwrap_or("");
                let is_arithmetic = ["add", "sub", "mul", "div", "sqrt"]
                    .iter()
                    .any(|kind| ["sd", "pd"].iter().any(|end| word.trim_start_matches('v') == format!("{kind}{end}")));
                let is_allowed = may.iter().any(|name| function.ends_with(name));
                assert!(!is_arithmetic || is_allowed, "{name}, {function}: {line}");
                instructions += usize::from(word.ends_with("ss") || word.ends_with("ps"));
            }
        }
        assert!(instructions > 10, "the model is computed in single precision");
    }
}

#[test]
fn in_single_precision_what_has_no_meaning_is_no_program() {
    let refused = |surrogate: &Surrogate| {
        let folder = tempfile::tempdir().unwrap();
        write_sources(folder.path(), surrogate, FmiVersion::V2);
        let output = compiler()
            .args(["-std=c99", "-c", SINGLE, "-o"])
            .args([folder.path().join("data.o"), folder.path().join(FOLDER).join("model_data.c")])
            .output()
            .unwrap();
        assert!(!output.status.success());
        // in double precision it is one
        compile(folder.path(), &["model_data.c"], &["-c"], "data.o");
        String::from_utf8(output.stderr).unwrap()
    };
    let with = |change: &dyn Fn(&mut ScaledNetwork)| {
        let surrogate = example::with_network(&[24], Activation::Tanh);
        let mut network = surrogate.network().unwrap();
        change(&mut network);
        Surrogate::new(surrogate.metadata().clone(), Graph::from(&network)).unwrap()
    };
    let cancelling = with(&|network| {
        let last = network.layers.last_mut().unwrap();
        last.weight =
            (0..last.weight.len()).map(|index| if index % 2 == 0 { 3e6 } else { -3e6 }).collect::<Vec<f64>>().into();
    });
    assert!(refused(&cancelling).contains("the terms of a sum nearly cancel"), "{}", refused(&cancelling));
    // which is not a matter of units
    let mut metadata = cancelling.metadata().clone();
    metadata.outputs.iter_mut().for_each(|output| (output.min, output.max) = (-1e6, 1e6));
    let large = Surrogate::new(metadata.clone(), cancelling.program().clone()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    write_sources(folder.path(), &large, FmiVersion::V2);
    compile(folder.path(), &["model_data.c"], &["-c", SINGLE], "data.o");
    metadata.inputs[0].max = 1e200;
    let wide = Surrogate::new(metadata, cancelling.program().clone()).unwrap();
    let [.., kernels] = regressions(&example::surrogate());
    let mut graph = kernels.program().graph.clone();
    let affine = graph.steps.iter_mut().find(|step| matches!(step, Step::Affine { .. }));
    let Some(Step::Affine { weight, .. }) = affine else { panic!("it has kernels") };
    *weight = weight.iter().map(|weight| 1e8 * weight).collect::<Vec<f64>>().into();
    let kernels = Surrogate::new(kernels.metadata().clone(), graph).unwrap();
    assert!(refused(&kernels).contains("the terms of a sum nearly cancel"));
    for huge in [
        with(&|network| network.scaling.output_mean[0] = 1e300),
        with(&|network| network.scaling.input_scale[0] = 1e-60),
        wide,
    ] {
        assert!(refused(&huge).contains("the model has numbers, or ranges, that single precision has not"));
    }
}

/// Two hundred steps of a crane by each method with a force that changes, and steps that fail, in C and in Rust.
#[test]
fn the_steps_of_a_motion_are_those_of_the_evaluator() {
    for integration in [Integration::Fixed { step: 0.005 }, CONTROLLED] {
        let surrogate = example::integrated(&example::crane(), integration);
        let mut steps = Steps::of(&surrogate);
        let start = steps.start(&[1.4, 0.4, 0.9, -1.2, 2.0, 3.0]);
        for (tolerance, clamp) in [(0.0, false), (1e-7, false), (0.0, true), (1e-2, true)] {
            let mut point = start.clone();
            for index in 0..200 {
                let rates = [30.0 - 10.0 * f64::from(index % 7), 40.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, 0.02, tolerance, clamp, rates);
                point[5] += 0.02 * (rates[0] + 0.01 * rates[1]);
            }
        }
        let limit = surrogate.states()[0].limit();
        for (rope, far, size) in [(0.0, 0.4, 0.1), (1.4, 0.1 - limit, 0.2), (1.4, 0.4, 0.0), (-1.0, 0.4, 0.3)] {
            let mut point = start.clone();
            (point[0], point[6]) = (rope, far);
            steps.step(true, &mut point, size, 0.0, false, [0.0; 2]);
        }
        steps.step(true, &mut start.clone(), 1e9, 0.0, false, [0.0; 2]);
        let ends = steps.compare(&SANITIZERS);
        assert!(ends[..800].iter().all(|end| *end == 0.0));
        assert_eq!((ends[800], ends[801], ends[802]), (1.0, 3.0, 0.0), "{integration:?}");
        assert_eq!(ends[804], 2.0);
    }
}

/// With this integration a tolerance that a host may give is looked at.
const CONTROLLED: Integration = Integration::ErrorControlled { tolerance: 1e-5, longest: 0.02 };

#[test]
fn the_steps_of_a_state_space_are_those_of_the_evaluator() {
    let by_network = example::oscillator(Some(example::residual_network()));
    let controlled = [&by_network, &turning(Activation::Tanh)].map(|space| example::integrated(space, CONTROLLED));
    for surrogate in [by_network, example::oscillator_by_graph()].into_iter().chain(controlled) {
        let mut steps = Steps::of(&surrogate);
        let start = steps.start(&[1.2, 0.8, -0.5, 0.4]);
        for (tolerance, clamp) in [(0.0, false), (1e-7, false), (0.0, true), (1e-2, true)] {
            let mut point = start.clone();
            for index in 0..200 {
                let rates = [3.0 - f64::from(index % 7), 4.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, 0.02, tolerance, clamp, rates);
                point[3] += 0.02 * (rates[0] + 0.01 * rates[1]);
            }
        }
        for (speed, size) in [(1e300, 1e5), (1.0, 0.0), (1.0, 0.3)] {
            let mut point = start.clone();
            point[5] = speed;
            steps.step(true, &mut point, size, 0.0, false, [0.0; 2]);
        }
        steps.step(true, &mut start.clone(), 1e9, 0.0, false, [0.0; 2]);
        let ends = steps.compare(&SANITIZERS);
        assert_eq!(ends[803], 2.0);
        assert!(ends[..800].iter().all(|end| *end == 0.0) && ends[800] > 0.0, "{:?}", &ends[800..]);
    }
}

/// Whole samples, parts of them, several, and such that miss samples a little.
#[test]
fn the_steps_of_a_model_of_samples_are_those_of_the_evaluator() {
    for (surrogate, inputs) in [
        (example::recorded(), &[1.3, 0.4, 0.25, 1.0][..]),
        (window(), &[0.4, 0.25, 1.0]),
        (two_by_two(), &[1.3, 0.4, -0.2, 1.0, -2.0]),
        (example::cell(), &[1.3, 0.4, 1.0]),
    ] {
        let mut steps = Steps::of(&surrogate);
        let start = steps.start(inputs);
        let driven = steps.driven();
        for (sizes, clamp) in [
            (&[0.1][..], false),
            (&[0.05], true),
            (&[0.1 / 3.0], false),
            (&[0.25, 0.37, 0.02, 0.1, 1.7], true),
            (&[0.1 * (1.0 + 1e-7), 0.1 * (1.0 - 3e-7)], false),
            (&[0.0, 1e-9, 0.1], false),
        ] {
            let mut point = start.clone();
            for (index, size) in (0..60).zip(sizes.iter().cycle()) {
                let rates = [30.0 - 10.0 * f64::from(index % 7), 40.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, *size, 0.0, clamp, rates);
                point[driven] = 4.0 * (0.37 * f64::from(index)).sin();
            }
        }
        steps.step(true, &mut start.clone(), 2e6, 0.0, false, [0.0; 2]);
        let ends = steps.compare(&SANITIZERS);
        assert!(ends[..360].iter().all(|end| *end == 0.0) && ends[360..] == [2.0]);
    }
    let surrogate = diverging();
    let mut steps = Steps::of(&surrogate);
    let start = steps.start(&[1.3, 0.4, 0.25, 1.0]);
    for size in [0.1, 0.15, 1.0] {
        steps.step(true, &mut start.clone(), size, 0.0, false, [0.0; 2]);
    }
    assert_eq!(steps.compare(&SANITIZERS), [0.0, 1.0, 1.0]);
}

/// A surrogate's FMU with the library of its sources and with the packed one, for each version and interface that it has.
fn in_c_and_rust(surrogate: &Surrogate) -> Vec<[Fmu; 2]> {
    let folder = tempfile::tempdir().unwrap();
    let mut pairs = Vec::new();
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let paths = [c_fmu(folder.path(), surrogate, version), rust_fmu(folder.path(), surrogate, version)];
        let is_discrete = surrogate.program().sampling().is_some();
        let interfaces = [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange];
        for interface in interfaces.into_iter().filter(|kind| !is_discrete || *kind == InterfaceKind::CoSimulation) {
            pairs.push(paths.each_ref().map(|path| Fmu::open_for(path, interface).unwrap()));
        }
    }
    pairs
}

#[test]
fn a_whole_run_is_that_of_the_packed_library() {
    let example = example::with_network(&[20, 20], Activation::Tanh);
    let [polynomial, forest, kernel] = regressions(&example);
    let per_instant = example::per_instant(&[20, 20], Activation::Tanh, Precision::Double);
    let covered = example::with_cover(&example);
    for surrogate in [bent(&example, Activation::Tanh), example, covered, per_instant, polynomial, forest, kernel] {
        compare_run_of_example(&seal(surrogate).unwrap());
    }
}

fn compare_run_of_example(surrogate: &Surrogate) {
    for fmus in in_c_and_rust(surrogate) {
        // inside the domain, and outside with each policy that goes on
        for (speed, policy) in [(4.5, 0.0), (7.0, 0.0), (7.0, 1.0)] {
            let start_values = [("length", 0.13), ("speed", speed), ("domain_policy", policy)];
            let start_values = start_values.map(|(name, value)| (name.to_owned(), value)).into();
            let options = SimulationOptions { start_values, step: Some(0.013), ..SimulationOptions::default() };
            let [found, expected] =
                fmus.each_ref().map(|fmu| simulate(&fmu.instantiate("run", false).unwrap(), &options).unwrap());
            assert_eq!((&found.columns, &found.times), (&expected.columns, &expected.times));
            assert_eq!((found.rows.len(), found.columns.len()), (155, 4));
            for (found, expected) in found.rows.iter().zip(&expected.rows) {
                assert_close(found, expected, 6.0, "run");
            }
        }
    }
}

/// A run with a force that jumps, by each policy that goes on.
fn compare_run(surrogate: Surrogate, starts: &[(&str, f64)], record: &[&str], step: f64) {
    let surrogate = seal(surrogate).unwrap();
    for fmus in in_c_and_rust(&surrogate) {
        for policy in [0.0, 1.0] {
            let start_values = starts.iter().copied().chain([("domain_policy", policy)]);
            let options = SimulationOptions {
                start_values: start_values.map(|(name, value)| (name.to_owned(), value)).collect(),
                stop: Some(2.0),
                step: Some(step),
                inputs: Inputs {
                    names: vec!["force".into()],
                    times: vec![0.0, 0.5, 0.5, 2.0],
                    rows: vec![vec![-4.0], vec![12.0], vec![3.0], vec![-14.0]],
                },
                record: record.iter().map(|name| (*name).to_owned()).collect(),
                ..SimulationOptions::default()
            };
            let [found, expected] =
                fmus.each_ref().map(|fmu| simulate(&fmu.instantiate("run", false).unwrap(), &options).unwrap());
            assert_eq!((&found.columns, &found.times), (&expected.columns, &expected.times));
            let outputs = surrogate.outputs().len();
            assert!(found.rows.len() > 100 && found.columns.len() >= outputs + record.len(), "{:?}", found.columns);
            for (found, expected) in found.rows.iter().zip(&expected.rows) {
                assert_close(found, expected, 10.0, "run");
            }
        }
    }
}

#[test]
fn a_whole_run_with_an_input_is_that_of_the_packed_library() {
    let record = ["rope.angular_velocity", "der(rope.angular_velocity)"];
    compare_run(example::crane(), &[("rope", 1.3), ("rope.angle_start", 0.8)], &record, 0.013);
    let by_network = example::oscillator(Some(example::residual_network()));
    for surrogate in [by_network, example::oscillator_by_graph(), turning(Activation::Tanh)] {
        compare_run(surrogate, &[("mu", 1.3), ("x_start", 0.8)], &["v", "der(v)"], 0.013);
    }
    compare_run(without_states(true), &[("mu", 1.3)], &["domain_distance"], 0.013);
    compare_run(example::recorded(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
    compare_run(example::supported(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
    compare_run(window(), &[("force_start", 0.8)], &[], 0.013);
    compare_run(example::cell(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
}

/// What an instance says in the middle of a run: states as bytes and derivatives. Policy 1 clamps the inputs.
fn said_in_a_run(instance: &FmuInstance, surrogate: &Surrogate, starts: &[f64]) -> (Vec<u8>, Vec<f64>) {
    let of_inputs = |wanted: fn(Role) -> bool| -> Vec<u32> {
        let indexed = (0..).zip(surrogate.inputs());
        indexed.filter(|(_, input)| wanted(input.role)).map(|(index, _)| index).collect()
    };
    let (parameters, start, driven) = (
        of_inputs(|role| matches!(role, Role::Parameter(_))),
        of_inputs(|role| role == Role::Start),
        of_inputs(|role| role == Role::Input),
    );
    let references = |wanted: fn(&Quantity) -> bool| -> Vec<u32> {
        let variables = surrogate.variables().iter();
        variables.filter(|(_, variable)| wanted(&variable.quantity)).map(|(reference, _)| reference).collect()
    };
    let states = references(|quantity| matches!(quantity, Quantity::State(_)));
    let unknowns = references(|quantity| {
        let distance = Quantity::BuiltIn(BuiltIn::DomainDistance);
        *quantity == distance || matches!(quantity, Quantity::Output(_) | Quantity::State(_) | Quantity::Derivative(_))
    });
    let policy = surrogate.variables().reference(Quantity::BuiltIn(BuiltIn::DomainPolicy)).unwrap();
    instance.set_real(&start, starts).unwrap();
    instance.enter_initialization_mode(0.0, Some(9.0)).unwrap();
    instance.exit_initialization_mode().unwrap();
    instance.set_integer(&[policy], &[1]).unwrap();
    for reference in &driven {
        instance.set_real(&[*reference], &[11.0]).unwrap();
    }
    for step in 0..10 {
        instance.do_step(0.13 * f64::from(step), 0.13).unwrap();
    }
    let knowns = [parameters, driven, states, start].concat();
    let seed: Vec<f64> = (0..knowns.len()).map(|k| 0.25 + k as f64).collect();
    let mut values = instance.directional_derivative(&unknowns, &knowns, &seed).unwrap();
    // outputs of samples have none, and a refusal ends the run
    let orders: &[i32] = if surrogate.program().sampling().is_some() { &[] } else { &[1, 2] };
    for &order in orders {
        values.extend(instance.output_derivatives(&unknowns, &vec![order; unknowns.len()]).unwrap());
    }
    let all = references(|quantity| {
        !matches!(quantity, Quantity::BuiltIn(BuiltIn::DomainPolicy | BuiltIn::InDomain | BuiltIn::Time))
    });
    let mut read = vec![0.0; all.len()];
    instance.get_real(&all, &mut read).unwrap();
    values.extend(read);
    (instance.state().unwrap().to_bytes().unwrap(), values)
}

#[test]
fn states_and_derivatives_in_a_run_are_those_of_the_packed_library() {
    for (surrogate, starts) in [
        // beyond the rail
        (example::crane(), &[4.5, 0.5, 1.5, 0.3][..]),
        (turning(Activation::Tanh), &[3.5, 0.8]),
        (example::recorded(), &[0.5, -0.25]),
        (two_by_two(), &[0.5, -0.25]),
        (example::cell(), &[0.5]),
        (example::oscillator_by_graph(), &[0.5, -0.25]),
    ] {
        let surrogate = seal(surrogate).unwrap();
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let folder = tempfile::tempdir().unwrap();
            let fmus = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
            let [c, rust] = fmus.map(|path| Fmu::open(path).unwrap());
            let [(found, values), (expected, expected_values)] =
                [&c, &rust].map(|fmu| said_in_a_run(&fmu.instantiate("run", false).unwrap(), &surrogate, starts));
            assert_close(&values, &expected_values, 1.0, &format!("{version:?}"));
            assert_eq!(values.len(), expected_values.len());
            // after magic, fingerprint and state, whose numbers are others, and before the checksum
            let end = found.len() - 8;
            assert_eq!((found.len(), &found[17..20]), (expected.len(), &expected[17..20]));
            let numbers = |bytes: &[u8]| -> Vec<f64> {
                bytes[20..end].as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
            };
            assert_close(&numbers(&found), &numbers(&expected), 1.0, "snapshot");
            assert_eq!((found[7], expected[7]), (3, 3), "version of the layout");
        }
    }
}

/// In the ranges, but not near the data that the surrogate knows of.
#[test]
fn where_no_data_are_near_is_as_in_the_packed_library() {
    let surrogate = seal(example::with_cover(&example::surrogate())).unwrap();
    let reference = |of: BuiltIn| surrogate.variables().reference(Quantity::BuiltIn(of)).unwrap();
    let unknown = [reference(BuiltIn::DomainDistance)];
    for [c, rust] in in_c_and_rust(&surrogate) {
        for (length, speed, policy) in [
            (0.12, 1.0, 0),
            (0.12, 4.5, 0),
            (0.19, 1.5, 0),
            (0.12, 4.5, 1),
            (0.12, 4.5, 2),
            (0.25, 4.5, 0),
            (0.19, 4.5, 2),
        ] {
            let [found, expected] = [&c, &rust].map(|fmu| {
                let instance = fmu.instantiate("run", false).unwrap();
                instance.set_real(&[0, 1], &[length, speed]).unwrap();
                instance.set_integer(&[reference(BuiltIn::DomainPolicy)], &[policy]).unwrap();
                instance.enter_initialization_mode(0.0, None).unwrap();
                let mut values = instance.directional_derivative(&unknown, &[0, 1], &[0.5, 0.25]).unwrap();
                let (mut inside, mut distance) = ([true], [0.0]);
                instance.get_boolean(&[reference(BuiltIn::InDomain)], &mut inside).unwrap();
                instance.get_real(&unknown, &mut distance).unwrap();
                values.extend(distance);
                let left = instance.exit_initialization_mode().map_err(|error| error.to_string());
                (values, inside, left)
            });
            assert_close(&found.0, &expected.0, 1.0, &format!("{length} {speed}"));
            assert_eq!((found.1, found.2.is_ok()), (expected.1, expected.2.is_ok()));
            let is_inside = (length < 0.15) == (speed < 2.5) && length <= 0.2;
            assert_eq!(
                (found.1[0], found.2.is_ok()),
                (is_inside, is_inside || policy != 2),
                "{length} {speed} {policy}"
            );
        }
    }
}

/// Steps that cannot be made: what is said, and what the outputs are afterwards if the host may go on.
#[test]
fn steps_that_fail_say_what_the_library_says() {
    for (surrogate, starts, size, says) in [
        (
            diverging(),
            &[0.4, 0.25][..],
            1.0,
            "the outputs are not finite at the sample 0.2 s after the beginning of the step",
        ),
        (example::recorded(), &[0.4, 0.25], 2e6, "communication step size 2000000 takes more than ten million steps"),
        (
            example::oscillator(None),
            &[1e100, 1.0],
            0.25,
            "the states are not finite 0.005 s after the beginning of the step",
        ),
        (example::oscillator(None), &[1.0, 1.0], 1e9, "takes more than ten million steps of the solver"),
    ] {
        let surrogate = seal(surrogate).unwrap();
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let folder = tempfile::tempdir().unwrap();
            let fmus = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
            let [found, expected] = fmus.map(|path| {
                let fmu = Fmu::open(path).unwrap();
                let instance = fmu.instantiate("run", true).unwrap();
                instance.set_real(&[1, 2], starts).unwrap();
                instance.enter_initialization_mode(0.0, None).unwrap();
                instance.exit_initialization_mode().unwrap();
                instance.take_messages();
                let refused = instance.do_step(0.0, size).unwrap_err().to_string();
                let said: String = instance.take_messages().into_iter().map(|said| said.text).collect();
                let mut output = [0.0];
                instance.get_real(&[surrogate.inputs().len() as u32], &mut output).unwrap();
                (refused + &said, output)
            });
            assert_eq!(found, expected);
            assert_eq!(found.1, [starts[0]]);
            assert!(found.0.contains(says), "{}", found.0);
        }
    }
}

/// What is said and done outside of the valid values of an encoded input, by each policy.
#[test]
fn nominal_and_periodic_inputs_are_checked_as_in_the_library() {
    let surrogate = seal(example::encoded(&example::surrogate())).unwrap();
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let folder = tempfile::tempdir().unwrap();
        let fmus = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
        let fmus = fmus.map(|path| Fmu::open(path).unwrap());
        let (length, speed, policy, distance) = (0, 1, 5, 7);
        for number in 0..3 {
            for value in [0.14, 0.15, 0.2 + 1e-12, 0.19, -7.0] {
                let [found, expected] = fmus.each_ref().map(|fmu| {
                    let instance = fmu.instantiate("run", true).unwrap();
                    instance.take_messages();
                    instance.set_integer(&[policy], &[number]).unwrap();
                    let refused = instance.set_real(&[length, speed], &[value, 1e3]).map_err(|error| error.to_string());
                    let said: String = instance.take_messages().into_iter().map(|said| said.text).collect();
                    let mut values = [0.0; 4];
                    if refused.is_ok() {
                        instance.enter_initialization_mode(0.0, None).unwrap();
                        instance.get_real(&[3, 4, length, distance], &mut values).unwrap();
                    }
                    (refused, said, values)
                });
                assert_eq!((&found.0, &found.1), (&expected.0, &expected.1), "{number} {value}");
                assert_close(&found.2, &expected.2, 6.0, &format!("{number} {value}"));
                let says = found.1 + &found.0.err().unwrap_or_default();
                let is_told = number != 1 && (value == 0.15 || value == 0.19 || value == -7.0);
                assert_eq!(says.contains("is outside the trained values 0.14, 0.1, 0.2"), is_told, "{says}");
            }
        }
    }
}

#[test]
fn the_validator_finds_nothing() {
    let [polynomial, forest, kernel] = regressions(&example::surrogate());
    let per_instant = example::per_instant(&[20], Activation::Tanh, Precision::Double);
    for surrogate in [
        bent(&per_instant, Activation::Tanh),
        example::encoded(&per_instant),
        polynomial,
        forest,
        kernel,
        graph(&example::surrogate()),
        example::with_input(),
        example::crane(),
        example::encoded(&example::with_input()),
        turning(Activation::Tanh),
        without_states(false),
        example::recorded(),
        example::cell(),
        example::oscillator_by_graph(),
        alone(),
    ] {
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let folder = tempfile::tempdir().unwrap();
            let report = validate(c_fmu(folder.path(), &seal(surrogate.clone()).unwrap(), version)).unwrap();
            assert!(report.problems.is_empty(), "{report}");
        }
    }
}

#[test]
fn error_bounds_are_read_as_in_the_library() {
    let mut metadata = example::with_bounds().metadata().clone();
    metadata.arrays.clear();
    let [polynomial, ..] = regressions(&example::surrogate());
    let per_instant = example::per_instant(&[16], Activation::Tanh, Precision::Double);
    let with_bounds = |of: &Surrogate| Surrogate::new(metadata.clone(), of.program().clone()).unwrap();
    for surrogate in [example::surrogate(), per_instant, polynomial].iter().map(with_bounds) {
        check_bounds(&surrogate);
    }
}

fn check_bounds(surrogate: &Surrogate) {
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let folder = tempfile::tempdir().unwrap();
        let fmu = c_fmu(folder.path(), &seal(surrogate.clone()).unwrap(), version);
        assert!(validate(&fmu).unwrap().problems.is_empty(), "{}", validate(&fmu).unwrap());
        let fmu = Fmu::open(&fmu).unwrap();
        let instance = fmu.instantiate("bounds", false).unwrap();
        instance.enter_initialization_mode(0.0, None).unwrap();
        let mut values = [0.0; 2];
        let [first, second] = [0, 1].map(|output| surrogate.variables().reference(Quantity::Bound(output)).unwrap());
        instance.get_real(&[second, first], &mut values).unwrap();
        assert_eq!(values, [0.25, 0.125]);
        assert!(instance.get_real(&[second + 1], &mut values[..1]).is_err());
    }
}

#[test]
fn error_bounds_grow_as_in_the_library() {
    let surrogate = seal(example::with_growing_bounds()).unwrap();
    let [first, last] = [0, 6].map(|output| surrogate.variables().reference(Quantity::Bound(output)).unwrap());
    let force = surrogate.variables().reference(Quantity::Input(5)).unwrap();
    let said = |fmu: &Path| {
        let fmu = Fmu::open(fmu).unwrap();
        let instance = fmu.instantiate("bounds", false).unwrap();
        instance.enter_initialization_mode(5.0, None).unwrap();
        instance.exit_initialization_mode().unwrap();
        let mut said = Vec::new();
        for step in 0..5 {
            instance.do_step(5.0 + 0.6 * f64::from(step), 0.6).unwrap();
            let mut values = [0.0; 2];
            instance.get_real(&[first, last], &mut values).unwrap();
            said.extend(values);
            said.extend(instance.directional_derivative(&[first], &[force], &[1.0]).unwrap());
            said.extend(instance.output_derivatives(&[last], &[1]).unwrap());
        }
        said
    };
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let folder = tempfile::tempdir().unwrap();
        let [c, rust] = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
        assert!(validate(&c).unwrap().problems.is_empty(), "{}", validate(&c).unwrap());
        let (found, expected) = (said(&c), said(&rust));
        assert_close(&found, &expected, 1.0, &format!("{version:?}"));
        assert!((expected[8] - 0.325).abs() < 1e-12 && expected[16] == 0.375, "{expected:?}");
    }
}

/// A program in C that calls everything: right, wrong, and with null pointers.
#[test]
fn the_functions_of_fmi_2_answer_as_the_standard_says() {
    run(&seal(example::with_input()).unwrap(), FmiVersion::V2, include_str!("tests/fmi2_calls.c"));
}

#[test]
fn the_functions_of_fmi_3_answer_as_the_standard_says() {
    run(&seal(example::with_input()).unwrap(), FmiVersion::V3, include_str!("tests/fmi3_calls.c"));
}

#[test]
fn the_functions_of_both_versions_answer_as_the_library_does_of_states() {
    let surrogate = seal(example::crane()).unwrap();
    run(&surrogate, FmiVersion::V2, include_str!("tests/fmi2_motion.c"));
    let controlled = Integration::ErrorControlled { tolerance: 1e-5, longest: 0.005 };
    let surrogate = seal(example::integrated(&example::crane(), controlled)).unwrap();
    run(&surrogate, FmiVersion::V3, include_str!("tests/fmi3_motion.c"));
}

#[test]
fn the_functions_of_fmi_2_answer_as_the_library_does_of_samples() {
    run(&seal(example::recorded()).unwrap(), FmiVersion::V2, include_str!("tests/fmi2_samples.c"));
}

/// What tests/hosts/strict.c prints with the library of a surrogate, by each version and interface: the outputs at the end.
fn run_strict_host(
    surrogate: Surrogate,
    model: &str,
    library_of: impl Fn(&Path, &Surrogate, FmiVersion) -> PathBuf,
) -> Vec<[f64; 2]> {
    let folder = tempfile::tempdir().unwrap();
    let resources = folder.path().join("resources");
    let surrogate = seal(surrogate).unwrap();
    fs::create_dir(&resources).unwrap();
    fs::write(resources.join("model.safetensors"), surrogate.to_bytes().unwrap()).unwrap();
    let host = folder.path().join("strict");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/hosts/strict.c");
    let status = compiler().args(FLAGS).arg(source).arg("-o").arg(&host).arg("-ldl").status().unwrap();
    assert!(status.success());
    let mut found = Vec::new();
    for (version, number, resources) in [
        (FmiVersion::V2, "2", format!("file://{}", resources.display())),
        (FmiVersion::V3, "3", resources.display().to_string()),
    ] {
        let library = library_of(folder.path(), &surrogate, version);
        for interface in ["cs", "me"] {
            let token = surrogate.instantiation_token();
            let arguments = [library.to_str().unwrap(), number, interface, &resources, &token, model];
            let output = Command::new(&host).args(arguments).output().unwrap();
            assert!(output.status.success(), "{number} {interface}: {}", String::from_utf8_lossy(&output.stderr));
            assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
            let text = String::from_utf8(output.stdout).unwrap();
            let numbers: Vec<f64> = text.split_whitespace().map(|number| number.parse().unwrap()).collect();
            found.extend(numbers.chunks(2).map(|outputs| [outputs[0], outputs[1]]));
        }
    }
    // two versions, two interfaces, three domain policies
    assert_eq!(found.len(), 12);
    found
}

fn packed_library(folder: &Path, _: &Surrogate, _: FmiVersion) -> PathBuf {
    let binary = Binary::embedded().into_iter().find(|binary| binary.platform == Platform::CURRENT).unwrap();
    let path = folder.join("packed");
    fs::write(&path, &binary.bytes).unwrap();
    path
}

fn library_of_sources(folder: &Path, surrogate: &Surrogate, version: FmiVersion) -> PathBuf {
    write_sources(folder, surrogate, version);
    let files = compiled(surrogate, version);
    compile(folder, &files, &["-fPIC", "-shared"], &format!("of-sources-{version:?}"))
}

#[test]
fn a_host_that_takes_every_status_but_ok_for_a_failure_finds_none() {
    for library_of in [packed_library, library_of_sources] {
        let found = run_strict_host(example::with_input(), "response", library_of);
        for outputs in &found {
            assert!((0..2).all(|i| (outputs[i] - found[0][i]).abs() < 1e-12), "{found:?}");
        }
    }
}

/// The crane of the example, pushed as the host does: its own equations, integrated here.
#[test]
fn the_same_host_drives_the_input_of_a_motion_by_both_interfaces() {
    let mut state = SVector::from([0.0, 0.3, 0.0, 0.0]);
    for force in [4.0, -6.0, 8.0, -3.0] {
        let derivative = |state: &SVector<f64, 4>| {
            let (l, [_, theta, v, omega]) = (1.3, (*state).into());
            let masses = Matrix2::new(3.0, l * theta.cos(), l * theta.cos(), l * l);
            let swing = l * omega * omega * theta.sin();
            let forces = Vector2::new(force - 0.3 * v + swing, -9.81 * l * theta.sin());
            let accelerations = masses.try_inverse().unwrap() * forces;
            SVector::from([v, omega, accelerations[0], accelerations[1]])
        };
        state = integrate(derivative, state, &[0.0, 0.5], TOLERANCE, &Budget::default()).unwrap()[1];
    }
    for library_of in [packed_library, library_of_sources] {
        let found = run_strict_host(example::crane(), "motion", library_of);
        for outputs in &found {
            assert!((0..2).all(|i| (outputs[i] - state[i]).abs() < 1e-5), "{found:?}, expected {state}");
        }
    }
}

#[test]
fn several_fmus_can_be_linked_into_one_library() {
    let folder = tempfile::tempdir().unwrap();
    let [polynomial, forest, kernel] = regressions(&example::surrogate());
    let per_instant = example::per_instant(&[20], Activation::Tanh, Precision::Double);
    let mut objects = Vec::new();
    for (name, surrogate, version, prefix) in [
        ("one", example::surrogate(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=one_"),
        ("two", example::surrogate(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=two_"),
        ("three", example::surrogate(), FmiVersion::V3, "-DFMI3_FUNCTION_PREFIX=three_"),
        ("four", example::crane(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=four_"),
        ("five", example::crane(), FmiVersion::V3, "-DFMI3_FUNCTION_PREFIX=five_"),
        ("six", example::oscillator(None), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=six_"),
        ("seven", turning(Activation::Tanh), FmiVersion::V3, "-DFMI3_FUNCTION_PREFIX=seven_"),
        ("eight", example::recorded(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=eight_"),
        ("nine", window(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=nine_"),
        ("ten", per_instant, FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=ten_"),
        ("eleven", polynomial.clone(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=eleven_"),
        ("twelve", polynomial, FmiVersion::V3, "-DFMI3_FUNCTION_PREFIX=twelve_"),
        ("thirteen", forest, FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=thirteen_"),
        ("fourteen", kernel, FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=fourteen_"),
        ("fifteen", graph(&example::surrogate()), FmiVersion::V3, "-DFMI3_FUNCTION_PREFIX=fifteen_"),
        ("sixteen", example::cell(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=sixteen_"),
        ("seventeen", example::cell(), FmiVersion::V3, "-DFMI3_FUNCTION_PREFIX=seventeen_"),
        ("eighteen", example::oscillator_by_graph(), FmiVersion::V2, "-DFMI2_FUNCTION_PREFIX=eighteen_"),
    ] {
        let sources = folder.path().join(name);
        fs::create_dir(&sources).unwrap();
        for (file, bytes) in files(&surrogate, name, version) {
            fs::write(sources.join(file.rsplit('/').next().unwrap()), bytes).unwrap();
        }
        for file in compiled(&surrogate, version) {
            let object = sources.join(file).with_extension("o");
            let mut command = compiler();
            // functions are compiled for several processors, under different names
            let level = if version == FmiVersion::V2 { "-O1" } else { "-O0" };
            command.args(FLAGS).args([prefix, level, "-fPIC", "-c", "-o"]).arg(&object).arg(sources.join(file));
            assert!(command.status().unwrap().success());
            objects.push(object);
        }
    }
    let output = compiler().arg("-shared").args(objects).arg("-lm").arg("-o").arg(folder.path().join("all")).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_files_are_sorted_reproducible_and_listed() {
    let [polynomial, forest, kernel] = regressions(&example::surrogate());
    for (surrogate, expected) in [
        (example::surrogate(), vec!["network.c"]),
        (example::per_instant(&[20], Activation::Tanh, Precision::Double), vec!["network.c"]),
        (polynomial, vec!["graph.c"]),
        (forest, vec!["graph.c"]),
        (kernel, vec!["graph.c"]),
        (graph(&example::surrogate()), vec!["graph.c"]),
        (example::crane(), vec!["motion.c"]),
        (example::oscillator(None), vec!["graph.c", "state_space.c"]),
        (example::recorded(), vec!["discrete.c", "graph.c"]),
    ] {
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let found = files(&surrogate, "example", version);
            assert_eq!(found, files(&surrogate, "example", version));
            assert!(found.is_sorted());
            let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
            let compiled = compiled(&surrogate, version);
            for name in &compiled {
                assert!(names.contains(&format!("{FOLDER}/{name}").as_str()), "{name}");
            }
            let models = ["network.c", "graph.c", "motion.c", "state_space.c", "discrete.c"];
            let models: Vec<&str> = compiled.iter().copied().filter(|name| models.contains(name)).collect();
            assert_eq!(models, expected);
            assert_eq!(names.contains(&"sources/buildDescription.xml"), version == FmiVersion::V3);
        }
    }
    let description = build_description(&["model_data.c"], "example");
    assert!(description.contains("<BuildConfiguration modelIdentifier=\"example\">"));
    assert!(description.contains("<SourceFile name=\"model_data.c\"/>"));
}
