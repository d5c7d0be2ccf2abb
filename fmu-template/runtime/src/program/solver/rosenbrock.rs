//! Stages of the method Rodas5P: Rosenbrock's type, order 5, L-stable and stiffly accurate, with an embedded method of order 4.
//!
//! With `W = 1 / (gamma h) - J` and `W U_i = f(t + c_i h, y + sum a_ij U_j) + sum C_ij / h U_j + h d_i f_t` a step ends at
//! `y + sum m_j U_j`; its error is about `U_8` (Steinebach: *Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within
//! the Julia Differential Equations package*, BIT 63, 2023). The Jacobian `J` and `f_t` are differences.

use super::{Drive, LANES, STAGES, Solver, without_rounding};

/// Stages.
const COUNT: usize = 8;
/// `gamma`.
const GAMMA: f64 = 0.211_937_563_194_290_14;
/// `c`.
pub(super) const TIMES: [f64; COUNT] = [
    0.0,
    0.635_812_689_582_870_4,
    0.409_579_839_339_753_5,
    0.976_930_672_506_071_6,
    0.428_840_360_955_866_4,
    1.0,
    1.0,
    1.0,
];
/// `d`; zero after these.
const BY_TIME: [f64; COUNT] = [
    0.211_937_563_194_290_14,
    -0.423_875_126_388_580_27,
    -0.338_462_712_623_592_4,
    1.804_645_287_288_273_4,
    2.325_825_639_765_069,
    0.0,
    0.0,
    0.0,
];
/// Rows of `a`; the row of the result, `m`, is the last one and ones. The last rows differ by ones.
const WEIGHTS: [&[f64]; 6] = [
    &[],
    &[3.0],
    &[2.849_394_379_747_939, 0.458_422_422_044_639_23],
    &[-6.954_028_509_809_101, 2.489_845_061_869_568, -10.358_996_098_473_584],
    &[2.802_998_627_562_896_4, 0.507_246_473_622_820_6, -0.398_831_254_177_052_4, -0.047_211_872_304_046_41],
    &[
        -7.502_846_399_306_121,
        2.561_846_144_803_919,
        -11.627_539_656_261_098,
        -0.182_687_676_599_422_56,
        0.030_198_172_008_377_946,
    ],
];
/// Rows of `C`.
const COUPLINGS: [&[f64]; COUNT] = [
    &[],
    &[-14.155_112_264_123_755],
    &[-17.972_960_358_859_52, -2.859_693_295_451_294],
    &[147.121_502_757_117_16, -1.412_214_027_182_13, 71.689_402_513_023_58],
    &[165.435_170_248_716_76, -0.459_282_345_649_112_6, 42.909_383_369_586_03, -5.961_986_721_573_306],
    &[
        24.854_864_614_690_072,
        -3.000_922_700_283_218_6,
        47.493_111_002_076_8,
        5.581_419_782_155_812_5,
        -0.661_069_182_524_947_1,
    ],
    &[
        30.912_732_140_285_99,
        -3.120_824_334_993_797_4,
        77.799_546_460_708_92,
        34.286_460_282_947_83,
        -19.097_331_116_725_623,
        -28.087_943_162_872_662,
    ],
    &[
        37.802_771_233_905_63,
        -3.257_196_902_907_227_6,
        112.269_188_494_963_27,
        66.934_723_124_404_7,
        -40.066_189_370_910_02,
        -54.667_802_628_779_68,
        -9.488_616_523_096_27,
    ],
];
/// The last part of the arguments with bends.
const LAST: usize = STAGES - 1;
/// Part of a step over which the derivative with respect to time is a difference.
const SHORT: f64 = 1e-6;

/// Gives the rates of the states at a point, and the arguments with bends. Not generic: the equations decide the time.
type Respond<'a> = dyn FnMut(&[f64], &mut [f64], &mut [f64]) + 'a;

/// Working memory of the method.
#[derive(Clone, Debug)]
pub(super) struct Rosenbrock {
    /// Columns of `J`, those of `W` factorised, the derivative of the rates with respect to time, the rates at a stage, and `U` of all stages.
    memory: Vec<f64>,
    pivots: Vec<usize>,
}

/// The parts of the working memory.
struct RosenbrockParts<'a> {
    jacobian: &'a mut [f64],
    factors: &'a mut [f64],
    by_time: &'a mut [f64],
    rates: &'a mut [f64],
    changes: &'a mut [f64],
    pivots: &'a mut [usize],
}

