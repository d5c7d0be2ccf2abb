//! Lookup tables: functions of one or two variables by linear interpolation or cubic splines.

use super::bends::{Bend, Bends};
use crate::FormatError;
use crate::{
    check::{expect_finite, expect_shape},
    numbers::jet::{Jet, Number},
};
use std::sync::Arc;

/// Interpolation between knots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// On straight lines; bilinear in two dimensions.
    Linear,
    /// On a spline with continuous second derivatives. Its ends are those of *not-a-knot* splines (de Boor: *A Practical Guide to Splines*,
    /// chapter 4): the third derivative is continuous at the second and at the last but one knot.
    Cubic,
}

/// Values beyond the first and the last knot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extrapolation {
    /// The value at the end.
    Hold,
    /// The tangent at the end.
    Linear,
    /// The table repeats itself, and the values at both ends are equal.
    Periodic,
}

impl Interpolation {
    /// All of them, in the order of their numbers in the model file.
    pub const ALL: [Self; 2] = [Self::Linear, Self::Cubic];
}

impl Extrapolation {
    /// All of them, in the order of their numbers in the model file.
    pub const ALL: [Self; 3] = [Self::Hold, Self::Linear, Self::Periodic];
}

/// A function that takes given values at the knots of a grid.
///
/// With the knots `x_i` around `x`, `h = x_(i+1) - x_i` and `w = (x - x_i) / h` it is `(1 - w) f_i + w f_(i+1)` or, with slopes `s_i`, the cubic
/// Hermite polynomial `(1 + 2w)(1 - w)² f_i + w (1 - w)² h s_i + w² (3 - 2w) f_(i+1) - w² (1 - w) h s_(i+1)`; in two dimensions the
/// tensor product of both. Derivatives are exact. At a kink they are those towards larger arguments.
#[derive(Clone, Debug, PartialEq)]
pub struct LookupTable {
    axes: Vec<Vec<f64>>,
    values: Vec<f64>,
    interpolation: Interpolation,
    extrapolation: Extrapolation,
    nodes: Vec<f64>,
    /// Knots where the slope changes much, by axis.
    bends: Vec<Arc<Bends>>,
}

/// Change of the slope at a [`Bend`], times the shorter interval beside it and relative to the range of the values, at least.
const BENT: f64 = 1e-3;

/// Numbers of a node: the value, for a spline also its slope, in two dimensions slopes along `x`, along `y` and the mixed derivative.
type Weights<T> = [[T; 2]; 2];

impl LookupTable {
    /// A table of values, shape `[x]` or `[x, y]`, at the knots of one or two axes.
    ///
    /// # Errors
    /// [`FormatError`] if there is no axis or more than two, an axis has fewer than two knots, knots do not ascend, or
    /// numbers are not finite. Also if the values have a different shape, or the ends of a periodic table differ.
    pub fn new(
        axes: Vec<Vec<f64>>,
        values: Vec<f64>,
        interpolation: Interpolation,
        extrapolation: Extrapolation,
    ) -> Result<Self, FormatError> {
        expect_shape("lookup.axes", &[axes.len()], &[axes.len().clamp(1, 2)])?;
        for axis in &axes {
            expect_shape("lookup.knots", &[axis.len()], &[axis.len().max(2)])?;
            expect_finite("lookup.knots", axis.iter().copied())?;
            if let Some(index) = axis.windows(2).position(|pair| pair[0] >= pair[1]) {
                let (before, found) = (axis[index], axis[index + 1]);
                return Err(FormatError::NotAscending { name: "lookup.knots".into(), index: index + 1, before, found });
            }
        }
        expect_shape("lookup.values", &[values.len()], &[axes.iter().map(Vec::len).product()])?;
        expect_finite("lookup.values", values.iter().copied())?;
        let (nodes, bends) = (Vec::new(), Vec::new());
        let mut table = Self { axes, values, interpolation, extrapolation, nodes, bends };
        if let Some(index) = table.first_open_end() {
            return Err(FormatError::OpenPeriod { index });
        }
        table.nodes = table.with_slopes();
        expect_finite("lookup.values", table.nodes.iter().copied())?;
        table.bends = (0..table.axes.len()).map(|axis| Arc::new(table.find_bends(axis))).collect();
        Ok(table)
    }

