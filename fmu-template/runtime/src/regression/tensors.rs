//! Tensors of the model file; `format` says what they are.

use super::{Forest, Function, KernelMachine, KernelMachines, Polynomial, Regression, Tree};
use crate::format::{Tensor, bytes};
use safetensors::Dtype;

impl Regression {
    pub(crate) fn tensors(&self) -> Vec<Tensor> {
        let scaling = &self.scaling;
        let mut tensors: Vec<Tensor> = [
            ("input_mean", &scaling.input_mean),
            ("input_scale", &scaling.input_scale),
            ("output_mean", &scaling.output_mean),
            ("output_scale", &scaling.output_scale),
        ]
        .map(|(name, column)| doubles(name, vec![column.len()], column))
        .into();
        tensors.extend(match &self.function {
            Function::Polynomial(polynomial) => polynomial_tensors(polynomial, self.inputs(), self.outputs()),
            Function::Forest(forest) => forest_tensors(forest),
            Function::Kernel(machines) => kernel_tensors(machines),
        });
        tensors
    }
}

fn polynomial_tensors(polynomial: &Polynomial, inputs: usize, outputs: usize) -> Vec<Tensor> {
    let terms = polynomial.terms(inputs);
    vec![
        ("polynomial.degrees".into(), Dtype::U8, vec![terms, inputs], polynomial.degrees.clone()),
        doubles("polynomial.coefficients", vec![outputs, terms], &polynomial.coefficients),
    ]
}

fn forest_tensors(forest: &Forest) -> Vec<Tensor> {
    let Forest { nodes, trees } = forest;
    let columns: Vec<u32> = nodes.iter().map(|node| node.column).collect();
    let numbers: Vec<f64> = nodes.iter().map(|node| node.number).collect();
    let below: Vec<u32> = nodes.iter().flat_map(|node| node.below).collect();
    let [roots, outputs] =
        [|tree: &Tree| tree.root, |tree: &Tree| tree.output].map(|of| trees.iter().map(of).collect::<Vec<u32>>());
    vec![
        indices("forest.column", vec![nodes.len()], &columns),
        doubles("forest.number", vec![nodes.len()], &numbers),
        indices("forest.below", vec![nodes.len(), 2], &below),
        indices("forest.root", vec![trees.len()], &roots),
        indices("forest.output", vec![trees.len()], &outputs),
    ]
}

fn kernel_tensors(machines: &KernelMachines) -> Vec<Tensor> {
    let bias: Vec<f64> = machines.machines.iter().map(|machine| machine.bias).collect();
    let mut tensors = vec![doubles("kernel.bias", vec![bias.len()], &bias)];
    for (output, machine) in machines.machines.iter().enumerate() {
        let KernelMachine { lengths, centres, weights, .. } = machine;
        tensors.push(doubles(&format!("kernel.{output}.lengths"), vec![lengths.len()], lengths));
        tensors.push(doubles(&format!("kernel.{output}.centres"), vec![weights.len(), lengths.len()], centres));
        tensors.push(doubles(&format!("kernel.{output}.weights"), vec![weights.len()], weights));
    }
    tensors
}

fn doubles(name: &str, shape: Vec<usize>, values: &[f64]) -> Tensor {
    (name.into(), Dtype::F64, shape, bytes(values, f64::to_le_bytes))
}

fn indices(name: &str, shape: Vec<usize>, values: &[u32]) -> Tensor {
    (name.into(), Dtype::U32, shape, bytes(values, u32::to_le_bytes))
}
