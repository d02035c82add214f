//! Slabs and the adding equations, one azimuthal mode at a time.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatRef, Par};

use super::facets::Fate;
use super::kernel::Column;

/// a·b on this thread.
pub(super) fn times(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut product = Mat::zeros(a.nrows(), b.ncols());
    matmul(product.as_mut(), Accum::Replace, a, b, 1.0, Par::Seq);
    product
}

/// c += a·b on this thread.
pub(super) fn add_times(c: &mut Mat<f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    matmul(c.as_mut(), Accum::Add, a, b, 1.0, Par::Seq);
}

/// (I − a)⁻¹ b.
pub(super) fn resolvent(mut a: Mat<f64>, mut b: Mat<f64>) -> Mat<f64> {
    identity_minus(&mut a);
    a.partial_piv_lu().solve_in_place(b.as_mut());
    b
}

/// [`resolvent`] with one step of iterative refinement, for the last solve: I − R₁R₂ is nearly singular under a thick
/// lossless body, and the energy balance should keep its last digits.
pub(super) fn refined_resolvent(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let mut matrix = a.clone();
    identity_minus(&mut matrix);
    let factors = matrix.partial_piv_lu();
    let mut x = b.clone();
    factors.solve_in_place(x.as_mut());
    let mut residual = b - times(matrix.as_ref(), x.as_ref());
    factors.solve_in_place(residual.as_mut());
    x + residual
}

/// Takes rounding out of the energy balance of a lossless slab: every column of R + T sums to 1 in exact arithmetic,
/// and each doubling would double what the solve with the nearly singular I − R left.
fn conserve(r: &mut Mat<f64>, t: &mut Mat<f64>) {
    for i in 0..r.ncols() {
        let (up, down): (f64, f64) = (r.col(i).sum(), t.col(i).sum());
        let excess = up + down - 1.0;
        let (larger, sum) = if up > down { (r.as_mut(), up) } else { (t.as_mut(), down) };
        larger.col_mut(i).iter_mut().for_each(|value| *value *= 1.0 - excess / sum);
    }
}

fn identity_minus(a: &mut Mat<f64>) {
    for j in 0..a.ncols() {
        for value in a.col_mut(j).iter_mut() {
            *value = -*value;
        }
        a[(j, j)] += 1.0;
    }
}

/// Reflection and transmission of a slab from above (R, T) and from below (R′, T′). Columns are incident nodes.
#[derive(Clone, Debug)]
pub(super) struct Slab {
    pub(super) r: Mat<f64>,
    pub(super) t: Mat<f64>,
    pub(super) r_below: Mat<f64>,
    pub(super) t_below: Mat<f64>,
}

impl Slab {
    /// No interface at all.
    pub(super) fn nothing(n: usize) -> Self {
        Self {
            r: Mat::zeros(n, n),
            t: Mat::identity(n, n),
            r_below: Mat::zeros(n, n),
            t_below: Mat::identity(n, n),
        }
    }

    /// The same interface or slab upside down.
    pub(super) fn flipped(&self) -> Self {
        Self {
            r: self.r_below.clone(),
            t: self.t_below.clone(),
            r_below: self.r.clone(),
            t_below: self.t.clone(),
        }
    }

    /// This slab above another one: the adding equations.
    pub(super) fn above(&self, lower: &Self) -> Self {
        let down = resolvent(times(self.r_below.as_ref(), lower.r.as_ref()), self.t.clone());
        let up = resolvent(times(lower.r.as_ref(), self.r_below.as_ref()), lower.t_below.clone());
        let mut r = self.r.clone();
        add_times(&mut r, self.t_below.as_ref(), times(lower.r.as_ref(), down.as_ref()).as_ref());
        let mut r_below = lower.r_below.clone();
        add_times(&mut r_below, lower.t.as_ref(), times(self.r_below.as_ref(), up.as_ref()).as_ref());
        Self {
            r,
            t: times(lower.t.as_ref(), down.as_ref()),
            r_below,
            t_below: times(self.t_below.as_ref(), up.as_ref()),
        }
    }

