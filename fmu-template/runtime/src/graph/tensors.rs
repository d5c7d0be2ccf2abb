//! Tensors of the model file; `format` says what they are.

use super::{Elementwise, Forest, Graph, Node, Operation, Products, Step, Tree};
use crate::{
    FormatError, Motion, Numbers,
    check::expect_shape,
    dictionary::Dictionary,
    tensors::{Tensor, Views, bytes, counts, elements, joined, numbers, stacked, take, take_one_of, whole_rows},
};
use safetensors::Dtype;

const AFFINE: u32 = 0;
const ELEMENTWISE: u32 = 1;
const COMBINE: u32 = 2;
const COLUMNS: u32 = 3;
const NORMALIZE: u32 = 4;
const SOFTMAX: u32 = 5;
const DISTANCES: u32 = 6;
const FOREST: u32 = 7;
const SELECT: u32 = 8;
const PRODUCTS: u32 = 9;
const STANDARDIZE: u32 = 10;
const RESCALE: u32 = 11;
/// Steps from here on have separate working memory.
const CALL: u32 = 12;
const INTERPOLATE: u32 = 13;
const DICTIONARY: u32 = 14;
const MOTION: u32 = 15;

impl Graph {
    /// Tensors whose names begin with this.
    pub(crate) fn tensors(&self, prefix: &str) -> Vec<Tensor> {
        let codes: Vec<u32> = self.steps.iter().flat_map(Step::codes).collect();
        let mut tensors: Vec<Tensor> = vec![
            indices(&format!("{prefix}inputs"), vec![1], &[self.inputs as u32]),
            indices(&format!("{prefix}steps"), vec![self.steps.len(), 4], &codes),
        ];
        for (number, step) in self.steps.iter().enumerate() {
            tensors.extend(step.tensors(&format!("{prefix}{number}.")));
        }
        tensors
    }

    /// Bytes of its numbers in the model file.
    pub fn bytes(&self) -> u64 {
        self.tensors("").iter().map(|(.., content)| content.len() as u64).sum()
    }

    /// The graph of the tensors whose names begin with this. One that a step calls has no steps that call others.
    pub(crate) fn read(tensors: &mut Views, prefix: &str, is_called: bool) -> Result<Self, FormatError> {
        let name = [prefix, "steps"].concat();
        let steps = whole_rows(tensors, &name)?;
        let inputs = counts(tensors, &[prefix, "inputs"].concat(), 1)?[0] as usize;
        let steps = steps.into_iter().enumerate().map(|(number, codes)| {
            let row = CodeRow { name: &name, number, codes };
            if is_called && codes[0] >= CALL {
                return Err(row.unknown(0));
            }
            Step::read(tensors, &joined([prefix, &number.to_string(), "."]), row)
        });
        Ok(Self { inputs, steps: steps.collect::<Result<_, _>>()? })
    }

    /// The graph of a name, which is a network.
    fn read_network(tensors: &mut Views, name: &str) -> Result<Self, FormatError> {
        let graph = Self::read(tensors, &joined([name, "."]), true)?;
        if graph.is_network() { Ok(graph) } else { Err(FormatError::NoNetwork { name: name.into() }) }
    }

    /// A network with the same steps and other numbers: those of its tensors, in their order.
    fn with_numbers(&self, tensors: &mut dyn Iterator<Item = Numbers>) -> Self {
        let steps = self.steps.iter().map(|step| match *step {
            Step::Affine { of, .. } => Step::Affine { of, weight: next_numbers(tensors), bias: next_numbers(tensors) },
            Step::Standardize { of, .. } => {
                Step::Standardize { of, mean: next_doubles(tensors), scale: next_doubles(tensors) }
            }
            Step::Rescale { of, .. } => Step::Rescale { of, mean: next_doubles(tensors), scale: next_doubles(tensors) },
            ref other => other.clone(),
        });
        Self { inputs: self.inputs, steps: steps.collect() }
    }
}

fn next_numbers(tensors: &mut dyn Iterator<Item = Numbers>) -> Numbers {
    tensors.next().unwrap_or(Numbers::Double(Vec::new()))
}

