//! The equations of motion at sampled states: what networks learn from, and what candidates are compared by.

use super::{
    EquationSamples, FIRST_ORDER, OfEquations, Region, SampleDensity, UNCHANGED,
    labels::MechanismRegion,
    least_squares::{self, DictionaryError},
    terms,
};
use crate::multibody::{Mechanism, MotionCause, MotionError, measure::Measure, reduced::Reduced};
use metafmu_runtime::{
    Rows, Shown,
    dictionary::{Dictionary, Factor},
};
use nalgebra::DVector;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;

/// The equations of motion of a mechanism in a region.
pub struct Equations<'a> {
    labels: MechanismRegion<'a>,
    region: &'a Region,
}

/// The equations with values of the parameters, which follow a motion: each configuration is found from the one before.
pub struct EquationsWithParameters<'e> {
    reduced: Reduced,
    /// Forces of joints, drivers and springs that outputs show.
    measures: &'e [Measure],
}

/// Accelerations and forces that follow from a state and the inputs.
pub struct ExactMotion {
    /// Accelerations of the coordinates.
    pub accelerations: Vec<f64>,
    /// Forces of joints, drivers and springs, by their positions in [`Shown::Reaction`].
    pub reactions: Vec<f64>,
}

/// Number of configurations at which the effect of a column is checked.
const COMPARED: usize = 12;

/// Function of a state with inputs: shape `[columns]` to `[functions]`.
type StateFunction<'f> = dyn Fn(&[f64]) -> Result<Vec<f64>, MotionError> + Sync + 'f;

impl<'a> Equations<'a> {
    /// The equations in a region with ranges of velocities and inputs.
    ///
    /// # Errors
    /// As [`fit`](super::fit).
    pub fn new(mechanism: &'a Mechanism, region: &'a Region) -> Result<Self, MotionError> {
        let labels = MechanismRegion::new(mechanism, region)?;
        let (found, expected) =
            ([region.velocities.len(), region.inputs.len()], [labels.coordinates(), labels.inputs()]);
        if found != expected {
            let message = format!("ranges of {found:?} velocities and inputs, expected {expected:?}");
            return Err(MotionError::new(MotionCause::Unsuitable, message));
        }
        Ok(Self { labels, region })
    }

    /// The factor of each coordinate and parameter in a dictionary.
    pub fn factors(&self) -> Vec<Factor> {
        self.labels.factors()
    }

    /// Coordinates whose accelerations are prescribed.
    pub fn prescribed(&self) -> &[usize] {
        self.labels.driven()
    }

    /// Functions of the equations, and of the positions.
    pub fn counts(&self) -> [usize; 2] {
        let of_equations = self.labels.functions_of_equations();
        [of_equations, self.labels.functions() - of_equations]
    }

    /// The functions in random configurations, with more of them at the ends of ranges.
    ///
    /// # Errors
    /// As [`fit`](super::fit).
    pub fn functions(&self, count: usize, seed: u64) -> Result<OfEquations, MotionError> {
        let mut samples = OfEquations::default();
        samples.extend(&self.labels, SampleDensity::Ends, count, seed)?;
        Ok(samples)
    }

    /// For each function, true if its derivatives with respect to the coordinates are known.
    pub fn known(&self) -> Vec<bool> {
        self.labels.known()
    }

    /// Coordinate scales that make derivatives comparable in size to the functions: a radian, or half of the range.
    pub fn units(&self) -> Vec<f64> {
        let units = self.labels.factors().into_iter().take(self.labels.coordinates()).map(|factor| match factor {
            Factor::Angle => 1.0,
            Factor::Power { half, .. } => half,
        });
        units.collect()
    }

    /// Largest magnitudes of the functions in these samples, shared by those of a kind.
    pub fn scales(&self, samples: &EquationSamples) -> Vec<f64> {
        self.labels.scales(samples.labels.iter())
    }

    /// Dictionaries of the lowest order, of the equations and of the positions, for networks that learn the rest: what higher orders
    /// leave over oscillates. They have the columns only that change something.
    ///
    /// # Errors
    /// [`DictionaryError`](super::DictionaryError): the samples do not determine the coefficients.
    pub fn lowest(
        &self,
        [samples, unseen]: [&EquationSamples; 2],
        dependencies: &[Vec<bool>; 2],
    ) -> Result<[Dictionary; 2], DictionaryError> {
        let (factors, scales, [of_equations, _]) = (self.factors(), self.scales(samples), self.counts());
        let ranges = [0..of_equations, of_equations..scales.len()];
        let [of_equations, of_positions] = [0, 1].map(|kind| -> Result<Dictionary, DictionaryError> {
            let (range, depends) = (&ranges[kind], &dependencies[kind]);
            let functions: Vec<usize> = range.clone().collect();
            let [samples, unseen] = [samples, unseen].map(|samples| EquationSamples {
                points: samples.points.clone(),
                labels: samples.labels.select(&functions),
            });
            let mut exponents = terms::exponents(&factors, FIRST_ORDER);
            exponents.retain(|exponents| terms::uses_only(exponents, depends));
            let scales = &scales[range.clone()];
            let set = factors[..].into();
            let (coefficients, _) = least_squares::solve(set, &exponents, &samples, &unseen, scales)?;
            least_squares::dictionary(set, &exponents, &coefficients, 0..scales.len())
        });
        Ok([of_equations?, of_positions?])
    }

    /// The accelerations in random states `(q, p, v, u)`.
    ///
    /// # Errors
    /// As [`fit`](super::fit).
    pub fn accelerations(&self, count: usize, seed: u64) -> Result<EquationSamples, MotionError> {
        self.ask(count, seed, &|point| self.accelerations_at(point))
    }

