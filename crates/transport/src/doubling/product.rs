//! Products of matrices, or of parts of them, on this thread.

use std::ops::Range;

/// A rectangle of values to read: value (i, k) lies at i·`row_step` + k·`column_step`, inside `values`.
#[derive(Clone, Copy)]
pub(super) struct Block<'a> {
    values: &'a [f64],
    rows: usize,
    columns: usize,
    row_step: usize,
    column_step: usize,
}

impl<'a> Block<'a> {
    /// `rows` × `columns` values stored column by column.
    pub(super) fn new(values: &'a [f64], rows: usize, columns: usize) -> Self {
        assert!(fits(rows, columns, rows, values), "{rows} × {columns} of {} values", values.len());
        Self { values, rows, columns, row_step: 1, column_step: rows }
    }

    pub(super) fn transposed(self) -> Self {
        let Self { values, rows, columns, row_step, column_step } = self;
        Self { values, rows: columns, columns: rows, row_step: column_step, column_step: row_step }
    }

    pub(super) fn part(self, rows: Range<usize>, columns: Range<usize>) -> Self {
        assert!(rows.end <= self.rows && columns.end <= self.columns, "a part of the block");
        let first = rows.start * self.row_step + columns.start * self.column_step;
        // A part without values may start behind the last one.
        let values = self.values.get(first..).unwrap_or_default();
        Self { values, rows: rows.len(), columns: columns.len(), ..self }
    }
}

/// Whether columns of some rows, `stride` apart, lie inside the values.
fn fits(rows: usize, columns: usize, stride: usize, values: &[f64]) -> bool {
    let end = columns.saturating_sub(1).checked_mul(stride).and_then(|last| last.checked_add(rows));
    end.is_some_and(|end| end <= values.len())
}

/// c := factor·a·b, or c += factor·a·b where `add` says so. Column j of c starts at j·`stride`.
///
/// # Panics
/// If the shapes do not match.
#[allow(unsafe_code)] // The product takes a tenth of the time of loops in safe Rust.
pub(super) fn product(c: &mut [f64], stride: usize, add: bool, factor: f64, a: Block<'_>, b: Block<'_>) {
    let (rows, terms, columns) = (a.rows, a.columns, b.columns);
    assert_eq!(terms, b.rows, "as many rows of b as columns of a");
    if rows == 0 || columns == 0 {
        return;
    }
    assert!(rows <= stride && fits(rows, columns, stride, c), "room for the product");
    let gemm = gemm_f64::gemm::f64::get_gemm_fn();
    let step = |step: usize| isize::try_from(step).expect("a step inside a slice");
    let (kept, serial) = (f64::from(u8::from(add)), gemm_common::Parallelism::None);
    // SAFETY: the rectangle written lies inside c (asserted above), the rectangles read inside `a.values` and `b.values`
    // (what `Block` promises); c is borrowed alone, so that they do not overlap.
    unsafe {
        gemm(
            rows,
            columns,
            terms,
            c.as_mut_ptr(),
            step(stride),
            1,
            add,
            a.values.as_ptr(),
            step(a.column_step),
            step(a.row_step),
            b.values.as_ptr(),
            step(b.column_step),
            step(b.row_step),
            kept,
            factor,
            false,
            false,
            false,
            serial,
        );
    }
}
