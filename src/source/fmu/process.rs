//! A [worker](super::worker) as the process that started it sees it.

use super::worker::{ARGUMENT, Reply};
use crate::fmu::host::process::{in_own_group, kill};
use std::{
    io::{BufRead, BufReader, Read, Write},
    process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, RecvTimeoutError},
    },
    thread,
    time::{Duration, Instant},
};

/// Environment variable that keeps a worker from starting workers, should a program not know what it was started for.
const MARK: &str = "METAFMU_FMU_WORKER";

/// How often it is looked whether to stop.
const GLANCE: Duration = Duration::from_millis(50);

/// How long a process that ended may take to hand over its last words.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// Of what an FMU prints only the end is kept.
const KEPT: usize = 4096;

/// A running worker; killed when dropped.
pub struct Worker {
    child: Child,
    requests: ChildStdin,
    replies: Receiver<(Reply, Vec<f64>)>,
    /// The end of what it printed, once it has ended.
    last_words: Receiver<String>,
}

/// How a request ended.
pub enum Answer {
    /// With a reply, and the run's outputs if it is done.
    Reply(Reply, Vec<f64>),
    /// With the end of the process, and why.
    Died(String),
    /// Not within the time limit.
    TimedOut,
    /// It was not waited for, because the program is to stop.
    Stopped,
}

impl Worker {
    /// Starts a process; its first answer is to the setup.
    ///
    /// # Errors
    /// The system's.
    pub fn start(setup: &str) -> std::io::Result<Self> {
        if std::env::var_os(MARK).is_some() {
            return Err(std::io::Error::other("a worker cannot start another: does the program call `worker::serve`?"));
        }
        let mut command = Command::new(std::env::current_exe()?);
        command.arg(ARGUMENT).env(MARK, "1");
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        in_own_group(&mut command);
        let mut child = command.spawn()?;
        let (Some(mut requests), Some(output), Some(errors)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(std::io::Error::other("no pipe"));
        };
        let (send, replies) = mpsc::channel();
        thread::spawn(move || read_replies(output, &send));
        let (send, last_words) = mpsc::channel();
        // nobody may be left who wants to hear it
        thread::spawn(move || send.send(end_of(errors)));
        // a process that ended already is found when it is asked for its answer
        let _ = writeln!(requests, "{setup}");
        Ok(Self { child, requests, replies, last_words })
    }

    /// Asks for a run with values.
    pub fn ask(&mut self, values: &[f64], limit: Duration, stop: &AtomicBool) -> Answer {
        let numbers: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
        let _ = writeln!(self.requests, "[{}]", numbers.join(","));
        self.answer(limit, stop)
    }

    /// Waits for the answer to the last request.
    pub fn answer(&mut self, limit: Duration, stop: &AtomicBool) -> Answer {
        let begin = Instant::now();
        loop {
            let left = limit.saturating_sub(begin.elapsed());
            match self.replies.recv_timeout(left.min(GLANCE)) {
                Ok((reply, outputs)) => return Answer::Reply(reply, outputs),
                Err(RecvTimeoutError::Disconnected) => return Answer::Died(self.obituary()),
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return Answer::Stopped,
                Err(RecvTimeoutError::Timeout) if left.is_zero() => return Answer::TimedOut,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// How the process ended, and the last line that it printed.
    fn obituary(&mut self) -> String {
        // it has closed its output, but might still be there
        let begin = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && begin.elapsed() < LAST_WORDS {
            thread::sleep(Duration::from_millis(1));
        }
        kill(&mut self.child);
        let status = self.child.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
        let words = self.last_words.recv_timeout(LAST_WORDS).unwrap_or_default();
        let last = words.lines().map(str::trim).rfind(|line| !line.is_empty());
        let last = last.map_or(String::new(), |line| format!(": {line}"));
        format!("its process ended with {status}{last}")
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        kill(&mut self.child);
        let _ = self.child.wait();
    }
}

/// Hands replies on until there is none or one that makes no sense.
fn read_replies(output: ChildStdout, send: &mpsc::Sender<(Reply, Vec<f64>)>) {
    let mut output = BufReader::with_capacity(1 << 16, output);
    let mut line = String::new();
    while output.read_line(&mut line).is_ok_and(|count| count > 0) {
        let Ok(reply) = serde_json::from_str(&line) else { return };
        line.clear();
        let count = if let Reply::Done(count) = reply { count } else { 0 };
        let mut outputs = Vec::new();
        for _ in 0..count {
            let mut bytes = [0; 8];
            if output.read_exact(&mut bytes).is_err() {
                return;
            }
            outputs.push(f64::from_le_bytes(bytes));
        }
        if send.send((reply, outputs)).is_err() {
            return;
        }
    }
}

/// Reads to the end, and keeps that.
fn end_of(mut errors: ChildStderr) -> String {
    let (mut kept, mut buffer) = (Vec::new(), [0; KEPT]);
    while let Ok(count @ 1..) = errors.read(&mut buffer) {
        kept.extend_from_slice(&buffer[..count]);
        let old = kept.len().saturating_sub(KEPT);
        kept.drain(..old);
    }
    String::from_utf8_lossy(&kept).into_owned()
}
