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
//! Each section has a file here: its options, defaults, limits and checks. docs/study-file.md has every key. A section's `problems` are
//! those that it has by itself, its `problems_beside` those that it has beside the others.

mod accept;
mod bounds;
mod digest;
mod export;
mod network;
mod outputs;
mod parameters;
mod points;
mod sampling;
mod search;
mod size;
mod source;
mod target;
mod time;
mod training;

use crate::{
    Error, Result,
    diagnostics::{
        KeyProblem, Problems,
        origin::{self, Origin, Problem},
        schema,
    },
    files,
    multibody::Mechanism,
    table::Table,
};
pub use accept::AcceptOptions;
pub use bounds::BoundsOptions;
pub use export::{ExportOptions, FmiChoice};
use indexmap::IndexMap;
use metafmu_baselines::{BaselineKind, Baselines};
use metafmu_runtime::{Encoder, Encoding};
pub use network::{NetworkOptions, Structure};
pub use outputs::OutputOptions;
pub use parameters::{ParameterOptions, Variability};
pub use points::{MAX_HALTON_PARAMETERS, MAX_SOBOL_PARAMETERS, read_value};
pub use sampling::{Method, SamplingOptions};
use schemars::JsonSchema;
pub(crate) use search::set;
pub use search::{Range, Scale, SearchMethod, SearchOptions, Space};
use serde::Deserialize;
pub use source::SourceOptions;
use std::{
    path::{Path, PathBuf},
    sync::{Arc, LazyLock},
};
pub use target::TargetOptions;
pub use time::TimeOptions;
use toml::{Spanned, de::DeTable};
use training::MAX_EPOCHS;
pub use training::{Loss, Optimizer, Schedule, TrainingOptions};

/// A study file's content, validated: what is sampled, how, and what is made of it.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Names the outputs and the FMU: a letter, then letters, digits, `-` and `_`; at most 100 characters.
    pub name: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
    /// Everything random follows from it.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// What is sampled, by one of `system`, `mechanism`, `fmu`, `table` and `index`.
    pub source: SourceOptions,
    /// The rows of a run: `0, step, ..., stop`.
    pub time: TimeOptions,
    /// Parameters by name: the surrogate's inputs beside the time. Each has `min` and `max`, or `values`.
    pub parameters: IndexMap<String, ParameterOptions>,
    /// Outputs by name.
    pub outputs: IndexMap<String, OutputOptions>,
    /// Outputs of one unit that an FMI 3.0 FMU also offers as an array, by the array's name.
    #[serde(default)]
    #[schemars(extend("examples" = [{"angles": ["theta1", "theta2"]}]))]
    pub arrays: IndexMap<String, Vec<String>>,
    /// Where in the parameters' ranges runs are placed.
    pub sampling: SamplingOptions,
    /// The feed-forward network.
    #[serde(default)]
    pub network: NetworkOptions,
    /// How the network is trained.
    #[serde(default)]
    pub training: TrainingOptions,
    /// How good the surrogate is to be, if runs are to be added until it is.
    pub target: Option<TargetOptions>,
    /// Error bounds of the outputs; without this section there are none.
    pub bounds: Option<BoundsOptions>,
    /// When a surrogate is good enough to be used. One that is not is rejected: `build`, `train` and `evaluate` say why and end with exit
    /// code 1.
    #[serde(default)]
    pub accept: AcceptOptions,
    /// What kind of FMU is made, and what it says about itself.
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

/// Characters of a study's name, which is part of the names of files; most systems take 255.
const MAX_NAME: usize = 100;

fn default_seed() -> u64 {
    1
}

static SCHEMA: LazyLock<serde_json::Value> = LazyLock::new(schema::of::<Study>);

/// The JSON schema of a study file.
pub fn json_schema() -> &'static serde_json::Value {
    &SCHEMA
}

/// A study that was read, and every mistake found on the way.
#[derive(Debug)]
pub struct Draft {
    study: Study,
    problems: Vec<Problem>,
    /// Whether what its source is asked for is known: the source itself, parameters and outputs.
    names_are_known: bool,
}

