//! Graphs of fitted models: networks, linear functions, polynomials, forests of decision trees, sums of kernels. All are fitted to
//! standardized columns `z = (x - mean) / scale` and outputs. Means are subtracted first: in `x / scale - mean / scale` digits would cancel
//! far from zero.

use super::{Elementwise, Forest, Graph, LEAF, ProcessDeviation, Products, Step};
use crate::{Activation, Layer, Numbers, ScaledNetwork, Scaling};

/// `y = bias + sum_c weights[c] * exp(-1/2 sum_i ((z_i - centres[c, i]) / lengths[i])^2)`: support vector regression, Gaussian processes.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelMachine {
    /// Length scale of each input, positive.
    pub lengths: Vec<f64>,
    /// Shape `[centres, inputs]`.
    pub centres: Vec<f64>,
    /// Shape `[centres]`.
    pub weights: Vec<f64>,
    /// Far from every centre.
    pub bias: f64,
    /// Predicted standard deviation, of a Gaussian process.
    pub deviation: Option<ProcessDeviation>,
}

impl KernelMachine {
    /// Returns true if both have the same kernels.
    fn shares_kernels(&self, other: &Self) -> bool {
        self.lengths == other.lengths && self.centres == other.centres
    }
}

/// Numbers of a network: mean and scale of inputs and outputs, and its layers.
struct NetworkSteps<'a> {
    input: [&'a [f64]; 2],
    layers: Vec<LayerSteps<'a>>,
    output: [&'a [f64]; 2],
}

/// Numbers of the affine step of a layer, and the activation that follows.
struct LayerSteps<'a> {
    weight: &'a Numbers,
    bias: &'a Numbers,
    activation: Activation,
}

impl From<LayerSteps<'_>> for Layer {
    fn from(LayerSteps { weight, bias, activation }: LayerSteps) -> Self {
        let (inputs, outputs) = (weight.len() / bias.len().max(1), bias.len());
        Self { inputs, outputs, weight: weight.clone(), bias: bias.clone(), activation }
    }
}

impl From<&ScaledNetwork> for Graph {
    fn from(ScaledNetwork { scaling, layers }: &ScaledNetwork) -> Self {
        let mut graph = Self::standardized(scaling);
        for Layer { weight, bias, activation, .. } in layers {
            let of = graph.steps.len();
            let of = graph.add(Step::Affine { of, weight: weight.clone(), bias: bias.clone() });
            if *activation != Activation::Identity {
                let function = Elementwise::Activation(*activation);
                graph.add(Step::Elementwise { of, function, parameters: Vec::new() });
            }
        }
        let Scaling { output_mean, output_scale, .. } = scaling;
        let (of, mean, scale) = (graph.steps.len(), output_mean.clone(), output_scale.clone());
        graph.add(Step::Rescale { of, mean, scale });
        graph
    }
}

impl Graph {
    /// The network, if it is one: layers one after the other, of standardized columns, with rescaled outputs.
    pub fn network(&self) -> Option<ScaledNetwork> {
        let NetworkSteps { input: [input_mean, input_scale], layers, output: [output_mean, output_scale] } =
            self.network_steps()?;
        let [input_mean, input_scale] = [input_mean, input_scale].map(<[f64]>::to_vec);
        let [output_mean, output_scale] = [output_mean, output_scale].map(<[f64]>::to_vec);
        let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
        Some(ScaledNetwork { scaling, layers: layers.into_iter().map(Layer::from).collect() })
    }

