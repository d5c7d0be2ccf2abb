//! A mechanism as a line drawing at one time of a run, with its poses at others for a script that moves it.

use super::{numbers::evenly, readable::number, strip::coordinates};
use crate::{
    multibody::{JointGeometry, MechanismGeometry, coordinate::BodyPoint, description::JointType},
    source::MovingMechanism,
};
use nalgebra::Vector2;
use std::fmt::Write;

/// Largest number of poses of all bodies for the script.
const POSES: usize = 1800;
/// Most frames.
const FRAMES: usize = 160;
/// Size of the drawing in CSS pixels, and the room around it.
const SIZE: [f64; 2] = [420.0, 220.0];
const MARGIN: f64 = 16.0;

/// A map from the plane to the drawing.
struct View {
    scale: f64,
    left: f64,
    top: f64,
    /// Width and height of what is shown, in the plane.
    spans: [f64; 2],
}

/// Pose of a body: position and angle.
type Pose = [f64; 3];

impl View {
    /// The view of points; none if they are all at the same place.
    fn around(points: impl Iterator<Item = [f64; 2]>) -> Option<Self> {
        let (low, high) = points.fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(low, high), [x, y]| {
            ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)])
        });
        let spans = [high[0] - low[0], high[1] - low[1]];
        let scales = [0, 1]
            .map(|axis| if spans[axis] > 0.0 { (SIZE[axis] - 2.0 * MARGIN) / spans[axis] } else { f64::INFINITY });
        let scale = scales[0].min(scales[1]);
        scale.is_finite().then_some(Self { scale, left: low[0], top: high[1], spans })
    }

    /// Place of a point.
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [MARGIN + self.scale * (x - self.left), MARGIN + self.scale * (self.top - y)]
    }

    /// A vector of a body's frame, in the drawing's units; y points down there.
    fn local(&self, point: Vector2<f64>) -> [f64; 2] {
        [self.scale * point.x, -self.scale * point.y]
    }

    /// Place of a point in the drawing of its body, or of the ground.
    fn of_frame(&self, frame: Option<usize>, point: Vector2<f64>) -> [f64; 2] {
        match frame {
            Some(_) => self.local(point),
            None => self.place([point.x, point.y]),
        }
    }
}

/// The drawing at a row of the run, whose times these are; none without finite poses.
pub fn picture(mechanism: &MovingMechanism, times: &[f64], row: usize) -> Option<String> {
    let MovingMechanism { geometry, poses } = mechanism;
    let bodies = geometry.links.len();
    let rows: Vec<Vec<Pose>> = poses
        .chunks_exact(3 * bodies.max(1))
        .map(|row| row.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
        .collect();
    let at_row = rows.get(row)?;
    if poses.iter().any(|value| !value.is_finite()) || rows.len() > times.len() {
        return None;
    }
    let ends = geometry.joints.iter().flat_map(|joint| joint.ends).chain(geometry.springs.iter().flatten().copied());
    let shown = link_points(geometry).chain(ends);
    let view = View::around(shown.flat_map(|point| rows.iter().map(move |poses| position(point, poses))))?;
    let mut drawing = MechanismDrawing::new(view, &rows, at_row);
    drawing.add_links(geometry);
    drawing.add_joints(geometry);
    drawing.add_contacts(geometry);
    drawing.add_springs(geometry);
    let MechanismDrawing { view, ground, marks, .. } = &drawing;
    let [width, height] = view.spans.map(|span| view.scale * span + 2.0 * MARGIN);
    let traced = farthest_moved(geometry, &rows)?;
    let path = evenly(rows.len(), 400).into_iter().map(|row| view.place(position(traced, &rows[row])));
    let path = coordinates(path);
    let frames = evenly(rows.len(), (POSES / bodies).clamp(2, FRAMES));
    let mut script = String::new();
    for &frame in &frames {
        for pose in &rows[frame] {
            let [x, y] = view.place([pose[0], pose[1]]);
            // writing to a string does not fail
            let _ = write!(script, "{x:.1},{y:.1},{:.1},", -pose[2].to_degrees());
        }
    }
    Some(format!(
        "<div class=\"mechanism\" data-frames=\"{}\" data-times=\"{} {}\">\n\
         <svg viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" aria-label=\"The mechanism in the worst run\">\
         <polyline class=\"path\" points=\"{path}\"/>{ground}{}{marks}</svg>\n\
         <p>Worst run at its worst instant, <span>t = {} s</span></p></div>\n",
        script.trim_end_matches(','),
        times[frames[0]],
        times[frames[frames.len() - 1]],
        drawing.moving(),
        number(times[row])
    ))
}

/// Points of the links of all bodies.
fn link_points(geometry: &MechanismGeometry) -> impl Iterator<Item = BodyPoint> {
    let links = geometry.links.iter().enumerate();
    links.flat_map(|(body, link)| link.iter().map(move |&local| BodyPoint { frame: Some(body), local }))
}

/// The point of a link with the longest path.
fn farthest_moved(geometry: &MechanismGeometry, rows: &[Vec<Pose>]) -> Option<BodyPoint> {
    let paths = link_points(geometry).map(|point| {
        let path: Vec<[f64; 2]> = rows.iter().map(|poses| position(point, poses)).collect();
        let steps = path.windows(2).map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]));
        (point, steps.sum::<f64>())
    });
    paths.max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(point, _)| point)
}

