//! The loss of a batch and its gradient, on all cores, with the same bits for any number of threads.
//!
//! A batch is cut into parts whose size depends on the batch alone. Each part adds up its gradient block by block in a
//! buffer of its own, whichever thread works on it; the parts are then added in their order.
//!
//! Batches of up to [`BLOCK_ROWS`] rows are one part and stay on one core: cut into 32 rows for each of two cores, a batch
//! of 64 takes longer (100 µs against 90 for 4-128-128-3), because products with so few rows are slower and the cores
//! have to meet.

use super::Rows;
use crate::network::{BLOCK_ROWS, Network, Workspace};
use rayon::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Most parts of a batch: bounds the memory and the cost of adding the parts' gradients.
const MAX_PARTS: usize = 64;

/// Working memory for the gradients of batches, and for the loss on whole sets of rows.
pub(super) struct Gradients {
    /// Most rows of a batch.
    batch: usize,
    /// Whole blocks, and no more than [`MAX_PARTS`] parts in a batch.
    part_rows: usize,
    /// `[parts, parameters]`; the sum ends in the first
    parts: Vec<f32>,
    /// `[parts]`, sums of squared errors
    losses: Vec<f64>,
    workers: Vec<Mutex<Worker>>,
}

/// What one thread needs to work on a block of rows.
struct Worker {
    inputs: Vec<f32>,
    targets: Vec<f32>,
    workspace: Workspace,
}

impl Gradients {
    /// For batches of at most `batch` rows, on the current thread pool.
    pub(super) fn new(network: &Network, batch: usize) -> Self {
        let part_rows = batch.div_ceil(MAX_PARTS * BLOCK_ROWS).max(1) * BLOCK_ROWS;
        let parts = batch.div_ceil(part_rows);
        let workers = (0..rayon::current_num_threads()).map(|_| Mutex::new(Worker::new(network))).collect();
        Self {
            batch,
            part_rows,
            parts: vec![0.0; parts * network.parameters().len()],
            losses: vec![0.0; parts],
            workers,
        }
    }

    /// Mean over rows and outputs of the squared error on the rows with the given numbers; leaves its gradient in
    /// [`gradient`](Self::gradient).
    pub(super) fn compute(&mut self, network: &Network, rows: &Rows, numbers: &[u32]) -> f64 {
        let Self { batch, part_rows, parts, losses, workers } = self;
        assert!((1..=*batch).contains(&numbers.len()), "{} rows, expected 1 to {batch}", numbers.len());
        assert_eq!((rows.n_inputs(), rows.n_outputs()), (network.inputs(), network.outputs()), "columns of the rows");
        let used = numbers.len().div_ceil(*part_rows);
        let parameters = network.parameters().len();
        let count = (numbers.len() * rows.n_outputs()) as f64;
        numbers
            .par_chunks(*part_rows)
            .zip(parts.par_chunks_exact_mut(parameters))
            .zip(losses.par_iter_mut())
            .with_max_len(1)
            .for_each(|((numbers, gradient), loss)| {
                let mut worker = own_worker(workers);
                gradient.fill(0.0);
                let blocks = numbers.chunks(BLOCK_ROWS);
                *loss = blocks.map(|block| worker.add_gradient(network, rows, block, 2.0 / count, gradient)).sum();
            });
        let (total, others) = parts[..used * parameters].split_at_mut(parameters);
        for part in others.chunks_exact(parameters) {
            total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
        }
        losses[..used].iter().sum::<f64>() / count
    }

    /// The gradient of the last batch, laid out as the parameters are.
    pub(super) fn gradient(&self, network: &Network) -> &[f32] {
        &self.parts[..network.parameters().len()]
    }

    /// Mean over rows and outputs of the squared error on all rows.
    pub(super) fn loss(&self, network: &Network, rows: &Rows, sums: &mut [f64]) -> f64 {
        let blocks = rows.inputs().par_chunks(BLOCK_ROWS * rows.n_inputs());
        let targets = rows.outputs().par_chunks(BLOCK_ROWS * rows.n_outputs());
        blocks.zip(targets).zip(sums.par_iter_mut()).for_each(|((inputs, targets), sum)| {
            let mut worker = own_worker(&self.workers);
            let outputs = network.forward(inputs, &mut worker.workspace);
            *sum = outputs.iter().zip(targets).map(|(output, target)| squared(output - target)).sum();
        });
        sums.iter().sum::<f64>() / rows.outputs().len() as f64
    }
}

impl Worker {
    fn new(network: &Network) -> Self {
        Self {
            inputs: vec![0.0; BLOCK_ROWS * network.inputs()],
            targets: vec![0.0; BLOCK_ROWS * network.outputs()],
            workspace: Workspace::new(network),
        }
    }

    /// Adds to `gradient` that of `scale / 2` times the sum of squared errors, and returns that sum.
    fn add_gradient(
        &mut self,
        network: &Network,
        rows: &Rows,
        numbers: &[u32],
        scale: f64,
        gradient: &mut [f32],
    ) -> f64 {
        let inputs = &mut self.inputs[..numbers.len() * rows.n_inputs()];
        let targets = &mut self.targets[..numbers.len() * rows.n_outputs()];
        rows.gather(numbers, inputs, targets);
        network.forward(inputs, &mut self.workspace);
        let (outputs, deltas) = self.workspace.outputs_and_deltas();
        let mut sum = 0.0;
        for ((output, target), delta) in outputs.iter().zip(&*targets).zip(deltas) {
            let error = output - target;
            *delta = scale as f32 * error;
            sum += squared(error);
        }
        network.backward(inputs, &mut self.workspace, gradient);
        sum
    }
}

/// The calling thread's worker. Never waits: each thread of the pool has one of its own.
fn own_worker(workers: &[Mutex<Worker>]) -> MutexGuard<'_, Worker> {
    let index = rayon::current_thread_index().unwrap_or(0);
    workers[index].lock().unwrap_or_else(PoisonError::into_inner)
}

fn squared(error: f32) -> f64 {
    f64::from(error) * f64::from(error)
}
