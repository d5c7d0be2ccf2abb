//! Regressors and scalers of `ai.onnx.ml`; `trees.rs` has the trees.

use super::*;

impl GraphReader {
    /// Imputer: it may replace NaN only, which never reaches an FMU, so it passes its input on.
    pub(super) fn imputer(&mut self, node: &NodeProto) -> Made {
        match Attributes::of(node).number("replaced_value_float") {
            Some(replaced) if replaced.is_nan() => self.input(node, 0),
            // 0 unless given
            replaced => Err(ImportError::unsupported(format!(
                "values of {} are replaced, expected NaN (`replaced_value_float`)",
                replaced.unwrap_or(0.0)
            ))),
        }
    }

    /// Inputs beside each other.
    pub(super) fn features(&mut self, node: &NodeProto) -> Made {
        let values = (0..node.input.len()).map(|place| self.input(node, place)).collect::<Result<Vec<_>, _>>()?;
        let widths: Vec<i64> = values.iter().map(|value| value.shape().last().copied().unwrap_or(1) as i64).collect();
        match Attributes::of(node).integers("inputdimensions") {
            Some(given) if !given.is_empty() && given != widths => Err(ImportError::malformed(format!(
                "attribute `inputdimensions` is {given:?} for inputs of {widths:?} columns, expected the same"
            ))),
            _ => self.concatenated(&values, 1),
        }
    }

    pub(super) fn scaler(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let value = self.input(node, 0)?;
        let count = value.shape().iter().product::<usize>();
        let width = value.shape().last().copied().unwrap_or(1);
        let numbers = |name: &str| -> Result<Vec<f64>, ImportError> {
            match attributes.numbers(name)?.values {
                one if one.len() == 1 => Ok(vec![one[0]; count]),
                // of each row the same
                all if all.len() == width && width > 0 => Ok(all.repeat(count / width)),
                other => Err(ImportError::malformed(format!(
                    "attribute `{name}` has {} elements, expected {width}",
                    other.len()
                ))),
            }
        };
        let (offset, scale) = (numbers("offset")?, numbers("scale")?);
        self.standardized(&value, &offset, &scale, &vec![0.0; count])
    }

    pub(super) fn linear_regressor(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        refuse_transform(attributes)?;
        let width = self.row(node, 0)?.shape.last().copied().unwrap_or(1);
        let targets = usize::try_from(attributes.integer("targets").unwrap_or(1)).unwrap_or(0);
        let (weight, mut bias) = (attributes.numbers("coefficients")?.values, attributes.numbers("intercepts")?.values);
        if bias.is_empty() {
            bias = vec![0.0; targets];
        }
        if targets == 0 || weight.len() != targets * width || bias.len() != targets {
            return Err(ImportError::malformed(format!(
                "{} coefficients and {} intercepts, expected {targets} times {width} and {targets}",
                weight.len(),
                bias.len()
            )));
        }
        let (weight, bias) = (single(weight), single(bias));
        self.each_row(node, targets, |reader, row| reader.affine(row, weight.clone(), bias.clone(), vec![1, targets]))
    }

