//! Coefficients of a compliant element by least squares.
//!
//! Forces are linear in the coefficients of the potential. Those of the dissipation, the entries of `L`, follow from Levenberg-Marquardt steps, in
//! which the potential is always the best one (Golub and Pereyra 1973, variable projection). Degrees are raised as long as held-out runs gain.

use super::{CompliantElement, ElementRows, ProductBasis, basis::size, triangle};
use crate::{
    Error, Result, scaling,
    study::{MAX_DEGREE, Study},
};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SymmetricEigen};
use std::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

/// Result of a fit.
#[derive(Clone, Debug)]
pub struct ElementFit {
    /// The element of the best degrees.
    pub element: CompliantElement,
    /// All degrees that were compared.
    pub candidates: Vec<FittedDegrees>,
    /// Position of the best among them.
    pub best: usize,
}

/// Degrees of polynomials, and their error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedDegrees {
    /// Total degree of the potential.
    pub potential: u8,
    /// Total degree of the entries of `L`; none without velocities.
    pub dissipation: Option<u8>,
    /// Root mean square error on the held-out rows relative to the standard deviation, of the worst force.
    pub error: f64,
    /// Wall time.
    pub seconds: f64,
}

/// Degrees: of the potential, and of the entries of `L`.
type Degrees = (u8, u8);

/// Degrees to begin with.
const FIRST: Degrees = (2, 0);
/// Coefficients of the potential and of the dissipation together.
const MOST_COEFFICIENTS: usize = 2000;
/// Numbers that are fitted for each coefficient, at least.
const NUMBERS_PER_COEFFICIENT: usize = 3;
/// Share of the error that higher degrees must gain.
const GAIN: f64 = 0.05;
/// Error that is small enough: higher degrees would only cost time.
const SMALL_ENOUGH: f64 = 1e-4;
/// Ridge relative to the mean diagonal of the normal equations: it leaves out directions that the rows do not determine.
const RIDGE: f64 = 1e-12;
/// Levenberg-Marquardt steps at most, and the relative decrease that ends them.
const STEPS: usize = 50;
const ENOUGH: f64 = 1e-7;
/// Rows whose derivatives are in memory at a time.
const BLOCK: usize = 256;

/// Fits an element to rows, with the degrees of the study or those that are best on held-out rows.
///
/// # Errors
/// [`Error::Interrupted`] when `stop` turns true, [`Error::Study`] if the rows do not determine the coefficients.
pub fn fit(study: &Study, rows: &ElementRows, held_out: &ElementRows, stop: &AtomicBool) -> Result<ElementFit> {
    let limits = limits(study, rows, held_out);
    let given = [study.compliant.potential, study.compliant.dissipation];
    let search = DegreeSearch { study, rows, held_out, limits: &limits, stop };
    let first = (given[0].unwrap_or(FIRST.0), given[1].unwrap_or(FIRST.1));
    if !search.is_possible(first) {
        let (found, numbers) = (search.coefficients(first), rows.points.len() * rows.coordinates);
        let message = format!(
            "{found} coefficients, expected at most {MOST_COEFFICIENTS} and at most a third of the {numbers} forces: lower degrees or more rows"
        );
        return Err(study.refusal("compliant", message));
    }
    let mut tried: Vec<(Degrees, FittedCandidate)> = vec![(first, search.candidate(first, None)?)];
    let mut best = 0;
    while tried[best].1.error > SMALL_ENOUGH {
        let ((potential, dissipation), start) = &tried[best];
        let mut next = Vec::new();
        if given[0].is_none() {
            // even potentials gain nothing from odd degrees
            next.extend([(potential + 1, *dissipation), (potential + 2, *dissipation)]);
        }
        if given[1].is_none() && rows.has_velocities {
            next.push((*potential, dissipation + 1));
        }
        next.retain(|degrees| search.is_possible(*degrees) && tried.iter().all(|(known, _)| known != degrees));
        let found: Vec<_> = next
            .into_iter()
            .map(|degrees| Ok((degrees, search.candidate(degrees, Some(&start.element))?)))
            .collect::<Result<_>>()?;
        let wanted = (1.0 - GAIN) * start.error;
        tried.extend(found);
        let order = |(at, (_, candidate)): (usize, &(Degrees, FittedCandidate))| (at, candidate.error);
        let least = tried.iter().enumerate().map(order).min_by(|a, b| a.1.total_cmp(&b.1));
        match least {
            Some((at, error)) if error < wanted => best = at,
            _ => break,
        }
    }
    let degrees = |((potential, dissipation), candidate): &(Degrees, FittedCandidate)| FittedDegrees {
        potential: *potential,
        dissipation: rows.has_velocities.then_some(*dissipation),
        error: candidate.error,
        seconds: candidate.seconds,
    };
    let candidates = tried.iter().map(degrees).collect();
    Ok(ElementFit { element: tried.swap_remove(best).1.element, candidates, best })
}

