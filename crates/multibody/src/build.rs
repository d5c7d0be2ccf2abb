//! From a description and the values of its parameters to a model: names are resolved and expressions evaluated.

mod contacts;
mod forces;
mod geometry;
mod names;

use super::{
    constraint::{BoundExpression, Constraint, Constraints, Slot, Target},
    coordinate::{BodyPoint, Coordinate},
    description::{CouplingOptions, Description, JointOptions, JointType, MechanismOutput, PlaneVector},
    expression::{Expression, Tables},
    joints::{Driver, Ends, Joint, JointOption},
    measure::Measure,
    model::{ActuatorState, MultibodyInput, MultibodyModel, OutputFormula, Prescribed},
    redundancy::Redundancy,
    tables::tables,
    variables::variables,
};
use crate::{
    diagnostics::{Problems, names::expected_one_of},
    integrate::TOLERANCE,
    signal::Signal,
    unit::is_same,
};
pub use geometry::{JointGeometry, MechanismGeometry, geometry};
use indexmap::IndexMap;
use nalgebra::{DVector, Vector2};
use names::NameError;
use std::{collections::BTreeSet, error::Error, ops::Range};

/// Part of a model that the stiffness of springs along angles is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Torsion {
    /// The potential, as any other stiffness.
    #[default]
    InPotential,
    /// Efforts: formulas, whose energy is not part of the potential.
    AsForces,
}

/// The model and what its outputs measure, in the order of the description.
///
/// # Errors
/// Every problem found, with its key.
pub fn build(
    description: &Description,
    values: &[f64],
    torsion: Torsion,
) -> Result<(MultibodyModel, Vec<Measure>), Problems> {
    let mut builder = MultibodyBuilder { torsion, ..MultibodyBuilder::new(description, values) };
    let mut model = builder.model();
    let measures: Vec<Measure> = builder.measures(&mut model.formulas).into_iter().flatten().collect();
    if !builder.problems.is_empty() {
        return Err(builder.problems);
    }
    let redundancy = Redundancy::take_out(&mut model);
    // where nothing is free, kinks of motions have no effect on positions
    if model.degrees_of_freedom() > 0 {
        builder.refuse_kinked_motions();
    }
    for (name, _) in description.outputs.keys().zip(&measures).filter(|(_, measure)| redundancy.concerns(measure)) {
        let owners: BTreeSet<String> = model.redundant.iter().map(|one| format!("`{}`", one.owner)).collect();
        let owners = owners.into_iter().collect::<Vec<_>>().join(", ");
        let message =
            format!("is not determined: {owners} repeats what others hold; a bushing shares loads by its stiffness");
        builder.problem(&format!("outputs.{name}.measure"), message);
    }
    let measures = measures.into_iter().map(|measure| redundancy.renumbered(measure)).collect();
    if builder.problems.is_empty() { Ok((model, measures)) } else { Err(builder.problems) }
}

/// Problems of the parts of a description and of its outputs, one by one.
pub fn part_problems(description: &Description, values: &[f64]) -> Problems {
    let mut builder = MultibodyBuilder::new(description, values);
    let mut model = builder.model();
    let parts_are_right = builder.problems.is_empty();
    let measures = builder.measures(&mut model.formulas);
    // where a part is missing, others have its number
    for ((name, output), measure) in description.outputs.iter().zip(&measures).filter(|_| parts_are_right) {
        let Some(unit) = measure.as_ref().map(|measure| measure.unit(&model)) else { continue };
        if let Some(found) = output.unit.as_deref().filter(|&found| !is_same(found, unit)) {
            let expected = if unit.is_empty() { "none".into() } else { format!("`{unit}`") };
            builder.problem(&format!("outputs.{name}.unit"), format!("`{found}`, expected {expected}"));
        }
    }
    builder.problems
}

/// The coordinates that measures of positions name.
///
/// # Errors
/// Every name that is not that of a position, with the name as its key.
pub fn position_coordinates(
    description: &Description,
    values: &[f64],
    names: &[&str],
) -> Result<Vec<Coordinate>, Problems> {
    let mut builder = MultibodyBuilder::new(description, values);
    let coordinates = names.iter().filter_map(|name| {
        let coordinate = builder.coordinate(name);
        builder.noted(name, coordinate)
    });
    let coordinates = coordinates.collect();
    if builder.problems.is_empty() { Ok(coordinates) } else { Err(builder.problems) }
}

