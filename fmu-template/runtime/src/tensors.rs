//! Tensors of the model file; `format` says what they are.

use crate::{FormatError, Numbers};
use safetensors::{Dtype, tensor::TensorView};
use std::collections::HashMap;

/// Name, type, shape and content.
pub(crate) type Tensor = (String, Dtype, Vec<usize>, Vec<u8>);

/// Tensors of a file that have not been read yet.
pub(crate) type Views<'a> = HashMap<String, TensorView<'a>>;

pub(crate) fn bytes<T: Copy, const N: usize>(values: &[T], to: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&value| to(value)).collect()
}

pub(crate) fn numbers(dtype: Dtype, bytes: &[u8]) -> Numbers {
    match dtype {
        Dtype::F64 => Numbers::Double(elements(bytes, f64::from_le_bytes)),
        _ => Numbers::Single(elements(bytes, f32::from_le_bytes)),
    }
}

pub(crate) fn take<'a>(
    tensors: &mut Views<'a>,
    name: &str,
    expected: Dtype,
    dimensions: usize,
) -> Result<TensorView<'a>, FormatError> {
    take_one_of(tensors, name, &[expected], dimensions)
}

pub(crate) fn take_one_of<'a>(
    tensors: &mut Views<'a>,
    name: &str,
    expected: &[Dtype],
    dimensions: usize,
) -> Result<TensorView<'a>, FormatError> {
    let view = tensors.remove(name).ok_or_else(|| FormatError::MissingTensor { name: name.into() })?;
    if !expected.contains(&view.dtype()) {
        let expected = expected.iter().map(|dtype| format!("{dtype:?}")).collect::<Vec<_>>().join(" or ");
        return Err(FormatError::Type { name: name.into(), found: format!("{:?}", view.dtype()), expected });
    }
    if view.shape().len() != dimensions {
        let mut expected = view.shape().to_vec();
        expected.resize(dimensions, 1);
        return Err(FormatError::Shape { name: name.into(), found: view.shape().to_vec(), expected });
    }
    Ok(view)
}

#[inline(never)]
pub(crate) fn elements<T, const N: usize>(bytes: &[u8], from: fn([u8; N]) -> T) -> Vec<T> {
    bytes.as_chunks::<N>().0.iter().map(|chunk| from(*chunk)).collect()
}
