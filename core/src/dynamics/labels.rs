//! Equations of motion of a mechanism in a configuration.

use super::{
    QuantityRange, Region, UNCHANGED,
    efforts::KnownEfforts,
    outputs::Outputs,
    reactions::{self, Forces},
    windings::Windings,
};
use crate::diagnostics::numbers::{from_to, number};
use crate::multibody::{
    Mechanism, MotionCause, MotionError,
    constraint::{Slot, Target},
    coordinate::Coordinate,
    reduced::{Reduced, Terms},
};
use metafmu_runtime::{
    Dynamics, Efforts,
    dictionary::{Factor, SplineFactor},
    formula::{FormulaStep, LookupTable},
};
use nalgebra::DVector;
use std::{borrow::Cow, f64::consts::TAU, ops::Range, sync::Arc};

/// Point of a region: coordinates, then parameters.
pub(super) type RegionPoint = Vec<f64>;

/// A length that is one: less is rounding, in m.
const SHORTEST: f64 = 1e-9;

/// Where in their ranges parameters are when it is seen whether positions repeat: not in the middle, where whole numbers may be.
const ASIDE: f64 = 0.37;

/// Largest change of a potential, relative to its value, that is rounding.
const ROUNDING: f64 = 1e-12;

/// Where in its range, or in a turn, a coordinate is when it is seen whether forces are the same everywhere.
const SHARES: [f64; 4] = [0.04, 0.31, 0.67, 0.93];

/// Distances from the start, in turns, at which forces are compared with those a turn later.
const SHIFTS: [f64; 3] = [0.0, 0.0175, -0.0366];

/// Largest number of turns after which forces may repeat: of a cycle of an engine two.
const MOST_TURNS: u32 = 12;

/// Number of distances in each turn at which forces that repeat themselves are compared with later ones, and the first of these distances.
const SHIFTS_OF_TURN: u32 = 60;
const FIRST_SHIFT: f64 = 0.37;

/// A mechanism whose equations are evaluated in a region.
pub(super) struct MechanismRegion<'a> {
    mechanism: Cow<'a, Mechanism>,
    region: &'a Region,
    /// Values of all parameters of the mechanism, and where those that vary are among them.
    defaults: Vec<f64>,
    varied: Vec<usize>,
    is_angle: Vec<bool>,
    /// Flags of the coordinates: angles with functions that are the same a turn later.
    is_harmonic: Vec<bool>,
    /// Number of turns of each harmonic angle after which efforts are the same, too.
    periods: Vec<Option<u32>>,
    /// Flags of the coordinates along which a part of the potential's force is uniform: the weight of a load on a drum.
    is_uniform: Vec<bool>,
    /// Coordinates whose accelerations are prescribed, and rows of the equations that are of one kind.
    driven: Vec<usize>,
    alike: Vec<Vec<usize>>,
    efforts: KnownEfforts,
    outputs: Outputs,
    /// Values of the actuator states at the start.
    actuator_starts: Vec<f64>,
}

/// Values of the equations at a point.
pub(super) struct Label {
    /// In the order of [`Dynamics`], then the positions.
    pub(super) functions: Vec<f64>,
    /// Derivatives with respect to the coordinates: shape `[functions, coordinates]`; zero where they are not
    /// [known](MechanismRegion::known).
    pub(super) gradients: Vec<f64>,
    /// Forces of joints and springs.
    pub(super) reactions: Forces,
}

/// The equations in a configuration.
pub(super) struct Configured {
    reduced: Reduced,
    terms: Terms,
}

