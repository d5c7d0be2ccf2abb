//! A whole run of one FMU.

use super::{Fmu, Instance, Step};
use crate::{
    Error, Result,
    fmu::model_description::{Causality, ScalarVariable, Variability, VariableType},
};

/// A run with more steps than this is taken for a mistake in the step size.
const MAX_STEPS: f64 = 1e8;
/// Steps of a run whose step size neither the caller nor the FMU gives.
const DEFAULT_STEPS: f64 = 500.0;
/// A remainder below this share of a step is rounding, not a last partial step.
const ROUNDING: f64 = 1e-9;

/// What to run. Whatever is not given comes from the FMU's default experiment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SimulationOptions {
    /// Start time; else the FMU's, else 0.
    pub start: Option<f64>,
    /// Stop time; else the FMU's.
    pub stop: Option<f64>,
    /// Communication step size; else the FMU's, else a 500th of the whole.
    pub step: Option<f64>,
    /// Values that variables start with, by name: 0 or 1 for a boolean.
    pub start_values: Vec<(String, f64)>,
    /// Names of further variables to record.
    pub record: Vec<String>,
}

/// The result of a run: a row for each communication point, the start included.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// What the columns are; time is not among them.
    pub columns: Vec<Column>,
    /// Time of each row.
    pub times: Vec<f64>,
    /// Values of each row, in the order of the columns.
    pub rows: Vec<Vec<f64>>,
    /// Whether the FMU ended the simulation before its stop time.
    pub terminated: bool,
}

/// A recorded variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// The variable's name.
    pub name: String,
    /// Its unit.
    pub unit: Option<String>,
}

/// Runs an instance that was just made or reset, from its initialization to its end, and records the outputs.
///
/// Step `i` begins at `start + i * step`, with no accumulation of rounding; a last partial step reaches `stop`.
///
/// # Errors
/// - [`Error::Experiment`]: the times make no simulation, or need a partial step the FMU cannot do;
/// - [`Error::UnknownVariable`], [`Error::Variable`]: a start value or recorded variable that cannot be;
/// - [`Error::Fmi`]: the FMU failed.
pub fn simulate(instance: &Instance, options: &SimulationOptions) -> Result<Table> {
    let grid = Grid::new(instance.fmu(), options)?;
    let recorder = Recorder::new(instance, &options.record)?;
    // a stop time that is the start time is refused by some FMUs
    instance.setup_experiment(grid.start, (grid.stop > grid.start).then_some(grid.stop))?;
    for (name, value) in &options.start_values {
        set_start(instance, name, *value)?;
    }
    instance.enter_initialization_mode()?;
    instance.exit_initialization_mode()?;

    let mut table = Table {
        columns: recorder.columns.clone(),
        times: vec![grid.start],
        rows: vec![recorder.row()?],
        terminated: false,
    };
    for step in 0..grid.steps() {
        let time = grid.time(step);
        let step_end = instance.do_step(time, grid.size(step))?;
        table.terminated = step_end != Step::Done;
        table.times.push(match step_end {
            Step::Done => grid.time(step + 1),
            Step::Terminated { time } => time,
        });
        table.rows.push(recorder.row()?);
        if table.terminated {
            break;
        }
    }
    instance.terminate()?;
    Ok(table)
}

/// The communication points of a run.
#[derive(Debug, PartialEq)]
pub struct Grid {
    start: f64,
    stop: f64,
    step: f64,
    full_steps: usize,
    /// Whether a shorter step follows the full ones.
    partial: bool,
}

impl Grid {
    pub fn new(fmu: &Fmu, options: &SimulationOptions) -> Result<Self> {
        let experiment = fmu.description().default_experiment.unwrap_or_default();
        let start = options.start.or(experiment.start).unwrap_or(0.0);
        let wrong = |stop, step, expected| Err(Error::Experiment { start, stop, step, expected });
        let Some(stop) = options.stop.or(experiment.stop) else {
            return wrong(f64::NAN, f64::NAN, "a stop time: the FMU suggests none");
        };
        let step = options.step.or(experiment.step_size).unwrap_or((stop - start) / DEFAULT_STEPS);
        let grid = match Self::of_times(start, stop, step) {
            Ok(grid) => grid,
            Err(expected) => return wrong(stop, step, expected),
        };
        if grid.partial && !fmu.co_simulation().variable_step_size {
            return wrong(stop, step, "whole steps: the FMU cannot do a shorter last one");
        }
        Ok(grid)
    }

