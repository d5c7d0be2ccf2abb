//! Shard of a sampling that is spread over machines: made by `metafmu sample STUDY --shard 3/8`, put together by
//! `--merge`.
//!
//! Shard `i` of `n` has the runs `i - 1`, `i - 1 + n`, ... of all runs of the plan: training, test and calibration runs
//! in one row. So each shard has its share of every set, whatever the order of the plan. Its file is a line of JSON,
//! then the outputs of the successful runs, as little-endian doubles, and the SHA-256 of all that.

use super::{
    RunFailure,
    simulation::{RunOutcome, Simulation},
};
use crate::{Error, Result, files, study::Study};
use metafmu_runtime::Rows;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

const CHECKSUM: usize = 32;

/// Number of a shard, counted from 1, and number of all shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    /// Number of shards.
    pub of: usize,
    /// Number of this shard, from 1.
    pub number: usize,
}

/// Text that is no shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShardSyntaxError;

impl fmt::Display for ShardSyntaxError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("expected I/N with I from 1 to N, for instance 3/8")
    }
}

impl std::error::Error for ShardSyntaxError {}

impl FromStr for Shard {
    type Err = ShardSyntaxError;

    fn from_str(text: &str) -> std::result::Result<Self, ShardSyntaxError> {
        let parts = text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        match parts {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Self { of, number }),
            _ => Err(ShardSyntaxError),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Shard {
    /// Positions of its runs among `runs`.
    pub fn positions(self, runs: usize) -> impl Iterator<Item = usize> {
        (self.number - 1..runs).step_by(self.of)
    }

    /// Returns true if a position is one of its runs.
    pub fn has(self, position: usize) -> bool {
        position % self.of == self.number - 1
    }

    /// Its file in a folder.
    pub fn file(self, folder: &Path) -> PathBuf {
        folder.join(format!("shard-{}-of-{}.bin", self.number, self.of))
    }

    /// The files of shards in a folder.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn files(folder: &Path) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(Error::io(folder, "read"))? {
            let entry = entry.map_err(Error::io(folder, "read"))?;
            if entry.file_name().to_str().is_some_and(Self::is_name_of_shard) {
                files.push(entry.path());
            }
        }
        files.sort_unstable();
        Ok(files)
    }

    /// Returns true if a file is named like a shard.
    fn is_name_of_shard(name: &str) -> bool {
        let parts = name.strip_prefix("shard-").and_then(|name| name.strip_suffix(".bin")?.split_once("-of-"));
        parts.is_some_and(|(number, of)| format!("{number}/{of}").parse::<Self>().is_ok())
    }
}

/// Header of a shard: the first line of its file.
#[derive(Debug, Serialize, Deserialize)]
struct ShardHeader {
    /// Version of the program.
    metafmu: String,
    sampling_digest: String,
    shard: Shard,
    /// Failed runs, by their position in the plan.
    failed: BTreeMap<usize, RunFailure>,
    seconds: f64,
}

/// Writes the runs of a shard, in the order of its positions.
///
/// # Errors
/// [`Error::Io`].
pub fn write(path: &Path, study: &Study, shard: Shard, outcomes: &[RunOutcome], seconds: f64) -> Result<()> {
    let positions = shard.positions(usize::MAX).zip(outcomes);
    let failed = positions.filter_map(|(position, outcome)| Some((position, outcome.as_ref().err()?.clone())));
    let header = ShardHeader {
        metafmu: env!("CARGO_PKG_VERSION").into(),
        sampling_digest: study.sampling_digest(),
        shard,
        failed: failed.collect(),
        seconds,
    };
    let mut bytes = serde_json::to_vec(&header).map_err(std::io::Error::from).map_err(Error::io(path, "write"))?;
    bytes.push(b'\n');
    let values = outcomes.iter().flatten().flat_map(|run| &run.outputs);
    bytes.extend(values.flat_map(|value| value.to_le_bytes()));
    let checksum = Sha256::digest(&bytes);
    files::write_with(path, |file| {
        file.write_all(&bytes)?;
        file.write_all(&checksum)
    })
}

