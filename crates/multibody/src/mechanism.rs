//! The mechanism file: read, checked, simulated.

use super::{
    build::{Torsion, build, free_coordinates, limits, part_problems, position_coordinates},
    constraint::BoundExpression,
    description::{ActuatorStateOptions, Description, JointOptions, JointType, MechanismInput, MechanismParameter},
    error::{MotionCause, MotionError},
    expression::{Expression, is_function},
    measure::Measure,
    model::{MultibodyModel, Sample},
    reduced::{self, Reduced},
    review::{idle_parts, is_zero, oddities},
    simulate::{simulate, simulate_from},
    tables::{read_files, tables},
    variables::variables,
};
use crate::{
    Error, Result,
    diagnostics::{
        KeyProblem, Problems,
        numbers::{exact, from_to},
        origin::{self, Origin},
        problem::Problem,
        schema,
    },
    integrate::Budget,
    signal::Signal,
    variable::SourceVariable,
};
use indexmap::IndexMap;
use nalgebra::DVector;
use std::{borrow::Cow, path::Path, sync::LazyLock};

/// Number of revolute joints between moving bodies from which body angles are better coordinates of a tree than joint
/// angles. In body angles, the inertia of a chain has terms `cos(q_i - q_j)` of pairs; in joint angles, it has products
/// over all joints in between.
const LONG_CHAIN: usize = 3;

static SCHEMA: LazyLock<serde_json::Value> = LazyLock::new(schema::of::<Description>);

/// The JSON schema of a mechanism file.
pub fn json_schema() -> &'static serde_json::Value {
    &SCHEMA
}

/// The problem of a number or a text that has a format of the schema.
fn format_problem(format: &str, text: &str) -> Option<String> {
    match format {
        "expression" => Expression::parse(text).err().map(|error| error.message),
        "finite" if !text.parse().is_ok_and(f64::is_finite) => Some(format!("{text}, expected a finite number")),
        _ => None,
    }
}

/// A mechanism file's content, checked.
#[derive(Clone, Debug)]
pub struct Mechanism {
    description: Description,
    torsion: Torsion,
    outputs: Vec<SourceVariable>,
    degrees_of_freedom: usize,
    warnings: Vec<Problem>,
    origin: Origin,
}

