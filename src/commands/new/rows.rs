//! A study of a table of rows without a time, from its columns and their content.

use super::{
    StudyTarget, key,
    located::in_source,
    quoted,
    table::{columns_of, given_all},
};
use crate::{
    cli::NewArgs,
    commands::{say, terminal::control},
};
use metafmu::{
    Result,
    source::StaticRows,
    table::{Table, has_commas, is_text, stamps},
};
use std::{fmt::Write, path::Path};

/// Lowercase names of columns that are results, without a number behind them; also the beginnings of longer names if
/// they have more than three letters.
const OUTPUTS: [&str; 20] = [
    "y",
    "f",
    "out",
    "output",
    "result",
    "response",
    "target",
    "objective",
    "label",
    "cost",
    "loss",
    "fitness",
    "score",
    "qoi",
    "obj",
    "ergebnis",
    "ausgang",
    "zielgr",
    "sortie",
    "salida",
];

/// Lowercase names of columns that number the rows, without punctuation.
const NUMBERS: [&str; 22] = [
    "id",
    "idx",
    "index",
    "no",
    "nr",
    "num",
    "number",
    "nummer",
    "run",
    "case",
    "point",
    "sample",
    "row",
    "experiment",
    "exp",
    "trial",
    "design",
    "dp",
    "lfd",
    "lfdnr",
    "unnamed0",
    "n",
];

/// Unit of a time.
const SECONDS: &str = "s";

/// Fewest rows of a column that may be a time despite an unknown name.
const MANY: usize = 30;

/// A column of rows.
struct RowColumn {
    /// Name in the table.
    title: String,
    /// Name in the study.
    name: String,
    unit: String,
    min: f64,
    max: f64,
    /// Numbers of cells that are numbers, and of others that have content.
    numbers: usize,
    texts: usize,
    /// The first of the latter.
    text: Option<String>,
    /// `true` if its values are 0, 1, 2, ... or 1, 2, 3, ...
    counts: bool,
    /// Its values, for the first column and for those in seconds, which may be a time.
    values: Vec<f64>,
}

/// Roles of the columns.
struct RowRoles<'a> {
    inputs: Vec<&'a RowColumn>,
    outputs: Vec<&'a RowColumn>,
    /// Columns without a role, and the reasons.
    others: Vec<(&'a RowColumn, String)>,
    /// Method by which the outputs were found.
    reason: &'static str,
}

/// Returns true if a table has rows without a time: no column is known to be one, and the arguments name none.
pub(super) fn has_no_time(file: &Path, args: &NewArgs) -> Result<bool> {
    Ok(args.structure.is_none() && args.time.is_none() && super::table::known_time(&Table::open(file)?).is_none())
}

pub(super) fn study(target: &StudyTarget, file: &Path, args: &NewArgs) -> Result<String> {
    let mut table = Table::open(file)?;
    let (columns, rows) = survey(&mut table)?;
    let roles = roles(&table, &columns, args)?;
    for (RowColumn { title, .. }, why) in &roles.others {
        say(format_args!("column `{title}`: {why}"));
    }
    for RowColumn { title, name, .. } in roles.inputs.iter().chain(&roles.outputs).filter(|of| of.name != of.title) {
        say(format_args!(
            "column `{title}`: called `{name}` in the study, and where the FMU or `predict` reads a table"
        ));
    }
    let names = |columns: &[&RowColumn]| columns.iter().map(|of| of.title.as_str()).collect::<Vec<_>>().join(", ");
    let (outputs, reason) = (names(&roles.outputs), roles.reason);
    say(format_args!(
        "a table without a time: outputs are {outputs} ({reason}), inputs {}; --inputs or --outputs COLUMNS changes that",
        names(&roles.inputs)
    ));
    if let Some((title, how)) = looks_like_time(&columns, args) {
        say(format_args!(
            "column `{title}` {how}: if it is the time, --time {} makes a study of recorded runs",
            quoted(title)
        ));
    }
    let text = text(target, file, rows, &roles);
    let study = target.parse(&text).map_err(|error| in_source(error, args))?;
    // other cells are problems of the table: a study would not help
    let stop = control()?.stop;
    let read = StaticRows::new(&study).and_then(|rows| rows.read(&study, stop));
    let read = read.map_err(|error| in_source(error, args))?;
    read.notes.iter().for_each(say);
    Ok(text)
}

