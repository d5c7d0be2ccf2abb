//! The implicit method of Radau IIA with seven stages, order 13, for stiff equations.
//!
//! A step of size `h` solves `Z = h A F(y + Z)` for the changes `Z` of the states at seven nodes; the last node is the end of the step.
//! The method is L-stable: decays that are much faster than a step cost nothing. Newton's method uses the Jacobian `J` of some earlier
//! state, by differences unless the problem provides it. With the eigenvalues of the inverse of `A` its linear system falls into one real system of the size of the state and
//! three complex ones. The error is estimated against an embedded formula of order 7 (Hairer, Wanner: *Solving Ordinary Differential
//! Equations II*, IV.8; *Stiff differential equations solved by Radau methods*, 1999). Steps end at rows.

mod coefficients;

use super::{Budget, IntegrationFailure, IntegrationResult};
use crate::worst::worst;
use coefficients::*;
use nalgebra::{Complex, DMatrix, DVector, Dyn, LU};

/// Part of the tolerance that Newton's method may leave.
const CONVERGED: f64 = 0.02;
/// Part of the tolerance that Newton's method may leave where rounding prevents further convergence.
const ROUNDED: f64 = 0.3;
/// Iterations of Newton's method at most.
const ITERATIONS: usize = 12;
/// Rate of convergence above which the next step has a new Jacobian.
const SLOW: f64 = 1e-3;
/// Part of the time between two rows that no step is shorter than.
const SHORTEST: f64 = 1e-14;
/// Part of the time between two rows that is tried first.
const FIRST: f64 = 1e-2;

/// Relative difference of two step sizes that have the same matrices.
const SAME: f64 = 1e-10;

/// Right-hand side `f(t, y)` of `y' = f(t, y)`. None: not defined or not finite there.
pub trait ImplicitProblem {
    /// The derivative.
    fn derivative(&mut self, t: f64, y: &DVector<f64>) -> Option<DVector<f64>>;

    /// Jacobian of the derivative, if the problem provides it. Otherwise differences are used.
    fn jacobian(&mut self, _t: f64, _y: &DVector<f64>) -> Option<DMatrix<f64>> {
        None
    }

    /// Receives an accepted step. Returns true if the integration shall stop there.
    fn accept(&mut self, _step: &CollocationStep) -> bool {
        false
    }

    /// Returns true if the integration shall stop after this row.
    fn is_last(&mut self, t: f64, row: &DVector<f64>) -> bool;
}

/// An accepted step with the solution inside it.
#[derive(Clone, Copy, Debug)]
pub struct CollocationStep<'a> {
    /// Time at its beginning.
    pub t: f64,
    /// Its size.
    pub size: f64,
    begin: &'a DVector<f64>,
    changes: &'a DMatrix<f64>,
}

impl CollocationStep<'_> {
    /// Nodes of the method as shares of the step; the last one is its end.
    pub fn nodes() -> &'static [f64] {
        &NODES
    }

    /// State at a node, by its position among [`Self::nodes`].
    ///
    /// # Panics
    /// If there is no such node.
    pub fn at_node(&self, node: usize) -> DVector<f64> {
        self.begin + self.changes.column(node)
    }

    /// State at a share of the step, from 0 to 1: the collocation polynomial, of order 7.
    pub fn at(&self, share: f64) -> DVector<f64> {
        self.begin + interpolated(self.changes, share)
    }
}

/// Step size, Jacobian, matrices and predictor that a step leaves to the next one. Valid as long as state and equations have no jump.
#[derive(Clone, Debug)]
pub struct RadauMemory {
    /// Size of the next step.
    step: f64,
    jacobian: DMatrix<f64>,
    /// True if Newton's method converged slowly in the last step.
    is_slow: bool,
    factors: Option<StageFactors>,
    last: Option<LastStep>,
    /// Remainder of Newton's method over its last change.
    remainder: f64,
}

