//! `metafmu simulate`: runs an FMU and writes its outputs.

use super::{Outcome, print};
use crate::cli::{InterfaceArg, SimulateArgs};
use metafmu::{
    Error, Result, files,
    fmu::host::{Fmu, Inputs, InterfaceKind, SimulationOptions, Table, simulate},
    report::{Curve, time_series_svg},
    table::header_field,
};
use std::{fmt::Write, path::Path};

pub fn run(args: &SimulateArgs) -> Result<Outcome> {
    let fmu = match args.interface {
        None => Fmu::open(&args.fmu)?,
        Some(InterfaceArg::Cs) => Fmu::open_for(&args.fmu, InterfaceKind::CoSimulation)?,
        Some(InterfaceArg::Me) => Fmu::open_for(&args.fmu, InterfaceKind::ModelExchange)?,
    };
    let options = SimulationOptions {
        start: args.start_time,
        stop: args.stop_time,
        step: args.step_size,
        tolerance: args.tolerance,
        start_values: args.start.clone(),
        inputs: args.input.as_deref().map(Inputs::read_csv).transpose()?.unwrap_or_default(),
        record: Vec::new(),
        record_only: false,
    };
    let table = simulate(&fmu.instantiate("metafmu", false)?, &options)?;
    match (&args.output, &args.plot) {
        (Some(path), _) => files::write_whole(path, csv(&table).as_bytes())?,
        (None, None) => print(&csv(&table))?,
        (None, Some(_)) => {}
    }
    if let Some(path) = &args.plot {
        plot(path, &fmu.description().model_name, &table)?;
    }
    Ok(Outcome::Fine)
}

/// `time` and the recorded variables; numbers are the shortest decimals that read back as the same doubles.
fn csv(table: &Table) -> String {
    let names: Vec<String> = table.columns.iter().map(|column| header_field(&column.name)).collect();
    let mut text = format!("time,{}\n", names.join(","));
    for (time, row) in table.times.iter().zip(&table.rows) {
        let _ = write!(text, "{time:?}");
        for value in row {
            let _ = write!(text, ",{value:?}");
        }
        text.push('\n');
    }
    text
}

fn plot(path: &Path, title: &str, table: &Table) -> Result<()> {
    let curve = |(index, column): (usize, &metafmu::fmu::host::Column)| Curve {
        name: column.name.clone(),
        unit: column.unit.clone().unwrap_or_default(),
        values: table.rows.iter().map(|row| row[index]).collect(),
    };
    let curves: Vec<Curve> = table.columns.iter().enumerate().map(curve).collect();
    let svg = time_series_svg(title, &table.times, &curves)
        .map_err(|message| Error::Plot { path: path.to_owned(), message })?;
    files::write_whole(path, svg.as_bytes())
}
