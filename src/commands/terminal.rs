//! What a pipeline tells, on stderr: a bar on a terminal, a few lines elsewhere.

use super::{
    heard, interrupt,
    messages::{Verbosity, verbosity},
    say, warn,
};
use indicatif::{HumanCount, HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use metafmu::{
    Error, Result,
    fmi::Workers,
    pipeline::{Control, CountedWork, Event, PipelineObserver},
};
use std::{
    fmt::{Arguments, Write},
    io::IsTerminal,
    path::{Path, PathBuf},
    sync::{Mutex, OnceLock, PoisonError},
    time::{Duration, Instant},
};

/// Time between two messages of a bar.
const BETWEEN: Duration = Duration::from_millis(100);

static TERMINAL: Terminal =
    Terminal { shown: Mutex::new(ProgressBarState { bar: None, on_terminal: false, at: None }) };

/// Removes the bar that a stage has left because of an error.
pub fn end() {
    TERMINAL.event(Event::End);
}

/// What a pipeline gets from this command.
pub fn control() -> Result<Control<'static>> {
    let observer = &TERMINAL;
    Ok(Control { observer, stop: interrupt::flag(), program: program()?, heard })
}

/// What worker processes get from this command.
pub fn workers() -> Result<Workers<'static>> {
    Ok(Workers { program: program()?, stop: interrupt::flag() })
}

static PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// Names the program that worker processes run; the first one counts.
pub fn set_program(program: &Path) {
    let _ = PROGRAM.set(program.to_owned());
}

/// This program.
fn program() -> Result<&'static Path> {
    if let Some(program) = PROGRAM.get() {
        return Ok(program);
    }
    let program = std::env::current_exe().map_err(Error::io(Path::new("metafmu"), "find"))?;
    Ok(PROGRAM.get_or_init(|| program))
}

/// Shows one stage after the other.
struct Terminal {
    shown: Mutex<ProgressBarState>,
}

/// Progress bar of the current work.
struct ProgressBarState {
    bar: Option<ProgressBar>,
    on_terminal: bool,
    /// When its message was changed.
    at: Option<Instant>,
}

impl PipelineObserver for Terminal {
    fn event(&self, event: Event<'_>) {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            Event::Begin { work, total } => {
                shown.end();
                *shown = ProgressBarState::begin(work, total);
            }
            Event::Advance => shown.bar.iter().for_each(|bar| bar.inc(1)),
            Event::Progress { done, about } => shown.set(done, about),
            Event::End => shown.end(),
            Event::Note(line) if !shown.on_terminal || verbosity() == Verbosity::Verbose => {
                shown.write(|| say(line));
            }
            Event::Note(_) => {}
            Event::Message(line) => shown.write(|| say(line)),
            Event::Warning(line) => shown.write(|| warn(line)),
        }
    }
}

impl ProgressBarState {
    fn begin(work: CountedWork, total: usize) -> Self {
        let template = match work {
            CountedWork::Runs => "sampling {bar:30} {pos}/{len} runs, {speed}, {left} left",
            CountedWork::Equations => "asking for equations {bar:30} {pos}/{len} batches of states, {left} left",
            CountedWork::Steps => "training {bar:30} {percent}%, {msg}",
            CountedWork::Networks => "training {bar:30} {pos}/{len} networks, {msg}, {left} left",
            CountedWork::Trials { rung, rungs } => {
                &format!("rung {rung} of {rungs} {{bar:30}} {{pos}}/{{len}} trials, {{left}} left")
            }
            CountedWork::Rows => "predicting {bar:30} {percent}%, {msg}, {elapsed}",
            CountedWork::Models => "comparing {bar:30} {pos}/{len} models, {msg}, {elapsed}",
        };
        let length = total as u64;
        let bar = ProgressBar::new(length);
        if verbosity() == Verbosity::Quiet {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let style = style.with_key("speed", |state: &ProgressState, text: &mut dyn Write| {
            let _ = write!(text, "{}/s", rounded(speed(state)));
        });
        bar.set_style(style.with_key("left", move |state: &ProgressState, text: &mut dyn Write| {
            // nothing is known before the first is done
            let left = Duration::try_from_secs_f64(length.saturating_sub(state.pos()) as f64 / speed(state));
            let _ = match left {
                Ok(left) => write!(text, "{:#}", HumanDuration(left)),
                Err(_) => text.write_char('?'),
            };
        }));
        let on_terminal = std::io::stderr().is_terminal();
        if on_terminal {
            // speed and time left go on while nothing is done
            bar.enable_steady_tick(Duration::from_millis(500));
        }
        Self { bar: Some(bar), on_terminal, at: None }
    }

    /// Moves the bar, if a person could read a new message by now.
    fn set(&mut self, done: usize, about: Arguments<'_>) {
        let Some(bar) = self.bar.as_ref().filter(|_| self.on_terminal) else { return };
        if self.at.is_none_or(|at| at.elapsed() > BETWEEN) {
            self.at = Some(Instant::now());
            bar.set_message(about.to_string());
            bar.set_position(done as u64);
        }
    }

    /// Writes a line that stays.
    fn write(&self, line: impl FnOnce()) {
        match &self.bar {
            Some(bar) => bar.suspend(line),
            None => line(),
        }
    }

    fn end(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

/// A speed with no more digits than a person reads: whole numbers from 10 on.
fn rounded(speed: f64) -> String {
    match speed {
        speed if speed >= 9.95 => HumanCount(speed.round() as u64).to_string(),
        speed if speed >= 0.095 => format!("{speed:.1}"),
        speed => format!("{speed:.1e}"),
    }
}

/// What is done in a second: of late, or from the beginning if that is less, so that it falls at once when nothing moves.
fn speed(state: &ProgressState) -> f64 {
    state.per_sec().min(state.pos() as f64 / state.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_speed_is_rounded_as_people_read() {
        for (speed, expected) in
            [(1994.9262, "1,995"), (12.34, "12"), (9.96, "10"), (1.26, "1.3"), (0.0123, "1.2e-2"), (0.0, "0.0e0")]
        {
            assert_eq!(rounded(speed), expected, "{speed}");
        }
    }
}
