//! Sequences of steps, each of which makes a vector of those before it: what baselines fit, and functions of other tools.

mod cell;
mod elementwise;
mod evaluate;
mod forest;
mod learned;
mod other;
mod products;
mod tensors;
#[cfg(test)]
mod tests;

use super::{Numbers, USUAL_SIZE, expect_finite, expect_positive, expect_shape, fits_single};
use crate::FormatError;
pub use elementwise::Elementwise;
pub(crate) use evaluate::{GraphScratch, PreparedGraph};
pub use forest::{Forest, LEAF, Node, Tree};
pub use learned::KernelMachine;
pub use products::Products;

/// A function as a sequence of steps. Value 0 is the vector of the input columns, step `k` makes value `k + 1`, and the last
/// value is the outputs. Derivatives are exact.
#[derive(Clone, Debug, PartialEq)]
pub struct Graph {
    /// Number of input columns.
    pub inputs: usize,
    /// At least one.
    pub steps: Vec<Step>,
}

/// What makes a vector `y` of earlier ones, `x`. `of` is the number of the value that `x` is.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// `y = W x + b`
    Affine {
        /// `x`
        of: usize,
        /// `W`, row by row: shape `[outputs, inputs]`.
        weight: Numbers,
        /// `b`: shape `[outputs]`.
        bias: Numbers,
    },
    /// `y_i = f(x_i)`
    Elementwise {
        /// `x`
        of: usize,
        /// `f`
        function: Elementwise,
        /// What `f` depends on besides, [`Elementwise::parameters`] in number; or so many rows of one number for each `x_i`.
        parameters: Vec<f64>,
    },
    /// `y_i = a_i op b_i`
    Combine {
        /// `a` and `b`, of one length.
        of: [usize; 2],
        /// `op`
        operation: Operation,
    },
    /// `y_i = a_i` where `c_i > 0`, else `b_i`; what is not chosen may be infinite or not a number.
    Select {
        /// `c`, `a` and `b`, of one length.
        of: [usize; 3],
    },
    /// `y_i` is a number of some value: parts of vectors, or several of them as one.
    Columns {
        /// For each `y_i` the number of a value, and the position in it.
        columns: Vec<[u32; 2]>,
    },
    /// `y_i = (x_i - m) / √(v + ε)`, with the mean `m` and the variance `v` of all `x_i`.
    Standardise {
        /// `x`
        of: usize,
        /// `ε`, not negative.
        epsilon: f64,
    },
    /// `y_i = exp(x_i) / sum_j exp(x_j)`
    Softmax {
        /// `x`
        of: usize,
    },
    /// `y_c = sum_i ((x_i - centres[c, i]) / lengths[i])²`
    Distances {
        /// `x`
        of: usize,
        /// Shape `[outputs, inputs]`.
        centres: Vec<f64>,
        /// Length scale of each `x_i`, positive.
        lengths: Vec<f64>,
    },
    /// Sums of decision trees: piecewise constant, so every derivative is 0.
    Forest {
        /// `x`
        of: usize,
        /// The trees.
        forest: Forest,
        /// Number of `y_i`.
        outputs: usize,
    },
    /// Products of Legendre polynomials of `x_i`, one for each term.
    Products {
        /// `x`
        of: usize,
        /// The terms.
        products: Products,
    },
}

/// What makes one number of two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// `a + b`
    Add,
    /// `a - b`
    Subtract,
    /// `a b`
    Multiply,
    /// `a / b`
    Divide,
    /// The larger one; the first of equal ones counts for derivatives.
    Maximum,
    /// The smaller one, likewise.
    Minimum,
}

impl Operation {
    /// All of them, in the order of their codes in the model file.
    pub const ALL: [Self; 6] = [Self::Add, Self::Subtract, Self::Multiply, Self::Divide, Self::Maximum, Self::Minimum];
}

/// How many numbers all values of a graph may have together: a file of a few megabytes must not ask for gigabytes of memory.
pub const MAX_VALUES: usize = 1 << 22;

impl Graph {
    /// Lengths of all values: the inputs, and one of each step.
    ///
    /// # Errors
    /// [`FormatError`] if a step is of a value that is not before it, or of lengths that do not fit.
    pub fn widths(&self) -> Result<Vec<usize>, FormatError> {
        let mut widths = vec![self.inputs];
        for (number, step) in self.steps.iter().enumerate() {
            widths.push(step.width(number, &widths)?);
        }
        let noted = self.steps.iter().map(Step::noted);
        let numbers = widths.iter().copied().chain(noted).fold(0, usize::saturating_add);
        if numbers > MAX_VALUES {
            return Err(FormatError::TooLarge { found: numbers, limit: MAX_VALUES });
        }
        Ok(widths)
    }

    /// Returns true if single precision adds only rounding errors for inputs in these ranges. No input may be large compared with its
    /// range, and no step may divide, select or compare: there rounding may make a large difference.
    pub fn fits_single(&self, ranges: &[[f64; 2]]) -> bool {
        /// Size of an input for each unit of its range.
        const FAR: f64 = 16.0;
        let size = |[min, max]: &[f64; 2]| min.abs().max(max.abs());
        if ranges.iter().any(|range| range[0] < range[1] && size(range) > FAR * (range[1] - range[0])) {
            return false;
        }
        let Ok(widths) = self.widths() else { return false };
        let sizes = |of: usize| match of {
            0 => ranges.iter().map(size).collect(),
            _ => vec![USUAL_SIZE; widths[of]],
        };
        self.steps.iter().all(|step| match step {
            Step::Affine { of, weight, bias } => fits_single(weight, bias, &sizes(*of)),
            Step::Elementwise { function, .. } => function.is_smooth(),
            Step::Combine { operation, .. } => *operation != Operation::Divide,
            Step::Columns { .. } | Step::Standardise { .. } | Step::Softmax { .. } => true,
            Step::Select { .. } | Step::Distances { .. } | Step::Forest { .. } | Step::Products { .. } => false,
        })
    }