impl<'a> MechanismRegion<'a> {
    pub(super) fn new(mechanism: &'a Mechanism, region: &'a Region) -> Result<Self, MotionError> {
        let mechanism = mechanism.with_torsion_as_forces(&region.outputs);
        for QuantityRange { name, min, max } in region.coordinates.iter().chain(&region.parameters) {
            // also where one of them is not a number
            if !(min < max && min.is_finite() && max.is_finite()) {
                let message = format!("`{name}`: range {}, expected an end above the beginning", from_to(*min, *max));
                return Err(MotionError::new(MotionCause::Unsuitable, message));
            }
        }
        let known = mechanism.parameters().clone();
        let position =
            |range: &QuantityRange| known.get_index_of(&range.name).ok_or_else(|| unknown_parameter(&range.name));
        let varied: Vec<usize> = region.parameters.iter().map(position).collect::<Result<_, _>>()?;
        let mut defaults: Vec<f64> = known.values().map(|parameter| parameter.default).collect();
        for (name, value) in &region.constants {
            defaults[known.get_index_of(name).ok_or_else(|| unknown_parameter(name))?] = *value;
        }
        let mut others = defaults.clone();
        for (range, position) in region.parameters.iter().zip(&varied) {
            let value = &mut others[*position];
            *value = if *value == range.max { range.min } else { range.max };
        }
        let outputs = Outputs::new(&mechanism, [&defaults, &others], &region.outputs)?;
        let efforts = KnownEfforts::new(&mechanism, [&defaults, &others], outputs.unused_formulas())?;
        let ([is_angle, is_harmonic, is_uniform], periods) = ([const { Vec::new() }; 3], Vec::new());
        let (driven, alike) = (Vec::new(), Vec::new());
        let mut labels = Self {
            mechanism,
            region,
            defaults,
            varied,
            is_angle,
            is_harmonic,
            periods,
            is_uniform,
            driven,
            alike,
            efforts,
            outputs,
            actuator_starts: Vec::new(),
        };
        let middle: RegionPoint = labels.ranges().map(|range| 0.5 * (range.min + range.max)).collect();
        let reduced = labels.reduced(&middle)?;
        labels.is_angle = reduced.coordinates().iter().map(|coordinate| coordinate.is_angle()).collect();
        labels.actuator_starts = reduced.model().actuator_starts();
        (labels.driven, labels.alike) = (reduced.driven().to_vec(), reduced.alike());
        labels.outputs.windings = Windings::find(&labels.outputs.positions, &reduced)?;
        labels.efforts.wind(&reduced)?;
        let aside: RegionPoint = labels.ranges().map(|range| range.min + ASIDE * (range.max - range.min)).collect();
        for k in 0..labels.coordinates() {
            let is_harmonic = labels.repeats(&reduced, k, None, &SHIFTS) && labels.positions_repeat(&aside, k)?;
            labels.is_harmonic.push(is_harmonic);
            labels.periods.push(if is_harmonic { labels.period(&reduced, k) } else { None });
        }
        let reduced_aside = labels.reduced(&aside)?;
        for k in 0..labels.coordinates() {
            let is_uniform = [&reduced, &reduced_aside].iter().any(|reduced| labels.has_uniform_force(reduced, k));
            labels.is_uniform.push(is_uniform);
        }
        Ok(labels)
    }

    /// Ranges of the columns of a point.
    pub(super) fn ranges(&self) -> impl Iterator<Item = &QuantityRange> {
        self.region.coordinates.iter().chain(&self.region.parameters)
    }

    pub(super) fn coordinates(&self) -> usize {
        self.region.coordinates.len()
    }

    /// Number of inputs of the equations: those of the mechanism, then its actuator states.
    pub(super) fn inputs(&self) -> usize {
        self.mechanism.inputs().len() + self.actuator_states()
    }

    pub(super) fn actuator_states(&self) -> usize {
        self.mechanism.actuator_states().len()
    }

    /// Number of known expressions: efforts, prescribed accelerations, formulas of outputs, rates of actuator states.
    pub(super) fn efforts(&self) -> usize {
        self.efforts.count()
    }

    /// Formulas of the efforts.
    pub(super) fn formulas(&self) -> Result<Efforts, MotionError> {
        self.efforts.formulas(&self.varied, self.inputs(), self.coordinates())
    }

    /// Returns true if a position that moves along with a coordinate occurs in a formula.
    pub(super) fn is_in_formula(&self, coordinate: usize) -> bool {
        self.efforts.has_position_along(coordinate, self.coordinates())
    }

    /// Returns true if a parameter of the region occurs in a formula.
    pub(super) fn occurs(&self, parameter: usize) -> bool {
        self.efforts.has_parameter(self.varied[parameter])
    }

    /// Number of functions of the equations of motion.
    pub(super) fn functions_of_equations(&self) -> usize {
        Dynamics::functions(self.coordinates(), self.efforts()) + self.efforts.positions()
    }

    /// Flags of the functions: positions of outputs, and positions of which the rate alone enters formulas.
    pub(super) fn free_positions(&self) -> Vec<bool> {
        let mut flags = vec![false; self.functions()];
        let n = self.coordinates();
        let of_efforts = &mut flags[n * (n + 1) / 2 + 1..][..self.efforts.positions()];
        of_efforts.iter_mut().enumerate().for_each(|(position, flag)| *flag = !self.efforts.has_position(position));
        flags[self.functions_of_equations()..].fill(true);
        flags
    }