/// States at `times`, from `initial` at the first of them; `tolerance` is relative and absolute.
///
/// At the last time the derivative is evaluated just before it: inputs may jump there.
pub fn advance(
    problem: &mut impl ImplicitProblem,
    initial: DVector<f64>,
    times: &[f64],
    tolerance: f64,
    budget: &Budget,
) -> IntegrationResult<DVector<f64>> {
    resume(problem, initial, times, tolerance, budget, &mut None)
}

/// States as by [`advance`], with the memory of an integration that ended in `initial`; it is replaced by that of this one.
pub fn resume(
    problem: &mut impl ImplicitProblem,
    initial: DVector<f64>,
    times: &[f64],
    tolerance: f64,
    budget: &Budget,
    memory: &mut Option<RadauMemory>,
) -> IntegrationResult<DVector<f64>> {
    let mut states = vec![initial.clone()];
    let known = memory.take().filter(|memory| memory.jacobian.nrows() == initial.len());
    let failure = match RadauRun::new(problem, initial, times, tolerance, budget, known) {
        None => Some(IntegrationFailure {
            message: "the derivative is not finite".into(),
            t: times.first().copied().unwrap_or_default(),
        }),
        Some(mut integration) => {
            let failure = integration.follow(times, &mut states).err();
            *memory = failure.is_none().then_some(integration.memory);
            failure
        }
    };
    states.truncate(times.len());
    IntegrationResult { states, failure, is_stiff: false, evaluations: 0 }
}

/// Jacobian of a function by differences at a point where its value is known; backward ones where it is not defined beyond.
pub fn jacobian(
    mut function: impl FnMut(&DVector<f64>) -> Option<DVector<f64>>,
    at: &DVector<f64>,
    value: &DVector<f64>,
) -> Option<DMatrix<f64>> {
    let (mut jacobian, mut point) = (DMatrix::zeros(value.len(), at.len()), at.clone());
    for column in 0..at.len() {
        let by = f64::EPSILON.sqrt() * (1.0 + at[column].abs());
        let difference = [by, -by].into_iter().find_map(|by| {
            point[column] = at[column] + by;
            let moved = function(&point);
            let step = point[column] - at[column];
            point[column] = at[column];
            moved.map(|moved| (moved - value) / step)
        })?;
        jacobian.set_column(column, &difference);
    }
    jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
}

/// Change since the beginning of a step at a share of it, by the collocation polynomial.
fn interpolated(changes: &DMatrix<f64>, at: f64) -> DVector<f64> {
    let mut change = DVector::zeros(changes.nrows());
    for (index, of_node) in NODES.iter().enumerate() {
        let others = NODES.iter().enumerate().filter(|(other, _)| *other != index);
        let weight = others.fold(at / of_node, |product, (_, other)| product * (at - other) / (of_node - other));
        change.axpy(weight, &changes.column(index), 1.0);
    }
    change
}

/// Matrices of Newton's method for a Jacobian and a step size, factorised.
#[derive(Clone, Debug)]
struct StageFactors {
    size: f64,
    real: LU<f64, Dyn, Dyn>,
    pairs: Vec<LU<Complex<f64>, Dyn, Dyn>>,
}

/// The last step that was made; its collocation polynomial predicts the next one.
#[derive(Clone, Debug)]
struct LastStep {
    size: f64,
    changes: DMatrix<f64>,
    error: f64,
}

struct RadauRun<'a, 'b, P> {
    problem: &'a mut P,
    budget: &'a Budget<'b>,
    tolerance: f64,
    /// Last time at which the derivative is evaluated.
    end: f64,
    t: f64,
    y: DVector<f64>,
    /// Derivative at the beginning of the step.
    slope: DVector<f64>,
    /// True if the Jacobian is that of the present state.
    is_fresh: bool,
    memory: RadauMemory,
}

