//! Cross-validation of a kind of model by runs.

use super::{DiscreteSamples, LearnedDiscrete, error, unless_interrupted};
use crate::{
    Result,
    dataset::{Dataset, Run},
    evaluation::Accuracy,
    kinds::prepare::{self, held_out},
    project::Project,
    study::DiscreteModel,
    training::StopReason,
};
use metafmu_runtime::Surrogate;

/// Parts of the runs; each is unseen once.
pub(super) const PARTS: usize = 3;

/// Error of a kind of model in simulations of unseen runs: root mean square of standardized outputs, mean over the parts of the runs. Each part is
/// simulated by a model that is learned from the others, with the delayed inputs of `late`. None if Ctrl-C ended it.
pub(super) fn cross_validation(
    project: &Project,
    [dataset, late]: [&Dataset; 2],
    kind: DiscreteModel,
    assembled: &impl Fn(&LearnedDiscrete) -> Result<Surrogate>,
) -> Result<Option<f64>> {
    let (study, parts) = (&project.study, PARTS);
    let (_, scales) =
        &DiscreteSamples::new(study.time.step, dataset, (dataset.runs.iter().collect(), Vec::new())).scales[2];
    let mut sum = 0.0;
    for part in 0..parts {
        let of_part = |of: &Dataset, wanted: bool| -> Vec<Run> {
            let runs = of.runs.iter().enumerate().filter(|(run, _)| (run % parts == part) == wanted);
            runs.map(|(_, run)| run.clone()).collect()
        };
        let seen = of_part(late, false);
        let samples = DiscreteSamples::new(study.time.step, late, prepare::split(&seen, &study.training, study.seed));
        let Some(found) = unless_interrupted(project, samples.learn(project, kind), true)? else { return Ok(None) };
        if found.iter().any(|one| one.stopped == StopReason::Interrupted) {
            return Ok(None);
        }
        let [seen, unseen] = [false, true].map(|wanted| Dataset { runs: of_part(dataset, wanted), ..dataset.clone() });
        let held_out = held_out(study, &seen);
        let mut best = (f64::INFINITY, f64::INFINITY);
        for one in &found {
            let surrogate = assembled(one)?;
            let chosen_by = error(&Accuracy::of(&surrogate, &held_out));
            if chosen_by < best.0 {
                let outputs = &Accuracy::of(&surrogate, &unseen).outputs;
                let squares = outputs.values().zip(scales).map(|(output, scale)| output.mse / (scale * scale));
                best = (chosen_by, (squares.sum::<f64>() / scales.len() as f64).sqrt());
            }
        }
        sum += best.1;
    }
    Ok(Some(sum / parts as f64))
}
