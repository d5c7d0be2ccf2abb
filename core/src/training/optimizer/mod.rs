//! Rules that turn gradients into parameter updates.

mod eigenbasis;
mod elementwise;
mod soap;

use super::{
    gradient::Gradients,
    team::{Divided, Team},
};
use crate::{
    network::{
        Packed,
        kernels::{InstructionSet, SimdKernel, SimdLanes, WIDTH, buffer::Buffer},
    },
    study::{Optimizer, TrainingOptions},
};
use elementwise::ElementwiseStep;
use soap::Soap;

/// The options of all rules, with their defaults filled in.
#[derive(Clone, Copy, Debug)]
struct Coefficients {
    /// μ of SGD and RMSprop, β1 of the others.
    momentum: f64,
    /// α of RMSprop, β2 of the others.
    beta2: f64,
    weight_decay: f64,
    refresh: u64,
}

/// A rule with its memory.
pub(super) struct Updater {
    rule: Optimizer,
    coefficients: Coefficients,
    penalty: Penalty,
    clip_norm: f64,
    /// Steps done.
    steps: u64,
    memory: OptimizerState,
    /// Sum of squares of each piece of the gradient.
    squares: Vec<f64>,
}

enum OptimizerState {
    /// Laid out as the packed parameters are.
    Elementwise {
        mean: Buffer,
        square: Buffer,
    },
    Soap(Box<Soap>),
}

/// Correction of a gradient before its use: `g = factor g + l2 p + l1 sign(p)`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Penalty {
    factor: f32,
    l1: f32,
    l2: f32,
}

impl Updater {
    pub(super) fn new(options: &TrainingOptions, network: &Packed) -> Self {
        let (momentum, beta2) = match options.optimizer {
            Optimizer::Sgd => (0.9, 0.0),
            Optimizer::RmsProp => (0.0, 0.99),
            Optimizer::Adam | Optimizer::AdamW => (0.9, 0.999),
            Optimizer::Soap => (0.95, 0.95),
        };
        let decays = matches!(options.optimizer, Optimizer::AdamW | Optimizer::Soap);
        let coefficients = Coefficients {
            momentum: options.momentum.unwrap_or(momentum),
            beta2: options.beta2.unwrap_or(beta2),
            weight_decay: if decays { options.weight_decay } else { 0.0 },
            refresh: options.refresh,
        };
        let length = network.layout.len();
        let memory = match options.optimizer {
            Optimizer::Soap => OptimizerState::Soap(Box::new(Soap::new(&network.layout))),
            _ => OptimizerState::Elementwise { mean: Buffer::zeros(length), square: Buffer::zeros(length) },
        };
        Self {
            rule: options.optimizer,
            coefficients,
            penalty: Penalty { factor: 1.0, l1: options.l1 as f32, l2: options.l2 as f32 },
            clip_norm: options.clip_norm,
            steps: 0,
            memory,
            squares: vec![0.0; network.layout.pieces.len()],
        }
    }

    /// One step with the gradients of the parts of the last batch, which had `rows` rows.
    pub(super) fn step(
        &mut self,
        team: &mut Team,
        gradients: &mut Gradients,
        rows: usize,
        network: &mut Packed,
        learning_rate: f64,
    ) {
        self.steps += 1;
        let simd = InstructionSet::detect();
        let Packed { layout, parameters, transposed, .. } = network;
        let pieces = &layout.pieces;
        let mut penalty = self.penalty;
        let mut summed = false;
        if self.clip_norm > 0.0 {
            penalty.factor = self.clip_factor(team, gradients, rows, pieces);
            summed = true;
        }
        let (parameters_of, transposed_of) = (Divided::new(parameters), Divided::new(transposed));
        let sum = gradients.sum(rows, summed);
        let penalized = |index: usize| {
            let range = pieces[index].range.clone();
            // SAFETY: the pieces of a layout do not overlap, and each is asked for once in a round
            unsafe {
                let (gradient, parameters) = (sum.piece(range.clone()), parameters_of.range(range));
                if penalty != Penalty::NONE {
                    simd.run(Penalize { penalty, parameters, gradient });
                }
                (gradient, parameters)
            }
        };
        let transpose = |index: usize, parameters: &[f32]| {
            let piece = &pieces[index];
            piece.transpose(&layout.shapes[piece.layer], parameters, |range, fill| {
                // SAFETY: the transposed weights of different pieces do not overlap
                fill(unsafe { transposed_of.range(range) })
            });
        };
        match &mut self.memory {
            OptimizerState::Elementwise { mean, square } => {
                let with = ElementwiseStep::new(self.rule, &self.coefficients, self.steps, learning_rate);
                let (mean, square) = (Divided::new(mean), Divided::new(square));
                team.for_each(pieces.len(), |_, index| {
                    let (gradient, parameters) = penalized(index);
                    let range = pieces[index].range.clone();
                    // SAFETY: the pieces of a layout do not overlap
                    let (mean, square) = unsafe { (mean.range(range.clone()), square.range(range)) };
                    with.update(parameters, gradient, mean, square);
                    transpose(index, parameters);
                });
            }
            OptimizerState::Soap(soap) => {
                team.for_each(pieces.len(), |_, index| {
                    penalized(index);
                });
                // SAFETY: the round is over, so nobody else has a piece of the parameters
                let all = unsafe { parameters_of.range(0..layout.len()) };
                soap.step(team, &self.coefficients, self.steps, learning_rate, gradients.total(), all);
                let all = &*all;
                team.for_each(pieces.len(), |_, index| transpose(index, &all[pieces[index].range.clone()]));
            }
        }
    }

