//! Double pendulum (Choi et al. 2021, section 4.2).
//!
//! Point masses `m1`, `m2` on massless rods `L1`, `L2`; `theta1`, `theta2` are measured from the downward vertical:
//! - `(m1 + m2) L1 theta1dd + m2 L2 theta2dd cos(theta1 - theta2) + m2 L2 theta2d² sin(theta1 - theta2)
//!   + (m1 + m2) g sin(theta1) = 0`
//! - `m2 L2 theta2dd + m2 L1 theta1dd cos(theta1 - theta2) - m2 L1 theta1d² sin(theta1 - theta2) + m2 g sin(theta2) = 0`

use super::{System, SystemError, SystemOutput, SystemPoint, SystemQuantity};
use crate::integrate::{Budget, integrate};
use nalgebra::{Matrix2, Vector2, Vector4};

pub(super) static SYSTEM: System = System {
    name: "double-pendulum",
    description: "double pendulum, massless rods (Choi et al. 2021, section 4.2)",
    quantities: &[
        SystemQuantity { name: "L1", unit: "m", description: "length of the upper rod", default: 1.5 },
        SystemQuantity { name: "L2", unit: "m", description: "length of the lower rod", default: 2.5 },
        SystemQuantity {
            name: "theta1d0",
            unit: "rad/s",
            description: "initial angular velocity, upper",
            default: 0.0,
        },
        SystemQuantity {
            name: "theta2d0",
            unit: "rad/s",
            description: "initial angular velocity, lower",
            default: 0.3,
        },
        SystemQuantity { name: "theta10", unit: "rad", description: "initial angle, upper", default: 1.6 },
        SystemQuantity { name: "theta20", unit: "rad", description: "initial angle, lower", default: 1.6 },
        SystemQuantity { name: "m1", unit: "kg", description: "upper mass", default: 2.0 },
        SystemQuantity { name: "m2", unit: "kg", description: "lower mass", default: 1.0 },
        SystemQuantity { name: "g", unit: "m/s2", description: "gravity", default: 9.81 },
    ],
    outputs: &[
        SystemOutput { name: "theta1", unit: "rad", description: "angle of the upper rod" },
        SystemOutput { name: "theta2", unit: "rad", description: "angle of the lower rod" },
        SystemOutput { name: "theta1d", unit: "rad/s", description: "angular velocity of the upper rod" },
        SystemOutput { name: "theta2d", unit: "rad/s", description: "angular velocity of the lower rod" },
    ],
    points: &[
        SystemPoint {
            name: "upper mass",
            outputs: &["theta1"],
            position: |q, angles| end([0.0, 0.0], q[0], angles[0]),
        },
        SystemPoint {
            name: "lower mass",
            outputs: &["theta1", "theta2"],
            position: |q, angles| end(end([0.0, 0.0], q[0], angles[0]), q[1], angles[1]),
        },
    ],
    mechanism: include_str!("double-pendulum.toml"),
    study: include_str!("double-pendulum-study.toml"),
    simulate,
};

/// End of a rod that hangs from a point.
fn end([x, y]: [f64; 2], length: f64, angle: f64) -> [f64; 2] {
    [x + length * angle.sin(), y - length * angle.cos()]
}

struct DoublePendulum {
    lengths: [f64; 2],
    masses: [f64; 2],
    gravity: f64,
}

impl DoublePendulum {
    /// Angular accelerations: the two equations solved for `theta1dd`, `theta2dd`.
    fn accelerations(&self, [theta1, theta2, theta1d, theta2d]: [f64; 4]) -> Option<Vector2<f64>> {
        let ([l1, l2], [m1, m2], g) = (self.lengths, self.masses, self.gravity);
        let (sine, cosine) = (theta1 - theta2).sin_cos();
        let matrix = Matrix2::new((m1 + m2) * l1, m2 * l2 * cosine, m2 * l1 * cosine, m2 * l2);
        let forces = Vector2::new(
            -m2 * l2 * theta2d * theta2d * sine - (m1 + m2) * g * theta1.sin(),
            m2 * l1 * theta1d * theta1d * sine - m2 * g * theta2.sin(),
        );
        Some(matrix.try_inverse()? * forces)
    }
}

fn simulate(quantities: &[f64], times: &[f64], tolerance: f64, budget: &Budget) -> Result<Vec<f64>, SystemError> {
    let &[l1, l2, theta1d0, theta2d0, theta10, theta20, m1, m2, gravity] = quantities else {
        return Err(SYSTEM.wrong_count(quantities.len()));
    };
    let model = DoublePendulum { lengths: [l1, l2], masses: [m1, m2], gravity };
    let initial = Vector4::new(theta10, theta20, theta1d0, theta2d0);
    // a singular mass matrix (a rod or mass of zero) shows as a state that is not finite
    let derivative = |y: &Vector4<f64>| {
        let accelerations = model.accelerations((*y).into()).unwrap_or(Vector2::repeat(f64::NAN));
        Vector4::new(y[2], y[3], accelerations[0], accelerations[1])
    };
    let states = integrate(derivative, initial, times, tolerance, budget)?;
    Ok(states.iter().flat_map(|y| <[f64; 4]>::from(*y)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::TOLERANCE;

    fn grid(stop: f64, count: u32) -> Vec<f64> {
        (0..=count).map(|i| stop * f64::from(i) / f64::from(count)).collect()
    }

    #[test]
    fn energy_is_kept() {
        let (l1, l2, m1, m2, g) = (1.3, 2.2, 2.0, 1.0, 9.81);
        let values =
            simulate(&[l1, l2, 0.1, 0.5, 1.6, 1.6, m1, m2, g], &grid(5.0, 500), TOLERANCE, &Budget::default()).unwrap();
        let energy = |row: &[f64]| {
            let (a, b, ad, bd) = (row[0], row[1], row[2], row[3]);
            let (v1, v2) = ((l1 * ad).powi(2), (l2 * bd).powi(2) + 2.0 * l1 * l2 * ad * bd * (a - b).cos());
            0.5 * (m1 + m2) * v1 + 0.5 * m2 * v2 - (m1 + m2) * g * l1 * a.cos() - m2 * g * l2 * b.cos()
        };
        let initial = energy(&values[..4]);
        let drift = values.chunks(4).map(|row| (energy(row) - initial).abs()).fold(0.0, f64::max);
        assert!(drift < 1e-9, "{drift:e} J");
    }

    #[test]
    fn small_swings_are_the_two_normal_modes() {
        // equal lengths and masses: omega² = (2 -+ sqrt 2) g / l, amplitudes 1 : +- sqrt 2
        let (l, g, amplitude) = (1.0, 9.81, 1e-5);
        let times = grid(5.0, 500);
        for sign in [-1.0, 1.0] {
            let ratio = -sign * 2f64.sqrt();
            let omega = ((2.0 + sign * 2f64.sqrt()) * g / l).sqrt();
            let values = simulate(
                &[l, l, 0.0, 0.0, amplitude, ratio * amplitude, 1.0, 1.0, g],
                &times,
                TOLERANCE,
                &Budget::default(),
            )
            .unwrap();
            for (row, t) in values.chunks(4).zip(&times) {
                let exact = amplitude * (omega * t).cos();
                assert!((row[0] - exact).abs() < 1e-11, "mode {sign}, t = {t}: {} {exact}", row[0]);
                assert!((row[1] - ratio * exact).abs() < 1e-11, "mode {sign}, t = {t}");
            }
        }
    }
}
