//! Region of a table's rows within the ranges of its columns.

use metafmu_runtime::{Cover, Domain, Input, Rows};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use rayon::prelude::*;
use std::collections::HashSet;

/// Largest number of cubes of a cover, all of which a step of an FMU may check.
const CUBES: usize = 512;
/// Largest number of rows among which centers are chosen, and of those whose distances from others are computed.
const CANDIDATES: usize = 1 << 16;
const DISTANCES: usize = 1 << 11;
/// Share of further rows, drawn like those of the table, that is to be inside.
const SHARE: f64 = 0.99;
/// Random points by which a cover is compared with the ranges.
const POINTS: usize = 4096;

/// Cubes around some of the rows. All rows are inside, and so is a further row that is drawn like them, with a
/// probability of [`SHARE`]. The probability is n / (n + 1) if half of the rows, n, are too few for that. None if the
/// cubes fill the ranges and add no information.
///
/// A further row is at most `gap` from one of the rows with that probability. It is a split-conformal bound: the
/// quantile of the distances of one half of the rows from the nearest row of the other half. Every row is at most a
/// covering radius from a center; each center is chosen as far as possible from those before (Gonzalez 1985). The half
/// width of the cubes is the sum of `gap` and the covering radius.
pub fn of_rows(rows: &Rows, inputs: &[Input]) -> Option<Cover> {
    let columns: Vec<usize> = (0..inputs.len()).filter(|&column| Cover::counts(&inputs[column])).collect();
    let mut seen = HashSet::new();
    let mut rows: Vec<Vec<f32>> = rows
        .iter()
        .map(|row| {
            columns
                .iter()
                .map(|&column| {
                    let Input { min, max, .. } = inputs[column];
                    ((row[column] - min) / (max - min)) as f32
                })
                .collect::<Vec<f32>>()
        })
        .filter(|row| row.iter().all(|value| (0.0..=1.0).contains(value)))
        .filter(|row| seen.insert(row.iter().map(|value| value.to_bits()).collect::<Vec<u32>>()))
        .collect();
    if columns.is_empty() || rows.len() < 2 {
        return None;
    }
    let mut random = ChaCha8Rng::seed_from_u64(1);
    rows.shuffle(&mut random);
    let (some, others) = rows.split_at(rows.len() / 2);
    let gap = gap(&some[..some.len().min(DISTANCES)], &others[..others.len().min(CANDIDATES)]);
    let centres = centres(&rows[..rows.len().min(CANDIDATES)], 0.5 * gap);
    let table = RowMatrix::new(&centres);
    let radius = nearest(&rows, &table).into_iter().fold(0.0, f32::max) + gap;
    let points: Vec<Vec<f32>> = (0..POINTS).map(|_| columns.iter().map(|_| random.random::<f32>()).collect()).collect();
    if nearest(&points, &table).into_iter().all(|distance| distance <= radius) {
        return None;
    }
    Some(Cover {
        columns: columns.into_iter().map(|column| column as u32).collect(),
        // rows were rounded
        radius: f64::from(radius) + f64::from(f32::EPSILON),
        centres: centres.concat(),
    })
}

/// Puts the start values that may be chosen into the domain: those of the row that is nearest.
pub fn start_among(rows: &Rows, cover: &Cover, inputs: &mut [Input], is_free: impl Fn(&Input) -> bool) {
    let start: Vec<f64> = inputs.iter().map(|input| input.start).collect();
    let domain = Domain::new(inputs, &[]).near(cover, inputs);
    if domain.contains_point(&start, 0) {
        return;
    }
    let inside = rows.iter().filter(|row| domain.contains_point(row, 0));
    let distances = inside.map(|row| (row, distance(row, &start, cover, inputs)));
    let Some((row, _)) = distances.min_by(|(_, a), (_, b)| a.total_cmp(b)) else {
        return;
    };
    for column in cover.columns.iter().map(|column| *column as usize) {
        if is_free(&inputs[column]) {
            inputs[column].start = row[column].clamp(inputs[column].min, inputs[column].max);
        }
    }
}

/// The largest difference of two rows in a column of a cover, relative to its range.
fn distance(row: &[f64], other: &[f64], cover: &Cover, inputs: &[Input]) -> f64 {
    cover
        .columns
        .iter()
        .map(|&column| {
            let Input { min, max, .. } = inputs[column as usize];
            (row[column as usize] - other[column as usize]).abs() / (max - min)
        })
        .fold(0.0, f64::max)
}

/// Rows by columns, so that the distances of all of them from a row are computed at once.
struct RowMatrix {
    columns: Vec<Vec<f32>>,
}

impl RowMatrix {
    fn new(rows: &[Vec<f32>]) -> Self {
        Self { columns: (0..rows[0].len()).map(|column| rows.iter().map(|row| row[column]).collect()).collect() }
    }

    /// Distances of the rows from this one: the largest difference of a column.
    fn distances<'a>(&self, row: &[f32], found: &'a mut Vec<f32>) -> &'a [f32] {
        found.clear();
        found.resize(self.columns[0].len(), 0.0);
        for (column, value) in self.columns.iter().zip(row) {
            for (found, other) in found.iter_mut().zip(column) {
                let difference = (other - value).abs();
                *found = if difference > *found { difference } else { *found };
            }
        }
        found
    }

    /// Distance from the nearest of the rows.
    fn nearest(&self, row: &[f32], found: &mut Vec<f32>) -> f32 {
        let mut least = [f32::INFINITY; 8];
        let (blocks, rest) = self.distances(row, found).as_chunks::<8>();
        for block in blocks {
            for (least, found) in least.iter_mut().zip(block) {
                *least = if found < least { *found } else { *least };
            }
        }
        least.iter().chain(rest).copied().fold(f32::INFINITY, f32::min)
    }
}

