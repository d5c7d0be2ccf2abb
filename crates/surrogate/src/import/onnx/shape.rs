//! Rows of numbers as tensors: the elements that one tensor takes from another.

use super::{ImportError, tensor::within_limits};

/// The shape that two shapes are broadcast to.
///
/// # Errors
/// An error if they do not fit each other, or if the result is too large.
pub fn broadcast(a: &[usize], b: &[usize]) -> Result<Vec<usize>, ImportError> {
    let rank = a.len().max(b.len());
    // missing dimensions, which are the first ones, are 1
    let [of_a, of_b] = [a, b].map(|shape| [vec![1; rank - shape.len()].as_slice(), shape].concat());
    let shape: Option<Vec<usize>> = of_a
        .into_iter()
        .zip(of_b)
        .map(|dims| match dims {
            (a, b) if a == b => Some(a),
            (1, other) | (other, 1) => Some(other),
            _ => None,
        })
        .collect();
    let shape =
        shape.ok_or_else(|| ImportError::malformed(format!("shapes {a:?} and {b:?} that do not fit each other")))?;
    within_limits(&shape)?;
    Ok(shape)
}

/// For each element of a tensor of the shape `to`, the element of `from` that it is after broadcasting.
pub fn broadcast_places(from: &[usize], to: &[usize]) -> Vec<usize> {
    let strides = strides(from);
    let missing = to.len() - from.len();
    places(to, |index| {
        let dims = index[missing..].iter().zip(from).zip(&strides);
        dims.map(|((index, dim), stride)| if *dim == 1 { 0 } else { index * stride }).sum()
    })
}

/// A function of the index for each element of a tensor of a shape.
pub fn places<T>(shape: &[usize], place: impl Fn(&[usize]) -> T) -> Vec<T> {
    let count = shape.iter().product();
    let mut index = vec![0; shape.len()];
    let mut found = Vec::with_capacity(count);
    for _ in 0..count {
        found.push(place(&index));
        for (index, dim) in index.iter_mut().zip(shape).rev() {
            *index += 1;
            if *index < *dim {
                break;
            }
            *index = 0;
        }
    }
    found
}

/// Distances of elements whose index differs by one along each axis.
pub fn strides(shape: &[usize]) -> Vec<usize> {
    let mut strides = vec![1; shape.len()];
    for place in (1..shape.len()).rev() {
        strides[place - 1] = strides[place] * shape[place];
    }
    strides
}

/// Position of an axis that may be counted from the end.
///
/// # Errors
/// An error if the tensor has no such axis.
pub fn axis(axis: i64, rank: usize) -> Result<usize, ImportError> {
    let place = if axis < 0 { axis + rank as i64 } else { axis };
    usize::try_from(place)
        .ok()
        .filter(|place| *place < rank)
        .ok_or_else(|| ImportError::malformed(format!("axis {axis} of a tensor of {rank} dimensions")))
}
