//! LU factors and solves by blocks, so that nearly all of the work is products of matrices.

use std::ops::Range;

use super::matrix::Matrix;
use super::product::{Block, product};

/// Rows and columns of a block of a solve: a multiple of what the kernels of the product hold in registers.
const BLOCK: usize = 24;
/// Columns that are eliminated one by one.
const LEAF: usize = 6;

/// The factors P·A = L·U of a square matrix, with partial pivoting.
pub(super) struct Lu {
    /// U, and below its diagonal L without its own, which is 1.
    factors: Matrix,
    /// The row that step j exchanged with row j.
    pivots: Vec<usize>,
    /// Inverses of the blocks on the diagonals of L and of U.
    inverses: Vec<(Matrix, Matrix)>,
}

impl Lu {
    pub(super) fn new(mut a: Matrix) -> Self {
        let n = a.rows();
        assert_eq!(n, a.columns(), "LU of a square matrix");
        let mut pivots = vec![0; n];
        let lower = factor(&mut a, &mut pivots, 0..n, &[BLOCK, LEAF]);
        let upper = blocks(0..n, BLOCK).map(|block| upper_inverse(&a, &block));
        Self { inverses: lower.into_iter().zip(upper).collect(), factors: a, pivots }
    }

    /// x := A⁻¹x.
    pub(super) fn solve(&self, x: &mut Matrix) {
        let (n, columns) = (x.rows(), x.columns());
        if columns == 0 {
            return;
        }
        exchange(x, 0..columns, &self.pivots, 0..n);
        let mut y = Matrix::zeros(n, columns);
        let blocks: Vec<_> = blocks(0..n, BLOCK).zip(&self.inverses).collect();
        for (block, (lower, _)) in &blocks {
            self.solve_block(x, &mut y, 0..block.start, block, lower);
        }
        for (block, (_, upper)) in blocks.iter().rev() {
            self.solve_block(&mut y, x, block.end..n, block, upper);
        }
    }

    /// Rows of the solution of one triangle, from its right side and the rows that are `known`.
    fn solve_block(
        &self,
        right: &mut Matrix,
        solution: &mut Matrix,
        known: Range<usize>,
        block: &Range<usize>,
        inverse: &Matrix,
    ) {
        let (n, all) = (right.rows(), 0..right.columns());
        let factors = self.factors.block().part(block.clone(), known.clone());
        let solved = solution.block().part(known, all.clone());
        product(&mut right.values_mut()[block.start..], n, true, -1.0, factors, solved);
        let right = right.block().part(block.clone(), all);
        product(&mut solution.values_mut()[block.start..], n, false, 1.0, inverse.block(), right);
    }
}

fn blocks(range: Range<usize>, size: usize) -> impl Iterator<Item = Range<usize>> {
    range.clone().step_by(size).map(move |start| start..range.end.min(start + size))
}

/// Exchanges row j and the row `pivots[j]` of some columns, for each of the steps j in turn.
fn exchange(a: &mut Matrix, columns: impl IntoIterator<Item = usize>, pivots: &[usize], steps: Range<usize>) {
    for column in columns {
        let column = a.column_mut(column);
        steps.clone().for_each(|j| column.swap(j, pivots[j]));
    }
}

/// Factors some columns, whose rows above the first pivot are done, by blocks of the first size, those by blocks of the
/// next one. Returns the inverses of the blocks on the diagonal of L.
fn factor(a: &mut Matrix, pivots: &mut [usize], columns: Range<usize>, sizes: &[usize]) -> Vec<Matrix> {
    let Some((&size, finer)) = sizes.split_first() else {
        factor_one_by_one(a, pivots, columns);
        return Vec::new();
    };
    let n = a.rows();
    let mut inverses = Vec::new();
    for block in blocks(columns.clone(), size) {
        factor(a, pivots, block.clone(), finer);
        exchange(a, (columns.start..block.start).chain(block.end..columns.end), pivots, block.clone());
        let count = columns.end - block.end;
        let inverse = lower_inverse(a, &block);
        if count == 0 {
            inverses.push(inverse);
            break;
        }
        let (left, right) = a.values_mut()[..columns.end * n].split_at_mut(block.end * n);
        let mut top = Matrix::zeros(block.len(), count);
        let old = Block::new(right, n, count).part(block.clone(), 0..count);
        product(top.values_mut(), block.len(), false, 1.0, inverse.block(), old);
        for (j, column) in right.chunks_exact_mut(n).enumerate() {
            column[block.clone()].copy_from_slice(top.column(j));
        }
        let below = Block::new(left, n, block.end).part(block.end..n, block.clone());
        product(&mut right[block.end..], n, true, -1.0, below, top.block());
        inverses.push(inverse);
    }
    inverses
}

