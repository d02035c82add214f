//! Slabs and the adding equations, one azimuthal mode at a time.

use super::facets::Fate;
use super::kernel::Column;
use super::lu::Lu;
use super::matrix::{Matrix, sum};

/// (I − a)⁻¹ b.
pub(super) fn resolvent(mut a: Matrix, mut b: Matrix) -> Matrix {
    identity_minus(&mut a);
    Lu::new(a).solve(&mut b);
    b
}

/// (I − a)⁻¹ with one step of iterative refinement, for the last solve: I − R₁R₂ is nearly singular under a thick lossless
/// body, and the energy balance should keep its last digits.
pub(super) struct Resolvent {
    matrix: Matrix,
    factors: Lu,
}

impl Resolvent {
    pub(super) fn new(mut a: Matrix) -> Self {
        identity_minus(&mut a);
        Self { factors: Lu::new(a.clone()), matrix: a }
    }

    /// (I − a)⁻¹ b.
    pub(super) fn times(&self, b: &Matrix) -> Matrix {
        let mut x = b.clone();
        self.factors.solve(&mut x);
        let mut residual = b.clone().with(&self.matrix.times(&x), |b, product| b - product);
        self.factors.solve(&mut residual);
        x += &residual;
        x
    }
}

/// Takes rounding out of the energy balance of a lossless slab: every column of R + T sums to 1 in exact arithmetic,
/// and each doubling would double what the solve with the nearly singular I − R left.
fn conserve(r: &mut Matrix, t: &mut Matrix) {
    for i in 0..r.columns() {
        let (up, down): (f64, f64) = (sum(r.column(i)), sum(t.column(i)));
        let excess = up + down - 1.0;
        let (larger, share) = if up > down { (&mut *r, up) } else { (&mut *t, down) };
        larger.column_mut(i).iter_mut().for_each(|value| *value *= 1.0 - excess / share);
    }
}

fn identity_minus(a: &mut Matrix) {
    for j in 0..a.columns() {
        for value in a.column_mut(j).iter_mut() {
            *value = -*value;
        }
        a[(j, j)] += 1.0;
    }
}

/// Reflection and transmission of a slab from above (R, T) and from below (R′, T′). Columns are incident nodes.
#[derive(Clone, Debug)]
pub(super) struct Slab {
    pub(super) r: Matrix,
    pub(super) t: Matrix,
    pub(super) r_below: Matrix,
    pub(super) t_below: Matrix,
}

