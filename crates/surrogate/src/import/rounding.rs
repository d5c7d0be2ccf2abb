//! Effect of rounding on a graph: differences that it explains are no evidence that a model was read wrongly.

use super::builder::{Builder, GraphError};
use metafmu_runtime::{
    Activation,
    graph::{Elementwise, Graph, Step},
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Random rounding of every number of a graph, `x (1 + a relative) + b absolute` with `a` and `b` from -1 to 1.
#[derive(Clone, Copy, Debug)]
pub struct RandomRounding {
    /// Relative error of the number type.
    pub relative: f64,
    /// Smallest positive normal number of the type: below it, some programs compute 0. Of a sigmoid the error is at least `relative`,
    /// because programs approximate it by a rational function, whose error is absolute.
    pub absolute: f64,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl RandomRounding {
    /// The graph of a builder from its columns to some numbers of some values, whose columns and values are rounded.
    ///
    /// # Errors
    /// As [`Builder::add`]: the graph has twice as many values.
    pub fn of(&self, builder: &Builder, mut outputs: Vec<[u32; 2]>) -> Result<Graph, GraphError> {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let mut rounded = Builder::new(builder.width(0));
        // of each value of the builder, its number in the rounded graph
        let mut places = vec![self.round(&mut rounded, 0, self.absolute, &mut random)?];
        for (number, step) in builder.steps().iter().enumerate() {
            let mut copy = step.clone();
            copy.rename(|of| places[of]);
            let made = rounded.add(copy, builder.width(number + 1))?;
            // copies are exact
            let is_copy = matches!(step, Step::Columns { .. });
            let is_sigmoid =
                matches!(step, Step::Elementwise { function: Elementwise::Activation(Activation::Sigmoid), .. });
            let absolute = if is_sigmoid { self.relative } else { self.absolute };
            places.push(if is_copy { made } else { self.round(&mut rounded, made, absolute, &mut random)? });
        }
        outputs.iter_mut().for_each(|[of, _]| *of = places[*of as usize] as u32);
        rounded.columns(outputs)?;
        Ok(Graph { inputs: rounded.width(0), steps: rounded.steps().to_vec() })
    }

    fn round(
        &self,
        builder: &mut Builder,
        of: usize,
        absolute: f64,
        random: &mut ChaCha8Rng,
    ) -> Result<usize, GraphError> {
        let width = builder.width(of);
        let mut parameters = Vec::with_capacity(2 * width);
        for (center, size) in [(1.0, self.relative), (0.0, absolute)] {
            parameters.extend((0..width).map(|_| center + size * (2.0 * random.random::<f64>() - 1.0)));
        }
        builder.elementwise(of, Elementwise::Linear, parameters)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_has_the_effect_of_the_conditioning() {
        // ln(sigmoid(80 x)), whose sigmoid is below the resolution of single precision at -0.5
        let mut builder = Builder::new(1);
        let scaled = builder.affine(0, vec![80.0].into(), vec![0.0].into()).unwrap();
        let sigmoid = Elementwise::Activation(Activation::Sigmoid);
        let squashed = builder.elementwise(scaled, sigmoid, Vec::new()).unwrap();
        let value = builder.elementwise(squashed, Elementwise::Logarithm, Vec::new()).unwrap();
        let columns = vec![[value as u32, 0]];
        let points = [[-0.5], [0.02], [0.1]];
        let exact = builder.clone().finish(columns.clone()).unwrap().evaluate(points);
        for seed in 0..4 {
            let single = RandomRounding { relative: 1.2e-7, absolute: 1.2e-38, seed };
            let found = single.of(&builder, columns.clone()).unwrap().evaluate(points);
            let effects: Vec<f64> =
                exact.iter().zip(&found).map(|(exact, found)| (exact[0] - found[0]).abs()).collect();
            // NaN of a negative number has no bound
            assert!(effects[0].is_nan() || effects[0] > 1e-3, "{effects:?}");
            // of 80 x, of the sigmoid and of the logarithm
            assert!(effects[1..].iter().all(|effect| *effect > 0.0 && *effect < 1.2e-7 * 4.0), "{effects:?}");
        }
    }
}