    /// First and second derivative of a table of one argument that is a spline, as tables with the same knots. Beyond
    /// the ends they keep the values at the ends. They have no bends: the table itself has the bends that a solver must
    /// not step over.
    ///
    /// # Errors
    /// [`FormatError::Shape`] if it has two arguments or is not a spline.
    pub fn derivatives(&self) -> Result<[Self; 2], FormatError> {
        expect_shape(
            "lookup.axes",
            &[self.axes.len(), self.interpolation as usize],
            &[1, Interpolation::Cubic as usize],
        )?;
        let slopes: Vec<f64> = self.nodes.as_chunks::<2>().0.iter().map(|node| node[1]).collect();
        let (knots, last) = (&self.axes[0], self.axes[0].len() - 1);
        // the second derivative is continuous: that at a knot is that of either interval beside it
        let seconds = (0..=last).map(|knot| {
            let (from, to) = if knot < last { (knot, knot + 1) } else { (knot - 1, knot) };
            let h = knots[to] - knots[from];
            let chord = (self.values[to] - self.values[from]) / h;
            let both = if knot < last { 2.0 * slopes[from] + slopes[to] } else { -slopes[from] - 2.0 * slopes[to] };
            (if knot < last { 6.0 } else { -6.0 } * chord - 2.0 * both) / h
        });
        let mut seconds: Vec<f64> = seconds.collect();
        let extrapolation = match self.extrapolation {
            Extrapolation::Periodic => Extrapolation::Periodic,
            Extrapolation::Hold | Extrapolation::Linear => Extrapolation::Hold,
        };
        let mut first = Self { values: slopes, extrapolation, bends: vec![Arc::default()], ..self.clone() };
        if extrapolation == Extrapolation::Periodic {
            seconds[last] = seconds[0];
            first.values[last] = first.values[0];
        }
        first.nodes = first.values.iter().zip(&seconds).flat_map(|(value, slope)| [*value, *slope]).collect();
        let second =
            Self { values: seconds.clone(), nodes: seconds, interpolation: Interpolation::Linear, ..first.clone() };
        Ok([first, second])
    }

    /// Knots of an axis at which the slope changes much, in their order. Features between them are so narrow that a solver may step over them.
    pub fn bends(&self, axis: usize) -> &Arc<Bends> {
        &self.bends[axis]
    }

    /// Length of the repeated part of an axis; none if the table is not periodic.
    pub fn period(&self, axis: usize) -> Option<f64> {
        let knots = &self.axes[axis];
        (self.extrapolation == Extrapolation::Periodic).then(|| knots[knots.len() - 1] - knots[0])
    }

