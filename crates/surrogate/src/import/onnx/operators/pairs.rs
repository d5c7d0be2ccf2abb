//! Functions of two values or more.

use super::*;

impl GraphReader {
    pub(super) fn many(&mut self, node: &NodeProto, operation: Operation) -> Made {
        let mut result = self.input(node, 0)?;
        for place in 1..node.input.len() {
            let next = self.input(node, place)?;
            result = self.combined(operation, &result, &next)?;
        }
        Ok(result)
    }

    pub(super) fn combined(&mut self, operation: Operation, a: &Value, b: &Value) -> Made {
        let shape = broadcast(a.shape(), b.shape())?;
        let (a, b) = (self.expanded(a, &shape)?, self.expanded(b, &shape)?);
        match (&a, &b) {
            (Value::Constant(a), Value::Constant(b)) => {
                let is_whole = matches!((&a.data, &b.data), (Data::Integer(_), Data::Integer(_)));
                let pairs = a.data.doubles().into_iter().zip(b.data.doubles());
                let values: Vec<f64> = pairs.map(|(a, b)| of_numbers(operation, a, b, is_whole)).collect();
                if values.iter().any(|value| !value.is_finite()) {
                    return Err(ImportError::not_finite("a constant becomes a number that is not finite"));
                }
                Ok(Value::Constant(ConstantTensor::like(&a.data, shape, values)))
            }
            (Value::Row(_), Value::Constant(b)) => self.with_constant(operation, &a, &b.data.doubles(), false),
            (Value::Constant(a), Value::Row(_)) => self.with_constant(operation, &b, &a.data.doubles(), true),
            (Value::Row(a), Value::Row(b)) => {
                let width = self.builder.width(a.value);
                let value = self.builder.add(Step::Combine { of: [a.value, b.value], operation }, width)?;
                Ok(Value::Row(RowTensor { shape, value, is_single: a.is_single }))
            }
        }
    }

    /// A row and a constant of the same shape; `is_first`: the constant is the first of the two.
    pub(super) fn with_constant(&mut self, operation: Operation, row: &Value, numbers: &[f64], is_first: bool) -> Made {
        let width = numbers.len();
        if width == 0 {
            return Err(ImportError::unsupported("nothing is left"));
        }
        match operation {
            Operation::Add => {
                self.mapped(row, Elementwise::Linear, linear_parameters(vec![1.0; width], numbers.to_vec()))
            }
            Operation::Subtract if is_first => {
                self.mapped(row, Elementwise::Linear, linear_parameters(vec![-1.0; width], numbers.to_vec()))
            }
            Operation::Subtract => {
                let offsets = numbers.iter().map(|number| -number).collect();
                self.mapped(row, Elementwise::Linear, linear_parameters(vec![1.0; width], offsets))
            }
            Operation::Multiply => {
                self.mapped(row, Elementwise::Linear, linear_parameters(numbers.to_vec(), vec![0.0; width]))
            }
            Operation::Divide if is_first => {
                let inverse = self.mapped(row, Elementwise::Reciprocal, Vec::new())?;
                self.mapped(&inverse, Elementwise::Linear, linear_parameters(numbers.to_vec(), vec![0.0; width]))
            }
            Operation::Divide => {
                if numbers.contains(&0.0) {
                    return Err(ImportError::not_finite("a division by a constant that is 0"));
                }
                let factors = numbers.iter().map(|number| 1.0 / number).collect();
                self.mapped(row, Elementwise::Linear, linear_parameters(factors, vec![0.0; width]))
            }
            Operation::Maximum => {
                self.mapped(row, Elementwise::Clip, [numbers.to_vec(), vec![f64::MAX; width]].concat())
            }
            Operation::Minimum => {
                self.mapped(row, Elementwise::Clip, [vec![f64::MIN; width], numbers.to_vec()].concat())
            }
        }
    }

    pub(super) fn power(&mut self, node: &NodeProto) -> Made {
        let (base, exponent) = (self.input(node, 0)?, self.input(node, 1)?);
        let shape = broadcast(base.shape(), exponent.shape())?;
        let (base, exponent) = (self.expanded(&base, &shape)?, self.expanded(&exponent, &shape)?);
        match (&base, &exponent) {
            (_, Value::Constant(exponent)) => {
                let mut exponents = exponent.data.doubles();
                if exponents.windows(2).all(|pair| pair[0] == pair[1]) {
                    exponents.truncate(1);
                }
                self.mapped(&base, Elementwise::Power, exponents)
            }
            (Value::Constant(base), Value::Row(_)) => {
                let base = base.data.doubles();
                if base.iter().any(|base| *base <= 0.0) {
                    return Err(ImportError::unsupported("a power of a constant that is not positive"));
                }
                let factors = [base.iter().map(|base| base.ln()).collect(), vec![0.0; base.len()]].concat();
                let exponent = self.mapped(&exponent, Elementwise::Linear, factors)?;
                self.mapped(&exponent, Elementwise::Exponential, Vec::new())
            }
            (Value::Row(_), Value::Row(_)) => {
                let logarithm = self.mapped(&base, Elementwise::Logarithm, Vec::new())?;
                let product = self.combined(Operation::Multiply, &exponent, &logarithm)?;
                self.mapped(&product, Elementwise::Exponential, Vec::new())
            }
        }
    }

