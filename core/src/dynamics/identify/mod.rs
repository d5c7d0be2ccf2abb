//! Equations of motion from recorded motions.
//!
//! The Euler-Lagrange equations are linear in the coefficients of their functions (module `system`), and homogeneous:
//! the coefficients are the singular vector of the smallest singular value. Only a common factor of all functions is
//! lost, on which no acceleration depends. Several vectors may solve the equations: uncoupled masses, modes of a linear
//! system, or a single orbit of a conservative one. Then the combination is taken whose mass matrix is closest to a
//! constant diagonal one and positive definite.
//!
//! Coefficients whose absence costs no accuracy are removed, starting with the smallest: absent terms cannot go wrong
//! beyond the rows. Orders, windows and sets of coefficients are compared by how well the equations continue the last
//! quarter of the motions. This quarter is held out until the choice is made, and then added.

mod roll_out;
mod system;

#[cfg(test)]
mod tests;

use super::{EquationSamples, WORTH_IT, least_squares, terms, trajectory::Trajectory};
use metafmu_runtime::{
    FormatError,
    dictionary::{Dictionary, Factor},
};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
pub use roll_out::AccelerationModel;
use std::ops::Range;
use system::{Basis, EquationPart};

/// Equations that were found, and how well.
#[derive(Clone, Debug)]
pub struct Identified {
    /// The equations.
    pub model: AccelerationModel,
    /// Highest harmonic of the angles, and highest power of the others; of equations of motion that of the mass matrix, and the potential
    /// has two more.
    pub order: [usize; 2],
    /// Coefficients other than zero.
    pub coefficients: usize,
    /// Number of independent solutions that the rows allow if no coefficient is left out; more than one are not told apart by them.
    pub solutions: usize,
    /// Root mean square error of coordinates along stretches that were held out, relative to their standard deviations.
    pub error: f64,
}

