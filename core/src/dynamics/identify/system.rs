//! The equations of motion as linear equations for the coefficients of their functions.
//!
//! For a motion `q(t)` and each coordinate `i` the Euler-Lagrange equation is linear in the functions, and homogeneous:
//!
//! ```text
//! d/dt (sum over j of M_ij v_j) - sum over j, k of dM_jk/dq_i v_j v_k / 2 + dV/dq_i - F_i + (D v)_i - (B u)_i = 0
//! ```
//!
//! The weak form is solved: the equation is multiplied by a window `w(t) = (1 - s^2)^8`, `s` from -1 to 1, and
//! integrated by parts, so that no acceleration is needed. The trapezoidal rule is nearly exact for such windows.

use super::super::{terms, trajectory::Trajectory};
use metafmu_runtime::{
    Dynamics, FormatError,
    dictionary::{Dictionary, Factor, Term},
};
use nalgebra::DMatrix;
use std::collections::HashMap;

/// Part of the equations that a function belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EquationPart {
    /// `M_ij`, the row at least as large as the column.
    Mass(usize, usize),
    Potential,
    Force(usize),
    Damping(usize, usize),
    Input(usize, usize),
}

/// The products that the functions may have.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    factors: Vec<Factor>,
    coordinates: usize,
    inputs: usize,
    /// Exponents of all products, with the derivatives of each.
    exponents: Vec<Vec<i16>>,
    /// Function and product of each coefficient.
    pub(super) unknowns: Vec<(EquationPart, usize)>,
}

/// Exponent of the window.
const WINDOW: i32 = 8;

impl Basis {
    /// Products of these harmonics and powers; those of the potential have two powers more, so that forces have one more than the masses.
    pub(super) fn new(factors: &[Factor], coordinates: usize, inputs: usize, [harmonics, powers]: [usize; 2]) -> Self {
        let exponents = terms::exponents(factors, [harmonics, powers + 2]);
        let n = coordinates;
        let (mut of_mass, mut of_potential, mut of_damping, mut of_force) =
            <(Vec<_>, Vec<_>, Vec<_>, Vec<_>)>::default();
        for (product, exponents) in exponents.iter().enumerate() {
            let has_coordinate = exponents[..n].iter().any(|exponent| *exponent != 0);
            if has_coordinate {
                // what does not depend on the coordinates is no potential
                of_potential.push(product);
            }
            if sum_of_powers(exponents, factors) > powers {
                continue;
            }
            of_mass.push(product);
            let has_angle =
                exponents.iter().zip(factors).any(|(exponent, factor)| *exponent != 0 && *factor == Factor::Angle);
            if !has_angle {
                of_damping.push(product);
            }
            if !has_coordinate {
                // a constant torque is no periodic potential
                of_force.push(product);
            }
        }
        let mut parts: Vec<(EquationPart, &[usize])> = Vec::new();
        for row in 0..n {
            parts.extend((0..=row).map(|column| (EquationPart::Mass(row, column), &of_mass[..])));
        }
        parts.push((EquationPart::Potential, &of_potential));
        let angles = (0..n).filter(|row| factors[*row] == Factor::Angle);
        parts.extend(angles.map(|row| (EquationPart::Force(row), &of_force[..])));
        for row in 0..n {
            parts.extend((0..n).map(|column| (EquationPart::Damping(row, column), &of_damping[..])));
        }
        for row in 0..n {
            parts.extend((0..inputs).map(|column| (EquationPart::Input(row, column), &of_mass[..])));
        }
        let unknowns =
            parts.into_iter().flat_map(|(part, products)| products.iter().map(move |product| (part, *product)));
        let unknowns = unknowns.collect();
        Self { factors: factors.to_vec(), coordinates, inputs, exponents, unknowns }
    }

    /// The products at the rows of a motion, shape `[rows, products]`.
    fn products(&self, trajectory: &Trajectory, rows: &[usize]) -> Result<DMatrix<f64>, FormatError> {
        let n = self.coordinates;
        let points = rows.iter().map(|row| [&trajectory.q[row * n..][..n], &trajectory.parameters].concat());
        terms::values(self.factors[..].into(), &self.exponents, &points.collect())
    }

    /// The derivative of each product with respect to a coordinate: a factor and another product.
    fn derivatives(&self, coordinate: usize) -> Vec<(f64, usize)> {
        let known: HashMap<&[i16], usize> =
            self.exponents.iter().enumerate().map(|(index, exponents)| (exponents.as_slice(), index)).collect();
        let derivatives = self.exponents.iter().map(|exponents| {
            let (mut other, order) = (exponents.clone(), exponents[coordinate]);
            let factor = match self.factors[coordinate] {
                _ if order == 0 => return (0.0, 0),
                // cos(k x)' = -k sin(k x), sin(k x)' = k cos(k x)
                Factor::Angle => {
                    other[coordinate] = -order;
                    -f64::from(order)
                }
                Factor::Power { half, .. } => {
                    other[coordinate] = order - 1;
                    f64::from(order) / half
                }
            };
            known.get(other.as_slice()).map_or((0.0, 0), |product| (factor, *product))
        });
        derivatives.collect()
    }