    /// Operand of a comparison. Inputs of the graph are rounded to the model's precision, because a threshold may be
    /// the same number.
    fn compared(&mut self, node: &NodeProto, place: usize) -> Made {
        match self.input(node, place)? {
            Value::Row(row) if row.is_single && self.is_input(&row) => Ok(Value::Row(self.rounded(row)?)),
            value => Ok(value),
        }
    }

    /// 1 where the comparison is true, else 0.
    pub(super) fn compare(&mut self, node: &NodeProto) -> Made {
        let (a, b) = (self.compared(node, 0)?, self.compared(node, 1)?);
        let (more, less) = if node.op_type.starts_with("Greater") { (a, b) } else { (b, a) };
        if !node.op_type.ends_with("OrEqual") {
            let difference = self.combined(Operation::Subtract, &more, &less)?;
            return self.mapped(&difference, Elementwise::Positive, Vec::new());
        }
        let difference = self.combined(Operation::Subtract, &less, &more)?;
        let is_less = self.mapped(&difference, Elementwise::Positive, Vec::new())?;
        self.mapped(&is_less, Elementwise::Linear, vec![-1.0, 1.0])
    }

    /// 1 where the numbers are the same, else 0.
    pub(super) fn equal(&mut self, node: &NodeProto) -> Made {
        let (a, b) = (self.compared(node, 0)?, self.compared(node, 1)?);
        let difference = self.combined(Operation::Subtract, &a, &b)?;
        let distance = self.mapped(&difference, Elementwise::Absolute, Vec::new())?;
        let differs = self.mapped(&distance, Elementwise::Positive, Vec::new())?;
        self.mapped(&differs, Elementwise::Linear, vec![-1.0, 1.0])
    }

    /// `asin x = atan (x / √((1 - x) (1 + x)))` and `acos x = 2 atan √((1 - x) / (1 + x))`, which lose no digits at 1.
    pub(super) fn arc(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let below = self.mapped(&value, Elementwise::Linear, vec![-1.0, 1.0])?;
        let above = self.mapped(&value, Elementwise::Linear, vec![1.0, 1.0])?;
        let is_sine = node.op_type == "Asin";
        let operation = if is_sine { Operation::Multiply } else { Operation::Divide };
        let of_both = self.combined(operation, &below, &above)?;
        let root = self.mapped(&of_both, Elementwise::Power, vec![if is_sine { -0.5 } else { 0.5 }])?;
        let tangent = if is_sine { self.combined(Operation::Multiply, &value, &root)? } else { root };
        let angle = self.mapped(&tangent, Elementwise::Arctangent, Vec::new())?;
        if is_sine { Ok(angle) } else { self.mapped(&angle, Elementwise::Linear, vec![2.0, 0.0]) }
    }

    pub(super) fn choose(&mut self, node: &NodeProto) -> Made {
        let (condition, a, b) = (self.input(node, 0)?, self.input(node, 1)?, self.input(node, 2)?);
        let shape = broadcast(&broadcast(condition.shape(), a.shape())?, b.shape())?;
        let condition = self.expanded(&condition, &shape)?;
        let (a, b) = (self.expanded(&a, &shape)?, self.expanded(&b, &shape)?);
        if let (Value::Constant(condition), Value::Constant(a), Value::Constant(b)) = (&condition, &a, &b) {
            let pairs = a.data.doubles().into_iter().zip(b.data.doubles());
            let chosen = condition.data.doubles().into_iter().zip(pairs);
            let values = chosen.map(|(condition, (a, b))| if condition > 0.0 { a } else { b }).collect();
            return Ok(Value::Constant(ConstantTensor::like(&a.data, shape, values)));
        }
        let mut rows = Vec::new();
        for value in [condition, a, b] {
            rows.push(match value {
                Value::Row(row) => row,
                Value::Constant(tensor) => constant_row(&mut self.builder, &tensor)?,
            });
        }
        let width = self.builder.width(rows[0].value);
        let value = self.builder.add(Step::Select { of: [rows[0].value, rows[1].value, rows[2].value] }, width)?;
        Ok(Value::Row(RowTensor { shape, value, is_single: rows[1].is_single }))
    }

