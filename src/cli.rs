//! The command line: definitions only.

mod values;

use crate::templates::TEMPLATES;
use clap::{
    ArgGroup, Args, ColorChoice, Parser, Subcommand, ValueEnum, ValueHint,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use clap_complete::Shell;
use metafmu::{
    baselines::BaselineKind, export::Binary, fmi::worker, source::shard::Shard, study::StudyStructure,
    systems::SYSTEMS, table::writer::Format, variable::DefaultValue,
};
use std::{path::PathBuf, time::Duration};
use values::{duration, name_and_value, share, svg_file, table_file, tolerance, tuple_and_file};

/// Makes FMUs of multibody models, recorded runs, other FMUs and trained networks
///
/// A surrogate is sampled and trained, measured on unseen runs, and packaged as a Functional Mock-up Unit. It runs in
/// every tool that supports FMI 2.0 or 3.0, without further software.
#[derive(Debug, Parser)]
#[command(
    version,
    arg_required_else_help = true,
    after_help = "Begin with what you have:
  metafmu import net.onnx --new interface.toml       a trained network
  metafmu new my-study --table runs.csv              recorded runs
  metafmu new my-study --table points.csv            rows of inputs and outputs
  metafmu new my-study --fmu model.fmu               a third-party FMU
  metafmu new my-study --command python model.py     a program: MuJoCo, a script, an in-house code
  metafmu new my-study --mechanism mechanism.toml    bodies, joints and forces
  metafmu new my-study --template crane              such a file to start from
  metafmu new my-study --system single-pendulum      a built-in system

Review the file that this writes, then:
  metafmu build my-study.toml                        everything, into out/my-study/
  metafmu import net.onnx --interface interface.toml
  metafmu export NAME.safetensors                    an FMU of what `import` wrote

`metafmu help VERB` has examples of each verb. Results go to stdout, progress to stderr.
Exit codes: 0 fine, 1 problems found, 2 failure, 3 the FMU to validate could not be run here, 130 stopped by Ctrl-C, even if the later \
stages completed."
)]
pub struct Cli {
    #[command(flatten)]
    pub global: GlobalArgs,
    #[command(subcommand)]
    pub command: Command,
}

