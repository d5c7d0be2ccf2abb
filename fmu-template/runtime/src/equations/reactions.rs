//! Forces and moments that follow from the motion: of joints, and of springs.
//!
//! The equations of the bodies on one side of a joint have no inverse of the mass matrix, so that a force is, with the accelerations
//! `a` of the coordinates,
//!
//! ```text
//! r = A(q, p) a + sum over i >= j of C_ij(q, p) v_i v_j + D(q, p) v + F(q, p) + B(q, p) e
//! ```
//!
//! The functions of the configuration are of the same kind as those of the [equations of motion](super::dynamics): for
//! a tree of joints they are sums of sines, cosines and powers. The efforts `e` and the accelerations are those of the
//! equations.

use super::{
    dictionary::Dictionary,
    dynamics::Point,
    tape::{Register, Tape, TapeBuilder, TapeWork, listing::Listing},
};
use crate::{FormatError, check::expect_shape, numbers::jet::Number};

/// Forces and moments of a motion with `n` coordinates, as functions of state, accelerations and efforts.
#[derive(Clone, Debug, PartialEq)]
pub struct Reactions {
    coordinates: usize,
    efforts: usize,
    /// From `(q, p)` to the functions of each force, one force after the other.
    functions: Dictionary,
    /// The forces, whose inputs are `(q, p, v, a, e)`.
    tape: Tape,
    forces: Vec<Register>,
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
        let (tape, forces) = (Tape::default(), Vec::new());
        Ok(Self { coordinates, efforts, functions, tape, forces }.write())
    }

    fn write(mut self) -> Self {
        let (n, columns) = (self.coordinates, self.functions.columns());
        let mut tape = TapeBuilder::new(columns + 2 * n + self.efforts, n..columns);
        let (v, a, e) = (columns, columns + n, columns + 2 * n);
        let written = self.functions.write(&(0..columns).map(Register::input).collect::<Vec<_>>(), &mut tape);
        for index in 0..self.count() {
            let mut function = index * Self::functions_of_each(n, self.efforts)..;
            let mut next = |tape: &mut TapeBuilder| written.value(function.next().unwrap_or_default(), tape);
            let mut force = tape.zero;
            for i in 0..n {
                let of_acceleration = next(&mut tape);
                force = tape.add_product(force, of_acceleration, Register::input(a + i));
            }
            for (i, j) in (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))) {
                let (of_square, velocities) = (next(&mut tape), [i, j].map(|k| Register::input(v + k)));
                let square = tape.product(velocities[0], velocities[1]);
                force = tape.add_product(force, of_square, square);
            }
            for i in 0..n {
                let of_velocity = next(&mut tape);
                force = tape.add_product(force, of_velocity, Register::input(v + i));
            }
            let rest = next(&mut tape);
            force = tape.add_product(force, rest, tape.one);
            for k in 0..self.efforts {
                let of_effort = next(&mut tape);
                force = tape.add_product(force, of_effort, Register::input(e + k));
            }
            self.forces.push(force);
        }
        self.tape = tape.finish();
        self
    }

    /// The forces as data, functions of `(q, p, v, a, e)`.
    pub fn listing(&self) -> Listing {
        self.tape.listing(self.forces.iter().copied())
    }

    /// Makes sure that the reactions fit equations with these numbers of coordinates, of efforts, and of coordinates
    /// and parameters.
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

    /// Returns true if a force depends on a coordinate or parameter, by its position among both.
    pub fn depends_on(&self, column: usize) -> bool {
        self.functions.terms().any(|term| term.exponents[column] != 0)
    }

    /// Returns true if a force changes at once with an effort: directly, or because accelerations do.
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
        self.compute([&[q, p].concat(), v, accelerations], |k| u[k], &mut work);
        (0..self.count()).map(|index| self.value(index, &work)).collect()
    }

    pub(super) fn work<T: Number>(&self) -> TapeWork<T> {
        self.tape.work()
    }

    /// Computes the forces at `(q, p)` with velocities, accelerations and efforts. Does not allocate.
    pub(super) fn compute<T: Number>(&self, parts: [&[T]; 3], effort: impl Fn(usize) -> T, work: &mut TapeWork<T>) {
        let known = parts.into_iter().flatten().copied();
        work.set_inputs(known.chain((0..self.efforts).map(effort)));
        self.tape.run(work);
    }

    /// A force or moment, once they were computed.
    pub(super) fn value<T: Number>(&self, index: usize, work: &TapeWork<T>) -> T {
        work.get(self.forces[index])
    }
}
