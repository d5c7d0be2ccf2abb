//! `metafmu export`: packages the surrogate as an FMU.

use super::{Outcome, print, print_json, project};
use crate::cli::{ExportArgs, ExportModelArgs, FmiArg};
use metafmu::{
    Result,
    pipeline::export::{ExportOptions, Plan, export_baseline, export_network},
    study::FmiChoice,
};

pub fn run(args: &ExportModelArgs) -> Result<Outcome> {
    let project = project(&args.export.study)?;
    let plan = Plan::new(&project, &args.export.options())?;
    let written = match args.model {
        None => export_network(&project, &plan)?,
        Some(kind) => export_baseline(&project, &plan, kind)?,
    };
    match written.as_slice() {
        [one] if args.export.study.json => print_json(one)?,
        all if args.export.study.json => print_json(&all)?,
        all => all.iter().try_for_each(|written| print(&format!("{}\n", written.fmu.display())))?,
    }
    Ok(Outcome::Fine)
}

impl ExportArgs {
    pub fn options(&self) -> ExportOptions {
        let fmi = self.fmi.map(|fmi| match fmi {
            FmiArg::V2 => FmiChoice::V2,
            FmiArg::V3 => FmiChoice::V3,
            FmiArg::Both => FmiChoice::Both,
        });
        ExportOptions { fmi, platforms: self.platform.clone(), binaries: self.binary.clone(), sources: self.sources }
    }
}
