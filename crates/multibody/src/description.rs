//! The mechanism file as plain data.
//!
//! TOML. Wherever it takes a number it takes an [expression](super::expression) of the mechanism's parameters in quotes.
//! SI units and radians throughout. References are names: `rod` is a body and its centre of mass, `rod.tip` a point of it,
//! `ground` and `ground.pivot` are fixed; `rod.angle`, `hinge.angle`, `guide.position` are coordinates
//! (see [`super::measure`]).
//!
//! ```toml
//! formulation = "augmented"                   # or "embedding"
//! gravity = [0, -9.81]                        # in the ground frame; none by default
//! equilibrium = true                          # start in a static equilibrium; false by default
//!
//! [parameters]                                # what a study may vary
//! L = { default = 0.15, unit = "m" }
//!
//! [ground]
//! points = { wall = [1, 0] }                  # points may be named for later reference
//!
//! [bodies.rod]
//! mass = 0.3
//! inertia = "0.3*L^2/12"                      # about the centre of mass
//! position = [0, "-L/2"]                      # of the centre of mass at the start: a guess, made consistent
//! angle = 0
//! points = { top = [0, "L/2"] }               # from the centre of mass, in the body's frame
//!
//! [joints.pivot]
//! type = "revolute"                           # or "prismatic" with an axis, or "fixed"
//! between = ["ground", "rod.top"]
//!
//! [springs.damper]
//! coordinate = "pivot.angle"                  # or `between` two points
//! damping = 0.01                              # stiffness, damping, rest: 0 where nothing is said; not negative
//!
//! [initial]                                   # kept exactly; the rest follows from the guesses and the joints
//! pivot.angle = 1.57
//! pivot.angular_velocity = 0
//!
//! [outputs]
//! theta = { measure = "pivot.angle" }
//! ```
//!
//! `[forces.NAME]` act on a `point` with a `force`, `[actuators.NAME]` along a `coordinate` with an `effort` (a force or a
//! torque); both may depend on `time` and on positions and velocities. `[drivers.NAME]` prescribe the `motion` of a
//! `coordinate`, an expression of the parameters and `time`, or its `acceleration`, which may depend on what efforts may. `[tables.NAME]` are
//! functions of one or two variables for all expressions: `"-20*cam(shaft.angle)"`; `[variables]` are expressions with a name.
//! `[states.NAME]` change with a `rate`, as the current of a motor does.
//! `[couplings.NAME]` hold a `coordinate` at a function of others: gears, racks, cams. `[stops.NAME]` limit a `coordinate`, `[bushings.NAME]`
//! are springs in all directions `between` two points, and `[contacts.NAME]` keep a `point` on one side of a `line`.

use super::expression::Expression;
use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A vector in the plane.
pub type PlaneVector = [Expression; 2];

/// A mechanism file's content.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
    /// Formulation of the equations of motion.
    #[serde(default)]
    pub formulation: FormulationKind,
    /// Start in the static equilibrium to which the forces lead from the guesses of positions. Inputs and states have their values of the
    /// start. Positions of `[initial]`, and those that drivers accelerate, are kept.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub equilibrium: bool,
    /// Acceleration of gravity in the ground frame.
    #[schemars(extend("x-unit" = "m/s²"))]
    #[serde(default)]
    pub gravity: PlaneVector,
    /// Parameters that a study may vary.
    #[serde(default)]
    pub parameters: IndexMap<String, MechanismParameter>,
    /// Inputs that act on the mechanism while it runs; forces, efforts and accelerations of drivers may name them.
    #[serde(default)]
    pub inputs: IndexMap<String, MechanismInput>,
    /// Functions of one or two variables by their values at some points; expressions may call them.
    #[serde(default)]
    pub tables: IndexMap<String, TableOptions>,
    /// Expressions with a name, for other expressions.
    #[serde(default)]
    pub variables: IndexMap<String, Expression>,
    /// The ground, which does not move.
    #[serde(default)]
    pub ground: GroundOptions,
    /// Rigid bodies.
    pub bodies: IndexMap<String, BodyOptions>,
    /// Joints.
    #[serde(default)]
    pub joints: IndexMap<String, JointOptions>,
    /// Coordinates that follow others: gears, racks, cams.
    #[serde(default)]
    pub couplings: IndexMap<String, CouplingOptions>,
    /// Prescribed motion.
    #[serde(default)]
    pub drivers: IndexMap<String, DriverOptions>,
    /// Springs and dampers.
    #[serde(default)]
    pub springs: IndexMap<String, SpringOptions>,
    /// Springs and dampers in all directions between two points.
    #[serde(default)]
    pub bushings: IndexMap<String, BushingOptions>,
    /// Limits of coordinates.
    #[serde(default)]
    pub stops: IndexMap<String, StopOptions>,
    /// Points and circles that touch lines.
    #[serde(default)]
    pub contacts: IndexMap<String, ContactOptions>,
    /// Forces at points.
    #[serde(default)]
    pub forces: IndexMap<String, ForceOptions>,
    /// Forces and torques along coordinates.
    #[serde(default)]
    pub actuators: IndexMap<String, ActuatorOptions>,
    /// States of actuators and controllers: currents, pressures, integrals of an error; forces, efforts and accelerations may name them.
    #[serde(default)]
    pub states: IndexMap<String, ActuatorStateOptions>,
    /// Coordinates and velocities at the start, by the name of what they belong to and their own.
    #[serde(default)]
    pub initial: IndexMap<String, IndexMap<String, Expression>>,
    /// Outputs that a study may use.
    pub outputs: IndexMap<String, MechanismOutput>,
}

