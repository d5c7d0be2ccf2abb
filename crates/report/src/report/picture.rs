//! A mechanism as a line drawing at one time of a run, with its poses at others for a script that moves it.

use super::{numbers::evenly, readable::number, strip::coordinates};
use crate::{
    multibody::{JointGeometry, coordinate::BodyPoint, description::JointType},
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
}

/// Pose of a body: position and angle.
type Pose = [f64; 3];

impl View {
    /// Place of a point.
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [MARGIN + self.scale * (x - self.left), MARGIN + self.scale * (self.top - y)]
    }

    /// A vector of a body's frame, in the drawing's units; y points down there.
    fn local(&self, point: Vector2<f64>) -> [f64; 2] {
        [self.scale * point.x, -self.scale * point.y]
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
    let in_frames = |point: BodyPoint| rows.iter().map(move |poses| position(point, poses));
    let link_points = geometry
        .links
        .iter()
        .enumerate()
        .flat_map(|(body, link)| link.iter().map(move |&local| BodyPoint { frame: Some(body), local }));
    let ends = geometry.joints.iter().flat_map(|joint| joint.ends).chain(geometry.springs.iter().flatten().copied());
    let shown: Vec<BodyPoint> = link_points.chain(ends).collect();
    let (low, high) = shown
        .iter()
        .flat_map(|&point| in_frames(point))
        .fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(low, high), [x, y]| {
            ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)])
        });
    let spans = [high[0] - low[0], high[1] - low[1]];
    let scales =
        [0, 1].map(|axis| if spans[axis] > 0.0 { (SIZE[axis] - 2.0 * MARGIN) / spans[axis] } else { f64::INFINITY });
    let scale = scales[0].min(scales[1]);
    if !scale.is_finite() {
        return None;
    }
    let [width, height] = [0, 1].map(|axis| scale * spans[axis] + 2.0 * MARGIN);
    let view = View { scale, left: low[0], top: high[1] };

    let mut ground = String::new();
    let mut of_bodies = vec![String::new(); bodies];
    let mut marks = String::new();
    // writing to a string does not fail
    for (body, link) in geometry.links.iter().enumerate() {
        of_bodies[body] += &shape(&link.iter().map(|&point| view.local(point)).collect::<Vec<_>>());
        let is_joined = |at: Vector2<f64>| shown_joints(&geometry.joints, body).any(|point| point == at);
        if link.contains(&Vector2::zeros()) && !is_joined(Vector2::zeros()) {
            of_bodies[body] += "<circle class=\"mass\" r=\"6\"/>";
        }
    }
    for joint in &geometry.joints {
        let JointGeometry { kind, ends: [from, to], axis } = *joint;
        match kind {
            JointType::Revolute => {
                if let Some(BodyPoint { local, .. }) = [from, to].into_iter().find(|end| end.frame.is_none()) {
                    let [x, y] = view.place([local.x, local.y]);
                    let _ = write!(ground, "<path class=\"support\" d=\"M{x:.1} {y:.1}l-7 11h14z\"/>");
                }
                // on the body that is drawn last, so that no link covers it
                let last = if to.frame > from.frame { to } else { from };
                if let Some(body) = last.frame {
                    let [x, y] = view.local(last.local);
                    let _ = write!(of_bodies[body], "<circle class=\"joint\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\"/>");
                }
            }
            JointType::Prismatic => {
                slide(&view, (from, to, axis), &rows, &mut ground, &mut of_bodies);
                block(&view, (from, to, axis), at_row, &mut ground, &mut of_bodies);
            }
            JointType::Fixed => {}
        }
    }
    for (point, radius, line) in &geometry.contacts {
        let [a, b] = line.map(|end| end.local);
        // the line is infinite
        let along = b - a;
        let long = (high[0] - low[0]).hypot(high[1] - low[1]) / along.norm();
        let (a, b) = (a - long * along, b + long * along);
        match line[0].frame {
            Some(body) => of_bodies[body] += &segment("rail", view.local(a), view.local(b)),
            None => ground += &segment("rail", view.place([a.x, a.y]), view.place([b.x, b.y])),
        }
        if let (Some(body), true) = (point.frame, *radius > 0.0) {
            let [x, y] = view.local(point.local);
            let r = view.scale * radius;
            let _ = write!(of_bodies[body], "<circle class=\"rim\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\"/>");
        }
    }
    for [from, to] in &geometry.springs {
        let ends = [from, to].map(|end| {
            let [x, y] = match end.frame {
                Some(_) => view.local(end.local),
                None => view.place([end.local.x, end.local.y]),
            };
            format!("{} {x:.1} {y:.1}", end.frame.map_or(-1, |body| body as i64))
        });
        let [a, b] = [*from, *to].map(|end| view.place(position(end, at_row)));
        let _ = write!(
            marks,
            "<path class=\"spring\" data-ends=\"{} {}\" transform=\"{}\" d=\"M0 0H.2L.26 1 .38-1 .5 1 .62-1 .74 1 .8 0H1\"/>",
            ends[0],
            ends[1],
            stretched(a, b)
        );
    }
    let traced = geometry
        .links
        .iter()
        .enumerate()
        .flat_map(|(body, link)| link.iter().map(move |&local| BodyPoint { frame: Some(body), local }));
    let length = |point: &BodyPoint| {
        let path: Vec<[f64; 2]> = in_frames(*point).collect();
        path.windows(2).map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1])).sum::<f64>()
    };
    let traced = traced.max_by(|a, b| length(a).total_cmp(&length(b)))?;
    let path = evenly(rows.len(), 400).into_iter().map(|row| view.place(position(traced, &rows[row])));
    let path = coordinates(path);
    let frames = evenly(rows.len(), (POSES / bodies).clamp(2, FRAMES));
    let mut script = String::new();
    for &frame in &frames {
        for pose in &rows[frame] {
            let [x, y] = view.place([pose[0], pose[1]]);
            let _ = write!(script, "{x:.1},{y:.1},{:.1},", -pose[2].to_degrees());
        }
    }
    let moving = of_bodies.iter().zip(at_row).map(|(content, &[x, y, angle])| {
        let [x, y] = view.place([x, y]);
        format!(
            "<g class=\"body\" transform=\"translate({x:.1} {y:.1}) rotate({:.1})\">{content}</g>",
            -angle.to_degrees()
        )
    });
    let moving: String = moving.collect();
    let time = |row: usize| times[row];
    Some(format!(
        "<div class=\"mechanism\" data-frames=\"{}\" data-times=\"{} {}\">\n\
         <svg viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" aria-label=\"The mechanism in the worst run\">\
         <polyline class=\"path\" points=\"{path}\"/>{ground}{moving}{marks}</svg>\n\
         <p>Worst run at its worst instant, <span>t = {} s</span></p></div>\n",
        script.trim_end_matches(','),
        time(frames[0]),
        time(frames[frames.len() - 1]),
        number(time(row))
    ))
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
            let turn = |point: &[f64; 2]| (point[1] - middle[1]).atan2(point[0] - middle[0]);
            around.sort_by(|a, b| turn(a).total_cmp(&turn(b)));
            let around = around.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ");
            format!("<polygon class=\"link\" points=\"{around}\"/>")
        }
    }
}