impl Draft {
    /// Reads a study file, and the files it names.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Study`] if it is not TOML at all.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&origin::read(path, "a study in TOML")?, path)
    }

    /// Reads a study file's text, and the files it names; `path` is for messages and tells the folder.
    ///
    /// # Errors
    /// [`Error::Study`] if it is not TOML, or a file of another kind.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let origin = Origin::new(path, text);
        let mut root = origin.parse()?;
        let hint = "this is a mechanism, expected a study: `metafmu new NAME --mechanism FILE` writes one";
        origin.refuse_section("bodies", hint)?;
        let (mut problems, damaged) = origin.structure(root.get_ref(), &SCHEMA, |_, _| None);
        replace(&mut root, &damaged);
        let mut study: Study = origin.deserialize(root)?;
        study.origin = origin.clone();
        // what a damaged section says is unknown: the other ones are checked without it
        let is_damaged = |section: &str| damaged.iter().any(|damaged| damaged == section);
        let of_section = |problem: &KeyProblem| problem.key.split('.').next().unwrap_or_default().to_owned();
        let mut found: Problems =
            study.section_problems().into_iter().filter(|problem| !is_damaged(&of_section(problem))).collect();
        let has_problems =
            |section: &str| is_damaged(section) || found.iter().any(|problem| of_section(problem) == section);
        let (source, sampling) = (has_problems("source"), has_problems("sampling") || has_problems("parameters"));
        let mut names_are_known = !source && !["parameters", "outputs", "arrays"].into_iter().any(is_damaged);
        let time_is_known = !has_problems("time");
        let mut is_complete = damaged.is_empty();
        if !source {
            names_are_known &= study.load_source(&mut found, &mut problems);
            is_complete &= names_are_known;
        }
        if !sampling {
            is_complete &= study.load_points(&mut found);
        }
        if is_complete {
            found.extend(study.problems_beside());
        }
        problems.extend(origin.locate(found));
        if !time_is_known {
            study.time = PLACEHOLDER_TIME;
        }
        Ok(Self { study, problems, names_are_known })
    }

    /// The study, as far as it can be asked for its names; none if source, parameters or outputs are not known. Other values may be
    /// wrong.
    pub fn names(&self) -> Option<&Study> {
        self.names_are_known.then_some(&self.study)
    }

    /// Whether nothing is wrong.
    pub fn is_valid(&self) -> bool {
        self.problems.is_empty()
    }

    /// Adds what is wrong with the source that the study names.
    pub fn add(&mut self, error: Error) {
        match error {
            Error::Study { problems } => self.problems.extend(problems),
            other => {
                let key = self.study.source.file().map_or("source".into(), |(key, _)| format!("source.{key}"));
                self.problems.extend(self.study.origin.locate(Problems::one(key, other.to_string())));
            }
        }
    }

    /// The study, if nothing is wrong.
    ///
    /// # Errors
    /// [`Error::Study`] with every problem, in the order of the lines.
    pub fn finish(self) -> Result<Study> {
        let Self { study, mut problems, .. } = self;
        if problems.is_empty() {
            return Ok(study);
        }
        // those of the study's own file first
        problems.sort_by_key(|problem| (problem.path != study.origin.path(), problem.line));
        Err(Error::Study { problems })
    }
}

/// The baselines are a crate of their own, which knows nothing of files.
fn of_baselines(problems: Vec<(String, String)>) -> impl Iterator<Item = KeyProblem> {
    problems.into_iter().map(|(key, message)| KeyProblem { key, message })
}

/// Sections that stand for damaged ones until their mistakes are told.
const PLACEHOLDER: &str = "name = 'study'\nsource = { system = 'none' }\ntime = { stop = 1, step = 1 }\n\
                           parameters = { p = { min = 0, max = 1 } }\noutputs = { y = {} }\nsampling = {}\n";

const PLACEHOLDER_TIME: TimeOptions = TimeOptions { stop: 1.0, step: 1.0, margin: 0.0 };

fn replace(root: &mut Spanned<DeTable<'_>>, sections: &[String]) {
    let placeholder = DeTable::parse(PLACEHOLDER).map(Spanned::into_inner).unwrap_or_default();
    for section in sections {
        root.get_mut().remove(section.as_str());
    }
    let good = placeholder.into_iter().filter(|(name, _)| sections.iter().any(|section| name.get_ref() == section));
    root.get_mut().extend(good);
}

impl Study {
    /// Reads and validates a study file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Study`] with every problem found in it and in the files it names.
    pub fn load(path: &Path) -> Result<Self> {
        Draft::load(path)?.finish()
    }

