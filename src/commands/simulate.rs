//! `metafmu simulate`: runs an FMU and writes its outputs.

use super::{CommandOutcome, heard, messages::say_stream, say, stdout::write_result, terminal::workers, warn};
use crate::cli::{InterfaceArg, SimulateArgs};
use metafmu::{
    Error, Result,
    diagnostics::Place,
    export::{added_variables, find_surrogate, is_own},
    files,
    fmi::{
        ModelDescription, Watch,
        host::{Inputs, InterfaceKind, RecordedColumn, RowSink, SimulationOptions, SimulationTable, Unpacked},
        model_description::Causality,
        simulate_apart,
    },
    pipeline::measured,
    report::{Curve, time_series_svg},
    table::{Table, header_field},
    variable::{DefaultValue, MatchedVariables},
};
use metafmu_runtime::{BuiltIn, Output, TOLERANCE};
use std::{io::Write, path::Path, sync::atomic::AtomicBool};

pub fn run(args: &SimulateArgs) -> Result<CommandOutcome> {
    [&args.output, &args.plot].into_iter().flatten().try_for_each(|path| files::check_output(path))?;
    expect_one_value_each(&args.start)?;
    let wanted = args.interface.map(|interface| match interface {
        InterfaceArg::Cs => InterfaceKind::CoSimulation,
        InterfaceArg::Me => InterfaceKind::ModelExchange,
    });
    let watch = Watch { workers: workers()?, limit: args.time_limit, heard };
    let unpacked = Unpacked::open(&args.fmu, wanted, watch.patience())?;
    let InputSignals { inputs, first, constants } = match &args.input {
        Some(path) => {
            say_stream(path);
            read_inputs(args, unpacked.description(), path, watch.workers.stop)?
        }
        None => InputSignals::default(),
    };
    let options = SimulationOptions {
        start: args.start_time.or(first),
        stop: args.stop_time,
        step: args.step_size,
        tolerance: args.tolerance,
        states: None,
        start_values: constants.into_iter().chain(args.start.clone()).collect(),
        inputs,
        inputs_first: false,
        record: added_variables(unpacked.description()),
        record_only: false,
    };
    let mut table = args.plot.as_ref().map(|_| SimulationTable::default());
    let (mut domain, mut held) = (DomainWarning::default(), HeldInputs::default());
    let path = args.output.as_deref().unwrap_or(Path::new("stdout"));
    let mut simulate = |csv: Option<&mut dyn Write>| {
        let mut rows = RowOutput { csv, path, table: table.as_mut(), domain: &mut domain, held: &mut held };
        simulate_apart(&unpacked, &options, watch, &mut rows)
    };
    match (&args.output, &args.plot) {
        (None, Some(_)) => drop(simulate(None)?),
        _ => drop(write_result(args.output.as_deref(), |csv| simulate(Some(csv)))?),
    }
    domain.warn();
    held.warn(&options.inputs);
    if let (Some(path), Some(table)) = (&args.plot, &table) {
        plot(path, &unpacked.description().model_name, table)?;
    }
    Ok(CommandOutcome::Fine)
}

fn expect_one_value_each(starts: &[(String, f64)]) -> Result<()> {
    for (position, (name, value)) in starts.iter().enumerate() {
        if starts[..position].iter().any(|(earlier, other)| earlier == name && other != value) {
            return Err(Error::Variable { name: name.clone(), problem: "has two start values".into() });
        }
    }
    Ok(())
}

/// Signals of a table.
#[derive(Default)]
struct InputSignals {
    inputs: Inputs,
    /// Time of the first row if it has measured outputs, which an FMU of a discrete-time surrogate takes.
    first: Option<f64>,
    /// Values of inputs without a column.
    constants: Vec<(String, f64)>,
}

fn read_inputs(
    args: &SimulateArgs,
    description: &ModelDescription,
    path: &Path,
    stop: &AtomicBool,
) -> Result<InputSignals> {
    let takes_measured = description.variable(BuiltIn::UseMeasured.name()).is_some();
    // not of every FMU: some model files are large
    let may_be_discrete = is_own(description) && description.model_exchange.is_none();
    let surrogate = if may_be_discrete { find_surrogate(&args.fmu)? } else { None };
    let table = Table::open_stream(path, stop)?;
    let units = table.columns().iter().map(|column| description.unit_of(description.variable(&column.name)?));
    table.check_units(units.enumerate())?;
    let (inputs, first) = match &surrogate {
        Some(surrogate) => measured::read_inputs(surrogate, takes_measured, table, |line| say(line))?,
        None => (Inputs::read(table)?, None),
    };
    let outputs = surrogate.iter().flat_map(|surrogate| surrogate.outputs());
    let measured: Vec<String> = outputs.map(|output| Output::measured_name(&output.name)).collect();
    let is_switch = |name: &str| surrogate.is_some() && name == BuiltIn::UseMeasured.name();
    let is_optional = |name: &str| is_switch(name) || measured.iter().any(|known| known == name);
    let start = |(name, value): &(String, f64)| DefaultValue { name: name.clone(), value: Some(*value) };
    let is_input = |(name, _): &&(String, f64)| {
        description.variable(name).is_some_and(|variable| variable.causality == Causality::Input)
    };
    let starts = args.start.iter().filter(is_input).filter(|(name, _)| !is_optional(name)).map(start);
    let defaults: Vec<DefaultValue> = args.default.iter().cloned().chain(starts).collect();
    let (constants, MatchedVariables { notes, doubts, .. }) =
        inputs.complete(description, is_optional, &defaults).map_err(Error::table(path, Place::Line(1)))?;
    notes.iter().for_each(say);
    doubts.iter().for_each(warn);
    Ok(InputSignals { inputs, first, constants })
}