    /// Absorption in a layer above the slab: `keep` is exp(−τ/|cos θ|) at each node.
    pub(super) fn attenuated_above(mut self, keep: &[f64]) -> Self {
        scale_columns(&mut self.r, keep);
        scale_rows(&mut self.r, keep);
        scale_columns(&mut self.t, keep);
        scale_rows(&mut self.t_below, keep);
        self
    }
}

/// A slab that is its own mirror image: R = R′, T = T′.
#[derive(Clone, Debug)]
pub(super) struct Mirror {
    pub(super) r: Mat<f64>,
    pub(super) t: Mat<f64>,
}

impl Mirror {
    /// Two of it. The sum and the difference of R and T answer light that is even or odd about the middle:
    /// R₂ ± T₂ = R ± T (I ∓ R)⁻¹ T.
    fn doubled(&self) -> Self {
        let even = resolvent(self.r.clone(), self.t.clone());
        let odd = resolvent(-&self.r, self.t.clone());
        let (even, odd) = (times(self.t.as_ref(), even.as_ref()), times(self.t.as_ref(), odd.as_ref()));
        Self { r: &self.r + faer::Scale(0.5) * (&even - &odd), t: faer::Scale(0.5) * (even + odd) }
    }

    /// This above another power of the same cell (they commute, so that the pair is a mirror again).
    fn joined(&self, other: &Self) -> Self {
        let down = resolvent(times(self.r.as_ref(), other.r.as_ref()), self.t.clone());
        let mut r = self.r.clone();
        add_times(&mut r, self.t.as_ref(), times(other.r.as_ref(), down.as_ref()).as_ref());
        Self { r, t: times(other.t.as_ref(), down.as_ref()) }
    }

    /// `count` ≥ 1 of it, by doubling; `lossless` where mode 0 conserves energy.
    pub(super) fn power(self, count: usize, lossless: bool) -> Self {
        let balanced = |mut mirror: Self| {
            if lossless {
                conserve(&mut mirror.r, &mut mirror.t);
            }
            mirror
        };
        repeat(self, count, |one| balanced(one.doubled()), |one, other| balanced(one.joined(other)))
    }
}

impl Slab {
    /// `count` ≥ 1 of it, by doubling; `lossless` where mode 0 conserves energy.
    pub(super) fn power(self, count: usize, lossless: bool) -> Self {
        let balanced = |mut slab: Self| {
            if lossless {
                conserve(&mut slab.r, &mut slab.t);
                conserve(&mut slab.r_below, &mut slab.t_below);
            }
            slab
        };
        repeat(self, count, |one| balanced(one.above(one)), |one, other| balanced(one.above(other)))
    }
}

impl From<Mirror> for Slab {
    fn from(mirror: Mirror) -> Self {
        Self { r_below: mirror.r.clone(), t_below: mirror.t.clone(), r: mirror.r, t: mirror.t }
    }
}

/// Square-and-multiply, from the leading bit down: count − 1 ≤ 2·log₂ products.
fn repeat<S: Clone>(cell: S, count: usize, double: impl Fn(&S) -> S, join: impl Fn(&S, &S) -> S) -> S {
    let mut result = cell.clone();
    for bit in (0..count.max(1).ilog2()).rev() {
        result = double(&result);
        if count >> bit & 1 == 1 {
            result = join(&result, &cell);
        }
    }
    result
}

pub(super) fn scale_columns(a: &mut Mat<f64>, factors: &[f64]) {
    for (j, &factor) in factors.iter().enumerate() {
        a.col_mut(j).iter_mut().for_each(|value| *value *= factor);
    }
}

pub(super) fn scale_rows(a: &mut Mat<f64>, factors: &[f64]) {
    for j in 0..a.ncols() {
        a.col_mut(j).iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
    }
}

/// One interface in one mode, its re-hits resolved: interface = E (I − H)⁻¹.
///
/// States are the incident nodes of the upper side (first n) and of the lower side (last n).
#[derive(Clone, Debug)]
pub(super) struct Resolved {
    /// What leaves after one event: rows upper side away, lower side away.
    once: Mat<f64>,
    /// States that facets send back to the interface, and all visits that follow from one ray there.
    again: Vec<usize>,
    /// H (I − H)⁻¹, columns `again`.
    visits: Mat<f64>,
    /// The same for light that stays on the upper side.
    visits_above: Mat<f64>,
    again_above: usize,
}