impl Mechanism {
    /// Reads and checks a mechanism file.
    ///
    /// # Errors
    /// [`crate::Error::Io`] if it cannot be read, [`crate::Error::Study`] with every problem found.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&origin::read(path, "a mechanism in TOML")?, path)
    }

    /// Checks a mechanism file's text; `path` is for messages.
    ///
    /// # Errors
    /// [`crate::Error::Study`] with every problem found.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let origin = Origin::new(path, text);
        let root = origin.parse()?;
        origin.refuse_section("source", "this is a study, expected a mechanism")?;
        let (problems, _) = origin.structure(root.get_ref(), json_schema(), format_problem);
        if !problems.is_empty() {
            return Err(Error::Study { problems });
        }
        let mut description: Description = origin.deserialize(root)?;
        origin.refuse(read_files(&mut description, origin.folder()))?;
        let mut problems = name_problems(&description);
        problems.extend(tables(&description).1);
        problems.extend(variables(&description.variables).1);
        let defaults: Vec<f64> = description.parameters.values().map(|parameter| parameter.default).collect();
        // every part that uses a wrong name or number would repeat its problem
        let parts_are_checked = problems.is_empty() && defaults.iter().all(|default| default.is_finite());
        problems.extend(range_problems(&description));
        problems.extend(idle_parts(&description));
        if parts_are_checked {
            problems.extend(part_problems(&description, &defaults));
        }
        origin.refuse(problems)?;
        let (model, measures) = match build(&description, &defaults, Torsion::default()) {
            Ok(built) => built,
            Err(problems) => return Err(Error::Study { problems: origin.locate(problems) }),
        };
        let (mut problems, mut outputs) = (Problems::default(), Vec::new());
        for ((name, output), measure) in description.outputs.iter().zip(&measures) {
            outputs.push(SourceVariable::new(name, measure.unit(&model), &output.description));
        }
        match model.initial_state(0.0) {
            Ok((q, _)) => problems.extend(free_of_inertia(&description, &model, &q)),
            Err(error) => problems.add(error.part.unwrap_or_default(), error.message),
        }
        origin.refuse(problems)?;
        let mut odd = oddities(&description);
        odd.extend(constant_outputs(&description, &measures));
        for owner in model.redundant.iter().map(|constraint| &constraint.owner) {
            let message = "is left out as far as it repeats what others hold: their reactions are not determined";
            if !odd.iter().any(|known| known.key == *owner) {
                odd.add(owner.clone(), message);
            }
        }
        let warnings = origin.locate(odd);
        let torsion = Torsion::default();
        Ok(Self { description, torsion, outputs, degrees_of_freedom: model.degrees_of_freedom(), warnings, origin })
    }

    /// Unusual parts of the file that may be intended.
    pub fn warnings(&self) -> &[Problem] {
        &self.warnings
    }

    /// Summary of the parts for people: "3 bodies, 4 joints, 1 degree of freedom".
    pub fn summary(&self) -> String {
        let Description { bodies, joints, couplings, drivers, states, .. } = &self.description;
        let mut parts = vec![counted(bodies.len(), "body", "bodies"), counted(joints.len(), "joint", "joints")];
        if !couplings.is_empty() {
            parts.push(counted(couplings.len(), "coupling", "couplings"));
        }
        if !drivers.is_empty() {
            parts.push(counted(drivers.len(), "driver", "drivers"));
        }
        parts.push(counted(self.degrees_of_freedom, "degree of freedom", "degrees of freedom"));
        if !states.is_empty() {
            parts.push(counted(states.len(), "actuator state", "actuator states"));
        }
        parts.join(", ")
    }

    /// Fails if there are problems, which are given their lines here.
    ///
    /// # Errors
    /// [`crate::Error::Study`].
    pub fn refuse(&self, problems: Problems) -> Result<()> {
        self.origin.refuse(problems)
    }

    /// A problem of the equations of motion, at the line of the part that it lies in.
    pub fn located(&self, error: MotionError) -> Problem {
        let problem = Problems::one(error.part.unwrap_or_else(|| "joints".into()), error.message);
        self.origin.locate(problem).swap_remove(0)
    }

    /// The content of the file.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// The mechanism with the stiffness of springs along angles as forces, which stay formulas: the energy of such a
    /// spring is not a harmonic of its angle. Returns the mechanism itself if one of these outputs measures the
    /// potential energy.
    pub fn with_torsion_as_forces(&self, outputs: &[String]) -> Cow<'_, Self> {
        let Description { springs, bushings, .. } = &self.description;
        let mut measured = outputs.iter().filter_map(|name| self.description.outputs.get(name)?.measure.as_deref());
        let along_angles =
            springs.values().filter(|spring| spring.coordinate.as_ref().is_some_and(|of| of.ends_with(".angle")));
        let mut torsion = (along_angles.map(|spring| &spring.stiffness))
            .chain(bushings.values().map(|bushing| &bushing.stiffness[2]));
        if measured.any(|measure| measure == "potential_energy") || torsion.all(is_zero) {
            return Cow::Borrowed(self);
        }
        let mut mechanism = self.clone();
        mechanism.torsion = Torsion::AsForces;
        Cow::Owned(mechanism)
    }

    /// Parameters that a study may vary.
    pub fn parameters(&self) -> &IndexMap<String, MechanismParameter> {
        &self.description.parameters
    }

    /// Inputs that act on the mechanism while it runs.
    pub fn inputs(&self) -> &IndexMap<String, MechanismInput> {
        &self.description.inputs
    }

    /// States of actuators and controllers.
    pub fn actuator_states(&self) -> &IndexMap<String, ActuatorStateOptions> {
        &self.description.states
    }

    /// Outputs that a study may use.
    pub fn outputs(&self) -> &[SourceVariable] {
        &self.outputs
    }

    /// Simulates one run with all inputs at their start values. Takes a value for each parameter, evenly spaced times,
    /// the tolerance of the integration and the cost limit. Returns the rows of all outputs, one after the other.
    ///
    /// # Errors
    /// An error that says what failed, when, and at which joint.
    pub fn simulate(
        &self,
        values: &[f64],
        times: &[f64],
        tolerance: f64,
        budget: &Budget,
    ) -> std::result::Result<Vec<f64>, MotionError> {
        let start = self.description.inputs.values().map(|input| Signal::Constant(input.start));
        self.simulate_driven(values, &start.collect::<Vec<_>>(), times, tolerance, budget)
    }

    /// Simulates one run with a signal for each input. The integrator detects the jumps of a signal without knowing
    /// them in advance, at the cost of repeated steps.
    ///
    /// # Errors
    /// An error that says what failed, when, and at which joint.
    ///
    /// # Panics
    /// If there are more or fewer signals than inputs.
    pub fn simulate_driven(
        &self,
        values: &[f64],
        signals: &[Signal],
        times: &[f64],
        tolerance: f64,
        budget: &Budget,
    ) -> std::result::Result<Vec<f64>, MotionError> {
        let (model, measures) = self.driven(values, signals, tolerance)?;
        self.rows(&model, &measures, &simulate(&model, times, budget)?)
    }

    /// Simulates one run with a signal for each input from a state.
    ///
    /// # Errors
    /// As [`Mechanism::reduced`] and [`Mechanism::simulate_driven`].
    ///
    /// # Panics
    /// If there are more or fewer signals than inputs.
    pub fn simulate_from(
        &self,
        values: &[f64],
        start: RunStart,
        signals: &[Signal],
        times: &[f64],
        (tolerance, budget): (f64, &Budget),
    ) -> std::result::Result<Vec<f64>, MotionError> {
        let (model, measures, samples, _) = self.run_from(values, start, signals, times, (tolerance, budget))?;
        self.rows(&model, &measures, &samples)
    }

    /// The coordinates in the same run, their rates, then the actuator states: shape `[times, 2 coordinates + states]`.
    ///
    /// # Errors
    /// As [`simulate_from`](Self::simulate_from).
    pub fn states_from(
        &self,
        values: &[f64],
        start: RunStart,
        signals: &[Signal],
        times: &[f64],
        (tolerance, budget): (f64, &Budget),
    ) -> std::result::Result<Vec<f64>, MotionError> {
        let (.., samples, reduced) = self.run_from(values, start, signals, times, (tolerance, budget))?;
        let states = samples.iter().flat_map(|sample| {
            let coordinates = reduced.coordinates().iter();
            let rates = coordinates.clone().map(|coordinate| coordinate.rate(&sample.q, &sample.v));
            let positions = coordinates.map(|coordinate| coordinate.value(&sample.q));
            positions.chain(rates).chain(sample.actuator_states(reduced.model()).iter().copied()).collect::<Vec<_>>()
        });
        Ok(states.collect())
    }

    /// A run from a state: the model, what its outputs measure, its samples, and the equations in the coordinates.
    pub(super) fn run_from(
        &self,
        values: &[f64],
        RunStart { coordinates, positions, rates, actuator_states }: RunStart,
        signals: &[Signal],
        times: &[f64],
        (tolerance, budget): (f64, &Budget),
    ) -> std::result::Result<(MultibodyModel, Vec<Measure>, Vec<Sample>, Reduced), MotionError> {
        let (model, measures) = self.driven(values, signals, tolerance)?;
        let [s, rates] = [positions, rates].map(DVector::from_column_slice);
        let reduced = self.reduced(values, coordinates)?;
        let terms = reduced.terms(&s)?;
        let velocities = &terms.velocities * &rates;
        let samples = simulate_from(&model, (terms.q, velocities, actuator_states.to_vec()), times, budget)?;
        Ok((model, measures, samples, reduced))
    }

    /// The model with a value for each parameter, and what its outputs measure, in their order.
    ///
    /// # Errors
    /// An error that says what cannot be built of these values.
    pub fn build(&self, values: &[f64]) -> std::result::Result<(MultibodyModel, Vec<Measure>), MotionError> {
        build(&self.description, values, self.torsion).map_err(unsuitable)
    }

    /// The model with signals, and what its outputs measure.
    pub(super) fn driven(
        &self,
        values: &[f64],
        signals: &[Signal],
        tolerance: f64,
    ) -> std::result::Result<(MultibodyModel, Vec<Measure>), MotionError> {
        let (mut model, measures) = self.build(values)?;
        assert_eq!(signals.len(), model.inputs.len(), "a signal for each input");
        model.inputs.iter_mut().zip(signals).for_each(|(input, signal)| input.signal = signal.clone());
        model.tolerance = tolerance;
        Ok((model, measures))
    }

    /// The measures of the outputs, in their order, with a value for each parameter.
    ///
    /// # Errors
    /// An error that says what cannot be built of these values.
    pub fn measures(&self, values: &[f64]) -> std::result::Result<Vec<Measure>, MotionError> {
        self.build(values).map(|(_, measures)| measures)
    }

    /// Expressions that are efforts of learned equations, with a value for each parameter: see [`MultibodyModel::known_expressions`].
    ///
    /// # Errors
    /// An error that says what cannot be built of these values.
    pub fn known_expressions(&self, values: &[f64]) -> std::result::Result<Vec<BoundExpression>, MotionError> {
        let (model, _) = self.build(values)?;
        Ok(model.known_expressions().cloned().collect())
    }

    /// The outputs of samples, row by row.
    pub(super) fn rows(
        &self,
        model: &MultibodyModel,
        measures: &[Measure],
        samples: &[Sample],
    ) -> std::result::Result<Vec<f64>, MotionError> {
        let mut rows = Vec::with_capacity(samples.len() * measures.len());
        for sample in samples {
            for (measure, output) in measures.iter().zip(&self.outputs) {
                let value = measure.value(model, sample);
                if !value.is_finite() {
                    let message = format!("output `{}` is {value} at t = {} s", output.name, sample.t);
                    let part = format!("outputs.{}", output.name);
                    return Err(MotionError::of(&part, MotionCause::Undefined, message));
                }
                rows.push(value);
            }
        }
        Ok(rows)
    }

    /// Makes sure that every name is that of the measure of a position.
    ///
    /// # Errors
    /// Every one that is not, with the name as its key.
    pub fn check_positions(&self, values: &[f64], names: &[&str]) -> std::result::Result<(), Problems> {
        position_coordinates(&self.description, values, names).map(|_| ())
    }

    /// The equations of motion in independent coordinates, with a value for each parameter. `coordinates` names a
    /// measure of a position (`JOINT.angle`, `BODY.x`) for each degree of freedom. If it is empty, the first
    /// independent coordinates are taken of those that drivers accelerate, then of those that the joints leave free, in
    /// the order of the file, then of the bodies.
    ///
    /// # Errors
    /// An error: a name is not that of a position, or as [`Reduced::new`].
    pub fn reduced(&self, values: &[f64], coordinates: &[&str]) -> std::result::Result<Reduced, MotionError> {
        let (model, _) = self.build(values)?;
        // a name is no part of the file
        let named = position_coordinates(&self.description, values, coordinates);
        let named = named.map_err(|problems| MotionError { part: None, ..unsuitable(problems) })?;
        let candidates = if named.is_empty() {
            reduced::candidates(&model, free_coordinates(&self.description, values))
        } else if named.len() == model.degrees_of_freedom() {
            named
        } else {
            let found = counted(named.len(), "coordinate", "coordinates");
            let message = format!("{found}, expected {}: one for each degree of freedom", model.degrees_of_freedom());
            return Err(MotionError::new(MotionCause::Unsuitable, message));
        };
        Reduced::new(model, &candidates)
    }
}

