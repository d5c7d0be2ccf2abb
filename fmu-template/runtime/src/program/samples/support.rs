//! Domain of the motion: where the outputs that a model feeds back, its hidden states, and the inputs that drove it were in training.

use crate::{
    FormatError,
    check::{expect_finite, expect_shape},
};

/// Smallest distance that counts as outside, relative to the width of a range.
pub(super) const NEGLIGIBLE: f64 = 0.003;
/// Smallest part of a distance that is kept in mind.
const LEAST: f64 = 1e-6;

/// Training ranges of measures of the transition from sample k to sample k + 1. The first measures are features of it,
///
/// ```text
/// u[k],  u[k] - u[k - 1],  r[k] = r[k - 1] + (|u[k] - u[k - 1]| - r[k - 1]) / M,
/// s[k] = s[k - 1] + (u[k] - s[k - 1]) / M,  y[k + 1],  y[k + 1] - y[k],  h[k + 1]
/// ```
///
/// with outputs `y` and hidden states `h`. A constant input at an end of its range stays in the range, but its average
/// `s` leaves that of inputs that change. An input that changes at each sample by no more than in training leaves the
/// range of the average change `r`. Further measures describe the shape of the features from `s` on: their components,
/// which are linear combinations with weights, and the sums and differences of any two of the first four components.
///
/// The distance `d` of a transition is that of its farthest measure from its range, relative to the width of the range.
/// It ends when no past sample of that time counts any more. Errors made outside are fed back, however: their possible
/// residual is
///
/// ```text
/// e[k] = f e[k - 1] + (1 - f) min(d[k], 1),  f = exp(-1 / L)
/// ```
///
/// with the number `L` of samples after which the model has forgotten an error of its outputs. The larger of both is
/// the distance, which is 0 where it is negligible. Measured outputs end both when all past samples that count are
/// measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Support {
    /// Number of inputs with features: all or none.
    pub inputs: usize,
    /// Smallest and largest value of each measure.
    pub ranges: Vec<[f64; 2]>,
    /// Weights of the components, shape `[components, features from s on]`.
    pub components: Vec<f64>,
    /// `M`, at least 1.
    pub samples: f64,
    /// `L`, at least 1: number of samples over which the model forgets an error of its outputs.
    pub lasting: f64,
}

impl Support {
    /// Largest number of components whose pairs have ranges.
    pub const PAIRED: usize = 4;

    /// Number of features from `s` on.
    pub fn coordinates(&self, outputs: usize, hidden: usize) -> usize {
        self.inputs + 2 * outputs + hidden
    }

    /// Number of measures.
    pub fn measures(&self, outputs: usize, hidden: usize) -> usize {
        let coordinates = self.coordinates(outputs, hidden);
        let components = self.components.len() / coordinates;
        let paired = components.min(Self::PAIRED);
        3 * self.inputs + coordinates + components + paired * paired.saturating_sub(1)
    }

    /// Number of values in the memory of inputs: averages, last values and average changes.
    pub fn memory(&self) -> usize {
        3 * self.inputs
    }

    /// Fills the memory of inputs that have always been these.
    pub fn begin(&self, memory: &mut [f64], inputs: &[f64]) {
        let (levels, changes) = memory.split_at_mut(2 * self.inputs);
        for (level, input) in levels.iter_mut().zip(inputs.iter().cycle()) {
            *level = *input;
        }
        changes.fill(0.0);
    }

    /// Fills the measures of a transition with these inputs, outputs before and after it, and hidden states after it; and updates the memory of
    /// inputs. Does not allocate.
    pub fn measure(
        &self,
        memory: &mut [f64],
        inputs: &[f64],
        [now, next]: [&[f64]; 2],
        hidden: &[f64],
        measures: &mut [f64],
    ) {
        let (count, outputs) = (self.inputs, now.len());
        let (of_inputs, rest) = measures.split_at_mut(3 * count);
        let (coordinates, rest) = rest.split_at_mut(self.coordinates(outputs, hidden.len()));
        for (i, input) in inputs.iter().take(count).enumerate() {
            let change = input - memory[count + i];
            memory[i] += (input - memory[i]) / self.samples;
            memory[count + i] = *input;
            memory[2 * count + i] += (change.abs() - memory[2 * count + i]) / self.samples;
            of_inputs[i] = *input;
            of_inputs[count + i] = change;
            of_inputs[2 * count + i] = memory[2 * count + i];
            coordinates[i] = memory[i];
        }
        for (i, (next, now)) in next.iter().zip(now).enumerate() {
            coordinates[count + i] = *next;
            coordinates[count + outputs + i] = next - now;
        }
        coordinates[count + 2 * outputs..].copy_from_slice(hidden);
        let components = self.components.len() / coordinates.len();
        let (found, pairs) = rest.split_at_mut(components);
        for (component, weights) in found.iter_mut().zip(self.components.chunks_exact(coordinates.len())) {
            *component = weights.iter().zip(&*coordinates).fold(0.0, |sum, (weight, value)| sum + weight * value);
        }
        let mut place = 0;
        for i in 1..components.min(Self::PAIRED) {
            for j in 0..i {
                pairs[place] = found[i] + found[j];
                pairs[place + 1] = found[i] - found[j];
                place += 2;
            }
        }
    }

