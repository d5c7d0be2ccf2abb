//! Damped single pendulum (Choi et al. 2021, section 4.1).
//!
//! A point mass `m` on a massless rod of length `L`, damped by a force `c thetad`:
//! `thetadd + (g / L) sin(theta) + c / (m L) thetad = 0`.

use super::{System, SystemError, SystemOutput, SystemPoint, SystemQuantity};
use crate::integrate::{Budget, integrate};
use nalgebra::Vector2;

pub(super) static SYSTEM: System = System {
    name: "single-pendulum",
    description: "damped single pendulum, massless rod (Choi et al. 2021, section 4.1)",
    quantities: &[
        SystemQuantity { name: "L", unit: "m", description: "length of the massless rod", default: 0.15 },
        SystemQuantity { name: "c", unit: "kg.m/s", description: "damping coefficient", default: 0.0 },
        SystemQuantity { name: "thetad0", unit: "rad/s", description: "initial angular velocity", default: 0.0 },
        SystemQuantity {
            name: "theta0",
            unit: "rad",
            description: "initial angle",
            default: std::f64::consts::FRAC_PI_2,
        },
        SystemQuantity { name: "m", unit: "kg", description: "mass", default: 0.3 },
        SystemQuantity { name: "g", unit: "m/s2", description: "gravity", default: 9.81 },
    ],
    outputs: &[
        SystemOutput { name: "theta", unit: "rad", description: "angle from the downward vertical" },
        SystemOutput { name: "thetad", unit: "rad/s", description: "angular velocity" },
        SystemOutput { name: "thetadd", unit: "rad/s2", description: "angular acceleration" },
    ],
    points: &[SystemPoint {
        name: "mass",
        outputs: &["theta"],
        position: |quantities, outputs| [quantities[0] * outputs[0].sin(), -quantities[0] * outputs[0].cos()],
    }],
    mechanism: include_str!("single-pendulum.toml"),
    study: include_str!("single-pendulum-study.toml"),
    simulate,
};

fn simulate(quantities: &[f64], times: &[f64], tolerance: f64, budget: &Budget) -> Result<Vec<f64>, SystemError> {
    let &[length, damping, thetad0, theta0, mass, gravity] = quantities else {
        return Err(SYSTEM.wrong_count(quantities.len()));
    };
    let (stiffness, damping) = (gravity / length, damping / (mass * length));
    let acceleration = |theta: f64, thetad: f64| -stiffness * theta.sin() - damping * thetad;
    let states = integrate(
        |y| Vector2::new(y[1], acceleration(y[0], y[1])),
        Vector2::new(theta0, thetad0),
        times,
        tolerance,
        budget,
    )?;
    Ok(states.iter().flat_map(|y| [y[0], y[1], acceleration(y[0], y[1])]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::TOLERANCE;

    fn run(length: f64, damping: f64, thetad0: f64, times: &[f64]) -> Vec<f64> {
        simulate(
            &[length, damping, thetad0, std::f64::consts::FRAC_PI_2, 0.3, 9.81],
            times,
            TOLERANCE,
            &Budget::default(),
        )
        .unwrap()
    }

    fn grid(stop: f64, count: u32) -> Vec<f64> {
        (0..=count).map(|i| stop * f64::from(i) / f64::from(count)).collect()
    }

    #[test]
    fn agrees_with_the_papers_sample_rows_to_five_decimals() {
        // Choi et al., table of S_full: printed for L = 0.0, 0.1, 0.2 and c = 0, 0.05, 0.1, computed for L = 0.1 and
        // c = 0, 0.01, 0.02 with thetad0 = 0 (their slip); the first row of each set is the initial state
        #[expect(clippy::approx_constant, reason = "printed to five decimals in the paper")]
        for (damping, rows) in [
            (0.00, [[1.57080, 0.00000], [1.56589, -0.98100], [1.55118, -1.96192]]),
            (0.01, [[1.57080, 0.00000], [1.56590, -0.97936], [1.55122, -1.95540]]),
            (0.02, [[1.57080, 0.00000], [1.56590, -0.97773], [1.55126, -1.94890]]),
        ] {
            let values = run(0.1, damping, 0.0, &[0.0, 0.01, 0.02]);
            for (row, expected) in rows.iter().enumerate() {
                for (column, expected) in expected.iter().enumerate() {
                    let found: f64 = values[3 * row + column];
                    assert!((found - expected).abs() < 5.1e-6, "c = {damping}, row {row}: {found}, paper {expected}");
                }
            }
        }
    }

    #[test]
    fn energy_is_kept_without_damping() {
        for (length, thetad0) in [(0.1, 0.0), (0.1, 5.0), (0.2, 5.0)] {
            let values = run(length, 0.0, thetad0, &grid(2.0, 200));
            // per unit of m L: kinetic energy and height of the mass
            let energy = |row: &[f64]| 0.5 * length * row[1] * row[1] - 9.81 * row[0].cos();
            let initial = energy(&values[..3]);
            let drift = values.chunks(3).map(|row| (energy(row) - initial).abs()).fold(0.0, f64::max);
            assert!(drift < 1e-10 * 9.81, "L = {length}, thetad0 = {thetad0}: {drift:e}");
        }
    }

    #[test]
    fn small_damped_swings_agree_with_the_closed_form() {
        let (length, damping, mass, amplitude) = (0.15, 0.05, 0.3, 1e-4_f64);
        let times = grid(2.0, 200);
        let values =
            simulate(&[length, damping, 0.0, amplitude, mass, 9.81], &times, TOLERANCE, &Budget::default()).unwrap();
        let decay = damping / (2.0 * mass * length);
        let omega = (9.81 / length - decay * decay).sqrt();
        for (row, &t) in values.chunks(3).zip(&times) {
            let exact = amplitude * (-decay * t).exp() * ((omega * t).cos() + decay / omega * (omega * t).sin());
            // sin(theta) - theta is of the order of amplitude cubed
            assert!((row[0] - exact).abs() < 20.0 * amplitude.powi(3), "t = {t}");
        }
    }
}
