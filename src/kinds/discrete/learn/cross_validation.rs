//! Cross-validation of a kind of model by runs.

use super::{DiscreteSamples, SampledAssembly, error, unless_interrupted};
use crate::{
    Result,
    dataset::{Dataset, Run},
    evaluation::Accuracy,
    kinds::prepare::{self, held_out},
    project::Project,
    study::DiscreteModel,
    training::StopReason,
};

/// Parts of the runs; each is unseen once.
pub(super) const PARTS: usize = 3;

/// Error of a kind of model in simulations of unseen runs: root mean square of standardized outputs, mean over the parts of the runs. Each part is
/// simulated by a model that is learned from the others, of the runs `delayed` without the effects of inputs. None if Ctrl-C ended it.
pub(super) fn cross_validation(
    project: &Project,
    delayed: &Dataset,
    kind: DiscreteModel,
    assembly: &SampledAssembly,
) -> Result<Option<f64>> {
    let (study, dataset) = (&project.study, assembly.dataset);
    let all = DiscreteSamples::new(study.time.step, dataset, dataset.runs.iter().collect(), Vec::new());
    let scales = &all.scales[2].scales;
    let mut sum = 0.0;
    for part in 0..PARTS {
        let (seen, _) = divided(delayed, part);
        let (training, validation) = prepare::split(&seen, &study.training, study.seed);
        let samples = DiscreteSamples::new(study.time.step, delayed, training, validation);
        let Some(models) = unless_interrupted(project, samples.learn(project, kind), true)? else { return Ok(None) };
        if models.iter().any(|model| model.stopped == StopReason::Interrupted) {
            return Ok(None);
        }
        let (seen, unseen) = divided(dataset, part);
        let [seen, unseen] = [seen, unseen].map(|runs| Dataset { runs, ..dataset.clone() });
        let held_out = held_out(study, &seen);
        let mut best = (f64::INFINITY, f64::INFINITY);
        for model in &models {
            let surrogate = assembly.surrogate(model)?;
            let chosen_by = error(&Accuracy::of(&surrogate, &held_out));
            if chosen_by < best.0 {
                let outputs = &Accuracy::of(&surrogate, &unseen).outputs;
                let squares = outputs.values().zip(scales).map(|(output, scale)| output.mse / (scale * scale));
                best = (chosen_by, (squares.sum::<f64>() / scales.len() as f64).sqrt());
            }
        }
        sum += best.1;
    }
    Ok(Some(sum / PARTS as f64))
}

/// Runs of the other parts, and those of a part.
fn divided(dataset: &Dataset, part: usize) -> (Vec<Run>, Vec<Run>) {
    let (mut others, mut own) = (Vec::new(), Vec::new());
    for (number, run) in dataset.runs.iter().enumerate() {
        let runs = if number % PARTS == part { &mut own } else { &mut others };
        runs.push(run.clone());
    }
    (others, own)
}
