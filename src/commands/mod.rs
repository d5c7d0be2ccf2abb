//! One file a verb. The only code that prints.

pub mod build;
pub mod compare;
pub mod evaluate;
pub mod export;
mod improve;
mod instants;
mod interrupt;
mod job;
pub mod new;
mod prepare;
mod progress;
pub mod report;
pub mod sample;
pub mod search;
mod side_by_side;
pub mod simulate;
mod stdout;
pub mod train;
pub mod validate;

use metafmu::{Error, Result};
use std::{
    fmt::Display,
    io::{ErrorKind, Write},
    path::Path,
};

/// How a command that did its work ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing to complain about.
    Fine,
    /// The command worked and found problems.
    ProblemsFound,
    /// Ctrl-C shortened the training; everything was made of the best network so far.
    Interrupted,
}

/// Prints to stdout; a reader that has seen enough (`| head`) is no error, a stdout that is closed (`>&-`) is one.
fn print(text: &str) -> Result<()> {
    let write = || {
        if stdout::was_closed() {
            return Err(std::io::Error::other("it is closed"));
        }
        let mut stdout = std::io::stdout();
        stdout.write_all(text.as_bytes())?;
        stdout.flush()
    };
    match write() {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::io(Path::new("stdout"), "write")(error)),
        _ => Ok(()),
    }
}

/// Prints a line of progress, a warning or an error to stderr. Nobody reading it any more (`2>&1 | head`) is no reason to stop.
pub fn say(line: impl Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Prints a value as indented JSON.
fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(std::io::Error::from);
    print(&(text.map_err(Error::io(Path::new("stdout"), "write"))? + "\n"))
}
