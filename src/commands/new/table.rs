//! A study of a table of recorded runs, from its columns and their content.

use super::{DISCRETE, StudyTarget, key, quoted, rest};
use crate::{cli::NewArgs, commands::say};
use metafmu::{
    Error, Result,
    diagnostics::numbers::counted,
    source::recorded::at_gap,
    table::{Table, is_text, stamps},
};
use metafmu_runtime::BuiltIn;
use std::{collections::HashSet, fmt::Write, path::Path};

/// Lowercase names of columns that are the time.
const TIMES: [&str; 12] = [
    "time",
    "zeit",
    "time_s",
    "zeit_s",
    "sim_time",
    "simtime",
    "simulation time",
    "temps",
    "tiempo",
    "tempo",
    "t_s",
    "t",
];

/// Lowercase beginnings of names of columns that drive a component; a single letter is the whole name.
const INPUTS: [&str; 14] = [
    "u", "f", "input", "force", "torque", "moment", "voltage", "current", "drive", "command", "setpoint", "effort",
    "kraft", "eingang",
];

/// Fewest runs whose numbers count them: with fewer, 0, 1 or 1, 2 may have another reason.
const COUNTED: usize = 3;

/// Profile of a column.
pub(super) struct ColumnProfile {
    /// Name in the table.
    pub(super) title: String,
    /// Name in the study.
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) min: f64,
    pub(super) max: f64,
    /// Value in the current run's first row.
    first: f64,
    /// Value in the first row.
    start: f64,
    /// `true` if it has one value in every run.
    pub(super) is_constant_in_runs: bool,
    /// `true` if its values in the runs are 0, 1, 2, ... or 1, 2, 3, ...
    counts_runs: bool,
    /// `true` if it does not begin with a number.
    pub(super) is_text: bool,
}

/// Profile of the runs of a table.
#[derive(Default)]
pub(super) struct RunsProfile {
    pub(super) count: usize,
    label: String,
    last_time: f64,
    /// End of the shortest run, and the time between two rows of the first run.
    pub(super) stop: f64,
    pub(super) step: f64,
    /// Times of the first run's rows.
    times: Vec<f64>,
}

/// Content of a table, with the names of its time and of its label of runs.
pub(super) struct Survey {
    pub(super) time: String,
    pub(super) label: Option<String>,
    pub(super) runs: RunsProfile,
    pub(super) columns: Vec<ColumnProfile>,
}

/// Roles of the columns.
struct Roles<'a> {
    time: &'a str,
    label: Option<&'a str>,
    varied: Vec<&'a ColumnProfile>,
    /// Inputs, for the structure "discrete".
    inputs: Vec<&'a ColumnProfile>,
    outputs: Vec<&'a ColumnProfile>,
    /// Columns without a role, and the reasons.
    others: Vec<(&'a ColumnProfile, String)>,
}

pub fn study(target: &StudyTarget, file: &Path, args: &NewArgs) -> Result<String> {
    let Survey { time, label, runs, columns } = survey(file, args)?;
    let mut roles = roles(&time, label.as_deref(), &runs, &columns);
    let is_discrete = args.structure.unwrap_or_default().runs().are_samples;
    if is_discrete {
        find_inputs(file, args, &mut roles)?;
    }
    let problem = match (roles.varied.is_empty() && !is_discrete, roles.outputs.is_empty()) {
        (true, _) => {
            "no column has one value in each run and others in other runs: there is no parameter; of columns that drive the others say \
             --structure discrete --inputs COLUMNS, of a table without a time --structure static"
        }
        (_, true) => "no column changes in a run: there is no output",
        _ => "",
    };
    if !problem.is_empty() {
        return Err(Table::open(file)?.mistake_in_header(problem));
    }
    for (ColumnProfile { title, .. }, why) in roles.others.iter().filter(|(column, _)| column.min < column.max) {
        say(format_args!("column `{title}`: {why}"));
    }
    Ok(text(target, file, &runs, &roles))
}

/// Reads a table.
pub(super) fn survey(file: &Path, args: &NewArgs) -> Result<Survey> {
    let mut table = Table::open(file)?;
    let time = time_column(&table, args.time.as_deref())?;
    let label = match &args.run {
        Some(run) => Some(given(&table, run)?),
        None => table.columns().iter().position(|column| column.name.to_lowercase() == "run"),
    };
    let titles: Vec<String> = table.columns().iter().map(|column| column.name.clone()).collect();
    let positions: Vec<usize> = (0..titles.len()).filter(|&index| index != time && Some(index) != label).collect();
    let mut columns = named(&table, &positions);
    let advised: fn(Error) -> Error =
        if args.structure.unwrap_or_default().runs().are_samples { at_gap } else { |error| error };
    let runs = read(&mut table, (time, label), &positions, &mut columns, advised)?;
    let label = label.map(|label| titles[label].clone());
    Ok(Survey { time: titles[time].clone(), label, runs, columns })
}

