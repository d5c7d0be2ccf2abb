//! Models that are only tensors by name, `.npz` of numpy or `.safetensors`: the interface says which are the layers.

use super::interface::{LayerOptions, ModelInterface};
use super::{ImportError, ImportPlace, Imported, builder::Builder};
use crate::{
    diagnostics::{Problems, names::expected_one_of},
    unpacking::ArchiveSize,
};
use metafmu_runtime::{Activation, Numbers, graph::Elementwise};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::{
    collections::BTreeMap,
    io::{Cursor, Read},
};
use zip::{ZipArchive, result::ZipError};

/// Tensors by name.
pub type Tensors = BTreeMap<String, NumericTensor>;

/// A tensor of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct NumericTensor {
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its numbers, row by row.
    pub numbers: Numbers,
}

/// Returns true if these bytes are an archive of numpy.
pub fn is_npz(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04")
}

/// Returns true if these bytes are a file of safetensors.
pub fn is_safetensors(bytes: &[u8]) -> bool {
    bytes.get(8) == Some(&b'{') && bytes[..8].ends_with(&[0, 0])
}

/// Message for a file that is an FMU, or a model file of metafmu: there is nothing to import.
pub fn made_already(bytes: &[u8]) -> Option<String> {
    let expected = "expected a third-party network: ONNX, .npz or .safetensors";
    if is_npz(bytes) {
        let archive = ZipArchive::new(Cursor::new(bytes)).ok()?;
        let is_fmu = archive.index_for_name("modelDescription.xml").is_some();
        return is_fmu.then(|| {
            format!(
                "is an FMU, {expected}; of one by metafmu `metafmu export` makes FMUs of other versions and platforms"
            )
        });
    }
    let (_, header) = is_safetensors(bytes).then(|| SafeTensors::read_metadata(bytes).ok()).flatten()?;
    let is_ours = header.metadata().as_ref().is_some_and(|entries| entries.contains_key("metafmu"));
    is_ours.then(|| format!("is a model file of metafmu already, {expected}; `metafmu export` makes an FMU of it"))
}

/// The tensors of an archive of numpy.
///
/// # Errors
/// An error for each file that is no array of numbers, or one for an archive that is damaged or too large.
pub fn read_npz(bytes: &[u8]) -> Result<Tensors, Vec<ImportError>> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(not_npz)?;
    let mut size = ArchiveSize { archive: bytes.len() as u64, entries: archive.len(), unpacked: 0 };
    for index in 0..archive.len() {
        size.unpacked = size.unpacked.saturating_add(archive.by_index_data(index).map_err(not_npz)?.size());
    }
    if let Some(problem) = size.problem() {
        return Err(ImportError::too_large(problem).into());
    }
    let (mut tensors, mut problems) = (Tensors::new(), Vec::new());
    for index in 0..archive.len() {
        // gives no more than the size that is declared
        let mut entry = archive.by_index(index).map_err(not_npz)?;
        let name = entry.name().map_err(not_npz)?;
        let name = name.strip_suffix(".npy").unwrap_or(name.as_ref()).to_owned();
        match read_entry(&mut entry) {
            Ok(_) if tensors.contains_key(&name) => {
                let error = ImportError::malformed("two entries of this name, expected one");
                problems.push(error.at(ImportPlace::Array(name)));
            }
            Ok(tensor) => drop(tensors.insert(name, tensor)),
            Err(error) => problems.push(error.at(ImportPlace::Array(name))),
        }
    }
    if problems.is_empty() { Ok(tensors) } else { Err(problems) }
}

/// The error of a file that cannot be read as an archive.
fn not_npz(error: ZipError) -> ImportError {
    ImportError::malformed(format!("not an archive of numpy (.npz): {error}"))
}

fn read_entry(entry: &mut impl Read) -> Result<NumericTensor, ImportError> {
    let mut content = Vec::new();
    entry.read_to_end(&mut content).map_err(|error| ImportError::malformed(error.to_string()))?;
    read_npy(&content)
}

fn no_array() -> ImportError {
    ImportError::malformed("not an array of numpy")
}