/// Reason why no equations are identified.
#[derive(Debug, thiserror::Error)]
pub enum IdentificationError {
    /// More coefficients, even at the lowest order, than the rows or the method allow.
    #[error("too many coordinates, parameters and inputs, or too few rows")]
    TooManyCoefficients,
    /// Equations of motion, but none with a positive definite mass matrix.
    #[error("no equations with a positive definite mass matrix continue the motions")]
    NoMassMatrix,
    /// Coefficients of which no functions can be made.
    #[error(transparent)]
    Format(#[from] FormatError),
}

/// Part of the rows of each motion from which equations are found before those that are held out are added.
const LEARNED: f64 = 0.75;

/// Rows of the shortest motion that anything is learned from.
pub const FEWEST_ROWS: usize = 50;

/// Half widths of the windows that are tried, in rows.
const WINDOWS: [usize; 4] = [6, 12, 20, 32];

/// Number of coefficients that are tried at most: the cube of it is the cost.
const MOST_COEFFICIENTS: usize = 320;

/// Equations of windows for each coefficient: more cost time and change little.
const EQUATIONS: usize = 20;

/// Factor by which an error may grow when coefficients are left out.
const AS_GOOD: f64 = 1.2;

/// Errors below it are not told apart: that of the integration is of this size.
const SAME: f64 = 1e-8;

/// Orders that are tried without a gain before the search ends.
const PATIENCE: usize = 2;

/// The row at which the part begins that is held out.
fn split(rows: usize) -> usize {
    (rows as f64 * LEARNED) as usize
}

/// Finds equations of motion, their columns being `factors`: coordinates, then parameters.
///
/// # Errors
/// [`IdentificationError`]: too many functions or too few rows, or no equations with a positive definite mass matrix.
pub fn fit_motion(factors: &[Factor], trajectories: &[Trajectory]) -> Result<Identified, IdentificationError> {
    let has_angles = factors.contains(&Factor::Angle);
    let has_powers = factors.iter().any(|factor| *factor != Factor::Angle);
    let mut order = [if has_angles { 2 } else { 0 }, 0];
    let mut best: Option<Identified> = None;
    let mut without_gain = 0;
    while without_gain < PATIENCE {
        match of_order(factors, trajectories, order)? {
            None => break,
            Some(found) if best.as_ref().is_none_or(|best| found.error < WORTH_IT * best.error) => {
                (best, without_gain) = (Some(found), 0);
            }
            Some(_) => without_gain += 1,
        }
        if best.as_ref().is_some_and(|best| best.error <= SAME) {
            break;
        }
        // powers first: there are fewer of them
        order = match (has_powers, has_angles) {
            (true, _) if order[1] < 4 => [order[0], order[1] + 1],
            (_, true) => [2 * order[0], 0],
            _ => break,
        };
    }
    let best = best.ok_or(IdentificationError::TooManyCoefficients)?;
    if best.error.is_finite() { Ok(best) } else { Err(IdentificationError::NoMassMatrix) }
}

/// The best equations of an order; none if there are too many coefficients for the rows.
fn of_order(
    factors: &[Factor],
    trajectories: &[Trajectory],
    order: [usize; 2],
) -> Result<Option<Identified>, FormatError> {
    let first = &trajectories[0];
    let basis = Basis::new(factors, first.coordinates, first.inputs(), order);
    if basis.unknowns.len() > MOST_COEFFICIENTS {
        return Ok(None);
    }
    let parts: Vec<Trajectory> = trajectories.iter().map(|motion| motion.first(split(motion.rows()))).collect();
    let of_windows = WINDOWS.into_par_iter().map(|half| {
        let problem = WeakEquations::new(&basis, &parts, half)?;
        let chosen = problem.map(|problem| problem.choose(trajectories)).transpose()?.flatten();
        Ok(chosen.map(|(choice, error)| (choice, error, half)))
    });
    let found: Result<Vec<_>, FormatError> = of_windows.collect();
    let found = found?.into_iter().flatten().collect();
    let Some((choice, error, half)) = simplest(found, |(choice, error, _)| (choice.active.len(), *error)) else {
        let model = motion_model(&basis, &Choice::none(&basis))?;
        return Ok(Some(Identified { model, order, coefficients: 0, solutions: 0, error: f64::INFINITY }));
    };
    // with the rows that were held out, if that is a solution as well
    let whole = WeakEquations::new(&basis, trajectories, half)?;
    let refitted = whole.and_then(|problem| problem.solve(&choice.active, choice.limit, choice.solutions));
    let refitted = refitted.map(|choice| motion_model(&basis, &choice)).transpose()?;
    let refitted = refitted.filter(|model| roll_out::error(model, trajectories, split) <= 2.0 * error.max(SAME));
    let Choice { active, independent, .. } = &choice;
    let model = refitted.map_or_else(|| motion_model(&basis, &choice), Ok)?;
    Ok(Some(Identified { model, order, coefficients: active.len(), solutions: *independent, error }))
}

/// The candidate with the fewest coefficients whose error is as good as the least; `of` returns the number of
/// coefficients and the error.
fn simplest<T>(candidates: Vec<T>, of: impl Fn(&T) -> (usize, f64)) -> Option<T> {
    let least = candidates.iter().map(|candidate| of(candidate).1).fold(f64::INFINITY, f64::min);
    let good = candidates.into_iter().filter(|candidate| of(candidate).1 <= AS_GOOD * least.max(SAME));
    good.min_by(|a, b| of(a).0.cmp(&of(b).0).then(of(a).1.total_cmp(&of(b).1)))
}

/// Weak form of the equations of motion, reduced to one equation for each coefficient.
struct WeakEquations<'a> {
    basis: &'a Basis,
    coordinates: usize,
    /// The upper triangle of the equations, whose columns have the norm 1, and the norms.
    triangle: DMatrix<f64>,
    norms: Vec<f64>,
    /// Entries of the mass matrix at some rows of the motions, shape `[rows, coefficients]`.
    masses: DMatrix<f64>,
    /// Scale of each coordinate in the mass matrix: the inverse of its root mean square rate, or 1 without motion.
    sizes: Vec<f64>,
}