    /// Remainder of known whole numbers.
    pub(super) fn remainder(&mut self, node: &NodeProto) -> Made {
        let (a, b) = (self.required_constant(node, 0)?, self.required_constant(node, 1)?);
        let shape = broadcast(&a.shape, &b.shape)?;
        let (of_a, of_b) = (broadcast_places(&a.shape, &shape), broadcast_places(&b.shape, &shape));
        let (a, b) = (a.integers()?, b.integers()?);
        let pairs = of_a.iter().zip(&of_b).map(|(first, second)| (a[*first], b[*second]));
        // with `fmod` the sign is that of the first number, else that of the second
        let of_first = Attributes::of(node).integer("fmod").unwrap_or(0) != 0;
        let values: Option<Vec<i64>> = pairs
            .map(|(a, b)| {
                let rest = a.checked_rem(b)?;
                let is_of_other_sign = rest != 0 && (rest < 0) != (b < 0);
                Some(if is_of_other_sign && !of_first { rest + b } else { rest })
            })
            .collect();
        let values = values.ok_or_else(|| ImportError::not_finite("a division by 0"))?;
        Ok(Value::Constant(ConstantTensor { shape, data: Data::Integer(values) }))
    }

    pub(super) fn prelu(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let slope = Value::Constant(self.required_constant(node, 1)?);
        let shape = value.shape().to_vec();
        if broadcast(&shape, slope.shape())? != shape {
            return Err(ImportError::malformed(format!("a slope of shape {:?} for {shape:?}", slope.shape())));
        }
        let Value::Constant(slope) = self.expanded(&slope, &shape)? else { unreachable!("a constant stays one") };
        self.mapped(&value, Elementwise::LeakyRelu, slope.data.doubles())
    }

    pub(super) fn clip(&mut self, node: &NodeProto) -> Made {
        let (min, max) = (self.limit(node, 1, "min", f64::MIN)?, self.limit(node, 2, "max", f64::MAX)?);
        if min > max {
            return Err(ImportError::malformed(format!("limits from {min} to {max}")));
        }
        let value = self.input(node, 0)?;
        self.mapped(&value, Elementwise::Clip, vec![min, max])
    }

    /// Number of an input, or of an attribute before version 11.
    fn limit(&self, node: &NodeProto, place: usize, attribute: &str, default: f64) -> Result<f64, ImportError> {
        match self.constant(node, place)? {
            Some(tensor) => tensor.data.doubles().first().copied().ok_or_else(|| empty_input(place)),
            None => Attributes::of(node).float(attribute, default),
        }
    }

    pub(super) fn hard_sigmoid(&mut self, value: &Value, alpha: f64, beta: f64) -> Made {
        let line = self.mapped(value, Elementwise::Linear, vec![alpha, beta])?;
        self.mapped(&line, Elementwise::Clip, vec![0.0, 1.0])
    }

    /// Functions of two others.
    pub(super) fn of_two(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        if node.op_type == "Tan" {
            let sine = self.mapped(&value, Elementwise::Activation(Activation::Sine), Vec::new())?;
            let cosine = self.mapped(&value, Elementwise::Cosine, Vec::new())?;
            return self.combined(Operation::Divide, &sine, &cosine);
        }
        if node.op_type == "Sinh" {
            // a difference of exponentials would have few digits near 0
            let hyperbolic = self.mapped(&value, Elementwise::Activation(Activation::Tanh), Vec::new())?;
            let cosine = self.hyperbolic_cosine(&value)?;
            return self.combined(Operation::Multiply, &hyperbolic, &cosine);
        }
        self.hyperbolic_cosine(&value)
    }

    fn hyperbolic_cosine(&mut self, value: &Value) -> Made {
        let up = self.mapped(value, Elementwise::Exponential, Vec::new())?;
        let down = self.mapped(value, Elementwise::Linear, vec![-1.0, 0.0])?;
        let down = self.mapped(&down, Elementwise::Exponential, Vec::new())?;
        let both = self.combined(Operation::Add, &up, &down)?;
        self.mapped(&both, Elementwise::Linear, vec![0.5, 0.0])
    }
}

/// Parameters of a linear function: only one factor and offset if they are all the same.
fn linear_parameters(factors: Vec<f64>, offsets: Vec<f64>) -> Vec<f64> {
    let are_same = [&factors, &offsets].iter().all(|numbers| numbers.iter().all(|number| *number == numbers[0]));
    match are_same {
        true => vec![factors[0], offsets[0]],
        false => [factors, offsets].concat(),
    }
}

fn of_numbers(operation: Operation, a: f64, b: f64, is_whole: bool) -> f64 {
    match operation {
        Operation::Add => a + b,
        Operation::Subtract => a - b,
        Operation::Multiply => a * b,
        Operation::Divide if is_whole => (a / b).trunc(),
        Operation::Divide => a / b,
        Operation::Maximum => a.max(b),
        Operation::Minimum => a.min(b),
    }
}
