//! Functions of some columns: a [dictionary](Dictionary), and a network that adds to some of them.
//!
//! They are computed in plain numbers and in jets, with their derivatives with respect to the first columns, so that
//! derivatives of those derivatives are exact as well.

mod network;

use super::{
    dictionary::Dictionary,
    tape::{Register, Tape, TapeBuilder, TapeWork, listing::Listing},
};
use crate::{FormatError, ScaledNetwork, check::expect_below, numbers::jet::Number};
pub(crate) use network::WrittenNetwork;
use std::ops::Range;

/// Functions of some columns.
#[derive(Clone, Debug, PartialEq)]
pub struct FunctionSet {
    dictionary: Dictionary,
    network: Option<NetworkTerm>,
}

/// A network of some columns that adds to some functions, computed in double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkTerm {
    columns: Vec<NetworkColumn>,
    outputs: Vec<usize>,
    network: ScaledNetwork,
}

/// A column of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkColumn {
    /// Position of the column it is a function of.
    pub of: usize,
    /// Function of that column.
    pub kind: ColumnKind,
}

/// Function that makes a column of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    /// The value.
    Plain,
    /// Its sine.
    Sine,
    /// Its cosine.
    Cosine,
}

/// A [`FunctionSet`] as it is computed: with derivatives with respect to the first columns, if they are wanted.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PreparedFunctions {
    tape: Tape,
    values: Vec<Register>,
    /// Shape `[functions, first]`.
    slopes: Vec<Register>,
}

impl FunctionSet {
    /// The functions of a dictionary, to which a network may add.
    ///
    /// # Errors
    /// [`FormatError`] if the network has columns or functions that the dictionary does not have, or the dictionary has
    /// second derivatives of splines: it is differentiated.
    pub fn new(dictionary: Dictionary, network: Option<NetworkTerm>) -> Result<Self, FormatError> {
        dictionary.expect_differentiable()?;
        if let Some(network) = &network {
            network.check_limits(dictionary.columns(), dictionary.outputs())?;
        }
        Ok(Self { dictionary, network })
    }

    /// The dictionary.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Network that adds to the dictionary.
    pub fn network(&self) -> Option<&NetworkTerm> {
        self.network.as_ref()
    }

    /// Returns true if any function depends on a column.
    pub fn depends_on(&self, column: usize) -> bool {
        self.dictionary.depends_on(column) || self.network.as_ref().is_some_and(|network| network.depends_on(column))
    }

    /// Returns true if a function depends on a column.
    pub fn function_depends_on(&self, function: usize, column: usize) -> bool {
        self.dictionary.output_depends_on(function, column) || self.network_depends_on(function, column)
    }

    /// Returns true if a function is a straight line along a column, or does not depend on it: then it is known beyond the column's range.
    pub fn function_is_straight(&self, function: usize, column: usize) -> bool {
        self.dictionary.output_is_straight(function, column) && !self.network_depends_on(function, column)
    }

    /// Returns true if the network's part of a function depends on a column.
    fn network_depends_on(&self, function: usize, column: usize) -> bool {
        let network = self.network.as_ref();
        network.is_some_and(|network| network.outputs.contains(&function) && network.depends_on(column))
    }

    /// Returns true if a function is zero everywhere.
    pub fn is_zero(&self, function: usize) -> bool {
        self.dictionary.is_zero(function)
            && self.network.as_ref().is_none_or(|network| !network.outputs.contains(&function))
    }

