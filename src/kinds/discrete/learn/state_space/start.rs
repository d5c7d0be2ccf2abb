//! Linear state spaces from which trainings begin, of ARX models.

use crate::{
    dataset::Run,
    discrete::{CountedRuns, Limits, Signals, Simulated, StateShape, overwriting, simulate},
    kinds::discrete::learn::{
        DiscreteSamples, Regressors,
        linear::{LinearPart, solve},
        standardized,
    },
    scaling,
    study::Study,
};
use nalgebra::{DMatrix, DVector};

/// Largest number of past samples of the ARX model whose impulse responses are realized, and of its columns.
const LONGEST: usize = 20;
const COLUMNS: usize = 200;
/// Minimum number of samples for each of its coefficients.
const SAMPLES: usize = 10;
/// Smallest standard deviation that a hidden state is divided by.
const LEAST_DEVIATION: f64 = 1e-9;
/// Largest magnitude of the eigenvalues of a realization: responses that grow are those of noise.
const STABLE: f64 = 0.999;
/// Factors of the poles of linear state spaces: the first one that does not diverge counts.
const RADII: [f64; 5] = [1.0, 0.99, 0.97, 0.9, 0.7];
/// Singular values that count as zero.
const SMALL: f64 = 1e-12;

/// Standardized outputs at the start of all runs from rest, if they differ by no more than the errors of a linear model; none without such runs.
pub fn common(samples: &DiscreteSamples, study: &Study) -> Option<Vec<f64>> {
    let runs = samples.training.iter().chain(&samples.validation).filter(|run| run.times[0] >= 0.0);
    let outputs = samples.counts[2];
    let first = |run: &&Run| standardized(&run.outputs[..outputs], &samples.scales[2]).collect::<Vec<f64>>();
    let starts: Vec<Vec<f64>> = runs.map(first).collect();
    if let [] | [_] = starts[..] {
        return starts.into_iter().next();
    }
    let (means, _) = scaling::of_columns(&starts);
    let linear = LinearPart::of(samples, study, [samples.past(study.discrete.history); 2]).ok()?;
    let is_common = |output: usize| {
        let squares: f64 = starts.iter().map(|start| (start[output] - means[output]).powi(2)).sum();
        squares <= starts.len() as f64 * linear.gains[output].powi(2)
    };
    (0..outputs).all(is_common).then_some(means)
}

/// Origin of a linear state space.
#[derive(Clone, Copy, Debug)]
pub enum LinearStart {
    /// An ARX model of its order.
    Arx(Pasts),
    /// The balanced realization of a longer ARX model's responses to impulses.
    Realization(Pasts),
}

/// Rows that an ARX model is fitted to.
#[derive(Clone, Copy, Debug)]
pub enum Pasts {
    /// Samples whose whole past is in the run: components that are released from a position were not at rest there
    /// before.
    Known,
    /// All: runs from rest begin as they were before.
    AtRest,
}

/// Linear state spaces to begin with.
pub const STARTS: [LinearStart; 4] = [
    LinearStart::Arx(Pasts::AtRest),
    LinearStart::Realization(Pasts::AtRest),
    LinearStart::Arx(Pasts::Known),
    LinearStart::Realization(Pasts::Known),
];

/// Coefficients of a linear state space of a shape in observer form, in which measured outputs make the hidden states
/// forget. The hidden states have unit variance. None if the state space is not determined, or diverges.
pub fn linear(
    origin: LinearStart,
    samples: &DiscreteSamples,
    data: &CountedRuns,
    shape: &StateShape,
    limits: &Limits,
) -> Option<Vec<f64>> {
    let order = shape.states / shape.outputs;
    let lags = match origin {
        LinearStart::Arx(pasts) => arx(samples, order, pasts),
        LinearStart::Realization(pasts) => realization(samples, order, pasts),
    }?;
    RADII.into_iter().find_map(|radius| {
        let (matrix, constants) = observer(&with_poles(&lags, radius), shape);
        let mut coefficients = shape.constant();
        let [linear, constant, ..] = shape.places();
        // columns of a matrix of nalgebra lie one after the other
        coefficients[linear].copy_from_slice(matrix.transpose().as_slice());
        coefficients[constant].copy_from_slice(&constants);
        scale_hidden(data, shape, limits, &mut coefficients)?;
        if shape.common_start.is_none() {
            hold_outputs(shape, limits, &mut coefficients);
        }
        Some(coefficients)
    })
}

/// Lags with poles that are closer to 0 by a factor.
fn with_poles(lags: &[Lag], factor: f64) -> Vec<Lag> {
    let mut power = 1.0;
    let closer = |lag: &Lag| {
        power *= factor;
        Lag { outputs: &lag.outputs * power, ..lag.clone() }
    };
    lags.iter().map(closer).collect()
}

