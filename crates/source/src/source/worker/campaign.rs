//! Runs of many points by several processes, with retries and repeats.

use super::{RunOutputs, WorkerModel};
use crate::{
    Error, Result,
    fmi::Workers,
    source::{
        FailureCause, Journal, RunFailure,
        launch::{Launcher, WorkerProcess, WorkerReply},
    },
};
use metafmu_runtime::Rows;
use std::{
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
    time::Instant,
};

/// Memory in bytes above which a process is replaced, if the study has no limit.
const MEMORY: u64 = 1_000_000_000;

/// Time between two measurements of memory, in durations of a measurement.
const BETWEEN: u32 = 50;

/// Runs on their way.
pub(super) struct Campaign<'a> {
    pub(super) model: &'a WorkerModel,
    pub(super) launcher: &'a dyn Launcher,
    pub(super) points: &'a Rows,
    /// Positions of the points to run.
    pub(super) missing: &'a [usize],
    pub(super) failure: &'a (dyn Fn(&[f64], &RunFailure) -> Result<()> + Sync),
    pub(super) journal: Option<&'a Journal>,
    pub(super) workers: Workers<'a>,
    pub(super) done: &'a (dyn Fn() + Sync),
}

/// State that the threads of a campaign share.
struct SharedProgress {
    /// Next of the missing points.
    next: AtomicUsize,
    /// Another thread met an error.
    halt: AtomicBool,
}

/// A process between two runs.
pub(super) struct IdleWorker {
    process: Box<dyn WorkerProcess>,
    memory: MemoryWatch,
}

/// Memory of a process, from run to run.
#[derive(Default)]
struct MemoryWatch {
    /// Limit in bytes, once a run is finished.
    limit: Option<u64>,
    /// Time before which it is not measured again.
    later: Option<Instant>,
}

