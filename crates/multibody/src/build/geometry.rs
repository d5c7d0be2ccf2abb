//! The points of a mechanism that a picture shows: of links, joints, springs and contacts.

use super::MultibodyBuilder;
use crate::{coordinate::BodyPoint, description::Description, description::JointType};
use nalgebra::Vector2;

/// Points of a mechanism with a value for each parameter, as a picture of it needs them.
#[derive(Clone, Debug, PartialEq)]
pub struct MechanismGeometry {
    /// For each body the points at which something acts, in its frame, in m; without any, its other named points.
    pub links: Vec<Vec<Vector2<f64>>>,
    /// Joints.
    pub joints: Vec<JointGeometry>,
    /// Ends of springs, dampers and bushings between two points.
    pub springs: Vec<[BodyPoint; 2]>,
    /// Contacts: the point, its radius in m, and two points of the line.
    pub contacts: Vec<(BodyPoint, f64, [BodyPoint; 2])>,
}

/// A joint in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointGeometry {
    /// Kind of joint.
    pub kind: JointType,
    /// Points of the first and the second body.
    pub ends: [BodyPoint; 2],
    /// Direction of the slide in the frame of the first body, of a prismatic joint.
    pub axis: Vector2<f64>,
}

/// The geometry of a description; none if it cannot be built of these values.
pub fn geometry(description: &Description, values: &[f64]) -> Option<MechanismGeometry> {
    let mut builder = MultibodyBuilder::new(description, values);
    let mut joints = Vec::new();
    for (name, options) in &description.joints {
        let (ends, axis) = (points(&mut builder, &options.between)?, builder.axis(name, options));
        joints.push(JointGeometry { kind: options.joint, ends, axis });
    }
    let springs = description.springs.values().filter_map(|spring| spring.between.as_ref());
    let bushings = description.bushings.values().map(|bushing| &bushing.between);
    let springs = springs.chain(bushings).map(|ends| points(&mut builder, ends)).collect::<Option<Vec<_>>>()?;
    let mut contacts = Vec::new();
    for (name, contact) in &description.contacts {
        let (point, line) = (builder.point(&contact.point).ok()?, points(&mut builder, &contact.line)?);
        contacts.push((point, builder.number(&format!("contacts.{name}.radius"), &contact.radius), line));
    }
    let mut links = vec![Vec::new(); description.bodies.len()];
    let acting = joints.iter().flat_map(|joint| joint.ends).chain(springs.iter().flatten().copied());
    for BodyPoint { frame, local } in acting.chain(contacts.iter().map(|(point, ..)| *point)) {
        if let Some(body) = frame {
            links[body].push(local);
        }
    }
    for ((name, body), link) in description.bodies.iter().zip(&mut links) {
        // a body on one joint reaches to its centre of mass
        if link.len() < 2 {
            link.push(Vector2::zeros());
        }
        if link.len() < 2 {
            let points = body.points.iter();
            link.extend(points.map(|(point, at)| builder.vector(&format!("bodies.{name}.points.{point}"), at)));
        }
        let mut different: Vec<Vector2<f64>> = Vec::new();
        for point in link.drain(..) {
            if different.iter().all(|other| *other != point) {
                different.push(point);
            }
        }
        *link = different;
    }
    builder.problems.is_empty().then_some(MechanismGeometry { links, joints, springs, contacts })
}

/// The two points with these names.
fn points(builder: &mut MultibodyBuilder, [from, to]: &[String; 2]) -> Option<[BodyPoint; 2]> {
    Some([builder.point(from).ok()?, builder.point(to).ok()?])
}