fn next_doubles(tensors: &mut dyn Iterator<Item = Numbers>) -> Vec<f64> {
    match next_numbers(tensors) {
        Numbers::Double(numbers) => numbers,
        // types are those of the first network, which were checked
        Numbers::Single(_) => Vec::new(),
    }
}

/// A row of the tensor of steps: kind and code of a step, and its operands.
struct CodeRow<'a> {
    /// Name of the tensor.
    name: &'a str,
    number: usize,
    codes: [u32; 4],
}

impl CodeRow<'_> {
    /// The error about one of the codes.
    fn unknown(&self, place: usize) -> FormatError {
        FormatError::Unknown { name: self.name.into(), index: 4 * self.number + place, found: self.codes[place] }
    }
}

impl Step {
    /// Kind and code of the step, and its operands.
    fn codes(&self) -> [u32; 4] {
        match self {
            Self::Affine { of, .. } => [AFFINE, 0, *of as u32, 0],
            Self::Elementwise { of, function, .. } => [ELEMENTWISE, function.code() as u32, *of as u32, 0],
            Self::Combine { of: [a, b], operation } => {
                let code = Operation::ALL.iter().position(|known| known == operation).expect("all of them are listed");
                [COMBINE, code as u32, *a as u32, *b as u32]
            }
            // the condition stands where others have their code
            Self::Select { of: [condition, a, b] } => [SELECT, *condition as u32, *a as u32, *b as u32],
            Self::Columns { .. } => [COLUMNS, 0, 0, 0],
            Self::Standardize { of, .. } => [STANDARDIZE, 0, *of as u32, 0],
            Self::Rescale { of, .. } => [RESCALE, 0, *of as u32, 0],
            Self::Normalize { of, .. } => [NORMALIZE, 0, *of as u32, 0],
            Self::Softmax { of } => [SOFTMAX, 0, *of as u32, 0],
            Self::Distances { of, .. } => [DISTANCES, 0, *of as u32, 0],
            Self::Forest { of, outputs, .. } => [FOREST, *outputs as u32, *of as u32, 0],
            Self::Products { of, .. } => [PRODUCTS, 0, *of as u32, 0],
            Self::Call { of, .. } => [CALL, 0, *of as u32, 0],
            Self::Interpolate { of, column, .. } => [INTERPOLATE, *column as u32, *of as u32, 0],
            Self::Dictionary { of, .. } => [DICTIONARY, 0, *of as u32, 0],
            Self::Motion { of, .. } => [MOTION, 0, *of as u32, 0],
        }
    }

    /// Tensors whose names begin with this.
    fn tensors(&self, prefix: &str) -> Vec<Tensor> {
        match self {
            Self::Affine { weight, bias, .. } => {
                let shape = vec![bias.len(), weight.len() / bias.len().max(1)];
                let bias_shape = vec![bias.len()];
                vec![
                    of_numbers(&joined([prefix, "weight"]), shape, weight),
                    of_numbers(&joined([prefix, "bias"]), bias_shape, bias),
                ]
            }
            Self::Elementwise { parameters, .. } if parameters.is_empty() => Vec::new(),
            Self::Elementwise { parameters, .. } => {
                vec![doubles(&joined([prefix, "parameters"]), vec![parameters.len()], parameters)]
            }
            Self::Columns { columns } => {
                let content = columns.iter().flatten().copied().collect::<Vec<u32>>();
                vec![indices(&joined([prefix, "columns"]), vec![columns.len(), 2], &content)]
            }
            Self::Standardize { mean, scale, .. } | Self::Rescale { mean, scale, .. } => {
                vec![
                    doubles(&joined([prefix, "mean"]), vec![mean.len()], mean),
                    doubles(&joined([prefix, "scale"]), vec![scale.len()], scale),
                ]
            }
            Self::Normalize { epsilon, .. } => vec![doubles(&joined([prefix, "parameters"]), vec![1], &[*epsilon])],
            Self::Distances { centres, lengths, .. } => {
                let shape = vec![centres.len() / lengths.len().max(1), lengths.len()];
                vec![
                    doubles(&joined([prefix, "centres"]), shape, centres),
                    doubles(&joined([prefix, "lengths"]), vec![lengths.len()], lengths),
                ]
            }
            Self::Forest { forest, .. } => forest.tensors(prefix),
            Self::Products { products, .. } => {
                let shape = vec![products.terms(), products.inputs];
                vec![(joined([prefix, "degrees"]), Dtype::U8, shape, products.degrees.clone())]
            }
            Self::Combine { .. } | Self::Select { .. } | Self::Softmax { .. } => Vec::new(),
            Self::Call { function, .. } => function.tensors(&joined([prefix, "function."])),
            Self::Interpolate { instants, functions, .. } => {
                let mut tensors = vec![doubles(&joined([prefix, "instants"]), vec![instants.len()], instants)];
                let functions = functions.iter().map(|function| function.tensors(&joined([prefix, "functions."])));
                tensors.extend(stacked(functions));
                tensors
            }
            Self::Dictionary { dictionary, .. } => dictionary.tensors(prefix),
            Self::Motion { motion, .. } => motion.tensors(prefix),
        }
    }

