//! Simulations of the FMU of a discrete-time surrogate that start from measured outputs: the rule of [`super::predict()`] for its inputs.

use super::predict::{check_sample, partly_measured};
use crate::{Result, diagnostics::names::listed, fmi::host::Inputs, table::Table};
use metafmu_runtime::{BuiltIn, Output, Surrogate};

/// Reads the inputs of an FMU from a table, and the time of the first row if outputs are measured there.
///
/// Columns of all outputs of a discrete-time surrogate are measured in rows with negative times: they become inputs,
/// which the FMU uses up to the last of these rows, if it `takes_measured` outputs. The outputs of other rows are not used; `tell` receives
/// columns of some outputs.
///
/// # Errors
/// Those of [`Inputs::read`]; [`Error::Table`](crate::Error::Table) with the line of a row before time 0 that is no sample, or
/// that lacks some of the outputs, or has them for an FMU that takes none.
pub fn read_inputs(
    surrogate: &Surrogate,
    takes_measured: bool,
    table: Table,
    tell: impl Fn(&str),
) -> Result<(Inputs, Option<f64>)> {
    let Some(sampling) = surrogate.program().sampling() else { return Ok((Inputs::read(table)?, None)) };
    let position = |names: &[String], output: &Output| names.iter().position(|name| *name == output.name);
    let is_measured = |names: &[String]| surrogate.outputs().iter().all(|output| position(names, output).is_some());
    let problem = |inputs: &Inputs, time: f64| {
        if time >= 0.0 {
            return None;
        }
        let is_missing = |output: &&Output| position(&inputs.names, output).is_none();
        let missing: Vec<&str> =
            surrogate.outputs().iter().filter(is_missing).map(|output| output.name.as_str()).collect();
        match missing.len() {
            0 if !takes_measured => Some(
                "outputs were measured before 0 s, and the FMU has no inputs for them: `metafmu export --ports measured` adds them".into(),
            ),
            0 => check_sample(&inputs.times, time, sampling.step),
            count if count == surrogate.outputs().len() => None,
            _ => Some(partly_measured(&missing, &inputs.names.iter().map(String::as_str).collect::<Vec<_>>())),
        }
    };
    let mut inputs = Inputs::read_with(table, problem)?;
    let columns: Vec<usize> = surrogate.outputs().iter().filter_map(|output| position(&inputs.names, output)).collect();
    let first = inputs.times[0];
    if is_measured(&inputs.names) && first < 0.0 {
        for (&column, output) in columns.iter().zip(surrogate.outputs()) {
            inputs.names[column] = Output::measured_name(&output.name);
        }
        switch(&mut inputs, sampling.step);
        return Ok((inputs, Some(first)));
    }
    if !columns.is_empty() && !is_measured(&inputs.names) {
        let names: Vec<&str> = columns.iter().map(|&column| inputs.names[column].as_str()).collect();
        tell(&format!("columns that are not used: {}", listed(&names)));
    }
    remove(&mut inputs, &columns);
    Ok((inputs, None))
}

/// Uses measured outputs in rows with negative times. A further row between the last of them and the next one ends it:
/// a communication point before a row by rounding belongs to that row.
fn switch(inputs: &mut Inputs, step: f64) {
    let count = inputs.times.partition_point(|time| *time < 0.0);
    let last = inputs.times[count - 1];
    let row: Vec<f64> = match inputs.rows.get(count) {
        Some(next) => inputs.rows[count - 1].iter().zip(next).map(|(from, to)| from + 0.5 * (to - from)).collect(),
        None => inputs.rows[count - 1].clone(),
    };
    let next = inputs.times.get(count).map_or(last + step, |next| *next);
    inputs.times.insert(count, last + 0.5 * (next - last));
    inputs.rows.insert(count, row);
    inputs.names.push(BuiltIn::UseMeasured.name().into());
    inputs.rows.iter_mut().enumerate().for_each(|(row, values)| values.push(f64::from(u8::from(row < count))));
}

fn remove(inputs: &mut Inputs, columns: &[usize]) {
    let keeps = |index: usize| !columns.contains(&index);
    let kept = |values: &mut Vec<f64>| {
        *values = values.iter().enumerate().filter(|(index, _)| keeps(*index)).map(|(_, value)| *value).collect();
    };
    inputs.rows.iter_mut().for_each(kept);
    let names = std::mem::take(&mut inputs.names);
    inputs.names = names.into_iter().enumerate().filter(|(index, _)| keeps(*index)).map(|(_, name)| name).collect();
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;
    use std::cell::RefCell;

    /// Inputs of a table, and the lines that are printed about it.
    struct ReadTable {
        inputs: Result<(Inputs, Option<f64>)>,
        lines: Vec<String>,
    }

    fn read(text: &str) -> ReadTable {
        read_for(text, true)
    }

    fn read_for(text: &str, takes_measured: bool) -> ReadTable {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let lines = RefCell::new(Vec::new());
        let table = Table::open(file.path()).unwrap();
        let inputs =
            read_inputs(&example::recorded(), takes_measured, table, |line| lines.borrow_mut().push(line.to_owned()));
        ReadTable { inputs, lines: lines.into_inner() }
    }

    #[test]
    fn outputs_are_measured_up_to_a_row_between_the_last_one_before_the_start_and_the_next() {
        let table = read("time,position,force\n-0.2,0.5,1\n-0.1,0.75,2\n0,9,3\n0.1,9,4\n");
        let (inputs, start) = table.inputs.unwrap();
        assert_eq!(
            (inputs.names, start),
            (vec!["position_measured".into(), "force".into(), "use_measured".into()], Some(-0.2))
        );
        assert_eq!(inputs.times, [-0.2, -0.1, -0.05, 0.0, 0.1]);
        let expected = [[0.5, 1.0, 1.0], [0.75, 2.0, 1.0], [4.875, 2.5, 0.0], [9.0, 3.0, 0.0], [9.0, 4.0, 0.0]];
        assert_eq!(inputs.rows, expected.map(|row| row.to_vec()));
        assert!(table.lines.is_empty());
        // the table may end there
        let (mut inputs, _) = read("time,position,force\n-0.2,0.5,1\n-0.1,0.7,2\n").inputs.unwrap();
        assert_eq!((inputs.times, inputs.rows.pop()), (vec![-0.2, -0.1, -0.05], Some(vec![0.7, 2.0, 0.0])));
    }

    #[test]
    fn outputs_of_other_rows_are_not_used_and_a_row_that_is_no_sample_is_located() {
        let table = read("time,position,force\n0,9,3\n0.1,9,4\n");
        assert_eq!(
            table.inputs.unwrap(),
            (Inputs { names: vec!["force".into()], times: vec![0.0, 0.1], rows: vec![vec![3.0], vec![4.0]] }, None)
        );
        assert!(table.lines.is_empty());
        let message =
            "time -0.05 s, expected -0.1 s: rows before time 0 are 0.1 s apart, as their outputs are measured samples";
        let error = read("time,position\n-0.2,1\n-0.05,1\n").inputs.unwrap_err().to_string();
        assert!(error.ends_with(&format!(":3: {message}")), "{error}");
        let error = read_for("time,position,force\n-0.2,0.5,1\n", false).inputs.unwrap_err().to_string();
        assert!(error.contains("the FMU has no inputs for them: `metafmu export --ports measured`"), "{error}");
        // inputs alone may be anywhere
        assert_eq!(read("time,force\n-0.2,1\n-0.05,1\n").inputs.unwrap().1, None);
    }
}
