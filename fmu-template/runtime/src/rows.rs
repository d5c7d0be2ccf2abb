//! Rows of numbers.

use std::ops::{Index, IndexMut, Range};

/// Rows of numbers, all of the same width, one behind the other in memory: shape `[rows, width]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    width: usize,
    /// Rows may be empty, so their number does not follow from that of the values.
    count: usize,
    values: Vec<f64>,
}

impl Rows {
    /// Rows of zeros.
    pub fn zeros(width: usize, count: usize) -> Self {
        Self { width, count, values: vec![0.0; width * count] }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns true if there are no rows.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Numbers in a row; that of the first row pushed.
    pub fn width(&self) -> usize {
        self.width
    }

    /// All numbers, row by row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// All numbers, row by row.
    pub fn into_values(self) -> Vec<f64> {
        self.values
    }

    /// Iterator over the rows.
    pub fn iter(&self) -> RowsIter<'_> {
        RowsIter { rows: self, range: 0..self.count }
    }

    /// Returns true if one of the rows has these numbers.
    pub fn contains(&self, row: &[f64]) -> bool {
        self.iter().any(|other| other == row)
    }

    /// Iterator over the numbers of a column.
    pub fn column(&self, column: usize) -> impl Iterator<Item = f64> + Clone {
        self.iter().map(move |row| row[column])
    }

    /// Largest magnitude in a column; zero without rows.
    pub fn largest_magnitude(&self, column: usize) -> f64 {
        self.column(column).map(f64::abs).fold(0.0, f64::max)
    }

    /// Some of the rows.
    #[must_use]
    pub fn part(&self, range: Range<usize>) -> Self {
        let values = self.values[range.start * self.width..range.end * self.width].to_vec();
        Self { width: self.width, count: range.len(), values }
    }

    /// Rows of these numbers, in this order.
    #[must_use]
    pub fn pick(&self, rows: &[usize]) -> Self {
        Self { width: self.width, ..rows.iter().map(|row| &self[*row]).collect() }
    }

    /// Some of the columns, in this order.
    #[must_use]
    pub fn select(&self, columns: &[usize]) -> Self {
        let values = self.iter().flat_map(|row| columns.iter().map(|column| row[*column])).collect();
        Self { width: columns.len(), count: self.count, values }
    }

    /// Appends a row.
    ///
    /// # Panics
    /// If its width is not that of the others.
    pub fn push(&mut self, row: &[f64]) {
        if self.count == 0 {
            self.width = row.len();
        }
        assert_eq!(row.len(), self.width, "width of a row");
        self.values.extend_from_slice(row);
        self.count += 1;
    }
}

impl Index<usize> for Rows {
    type Output = [f64];

    fn index(&self, row: usize) -> &[f64] {
        assert!(row < self.count, "row {row} of {}", self.count);
        &self.values[row * self.width..(row + 1) * self.width]
    }
}

impl IndexMut<usize> for Rows {
    fn index_mut(&mut self, row: usize) -> &mut [f64] {
        assert!(row < self.count, "row {row} of {}", self.count);
        &mut self.values[row * self.width..(row + 1) * self.width]
    }
}

impl<R: AsRef<[f64]>> Extend<R> for Rows {
    fn extend<I: IntoIterator<Item = R>>(&mut self, rows: I) {
        rows.into_iter().for_each(|row| self.push(row.as_ref()));
    }
}

impl<R: AsRef<[f64]>> FromIterator<R> for Rows {
    fn from_iter<I: IntoIterator<Item = R>>(rows: I) -> Self {
        let mut collected = Self::default();
        collected.extend(rows);
        collected
    }
}

impl<'a> IntoIterator for &'a Rows {
    type Item = &'a [f64];
    type IntoIter = RowsIter<'a>;

    fn into_iter(self) -> RowsIter<'a> {
        self.iter()
    }
}

/// Iterator over [`Rows`].
#[derive(Clone, Debug)]
pub struct RowsIter<'a> {
    rows: &'a Rows,
    range: Range<usize>,
}

impl<'a> Iterator for RowsIter<'a> {
    type Item = &'a [f64];

    fn next(&mut self) -> Option<&'a [f64]> {
        self.range.next().map(|row| &self.rows[row])
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.range.size_hint()
    }
}

impl DoubleEndedIterator for RowsIter<'_> {
    fn next_back(&mut self) -> Option<Self::Item> {
        self.range.next_back().map(|row| &self.rows[row])
    }
}

impl ExactSizeIterator for RowsIter<'_> {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_keep_their_order_and_their_number_even_if_they_are_empty() {
        let rows: Rows = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]].into_iter().collect();
        assert_eq!((rows.len(), rows.width()), (3, 2));
        assert_eq!(rows[1], [3.0, 4.0]);
        assert_eq!(rows.column(1).collect::<Vec<_>>(), [2.0, 4.0, 6.0]);
        assert_eq!(Rows::from_iter([[1.0], [-3.0], [2.0]]).largest_magnitude(0), 3.0);
        assert_eq!(rows.part(1..3).values(), [3.0, 4.0, 5.0, 6.0]);
        assert_eq!(rows.pick(&[2, 0]).values(), [5.0, 6.0, 1.0, 2.0]);
        assert_eq!(rows.select(&[1, 0, 1])[2], [6.0, 5.0, 6.0]);
        let empty: Rows = [[0.0; 0]; 4].into_iter().collect();
        assert_eq!(empty.iter().map(<[f64]>::len).collect::<Vec<_>>(), [0; 4]);
    }

    #[test]
    #[should_panic = "width of a row"]
    fn rows_of_different_widths_are_refused() {
        Rows::from_iter([vec![1.0, 2.0], vec![3.0]]);
    }
}
