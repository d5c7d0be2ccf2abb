//! Writes equations of motion on a tape.

use super::{Dynamics, Written, entry};
use crate::equations::{
    dictionary::WrittenDictionary,
    formula::Formula,
    function_set::WrittenNetwork,
    switches,
    tape::{Register, TapeBuilder},
};
use std::sync::Arc;

/// The equations of motion, of which parts are written one after the other.
pub(super) struct EquationWriter<'a> {
    dynamics: &'a Dynamics,
    tape: TapeBuilder,
    /// Registers of `(q, p, v, u)`.
    columns: Vec<Register>,
    function_set: WrittenDictionary<'a>,
    network: Option<WrittenNetwork>,
    forces: Option<WrittenNetwork>,
}

/// Positions in efforts, and their rates.
struct EffortPositions {
    values: Vec<Register>,
    rates: Vec<Register>,
}

impl<'a> EquationWriter<'a> {
    pub(super) fn new(dynamics: &'a Dynamics) -> Self {
        let (n, p) = (dynamics.coordinates, dynamics.parameters());
        let columns: Vec<Register> = (0..dynamics.force_columns()).map(Register::input).collect();
        let mut tape = TapeBuilder::new(columns.len(), n..n + p);
        let configuration = &columns[..n + p];
        let function_set = dynamics.function_set.dictionary().write(configuration, &mut tape);
        let network = dynamics.function_set.network();
        let network = network.map(|network| network.write(configuration, n, dynamics.differentiated(), &mut tape));
        let forces = dynamics.forces.as_ref().map(|network| network.write(&columns, 0, 0, &mut tape));
        Self { dynamics, tape, columns, function_set, network, forces }
    }

    pub(super) fn write(mut self) -> Written {
        let n = self.dynamics.coordinates;
        let energies = self.energies();
        let slopes: Vec<Register> = (0..self.potential() * n).map(|index| self.slope(index / n, index % n)).collect();
        let positions = self.positions();
        let efforts = self.efforts(&positions);
        let mut sides = Vec::with_capacity(n);
        for coordinate in 0..n {
            let mut side = self.forces(coordinate, &efforts);
            // inertia and potential do not act on what is prescribed
            if !self.dynamics.prescribed[coordinate] {
                side = self.add_potential(side, coordinate);
                side = self.add_inertia(side, coordinate, &slopes);
            }
            sides.push(side);
        }
        let accelerations = self.accelerations(sides, &energies);
        let tape = self.tape.finish_for(&[efforts.as_slice(), &accelerations].concat());
        Written { energies, efforts, accelerations, tape }
    }

    fn q(&self, coordinate: usize) -> Register {
        self.columns[coordinate]
    }

    fn v(&self, coordinate: usize) -> Register {
        self.columns[self.dynamics.coordinates + self.dynamics.parameters() + coordinate]
    }

    /// Number of the function `V`.
    fn potential(&self) -> usize {
        self.dynamics.coordinates * (self.dynamics.coordinates + 1) / 2
    }

    fn function(&mut self, index: usize) -> Register {
        let value = self.function_set.value(index, &mut self.tape);
        added(self.network.as_ref(), value, index, None, &mut self.tape)
    }

    /// Derivative of a function with respect to a coordinate.
    fn slope(&mut self, index: usize, coordinate: usize) -> Register {
        let value = self.function_set.slope(index, coordinate, &mut self.tape);
        added(self.network.as_ref(), value, index, Some(coordinate), &mut self.tape)
    }

    /// The lower triangle of `M`, and `V` with the potentials of uniform forces.
    fn energies(&mut self) -> Vec<Register> {
        let potential = self.potential();
        let mut energies: Vec<Register> = (0..=potential).map(|index| self.function(index)).collect();
        for k in (0..self.dynamics.coordinates).filter(|k| self.dynamics.is_uniform(*k)) {
            let uniform = self.function(self.dynamics.differentiated() + k);
            energies[potential] = self.tape.subtract_product(energies[potential], uniform, self.columns[k]);
        }
        energies
    }

    fn positions(&mut self) -> EffortPositions {
        let (mut values, mut rates) = (Vec::new(), Vec::new());
        for (index, windings) in self.dynamics.efforts.windings().chunks(self.dynamics.coordinates).enumerate() {
            let function = self.potential() + 1 + index;
            let (mut value, mut rate) = (self.function(function), self.tape.zero);
            for (k, winding) in windings.iter().enumerate() {
                let (q, v, one) = (self.q(k), self.v(k), self.tape.one);
                value = self.tape.add_scaled(value, q, *winding);
                let slope = self.slope(function, k);
                let winding = self.tape.constant(*winding);
                let slope = self.tape.add_product(winding, slope, one);
                rate = self.tape.add_product(rate, slope, v);
            }
            values.push(value);
            rates.push(rate);
        }
        EffortPositions { values, rates }
    }

    fn efforts(&mut self, positions: &EffortPositions) -> Vec<Register> {
        let (n, p) = (self.dynamics.coordinates, self.dynamics.parameters());
        let (parameters, inputs) = (&self.columns[n..n + p], &self.columns[2 * n + p..]);
        let of_formulas = [parameters, inputs, &positions.values, &positions.rates].concat();
        let formulas = self.dynamics.efforts.formulas().iter();
        formulas.map(|formula| self.effort(formula, &of_formulas)).collect()
    }

    /// An effort, and the arguments at which its formula bends.
    fn effort(&mut self, formula: &Formula, columns: &[Register]) -> Register {
        let effort = formula.write(columns, &mut self.tape);
        let group = self.tape.new_group();
        for argument in switches::bent_arguments(formula, &|column| self.tape.varies(columns[column])) {
            let of = argument.formula.write(columns, &mut self.tape);
            self.tape.add_bends(of, &Arc::new(argument.bends), group);
        }
        effort
    }