/// Formulation of the equations of motion (Choi et al. 2021, section 2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FormulationKind {
    /// All coordinates with Lagrange multipliers.
    #[default]
    Augmented,
    /// Independent coordinates only.
    Embedding,
}

/// An entry of `[parameters]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"default": 0.15, "unit": "m"}]))]
pub struct MechanismParameter {
    /// Value if the study does not set it; within the range if there is one.
    pub default: f64,
    /// Lower end of the range that `metafmu new` proposes; there are both ends or none.
    pub min: Option<f64>,
    /// Upper end of the range that `metafmu new` proposes.
    pub max: Option<f64>,
    /// Unit.
    #[serde(default)]
    pub unit: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
}

/// An entry of `[inputs]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"min": -10, "max": 10, "unit": "N"}]))]
pub struct MechanismInput {
    /// Value that it keeps where no signal is given, in runs of a study for instance; within the range.
    #[serde(default)]
    pub start: f64,
    /// Lower end of its range.
    pub min: f64,
    /// Upper end of its range.
    pub max: f64,
    /// Unit.
    #[serde(default)]
    pub unit: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
}

/// An entry of `[tables]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"x": [0, 1, 2], "values": [0, 0.5, 2]}]))]
pub struct TableOptions {
    /// CSV or Parquet file with the knots and the values, in the place of `x` and `values`; relative to the mechanism file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Columns of the knots and of the values in the file; the first two unless given. Three make a table of two arguments, which has a row for
    /// each pair of knots, in any order.
    #[schemars(extend("minItems" = 2, "maxItems" = 3))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<Vec<String>>,
    /// Knots of the first argument, ascending; two or more.
    #[serde(default)]
    pub x: Vec<f64>,
    /// Knots of the second argument, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y: Option<Vec<f64>>,
    /// A value for each knot; with `y` a list for each `x`, of a value for each `y`.
    #[serde(default)]
    pub values: Vec<TableValues>,
    /// Interpolation between the knots.
    #[serde(default)]
    pub interpolation: InterpolationKind,
    /// Values beyond the first and the last knot.
    #[serde(default)]
    pub extrapolation: ExtrapolationKind,
}

/// Values at a knot of the first argument.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum TableValues {
    /// The value.
    One(f64),
    /// A value for each knot of the second argument.
    Row(Vec<f64>),
}

/// Interpolation between knots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum InterpolationKind {
    /// On straight lines.
    #[default]
    Linear,
    /// On a spline with continuous second derivatives, whose ends are free ("not-a-knot").
    Cubic,
}

/// Values beyond the first and the last knot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ExtrapolationKind {
    /// The value at the end.
    #[default]
    Hold,
    /// The tangent at the end.
    Linear,
    /// The table repeats itself; the values at both ends are equal.
    Periodic,
}

/// `[ground]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroundOptions {
    /// Named points in the ground frame.
    #[serde(default)]
    #[schemars(extend("x-unit" = "m"))]
    pub points: IndexMap<String, PlaneVector>,
}

