//! Casts, and constants that nodes make.

use super::*;

impl GraphReader {
    pub(super) fn cast(&mut self, node: &NodeProto) -> Made {
        let to = Attributes::of(node).integer("to").unwrap_or_default() as i32;
        self.cast_to(node, to, &type_name(to))
    }

    pub(super) fn cast_like(&mut self, node: &NodeProto) -> Made {
        let (to, name) = match self.input(node, 1)? {
            Value::Constant(ConstantTensor { data: Data::Integer(_), .. }) => (INT64, "whole numbers or truth values"),
            Value::Constant(ConstantTensor { data: Data::Single(_), .. })
            | Value::Row(RowTensor { is_single: true, .. }) => (FLOAT, ""),
            _ => (DOUBLE, ""),
        };
        self.cast_to(node, to, name)
    }

    fn cast_to(&mut self, node: &NodeProto, to: i32, name: &str) -> Made {
        let value = self.input(node, 0)?;
        let refused = ImportError::unsupported(format!("a cast to {name}, expected float or double"));
        match value {
            Value::Constant(ConstantTensor { shape, data }) => {
                let values = data.doubles();
                let data = match to {
                    FLOAT => Data::Single(values.iter().map(|value| *value as f32).collect()),
                    DOUBLE => Data::Double(values),
                    INT32 | INT64 => Data::Integer(values.iter().map(|value| *value as i64).collect()),
                    _ => return Err(refused),
                };
                Ok(Value::Constant(ConstantTensor { shape, data }))
            }
            Value::Row(mut row) => {
                let is_single = match to {
                    FLOAT => true,
                    DOUBLE => false,
                    _ => return Err(refused),
                };
                if is_single && !row.is_single && self.has_trees {
                    row.value = self.builder.elementwise(row.value, Elementwise::Single, Vec::new())?;
                }
                Ok(Value::Row(RowTensor { is_single, ..row }))
            }
        }
    }

    pub(super) fn constant_of_shape(&mut self, node: &NodeProto) -> Made {
        let shape = self.required_constant(node, 0)?;
        let shape = lengths(shape.integers()?)?;
        let count = within_limits(&shape)?;
        let value = Attributes::of(node).tensor("value").transpose()?;
        let value = value.unwrap_or(ConstantTensor { shape: vec![1], data: Data::Single(vec![0.0]) });
        if value.data.len() != 1 {
            return Err(ImportError::malformed(format!(
                "attribute `value` has {} elements, expected 1",
                value.data.len()
            )));
        }
        Ok(Value::Constant(ConstantTensor { shape, data: value.data.picked(&vec![0; count]) }))
    }

    pub(super) fn shape(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let value = self.input(node, 0)?;
        let rank = value.shape().len() as i64;
        let (start, end) = (attributes.integer("start").unwrap_or(0), attributes.integer("end").unwrap_or(rank));
        let [start, end] =
            [start, end].map(|place| (if place < 0 { place + rank } else { place }).clamp(0, rank) as usize);
        let dims = value.shape().get(start..end).unwrap_or_default();
        Ok(Value::Constant(ConstantTensor::of_integers(dims.iter().map(|dim| *dim as i64).collect())))
    }

    /// Number of elements of a value.
    pub(super) fn size(&self, node: &NodeProto) -> Made {
        let count = self.input(node, 0)?.shape().iter().product::<usize>();
        Ok(Value::Constant(ConstantTensor { shape: Vec::new(), data: Data::Integer(vec![count as i64]) }))
    }

    pub(super) fn range(&mut self, node: &NodeProto) -> Made {
        let (start, limit, step) =
            (self.required_integer(node, 0)?, self.required_integer(node, 1)?, self.required_integer(node, 2)?);
        if step == 0 {
            return Err(ImportError::malformed("a step of 0"));
        }
        // steps up to the limit, rounded up; both signs are made positive
        let (way, step_size) = (i128::from(limit) - i128::from(start), i128::from(step));
        let count = (way * step_size.signum() + step_size.abs() - 1).div_euclid(step_size.abs()).max(0);
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        within_limits(&[count])?;
        let values = (0..count).map(|index| start.wrapping_add(step.wrapping_mul(index as i64))).collect();
        Ok(Value::Constant(ConstantTensor::of_integers(values)))
    }

    fn required_integer(&self, node: &NodeProto, place: usize) -> Result<i64, ImportError> {
        let tensor = self.required_constant(node, place)?;
        tensor.integers()?.first().copied().ok_or_else(|| empty_input(place))
    }
}

pub(super) fn constant(attributes: Attributes) -> Made {
    if let Some(tensor) = attributes.tensor("value") {
        return tensor.map(Value::Constant);
    }
    if let Some(value) = attributes.integer("value_int") {
        return Ok(Value::Constant(ConstantTensor { shape: Vec::new(), data: Data::Integer(vec![value]) }));
    }
    if let Some(values) = attributes.integers("value_ints") {
        return Ok(Value::Constant(ConstantTensor::of_integers(values.to_vec())));
    }
    let floats = attributes.numbers("value_floats")?.values;
    let (shape, values) = match floats.is_empty() {
        true => (Vec::new(), vec![single_value(attributes)?]),
        false => (vec![floats.len()], floats),
    };
    Ok(Value::Constant(ConstantTensor {
        shape,
        data: Data::Single(values.iter().map(|value| *value as f32).collect()),
    }))
}

fn single_value(attributes: Attributes) -> Result<f64, ImportError> {
    let value = attributes.float("value_float", f64::NAN);
    value.map_err(|_| ImportError::unsupported("no value of a known kind"))
}
