//! Steps with separate working memory: calls of graphs, equations. A graph with such steps is in double precision.

use super::{
    GraphScratch, PreparedGraph, Series, Step,
    interpolate::{PreparedInstants, Sides},
};
use crate::{
    Jet, Precision,
    equations::{
        function_set::{FunctionSet, PreparedFunctions},
        motion::{MotionScratch, PreparedMotion},
        tape::TapeWork,
    },
    simd::{Lanes, Real, Simd, flat, flat_mut},
    task::Task,
};
use std::ops::Range;

/// A step laid out for evaluation.
#[derive(Clone, Debug)]
pub(super) struct NestedStep {
    pub(super) of: usize,
    columns: usize,
    outputs: usize,
    function: PreparedFunction,
}

#[derive(Clone, Debug)]
enum PreparedFunction {
    Call(PreparedGraph, Simd),
    Interpolate(PreparedInstants),
    Dictionary(Box<PreparedFunctions>),
    Motion(Box<PreparedMotion>),
}

/// Working memory of a step.
#[derive(Clone, Debug)]
pub(super) struct NestedScratch {
    direction: Vec<f64>,
    derivative: Vec<f64>,
    gradient: Vec<f64>,
    work: Work,
}

#[derive(Clone, Debug)]
enum Work {
    Call(Box<GraphScratch>),
    Interpolate(Box<Sides>),
    Dictionary(Box<DictionaryWork>),
    Motion(Box<MotionScratch>),
}

#[derive(Clone, Debug)]
struct DictionaryWork {
    plain: TapeWork<f64>,
    series: TapeWork<Jet>,
    columns: Vec<Jet>,
    results: Vec<Jet>,
}

impl NestedStep {
    /// The step that makes value `to` of values with these `widths`. Functions of other graphs compute in this precision. None if the
    /// step is of another kind.
    pub(super) fn new(step: &Step, (widths, to): (&[usize], usize), precision: Precision) -> Option<Self> {
        let (of, function) = match step {
            Step::Call { of, function } => {
                (of, PreparedFunction::Call(PreparedGraph::new(function, precision), Simd::detect()))
            }
            Step::Interpolate { of, column, instants, functions } => {
                (of, PreparedFunction::Interpolate(PreparedInstants::new(instants, *column, functions, precision)))
            }
            Step::Dictionary { of, dictionary } => {
                (of, PreparedFunction::Dictionary(Box::new(FunctionSet::from(dictionary.clone()).prepared(0, 0..0))))
            }
            Step::Motion { of, motion } => {
                (of, PreparedFunction::Motion(Box::new(PreparedMotion::new(motion.as_ref().clone()))))
            }
            _ => return None,
        };
        Some(Self { of: *of, columns: widths[*of], outputs: widths[to], function })
    }

    /// The equations of motion, if it is them.
    pub(super) fn motion(&self) -> Option<&PreparedMotion> {
        if let PreparedFunction::Motion(motion) = &self.function { Some(motion) } else { None }
    }

    pub(super) fn scratch(&self) -> NestedScratch {
        let Self { columns, outputs, .. } = *self;
        NestedScratch {
            direction: vec![0.0; columns],
            derivative: vec![0.0; outputs],
            gradient: vec![0.0; columns],
            work: match &self.function {
                PreparedFunction::Call(program, _) => Work::Call(Box::new(program.scratch())),
                PreparedFunction::Interpolate(instants) => {
                    Work::Interpolate(Box::new(instants.sides(columns, outputs)))
                }
                PreparedFunction::Dictionary(function_set) => Work::Dictionary(Box::new(DictionaryWork {
                    plain: function_set.work(),
                    series: function_set.work(),
                    columns: vec![Jet::from(0.0); columns],
                    results: vec![Jet::from(0.0); outputs],
                })),
                PreparedFunction::Motion(motion) => Work::Motion(Box::new(motion.scratch())),
            },
        }
    }

    /// Value of the step, if `needs_value`, and its first `orders` derivatives.
    pub(super) fn forward<T: Real, const WIDTH: usize>(
        &self,
        from: &Series<T, WIDTH>,
        to: &mut Series<T, WIDTH>,
        (orders, needs_value): (usize, bool),
        scratch: &mut NestedScratch,
    ) {
        let [point, along, bend] = [&from.value, &from.first, &from.second].map(|of| &doubles(of)[..self.columns]);
        let Series { value, first, second } = to;
        let [results, first, second] = [value, first, second].map(|to| &mut doubles_mut(to)[..self.outputs]);
        let work = &mut scratch.work;
        if needs_value || orders == 0 {
            self.perform(point, Task::Outputs(results), work);
        }
        match orders {
            0 => {}
            1 => self.perform(point, Task::Series { rates: [along, &[]], first, second: None }, work),
            _ => self.perform(point, Task::Series { rates: [along, bend], first, second: Some(second) }, work),
        }
    }

