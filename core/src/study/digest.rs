//! Digests of the keys that affect results. Every key of the study is in one of these structures, or named here as one
//! without effect: a new key does not compile until that is stated.

use super::{
    BaselineKind, Baselines, BoundsOptions, Excitation, ExportOptions, InputOptions, NetworkOptions, OutputOptions,
    ParameterOptions, ParameterVariability, SamplingOptions, SourceOptions, StateOptions, Study, TargetOptions,
    TimeOptions, TrainingOptions,
};
use crate::{files, multibody::description::Description};
use indexmap::IndexMap;
use metafmu_runtime::Precision;
use serde::Serialize;
use sha2::{Digest, Sha256};

/// Content of the digest that decides the runs.
#[derive(Serialize)]
struct DigestedSamples<'a> {
    seed: u64,
    source: DigestedSource<'a>,
    time: &'a TimeOptions,
    parameters: IndexMap<&'a str, Parameter<'a>>,
    outputs: &'a IndexMap<String, OutputOptions>,
    sampling: DigestedPlan<'a>,
    calibration_runs: usize,
    /// States and inputs; none of a surrogate that has neither.
    #[serde(skip_serializing_if = "Option::is_none")]
    motion: Option<DigestedMotion<'a>>,
}

/// States and inputs in the digest, of a surrogate with states.
#[derive(Serialize)]
struct DigestedMotion<'a> {
    states: &'a IndexMap<String, StateOptions>,
    inputs: IndexMap<&'a str, DigestedInput<'a>>,
}

/// An input in the digest: a recording counts by its content, not by its name.
#[derive(Serialize)]
struct DigestedInput<'a> {
    min: Option<f64>,
    max: Option<f64>,
    start: Option<f64>,
    bandwidth: Option<f64>,
    excitation: &'a Option<Vec<Excitation>>,
    unit: &'a Option<String>,
    description: &'a Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    recording: Option<&'a str>,
}

/// The source in the digest: files count by their content, not by their names.
#[derive(Serialize)]
struct DigestedSource<'a> {
    system: &'a Option<String>,
    mechanism: Option<&'a Description>,
    /// SHA-256 of the FMU, of the command and its files, or of the recorded runs, those of the tests among them.
    files: Option<&'a str>,
    columns: &'a IndexMap<String, String>,
    constants: &'a IndexMap<String, f64>,
    step: Option<f64>,
    tolerance: Option<f64>,
}

#[derive(Serialize)]
struct Parameter<'a> {
    min: f64,
    max: f64,
    values: &'a [f64],
    periodic: bool,
    unit: &'a Option<String>,
    description: &'a Option<String>,
    levels: Option<usize>,
    variability: Option<ParameterVariability>,
}

/// The sampling in the digest: a list's points count, not the name of its file.
#[derive(Serialize)]
struct DigestedPlan<'a> {
    method: Option<super::Method>,
    levels: Option<usize>,
    runs: Option<usize>,
    points: Option<&'a [Vec<f64>]>,
    faces: Option<f64>,
    test_runs: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    train_stop: Option<f64>,
}

/// Content of the digest that decides the surrogate.
#[derive(Serialize)]
struct DigestedTraining<'a> {
    name: &'a str,
    description: &'a str,
    arrays: &'a IndexMap<String, Vec<String>>,
    network: &'a NetworkOptions,
    training: &'a TrainingOptions,
    precision: Precision,
    bounds: Option<BoundsOptions>,
    target: Option<TargetOptions>,
    #[serde(skip_serializing_if = "Option::is_none")]
    states: Option<usize>,
    #[serde(flatten)]
    kind: IndexMap<&'static str, serde_json::Value>,
    samples: String,
}

/// Content of the digest that decides an exported baseline.
#[derive(Serialize)]
struct DigestedBaseline<'a> {
    kind: BaselineKind,
    options: Option<serde_json::Value>,
    name: &'a str,
    arrays: &'a IndexMap<String, Vec<String>>,
    validation: f64,
    samples: String,
}

/// [`Study::sampling_digest`].
pub(super) fn of_samples(study: &Study) -> String {
    let Study { seed, source, time, parameters, outputs, sampling, .. } = study;
    digest(&DigestedSamples {
        seed: *seed,
        source: of_source(study, source),
        time,
        parameters: parameters.iter().map(|(name, options)| (name.as_str(), of_parameter(options))).collect(),
        outputs,
        sampling: of_plan(study, sampling),
        calibration_runs: study.calibration_runs(),
        motion: (!study.runs().are_planned).then(|| DigestedMotion {
            states: &study.states,
            inputs: study
                .inputs
                .iter()
                .map(|(name, options)| (name.as_str(), of_input(study, name, options)))
                .collect(),
        }),
    })
}

