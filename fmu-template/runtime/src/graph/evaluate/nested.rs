//! Steps with separate working memory: calls of graphs, equations. Operands and results are in double precision.

use super::{
    GraphScratch, PreparedGraph, Series, Step,
    interpolate::{PreparedInstants, Sides},
};
use crate::{
    Jet, Precision,
    equations::{
        law::{Law, PreparedLaw},
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
    function: Function,
}

#[derive(Clone, Debug)]
enum Function {
    Call(PreparedGraph, Simd),
    Interpolate(PreparedInstants),
    Dictionary(Box<PreparedLaw>),
    Motion(Box<PreparedMotion>),
}

/// Working memory of a step.
#[derive(Clone, Debug)]
pub(super) struct NestedScratch {
    point: Vec<f64>,
    rates: [Vec<f64>; 2],
    gradient: Vec<f64>,
    results: Vec<f64>,
    derivatives: [Vec<f64>; 2],
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
    /// Functions of other graphs compute in this precision. None if the step is of another kind.
    pub(super) fn new(step: &Step, precision: Precision) -> Option<Self> {
        let (of, function) = match step {
            Step::Call { of, function } => {
                (of, Function::Call(PreparedGraph::new(function, precision), Simd::detect()))
            }
            Step::Interpolate { of, column, instants, functions } => {
                (of, Function::Interpolate(PreparedInstants::new(instants, *column, functions, precision)))
            }
            Step::Dictionary { of, dictionary } => {
                (of, Function::Dictionary(Box::new(Law::from(dictionary.clone()).prepared(0, 0..0))))
            }
            Step::Motion { of, motion } => {
                (of, Function::Motion(Box::new(PreparedMotion::new(motion.as_ref().clone()))))
            }
            _ => return None,
        };
        Some(Self { of: *of, function })
    }

    /// The equations of motion, if it is them.
    pub(super) fn motion(&self) -> Option<&PreparedMotion> {
        if let Function::Motion(motion) = &self.function { Some(motion) } else { None }
    }

    pub(super) fn scratch(&self, columns: usize, outputs: usize) -> NestedScratch {
        let [point, result] = [columns, outputs].map(|length| vec![0.0; length]);
        NestedScratch {
            rates: [point.clone(), point.clone()],
            gradient: point.clone(),
            point,
            derivatives: [result.clone(), result.clone()],
            results: result,
            work: match &self.function {
                Function::Call(program, _) => Work::Call(Box::new(program.scratch())),
                Function::Interpolate(instants) => Work::Interpolate(Box::new(instants.sides(columns, outputs))),
                Function::Dictionary(law) => Work::Dictionary(Box::new(DictionaryWork {
                    plain: law.work(),
                    series: law.work(),
                    columns: vec![Jet::from(0.0); columns],
                    results: vec![Jet::from(0.0); outputs],
                })),
                Function::Motion(motion) => Work::Motion(Box::new(motion.scratch())),
            },
        }
    }

    /// Value of the step, if `needs_value`, and its first `orders` derivatives.
    #[inline(never)]
    pub(super) fn forward<T: Real, const WIDTH: usize>(
        &self,
        from: &Series<T, WIDTH>,
        to: &mut Series<T, WIDTH>,
        (orders, needs_value): (usize, bool),
        scratch: &mut NestedScratch,
    ) {
        let NestedScratch { point, rates, results, derivatives, work, .. } = scratch;
        copy(&from.value, point);
        if needs_value || orders == 0 {
            self.perform(point, Task::Outputs(results), work);
            narrow(results, &mut to.value);
        }
        if orders > 0 {
            let ([along, bend], [first, second]) = (rates, derivatives);
            copy(&from.first, along);
            copy(&from.second, bend);
            let is_curve = orders > 1;
            let rates: [&[f64]; 2] = if is_curve { [along, bend] } else { [along, &[]] };
            let of_second = is_curve.then_some(second.as_mut_slice());
            self.perform(point, Task::Series { rates, first, second: of_second }, work);
            narrow(first, &mut to.first);
            if is_curve {
                narrow(second, &mut to.second);
            }
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
        let NestedScratch { point, rates: [direction, _], gradient, results, derivatives: [changes, _], work } =
            scratch;
        copy(&from.value, point);
        copy(change, results);
        if matches!(self.function, Function::Call(..) | Function::Interpolate(_)) {
            self.perform(point, Task::Adjoint { weights: results, gradient }, work);
        } else {
            // by directions: equations have few columns
            for (column, to) in gradient.iter_mut().enumerate() {
                direction.fill(0.0);
                direction[column] = 1.0;
                self.perform(point, Task::Series { rates: [direction, &[]], first: changes, second: None }, work);
                *to = results.iter().zip(&*changes).map(|(weight, change)| weight * change).sum();
            }
        }
        let sums = flat_mut(&mut from.second).iter_mut();
        sums.zip(&*gradient).for_each(|(sum, more)| *sum = *sum + T::narrow(*more));
    }

    fn perform(&self, point: &[f64], task: Task, work: &mut Work) {
        match (&self.function, work) {
            (Function::Call(program, simd), Work::Call(scratch)) => program.perform(*simd, point, task, scratch),
            (Function::Interpolate(instants), Work::Interpolate(sides)) => instants.perform(point, task, sides),
            (Function::Dictionary(law), Work::Dictionary(work)) => dictionary(law, point, task, work),
            (Function::Motion(motion), Work::Motion(scratch)) => motion.perform(point, task, scratch),
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
        if let (Function::Motion(motion), Work::Motion(scratch)) = (&self.function, &mut scratch.work) {
            motion.rates(point, left_out, to, scratch);
        }
    }
}

fn dictionary(law: &PreparedLaw, point: &[f64], task: Task, work: &mut DictionaryWork) {
    let DictionaryWork { plain, series, columns, results } = work;
    match task {
        Task::Outputs(outputs) => law.compute(point, outputs, &mut [], plain),
        Task::Series { rates, first, second } => {
            for (index, column) in columns.iter_mut().enumerate() {
                let [first, second] = rates.map(|rates| rates.get(index).copied().unwrap_or(0.0));
                *column = Jet { value: point[index], first, second };
            }
            law.compute(columns, results, &mut [], series);
            first.iter_mut().zip(&*results).for_each(|(to, from)| *to = from.first);
            second.into_iter().flatten().zip(&*results).for_each(|(to, from)| *to = from.second);
        }
        Task::Adjoint { .. } => {}
    }
}

fn copy<T: Real, const WIDTH: usize>(from: &[Lanes<T, WIDTH>], to: &mut [f64]) {
    to.iter_mut().zip(flat(from)).for_each(|(to, from)| *to = (*from).into());
}

fn narrow<T: Real, const WIDTH: usize>(from: &[f64], to: &mut [Lanes<T, WIDTH>]) {
    flat_mut(to).iter_mut().zip(from).for_each(|(to, from)| *to = T::narrow(*from));
}
