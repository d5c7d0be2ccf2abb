//! Equations as a list of multiplications, additions and functions. What is zero everywhere is no part of it, what occurs twice is computed
//! once, and what follows from fixed inputs alone is computed when they have changed.

mod lanes;
pub mod listing;

use super::{
    bends::{Bends, BentArgument},
    lookup::LookupTable,
    places::PlaceTable,
};
use crate::{
    numbers::{combination::Combination, elementary::ElementaryFunction, jet::Number},
    simd::{Compute, Simd},
};
use lanes::LaneOperation;
use std::{ops::Range, sync::Arc};

/// Place of a number in the working memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Register(u32);

impl Register {
    /// Register of an input.
    pub(crate) fn input(index: usize) -> Self {
        // no model has so many columns
        Self(index as u32)
    }

    fn index(self) -> usize {
        self.0 as usize
    }

    /// Register `count` places later.
    pub(crate) fn plus(self, count: usize) -> Self {
        Self::input(self.index() + count)
    }
}

/// The list. Made by a [`TapeBuilder`].
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tape {
    fixed: Range<usize>,
    registers: usize,
    constants: Vec<(Register, f64)>,
    tables: Vec<Arc<LookupTable>>,
    /// Arguments with bends that a run computes.
    arguments: Vec<Argument>,
    /// Weights of layers.
    weights: Vec<[f64; LANES]>,
    of_fixed: Part,
    of_others: Part,
    /// Operations of results that are rarely needed, without angles and layers.
    rest: Part,
}

/// Argument of a table or a formula.
#[derive(Clone, Debug, PartialEq)]
struct Argument {
    with: BentArgument,
    of: Register,
}

/// Sines and cosines, and after them all else.
#[derive(Clone, Debug, Default, PartialEq)]
struct Part {
    angles: Vec<Angle>,
    operations: Vec<TapeOperation>,
    lanes: Vec<LaneOperation>,
}

/// Cosines of 1, 2, ... times an angle, and after them as many sines.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Angle {
    of: Register,
    first: Register,
    count: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum TapeOperation {
    /// `to = a b + c`
    Product { a: Register, b: Register, c: Register, to: Register },
    /// `to = sum over i of a_i b_i + c`, with numbers that stand one after the other.
    Products { a: Register, b: Register, count: u32, c: Register, to: Register },
    /// `to = 1 / of`, NaN where `of` is not positive.
    Reciprocal { of: Register, to: Register },
    /// `to = f(of)`
    Call { function: ElementaryFunction, of: Register, to: Register },
    /// `to = f(a, b)`
    Combine { combination: Combination, a: Register, b: Register, to: Register },
    /// A table, by its position, at one or two numbers.
    Lookup { table: u32, at: [Register; 2], to: Register },
    /// Some operations of layers one after the other.
    Lanes { first: u32, count: u32 },
}

/// Working memory of a [`Tape`].
#[derive(Clone, Debug)]
pub(crate) struct TapeWork<T> {
    registers: Vec<T>,
    /// Fixed inputs of the last run, if `is_known`.
    at: Vec<T>,
    is_known: bool,
}

impl<T: Number> TapeWork<T> {
    /// The inputs, and behind them all else.
    pub(crate) fn inputs(&self) -> &[T] {
        &self.registers
    }

    /// The inputs, to be filled in.
    pub(crate) fn inputs_mut(&mut self) -> &mut [T] {
        &mut self.registers
    }

    /// Sets the first inputs. Returns false if all registers are those of these inputs already.
    pub(crate) fn set_inputs(&mut self, inputs: impl Iterator<Item = T>) -> bool {
        let mut changes = !self.is_known;
        for (to, from) in self.registers.iter_mut().zip(inputs) {
            changes |= *to != from;
            *to = from;
        }
        changes
    }

    pub(crate) fn get(&self, register: Register) -> T {
        self.registers[register.index()]
    }
}

impl Tape {
    #[inline(never)]
    pub(crate) fn work<T: Number>(&self) -> TapeWork<T> {
        let mut registers = vec![T::from(0.0); self.registers];
        for (register, value) in &self.constants {
            registers[register.index()] = T::from(*value);
        }
        TapeWork { registers, at: vec![T::from(0.0); self.fixed.len()], is_known: false }
    }

    /// The arguments with bends that change with inputs that are not fixed.
    pub(crate) fn arguments(&self) -> Vec<BentArgument> {
        self.arguments.iter().map(|argument| argument.with.clone()).collect()
    }