/// Coefficients of equations of motion.
struct Choice {
    /// Those that are not zero.
    active: Vec<usize>,
    /// All coefficients.
    coefficients: Vec<f64>,
    /// Largest singular value that counts as zero.
    limit: f64,
    /// Number of them, and of those of all coefficients together.
    solutions: usize,
    independent: usize,
}

/// Rows at which the mass matrix is to be positive definite.
const CHECKED: usize = 200;

/// Share of the largest eigenvalue of the mass matrix that the smallest one is to have, in coordinates in which rates are alike.
const DEFINITE: f64 = 1e-4;

impl Choice {
    fn none(basis: &Basis) -> Self {
        Self {
            active: Vec::new(),
            coefficients: vec![0.0; basis.unknowns.len()],
            limit: 0.0,
            solutions: 0,
            independent: 0,
        }
    }
}

impl<'a> WeakEquations<'a> {
    /// None if there are too few rows.
    fn new(basis: &'a Basis, trajectories: &[Trajectory], half: usize) -> Result<Option<Self>, FormatError> {
        let (unknowns, n) = (basis.unknowns.len(), trajectories[0].coordinates);
        let count: usize = trajectories.iter().map(|motion| motion.rows().saturating_sub(2 * half)).sum();
        // neighboring windows overlap
        if count * n < 2 * unknowns || count < half {
            return Ok(None);
        }
        let stride = (count * n / (EQUATIONS * unknowns).max(2000)).max(1);
        let blocks: Vec<DMatrix<f64>> =
            trajectories.iter().map(|motion| basis.equations(motion, half, stride)).collect::<Result<_, _>>()?;
        let mut equations = stacked(&blocks, unknowns);
        let norms: Vec<f64> = equations.column_iter().map(|column| column.norm()).collect();
        if equations.nrows() < unknowns || norms.iter().any(|norm| !norm.is_finite()) {
            return Ok(None);
        }
        for (mut column, norm) in equations.column_iter_mut().zip(&norms).filter(|(_, norm)| **norm > 0.0) {
            column /= *norm;
        }
        let stride = trajectories.iter().map(Trajectory::rows).sum::<usize>().div_ceil(CHECKED);
        let checked = trajectories.iter().step_by(trajectories.len().div_ceil(CHECKED)).map(|trajectory| {
            let rows: Vec<usize> = (0..trajectory.rows()).step_by(stride).collect();
            basis.masses(trajectory, &rows)
        });
        let masses = stacked(&checked.collect::<Result<Vec<_>, _>>()?, unknowns);
        let sizes = (0..n).map(|k| {
            let squares = trajectories.iter().flat_map(|motion| motion.v.iter().skip(k).step_by(n)).map(|v| v * v);
            let rows: usize = trajectories.iter().map(Trajectory::rows).sum();
            let mean = squares.sum::<f64>() / rows as f64;
            if mean > 0.0 { mean.sqrt().recip() } else { 1.0 }
        });
        let sizes = sizes.collect();
        Ok(Some(Self { basis, coordinates: n, triangle: equations.qr().r(), norms, masses, sizes }))
    }

    /// The coefficients that continue the rows that are held out best, as few as are as good.
    fn choose(&self, trajectories: &[Trajectory]) -> Result<Option<(Choice, f64)>, FormatError> {
        let error = |choice: &Choice| Ok(roll_out::error(&motion_model(self.basis, choice)?, trajectories, split));
        let largest = self.norms.iter().copied().fold(0.0, f64::max);
        let all: Vec<usize> = (0..self.norms.len()).filter(|unknown| self.norms[*unknown] > 1e-14 * largest).collect();
        let Some(singular) = self.singular_values(&all) else { return Ok(None) };
        let mut found: Vec<(Choice, f64)> = Vec::new();
        for solutions in likely_solutions(&singular, self.coordinates) {
            let limit = 3.0 * singular[solutions - 1].max(f64::EPSILON);
            if let Some(choice) = self.solve(&all, limit, solutions) {
                let independent = choice.solutions;
                let (choice, error) = self.without_idle(choice, &error)?;
                found.push((Choice { independent, ..choice }, error));
            }
        }
        found.retain(|(_, error)| error.is_finite());
        Ok(simplest(found, |(choice, error)| (choice.active.len(), *error)))
    }

