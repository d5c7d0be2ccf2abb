//! A worker as the process that started it sees it.

use super::{ARGUMENT, FOLDER, Job};
use crate::{
    Error, Result,
    fmi::host::process::{in_own_group, kill},
};
use serde::{Serialize, de::DeserializeOwned};
use std::{
    io::{BufRead, BufReader, Read, Write},
    marker::PhantomData,
    path::Path,
    process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, RecvTimeoutError, SyncSender},
    },
    thread,
    time::{Duration, Instant},
};

/// How often it is looked whether to stop.
const GLANCE: Duration = Duration::from_millis(50);

/// How long a process that ended may take to hand over its last words.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// Longer lines of what an FMU prints are broken.
const LONGEST_LINE: u64 = 4096;

/// Replies that wait to be taken; a worker that has more has to wait.
const WAITING: usize = 16;

/// What worker processes need.
#[derive(Clone, Copy, Debug)]
pub struct Workers<'a> {
    /// The program that is started with [`ARGUMENT`]: `metafmu`, or another one that calls [`serve`](super::serve) in
    /// that case.
    pub program: &'a Path,
    /// Ends them when it turns true.
    pub stop: &'a AtomicBool,
}

/// Watch over an FMU that runs in a separate process.
#[derive(Clone, Copy, Debug)]
pub struct Watch<'a> {
    /// What its process needs.
    pub workers: Workers<'a>,
    /// Time limit.
    pub limit: Option<Duration>,
    /// Receives each line that it prints.
    pub heard: fn(&str),
}

/// A running worker with replies of a type; killed when dropped.
#[derive(Debug)]
pub struct Worker<R> {
    child: Child,
    requests: ChildStdin,
    replies: Receiver<(R, Vec<f64>)>,
    /// The last line that it printed, once it has ended.
    last_words: Receiver<String>,
    reply: PhantomData<R>,
}

/// How a request ended.
#[derive(Debug)]
pub enum ReplyStatus<R> {
    /// With a reply and its numbers.
    Reply(R, Vec<f64>),
    /// With the end of the process, and how that was.
    Died(String),
    /// Not within the time limit.
    TimedOut,
    /// Not awaited, because the program is to stop.
    Stopped,
}

impl<R: DeserializeOwned + Send + 'static> Worker<R> {
    /// Starts `program` for the FMU at `path` that is unpacked into a folder; `heard` takes each line that it prints.
    ///
    /// # Errors
    /// [`Error::Io`] with the system's reason.
    pub fn start(program: &Path, path: &Path, folder: &Path, job: &Job, heard: fn(&str)) -> Result<Self> {
        let failed = |source| Error::io(path, "start a process for")(source);
        if std::env::var_os(FOLDER).is_some() {
            let other = "a worker cannot start another: does the program call `worker::serve`?";
            return Err(failed(std::io::Error::other(other)));
        }
        let mut command = Command::new(program);
        command.arg(ARGUMENT).env(FOLDER, folder);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        in_own_group(&mut command);
        let mut child = command.spawn().map_err(failed)?;
        let (Some(requests), Some(output), Some(errors)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(failed(std::io::Error::other("no pipe")));
        };
        let (send, replies) = mpsc::sync_channel(WAITING);
        thread::spawn(move || read_replies(output, &send));
        let (send, last_words) = mpsc::channel();
        // the receiver may be gone
        thread::spawn(move || send.send(listen(errors, heard)));
        let mut worker = Self { child, requests, replies, last_words, reply: PhantomData };
        worker.ask(job);
        Ok(worker)
    }

    /// Sends a request.
    pub fn ask(&mut self, request: &impl Serialize) {
        // a process that has ended is found when its reply is awaited
        if let Ok(line) = serde_json::to_string(request) {
            let _ = writeln!(self.requests, "{line}");
        }
    }

    /// Waits for the next reply.
    pub fn reply(&mut self, limit: Option<Duration>, stop: &AtomicBool) -> ReplyStatus<R> {
        let begin = Instant::now();
        loop {
            let left = limit.map(|limit| limit.saturating_sub(begin.elapsed()));
            match self.replies.recv_timeout(left.map_or(GLANCE, |left| left.min(GLANCE))) {
                Ok((reply, numbers)) => return ReplyStatus::Reply(reply, numbers),
                Err(RecvTimeoutError::Disconnected) => return ReplyStatus::Died(self.obituary()),
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return ReplyStatus::Stopped,
                Err(RecvTimeoutError::Timeout) if left.is_some_and(|left| left.is_zero()) => {
                    return ReplyStatus::TimedOut;
                }
                // what the FMU has started may hold the pipe open
                Err(RecvTimeoutError::Timeout) if !matches!(self.child.try_wait(), Ok(None)) => {
                    return match self.replies.recv_timeout(LAST_WORDS) {
                        Ok((reply, numbers)) => ReplyStatus::Reply(reply, numbers),
                        Err(_) => ReplyStatus::Died(self.obituary()),
                    };
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// After the last reply: reads its remaining output.
    pub fn finish(mut self) {
        self.wait();
    }

    /// How the process ended, and the last line that it printed.
    fn obituary(&mut self) -> String {
        let words = self.wait();
        let how = match self.child.wait() {
            Ok(status) => match status.code() {
                Some(code) => format!("the FMU ended its process with exit code {code}"),
                None => format!("its process ended with {status}"),
            },
            Err(error) => error.to_string(),
        };
        if words.is_empty() { how } else { format!("{how}: {words}") }
    }

    /// Waits for the end, which is near, and returns the last line that was printed.
    fn wait(&mut self) -> String {
        let begin = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && begin.elapsed() < LAST_WORDS {
            thread::sleep(Duration::from_millis(1));
        }
        kill(&mut self.child);
        self.last_words.recv_timeout(LAST_WORDS).unwrap_or_default()
    }
}

impl<R> Drop for Worker<R> {
    fn drop(&mut self) {
        kill(&mut self.child);
        let _ = self.child.wait();
    }
}

/// Hands replies on until there is none or one that makes no sense.
fn read_replies<R: DeserializeOwned>(output: ChildStdout, send: &SyncSender<(R, Vec<f64>)>) {
    let mut output = BufReader::with_capacity(1 << 16, output);
    let mut line = Vec::new();
    while output.read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let Ok((reply, count)) = serde_json::from_slice::<(R, usize)>(&line) else { return };
        line.clear();
        let mut numbers = Vec::new();
        for _ in 0..count {
            let mut bytes = [0; 8];
            if output.read_exact(&mut bytes).is_err() {
                return;
            }
            numbers.push(f64::from_le_bytes(bytes));
        }
        if send.send((reply, numbers)).is_err() {
            return;
        }
    }
}

/// Hands on each line that is printed, and returns the last one that is not blank.
fn listen(errors: ChildStderr, heard: fn(&str)) -> String {
    let mut errors = BufReader::new(errors);
    let (mut line, mut last) = (Vec::new(), String::new());
    while errors.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end();
        heard(text);
        if !text.is_empty() {
            text.trim_start().clone_into(&mut last);
        }
        line.clear();
    }
    last
}