    /// Writes these arguments as they were in the last run.
    pub(crate) fn write_arguments(&self, work: &TapeWork<f64>, to: &mut [f64]) {
        to.iter_mut().zip(&self.arguments).for_each(|(to, argument)| *to = work.get(argument.of));
    }

    /// Computes the registers from the inputs, but not those of the rest. Does not allocate.
    pub(crate) fn run<T: Number>(&self, work: &mut TapeWork<T>) {
        let TapeWork { registers, at, is_known } = work;
        let fixed = &registers[self.fixed.clone()];
        if !(*is_known && at == fixed) {
            at.copy_from_slice(fixed);
            *is_known = true;
            self.run_part(&self.of_fixed, registers);
        }
        self.run_part(&self.of_others, registers);
    }

    /// Computes the rest after a [`run`](Self::run).
    pub(crate) fn run_rest<T: Number>(&self, work: &mut TapeWork<T>) {
        self.run_part(&self.rest, &mut work.registers);
    }

    fn run_part<T: Number>(&self, part: &Part, registers: &mut [T]) {
        // series are compiled once, and FMUs stay small
        let simd = if T::DEPTH < 1 { Simd::detect().narrow() } else { Simd::Portable };
        simd.run(RunPart { tape: self, part, registers });
    }
}

struct RunPart<'a, T> {
    tape: &'a Tape,
    part: &'a Part,
    registers: &'a mut [T],
}

impl<T: Number> Compute for RunPart<'_, T> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        let Self { tape, part, registers } = self;
        for &Angle { of, first, count } in &part.angles {
            let angle = registers[of.index()];
            let block = &mut registers[first.index()..][..2 * count as usize];
            let (cosines, sines) = block.split_at_mut(count as usize);
            harmonics(angle, cosines, sines);
        }
        let mut operations = part.operations.as_slice();
        while let [operation, after @ ..] = operations {
            operations = after;
            match *operation {
                TapeOperation::Product { a, b, c, to } => {
                    let (mut sum, mut last) = (registers[c.index()], to);
                    sum = sum.add_product::<SIMD>(registers[a.index()], registers[b.index()]);
                    registers[to.index()] = sum;
                    // consecutive products: a sum that continues need not wait until it is stored
                    while let [TapeOperation::Product { a, b, c, to }, after @ ..] = operations {
                        operations = after;
                        let before = if *c == last { sum } else { registers[c.index()] };
                        (sum, last) = (before.add_product::<SIMD>(registers[a.index()], registers[b.index()]), *to);
                        registers[to.index()] = sum;
                    }
                }
                TapeOperation::Products { a, b, count, c, to } => {
                    let [a, b] = [a, b].map(|register| &registers[register.index()..][..count as usize]);
                    registers[to.index()] = add_products::<T, SIMD>(registers[c.index()], a, b);
                }
                TapeOperation::Reciprocal { of, to } => {
                    let value = registers[of.index()];
                    let value = if value.value() > 0.0 { value } else { T::from(f64::NAN) };
                    registers[to.index()] = value.recip();
                }
                TapeOperation::Call { .. } | TapeOperation::Combine { .. } | TapeOperation::Lookup { .. } => {
                    operation.run_rare(registers, &tape.tables);
                }
                TapeOperation::Lanes { first, count } => {
                    tape.run_lanes(&part.lanes[first as usize..][..count as usize], registers);
                }
            }
        }
    }
}

impl TapeOperation {
    /// Result, and the first ones and numbers of the registers that it follows from. None of layers.
    fn registers(&self) -> Option<(Register, [(Register, u32); 3])> {
        Some(match *self {
            Self::Product { a, b, c, to } => (to, [(a, 1), (b, 1), (c, 1)]),
            Self::Products { a, b, count, c, to } => (to, [(a, count), (b, count), (c, 1)]),
            Self::Reciprocal { of, to } | Self::Call { of, to, .. } => (to, [(of, 1); 3]),
            Self::Combine { a, b, to, .. } | Self::Lookup { at: [a, b], to, .. } => (to, [(a, 1), (b, 1), (b, 1)]),
            Self::Lanes { .. } => return None,
        })
    }

