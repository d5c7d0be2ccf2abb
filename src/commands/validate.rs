//! `metafmu validate`: lists every problem of an FMU, and what hosts will do with it.

use super::{CommandOutcome, heard, print, print_json, terminal::workers};
use crate::cli::ValidateArgs;
use metafmu::{
    Result,
    export::validate_apart,
    fmi::{
        Report, Watch,
        hosts::{HostOutlook, outlooks},
    },
};
use serde::Serialize;

/// Output as JSON.
#[derive(Serialize)]
struct Validated<'a> {
    #[serde(flatten)]
    report: &'a Report,
    #[serde(skip_serializing_if = "Option::is_none")]
    hosts: Option<Vec<HostOutlook>>,
}

pub fn run(args: &ValidateArgs) -> Result<CommandOutcome> {
    let watch = Watch { workers: workers()?, limit: Some(args.time_limit), heard };
    let report = validate_apart(&args.fmu, watch)?;
    let hosts = if args.hosts { Some(outlooks(&args.fmu, watch)?) } else { None };
    if args.json {
        print_json(&Validated { report: &report, hosts })?;
    } else {
        print(&report.to_string())?;
        hosts.iter().flatten().try_for_each(|host| print(&format!("{host}\n")))?;
    }
    Ok(match report.problems.is_empty() {
        false => CommandOutcome::ProblemsFound,
        true if report.was_run => CommandOutcome::Fine,
        true => CommandOutcome::NotRun,
    })
}
