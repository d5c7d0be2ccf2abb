//! Springs, bushings, forces, actuators and stops of a model.

use super::{MultibodyBuilder, NameError, Scope, Torsion};
use crate::{
    constraint::BoundExpression,
    coordinate::{BodyPoint, Coordinate},
    description::StopOptions,
    expression::Expression,
    model::{Effort, Spring},
    review::is_zero,
};
use nalgebra::Vector2;

/// Name of the rate of a position.
fn rate_of(position: &str) -> Option<String> {
    let (owner, what) = position.rsplit_once('.')?;
    let rate = match what {
        "angle" => "angular_velocity",
        "position" | "length" => "velocity",
        "x" => "vx",
        "y" => "vy",
        _ => return None,
    };
    Some(format!("{owner}.{rate}"))
}

/// A spring of the description, or one of a bushing.
struct SpringPart<'a> {
    /// Its key in the description.
    owner: String,
    /// Name of the coordinate, if it is an angle.
    name: &'a str,
    stiffness: &'a Expression,
    damping: &'a Expression,
    /// Where there is no force, as a number and as it stands in the file.
    rest: (f64, &'a Expression),
    force: Option<&'a Expression>,
}

/// Along `x` and `y` of the first point's body, and the angle of the second against it.
pub(super) fn bushing_coordinates([from, to]: [BodyPoint; 2]) -> [Coordinate; 3] {
    let [x, y] = [Vector2::x(), Vector2::y()].map(|axis| Coordinate::Projection { from, to, frame: from.frame, axis });
    [x, y, Coordinate::Angle { from: from.frame, to: to.frame }]
}