/// Rows that are farthest from each other, until all are that near to one of them, or there are enough.
fn centres(rows: &[Vec<f32>], near: f32) -> Vec<Vec<f32>> {
    let table = RowMatrix::new(rows);
    let mut centres = vec![rows[0].clone()];
    let mut distances = Vec::new();
    table.distances(&rows[0], &mut distances);
    let mut from_centre = Vec::new();
    while centres.len() < CUBES {
        let (farthest, largest) = distances
            .iter()
            .enumerate()
            .fold((0, 0.0), |best, (row, &found)| if found > best.1 { (row, found) } else { best });
        if largest <= near {
            break;
        }
        for (found, distance) in distances.iter_mut().zip(table.distances(&rows[farthest], &mut from_centre)) {
            *found = found.min(*distance);
        }
        centres.push(rows[farthest].clone());
    }
    centres
}

/// The distance that the share of further rows does not exceed, by the distances of some rows from others.
fn gap(some: &[Vec<f32>], others: &[Vec<f32>]) -> f32 {
    let mut distances = nearest(some, &RowMatrix::new(others));
    distances.sort_by(f32::total_cmp);
    let rank = ((distances.len() + 1) as f64 * SHARE).ceil() as usize;
    distances[rank.clamp(1, distances.len()) - 1]
}

/// Distance of each row from the nearest of others.
fn nearest(rows: &[Vec<f32>], others: &RowMatrix) -> Vec<f32> {
    rows.par_iter().map_init(Vec::new, |found, row| others.nearest(row, found)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Encoding, Role};

    fn inputs(count: usize) -> Vec<Input> {
        let input = |column| Input {
            name: format!("x{column}"),
            role: Role::Input,
            unit: String::new(),
            description: String::new(),
            min: -1.0,
            max: 1.0,
            start: 0.0,
            encoding: Encoding::Plain,
        };
        (0..count).map(input).collect()
    }

    /// Points on a circle, within so much of it.
    fn ring(count: usize, width: f64, seed: u64) -> Rows {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut point = || {
            let (angle, radius) =
                (std::f64::consts::TAU * random.random::<f64>(), 1.0 - width * random.random::<f64>());
            vec![radius * angle.cos(), radius * angle.sin()]
        };
        (0..count).map(|_| point()).collect()
    }

    fn is_inside(cover: &Cover, inputs: &[Input], row: &[f64]) -> bool {
        Domain::new(inputs, &[]).near(cover, inputs).contains_point(row, 0)
    }

    #[test]
    fn all_rows_are_inside_and_of_further_ones_nearly_all() {
        let inputs = inputs(2);
        // few rows make large cubes
        for (count, width) in [(60, 0.0), (500, 0.1), (5000, 0.2)] {
            let rows = ring(count, width, 2);
            let cover = of_rows(&rows, &inputs).unwrap();
            assert!(rows.iter().all(|row| is_inside(&cover, &inputs, row)), "{count}");
            let further = ring(4000, width, 3);
            let share = further.iter().filter(|row| is_inside(&cover, &inputs, row)).count() as f64 / 4000.0;
            assert!(share >= 0.98, "{count}: {share}");
            assert!(!is_inside(&cover, &inputs, &[0.0, 0.0]), "{count}: the middle has no rows");
            assert!(count < 100 || !is_inside(&cover, &inputs, &[1.0, -1.0]), "{count}: nor have the corners");
            assert!(cover.centres.len() <= 2 * CUBES);
        }
    }

    #[test]
    fn rows_that_fill_the_ranges_need_no_cover() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        for columns in [1, 2, 5] {
            let mut row = || (0..columns).map(|_| 2.0 * random.random::<f64>() - 1.0).collect::<Vec<_>>();
            let rows: Rows = (0..2000).map(|_| row()).collect();
            assert_eq!(of_rows(&rows, &inputs(columns)), None, "{columns}");
        }
        let grid: Rows = (0..25).map(|k| vec![0.5 * f64::from(k / 5) - 1.0, 0.5 * f64::from(k % 5) - 1.0]).collect();
        assert_eq!(of_rows(&grid, &inputs(2)), None);
    }

    #[test]
    fn few_rows_equal_rows_and_constants_make_none() {
        let mut inputs = inputs(2);
        assert_eq!(of_rows(&Rows::from_iter([[0.5, 0.5]]), &inputs), None);
        assert_eq!(of_rows(&Rows::from_iter([[0.5, 0.5]; 9]), &inputs), None);
        for input in &mut inputs {
            (input.min, input.max) = (0.5, 0.5);
        }
        assert_eq!(of_rows(&ring(50, 0.1, 1), &inputs), None);
    }

    #[test]
    fn a_gap_between_rows_of_one_column_is_outside() {
        let rows: Rows =
            (0..200).map(|k| vec![if k < 100 { -1.0 } else { 0.8 } + 0.002 * f64::from(k % 100)]).collect();
        let mut inputs = inputs(1);
        let cover = of_rows(&rows, &inputs).unwrap();
        for (value, expected) in [(-0.9, true), (0.0, false), (0.9, true)] {
            assert_eq!(is_inside(&cover, &inputs, &[value]), expected, "{value}");
        }
        start_among(&rows, &cover, &mut inputs, |_| false);
        assert_eq!(inputs[0].start, 0.0);
        start_among(&rows, &cover, &mut inputs, |_| true);
        assert!((inputs[0].start - 0.8).abs() < 1e-9, "{}", inputs[0].start);
    }
}
