//! Sparse gradients of scalar functions of the coordinates, and the elimination of accelerations and corrections with them.
//!
//! A constraint depends on two bodies; one that follows other coordinates depends on a few more. With weights `W` of
//! the coordinates, `C_q W C_q^T` has an entry where two constraints share a body. Its factors `L D L^T` use a
//! minimum-degree ordering, which adds no fill-in for a chain, and little for trees and loops (George, Liu: *Computer
//! Solution of Large Sparse Positive Definite Systems*, chapter 5).

use nalgebra::{DMatrix, DVector, Vector3};
use std::collections::BTreeSet;

/// Part of the largest diagonal element below which a pivot of `C_q W C_q^T` costs too many digits.
const SAFE_PIVOT: f64 = 1e-6;

/// Part of a gradient: a body by its position, and the derivatives along its `(x, y, phi)`.
type BodyPart = (usize, Vector3<f64>);

/// SparseGradients one after the other, such as the columns of `C_q^T`.
#[derive(Clone, Debug)]
pub struct SparseGradients {
    /// Number of coordinates of all bodies.
    coordinates: usize,
    parts: Vec<BodyPart>,
    /// End of each gradient among the parts.
    ends: Vec<usize>,
}

impl SparseGradients {
    /// An empty list, with memory for `capacity` gradients of functions of `coordinates` coordinates.
    pub fn new(coordinates: usize, capacity: usize) -> Self {
        Self { coordinates, parts: Vec::with_capacity(2 * capacity), ends: Vec::with_capacity(capacity) }
    }

    /// Number of gradients.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// `true` if there are none.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Number of coordinates.
    pub fn coordinates(&self) -> usize {
        self.coordinates
    }

    /// Adds a gradient; `write` passes its parts on, several of one body are summed.
    pub fn push(&mut self, write: impl FnOnce(&mut dyn FnMut(usize, Vector3<f64>))) {
        let (first, parts) = (self.parts.len(), &mut self.parts);
        write(&mut |body, part| match parts[first..].iter_mut().find(|(known, _)| *known == body) {
            Some((_, sum)) => *sum += part,
            None => parts.push((body, part)),
        });
        self.ends.push(self.parts.len());
    }

    /// Positions of a gradient's parts.
    fn range(&self, gradient: usize) -> std::ops::Range<usize> {
        gradient.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[gradient]
    }

    /// Parts of a gradient, one for each body.
    pub fn parts(&self, gradient: usize) -> &[BodyPart] {
        &self.parts[self.range(gradient)]
    }

    /// Each gradient times a vector: `C_q v`.
    pub fn along(&self, vector: &DVector<f64>) -> DVector<f64> {
        let bodies = vector.as_slice();
        let mut first = 0;
        DVector::from_iterator(
            self.len(),
            self.ends.iter().map(|&end| {
                let parts = &self.parts[std::mem::replace(&mut first, end)..end];
                let along = parts.iter().map(|(body, part)| {
                    let of_body = &bodies[3 * body..3 * body + 3];
                    part.x * of_body[0] + part.y * of_body[1] + part.z * of_body[2]
                });
                along.sum()
            }),
        )
    }

    /// Sum of the gradients, each times its factor: `C_q^T lambda`.
    pub fn sum(&self, factors: &DVector<f64>) -> DVector<f64> {
        let mut sum = DVector::zeros(self.coordinates);
        let (bodies, mut first) = (sum.as_mut_slice(), 0);
        for (&end, factor) in self.ends.iter().zip(factors.iter()) {
            for (body, part) in &self.parts[std::mem::replace(&mut first, end)..end] {
                let of_body = &mut bodies[3 * body..3 * body + 3];
                of_body.iter_mut().zip(part.iter()).for_each(|(sum, entry)| *sum += factor * entry);
            }
        }
        sum
    }

    /// The gradients as columns of a matrix of shape `[coordinates, gradients]`.
    pub fn dense(&self) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(self.coordinates, self.len());
        for (gradient, mut column) in matrix.column_iter_mut().enumerate() {
            for (body, part) in self.parts(gradient) {
                column.fixed_rows_mut::<3>(3 * body).copy_from(part);
            }
        }
        matrix
    }
}

/// Order and pattern of the factors of `C_q W C_q^T`: the same for all configurations of a model.
#[derive(Clone, Debug)]
pub struct Elimination {
    /// Gradients in the order in which they are eliminated.
    order: Vec<usize>,
    /// Row of each entry of `L`, column by column: the diagonal, then the rows below it.
    rows: Vec<usize>,
    /// Position of each column's diagonal among the entries, and the end of the last one.
    starts: Vec<usize>,
    /// Entry that each product of two parts of a shared body is added to, and the positions of the parts.
    products: Vec<[usize; 3]>,
    /// Columns with an entry in each row, and the entry's position, row by row.
    before: Vec<(usize, usize)>,
    /// End of each row among these.
    before_ends: Vec<usize>,
}

/// Factors `L D L^T` of `C_q W C_q^T`.
#[derive(Debug)]
pub struct Factors<'a> {
    elimination: &'a Elimination,
    /// `D` on the diagonal, `L` below it.
    entries: Vec<f64>,
}