impl MultibodyBuilder<'_> {
    /// Springs of the description, then three for each bushing; and the efforts besides their stiffness and damping.
    pub(super) fn springs(&mut self) -> (Vec<Spring>, Vec<Effort>) {
        let (mut springs, mut efforts) = (Vec::new(), Vec::new());
        for (name, spring) in &self.description.springs {
            let owner = format!("springs.{name}");
            let key = |field: &str| format!("{owner}.{field}");
            let is_length = spring.between.is_some();
            let rest = if is_length { Self::not_negative } else { Self::number }(self, &key("rest"), &spring.rest);
            let coordinate = match (&spring.between, &spring.coordinate) {
                (Some(between), None) => {
                    self.ends(&key("between"), between).map(|[from, to]| Coordinate::Distance { from, to })
                }
                (None, Some(coordinate)) => {
                    let coordinate = self.coordinate(coordinate);
                    self.noted(&key("coordinate"), coordinate)
                }
                _ => {
                    self.problem(&owner, "expected either `between` or `coordinate`".into());
                    None
                }
            };
            let part = SpringPart {
                owner,
                name: spring.coordinate.as_deref().unwrap_or_default(),
                stiffness: &spring.stiffness,
                damping: &spring.damping,
                rest: (rest, &spring.rest),
                force: spring.force.as_ref(),
            };
            self.spring(part, coordinate, &mut springs, &mut efforts);
        }
        for (name, bushing) in &self.description.bushings {
            let owner = format!("bushings.{name}");
            let ends = self.ends(&format!("{owner}.between"), &bushing.between);
            let angle = self.number(&format!("{owner}.angle"), &bushing.angle);
            let coordinates = ends.map(bushing_coordinates);
            let zero = Expression::default();
            let rests = [(0.0, &zero), (0.0, &zero), (angle, &bushing.angle)];
            for (k, rest) in rests.into_iter().enumerate() {
                let part = SpringPart {
                    owner: owner.clone(),
                    name: &format!("{name}.angle"),
                    stiffness: &bushing.stiffness[k],
                    damping: &bushing.damping[k],
                    rest,
                    force: None,
                };
                self.spring(part, coordinates.map(|of| of[k]), &mut springs, &mut efforts);
            }
        }
        (springs, efforts)
    }

    /// Adds a spring, and its force beside stiffness and damping, if it has one.
    fn spring(
        &mut self,
        part: SpringPart,
        coordinate: Option<Coordinate>,
        springs: &mut Vec<Spring>,
        efforts: &mut Vec<Effort>,
    ) {
        let SpringPart { owner, name, rest: (rest, free), .. } = part;
        let mut stiffness = self.not_negative(&format!("{owner}.stiffness"), part.stiffness);
        let damping = self.not_negative(&format!("{owner}.damping"), part.damping);
        let mut force = part.force.cloned();
        let Some(coordinate) = coordinate else { return };
        if self.torsion == Torsion::AsForces && coordinate.is_angle() && !is_zero(part.stiffness) {
            let further = force.map_or(String::new(), |force| format!(" + ({force})"));
            let text = format!("-({})*({name} - ({free})){further}", part.stiffness);
            (force, stiffness) = (self.noted(&owner, Expression::parse(&text)), 0.0);
        }
        let expression = force.and_then(|force| self.bound(&format!("{owner}.force"), &force, Scope::State));
        let further = expression.is_some().then_some(efforts.len());
        efforts.extend(expression.map(|expression| Effort { coordinate, expression, owner: owner.clone() }));
        springs.push(Spring { coordinate, stiffness, damping, rest, further, owner });
    }

    /// Forces of springs, forces at points, component by component, actuators, stops, then contacts.
    pub(super) fn efforts(&mut self, of_springs: Vec<Effort>) -> Vec<Effort> {
        let mut efforts = of_springs;
        for (name, force) in &self.description.forces {
            let point = self.point(&force.point);
            let point = point.and_then(|point| match point.frame {
                Some(_) => Ok(point),
                None => {
                    let message = format!("`{}` belongs to the ground, expected a point of a body", force.point);
                    Err(NameError::OtherKind(message))
                }
            });
            let point = self.noted(&format!("forces.{name}.point"), point);
            let key = format!("forces.{name}.force");
            let components = force.force.each_ref().map(|component| self.bound(&key, component, Scope::State));
            let Some(point) = point else { continue };
            for (axis, expression) in
                components.into_iter().enumerate().filter(|(axis, _)| !is_zero(&force.force[*axis]))
            {
                let (coordinate, owner) = (Coordinate::component(point, axis), format!("forces.{name}"));
                efforts.extend(expression.map(|expression| Effort { coordinate, expression, owner }));
            }
        }
        for (name, actuator) in &self.description.actuators {
            let owner = format!("actuators.{name}");
            let coordinate = self.coordinate_of(&owner, &actuator.coordinate);
            let expression = self.bound(&format!("{owner}.effort"), &actuator.effort, Scope::State);
            if let (Some(coordinate), Some(expression)) = (coordinate, expression) {
                efforts.push(Effort { coordinate, expression, owner });
            }
        }
        for (name, stop) in &self.description.stops {
            let owner = format!("stops.{name}");
            let coordinate = self.coordinate_of(&owner, &stop.coordinate);
            let expression = self.stop(&owner, stop);
            if let (Some(coordinate), Some(expression)) = (coordinate, expression) {
                efforts.push(Effort { coordinate, expression, owner });
            }
        }
        efforts.extend(self.contacts());
        efforts
    }

    /// Force of a stop: with `d` beyond a limit, `stiffness d (1 + damping d')` back to the limit, where that does not pull.
    fn stop(&mut self, owner: &str, stop: &StopOptions) -> Option<BoundExpression> {
        let StopOptions { coordinate, min, max, stiffness, damping } = stop;
        self.not_negative(&format!("{owner}.stiffness"), stiffness);
        self.not_negative(&format!("{owner}.damping"), damping);
        let limits = [("min", min), ("max", max)]
            .map(|(field, limit)| limit.as_ref().map(|limit| self.number(&format!("{owner}.{field}"), limit)));
        match limits {
            [None, None] => self.problem(owner, "neither `min` nor `max`, expected at least one of them".into()),
            [Some(min), Some(max)] if min >= max => {
                self.problem(&format!("{owner}.min"), format!("{min} is not below max {max}"));
            }
            _ => {}
        }
        let rate = rate_of(coordinate)?;
        let below = min.as_ref().map(|min| format!("max(({min}) - {coordinate}, 0)*max(1 - ({damping})*{rate}, 0)"));
        let above = max.as_ref().map(|max| format!("max({coordinate} - ({max}), 0)*max(1 + ({damping})*{rate}, 0)"));
        let text = format!("({stiffness})*({} - {})", below.unwrap_or("0".into()), above.unwrap_or("0".into()));
        let expression = self.noted(owner, Expression::parse(&text))?;
        self.bound(owner, &expression, Scope::State)
    }
}
