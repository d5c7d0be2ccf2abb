//! Cost limit of a run.
//!
//! Cost is counted in evaluations of the right-hand side, so that the same runs are abandoned on every machine. Seconds
//! count only where a study limits them. A run may take [`EVALUATIONS`] in all. They are spread evenly over its time,
//! with an allowance of [`AHEAD`], so that a run that would need many more is abandoned early. At every time it must
//! progress at a rate that would complete it.

use std::{
    cell::Cell,
    fmt,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

/// Evaluations of a run that is simulated to its end.
const EVALUATIONS: f64 = 2e7;
/// Evaluations that a part of a run may take beyond its share, for instance an impact.
const AHEAD: f64 = 5e5;
/// Evaluations after which a run must have got on.
const WINDOW: u64 = 1 << 14;
/// A run that would take this many at the rate of the last window has come to a standstill.
const STANDSTILL: f64 = 1e10;
/// Evaluations between two looks at the clock and at the flags.
const LOOK: u64 = 1 << 8;

/// Cost limit of a run, and its cost so far.
#[derive(Debug, Default)]
pub struct Budget<'a> {
    stops: &'a [&'a AtomicBool],
    /// The time at which the run began, and its time limit.
    clock: Option<(Instant, Duration)>,
    start: Cell<f64>,
    duration: Cell<f64>,
    reached: Cell<f64>,
    last_step: Cell<f64>,
    evaluations: Cell<u64>,
    /// Progress at the beginning of the window.
    window: Cell<f64>,
    end: Cell<Option<StopCause>>,
}

/// Reason why a run is abandoned before its end.
#[derive(Clone, Debug, PartialEq)]
pub struct BudgetError {
    /// Kind of the reason.
    pub cause: StopCause,
    /// Simulated time that the run has reached, in s.
    pub t: f64,
    /// A sentence for people.
    pub message: String,
}

/// Kinds of reasons why a run is abandoned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopCause {
    /// A flag ended the run.
    Stopped,
    /// The run took longer than the study's `source.time_limit`.
    TimeLimit,
    /// The run needs too many evaluations.
    Evaluations,
}

impl fmt::Display for BudgetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for BudgetError {}

