//! Next rows of the table of a static map: points in the ranges of its inputs, for the user to run.

use crate::{
    Error, Result,
    baselines::{DesignPlaces, GaussianProcess, StandardizedRows, choose_rows, design_points},
    diagnostics::Problems,
    files,
    kinds::{self, learning::Learning},
    project::{Control, Event},
    sampling::{self, Stream},
    scaling::of_columns,
    source::{StaticRows, rows::DesignRows},
    study::{Draft, Study},
    table::{TableColumn, header_field},
};
use metafmu_runtime::{Rows, Scaling};
use std::{fmt::Write as _, io::Write, path::Path};

/// Fewest places among which points beside rows are chosen, and places for each point.
const PLACES: usize = 1000;
const PLACES_FOR_EACH: usize = 2;
/// Largest number of points beside rows.
const MOST_BESIDE_ROWS: usize = 1000;
/// Largest number of points without rows.
const MOST: usize = 1_000_000;
/// Latin hypercubes that are compared, if distances of their points are few enough.
const HYPERCUBES: usize = 200;
const DISTANCES: usize = 20_000_000;
/// Share of the places that lies on the ends of each range.
const FACES: f64 = 0.1;
/// Digits of a range that points have.
const DIGITS: i32 = 6;

/// Design points as a table.
struct Design {
    columns: Vec<TableColumn>,
    /// Position of each input among the columns.
    positions: Vec<usize>,
    points: Rows,
}

/// Writes points as CSV, with empty outputs. They are a space-filling design if the table has no rows. Otherwise they
/// reduce the variance of a Gaussian process of its rows the most. Rows without outputs are points that were planned
/// before. The same study and table give the same points.
///
/// # Errors
/// [`Error::Study`] with problems of the study and with ranges that neither it nor the table has, [`Error::Rows`] and
/// [`Error::Table`] of the table, [`Error::Interrupted`], [`Error::Io`].
pub fn plan(study: &Path, points: usize, control: Control, to: (&mut dyn Write, &Path)) -> Result<()> {
    let study = Draft::load_without_table(study)?.finish()?;
    if let Learning::FromRuns(_) = kinds::of(&study).learning(&study) {
        let message = "points are planned for tables without a time, expected \"static\": of other structures, `metafmu sample --dry-run` prints the plan";
        return Err(study.refusal("structure", message));
    }
    let design = design(&study, points, control)?;
    let (to, path) = to;
    to.write_all(design.csv().as_bytes()).map_err(Error::io(path, "write"))
}

/// The study's table, if it is not that with which the design would be replaced.
///
/// # Errors
/// [`Error::Study`], those of a study that cannot be read.
pub fn check_out(study: &Path, out: &Path) -> Result<()> {
    let study = Draft::load_without_table(study)?.finish()?;
    let table = study.source.table.as_deref().map(|table| study.beside(table));
    let is_same =
        |table: &Path| table.canonicalize().is_ok_and(|table| out.canonicalize().is_ok_and(|out| out == table));
    match table {
        Some(table) if is_same(&table) && files::has_content(&table) => {
            let message =
                "--out would replace the rows of this table: write the points to another file, then append them";
            Err(study.refusal("source.table", message))
        }
        _ => Ok(()),
    }
}

fn design(study: &Study, count: usize, control: Control) -> Result<Design> {
    let say = |line: std::fmt::Arguments| control.observer.event(Event::Message(line));
    let table = study.beside(study.source.table.as_deref().unwrap_or(Path::new("")));
    let rows = match files::has_content(&table) {
        true => StaticRows::new(study)?.design(control.stop)?,
        false => DesignRows::of_study(study),
    };
    let ranges = ranges(study, &rows)?;
    let names: Vec<&str> = study.inputs.keys().map(String::as_str).collect();
    let is_first = rows.points.is_empty();
    let most = if is_first { MOST } else { MOST_BESIDE_ROWS };
    if !(1..=most).contains(&count) {
        let message = format!(
            "--points: {count}, expected 1 to {most}{}",
            if is_first { "" } else { " beside the rows of a table" }
        );
        return Err(study.refusal("source.table", message));
    }
    let points = match is_first {
        true => {
            say(format_args!("{count} points that fill the ranges of {}: a Latin hypercube", names.join(", ")));
            spread(study, &ranges, count)
        }
        false => beside_rows(study, &ranges, &rows, count, say),
    };
    if points.len() < count {
        return Err(
            study.refusal("inputs", format!("{} points were found in these ranges, expected {count}", points.len()))
        );
    }
    Ok(Design { columns: rows.columns, positions: rows.positions, points })
}