/// Positions and velocities of joints and bodies, by the names of their measures.
pub fn motions(description: &Description, values: &[f64]) -> Vec<(String, Measure)> {
    let mut builder = MultibodyBuilder::new(description, values);
    let of_joints = description
        .joints
        .keys()
        .flat_map(|name| ["angle", "position", "angular_velocity", "velocity"].map(|what| format!("{name}.{what}")));
    let of_bodies = description
        .bodies
        .keys()
        .flat_map(|name| ["x", "y", "angle", "vx", "vy", "angular_velocity"].map(|what| format!("{name}.{what}")));
    let names: Vec<String> = of_joints.chain(of_bodies).collect();
    // a joint has some of them
    names.into_iter().filter_map(|name| builder.measure(&name).ok().map(|measure| (name, measure))).collect()
}

/// The coordinates that the joints leave free, in the order of the description.
pub fn free_coordinates(description: &Description, values: &[f64]) -> Vec<Coordinate> {
    MultibodyBuilder::new(description, values).joints.iter().filter_map(Joint::free).collect()
}

/// Limits of coordinates by stops, the lower and the upper one; stops that cannot be built are ignored.
pub fn limits(description: &Description, values: &[f64]) -> Vec<(Coordinate, [f64; 2])> {
    let mut builder = MultibodyBuilder::new(description, values);
    let stops = description.stops.values();
    let limits = stops.filter_map(|stop| {
        let coordinate = builder.coordinate(&stop.coordinate).ok()?;
        let min = stop.min.as_ref().map_or(f64::NEG_INFINITY, |min| builder.number("", min));
        let max = stop.max.as_ref().map_or(f64::INFINITY, |max| builder.number("", max));
        Some((coordinate, [min, max]))
    });
    limits.collect()
}

/// Names that an expression may use beside those of parameters.
#[derive(Clone, Copy, PartialEq)]
enum Scope {
    /// The time: what is prescribed.
    Time,
    /// Positions: what follows them.
    Positions,
    /// Time, inputs, positions and velocities: what acts.
    State,
}

struct MultibodyBuilder<'a> {
    description: &'a Description,
    values: &'a [f64],
    tables: Tables,
    /// Without variables in them.
    variables: IndexMap<String, Expression>,
    /// In the order of the description.
    joints: Vec<Joint>,
    torsion: Torsion,
    problems: Problems,
}

impl<'a> MultibodyBuilder<'a> {
    fn new(description: &'a Description, values: &'a [f64]) -> Self {
        let (tables, mut problems) = tables(description);
        let (variables, more) = variables(&description.variables);
        problems.extend(more);
        let (joints, torsion) = (Vec::new(), Torsion::InPotential);
        let mut builder = Self { description, values, tables, variables, joints, torsion, problems };
        builder.joints = description.joints.iter().map(|(name, options)| builder.joint(name, options)).collect();
        builder
    }

    fn model(&mut self) -> MultibodyModel {
        let description = self.description;
        let mut mass = Vec::new();
        let (mut positions, mut velocities) = (Vec::new(), Vec::new());
        for (name, body) in &description.bodies {
            let key = |field: &str| format!("bodies.{name}.{field}");
            let m = self.not_negative(&key("mass"), &body.mass);
            mass.extend([m, m, self.not_negative(&key("inertia"), &body.inertia)]);
            let (position, angle) =
                (self.vector(&key("position"), &body.position), self.number(&key("angle"), &body.angle));
            positions.extend([position.x, position.y, angle]);
            let velocity = self.vector(&key("velocity"), &body.velocity);
            velocities.extend([velocity.x, velocity.y, self.number(&key("angular_velocity"), &body.angular_velocity)]);
        }
        let (initial_positions, initial_velocities) = self.initial();
        let (springs, of_springs) = self.springs();
        let (constraints, prescribed) = (self.constraints(), self.prescribed());
        let still = prescribed.iter().map(|driver| Constraint {
            coordinate: driver.coordinate,
            target: Target::Fixed { value: 0.0, rate: 0.0 },
            owner: driver.owner.clone(),
        });
        MultibodyModel {
            formulation: description.formulation,
            tolerance: TOLERANCE,
            mass: DVector::from_vec(mass),
            gravity: self.vector("gravity", &description.gravity),
            deciding: constraints.iter().cloned().chain(still).collect(),
            constraints,
            redundant: Constraints::default(),
            prescribed,
            efforts: self.efforts(of_springs),
            springs,
            inputs: self.inputs(),
            actuator_states: self.actuator_states(),
            formulas: Vec::new(),
            position_guess: DVector::from_vec(positions),
            velocity_guess: DVector::from_vec(velocities),
            initial_positions,
            initial_velocities,
            starts_in_equilibrium: description.equilibrium,
        }
    }