fn of_source<'a>(study: &'a Study, options: &'a SourceOptions) -> DigestedSource<'a> {
    // the names of files, and what is done about runs that fail, decide nothing
    let SourceOptions {
        system,
        mechanism: _,
        fmu: _,
        command: _,
        files: _,
        table: _,
        index: _,
        outliers: _,
        columns,
        constants,
        step,
        tolerance,
        time_limit: _,
        retries: _,
        repeats: _,
        memory_limit: _,
        max_failed: _,
    } = options;
    DigestedSource {
        system,
        mechanism: study.mechanism.as_ref().map(|mechanism| mechanism.description()),
        files: study.source_files.as_deref(),
        columns,
        constants,
        step: *step,
        tolerance: *tolerance,
    }
}

fn of_input<'a>(study: &'a Study, name: &str, options: &'a InputOptions) -> DigestedInput<'a> {
    let InputOptions { min, max, start, bandwidth, excitation, recording: _, unit, description } = options;
    DigestedInput {
        min: *min,
        max: *max,
        start: *start,
        bandwidth: *bandwidth,
        excitation,
        unit,
        description,
        recording: study.recording(name).map(|recording| recording.digest()),
    }
}

fn of_parameter(options: &ParameterOptions) -> Parameter<'_> {
    let ParameterOptions { min, max, values, periodic, unit, description, levels, variability, problem: _ } = options;
    Parameter {
        min: *min,
        max: *max,
        values,
        periodic: *periodic,
        unit,
        description,
        levels: *levels,
        variability: *variability,
    }
}

fn of_plan<'a>(study: &'a Study, options: &SamplingOptions) -> DigestedPlan<'a> {
    // the format of the tables decides nothing about their numbers
    let &SamplingOptions { method, levels, runs, states: _, file: _, faces, test_runs, test: _, train_stop, tables: _ } =
        options;
    DigestedPlan { method, levels, runs, points: study.points(), faces, test_runs, train_stop }
}

/// [`Study::digest`].
pub(super) fn of_surrogate(study: &Study) -> String {
    let Study {
        name,
        description,
        arrays,
        network,
        training,
        export,
        bounds,
        target,
        // the kind adds the options of its own section
        dynamics: _,
        discrete: _,
        static_map: _,
        compliant: _,
        has_epochs: _,
        small_networks: _,
        // these decide the runs
        seed: _,
        source: _,
        time: _,
        parameters: _,
        structure: _,
        states: _,
        inputs: _,
        outputs: _,
        sampling,
        starts: _,
        mechanism: _,
        points: _,
        recordings: _,
        source_files: _,
        // these decide nothing about the network
        accept: _,
        baselines: _,
        search: _,
        origin: _,
    } = study;
    let kind = study.structure.kind();
    // what the FMU says of itself
    let ExportOptions { precision, fmi: _, interface: _, ports: _, names: _, author: _, copyright: _, license: _ } =
        export;
    digest(&DigestedTraining {
        name,
        description,
        arrays,
        network,
        training,
        precision: *precision,
        bounds: *bounds,
        target: *target,
        states: sampling.states,
        kind: kind.section().zip(kind.digested(study)).into_iter().collect(),
        samples: of_samples(study),
    })
}

/// [`Study::baseline_digest`].
pub(super) fn of_baseline(study: &Study, kind: BaselineKind) -> String {
    digest(&DigestedBaseline {
        kind,
        options: options_of(&study.baselines, kind),
        name: &study.name,
        arrays: &study.arrays,
        validation: study.training.validation,
        samples: of_samples(study),
    })
}

fn options_of(baselines: &Baselines, kind: BaselineKind) -> Option<serde_json::Value> {
    serde_json::to_value(baselines).ok()?.get(kind.name()).cloned()
}

/// SHA-256 of content as JSON, in hexadecimal digits.
pub(super) fn digest(content: &impl Serialize) -> String {
    // plain data with string keys: serialization cannot fail, and if it did, no digest could match
    let text = serde_json::to_string(content).unwrap_or_default();
    files::digits(Sha256::new_with_prefix(text))
}
