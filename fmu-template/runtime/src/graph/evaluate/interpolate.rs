//! Interpolation between networks at time points.

use super::{Graph, GraphScratch, PreparedGraph, Step};
use crate::{
    FormatError, Precision,
    check::{expect_below, expect_finite},
    simd::Simd,
    task::Task,
};
use std::mem::discriminant;

/// Checks time points and networks against the number of columns and the column of the time. Returns the number of outputs.
pub(in crate::graph) fn check(
    name: &str,
    (columns, time): (usize, usize),
    instants: &[f64],
    functions: &[Graph],
) -> Result<usize, FormatError> {
    expect_below(&name, 0, time, columns)?;
    if columns == 1 {
        return Err(FormatError::OnlyTime);
    }
    if instants.len() < 2 {
        return Err(FormatError::FewInstants { count: instants.len() });
    }
    expect_finite(name, instants.iter().copied())?;
    if let Some(index) = instants.windows(2).position(|pair| pair[0] >= pair[1]) {
        let (index, before, found) = (index + 1, instants[index], instants[index + 1]);
        return Err(FormatError::NotAscending { name: name.into(), index, before, found });
    }
    if functions.len() != instants.len() {
        return Err(FormatError::NetworkCount { found: functions.len(), expected: instants.len() });
    }
    let expected = functions[0].widths()?;
    let outputs = expected.last().copied().unwrap_or_default();
    for (instant, function) in functions.iter().enumerate() {
        // they share their working memory
        if instant == 0 || function.inputs != functions[0].inputs || !sizes(function).eq(sizes(&functions[0])) {
            let found = function.shape(columns - 1).map_err(|source| source.of_instant(instant))?;
            if found != expected {
                return Err(FormatError::LayerSizes { instant, found, expected });
            }
            if instant > 0 {
                return Err(FormatError::StepKinds { instant });
            }
        }
        if !function.is_network() {
            return Err(FormatError::NoNetwork { name: "function".into() }.of_instant(instant));
        }
    }
    Ok(outputs)
}

/// Kind of each step, how many numbers it has, and whether they are single.
fn sizes(graph: &Graph) -> impl Iterator<Item = impl PartialEq> {
    graph.steps.iter().map(|step| {
        let numbers = match step {
            Step::Affine { weight, bias, .. } => [weight, bias].map(|of| (of.len(), of.as_single().is_some())),
            Step::Standardize { mean, scale, .. } | Step::Rescale { mean, scale, .. } => {
                [mean, scale].map(|of| (of.len(), false))
            }
            _ => [(0, false); 2],
        };
        (discriminant(step), numbers)
    })
}

/// The networks laid out for evaluation.
#[derive(Clone, Debug)]
pub(super) struct PreparedInstants {
    instants: Vec<f64>,
    time: usize,
    functions: Vec<PreparedGraph>,
    simd: Simd,
}

/// Working memory for the two neighboring time points.
#[derive(Clone, Debug)]
pub(super) struct Sides {
    /// The columns other than the time, and their derivatives.
    point: Vec<f64>,
    rates: [Vec<f64>; 2],
    /// Outputs and their derivatives.
    values: [Vec<f64>; 2],
    first: [Vec<f64>; 2],
    second: [Vec<f64>; 2],
    /// Adjoint derivatives.
    gradient: [Vec<f64>; 2],
    scratch: GraphScratch,
}

/// Interpolation between time point `left` and the next one: `y = (1 - weight) y_left + weight y_right`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Between {
    left: usize,
    weight: f64,
    /// Derivative of the weight with respect to the time.
    slope: f64,
}

impl PreparedInstants {
    pub(super) fn new(instants: &[f64], time: usize, functions: &[Graph], precision: Precision) -> Self {
        let functions = functions.iter().map(|function| PreparedGraph::new(function, precision)).collect();
        Self { instants: instants.to_vec(), time, functions, simd: Simd::detect() }
    }

    /// Working memory for graphs with these numbers of columns and outputs.
    pub(super) fn sides(&self, columns: usize, outputs: usize) -> Sides {
        let point = vec![0.0; columns - 1];
        let points = [point.clone(), point.clone()];
        let results = [vec![0.0; outputs], vec![0.0; outputs]];
        Sides {
            point,
            rates: points.clone(),
            values: results.clone(),
            first: results.clone(),
            second: results,
            gradient: points,
            scratch: self.functions[0].scratch(),
        }
    }