    /// Adds the parts' gradients; returns the factor that clips their sum to the largest norm.
    fn clip_factor(
        &mut self,
        team: &mut Team,
        gradients: &mut Gradients,
        rows: usize,
        pieces: &[crate::network::layout::Piece],
    ) -> f32 {
        let (sum, squares) = (gradients.sum(rows, false), Divided::new(&mut self.squares));
        team.for_each(pieces.len(), |_, index| {
            // SAFETY: the pieces of a layout do not overlap; one place of the squares for each item
            let (gradient, square) =
                unsafe { (sum.piece(pieces[index].range.clone()), &mut squares.range(index..index + 1)[0]) };
            *square = gradient.iter().map(|&g| f64::from(g) * f64::from(g)).sum();
        });
        let norm = self.squares.iter().sum::<f64>().sqrt();
        // a norm that is not finite must not hide a divergence
        if norm > self.clip_norm { (self.clip_norm / norm) as f32 } else { 1.0 }
    }

    /// The state that a checkpoint keeps, with names.
    pub(super) fn memory(&mut self) -> Vec<(String, &mut [f32])> {
        match &mut self.memory {
            OptimizerState::Elementwise { mean, square } => {
                vec![("mean".into(), &mut **mean), ("square".into(), &mut **square)]
            }
            OptimizerState::Soap(soap) => soap.memory(),
        }
    }

    /// Steps done.
    pub(super) fn steps(&self) -> u64 {
        self.steps
    }

    pub(super) fn set_steps(&mut self, steps: u64) {
        self.steps = steps;
    }
}

impl Penalty {
    const NONE: Self = Self { factor: 1.0, l1: 0.0, l2: 0.0 };
}

struct Penalize<'a> {
    penalty: Penalty,
    parameters: &'a [f32],
    gradient: &'a mut [f32],
}

impl SimdKernel for Penalize<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { penalty: Penalty { factor, l1, l2 }, parameters, gradient } = self;
        let (factor, l1, l2, zero) = (L::splat(factor), L::splat(l1), L::splat(l2), L::splat(0.0));
        for (p, gradient) in parameters.as_chunks::<WIDTH>().0.iter().zip(gradient.as_chunks_mut::<WIDTH>().0) {
            let p = L::load(p);
            // no sign at 0, where the padding is too
            let sign = l1.where_positive(p).sub(l1.where_positive(zero.sub(p)));
            L::load(gradient).mul_add(factor, p.mul_add(l2, sign)).store(gradient);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn coefficients() -> Coefficients {
        Coefficients { momentum: 0.95, beta2: 0.95, weight_decay: 0.0, refresh: 10 }
    }

    #[test]
    fn penalties_agree_with_their_definition() {
        let mut gradient = [1.0; WIDTH];
        let mut parameters = [0.0; WIDTH];
        (parameters[1], parameters[2]) = (2.0, -4.0);
        let penalty = Penalty { factor: 0.5, l1: 0.25, l2: 0.125 };
        for simd in InstructionSet::available() {
            gradient.fill(1.0);
            simd.run(Penalize { penalty, parameters: &parameters, gradient: &mut gradient });
            assert_eq!(gradient[..3], [0.5, 0.5 + 0.25 + 0.25, 0.5 - 0.5 - 0.25], "{simd:?}");
        }
    }
}
