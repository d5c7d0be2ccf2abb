//! One file a verb. The only code that prints.

pub mod build;
pub mod compare;
pub mod completions;
pub mod evaluate;
pub mod export;
pub mod import;
mod interrupt;
pub mod man;
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
use clap::Parser;
use metafmu::{Error, Result, evaluation::Verdict, export::serve_worker, pipeline, pipeline::Project};
use std::{
    borrow::Cow,
    ffi::OsString,
    fmt::Display,
    io::{ErrorKind, Write},
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
    let command = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli.command,
        Err(error) => {
            // help is one of these errors
            let _ = error.print();
            let code = error.exit_code() as u8;
            if json && error.use_stderr() {
                print_problems(error.to_string().trim_end(), code);
            }
            return code;
        }
    };
    match run(command) {
        Ok(CommandOutcome::Fine) => 0,
        Ok(CommandOutcome::ProblemsFound) => 1,
        Ok(CommandOutcome::Interrupted) => 130,
        Err(error) => {
            terminal::end();
            for line in error.to_string().lines() {
                say(format_args!("error: {line}"));
            }
            let code = if matches!(error, Error::Interrupted) { 130 } else { 2 };
            if json {
                print_problems(&error.to_string(), code);
            }
            code
        }
    }
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
    /// Ctrl-C shortened the training; the results are those of the best network so far.
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
        print(&verdict.text())?;
    }
    Ok(if verdict.accepted { CommandOutcome::Fine } else { CommandOutcome::ProblemsFound })
}

/// Prints to stdout; a reader that has seen enough (`| head`) is not an error, a stdout that is closed (`>&-`) is one.
fn print(text: &str) -> Result<()> {
    match write(visible(text).as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::io(Path::new("stdout"), "write")(error)),
        _ => Ok(()),
    }
}

/// Writes to stdout.
fn write(bytes: &[u8]) -> std::io::Result<()> {
    if stdout::was_closed() {
        return Err(std::io::Error::other("it is closed"));
    }
    let mut stdout = std::io::stdout();
    stdout.write_all(bytes)?;
    stdout.flush()
}

/// Prints a line of progress, a warning or an error to stderr. A closed stderr (`2>&1 | head`) does not stop the program.
pub fn say(line: impl Display) {
    let _ = writeln!(std::io::stderr(), "{}", visible(&line.to_string()));
}

/// Prints a line of an FMU.
fn heard(line: &str) {
    say(line);
}

/// Text of third-party names and messages that is safe for a terminal: control characters are escaped as in JSON,
/// except line breaks and tabs.
fn visible(text: &str) -> Cow<'_, str> {
    let hidden = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if !text.contains(hidden) {
        return text.into();
    }
    let mut visible = String::with_capacity(text.len());
    for c in text.chars() {
        if hidden(c) {
            visible.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            visible.push(c);
        }
    }
    visible.into()
}

/// Prints a value as indented JSON.
fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(std::io::Error::from);
    print(&(text.map_err(Error::io(Path::new("stdout"), "write"))? + "\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_of_others_are_shown_and_not_sent_to_the_terminal() {
        assert_eq!(
            visible("a \u{1b}[2J\u{9b}31m\r\u{7}b\n\tc\u{7f} é"),
            "a \\u001b[2J\\u009b31m\\u000d\\u0007b\n\tc\\u007f é"
        );
        assert!(matches!(visible("one\ntwo\tthree"), Cow::Borrowed(_)));
    }
}