    /// Functions that are uniform forces.
    pub(super) fn uniform(&self) -> Range<usize> {
        let (n, positions) = (self.coordinates(), self.efforts.positions());
        let first = n * (n + 1) / 2 + 1 + positions;
        first..first + n
    }

    /// Number of functions of the equations and of the positions that the outputs need.
    pub(super) fn functions(&self) -> usize {
        self.functions_of_equations() + self.outputs.positions.len()
    }

    pub(super) fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Number of turns of a harmonic angle after which efforts are the same; none if they never are. Only formulas that repeat themselves do
    /// so after several turns.
    fn period(&self, reduced: &Reduced, k: usize) -> Option<u32> {
        if !self.efforts.have_periods() {
            return self.repeats(reduced, k, Some(1), &SHIFTS).then_some(1);
        }
        (1..=MOST_TURNS).find(|&turns| {
            self.repeats(reduced, k, Some(turns), &SHIFTS)
                && self.repeats(reduced, k, Some(turns), &shifts_everywhere(turns))
        })
    }

    /// Returns true if a coordinate is an angle and forces are the same a turn later: the torque of a spring on a joint is not. An angle
    /// that cannot go around counts as periodic. Efforts are left out, or compared after a number of turns. `shifts` are distances from
    /// the start, in turns.
    fn repeats(&self, reduced: &Reduced, k: usize, of_efforts: Option<u32>, shifts: &[f64]) -> bool {
        if !self.is_angle[k] {
            return false;
        }
        let turns = of_efforts.map_or(1.0, f64::from);
        // one after the other: each configuration is followed from the one before
        let [before, after] = [0.0, turns].map(|turns| {
            let forces = shifts.iter().map(|shift| self.forces_after(reduced, k, shift + turns, of_efforts.is_some()));
            forces.collect::<Vec<_>>()
        });
        let pairs = before.into_iter().zip(after).filter_map(|(before, after)| Option::zip(before, after));
        let pairs: Vec<[DVector<f64>; 2]> = pairs
            .flat_map(|([rest, moving], after)| {
                let [a, b] = after;
                [[rest, a], [moving, b]]
            })
            .collect();
        let n = self.coordinates();
        let further = pairs.first().map_or(0, |[forces, _]| forces.len() - n);
        self.alike.iter().cloned().chain((0..further).map(|state| vec![n + state])).all(|rows| {
            // where forces vanish, rounding is left of them
            let largest = pairs.iter().flatten().map(|forces| forces.select_rows(&rows).amax()).fold(0.0, f64::max);
            pairs.iter().all(|[before, after]| {
                let change = before.select_rows(&rows) - after.select_rows(&rows);
                change.iter().all(|change| change.is_nan() || change.abs() <= 1e-8 * largest)
            })
        })
    }

    /// Forces this number of turns of an angle after the start: with the efforts, at rest and in motion, or the potential ones, and what
    /// damping and efforts of one do. None if the configuration cannot be reached.
    fn forces_after(&self, reduced: &Reduced, k: usize, turns: f64, with_efforts: bool) -> Option<[DVector<f64>; 2]> {
        let (rates, inputs) = self.probe();
        let mut s = reduced.start().0.clone();
        s[k] += turns * TAU;
        let terms = reduced.terms(&s).ok()?;
        if !with_efforts {
            let unit = DVector::from_element(terms.effort_map.ncols(), 1.0);
            return Some([terms.potential_force.clone(), &terms.effort_map * unit - &terms.damping * &rates]);
        }
        Some([&(0.0 * &rates), &rates].map(|v| {
            let of_actuators = reduced.model().actuator_rates(0.0, &terms.q, &(&terms.velocities * v), &inputs);
            let forces = reduced.force(&terms, v, &inputs);
            DVector::from_iterator(forces.len() + of_actuators.len(), forces.iter().copied().chain(of_actuators))
        }))
    }