    /// Runs an operation of a formula: kept out of the loop over the common operations.
    #[inline(never)]
    fn run_rare<T: Number>(&self, registers: &mut [T], tables: &[Arc<LookupTable>]) {
        let (value, to) = match *self {
            Self::Call { function, of, to } => (registers[of.index()].apply(function), to),
            Self::Combine { combination, a, b, to } => {
                (combination.on_tape(registers[a.index()], registers[b.index()]), to)
            }
            Self::Lookup { table, at, to } => {
                (tables[table as usize].at(&at.map(|register| registers[register.index()])), to)
            }
            Self::Product { .. } | Self::Products { .. } | Self::Reciprocal { .. } | Self::Lanes { .. } => return,
        };
        registers[to.index()] = value;
    }
}

/// By doubling, so that few wait for one another, and few rounding errors add up.
#[inline(always)]
fn harmonics<T: Number>(angle: T, cosines: &mut [T], sines: &mut [T]) {
    (sines[0], cosines[0]) = angle.sin_cos();
    let mut known = 1;
    while known < cosines.len() {
        let count = known.min(cosines.len() - known);
        let ((c, next_c), (s, next_s)) = (cosines.split_at_mut(known), sines.split_at_mut(known));
        let (last_c, last_s) = (c[known - 1], s[known - 1]);
        for k in 0..count {
            next_c[k] = c[k] * last_c - s[k] * last_s;
            next_s[k] = s[k] * last_c + c[k] * last_s;
        }
        known += count;
    }
}

/// Numbers that are added up at once.
const LANES: usize = 8;

#[inline(always)]
fn add_products<T: Number, const SIMD: u8>(mut sum: T, a: &[T], b: &[T]) -> T {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a_rest.iter().zip(b_rest) {
        sum = sum.add_product::<SIMD>(*a, *b);
    }
    let mut sums = [T::from(0.0); LANES];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] = sums[lane].add_product::<SIMD>(a[lane], b[lane]);
        }
    }
    let [a, b, c, d, e, f, g, h] = sums;
    sum + (((a + e) + (b + f)) + ((c + g) + (d + h)))
}

/// Term of a sum. Its weight is `constant + fixed`, and `fixed` depends on fixed inputs at most.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SumTerm {
    pub(crate) of: Register,
    pub(crate) constant: f64,
    pub(crate) fixed: Register,
}

/// Orders operations by the time that is needed after their beginning, longest first: an operation then rarely waits for the one before.
fn critical_first(operations: &mut [TapeOperation], registers: usize) {
    let mut remaining = vec![0u32; registers];
    for operation in operations.iter().rev() {
        let Some((to, from)) = operation.registers() else { continue };
        // in products of two numbers; divisions, functions and long sums take about as long as three of them
        let own = if matches!(operation, TapeOperation::Product { .. }) { 1 } else { 3 };
        remaining[to.index()] += own;
        let whole = remaining[to.index()];
        for (first, count) in from {
            remaining[first.index()..][..count as usize].iter_mut().for_each(|time| *time = whole.max(*time));
        }
    }
    let time = |operation: &TapeOperation| operation.registers().map_or(0, |(to, _)| remaining[to.index()]) as usize;
    // by counting: a sort of the standard library takes 12 kB of machine code
    let mut ends = vec![0; operations.iter().map(time).max().unwrap_or(0) + 1];
    operations.iter().for_each(|operation| ends[time(operation)] += 1);
    ends.iter_mut().rev().fold(0, |sum, end| {
        *end += sum;
        *end
    });
    for operation in operations.to_vec().iter().rev() {
        let end = &mut ends[time(operation)];
        *end -= 1;
        operations[*end] = *operation;
    }
}

/// When a number is known.
#[derive(Clone, Copy, Debug, PartialEq)]
enum BindingTime {
    Always(f64),
    /// With the fixed inputs.
    Fixed,
    WithInputs,
}

/// Room for registers that most equations do with.
const WRITTEN: usize = 256;
/// Shortest sum that is not computed term by term.
const LONG: usize = 8;
/// Zeros with which two runs of numbers become one.
const LARGEST_GAP: u32 = 3;

/// Writes a [`Tape`].
#[derive(Debug)]
pub(crate) struct TapeBuilder {
    pub(crate) zero: Register,
    pub(crate) one: Register,
    known: Vec<BindingTime>,
    /// Registers of constants, products and calls; a constant and a call have no register where a product has its summand.
    written: PlaceTable,
    tape: Tape,
}