    /// For each coordinate and parameter, true for the functions that it changes: shape `[columns, functions]`.
    ///
    /// # Errors
    /// As [`fit`](super::fit).
    pub fn dependencies(&self, samples: &EquationSamples) -> Result<Vec<Vec<bool>>, MotionError> {
        dependencies(samples, &|point| Ok(self.labels.at(point)?.functions), &self.scales(samples))
    }

    /// For each of `(q, p, v, u)`, true if it changes the accelerations.
    ///
    /// # Errors
    /// As [`fit`](super::fit).
    pub fn dependencies_of_accelerations(&self, samples: &EquationSamples) -> Result<Vec<bool>, MotionError> {
        self.dependencies_in_states(samples, &|point| self.accelerations_at(point))
    }

    fn dependencies_in_states(
        &self,
        samples: &EquationSamples,
        function: &StateFunction,
    ) -> Result<Vec<bool>, MotionError> {
        let magnitudes = samples.labels.values().iter().map(|value| value.abs());
        let largest = magnitudes.fold(f64::MIN_POSITIVE, f64::max);
        let scales = vec![largest; self.labels.coordinates()];
        let changes = dependencies(samples, function, &scales)?;
        Ok(changes.iter().map(|changed| changed.contains(&true)).collect())
    }

    /// The accelerations in a state `(q, p, v, u)`.
    ///
    /// # Errors
    /// An error if the configuration cannot be reached.
    pub fn accelerations_at(&self, point: &[f64]) -> Result<Vec<f64>, MotionError> {
        let (configuration, v, u) = self.parts(point);
        self.labels.configured(configuration)?.accelerations(v, u)
    }

    /// With values of the region's parameters.
    ///
    /// # Errors
    /// An error: what [`Mechanism::reduced`] says.
    pub fn with(&self, parameters: &[f64]) -> Result<EquationsWithParameters<'_>, MotionError> {
        let point: Vec<f64> =
            std::iter::repeat_n(0.0, self.labels.coordinates()).chain(parameters.iter().copied()).collect();
        Ok(EquationsWithParameters {
            reduced: self.labels.reduced(&point)?,
            measures: &self.labels.outputs().reactions,
        })
    }

    /// Quantity that each output shows.
    pub fn shown(&self) -> &[Shown] {
        &self.labels.outputs().shown
    }

    /// `(q, p)`, `v` and `u`.
    fn parts<'p>(&self, point: &'p [f64]) -> (&'p [f64], &'p [f64], &'p [f64]) {
        let (configuration, rest) = point.split_at(self.labels.ranges().count());
        let (v, u) = rest.split_at(self.labels.coordinates());
        (configuration, v, u)
    }

    fn ask(&self, count: usize, seed: u64, function: &StateFunction) -> Result<EquationSamples, MotionError> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let points: Rows = (0..count).map(|number| self.state(number % 2 == 0, &mut random)).collect();
        let labels = (0..count).into_par_iter().map(|number| function(&points[number]));
        let labels = labels.collect::<Result<Vec<_>, _>>()?.into_iter().collect();
        Ok(EquationSamples { points, labels })
    }

    /// A random state `(q, p, v, u)`; one `near_rest` has small velocities more often: there friction changes fastest.
    fn state(&self, near_rest: bool, random: &mut ChaCha8Rng) -> Vec<f64> {
        let mut state: Vec<f64> = self.labels.ranges().map(|range| uniform(random, [range.min, range.max])).collect();
        for &[min, max] in &self.region.velocities {
            let share = uniform(random, [-1.0, 1.0]);
            let share = if near_rest { share.powi(3) } else { share };
            state.push(0.5 * (min + max) + 0.5 * share * (max - min));
        }
        state.extend(self.region.inputs.iter().map(|range| uniform(random, *range)));
        state
    }
}

/// A random number in a range.
fn uniform(random: &mut ChaCha8Rng, [min, max]: [f64; 2]) -> f64 {
    min + random.random::<f64>() * (max - min)
}

impl EquationsWithParameters<'_> {
    /// Accelerations and forces in a state with velocities `v` and inputs `u`.
    ///
    /// # Errors
    /// An error if the configuration cannot be reached.
    pub fn motion(&self, q: &[f64], v: &[f64], u: &[f64]) -> Result<ExactMotion, MotionError> {
        let [q, v] = [q, v].map(DVector::from_column_slice);
        let terms = self.reduced.terms(&q)?;
        let accelerations = self.reduced.accelerations(&terms, &v, u)?;
        let sample = self.reduced.sample(&terms, &v, &accelerations, u)?;
        let reactions = self.measures.iter().map(|measure| measure.value(self.reduced.model(), &sample));
        Ok(ExactMotion { reactions: reactions.collect(), accelerations: accelerations.iter().copied().collect() })
    }
}

/// Which functions change with each column: shape `[columns, functions]`.
fn dependencies(
    samples: &EquationSamples,
    function: &StateFunction,
    scales: &[f64],
) -> Result<Vec<Vec<bool>>, MotionError> {
    let columns = samples.points.width();
    let points = samples.points.iter().zip(&samples.labels).zip(samples.points.iter().skip(1)).take(COMPARED);
    let points: Vec<_> = points.collect();
    let changes = (0..columns).into_par_iter().map(|column| {
        let mut changed = vec![false; scales.len()];
        for ((point, label), other) in &points {
            let mut moved = point.to_vec();
            moved[column] = other[column];
            let functions = function(&moved)?;
            for (changed, ((before, after), scale)) in changed.iter_mut().zip(label.iter().zip(&functions).zip(scales))
            {
                *changed |= (after - before).abs() > UNCHANGED * scale;
            }
        }
        Ok(changed)
    });
    changes.collect()
}
