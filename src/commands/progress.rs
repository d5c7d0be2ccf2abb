//! Progress on stderr: a bar on a terminal, a few lines elsewhere.

use super::say;
use indicatif::{HumanDuration, HumanFloatCount, ProgressBar, ProgressState, ProgressStyle};
use metafmu::training::Outcome;
use std::{
    fmt::Write,
    io::IsTerminal,
    time::{Duration, Instant},
};

/// Progress of one stage.
pub struct Progress {
    bar: ProgressBar,
    on_terminal: bool,
    shown: Option<Instant>,
}

impl Progress {
    /// Counts simulated runs.
    pub fn runs(count: usize) -> Self {
        Self::new(count as u64, "sampling {bar:30} {pos}/{len} runs, {speed}, {left} left")
    }

    /// Counts optimizer steps; the message is the loss.
    pub fn steps(count: usize) -> Self {
        Self::new(count as u64, "training {bar:30} {percent}%, {msg}")
    }

    /// Counts the networks of a series; the message is the loss.
    pub fn networks(count: usize) -> Self {
        Self::new(count as u64, "training {bar:30} {pos}/{len} networks, {msg}, {left} left")
    }

    /// Counts the trials of a rung of a search.
    pub fn trials(count: usize, rung: usize, rungs: usize) -> Self {
        Self::new(count as u64, &format!("rung {rung} of {rungs} {{bar:30}} {{pos}}/{{len}} trials, {{left}} left"))
    }

    /// Counts baselines; the message is the one at hand.
    pub fn baselines(count: usize) -> Self {
        Self::new(count as u64, "comparing {bar:30} {pos}/{len} models, {msg}, {elapsed}")
    }

    fn new(length: u64, template: &str) -> Self {
        let bar = ProgressBar::new(length);
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let style = style.with_key("speed", |state: &ProgressState, text: &mut dyn Write| {
            let _ = write!(text, "{}/s", HumanFloatCount(speed(state)));
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
        Self { bar, on_terminal, shown: None }
    }

    pub fn advance(&self, by: u64) {
        self.bar.inc(by);
    }

    /// Whether a person could read a new message by now.
    pub fn is_due(&self) -> bool {
        self.on_terminal && self.shown.is_none_or(|shown| shown.elapsed() > Duration::from_millis(100))
    }

    /// Moves the bar to a position.
    pub fn set(&mut self, position: u64, message: String) {
        self.shown = Some(Instant::now());
        self.bar.set_message(message);
        self.bar.set_position(position);
    }

    /// A line that stays.
    pub fn warn(&self, line: &str) {
        self.bar.suspend(|| say(format_args!("warning: {line}")));
    }

    /// A line that stays; only where there is no bar.
    pub fn note(&self, line: &str) {
        if !self.on_terminal {
            say(line);
        }
    }

    /// A line that stays, of one more trial.
    pub fn trial(&self, line: &str) {
        self.bar.suspend(|| say(line));
        self.bar.inc(1);
    }

    /// One more network of a series.
    pub fn network(&mut self, outcome: &Outcome) {
        let loss = outcome.history.iter().map(|epoch| epoch.validation_loss).fold(f64::INFINITY, f64::min);
        self.bar.set_message(format!("the last one's loss on held-out runs {loss:.2e}"));
        self.bar.inc(1);
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0));
        if done.is_multiple_of(all.div_ceil(10).max(1)) || done == all {
            let left = self.bar.eta().as_secs();
            self.note(&format!("network {done}/{all}: loss on held-out runs {loss:.2e}, {left} s left"));
        }
    }

    /// Ends the bar.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// Ends the bar and leaves a line.
    pub fn finish(&self, line: &str) {
        self.bar.finish_and_clear();
        say(line);
    }
}

/// What is done in a second: of late, or from the beginning if that is less, so that it falls at once when nothing moves.
fn speed(state: &ProgressState) -> f64 {
    state.per_sec().min(state.pos() as f64 / state.elapsed().as_secs_f64())
}
