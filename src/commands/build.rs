//! `metafmu build`: the whole way from a study to a validated FMU.

use super::{CommandOutcome, conclude, interrupt, print, print_json, project};
use crate::cli::BuildArgs;
use metafmu::{
    Result,
    pipeline::{
        Built, Project, build, evaluate,
        export::{ExportPlan, WrittenFmu},
    },
};
use std::path::PathBuf;

pub fn run(args: &BuildArgs) -> Result<CommandOutcome> {
    let json = args.export.study.json;
    let project = project(&args.export.study)?;
    let plan = ExportPlan::new(&project, &args.export.options())?;
    interrupt::can_resume();
    let built = build(&project, &plan, args.resume)?;
    if json {
        print_json(&built.metrics)?;
    } else {
        print(&format!("\n{}\n", evaluate::table(&project, &built.metrics)))?;
        built.comparison.as_ref().map_or(Ok(()), |comparison| print(&format!("{}\n", comparison.table())))?;
        print(&files(&project, &built))?;
    }
    let outcome = conclude(&built.verdict, json)?;
    if let Some(interruption) = &built.interruption {
        interrupt::conclude(interruption);
    }
    Ok(if built.interruption.is_some() { CommandOutcome::Interrupted } else { outcome })
}

/// Paths of the results, the FMU first.
fn files(project: &Project, built: &Built) -> String {
    let fmu = |(WrittenFmu { fmu, bytes, version }, _): &(WrittenFmu, _)| {
        let interfaces = if project.study.is_discrete() { "co-simulation" } else { "co-simulation and model exchange" };
        let what = format!("FMI {version} {interfaces}, {} kB", bytes.div_ceil(1000));
        (fmu.clone(), what)
    };
    let is_static = project.study.is_static();
    let model = if is_static {
        "map of inputs to outputs"
    } else if project.study.is_compliant() {
        "potential and dissipation"
    } else if project.study.has_states() {
        "equations of motion"
    } else {
        "network, scaling"
    };
    let others = [
        (project.model(), format!("{model}, variables: opens with safetensors in Python")),
        (project.report(), "surrogate beside truth: opens in a browser".into()),
        (project.metrics(), format!("accuracy on the {}", if is_static { "unseen rows" } else { "test runs" })),
        (project.comparison(), if is_static { "kinds of model" } else { "the network beside simpler models" }.into()),
        (project.unseen(), "unseen rows and their predictions".into()),
        (project.history(), "loss of each epoch".into()),
        (project.table("train"), "training and validation runs".into()),
        (project.table("test"), "test runs".into()),
    ];
    // of a surrogate with states there are neither epochs nor baselines; of one of samples no baselines; a static map has no runs, and epochs
    // only if it is a network
    let has_epochs = built.metrics.training.epochs > 0;
    let others = others.into_iter().filter(|(path, _)| {
        let study = &project.study;
        let of_runs = *path == project.table("train") || *path == project.table("test");
        let is_of_others = if study.is_static() {
            of_runs || *path == project.history() && !has_epochs
        } else {
            *path == project.unseen()
        };
        !(is_of_others
            || (study.has_states() || study.is_compliant()) && *path == project.history()
            || (study.has_memory() || study.is_compliant()) && *path == project.comparison())
    });
    let calibration = project
        .study
        .bounds
        .filter(|_| !is_static)
        .map(|_| (project.table("calibration"), "runs for the error bounds".into()));
    let rows: Vec<(PathBuf, String)> = built.fmus.iter().map(fmu).chain(others).chain(calibration).collect();
    let width = rows.iter().map(|(path, _)| path.display().to_string().len()).max().unwrap_or(0);
    rows.iter().map(|(path, what)| format!("{:<width$}  {what}\n", path.display().to_string())).collect()
}