/// Names in the table of the columns that the arguments name as inputs.
pub(super) fn named_inputs(table: &Table, args: &NewArgs) -> Result<Vec<String>> {
    let columns = given_all(table, &args.inputs)?.into_iter();
    Ok(columns.map(|column| table.columns()[column].name.clone()).collect())
}

/// Finds the inputs among the columns that change in a run.
fn find_inputs(file: &Path, args: &NewArgs, roles: &mut Roles) -> Result<()> {
    let table = Table::open(file)?;
    let wanted = named_inputs(&table, args)?;
    let is_wanted = |column: &&ColumnProfile| match wanted.is_empty() {
        true => drives(&column.title),
        false => wanted.contains(&column.title),
    };
    (roles.inputs, roles.outputs) = std::mem::take(&mut roles.outputs).into_iter().partition(is_wanted);
    if roles.inputs.is_empty() {
        let changing: Vec<&str> = roles.outputs.iter().map(|column| column.title.as_str()).collect();
        let expected = format!("say which they are with --inputs COLUMNS ({})", changing.join(", "));
        return Err(table.mistake_in_header(&format!("no column is known to drive the runs: {expected}")));
    }
    Ok(())
}

/// Returns true if a column of this name is an input.
fn drives(title: &str) -> bool {
    let title = title.to_lowercase();
    let begins = |name: &&str| match name.len() {
        // also u1, u_2
        1 => title.strip_prefix(*name).is_some_and(|rest| rest.chars().all(|c| c.is_ascii_digit() || c == '_')),
        _ => title.starts_with(*name),
    };
    INPUTS.iter().any(begins)
}

/// Positions of columns by their names, with their units or without.
pub(super) fn given_all<T: AsRef<str>>(table: &Table, names: &[T]) -> Result<Vec<usize>> {
    let is_there = |name: &str| table.columns().iter().any(|column| column.name == name);
    let known = |name: &T| {
        let name = name.as_ref();
        let bare = name.split(['[', '(']).next().unwrap_or_default().trim();
        if !is_there(name) && is_there(bare) { bare.to_owned() } else { name.to_owned() }
    };
    table.columns_of(&names.iter().map(known).collect::<Vec<String>>())
}

/// Position of a column by its name, with its unit or without.
fn given(table: &Table, name: &str) -> Result<usize> {
    given_all(table, &[name]).map(|columns| columns[0])
}

/// Position of the column that is the time by its name.
pub(super) fn known_time(table: &Table) -> Option<usize> {
    // `T` is a temperature more often than the time
    let is = |known: &str, title: &str| if known == "t" { title == "t" } else { title.to_lowercase() == known };
    let known = |known: &&str| table.columns().iter().position(|column| is(known, &column.name));
    TIMES.iter().find_map(known)
}

fn time_column(table: &Table, name: Option<&str>) -> Result<usize> {
    let position = match name {
        Some(name) => given(table, name)?,
        None => known_time(table).ok_or_else(|| {
            let titles: Vec<&str> = table.columns().iter().take(20).map(|column| column.name.as_str()).collect();
            let expected = "expected it to be called `time`, `t` or `Zeit`; say which it is with --time COLUMN, or that rows have none with \
                            --structure static";
            table.mistake_in_header(&format!("none of the columns is the time ({}), {expected}", titles.join(", ")))
        })?,
    };
    table.check_unit(position, Some("s"))?;
    Ok(position)
}

/// Columns by their names in the table, their unique names in a study, and their units.
pub(super) fn columns_of(table: &Table, positions: &[usize]) -> Vec<(String, String, String)> {
    let reserved = BuiltIn::ALWAYS.iter().map(|variable| variable.name()).chain(["run", "time", "file"]);
    let mut taken: HashSet<String> = reserved.map(str::to_owned).collect();
    let column = |&position: &usize| {
        let column = &table.columns()[position];
        let mut name = column.name.replace(char::is_control, " ").trim().to_owned();
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        (column.name.clone(), name, column.unit().unwrap_or_default().to_owned())
    };
    positions.iter().map(column).collect()
}

fn named(table: &Table, positions: &[usize]) -> Vec<ColumnProfile> {
    let profile = |(title, name, unit)| ColumnProfile {
        title,
        name,
        unit,
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
        first: f64::NAN,
        start: f64::NAN,
        is_constant_in_runs: true,
        counts_runs: true,
        is_text: false,
    };
    columns_of(table, positions).into_iter().map(profile).collect()
}

