//! The passes through a network, forward and beside it backward, on blocks of rows.

use super::{
    Network,
    kernels::{
        Kernel, Register, Simd,
        buffer::Buffer,
        layer::{self, Slope, Store},
    },
    layout::{Layout, stride},
};
use metafmu_runtime::Activation;

/// Rows that pass through the network together: enough for the matrix products to reach their speed, few enough for
/// activations and deltas to stay in the cache of one core.
pub(crate) const BLOCK_ROWS: usize = 64;

/// A network whose parameters lie as the kernels want them.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    pub(crate) layout: Layout,
    activation: Activation,
    pub(crate) parameters: Buffer,
    /// The weights once more, as the backward pass reads them.
    pub(crate) turned: Buffer,
}

/// Inputs, activations and deltas of at most [`BLOCK_ROWS`] rows, at a distance of [`stride`].
pub(crate) struct Workspace {
    pub(crate) simd: Simd,
    /// `x, y_1 ... y_L`
    values: Vec<Buffer>,
    /// `d_1 ... d_L`
    deltas: Vec<Buffer>,
}

impl Packed {
    pub(crate) fn new(network: &Network) -> Self {
        let layout = Layout::new(network.sizes());
        let (parameters, turned) = (Buffer::zeros(layout.len()), Buffer::zeros(layout.turned_len()));
        let mut packed = Self { layout, activation: network.activation(), parameters, turned };
        packed.set(network.parameters());
        packed
    }

    /// Takes over the parameters of a network of the same sizes.
    pub(crate) fn set(&mut self, plain: &[f32]) {
        self.layout.pack(plain, &mut self.parameters);
        for piece in &self.layout.pieces {
            let (shape, turned) = (&self.layout.shapes[piece.layer], &mut self.turned);
            piece.turn(shape, &self.parameters[piece.range.clone()], |range, fill| fill(&mut turned[range]));
        }
    }

    /// Outputs at the first `rows` rows of [`Workspace::inputs_mut`]; see [`Workspace::outputs`].
    pub(crate) fn forward(&self, rows: usize, workspace: &mut Workspace) {
        workspace.simd.run(Forward { network: self, rows, workspace });
    }

    /// Puts into or onto `gradient`, laid out as the parameters are, the loss's derivatives by the parameters, given
    /// its derivatives by the outputs ([`Workspace::outputs_and_deltas`]) and what [`forward`](Self::forward) left in
    /// the workspace.
    pub(crate) fn backward(&self, rows: usize, workspace: &mut Workspace, store: Store, gradient: &mut [f32]) {
        workspace.simd.run(Backward { network: self, rows, workspace, store, gradient });
    }
}

struct Forward<'a> {
    network: &'a Packed,
    rows: usize,
    workspace: &'a mut Workspace,
}

impl Kernel for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<R: Register, const N: usize>(self) {
        let Self { network, rows, workspace } = self;
        let shapes = &network.layout.shapes;
        for (index, shape) in shapes.iter().enumerate() {
            let (before, after) = workspace.values.split_at_mut(index + 1);
            let activation = (index + 1 < shapes.len()).then_some(network.activation);
            layer::forward::<R, N>(shape, &network.parameters, activation, rows, &before[index], &mut after[0]);
        }
    }
}

struct Backward<'a> {
    network: &'a Packed,
    rows: usize,
    workspace: &'a mut Workspace,
    store: Store,
    gradient: &'a mut [f32],
}

impl Kernel for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<R: Register, const N: usize>(self) {
        let Self { network, rows, workspace, store, gradient } = self;
        let Workspace { values, deltas, .. } = workspace;
        for (index, shape) in network.layout.shapes.iter().enumerate().rev() {
            let (before, from) = deltas.split_at_mut(index);
            layer::gradient::<R, N>(shape, rows, &values[index], &from[0], store, gradient);
            if let Some(to) = before.last_mut() {
                let slope = Slope::OfValue(network.activation, &values[index]);
                let Packed { parameters, turned, .. } = network;
                layer::backward::<R, N>(shape, parameters, turned, slope, rows, &from[0], to);
            }
        }
    }
}

impl Workspace {
    pub(crate) fn new(network: &Packed) -> Self {
        let shapes = &network.layout.shapes;
        let buffer = |columns| Buffer::zeros(BLOCK_ROWS * stride(columns));
        let outputs = || shapes.iter().map(|shape| buffer(shape.outputs));
        Self {
            simd: Simd::detect(),
            values: std::iter::once(buffer(shapes[0].inputs)).chain(outputs()).collect(),
            deltas: outputs().collect(),
        }
    }

    /// Where [`Packed::forward`] expects the inputs: rows of `stride(inputs)`; what is behind an input stays zero.
    pub(crate) fn inputs_mut(&mut self) -> &mut [f32] {
        &mut self.values[0]
    }

    /// What [`Packed::forward`] computed: rows of `stride(outputs)`.
    pub(crate) fn outputs(&self) -> &[f32] {
        &self.values[self.values.len() - 1]
    }

    /// The outputs, and where [`Packed::backward`] expects the loss's derivatives by them, in rows of the same distance.
    pub(crate) fn outputs_and_deltas(&mut self) -> (&[f32], &mut [f32]) {
        let last = self.deltas.len() - 1;
        (&self.values[last + 1], &mut self.deltas[last])
    }
}
