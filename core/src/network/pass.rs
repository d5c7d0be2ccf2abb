//! The passes through a network, forward and beside it backward, on blocks of rows.

use super::{
    Network,
    kernels::{
        InstructionSet, SimdKernel, SimdLanes, Store, WIDTH,
        activation::{ActivationFunction, ActivationVisitor, slope_follows_from_value, visit},
        batch_norm,
        buffer::Buffer,
        layer::{self, Slope},
    },
    layout::{LayerShape, NetworkLayout, padded, stride},
};
use metafmu_runtime::Activation;

/// Rows that pass through the network together: enough for the matrix products to reach their speed, few enough for
/// activations and deltas to stay in the cache of one core.
pub(crate) const BLOCK_ROWS: usize = 64;

/// A network whose parameters are laid out as the kernels need them.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    pub(crate) layout: NetworkLayout,
    pub(super) activation: Activation,
    pub(crate) parameters: Buffer,
    /// The weights again, as the backward pass reads them.
    pub(crate) transposed: Buffer,
    /// Share of the hidden nodes that is left out in training.
    dropout: f64,
}

/// Inputs, activations and deltas of at most [`BLOCK_ROWS`] rows, at a distance of [`stride`].
pub(crate) struct Workspace {
    pub(crate) simd: InstructionSet,
    /// `x, y_1 ... y_L`
    pub(super) values: Vec<Buffer>,
    /// `d_1 ... d_L`
    pub(super) deltas: Vec<Buffer>,
    /// `f'` of each hidden layer, unless it follows from `y`.
    slopes: Vec<Buffer>,
    /// Normalized values of each hidden layer that is normalized.
    normalized: Vec<Buffer>,
    statistics: Vec<Buffer>,
    /// Derivatives by the biases of the layer at hand.
    pub(super) bias: Buffer,
}

/// Selects the dropped nodes of each row: the same for any number of threads.
#[derive(Clone, Copy)]
pub(crate) struct DropoutMask<'a> {
    pub(crate) seed: u64,
    /// Step number of the optimizer.
    pub(crate) step: u64,
    /// The numbers of the rows.
    pub(crate) rows: &'a [u32],
}

impl Packed {
    pub(crate) fn new(network: &Network) -> Self {
        Self::with(network, false, 0.0)
    }

    /// For a training with normalization or with a share of the hidden nodes left out.
    pub(crate) fn with(network: &Network, batch_norm: bool, dropout: f64) -> Self {
        let layout = NetworkLayout::new(network.sizes(), batch_norm);
        let (parameters, transposed) = (Buffer::zeros(layout.len()), Buffer::zeros(layout.transposed_len()));
        let mut packed = Self { layout, activation: network.activation(), parameters, transposed, dropout };
        packed.layout.pack(network.parameters(), &mut packed.parameters);
        packed.transpose();
        packed
    }

    /// Takes over the parameters of a network of the same sizes.
    pub(crate) fn set(&mut self, plain: &[f32]) {
        self.layout.pack(plain, &mut self.parameters);
        self.transpose();
    }

    /// Renews the transposed weights.
    pub(crate) fn transpose(&mut self) {
        for piece in &self.layout.pieces {
            let (shape, transposed) = (&self.layout.shapes[piece.layer], &mut self.transposed);
            piece.transpose(shape, &self.parameters[piece.range.clone()], |range, fill| fill(&mut transposed[range]));
        }
    }

    /// Outputs at the first `rows` rows of [`Workspace::inputs_mut`]; see [`Workspace::outputs`].
    pub(crate) fn forward(&self, rows: usize, workspace: &mut Workspace) {
        workspace.simd.run(ForwardPass { network: self, rows, workspace, mask: None });
    }

    /// As [`forward`](Self::forward), with what [`backward`](Self::backward) needs, normalization over the rows, and some
    /// nodes left out.
    pub(crate) fn forward_in_training(&self, workspace: &mut Workspace, mask: DropoutMask) {
        workspace.simd.run(ForwardPass { network: self, rows: mask.rows.len(), workspace, mask: Some(mask) });
    }

    /// Puts into or onto `gradient`, laid out as the parameters are, the loss's derivatives by the parameters, given
    /// its derivatives by the outputs ([`Workspace::outputs_and_deltas`]) and what
    /// [`forward_in_training`](Self::forward_in_training) left in the workspace.
    pub(crate) fn backward(&self, rows: usize, workspace: &mut Workspace, store: Store, gradient: &mut [f32]) {
        workspace.simd.run(BackwardPass { network: self, rows, workspace, store, gradient });
    }

