//! Sequences of steps, each of which computes a vector from earlier ones: fitted baselines, and functions of
//! third-party tools.

mod cell;
mod composed;
mod elementwise;
mod evaluate;
mod forest;
mod learned;
mod process;
mod products;
mod series;
mod tensors;
#[cfg(test)]
mod tests;

use crate::{
    FormatError, Motion, Numbers, Precision, Rows,
    check::{expect_below, expect_finite, expect_positive, expect_shape},
    dictionary::Dictionary,
    network::{USUAL_SIZE, fits_single},
    simd::Simd,
    task::Task,
};
pub use composed::{Given, StateObserver};
pub use elementwise::Elementwise;
use evaluate::check_instants;
pub(crate) use evaluate::{GraphScratch, PreparedGraph};
pub use forest::{Forest, LEAF, Node, Tree};
pub use learned::KernelMachine;
pub use process::ProcessDeviation;
pub use products::Products;
use std::{fmt, sync::Arc};

/// A function as a sequence of steps. Value 0 is the vector of the input columns, step `k` makes value `k + 1`, and the last
/// value is the outputs. Derivatives are exact.
#[derive(Clone, Debug, PartialEq)]
pub struct Graph {
    /// Number of input columns.
    pub inputs: usize,
    /// At least one.
    pub steps: Vec<Step>,
}

/// Step that computes a vector `y` from earlier ones, `x`. `of` is the index of the value `x`.
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
        /// Parameters of `f`: [`Elementwise::parameters`] numbers, or a row for each of them with one number for each
        /// `x_i`.
        parameters: Vec<f64>,
    },
    /// `y_i = a_i op b_i`
    Combine {
        /// `a` and `b`, of one length.
        of: [usize; 2],
        /// `op`
        operation: Operation,
    },
    /// `y_i = a_i` where `c_i > 0`, else `b_i`; the number that is not chosen may be infinite or NaN.
    Select {
        /// `c`, `a` and `b`, of one length.
        of: [usize; 3],
    },
    /// `y_i` is a number of some value: parts of vectors, or several of them as one.
    Columns {
        /// For each `y_i` the number of a value, and the position in it.
        columns: Vec<[u32; 2]>,
    },
    /// `y_i = (x_i - mean_i) / scale_i`. As the first step, of the input columns, it is computed in double precision.
    Standardize {
        /// `x`
        of: usize,
        /// One for each `x_i`.
        mean: Vec<f64>,
        /// One for each `x_i`, positive.
        scale: Vec<f64>,
    },
    /// `y_i = mean_i + scale_i x_i`. As the last step it is computed in double precision.
    Rescale {
        /// `x`
        of: usize,
        /// One for each `x_i`.
        mean: Vec<f64>,
        /// One for each `x_i`, positive.
        scale: Vec<f64>,
    },
    /// `y_i = (x_i - m) / √(v + ε)`, with the mean `m` and the variance `v` of all `x_i`.
    Normalize {
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
        /// The trees: megabytes, which an evaluator shares.
        forest: Arc<Forest>,
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
    /// Another graph of `x`, which computes in the precision of the model.
    Call {
        /// `x`
        of: usize,
        /// The graph, without calls, interpolation, dictionaries and equations of motion.
        function: Graph,
    },
    /// Interpolation in `t`, one of the `x_i`, between networks of the others: `y = (1 - w) y_k + w y_(k+1)` with
    /// `w = (t - t_k) / (t_(k+1) - t_k)`. `y` is constant before the first time point and after the last.
    Interpolate {
        /// `x`
        of: usize,
        /// Position of `t` in `x`.
        column: usize,
        /// `t_0, ..., t_N`, ascending, at least two.
        instants: Vec<f64>,
        /// Network at each time point, with equal layer sizes, in the precision of the model.
        functions: Vec<Graph>,
    },
    /// Sums of products of powers, sines and cosines of `x_i`, in double precision.
    Dictionary {
        /// `x`
        of: usize,
        /// The functions.
        dictionary: Dictionary,
    },
    /// Equations of motion, in double precision.
    Motion {
        /// Parameters, inputs, coordinates and velocities.
        of: usize,
        /// The equations and their outputs.
        motion: Box<Motion>,
    },
}

/// Operation on two numbers.
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
    /// The smaller one; the first of equal ones counts for derivatives.
    Minimum,
}

