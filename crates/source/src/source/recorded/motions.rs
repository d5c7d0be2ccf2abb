//! Motions in a table, from which equations are learned: columns of coordinates, of their rates and of inputs, in rows
//! that are equally spaced in time.

use super::{ColumnNames, Recorded, resolve, runs::Runs};
use crate::{
    Error, Result,
    dataset::{Dataset, Run},
    diagnostics::{Problems, numbers::counted},
    dynamics::{
        identify::FEWEST_ROWS,
        trajectory::{Trajectory, differences},
    },
    sampling::Sets,
    source::{
        driven::{Driven, OwnInput},
        list, wrong_unit,
    },
    study::Study,
    table::Table,
    variable::SourceVariable,
};
use std::sync::{Arc, atomic::AtomicBool};

/// The motions of a table.
#[derive(Clone, Debug)]
pub struct Motions {
    driven: Driven,
    /// Runs, with the state of the first row among the parameters of each.
    runs: Arc<Vec<Run>>,
    trajectories: Arc<Vec<Trajectory>>,
    inputs: Vec<SourceVariable>,
    /// The numbers of the runs of each set.
    chosen: Sets<Vec<usize>>,
    /// End of the rows to learn from.
    stop: f64,
}

/// A part of a table's length that is rounding.
const ROUNDING: f64 = 1e-9;

impl Motions {
    /// States and inputs of the motions.
    pub fn driven(&self) -> &Driven {
        &self.driven
    }

    pub(super) fn inputs(&self) -> &[SourceVariable] {
        &self.inputs
    }

    /// The runs of each set.
    pub(super) fn sets(&self, recorded: &Recorded) -> Result<Sets<Dataset>> {
        let Sets { train, test, calibration } = self.chosen.clone().try_map(|chosen| {
            Ok(Dataset {
                inputs: self.inputs.clone(),
                parameters: recorded.parameters.clone(),
                outputs: recorded.outputs.clone(),
                runs: chosen.into_iter().map(|run| self.runs[run].clone()).collect(),
            })
        })?;
        Ok(Sets { train: train.until(self.stop), test, calibration })
    }

    /// Trajectories to learn from.
    pub(super) fn learned(&self) -> Vec<Trajectory> {
        self.chosen
            .train
            .iter()
            .map(|run| {
                let rows = self.runs[*run].times.partition_point(|time| *time <= self.stop);
                self.trajectories[*run].first(rows)
            })
            .collect()
    }
}

/// The columns of a table that has motions.
struct MotionColumns {
    /// Coordinates, then rates.
    states: Vec<SourceVariable>,
    /// The column of each rate that the table has.
    rates: Vec<Option<String>>,
    inputs: Vec<SourceVariable>,
    /// Position among the states of what each output is.
    shown: Vec<usize>,
}

impl Recorded {
    /// Finds the columns of the motions, and reads them.
    ///
    /// # Errors
    /// [`Error::Study`] with every output that is no state, [`Error::Table`] with the line of a row that is not where it is expected.
    pub(super) fn with_motions(mut self, study: &Study) -> Result<Self> {
        let mut table = Table::open(&self.path)?;
        let there = |name: &str| study.source.columns.get(name).map_or(name, String::as_str).to_owned();
        let columns = MotionColumns::new(study, &table, &there)?;
        self.outputs = columns.outputs(study)?;
        let rates = columns.rates.iter().flatten().map(|name| there(name));
        self.names.outputs = study.states.keys().map(|name| there(name)).chain(rates).collect();
        self.names.outputs.extend(columns.inputs.iter().map(|input| there(&input.name)));
        self.is_motion = true;
        let never = AtomicBool::new(false);
        let mut runs = Runs::new(&self, &never);
        self.read_long(&mut table, &mut runs)?;
        let recorded = std::mem::take(&mut runs.finished);
        if recorded.is_empty() {
            return Err(table.mistake("the table has no rows"));
        }
        // of runs that are divided in time each one is for both
        let chosen = match study.sampling.train_stop {
            Some(_) => {
                let all: Vec<usize> = (0..recorded.len()).collect();
                Sets { train: all.clone(), test: all, calibration: Vec::new() }
            }
            None => self.choose(recorded.len(), false).map_err(|error| table.mistake(&error.to_string()))?,
        };
        let motions = columns.motions(study, recorded, chosen)?;
        if let Some(short) = motions.learned().iter().find(|motion| motion.rows() < FEWEST_ROWS) {
            let part = study.sampling.train_stop.map_or(String::new(), |stop| format!(" up to {stop} s"));
            let expected = format!("expected at least {FEWEST_ROWS} to learn from");
            return Err(table.mistake(&format!("a run has {}{part}, {expected}", counted(short.rows(), "row"))));
        }
        self.parameters.extend(motions.driven.starts());
        self.motions = Some(Box::new(motions));
        Ok(self)
    }
}