    /// Constraints of the joints, of the couplings, and of the drivers of motions, in the order of [`MultibodyBuilder::joint_rows`].
    fn constraints(&mut self) -> Constraints {
        let mut constraints = Vec::new();
        for (name, joint) in self.description.joints.keys().zip(&self.joints) {
            constraints.extend(joint.held().into_iter().map(|(coordinate, value)| Constraint {
                coordinate,
                target: Target::Fixed { value, rate: 0.0 },
                owner: format!("joints.{name}"),
            }));
        }
        for (name, CouplingOptions { coordinate, follows }) in &self.description.couplings {
            let owner = format!("couplings.{name}");
            let coordinate = self.coordinate_of(&owner, coordinate);
            let follows = self.bound(&format!("{owner}.follows"), follows, Scope::Positions);
            if let (Some(coordinate), Some(follows)) = (coordinate, follows) {
                if follows.slots.iter().any(|slot| matches!(slot, Slot::Position(of) if *of == coordinate)) {
                    self.problem(
                        &format!("{owner}.follows"),
                        format!("`{}` names the coordinate itself", follows.text),
                    );
                }
                constraints.push(Constraint { coordinate, target: Target::Follows(follows), owner });
            }
        }
        for (name, driver) in &self.description.drivers {
            let Some(motion) = &driver.motion else { continue };
            let coordinate = self.coordinate_of(&format!("drivers.{name}"), &driver.coordinate);
            let motion = self.bound(&format!("drivers.{name}.motion"), motion, Scope::Time);
            if let (Some(coordinate), Some(motion)) = (coordinate, motion) {
                let (coordinate, target) = Driver { coordinate, motion }.held();
                constraints.push(Constraint { coordinate, target, owner: format!("drivers.{name}") });
            }
        }
        constraints.into_iter().collect()
    }

    /// Velocities jump at kinks of motions, and what is free would need the impulse.
    fn refuse_kinked_motions(&mut self) {
        for (name, driver) in &self.description.drivers {
            let Some(Ok(motion)) = driver.motion.as_ref().map(|motion| motion.with_variables(&self.variables)) else {
                continue;
            };
            if let Some(function) = motion.kinked_function(|name| self.description.parameters.contains_key(name)) {
                let message = "has no rate at its kinks, expected for instance `step` where other motions are free";
                self.problem(&format!("drivers.{name}.motion"), format!("`{motion}`: `{function}` {message}"));
            }
        }
    }

    /// The drivers of accelerations.
    fn prescribed(&mut self) -> Vec<Prescribed> {
        let mut prescribed = Vec::new();
        for (name, driver) in &self.description.drivers {
            let owner = format!("drivers.{name}");
            let acceleration = match (&driver.motion, &driver.acceleration) {
                (None, Some(acceleration)) => acceleration,
                (Some(_), None) => continue,
                (motion, _) => {
                    let found = if motion.is_some() { "both" } else { "neither" };
                    let message = format!("{found} of `motion` and `acceleration`, expected one of them");
                    self.problem(&owner, message);
                    continue;
                }
            };
            let coordinate = self.coordinate_of(&owner, &driver.coordinate);
            let expression = self.bound(&format!("{owner}.acceleration"), acceleration, Scope::State);
            if let (Some(coordinate), Some(expression)) = (coordinate, expression) {
                prescribed.push(Prescribed { coordinate, expression, name: driver.coordinate.clone(), owner });
            }
        }
        prescribed
    }

