//! `metafmu export`: packages the surrogate as an FMU.

use super::{Outcome, job::Job, prepare::baseline_rows, print, print_json, say};
use crate::cli::{ExportArgs, ExportModelArgs, FmiArg};
use metafmu::{
    Error, Result,
    acceptance::{self, Verdict},
    baseline::{Fitted, Kind, choose_rows},
    evaluation::Accuracy,
    files,
    fmu::{self, Archive, Binary, Contents, FmiVersion},
    report::{Drawn, Evaluated, Figure, card_figures},
    study::{FmiChoice, ParameterOptions, Structure},
    surrogate,
};
use metafmu_runtime::Surrogate;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What is to be made.
pub struct Plan {
    choice: FmiChoice,
    binaries: Vec<Binary>,
    sources: bool,
}

/// An FMU that was written.
#[derive(Debug, Serialize)]
pub struct Written {
    pub fmu: PathBuf,
    pub bytes: usize,
    #[serde(skip)]
    pub version: FmiVersion,
}

pub fn run(args: &ExportModelArgs) -> Result<Outcome> {
    let job = Job::new(&args.export.study)?;
    let plan = Plan::new(&job, &args.export)?;
    let written = match args.model {
        None => export_network(&job, &plan)?,
        Some(kind) => export_baseline(&job, &plan, kind)?,
    };
    match written.as_slice() {
        [one] if job.json => print_json(one)?,
        all if job.json => print_json(&all)?,
        all => all.iter().try_for_each(|written| print(&format!("{}\n", written.fmu.display())))?,
    }
    Ok(Outcome::Fine)
}

impl Plan {
    /// Finds the libraries, so that one that is missing is found before the work and not after it.
    pub fn new(job: &Job, args: &ExportArgs) -> Result<Self> {
        if args.sources && job.study.network.structure == Structure::Fixed {
            return Err(Error::NoSources);
        }
        let encoded = |parameter: &ParameterOptions| !parameter.encoding().is_plain();
        let encoded = job.study.parameters.iter().find(|(_, parameter)| encoded(parameter));
        if let Some((name, _)) = encoded.filter(|_| args.sources) {
            return Err(Error::NoEncodedSources { parameter: name.clone() });
        }
        let choice = match args.fmi {
            None => job.study.export.fmi,
            Some(FmiArg::V2) => FmiChoice::V2,
            Some(FmiArg::V3) => FmiChoice::V3,
            Some(FmiArg::Both) => FmiChoice::Both,
        };
        let added = args.binary.iter().map(|(tuple, path)| Binary::from_file(tuple, path));
        let added = added.collect::<Result<Vec<Binary>>>()?;
        let mut binaries = if args.platform.is_empty() {
            Binary::embedded()
        } else {
            args.platform.iter().map(|tuple| Binary::of_platform(tuple.trim())).collect::<Result<_>>()?
        };
        // a library given by name goes before the embedded one
        binaries.retain(|binary| added.iter().all(|added| added.platform != binary.platform));
        binaries.extend(added);
        Ok(Self { choice, binaries, sources: args.sources })
    }
}

/// Pictures for the model card.
pub fn figures(evaluated: &Evaluated) -> Result<Vec<Drawn>> {
    card_figures(evaluated).iter().map(Figure::draw).collect()
}

fn export_network(job: &Job, plan: &Plan) -> Result<Vec<Written>> {
    let surrogate = job.load_model()?;
    let accuracy = job.load_accuracy(&surrogate)?.map(|accuracy| {
        let (training, comparison) = (job.load_training_record()?, job.load_comparison(&accuracy)?);
        let verdict = job.judge(&surrogate, &training, &accuracy, comparison.as_ref());
        Ok::<_, Error>(with_verdict(accuracy, verdict))
    });
    let accuracy = accuracy.transpose()?;
    job.prepare_folder()?;
    let figures = match &accuracy {
        Some(_) if job.table("test").exists() => figures(&Evaluated::new(&surrogate, &job.load_table("test")?))?,
        _ => Vec::new(),
    };
    stage(job, plan, &surrogate, accuracy.as_ref(), &figures)
}