    /// Returns true if the learned positions are equal a turn later, with the parameters of a point. A rack whose
    /// pinion has a different radius than in the middle of the ranges travels a different distance. An angle that
    /// cannot go around repeats.
    fn positions_repeat(&self, point: &[f64], k: usize) -> Result<bool, MotionError> {
        let reduced = self.reduced(point)?;
        let before = reduced.start().0.clone();
        let mut after = before.clone();
        after[k] += TAU;
        let Some([from, to]) = Option::zip(reduced.configuration(&before).ok(), reduced.configuration(&after).ok())
            .map(<[DVector<f64>; 2]>::from)
        else {
            return Ok(true);
        };
        let of_efforts = (self.efforts.positions_of(reduced.model()), &self.efforts.windings);
        let of_outputs = (self.positions(point)?, &self.outputs.windings);
        Ok([of_efforts, of_outputs].iter().all(|(positions, windings)| {
            let of =
                |q: &DVector<f64>, s: &DVector<f64>| windings.unturned(positions, q, s.as_slice()).collect::<Vec<_>>();
            of(&from, &before).into_iter().zip(of(&to, &after)).all(|(a, b)| (a - b).abs() <= 1e-8 * (1.0 + a.abs()))
        }))
    }

    /// Returns true if the potential of a harmonic angle differs a turn later, or if the potential's forces are the same wherever any other
    /// coordinate is. Configurations that cannot be reached count as without a uniform force.
    fn has_uniform_force(&self, reduced: &Reduced, k: usize) -> bool {
        if self.is_harmonic[k] {
            return self.has_mean_force(reduced, k).unwrap_or(false);
        }
        let QuantityRange { min, max, .. } = self.region.coordinates[k];
        let terms = SHARES.iter().map(|share| {
            let mut s = reduced.start().0.clone();
            s[k] = min + share * (max - min);
            reduced.terms(&s)
        });
        let Ok(terms) = terms.collect::<Result<Vec<Terms>, _>>() else { return false };
        let forces = |row: usize| terms.iter().map(move |terms| terms.potential_force[row]);
        let least =
            |row: usize| UNCHANGED * terms.iter().map(|terms| largest_force(reduced, terms, row)).fold(0.0, f64::max);
        let is_uniform = (0..self.coordinates())
            .all(|row| forces(row).all(|force| (force - terms[0].potential_force[row]).abs() <= least(row)));
        is_uniform && forces(k).all(|force| force.abs() > least(k))
    }

    /// Returns true if the potential differs a turn of an angle later by more than rounding explains. Where the mechanism starts its forces
    /// may be zero, as at a dead center, so they are measured around the turn.
    fn has_mean_force(&self, reduced: &Reduced, k: usize) -> Result<bool, MotionError> {
        let [before, after] = [0.0, 1.0].map(|turns| self.potential_after(reduced, k, turns));
        let (before, after) = (before?, after?);
        let around = SHARES.iter().filter_map(|turns| {
            let mut s = reduced.start().0.clone();
            s[k] += turns * TAU;
            reduced.terms(&s).ok().map(|terms| largest_force(reduced, &terms, k))
        });
        let least = UNCHANGED * TAU * around.fold(0.0, f64::max);
        Ok((after - before).abs() > least.max(ROUNDING * before.abs()))
    }

    /// Potential this number of turns of an angle after the start.
    fn potential_after(&self, reduced: &Reduced, k: usize, turns: f64) -> Result<f64, MotionError> {
        let mut s = reduced.start().0.clone();
        s[k] += turns * TAU;
        Ok(reduced.model().potential_energy(&reduced.configuration(&s)?))
    }

    /// Uniform forces of the potential, functions of the parameters: the mean over a turn along a harmonic angle, that at the start along
    /// any other coordinate, zero where there is none.
    fn uniform_forces(&self, reduced: &Reduced) -> Result<Vec<f64>, MotionError> {
        (0..self.coordinates()).map(|k| self.uniform_force(reduced, k)).collect()
    }

    fn uniform_force(&self, reduced: &Reduced, k: usize) -> Result<f64, MotionError> {
        if !self.is_uniform[k] {
            return Ok(0.0);
        }
        if self.is_harmonic[k] {
            let [before, after] = [0.0, 1.0].map(|turns| self.potential_after(reduced, k, turns));
            return Ok((before? - after?) / TAU);
        }
        Ok(reduced.terms(reduced.start().0)?.potential_force[k])
    }

    /// For each coordinate, the number of turns after which equations and efforts are the same; none if they never are.
    pub(super) fn periods(&self) -> &[Option<u32>] {
        &self.periods
    }

