//! Layers of networks on a tape: operations on blocks of registers, which are whole lanes.

use super::{BindingTime, LANES, Register, Tape, TapeBuilder, TapeOperation};
use crate::{
    Activation,
    numbers::{
        activation::{finish, has_tanh, prepare},
        jet::Number,
    },
    simd::{Compute, Simd},
};

/// Operation of a layer on blocks of `lanes` lanes, with [`LANES`] registers each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum LaneOperation {
    /// `to = W of + c`, with `weights[lane * columns + column]`; `c` is zero if it is none.
    Matrix { weights: u32, of: Register, columns: u32, c: Option<Register>, to: Register, lanes: u32 },
    /// `to = w^T of + c`, a number.
    Dot { weights: u32, of: Register, c: Register, to: Register, lanes: u32 },
    /// `to_i = f(of_i)`, and in the block after it the slopes `f'(of_i)`.
    Activation { function: Activation, of: Register, to: Register, lanes: u32 },
    /// `to_i = a_i b_i`
    Products { a: Register, b: Register, to: Register, lanes: u32 },
}

impl Tape {
    /// Runs consecutive operations. One call for all of them: the loop over other operations stays small.
    #[inline(never)]
    pub(super) fn run_lanes<T: Number>(&self, operations: &[LaneOperation], registers: &mut [T]) {
        // series are compiled once, and FMUs stay small
        let simd = if T::DEPTH < 1 { Simd::detect() } else { Simd::Portable };
        simd.run(RunLanes { tape: self, operations, registers });
    }
}

struct RunLanes<'a, T> {
    tape: &'a Tape,
    operations: &'a [LaneOperation],
    registers: &'a mut [T],
}

impl<T: Number> Compute for RunLanes<'_, T> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        let Self { tape, operations, registers } = self;
        for operation in operations {
            match *operation {
                LaneOperation::Matrix { weights, of, columns, c, to, lanes } => {
                    let weights = tape.weights[weights as usize..].chunks_exact(columns as usize);
                    for (lane, weights) in weights.take(lanes as usize).enumerate() {
                        let x = &registers[of.index()..][..weights.len()];
                        let at = |block: Register| block.index() + lane * LANES..block.index() + (lane + 1) * LANES;
                        let mut sums = [T::from(0.0); LANES];
                        if let Some(c) = c {
                            sums.copy_from_slice(&registers[at(c)]);
                        }
                        add_columns::<T, SIMD>(&mut sums, weights, x);
                        registers[at(to)].copy_from_slice(&sums);
                    }
                }
                LaneOperation::Dot { weights, of, c, to, lanes } => {
                    let weights = &tape.weights[weights as usize..][..lanes as usize];
                    let x = registers[of.index()..].as_chunks().0;
                    registers[to.index()] = registers[c.index()] + dot::<T, SIMD>(weights, &x[..weights.len()]);
                }
                LaneOperation::Activation { function, of, to, lanes } => {
                    // registers are written after those that they follow from
                    let (before, after) = registers.split_at_mut(to.index());
                    let count = lanes as usize * LANES;
                    let (values, slopes) = after[..2 * count].split_at_mut(count);
                    values.copy_from_slice(&before[of.index()..][..count]);
                    if has_tanh(function) {
                        prepare(function, values, slopes);
                        values.iter_mut().for_each(|value| *value = value.tanh::<SIMD>());
                    }
                    finish(function, values, slopes);
                }
                LaneOperation::Products { a, b, to, lanes } => {
                    let (before, after) = registers.split_at_mut(to.index());
                    let [a, b] = [a, b].map(|block| &before[block.index()..][..lanes as usize * LANES]);
                    after.iter_mut().zip(a.iter().zip(b)).for_each(|(to, (a, b))| *to = *a * *b);
                }
            }
        }
    }
}

#[inline(always)]
fn add_columns<T: Number, const SIMD: u8>(sums: &mut [T; LANES], weights: &[[f64; LANES]], x: &[T]) {
    // few columns one after the other: coefficients of random features are large, and every rounding counts
    if T::DEPTH > 0 || x.len() < 4 {
        for (x, weights) in x.iter().zip(weights) {
            sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum = sum.add_scaled::<SIMD>(*x, *weight));
        }
        return;
    }
    // two sums each, so that an addition need not wait for the one before
    let mut odd = [T::from(0.0); LANES];
    let ((pairs, rest), (weight_pairs, weight_rest)) = (x.as_chunks::<2>(), weights.as_chunks::<2>());
    for (x, w) in pairs.iter().zip(weight_pairs) {
        for lane in 0..LANES {
            sums[lane] = sums[lane].add_scaled::<SIMD>(x[0], w[0][lane]);
            odd[lane] = odd[lane].add_scaled::<SIMD>(x[1], w[1][lane]);
        }
    }
    for (x, w) in rest.iter().zip(weight_rest) {
        for lane in 0..LANES {
            sums[lane] = sums[lane].add_scaled::<SIMD>(*x, w[lane]);
        }
    }
    for lane in 0..LANES {
        sums[lane] = sums[lane] + odd[lane];
    }
}