    /// The loss's derivatives by the first `columns` inputs, `[rows, columns]`, after [`backward`](Self::backward). The network has
    /// hidden layers.
    pub(crate) fn input_deltas(&self, rows: usize, workspace: &mut Workspace, columns: usize, to: &mut [f32]) {
        workspace.simd.run(InputDeltas { network: self, rows, deltas: &workspace.deltas[0], columns, to });
    }

    pub(super) fn stores_slopes(&self) -> bool {
        !slope_follows_from_value(self.activation) || self.dropout > 0.0 || self.layout.shapes[0].normalized
    }
}

struct ForwardPass<'a> {
    network: &'a Packed,
    rows: usize,
    workspace: &'a mut Workspace,
    mask: Option<DropoutMask<'a>>,
}

impl SimdKernel for ForwardPass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { network, rows, workspace, mask } = self;
        let Packed { layout, activation, parameters, dropout, .. } = network;
        let Workspace { values, slopes, normalized, statistics, .. } = workspace;
        for (index, shape) in layout.shapes.iter().enumerate() {
            let (before, after) = values.split_at_mut(index + 1);
            let (x, y) = (&before[index], &mut *after[0]);
            let hidden = index + 1 < layout.shapes.len();
            let mut slopes = if mask.is_some() { slopes.get_mut(index).map(|slopes| &mut **slopes) } else { None };
            let function = if hidden && !shape.normalized { *activation } else { Activation::Identity };
            let slopes_now = if shape.normalized { None } else { slopes.as_deref_mut() };
            layer::forward::<L>(shape, parameters, function, rows, x, y, slopes_now);
            if let (true, Some(slopes)) = (shape.normalized, &mut slopes) {
                let (v, statistics) = (&mut normalized[index], &mut statistics[index]);
                let normalize = Normalize { shape, parameters, rows, y, v, slopes, statistics };
                visit::<L, _>(*activation, normalize);
            }
            if let (Some(mask), Some(slopes), true) = (mask, slopes, hidden && *dropout > 0.0) {
                leave_out(*dropout, mask, index, shape.outputs, y, slopes);
            }
        }
    }
}

/// The arguments of [`batch_norm::forward`].
struct Normalize<'a> {
    shape: &'a LayerShape,
    parameters: &'a [f32],
    rows: usize,
    y: &'a mut [f32],
    v: &'a mut [f32],
    slopes: &'a mut [f32],
    statistics: &'a mut [f32],
}

impl ActivationVisitor for Normalize<'_> {
    type Output = ();

    #[inline(always)]
    fn visit<L: SimdLanes, F: ActivationFunction>(self) {
        let Self { shape, parameters, rows, y, v, slopes, statistics } = self;
        batch_norm::forward::<L, F>(shape, parameters, rows, y, v, slopes, statistics);
    }
}

/// Sets a share of the values and slopes to zero, and makes the others larger by as much.
fn leave_out(share: f64, mask: DropoutMask, layer: usize, nodes: usize, values: &mut [f32], slopes: &mut [f32]) {
    let (distance, factor) = (stride(nodes), (1.0 - share).recip() as f32);
    let limit = (share * 65_536.0) as u64;
    let rows = values.chunks_exact_mut(distance).zip(slopes.chunks_exact_mut(distance));
    for ((values, slopes), &row) in rows.zip(mask.rows) {
        let key = [mask.step, layer as u64, row.into()].iter().fold(mask.seed, |key, &part| mix(key ^ part));
        // 16 random bits for each node, four nodes at a time
        for (index, (values, slopes)) in values[..nodes].chunks_mut(4).zip(slopes.chunks_mut(4)).enumerate() {
            let mut bits = mix(key.wrapping_add(index as u64));
            for (value, slope) in values.iter_mut().zip(slopes) {
                let factor = if bits & 0xffff < limit { 0.0 } else { factor };
                *value *= factor;
                *slope *= factor;
                bits >>= 16;
            }
        }
    }
}

/// Steele and others 2014, SplitMix64: numbers that follow each other become random ones.
fn mix(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

struct BackwardPass<'a> {
    network: &'a Packed,
    rows: usize,
    workspace: &'a mut Workspace,
    store: Store,
    gradient: &'a mut [f32],
}

