//! Tensors of the model file; `format` says what they are.

use super::{Elementwise, Forest, Graph, Node, Operation, Products, Step, Tree};
use crate::{
    FormatError, Numbers,
    map::{
        expect_shape,
        tensors::{OUTPUTS, Tensor, Views, bytes, elements, numbers, take, take_one_of},
    },
};
use safetensors::Dtype;

const AFFINE: u32 = 0;
const ELEMENTWISE: u32 = 1;
const COMBINE: u32 = 2;
const COLUMNS: u32 = 3;
const STANDARDISE: u32 = 4;
const SOFTMAX: u32 = 5;
const DISTANCES: u32 = 6;
const FOREST: u32 = 7;
const SELECT: u32 = 8;
const PRODUCTS: u32 = 9;

impl Graph {
    pub(crate) fn tensors(&self) -> Vec<Tensor> {
        let codes: Vec<u32> = self.steps.iter().flat_map(Step::codes).collect();
        let mut tensors: Vec<Tensor> = vec![
            ("graph.inputs".into(), Dtype::U32, vec![1], bytes(&[self.inputs as u32], u32::to_le_bytes)),
            ("graph.steps".into(), Dtype::U32, vec![self.steps.len(), 4], bytes(&codes, u32::to_le_bytes)),
        ];
        for (number, step) in self.steps.iter().enumerate() {
            tensors.extend(
                step.tensors()
                    .into_iter()
                    .map(|(name, kind, shape, content)| (format!("graph.{number}.{name}"), kind, shape, content)),
            );
        }
        tensors
    }

    /// Bytes of its numbers in the model file.
    pub fn bytes(&self) -> u64 {
        self.tensors().iter().map(|(.., content)| content.len() as u64).sum()
    }

    pub(crate) fn read(tensors: &mut Views) -> Result<Self, FormatError> {
        let indices = |view: &[u8]| elements(view, u32::from_le_bytes);
        let steps = indices(take(tensors, &format!("{OUTPUTS}graph.steps"), Dtype::U32, 2)?.data());
        let inputs = indices(take(tensors, &format!("{OUTPUTS}graph.inputs"), Dtype::U32, 1)?.data());
        let steps = steps.as_chunks::<4>().0.iter().enumerate();
        let steps = steps.map(|(number, codes)| Step::read(tensors, number, *codes)).collect::<Result<_, _>>()?;
        Ok(Self { inputs: inputs.first().map_or(0, |inputs| *inputs as usize), steps })
    }
}

impl Step {
    /// What kind of step it is, what of that kind, and of which values.
    fn codes(&self) -> [u32; 4] {
        let place = |found: Option<usize>| found.expect("all of them are listed") as u32;
        match self {
            Self::Affine { of, .. } => [AFFINE, 0, *of as u32, 0],
            Self::Elementwise { of, function, .. } => {
                let code = place(Elementwise::ALL.iter().position(|known| known == function));
                [ELEMENTWISE, code, *of as u32, 0]
            }
            Self::Combine { of: [a, b], operation } => {
                let code = place(Operation::ALL.iter().position(|known| known == operation));
                [COMBINE, code, *a as u32, *b as u32]
            }
            // the condition stands where others have their code
            Self::Select { of: [condition, a, b] } => [SELECT, *condition as u32, *a as u32, *b as u32],
            Self::Columns { .. } => [COLUMNS, 0, 0, 0],
            Self::Standardise { of, .. } => [STANDARDISE, 0, *of as u32, 0],
            Self::Softmax { of } => [SOFTMAX, 0, *of as u32, 0],
            Self::Distances { of, .. } => [DISTANCES, 0, *of as u32, 0],
            Self::Forest { of, outputs, .. } => [FOREST, *outputs as u32, *of as u32, 0],
            Self::Products { of, .. } => [PRODUCTS, 0, *of as u32, 0],
        }
    }

    fn tensors(&self) -> Vec<Tensor> {
        match self {
            Self::Affine { weight, bias, .. } => {
                let shape = vec![bias.len(), weight.len() / bias.len().max(1)];
                vec![of_numbers("weight", shape, weight), of_numbers("bias", vec![bias.len()], bias)]
            }
            Self::Elementwise { parameters, .. } if parameters.is_empty() => Vec::new(),
            Self::Elementwise { parameters, .. } => vec![doubles("parameters", vec![parameters.len()], parameters)],
            Self::Columns { columns } => {
                let content = columns.iter().flatten().copied().collect::<Vec<u32>>();
                vec![indices("columns", vec![columns.len(), 2], &content)]
            }
            Self::Standardise { epsilon, .. } => vec![doubles("parameters", vec![1], &[*epsilon])],
            Self::Distances { centres, lengths, .. } => {
                let shape = vec![centres.len() / lengths.len().max(1), lengths.len()];
                vec![doubles("centres", shape, centres), doubles("lengths", vec![lengths.len()], lengths)]
            }
            Self::Forest { forest, .. } => forest.tensors(),
            Self::Products { products, .. } => {
                let shape = vec![products.terms(), products.inputs];
                vec![("degrees".into(), Dtype::U8, shape, products.degrees.clone())]
            }
            Self::Combine { .. } | Self::Select { .. } | Self::Softmax { .. } => Vec::new(),
        }
    }

