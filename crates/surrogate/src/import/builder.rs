//! Builds a graph of steps and simplifies it: a graph that is a feed-forward network becomes one, which the FMU
//! evaluates faster.

use metafmu_runtime::{
    Activation, FormatError, Layer, Numbers, ScaledNetwork, Scaling,
    graph::{Elementwise, Graph, MAX_VALUES, Step},
};
use std::fmt;

/// Largest number of weights of a step: a file of a few kilobytes must not request gigabytes.
pub const MAX_WEIGHTS: usize = 1 << 25;

/// Reason why a graph cannot be built.
#[derive(Debug)]
pub enum GraphError {
    /// More numbers or weights than a graph may have.
    TooLarge {
        /// Numbers of all values.
        numbers: usize,
        /// Weights of all steps.
        weights: usize,
    },
    /// A graph that is appended to a value of another length.
    Width {
        /// Numbers of the value.
        found: usize,
        /// Columns of the graph.
        expected: usize,
    },
    /// A graph with steps that do not fit each other.
    Format(FormatError),
    /// A graph with NaN or infinity after constants were folded.
    NotFinite(FormatError),
}

impl fmt::Display for GraphError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLarge { numbers, weights } => write!(
                f,
                "the graph has {numbers} numbers and {weights} weights up to here, expected at most {MAX_VALUES} and {MAX_WEIGHTS}"
            ),
            Self::Width { found, expected } => write!(f, "{found} columns, expected {expected}"),
            Self::Format(error) => error.fmt(f),
            Self::NotFinite(error) => write!(f, "constant folding of the graph produced NaN or infinity: {error}"),
        }
    }
}

impl std::error::Error for GraphError {}

/// A graph under construction: every step is added behind those whose values it uses.
#[derive(Clone, Debug)]
pub struct Builder {
    widths: Vec<usize>,
    steps: Vec<Step>,
    numbers: usize,
    weights: usize,
}

impl Builder {
    /// A graph with `inputs` input columns, which are value 0.
    pub fn new(inputs: usize) -> Self {
        Self { widths: vec![inputs], steps: Vec::new(), numbers: inputs, weights: 0 }
    }

    /// Further input columns, behind those that there are: the position of the first one.
    ///
    /// # Errors
    /// As [`Builder::add`].
    pub fn more_inputs(&mut self, count: usize) -> Result<usize, GraphError> {
        let first = self.widths[0];
        self.numbers = self.numbers.saturating_add(count);
        self.within_limits()?;
        self.widths[0] += count;
        Ok(first)
    }

    fn within_limits(&self) -> Result<(), GraphError> {
        if self.numbers > MAX_VALUES || self.weights > MAX_WEIGHTS {
            return Err(GraphError::TooLarge { numbers: self.numbers, weights: self.weights });
        }
        Ok(())
    }

    /// Length of a value.
    pub fn width(&self, value: usize) -> usize {
        self.widths[value]
    }

    /// All steps up to here.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Adds a step that makes `width` numbers; the result is the value's number.
    ///
    /// # Errors
    /// [`GraphError::TooLarge`].
    pub fn add(&mut self, step: Step, width: usize) -> Result<usize, GraphError> {
        self.numbers = self.numbers.saturating_add(width);
        self.weights = self.weights.saturating_add(match &step {
            Step::Affine { weight, .. } => weight.len(),
            Step::Distances { centres, .. } => centres.len(),
            Step::Forest { forest, .. } => forest.nodes.len(),
            Step::Products { products, .. } => products.degrees.len(),
            _ => 0,
        });
        self.within_limits()?;
        self.steps.push(step);
        self.widths.push(width);
        Ok(self.steps.len())
    }

    /// `W x + b`, `W` row by row.
    ///
    /// # Errors
    /// As [`Builder::add`].
    pub fn affine(&mut self, of: usize, weight: Numbers, bias: Numbers) -> Result<usize, GraphError> {
        let width = bias.len();
        self.add(Step::Affine { of, weight, bias }, width)
    }