impl SimdKernel for BackwardPass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { network, rows, workspace, store, gradient } = self;
        let Workspace { values, deltas, slopes, normalized, statistics, .. } = workspace;
        let Packed { parameters, transposed, activation, .. } = network;
        for (index, shape) in network.layout.shapes.iter().enumerate().rev() {
            let (before, from) = deltas.split_at_mut(index);
            let d = &mut *from[0];
            if shape.normalized {
                let (v, statistics) = (&normalized[index], &statistics[index]);
                batch_norm::backward::<L>(shape, parameters, rows, v, statistics, d, store, gradient);
            }
            layer::gradient::<L>(shape, rows, &values[index], d, store, gradient);
            if let Some(to) = before.last_mut() {
                let slope = match slopes.get(index - 1) {
                    Some(slopes) => Slope::Stored(slopes),
                    None => Slope::FromValue(*activation, &values[index]),
                };
                layer::backward::<L>(shape, parameters, transposed, slope, rows, d, to);
            }
        }
    }
}

struct InputDeltas<'a> {
    network: &'a Packed,
    rows: usize,
    /// Deltas of the first layer.
    deltas: &'a [f32],
    columns: usize,
    to: &'a mut [f32],
}

impl SimdKernel for InputDeltas<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { network, rows, deltas, columns, to } = self;
        let shape = &network.layout.shapes[0];
        debug_assert!(!shape.by_rows, "a network with hidden layers");
        let weights = shape.split(&network.parameters).0.as_chunks::<WIDTH>().0;
        let rows = deltas.chunks_exact(stride(shape.outputs)).zip(to.chunks_exact_mut(columns)).take(rows);
        for (deltas, to) in rows {
            for (column, to) in to.iter_mut().enumerate() {
                let mut sum = L::splat(0.0);
                let panels = deltas.as_chunks::<WIDTH>().0.iter().take(padded(shape.outputs) / WIDTH);
                for (panel, deltas) in panels.enumerate() {
                    sum = L::load(&weights[panel * shape.inputs + column]).mul_add(L::load(deltas), sum);
                }
                *to = sum.sum();
            }
        }
    }
}

impl Workspace {
    pub(crate) fn new(network: &Packed) -> Self {
        let shapes = &network.layout.shapes;
        let hidden = &shapes[..shapes.len() - 1];
        let buffer = |columns| Buffer::zeros(BLOCK_ROWS * stride(columns));
        let of = |shapes: &[LayerShape]| shapes.iter().map(|shape| buffer(shape.outputs)).collect();
        let slopes: &[LayerShape] = if network.stores_slopes() { hidden } else { &[] };
        let normalized: &[LayerShape] = if shapes[0].normalized { hidden } else { &[] };
        let statistics = normalized.iter().map(|shape| Buffer::zeros(batch_norm::STATISTICS * padded(shape.outputs)));
        Self {
            simd: InstructionSet::detect(),
            values: std::iter::once(buffer(shapes[0].inputs)).chain(of(shapes) as Vec<Buffer>).collect(),
            deltas: of(shapes),
            slopes: of(slopes),
            normalized: of(normalized),
            statistics: statistics.collect(),
            bias: Buffer::zeros(shapes.iter().map(|shape| padded(shape.outputs)).max().unwrap_or(0)),
        }
    }

    /// Where [`Packed::forward`] expects the inputs: rows of `stride(inputs)`; the padding after the inputs stays zero.
    pub(crate) fn inputs_mut(&mut self) -> &mut [f32] {
        &mut self.values[0]
    }

    /// Outputs of [`Packed::forward`]: rows of `stride(outputs)`.
    pub(crate) fn outputs(&self) -> &[f32] {
        &self.values[self.values.len() - 1]
    }

    /// The outputs, and where [`Packed::backward`] expects the loss's derivatives by them, in rows of the same distance.
    pub(crate) fn outputs_and_deltas(&mut self) -> (&[f32], &mut [f32]) {
        let last = self.deltas.len() - 1;
        (&self.values[last + 1], &mut self.deltas[last])
    }

    /// Statistics of the normalized layers: mean, variance and more of each node over the last block.
    pub(crate) fn statistics(&self) -> impl Iterator<Item = &[f32]> {
        self.statistics.iter().map(|statistics| &**statistics)
    }
}