/// Ranges of the parameters, those of the study, and of the positions.
fn limits(study: &Study, rows: &ElementRows, held_out: &ElementRows) -> Vec<[f64; 2]> {
    let of_parameters = study.compliant.parameters.iter().filter_map(|name| study.parameters.get(name));
    let mut limits: Vec<[f64; 2]> = of_parameters.map(|parameter| [parameter.min, parameter.max]).collect();
    for column in rows.parameters..rows.configuration() {
        let values = rows.points.iter().chain(&held_out.points).map(|point| point[column]);
        limits.push(
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(value), max.max(value)]),
        );
    }
    limits
}

/// A fitted element, and its error on held-out rows.
struct FittedCandidate {
    element: CompliantElement,
    error: f64,
    seconds: f64,
}

/// Rows that degrees are compared on.
struct DegreeSearch<'a> {
    study: &'a Study,
    rows: &'a ElementRows,
    held_out: &'a ElementRows,
    limits: &'a [[f64; 2]],
    stop: &'a AtomicBool,
}

impl DegreeSearch<'_> {
    fn coefficients(&self, (potential, dissipation): Degrees) -> usize {
        let columns = self.rows.configuration();
        let entries = if self.rows.has_velocities { triangle(self.rows.coordinates).count() } else { 0 };
        size(columns, potential.into()).saturating_add(entries.saturating_mul(size(columns, dissipation.into())))
    }

    fn is_possible(&self, degrees: Degrees) -> bool {
        let numbers = self.rows.points.len() * self.rows.coordinates;
        let few = self.coefficients(degrees).saturating_mul(NUMBERS_PER_COEFFICIENT) <= numbers;
        few && self.coefficients(degrees) <= MOST_COEFFICIENTS && degrees.0.max(degrees.1) <= MAX_DEGREE
    }

    fn candidate(&self, degrees: Degrees, start: Option<&CompliantElement>) -> Result<FittedCandidate> {
        let began = Instant::now();
        let problem = LeastSquares::new(self.rows, self.limits, degrees);
        let message = "the rows do not determine the coefficients of the potential: more runs, or other motions";
        let element = problem.solve(start, self.stop)?.ok_or_else(|| self.study.refusal("compliant", message))?;
        let error = element.error(if self.held_out.points.is_empty() { self.rows } else { self.held_out }, self.rows);
        Ok(FittedCandidate { element, error, seconds: began.elapsed().as_secs_f64() })
    }
}

impl CompliantElement {
    fn is_finite(&self) -> bool {
        self.potential.iter().chain(&self.dissipation).all(|coefficient| coefficient.is_finite())
    }