/// Initial state of a run.
#[derive(Clone, Copy, Debug)]
pub struct RunStart<'a> {
    /// Names of independent coordinates, as in [`Mechanism::reduced`].
    pub coordinates: &'a [&'a str],
    /// Their values.
    pub positions: &'a [f64],
    /// Their rates.
    pub rates: &'a [f64],
    /// Values of the actuator states, in the order of the file.
    pub actuator_states: &'a [f64],
}

/// A coordinate of a mechanism that is independent of its constraints and of the others, and where it may be.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeCoordinate {
    /// As in the mechanism file, for instance `hinge.angle`.
    pub name: String,
    /// Value at the start.
    pub start: f64,
    /// Its rate there.
    pub rate: f64,
    /// Largest magnitude of its second derivative there, all inputs at the lower or all at the upper ends of their ranges.
    pub acceleration: f64,
    /// Range on the assembly of the start: up to half a turn or a metre in each direction, or into the stops.
    pub reach: [f64; 2],
}

impl Mechanism {
    /// Independent coordinates, one for each degree of freedom, with the defaults of all parameters. Those that drivers
    /// accelerate come first, then the first independent ones of those that the joints leave free, then those of the
    /// bodies. Joints are in the order of the file, except that coordinates that follow others come last. In long
    /// chains, angles of bodies against the ground replace those of revolute joints.
    ///
    /// # Errors
    /// As [`Reduced::new`].
    pub fn free_coordinates(&self) -> std::result::Result<Vec<FreeCoordinate>, MotionError> {
        let values: Vec<f64> = self.description.parameters.values().map(|parameter| parameter.default).collect();
        let (model, _) = self.build(&values)?;
        // a joint has an angle or a position, or none
        let candidates = self.candidate_names().filter_map(|name| {
            let coordinates = position_coordinates(&self.description, &values, &[&name]).ok()?;
            Some((coordinates[0], name))
        });
        let (coordinates, names): (Vec<_>, Vec<String>) = candidates.unzip();
        let reduced = Reduced::new(model, &coordinates)?;
        let (s, rates) = reduced.start();
        let z = reduced.model().actuator_starts();
        let inputs = self.description.inputs.values();
        let ends = [inputs.clone().map(|input| input.min).collect::<Vec<_>>(), inputs.map(|input| input.max).collect()];
        let accelerations = ends.map(|u| {
            let terms = reduced.terms(s);
            let found = terms.and_then(|terms| reduced.accelerations(&terms, rates, &[u, z.clone()].concat()));
            found.unwrap_or_else(|_| DVector::zeros(s.len()))
        });
        let limits = limits(&self.description, &values);
        let chosen = reduced.coordinates().iter().enumerate();
        let free = chosen.filter_map(|(k, coordinate)| {
            let name = names[coordinates.iter().position(|known| known == coordinate)?].clone();
            let furthest = if coordinate.is_angle() { std::f64::consts::PI } else { 1.0 };
            let reach = [-furthest, furthest].map(|end| s[k] + reach(&reduced, s, k, end));
            let reach = limits
                .iter()
                .filter(|(of, _)| of == coordinate)
                .fold(reach, |reach, (_, limits)| within(reach, *limits, s[k]));
            let acceleration = accelerations.iter().fold(0.0, |largest: f64, at| largest.max(at[k].abs()));
            Some(FreeCoordinate { name, start: s[k], rate: rates[k], acceleration, reach })
        });
        Ok(free.collect())
    }
}

