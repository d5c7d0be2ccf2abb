//! Motions that were recorded: what equations are learned from where their source cannot be asked.

/// A motion in rows that are equally far apart in time.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Values of the parameters.
    pub parameters: Vec<f64>,
    /// Time between two rows, in seconds.
    pub step: f64,
    /// Number of generalized coordinates.
    pub coordinates: usize,
    /// Generalized coordinates, row by row: shape `[rows, coordinates]`.
    pub q: Vec<f64>,
    /// Their rates, likewise.
    pub v: Vec<f64>,
    /// Inputs, row by row: shape `[rows, inputs]`. Between two rows they are linear.
    pub u: Vec<f64>,
}

impl Trajectory {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.q.len() / self.coordinates.max(1)
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.u.len() / self.rows().max(1)
    }

    /// The first rows.
    pub fn first(&self, rows: usize) -> Self {
        let rows = rows.min(self.rows());
        let part = |values: &[f64], width: usize| values[..rows * width].to_vec();
        let Self { coordinates, .. } = *self;
        Self {
            parameters: self.parameters.clone(),
            step: self.step,
            coordinates,
            q: part(&self.q, coordinates),
            v: part(&self.v, coordinates),
            u: part(&self.u, self.inputs()),
        }
    }

    /// Accelerations by [`differences`] of the rates, shape `[rows, coordinates]`.
    pub fn accelerations(&self) -> Vec<f64> {
        let columns: Vec<Vec<f64>> =
            (0..self.coordinates).map(|k| differences(&self.v, self.coordinates, k, self.step)).collect();
        (0..self.rows()).flat_map(|row| columns.iter().map(move |column| column[row])).collect()
    }
}

/// Rows that a difference needs: it is of order six.
pub const STENCIL: usize = 7;

/// Numerators of the difference quotients of order six at each of seven rows, over 60.
const WEIGHTS: [[f64; STENCIL]; STENCIL] = [
    [-147.0, 360.0, -450.0, 400.0, -225.0, 72.0, -10.0],
    [-10.0, -77.0, 150.0, -100.0, 50.0, -15.0, 2.0],
    [2.0, -24.0, -35.0, 80.0, -30.0, 8.0, -1.0],
    [-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0],
    [1.0, -8.0, 30.0, -80.0, 35.0, 24.0, -2.0],
    [-2.0, 15.0, -50.0, 100.0, -150.0, 77.0, 10.0],
    [10.0, -72.0, 225.0, -400.0, 450.0, -360.0, 147.0],
];

/// Derivatives with respect to time of a column of `values`, shape `[rows, columns]`, at all rows, which are `step` apart: differences of
/// order six, central but for three rows at either end. Noise of the values is multiplied by `1.1 / step`, at the very ends by `13 / step`.
/// NaN if there are fewer than seven rows.
pub fn differences(values: &[f64], columns: usize, column: usize, step: f64) -> Vec<f64> {
    let series: Vec<f64> = values.iter().skip(column).step_by(columns).copied().collect();
    let rows = series.len();
    if rows < STENCIL {
        return vec![f64::NAN; rows];
    }
    let at = |row: usize| {
        let first = row.saturating_sub(STENCIL / 2).min(rows - STENCIL);
        let weights = &WEIGHTS[row - first];
        weights.iter().zip(&series[first..]).map(|(weight, value)| weight * value).sum::<f64>() / (60.0 * step)
    };
    (0..rows).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_exact_for_polynomials_of_degree_six_and_of_order_six() {
        let values =
            |of: &dyn Fn(f64) -> f64, step: f64| (0..20).flat_map(|k| [9.0, of(step * k as f64)]).collect::<Vec<_>>();
        let polynomial = values(&|t| t.powi(6) - 2.0 * t.powi(5) + t, 0.1);
        for (k, found) in differences(&polynomial, 2, 1, 0.1).into_iter().enumerate() {
            let t = 0.1 * k as f64;
            let expected = 6.0 * t.powi(5) - 10.0 * t.powi(4) + 1.0;
            assert!((found - expected).abs() < 1e-10, "{k}: {found} {expected}");
        }
        let error = |step: f64| {
            let found = differences(&values(&f64::sin, step), 2, 1, step);
            found.iter().enumerate().map(|(k, found)| (found - (step * k as f64).cos()).abs()).fold(0.0, f64::max)
        };
        assert!((50.0..80.0).contains(&(error(0.2) / error(0.1))), "{}", error(0.2) / error(0.1));
        assert!(differences(&[1.0; 6], 1, 0, 0.1).iter().all(|value| value.is_nan()));
    }
}
