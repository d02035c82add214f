//! The lobes interior and rehit of one band: arrays, read by the rule of [`lut_io::lobe`].
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

pub(crate) mod azimuth;
pub(crate) mod distribution;
pub(crate) mod integral;
pub(crate) mod many;

use crate::numerics::angles::{self, INVERSE_TAU, Polar, greatest, least};
use crate::numerics::single::{angle, step_of, whole};
use crate::numerics::warp::{Cell, Warp};
use azimuth::Forward;
use distribution::Distribution;
use lut_io::axis::ExitAxis;
use std::f64::consts::{FRAC_PI_2, PI};

/// The cap around the normal in which the sampling density is even.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cap {
    /// Radians.
    pub(crate) radius: f64,
    sin: f64,
    /// sin² of half the radius: half the height of the cap.
    half_chord2: f64,
    /// One over its solid angle.
    density: f64,
}

impl Cap {
    pub(crate) fn new(radius: f64) -> Self {
        let half_chord2 = (0.5 * radius).sin().powi(2);
        Self { radius, sin: radius.sin(), half_chord2, density: 0.25 / (PI * half_chord2) }
    }

    /// θo of a point of the cap, by the share of its area nearer to the normal.
    #[inline(always)]
    pub(crate) fn theta(&self, area: f64) -> f64 {
        let sin2 = self.half_chord2 * area;
        2.0 * angles::angle(sin2, (1.0 - sin2).sqrt())
    }
}

/// Both lobes of one band; made by [`crate::prepare`].
#[derive(Clone, Debug)]
pub(crate) struct Lobes {
    pub(crate) axis: ExitAxis,
    /// Whether the table is read at the larger of both angles ([`lut_io::reciprocal`]).
    pub(crate) reciprocal: bool,
    /// Ranges of θi that one pair of rows serves, from 0 to π/2, and where each begins; behind the last one, infinity.
    pub(crate) spans: Vec<Span>,
    pub(crate) starts: Vec<f64>,
    /// Where to begin looking for an angle among them: the one at each of [`GUIDES`] equal steps to π/2, or one before.
    pub(crate) guide: Vec<u16>,
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    /// Stretch width of the cells, radians, and its inverse.
    pub(crate) cell_width: f64,
    pub(crate) inverse_width: f64,
    /// \[incidence, φ row, column\].
    pub(crate) cells: Vec<Values>,
    /// Σ of the sampling density of each incidence, both lobes.
    pub(crate) totals: Vec<[f32; 2]>,
    /// What is sampled of interior and of rehit.
    pub(crate) distributions: [Distribution; 2],
    /// \[span, step\]: at equal steps of each span; smooth within it, with a kink at its ends.
    pub(crate) span_curves: Vec<SpanCurves>,
    pub(crate) span_steps: usize,
    pub(crate) cap: Cap,
    /// Columns of some incidence: all but their centre and gains are those of every incidence.
    pub(crate) some_columns: Warp,
}

/// Of one cell: interior and rehit, f·cos θo in 1/sr, then the densities u with which each is sampled.
pub(crate) type Values = [f32; 4];

/// Where the densities begin in [`Values`].
pub(crate) const DENSITIES: usize = 2;

/// A range of θi between two incidences of the table, or between the last one and the end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    pub(crate) from: f64,
    /// One over its length.
    pub(crate) inverse: f64,
    /// The incidences at its ends; the same one twice beyond the last.
    pub(crate) node: usize,
    pub(crate) next: usize,
    /// w of the decay postulate at `from`, and what it gains to the end, radians.
    pub(crate) width: f32,
    pub(crate) widening: f32,
}

/// What is known over the θi of a span, of interior and rehit: what is read over the albedo, which restores it, and the share of what
/// is sampled that falls into the cap around the normal. A mixture's light is nearly linear along a span; one over it is not where a
/// row adds many times its share, as that of the normal does in a space table.
pub(crate) type SpanCurves = [f32; 4];

/// Where these shares begin in [`SpanCurves`].
const CAP: usize = 2;

