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
        let offset = of_columns(attributes, "offset", value.shape())?;
        let scale = of_columns(attributes, "scale", value.shape())?;
        self.standardized(&value, &offset, &scale, &vec![0.0; offset.len()])
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
        let [gamma, offset, degree] = [0, 1, 2].map(|place| parameters.get(place).copied().unwrap_or(0.0));
        let (coefficients, bias) = (single(coefficients), single(vec![bias]));
        self.each_row(node, 1, |reader, row| {
            let builder = &mut reader.builder;
            let kernels = match kernel.as_str() {
                "LINEAR" => builder.affine(row.value, vectors.clone().into(), vec![0.0; supports].into())?,
                "POLY" => {
                    let scaled: Vec<f64> = vectors.iter().map(|number| gamma * number).collect();
                    let line = builder.affine(row.value, scaled.into(), vec![offset; supports].into())?;
                    builder.elementwise(line, Elementwise::Power, vec![degree])?
                }
                "SIGMOID" => {
                    let scaled: Vec<f64> = vectors.iter().map(|number| gamma * number).collect();
                    let line = builder.affine(row.value, scaled.into(), vec![offset; supports].into())?;
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

/// Numbers of an attribute, one for each element of a tensor of this shape; each row has the same.
fn of_columns(attributes: Attributes, name: &str, shape: &[usize]) -> Result<Vec<f64>, ImportError> {
    let count = shape.iter().product::<usize>();
    let width = shape.last().copied().unwrap_or(1);
    match attributes.numbers(name)?.values {
        of_all if of_all.len() == 1 => Ok(vec![of_all[0]; count]),
        of_row if of_row.len() == width && width > 0 => Ok(of_row.repeat(count / width)),
        other => {
            Err(ImportError::malformed(format!("attribute `{name}` has {} elements, expected {width}", other.len())))
        }
    }
}

/// Numbers in single precision, if all of them fit.
fn single(values: Vec<f64>) -> Numbers {
    match values.iter().all(|value| f64::from(*value as f32) == *value) {
        true => values.into_iter().map(|value| value as f32).collect::<Vec<f32>>().into(),
        false => values.into(),
    }
}
