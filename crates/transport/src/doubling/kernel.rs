//! Scattering columns: what one interface does to rays of given θ, tested against the basis of value functions.
//!
//! Column i of mode m is K_m\[j, i\] = Σ_facets w·P·ℓ_j(θ')·(s'/s_j)ᵖ·cos mΔφ: the expectation of cardinal function
//! j after one event. It maps value functions back exactly, so that mass closes to rounding for any N.

use rayon::prelude::*;

use super::facets::{Events, FATES, Fate, Interface, Outcomes, Part};
use super::grid::Grid;
use super::matrix::{Matrix, sum};
use super::product::{Block, product};
use crate::Geometry;

/// Facets of one block of a deposit: what stays in the cache together.
const BLOCK: usize = 384;

/// What one interface does to a ray of one θ: deposits at the grid's nodes (rows) for each mode (columns).
#[derive(Clone, Debug)]
pub(super) struct Column {
    /// By [`Fate`]; `None` where no facet has that outcome.
    pub(super) deposits: [Option<Matrix>; 4],
    /// Σ w·θ'ᵏ (plane: signed angle) of what is reflected away, k = 0…3.
    pub(super) reflected_powers: [f64; 4],
}

impl Column {
    pub(super) fn deposit(&self, fate: Fate) -> Option<&Matrix> {
        self.deposits[fate as usize].as_ref()
    }
}

/// Scratch of one thread.
#[derive(Default)]
struct Scratch {
    events: Events,
    polynomials: Vec<f64>,
    cosines: Vec<f64>,
    /// (P_k's argument + 1)/2.
    halves: Vec<f64>,
}

/// Columns for rays at each `theta`.
pub(super) fn columns(interface: &Interface, grid: &Grid, modes: usize, theta: &[f64]) -> Vec<Column> {
    theta
        .par_iter()
        .map_init(Scratch::default, |scratch, &theta| match grid.geometry {
            Geometry::Plane => plane_column(interface, grid, theta, scratch),
            Geometry::Space => space_column(interface, grid, modes, theta, scratch),
        })
        .collect()
}

fn plane_column(interface: &Interface, grid: &Grid, theta: f64, scratch: &mut Scratch) -> Column {
    let n = grid.len();
    scratch.events.clear();
    interface.tilts(theta, &mut scratch.events);
    let scale = 1.0 / scratch.events.total;
    let mut powers = [0.0; 4];
    let reflected = &scratch.events.by_fate[Fate::Reflected as usize];
    for (weight, angle) in reflected.weight.iter().zip(&reflected.argument) {
        add_powers(&mut powers, weight * scale, *angle);
    }
    let Scratch { events, polynomials, halves, .. } = scratch;
    let deposits = FATES.map(|fate| {
        let outcomes = &events.by_fate[fate as usize];
        if outcomes.weight.is_empty() {
            return None;
        }
        let mut moments = Matrix::zeros(n, 2);
        polynomials.resize(BLOCK * 2 * n, 0.0);
        for (weight, angle) in outcomes.weight.chunks(BLOCK).zip(outcomes.argument.chunks(BLOCK)) {
            halves.clear();
            halves.extend(angle.iter().map(|angle| 0.5 * (grid.argument(*angle) + 1.0)));
            fill_polynomials(weight, halves, 2 * n, polynomials);
            for (k, column) in polynomials.chunks_exact(weight.len()).take(2 * n).enumerate() {
                moments[(k / 2, k % 2)] += scale * sum(column);
            }
        }
        Some(to_nodes(grid, &moments))
    });
    Column { deposits, reflected_powers: powers }
}

fn add_powers(powers: &mut [f64; 4], weight: f64, angle: f64) {
    let mut term = weight;
    for power in powers {
        *power += term;
        term *= angle;
    }
}

/// Node values of all modes from their Legendre moments.
fn to_nodes(grid: &Grid, moments: &Matrix) -> Matrix {
    let modes = moments.columns();
    let mut nodes = Matrix::zeros(grid.len(), modes);
    for m in 0..modes.min(2) {
        // Both parities in one product each: columns of one parity, strided.
        let pick: Vec<usize> = (m..modes).step_by(2).collect();
        let same = Matrix::from_columns(grid.len(), pick.iter().map(|&mode| moments.column(mode)));
        let product = grid.to_nodes(m).times(&same);
        for (k, &mode) in pick.iter().enumerate() {
            nodes.column_mut(mode).copy_from_slice(product.column(k));
        }
    }
    nodes
}