fn segment(class: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> String {
    format!("<path class=\"{class}\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>")
}

/// The line along which a prismatic joint slides, as far as it does in the run.
fn slide(
    view: &View,
    (from, to, axis): (BodyPoint, BodyPoint, Vector2<f64>),
    rows: &[Vec<Pose>],
    ground: &mut String,
    of_bodies: &mut [String],
) {
    let along = rows.iter().map(|poses| {
        let [a, b] = [from, to].map(|end| position(end, poses));
        let angle = from.frame.map_or(0.0, |body| poses[body][2]);
        let (sine, cosine) = angle.sin_cos();
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        // in the frame of the first body
        axis.x * (cosine * dx + sine * dy) + axis.y * (cosine * dy - sine * dx)
    });
    let room = 14.0 / view.scale;
    let (low, high) = along.fold((0.0f64, 0.0f64), |(low, high), s| (low.min(s), high.max(s)));
    let [a, b] = [low - room, high + room].map(|s| from.local + s * axis);
    match from.frame {
        Some(body) => of_bodies[body] += &segment("rail", view.local(a), view.local(b)),
        None => *ground += &segment("rail", view.place([a.x, a.y]), view.place([b.x, b.y])),
    }
}

/// The block that slides: on the second body, along the axis.
fn block(
    view: &View,
    (from, to, axis): (BodyPoint, BodyPoint, Vector2<f64>),
    poses: &[Pose],
    ground: &mut String,
    of_bodies: &mut [String],
) {
    let angle = |point: BodyPoint| point.frame.map_or(0.0, |body| poses[body][2]);
    // the joint keeps the angle between its bodies
    let turn = axis.y.atan2(axis.x) + angle(from) - angle(to);
    let ([x, y], layer) = match to.frame {
        Some(body) => (view.local(to.local), &mut of_bodies[body]),
        None => (view.place([to.local.x, to.local.y]), ground),
    };
    let turn = -turn.to_degrees();
    let _ = write!(
        layer,
        "<rect class=\"block\" x=\"-11\" y=\"-6.5\" width=\"22\" height=\"13\" rx=\"2\" transform=\"translate({x:.1} {y:.1}) rotate({turn:.1})\"/>"
    );
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
