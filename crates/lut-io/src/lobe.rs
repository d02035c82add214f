//! Reading a table at any pair of directions.
//!
//! The rule, in four steps:
//! 1. A row (one θi) is read piecewise linearly in cell *position* ([`crate::axis`]), values sitting at cell
//!    centres, constant in the half cells at the two ends; in walk tables bilinearly in (φ, θo) positions.
//! 2. Between two incidences, their rows are mixed linearly in θi *at equal position*, so that the lobes'
//!    centres and the horizon line up; the axis is that of the θi asked for. Outside the incidences of the table
//!    the nearest row is used.
//! 3. Decay tables: f cos θo = v(+θo)·D + v(−θo)·(1 − D), D from [`crate::decay`] with w linear in θi.
//! 4. The result is multiplied by [`Row::correction`], so that its hemispherical integral is the component's
//!    albedo, itself interpolated by a monotone cubic in θi. At a θi of the table the factor differs from 1 by
//!    the rounding of the file only.
//!
//! The integral in step 4 is Σ v·W with the weights of [`crate::measure`] at the θi asked for; it is computed
//! when an [`Interpolant`] is made, at every incidence and at steps of at most 0.5° between them, and the factor
//! is linear between those.

use crate::axis::Stretched;
use crate::decay;
use crate::measure::{self, neighbours};
use crate::monotone::Monotone;
use crate::table::{Component, IncidenceSummary, Table};
use std::sync::Arc;

/// Largest step in θi between corrections, radians.
const CORRECTION_STEP: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Fewest steps between two incidences: the factor is a parabola there to leading order, and four chords of it
/// keep a fifteenth of its height as error.
const MIN_STEPS: usize = 4;

/// A table with all that reading it between its nodes needs.
#[derive(Clone, Debug)]
pub struct Interpolant {
    table: Arc<Table>,
    theta_i: Vec<f64>,
    /// w of the decay postulate at each incidence, radians.
    azimuth_width: Vec<f64>,
    albedo: [Monotone; 3],
    /// Where the corrections are known, radians, ascending; and their values.
    correction_at: Vec<f64>,
    correction: [Vec<f64>; 3],
}

/// A table at one angle of incidence.
#[derive(Clone, Debug)]
pub struct Row<'t> {
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
    ///
    /// The table must be valid ([`Table::validate`]), as every table read from a file is.
    #[must_use]
    pub fn new(table: impl Into<Arc<Table>>) -> Self {
        let table = table.into();
        let theta_i = table.theta_i();
        let per_incidence = &table.meta.per_incidence;
        let azimuth_width = per_incidence.iter().map(|s| s.azimuth_width_deg.to_radians()).collect();
        let share = |component| per_incidence.iter().map(|s: &IncidenceSummary| s.share(component)).collect();
        let albedo = Component::ALL.map(|component| Monotone::new(theta_i.clone(), share(component)));
        let correction_at = correction_nodes(&theta_i);
        let correction = [vec![], vec![], vec![]];
        let mut this = Self { table, theta_i, azimuth_width, albedo, correction_at, correction };
        for at in 0..this.correction_at.len() {
            let theta_i = this.correction_at[at];
            let integrals = this.uncorrected_row(theta_i).integrals();
            for component in Component::ALL {
                let (albedo, integral) = (this.albedo(component, theta_i), integrals[component as usize]);
                // A component without light, or one that no cell caught, has nothing to correct.
                let factor = if integral > 0.0 { albedo / integral } else { 1.0 };
                this.correction[component as usize].push(factor);
            }
        }
        this
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

    /// w of the decay postulate at θi, radians (0 in walk tables that give none).
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
        let (i, t) = bracket(&self.correction_at, theta_i);
        row.correction = Component::ALL.map(|component| mix(&self.correction[component as usize], i, t));
        row
    }

    fn uncorrected_row(&self, theta_i: f64) -> Row<'_> {
        let axis = &self.table.meta.exit_axis;
        Row {
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

    /// The exit cells at this incidence: signed angle s (decay tables) or θo (walk tables).
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
        self.correction(component) * self.read(samples, theta_o, phi)
    }

    /// Standard error of [`Self::eval`], taken as fully correlated between neighbouring cells: an upper bound.
    #[must_use]
    pub fn std_error(&self, component: Component, theta_o: f64, phi: f64) -> f64 {
        let samples = &self.table.lobe(component).std_error;
        self.correction(component) * self.read(samples, theta_o, phi)
    }

    /// A channel of the table read by the rule above, without the correction.
    #[must_use]
    pub fn read(&self, samples: &[f32], theta_o: f64, phi: f64) -> f64 {
        let Some(phi_axis) = &self.phi else {
            let x = decay::concentration(self.theta_i, theta_o, self.azimuth_width);
            let d = decay::decay(x, phi.cos());
            let at = |s: f64| self.along_columns(samples, 0, s);
            return at(theta_o) * d + at(-theta_o) * (1.0 - d);
        };
        // The lobe is even in φ: fold any angle to [0, π].
        let folded = phi.cos().clamp(-1.0, 1.0).acos();
        let (row, t) = neighbours(phi_axis.position(folded), phi_axis.cells);
        let near = self.along_columns(samples, row, theta_o);
        if t == 0.0 {
            return near;
        }
        near * (1.0 - t) + t * self.along_columns(samples, row + 1, theta_o)
    }

    /// A channel at a whole cell, without the correction: (φ row, column); the stored number at a stored θi.
    #[must_use]
    pub fn cell(&self, samples: &[f32], row: usize, column: usize) -> f64 {
        let cells = self.table.meta.exit_axis.cells();
        let offset = row * self.columns.cells + column;
        let (i, t) = self.node;
        let near = f64::from(samples[i * cells + offset]);
        if t == 0.0 {
            return near;
        }
        let far = f64::from(samples[(i + 1) * cells + offset]);
        if t == 1.0 { far } else { near * (1.0 - t) + far * t }
    }

    fn along_columns(&self, samples: &[f32], row: usize, x: f64) -> f64 {
        let (column, t) = neighbours(self.columns.position(x), self.columns.cells);
        let near = self.cell(samples, row, column);
        if t == 0.0 {
            return near;
        }
        near * (1.0 - t) + t * self.cell(samples, row, column + 1)
    }

    /// Hemispherical integral of each component as read, the correction included.
    #[must_use]
    pub fn integrals(&self) -> [f64; 3] {
        let axis = &self.table.meta.exit_axis;
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

/// The node at or before x and how far (0..1) x is towards the next; clamped to the ends.
fn bracket(nodes: &[f64], x: f64) -> (usize, f64) {
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

/// Every incidence and equal steps between; from 0 to 90° also outside the incidences, where rows move with the
/// mirror direction although their values stay.
fn correction_nodes(theta_i: &[f64]) -> Vec<f64> {
    let mut ends = theta_i.to_vec();
    if ends[0] > 0.0 {
        ends.insert(0, 0.0);
    }
    if ends[ends.len() - 1] < std::f64::consts::FRAC_PI_2 {
        ends.push(std::f64::consts::FRAC_PI_2);
    }
    let mut nodes = vec![ends[0]];
    for pair in ends.windows(2) {
        let room = pair[1] - pair[0];
        let steps = ((room / CORRECTION_STEP).ceil() as usize).max(MIN_STEPS);
        nodes.extend((1..steps).map(|k| pair[0] + room * k as f64 / steps as f64));
        nodes.push(pair[1]);
    }
    nodes
}