impl ColumnNames {
    /// Checks that a table has the columns of a motion.
    ///
    /// # Errors
    /// [`Error::Table`] with all that are missing.
    pub(super) fn find_motions(&self, study: &Study, table: &Table) -> Result<()> {
        let rates = study.states.values().filter_map(|state| state.rate.as_ref());
        let names = study.states.keys().chain(rates).chain(study.inputs.keys());
        let names = names
            .map(|name| study.source.columns.get(name).unwrap_or(name).clone())
            .chain(self.parameters.iter().cloned())
            .chain([self.time.clone()]);
        table.columns_of(&names.collect::<Vec<String>>()).map(drop)
    }
}

impl MotionColumns {
    fn new(study: &Study, table: &Table, there: &impl Fn(&str) -> String) -> Result<Self> {
        let unit_there =
            |name: &str| Ok::<_, Error>(table.columns()[table.column(&there(name))?].unit().map(str::to_owned));
        let variable = |name: &str, unit: Option<String>, otherwise: String, description: String| {
            let options = study.outputs.get(name);
            let own = unit.or(options.and_then(|options| options.unit.clone())).unwrap_or(otherwise);
            let description = options.and_then(|options| options.description.clone()).unwrap_or(description);
            SourceVariable::new(name, &own, &description)
        };
        let (mut coordinates, mut velocities, mut rates) = (Vec::new(), Vec::new(), Vec::new());
        for (name, state) in &study.states {
            let otherwise = if state.is_periodic() { "rad" } else { "" };
            let coordinate = variable(name, unit_there(name)?, otherwise.into(), format!("coordinate {name}"));
            let unit = match &state.rate {
                Some(rate) => unit_there(rate)?,
                None => None,
            };
            let otherwise = if coordinate.unit.is_empty() { "1/s".into() } else { format!("{}/s", coordinate.unit) };
            velocities.push(variable(&state.rate_name(name), unit, otherwise, format!("derivative of {name}")));
            coordinates.push(coordinate);
            rates.push(state.rate.clone());
        }
        let inputs = study
            .inputs
            .iter()
            .map(|(name, options)| {
                resolve(table, &there(name), name, options.unit.as_deref(), options.description.as_deref())
            })
            .collect::<Result<_>>()?;
        let states = [coordinates, velocities].concat();
        let shown =
            study.outputs.keys().filter_map(|name| states.iter().position(|state| state.name == *name)).collect();
        Ok(Self { states, rates, inputs, shown })
    }

    /// The study's outputs, which are states.
    fn outputs(&self, study: &Study) -> Result<Vec<SourceVariable>> {
        let mut problems = Problems::default();
        for (name, options) in &study.outputs {
            match self.states.iter().find(|state| state.name == *name) {
                Some(state) => {
                    problems.extend(wrong_unit(&format!("outputs.{name}"), options.unit.as_deref(), &state.unit))
                }
                None => {
                    let known = list(self.states.iter().map(|state| &state.name));
                    let message = format!(
                        "is no state: of a table coordinates and their rates are shown, expected one of {known}"
                    );
                    problems.add(format!("outputs.{name}"), message);
                }
            }
        }
        study.refuse(problems)?;
        Ok(self.shown.iter().map(|state| self.states[*state].clone()).collect())
    }

