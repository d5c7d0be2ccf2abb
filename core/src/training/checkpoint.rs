//! The state of a training as bytes: a safetensors container.
//!
//! | tensor | type | |
//! |---|---|---|
//! | `parameters`, `mean`, `square`, ... | F32 | the trainer's state, in the layout it has in memory |
//! | `best` | F32 | parameters of the best network so far |
//! | `history` | F64 `[epochs, 6]` | the fields of [`EpochRecord`] |
//!
//! The container's metadata has one entry, `metafmu_training`: the JSON text of [`Header`]. Among that is the SHA-256 of all
//! bytes of the file, those of the digest itself taken as zeros: any change is noticed.

use super::{EpochRecord, TrainingError};
use crate::{files, study::TrainingOptions};
use metafmu_runtime::Activation;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::ops::Range;

pub(super) const FORMAT: u32 = 3;

const HEADER_KEY: &str = "metafmu_training";

/// Header of a checkpoint: the training that it belongs to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Header {
    pub(super) format: u32,
    pub(super) options: TrainingOptions,
    pub(super) seed: u64,
    pub(super) sizes: Vec<usize>,
    pub(super) activation: Activation,
    /// For training and for validation.
    pub(super) rows: [usize; 2],
    /// [`TrainingRows::digest`](super::TrainingRows::digest) of both, as text: JSON's numbers are not that long
    /// everywhere.
    pub(super) digests: [String; 2],
    /// Steps of the optimizer.
    pub(super) steps: u64,
    pub(super) best_epoch: usize,
    /// Processor time so far.
    pub(super) processor_seconds: f64,
    /// Hexadecimal digits of the SHA-256; [`NO_DIGEST`] until there is one.
    pub(super) digest: String,
}

/// In place of a digest.
pub(super) const NO_DIGEST: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// Format of a checkpoint: the key that all versions have.
#[derive(Deserialize)]
struct CheckpointFormat {
    format: u32,
}

/// # Errors
/// [`TrainingError::Checkpoint`]; not expected to happen.
pub(super) fn write(
    header: &Header,
    state: &[(String, &mut [f32])],
    best: &[f32],
    history: &[EpochRecord],
) -> Result<Vec<u8>, TrainingError> {
    let text = serde_json::to_string(header).map_err(damaged)?;
    let mut tensors: Vec<(&str, Dtype, Vec<usize>, Vec<u8>)> =
        state.iter().map(|(name, values)| (name.as_str(), Dtype::F32, vec![values.len()], bytes_of(values))).collect();
    tensors.push(("best", Dtype::F32, vec![best.len()], bytes_of(best)));
    let rows = history.iter().flat_map(|record| {
        let EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, best } = *record;
        [epoch as f64, train_loss, validation_loss, learning_rate, seconds, f64::from(u8::from(best))]
    });
    let bytes = rows.flat_map(f64::to_le_bytes).collect();
    tensors.push(("history", Dtype::F64, vec![history.len(), 6], bytes));
    let views: Vec<(&str, TensorView)> = tensors
        .iter()
        .map(|(name, dtype, shape, bytes)| Ok((*name, TensorView::new(*dtype, shape.clone(), bytes)?)))
        .collect::<Result<_, safetensors::SafeTensorError>>()
        .map_err(damaged)?;
    let metadata = [(HEADER_KEY.to_owned(), text)].into_iter().collect();
    let mut bytes = safetensors::serialize(views, Some(metadata)).map_err(damaged)?;
    let (digest, range) = content_digest(&bytes, NO_DIGEST)?;
    bytes[range].copy_from_slice(digest.as_bytes());
    Ok(bytes)
}

/// The digest of a container that says `noted`, and its position.
fn content_digest(bytes: &[u8], noted: &str) -> Result<(String, Range<usize>), TrainingError> {
    let begin = bytes.windows(NO_DIGEST.len()).position(|text| text == noted.as_bytes());
    let begin = begin.ok_or_else(|| damaged("it has no digest"))?;
    let range = begin..begin + NO_DIGEST.len();
    let mut hash = Sha256::new_with_prefix(&bytes[..range.start]);
    hash.update(NO_DIGEST);
    hash.update(&bytes[range.end..]);
    Ok((files::digits(hash), range))
}

/// Fills the state and the best parameters; returns the header, to be compared, and the history.
///
/// # Errors
/// [`TrainingError::Checkpoint`] if the container is damaged or its tensors are not these.
pub(super) fn read(
    bytes: &[u8],
    state: &mut [(String, &mut [f32])],
    best: &mut [f32],
) -> Result<(Header, Vec<EpochRecord>), TrainingError> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let text = metadata.metadata().as_ref().and_then(|entries| entries.get(HEADER_KEY));
    let text = text.ok_or_else(|| damaged("it has no header"))?;
    let CheckpointFormat { format } = serde_json::from_str(text).map_err(damaged)?;
    if format != FORMAT {
        return Err(damaged(format!("it has format {format}, expected {FORMAT}: another version of metafmu wrote it")));
    }
    let header: Header = serde_json::from_str(text).map_err(damaged)?;
    if content_digest(bytes, &header.digest)?.0 != header.digest {
        return Err(damaged("its content is not what was written: it was changed or damaged"));
    }
    let container = SafeTensors::deserialize(bytes).map_err(damaged)?;
    if container.len() != state.len() + 2 {
        return Err(damaged(format!("{} tensors, expected {}", container.len(), state.len() + 2)));
    }
    let best = [("best", best)];
    for (name, values) in state.iter_mut().map(|(name, values)| (name.as_str(), &mut **values)).chain(best) {
        let tensor = container.tensor(name).map_err(damaged)?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != [values.len()] {
            return Err(damaged(format!("tensor `{name}` is not {} numbers", values.len())));
        }
        for (value, bytes) in values.iter_mut().zip(tensor.data().as_chunks().0) {
            *value = f32::from_le_bytes(*bytes);
        }
    }
    let history = container.tensor("history").map_err(damaged)?;
    if history.dtype() != Dtype::F64 || history.shape().len() != 2 || history.shape()[1] != 6 {
        return Err(damaged("tensor `history` has not six columns of numbers"));
    }
    let numbers: Vec<f64> = history.data().as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    let rows = numbers.as_chunks().0.iter();
    let records = rows.map(|&[epoch, train_loss, validation_loss, learning_rate, seconds, best]| EpochRecord {
        epoch: epoch as usize,
        train_loss,
        validation_loss,
        learning_rate,
        seconds,
        best: best > 0.0,
    });
    Ok((header, records.collect()))
}

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn damaged(problem: impl ToString) -> TrainingError {
    TrainingError::Checkpoint { problem: problem.to_string() }
}