impl Mechanism {
    /// Names of coordinates that may be independent, the best ones first; those of a joint that it does not have are among them.
    fn candidate_names(&self) -> impl Iterator<Item = String> + '_ {
        let Description { bodies, joints, couplings, drivers, .. } = &self.description;
        let is_tree = couplings.is_empty() && joints.len() == bodies.len();
        let is_long = is_tree && joints.values().filter_map(linked_bodies).count() >= LONG_CHAIN;
        let of_joints = joints.iter().flat_map(|(name, joint)| {
            let [from, to] = linked_bodies(joint).filter(|_| is_long).unwrap_or_default();
            let against_ground = [to, from].into_iter().filter(|body| !body.is_empty());
            let angles = against_ground.map(|body| format!("{body}.angle"));
            angles.chain(["angle", "position"].map(|measure| format!("{name}.{measure}"))).collect::<Vec<_>>()
        });
        let (held, free): (Vec<String>, Vec<String>) =
            of_joints.partition(|name| couplings.values().any(|coupling| coupling.coordinate == *name));
        let drivers = drivers.values().filter(|driver| driver.acceleration.is_some());
        let names = drivers.map(|driver| driver.coordinate.clone()).chain(free).chain(held);
        let of_bodies = bodies.keys().flat_map(|name| ["x", "y", "angle"].map(|measure| format!("{name}.{measure}")));
        names.chain(of_bodies)
    }
}