/// `to += factor * from`, as far as the shorter one reaches. Not inlined: the library stays small.
#[inline(never)]
fn add(to: &mut [f64], factor: f64, from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}

impl Rosenbrock {
    pub(super) fn new(states: usize) -> Self {
        Self { memory: vec![0.0; (2 * states + 2 + COUNT) * states], pivots: vec![0; states] }
    }

    /// Estimate of the error of each state.
    pub(super) fn error(&self) -> &[f64] {
        &self.memory[self.memory.len() - self.pivots.len()..]
    }

    fn parts(&mut self) -> RosenbrockParts<'_> {
        let (n, pivots) = (self.pivots.len(), &mut *self.pivots);
        let (jacobian, rest) = self.memory.split_at_mut(n * n);
        let (factors, rest) = rest.split_at_mut(n * n);
        let (by_time, rest) = rest.split_at_mut(n);
        let (rates, changes) = rest.split_at_mut(n);
        RosenbrockParts { jacobian, factors, by_time, rates, changes, pivots }
    }
}

impl RosenbrockParts<'_> {
    /// Factorises `1 / (gamma h) - J`, with the largest pivots: columns of `P W = L R`. A singular matrix makes NaN.
    fn factorise(&mut self, h: f64) {
        let Self { jacobian, factors, pivots, .. } = self;
        let n = pivots.len();
        factors.fill(0.0);
        add(factors, -1.0, jacobian);
        factors.iter_mut().step_by(n + 1).for_each(|diagonal| *diagonal += 1.0 / (GAMMA * h));
        for k in 0..n {
            let (before, rest) = factors.split_at_mut((k + 1) * n);
            let column = &mut before[k * n..];
            let mut pivot = k;
            for row in k + 1..n {
                if column[row].abs() > column[pivot].abs() {
                    pivot = row;
                }
            }
            pivots[k] = pivot;
            column.swap(k, pivot);
            let largest = column[k];
            column[k + 1..].iter_mut().for_each(|value| *value /= largest);
            for later in rest.chunks_exact_mut(n) {
                later.swap(k, pivot);
                let value = later[k];
                add(&mut later[k + 1..], -value, &column[k + 1..]);
            }
        }
    }

    /// Solves `W U = rates` for a stage.
    fn solve(&mut self, stage: usize) {
        let Self { factors, rates, changes, pivots, .. } = self;
        let n = pivots.len();
        let side = &mut changes[stage * n..][..n];
        side.copy_from_slice(rates);
        // rows of earlier columns were not exchanged
        for (k, column) in factors.chunks_exact(n).enumerate() {
            side.swap(k, pivots[k]);
            let value = side[k];
            add(&mut side[k + 1..], -value, &column[k + 1..]);
        }
        for (k, column) in factors.chunks_exact(n).enumerate().rev() {
            side[k] /= column[k];
            let value = side[k];
            add(&mut side[..k], -value, column);
        }
    }
}

impl Solver {
    /// Makes a step of size `h`, `since` seconds after the beginning, whose first rates are known. Leaves its end in the columns of the stage. A
    /// step is repeated with the same Jacobian.
    #[inline(never)]
    pub(super) fn implicit_stages(
        &mut self,
        point: &[f64],
        (since, h): (f64, f64),
        is_repeated: bool,
        drive: Drive,
        respond: &mut Respond,
    ) {
        let n = self.before.len();
        if !is_repeated {
            self.find_jacobian(point, (since, h), drive, respond);
        }
        self.implicit.parts().factorise(h);
        for stage in 0..COUNT {
            let RosenbrockParts { rates, changes, .. } = self.implicit.parts();
            let states = &mut self.stage[self.states.clone()];
            states.copy_from_slice(&point[self.states.clone()]);
            let weights = WEIGHTS[stage.min(5)].iter().chain(&[1.0; 2][..stage.saturating_sub(5)]);
            for (weight, changes) in weights.zip(changes.chunks_exact(n)) {
                add(states, *weight, changes);
            }
            if stage == 0 {
                rates.copy_from_slice(&self.rates.as_flattened()[..n]);
            } else {
                self.respond_at(point, (since + TIMES[stage] * h, stage.min(LAST)), drive, respond);
            }
            let mut parts = self.implicit.parts();
            for (weight, changes) in COUPLINGS[stage].iter().zip(parts.changes.chunks_exact(n)) {
                add(parts.rates, weight / h, changes);
            }
            add(parts.rates, h * BY_TIME[stage], parts.by_time);
            parts.solve(stage);
        }
        add(&mut self.stage[self.states.clone()], 1.0, self.implicit.error());
    }