    /// The coordinate that a part names.
    fn coordinate_of(&mut self, owner: &str, name: &str) -> Option<Coordinate> {
        let coordinate = self.coordinate(name);
        self.noted(&format!("{owner}.coordinate"), coordinate)
    }

    /// Numbers put in for a joint; one whose points are not found is a joint of the ground.
    fn joint(&mut self, name: &str, options: &JointOptions) -> Joint {
        let key = |field: &str| format!("joints.{name}.{field}");
        for (option, field, is_set) in [
            (JointOption::Axis, "axis", options.axis.is_some()),
            (JointOption::Angle, "angle", options.angle.is_some()),
        ] {
            if is_set && !option.joints().any(|joint| joint == options.joint) {
                let names: Vec<&str> = option.joints().map(JointType::name).collect();
                self.problem(&key(field), format!("belongs to {} joints", names.join(" and ")));
            }
        }
        let ends = self.ends(&key("between"), &options.between);
        let [from, to] = ends.unwrap_or([BodyPoint::ORIGIN; 2]);
        let axis = self.axis(name, options);
        let angle = options.angle.as_ref().map_or(0.0, |angle| self.number(&key("angle"), angle));
        Joint::new(options.joint, Ends { from, to }, axis, angle)
    }

    /// The direction of a joint's `axis`, as a unit vector.
    fn axis(&mut self, name: &str, options: &JointOptions) -> Vector2<f64> {
        let key = format!("joints.{name}.axis");
        let Some(axis) = &options.axis else {
            if JointOption::Axis.joints().any(|joint| joint == options.joint) {
                self.problem(&format!("joints.{name}"), format!("a {} joint needs an `axis`", options.joint.name()));
            }
            return Vector2::x();
        };
        let axis = self.vector(&key, axis);
        if axis.norm() == 0.0 {
            self.problem(&key, "[0, 0] is not a direction".into());
        }
        axis.normalize()
    }

    fn inputs(&self) -> Vec<MultibodyInput> {
        let inputs = self.description.inputs.iter();
        let inputs = inputs.map(|(name, input)| MultibodyInput {
            name: name.clone(),
            range: [input.min, input.max],
            signal: Signal::Constant(input.start),
        });
        inputs.collect()
    }

    /// States of actuators and controllers.
    fn actuator_states(&mut self) -> Vec<ActuatorState> {
        let mut states = Vec::new();
        for (name, state) in &self.description.states {
            let owner = format!("states.{name}");
            let start = self.number(&format!("{owner}.start"), &state.start);
            let rate = self.bound(&format!("{owner}.rate"), &state.rate, Scope::State);
            states.extend(rate.map(|rate| ActuatorState { rate, start, owner }));
        }
        states
    }

    /// Quantity that each output shows, none where there is a problem; formulas are added to those of the model.
    fn measures(&mut self, formulas: &mut Vec<OutputFormula>) -> Vec<Option<Measure>> {
        let outputs = self.description.outputs.iter();
        outputs.map(|(name, output)| self.output(name, output, formulas)).collect()
    }

    /// Quantity that an output shows; formulas are added to those of the model.
    fn output(&mut self, name: &str, output: &MechanismOutput, formulas: &mut Vec<OutputFormula>) -> Option<Measure> {
        let MechanismOutput { measure, formula, unit, .. } = output;
        let (key, formula, unit) = match (measure, formula) {
            (Some(measure), None) => match self.description.states.get(measure) {
                Some(state) => ("measure", Expression::parse(measure), state.unit.clone()),
                None => match self.contact_force(measure) {
                    Some(force) => ("measure", force, "N".into()),
                    None => {
                        let measure = self.measure(measure);
                        return self.noted(&format!("outputs.{name}.measure"), measure);
                    }
                },
            },
            (None, Some(formula)) => ("formula", Ok(formula.clone()), unit.clone().unwrap_or_default()),
            (measure, _) => {
                let found = if measure.is_some() { "both" } else { "neither" };
                let message = format!("{found} of `measure` and `formula`, expected one of them");
                self.problem(&format!("outputs.{name}"), message);
                return None;
            }
        };
        let key = format!("outputs.{name}.{key}");
        let formula = self.noted(&key, formula)?;
        let expression = self.bound(&key, &formula, Scope::State)?;
        formulas.push(OutputFormula { expression, unit });
        Some(Measure::Formula(formulas.len() - 1))
    }

