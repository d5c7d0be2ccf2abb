//! Surrogates with states, learned by structure: the functions of the configuration in a mechanism's equations of motion, as sums of
//! sines, cosines and powers.
//!
//! Configurations and parameters are sampled, and at each the [reduced equations](crate::multibody::reduced) give the labels: the
//! mass matrix, the potential, the damping of springs and the map of the efforts. One linear least-squares problem for all of them finds the
//! coefficients, another one those of forces in joints, drivers and springs that outputs show. Forces, actuators and prescribed
//! accelerations are efforts, which the equations have as formulas: velocities and inputs enter the equations exactly ([`Dynamics`]),
//! so neither is sampled and neither is extrapolated. A driver's acceleration stands in the place of the forces of its coordinate.
//!
//! Tree mechanisms of revolute and prismatic joints are such sums exactly. A closed loop is periodic in its crank's angle, and its
//! series converges geometrically: the order grows until unseen configurations agree, or the terms are too many.

mod assembly;
mod efforts;
mod equations;
pub mod identify;
mod labels;
mod least_squares;
mod mass_matrix;
mod outputs;
mod reactions;
mod state_space;
mod terms;
pub mod trajectory;
mod windings;

#[cfg(test)]
mod tests;

use crate::multibody::{Mechanism, MotionError};
pub use assembly::{Assembled, Assembly};
pub use equations::{Equations, EquationsWithParameters, ExactMotion};
use labels::{Label, MechanismRegion, RegionPoint};
pub use least_squares::DictionaryError;
pub use mass_matrix::{ENOUGH, FittedMassMatrix, MassMatrixProblem, acceleration_error};
use metafmu_runtime::{
    Dynamics, Reactions, Rows, Shown,
    dictionary::{Dictionary, Factor},
};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use reactions::Forces;
pub use state_space::{FittedFunctions, fit_functions};
use std::{
    f64::consts::{PI, TAU},
    ops::Range,
};
use terms::FactorSet;

/// Where the equations are learned.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Region {
    /// Independent coordinates by the measure that names each (`JOINT.angle`, `BODY.x`), one for each degree of freedom.
    pub coordinates: Vec<QuantityRange>,
    /// Parameters that vary; the others keep their defaults, unless they are among the constants.
    pub parameters: Vec<QuantityRange>,
    /// Names and values of parameters that are not those of the mechanism file.
    pub constants: Vec<(String, f64)>,
    /// Outputs of the mechanism that are learned as well.
    pub outputs: Vec<String>,
    /// Ranges of the velocities, and of the inputs and then the actuator states, in which accelerations are sampled.
    pub velocities: Vec<[f64; 2]>,
    /// Ranges of the inputs, then of the actuator states.
    pub inputs: Vec<[f64; 2]>,
}

/// A quantity and its range.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantityRange {
    /// As in the mechanism file.
    pub name: String,
    /// Lower end.
    pub min: f64,
    /// Upper end; an angle of a crank that goes around spans 2 pi.
    pub max: f64,
}

impl QuantityRange {
    /// A range of a quantity.
    pub fn new(name: &str, min: f64, max: f64) -> Self {
        Self { name: name.into(), min, max }
    }
}

/// Equations that were learned, and how well.
#[derive(Clone, Debug)]
pub struct FittedEquations {
    /// The equations: coordinates and parameters are in the order of the region, inputs in that of the mechanism file.
    pub dynamics: Dynamics,
    /// The positions that the outputs need, in whole turns `windings`, shape `[positions, coordinates]`, beside a dictionary.
    pub positions: Dictionary,
    /// Whole turns of the positions, shape `[positions, coordinates]`.
    pub windings: Vec<f64>,
    /// Forces of joints, drivers and springs, if there are any among the outputs.
    pub reactions: Option<FittedReactions>,
    /// Number of actuator states: the last inputs of the equations.
    pub actuator_states: usize,
    /// Quantity that each output of the region shows.
    pub outputs: Vec<Shown>,
    /// Highest harmonic of the angles, and highest power of the others.
    pub order: [usize; 2],
    /// Terms that were tried; those without any coefficient are not in the equations.
    pub terms: usize,
    /// Largest error of any function at configurations that were held out to choose the order, relative to the function's largest value; functions of the same kind
    /// (the mass matrix, the forces) are taken together.
    pub error: f64,
    /// Number of turns of each coordinate after which equations and efforts are the same; none if they never are.
    pub periods: Vec<Option<u32>>,
    /// Coordinates along which all functions of the mechanism are straight lines.
    pub straight: Vec<usize>,
}

