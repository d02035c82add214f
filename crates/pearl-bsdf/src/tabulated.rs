//! The tabulated lobes: interior and rehit, read by the rule of [`lut_io::lobe`] and sampled.
//!
//! Reading and sampling work in cell positions. The sampling density of a row is piecewise linear in position
//! through u = v·J at the cell centres, v the stored values and J = dω/dposition at the row's own incidence; its
//! distribution function is inverted exactly. Between two incidences the rows are mixed at equal position, as
//! values are. So what is sampled differs from what is evaluated only by the change of J within a cell and
//! between two incidences, and the pdf is exact.
//!
//! A density that is linear in position does not vanish with sin θo at the normal: per solid angle it would be singular
//! there. Within a cap as narrow as a facet's tilt, where lobes do not vary much, what falls there is spread evenly over
//! the solid angle.

use crate::angles::{self, Polar, angle};
use crate::azimuth::{self, Forward};
use crate::warp::{Cell, Warp};
use lut_io::axis::ExitAxis;
use lut_io::decay;
use lut_io::lobe::Interpolant;
use lut_io::reciprocal;
use lut_io::table::{Component, Table};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// The tabulated components, in the order of every pair below.
pub(crate) const COMPONENTS: [Component; 2] = [Component::Interior, Component::Rehit];

/// Largest radius of the cap around the normal, radians.
const LARGEST_CAP: f64 = 0.1;

/// The cap around the normal in which the sampling density is even.
#[derive(Clone, Copy, Debug)]
struct Cap {
    radius: f64,
    sin: f64,
    /// sin² of half the radius: half the height of the cap.
    half_chord2: f64,
    /// One over its solid angle.
    density: f64,
}

impl Cap {
    fn new(radius: f64) -> Self {
        let half_chord2 = (0.5 * radius).sin().powi(2);
        Self { radius, sin: radius.sin(), half_chord2, density: 0.25 / (PI * half_chord2) }
    }

    /// θo of a point of the cap, by the share of its area nearer to the normal.
    fn theta(&self, area: f64) -> f64 {
        2.0 * (self.half_chord2 * area).sqrt().asin()
    }
}

/// Both lobes of a table.
#[derive(Clone, Debug)]
pub(crate) struct Tabulated {
    axis: ExitAxis,
    /// Whether the table is read at the larger of both angles ([`lut_io::reciprocal`]).
    reciprocal: bool,
    /// Angles of incidence, radians.
    theta: Vec<f64>,
    /// Where to begin looking for an angle among them: their number at or before each of [`GUIDES`] equal steps to π/2.
    guide: Vec<u16>,
    /// w of the decay postulate at each incidence, radians.
    width: Vec<f64>,
    columns: usize,
    rows: usize,
    /// Stretch width of the cells, radians, and its inverse.
    cell_width: f64,
    inverse_width: f64,
    /// Interior and rehit of every cell, f·cos θo in 1/sr.
    values: Vec<[f32; 2]>,
    sampling: [Sampling; 2],
    /// Ends of the ranges of θi that one pair of rows serves, radians: the incidences, 0 and π/2.
    spans: Vec<f64>,
    /// At equal steps of each span: smooth within it, with a kink at its ends.
    along: Vec<[Along; SPAN_STEPS + 1]>,
    cap: Cap,
}

/// What is known along θi, of interior and rehit.
#[derive(Clone, Copy, Debug, Default)]
struct Along {
    /// Factor that restores the albedo.
    correction: [f64; 2],
    /// Share of what is sampled that falls into the cap around the normal.
    cap: [f64; 2],
}

/// Steps of [`Tabulated::guide`].
const GUIDES: usize = 1024;

/// Steps of a span at which [`Along`] is known.
const SPAN_STEPS: usize = 64;

/// Piecewise-linear densities of one component, every incidence.
#[derive(Clone, Debug)]
struct Sampling {
    /// u at cell centres.
    u: Vec<f64>,
    /// Integral of u up to each cell centre of a row.
    cdf: Vec<f64>,
    /// Where to begin looking in `cdf` of a row ([`guide`]), and in `row_cdf` of an incidence.
    guide: Vec<u16>,
    row_guide: Vec<u16>,
    /// Σ u of each row.
    row_total: Vec<f64>,
    /// Integral of the rows' totals up to the centre of each φ row of an incidence.
    row_cdf: Vec<f64>,
    /// Σ u of each incidence.
    total: Vec<f64>,
}