    /// The weak equations of a motion with windows of `2 half + 1` rows whose middles are every `stride` rows: shape
    /// `[windows coordinates, unknowns]`.
    pub(super) fn equations(
        &self,
        trajectory: &Trajectory,
        half: usize,
        stride: usize,
    ) -> Result<DMatrix<f64>, FormatError> {
        let (n, m, rows) = (self.coordinates, self.inputs, trajectory.rows());
        let middles: Vec<usize> = (half..rows.saturating_sub(half)).step_by(stride.max(1)).collect();
        let products = self.products(trajectory, &(0..rows).collect::<Vec<_>>())?;
        let derivatives: Vec<Vec<(f64, usize)>> = (0..n).map(|coordinate| self.derivatives(coordinate)).collect();
        let window = WindowWeights::new(half, trajectory.step);
        let v = |row: usize, k: usize| trajectory.v[row * n + k];
        // the integral of a smooth function times an input that is linear between the rows
        let u = |row: usize, k: usize| {
            let at = |row: usize| trajectory.u[row * m + k];
            let (before, after) = (at(row.saturating_sub(1)), at((row + 1).min(rows - 1)));
            at(row) + (before - 2.0 * at(row) + after) / 12.0
        };
        let mut equations = DMatrix::zeros(middles.len() * n, self.unknowns.len());
        let (mut momentum, mut force) = (vec![0.0; rows * n], vec![0.0; rows * n]);
        for (&(part, product), mut column) in self.unknowns.iter().zip(equations.column_iter_mut()) {
            momentum.fill(0.0);
            force.fill(0.0);
            for row in 0..rows {
                let value = products[(row, product)];
                let slope = |coordinate: usize| {
                    let (factor, other) = derivatives[coordinate][product];
                    factor * products[(row, other)]
                };
                let (momentum, force) = (&mut momentum[row * n..][..n], &mut force[row * n..][..n]);
                match part {
                    EquationPart::Mass(i, j) => {
                        momentum[i] = value * v(row, j);
                        momentum[j] = value * v(row, i);
                        let twice = if i == j { 0.5 } else { 1.0 };
                        (0..n).for_each(|k| force[k] = -twice * slope(k) * v(row, i) * v(row, j));
                    }
                    EquationPart::Potential => (0..n).for_each(|k| force[k] = slope(k)),
                    EquationPart::Force(i) => force[i] = -value,
                    EquationPart::Damping(i, j) => force[i] = value * v(row, j),
                    EquationPart::Input(i, j) => force[i] = -value * u(row, j),
                }
            }
            for (index, middle) in middles.iter().enumerate() {
                for k in 0..n {
                    let at = |offset: usize| (middle - half + offset) * n + k;
                    let weights = window.values.iter().zip(&window.slopes).enumerate();
                    column[index * n + k] = weights
                        .map(|(offset, (value, slope))| value * force[at(offset)] - slope * momentum[at(offset)])
                        .sum();
                }
            }
        }
        Ok(equations)
    }

    /// The mass matrix at some rows, for each coefficient of it: shape `[rows, unknowns]` of the entry `(row, column)` of the lower triangle;
    /// zero for the other coefficients.
    pub(super) fn masses(&self, trajectory: &Trajectory, rows: &[usize]) -> Result<DMatrix<f64>, FormatError> {
        let products = self.products(trajectory, rows)?;
        Ok(DMatrix::from_fn(rows.len(), self.unknowns.len(), |row, unknown| match self.unknowns[unknown] {
            (EquationPart::Mass(..), product) => products[(row, product)],
            _ => 0.0,
        }))
    }

    /// The equations with these coefficients.
    pub(super) fn dynamics(&self, coefficients: &[f64]) -> Result<Dynamics, FormatError> {
        let (n, m) = (self.coordinates, self.inputs);
        let (functions, potential) = (Dynamics::functions(n, m), n * (n + 1) / 2);
        let mut terms: Vec<Term> = self
            .exponents
            .iter()
            .map(|exponents| Term { exponents: exponents.clone(), coefficients: vec![0.0; functions] })
            .collect();
        for ((part, product), coefficient) in self.unknowns.iter().zip(coefficients) {
            let function = match *part {
                EquationPart::Mass(row, column) => row * (row + 1) / 2 + column,
                EquationPart::Potential => potential,
                EquationPart::Force(row) => potential + 1 + row,
                EquationPart::Damping(row, column) => potential + 1 + n + row * n + column,
                EquationPart::Input(row, column) => potential + 1 + n + n * n + row * m + column,
            };
            terms[*product].coefficients[function] = *coefficient;
        }
        Dynamics::new(n, m, Dictionary::new(&self.factors, functions, &terms)?)
    }
}

/// Sum of the powers of the columns that are no angles.
fn sum_of_powers(exponents: &[i16], factors: &[Factor]) -> usize {
    let powers = exponents.iter().zip(factors).filter(|(_, factor)| **factor != Factor::Angle);
    powers.map(|(exponent, _)| usize::from(exponent.unsigned_abs())).sum()
}

/// Weights of the rows of a window, whose sum is one, and their derivatives with respect to time.
struct WindowWeights {
    values: Vec<f64>,
    slopes: Vec<f64>,
}

impl WindowWeights {
    fn new(half: usize, step: f64) -> Self {
        let shares: Vec<f64> = (0..=2 * half).map(|row| row as f64 / half as f64 - 1.0).collect();
        let values: Vec<f64> = shares.iter().map(|s| (1.0 - s * s).powi(WINDOW)).collect();
        let sum: f64 = values.iter().sum();
        let slope =
            |s: &f64| -2.0 * s * f64::from(WINDOW) * (1.0 - s * s).powi(WINDOW - 1) / (half as f64 * step * sum);
        let slopes = shares.iter().map(slope).collect();
        Self { values: values.iter().map(|value| value / sum).collect(), slopes }
    }
}