impl Operation {
    /// All of them, in the order of their codes in the model file.
    pub const ALL: [Self; 6] = [Self::Add, Self::Subtract, Self::Multiply, Self::Divide, Self::Maximum, Self::Minimum];
}

/// Limit of the numbers in all values of a graph together: a file of a few megabytes must not ask for gigabytes of
/// memory.
pub const MAX_VALUES: usize = 1 << 22;

impl Graph {
    /// The outputs at each row of columns, in double precision.
    ///
    /// # Panics
    /// If lengths do not fit.
    pub fn evaluate(&self, rows: impl IntoIterator<Item: AsRef<[f64]>>) -> Rows {
        let (program, simd) = (PreparedGraph::new(self, Precision::Double), Simd::detect());
        let mut scratch = program.scratch();
        let width = self.widths().ok().and_then(|widths| widths.last().copied()).unwrap_or_default();
        let (mut outputs, mut all) = (vec![0.0; width], Rows::default());
        for row in rows {
            program.perform(simd, row.as_ref(), Task::Outputs(&mut outputs), &mut scratch);
            all.push(&outputs);
        }
        all
    }

    /// Lengths of all values: the inputs, and one of each step.
    ///
    /// # Errors
    /// [`FormatError`] if a step is of a value that is not before it, or of lengths that do not fit.
    pub fn widths(&self) -> Result<Vec<usize>, FormatError> {
        if self.inputs == 0 {
            return Err(FormatError::NoVariables { what: "inputs" });
        }
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

    /// Number of numbers of all values.
    fn value_numbers(&self) -> usize {
        self.widths().map_or(0, |widths| widths.iter().sum())
    }

    /// Returns true if single precision adds only rounding errors for inputs in these ranges. No input may be large compared with its
    /// range, and no step may divide, select or compare: there rounding may make a large difference.
    pub fn fits_single(&self, ranges: &[[f64; 2]]) -> bool {
        /// Size of an input for each unit of its range.
        const FAR: f64 = 16.0;
        let Ok(widths) = self.widths() else { return false };
        // standardized in double precision
        let standardized: Option<Vec<f64>> = match self.steps.first() {
            Some(Step::Standardize { mean, scale, .. }) => {
                let relative = ranges.iter().zip(mean).zip(scale).map(|((range, mean), scale)| {
                    range.iter().map(|end| ((end - mean) / scale).abs()).fold(0.0, f64::max)
                });
                Some(relative.collect())
            }
            _ => None,
        };
        let mut varying = ranges.iter().filter(|range| range[0] < range[1]);
        if standardized.is_none() && varying.any(|range| magnitude(range) > FAR * (range[1] - range[0])) {
            return false;
        }
        let sizes = |of: usize| match (of, &standardized) {
            (0, _) => ranges.iter().map(magnitude).collect(),
            (1, Some(sizes)) => sizes.clone(),
            _ => vec![USUAL_SIZE; widths[of]],
        };
        self.steps.iter().all(|step| match step {
            Step::Affine { of, weight, bias } => fits_single(weight, bias, &sizes(*of)),
            Step::Elementwise { function, .. } => function.is_smooth(),
            Step::Combine { operation, .. } => *operation != Operation::Divide,
            Step::Standardize { .. } | Step::Rescale { .. } => true,
            Step::Columns { .. } | Step::Normalize { .. } | Step::Softmax { .. } => true,
            Step::Select { .. } | Step::Distances { .. } | Step::Forest { .. } | Step::Products { .. } => false,
            Step::Call { .. } | Step::Interpolate { .. } | Step::Dictionary { .. } | Step::Motion { .. } => false,
        })
    }

    /// Makes sure that lengths fit the numbers of columns and outputs, and that every number is finite.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub fn check(&self, columns: usize, outputs: usize) -> Result<(), FormatError> {
        let widths = self.shape(columns)?;
        expect_shape("graph.steps", &[widths[self.steps.len()]], &[outputs])?;
        self.check_numbers()
    }

    /// Lengths of all values of a graph with this number of columns.
    pub(super) fn shape(&self, columns: usize) -> Result<Vec<usize>, FormatError> {
        if self.steps.is_empty() {
            return Err(FormatError::MissingTensor { name: "graph.steps".into() });
        }
        expect_shape("graph.inputs", &[self.inputs], &[columns])?;
        self.widths()
    }

