//! A study of a table of recorded runs, from its columns and what is in them.

use super::{key, quoted, rest};
use metafmu::{Result, table::Table};
use std::{collections::HashSet, fmt::Write, path::Path};

/// What is known of a column.
struct Column {
    /// Name in the table.
    title: String,
    /// Name in the study.
    name: String,
    unit: String,
    min: f64,
    max: f64,
    /// Value in the current run's first row.
    first: f64,
    /// Whether it has one value in every run.
    is_constant_in_runs: bool,
}

/// Runs as they pass by.
#[derive(Default)]
struct Runs {
    count: usize,
    label: String,
    last_time: f64,
    /// End of the shortest run, and the first step of the first run.
    stop: f64,
    step: f64,
}

pub fn study(name: &str, file: &Path) -> Result<String> {
    let mut table = Table::open(file)?;
    let titles: Vec<String> = table.columns().iter().map(|column| column.name.clone()).collect();
    let find = |names: &[&str]| titles.iter().position(|title| names.contains(&title.to_lowercase().as_str()));
    let Some(time) = find(&["time", "t"]) else {
        return Err(
            table.mistake_in_header(&format!("no column `time` or `t`, expected it among {}", titles.join(", ")))
        );
    };
    let label = find(&["run"]);
    let positions: Vec<usize> = (0..titles.len()).filter(|&index| index != time && Some(index) != label).collect();
    let mut columns = named(&table, &positions);
    let runs = read(&mut table, time, label, &positions, &mut columns)?;
    let (parameters, outputs): (Vec<&Column>, Vec<&Column>) =
        columns.iter().partition(|column| column.is_constant_in_runs);
    let (varied, fixed): (Vec<&Column>, Vec<&Column>) =
        parameters.into_iter().partition(|column| column.min < column.max);
    let problem = match (varied.is_empty(), outputs.is_empty()) {
        (true, _) => "no column has one value in each run and others in other runs: there is no parameter",
        (_, true) => "no column changes in a run: there is no output",
        _ => "",
    };
    if !problem.is_empty() {
        return Err(table.mistake_in_header(problem));
    }
    Ok(text(name, file, (&titles[time], label.map(|label| &titles[label])), &runs, &varied, &fixed, &outputs))
}

/// The columns under names that every host takes.
fn named(table: &Table, positions: &[usize]) -> Vec<Column> {
    let mut taken: HashSet<String> = ["run", "time", "file"].map(str::to_owned).into();
    let column = |&position: &usize| {
        let column = &table.columns()[position];
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let mut name: String = column.name.chars().map(plain).collect();
        if !name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
            name.insert(0, '_');
        }
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        Column {
            title: column.name.clone(),
            name,
            unit: column.unit().unwrap_or_default().to_owned(),
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            first: f64::NAN,
            is_constant_in_runs: true,
        }
    };
    positions.iter().map(column).collect()
}

/// A new label begins a run; without labels a time that does not come after the one before does.
fn read(
    table: &mut Table,
    time: usize,
    label: Option<usize>,
    positions: &[usize],
    columns: &mut [Column],
) -> Result<Runs> {
    let mut runs = Runs { stop: f64::INFINITY, ..Runs::default() };
    while table.next_row()? {
        let now = table.number(time)?;
        let name = match label {
            Some(label) => table.text(label)?.into_owned(),
            None => String::new(),
        };
        let begins = runs.count == 0 || label.map_or(now <= runs.last_time, |_| name != runs.label);
        if begins && runs.count > 0 {
            runs.stop = runs.stop.min(runs.last_time);
        }
        if !begins && runs.step == 0.0 {
            runs.step = now - runs.last_time;
        }
        for (column, &position) in columns.iter_mut().zip(positions) {
            let value = table.number(position)?;
            (column.min, column.max) = (column.min.min(value), column.max.max(value));
            if begins {
                column.first = value;
            } else if value != column.first {
                column.is_constant_in_runs = false;
            }
        }
        (runs.count, runs.label, runs.last_time) = (runs.count + usize::from(begins), name, now);
    }
    runs.stop = runs.stop.min(runs.last_time);
    let expected = "expected runs that begin at 0 s and have more than one row";
    if !(runs.stop > 0.0 && runs.step > 0.0) {
        return Err(table.mistake(&format!("{} runs, the shortest ends at {} s: {expected}", runs.count, runs.stop)));
    }
    Ok(runs)
}

fn text(
    name: &str,
    file: &Path,
    (time, label): (&str, Option<&String>),
    runs: &Runs,
    varied: &[&Column],
    fixed: &[&Column],
    outputs: &[&Column],
) -> String {
    let file = file.display().to_string();
    let renamed = varied.iter().chain(outputs).filter(|column| column.name != column.title);
    let renamed = renamed.map(|column| (column.name.as_str(), column.title.as_str()));
    let own = [("time", Some(time)), ("run", label.map(String::as_str))];
    let own = own.into_iter().filter_map(|(name, title)| Some((name, title.filter(|title| *title != name)?)));
    let names: Vec<String> =
        own.chain(renamed).map(|(name, title)| format!("{} = {}", key(name), quoted(title))).collect();
    let columns = if names.is_empty() {
        String::new()
    } else {
        format!("columns = {{ {} }}    # names in the table\n", names.join(", "))
    };
    let step = runs.stop / (runs.stop / runs.step).round().max(1.0);
    let mut text = format!(
        "# Made by `metafmu new {name} --table {file}`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
seed = 1                    # everything random follows from it

[source]
table = {}    # {} runs; relative to this file
{columns}
[time]                      # runs begin at 0 and are cut off at `stop`, where the shortest ends
stop = {:?}                  # s
step = {step:?}                 # s; what the FMU suggests: the rows are where the table has them

[parameters]                # inputs of the surrogate, beside the time: columns with one value in each run
",
        quoted(&file),
        runs.count,
        runs.stop,
    );
    let unit = |unit: &str| if unit.is_empty() { String::new() } else { format!("unit = {}", quoted(unit)) };
    for Column { name, min, max, unit: of, .. } in varied.iter().copied() {
        let unit = if of.is_empty() { String::new() } else { format!(", {}", unit(of)) };
        // writing to a string does not fail
        let _ = writeln!(text, "{} = {{ min = {min:?}, max = {max:?}{unit} }}", key(name));
    }
    for Column { title, min, .. } in fixed {
        let _ = writeln!(text, "# {title} is always {min}");
    }
    text += "\n[outputs]\n";
    for Column { name, unit: of, .. } in outputs.iter().copied() {
        let unit = unit(of);
        let _ = writeln!(text, "{} = {{{}}}", key(name), if unit.is_empty() { unit } else { format!(" {unit} ") });
    }
    let test_runs = (runs.count / 10).max(1);
    let _ = write!(
        text,
        "\n[sampling]\ntest_runs = {test_runs}              # chosen at random, never part of training\n\n"
    );
    text + rest()
}
