//! Ways to learn the functions of equations, compared: dictionaries, networks, and networks for what dictionaries leave over.

use crate::{
    Error, Result,
    kinds::{
        follower::{Checkpoints, Follower, at_least_one_epoch, unusable_checkpoint},
        record::{ACCELERATIONS, Candidate},
    },
    network::Network,
    project::{CountedWork, Event, Project},
    scaling,
    source::worker::WorkerModel,
    study::{DynamicsOptions, Study},
    training::{self, Outcome, Tangents, TrainingRows, drawn, without_constants},
    worst::worst,
};
use metafmu_runtime::{
    FormatError, Graph, Rows, ScaledNetwork, Scaling,
    dictionary::Factor,
    function_set::{ColumnKind, NetworkColumn},
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::sync::atomic::Ordering;

/// Default `sampling.states` of an FMU, and of a mechanism.
const STATES: [usize; 2] = [5000, 20_000];
/// Number of states per held-out state, and minimum number of held-out states, unless that is more than half of all.
const HELD_OUT: (usize, usize) = (10, 200);
/// Error of a dictionary at which a network cannot add anything: it is trained in single precision.
pub(super) const EXACT: f64 = 1e-9;

/// Number of states at which equations are evaluated.
pub(super) fn states(study: &Study) -> usize {
    study.sampling.states.unwrap_or(STATES[usize::from(study.mechanism().is_some())])
}

/// Number of states that are held out.
pub(super) fn held_out(states: usize) -> usize {
    (states / HELD_OUT.0).max(HELD_OUT.1).min(states / 2)
}

/// Derivatives and outputs of a source at points of parameters, inputs and states; then its mass matrix, if it gives one.
pub(super) fn ask(project: &Project, model: &WorkerModel, points: &Rows) -> Result<Rows> {
    project.begin(CountedWork::Equations, model.batches(points.len()));
    let labels = model.derivatives(points, project.workers(), || project.event(Event::Advance));
    project.event(Event::End);
    labels
}

/// Random points in ranges, the same ones for the same seed; more of them begin with the same ones.
pub(super) fn random_points(ranges: &[[f64; 2]], count: usize, seed: u64) -> Rows {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut points = Rows::default();
    for _ in 0..count {
        let point: Vec<f64> = ranges.iter().map(|[min, max]| min + random.random::<f64>() * (max - min)).collect();
        points.push(&point);
    }
    points
}

/// Two values that differ by less of the largest one are the same.
pub(super) const SAME: f64 = 1e-12;

/// Number of values in its range at which the effect of a column is checked.
const COMPARED: usize = 32;

/// For each column of parameters, inputs and states, true if it changes some of the labels of a source, numbered as [`ask`] returns them.
/// Each column is compared with its lower end at values that are evenly spaced in its range, the other columns being anywhere.
pub(super) fn used(project: &Project, model: &WorkerModel, ranges: &[[f64; 2]], labels: &[usize]) -> Result<Vec<bool>> {
    let random = random_points(ranges, COMPARED, project.study.seed ^ 0x5553_4544);
    let pairs = ranges.iter().enumerate().flat_map(|(column, [min, max])| {
        random.iter().enumerate().flat_map(move |(index, point)| {
            let share = (index + 1) as f64 / COMPARED as f64;
            [*min, min + share * (max - min)].map(|value| {
                let mut point = point.to_vec();
                point[column] = value;
                point
            })
        })
    });
    let found = ask(project, model, &pairs.collect())?;
    let limits: Vec<(usize, f64)> =
        labels.iter().map(|label| (*label, SAME * found.largest_magnitude(*label))).collect();
    let differs = |pair: usize| {
        let (low, high) = (&found[2 * pair], &found[2 * pair + 1]);
        limits.iter().any(|(label, limit)| (low[*label] - high[*label]).abs() > *limit)
    };
    Ok((0..ranges.len()).map(|column| (column * COMPARED..(column + 1) * COMPARED).any(differs)).collect())
}

/// Columns of a network of these columns of `factors` and beyond: angles enter as sine and cosine.
pub(super) fn network_columns(factors: &[Factor], of: impl Iterator<Item = usize>) -> Vec<NetworkColumn> {
    let kinds = |column: usize| match factors.get(column) {
        Some(Factor::Angle) => &[ColumnKind::Sine, ColumnKind::Cosine] as &[ColumnKind],
        _ => &[ColumnKind::Plain],
    };
    of.flat_map(|of| kinds(of).iter().map(move |&kind| NetworkColumn { of, kind })).collect()
}

/// The columns of a network at some points.
pub(super) fn encoded(columns: &[NetworkColumn], points: &Rows) -> Rows {
    points.iter().map(|point| columns.iter().map(|column| column.of(point)).collect::<Vec<_>>()).collect()
}

/// The error about a surrogate whose parts do not fit together.
pub(super) fn invalid(source: FormatError) -> Error {
    Error::Surrogate { source }
}

/// Position of the exported candidate: the one that the study names, or the best.
pub(super) fn chosen(candidates: &[Candidate], options: &DynamicsOptions) -> usize {
    let named = candidates.iter().position(|candidate| Some(candidate.name.as_str()) == options.model.name());
    let is_structured = |(_, candidate): &(usize, &Candidate)| candidate.name != ACCELERATIONS;
    let best = candidates.iter().enumerate().filter(is_structured).min_by(|a, b| a.1.error.total_cmp(&b.1.error));
    named.or(best.map(|(index, _)| index)).unwrap_or(0)
}

/// Training data of a network.
#[derive(Default)]
pub(super) struct Examples {
    /// Its columns, row by row.
    pub inputs: Rows,
    /// Its expected outputs, row by row.
    pub outputs: Rows,
    /// Derivatives of both along some directions, if they are known; a training ignores those of held-out examples.
    pub tangents: Option<Directions>,
}

/// Derivatives along some directions, row by row and, in a row, direction by direction.
pub(super) struct Directions {
    /// Derivatives of the columns.
    pub inputs: Rows,
    /// Derivatives of the expected outputs.
    pub outputs: Rows,
    /// `true` for each output whose derivatives are known.
    pub known: Vec<bool>,
}

/// Network with one hidden layer of random features, whose last layer is the solution of a least-squares problem, and
/// its error, that of [`error`]. `depends[output][column]` is `true` if a column changes an output. None if there is no
/// such solution.
///
/// # Errors
/// [`Error::Interrupted`].
pub(super) fn draw(
    project: &Project,
    seen: &Examples,
    unseen: &Examples,
    depends: &[Vec<bool>],
) -> Result<Option<(ScaledNetwork, f64)>> {
    let scaling = scaling_of(seen);
    let known = seen.tangents.as_ref().map_or(vec![true; depends.len()], |tangents| tangents.known.clone());
    let samples = |examples: &Examples| {
        let (inputs, outputs) = (&examples.inputs, &examples.outputs);
        let directions = examples.tangents.as_ref().map_or(0, |tangents| tangents.inputs.len() / inputs.len().max(1));
        let mut samples = drawn::FunctionSamples { directions, ..drawn::FunctionSamples::default() };
        for row in 0..inputs.len() {
            let mut add = |input: &[f64], output: &[f64], share: f64| {
                let standardized = |value: &f64, mean: &f64, scale: &f64| (value - share * mean) / scale;
                let of = |values: &[f64], means: &[f64], scales: &[f64]| -> Vec<f64> {
                    let values = values.iter().zip(means).zip(scales);
                    values.map(|((value, mean), scale)| standardized(value, mean, scale)).collect()
                };
                samples.inputs.extend(of(input, &scaling.input_mean, &scaling.input_scale));
                samples.outputs.extend(of(output, &scaling.output_mean, &scaling.output_scale));
            };
            add(&inputs[row], &outputs[row], 1.0);
            // derivatives have no mean
            if let Some(tangents) = &examples.tangents {
                let rows = row * directions..(row + 1) * directions;
                rows.for_each(|row| add(&tangents.inputs[row], &tangents.outputs[row], 0.0));
            }
        }
        samples
    };
    let stop = project.control().stop;
    let solved = drawn::solve(&samples(seen), &samples(unseen), depends, &known, project.study.seed, stop);
    if stop.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    Ok(solved.map(|(layers, error)| (ScaledNetwork { scaling, layers }, error)))
}

/// Root mean square error of a network, of the worst output, relative to its scale.
pub(super) fn error(network: &ScaledNetwork, examples: &Examples) -> f64 {
    let found = Graph::from(network).evaluate(&examples.inputs);
    let of = |(output, scale): (usize, &f64)| {
        let rows = found.iter().zip(&examples.outputs);
        let squares: f64 = rows.map(|(found, exact)| (found[output] - exact[output]).powi(2)).sum();
        (squares / found.len().max(1) as f64).sqrt() / scale
    };
    worst(network.scaling.output_scale.iter().enumerate().map(of))
}

/// Scaling that standardizes examples.
fn scaling_of(examples: &Examples) -> Scaling {
    let ((input_mean, input_scale), (output_mean, output_scale)) =
        (scaling::of_columns(&examples.inputs), scaling::of_columns(&examples.outputs));
    Scaling { input_mean, input_scale, output_mean, output_scale }
}

/// Trains a network as the study says, on examples that are seen; the best epoch is that of those that are not. Continues from its
/// checkpoint, if there is one.
pub(super) fn train(
    project: &Project,
    [seen, unseen]: [&Examples; 2],
    checkpoints: &Checkpoints,
) -> Result<(ScaledNetwork, Outcome)> {
    let study = &project.study;
    let scaling = scaling_of(seen);
    let (inputs, outputs) = (scaling.input_mean.len(), scaling.output_mean.len());
    let rows = |examples: &Examples| {
        let x = scaling::standardize_rows(&examples.inputs, &scaling.input_mean, &scaling.input_scale);
        let y = scaling::standardize_rows(&examples.outputs, &scaling.output_mean, &scaling.output_scale);
        let rows = TrainingRows::new(inputs, outputs, x, y)?;
        let Some(directions) = &examples.tangents else { return Ok(rows) };
        rows.with_tangents(Tangents {
            directions: directions.inputs.len() / examples.inputs.len().max(1),
            inputs: scaling::standardize_rows(&directions.inputs, &vec![0.0; inputs], &scaling.input_scale),
            outputs: scaling::standardize_rows(&directions.outputs, &vec![0.0; outputs], &scaling.output_scale),
            known: directions.known.clone(),
        })
    };
    let (training_rows, validation_rows) = (rows(seen)?, rows(unseen)?);
    let network = Network::new(inputs, outputs, &study.network, study.seed)?;
    let (path, kept) = checkpoints.next()?;
    let mut follower = Follower::new(project, training_rows.len()).with_checkpoint(path.clone());
    let (options, seed, rows) = (&study.training, study.seed, [&training_rows, &validation_rows]);
    let outcome = match kept {
        None => training::train(network, rows[0], rows[1], options, seed, &mut follower)?,
        Some(bytes) => training::resume(&bytes, network, rows[0], rows[1], options, seed, &mut follower)
            .map_err(|error| unusable_checkpoint(path, error))?,
    };
    let outcome = at_least_one_epoch(project, outcome)?;
    // a Ctrl-C that ended the training is used up: what follows is quick and uses the best network
    project.control().stop.store(false, Ordering::Relaxed);
    let layers = without_constants(&outcome.network, &training_rows).to_layers();
    Ok((ScaledNetwork { scaling, layers }, outcome))
}
