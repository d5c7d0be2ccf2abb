//! A study of motions in a table.

use super::{
    StudyTarget, key, quoted,
    table::{ColumnProfile, Survey, named_inputs, shortest, survey},
};
use crate::{cli::NewArgs, commands::say};
use metafmu::{
    Result,
    dynamics::trajectory::{differences, disagreement},
    table::Table,
};
use std::{fmt::Write, path::Path};

/// Largest root mean square difference between a rate and the differences of its coordinate, relative to the rate's
/// values.
const RATE: f64 = 0.05;

/// Share of every run from which equations are learned if there are few runs.
const LEARNED: f64 = 0.75;

/// Fewest runs with whole runs as tests.
const ENOUGH: usize = 10;

/// A study of all columns that change. Coordinates are those whose differences are another column; without such
/// columns, all of them are.
pub fn study(target: &StudyTarget, file: &Path, args: &NewArgs) -> Result<String> {
    let Survey { time, label, runs, columns } = survey(file, args)?;
    let numbers = || columns.iter().filter(|column| !column.is_text && column.min < column.max);
    let driving = named_inputs(&Table::open(file)?, args)?;
    let (named, others): (Vec<&ColumnProfile>, Vec<&ColumnProfile>) =
        numbers().partition(|column| driving.contains(&column.title));
    let (parameters, moving): (Vec<&ColumnProfile>, Vec<&ColumnProfile>) =
        others.into_iter().partition(|column| column.is_constant_in_runs);
    let label = label.as_deref();
    if moving.is_empty() {
        return Err(Table::open(file)?.mistake_in_header("no column changes in a run: there is no coordinate"));
    }
    let rates = rates(file, &time, &moving, runs.step)?;
    let mut states: Vec<(&ColumnProfile, Option<&ColumnProfile>)> = Vec::new();
    let (mut inputs, mut wrong) = (Vec::new(), Vec::new());
    for Chain { first, rate, accelerations } in chains(&rates) {
        let column = moving[first];
        match &rates[first] {
            Some(_) if rate.is_none() => states.push((column, None)),
            Some(Rate { column: rate, error: None }) => states.push((column, Some(moving[*rate]))),
            Some(Rate { column: rate, error: Some(error) }) => {
                states.push((column, None));
                let message = format!(
                    "differs from the derivative of `{}` by {error:.1e} of its root mean square: rates come from differences",
                    column.title
                );
                say(format_args!("column `{}`: {message}", moving[*rate].title));
                wrong.push((moving[*rate], message));
            }
            None => inputs.push(column),
        }
        for acceleration in accelerations {
            let title = &moving[acceleration].title;
            say(format_args!("column `{title}`: is an acceleration, which follows from the equations: left out"));
        }
    }
    if states.is_empty() {
        states = inputs.drain(..).map(|column| (column, None)).collect();
        say(format_args!(
            "no column is the rate of another one: all that change are taken for coordinates, and rates come from differences"
        ));
    }
    for ColumnProfile { title, .. } in &inputs {
        say(format_args!("column `{title}`: is no rate and has none: taken for an input"));
    }
    inputs.extend(named);
    let shown = || states.iter().flat_map(|(column, rate)| [Some(*column), *rate]).flatten();
    let renamed = shown().chain(inputs.iter().copied()).chain(parameters.iter().copied());
    let renamed = renamed
        .filter(|column| column.name != column.title)
        .map(|column| (column.name.as_str(), column.title.as_str()));
    let own = [("time", Some(time.as_str())), ("run", label)];
    let own = own.into_iter().filter_map(|(name, title)| Some((name, title.filter(|title| *title != name)?)));
    let names: Vec<String> =
        own.chain(renamed).map(|(name, title)| format!("{} = {}", key(name), quoted(title))).collect();
    let names = if names.is_empty() {
        String::new()
    } else {
        format!("columns = {{ {} }}    # names in the table\n", names.join(", "))
    };
    let (stop, step) = (runs.step * (runs.stop / runs.step).round().max(1.0), runs.step);
    let stop = shortest(stop);
    let (name, file) = (target.name, target.path_from(file));
    let mut text = format!(
        "# Made by `metafmu new {name} --table {file} --structure dynamics`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
seed = 1                    # everything random follows from it
structure = \"dynamics\"      # the FMU has states, and inputs drive it

[source]
table = {}    # {} runs, whose rows are equally far apart in time; relative to this file
{names}
[time]                      # runs begin at 0 and are cut off at `stop`, where the shortest ends
stop = {stop:?}                  # s
step = {:?}                 # s

[states]                    # coordinates; `rate` is the column of the derivative, which is found by differences otherwise;
                            # `periodic = true`: an angle in rad, the equations are the same a turn later
",
        quoted(&file),
        runs.count,
        step,
    );
    // writing to a string does not fail
    for (column, rate) in &states {
        let periodic = (column.unit == "rad").then(|| "periodic = true".to_owned());
        let rate = rate.map(|rate| format!("rate = {}", quoted(&rate.name)));
        let options: Vec<String> = periodic.into_iter().chain(rate).collect();
        let hint =
            if column.unit.is_empty() { "    # without a unit: tried as an angle and as another quantity" } else { "" };
        let _ = writeln!(text, "{} = {{ {} }}{hint}", key(&column.name), options.join(", "));
    }
    for (column, message) in &wrong {
        let _ = writeln!(text, "# {}: {message}", column.title.replace(char::is_control, " "));
    }
    for (title, columns) in [("inputs", &inputs), ("parameters", &parameters)] {
        if !columns.is_empty() {
            let _ = writeln!(text, "\n[{title}]");
        }
        for ColumnProfile { name, min, max, .. } in columns {
            let _ = writeln!(text, "{} = {{ min = {min:?}, max = {max:?} }}", key(name));
        }
    }
    text += "\n[outputs]                   # coordinates and rates\n";
    for column in shown() {
        let _ = writeln!(text, "{} = {{}}", key(&column.name));
    }
    text += "\n[sampling]\n";
    let _ = match runs.count {
        ENOUGH.. => {
            writeln!(text, "test_runs = {}               # chosen at random, never part of training", runs.count / 5)
        }
        _ => writeln!(
            text,
            "train_stop = {:?}           # s; all runs are tests as a whole, and rows after it are seen there only",
            LEARNED * stop
        ),
    };
    Ok(text)
}