/// Output of the rows: numbers as the shortest decimals that read back as the same doubles.
struct RowOutput<'a, 'b> {
    csv: Option<&'a mut dyn Write>,
    path: &'b Path,
    /// Rows for the plot.
    table: Option<&'b mut SimulationTable>,
    domain: &'b mut DomainWarning,
    held: &'b mut HeldInputs,
}

impl RowSink for RowOutput<'_, '_> {
    fn begin(&mut self, columns: &[RecordedColumn]) -> Result<()> {
        self.domain.column = columns.iter().position(|column| column.name == BuiltIn::InDomain.name());
        if let Some(table) = &mut self.table {
            table.begin(columns)?;
        }
        let Some(csv) = &mut self.csv else { return Ok(()) };
        let names: Vec<String> = columns.iter().map(|column| header_field(&column.name)).collect();
        writeln!(csv, "time,{}", names.join(",")).map_err(Error::io(self.path, "write"))
    }

    fn row(&mut self, time: f64, values: &[f64]) -> Result<()> {
        self.domain.look(time, values);
        self.held.look(time);
        if let Some(table) = &mut self.table {
            table.row(time, values)?;
        }
        let Some(csv) = &mut self.csv else { return Ok(()) };
        let mut write = || {
            write!(csv, "{time:?}")?;
            values.iter().try_for_each(|value| write!(csv, ",{value:?}"))?;
            writeln!(csv)
        };
        write().map_err(Error::io(self.path, "write"))
    }
}

/// A warning about the FMU's domain of validity, which would be overlooked in a long table.
#[derive(Default)]
struct DomainWarning {
    column: Option<usize>,
    rows: usize,
    outside: usize,
    /// The first time outside.
    first: f64,
}

impl DomainWarning {
    fn look(&mut self, time: f64, values: &[f64]) {
        self.rows += 1;
        if self.column.is_some_and(|column| values[column] == 0.0) {
            if self.outside == 0 {
                self.first = time;
            }
            self.outside += 1;
        }
    }

    fn warn(&self) {
        let Self { rows, outside, first, .. } = self;
        if *outside > 0 {
            warn(format_args!(
                "outside the ranges that the FMU is made for in {outside} of {rows} rows, at {first} s for the first \
                 time (`{}` is false): its outputs there cannot be trusted",
                BuiltIn::InDomain.name()
            ));
        }
    }
}

/// A warning about a run that is longer than its table of inputs.
#[derive(Default)]
struct HeldInputs {
    /// First and last time of the run.
    run: Option<[f64; 2]>,
}

impl HeldInputs {
    fn look(&mut self, time: f64) {
        self.run = Some([self.run.map_or(time, |[first, _]| first), time]);
    }

    fn warn(&self, inputs: &Inputs) {
        // a single row means constant inputs
        let ([first, .., last], Some([start, stop])) = (inputs.times.as_slice(), self.run) else { return };
        let rounding = TOLERANCE * (stop - start);
        if start < first - rounding || stop > last + rounding {
            warn(format_args!(
                "the run is from {start} to {stop} s, and the table of inputs from {first} to {last} s: beyond its ends \
                 inputs keep the values of its first and last row"
            ));
        }
    }
}

/// Plots the variables that change during the run, or all of them if none does.
fn plot(path: &Path, title: &str, table: &SimulationTable) -> Result<()> {
    let curve = |(index, column): (usize, &RecordedColumn)| Curve {
        name: column.name.clone(),
        unit: column.unit.clone().unwrap_or_default(),
        values: table.rows.iter().map(|row| row[index]).collect(),
    };
    let curves: Vec<Curve> = table.columns.iter().enumerate().map(curve).collect();
    let changes = |curve: &Curve| curve.values.iter().any(|value| *value != curve.values[0]);
    let (changing, constant): (Vec<Curve>, Vec<Curve>) = curves.into_iter().partition(changes);
    let curves = if changing.is_empty() { &constant } else { &changing };
    let svg = time_series_svg(title, &table.times, curves).map_err(Error::plot(path))?;
    files::write_output(path, |file| file.write_all(svg.as_bytes()))?;
    if !changing.is_empty() && !constant.is_empty() {
        let values: Vec<String> =
            constant.iter().map(|curve| format!("{} = {:?}", curve.name, curve.values[0])).collect();
        say(format_args!("constant in this run and not plotted: {}", values.join(", ")));
    }
    Ok(())
}