/// Forces of joints and springs that were learned, and how well.
#[derive(Clone, Debug)]
pub struct FittedReactions {
    /// The forces.
    pub reactions: Reactions,
    /// Highest harmonic of the angles, and highest power of the others.
    pub order: [usize; 2],
    /// Largest error of any function at configurations that were held out, as that of [`FittedEquations`]; functions of
    /// the same part of a force are taken together.
    pub error: f64,
}

/// An error at which a higher order is not worth its cost: rounding begins to dominate.
const EXACT: f64 = 1e-12;

/// Number of terms that are tried at most: the equations' cost in an FMU, and the cube of it in the least-squares problem.
const MOST_TERMS: usize = 1000;

/// Configurations at which the error is measured.
const UNSEEN: usize = 200;

/// Configurations at which it is checked whether the equations can be learned.
const CHECKED: usize = 16;

/// Random configurations that are checked for singular positions.
const REACHED: usize = 300;

/// Corners of the ranges that are checked for them as well, at most.
const MOST_CORNERS: usize = 256;

/// Share of a coordinate's range at which functions are compared with those at its lower end.
const ELSEWHERE: f64 = 0.37;

/// Number of the [`CHECKED`] configurations at which the effect of each parameter and coordinate is checked.
const COMPARED: usize = 4;

/// Largest change of a function, relative to its largest value, that is rounding.
const UNCHANGED: f64 = 1e-9;

/// Highest harmonic and highest power to begin with.
const FIRST_ORDER: [usize; 2] = [2, 1];

/// Part of the error that a higher order must leave at most to be worth its terms.
const WORTH_IT: f64 = 0.7;

/// Learns the equations of motion of a mechanism.
///
/// # Errors
/// An error: what [`Mechanism::reduced`] says, a range is empty or its name unknown, a force is not a number, or a configuration of
/// the region cannot be reached.
pub fn fit(mechanism: &Mechanism, region: &Region, seed: u64) -> Result<FittedEquations, MotionError> {
    let labels = MechanismRegion::new(mechanism, region)?;
    let (factors, splines) = (labels.factors(), labels.splines()?);
    let mut unseen = OfEquations::default();
    unseen.extend(&labels, SampleDensity::Uniform, UNSEEN, seed ^ 1)?;
    let straight = straight_coordinates(&ColumnComparison::of(&labels, &unseen), &factors)?;
    let mut highest = vec![i16::MAX; factors.len()];
    straight.iter().for_each(|coordinate| highest[coordinate.column] = 1);
    let set = FactorSet { factors: &factors, splines: &splines, highest: &highest };
    let mut samples = OfEquations::default();
    // accelerations have derivatives of the functions, reactions do not
    let mut equations = raise_order((set, 1), (FIRST_ORDER, EXACT), |exponents| {
        samples.extend(&labels, SampleDensity::Uniform, rows(exponents), seed)?;
        let scales = labels.scales(samples.samples.labels.iter().chain(&unseen.samples.labels));
        let samples = samples.samples.first(rows(exponents));
        least_squares::solve(set, exponents, &samples, &unseen.samples, &scales).map_err(MotionError::from)
    })?;
    // no coordinate changes a uniform force, though functions that are no such sums may seem to
    equations.clear(labels.uniform(), |exponents| {
        let (of_columns, of_splines) = exponents.split_at(factors.len());
        of_columns[..labels.coordinates()].iter().chain(of_splines).any(|exponent| *exponent != 0)
    });
    straight.iter().for_each(|coordinate| equations.clear_along(coordinate.column, &coordinate.still));
    let counts = [labels.coordinates(), labels.efforts()];
    let has_reactions = !labels.outputs().reactions.is_empty();
    // what makes one of them hard to learn does so with both
    let first = equations.order;
    let reactions = has_reactions.then(|| {
        raise_order((set, 2), (first, EXACT), |exponents| {
            samples.extend(&labels, SampleDensity::Uniform, rows(exponents), seed)?;
            let [seen, unseen] = [samples.reactions(rows(exponents)), unseen.reactions(UNSEEN)];
            let sizes = samples.sizes;
            let scales = reactions::scales(counts, &sizes, seen.labels.iter().chain(&unseen.labels));
            least_squares::solve(set, exponents, &seen, &unseen, &scales).map_err(MotionError::from)
        })
    });
    let reactions = reactions.transpose()?;
    let (functions, of_equations) = (labels.functions(), labels.functions_of_equations());
    let [dynamics, positions] =
        [0..of_equations, of_equations..functions].map(|columns| equations.dictionary(set, columns));
    let [coordinates, efforts] = counts;
    let dynamics = Dynamics::with_efforts(labels.formulas()?, dynamics?);
    let dynamics = dynamics.and_then(|dynamics| dynamics.with_prescribed(labels.driven()));
    let dynamics = dynamics?;
    let reactions = reactions.map(|mut found| {
        straight.iter().for_each(|coordinate| found.clear_along(coordinate.column, &coordinate.still_reactions));
        let functions = found.dictionary(set, 0..found.coefficients.ncols())?;
        let reactions = Reactions::new(coordinates, efforts, functions)?;
        Ok::<_, MotionError>(FittedReactions { reactions, order: found.order, error: found.error })
    });
    Ok(FittedEquations {
        dynamics,
        positions: positions?,
        windings: labels.outputs().windings.0.clone(),
        reactions: reactions.transpose()?,
        actuator_states: labels.actuator_states(),
        outputs: labels.outputs().shown.clone(),
        order: equations.order,
        terms: equations.exponents.len(),
        error: equations.error,
        periods: labels.periods().to_vec(),
        straight: straight.iter().map(|coordinate| coordinate.column).collect(),
    })
}