/// Two incidences and how far (0..1) θi lies between them.
#[derive(Clone, Copy, Debug)]
struct Between {
    node: usize,
    next: usize,
    fraction: f64,
}

/// The table at one incidence.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incidence {
    between: Between,
    along: Along,
    columns: Warp,
    azimuth: Azimuth,
}

#[derive(Clone, Copy, Debug)]
enum Azimuth {
    /// Decay tables: sin θi / w².
    Decay { concentration: f64 },
    /// Walk tables: the φ axis.
    Walk(Warp),
}

/// Where an exit direction lies in the table at one incidence.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Exit {
    Decay { forward: Cell, retro: Cell, slopes: [f64; 2], concentration: f64, sin_o: f64, y2: f64 },
    Walk { column: Cell, row: Cell, measure: f64, sin_o: f64 },
}

impl Tabulated {
    pub(crate) fn new(lobe: &Interpolant) -> Self {
        let table = lobe.table();
        let axis = table.meta.exit_axis;
        let theta = table.theta_i();
        let width = table.meta.per_incidence.iter().map(|s| s.azimuth_width_deg.to_radians()).collect();
        let values = table.interior.value.iter().zip(&table.rehit.value).map(|(a, b)| [*a, *b]).collect();
        let sampling = COMPONENTS.map(|component| Sampling::new(table, component));
        let at_or_before = |step: usize| {
            let start = FRAC_PI_2 * (step as f64 - 1e-6) / GUIDES as f64;
            u16::try_from(theta.partition_point(|theta| *theta <= start)).unwrap_or(u16::MAX)
        };
        let guide = (0..=GUIDES).map(at_or_before).collect();
        let mut spans = theta.clone();
        if theta[0] > 0.0 {
            spans.insert(0, 0.0);
        }
        if theta[theta.len() - 1] < FRAC_PI_2 {
            spans.push(FRAC_PI_2);
        }
        let mut this = Self {
            axis,
            reciprocal: reciprocal::is_reciprocal(&table.meta),
            guide,
            theta,
            width,
            columns: axis.columns(),
            rows: axis.rows_per_incidence(),
            cell_width: axis.width(),
            inverse_width: 1.0 / axis.width(),
            values,
            sampling,
            spans: Vec::new(),
            along: Vec::new(),
            cap: Cap::new(axis.width().min(LARGEST_CAP)),
        };
        let at = |theta_i: f64| {
            let row = lobe.row(theta_i);
            Along {
                correction: COMPONENTS.map(|component| row.correction(component)),
                cap: this.cap_shares(theta_i),
            }
        };
        let step =
            |ends: &[f64], step: usize| at(ends[0] + step as f64 / SPAN_STEPS as f64 * (ends[1] - ends[0]));
        let along = spans.windows(2).map(|ends| std::array::from_fn(|k| step(ends, k))).collect();
        this.along = along;
        this.spans = spans;
        this
    }

    /// Share of what is sampled at θi that falls into the cap around the normal.
    fn cap_shares(&self, theta_i: f64) -> [f64; 2] {
        let between = self.between(theta_i);
        let columns = Warp::new(&self.axis.columns_at(theta_i));
        let position = |s: f64| columns.position_and_slope(s).0;
        let from = if self.signed() { position(-self.cap.radius) } else { 0.0 };
        let to = position(self.cap.radius);
        [0, 1].map(|component| {
            let sampling = &self.sampling[component];
            let inside = |node: usize| -> f64 {
                let rows = (0..self.rows).map(|row| {
                    let cells = self.cells(node, row);
                    let up_to =
                        |x: f64| cumulated(&sampling.u[cells.clone()], &sampling.cdf[cells.clone()], x);
                    up_to(to) - up_to(from)
                });
                rows.sum()
            };
            let total = sampling.mixed_total(between);
            let mixed =
                (1.0 - between.fraction) * inside(between.node) + between.fraction * inside(between.next);
            if total > 0.0 { (mixed / total).clamp(0.0, 1.0) } else { 0.0 }
        })
    }

    /// Whether columns run over signed exit angles (decay tables).
    const fn signed(&self) -> bool {
        matches!(self.axis, ExitAxis::Plane { .. })
    }

    /// The cells of a row.
    const fn cells(&self, node: usize, row: usize) -> std::ops::Range<usize> {
        let start = (node * self.rows + row) * self.columns;
        start..start + self.columns
    }