impl<'a, 'b, P: ImplicitProblem> RadauRun<'a, 'b, P> {
    fn new(
        problem: &'a mut P,
        y: DVector<f64>,
        times: &[f64],
        tolerance: f64,
        budget: &'a Budget<'b>,
        memory: Option<RadauMemory>,
    ) -> Option<Self> {
        let &[t, next, ..] = times else { return None };
        let end = times[times.len() - 1];
        let n = y.len();
        let is_new = memory.is_none();
        let mut integration = Self {
            problem,
            budget,
            tolerance,
            end: end.next_down(),
            t,
            y,
            slope: DVector::zeros(n),
            is_fresh: false,
            memory: memory.unwrap_or_else(|| RadauMemory {
                step: first_step(next - t, budget),
                jacobian: DMatrix::zeros(n, n),
                is_slow: false,
                factors: None,
                last: None,
                remainder: 1.0,
            }),
        };
        integration.find_slope()?;
        if is_new || integration.memory.is_slow {
            integration.renew_jacobian()?;
        }
        Some(integration)
    }

    /// Appends the states at the times after the first one.
    fn follow(&mut self, times: &[f64], states: &mut Vec<DVector<f64>>) -> Result<(), IntegrationFailure> {
        let mut h = self.memory.step;
        for pair in times.windows(2) {
            let shortest = SHORTEST * (pair[1] - pair[0]);
            while self.t < pair[1] {
                let rest = pair[1] - self.t;
                // no sliver before the row
                let step = if h > 0.99 * rest { rest } else { h.min(0.5 * rest) };
                let begin = self.y.clone();
                let attempt = self.attempt(step);
                if self.budget.is_over() {
                    return Ok(());
                }
                match attempt {
                    Ok(factor) => {
                        let t = self.t;
                        self.t = if step == rest { pair[1] } else { t + step };
                        self.budget.arrive(self.t);
                        h = if step < h { h.max(step * factor) } else { step * factor };
                        self.memory.step = h;
                        if let Some(LastStep { changes, .. }) = &self.memory.last
                            && self.problem.accept(&CollocationStep { t, size: step, begin: &begin, changes })
                        {
                            return Ok(());
                        }
                        // beyond the last row a force may be undefined
                        if self.t < times[times.len() - 1] {
                            self.begin_step().ok_or_else(|| self.no_step())?;
                        }
                    }
                    Err(factor) => h = step * factor,
                }
                if h < shortest {
                    return Err(self.no_step());
                }
            }
            states.push(self.y.clone());
            if self.problem.is_last(self.t, &self.y) {
                return Ok(());
            }
        }
        Ok(())
    }

    fn no_step(&self) -> IntegrationFailure {
        let message = "no step of the implicit method is short enough for the tolerance".into();
        IntegrationFailure { message, t: self.t }
    }

    fn begin_step(&mut self) -> Option<()> {
        self.is_fresh = false;
        self.find_slope()?;
        if self.memory.is_slow { self.renew_jacobian() } else { Some(()) }
    }

    fn find_slope(&mut self) -> Option<()> {
        let y = self.y.clone();
        self.slope = self.derivative(self.t, &y)?;
        Some(())
    }

    fn derivative(&mut self, t: f64, y: &DVector<f64>) -> Option<DVector<f64>> {
        if !self.budget.spend() {
            return None;
        }
        let derivative = self.problem.derivative(t.min(self.end), y)?;
        derivative.iter().all(|value| value.is_finite()).then_some(derivative)
    }

    /// The Jacobian at the present state.
    fn renew_jacobian(&mut self) -> Option<()> {
        let (t, y, slope) = (self.t, self.y.clone(), self.slope.clone());
        let known = self.problem.jacobian(t.min(self.end), &y);
        self.memory.jacobian = match known.filter(|known| known.iter().all(|value| value.is_finite())) {
            Some(known) => known,
            None => jacobian(|y| self.derivative(t, y), &y, &slope)?,
        };
        self.is_fresh = true;
        self.memory.factors = None;
        Some(())
    }