    /// The conditions on positions and on velocities at the start.
    fn initial(&mut self) -> (Constraints, Constraints) {
        let (mut positions, mut velocities) = (Vec::new(), Vec::new());
        for (owner, values) in &self.description.initial {
            for (quantity, expression) in values {
                let (name, key) = (format!("{owner}.{quantity}"), format!("initial.{owner}.{quantity}"));
                let number = self.number(&key, expression);
                let measure = self.measure(&name).and_then(|measure| match measure {
                    Measure::Position(_) | Measure::Velocity(_) => Ok(measure),
                    _ => Err(NameError::OtherKind(format!("`{name}` is neither a position nor a velocity"))),
                });
                let owner = key.clone();
                match self.noted(&key, measure) {
                    Some(Measure::Position(coordinate)) => {
                        let target = Target::Fixed { value: number, rate: 0.0 };
                        positions.push(Constraint { coordinate, target, owner });
                    }
                    Some(Measure::Velocity(coordinate)) => {
                        let target = Target::Fixed { value: 0.0, rate: number };
                        velocities.push(Constraint { coordinate, target, owner });
                    }
                    _ => {}
                }
            }
        }
        (positions.into_iter().collect(), velocities.into_iter().collect())
    }

    /// A joint's constraints; those of the joint after the last are empty and where the couplings begin.
    fn joint_rows(&self, index: usize) -> Range<usize> {
        let before: usize = self.joints.iter().take(index).map(|joint| joint.held().len()).sum();
        before..before + self.joints.get(index).map_or(0, |joint| joint.held().len())
    }

    /// A driver's multiplier: after those of joints and couplings those of motions, then those of accelerations.
    fn driver_row(&self, index: usize) -> usize {
        let are_motions: Vec<bool> = self.description.drivers.values().map(|driver| driver.motion.is_some()).collect();
        let motions = are_motions.iter().filter(|is_motion| **is_motion).count();
        let before = are_motions.iter().take(index);
        let before = match are_motions.get(index) {
            Some(true) => before.filter(|is_motion| **is_motion).count(),
            _ => motions + before.filter(|is_motion| !**is_motion).count(),
        };
        self.joint_rows(self.joints.len()).start + self.description.couplings.len() + before
    }

    fn ends(&mut self, key: &str, names: &[String; 2]) -> Option<[BodyPoint; 2]> {
        let [from, to] = names.each_ref().map(|name| {
            let point = self.point(name);
            self.noted(key, point)
        });
        let (from, to) = (from?, to?);
        if from.frame == to.frame {
            let owner = if from.frame.is_some() { "the same body" } else { "the ground" };
            self.problem(key, format!("both points belong to {owner}"));
        }
        Some([from, to])
    }

    fn vector(&mut self, key: &str, [x, y]: &PlaneVector) -> Vector2<f64> {
        Vector2::new(self.number(key, x), self.number(key, y))
    }

    fn not_negative(&mut self, key: &str, expression: &Expression) -> f64 {
        let number = self.number(key, expression);
        if number < 0.0 {
            let found = if expression.as_number().is_some() { String::new() } else { format!("`{expression}` is ") };
            self.problem(key, format!("{found}{number}, expected zero or more"));
        }
        number
    }

    /// A number that depends on the parameters only.
    fn number(&mut self, key: &str, expression: &Expression) -> f64 {
        let expanded = expression.with_variables(&self.variables);
        let Some(expression) = &self.noted(key, expanded) else { return 1.0 };
        for name in expression.names() {
            if !self.description.parameters.contains_key(name) {
                let known: Vec<&str> = self.description.parameters.keys().map(String::as_str).collect();
                let known = expected_one_of(name, &known);
                self.problem(key, format!("`{expression}`: no parameter `{name}`, {known}"));
                return 1.0;
            }
        }
        let formula = expression.formula(&self.tables);
        let Some(formula) = self.noted(key, formula) else { return 1.0 };
        let number = formula.value(|position| self.parameter(&expression.names()[position]));
        if !number.is_finite() {
            self.problem(key, format!("`{expression}` is {number}, expected a finite number"));
            return 1.0;
        }
        number
    }

