//! Models without states: maps, with the inputs' encoding before them and time between them.

use super::{
    Model,
    per_instant::{Instants, Sides},
};
use crate::{
    Encoder, Metadata, Role,
    map::{MapScratch, PreparedMap, Task},
    simd::Simd,
};

/// Maps laid out for fast evaluation.
#[derive(Clone, Debug)]
pub(super) struct Maps {
    outputs: usize,
    /// What makes columns of the inputs, if some are not what they are.
    encoder: Option<Encoder>,
    columns: usize,
    /// One, or one for each instant.
    maps: Vec<PreparedMap>,
    /// The networks' instants, if there are several.
    instants: Option<Instants>,
    pub(super) simd: Simd,
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub(super) struct MapsScratch {
    pub(super) map: MapScratch,
    sides: Option<Sides>,
    columns: Option<Columns>,
}

/// Columns of the network after the inputs' encoding: their values, rates along a curve, and adjoint derivatives.
#[derive(Clone, Debug)]
struct Columns {
    point: Vec<f64>,
    rates: [Vec<f64>; 2],
    gradient: Vec<f64>,
}

impl Maps {
    pub(super) fn new(metadata: &Metadata, model: &Model) -> Self {
        let encoder = Encoder::of(&metadata.inputs);
        let (maps, instants) = match model {
            Model::Response(map) => (vec![PreparedMap::new(map, metadata.precision)], None),
            Model::PerInstant { instants, networks } => {
                let time = metadata.inputs.iter().position(|input| input.role == Role::Time);
                let time = time.expect("a network for each instant has a time column");
                let prepared = |network| PreparedMap::of_network(network, metadata.precision);
                let instants = Instants::new(instants, encoder.first_column(time));
                (networks.iter().map(prepared).collect(), Some(instants))
            }
            Model::Motion(_) | Model::StateSpace(_) | Model::Discrete(_) => (Vec::new(), None),
        };
        Self {
            outputs: metadata.outputs.len(),
            columns: encoder.width(),
            encoder: (!encoder.is_plain()).then_some(encoder),
            maps,
            instants,
            simd: Simd::detect(),
        }
    }

    pub(super) fn scratch(&self) -> MapsScratch {
        let sides = self.instants.is_some().then(|| Sides::new(self.columns - 1, self.outputs));
        let zeros = || vec![0.0; self.columns];
        let columns =
            self.encoder.is_some().then(|| Columns { point: zeros(), rates: [zeros(), zeros()], gradient: zeros() });
        // the layers of all networks have the same sizes
        MapsScratch { map: self.maps[0].scratch(), sides, columns }
    }

    #[inline]
    pub(super) fn perform(&self, inputs: &[f64], task: Task, scratch: &mut MapsScratch) {
        let MapsScratch { map, sides, columns } = scratch;
        match (&self.encoder, columns) {
            (None, None) => self.compute(inputs, task, sides, map),
            (Some(encoder), Some(columns)) => self.encode(encoder, inputs, task, columns, sides, map),
            _ => panic!("the scratch belongs to another evaluator"),
        }
    }

    /// Does a task of the inputs with the columns after their encoding, by the chain rule.
    fn encode(
        &self,
        encoder: &Encoder,
        inputs: &[f64],
        task: Task,
        columns: &mut Columns,
        sides: &mut Option<Sides>,
        map: &mut MapScratch,
    ) {
        let Columns { point, rates: [velocity, change], gradient: by_columns } = columns;
        encoder.encode(inputs, point);
        match task {
            Task::Outputs(outputs) => self.compute(point, Task::Outputs(outputs), sides, map),
            Task::Series { rates, first, second } => {
                encoder.along_curve(point, rates, [velocity, change]);
                let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                self.compute(point, Task::Series { rates, first, second }, sides, map);
            }
            Task::Adjoint { weights, gradient } => {
                self.compute(point, Task::Adjoint { weights, gradient: by_columns }, sides, map);
                encoder.gradient(point, by_columns, gradient);
            }
        }
    }

    /// Does a task at the columns of the network.
    #[inline]
    fn compute(&self, columns: &[f64], task: Task, sides: &mut Option<Sides>, map: &mut MapScratch) {
        match (&self.instants, sides) {
            (None, None) => self.dispatch(0, columns, task, map),
            (Some(instants), Some(sides)) => self.interpolate(instants, columns, task, sides, map),
            _ => panic!("the scratch belongs to another evaluator"),
        }
    }

    /// Does a task with the networks of the two instants around the moment, and takes what lies between.
    fn interpolate(&self, instants: &Instants, inputs: &[f64], task: Task, sides: &mut Sides, map: &mut MapScratch) {
        let Sides { point, rates: point_rates, values, first: once, second: twice, gradient: gradients } = sides;
        let interpolation = instants.interpolation(inputs[instants.time()]);
        instants.others(inputs, point);
        if let Task::Outputs(outputs) = task {
            let [_, right] = values;
            self.dispatch(interpolation.left, point, Task::Outputs(outputs), map);
            if interpolation.weight != 0.0 {
                self.dispatch(interpolation.left + 1, point, Task::Outputs(right), map);
                outputs.iter_mut().zip(right).for_each(|(left, right)| *left = interpolation.between(*left, *right));
            }
            return;
        }
        for (side, values) in values.iter_mut().enumerate() {
            self.dispatch(interpolation.left + side, point, Task::Outputs(values), map);
        }
        match task {
            Task::Outputs(_) => {}
            Task::Series { rates, first, second } => {
                // of the weight along the curve
                let [rate, acceleration] =
                    rates.map(|rates| rates.get(instants.time()).map_or(0.0, |rate| interpolation.slope * rate));
                for (to, from) in point_rates.iter_mut().zip(rates) {
                    instants.others(from, to);
                }
                for side in [0, 1] {
                    let [velocity, change] = &*point_rates;
                    let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                    let second = second.is_some().then_some(twice[side].as_mut_slice());
                    let task = Task::Series { rates, first: &mut once[side], second };
                    self.dispatch(interpolation.left + side, point, task, map);
                }
                for (output, first) in first.iter_mut().enumerate() {
                    let [left, right] = [0, 1].map(|side| once[side][output]);
                    *first = interpolation.between(left, right) + rate * (values[1][output] - values[0][output]);
                }
                for (output, second) in second.into_iter().flatten().enumerate() {
                    let [left, right] = [0, 1].map(|side| twice[side][output]);
                    *second = interpolation.between(left, right)
                        + 2.0 * rate * (once[1][output] - once[0][output])
                        + acceleration * (values[1][output] - values[0][output]);
                }
            }
            Task::Adjoint { weights, gradient } => {
                for (side, gradient) in gradients.iter_mut().enumerate() {
                    self.dispatch(interpolation.left + side, point, Task::Adjoint { weights, gradient }, map);
                }
                let changes = values[1].iter().zip(&values[0]).map(|(right, left)| right - left);
                let by_time =
                    interpolation.slope * weights.iter().zip(changes).map(|(weight, by)| weight * by).sum::<f64>();
                let mut others =
                    gradients[0].iter().zip(&gradients[1]).map(|(left, right)| interpolation.between(*left, *right));
                for (column, gradient) in gradient.iter_mut().enumerate() {
                    *gradient = if column == instants.time() { by_time } else { others.next().unwrap_or(0.0) };
                }
            }
        }
    }

    /// Does a task with map `index`.
    #[inline]
    fn dispatch(&self, index: usize, columns: &[f64], task: Task, map: &mut MapScratch) {
        self.maps[index].perform(self.simd, columns, task, map);
    }
}
