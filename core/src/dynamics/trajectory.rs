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
    /// Rates of the generalized coordinates, row by row: shape `[rows, coordinates]`.
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
        let Self { coordinates, .. } = *self;
        Self {
            parameters: self.parameters.clone(),
            step: self.step,
            coordinates,
            q: self.q[..rows * coordinates].to_vec(),
            v: self.v[..rows * coordinates].to_vec(),
            u: self.u[..rows * self.inputs()].to_vec(),
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
    let differences = (0..rows).map(|row| {
        let first = row.saturating_sub(STENCIL / 2).min(rows - STENCIL);
        let weights = &WEIGHTS[row - first];
        weights.iter().zip(&series[first..]).map(|(weight, value)| weight * value).sum::<f64>() / (60.0 * step)
    });
    differences.collect()
}

/// Differences of a rate and of the differences of its coordinate that are told, as a part of the rate.
const TOLD: f64 = 1e-4;

/// By how much a column that is given as the rate of a coordinate is not its derivative, and how good [`differences`] are: root mean squares,
/// relative to that of the rate. None if the rate is as good as they are, or there are too few rows. Differences of every second row show how
/// good they are.
pub fn disagreement(values: &[f64], rates: &[f64], step: f64) -> Option<[f64; 2]> {
    if values.len() < 4 * STENCIL || values.len() != rates.len() {
        return None;
    }
    let fine = differences(values, 1, 0, step);
    let (mut coarse, mut count) = (0.0, 0);
    for phase in 0..2 {
        let part: Vec<f64> = values.iter().skip(phase).step_by(2).copied().collect();
        let found = differences(&part, 1, 0, 2.0 * step);
        // differences at the ends are worse
        for row in STENCIL / 2..found.len() - STENCIL / 2 {
            coarse += (found[row] - fine[2 * row + phase]).powi(2);
            count += 1;
        }
    }
    let within = STENCIL / 2..values.len() - STENCIL / 2;
    let mean = |of: &dyn Fn(usize) -> f64| within.clone().map(|row| of(row).powi(2)).sum::<f64>() / within.len() as f64;
    let size = mean(&|row| rates[row]).sqrt();
    let [found, own] = [mean(&|row| rates[row] - fine[row]).sqrt(), (coarse / f64::from(count.max(1))).sqrt()]
        .map(|error| error / size);
    (found > TOLD && found > 2.0 * own).then_some([found, own])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_rate_that_is_not_the_derivative_is_noticed_and_noise_of_the_coordinate_is_not() {
        let step = 0.01;
        let of = |value: &dyn Fn(f64) -> f64| (0..400).map(|row| value(step * f64::from(row))).collect::<Vec<f64>>();
        // two whole periods in the rows that count
        let omega = 2.0 * TAU / (394.0 * step);
        let values = of(&|t| (omega * t).sin());
        let rate = of(&|t| omega * (omega * t).cos());
        assert_eq!(disagreement(&values, &rate, step), None);
        // half a step late
        let late = of(&|t| omega * (omega * (t - 0.5 * step)).cos());
        let [found, own] = disagreement(&values, &late, step).unwrap();
        assert!((found - 0.5 * omega * step).abs() < 1e-6 && own < 1e-6, "{found} {own}");
        // noise without a period: quadratic phases
        let noise = |row: i32| (0.618_033_988_75 * f64::from(row * row)).fract() - 0.5;
        let noisy: Vec<f64> = values.iter().zip(0..).map(|(value, row)| value + 1e-3 * noise(row)).collect();
        assert_eq!(disagreement(&noisy, &rate, step), None);
        assert_eq!(disagreement(&values[..20], &late[..20], step), None);
    }

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
