//! Tensors of the model file; `format` says what they are.

use crate::{FormatError, Numbers, check::expect_shape};
use safetensors::{
    Dtype,
    tensor::{Metadata, TensorInfo},
};
use std::iter;

/// Name, type, shape and content.
pub(crate) type Tensor = (String, Dtype, Vec<usize>, Vec<u8>);

/// Tensor of a file.
#[derive(Clone, Copy)]
pub(crate) struct TensorSlice<'a> {
    pub(crate) dtype: Dtype,
    pub(crate) shape: &'a [usize],
    pub(crate) data: &'a [u8],
}

impl<'a> TensorSlice<'a> {
    /// One of `count` equal parts of the content.
    fn part(&self, part: usize, count: usize) -> &'a [u8] {
        let size = self.data.len() / count;
        &self.data[part * size..][..size]
    }
}

/// Tensors of a file, of which each is read once.
pub(crate) struct Views<'a> {
    container: &'a Metadata,
    data: &'a [u8],
    /// Names of the tensors that were read.
    taken: Vec<String>,
    /// Number of parts of tensors of which the first is read, and the tensors.
    parts: Option<(usize, Vec<TensorSlice<'a>>)>,
}

impl<'a> Views<'a> {
    /// Tensors of a container with this content.
    pub(crate) fn new(container: &'a Metadata, data: &'a [u8]) -> Self {
        Self { container, data, taken: Vec::new(), parts: None }
    }

    pub(crate) fn contain(&self, name: &str) -> bool {
        self.container.info(name).is_some()
    }

    /// Returns true if a name begins with this.
    pub(crate) fn contain_any(&self, prefix: &str) -> bool {
        self.container.tensors().keys().any(|name| name.starts_with(prefix))
    }

    /// First name of a tensor that was not read.
    pub(crate) fn unread(&self) -> Option<String> {
        let all = self.container.tensors();
        // without the search, whose time would grow with the square of their number
        if all.len() == self.taken.len() {
            None
        } else {
            all.into_keys().filter(|name| !self.taken.contains(name)).min()
        }
    }

    /// Reads `count` parts of tensors that are [stacked]: the first by names, the others as the first, from their numbers in the same order.
    ///
    /// # Errors
    /// That of the first part, or [`FormatError::StepKinds`] if whole numbers, which tell kinds and sizes, differ.
    pub(crate) fn parts<T>(
        &mut self,
        count: usize,
        first: impl FnOnce(&mut Self) -> Result<T, FormatError>,
        with_numbers: impl Fn(&T, &mut dyn Iterator<Item = Numbers>) -> T,
    ) -> Result<Vec<T>, FormatError> {
        if count == 0 {
            return Ok(Vec::new());
        }
        self.parts = Some((count, Vec::new()));
        let first = first(self);
        let stacked = self.parts.take().map(|(_, stacked)| stacked).unwrap_or_default();
        let mut parts = vec![first?];
        for part in 1..count {
            if stacked.iter().any(|view| view.dtype == Dtype::U32 && view.part(part, count) != view.part(0, count)) {
                return Err(FormatError::StepKinds { instant: part });
            }
            let views = stacked.iter().filter(|view| view.dtype != Dtype::U32);
            parts.push(with_numbers(&parts[0], &mut views.map(|view| numbers(view.dtype, view.part(part, count)))));
        }
        Ok(parts)
    }

    /// The tensor, or the present part of it.
    fn take(&mut self, name: &str) -> Result<TensorSlice<'a>, FormatError> {
        let info = self.container.info(name).ok_or_else(|| FormatError::MissingTensor { name: name.into() })?;
        let TensorInfo { dtype, shape, data_offsets: (begin, end) } = info;
        let view = TensorSlice { dtype: *dtype, shape, data: &self.data[*begin..*end] };
        self.taken.push(name.into());
        let Some((count, stacked)) = &mut self.parts else { return Ok(view) };
        let TensorSlice { dtype, shape, .. } = view;
        if shape.first() != Some(count) {
            let expected = iter::once(*count).chain(shape.iter().skip(1).copied()).collect();
            return Err(FormatError::Shape { name: name.into(), found: shape.to_vec(), expected });
        }
        stacked.push(view);
        Ok(TensorSlice { dtype, shape: &shape[1..], data: view.part(0, *count) })
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
) -> Result<TensorSlice<'a>, FormatError> {
    take_one_of(tensors, name, &[expected], dimensions)
}

#[inline(never)]
pub(crate) fn take_one_of<'a>(
    tensors: &mut Views<'a>,
    name: &str,
    expected: &[Dtype],
    dimensions: usize,
) -> Result<TensorSlice<'a>, FormatError> {
    let view = tensors.take(name)?;
    if !expected.contains(&view.dtype) {
        let expected = expected.iter().map(|dtype| format!("{dtype:?}")).collect::<Vec<_>>().join(" or ");
        return Err(FormatError::Type { name: name.into(), found: format!("{:?}", view.dtype), expected });
    }
    if view.shape.len() != dimensions {
        let mut expected = view.shape.to_vec();
        expected.resize(dimensions, 1);
        return Err(FormatError::Shape { name: name.into(), found: view.shape.to_vec(), expected });
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
    expect_shape(name, view.shape, &[count])?;
    Ok(elements(view.data, u32::from_le_bytes))
}

/// Rows of whole numbers.
#[inline(never)]
pub(crate) fn whole_rows<const N: usize>(tensors: &mut Views, name: &str) -> Result<Vec<[u32; N]>, FormatError> {
    let view = take(tensors, name, Dtype::U32, 2)?;
    expect_shape(name, &view.shape[1..], &[N])?;
    Ok(elements(view.data, u32::from_le_bytes).as_chunks().0.to_vec())
}
