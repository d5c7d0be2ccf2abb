//! `metafmu validate`: lists every problem of an FMU.

use super::{Outcome, print, print_json};
use crate::cli::ValidateArgs;
use metafmu::{Result, fmu::validate};

pub fn run(args: &ValidateArgs) -> Result<Outcome> {
    let report = validate(&args.fmu)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.to_string())?;
    }
    Ok(if report.problems.is_empty() { Outcome::Fine } else { Outcome::ProblemsFound })
}
