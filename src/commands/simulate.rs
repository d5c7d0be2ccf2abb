//! `metafmu simulate`: runs an FMU and writes its outputs.

use super::{Outcome, print, say};
use crate::cli::{InterfaceArg, SimulateArgs};
use metafmu::{
    Error, Result, files,
    fmu::host::{Fmu, Inputs, InterfaceKind, SimulationOptions, Table, simulate},
    report::{Curve, time_series_svg},
    table::header_field,
};
use metafmu_runtime::extra::IN_DOMAIN;
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
    warn_outside(&table);
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

/// What the FMU says about its domain of validity, which nobody looks for in a long table.
fn warn_outside(table: &Table) {
    let Some(column) = table.columns.iter().position(|column| column.name == IN_DOMAIN.name) else { return };
    let outside = || table.times.iter().zip(&table.rows).filter(|(_, row)| row[column] == 0.0);
    if let Some((first, _)) = outside().next() {
        say(format_args!(
            "warning: outside the ranges that the FMU is made for in {} of {} rows, at {first} s for the first time \
             (`{}` is false): its outputs there cannot be trusted",
            outside().count(),
            table.rows.len(),
            IN_DOMAIN.name
        ));
    }
}

/// Plots what changes during the run, or everything if nothing does.
fn plot(path: &Path, title: &str, table: &Table) -> Result<()> {
    let curve = |(index, column): (usize, &metafmu::fmu::host::Column)| Curve {
        name: column.name.clone(),
        unit: column.unit.clone().unwrap_or_default(),
        values: table.rows.iter().map(|row| row[index]).collect(),
    };
    let curves: Vec<Curve> = table.columns.iter().enumerate().map(curve).collect();
    let changes = |curve: &Curve| curve.values.iter().any(|value| *value != curve.values[0]);
    let (changing, constant): (Vec<Curve>, Vec<Curve>) = curves.into_iter().partition(changes);
    let curves = if changing.is_empty() { &constant } else { &changing };
    let svg = time_series_svg(title, &table.times, curves)
        .map_err(|message| Error::Plot { path: path.to_owned(), message })?;
    files::write_whole(path, svg.as_bytes())?;
    if !changing.is_empty() && !constant.is_empty() {
        let values: Vec<String> =
            constant.iter().map(|curve| format!("{} = {:?}", curve.name, curve.values[0])).collect();
        say(format_args!("constant in this run and not plotted: {}", values.join(", ")));
    }
    Ok(())
}
