//! One file a verb. The only code that prints.

pub mod build;
pub mod compare;
pub mod completions;
pub mod evaluate;
pub mod export;
pub mod import;
mod interrupt;
pub mod man;
mod messages;
pub mod new;
pub mod plan;
pub mod predict;
pub mod report;
pub mod sample;
pub mod schema;
pub mod search;
pub mod simulate;
mod stdout;
pub mod swap;
pub mod terminal;
pub mod train;
pub mod validate;

use crate::cli::{Cli, Command, StudyArgs};
use clap::{ColorChoice, CommandFactory, FromArgMatches, error::ErrorKind};
use messages::{complain, graded, heard, say, visible, warn};
use metafmu::{
    Error, Result,
    evaluation::Verdict,
    export::{Binary, serve_worker},
    pipeline,
    pipeline::Project,
};
use rayon::ThreadPoolBuilder;
use std::{
    ffi::OsString,
    io::{self, Write},
    path::Path,
};

/// The `metafmu` command: parses and executes the arguments, the first of which is the program's name, and returns the
/// exit code. Errors are on stderr. Worker processes run `program`, with other arguments; by default it is this
/// process's executable.
pub fn command(arguments: impl IntoIterator<Item = OsString>, program: Option<&Path>) -> u8 {
    if let Some(program) = program {
        terminal::set_program(program);
    }
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let json = arguments.iter().any(|argument| argument == "--json");
    let parsed = Cli::command().color(color_of(&arguments)).try_get_matches_from(&arguments);
    let Cli { global, command } = match parsed.and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        // help and version are two of these errors
        Err(error) if error.kind() == ErrorKind::DisplayVersion && is_verbose(&arguments) => {
            return u8::from(print(&version()).is_err()) * 2;
        }
        Err(error) => {
            let _ = error.print();
            let code = error.exit_code() as u8;
            if json && error.use_stderr() {
                print_problems(error.to_string().trim_end(), code);
            }
            return code;
        }
    };
    messages::set(global);
    interrupt::set_arguments(&arguments);
    let threads = global.threads.map(|threads| ThreadPoolBuilder::new().num_threads(threads.into()).build_global());
    if let Some(Err(reason)) = threads {
        complain(format_args!("--threads: {reason}"));
        return 2;
    }
    match run(command) {
        Ok(CommandOutcome::Fine) => 0,
        Ok(CommandOutcome::ProblemsFound) => 1,
        Ok(CommandOutcome::NotRun) => 3,
        Ok(CommandOutcome::Interrupted) => 130,
        Err(error) => {
            terminal::end();
            let code = if matches!(error, Error::Interrupted | Error::Unfinished { .. }) { 130 } else { 2 };
            match &error {
                Error::Unfinished { interruption } => interrupt::conclude(interruption),
                error => complain(error),
            }
            if json {
                print_problems(&error.to_string(), code);
            }
            code
        }
    }
}

/// The color that the arguments ask for; a wrong one is refused later.
fn color_of(arguments: &[OsString]) -> ColorChoice {
    let texts: Vec<&str> = arguments.iter().filter_map(|argument| argument.to_str()).collect();
    let apart = texts.windows(2).find(|pair| pair[0] == "--color").map(|pair| pair[1]);
    let joined = texts.iter().find_map(|argument| argument.strip_prefix("--color="));
    apart.or(joined).and_then(|choice| choice.parse().ok()).unwrap_or(ColorChoice::Auto)
}

fn is_verbose(arguments: &[OsString]) -> bool {
    arguments.iter().any(|argument| argument == "--verbose" || argument == "-v")
}

/// Version, platforms of the embedded libraries, threads: what a report of a problem needs.
fn version() -> String {
    let platforms: Vec<String> = Binary::embedded().into_iter().map(|binary| binary.platform.tuple.into()).collect();
    format!(
        "metafmu {}\nFMUs for: {}\nthis program: {}-{}, {} threads\nFMI: 2.0, 3.0\n",
        env!("CARGO_PKG_VERSION"),
        platforms.join(", "),
        std::env::consts::ARCH,
        std::env::consts::OS,
        rayon::current_num_threads(),
    )
}

/// Prints the problems on stderr to stdout as well, where a reader of JSON expects an object.
fn print_problems(text: &str, exit_code: u8) {
    let problems: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    // the exit code says that something is wrong, also if nothing can be printed
    let _ = print_json(&serde_json::json!({ "problems": problems, "exit_code": exit_code }));
}

fn run(command: Command) -> Result<CommandOutcome> {
    match command {
        Command::New(args) => new::run(&args),
        Command::Build(args) => build::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Search(args) => search::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::FitBaseline => pipeline::compare::work().map(|()| CommandOutcome::Fine),
        Command::Report(args) => report::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Schema(args) => schema::run(&args),
        Command::Validate(args) => validate::run(&args),
        Command::Predict(args) => predict::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Swap(args) => swap::run(&args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
        Command::FmuWorker => serve_worker().map(|()| CommandOutcome::Fine),
    }
}

/// Outcome of a command that did its work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandOutcome {
    /// No problem.
    Fine,
    /// The command worked and found problems.
    ProblemsFound,
    /// `validate` found no problem, and could not run the FMU.
    NotRun,
    /// Ctrl-C shortened the training or the comparison; the results are those of the best network so far.
    Interrupted,
}

/// The project of a study file and its folder of results.
fn project(args: &StudyArgs) -> Result<Project<'static>> {
    Project::open(&args.study, args.out.as_deref(), terminal::control()?)
}

/// Last lines and exit code of a command that has made or measured a surrogate.
fn conclude(verdict: &Verdict, json: bool) -> Result<CommandOutcome> {
    if json {
        verdict.text().lines().for_each(say);
    } else {
        print_styled(&graded(verdict))?;
    }
    Ok(if verdict.accepted { CommandOutcome::Fine } else { CommandOutcome::ProblemsFound })
}

/// Prints to stdout; a reader that has seen enough (`| head`) is not an error, a stdout that is closed (`>&-`) is one.
fn print(text: &str) -> Result<()> {
    print_styled(&visible(text))
}

/// Prints a text whose control characters are ours.
fn print_styled(text: &str) -> Result<()> {
    match write(text.as_bytes()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Error::io(Path::new("stdout"), "write")(error)),
        _ => Ok(()),
    }
}

/// Writes to stdout.
fn write(bytes: &[u8]) -> io::Result<()> {
    if stdout::was_closed() {
        return Err(io::Error::other("it is closed"));
    }
    let mut stdout = io::stdout();
    stdout.write_all(bytes)?;
    stdout.flush()
}

/// Prints a value as indented JSON.
fn print_json(value: &impl serde::Serialize) -> Result<()> {
    print(&json_text(value)?)
}

/// Indented JSON with a line break at its end.
fn json_text(value: &impl serde::Serialize) -> Result<String> {
    let text = serde_json::to_string_pretty(value).map_err(io::Error::from);
    Ok(text.map_err(Error::io(Path::new("stdout"), "write"))? + "\n")
}
