//! The loss of a batch and its gradient, on all members of a team, with the same bits for any number of them.
//!
//! A batch is cut into parts whose number depends on the batch alone. Each part adds up its gradient block by block in
//! a separate buffer, whichever thread works on it; the parts are added in their order, by [`Gradients::sum_piece`].

use super::{
    Tangents, TrainingRows,
    loss::LossFunction,
    recurrence::{StretchBlock, Unrolled},
    team::{Divided, Team},
};
use crate::network::{
    BLOCK_ROWS, DropoutMask, Packed, Workspace, block_rows,
    kernels::{InstructionSet, SimdKernel, SimdLanes, Store, WIDTH, buffer::Buffer},
    layout::{padded, stride},
};
use crate::study::TrainingOptions;
use std::{
    ops::Range,
    sync::{Mutex, MutexGuard, PoisonError},
};

/// Most parts of a batch: bounds the memory and the cost of adding the parts' gradients, which are to stay in the cache.
const MAX_PARTS: usize = 8;

/// Rows of a part at least: with fewer, products are slower than it is worth.
const MIN_PART_ROWS: usize = 32;

/// Working memory for the gradients of batches, and for the loss on whole sets of rows.
pub(super) struct Gradients {
    /// Most rows of a batch.
    batch: usize,
    simd: InstructionSet,
    function: LossFunction,
    parts: Vec<BatchPart>,
    /// One for each member.
    workspaces: Vec<Mutex<Unrolled>>,
}

/// A part of the batch.
struct BatchPart {
    /// Laid out as the packed parameters are.
    gradient: Buffer,
    /// Sum over its rows.
    loss: f64,
    /// Means and variances of each normalized layer, `[2, padded(outputs)]`, summed over its rows.
    statistics: Vec<Buffer>,
}

/// The gradients of the parts of a batch, while they are added piece by piece.
pub(super) struct Sum<'a> {
    simd: InstructionSet,
    first: Divided<'a, f32>,
    others: &'a [BatchPart],
}

impl Gradients {
    /// For batches of at most `batch` rows and teams of at most `members`.
    pub(super) fn new(network: &Packed, options: &TrainingOptions, batch: usize, members: usize) -> Self {
        let outputs = network.layout.shapes[network.layout.shapes.len() - 1].outputs;
        let normalized = network.layout.shapes.iter().filter(|shape| shape.normalized);
        let parts = (0..parts(batch)).map(|_| BatchPart {
            gradient: Buffer::zeros(network.layout.len()),
            loss: 0.0,
            statistics: normalized.clone().map(|shape| Buffer::zeros(2 * padded(shape.outputs))).collect(),
        });
        Self {
            batch,
            simd: InstructionSet::detect(),
            function: LossFunction::new(options, outputs),
            parts: parts.collect(),
            workspaces: (0..members).map(|_| Mutex::new(Unrolled::new(network))).collect(),
        }
    }

    /// Mean loss over the outputs of the rows with the given numbers; leaves the gradients of its parts for
    /// [`sum`](Self::sum). `seed` and `step` decide which nodes are dropped.
    pub(super) fn compute(
        &mut self,
        team: &mut Team,
        network: &Packed,
        rows: &TrainingRows,
        numbers: &[u32],
        (seed, step): (u64, u64),
    ) -> f64 {
        let Self { batch, function, parts: all, workspaces, .. } = self;
        assert!((1..=*batch).contains(&numbers.len()), "{} rows, expected 1 to {batch}", numbers.len());
        let shapes = &network.layout.shapes;
        let columns = (shapes[0].inputs, shapes[shapes.len() - 1].outputs);
        assert_eq!((rows.n_inputs(), rows.n_outputs()), columns, "columns of the rows");
        let used = parts(numbers.len());
        let count = (numbers.len() * rows.targets() / rows.len()) as f64;
        let tangents = rows.tangents().filter(|tangents| network.takes_tangents(tangents.directions));
        let of_tangents = tangents.map(|tangents| (tangents, function.of(&tangents.known)));
        let most = tangents.map_or(BLOCK_ROWS, |tangents| block_rows(tangents.directions));
        let divided = Divided::new(&mut all[..used]);
        team.for_each(used, |member, index| {
            // SAFETY: one part for each item
            let part = unsafe { &mut divided.range(index..index + 1)[0] };
            let mut unrolled = lock(&workspaces[member]);
            let numbers = &numbers[index * numbers.len() / used..(index + 1) * numbers.len() / used];
            part.loss = 0.0;
            part.statistics.iter_mut().for_each(|statistics| statistics.fill(0.0));
            let mut store = Store::Replace;
            // blocks of nearly equal size: a small one would be normalized badly
            let blocks = numbers.len().div_ceil(most);
            for block in 0..blocks {
                let numbers = &numbers[block * numbers.len() / blocks..(block + 1) * numbers.len() / blocks];
                if let Some(recurrence) = rows.recurrence() {
                    let block = StretchBlock { network, rows, recurrence, function, numbers };
                    let scale = (1.0 / count) as f32;
                    part.loss += block.gradient((seed, step), scale, store, &mut unrolled, &mut part.gradient);
                    store = Store::Add;
                    continue;
                }
                let workspace = &mut unrolled.workspaces[0];
                gather(rows, numbers, workspace);
                if let Some((tangents, of_tangents)) = &of_tangents {
                    let shape = (numbers.len(), tangents.directions);
                    gather_tangents(rows, tangents, numbers, workspace);
                    network.forward_with_tangents(shape, workspace);
                    part.loss += sum_of_losses(function, workspace, rows, numbers, 1.0 / count);
                    part.loss += sum_of_tangents(of_tangents, workspace, (rows, tangents), numbers, 1.0 / count);
                    network.backward_with_tangents(shape, workspace, store, &mut part.gradient);
                    store = Store::Add;
                    continue;
                }
                network.forward_in_training(workspace, DropoutMask { seed, step, rows: numbers });
                part.loss += sum_of_losses(function, workspace, rows, numbers, 1.0 / count);
                network.backward(numbers.len(), workspace, store, &mut part.gradient);
                part.add_statistics(numbers.len(), workspace);
                store = Store::Add;
            }
        });
        self.parts[..used].iter().map(|part| part.loss).sum::<f64>() / count
    }

