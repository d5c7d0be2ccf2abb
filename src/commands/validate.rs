//! `metafmu validate`: lists every problem of an FMU.

use super::{CommandOutcome, heard, print, print_json, terminal::workers};
use crate::cli::ValidateArgs;
use metafmu::{Result, export::validate_apart, fmi::Watch};

pub fn run(args: &ValidateArgs) -> Result<CommandOutcome> {
    let watch = Watch { workers: workers()?, limit: Some(args.time_limit), heard };
    let report = validate_apart(&args.fmu, watch)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.to_string())?;
    }
    Ok(match report.problems.is_empty() {
        false => CommandOutcome::ProblemsFound,
        true if report.was_run => CommandOutcome::Fine,
        true => CommandOutcome::NotRun,
    })
}
