//! From a study and its runs to what a training begins with.

use crate::{
    Result, baselines,
    dataset::{Dataset, Run},
    diagnostics::KeyProblem,
    layout::RowLayout,
    network::Network,
    sampling::{self, Stream},
    scaling,
    study::{Study, TrainingOptions},
    training::TrainingRows,
};
use metafmu_runtime::{ScaledNetwork, Scaling, Surrogate};
use std::sync::Arc;

/// Data and network that a training starts from.
pub struct PreparedTraining {
    pub scaling: Scaling,
    pub network: Network,
    pub training: TrainingRows,
    pub validation: TrainingRows,
    pub validation_runs: usize,
}

/// Holds out the validation runs, standardizes the rows by the others, and makes the network. The last `added` runs are all for
/// training. Scaling and network are those of `start`, if there is one.
pub fn prepare(study: &Study, dataset: &Dataset, added: usize, start: Option<&Surrogate>) -> Result<PreparedTraining> {
    let (planned, added) = dataset.runs.split_at(dataset.runs.len() - added);
    let (mut training, validation) = split(planned, &study.training, study.seed);
    training.extend(added);
    of_rows(
        study,
        dataset,
        &training,
        &validation,
        RowLayout::new(study.encoder()),
        start.and_then(Surrogate::network).as_ref(),
    )
}

/// Prepares the network of each instant. The instants are the times of the runs, which are equal in every run.
pub fn prepare_instants(study: &Study, dataset: &Dataset) -> Result<(Arc<[f64]>, Vec<PreparedTraining>)> {
    let instants = common_times(study, &dataset.runs)?;
    let (training, validation) = split(&dataset.runs, &study.training, study.seed);
    let prepared = |row| of_rows(study, dataset, &training, &validation, RowLayout::at(study.encoder(), row), None);
    Ok((Arc::clone(&instants), (0..instants.len()).map(prepared).collect::<Result<_>>()?))
}

/// The runs that are held out for validation.
pub fn held_out(study: &Study, planned: &Dataset) -> Dataset {
    let (_, runs) = split(&planned.runs, &study.training, study.seed);
    Dataset { runs: runs.into_iter().cloned().collect(), ..planned.clone() }
}

fn of_rows(
    study: &Study,
    dataset: &Dataset,
    training_runs: &[&Run],
    validation_runs: &[&Run],
    layout: RowLayout,
    start: Option<&ScaledNetwork>,
) -> Result<PreparedTraining> {
    let fit = || scaling::fit(dataset, &layout, training_runs.iter().copied());
    let scaling = start.map_or_else(fit, |start| start.scaling.clone());
    let (inputs, outputs) = (layout.columns(), dataset.outputs.len());
    let rows = |runs: &[&Run]| {
        let (x, y) = scaling::standardize(runs.iter().copied(), &layout, &scaling);
        TrainingRows::new(inputs, outputs, x, y)
    };
    let (training, validation) = (rows(training_runs)?, rows(validation_runs)?);
    let network = match start {
        None => Network::new(inputs, outputs, &study.network, study.seed)?,
        Some(start) => Network::from_layers(&start.layers, study.network.activation)?,
    };
    Ok(PreparedTraining { scaling, network, training, validation, validation_runs: validation_runs.len() })
}

fn common_times(study: &Study, runs: &[Run]) -> Result<Arc<[f64]>> {
    let Some(first) = runs.first() else { return Ok(Arc::new([])) };
    let other = runs.iter().position(|run| run.times != first.times);
    let problems = other.into_iter().map(|index| {
        let times = &runs[index].times;
        let difference = match first.times.iter().zip(times.iter()).find(|(expected, found)| expected != found) {
            Some((expected, found)) => format!("has a row at {found} s where the first one has it at {expected} s"),
            None => format!("has {} rows, the first one {}", times.len(), first.times.len()),
        };
        let message = format!("\"fixed\" needs the same times in every run, but training run {index} {difference}");
        KeyProblem { key: "network.structure".into(), message }
    });
    study.refuse(problems.collect())?;
    Ok(Arc::clone(&first.times))
}

/// The rows a baseline may be fitted to: those the network is trained on.
pub fn baseline_rows(study: &Study, dataset: &Dataset) -> baselines::StandardizedRows {
    baseline_rows_and_held_out(study, dataset).0
}

/// Rows that a baseline may be fitted to, and the runs that are held out of the training.
pub fn baseline_rows_and_held_out(study: &Study, dataset: &Dataset) -> (baselines::StandardizedRows, Dataset) {
    let (training_runs, held_out) = split(&dataset.runs, &study.training, study.seed);
    let Dataset { parameters, outputs, .. } = dataset;
    let runs = held_out.into_iter().cloned().collect();
    let held_out = Dataset { inputs: Vec::new(), parameters: parameters.clone(), outputs: outputs.clone(), runs };
    (baselines::rows(dataset, &RowLayout::new(study.encoder()), &training_runs), held_out)
}

/// Training and validation runs: whole runs, chosen at random; at least one of each.
pub(super) fn split<'a>(runs: &'a [Run], options: &TrainingOptions, seed: u64) -> (Vec<&'a Run>, Vec<&'a Run>) {
    let order = sampling::permutation(runs.len(), sampling::random(seed, Stream::Validation));
    let count = options.held_out(runs.len());
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
        let run = |p: f64| Run { inputs: Vec::new(), parameters: vec![p], times: [0.0].into(), outputs: vec![p] };
        let runs: Vec<Run> = (0..100).map(|i| run(f64::from(i))).collect();
        let with = |validation| TrainingOptions { validation, ..TrainingOptions::default() };
        let (training, validation) = split(&runs, &with(0.1), 1);
        assert_eq!((training.len(), validation.len()), (90, 10));
        assert!(validation.iter().all(|held| training.iter().all(|run| run.parameters != held.parameters)));
        assert_eq!(split(&runs, &with(0.1), 1), (training, validation.clone()));
        assert_ne!(split(&runs, &with(0.1), 2).1, validation);
        assert_eq!(split(&runs[..2], &with(0.001), 1).1.len(), 1);
    }
}
