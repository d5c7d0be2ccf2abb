//! From a study and its runs to what a training begins with.

use metafmu::{
    Result,
    dataset::{Dataset, Run},
    network::Network,
    sampling::{self, Stream},
    scaling,
    study::Study,
    training::Rows,
};
use metafmu_runtime::Scaling;

/// What a training begins with.
pub struct Prepared {
    pub scaling: Scaling,
    pub network: Network,
    pub training: Rows,
    pub validation: Rows,
    pub validation_runs: usize,
}

/// Holds out the validation runs, standardises the rows by the others, and makes the network.
pub fn prepare(study: &Study, dataset: &Dataset) -> Result<Prepared> {
    let (training_runs, validation_runs) = split(&dataset.runs, study.training.validation, study.seed);
    let scaling = scaling::fit(dataset, training_runs.iter().copied());
    let (inputs, outputs) = (dataset.parameters.len() + 1, dataset.outputs.len());
    let rows = |runs: &[&Run]| {
        let (x, y) = scaling::standardise(runs.iter().copied(), &scaling);
        Rows::new(inputs, outputs, x, y)
    };
    let (training, validation) = (rows(&training_runs)?, rows(&validation_runs)?);
    let network = Network::new(inputs, outputs, &study.network, study.seed)?;
    Ok(Prepared { scaling, network, training, validation, validation_runs: validation_runs.len() })
}

/// Training and validation runs: whole runs, chosen at random; at least one of each.
fn split(runs: &[Run], share: f64, seed: u64) -> (Vec<&Run>, Vec<&Run>) {
    let order = sampling::permutation(runs.len(), sampling::random(seed, Stream::Validation));
    let count = ((share * runs.len() as f64).round() as usize).clamp(1, runs.len().saturating_sub(1).max(1));
    let mut held_out = vec![false; runs.len()];
    order.iter().take(count).for_each(|&run| held_out[run] = true);
    let choose = |wanted: bool| {
        let pairs = runs.iter().zip(&held_out);
        pairs.filter(|&(_, &held)| held == wanted).map(|(run, _)| run).collect()
    };
    (choose(false), choose(true))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_split_is_by_run_complete_and_repeats_for_a_seed_only() {
        let run = |p: f64| Run { parameters: vec![p], times: [0.0].into(), outputs: vec![p] };
        let runs: Vec<Run> = (0..100).map(|i| run(f64::from(i))).collect();
        let (training, validation) = split(&runs, 0.1, 1);
        assert_eq!((training.len(), validation.len()), (90, 10));
        assert!(validation.iter().all(|held| training.iter().all(|run| run.parameters != held.parameters)));
        assert_eq!(split(&runs, 0.1, 1), (training, validation.clone()));
        assert_ne!(split(&runs, 0.1, 2).1, validation);
        assert_eq!(split(&runs[..2], 0.001, 1).1.len(), 1);
    }
}