/// Sets the initial state to the states after outputs and inputs that have long been fixed: measured outputs make the
/// hidden states forget.
fn hold_outputs(shape: &StateShape, limits: &Limits, coefficients: &mut [f64]) {
    let StateShape { states, outputs, columns, .. } = *shape;
    let rows = states + 1;
    let gain = overwriting(shape);
    let held = |values: Vec<f64>| {
        let run = Signals {
            outputs: values.repeat(rows),
            inputs: vec![0.0; rows * (columns - states)],
            given: rows,
            runs: vec![0; rows],
        };
        let mut found = vec![0.0; states];
        let model = Simulated { coefficients: &*coefficients, gain: &gain, limits };
        simulate(shape, model, &run, [rows, rows], |_, states| found.copy_from_slice(states))?;
        Some(found.split_off(outputs))
    };
    let unit = |output: Option<usize>| (0..outputs).map(|of| f64::from(u8::from(Some(of) == output))).collect();
    let found: Option<Vec<Vec<f64>>> =
        [None].into_iter().chain((0..outputs).map(Some)).map(|of| held(unit(of))).collect();
    let Some([constants, by_output @ ..]) = found.as_deref() else { return };
    let start = shape.places()[5].start;
    let mut of_outputs = Vec::new();
    for (hidden, constant) in constants.iter().enumerate() {
        of_outputs.extend(by_output.iter().map(|states| states[hidden] - constant));
    }
    coefficients[start..].copy_from_slice(&[constants.as_slice(), &of_outputs].concat());
}

/// Gives the hidden states unit variance; none if the simulations diverge.
fn scale_hidden(data: &CountedRuns, shape: &StateShape, limits: &Limits, coefficients: &mut [f64]) -> Option<()> {
    let StateShape { states, outputs, columns, .. } = *shape;
    let [linear, constant, ..] = shape.places();
    let deviations = data.deviations(shape, coefficients, limits)?;
    for hidden in outputs..states {
        let scale = deviations[hidden].max(LEAST_DEVIATION);
        coefficients[linear.start + hidden * columns..][..columns].iter_mut().for_each(|weight| *weight /= scale);
        coefficients[constant.start + hidden] /= scale;
        (0..states).for_each(|row| coefficients[linear.start + row * columns + hidden] *= scale);
    }
    Some(())
}

/// One lag of a linear function of past samples: that of the outputs, shape `[outputs, outputs]`, that of inputs and
/// parameters, shape `[outputs, inputs + parameters]`, and the constants.
#[derive(Clone)]
struct Lag {
    outputs: DMatrix<f64>,
    inputs: DMatrix<f64>,
    constants: DVector<f64>,
}

/// `x[k+1] - x[k]` from the columns, shape `[states, columns]`, and the constants. The first lag gives the next
/// outputs, each later one the part that is added a sample after.
fn observer(lags: &[Lag], shape: &StateShape) -> (DMatrix<f64>, Vec<f64>) {
    let StateShape { states, outputs, columns, .. } = *shape;
    let mut matrix = DMatrix::zeros(states, columns);
    for (place, lag) in lags.iter().enumerate() {
        let first = place * outputs;
        matrix.view_mut((first, 0), (outputs, outputs)).copy_from(&lag.outputs);
        matrix.view_mut((first, states), (outputs, columns - states)).copy_from(&lag.inputs);
        for state in first..first + outputs {
            if state + outputs < states {
                matrix[(state, state + outputs)] = 1.0;
            }
            matrix[(state, state)] -= 1.0;
        }
    }
    (matrix, lags.iter().flat_map(|lag| lag.constants.iter().copied().collect::<Vec<_>>()).collect())
}

/// Regressors of rows whose whole past is in the run.
fn with_known_pasts(samples: &DiscreteSamples, regressors: Regressors, order: usize) -> Regressors {
    let Regressors { inputs, outputs, lengths } = regressors;
    let is_known = samples.training.iter().zip(&lengths).flat_map(|(run, length)| {
        let unknown = if run.times[0] < 0.0 { 0 } else { order - 1 };
        (0..*length).map(move |row| row >= unknown)
    });
    let is_known: Vec<bool> = is_known.collect();
    let known: Vec<usize> = (0..is_known.len()).filter(|row| is_known[*row]).collect();
    Regressors { inputs: inputs.pick(&known), outputs: outputs.pick(&known), lengths }
}

