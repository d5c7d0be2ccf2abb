//! The study file: what is sampled, how, and what is made of it.
//!
//! TOML, read by [`Study::load`]. Every mistake is reported with file, line and key, and all of them at once.
//!
//! ```toml
//! name = "single-pendulum"              # names the outputs and the FMU
//! seed = 1
//!
//! [source]
//! system = "single-pendulum"            # a built-in system; `metafmu new --help` lists them; or
//! # mechanism = "four-bar.toml"         # a mechanism file (see `multibody::description`), relative to this file; or
//! # fmu = "model.fmu"                   # an FMU of any tool (see `source::fmu`); or
//! # table = "runs.csv"                  # recorded runs, CSV or Parquet (see `source::recorded`), or an `index` of files
//! constants = { m = 0.3 }               # quantities that are no parameters; there are defaults
//!
//! [time]                                # rows of a run: 0, step, 2 step, ..., stop, in seconds
//! stop = 2.0
//! step = 0.01
//! margin = 0.05                         # optional: training runs are longer by this share of `stop`
//!
//! [parameters]                          # inputs of the surrogate, beside the time
//! L = { min = 0.1, max = 0.2, unit = "m" }
//! thetad0 = { min = 0.0, max = 5.0, variability = "tunable" }  # else "fixed"; "continuous": an input
//! theta0 = { min = -3.141592653589793, max = 3.141592653589793, periodic = true }  # max is min again
//! m = { values = [0.1, 0.3, 1.0] }      # nominal: it has these values only
//!
//! [outputs]
//! theta = { unit = "rad" }
//!
//! [arrays]                              # optional: outputs of one unit that FMI 3.0 also offers as an array
//! angles = ["theta1", "theta2"]
//!
//! [sampling]
//! method = "mesh"                       # or "random", "latin-hypercube", "sobol", "halton" with `runs`, "list" with a `file`
//! levels = 11                           # of each parameter; a parameter may have `levels` of its own
//! faces = 0.1                           # optional, not of a mesh: share of the training runs on the ends of each range
//! test_runs = 200
//! ```
//!
//! `[target]` is [`TargetOptions`], `[bounds]` is [`BoundsOptions`], `[network]` and `[training]` are [`NetworkOptions`] and
//! [`TrainingOptions`], `[accept]` is [`AcceptOptions`], `[export]` is [`ExportOptions`], `[baselines]` is [`Baselines`],
//! `[search]` is [`SearchOptions`].

mod options;
mod points;
mod search;

use crate::{
    Result,
    diagnostics::origin::{self, Origin},
    files,
    multibody::Mechanism,
    table::Table,
};
use indexmap::IndexMap;
use metafmu_baselines::{Baselines, Kind};
use metafmu_runtime::{BuiltIn, Encoder, Encoding};
use options::MAX_EPOCHS;
pub use options::{
    AcceptOptions, BoundsOptions, ExportOptions, FmiChoice, Loss, Method, NetworkOptions, Optimizer, OutputOptions,
    ParameterOptions, SamplingOptions, Schedule, SourceOptions, Structure, TargetOptions, TimeOptions, TrainingOptions,
    Variability,
};
pub use points::{MAX_HALTON_PARAMETERS, MAX_SOBOL_PARAMETERS, read_value};
pub use search::{Range, Scale, SearchMethod, SearchOptions, Space};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// A study file's content, validated.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Names the outputs and the FMU: letters, digits, `-` and `_`.
    pub name: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
    /// Everything random follows from it.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// What is sampled.
    pub source: SourceOptions,
    /// The time of a run.
    pub time: TimeOptions,
    /// Parameters by name: the surrogate's inputs beside the time.
    pub parameters: IndexMap<String, ParameterOptions>,
    /// Outputs by name.
    pub outputs: IndexMap<String, OutputOptions>,
    /// Outputs of one unit that an FMI 3.0 FMU also offers as an array, by the array's name.
    #[serde(default)]
    pub arrays: IndexMap<String, Vec<String>>,
    /// How the parameters are sampled.
    pub sampling: SamplingOptions,
    /// The feed-forward network.
    #[serde(default)]
    pub network: NetworkOptions,
    /// How the network is trained.
    #[serde(default)]
    pub training: TrainingOptions,
    /// How good the surrogate is to be, if runs are to be added until it is.
    pub target: Option<TargetOptions>,
    /// Error bounds of the outputs, if they are wanted.
    pub bounds: Option<BoundsOptions>,
    /// When a surrogate is good enough to be used. It decides nothing else and does not count for digests.
    #[serde(default)]
    pub accept: AcceptOptions,
    /// What the FMU says about itself.
    #[serde(default)]
    pub export: ExportOptions,
    /// Models that are compared with the network.
    #[serde(default)]
    pub baselines: Baselines,
    /// Studies like this one that are tried in search of the best.
    pub search: Option<SearchOptions>,
    #[serde(skip)]
    origin: Origin,
    #[serde(skip)]
    mechanism: Option<Arc<Mechanism>>,
    /// The points of the method "list".
    #[serde(skip)]
    points: Option<Arc<Vec<Vec<f64>>>>,
    /// Digest of the FMU or of the tables of recorded runs.
    #[serde(skip)]
    source_files: Option<String>,
}

/// Communication steps of a run of an FMU.
const MAX_STEPS: f64 = 1e8;

/// Characters of a study's name, which is part of the names of files; most systems take 255.
const MAX_NAME: usize = 100;

/// Runs for one purpose: the points of so many are a few gigabytes.
pub(crate) const MAX_RUNS: usize = 10_000_000;

/// Rows of all runs together.
const MAX_ROWS: f64 = 1e9;

/// Bytes of the outputs of all rows.
const MAX_BYTES: f64 = 64e9;