    /// Makes a step of size `h`. Returns the factor of the next one: Ok if the step was made, Err if it must be repeated.
    fn attempt(&mut self, h: f64) -> Result<f64, f64> {
        let factors = self.memory.factors.take().filter(|factors| (factors.size - h).abs() <= SAME * h);
        let factors = factors.map(|factors| StageFactors { size: h, ..factors });
        let factors = factors.or_else(|| self.factorise(h)).ok_or(0.5)?;
        let changes = match self.solve(&factors) {
            Some(changes) => changes,
            None if self.is_fresh => return Err(0.25),
            // it may converge with the Jacobian of this state
            None => return self.renew_jacobian().map_or(Err(0.25), |()| Err(1.0)),
        };
        let error = self.error(&changes, &factors);
        if error.is_nan() || error > 1.0 {
            self.memory.factors = Some(factors);
            // the first step may be too long by far
            return Err(if self.memory.last.is_none() { 0.1 } else { step_factor(error).clamp(0.1, 0.9) });
        }
        let mut factor = step_factor(error);
        if let Some(last) = &self.memory.last {
            // Gustafsson's prediction
            factor = factor.min(factor * (h / last.size) * step_factor(error) / step_factor(last.error.max(1e-2)));
        }
        self.y += changes.column(STAGES - 1);
        self.memory.last = Some(LastStep { size: h, changes, error });
        self.memory.factors = Some(factors);
        let factor = factor.clamp(0.2, 8.0);
        // with the same size the factors serve again
        Ok(if (1.0..1.2).contains(&factor) { 1.0 } else { factor })
    }

    fn factorise(&self, h: f64) -> Option<StageFactors> {
        let real = self.shifted(GAMMA / h).lu();
        let mut pairs = Vec::with_capacity(PAIRS.len());
        for [re, im] in PAIRS {
            let mut matrix = self.shifted(re / h).map(|value| Complex::new(value, 0.0));
            (0..matrix.nrows()).for_each(|k| matrix[(k, k)].im += im / h);
            pairs.push(matrix.lu());
        }
        (real.is_invertible() && pairs.iter().all(LU::is_invertible)).then_some(StageFactors { size: h, real, pairs })
    }

    /// The matrix `shift I - J` with the Jacobian `J` of the equations.
    fn shifted(&self, shift: f64) -> DMatrix<f64> {
        let mut matrix = -self.memory.jacobian.clone();
        (0..matrix.nrows()).for_each(|k| matrix[(k, k)] += shift);
        matrix
    }

    /// Newton's method: the changes at the nodes, one a column. None if it does not converge.
    fn solve(&mut self, factors: &StageFactors) -> Option<DMatrix<f64>> {
        let (n, h) = (self.y.len(), factors.size);
        let mut changes = self.predicted(h);
        let mut slopes = DMatrix::zeros(n, STAGES);
        let weights = DMatrix::from_fn(STAGES, STAGES, |node, stage| h * WEIGHTS[stage][node]);
        let mut remainder = self.memory.remainder.max(1e-4).powf(0.8);
        let (mut before, mut rate) = (f64::INFINITY, 0.0f64);
        for iteration in 0..ITERATIONS {
            for (stage, node) in NODES.iter().enumerate() {
                let y = &self.y + changes.column(stage);
                slopes.set_column(stage, &self.derivative(self.t + node * h, &y)?);
            }
            let residual = &slopes * &weights - &changes;
            let step = self.corrected(&residual, factors)?;
            changes += &step;
            let norm = step.column_iter().map(|change| self.norm(&change.into_owned())).fold(0.0, f64::max);
            if !norm.is_finite() {
                return None;
            }
            if iteration > 0 {
                rate = norm / before;
                remainder = if rate < 1.0 { rate / (1.0 - rate) } else { f64::INFINITY };
            }
            if remainder * norm <= CONVERGED || norm == 0.0 || (rate > 0.1 && norm <= ROUNDED) {
                // where rounding decides the changes, the rate says nothing
                self.memory.is_slow = rate > SLOW && before > 1.0 / CONVERGED;
                self.memory.remainder = remainder.min(1.0);
                return Some(changes);
            }
            if rate >= 1.0 {
                return None;
            }
            before = norm;
        }
        None
    }