    /// The motions of runs whose outputs are coordinates, rates that the table has, and inputs.
    fn motions(&self, study: &Study, recorded: Vec<Run>, chosen: Sets<Vec<usize>>) -> Result<Motions> {
        let (n, m) = (self.rates.len(), self.inputs.len());
        let trajectories: Vec<Trajectory> = recorded.iter().map(|run| self.trajectory(run)).collect();
        let runs = recorded.into_iter().zip(&trajectories).map(|(run, Trajectory { q, v, u, .. })| {
            let starts = [&q[..n], &v[..n]].concat();
            let mut outputs = Vec::new();
            for (q, v) in q.chunks_exact(n).zip(v.chunks_exact(n)).take(run.times.len()) {
                outputs.extend(self.shown.iter().map(|&state| if state < n { q[state] } else { v[state - n] }));
            }
            let parameters = [run.parameters.as_slice(), &starts].concat();
            Run { parameters, times: Arc::clone(&run.times), inputs: u.clone(), outputs }
        });
        let runs: Vec<Run> = runs.collect();
        let stop = study.sampling.train_stop.unwrap_or(study.time.stop) * (1.0 + ROUNDING);
        let learned = runs.iter().zip(&trajectories);
        let learned: Vec<Trajectory> =
            learned.map(|(run, motion)| motion.first(run.times.partition_point(|time| *time <= stop))).collect();
        let own = self.inputs.iter().enumerate().map(|(column, variable)| {
            let [min, max] = range(learned.iter().flat_map(|motion| motion.u.iter().skip(column).step_by(m)));
            let start = trajectories[0].u.get(column).copied();
            OwnInput { variable: variable.clone(), range: [Some(min), Some(max)], start }
        });
        let ranges = (0..2 * n).map(|k| match k < n {
            true => range(learned.iter().flat_map(|motion| motion.q.iter().skip(k).step_by(n))),
            false => range(learned.iter().flat_map(|motion| motion.v.iter().skip(k - n).step_by(n))),
        });
        let first = &trajectories[0];
        let start = [&first.q[..n], &first.v[..n]].concat();
        let driven = Driven::of_table(study, self.states.clone(), (start, ranges.collect()), own.collect());
        let driven = match driven {
            Ok(driven) => driven,
            Err(problems) => return Err(study.refuse(problems).err().unwrap_or(Error::Interrupted)),
        };
        let (runs, trajectories) = (Arc::new(runs), Arc::new(trajectories));
        Ok(Motions { driven, runs, trajectories, inputs: self.inputs.clone(), chosen, stop })
    }

    fn trajectory(&self, run: &Run) -> Trajectory {
        let (n, m, rows) = (self.rates.len(), self.inputs.len(), run.times.len());
        let width = run.outputs.len() / rows;
        let column = |column: usize| run.outputs.iter().skip(column).step_by(width).copied().collect::<Vec<f64>>();
        let step = (run.times[rows - 1] - run.times[0]) / rows.saturating_sub(1).max(1) as f64;
        let mut given = n..;
        let rates: Vec<Vec<f64>> = self
            .rates
            .iter()
            .enumerate()
            .map(|(k, rate)| match (rate, given.next()) {
                (Some(_), Some(position)) => column(position),
                _ => differences(&run.outputs, width, k, step),
            })
            .collect();
        let by_rows =
            |columns: &[Vec<f64>]| (0..rows).flat_map(|row| columns.iter().map(move |column| column[row])).collect();
        Trajectory {
            parameters: run.parameters.clone(),
            step,
            coordinates: n,
            q: by_rows(&(0..n).map(column).collect::<Vec<_>>()),
            v: by_rows(&rates),
            u: by_rows(&(width - m..width).map(column).collect::<Vec<_>>()),
        }
    }
}

/// The smallest and the largest of some values.
fn range<'a>(values: impl Iterator<Item = &'a f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(*value), max.max(*value)])
}