    #[inline(never)]
    fn find_bends(&self, axis: usize) -> Bends {
        let knots = &self.axes[axis];
        let ends = self.values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], y| [a.min(*y), b.max(*y)]);
        let least = BENT * (ends[1] - ends[0]);
        let lines = self.lines(axis);
        let last = knots.len() - 1;
        let bends = knots.iter().enumerate().filter_map(|(k, at)| {
            let before = if k > 0 { knots[k] - knots[k - 1] } else { f64::INFINITY };
            let after = if k < last { knots[k + 1] - knots[k] } else { f64::INFINITY };
            let width = before.min(after);
            let changes = lines.iter().map(|line| {
                let before = if k > 0 { self.chord(knots, line, k - 1) } else { self.slope_beyond(knots, line, 0) };
                let after = if k < last { self.chord(knots, line, k) } else { self.slope_beyond(knots, line, last) };
                (after - before).abs() * width
            });
            let largest = changes.fold(0.0, f64::max);
            (largest > least).then_some(Bend { at: *at, width })
        });
        Bends::new(bends.collect(), knots[0], self.period(axis))
    }

    /// Slope of a line of values from knot `k` to the next one.
    fn chord(&self, knots: &[f64], line: &[usize], k: usize) -> f64 {
        (self.values[line[k + 1]] - self.values[line[k]]) / (knots[k + 1] - knots[k])
    }

    /// Slope of a line of values beyond its first or last knot.
    fn slope_beyond(&self, knots: &[f64], line: &[usize], knot: usize) -> f64 {
        let (first, last) = (0, knots.len() - 2);
        let [own, opposite] = if knot == 0 { [first, last] } else { [last, first] };
        match self.extrapolation {
            Extrapolation::Hold => 0.0,
            Extrapolation::Linear => self.chord(knots, line, own),
            Extrapolation::Periodic => self.chord(knots, line, opposite),
        }
    }

    /// Knots of each axis.
    pub fn axes(&self) -> &[Vec<f64>] {
        &self.axes
    }

    /// Number of arguments: one or two.
    pub fn arguments(&self) -> usize {
        self.axes.len()
    }

    /// Values at the knots, shape `[x]` or `[x, y]`.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Values and slopes at the knots: shape `[x, y, numbers]`, with this [number for each
    /// knot](Self::numbers_of_node).
    pub fn nodes(&self) -> &[f64] {
        &self.nodes
    }

    /// Interpolation between knots.
    pub fn interpolation(&self) -> Interpolation {
        self.interpolation
    }

    /// Values beyond the ends.
    pub fn extrapolation(&self) -> Extrapolation {
        self.extrapolation
    }

    /// Returns true if the first derivative is continuous everywhere.
    pub fn is_smooth(&self) -> bool {
        self.interpolation == Interpolation::Cubic && self.extrapolation != Extrapolation::Hold
    }

    /// Returns true if nodes have slopes: those of splines, and those at the ends of tables that go on along their tangents.
    pub fn has_slopes(&self) -> bool {
        self.interpolation == Interpolation::Cubic || self.extrapolation == Extrapolation::Linear
    }

    /// Number of values in a node: the value itself, and with slopes its derivative along `x`, along `y`, and the mixed one.
    pub fn numbers_of_node(&self) -> usize {
        if self.has_slopes() { 1 << self.axes.len() } else { 1 }
    }

    /// Position of the first value at an end that differs from that at the start, in a periodic table.
    #[inline(never)]
    fn first_open_end(&self) -> Option<usize> {
        if self.extrapolation != Extrapolation::Periodic {
            return None;
        }
        let lines = (0..self.axes.len()).flat_map(|axis| self.lines(axis));
        let open = lines.filter(|line| self.values[line[0]] != self.values[line[line.len() - 1]]);
        open.map(|line| line[line.len() - 1]).min()
    }

    /// Positions of the values along an axis, line by line.
    #[inline(never)]
    fn lines(&self, axis: usize) -> Vec<Vec<usize>> {
        let columns = self.axes.get(1).map_or(1, Vec::len);
        let rows = self.axes[0].len();
        match axis {
            0 => (0..columns).map(|column| (0..rows).map(|row| row * columns + column).collect()).collect(),
            _ => (0..rows).map(|row| (0..columns).map(|column| row * columns + column).collect()).collect(),
        }
    }

    #[inline(never)]
    fn with_slopes(&self) -> Vec<f64> {
        if !self.has_slopes() {
            return self.values.clone();
        }
        // value, then slope along x; after them those of both along y
        let mut derivatives = vec![self.values.clone()];
        for (axis, knots) in self.axes.iter().enumerate() {
            let lines = self.lines(axis);
            let slopes = derivatives.iter().map(|values| {
                let mut slopes = vec![0.0; values.len()];
                for line in &lines {
                    let of_line: Vec<f64> = line.iter().map(|position| values[*position]).collect();
                    let of_line = self.line_slopes(knots, &of_line);
                    line.iter().zip(of_line).for_each(|(position, slope)| slopes[*position] = slope);
                }
                slopes
            });
            let slopes: Vec<Vec<f64>> = slopes.collect();
            derivatives.extend(slopes);
        }
        let nodes = 0..self.values.len();
        nodes.flat_map(|position| derivatives.iter().map(move |numbers| numbers[position])).collect()
    }

    /// Slopes at the knots of a line of values.
    fn line_slopes(&self, knots: &[f64], values: &[f64]) -> Vec<f64> {
        match self.interpolation {
            Interpolation::Linear => end_slopes(knots, values),
            Interpolation::Cubic => spline_slopes(knots, values, self.extrapolation == Extrapolation::Periodic),
        }
    }

    /// Value with derivatives along a curve of the arguments, of which there is one for each axis.
    ///
    /// # Panics
    /// If there are fewer arguments than axes.
    pub fn series(&self, x: &[Jet]) -> Jet {
        self.at(x)
    }

    /// Value at one or two arguments.
    ///
    /// # Panics
    /// If there are fewer arguments than axes.
    pub(crate) fn at<T: Number>(&self, x: &[T]) -> T {
        let (row, along_x) = self.weights(0, x[0]);
        let (column, along_y) = match self.axes.len() {
            1 => (0, [[T::from(1.0), T::from(0.0)], [T::from(0.0); 2]]),
            _ => self.weights(1, x[1]),
        };
        let (columns, numbers) = (self.axes.get(1).map_or(1, Vec::len), self.numbers_of_node());
        let mut sum = T::from(0.0);
        for (i, of_x) in along_x.iter().enumerate() {
            for (j, of_y) in along_y.iter().enumerate().take(self.axes.len()) {
                let node = &self.nodes[((row + i) * columns + column + j) * numbers..][..numbers];
                for (which, number) in node.iter().enumerate() {
                    sum = sum + (of_x[which % 2] * of_y[which / 2]).scaled(*number);
                }
            }
        }
        sum
    }

    /// First of the two knots around an argument, and the weights of value and slope at both.
    fn weights<T: Number>(&self, axis: usize, x: T) -> (usize, Weights<T>) {
        let knots = &self.axes[axis];
        let last = knots.len() - 1;
        let [start, end] = [knots[0], knots[last]];
        let (one, zero) = (T::from(1.0), T::from(0.0));
        let x = match self.extrapolation {
            Extrapolation::Periodic => x - T::from(((x.value() - start) / (end - start)).floor() * (end - start)),
            Extrapolation::Hold | Extrapolation::Linear => x,
        };
        let at = knots.partition_point(|knot| *knot <= x.value()).clamp(1, last) - 1;
        let (left, h) = (knots[at], knots[at + 1] - knots[at]);
        let is_beyond = x.value() < start || x.value() > end;
        if is_beyond && self.extrapolation != Extrapolation::Periodic {
            let is_first = x.value() < start;
            // from the end on: farther away, differences of values would lose their digits
            let along = match self.extrapolation {
                Extrapolation::Hold => zero,
                _ => x - T::from(if is_first { start } else { end }),
            };
            return (at, if is_first { [[one, along], [zero; 2]] } else { [[zero; 2], [one, along]] });
        }
        let w = (x - T::from(left)).scaled(h.recip());
        let rest = one - w;
        match self.interpolation {
            Interpolation::Linear => (at, [[rest, zero], [w, zero]]),
            Interpolation::Cubic => {
                let [of_first, of_second] = [(w, rest), (rest, w)].map(|(from, to)| {
                    let square = to * to;
                    [square * (one + from.scaled(2.0)), square * from.scaled(h)]
                });
                (at, [of_first, [of_second[0], of_second[1].scaled(-1.0)]])
            }
        }
    }
}

