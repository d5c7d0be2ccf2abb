//! `metafmu new`: writes a commented study file.

mod command;
mod dynamics;
mod fmu;
mod located;
mod motions;
mod rows;
mod schemas;
mod table;

use super::{CommandOutcome, print, say, terminal::control};
use crate::{cli::NewArgs, templates::Template};
use metafmu::{
    Error, Result,
    diagnostics::{Problems, problem::Problem},
    files,
    multibody::Mechanism,
    pipeline::{
        describe,
        trial::{self, Trial},
    },
    study::{Study, StudyStructure, name_problem},
    systems::{SYSTEMS, System},
    table::Table,
};
use schemas::SchemaFiles;
use std::{
    fmt::Write,
    path::{Component, Path, PathBuf},
};

pub fn run(args: &NewArgs) -> Result<CommandOutcome> {
    let name = args.name.strip_suffix(".toml").unwrap_or(&args.name);
    let path = PathBuf::from(format!("{name}.toml"));
    let folder = path.parent().unwrap_or(Path::new(""));
    let name = Path::new(name).file_name().and_then(|name| name.to_str()).unwrap_or(name);
    if let Some(message) = name_problem(name) {
        let problem = Problem { path: PathBuf::new(), line: 0, key: "NAME".into(), message: message + &instead(name) };
        return Err(Error::Study { problems: vec![problem] });
    }
    if !folder.as_os_str().is_empty() && !folder.is_dir() {
        let message = "is no folder: make it first".into();
        return Err(Error::Stale { path: folder.to_owned(), message });
    }
    expect_structure(args)?;
    expect_free(&path)?;
    let template = args.template.as_deref().and_then(Template::of);
    let (schemas, [study_line, mechanism_line]) = match args.schema {
        true => (SchemaFiles::new(folder, template.is_some())?, [schemas::OF_STUDY, schemas::OF_MECHANISM]),
        false => (SchemaFiles::default(), [""; 2]),
    };
    let target = &StudyTarget { name, folder, first_line: study_line };
    let usual = if template.is_some() { StudyStructure::Dynamics } else { StudyStructure::default() };
    let structure = args.structure.unwrap_or(usual);
    let runs = structure.runs();
    let mechanism = match template {
        Some(template) => Some(written(template, mechanism_line, &folder.join(format!("{name}-mechanism.toml")))?),
        None => args.mechanism.clone(),
    };
    let Proposal { text, trial } = match (&mechanism, &args.fmu, &args.table) {
        (None, None, None) if !args.command.is_empty() => command::study(target, &args.command, structure)?.into(),
        (Some(file), _, _) if runs.start_from_states => dynamics::of_mechanism(target, file)?,
        (Some(file), _, _) => of_mechanism(target, file)?.into(),
        (None, Some(file), _) if runs.start_from_states => fmu::study_of_states(target, file)?.into(),
        (None, Some(file), _) if runs.are_samples => fmu::study_of_samples(target, file)?.into(),
        (None, Some(file), _) => fmu::study(target, file)?.into(),
        (None, None, Some(file)) if runs.are_rows || rows::has_no_time(file, args)? => {
            let text = rows::study(target, file, args)?;
            // all of its rows were read
            Proposal { text, trial: Some(Ok(Trial::default())) }
        }
        (None, None, Some(file)) if !args.outputs.is_empty() => {
            let expected = "expected a table without a time, or --structure static";
            return Err(
                Table::open(file)?.mistake_in_header(&format!("--outputs belongs to rows without a time, {expected}"))
            );
        }
        (None, None, Some(file)) if !args.inputs.is_empty() && runs.are_planned => {
            let expected = "expected --structure discrete or dynamics, or a table without a time";
            let message = format!("--inputs belongs to studies with inputs and rows without a time, {expected}");
            return Err(Table::open(file)?.mistake_in_header(&message));
        }
        (None, None, Some(file)) if runs.start_from_states => motions::study(target, file, args)?.into(),
        (None, None, Some(file)) => table::study(target, file, args)?.into(),
        (None, None, None) => of_system(target, args)?,
    };
    let study = target.parse(&text).map_err(|error| located::in_source(error, args))?;
    schemas.write()?;
    files::write_whole(&path, target.whole(&text).as_bytes())?;
    // the proposal is tried; a refused file is written all the same, to be changed
    let trial = trial.unwrap_or_else(|| trial::attempt(&study, control()?));
    let Trial { runs, failures } = trial.inspect_err(|_| {
        say(format_args!("{} is written, and has to be changed before it can be built", path.display()));
    })?;
    if let Some(failure) = failures.first() {
        let count = failures.len();
        say(format_args!("{count} of {runs} runs that were tried fail, narrower ranges are needed: {failure}"));
    }
    print(&format!("{}\nbuild it with `metafmu build {}`\n", path.display(), path.display()))?;
    Ok(CommandOutcome::Fine)
}