/// Steps of [`Lobes::guide`].
pub(crate) const GUIDES: usize = 1024;

/// Two incidences and how far (0..1) θi lies between them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Between {
    pub(crate) node: usize,
    pub(crate) next: usize,
    pub(crate) fraction: f32,
}

/// The lobes at one incidence.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incidence {
    pub(crate) between: Between,
    along: SpanCurves,
    pub(crate) columns: Warp,
    /// Decay tables: sin θi / w². Space tables: the width of the φ cells.
    pub(crate) azimuth: f32,
}

/// Both lobes at a pair of directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Light {
    /// f·cos θo in 1/sr, the albedo restored.
    pub(crate) values: [f64; 2],
    /// Densities per steradian with which [`Lobes::sample`] finds the exit direction.
    pub(crate) densities: [f64; 2],
}

impl Lobes {
    /// Whether columns run over signed exit angles (decay tables).
    pub(crate) const fn signed(&self) -> bool {
        matches!(self.axis, ExitAxis::Plane { .. })
    }

    /// The cells of a row.
    pub(crate) const fn range(&self, node: usize, row: usize) -> std::ops::Range<usize> {
        let start = (node * self.rows + row) * self.columns;
        start..start + self.columns
    }

    /// The table at an incidence.
    #[inline(always)]
    pub(crate) fn incidence(&self, at: &Polar) -> Incidence {
        let (columns, moved) = self.columns_at(at.theta);
        let (span, between) = self.between(at.theta);
        let azimuth = if self.signed() {
            let Span { width, widening, .. } = self.spans[span];
            concentration_of_sine(at.sin, width + between.fraction * widening)
        } else {
            self.row_width(at.sin, at.cos, moved)
        };
        let mut along = self.curves_at(span, self.step_of_span(between.fraction));
        restore(&mut along);
        Incidence { between, along, columns, azimuth }
    }

    /// [`ExitAxis::columns_at`] in few operations, and how far its centre is moved from θi.
    #[inline(always)]
    pub(crate) fn columns_at(&self, theta_i: f64) -> (Warp, f64) {
        let (width, cells) = (self.cell_width, self.columns);
        let lo = if self.signed() { -FRAC_PI_2 } else { 0.0 };
        // θi + (√(below² + width²) − below) − (√(above² + width²) − above), and below + above = π/2 − lo.
        let far = |room: f64| (room * room + width * width).sqrt();
        let centre = (far(theta_i - lo) - far(FRAC_PI_2 - theta_i)) + ((lo + FRAC_PI_2) - theta_i);
        (Warp::two_sided(lo, centre, FRAC_PI_2, width, self.inverse_width, cells), centre - theta_i)
    }

    /// Width of the φ cells of space tables at an incidence.
    #[inline(always)]
    fn row_width(&self, sin_i: f64, cos_i: f64, moved: f64) -> f32 {
        (self.cell_width * angles::cotangent(sin_i, cos_i, moved)) as f32
    }

    /// The φ axis of space tables whose φ cells have this width.
    #[inline(always)]
    pub(crate) fn around(&self, width: f32) -> Warp {
        Warp::one_sided(0.0, PI, f64::from(width), f64::from(1.0 / width), self.rows)
    }

    #[inline(always)]
    fn curves_at(&self, span: usize, (index, t): (usize, f32)) -> SpanCurves {
        let first = span * (self.span_steps + 1) + index;
        let [a, b] = &self.span_curves[first..first + 2] else { return [1.0; 4] };
        angles::between(a, b, t)
    }

    /// Step of a span's [`SpanCurves`], and how far to the next.
    #[inline(always)]
    fn step_of_span(&self, fraction: f32) -> (usize, f32) {
        step_of(fraction * whole(self.span_steps), whole(self.span_steps - 1))
    }

    /// A width in φ, radians, that resolves the decay of a decay table around the mirror direction, from [`Self::LEAST_DECAY_WIDTH`] to 1.
    pub(crate) fn decay_width(&self, at: &Incidence, sin_o: f64) -> f64 {
        (0.5 / (f64::from(at.azimuth) * sin_o).sqrt()).clamp(Self::LEAST_DECAY_WIDTH, 1.0)
    }