    /// Largest root mean square error of a force, relative to its standard deviation in other rows.
    fn error(&self, rows: &ElementRows, of: &ElementRows) -> f64 {
        let found = self.graph().evaluate(&rows.points);
        let (_, scales) = scaling::of_columns(&of.forces);
        let of_force = |(force, scale): (usize, &f64)| {
            let squares = found.iter().zip(&rows.forces).map(|(found, exact)| (found[force] - exact[force]).powi(2));
            (squares.sum::<f64>() / found.len().max(1) as f64).sqrt() / scale
        };
        // NaN is the worst
        let errors = scales.iter().enumerate().map(of_force);
        errors.fold(0.0, |worst: f64, error| if error.is_nan() { f64::INFINITY } else { worst.max(error) })
    }
}

/// The normal equations of a fit, in which forces have a standard deviation of 1.
struct LeastSquares {
    element: CompliantElement,
    /// Products that the potential consists of: those without a position have no gradient.
    columns: Vec<usize>,
    /// Number of products of an entry of `L`.
    of_entry: usize,
    /// Values of the products; shape `[rows, products]`.
    values: DMatrix<f64>,
    /// Velocities relative to half of the range of their positions; shape `[rows, coordinates]`.
    rates: DMatrix<f64>,
    /// Forces; shape `[rows, coordinates]`.
    forces: DMatrix<f64>,
    /// Units of energy to standard deviations of each force.
    weights: Vec<f64>,
}

/// Sums over all rows at some entries of `L`.
struct Sums {
    /// `J_Vᵀ J_L`
    mixed: DMatrix<f64>,
    /// `J_Lᵀ J_L`
    own: DMatrix<f64>,
    /// `J_Vᵀ d`, with the dissipative forces `d`
    elastic: DVector<f64>,
    /// `J_Lᵀ (y - d)`
    gradient: DVector<f64>,
}

impl LeastSquares {
    fn new(rows: &ElementRows, limits: &[[f64; 2]], (potential, dissipation): Degrees) -> Self {
        let (configuration, n, first) = (rows.configuration(), rows.coordinates, rows.parameters);
        let of_dissipation = if rows.has_velocities { dissipation } else { 0 };
        let basis = ProductBasis::new(configuration, potential.max(of_dissipation));
        let middle: Vec<f64> = limits.iter().map(|[min, max]| 0.5 * (min + max)).collect();
        let half: Vec<f64> = limits.iter().map(|[min, max]| 0.5 * (max - min)).collect();
        let half: Vec<f64> = half.into_iter().map(|half| if half > 0.0 { half } else { 1.0 }).collect();
        let mut values = DMatrix::zeros(rows.points.len(), basis.products.terms());
        let mut of_row = vec![0.0; basis.products.terms()];
        for (row, point) in rows.points.iter().enumerate() {
            let z = point.iter().zip(&middle).zip(&half).map(|((value, middle), half)| (value - middle) / half);
            basis.products.evaluate(&z.collect::<Vec<_>>(), &mut of_row);
            values.row_mut(row).iter_mut().zip(&of_row).for_each(|(value, of)| *value = *of);
        }
        let (_, scales) = scaling::of_columns(&rows.forces);
        let rate = |row: usize, coordinate: usize| {
            if rows.has_velocities {
                rows.points[row][configuration + coordinate] / half[first + coordinate]
            } else {
                0.0
            }
        };
        let columns: Vec<usize> =
            (0..basis.count(potential)).filter(|product| basis.depends(*product, first)).collect();
        Self {
            columns,
            of_entry: basis.count(of_dissipation),
            values,
            rates: DMatrix::from_fn(rows.points.len(), n, rate),
            forces: DMatrix::from_fn(rows.points.len(), n, |row, force| rows.forces[row][force] / scales[force]),
            weights: (0..n).map(|force| 1.0 / (half[first + force] * scales[force])).collect(),
            element: CompliantElement {
                parameters: first,
                coordinates: n,
                has_velocities: rows.has_velocities,
                potential: vec![0.0; basis.count(potential)],
                dissipation: Vec::new(),
                basis,
                middle,
                half,
            },
        }
    }