    /// The table at an incidence.
    #[inline]
    pub(crate) fn incidence(&self, at: &Polar) -> Incidence {
        let theta_i = at.theta;
        let between = self.between(theta_i);
        let (width, cells) = (self.cell_width, self.columns);
        // `ExitAxis::columns_at`, in few operations.
        let withdrawal = |room: f64| (room * room + width * width).sqrt() - room;
        let below_horizon = withdrawal(FRAC_PI_2 - theta_i);
        let lo = if self.signed() { -FRAC_PI_2 } else { 0.0 };
        let moved = withdrawal(theta_i - lo) - below_horizon;
        let columns = Warp::two_sided(lo, theta_i + moved, FRAC_PI_2, width, self.inverse_width, cells);
        let azimuth = if self.signed() {
            let (a, b) = (self.width[between.node], self.width[between.next]);
            let width = a + between.fraction * (b - a);
            Azimuth::Decay { concentration: at.sin / (width * width) }
        } else {
            let cot = angles::cotangent(at.sin, at.cos, moved);
            let width = width * cot;
            Azimuth::Walk(Warp::one_sided(0.0, PI, width, 1.0 / width, self.rows))
        };
        Incidence { between, along: self.along(theta_i, between), columns, azimuth }
    }

    #[inline]
    fn along(&self, theta_i: f64, between: Between) -> Along {
        // The first span ends at the first incidence unless that is 0.
        let before = usize::from(self.theta[0] > 0.0 && theta_i >= self.theta[0]);
        let span = (between.node + before).min(self.along.len() - 1);
        let (from, to) = (self.spans[span], self.spans[span + 1]);
        let step = ((theta_i - from) / (to - from)).clamp(0.0, 1.0) * SPAN_STEPS as f64;
        let index = (step as usize).min(SPAN_STEPS - 1);
        let (a, b) = (&self.along[span][index], &self.along[span][index + 1]);
        let t = step - index as f64;
        let mix = |a: [f64; 2], b: [f64; 2]| [0, 1].map(|c| a[c] + t * (b[c] - a[c]));
        Along { correction: mix(a.correction, b.correction), cap: mix(a.cap, b.cap) }
    }

    /// The exit cells.
    pub(crate) const fn axis(&self) -> &ExitAxis {
        &self.axis
    }

    /// A width in φ, radians, that resolves the decay around the mirror direction.
    pub(crate) fn decay_width(&self, at: &Incidence, sin_o: f64) -> f64 {
        match &at.azimuth {
            Azimuth::Decay { concentration } => (0.5 / (concentration * sin_o).sqrt()).clamp(1e-7, 1.0),
            Azimuth::Walk(_) => 1.0,
        }
    }

    #[inline]
    fn between(&self, theta_i: f64) -> Between {
        let last = self.theta.len() - 1;
        // `partition_point`, from where the guide says.
        let step = (theta_i * (GUIDES as f64 / FRAC_PI_2)) as usize;
        let mut above = usize::from(self.guide[step.min(GUIDES)]);
        while above <= last && self.theta[above] <= theta_i {
            above += 1;
        }
        if above == 0 {
            return Between { node: 0, next: 0, fraction: 0.0 };
        }
        if above > last {
            return Between { node: last, next: last, fraction: 0.0 };
        }
        let (lo, hi) = (self.theta[above - 1], self.theta[above]);
        Between { node: above - 1, next: above, fraction: (theta_i - lo) / (hi - lo) }
    }

    /// Where an exit direction lies; y2 = sin²(φ/2).
    #[inline]
    pub(crate) fn exit(&self, at: &Incidence, theta_o: f64, sin_o: f64, y2: f64) -> Exit {
        match &at.azimuth {
            Azimuth::Decay { concentration } => {
                let (forward, slope) = at.columns.position_and_slope(theta_o);
                let (retro, retro_slope) = at.columns.position_and_slope(-theta_o);
                Exit::Decay {
                    forward: Cell::new(forward, self.columns),
                    retro: Cell::new(retro, self.columns),
                    slopes: [slope, retro_slope],
                    concentration: concentration * sin_o,
                    sin_o,
                    y2,
                }
            }
            Azimuth::Walk(phi) => {
                let (column, slope) = at.columns.position_and_slope(theta_o);
                let (row, phi_slope) =
                    phi.position_and_slope(2.0 * angle(y2.sqrt(), (1.0 - y2).max(0.0).sqrt()));
                Exit::Walk {
                    column: Cell::new(column, self.columns),
                    row: Cell::new(row, self.rows),
                    measure: slope * phi_slope * sin_o,
                    sin_o,
                }
            }
        }
    }