    /// Checks the number of measures, and that ranges, weights and `M` are valid.
    ///
    /// # Errors
    /// A [`FormatError`].
    pub(super) fn check(&self, inputs: usize, outputs: usize, hidden: usize) -> Result<(), FormatError> {
        if self.inputs != 0 {
            expect_shape("support.inputs", &[self.inputs], &[inputs])?;
        }
        let coordinates = self.coordinates(outputs, hidden);
        if !self.components.len().is_multiple_of(coordinates) {
            return Err(FormatError::Support);
        }
        expect_shape("support.ranges", &[self.ranges.len()], &[self.measures(outputs, hidden)])?;
        expect_finite("support.ranges", self.ranges.iter().flatten().copied())?;
        expect_finite("support.components", self.components.iter().copied())?;
        let is_in_order = self.ranges.iter().all(|[min, max]| min <= max);
        let fits = [self.samples, self.lasting].iter().all(|samples| samples.is_finite() && *samples >= 1.0);
        if fits && is_in_order { Ok(()) } else { Err(FormatError::Support) }
    }

    /// Factor `f` by which errors fade from sample to sample.
    pub fn fading(&self) -> f64 {
        (-1.0 / self.lasting).exp()
    }

    /// Distance of a transition with these measures. Does not allocate.
    pub fn distance(&self, measures: &[f64]) -> f64 {
        let measures = measures.iter().zip(&self.ranges);
        // usually all are inside, which takes less time than their distances
        if measures.clone().fold(false, |outside, (value, [min, max])| outside | (value < min) | (value > max)) {
            return measures.map(|(value, range)| distance(*value, *range)).fold(0.0, f64::max).min(f64::MAX);
        }
        0.0
    }

    /// Estimated error and reported distance after a transition at distance `own`, from those before it. `fading` has the factors
    /// [`Support::fading`] and [`Sampling::settling`](super::Sampling::settling).
    pub fn after(own: f64, [error, distance]: [f64; 2], [fading, settling]: [f64; 2], is_measured: bool) -> [f64; 2] {
        let own = if own < NEGLIGIBLE { 0.0 } else { own };
        let kept = if is_measured { fading.min(settling) } else { fading };
        let error = kept * error + (1.0 - fading) * own.min(1.0);
        let distance = own.max(settling * distance).max(error);
        [if error < LEAST { 0.0 } else { error }, if distance < NEGLIGIBLE { 0.0 } else { distance }]
    }
}