    /// A function of each number.
    ///
    /// # Errors
    /// As [`Builder::add`].
    pub fn elementwise(&mut self, of: usize, function: Elementwise, parameters: Vec<f64>) -> Result<usize, GraphError> {
        self.add(Step::Elementwise { of, function, parameters }, self.width(of))
    }

    /// Numbers of some values.
    ///
    /// # Errors
    /// As [`Builder::add`].
    pub fn columns(&mut self, columns: Vec<[u32; 2]>) -> Result<usize, GraphError> {
        let width = columns.len();
        self.add(Step::Columns { columns }, width)
    }

    /// Outputs of another graph, whose columns are a value.
    ///
    /// # Errors
    /// As [`Builder::add`]. [`GraphError::Width`] if the numbers of the value are not as many as the columns of the graph,
    /// [`GraphError::Format`] if the graph is invalid.
    pub fn append(&mut self, of: usize, graph: &Graph) -> Result<usize, GraphError> {
        let widths = graph.widths().map_err(GraphError::Format)?;
        if self.width(of) != graph.inputs {
            return Err(GraphError::Width { found: self.width(of), expected: graph.inputs });
        }
        let before = self.steps.len();
        let mut last = of;
        for (step, width) in graph.steps.iter().zip(&widths[1..]) {
            let mut step = step.clone();
            step.rename(|value| if value == 0 { of } else { before + value });
            last = self.add(step, *width)?;
        }
        Ok(last)
    }

    /// The graph for other columns: `first` computes its previous columns from them.
    #[must_use]
    pub fn after(self, inputs: usize, first: Step) -> Self {
        let Self { widths, steps, numbers, weights } = self;
        let mut all = vec![first];
        all.extend(steps);
        // every value is one place further, and the old columns are the value of the new step
        all[1..].iter_mut().for_each(|step| step.rename(|of| of + 1));
        Self { widths: [vec![inputs], widths].concat(), steps: all, numbers: numbers + inputs, weights }
    }

    /// The graph from the input columns to some numbers of some values.
    ///
    /// # Errors
    /// As [`Builder::add`].
    pub fn finish(mut self, outputs: Vec<[u32; 2]>) -> Result<Graph, GraphError> {
        self.columns(outputs)?;
        let inputs = self.widths[0];
        let mut steps = self.steps;
        // each pass makes something shorter or ends
        while let Some(fewer) = simplified(inputs, &steps) {
            steps = fewer;
        }
        Ok(match network(inputs, &steps) {
            Some(network) => Graph::from(&network),
            None => Graph { inputs, steps },
        })
    }
}

#[cfg(test)]
impl Builder {
    /// The graph as it was put together.
    pub(super) fn unsimplified(mut self, outputs: Vec<[u32; 2]>) -> Graph {
        self.columns(outputs).expect("a graph for tests is small");
        Graph { inputs: self.widths[0], steps: self.steps }
    }
}

/// The steps with one removed or two of them merged; none if that is impossible.
fn simplified(inputs: usize, steps: &[Step]) -> Option<Vec<Step>> {
    let uses = uses(steps);
    let widths = Graph { inputs, steps: steps.to_vec() }.widths().ok()?;
    let nearness = nearness(steps);
    if steps.len() > 1
        && let Some(unused) = (0..steps.len() - 1).find(|step| uses[step + 1] == 0)
    {
        return Some(without(steps, unused, 0));
    }
    for (number, step) in steps.iter().enumerate() {
        if let Some(same) = alias(step, &widths)
            && (number + 1 < steps.len() || same > 0)
        {
            if number + 1 < steps.len() {
                return Some(without(steps, number, same));
            }
            // the last value is the outputs
            if same == steps.len() - 1 {
                return Some(steps[..number].to_vec());
            }
        }
        let known = AnalyzedSteps { steps, widths: &widths, nearness: &nearness, uses: &uses };
        if let Some(fewer) = linear_first(known, number).or_else(|| together(known, number)) {
            return Some(fewer);
        }
        if !keeps_difference(known, number)
            && let Some((merged, of)) = merged(known, number)
        {
            let mut fewer = steps.to_vec();
            fewer[number] = merged;
            return Some(without(&fewer, of - 1, 0));
        }
    }
    None
}