    /// The element; with velocities the dissipation begins with that of another element. None if the rows do not determine it.
    fn solve(mut self, start: Option<&CompliantElement>, stop: &AtomicBool) -> Result<Option<CompliantElement>> {
        let (elastic, side) = self.elastic_equations(stop)?;
        let Some(factors) = Cholesky::new(with_ridge(elastic, RIDGE)) else { return Ok(None) };
        if !self.element.has_velocities {
            self.set_potential(&factors.solve(&side));
            return Ok(Some(self.element).filter(CompliantElement::is_finite));
        }
        let mut entries = match start {
            Some(element) => self.resized(element),
            None => self.constant_entries(&factors, &side),
        };
        let mut damping = 1e-3;
        let mut sums = self.sums(&entries, stop)?;
        let mut potential = factors.solve(&(&side - &sums.elastic));
        let mut cost = self.cost(&potential, &entries);
        for _ in 0..STEPS {
            let solved = factors.solve(&sums.mixed);
            let hessian = &sums.own - sums.mixed.tr_mul(&solved);
            let gradient = &sums.gradient - sums.mixed.tr_mul(&potential);
            let mut gained = 0.0;
            while damping < 1e12 {
                let mut damped = hessian.clone();
                let mean = hessian.trace() / hessian.nrows().max(1) as f64;
                (0..damped.nrows()).for_each(|i| damped[(i, i)] += damping * (damped[(i, i)] + 1e-9 * mean));
                let Some(step) = Cholesky::new(damped).map(|factors| factors.solve(&gradient)) else {
                    damping *= 10.0;
                    continue;
                };
                let (next, along) = (&entries + &step, &potential - &solved * &step);
                let found = self.cost(&along, &next);
                if found < cost {
                    gained = (cost - found) / cost;
                    (entries, cost) = (next, found);
                    damping = (0.1 * damping).max(1e-12);
                    break;
                }
                damping *= 10.0;
            }
            sums = self.sums(&entries, stop)?;
            potential = factors.solve(&(&side - &sums.elastic));
            cost = cost.min(self.cost(&potential, &entries));
            if gained < ENOUGH {
                break;
            }
        }
        self.set_potential(&potential);
        self.element.dissipation = entries.as_slice().to_vec();
        Ok(Some(self.element).filter(CompliantElement::is_finite))
    }

    fn set_potential(&mut self, solution: &DVector<f64>) {
        self.columns.iter().zip(solution.iter()).for_each(|(product, value)| self.element.potential[*product] = *value);
    }

    fn blocks(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let rows = self.values.nrows();
        (0..rows).step_by(BLOCK).map(move |first| first..(first + BLOCK).min(rows))
    }

    /// Derivatives of the forces of some rows by the coefficients of the potential: shape `[rows coordinates, products]`.
    fn elastic_rows(&self, rows: &Range<usize>) -> DMatrix<f64> {
        let (n, count) = (self.element.coordinates, rows.len());
        let mut derivatives = DMatrix::zeros(count * n, self.columns.len());
        for (column, product) in self.columns.iter().enumerate() {
            for (coordinate, weight) in self.weights.iter().enumerate() {
                for (place, factor) in self.element.basis.derivative(self.element.parameters + coordinate, *product) {
                    for row in 0..count {
                        derivatives[(coordinate * count + row, column)] +=
                            weight * factor * self.values[(rows.start + row, *place)];
                    }
                }
            }
        }
        derivatives
    }

    /// `J_Vᵀ J_V` and `J_Vᵀ y`
    fn elastic_equations(&self, stop: &AtomicBool) -> Result<(DMatrix<f64>, DVector<f64>)> {
        let columns = self.columns.len();
        let (mut matrix, mut side) = (DMatrix::zeros(columns, columns), DVector::zeros(columns));
        for rows in self.blocks() {
            expect_going(stop)?;
            let derivatives = self.elastic_rows(&rows);
            matrix += derivatives.tr_mul(&derivatives);
            side += derivatives.tr_mul(&self.stacked(&self.forces, &rows));
        }
        Ok((matrix, side))
    }

