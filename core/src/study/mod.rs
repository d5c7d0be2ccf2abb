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
//! # command = ["python", "model.py"]    # a program that answers requests (see `source::command`); or
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
//! With `structure = "dynamics"` the surrogate has states and is driven by inputs, and there are further sections:
//!
//! ```toml
//! [states]                              # a coordinate for each degree of freedom of a mechanism
//! "rail.position" = { min = -5.0, max = 5.0 }
//!
//! [inputs]                              # those of the mechanism
//! force = { bandwidth = 1.0 }
//! ```
//!
//! With `structure = "static"` the surrogate is a function of its inputs alone, fitted to the rows of a table; see [`StaticOptions`]. There are
//! `[inputs]` and `[outputs]`, and neither `[time]`, `[parameters]` nor `[sampling]`.
//!
//! With `structure = "discrete"` it is discrete-time, learned from a table with columns of inputs, or from an FMU or a
//! program; see [`DiscreteOptions`].
//!
//! With `structure = "compliant"` the surrogate is a force between two interfaces that creates no energy; see [`CompliantOptions`].
//!
//! Each section has a file here: its options, defaults, limits and checks. docs/study-file.md has every key. A
//! section's `problems` follow from the section alone, its `problems_beside` from the other sections as well.

mod accept;
pub mod baselines;
mod bounds;
mod digest;
mod draft;
mod export;
mod inputs;
mod kinds;
mod limits;
mod network;
mod outputs;
mod parameters;
mod points;
mod recording;
mod run_form;
mod sampling;
mod search;
mod size;
mod source;
mod target;
mod time;
mod training;