    fn of_times(start: f64, stop: f64, step: f64) -> std::result::Result<Self, &'static str> {
        if !(start.is_finite() && stop.is_finite() && start <= stop) {
            return Err("finite times, the stop not before the start");
        }
        if !(step.is_finite() && step > 0.0) && start < stop {
            return Err("a step size above zero");
        }
        // a run of no length has no steps, whatever their size
        let steps = if start < stop { (stop - start) / step } else { 0.0 };
        if steps > MAX_STEPS {
            return Err("at most 100 million steps");
        }
        let whole = steps.round();
        let partial = (steps - whole).abs() > ROUNDING * whole.max(1.0);
        let full_steps = if partial { steps.floor() } else { whole } as usize;
        Ok(Self { start, stop, step, full_steps, partial })
    }

    /// Only the first steps.
    pub fn shorten(&mut self, steps: usize) {
        if steps < self.full_steps {
            *self = Self { stop: self.time(steps), full_steps: steps, partial: false, ..*self };
        }
    }

    pub fn steps(&self) -> usize {
        self.full_steps + usize::from(self.partial)
    }

    /// Where step `index` begins; `steps()` gives the end of the run.
    pub fn time(&self, index: usize) -> f64 {
        if index > self.full_steps { self.stop } else { self.start + index as f64 * self.step }
    }

    /// Full steps are given to the FMU as exactly `step`, for some accept no other size.
    pub fn size(&self, index: usize) -> f64 {
        if index < self.full_steps { self.step } else { self.stop - self.time(index) }
    }
}

/// Sets a start value before initialization.
fn set_start(instance: &Instance, name: &str, value: f64) -> Result<()> {
    let variable = find(instance, name)?;
    let wrong = |problem: String| Err(Error::Variable { name: name.into(), problem });
    let settable = variable.variability != Variability::Constant
        && (variable.causality == Causality::Input || variable.kind.has_start());
    if !settable || variable.causality == Causality::Independent {
        return wrong("has no start value to be set".into());
    }
    let reference = [variable.value_reference];
    match &variable.kind {
        VariableType::Real(_) => instance.set_real(&reference, &[value]),
        VariableType::Integer(_) | VariableType::Enumeration(_) => {
            if value != f64::from(value as i32) {
                return wrong(format!("start value {value}, expected an integer of 32 bits"));
            }
            instance.set_integer(&reference, &[value as i32])
        }
        VariableType::Boolean { .. } => {
            if value != 0.0 && value != 1.0 {
                return wrong(format!("start value {value}, expected 0 or 1"));
            }
            instance.set_boolean(&reference, &[value == 1.0])
        }
        VariableType::String { .. } => wrong("is a text, which cannot be set to a number".into()),
    }
}

fn find<'a>(instance: &Instance<'a>, name: &str) -> Result<&'a ScalarVariable> {
    let description = instance.fmu().description();
    description.variable(name).ok_or_else(|| Error::UnknownVariable {
        name: name.into(),
        known: description.variables.iter().map(|variable| variable.name.clone()).collect(),
    })
}

/// Reads variables of several types into rows of numbers.
pub struct Recorder<'a> {
    instance: &'a Instance<'a>,
    columns: Vec<Column>,
    reals: Group,
    integers: Group,
    booleans: Group,
}

/// Variables of one type: their value references and the columns they go to.
#[derive(Default)]
struct Group {
    references: Vec<u32>,
    columns: Vec<usize>,
}