    /// Newton's correction for a residual `h A F - Z`.
    fn corrected(
        &self,
        residual: &DMatrix<f64>,
        StageFactors { size: h, real, pairs }: &StageFactors,
    ) -> Option<DMatrix<f64>> {
        let mut step = DMatrix::zeros(residual.nrows(), STAGES);
        let side = residual * DVector::from_column_slice(&REAL_ROW) * (GAMMA / h);
        let solution = real.solve(&side)?;
        for (stage, weight) in REAL_VECTOR.iter().enumerate() {
            step.column_mut(stage).axpy(*weight, &solution, 1.0);
        }
        for (pair, factors) in pairs.iter().enumerate() {
            let mut side = DVector::from_element(residual.nrows(), Complex::new(0.0, 0.0));
            for (column, weight) in residual.column_iter().zip(PAIR_ROWS[pair]) {
                let weight = complex(weight) * complex(PAIRS[pair]) / *h;
                side.zip_apply(&column, |sum, value| *sum += weight * value);
            }
            let solution = factors.solve(&side)?;
            for (mut column, weight) in step.column_iter_mut().zip(PAIR_VECTORS[pair]) {
                // of a pair of conjugates
                column.zip_apply(&solution, |sum, value| *sum += 2.0 * (complex(weight) * value).re);
            }
        }
        Some(step)
    }

    /// The changes that the collocation polynomial of the last step has at the nodes of a step of size `h`.
    fn predicted(&self, h: f64) -> DMatrix<f64> {
        let n = self.y.len();
        let Some(last) = &self.memory.last else { return DMatrix::zeros(n, STAGES) };
        let mut changes = DMatrix::zeros(n, STAGES);
        for (mut change, node) in changes.column_iter_mut().zip(NODES) {
            change.copy_from(
                &(interpolated(&last.changes, 1.0 + node * h / last.size) - last.changes.column(STAGES - 1)),
            );
        }
        changes
    }

    /// Estimate of the error of a step, relative to the tolerance.
    fn error(&mut self, changes: &DMatrix<f64>, StageFactors { size: h, real, .. }: &StageFactors) -> f64 {
        let of_changes = changes * DVector::from_column_slice(&ERROR) * (GAMMA / h);
        let Some(error) = real.solve(&(&self.slope + &of_changes)) else { return f64::NAN };
        let norm = self.norm(&error);
        if norm < 1.0 || self.memory.last.is_some() {
            return norm;
        }
        // a stiff transient is overestimated: once more, filtered
        let slope = self.derivative(self.t, &(&self.y + error));
        slope.and_then(|slope| real.solve(&(slope + &of_changes))).map_or(norm, |error| self.norm(&error))
    }

    /// Largest change of a state, relative to the tolerance.
    fn norm(&self, change: &DVector<f64>) -> f64 {
        worst(change.iter().zip(&self.y).map(|(change, y)| change.abs() / (self.tolerance * (1.0 + y.abs()))))
    }
}

/// Size of the first step of an integration, if the next time is at this distance; never more than the last step of the one before.
#[inline]
fn first_step(distance: f64, budget: &Budget) -> f64 {
    let step = FIRST * distance;
    if budget.last_step() > 0.0 { step.min(budget.last_step()) } else { step }
}

/// Factor between the size of a step with this error and the size that just meets the tolerance, with a margin.
#[inline]
fn step_factor(error: f64) -> f64 {
    0.9 * error.max(1e-16).powf(-1.0 / (STAGES + 1) as f64)
}

#[inline]
fn complex([re, im]: [f64; 2]) -> Complex<f64> {
    Complex::new(re, im)
}

#[cfg(test)]
mod tests;
