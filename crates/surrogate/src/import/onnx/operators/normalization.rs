//! Normalizations and sums along axes.

use super::*;
use std::ops::Range;

fn in_training() -> ImportError {
    ImportError::unsupported("a network in training, expected one for inference: export it after `eval()`")
}

fn other_count(place: usize, found: usize, channels: usize) -> ImportError {
    ImportError::malformed(format!("input {place} has {found} elements, expected {channels}"))
}

impl GraphReader {
    pub(super) fn dropout(&mut self, node: &NodeProto) -> Made {
        let drops = self.constant(node, 1)?.is_none_or(|ratio| is_not_zero(&ratio));
        if drops && self.constant(node, 2)?.is_some_and(|training| is_not_zero(&training)) {
            return Err(in_training());
        }
        self.input(node, 0)
    }

    pub(super) fn batch_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        if attributes.integer("training_mode").unwrap_or(0) != 0 {
            return Err(in_training());
        }
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let channels = *shape.get(1).ok_or_else(|| ImportError::malformed("a tensor without channels"))?;
        let scale = self.of_channels(node, 1, channels)?;
        let bias = self.of_channels(node, 2, channels)?;
        let mean = self.of_channels(node, 3, channels)?;
        let variance = self.of_channels(node, 4, channels)?;
        let factors: Vec<f64> =
            scale.iter().zip(&variance).map(|(scale, variance)| scale / (variance + epsilon).sqrt()).collect();
        if factors.iter().any(|factor| !factor.is_finite()) {
            return Err(ImportError::not_finite("a variance that is not positive"));
        }
        let channel = places(&shape, |index| index[1]);
        let [mean, factors, bias] =
            [mean, factors, bias].map(|numbers| channel.iter().map(|channel| numbers[*channel]).collect::<Vec<f64>>());
        self.standardized(&value, &mean, &factors, &bias)
    }

    /// A number for each channel.
    fn of_channels(&self, node: &NodeProto, place: usize, channels: usize) -> Result<Vec<f64>, ImportError> {
        let tensor = self.required_constant(node, place)?;
        match tensor.data.len() {
            count if count == channels => Ok(tensor.data.doubles()),
            count => Err(other_count(place, count, channels)),
        }
    }

    /// `(x - mean) factor + offset`, in this order: with inputs far from zero, a difference of products would have few
    /// digits.
    pub(super) fn standardized(&mut self, value: &Value, mean: &[f64], factors: &[f64], offsets: &[f64]) -> Made {
        let difference = self.with_constant(Operation::Subtract, value, mean, false)?;
        self.mapped(&difference, Elementwise::Linear, [factors, offsets].concat())
    }

    pub(super) fn layer_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let at = axis(attributes.integer("axis").unwrap_or(-1), value.shape().len())?;
        let normal =
            self.in_groups(&value, at, |reader, of, width| reader.builder.add(Step::Normalize { of, epsilon }, width))?;
        self.scaled(node, normal)
    }

    /// Normalization of each channel, or of as many groups of channels as are given.
    pub(super) fn group_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let [rows, channels, rest @ ..] = shape.as_slice() else {
            return Err(ImportError::malformed(format!(
                "a shape of {shape:?}, expected the batch, channels, and other dimensions"
            )));
        };
        let groups = match node.op_type.as_str() {
            "InstanceNormalization" => *channels,
            _ => usize::try_from(attributes.integer("num_groups").unwrap_or(0)).unwrap_or(0),
        };
        if groups == 0 || !channels.is_multiple_of(groups) {
            return Err(ImportError::malformed(format!("{channels} channels in {groups} groups")));
        }
        let each = channels / groups;
        let grouped = self.reshaped(&value, [&[*rows, groups, each], rest].concat())?;
        let mut normal = self
            .in_groups(&grouped, 2, |reader, of, width| reader.builder.add(Step::Normalize { of, epsilon }, width))?;
        // before version 21 a group has one of each
        for (place, operation) in [(1, Operation::Multiply), (2, Operation::Add)] {
            let tensor = self.required_constant(node, place)?;
            let dims = match tensor.data.len() {
                count if count == *channels => [groups, each],
                count if count == groups => [groups, 1],
                count => return Err(other_count(place, count, *channels)),
            };
            let tensor =
                Value::Constant(ConstantTensor { shape: [&dims[..], &vec![1; rest.len()]].concat(), ..tensor });
            normal = self.combined(operation, &normal, &tensor)?;
        }
        self.reshaped(&normal, shape)
    }

    pub(super) fn rms_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let at = axis(attributes.integer("axis").unwrap_or(-1), value.shape().len())?;
        let normal = self.in_groups(&value, at, |reader, of, width| {
            let square =
                reader.builder.add(Step::Distances { of, centres: vec![0.0; width], lengths: vec![1.0; width] }, 1)?;
            let mean = reader.builder.elementwise(square, Elementwise::Linear, vec![1.0 / width as f64, epsilon])?;
            let inverse = reader.builder.elementwise(mean, Elementwise::Power, vec![-0.5])?;
            let repeated = reader.builder.columns(vec![[inverse as u32, 0]; width])?;
            reader.builder.add(Step::Combine { of: [of, repeated], operation: Operation::Multiply }, width)
        })?;
        self.scaled(node, normal)
    }

    /// Times input 1, plus input 2.
    pub(super) fn scaled(&mut self, node: &NodeProto, mut value: Value) -> Made {
        if let Some(scale) = self.given(node, 1)?.cloned() {
            value = self.combined(Operation::Multiply, &value, &scale)?;
        }
        if let Some(bias) = self.given(node, 2)?.cloned() {
            value = self.combined(Operation::Add, &value, &bias)?;
        }
        Ok(value)
    }

    /// Does something to each group of elements that differ in the axes from `at` on only.
    pub(super) fn in_groups(
        &mut self,
        value: &Value,
        at: usize,
        mut make: impl FnMut(&mut Self, usize, usize) -> Result<usize, GraphError>,
    ) -> Made {
        let Value::Row(row) = value else { return Err(ImportError::unsupported("a normalization of a constant")) };
        let width: usize = row.shape[at..].iter().product();
        let groups: usize = row.shape[..at].iter().product();
        if width == 0 || groups == 0 {
            return Err(ImportError::unsupported("a normalization of nothing"));
        }
        if groups == 1 {
            let made = make(self, row.value, width)?;
            return Ok(Value::Row(RowTensor { value: made, ..row.clone() }));
        }
        let mut columns = Vec::new();
        for group in 0..groups {
            let part = (group * width..(group + 1) * width).map(|column| [row.value as u32, column as u32]).collect();
            let part = self.builder.columns(part)?;
            let made = make(self, part, width)?;
            columns.extend((0..width).map(|column| [made as u32, column as u32]));
        }
        Ok(Value::Row(RowTensor { value: self.builder.columns(columns)?, ..row.clone() }))
    }

    /// The axis of a softmax, and `true` if those after it belong to it as well.
    fn normalized_axis(&self, node: &NodeProto, rank: usize) -> Result<(usize, bool), ImportError> {
        // before version 13 all axes from this one on are one
        let (default, whole) = if self.opset < 13 { (1, true) } else { (-1, false) };
        Ok((axis(Attributes::of(node).integer("axis").unwrap_or(default), rank)?, whole))
    }

    pub(super) fn softmax(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let rank = value.shape().len();
        let (at, whole) = self.normalized_axis(node, rank)?;
        if whole || at + 1 == rank {
            return self.softmax_from(&value, at);
        }
        // the other way round it is the same exchange
        let mut order: Vec<usize> = (0..rank).collect();
        order.swap(at, rank - 1);
        let turned = self.transposed(&value, &order)?;
        let turned = self.softmax_from(&turned, rank - 1)?;
        self.transposed(&turned, &order)
    }

    /// The softmax of all axes from one on.
    fn softmax_from(&mut self, value: &Value, at: usize) -> Made {
        self.in_groups(value, at, |reader, of, width| reader.builder.add(Step::Softmax { of }, width))
    }

    /// Subtracts the logarithm of a sum that is at least 1, so nothing underflows to -inf.
    pub(super) fn log_softmax(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let (at, whole) = self.normalized_axis(node, value.shape().len())?;
        let mut kept = value.shape().to_vec();
        let end = if whole { kept.len() } else { at + 1 };
        kept[at..end].fill(1);
        let logarithm = self.logarithm_of_sum(&value, kept)?;
        self.combined(Operation::Subtract, &value, &logarithm)
    }

    /// log(sum(exp x)) of elements, `kept` the shape of the sums.
    fn logarithm_of_sum(&mut self, value: &Value, kept: Vec<usize>) -> Made {
        let largest = self.folded(Operation::Maximum, value, kept.clone())?;
        let below = self.combined(Operation::Subtract, value, &largest)?;
        let exponentials = self.mapped(&below, Elementwise::Exponential, Vec::new())?;
        let sum = self.sum(&exponentials, kept, 1.0)?;
        let logarithm = self.mapped(&sum, Elementwise::Logarithm, Vec::new())?;
        self.combined(Operation::Add, &largest, &logarithm)
    }

    pub(super) fn reduce(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let axes = self.integers(node, 1, "axes")?.filter(|axes| !axes.is_empty());
        let axes: Vec<usize> = match axes {
            Some(axes) => axes.iter().map(|at| axis(*at, shape.len())).collect::<Result<_, _>>()?,
            // operations on each element still apply
            None if attributes.integer("noop_with_empty_axes").unwrap_or(0) != 0 => Vec::new(),
            None => (0..shape.len()).collect(),
        };
        let kept: Vec<usize> =
            shape.iter().enumerate().map(|(at, dim)| if axes.contains(&at) { 1 } else { *dim }).collect();
        let (count, width) = (kept.iter().product::<usize>(), shape.iter().product::<usize>());
        if count == 0 || width == 0 {
            return Err(ImportError::unsupported("a sum of nothing"));
        }
        let rest: Vec<usize> = match attributes.integer("keepdims").unwrap_or(1) {
            0 => shape.iter().enumerate().filter(|(at, _)| !axes.contains(at)).map(|(_, dim)| *dim).collect(),
            _ => kept.clone(),
        };
        let reduced = match node.op_type.as_str() {
            "ReduceProd" => self.folded(Operation::Multiply, &value, kept)?,
            "ReduceMax" => self.folded(Operation::Maximum, &value, kept)?,
            "ReduceMin" => self.folded(Operation::Minimum, &value, kept)?,
            "ReduceMean" => self.mean(&value, kept, width / count)?,
            "ReduceLogSumExp" => self.logarithm_of_sum(&value, kept)?,
            "ReduceLogSum" => {
                let sum = self.sum(&value, kept, 1.0)?;
                self.mapped(&sum, Elementwise::Logarithm, Vec::new())?
            }
            "ReduceL1" => {
                let magnitude = self.mapped(&value, Elementwise::Absolute, Vec::new())?;
                self.sum(&magnitude, kept, 1.0)?
            }
            "ReduceSumSquare" | "ReduceL2" => {
                let square = self.mapped(&value, Elementwise::Power, vec![2.0])?;
                let sum = self.sum(&square, kept, 1.0)?;
                if node.op_type == "ReduceL2" { self.mapped(&sum, Elementwise::Power, vec![0.5])? } else { sum }
            }
            _ => self.sum(&value, kept, 1.0)?,
        };
        self.reshaped(&reduced, rest)
    }

    fn mean(&mut self, value: &Value, kept: Vec<usize>, each: usize) -> Made {
        match value {
            // whole numbers are added up before they are divided
            Value::Constant(ConstantTensor { data: Data::Integer(_), .. }) => {
                let sum = self.sum(value, kept, 1.0)?;
                let count = ConstantTensor { shape: Vec::new(), data: Data::Integer(vec![each as i64]) };
                self.combined(Operation::Divide, &sum, &Value::Constant(count))
            }
            _ => self.sum(value, kept, 1.0 / each as f64),
        }
    }

    /// Sums of elements times a factor.
    pub(super) fn sum(&mut self, value: &Value, kept: Vec<usize>, factor: f64) -> Made {
        if kept == value.shape() && factor == 1.0 {
            return Ok(value.clone());
        }
        let into = broadcast_places(&kept, value.shape());
        let (count, width) = (kept.iter().product::<usize>(), into.len());
        weights_within_limits(count, width)?;
        let mut weight = vec![0.0; count * width];
        into.iter().enumerate().for_each(|(column, row)| weight[row * width + column] = factor);
        match value {
            Value::Row(row) => self.affine(row, weight.into(), vec![0.0; count].into(), kept),
            Value::Constant(tensor) => {
                let numbers = tensor.data.doubles();
                let rows = weight.chunks_exact(width);
                let sums = rows.map(|row| row.iter().zip(&numbers).map(|(weight, number)| weight * number).sum());
                Ok(Value::Constant(ConstantTensor::like(&tensor.data, kept, sums.collect())))
            }
        }
    }

    /// Product of elements, or the largest or smallest: combines one half with the other until one element remains.
    pub(super) fn folded(&mut self, operation: Operation, value: &Value, kept: Vec<usize>) -> Made {
        let mut of: Vec<Vec<usize>> = vec![Vec::new(); kept.iter().product()];
        let into = broadcast_places(&kept, value.shape());
        into.into_iter().enumerate().for_each(|(element, place)| of[place].push(element));
        let mut each = of.first().map_or(0, Vec::len);
        if each == 0 {
            return Err(ImportError::unsupported("a product of nothing"));
        }
        let mut value = self.pick(value, &of.concat(), vec![of.len(), each])?;
        let mut odd: Option<Value> = None;
        while each > 1 {
            let half = each / 2;
            let [first, second] = [0..half, half..2 * half]
                .map(|part| self.pick(&value, &places_in_groups(of.len(), each, part), vec![of.len(), half]));
            if each % 2 == 1 {
                let last = self.pick(&value, &places_in_groups(of.len(), each, each - 1..each), vec![of.len(), 1])?;
                odd = Some(match odd {
                    None => last,
                    Some(odd) => self.combined(operation, &odd, &last)?,
                });
            }
            value = self.combined(operation, &first?, &second?)?;
            each = half;
        }
        if let Some(odd) = odd {
            value = self.combined(operation, &value, &odd)?;
        }
        self.reshaped(&value, kept)
    }
}

/// Returns true if any number of a tensor is not zero.
fn is_not_zero(tensor: &ConstantTensor) -> bool {
    tensor.data.doubles().iter().any(|number| *number != 0.0)
}

/// Positions of a part of the elements of each group.
fn places_in_groups(groups: usize, each: usize, part: Range<usize>) -> Vec<usize> {
    (0..groups).flat_map(|group| part.clone().map(move |element| group * each + element)).collect()
}
