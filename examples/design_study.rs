//! A design study: many parameter sets through one instance of an FMU, compared with metafmu's integrator in one
//! thread.
//!
//! Reads parameter sets from POINTS.csv and writes the outputs at the stop time to RESULT.csv. It prints the seconds
//! that a run takes for each of BLOCKS equal shares of the sets. They are those of the FMU step by step, of the FMU in
//! one step from start to stop, and of the integrator. `embedding/design_study.py` uses it.
//!
//!     cargo run --release --example design_study -- STUDY.toml NAME.fmu POINTS.csv RESULT.csv BLOCKS

use metafmu::{
    fmi::{Fmu, FmuInstance, SimulationOptions, simulate},
    source::Simulation,
    study::Study,
};
use std::{env, error::Error, hint::black_box, path::Path, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [study, fmu, points, result, blocks] = arguments.as_slice() else {
        return Err("expected five arguments: STUDY.toml NAME.fmu POINTS.csv RESULT.csv BLOCKS".into());
    };
    let source = Simulation::new(&Study::load(Path::new(study))?)?;
    let names: Vec<&str> = source.parameters().iter().map(|parameter| parameter.name.as_str()).collect();
    let mut reader = csv::Reader::from_path(points)?;
    if reader.headers()? != names {
        return Err(format!("{points}: expected the columns {names:?}").into());
    }
    let points: Vec<Vec<f64>> = reader.deserialize().collect::<Result<_, _>>()?;
    let block = points.len().div_ceil(blocks.parse::<usize>()?.max(1)).max(1);

    let fmu = Fmu::open(fmu)?;
    let instance = fmu.instantiate("design_study", false)?;
    // the FMU has further outputs
    let outputs: Vec<&str> = source.outputs().iter().map(|output| output.name.as_str()).collect();
    let mut results = csv::Writer::from_path(result)?;
    results.write_record(&outputs)?;
    let stop = *source.times().last().ok_or("the study has no times")?;
    for points in points.chunks(block) {
        let started = Instant::now();
        for point in points {
            let ends = end(&instance, &names, point, None)?;
            let ends = ends.iter().filter(|(name, _)| outputs.contains(&name.as_str()));
            results.serialize(ends.map(|(_, value)| value).collect::<Vec<_>>())?;
        }
        let by_steps = started.elapsed();
        let started = Instant::now();
        for point in points {
            black_box(end(&instance, &names, point, Some(stop))?);
        }
        let by_one_step = started.elapsed();
        let started = Instant::now();
        for point in points {
            black_box(source.run(point)?);
        }
        let times = [by_steps, by_one_step, started.elapsed()].map(|time| time.as_secs_f64() / points.len() as f64);
        println!("{},{},{}", times[0], times[1], times[2]);
    }
    Ok(results.flush()?)
}

/// The outputs at the end of a run in steps of the given size, else of the FMU's own.
fn end(
    instance: &FmuInstance,
    names: &[&str],
    point: &[f64],
    step: Option<f64>,
) -> metafmu::Result<Vec<(String, f64)>> {
    instance.reset()?;
    let start_values = names.iter().zip(point).map(|(&name, &value)| (name.to_owned(), value)).collect();
    let mut table = simulate(instance, &SimulationOptions { start_values, step, ..SimulationOptions::default() })?;
    let row = table.rows.pop().expect("a run has a first row");
    Ok(table.columns.into_iter().map(|column| column.name).zip(row).collect())
}