/// Puts the shards of a plan together: an outcome for each point, and the seconds that all of them took.
///
/// # Errors
/// [`Error::Stale`] naming a file that is damaged, of another study or version, or of another number of shards, and the
/// shards that are missing; [`Error::Io`].
pub fn merge(
    paths: &[PathBuf],
    folder: &Path,
    study: &Study,
    simulation: &Simulation,
    points: &Rows,
) -> Result<(Vec<RunOutcome>, f64)> {
    let mut parts: BTreeMap<Shard, (&Path, Vec<RunOutcome>)> = BTreeMap::new();
    let mut seconds = 0.0;
    for path in paths {
        let (shard, outcomes, took) = read(path, study, simulation, points)?;
        if let Some((first, (of, _))) = parts.first_key_value()
            && first.of != shard.of
        {
            let message = format!("is shard {shard}, but {} is {first}: expected shards of one division", of.display());
            return Err(stale(path, message));
        }
        if let Some((first, _)) = parts.insert(shard, (path, outcomes)) {
            return Err(stale(path, format!("is shard {shard}, and so is {}", first.display())));
        }
        seconds += took;
    }
    let Some(of) = parts.keys().next().map(|shard| shard.of) else {
        let message = "no shards: run `metafmu sample STUDY --shard I/N` first";
        return Err(stale(folder, message));
    };
    let missing: Vec<String> = (1..=of)
        .filter(|&number| !parts.contains_key(&Shard { of, number }))
        .map(|number| number.to_string())
        .collect();
    if !missing.is_empty() {
        let (plural, verb) = if missing.len() == 1 { ("", "is") } else { ("s", "are") };
        let message = format!("shard{plural} {} of {of} {verb} missing", missing.join(", "));
        return Err(stale(folder, message));
    }
    let mut parts: Vec<_> = parts.into_values().map(|(_, outcomes)| outcomes.into_iter()).collect();
    // a shard has an outcome for each of its points, and every point is in one shard
    let outcomes = (0..points.len()).filter_map(|position| parts[position % of].next()).collect();
    Ok((outcomes, seconds))
}

fn read(path: &Path, study: &Study, simulation: &Simulation, points: &Rows) -> Result<(Shard, Vec<RunOutcome>, f64)> {
    let damaged = || stale(path, "is damaged: make the shard again");
    let bytes = std::fs::read(path).map_err(Error::io(path, "read"))?;
    let (content, checksum) = bytes.split_at_checked(bytes.len().saturating_sub(CHECKSUM)).ok_or_else(damaged)?;
    let end = content.iter().position(|&byte| byte == b'\n').ok_or_else(damaged)?;
    if Sha256::digest(content)[..] != *checksum {
        return Err(damaged());
    }
    let header: ShardHeader = serde_json::from_slice(&content[..end]).map_err(|_| damaged())?;
    if header.metafmu != env!("CARGO_PKG_VERSION") {
        return Err(stale(
            path,
            format!("was made by metafmu {}, expected {}", header.metafmu, env!("CARGO_PKG_VERSION")),
        ));
    }
    if header.sampling_digest != study.sampling_digest() {
        return Err(stale(path, "was sampled from another study: make the shard again"));
    }
    let size = 8 * simulation.times().len() * simulation.outputs().len();
    let mut runs = content[end + 1..].chunks_exact(size);
    let mut outcomes = Vec::new();
    for position in header.shard.positions(points.len()) {
        outcomes.push(match header.failed.get(&position) {
            Some(failure) => Err(failure.clone()),
            None => {
                let values = runs.next().ok_or_else(damaged)?.as_chunks().0;
                Ok(simulation
                    .run_of(&points[position], values.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect()))
            }
        });
    }
    Ok((header.shard, outcomes, header.seconds))
}

fn stale(path: &Path, message: impl Into<String>) -> Error {
    Error::Stale { path: path.to_owned(), message: message.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_parsed_and_have_every_run_once() {
        for wrong in ["", "1", "0/3", "4/3", "1/0", "-1/3", "a/b", "1/2/3"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
        for (of, runs) in [(1, 5), (3, 10), (4, 4), (5, 3)] {
            let shards = (1..=of).map(|number| format!("{number}/{of}").parse::<Shard>().unwrap());
            let mut all: Vec<usize> = shards.flat_map(|shard| shard.positions(runs)).collect();
            all.sort_unstable();
            assert_eq!(all, (0..runs).collect::<Vec<_>>());
        }
    }
}