/// A new label begins a run; without labels, a time that is not later than the one before does.
fn read(
    table: &mut Table,
    (time, label): (usize, Option<usize>),
    positions: &[usize],
    columns: &mut [ColumnProfile],
    advised: fn(Error) -> Error,
) -> Result<RunsProfile> {
    let mut runs = RunsProfile { stop: f64::INFINITY, ..RunsProfile::default() };
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
        if runs.count + usize::from(begins) == 1 {
            runs.times.push(now);
        }
        for (column, &position) in columns.iter_mut().zip(positions) {
            column.see(table, position, begins, runs.count).map_err(advised)?;
        }
        (runs.count, runs.label, runs.last_time) = (runs.count + usize::from(begins), name, now);
    }
    runs.stop = runs.stop.min(runs.last_time);
    // unequally spaced rows keep their times
    let first = runs.times.get(1).map_or(0.0, |second| second - runs.times[0]);
    runs.step = stamps::period(&runs.times).unwrap_or_else(|| {
        let steps = (runs.stop / first).round().max(1.0);
        shortest(runs.stop / steps)
    });
    let expected =
        "expected runs that begin at 0 s and have more than one row, or of rows without a time --structure static";
    if !(runs.stop > 0.0 && runs.step > 0.0) {
        return Err(table.mistake(&format!(
            "{}, the shortest ends at {} s: {expected}",
            counted(runs.count, "run"),
            runs.stop
        )));
    }
    Ok(runs)
}

impl ColumnProfile {
    /// Takes a row; there were `count` runs before it.
    fn see(&mut self, table: &mut Table, position: usize, begins: bool, count: usize) -> Result<()> {
        if begins && count == 0 {
            let text = table.text(position)?;
            self.is_text = is_text(&text);
        }
        if self.is_text {
            return Ok(());
        }
        let value = table.number(position)?;
        (self.min, self.max) = (self.min.min(value), self.max.max(value));
        if begins {
            self.counts_runs &= value == count as f64 + self.min && (self.min == 0.0 || self.min == 1.0);
            self.first = value;
            self.start = if count == 0 { value } else { self.start };
        } else if value != self.first {
            self.is_constant_in_runs = false;
        }
        Ok(())
    }
}

/// Columns with one value in each run are parameters, but for those that number the runs, unless there are no others.
fn roles<'a>(time: &'a str, mut label: Option<&'a str>, runs: &RunsProfile, columns: &'a [ColumnProfile]) -> Roles<'a> {
    let (texts, numbers): (Vec<&ColumnProfile>, Vec<&ColumnProfile>) =
        columns.iter().partition(|column| column.is_text);
    let (parameters, outputs): (Vec<&ColumnProfile>, Vec<&ColumnProfile>) =
        numbers.into_iter().partition(|column| column.is_constant_in_runs);
    let (mut varied, fixed): (Vec<&ColumnProfile>, Vec<&ColumnProfile>) =
        parameters.into_iter().partition(|column| column.min < column.max);
    let mut others: Vec<(&ColumnProfile, String)> = Vec::new();
    let counts = |column: &&ColumnProfile| column.counts_runs && runs.count >= COUNTED;
    if !varied.iter().all(counts) {
        for column in varied.extract_if(.., |column| counts(column)) {
            let why = match label {
                Some(_) => "numbers the runs and is not a parameter",
                None => "numbers the runs: taken as their label and not as a parameter",
            };
            label = label.or(Some(column.title.as_str()));
            others.push((column, why.into()));
        }
    }
    others.extend(fixed.into_iter().map(|column| (column, format!("is always {}", column.min))));
    others.extend(
        texts.into_iter().map(|column| (column, "is text and left out; --run if it tells the runs apart".into())),
    );
    Roles { time, label, varied, inputs: Vec::new(), outputs, others }
}

/// Number of runs into which a record of `rows` rows is cut: enough for training, validation and tests.
fn pieces(rows: f64) -> f64 {
    const FEWEST: f64 = 4.0;
    const MOST: f64 = 10.0;
    const LONG: f64 = 150.0;
    if rows < 10.0 * FEWEST { 1.0 } else { (rows / LONG).floor().clamp(FEWEST, MOST) }
}

/// The number with the fewest digits that equals this one except for rounding: 0.05 instead of 19.95 / 399.
pub(super) fn shortest(number: f64) -> f64 {
    let rounded = |digits: usize| format!("{number:.digits$e}").parse().unwrap_or(number);
    (0..16).map(rounded).find(|other: &f64| (other - number).abs() <= 1e-12 * number.abs()).unwrap_or(number)
}