    /// Makes sure that lengths fit so many columns and outputs, and that every number is finite.
    pub(crate) fn check(&self, columns: usize, outputs: usize) -> Result<(), FormatError> {
        if self.steps.is_empty() {
            return Err(FormatError::MissingTensor { name: "graph.steps".into() });
        }
        expect_shape("graph.inputs", &[self.inputs], &[columns])?;
        let widths = self.widths()?;
        expect_shape("graph.steps", &[widths[self.steps.len()]], &[outputs])
    }
}

impl Step {
    /// Indices of the operand values, repeated operands included.
    pub fn values(&self) -> impl Iterator<Item = usize> + '_ {
        let (few, columns): (&[usize], &[[u32; 2]]) = match self {
            Self::Affine { of, .. }
            | Self::Elementwise { of, .. }
            | Self::Standardise { of, .. }
            | Self::Softmax { of }
            | Self::Distances { of, .. }
            | Self::Forest { of, .. }
            | Self::Products { of, .. } => (std::slice::from_ref(of), &[]),
            Self::Combine { of, .. } => (of, &[]),
            Self::Select { of } => (of, &[]),
            Self::Columns { columns } => (&[], columns),
        };
        few.iter().copied().chain(columns.iter().map(|[of, _]| *of as usize))
    }

    /// Number of numbers that an evaluation keeps beside those that the step makes.
    pub fn noted(&self) -> usize {
        if let Self::Products { products, .. } = self { products.polynomials() } else { 0 }
    }

    /// Length of what the step makes, of the values before it; every number of it is checked.
    fn width(&self, number: usize, widths: &[usize]) -> Result<usize, FormatError> {
        let name = |what: &str| format!("graph.{number}.{what}");
        let width = |of: usize| match widths.get(of) {
            Some(width) => Ok(*width),
            None => Err(FormatError::Index {
                name: "graph.steps".into(),
                index: number,
                found: of as u64,
                limit: widths.len() as u64,
            }),
        };
        match self {
            Self::Affine { of, weight, bias } => {
                expect_shape(&name("weight"), &[weight.len()], &[bias.len() * width(*of)?])?;
                expect_finite(&name("weight"), weight.iter())?;
                expect_finite(&name("bias"), bias.iter())?;
                not_empty(bias.len())
            }
            Self::Elementwise { of, function, parameters } => {
                let (width, count) = (width(*of)?, function.parameters());
                if parameters.len() != count {
                    expect_shape(&name("parameters"), &[parameters.len()], &[count * width])?;
                }
                expect_finite(&name("parameters"), parameters.iter().copied())?;
                Ok(width)
            }
            Self::Combine { of: [a, b], .. } => {
                expect_shape(&format!("graph.{number}"), &[width(*b)?], &[width(*a)?])?;
                width(*a)
            }
            Self::Select { of: [condition, a, b] } => {
                expect_shape(&format!("graph.{number}"), &[width(*a)?], &[width(*condition)?])?;
                expect_shape(&format!("graph.{number}"), &[width(*b)?], &[width(*condition)?])?;
                width(*a)
            }
            Self::Columns { columns } => {
                for (index, [of, column]) in columns.iter().enumerate() {
                    let limit = width(*of as usize)?;
                    if *column as usize >= limit {
                        let (found, limit) = (u64::from(*column), limit as u64);
                        return Err(FormatError::Index { name: name("columns"), index, found, limit });
                    }
                }
                not_empty(columns.len())
            }
            Self::Standardise { of, epsilon } => {
                expect_finite(&name("parameters"), [*epsilon].into_iter())?;
                if *epsilon < 0.0 {
                    return Err(FormatError::NotPositive { name: name("parameters"), index: 0, value: *epsilon });
                }
                width(*of)
            }
            Self::Softmax { of } => width(*of),
            Self::Distances { of, centres, lengths } => {
                let width = width(*of)?;
                expect_shape(&name("lengths"), &[lengths.len()], &[width])?;
                expect_finite(&name("lengths"), lengths.iter().copied())?;
                expect_positive(&name("lengths"), lengths)?;
                expect_finite(&name("centres"), centres.iter().copied())?;
                expect_shape(&name("centres"), &[centres.len()], &[centres.len() / width * width])?;
                not_empty(centres.len() / width)
            }
            Self::Forest { of, forest, outputs } => {
                forest.check(width(*of)?, *outputs)?;
                not_empty(*outputs)
            }
            Self::Products { of, products } => {
                products.check(&name("degrees"), width(*of)?)?;
                not_empty(products.terms())
            }
        }
    }
}

fn not_empty(width: usize) -> Result<usize, FormatError> {
    if width == 0 { Err(FormatError::NoVariables { what: "outputs" }) } else { Ok(width) }
}