    pub(super) fn svm_regressor(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        refuse_transform(attributes)?;
        if attributes.integer("one_class").unwrap_or(0) != 0 {
            return Err(ImportError::unsupported("a classifier of one class, expected a regression"));
        }
        let width = self.row(node, 0)?.shape.last().copied().unwrap_or(1);
        let supports = usize::try_from(attributes.integer("n_supports").unwrap_or(0)).unwrap_or(0);
        let (mut coefficients, rho) = (attributes.numbers("coefficients")?.values, attributes.numbers("rho")?.values);
        let bias = rho.first().copied().unwrap_or(0.0);
        let kernel = attributes.text("kernel_type").unwrap_or("LINEAR".into());
        if supports == 0 {
            if coefficients.is_empty() {
                // a constant: no row is far from it
                coefficients = vec![0.0; width];
            }
            if coefficients.len() != width {
                return Err(ImportError::malformed(format!("{} coefficients, expected {width}", coefficients.len())));
            }
            let (coefficients, bias) = (single(coefficients), single(vec![bias]));
            return self
                .each_row(node, 1, |reader, row| reader.affine(row, coefficients.clone(), bias.clone(), vec![1, 1]));
        }
        let vectors = attributes.numbers("support_vectors")?.values;
        if coefficients.len() != supports
            || vectors.len().checked_div(supports) != Some(width)
            || vectors.len() != supports * width
        {
            return Err(ImportError::malformed(format!(
                "{} coefficients and {} numbers of support vectors, expected {supports} and {supports} times {width}",
                coefficients.len(),
                vectors.len()
            )));
        }
        let parameters = attributes.numbers("kernel_params")?.values;
        let parameter = |place: usize, default: f64| parameters.get(place).copied().unwrap_or(default);
        let (gamma, offset, degree) = (parameter(0, 0.0), parameter(1, 0.0), parameter(2, 0.0));
        let like_vectors = |factor: f64| vectors.iter().map(|number| factor * number).collect::<Vec<f64>>();
        let (coefficients, bias) = (single(coefficients), single(vec![bias]));
        self.each_row(node, 1, |reader, row| {
            let builder = &mut reader.builder;
            let products = |builder: &mut Builder, factor: f64, offset: f64| {
                builder.affine(row.value, like_vectors(factor).into(), vec![offset; supports].into())
            };
            let kernels = match kernel.as_str() {
                "LINEAR" => products(builder, 1.0, 0.0)?,
                "POLY" => {
                    let line = products(builder, gamma, offset)?;
                    builder.elementwise(line, Elementwise::Power, vec![degree])?
                }
                "SIGMOID" => {
                    let line = products(builder, gamma, offset)?;
                    builder.elementwise(line, Elementwise::Activation(Activation::Tanh), Vec::new())?
                }
                "RBF" => {
                    let step = Step::Distances { of: row.value, centres: vectors.clone(), lengths: vec![1.0; width] };
                    let distances = builder.add(step, supports)?;
                    let exponent = builder.elementwise(distances, Elementwise::Linear, vec![-gamma, 0.0])?;
                    builder.elementwise(exponent, Elementwise::Exponential, Vec::new())?
                }
                other => {
                    return Err(ImportError::malformed(format!(
                        "kernel {other}, expected LINEAR, POLY, RBF or SIGMOID"
                    )));
                }
            };
            let kernels = RowTensor { shape: vec![1, supports], value: kernels, is_single: row.is_single };
            reader.affine(&kernels, coefficients.clone(), bias.clone(), vec![1, 1])
        })
    }

    pub(super) fn normalizer(&mut self, node: &NodeProto) -> Made {
        let norm = Attributes::of(node).text("norm").unwrap_or("MAX".into());
        let value = self.input(node, 0)?;
        let rank = value.shape().len();
        if norm != "L2" || rank == 0 {
            return Err(ImportError::unsupported(format!("norm {norm}, expected L2")));
        }
        self.in_groups(&value, rank - 1, |reader, of, width| {
            let square =
                reader.builder.add(Step::Distances { of, centres: vec![0.0; width], lengths: vec![1.0; width] }, 1)?;
            // of nothing but zeros nothing else is made
            let square = reader.builder.elementwise(square, Elementwise::Clip, vec![f64::MIN_POSITIVE, f64::MAX])?;
            let inverse = reader.builder.elementwise(square, Elementwise::Power, vec![-0.5])?;
            let repeated = reader.builder.columns(vec![[inverse as u32, 0]; width])?;
            reader.builder.add(Step::Combine { of: [of, repeated], operation: Operation::Multiply }, width)
        })
    }
}

/// Numbers in single precision, if all of them fit.
fn single(values: Vec<f64>) -> Numbers {
    match values.iter().all(|value| f64::from(*value as f32) == *value) {
        true => values.into_iter().map(|value| value as f32).collect::<Vec<f32>>().into(),
        false => values.into(),
    }
}
