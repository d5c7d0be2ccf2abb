//! `metafmu completions`: prints a script with which a shell completes this command.

use super::{CommandOutcome, print};
use crate::cli::{Cli, CompletionsArgs};
use clap::{Command, CommandFactory};
use metafmu::Result;

pub fn run(args: &CompletionsArgs) -> Result<CommandOutcome> {
    let mut script = Vec::new();
    // some shells would offer hidden verbs, too
    let verbs = Cli::command().get_subcommands().filter(|verb| !verb.is_hide_set()).cloned().collect::<Vec<_>>();
    let mut command = Command::new("metafmu").version(env!("CARGO_PKG_VERSION")).subcommands(verbs);
    clap_complete::generate(args.shell, &mut command, "metafmu", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(CommandOutcome::Fine)
}