/// Coefficients of the products of an order.
struct Solution {
    order: [usize; 2],
    exponents: Vec<Vec<i16>>,
    /// Shape `[products, functions]`.
    coefficients: DMatrix<f64>,
    error: f64,
}

impl Solution {
    /// Sets coefficients of some functions to zero, in some of the products.
    fn clear(&mut self, functions: Range<usize>, is_cleared: impl Fn(&[i16]) -> bool) {
        let products = self.exponents.iter().enumerate().filter(|(_, exponents)| is_cleared(exponents));
        for (product, _) in products {
            self.coefficients.row_mut(product).columns_range_mut(functions.clone()).fill(0.0);
        }
    }

    /// Sets coefficients of products with a column to zero in the functions that are `still` along it. They are rounding errors.
    fn clear_along(&mut self, column: usize, still: &[bool]) {
        for (function, _) in still.iter().enumerate().filter(|(_, still)| **still) {
            self.clear(function..function + 1, |exponents| exponents[column] != 0);
        }
    }

    /// Some of the functions.
    fn dictionary(&self, set: FactorSet, columns: Range<usize>) -> Result<Dictionary, DictionaryError> {
        least_squares::dictionary(set, &self.exponents, &self.coefficients, columns)
    }
}

/// Solves for coefficients of higher and higher orders, as long as that is worth it and the error is above `enough`.
/// Products have derivatives of splines up to the order `derivatives`.
fn raise_order<E: From<DictionaryError>>(
    (set, derivatives): (FactorSet, usize),
    (first, enough): ([usize; 2], f64),
    mut solve: impl FnMut(&[Vec<i16>]) -> Result<(DMatrix<f64>, f64), E>,
) -> Result<Solution, E> {
    let has_angles = set.factors.contains(&Factor::Angle);
    let has_powers = set.factors.iter().any(|factor| *factor != Factor::Angle);
    let mut tried: Vec<[usize; 2]> = Vec::new();
    let mut try_order = |[harmonics, powers]: [usize; 2]| {
        let order = [if has_angles { harmonics } else { first[0] }, if has_powers { powers } else { first[1] }];
        if tried.contains(&order) {
            return Ok(None);
        }
        tried.push(order);
        let exponents = terms::exponents_with_splines(set, order, derivatives);
        if exponents.len() > MOST_TERMS {
            return Ok(None);
        }
        solve(&exponents).map(|(coefficients, error)| Some(Solution { order, exponents, coefficients, error }))
    };
    let mut best = try_order(first)?.ok_or(DictionaryError::TooManyTerms(MOST_TERMS))?;
    while best.error > enough {
        let [harmonics, powers] = best.order;
        // what limits the error is not known; neither alone may lower it
        let higher = [[2 * harmonics, powers], [harmonics, powers + 1], [2 * harmonics, powers + 1]];
        let mut better = None;
        // an even function gains nothing from the next power
        for orders in [&higher[..], &[[harmonics, powers + 2]]] {
            let mut next: Option<Solution> = None;
            for order in orders {
                let found = try_order(*order)?;
                if let Some(found) = found
                    && next.as_ref().is_none_or(|next| found.error < WORTH_IT * next.error)
                {
                    next = Some(found);
                }
            }
            better = next.filter(|next| next.error < WORTH_IT * best.error);
            if better.is_some() {
                break;
            }
        }
        match better {
            Some(next) => best = next,
            None => break,
        }
    }
    Ok(best)
}

