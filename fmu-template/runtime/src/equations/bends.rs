//! Narrow parts of functions: values of their arguments over which no step of a solver may jump.

use std::sync::Arc;

/// A value of an argument at which the slope of a function changes much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// The value.
    pub at: f64,
    /// Distance to the nearer neighbor: the shorter interval beside a knot of a table. Infinite without neighbors.
    pub width: f64,
}

/// The bends of a function along an argument.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bends {
    list: Vec<Bend>,
    start: f64,
    period: Option<f64>,
}

/// An argument of a function, and its bends. Arguments of one function form a group: parts between their bends are narrow, too.
#[derive(Clone, Debug, PartialEq)]
pub struct BentArgument {
    /// The bends.
    pub bends: Arc<Bends>,
    /// Number of the function.
    pub group: u32,
}

/// Values of an argument during a step of a solver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArgumentPath {
    /// At the beginning and at the end.
    ends: [f64; 2],
    lowest: f64,
    highest: f64,
}

/// Part of the distance to a bend that a step may cover.
const APPROACH: f64 = 0.9;
/// Part of the distance if the argument turns at the bend: it moves fastest at the beginning.
const APPROACH_OF_TURN: f64 = 0.45;
/// Share of a step in which an argument turns from which on the distance to the bend does not matter.
const NEAR_TURN: f64 = 1e-3;
/// Part of the distance to a turn by which the estimate of the turn may be off.
const UNCERTAIN: f64 = 0.05;
/// Shares of a step whose difference is rounding.
const COINCIDENT: f64 = 1e-9;

impl Bends {
    /// Bends in ascending order; with a period they are those from `start` on, over one period.
    pub fn new(list: Vec<Bend>, start: f64, period: Option<f64>) -> Self {
        Self { list, start, period }
    }

    /// Bends at values, in ascending order. Without a period the width of a bend is the distance to its neighbor.
    pub(crate) fn at(values: &[f64], period: Option<f64>) -> Self {
        // from the last one to the first one of the next period
        let between_periods = match (values, period) {
            ([first, ..], Some(period)) => period - (values[values.len() - 1] - first),
            _ => f64::INFINITY,
        };
        let bends = values.iter().enumerate().map(|(index, at)| {
            let before = index.checked_sub(1).map_or(between_periods, |before| (values[before] - at).abs());
            let after = values.get(index + 1).map_or(between_periods, |after| (after - at).abs());
            Bend { at: *at, width: before.min(after) }
        });
        Self { list: bends.collect(), start: 0.0, period }
    }

    /// The bends, in ascending order.
    pub fn list(&self) -> &[Bend] {
        &self.list
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Beginning of the first period.
    pub fn start(&self) -> f64 {
        self.start
    }

    /// Length after which the bends repeat themselves.
    pub fn period(&self) -> Option<f64> {
        self.period
    }

    /// The bends on a path: those in the period in which it begins, and in the next one.
    fn on(&self, path: &ArgumentPath) -> impl Iterator<Item = Bend> + '_ {
        let ArgumentPath { lowest, highest, .. } = *path;
        let shifts = match self.period {
            Some(period) => {
                let turned = ((lowest - self.start) / period).floor() * period;
                [turned, turned + period]
            }
            None => [0.0, f64::NAN],
        };
        shifts.into_iter().filter(|shift| shift.is_finite()).flat_map(move |shift| {
            let before = self.list.partition_point(|bend| bend.at + shift < lowest);
            let rest = self.list[before..].iter().map(move |bend| Bend { at: bend.at + shift, ..*bend });
            rest.take_while(move |bend| bend.at <= highest)
        })
    }
}

impl ArgumentPath {
    /// A path that does not move.
    pub fn at(value: f64) -> Self {
        Self { ends: [value; 2], lowest: value, highest: value }
    }

    /// Adds a later value, which is the end until another one is added.
    pub fn add(&mut self, value: f64) {
        self.ends[1] = value;
        self.lowest = self.lowest.min(value);
        self.highest = self.highest.max(value);
    }

    /// Adds the value at which the path turns between the first and the last of three points `(time, value)`, if it does: that of the
    /// parabola through them.
    #[inline]
    pub fn add_turn(&mut self, points: [[f64; 2]; 3]) {
        let [[begin, first], [middle, value], [end, last]] = points;
        let share = (middle - begin) / (end - begin);
        let (moved, part) = (last - first, value - first);
        let curvature = (part - share * moved) / (share * share - share);
        let slope = moved - curvature;
        let turn = -0.5 * slope / curvature;
        if turn > 0.0 && turn < 1.0 {
            let height = 0.5 * slope * turn;
            let margin = UNCERTAIN * height.abs().min((height - moved).abs());
            let reached = first + height + margin.copysign(-curvature);
            self.lowest = self.lowest.min(reached);
            self.highest = self.highest.max(reached);
        }
    }

    /// Share of the way up to a value.
    fn share_up_to(&self, value: f64) -> f64 {
        (value - self.ends[0]).abs() / (self.highest - self.lowest)
    }

