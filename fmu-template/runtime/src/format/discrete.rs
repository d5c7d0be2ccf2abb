//! The tensors of a discrete model.

use super::{
    OUTPUTS, Tensor, Views, bytes, elements,
    motion::{double, doubles},
    of_one, take,
};
use crate::{Discrete, FormatError, ScaledNetwork, map::expect_shape};
use safetensors::Dtype;

impl Discrete {
    /// Name, type, shape and content of each.
    pub(super) fn tensors(&self) -> Vec<Tensor> {
        let Self { counts, history, step, weights, constants, network } = self;
        let whole = |name: &str, values: &[usize]| -> Tensor {
            let values: Vec<u32> = values.iter().map(|value| *value as u32).collect();
            (name.into(), Dtype::U32, vec![values.len()], bytes(&values, u32::to_le_bytes))
        };
        let mut tensors = vec![
            whole("counts", counts),
            whole("history", history),
            double("sample.time", &[1], &[*step]),
            double("linear.weights", &[counts[2], self.width()], weights),
            double("linear.constants", &[constants.len()], constants),
        ];
        tensors.extend(network.iter().flat_map(|network| of_one(network, OUTPUTS)));
        tensors
    }

    pub(super) fn read(tensors: &mut Views, network: Option<ScaledNetwork>) -> Result<Self, FormatError> {
        let counts = whole::<3>(tensors, "counts")?;
        let history = whole::<2>(tensors, "history")?;
        let (step, shape) = doubles(tensors, "sample.time", 1)?;
        expect_shape("sample.time", &shape, &[1])?;
        let (weights, shape) = doubles(tensors, "linear.weights", 2)?;
        let (constants, _) = doubles(tensors, "linear.constants", 1)?;
        let discrete = Self { counts, history, step: step[0], weights, constants, network };
        expect_shape("linear.weights", &shape, &[counts[2], discrete.width()])?;
        Ok(discrete)
    }
}

fn whole<const N: usize>(tensors: &mut Views, name: &str) -> Result<[usize; N], FormatError> {
    let view = take(tensors, name, Dtype::U32, 1)?;
    expect_shape(name, view.shape(), &[N])?;
    let values = elements(view.data(), u32::from_le_bytes);
    Ok(std::array::from_fn(|index| values[index] as usize))
}
