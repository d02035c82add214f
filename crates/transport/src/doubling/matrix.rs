//! Dense matrices: what adding and doubling need, and no more.

use std::ops::{AddAssign, Index, IndexMut, Range};

use super::product::{Block, product};

/// A matrix of f64, stored column by column.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    values: Vec<f64>,
    rows: usize,
    columns: usize,
}

impl Matrix {
    pub(super) fn zeros(rows: usize, columns: usize) -> Self {
        Self { values: vec![0.0; rows * columns], rows, columns }
    }

    pub(super) fn identity(n: usize) -> Self {
        Self::from_fn(n, n, |i, j| f64::from(u8::from(i == j)))
    }

    /// The matrix of `value(i, j)`.
    #[must_use]
    pub fn from_fn(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let mut values = Vec::with_capacity(rows * columns);
        for j in 0..columns {
            values.extend((0..rows).map(|i| value(i, j)));
        }
        Self { values, rows, columns }
    }

    pub(super) fn from_columns<'a>(rows: usize, columns: impl Iterator<Item = &'a [f64]>) -> Self {
        let mut values = Vec::with_capacity(rows * columns.size_hint().0);
        let mut count = 0;
        for column in columns {
            assert_eq!(column.len(), rows, "columns of one length");
            values.extend_from_slice(column);
            count += 1;
        }
        Self { values, rows, columns: count }
    }

    /// The number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// All values, column by column.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The values of column j.
    ///
    /// # Panics
    /// If there is no such column.
    #[must_use]
    pub fn column(&self, j: usize) -> &[f64] {
        assert!(j < self.columns, "column {j} of {}", self.columns);
        &self.values[j * self.rows..][..self.rows]
    }

    pub(super) fn column_mut(&mut self, j: usize) -> &mut [f64] {
        assert!(j < self.columns, "column {j} of {}", self.columns);
        &mut self.values[j * self.rows..][..self.rows]
    }

    pub(super) fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    pub(super) fn block(&self) -> Block<'_> {
        Block::new(&self.values, self.rows, self.columns)
    }

    /// A copy of a part.
    pub(super) fn part(&self, rows: Range<usize>, columns: Range<usize>) -> Self {
        Self::from_columns(rows.len(), columns.map(|j| &self.column(j)[rows.clone()]))
    }

    pub(super) fn transposed(&self) -> Self {
        Self::from_fn(self.columns, self.rows, |i, j| self[(j, i)])
    }

    /// f of every value.
    pub(super) fn map(mut self, f: impl Fn(f64) -> f64) -> Self {
        self.values.iter_mut().for_each(|value| *value = f(*value));
        self
    }

    /// f of every value and of the other matrix's value in the same place.
    pub(super) fn with(mut self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        assert_eq!((self.rows, self.columns), (other.rows, other.columns), "matrices of one shape");
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a = f(*a, *b));
        self
    }

    /// self·b, on this thread.
    ///
    /// # Panics
    /// If b has not as many rows as self has columns.
    #[must_use]
    pub fn times(&self, b: &Self) -> Self {
        let mut all = Self::zeros(self.rows, b.columns);
        product(&mut all.values, self.rows, false, 1.0, self.block(), b.block());
        all
    }

    /// self += a·b, on this thread.
    pub(super) fn add_product(&mut self, a: &Self, b: &Self) {
        assert_eq!((self.rows, self.columns), (a.rows, b.columns), "room for the product");
        product(&mut self.values, self.rows, true, 1.0, a.block(), b.block());
    }
}

impl Index<(usize, usize)> for Matrix {
    type Output = f64;

    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        &self.column(j)[i]
    }
}

impl IndexMut<(usize, usize)> for Matrix {
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        &mut self.column_mut(j)[i]
    }
}

impl AddAssign<&Self> for Matrix {
    fn add_assign(&mut self, other: &Self) {
        assert_eq!((self.rows, self.columns), (other.rows, other.columns), "matrices of one shape");
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a += b);
    }
}

/// Sum of a column, as eight sums of every eighth value: faster than one, and with less rounding.
pub(super) fn sum(values: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    for values in values.chunks(8) {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sums.iter().sum()
}
