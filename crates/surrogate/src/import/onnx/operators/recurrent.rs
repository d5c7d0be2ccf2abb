//! Recurrent cells: one step of an LSTM, GRU or RNN.
//!
//! A sequence is one sample at a time, so that a cell is a function of the sample and of its previous state. If that is
//! no input of the graph, it is a state of the model, which begins with the constant that the graph has for it.

use super::*;
use crate::import::RecurrentState;

/// Standard operators that have a state.
pub const RECURRENT: [&str; 3] = ["GRU", "LSTM", "RNN"];

/// Functions one after the other, with their parameters.
type FunctionChain = Vec<(Elementwise, Vec<f64>)>;

/// A cell that is being read: one row of samples, and the numbers of its weights in the order of ONNX.
struct RecurrentCell {
    hidden: usize,
    /// Value and width of the sample.
    sample: usize,
    inputs: usize,
    /// `W`, `R`, `Wb`, `Rb` of all gates, row by row, and `P`.
    weights: Vec<f64>,
    recurrence: Vec<f64>,
    bias: [Vec<f64>; 2],
    peepholes: Option<Vec<f64>>,
    activations: Vec<FunctionChain>,
    /// `true` if the batch stands before the sequence.
    batch_first: bool,
    is_single: bool,
}

impl GraphReader {
    /// `Y`, `Y_h` and, of an LSTM, `Y_c`.
    pub(super) fn recurrent(&mut self, node: &NodeProto) -> Result<Vec<Value>, ImportError> {
        let (gates, defaults): (usize, &[&str]) = match node.op_type.as_str() {
            "LSTM" => (4, &["Sigmoid", "Tanh", "Tanh"]),
            "GRU" => (3, &["Sigmoid", "Tanh"]),
            _ => (1, &["Tanh"]),
        };
        let cell = self.cell(node, gates, defaults)?;
        let before = self.before(node, 5, "h", &cell)?;
        let (after, memory) = match gates {
            4 => {
                let memory = self.before(node, 6, "c", &cell)?;
                let coupled = Attributes::of(node).integer("input_forget").unwrap_or(0) != 0;
                let [after, next] = self.lstm(&cell, [before.value, memory.value], coupled)?;
                self.has_memory(memory, next);
                (after, Some(next))
            }
            3 => {
                let linear_first = Attributes::of(node).integer("linear_before_reset").unwrap_or(0) != 0;
                (self.gru(&cell, before.value, linear_first)?, None)
            }
            _ => {
                let sum = self.gate_sums(&cell, &[cell.sample, before.value], 0..1)?;
                (self.activated(&cell, 0, sum)?, None)
            }
        };
        self.has_memory(before, after);
        let last = vec![1, 1, cell.hidden];
        let mut made =
            vec![row_of_cell(&cell, after, vec![1, 1, 1, cell.hidden]), row_of_cell(&cell, after, last.clone())];
        made.extend(memory.map(|memory| row_of_cell(&cell, memory, last)));
        Ok(made)
    }

