//! Packages the surrogate, or a baseline, as FMUs.

use super::{compare, predict::load_file};
use crate::{
    Error, Result, acceptance,
    baselines::{self, BaselineKind, Fitted, choose_rows},
    evaluation::{Accuracy, Findings, Verdict},
    export::{Binary, Contents, onnx, pack},
    files,
    fmi::{Archive, FmiVersion},
    kinds::{self, prepare::baseline_rows},
    project::Project,
    report::{Drawn, Evaluated, Figure, card_figures},
    study::{ExportOptions, FmiChoice, FmuInterface, FmuPort, NameStyle},
    surrogate::{self, with_names},
};
use metafmu_runtime::Surrogate;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Choices of an export; by default those of the study, with every embedded library.
#[derive(Clone, Debug, Default)]
pub struct ExportRequest {
    /// Versions of FMI.
    pub fmi: Option<FmiChoice>,
    /// Platforms with a binary, of those embedded; all if there is none.
    pub platforms: Vec<String>,
    /// Further libraries, by platform tuple.
    pub binaries: Vec<(String, PathBuf)>,
    /// `true` if the FMU contains C sources.
    pub sources: bool,
    /// Variables of the FMU.
    pub interface: Option<FmuInterface>,
    /// Ports beside those of the study.
    pub ports: Option<Vec<FmuPort>>,
    /// Names of the variables.
    pub names: Option<NameStyle>,
}

/// Plan of an export: the FMUs to write.
#[derive(Debug)]
pub struct ExportPlan {
    about: ExportOptions,
    binaries: Vec<Binary>,
    sources: bool,
}

/// An FMU that was written.
#[derive(Debug, Serialize)]
pub struct WrittenFmu {
    /// Its file.
    pub fmu: PathBuf,
    /// Size of the file.
    pub bytes: usize,
    /// Version of FMI.
    #[serde(skip)]
    pub version: FmiVersion,
}

impl ExportPlan {
    /// Finds the libraries and checks the ports, so that what is wrong is reported before the work instead of after it.
    ///
    /// # Errors
    /// [`Error::Io`] of a library, the error of an unknown platform, [`Error::Ports`].
    pub fn new(project: &Project, options: &ExportRequest) -> Result<Self> {
        let plan = Self::of(options, project.study.export.clone())?;
        let problems = plan.about.problems_beside(&project.study).into_iter().map(|problem| problem.message);
        let problems: Vec<String> = problems.collect();
        if problems.is_empty() { Ok(plan) } else { Err(Error::Ports { problems }) }
    }

    /// `of_study`: options unless others are requested.
    fn of(options: &ExportRequest, of_study: ExportOptions) -> Result<Self> {
        let interface = options.interface.unwrap_or(of_study.interface);
        // ports of the study are not requested of a plain FMU
        let usual = if options.interface == Some(FmuInterface::Plain) { Vec::new() } else { of_study.ports };
        let about = ExportOptions {
            fmi: options.fmi.unwrap_or(of_study.fmi),
            interface,
            ports: options.ports.clone().unwrap_or(usual),
            names: options.names.unwrap_or(of_study.names),
            ..of_study
        };
        let added = options.binaries.iter().map(|(tuple, path)| Binary::from_file(tuple, path));
        let added = added.collect::<Result<Vec<Binary>>>()?;
        let mut binaries = if options.platforms.is_empty() {
            Binary::embedded()
        } else {
            options.platforms.iter().map(|tuple| Binary::of_platform(tuple.trim())).collect::<Result<_>>()?
        };
        // a library given by name goes before the embedded one
        binaries.retain(|binary| added.iter().all(|added| added.platform != binary.platform));
        binaries.extend(added);
        Ok(Self { about, binaries, sources: options.sources })
    }

    /// Files of the FMUs of a project.
    pub(super) fn files(&self, project: &Project) -> Vec<PathBuf> {
        let target = ExportTarget { folder: project.folder(), name: &project.study.name, alone: false };
        self.wanted().map(|version| target.fmu(version)).collect()
    }

    /// The versions to write.
    fn wanted(&self) -> impl Iterator<Item = FmiVersion> {
        let choice = self.about.fmi;
        let is_wanted = move |version: &FmiVersion| match version {
            FmiVersion::V2 => choice != FmiChoice::V3,
            FmiVersion::V3 => choice != FmiChoice::V2,
        };
        FmiVersion::ALL.into_iter().filter(is_wanted)
    }
}

