//! `metafmu man`: writes man pages, one for the command and one for each verb.

use super::CommandOutcome;
use crate::cli::{Cli, ManArgs};
use clap::CommandFactory;
use metafmu::{Error, Result};
use std::fs;

pub fn run(args: &ManArgs) -> Result<CommandOutcome> {
    fs::create_dir_all(&args.folder).map_err(Error::io(&args.folder, "create"))?;
    clap_mangen::generate_to(Cli::command(), &args.folder).map_err(Error::io(&args.folder, "write man pages to"))?;
    Ok(CommandOutcome::Fine)
}
