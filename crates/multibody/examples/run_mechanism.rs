//! Times runs of a mechanism without the start of a process, and prints the rows of its outputs.
//!
//! `cargo run --release -p metafmu-multibody --example run_mechanism -- FILE TOLERANCE STOP ROWS REPETITIONS`
//!
//! The first line has the seconds of assembly, the second those of each run from the assembled state, further lines the rows. Parameters have
//! their defaults, inputs their starts.

use metafmu_multibody::{Mechanism, simulate::simulate_from};
use metafmu_numerics::integrate::Budget;
use std::{env, path::Path, time::Instant};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [file, tolerance, stop, rows, repetitions] = &arguments[..] else {
        return Err("expected FILE TOLERANCE STOP ROWS REPETITIONS".into());
    };
    let mechanism = Mechanism::load(Path::new(file))?;
    let (stop, rows): (f64, u32) = (stop.parse()?, rows.parse()?);
    let times: Vec<f64> = (0..=rows).map(|row| stop * f64::from(row) / f64::from(rows)).collect();
    let values: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
    let begin = Instant::now();
    let (mut model, measures) = mechanism.build(&values)?;
    model.tolerance = tolerance.parse()?;
    let (q, v) = model.initial_state(0.0)?;
    println!("{:e}", begin.elapsed().as_secs_f64());
    let (mut seconds, mut samples) = (Vec::new(), Vec::new());
    for _ in 0..repetitions.parse()? {
        let state = (q.clone(), v.clone(), model.actuator_starts());
        let begin = Instant::now();
        samples = simulate_from(&model, state, &times, &Budget::default())?;
        seconds.push(format!("{:e}", begin.elapsed().as_secs_f64()));
    }
    println!("{}", seconds.join(" "));
    for sample in &samples {
        let row: Vec<String> = measures.iter().map(|measure| format!("{:e}", measure.value(&model, sample))).collect();
        println!("{}", row.join(" "));
    }
    Ok(())
}
