//! `metafmu search`: trains the trials of a study's `[search]` side by side and writes a table and the best study.

use super::{CommandOutcome, print, print_json, project};
use crate::cli::SearchArgs;
use metafmu::{Result, pipeline::search};

pub fn run(args: &SearchArgs) -> Result<CommandOutcome> {
    let project = project(&args.study)?;
    let found = search(&project, &args.study.study, args.resume)?;
    if args.study.json {
        print_json(&found)?;
    } else {
        print(&found.summary)?;
        print(&format!("\n{}\n{}\n", found.table.display(), found.best_study.display()))?;
    }
    Ok(if found.has_errors { CommandOutcome::ProblemsFound } else { CommandOutcome::Fine })
}
