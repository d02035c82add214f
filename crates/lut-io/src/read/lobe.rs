//! Reading a table at any pair of directions.
//!
//! The rule, in four steps:
//! 1. A row (one θi) is read piecewise linearly in cell *position* ([`crate::axis`]), values sitting at cell
//!    centres, constant in the half cells at the two ends; in space tables bilinearly in (φ, θo) positions.
//! 2. Between two incidences, their rows are mixed linearly in θi *at equal position*, so that the lobes'
//!    centres and the horizon line up; the axis is that of the θi asked for. Outside the incidences of the table
//!    the nearest row is used.
//! 3. Decay tables: f cos θo = v(+θo)·D + v(−θo)·(1 − D), D from [`crate::decay`] with w linear in θi.
//! 4. The result is multiplied by [`Row::correction`], so that its hemispherical integral is the component's
//!    albedo, itself interpolated by a monotone cubic in θi. At a θi of the table the factor differs from 1 by
//!    the rounding of the file only.
//!
//! A reciprocal table ([`crate::reciprocal`]) is read at the larger of θi and θo, the result taken over to the other by cos θo/cos θi.
//!
//! The integral that step 4 divides by is Σ v·W with the weights W of [`crate::measure`] at the θi asked for. For
//! each of the two rows it is computed when an [`Interpolant`] is made, at every incidence and at steps of at most
//! 0.5° between (shorter near 0 and 90°), and is linear between those: of a row that stays while the axis moves, only
//! the bend of W is lost.

use crate::model::axis::Stretched;
use crate::model::decay;
use crate::model::measure::{self, neighbours};
use crate::model::table::{Component, IncidenceSummary, Table};
use crate::read::monotone::Monotone;
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use std::sync::Arc;

/// Largest step in θi between known integrals, radians.
const LARGEST_STEP: f64 = 0.5 * PI / 180.0;
/// The same as a share of hypot(w, distance of θi to 0 or 90°): there the weights bend on that scale, and a chord
/// keeps a share of 0.02²/8 = 5e-5 of the integral as error.
const RELATIVE_STEP: f64 = 0.02;
/// Fewest steps between two incidences; four chords keep a sixteenth of a bend.
const MIN_STEPS: usize = 4;

/// A table with all that reading it between its nodes needs.
#[derive(Clone, Debug)]
pub struct Interpolant {
    table: Arc<Table>,
    reciprocal: bool,
    theta_i: Vec<f64>,
    /// w of the decay postulate at each incidence, radians.
    azimuth_width: Vec<f64>,
    albedo: [Monotone; 3],
    /// Integrals from 0 to 90°, ascending, without gaps.
    spans: Vec<Span>,
}

/// Hemispherical integrals of the rows that serve one range of θi.
#[derive(Clone, Debug)]
struct Span {
    /// Where they are known, radians, ascending; the first and the last are the range.
    at: Vec<f64>,
    /// Integrals of the rows before and after θi (the same row outside the table's incidences), each component.
    before: Vec<[f64; 3]>,
    after: Vec<[f64; 3]>,
}

/// A table at one angle of incidence.
#[derive(Clone, Debug)]
pub struct Row<'t> {
    of: &'t Interpolant,
    table: &'t Table,
    theta_i: f64,
    azimuth_width: f64,
    columns: Stretched,
    phi: Option<Stretched>,
    /// The incidence at or before θi, and how far (0..1) θi is towards the next one.
    node: (usize, f64),
    correction: [f64; 3],
}

impl Interpolant {
    /// Prepares a table for reading; costs a few milliseconds an incidence.
    #[must_use]
    pub fn new(table: impl Into<Arc<Table>>) -> Self {
        let table = table.into();
        let theta_i = table.theta_i();
        let per_incidence = &table.meta().per_incidence;
        let azimuth_width = per_incidence.iter().map(|s| s.azimuth_width_deg.to_radians()).collect();
        let share = |component| per_incidence.iter().map(|s: &IncidenceSummary| s.share(component)).collect();
        let albedo = Component::ALL.map(|component| Monotone::new(theta_i.clone(), share(component)));
        let reciprocal = table.meta().reciprocal.is_some();
        let mut this = Self { table, reciprocal, theta_i, azimuth_width, albedo, spans: Vec::new() };
        let steps = steps(this.table.meta().exit_axis.width());
        let ends = span_ends(&this.theta_i);
        this.spans = ends.par_windows(2).map(|ends| this.span(ends[0], ends[1], &steps)).collect();
        this
    }