impl Slab {
    /// No interface at all.
    pub(super) fn nothing(n: usize) -> Self {
        Self {
            r: Matrix::zeros(n, n),
            t: Matrix::identity(n),
            r_below: Matrix::zeros(n, n),
            t_below: Matrix::identity(n),
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
        let down = resolvent(self.r_below.times(&lower.r), self.t.clone());
        let up = resolvent(lower.r.times(&self.r_below), lower.t_below.clone());
        let mut r = self.r.clone();
        r.add_product(&self.t_below, &lower.r.times(&down));
        let mut r_below = lower.r_below.clone();
        r_below.add_product(&lower.t, &self.r_below.times(&up));
        Self { r, t: lower.t.times(&down), r_below, t_below: self.t_below.times(&up) }
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
    pub(super) r: Matrix,
    pub(super) t: Matrix,
}

impl Mirror {
    /// Two of it. The sum and the difference of R and T answer light that is even or odd about the middle:
    /// R₂ ± T₂ = R ± T (I ∓ R)⁻¹ T.
    fn doubled(&self) -> Self {
        let even = resolvent(self.r.clone(), self.t.clone());
        let odd = resolvent(self.r.clone().map(|r| -r), self.t.clone());
        let (mut r, mut t) = (self.t.times(&even), self.t.times(&odd));
        for (even, odd) in r.values_mut().iter_mut().zip(t.values_mut()) {
            (*even, *odd) = (0.5 * (*even - *odd), 0.5 * (*even + *odd));
        }
        r += &self.r;
        Self { r, t }
    }

    /// This above another power of the same cell (they commute, so that the pair is a mirror again).
    fn joined(&self, other: &Self) -> Self {
        let down = resolvent(self.r.times(&other.r), self.t.clone());
        let mut r = self.r.clone();
        r.add_product(&self.t, &other.r.times(&down));
        Self { r, t: other.t.times(&down) }
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

pub(super) fn scale_columns(a: &mut Matrix, factors: &[f64]) {
    for (j, &factor) in factors.iter().enumerate() {
        a.column_mut(j).iter_mut().for_each(|value| *value *= factor);
    }
}

pub(super) fn scale_rows(a: &mut Matrix, factors: &[f64]) {
    for j in 0..a.columns() {
        a.column_mut(j).iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
    }
}

/// One interface in one mode, its re-hits resolved: interface = E (I − H)⁻¹.
///
/// States are the incident nodes of the upper side (first n) and of the lower side (last n).
#[derive(Clone, Debug)]
pub(super) struct Resolved {
    /// What leaves after one event: rows upper side away, lower side away.
    once: Matrix,
    /// States that facets send back to the interface, and all visits that follow from one ray there.
    again: Vec<usize>,
    /// H (I − H)⁻¹, columns `again`.
    visits: Matrix,
    /// The same for light that stays on the upper side.
    visits_above: Matrix,
    again_above: usize,
}

impl Resolved {
    pub(super) fn new(from_above: &[Column], from_below: &[Column], mode: usize) -> Self {
        let n = from_above.len();
        let mut once = Matrix::zeros(2 * n, 2 * n);
        let mut back = Matrix::zeros(2 * n, 2 * n);
        let mut again = Vec::new();
        for (state, column) in from_above.iter().chain(from_below).enumerate() {
            let (near, far) = if state < n { (0, n) } else { (n, 0) };
            let place = |target: &mut Matrix, fate: Fate, row: usize| {
                if let Some(deposit) = column.deposit(fate) {
                    target.column_mut(state)[row..row + n].copy_from_slice(deposit.column(mode));
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
        let again_above = again.iter().filter(|&&state| state < n).count();
        let visits_above = visits(&back, &again[..again_above], n);
        let visits = visits(&back, &again, 2 * n);
        Self { once, again, visits, visits_above, again_above }
    }

    /// R, T, R′, T′ of the interface.
    pub(super) fn slab(&self) -> Slab {
        let mut all = self.once.clone();
        let more = self.once.times(&self.visits);
        for (k, &state) in self.again.iter().enumerate() {
            all.column_mut(state).iter_mut().zip(more.column(k)).for_each(|(all, more)| *all += more);
        }
        let n = all.rows() / 2;
        let part = |row: usize, column: usize| all.part(row..row + n, column..column + n);
        Slab { r: part(0, 0), t: part(n, 0), r_below: part(n, n), t_below: part(0, n) }
    }

    /// What becomes of light that a first event sent back to the interface: deposits `back` over both sides
    /// (2n rows) to what leaves (2n rows: above, below).
    pub(super) fn finish(&self, back: &Matrix) -> Matrix {
        let mut all = back.clone();
        all.add_product(&self.visits, &pick_rows(back, &self.again));
        self.once.times(&all)
    }

    /// The part of [`Resolved::finish`] that leaves above and never passed the interface: `back` has n rows.
    pub(super) fn finish_above(&self, back: &Matrix) -> Matrix {
        let n = back.rows();
        let mut all = back.clone();
        let again = &self.again[..self.again_above];
        all.add_product(&self.visits_above, &pick_rows(back, again));
        self.once.part(0..n, 0..n).times(&all)
    }
}

fn pick_rows(a: &Matrix, rows: &[usize]) -> Matrix {
    Matrix::from_fn(rows.len(), a.columns(), |i, j| a[(rows[i], j)])
}

/// H_{:,J} (I − H_JJ)⁻¹ where only the states J are ever sent back.
fn visits(back: &Matrix, again: &[usize], states: usize) -> Matrix {
    let columns = Matrix::from_fn(states, again.len(), |i, k| back[(i, again[k])]);
    let mut core = pick_rows(&columns, again);
    identity_minus(&mut core);
    // x·A⁻¹ is (A⁻ᵀxᵀ)ᵀ.
    let mut transposed = columns.transposed();
    Lu::new(core.transposed()).solve(&mut transposed);
    transposed.transposed()
}