/// The columns, and the number of rows.
fn survey(table: &mut Table) -> Result<(Vec<RowColumn>, usize)> {
    let positions: Vec<usize> = (0..table.columns().len()).collect();
    let column = |(title, name, unit)| RowColumn {
        title,
        name,
        unit,
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
        numbers: 0,
        texts: 0,
        text: None,
        counts: true,
        values: Vec::new(),
    };
    let mut columns: Vec<RowColumn> = columns_of(table, &positions).into_iter().map(column).collect();
    let mut rows = 0;
    while table.next_row()? {
        for (position, column) in columns.iter_mut().enumerate() {
            let value = match table.number(position) {
                Ok(value) => value,
                Err(error) => {
                    let cell = table.text(position)?;
                    if has_commas(&cell) {
                        return Err(error);
                    }
                    if is_text(&cell) {
                        column.text.get_or_insert_with(|| cell.into_owned());
                        column.texts += 1;
                    }
                    column.counts = false;
                    continue;
                }
            };
            if position == 0 || column.unit == SECONDS {
                column.values.push(value);
            }
            column.numbers += 1;
            (column.min, column.max) = (column.min.min(value), column.max.max(value));
            column.counts &= value == rows as f64 + column.min && (column.min == 0.0 || column.min == 1.0);
        }
        rows += 1;
    }
    if rows == 0 {
        return Err(table.mistake("no rows, expected at least two: one judges a model of the other"));
    }
    Ok((columns, rows))
}

fn roles<'a>(table: &Table, columns: &'a [RowColumn], args: &NewArgs) -> Result<RowRoles<'a>> {
    let (wanted_inputs, wanted_outputs) = (given_all(table, &args.inputs)?, given_all(table, &args.outputs)?);
    if let Some(both) = wanted_inputs.iter().find(|position| wanted_outputs.contains(position)) {
        let problem =
            format!("column `{}` is among --inputs and --outputs, expected one of them", columns[*both].title);
        return Err(table.mistake_in_header(&problem));
    }
    let is_text = |position: &&usize| columns[**position].texts > columns[**position].numbers;
    let texts: Vec<String> = (wanted_inputs.iter().chain(&wanted_outputs).filter(is_text))
        .map(|position| format!("`{}`", columns[*position].title))
        .collect();
    if !texts.is_empty() {
        let problem = format!("{} of --inputs and --outputs: text, expected columns of numbers", texts.join(", "));
        return Err(table.mistake_in_header(&problem));
    }
    let (mut others, mut usable) = (Vec::new(), Vec::new());
    for (position, column) in columns.iter().enumerate() {
        let is_wanted = wanted_inputs.contains(&position) || wanted_outputs.contains(&position);
        if column.texts > column.numbers {
            let text = column.text.as_deref().unwrap_or_default();
            others.push((column, format!("is text and left out: `{text}`")));
        } else if column.numbers == 0 {
            others.push((column, "is empty and left out".to_owned()));
        } else if column.min == column.max {
            others.push((column, format!("is always {} and left out", column.min)));
        } else if column.counts && is_number_of_rows(&column.title) && !is_wanted {
            others.push((column, "numbers the rows and is left out".to_owned()));
        } else {
            usable.push((position, column));
        }
    }
    let is_output = guess(&usable, &wanted_inputs, &wanted_outputs);
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    for (place, (position, column)) in usable.iter().enumerate() {
        let is_wanted = wanted_inputs.contains(position) || wanted_outputs.contains(position);
        let is_neither = !(is_wanted || wanted_inputs.is_empty() || wanted_outputs.is_empty());
        match (is_neither, is_output.0[place]) {
            (true, _) => others.push((column, "is neither in --inputs nor in --outputs and left out".to_owned())),
            (false, true) => outputs.push(*column),
            (false, false) => inputs.push(*column),
        }
    }
    if inputs.is_empty() || outputs.is_empty() {
        let why: Vec<String> = others.iter().map(|(column, why)| format!("`{}` {why}", column.title)).collect();
        let found = if why.is_empty() { String::new() } else { format!(" ({})", why.join("; ")) };
        let what = if outputs.is_empty() && !usable.is_empty() { "output" } else { "input" };
        let expected = "expected two columns of numbers that vary, or a column that is the time, which --time names";
        return Err(table.mistake_in_header(&format!("no column is left for an {what}{found}: {expected}")));
    }
    Ok(RowRoles { inputs, outputs, others, reason: is_output.1 })
}

