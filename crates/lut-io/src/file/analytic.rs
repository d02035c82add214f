//! The analytic reflection distribution: the exponential of a polynomial.
//!
//! Over the cells of one incidence, with x from −1 to 1 along the columns and y from 0 to 1 along φ (both in cell position,
//! so that the mirror direction is at x = 0 and the horizon at x = 1 at every incidence),
//!
//! f·cos θo = exp(Σₖ cₖ·T_m(x)·T_2n(y)),  (m, n) = termₖ,  T the Chebyshev polynomials;
//!
//! in decay tables n = 0. Even polynomials in y, as lobes are even in φ.

use crate::model::axis::ExitAxis;
use crate::model::compaction::Term;

/// Chebyshev polynomials of every cell position along both axes.
pub(crate) struct Basis {
    /// T_m(x) by column, then order.
    pub(crate) columns: Vec<Vec<f64>>,
    /// T_2n(y) by row, then n.
    pub(crate) rows: Vec<Vec<f64>>,
}

impl Basis {
    pub(crate) fn new(axis: &ExitAxis, terms: &[Term]) -> Self {
        let (most_m, most_n) = terms.iter().fold((0, 0), |most, t| (most.0.max(t.0), most.1.max(t.1)));
        let (columns, rows) = (axis.columns(), axis.rows_per_incidence());
        let centre = |k: usize, count: usize| (k as f64 + 0.5) / count as f64;
        Self {
            columns: (0..columns)
                .map(|k| chebyshev(2.0 * centre(k, columns) - 1.0, usize::from(most_m)))
                .collect(),
            rows: (0..rows)
                .map(|k| chebyshev(centre(k, rows), 2 * usize::from(most_n)).into_iter().step_by(2).collect())
                .collect(),
        }
    }
}

/// T_0(x) … T_order(x).
fn chebyshev(x: f64, order: usize) -> Vec<f64> {
    let mut t = vec![1.0, x];
    for n in 2..=order {
        t.push(2.0 * x * t[n - 1] - t[n - 2]);
    }
    t.truncate(order + 1);
    t
}

/// Values of one incidence's cells, φ-major.
pub(crate) fn values(axis: &ExitAxis, terms: &[Term], coefficients: &[f32]) -> Vec<f32> {
    let basis = Basis::new(axis, terms);
    let mut values = Vec::with_capacity(axis.cells());
    for row in &basis.rows {
        // Along a row of cells the polynomial depends on x alone.
        let mut along = vec![0.0; basis.columns[0].len()];
        for (term, c) in terms.iter().zip(coefficients) {
            along[usize::from(term.0)] += f64::from(*c) * row[usize::from(term.1)];
        }
        let exponent = |column: &Vec<f64>| column.iter().zip(&along).map(|(t, c)| t * c).sum::<f64>();
        values.extend(basis.columns.iter().map(|column| exponent(column).exp() as f32));
    }
    values
}
