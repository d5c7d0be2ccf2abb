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
        let step = |(number, codes): (usize, &[u32; 4])| {
            let unknown = |place: usize| FormatError::Unknown {
                name: name.clone(),
                index: 4 * number + place,
                found: codes[place],
            };
            if is_called && codes[0] >= CALL {
                return Err(unknown(0));
            }
            Step::read(tensors, &joined([prefix, &number.to_string(), "."]), *codes, unknown)
        };
        let steps = steps.iter().enumerate().map(step).collect::<Result<_, _>>()?;
        Ok(Self { inputs, steps })
    }

    /// A network with the same steps and other numbers: those of its tensors, in their order.
    fn with_numbers(&self, tensors: &mut dyn Iterator<Item = Numbers>) -> Self {
        let mut next = || tensors.next().unwrap_or(Numbers::Double(Vec::new()));
        // types are those of the first network, which were checked
        let doubles = |next: Numbers| match next {
            Numbers::Double(numbers) => numbers,
            Numbers::Single(_) => Vec::new(),
        };
        let steps = self.steps.iter().map(|step| match *step {
            Step::Affine { of, .. } => Step::Affine { of, weight: next(), bias: next() },
            Step::Standardize { of, .. } => Step::Standardize { of, mean: doubles(next()), scale: doubles(next()) },
            Step::Rescale { of, .. } => Step::Rescale { of, mean: doubles(next()), scale: doubles(next()) },
            ref other => other.clone(),
        });
        Self { inputs: self.inputs, steps: steps.collect() }
    }
}