    /// Interpolation at a time. A time point belongs to the interval after it, the last one to the interval before it.
    #[inline]
    fn between(&self, time: f64) -> Between {
        let intervals = self.instants.len() - 1;
        let left = self.instants.partition_point(|&instant| instant <= time).clamp(1, intervals) - 1;
        let (begin, end) = (self.instants[left], self.instants[left + 1]);
        // NaN stays NaN
        let weight = ((time - begin) / (end - begin)).clamp(0.0, 1.0);
        let outside = time < self.instants[0] || time > self.instants[intervals];
        Between { left, weight, slope: if outside { 0.0 } else { 1.0 / (end - begin) } }
    }

    /// The columns other than the time.
    #[inline]
    fn others(&self, columns: &[f64], to: &mut [f64]) {
        let from = columns.iter().enumerate().filter(|&(column, _)| column != self.time);
        to.iter_mut().zip(from).for_each(|(to, (_, &from))| *to = from);
    }

    /// Performs a task with the networks at the two neighboring time points and interpolates. Does not allocate.
    pub(super) fn perform(&self, columns: &[f64], task: Task, sides: &mut Sides) {
        let Sides { point, rates: point_rates, values, first: once, second: twice, gradient: gradients, scratch } =
            sides;
        let between = self.between(columns[self.time]);
        self.others(columns, point);
        let mut perform =
            |side: usize, task: Task| self.functions[between.left + side].perform(self.simd, point, task, scratch);
        if let Task::Outputs(outputs) = task {
            let [_, right] = values;
            perform(0, Task::Outputs(outputs));
            if between.weight != 0.0 {
                perform(1, Task::Outputs(right));
                outputs.iter_mut().zip(right).for_each(|(left, right)| *left = between.of(*left, *right));
            }
            return;
        }
        for (side, values) in values.iter_mut().enumerate() {
            perform(side, Task::Outputs(values));
        }
        match task {
            Task::Outputs(_) => {}
            Task::Series { rates, first, second } => {
                // of the weight along the curve
                let [rate, acceleration] =
                    rates.map(|rates| rates.get(self.time).map_or(0.0, |rate| between.slope * rate));
                for (to, from) in point_rates.iter_mut().zip(rates) {
                    self.others(from, to);
                }
                for side in [0, 1] {
                    let [velocity, change] = &*point_rates;
                    let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                    let second = second.is_some().then_some(twice[side].as_mut_slice());
                    perform(side, Task::Series { rates, first: &mut once[side], second });
                }
                for (output, first) in first.iter_mut().enumerate() {
                    let [left, right] = [0, 1].map(|side| once[side][output]);
                    *first = between.of(left, right) + rate * (values[1][output] - values[0][output]);
                }
                for (output, second) in second.into_iter().flatten().enumerate() {
                    let [left, right] = [0, 1].map(|side| twice[side][output]);
                    *second = between.of(left, right)
                        + 2.0 * rate * (once[1][output] - once[0][output])
                        + acceleration * (values[1][output] - values[0][output]);
                }
            }
            Task::Adjoint { weights, gradient } => {
                for (side, gradient) in gradients.iter_mut().enumerate() {
                    perform(side, Task::Adjoint { weights, gradient });
                }
                let changes = values[1].iter().zip(&values[0]).map(|(right, left)| right - left);
                let by_time = between.slope * weights.iter().zip(changes).map(|(weight, by)| weight * by).sum::<f64>();
                let mut others = gradients[0].iter().zip(&gradients[1]).map(|(left, right)| between.of(*left, *right));
                for (column, gradient) in gradient.iter_mut().enumerate() {
                    *gradient = if column == self.time { by_time } else { others.next().unwrap_or(0.0) };
                }
            }
        }
    }
}

impl Between {
    /// Interpolated value; exact at both time points.
    #[inline]
    fn of(&self, left: f64, right: f64) -> f64 {
        (1.0 - self.weight) * left + self.weight * right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_found_between_its_neighbors_and_outside_at_the_ends() {
        let instants = PreparedInstants::new(&[0.0, 0.5, 0.75, 2.0], 1, &[], Precision::Double);
        for (time, left, weight, slope) in [
            (-1.0, 0, 0.0, 0.0),
            (0.0, 0, 0.0, 2.0),
            (0.25, 0, 0.5, 2.0),
            (0.5, 1, 0.0, 4.0),
            (0.625, 1, 0.5, 4.0),
            (2.0, 2, 1.0, 0.8),
            (2.5, 2, 1.0, 0.0),
        ] {
            assert_eq!(instants.between(time), Between { left, weight, slope }, "{time}");
        }
        assert!(instants.between(f64::NAN).weight.is_nan());
        let mut others = [0.0; 2];
        instants.others(&[1.0, 9.0, 2.0], &mut others);
        assert_eq!(others, [1.0, 2.0]);
    }
}