/// Weights and biases of all networks: training holds several copies of them in single precision.
const MAX_WEIGHTS: f64 = 1e8;

/// Epochs of all networks where there is one for each instant: each has its history.
const MAX_HISTORIES: f64 = 1e8;

/// Runs that are added each time: the places of each are chosen among thirty.
const MAX_ADDED_RUNS: usize = 100_000;

/// Fewest held-out runs a `[target]` is judged on. Errors differ from run to run: that the next run is worse than the worst of
/// `n` has a chance of `1 / (n + 1)`, which is below a tenth from here on; of three runs it is a quarter.
const LEAST_JUDGES: usize = 10;

fn default_seed() -> u64 {
    1
}

impl Study {
    /// Reads and validates a study file.
    ///
    /// # Errors
    /// [`crate::Error::Io`] if it cannot be read, [`crate::Error::Study`] with every problem found.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&origin::read(path, "a study in TOML")?, path)
    }

    /// Validates a study file's text, and reads the files it names; `path` is for messages and tells the folder.
    ///
    /// # Errors
    /// [`crate::Error::Study`] with every problem found in the study or in the mechanism, [`crate::Error::Table`] if the list of points is
    /// wrong.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let origin = Origin::new(path, text);
        let hint = "this is a mechanism, expected a study: `metafmu new NAME --mechanism FILE` writes one";
        origin.refuse_section("bodies", hint)?;
        let mut study: Self = origin.deserialize()?;
        let problems = study.problems();
        study.origin = origin;
        study.refuse(problems)?;
        if let Some(file) = &study.source.mechanism {
            study.mechanism = Some(Arc::new(Mechanism::load(&study.beside(file))?));
        }
        study.source_files = study.digest_source_files()?;
        if let Some(file) = &study.sampling.file {
            study.points = Some(Arc::new(points::read_points(&study.beside(file), &study.parameters)?));
            let mut problems = Problems::default();
            study.size_problems(&mut problems);
            study.target_run_problems(&mut problems);
            study.refuse(problems.0)?;
        }
        Ok(study)
    }

    /// Where a file is that the study names.
    pub fn beside(&self, file: &Path) -> PathBuf {
        self.origin.folder().join(file)
    }

    /// SHA-256 of the FMU or of the tables of recorded runs, if there are any.
    fn digest_source_files(&self) -> Result<Option<String>> {
        let SourceOptions { fmu, table, index, columns, .. } = &self.source;
        if let Some(file) = fmu.as_ref().or(table.as_ref()) {
            return Ok(Some(files::digest(&self.beside(file))?));
        }
        let Some(index) = index else { return Ok(None) };
        let path = self.beside(index);
        let mut digests = vec![files::digest(&path)?];
        let mut rows = Table::open(&path)?;
        let column = rows.column(columns.get("file").map_or("file", String::as_str))?;
        while rows.next_row()? {
            let file = path.with_file_name(&*rows.text(column)?);
            digests.push(files::digest(&file).map_err(|error| rows.mistake(&error.to_string()))?);
        }
        Ok(Some(digest(&digests)))
    }

    /// The mechanism that the study's source names.
    pub fn mechanism(&self) -> Option<&Arc<Mechanism>> {
        self.mechanism.as_ref()
    }

    /// The points of the method "list".
    pub fn points(&self) -> Option<&[Vec<f64>]> {
        self.points.as_ref().map(|points| points.as_slice())
    }

    /// SHA-256 of what decides the surrogate, in hexadecimal digits: comments, layout and `[export]` but for the precision
    /// do not count.
    pub fn digest(&self) -> String {
        let about = (&self.name, &self.description, &self.arrays);
        let trained = (about, &self.network, &self.training, &self.export.precision, self.sampling_digest());
        match (&self.bounds, &self.target) {
            (None, None) => digest(&trained),
            (bounds, None) => digest(&(trained, bounds)),
            (bounds, target) => digest(&(trained, bounds, target)),
        }
    }

    /// Like [`Study::digest`], of what decides a baseline that is exported.
    pub fn baseline_digest(&self, kind: Kind) -> String {
        let options = serde_json::to_value(&self.baselines).unwrap_or_default();
        digest(&(
            kind,
            options.get(kind.name()),
            &self.name,
            &self.arrays,
            self.training.validation,
            self.sampling_digest(),
        ))
    }

    /// Like [`Study::digest`], of what decides the samples only: a table sampled before the network was changed stays good.
    pub fn sampling_digest(&self) -> String {
        let study = (self.seed, &self.source, &self.time, &self.parameters, &self.outputs, &self.sampling);
        let mechanism = self.mechanism.as_ref().map(|mechanism| mechanism.description());
        match (mechanism, self.points(), &self.source_files) {
            (None, None, None) if self.bounds.is_none() => digest(&study),
            files => digest(&(study, files, self.calibration_runs())),
        }
    }

    /// Fails if there are problems; each is a dotted key and what is wrong with it, and is given its line here.
    ///
    /// # Errors
    /// [`crate::Error::Study`].
    pub fn refuse(&self, problems: Vec<(String, String)>) -> Result<()> {
        self.origin.refuse(problems)
    }

    fn problems(&self) -> Vec<(String, String)> {
        let mut problems = Problems::default();
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if !self.name.starts_with(|c: char| c.is_ascii_alphabetic()) || !self.name.chars().all(plain) {
            let expected = "expected a letter, then letters, digits, `-` and `_`";
            problems.add("name", format!("`{}` is not a valid name: {expected}", self.name));
        }
        let characters = self.name.chars().count();
        if characters > MAX_NAME {
            problems
                .add("name", format!("{characters} characters, expected at most {MAX_NAME}: files are named after it"));
        }
        self.source_problems(&mut problems);
        self.fmu_problems(&mut problems);
        self.time_problems(&mut problems);
        self.variable_problems(&mut problems);
        self.sampling_problems(&mut problems);
        self.target_problems(&mut problems);
        self.bounds_problems(&mut problems);
        // of a list of points the number is not known yet
        if self.sampling.method != Some(Method::List) {
            self.size_problems(&mut problems);
            self.target_run_problems(&mut problems);
        }
        problems.extend("network", self.network.problems());
        problems.extend("training", self.training.problems(self.outputs.len()));
        self.network_problems(&mut problems);
        problems.extend("accept", self.accept.problems());
        problems.extend("baselines", self.baselines.problems());
        problems.extend("search", self.search.as_ref().map(SearchOptions::problems).unwrap_or_default());
        problems.0
    }

    fn source_problems(&self, problems: &mut Problems) {
        let SourceOptions { system, mechanism, fmu, table, index, columns, constants, .. } = &self.source;
        let given = [system.is_some(), mechanism.is_some(), fmu.is_some(), table.is_some(), index.is_some()];
        if given.iter().filter(|&&given| given).count() != 1 {
            problems.add("source", "expected one of `system`, `mechanism`, `fmu`, `table` and `index`".into());
        } else if !self.source.is_recorded() && !columns.is_empty() {
            problems.add("source.columns", "belongs to `table` and `index`".into());
        } else if self.source.is_recorded() && !constants.is_empty() {
            problems.add("source.constants", "belongs to `system`, `mechanism` and `fmu`".into());
        }
    }

    fn fmu_problems(&self, problems: &mut Problems) {
        let SourceOptions { fmu, step, tolerance, time_limit, retries, max_failed, .. } = self.source.clone();
        let is_recorded = self.source.is_recorded();
        if step.is_some() && fmu.is_none() {
            problems.add("source.step", "belongs to `fmu`".into());
        }
        if retries.is_some() && fmu.is_none() {
            let reason = if is_recorded { "" } else { ": a simulation that failed would fail again" };
            problems.add("source.retries", format!("belongs to `fmu`{reason}"));
        }
        let given = [tolerance.is_some(), time_limit.is_some(), max_failed.is_some()];
        for (key, _) in
            ["tolerance", "time_limit", "max_failed"].iter().zip(given).filter(|(_, given)| *given && is_recorded)
        {
            problems.add(&format!("source.{key}"), "belongs to `system`, `mechanism` and `fmu`".into());
        }
        if let Some(tolerance) = tolerance.filter(|tolerance| !(1e-13..=0.1).contains(tolerance)) {
            problems.add("source.tolerance", format!("{tolerance}, expected a number from 1e-13 to 0.1"));
        }
        if let Some(limit) = time_limit {
            problems.expect_positive("source.time_limit", limit);
        }
        if let Some(share) = max_failed.filter(|share| !(0.0..1.0).contains(share)) {
            problems.add("source.max_failed", format!("{share}, expected a share of at least 0 and below 1"));
        }
        let Some(step) = step else { return };
        problems.expect_positive("source.step", step);
        let steps = self.time.step / step;
        if steps > 0.0 && (steps < 0.5 || (steps.round() - steps).abs() > 1e-9 * steps) {
            let message = format!("{step} s does not divide the time between two rows, {} s", self.time.step);
            problems.add("source.step", message);
        } else if self.time.stop / step > MAX_STEPS {
            problems.add("source.step", format!("{} steps a run, expected at most 100 million", self.time.stop / step));
        }
    }

    fn time_problems(&self, problems: &mut Problems) {
        let TimeOptions { stop, step, margin } = self.time;
        if !(0.0..=1.0).contains(&margin) {
            problems.add("time.margin", format!("{margin}, expected a share from 0 to 1"));
        } else if margin > 0.0 && self.source.is_recorded() {
            problems.add(
                "time.margin",
                "belongs to `system`, `mechanism` and `fmu`: recorded runs end where they end".into(),
            );
        } else if margin > 0.0 && self.network.structure == Structure::Fixed {
            problems.add("time.margin", "belongs to the structure \"full\"".into());
        }
        problems.expect_positive("time.stop", stop);
        problems.expect_positive("time.step", step);
        let steps = stop / step;
        if steps > 1e7 {
            problems.add("time.step", format!("{steps} rows a run, expected at most 10 million"));
        } else if steps > 0.0 && (steps < 0.5 || (steps.round() - steps).abs() > 1e-9 * steps) {
            problems.add("time.step", format!("{step} s does not divide the stop time of {stop} s"));
        }
    }

    fn variable_problems(&self, problems: &mut Problems) {
        if self.parameters.is_empty() {
            problems.add("parameters", "no parameter, expected at least one".into());
        }
        if self.outputs.is_empty() {
            problems.add("outputs", "no output, expected at least one".into());
        }
        for name in self.parameters.keys() {
            problems.expect_variable_name(&format!("parameters.{name}"), name);
        }
        for name in self.outputs.keys() {
            let key = format!("outputs.{name}");
            problems.expect_variable_name(&key, name);
            if self.parameters.contains_key(name) {
                problems.add(&key, format!("`{name}` is a parameter already: names of variables must be unique"));
            }
        }
        for name in self.outputs.keys().filter(|_| self.bounds.is_some()) {
            let bound = format!("{name}_bound");
            for section in ["parameters", "outputs", "arrays"] {
                let is_there = match section {
                    "parameters" => self.parameters.contains_key(&bound),
                    "outputs" => self.outputs.contains_key(&bound),
                    _ => self.arrays.contains_key(&bound),
                };
                if is_there {
                    let message = format!("`{bound}` is the name of the error bound of `{name}`");
                    problems.add(&format!("{section}.{bound}"), message);
                }
            }
        }
        for (name, outputs) in &self.arrays {
            let key = format!("arrays.{name}");
            problems.expect_variable_name(&key, name);
            if self.parameters.contains_key(name) || self.outputs.contains_key(name) {
                problems
                    .add(&key, format!("`{name}` is a parameter or output already: names of variables must be unique"));
            }
            if outputs.len() < 2 {
                problems.add(&key, format!("{} outputs, expected at least 2", outputs.len()));
            }
            for (index, output) in outputs.iter().enumerate() {
                if !self.outputs.contains_key(output) {
                    problems.add(&key, format!("`{output}` is no output"));
                } else if outputs[..index].contains(output) {
                    problems.add(&key, format!("`{output}` is duplicated"));
                }
            }
        }
        for (name, parameter) in &self.parameters {
            if let Some(problem) = parameter.problem() {
                problems.add(&format!("parameters.{name}"), problem);
            }
        }
    }

    fn sampling_problems(&self, problems: &mut Problems) {
        let SamplingOptions { method, levels, runs, file, faces, test_runs } = &self.sampling;
        if *test_runs == 0 {
            problems.add("sampling.test_runs", "expected at least 1".into());
        }
        if self.source.is_recorded() {
            let given = [method.is_some(), levels.is_some(), runs.is_some(), file.is_some(), faces.is_some()];
            let is_plan = given.contains(&true);
            if is_plan || self.parameters.values().any(|parameter| parameter.levels.is_some()) {
                problems.add("sampling", "recorded runs are where they are: expected `test_runs` only".into());
            }
            return;
        }
        let Some(method) = method else {
            problems.add("sampling", "expected a `method`".into());
            return;
        };
        let (mesh, list) = (*method == Method::Mesh, *method == Method::List);
        if !mesh && levels.is_some() {
            problems.add("sampling.levels", "belongs to the method \"mesh\"".into());
        }
        if mesh && runs.is_some() {
            problems.add("sampling.runs", "a mesh has `levels`; `runs` belong to the other methods".into());
        }
        if list && runs.is_some() {
            problems.add("sampling.runs", "a list has a `file`; `runs` belong to the other methods".into());
        }
        if !list && file.is_some() {
            problems.add("sampling.file", "belongs to the method \"list\"".into());
        }
        if list && file.is_none() {
            problems.add("sampling", "the list has no `file`".into());
        }
        if faces.is_some() && (mesh || list) {
            problems
                .add("sampling.faces", "a mesh has its ends anyway, and a list its points: expected no `faces`".into());
        }
        if let Some(faces) = faces.filter(|faces| !(0.0..=0.5).contains(faces)) {
            problems.add("sampling.faces", format!("{faces}, expected a share from 0 to 0.5"));
        }
        if !mesh && !list && runs.is_none_or(|runs| runs < 2) {
            problems.add("sampling.runs", "expected at least 2 runs".into());
        }
        let limits =
            [(Method::Sobol, "sobol", MAX_SOBOL_PARAMETERS), (Method::Halton, "halton", MAX_HALTON_PARAMETERS)];
        for (_, name, limit) in limits.into_iter().filter(|(limited, ..)| limited == method) {
            if self.parameters.len() > limit {
                problems.add("sampling.method", format!("the method \"{name}\" takes at most {limit} parameters"));
            }
        }
        if !self.parameters.is_empty() && self.parameters.values().all(ParameterOptions::is_nominal) {
            let message = "every parameter has `values`, expected one with a range: no run would be left for the tests";
            problems.add("parameters", message.into());
        }
        for (name, parameter) in self.parameters.iter().filter(|(_, parameter)| !parameter.is_nominal()) {
            let key = format!("parameters.{name}.levels");
            match (mesh, parameter.levels.or(*levels)) {
                (false, _) if parameter.levels.is_some() => problems.add(&key, "belongs to the method \"mesh\"".into()),
                (true, None) => problems.add("sampling", format!("the mesh has no `levels` for `{name}`")),
                (true, Some(levels)) if levels < 2 => {
                    problems.add(&key, format!("{levels} levels, expected at least 2: both ends of the range"));
                }
                _ => {}
            }
        }
    }

    /// What would take more memory than machines have, or more time than anyone has.
    fn size_problems(&self, problems: &mut Problems) {
        let train_runs = self.train_runs();
        let planned = match self.sampling.method {
            Some(Method::Mesh) => "sampling.levels",
            Some(Method::List) => "sampling.file",
            _ => "sampling.runs",
        };
        let target = self.target.map_or(0, |target| target.max_runs);
        let counts = [
            (planned, train_runs),
            ("sampling.test_runs", self.sampling.test_runs as u64),
            ("bounds.runs", self.calibration_runs() as u64),
            ("target.max_runs", target as u64),
        ];
        let too_many = counts.iter().filter(|(_, runs)| *runs > MAX_RUNS as u64);
        let before = problems.0.len();
        let message = |runs: u64| match runs {
            u64::MAX => format!("more runs than can be counted, expected at most {MAX_RUNS}"),
            runs => format!("{runs} runs, expected at most {MAX_RUNS}"),
        };
        problems.0.extend(too_many.map(|(key, runs)| ((*key).into(), message(*runs))));
        // rows of recorded runs are what the tables have
        if problems.0.len() > before || self.source.is_recorded() {
            return;
        }
        let runs = train_runs.max(target as u64) + (self.sampling.test_runs + self.calibration_runs()) as u64;
        let rows = runs as f64 * (self.time.stop * (1.0 + self.time.margin) / self.time.step + 1.0);
        let bytes = 8.0 * rows * self.outputs.len() as f64;
        if rows > MAX_ROWS {
            problems.add("sampling", format!("{rows:.3e} rows of all runs, expected at most a billion"));
        } else if bytes > MAX_BYTES {
            let (count, gigabytes) = (self.outputs.len(), bytes / 1e9);
            let message = format!("{rows:.3e} rows of {count} outputs are {gigabytes:.0} GB, expected at most 64 GB");
            problems.add("sampling", message);
        }
    }

    /// How the parameters' values become columns of the network.
    pub fn encoder(&self) -> Encoder {
        let encodings: Vec<(Encoding, f64, f64)> =
            self.parameters.values().map(|parameter| (parameter.encoding(), parameter.min, parameter.max)).collect();
        Encoder::new(encodings.iter().map(|(encoding, min, max)| (encoding, *min, *max)))
    }

    /// Share of the training runs on the ends of each parameter's range.
    pub fn faces(&self) -> f64 {
        match self.sampling.method {
            None | Some(Method::Mesh | Method::List) => 0.0,
            _ => self.sampling.faces.unwrap_or(0.0),
        }
    }

    /// Number of training runs that are simulated, those held out for validation included.
    pub fn train_runs(&self) -> u64 {
        match self.sampling.method {
            Some(Method::Mesh) => {
                let levels = |parameter: &ParameterOptions| match parameter.values.len() {
                    0 => parameter.levels.or(self.sampling.levels).unwrap_or(0),
                    count => count,
                };
                self.parameters.values().fold(1, |product, parameter| product.saturating_mul(levels(parameter) as u64))
            }
            Some(Method::List) => self.points().map_or(0, <[_]>::len) as u64,
            _ => self.sampling.runs.unwrap_or(0) as u64,
        }
    }

    fn target_problems(&self, problems: &mut Problems) {
        let Some(TargetOptions { r2, runs, .. }) = self.target else { return };
        if self.source.is_recorded() {
            problems.add("target", "recorded runs cannot be added to".into());
        }
        if self.network.structure == Structure::Fixed {
            problems.add("target", "belongs to the structure \"full\"".into());
        }
        if !(r2 > 0.0 && r2 < 1.0) {
            problems.add("target.r2", format!("{r2}, expected a number between 0 and 1"));
        }
        if !(1..=MAX_ADDED_RUNS).contains(&runs) {
            problems.add("target.runs", format!("{runs} runs, expected 1 to {MAX_ADDED_RUNS}"));
        }
    }

    /// Whether the plan's runs are enough for a target.
    fn target_run_problems(&self, problems: &mut Problems) {
        let Some(TargetOptions { max_runs, .. }) = self.target.filter(|_| !self.source.is_recorded()) else { return };
        let runs = self.train_runs();
        if (max_runs as u64) < runs {
            problems.add("target.max_runs", format!("{max_runs} runs, expected at least the {runs} of the plan"));
        }
        let share = self.training.validation;
        let held_out = self.training.held_out(runs as usize);
        if held_out >= LEAST_JUDGES || !(share > 0.0 && share < 1.0) {
            return;
        }
        let more = match self.sampling.method {
            Some(Method::Mesh) => "more `sampling.levels`",
            Some(Method::List) => "more points in `sampling.file`",
            _ => "more `sampling.runs`",
        };
        let least_runs = (LEAST_JUDGES as f64 / share).ceil();
        let least_share = (100.0 * LEAST_JUDGES as f64 / runs as f64).ceil() / 100.0;
        let larger = match least_share <= 0.5 {
            true => format!("`training.validation` of at least {least_share}, or "),
            false => String::new(),
        };
        let message = format!(
            "{held_out} of {runs} runs are held out to judge it, expected at least {LEAST_JUDGES}: set {larger}{more} \
             ({least_runs} runs with `training.validation = {share}`)"
        );
        problems.add("target", message);
    }

    fn bounds_problems(&self, problems: &mut Problems) {
        let Some(BoundsOptions { coverage, runs }) = self.bounds else { return };
        if !(coverage > 0.0 && coverage < 1.0) {
            problems.add("bounds.coverage", format!("{coverage}, expected a share between 0 and 1"));
            return;
        }
        let least = BoundsOptions::least_runs(coverage);
        if runs < least {
            let message = format!("{runs} runs, expected at least {least} for a coverage of {coverage}");
            problems.add("bounds.runs", message);
        }
    }

    /// Number of runs that error bounds are measured on.
    pub fn calibration_runs(&self) -> usize {
        self.bounds.map_or(0, |bounds| bounds.runs)
    }

    /// What is wrong with the network and its training beside each other and the rest.
    fn network_problems(&self, problems: &mut Problems) {
        let NetworkOptions { structure, hidden, .. } = &self.network;
        if hidden.is_empty() {
            let message = "belongs to hidden layers, `network.hidden` has none";
            let given =
                [("training.dropout", self.training.dropout > 0.0), ("training.batch_norm", self.training.batch_norm)];
            given.iter().filter(|(_, given)| *given).for_each(|(key, _)| problems.add(key, message.into()));
        }
        let instants = match structure {
            Structure::Fixed if !self.source.is_recorded() => self.time.stop / self.time.step + 1.0,
            _ => 1.0,
        };
        let inputs = self.encoder().width() + usize::from(*structure == Structure::Full);
        let sizes: Vec<usize> = [&[inputs], hidden.as_slice(), &[self.outputs.len()]].concat();
        let weights: f64 = sizes.windows(2).map(|pair| (pair[0] as f64 + 1.0) * pair[1] as f64).sum();
        if weights * instants > MAX_WEIGHTS {
            let of = if instants > 1.0 { format!(" of {instants:.0} networks") } else { String::new() };
            let message = format!("{:.3e} weights and biases{of}, expected at most 100 million", weights * instants);
            problems.add("network.hidden", message);
        }
        let epochs = self.training.epochs as f64 * instants;
        if instants > 1.0 && epochs > MAX_HISTORIES && self.training.epochs <= MAX_EPOCHS {
            let message = format!("{epochs:.3e} epochs of {instants:.0} networks, expected at most 100 million");
            problems.add("training.epochs", message);
        }
    }
}