    /// Checks a node and takes its weights.
    fn cell(&mut self, node: &NodeProto, gates: usize, defaults: &[&str]) -> Result<RecurrentCell, ImportError> {
        let attributes = Attributes::of(node);
        let direction = attributes.text("direction").unwrap_or("forward".into());
        if direction != "forward" {
            return Err(ImportError::unsupported(format!(
                "attribute `direction` is {direction:?}, expected \"forward\": samples come one at a time"
            )));
        }
        if let Some(clip) = attributes.number("clip") {
            return Err(ImportError::unsupported(format!("attribute `clip` is {clip}, expected none")));
        }
        let batch_first = attributes.integer("layout").unwrap_or(0) != 0;
        let sample = self.row(node, 0)?;
        let [length, batch, inputs] = match (sample.shape.as_slice(), batch_first) {
            (&[length, batch, inputs], false) | (&[batch, length, inputs], true) => [length, batch, inputs],
            (other, _) => {
                return Err(ImportError::malformed(format!(
                    "a sequence of shape {other:?}, expected three dimensions"
                )));
            }
        };
        if length != 1 {
            return Err(ImportError::unsupported(format!(
                "a sequence of {length} samples, expected 1 or a dimension that is free: the FMU gets one sample at a time"
            )));
        }
        if batch != 1 {
            return Err(ImportError::unsupported(format!(
                "a batch of {batch}, expected 1 or a dimension that is free"
            )));
        }
        let (weights, recurrence) = (self.cell_weights(node, 1, "W")?, self.cell_weights(node, 2, "R")?);
        let (bias, lengths, peepholes) = (self.constant(node, 3)?, self.constant(node, 4)?, self.constant(node, 7)?);
        if let Some(found) = lengths.filter(|lengths| lengths.data.doubles().iter().any(|length| *length != 1.0)) {
            return Err(ImportError::unsupported(format!(
                "input 4 (sequence_lens) is {:?}, expected 1",
                found.data.doubles()
            )));
        }
        let hidden = recurrence.shape.last().copied().unwrap_or(0);
        if let Some(size) = attributes.integer("hidden_size").filter(|size| usize::try_from(*size) != Ok(hidden)) {
            return Err(ImportError::malformed(format!(
                "attribute `hidden_size` is {size}, but R has {hidden} columns"
            )));
        }
        let rows = gates.checked_mul(hidden).filter(|rows| *rows > 0);
        let rows = rows.ok_or_else(|| ImportError::malformed("no hidden numbers"))?;
        weights_within_limits(rows, inputs + hidden)?;
        let bias = bias.map_or_else(|| Ok(vec![0.0; 2 * rows]), |bias| shaped(&bias, "B", &[1, 2 * rows]))?;
        let peepholes = peepholes.filter(|_| gates == 4);
        let peepholes = peepholes.map(|peepholes| shaped(&peepholes, "P", &[1, 3 * hidden])).transpose()?;
        Ok(RecurrentCell {
            hidden,
            sample: sample.value,
            inputs,
            weights: shaped(&weights, "W", &[1, rows, inputs])?,
            recurrence: shaped(&recurrence, "R", &[1, rows, hidden])?,
            bias: [bias[..rows].to_vec(), bias[rows..].to_vec()],
            peepholes,
            activations: activations(attributes, defaults)?,
            batch_first,
            is_single: sample.is_single,
        })
    }

    fn cell_weights(&self, node: &NodeProto, place: usize, name: &str) -> Result<ConstantTensor, ImportError> {
        let weights = self.constant(node, place)?;
        weights.ok_or_else(|| ImportError::malformed(format!("input {place} ({name}) is missing")))
    }

    /// Previous state of the cell: an input of the graph, or a state of the model.
    fn before(
        &mut self,
        node: &NodeProto,
        place: usize,
        what: &str,
        cell: &RecurrentCell,
    ) -> Result<Before, ImportError> {
        let given = self.given(node, place)?.cloned();
        if let Some(value) = &given {
            let count: usize = value.shape().iter().product();
            // one layer of one row, whichever of these dimensions comes first
            if count != cell.hidden || value.shape().len() != 3 {
                let order = if cell.batch_first { "batch, layer" } else { "layer, batch" };
                return Err(ImportError::malformed(format!(
                    "input {place} (initial_{what}) has the shape {:?}, expected [1, 1, {}] ({order}, hidden)",
                    value.shape(),
                    cell.hidden
                )));
            }
        }
        let start = match given {
            Some(Value::Row(row)) => return Ok(Before { value: row.value, state: None }),
            Some(Value::Constant(tensor)) => tensor.data.doubles(),
            None => vec![0.0; cell.hidden],
        };
        let first = self.builder.more_inputs(cell.hidden)?;
        let columns = (first..first + cell.hidden).map(|column| [0, column as u32]).collect();
        let value = self.builder.columns(columns)?;
        let made = node.output.iter().find(|name| !name.is_empty()).map_or("", String::as_str);
        let state = RecurrentState { name: format!("{made}.{what}"), first, next: value, start };
        Ok(Before { value, state: Some(state) })
    }

    /// Notes what a state of the model becomes.
    fn has_memory(&mut self, before: Before, next: usize) {
        self.recurrences.extend(before.state.map(|state| RecurrentState { next, ..state }));
    }

    /// `W x + R h + Wb + Rb` of some gates, of values that are the sample and what the hidden numbers are multiplied as.
    fn gate_sums(
        &mut self,
        cell: &RecurrentCell,
        of: &[usize; 2],
        gates: std::ops::Range<usize>,
    ) -> Result<usize, GraphError> {
        let RecurrentCell { hidden, inputs, weights, recurrence, bias: [of_sample, of_hidden], .. } = cell;
        let rows = gates.start * hidden..gates.end * hidden;
        let both = self.joined(of)?;
        let (mut weight, mut bias) = (Vec::<f64>::new(), Vec::<f64>::new());
        for row in rows {
            weight.extend(&weights[row * inputs..][..*inputs]);
            weight.extend(&recurrence[row * hidden..][..*hidden]);
            bias.push(of_sample[row] + of_hidden[row]);
        }
        self.builder.affine(both, weight.into(), bias.into())
    }