    /// To add the gradients of the parts of the last batch, which had `rows` rows; `done`: they have been added already.
    pub(super) fn sum(&mut self, rows: usize, done: bool) -> Sum<'_> {
        let used = if done { 1 } else { parts(rows) };
        let (first, others) = self.parts[..used].split_at_mut(1);
        Sum { simd: self.simd, first: Divided::new(&mut first[0].gradient), others }
    }

    /// The gradient of the last batch, laid out as the packed parameters are, once all its pieces are added.
    pub(super) fn total(&self) -> &[f32] {
        &self.parts[0].gradient
    }

    /// Takes the means and variances of the nodes of a normalized layer over the last batch, which had `rows` rows, into
    /// running ones, with this share.
    pub(super) fn blend_statistics(&self, rows: usize, layer: usize, share: f32, running: &mut [f32]) {
        for (index, running) in running.iter_mut().enumerate() {
            let sum: f32 = self.parts[..parts(rows)].iter().map(|part| part.statistics[layer][index]).sum();
            *running += share * (sum / rows as f32 - *running);
        }
    }

    /// Mean loss over the outputs of all rows; `sums`: one place for every [`BLOCK_ROWS`] rows.
    pub(super) fn loss(&self, team: &mut Team, network: &Packed, rows: &TrainingRows, sums: &mut [f64]) -> f64 {
        let blocks = rows.len().div_ceil(BLOCK_ROWS);
        let divided = Divided::new(&mut sums[..blocks]);
        team.for_each(blocks, |member, index| {
            let numbers = index * BLOCK_ROWS..((index + 1) * BLOCK_ROWS).min(rows.len());
            let mut unrolled = lock(&self.workspaces[member]);
            let mut block = [0; BLOCK_ROWS];
            block.iter_mut().zip(numbers.clone()).for_each(|(to, number)| *to = number as u32);
            // SAFETY: one place for each item
            let sum = unsafe { &mut divided.range(index..index + 1)[0] };
            let numbers = &block[..numbers.len()];
            if let Some(recurrence) = rows.recurrence() {
                *sum =
                    StretchBlock { network, rows, recurrence, function: &self.function, numbers }.loss(&mut unrolled);
                return;
            }
            let workspace = &mut unrolled.workspaces[0];
            gather(rows, numbers, workspace);
            network.forward(numbers.len(), workspace);
            *sum = sum_of_losses(&self.function, workspace, rows, numbers, 0.0);
        });
        sums[..blocks].iter().sum::<f64>() / rows.targets() as f64
    }
}

/// Number of parts of a batch.
fn parts(rows: usize) -> usize {
    (rows / MIN_PART_ROWS).clamp(1, MAX_PARTS)
}

impl BatchPart {
    fn add_statistics(&mut self, rows: usize, workspace: &Workspace) {
        for (sums, of_block) in self.statistics.iter_mut().zip(workspace.statistics()) {
            let (count, width) = (rows as f32, sums.len() / 2);
            let (means, variances) = sums.split_at_mut(width);
            means.iter_mut().zip(of_block).for_each(|(sum, mean)| *sum += count * mean);
            // that of the population, as in PyTorch
            let weight = if rows > 1 { count * count / (count - 1.0) } else { 1.0 };
            variances.iter_mut().zip(&of_block[width..]).for_each(|(sum, variance)| *sum += weight * variance);
        }
    }
}

