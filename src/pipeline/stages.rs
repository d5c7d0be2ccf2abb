//! Stages of a build, and the state in which a Ctrl-C ends it.

use super::export::ExportPlan;
use crate::{
    diagnostics::interruption::Interruption,
    kinds::{self, learning::Learning},
    project::Project,
    study::Study,
};

/// A stage of a build.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BuildStage {
    /// Runs are sampled.
    Samples,
    /// The surrogate is trained.
    Training,
    /// Simpler models are fitted.
    Comparison,
    /// Accuracy and speed are measured.
    Measurement,
    /// FMUs are written.
    Export,
    /// FMUs are validated.
    Validation,
    /// The verdict and the report are written.
    Report,
}

impl BuildStage {
    const ALL: [Self; 7] = [
        Self::Samples,
        Self::Training,
        Self::Comparison,
        Self::Measurement,
        Self::Export,
        Self::Validation,
        Self::Report,
    ];

    /// The work of the stage, as the end of "stopped while".
    pub fn work(self) -> &'static str {
        match self {
            Self::Samples => "runs were sampled",
            Self::Training => "the surrogate was trained",
            Self::Comparison => "models were compared",
            Self::Measurement => "accuracy and speed were measured",
            Self::Export => "FMUs were written",
            Self::Validation => "FMUs were validated",
            Self::Report => "the report was written",
        }
    }
}

/// Position of a build among its stages.
pub struct Stages<'a> {
    project: &'a Project<'a>,
    plan: &'a ExportPlan,
    /// The stage at hand.
    pub stage: BuildStage,
}

impl<'a> Stages<'a> {
    /// A build that begins.
    pub fn new(project: &'a Project<'a>, plan: &'a ExportPlan) -> Self {
        let stage = if has_runs(&project.study) { BuildStage::Samples } else { BuildStage::Training };
        Self { project, plan, stage }
    }

    /// Complete and missing results at the stage at hand.
    pub fn interruption(&self) -> Interruption {
        let done = self.results().filter(|(stage, _)| *stage < self.stage).map(|(_, result)| result);
        let missing = self.results().filter(|(stage, _)| *stage >= self.stage).map(|(_, result)| result);
        let runs = (self.stage == BuildStage::Samples && self.project.journal().exists())
            .then(|| "some of the runs".to_owned());
        Interruption {
            during: self.stage.work().into(),
            done: runs.into_iter().chain(done).collect(),
            missing: missing.collect(),
        }
    }

    /// The results of each stage that the build has.
    fn results(&self) -> impl Iterator<Item = (BuildStage, String)> {
        let Self { project, plan, .. } = *self;
        let study = &project.study;
        let name = |path: std::path::PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let has = move |stage: &BuildStage| match stage {
            BuildStage::Samples => has_runs(study),
            BuildStage::Comparison => !study.baselines.build.is_empty() && kinds::of(study).no_baselines().is_none(),
            _ => true,
        };
        BuildStage::ALL.into_iter().filter(has).flat_map(move |stage| {
            let results = match stage {
                BuildStage::Samples => {
                    vec![format!("runs ({}, {})", name(project.table("train")), name(project.table("test")))]
                }
                BuildStage::Training => vec![format!("surrogate ({})", name(project.model()))],
                BuildStage::Comparison => {
                    vec![format!("comparison with simpler models ({})", name(project.comparison()))]
                }
                // they become part of the verdict
                BuildStage::Measurement => Vec::new(),
                BuildStage::Export => {
                    let fmus: Vec<String> = plan.files(project).into_iter().map(name).collect();
                    vec![format!("FMU ({})", fmus.join(", "))]
                }
                BuildStage::Validation => vec!["validation".into()],
                BuildStage::Report => {
                    vec![
                        format!("verdict ({})", name(project.metrics())),
                        format!("report ({})", name(project.report())),
                    ]
                }
            };
            results.into_iter().map(move |result| (stage, result))
        })
    }
}

/// Returns true if a build begins with runs.
fn has_runs(study: &Study) -> bool {
    matches!(kinds::of(study).learning(study), Learning::FromRuns(_))
}
