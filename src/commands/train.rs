//! `metafmu train`: trains the network on the sampled runs and writes the surrogate.

use super::{CommandOutcome, conclude, print, print_json, project};
use crate::cli::TrainArgs;
use metafmu::{
    Result,
    evaluation::Verdict,
    pipeline::{record::TrainingRecord, rounds, static_map, train},
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
    let (record, verdict) = if project.study.is_static() {
        project.prepare_folder()?;
        let (_, record, verdict) = static_map::fit(&project, args.resume)?;
        (record, verdict)
    } else {
        let (train, calibration) = (project.load_table("train")?, project.load_table("calibration")?);
        project.prepare_folder()?;
        let (surrogate, record) = rounds::stage(&project, &train, &calibration, args.resume)?;
        let verdict = train::judge(&project, &train, &surrogate, &record);
        (record, verdict)
    };
    if args.study.json {
        print_json(&Printed { record: &record, verdict: &verdict })?;
    } else {
        let beside = if project.study.is_static() { project.unseen() } else { project.history() };
        print(&format!("{}\n{}\n", project.model().display(), beside.display()))?;
    }
    let outcome = conclude(&verdict, args.study.json)?;
    Ok(if record.was_interrupted() { CommandOutcome::Interrupted } else { outcome })
}