    /// Some rows of a matrix as a vector, coordinate by coordinate.
    fn stacked(&self, matrix: &DMatrix<f64>, rows: &Range<usize>) -> DVector<f64> {
        let columns = 0..matrix.ncols();
        let numbers = columns.flat_map(|column| rows.clone().map(move |row| matrix[(row, column)]));
        DVector::from_iterator(rows.len() * matrix.ncols(), numbers)
    }

    /// `L` of a row.
    fn matrix_at(&self, entries: &DVector<f64>, row: usize) -> DMatrix<f64> {
        let n = self.element.coordinates;
        let mut l = DMatrix::zeros(n, n);
        for ((i, j), coefficients) in triangle(n).zip(entries.as_slice().chunks(self.of_entry)) {
            l[(i, j)] = coefficients.iter().enumerate().map(|(at, value)| value * self.values[(row, at)]).sum();
        }
        l
    }

    /// Dissipative forces of some rows, and their derivatives by the coefficients of `L`.
    fn dissipative_rows(&self, entries: &DVector<f64>, rows: &Range<usize>) -> (DVector<f64>, DMatrix<f64>) {
        let (n, count) = (self.element.coordinates, rows.len());
        let mut forces = DVector::zeros(count * n);
        let mut derivatives = DMatrix::zeros(count * n, entries.len());
        for (at, row) in rows.clone().enumerate() {
            let (l, u) = (self.matrix_at(entries, row), self.rates.row(row).transpose());
            let y = l.tr_mul(&u);
            let force = &l * &y;
            for coordinate in 0..n {
                forces[coordinate * count + at] = self.weights[coordinate] * force[coordinate];
            }
            for (entry, (a, b)) in triangle(n).enumerate() {
                for i in 0..n {
                    // d(L Lᵀ u) = E_ab Lᵀ u + L E_ba u
                    let own = if i == a { y[b] } else { 0.0 };
                    let slope = self.weights[i] * (own + l[(i, b)] * u[a]);
                    if slope != 0.0 {
                        for product in 0..self.of_entry {
                            derivatives[(i * count + at, entry * self.of_entry + product)] =
                                slope * self.values[(row, product)];
                        }
                    }
                }
            }
        }
        (forces, derivatives)
    }

    fn sums(&self, entries: &DVector<f64>, stop: &AtomicBool) -> Result<Sums> {
        let (columns, count) = (self.columns.len(), entries.len());
        let mut sums = Sums {
            mixed: DMatrix::zeros(columns, count),
            own: DMatrix::zeros(count, count),
            elastic: DVector::zeros(columns),
            gradient: DVector::zeros(count),
        };
        for rows in self.blocks() {
            expect_going(stop)?;
            let elastic = self.elastic_rows(&rows);
            let (forces, derivatives) = self.dissipative_rows(entries, &rows);
            sums.mixed += elastic.tr_mul(&derivatives);
            sums.own += derivatives.tr_mul(&derivatives);
            sums.gradient += derivatives.tr_mul(&(self.stacked(&self.forces, &rows) - &forces));
            sums.elastic += elastic.tr_mul(&forces);
        }
        Ok(sums)
    }

    /// Sum of the squared errors.
    fn cost(&self, potential: &DVector<f64>, entries: &DVector<f64>) -> f64 {
        let n = self.element.coordinates;
        let mut weights = DMatrix::zeros(self.values.ncols(), n);
        for (coordinate, weight) in self.weights.iter().enumerate() {
            for (product, coefficient) in self.columns.iter().zip(potential.iter()) {
                for (place, factor) in self.element.basis.derivative(self.element.parameters + coordinate, *product) {
                    weights[(*place, coordinate)] += weight * coefficient * factor;
                }
            }
        }
        let residual = &self.forces - &self.values * weights;
        let of_row = |row: usize| {
            let l = self.matrix_at(entries, row);
            let force = &l * l.tr_mul(&self.rates.row(row).transpose());
            (0..n).map(|i| (residual[(row, i)] - self.weights[i] * force[i]).powi(2)).sum::<f64>()
        };
        (0..self.values.nrows()).map(of_row).sum()
    }