    /// The narrowest decay that is resolved, radians.
    pub(crate) const LEAST_DECAY_WIDTH: f64 = 1e-7;

    /// The span of θi, and how far along it.
    #[inline(always)]
    pub(crate) fn between(&self, theta_i: f64) -> (usize, Between) {
        let index = self.span_of(theta_i, guide_step(theta_i));
        let Span { from, inverse, node, next, .. } = self.spans[index];
        (index, Between { node, next, fraction: fraction_of_span(theta_i, from, inverse) })
    }

    /// The span of θi, whose [`guide_step`] is known.
    #[inline(always)]
    fn span_of(&self, theta_i: f64, guide_step: usize) -> usize {
        // A step may have been rounded up to: the guide of the one before.
        let guided = usize::from(self.guide[guide_step.saturating_sub(1)]);
        // One step without a branch, which random angles would mispredict; more are seldom.
        let mut index = guided + usize::from(self.starts[guided + 1] <= theta_i);
        while self.starts[index + 1] <= theta_i {
            index += 1;
        }
        index
    }

    /// What a pair of directions has, y2 = sin²(φ/2); in reciprocal tables values are read at the larger angle.
    #[inline(always)]
    pub(crate) fn light(&self, at: &Incidence, i: &Polar, o: &Polar, y2: f64) -> Light {
        let mut light = self.light_of(at, o.theta, o.sin, y2);
        if self.reciprocal && o.theta > i.theta {
            light.values = self.values_back(i, o, y2);
        }
        light
    }

    #[inline(always)]
    fn light_of(&self, at: &Incidence, theta_o: f64, sin_o: f64, y2: f64) -> Light {
        if self.signed() {
            self.light_of_plane(at, theta_o, sin_o, y2)
        } else {
            self.light_of_space(at, theta_o, sin_o, y2)
        }
    }

    /// Values of the way back, taken over to the way there.
    #[inline(never)]
    fn values_back(&self, i: &Polar, o: &Polar, y2: f64) -> [f64; 2] {
        let back = self.light_of(&self.incidence(o), i.theta, i.sin, y2);
        let taken_over = o.cos / i.cos;
        back.values.map(|f| f * taken_over)
    }

    /// Of decay tables.
    #[inline(always)]
    fn light_of_plane(&self, at: &Incidence, theta_o: f64, sin_o: f64, y2: f64) -> Light {
        let [(forward, per_ahead), (retro, per_back)] = at.columns.positions([theta_o, -theta_o]);
        let forward = self.read(at.between, 0, Cell::new(forward, self.columns));
        let retro = self.read(at.between, 0, Cell::new(retro, self.columns));
        let (concentration, y2) = (at.azimuth * sin_o as f32, y2 as f32);
        let values = angles::between(&retro, &forward, azimuth::decay(concentration, y2));
        let densities = densities_of_plane(
            &forward,
            &retro,
            Forward::new(concentration).pdf(y2) * per_ahead,
            INVERSE_TAU as f32 * per_back,
        );
        let densities = self.per_steradian(at.between, &at.along, densities, 1.0 / sin_o as f32, sin_o);
        Light { values: restored(&at.along, &values), densities }
    }

    /// Of space tables.
    #[inline(always)]
    fn light_of_space(&self, at: &Incidence, theta_o: f64, sin_o: f64, y2: f64) -> Light {
        let (column, per_theta) = at.columns.position(theta_o);
        let (row, per_phi) = self.around(at.azimuth).position(azimuth_of(y2));
        let (column, row) = (Cell::new(column, self.columns), Cell::new(row, self.rows));
        let read = self.read_rows(at.between, row, column);
        let densities = [read[DENSITIES], read[DENSITIES + 1]];
        let scale = scale_of_space(per_theta, per_phi, sin_o);
        let densities = self.per_steradian(at.between, &at.along, densities, scale, sin_o);
        Light { values: restored(&at.along, &read), densities }
    }