    /// Adds the cotangent of the operand, `from`, for the cotangent `change` of the step.
    #[inline(never)]
    pub(super) fn backward<T: Real, const WIDTH: usize>(
        &self,
        from: &mut Series<T, WIDTH>,
        change: &[Lanes<T, WIDTH>],
        scratch: &mut NestedScratch,
    ) {
        let NestedScratch { direction, derivative, gradient, work } = scratch;
        let point = &doubles(&from.value)[..self.columns];
        let weights = &doubles(change)[..self.outputs];
        if matches!(self.function, PreparedFunction::Call(..) | PreparedFunction::Interpolate(_)) {
            self.perform(point, Task::Adjoint { weights, gradient }, work);
        } else {
            // by directions: equations have few columns
            for (column, to) in gradient.iter_mut().enumerate() {
                direction.fill(0.0);
                direction[column] = 1.0;
                let task = Task::Series { rates: [direction, &[]], first: derivative, second: None };
                self.perform(point, task, work);
                // with an infinite change, a weight of zero would make NaN
                let products = weights.iter().zip(&*derivative).map(|(w, dy)| if *w == 0.0 { 0.0 } else { w * dy });
                *to = products.sum();
            }
        }
        doubles_mut(&mut from.second).iter_mut().zip(&*gradient).for_each(|(sum, more)| *sum += more);
    }

    fn perform(&self, point: &[f64], task: Task, work: &mut Work) {
        match (&self.function, work) {
            (PreparedFunction::Call(program, simd), Work::Call(scratch)) => {
                program.perform(*simd, point, task, scratch)
            }
            (PreparedFunction::Interpolate(instants), Work::Interpolate(sides)) => instants.perform(point, task, sides),
            (PreparedFunction::Dictionary(function_set), Work::Dictionary(work)) => {
                dictionary(function_set, point, task, work)
            }
            (PreparedFunction::Motion(motion), Work::Motion(scratch)) => motion.perform(point, task, scratch),
            _ => panic!("the scratch belongs to another graph"),
        }
    }

    /// Outputs or derivatives of a graph that consists of this step.
    pub(super) fn perform_alone(&self, point: &[f64], task: Task, scratch: &mut NestedScratch) {
        self.perform(point, task, &mut scratch.work);
    }

    /// State derivatives of equations of motion, see [`PreparedMotion::rates`].
    pub(super) fn rates(
        &self,
        point: &[f64],
        left_out: Range<usize>,
        to: (&mut [f64], &mut [f64]),
        scratch: &mut NestedScratch,
    ) {
        if let (PreparedFunction::Motion(motion), Work::Motion(scratch)) = (&self.function, &mut scratch.work) {
            motion.rates(point, left_out, to, scratch);
        }
    }
}

fn dictionary(function_set: &PreparedFunctions, point: &[f64], task: Task, work: &mut DictionaryWork) {
    let DictionaryWork { plain, series, columns, results } = work;
    match task {
        Task::Outputs(outputs) => function_set.compute(point, outputs, &mut [], plain),
        Task::Series { rates, first, second } => {
            for (index, column) in columns.iter_mut().enumerate() {
                let [first, second] = rates.map(|rates| rates.get(index).copied().unwrap_or(0.0));
                *column = Jet { value: point[index], first, second };
            }
            function_set.compute(columns, results, &mut [], series);
            first.iter_mut().zip(&*results).for_each(|(to, from)| *to = from.first);
            second.into_iter().flatten().zip(&*results).for_each(|(to, from)| *to = from.second);
        }
        Task::Adjoint { .. } => {}
    }
}

fn doubles<T: Real, const WIDTH: usize>(of: &[Lanes<T, WIDTH>]) -> &[f64] {
    T::doubles(flat(of)).expect("a graph with such steps is in double precision")
}

fn doubles_mut<T: Real, const WIDTH: usize>(of: &mut [Lanes<T, WIDTH>]) -> &mut [f64] {
    T::doubles_mut(flat_mut(of)).expect("a graph with such steps is in double precision")
}
