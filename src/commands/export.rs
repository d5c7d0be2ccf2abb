//! `metafmu export`: packages the surrogate as an FMU.

use super::{CommandOutcome, print, print_json, project};
use crate::cli::{ExportArgs, ExportModelArgs, FmiArg, FmuInterfaceArg, FmuPortArg, NameStyleArg};
use metafmu::{
    Error, Result,
    pipeline::{
        export::{ExportPlan, ExportRequest, WrittenFmu, export_baseline, export_file, export_network, export_onnx},
        predict::{is_surrogate, load_file},
    },
    study::{FmiChoice, FmuInterface, FmuPort, NameStyle},
};
use std::path::Path;

pub fn run(args: &ExportModelArgs) -> Result<CommandOutcome> {
    if let Some(path) = &args.onnx {
        let surrogate = match is_surrogate(&args.export.study.study) {
            true => load_file(&args.export.study.study)?,
            false => project(&args.export.study)?.load_model()?,
        };
        let bytes = export_onnx(&surrogate, path)?;
        match args.export.study.json {
            true => print_json(&serde_json::json!({ "onnx": path, "bytes": bytes }))?,
            false => print(&format!("{}\n", path.display()))?,
        }
        return Ok(CommandOutcome::Fine);
    }
    let written = match is_surrogate(&args.export.study.study) {
        true => of_file(args)?,
        false => of_study(args)?,
    };
    match written.as_slice() {
        [one] if args.export.study.json => print_json(one)?,
        all if args.export.study.json => print_json(&all)?,
        all => all.iter().try_for_each(|written| print(&format!("{}\n", written.fmu.display())))?,
    }
    Ok(CommandOutcome::Fine)
}

fn of_file(args: &ExportModelArgs) -> Result<Vec<WrittenFmu>> {
    if let Some(kind) = args.model {
        let problem = "is fitted to the runs of a study: expected a study file".into();
        return Err(Error::Baseline { model: kind.name(), problem });
    }
    let folder = args.export.study.out.as_deref().unwrap_or(Path::new("."));
    export_file(&args.export.study.study, folder, &args.export.options())
}

fn of_study(args: &ExportModelArgs) -> Result<Vec<WrittenFmu>> {
    let project = project(&args.export.study)?;
    let plan = ExportPlan::new(&project, &args.export.options())?;
    match args.model {
        None => export_network(&project, &plan),
        Some(kind) => export_baseline(&project, &plan, kind),
    }
}

impl From<FmuPortArg> for FmuPort {
    fn from(port: FmuPortArg) -> Self {
        match port {
            FmuPortArg::Domain => Self::Domain,
            FmuPortArg::Bounds => Self::Bounds,
            FmuPortArg::Measured => Self::Measured,
        }
    }
}

impl ExportArgs {
    pub fn options(&self) -> ExportRequest {
        let fmi = self.fmi.map(|fmi| match fmi {
            FmiArg::V2 => FmiChoice::V2,
            FmiArg::V3 => FmiChoice::V3,
            FmiArg::Both => FmiChoice::Both,
        });
        let interface = self.interface.map(|interface| match interface {
            FmuInterfaceArg::Study => FmuInterface::Study,
            FmuInterfaceArg::Plain => FmuInterface::Plain,
        });
        let ports = self.ports.as_ref().map(|ports| ports.iter().copied().map(FmuPort::from).collect());
        let names = self.names.map(|names| match names {
            NameStyleArg::Study => NameStyle::Study,
            NameStyleArg::Flat => NameStyle::Flat,
        });
        ExportRequest {
            fmi,
            platforms: self.platform.clone(),
            binaries: self.binary.clone(),
            sources: self.sources,
            interface,
            ports,
            names,
        }
    }
}