/// An entry of `[bodies]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BodyOptions {
    /// Mass; may be zero where the joints leave no motion without inertia.
    #[schemars(extend("x-unit" = "kg", "minimum" = 0))]
    #[serde(default)]
    pub mass: Expression,
    /// Moment of inertia about the centre of mass; zero for a point mass.
    #[schemars(extend("x-unit" = "kg.m²", "minimum" = 0))]
    #[serde(default)]
    pub inertia: Expression,
    /// Centre of mass at the start.
    #[schemars(extend("x-unit" = "m"))]
    #[serde(default)]
    pub position: PlaneVector,
    /// Angle at the start.
    #[schemars(extend("x-unit" = "rad"))]
    #[serde(default)]
    pub angle: Expression,
    /// Velocity of the centre of mass at the start.
    #[schemars(extend("x-unit" = "m/s"))]
    #[serde(default)]
    pub velocity: PlaneVector,
    /// Angular velocity at the start.
    #[schemars(extend("x-unit" = "rad/s"))]
    #[serde(default)]
    pub angular_velocity: Expression,
    /// Named points, from the centre of mass in the body's frame.
    #[schemars(extend("x-unit" = "m"))]
    #[serde(default)]
    pub points: IndexMap<String, PlaneVector>,
}

/// An entry of `[joints]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointOptions {
    /// Kind of joint.
    #[serde(rename = "type")]
    pub joint: JointType,
    /// The points it connects.
    pub between: [String; 2],
    /// Prismatic: direction of the slide in the frame of the first point's body.
    pub axis: Option<PlaneVector>,
    /// Prismatic and fixed: angle of the second body against the first.
    #[schemars(extend("x-unit" = "rad"))]
    pub angle: Option<Expression>,
}

/// Motion that a joint leaves free; see [`super::joints`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum JointType {
    /// Rotation about the common point.
    Revolute,
    /// Translation along the axis.
    Prismatic,
    /// Nothing.
    Fixed,
}

impl JointType {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Revolute, Self::Prismatic, Self::Fixed];

    /// As in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Revolute => "revolute",
            Self::Prismatic => "prismatic",
            Self::Fixed => "fixed",
        }
    }
}

/// An entry of `[drivers]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DriverOptions {
    /// The coordinate that is prescribed.
    pub coordinate: String,
    /// Its value, of the parameters and `time`.
    pub motion: Option<Expression>,
    /// Or its second derivative, of the parameters, inputs, `time`, positions and velocities; the coordinate continues
    /// from its value and rate at the start.
    #[schemars(extend("x-unit" = "m/s² or rad/s²"))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<Expression>,
}

/// An entry of `[springs]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpringOptions {
    /// Ends of a spring that acts along their distance.
    pub between: Option<[String; 2]>,
    /// Coordinate along which a spring without ends acts, an angle for instance.
    pub coordinate: Option<String>,
    /// Force or torque per length or angle; zero or more, as the `rest` of a spring `between` two points.
    #[schemars(extend("x-unit" = "N/m or N.m/rad", "minimum" = 0))]
    #[serde(default)]
    pub stiffness: Expression,
    /// Force or torque per velocity; zero or more.
    #[schemars(extend("x-unit" = "N.s/m or N.m.s/rad", "minimum" = 0))]
    #[serde(default)]
    pub damping: Expression,
    /// Length or angle at which there is no force.
    #[schemars(extend("x-unit" = "m or rad"))]
    #[serde(default)]
    pub rest: Expression,
    /// Further force or torque, positive where it increases the length or the angle; of the parameters, inputs, `time`, positions and
    /// velocities.
    #[schemars(extend("x-unit" = "N or N.m"))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force: Option<Expression>,
}

/// An entry of `[couplings]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"coordinate": "rack.position", "follows": "r*pinion.angle"}]))]
pub struct CouplingOptions {
    /// The coordinate that is held.
    pub coordinate: String,
    /// Its value, of the parameters and of other positions.
    #[schemars(extend("x-unit" = "m or rad"))]
    pub follows: Expression,
}