impl TapeBuilder {
    /// A tape of `inputs` inputs, some of them fixed.
    pub(crate) fn new(inputs: usize, fixed: Range<usize>) -> Self {
        let mut builder = Self {
            zero: Register(0),
            one: Register(0),
            known: Vec::with_capacity(inputs + WRITTEN),
            written: PlaceTable::with_capacity_and_hasher(WRITTEN, Default::default()),
            tape: Tape { fixed: fixed.clone(), ..Tape::default() },
        };
        builder.known.extend((0..inputs).map(|input| match fixed.contains(&input) {
            true => BindingTime::Fixed,
            false => BindingTime::WithInputs,
        }));
        builder.tape.constants.reserve(WRITTEN);
        builder.zero = builder.constant(0.0);
        builder.one = builder.constant(1.0);
        builder
    }

    pub(crate) fn finish(mut self) -> Tape {
        let registers = self.known.len();
        for part in [&mut self.tape.of_others, &mut self.tape.rest] {
            let without_layers = part.operations.split_mut(|operation| operation.registers().is_none());
            without_layers.for_each(|operations| critical_first(operations, registers));
        }
        Tape { registers, ..self.tape }
    }

    /// The tape whose [`run`](Tape::run) computes these registers. Operations that none of them follows from are the rest.
    pub(crate) fn finish_for(mut self, wanted: &[Register]) -> Tape {
        let mut is_needed = vec![false; self.known.len()];
        let arguments = self.tape.arguments.iter().map(|argument| &argument.of);
        wanted.iter().chain(arguments).for_each(|register| is_needed[register.index()] = true);
        let (mut needed, mut rest, mut is_layer) = (Vec::new(), Vec::new(), false);
        for operation in self.tape.of_others.operations.drain(..).rev() {
            let registers = operation.registers();
            // layers, and what comes before them, are computed in any case
            is_layer |= registers.is_none();
            match registers {
                Some((to, _)) if !is_layer && !is_needed[to.index()] => rest.push(operation),
                _ => {
                    for (first, count) in registers.into_iter().flat_map(|(_, from)| from) {
                        is_needed[first.index()..][..count as usize].fill(true);
                    }
                    needed.push(operation);
                }
            }
        }
        needed.reverse();
        rest.reverse();
        self.tape.of_others.operations = needed;
        self.tape.rest.operations = rest;
        self.finish()
    }

    fn reserve(&mut self, known: BindingTime) -> Register {
        self.known.push(known);
        Register::input(self.known.len() - 1)
    }

    fn part(&mut self, known: BindingTime) -> &mut Part {
        match known {
            BindingTime::Fixed => &mut self.tape.of_fixed,
            BindingTime::Always(_) | BindingTime::WithInputs => &mut self.tape.of_others,
        }
    }

    /// When what follows from some numbers is known.
    fn follows(&self, from: &[Register]) -> BindingTime {
        match from.iter().any(|register| self.varies(*register)) {
            true => BindingTime::WithInputs,
            false => BindingTime::Fixed,
        }
    }

    /// The value of a constant.
    pub(crate) fn value(&self, register: Register) -> Option<f64> {
        match self.known[register.index()] {
            BindingTime::Always(value) => Some(value),
            BindingTime::Fixed | BindingTime::WithInputs => None,
        }
    }

    /// Returns true if a number changes with inputs that are not fixed.
    pub(crate) fn varies(&self, register: Register) -> bool {
        self.known[register.index()] == BindingTime::WithInputs
    }

    pub(crate) fn is_zero(&self, register: Register) -> bool {
        self.value(register) == Some(0.0)
    }

    #[inline(never)]
    pub(crate) fn constant(&mut self, value: f64) -> Register {
        let bits = value.to_bits();
        let key = [bits as u32, (bits >> 32) as u32, u32::MAX];
        if let Some(&known) = self.written.get(&key) {
            return Register(known);
        }
        let register = self.reserve(BindingTime::Always(value));
        self.written.insert(key, register.0);
        self.tape.constants.push((register, value));
        register
    }

    /// `a b + c`
    #[inline(never)]
    pub(crate) fn add_product(&mut self, c: Register, a: Register, b: Register) -> Register {
        let (a, b) = (a.min(b), a.max(b));
        match [a, b, c].map(|register| self.value(register)) {
            [Some(0.0), _, _] | [_, Some(0.0), _] => return c,
            [Some(1.0), _, Some(0.0)] => return b,
            [_, Some(1.0), Some(0.0)] => return a,
            [Some(a), Some(b), Some(c)] => return self.constant(a * b + c),
            _ => {}
        }
        self.once([a.0, b.0, c.0], &[a, b, c], |to| TapeOperation::Product { a, b, c, to })
    }