use crate::{
    Error, Result,
    diagnostics::{Problems, origin::Origin, problem::Problem, schema},
    files,
    multibody::Mechanism,
    systems::System,
    table::Table,
};
pub use accept::AcceptOptions;
pub use baselines::{BaselineKind, Baselines};
pub use bounds::BoundsOptions;
pub use draft::Draft;
pub use export::{ExportOptions, FmiChoice, FmuInterface, FmuPort, NameStyle};
use indexmap::IndexMap;
pub use inputs::{Excitation, InputOptions};
pub use kinds::{
    CompliantOptions, DiscreteModel, DiscreteOptions, DynamicsModel, DynamicsOptions, MAX_DEGREE, ModelKind, NETWORK,
    SmallNetworks, StateOptions, StaticOptions, StudyStructure, is_angle, velocity_name,
};
use kinds::{states, static_map};
pub use limits::{MAX_HALTON_PARAMETERS, MAX_SOBOL_PARAMETERS, MAX_VARIABLES};
use metafmu_runtime::{Encoder, Encoding};
pub use network::{NetworkOptions, TimeStructure};
pub use outputs::OutputOptions;
pub use outputs::check_variable_name;
pub use parameters::{ParameterOptions, ParameterVariability};
pub use points::read_value;
pub use recording::Recording;
pub use run_form::RunForm;
pub use sampling::{Method, SamplingOptions};
use schemars::JsonSchema;
pub use search::set;
pub use search::{SearchMethod, SearchOptions, SearchRange, SearchScale, Space};
use serde::Deserialize;
pub use source::{RESULT, SourceOptions};
use std::{
    path::{Path, PathBuf},
    sync::{Arc, LazyLock},
};
pub use target::TargetOptions;
pub use time::TimeOptions;
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
    /// Structure of the surrogate.
    #[serde(default)]
    pub structure: StudyStructure,
    /// Source of the runs, one of `system`, `mechanism`, `fmu`, `command`, `table` and `index`.
    pub source: SourceOptions,
    /// The rows of a run: `0, step, ..., stop`. Required, but of the structure "static".
    #[serde(default = "TimeOptions::of_rows")]
    #[schemars(with = "Option<TimeOptions>")]
    pub time: TimeOptions,
    /// Parameters by name: the surrogate's inputs beside the time. Each has `min` and `max`, or `values`. With states there may be none. Of the structure
    /// "static" there are none.
    #[serde(default)]
    pub parameters: IndexMap<String, ParameterOptions>,
    /// Independent coordinates by name, one for each degree of freedom, of the structure "dynamics".
    #[serde(default)]
    pub states: IndexMap<String, StateOptions>,
    /// Inputs by name. Of the structure "dynamics" all that the mechanism has; those that are not named have the mechanism's ranges. Of the
    /// structure "discrete" the columns that drive the runs, of the structure "static" those that the outputs follow from.
    #[serde(default)]
    pub inputs: IndexMap<String, InputOptions>,
    /// Which of the ways to learn the equations is exported, of the structure "dynamics".
    #[serde(default)]
    pub dynamics: DynamicsOptions,
    /// The force of a flexible part, of the structure "compliant".
    #[serde(default)]
    pub compliant: CompliantOptions,
    /// Outputs by name. Of the structure "compliant" positions, velocities and forces.
    pub outputs: IndexMap<String, OutputOptions>,
    /// Outputs of one unit that an FMI 3.0 FMU also offers as an array, by the array's name.
    #[serde(default)]
    #[schemars(extend("examples" = [{"angles": ["theta1", "theta2"]}]))]
    pub arrays: IndexMap<String, Vec<String>>,
    /// Discrete-time models, of the structure "discrete".
    #[serde(default)]
    pub discrete: DiscreteOptions,
    /// The model of the rows of a table, of the structure "static".
    #[serde(default, rename = "static")]
    pub static_map: StaticOptions,
    /// Where in the parameters' ranges runs are placed.
    #[serde(default)]
    pub sampling: SamplingOptions,
    /// The feed-forward network. Without this section, those in the equations of motion of a mechanism have
    /// `hidden = [64, 64, 64]`. Without `[training]` as well, they first have one hidden layer with random weights, and
    /// are trained only if that is not exact enough.
    #[serde(default)]
    pub network: NetworkOptions,
    /// How the network is trained. Without this section, those in the equations of motion of a mechanism are trained with
    /// `schedule = "cosine"`, `learning_rate = 0.01`, `batch = 256` and `epochs = 600`.
    #[serde(default)]
    pub training: TrainingOptions,
    /// How good the surrogate is to be, if runs are to be added until it is.
    pub target: Option<TargetOptions>,
    /// Error bounds of the outputs; without this section there are none. Of a surrogate with a state they grow with the time since the
    /// start.
    pub bounds: Option<BoundsOptions>,
    /// When a surrogate is good enough to be used. One that is not is rejected: `build`, `train` and `evaluate` say why and end with exit
    /// code 1.
    #[serde(default)]
    pub accept: AcceptOptions,
    /// Kind and metadata of the FMU.
    #[serde(default)]
    pub export: ExportOptions,
    /// Models that are compared with the network.
    #[serde(default)]
    pub baselines: Baselines,
    /// Studies like this one that are tried in search of the best.
    pub search: Option<SearchOptions>,
    /// Values of the states at the start, sampled like parameters.
    #[serde(skip)]
    starts: IndexMap<String, ParameterOptions>,
    #[serde(skip)]
    origin: Origin,
    #[serde(skip)]
    mechanism: Option<Arc<Mechanism>>,
    /// The points of the method "list".
    #[serde(skip)]
    points: Option<Arc<Vec<Vec<f64>>>>,
    /// The recorded signals, by the inputs that have one.
    #[serde(skip)]
    recordings: IndexMap<String, Arc<Recording>>,
    /// Digest of the FMU, of the command and its files, or of the tables of recorded runs.
    #[serde(skip)]
    source_files: Option<String>,
    /// `true` if the study has `training.epochs`.
    #[serde(skip)]
    has_epochs: bool,
    /// How the network of a static map is trained.
    #[serde(skip)]
    small_networks: SmallNetworks,
}

/// Problem of the name of a study, after which files are named; none if it is valid.
pub fn name_problem(name: &str) -> Option<String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) || !name.chars().all(is_plain) {
        let expected = "expected a letter, then letters, digits, `-` and `_`";
        return Some(format!("`{name}` is not a valid name: {expected}"));
    }
    let characters = name.chars().count();
    (characters > MAX_NAME)
        .then(|| format!("{characters} characters, expected at most {MAX_NAME}: files are named after it"))
}