/// Distance of a value from its range, relative to the width of the range, or to the magnitude of a constant measure.
#[inline]
fn distance(value: f64, [min, max]: [f64; 2]) -> f64 {
    let width = match max - min {
        width if width > 0.0 => width,
        _ if max != 0.0 => max.abs(),
        _ => 1.0,
    };
    (min - value).max(value - max) / width
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Input from -1 to 1 that changes by 0.5 on average, and an output from 0 to 10 that changes by at most 2 a
    /// sample. The output is ten times the average of the input, up to 1.
    fn support() -> Support {
        let ranges = vec![[-1.0, 1.0], [-2.0, 2.0], [0.0, 0.5], [0.0, 1.0], [0.0, 10.0], [-2.0, 2.0], [-1.0, 1.0]];
        let support = Support { inputs: 1, ranges, components: vec![-10.0, 1.0, 0.0], samples: 5.0, lasting: 5.0 };
        support.check(1, 1, 0).unwrap();
        support
    }

    /// Distance of a transition from a memory: average, last value and average change of the input.
    fn distance(mut memory: [f64; 3], input: f64, outputs: [f64; 2]) -> f64 {
        let support = support();
        let mut measures = [0.0; 7];
        let [now, next] = outputs.map(|output| [output]);
        support.measure(&mut memory, &[input], [&now, &next], &[], &mut measures);
        Support::after(support.distance(&measures), [0.0; 2], [support.fading(), 0.5], false)[1]
    }

    #[test]
    fn a_transition_is_outside_if_a_feature_leaves_its_range() {
        assert_eq!(distance([0.45, 0.5, 0.3], 0.5, [4.0, 4.5]), 0.0);
        assert!((distance([0.5, 0.5, 0.3], 1.2, [6.0, 6.4]) - 0.1).abs() < 1e-12, "the input itself");
        assert!((distance([0.5, -1.9, 0.0], 1.0, [6.0, 6.0]) - 0.225).abs() < 1e-12, "a large change");
        let often = distance([0.5, -0.5, 0.5], 0.5, [4.0, 5.0]);
        assert!((often - 0.2).abs() < 1e-12, "changes that are more frequent: {often}");
        assert!((distance([1.2, 1.0, 0.0], 1.0, [9.5, 10.0]) - 0.3).abs() < 1e-12, "0.16 and the component");
        assert!((distance([0.9, 0.9, 0.0], 0.9, [7.0, 9.9]) - 0.225).abs() < 1e-12, "an output that jumps");
        assert_eq!(distance([0.5, 0.5, 0.0], 0.5, [4.0, f64::INFINITY]), f64::MAX);
        assert_eq!(distance([1.0, 1.0, 0.0], 1.0, [10.0, 10.02]), 0.0, "a negligible part of the range");
    }

    #[test]
    fn a_transition_is_outside_if_features_in_their_ranges_do_not_fit_together() {
        let apart = distance([0.2, 0.2, 0.0], 0.2, [6.5, 7.0]);
        assert!((apart - 2.0).abs() < 1e-12, "{apart}");
    }

    #[test]
    fn pairs_of_components_cut_the_corners_of_their_ranges() {
        // two outputs on a circle, without inputs
        let components = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        let support = Support { inputs: 0, ranges: Vec::new(), components, samples: 5.0, lasting: 5.0 };
        assert_eq!((support.measures(2, 0), support.memory()), (8, 0));
        let mut measures = [0.0; 8];
        support.measure(&mut [], &[], [&[0.6, 0.8], &[0.8, 0.6]], &[], &mut measures);
        let expected = [0.8, 0.6, 0.2, -0.2, 0.8, 0.6, 1.4, -0.2];
        assert!(
            measures.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12),
            "{measures:?}"
        );
    }

    #[test]
    fn a_distance_lasts_as_long_as_its_errors() {
        let fading = [support().fading(), NEGLIGIBLE.sqrt()];
        let samples = |outside: usize, own: f64, is_measured: bool| {
            let mut state = [0.0; 2];
            for _ in 0..outside {
                state = Support::after(own, state, fading, false);
            }
            let after = |state: &[f64; 2]| Some(Support::after(0.0, *state, fading, is_measured));
            std::iter::successors(Some(state), after).skip(1).take_while(|state| state[1] > 0.0).count()
        };
        // after long enough the error is the distance, which fades within five samples by a factor e
        assert_eq!(samples(100, 0.5, false), (5.0 * (0.5_f64 / NEGLIGIBLE).ln()).floor() as usize);
        // a single sample makes a fifth of it
        let part = 0.5 * (1.0 - fading[0]);
        assert_eq!(samples(1, 0.5, false), (5.0 * (part / NEGLIGIBLE).ln()).floor() as usize);
        assert_eq!(samples(1, 2.0 * NEGLIGIBLE, false), 0, "a little outside for a moment");
        assert_eq!(samples(100, 0.5, true), 1, "two past samples count, and both are measured");
        assert_eq!(Support::after(f64::MAX, [0.0; 2], fading, false)[0], 1.0 - fading[0], "an error ends");
    }

    #[test]
    fn a_support_that_makes_no_sense_is_refused() {
        assert!(support().check(1, 2, 0).is_err() && support().check(2, 1, 0).is_err());
        assert!(Support { samples: 0.5, ..support() }.check(1, 1, 0).is_err());
        assert!(Support { lasting: 0.5, ..support() }.check(1, 1, 0).is_err());
        assert!(Support { components: vec![1.0; 2], ..support() }.check(1, 1, 0).is_err());
        assert!(Support { components: vec![f64::NAN; 3], ..support() }.check(1, 1, 0).is_err());
        assert!(Support { ranges: vec![[1.0, 0.0]; 7], ..support() }.check(1, 1, 0).is_err());
        assert!(Support { ranges: vec![[0.0, f64::NAN]; 7], ..support() }.check(1, 1, 0).is_err());
    }
}