/// Slopes of straight lines at the first and the last knot; zero at all others, where they are not used.
#[inline(never)]
fn end_slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let last = x.len() - 1;
    let mut slopes = vec![0.0; x.len()];
    [slopes[0], slopes[last]] = [0, last - 1].map(|k| (y[k + 1] - y[k]) / (x[k + 1] - x[k]));
    slopes
}

/// Slopes of a cubic spline at its knots.
#[inline(never)]
fn spline_slopes(x: &[f64], y: &[f64], is_periodic: bool) -> Vec<f64> {
    let h: Vec<f64> = x.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let chord: Vec<f64> = y.windows(2).zip(&h).map(|(pair, h)| (pair[1] - pair[0]) / h).collect();
    let n = x.len();
    match (n, is_periodic) {
        (2, _) => vec![chord[0]; 2],
        // a parabola
        (3, false) => {
            let curvature = (chord[1] - chord[0]) / (h[0] + h[1]);
            vec![chord[0] - curvature * h[0], chord[0] + curvature * h[0], chord[1] + curvature * h[1]]
        }
        (_, false) => {
            let side = end_side([h[0], h[1]], [chord[0], chord[1]]);
            let mut rows = vec![TridiagonalRow { before: 0.0, own: h[1], after: h[0] + h[1], side }];
            rows.extend((1..n - 1).map(|knot| inner_row(&h, &chord, knot - 1, knot)));
            let side = end_side([h[n - 2], h[n - 3]], [chord[n - 2], chord[n - 3]]);
            rows.push(TridiagonalRow { before: h[n - 2] + h[n - 3], own: h[n - 3], after: 0.0, side });
            tridiagonal(&rows)
        }
        // the slope at the start is that at the end: the others follow from it linearly
        (_, true) => {
            let others: Vec<TridiagonalRow> = (1..n - 1).map(|knot| inner_row(&h, &chord, knot - 1, knot)).collect();
            let TridiagonalRow { before, own, after, side } = inner_row(&h, &chord, n - 2, 0);
            let (fixed, by_start) = (inner_slopes(&others, 0.0, 1.0), inner_slopes(&others, 1.0, 0.0));
            let last = fixed.len() - 1;
            let known = before * fixed[last] + after * fixed[0];
            let start = (side - known) / (own + before * by_start[last] + after * by_start[0]);
            let others = fixed.iter().zip(&by_start).map(|(fixed, by_start)| fixed + start * by_start);
            [start].into_iter().chain(others).chain([start]).collect()
        }
    }
}