/// Properties of the equations, checked at a few configurations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checked {
    /// Parameters on which neither the equations nor the outputs depend.
    pub idle: Vec<String>,
    /// For each coordinate, true if it is an angle whose equations repeat after a turn or several.
    pub is_periodic: Vec<bool>,
    /// For each coordinate, true if equations, known forces or outputs depend on it.
    pub is_used: Vec<bool>,
}

/// Checks that the mechanism can be put together in random configurations of a region and, with `corners`, at its ends.
///
/// # Errors
/// An error with the first configuration that is singular, or as [`fit`].
pub fn reach(mechanism: &Mechanism, region: &Region, corners: bool, seed: u64) -> Result<(), MotionError> {
    let labels = MechanismRegion::new(mechanism, region)?;
    let ranges: Vec<&QuantityRange> = labels.ranges().collect();
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let mut points: Vec<RegionPoint> =
        (0..REACHED).map(|_| point_within(&ranges, |_| generator.random::<f64>())).collect();
    let all = 1usize.checked_shl(ranges.len() as u32).unwrap_or(0);
    if corners && (1..=MOST_CORNERS).contains(&all) {
        points.extend((0..all).map(|corner| point_within(&ranges, |k| f64::from(u8::from(corner >> k & 1 == 1)))));
    } else if corners {
        let corners =
            (0..MOST_CORNERS).map(|_| point_within(&ranges, |_| f64::from(u8::from(generator.random::<bool>()))));
        points.extend(corners);
    }
    let reached: Vec<Result<(), MotionError>> = points.par_iter().map(|point| labels.reach(point)).collect();
    reached.into_iter().collect()
}

/// The point at a share of each range.
fn point_within(ranges: &[&QuantityRange], mut share: impl FnMut(usize) -> f64) -> RegionPoint {
    let values = ranges.iter().enumerate().map(|(k, range)| range.min + share(k) * (range.max - range.min));
    values.collect()
}

/// Checks that the equations can be learned, by evaluating them at a few configurations.
///
/// # Errors
/// As [`fit`].
pub fn check(mechanism: &Mechanism, region: &Region, seed: u64) -> Result<Checked, MotionError> {
    let labels = MechanismRegion::new(mechanism, region)?;
    let mut samples = OfEquations::default();
    samples.extend(&labels, SampleDensity::Uniform, CHECKED, seed)?;
    let comparison = ColumnComparison::of(&labels, &samples);
    let (mut idle, mut is_used) = (Vec::new(), Vec::new());
    for (index, parameter) in region.parameters.iter().enumerate().filter(|(index, _)| !labels.occurs(*index)) {
        if !comparison.changes(labels.coordinates() + index, [parameter.min, parameter.max], UNCHANGED)?.contains(&true)
        {
            idle.push(parameter.name.clone());
        }
    }
    for (k, range) in region.coordinates.iter().enumerate() {
        is_used.push(labels.is_in_formula(k) || comparison.is_limited_along(k, range)?);
    }
    Ok(Checked { idle, is_periodic: labels.periods().iter().map(Option::is_some).collect(), is_used })
}

/// Functions of a region at values of one column, elsewhere at some of its configurations.
struct ColumnComparison<'a> {
    labels: &'a MechanismRegion<'a>,
    points: Rows,
    /// Largest magnitudes of the functions, with those of joints and springs.
    scales: Vec<f64>,
}

impl<'a> ColumnComparison<'a> {
    fn of(labels: &'a MechanismRegion<'a>, samples: &'a OfEquations) -> Self {
        let mut scales = labels.scales(samples.samples.labels.iter());
        let counts = [labels.coordinates(), labels.efforts()];
        scales.extend(reactions::scales(counts, &samples.sizes, samples.reactions.iter()));
        Self { labels, points: samples.samples.first(COMPARED).points, scales }
    }

