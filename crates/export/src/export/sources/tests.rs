//! C sources, compiled and compared with the library.

use super::*;
use crate::{
    export::{Binary, Contents, pack, validate},
    fmi::{
        Fmu, FmuInstance, Inputs, InterfaceKind, Platform, SimulationOptions, identifier::model_identifier, simulate,
    },
    study::ExportOptions,
    surrogate::seal,
};
use metafmu_example as example;
use metafmu_numerics::integrate::{Budget, TOLERANCE, integrate};
use metafmu_runtime::{
    Activation, BuiltIn, Clock, CommunicationStep, Domain, Drive, Dynamics, Encoder, Evaluator, Graph, Input,
    Integration, Layer, Metadata, Motion, Precision, Program, Quantity, Role, Sampling, ScaledNetwork, Scaling, Shown,
    StepError, Variables,
    dictionary::{Dictionary, Factor, Term},
    graph::{Elementwise, Forest, Given, KernelMachine, LEAF, Node, Operation, ProcessDeviation, Products, Step, Tree},
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

mod hosts;
mod models;
mod single;
mod values;

use models::*;

/// Every warning is an error, as it is where real-time code is certified.
const FLAGS: [&str; 8] =
    ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror"];

/// Undefined behavior and wrong memory accesses end the program. Without optimization, compilation takes a third of the
/// time, and code that the compiler would remove is checked as well.
const SANITIZERS: [&str; 4] = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"];

const SINGLE: &str = "-DMETAFMU_SINGLE";

fn compiler() -> Command {
    Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()))
}

/// Files of FMI 2.0 that the evaluation does not need: what hosts see.
const HOST_FILES: [&str; 8] =
    ["derivatives.c", "domain.c", "fmi2.c", "instance.c", "messages.c", "snapshot.c", "steps.c", "variables.c"];

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
        // half the time of -O2, at which the same files are compiled to be linked into one library
        let library = compile(folder, &compiled(surrogate, version), &["-Og", "-fPIC", "-shared"], "library");
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

/// Runs a program of the `tests` folder that calls the evaluator, linked with the sources, and returns its output.
fn run_evaluator(surrogate: &Surrogate, program: &str, flags: &[&str], input: &str) -> String {
    let version = FmiVersion::V2;
    let mut files = compiled(surrogate, version);
    files.retain(|name| !HOST_FILES.contains(name));
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
    // past samples
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

/// Compares the C code in single precision with the evaluator, except at the far point, where digits get lost.
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
    // periodic and nominal inputs have a scale of less than one
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

/// Steps as `tests/steps.c` reads them, with the evaluator's result of each.
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

    /// Compares the C code with the evaluator. Returns how the steps ended, in order.
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
            // optimized, functions are compiled for several processors, under different names, and the compiler warns of more
            let level = if version == FmiVersion::V2 { "-O2" } else { "-O0" };
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
