//! Scalar functions of the generalized coordinates: what joints hold fixed, drivers prescribe, springs and actuators act
//! along, and outputs measure.
//!
//! Each planar body has the generalized coordinates `(x, y, phi)`: its centre of mass in the ground frame and its angle
//! (Nikravesh: *Planar Multibody Dynamics*; Shabana: *Computational Dynamics*, chapter 3). For `s(q)` a coordinate gives
//! - the value `s`,
//! - the gradient `s_q`, a row of the constraint Jacobian,
//! - the curvature `(s_q qd)_q qd`, so that `sdd = s_q qdd + curvature`.

use nalgebra::{DVector, Vector2, Vector3};

/// A body by its position in the mechanism, or the ground.
pub type Frame = Option<usize>;

/// A point fixed to a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyPoint {
    /// The body.
    pub frame: Frame,
    /// Position in the body's frame, from its centre of mass, in m.
    pub local: Vector2<f64>,
}

/// Positions of all bodies: their coordinates, and vectors of their frames in the ground frame.
pub trait Positions {
    /// The coordinates `q`.
    fn coordinates(&self) -> &DVector<f64>;

    /// A vector of a body's frame in the ground frame.
    fn turn(&self, body: usize, vector: Vector2<f64>) -> Vector2<f64>;
}

impl Positions for DVector<f64> {
    fn coordinates(&self) -> &DVector<f64> {
        self
    }

    fn turn(&self, body: usize, vector: Vector2<f64>) -> Vector2<f64> {
        rotated(self[3 * body + 2].sin_cos(), vector)
    }
}

/// Coordinates with the sine and cosine of each body's angle, for many functions of the same positions.
#[derive(Clone, Debug)]
pub struct TurnedBodies<'a> {
    q: &'a DVector<f64>,
    of_bodies: Vec<(f64, f64)>,
}

impl<'a> TurnedBodies<'a> {
    /// Sines and cosines for the coordinates `q`.
    pub fn new(q: &'a DVector<f64>) -> Self {
        Self { q, of_bodies: q.as_slice().chunks_exact(3).map(|body| body[2].sin_cos()).collect() }
    }
}

impl Positions for TurnedBodies<'_> {
    fn coordinates(&self) -> &DVector<f64> {
        self.q
    }

    fn turn(&self, body: usize, vector: Vector2<f64>) -> Vector2<f64> {
        rotated(self.of_bodies[body], vector)
    }
}

/// Motion of a vector: itself, its rate, and the part of its second derivative that accelerations do not enter.
#[derive(Clone, Copy, Debug)]
struct VectorMotion {
    value: Vector2<f64>,
    rate: Vector2<f64>,
    curvature: Vector2<f64>,
}

/// A scalar function of the generalized coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coordinate {
    /// `a . (r_to - r_from)` with the vector `a` fixed in a frame: components of points, displacements of slides.
    Projection {
        /// Beginning of the difference.
        from: BodyPoint,
        /// End of the difference.
        to: BodyPoint,
        /// Frame in which the axis is fixed.
        frame: Frame,
        /// The axis in that frame; a unit vector.
        axis: Vector2<f64>,
    },
    /// `phi_to - phi_from`.
    Angle {
        /// Frame from which the angle is measured.
        from: Frame,
        /// Frame whose angle it is.
        to: Frame,
    },
    /// `|r_to - r_from|`.
    Distance {
        /// One end.
        from: BodyPoint,
        /// The other end.
        to: BodyPoint,
    },
}

impl BodyPoint {
    /// The ground's origin.
    pub const ORIGIN: Self = Self { frame: None, local: Vector2::new(0.0, 0.0) };

    #[inline]
    fn position(&self, at: &impl Positions) -> Vector2<f64> {
        let (q, arm) = (at.coordinates(), turned(self.frame, self.local, at));
        self.frame.map_or(arm, |body| Vector2::new(q[3 * body], q[3 * body + 1]) + arm)
    }

    fn motion(&self, at: &impl Positions, v: &DVector<f64>) -> VectorMotion {
        let Some(body) = self.frame else {
            return VectorMotion { value: self.local, rate: Vector2::zeros(), curvature: Vector2::zeros() };
        };
        let (q, arm) = (at.coordinates(), at.turn(body, self.local));
        let (x, y, omega) = (3 * body, 3 * body + 1, v[3 * body + 2]);
        VectorMotion {
            value: Vector2::new(q[x], q[y]) + arm,
            rate: Vector2::new(v[x], v[y]) + omega * quarter_turn(arm),
            curvature: -omega * omega * arm,
        }
    }

