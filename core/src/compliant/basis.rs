//! Products of Legendre polynomials up to a total degree, and their gradients in the same products.

use metafmu_runtime::graph::Products;
use std::collections::HashMap;

/// Products of Legendre polynomials of `z`, of ascending total degree: the first of them are those of a lower degree.
#[derive(Clone, Debug)]
pub(super) struct ProductBasis {
    pub products: Products,
    /// Total degree of each product, ascending.
    totals: Vec<usize>,
    /// Derivatives with respect to each column, product by product.
    derivatives: Vec<Vec<ProductDerivative>>,
}

/// Derivative of a product with respect to a column: products and their factors.
type ProductDerivative = Vec<(usize, f64)>;

impl ProductBasis {
    /// All products of `columns` polynomials up to a total degree.
    pub fn new(columns: usize, degree: u8) -> Self {
        let mut all = Products::up_to(columns, degree, usize::MAX).unwrap_or_default();
        let total = |degrees: &Vec<u8>| degrees.iter().map(|degree| usize::from(*degree)).sum::<usize>();
        all.sort_by_key(total);
        let places: HashMap<&[u8], usize> =
            all.iter().enumerate().map(|(at, degrees)| (degrees.as_slice(), at)).collect();
        // P'_n = sum of (2 k + 1) P_k over k = n - 1, n - 3, ...
        let derivative = |degrees: &Vec<u8>, column: usize| -> ProductDerivative {
            let lower = (0..degrees[column]).rev().step_by(2);
            lower
                .filter_map(|order| {
                    let mut other = degrees.clone();
                    other[column] = order;
                    Some((*places.get(other.as_slice())?, 2.0 * f64::from(order) + 1.0))
                })
                .collect()
        };
        let derivatives =
            (0..columns).map(|column| all.iter().map(|degrees| derivative(degrees, column)).collect()).collect();
        let totals = all.iter().map(total).collect();
        Self { products: Products { inputs: columns, degrees: all.concat() }, totals, derivatives }
    }

    /// Number of products up to a total degree.
    pub fn count(&self, degree: u8) -> usize {
        self.totals.partition_point(|total| *total <= usize::from(degree))
    }

    /// Derivative of a product with respect to a column.
    pub fn derivative(&self, column: usize, product: usize) -> &[(usize, f64)] {
        &self.derivatives[column][product]
    }

    /// Returns true if a product is a function of one of the columns from `first` on.
    pub fn depends(&self, product: usize, first: usize) -> bool {
        let columns = self.products.inputs;
        self.products.degrees[product * columns..][..columns][first..].iter().any(|degree| *degree > 0)
    }
}

/// Number of products of `columns` polynomials up to a total degree: `(columns + degree)! / (columns! degree!)`.
pub(super) fn size(columns: usize, degree: usize) -> usize {
    (1..=columns).fold(1, |count: usize, column| count.saturating_mul(degree + column) / column)
}