impl Elimination {
    /// Order and pattern for gradients with parts of these bodies.
    pub fn new(gradients: &SparseGradients) -> Self {
        let count = gradients.len();
        let mut of_body = vec![Vec::new(); gradients.coordinates() / 3];
        for gradient in 0..count {
            for position in gradients.range(gradient) {
                of_body[gradients.parts[position].0].push((gradient, position));
            }
        }
        let mut neighbors = vec![BTreeSet::new(); count];
        for shared in &of_body {
            for (one, _) in shared {
                neighbors[*one].extend(shared.iter().map(|(other, _)| *other).filter(|other| other != one));
            }
        }
        let (mut order, mut columns) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut remaining: BTreeSet<usize> = (0..count).collect();
        while let Some(next) = remaining.iter().copied().min_by_key(|&one| neighbors[one].len()) {
            remaining.remove(&next);
            let column = std::mem::take(&mut neighbors[next]);
            for one in &column {
                neighbors[*one].extend(column.iter().filter(|other| *other != one));
                neighbors[*one].remove(&next);
            }
            order.push(next);
            columns.push(column);
        }
        let mut places = vec![0; count];
        order.iter().enumerate().for_each(|(place, &gradient)| places[gradient] = place);
        let (mut rows, mut starts, mut of_row) = (Vec::new(), Vec::with_capacity(count + 1), vec![Vec::new(); count]);
        for (place, column) in columns.iter().enumerate() {
            starts.push(rows.len());
            rows.push(place);
            let first = rows.len();
            rows.extend(column.iter().map(|&gradient| places[gradient]));
            rows[first..].sort_unstable();
            (first..rows.len()).for_each(|entry| of_row[rows[entry]].push((place, entry)));
        }
        starts.push(rows.len());
        let mut products = Vec::new();
        for shared in &of_body {
            for (index, (one, position)) in shared.iter().enumerate() {
                for (other, with) in &shared[..=index] {
                    let (column, row) = (places[*one].min(places[*other]), places[*one].max(places[*other]));
                    let entries = &rows[starts[column]..starts[column + 1]];
                    // eliminated together, so that the entry exists
                    let entry = entries.partition_point(|&known| known < row);
                    products.push([starts[column] + entry, *position, *with]);
                }
            }
        }
        products.sort_unstable();
        let before_ends = of_row.iter().scan(0, |end, row| {
            *end += row.len();
            Some(*end)
        });
        let before_ends = before_ends.collect();
        Self { order, rows, starts, products, before: of_row.concat(), before_ends }
    }

    /// Number of entries of the factors.
    pub fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Factors of `C_q W C_q^T` with the weights `W` of a body's coordinates. `None` if the matrix is not safely positive definite.
    pub fn factorise(
        &self,
        gradients: &SparseGradients,
        weight: impl Fn(usize) -> Vector3<f64>,
    ) -> Option<Factors<'_>> {
        let weighted: Vec<Vector3<f64>> =
            gradients.parts.iter().map(|(body, part)| part.component_mul(&weight(*body))).collect();
        let mut entries = vec![0.0; self.rows.len()];
        for &[entry, one, other] in &self.products {
            entries[entry] += weighted[one].dot(&gradients.parts[other].1);
        }
        let count = self.order.len();
        let largest = self.starts[..count].iter().map(|&start| entries[start]).fold(0.0, f64::max);
        let mut sums = vec![0.0; count];
        let mut first = 0;
        for column in 0..count {
            let (start, end) = (self.starts[column], self.starts[column + 1]);
            for &(before, entry) in &self.before[first..self.before_ends[column]] {
                let factor = entries[entry] * entries[self.starts[before]];
                let below = entry..self.starts[before + 1];
                for (row, value) in self.rows[below.clone()].iter().zip(&entries[below]) {
                    sums[*row] += value * factor;
                }
            }
            first = self.before_ends[column];
            let pivot = entries[start] - std::mem::take(&mut sums[column]);
            // false for NaN, too
            if !(pivot >= SAFE_PIVOT * largest && pivot > 0.0) {
                return None;
            }
            entries[start] = pivot;
            let inverse = 1.0 / pivot;
            for (row, value) in self.rows[start + 1..end].iter().zip(&mut entries[start + 1..end]) {
                *value = (*value - std::mem::take(&mut sums[*row])) * inverse;
            }
        }
        Some(Factors { elimination: self, entries })
    }
}

impl Factors<'_> {
    /// `(C_q W C_q^T)^-1 b`.
    pub fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        let Elimination { order, rows, starts, .. } = self.elimination;
        let mut x: Vec<f64> = order.iter().map(|&gradient| b[gradient]).collect();
        let below = |column: usize| {
            let below = starts[column] + 1..starts[column + 1];
            rows[below.clone()].iter().zip(&self.entries[below])
        };
        for column in 0..x.len() {
            let value = x[column];
            below(column).for_each(|(&row, entry)| x[row] -= entry * value);
        }
        for column in (0..x.len()).rev() {
            let sum: f64 = below(column).map(|(&row, entry)| entry * x[row]).sum();
            x[column] = x[column] / self.entries[starts[column]] - sum;
        }
        let mut solution = DVector::zeros(x.len());
        order.iter().zip(x).for_each(|(&gradient, value)| solution[gradient] = value);
        solution
    }
}