/// Options of every verb.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Options of every verb")]
pub struct GlobalArgs {
    /// Write warnings and errors to stderr only, without progress and notes
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Write notes in addition to the progress bar; with --version, platforms and threads as well
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Color of verdicts, warnings and errors
    #[arg(long, global = true, value_name = "WHEN", value_enum, default_value_t = ColorChoice::Auto)]
    pub color: ColorChoice,
    /// Number of threads [default: one for each core]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write a commented study file
    #[command(after_help = "Examples:
  metafmu new my-pendulum --system single-pendulum
  metafmu new my-component --system double-pendulum --structure dynamics    # with states, of its equations of motion
  metafmu new my-hoist --template crane    # writes my-hoist-mechanism.toml as well, to be changed
  metafmu new my-linkage --mechanism examples/mechanisms/four-bar.toml
  metafmu new my-surrogate --fmu model.fmu
  metafmu new my-component --fmu model.fmu --structure dynamics    # with its states, for model exchange
  metafmu new my-component --fmu model.fmu --structure discrete    # discrete-time, for co-simulation
  metafmu new my-surrogate --table runs.csv
  metafmu new my-surrogate --table runs.csv --time Zeit --run Case
  metafmu new my-component --table motions.csv --structure dynamics    # coordinates, their rates and inputs in the columns
  metafmu new my-component --table runs.csv --structure discrete --inputs force,voltage    # driven by columns of the table
  metafmu new my-map --table points.csv    # rows without a time: columns follow from columns
  metafmu new my-loss --table points.csv --inputs speed,torque
  metafmu new my-hoist --template crane --schema    # for editors: with the JSON schemas of both files

With a mechanism or an FMU, its parameters that have a `min` and a `max` become the study's, and so do all its outputs. Of an \
FMU without such parameters the first ones vary by a tenth around their start values: review the study.
Of a table, columns with one value in each run become parameters, the others outputs, or inputs of the structure discrete.
Of a table without a time, columns are inputs or outputs; those that are constant, text, or number the rows are left out.")]
    New(NewArgs),
    /// Do everything: sample, train, evaluate, report, export, validate
    #[command(after_help = "Example:\n  metafmu build examples/single-pendulum.toml --out /tmp/pendulum

Writes into DIR: NAME.fmu (of FMI 3.0: NAME-fmi3.fmu), NAME.safetensors, report.html, metrics.json, train.csv, test.csv, samples.json, history.csv. \
Tables of more than 5 million numbers are Parquet, train.parquet and test.parquet; `tables` in [sampling] of the study selects a format.
Exit code 1 if the surrogate is rejected: the training diverged, the R² of an output is below 0.9, a simpler model is better, or a check \
failed: the validation of the FMU, or the error of its solver. From 0.9 to 0.99 it is usable, and the verdict has advice. `[accept]` in the study has the limits.
Ctrl-C ends with exit code 130 and says what is done, what is missing, and the command with --resume that continues. During training it keeps \
the best network so far and completes the build with it, during the comparison with the models that are done. Before the first epoch is \
complete there is no network. Pressed again, Ctrl-C ends the program.")]
    Build(BuildArgs),
    /// Simulate the training and test runs and write their tables, CSV or Parquet
    #[command(after_help = "Examples:
  metafmu sample examples/single-pendulum.toml
  metafmu sample examples/single-pendulum.toml --dry-run > plan.csv
  metafmu sample study.toml --out DIR --shard 3/8    # on one of eight machines that share DIR, or copy their files to it
  metafmu sample study.toml --out DIR --merge        # when all are done: the tables are as if there had been no shards

The same study has the same plan. With the methods \"random\", \"sobol\" and \"halton\" the first points of a longer plan are \
the shorter plan; the first column of a printed plan says what a run is for.
Tables are train.csv and test.csv, those of more than 5 million numbers Parquet; `tables` in [sampling] of the study selects a format.")]
    Sample(SampleArgs),
    /// Write the next points to run, for a table of inputs and outputs without a time
    #[command(after_help = "Examples:
  metafmu plan study.toml --points 50 --out points.csv    # before the table exists: they fill the ranges of the study's inputs
  metafmu plan study.toml --points 10 > next.csv          # beside the rows of the table: where the expected error is reduced the most

The study has structure = \"static\", as `metafmu new NAME --table points.csv` writes it. The columns are those of the table; outputs are empty, \
for you to fill in. Rows of the table without outputs are points that were planned before. The same study and table have the same points.")]
    Plan(PlanArgs),
    /// Train the network on the sampled runs and write NAME.safetensors and history.csv
    #[command(after_help = "Examples:
  metafmu train examples/single-pendulum.toml
  metafmu train examples/single-pendulum.toml --resume    # after it was stopped, killed, or lost power")]
    Train(TrainArgs),
    /// Train variants of the study side by side and write search.csv and NAME-best.toml
    #[command(after_help = "Examples:
  metafmu search study.toml
  metafmu search study.toml --resume    # after it was stopped, killed, or lost power

The study says what to try, for instance:

  [search]
  method = \"halving\"       # after each rung the best ones continue; or \"random\", \"grid\"
  trials = 18
  [search.space]
  \"training.learning_rate\" = { min = 1e-3, max = 1e-2, scale = \"log\" }
  \"training.optimizer\" = [\"adam\", \"soap\"]
  \"network.hidden\" = [[64, 64], [128, 128]]

