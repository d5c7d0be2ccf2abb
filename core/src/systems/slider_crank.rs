//! Kinematic slider crank (Choi et al. 2021, section 4.3).
//!
//! A crank of radius `r` is driven by `thetadd = sin(tau t)` from rest at `theta = 0`; a rod of length `L` leads to a slider
//! on the line through the crank's axis. `phi` is the rod's angle and `x_B` the slider's position:
//! - `theta = t / tau - sin(tau t) / tau²`
//! - `r sin(theta) + L sin(phi) = 0`
//! - `x_B = r cos(theta) + L cos(phi)`
//!
//! Velocities and accelerations by differentiating both constraints.

use super::{System, SystemError, SystemOutput, SystemPoint, SystemQuantity};
use crate::integrate::Budget;

pub(super) static SYSTEM: System = System {
    name: "slider-crank",
    description: "kinematic slider crank (Choi et al. 2021, section 4.3)",
    quantities: &[
        SystemQuantity { name: "tau", unit: "rad/s", description: "angular frequency of the drive", default: 1.5 },
        SystemQuantity { name: "r", unit: "m", description: "radius of the crank", default: 2.0 },
        SystemQuantity {
            name: "L_over_r",
            unit: "",
            description: "length of the rod over radius of the crank",
            default: 3.0,
        },
    ],
    outputs: &[
        SystemOutput { name: "theta", unit: "rad", description: "crank angle" },
        SystemOutput { name: "phi", unit: "rad", description: "rod angle" },
        SystemOutput { name: "phid", unit: "rad/s", description: "rod angular velocity" },
        SystemOutput { name: "phidd", unit: "rad/s2", description: "rod angular acceleration" },
        SystemOutput { name: "xB", unit: "m", description: "slider position" },
        SystemOutput { name: "xBd", unit: "m/s", description: "slider velocity" },
        SystemOutput { name: "xBdd", unit: "m/s2", description: "slider acceleration" },
    ],
    points: &[
        SystemPoint {
            name: "crank pin",
            outputs: &["theta"],
            position: |q, outputs| [q[1] * outputs[0].cos(), q[1] * outputs[0].sin()],
        },
        SystemPoint {
            name: "middle of the rod",
            outputs: &["theta", "phi"],
            position: |q, outputs| {
                let (radius, half) = (q[1], 0.5 * q[1] * q[2]);
                [
                    radius * outputs[0].cos() + half * outputs[1].cos(),
                    radius * outputs[0].sin() + half * outputs[1].sin(),
                ]
            },
        },
    ],
    mechanism: include_str!("slider-crank.toml"),
    study: include_str!("slider-crank-study.toml"),
    simulate,
};

fn simulate(quantities: &[f64], times: &[f64], _: f64, _: &Budget) -> Result<Vec<f64>, SystemError> {
    let &[tau, radius, ratio] = quantities else {
        return Err(SYSTEM.wrong_count(quantities.len()));
    };
    if ratio.abs() <= 1.0 {
        return Err(SystemError::ShortRod { ratio });
    }
    let rows: Vec<f64> = times.iter().flat_map(|&t| row(tau, radius, ratio, t)).collect();
    if rows.iter().all(|value| value.is_finite()) { Ok(rows) } else { Err(SystemError::NotFinite) }
}

fn row(tau: f64, radius: f64, ratio: f64, t: f64) -> [f64; 7] {
    let length = ratio * radius;
    let theta = t / tau - (tau * t).sin() / (tau * tau);
    let thetad = (1.0 - (tau * t).cos()) / tau;
    let thetadd = (tau * t).sin();
    let (sin_theta, cos_theta) = theta.sin_cos();
    let phi = (-sin_theta / ratio).asin();
    let (sin_phi, cos_phi) = phi.sin_cos();
    let phid = -cos_theta * thetad / (ratio * cos_phi);
    let phidd = (-(cos_theta * thetadd - sin_theta * thetad * thetad) / ratio + sin_phi * phid * phid) / cos_phi;
    let x = radius * cos_theta + length * cos_phi;
    let xd = -radius * sin_theta * thetad - length * sin_phi * phid;
    let xdd = -radius * (cos_theta * thetad * thetad + sin_theta * thetadd)
        - length * (cos_phi * phid * phid + sin_phi * phidd);
    [theta, phi, phid, phidd, x, xd, xdd]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::TOLERANCE;

    #[test]
    fn the_constraints_hold_and_the_crank_follows_its_drive() {
        for t in [0.0, 0.7, 2.0, 4.9] {
            let (tau, radius, ratio) = (1.78, 1.36, 3.05);
            let [theta, phi, .., x, _, _] = row(tau, radius, ratio, t);
            let length = ratio * radius;
            assert!((radius * theta.sin() + length * phi.sin()).abs() < 1e-14);
            // the slider is at the rod's length from the crank pin
            let distance = (x - radius * theta.cos()).hypot(radius * theta.sin());
            assert!((distance - length).abs() < 1e-13);
        }
    }

    #[test]
    fn velocities_and_accelerations_are_the_differences_of_positions() {
        let (tau, radius, ratio, h) = (1.3, 2.4, 2.6, 1e-4);
        for t in [0.5, 1.7, 3.3, 4.8] {
            let [before, now, after] = [t - h, t, t + h].map(|t| row(tau, radius, ratio, t));
            for (position, velocity, acceleration) in [(1, 2, 3), (4, 5, 6)] {
                let first = (after[position] - before[position]) / (2.0 * h);
                let second = (after[position] - 2.0 * now[position] + before[position]) / (h * h);
                assert!((now[velocity] - first).abs() < 1e-6, "t = {t}");
                assert!((now[acceleration] - second).abs() < 1e-6, "t = {t}: {} {second}", now[acceleration]);
            }
            let second = (after[0] - 2.0 * now[0] + before[0]) / (h * h);
            assert!(((tau * t).sin() - second).abs() < 1e-6, "the drive, t = {t}");
        }
    }

    #[test]
    fn a_rod_too_short_for_the_crank_is_refused() {
        let error = simulate(&[1.5, 2.0, 0.9], &[0.0, 1.0], TOLERANCE, &Budget::default()).unwrap_err();
        assert_eq!(error, SystemError::ShortRod { ratio: 0.9 });
        assert!(error.to_string().contains("longer than the crank"), "{error}");
    }
}