    fn span(&self, from: f64, to: f64, steps: &[f64]) -> Span {
        // Outside the table's incidences both are the nearest row.
        let before = self.theta_i.iter().rposition(|node| *node <= from).unwrap_or(0);
        let after = self.theta_i.iter().position(|node| *node >= to).unwrap_or(self.theta_i.len() - 1);
        let mut at: Vec<f64> = steps.iter().copied().filter(|step| from < *step && *step < to).collect();
        at.extend((0..MIN_STEPS).map(|k| from + (to - from) * k as f64 / MIN_STEPS as f64));
        at.push(to);
        at.sort_by(f64::total_cmp);
        at.dedup();
        let of = |theta_i: &f64| {
            let width = self.azimuth_width(*theta_i);
            let weights = measure::reading_weights(&self.table.meta().exit_axis, *theta_i, width);
            [before, after].map(|row| integrals(&self.table, row, &weights))
        };
        let (before, after) = at.par_iter().map(of).map(|[before, after]| (before, after)).unzip();
        Span { at, before, after }
    }

    /// Hemispherical integrals at θi as read, before the correction.
    fn uncorrected_integrals(&self, theta_i: f64) -> [f64; 3] {
        let last = self.spans.len() - 1;
        let span =
            &self.spans[self.spans.partition_point(|span| span.at[span.at.len() - 1] < theta_i).min(last)];
        let (step, u) = bracket(&span.at, theta_i);
        let (_, t) = bracket(&[span.at[0], span.at[span.at.len() - 1]], theta_i);
        std::array::from_fn(|c| {
            let along = |known: &[[f64; 3]]| known[step][c] * (1.0 - u) + known[step + 1][c] * u;
            along(&span.before) * (1.0 - t) + along(&span.after) * t
        })
    }

    /// The table.
    #[must_use]
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// Share of the light arriving at θi (radians) that leaves as this component.
    #[must_use]
    pub fn albedo(&self, component: Component, theta_i: f64) -> f64 {
        self.albedo[component as usize].at(theta_i)
    }

    /// w of the decay postulate at θi, radians (0 in space tables that give none).
    #[must_use]
    pub fn azimuth_width(&self, theta_i: f64) -> f64 {
        let (i, t) = self.node(theta_i);
        mix(&self.azimuth_width, i, t)
    }

    /// f·cos θo in 1/sr of one component; angles in radians, θi and θo in [0, π/2], any φ.
    #[must_use]
    pub fn eval(&self, component: Component, theta_i: f64, theta_o: f64, phi: f64) -> f64 {
        self.row(theta_i).eval(component, theta_o, phi)
    }

    /// The table at one θi, radians: ask here when many exit directions share an incidence.
    #[must_use]
    pub fn row(&self, theta_i: f64) -> Row<'_> {
        let mut row = self.uncorrected_row(theta_i);
        let integrals = self.uncorrected_integrals(theta_i);
        row.correction = Component::ALL.map(|component| {
            let integral = integrals[component as usize];
            // A component without light, or one that no cell caught, has nothing to correct.
            if integral > 0.0 { self.albedo(component, theta_i) / integral } else { 1.0 }
        });
        row
    }

    fn uncorrected_row(&self, theta_i: f64) -> Row<'_> {
        let axis = &self.table.meta().exit_axis;
        Row {
            of: self,
            table: &self.table,
            theta_i,
            azimuth_width: self.azimuth_width(theta_i),
            columns: axis.columns_at(theta_i),
            phi: axis.phi_at(theta_i),
            node: self.node(theta_i),
            correction: [1.0; 3],
        }
    }

    fn node(&self, theta_i: f64) -> (usize, f64) {
        bracket(&self.theta_i, theta_i)
    }
}