/// Refuses a structure that a source does not have.
fn expect_structure(args: &NewArgs) -> Result<()> {
    let has_samples = args.table.is_some() || args.fmu.is_some() || !args.command.is_empty();
    let structure = args.structure.unwrap_or_default();
    let runs = structure.runs();
    let expected = if runs.are_rows && args.table.is_none() {
        "is for tables: expected --table FILE"
    } else if runs.are_samples && !has_samples {
        "is learned from samples: expected --fmu FILE, --table FILE or --command PROGRAM; here it may be response or dynamics"
    } else {
        return Ok(());
    };
    let key = format!("--structure {}", structure.name());
    let problem = Problem { path: PathBuf::new(), line: 0, key, message: expected.into() };
    Err(Error::Study { problems: vec![problem] })
}

/// A valid name that is like another one, as the end of a message.
fn instead(name: &str) -> String {
    let character = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    let valid: String = name.trim().chars().map(character).collect();
    if name_problem(&valid).is_none() { format!(", for instance `{valid}`") } else { String::new() }
}

/// Refuses to overwrite a file.
fn expect_free(path: &Path) -> Result<()> {
    if !path.exists() {
        return Ok(());
    }
    let message = "exists already and is not overwritten: remove it, or choose another name".into();
    Err(Error::Stale { path: path.to_owned(), message })
}

/// Writes the mechanism file of a template, after `first_line`.
fn written(template: &Template, first_line: &str, path: &Path) -> Result<PathBuf> {
    expect_free(path)?;
    files::write_whole(path, format!("{first_line}{}", template.file()).as_bytes())?;
    print(&format!("{}\n", path.display()))?;
    Ok(path.to_owned())
}

/// A study to be written, and the result of its trial, if it was tried.
struct Proposal {
    text: String,
    trial: Option<Result<Trial>>,
}

impl From<String> for Proposal {
    fn from(text: String) -> Self {
        Self { text, trial: None }
    }
}

/// Name of a study, the folder of its file, and the line before its text; empty if there is none.
struct StudyTarget<'a> {
    name: &'a str,
    folder: &'a Path,
    first_line: &'a str,
}

impl StudyTarget<'_> {
    /// Its file.
    fn file(&self) -> PathBuf {
        self.folder.join(format!("{}.toml", self.name))
    }

    /// Text of its file.
    fn whole(&self, text: &str) -> String {
        format!("{}{text}", self.first_line)
    }

    /// The study of a text, with lines counted as in its file.
    fn parse(&self, text: &str) -> Result<Study> {
        Study::parse(&self.whole(text), &self.file())
    }

    /// Path of a file in the study: relative to the study's folder, unless an absolute path was given.
    fn path_from(&self, file: &Path) -> String {
        let is_here = self.folder.as_os_str().is_empty();
        let (false, Ok(folder), Ok(found)) =
            (is_here || file.is_absolute(), self.folder.canonicalize(), file.canonicalize())
        else {
            return file.display().to_string();
        };
        let common = folder.components().zip(found.components()).take_while(|(a, b)| a == b).count();
        let up = folder.components().skip(common).map(|_| Component::ParentDir);
        up.chain(found.components().skip(common)).collect::<PathBuf>().display().to_string()
    }
}

fn of_system(target: &StudyTarget, args: &NewArgs) -> Result<Proposal> {
    // the arguments have the name of one
    let system = args.system.as_deref().and_then(System::of).unwrap_or(SYSTEMS[0]);
    if args.structure.unwrap_or_default().runs().start_from_states {
        return dynamics::of_system(target, system);
    }
    let (known, name) = (system.name, target.name);
    let text = system
        .study
        .replacen(&format!("metafmu new {known}"), &format!("metafmu new {name}"), 1)
        .replacen(&format!("{known}.toml"), &format!("{name}.toml"), 1)
        .replacen(&format!("name = \"{known}\""), &format!("name = \"{name}\""), 1);
    Ok(text.into())
}

