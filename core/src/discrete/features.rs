//! Nonlinear functions of the columns of a state space: none, nodes of a network, or products.

use metafmu_runtime::graph::Products;

/// Standardized magnitude at which products take the end of a column's range: `z / SPAN` is in `[-1, 1]`.
pub const SPAN: f64 = 3.0;

/// Functions of the columns `z`.
#[derive(Clone, Debug, PartialEq)]
pub enum Features {
    /// Number of functions `tanh(W z + b)`; 0 for a linear state space.
    Nodes(usize),
    /// Products of Legendre polynomials of `z / SPAN`.
    Products(Products),
}

/// Values of features, and their slopes in the states.
pub struct FeatureValues {
    pub values: Vec<f64>,
    /// Shape `[features, states]`.
    pub slopes: Vec<f64>,
    states: usize,
    /// Legendre polynomials of the columns, each with its slope, shape `[columns, orders]`.
    polynomials: Vec<[f64; 2]>,
    /// Factors of all products: column and position of the polynomial.
    factors: Vec<[usize; 2]>,
    /// End of the factors of each product.
    ends: Vec<usize>,
}

impl Features {
    /// All products of powers with a sum from 2 to `degree`, of the columns that are `among` them; none if there are more than `most`.
    pub fn products(columns: usize, degree: u8, among: impl Fn(usize) -> bool, most: usize) -> Option<Self> {
        let among: Vec<usize> = (0..columns).filter(|column| among(*column)).collect();
        let all = Products::up_to(among.len(), degree, most + among.len() + 1)?;
        let is_nonlinear = |powers: &&Vec<u8>| powers.iter().sum::<u8>() > 1;
        let in_columns = |powers: &Vec<u8>| {
            let mut degrees = vec![0; columns];
            among.iter().zip(powers).for_each(|(column, power)| degrees[*column] = *power);
            degrees
        };
        let degrees = all.iter().filter(is_nonlinear).flat_map(in_columns).collect();
        Some(Self::Products(Products { inputs: columns, degrees }))
    }

    /// Number of functions.
    pub fn count(&self) -> usize {
        match self {
            Self::Nodes(count) => *count,
            Self::Products(products) => products.terms(),
        }
    }

    /// Number of nodes, which have weights and biases.
    pub fn nodes(&self) -> usize {
        if let Self::Nodes(count) = self { *count } else { 0 }
    }
}

impl FeatureValues {
    /// Memory for features of `states` states.
    pub fn new(features: &Features, states: usize) -> Self {
        let count = features.count();
        let mut found = Self {
            values: vec![0.0; count],
            slopes: vec![0.0; count * states],
            states,
            polynomials: Vec::new(),
            factors: Vec::new(),
            ends: Vec::new(),
        };
        if let Features::Products(products) = features {
            let orders = products.orders();
            found.polynomials = vec![[0.0; 2]; products.polynomials()];
            for degrees in products.degrees.chunks_exact(products.inputs) {
                let factors = degrees.iter().enumerate().filter(|(_, degree)| **degree > 0);
                found.factors.extend(factors.map(|(column, degree)| [column, column * orders + usize::from(*degree)]));
                found.ends.push(found.factors.len());
            }
        }
        found
    }

    /// Values at columns `z`; `weights` and `biases` are those of nodes.
    pub fn evaluate(&mut self, features: &Features, [weights, biases]: [&[f64]; 2], z: &[f64]) {
        match features {
            Features::Nodes(_) => {
                let nodes = weights.chunks_exact(z.len()).zip(biases);
                for (value, (weights, bias)) in self.values.iter_mut().zip(nodes) {
                    *value = (bias + weights.iter().zip(z).map(|(weight, z)| weight * z).sum::<f64>()).tanh();
                }
            }
            Features::Products(products) => {
                let orders = products.orders();
                let of_columns = self.polynomials.chunks_exact_mut(orders);
                z.iter().zip(of_columns).for_each(|(z, polynomials)| legendre(z / SPAN, polynomials));
                let mut begin = 0;
                for (value, end) in self.values.iter_mut().zip(&self.ends) {
                    *value = self.factors[begin..*end].iter().map(|[_, place]| self.polynomials[*place][0]).product();
                    begin = *end;
                }
            }
        }
    }

    /// Slopes at the columns of the last [evaluation](Self::evaluate).
    pub fn differentiate(&mut self, features: &Features, weights: &[f64]) {
        let states = self.states;
        match features {
            Features::Nodes(nodes) => {
                let columns = weights.len() / nodes.max(&1);
                for (node, value) in self.values.iter().enumerate() {
                    let slope = 1.0 - value * value;
                    let weights = &weights[node * columns..][..states];
                    let slopes = &mut self.slopes[node * states..][..states];
                    slopes.iter_mut().zip(weights).for_each(|(found, weight)| *found = slope * weight);
                }
            }
            Features::Products(_) => {
                let mut begin = 0;
                for (slopes, end) in self.slopes.chunks_exact_mut(states).zip(&self.ends) {
                    let factors = &self.factors[begin..*end];
                    // slopes in columns without a factor stay zero
                    for &[state, _] in factors.iter().take_while(|[column, _]| *column < states) {
                        let of = |[column, place]: &[usize; 2]| self.polynomials[*place][usize::from(*column == state)];
                        slopes[state] = factors.iter().map(of).product::<f64>() / SPAN;
                    }
                    begin = *end;
                }
            }
        }
    }
}

/// `P_0(x), P_1(x), ...` by Bonnet's recursion, each with its slope, `P'_(k+1) = P'_(k-1) + (2k + 1) P_k`.
fn legendre(x: f64, polynomials: &mut [[f64; 2]]) {
    for order in 0..polynomials.len() {
        polynomials[order] = match order {
            0 => [1.0, 0.0],
            1 => [x, 1.0],
            _ => {
                let (last, before) = (polynomials[order - 1], polynomials[order - 2]);
                let k = order as f64 - 1.0;
                let factor = 2.0 * k + 1.0;
                [(factor * x * last[0] - k * before[0]) / (k + 1.0), before[1] + factor * last[0]]
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_with_a_sum_of_powers_from_two() {
        let Some(Features::Products(products)) = Features::products(3, 3, |column| column != 1, 100) else { panic!() };
        // x², xy, y², x³, x²y, xy², y³
        assert_eq!(products.terms(), 7);
        assert!(products.degrees.chunks_exact(3).all(|degrees| degrees[1] == 0));
        assert!(Features::products(10, 3, |_| true, 100).is_none());
    }

    #[test]
    fn legendre_polynomials_have_their_slopes() {
        let mut found = [[0.0; 2]; 4];
        legendre(0.3, &mut found);
        let x: f64 = 0.3;
        let expected = [
            [1.0, 0.0],
            [x, 1.0],
            [(3.0 * x * x - 1.0) / 2.0, 3.0 * x],
            [(5.0 * x.powi(3) - 3.0 * x) / 2.0, (15.0 * x * x - 3.0) / 2.0],
        ];
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-14);
        }
    }
}
