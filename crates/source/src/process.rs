//! Child processes that answer requests in lines: a crash, a hang or output there does not affect the program that started them.

mod memory;

use serde::Serialize;
use std::{
    io::{self, BufRead, BufReader, Read, Write},
    process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, RecvTimeoutError, Sender},
    },
    thread,
    time::{Duration, Instant},
};

/// Time between two checks of the stop flag.
const GLANCE: Duration = Duration::from_millis(50);

/// Time between two checks for the end of a process.
const PAUSE: Duration = Duration::from_millis(1);

/// Time that a process which ended has for its remaining output.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// Longest line on standard error; longer ones are broken.
const LONGEST_LINE: u64 = 4096;

/// Largest number of replies that are not yet taken; a process with more must wait.
const WAITING: usize = 16;

/// Standard output of a process.
pub type ReplyStream = BufReader<ChildStdout>;

/// A running process with replies of a type; killed when dropped.
#[derive(Debug)]
pub struct ChildProcess<M> {
    child: Child,
    /// Name of the process in the message about its end.
    name: &'static str,
    /// Lines on their way to standard input, which is closed when there is no sender.
    requests: Option<Sender<String>>,
    replies: Receiver<M>,
    /// The last line on standard error, once it is closed.
    last_words: Receiver<String>,
}

/// End of a request.
#[derive(Debug)]
pub enum ReplyStatus<M> {
    /// A reply arrived.
    Reply(M),
    /// The process ended.
    Died(Obituary),
    /// The time limit passed.
    TimedOut,
    /// The program must stop, so the reply is not awaited.
    Stopped,
}

/// End of a process.
#[derive(Debug)]
pub struct Obituary {
    /// `true` with exit code 0.
    pub is_success: bool,
    /// Reason of the end of the process, and the last line on its standard error.
    pub message: String,
}