/// An array of numpy (format 1.0 to 3.0): a header that is a dictionary of Python, then the numbers.
fn read_npy(bytes: &[u8]) -> Result<NumericTensor, ImportError> {
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or_else(no_array)?;
    let (version, rest) = rest.split_at_checked(2).ok_or_else(no_array)?;
    let width = if version[0] == 1 { 2 } else { 4 };
    let (length, rest) = rest.split_at_checked(width).ok_or_else(no_array)?;
    let length = length.iter().rev().fold(0usize, |length, byte| length << 8 | usize::from(*byte));
    let (header, data) = rest.split_at_checked(length).ok_or_else(no_array)?;
    let header = String::from_utf8_lossy(header);
    let kind = header_value(&header, "descr").and_then(|rest| rest.split('\'').nth(1)).ok_or_else(no_array)?;
    let is_fortran = header_value(&header, "fortran_order").is_some_and(|rest| rest.starts_with("True"));
    let dims =
        header_value(&header, "shape").and_then(|rest| rest.strip_prefix('(')?.split_once(')')).ok_or_else(no_array)?.0;
    let dims = dims.split(',').map(str::trim).filter(|dim| !dim.is_empty());
    let shape: Vec<usize> = dims.map(|dim| dim.parse().map_err(|_| no_array())).collect::<Result<_, _>>()?;
    let numbers = match kind {
        "<f4" => Numbers::Single(data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()),
        "<f8" => Numbers::Double(data.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()),
        other => {
            let message = format!("elements of type {other:?}, expected \"<f4\" or \"<f8\"");
            return Err(ImportError::unsupported(message));
        }
    };
    let tensor = checked(shape, numbers)?;
    match (is_fortran, tensor.shape.as_slice()) {
        (true, &[rows, columns]) => {
            let turned = NumericTensor { shape: vec![columns, rows], numbers: tensor.numbers };
            Ok(NumericTensor { shape: vec![rows, columns], numbers: transposed(&turned) })
        }
        _ => Ok(tensor),
    }
}

/// Text of the header from the value of a key on.
fn header_value<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start())
}

/// The tensors of a file of safetensors.
///
/// # Errors
/// An error for each tensor of another type, of the wrong length or with NaN, or one for a file that is damaged.
pub fn read_safetensors(bytes: &[u8]) -> Result<Tensors, Vec<ImportError>> {
    let file = SafeTensors::deserialize(bytes)
        .map_err(|error| ImportError::malformed(format!("not safetensors, or cut short: {error}")))?;
    let (mut tensors, mut problems) = (Tensors::new(), Vec::new());
    for (name, view) in file.tensors() {
        match read_view(&view) {
            Ok(tensor) => drop(tensors.insert(name, tensor)),
            Err(error) => problems.push(error.at(ImportPlace::Array(name))),
        }
    }
    if problems.is_empty() { Ok(tensors) } else { Err(problems) }
}

fn read_view(view: &TensorView) -> Result<NumericTensor, ImportError> {
    let data = view.data();
    let numbers = match view.dtype() {
        Dtype::F32 => Numbers::Single(data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()),
        Dtype::F64 => Numbers::Double(data.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()),
        other => {
            return Err(ImportError::unsupported(format!("elements of type {other:?}, expected F32 or F64")));
        }
    };
    checked(view.shape().to_vec(), numbers)
}

fn checked(shape: Vec<usize>, numbers: Numbers) -> Result<NumericTensor, ImportError> {
    let count = shape.iter().try_fold(1usize, |count, dim| count.checked_mul(*dim));
    if count != Some(numbers.len()) {
        return Err(ImportError::malformed(format!("{} numbers of a shape {shape:?}", numbers.len())));
    }
    let wrong = numbers.iter().position(|number| !number.is_finite());
    match wrong {
        Some(place) => {
            let message = format!("element {place} is {}, expected a finite number", numbers.get(place));
            Err(ImportError::not_finite(message))
        }
        None => Ok(NumericTensor { shape, numbers }),
    }
}

/// The network of an interface's layers.
///
/// # Errors
/// [`crate::Error::Study`] with the keys of the interface that do not fit the tensors.
pub fn layers(tensors: &Tensors, interface: &ModelInterface) -> crate::Result<Imported> {
    let mut problems = Problems::default();
    if interface.layers.is_empty() {
        let known: Vec<&str> = tensors.keys().map(String::as_str).collect();
        let message = format!("no layers, expected them of the tensors {}", crate::diagnostics::names::listed(&known));
        problems.add("layers", message);
    }
    let (mut builder, mut value): (Option<Builder>, usize) = (None, 0);
    let (mut width, mut is_single) = (0, true);
    for (number, options) in interface.layers.iter().enumerate() {
        let key = format!("layers[{number}]");
        let Some((weight, bias)) = layer(tensors, options, (number > 0).then_some(width), &key, &mut problems) else {
            break;
        };
        let inputs = weight.len() / bias.len();
        is_single &= weight.as_single().is_some();
        width = bias.len();
        let builder = builder.get_or_insert_with(|| Builder::new(inputs));
        let Some((function, parameters)) = activation(&options.activation) else {
            let known: Vec<&str> = activations().map(|(name, ..)| name).collect();
            let message = format!("\"{}\", {}", options.activation, expected_one_of(&options.activation, &known));
            problems.add(format!("{key}.activation"), message);
            break;
        };
        let added = builder.affine(value, weight, bias);
        match added.and_then(|affine| builder.elementwise(affine, function, parameters)) {
            Ok(made) => value = made,
            Err(error) => {
                problems.add(key, error.to_string());
                break;
            }
        }
    }
    interface.refuse(problems)?;
    let builder = builder.unwrap_or_else(|| Builder::new(1));
    Ok(Imported {
        stacked: Vec::new(),
        inputs: (0..builder.width(0)).map(|place| format!("x[{place}]")).collect(),
        outputs: (0..width).map(|place| format!("y[{place}]")).collect(),
        columns: (0..width).map(|column| [value as u32, column as u32]).collect(),
        builder,
        recurrences: Vec::new(),
        is_single,
        producer: String::new(),
    })
}