    /// Coefficients of `L` of another element with another number of products.
    fn resized(&self, element: &CompliantElement) -> DVector<f64> {
        let known = element.products_of_entry();
        let mut entries = DVector::zeros(element.entries() * self.of_entry);
        for (entry, coefficients) in element.dissipation.chunks(known.max(1)).enumerate() {
            let common = known.min(self.of_entry);
            entries.rows_mut(entry * self.of_entry, common).copy_from_slice(&coefficients[..common]);
        }
        entries
    }

    /// Coefficients of a constant `L`, by the symmetric matrix of least squares. A small dissipation remains, from which steps can begin.
    fn constant_entries(&self, factors: &Cholesky<f64, Dyn>, side: &DVector<f64>) -> DVector<f64> {
        let n = self.element.coordinates;
        let potential = factors.solve(side);
        let pairs: Vec<(usize, usize)> = triangle(n).collect();
        let (mut matrix, mut right) = (DMatrix::zeros(pairs.len(), pairs.len()), DVector::zeros(pairs.len()));
        for rows in self.blocks() {
            let residual = self.stacked(&self.forces, &rows) - self.elastic_rows(&rows) * &potential;
            for (at, row) in rows.clone().enumerate() {
                for i in 0..n {
                    let of_pair = |(a, b): &(usize, usize)| match i {
                        _ if i == *a => self.rates[(row, *b)],
                        _ if i == *b => self.rates[(row, *a)],
                        _ => 0.0,
                    };
                    let line = DVector::from_iterator(pairs.len(), pairs.iter().map(of_pair)) * self.weights[i];
                    right += &line * residual[i * rows.len() + at];
                    matrix += &line * line.transpose();
                }
            }
        }
        let size = |of: &DMatrix<f64>, i: usize| (of.column(i).norm_squared() / of.nrows().max(1) as f64).sqrt();
        // dissipation that would make a thousandth of the forces
        let floor = |i: usize| 1e-3 / (self.weights[i] * size(&self.rates, i)).max(f64::MIN_POSITIVE);
        let solved = Cholesky::new(with_ridge(matrix, 1e-9)).map(|factors| factors.solve(&right));
        let mut l = DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| floor(i).sqrt()));
        if let Some(solved) = solved.filter(|solved| solved.iter().all(|value| value.is_finite())) {
            // relative to the floor, so that no coordinate's unit counts
            let mut relative = DMatrix::zeros(n, n);
            for ((a, b), value) in pairs.iter().zip(solved.iter()) {
                let value = value / (l[(*a, *a)] * l[(*b, *b)]);
                (relative[(*a, *b)], relative[(*b, *a)]) = (value, value);
            }
            let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(relative);
            let positive = DMatrix::from_diagonal(&eigenvalues.map(|value| value.max(1.0)));
            let positive = &eigenvectors * positive * eigenvectors.transpose();
            if let Some(root) = Cholesky::new(positive) {
                l *= root.l();
            }
        }
        let mut entries = DVector::zeros(pairs.len() * self.of_entry);
        pairs.iter().enumerate().for_each(|(entry, at)| entries[entry * self.of_entry] = l[*at]);
        entries
    }
}

fn with_ridge(mut matrix: DMatrix<f64>, share: f64) -> DMatrix<f64> {
    let ridge = share * matrix.trace() / matrix.nrows().max(1) as f64;
    (0..matrix.nrows()).for_each(|i| matrix[(i, i)] += ridge.max(f64::MIN_POSITIVE));
    matrix
}

fn expect_going(stop: &AtomicBool) -> Result<()> {
    if stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}