    fn read(tensors: &mut Views, number: usize, [kind, code, a, b]: [u32; 4]) -> Result<Self, FormatError> {
        let prefix = format!("{OUTPUTS}graph.{number}.");
        let unknown = |found: u32, place: usize| FormatError::Unknown {
            name: format!("{OUTPUTS}graph.steps"),
            index: 4 * number + place,
            found,
        };
        let mut doubles = |name: &str, dimensions: usize| -> Result<Vec<f64>, FormatError> {
            let view = take(tensors, &format!("{prefix}{name}"), Dtype::F64, dimensions)?;
            Ok(elements(view.data(), f64::from_le_bytes))
        };
        let of = a as usize;
        match kind {
            AFFINE => {
                let mut read = |name: &str, dimensions: usize| -> Result<Numbers, FormatError> {
                    let name = format!("{prefix}{name}");
                    let view = take_one_of(tensors, &name, &[Dtype::F32, Dtype::F64], dimensions)?;
                    Ok(numbers(view.dtype(), view.data()))
                };
                Ok(Self::Affine { of, weight: read("weight", 2)?, bias: read("bias", 1)? })
            }
            ELEMENTWISE => {
                let function = *Elementwise::ALL.get(code as usize).ok_or_else(|| unknown(code, 1))?;
                let parameters = if function.parameters() > 0 { doubles("parameters", 1)? } else { Vec::new() };
                Ok(Self::Elementwise { of, function, parameters })
            }
            COMBINE => {
                let operation = *Operation::ALL.get(code as usize).ok_or_else(|| unknown(code, 1))?;
                Ok(Self::Combine { of: [of, b as usize], operation })
            }
            SELECT => Ok(Self::Select { of: [code as usize, of, b as usize] }),
            COLUMNS => {
                let view = take(tensors, &format!("{prefix}columns"), Dtype::U32, 2)?;
                let columns = elements(view.data(), u32::from_le_bytes).as_chunks::<2>().0.to_vec();
                Ok(Self::Columns { columns })
            }
            STANDARDISE => {
                let epsilon = doubles("parameters", 1)?.first().copied().unwrap_or(f64::NAN);
                Ok(Self::Standardise { of, epsilon })
            }
            SOFTMAX => Ok(Self::Softmax { of }),
            DISTANCES => Ok(Self::Distances { of, centres: doubles("centres", 2)?, lengths: doubles("lengths", 1)? }),
            FOREST => Ok(Self::Forest { of, forest: Forest::read(tensors, &prefix)?, outputs: code as usize }),
            PRODUCTS => {
                let view = take(tensors, &format!("{prefix}degrees"), Dtype::U8, 2)?;
                Ok(Self::Products { of, products: Products { inputs: view.shape()[1], degrees: view.data().to_vec() } })
            }
            other => Err(unknown(other, 0)),
        }
    }
}

impl Forest {
    fn tensors(&self) -> Vec<Tensor> {
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
    fn read(tensors: &mut Views, prefix: &str) -> Result<Self, FormatError> {
        let mut indices = |name: &str, dimensions| {
            let view = take(tensors, &format!("{prefix}forest.{name}"), Dtype::U32, dimensions)?;
            Ok::<_, FormatError>(elements(view.data(), u32::from_le_bytes))
        };
        let (columns, below) = (indices("column", 1)?, indices("below", 2)?);
        let (roots, outputs) = (indices("root", 1)?, indices("output", 1)?);
        let numbers = take(tensors, &format!("{prefix}forest.number"), Dtype::F64, 1)?;
        let numbers = elements(numbers.data(), f64::from_le_bytes);
        let nodes = columns.len();
        expect_shape("forest.number", &[numbers.len()], &[nodes])?;
        expect_shape("forest.below", &[below.len()], &[2 * nodes])?;
        expect_shape("forest.output", &[outputs.len()], &[roots.len()])?;
        let below = below.as_chunks::<2>().0;
        let nodes = columns.into_iter().zip(numbers).zip(below);
        let trees = roots.into_iter().zip(outputs);
        Ok(Self {
            nodes: nodes.map(|((column, number), below)| Node { column, number, below: *below }).collect(),
            trees: trees.map(|(root, output)| Tree { root, output }).collect(),
        })
    }
}

fn doubles(name: &str, shape: Vec<usize>, values: &[f64]) -> Tensor {
    (name.into(), Dtype::F64, shape, bytes(values, f64::to_le_bytes))
}

fn indices(name: &str, shape: Vec<usize>, values: &[u32]) -> Tensor {
    (name.into(), Dtype::U32, shape, bytes(values, u32::to_le_bytes))
}

fn of_numbers(name: &str, shape: Vec<usize>, numbers: &Numbers) -> Tensor {
    match numbers {
        Numbers::Single(values) => (name.into(), Dtype::F32, shape, bytes(values, f32::to_le_bytes)),
        Numbers::Double(values) => (name.into(), Dtype::F64, shape, bytes(values, f64::to_le_bytes)),
    }
}