/// `W` with a row for each output, and `b`.
fn layer(
    tensors: &Tensors,
    options: &LayerOptions,
    before: Option<usize>,
    key: &str,
    problems: &mut Problems,
) -> Option<(Numbers, Numbers)> {
    let weight = tensor_of_layer(tensors, &options.weight, 2, &format!("{key}.weight"), problems)?;
    let bias = match &options.bias {
        Some(bias) => Some(tensor_of_layer(tensors, bias, 1, &format!("{key}.bias"), problems)?),
        None => None,
    };
    let (rows, columns) = (weight.shape[0], weight.shape[1]);
    // the known sizes decide whether rows are outputs
    let [plain, turned] = [[rows, columns], [columns, rows]].map(|[outputs, inputs]| {
        bias.is_none_or(|bias| bias.numbers.len() == outputs) && before.is_none_or(|before| before == inputs)
    });
    let is_transposed = match (options.transposed, plain, turned) {
        (Some(transposed), plain, turned) if (transposed && turned) || (!transposed && plain) => transposed,
        (None, true, false) => false,
        (None, false, true) => true,
        (None, true, true) if rows == columns || (bias.is_none() && before.is_none()) => {
            let message =
                "may be either way round: expected `transposed = true` if its columns are outputs, else false";
            problems
                .add(format!("{key}.weight"), format!("`{}` of shape [{rows}, {columns}] {message}", options.weight));
            return None;
        }
        (None, true, true) => false,
        _ => {
            let bias = bias.map_or("none".into(), |bias| bias.numbers.len().to_string());
            let before = before.map_or(String::new(), |before| format!(", and the layer before has {before} outputs"));
            let message =
                format!("`{}` has the shape [{rows}, {columns}], its bias {bias} numbers{before}", options.weight);
            problems.add(format!("{key}.weight"), message);
            return None;
        }
    };
    let outputs = if is_transposed { columns } else { rows };
    let weight_numbers = if is_transposed { transposed(weight) } else { weight.numbers.clone() };
    let bias = match (bias, &weight_numbers) {
        (Some(bias), _) => bias.numbers.clone(),
        (None, Numbers::Single(_)) => vec![0.0f32; outputs].into(),
        (None, Numbers::Double(_)) => vec![0.0f64; outputs].into(),
    };
    Some((weight_numbers, bias))
}

/// The tensor of a name with this number of dimensions; otherwise a problem of the key.
fn tensor_of_layer<'a>(
    tensors: &'a Tensors,
    name: &str,
    dimensions: usize,
    key: &str,
    problems: &mut Problems,
) -> Option<&'a NumericTensor> {
    let Some(tensor) = tensors.get(name) else {
        let known: Vec<&str> = tensors.keys().map(String::as_str).collect();
        problems.add(key, format!("no tensor `{name}`, {}", expected_one_of(name, &known)));
        return None;
    };
    let expected = match (tensor.shape.len() == dimensions, dimensions) {
        (true, _) if !tensor.numbers.is_empty() => return Some(tensor),
        (true, _) => "at least one number",
        (false, 1) => "1 dimension",
        (false, _) => "2 dimensions",
    };
    problems.add(key, format!("`{name}` has the shape {:?}, expected {expected}", tensor.shape));
    None
}

/// The numbers of a matrix column by column.
fn transposed(tensor: &NumericTensor) -> Numbers {
    let (rows, columns) = (tensor.shape[0], tensor.shape[1]);
    let places = (0..columns).flat_map(move |column| (0..rows).map(move |row| row * columns + column));
    match &tensor.numbers {
        Numbers::Single(values) => places.map(|place| values[place]).collect::<Vec<f32>>().into(),
        Numbers::Double(values) => places.map(|place| values[place]).collect::<Vec<f64>>().into(),
    }
}

/// Functions of layers besides the activations that metafmu trains, with their parameters.
const OTHERS: [(&str, Elementwise, &[f64]); 5] = [
    ("gelu-exact", Elementwise::GeluExact, &[]),
    ("leaky-relu", Elementwise::LeakyRelu, &[0.01]),
    ("elu", Elementwise::Elu, &[1.0]),
    ("softplus", Elementwise::Softplus, &[]),
    ("softsign", Elementwise::Softsign, &[]),
];

/// Names, functions and parameters of all that `activation` may be.
fn activations() -> impl Iterator<Item = (&'static str, Elementwise, &'static [f64])> {
    let trained =
        Activation::ALL.map(|activation| (activation.key(), Elementwise::Activation(activation), [].as_slice()));
    trained.into_iter().chain(OTHERS)
}

fn activation(name: &str) -> Option<(Elementwise, Vec<f64>)> {
    let (_, function, parameters) = activations().find(|(known, ..)| *known == name)?;
    Some((function, parameters.to_vec()))
}