impl Resolved {
    pub(super) fn new(from_above: &[Column], from_below: &[Column], mode: usize) -> Self {
        let n = from_above.len();
        let mut once = Mat::zeros(2 * n, 2 * n);
        let mut back = Mat::zeros(2 * n, 2 * n);
        let mut again = Vec::new();
        for (state, column) in from_above.iter().chain(from_below).enumerate() {
            let (near, far) = if state < n { (0, n) } else { (n, 0) };
            let place = |target: &mut Mat<f64>, fate: Fate, row: usize| {
                if let Some(deposit) = column.deposit(fate) {
                    target.col_mut(state).subrows_mut(row, n).copy_from(deposit.col(mode));
                }
            };
            place(&mut once, Fate::Reflected, near);
            place(&mut once, Fate::Refracted, far);
            place(&mut back, Fate::ReflectedBack, near);
            place(&mut back, Fate::RefractedBack, far);
            if column.deposit(Fate::ReflectedBack).is_some() || column.deposit(Fate::RefractedBack).is_some()
            {
                again.push(state);
            }
        }
        let visits = visits(&back, &again, 2 * n);
        let again_above = again.iter().filter(|&&state| state < n).count();
        let visits_above = visits_above(&back, &again[..again_above], n);
        Self { once, again, visits, visits_above, again_above }
    }

    /// R, T, R′, T′ of the interface.
    pub(super) fn slab(&self) -> Slab {
        let mut all = self.once.clone();
        let more = times(self.once.as_ref(), self.visits.as_ref());
        for (k, &state) in self.again.iter().enumerate() {
            let column = all.col(state) + more.col(k);
            all.col_mut(state).copy_from(&column);
        }
        let n = all.nrows() / 2;
        let part = |row: usize, column: usize| all.submatrix(row, column, n, n).to_owned();
        Slab { r: part(0, 0), t: part(n, 0), r_below: part(n, n), t_below: part(0, n) }
    }

    /// What becomes of light that a first event sent back to the interface: deposits `back` over both sides
    /// (2n rows) to what leaves (2n rows: above, below).
    pub(super) fn finish(&self, back: &Mat<f64>) -> Mat<f64> {
        let mut all = back.clone();
        add_times(&mut all, self.visits.as_ref(), pick_rows(back, &self.again).as_ref());
        times(self.once.as_ref(), all.as_ref())
    }

    /// The part of [`Resolved::finish`] that leaves above and never passed the interface: `back` has n rows.
    pub(super) fn finish_above(&self, back: &Mat<f64>) -> Mat<f64> {
        let n = back.nrows();
        let mut all = back.clone();
        let again = &self.again[..self.again_above];
        add_times(&mut all, self.visits_above.as_ref(), pick_rows(back, again).as_ref());
        times(self.once.submatrix(0, 0, n, n), all.as_ref())
    }
}

fn pick_rows(a: &Mat<f64>, rows: &[usize]) -> Mat<f64> {
    Mat::from_fn(rows.len(), a.ncols(), |i, j| a[(rows[i], j)])
}

/// H_{:,J} (I − H_JJ)⁻¹ where only the states J are ever sent back.
fn visits(back: &Mat<f64>, again: &[usize], states: usize) -> Mat<f64> {
    let columns = Mat::from_fn(states, again.len(), |i, k| back[(i, again[k])]);
    let mut core = Mat::from_fn(again.len(), again.len(), |i, k| back[(again[i], again[k])]);
    identity_minus(&mut core);
    let mut visits = columns;
    if !again.is_empty() {
        core.partial_piv_lu().rsolve_in_place(visits.as_mut());
    }
    visits
}

fn visits_above(back: &Mat<f64>, again: &[usize], n: usize) -> Mat<f64> {
    visits(back, again, n)
}