fn text(target: &StudyTarget, file: &Path, runs: &RunsProfile, roles: &Roles) -> String {
    let Roles { time, label, varied, inputs, outputs, others } = roles;
    let (name, file) = (target.name, target.path_from(file));
    let renamed = varied.iter().chain(inputs).chain(outputs).filter(|column| column.name != column.title);
    let renamed = renamed.map(|column| (column.name.as_str(), column.title.as_str()));
    let own = [("time", Some(*time)), ("run", *label)];
    let own = own.into_iter().filter_map(|(name, title)| Some((name, title.filter(|title| *title != name)?)));
    let names: Vec<String> =
        own.chain(renamed).map(|(name, title)| format!("{} = {}", key(name), quoted(title))).collect();
    let columns = if names.is_empty() {
        String::new()
    } else {
        format!("columns = {{ {} }}    # names in the table\n", names.join(", "))
    };
    let is_discrete = !inputs.is_empty();
    let rows = (runs.stop / runs.step).round().max(1.0);
    let pieces = if is_discrete && runs.count == 1 { pieces(rows) } else { 1.0 };
    let (step, stop) = match is_discrete {
        true => (runs.step, shortest(runs.step * (rows / pieces).floor())),
        false => (shortest(runs.stop / rows), runs.stop),
    };
    let cut = match pieces {
        1.0 => "runs begin at 0 and are cut off at `stop`, where the shortest ends".into(),
        _ => format!("the run is cut into {pieces} of this length, each with the samples before it"),
    };
    let count = counted(runs.count, "run");
    // of a single run that is cut
    let run_count = runs.count.max(pieces as usize);
    let (structure, option) = match is_discrete {
        true => ("structure = \"discrete\"      # discrete-time, driven by the inputs\n", " --structure discrete"),
        false => ("", ""),
    };
    let steps = match is_discrete {
        true => "the sample time: rows are so far apart",
        false => "the step size that the FMU suggests to hosts; rows are where the table has them",
    };
    let mut text = format!(
        "# Made by `metafmu new {name} --table {file}{option}`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
{structure}seed = 1                    # everything random follows from it

[source]
table = {}    # {count}; relative to this file
{columns}
[time]                      # {cut}
stop = {stop:?}                  # s
step = {step:?}                 # s; {steps}
",
        quoted(&file),
    );
    let unit = |unit: &str| if unit.is_empty() { String::new() } else { format!("unit = {}", quoted(unit)) };
    if !varied.is_empty() {
        let beside = if is_discrete { "" } else { ", beside the time" };
        // writing to a string does not fail
        let _ = writeln!(
            text,
            "\n[parameters]                # inputs of the surrogate{beside}: columns with one value in each run"
        );
    }
    for ColumnProfile { name, min, max, unit: of, .. } in varied {
        let unit = if of.is_empty() { String::new() } else { format!(", {}", unit(of)) };
        // writing to a string does not fail
        let _ = writeln!(text, "{} = {{ min = {min:?}, max = {max:?}{unit} }}", key(name));
    }
    for (ColumnProfile { title, .. }, why) in others {
        let _ = writeln!(text, "# {} {why}", title.replace(char::is_control, " "));
    }
    let sections = [("inputs", inputs), ("outputs", outputs)];
    for (section, columns) in sections.into_iter().filter(|(_, columns)| !columns.is_empty()) {
        let _ = writeln!(text, "\n[{section}]");
        for ColumnProfile { name, unit: of, min, max, start, .. } in columns {
            // zero, the value before the start unless given, is far from such inputs
            let is_away = section == "inputs" && !(*min..=*max).contains(&0.0);
            let start = if is_away { format!("start = {start:?}") } else { String::new() };
            let options: Vec<String> = [unit(of), start].into_iter().filter(|option| !option.is_empty()).collect();
            let options = options.join(", ");
            let braced = if options.is_empty() { options } else { format!(" {options} ") };
            let _ = writeln!(text, "{} = {{{braced}}}", key(name));
        }
    }
    let test_runs = if pieces > 1.0 { run_count / 5 } else { run_count / 10 }.max(1);
    let _ = write!(
        text,
        "\n[sampling]\ntest_runs = {test_runs}              # chosen at random, never part of training\n\n"
    );
    if is_discrete {
        return text + DISCRETE;
    }
    text + &rest(run_count - test_runs.min(run_count), stop / step)
}

#[cfg(test)]
mod tests {
    use super::shortest;

    #[test]
    fn a_step_has_no_more_digits_than_it_needs() {
        assert_eq!([19.95 / 399.0, 0.3 / 3.0, 1e-3, 4.0].map(shortest), [0.05, 0.1, 1e-3, 4.0]);
        let third = 1.0 / 3.0;
        assert!((shortest(third) - third).abs() <= 1e-12 * third);
    }
}