    /// The step of the tensors whose names begin with this.
    fn read(tensors: &mut Views, prefix: &str, row: CodeRow) -> Result<Self, FormatError> {
        let [kind, code, a, b] = row.codes;
        let of = a as usize;
        match kind {
            AFFINE => {
                let weight = take_one_of(tensors, &joined([prefix, "weight"]), &[Dtype::F32, Dtype::F64], 2)?;
                let bias = take_one_of(tensors, &joined([prefix, "bias"]), &[Dtype::F32, Dtype::F64], 1)?;
                let shape = weight.shape;
                let [weight, bias] = [weight, bias].map(|view| numbers(view.dtype, view.data));
                expect_shape(joined([prefix, "weight"]), shape, &[bias.len(), weight.len() / bias.len().max(1)])?;
                Ok(Self::Affine { of, weight, bias })
            }
            ELEMENTWISE => {
                let function = Elementwise::of_code(code as usize).ok_or_else(|| row.unknown(1))?;
                let parameters = if function.parameters() > 0 {
                    read_doubles(tensors, &joined([prefix, "parameters"]))?
                } else {
                    Vec::new()
                };
                Ok(Self::Elementwise { of, function, parameters })
            }
            COMBINE => {
                let operation = *Operation::ALL.get(code as usize).ok_or_else(|| row.unknown(1))?;
                Ok(Self::Combine { of: [of, b as usize], operation })
            }
            SELECT => Ok(Self::Select { of: [code as usize, of, b as usize] }),
            COLUMNS => Ok(Self::Columns { columns: whole_rows(tensors, &joined([prefix, "columns"]))? }),
            STANDARDIZE => Ok(Self::Standardize {
                of,
                mean: read_doubles(tensors, &joined([prefix, "mean"]))?,
                scale: read_doubles(tensors, &joined([prefix, "scale"]))?,
            }),
            RESCALE => Ok(Self::Rescale {
                of,
                mean: read_doubles(tensors, &joined([prefix, "mean"]))?,
                scale: read_doubles(tensors, &joined([prefix, "scale"]))?,
            }),
            NORMALIZE => {
                let parameters = read_doubles(tensors, &joined([prefix, "parameters"]))?;
                expect_shape(joined([prefix, "parameters"]), &[parameters.len()], &[1])?;
                Ok(Self::Normalize { of, epsilon: parameters[0] })
            }
            SOFTMAX => Ok(Self::Softmax { of }),
            DISTANCES => {
                let lengths = read_doubles(tensors, &joined([prefix, "lengths"]))?;
                let centres = take(tensors, &joined([prefix, "centres"]), Dtype::F64, 2)?;
                expect_shape(joined([prefix, "centres"]), &centres.shape[1..], &[lengths.len()])?;
                Ok(Self::Distances { of, centres: elements(centres.data, f64::from_le_bytes), lengths })
            }
            FOREST => Ok(Self::Forest { of, forest: Forest::read(tensors, prefix)?.into(), outputs: code as usize }),
            PRODUCTS => {
                let view = take(tensors, &joined([prefix, "degrees"]), Dtype::U8, 2)?;
                Ok(Self::Products { of, products: Products { inputs: view.shape[1], degrees: view.data.to_vec() } })
            }
            CALL => Ok(Self::Call { of, function: Graph::read(tensors, &joined([prefix, "function."]), true)? }),
            INTERPOLATE => {
                let instants = read_doubles(tensors, &joined([prefix, "instants"]))?;
                let functions = tensors.parts(
                    instants.len(),
                    |part| Graph::read_network(part, &joined([prefix, "functions"])),
                    Graph::with_numbers,
                )?;
                Ok(Self::Interpolate { of, column: code as usize, instants, functions })
            }
            DICTIONARY => Ok(Self::Dictionary { of, dictionary: Dictionary::read(tensors, prefix)? }),
            MOTION => Ok(Self::Motion { of, motion: Box::new(Motion::read(tensors, prefix)?) }),
            _ => Err(row.unknown(0)),
        }
    }
}