impl Campaign<'_> {
    /// Outcomes of the missing points, in any order.
    pub(super) fn run(&self) -> Result<Vec<(usize, RunOutputs)>> {
        let threads = rayon::current_num_threads().min(self.missing.len());
        // the first thread makes the first runs, which it repeats
        let first = self.missing.len().min(self.model.repeats);
        let progress = SharedProgress { next: AtomicUsize::new(first), halt: AtomicBool::new(false) };
        let results: Vec<Result<Vec<_>>> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..threads)
                .map(|thread| {
                    let own = if thread == 0 { &self.missing[..first] } else { &[] };
                    let progress = &progress;
                    scope.spawn(move || self.work(own, progress))
                })
                .collect();
            threads.into_iter().map(|thread| thread.join().unwrap_or_else(|p| std::panic::resume_unwind(p))).collect()
        });
        // threads that were halted do not know why
        let mut outcomes = Vec::new();
        for result in results {
            outcomes.extend(result?);
        }
        if self.workers.stop.load(Ordering::Relaxed) && outcomes.len() < self.missing.len() {
            return Err(Error::Interrupted);
        }
        Ok(outcomes)
    }

    /// Makes one run after the other with a separate process, and halts the other threads after an error.
    fn work(&self, own: &[usize], progress: &SharedProgress) -> Result<Vec<(usize, RunOutputs)>> {
        let result = self.work_off(own, progress);
        result.inspect_err(|_| progress.halt.store(true, Ordering::Relaxed))
    }

    /// Makes runs of a thread's own points, repeats them, then makes those that are next.
    fn work_off(&self, own: &[usize], progress: &SharedProgress) -> Result<Vec<(usize, RunOutputs)>> {
        let (mut outcomes, mut worker) = (Vec::new(), None);
        while !self.workers.stop.load(Ordering::Relaxed) && !progress.halt.load(Ordering::Relaxed) {
            let own_next = own.get(outcomes.len());
            let next = own_next.or_else(|| self.missing.get(progress.next.fetch_add(1, Ordering::Relaxed)));
            let Some(&index) = next else { break };
            let Some(outcome) = self.attempt(&self.points[index], &mut worker)? else { return Ok(outcomes) };
            outcomes.push((index, outcome));
            (self.done)();
            if outcomes.len() == own.len() {
                self.repeat(&outcomes, &mut worker)?;
            }
        }
        if let Some(IdleWorker { process, .. }) = worker {
            process.finish();
        }
        Ok(outcomes)
    }

    /// One run, with retries, which the journal keeps; none if the program must stop.
    fn attempt(&self, point: &[f64], worker: &mut Option<IdleWorker>) -> Result<Option<RunOutputs>> {
        let begin = Instant::now();
        let Some(outcome) = self.try_run(point, worker)? else { return Ok(None) };
        match (&outcome, self.journal) {
            (Ok(outputs), Some(journal)) => journal.keep(point, outputs, begin.elapsed())?,
            (Ok(_), None) => {}
            (Err(failure), _) => (self.failure)(point, failure)?,
        }
        Ok(Some(outcome))
    }

    /// One run, with retries; none if the program must stop.
    pub(super) fn try_run(&self, point: &[f64], worker: &mut Option<IdleWorker>) -> Result<Option<RunOutputs>> {
        let (limit, stop) = (self.model.time_limit, self.workers.stop);
        let mut failure = RunFailure::senseless_reply();
        for _ in 0..=self.model.retries {
            let (started, memory) = match worker.take() {
                Some(IdleWorker { process, memory }) => (Some(process), memory),
                None => (self.launcher.start(limit, self.workers)?, MemoryWatch::default()),
            };
            // a process in which something goes wrong is not trusted any more
            let Some(mut process) = started else { return Ok(None) };
            failure = match process.run(&self.model.request(point), limit, stop) {
                WorkerReply::Done(outputs) if outputs.len() == self.model.values => {
                    *worker = self.idle(process, memory);
                    return Ok(Some(Ok(outputs)));
                }
                WorkerReply::Done(_) => RunFailure::senseless_reply(),
                WorkerReply::Failed(failure) => failure,
                WorkerReply::TimedOut => {
                    let message = format!("took longer than {limit:?} (source.time_limit)");
                    RunFailure::new(FailureCause::TimeLimit, message)
                }
                WorkerReply::Stopped => return Ok(None),
            };
        }
        Ok(Some(Err(failure)))
    }

    /// The process after a run; none if the next run needs a fresh one.
    fn idle(&self, process: Box<dyn WorkerProcess>, mut memory: MemoryWatch) -> Option<IdleWorker> {
        if process.is_spent() {
            return None;
        }
        if memory.is_exceeded(self.model.memory_limit, || process.memory()) {
            process.finish();
            return None;
        }
        Some(IdleWorker { process, memory })
    }
}

impl MemoryWatch {
    /// Returns true after a run that leaves the process with more memory than the study's limit. Without one, the limit is the
    /// default, or twice the memory after the first run.
    fn is_exceeded(&mut self, of_study: Option<u64>, measure: impl FnOnce() -> Option<u64>) -> bool {
        let begin = Instant::now();
        if self.later.is_some_and(|later| begin < later) {
            return false;
        }
        let Some(bytes) = measure() else { return false };
        self.later = Some(begin + BETWEEN * begin.elapsed());
        let limit = *self.limit.get_or_insert(of_study.unwrap_or(MEMORY.max(bytes.saturating_mul(2))));
        bytes > limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Replacement of a process that has this memory after each of three runs.
    fn replaced(of_study: Option<u64>, megabytes: [u64; 3]) -> [bool; 3] {
        let mut watch = MemoryWatch::default();
        megabytes.map(|size| {
            watch.later = None;
            watch.is_exceeded(of_study, || Some(1_000_000 * size))
        })
    }

    #[test]
    fn a_process_may_have_twice_the_memory_of_its_first_run() {
        assert_eq!(replaced(None, [3000, 5900, 6100]), [false, false, true]);
        assert_eq!(replaced(None, [10, 990, 1010]), [false, false, true]);
        assert_eq!(replaced(Some(20_000_000), [10, 19, 21]), [false, false, true]);
        assert!(!MemoryWatch::default().is_exceeded(Some(1), || None));
    }
}
