//! Learns the force of a flexible part: the gradient of a potential, and a dissipation that is never negative.

use crate::{
    Result,
    compliant::{self, ElementColumns, ElementFit, ElementRows, FittedDegrees},
    dataset::Dataset,
    import::{
        self, About,
        interface::{InterfaceCausality, InterfaceVariability, ModelInterface},
    },
    kinds::{
        learning::{Beginning, LearningMethod, Trained},
        prepare,
        record::{Candidate, CompliantRecord, MethodRecord, TrainingRecord},
    },
    project::Project,
    study::{ParameterVariability, Study},
    surrogate,
};
use std::{path::Path, time::Instant};

/// Rows of runs in which a flexible part is deformed.
pub(super) struct ElementOfRuns;

impl LearningMethod for ElementOfRuns {
    fn learn(&self, project: &Project, dataset: &Dataset, _: &Beginning) -> Result<Trained> {
        let study = &project.study;
        let began = Instant::now();
        let (training, held_out) = prepare::split(&dataset.runs, &study.training, study.seed);
        let validation_runs = held_out.len();
        let [rows, held_out] = [training, held_out].map(|runs| ElementRows::of(study, dataset, runs));
        let ElementFit { element, candidates, best } = compliant::fit(study, &rows, &held_out, project.control().stop)?;
        let columns = ElementColumns::of(study, dataset);
        let interface = interface(study, &columns);
        let mut points = rows.points.clone();
        points.extend(&held_out.points);
        let numbers = points.values().iter().chain(rows.forces.values());
        let content: Vec<u8> = numbers.flat_map(|value| value.to_le_bytes()).collect();
        let about = About { path: Path::new(&study.name), content: &content, is_single: false, producer: "" };
        let surrogate = import::of_graph(element.graph(), about, &interface, Some(points))?;
        let surrogate = surrogate::of_rows(study, &surrogate)?;
        let candidates: Vec<Candidate> = candidates.iter().map(candidate).collect();
        let method = MethodRecord::Compliant(CompliantRecord {
            exported: candidates[best].name.clone(),
            coefficients: element.coefficients(),
            candidates,
        });
        let record = TrainingRecord {
            validation_runs,
            ..TrainingRecord::solved(rows.points.len(), began.elapsed().as_secs_f64(), method)
        };
        project.finish(format_args!(
            "fitted to {} rows in {:.1} s: {}",
            record.train_rows,
            record.train_seconds,
            record.method.as_ref().map_or(String::new(), MethodRecord::describe)
        ));
        Ok(Trained { surrogate, history: Vec::new(), record })
    }
}

fn candidate(FittedDegrees { potential, dissipation, error, seconds }: &FittedDegrees) -> Candidate {
    let dissipation = dissipation.map_or(String::new(), |degree| format!(" and dissipation {degree}"));
    Candidate { name: format!("potential {potential}{dissipation}"), error: *error, seconds: *seconds }
}

/// Parameters of the element are parameters of the FMU, positions and velocities are inputs.
fn interface(study: &Study, columns: &ElementColumns) -> ModelInterface {
    let mut interface = ModelInterface::of_study(study, &columns.inputs, &columns.outputs);
    for name in &study.compliant.parameters {
        let (Some(input), Some(parameter)) = (interface.inputs.get_mut(name), study.parameters.get(name)) else {
            continue;
        };
        input.causality = InterfaceCausality::Parameter;
        input.variability = Some(match parameter.variability {
            Some(ParameterVariability::Tunable) => InterfaceVariability::Tunable,
            _ => InterfaceVariability::Fixed,
        });
        (input.min, input.max) = (Some(parameter.min), Some(parameter.max));
    }
    interface
}