/// An equation: numbers before, on and after the diagonal, and the right side.
struct TridiagonalRow {
    before: f64,
    own: f64,
    after: f64,
    side: f64,
}

/// Continuous second derivatives at a knot between two intervals of lengths `h` and slopes `chord`.
fn inner_row(h: &[f64], chord: &[f64], before: usize, after: usize) -> TridiagonalRow {
    let [a, b] = [h[before], h[after]];
    TridiagonalRow { before: b, own: 2.0 * (a + b), after: a, side: 3.0 * (b * chord[before] + a * chord[after]) }
}

/// Right side of the equation at an end, from the lengths and slopes of the interval there and the next one.
fn end_side(h: [f64; 2], chord: [f64; 2]) -> f64 {
    let both = h[0] + h[1];
    ((h[0] + 2.0 * both) * h[1] * chord[0] + h[0] * h[0] * chord[1]) / both
}

/// Slopes between the ends for a slope at both ends, with right sides times `scale`.
fn inner_slopes(rows: &[TridiagonalRow], at_ends: f64, scale: f64) -> Vec<f64> {
    let rows = rows.iter().map(|row| TridiagonalRow { side: scale * row.side, ..*row });
    let mut rows: Vec<TridiagonalRow> = rows.collect();
    let last = rows.len() - 1;
    rows[0].side -= rows[0].before * at_ends;
    rows[last].side -= rows[last].after * at_ends;
    tridiagonal(&rows)
}