/// Parts of the drawing of a mechanism as SVG.
struct MechanismDrawing<'a> {
    view: View,
    /// Poses of all bodies in each row, and in that of the drawing.
    rows: &'a [Vec<Pose>],
    at_row: &'a [Pose],
    ground: String,
    /// Content of each body, in its frame.
    of_bodies: Vec<String>,
    /// Springs, which are between bodies.
    marks: String,
}

impl<'a> MechanismDrawing<'a> {
    fn new(view: View, rows: &'a [Vec<Pose>], at_row: &'a [Pose]) -> Self {
        let of_bodies = vec![String::new(); at_row.len()];
        Self { view, rows, at_row, ground: String::new(), of_bodies, marks: String::new() }
    }

    /// Content of a frame: that of a body, or the ground.
    fn layer(&mut self, frame: Option<usize>) -> &mut String {
        match frame {
            Some(body) => &mut self.of_bodies[body],
            None => &mut self.ground,
        }
    }

    fn add_rail(&mut self, frame: Option<usize>, ends: [Vector2<f64>; 2]) {
        let [a, b] = ends.map(|end| self.view.of_frame(frame, end));
        *self.layer(frame) += &segment("rail", a, b);
    }

    fn add_links(&mut self, geometry: &MechanismGeometry) {
        for (body, link) in geometry.links.iter().enumerate() {
            self.of_bodies[body] += &shape(&link.iter().map(|&point| self.view.local(point)).collect::<Vec<_>>());
            let is_joined = shown_joints(&geometry.joints, body).any(|point| point == Vector2::zeros());
            if link.contains(&Vector2::zeros()) && !is_joined {
                self.of_bodies[body] += "<circle class=\"mass\" r=\"6\"/>";
            }
        }
    }

    fn add_joints(&mut self, geometry: &MechanismGeometry) {
        for joint in &geometry.joints {
            match joint.kind {
                JointType::Revolute => self.add_hinge(joint),
                JointType::Prismatic => {
                    self.add_slide(joint);
                    self.add_block(joint);
                }
                JointType::Fixed => {}
            }
        }
    }

    fn add_hinge(&mut self, joint: &JointGeometry) {
        let [from, to] = joint.ends;
        // writing to a string does not fail
        if let Some(BodyPoint { local, .. }) = [from, to].into_iter().find(|end| end.frame.is_none()) {
            let [x, y] = self.view.place([local.x, local.y]);
            let _ = write!(self.ground, "<path class=\"support\" d=\"M{x:.1} {y:.1}l-7 11h14z\"/>");
        }
        // on the body that is drawn last, so that no link covers it
        let last = if to.frame > from.frame { to } else { from };
        if let Some(body) = last.frame {
            let [x, y] = self.view.local(last.local);
            let _ = write!(self.of_bodies[body], "<circle class=\"joint\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\"/>");
        }
    }