    /// The register of what is written already, or else of an operation that is written now.
    #[inline(always)]
    fn once(
        &mut self,
        key: [u32; 3],
        from: &[Register],
        operation: impl FnOnce(Register) -> TapeOperation,
    ) -> Register {
        let (to, is_written) = self.find_or_reserve(key, from);
        if !is_written {
            let known = self.known[to.index()];
            self.part(known).operations.push(operation(to));
        }
        to
    }

    #[inline(never)]
    fn find_or_reserve(&mut self, key: [u32; 3], from: &[Register]) -> (Register, bool) {
        if let Some(&known) = self.written.get(&key) {
            return (Register(known), true);
        }
        let to = self.reserve(self.follows(from));
        self.written.insert(key, to.0);
        (to, false)
    }

    pub(crate) fn product(&mut self, a: Register, b: Register) -> Register {
        self.add_product(self.zero, a, b)
    }

    /// `c + factor a`
    pub(crate) fn add_scaled(&mut self, c: Register, a: Register, factor: f64) -> Register {
        let factor = self.constant(factor);
        self.add_product(c, a, factor)
    }

    /// Sum of numbers times factors.
    pub(crate) fn weighted(&mut self, terms: &[(Register, f64)]) -> Register {
        terms.iter().fold(self.zero, |sum, (of, factor)| self.add_scaled(sum, *of, *factor))
    }

    /// `c - a b`
    pub(crate) fn subtract_product(&mut self, c: Register, a: Register, b: Register) -> Register {
        let minus_a = self.negative(a);
        self.add_product(c, minus_a, b)
    }

    pub(crate) fn negative(&mut self, a: Register) -> Register {
        let minus_one = self.constant(-1.0);
        self.product(a, minus_one)
    }

    /// `1 / a`, NaN where `a` is not positive.
    pub(crate) fn reciprocal(&mut self, of: Register) -> Register {
        let known = self.follows(&[of]);
        let to = self.reserve(known);
        self.part(known).operations.push(TapeOperation::Reciprocal { of, to });
        to
    }

    /// A function of a number.
    #[inline(never)]
    pub(crate) fn call(&mut self, function: ElementaryFunction, of: Register) -> Register {
        if let Some(value) = self.value(of) {
            return self.constant(function.value(value));
        }
        let key = [function as u32, of.0, u32::MAX - 1];
        self.once(key, &[of], |to| TapeOperation::Call { function, of, to })
    }

    /// A function of two numbers.
    pub(crate) fn combine(&mut self, combination: Combination, a: Register, b: Register) -> Register {
        match (combination, [a, b].map(|register| self.value(register))) {
            (_, [Some(a), Some(b)]) => self.constant(combination.of(a, b)),
            (Combination::Add, _) => self.add_product(a, b, self.one),
            (Combination::Subtract, _) => self.subtract_product(a, b, self.one),
            (Combination::Multiply, _) => self.product(a, b),
            (Combination::Divide, [_, Some(b)]) => {
                let inverse = self.constant(b.recip());
                self.product(a, inverse)
            }
            (Combination::Power, [_, Some(0.5)]) => self.call(ElementaryFunction::Sqrt, a),
            (Combination::Power, [_, Some(power)]) if let Some(factors) = Combination::factors(power) => {
                (1..factors).fold(a, |product, _| self.product(product, a))
            }
            (Combination::Maximum, _) => {
                let [a, b] = [a, b].map(|value| self.negative(value));
                let smaller = self.combine(Combination::Minimum, a, b);
                self.negative(smaller)
            }
            _ => {
                // numbers of products are below these
                let key = [a.0, b.0, u32::MAX - 2 - combination as u32];
                self.once(key, &[a, b], |to| TapeOperation::Combine { combination, a, b, to })
            }
        }
    }

    /// Number of a function whose arguments have bends.
    pub(crate) fn new_group(&self) -> u32 {
        self.tape.arguments.last().map_or(0, |argument| argument.with.group + 1)
    }

    /// Makes a number an argument with bends, if there are any and it changes with inputs that are not fixed.
    pub(crate) fn add_bends(&mut self, of: Register, bends: &Arc<Bends>, group: u32) {
        if self.varies(of) && !bends.is_empty() {
            self.tape.arguments.push(Argument { with: BentArgument { bends: Arc::clone(bends), group }, of });
        }
    }