/// Steps, and of each value its length, its nearness to the inputs, and by how many steps it is used.
#[derive(Clone, Copy)]
struct AnalyzedSteps<'a> {
    steps: &'a [Step],
    widths: &'a [usize],
    nearness: &'a [Nearness],
    uses: &'a [usize],
}

impl<'a> AnalyzedSteps<'a> {
    /// The step that a value is of; none for the inputs.
    fn maker(&self, of: usize) -> Option<&'a Step> {
        of.checked_sub(1).map(|number| &self.steps[number])
    }

    /// The step that a value is of, if only one step uses the value.
    fn inner(&self, of: usize) -> Option<&'a Step> {
        self.maker(of).filter(|_| self.uses[of] == 1)
    }

    /// The value of which another one is a linear function that only one step uses, with the parameters.
    fn inner_linear(&self, of: usize) -> Option<(usize, &'a [f64])> {
        match self.inner(of) {
            Some(Step::Elementwise { of, function: Elementwise::Linear, parameters }) => Some((*of, parameters)),
            _ => None,
        }
    }
}

/// How much was done to the input columns until they became a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Nearness {
    /// Chosen, and multiplied.
    Columns,
    /// Shifted, too.
    Shifted,
    /// Anything else.
    Far,
}

fn nearness(steps: &[Step]) -> Vec<Nearness> {
    let mut found = vec![Nearness::Columns];
    for step in steps {
        found.push(match step {
            Step::Columns { columns } => {
                let of_columns: Vec<Nearness> = columns.iter().map(|[of, _]| found[*of as usize]).collect();
                if of_columns.contains(&Nearness::Columns) {
                    // with columns among them it counts as columns
                    Nearness::Columns
                } else if of_columns.contains(&Nearness::Far) {
                    Nearness::Far
                } else {
                    Nearness::Shifted
                }
            }
            Step::Elementwise { of, function: Elementwise::Single, .. } => found[*of],
            Step::Elementwise { of, function: Elementwise::Linear, parameters } => match found[*of] {
                Nearness::Columns if !shifts(parameters) => Nearness::Columns,
                Nearness::Far => Nearness::Far,
                _ => Nearness::Shifted,
            },
            _ => Nearness::Far,
        });
    }
    found
}

fn shifts(parameters: &[f64]) -> bool {
    parameters[parameters.len() / 2..].iter().any(|offset| *offset != 0.0)
}

/// Returns true if a step and the one before it must not be merged. Inputs may be far from zero compared with their
/// range (a pressure in Pa, a temperature in K). Their offset must be subtracted before products or sums, because this
/// difference is exact and that of two products is not.
fn keeps_difference(known: AnalyzedSteps, number: usize) -> bool {
    let AnalyzedSteps { steps, nearness, .. } = known;
    match &steps[number] {
        Step::Affine { of, .. } => known.inner_linear(*of).is_some() && nearness[*of] == Nearness::Shifted,
        Step::Elementwise { of, function: Elementwise::Linear, parameters } => {
            known.inner_linear(*of).is_some_and(|(first, before)| {
                let width = before.len().max(parameters.len()) / 2;
                let ((a, b), (c, d)) = (of_each(before, width), of_each(parameters, width));
                // a constant that stands for a column may be merged, and what changes nothing
                nearness[first] == Nearness::Columns
                    && !(0..width).all(|k| a[k] == 0.0 || b[k] == 0.0 || (c[k] == 1.0 && d[k] == 0.0))
            })
        }
        _ => false,
    }
}