    fn joined(&mut self, of: &[usize]) -> Result<usize, GraphError> {
        let mut columns = Vec::new();
        for value in of {
            columns.extend((0..self.builder.width(*value)).map(|column| [*value as u32, column as u32]));
        }
        self.builder.columns(columns)
    }

    /// The part of a value that belongs to a gate.
    fn gate(&mut self, cell: &RecurrentCell, of: usize, gate: usize) -> Result<usize, GraphError> {
        let columns = gate * cell.hidden..(gate + 1) * cell.hidden;
        self.builder.columns(columns.map(|column| [of as u32, column as u32]).collect())
    }

    fn activated(&mut self, cell: &RecurrentCell, which: usize, of: usize) -> Result<usize, GraphError> {
        let mut functions = cell.activations[which].iter();
        functions.try_fold(of, |of, (function, parameters)| self.builder.elementwise(of, *function, parameters.clone()))
    }

    fn both(&mut self, cell: &RecurrentCell, operation: Operation, of: [usize; 2]) -> Result<usize, GraphError> {
        self.builder.add(Step::Combine { of, operation }, cell.hidden)
    }

    /// `1 - x`
    fn rest(&mut self, of: usize) -> Result<usize, GraphError> {
        self.builder.elementwise(of, Elementwise::Linear, vec![-1.0, 1.0])
    }

    /// Adds the peephole term of the memory to a gate's sum, if the cell has peepholes.
    fn peep(&mut self, cell: &RecurrentCell, gate: usize, [sum, memory]: [usize; 2]) -> Result<usize, GraphError> {
        let Some(peepholes) = &cell.peepholes else { return Ok(sum) };
        let factors = peepholes[gate * cell.hidden..][..cell.hidden].iter().copied();
        let parameters = factors.chain(std::iter::repeat_n(0.0, cell.hidden)).collect();
        let peeped = self.builder.elementwise(memory, Elementwise::Linear, parameters)?;
        self.both(cell, Operation::Add, [sum, peeped])
    }

    /// The hidden numbers and the memory after the sample; gates are input, output, forget, cell.
    fn lstm(
        &mut self,
        cell: &RecurrentCell,
        [before, memory]: [usize; 2],
        coupled: bool,
    ) -> Result<[usize; 2], GraphError> {
        let sums = self.gate_sums(cell, &[cell.sample, before], 0..4)?;
        let (input, output) = (self.gate(cell, sums, 0)?, self.gate(cell, sums, 1)?);
        let (forget, candidate) = (self.gate(cell, sums, 2)?, self.gate(cell, sums, 3)?);
        let input = self.peep(cell, 0, [input, memory])?;
        let input = self.activated(cell, 0, input)?;
        let forget = match coupled {
            true => self.rest(input)?,
            false => {
                let forget = self.peep(cell, 2, [forget, memory])?;
                self.activated(cell, 0, forget)?
            }
        };
        let candidate = self.activated(cell, 1, candidate)?;
        let kept = self.both(cell, Operation::Multiply, [forget, memory])?;
        let added = self.both(cell, Operation::Multiply, [input, candidate])?;
        let next = self.both(cell, Operation::Add, [kept, added])?;
        let output = self.peep(cell, 1, [output, next])?;
        let output = self.activated(cell, 0, output)?;
        let shown = self.activated(cell, 2, next)?;
        Ok([self.both(cell, Operation::Multiply, [output, shown])?, next])
    }

    /// The hidden numbers after the sample; gates are update, reset, hidden.
    fn gru(&mut self, cell: &RecurrentCell, before: usize, linear_first: bool) -> Result<usize, GraphError> {
        let sums = self.gate_sums(cell, &[cell.sample, before], 0..2)?;
        let gates = self.activated(cell, 0, sums)?;
        let (update, reset) = (self.gate(cell, gates, 0)?, self.gate(cell, gates, 1)?);
        let sum = if linear_first {
            let RecurrentCell { hidden, inputs, weights, recurrence, bias: [of_sample, of_hidden], .. } = cell;
            let first = 2 * hidden;
            let (weight, bias) = (recurrence[first * hidden..].to_vec(), of_hidden[first..].to_vec());
            let linear = self.builder.affine(before, weight.into(), bias.into())?;
            let reset = self.both(cell, Operation::Multiply, [reset, linear])?;
            let (weight, bias) = (weights[first * inputs..].to_vec(), of_sample[first..].to_vec());
            let of_sample = self.builder.affine(cell.sample, weight.into(), bias.into())?;
            self.both(cell, Operation::Add, [of_sample, reset])?
        } else {
            let reset = self.both(cell, Operation::Multiply, [reset, before])?;
            self.gate_sums(cell, &[cell.sample, reset], 2..3)?
        };
        let candidate = self.activated(cell, 1, sum)?;
        let rest = self.rest(update)?;
        let new = self.both(cell, Operation::Multiply, [rest, candidate])?;
        let kept = self.both(cell, Operation::Multiply, [update, before])?;
        self.both(cell, Operation::Add, [new, kept])
    }
}

