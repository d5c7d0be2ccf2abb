//! The tensors of a discrete model.

use super::{
    Tensor, Views, bytes, elements,
    motion::{double, doubles},
    of_map, take,
};
use crate::{Discrete, FormatError, Map, map::expect_shape};
use safetensors::Dtype;

impl Discrete {
    /// Name, type, shape and content of each.
    pub(super) fn tensors(&self) -> Vec<Tensor> {
        let Self { counts, hidden, history, step, weights, constants, map } = self;
        let whole = |name: &str, values: &[usize]| -> Tensor {
            let values: Vec<u32> = values.iter().map(|value| *value as u32).collect();
            (name.into(), Dtype::U32, vec![values.len()], bytes(&values, u32::to_le_bytes))
        };
        let mut tensors = vec![
            whole("counts", counts),
            whole("history", history),
            double("sample.time", &[1], &[*step]),
            double("linear.constants", &[constants.len()], constants),
        ];
        if !weights.is_empty() {
            tensors.push(double("linear.weights", &[constants.len(), self.width()], weights));
        }
        if !hidden.is_empty() {
            tensors.push(double("hidden.start", &[hidden.len()], hidden));
        }
        tensors.extend(map.iter().flat_map(of_map));
        tensors
    }

    pub(super) fn read(tensors: &mut Views, map: Option<Map>) -> Result<Self, FormatError> {
        let counts = whole::<3>(tensors, "counts")?;
        let history = whole::<2>(tensors, "history")?;
        let (step, shape) = doubles(tensors, "sample.time", 1)?;
        expect_shape("sample.time", &shape, &[1])?;
        let (constants, _) = doubles(tensors, "linear.constants", 1)?;
        let mut given = |name: &str, dimensions| match tensors.contains_key(name) {
            true => doubles(tensors, name, dimensions).map(Some),
            false => Ok(None),
        };
        let (weights, hidden) = (given("linear.weights", 2)?, given("hidden.start", 1)?);
        let (weights, shape) = weights.unwrap_or_default();
        let hidden = hidden.unwrap_or_default().0;
        let discrete = Self { counts, hidden, history, step: step[0], weights, constants, map };
        if !shape.is_empty() {
            expect_shape("linear.weights", &shape, &[discrete.numbers(), discrete.width()])?;
        }
        Ok(discrete)
    }
}

fn whole<const N: usize>(tensors: &mut Views, name: &str) -> Result<[usize; N], FormatError> {
    let view = take(tensors, name, Dtype::U32, 1)?;
    expect_shape(name, view.shape(), &[N])?;
    let values = elements(view.data(), u32::from_le_bytes);
    Ok(std::array::from_fn(|index| values[index] as usize))
}