impl Row<'_> {
    /// Angle of incidence, radians.
    #[must_use]
    pub const fn theta_i(&self) -> f64 {
        self.theta_i
    }

    /// w of the decay postulate, radians.
    #[must_use]
    pub const fn azimuth_width(&self) -> f64 {
        self.azimuth_width
    }

    /// The exit cells at this incidence: signed angle s (decay tables) or θo (space tables).
    #[must_use]
    pub const fn columns(&self) -> &Stretched {
        &self.columns
    }

    /// The φ cells at this incidence; `None` in decay tables.
    #[must_use]
    pub const fn phi(&self) -> Option<&Stretched> {
        self.phi.as_ref()
    }

    /// The incidence of the table that this row is, if it is one.
    #[must_use]
    pub const fn stored(&self) -> Option<usize> {
        match self.node {
            (i, 0.0) => Some(i),
            (i, 1.0) => Some(i + 1),
            _ => None,
        }
    }

    /// What the interpolated values are multiplied by to keep the component's albedo.
    #[must_use]
    pub const fn correction(&self, component: Component) -> f64 {
        self.correction[component as usize]
    }

    /// f·cos θo in 1/sr of one component; θo in [0, π/2] and φ in radians.
    #[must_use]
    pub fn eval(&self, component: Component, theta_o: f64, phi: f64) -> f64 {
        let samples = &self.table.lobe(component).value;
        let [value] = self.at_larger_angle(theta_o, |row, theta_o| {
            [row.correction(component) * row.read(samples, theta_o, phi)]
        });
        value
    }

    /// [`Self::eval`] of every component, in the order of [`Component::ALL`], for little more than the price of one.
    #[must_use]
    pub fn eval_all(&self, theta_o: f64, phi: f64) -> [f64; 3] {
        let samples = Component::ALL.map(|component| &self.table.lobe(component).value);
        self.at_larger_angle(theta_o, |row, theta_o| {
            let read = row.read_each(samples.map(Vec::as_slice), theta_o, phi);
            Component::ALL.map(|component| row.correction(component) * read[component as usize])
        })
    }

    /// What `read` finds at an exit angle; in reciprocal tables at the larger of the two angles.
    fn at_larger_angle<const N: usize>(
        &self,
        theta_o: f64,
        read: impl Fn(&Self, f64) -> [f64; N],
    ) -> [f64; N] {
        if !self.of.reciprocal || theta_o <= self.theta_i {
            return read(self, theta_o);
        }
        read(&self.of.row(theta_o), self.theta_i).map(|value| value * theta_o.cos() / self.theta_i.cos())
    }

    /// Standard error of [`Self::eval`], taken as fully correlated between neighbouring cells: an upper bound.
    #[must_use]
    pub fn std_error(&self, component: Component, theta_o: f64, phi: f64) -> f64 {
        let samples = &self.table.lobe(component).std_error;
        let [value] = self.at_larger_angle(theta_o, |row, theta_o| {
            [row.correction(component) * row.read(samples, theta_o, phi)]
        });
        value
    }

    /// A channel of the table read by the rule above, without the correction.
    #[must_use]
    pub fn read(&self, samples: &[f32], theta_o: f64, phi: f64) -> f64 {
        let [value] = self.read_each([samples], theta_o, phi);
        value
    }

    fn read_each<const N: usize>(&self, samples: [&[f32]; N], theta_o: f64, phi: f64) -> [f64; N] {
        let cells = Cells { centre: self.theta_i, columns: &self.columns, phi: self.phi.as_ref() };
        // The lobe is even in φ: fold any angle to [0, π].
        let phi = if self.phi.is_some() { phi.cos().clamp(-1.0, 1.0).acos() } else { phi };
        cells.read(theta_o, phi, self.azimuth_width, |row, column| {
            samples.map(|samples| self.cell(samples, row, column))
        })
    }

    /// A channel at a whole cell, without the correction: (φ row, column); the stored number at a stored θi.
    #[must_use]
    pub fn cell(&self, samples: &[f32], row: usize, column: usize) -> f64 {
        let cells = self.table.meta().exit_axis.cells();
        let offset = row * self.columns.cells + column;
        let (i, t) = self.node;
        let near = f64::from(samples[i * cells + offset]);
        if t == 0.0 {
            return near;
        }
        let far = f64::from(samples[(i + 1) * cells + offset]);
        if t == 1.0 { far } else { near * (1.0 - t) + far * t }
    }

    /// A channel at a position in units of cells along φ (0.5 in decay tables) and along the columns, without the
    /// correction.
    #[must_use]
    pub fn at_position(&self, samples: &[f32], across: f64, along: f64) -> f64 {
        let rows = self.table.meta().exit_axis.rows_per_incidence();
        let at = |row: usize| mixed(along, self.columns.cells, |column| [self.cell(samples, row, column)]);
        let [value] = mixed(across, rows, at);
        value
    }

    /// Hemispherical integral of each component as read, the correction included.
    #[must_use]
    pub fn integrals(&self) -> [f64; 3] {
        let axis = &self.table.meta().exit_axis;
        let weights = measure::reading_weights(axis, self.theta_i, self.azimuth_width);
        Component::ALL.map(|component| {
            let samples = &self.table.lobe(component).value;
            let sum: f64 = weights
                .iter()
                .enumerate()
                .map(|(k, weight)| {
                    weight * self.cell(samples, k / self.columns.cells, k % self.columns.cells)
                })
                .sum();
            sum * self.correction(component)
        })
    }
}