    /// Passes `direction . r_q` on.
    fn visit_gradient(&self, q: &impl Positions, direction: Vector2<f64>, act: &mut dyn FnMut(usize, Vector3<f64>)) {
        if let Some(body) = self.frame {
            let arm = q.turn(body, self.local);
            act(body, Vector3::new(direction.x, direction.y, direction.dot(&quarter_turn(arm))));
        }
    }
}

impl Coordinate {
    /// Component `x` (0) or `y` (1) of a point in the ground frame.
    pub fn component(point: BodyPoint, axis: usize) -> Self {
        let axis = if axis == 0 { Vector2::x() } else { Vector2::y() };
        Self::Projection { from: BodyPoint::ORIGIN, to: point, frame: None, axis }
    }

    /// Returns true if it is an angle; otherwise it is a length.
    pub fn is_angle(&self) -> bool {
        matches!(self, Self::Angle { .. })
    }

    /// The frames between which it is measured.
    pub fn frames(&self) -> [Frame; 2] {
        match self {
            Self::Projection { from, to, .. } | Self::Distance { from, to } => [from.frame, to.frame],
            Self::Angle { from, to } => [*from, *to],
        }
    }

    /// Returns true if the motion of a body changes it; otherwise it belongs to the ground alone.
    pub fn is_of_body(&self) -> bool {
        match self {
            Self::Projection { from, to, .. } | Self::Distance { from, to } => from.frame.or(to.frame).is_some(),
            Self::Angle { from, to } => from.or(*to).is_some(),
        }
    }

    /// `s(q)`, in m or rad.
    pub fn value(&self, at: &impl Positions) -> f64 {
        let q = at.coordinates();
        match self {
            Self::Projection { from, to, frame, axis } => {
                turned(*frame, *axis, at).dot(&(to.position(at) - from.position(at)))
            }
            Self::Angle { from, to } => angle(*to, q) - angle(*from, q),
            Self::Distance { from, to } => (to.position(at) - from.position(at)).norm(),
        }
    }

    /// Adds `factor * s_q` to a row of as many entries as `q`. The gradient of a distance of zero is not finite.
    pub fn add_gradient(&self, q: &impl Positions, factor: f64, gradient: &mut [f64]) {
        self.visit_gradient(q, factor, &mut |body, part| {
            gradient[3 * body..3 * body + 3].iter_mut().zip(part.iter()).for_each(|(entry, by)| *entry += by);
        });
    }

    /// Passes the parts of `factor * s_q` on: a body, and the derivatives along its `(x, y, phi)`. A body may have several parts, whose
    /// sum counts. The bodies are the same in all positions.
    pub fn visit_gradient(&self, q: &impl Positions, factor: f64, act: &mut dyn FnMut(usize, Vector3<f64>)) {
        match self {
            Self::Projection { from, to, frame, axis } => {
                let axis = factor * turned(*frame, *axis, q);
                to.visit_gradient(q, axis, act);
                from.visit_gradient(q, -axis, act);
                if let Some(body) = frame {
                    act(*body, along_angle(quarter_turn(axis).dot(&self.difference(q, q.coordinates()).value)));
                }
            }
            Self::Angle { from, to } => {
                for (frame, sign) in [(to, factor), (from, -factor)] {
                    if let Some(body) = frame {
                        act(*body, along_angle(sign));
                    }
                }
            }
            // a spring of no length that is at rest there has no force, whatever its direction is
            Self::Distance { .. } if factor == 0.0 => {}
            Self::Distance { from, to } => {
                let difference = self.difference(q, q.coordinates()).value;
                let direction = factor * difference / difference.norm();
                to.visit_gradient(q, direction, act);
                from.visit_gradient(q, -direction, act);
            }
        }
    }

    /// `s_q qd`, in m/s or rad/s.
    pub fn rate(&self, q: &impl Positions, v: &DVector<f64>) -> f64 {
        match self {
            Self::Projection { frame, axis, .. } => {
                let (axis, omega) = (turned(*frame, *axis, q), angle(*frame, v));
                let VectorMotion { value, rate, .. } = self.difference(q, v);
                axis.dot(&rate) + omega * quarter_turn(axis).dot(&value)
            }
            Self::Angle { from, to } => angle(*to, v) - angle(*from, v),
            Self::Distance { .. } => {
                let VectorMotion { value, rate, .. } = self.difference(q, v);
                value.dot(&rate) / value.norm()
            }
        }
    }

