//! Work in a separate thread, while the caller's thread checks for Ctrl-C and prints the messages of the work.

use crate::threads::shared;
use metafmu::pipeline::{Control, Event, PipelineObserver};
use pyo3::prelude::*;
use std::{
    panic::resume_unwind,
    path::Path,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, Sender, channel},
    },
    thread,
    time::Duration,
};

/// Time between two checks for Ctrl-C.
const BETWEEN: Duration = Duration::from_millis(50);

/// Sends the messages of a pipeline to the thread that may print them.
pub struct LineSender(Option<Mutex<Sender<String>>>);

impl LineSender {
    /// Drops all messages unless they are wanted.
    pub fn only_if(self, wanted: bool) -> Self {
        Self(self.0.filter(|_| wanted))
    }

    /// Control of a pipeline with this observer, stop flag and program.
    pub fn control<'a>(&'a self, stop: &'a AtomicBool, program: &'a Path) -> Control<'a> {
        Control { observer: self, stop, program, heard: |_| {} }
    }

    fn say(&self, line: String) {
        if let Some(lines) = &self.0 {
            // the other end is there as long as the work
            let _ = lines.lock().unwrap_or_else(PoisonError::into_inner).send(line);
        }
    }
}

impl PipelineObserver for LineSender {
    fn event(&self, event: Event<'_>) {
        match event {
            Event::Note(line) | Event::Message(line) => self.say(line.to_string()),
            Event::Warning(line) => self.say(format!("warning: {line}")),
            _ => {}
        }
    }
}

/// Does work that ends soon after its token turns true, which it does at Ctrl-C: then the error is Python's `KeyboardInterrupt`.
pub fn interruptible<T: Send>(py: Python<'_>, work: impl FnOnce(&AtomicBool, LineSender) -> T + Send) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    let (done, interrupted) = py.detach(|| {
        let (sender, receiver) = channel();
        let mut interrupted = None;
        let done = thread::scope(|scope| {
            let stop = &stop;
            let worker = scope.spawn(move || {
                let alive = sender.clone();
                let done = shared(|| work(stop, LineSender(Some(Mutex::new(sender)))));
                drop(alive);
                done
            });
            loop {
                let line = receiver.recv_timeout(BETWEEN);
                if matches!(line, Err(RecvTimeoutError::Disconnected)) {
                    break;
                }
                let looked = Python::attach(|py| {
                    if let Ok(line) = &line {
                        show(py, line)?;
                    }
                    py.check_signals()
                });
                if let Err(error) = looked {
                    stop.store(true, Ordering::Relaxed);
                    interrupted.get_or_insert(error);
                }
            }
            worker.join()
        });
        (done, interrupted)
    });
    match (done, interrupted) {
        (Err(panic), _) => resume_unwind(panic),
        (_, Some(error)) => Err(error),
        (Ok(done), None) => Ok(done),
    }
}

/// A line on `sys.stderr`, which a notebook shows below the cell.
fn show(py: Python<'_>, line: &str) -> PyResult<()> {
    let stderr = py.import("sys")?.getattr("stderr")?;
    if stderr.is_none() {
        return Ok(());
    }
    stderr.call_method1("write", (format!("{line}\n"),))?;
    stderr.call_method0("flush").map(|_| ())
}
