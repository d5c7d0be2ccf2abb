//! The feed-forward network in single precision: its parameters, its forward pass and, beside it, its backward pass.
//!
//! ```text
//! sizes                  n_0 (inputs), n_1, ..., n_L (outputs)
//! layer k = 1 ... L      W_k [n_k, n_(k-1)] row by row, b_k [n_k]
//! parameters             W_1 | b_1 | W_2 | b_2 | ... | W_L | b_L     one block, so that an optimizer is one loop
//! gradient               the same layout as the parameters
//! activations, deltas    [rows, n_k] row by row
//!
//! forward    y_0 = x,  y_k = f(y_(k-1) W_k^T + b_k),  f the identity for k = L
//! backward   d_k = (dloss/dy_k) f'   dW_k = d_k^T y_(k-1)   db_k = sum over rows of d_k   dloss/dy_(k-1) = d_k W_k
//! ```

pub(crate) mod kernels;
pub(crate) mod layout;
mod pass;
mod tangent;

use crate::study::NetworkOptions;
use layout::stride;
use metafmu_runtime::{Activation, Layer};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;

pub(crate) use pass::{BLOCK_ROWS, DropoutMask, Packed, Workspace};
pub(crate) use tangent::block_rows;

/// A feed-forward network: dense layers, the hidden ones with an activation, the last one linear.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    activation: Activation,
    sizes: Vec<usize>,
    parameters: Vec<f32>,
}

/// Reason why a network cannot be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// A layer without nodes.
    #[error("layer {layer} of the network has no nodes (layer 0: the inputs)")]
    EmptyLayer {
        /// Counted from the inputs, which are layer 0.
        layer: usize,
    },
    /// No layer at all.
    #[error("a network needs at least one layer")]
    NoLayers,
    /// A layer with another activation than the network has there.
    #[error("layer {layer} of the network has the activation {found:?}, expected {expected:?}")]
    LayerActivation {
        /// Counted from the inputs, which are layer 0.
        layer: usize,
        /// Activation of the hidden layers, or the identity for the last one.
        expected: Activation,
        /// Activation of the layer.
        found: Activation,
    },
    /// Weights that this network, which is trained in single precision, cannot hold.
    #[error("layer {layer} of the network has weights in double precision, expected single precision")]
    Precision {
        /// Counted from the inputs, which are layer 0.
        layer: usize,
    },
    /// A layer that does not fit the one before it, or whose weights and biases do not fit its size.
    #[error("layer {layer} of the network does not fit: expected {expected} {what}, found {found}")]
    LayerShape {
        /// Counted from the inputs, which are layer 0.
        layer: usize,
        /// Counted items: `inputs`, `weights` or `biases`.
        what: &'static str,
        /// The expected number.
        expected: usize,
        /// The number found.
        found: usize,
    },
}

/// Views of one layer's part of a block laid out as the parameters are.
struct LayerView<'a> {
    inputs: usize,
    outputs: usize,
    weight: &'a [f32],
    bias: &'a [f32],
}

impl Network {
    /// A network to be trained. Weights and biases are uniform within `±1 / sqrt(inputs of the layer)`, drawn in the
    /// order of the parameters; a seed gives the same network on every machine.
    ///
    /// # Errors
    /// [`NetworkError::EmptyLayer`] if a size is zero.
    pub fn new(inputs: usize, outputs: usize, options: &NetworkOptions, seed: u64) -> Result<Self, NetworkError> {
        let sizes: Vec<usize> = [&[inputs], options.hidden.as_slice(), &[outputs]].concat();
        if let Some(layer) = sizes.iter().position(|&size| size == 0) {
            return Err(NetworkError::EmptyLayer { layer });
        }
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut parameters = Vec::with_capacity(count_parameters(&sizes));
        for pair in sizes.windows(2) {
            let (inputs, outputs) = (pair[0], pair[1]);
            let bound = 1.0 / (inputs as f32).sqrt();
            parameters.extend((0..(inputs + 1) * outputs).map(|_| bound * (2.0 * random.random::<f32>() - 1.0)));
        }
        Ok(Self { activation: options.activation, sizes, parameters })
    }