/// ARX model with `order` lags, by least squares.
fn arx(samples: &DiscreteSamples, order: usize, pasts: Pasts) -> Option<Vec<Lag>> {
    let [parameters, inputs, outputs] = samples.counts;
    let regressors = samples.regressors(&samples.training, [order; 2]);
    let found = match pasts {
        Pasts::AtRest => solve(&regressors),
        Pasts::Known => solve(&with_known_pasts(samples, regressors, order)),
    }?;
    let beside = order * (outputs + inputs);
    let lag = |lag: usize| {
        let mut of_inputs = DMatrix::zeros(outputs, inputs + parameters);
        let from = order * outputs + lag * inputs;
        of_inputs.columns_mut(0, inputs).copy_from(&found.rows(from, inputs).transpose());
        let mut constants = DVector::zeros(outputs);
        // parameters and constants act once
        if lag == 0 {
            of_inputs.columns_mut(inputs, parameters).copy_from(&found.rows(beside, parameters).transpose());
            constants.copy_from(&found.row(beside + parameters).transpose());
        }
        Lag { outputs: found.rows(lag * outputs, outputs).transpose(), inputs: of_inputs, constants }
    };
    Some((0..order).map(lag).collect())
}

/// Model with `order` lags from the impulse responses of a long ARX model. The lags of the outputs are those of the
/// balanced realization (Ho, Kalman (1966)). Its first responses give the lags of the inputs.
fn realization(samples: &DiscreteSamples, order: usize, pasts: Pasts) -> Option<Vec<Lag>> {
    let [parameters, inputs, outputs] = samples.counts;
    let states = order * outputs;
    let length = (samples.rows() / (SAMPLES * (inputs + outputs))).min(LONGEST).min(COLUMNS / (inputs + outputs));
    if length < 2 * order {
        return None;
    }
    let long = arx(samples, length, pasts)?;
    let driven = inputs + outputs;
    let responses = responses(&long, [inputs, outputs]);
    let hankel = DMatrix::from_fn(length * outputs, length * driven, |row, column| {
        responses[row / outputs + column / driven][(row % outputs, column % driven)]
    });
    let svd = hankel.svd(true, true);
    let scale = DMatrix::from_diagonal(&svd.singular_values.rows(0, states).map(f64::sqrt));
    let observability = svd.u.as_ref()?.columns(0, states) * &scale;
    let controllability = scale * svd.v_t.as_ref()?.rows(0, states);
    let [earlier, later] = [0, outputs].map(|from| observability.rows(from, (length - 1) * outputs).into_owned());
    let mut a = earlier.svd(true, true).solve(&later, SMALL).ok()?;
    let radius = a.complex_eigenvalues().iter().map(|value| value.norm()).fold(0.0, f64::max);
    if radius > STABLE {
        a *= STABLE / radius;
    }
    let c = observability.rows(0, outputs);
    // of the realization: those of the ARX model are noisy
    let mut reached = controllability.columns(0, driven).into_owned();
    let mut smooth = Vec::new();
    let mut seen = DMatrix::zeros(states, states);
    let mut ahead = c.into_owned();
    for lag in 0..order {
        smooth.push(c * &reached);
        reached = &a * reached;
        seen.rows_mut(lag * outputs, outputs).copy_from(&ahead);
        ahead *= &a;
    }
    // the outputs of `order` samples give those of the next
    let of_outputs = ahead * seen.try_inverse()?;
    let outputs_of = |lag: usize| of_outputs.columns((order - 1 - lag) * outputs, outputs).into_owned();
    let mut lags: Vec<Lag> = Vec::new();
    for lag in 0..order {
        let mut driven_by = smooth[lag].clone();
        (0..lag).for_each(|earlier| driven_by -= outputs_of(earlier) * &smooth[lag - 1 - earlier]);
        let of_errors = driven_by.columns(inputs, outputs);
        let mut of_inputs = DMatrix::zeros(outputs, inputs + parameters);
        of_inputs.columns_mut(0, inputs).copy_from(&driven_by.columns(0, inputs));
        of_inputs.columns_mut(inputs, parameters).copy_from(&(of_errors * long[0].inputs.columns(inputs, parameters)));
        lags.push(Lag { outputs: outputs_of(lag), inputs: of_inputs, constants: of_errors * &long[0].constants });
    }
    Some(lags)
}

/// Outputs `k + 1` samples after an impulse of an input or of an output's error, shape `[outputs, inputs + outputs]` each.
fn responses(lags: &[Lag], [inputs, outputs]: [usize; 2]) -> Vec<DMatrix<f64>> {
    let mut found: Vec<DMatrix<f64>> = Vec::new();
    for k in 0..2 * lags.len() {
        let mut next = DMatrix::zeros(outputs, inputs + outputs);
        lags.iter().take(k).enumerate().for_each(|(lag, of)| next += &of.outputs * &found[k - 1 - lag]);
        if let Some(lag) = lags.get(k) {
            let mut columns = next.columns_mut(0, inputs);
            columns += lag.inputs.columns(0, inputs);
        }
        if k == 0 {
            (0..outputs).for_each(|output| next[(output, inputs + output)] += 1.0);
        }
        found.push(next);
    }
    found
}