/// Range of each input: that of the study, else that of the rows.
fn ranges(study: &Study, rows: &DesignRows) -> Result<Vec<[f64; 2]>> {
    let mut problems = Problems::default();
    let range = |(column, (name, options)): (usize, (&String, &crate::study::InputOptions))| {
        let values = || rows.points.iter().map(|point| point[column]);
        let min = options.min.unwrap_or_else(|| values().fold(f64::INFINITY, f64::min));
        let max = options.max.unwrap_or_else(|| values().fold(f64::NEG_INFINITY, f64::max));
        if min >= max {
            let message = "has no range, expected `min` and `max`, or rows of the table from which they follow";
            problems.add(format!("inputs.{name}"), message);
        }
        [min, max]
    };
    let ranges = study.inputs.iter().enumerate().map(range).collect();
    study.refuse(problems)?;
    Ok(ranges)
}

/// The value of a share of a range, in a few digits.
fn value([min, max]: [f64; 2], share: f64) -> f64 {
    let value = min + (max - min) * share;
    let digits = DIGITS - 1 - (max - min).log10().floor() as i32;
    let factor = 10f64.powi(digits.abs());
    let rounded = if digits >= 0 { (value * factor).round() / factor } else { (value / factor).round() * factor };
    if rounded.is_finite() { rounded.clamp(min, max) } else { value }
}

fn placed(ranges: &[[f64; 2]], shares: &[f64], faces: f64) -> Vec<f64> {
    let share = |share: f64| ((share - 0.5 * faces) / (1.0 - faces)).clamp(0.0, 1.0);
    ranges.iter().zip(shares).map(|(range, of)| value(*range, share(*of))).collect()
}

/// Latin hypercube whose nearest points are the farthest from each other, of many random ones.
fn spread(study: &Study, ranges: &[[f64; 2]], count: usize) -> Rows {
    let mut generator = sampling::random(study.seed, Stream::Design);
    let tries = (DISTANCES / (count * count).max(1)).clamp(1, HYPERCUBES);
    let made = (0..tries).map(|_| {
        let points = sampling::latin_hypercube(ranges.len(), count, &mut generator);
        let distance = if tries > 1 { least_distance(&points) } else { 0.0 };
        (distance, points)
    });
    // the first of equal ones
    let best = made.reduce(|best, next| if next.0 > best.0 { next } else { best });
    let points = best.map_or_else(Rows::default, |(_, points)| points);
    points.iter().map(|shares| placed(ranges, shares, 0.0)).collect()
}

fn least_distance(points: &Rows) -> f64 {
    let distance = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
    let pairs = points.iter().enumerate().flat_map(|(place, a)| points.iter().take(place).map(move |b| distance(a, b)));
    pairs.fold(f64::INFINITY, f64::min)
}

fn beside_rows(
    study: &Study,
    ranges: &[[f64; 2]],
    rows: &DesignRows,
    count: usize,
    say: impl Fn(std::fmt::Arguments),
) -> Rows {
    let places = PLACES.max(PLACES_FOR_EACH * count);
    let mut generator = sampling::random(study.seed, Stream::Design);
    let shares = sampling::latin_hypercube(ranges.len(), places, &mut generator);
    let is_new = |point: &Vec<f64>| !rows.points.contains(point);
    let candidates: Rows = shares.iter().map(|shares| placed(ranges, shares, FACES)).filter(is_new).collect();
    let (mut points, mut labels, mut planned) = (Rows::default(), Rows::default(), Rows::default());
    for (point, outputs) in rows.points.iter().zip(&rows.outputs) {
        match outputs {
            Some(outputs) => {
                points.push(point);
                labels.push(outputs);
            }
            None => planned.push(point),
        }
    }
    let waiting = match planned.len() {
        0 => String::new(),
        planned => format!(", {planned} of them planned and without outputs"),
    };
    say(format_args!(
        "{count} points beside {} rows{waiting}: they reduce the expected error the most",
        rows.points.len()
    ));
    // lengths of distances, where no row has outputs
    let (input_mean, input_scale) = of_columns(points.iter().chain(&planned));
    let outputs = labels.width();
    let (output_mean, output_scale) =
        if labels.is_empty() { (vec![0.0; outputs], vec![1.0; outputs]) } else { of_columns(&labels) };
    let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
    let places = [planned.values(), candidates.values()].concat();
    let x = StandardizedRows::new(places, Vec::new(), scaling.clone()).x;
    let model = GaussianProcess::default();
    let known = StandardizedRows::new(points.into_values(), labels.into_values(), scaling);
    let known = choose_rows(&known, Some(model.rows), study.seed);
    let chosen = design_points(&model, &known, &DesignPlaces { x, planned: planned.len() }, count);
    chosen.into_iter().map(|place| &candidates[place - planned.len()]).collect()
}

impl Design {
    fn csv(&self) -> String {
        let title = |TableColumn { name, unit }: &TableColumn| match unit {
            Some(unit) => header_field(&format!("{name} [{unit}]")),
            None => header_field(name),
        };
        let mut text = self.columns.iter().map(title).collect::<Vec<_>>().join(",") + "\n";
        for point in &self.points {
            let mut cells = vec![String::new(); self.columns.len()];
            for (position, value) in self.positions.iter().zip(point) {
                // writing to a string does not fail
                let _ = write!(cells[*position], "{value:?}");
            }
            text += &(cells.join(",") + "\n");
        }
        text
    }
}