    /// The network of a surrogate, for instance to train it further.
    ///
    /// # Errors
    /// A [`NetworkError`] if there are no layers, a layer is empty, or layers do not fit each other. Also if a hidden
    /// layer has another activation, the last one is not linear, or weights are in double precision.
    pub fn from_layers(layers: &[Layer], activation: Activation) -> Result<Self, NetworkError> {
        let mut sizes = vec![layers.first().ok_or(NetworkError::NoLayers)?.inputs];
        let mut parameters = Vec::new();
        for (index, layer) in layers.iter().enumerate() {
            if layer.inputs == 0 || layer.outputs == 0 {
                return Err(NetworkError::EmptyLayer { layer: index + usize::from(layer.inputs > 0) });
            }
            let last = index + 1 == layers.len();
            let expected = if last { Activation::Identity } else { activation };
            if layer.activation != expected {
                return Err(NetworkError::LayerActivation { layer: index + 1, expected, found: layer.activation });
            }
            for (what, expected, found) in [
                ("inputs", sizes[index], layer.inputs),
                ("weights", layer.inputs * layer.outputs, layer.weight.len()),
                ("biases", layer.outputs, layer.bias.len()),
            ] {
                if found != expected {
                    return Err(NetworkError::LayerShape { layer: index + 1, what, expected, found });
                }
            }
            sizes.push(layer.outputs);
            for numbers in [&layer.weight, &layer.bias] {
                parameters.extend_from_slice(numbers.as_single().ok_or(NetworkError::Precision { layer: index + 1 })?);
            }
        }
        Ok(Self { activation, sizes, parameters })
    }

    /// The layers as they are in the model file.
    pub fn to_layers(&self) -> Vec<Layer> {
        let last = self.sizes.len() - 2;
        let layers = self.layers().enumerate().map(|(index, view)| Layer {
            inputs: view.inputs,
            outputs: view.outputs,
            weight: view.weight.to_vec().into(),
            bias: view.bias.to_vec().into(),
            activation: if index == last { Activation::Identity } else { self.activation },
        });
        layers.collect()
    }

    /// Makes an output zero whatever the inputs are.
    ///
    /// # Panics
    /// If there is no such output.
    pub fn clear_output(&mut self, output: usize) {
        let (inputs, outputs) = (self.sizes[self.sizes.len() - 2], self.outputs());
        let last = self.parameters.len() - (inputs + 1) * outputs;
        let (weight, bias) = self.parameters[last..].split_at_mut(inputs * outputs);
        weight[output * inputs..][..inputs].fill(0.0);
        bias[output] = 0.0;
    }

    /// Number of inputs, of nodes of each hidden layer, and of outputs.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.sizes[0]
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// Activation of the hidden layers.
    pub fn activation(&self) -> Activation {
        self.activation
    }

    /// All weights and biases in one block: `W_1 | b_1 | W_2 | b_2 | ...`, each `W` of shape `[outputs, inputs]` row by row.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// [`Self::parameters`], to write.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
    }

    /// Standardized outputs `[rows, outputs]` at standardized inputs `[rows, inputs]`, on all cores; the values do not
    /// depend on the number of threads.
    ///
    /// # Panics
    /// If `inputs` are not whole rows or `outputs` do not have as many.
    pub fn predict(&self, inputs: &[f32], outputs: &mut [f32]) {
        let rows = inputs.len() / self.inputs();
        assert_eq!(inputs.len(), rows * self.inputs(), "whole rows of inputs");
        assert_eq!(outputs.len(), rows * self.outputs(), "number of outputs");
        let packed = Packed::new(self);
        inputs
            .par_chunks(BLOCK_ROWS * self.inputs())
            .zip(outputs.par_chunks_mut(BLOCK_ROWS * self.outputs()))
            .for_each_init(
                || Workspace::new(&packed),
                |workspace, (inputs, outputs)| {
                    let distance = stride(self.inputs());
                    let rows = inputs.chunks_exact(self.inputs());
                    for (to, row) in workspace.inputs_mut().chunks_exact_mut(distance).zip(rows) {
                        to[..row.len()].copy_from_slice(row);
                    }
                    packed.forward(inputs.len() / self.inputs(), workspace);
                    let rows = workspace.outputs().chunks_exact(stride(self.outputs()));
                    for (to, row) in outputs.chunks_exact_mut(self.outputs()).zip(rows) {
                        to.copy_from_slice(&row[..to.len()]);
                    }
                },
            );
    }

    fn layers(&self) -> impl Iterator<Item = LayerView<'_>> {
        (0..self.sizes.len() - 1).map(|index| self.layer(index))
    }

    /// Layer `index + 1` of the module's table.
    fn layer(&self, index: usize) -> LayerView<'_> {
        let (inputs, outputs) = (self.sizes[index], self.sizes[index + 1]);
        let (weight, rest) = self.parameters[count_parameters(&self.sizes[..=index])..].split_at(inputs * outputs);
        LayerView { inputs, outputs, weight, bias: &rest[..outputs] }
    }
}

/// Number of parameters of the layers between these sizes.
fn count_parameters(sizes: &[usize]) -> usize {
    sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum()
}

impl From<NetworkError> for crate::Error {
    fn from(error: NetworkError) -> Self {
        Self::Network(Box::new(error))
    }
}

#[cfg(test)]
mod tests {
    use super::{
        kernels::{InstructionSet, Store, activation::tests as activations},
        *,
    };