    /// The functions `y` at `x`.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn evaluate(&self, x: &[f64], y: &mut [f64]) {
        let prepared = self.prepared(0, 0..0);
        prepared.compute(x, y, &mut [], &mut prepared.work());
    }

    /// Functions prepared for evaluation, with derivatives with respect to the first `first` columns. The part that depends on fixed
    /// columns alone runs only when they change.
    pub(crate) fn prepared(&self, first: usize, fixed: Range<usize>) -> PreparedFunctions {
        self.with_windings(first, fixed, &[])
    }

    /// Functions `f(x) + w^T x` on a tape, with the first columns `x`. `windings` are the `w` of all functions, or empty.
    pub(crate) fn with_windings(&self, first: usize, fixed: Range<usize>, windings: &[f64]) -> PreparedFunctions {
        let Self { dictionary, network } = self;
        let mut tape = TapeBuilder::new(dictionary.columns(), fixed.clone());
        let columns: Vec<Register> = (0..dictionary.columns()).map(Register::input).collect();
        let written = dictionary.write(&columns, &mut tape);
        let network = network.as_ref().map(|network| network.write(&columns, first, usize::MAX, &mut tape));
        let mut function = |function: usize, column: Option<usize>| {
            let value = match column {
                Some(column) => written.slope(function, column, &mut tape),
                None => written.value(function, &mut tape),
            };
            network.as_ref().map_or(value, |network| network.added(value, function, column, &mut tape))
        };
        let mut values: Vec<Register> = (0..dictionary.outputs()).map(|index| function(index, None)).collect();
        let slopes = (0..dictionary.outputs() * first).map(|index| function(index / first, Some(index % first)));
        let slopes = slopes.collect();
        let width = windings.len() / dictionary.outputs().max(1);
        for (value, windings) in values.iter_mut().zip(windings.chunks(width.max(1))) {
            for (column, winding) in columns.iter().zip(windings) {
                *value = tape.add_scaled(*value, *column, *winding);
            }
        }
        PreparedFunctions { tape: tape.finish(), values, slopes }
    }

    /// The functions as data, evaluated with these columns fixed.
    pub fn listing(&self, fixed: Range<usize>) -> Listing {
        self.prepared(0, fixed).listing()
    }
}

impl PreparedFunctions {
    pub(crate) fn work<T: Number>(&self) -> TapeWork<T> {
        self.tape.work()
    }

    pub(crate) fn listing(&self) -> Listing {
        self.tape.listing(self.values.iter().copied())
    }

    /// The functions `y` at `x`, and in `gradient`, shape `[functions, first]`, derivatives with respect to the first columns, of as many
    /// functions as it has. Does not allocate.
    ///
    /// # Panics
    /// If a slice has the wrong length, or the working memory is that of another function set.
    pub(crate) fn compute<T: Number>(&self, x: &[T], y: &mut [T], gradient: &mut [T], work: &mut TapeWork<T>) {
        work.inputs_mut()[..x.len()].copy_from_slice(x);
        self.tape.run(work);
        y.iter_mut().zip(&self.values).for_each(|(to, register)| *to = work.get(*register));
        gradient.iter_mut().zip(&self.slopes).for_each(|(to, register)| *to = work.get(*register));
    }
}

impl From<Dictionary> for FunctionSet {
    fn from(dictionary: Dictionary) -> Self {
        Self { dictionary, network: None }
    }
}

impl NetworkTerm {
    /// Lays a network out that has a column for each of `columns` and adds its outputs to the functions `outputs`.
    ///
    /// # Errors
    /// [`FormatError`] if the network has other columns or outputs, or a number is not finite.
    pub fn new(columns: Vec<NetworkColumn>, outputs: Vec<usize>, network: ScaledNetwork) -> Result<Self, FormatError> {
        network.check(columns.len(), outputs.len())?;
        Ok(Self { columns, outputs, network })
    }

    /// Makes sure that columns and functions are below these numbers.
    ///
    /// # Errors
    /// [`FormatError`].
    pub(crate) fn check_limits(&self, columns: usize, functions: usize) -> Result<(), FormatError> {
        for (index, column) in self.columns.iter().enumerate() {
            expect_below(&"network.columns", index, column.of, columns)?;
        }
        for (index, output) in self.outputs.iter().enumerate() {
            expect_below(&"network.outputs", index, *output, functions)?;
        }
        Ok(())
    }

    /// Columns of the network.
    pub fn columns(&self) -> &[NetworkColumn] {
        &self.columns
    }

    /// The functions that it adds to.
    pub fn outputs(&self) -> &[usize] {
        &self.outputs
    }

    /// The network.
    pub fn network(&self) -> &ScaledNetwork {
        &self.network
    }