/// An entry of `[bushings]`: in the frame of the first point's body, springs and dampers along `x` and `y`, and one of the angle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BushingOptions {
    /// The points it connects.
    pub between: [String; 2],
    /// Along `x` and `y`, and about the point; zero or more.
    #[schemars(extend("x-unit" = "N/m, N/m and N.m/rad"))]
    pub stiffness: [Expression; 3],
    /// Along `x` and `y`, and about the point; zero or more.
    #[schemars(extend("x-unit" = "N.s/m, N.s/m and N.m.s/rad"))]
    #[serde(default)]
    pub damping: [Expression; 3],
    /// Angle of the second body against the first at which there is no moment.
    #[schemars(extend("x-unit" = "rad"))]
    #[serde(default)]
    pub angle: Expression,
}

/// An entry of `[stops]`: beyond a limit by `d`, the force back is `stiffness d (1 + damping d')`, and never pulls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"coordinate": "rail.position", "min": -0.5, "max": 0.5, "stiffness": 1e5}]))]
pub struct StopOptions {
    /// The coordinate that is limited.
    pub coordinate: String,
    /// Lower limit; there is one limit or both.
    #[schemars(extend("x-unit" = "m or rad"))]
    pub min: Option<Expression>,
    /// Upper limit.
    #[schemars(extend("x-unit" = "m or rad"))]
    pub max: Option<Expression>,
    /// Force or torque per length or angle beyond a limit.
    #[schemars(extend("x-unit" = "N/m or N.m/rad"))]
    pub stiffness: Expression,
    /// Share by which a unit of speed into the stop raises the force; zero or more.
    #[schemars(extend("x-unit" = "s/m or s/rad", "minimum" = 0))]
    #[serde(default)]
    pub damping: Expression,
}

/// An entry of `[contacts]`: a point or a circle about it stays on the left of a line. With `d` the depth beyond the line, the normal force is
/// `stiffness d (1 + damping d')`, which never pulls; friction is `friction` times that force, times `tanh(v/slip)` of the sliding speed `v`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"point": "wheel", "line": ["ground", "ground.right"], "radius": 0.3, "stiffness": 2e5, "friction": 0.9, "slip": 0.05}]))]
pub struct ContactOptions {
    /// The point, or the centre of the circle.
    pub point: String,
    /// Two points of another body or of the ground through which the line passes. The line is infinite; its left is that of somebody who looks from
    /// the first point to the second.
    pub line: [String; 2],
    /// Radius of the circle; zero for a point.
    #[schemars(extend("x-unit" = "m", "minimum" = 0))]
    #[serde(default)]
    pub radius: Expression,
    /// Force per depth.
    #[schemars(extend("x-unit" = "N/m", "minimum" = 0))]
    pub stiffness: Expression,
    /// Share by which a unit of speed into the line raises the normal force; zero or more.
    #[schemars(extend("x-unit" = "s/m", "minimum" = 0))]
    #[serde(default)]
    pub damping: Expression,
    /// Coefficient of friction.
    #[schemars(extend("minimum" = 0))]
    #[serde(default)]
    pub friction: Expression,
    /// Sliding speed at which friction has 76 % of its largest value: below it the contact creeps; required with `friction`.
    #[schemars(extend("x-unit" = "m/s"))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slip: Option<Expression>,
}

/// An entry of `[forces]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceOptions {
    /// Point of application.
    pub point: String,
    /// Components in the ground frame; of the parameters, `time`, positions and velocities.
    #[schemars(extend("x-unit" = "N"))]
    pub force: PlaneVector,
}

/// An entry of `[actuators]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActuatorOptions {
    /// The coordinate along which it acts.
    pub coordinate: String,
    /// Force or torque, positive where it increases the coordinate; of the parameters, `time`, positions and
    /// velocities.
    #[schemars(extend("x-unit" = "N or N.m"))]
    pub effort: Expression,
}

/// An entry of `[states]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"rate": "(u - R*current - k*shaft.angular_velocity)/L", "unit": "A"}]))]
pub struct ActuatorStateOptions {
    /// Derivative with respect to time, of the parameters, inputs, states, `time`, positions and velocities.
    pub rate: Expression,
    /// Value at the start, of the parameters.
    #[serde(default)]
    pub start: Expression,
    /// Unit.
    #[serde(default)]
    pub unit: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
}

/// An entry of `[outputs]`: a measure, or a formula.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"measure": "rod.angle"}]))]
pub struct MechanismOutput {
    /// Name of a measure or of an actuator state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measure: Option<String>,
    /// Or an expression of the parameters, inputs, states, `time`, positions and velocities.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub formula: Option<Expression>,
    /// Unit; must be the measure's own.
    pub unit: Option<String>,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
}
