//! Points of a mechanism whose paths follow from its outputs, and the mechanism itself in a run.

use crate::{multibody::MechanismGeometry, systems::SystemPoint};

/// A mechanism in a run.
#[derive(Clone, Debug)]
pub struct MovingMechanism {
    /// Its points.
    pub geometry: MechanismGeometry,
    /// Position and angle of each body at each time of the run: shape `[times, bodies, 3]`.
    pub poses: Vec<f64>,
}

/// A point that moves in the plane.
#[derive(Clone, Debug)]
pub struct MovingPoint {
    /// Name for people.
    pub name: String,
    rule: PointRule,
}

/// Rule for the position of a point in a row.
#[derive(Clone, Debug)]
enum PointRule {
    /// Two outputs are its coordinates.
    Outputs([usize; 2]),
    /// A system's formula.
    System {
        point: &'static SystemPoint,
        /// Values of the system's quantities; those of parameters are overwritten.
        quantities: Vec<f64>,
        /// Position of each parameter among the quantities.
        parameters: Vec<usize>,
        /// Position of each of the point's outputs among the study's.
        outputs: Vec<usize>,
    },
}

impl MovingPoint {
    /// The point whose coordinates are two outputs.
    pub fn of_outputs(name: impl Into<String>, x: usize, y: usize) -> Self {
        Self { name: name.into(), rule: PointRule::Outputs([x, y]) }
    }

    /// A system's point. `parameters`: position of each of the study's parameters among the system's quantities. `None` if the
    /// study has not all of the outputs that it follows from.
    pub fn of_system(
        point: &'static SystemPoint,
        quantities: &[f64],
        parameters: &[usize],
        outputs: &[impl AsRef<str>],
    ) -> Option<Self> {
        let positions = point.outputs.iter().map(|&name| outputs.iter().position(|output| output.as_ref() == name));
        let outputs = positions.collect::<Option<Vec<usize>>>()?;
        let rule =
            PointRule::System { point, quantities: quantities.to_vec(), parameters: parameters.to_vec(), outputs };
        Some(Self { name: point.name.into(), rule })
    }

    /// Its position in meters: x to the right, y upwards.
    pub fn position(&self, parameters: &[f64], outputs: &[f64]) -> [f64; 2] {
        match &self.rule {
            PointRule::Outputs([x, y]) => [outputs[*x], outputs[*y]],
            PointRule::System { point, quantities, parameters: positions, outputs: columns } => {
                let mut quantities = quantities.clone();
                for (&position, &value) in positions.iter().zip(parameters) {
                    quantities[position] = value;
                }
                let outputs: Vec<f64> = columns.iter().map(|&column| outputs[column]).collect();
                (point.position)(&quantities, &outputs)
            }
        }
    }
}
