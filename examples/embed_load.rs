//! The slider crank's surrogate moves a load: a co-simulation master that uses metafmu's host of FMUs as a library.
//!
//! The coupling is that of `embedding/master.py`: both FMUs step over the same interval, and the load keeps the slider's
//! acceleration of the interval's beginning (Jacobi). Prints a CSV table.
//!
//!     cargo run --release --example embed_load -- slider-crank.fmu load.fmu > result.csv

#[path = "embedding/variables.rs"]
mod variables;

use metafmu::{Result, fmi::Fmu};
use std::{
    env,
    fmt::Write as _,
    io::{Write as _, stdout},
};
use variables::{references, values};

const STOP: f64 = 5.0;
const STEP: f64 = 1e-3;

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<_> = env::args_os().skip(1).collect();
    let [slider_crank, load] = paths.as_slice() else {
        return Err("expected two arguments: SLIDER_CRANK.fmu LOAD.fmu".into());
    };
    let table = simulate(&Fmu::open(slider_crank)?, &Fmu::open(load)?)?;
    Ok(stdout().write_all(table.as_bytes())?)
}

fn simulate(slider_crank: &Fmu, load: &Fmu) -> Result<String> {
    let motion = references(slider_crank, ["xB", "xBdd"])?;
    let acceleration = references(load, ["acceleration"])?;
    let response = references(load, ["displacement", "force"])?;
    let (slider, load) = (slider_crank.instantiate("slider_crank", false)?, load.instantiate("load", false)?);
    for instance in [&slider, &load] {
        instance.enter_initialization_mode(0.0, Some(STOP))?;
        instance.exit_initialization_mode()?;
    }
    let mut table = String::from("time,xB,xBdd,displacement,force\n");
    let steps = (STOP / STEP).round() as usize;
    for step in 0..=steps {
        let time = step as f64 * STEP;
        let [x, xdd] = values(&slider, motion)?;
        let [displacement, force] = values(&load, response)?;
        writeln!(table, "{time},{x},{xdd},{displacement},{force}").expect("a text takes all that is written");
        if step < steps {
            load.set_real(&acceleration, &[xdd])?;
            slider.do_step(time, STEP)?;
            load.do_step(time, STEP)?;
        }
    }
    slider.terminate()?;
    load.terminate()?;
    Ok(table)
}
