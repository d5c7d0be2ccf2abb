//! Names in a mechanism file: measures, coordinates and points.

use super::{MultibodyBuilder, contacts::ContactError, forces::bushing_coordinates};
use crate::{
    coordinate::{BodyPoint, Coordinate, Frame},
    description::{BushingOptions, SpringOptions},
    diagnostics::names::expected_one_of,
    joints::{Driver, Measures},
    measure::Measure,
};
use nalgebra::Vector2;
use std::fmt;

/// Reason why a name is not the measure, coordinate or point that is needed, as text with the name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum NameError {
    /// The description has nothing of this name.
    Unknown(String),
    /// The name is that of something else, for instance of a force and not of a position.
    OtherKind(String),
    /// The contact that the measure belongs to is itself wrong.
    BrokenContact(ContactError),
}

impl NameError {
    /// Error of a part without a measure of this name.
    pub(super) fn unknown_measure(owner: &str, what: &str, known: &[&str]) -> Self {
        Self::Unknown(format!("`{owner}` has no `{what}`, {}", expected_one_of(what, known)))
    }
}

impl fmt::Display for NameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(message) | Self::OtherKind(message) => f.write_str(message),
            Self::BrokenContact(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for NameError {}

/// Measures of points.
const POINT_MEASURES: [&str; 6] = ["x", "y", "vx", "vy", "ax", "ay"];

/// Further measures of bodies.
const BODY_MEASURES: [&str; 3] = ["angle", "angular_velocity", "angular_acceleration"];

/// The measure of this name among those of a part.
fn one_of(owner: &str, what: &str, measures: Measures) -> Result<Measure, NameError> {
    let known: Vec<&str> = measures.iter().map(|(name, _)| *name).collect();
    let unknown = NameError::unknown_measure(owner, what, &known);
    measures.into_iter().find(|(name, _)| *name == what).map(|(_, measure)| measure).ok_or(unknown)
}

impl MultibodyBuilder<'_> {
    /// Resolves the name of a measure; see [`super::measure`].
    pub(super) fn measure(&mut self, name: &str) -> Result<Measure, NameError> {
        match name {
            "kinetic_energy" => return Ok(Measure::KineticEnergy),
            "potential_energy" => return Ok(Measure::PotentialEnergy),
            _ => {}
        }
        let description = self.description;
        let Some((owner, what)) = name.rsplit_once('.') else {
            let known: Vec<&str> = description.states.keys().map(String::as_str).collect();
            let known = if known.is_empty() { String::new() } else { format!(", {}", expected_one_of(name, &known)) };
            let message = format!("`{name}` is not a measure, expected for instance `BODY.angle`{known}");
            return Err(NameError::Unknown(message));
        };
        if let Some(index) = description.joints.get_index_of(owner) {
            return one_of(owner, what, self.joints[index].measures(self.joint_rows(index)));
        }
        if let Some((index, _, spring)) = description.springs.get_full(owner) {
            return self.spring_measure(owner, what, index, spring);
        }
        if let Some((index, _, bushing)) = description.bushings.get_full(owner) {
            return self.bushing_measure(owner, what, index, bushing);
        }
        if description.contacts.contains_key(owner) {
            return self.contact_measure(owner, what);
        }
        if let Some(index) = description.couplings.get_index_of(owner) {
            return one_of(owner, what, Driver::measures(self.joint_rows(self.joints.len()).start + index));
        }
        if let Some(index) = description.drivers.get_index_of(owner) {
            return one_of(owner, what, Driver::measures(self.driver_row(index)));
        }
        if !owner.contains('.') && owner != "ground" && !description.bodies.contains_key(owner) {
            let (joints, bodies) = (description.joints.keys(), description.bodies.keys());
            let names = joints.chain(bodies).chain(description.springs.keys()).chain(description.drivers.keys());
            let known: Vec<&str> = names.map(String::as_str).chain(["ground"]).collect();
            let message = format!("no joint or body `{owner}`, {}", expected_one_of(owner, &known));
            return Err(NameError::Unknown(message));
        }
        self.point_measure(owner, what)
    }

    fn spring_measure(
        &mut self,
        name: &str,
        what: &str,
        index: usize,
        spring: &SpringOptions,
    ) -> Result<Measure, NameError> {
        let ends = spring.between.as_ref().map(|[from, to]| Ok::<_, NameError>([self.point(from)?, self.point(to)?]));
        let distance = ends.transpose()?.map(|[from, to]| Coordinate::Distance { from, to });
        match (what, distance) {
            ("force", _) => Ok(Measure::SpringEffort(index)),
            ("length", Some(distance)) => Ok(Measure::Position(distance)),
            ("velocity", Some(distance)) => Ok(Measure::Velocity(distance)),
            (_, Some(_)) => Err(NameError::unknown_measure(name, what, &["length", "velocity", "force"])),
            (_, None) => Err(NameError::unknown_measure(name, what, &["force"])),
        }
    }

    fn bushing_measure(
        &mut self,
        name: &str,
        what: &str,
        index: usize,
        bushing: &BushingOptions,
    ) -> Result<Measure, NameError> {
        let springs = (self.description.springs.len() + 3 * index..).map(Measure::SpringEffort);
        let [from, to] = [self.point(&bushing.between[0])?, self.point(&bushing.between[1])?];
        let positions = bushing_coordinates([from, to]);
        let positions = positions.map(Measure::Position).into_iter().chain(positions.map(Measure::Velocity));
        let names = ["fx", "fy", "moment", "x", "y", "angle", "vx", "vy", "angular_velocity"];
        one_of(name, what, names.into_iter().zip(springs.take(3).chain(positions)).collect())
    }

    /// A measure of a point; a body has more of them.
    fn point_measure(&mut self, owner: &str, what: &str) -> Result<Measure, NameError> {
        let (description, point) = (self.description, self.point(owner)?);
        let (x, y) = (Coordinate::component(point, 0), Coordinate::component(point, 1));
        let body = description.bodies.get_index_of(owner);
        let angle = Coordinate::Angle { from: None, to: body };
        match (what, body) {
            ("x", _) => Ok(Measure::Position(x)),
            ("y", _) => Ok(Measure::Position(y)),
            ("vx", _) => Ok(Measure::Velocity(x)),
            ("vy", _) => Ok(Measure::Velocity(y)),
            ("ax", _) => Ok(Measure::Acceleration(x)),
            ("ay", _) => Ok(Measure::Acceleration(y)),
            ("angle", Some(_)) => Ok(Measure::Position(angle)),
            ("angular_velocity", Some(_)) => Ok(Measure::Velocity(angle)),
            ("angular_acceleration", Some(_)) => Ok(Measure::Acceleration(angle)),
            (_, Some(body)) if description.bodies[body].points.contains_key(what) => {
                let message = format!("`{owner}.{what}` is a point, expected a component such as `{owner}.{what}.x`");
                Err(NameError::OtherKind(message))
            }
            (_, Some(_)) => {
                let known = [&POINT_MEASURES[..], &BODY_MEASURES].concat();
                Err(NameError::unknown_measure(owner, what, &known))
            }
            (_, None) => Err(NameError::unknown_measure(owner, what, &POINT_MEASURES)),
        }
    }

    /// Resolves the name of a coordinate of a body.
    pub(super) fn coordinate(&mut self, name: &str) -> Result<Coordinate, NameError> {
        match self.measure(name)? {
            Measure::Position(coordinate) if !coordinate.is_of_body() && !self.is_broken_joint(name) => {
                let message = format!("`{name}` belongs to the ground, expected a coordinate of a body");
                Err(NameError::OtherKind(message))
            }
            Measure::Position(coordinate) => Ok(coordinate),
            _ => {
                let message = format!("`{name}` is not a position, expected for instance `BODY.angle`");
                Err(NameError::OtherKind(message))
            }
        }
    }

    /// Returns true if a coordinate belongs to a joint whose points are unknown, so that nothing follows from its
    /// value.
    fn is_broken_joint(&self, coordinate: &str) -> bool {
        let owner = coordinate.rsplit_once('.').map_or("", |(owner, _)| owner);
        let key = format!("joints.{owner}.between");
        self.problems.iter().any(|known| known.key == key)
    }

    /// `ground`, `ground.POINT`, `BODY` (its centre of mass) or `BODY.POINT`.
    pub(super) fn point(&mut self, name: &str) -> Result<BodyPoint, NameError> {
        let description = self.description;
        let (owner, point) = name.split_once('.').map_or((name, None), |(owner, point)| (owner, Some(point)));
        let (frame, points): (Frame, _) = match description.bodies.get_full(owner) {
            Some((index, _, body)) => (Some(index), &body.points),
            None if owner == "ground" => (None, &description.ground.points),
            None => {
                let known: Vec<&str> = description.bodies.keys().map(String::as_str).chain(["ground"]).collect();
                let message = format!("no body `{owner}`, {}", expected_one_of(owner, &known));
                return Err(NameError::Unknown(message));
            }
        };
        let Some(point) = point else { return Ok(BodyPoint { frame, local: Vector2::zeros() }) };
        let Some(local) = points.get(point) else {
            let known: Vec<&str> = points.keys().map(String::as_str).collect();
            let message = format!("`{owner}` has no point `{point}`, {}", expected_one_of(point, &known));
            return Err(NameError::Unknown(message));
        };
        let key =
            if frame.is_some() { format!("bodies.{owner}.points.{point}") } else { format!("ground.points.{point}") };
        Ok(BodyPoint { frame, local: self.vector(&key, local) })
    }
}