    /// Share of the step that passes a bend in short steps, after few steps up to there.
    fn share_at(&self, bend: Bend) -> f64 {
        let [start, end] = self.ends;
        let up_to = self.share_up_to(bend.at);
        let share = (bend.width / (self.highest - self.lowest)).max(APPROACH * up_to);
        // passed twice: there and back again
        if (bend.at > start && bend.at > end) || (bend.at < start && bend.at < end) {
            return share.min(NEAR_TURN.max(APPROACH_OF_TURN * up_to));
        }
        share
    }
}

/// Bends on the way of a solver's step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOverBends {
    /// Share of the step, from 0 to 1, with which it misses nothing.
    pub share: f64,
    /// `true` if an argument passes a bend in the step.
    pub has_bend: bool,
}

/// The bends on the way of a step. Over a bend an argument may move by no more than the bend's width. Arguments of one function may not pass two
/// bends at once. The paths are those of the arguments.
pub fn step_over(arguments: &[BentArgument], paths: &[ArgumentPath]) -> StepOverBends {
    let (mut share, mut has_bend) = (1.0f64, false);
    for (index, (argument, path)) in arguments.iter().zip(paths).enumerate() {
        for bend in argument.bends.on(path) {
            has_bend = true;
            share = share.min(path.share_at(bend));
            let up_to = path.share_up_to(bend.at);
            for (earlier, path) in arguments[..index].iter().zip(paths).filter(|(it, _)| it.group == argument.group) {
                for bend in earlier.bends.on(path) {
                    let before = path.share_up_to(bend.at);
                    let between = (before - up_to).abs();
                    if between > COINCIDENT {
                        share = share.min(between.max(APPROACH * before.min(up_to)));
                    }
                }
            }
        }
    }
    StepOverBends { share, has_bend }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(values: &[f64]) -> ArgumentPath {
        let mut path = ArgumentPath::at(values[0]);
        values[1..].iter().for_each(|value| path.add(*value));
        path
    }

    fn share(bends: &[&Bends], paths: &[&[f64]]) -> f64 {
        let arguments: Vec<BentArgument> =
            bends.iter().map(|bends| BentArgument { bends: Arc::new((*bends).clone()), group: 0 }).collect();
        let paths: Vec<ArgumentPath> = paths.iter().map(|values| path(values)).collect();
        step_over(&arguments, &paths).share
    }

    #[test]
    fn a_step_passes_no_two_bends_of_a_function() {
        let hat = Bends::at(&[0.298, 0.3, 0.302], None);
        assert_eq!(share(&[&hat], &[&[0.0, 0.2]]), 1.0);
        assert!((share(&[&hat], &[&[0.0, 1.0]]) - 0.9 * 0.298).abs() < 1e-12);
        assert!((share(&[&hat], &[&[0.2975, 0.3075]]) - 0.2).abs() < 1e-9);
        // the bends of two arguments, one of which moves faster
        let [first, second] = [0.4, 0.9].map(|at| Bends::at(&[at], None));
        assert_eq!(share(&[&first], &[&[0.0, 1.0]]), 1.0);
        assert!((share(&[&first, &second], &[&[0.0, 1.0], &[0.0, 2.0]]) - 0.9 * 0.4).abs() < 1e-12);
        assert_eq!(share(&[&first, &second], &[&[0.0, 1.0], &[0.0, 0.8]]), 1.0);
    }

    #[test]
    fn a_bend_that_is_passed_twice_is_approached() {
        let only = Bends::at(&[1.0], None);
        assert_eq!(share(&[&only], &[&[2.0, 0.5, 0.0]]), 1.0);
        assert!((share(&[&only], &[&[3.0, 0.5, 3.5]]) - 0.45 * 2.0 / 3.0).abs() < 1e-12);
        // a parabola whose values at 0, 0.3 and 1 do not reach the bend
        let mut turning = ArgumentPath::at(3.0);
        let at = |share: f64| 0.99 + 2.01 * (1.0 - 2.0 * share).powi(2);
        [0.2, 0.8, 1.0].iter().for_each(|share| turning.add(at(*share)));
        assert_eq!(only.on(&turning).count(), 0);
        turning.add_turn([0.0, 0.3, 1.0].map(|share| [share, at(share)]));
        assert_eq!(only.on(&turning).count(), 1);
    }

    #[test]
    fn periodic_bends_are_passed_in_every_period() {
        let detent = Bends::at(&[0.1, 0.101], Some(0.5));
        assert!((share(&[&detent], &[&[10.0, 10.25]]) - 0.9 * 0.1 / 0.25).abs() < 1e-9);
        assert!((share(&[&detent], &[&[-0.05, -0.25]]) - 1.0).abs() < 1e-9);
        assert!((share(&[&detent], &[&[-0.25, -0.65]]) - 0.9 * 0.149 / 0.4).abs() < 1e-9);
    }
}