fn space_column(
    interface: &Interface,
    grid: &Grid,
    modes: usize,
    theta: f64,
    scratch: &mut Scratch,
) -> Column {
    let mut deposits: [Option<Matrix>; 4] = [const { None }; 4];
    let [reflected_pole, refracted_pole] =
        [Part::ReflectedOnly, Part::RefractedOnly].map(|part| interface.pole(theta, part));
    // One set of facets for mode 0 of both parts, so that their energy adds up, and for the reflected light. A pole
    // disturbs modes from 2 on: those come from a polar rule.
    let mut plain = *interface;
    plain.sampling.modes[1] = 0.0;
    if reflected_pole.is_some() {
        plain.sampling.modes[0] = 0.0;
    }
    scratch.events.clear();
    plain.rows(theta, Part::Both, &mut scratch.events);
    let mut powers = polar_angle_powers(&scratch.events);
    let refracted_modes = if refracted_pole.is_some() { 2 } else { 1 };
    let reflected_modes = if reflected_pole.is_some() { 2 } else { modes };
    for fate in FATES {
        let count = if fate.is_reflected() { reflected_modes } else { refracted_modes };
        add_deposit(&mut deposits, fate, grid, (0, count.min(modes)), modes, scratch);
    }
    if let Some(pole) = reflected_pole {
        scratch.events.clear();
        interface.polar(theta, pole, Part::ReflectedOnly, &mut scratch.events);
        powers[1..].copy_from_slice(&polar_angle_powers(&scratch.events)[1..]);
        for fate in [Fate::Reflected, Fate::ReflectedBack] {
            add_deposit(&mut deposits, fate, grid, (2, modes), modes, scratch);
        }
    }
    // The refracted ray turns by (n₁/n₂ − 1) of what the reflected one does: far fewer facets resolve it.
    scratch.events.clear();
    match refracted_pole {
        Some(pole) => interface.polar(theta, pole, Part::RefractedOnly, &mut scratch.events),
        None => interface.rows(theta, Part::RefractedOnly, &mut scratch.events),
    }
    for fate in [Fate::Refracted, Fate::RefractedBack] {
        add_deposit(&mut deposits, fate, grid, (refracted_modes, modes), modes, scratch);
    }
    Column { deposits, reflected_powers: powers }
}

/// Adds the modes `range` of one fate in the scratch's events to its deposit.
fn add_deposit(
    deposits: &mut [Option<Matrix>; 4],
    fate: Fate,
    grid: &Grid,
    range: (usize, usize),
    modes: usize,
    scratch: &mut Scratch,
) {
    let scale = 1.0 / scratch.events.total;
    let outcomes = &scratch.events.by_fate[fate as usize];
    let more = deposit(
        outcomes,
        grid,
        range.0,
        range.1,
        modes,
        scale,
        &mut scratch.polynomials,
        &mut scratch.cosines,
    );
    match (&mut deposits[fate as usize], more) {
        (Some(all), Some(more)) => *all += &more,
        (none, more @ Some(_)) => *none = more,
        (_, None) => {}
    }
}

/// Σ w·θ'ᵏ of the light reflected away.
fn polar_angle_powers(events: &Events) -> [f64; 4] {
    let reflected = &events.by_fate[Fate::Reflected as usize];
    let mut powers = [0.0; 4];
    for (k, weight) in reflected.weight.iter().enumerate() {
        add_powers(&mut powers, weight / events.total, reflected.sine[k].atan2(reflected.argument[k]));
    }
    powers
}

/// Deposit of the modes `first..end` of one fate, as columns of a matrix of `modes` columns.
fn deposit(
    outcomes: &Outcomes,
    grid: &Grid,
    first: usize,
    end: usize,
    modes: usize,
    scale: f64,
    polynomials: &mut Vec<f64>,
    cosines: &mut Vec<f64>,
) -> Option<Matrix> {
    if outcomes.weight.is_empty() {
        return None;
    }
    let n = grid.len();
    let mut moments = Matrix::zeros(n, modes);
    let count = end.saturating_sub(first);
    if count > 0 {
        polynomials.resize(BLOCK * n, 0.0);
        cosines.resize(BLOCK * end.max(2), 0.0);
        for start in (0..outcomes.weight.len()).step_by(BLOCK) {
            let stop = (start + BLOCK).min(outcomes.weight.len());
            let size = stop - start;
            fill_polynomials(&outcomes.weight[start..stop], &outcomes.argument[start..stop], n, polynomials);
            fill_cosines(&outcomes.sine[start..stop], &outcomes.cosine[start..stop], end, cosines);
            let polynomials = Block::new(polynomials, size, n).transposed();
            let cosines = Block::new(&cosines[size * first..], size, count);
            product(&mut moments.values_mut()[n * first..], n, true, scale, polynomials, cosines);
        }
    }
    Some(to_nodes(grid, &moments))
}

/// Column k holds w·P_k(2μ' − 1) of every facet.
fn fill_polynomials(weight: &[f64], mu: &[f64], count: usize, out: &mut [f64]) {
    let size = weight.len();
    out[..size].copy_from_slice(weight);
    if count == 1 {
        return;
    }
    for ((p, w), mu) in out[size..2 * size].iter_mut().zip(weight).zip(mu) {
        *p = w * (2.0 * mu - 1.0);
    }
    for k in 2..count {
        let (done, rest) = out.split_at_mut(k * size);
        let before = &done[(k - 2) * size..(k - 1) * size];
        let last = &done[(k - 1) * size..];
        let order = k as f64;
        let (a, b) = ((2.0 * order - 1.0) / order, (order - 1.0) / order);
        for (((next, mu), p), q) in rest[..size].iter_mut().zip(mu).zip(last).zip(before) {
            *next = a * (2.0 * mu - 1.0) * p - b * q;
        }
    }
}

/// Column m holds sᵖ·cos mΔφ of every facet, p = m mod 2.
fn fill_cosines(sine: &[f64], cosine: &[f64], count: usize, out: &mut [f64]) {
    let size = sine.len();
    out[..size].fill(1.0);
    if count < 2 {
        return;
    }
    out[size..2 * size].copy_from_slice(cosine);
    for m in 2..count {
        let (done, rest) = out.split_at_mut(m * size);
        let before = &done[(m - 2) * size..(m - 1) * size];
        let last = &done[(m - 1) * size..];
        for (((next, c), p), q) in rest[..size].iter_mut().zip(cosine).zip(last).zip(before) {
            *next = 2.0 * c * p - q;
        }
    }
    for m in (1..count).step_by(2) {
        for (value, s) in out[m * size..(m + 1) * size].iter_mut().zip(sine) {
            *value *= s;
        }
    }
}