    /// The line along which a prismatic joint slides, as far as it does in the run.
    fn add_slide(&mut self, joint: &JointGeometry) {
        let JointGeometry { ends: [from, to], axis, .. } = *joint;
        let along = self.rows.iter().map(|poses| {
            let [a, b] = [from, to].map(|end| position(end, poses));
            let (sine, cosine) = angle(from, poses).sin_cos();
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            // in the frame of the first body
            axis.x * (cosine * dx + sine * dy) + axis.y * (cosine * dy - sine * dx)
        });
        let room = 14.0 / self.view.scale;
        let (low, high) = along.fold((0.0f64, 0.0f64), |(low, high), s| (low.min(s), high.max(s)));
        self.add_rail(from.frame, [low - room, high + room].map(|s| from.local + s * axis));
    }

    /// The block that slides: on the second body, along the axis.
    fn add_block(&mut self, joint: &JointGeometry) {
        let JointGeometry { ends: [from, to], axis, .. } = *joint;
        // the joint keeps the angle between its bodies
        let turn = axis.y.atan2(axis.x) + angle(from, self.at_row) - angle(to, self.at_row);
        let [x, y] = self.view.of_frame(to.frame, to.local);
        let turn = -turn.to_degrees();
        let _ = write!(
            self.layer(to.frame),
            "<rect class=\"block\" x=\"-11\" y=\"-6.5\" width=\"22\" height=\"13\" rx=\"2\" transform=\"translate({x:.1} {y:.1}) rotate({turn:.1})\"/>"
        );
    }

    fn add_contacts(&mut self, geometry: &MechanismGeometry) {
        for (point, radius, line) in &geometry.contacts {
            let [a, b] = line.map(|end| end.local);
            // the line is infinite
            let along = b - a;
            let long = self.view.spans[0].hypot(self.view.spans[1]) / along.norm();
            self.add_rail(line[0].frame, [a - long * along, b + long * along]);
            if let (Some(body), true) = (point.frame, *radius > 0.0) {
                let [x, y] = self.view.local(point.local);
                let r = self.view.scale * radius;
                let _ =
                    write!(self.of_bodies[body], "<circle class=\"rim\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\"/>");
            }
        }
    }

    fn add_springs(&mut self, geometry: &MechanismGeometry) {
        for ends in &geometry.springs {
            let [from, to] = ends.map(|end| {
                let [x, y] = self.view.of_frame(end.frame, end.local);
                format!("{} {x:.1} {y:.1}", end.frame.map_or(-1, |body| body as i64))
            });
            let [a, b] = ends.map(|end| self.view.place(position(end, self.at_row)));
            let _ = write!(
                self.marks,
                "<path class=\"spring\" data-ends=\"{from} {to}\" transform=\"{}\" d=\"M0 0H.2L.26 1 .38-1 .5 1 .62-1 .74 1 .8 0H1\"/>",
                stretched(a, b)
            );
        }
    }

    /// The bodies at their places.
    fn moving(&self) -> String {
        let bodies = self.of_bodies.iter().zip(self.at_row).map(|(content, &[x, y, angle])| {
            let [x, y] = self.view.place([x, y]);
            format!(
                "<g class=\"body\" transform=\"translate({x:.1} {y:.1}) rotate({:.1})\">{content}</g>",
                -angle.to_degrees()
            )
        });
        bodies.collect()
    }
}

/// Angle of a point's frame.
fn angle(point: BodyPoint, poses: &[Pose]) -> f64 {
    point.frame.map_or(0.0, |body| poses[body][2])
}

