//! Parts of a description that have no effect: usually mistakes.

use super::{
    description::{BodyOptions, ContactOptions, Description, PlaneVector, SpringOptions},
    expression::{Expression, Tables},
};
use crate::diagnostics::Problems;
use std::collections::BTreeSet;

/// Parts that have no effect although that is their only purpose: dotted keys and messages.
pub fn idle_parts(description: &Description) -> Problems {
    let names = Names::of(description);
    let mut problems = Problems::default();
    for (name, spring) in &description.springs {
        // a spring between two points is also a way to measure their distance
        if is_zero(&spring.stiffness) && is_zero(&spring.damping) && spring.force.is_none() && !names.has(name) {
            let message = "none of `stiffness`, `damping` and `force`, expected at least one of them";
            problems.add(format!("springs.{name}"), message);
        }
    }
    problems
}

/// Unusual parts of a description that may be intended: dotted keys and messages.
pub fn oddities(description: &Description) -> Problems {
    let names = Names::of(description);
    let Description {
        parameters, inputs, tables, variables, ground, bodies, springs, forces, actuators, states, ..
    } = description;
    let mut oddities = Problems::default();
    for name in parameters.keys().filter(|name| !names.values.contains(name.as_str())) {
        oddities.add(format!("parameters.{name}"), "nothing depends on it");
    }
    for name in inputs.keys().filter(|name| !names.values.contains(name.as_str())) {
        oddities.add(format!("inputs.{name}"), "no force, effort or acceleration depends on it");
    }
    for name in tables.keys().filter(|name| !names.tables.contains(name.as_str())) {
        oddities.add(format!("tables.{name}"), "no expression uses it");
    }
    for name in variables.keys().filter(|name| !names.values.contains(name.as_str())) {
        oddities.add(format!("variables.{name}"), "no expression uses it");
    }
    for name in states.keys().filter(|name| !names.values.contains(name.as_str())) {
        oddities.add(format!("states.{name}"), "no expression and no output uses it");
    }
    for point in ground.points.keys().filter(|point| !names.has(&format!("ground.{point}"))) {
        oddities.add(format!("ground.points.{point}"), "nothing uses this point");
    }
    for (name, BodyOptions { points, .. }) in bodies {
        if !names.holds_or_moves(name) {
            oddities.add(format!("bodies.{name}"), "no joint, spring, force or actuator is attached to it");
        }
        for point in points.keys().filter(|point| !names.has(&format!("{name}.{point}"))) {
            oddities.add(format!("bodies.{name}.points.{point}"), "nothing uses this point");
        }
    }
    for (name, SpringOptions { stiffness, rest, .. }) in springs {
        if is_zero(stiffness) && !is_zero(rest) {
            oddities.add(format!("springs.{name}.rest"), "has no effect without `stiffness`");
        }
    }
    for (name, _) in forces.iter().filter(|(_, force)| force.force.iter().all(is_zero)) {
        oddities.add(format!("forces.{name}.force"), "is zero: it has no effect");
    }
    for (name, _) in actuators.iter().filter(|(_, actuator)| is_zero(&actuator.effort)) {
        oddities.add(format!("actuators.{name}.effort"), "is zero: it has no effect");
    }
    oddities
}

/// Zero for any parameters.
pub(super) fn is_zero(expression: &Expression) -> bool {
    let formula = expression.formula(&Tables::new()).ok().filter(|_| expression.names().is_empty());
    formula.is_some_and(|formula| formula.value(|_| f64::NAN) == 0.0)
}

/// Names used in a description.
struct Names<'a> {
    /// In expressions: parameters, inputs, `time`, coordinates.
    values: BTreeSet<&'a str>,
    /// Tables in expressions.
    tables: BTreeSet<&'a str>,
    /// Points, coordinates and measures, wherever they are named.
    parts: Vec<String>,
    /// Points between which something acts, and where it acts.
    attached: Vec<&'a str>,
}