impl<'a> Budget<'a> {
    /// For a run that begins now, ends early when one of the flags turns true, and may take so long.
    pub fn new(stops: &'a [&'a AtomicBool], time_limit: Option<Duration>) -> Self {
        Self { stops, clock: time_limit.map(|limit| (Instant::now(), limit)), ..Self::default() }
    }

    /// The times of a run; without this the evaluations are not limited.
    pub fn begin(&self, times: &[f64]) {
        if let [start, .., stop] = times {
            self.start.set(*start);
            self.duration.set(stop - start);
            self.reached.set(*start);
        }
    }

    /// Counts an evaluation; returns false if the run must be abandoned.
    pub fn spend(&self) -> bool {
        let spent = self.evaluations.get() + 1;
        self.evaluations.set(spent);
        if spent.is_multiple_of(LOOK) {
            self.look(spent);
        }
        !self.is_over()
    }

    fn look(&self, spent: u64) {
        let progress = self.progress();
        if self.stops.iter().any(|stop| stop.load(Ordering::Relaxed)) {
            self.end.set(Some(StopCause::Stopped));
        } else if self.clock.is_some_and(|(begin, limit)| begin.elapsed() > limit) {
            self.end.set(Some(StopCause::TimeLimit));
        } else if spent as f64 > AHEAD + EVALUATIONS * progress {
            self.end.set(Some(StopCause::Evaluations));
        } else if spent.is_multiple_of(WINDOW) {
            if progress - self.window.get() < WINDOW as f64 / STANDSTILL {
                self.end.set(Some(StopCause::Evaluations));
            }
            self.window.set(progress);
        }
    }

    /// Notes the time that the run has reached.
    pub fn arrive(&self, t: f64) {
        if t > self.reached.get() {
            self.last_step.set(t - self.reached.get());
            self.reached.set(t);
        }
    }

    /// The simulated time at which the run begins.
    pub fn start(&self) -> f64 {
        self.start.get()
    }

    /// Begins anew from where the run is, for another method, if the evaluations are spent.
    pub fn renew(&self) {
        if self.is_spent() {
            self.end.set(None);
            self.evaluations.set((EVALUATIONS * self.progress()) as u64);
            self.window.set(f64::NEG_INFINITY);
        }
    }

    /// Part of the run that is done.
    fn progress(&self) -> f64 {
        (self.reached.get() - self.start.get()) / self.duration.get()
    }

    /// Number of evaluations until now.
    pub fn spent(&self) -> u64 {
        self.evaluations.get()
    }

    /// The simulated time that the run has reached.
    pub fn reached(&self) -> f64 {
        self.reached.get()
    }

    /// Length of the latest step.
    pub fn last_step(&self) -> f64 {
        self.last_step.get()
    }

    /// Returns true if the evaluations are spent.
    pub fn is_spent(&self) -> bool {
        matches!(self.end.get(), Some(StopCause::Evaluations))
    }

    /// Returns true if the run must be abandoned.
    pub fn is_over(&self) -> bool {
        self.end.get().is_some()
    }

    /// Fails if the run must be abandoned; `obstacle` may explain why the equations cannot be integrated.
    ///
    /// # Errors
    /// The reason why the run is abandoned, with its effort so far.
    pub fn check(&self, obstacle: impl FnOnce() -> Option<String>) -> Result<(), BudgetError> {
        let Some(cause) = self.end.get() else { return Ok(()) };
        let t = self.reached.get();
        let message = match (cause, self.clock) {
            (StopCause::TimeLimit, Some((_, limit))) => {
                format!("took longer than {limit:?} (source.time_limit) and came to t = {t} s")
            }
            (StopCause::Evaluations, _) => {
                let (spent, step) = (self.evaluations.get(), self.last_step.get());
                let obstacle =
                    obstacle().unwrap_or_else(|| "the motion is too fast, or the equations are too stiff".into());
                format!("given up at t = {t} s after {spent} evaluations, the last step was {step:.1e} s: {obstacle}")
            }
            _ => format!("stopped at t = {t} s"),
        };
        Err(BudgetError { cause, t, message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evaluations until the end of a run that advances by this much in each of them.
    fn spent(step: f64) -> u64 {
        let budget = Budget::default();
        budget.begin(&[0.0, 1.0, 2.0]);
        (1..)
            .find(|&count| {
                budget.arrive(step * count as f64);
                !budget.spend() || budget.reached() >= 2.0
            })
            .unwrap_or(0)
    }

    #[test]
    fn a_run_that_cannot_come_to_its_end_is_given_up_early_and_one_that_can_is_not() {
        assert!((10_000_000..=10_000_001).contains(&spent(2e-7)));
        assert!((500_000..600_000).contains(&spent(1e-9)));
        assert_eq!(spent(1e-11), WINDOW);
    }

    #[test]
    fn a_flag_and_the_clock_end_a_run() {
        let flag = AtomicBool::new(false);
        let flags = [&flag];
        let budget = Budget::new(&flags, None);
        assert!((0..1000).all(|_| budget.spend()));
        flag.store(true, Ordering::Relaxed);
        assert!(!(0..1000).all(|_| budget.spend()));
        let message = "stopped at t = 0 s".into();
        assert_eq!(budget.check(|| None), Err(BudgetError { cause: StopCause::Stopped, t: 0.0, message }));
        let budget = Budget::new(&[], Some(Duration::ZERO));
        assert!(!(0..1000).all(|_| budget.spend()));
        let BudgetError { cause, message, .. } = budget.check(|| None).unwrap_err();
        assert_eq!(cause, StopCause::TimeLimit);
        assert!(message.starts_with("took longer than 0ns (source.time_limit)"), "{message}");
    }
}