    /// Forces, damping and efforts along a coordinate.
    fn forces(&mut self, coordinate: usize, efforts: &[Register]) -> Register {
        let (n, force) = (self.dynamics.coordinates, self.dynamics.differentiated());
        let (damping, effort_map) = (force + n, force + n + n * n);
        let has_force = !(self.dynamics.prescribed[coordinate] && self.dynamics.is_uniform(coordinate));
        let mut side = if has_force { self.function(force + coordinate) } else { self.tape.zero };
        side = added(self.forces.as_ref(), side, coordinate, None, &mut self.tape);
        for j in 0..n {
            let damping = self.function(damping + coordinate * n + j);
            let v = self.v(j);
            side = self.tape.subtract_product(side, damping, v);
        }
        for (j, effort) in efforts.iter().enumerate() {
            let factor = self.function(effort_map + coordinate * efforts.len() + j);
            side = self.tape.add_product(side, factor, *effort);
        }
        side
    }

    fn add_potential(&mut self, side: Register, coordinate: usize) -> Register {
        let (potential, zero) = (self.potential(), self.tape.zero);
        let side = self.function_set.add_slope(side, potential, coordinate, -1.0, &mut self.tape);
        let of_network = added(self.network.as_ref(), zero, potential, Some(coordinate), &mut self.tape);
        self.tape.add_scaled(side, of_network, -1.0)
    }

    /// Subtracts `h`, from the derivatives of `M`.
    fn add_inertia(&mut self, mut side: Register, coordinate: usize, slopes: &[Register]) -> Register {
        let (n, zero) = (self.dynamics.coordinates, self.tape.zero);
        for (j, k) in (0..n).flat_map(|j| (0..=j).map(move |k| (j, k))) {
            let mut terms = of_velocities([coordinate, j, k], |a, b, c| slopes[entry(a, b) * n + c]);
            terms.retain(|(of, weight)| !self.tape.is_zero(*of) && *weight != 0.0);
            let (factor, weight) = match terms[..] {
                [] => continue,
                [term] => term,
                _ => (self.tape.weighted(&terms), 1.0),
            };
            let [v_j, v_k] = [j, k].map(|coordinate| self.v(coordinate));
            let weighted_v = self.tape.add_scaled(zero, v_j, -weight);
            let velocities = self.tape.product(weighted_v, v_k);
            side = self.tape.add_product(side, factor, velocities);
        }
        side
    }

    /// Solves for the accelerations that are not prescribed, from the right sides.
    fn accelerations(&mut self, mut sides: Vec<Register>, energies: &[Register]) -> Vec<Register> {
        let coordinates = 0..self.dynamics.coordinates;
        let (prescribed, free): (Vec<usize>, Vec<usize>) = coordinates.partition(|&i| self.dynamics.prescribed[i]);
        for &i in &free {
            for &j in &prescribed {
                sides[i] = self.tape.subtract_product(sides[i], energies[entry(i, j)], sides[j]);
            }
        }
        let mut solution: Vec<Register> = free.iter().map(|&i| sides[i]).collect();
        solve(&mut self.tape, free.len(), |i, j| energies[entry(free[i], free[j])], &mut solution);
        for (&i, acceleration) in free.iter().zip(solution) {
            sides[i] = acceleration;
        }
        sides
    }
}

/// A function plus the network's part of it, if there is a network.
fn added(
    network: Option<&WrittenNetwork>,
    function: Register,
    index: usize,
    coordinate: Option<usize>,
    tape: &mut TapeBuilder,
) -> Register {
    network.map_or(function, |network| network.added(function, index, coordinate, tape))
}

/// Slopes of `M` and their weights whose sum is the factor of `v_j v_k` in `h_i`, from the slope of `M_ab` along `c`. Each slope occurs once.
fn of_velocities([i, j, k]: [usize; 3], slope: impl Fn(usize, usize, usize) -> Register) -> Vec<(Register, f64)> {
    let mut terms: Vec<(Register, f64)> = Vec::with_capacity(4);
    // both orders of a pair
    for (j, k) in [(j, k), (k, j)].into_iter().take(if j == k { 1 } else { 2 }) {
        for (of, weight) in [(slope(i, j, k), 1.0), (slope(j, k, i), -0.5)] {
            match terms.iter_mut().find(|(known, _)| *known == of) {
                Some((_, sum)) => *sum += weight,
                None => terms.push((of, weight)),
            }
        }
    }
    terms
}

/// Writes `x` in place of `b` with `M x = b`, by the factors `M = L D L^T`; NaN where a pivot is not positive.
fn solve(tape: &mut TapeBuilder, n: usize, mass: impl Fn(usize, usize) -> Register, x: &mut [Register]) {
    let zero = tape.zero;
    // -L below the diagonal, L D above, 1 / D on it
    let mut factors = vec![zero; n * n];
    for i in 0..n {
        for j in 0..=i {
            let mut value = mass(i, j);
            for k in 0..j {
                value = tape.add_product(value, factors[i * n + k], factors[k * n + j]);
            }
            if j < i {
                factors[j * n + i] = value;
                let minus = tape.negative(factors[j * n + j]);
                factors[i * n + j] = tape.product(value, minus);
            } else {
                factors[i * n + i] = tape.reciprocal(value);
            }
        }
    }
    for i in 0..n {
        for j in 0..i {
            x[i] = tape.add_product(x[i], factors[i * n + j], x[j]);
        }
    }
    for i in (0..n).rev() {
        x[i] = tape.product(x[i], factors[i * n + i]);
        for j in i + 1..n {
            x[i] = tape.add_product(x[i], factors[j * n + i], x[j]);
        }
    }
}
