//! The `metafmu` command: parse, dispatch, print the error, exit code.

// both panic where nobody listens; `commands` has one function for each
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod cli;
mod commands;

use clap::Parser;
use cli::Command;
use metafmu::{export, pipeline};
use std::process::ExitCode;

fn main() -> ExitCode {
    let result = match cli::Cli::parse().command {
        Command::New(args) => commands::new::run(&args),
        Command::Build(args) => commands::build::run(&args),
        Command::Sample(args) => commands::sample::run(&args),
        Command::Train(args) => commands::train::run(&args),
        Command::Search(args) => commands::search::run(&args),
        Command::Evaluate(args) => commands::evaluate::run(&args),
        Command::Compare(args) => commands::compare::run(&args),
        Command::FitBaseline => pipeline::compare::work().map(|()| commands::Outcome::Fine),
        Command::Report(args) => commands::report::run(&args),
        Command::Export(args) => commands::export::run(&args),
        Command::Import(args) => commands::import::run(&args),
        Command::Schema(args) => commands::schema::run(&args),
        Command::Validate(args) => commands::validate::run(&args),
        Command::Predict(args) => commands::predict::run(&args),
        Command::Simulate(args) => commands::simulate::run(&args),
        Command::Swap(args) => commands::swap::run(&args),
        Command::FmuWorker => export::serve_worker().map(|()| commands::Outcome::Fine),
    };
    match result {
        Ok(commands::Outcome::Fine) => ExitCode::SUCCESS,
        Ok(commands::Outcome::ProblemsFound) => ExitCode::from(1),
        Ok(commands::Outcome::Interrupted) => ExitCode::from(130),
        Err(error) => {
            commands::terminal::end();
            for line in error.to_string().lines() {
                commands::say(format_args!("error: {line}"));
            }
            ExitCode::from(if matches!(error, metafmu::Error::Interrupted) { 130 } else { 2 })
        }
    }
}
