//! `metafmu train`: trains the network on the sampled runs and writes the surrogate.

use super::{CommandOutcome, conclude, print, print_json, project};
use crate::cli::TrainArgs;
use metafmu::{
    Result,
    evaluation::Verdict,
    pipeline::{
        record::TrainingRecord,
        train::{TrainingResult, train},
    },
};
use serde::Serialize;

/// Result of a training as printed in JSON.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    record: &'a TrainingRecord,
    verdict: &'a Verdict,
}

pub fn run(args: &TrainArgs) -> Result<CommandOutcome> {
    let project = project(&args.study)?;
    let TrainingResult { record, verdict, files } = train(&project, args.resume)?;
    if args.study.json {
        print_json(&Printed { record: &record, verdict: &verdict })?;
    } else {
        files.iter().try_for_each(|file| print(&format!("{}\n", file.display())))?;
    }
    let outcome = conclude(&verdict, args.study.json)?;
    Ok(if record.was_interrupted() { CommandOutcome::Interrupted } else { outcome })
}