/// Fits a baseline, measures it on the test runs, and writes its model file and its FMUs.
fn export_baseline(job: &Job, plan: &Plan, kind: Kind) -> Result<Vec<Written>> {
    let (study, model) = (&job.study, kind.name());
    let (train, test) = (job.load_table("train")?, job.load_table("test")?);
    job.prepare_folder()?;
    let baseline = study.baselines.get(kind);
    let rows = baseline_rows(study, &train);
    let rows = choose_rows(&rows, baseline.most_rows(), study.seed);
    let failed = |problem| Error::Baseline { model, problem };
    let regression = match baseline.fit(&rows, study.seed).map_err(failed)? {
        Fitted::Formula(regression) => regression,
        Fitted::Library(library) => return Err(failed(format!("cannot be exported: {}", library.not_exportable))),
    };
    let surrogate = surrogate::assemble_baseline(study, &train, rows.len(), kind, regression)?;
    surrogate::save(&surrogate, &job.baseline_model(kind))?;
    let evaluated = Evaluated::new(&surrogate, &test);
    // the network's own: a baseline is not compared with baselines
    let verdict = Verdict::of(acceptance::problems(study, &surrogate, &evaluated.accuracy, None, "test runs"));
    let accuracy = with_verdict(evaluated.accuracy.clone(), verdict);
    write(job, plan, &surrogate, Some(&accuracy), &figures(&evaluated)?, &format!("-{model}"))
}

/// An FMU of a rejected surrogate is made all the same, and says so.
fn with_verdict(accuracy: Accuracy, verdict: Verdict) -> Accuracy {
    verdict.text().lines().for_each(say);
    Accuracy { verdict: Some(verdict), ..accuracy }
}

/// Writes the network's FMUs.
pub fn stage(
    job: &Job,
    plan: &Plan,
    surrogate: &Surrogate,
    accuracy: Option<&Accuracy>,
    figures: &[Drawn],
) -> Result<Vec<Written>> {
    write(job, plan, surrogate, accuracy, figures, "")
}

fn write(
    job: &Job,
    plan: &Plan,
    surrogate: &Surrogate,
    accuracy: Option<&Accuracy>,
    figures: &[Drawn],
    model: &str,
) -> Result<Vec<Written>> {
    let (wanted, others) = match plan.choice {
        FmiChoice::V2 => (vec![FmiVersion::V2], vec![FmiVersion::V3]),
        FmiChoice::V3 => (vec![FmiVersion::V3], vec![FmiVersion::V2]),
        FmiChoice::Both => (vec![FmiVersion::V2, FmiVersion::V3], vec![]),
    };
    let path = |version| {
        let suffix = if version == FmiVersion::V3 { "-fmi3" } else { "" };
        job.fmu(&format!("{model}{suffix}"))
    };
    let write = |version| {
        let Plan { binaries, sources, .. } = plan;
        let contents = Contents { version, about: &job.study.export, binaries, accuracy, figures, sources: *sources };
        let (path, bytes) = (path(version), fmu::pack(surrogate, &contents)?);
        files::write_whole(&path, &bytes)?;
        Ok(Written { fmu: path, bytes: bytes.len(), version })
    };
    let written = wanted.into_iter().map(write).collect::<Result<_>>()?;
    for path in others.into_iter().map(path) {
        if path.exists() && !is_of(surrogate, &path) {
            files::remove(&path)?;
            say(format_args!("removed {}, which an earlier export made of another model", path.display()));
        }
    }
    Ok(written)
}

/// Whether an FMU was made of this surrogate.
fn is_of(surrogate: &Surrogate, fmu: &Path) -> bool {
    let document = Archive::open(fmu).and_then(|mut archive| archive.document());
    document.is_ok_and(|document| document.description.token == surrogate.instantiation_token())
}
