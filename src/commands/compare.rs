//! `metafmu compare`: the network beside simpler models.

use super::{CommandOutcome, print, print_json, project};
use crate::cli::CompareArgs;
use metafmu::{
    Error, Result,
    pipeline::compare::{compare, refuse_others},
};

pub fn run(args: &CompareArgs) -> Result<CommandOutcome> {
    let project = project(&args.study)?;
    refuse_others(&project)?;
    let (train, test) = (project.load_table("train")?, project.load_table("test")?);
    project.prepare_folder()?;
    let kinds = if args.model.is_empty() { &project.study.baselines.models } else { &args.model };
    let comparison = compare(&project, kinds, &train, &test)?;
    if args.study.json {
        print_json(&comparison)?;
    } else {
        let (json, csv) = (project.comparison(), project.comparison_table());
        print(&format!("{}\n{}\n{}\n", comparison.table(), json.display(), csv.display()))?;
    }
    if comparison.was_interrupted() { Err(Error::Interrupted) } else { Ok(CommandOutcome::Fine) }
}