    fn network(inputs: usize, hidden: &[usize], outputs: usize, activation: Activation) -> Network {
        let options = NetworkOptions { hidden: hidden.into(), activation, ..NetworkOptions::default() };
        Network::new(inputs, outputs, &options, 1).unwrap()
    }

    /// Numbers spread over (-1, 1).
    fn spread(count: usize) -> Vec<f32> {
        (0..count).map(|i| 2.0 * ((i + 1) as f64 * 0.618_033_988_749_894_9).fract() as f32 - 1.0).collect()
    }

    /// The textbook formula in double precision, one scalar at a time: the outputs of one row.
    fn reference(sizes: &[usize], activation: Activation, parameters: &[f64], inputs: &[f32]) -> Vec<f64> {
        let mut y: Vec<f64> = inputs.iter().map(|&x| x.into()).collect();
        let mut rest = parameters;
        for (index, pair) in sizes.windows(2).enumerate() {
            let (weight, tail) = rest.split_at(pair[0] * pair[1]);
            let (bias, tail) = tail.split_at(pair[1]);
            rest = tail;
            let sum = |row: &[f64]| row.iter().zip(&y).map(|(w, y)| w * y).sum::<f64>();
            let z = weight.chunks(pair[0]).zip(bias).map(|(row, bias)| sum(row) + bias);
            let last = index + 2 == sizes.len();
            y = z.map(|z| if last { z } else { activations::reference(activation, z).0 }).collect();
        }
        y
    }

    #[test]
    fn predictions_agree_with_the_textbook_formula_in_double_precision() {
        for activation in Activation::ALL {
            for (inputs, hidden, outputs, rows) in
                [(4, vec![128, 128], 3, 300), (1, vec![], 1, 1), (3, vec![7, 33], 2, 129), (5, vec![64; 4], 4, 128)]
            {
                let network = network(inputs, &hidden, outputs, activation);
                let parameters: Vec<f64> = network.parameters().iter().map(|&p| p.into()).collect();
                let (x, mut y) = (spread(rows * inputs), vec![f32::NAN; rows * outputs]);
                network.predict(&x, &mut y);
                for (x, y) in x.chunks(inputs).zip(y.chunks(outputs)) {
                    for (found, expected) in y.iter().zip(reference(network.sizes(), activation, &parameters, x)) {
                        let error = (f64::from(*found) - expected).abs();
                        assert!(error < 1e-6, "{activation:?} {hidden:?}: {error:e}");
                    }
                }
            }
        }
    }

    /// The loss is the sum of the outputs, each weighted, so that every output and every parameter matters.
    #[test]
    fn every_gradient_agrees_with_central_differences_in_double_precision() {
        let (inputs, hidden, outputs, rows) = (3, [9, 17, 6], 2, 21);
        for activation in Activation::ALL {
            let network = network(inputs, &hidden, outputs, activation);
            let (x, weights) = (spread(rows * inputs), spread(rows * outputs + 5)[5..].to_vec());
            let loss = |parameters: &[f64]| -> f64 {
                let rows = x.chunks(inputs).zip(weights.chunks(outputs));
                let row_loss = |(x, weights): (&[f32], &[f32])| -> f64 {
                    let y = reference(network.sizes(), activation, parameters, x);
                    y.iter().zip(weights).map(|(y, &weight)| y * f64::from(weight)).sum()
                };
                rows.map(row_loss).sum()
            };

            let packed = Packed::new(&network);
            let mut workspace = Workspace::new(&packed);
            for simd in InstructionSet::available() {
                workspace.simd = simd;
                let found = weighted_gradient(&packed, &mut workspace, &x, &weights, Store::Replace, None);
                let mut gradient = vec![0.0; network.parameters().len()];
                packed.layout.unpack(&found, &mut gradient);

                let largest = gradient.iter().fold(0.0f32, |largest, g| largest.max(g.abs()));
                let mut parameters: Vec<f64> = network.parameters().iter().map(|&p| p.into()).collect();
                for (index, found) in gradient.iter().enumerate() {
                    // truncation error about step², rounding error about 1e-16 / step: both far below single precision
                    let (step, kept) = (1e-5, parameters[index]);
                    parameters[index] = kept + step;
                    let above = loss(&parameters);
                    parameters[index] = kept - step;
                    let below = loss(&parameters);
                    parameters[index] = kept;
                    let expected = (above - below) / (2.0 * step);
                    let error = (f64::from(*found) - expected).abs() / f64::from(largest);
                    assert!(error < 3e-6, "{simd:?} {activation:?} parameter {index}: {found} {expected}, {error:e}");
                }
            }
        }
    }

