//! Choice between all members of a team and the caller alone for a training's steps.
//!
//! Together, members divide the arithmetic of a step but have to exchange gradients and parameters through the caches.
//! This takes longer than a small step if their cores are far apart or busy with other work. So both are tried, again
//! and again. The network is the same, since results do not depend on the members that compute them.

/// Seconds of a trial's steps of each kind: enough for threads that were asleep to be given a core.
const TRIAL: f64 = 0.01;

/// Seconds from the end of one trial to the next.
const PERIOD: f64 = 0.4;

/// Steps of each kind in a trial, at least and at most.
const STEPS: [usize; 2] = [32, 4096];

/// Times both, then uses the faster one for a while.
pub(super) struct Pace {
    phase: Phase,
    /// Since the phase began.
    seconds: f64,
    /// Seconds of each step of a trial's phase.
    times: Vec<f64>,
    /// Median seconds of the steps together.
    together: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    TryTogether,
    TryAlone,
    Decided { alone: bool },
}

impl Pace {
    pub(super) fn new() -> Self {
        Self { phase: Phase::TryTogether, seconds: 0.0, times: Vec::with_capacity(STEPS[1]), together: 0.0 }
    }

    /// Returns true if the caller should do the next step alone.
    pub(super) fn alone(&self) -> bool {
        matches!(self.phase, Phase::TryAlone | Phase::Decided { alone: true })
    }

    /// To be called after every step with its time.
    pub(super) fn took(&mut self, seconds: f64) {
        self.seconds += seconds;
        if let Phase::Decided { .. } = self.phase {
            if self.seconds >= PERIOD {
                self.begin(Phase::TryTogether);
            }
            return;
        }
        self.times.push(seconds);
        let enough = self.seconds >= TRIAL && self.times.len() >= STEPS[0];
        if !enough && self.times.len() < STEPS[1] {
            return;
        }
        let median = median_of_later_half(&mut self.times);
        if self.phase == Phase::TryTogether {
            self.together = median;
            self.begin(Phase::TryAlone);
        } else {
            self.begin(Phase::Decided { alone: median < self.together });
        }
    }

    fn begin(&mut self, phase: Phase) {
        self.phase = phase;
        self.seconds = 0.0;
        self.times.clear();
    }
}

/// The first half may pass before threads are where they stay. Not the mean: some steps have more to do than others, or
/// lose their core.
fn median_of_later_half(times: &mut [f64]) -> f64 {
    let half = times.len() / 2;
    let later = &mut times[half..];
    later.sort_unstable_by(f64::total_cmp);
    later[later.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds of a period that are spent alone, without those of the trial at its beginning.
    fn alone(pace: &mut Pace, seconds: impl Fn(bool, usize) -> f64) -> f64 {
        let (mut all, mut alone) = (0.0, 0.0);
        for step in 0.. {
            let took = seconds(pace.alone(), step);
            if let Phase::Decided { alone: decided } = pace.phase {
                all += took;
                alone += if decided { took } else { 0.0 };
            }
            pace.took(took);
            if all > 0.0 && pace.phase == Phase::TryTogether {
                break;
            }
        }
        alone / all
    }

    #[test]
    fn the_faster_way_does_all_steps_but_those_of_the_trial() {
        for scale in [1e-5, 1e-3, 0.1] {
            let mut pace = Pace::new();
            // every tenth step has more to do, and threads that wake up are slow
            let other = |step: usize| if step.is_multiple_of(10) { 9.0 * scale } else { 0.0 };
            let slow_start = |step: usize| if step < 12 { 9.0 * scale } else { other(step) };
            assert_eq!(alone(&mut pace, |alone, step| scale * if alone { 2.0 } else { 1.0 } + slow_start(step)), 0.0);
            // and it finds out when that changes
            assert_eq!(alone(&mut pace, |alone, step| scale * if alone { 1.0 } else { 2.0 } + other(step)), 1.0);
        }
    }
}