    /// Leaves out coefficients that the error does not need: the smallest ones together, then one by one.
    fn without_idle(
        &self,
        all: Choice,
        error: &impl Fn(&Choice) -> Result<f64, FormatError>,
    ) -> Result<(Choice, f64), FormatError> {
        let mut least = error(&all)?;
        let mut best = (all, least);
        let shares = (-9..=-1).map(|exponent| 10f64.powi(exponent));
        let one_by_one = std::iter::repeat_n(0.0, best.0.active.len());
        for share in shares.chain(one_by_one) {
            let sizes: Vec<f64> =
                best.0.active.iter().map(|k| (best.0.coefficients[*k] * self.norms[*k]).abs()).collect();
            let (smallest, largest) =
                sizes.iter().fold((f64::INFINITY, 0.0f64), |(low, high), size| (low.min(*size), high.max(*size)));
            let least_size = if share > 0.0 { share * largest } else { smallest };
            let active = best.0.active.iter().zip(&sizes).filter(|(_, size)| **size > least_size).map(|(k, _)| *k);
            let active: Vec<usize> = active.collect();
            if active.len() == best.0.active.len() {
                continue;
            }
            let fewer = self.solve(&active, best.0.limit, 1);
            let found = fewer.map(|choice| Ok((error(&choice)?, choice))).transpose()?;
            match found.filter(|(error, _)| *error <= AS_GOOD * least.max(SAME)) {
                Some((error, choice)) => {
                    least = least.min(error);
                    best = (choice, error);
                }
                None if share > 0.0 => {}
                None => break,
            }
        }
        Ok(best)
    }

    /// Singular values of the equations for some coefficients, the smallest first.
    fn singular_values(&self, active: &[usize]) -> Option<Vec<f64>> {
        let mut values: Vec<f64> = self
            .triangle
            .select_columns(active)
            .try_svd(false, false, f64::EPSILON, 0)?
            .singular_values
            .iter()
            .copied()
            .collect();
        values.sort_by(f64::total_cmp);
        Some(values)
    }

    /// Coefficients that solve the equations up to singular values of `limit`, with at least `at_least` singular
    /// values, and whose mass matrix is positive definite; none if they do not exist.
    fn solve(&self, active: &[usize], limit: f64, at_least: usize) -> Option<Choice> {
        if active.len() < at_least {
            return None;
        }
        let decomposition = self.triangle.select_columns(active).try_svd(false, true, f64::EPSILON, 0)?;
        let vectors = decomposition.v_t?;
        let mut order: Vec<usize> = (0..vectors.nrows()).collect();
        let values = &decomposition.singular_values;
        order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
        let small = order.iter().filter(|index| values[**index] <= limit).count();
        let solutions = small.max(at_least).min(active.len());
        let space = DMatrix::from_fn(active.len(), solutions, |row, column| {
            vectors[(order[column], row)] / self.norms[active[row]]
        });
        let weights = self.definite(active, &space)?;
        let solution = space * weights;
        let mut coefficients = vec![0.0; self.norms.len()];
        active.iter().zip(&solution).for_each(|(unknown, value)| coefficients[*unknown] = *value);
        let of_mass =
            active.iter().filter(|unknown| matches!(self.basis.unknowns[**unknown].0, EquationPart::Mass(..)));
        let largest = of_mass.map(|unknown| coefficients[*unknown].abs()).fold(0.0, f64::max);
        coefficients.iter_mut().for_each(|value| *value /= largest);
        Some(Choice { active: active.to_vec(), coefficients, limit, solutions, independent: solutions })
    }