/// A study of a mechanism's parameters with a range and of all its outputs; the rest as in the built-in systems' studies.
fn of_mechanism(target: &StudyTarget, file: &Path) -> Result<String> {
    let mechanism = Mechanism::load(file)?;
    if mechanism.parameters().values().all(|parameter| parameter.min.is_none()) {
        let message = "none has a range, expected `min` and `max` of each that the study is to vary";
        mechanism.refuse(Problems::one("parameters", message))?;
    }
    describe(&mechanism, control()?);
    let (name, file) = (target.name, target.path_from(file));
    let mut text = format!(
        "# Made by `metafmu new {name} --mechanism {file}`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it

[source]
mechanism = {}    # relative to this file
# Parameters of the mechanism that are not varied here: their defaults there, or constants = {{ NAME = VALUE }}
# max_failed = 0.1          # share of the runs that may fail
# time_limit = 60           # s; a run that takes longer fails

[time]                      # rows of a run: 0, step, 2 step, ..., stop
stop = 2.0                  # s
step = 0.01                 # s
margin = 0.05               # training runs are longer by this share of `stop`; without it, errors are largest at the end

[parameters]                # `variability` is \"fixed\" (default), \"tunable\" or \"continuous\" (an input); docs/using-the-fmu.md
",
        quoted(&mechanism.description().description),
        quoted(&file),
    );
    // writing to a string does not fail
    for (name, parameter) in mechanism.parameters() {
        let unit =
            if parameter.unit.is_empty() { String::new() } else { format!(", unit = {}", quoted(&parameter.unit)) };
        let _ = match (parameter.min, parameter.max) {
            (Some(min), Some(max)) => writeln!(text, "{name} = {{ min = {min:?}, max = {max:?}{unit} }}"),
            _ => writeln!(
                text,
                "# {name} = {{ min = ..., max = ...{unit} }}    # {:?} where it is not varied",
                parameter.default
            ),
        };
    }
    text += "\n[outputs]\n";
    for output in mechanism.outputs() {
        let _ = writeln!(text, "{} = {{ unit = {} }}", output.name, quoted(&output.unit));
    }
    let _ = write!(text, "\n{}{}", sampling(), rest(RUNS, 200.0));
    Ok(text)
}

/// Runs that a new study samples.
const RUNS: usize = 1000;

/// `[sampling]` of a source that can be sampled anywhere in the ranges.
fn sampling() -> String {
    format!(
        "[sampling]
method = \"sobol\"            # points without gaps and clusters; docs/sampling.md has the others
runs = {RUNS}
faces = 0.1                 # share of the training runs on the ends of each range; without it, errors are largest there
test_runs = 200             # random runs that are never part of training

"
    )
}

/// End of a study of the structure "discrete".
const DISCRETE: &str = "[discrete]
history = 8                 # past samples of outputs and inputs that the next outputs follow from, at most
stretch = 64                # samples that are predicted in a row in the training

[network]
hidden = [32, 32]           # beside what is linear

[training]
epochs = 300
";

/// Largest number of optimizer steps of a training: half a minute to a minute with the network of the examples.
const STEPS: f64 = 40_000.0;

/// Rows of a batch in the examples.
const BATCH: f64 = 1024.0;

/// Smallest number of runs held out for validation.
const HELD_OUT: f64 = 10.0;

/// The study from `[network]` on, as in the built-in systems' studies, with epochs and validation that suit `runs`
/// training runs of `rows` rows.
fn rest(runs: usize, rows: f64) -> String {
    let template = SYSTEMS[0].study;
    let text = template.find("[network]").map_or("", |start| &template[start..]);
    let steps = (runs as f64 * rows / BATCH).ceil().max(1.0);
    let epochs = (STEPS / steps).round().clamp(30.0, 3000.0);
    let validation = (HELD_OUT / runs.max(1) as f64).clamp(0.03, 0.2);
    text.replacen("epochs = 150 ", &format!("epochs = {epochs:<4}"), 1).replacen(
        "validation = 0.03 ",
        &format!("validation = {validation:<5.2}"),
        1,
    )
}

/// Bandwidth of the inputs of runs, in Hz: ten periods in a run, and at most what rows a step apart can show.
fn bandwidth(stop: f64, step: f64) -> f64 {
    fmu::short((10.0 / stop).min(0.5 / step))
}

/// A TOML key.
fn key(name: &str) -> String {
    let is_bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if is_bare { name.to_owned() } else { quoted(name) }
}

/// A TOML string.
fn quoted(text: &str) -> String {
    let plain = text.replace(char::is_control, " ");
    format!("\"{}\"", plain.replace('\\', "\\\\").replace('"', "\\\""))
}