impl<'a> Names<'a> {
    fn of(description: &'a Description) -> Self {
        let Description {
            joints,
            couplings,
            drivers,
            springs,
            bushings,
            stops,
            contacts,
            forces,
            actuators,
            initial,
            outputs,
            states,
            ..
        } = description;
        let expressions = expressions(description).into_iter();
        let tables = expressions.clone().flat_map(Expression::tables).collect();
        let values = expressions.flat_map(Expression::names);
        let shown =
            outputs.values().filter_map(|output| output.measure.as_ref()).filter(|name| states.contains_key(*name));
        let values: BTreeSet<&str> = values.chain(shown).map(String::as_str).collect();
        let ends = joints.values().map(|joint| &joint.between);
        let ends = ends.chain(springs.values().filter_map(|spring| spring.between.as_ref()));
        let ends = ends.chain(bushings.values().map(|bushing| &bushing.between)).flatten();
        let mut attached: Vec<&str> = ends.map(String::as_str).collect();
        attached.extend(forces.values().map(|force| force.point.as_str()));
        attached.extend(couplings.values().map(|coupling| coupling.coordinate.as_str()));
        attached.extend(stops.values().map(|stop| stop.coordinate.as_str()));
        attached.extend(
            contacts.values().flat_map(|contact| contact.line.iter().chain([&contact.point])).map(String::as_str),
        );
        attached.extend(drivers.values().map(|driver| driver.coordinate.as_str()));
        attached.extend(springs.values().filter_map(|spring| spring.coordinate.as_deref()));
        attached.extend(actuators.values().map(|actuator| actuator.coordinate.as_str()));
        let conditions = initial.iter().flat_map(|(owner, of)| of.keys().map(move |what| format!("{owner}.{what}")));
        let measured = outputs.values().filter_map(|output| output.measure.clone());
        let named = attached.iter().chain(&values).map(|name| (*name).to_owned());
        Self { parts: named.chain(conditions).chain(measured).collect(), values, tables, attached }
    }

    /// Returns true if a name refers to the part or point, or to a measure of it.
    fn has(&self, part: &str) -> bool {
        self.parts.iter().any(|name| is_of(name, part))
    }

    /// Returns true if something acts on the body.
    fn holds_or_moves(&self, body: &str) -> bool {
        self.attached.iter().any(|name| is_of(name, body))
    }
}

/// Returns true if a name is that of the part, or continues it after a dot.
fn is_of(name: &str, part: &str) -> bool {
    name.strip_prefix(part).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

fn expressions(description: &Description) -> Vec<&Expression> {
    let Description {
        gravity, variables, ground, bodies, joints, couplings, drivers, springs, bushings, stops, ..
    } = description;
    let Description { contacts, forces, actuators, states, initial, outputs, .. } = description;
    let mut all: Vec<&Expression> =
        gravity.iter().chain(variables.values()).chain(ground.points.values().flatten()).collect();
    for BodyOptions { mass, inertia, position, angle, velocity, angular_velocity, points } in bodies.values() {
        all.extend([mass, inertia, angle, angular_velocity]);
        all.extend([position, velocity].into_iter().chain(points.values()).flat_map(|vector: &PlaneVector| vector));
    }
    for joint in joints.values() {
        all.extend(joint.axis.iter().flatten().chain(&joint.angle));
    }
    all.extend(drivers.values().flat_map(|driver| driver.motion.iter().chain(&driver.acceleration)));
    all.extend(couplings.values().map(|coupling| &coupling.follows));
    for spring in springs.values() {
        all.extend([&spring.stiffness, &spring.damping, &spring.rest].into_iter().chain(&spring.force));
    }
    all.extend(
        bushings.values().flat_map(|bushing| bushing.stiffness.iter().chain(&bushing.damping).chain([&bushing.angle])),
    );
    all.extend(
        stops.values().flat_map(|stop| stop.min.iter().chain(&stop.max).chain([&stop.stiffness, &stop.damping])),
    );
    for ContactOptions { radius, stiffness, damping, friction, slip, .. } in contacts.values() {
        all.extend([radius, stiffness, damping, friction].into_iter().chain(slip));
    }
    all.extend(forces.values().flat_map(|force| &force.force));
    all.extend(actuators.values().map(|actuator| &actuator.effort));
    all.extend(states.values().flat_map(|state| [&state.rate, &state.start]));
    all.extend(outputs.values().filter_map(|output| output.formula.as_ref()));
    all.extend(initial.values().flat_map(|of| of.values()));
    all
}
