//! Graphs composed of graphs: derivatives of states, the next sample, networks at time points.

use super::{Elementwise, Graph, Operation, Step};
use crate::{
    ScaledNetwork,
    dictionary::{Dictionary, Factor, Term},
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

/// Gain and ranges of an [observer](Graph::of_observer).
#[derive(Clone, Debug)]
pub struct StateObserver {
    /// `K`, shape `[states, outputs]`.
    pub gain: Vec<f64>,
    /// `F`, by which the first outputs act on the states, shape `[states, outputs]`.
    pub first: Vec<f64>,
    /// Range of each state, if states stop.
    pub stops: Option<Vec<[f64; 2]>>,
    /// Range of the sensor of each output, if sensors saturate.
    pub measured: Option<Vec<[f64; 2]>>,
}

/// Step that takes some of the numbers of a value.
fn picked(of: usize, places: Range<usize>) -> Step {
    Step::Columns { columns: places.map(|place| [of as u32, place as u32]).collect() }
}

impl Graph {
    /// Outputs and state derivatives. The columns are parameters, inputs and `states` states. Each result is a state or a function of the
    /// dictionary plus the `added` graph. Each angle becomes two columns of that graph, its sine and cosine.
    pub fn of_rates(dictionary: &Dictionary, added: Option<Graph>, states: usize, results: &[Given]) -> Self {
        let inputs = dictionary.columns();
        let mut graph = Self { inputs, steps: Vec::new() };
        let functions = match added {
            None => graph.add(Step::Dictionary { of: 0, dictionary: dictionary.clone() }),
            Some(function) => graph.add_functions(dictionary, function),
        };
        let columns = results.iter().map(|given| match *given {
            Given::State(state) => [0, (inputs - states + state) as u32],
            Given::Function(function) => [functions as u32, function as u32],
        });
        graph.add(Step::Columns { columns: columns.collect() });
        graph
    }

    /// The functions of a dictionary and those of another graph.
    fn add_functions(&mut self, dictionary: &Dictionary, added: Graph) -> usize {
        let functions = if dictionary.products() > 0 { dictionary.outputs() } else { 0 };
        let angles = dictionary.factors().filter(|factor| *factor == Factor::Angle).count();
        if angles > 0 || functions > 0 {
            self.add(Step::Dictionary { of: 0, dictionary: with_angles(dictionary, functions) });
        }
        let of = if angles > 0 { self.add(encoded(dictionary, functions as u32)) } else { 0 };
        let called = self.add(Step::Call { of, function: added });
        if functions == 0 {
            return called;
        }
        let first = match angles {
            0 => 1,
            _ => self.add(Step::Columns { columns: (0..functions as u32).map(|function| [1, function]).collect() }),
        };
        self.add(Step::Combine { of: [first, called], operation: Operation::Add })
    }

    /// The next sample, `constants + weights z + function(z)`; weights, shape `[constants, columns]`, are none if they are zero.
    pub fn of_samples(columns: usize, weights: Vec<f64>, constants: Vec<f64>, function: Option<Graph>) -> Self {
        let mut graph = Self { inputs: columns, steps: Vec::new() };
        graph.add_sample(0, columns, (weights, constants), function);
        graph
    }

    /// The next sample, as in [`of_samples`](Self::of_samples), from the columns that a value has.
    fn add_sample(
        &mut self,
        of: usize,
        columns: usize,
        (weights, constants): (Vec<f64>, Vec<f64>),
        function: Option<Graph>,
    ) -> usize {
        let has_linear = !weights.is_empty() || constants.iter().any(|constant| *constant != 0.0) || function.is_none();
        let linear = has_linear.then(|| {
            let weight = if weights.is_empty() { vec![0.0; constants.len() * columns] } else { weights };
            self.add(Step::Affine { of, weight: weight.into(), bias: constants.into() })
        });
        let called = function.map(|function| self.add(Step::Call { of, function }));
        match (linear, called) {
            (Some(linear), Some(called)) => self.add(Step::Combine { of: [linear, called], operation: Operation::Add }),
            (linear, called) => linear.or(called).unwrap_or(of),
        }
    }

    /// Applies the function to some of `inputs` columns.
    #[must_use]
    pub fn of_columns(mut self, inputs: usize, columns: impl IntoIterator<Item = usize>) -> Self {
        self.steps.iter_mut().for_each(|step| step.rename(|of| of + 1));
        self.steps.insert(0, Step::Columns { columns: columns.into_iter().map(|column| [0, column as u32]).collect() });
        Self { inputs, ..self }
    }

    /// Clips each output to a range, if there are ranges.
    #[must_use]
    pub fn limited(mut self, ranges: Option<Vec<[f64; 2]>>) -> Self {
        self.add_clip(self.steps.len(), ranges.as_deref());
        self
    }

    /// Next sample of a model whose states are corrected by measured outputs, which differ from its predictions. The
    /// columns are the outputs, the states of the model (its outputs first), `s`, and the other columns `u` of the
    /// model. `s` is 0 before the first prediction and 1 afterwards. Weights, constants and function are those of
    /// [`of_samples`](Self::of_samples).
    ///
    /// ```text
    /// z = x + s K (y - c(x_y)) + (1 - s) F y
    /// x[k+1] = model(z, u),    y[k+1] = c(x_y[k+1]),    s[k+1] = 1
    /// ```
    ///
    /// where `c` clips to the measured ranges. Predicted outputs correct nothing.
    pub fn of_observer(
        [states, outputs, columns]: [usize; 3],
        StateObserver { gain, first: at_start, stops, measured }: StateObserver,
        linear: (Vec<f64>, Vec<f64>),
        function: Option<Graph>,
    ) -> Self {
        let mut graph = Self { inputs: columns + outputs + 1, steps: Vec::new() };
        let begun = outputs + states;
        let other = begun + 1..columns + outputs + 1;
        let given = graph.add(picked(0, 0..outputs));
        let own = (outputs..begun).chain(other).map(|place| [0, place as u32]).collect();
        let own = graph.add(Step::Columns { columns: own });
        let predicted = graph.add(picked(0, outputs..2 * outputs));
        let predicted = graph.add_clip(predicted, measured.as_deref());
        let begun = graph.add(Step::Columns { columns: vec![[0, begun as u32]; outputs] });
        let errors = graph.add(Step::Combine { of: [given, predicted], operation: Operation::Subtract });
        let errors = graph.add(Step::Combine { of: [begun, errors], operation: Operation::Multiply });
        let first =
            graph.add(Step::Elementwise { of: begun, function: Elementwise::Linear, parameters: vec![-1.0, 1.0] });
        let first = graph.add(Step::Combine { of: [first, given], operation: Operation::Multiply });
        let both = [errors, first].into_iter().flat_map(|of| (0..outputs).map(move |place| [of as u32, place as u32]));
        let both = graph.add(Step::Columns { columns: both.collect() });
        let weight = (0..columns * 2 * outputs).map(|place| {
            let (row, column) = (place / (2 * outputs), place % (2 * outputs));
            let (of, column) = match column.checked_sub(outputs) {
                None => (&gain, column),
                Some(output) => (&at_start, output),
            };
            // columns after the states are not corrected
            of.get(row * outputs + column).copied().unwrap_or(0.0)
        });
        let weight: Vec<f64> = weight.collect();
        let corrections = graph.add(Step::Affine { of: both, weight: weight.into(), bias: vec![0.0; columns].into() });
        let corrected = graph.add(Step::Combine { of: [own, corrections], operation: Operation::Add });
        let next = graph.add_sample(corrected, columns, linear, function);
        let next = graph.add_clip(next, stops.as_deref());
        let one = graph.add(Step::Affine { of: next, weight: vec![0.0; states].into(), bias: vec![1.0].into() });
        let shown = graph.add(picked(next, 0..outputs));
        let shown = graph.add_clip(shown, measured.as_deref());
        let results = [(shown, outputs), (next, states), (one, 1)];
        let places = results.into_iter().flat_map(|(of, count)| (0..count).map(move |place| [of as u32, place as u32]));
        graph.add(Step::Columns { columns: places.collect() });
        graph
    }

    /// A value with each number clipped to a range, which may be infinite, if there are ranges.
    fn add_clip(&mut self, of: usize, ranges: Option<&[[f64; 2]]>) -> usize {
        let Some(ranges) = ranges else { return of };
        let ends = [0, 1].into_iter().flat_map(|end| ranges.iter().map(move |range| range[end]));
        // parameters of a graph are finite
        let parameters = ends.map(|end| end.clamp(f64::MIN, f64::MAX)).collect();
        self.add(Step::Elementwise { of, function: Elementwise::Clip, parameters })
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

    /// Number of products in results, other than sines and cosines that are columns of the [called](Self::called) function.
    pub fn products(&self) -> usize {
        let Some(dictionary) = self.dictionary() else { return 0 };
        let angles = dictionary.factors().filter(|factor| *factor == Factor::Angle).count();
        dictionary.products().saturating_sub(if self.called().is_some() { 2 * angles } else { 0 })
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
                other => vec![other.values().any(|of| values[of].contains(&true)); *width],
            });
        }
        values
    }
}