    /// Checks that the mechanism can be put together at a point.
    pub(super) fn reach(&self, point: &[f64]) -> Result<(), MotionError> {
        let s = DVector::from_column_slice(&point[..self.coordinates()]);
        let reached = self.reduced(point).and_then(|reduced| reduced.configuration(&s));
        reached.map(|_| ()).map_err(|error| self.explain(point, error))
    }

    /// Periodic angles are angles; everything else is a power in its range.
    pub(super) fn factors(&self) -> Vec<Factor> {
        let factors = self.ranges().enumerate().map(|(column, range)| match self.is_harmonic.get(column) {
            Some(true) => Factor::Angle,
            _ => Factor::Power { middle: 0.5 * (range.min + range.max), half: 0.5 * (range.max - range.min) },
        });
        factors.collect()
    }

    /// Splines by which coordinates of the mechanism follow those of the region: lifts of cams. Splines whose slope or
    /// curvature jumps in the range are excluded.
    pub(super) fn splines(&self) -> Result<Vec<SplineFactor>, MotionError> {
        let middle: RegionPoint = self.ranges().map(|range| 0.5 * (range.min + range.max)).collect();
        let reduced = self.reduced(&middle)?;
        let mut splines: Vec<SplineFactor> = Vec::new();
        for constraint in reduced.model().constraints.iter() {
            let Target::Follows(bound) = &constraint.target else { continue };
            for pair in bound.formula.steps().windows(2) {
                let [FormulaStep::Column(argument), FormulaStep::Lookup(table)] = pair else { continue };
                let Slot::Position(argument) = bound.slots[*argument] else { continue };
                let Some(column) = reduced.coordinates().iter().position(|known| *known == argument) else { continue };
                let QuantityRange { min, max, .. } = self.region.coordinates[column];
                let spline = SplineFactor { column, table: Arc::clone(table) };
                let is_smooth = table.derivatives().is_ok() && (table.period(0).is_some() || spans(table, min, max));
                if is_smooth && !splines.contains(&spline) {
                    splines.push(spline);
                }
            }
        }
        Ok(splines)
    }

    /// Values of all parameters of the mechanism at a point.
    fn values(&self, point: &[f64]) -> Vec<f64> {
        let mut values = self.defaults.clone();
        let of_parameters = &point[self.coordinates()..];
        self.varied.iter().zip(of_parameters).for_each(|(position, value)| values[*position] = *value);
        values
    }

    /// The positions that the outputs need, with the parameters of a point.
    pub(super) fn positions(&self, point: &[f64]) -> Result<Vec<Coordinate>, MotionError> {
        self.outputs.positions_with(&self.mechanism, &self.values(point))
    }

    pub(super) fn reduced(&self, point: &[f64]) -> Result<Reduced, MotionError> {
        let names: Vec<&str> = self.region.coordinates.iter().map(|range| range.name.as_str()).collect();
        self.mechanism.reduced(&self.values(point), &names)
    }

