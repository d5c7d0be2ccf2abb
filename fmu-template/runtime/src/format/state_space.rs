//! The tensors of a state space.

use super::{
    Tensor, Views, bytes, elements,
    motion::{columns, dictionary, factors, integration, of_dictionary, of_integration},
    of_map, take,
};
use crate::{FormatError, Given, Map, StateSpace, map::expect_shape};
use safetensors::Dtype;

impl StateSpace {
    /// Name, type, shape and content of each.
    pub(super) fn tensors(&self) -> Vec<Tensor> {
        let Self { counts, functions, map, results, integration } = self;
        let whole = |name: &str, shape: &[usize], values: &[u32]| -> Tensor {
            (name.into(), Dtype::U32, shape.into(), bytes(values, u32::to_le_bytes))
        };
        let pair = |given: &Given| match *given {
            Given::State(state) => [0, state as u32],
            Given::Function(function) => [1, function as u32],
        };
        let given: Vec<u32> = results.iter().flat_map(pair).collect();
        let mut tensors = vec![
            whole("counts", &[counts.len()], &counts.map(|count| count as u32)),
            columns(functions),
            whole("results.given", &[results.len(), 2], &given),
        ];
        tensors.extend(of_integration(*integration));
        tensors.extend(of_dictionary("functions", functions));
        tensors.extend(map.iter().flat_map(of_map));
        tensors
    }

    pub(super) fn read(tensors: &mut Views, map: Option<Map>) -> Result<Self, FormatError> {
        let factors = factors(tensors)?;
        let functions = dictionary(tensors, "functions", &factors)?;
        let counts = take(tensors, "counts", Dtype::U32, 1)?;
        expect_shape("counts", counts.shape(), &[3])?;
        let counts = elements(counts.data(), u32::from_le_bytes);
        let given = take(tensors, "results.given", Dtype::U32, 2)?;
        expect_shape("results.given", &given.shape()[1..], &[2])?;
        let given = elements(given.data(), u32::from_le_bytes);
        let results = given.as_chunks::<2>().0.iter().enumerate().map(|(index, &[kind, place])| match kind {
            0 => Ok(Given::State(place as usize)),
            1 => Ok(Given::Function(place as usize)),
            found => Err(FormatError::Unknown { name: "results.given".into(), index: 2 * index, found }),
        });
        Ok(Self {
            counts: std::array::from_fn(|index| counts[index] as usize),
            functions,
            map,
            results: results.collect::<Result<_, _>>()?,
            integration: integration(tensors)?,
        })
    }
}