    fn network_steps(&self) -> Option<NetworkSteps<'_>> {
        let (first, rest) = self.steps.split_first()?;
        let (last, steps) = rest.split_last()?;
        let Step::Standardize { of: 0, mean: input_mean, scale: input_scale } = first else { return None };
        let Step::Rescale { of, mean: output_mean, scale: output_scale } = last else { return None };
        let mut layers: Vec<LayerSteps> = Vec::new();
        for (before, step) in (1..).zip(steps) {
            match step {
                Step::Affine { of, weight, bias } if *of == before => {
                    layers.push(LayerSteps { weight, bias, activation: Activation::Identity });
                }
                Step::Elementwise { of, function: Elementwise::Activation(activation), .. } if *of == before => {
                    let layer = layers.last_mut().filter(|layer| layer.activation == Activation::Identity)?;
                    layer.activation = *activation;
                }
                _ => return None,
            }
        }
        let (input, output) = ([&input_mean[..], input_scale], [&output_mean[..], output_scale]);
        (*of == self.steps.len() - 1 && !layers.is_empty()).then_some(NetworkSteps { input, layers, output })
    }

    /// Returns true if it is a [network](Self::network).
    pub fn is_network(&self) -> bool {
        self.network_steps().is_some()
    }

    /// `y_o = mean_o + scale_o (biases[o] + sum_i weights[o, i] z_i)`
    pub fn of_linear(scaling: &Scaling, weights: &[f64], biases: &[f64]) -> Self {
        let mut graph = Self::centred(scaling);
        let scales = scaling.input_scale.iter().cycle();
        let weights: Vec<f64> = weights.iter().zip(scales).map(|(weight, scale)| weight / scale).collect();
        graph.add(scaled(1, &weights, biases, &scaling.output_mean, &scaling.output_scale));
        graph
    }

    /// `y_o = mean_o + scale_o sum_t coefficients[o, t] products_t(z)`
    pub fn of_polynomial(scaling: &Scaling, products: Products, coefficients: &[f64]) -> Self {
        let mut graph = Self::standardized(scaling);
        let biases = vec![0.0; scaling.output_mean.len()];
        let of = graph.add(Step::Products { of: graph.steps.len(), products });
        graph.add(scaled(of, coefficients, &biases, &scaling.output_mean, &scaling.output_scale));
        graph
    }

    /// `y_o = mean_o + scale_o forest_o(z)`
    pub fn of_forest(scaling: &Scaling, forest: Forest) -> Self {
        let mut graph = Self::centred(scaling);
        let mut forest = forest;
        for node in forest.nodes.iter_mut().filter(|node| node.column != LEAF) {
            node.number *= scaling.input_scale.get(node.column as usize).copied().unwrap_or(1.0);
        }
        let of = graph.add(Step::Forest { of: 1, forest: forest.into(), outputs: scaling.output_mean.len() });
        graph.add(linear(of, &scaling.output_scale, &scaling.output_mean));
        graph
    }

    /// `y_o = mean_o + scale_o machine_o(z)`, then the [standard deviations](ProcessDeviation) of the machines that have one. Machines with the same
    /// centres and lengths share their kernels.
    pub fn of_kernels(scaling: &Scaling, machines: &[KernelMachine]) -> Self {
        let mut graph = Self::standardized(scaling);
        let Scaling { output_mean, output_scale, .. } = scaling;
        let (inputs, z) = (graph.inputs, graph.steps.len());
        let mut columns = vec![[0; 2]; machines.len()];
        let mut deviations = vec![None; machines.len()];
        let mut rest: Vec<usize> = (0..machines.len()).collect();
        while let Some(first) = rest.first() {
            let machine = &machines[*first];
            let (shared, others): (Vec<usize>, Vec<usize>) =
                rest.iter().partition(|other| machines[**other].shares_kernels(machine));
            let KernelMachine { lengths, centres, .. } = machine;
            let (kernels, weights): (usize, Vec<f64>) = if centres.is_empty() {
                (z, vec![0.0; inputs * shared.len()])
            } else {
                let step = Step::Distances { of: z, centres: centres.clone(), lengths: lengths.clone() };
                let of = graph.add(step);
                let function = Elementwise::Gaussian;
                let kernels = graph.add(Step::Elementwise { of, function, parameters: Vec::new() });
                (kernels, shared.iter().flat_map(|output| machines[*output].weights.iter().copied()).collect())
            };
            let biases: Vec<f64> = shared.iter().map(|output| machines[*output].bias).collect();
            let mean: Vec<f64> = shared.iter().map(|output| output_mean[*output]).collect();
            let scale: Vec<f64> = shared.iter().map(|output| output_scale[*output]).collect();
            let made = graph.add(scaled(kernels, &weights, &biases, &mean, &scale));
            (0..).zip(&shared).for_each(|(row, output)| columns[*output] = [made as u32, row]);
            for (output, deviation) in shared.iter().filter_map(|o| Some((*o, machines[*o].deviation.as_ref()?))) {
                deviations[output] = Some([graph.add_deviation(kernels, deviation, output_scale[output]) as u32, 0]);
            }
            rest = others;
        }
        columns.extend(deviations.into_iter().flatten());
        if columns.iter().any(|[of, _]| *of != columns[0][0]) {
            graph.add(Step::Columns { columns });
        }
        graph
    }

    /// `x - mean`
    fn centred(Scaling { input_mean, .. }: &Scaling) -> Self {
        let negative: Vec<f64> = input_mean.iter().map(|mean| -mean).collect();
        let inputs = input_mean.len();
        Self { inputs, steps: vec![linear(0, &vec![1.0; inputs], &negative)] }
    }

    /// `(x - mean) / scale`
    fn standardized(Scaling { input_mean, input_scale, .. }: &Scaling) -> Self {
        let step = Step::Standardize { of: 0, mean: input_mean.clone(), scale: input_scale.clone() };
        Self { inputs: input_mean.len(), steps: vec![step] }
    }

    /// The number of the value that a step makes.
    pub(super) fn add(&mut self, step: Step) -> usize {
        self.steps.push(step);
        self.steps.len()
    }
}

fn linear(of: usize, factors: &[f64], offsets: &[f64]) -> Step {
    Step::Elementwise { of, function: Elementwise::Linear, parameters: [factors, offsets].concat() }
}

/// `mean + scale (W x + b)`
fn scaled(of: usize, weight: &[f64], bias: &[f64], mean: &[f64], scale: &[f64]) -> Step {
    let rows = weight.chunks(weight.len().div_ceil(bias.len()).max(1)).zip(scale);
    let weight: Vec<f64> = rows.flat_map(|(row, scale)| row.iter().map(move |weight| scale * weight)).collect();
    let bias: Vec<f64> = mean.iter().zip(scale).zip(bias).map(|((mean, scale), bias)| mean + scale * bias).collect();
    Step::Affine { of, weight: weight.into(), bias: bias.into() }
}

#[cfg(test)]
mod tests;