/// The steps with a linear function of chosen input columns moved before the choice, so that it may become the scaling
/// of a network's inputs. None if a column would have two of them.
fn linear_first(AnalyzedSteps { steps, widths, nearness, uses }: AnalyzedSteps, number: usize) -> Option<Vec<Step>> {
    let Step::Elementwise { of, function: Elementwise::Linear, parameters } = &steps[number] else { return None };
    let Step::Columns { columns } = &steps[of.checked_sub(1)?] else { return None };
    let first = columns[0][0];
    let (width, before) = (columns.len(), widths[first as usize]);
    let is_choice = columns.iter().all(|[value, _]| *value == first)
        && nearness[first as usize] != Nearness::Far
        && uses[*of] == 1
        && before <= 2 * width + 16;
    if !is_choice {
        return None;
    }
    let (factors, offsets) = of_each(parameters, width);
    let mut of_column: Vec<Option<[f64; 2]>> = vec![None; before];
    for ([_, column], (factor, offset)) in columns.iter().zip(factors.into_iter().zip(offsets)) {
        let known = of_column[*column as usize].get_or_insert([factor, offset]);
        if *known != [factor, offset] {
            return None;
        }
    }
    let all: Vec<[f64; 2]> = of_column.into_iter().map(|of| of.unwrap_or([1.0, 0.0])).collect();
    let parameters = [0, 1].map(|row| all.iter().map(|of| of[row]).collect::<Vec<f64>>()).concat();
    let mut turned = steps.to_vec();
    turned[of - 1] = Step::Elementwise { of: first as usize, function: Elementwise::Linear, parameters };
    turned[number] = Step::Columns { columns: columns.iter().map(|[_, column]| [*of as u32, *column]).collect() };
    Some(turned)
}

/// The steps with input columns joined before linear functions of some of them, so that inputs normalized separately
/// are as good as inputs normalized together.
fn together(known: AnalyzedSteps, number: usize) -> Option<Vec<Step>> {
    let AnalyzedSteps { steps, widths, nearness, .. } = known;
    let Step::Columns { columns } = &steps[number] else { return None };
    if columns.iter().all(|[value, _]| *value == columns[0][0])
        || columns.iter().any(|[value, _]| nearness[*value as usize] == Nearness::Far)
    {
        return None;
    }
    let direct: Vec<[u32; 2]> = columns
        .iter()
        .map(|&[value, column]| match known.maker(value as usize) {
            Some(Step::Columns { columns }) => columns[column as usize],
            _ => [value, column],
        })
        .collect();
    let mut turned = steps.to_vec();
    if direct != *columns {
        turned[number] = Step::Columns { columns: direct };
        return Some(turned);
    }
    let (mut of, mut factors, mut offsets) = (Vec::new(), Vec::new(), Vec::new());
    for &[value, column] in columns {
        let (source, factor, offset) = match known.inner_linear(value as usize) {
            Some((source, parameters)) => {
                let (factors, offsets) = of_each(parameters, widths[value as usize]);
                (source as u32, factors[column as usize], offsets[column as usize])
            }
            None => (value, 1.0, 0.0),
        };
        of.push([source, column]);
        factors.push(factor);
        offsets.push(offset);
    }
    if of == *columns {
        return None;
    }
    let parameters = [factors, offsets].concat();
    turned.iter_mut().skip(number + 1).for_each(|step| step.rename(|value| value + usize::from(value > number)));
    turned[number] = Step::Columns { columns: of };
    turned.insert(number + 1, Step::Elementwise { of: number + 1, function: Elementwise::Linear, parameters });
    Some(turned)
}

/// Number of steps that use each value; the result of the graph uses the last one.
fn uses(steps: &[Step]) -> Vec<usize> {
    let mut uses = vec![0; steps.len() + 1];
    uses[steps.len()] = 1;
    for step in steps {
        let mut of: Vec<usize> = step.values().collect();
        of.sort_unstable();
        of.dedup();
        of.into_iter().for_each(|value| uses[value] += 1);
    }
    uses
}