/// Dotted keys and what is wrong with them.
#[derive(Default)]
struct Problems(Vec<(String, String)>);

impl Problems {
    fn add(&mut self, key: &str, message: String) {
        self.0.push((key.to_owned(), message));
    }

    /// Those of a section, whose keys are within it.
    fn extend(&mut self, section: &str, problems: Vec<(String, String)>) {
        self.0.extend(problems.into_iter().map(|(key, message)| (format!("{section}.{key}"), message)));
    }

    fn expect_positive(&mut self, key: &str, value: f64) {
        if !(value.is_finite() && value > 0.0) {
            self.add(key, format!("{value}, expected a positive number"));
        }
    }

    /// FMI takes any text on one line, and so do the tables but for spaces at its ends.
    fn expect_variable_name(&mut self, key: &str, name: &str) {
        if name.is_empty() || name.contains(char::is_control) || name.trim() != name {
            let expected = "expected a text on one line without spaces at its ends";
            self.add(key, format!("`{}` is not a valid name of a variable, {expected}", name.escape_debug()));
        }
        if name == BuiltIn::Time.name() {
            self.add(key, "`time` is the name of the independent variable".into());
        } else if BuiltIn::ALWAYS.iter().any(|variable| variable.name() == name) {
            self.add(key, format!("`{name}` is the name of a variable that every FMU of metafmu has"));
        }
    }
}