/// Solution of equations with three diagonals.
#[inline(never)]
fn tridiagonal(rows: &[TridiagonalRow]) -> Vec<f64> {
    let mut reduced: Vec<[f64; 2]> = Vec::with_capacity(rows.len());
    for TridiagonalRow { before, own, after, side } in rows {
        let [factor, known] = reduced.last().copied().unwrap_or_default();
        let pivot = own - before * factor;
        reduced.push([after / pivot, (side - before * known) / pivot]);
    }
    let mut solution = vec![0.0; rows.len()];
    let mut after = 0.0;
    for (to, [factor, known]) in solution.iter_mut().zip(reduced).rev() {
        after = known - factor * after;
        *to = after;
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Jet,
        equations::bends::{ArgumentPath, BentArgument, step_over},
    };

    fn table(axes: &[&[f64]], values: &[f64], how: (Interpolation, Extrapolation)) -> LookupTable {
        LookupTable::new(axes.iter().map(|axis| axis.to_vec()).collect(), values.to_vec(), how.0, how.1).unwrap()
    }

    const X: [f64; 5] = [-1.0, 0.0, 0.5, 2.0, 3.0];
    const Y: [f64; 4] = [0.0, 1.0, 1.5, 4.0];

    #[test]
    fn cubics_are_exact_with_both_ends_free() {
        let cubic = |x: f64| 1.0 - x + 0.5 * x * x + 0.25 * x * x * x;
        let slope = |x: f64| -1.0 + x + 0.75 * x * x;
        let found = table(&[&X], &X.map(cubic), (Interpolation::Cubic, Extrapolation::Linear));
        for x in [-1.0, -0.7, 0.0, 0.4, 0.5, 1.7, 2.9, 3.0] {
            let jet = found.at(&[Jet { value: x, first: 2.0, second: 0.0 }]);
            let expected = [cubic(x), 2.0 * slope(x), 4.0 * (1.0 + 1.5 * x)];
            for (found, expected) in [jet.value, jet.first, jet.second].into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{x}: {jet:?} {expected}");
            }
        }
        for (x, end) in [(-1.5, -1.0), (4.0, 3.0)] {
            let jet = found.at(&[Jet { value: x, first: 1.0, second: 0.0 }]);
            let expected = cubic(end) + slope(end) * (x - end);
            assert!((jet.value - expected).abs() < 1e-12 && (jet.first - slope(end)).abs() < 1e-12, "{jet:?}");
            assert!(jet.second.abs() < 1e-12, "{jet:?}");
        }
        let surface = |x: f64, y: f64| cubic(x) * cubic(0.5 * y);
        let values: Vec<f64> = X.iter().flat_map(|x| Y.map(|y| surface(*x, y))).collect();
        let found = table(&[&X, &Y], &values, (Interpolation::Cubic, Extrapolation::Hold));
        for (x, y) in [(0.3, 0.2), (-0.9, 3.9), (2.9, 1.2), (-1.0, 4.0)] {
            let jet =
                found.at(&[Jet { value: x, first: 1.0, second: 0.0 }, Jet { value: y, first: -2.0, second: 0.5 }]);
            let along = |h: f64| surface(x + h, y - 2.0 * h + 0.25 * h * h);
            assert!((jet.value - surface(x, y)).abs() < 1e-12, "{jet:?}");
            assert!((jet.first - (along(1e-5) - along(-1e-5)) / 2e-5).abs() < 1e-7, "{jet:?}");
            assert!((jet.second - (along(1e-4) - 2.0 * along(0.0) + along(-1e-4)) / 1e-8).abs() < 1e-5, "{jet:?}");
        }
        assert_eq!(found.at(&[-7.0, 9.0]), values[3]);
        assert_eq!(found.at(&[Jet { value: 9.0, first: 1.0, second: 1.0 }, Jet::from(4.0)]).first, 0.0);
    }

    #[test]
    fn few_knots_make_a_line_or_a_parabola() {
        let line = table(&[&[1.0, 3.0]], &[2.0, 8.0], (Interpolation::Cubic, Extrapolation::Linear));
        let parabola = table(&[&[0.0, 1.0, 3.0]], &[1.0, 2.0, 10.0], (Interpolation::Cubic, Extrapolation::Linear));
        for x in [1.0, 1.5, 3.0, 5.0] {
            assert!((line.at(&[x]) - (3.0 * x - 1.0)).abs() < 1e-14);
            assert!((parabola.at(&[x / 2.0]) - (1.0 + x * x / 4.0)).abs() < 1e-14);
        }
    }

    #[test]
    fn linear_tables_are_polygons() {
        let found = table(&[&X], &[1.0, 3.0, 2.0, 2.0, 0.0], (Interpolation::Linear, Extrapolation::Linear));
        for (x, expected) in [(-2.0, -1.0), (-0.5, 2.0), (0.0, 3.0), (0.25, 2.5), (1.0, 2.0), (3.0, 0.0), (3.5, -1.0)] {
            assert_eq!(found.at(&[x]), expected, "{x}");
        }
        // towards larger arguments
        assert_eq!(found.at(&[Jet { value: 0.0, first: 1.0, second: 0.0 }]).first, -2.0);
        let held = table(&[&X, &[0.0, 2.0]], &[0.0; 10], (Interpolation::Linear, Extrapolation::Hold));
        assert_eq!(held.at(&[9.0, f64::INFINITY]), 0.0);
        let plane: Vec<f64> = X.iter().flat_map(|x| Y.map(|y| 2.0 * x - y + 1.0)).collect();
        let plane = table(&[&X, &Y], &plane, (Interpolation::Linear, Extrapolation::Linear));
        for (x, y) in [(0.3, 0.7), (-4.0, 0.5), (2.5, 9.0), (5.0, -3.0)] {
            assert!((plane.at(&[x, y]) - (2.0 * x - y + 1.0)).abs() < 1e-13, "{x} {y}");
        }
        let flat = table(&[&[0.0, 1.0, 1.01]], &[1.0, 5.3, 5.3], (Interpolation::Linear, Extrapolation::Linear));
        assert_eq!(flat.at(&[1e13]), 5.3);
    }

    #[test]
    fn periodic_splines_repeat_and_are_smooth_at_the_ends() {
        let knots: Vec<f64> = (0..=12).map(|k| 0.5 + f64::from(k)).collect();
        let turn = std::f64::consts::TAU / 12.0;
        let mut values: Vec<f64> = knots.iter().map(|x| (turn * x).sin()).collect();
        values[12] = values[0];
        for (count, bound) in [(12, 1e-3), (2, f64::INFINITY), (1, f64::INFINITY)] {
            let every: Vec<usize> = (0..=count).map(|k| k * 12 / count).collect();
            let (x, y): (Vec<f64>, Vec<f64>) = every.iter().map(|k| (knots[*k], values[*k])).unzip();
            let found = table(&[&x], &y, (Interpolation::Cubic, Extrapolation::Periodic));
            let jet = |x: f64| found.at(&[Jet { value: x, first: 1.0, second: 0.0 }]);
            for x in [-30.2, -0.1, 0.5, 3.3, 12.4, 100.7] {
                assert!((jet(x).value - (turn * x).sin()).abs() < bound, "{count} {x}");
                assert!((jet(x).value - jet(x + 12.0).value).abs() < 1e-12, "{count} {x}");
            }
            let [before, after] = [12.5 - 1e-9, 12.5 + 1e-9].map(jet);
            assert!((before.first - after.first).abs() < 1e-7, "{count}: {before:?} {after:?}");
            assert!((before.second - after.second).abs() < 1e-7, "{count}: {before:?} {after:?}");
        }
    }

    #[test]
    fn derivatives_of_splines_are_those_of_their_series() {
        let ways = [
            (&X[..], [1.0, -2.0, 0.5, 3.0, 1.0], Extrapolation::Periodic),
            (&X, [1.0, 2.0, 0.0, 1.0, 4.0], Extrapolation::Linear),
        ];
        for (knots, values, extrapolation) in ways {
            let spline = table(&[knots], &values, (Interpolation::Cubic, extrapolation));
            let [first, second] = spline.derivatives().unwrap();
            let ends = if extrapolation == Extrapolation::Periodic { [-7.3, 9.1] } else { [-1.0, 3.0] };
            for k in 0..200 {
                let x = ends[0] + (f64::from(k) + 0.5) / 200.0 * (ends[1] - ends[0]);
                let at = |table: &LookupTable| table.series(&[Jet { value: x, first: 1.0, second: 0.0 }]);
                let expected = at(&spline);
                assert!((at(&first).value - expected.first).abs() < 1e-12, "{x}");
                assert!((at(&first).first - expected.second).abs() < 1e-12, "{x}");
                assert!((at(&second).value - expected.second).abs() < 1e-12, "{x}: {expected:?}");
            }
            assert!(first.bends(0).is_empty() && second.bends(0).is_empty());
        }
        assert!(table(&[&X], &[0.0; 5], (Interpolation::Linear, Extrapolation::Hold)).derivatives().is_err());
    }

    /// Share of a step in which the argument of a table moves.
    fn share(table: &LookupTable, from: f64, to: f64) -> f64 {
        let argument = BentArgument { bends: Arc::clone(table.bends(0)), group: 0 };
        let mut path = ArgumentPath::at(from);
        path.add(to);
        step_over(&[argument], &[path]).share
    }

    #[test]
    fn bends_are_where_a_step_would_miss_something() {
        let spike = table(
            &[&[0.0, 0.5, 0.51, 0.52, 1.0, 2.0]],
            &[0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            (Interpolation::Linear, Extrapolation::Hold),
        );
        let at: Vec<f64> = spike.bends(0).list().iter().map(|bend| bend.at).collect();
        assert_eq!(at, [0.5, 0.51, 0.52]);
        // not over it, from far away, over it, from close by, and in short steps
        for (from, to, expected) in
            [(0.0, 0.4, 1.0), (0.0, 2.0, 0.225), (2.0, 0.0, 0.666), (0.49, 0.59, 0.1), (0.5, 0.508, 1.0)]
        {
            let share = share(&spike, from, to);
            assert!((share - expected).abs() < 1e-12, "{from} {to}: {share}");
        }
        let smooth: Vec<f64> = (0..=1000).map(|k| f64::from(k) / 100.0).collect();
        let values: Vec<f64> = smooth.iter().map(|x| x.sin()).collect();
        let smooth = table(&[&smooth], &values, (Interpolation::Linear, Extrapolation::Linear));
        assert!(smooth.bends(0).is_empty());
        let cam =
            table(&[&[0.0, 0.1, 0.2, 6.0]], &[0.0, 1.0, 0.0, 0.0], (Interpolation::Cubic, Extrapolation::Periodic));
        assert!((share(&cam, 5.0, 7.0) - 0.45).abs() < 1e-12);
        assert_eq!(share(&cam, 13.0, 16.0), 1.0);
    }

    #[test]
    fn nan_stays_nan() {
        for how in Interpolation::ALL.into_iter().flat_map(|first| Extrapolation::ALL.map(|second| (first, second))) {
            let found = table(&[&[0.0, 1.0, 2.0]], &[1.0, 2.0, 1.0], how);
            assert!(found.at(&[f64::NAN]).is_nan(), "{how:?}");
        }
    }

    #[test]
    fn wrong_tables_are_refused() {
        let refused = |axes: &[&[f64]], values: &[f64], extrapolation| {
            let axes = axes.iter().map(|axis| axis.to_vec()).collect();
            LookupTable::new(axes, values.to_vec(), Interpolation::Cubic, extrapolation).unwrap_err().to_string()
        };
        assert!(refused(&[], &[], Extrapolation::Hold).contains("shape"));
        assert!(refused(&[&[1.0]], &[1.0], Extrapolation::Hold).contains("shape"));
        assert!(refused(&[&[1.0, 1.0]], &[1.0; 2], Extrapolation::Hold).contains("is not above"));
        assert!(refused(&[&[1.0, f64::NAN]], &[1.0; 2], Extrapolation::Hold).contains("not finite"));
        assert!(refused(&[&[1.0, 2.0]], &[1.0; 3], Extrapolation::Hold).contains("shape"));
        assert!(refused(&[&[1.0, 2.0]], &[1.0, 2.0], Extrapolation::Periodic).contains("ends"));
    }
}