    /// The gradient of the sum of the outputs, each weighted, in the layout of the packed parameters.
    fn weighted_gradient(
        packed: &Packed,
        workspace: &mut Workspace,
        x: &[f32],
        weights: &[f32],
        store: Store,
        onto: Option<Vec<f32>>,
    ) -> Vec<f32> {
        let (inputs, outputs) = (packed.layout.shapes[0].inputs, packed.layout.shapes.last().unwrap().outputs);
        for (to, row) in workspace.inputs_mut().chunks_mut(stride(inputs)).zip(x.chunks(inputs)) {
            to[..inputs].copy_from_slice(row);
        }
        let rows = x.len() / inputs;
        let numbers: Vec<u32> = (0..rows as u32).collect();
        packed.forward_in_training(workspace, DropoutMask { seed: 1, step: 1, rows: &numbers });
        let (_, deltas) = workspace.outputs_and_deltas();
        for (to, row) in deltas.chunks_mut(stride(outputs)).zip(weights.chunks(outputs)) {
            to[..outputs].copy_from_slice(row);
        }
        let mut gradient = onto.unwrap_or_else(|| vec![f32::NAN; packed.layout.len()]);
        packed.backward(rows, workspace, store, &mut gradient);
        gradient
    }

    #[test]
    fn gradients_are_added_to_what_is_there_and_none_is_in_the_padding() {
        for (outputs, activation) in [(1, Activation::Sigmoid), (40, Activation::Tanh)] {
            let packed = Packed::new(&network(2, &[3, 35], outputs, activation));
            let (x, weights, mut workspace) = (spread(10), vec![1.0; 5 * outputs], Workspace::new(&packed));
            let once = weighted_gradient(&packed, &mut workspace, &x, &weights, Store::Replace, None);
            let twice = weighted_gradient(&packed, &mut workspace, &x, &weights, Store::Add, Some(once.clone()));
            assert!(twice.iter().zip(&once).all(|(twice, once)| *twice == 2.0 * once));
            let mut parameters = vec![0.0; packed.layout.len()];
            let count = [2, 3, 35, outputs].windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
            packed.layout.pack(&vec![1.0; count], &mut parameters);
            assert!(
                parameters.iter().zip(&once).all(|(is_parameter, gradient)| *is_parameter > 0.0 || *gradient == 0.0)
            );
        }
    }

    #[test]
    fn a_seed_gives_the_same_weights_on_every_machine() {
        let first = network(4, &[128, 128], 3, Activation::Tanh);
        assert_eq!(first, network(4, &[128, 128], 3, Activation::Tanh));
        assert_eq!(first.parameters().len(), 5 * 128 + 129 * 128 + 129 * 3);
        let found: Vec<u32> = first.parameters()[..3].iter().map(|parameter| parameter.to_bits()).collect();
        assert_eq!(found, [1_028_276_432, 3_183_981_984, 1_056_447_772]);
        let (hidden, bound) = (&first.parameters()[5 * 128..][..129 * 128], 1.0 / 128f32.sqrt());
        assert!(hidden.iter().all(|parameter| parameter.abs() <= bound));
        let variance = hidden.iter().map(|p| p * p).sum::<f32>() / hidden.len() as f32;
        assert!((variance / (bound * bound) - 1.0 / 3.0).abs() < 0.01, "{variance}");
    }

    #[test]
    fn layers_there_and_back_are_the_same_network() {
        let network = network(3, &[7, 5], 2, Activation::Relu);
        let layers = network.to_layers();
        assert_eq!(layers.len(), 3);
        assert_eq!((layers[1].inputs, layers[1].outputs, layers[1].weight.len()), (7, 5, 35));
        assert_eq!(layers[0].bias.as_single().unwrap(), &network.parameters()[21..28]);
        assert_eq!(Network::from_layers(&layers, Activation::Relu).unwrap(), network);
    }

    #[test]
    fn networks_that_make_no_sense_are_refused() {
        let options = NetworkOptions { hidden: vec![4, 0], ..NetworkOptions::default() };
        assert_eq!(Network::new(2, 1, &options, 0), Err(NetworkError::EmptyLayer { layer: 2 }));
        assert_eq!(Network::from_layers(&[], Activation::Tanh), Err(NetworkError::NoLayers));
        let mut layers = network(2, &[3], 1, Activation::Tanh).to_layers();
        layers[1].bias = vec![0.0f32; layers[1].outputs + 1].into();
        let error = Network::from_layers(&layers, Activation::Tanh).unwrap_err();
        assert_eq!(error.to_string(), "layer 2 of the network does not fit: expected 1 biases, found 2");
        layers[1].inputs = 4;
        let error = Network::from_layers(&layers, Activation::Tanh).unwrap_err();
        assert_eq!(error, NetworkError::LayerShape { layer: 2, what: "inputs", expected: 3, found: 4 });
        layers[1].outputs = 0;
        let error = Network::from_layers(&layers, Activation::Tanh).unwrap_err();
        assert_eq!(error, NetworkError::EmptyLayer { layer: 2 });
    }
}