impl<'a> Recorder<'a> {
    /// Records all outputs but texts, then the named variables.
    pub fn new(instance: &'a Instance<'a>, more: &[String]) -> Result<Self> {
        let description = instance.fmu().description();
        let mut variables: Vec<&ScalarVariable> =
            description.outputs().filter(|output| !matches!(output.kind, VariableType::String { .. })).collect();
        for name in more {
            let variable = find(instance, name)?;
            if matches!(variable.kind, VariableType::String { .. }) {
                let problem = "is a text, which cannot be recorded as a number".into();
                return Err(Error::Variable { name: name.clone(), problem });
            }
            if !variables.iter().any(|known| known.name == *name) {
                variables.push(variable);
            }
        }
        let [mut reals, mut integers, mut booleans] = <[Group; 3]>::default();
        let mut columns = Vec::new();
        for variable in variables {
            let group = match variable.kind {
                VariableType::Boolean { .. } => &mut booleans,
                VariableType::Integer(_) | VariableType::Enumeration(_) => &mut integers,
                VariableType::Real(_) | VariableType::String { .. } => &mut reals,
            };
            group.references.push(variable.value_reference);
            group.columns.push(columns.len());
            let unit = description.unit_of(variable).map(str::to_owned);
            columns.push(Column { name: variable.name.clone(), unit });
        }
        Ok(Self { instance, columns, reals, integers, booleans })
    }

    /// The values now.
    pub fn row(&self) -> Result<Vec<f64>> {
        let mut row = vec![0.0; self.columns.len()];
        if !self.reals.references.is_empty() {
            let mut reals = vec![0.0; self.reals.references.len()];
            self.instance.get_real(&self.reals.references, &mut reals)?;
            self.reals.put(reals, &mut row);
        }
        if !self.integers.references.is_empty() {
            let mut integers = vec![0; self.integers.references.len()];
            self.instance.get_integer(&self.integers.references, &mut integers)?;
            self.integers.put(integers, &mut row);
        }
        if !self.booleans.references.is_empty() {
            let mut booleans = vec![false; self.booleans.references.len()];
            self.instance.get_boolean(&self.booleans.references, &mut booleans)?;
            self.booleans.put(booleans, &mut row);
        }
        Ok(row)
    }
}

impl Group {
    fn put(&self, values: Vec<impl Into<f64>>, row: &mut [f64]) {
        for (&column, value) in self.columns.iter().zip(values) {
            row[column] = value.into();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn communication_points_are_computed_without_accumulation() {
        let grid = Grid::of_times(0.0, 1.0, 0.1).unwrap();
        assert_eq!((grid.steps(), grid.partial), (10, false));
        assert_eq!(grid.time(3), 0.0 + 3.0 * 0.1);
        assert_eq!(grid.size(9), 0.1);
        // 0.3 / 0.1 is a little less than 3
        assert_eq!(Grid::of_times(0.0, 0.3, 0.1).unwrap().steps(), 3);
    }

    #[test]
    fn a_last_partial_step_ends_at_the_stop_time() {
        let grid = Grid::of_times(1.0, 2.05, 0.1).unwrap();
        assert_eq!((grid.steps(), grid.partial), (11, true));
        assert_eq!(grid.time(11), 2.05);
        assert_eq!(grid.size(10), 2.05 - grid.time(10));
        let grid = Grid::of_times(0.0, 0.5, 1.0).unwrap();
        assert_eq!((grid.steps(), grid.time(1), grid.size(0)), (1, 0.5, 0.5));
    }

    #[test]
    fn a_run_of_no_length_has_one_row() {
        assert_eq!(Grid::of_times(1.0, 1.0, 0.0).unwrap().steps(), 0);
    }

    #[test]
    fn times_that_make_no_run_are_refused() {
        for (start, stop, step) in [
            (0.0, -1.0, 0.1),
            (0.0, f64::NAN, 0.1),
            (0.0, 1.0, 0.0),
            (0.0, 1.0, -1.0),
            (0.0, 1.0, f64::NAN),
            (0.0, 1.0, 1e-12),
        ] {
            assert!(Grid::of_times(start, stop, step).is_err(), "{start} {stop} {step}");
        }
    }
}