    /// Largest magnitude of each function over some labels; functions of one kind share the largest of theirs.
    pub(super) fn scales<'l>(&self, labels: impl Iterator<Item = &'l [f64]>) -> Vec<f64> {
        let mut largest = vec![0.0f64; self.functions()];
        for label in labels {
            largest.iter_mut().zip(label).for_each(|(largest, value)| *largest = largest.max(value.abs()));
        }
        let (n, mut begin) = (self.coordinates(), 0);
        // without the part of uniform forces, rounding may be left of a potential
        let potential = n * (n + 1) / 2;
        for (force, QuantityRange { min, max, .. }) in self.uniform().zip(&self.region.coordinates) {
            largest[potential] = largest[potential].max(largest[force] * (max - min));
        }
        for count in [n * (n + 1) / 2, 1] {
            share_scale(&mut largest, &(begin..begin + count).collect::<Vec<_>>());
            begin += count;
        }
        let in_efforts = self.efforts.are_angles().zip(begin..);
        begin += self.efforts.positions();
        // uniform forces, damping, map of the efforts, row by row
        for width in [1, n, self.efforts()] {
            for rows in &self.alike {
                let group = rows.iter().flat_map(|row| begin + row * width..begin + (row + 1) * width);
                share_scale(&mut largest, &group.collect::<Vec<_>>());
            }
            begin += n * width;
        }
        // all lengths are measured by the longest; of a position without what moves along with a coordinate rounding may be left
        let positions = self.outputs.positions.iter().map(Coordinate::is_angle).zip(begin..).chain(in_efforts);
        let positions: Vec<(bool, usize)> = positions.collect();
        let lengths = positions.iter().filter(|(is_angle, _)| !is_angle).map(|(_, function)| largest[*function]);
        let ranges = self.region.coordinates.iter().zip(&self.is_angle).filter(|(_, is_angle)| !**is_angle);
        let longest = ranges.map(|(range, _)| range.max - range.min).fold(SHORTEST, f64::max);
        let longest = lengths.fold(longest, f64::max).max(self.longest_travel());
        for (is_angle, function) in positions {
            largest[function] = if is_angle { largest[function].max(1.0) } else { longest };
        }
        largest
    }

    /// Longest way that a position which is a length moves along with coordinates in their ranges: the rope of a drum.
    fn longest_travel(&self) -> f64 {
        let n = self.coordinates();
        let of_outputs = self.outputs.positions.iter().map(Coordinate::is_angle).zip(self.outputs.windings.0.chunks(n));
        let of_efforts = self.efforts.are_angles().zip(self.efforts.windings.0.chunks(n));
        let lengths = of_outputs.chain(of_efforts).filter(|(is_angle, _)| !is_angle);
        let travels = lengths.map(|(_, windings)| -> f64 {
            let ways = windings.iter().zip(&self.region.coordinates);
            ways.map(|(winding, range)| winding.abs() * (range.max - range.min)).sum()
        });
        travels.fold(0.0, f64::max)
    }

    /// The functions at a point.
    pub(super) fn at(&self, point: &[f64]) -> Result<Label, MotionError> {
        let n = self.coordinates();
        let Configured { reduced, terms } = self.configured(point)?;
        self.check_efforts(&reduced, &terms).map_err(|error| self.explain(point, error))?;
        let reactions = match self.outputs.reactions.as_slice() {
            [] => Forces::default(),
            measures => {
                let found = reactions::in_configuration(&reduced, &terms, measures);
                found.map_err(|error| self.explain(point, error))?
            }
        };
        let mut functions = Vec::with_capacity(self.functions());
        for row in 0..n {
            functions.extend((0..=row).map(|column| terms.mass[(row, column)]));
        }
        let uniform = self.uniform_forces(&reduced).map_err(|error| self.explain(point, error))?;
        functions.push(terms.potential + uniform.iter().zip(point).map(|(force, s)| force * s).sum::<f64>());
        let in_efforts = self.efforts.positions_of(reduced.model());
        functions.extend(self.efforts.windings.unturned(&in_efforts, &terms.q, &point[..n]));
        // all other forces are those of the potential, of damping and of efforts
        functions.extend(&uniform);
        for matrix in [&terms.damping, &terms.effort_map] {
            matrix.row_iter().for_each(|row| functions.extend(row.iter()));
        }
        let positions = self.positions(point)?;
        functions.extend(self.outputs.windings.unturned(&positions, &terms.q, &point[..n]));
        let mut gradients = Vec::with_capacity(self.functions() * n);
        for row in 0..n {
            gradients.extend((0..=row).flat_map(|column| terms.mass_gradient.iter().map(move |by| by[(row, column)])));
        }
        gradients.extend(terms.potential_force.iter().zip(&uniform).map(|(force, uniform)| uniform - force));
        gradients.extend(self.efforts.windings.gradients(&in_efforts, &terms.q, &terms.velocities));
        gradients.resize(self.functions_of_equations() * n, 0.0);
        gradients.extend(self.outputs.windings.gradients(&positions, &terms.q, &terms.velocities));
        Ok(Label { functions, gradients, reactions })
    }

    /// Makes sure that efforts are finite at rest and in motion, with inputs in their ranges.
    fn check_efforts(&self, reduced: &Reduced, terms: &Terms) -> Result<(), MotionError> {
        let (rates, inputs) = self.probe();
        let moving = &terms.velocities * rates;
        let ends = [0, 1].map(|end| self.input_ranges().map(|range| range[end]).collect::<Vec<f64>>());
        for (v, u) in [(&(0.0 * &moving), &ends[0]), (&(0.0 * &moving), &ends[1]), (&moving, &inputs)] {
            if let Some(error) = reduced.model().undefined_effort(0.0, &terms.q, v, u) {
                let names = self.mechanism.inputs().keys().chain(self.mechanism.actuator_states().keys());
                let names = names.zip(u).map(|(name, value)| format!("{name} = {value}"));
                let with = names.collect::<Vec<_>>().join(", ");
                let with = if with.is_empty() { with } else { format!(" with {with}") };
                let message = format!("{error}{with}, expected a finite number");
                return Err(error.with_message(message));
            }
        }
        Ok(())
    }

    /// Coordinates whose accelerations are prescribed.
    pub(super) fn driven(&self) -> &[usize] {
        &self.driven
    }

    /// Flag for each function: true if its derivatives with respect to the coordinates are known. They are for mass matrix, potential and
    /// positions.
    pub(super) fn known(&self) -> Vec<bool> {
        let (n, of_equations) = (self.coordinates(), self.functions_of_equations());
        let known = n * (n + 1) / 2 + 1 + self.efforts.positions();
        (0..self.functions()).map(|function| function < known || function >= of_equations).collect()
    }

    /// Rates of both signs and different sizes, and inputs: where it is checked whether forces are finite, and periodic.
    fn probe(&self) -> (DVector<f64>, Vec<f64>) {
        let rates = DVector::from_fn(self.coordinates(), |row, _| {
            let base = if row.is_multiple_of(2) { -2.5 } else { 1.75 };
            base + 0.1 * row as f64
        });
        let inputs = self.input_ranges().enumerate();
        let inputs = inputs.map(|(k, [min, max])| min + [0.8, 0.3, 0.55][k % 3] * (max - min)).collect();
        (rates, inputs)
    }

    /// The ranges of the region, or of the mechanism file; actuator states without a range are as at the start.
    fn input_ranges(&self) -> impl Iterator<Item = [f64; 2]> {
        let own = self.mechanism.inputs().values().map(|input| [input.min, input.max]);
        let own = own.chain(self.actuator_starts.iter().map(|start| [*start; 2]));
        own.enumerate().map(|(k, own)| self.region.inputs.get(k).copied().unwrap_or(own))
    }

    /// An error with the point that it is about.
    fn explain(&self, point: &[f64], error: MotionError) -> MotionError {
        let values: Vec<String> =
            self.ranges().zip(point).map(|(range, value)| format!("{} = {}", range.name, number(*value))).collect();
        let message = format!("at {}: {error}", values.join(", "));
        error.with_message(message)
    }

    /// The equations in the configuration of a point.
    pub(super) fn configured(&self, point: &[f64]) -> Result<Configured, MotionError> {
        let reduced = self.reduced(point).map_err(|error| self.explain(point, error))?;
        let s = DVector::from_column_slice(&point[..self.coordinates()]);
        let terms = reduced.terms(&s).map_err(|error| self.explain(point, error))?;
        Ok(Configured { reduced, terms })
    }
}