/// The steps without one; steps that use its value use `instead`.
fn without(steps: &[Step], removed: usize, instead: usize) -> Vec<Step> {
    let mut rest: Vec<Step> = steps.to_vec();
    rest.remove(removed);
    rest.iter_mut().for_each(|step| {
        step.rename(|of| match of {
            _ if of == removed + 1 => instead,
            _ if of > removed => of - 1,
            _ => of,
        })
    });
    rest
}

/// The value that a step only repeats.
fn alias(step: &Step, widths: &[usize]) -> Option<usize> {
    match step {
        Step::Elementwise { of, function: Elementwise::Activation(Activation::Identity), .. } => Some(*of),
        Step::Columns { columns } => {
            let of = columns[0][0];
            let same = columns.len() == widths[of as usize]
                && columns.iter().enumerate().all(|(index, column)| *column == [of, index as u32]);
            same.then_some(of as usize)
        }
        _ => None,
    }
}

/// A step merged with the one before it, and the number of the value that is no longer needed.
fn merged(known: AnalyzedSteps, number: usize) -> Option<(Step, usize)> {
    match &known.steps[number] {
        Step::Elementwise { of, function: Elementwise::Linear, parameters } => {
            Some((linear_of_inner(known, *of, parameters)?, *of))
        }
        Step::Affine { of, weight, bias } => Some((affine_of_inner(known, *of, weight, bias)?, *of)),
        Step::Columns { columns } => {
            let of = columns[0][0] as usize;
            let is_choice = columns.iter().all(|[value, _]| *value as usize == of);
            is_choice.then(|| columns_of_inner(known, of, columns)).flatten().map(|step| (step, of))
        }
        _ => None,
    }
}

/// A linear function of each number of a value, merged with the step that the value is of.
fn linear_of_inner(known: AnalyzedSteps, of: usize, parameters: &[f64]) -> Option<Step> {
    match known.inner(of)? {
        Step::Affine { of: first, weight, bias } => {
            let columns = known.widths[*first];
            let (factors, offsets) = of_each(parameters, bias.len());
            let weight: Vec<f64> =
                weight.iter().enumerate().map(|(index, weight)| factors[index / columns] * weight).collect();
            let bias = bias.iter().zip(factors.iter().zip(&offsets));
            let bias: Vec<f64> = bias.map(|(bias, (factor, offset))| factor * bias + offset).collect();
            Some(Step::Affine { of: *first, weight: weight.into(), bias: bias.into() })
        }
        Step::Elementwise { of: first, function: Elementwise::Linear, parameters: before } => {
            let width = known.widths[of];
            let ((a, b), (c, d)) = (of_each(before, width), of_each(parameters, width));
            let factors = a.iter().zip(&c).map(|(a, c)| a * c);
            let offsets = b.iter().zip(c.iter().zip(&d)).map(|(b, (c, d))| c * b + d);
            let parameters = factors.chain(offsets).collect();
            Some(Step::Elementwise { of: *first, function: Elementwise::Linear, parameters })
        }
        _ => None,
    }
}