/// Pictures for the model card.
pub(super) fn figures(evaluated: &Evaluated) -> Result<Vec<Drawn>> {
    card_figures(evaluated).iter().map(Figure::draw).collect()
}

/// The network's FMUs.
///
/// # Errors
/// [`Error::Stale`] if there is no network of this study, those of the files.
pub fn export_network(project: &Project, plan: &ExportPlan) -> Result<Vec<WrittenFmu>> {
    let surrogate = project.load_model()?;
    let accuracy = project.load_accuracy(&surrogate)?.map(|accuracy| {
        let (training, comparison) = (project.load_training_record()?, project.load_comparison(&accuracy)?);
        let validation = project.load_validation(&surrogate);
        let verdict = project.judge(&surrogate, &training, &accuracy, comparison.as_ref(), validation);
        Ok::<_, Error>(with_verdict(project, accuracy, verdict))
    });
    let accuracy = accuracy.transpose()?;
    project.prepare_folder()?;
    let kind = kinds::of(&project.study);
    let figures = match &accuracy {
        Some(_) if kind.unseen_table(project).exists() => {
            let unseen = kind.load_unseen(project, &project.load_training_record()?)?;
            figures(&unseen.test.evaluated(&surrogate))?
        }
        _ => Vec::new(),
    };
    stage(project, plan, &surrogate, accuracy.as_ref(), &figures)
}

/// The FMUs of a surrogate that is a file, of metafmu's model files or FMUs, in a folder: NAME.fmu and NAME-fmi3.fmu,
/// NAME being the surrogate's. Their accuracy is not known here, so their model cards do not contain it.
///
/// # Errors
/// Those of [`load_file`], [`Error::Io`], the error of an unknown platform; [`Error::SameFile`] if an FMU would take
/// the place of the file itself.
pub fn export_file(file: &Path, folder: &Path, options: &ExportRequest) -> Result<Vec<WrittenFmu>> {
    let plan = ExportPlan::of(options, ExportOptions::default())?;
    let surrogate = load_file(file)?;
    if folder.extension().is_some_and(|extension| extension == "fmu") && !folder.is_dir() {
        let source = std::io::Error::other("expected a folder for NAME.fmu, NAME being the surrogate's");
        return Err(Error::io(folder, "write into the folder")(source));
    }
    files::writable_folder_in_place(folder)?;
    let target = ExportTarget { folder, name: &surrogate.metadata().name, alone: false };
    let same =
        |path: &PathBuf| path.canonicalize().is_ok_and(|path| file.canonicalize().is_ok_and(|file| file == path));
    if let Some(path) = plan.wanted().map(|version| target.fmu(version)).find(same) {
        return Err(Error::SameFile { path });
    }
    write(&target, &plan, &surrogate, None, &[])
}

/// A surrogate as an ONNX model; the result is the size of the file.
///
/// # Errors
/// [`Error::NoOnnx`] if it has states, [`Error::Io`].
pub fn export_onnx(surrogate: &Surrogate, path: &Path) -> Result<usize> {
    files::check_output(path)?;
    let bytes = onnx(surrogate)?;
    files::write_whole(path, &bytes)?;
    Ok(bytes.len())
}

/// FMUs of a surrogate with these names. A single version is `fmu`; of both, that of FMI 3.0 is beside it, with `-fmi3`
/// in its name. `accuracy`: measured accuracy, for the model card.
///
/// # Errors
/// [`Error::Io`], the error of an unknown platform.
pub fn export_surrogate(
    surrogate: &Surrogate,
    accuracy: Option<&Accuracy>,
    fmu: &Path,
    options: &ExportRequest,
) -> Result<Vec<WrittenFmu>> {
    let plan = ExportPlan::of(options, ExportOptions::default())?;
    let folder = fmu.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // as of the FMU itself: no folder is made for it
    files::check_output(fmu)?;
    let stem = fmu.file_stem().unwrap_or_default().to_string_lossy();
    let target = ExportTarget { folder, name: &stem, alone: plan.wanted().count() == 1 };
    write(&target, &plan, surrogate, accuracy, &[])
}

