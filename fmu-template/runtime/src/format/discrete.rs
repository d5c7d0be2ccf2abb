//! The tensors of a discrete model.

use super::{
    Tensor, Views, bytes, elements,
    motion::{double, doubles},
    of_map, take,
};
use crate::{Discrete, FormatError, Map, Support, map::expect_shape};
use safetensors::Dtype;

impl Discrete {
    /// Name, type, shape and content of each.
    pub(super) fn tensors(&self) -> Vec<Tensor> {
        let Self { counts, hidden, history, step, weights, constants, map, support } = self;
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
        if let Some(Support { ranges, samples }) = support {
            tensors.push(double("support.ranges", &[ranges.len(), 2], ranges.as_flattened()));
            tensors.push(double("support.samples", &[1], &[*samples]));
        }
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
        let support = support(tensors)?;
        let discrete = Self { counts, hidden, history, step: step[0], weights, constants, map, support };
        if !shape.is_empty() {
            expect_shape("linear.weights", &shape, &[discrete.numbers(), discrete.width()])?;
        }
        Ok(discrete)
    }
}

/// The support, if there is one.
fn support(tensors: &mut Views) -> Result<Option<Support>, FormatError> {
    if !tensors.contains_key("support.ranges") {
        return Ok(None);
    }
    let (ranges, shape) = doubles(tensors, "support.ranges", 2)?;
    expect_shape("support.ranges", &shape, &[shape[0], 2])?;
    let (samples, shape) = doubles(tensors, "support.samples", 1)?;
    expect_shape("support.samples", &shape, &[1])?;
    Ok(Some(Support { ranges: ranges.as_chunks().0.to_vec(), samples: samples[0] }))
}

fn whole<const N: usize>(tensors: &mut Views, name: &str) -> Result<[usize; N], FormatError> {
    let view = take(tensors, name, Dtype::U32, 1)?;
    expect_shape(name, view.shape(), &[N])?;
    let values = elements(view.data(), u32::from_le_bytes);
    Ok(std::array::from_fn(|index| values[index] as usize))
}