    /// A table at one or two numbers.
    pub(crate) fn lookup(&mut self, table: &Arc<LookupTable>, at: &[Register]) -> Register {
        let values: Option<Vec<f64>> = at.iter().map(|register| self.value(*register)).collect();
        if let Some(values) = values {
            return self.constant(table.at(&values));
        }
        let tables = &mut self.tape.tables;
        let position = tables.iter().position(|known| known == table).unwrap_or_else(|| {
            tables.push(Arc::clone(table));
            tables.len() - 1
        });
        let known = self.follows(at);
        let to = self.reserve(known);
        for (axis, of) in at.iter().enumerate() {
            let group = self.new_group();
            self.add_bends(*of, table.bends(axis), group);
        }
        let at = [at[0], at[at.len() - 1]];
        self.part(known).operations.push(TapeOperation::Lookup { table: position as u32, at, to });
        to
    }

    /// Cosines of 1, 2, ..., `count` times an angle, followed by the sines.
    pub(crate) fn harmonics(&mut self, of: Register, count: usize) -> Vec<Register> {
        let known = self.follows(&[of]);
        if let Some(same) = self.part(known).angles.iter().find(|angle| angle.of == of && angle.count as usize >= count)
        {
            let (cosines, sines) = (same.first.index(), same.first.index() + same.count as usize);
            return (cosines..cosines + count).chain(sines..sines + count).map(Register::input).collect();
        }
        let block: Vec<Register> = (0..2 * count).map(|_| self.reserve(known)).collect();
        if let Some(&first) = block.first() {
            self.part(known).angles.push(Angle { of, first, count: count as u32 });
        }
        block
    }

    /// Sum of some numbers times their weights, in the order of the numbers, and `c`.
    pub(crate) fn sum(&mut self, mut c: Register, terms: &[SumTerm]) -> Register {
        let mut rest = terms;
        while let Some(SumTerm { of: first, .. }) = rest.first() {
            let gaps = rest.windows(2).take_while(|pair| pair[1].of.0 - pair[0].of.0 <= LARGEST_GAP + 1).count();
            let (run, others) = rest.split_at(gaps + 1);
            rest = others;
            if run.len() < LONG {
                for term in run {
                    let weight = self.add_scaled(term.fixed, self.one, term.constant);
                    c = self.add_product(c, term.of, weight);
                }
                continue;
            }
            let weights = self.weights(run);
            let known =
                if run.iter().any(|term| self.varies(term.of)) { BindingTime::WithInputs } else { self.follows(&[c]) };
            let to = self.reserve(known);
            let count = weights.len() as u32;
            self.part(known).operations.push(TapeOperation::Products { a: *first, b: weights[0], count, c, to });
            c = to;
        }
        c
    }

    /// Weights of a run of consecutive numbers, zero in the gaps of the run.
    fn weights(&mut self, run: &[SumTerm]) -> Vec<Register> {
        let (zero, one) = (self.zero, self.one);
        let mut terms = run.iter().peekable();
        let (first, last) = (run[0].of.0, run[run.len() - 1].of.0);
        // registers of weights that depend on fixed inputs, before the block
        let terms = (first..=last).map(|of| terms.next_if(|term| term.of.0 == of).copied());
        let weights = terms.map(|term| match term {
            Some(SumTerm { constant, fixed, .. }) if !self.is_zero(fixed) => Err(self.add_scaled(fixed, one, constant)),
            term => Ok(term.map_or(0.0, |term| term.constant)),
        });
        let weights: Vec<Result<f64, Register>> = weights.collect();
        let of_block = weights.into_iter().map(|weight| match weight {
            Ok(value) => {
                let to = self.reserve(BindingTime::Always(value));
                self.tape.constants.push((to, value));
                to
            }
            Err(weight) => {
                let known = self.known[weight.index()];
                let to = self.reserve(known);
                self.part(known).operations.push(TapeOperation::Product { a: weight, b: one, c: zero, to });
                to
            }
        });
        of_block.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_with_the_longest_time_after_them_are_first() {
        let mut builder = TapeBuilder::new(3, 0..0);
        let [x, y, z] = [0, 1, 2].map(Register::input);
        let alone = builder.product(x, z);
        let first = builder.product(x, y);
        let inverse = builder.reciprocal(first);
        let last = builder.add_product(alone, inverse, y);
        let tape = builder.finish();
        let order: Vec<Register> = tape.of_others.operations.iter().map(|it| it.registers().unwrap().0).collect();
        assert_eq!(order, [first, inverse, alone, last]);
        let mut work = tape.work::<f64>();
        work.set_inputs([0.5, 8.0, 3.0].into_iter());
        tape.run(&mut work);
        assert_eq!(work.get(last), 8.0 / 4.0 + 1.5);
    }
}