fn digest(content: &impl Serialize) -> String {
    // a study is plain data with string keys: serialization cannot fail, and if it did, no digest could match
    let text = serde_json::to_string(content).unwrap_or_default();
    files::digits(Sha256::new_with_prefix(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = include_str!("../../examples/paper/single-pendulum.toml");

    fn problems(text: &str) -> Vec<String> {
        match Study::parse(text, Path::new("study.toml")) {
            Ok(_) => Vec::new(),
            Err(error) => error.to_string().lines().map(str::to_owned).collect(),
        }
    }

    /// The one message for the good study with one piece of its text replaced.
    fn message(from: &str, to: &str) -> String {
        assert!(GOOD.contains(from), "{from} is not in the example");
        let messages = problems(&GOOD.replacen(from, to, 1));
        assert_eq!(messages.len(), 1, "{messages:#?}");
        messages[0].clone()
    }

    /// The good study with another plan.
    fn sobol(runs: usize) -> String {
        GOOD.replacen("\"mesh\"", "\"sobol\"", 1).replacen("levels = 11", &format!("runs = {runs}"), 1)
    }

    #[test]
    fn the_example_is_the_papers_case() {
        let study = Study::parse(GOOD, Path::new("single-pendulum.toml")).unwrap();
        assert_eq!(study.parameters.keys().collect::<Vec<_>>(), ["L", "c", "thetad0"]);
        assert_eq!(study.outputs.keys().collect::<Vec<_>>(), ["theta", "thetad", "thetadd"]);
        assert_eq!(study.train_runs(), 1331);
        assert_eq!(study.network.hidden, [128, 128]);
    }

    #[test]
    fn only_what_decides_the_surrogate_changes_the_digest() {
        let parse = |text: &str| Study::parse(text, Path::new("s.toml")).unwrap();
        let study = parse(GOOD);
        assert_eq!(study.digest(), parse(&format!("# a comment\n{GOOD}")).digest());
        assert_eq!(study.digest(), parse(&GOOD.replacen("license = ", "author = \"me\"\nlicense = ", 1)).digest());
        let other = parse(&GOOD.replacen("epochs = ", "epochs = 1", 1));
        assert_ne!(study.digest(), other.digest());
        assert_eq!(study.sampling_digest(), other.sampling_digest());
        assert_eq!(study.digest(), parse(&GOOD.replacen("fmi = \"2\"", "fmi = \"both\"", 1)).digest());
        assert_ne!(study.digest(), parse(&GOOD.replacen("\"double\"", "\"single\"", 1)).digest());
    }

    #[test]
    fn every_mistake_is_located_by_line_and_key() {
        let line = |needle: &str| GOOD.lines().position(|line| line.starts_with(needle)).unwrap() + 1;
        for (from, to, needle, key, says) in [
            (
                "[network]",
                "[network]\nnods = 3",
                "[network]",
                "network.nods",
                "unknown key `nods`, expected one of structure, hidden",
            ),
            ("stop = 2.0", "stop = \"2\"", "stop", "time.stop", "expected"),
            ("stop = 2.0", "stop = -2.0", "stop", "time.stop", "expected a positive number"),
            ("step = 0.01", "step = 0.03", "step", "time.step", "does not divide"),
            ("min = 0.1,", "min = 0.3,", "L = ", "parameters.L", "min 0.3 is not below max 0.2"),
            ("min = 0.1,", "min = nan,", "L = ", "parameters.L", "not finite"),
            ("\nc = ", "\n\" c\" = ", "c = ", "parameters. c", "` c` is not a valid name of a variable"),
            ("\nc = ", "\nin_domain = ", "c = ", "parameters.in_domain", "that every FMU of metafmu has"),
            ("\nc = ", "\ntime = ", "c = ", "parameters.time", "independent variable"),
            ("theta = {", "c = {", "theta = ", "outputs.c", "parameter already"),
            ("theta = {", "L = 3 #", "theta = ", "outputs.L", "expected"),
            ("levels = 11", "levels = 1", "levels", "parameters.L.levels", "at least 2"),
            (
                "method = \"mesh\"",
                "method = \"grid\"",
                "method",
                "sampling.method",
                "\"grid\", expected one of \"mesh\"",
            ),
            ("levels = 11", "levels = 11\nruns = 5", "levels", "sampling.runs", "a mesh has `levels`"),
            ("levels = 11", "levels = 11\nfaces = 0.1", "levels", "sampling.faces", "a mesh has its ends anyway"),
            ("levels = 11", "levels = 11\nfaces = 0.6", "levels", "sampling.faces", "a mesh has its ends anyway"),
            ("step = 0.01", "step = 0.01\nmargin = 5", "step = ", "time.margin", "5, expected a share from 0 to 1"),
            ("epochs = ", "epochs = 4\nenough = 1e-6 # ", "epochs", "training.enough", "belongs to the schedule"),
            (
                "levels = 11",
                "levels = 11\nfile = \"p.csv\"",
                "levels",
                "sampling.file",
                "belongs to the method \"list\"",
            ),
            ("method = \"mesh\"", "method = \"halton\"", "levels", "sampling.levels", "belongs to the method \"mesh\""),
            ("fmi = \"2\"", "fmi = \"4\"", "fmi", "export.fmi", "\"4\", expected one of \"2\", \"3\", \"both\""),
            ("\"double\"", "\"half\"", "precision", "export.precision", "\"half\", expected"),
            (
                "[sampling]",
                "[arrays]\nq = [\"theta\", \"omega\"]\n[sampling]",
                "[sampling]",
                "arrays.q",
                "`omega` is no output",
            ),
            ("epochs = ", "epochs = -", "epochs", "training.epochs", "expected"),
            ("[network]", "[bounds]\ncoverage = 95\n[network]", "[network]", "bounds.coverage", "between 0 and 1"),
            ("[network]", "[bounds]\nruns = 18\n[network]", "[network]", "bounds.runs", "at least 19"),
            ("theta = {", "in_domain = {", "theta = ", "outputs.in_domain", "that every FMU of metafmu has"),
            ("[network]", "[accept]\nr2 = 1.5\n[network]", "[network]", "accept.r2", "a number below 1"),
            ("[network]", "[accept]\nr3 = 0.5\n[network]", "[network]", "accept.r3", "unknown key"),
        ] {
            let messages = problems(&GOOD.replacen(from, to, 1));
            let found = messages.first().cloned().unwrap_or_default();
            assert!(found.contains(key), "{to}: no `{key}` in {found}");
            assert!(found.contains(says), "{to}: no `{says}` in {found}");
            let expected = line(needle) + usize::from(to.contains('\n') && from != "\nc = ");
            // a mistake in a value that only the defaults of `levels` explain is placed at the parameter
            if key != "parameters.L.levels" {
                assert!(found.starts_with(&format!("study.toml:{expected}:")), "{to}: not line {expected}: {found}");
            }
        }
    }

    #[test]
    fn nominal_and_periodic_parameters_are_checked_and_count_for_the_digest() {
        let l = "L = { min = 0.1, max = 0.2,";
        for (to, says) in [
            ("L = { values = [],", "parameters.L: no `values`, expected at least 2"),
            ("L = { values = [0.1],", "parameters.L: 1 value, expected at least 2"),
            ("L = { values = [0.1, 0.2, 0.1],", "parameters.L: value 0.1 is duplicated"),
            ("L = { values = [0.1, inf],", "parameters.L: value inf is not finite"),
            ("L = { values = [0.1, nan],", "parameters.L: value NaN is not finite"),
            ("L = { values = [0.1, 0.2], min = 0.1,", "parameters.L: `values` exclude `min`, `max`, `levels` and"),
            ("L = { values = [0.1, 0.2], levels = 2,", "parameters.L: `values` exclude `min`, `max`, `levels` and"),
            ("L = { values = [0.1, 0.2], periodic = true,", "parameters.L: `values` exclude `min`, `max`, `levels`"),
            ("L = { max = 0.2,", "parameters.L: `min` is missing"),
            ("L = { min = 0.2,", "parameters.L: `max` is missing"),
            ("L = { periodic = true,", "parameters.L: expected `min` and `max`, or `values`"),
            ("L = { min = 0.1, max = 0.2, cyclic = true,", "parameters.L.cyclic: unknown key `cyclic`, expected"),
            ("L = { values = [\"a\"],", "parameters.L.values[0]: \"a\", expected a number"),
        ] {
            let found = message(l, to);
            assert!(found.contains(says), "{to}: {found}");
            assert_eq!(found.split(':').nth(1), message(l, "L = { min = 0.3, max = 0.2,").split(':').nth(1), "{found}");
        }
        let nominal = |text: &str| text.replacen("min = 0.0, max = 0.15", "values = [0, 1]", 1);
        let all = nominal(GOOD).replacen("min = 0.0, max = 5.0", "values = [0, 1]", 1);
        assert_eq!(problems(&all), Vec::<String>::new());
        let all = problems(&all.replacen("min = 0.1, max = 0.2", "values = [0.1, 0.2]", 1));
        assert!(all.len() == 1 && all[0].contains("parameters: every parameter has `values`"), "{all:?}");
        let digest = |text: &str| Study::parse(text, Path::new("s.toml")).unwrap().sampling_digest();
        let of = [GOOD, &nominal(GOOD), &GOOD.replacen("max = 5.0", "max = 5.0, periodic = true", 1)].map(digest);
        assert!(of[0] != of[1] && of[1] != of[2] && of[0] != of[2]);
        assert_eq!(of[0], digest(&GOOD.replacen("max = 5.0", "max = 5.0, periodic = false", 1)));
    }

    #[test]
    fn malformed_toml_and_duplicate_keys_are_located() {
        assert!(message("[time]", "[time").starts_with("study.toml:"));
        assert!(message("\nc = ", "\nL = ").contains("duplicate key"));
    }

    #[test]
    fn options_of_network_and_training_that_make_no_sense_are_found_at_load_all_at_once() {
        let (head, _) = GOOD.split_once("[network]").unwrap();
        let wrong = [
            ("batch = 1", "at least 2 rows with `batch_norm`"),
            ("batch_norm = true", ""),
            ("clip_norm = -1.0", "0 or a positive number"),
            ("dropout = 2", "below 1"),
            ("epochs = 1000000000", "1 to 1000000"),
            ("huber_delta = 0.5", "belongs to the loss \"huber\""),
            ("l1 = inf", "0 or a positive number"),
            ("momentum = 1.0", "below 1"),
            ("optimizer = \"sgd\"", ""),
            ("output_weights = [1.0]", "1 weights, expected one for each output"),
            ("refresh = 5", "belongs to the optimizer \"soap\""),
            ("beta2 = 0.9", "\"sgd\" has `momentum` only"),
            ("validation = 1.0", "between 0 and 1"),
            ("warm_up = -0.1", "below 1"),
            ("weight_decay = 0.1", "belongs to the optimizers \"adamw\" and \"soap\""),
        ];
        let training: String = wrong.iter().map(|(line, _)| format!("{line}\n")).collect();
        let found = problems(&format!("{head}[training]\n{training}"));
        let first = head.lines().count() + 2;
        for (index, (line, says)) in wrong.iter().enumerate().filter(|(_, (_, says))| !says.is_empty()) {
            let place = format!("study.toml:{}: training.{}: ", first + index, line.split(' ').next().unwrap());
            assert!(
                found.iter().any(|found| found.starts_with(&place) && found.contains(says)),
                "{place}{says}: {found:#?}"
            );
        }
        assert_eq!(found.len(), wrong.len() - 2, "{found:#?}");
        let of_layers =
            problems(&format!("{head}[network]\nhidden = []\n[training]\ndropout = 0.1\nbatch_norm = true\n"));
        assert_eq!(of_layers.len(), 2, "{of_layers:#?}");
    }

    #[test]
    fn counts_that_no_machine_can_hold_are_refused_with_their_limit() {
        let huge = "1000000000000";
        for (from, to, says) in [
            (
                "test_runs = 200",
                format!("test_runs = {huge}"),
                "sampling.test_runs: 1000000000000 runs, expected at most 10000000",
            ),
            (
                "levels = 11",
                format!("levels = {huge}"),
                "sampling.levels: more runs than can be counted, expected at most 10000000",
            ),
            (
                "[network]",
                format!("[bounds]\nruns = {huge}\n[network]"),
                "bounds.runs: 1000000000000 runs, expected at most",
            ),
            (
                "hidden = [128, 128]",
                "hidden = [16384, 16384]".into(),
                "network.hidden: 2.686e8 weights and biases, expected at most",
            ),
            (
                "hidden = [128, 128]",
                "hidden = [1024, 1024]\nstructure = \"fixed\"".into(),
                "network.hidden: 2.124e8 weights and biases of 201 networks, expected at most 100 million",
            ),
        ] {
            let found = message(from, &to);
            assert!(found.contains(says), "{says} is not in {found}");
        }
        for (runs, says) in [
            (1_000_000_000_000, "sampling.runs: 1000000000000 runs, expected at most 10000000"),
            (9_000_000, "sampling: 1.809e9 rows of all runs, expected at most a billion"),
        ] {
            let found = problems(&sobol(runs));
            assert!(found.len() == 1 && found[0].contains(says), "{found:#?}");
        }
        let name = message("name = \"single-pendulum\"", &format!("name = \"{}\"", "n".repeat(300)));
        assert!(name.contains("name: 300 characters, expected at most 100"), "{name}");
    }

    #[test]
    fn a_target_needs_enough_held_out_runs() {
        let of = |runs: usize| problems(&(sobol(runs) + "[target]\nr2 = 0.9\nruns = 10\nmax_runs = 1000\n"));
        // the example holds out a twentieth
        assert_eq!(of(200), Vec::<String>::new());
        let few = of(60);
        assert_eq!(few.len(), 1, "{few:#?}");
        let expected = "target: 3 of 60 runs are held out to judge it, expected at least 10: set `training.validation` of at \
                        least 0.17, or more `sampling.runs` (200 runs with `training.validation = 0.05`)";
        assert!(few[0].contains(expected), "{}", few[0]);
        let many = GOOD.to_owned() + "[target]\nr2 = 0.9\nruns = 1000000\nmax_runs = 2000\n";
        let many = problems(&many);
        assert!(many.len() == 1 && many[0].contains("target.runs: 1000000 runs, expected 1 to 100000"), "{many:#?}");
    }

    #[test]
    fn thousands_of_mistakes_take_no_longer_than_reading_them() {
        let outputs: String = (0..20_000).map(|index| format!("\" y{index}\" = {{}}\n")).collect();
        let text = GOOD.replacen("[outputs]", &format!("[outputs]\n{outputs}"), 1);
        let begin = std::time::Instant::now();
        let found = problems(&text);
        assert_eq!(found.len(), 20_000);
        let line = text.lines().position(|line| line.starts_with("\" y19999\"")).unwrap() + 1;
        assert!(found[19_999].starts_with(&format!("study.toml:{line}: outputs. y19999: ")), "{}", found[19_999]);
        assert!(begin.elapsed().as_secs() < 20, "{:?}", begin.elapsed());
    }

    #[test]
    fn every_problem_is_listed_not_only_the_first() {
        let text = GOOD.replacen("stop = 2.0", "stop = 0.0", 1).replacen("min = 0.1,", "min = 0.3,", 1);
        assert!(problems(&text).len() >= 2);
    }
}
