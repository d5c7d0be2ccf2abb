//! Link between a pipeline and the program around it: its observer, its stop token, and the program of its worker
//! processes.

use std::{
    fmt::{Arguments, Debug},
    path::Path,
    sync::atomic::AtomicBool,
};

/// Work that is counted while it is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CountedWork {
    /// Simulated runs.
    Runs,
    /// Batches of states at which a source evaluates its equations.
    Equations,
    /// Optimizer steps of a training.
    Steps,
    /// Networks, one per instant.
    Networks,
    /// Trials of a rung of a search; rungs are counted from one.
    Trials {
        /// The rung at hand.
        rung: usize,
        /// How many there are.
        rungs: usize,
    },
    /// Models of a comparison.
    Models,
    /// Thousandths of the rows of a table.
    Rows,
}

/// Event in a pipeline. Only observers that show a text format it.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// Work begins.
    Begin {
        /// Kind of the units.
        work: CountedWork,
        /// Number of units.
        total: usize,
    },
    /// One more unit is done.
    Advance,
    /// Number of units done in all.
    Progress {
        /// Number of units.
        done: usize,
        /// The state of the work, for instance the loss.
        about: Arguments<'a>,
    },
    /// The work has ended.
    End,
    /// A line about the progress, for those who do not show every [`Event::Progress`].
    Note(Arguments<'a>),
    /// A result or a decision.
    Message(Arguments<'a>),
    /// Problem that the user should check.
    Warning(Arguments<'a>),
}

/// Observer of a pipeline; called from any thread.
pub trait PipelineObserver: Sync {
    /// Something happens.
    fn event(&self, event: Event<'_>);
}

/// Ignores all events.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl PipelineObserver for Silent {
    fn event(&self, _: Event<'_>) {}
}

/// Control of a pipeline by the program around it.
#[derive(Clone, Copy)]
pub struct Control<'a> {
    /// Receives the events.
    pub observer: &'a dyn PipelineObserver,
    /// Ends the work when it turns true: a training keeps its best network and clears it, everything else is an
    /// [`Error::Interrupted`](crate::Error::Interrupted).
    pub stop: &'a AtomicBool,
    /// The program that is started for each worker process: `metafmu`, or one that behaves like it when its argument is
    /// [`worker::ARGUMENT`](crate::fmi::worker::ARGUMENT) or [`FIT_BASELINE`](crate::pipeline::compare::FIT_BASELINE). FMUs as
    /// sources, the validation of FMUs and baselines need it.
    pub program: &'a Path,
    /// Takes each line that an FMU prints.
    pub heard: fn(&str),
}

impl Debug for Control<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Control").field("stop", self.stop).field("program", &self.program).finish_non_exhaustive()
    }
}
