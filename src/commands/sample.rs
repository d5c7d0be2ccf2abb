//! `metafmu sample`: simulates the training and test runs and writes their tables.

use super::{CommandOutcome, print, print_json, project};
use crate::cli::SampleArgs;
use metafmu::{Result, pipeline::sample};

pub fn run(args: &SampleArgs) -> Result<CommandOutcome> {
    let project = project(&args.study)?;
    sample::expect_runs(&project)?;
    project.describe_mechanism();
    if args.dry_run {
        print(&sample::plan_table(&project, args.shard)?)?;
        return Ok(CommandOutcome::Fine);
    }
    project.prepare_folder()?;
    if let Some(part) = args.shard {
        let record = sample::sample_shard(&project, part)?;
        if args.study.json {
            print_json(&record)?;
        } else {
            print(&format!("{}\n", record.shard.display()))?;
        }
        return Ok(CommandOutcome::Fine);
    }
    let samples = match &args.merge {
        Some(files) => sample::merge(&project, files)?,
        None => sample::stage(&project)?,
    };
    if args.study.json {
        print_json(&samples.record)?;
    } else {
        let tables = samples.sets.named().into_iter().filter(|(_, dataset)| !dataset.runs.is_empty());
        print(&tables.map(|(set, _)| format!("{}\n", project.table(set).display())).collect::<String>())?;
    }
    Ok(CommandOutcome::Fine)
}
