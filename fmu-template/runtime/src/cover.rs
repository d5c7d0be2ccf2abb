//! Where the training data are, beyond the ranges of their columns.

use crate::{Encoding, FormatError, Input, Role};
use serde::Serialize;

/// Cubes that cover the training data: a point is near the data if a centre is within `radius` of it in each column,
///
/// `min over centres k of max over columns j of |u_j - c_kj| <= radius`, with `u_j = (x_j - min_j) / (max_j - min_j)`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cover {
    /// Positions of the inputs that count, ascending: those that are neither the time nor constant.
    pub columns: Vec<u32>,
    /// Half the width of the cubes, relative to the inputs' ranges.
    pub radius: f64,
    /// The centres, relative to the inputs' ranges; shape `[centres, columns]`.
    pub centres: Vec<f32>,
}

impl Cover {
    /// Returns true if an input can be a column of a cover.
    pub fn counts(input: &Input) -> bool {
        !matches!(input.role, Role::Time | Role::Start) && input.encoding == Encoding::Plain && input.min < input.max
    }

    /// Makes sure that the cover belongs to these inputs.
    ///
    /// # Errors
    /// [`FormatError::Cover`]
    pub(crate) fn check(&self, inputs: &[Input]) -> Result<(), FormatError> {
        let Self { columns, radius, centres } = self;
        let all_count = columns.iter().all(|column| inputs.get(*column as usize).is_some_and(Self::counts));
        let problem = if columns.is_empty() || !columns.is_sorted_by(|a, b| a < b) || !all_count {
            "columns are inputs that are no constants, in order"
        } else if !(radius.is_finite() && *radius > 0.0) {
            "the radius is a positive number"
        } else if centres.is_empty() || centres.len() % columns.len() != 0 || centres.iter().any(|c| !c.is_finite()) {
            "each centre has a finite number for each column"
        } else {
            return Ok(());
        };
        Err(FormatError::Cover { expected: problem })
    }
}

/// A [`Cover`] of inputs with certain ranges, prepared for evaluation.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cubes {
    columns: Vec<CubeAxis>,
    radius: f64,
    centres: Vec<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct CubeAxis {
    input: usize,
    min: f64,
    /// Width of the range.
    width: f64,
}

/// Position of a point relative to the cubes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// The first centre that is near enough, else the nearest one.
    pub centre: usize,
    /// Distance from its cube, relative to the ranges; zero or negative inside.
    pub distance: f64,
    /// The input of the column that is farthest, and the derivative with respect to it.
    pub slope: (usize, f64),
}

impl Cubes {
    pub fn new(cover: &Cover, inputs: &[Input]) -> Self {
        let columns = cover.columns.iter().map(|&input| {
            let Input { min, max, .. } = inputs[input as usize];
            CubeAxis { input: input as usize, min, width: max - min }
        });
        Self { columns: columns.collect(), radius: cover.radius, centres: cover.centres.clone() }
    }

    /// The cube that a point is in, up to a tolerance, or the nearest one. A simulation stays near one centre for a while, so the search
    /// begins at a guess. Does not allocate.
    pub fn nearest(&self, inputs: &[f64], guess: usize, tolerance: f64) -> Nearest {
        let count = self.centres.len() / self.columns.len();
        let mut nearest = Nearest { centre: 0, distance: f64::INFINITY, slope: (self.columns[0].input, 0.0) };
        for centre in [guess.min(count - 1)].into_iter().chain(0..count) {
            let found = self.cube(centre, inputs, nearest.distance);
            if found.distance < nearest.distance {
                nearest = found;
            }
            if nearest.distance <= tolerance {
                break;
            }
        }
        nearest
    }

    /// Distance from one cube, or one that is not below `enough`.
    #[inline]
    fn cube(&self, centre: usize, inputs: &[f64], enough: f64) -> Nearest {
        let mut found = Nearest { centre, distance: -self.radius, slope: (self.columns[0].input, 0.0) };
        for (CubeAxis { input, min, width }, at) in
            self.columns.iter().zip(&self.centres[centre * self.columns.len()..])
        {
            let off = (inputs[*input] - min) / width - f64::from(*at);
            let distance = off.abs() - self.radius;
            if distance > found.distance {
                (found.distance, found.slope) = (distance, (*input, off.signum() / width));
            }
            if found.distance >= enough {
                break;
            }
        }
        found
    }
}