/// Characters of a study's name, which is part of the names of files; most systems take 255.
pub const MAX_NAME: usize = 100;

fn default_seed() -> u64 {
    1
}

static SCHEMA: LazyLock<serde_json::Value> = LazyLock::new(schema::of::<Study>);

/// The JSON schema of a study file.
pub fn json_schema() -> &'static serde_json::Value {
    &SCHEMA
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
    pub fn file(&self) -> (&Path, &str) {
        (self.origin.path(), self.origin.text())
    }

    /// Where a file is that the study names.
    pub fn beside(&self, file: &Path) -> PathBuf {
        self.origin.folder().join(file)
    }

    /// Reads the mechanism, or the digest of other files of the source. False if that failed: problems of a mechanism are in its own
    /// file.
    fn load_source(&mut self, found: &mut Problems, problems: &mut Vec<Problem>, may_lack_table: bool) -> bool {
        if self.source.command.is_some() {
            return self.load_command(found);
        }
        let Some((key, file)) = self.source.file() else { return self.load_system(found) };
        let (key, path) = (format!("source.{key}"), self.beside(file));
        if may_lack_table && self.source.table.is_some() && !path.exists() {
            return true;
        }
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

    /// With states, a built-in system is the mechanism that describes it; one of an unknown name is refused elsewhere.
    fn load_system(&mut self, found: &mut Problems) -> bool {
        let Some(system) = self.source.system.as_deref().and_then(System::of).filter(|_| self.runs().start_from_states)
        else {
            return true;
        };
        match Mechanism::parse(system.mechanism, Path::new(system.name)) {
            Ok(mechanism) => self.mechanism = Some(Arc::new(mechanism)),
            Err(error) => found.add("source.system", error.to_string()),
        }
        self.mechanism.is_some()
    }

    /// Takes the digest of the command and its files. False if a file cannot be read.
    fn load_command(&mut self, found: &mut Problems) -> bool {
        let (mut digests, mut problems) = (Vec::new(), Problems::default());
        for argument in self.source.command.iter().flatten() {
            let path = self.beside(Path::new(argument));
            // a file counts by its content, as it may be moved
            let content = path.is_file().then(|| files::digest(&path));
            match content.transpose() {
                Ok(content) => digests.push(content.unwrap_or_else(|| argument.clone())),
                Err(error) => problems.add("source.command", error.to_string()),
            }
        }
        for file in &self.source.files {
            match files::digest(&self.beside(file)) {
                Ok(content) => digests.push(content),
                Err(error) => problems.add("source.files", error.to_string()),
            }
        }
        self.source_files = Some(digest::digest(&digests));
        let is_read = problems.is_empty();
        found.extend(problems);
        is_read
    }

    /// Takes ranges of states that are not given from the study's table. False if that failed.
    fn load_ranges(&mut self, found: &mut Problems) -> bool {
        let Some(file) =
            self.source.table.as_ref().filter(|_| self.runs().start_from_states && self.source_files.is_some())
        else {
            return true;
        };
        let (path, stop) = (self.beside(file), self.sampling.train_stop.unwrap_or(self.time.stop));
        let completed = Table::open(&path)
            .and_then(|mut table| states::complete(&mut self.states, &self.source.columns, stop, &mut table));
        match completed {
            Ok(()) => {
                found.extend(states::problems(self));
                self.starts = states::starts(self);
                true
            }
            Err(error) => {
                found.add("source.table", error.to_string());
                false
            }
        }
    }

    /// Reads the points of a list. False if that failed.
    fn load_points(&mut self, found: &mut Problems) -> bool {
        // a motion has no method, which is said elsewhere
        let Some(file) = self.sampling.file.as_ref().filter(|_| !self.runs().start_from_states) else { return true };
        match points::read_points(&self.beside(file), &self.parameters) {
            Ok(points) => {
                self.points = Some(Arc::new(points));
                return true;
            }
            Err(error) => found.add("sampling.file", error.to_string()),
        }
        false
    }

    /// Reads the recorded signals. False if that failed.
    fn load_recordings(&mut self, found: &mut Problems) -> bool {
        let files: Vec<(String, PathBuf)> = self
            .inputs
            .iter()
            .filter_map(|(name, input)| Some((name.clone(), self.beside(input.recording.as_ref()?))))
            .collect();
        let mut are_read = true;
        for (name, file) in files {
            match Recording::read(&file, &name) {
                Ok(recording) => {
                    self.recordings.insert(name, Arc::new(recording));
                }
                Err(error) => {
                    found.add(format!("inputs.{name}.recording"), error.to_string());
                    are_read = false;
                }
            }
        }
        are_read
    }

    /// SHA-256 of the FMU or of the tables of recorded runs, of which `path` is the first file.
    fn digest_source_files(&self, path: &Path) -> Result<String> {
        let mut digests = self.digest_tables(path)?;
        if let Some(test) = self.sampling.test.as_ref().filter(|_| self.source.is_recorded()) {
            digests.push("test".into());
            digests.extend(self.digest_tables(&self.beside(test))?);
        }
        Ok(if let [only] = &digests[..] { only.clone() } else { digest::digest(&digests) })
    }

    /// SHA-256 of a table of recorded runs, or of an index and its files.
    fn digest_tables(&self, path: &Path) -> Result<Vec<String>> {
        let mut digests = vec![files::digest(path)?];
        if self.source.index.is_none() {
            return Ok(digests);
        }
        let mut rows = Table::open(path)?;
        let column = rows.column(self.source.columns.get("file").map_or("file", String::as_str))?;
        while rows.next_row()? {
            let file = path.with_file_name(&*rows.text(column)?);
            digests.push(files::digest(&file).map_err(|error| rows.mistake(&error.to_string()))?);
        }
        Ok(digests)
    }

    /// The mechanism that the study's source names, or that describes its built-in system if the study has states.
    pub fn mechanism(&self) -> Option<&Arc<Mechanism>> {
        self.mechanism.as_ref()
    }

    /// The points of the method "list".
    pub fn points(&self) -> Option<&[Vec<f64>]> {
        self.points.as_ref().map(|points| points.as_slice())
    }

    /// The recorded signal of an input, if it has one.
    pub fn recording(&self, input: &str) -> Option<&Arc<Recording>> {
        self.recordings.get(input)
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

    /// Where its keys are.
    pub fn origin(&self) -> &Origin {
        &self.origin
    }

    /// The error of one problem.
    pub fn refusal(&self, key: &str, message: impl Into<String>) -> Error {
        Error::Study { problems: self.origin.locate(Problems::one(key, message)) }
    }

    fn name_problems(&self) -> Problems {
        let mut problems = Problems::default();
        name_problem(&self.name).into_iter().for_each(|problem| problems.add("name", problem));
        problems
    }

    /// Problems of each section alone.
    fn section_problems(&self) -> Problems {
        let mut problems = self.name_problems();
        problems.extend(self.source.problems());
        problems.add_section("time", self.time.problems());
        problems.extend(parameters::problems(&self.parameters, self.runs()));
        problems.extend(states::problems(self));
        problems.extend(inputs::problems(&self.inputs));
        problems.extend(outputs::problems(&self.outputs));
        problems.extend(outputs::array_problems(&self.arrays));
        problems.add_section("discrete", self.discrete.problems());
        problems.add_section("compliant", self.compliant.problems());
        problems.add_section("dynamics", self.dynamics.problems());
        problems.extend(self.sampling.problems(self.runs()));
        problems.add_section("network", self.network.problems());
        problems.add_section("training", self.training.problems());
        problems.extend(self.target.map(|target| target.problems()).unwrap_or_default());
        problems.add_section("bounds", self.bounds.map(|bounds| bounds.problems()).unwrap_or_default());
        problems.add_section("accept", self.accept.problems());
        problems.add_section("baselines", self.baselines.problems());
        if let Some(search) = &self.search {
            problems.add_section("search", search.problems());
            problems.add_section("search", search.key_problems(&SCHEMA));
        }
        problems
    }

    /// Problems of the sections in combination.
    fn problems_beside(&self) -> Problems {
        let mut problems = self.structure.kind().problems_beside(self);
        // the kind has said everything of rows, and so has the reader of the file
        if self.runs().are_rows {
            return problems;
        }
        problems.extend(kinds::options_of_others(self));
        problems.extend(self.source.problems_beside(self));
        problems.add_section("time", self.time.problems_beside(self));
        problems.extend(parameters::problems_beside(self));
        problems.extend(inputs::problems_beside(self));
        problems.extend(outputs::problems_beside(self));
        problems.extend(self.sampling.problems_beside(self));
        problems.extend(size::problems(self));
        problems.extend(self.network.problems_beside(self));
        problems.add_section("training", self.training.problems_beside(self.outputs.len()));
        problems.extend(self.target.map(|target| target.problems_beside(self)).unwrap_or_default());
        // the time is an input, too
        problems.add_section("baselines", self.baselines.problems_beside(self.encoder().width() + 1));
        problems.add_section("export", self.export.problems_beside(self));
        problems
    }

    /// The sampled quantities in order: the parameters, then the values of the states at the start.
    pub fn sampled(&self) -> impl Iterator<Item = (&String, &ParameterOptions)> {
        self.parameters.iter().chain(&self.starts)
    }

    /// The quantities of a plan's points in order: the sampled ones and, for runs of the structure "discrete", a number
    /// that determines their signals, since nothing else may distinguish these runs.
    pub fn planned(&self) -> impl Iterator<Item = (&str, &ParameterOptions)> {
        static NUMBER: ParameterOptions = ParameterOptions::range(0.0, 1.0);
        let sampled = self.sampled().map(|(name, options)| (name.as_str(), options));
        sampled.chain(self.runs().are_samples.then_some(("signals", &NUMBER)))
    }

    /// The values of the states at the start: of the coordinates, of the velocities, then of actuator states.
    pub fn starts(&self) -> &IndexMap<String, ParameterOptions> {
        &self.starts
    }

    /// Returns true if the study sets how networks in the equations of motion of a mechanism are trained: a section
    /// differs from the defaults.
    pub fn trains_networks(&self) -> bool {
        self.network != NetworkOptions::of_equations() || self.training != TrainingOptions::of_equations()
    }

    /// Returns true if an entry of `[states]` is an actuator state of a mechanism: coordinates have a dot in their names.
    pub fn is_actuator_state(&self, name: &str) -> bool {
        self.source.is_of_equations() && !name.contains('.')
    }

    /// Entries of `[states]` but actuator states: coordinates of a mechanism or a table, states of an FMU.
    pub fn coordinates(&self) -> impl Iterator<Item = (&String, &StateOptions)> + Clone {
        self.states.iter().filter(|(name, _)| !self.is_actuator_state(name))
    }

    /// Actuator states of a mechanism.
    pub fn actuator_states(&self) -> impl Iterator<Item = (&String, &StateOptions)> + Clone {
        self.states.iter().filter(|(name, _)| self.is_actuator_state(name))
    }

    /// Moves the actuator states of a mechanism behind the coordinates, in the order of its file.
    fn order_states(&mut self) {
        let Some(mechanism) = self.mechanism.as_ref().filter(|_| self.runs().start_from_states) else { return };
        self.states.sort_by_cached_key(|name, _| mechanism.actuator_states().get_index_of(name).map(|index| index + 1));
        self.starts = states::starts(self);
    }

    /// Returns true if the source gives a mass matrix: some states are rates of others.
    pub fn has_mass_matrix(&self) -> bool {
        self.states.values().any(|state| state.rate_of.is_some())
    }

    /// Form of the runs that the surrogate is learned from.
    pub fn runs(&self) -> RunForm {
        self.structure.runs()
    }

    /// Training options for a network on a table with this many rows.
    pub fn training_on(&self, rows: usize) -> TrainingOptions {
        let training = self.training.clone();
        let usual = static_map::epochs(training.held_in(rows), training.batch);
        TrainingOptions { epochs: if self.has_epochs { training.epochs } else { usual }, ..training }
    }

    /// Which networks of a static map are trained by Levenberg-Marquardt steps: none if the study has options of the training.
    pub fn small_networks(&self) -> SmallNetworks {
        self.small_networks
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
            None => self.sampling.runs.unwrap_or(self.runs().usual_number) as u64,
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
mod tests;