/// The bodies that a revolute joint links, unless one of them is the ground.
fn linked_bodies(joint: &JointOptions) -> Option<[String; 2]> {
    let bodies = joint.between.each_ref().map(|end| end.split('.').next().unwrap_or_default().to_owned());
    let is_link = joint.joint == JointType::Revolute && !bodies.contains(&"ground".to_owned());
    is_link.then_some(bodies)
}

/// A range cut at the limits of a stop, with a twentieth of the limits' distance for what goes into the stop. The start stays in it.
fn within([low, high]: [f64; 2], [min, max]: [f64; 2], start: f64) -> [f64; 2] {
    let into = 0.05 * (max.min(high) - min.max(low));
    [low.max((min - into).min(start)), high.min((max + into).max(start))]
}

/// Distance by which a coordinate can move towards `end`, with a tenth to spare if that is not all the way.
fn reach(reduced: &Reduced, s: &DVector<f64>, k: usize, end: f64) -> f64 {
    const PARTS: u32 = 32;
    let shares = (1..=PARTS).map(|part| f64::from(part) / f64::from(PARTS));
    let reached = shares.take_while(|share| {
        let mut target = s.clone();
        target[k] += share * end;
        reduced.configuration(&target).is_ok()
    });
    match reached.last() {
        Some(1.0) => end,
        Some(share) => 0.9 * share * end,
        None => 0.0,
    }
}

