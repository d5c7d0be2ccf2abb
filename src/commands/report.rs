//! `metafmu report`: the surrogate and the truth on one page.

use super::{CommandOutcome, print, print_json, project};
use crate::cli::ReportArgs;
use metafmu::{
    Result,
    pipeline::report::{BesideStudy, report},
};

pub fn run(args: &ReportArgs) -> Result<CommandOutcome> {
    let project = project(&args.study)?;
    let beside = args.beside.as_ref().map(|study| BesideStudy { study, folder: args.beside_out.as_deref() });
    let written = report(&project, beside, args.plots.as_deref())?;
    if args.study.json {
        print_json(&written)?;
    } else {
        print(&format!("{}\n", written.report.display()))?;
    }
    Ok(CommandOutcome::Fine)
}
