//! Motion of the bodies in a run, for pictures: their poses beside the outputs.

use super::{
    Mechanism, RunStart,
    build::{MechanismGeometry, geometry},
    error::MotionError,
    measure::Measure,
    model::{MultibodyModel, Sample},
    simulate::simulate,
};
use crate::{integrate::Budget, signal::Signal};

/// Poses of all bodies in a run, and the outputs that the same run has.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyMotion {
    /// Centre of mass in the ground frame, in m, and angle, in rad: shape `[times, bodies, 3]`.
    pub poses: Vec<f64>,
    /// Rows of all outputs, one after the other.
    pub outputs: Vec<f64>,
}

impl Mechanism {
    /// Points of the mechanism with a value for each parameter; none if it cannot be built of these values.
    pub fn geometry(&self, values: &[f64]) -> Option<MechanismGeometry> {
        geometry(self.description(), values)
    }

    /// Motion of the bodies in the run of [`simulate`](Self::simulate).
    ///
    /// # Errors
    /// As [`simulate`](Self::simulate).
    pub fn body_motion(
        &self,
        values: &[f64],
        times: &[f64],
        tolerance: f64,
        budget: &Budget,
    ) -> Result<BodyMotion, MotionError> {
        let start = self.inputs().values().map(|input| Signal::Constant(input.start));
        let (model, measures) = self.driven(values, &start.collect::<Vec<_>>(), tolerance)?;
        let samples = simulate(&model, times, budget)?;
        self.body_motion_of(&model, &measures, &samples)
    }

    /// Motion of the bodies in the run of [`simulate_from`](Self::simulate_from).
    ///
    /// # Errors
    /// As [`simulate_from`](Self::simulate_from).
    pub fn body_motion_from(
        &self,
        values: &[f64],
        start: RunStart,
        signals: &[Signal],
        times: &[f64],
        integration: (f64, &Budget),
    ) -> Result<BodyMotion, MotionError> {
        let (model, measures, samples, _) = self.run_from(values, start, signals, times, integration)?;
        self.body_motion_of(&model, &measures, &samples)
    }

    fn body_motion_of(
        &self,
        model: &MultibodyModel,
        measures: &[Measure],
        samples: &[Sample],
    ) -> Result<BodyMotion, MotionError> {
        let poses = samples.iter().flat_map(|sample| sample.q.iter().copied()).collect();
        Ok(BodyMotion { poses, outputs: self.rows(model, measures, samples)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{description::JointType, integrate::TOLERANCE};
    use std::path::Path;

    #[test]
    fn links_of_a_four_bar_linkage_meet_in_its_joints_all_the_time() {
        let text = include_str!("../../../examples/mechanisms/four-bar.toml");
        let mechanism = Mechanism::parse(text, Path::new("m.toml")).unwrap();
        let values: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
        let geometry = mechanism.geometry(&values).unwrap();
        assert_eq!(geometry.links.iter().map(Vec::len).collect::<Vec<_>>(), [2, 2, 2]);
        assert_eq!(geometry.joints.iter().filter(|joint| joint.kind == JointType::Revolute).count(), 4);
        assert!(geometry.springs.is_empty(), "the spring along an angle has no ends");
        let times: Vec<f64> = (0..21).map(|i| 0.05 * f64::from(i)).collect();
        let motion = mechanism.body_motion(&values, &times, TOLERANCE, &Budget::default()).unwrap();
        let rows = mechanism.simulate(&values, &times, TOLERANCE, &Budget::default()).unwrap();
        assert_eq!((motion.poses.len(), &motion.outputs), (times.len() * 9, &rows));
        for poses in motion.poses.chunks(9) {
            let q = nalgebra::DVector::from_column_slice(poses);
            for joint in &geometry.joints {
                let [a, b] = joint.ends.map(|end| {
                    let centre = end.frame.map_or([0.0, 0.0], |body| [q[3 * body], q[3 * body + 1]]);
                    let turned = crate::coordinate::turned(end.frame, end.local, &q);
                    [centre[0] + turned.x, centre[1] + turned.y]
                });
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9, "{a:?} {b:?}");
            }
        }
    }
}