    /// Makes sure that numbers are in their ranges.
    fn check_numbers(&self) -> Result<(), FormatError> {
        self.steps.iter().enumerate().try_for_each(|(number, step)| step.check_numbers(number))
    }
}

impl Step {
    /// Indices of the operand values, repeated operands included.
    pub fn values(&self) -> impl Iterator<Item = usize> + '_ {
        let (few, columns): (&[usize], &[[u32; 2]]) = match self {
            Self::Affine { of, .. }
            | Self::Elementwise { of, .. }
            | Self::Standardize { of, .. }
            | Self::Rescale { of, .. }
            | Self::Normalize { of, .. }
            | Self::Softmax { of }
            | Self::Distances { of, .. }
            | Self::Forest { of, .. }
            | Self::Products { of, .. }
            | Self::Call { of, .. }
            | Self::Interpolate { of, .. }
            | Self::Dictionary { of, .. }
            | Self::Motion { of, .. } => (std::slice::from_ref(of), &[]),
            Self::Combine { of, .. } => (of, &[]),
            Self::Select { of } => (of, &[]),
            Self::Columns { columns } => (&[], columns),
        };
        few.iter().copied().chain(columns.iter().map(|[of, _]| *of as usize))
    }

    /// Renumbers the operand values.
    pub fn rename(&mut self, renamed: impl Fn(usize) -> usize) {
        match self {
            Self::Affine { of, .. }
            | Self::Elementwise { of, .. }
            | Self::Standardize { of, .. }
            | Self::Rescale { of, .. }
            | Self::Normalize { of, .. }
            | Self::Softmax { of }
            | Self::Distances { of, .. }
            | Self::Forest { of, .. }
            | Self::Products { of, .. }
            | Self::Call { of, .. }
            | Self::Interpolate { of, .. }
            | Self::Dictionary { of, .. }
            | Self::Motion { of, .. } => *of = renamed(*of),
            Self::Combine { of, .. } => *of = of.map(renamed),
            Self::Select { of } => *of = of.map(renamed),
            Self::Columns { columns } => {
                columns.iter_mut().for_each(|[of, _]| *of = renamed(*of as usize) as u32);
            }
        }
    }

    /// Returns true if the step has separate working memory.
    pub(crate) fn is_nested(&self) -> bool {
        matches!(self, Self::Call { .. } | Self::Interpolate { .. } | Self::Dictionary { .. } | Self::Motion { .. })
    }

    /// Number of numbers that an evaluation keeps beside those that the step makes.
    pub fn noted(&self) -> usize {
        match self {
            Self::Products { products, .. } => products.polynomials(),
            Self::Call { function, .. } => function.value_numbers(),
            Self::Interpolate { functions, .. } => functions.first().map_or(0, Graph::value_numbers),
            _ => 0,
        }
    }

    /// Makes sure that numbers are in their ranges.
    fn check_numbers(&self, number: usize) -> Result<(), FormatError> {
        match self {
            Self::Affine { weight, bias, .. } => {
                weight.expect_finite(StepName(number, "weight"))?;
                bias.expect_finite(StepName(number, "bias"))
            }
            Self::Elementwise { parameters, .. } => {
                expect_finite(StepName(number, "parameters"), parameters.iter().copied())
            }
            Self::Standardize { mean, scale, .. } | Self::Rescale { mean, scale, .. } => {
                expect_finite(StepName(number, "mean"), mean.iter().copied())?;
                expect_finite(StepName(number, "scale"), scale.iter().copied())?;
                expect_positive(StepName(number, "scale"), scale)
            }
            Self::Normalize { epsilon, .. } => {
                expect_finite(StepName(number, "parameters"), [*epsilon].into_iter())?;
                if *epsilon < 0.0 {
                    return Err(FormatError::NotPositive {
                        name: StepName(number, "parameters").to_string(),
                        index: 0,
                        value: *epsilon,
                    });
                }
                Ok(())
            }
            Self::Distances { centres, lengths, .. } => {
                expect_finite(StepName(number, "lengths"), lengths.iter().copied())?;
                expect_positive(StepName(number, "lengths"), lengths)?;
                expect_finite(StepName(number, "centres"), centres.iter().copied())
            }
            Self::Call { function, .. } => function.check_numbers(),
            Self::Interpolate { functions, .. } => functions.iter().enumerate().try_for_each(|(instant, function)| {
                function.check_numbers().map_err(|source| source.of_instant(instant))
            }),
            Self::Motion { motion, .. } => motion.check(),
            // dictionaries are checked when they are made, the others have shapes alone
            Self::Dictionary { .. } | Self::Forest { .. } | Self::Products { .. } => Ok(()),
            Self::Combine { .. } | Self::Select { .. } | Self::Columns { .. } | Self::Softmax { .. } => Ok(()),
        }
    }

    /// Length of what the step makes, of the values before it; its shape is checked.
    fn width(&self, number: usize, widths: &[usize]) -> Result<usize, FormatError> {
        let width = |of: usize| expect_below(&"graph.steps", number, of, widths.len()).map(|()| widths[of]);
        match self {
            Self::Affine { of, weight, bias } => {
                expect_shape(StepName(number, "weight"), &[weight.len()], &[bias.len() * width(*of)?])?;
                not_empty(bias.len())
            }
            Self::Elementwise { of, function, parameters } => {
                let (width, count) = (width(*of)?, function.parameters());
                if parameters.len() != count {
                    expect_shape(StepName(number, "parameters"), &[parameters.len()], &[count * width])?;
                }
                Ok(width)
            }
            Self::Combine { of: [a, b], .. } => {
                expect_shape(format_args!("graph.{number}"), &[width(*b)?], &[width(*a)?])?;
                width(*a)
            }
            Self::Select { of: [condition, a, b] } => {
                expect_shape(format_args!("graph.{number}"), &[width(*a)?], &[width(*condition)?])?;
                expect_shape(format_args!("graph.{number}"), &[width(*b)?], &[width(*condition)?])?;
                width(*a)
            }
            Self::Columns { columns } => {
                for (index, [of, column]) in columns.iter().enumerate() {
                    expect_below(&StepName(number, "columns"), index, *column as usize, width(*of as usize)?)?;
                }
                not_empty(columns.len())
            }
            Self::Standardize { of, mean, scale } | Self::Rescale { of, mean, scale } => {
                let width = width(*of)?;
                for (what, values) in [("mean", mean), ("scale", scale)] {
                    expect_shape(StepName(number, what), &[values.len()], &[width])?;
                }
                Ok(width)
            }
            Self::Normalize { of, .. } | Self::Softmax { of } => width(*of),
            Self::Distances { of, centres, lengths } => {
                let width = width(*of)?;
                expect_shape(StepName(number, "lengths"), &[lengths.len()], &[width])?;
                expect_shape(StepName(number, "centres"), &[centres.len()], &[centres.len() / width * width])?;
                not_empty(centres.len() / width)
            }
            Self::Forest { of, forest, outputs } => {
                forest.check(width(*of)?, *outputs)?;
                not_empty(*outputs)
            }
            Self::Products { of, products } => {
                products.check(&StepName(number, "degrees").to_string(), width(*of)?)?;
                not_empty(products.terms())
            }
            Self::Call { of, function } => {
                if function.steps.iter().any(Self::is_nested) {
                    return Err(FormatError::NestedFunction { name: StepName(number, "function").to_string() });
                }
                not_empty(function.shape(width(*of)?)?[function.steps.len()])
            }
            Self::Interpolate { of, column, instants, functions } => {
                check_instants(&StepName(number, "instants").to_string(), (width(*of)?, *column), instants, functions)
            }
            Self::Dictionary { of, dictionary } => {
                expect_shape(StepName(number, "functions"), &[dictionary.columns()], &[width(*of)?])?;
                not_empty(dictionary.outputs())
            }
            Self::Motion { of, motion } => {
                expect_shape(StepName(number, "motion"), &[motion.columns()], &[width(*of)?])?;
                not_empty(motion.results())
            }
        }
    }
}

/// Name of a step's tensor, written only where an error needs it.
struct StepName(usize, &'static str);

impl fmt::Display for StepName {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self(number, what) = self;
        write!(f, "graph.{number}.{what}")
    }
}

/// The larger magnitude of the ends of a range.
fn magnitude([min, max]: &[f64; 2]) -> f64 {
    min.abs().max(max.abs())
}

fn not_empty(width: usize) -> Result<usize, FormatError> {
    if width == 0 { Err(FormatError::NoVariables { what: "outputs" }) } else { Ok(width) }
}
