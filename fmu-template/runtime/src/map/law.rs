//! Functions of some columns: a [dictionary](Dictionary), and a network that adds to some of them.
//!
//! They are computed in plain numbers and in jets, with their derivatives with respect to the first columns, so that
//! derivatives of those derivatives are exact as well.

mod nodes;

use super::{
    Activation, Layer, ScaledNetwork, Scaling,
    dictionary::Dictionary,
    jet::Number,
    tape::{Register, Tape, TapeBuilder, TapeWork},
};
#[cfg(target_arch = "x86_64")]
use crate::simd::{AVX2, AVX512};
use crate::{
    FormatError,
    simd::{PORTABLE, Simd},
};
use nodes::{Nodes, NodesWork};
use std::ops::Range;

/// Functions of some columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Law {
    dictionary: Dictionary,
    network: Option<NetworkTerm>,
}

/// A network of some columns that adds to some functions, computed in double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkTerm {
    columns: Vec<NetworkColumn>,
    outputs: Vec<usize>,
    network: ScaledNetwork,
    laid_out: LaidOut,
}

/// The layers as they are computed.
#[derive(Clone, Debug, PartialEq)]
enum LaidOut {
    Nodes(Nodes),
    Layers(Vec<Blocks>),
}

/// A column of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkColumn {
    /// Position of the column that it is made of.
    pub of: usize,
    /// What it is of that one.
    pub kind: ColumnKind,
}

/// What a column of the network is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    /// The value.
    Plain,
    /// Its sine.
    Sine,
    /// Its cosine.
    Cosine,
}

/// A [`Law`] as it is computed: with derivatives with respect to the first columns, if they are wanted.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PreparedLaw {
    tape: Tape,
    values: Vec<Register>,
    /// Shape `[functions, first]`.
    slopes: Vec<Register>,
    first: usize,
    held: Range<usize>,
    network: Option<NetworkTerm>,
}

/// Working memory of an evaluation of a [`PreparedLaw`].
#[derive(Clone, Debug)]
pub(crate) struct LawWork<T> {
    tape: TapeWork<T>,
    network: Option<TermWork<T>>,
}

/// Working memory of a [`NetworkTerm`].
#[derive(Clone, Debug)]
pub(crate) enum TermWork<T> {
    Nodes(NodesWork<T>),
    /// A layer and the one after it, each with the derivatives with respect to the first columns.
    Layers {
        current: Vec<T>,
        next: Vec<T>,
    },
}

/// Rows that are computed together.
const LANES: usize = 8;

/// A layer in blocks of rows: `weights[block * inputs + column][lane]`.
#[derive(Clone, Debug, PartialEq)]
struct Blocks {
    inputs: usize,
    weights: Vec<[f64; LANES]>,
    bias: Vec<[f64; LANES]>,
    activation: Activation,
}

impl Law {
    /// The functions of a dictionary, to which a network may add.
    ///
    /// # Errors
    /// [`FormatError`] if the network has columns or functions that the dictionary does not have.
    pub fn new(dictionary: Dictionary, network: Option<NetworkTerm>) -> Result<Self, FormatError> {
        if let Some(network) = &network {
            network.check_limits(dictionary.columns(), dictionary.outputs())?;
        }
        Ok(Self { dictionary, network })
    }

    /// The dictionary.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// What adds to it.
    pub fn network(&self) -> Option<&NetworkTerm> {
        self.network.as_ref()
    }

    /// Whether a function depends on a column.
    pub fn depends_on(&self, column: usize) -> bool {
        self.dictionary.terms().any(|term| term.exponents[column] != 0)
            || self.network.as_ref().is_some_and(|network| network.depends_on(column))
    }

    /// Whether a function is zero everywhere.
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

    /// Laid out for evaluation, with derivatives with respect to so many first columns. What follows from held columns alone, which are
    /// others, is kept as long as they have the same values.
    pub(crate) fn prepared(&self, first: usize, held: Range<usize>) -> PreparedLaw {
        let Self { dictionary, network } = self;
        let mut tape = TapeBuilder::new(dictionary.columns(), held.clone());
        let columns: Vec<Register> = (0..dictionary.columns()).map(Register::input).collect();
        let written = dictionary.write(&columns, &mut tape);
        let values = (0..dictionary.outputs()).map(|function| written.value(function, &mut tape)).collect();
        let slopes =
            (0..dictionary.outputs() * first).map(|index| written.slope(index / first, index % first, &mut tape));
        let slopes = slopes.collect();
        PreparedLaw { tape: tape.finish(), values, slopes, first, held, network: network.clone() }
    }
}