/// `true` for each column that is an output, and the method by which they were found.
fn guess(usable: &[(usize, &RowColumn)], inputs: &[usize], outputs: &[usize]) -> (Vec<bool>, &'static str) {
    let of = |is: &dyn Fn(usize, &RowColumn) -> bool| {
        usable.iter().map(|(position, column)| is(*position, column)).collect()
    };
    if !outputs.is_empty() {
        return (of(&|position, _| outputs.contains(&position)), "by --outputs");
    }
    if !inputs.is_empty() {
        return (of(&|position, _| !inputs.contains(&position)), "all but --inputs");
    }
    let has = |name: &str| usable.iter().any(|(_, column)| column.title.eq_ignore_ascii_case(name));
    // beside x and z, y may be a coordinate
    let coordinates = ["x", "y", "z"];
    let is_surface = coordinates.into_iter().all(has);
    let is_coordinate = |title: &str| coordinates.iter().any(|name| title.eq_ignore_ascii_case(name));
    let is_named =
        |_: usize, column: &RowColumn| is_result(&column.title) && !(is_surface && is_coordinate(&column.title));
    let named: Vec<bool> = of(&is_named);
    let count = named.iter().filter(|named| **named).count();
    if count > 0 && count < usable.len() {
        return (named, "by name");
    }
    let last = usable.last().map(|(position, _)| *position);
    (of(&|position, _| Some(position) == last), "the last column")
}

/// Returns true if a column of this name is a result.
fn is_result(title: &str) -> bool {
    let title = title.to_lowercase();
    let bare = title.split(['(', '[']).next().unwrap_or_default();
    let bare = bare.trim_end_matches(|c: char| c.is_ascii_digit() || matches!(c, '_' | '.' | '-' | ' '));
    OUTPUTS.iter().any(|name| bare == *name || name.len() > 3 && bare.starts_with(name))
}

/// Returns true if a column of this name may number the rows.
fn is_number_of_rows(title: &str) -> bool {
    let bare: String = title.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect();
    // `#` and the like
    bare.is_empty() || NUMBERS.iter().any(|name| bare == *name || bare.strip_suffix("id") == Some(name))
}

/// A column that may be a time despite an unknown name, and the reason. It is the first one that grows evenly, or one
/// in seconds that grows from 0, once or in every run again.
fn looks_like_time<'a>(columns: &'a [RowColumn], args: &NewArgs) -> Option<(&'a str, &'static str)> {
    let is_even = |(position, column): &(usize, &RowColumn)| {
        let RowColumn { title, values, .. } = column;
        let grows = values.windows(2).all(|pair| pair[0] < pair[1]);
        *position == 0 && values.len() >= MANY && grows && stamps::period(values).is_some() && !is_number_of_rows(title)
    };
    let restarts = |column: &RowColumn| {
        let values = &column.values;
        let (rises, falls): (Vec<&[f64]>, Vec<&[f64]>) = values.windows(2).partition(|pair| pair[0] < pair[1]);
        column.unit == SECONDS
            && values.first() == Some(&0.0)
            && rises.len() > falls.len()
            && falls.iter().all(|pair| pair[1] == 0.0)
    };
    let found = |(position, column): (usize, &'a RowColumn)| match () {
        () if is_even(&(position, column)) => Some((column.title.as_str(), "grows evenly from row to row")),
        () if restarts(column) => Some((column.title.as_str(), "has seconds that grow from 0")),
        () => None,
    };
    columns.iter().enumerate().filter(|_| args.structure.is_none()).find_map(found)
}

