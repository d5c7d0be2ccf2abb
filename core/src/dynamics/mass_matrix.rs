//! Equations of motion from samples of the mass matrix and of the accelerations, of programs that evaluate both.
//!
//! With the mass matrix `M` and the accelerations `vd`, the generalized forces `f = M vd` are known at any state. The forces at rest, their
//! changes with each input and with each velocity give `F`, `B` and `D` of [`Dynamics`]; forces quadratic in velocities follow from `M`.

use super::{
    EquationSamples, FIRST_ORDER,
    least_squares::{self, DictionaryError},
    raise_order, rows,
    terms::FactorSet,
};
use crate::worst::worst;
use metafmu_runtime::{
    Dynamics, StatePoint,
    dictionary::{Dictionary, Factor},
};

/// Sizes of the equations, and what forces are measured by.
#[derive(Clone, Debug)]
pub struct MassMatrixProblem<'a> {
    /// Factor of each coordinate, then of each parameter.
    pub factors: &'a [Factor],
    /// Flag of each of them: true if it changes a function. No product has a factor that changes none.
    pub used: &'a [bool],
    /// Largest velocity of each coordinate.
    pub velocities: &'a [f64],
    /// Largest magnitude of each input.
    pub inputs: &'a [f64],
    /// Number of functions of the configuration after those of the equations.
    pub positions: usize,
}

/// Equations that were found, and how well.
#[derive(Clone, Debug)]
pub struct FittedMassMatrix {
    /// The equations, whose efforts are the inputs.
    pub dynamics: Dynamics,
    /// Functions of the configuration.
    pub positions: Dictionary,
    /// Highest harmonic of the angles, and highest power of the others.
    pub order: [usize; 2],
    /// Number of configurations.
    pub rows: usize,
    /// Largest error of any function at unseen configurations, relative to the largest value of its kind.
    pub error: f64,
}

/// An error that is small beside those of runs: equations of a higher order take longer in every step.
pub const ENOUGH: f64 = 1e-5;

/// Configurations at which the error is measured.
const UNSEEN: usize = 200;

impl MassMatrixProblem<'_> {
    /// Number of functions: those of [`Dynamics`], then the positions.
    pub fn functions(&self) -> usize {
        Dynamics::functions(self.velocities.len(), self.inputs.len()) + self.positions
    }

    /// Finds the functions. `sample` evaluates them at this number of configurations; with `true` at others, which are not learned from.
    ///
    /// # Errors
    /// Those of `sample`; a sentence if there are too many coordinates and parameters.
    pub fn fit<E: From<DictionaryError>>(
        &self,
        mut sample: impl FnMut(usize, bool) -> Result<EquationSamples, E>,
    ) -> Result<FittedMassMatrix, E> {
        let set = FactorSet::from(self.factors);
        let unseen = sample(UNSEEN, true)?;
        let mut samples = EquationSamples::default();
        let solution = raise_order((set, 1), (FIRST_ORDER, ENOUGH), |exponents| {
            let count = rows(exponents);
            if samples.points.len() < count {
                samples = sample(count, false)?;
            }
            let scales = self.scales(samples.labels.iter().chain(&unseen.labels));
            let solved =
                least_squares::solve_with((set, self.used), exponents, &samples.first(count), &unseen, &scales);
            solved.map_err(E::from)
        })?;
        let (all, of_equations) = (self.functions(), self.functions() - self.positions);
        let dynamics = solution.dictionary(set, 0..of_equations)?;
        let dynamics = Dynamics::new(self.velocities.len(), self.inputs.len(), dynamics);
        Ok(FittedMassMatrix {
            dynamics: dynamics.map_err(DictionaryError::Format)?,
            positions: solution.dictionary(set, of_equations..all)?,
            order: solution.order,
            rows: rows(&solution.exponents),
            error: solution.error,
        })
    }

    /// Largest magnitude of each function. The mass matrix shares one; forces are measured by the largest one of their coordinate.
    fn scales<'l>(&self, labels: impl Iterator<Item = &'l [f64]>) -> Vec<f64> {
        let mut largest = vec![0.0f64; self.functions()];
        for label in labels {
            largest.iter_mut().zip(label).for_each(|(largest, value)| *largest = largest.max(value.abs()));
        }
        let (n, e) = (self.velocities.len(), self.inputs.len());
        let (masses, rest) = largest.split_at_mut(n * (n + 1) / 2);
        let mass = or_one(masses.iter().copied().fold(0.0, f64::max));
        masses.fill(mass);
        let (potential, rest) = rest.split_at_mut(1);
        potential.fill(1.0);
        let (forces, rest) = rest.split_at_mut(n);
        let (damping, rest) = rest.split_at_mut(n * n);
        let (of_inputs, positions) = rest.split_at_mut(n * e);
        for row in 0..n {
            let (damping, of_inputs) = (&mut damping[row * n..][..n], &mut of_inputs[row * e..][..e]);
            let by_velocity = damping.iter().zip(self.velocities).map(|(force, v)| force * v);
            let by_input = of_inputs.iter().zip(self.inputs).map(|(force, u)| force * u);
            let force = or_one(by_velocity.chain(by_input).fold(forces[row], f64::max));
            forces[row] = force;
            damping.iter_mut().zip(self.velocities).for_each(|(scale, v)| *scale = force / or_one(*v));
            of_inputs.iter_mut().zip(self.inputs).for_each(|(scale, u)| *scale = force / or_one(*u));
        }
        // of a position that is constant rounding may be left
        let longest = or_one(positions.iter().copied().fold(0.0, f64::max));
        positions.iter_mut().filter(|scale| **scale < 1e-9 * longest).for_each(|scale| *scale = longest);
        largest
    }
}