/// A layer of a value, merged with the step that the value is of.
fn affine_of_inner(known: AnalyzedSteps, of: usize, weight: &Numbers, bias: &Numbers) -> Option<Step> {
    let (widths, width) = (known.widths, known.widths[of]);
    match known.inner(of)? {
        Step::Elementwise { of: first, function: Elementwise::Linear, parameters } => {
            let (factors, offsets) = of_each(parameters, width);
            let weight: Vec<f64> = weight.iter().collect();
            let bias: Vec<f64> =
                bias.iter().zip(weight.chunks_exact(width)).map(|(bias, row)| bias + dot(row, &offsets)).collect();
            let weight: Vec<f64> =
                weight.iter().enumerate().map(|(index, weight)| weight * factors[index % width]).collect();
            Some(Step::Affine { of: *first, weight: weight.into(), bias: bias.into() })
        }
        Step::Affine { of: first, weight: inner_weight, bias: inner_bias } => {
            let (outputs, columns) = (bias.len(), widths[*first]);
            if outputs * columns > outputs * width + width * columns {
                return None;
            }
            let (weight, before): (Vec<f64>, Vec<f64>) = (weight.iter().collect(), inner_weight.iter().collect());
            let inner_bias: Vec<f64> = inner_bias.iter().collect();
            let (mut bias, mut product) = (bias.iter().collect::<Vec<f64>>(), vec![0.0; outputs * columns]);
            let rows = weight.chunks_exact(width);
            for ((bias, to), row) in bias.iter_mut().zip(product.chunks_exact_mut(columns)).zip(rows) {
                *bias += dot(row, &inner_bias);
                for (factor, from) in row.iter().zip(before.chunks_exact(columns)) {
                    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
                }
            }
            Some(Step::Affine { of: *first, weight: product.into(), bias: bias.into() })
        }
        Step::Columns { columns } if columns.iter().all(|[value, _]| *value == columns[0][0]) => {
            let first = columns[0][0] as usize;
            // not more weights than there were, but for a few
            let is_small = widths[first] <= 2 * width + 16;
            is_small.then(|| Step::Affine {
                of: first,
                weight: spread(weight, columns, widths[first]),
                bias: bias.clone(),
            })
        }
        _ => None,
    }
}

/// Weights of chosen columns as weights of all the columns that they were chosen from.
fn spread(weight: &Numbers, columns: &[[u32; 2]], before: usize) -> Numbers {
    let mut spread = vec![0.0; weight.len() / columns.len() * before];
    for (index, weight) in weight.iter().enumerate() {
        let (row, column) = (index / columns.len(), columns[index % columns.len()][1] as usize);
        spread[row * before + column] += weight;
    }
    match weight {
        // sums of two singles may not be one
        Numbers::Single(_) if spread.iter().all(|weight| f64::from(*weight as f32) == *weight) => {
            spread.iter().map(|weight| *weight as f32).collect::<Vec<f32>>().into()
        }
        _ => spread.into(),
    }
}

/// Chosen columns of a value, merged with the step that the value is of.
fn columns_of_inner(known: AnalyzedSteps, of: usize, columns: &[[u32; 2]]) -> Option<Step> {
    match known.inner(of)? {
        Step::Columns { columns: before } => {
            let columns = columns.iter().map(|[_, column]| before[*column as usize]).collect();
            Some(Step::Columns { columns })
        }
        Step::Affine { of: first, weight, bias } if columns.len() <= bias.len() => {
            let width = known.widths[*first];
            let rows: Vec<usize> = columns.iter().map(|[_, row]| *row as usize).collect();
            let weight = picked(weight, rows.iter().flat_map(|row| row * width..(row + 1) * width));
            Some(Step::Affine { of: *first, weight, bias: picked(bias, rows.iter().copied()) })
        }
        _ => None,
    }
}

fn picked(numbers: &Numbers, places: impl Iterator<Item = usize>) -> Numbers {
    match numbers {
        Numbers::Single(values) => places.map(|place| values[place]).collect::<Vec<f32>>().into(),
        Numbers::Double(values) => places.map(|place| values[place]).collect::<Vec<f64>>().into(),
    }
}

