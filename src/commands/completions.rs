//! `metafmu completions`: prints a script with which a shell completes this command.

use super::{Outcome, print};
use crate::cli::{Cli, CompletionsArgs};
use clap::CommandFactory;
use metafmu::Result;

pub fn run(args: &CompletionsArgs) -> Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "metafmu", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Fine)
}