/// Root mean square error of accelerations at points `(q, p, v, u)`, relative to the standard deviation of the exact ones, of the worst
/// coordinate.
pub fn acceleration_error(dynamics: &Dynamics, exact: &EquationSamples) -> f64 {
    let (n, mut scratch) = (dynamics.coordinates(), dynamics.scratch());
    let configuration = n + dynamics.parameters();
    let count = exact.points.len().max(1) as f64;
    let (mut squares, mut found) = (vec![0.0; n], vec![0.0; n]);
    for (point, label) in exact.points.iter().zip(&exact.labels) {
        let ((q, p), (v, u)) = (point[..configuration].split_at(n), point[configuration..].split_at(n));
        dynamics.accelerations(StatePoint { q, v, u, p }, &mut found, &mut scratch);
        squares.iter_mut().zip(found.iter().zip(label)).for_each(|(sum, (a, b))| *sum += (a - b) * (a - b));
    }
    let deviations = exact.standard_deviations();
    worst(squares.iter().zip(deviations).map(|(sum, deviation)| (sum / count).sqrt() / deviation))
}

/// A scale, or 1 for what is zero everywhere.
fn or_one(scale: f64) -> f64 {
    if scale > 0.0 { scale } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::Rows;
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    /// A cart with a pendulum of length `l`: `M = [3, l cos; l cos, l²]`, gravity, a damper at the cart, a force on it.
    fn label(point: &[f64]) -> Vec<f64> {
        let [_, angle, l] = [point[0], point[1], point[2]];
        let (sine, cosine) = angle.sin_cos();
        let mass = [3.0, l * cosine, l * l];
        let forces = [0.0, -9.81 * l * sine];
        [&mass[..], &[0.0], &forces, &[0.4, 0.0, 0.0, 0.0], &[1.0, 0.0], &[point[0] + l * sine]].concat()
    }

    #[test]
    fn a_cart_with_a_pendulum_is_exact() {
        let power = |middle: f64, half: f64| Factor::Power { middle, half };
        let factors = [power(0.0, 1.0), Factor::Angle, power(0.75, 0.25)];
        let problem = MassMatrixProblem {
            factors: &factors,
            used: &[true; 3],
            velocities: &[2.0, 5.0],
            inputs: &[10.0],
            positions: 1,
        };
        let fitted = problem.fit(|count, is_unseen| {
            let mut random = ChaCha8Rng::seed_from_u64(u64::from(is_unseen));
            let mut point = || {
                let mut within = |min: f64, max: f64| min + (max - min) * random.random::<f64>();
                vec![within(-1.0, 1.0), within(-3.0, 3.0), within(0.5, 1.0)]
            };
            let points: Rows = (0..count).map(|_| point()).collect();
            Ok::<_, DictionaryError>(EquationSamples { labels: points.iter().map(label).collect(), points })
        });
        let fitted = fitted.unwrap();
        assert!(fitted.error < 1e-12, "{fitted:?}");
        // with the centrifugal force, which no sample has
        let (q, v, u, p) = ([0.3, 0.7], [1.0, -2.0], [5.0], [0.8]);
        let mut found = [0.0; 2];
        fitted.dynamics.accelerations(
            StatePoint { q: &q, v: &v, u: &u, p: &p },
            &mut found,
            &mut fitted.dynamics.scratch(),
        );
        let (sine, cosine) = q[1].sin_cos();
        let side = [5.0 - 0.4 * v[0] + p[0] * sine * v[1] * v[1], -9.81 * p[0] * sine];
        let determinant = 3.0 * p[0] * p[0] - (p[0] * cosine).powi(2);
        let expected = [
            (side[0] * p[0] * p[0] - p[0] * cosine * side[1]) / determinant,
            (3.0 * side[1] - p[0] * cosine * side[0]) / determinant,
        ];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-11, "{found} {expected}");
        }
    }
}