Every value is checked when the study is read. Trials are compared by 1 - R² on held-out runs; one that fails is a row of the \
table. With `model = \"svr\"` they fit that \
baseline instead of the network, for instance for \"baselines.svr.c\" = [1.0, 10.0, 100.0].")]
    Search(SearchArgs),
    /// Compare the surrogate with the test runs and write metrics.json
    #[command(after_help = "Example:\n  metafmu evaluate examples/single-pendulum.toml --json")]
    Evaluate(StudyArgs),
    /// Fit simpler models to the same rows and write comparison.json and comparison.csv
    #[command(after_help = "Examples:
  metafmu compare examples/single-pendulum.toml
  metafmu compare examples/single-pendulum.toml --model ridge --model random-forest

The table has accuracy on the unseen runs, time and memory of the network and of each model. `[baselines]` in the study has \
their options, for instance:

  [baselines]
  models = [\"ridge\", \"svr\"]   # all twelve unless given
  build = []                    # those that `metafmu build` fits as well
  time_budget = 60              # seconds for each
  svr = { rows = 2000, c = 100.0 }

A model that fails or takes too long has a row that says so. `metafmu export STUDY --model ridge` makes an FMU of one.")]
    Compare(CompareArgs),
    /// Fit one baseline; `compare` runs this
    #[command(hide = true)]
    FitBaseline,
    /// Show the surrogate beside the truth of the test runs and write report.html
    #[command(after_help = "Examples:
  metafmu report examples/single-pendulum.toml
  metafmu report examples/single-pendulum.toml --plots plots/                    # each plot as an SVG file, too
  metafmu report examples/single-pendulum.toml --beside examples/paper/single-pendulum.toml --beside-out out/paper

The page is one file that loads nothing: summary, label against prediction, time responses of the median and the worst run, \
phase plots, paths of points, errors over time and parameters, sensitivities, training, provenance. With --beside, another \
study's surrogate of the same variables is measured on the same test runs.")]
    Report(ReportArgs),
    /// Package NAME.safetensors as NAME.fmu
    #[command(mut_arg("study", |arg| arg.help("Study, model file NAME.safetensors, or an FMU made by metafmu")))]
    #[command(after_help = "Examples:
  metafmu export examples/single-pendulum.toml
  metafmu export out/single-pendulum/single-pendulum.safetensors --fmi 3 --sources
  metafmu export examples/single-pendulum.toml --fmi both --binary aarch64-linux=libfmu_template.so
  metafmu export examples/single-pendulum.toml --model ridge
  metafmu export examples/single-pendulum.toml --onnx single-pendulum.onnx    # for third-party tools: no states

The FMU has a binary for every platform embedded in this program unless --platform or --binary says otherwise. STUDY can also be a model \
file or an FMU made by metafmu. Its FMUs are written to the working directory or to --out, and their model cards have no accuracy.")]
    Export(ExportModelArgs),
    /// Read a third-party network and write NAME.safetensors, which `export` takes
    #[command(after_help = "Examples:
  metafmu import model.onnx --new interface.toml --data training.csv    # write a starter for the interface
  metafmu import model.onnx --interface interface.toml --data training.csv --check expected.csv
  metafmu export model.safetensors --fmi both

The interface says which column of the model is which variable: names, units, ranges, causality. Ranges that it does not have are those of \
--data. --check compares a table of the model's inputs and outputs with the import: if they differ, nothing is written, and the exit code \
is 1. docs/import.md lists the operators of ONNX that are known, and every key of an interface.")]
    Import(ImportArgs),
    /// Print the JSON schema of study, mechanism or interface files, with which editors complete and check them
    #[command(after_help = "Examples:
  metafmu schema study > study.schema.json
  metafmu schema mechanism > mechanism.schema.json

With the line `#:schema ./study.schema.json` at its beginning, a study is completed and checked by editors with Taplo, such as \
Visual Studio Code with Even Better TOML. `metafmu new NAME --schema` writes both. docs/study-file.md and docs/mechanism-file.md have every key.")]
    Schema(SchemaArgs),
    /// Check an FMU and list every problem
    #[command(after_help = "Example:\n  metafmu validate out/single-pendulum/single-pendulum.fmu

Takes FMI 2.0 and 3.0 FMUs of any tool and runs them by each interface they offer, in a separate process: an FMU that \
crashes, exits or hangs is reported as a problem. What it prints goes to stderr. The libraries of all platforms are checked by their names \
and headers. Exit code 1 if there are problems; 3 if none was found, but the FMU could not be run by all of its interfaces, for instance \
because it has no library for this platform.")]
    Validate(ValidateArgs),
    /// Run an FMU and write its outputs as CSV
    #[command(after_help = "Example:
  metafmu simulate out/single-pendulum/single-pendulum.fmu --start L=0.12 --start c=0.05 --output run.csv --plot run.svg
  metafmu simulate plant.fmu --input force.csv --interface me
  metafmu simulate plant.fmu --input force.csv --default brake    # the input without a column keeps its start value
  metafmu simulate discrete.fmu --input record.csv    # from measured outputs in rows before time 0

With --input, every input of the FMU has a column, or a value by --default or --start. Parameters keep their start values unless --start sets \
them. The FMU runs in a separate process; its output goes to stderr.")]
    Simulate(SimulateArgs),
    /// Compute a surrogate's outputs for every row of a table, on all cores
    #[command(after_help = "Examples:
  metafmu predict out/single-pendulum/single-pendulum.fmu designs.csv > predictions.csv
  metafmu predict examples/single-pendulum.toml designs.parquet --out predictions.parquet
  metafmu predict out/crane/crane.fmu out/crane/test.csv --out roll-outs.csv --outputs x,theta
  metafmu predict out/crane/crane.fmu forces.csv --default l --default m=1.2    # without columns of two parameters

Columns of TABLE are found by the names of the surrogate's parameters, inputs and `time`; of one with states also by those of the \
values at the start, NAME_start. Parameters and inputs without a column are an error, which lists all of them: --default NAME uses a start \
value, --default NAME=VALUE another one. A missing NAME_start has its start value unless columns remain that nothing uses. The result has a row for each row, in the same order: `run` and `time` if TABLE has them, the outputs, \
`in_domain` and `domain_distance`. Without states each row is a point; with states the rows of a `run` are one roll-out, whose inputs are \
linear between two rows. Exit code 1 if there are rows that cannot be computed.")]
    Predict(PredictArgs),
    /// Simulate a system with a component's source and with a surrogate in its place
    #[command(after_help = "Examples:
  metafmu swap crane.ssp --component crane --with out/crane/crane.fmu --plot crane.svg
  metafmu swap system/SystemStructure.ssd --component plant --with surrogate.fmu --step-size 0.01 --json

SYSTEM is an SSP archive, or a SystemStructure.ssd beside its FMUs (SSP 1.0). The surrogate's connectors and parameters are those of the \
component by their names; parameters have the values that the system sets, else the source's start values, and `NAME_start` takes \
that of the source's variable NAME. Inputs and parameters that the source lacks are an error unless --default gives their values. All \
start values are printed with their origin. The table has the difference of each output of the system, or of the component if the system has \
none, and the time of a step.")]
    Swap(SwapArgs),
    /// Print a script with which a shell completes this command
    #[command(after_help = "Examples:
  metafmu completions bash > ~/.local/share/bash-completion/completions/metafmu    # with the package bash-completion
  metafmu completions zsh > ~/.zfunc/_metafmu    # with `fpath+=~/.zfunc` before `compinit` in ~/.zshrc
  metafmu completions fish > ~/.config/fish/completions/metafmu.fish
  metafmu completions powershell >> $PROFILE

They take effect in the next shell.")]
    Completions(CompletionsArgs),
    /// Write the man pages of this command and of its verbs
    #[command(hide = true, after_help = "Example:\n  metafmu man ~/.local/share/man/man1")]
    Man(ManArgs),
    /// Run an FMU for another process of this program
    #[command(name = worker::ARGUMENT, hide = true)]
    FmuWorker,
}

