//! A controller of another tool moves the surrogate of a crane: a co-simulation master that uses metafmu's host of FMUs
//! as a library.
//!
//! The coupling is that of `embedding/crane_control.py`, which makes the controller: both FMUs step over the same interval
//! with the values of its beginning (Jacobi). Prints a CSV table. The controller needs the Python that has made it first on
//! the PATH.
//!
//!     cargo run --release --example crane_control -- crane.fmu controller.fmu > result.csv

#[path = "embedding/variables.rs"]
mod variables;

use metafmu::{Result, fmi::Fmu};
use std::{
    env,
    fmt::Write as _,
    io::{Write as _, stdout},
};
use variables::{references, values};

const STOP: f64 = 10.0;
const STEP: f64 = 0.02;

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<_> = env::args_os().skip(1).collect();
    let [crane, controller] = paths.as_slice() else {
        return Err("expected two arguments: CRANE.fmu CONTROLLER.fmu".into());
    };
    let table = simulate(&Fmu::open(crane)?, &Fmu::open(controller)?)?;
    Ok(stdout().write_all(table.as_bytes())?)
}

fn simulate(crane: &Fmu, controller: &Fmu) -> Result<String> {
    let positions = references(crane, ["x", "theta"])?;
    let motor = references(crane, ["force"])?;
    let measured = references(controller, ["x", "theta"])?;
    let command = references(controller, ["force"])?;
    let (crane, controller) = (crane.instantiate("crane", false)?, controller.instantiate("controller", false)?);
    for instance in [&crane, &controller] {
        instance.enter_initialization_mode(0.0, Some(STOP))?;
        instance.exit_initialization_mode()?;
    }
    let mut table = String::from("time,x,theta,force\n");
    let steps = (STOP / STEP).round() as usize;
    for step in 0..=steps {
        let time = step as f64 * STEP;
        let [x, theta] = values(&crane, positions)?;
        let [force] = values(&controller, command)?;
        writeln!(table, "{time},{x},{theta},{force}").expect("a text takes all that is written");
        if step < steps {
            crane.set_real(&motor, &[force])?;
            controller.set_real(&measured, &[x, theta])?;
            crane.do_step(time, STEP)?;
            controller.do_step(time, STEP)?;
        }
    }
    crane.terminate()?;
    controller.terminate()?;
    Ok(table)
}