    /// Validates a study file's text, and reads the files it names; `path` is for messages and tells the folder.
    ///
    /// # Errors
    /// [`Error::Study`] with every problem found in the study and in the files it names.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        Draft::parse(text, path)?.finish()
    }

    /// The file it was read from, and its text.
    pub(crate) fn file(&self) -> (&Path, &str) {
        (self.origin.path(), self.origin.text())
    }

    /// Where a file is that the study names.
    pub fn beside(&self, file: &Path) -> PathBuf {
        self.origin.folder().join(file)
    }

    /// Reads the mechanism, or the digest of other files of the source. False if that failed: problems of a mechanism are in its own
    /// file.
    fn load_source(&mut self, found: &mut Problems, problems: &mut Vec<Problem>) -> bool {
        let Some((key, file)) = self.source.file() else { return true };
        let (key, path) = (format!("source.{key}"), self.beside(file));
        let loaded = if self.source.mechanism.is_some() {
            Mechanism::load(&path).map(|mechanism| self.mechanism = Some(Arc::new(mechanism)))
        } else {
            self.digest_source_files(&path).map(|digest| self.source_files = Some(digest))
        };
        match loaded {
            Ok(()) => return true,
            Err(Error::Study { problems: more }) => problems.extend(more),
            Err(other) => found.add(key, other.to_string()),
        }
        false
    }

    /// Reads the points of a list. False if that failed.
    fn load_points(&mut self, found: &mut Problems) -> bool {
        let Some(file) = &self.sampling.file else { return true };
        match points::read_points(&self.beside(file), &self.parameters) {
            Ok(points) => {
                self.points = Some(Arc::new(points));
                return true;
            }
            Err(error) => found.add("sampling.file", error.to_string()),
        }
        false
    }

    /// SHA-256 of the FMU or of the tables of recorded runs, of which `path` is the first file.
    fn digest_source_files(&self, path: &Path) -> Result<String> {
        let first = files::digest(path)?;
        if self.source.index.is_none() {
            return Ok(first);
        }
        let mut digests = vec![first];
        let mut rows = Table::open(path)?;
        let column = rows.column(self.source.columns.get("file").map_or("file", String::as_str))?;
        while rows.next_row()? {
            let file = path.with_file_name(&*rows.text(column)?);
            digests.push(files::digest(&file).map_err(|error| rows.mistake(&error.to_string()))?);
        }
        Ok(digest::digest(&digests))
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
        digest::of_surrogate(self)
    }

    /// Like [`Study::digest`], of what decides a baseline that is exported.
    pub fn baseline_digest(&self, kind: BaselineKind) -> String {
        digest::of_baseline(self, kind)
    }

    /// Like [`Study::digest`], of what decides the samples only: a table sampled before the network was changed stays good.
    pub fn sampling_digest(&self) -> String {
        digest::of_samples(self)
    }

    /// Fails if there are problems, which are given their lines here.
    ///
    /// # Errors
    /// [`Error::Study`].
    pub fn refuse(&self, problems: Problems) -> Result<()> {
        self.origin.refuse(problems)
    }

    /// The error of one problem.
    pub fn refusal(&self, key: &str, message: impl Into<String>) -> Error {
        Error::Study { problems: self.origin.locate(Problems::one(key, message)) }
    }

    fn name_problems(&self) -> Problems {
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
        problems
    }

    /// What is wrong with each section by itself.
    fn section_problems(&self) -> Problems {
        let mut problems = self.name_problems();
        problems.extend(self.source.problems());
        problems.add_section("time", self.time.problems());
        problems.extend(parameters::problems(&self.parameters));
        problems.extend(outputs::problems(&self.outputs));
        problems.extend(outputs::array_problems(&self.arrays));
        problems.extend(self.sampling.problems());
        problems.add_section("network", self.network.problems());
        problems.add_section("training", self.training.problems());
        problems.extend(self.target.map(|target| target.problems()).unwrap_or_default());
        problems.add_section("bounds", self.bounds.map(|bounds| bounds.problems()).unwrap_or_default());
        problems.add_section("accept", self.accept.problems());
        problems.add_section("baselines", of_baselines(self.baselines.problems()));
        if let Some(search) = &self.search {
            problems.add_section("search", search.problems());
            problems.add_section("search", search.key_problems(&SCHEMA));
        }
        problems
    }

    /// What is wrong with the sections beside each other.
    fn problems_beside(&self) -> Problems {
        let mut problems = self.source.problems_beside(self);
        problems.add_section("time", self.time.problems_beside(self));
        problems.extend(parameters::problems_beside(self));
        problems.extend(outputs::problems_beside(self));
        problems.extend(self.sampling.problems_beside(self));
        problems.extend(size::problems(self));
        problems.extend(self.network.problems_beside(self));
        problems.add_section("training", self.training.problems_beside(self.outputs.len()));
        problems.extend(self.target.map(|target| target.problems_beside(self)).unwrap_or_default());
        // the time is an input, too
        problems.add_section("baselines", of_baselines(self.baselines.problems_beside(self.encoder().width() + 1)));
        problems
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

    /// Number of runs that error bounds are measured on.
    pub fn calibration_runs(&self) -> usize {
        self.bounds.map_or(0, |bounds| bounds.runs)
    }
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
                "`omega` is not an output",
            ),
            ("epochs = ", "epochs = -", "epochs", "training.epochs", "expected"),
            ("[network]", "[bounds]\ncoverage = 95\n[network]", "[network]", "bounds.coverage", "between 0 and 1"),
            ("[network]", "[bounds]\nruns = 18\n[network]", "[network]", "bounds.runs", "at least 19"),
            ("theta = {", "in_domain = {", "theta = ", "outputs.in_domain", "that every FMU of metafmu has"),
            ("[network]", "[accept]\nr2 = 1.5\n[network]", "[network]", "accept.r2", "a number below 1"),
            ("[network]", "[accept]\nr3 = 0.5\n[network]", "[network]", "accept.r3", "unknown key"),
        ] {
            let messages = problems(&GOOD.replacen(from, to, 1));
            let found =
                messages.iter().find(|message| message.contains(&format!(": {key}: ")) && message.contains(says));
            let found = found.unwrap_or_else(|| panic!("{to}: no `{key}` with `{says}` in {messages:#?}"));
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

    /// A section with a mistake in its structure is not judged further, the others are; nothing is said that follows from a mistake.
    #[test]
    fn mistakes_of_all_kinds_are_told_at_once_and_their_consequences_are_not() {
        let text = GOOD
            .replacen("stop = 2.0", "stop = \"2\"", 1)
            .replacen("levels = 11", "level = 11", 1)
            .replacen("min = 0.1,", "min = 0.3,", 1)
            .replacen("hidden = [128, 128]", "hidden = [0]\nnodes = 3", 1)
            .replacen("activation = \"relu\"", "activation = 1", 1);
        let found = problems(&text);
        let keys: Vec<&str> = found.iter().map(|line| line.split(": ").nth(1).unwrap()).collect();
        assert_eq!(
            keys,
            ["time.stop", "parameters.L", "sampling.level", "network.nodes", "network.activation"],
            "{found:#?}"
        );
        let missing = problems(&GOOD.replacen("[time]", "[tyme]", 1));
        let says = ["`time` is missing", "tyme: unknown key `tyme`, expected one of name, description, seed"];
        assert!(missing.len() == 2 && missing.iter().zip(says).all(|(line, says)| line.contains(says)), "{missing:#?}");
    }

    #[test]
    fn the_default_of_every_section_and_the_placeholder_are_valid() {
        let schema = json_schema();
        assert!(DeTable::parse(PLACEHOLDER).is_ok());
        let root = Origin::new(Path::new("p"), PLACEHOLDER);
        let document = root.parse().unwrap();
        let (problems, _) = root.structure(document.get_ref(), schema, |_, _| None);
        assert!(problems.is_empty(), "{problems:?}");
        let study: Study = root.deserialize(document).unwrap();
        assert!(study.network.problems().is_empty() && study.training.problems().is_empty());
        assert!(study.accept.problems().is_empty() && BoundsOptions::default().problems().is_empty());
    }

    #[test]
    fn every_problem_is_listed_not_only_the_first() {
        let text = GOOD.replacen("stop = 2.0", "stop = 0.0", 1).replacen("min = 0.1,", "min = 0.3,", 1);
        assert!(problems(&text).len() >= 2);
    }
}