    /// `(s_q qd)_q qd`, in m/s² or rad/s².
    pub fn curvature(&self, q: &impl Positions, v: &DVector<f64>) -> f64 {
        match self {
            Self::Projection { frame, axis, .. } => {
                let (axis, omega) = (turned(*frame, *axis, q), angle(*frame, v));
                let VectorMotion { value, rate, curvature } = self.difference(q, v);
                axis.dot(&curvature) + 2.0 * omega * quarter_turn(axis).dot(&rate) - omega * omega * axis.dot(&value)
            }
            Self::Angle { .. } => 0.0,
            Self::Distance { .. } => {
                let VectorMotion { value, rate, curvature } = self.difference(q, v);
                let (length, speed) = (value.norm(), value.dot(&rate) / value.norm());
                value.dot(&curvature) / length + (rate.norm_squared() - speed * speed) / length
            }
        }
    }

    /// `r_to - r_from` of a distance.
    pub fn direction(&self, q: &DVector<f64>) -> Option<Vector2<f64>> {
        matches!(self, Self::Distance { .. }).then(|| self.difference(q, q).value)
    }

    /// Motion of `r_to - r_from`.
    fn difference(&self, q: &impl Positions, v: &DVector<f64>) -> VectorMotion {
        let (Self::Projection { from, to, .. } | Self::Distance { from, to }) = self else {
            return BodyPoint::ORIGIN.motion(q, v);
        };
        let (from, to) = (from.motion(q, v), to.motion(q, v));
        VectorMotion {
            value: to.value - from.value,
            rate: to.rate - from.rate,
            curvature: to.curvature - from.curvature,
        }
    }
}

/// Largest entry of a change of the coordinates of bodies, lengths in parts of `length`.
pub fn size_of_change(change: &DVector<f64>, length: f64) -> f64 {
    let entries = change.iter().enumerate();
    let sizes = entries.map(|(index, value)| if index % 3 == 2 { value.abs() } else { value.abs() / length });
    sizes.fold(0.0, f64::max)
}

/// A vector of a frame in the ground frame.
pub fn turned(frame: Frame, vector: Vector2<f64>, q: &impl Positions) -> Vector2<f64> {
    frame.map_or(vector, |body| q.turn(body, vector))
}

fn rotated((sine, cosine): (f64, f64), vector: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(cosine * vector.x - sine * vector.y, sine * vector.x + cosine * vector.y)
}

/// The part of a gradient along a body's angle.
#[inline]
fn along_angle(slope: f64) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, slope)
}

fn quarter_turn(vector: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-vector.y, vector.x)
}

fn angle(frame: Frame, q: &DVector<f64>) -> f64 {
    frame.map_or(0.0, |body| q[3 * body + 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_rate_and_curvature_agree_with_finite_differences() {
        let q = DVector::from_vec(vec![0.3, -0.2, 0.7, 1.1, 0.4, -1.9]);
        let v = DVector::from_vec(vec![0.5, 0.8, -1.2, -0.4, 0.6, 2.3]);
        let point = |frame, x, y| BodyPoint { frame, local: Vector2::new(x, y) };
        let (one, two, fixed) = (point(Some(0), 0.4, -0.3), point(Some(1), -0.2, 0.9), point(None, 0.1, 2.0));
        let axis = Vector2::new(0.6, 0.8);
        let coordinates = [
            Coordinate::component(one, 0),
            Coordinate::component(two, 1),
            Coordinate::Projection { from: one, to: two, frame: Some(0), axis },
            Coordinate::Projection { from: fixed, to: two, frame: Some(1), axis },
            Coordinate::Angle { from: None, to: Some(1) },
            Coordinate::Angle { from: Some(1), to: Some(0) },
            Coordinate::Distance { from: one, to: two },
            Coordinate::Distance { from: fixed, to: one },
        ];
        let step = 1e-5;
        for coordinate in coordinates {
            let mut gradient = [0.0; 6];
            coordinate.add_gradient(&q, 1.0, &mut gradient);
            for i in 0..6 {
                let moved = |sign: f64| {
                    let mut q = q.clone();
                    q[i] += sign * step;
                    coordinate.value(&q)
                };
                let expected = (moved(1.0) - moved(-1.0)) / (2.0 * step);
                assert!((gradient[i] - expected).abs() < 1e-9, "{coordinate:?} {i}: {} {expected}", gradient[i]);
            }
            let rate: f64 = gradient.iter().zip(&v).map(|(a, b)| a * b).sum();
            assert!((coordinate.rate(&q, &v) - rate).abs() < 1e-14, "{coordinate:?}");
            // at constant velocities the second derivative is the curvature
            let along = |sign: f64| coordinate.rate(&(&q + sign * step * &v), &v);
            let expected = (along(1.0) - along(-1.0)) / (2.0 * step);
            assert!((coordinate.curvature(&q, &v) - expected).abs() < 1e-8, "{coordinate:?}");
        }
    }
}
