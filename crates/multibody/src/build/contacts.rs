//! Contacts of points and circles with lines.

use super::{MultibodyBuilder, NameError, Scope};
use crate::{
    coordinate::{BodyPoint, Coordinate},
    description::ContactOptions,
    expression::{Expression, ExpressionError},
    measure::Measure,
    model::Effort,
    review::is_zero,
};
use nalgebra::Vector2;
use std::{error::Error, fmt};

/// Forces on the body of a contact's point, as expressions.
struct ContactForces {
    /// To the left of the line.
    normal: String,
    /// Along the line.
    friction: String,
}

impl ContactForces {
    fn new(name: &str, ContactOptions { radius, stiffness, damping, friction, slip, .. }: &ContactOptions) -> Self {
        let normal = format!("({stiffness})*max(({radius}) - {name}.y, 0)*max(1 - ({damping})*{name}.vy, 0)");
        let friction = match slip {
            Some(slip) if !is_zero(friction) => {
                let speed = format!("({name}.vx + ({radius})*{name}.angular_velocity)");
                format!("-({friction})*{normal}*tanh({speed}/({slip}))")
            }
            _ => "0".into(),
        };
        Self { normal, friction }
    }
}

/// Names of a contact's measures: forces, then positions, then their rates.
const MEASURES: [&str; 8] = ["fx", "fy", "x", "y", "angle", "vx", "vy", "angular_velocity"];

/// Reason why a contact has no coordinates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ContactError {
    /// Key of the contact that is wrong: `point` or `line`.
    field: &'static str,
    message: String,
}

impl fmt::Display for ContactError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl Error for ContactError {}

impl From<ContactError> for NameError {
    fn from(error: ContactError) -> Self {
        Self::BrokenContact(error)
    }
}

impl MultibodyBuilder<'_> {
    /// Where the point is from the line's first point: along the line, to its left, and the angle of its body against that of the line.
    fn contact_coordinates(&mut self, name: &str) -> Result<[Coordinate; 3], ContactError> {
        let options = &self.description.contacts[name];
        let point = self.contact_point("point", &options.point)?;
        let [from, to] = &options.line;
        let [from, to] = [self.contact_point("line", from)?, self.contact_point("line", to)?];
        if from.frame != to.frame {
            let message = "the points belong to two bodies, expected two of the same one".into();
            return Err(ContactError { field: "line", message });
        }
        if point.frame == from.frame {
            let owner = if point.frame.is_some() { "the same body" } else { "the ground" };
            return Err(ContactError { field: "point", message: format!("point and line belong to {owner}") });
        }
        let length = (to.local - from.local).norm();
        if length == 0.0 {
            let message = "both points are in the same place, expected a direction".into();
            return Err(ContactError { field: "line", message });
        }
        let along = (to.local - from.local) / length;
        let [x, y] = [along, Vector2::new(-along.y, along.x)].map(|axis| Coordinate::Projection {
            from,
            to: point,
            frame: from.frame,
            axis,
        });
        let angle = Coordinate::Angle { from: from.frame, to: point.frame };
        Ok([x, y, angle])
    }

    /// Point that a key of a contact names.
    fn contact_point(&mut self, field: &'static str, name: &str) -> Result<BodyPoint, ContactError> {
        self.point(name).map_err(|error| ContactError { field, message: error.to_string() })
    }

    /// Position or velocity that a contact measures.
    ///
    /// # Errors
    /// The known names, or the reason why the contact does not exist.
    pub(super) fn contact_measure(&mut self, name: &str, what: &str) -> Result<Measure, NameError> {
        let [x, y, angle] = self.contact_coordinates(name)?;
        match what {
            "x" => Ok(Measure::Position(x)),
            "y" => Ok(Measure::Position(y)),
            "angle" => Ok(Measure::Position(angle)),
            "vx" => Ok(Measure::Velocity(x)),
            "vy" => Ok(Measure::Velocity(y)),
            "angular_velocity" => Ok(Measure::Velocity(angle)),
            "fx" | "fy" => {
                let message = format!("`{name}.{what}` is a force, expected as the measure of an output");
                Err(NameError::OtherKind(message))
            }
            _ => Err(NameError::unknown_measure(name, what, &MEASURES)),
        }
    }

    /// The force that an output measures, if it is a contact's.
    pub(super) fn contact_force(&self, measure: &str) -> Option<Result<Expression, ExpressionError>> {
        let (name, what) = measure.rsplit_once('.')?;
        let forces = ContactForces::new(name, self.description.contacts.get(name)?);
        match what {
            "fx" => Some(Expression::parse(&forces.friction)),
            "fy" => Some(Expression::parse(&forces.normal)),
            _ => None,
        }
    }

    /// Forces of contacts: a normal force for each, then friction, and its moment about the centre of a circle.
    pub(super) fn contacts(&mut self) -> Vec<Effort> {
        let mut efforts = Vec::new();
        for (name, options) in &self.description.contacts {
            let owner = format!("contacts.{name}");
            let key = |field: &str| format!("{owner}.{field}");
            for (field, expression) in [
                ("radius", &options.radius),
                ("stiffness", &options.stiffness),
                ("damping", &options.damping),
                ("friction", &options.friction),
            ] {
                self.not_negative(&key(field), expression);
            }
            match &options.slip {
                Some(slip) => {
                    let speed = self.number(&key("slip"), slip);
                    if speed <= 0.0 {
                        self.problem(&key("slip"), format!("{speed}, expected a speed above zero"));
                    }
                }
                None if !is_zero(&options.friction) => {
                    let message =
                        "no `slip`, expected the speed at which friction is three quarters of its largest value";
                    self.problem(&owner, message.into());
                }
                None => {}
            }
            let [x, y, angle] = match self.contact_coordinates(name) {
                Ok(coordinates) => coordinates,
                Err(ContactError { field, message }) => {
                    self.problem(&key(field), message);
                    continue;
                }
            };
            let ContactForces { normal, friction } = ContactForces::new(name, options);
            let moment = format!("({})*{friction}", options.radius);
            let has_friction = friction != "0";
            let parts = [
                (y, normal, true),
                (x, friction, has_friction),
                (angle, moment, has_friction && !is_zero(&options.radius)),
            ];
            for (coordinate, text, _) in parts.into_iter().filter(|(.., acts)| *acts) {
                let Some(expression) = self.noted(&owner, Expression::parse(&text)) else { continue };
                let expression = self.bound(&owner, &expression, Scope::State);
                efforts.extend(expression.map(|expression| Effort { coordinate, expression, owner: owner.clone() }));
            }
        }
        efforts
    }
}