/// The cells of one incidence: step 1 of the rule.
pub(super) struct Cells<'a> {
    /// The mirror direction, radians.
    pub(super) centre: f64,
    /// Signed exit angle (decay tables) or θo.
    pub(super) columns: &'a Stretched,
    /// φ in space tables.
    pub(super) phi: Option<&'a Stretched>,
}

impl Cells<'_> {
    /// The values of `cell` (φ row, column), of N channels, read at an exit direction, φ in [0, π] where there are φ cells; in decay tables by the
    /// postulate of width w, step 3 of the rule.
    pub(super) fn read<const N: usize>(
        &self,
        theta_o: f64,
        phi: f64,
        azimuth_width: f64,
        cell: impl Fn(usize, usize) -> [f64; N],
    ) -> [f64; N] {
        let along =
            |row: usize, position: f64| mixed(position, self.columns.cells, |column| cell(row, column));
        let position = self.columns.position(theta_o);
        let Some(phi_axis) = self.phi else {
            let d = decay::decay(decay::concentration(self.centre, theta_o, azimuth_width), phi.cos());
            let (ahead, behind) = (along(0, position), along(0, self.columns.position(-theta_o)));
            return std::array::from_fn(|n| ahead[n] * d + behind[n] * (1.0 - d));
        };
        mixed(phi_axis.position(phi), phi_axis.cells, |row| along(row, position))
    }
}

/// What is known at cell centres, linear in position between them.
fn mixed<const N: usize>(position: f64, cells: usize, at: impl Fn(usize) -> [f64; N]) -> [f64; N] {
    let (cell, t) = neighbours(position, cells);
    let near = at(cell);
    if t == 0.0 {
        return near;
    }
    let far = at(cell + 1);
    std::array::from_fn(|n| near[n] * (1.0 - t) + t * far[n])
}

/// The node at or before x and how far (0..1) x is towards the next; clamped to the ends.
pub(crate) fn bracket(nodes: &[f64], x: f64) -> (usize, f64) {
    let last = nodes.len() - 1;
    if last == 0 || x <= nodes[0] || x.is_nan() {
        return (0, 0.0);
    }
    if x >= nodes[last] {
        return (last - 1, 1.0);
    }
    let i = nodes.partition_point(|node| *node <= x) - 1;
    (i, (x - nodes[i]) / (nodes[i + 1] - nodes[i]))
}

fn mix(values: &[f64], i: usize, t: f64) -> f64 {
    if t == 0.0 { values[i] } else { values[i] * (1.0 - t) + values[i + 1] * t }
}

/// Incidences at which the integrals of a table of stretch width w must be known at least, beside its own.
fn steps(width: f64) -> Vec<f64> {
    // Steps of RELATIVE_STEP·hypot(w, θ) are equal steps in asinh(θ/w)/RELATIVE_STEP.
    let mut near = vec![0.0];
    let mut theta = 0.0;
    while theta < FRAC_PI_4 {
        let graded = width * (RELATIVE_STEP * near.len() as f64).sinh();
        theta = graded.min(theta + LARGEST_STEP);
        near.push(theta);
    }
    let far = near.iter().map(|theta| FRAC_PI_2 - theta);
    // Where the axis stops following the mirror direction its weights have a kink (ExitAxis::columns_at).
    near.iter().copied().chain(far).chain([width, FRAC_PI_2 - width]).collect()
}

/// The incidences, and 0 and 90°: outside the incidences rows move with the mirror direction although their values
/// stay.
fn span_ends(theta_i: &[f64]) -> Vec<f64> {
    let mut ends = theta_i.to_vec();
    if ends[0] > 0.0 {
        ends.insert(0, 0.0);
    }
    if ends[ends.len() - 1] < FRAC_PI_2 {
        ends.push(FRAC_PI_2);
    }
    ends
}

/// Σ value·weight of each component of the stored row at an incidence.
fn integrals(table: &Table, incidence: usize, weights: &[f64]) -> [f64; 3] {
    Component::ALL.map(|component| {
        let values = table.at_incidence(&table.lobe(component).value, incidence);
        weights.iter().zip(values).map(|(weight, value)| weight * f64::from(*value)).sum()
    })
}
