//! Prints what a run of an FMU costs: `cargo run --release --example step_time -- FMU STOP STEP OUTPUT...`
//!
//! Microseconds of the fastest of several runs: a step with its outputs, and a new instance up to its first step.

use metafmu::{
    Result,
    fmi::{Fmu, host::StepResult, model_description::ScalarVariable},
};
use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

const LEAST_RUNS: usize = 5;
const LEAST_TIME: Duration = Duration::from_millis(500);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [fmu, stop, step, outputs @ ..] = arguments.as_slice() else {
        eprintln!("usage: step_time FMU STOP STEP OUTPUT...");
        return ExitCode::from(2);
    };
    let (Ok(stop), Ok(step)) = (stop.parse(), step.parse()) else {
        eprintln!("STOP and STEP are times in seconds");
        return ExitCode::from(2);
    };
    match measure(fmu, stop, step, outputs) {
        Ok((step, instance)) => {
            println!("{:.4} {:.1}", 1e6 * step.as_secs_f64(), 1e6 * instance.as_secs_f64());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Time of a step, and of an instance up to its first step.
fn measure(fmu: &str, stop: f64, step: f64, outputs: &[String]) -> Result<(Duration, Duration)> {
    let fmu = Fmu::open(fmu)?;
    let variables: Vec<&ScalarVariable> = outputs.iter().filter_map(|name| fmu.description().variable(name)).collect();
    let steps = (stop / step).round() as u32;
    let (mut fastest_step, mut fastest_instance) = (Duration::MAX, Duration::MAX);
    let (begin, mut runs) = (Instant::now(), 0);
    while runs < LEAST_RUNS || begin.elapsed() < LEAST_TIME {
        let before = Instant::now();
        let instance = fmu.instantiate("step_time", false)?;
        instance.enter_initialization_mode(0.0, Some(stop))?;
        instance.exit_initialization_mode()?;
        fastest_instance = fastest_instance.min(before.elapsed());
        let before = Instant::now();
        for index in 0..steps {
            if instance.do_step(f64::from(index) * step, step)? != StepResult::Done {
                break;
            }
            for variable in &variables {
                std::hint::black_box(instance.get_numbers(variable)?);
            }
        }
        fastest_step = fastest_step.min(before.elapsed() / steps);
        instance.terminate()?;
        runs += 1;
    }
    Ok((fastest_step, fastest_instance))
}
