//! Constraints that follow from others wherever the mechanism is: a third crank of a parallelogram, a second rail beside a first one.
//!
//! Rows of joints and couplings that depend on those before them at the start are either redundant, or the start is singular. Without
//! redundant rows the mechanism moves as with them; from a singular start, it leaves them. Multipliers of redundant rows are not
//! determined, nor are those of the rows with which they make a null vector `y`, `C_q^T y = 0`.

use super::{
    constraint::{Constraints, DEPENDENT, Target, independence, null_space},
    coordinate::TurnedBodies,
    coordinate::size_of_change,
    measure::Measure,
    model::MultibodyModel,
};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeSet;

/// Largest displacement by which it is tried if constraints follow from others, in rad or in parts of the mechanism's length.
const DISPLACEMENT: f64 = 0.1;

/// Largest violation of a redundant constraint after a displacement, in m or rad.
const VIOLATION: f64 = 1e-10;

/// Rows of a model's constraints.
#[derive(Debug, Default)]
pub struct Redundancy {
    /// Those that were taken out.
    removed: BTreeSet<usize>,
    /// All whose multipliers are not determined.
    undetermined: BTreeSet<usize>,
}

impl Redundancy {
    /// Takes the redundant constraints out of a model.
    pub fn take_out(model: &mut MultibodyModel) -> Self {
        let Some(found) = Self::of(model) else { return Self::default() };
        let [redundant, kept] = parted(&model.constraints, &found.removed);
        let of_drivers = model.deciding.iter().skip(model.constraints.len());
        let deciding = kept.iter().chain(of_drivers).cloned().collect();
        (model.constraints, model.redundant, model.deciding) = (kept, redundant, deciding);
        found
    }

    /// `None` if no constraint is redundant.
    fn of(model: &MultibodyModel) -> Option<Self> {
        // drivers of motions come last
        let timeless =
            model.constraints.iter().take_while(|constraint| !matches!(constraint.target, Target::Motion(_)));
        let geometry: Constraints = timeless.cloned().collect();
        if !has_loops(&geometry, model.mass.len()) {
            return None;
        }
        let mut q = model.position_guess.clone();
        let all: Constraints = model.constraints.iter().chain(model.initial_positions.iter()).cloned().collect();
        all.assemble(0.0, &mut q).ok()?;
        let gradients = geometry.gradients(&TurnedBodies::new(&q)).dense();
        let parts = independence(&gradients);
        let removed: BTreeSet<usize> = (0..parts.len()).filter(|&row| parts[row] <= DEPENDENT).collect();
        if removed.is_empty() {
            return None;
        }
        let [redundant, kept] = parted(&geometry, &removed);
        follows(model, &redundant, &kept, &q)
            .then(|| Self { undetermined: dependent_rows(&gradients), removed: removed.clone() })
    }

    /// True if a measure is a reaction that is not determined.
    pub fn concerns(&self, measure: &Measure) -> bool {
        match measure {
            Measure::JointForce { rows, .. } | Measure::JointMoment { rows } => {
                self.undetermined.range(rows.clone()).next().is_some()
            }
            Measure::DriverEffort(row) => self.undetermined.contains(row),
            _ => false,
        }
    }

    /// The measure with the rows of the model from which constraints were taken out.
    pub fn renumbered(&self, measure: Measure) -> Measure {
        match measure {
            Measure::JointForce { rows, component } => {
                Measure::JointForce { rows: self.row_after(rows.start)..self.row_after(rows.end), component }
            }
            Measure::JointMoment { rows } => {
                Measure::JointMoment { rows: self.row_after(rows.start)..self.row_after(rows.end) }
            }
            Measure::DriverEffort(row) => Measure::DriverEffort(self.row_after(row)),
            other => other,
        }
    }

    /// Place of a constraint after those before it are taken out.
    fn row_after(&self, row: usize) -> usize {
        row - self.removed.range(..row).count()
    }
}

/// The constraints that are removed, and the others.
fn parted(constraints: &Constraints, removed: &BTreeSet<usize>) -> [Constraints; 2] {
    [true, false].map(|is_removed| {
        let rows = constraints.iter().enumerate().filter(|(row, _)| removed.contains(row) == is_removed);
        rows.map(|(_, constraint)| constraint.clone()).collect()
    })
}

/// False if the constraints certainly are a forest: no body is held in two ways.
fn has_loops(constraints: &Constraints, coordinates: usize) -> bool {
    let mut sets: Vec<usize> = (0..=coordinates / 3).collect();
    let ground = coordinates / 3;
    fn root(sets: &[usize], mut of: usize) -> usize {
        while sets[of] != of {
            of = sets[of];
        }
        of
    }
    let mut before = "";
    for constraint in constraints.iter() {
        if matches!(constraint.target, Target::Follows(_)) {
            return true;
        }
        // the rows of a joint are one
        if constraint.owner == before {
            continue;
        }
        before = &constraint.owner;
        let [from, to] = constraint.coordinate.frames().map(|frame| root(&sets, frame.unwrap_or(ground)));
        if from == to {
            return true;
        }
        sets[from] = to;
    }
    false
}

/// True if some constraints hold wherever the mechanism is moved under the others from `q`.
fn follows(model: &MultibodyModel, some: &Constraints, others: &Constraints, q: &DVector<f64>) -> bool {
    let gradients = others.gradients(&TurnedBodies::new(q));
    let length = model.length(&model.constraints.gradients(&TurnedBodies::new(q)));
    let motions = null_space(&gradients.dense().transpose());
    let sum = motions.iter().enumerate().fold(DVector::zeros(q.len()), |sum, (index, motion)| {
        // no two motions have the same share
        sum + motion * (1.0 + index as f64).sqrt()
    });
    let (mut moved, mut tried) = (0, 0);
    for motion in motions.iter().chain([&sum]).filter(|motion| size_of_change(motion, length) > 0.0) {
        for sign in [-1.0, 1.0] {
            tried += 1;
            let mut q = q + motion * (sign * DISPLACEMENT / size_of_change(motion, length));
            // a displacement may be out of reach
            if others.correct_positions(0.0, &mut q).is_err() {
                continue;
            }
            moved += 1;
            if some.residual(0.0, &TurnedBodies::new(&q)).amax() > VIOLATION * (1.0 + q.amax()) {
                return false;
            }
        }
    }
    tried == 0 || moved > 0
}

/// Columns that have a part in a combination that is zero.
fn dependent_rows(gradients: &DMatrix<f64>) -> BTreeSet<usize> {
    let vectors = null_space(gradients);
    (0..gradients.ncols()).filter(|row| vectors.iter().any(|vector| vector[*row].abs() > 1e-6)).collect()
}
