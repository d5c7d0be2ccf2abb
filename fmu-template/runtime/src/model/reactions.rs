//! Forces and moments that follow from the motion: of joints, and of springs.
//!
//! The equations of the bodies on one side of a joint have no inverse of the mass matrix, so that a force is, with the accelerations
//! `a` of the coordinates,
//!
//! ```text
//! r = A(q, p) a + sum over i >= j of C_ij(q, p) v_i v_j + D(q, p) v + F(q, p) + B(q, p) e
//! ```
//!
//! whose functions of the configuration are of the same kind as those of the [equations of motion](super::dynamics), and whose efforts `e`
//! are theirs: of a tree of joints sums of sines, cosines and powers. The accelerations are those of the equations.

use super::dynamics::Point;
use crate::{
    FormatError,
    dictionary::Dictionary,
    map::{
        expect_shape,
        jet::Number,
        law::{Law, PreparedLaw},
        tape::TapeWork,
    },
};

/// Forces and moments in a motion with `n` coordinates and so many efforts.
#[derive(Clone, Debug, PartialEq)]
pub struct Reactions {
    coordinates: usize,
    efforts: usize,
    /// From `(q, p)` to the functions of each force, one force after the other.
    functions: Dictionary,
    prepared: PreparedLaw,
}

/// Working memory of one evaluation in one kind of numbers.
#[derive(Clone, Debug)]
pub(super) struct ReactionsWork<T> {
    functions: Vec<T>,
    of_functions: TapeWork<T>,
}

impl Reactions {
    /// Number of functions of a force: `A`, the lower triangle of `C` row by row, `D`, `F`, `B`.
    pub fn functions_of_each(coordinates: usize, efforts: usize) -> usize {
        let n = coordinates;
        n + n * (n + 1) / 2 + n + 1 + efforts
    }

    /// The forces from their functions of `(q, p)`.
    ///
    /// # Errors
    /// [`FormatError`] if there are functions of a part of a force, or none, or fewer columns than coordinates.
    pub fn new(coordinates: usize, efforts: usize, functions: Dictionary) -> Result<Self, FormatError> {
        let each = Self::functions_of_each(coordinates, efforts);
        let expected = functions.outputs().div_ceil(each).max(1) * each;
        expect_shape("reactions", &[functions.outputs()], &[expected])?;
        if functions.columns() < coordinates {
            let (found, expected) = (vec![functions.columns()], vec![coordinates]);
            return Err(FormatError::Shape { name: "reactions".into(), found, expected });
        }
        let prepared = Law::from(functions.clone()).prepared(0, coordinates..functions.columns());
        Ok(Self { coordinates, efforts, functions, prepared })
    }

    /// Makes sure that it fits equations of motion with so many coordinates, efforts, and coordinates and parameters.
    ///
    /// # Errors
    /// [`FormatError`].
    pub(super) fn check(&self, [coordinates, efforts, columns]: [usize; 3]) -> Result<(), FormatError> {
        let found = [self.coordinates, self.efforts, self.functions.columns()];
        expect_shape("reactions", &found, &[coordinates, efforts, columns])
    }

    /// Number of forces and moments.
    pub fn count(&self) -> usize {
        self.functions.outputs() / Self::functions_of_each(self.coordinates, self.efforts)
    }

    /// The functions of the configuration.
    pub fn functions(&self) -> &Dictionary {
        &self.functions
    }

    /// Whether a force depends on a coordinate or parameter, by its position among both.
    pub fn depends_on(&self, column: usize) -> bool {
        self.functions.terms().any(|term| term.exponents[column] != 0)
    }

    /// Whether a force changes at once with an effort: by its own share, or because accelerations do.
    pub fn follows_efforts(&self, index: usize) -> bool {
        let each = Self::functions_of_each(self.coordinates, self.efforts);
        let of_efforts = each - self.efforts..each;
        let mut functions = (0..self.coordinates).chain(of_efforts).map(|function| index * each + function);
        functions.any(|function| self.functions.terms().any(|term| term.coefficients[function] != 0.0))
    }

    /// The forces in a state with these efforts, in the place of the inputs, and accelerations.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn evaluate(&self, Point { q, v, u, p }: Point, accelerations: &[f64]) -> Vec<f64> {
        let mut work = self.work();
        self.compute(&[q, p].concat(), &mut work);
        (0..self.count()).map(|index| self.value(index, [v, accelerations], |k| u[k], &work)).collect()
    }

    pub(super) fn work<T: Number>(&self) -> ReactionsWork<T> {
        let functions = vec![T::from(0.0); self.functions.outputs()];
        ReactionsWork { functions, of_functions: self.prepared.work() }
    }

    /// Computes the functions at `(q, p)`, of which [`value`](Self::value) makes the forces. Does not allocate.
    pub(super) fn compute<T: Number>(&self, columns: &[T], work: &mut ReactionsWork<T>) {
        self.prepared.compute(columns, &mut work.functions, &mut [], &mut work.of_functions);
    }

    /// A force or moment with velocities, efforts and accelerations.
    pub(super) fn value<T: Number>(
        &self,
        index: usize,
        [v, a]: [&[T]; 2],
        effort: impl Fn(usize) -> T,
        work: &ReactionsWork<T>,
    ) -> T {
        let (n, each) = (self.coordinates, Self::functions_of_each(self.coordinates, self.efforts));
        let (of_accelerations, rest) = work.functions[index * each..][..each].split_at(n);
        let (of_squares, rest) = rest.split_at(n * (n + 1) / 2);
        let (of_velocities, rest) = rest.split_at(n);
        let mut force = rest[0];
        for i in 0..n {
            force = force + of_accelerations[i] * a[i] + of_velocities[i] * v[i];
            for j in 0..=i {
                force = force + of_squares[i * (i + 1) / 2 + j] * v[i] * v[j];
            }
        }
        rest[1..].iter().enumerate().fold(force, |force, (k, function)| force + *function * effort(k))
    }
}