/// The column of a derivative, and its error if differences are better.
struct Rate {
    column: usize,
    error: Option<f64>,
}

/// A column, its rate if it has one, and what is the derivative of that.
struct Chain {
    first: usize,
    /// None as well if it is the rate of another column, too.
    rate: Option<usize>,
    accelerations: Vec<usize>,
}

/// Divides columns, the rates of some of which are others, so that each is in one chain.
fn chains(rates: &[Option<Rate>]) -> Vec<Chain> {
    let rate_of: Vec<Option<usize>> = rates.iter().map(|rate| rate.as_ref().map(|rate| rate.column)).collect();
    let mut is_free = vec![true; rates.len()];
    let mut chains = Vec::new();
    let (of_others, first): (Vec<usize>, Vec<usize>) =
        (0..rates.len()).partition(|column| rate_of.contains(&Some(*column)));
    // a sine is its own fourth derivative: chains may have no beginning
    for first in first.into_iter().chain(of_others) {
        if !std::mem::replace(&mut is_free[first], false) {
            continue;
        }
        let mut followers = Vec::new();
        let mut next = rate_of[first];
        while let Some(column) = next.filter(|column| std::mem::replace(&mut is_free[*column], false)) {
            followers.push(column);
            next = rate_of[column];
        }
        chains.push(Chain {
            first,
            rate: followers.first().copied(),
            accelerations: followers.into_iter().skip(1).collect(),
        });
    }
    chains.sort_by_key(|chain| chain.first);
    chains
}

/// Column of the derivative of each column, by the differences in the first run.
fn rates(file: &Path, time: &str, columns: &[&ColumnProfile], step: f64) -> Result<Vec<Option<Rate>>> {
    let mut table = Table::open(file)?;
    let positions: Vec<usize> = columns.iter().map(|column| table.column(&column.title)).collect::<Result<_>>()?;
    let time = table.column(time)?;
    let (mut values, mut rows, mut last): (Vec<f64>, usize, f64) = (Vec::new(), 0, f64::NEG_INFINITY);
    while rows < ROWS && table.next_row()? {
        let now = table.number(time)?;
        if now <= last {
            break;
        }
        last = now;
        for position in &positions {
            values.push(table.number(*position)?);
        }
        rows += 1;
    }
    let n = columns.len();
    let size = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>().sqrt();
    let of = |column: usize| {
        let found = differences(&values, n, column, step);
        let error = |other: &usize| {
            let given = || values.iter().skip(*other).step_by(n).copied();
            size(&mut given().zip(&found).map(|(given, found)| given - found)) / size(&mut given())
        };
        let best = (0..n).filter(|other| *other != column).min_by(|a, b| error(a).total_cmp(&error(b)));
        best.filter(|other| error(other) < RATE).map(|other| {
            let of = |column: usize| values.iter().skip(column).step_by(n).copied().collect::<Vec<f64>>();
            let error = disagreement(&of(column), &of(other), step).map(|[error, _]| error);
            Rate { column: other, error }
        })
    };
    Ok((0..n).map(of).collect())
}

/// Number of rows that are checked.
const ROWS: usize = 1000;
