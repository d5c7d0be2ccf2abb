//! Tensors of the model file; `format` says what they are.

use crate::{FormatError, Numbers, check::expect_shape};
use safetensors::{Dtype, tensor::TensorView};
use std::{collections::HashMap, iter};

/// Name, type, shape and content.
pub(crate) type Tensor = (String, Dtype, Vec<usize>, Vec<u8>);

/// Tensors of a file that have not been read yet.
#[derive(Default)]
pub(crate) struct Views<'a> {
    tensors: HashMap<String, TensorView<'a>>,
    /// Part of each tensor that is read, and the number of parts, which is its leading dimension.
    part: Option<(usize, usize)>,
}

impl<'a> Views<'a> {
    pub(crate) fn insert(&mut self, name: String, view: TensorView<'a>) {
        self.tensors.insert(name, view);
    }

    pub(crate) fn contain(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Names of the tensors that have not been read.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Reads each of `count` parts of tensors that are [stacked].
    pub(crate) fn parts<T>(
        &mut self,
        count: usize,
        read: impl Fn(&mut Self) -> Result<T, FormatError>,
    ) -> Result<Vec<T>, FormatError> {
        let parts = (0..count).map(|part| {
            self.part = Some((part, count));
            read(self)
        });
        let parts = parts.collect();
        self.part = None;
        parts
    }

    /// The tensor, or the present part of it.
    fn take(&mut self, name: &str) -> Result<TensorView<'a>, FormatError> {
        let missing = || FormatError::MissingTensor { name: name.into() };
        let Some((part, count)) = self.part else { return self.tensors.remove(name).ok_or_else(missing) };
        let view = self.tensors.get(name).ok_or_else(missing)?;
        let (dtype, shape, data) = (view.dtype(), view.shape(), view.data());
        if shape.first() != Some(&count) {
            let expected = iter::once(count).chain(shape.iter().skip(1).copied()).collect();
            return Err(FormatError::Shape { name: name.into(), found: shape.to_vec(), expected });
        }
        let size = data.len() / count;
        let shape = shape[1..].to_vec();
        let of_part = TensorView::new(dtype, shape, &data[part * size..][..size]).map_err(FormatError::Container)?;
        if part + 1 == count {
            self.tensors.remove(name);
        }
        Ok(of_part)
    }
}

/// Name of a tensor. A separate function, since reading and checking code would otherwise be a tenth of the FMU's library.
#[inline(never)]
pub(crate) fn joined<const N: usize>(parts: [&str; N]) -> String {
    parts.concat()
}

/// Tensors whose leading dimension is the number of `parts`, which have the same names, types and shapes.
pub(crate) fn stacked(parts: impl Iterator<Item = Vec<Tensor>>) -> Vec<Tensor> {
    let mut count = 0;
    let all = parts.inspect(|_| count += 1).reduce(|mut all, part| {
        all.iter_mut().zip(part).for_each(|((.., bytes), (.., more))| bytes.extend(more));
        all
    });
    let mut all = all.unwrap_or_default();
    all.iter_mut().for_each(|(_, _, shape, _)| shape.insert(0, count));
    all
}

pub(crate) fn bytes<T: Copy, const N: usize>(values: &[T], to: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&value| to(value)).collect()
}

pub(crate) fn numbers(dtype: Dtype, bytes: &[u8]) -> Numbers {
    match dtype {
        Dtype::F64 => Numbers::Double(elements(bytes, f64::from_le_bytes)),
        _ => Numbers::Single(elements(bytes, f32::from_le_bytes)),
    }
}

#[inline(never)]
pub(crate) fn take<'a>(
    tensors: &mut Views<'a>,
    name: &str,
    expected: Dtype,
    dimensions: usize,
) -> Result<TensorView<'a>, FormatError> {
    take_one_of(tensors, name, &[expected], dimensions)
}

#[inline(never)]
pub(crate) fn take_one_of<'a>(
    tensors: &mut Views<'a>,
    name: &str,
    expected: &[Dtype],
    dimensions: usize,
) -> Result<TensorView<'a>, FormatError> {
    let view = tensors.take(name)?;
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

/// Takes a tensor of `count` whole numbers.
#[inline(never)]
pub(crate) fn counts(tensors: &mut Views, name: &str, count: usize) -> Result<Vec<u32>, FormatError> {
    let view = take(tensors, name, Dtype::U32, 1)?;
    expect_shape(name, view.shape(), &[count])?;
    Ok(elements(view.data(), u32::from_le_bytes))
}

/// Rows of whole numbers.
#[inline(never)]
pub(crate) fn whole_rows<const N: usize>(tensors: &mut Views, name: &str) -> Result<Vec<[u32; N]>, FormatError> {
    let view = take(tensors, name, Dtype::U32, 2)?;
    expect_shape(name, &view.shape()[1..], &[N])?;
    Ok(elements(view.data(), u32::from_le_bytes).as_chunks().0.to_vec())
}
