//! Log messages of an FMU.

use super::ffi::{FmiStatus, status_name};
use std::{
    collections::VecDeque,
    ffi::{CStr, c_char, c_void},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// Only the last messages are kept, for an FMU may log every step.
const MAX_MESSAGES: usize = 1000;

/// One message of an FMU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogMessage {
    /// `ok`, `warning`, `discard`, `error`, `fatal` or `pending`.
    pub status: &'static str,
    /// Log category.
    pub category: String,
    /// The text.
    pub text: String,
}

/// Messages not yet taken. An FMU may log from several threads.
#[derive(Debug, Default)]
pub struct MessageLog {
    log: Mutex<MessageQueue>,
}

#[derive(Debug, Default)]
struct MessageQueue {
    messages: VecDeque<LogMessage>,
    /// How many there ever were.
    count: usize,
}

/// Addresses of the logs of living instances: some FMUs call the logger with an environment that they were never given.
static LIVING: Mutex<Vec<usize>> = Mutex::new(Vec::new());

fn living() -> MutexGuard<'static, Vec<usize>> {
    LIVING.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for MessageLog {
    fn drop(&mut self) {
        let address = std::ptr::from_ref(self).addr();
        living().retain(|known| *known != address);
    }
}

impl MessageLog {
    /// The log of an instance, whose address the FMU is given.
    pub fn of_instance() -> Box<Self> {
        let journal = Box::<Self>::default();
        living().push(std::ptr::from_ref(&*journal).expose_provenance());
        journal
    }

    /// How many messages there have been.
    pub fn count(&self) -> usize {
        self.log().count
    }

    /// Takes the messages after the first `count`.
    pub fn take_after(&self, count: usize) -> Vec<LogMessage> {
        let mut log = self.log();
        let new = log.count.saturating_sub(count).min(log.messages.len());
        let old = log.messages.len() - new;
        log.messages.split_off(old).into()
    }

    fn add(&self, message: LogMessage) {
        let mut log = self.log();
        if log.messages.len() == MAX_MESSAGES {
            log.messages.pop_front();
        }
        log.messages.push_back(message);
        log.count += 1;
    }

    fn log(&self) -> MutexGuard<'_, MessageQueue> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Called by the shim in logger.c with the environment that the FMU received. What is no log of a living instance is taken for that of the last
/// one.
///
/// # Safety
/// The texts must end with a zero byte.
#[unsafe(no_mangle)]
unsafe extern "C" fn metafmu_journal_add(
    journal: *mut c_void,
    status: FmiStatus,
    category: *const c_char,
    message: *const c_char,
) {
    let living = living();
    let known = living.iter().find(|known| **known == journal.addr()).or(living.last());
    let Some(journal) = known.map(|address| std::ptr::with_exposed_provenance::<MessageLog>(*address)) else { return };
    // SAFETY: as asked of the caller; the shim has checked for null pointers. The log is registered and stays so as long as `living` is locked
    let (journal, category, message) = unsafe { (&*journal, CStr::from_ptr(category), CStr::from_ptr(message)) };
    journal.add(LogMessage {
        status: status_name(status),
        category: category.to_string_lossy().into_owned(),
        text: message.to_string_lossy().trim_end().to_owned(),
    });
}

/// `fmi3LogMessageCallback`.
///
/// # Safety
/// The texts must be null or end with a zero byte.
pub unsafe extern "C" fn log_message(
    journal: *mut c_void,
    status: FmiStatus,
    category: *const c_char,
    message: *const c_char,
) {
    let category = if category.is_null() { c"".as_ptr() } else { category };
    if !journal.is_null() && !message.is_null() {
        // SAFETY: as asked of the caller
        unsafe { metafmu_journal_add(journal, status, category, message) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_messages_are_kept_and_those_of_one_call_can_be_told_apart() {
        let journal = MessageLog::default();
        let log = |range: std::ops::Range<usize>| {
            for number in range {
                journal.add(LogMessage { status: "ok", category: String::new(), text: number.to_string() });
            }
        };
        log(0..MAX_MESSAGES + 10);
        let before = journal.count();
        log(5000..5002);
        let texts = |messages: Vec<LogMessage>| messages.into_iter().map(|message| message.text).collect::<Vec<_>>();
        assert_eq!(texts(journal.take_after(before)), ["5000", "5001"]);
        let earlier = texts(journal.take_after(0));
        assert_eq!((earlier.len(), earlier[0].as_str()), (MAX_MESSAGES - 2, "12"));
        assert_eq!(journal.take_after(0), []);
    }

    #[test]
    fn a_message_with_an_environment_that_was_never_given_is_kept() {
        let journal = MessageLog::of_instance();
        let environment = std::ptr::without_provenance_mut(1);
        // SAFETY: the texts end with a zero byte
        unsafe { log_message(environment, 0, c"events".as_ptr(), c"of nobody".as_ptr()) };
        assert!(journal.take_after(0).iter().any(|message| message.text == "of nobody"));
    }
}