/// Position of a point of a body or the ground.
fn position(BodyPoint { frame, local }: BodyPoint, poses: &[Pose]) -> [f64; 2] {
    let Some(body) = frame else { return [local.x, local.y] };
    let [x, y, angle] = poses[body];
    let (sine, cosine) = angle.sin_cos();
    [x + cosine * local.x - sine * local.y, y + sine * local.x + cosine * local.y]
}

/// Points of a body at which joints are.
fn shown_joints(joints: &[JointGeometry], body: usize) -> impl Iterator<Item = Vector2<f64>> {
    let ends = joints.iter().flat_map(|joint| joint.ends);
    ends.filter(move |end| end.frame == Some(body)).map(|end| end.local)
}

/// A link through its points: nothing, a bar, or a plate.
fn shape(points: &[[f64; 2]]) -> String {
    match points {
        [] | [_] => String::new(),
        [a, b] => segment("link", *a, *b),
        points => {
            // around their middle, so that the outline does not cross itself
            let count = points.len() as f64;
            let middle = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count);
            let mut around = points.to_vec();
            around.sort_by(|a, b| {
                let [a, b] = [a, b].map(|point| (point[1] - middle[1]).atan2(point[0] - middle[0]));
                a.total_cmp(&b)
            });
            let around = around.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ");
            format!("<polygon class=\"link\" points=\"{around}\"/>")
        }
    }
}

fn segment(class: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> String {
    format!("<path class=\"{class}\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>")
}

/// Transform that lays the unit of the horizontal axis between two places, six pixels wide in the other direction.
fn stretched([x, y]: [f64; 2], [u, v]: [f64; 2]) -> String {
    let [dx, dy] = [u - x, v - y];
    let width = 6.0 / dx.hypot(dy).max(1e-3);
    format!("matrix({dx:.2} {dy:.2} {:.3} {:.3} {x:.1} {y:.1})", -dy * width, dx * width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::multibody::Mechanism;
    use metafmu_numerics::integrate::{Budget, TOLERANCE};
    use std::path::Path;

    fn drawn(text: &str) -> String {
        let mechanism = Mechanism::parse(text, Path::new("m.toml")).unwrap();
        let values: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
        let times: Vec<f64> = (0..11).map(|i| 0.05 * f64::from(i)).collect();
        let motion = mechanism.body_motion(&values, &times, TOLERANCE, &Budget::default()).unwrap();
        let geometry = mechanism.geometry(&values).unwrap();
        picture(&MovingMechanism { geometry, poses: motion.poses }, &times, 4).unwrap()
    }

    #[test]
    fn a_four_bar_linkage_has_three_bars_four_joints_and_a_path() {
        let svg = drawn(include_str!("../../../../examples/mechanisms/four-bar.toml"));
        let counts = ["class=\"link\"", "class=\"joint\"", "class=\"support\"", "class=\"path\"", "class=\"body\""]
            .map(|class| svg.matches(class).count());
        assert_eq!(counts, [3, 4, 2, 1, 3], "{svg}");
        assert!(svg.contains("t = 0.2 s") && !svg.contains("NaN"));
        // eleven frames of three bodies with three numbers each
        let frames = svg.split("data-frames=\"").nth(1).unwrap().split('"').next().unwrap();
        assert_eq!(frames.split(',').count(), 99);
    }

    #[test]
    fn sliders_and_springs_are_drawn() {
        let crane = drawn(include_str!("../../../../examples/dynamics/crane.toml"));
        assert_eq!(
            ["rail", "block", "mass"].map(|class| crane.matches(&format!("class=\"{class}\"")).count()),
            [1, 1, 1]
        );
        let car = drawn(include_str!("../../../../examples/mechanisms/quarter-car.toml"));
        assert!(car.contains("class=\"spring\" data-ends="), "{car}");
    }

    #[test]
    fn a_spring_ends_where_its_points_are() {
        assert_eq!(stretched([10.0, 20.0], [40.0, 60.0]), "matrix(30.00 40.00 -4.800 3.600 10.0 20.0)");
    }
}
