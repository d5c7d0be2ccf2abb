//! Layout of a row: its columns, the column of time, and the encodings. The order of columns is defined here only.
//!
//! The inputs of a surrogate are the parameters in order, then the time. A row of a model has the columns that the
//! inputs become by their encodings. A row of a model for a single time point has no time.

use crate::dataset::Run;
use metafmu_runtime::Encoder;
use std::iter;

/// Parameters and the time in the order of a surrogate's inputs.
pub fn inputs<T>(parameters: impl IntoIterator<Item = T>, time: T) -> impl Iterator<Item = T> {
    parameters.into_iter().chain(iter::once(time))
}

/// The values of a surrogate's inputs in a run.
#[derive(Clone, Debug)]
pub struct InputPoint {
    values: Vec<f64>,
    has_time: bool,
}

impl InputPoint {
    /// The parameters of a run, at the time 0 if that is an input.
    pub fn of(run: &Run, has_time: bool) -> Self {
        let parameters = run.parameters.iter().copied();
        let values = if has_time { inputs(parameters, 0.0).collect() } else { parameters.collect() };
        Self { values, has_time }
    }

    /// The point at a time in seconds.
    pub fn at(&mut self, time: f64) -> &[f64] {
        if let Some(last) = self.values.last_mut().filter(|_| self.has_time) {
            *last = time;
        }
        &self.values
    }
}

/// The rows of runs that a model learns, and their columns.
#[derive(Clone, Debug)]
pub struct RowLayout {
    /// Encoder of the parameters.
    encoder: Encoder,
    rows: RowSelection,
}

#[derive(Clone, Copy, Debug)]
enum RowSelection {
    All,
    /// That with this number of each run.
    At(usize),
}

impl RowLayout {
    /// All rows, with the time as a column; `encoder`: that of the parameters.
    pub fn new(encoder: Encoder) -> Self {
        Self { encoder, rows: RowSelection::All }
    }

    /// One row of each run, counted from 0, without the time.
    pub fn at(encoder: Encoder, row: usize) -> Self {
        Self { encoder, rows: RowSelection::At(row) }
    }

    /// Number of input columns.
    pub fn columns(&self) -> usize {
        match self.rows {
            RowSelection::All => self.encoder.width() + 1,
            RowSelection::At(_) => self.encoder.width(),
        }
    }

    /// Calls `each` with the input columns and the outputs of every row of a run.
    pub fn for_each<'a>(&self, run: &'a Run, mut each: impl FnMut(&[f64], &'a [f64])) {
        let mut columns = vec![0.0; self.columns()];
        let width = self.encoder.width();
        self.encoder.encode(&run.parameters, &mut columns[..width]);
        match self.rows {
            RowSelection::At(row) => run.rows().skip(row).take(1).for_each(|(_, outputs)| each(&columns, outputs)),
            RowSelection::All => {
                for (time, outputs) in run.rows() {
                    columns[width] = time;
                    each(&columns, outputs);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::Encoding;

    #[test]
    fn rows_are_encoded_parameters_then_the_time_or_without_it() {
        let nominal = Encoding::Nominal(vec![3.0, 1.0]);
        let encoder = Encoder::new([(&Encoding::Plain, 0.0, 1.0), (&nominal, 1.0, 3.0)].into_iter());
        let run =
            Run { inputs: Vec::new(), parameters: vec![0.5, 1.0], times: [0.0, 2.0].into(), outputs: vec![7.0, 8.0] };
        let rows = |layout: &RowLayout| {
            let mut rows = Vec::new();
            layout.for_each(&run, |columns, outputs| rows.push((columns.to_vec(), outputs.to_vec())));
            rows
        };
        let all = RowLayout::new(encoder.clone());
        assert_eq!(all.columns(), 4);
        assert_eq!(rows(&all), [(vec![0.5, 0.0, 1.0, 0.0], vec![7.0]), (vec![0.5, 0.0, 1.0, 2.0], vec![8.0])]);
        let second = RowLayout::at(encoder, 1);
        assert_eq!(second.columns(), 3);
        assert_eq!(rows(&second), [(vec![0.5, 0.0, 1.0], vec![8.0])]);
        assert_eq!(InputPoint::of(&run, true).at(2.0), [0.5, 1.0, 2.0]);
        assert_eq!(InputPoint::of(&run, false).at(2.0), [0.5, 1.0]);
        assert_eq!(inputs(["a", "b"], "time").collect::<Vec<_>>(), ["a", "b", "time"]);
    }
}