/// Problems of parts as one error, which lies in the first of them.
fn unsuitable(problems: Problems) -> MotionError {
    let problems: Vec<KeyProblem> = problems.into_iter().collect();
    let sentences: Vec<String> =
        problems.iter().map(|KeyProblem { key, message }| format!("{key}: {message}")).collect();
    let part = problems.into_iter().next().map(|first| first.key);
    MotionError { cause: MotionCause::Unsuitable, part, message: sentences.join("; ") }
}

fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// Ranges of parameters that are empty or incomplete, or do not contain the default.
fn range_problems(description: &Description) -> Problems {
    let mut problems = Problems::default();
    for (name, &MechanismParameter { default, min, max, .. }) in &description.parameters {
        let mut add = |field: &str, message: String| problems.add(format!("parameters.{name}.{field}"), message);
        for (field, value) in [("default", Some(default)), ("min", min), ("max", max)] {
            if value.is_some_and(|value| !value.is_finite()) {
                add(field, "expected a finite number".into());
            }
        }
        match (min, max) {
            (Some(_), None) => add("min", "expected a `max` as well".into()),
            (None, Some(_)) => add("max", "expected a `min` as well".into()),
            (Some(min), Some(max)) if min >= max => {
                add("min", format!("range is empty: min {} is not below max {}", exact(min), exact(max)));
            }
            (Some(min), Some(max)) if !(min..=max).contains(&default) => {
                add("default", format!("{} is outside the range {}", exact(default), from_to(min, max)));
            }
            _ => {}
        }
    }
    for (name, &MechanismInput { start, min, max, .. }) in &description.inputs {
        let mut add = |field: &str, message: String| problems.add(format!("inputs.{name}.{field}"), message);
        if min >= max {
            add("min", format!("range is empty: min {} is not below max {}", exact(min), exact(max)));
        } else if !(min..=max).contains(&start) {
            add("start", format!("{} is outside the range {}", exact(start), from_to(min, max)));
        }
    }
    problems
}

/// Bodies with a motion that neither mass nor inertia resists.
fn free_of_inertia(description: &Description, model: &MultibodyModel, q: &DVector<f64>) -> Problems {
    let problems = model.motions_without_inertia(q).into_iter().map(|coordinate| {
        let body = description.bodies.get_index(coordinate / 3).map_or("", |(name, _)| name.as_str());
        let (field, motion) = if coordinate % 3 == 2 { ("inertia", "turn") } else { ("mass", "move") };
        let message = format!("0, expected more: the body can {motion} without anything that has mass or inertia");
        KeyProblem { key: format!("bodies.{body}.{field}"), message }
    });
    let mut problems: Vec<KeyProblem> = problems.collect();
    // one mass is missing for two directions
    problems.dedup();
    problems.into_iter().collect()
}

fn is_constant(measure: &Measure) -> bool {
    match measure {
        Measure::Position(coordinate) | Measure::Velocity(coordinate) | Measure::Acceleration(coordinate) => {
            !coordinate.is_of_body()
        }
        _ => false,
    }
}