    /// Sampling densities in solid angle from those in cell positions, `scale` apart.
    #[inline(always)]
    fn per_steradian(
        &self,
        between: Between,
        along: &SpanCurves,
        densities: [f32; 2],
        scale: f32,
        sin_o: f64,
    ) -> [f64; 2] {
        if sin_o < self.cap.sin {
            return [0, 1].map(|c| f64::from(along[CAP + c]) * self.cap.density);
        }
        let totals = self.mixed_totals(between);
        let share =
            |c: usize| if totals[c] > 0.0 { f64::from(densities[c] * scale / totals[c] as f32) } else { 0.0 };
        [share(0), share(1)]
    }

    /// The [`Values`] at a row.
    #[inline(always)]
    pub(crate) fn read(&self, between: Between, row: usize, cell: Cell) -> Values {
        let (within, cells) = (row * self.columns + cell.index, self.rows * self.columns);
        let near = self.read_cells(between.node * cells + within, cell.fraction);
        let far = self.read_cells(between.next * cells + within, cell.fraction);
        angles::between(&near, &far, between.fraction)
    }

    /// The [`Values`] between two rows of a space table.
    #[inline(always)]
    fn read_rows(&self, between: Between, row: Cell, column: Cell) -> Values {
        let near = self.read(between, row.index, column);
        let far = self.read(between, row.index + 1, column);
        angles::between(&near, &far, row.fraction)
    }

    /// The [`Values`] between a cell and the next one.
    #[inline(always)]
    fn read_cells(&self, cell: usize, along: f32) -> Values {
        let [a, b] = &self.cells[cell..cell + 2] else { return [0.0; 4] };
        angles::between(a, b, along)
    }

    #[inline(always)]
    pub(crate) fn mixed_totals(&self, between: Between) -> [f64; 2] {
        let [a, b] = [between.node, between.next].map(|node| self.totals[node].map(f64::from));
        let fraction = f64::from(between.fraction);
        [0, 1].map(|c| a[c] + fraction * (b[c] - a[c]))
    }
}

/// Turns what is read over the albedo into what restores it.
#[inline(always)]
fn restore(along: &mut SpanCurves) {
    let [interior, rehit, ..] = along;
    (*interior, *rehit) = (1.0 / *interior, 1.0 / *rehit);
}

/// Both components as read, times what restores their albedo.
#[inline(always)]
fn restored(along: &SpanCurves, values: &Values) -> [f64; 2] {
    [f64::from(values[0] * along[0]), f64::from(values[1] * along[1])]
}

/// Sampling densities of a decay table per position in s and azimuth: of what is read ahead and of what is read behind.
#[inline(always)]
fn densities_of_plane(forward: &Values, retro: &Values, ahead: f32, back: f32) -> [f32; 2] {
    let density = |c: usize| forward[c] * ahead + retro[c] * back;
    [density(DENSITIES), density(DENSITIES + 1)]
}

/// Positions of a space table per solid angle: half of the light is on either side of the plane of incidence.
#[inline(always)]
fn scale_of_space(per_theta: f32, per_phi: f32, sin_o: f64) -> f32 {
    0.5 * per_theta * per_phi / sin_o as f32
}

/// sin θi / w², which the sine of θo turns into the concentration of the decay.
#[inline(always)]
fn concentration_of_sine(sin_i: f64, width: f32) -> f32 {
    sin_i as f32 / (width * width)
}

/// |φ| from sin²(φ/2).
#[inline(always)]
fn azimuth_of(y2: f64) -> f64 {
    f64::from(2.0 * angle(y2 as f32, greatest((1.0 - y2) as f32, 0.0).sqrt()))
}

/// Step of [`Lobes::guide`] at an angle.
#[inline(always)]
fn guide_step(theta_i: f64) -> usize {
    step_of(theta_i as f32 * (GUIDES as f64 / FRAC_PI_2) as f32, GUIDES as f32).0
}

/// How far θi is along its span.
#[inline(always)]
fn fraction_of_span(theta_i: f64, from: f64, inverse: f64) -> f32 {
    least(((theta_i - from) * inverse) as f32, 1.0)
}
