//! Limits of what is unpacked of an archive: a zip archive may hold a thousand times its size, and any number of entries.

use crate::{Error, Result};
use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

/// Entries at most.
pub const MAX_ENTRIES: usize = 50_000;
/// Bytes at most, of archives of any size.
pub const MAX_BYTES: u64 = 4 << 30;
/// Bytes that an archive of any size may have.
const SMALL: u64 = 64 << 20;
/// Bytes for each byte of a larger archive.
const RATIO: u64 = 100;
/// Time that unpacking may take if no other limit is given.
const TIME: Duration = Duration::from_secs(60);

/// Bytes that may be unpacked of an archive of `size` bytes.
pub fn allowed_bytes(size: u64) -> u64 {
    size.saturating_mul(RATIO).clamp(SMALL, MAX_BYTES)
}

/// Size of an archive and of the part of it that is unpacked.
#[derive(Clone, Copy, Debug)]
pub struct ArchiveSize {
    /// Bytes of the archive.
    pub archive: u64,
    /// Entries that are unpacked.
    pub entries: usize,
    /// Bytes of their contents.
    pub unpacked: u64,
}

impl ArchiveSize {
    /// Reason why the archive is not unpacked, if there is one.
    pub fn problem(self) -> Option<String> {
        let Self { archive, entries, unpacked } = self;
        let allowed = allowed_bytes(archive);
        if entries > MAX_ENTRIES {
            Some(format!("has {entries} entries to unpack, expected at most {MAX_ENTRIES}"))
        } else if unpacked > allowed {
            let remedy = if allowed < MAX_BYTES { ": pack it with less compression, as by `zip -0`" } else { "" };
            Some(format!("has {unpacked} bytes when it is unpacked, expected at most {allowed}{remedy}"))
        } else {
            None
        }
    }
}

/// Limits of time, and the request that ends an unpacking early.
#[derive(Clone, Copy, Debug)]
pub struct Patience<'a> {
    /// Time that it may take.
    pub limit: Duration,
    /// Option that sets the limit.
    pub option: &'static str,
    /// Ends it when it turns true.
    pub stop: Option<&'a AtomicBool>,
}

impl Default for Patience<'_> {
    fn default() -> Self {
        Self { limit: TIME, option: "", stop: None }
    }
}

/// Time of an unpacking that has begun.
#[derive(Debug)]
pub struct UnpackingClock<'a> {
    patience: Patience<'a>,
    begin: Instant,
}

impl<'a> Patience<'a> {
    /// Starts the clock.
    pub fn begin(self) -> UnpackingClock<'a> {
        UnpackingClock { patience: self, begin: Instant::now() }
    }
}

impl UnpackingClock<'_> {
    /// Reason why unpacking ends here, if there is one.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the program must stop.
    pub fn problem(&self) -> Result<Option<String>> {
        let Patience { limit, option, stop } = self.patience;
        if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
            return Err(Error::Interrupted);
        }
        let option = if option.is_empty() { String::new() } else { format!(" ({option})") };
        let is_over = self.begin.elapsed() > limit;
        Ok(is_over.then(|| format!("is not unpacked: the archive took longer than {} s{option}", limit.as_secs_f64())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn archives_have_limits_of_bytes_and_entries() {
        let problem = |archive, entries, unpacked| ArchiveSize { archive, entries, unpacked }.problem();
        assert_eq!(problem(1000, MAX_ENTRIES, SMALL), None);
        assert_eq!(problem(1 << 30, 1, MAX_BYTES), None);
        let few = "has 60000 entries to unpack, expected at most 50000";
        assert_eq!(problem(1000, 60_000, 1).unwrap(), few);
        let small = "has 4294967296 bytes when it is unpacked, expected at most 450000000: pack it with less compression, \
                     as by `zip -0`";
        assert_eq!(problem(4_500_000, 1, 1 << 32).unwrap(), small);
        let large = "has 4294967297 bytes when it is unpacked, expected at most 4294967296";
        assert_eq!(problem(1 << 32, 1, MAX_BYTES + 1).unwrap(), large);
    }

    #[test]
    fn unpacking_ends_at_its_limit_and_on_request() {
        let stop = AtomicBool::new(false);
        let patience = Patience { limit: Duration::ZERO, option: "--time-limit", stop: Some(&stop) };
        let message = patience.begin().problem().unwrap();
        assert_eq!(message.unwrap(), "is not unpacked: the archive took longer than 0 s (--time-limit)");
        assert_eq!(Patience::default().begin().problem().unwrap(), None);
        stop.store(true, Ordering::Relaxed);
        assert!(matches!(patience.begin().problem(), Err(Error::Interrupted)));
    }
}