    /// The rates at the stage, with inputs of a time; arguments with bends go to this part of them.
    fn respond_at(&mut self, point: &[f64], (later, part): (f64, usize), drive: Drive, respond: &mut Respond) {
        for (column, range) in self.inputs.clone().zip(&self.ranges) {
            let value = without_rounding(drive.at(column, point[column], later), *range);
            self.stage[column] = drive.clamp.map_or(value, |domain| domain.clamp(column, value));
        }
        let bent = self.bent.len();
        respond(&self.stage, self.implicit.parts().rates, &mut self.arguments[part * bent..][..bent]);
    }

    /// The Jacobian, and the derivative with respect to time if inputs change, at the beginning of a step.
    fn find_jacobian(&mut self, point: &[f64], (since, h): (f64, f64), drive: Drive, respond: &mut Respond) {
        let (n, first) = (self.before.len(), self.states.start);
        self.stage[first..].copy_from_slice(&point[first..]);
        for column in 0..n {
            let value = point[first + column];
            self.stage[first + column] = value + f64::EPSILON.sqrt() * self.scales[column].nominal.max(value.abs());
            let by = self.stage[first + column] - value;
            self.respond_at(point, (since, LAST), drive, respond);
            self.stage[first + column] = value;
            let RosenbrockParts { jacobian, rates, .. } = self.implicit.parts();
            difference(&mut jacobian[column * n..][..n], rates, &self.rates, by);
        }
        let is_driven = self.inputs.clone().any(|column| drive.rates.iter().any(|rates| rates[column] != 0.0));
        let by = SHORT * h;
        if is_driven {
            self.respond_at(point, (since + by, LAST), drive, respond);
        }
        let RosenbrockParts { by_time, rates, .. } = self.implicit.parts();
        by_time.fill(0.0);
        if is_driven {
            difference(by_time, rates, &self.rates, by);
        }
    }
}

/// `to = (after - before) / by`.
#[inline(never)]
fn difference(to: &mut [f64], after: &[f64], before: &[[f64; LANES]], by: f64) {
    for ((to, after), before) in to.iter_mut().zip(after).zip(before.as_flattened()) {
        *to = (after - before) / by;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CommunicationStep, Integration, Scale};

    /// The end of a step of 1 s of `y' = f(y, u)`, with an input of these derivatives that begins at zero, and the number of the solver's steps.
    fn end(f: impl Fn(f64, f64) -> f64, start: f64, rates: [f64; 2], (tolerance, longest): (f64, f64)) -> (f64, u32) {
        let scale = Scale { nominal: 1.0, is_relative: false, limit: 1e3 };
        let mut solver = Solver::new(2, vec![[-9.0, 9.0]], vec![scale], Vec::new());
        let mut point = [0.0, start];
        let drive = Drive { rates: [&[rates[0], 0.0], &[rates[1], 0.0]], clamp: None };
        let integration = Integration::Implicit { tolerance, longest };
        let respond = |point: &[f64], rates: &mut [f64], _: &mut [f64]| rates[0] = f(point[1], point[0]);
        let steps = solver.advance(&mut point, integration, CommunicationStep::of(1.0), drive, respond).unwrap();
        (point[1], steps)
    }

    #[test]
    fn the_error_falls_with_the_fifth_power_of_the_step() {
        // y' = y (1 - y) + u with u = t: against a run of short steps
        let error = |longest: f64| end(|y, u| y * (1.0 - y) + u, 0.1, [1.0, 0.5], (1e9, longest)).0;
        let exact = error(0.005);
        let order = ((error(0.2) - exact) / (error(0.1) - exact)).log2();
        assert!((4.5..6.5).contains(&order), "{order}");
    }

    #[test]
    fn a_fast_decay_costs_few_steps() {
        // u = t^2 / 2: y = u - t / k + (1 - exp(-k t)) / k^2
        for k in [1.0, 1e3, 1e6, 1e9] {
            let (found, steps) = end(|y, u| k * (u - y), 0.0, [0.0, 1.0], (1e-9, 1.0));
            let expected = 0.5 - 1.0 / k + (1.0 - (-k).exp()) / (k * k);
            assert!((found - expected).abs() < 1e-8, "k = {k}: {found} {expected}");
            assert!(steps < 40, "k = {k}: {steps} steps");
        }
    }
}