impl<M: Send + 'static> ChildProcess<M> {
    /// Starts a command. `read` takes replies from standard output until it returns none, `heard` takes each line on standard error; `name`
    /// is the process in messages.
    ///
    /// # Errors
    /// The system's reason.
    pub fn start(
        mut command: Command,
        name: &'static str,
        mut read: impl FnMut(&mut ReplyStream) -> Option<M> + Send + 'static,
        heard: fn(&str),
    ) -> io::Result<Self> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        in_own_group(&mut command);
        let mut child = command.spawn()?;
        let (Some(input), Some(output), Some(errors)) = (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(io::Error::other("no pipe"));
        };
        let (requests, lines) = mpsc::channel();
        // a process that does not read must not block this one
        thread::spawn(move || write_lines(input, &lines));
        let (send, replies) = mpsc::sync_channel(WAITING);
        thread::spawn(move || {
            let mut output = BufReader::with_capacity(1 << 16, output);
            while let Some(reply) = read(&mut output) {
                if send.send(reply).is_err() {
                    return;
                }
            }
        });
        let (send, last_words) = mpsc::channel();
        // the receiver may be gone
        thread::spawn(move || send.send(listen(errors, heard)));
        Ok(Self { child, name, requests: Some(requests), replies, last_words })
    }

    /// Sends a request as a line of JSON.
    pub fn ask(&self, request: &impl Serialize) {
        // a process that has ended is detected when its reply is awaited
        if let (Some(requests), Ok(line)) = (&self.requests, serde_json::to_string(request)) {
            let _ = requests.send(line);
        }
    }

    /// Closes standard input: no requests follow.
    pub fn close(&mut self) {
        self.requests = None;
    }

    /// Resident memory of the process and those below it, in bytes, if the system tells it: see [`memory::resident`].
    pub fn memory(&self) -> Option<u64> {
        memory::resident(&self.child)
    }

    /// Waits for the next reply.
    pub fn reply(&mut self, limit: Option<Duration>, stop: &AtomicBool) -> ReplyStatus<M> {
        let begin = Instant::now();
        loop {
            let left = limit.map(|limit| limit.saturating_sub(begin.elapsed()));
            match self.replies.recv_timeout(left.map_or(GLANCE, |left| left.min(GLANCE))) {
                Ok(reply) => return ReplyStatus::Reply(reply),
                Err(RecvTimeoutError::Disconnected) => return ReplyStatus::Died(self.obituary()),
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return ReplyStatus::Stopped,
                Err(RecvTimeoutError::Timeout) if left.is_some_and(|left| left.is_zero()) => {
                    return ReplyStatus::TimedOut;
                }
                // what the process has started may hold the pipe open
                Err(RecvTimeoutError::Timeout) if !matches!(self.child.try_wait(), Ok(None)) => {
                    return match self.replies.recv_timeout(LAST_WORDS) {
                        Ok(reply) => ReplyStatus::Reply(reply),
                        Err(_) => ReplyStatus::Died(self.obituary()),
                    };
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Waits for the end of the process, whatever becomes of its standard output.
    pub fn end(&mut self, limit: Duration, stop: &AtomicBool) -> ReplyStatus<M> {
        let begin = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) {
            if stop.load(Ordering::Relaxed) {
                return ReplyStatus::Stopped;
            } else if begin.elapsed() > limit {
                return ReplyStatus::TimedOut;
            }
            thread::sleep(PAUSE);
        }
        ReplyStatus::Died(self.obituary())
    }

    /// Waits for the end after the last reply, and reads the remaining output. Standard input stays open unless it was
    /// [closed](Self::close): a worker of an FMU takes its end for the end of this process, and removes the FMU's files.
    pub fn finish(mut self) {
        self.wait();
    }

    fn obituary(&mut self) -> Obituary {
        let words = self.wait();
        let (is_success, how) = match self.child.wait() {
            Ok(status) => match status.code() {
                Some(code) => (status.success(), format!("{} with exit code {code}", self.name)),
                None => (false, format!("its process ended with {status}")),
            },
            Err(error) => (false, error.to_string()),
        };
        Obituary { is_success, message: if words.is_empty() { how } else { format!("{how}: {words}") } }
    }

    /// Waits for the end, which is near, and returns the last line on standard error.
    fn wait(&mut self) -> String {
        let begin = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && begin.elapsed() < LAST_WORDS {
            thread::sleep(PAUSE);
        }
        kill(&mut self.child);
        self.last_words.recv_timeout(LAST_WORDS).unwrap_or_default()
    }
}

impl<M> Drop for ChildProcess<M> {
    fn drop(&mut self) {
        kill(&mut self.child);
        let _ = self.child.wait();
    }
}

/// Writes lines until there are no more, or the process reads none.
fn write_lines(mut input: ChildStdin, lines: &Receiver<String>) {
    for mut line in lines {
        line.push('\n');
        if input.write_all(line.as_bytes()).is_err() {
            return;
        }
    }
}

/// Hands on each line on standard error, and returns the last one that is not blank.
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

/// Makes a command start a separate group of processes: Ctrl-C in a terminal does not reach it, and [`kill`] ends its
/// children, such as the simulation tool behind an FMU.
fn in_own_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}

/// Ends a child that [`in_own_group`] was applied to, at once and with all its group.
fn kill(child: &mut Child) {
    // a child that was waited for is gone, and its number may be another's
    #[cfg(unix)]
    if let Ok(None) = child.try_wait() {
        // a group that is gone already is as good as killed
        let _ =
            rustix::process::kill_process_group(rustix::process::Pid::from_child(child), rustix::process::Signal::KILL);
    }
    // fails if it is gone already
    let _ = child.kill();
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    /// Starts a shell that replies with a line, then makes a file if its standard input is closed.
    fn shell(file: &std::path::Path) -> ChildProcess<String> {
        let mut command = Command::new("sh");
        command.args(["-c", "read request; echo done; read request || : > \"$0\""]).arg(file);
        let read = |output: &mut ReplyStream| {
            let mut line = String::new();
            output.read_line(&mut line).ok().filter(|count| *count > 0).map(|_| line)
        };
        let mut process = ChildProcess::start(command, "the shell ended", read, |_| {}).unwrap();
        process.ask(&1);
        let reply = process.reply(None, &AtomicBool::new(false));
        assert!(matches!(reply, ReplyStatus::Reply(text) if text == "done\n"));
        process
    }

    #[test]
    fn standard_input_stays_open_until_it_is_closed() {
        let folder = tempfile::tempdir().unwrap();
        let (open, closed) = (folder.path().join("open"), folder.path().join("closed"));
        shell(&open).finish();
        let mut process = shell(&closed);
        process.close();
        process.finish();
        assert!(closed.exists() && !open.exists());
    }
}
