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

impl MessageLog {
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

/// Called by the shim in logger.c with the environment that the FMU received.
///
/// # Safety
/// `journal` must be that of a living instance, the texts must end with a zero byte.
#[unsafe(no_mangle)]
unsafe extern "C" fn metafmu_journal_add(
    journal: *mut c_void,
    status: FmiStatus,
    category: *const c_char,
    message: *const c_char,
) {
    // SAFETY: as asked of the caller; the shim has checked for null pointers
    let (journal, category, message) =
        unsafe { (&*journal.cast::<MessageLog>(), CStr::from_ptr(category), CStr::from_ptr(message)) };
    journal.add(LogMessage {
        status: status_name(status),
        category: category.to_string_lossy().into_owned(),
        text: message.to_string_lossy().trim_end().to_owned(),
    });
}

/// `fmi3LogMessageCallback`.
///
/// # Safety
/// `journal` must be that of a living instance, the texts null or with a zero byte at their ends.
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
}