impl PreparedLaw {
    pub(crate) fn work<T: Number>(&self) -> LawWork<T> {
        let network = self.network.as_ref().map(|network| network.work(self.first, self.held.clone()));
        LawWork { tape: self.tape.work(), network }
    }

    /// The functions `y` at `x`, and in `gradient`, shape `[functions, first]`, derivatives with respect to the first columns, of as many
    /// functions as it has. Does not allocate.
    ///
    /// # Panics
    /// If a slice has the wrong length, or the working memory is that of another law.
    pub(crate) fn compute<T: Number>(&self, x: &[T], y: &mut [T], gradient: &mut [T], work: &mut LawWork<T>) {
        let LawWork { tape, network } = work;
        tape.inputs()[..x.len()].copy_from_slice(x);
        self.tape.run(tape);
        y.iter_mut().zip(&self.values).for_each(|(to, register)| *to = tape.get(*register));
        gradient.iter_mut().zip(&self.slopes).for_each(|(to, register)| *to = tape.get(*register));
        if let (Some(network), Some(work)) = (&self.network, network) {
            network.add(x, y, gradient, self.first, work);
        }
    }
}

impl From<Dictionary> for Law {
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
        let layers = || LaidOut::Layers(network.layers.iter().map(Blocks::new).collect());
        let laid_out = Nodes::new(&network.layers).map_or_else(layers, LaidOut::Nodes);
        Ok(Self { columns, outputs, network, laid_out })
    }

    /// Makes sure that columns and functions are below these numbers.
    ///
    /// # Errors
    /// [`FormatError`].
    pub(crate) fn check_limits(&self, columns: usize, functions: usize) -> Result<(), FormatError> {
        let below = |name: &str, mut found: std::iter::Enumerate<std::vec::IntoIter<usize>>, limit: usize| {
            let wrong = found.find(|(_, found)| *found >= limit);
            wrong.map_or(Ok(()), |(index, found)| {
                let (found, limit) = (found as u64, limit as u64);
                Err(FormatError::Index { name: name.into(), index, found, limit })
            })
        };
        let of: Vec<usize> = self.columns.iter().map(|column| column.of).collect();
        below("network.columns", of.into_iter().enumerate(), columns)?;
        below("network.outputs", self.outputs.clone().into_iter().enumerate(), functions)
    }

    /// What its columns are.
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

    /// Whether it has a column of this one.
    pub fn depends_on(&self, column: usize) -> bool {
        self.columns.iter().any(|own| own.of == column)
    }

    /// Working memory of an evaluation with derivatives with respect to so many first columns. Held columns, which are others, change rarely:
    /// what follows from them alone is kept.
    pub(crate) fn work<T: Number>(&self, first: usize, held: Range<usize>) -> TermWork<T> {
        match &self.laid_out {
            LaidOut::Nodes(nodes) => TermWork::Nodes(nodes.work(self.columns.len(), held)),
            LaidOut::Layers(layers) => {
                let zeros = vec![T::from(0.0); (1 + first) * width(layers, self.columns.len())];
                TermWork::Layers { current: zeros.clone(), next: zeros }
            }
        }
    }

    /// Adds to the functions `y` at `x`, and to the derivatives, with respect to the first columns, of as many functions as `gradient`,
    /// shape `[functions, first]`, has. Does not allocate.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub(crate) fn add<T: Number>(
        &self,
        x: &[T],
        y: &mut [T],
        gradient: &mut [T],
        first: usize,
        work: &mut TermWork<T>,
    ) {
        // jets of jets are for derivatives that a host asks for: they are compiled once, and FMUs stay small
        let simd = if T::DEPTH < 2 { Simd::detect() } else { Simd::Portable };
        match simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Simd::detect` found these features
            Simd::Avx512 => unsafe { self.run_avx512(x, y, gradient, first, work) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above
            Simd::Avx2 => unsafe { self.run_avx2(x, y, gradient, first, work) },
            Simd::Portable => self.run::<T, PORTABLE>(x, y, gradient, first, work),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
    fn run_avx512<T: Number>(&self, x: &[T], y: &mut [T], gradient: &mut [T], first: usize, work: &mut TermWork<T>) {
        self.run::<T, AVX512>(x, y, gradient, first, work);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2<T: Number>(&self, x: &[T], y: &mut [T], gradient: &mut [T], first: usize, work: &mut TermWork<T>) {
        self.run::<T, AVX2>(x, y, gradient, first, work);
    }

    #[inline(always)]
    fn run<T: Number, const SIMD: u8>(
        &self,
        x: &[T],
        y: &mut [T],
        gradient: &mut [T],
        first: usize,
        work: &mut TermWork<T>,
    ) {
        let Self { columns, outputs, network: ScaledNetwork { scaling, .. }, laid_out } = self;
        let (layers, current, next) = match (laid_out, work) {
            (LaidOut::Nodes(nodes), TermWork::Nodes(work)) => {
                return nodes.run::<T, SIMD>((columns, outputs, scaling), x, y, (gradient, first), work);
            }
            (LaidOut::Layers(layers), TermWork::Layers { current, next }) => (layers, current, next),
            _ => panic!("the working memory belongs to another network"),
        };
        let width = width(layers, columns.len());
        assert_eq!(current.len(), (1 + first) * width, "working memory of this network");
        let Scaling { input_mean, input_scale, output_mean, output_scale } = scaling;
        let zero = T::from(0.0);
        for (index, column) in columns.iter().enumerate() {
            let [value, slope] = column.kind.of(x[column.of]);
            let scale = input_scale[index].recip();
            current[index] = (value - T::from(input_mean[index])).scaled(scale);
            for k in 0..first {
                current[(1 + k) * width + index] = if column.of == k { slope.scaled(scale) } else { zero };
            }
        }
        for layer in layers {
            for order in 0..=first {
                let range = order * width..(order + 1) * width;
                layer.product::<T, SIMD>(&current[range.clone()], &mut next[range], order == 0);
            }
            if layer.activation != Activation::Identity {
                let (values, tangents) = next.split_at_mut(width);
                for (index, value) in values[..layer.bias.len() * LANES].iter_mut().enumerate() {
                    let [activated, slope] = with_slope::<T, SIMD>(layer.activation, *value);
                    *value = activated;
                    for tangent in tangents.chunks_exact_mut(width) {
                        tangent[index] = tangent[index] * slope;
                    }
                }
            }
            std::mem::swap(current, next);
        }
        for (index, &output) in outputs.iter().enumerate() {
            let scale = output_scale[index];
            y[output] = y[output] + current[index].scaled(scale) + T::from(output_mean[index]);
            for (k, to) in gradient.iter_mut().skip(output * first).take(first).enumerate() {
                *to = *to + current[(1 + k) * width + index].scaled(scale);
            }
        }
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
    /// What it is of a value, and its derivative.
    #[inline(always)]
    fn of<T: Number>(self, x: T) -> [T; 2] {
        self.chosen(self.parts(x))
    }

    /// What takes time: of a sine or cosine both of them, of a value itself.
    #[inline(always)]
    fn parts<T: Number>(self, x: T) -> (T, T) {
        if self == Self::Plain { (x, T::from(1.0)) } else { x.sin_cos() }
    }

    /// What it is of these parts, and its derivative.
    #[inline(always)]
    fn chosen<T: Number>(self, (sine, cosine): (T, T)) -> [T; 2] {
        if self == Self::Cosine { [cosine, sine.scaled(-1.0)] } else { [sine, cosine] }
    }
}

impl Blocks {
    fn new(layer: &Layer) -> Self {
        let blocks = layer.outputs.div_ceil(LANES);
        let mut weights = vec![[0.0; LANES]; blocks * layer.inputs];
        let mut bias = vec![[0.0; LANES]; blocks];
        for (row, value) in layer.bias.iter().enumerate() {
            bias[row / LANES][row % LANES] = value;
        }
        for (index, value) in layer.weight.iter().enumerate() {
            let (row, column) = (index / layer.inputs, index % layer.inputs);
            weights[row / LANES * layer.inputs + column][row % LANES] = value;
        }
        Self { inputs: layer.inputs, weights, bias, activation: layer.activation }
    }

    /// `W x + b`, or `W x` without bias.
    #[inline(always)]
    fn product<T: Number, const SIMD: u8>(&self, x: &[T], y: &mut [T], with_bias: bool) {
        let x = &x[..self.inputs];
        let rows = y.as_chunks_mut::<LANES>().0;
        for (block, (rows, bias)) in rows.iter_mut().zip(&self.bias).enumerate() {
            let weights = &self.weights[block * self.inputs..][..self.inputs];
            // two sums each, so that an addition need not wait for the one before
            let mut even = bias.map(|bias| T::from(if with_bias { bias } else { 0.0 }));
            let mut odd = [T::from(0.0); LANES];
            let (pairs, rest) = x.as_chunks::<2>();
            let (weight_pairs, weight_rest) = weights.as_chunks::<2>();
            for (x, w) in pairs.iter().zip(weight_pairs) {
                for lane in 0..LANES {
                    even[lane] = even[lane].add_scaled::<SIMD>(x[0], w[0][lane]);
                    odd[lane] = odd[lane].add_scaled::<SIMD>(x[1], w[1][lane]);
                }
            }
            for (x, w) in rest.iter().zip(weight_rest) {
                for lane in 0..LANES {
                    even[lane] = even[lane].add_scaled::<SIMD>(*x, w[lane]);
                }
            }
            for lane in 0..LANES {
                rows[lane] = even[lane] + odd[lane];
            }
        }
    }
}

/// Numbers of a layer, rounded up to whole blocks, in the widest of them.
fn width(layers: &[Blocks], columns: usize) -> usize {
    layers.iter().map(|layer| layer.bias.len() * LANES).fold(columns, usize::max)
}

/// An activation and its derivative; both follow from `tanh`, sines and cosines, of which every kind of number has the derivatives.
#[inline(always)]
fn with_slope<T: Number, const SIMD: u8>(activation: Activation, x: T) -> [T; 2] {
    let one = T::from(1.0);
    // of `(1 + tanh u) / 2`, whose derivative with respect to `u` is `2 s (1 - s)`
    let share = |u: T| (u.tanh::<SIMD>() + one).scaled(0.5);
    match activation {
        Activation::Identity => [x, one],
        Activation::Tanh => {
            let y = x.tanh::<SIMD>();
            [y, one - y * y]
        }
        Activation::Sigmoid => {
            let s = share(x.scaled(0.5));
            [s, s * (one - s)]
        }
        Activation::Silu => {
            let s = share(x.scaled(0.5));
            [x * s, s + x * s * (one - s)]
        }
        Activation::Gelu => {
            let square = x * x;
            let linear = (2.0 / std::f64::consts::PI).sqrt();
            let s = share(x * (T::from(linear) + square.scaled(0.044715 * linear)));
            let slope = T::from(linear) + square.scaled(3.0 * 0.044715 * linear);
            [x * s, s + (x * s * (one - s) * slope).scaled(2.0)]
        }
        Activation::Sine => x.sin_cos().into(),
        Activation::Relu if x.value() > 0.0 => [x, one],
        Activation::Relu => [x.scaled(0.0), T::from(0.0)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{
        dictionary::{Factor, Term},
        jet::Jet,
    };

    const SMOOTH: [Activation; 5] =
        [Activation::Tanh, Activation::Sigmoid, Activation::Gelu, Activation::Silu, Activation::Sine];

    /// Of an angle, a coordinate and a parameter, of which the network has the angle and the parameter.
    fn law(activation: Activation) -> Law {
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

    /// The same with nodes of the angle, of the parameter, of both and of neither, for one function or both.
    fn nodes() -> Law {
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

    fn laws() -> impl Iterator<Item = Law> {
        SMOOTH.map(law).into_iter().chain([nodes()])
    }

    fn with_network(layers: Vec<Layer>) -> Law {
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
        Law::new(dictionary, Some(network)).unwrap()
    }

    const POINT: [f64; 3] = [0.8, 1.3, -1.1];

    /// With derivatives with respect to so many first columns.
    fn compute<T: Number>(law: &Law, first: usize, x: &[T], y: &mut [T], gradient: &mut [T]) {
        let prepared = law.prepared(first, 0..0);
        prepared.compute(x, y, gradient, &mut prepared.work());
    }

    fn values(law: &Law, point: [f64; 3]) -> [f64; 3] {
        let mut y = [0.0; 3];
        law.evaluate(&point, &mut y);
        y
    }

    #[test]
    fn values_are_those_of_the_dictionary_and_the_network() {
        for law in Activation::ALL.map(law).into_iter().chain([nodes()]) {
            let (found, mut expected) = (values(&law, POINT), [0.0; 3]);
            law.dictionary().evaluate(&POINT, &mut expected);
            let term = law.network().unwrap();
            let (sine, cosine) = POINT[0].sin_cos();
            let more = term.network().evaluate(&[vec![sine, cosine, POINT[2]]]);
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
        for law in laws() {
            let (mut y, mut gradient) = ([0.0; 3], [0.0; 6]);
            compute(&law, 2, &POINT, &mut y, &mut gradient);
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
                    let expected = derivative(column, &|point| values(&law, point)[output]);
                    let found = gradient[2 * output + column];
                    assert!((found - expected).abs() < 1e-9, "{output} {column}: {found} {expected}");
                }
            }
            // along a curve: the series of the functions, and the rate of their gradient
            let (direction, bend) = ([0.3, -0.4, 1.2], [0.5, 0.1, -0.6]);
            let along: [Jet; 3] =
                std::array::from_fn(|i| Jet { value: POINT[i], first: direction[i], second: bend[i] });
            let (mut series, mut of_gradient) = ([Jet::default(); 3], [Jet::default(); 6]);
            compute(&law, 2, &along, &mut series, &mut of_gradient);
            let at =
                |h: f64| -> [f64; 3] { std::array::from_fn(|i| POINT[i] + h * direction[i] + 0.5 * h * h * bend[i]) };
            let gradient_at = |h: f64| {
                let (mut y, mut gradient) = ([0.0; 3], [0.0; 6]);
                compute(&law, 2, &at(h), &mut y, &mut gradient);
                gradient
            };
            let five = |of: &dyn Fn(f64) -> f64| {
                let [near, far] = [step, 2.0 * step].map(|h| [of(h), of(-h)]);
                let first = (8.0 * (near[0] - near[1]) - far[0] + far[1]) / (12.0 * step);
                let sum = 16.0 * (near[0] + near[1]) - far[0] - far[1] - 30.0 * of(0.0);
                [first, sum / (12.0 * step * step)]
            };
            for (output, found) in series.iter().enumerate() {
                let [first, second] = five(&|h| values(&law, at(h))[output]);
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
        let law = law(Activation::Tanh);
        let (direction, other) = ([0.3, -0.4, 1.2], [0.7, 0.2, -0.5]);
        let nested: [Jet<Jet>; 3] = std::array::from_fn(|i| Jet {
            value: Jet { value: POINT[i], first: other[i], second: 0.0 },
            first: Jet::from(direction[i]),
            second: Jet::from(0.0),
        });
        let mut series = [Jet::<Jet>::from(0.0); 3];
        compute(&law, 0, &nested, &mut series, &mut []);
        let second_along = |h: f64| {
            let along: [Jet; 3] =
                std::array::from_fn(|i| Jet { value: POINT[i] + h * other[i], first: direction[i], second: 0.0 });
            let mut series = [Jet::default(); 3];
            compute(&law, 0, &along, &mut series, &mut []);
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
        let law = nodes();
        for held in 1..3 {
            let prepared = law.prepared(1, held..3);
            let mut work = prepared.work();
            for (index, value) in [1.3, 1.3, 0.2, f64::NAN, 0.2].into_iter().enumerate() {
                for column in held..3 {
                    let mut point = POINT;
                    (point[0], point[column]) = (0.1 * index as f64, value);
                    let (mut y, mut gradient) = ([0.0; 3], [0.0; 3]);
                    prepared.compute(&point, &mut y, &mut gradient, &mut work);
                    let (mut expected, mut of_gradient) = ([0.0; 3], [0.0; 3]);
                    compute(&law, 1, &point, &mut expected, &mut of_gradient);
                    for (found, expected) in y.iter().chain(&gradient).zip(expected.iter().chain(&of_gradient)) {
                        let is_same = (found - expected).abs() < 1e-14 || found.is_nan() && expected.is_nan();
                        assert!(is_same, "{held} {index} {column}: {found} {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_of_the_first_functions_alone_are_the_same() {
        for law in laws() {
            let (mut y, mut all, mut two) = ([0.0; 3], [0.0; 6], [0.0; 4]);
            compute(&law, 2, &POINT, &mut y, &mut all);
            compute(&law, 2, &POINT, &mut y, &mut two);
            assert_eq!(all[..4], two);
        }
    }

    #[test]
    fn networks_that_do_not_fit_are_refused() {
        let law = law(Activation::Tanh);
        let NetworkTerm { columns, outputs, network, .. } = law.network().unwrap().clone();
        let message = |columns: &[NetworkColumn], outputs: &[usize]| {
            let term = NetworkTerm::new(columns.to_vec(), outputs.to_vec(), network.clone());
            term.and_then(|term| Law::new(law.dictionary().clone(), Some(term))).unwrap_err().to_string()
        };
        assert!(message(&columns[..2], &outputs).contains("`input_mean` has shape [3], expected [2]"));
        assert!(message(&columns, &[0]).contains("`output_mean` has shape [2], expected [1]"));
        assert_eq!(message(&columns, &[0, 3]), "tensor `network.outputs`, element 1: 3, expected less than 3");
        let far = [NetworkColumn { of: 7, ..columns[0] }, columns[1], columns[2]];
        assert_eq!(message(&far, &outputs), "tensor `network.columns`, element 0: 7, expected less than 3");
    }
}
