//! Compliant elements: flexible parts between two interfaces, as forces without states that create no energy.
//!
//! ```text
//! F(q, v, p) = dV/dq(q, p) + D(q, p) v      D = L Lᵀ
//! ```
//!
//! `q` are relative positions, `v` their rates, `p` parameters and `F` the forces conjugate to `q`: the power that the element takes is
//! `F · v`. Along any motion its integral is the change of `V` plus the integral of `|Lᵀ v|² >= 0`, whatever the coefficients are. `V` and
//! the entries of the lower triangular matrix `L` are sums of products of Legendre polynomials of `z`, the `p` and `q` relative to the middle
//! and half of their ranges. In units of energy, with `u = v / half` and the forces times `half`, the equation is the same in `z`.

mod basis;
mod fit;
mod graph;
#[cfg(test)]
mod tests;

use crate::{
    dataset::{Dataset, Run},
    study::Study,
    variable::SourceVariable,
};
use basis::ProductBasis;
pub use fit::{ElementFit, FittedDegrees, fit};
use metafmu_runtime::Rows;
use std::collections::HashMap;

/// Rows of a compliant element: forces, and the columns that they follow from.
#[derive(Clone, Debug, Default)]
pub struct ElementRows {
    /// Number of parameters.
    pub parameters: usize,
    /// Number of coordinates.
    pub coordinates: usize,
    /// `true` if the columns include velocities.
    pub has_velocities: bool,
    /// Parameters, positions and, if there are any, velocities of each row.
    pub points: Rows,
    /// Forces of each row.
    pub forces: Rows,
}

/// Variables of the columns of the points, and of the forces.
#[derive(Clone, Debug)]
pub struct ElementColumns {
    /// Parameters, positions, velocities.
    pub inputs: Vec<SourceVariable>,
    /// Forces.
    pub outputs: Vec<SourceVariable>,
}

impl ElementColumns {
    /// Columns that a study names, among those of a data set.
    pub fn of(study: &Study, dataset: &Dataset) -> Self {
        let named = |names: &[String], variables: &[SourceVariable]| -> Vec<SourceVariable> {
            names.iter().filter_map(|name| variables.iter().find(|of| of.name == *name).cloned()).collect()
        };
        let options = &study.compliant;
        let mut inputs = named(&options.parameters, &dataset.parameters);
        inputs.extend(named(&options.positions, &dataset.outputs));
        inputs.extend(named(&options.velocities, &dataset.outputs));
        Self { inputs, outputs: named(&options.forces, &dataset.outputs) }
    }
}

impl ElementRows {
    /// Rows of runs, whose outputs are positions, velocities and forces.
    pub fn of<'a>(study: &Study, dataset: &Dataset, runs: impl IntoIterator<Item = &'a Run>) -> Self {
        let places = |variables: &[SourceVariable]| -> HashMap<String, usize> {
            variables.iter().enumerate().map(|(place, of)| (of.name.clone(), place)).collect()
        };
        let (of_parameters, of_outputs) = (places(&dataset.parameters), places(&dataset.outputs));
        let columns = |names: &[String], places: &HashMap<String, usize>| -> Vec<usize> {
            names.iter().filter_map(|name| places.get(name).copied()).collect()
        };
        let options = &study.compliant;
        let parameters = columns(&options.parameters, &of_parameters);
        let motion = [columns(&options.positions, &of_outputs), columns(&options.velocities, &of_outputs)].concat();
        let forces = columns(&options.forces, &of_outputs);
        let mut rows = Self {
            parameters: parameters.len(),
            coordinates: options.positions.len(),
            has_velocities: !options.velocities.is_empty(),
            ..Self::default()
        };
        for run in runs {
            for (_, outputs) in run.rows() {
                let of_run = parameters.iter().map(|place| run.parameters[*place]);
                let point: Vec<f64> = of_run.chain(motion.iter().map(|place| outputs[*place])).collect();
                rows.points.push(&point);
                rows.forces.push(&forces.iter().map(|place| outputs[*place]).collect::<Vec<_>>());
            }
        }
        rows
    }

    /// Columns of the potential: parameters and positions.
    fn configuration(&self) -> usize {
        self.parameters + self.coordinates
    }
}

/// A fitted compliant element.
#[derive(Clone, Debug)]
pub struct CompliantElement {
    parameters: usize,
    coordinates: usize,
    has_velocities: bool,
    basis: ProductBasis,
    /// Middle and half of the range of each parameter and position.
    middle: Vec<f64>,
    half: Vec<f64>,
    /// Coefficients of the potential, in units of energy: one for each of the first products.
    potential: Vec<f64>,
    /// Coefficients of the entries of `L`, row by row of its lower triangle; shape `[entries, products]`.
    dissipation: Vec<f64>,
}

impl CompliantElement {
    /// Number of coefficients.
    pub fn coefficients(&self) -> usize {
        self.potential.len() + self.dissipation.len()
    }

    /// Number of entries of the lower triangle of `L`; 0 without velocities.
    fn entries(&self) -> usize {
        if self.has_velocities { triangle(self.coordinates).count() } else { 0 }
    }

    /// Number of products of an entry of `L`.
    fn products_of_entry(&self) -> usize {
        self.dissipation.len() / self.entries().max(1)
    }
}

/// Rows and columns of the entries of a lower triangular matrix, row by row.
fn triangle(size: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
    (0..size).flat_map(|row| (0..=row).map(move |column| (row, column)))
}
