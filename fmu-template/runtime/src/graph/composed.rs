//! Graphs composed of graphs: derivatives of states, the next sample, networks at time points.

use super::{Elementwise, Graph, Operation, Step};
use crate::{
    Activation, ScaledNetwork,
    dictionary::{Dictionary, Factor},
};
use std::ops::Range;

/// Source of an output or of a state derivative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Given {
    /// A state.
    State(usize),
    /// One of the functions.
    Function(usize),
}

impl Graph {
    /// Outputs and state derivatives. The columns are parameters, inputs and `states` states. Each result is a state or a function of the
    /// dictionary plus the `added` graph. Each angle becomes two columns of that graph, its sine and cosine.
    pub fn of_rates(dictionary: &Dictionary, added: Option<Graph>, states: usize, results: &[Given]) -> Self {
        let inputs = dictionary.columns();
        let mut graph = Self { inputs, steps: Vec::new() };
        let angles: Vec<bool> = dictionary.factors().map(|factor| factor == Factor::Angle).collect();
        // the dictionary marks the angles
        let has_dictionary = dictionary.products() > 0 || added.is_none() || angles.contains(&true);
        let mut functions = 0;
        if has_dictionary {
            functions = graph.add(Step::Dictionary { of: 0, dictionary: dictionary.clone() });
        }
        if let Some(function) = added {
            let of = graph.with_angles(&angles);
            let called = graph.add(Step::Call { of, function });
            functions = match has_dictionary {
                true => graph.add(Step::Combine { of: [functions, called], operation: Operation::Add }),
                false => called,
            };
        }
        let column = |given: &Given| match *given {
            Given::State(state) => [0, (inputs - states + state) as u32],
            Given::Function(function) => [functions as u32, function as u32],
        };
        graph.add(Step::Columns { columns: results.iter().map(column).collect() });
        graph
    }

    /// The columns with sine and cosine of angles in their place.
    fn with_angles(&mut self, angles: &[bool]) -> usize {
        if !angles.contains(&true) {
            return 0;
        }
        let of = (0..).zip(angles).filter_map(|(column, is_angle)| is_angle.then_some([0, column])).collect();
        let picked = self.add(Step::Columns { columns: of });
        let mut each = |function| self.add(Step::Elementwise { of: picked, function, parameters: Vec::new() }) as u32;
        let [sine, cosine] = [Elementwise::Activation(Activation::Sine), Elementwise::Cosine].map(&mut each);
        let mut columns = Vec::new();
        let mut angle = 0;
        for (column, is_angle) in (0..).zip(angles) {
            if *is_angle {
                columns.extend([[sine, angle], [cosine, angle]]);
                angle += 1;
            } else {
                columns.push([0, column]);
            }
        }
        self.add(Step::Columns { columns })
    }

    /// The next sample, `constants + weights z + function(z)`; weights, shape `[constants, columns]`, are none if they are zero.
    pub fn of_samples(columns: usize, weights: Vec<f64>, constants: Vec<f64>, function: Option<Graph>) -> Self {
        let mut graph = Self { inputs: columns, steps: Vec::new() };
        let has_linear = !weights.is_empty() || constants.iter().any(|constant| *constant != 0.0) || function.is_none();
        if has_linear {
            let weight = if weights.is_empty() { vec![0.0; constants.len() * columns] } else { weights };
            graph.add(Step::Affine { of: 0, weight: weight.into(), bias: constants.into() });
        }
        if let Some(function) = function {
            let called = graph.add(Step::Call { of: 0, function });
            if has_linear {
                graph.add(Step::Combine { of: [1, called], operation: Operation::Add });
            }
        }
        graph
    }

    /// Interpolation between networks at time points. `time` is the column of the time; the networks have the other columns.
    pub fn of_instants(columns: usize, time: usize, instants: Vec<f64>, networks: &[ScaledNetwork]) -> Self {
        let functions = networks.iter().map(Self::from).collect();
        Self { inputs: columns, steps: vec![Step::Interpolate { of: 0, column: time, instants, functions }] }
    }

    /// The function that a step calls, if there is one.
    pub fn called(&self) -> Option<&Graph> {
        self.steps.iter().find_map(|step| if let Step::Call { function, .. } = step { Some(function) } else { None })
    }

    /// The dictionary, if a step is one.
    pub fn dictionary(&self) -> Option<&Dictionary> {
        self.steps.iter().find_map(|step| match step {
            Step::Dictionary { dictionary, .. } => Some(dictionary),
            _ => None,
        })
    }

    /// Time points and their networks, if the graph interpolates between networks.
    pub fn instants(&self) -> Option<(&[f64], &[Graph])> {
        match self.steps.as_slice() {
            [Step::Interpolate { instants, functions, .. }] => Some((instants, functions)),
            _ => None,
        }
    }

    /// Returns true for each number of each value that may depend on these columns.
    ///
    /// # Panics
    /// If the graph was not checked.
    pub fn dependent_on(&self, columns: &Range<usize>) -> Vec<Vec<bool>> {
        let widths = self.widths().expect("the graph was checked");
        let mut values = vec![(0..self.inputs).map(|column| columns.contains(&column)).collect::<Vec<bool>>()];
        for (step, width) in self.steps.iter().zip(&widths[1..]) {
            let any = |of: usize| values[of].contains(&true);
            values.push(match step {
                Step::Elementwise { of, .. } | Step::Standardize { of, .. } | Step::Rescale { of, .. } => {
                    values[*of].clone()
                }
                Step::Combine { of: [a, b], .. } => values[*a].iter().zip(&values[*b]).map(|(a, b)| *a || *b).collect(),
                Step::Columns { columns } => {
                    columns.iter().map(|[of, column]| values[*of as usize][*column as usize]).collect()
                }
                Step::Dictionary { of, dictionary } => {
                    let mut depends = vec![false; *width];
                    for term in dictionary.terms() {
                        let mut factors = term.exponents.iter().zip(&values[*of]);
                        if factors.any(|(exponent, depends)| *exponent != 0 && *depends) {
                            let functions = depends.iter_mut().zip(&term.coefficients);
                            functions.for_each(|(depends, coefficient)| *depends |= *coefficient != 0.0);
                        }
                    }
                    depends
                }
                other => vec![other.values().any(any); *width],
            });
        }
        values
    }
}