impl Forest {
    fn tensors(&self, prefix: &str) -> Vec<Tensor> {
        let Self { nodes, trees } = self;
        let columns: Vec<u32> = nodes.iter().map(|node| node.column).collect();
        let numbers: Vec<f64> = nodes.iter().map(|node| node.number).collect();
        let below: Vec<u32> = nodes.iter().flat_map(|node| node.below).collect();
        let [roots, outputs] =
            [|tree: &Tree| tree.root, |tree: &Tree| tree.output].map(|of| trees.iter().map(of).collect::<Vec<u32>>());
        vec![
            indices(&joined([prefix, "forest.column"]), vec![nodes.len()], &columns),
            doubles(&joined([prefix, "forest.number"]), vec![nodes.len()], &numbers),
            indices(&joined([prefix, "forest.below"]), vec![nodes.len(), 2], &below),
            indices(&joined([prefix, "forest.root"]), vec![trees.len()], &roots),
            indices(&joined([prefix, "forest.output"]), vec![trees.len()], &outputs),
        ]
    }

    /// The forest of the tensors whose names have this prefix.
    fn read(tensors: &mut Views, prefix: &str) -> Result<Self, FormatError> {
        let columns = read_indices(tensors, &joined([prefix, "forest.column"]))?;
        let roots = read_indices(tensors, &joined([prefix, "forest.root"]))?;
        let outputs = read_indices(tensors, &joined([prefix, "forest.output"]))?;
        let below = take(tensors, &joined([prefix, "forest.below"]), Dtype::U32, 2)?;
        expect_shape(joined([prefix, "forest.below"]), below.shape, &[columns.len(), 2])?;
        let below = elements(below.data, u32::from_le_bytes);
        let numbers = take(tensors, &joined([prefix, "forest.number"]), Dtype::F64, 1)?;
        let numbers = elements(numbers.data, f64::from_le_bytes);
        let nodes = columns.len();
        expect_shape(joined([prefix, "forest.number"]), &[numbers.len()], &[nodes])?;
        expect_shape(joined([prefix, "forest.output"]), &[outputs.len()], &[roots.len()])?;
        let below = below.as_chunks::<2>().0;
        let nodes = columns.into_iter().zip(numbers).zip(below);
        let trees = roots.into_iter().zip(outputs);
        Ok(Self {
            nodes: nodes.map(|((column, number), below)| Node { column, number, below: *below }).collect(),
            trees: trees.map(|(root, output)| Tree { root, output }).collect(),
        })
    }
}

fn read_doubles(tensors: &mut Views, name: &str) -> Result<Vec<f64>, FormatError> {
    Ok(elements(take(tensors, name, Dtype::F64, 1)?.data, f64::from_le_bytes))
}

fn read_indices(tensors: &mut Views, name: &str) -> Result<Vec<u32>, FormatError> {
    Ok(elements(take(tensors, name, Dtype::U32, 1)?.data, u32::from_le_bytes))
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