/// Shifts all over this number of turns, in turns.
fn shifts_everywhere(turns: u32) -> Vec<f64> {
    let shifts = (0..SHIFTS_OF_TURN * turns).map(|index| f64::from(index) + FIRST_SHIFT);
    shifts.map(|shift| shift / f64::from(SHIFTS_OF_TURN)).collect()
}

/// Returns true if the knots of a table's first axis enclose a range.
fn spans(table: &LookupTable, min: f64, max: f64) -> bool {
    let knots = &table.axes()[0];
    knots[0] <= min && max <= knots[knots.len() - 1]
}

/// Gives the functions of a group the largest of their scales, or 1 where all are zero.
fn share_scale(scales: &mut [f64], group: &[usize]) {
    let largest = group.iter().map(|function| scales[*function]).fold(0.0, f64::max);
    group.iter().for_each(|function| scales[*function] = if largest > 0.0 { largest } else { 1.0 });
}

fn unknown_parameter(name: &str) -> MotionError {
    let message = format!("the mechanism has no parameter `{name}`");
    MotionError::of(&format!("parameters.{name}"), MotionCause::Unsuitable, message)
}

/// Sum of the magnitudes of the potential's forces along a coordinate: less than a small part of it is rounding.
fn largest_force(reduced: &Reduced, terms: &Terms, k: usize) -> f64 {
    let forces = reduced.model().potential_forces(&terms.q);
    terms.velocities.column(k).iter().zip(forces.iter()).map(|(along, force)| (along * force).abs()).sum()
}

impl Configured {
    /// The accelerations.
    pub(super) fn accelerations(&self, v: &[f64], u: &[f64]) -> Result<Vec<f64>, MotionError> {
        let v = DVector::from_column_slice(v);
        Ok(self.reduced.accelerations(&self.terms, &v, u)?.iter().copied().collect())
    }
}

#[cfg(test)]
mod tests;