    /// The combination of solutions whose mass matrix is closest to the identity at all rows and positive definite, in
    /// coordinates whose rates are of similar size. Projects in turn on the positive definite matrices and on the
    /// solutions.
    fn definite(&self, active: &[usize], space: &DMatrix<f64>) -> Option<DVector<f64>> {
        let (n, rows) = (self.coordinates, self.masses.nrows());
        // entries of the lower triangle, row by row, of each solution: shape [entries rows, solutions]
        let entries: Vec<(usize, usize)> = (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
        let mut of_solutions = DMatrix::zeros(entries.len() * rows, space.ncols());
        for (index, (i, j)) in entries.iter().enumerate() {
            let entry = EquationPart::Mass(*i, *j);
            let chosen: Vec<usize> = (0..active.len()).filter(|k| self.basis.unknowns[active[*k]].0 == entry).collect();
            let values = self.masses.select_columns(&chosen.iter().map(|k| active[*k]).collect::<Vec<_>>());
            // an entry beside the diagonal is there twice
            let weight = if i == j { 1.0 } else { 2f64.sqrt() } / (self.sizes[*i] * self.sizes[*j]);
            let block = values * space.select_rows(&chosen) * weight;
            of_solutions.rows_mut(index * rows, rows).copy_from(&block);
        }
        let projection = of_solutions.clone().try_svd(true, true, f64::EPSILON, 0)?;
        let smallest = 1e-10 * projection.singular_values.max();
        let mut target = DVector::zeros(entries.len() * rows);
        for (index, (i, j)) in entries.iter().enumerate() {
            target.rows_mut(index * rows, rows).fill(f64::from(u8::from(i == j)));
        }
        for _ in 0..PROJECTIONS {
            let weights = projection.solve(&target, smallest).ok()?;
            let found = &of_solutions * &weights;
            if !found.iter().all(|value| value.is_finite()) {
                return None;
            }
            let (mut lowest, mut highest) = (f64::INFINITY, 0.0f64);
            let mut decompositions = Vec::with_capacity(rows);
            for row in 0..rows {
                let mut mass = DMatrix::zeros(n, n);
                for (index, (i, j)) in entries.iter().enumerate() {
                    let value = found[index * rows + row] / if i == j { 1.0 } else { 2f64.sqrt() };
                    (mass[(*i, *j)], mass[(*j, *i)]) = (value, value);
                }
                let eigen = mass.symmetric_eigen();
                (lowest, highest) = (lowest.min(eigen.eigenvalues.min()), highest.max(eigen.eigenvalues.max()));
                decompositions.push(eigen);
            }
            if lowest > DEFINITE * highest {
                return Some(weights);
            }
            for (row, mut eigen) in decompositions.into_iter().enumerate() {
                eigen.eigenvalues.apply(|value| *value = value.max(0.05));
                let mass = eigen.recompose();
                for (index, (i, j)) in entries.iter().enumerate() {
                    target[index * rows + row] = mass[(*i, *j)] * if i == j { 1.0 } else { 2f64.sqrt() };
                }
            }
        }
        None
    }
}

/// Matrices one below the other.
fn stacked(parts: &[DMatrix<f64>], columns: usize) -> DMatrix<f64> {
    let mut whole = DMatrix::zeros(parts.iter().map(DMatrix::nrows).sum(), columns);
    let mut row = 0;
    for part in parts {
        whole.rows_mut(row, part.nrows()).copy_from(part);
        row += part.nrows();
    }
    whole
}

/// Projections until a mass matrix is positive definite.
const PROJECTIONS: usize = 100;

/// How many of the singular values, the smallest first, may be zero: one for each coordinate, or those before the largest gap.
fn likely_solutions(singular: &[f64], coordinates: usize) -> Vec<usize> {
    let few = singular.len().saturating_sub(1).min(coordinates * (coordinates + 1) / 2 + 6);
    let gaps = (1..=few).map(|k| (k, singular[k] / singular[k - 1].max(f64::EPSILON)));
    let at_gap = gaps.max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(k, _)| k);
    let mut likely: Vec<usize> = (1..=coordinates.min(few)).chain(at_gap).collect();
    likely.sort_unstable();
    likely.dedup();
    likely
}