fn factor_one_by_one(a: &mut Matrix, pivots: &mut [usize], columns: Range<usize>) {
    let n = a.rows();
    for j in columns.clone() {
        let (mut pivot, mut largest) = (j, 0.0);
        for (i, value) in a.column(j).iter().enumerate().skip(j) {
            if value.abs() > largest {
                (pivot, largest) = (i, value.abs());
            }
        }
        pivots[j] = pivot;
        exchange(a, columns.clone(), pivots, j..j + 1);
        let (left, right) = a.values_mut()[..columns.end * n].split_at_mut((j + 1) * n);
        let column = &mut left[j * n + j..];
        let inverse = 1.0 / column[0];
        column[1..].iter_mut().for_each(|value| *value *= inverse);
        for values in right.chunks_exact_mut(n) {
            let factor = values[j];
            values[j + 1..].iter_mut().zip(&column[1..]).for_each(|(value, l)| *value -= l * factor);
        }
    }
}

/// The inverse of the lower triangle of a block on the diagonal, with ones on its own.
fn lower_inverse(a: &Matrix, block: &Range<usize>) -> Matrix {
    let mut inverse = Matrix::identity(block.len());
    for j in 0..block.len() {
        let x = inverse.column_mut(j);
        for k in j..block.len() {
            let known = x[k];
            let below = &a.column(block.start + k)[block.clone()][k + 1..];
            x[k + 1..].iter_mut().zip(below).for_each(|(x, l)| *x -= l * known);
        }
    }
    inverse
}

/// The inverse of the upper triangle of a block on the diagonal.
fn upper_inverse(a: &Matrix, block: &Range<usize>) -> Matrix {
    let mut inverse = Matrix::identity(block.len());
    for j in 0..block.len() {
        let x = inverse.column_mut(j);
        for k in (0..=j).rev() {
            let column = &a.column(block.start + k)[block.clone()];
            x[k] /= column[k];
            let known = x[k];
            x[..k].iter_mut().zip(column).for_each(|(x, u)| *x -= u * known);
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Gaussian elimination row by row, with the largest pivot.
    fn naive(a: &Matrix, b: &Matrix) -> Matrix {
        let (n, columns) = (a.rows(), b.columns());
        let mut rows: Vec<Vec<f64>> = (0..n)
            .map(|i| (0..n).map(|j| a[(i, j)]).chain((0..columns).map(|j| b[(i, j)])).collect())
            .collect();
        for j in 0..n {
            let pivot = (j..n).max_by(|&p, &q| rows[p][j].abs().total_cmp(&rows[q][j].abs())).unwrap();
            rows.swap(j, pivot);
            let done = rows[j].clone();
            for (_, row) in rows.iter_mut().enumerate().filter(|(i, _)| *i != j) {
                let factor = row[j] / done[j];
                row.iter_mut().zip(&done).for_each(|(value, done)| *value -= factor * done);
            }
        }
        Matrix::from_fn(n, columns, |i, j| rows[i][n + j] / rows[i][i])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn solves_agree_with_naive_elimination(n in 1_usize..130, columns in 0_usize..30, seed: u64) {
            let value = |place: usize| {
                let mixed = (seed ^ place as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(31);
                mixed.wrapping_mul(0xd6e8_feb8_6659_fd93) as f64 / u64::MAX as f64 - 0.5
            };
            // A dominant diagonal in an order of its own: well conditioned, but nothing without exchanges of rows.
            let a = Matrix::from_fn(n, n, |i, j| {
                value(i * n + j) + if (i + n / 2) % n == j { n as f64 } else { 0.0 }
            });
            let b = Matrix::from_fn(n, columns, |i, j| value(n * n + i * columns + j));
            let mut x = b.clone();
            Lu::new(a.clone()).solve(&mut x);
            let truth = naive(&a, &b);
            let apart = x.with(&truth, |x, truth| (x - truth).abs());
            let worst = (0..columns).flat_map(|j| apart.column(j)).fold(0.0_f64, |worst, x| worst.max(*x));
            prop_assert!(worst < 1e-14 , "{worst} {n} {columns}"); // solutions are about 1/n
        }
    }
}
