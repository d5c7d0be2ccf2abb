//! `metafmu build`: the whole way from a study to a validated FMU.

use super::{CommandOutcome, conclude, interrupt, print, print_json, project};
use crate::cli::BuildArgs;
use metafmu::{
    Result,
    pipeline::{Built, Project, build, evaluate, export::ExportPlan},
};

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
    let files = built.files(project);
    let width = files.iter().map(|file| file.path.display().to_string().len()).max().unwrap_or(0);
    files.iter().map(|file| format!("{:<width$}  {}\n", file.path.display().to_string(), file.content)).collect()
}