#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true)))]
pub struct NewArgs {
    /// Name of the study, in a folder or not; the file is NAME.toml, which may be given as well
    pub name: String,
    /// Built-in system to sample
    #[arg(long, value_parser = PossibleValuesParser::new(SYSTEMS.iter().map(|system| system.name)))]
    #[arg(group = "source")]
    pub system: Option<String>,
    /// Mechanism to start from: writes it to NAME-mechanism.toml, too
    #[arg(long, value_parser = PossibleValuesParser::new(templates()), group = "source")]
    pub template: Option<String>,
    /// Mechanism file to sample
    #[arg(long, value_name = "FILE.toml", group = "source")]
    pub mechanism: Option<PathBuf>,
    /// Structure of the surrogate [default: response; static for a table without a time]
    #[arg(long, value_name = "STRUCTURE")]
    #[arg(value_parser = structures())]
    pub structure: Option<StudyStructure>,
    /// FMU to sample: FMI 2.0 or 3.0, of any tool
    #[arg(long, value_name = "FILE.fmu", group = "source")]
    pub fmu: Option<PathBuf>,
    /// Program to sample, with its arguments: the last option. It answers requests in lines of JSON; docs/command-sources.md
    #[arg(long, value_name = "PROGRAM", num_args = 1.., allow_hyphen_values = true, group = "source")]
    pub command: Vec<String>,
    /// Table of recorded runs, with a row for each time of each run, or of rows without a time: CSV or Parquet
    #[arg(long, value_name = "FILE", group = "source")]
    pub table: Option<PathBuf>,
    /// Column of the table that is the time [default: `time`, `t`, `Zeit` or the like]
    #[arg(long, value_name = "COLUMN", conflicts_with_all = ["system", "template", "mechanism", "fmu", "command"])]
    pub time: Option<String>,
    /// Column of the table that identifies the runs [default: `run`, else one that numbers them, else the time, which restarts with each run]
    #[arg(long, value_name = "COLUMN", conflicts_with_all = ["system", "template", "mechanism", "fmu", "command"])]
    pub run: Option<String>,
    /// Columns of the table that drive the runs, with --structure discrete [default: those called `u`, `input`, `force` or the like] or dynamics;
    /// of a table without a time those that the others follow from
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', conflicts_with_all = ["system", "template", "mechanism", "fmu", "command"])]
    pub inputs: Vec<String>,
    /// Columns of a table without a time that follow from the others [default: those that are called `y`, `output`, `result` or the like, else the
    /// last one]
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', conflicts_with_all = ["system", "template", "mechanism", "fmu", "command"])]
    pub outputs: Vec<String>,
    /// Write study.schema.json beside the study, with --template also mechanism.schema.json: editors complete and check the files
    #[arg(long)]
    pub schema: bool,
}