    /// Whether the table is a reciprocal one.
    pub(crate) const fn is_reciprocal(&self) -> bool {
        self.reciprocal
    }

    /// f·cos θo in 1/sr of both components of a pair of directions, in reciprocal tables read at the larger one.
    #[inline]
    pub(crate) fn eval_pair(&self, at: &Incidence, exit: &Exit, i: &Polar, o: &Polar, y2: f64) -> [f64; 2] {
        if !self.reciprocal || o.theta <= i.theta {
            return self.eval(at, exit);
        }
        let larger = self.incidence(o);
        let back = self.exit(&larger, i.theta, i.sin, y2);
        let taken_over = o.cos / i.cos;
        self.eval(&larger, &back).map(|f| f * taken_over)
    }

    /// f·cos θo in 1/sr of both components, the albedo restored.
    #[inline]
    pub(crate) fn eval(&self, at: &Incidence, exit: &Exit) -> [f64; 2] {
        let values = match exit {
            Exit::Decay { forward, retro, concentration, y2, .. } => {
                let d = azimuth::decay(*concentration, *y2);
                let (ahead, back) = (self.read(at.between, 0, *forward), self.read(at.between, 0, *retro));
                [0, 1].map(|c| ahead[c] * d + back[c] * (1.0 - d))
            }
            Exit::Walk { column, row, .. } => {
                let near = self.read(at.between, row.index, *column);
                let far = self.read(at.between, row.index + 1, *column);
                [0, 1].map(|c| near[c] + row.fraction * (far[c] - near[c]))
            }
        };
        [0, 1].map(|c| at.along.correction[c] * values[c])
    }

    #[inline]
    fn read(&self, between: Between, row: usize, cell: Cell) -> [f64; 2] {
        let at = |node: usize| {
            let k = (node * self.rows + row) * self.columns + cell.index;
            let (a, b) = (self.values[k], self.values[k + 1]);
            [0, 1].map(|c| {
                let (a, b) = (f64::from(a[c]), f64::from(b[c]));
                a + cell.fraction * (b - a)
            })
        };
        let (a, b) = (at(between.node), at(between.next));
        [0, 1].map(|c| a[c] + between.fraction * (b[c] - a[c]))
    }

    /// Density per steradian with which [`Self::sample`] finds an exit direction, of one component.
    #[inline]
    pub(crate) fn pdf(&self, component: usize, at: &Incidence, exit: &Exit) -> f64 {
        let sampling = &self.sampling[component];
        let total = sampling.mixed_total(at.between);
        if total <= 0.0 {
            return 0.0;
        }
        let (Exit::Decay { sin_o, .. } | Exit::Walk { sin_o, .. }) = exit;
        if *sin_o < self.cap.sin {
            return at.along.cap[component] * self.cap.density;
        }
        match exit {
            Exit::Decay { forward, retro, slopes, concentration, sin_o, y2 } => {
                let ahead = self.density(sampling, at.between, 0, *forward) / slopes[0];
                let back = self.density(sampling, at.between, 0, *retro) / slopes[1];
                let around = Forward::new(*concentration).pdf(*y2);
                (ahead * around + back / TAU) / (total * sin_o)
            }
            Exit::Walk { column, row, measure, .. } => {
                let near = self.density(sampling, at.between, row.index, *column);
                let far = self.density(sampling, at.between, row.index + 1, *column);
                // Half of it on either side of the plane of incidence.
                0.5 * (near + row.fraction * (far - near)) / (total * measure)
            }
        }
    }

    #[inline]
    fn density(&self, sampling: &Sampling, between: Between, row: usize, cell: Cell) -> f64 {
        let at = |node: usize| {
            let k = (node * self.rows + row) * self.columns + cell.index;
            sampling.u[k] + cell.fraction * (sampling.u[k + 1] - sampling.u[k])
        };
        let (a, b) = (at(between.node), at(between.next));
        a + between.fraction * (b - a)
    }