/// Puts the inputs of at most [`BLOCK_ROWS`] rows into the workspace.
fn gather(rows: &TrainingRows, numbers: &[u32], workspace: &mut Workspace) {
    let n_inputs = rows.n_inputs();
    for &number in numbers {
        rows.prefetch(number as usize);
    }
    for (to, &number) in workspace.inputs_mut().chunks_exact_mut(stride(n_inputs)).zip(numbers) {
        let row = &rows.inputs()[number as usize * n_inputs..][..n_inputs];
        // a row is too short for a call of `memcpy`
        to.iter_mut().zip(row).for_each(|(to, value)| *to = *value);
    }
}

/// Sum of the losses of the rows whose outputs are in the workspace, and `scale` times its derivatives as deltas.
fn sum_of_losses(
    function: &LossFunction,
    workspace: &mut Workspace,
    rows: &TrainingRows,
    numbers: &[u32],
    scale: f64,
) -> f64 {
    let n_outputs = rows.n_outputs();
    let (outputs, deltas) = workspace.outputs_and_deltas();
    let distance = stride(n_outputs);
    let outputs = outputs.chunks_exact(distance).zip(deltas.chunks_exact_mut(distance));
    let losses = outputs.zip(numbers).map(|((outputs, deltas), &number)| {
        let targets = &rows.outputs()[number as usize * n_outputs..][..n_outputs];
        function.row(outputs, targets, scale as f32, deltas)
    });
    losses.sum()
}

/// Puts the derivatives of the inputs after those of the rows: direction by direction.
fn gather_tangents(rows: &TrainingRows, tangents: &Tangents, numbers: &[u32], workspace: &mut Workspace) {
    let (n_inputs, directions) = (rows.n_inputs(), tangents.directions);
    let places = workspace.inputs_mut().chunks_exact_mut(stride(n_inputs)).skip(numbers.len());
    let sources = (0..directions).flat_map(|direction| {
        numbers.iter().map(move |&number| &tangents.inputs[(number as usize * directions + direction) * n_inputs..])
    });
    for (to, row) in places.zip(sources) {
        to[..n_inputs].copy_from_slice(&row[..n_inputs]);
    }
}

/// As [`sum_of_losses`], of the derivatives.
fn sum_of_tangents(
    function: &LossFunction,
    workspace: &mut Workspace,
    (rows, tangents): (&TrainingRows, &Tangents),
    numbers: &[u32],
    scale: f64,
) -> f64 {
    let (n_outputs, directions) = (rows.n_outputs(), tangents.directions);
    let distance = stride(n_outputs);
    let (outputs, deltas) = workspace.outputs_and_deltas();
    let places = outputs.chunks_exact(distance).zip(deltas.chunks_exact_mut(distance)).skip(numbers.len());
    let targets = (0..directions).flat_map(|direction| {
        numbers.iter().map(move |&number| &tangents.outputs[(number as usize * directions + direction) * n_outputs..])
    });
    let losses = places
        .zip(targets)
        .map(|((outputs, deltas), targets)| function.row(outputs, &targets[..n_outputs], scale as f32, deltas));
    losses.sum()
}

impl Sum<'_> {
    /// The gradient of a piece of the parameters.
    ///
    /// # Safety
    /// As long as the result lives, no other piece that overlaps with this one is requested.
    #[expect(clippy::mut_from_ref, reason = "the caller keeps the pieces apart")]
    pub(super) unsafe fn piece(&self, range: Range<usize>) -> &mut [f32] {
        // SAFETY: as the caller promises
        let total = unsafe { self.first.range(range.clone()) };
        if !self.others.is_empty() {
            self.simd.run(AddParts { total, others: self.others, range });
        }
        total
    }
}

struct AddParts<'a> {
    total: &'a mut [f32],
    others: &'a [BatchPart],
    range: Range<usize>,
}

impl SimdKernel for AddParts<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { total, others, range } = self;
        for part in others {
            let part = part.gradient[range.clone()].as_chunks::<WIDTH>().0;
            for (total, part) in total.as_chunks_mut::<WIDTH>().0.iter_mut().zip(part) {
                L::load(total).add(L::load(part)).store(total);
            }
        }
    }
}

fn lock(workspace: &Mutex<Unrolled>) -> MutexGuard<'_, Unrolled> {
    workspace.lock().unwrap_or_else(PoisonError::into_inner)
}
