//! `metafmu validate`: lists every problem of an FMU.

use super::{Outcome, heard, interrupt, print, print_json};
use crate::cli::ValidateArgs;
use metafmu::{
    Result,
    fmu::{Watch, validate_apart},
};

pub fn run(args: &ValidateArgs) -> Result<Outcome> {
    let watch = Watch { limit: Some(args.time_limit), stop: interrupt::flag(), heard };
    let report = validate_apart(&args.fmu, watch)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.to_string())?;
    }
    Ok(if report.problems.is_empty() { Outcome::Fine } else { Outcome::ProblemsFound })
}