fn templates() -> impl Iterator<Item = PossibleValue> {
    TEMPLATES.iter().map(|template| PossibleValue::new(template.name).help(template.about))
}

fn structures() -> impl TypedValueParser<Value = StudyStructure> {
    let names = [
        PossibleValue::new("response").help("Plays back runs: outputs are functions of parameters and time"),
        PossibleValue::new("dynamics")
            .help("Has states and inputs: of a system or mechanism, an FMU for model exchange, or a table of motions"),
        PossibleValue::new("discrete").help("Is discrete-time, driven by inputs of an FMU or by columns of a table"),
        PossibleValue::new("static").help("Has no time: outputs follow from inputs alone, as in the rows of a table"),
    ];
    PossibleValuesParser::new(names).map(|name| StudyStructure::named(&name).unwrap_or_default())
}

#[derive(Debug, Args)]
#[command(group(ArgGroup::new("what").required(true)))]
pub struct ImportArgs {
    /// Trained model: an ONNX file, or tensors by name in an .npz or .safetensors file
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Interface file, which describes the model's columns
    #[arg(long, value_name = "FILE.toml", group = "what")]
    pub interface: Option<PathBuf>,
    /// Write an interface file to begin with, and nothing else
    #[arg(long, value_name = "FILE.toml", group = "what", conflicts_with_all = ["check", "tolerance", "out", "json"])]
    pub new: Option<PathBuf>,
    /// Table of training data, CSV or Parquet, with a column for each input: its ranges count where the interface has
    /// none, and the domain of validity is the region of its rows
    #[arg(long, value_name = "TABLE")]
    pub data: Option<PathBuf>,
    /// Table of inputs and of the outputs that the model gave for them
    #[arg(long, value_name = "TABLE")]
    pub check: Option<PathBuf>,
    /// How far outputs may be from those of --check, relative to their range there [default: 1e-5 of a model in single precision, 1e-9 of
    /// one in double]
    #[arg(long, value_name = "SHARE", requires = "check", value_parser = share)]
    pub tolerance: Option<f64>,
    /// Model file [default: NAME.safetensors, NAME being the interface's]
    #[arg(long, value_name = "FILE.safetensors")]
    pub out: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SchemaArgs {
    /// Kind of file
    #[arg(value_name = "FILE")]
    pub file: SchemaOf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SchemaOf {
    /// A study: the source of the runs, their sampling, and the surrogate
    Study,
    /// A mechanism: bodies, joints, springs, forces and drivers
    Mechanism,
    /// The interface of a third-party model
    Interface,
}

#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// Shell that is to complete
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for the pages; it is made
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

#[derive(Debug, Args)]
pub struct StudyArgs {
    /// Study file
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Folder of the results [default: out/NAME, NAME being the study's name]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print results as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SampleArgs {
    #[command(flatten)]
    pub study: StudyArgs,
    /// Print the parameters of every run as CSV instead, and write nothing
    #[arg(long, conflicts_with = "json")]
    pub dry_run: bool,
    /// Simulate only one part of all runs, for instance 3/8, and write it to DIR/shard-3-of-8.bin
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
    /// Put the shards in DIR together, or those given, and write the tables of the runs
    #[arg(long, value_name = "FILE", num_args = 0.., conflicts_with_all = ["shard", "dry_run"])]
    pub merge: Option<Vec<PathBuf>>,
}

#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Study file of a static map; its table need not exist, if all inputs have `min` and `max`
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Number of points
    #[arg(long, value_name = "N")]
    pub points: usize,
    /// CSV file to write [default: stdout]
    #[arg(long, value_name = "FILE.csv", value_hint = ValueHint::FilePath)]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct SearchArgs {
    #[command(flatten)]
    pub study: StudyArgs,
    /// Keep the trials that a stopped search has finished, and continue from the checkpoints of the others
    #[arg(long)]
    pub resume: bool,
}

#[derive(Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    pub study: StudyArgs,
    /// Fit only this model; may be given several times [default: the study's, else all]
    #[arg(long, value_name = "MODEL")]
    pub model: Vec<BaselineKind>,
}

#[derive(Debug, Args)]
pub struct TrainArgs {
    #[command(flatten)]
    pub study: StudyArgs,
    /// Continue from the checkpoint of a training that was stopped; the result is the same to the last bit
    #[arg(long)]
    pub resume: bool,
}

#[derive(Debug, Args)]
pub struct BuildArgs {
    #[command(flatten)]
    pub export: ExportArgs,
    /// Keep what a stopped build of the same study has finished, and continue from its checkpoint
    #[arg(long)]
    pub resume: bool,
}

#[derive(Debug, Args)]
pub struct ReportArgs {
    #[command(flatten)]
    pub study: StudyArgs,
    /// Folder for the plots as SVG files
    #[arg(long, value_name = "DIR")]
    pub plots: Option<PathBuf>,
    /// Study file of another surrogate that is shown beside this one
    #[arg(long, value_name = "STUDY")]
    pub beside: Option<PathBuf>,
    /// Folder of the other study's results [default: out/NAME, NAME being its name]
    #[arg(long, value_name = "DIR", requires = "beside")]
    pub beside_out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ExportModelArgs {
    #[command(flatten)]
    pub export: ExportArgs,
    /// Fit this baseline and package it instead of the network, as NAME-MODEL.fmu; `metafmu compare` compares them
    #[arg(long, value_name = "MODEL")]
    pub model: Option<BaselineKind>,
    /// Write the surrogate as an ONNX model instead, of one input `inputs` and one output `outputs`
    #[arg(long, value_name = "FILE.onnx", conflicts_with_all = ["model", "fmi", "platform", "binary", "sources"])]
    pub onnx: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    #[command(flatten)]
    pub study: StudyArgs,
    /// Version of FMI: 2.0 is NAME.fmu, 3.0 is NAME-fmi3.fmu [default: the study's, else 2]
    #[arg(long, value_name = "VERSION")]
    pub fmi: Option<FmiArg>,
    #[arg(long, value_name = "TUPLE,...", value_delimiter = ',', help = platforms())]
    pub platform: Vec<String>,
    /// Adds the library for a platform; may be given several times
    #[arg(long, value_name = "TUPLE=FILE", value_parser = tuple_and_file)]
    pub binary: Vec<(String, PathBuf)>,
    /// Adds the surrogate as portable C99 source code, for targets without a binary
    #[arg(long)]
    pub sources: bool,
    /// Variables of the FMU [default: the study's, else study]
    #[arg(long, value_name = "WHICH")]
    pub interface: Option<FmuInterfaceArg>,
    /// Additions of metafmu as inputs and outputs that hosts can wire; may be several, with commas
    #[arg(long, value_name = "PORT,...", value_delimiter = ',')]
    pub ports: Option<Vec<FmuPortArg>>,
    /// Names of the variables [default: the study's, else study]
    #[arg(long, value_name = "STYLE")]
    pub names: Option<NameStyleArg>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FmuInterfaceArg {
    /// The study's; beside them `domain_policy`, and `in_domain`, `domain_distance` and error bounds as local variables
    Study,
    /// The study's alone
    Plain,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FmuPortArg {
    /// Outputs `in_domain` and `domain_distance`
    Domain,
    /// Outputs `NAME_bound`, the error bounds
    Bounds,
    /// Inputs `use_measured` and `NAME_measured` of a discrete-time FMU
    Measured,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum NameStyleArg {
    /// As in the study
    Study,
    /// Letters, digits and `_` only, for hosts that refuse dots and brackets
    Flat,
}

fn platforms() -> String {
    let embedded: Vec<String> =
        Binary::embedded().into_iter().map(|binary| binary.platform.tuple.to_string()).collect();
    format!("Platforms with a binary in the FMU [default: all that this program has, {}]", embedded.join(", "))
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FmiArg {
    #[value(name = "2")]
    V2,
    #[value(name = "3")]
    V3,
    Both,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum InterfaceArg {
    /// Co-simulation
    Cs,
    /// Model exchange: continuous states are integrated here, events are located
    Me,
}

#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// FMU to check
    #[arg(value_name = "FMU")]
    pub fmu: PathBuf,
    /// Seconds that unpacking the FMU, loading it and each of the checks that run it may take
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = duration)]
    pub time_limit: Duration,
    /// Also tell for each known host whether it will load and run the FMU, what will fail, and what to do instead
    #[arg(long)]
    pub hosts: bool,
    /// Print findings as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// FMU to run: FMI 2.0 or 3.0
    #[arg(value_name = "FMU")]
    pub fmu: PathBuf,
    /// Start value of a parameter or input; may be given several times
    #[arg(long, value_name = "NAME=VALUE", value_parser = name_and_value)]
    pub start: Vec<(String, f64)>,
    /// Table of inputs over time, CSV or Parquet: a column `time` in s, and a column for each input; continuous inputs are interpolated
    /// between its rows. In co-simulation they are set at the beginning of a step, and the outputs at its end belong to them. The FMU of a
    /// discrete-time surrogate starts from measured outputs, if there are columns of all outputs: in rows before time 0
    #[arg(long, value_name = "TABLE")]
    pub input: Option<PathBuf>,
    /// Value of an input without a column in the file of --input: its start value, or VALUE; may be given several times
    #[arg(long, value_name = "NAME[=VALUE]", value_parser = DefaultValue::parse, requires = "input")]
    pub default: Vec<DefaultValue>,
    /// Interface to run it by [default: cs if the FMU offers it]
    #[arg(long)]
    pub interface: Option<InterfaceArg>,
    /// First communication point in seconds [default: the first measured row, else the FMU's, else 0]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub start_time: Option<f64>,
    /// Last communication point in seconds [default: the FMU's]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub stop_time: Option<f64>,
    /// Communication step size in seconds [default: the FMU's, else a 500th of the run]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub step_size: Option<f64>,
    /// Model exchange: tolerance of a step, relative to each state and to its nominal value [default: the FMU's, else 1e-8]
    #[arg(long, value_name = "TOLERANCE", value_parser = tolerance)]
    pub tolerance: Option<f64>,
    /// Seconds that the simulation may take [default: any]
    #[arg(long, value_name = "SECONDS", value_parser = duration)]
    pub time_limit: Option<Duration>,
    /// CSV file to write [default: stdout, unless there is a plot]
    #[arg(long, value_name = "FILE.csv")]
    pub output: Option<PathBuf>,
    /// Plot over time of every output that changes
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file, value_hint = ValueHint::FilePath)]
    pub plot: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct PredictArgs {
    /// Surrogate: an FMU made by metafmu, a model file NAME.safetensors, or a study whose model is in out/NAME
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Table with the inputs: CSV or Parquet
    #[arg(value_name = "TABLE")]
    pub table: PathBuf,
    /// File to write: Parquet if it ends in .parquet, else CSV [default: CSV on stdout]
    #[arg(long, value_name = "FILE", value_parser = table_file, value_hint = ValueHint::FilePath)]
    pub out: Option<(PathBuf, Format)>,
    /// Value of a parameter, input or NAME_start without a column: its start value, or VALUE; may be given several times
    #[arg(long, value_name = "NAME[=VALUE]", value_parser = DefaultValue::parse)]
    pub default: Vec<DefaultValue>,
    /// Outputs to compute [default: all]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub outputs: Vec<String>,
    /// Print a summary as JSON
    #[arg(long, requires = "out")]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SwapArgs {
    /// System: an SSP archive, or a SystemStructure.ssd
    #[arg(value_name = "SYSTEM")]
    pub system: PathBuf,
    /// Component that is replaced
    #[arg(long, value_name = "NAME")]
    pub component: String,
    /// FMU that replaces it
    #[arg(long, value_name = "SURROGATE.fmu")]
    pub with: PathBuf,
    /// Value of an input or parameter of the surrogate that the source lacks: its start value, or VALUE; may be given several times
    #[arg(long, value_name = "NAME[=VALUE]", value_parser = DefaultValue::parse)]
    pub default: Vec<DefaultValue>,
    /// First communication point in seconds [default: the system's, else 0]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub start_time: Option<f64>,
    /// Last communication point in seconds [default: the system's, else the surrogate's]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub stop_time: Option<f64>,
    /// Communication step size in seconds [default: the surrogate's, else the source's]
    #[arg(long, alias = "step", value_name = "SECONDS", allow_negative_numbers = true)]
    pub step_size: Option<f64>,
    /// Model exchange and mechanisms: tolerance of a step, relative to each state and to its nominal value [default: each FMU's, else 1e-8]
    #[arg(long, value_name = "TOLERANCE", value_parser = tolerance)]
    pub tolerance: Option<f64>,
    /// Seconds that each of the two simulations may take [default: any]
    #[arg(long, value_name = "SECONDS", value_parser = duration)]
    pub time_limit: Option<Duration>,
    /// Plot over time of every output in both simulations
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file, value_hint = ValueHint::FilePath)]
    pub plot: Option<PathBuf>,
    /// Print the comparison as JSON
    #[arg(long)]
    pub json: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definitions_are_consistent() {
        Cli::command().debug_assert();
    }
}
