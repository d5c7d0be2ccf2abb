//! Runs of a sampling that is not finished: after a crash, a kill or Ctrl-C the next sampling of the study continues from them.
//!
//! One file, appended to by a single write for each run, or for all runs that ended within some milliseconds if they
//! are short. It has 32 bytes that identify study and version, then records of one size. A record has parameters,
//! outputs, and 8 bytes of their SHA-256, with numbers as little-endian doubles. An incomplete last record, after the
//! end of a process, is cut off.

use crate::{
    Error, Result,
    fail_points::{Moment, reach},
    files,
};
use sha2::{Digest, Sha256};
use std::{
    collections::HashMap,
    fs::{File, OpenOptions, TryLockError},
    io::{Read, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// Interval between two writes: longer runs, and the first one, are written at once.
const INTERVAL: Duration = Duration::from_millis(10);

const CHECKSUM: usize = 8;

/// The finished runs of a sampling.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    header: [u8; 32],
    /// Outputs of the runs of earlier attempts, by the bits of their parameters.
    finished: HashMap<Vec<u64>, Vec<f64>>,
    kept: Mutex<Kept>,
}

/// Runs of this attempt.
#[derive(Debug)]
struct Kept {
    /// None until a run is kept.
    file: Option<File>,
    /// Records that are not written yet.
    waiting: Vec<u8>,
    /// Time of the last write.
    written: Instant,
}

impl Journal {
    /// Reads the runs of an earlier attempt at the same study; `parameters` and `outputs` are the numbers of values of
    /// a run.
    ///
    /// # Errors
    /// [`Error::Io`], also if another process is sampling into the folder.
    pub fn open(path: &Path, study_digest: &str, parameters: usize, outputs: usize) -> Result<Self> {
        let name = format!("metafmu {} {study_digest} {parameters} {outputs}", env!("CARGO_PKG_VERSION"));
        let header = Sha256::digest(name).into();
        let kept = Kept { file: None, waiting: Vec::new(), written: Instant::now() };
        let mut journal = Self { path: path.to_owned(), header, finished: HashMap::new(), kept: Mutex::new(kept) };
        if !path.exists() {
            return Ok(journal);
        }
        let mut file = journal.lock_file()?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(Error::io(path, "read"))?;
        let records = bytes.strip_prefix(&journal.header);
        let mut length = 0;
        for record in records.unwrap_or_default().chunks_exact(8 * (parameters + outputs) + CHECKSUM) {
            let (values, checksum) = record.split_at(record.len() - CHECKSUM);
            if Sha256::digest(values)[..CHECKSUM] != *checksum {
                break;
            }
            let mut point: Vec<u64> = values.chunks_exact(8).map(word).collect();
            let outputs = point.split_off(parameters);
            journal.finished.insert(point, outputs.into_iter().map(f64::from_bits).collect());
            length += record.len();
        }
        let length = if records.is_some() { journal.header.len() + length } else { 0 };
        file.set_len(length as u64).map_err(Error::io(path, "write"))?;
        if length == 0 {
            file.write_all(&journal.header).map_err(Error::io(path, "write"))?;
        }
        journal.kept.get_mut().unwrap_or_else(PoisonError::into_inner).file = Some(file);
        Ok(journal)
    }

    /// Number of runs of earlier attempts.
    pub fn len(&self) -> usize {
        self.finished.len()
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.finished.is_empty()
    }

    /// Outputs of a run of an earlier attempt.
    pub fn get(&self, parameters: &[f64]) -> Option<&[f64]> {
        self.finished.get(&bits(parameters)).map(Vec::as_slice)
    }

    /// Keeps a run, with the time that it took.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn keep(&self, parameters: &[f64], outputs: &[f64], took: Duration) -> Result<()> {
        let mut record: Vec<u8> = parameters.iter().chain(outputs).flat_map(|value| value.to_le_bytes()).collect();
        let checksum = Sha256::digest(&record);
        record.extend_from_slice(&checksum[..CHECKSUM]);
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.waiting.append(&mut record);
        let is_due = kept.file.is_none() || took > INTERVAL || kept.written.elapsed() > INTERVAL;
        if is_due { self.write(&mut kept) } else { Ok(()) }
    }

    /// Writes the records that wait.
    fn write(&self, kept: &mut Kept) -> Result<()> {
        if kept.waiting.is_empty() {
            return Ok(());
        }
        let file = match &mut kept.file {
            Some(file) => file,
            none => {
                let mut new = self.lock_file()?;
                new.write_all(&self.header).map_err(Error::io(&self.path, "write"))?;
                none.insert(new)
            }
        };
        let records = &kept.waiting;
        let done = append_whole(file, records).map_err(Error::io(&self.path, "write"));
        kept.waiting.clear();
        kept.written = Instant::now();
        done?;
        reach(Moment::Appended, &self.path);
        Ok(())
    }

    /// Removes the file: the tables are written.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn remove(self) -> Result<()> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.waiting.clear();
        // closed before it goes
        kept.file = None;
        files::remove(&self.path)
    }

    /// Opens the file for this process alone.
    fn lock_file(&self) -> Result<File> {
        let mut options = OpenOptions::new();
        let file = options.read(true).append(true).create(true).open(&self.path);
        let file = file.map_err(Error::io(&self.path, "write"))?;
        let lock = file.try_lock().map_err(|error| match error {
            TryLockError::Error(error) => error,
            TryLockError::WouldBlock => std::io::Error::other("another metafmu is at work in this folder"),
        });
        lock.map_err(Error::io(&self.path, "write"))?;
        Ok(file)
    }
}