/// A value that has the numbers of a cell.
fn row_of_cell(cell: &RecurrentCell, value: usize, shape: Vec<usize>) -> Value {
    Value::Row(RowTensor { shape, value, is_single: cell.is_single })
}

/// Numbers of a tensor of a shape.
fn shaped(tensor: &ConstantTensor, name: &str, shape: &[usize]) -> Result<Vec<f64>, ImportError> {
    if tensor.shape == shape {
        return Ok(tensor.data.doubles());
    }
    Err(ImportError::malformed(format!("{name} has the shape {:?}, expected {shape:?}", tensor.shape)))
}

/// Previous state of a cell.
struct Before {
    /// The value that has its numbers.
    value: usize,
    /// State of the model, if it is no input of the graph; its next value is not known yet.
    state: Option<RecurrentState>,
}

/// The functions of a cell.
fn activations(attributes: Attributes, defaults: &[&str]) -> Result<Vec<FunctionChain>, ImportError> {
    let mut names = attributes.texts("activations");
    if names.is_empty() {
        names = defaults.iter().map(|name| (*name).to_owned()).collect();
    }
    if names.len() != defaults.len() {
        return Err(ImportError::malformed(format!(
            "attribute `activations` has {} names, expected {}",
            names.len(),
            defaults.len()
        )));
    }
    let (alphas, betas) = (attributes.floats("activation_alpha")?, attributes.floats("activation_beta")?);
    let mut numbers = ActivationNumbers { alphas: alphas.into_iter(), betas: betas.into_iter() };
    names.iter().map(|name| function_chain(name, &mut numbers)).collect()
}

/// Numbers of functions. Each function takes the next of the numbers that it has.
struct ActivationNumbers {
    alphas: std::vec::IntoIter<f64>,
    betas: std::vec::IntoIter<f64>,
}

impl ActivationNumbers {
    fn alpha(&mut self, default: f64) -> f64 {
        self.alphas.next().unwrap_or(default)
    }

    fn beta(&mut self, default: f64) -> f64 {
        self.betas.next().unwrap_or(default)
    }
}

fn function_chain(name: &str, numbers: &mut ActivationNumbers) -> Result<FunctionChain, ImportError> {
    let tanh = (Elementwise::Activation(Activation::Tanh), Vec::new());
    Ok(match name.to_ascii_lowercase().as_str() {
        "tanh" => vec![tanh],
        "sigmoid" => vec![(Elementwise::Activation(Activation::Sigmoid), Vec::new())],
        "relu" => vec![(Elementwise::Activation(Activation::Relu), Vec::new())],
        "softsign" => vec![(Elementwise::Softsign, Vec::new())],
        "softplus" => vec![(Elementwise::Softplus, Vec::new())],
        "affine" => vec![(Elementwise::Linear, vec![numbers.alpha(1.0), numbers.beta(0.0)])],
        "leakyrelu" => vec![(Elementwise::LeakyRelu, vec![numbers.alpha(0.01)])],
        "thresholdedrelu" => vec![(Elementwise::ThresholdedRelu, vec![numbers.alpha(1.0)])],
        "elu" => vec![(Elementwise::Elu, vec![numbers.alpha(1.0)])],
        "hardsigmoid" => {
            let line = (Elementwise::Linear, vec![numbers.alpha(0.2), numbers.beta(0.5)]);
            vec![line, (Elementwise::Clip, vec![0.0, 1.0])]
        }
        "scaledtanh" => {
            let (outer, inner) = (numbers.alpha(1.0), numbers.beta(1.0));
            vec![(Elementwise::Linear, vec![inner, 0.0]), tanh, (Elementwise::Linear, vec![outer, 0.0])]
        }
        _ => {
            let known = [
                "Tanh",
                "Sigmoid",
                "Relu",
                "Softsign",
                "Softplus",
                "Affine",
                "LeakyRelu",
                "ThresholdedRelu",
                "Elu",
                "HardSigmoid",
                "ScaledTanh",
            ];
            return Err(ImportError::malformed(format!(
                "attribute `activations`: \"{name}\", {}",
                crate::diagnostics::names::expected_one_of(name, &known)
            )));
        }
    })
}
