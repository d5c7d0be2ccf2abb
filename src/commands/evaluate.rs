//! `metafmu evaluate`: compares the surrogate with the unseen test runs.

use super::{CommandOutcome, conclude, print, print_json, project};
use crate::cli::StudyArgs;
use metafmu::{
    Result,
    pipeline::evaluate::{evaluate, table},
};

pub fn run(args: &StudyArgs) -> Result<CommandOutcome> {
    let project = project(args)?;
    let (metrics, verdict) = evaluate(&project)?;
    if args.json {
        print_json(&metrics)?;
    } else {
        print(&format!("{}\n{}\n", table(&project, &metrics), project.metrics().display()))?;
    }
    conclude(&verdict, args.json)
}
