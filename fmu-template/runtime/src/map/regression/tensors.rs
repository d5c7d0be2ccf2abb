//! Tensors of the model file; `format` says what they are.

use super::{Forest, Function, KernelMachine, KernelMachines, Node, Polynomial, Regression, Tree};
use crate::{
    FormatError, Scaling,
    map::tensors::{OUTPUTS, Tensor, Views, bytes, elements, take},
};
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
            Function::Forest(forest) => forest.tensors(),
            Function::Kernel(machines) => kernel_tensors(machines),
        });
        tensors
    }

    /// The regression of the scaling among these tensors and a function.
    pub(crate) fn read(tensors: &mut Views, function: Function) -> Result<Self, FormatError> {
        let mut column = |name: &str| read_doubles(tensors, name, 1);
        let scaling = Scaling {
            input_mean: column("input_mean")?,
            input_scale: column("input_scale")?,
            output_mean: column("output_mean")?,
            output_scale: column("output_scale")?,
        };
        Ok(Self { scaling, function })
    }
}

fn polynomial_tensors(polynomial: &Polynomial, inputs: usize, outputs: usize) -> Vec<Tensor> {
    let terms = polynomial.terms(inputs);
    vec![
        ("polynomial.degrees".into(), Dtype::U8, vec![terms, inputs], polynomial.degrees.clone()),
        doubles("polynomial.coefficients", vec![outputs, terms], &polynomial.coefficients),
    ]
}

impl Polynomial {
    pub(crate) fn read(tensors: &mut Views) -> Result<Self, FormatError> {
        let degrees = take(tensors, &format!("{OUTPUTS}polynomial.degrees"), Dtype::U8, 2)?.data().to_vec();
        Ok(Self { degrees, coefficients: read_doubles(tensors, "polynomial.coefficients", 2)? })
    }
}

impl Forest {
    pub(crate) fn tensors(&self) -> Vec<Tensor> {
        let Self { nodes, trees } = self;
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

    /// The forest of the tensors whose names have this prefix.
    pub(crate) fn read(tensors: &mut Views, prefix: &str) -> Result<Self, FormatError> {
        let mut indices = |name: &str, dimensions| {
            let view = take(tensors, &format!("{prefix}forest.{name}"), Dtype::U32, dimensions)?;
            Ok::<_, FormatError>(elements(view.data(), u32::from_le_bytes))
        };
        let (columns, below) = (indices("column", 1)?, indices("below", 2)?);
        let (roots, outputs) = (indices("root", 1)?, indices("output", 1)?);
        let numbers = take(tensors, &format!("{prefix}forest.number"), Dtype::F64, 1)?;
        let numbers = elements(numbers.data(), f64::from_le_bytes);
        let nodes = columns.len();
        expect_length("forest.number", numbers.len(), nodes)?;
        expect_length("forest.below", below.len(), 2 * nodes)?;
        expect_length("forest.output", outputs.len(), roots.len())?;
        let below = below.as_chunks::<2>().0;
        let nodes = columns.into_iter().zip(numbers).zip(below);
        let trees = roots.into_iter().zip(outputs);
        Ok(Self {
            nodes: nodes.map(|((column, number), below)| Node { column, number, below: *below }).collect(),
            trees: trees.map(|(root, output)| Tree { root, output }).collect(),
        })
    }
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

impl KernelMachines {
    pub(crate) fn read(tensors: &mut Views) -> Result<Self, FormatError> {
        let bias = read_doubles(tensors, "kernel.bias", 1)?;
        let machine = |(output, bias)| {
            let mut read =
                |what: &str, dimensions| read_doubles(tensors, &format!("kernel.{output}.{what}"), dimensions);
            let (lengths, centres, weights) = (read("lengths", 1)?, read("centres", 2)?, read("weights", 1)?);
            Ok(KernelMachine { lengths, centres, weights, bias })
        };
        let machines = bias.into_iter().enumerate().map(machine).collect::<Result<_, FormatError>>()?;
        Ok(Self { machines })
    }
}

fn doubles(name: &str, shape: Vec<usize>, values: &[f64]) -> Tensor {
    (name.into(), Dtype::F64, shape, bytes(values, f64::to_le_bytes))
}

fn indices(name: &str, shape: Vec<usize>, values: &[u32]) -> Tensor {
    (name.into(), Dtype::U32, shape, bytes(values, u32::to_le_bytes))
}

fn read_doubles(tensors: &mut Views, name: &str, dimensions: usize) -> Result<Vec<f64>, FormatError> {
    Ok(elements(take(tensors, &format!("{OUTPUTS}{name}"), Dtype::F64, dimensions)?.data(), f64::from_le_bytes))
}

fn expect_length(name: &str, found: usize, expected: usize) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Shape { name: name.into(), found: vec![found], expected: vec![expected] })
}