#[inline(always)]
fn dot<T: Number, const SIMD: u8>(weights: &[[f64; LANES]], x: &[[T; LANES]]) -> T {
    if T::DEPTH > 0 {
        let terms = x.as_flattened().iter().zip(weights.as_flattened());
        return terms.fold(T::from(0.0), |sum, (x, weight)| sum.add_scaled::<SIMD>(*x, *weight));
    }
    let mut sums = [[T::from(0.0); LANES]; 2];
    let ((pairs, rest), (weight_pairs, weight_rest)) = (x.as_chunks::<2>(), weights.as_chunks::<2>());
    for (x, w) in pairs.iter().zip(weight_pairs) {
        for half in 0..2 {
            for lane in 0..LANES {
                sums[half][lane] = sums[half][lane].add_scaled::<SIMD>(x[half][lane], w[half][lane]);
            }
        }
    }
    for (x, w) in rest.iter().zip(weight_rest) {
        for lane in 0..LANES {
            sums[0][lane] = sums[0][lane].add_scaled::<SIMD>(x[lane], w[lane]);
        }
    }
    let [even, odd] = sums;
    let mut lanes: [T; LANES] = std::array::from_fn(|lane| even[lane] + odd[lane]);
    for width in [LANES / 2, LANES / 4, LANES / 8] {
        for lane in 0..width {
            lanes[lane] = lanes[lane] + lanes[lane + width];
        }
    }
    lanes[0]
}

impl TapeBuilder {
    /// A block of constants, and zeros behind them.
    pub(crate) fn constants(&mut self, values: impl Iterator<Item = f64>) -> Register {
        let first = self.known.len();
        for value in values {
            let to = self.reserve(BindingTime::Always(value));
            self.tape.constants.push((to, value));
        }
        while !(self.known.len() - first).is_multiple_of(LANES) {
            self.reserve(BindingTime::Always(0.0));
        }
        Register::input(first)
    }

    /// A block of numbers times factors.
    pub(crate) fn scaled(&mut self, numbers: &[(Register, f64)]) -> Register {
        let factors: Vec<Register> = numbers.iter().map(|(_, factor)| self.constant(*factor)).collect();
        let registers: Vec<Register> = numbers.iter().map(|(number, _)| *number).collect();
        let known = self.follows(&registers);
        let (to, zero) = (self.block(known, numbers.len()), self.zero);
        for (index, (a, b)) in registers.into_iter().zip(factors).enumerate() {
            self.part(known).operations.push(TapeOperation::Product { a, b, c: zero, to: to.plus(index) });
        }
        to
    }

    /// The block `W x + c` of the first `columns` numbers `x` of a block. `c` is zero if it is none.
    pub(crate) fn matrix(
        &mut self,
        [rows, columns]: [usize; 2],
        weight: impl Fn(usize, usize) -> f64,
        of: Register,
        c: Option<Register>,
    ) -> Register {
        let weights = self.tape.weights.len() as u32;
        let lanes = rows.div_ceil(LANES);
        for (lane, column) in (0..lanes).flat_map(|lane| (0..columns).map(move |column| (lane, column))) {
            self.tape.weights.push(std::array::from_fn(|at| {
                let row = lane * LANES + at;
                if row < rows { weight(row, column) } else { 0.0 }
            }));
        }
        let known = self.follows(&[of, c.unwrap_or(of)]);
        let to = self.block(known, rows);
        let (columns, lanes) = (columns as u32, lanes as u32);
        self.push(known, LaneOperation::Matrix { weights, of, columns, c, to, lanes });
        to
    }

    /// `w^T x + c` of a block `x`.
    pub(crate) fn dot(&mut self, w: &[f64], of: Register, c: Register) -> Register {
        let weights = self.tape.weights.len() as u32;
        for chunk in w.chunks(LANES) {
            self.tape.weights.push(std::array::from_fn(|at| chunk.get(at).copied().unwrap_or(0.0)));
        }
        let known = self.follows(&[of, c]);
        let to = self.reserve(known);
        self.push(known, LaneOperation::Dot { weights, of, c, to, lanes: w.len().div_ceil(LANES) as u32 });
        to
    }

    /// The blocks `f(x_i)` and `f'(x_i)` of a block of `count` numbers.
    pub(crate) fn activation(&mut self, function: Activation, of: Register, count: usize) -> [Register; 2] {
        let known = self.follows(&[of]);
        let lanes = count.div_ceil(LANES);
        let to = self.block(known, 2 * lanes * LANES);
        self.push(known, LaneOperation::Activation { function, of, to, lanes: lanes as u32 });
        [to, to.plus(lanes * LANES)]
    }

    /// The block `a_i b_i` of blocks of `count` numbers.
    pub(crate) fn products(&mut self, a: Register, b: Register, count: usize) -> Register {
        let known = self.follows(&[a, b]);
        let to = self.block(known, count);
        self.push(known, LaneOperation::Products { a, b, to, lanes: count.div_ceil(LANES) as u32 });
        to
    }

    fn block(&mut self, known: BindingTime, count: usize) -> Register {
        let first = self.reserve(known);
        (1..count.next_multiple_of(LANES)).for_each(|_| _ = self.reserve(known));
        first
    }

    fn push(&mut self, known: BindingTime, operation: LaneOperation) {
        let part = self.part(known);
        part.lanes.push(operation);
        if let Some(TapeOperation::Lanes { count, .. }) = part.operations.last_mut() {
            *count += 1;
        } else {
            part.operations.push(TapeOperation::Lanes { first: part.lanes.len() as u32 - 1, count: 1 });
        }
    }
}