    /// An exit direction (θo, and cos φ, sin φ) of one component from three uniform numbers.
    pub(crate) fn sample(
        &self,
        component: usize,
        at: &Incidence,
        select: f64,
        u: f64,
        v: f64,
    ) -> Option<(f64, (f64, f64))> {
        let around = |u: f64| {
            let (sin, cos) = (PI * (2.0 * u - 1.0)).sin_cos();
            (cos, sin)
        };
        let sampling = &self.sampling[component];
        let Between { node, next, fraction } = at.between;
        let (near, far) = ((1.0 - fraction) * sampling.total[node], fraction * sampling.total[next]);
        if near + far <= 0.0 {
            return None;
        }
        let (node, select) = split(select, near / (near + far), node, next);
        match &at.azimuth {
            Azimuth::Decay { concentration } => {
                let position = self.invert_row(sampling, node, 0, u);
                let s = at.columns.at(position).clamp(-FRAC_PI_2, FRAC_PI_2);
                if s.abs() < self.cap.radius {
                    // Neither the number that chose the row nor v has said anything yet.
                    return Some((self.cap.theta(select), around(v)));
                }
                let phi = if s >= 0.0 { Forward::new(concentration * s.sin()).sample(v) } else { around(v) };
                Some((s.abs(), phi))
            }
            Azimuth::Walk(phi) => {
                let (sign, v) = if v < 0.5 { (1.0, 2.0 * v) } else { (-1.0, 2.0 * v - 1.0) };
                let rows = node * self.rows..(node + 1) * self.rows;
                let totals = &sampling.row_total[rows.clone()];
                let guide = &sampling.row_guide[rows.clone()];
                let position = invert(totals, &sampling.row_cdf[rows], guide, v);
                let row = Cell::new(position, self.rows);
                let (near, far) =
                    ((1.0 - row.fraction) * totals[row.index], row.fraction * totals[row.index + 1]);
                let (row, select) = split(select, near / (near + far), row.index, row.index + 1);
                let theta_o = at.columns.at(self.invert_row(sampling, node, row, u)).clamp(0.0, FRAC_PI_2);
                if theta_o < self.cap.radius {
                    let cells = self.cells(node, row);
                    let (density, cdf) = (&sampling.u[cells.clone()], &sampling.cdf[cells]);
                    let edge = at.columns.position_and_slope(self.cap.radius).0;
                    let within = cumulated(density, cdf, edge) / total(density, cdf);
                    return Some((self.cap.theta((u / within).min(1.0)), around(select)));
                }
                let (sin, cos) = phi.at(position).min(PI).sin_cos();
                Some((theta_o, (cos, sign * sin)))
            }
        }
    }

    fn invert_row(&self, sampling: &Sampling, node: usize, row: usize, u: f64) -> f64 {
        let cells = self.cells(node, row);
        invert(&sampling.u[cells.clone()], &sampling.cdf[cells.clone()], &sampling.guide[cells], u)
    }
}

/// Chooses between two with the probability of the first, and what is left of the random number.
#[inline]
fn split(u: f64, first: f64, a: usize, b: usize) -> (usize, f64) {
    if u < first { (a, u / first) } else { (b, (u - first) / (1.0 - first).max(f64::MIN_POSITIVE)) }
}

/// Position where the integral of a piecewise-linear density reaches the share u of its total.
///
/// The density is u\[k\] at position k + ½, linear between, constant in the outer half cells; `cdf\[k\]` is its
/// integral up to position k + ½; `guide` says where to begin looking in it ([`guide`]).
#[inline]
fn invert(density: &[f64], cdf: &[f64], guide: &[u16], share: f64) -> f64 {
    let last = density.len() - 1;
    let target = share * total(density, cdf);
    // `partition_point`, from where the guide says.
    let step = (share * guide.len() as f64) as usize;
    let mut above = usize::from(guide[step.min(last)]);
    while above <= last && cdf[above] <= target {
        above += 1;
    }
    if above == 0 {
        return 0.5 * target / cdf[0];
    }
    if above > last {
        let rest = if density[last] > 0.0 { (target - cdf[last]) / density[last] } else { 0.0 };
        return last as f64 + 0.5 + rest.clamp(0.0, 0.5);
    }
    let k = above - 1;
    let (a, b, rest) = (density[k], density[k + 1], target - cdf[k]);
    // a·t + (b − a)·t²/2 = rest, in the form that does not cancel.
    let root = (a * a + 2.0 * (b - a) * rest).max(0.0).sqrt();
    let t = if a + root > 0.0 { (2.0 * rest / (a + root)).min(1.0) } else { 0.0 };
    k as f64 + 0.5 + t
}