    fn at(&self, point: &[f64], column: usize, value: f64) -> Result<Vec<f64>, MotionError> {
        let mut point = point.to_vec();
        point[column] = value;
        self.labels.at(&point).map(|label| [label.functions, label.reactions.functions].concat())
    }

    /// For each function, true if it differs between two values of a column by more than a part of its largest value.
    fn changes(&self, column: usize, [low, high]: [f64; 2], part: f64) -> Result<Vec<bool>, MotionError> {
        let mut changes = vec![false; self.scales.len()];
        for point in &self.points {
            let ends = self.at(point, column, low)?.into_iter().zip(self.at(point, column, high)?);
            for ((changes, (low, high)), scale) in changes.iter_mut().zip(ends).zip(&self.scales) {
                *changes |= (high - low).abs() > part * scale;
            }
        }
        Ok(changes)
    }

    /// For each function, true if it is no straight line along a coordinate, or cannot be evaluated all along its range.
    fn bends(&self, column: usize, QuantityRange { min, max, .. }: &QuantityRange) -> Vec<bool> {
        let mut bends = vec![false; self.scales.len()];
        let between = min + ELSEWHERE * (max - min);
        for point in &self.points {
            let [Ok(low), Ok(middle), Ok(high)] = [*min, between, *max].map(|value| self.at(point, column, value))
            else {
                return vec![true; self.scales.len()];
            };
            for (function, bends) in bends.iter_mut().enumerate() {
                let straight = low[function] + ELSEWHERE * (high[function] - low[function]);
                *bends |= (middle[function] - straight).abs() > UNCHANGED * self.scales[function];
            }
        }
        bends
    }

    /// Returns true if functions are known in a range of a coordinate only: they depend on it, and are no positions that are straight lines and
    /// enter no formula.
    fn is_limited_along(&self, coordinate: usize, range: &QuantityRange) -> Result<bool, MotionError> {
        // a function of an angle is the same at both ends of a turn
        let elsewhere = range.min + ELSEWHERE * (range.max - range.min);
        let changes = self.changes(coordinate, [range.min, elsewhere], UNCHANGED)?;
        if !changes.contains(&true) {
            return Ok(false);
        }
        let free = self.labels.free_positions();
        let bends = self.bends(coordinate, range);
        // reactions come after the flags, and none of them is free
        let free = free.into_iter().chain(std::iter::repeat(false));
        Ok(changes.into_iter().zip(bends).zip(free).any(|((changes, bends), is_free)| changes && (bends || !is_free)))
    }
}

/// Largest change of a function, relative to its largest value, that rounding makes of one that does not change.
const STILL: f64 = 1e-11;

/// A coordinate along which all functions are straight lines. What was learned holds beyond its range, where higher powers, of rounding errors, would
/// grow without limit.
struct StraightCoordinate {
    column: usize,
    /// Flags of the functions of the equations, and of the reactions: they do not change along it at all.
    still: Vec<bool>,
    still_reactions: Vec<bool>,
}

impl StraightCoordinate {
    /// The coordinate in a column, if all functions are straight lines along it.
    fn find(comparison: &ColumnComparison, column: usize, range: &QuantityRange) -> Result<Option<Self>, MotionError> {
        if comparison.bends(column, range).contains(&true) {
            return Ok(None);
        }
        let changes = comparison.changes(column, [range.min, range.max], STILL)?;
        let mut still: Vec<bool> = changes.into_iter().map(|changes| !changes).collect();
        let still_reactions = still.split_off(comparison.labels.functions());
        Ok(Some(Self { column, still, still_reactions }))
    }
}

/// All coordinates along which all functions are straight lines.
fn straight_coordinates(
    comparison: &ColumnComparison,
    factors: &[Factor],
) -> Result<Vec<StraightCoordinate>, MotionError> {
    let coordinates = comparison.labels.ranges().take(comparison.labels.coordinates()).enumerate();
    let powers = coordinates.filter(|(column, _)| factors[*column] != Factor::Angle);
    let found = powers.map(|(column, range)| StraightCoordinate::find(comparison, column, range));
    found.filter_map(Result::transpose).collect()
}

/// Number of configurations that determine these terms.
fn rows(exponents: &[Vec<i16>]) -> usize {
    3 * exponents.len() + 50
}

