//! Constants of an ONNX file: initializers, attributes, and results computed from them.

use super::{
    ImportError,
    proto::{BOOL, DOUBLE, FLOAT, INT32, INT64, TensorProto, type_name},
};
use crate::{import::builder::MAX_WEIGHTS, reading};
use std::{
    io::{self, Read, Seek, SeekFrom},
    path::{Component, Path},
};

/// Largest number of elements of a tensor, and of all constants that nodes make together: a file of a few kilobytes
/// must not request gigabytes. No more weights fit into a graph.
pub const MAX_ELEMENTS: usize = MAX_WEIGHTS;

/// Dimensions a tensor may have.
const MAX_DIMENSIONS: usize = 16;

/// A constant tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct ConstantTensor {
    /// Its dimensions; of a single number there are none.
    pub shape: Vec<usize>,
    /// Its numbers, row by row.
    pub data: Data,
}

/// Numbers of one type.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    /// Single precision.
    Single(Vec<f32>),
    /// Double precision.
    Double(Vec<f64>),
    /// Whole numbers and truth values.
    Integer(Vec<i64>),
}

impl Data {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Single(values) => values.len(),
            Self::Double(values) => values.len(),
            Self::Integer(values) => values.len(),
        }
    }

    /// Elements at some places.
    pub fn picked(&self, places: &[usize]) -> Self {
        match self {
            Self::Single(values) => Self::Single(places.iter().map(|place| values[*place]).collect()),
            Self::Double(values) => Self::Double(places.iter().map(|place| values[*place]).collect()),
            Self::Integer(values) => Self::Integer(places.iter().map(|place| values[*place]).collect()),
        }
    }

    /// All of them in double precision.
    pub fn doubles(&self) -> Vec<f64> {
        match self {
            Self::Single(values) => values.iter().map(|value| f64::from(*value)).collect(),
            Self::Double(values) => values.clone(),
            Self::Integer(values) => values.iter().map(|value| *value as f64).collect(),
        }
    }
}

impl ConstantTensor {
    /// Whole numbers in one dimension.
    pub fn of_integers(values: Vec<i64>) -> Self {
        Self { shape: vec![values.len()], data: Data::Integer(values) }
    }

    /// Numbers of a type like that of `like`.
    pub fn like(like: &Data, shape: Vec<usize>, values: Vec<f64>) -> Self {
        let data = match like {
            Data::Single(_) => Data::Single(values.into_iter().map(|value| value as f32).collect()),
            Data::Double(_) => Data::Double(values),
            Data::Integer(_) => Data::Integer(values.into_iter().map(|value| value as i64).collect()),
        };
        Self { shape, data }
    }

    /// The whole numbers.
    ///
    /// # Errors
    /// [`ImportCause::Unsupported`](crate::import::ImportCause): it has others.
    pub fn integers(&self) -> Result<&[i64], ImportError> {
        match &self.data {
            Data::Integer(values) => Ok(values),
            _ => Err(ImportError::unsupported("a constant of real numbers, expected whole ones")),
        }
    }

    /// Reads a constant; `folder`: that of the model, where its external data are, if they may be read.
    ///
    /// # Errors
    /// An error of its type, its shape or its data.
    pub fn read(proto: &TensorProto, folder: Option<&Path>) -> Result<Self, ImportError> {
        let shape = shape(&proto.dims)?;
        let count = shape.iter().product();
        let external;
        let raw = match proto.data_location {
            0 => &proto.raw_data,
            _ => {
                external = external_data(proto, folder)?;
                &external
            }
        };
        let data = match proto.data_type {
            FLOAT => Data::Single(numbers(raw, &proto.float_data, count, f32::from_le_bytes)?),
            DOUBLE => Data::Double(numbers(raw, &proto.double_data, count, f64::from_le_bytes)?),
            INT64 => Data::Integer(numbers(raw, &proto.int64_data, count, i64::from_le_bytes)?),
            INT32 => {
                let values = numbers(raw, &proto.int32_data, count, i32::from_le_bytes)?;
                Data::Integer(values.into_iter().map(i64::from).collect())
            }
            BOOL => {
                let given: Vec<u8> = proto.int32_data.iter().map(|value| u8::from(*value != 0)).collect();
                let values = numbers(raw, &given, count, u8::from_le_bytes)?;
                Data::Integer(values.into_iter().map(i64::from).collect())
            }
            other => {
                return Err(ImportError::unsupported(format!(
                    "elements of type {}, expected float, double, int64, int32 or bool",
                    type_name(other)
                )));
            }
        };
        let is_finite = match &data {
            Data::Single(values) => values.iter().all(|value| value.is_finite()),
            Data::Double(values) => values.iter().all(|value| value.is_finite()),
            Data::Integer(_) => true,
        };
        if is_finite { Ok(Self { shape, data }) } else { Err(ImportError::not_finite("a number is not finite")) }
    }
}