/// Integral of such a density over all positions.
#[inline]
fn total(density: &[f64], cdf: &[f64]) -> f64 {
    cdf[cdf.len() - 1] + 0.5 * density[density.len() - 1]
}

/// Integral of such a density up to a position.
fn cumulated(density: &[f64], cdf: &[f64], position: f64) -> f64 {
    let last = density.len() - 1;
    let from_first = position - 0.5;
    if from_first <= 0.0 {
        return position.max(0.0) * density[0];
    }
    let k = (from_first as usize).min(last);
    let t = from_first - k as f64;
    let next = density[(k + 1).min(last)];
    cdf[k] + t * (density[k] + 0.5 * t * (next - density[k]))
}

/// Integral up to each centre.
fn cumulate(density: &[f64], cdf: &mut Vec<f64>) {
    let mut sum = 0.5 * density[0];
    cdf.push(sum);
    for pair in density.windows(2) {
        sum += 0.5 * (pair[0] + pair[1]);
        cdf.push(sum);
    }
}

/// Where to begin looking for a share of a row's total: centres surely below each of as many equal steps as there are cells.
fn guide(density: &[f64], cdf: &[f64], guide: &mut Vec<u16>) {
    let (total, cells) = (total(density, cdf), cdf.len());
    let mut above = 0;
    for step in 0..cells {
        // Short of the step by more than rounding.
        let target = total * (step as f64 - 1e-6) / cells as f64;
        while above < cells && cdf[above] <= target {
            above += 1;
        }
        guide.push(u16::try_from(above).unwrap_or(u16::MAX));
    }
}

impl Sampling {
    fn new(table: &Table, component: Component) -> Self {
        let axis = &table.meta.exit_axis;
        let (columns, rows) = (axis.columns(), axis.rows_per_incidence());
        let samples = &table.lobe(component).value;
        let mut this = Self {
            u: Vec::with_capacity(samples.len()),
            cdf: Vec::with_capacity(samples.len()),
            guide: Vec::with_capacity(samples.len()),
            row_guide: Vec::new(),
            row_total: Vec::new(),
            row_cdf: Vec::new(),
            total: Vec::new(),
        };
        for (i, summary) in table.meta.per_incidence.iter().enumerate() {
            let theta_i = summary.theta_i_deg.to_radians();
            let measure = measures(axis, theta_i, summary.azimuth_width_deg.to_radians());
            let values = &samples[i * axis.cells()..(i + 1) * axis.cells()];
            let first_row = this.row_total.len();
            for row in 0..rows {
                let start = this.u.len();
                let cells = row * columns..(row + 1) * columns;
                this.u.extend(cells.map(|k| f64::from(values[k]) * measure[k]));
                let u = &this.u[start..];
                this.row_total.push(u.iter().sum());
                cumulate(u, &mut this.cdf);
                guide(u, &this.cdf[start..], &mut this.guide);
            }
            let totals = &this.row_total[first_row..];
            this.total.push(totals.iter().sum());
            cumulate(totals, &mut this.row_cdf);
            guide(totals, &this.row_cdf[first_row..], &mut this.row_guide);
        }
        this
    }

    #[inline]
    fn mixed_total(&self, between: Between) -> f64 {
        let (a, b) = (self.total[between.node], self.total[between.next]);
        a + between.fraction * (b - a)
    }
}

/// dω/dposition at every cell centre of one incidence; the azimuth is integrated over in decay tables.
fn measures(axis: &ExitAxis, theta_i: f64, width: f64) -> Vec<f64> {
    let columns = axis.columns_at(theta_i);
    let centres = columns.centres();
    let slopes: Vec<f64> = (0..columns.cells).map(|k| columns.slope(k as f64 + 0.5)).collect();
    let Some(phi) = axis.phi_at(theta_i) else {
        let measure = |(s, slope): (&f64, &f64)| {
            let mean = decay::mean_decay(decay::concentration(theta_i, *s, width));
            TAU * s.sin().abs() * slope * if *s >= 0.0 { mean } else { 1.0 - mean }
        };
        return centres.iter().zip(&slopes).map(measure).collect();
    };
    let band: Vec<f64> = centres.iter().zip(&slopes).map(|(theta, slope)| theta.sin() * slope).collect();
    (0..phi.cells).flat_map(|row| band.iter().map(move |b| b * phi.slope(row as f64 + 0.5))).collect()
}