fn text(target: &StudyTarget, file: &Path, rows: usize, roles: &RowRoles) -> String {
    let RowRoles { inputs, outputs, others, reason } = roles;
    let (name, file) = (target.name, target.path_from(file));
    let renamed = inputs.iter().chain(outputs).filter(|column| column.name != column.title);
    let renamed: Vec<String> =
        renamed.map(|column| format!("{} = {}", key(&column.name), quoted(&column.title))).collect();
    let columns = match renamed.is_empty() {
        true => String::new(),
        false => format!("columns = {{ {} }}    # names in the table\n", renamed.join(", ")),
    };
    let mut text = format!(
        "# Made by `metafmu new {name} --table {file}`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
structure = \"static\"        # outputs follow from inputs alone: the rows have no time
seed = 1                    # everything random follows from it

[source]
table = {}    # {rows} rows; relative to this file
{columns}
[inputs]                    # inputs of the FMU; unless given, `min` and `max` are those of the table, and `start` is between them
",
        quoted(&file),
    );
    let entry = |column: &RowColumn| {
        let unit = if column.unit.is_empty() { String::new() } else { format!(" unit = {} ", quoted(&column.unit)) };
        format!("{} = {{{unit}}}", key(&column.name))
    };
    for column in inputs {
        // writing to a string does not fail
        let _ = writeln!(text, "{}    # {} to {}", entry(column), column.min, column.max);
    }
    for (column, why) in others {
        let _ = writeln!(text, "# {} {why}", column.title.replace(char::is_control, " "));
    }
    let _ = writeln!(text, "\n[outputs]                   # {reason}; columns may be moved between inputs and outputs");
    for column in outputs {
        let _ = writeln!(text, "{}    # {} to {}", entry(column), column.min, column.max);
    }
    text + "
[static]
# model = \"network\"         # unless given, the best of a polynomial, a Gaussian process (up to 1000 rows) and a network
# std = true                # predicted standard deviations as outputs NAME_std, of a Gaussian process

# [bounds]                  # error bounds of the outputs
# coverage = 0.95           # share of further rows that are expected within

[export]                    # the FMU, and what it says about itself
fmi = \"2\"                   # version of the standard: \"2\" (more hosts know it), \"3\" or \"both\"
# author = \"...\"
# copyright = \"...\"
# license = \"...\"           # of the model: none is granted unless it is stated here
"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser;

    fn column(title: &str) -> RowColumn {
        let (name, unit) = (title.to_owned(), String::new());
        RowColumn {
            title: title.into(),
            name,
            unit,
            min: 0.0,
            max: 1.0,
            numbers: 9,
            texts: 0,
            text: None,
            counts: false,
            values: Vec::new(),
        }
    }

    /// The columns that are guessed to be outputs.
    fn guessed(titles: &[&str]) -> Vec<String> {
        let columns: Vec<RowColumn> = titles.iter().map(|title| column(title)).collect();
        let usable: Vec<(usize, &RowColumn)> = columns.iter().enumerate().collect();
        let (outputs, _) = guess(&usable, &[], &[]);
        titles.iter().zip(outputs).filter(|(_, is_output)| *is_output).map(|(title, _)| (*title).to_owned()).collect()
    }

    #[test]
    fn outputs_are_those_that_users_call_so_else_the_last_column() {
        for (titles, expected) in [
            (&["x1", "x2", "y"][..], &["y"][..]),
            (&["y1", "a", "y_2"], &["y1", "y_2"]),
            (&["x", "y", "z"], &["z"]),
            (&["x", "z", "y"], &["y"]),
            (&["x", "y", "z", "w"], &["w"]),
            (&["result", "x", "y", "z"], &["result"]),
            (&["X", "Y"], &["Y"]),
            (&["f(x)", "x"], &["f(x)"]),
            (&["Output 1 [N]", "a", "b"], &["Output 1 [N]"]),
            (&["result_drag", "cd", "speed"], &["result_drag"]),
            (&["fuel", "yield", "outer"], &["outer"]),
            (&["a", "b", "drag"], &["drag"]),
            (&["y1", "y2", "y3"], &["y3"]),
            (&["Ergebnis", "Druck"], &["Ergebnis"]),
        ] {
            assert_eq!(guessed(titles), expected, "{titles:?}");
        }
    }

    #[test]
    fn columns_that_number_rows_have_names_of_numbers() {
        let is = ["id", "ID", "No.", "#", "run_id", "Lfd. Nr.", "Unnamed: 0", "index", "case"];
        assert!(is.into_iter().all(is_number_of_rows), "{is:?}");
        let is_not = ["x", "gear", "humid", "notch", "months"];
        assert!(!is_not.into_iter().any(is_number_of_rows), "{is_not:?}");
    }

    #[test]
    fn a_first_column_that_grows_evenly_may_be_a_time() {
        let of =
            |values: &[f64], unit: &str| [RowColumn { unit: unit.into(), values: values.to_vec(), ..column("stamp") }];
        let arguments = ["metafmu", "new", "s", "--table", "t.csv"];
        let Command::New(args) = Cli::try_parse_from(arguments).unwrap().command else { panic!("{arguments:?}") };
        let even: Vec<f64> = (0..40).map(|row| 0.1 * f64::from(row)).collect();
        assert_eq!(looks_like_time(&of(&even, ""), &args), Some(("stamp", "grows evenly from row to row")));
        let mut uneven = even.clone();
        uneven[20] += 0.03;
        assert_eq!(looks_like_time(&of(&uneven, ""), &args), None);
        assert_eq!(looks_like_time(&of(&even[..20], ""), &args), None);
        let runs = [0.0, 0.3, 1.0, 0.0, 0.5, 1.0];
        assert_eq!(looks_like_time(&of(&runs, "s"), &args), Some(("stamp", "has seconds that grow from 0")));
        assert_eq!(looks_like_time(&of(&runs, "m"), &args), None);
        assert_eq!(looks_like_time(&of(&[0.0, 2.0, 1.0, 3.0], "s"), &args), None);
    }
}