/// The dimensions of a tensor, if it is not too large.
fn shape(dims: &[i64]) -> Result<Vec<usize>, ImportError> {
    if dims.len() > MAX_DIMENSIONS {
        return Err(ImportError::too_large(format!(
            "{} dimensions ({}, ...), expected at most {MAX_DIMENSIONS}",
            dims.len(),
            joined(&dims[..MAX_DIMENSIONS])
        )));
    }
    let shape: Option<Vec<usize>> = dims.iter().map(|dim| usize::try_from(*dim).ok()).collect();
    let shape = shape.ok_or_else(|| ImportError::malformed(format!("a negative dimension among {}", joined(dims))))?;
    within_limits(&shape)?;
    Ok(shape)
}

fn joined(dims: &[i64]) -> String {
    dims.iter().map(i64::to_string).collect::<Vec<_>>().join(", ")
}

/// Number of elements of a tensor of this shape; an error if it is too large.
pub fn within_limits(shape: &[usize]) -> Result<usize, ImportError> {
    // where one dimension is 0, the others still have indices
    let indices = shape.iter().try_fold(1usize, |product, dim| product.checked_mul((*dim).max(1)));
    match indices {
        Some(indices) if indices <= MAX_ELEMENTS => Ok(if shape.contains(&0) { 0 } else { indices }),
        _ => Err(ImportError::too_large(format!("a shape of {shape:?}, expected at most {MAX_ELEMENTS} numbers"))),
    }
}

fn numbers<T: Copy, const N: usize>(
    raw: &[u8],
    given: &[T],
    count: usize,
    from: fn([u8; N]) -> T,
) -> Result<Vec<T>, ImportError> {
    let (values, rest) = match raw {
        [] => (given.to_vec(), 0),
        raw => {
            let (chunks, rest) = raw.as_chunks::<N>();
            (chunks.iter().map(|chunk| from(*chunk)).collect(), rest.len())
        }
    };
    if values.len() == count && rest == 0 {
        return Ok(values);
    }
    Err(ImportError::malformed(format!("{} elements of data, its shape has {count}", values.len())))
}

/// The part of another file, which must be in the model's folder.
fn external_data(proto: &TensorProto, folder: Option<&Path>) -> Result<Vec<u8>, ImportError> {
    let folder = folder.ok_or_else(|| ImportError::unreadable("external data of a model that is not a file"))?;
    let location = external_entry(proto, "location");
    let location = location.ok_or_else(|| ImportError::malformed("external data without a `location`"))?;
    let relative = Path::new(location);
    if relative.components().any(|component| !matches!(component, Component::Normal(_) | Component::CurDir)) {
        return Err(outside(location));
    }
    let unreadable = |error: io::Error| ImportError::unreadable(format!("external data in `{location}`: {error}"));
    let path = folder.join(relative).canonicalize().map_err(unreadable)?;
    // a link may lead elsewhere
    if !path.starts_with(folder.canonicalize().map_err(unreadable)?) {
        return Err(outside(location));
    }
    let mut file = reading::open(&path).map_err(unreadable)?;
    let size = file.metadata().map_err(unreadable)?.len();
    let offset = external_number(proto, "offset")?.unwrap_or(0);
    let length = external_number(proto, "length")?.unwrap_or(size.saturating_sub(offset));
    if offset.checked_add(length).is_none_or(|end| end > size) {
        return Err(ImportError::malformed(format!(
            "external data in `{location}` from byte {offset}, {length} bytes, but the file has {size}"
        )));
    }
    if length > 8 * MAX_ELEMENTS as u64 {
        let message = format!("external data in `{location}`: {length} bytes, expected at most {}", 8 * MAX_ELEMENTS);
        return Err(ImportError::too_large(message));
    }
    file.seek(SeekFrom::Start(offset)).map_err(unreadable)?;
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).map_err(unreadable)?;
    Ok(bytes)
}

fn outside(location: &str) -> ImportError {
    let message = format!("external data in `{location}`, expected a file in the folder of the model");
    ImportError::unreadable(message)
}

fn external_entry<'a>(proto: &'a TensorProto, key: &str) -> Option<&'a str> {
    proto.external_data.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str())
}

fn external_number(proto: &TensorProto, key: &str) -> Result<Option<u64>, ImportError> {
    let Some(text) = external_entry(proto, key) else { return Ok(None) };
    let number = text.parse().map_err(|_| {
        let message = format!("external data with `{key}` {text:?}, expected a number");
        ImportError::malformed(message)
    });
    number.map(Some)
}