/// The first functions of a dictionary, then sine and cosine of each angle.
fn with_angles(dictionary: &Dictionary, functions: usize) -> Dictionary {
    let factors: Vec<Factor> = dictionary.factors().collect();
    let angles: Vec<usize> = (0..factors.len()).filter(|column| factors[*column] == Factor::Angle).collect();
    let outputs = functions + 2 * angles.len();
    let mut terms: Vec<Term> = dictionary.terms().collect();
    terms.iter_mut().for_each(|term| term.coefficients.resize(outputs, 0.0));
    for (index, angle) in angles.into_iter().enumerate() {
        for (exponent, output) in [(-1, functions + 2 * index), (1, functions + 2 * index + 1)] {
            let mut term = Term { exponents: vec![0; factors.len()], coefficients: vec![0.0; outputs] };
            (term.exponents[angle], term.coefficients[output]) = (exponent, 1.0);
            terms.push(term);
        }
    }
    Dictionary::new(&factors, outputs, &terms).expect("columns and functions are those of the dictionary")
}

/// The columns with sine and cosine in the place of each angle. These begin at column `first` of the dictionary's value.
fn encoded(dictionary: &Dictionary, first: u32) -> Step {
    let mut columns = Vec::new();
    let mut next = first;
    for (column, factor) in (0..).zip(dictionary.factors()) {
        if factor == Factor::Angle {
            columns.extend([[1, next], [1, next + 1]]);
            next += 2;
        } else {
            columns.push([0, column]);
        }
    }
    Step::Columns { columns }
}