/// Appends records, or none of them.
fn append_whole(file: &mut File, records: &[u8]) -> std::io::Result<()> {
    let length = file.metadata()?.len();
    // nothing after an incomplete record could be read: a full disk may have room again for the next one
    file.write_all(records).inspect_err(|_| drop(file.set_len(length)))
}

impl Drop for Journal {
    /// Writes the waiting records: a sampling that Ctrl-C ends loses no finished runs.
    fn drop(&mut self) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // nothing is lost but time
        let _ = self.write(&mut kept);
    }
}

fn word(bytes: &[u8]) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(bytes);
    u64::from_le_bytes(word)
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_there_after_a_crash_and_half_a_run_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("runs");
        let open = |digest: &str| Journal::open(&path, digest, 2, 3).unwrap();
        let first = open("study");
        assert!(first.is_empty() && !path.exists());
        first.keep(&[1.0, -0.0], &[0.1, f64::MIN_POSITIVE, 1e300], Duration::MAX).unwrap();
        assert!(path.exists(), "a long run is written at once");
        // a short one waits for others, or for the end
        first.keep(&[2.0, 0.0], &[4.0, 5.0, 6.0], Duration::ZERO).unwrap();
        let message = Journal::open(&path, "study", 2, 3).unwrap_err().to_string();
        assert!(message.contains("another metafmu is at work in this folder"), "{message}");
        drop(first);

        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, [&bytes[..], &bytes[32..60]].concat()).unwrap();
        let second = open("study");
        assert_eq!(second.len(), 2);
        assert_eq!(second.get(&[1.0, -0.0]), Some(&[0.1, f64::MIN_POSITIVE, 1e300][..]));
        assert_eq!(second.get(&[1.0, 0.0]), None);
        second.keep(&[3.0, 0.0], &[7.0, 8.0, 9.0], Duration::MAX).unwrap();
        drop(second);
        assert_eq!(open("study").len(), 3, "what was appended behind the cut is whole");

        // nothing after a changed byte is trusted
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[32 + 48 + 20] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(open("study").len(), 1);
        assert!(open("another study").is_empty());
        assert!(open("study").is_empty(), "the other study's sampling has been started again");
        open("study").remove().unwrap();
        assert!(!path.exists());
    }
}