/// Outputs that measure something that does not move.
fn constant_outputs(description: &Description, measures: &[Measure]) -> Problems {
    let mut odd = Problems::default();
    for (name, _) in description.outputs.keys().zip(measures).filter(|(_, measure)| is_constant(measure)) {
        odd.add(format!("outputs.{name}.measure"), "never changes: it belongs to the ground");
    }
    odd
}

/// Names that are ambiguous or cannot be used in an expression.
fn name_problems(description: &Description) -> Problems {
    let mut problems = Problems::default();
    let Description { parameters, inputs, tables, variables, bodies, joints, couplings, drivers, .. } = description;
    let Description { springs, bushings, stops, contacts, forces, actuators, states, .. } = description;
    // in expressions, parameters, inputs and tables are names without a dot, parts of the mechanism are followed by one
    let mut values: Vec<(&str, &str)> = vec![("the time", "time"), ("a number", "pi")];
    let mut parts: Vec<(&str, &str)> = vec![("the ground", "ground")];
    let sections: [(&str, Vec<&String>); 15] = [
        ("parameters", parameters.keys().collect()),
        ("inputs", inputs.keys().collect()),
        ("tables", tables.keys().collect()),
        ("variables", variables.keys().collect()),
        ("states", states.keys().collect()),
        ("bodies", bodies.keys().collect()),
        ("joints", joints.keys().collect()),
        ("couplings", couplings.keys().collect()),
        ("drivers", drivers.keys().collect()),
        ("springs", springs.keys().collect()),
        ("bushings", bushings.keys().collect()),
        ("stops", stops.keys().collect()),
        ("contacts", contacts.keys().collect()),
        ("forces", forces.keys().collect()),
        ("actuators", actuators.keys().collect()),
    ];
    for (section, names) in &sections {
        let seen = if ["parameters", "inputs", "tables", "variables", "states"].contains(section) {
            &mut values
        } else {
            &mut parts
        };
        for name in names {
            let key = format!("{section}.{name}");
            if !is_plain(name) {
                problems.add(key, format!("`{name}` is not a valid name: {PLAIN}"));
            } else if *section == "tables" && is_function(name) {
                problems.add(key, format!("`{name}` is the name of a function already"));
            } else if let Some((other, _)) = seen.iter().find(|(_, known)| known == name) {
                problems.add(key, format!("`{name}` is the name of {other} already"));
            } else {
                seen.push((section, name));
            }
        }
    }
    let points = bodies.iter().map(|(name, body)| (format!("bodies.{name}"), &body.points));
    for (key, points) in points.chain([("ground".to_owned(), &description.ground.points)]) {
        for name in points.keys().filter(|name| !is_plain(name)) {
            problems.add(format!("{key}.points.{name}"), format!("`{name}` is not a valid name: {PLAIN}"));
        }
    }
    if bodies.is_empty() {
        problems.add("bodies", "no body, expected at least one");
    }
    if description.outputs.is_empty() {
        problems.add("outputs", "no output, expected at least one");
    }
    add_output_problems(description, &mut problems);
    problems
}

/// Adds the problems of the names of outputs, which are variables of the FMU beside parameters and inputs.
fn add_output_problems(description: &Description, problems: &mut Problems) {
    let Description { parameters, inputs, .. } = description;
    for name in description.outputs.keys() {
        let key = format!("outputs.{name}");
        if !is_plain(name) {
            problems.add(key, format!("`{name}` is not a valid name: {PLAIN}"));
        } else if name == "time" {
            problems.add(key, "`time` is the name of the time already");
        } else if parameters.get(name).is_some_and(|parameter| parameter.min.is_some()) {
            problems.add(key, format!("`{name}` is a parameter already: names of variables must be unique"));
        } else if inputs.contains_key(name) {
            problems.add(key, format!("`{name}` is an input already: names of variables must be unique"));
        }
    }
}

/// Requirement of [`is_plain`] in messages.
const PLAIN: &str = "expected a letter or `_`, then letters, digits and `_`";

fn is_plain(name: &str) -> bool {
    let first = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    first && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}