impl Step {
    /// Kind and code of the step, and its operands.
    fn codes(&self) -> [u32; 4] {
        let place = |found: Option<usize>| found.expect("all of them are listed") as u32;
        match self {
            Self::Affine { of, .. } => [AFFINE, 0, *of as u32, 0],
            Self::Elementwise { of, function, .. } => [ELEMENTWISE, function.code() as u32, *of as u32, 0],
            Self::Combine { of: [a, b], operation } => {
                let code = place(Operation::ALL.iter().position(|known| known == operation));
                [COMBINE, code, *a as u32, *b as u32]
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
        let name = |what: &str| joined([prefix, what]);
        match self {
            Self::Affine { weight, bias, .. } => {
                let shape = vec![bias.len(), weight.len() / bias.len().max(1)];
                let bias_shape = vec![bias.len()];
                vec![of_numbers(&name("weight"), shape, weight), of_numbers(&name("bias"), bias_shape, bias)]
            }
            Self::Elementwise { parameters, .. } if parameters.is_empty() => Vec::new(),
            Self::Elementwise { parameters, .. } => {
                vec![doubles(&name("parameters"), vec![parameters.len()], parameters)]
            }
            Self::Columns { columns } => {
                let content = columns.iter().flatten().copied().collect::<Vec<u32>>();
                vec![indices(&name("columns"), vec![columns.len(), 2], &content)]
            }
            Self::Standardize { mean, scale, .. } | Self::Rescale { mean, scale, .. } => {
                vec![doubles(&name("mean"), vec![mean.len()], mean), doubles(&name("scale"), vec![scale.len()], scale)]
            }
            Self::Normalize { epsilon, .. } => vec![doubles(&name("parameters"), vec![1], &[*epsilon])],
            Self::Distances { centres, lengths, .. } => {
                let shape = vec![centres.len() / lengths.len().max(1), lengths.len()];
                vec![doubles(&name("centres"), shape, centres), doubles(&name("lengths"), vec![lengths.len()], lengths)]
            }
            Self::Forest { forest, .. } => forest.tensors(prefix),
            Self::Products { products, .. } => {
                let shape = vec![products.terms(), products.inputs];
                vec![(name("degrees"), Dtype::U8, shape, products.degrees.clone())]
            }
            Self::Combine { .. } | Self::Select { .. } | Self::Softmax { .. } => Vec::new(),
            Self::Call { function, .. } => function.tensors(&name("function.")),
            Self::Interpolate { instants, functions, .. } => {
                let mut tensors = vec![doubles(&name("instants"), vec![instants.len()], instants)];
                let functions = functions.iter().map(|function| function.tensors(&name("functions.")));
                tensors.extend(stacked(functions));
                tensors
            }
            Self::Dictionary { dictionary, .. } => dictionary.tensors(prefix),
            Self::Motion { motion, .. } => motion.tensors(prefix),
        }
    }

    /// The step of the tensors whose names begin with this; `unknown` is the error about one of the codes.
    fn read(
        tensors: &mut Views,
        prefix: &str,
        [kind, code, a, b]: [u32; 4],
        unknown: impl Fn(usize) -> FormatError,
    ) -> Result<Self, FormatError> {
        let name = |what: &str| joined([prefix, what]);
        let mut doubles = |what: &str| -> Result<Vec<f64>, FormatError> {
            let view = take(tensors, &name(what), Dtype::F64, 1)?;
            Ok(elements(view.data, f64::from_le_bytes))
        };
        let of = a as usize;
        match kind {
            AFFINE => {
                let mut read = |what: &str, dimensions: usize| -> Result<_, FormatError> {
                    let view = take_one_of(tensors, &name(what), &[Dtype::F32, Dtype::F64], dimensions)?;
                    Ok((numbers(view.dtype, view.data), view.shape))
                };
                let ((weight, shape), (bias, _)) = (read("weight", 2)?, read("bias", 1)?);
                expect_shape(name("weight"), shape, &[bias.len(), weight.len() / bias.len().max(1)])?;
                Ok(Self::Affine { of, weight, bias })
            }
            ELEMENTWISE => {
                let function = Elementwise::of_code(code as usize).ok_or_else(|| unknown(1))?;
                let parameters = if function.parameters() > 0 { doubles("parameters")? } else { Vec::new() };
                Ok(Self::Elementwise { of, function, parameters })
            }
            COMBINE => {
                let operation = *Operation::ALL.get(code as usize).ok_or_else(|| unknown(1))?;
                Ok(Self::Combine { of: [of, b as usize], operation })
            }
            SELECT => Ok(Self::Select { of: [code as usize, of, b as usize] }),
            COLUMNS => Ok(Self::Columns { columns: whole_rows(tensors, &name("columns"))? }),
            STANDARDIZE => Ok(Self::Standardize { of, mean: doubles("mean")?, scale: doubles("scale")? }),
            RESCALE => Ok(Self::Rescale { of, mean: doubles("mean")?, scale: doubles("scale")? }),
            NORMALIZE => {
                let parameters = doubles("parameters")?;
                expect_shape(name("parameters"), &[parameters.len()], &[1])?;
                Ok(Self::Normalize { of, epsilon: parameters[0] })
            }
            SOFTMAX => Ok(Self::Softmax { of }),
            DISTANCES => {
                let lengths = doubles("lengths")?;
                let centres = take(tensors, &name("centres"), Dtype::F64, 2)?;
                expect_shape(name("centres"), &centres.shape[1..], &[lengths.len()])?;
                Ok(Self::Distances { of, centres: elements(centres.data, f64::from_le_bytes), lengths })
            }
            FOREST => Ok(Self::Forest { of, forest: Forest::read(tensors, prefix)?.into(), outputs: code as usize }),
            PRODUCTS => {
                let view = take(tensors, &name("degrees"), Dtype::U8, 2)?;
                Ok(Self::Products { of, products: Products { inputs: view.shape[1], degrees: view.data.to_vec() } })
            }
            CALL => Ok(Self::Call { of, function: Graph::read(tensors, &name("function."), true)? }),
            INTERPOLATE => {
                let instants = doubles("instants")?;
                let first = |part: &mut Views| {
                    let function = Graph::read(part, &name("functions."), true)?;
                    let problem = || FormatError::NoNetwork { name: name("functions") };
                    if function.is_network() { Ok(function) } else { Err(problem()) }
                };
                let functions = tensors.parts(instants.len(), first, Graph::with_numbers)?;
                Ok(Self::Interpolate { of, column: code as usize, instants, functions })
            }
            DICTIONARY => Ok(Self::Dictionary { of, dictionary: Dictionary::read(tensors, prefix)? }),
            MOTION => Ok(Self::Motion { of, motion: Box::new(Motion::read(tensors, prefix)?) }),
            _ => Err(unknown(0)),
        }
    }
}

impl Forest {
    fn tensors(&self, prefix: &str) -> Vec<Tensor> {
        let Self { nodes, trees } = self;
        let name = |what: &str| joined([prefix, "forest.", what]);
        let columns: Vec<u32> = nodes.iter().map(|node| node.column).collect();
        let numbers: Vec<f64> = nodes.iter().map(|node| node.number).collect();
        let below: Vec<u32> = nodes.iter().flat_map(|node| node.below).collect();
        let [roots, outputs] =
            [|tree: &Tree| tree.root, |tree: &Tree| tree.output].map(|of| trees.iter().map(of).collect::<Vec<u32>>());
        vec![
            indices(&name("column"), vec![nodes.len()], &columns),
            doubles(&name("number"), vec![nodes.len()], &numbers),
            indices(&name("below"), vec![nodes.len(), 2], &below),
            indices(&name("root"), vec![trees.len()], &roots),
            indices(&name("output"), vec![trees.len()], &outputs),
        ]
    }

    /// The forest of the tensors whose names have this prefix.
    fn read(tensors: &mut Views, prefix: &str) -> Result<Self, FormatError> {
        let name = |what: &str| joined([prefix, "forest.", what]);
        let mut indices = |what: &str| {
            let view = take(tensors, &name(what), Dtype::U32, 1)?;
            Ok::<_, FormatError>(elements(view.data, u32::from_le_bytes))
        };
        let (columns, roots, outputs) = (indices("column")?, indices("root")?, indices("output")?);
        let below = take(tensors, &name("below"), Dtype::U32, 2)?;
        expect_shape(name("below"), below.shape, &[columns.len(), 2])?;
        let below = elements(below.data, u32::from_le_bytes);
        let numbers = take(tensors, &name("number"), Dtype::F64, 1)?;
        let numbers = elements(numbers.data, f64::from_le_bytes);
        let nodes = columns.len();
        expect_shape(name("number"), &[numbers.len()], &[nodes])?;
        expect_shape(name("output"), &[outputs.len()], &[roots.len()])?;
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