    /// Returns true if the network has a function of this column.
    pub fn depends_on(&self, column: usize) -> bool {
        self.columns.iter().any(|own| own.of == column)
    }
}

impl NetworkColumn {
    /// Its value at `x`.
    ///
    /// # Panics
    /// If there is no such column.
    pub fn of(self, x: &[f64]) -> f64 {
        self.kind.of(x[self.of])[0]
    }

    /// Its derivative with respect to the column that it is made of, at `x`.
    ///
    /// # Panics
    /// As [`of`](Self::of).
    pub fn slope(self, x: &[f64]) -> f64 {
        self.kind.of(x[self.of])[1]
    }
}

impl ColumnKind {
    /// Value of the function at `x`, and its derivative.
    fn of(self, x: f64) -> [f64; 2] {
        match self {
            Self::Plain => [x, 1.0],
            Self::Sine => x.sin_cos().into(),
            Self::Cosine => [x.cos(), -x.sin()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Activation, Graph, Jet, Layer, Scaling,
        dictionary::{Factor, Term},
    };

    const SMOOTH: [Activation; 5] =
        [Activation::Tanh, Activation::Sigmoid, Activation::Gelu, Activation::Silu, Activation::Sine];

    /// A function set of an angle, a coordinate and a parameter. Its network has the angle and the parameter.
    fn function_set(activation: Activation) -> FunctionSet {
        let mut state = 0.3f64;
        let mut number = || {
            state = (state + 0.618_033_988_749_894_9).fract();
            2.0 * state - 1.0
        };
        let mut layer = |inputs: usize, outputs: usize, activation| {
            let weight: Vec<f64> = (0..inputs * outputs).map(|_| number()).collect();
            let bias: Vec<f64> = (0..outputs).map(|_| number()).collect();
            Layer { inputs, outputs, weight: weight.into(), bias: bias.into(), activation }
        };
        let layers = vec![layer(3, 11, activation), layer(11, 9, activation), layer(9, 2, Activation::Identity)];
        with_network(layers)
    }

    /// A function set of the same columns, with nodes of the angle, of the parameter, of both and of neither, for one function or
    /// both.
    fn nodes() -> FunctionSet {
        let columns = |node: usize| [[1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0; 3]][node % 4];
        let functions = |node: usize| [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]][node / 4 % 3];
        let number = |index: usize| (1.7 * index as f64).sin();
        let weight: Vec<f64> = (0..3 * 37).map(|index| columns(index / 3)[index % 3] * number(index)).collect();
        let last: Vec<f64> = (0..2 * 37).map(|index| functions(index % 37)[index / 37] * number(index + 200)).collect();
        let bias: Vec<f64> = (0..37).map(|index| number(index + 400)).collect();
        let (outputs, activation) = (37, Activation::Tanh);
        let hidden = Layer { inputs: 3, outputs, weight: weight.into(), bias: bias.into(), activation };
        let (inputs, outputs, activation) = (37, 2, Activation::Identity);
        with_network(vec![
            hidden,
            Layer { inputs, outputs, weight: last.into(), bias: vec![0.3, -0.2].into(), activation },
        ])
    }

    fn function_sets() -> impl Iterator<Item = FunctionSet> {
        SMOOTH.map(function_set).into_iter().chain([nodes()])
    }

    fn with_network(layers: Vec<Layer>) -> FunctionSet {
        let scaling = Scaling {
            input_mean: vec![0.1, -0.2, 1.0],
            input_scale: vec![0.7, 0.6, 2.0],
            output_mean: vec![0.4, -3.0],
            output_scale: vec![2.0, 0.5],
        };
        let column = |of, kind| NetworkColumn { of, kind };
        let columns = vec![column(0, ColumnKind::Sine), column(0, ColumnKind::Cosine), column(2, ColumnKind::Plain)];
        let network = NetworkTerm::new(columns, vec![2, 0], ScaledNetwork { scaling, layers }).unwrap();
        let power = Factor::Power { middle: 0.0, half: 2.0 };
        let term = |exponents: [i16; 3], coefficients: [f64; 3]| Term {
            exponents: exponents.to_vec(),
            coefficients: coefficients.to_vec(),
        };
        let terms = [term([-1, 1, 1], [0.3, 1.0, 0.0]), term([2, 0, 1], [0.0, -2.0, 0.7])];
        let dictionary = Dictionary::new(&[Factor::Angle, power, power], 3, &terms).unwrap();
        FunctionSet::new(dictionary, Some(network)).unwrap()
    }

    const POINT: [f64; 3] = [0.8, 1.3, -1.1];

    /// Computes a function set with derivatives with respect to the first columns, `first` in number.
    fn compute<T: Number>(function_set: &FunctionSet, first: usize, x: &[T], y: &mut [T], gradient: &mut [T]) {
        let prepared = function_set.prepared(first, 0..0);
        prepared.compute(x, y, gradient, &mut prepared.work());
    }

    fn values(function_set: &FunctionSet, point: [f64; 3]) -> [f64; 3] {
        let mut y = [0.0; 3];
        function_set.evaluate(&point, &mut y);
        y
    }

    #[test]
    fn values_are_those_of_the_dictionary_and_the_network() {
        for function_set in Activation::ALL.map(function_set).into_iter().chain([nodes()]) {
            let (found, mut expected) = (values(&function_set, POINT), [0.0; 3]);
            function_set.dictionary().evaluate(&POINT, &mut expected);
            let term = function_set.network().unwrap();
            let (sine, cosine) = POINT[0].sin_cos();
            let more = Graph::from(term.network()).evaluate(&[vec![sine, cosine, POINT[2]]]);
            for (output, more) in term.outputs().iter().zip(&more[0]) {
                expected[*output] += more;
            }
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-13, "{found} {expected}");
            }
        }
    }

    #[test]
    fn gradients_and_series_are_those_of_finite_differences() {
        for function_set in function_sets() {
            let (mut y, mut gradient) = ([0.0; 3], [0.0; 6]);
            compute(&function_set, 2, &POINT, &mut y, &mut gradient);
            let step = 1e-3;
            let derivative = |column: usize, of: &dyn Fn([f64; 3]) -> f64| {
                let moved = |by: f64| {
                    let mut point = POINT;
                    point[column] += by;
                    of(point)
                };
                (8.0 * (moved(step) - moved(-step)) - moved(2.0 * step) + moved(-2.0 * step)) / (12.0 * step)
            };
            for output in 0..3 {
                for column in 0..2 {
                    let expected = derivative(column, &|point| values(&function_set, point)[output]);
                    let found = gradient[2 * output + column];
                    assert!((found - expected).abs() < 1e-9, "{output} {column}: {found} {expected}");
                }
            }
            // along a curve: the series of the functions, and the rate of their gradient
            let (direction, bend) = ([0.3, -0.4, 1.2], [0.5, 0.1, -0.6]);
            let along: [Jet; 3] =
                std::array::from_fn(|i| Jet { value: POINT[i], first: direction[i], second: bend[i] });
            let (mut series, mut of_gradient) = ([Jet::default(); 3], [Jet::default(); 6]);
            compute(&function_set, 2, &along, &mut series, &mut of_gradient);
            let at =
                |h: f64| -> [f64; 3] { std::array::from_fn(|i| POINT[i] + h * direction[i] + 0.5 * h * h * bend[i]) };
            let gradient_at = |h: f64| {
                let (mut y, mut gradient) = ([0.0; 3], [0.0; 6]);
                compute(&function_set, 2, &at(h), &mut y, &mut gradient);
                gradient
            };
            let five = |of: &dyn Fn(f64) -> f64| {
                let [near, far] = [step, 2.0 * step].map(|h| [of(h), of(-h)]);
                let first = (8.0 * (near[0] - near[1]) - far[0] + far[1]) / (12.0 * step);
                let sum = 16.0 * (near[0] + near[1]) - far[0] - far[1] - 30.0 * of(0.0);
                [first, sum / (12.0 * step * step)]
            };
            for (output, found) in series.iter().enumerate() {
                let [first, second] = five(&|h| values(&function_set, at(h))[output]);
                assert!((found.first - first).abs() < 1e-9, "{} {first}", found.first);
                assert!((found.second - second).abs() < 1e-6, "{} {second}", found.second);
            }
            for (index, found) in of_gradient.iter().enumerate() {
                let [first, second] = five(&|h| gradient_at(h)[index]);
                assert!((found.first - first).abs() < 1e-9, "{} {first}", found.first);
                assert!((found.second - second).abs() < 1e-6, "{} {second}", found.second);
            }
        }
    }

    #[test]
    fn jets_of_jets_have_the_series_of_derivatives() {
        let function_set = function_set(Activation::Tanh);
        let (direction, other) = ([0.3, -0.4, 1.2], [0.7, 0.2, -0.5]);
        let nested: [Jet<Jet>; 3] = std::array::from_fn(|i| Jet {
            value: Jet { value: POINT[i], first: other[i], second: 0.0 },
            first: Jet::from(direction[i]),
            second: Jet::from(0.0),
        });
        let mut series = [Jet::<Jet>::from(0.0); 3];
        compute(&function_set, 0, &nested, &mut series, &mut []);
        let second_along = |h: f64| {
            let along: [Jet; 3] =
                std::array::from_fn(|i| Jet { value: POINT[i] + h * other[i], first: direction[i], second: 0.0 });
            let mut series = [Jet::default(); 3];
            compute(&function_set, 0, &along, &mut series, &mut []);
            series.map(|jet| jet.second)
        };
        let (after, before) = (second_along(1e-4), second_along(-1e-4));
        for output in 0..3 {
            let expected = (after[output] - before[output]) / 2e-4;
            let found = series[output].second.first;
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn what_follows_from_columns_that_change_rarely_is_computed_again_when_they_do() {
        let function_set = nodes();
        for fixed in 1..3 {
            let prepared = function_set.prepared(1, fixed..3);
            let mut work = prepared.work();
            for (index, value) in [1.3, 1.3, 0.2, f64::NAN, 0.2].into_iter().enumerate() {
                for column in fixed..3 {
                    let mut point = POINT;
                    (point[0], point[column]) = (0.1 * index as f64, value);
                    let (mut y, mut gradient) = ([0.0; 3], [0.0; 3]);
                    prepared.compute(&point, &mut y, &mut gradient, &mut work);
                    let (mut expected, mut of_gradient) = ([0.0; 3], [0.0; 3]);
                    compute(&function_set, 1, &point, &mut expected, &mut of_gradient);
                    for (found, expected) in y.iter().chain(&gradient).zip(expected.iter().chain(&of_gradient)) {
                        let is_same = (found - expected).abs() < 1e-14 || found.is_nan() && expected.is_nan();
                        assert!(is_same, "{fixed} {index} {column}: {found} {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_of_the_first_functions_alone_are_the_same() {
        for function_set in function_sets() {
            let (mut y, mut all, mut two) = ([0.0; 3], [0.0; 6], [0.0; 4]);
            compute(&function_set, 2, &POINT, &mut y, &mut all);
            compute(&function_set, 2, &POINT, &mut y, &mut two);
            assert_eq!(all[..4], two);
        }
    }

    #[test]
    fn networks_that_do_not_fit_are_refused() {
        let function_set = function_set(Activation::Tanh);
        let NetworkTerm { columns, outputs, network, .. } = function_set.network().unwrap().clone();
        let message = |columns: &[NetworkColumn], outputs: &[usize]| {
            let term = NetworkTerm::new(columns.to_vec(), outputs.to_vec(), network.clone());
            term.and_then(|term| FunctionSet::new(function_set.dictionary().clone(), Some(term)))
                .unwrap_err()
                .to_string()
        };
        assert!(message(&columns[..2], &outputs).contains("`input_mean` has shape [3], expected [2]"));
        assert!(message(&columns, &[0]).contains("`output_mean` has shape [2], expected [1]"));
        assert_eq!(message(&columns, &[0, 3]), "tensor `network.outputs`, element 1: 3, expected less than 3");
        let far = [NetworkColumn { of: 7, ..columns[0] }, columns[1], columns[2]];
        assert_eq!(message(&far, &outputs), "tensor `network.columns`, element 0: 7, expected less than 3");
    }
}