/// Fits a baseline, measures it on the test runs, and writes its model file and its FMUs.
///
/// # Errors
/// [`Error::Baseline`] if it cannot be fitted or exported, [`Error::Stale`] if there are no runs of this study, [`Error::Io`].
pub fn export_baseline(project: &Project, plan: &ExportPlan, kind: BaselineKind) -> Result<Vec<WrittenFmu>> {
    compare::refuse_others(project)?;
    let (study, model) = (&project.study, kind.name());
    let (train, test) = (project.load_table("train")?, project.load_table("test")?);
    project.prepare_folder()?;
    let baseline = baselines::model(&study.baselines, kind);
    let rows = baseline_rows(study, &train);
    let rows = choose_rows(&rows, baseline.most_rows(), study.seed);
    let failed = |problem| Error::Baseline { model, problem };
    let graph = match baseline.fit(&rows, study.seed).map_err(|error| failed(error.message))? {
        Fitted::Formula(graph) => graph,
        Fitted::Library(library) => return Err(failed(format!("cannot be exported: {}", library.not_exportable))),
    };
    let surrogate = surrogate::assemble_baseline(study, &train, rows.len(), kind, graph)?;
    surrogate::save(&surrogate, &project.baseline_model(kind))?;
    let evaluated = Evaluated::new(&surrogate, &test);
    // the network's own: a baseline is not compared with baselines
    let measured = (&evaluated.accuracy, "test runs");
    let verdict = acceptance::judge(study, &surrogate, measured, None, Findings::default());
    let accuracy = with_verdict(project, evaluated.accuracy.clone(), verdict);
    write_of_project(project, plan, &surrogate, Some(&accuracy), &figures(&evaluated)?, &format!("-{model}"))
}

/// An FMU of a rejected surrogate is written nevertheless, and says so.
fn with_verdict(project: &Project, accuracy: Accuracy, verdict: Verdict) -> Accuracy {
    verdict.text().lines().for_each(|line| project.say(line));
    Accuracy { verdict: Some(verdict), ..accuracy }
}

/// Writes the network's FMUs.
pub(super) fn stage(
    project: &Project,
    plan: &ExportPlan,
    surrogate: &Surrogate,
    accuracy: Option<&Accuracy>,
    figures: &[Drawn],
) -> Result<Vec<WrittenFmu>> {
    write_of_project(project, plan, surrogate, accuracy, figures, "")
}

/// `model`: what follows the study's name in those of the files.
fn write_of_project(
    project: &Project,
    plan: &ExportPlan,
    surrogate: &Surrogate,
    accuracy: Option<&Accuracy>,
    figures: &[Drawn],
    model: &str,
) -> Result<Vec<WrittenFmu>> {
    let name = format!("{}{model}", project.study.name);
    let target = ExportTarget { folder: project.folder(), name: &name, alone: false };
    let written = write(&target, plan, surrogate, accuracy, figures)?;
    let others = FmiVersion::ALL.into_iter().filter(|version| plan.wanted().all(|wanted| wanted != *version));
    for path in others.map(|version| target.fmu(version)) {
        if path.exists() && !is_of(&with_names(surrogate, plan.about.names)?, &path) {
            files::remove(&path)?;
            project.say(format_args!("removed {}, which an earlier export made of another model", path.display()));
        }
    }
    Ok(written)
}

/// Target of an export: the folder, and the names of the FMUs.
struct ExportTarget<'a> {
    folder: &'a Path,
    name: &'a str,
    /// `true` if one version of FMI only is exported: the name of the FMU does not contain it.
    alone: bool,
}

impl ExportTarget<'_> {
    fn fmu(&self, version: FmiVersion) -> PathBuf {
        let suffix = if version == FmiVersion::V3 && !self.alone { "-fmi3" } else { "" };
        self.folder.join(format!("{}{suffix}.fmu", self.name))
    }
}

fn write(
    target: &ExportTarget,
    plan: &ExportPlan,
    surrogate: &Surrogate,
    accuracy: Option<&Accuracy>,
    figures: &[Drawn],
) -> Result<Vec<WrittenFmu>> {
    let write = |version| {
        let ExportPlan { about, binaries, sources } = plan;
        let contents = Contents { version, about, binaries, accuracy, figures, sources: *sources };
        let (path, bytes) = (target.fmu(version), pack(surrogate, &contents)?);
        files::write_whole(&path, &bytes)?;
        Ok(WrittenFmu { fmu: path, bytes: bytes.len(), version })
    };
    plan.wanted().map(write).collect()
}

/// Returns true if an FMU was made from this surrogate.
fn is_of(surrogate: &Surrogate, fmu: &Path) -> bool {
    let document = Archive::open(fmu).and_then(|mut archive| archive.document());
    document.is_ok_and(|document| document.description.token == surrogate.instantiation_token())
}