/// Points and the labels there.
#[derive(Clone, Debug, Default)]
pub struct EquationSamples {
    /// A value for each column.
    pub points: Rows,
    /// A value for each function.
    pub labels: Rows,
}

/// Samples of the equations of motion: configurations and the functions there.
#[derive(Clone, Debug, Default)]
pub struct OfEquations {
    /// Configurations `(q, p)`, and the functions of [`Dynamics`], then the positions.
    pub samples: EquationSamples,
    /// Derivatives of the functions with respect to the coordinates, where they are known: shape `[functions, coordinates]` each.
    pub gradients: Rows,
    /// Functions of the forces of joints and springs.
    reactions: Rows,
    /// Largest force anywhere in the mechanism, part by part.
    sizes: [f64; reactions::PARTS],
}

impl EquationSamples {
    /// The first ones.
    pub fn first(&self, count: usize) -> Self {
        self.part(0..count.min(self.points.len()))
    }

    /// Some of the samples.
    #[must_use]
    pub fn part(&self, range: Range<usize>) -> Self {
        Self { points: self.points.part(range.clone()), labels: self.labels.part(range) }
    }

    /// Standard deviation of each function over the points, above zero.
    pub fn standard_deviations(&self) -> Vec<f64> {
        (0..self.labels.width()).map(|function| self.standard_deviation(function)).collect()
    }

    fn standard_deviation(&self, function: usize) -> f64 {
        let count = self.labels.len().max(1) as f64;
        let mean = self.labels.column(function).sum::<f64>() / count;
        let variance = self.labels.column(function).map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        variance.sqrt().max(f64::MIN_POSITIVE)
    }
}

/// SampleDensity of random configurations in the range of a coordinate or parameter.
#[derive(Clone, Copy)]
enum SampleDensity {
    /// SampleDensity that is the same everywhere.
    Uniform,
    /// SampleDensity of Chebyshev's nodes, `1/(pi sqrt(1 - x^2))` over a range of ±1: what a network learns from them has errors of about the same
    /// size everywhere, while from uniform samples its errors are largest at the ends. An angle that turns around has no ends.
    Ends,
}

impl SampleDensity {
    /// The value that has this share of the random values below it.
    fn value(self, range: &QuantityRange, factor: Factor, share: f64) -> f64 {
        let width = range.max - range.min;
        let turns_around = matches!(factor, Factor::Angle) && width >= TAU;
        let share = match self {
            Self::Ends if !turns_around => 0.5 - 0.5 * (PI * share).cos(),
            Self::Ends | Self::Uniform => share,
        };
        range.min + share * width
    }
}

impl OfEquations {
    /// Some of the samples.
    #[must_use]
    pub fn part(&self, range: Range<usize>) -> Self {
        Self {
            samples: self.samples.part(range.clone()),
            gradients: self.gradients.part(range.clone()),
            reactions: self.reactions.part(range),
            sizes: self.sizes,
        }
    }

    /// The first samples of the forces of joints and springs.
    fn reactions(&self, count: usize) -> EquationSamples {
        let range = 0..count.min(self.samples.points.len());
        EquationSamples { points: self.samples.points.part(range.clone()), labels: self.reactions.part(range) }
    }

    /// Adds points until there are `count`, the same ones for the same seed.
    fn extend(
        &mut self,
        labels: &MechanismRegion,
        density: SampleDensity,
        count: usize,
        seed: u64,
    ) -> Result<(), MotionError> {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let factors = labels.factors();
        let points = (0..count).map(|_| {
            let shares = factors.iter().map(|_| generator.random::<f64>()).collect::<Vec<_>>();
            let values = labels.ranges().zip(&factors).zip(shares);
            values.map(|((range, factor), share)| density.value(range, *factor, share)).collect()
        });
        let points: Vec<RegionPoint> = points.skip(self.samples.points.len()).collect();
        let found: Vec<Label> = points.par_iter().map(|point| labels.at(point)).collect::<Result<_, _>>()?;
        for label in found {
            self.samples.labels.push(&label.functions);
            self.gradients.push(&label.gradients);
            let Forces { functions, sizes } = label.reactions;
            self.reactions.push(&functions);
            self.sizes.iter_mut().zip(sizes).for_each(|(largest, size)| *largest = size.max(*largest));
        }
        self.samples.points.extend(points);
        Ok(())
    }
}
