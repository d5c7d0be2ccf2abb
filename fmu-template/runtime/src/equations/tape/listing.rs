//! Equations as data, for generators of code: the operations of a tape, in the order in which they run.

use super::{Argument, LaneOperation, Part, Register, Tape, TapeOperation};
use crate::{
    Activation,
    bends::BentArgument,
    formula::{Combination, ElementaryFunction, LookupTable},
};
use std::{ops::Range, sync::Arc};

/// Length of a lane. The length of a block is a multiple of it.
pub const LANES: usize = super::LANES;

/// Operations that compute results from inputs. Registers hold all numbers: the inputs first, then zero and one.
#[derive(Clone, Debug, PartialEq)]
pub struct Listing {
    /// Number of inputs.
    pub inputs: usize,
    /// Fixed inputs: their part of the instructions runs only when they change.
    pub fixed: Range<usize>,
    /// Number of registers.
    pub registers: usize,
    /// Registers of constants, zero and one first, with their values.
    pub constants: Vec<(u32, f64)>,
    /// Lookup tables.
    pub tables: Vec<Arc<LookupTable>>,
    /// Arguments with bends that depend on inputs that are not fixed, and their registers.
    pub arguments: Vec<(BentArgument, u32)>,
    /// Weights of layers.
    pub weights: Vec<[f64; LANES]>,
    /// Instructions that depend on fixed inputs alone, the others, and those of rarely needed results.
    pub instructions: [Vec<Instruction>; 3],
    /// Registers of the results.
    pub results: Vec<u32>,
}

/// An operation on the registers `a`, `b` and `c`, whose result begins at `to`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instruction {
    /// Function.
    pub kind: InstructionKind,
    /// First operand.
    pub a: u32,
    /// Second operand.
    pub b: u32,
    /// Third operand.
    pub c: u32,
    /// First register of the result.
    pub to: u32,
    /// Number of terms, multiples or lanes.
    pub count: u32,
    /// Position of the first weights, or of the table.
    pub data: u32,
}

/// Function of an [`Instruction`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InstructionKind {
    /// Cosines of 1, 2, ... times the angle `a`, and after them as many sines.
    Harmonics,
    /// `a b + c`
    Product,
    /// `sum over i of a_i b_i + c`
    Products,
    /// `1 / a`, NaN where `a` is not positive.
    Reciprocal,
    /// `f(a)`
    Call(ElementaryFunction),
    /// `f(a, b)`
    Combine(Combination),
    /// A table at `a` or, if it has two arguments, at `a` and `b`.
    Lookup,
    /// The block `W a + c`, with weights column by column of each lane; `b` is the number of columns. `c` may be the register of zero.
    Matrix,
    /// `w^T a + c` of a block `a`.
    Dot,
    /// The block `f(a_i)`, and after it the block of slopes `f'(a_i)`.
    Activation(Activation),
    /// The block `a_i b_i`.
    LaneProducts,
}

impl Tape {
    pub(crate) fn listing(&self, results: impl IntoIterator<Item = Register>) -> Listing {
        let Self { fixed, registers, constants, tables, arguments, weights, of_fixed, of_others, rest } = self;
        Listing {
            inputs: constants[0].0.index(),
            fixed: fixed.clone(),
            registers: *registers,
            constants: constants.iter().map(|(to, value)| (to.0, *value)).collect(),
            tables: tables.clone(),
            arguments: arguments.iter().map(|Argument { with, of }| (with.clone(), of.0)).collect(),
            weights: weights.clone(),
            instructions: [of_fixed, of_others, rest].map(|part| part.instructions(constants[0].0)),
            results: results.into_iter().map(|register| register.0).collect(),
        }
    }
}

impl Part {
    fn instructions(&self, zero: Register) -> Vec<Instruction> {
        let angles = self.angles.iter().map(|angle| Instruction {
            count: angle.count,
            ..Instruction::new(InstructionKind::Harmonics, [angle.of; 3], angle.first)
        });
        let operations = self.operations.iter().flat_map(|operation| match *operation {
            TapeOperation::Lanes { first, count } => {
                self.lanes[first as usize..][..count as usize].iter().map(|lane| lane.instruction(zero)).collect()
            }
            _ => vec![operation.instruction()],
        });
        angles.chain(operations).collect()
    }
}

impl Instruction {
    fn new(kind: InstructionKind, [a, b, c]: [Register; 3], to: Register) -> Self {
        Self { kind, a: a.0, b: b.0, c: c.0, to: to.0, count: 1, data: 0 }
    }
}

impl TapeOperation {
    fn instruction(&self) -> Instruction {
        use InstructionKind as Kind;
        match *self {
            Self::Product { a, b, c, to } => Instruction::new(Kind::Product, [a, b, c], to),
            Self::Products { a, b, count, c, to } => {
                Instruction { count, ..Instruction::new(Kind::Products, [a, b, c], to) }
            }
            Self::Reciprocal { of, to } => Instruction::new(Kind::Reciprocal, [of; 3], to),
            Self::Call { function, of, to } => Instruction::new(Kind::Call(function), [of; 3], to),
            Self::Combine { combination, a, b, to } => Instruction::new(Kind::Combine(combination), [a, b, b], to),
            Self::Lookup { table, at: [a, b], to } => {
                Instruction { data: table, ..Instruction::new(Kind::Lookup, [a, b, b], to) }
            }
            Self::Lanes { .. } => unreachable!("its operations are listed one by one"),
        }
    }
}

impl LaneOperation {
    fn instruction(&self, zero: Register) -> Instruction {
        use InstructionKind as Kind;
        match *self {
            Self::Matrix { weights, of, columns, c, to, lanes } => {
                let instruction = Instruction::new(Kind::Matrix, [of, of, c.unwrap_or(zero)], to);
                Instruction { b: columns, count: lanes, data: weights, ..instruction }
            }
            Self::Dot { weights, of, c, to, lanes } => {
                Instruction { count: lanes, data: weights, ..Instruction::new(Kind::Dot, [of, of, c], to) }
            }
            Self::Activation { function, of, to, lanes } => {
                Instruction { count: lanes, ..Instruction::new(Kind::Activation(function), [of; 3], to) }
            }
            Self::Products { a, b, to, lanes } => {
                Instruction { count: lanes, ..Instruction::new(Kind::LaneProducts, [a, b, b], to) }
            }
        }
    }
}