/// Finds accelerations as functions of parameters, inputs, coordinates and rates, whose columns are `factors`, from differences of the
/// rates.
///
/// # Errors
/// [`IdentificationError::TooManyCoefficients`] if there are too many columns or too few rows.
pub fn fit_accelerations(factors: &[Factor], trajectories: &[Trajectory]) -> Result<Identified, IdentificationError> {
    let seen = acceleration_samples(trajectories, |rows| 0..split(rows));
    let unseen = acceleration_samples(trajectories, |rows| split(rows)..rows);
    let all = acceleration_samples(trajectories, |rows| 0..rows);
    let scales: Vec<f64> = (0..trajectories[0].coordinates)
        .map(|coordinate| all.labels.largest_magnitude(coordinate).max(f64::MIN_POSITIVE))
        .collect();
    let solve = |order: [usize; 2], samples: &EquationSamples| -> Option<Dictionary> {
        let exponents = terms::exponents(factors, order);
        if exponents.len() > MOST_COEFFICIENTS || samples.points.len() < 2 * exponents.len() {
            return None;
        }
        let (coefficients, _) = least_squares::solve(factors.into(), &exponents, samples, &unseen, &scales).ok()?;
        least_squares::dictionary(factors.into(), &exponents, &coefficients, 0..scales.len()).ok()
    };
    let mut order = [if factors.contains(&Factor::Angle) { 2 } else { 0 }, 1];
    let mut best: Option<Identified> = None;
    let mut without_gain = 0;
    while without_gain < PATIENCE {
        let Some(functions) = solve(order, &seen) else { break };
        let error = |functions: &Dictionary| {
            roll_out::error(&AccelerationModel::Functions(Box::new(functions.clone())), trajectories, split)
        };
        let error_unseen = error(&functions);
        if best.as_ref().is_none_or(|best| error_unseen < WORTH_IT * best.error) {
            let again = solve(order, &all).filter(|functions| error(functions) <= 2.0 * error_unseen.max(SAME));
            let functions = again.unwrap_or(functions);
            let coefficients =
                functions.terms().flat_map(|term| term.coefficients).filter(|value| *value != 0.0).count();
            let model = AccelerationModel::Functions(Box::new(functions));
            best = Some(Identified { model, order, coefficients, solutions: 1, error: error_unseen });
            without_gain = 0;
        } else {
            without_gain += 1;
        }
        order = if order[1] < 5 { [order[0], order[1] + 1] } else { [2 * order[0], 1] };
        if order[0] > 16 || order == [0, 1] {
            break;
        }
    }
    best.ok_or(IdentificationError::TooManyCoefficients)
}

/// Accelerations by differences in some rows of each motion, those close to its ends left out.
fn acceleration_samples(trajectories: &[Trajectory], chosen: fn(usize) -> Range<usize>) -> EquationSamples {
    let mut samples = EquationSamples::default();
    for trajectory in trajectories {
        let labels = trajectory.accelerations();
        let (n, m, rows) = (trajectory.coordinates, trajectory.inputs(), trajectory.rows());
        // differences at the ends are worse
        for row in chosen(rows).filter(|row| (3..rows.saturating_sub(3)).contains(row)) {
            let (u, q, v) =
                (&trajectory.u[row * m..][..m], &trajectory.q[row * n..][..n], &trajectory.v[row * n..][..n]);
            samples.points.push(&[&trajectory.parameters, u, q, v].concat());
            samples.labels.push(&labels[row * n..][..n]);
        }
    }
    samples
}

fn motion_model(basis: &Basis, choice: &Choice) -> Result<AccelerationModel, FormatError> {
    Ok(AccelerationModel::Motion(Box::new(basis.dynamics(&choice.coefficients)?)))
}

impl AccelerationModel {
    /// The number of products of sines, cosines and powers.
    pub fn products(&self) -> usize {
        match self {
            Self::Motion(dynamics) => dynamics.function_set().dictionary().products(),
            Self::Functions(functions) => functions.products(),
        }
    }
}