/// Factors and offsets of a linear function, one for each number.
fn of_each(parameters: &[f64], width: usize) -> (Vec<f64>, Vec<f64>) {
    match parameters {
        [factor, offset] => (vec![*factor; width], vec![*offset; width]),
        of_each => (of_each[..width].to_vec(), of_each[width..].to_vec()),
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The steps as a feed-forward network: layers one after the other, each with an activation that networks have. Linear functions of the inputs
/// before them are its scaling, which is computed in double precision whatever the network is.
fn network(inputs: usize, steps: &[Step]) -> Option<ScaledNetwork> {
    let mut layers: Vec<Layer> = Vec::new();
    let mut width = inputs;
    let mut columns = vec![ColumnTransform { mean: 0.0, factor: 1.0, offset: 0.0 }; inputs];
    for (number, step) in steps.iter().enumerate() {
        match step {
            Step::Elementwise { of, function: Elementwise::Linear, parameters }
                if *of == number && layers.is_empty() =>
            {
                let (factors, offsets) = of_each(parameters, width);
                let of_step = factors.into_iter().zip(offsets);
                columns.iter_mut().zip(of_step).for_each(|(column, (factor, offset))| column.then(factor, offset));
            }
            Step::Affine { of, weight, bias } if *of == number => {
                let (weight, bias) = match layers.is_empty() {
                    true => behind_scaling(&columns, weight, bias),
                    false => (weight.clone(), bias.clone()),
                };
                let activation = Activation::Identity;
                layers.push(Layer { inputs: width, outputs: bias.len(), weight, bias, activation });
                width = layers.last()?.outputs;
            }
            Step::Elementwise { of, function: Elementwise::Activation(activation), .. } if *of == number => {
                let last = layers.last_mut().filter(|layer| layer.activation == Activation::Identity)?;
                last.activation = *activation;
            }
            _ => return None,
        }
    }
    let outputs = layers.last()?.outputs;
    let scaling = Scaling {
        input_mean: columns.iter().map(|column| column.mean).collect(),
        input_scale: columns.iter().map(ColumnTransform::scale).collect(),
        output_mean: vec![0.0; outputs],
        output_scale: vec![1.0; outputs],
    };
    columns
        .iter()
        .all(|column| column.scale().is_normal() && column.mean.is_finite())
        .then_some(ScaledNetwork { scaling, layers })
}

/// Linear transform of an input column: `(x - mean) factor + offset`.
#[derive(Clone, Copy, Debug)]
struct ColumnTransform {
    mean: f64,
    factor: f64,
    offset: f64,
}

impl ColumnTransform {
    /// Another one behind it. What the first one adds is the mean: what it subtracts, that is, unless it multiplies as well.
    fn then(&mut self, factor: f64, offset: f64) {
        let is_first = self.mean == 0.0 && self.offset == 0.0 && self.factor != 0.0;
        self.factor *= factor;
        if is_first && self.factor != 0.0 {
            self.mean = -offset / self.factor;
        } else {
            self.offset = factor * self.offset + offset;
        }
    }

    /// Positive scale, as in every network; 1 for a column without effect.
    fn scale(&self) -> f64 {
        if self.factor == 0.0 { 1.0 } else { 1.0 / self.factor.abs() }
    }
}

/// Weights and biases of a layer of the standardized columns: with the signs of the factors, and the offsets.
fn behind_scaling(columns: &[ColumnTransform], weight: &Numbers, bias: &Numbers) -> (Numbers, Numbers) {
    // products with these are exact in either precision
    let signs = columns.iter().map(|column| if column.factor == 0.0 { 0.0 } else { column.factor.signum() }).cycle();
    let signed = match weight {
        Numbers::Single(values) => {
            values.iter().zip(signs).map(|(weight, sign)| weight * sign as f32).collect::<Vec<f32>>().into()
        }
        Numbers::Double(values) => {
            values.iter().zip(signs).map(|(weight, sign)| weight * sign).collect::<Vec<f64>>().into()
        }
    };
    let offsets: Vec<f64> = columns.iter().map(|column| column.offset).collect();
    if offsets.iter().all(|offset| *offset == 0.0) {
        return (signed, bias.clone());
    }
    let weight: Vec<f64> = weight.iter().collect();
    let bias = bias.iter().zip(weight.chunks_exact(columns.len())).map(|(bias, row)| bias + dot(row, &offsets));
    (signed, bias.collect::<Vec<f64>>().into())
}