    /// Value of a parameter; NaN if there is none of this name.
    fn parameter(&self, name: &str) -> f64 {
        self.description.parameters.get_index_of(name).map_or(f64::NAN, |index| self.values[index])
    }

    /// An expression of the parameters and of what else it may name.
    fn bound(&mut self, key: &str, expression: &Expression, allowed: Scope) -> Option<BoundExpression> {
        let expanded = expression.with_variables(&self.variables);
        let expression = &self.noted(key, expanded)?;
        let mut slots = Vec::new();
        for name in expression.names() {
            match self.slot(name, allowed) {
                Ok(slot) => slots.push(slot),
                Err(error) => {
                    self.problem(key, format!("`{expression}`: {error}"));
                    return None;
                }
            }
        }
        let mut kinked =
            expression.tables().filter(|name| self.tables.get(*name).is_some_and(|table| !table.is_smooth()));
        if let Some(name) = kinked.next().filter(|_| allowed != Scope::State) {
            let expected = "expected `interpolation = \"cubic\"` and `extrapolation = \"linear\"` or `\"periodic\"`";
            self.problem(key, format!("`{expression}`: the table `{name}` has no rate at its kinks, {expected}"));
        }
        let kinked_function = expression.kinked_function(|name| self.description.parameters.contains_key(name));
        if let Some(name) = kinked_function.filter(|_| allowed == Scope::Positions) {
            self.problem(
                key,
                format!("`{expression}`: `{name}` has no rate at its kinks, expected for instance `step`"),
            );
        }
        let formula = expression.formula(&self.tables);
        Some(BoundExpression { text: expression.to_string(), formula: self.noted(key, formula)?, slots })
    }

    /// The slot that a name in an expression stands for.
    fn slot(&mut self, name: &str, allowed: Scope) -> Result<Slot, NameError> {
        let (of_state, of_time) = (allowed == Scope::State, allowed != Scope::Positions);
        let Description { parameters, variables, inputs, states, .. } = self.description;
        // actuator states follow the inputs
        let state = states.get_index_of(name).map(|index| inputs.len() + index);
        let input = inputs.get_index_of(name).or(state).filter(|_| of_state);
        let value = parameters.get_index_of(name).map(|index| Slot::Parameter(index, self.values[index]));
        match value.or(input.map(Slot::Input)) {
            Some(slot) => Ok(slot),
            None if name == "time" && of_time => Ok(Slot::Time),
            None if allowed != Scope::Time && name.contains('.') => match self.measure(name)? {
                Measure::Position(coordinate) => Ok(Slot::Position(coordinate)),
                Measure::Velocity(coordinate) if of_state => Ok(Slot::Velocity(coordinate)),
                _ if of_state => Err(NameError::OtherKind(format!("`{name}` is neither a position nor a velocity"))),
                _ => Err(NameError::OtherKind(format!("`{name}` is not a position"))),
            },
            None if self.tables.contains_key(name) => {
                let message = format!("`{name}` is a table, expected its arguments, as in `{name}(time)`");
                Err(NameError::OtherKind(message))
            }
            None => {
                let parameters = parameters.keys().chain(variables.keys()).map(String::as_str);
                let inputs = inputs.keys().chain(states.keys()).map(String::as_str).filter(|_| of_state);
                let known = parameters.chain(inputs).chain(["time"].into_iter().filter(|_| of_time));
                let known: Vec<&str> = known.collect();
                Err(NameError::Unknown(format!("no `{name}`, {}", expected_one_of(name, &known))))
            }
        }
    }

    /// The value of a result; its error becomes a problem of a key.
    fn noted<T>(&mut self, key: &str, result: Result<T, impl Error>) -> Option<T> {
        result.map_err(|error| self.problem(key, error.to_string())).ok()
    }

    /// Notes a problem once: points are looked up wherever they are named.
    fn problem(&mut self, key: &str, message: String) {
        if !self.problems.iter().any(|known| known.key == key && known.message == message) {
            self.problems.add(key, message);
        }
    }
}
