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

pub(crate) mod many;

use crate::angles::{self, INVERSE_TAU, Polar, greatest, least, turned};
use crate::azimuth::{self, Forward};
use crate::single::{angle, step_of};
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
    #[inline(always)]
    fn theta(&self, area: f64) -> f64 {
        let sin2 = self.half_chord2 * area;
        2.0 * angles::angle(sin2.sqrt(), (1.0 - sin2).sqrt())
    }
}

/// Both lobes of a table.
#[derive(Clone, Debug)]
pub(crate) struct Tabulated {
    axis: ExitAxis,
    /// Whether the table is read at the larger of both angles ([`lut_io::reciprocal`]).
    reciprocal: bool,
    /// Ranges of θi that one pair of rows serves, from 0 to π/2, and where each begins; behind the last one, infinity.
    spans: Vec<Span>,
    starts: Vec<f64>,
    /// Where to begin looking for an angle among them: the one at each of [`GUIDES`] equal steps to π/2, or one before.
    guide: Vec<u16>,
    columns: usize,
    rows: usize,
    /// Stretch width of the cells, radians, and its inverse.
    cell_width: f64,
    inverse_width: f64,
    cells: Vec<Values>,
    /// Σ of the sampling density of each incidence, both components.
    totals: Vec<[f64; 2]>,
    sampling: [Sampling; 2],
    /// At equal steps of each span: smooth within it, with a kink at its ends.
    along: Vec<Along>,
    span_steps: usize,
    cap: Cap,
    /// Columns of some incidence: all but their centre and gains are those of every incidence.
    some_columns: Warp,
}

/// Of one cell: interior and rehit, f·cos θo in 1/sr, then the densities u with which each is sampled.
type Values = [f32; 4];

/// Where the densities begin in [`Values`].
const DENSITIES: usize = 2;

/// A range of θi between two incidences of the table, or between the last one and the end.
#[derive(Clone, Copy, Debug)]
struct Span {
    from: f64,
    /// One over its length.
    inverse: f64,
    /// The incidences at its ends; the same one twice beyond the last.
    node: usize,
    next: usize,
    /// w of the decay postulate at `from`, and what it gains to the end, radians.
    width: f32,
    widening: f32,
}

/// What is known along θi, of interior and rehit: what is read over the albedo, which restores it, and the share of what is sampled
/// that falls into the cap around the normal. A mixture's light is nearly linear along a span; one over it is not where a row adds
/// many times its share, as that of the normal does in a space table.
type Along = [f32; 4];

/// Area of what is outside the cap.
const OUTSIDE: f64 = -1.0;

/// Most that is read for an albedo.
const DARKEST: f64 = 1e30;
/// How far within a span its ends are, in lengths of it.
const INSIDE: f64 = 1e-6;

/// Where these shares begin in [`Along`].
const CAP: usize = 2;

/// Steps of [`Tabulated::guide`].
const GUIDES: usize = 1024;

/// Steps of every span at which [`Along`] is known; the Mitsuba plugin has the same. Sixteen miss its curvature at grazing incidence by
/// 2e-4; where rows are many widths of their facets apart it grows with that number, and would be missed by half a per cent.
fn span_steps(spans: &[Span], width: f64) -> usize {
    let longest = spans.iter().map(|span| 1.0 / span.inverse).fold(0.0, f64::max);
    // Short of whole numbers by more than rounding.
    let finer = ((longest / width).sqrt().log2() - 1e-6).ceil().clamp(0.0, 4.0);
    64 << finer as u32
}

/// Piecewise-linear densities of one component, every incidence.
#[derive(Clone, Debug)]
struct Sampling {
    /// Integral of u up to each cell centre of a row.
    cdf: Vec<f64>,
    /// Where to begin looking in `cdf` of a row ([`guide`]), and in `row_cdf` of an incidence.
    guide: Vec<u16>,
    row_guide: Vec<u16>,
    /// Σ u of each row.
    row_total: Vec<f64>,
    /// Integral of the rows' totals up to the centre of each φ row of an incidence.
    row_cdf: Vec<f64>,
}

/// Two incidences and how far (0..1) θi lies between them.
#[derive(Clone, Copy, Debug)]
struct Between {
    node: usize,
    next: usize,
    fraction: f32,
}

/// The table at one incidence.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incidence {
    between: Between,
    along: Along,
    columns: Warp,
    /// Decay tables: sin θi / w². Space tables: the width of the φ cells.
    azimuth: f32,
}

/// Where the integral of a piecewise-linear density reaches its target: behind a position, with the densities there and at the
/// next one, and what is left of the target.
#[derive(Clone, Copy, Debug)]
struct Found {
    base: f64,
    density: [f64; 2],
    rest: f64,
}

/// An exit direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exit {
    pub(crate) cos: f64,
    pub(crate) sin: f64,
    /// cos and sin of φ.
    pub(crate) azimuth: (f64, f64),
}

/// Both tabulated components at a pair of directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Light {
    /// f·cos θo in 1/sr, the albedo restored.
    pub(crate) values: [f64; 2],
    /// Densities per steradian with which [`Tabulated::sample`] finds the exit direction.
    pub(crate) densities: [f64; 2],
}

impl Tabulated {
    pub(crate) fn new(lobe: &Interpolant) -> Self {
        let table = lobe.table();
        let axis = table.meta.exit_axis;
        let cells = cells(table);
        let sampling = [0, 1].map(|component| Sampling::new(table, &cells, component));
        let spans = spans(table);
        let at_or_before = |step: usize| {
            let start = FRAC_PI_2 * (step as f64 - 1e-6) / GUIDES as f64;
            let span = spans.partition_point(|span| span.from <= start).saturating_sub(1);
            u16::try_from(span).unwrap_or(u16::MAX)
        };
        let guide = (0..=GUIDES).map(at_or_before).collect();
        let starts = spans.iter().map(|span| span.from).chain([f64::INFINITY]).collect();
        let rows = axis.rows_per_incidence();
        let total = |node: usize| {
            sampling.each_ref().map(|s| s.row_total[node * rows..(node + 1) * rows].iter().sum::<f64>())
        };
        let span_steps = span_steps(&spans, axis.width());
        let mut this = Self {
            axis,
            reciprocal: reciprocal::is_reciprocal(&table.meta),
            guide,
            starts,
            spans,
            columns: axis.columns(),
            rows,
            cell_width: axis.width(),
            inverse_width: 1.0 / axis.width(),
            cells,
            totals: (0..table.meta.per_incidence.len()).map(total).collect(),
            sampling,
            along: Vec::new(),
            span_steps,
            cap: Cap::new(axis.width().min(LARGEST_CAP)),
            some_columns: Warp::new(&axis.columns_at(0.25 * PI)),
        };
        let at = |theta_i: f64| {
            let row = lobe.row(theta_i);
            let [interior, rehit] =
                COMPONENTS.map(|component| least(1.0 / row.correction(component), DARKEST));
            let cap = this.cap_shares(theta_i);
            [interior, rehit, cap[0], cap[1]].map(|known| known as f32)
        };
        let along = this.spans.iter().flat_map(|span| {
            // Where a component goes out at an end, what it tends to counts, not 0/0.
            let share = move |k: usize| (k as f64 / span_steps as f64).clamp(INSIDE, 1.0 - INSIDE);
            (0..=span_steps).map(move |k| span.from + share(k) / span.inverse)
        });
        this.along = along.map(at).collect();
        this
    }

    /// Share of what is sampled at θi that falls into the cap around the normal.
    fn cap_shares(&self, theta_i: f64) -> [f64; 2] {
        let (_, between) = self.between(theta_i);
        let columns = Warp::new(&self.axis.columns_at(theta_i));
        let position = |s: f64| f64::from(columns.position(s).0);
        let from = if self.signed() { position(-self.cap.radius) } else { 0.0 };
        let to = position(self.cap.radius);
        [0, 1].map(|component| {
            let sampling = &self.sampling[component];
            let inside = |node: usize| -> f64 {
                let rows = (0..self.rows).map(|row| {
                    let range = self.range(node, row);
                    let density = |k: usize| f64::from(self.cells[range.start + k][DENSITIES + component]);
                    let up_to = |x: f64| cumulated(density, &sampling.cdf[range.clone()], x);
                    up_to(to) - up_to(from)
                });
                rows.sum()
            };
            let total = self.mixed_totals(between)[component];
            let fraction = f64::from(between.fraction);
            let mixed = (1.0 - fraction) * inside(between.node) + fraction * inside(between.next);
            if total > 0.0 { (mixed / total).clamp(0.0, 1.0) } else { 0.0 }
        })
    }

    /// Whether columns run over signed exit angles (decay tables).
    const fn signed(&self) -> bool {
        matches!(self.axis, ExitAxis::Plane { .. })
    }

    /// The cells of a row.
    const fn range(&self, node: usize, row: usize) -> std::ops::Range<usize> {
        let start = (node * self.rows + row) * self.columns;
        start..start + self.columns
    }

    /// The table at an incidence.
    #[inline(always)]
    pub(crate) fn incidence(&self, at: &Polar) -> Incidence {
        let (span, between) = self.between(at.theta);
        let (columns, moved) = self.columns_at(at.theta);
        let azimuth = if self.signed() {
            let Span { width, widening, .. } = self.spans[span];
            concentration_of_sine(at.sin, width + between.fraction * widening)
        } else {
            self.row_width(at.sin, at.cos, moved)
        };
        let mut along = self.along(span, self.along_step(between.fraction));
        restore(&mut along);
        Incidence { between, along, columns, azimuth }
    }

    /// [`ExitAxis::columns_at`] in few operations, and how far its centre is moved from θi.
    #[inline(always)]
    fn columns_at(&self, theta_i: f64) -> (Warp, f64) {
        let (width, cells) = (self.cell_width, self.columns);
        let lo = if self.signed() { -FRAC_PI_2 } else { 0.0 };
        let width2 = (width * width) as f32;
        // √(room² + width²) − room without its cancellation.
        let withdrawal = |room: f32| width2 / ((room * room + width2).sqrt() + room);
        let moved = f64::from(withdrawal((theta_i - lo) as f32) - withdrawal((FRAC_PI_2 - theta_i) as f32));
        (Warp::two_sided(lo, theta_i + moved, FRAC_PI_2, width, self.inverse_width, cells), moved)
    }

    /// Width of the φ cells of space tables at an incidence.
    #[inline(always)]
    fn row_width(&self, sin_i: f64, cos_i: f64, moved: f64) -> f32 {
        (self.cell_width * angles::cotangent(sin_i, cos_i, moved)) as f32
    }

    /// The φ axis of space tables whose φ cells have this width.
    #[inline(always)]
    fn around(&self, width: f32) -> Warp {
        Warp::one_sided(0.0, PI, f64::from(width), f64::from(1.0 / width), self.rows)
    }

    #[inline(always)]
    fn along(&self, span: usize, (index, t): (usize, f32)) -> Along {
        let first = span * (self.span_steps + 1) + index;
        let [a, b] = &self.along[first..first + 2] else { return [1.0; 4] };
        angles::between(a, b, t)
    }

    /// Step of a span's [`Along`], and how far to the next.
    #[inline(always)]
    fn along_step(&self, fraction: f32) -> (usize, f32) {
        step_of(fraction * self.span_steps as f32, (self.span_steps - 1) as f32)
    }

    /// The exit cells.
    pub(crate) const fn axis(&self) -> &ExitAxis {
        &self.axis
    }

    /// A width in φ, radians, that resolves the decay around the mirror direction.
    pub(crate) fn decay_width(&self, at: &Incidence, sin_o: f64) -> f64 {
        if self.signed() { (0.5 / (f64::from(at.azimuth) * sin_o).sqrt()).clamp(1e-7, 1.0) } else { 1.0 }
    }

    /// The span of θi, and how far along it.
    #[inline(always)]
    fn between(&self, theta_i: f64) -> (usize, Between) {
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

    /// Whether the table is a reciprocal one.
    pub(crate) const fn is_reciprocal(&self) -> bool {
        self.reciprocal
    }

    /// What a pair of directions has, y2 = sin²(φ/2); in reciprocal tables values are read at the larger angle.
    #[inline(always)]
    pub(crate) fn light(&self, at: &Incidence, i: &Polar, o: &Polar, y2: f64) -> Light {
        let mut light = if self.signed() {
            self.light_of_plane(at, o.theta, o.sin, y2)
        } else {
            self.light_of_space(at, o.theta, o.sin, y2)
        };
        if self.reciprocal && o.theta > i.theta {
            light.values = self.values_back(i, o, y2);
        }
        light
    }

    /// Values of the way back, taken over to the way there.
    #[inline(never)]
    fn values_back(&self, i: &Polar, o: &Polar, y2: f64) -> [f64; 2] {
        let larger = self.incidence(o);
        let back = if self.signed() {
            self.light_of_plane(&larger, i.theta, i.sin, y2)
        } else {
            self.light_of_space(&larger, i.theta, i.sin, y2)
        };
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
        let phi = azimuth_of(y2);
        let (row, per_phi) = self.around(at.azimuth).position(phi);
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
        along: &Along,
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
    fn read(&self, between: Between, row: usize, cell: Cell) -> Values {
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
    fn mixed_totals(&self, between: Between) -> [f64; 2] {
        let (a, b) = (self.totals[between.node], self.totals[between.next]);
        let fraction = f64::from(between.fraction);
        [0, 1].map(|c| a[c] + fraction * (b[c] - a[c]))
    }

    /// An exit direction of one component from three uniform numbers; no direction of one without light.
    #[inline]
    pub(crate) fn sample(&self, component: usize, at: &Incidence, select: f64, u: f64, v: f64) -> Exit {
        let (node, left) = self.choose_node(component, at.between, select);
        if self.signed() {
            let s = at.columns.at(self.find(component, node, u).position());
            // Neither what chose the node nor v has said anything yet: they place what falls into the cap.
            let (cos, sin) = turned(self.theta_of_plane(s, left) * INVERSE_TAU);
            let around = Forward::new(self.concentration_at(at.azimuth, s, sin));
            return Exit { cos, sin, azimuth: around.sample(v) };
        }
        let (side, v) = side_of(v);
        let around = self.find_row(component, node, v).position();
        let (row, left) = self.choose_row(component, node, around, left);
        let column = self.find(component, row, u).position();
        let cap_edge = self.cap_edge(&at.columns);
        let area = if column < cap_edge { self.cap_area(component, row, cap_edge, u) } else { OUTSIDE };
        let (cos, sin) = turned(self.theta_of_space(at.columns.at(column), area) * INVERSE_TAU);
        Exit { cos, sin, azimuth: turned(self.turn_of_space(at.azimuth, side * around, left, area)) }
    }

    /// One of two incidences by a uniform number, and what is left of it; NaN where the component has no light.
    #[inline(always)]
    fn choose_node(&self, component: usize, between: Between, select: f64) -> (usize, f64) {
        let Between { node, next, fraction } = between;
        let fraction = f64::from(fraction);
        let near = (1.0 - fraction) * self.totals[node][component];
        let far = fraction * self.totals[next][component];
        split(select, near / (near + far), node, next)
    }

    /// Where a uniform number falls among the φ rows of an incidence of a space table.
    #[inline(always)]
    fn find_row(&self, component: usize, node: usize, v: f64) -> Found {
        let sampling = &self.sampling[component];
        let rows = node * self.rows..(node + 1) * self.rows;
        let (cdf, guide) = (&sampling.row_cdf[rows.clone()], &sampling.row_guide[rows.clone()]);
        let totals = &sampling.row_total[rows];
        find(|k| totals[k], cdf, guide, self.totals[node][component], v)
    }

    /// One of the two rows around a position (the number among those of all incidences) by a uniform number, and what is left of it.
    #[inline(always)]
    fn choose_row(&self, component: usize, node: usize, position: f64, select: f64) -> (usize, f64) {
        let cell = Cell::new(position as f32, self.rows);
        let (first, fraction) = (node * self.rows + cell.index, f64::from(cell.fraction));
        let totals = &self.sampling[component].row_total;
        let (near, far) = ((1.0 - fraction) * totals[first], fraction * totals[first + 1]);
        split(select, near / (near + far), first, first + 1)
    }

    /// Where a uniform number falls in a row.
    #[inline(always)]
    fn find(&self, component: usize, row: usize, u: f64) -> Found {
        let sampling = &self.sampling[component];
        let range = row * self.columns..(row + 1) * self.columns;
        let cells = &self.cells[range.clone()];
        let density = |k: usize| f64::from(cells[k][DENSITIES + component]);
        find(density, &sampling.cdf[range.clone()], &sampling.guide[range], sampling.row_total[row], u)
    }

    /// Column at the edge of the cap in space tables.
    #[inline(always)]
    fn cap_edge(&self, columns: &Warp) -> f64 {
        f64::from(columns.position(self.cap.radius).0)
    }

    /// Share of the cap's area up to a number that falls into it, in a row of a space table.
    #[inline]
    fn cap_area(&self, component: usize, row: usize, cap_edge: f64, u: f64) -> f64 {
        let sampling = &self.sampling[component];
        let range = row * self.columns..(row + 1) * self.columns;
        let cells = &self.cells[range.clone()];
        let density = |k: usize| f64::from(cells[k][DENSITIES + component]);
        least(u * sampling.row_total[row] / cumulated(density, &sampling.cdf[range], cap_edge), 1.0)
    }

    /// θo at a signed exit angle of decay tables; NaN where nothing is left.
    #[inline(always)]
    fn theta_of_plane(&self, s: f64, left: f64) -> f64 {
        let theta = if self.is_capped(s) { self.cap.theta(left) } else { least(s.abs(), FRAC_PI_2) };
        if left.is_nan() { left } else { theta }
    }

    /// Concentration of the sampled azimuths there: 0, at which all are equal, in the cap and behind.
    #[inline(always)]
    fn concentration_at(&self, azimuth: f32, s: f64, sin_o: f64) -> f32 {
        if self.is_capped(s) | (s < 0.0) { 0.0 } else { azimuth * sin_o as f32 }
    }

    #[inline(always)]
    fn is_capped(&self, s: f64) -> bool {
        s.abs() < self.cap.radius
    }

    /// θo at a column's angle of space tables.
    #[inline(always)]
    fn theta_of_space(&self, theta: f64, area: f64) -> f64 {
        if area >= 0.0 { self.cap.theta(area) } else { least(greatest(theta, 0.0), FRAC_PI_2) }
    }

    /// φ in turns, of space tables; NaN where nothing is left.
    #[inline(always)]
    fn turn_of_space(&self, azimuth: f32, around: f64, left: f64, area: f64) -> f64 {
        let phi = least(self.around(azimuth).at(around.abs()), PI).copysign(around);
        let turn = if area >= 0.0 { left - 0.5 } else { phi * INVERSE_TAU };
        if left.is_nan() { left } else { turn }
    }
}

/// Turns what is read over the albedo into what restores it.
#[inline(always)]
fn restore(along: &mut Along) {
    let [interior, rehit, ..] = along;
    (*interior, *rehit) = (1.0 / *interior, 1.0 / *rehit);
}

/// Both components as read, times what restores their albedo.
#[inline(always)]
fn restored(along: &Along, values: &Values) -> [f64; 2] {
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
    f64::from(2.0 * angle((y2 as f32).sqrt(), greatest((1.0 - y2) as f32, 0.0).sqrt()))
}

/// Step of [`Tabulated::guide`] at an angle.
#[inline(always)]
fn guide_step(theta_i: f64) -> usize {
    step_of(theta_i as f32 * (GUIDES as f64 / FRAC_PI_2) as f32, GUIDES as f32).0
}

/// How far θi is along its span.
#[inline(always)]
fn fraction_of_span(theta_i: f64, from: f64, inverse: f64) -> f32 {
    least(((theta_i - from) * inverse) as f32, 1.0)
}

/// A side of the plane of incidence by one half of a uniform number, and what is left of it.
#[inline(always)]
fn side_of(v: f64) -> (f64, f64) {
    if v < 0.5 { (1.0, 2.0 * v) } else { (-1.0, 2.0 * v - 1.0) }
}

/// Chooses between two with the probability of the first, and what is left of the random number.
#[inline(always)]
fn split(u: f64, first: f64, a: usize, b: usize) -> (usize, f64) {
    // Without a branch, which random numbers would mispredict.
    let is_first = u < first;
    let (from, length) = if is_first { (0.0, first) } else { (first, 1.0 - first) };
    (if is_first { a } else { b }, (u - from) / greatest(length, f64::MIN_POSITIVE))
}

/// Where the integral of a piecewise-linear density reaches a share of its total.
///
/// The density is u\[k\] at position k + ½, linear between, constant in the outer half cells; `cdf\[k\]` is its
/// integral up to position k + ½; `guide` says where to begin looking in it ([`guide`]).
#[inline(always)]
fn find(density: impl Fn(usize) -> f64, cdf: &[f64], guide: &[u16], total: f64, share: f64) -> Found {
    let last = cdf.len() - 1;
    let target = share * total;
    // `partition_point`, from where the guide says.
    let step = (share * guide.len() as f64) as usize;
    let mut above = usize::from(guide[step.min(last)]);
    // One step without a branch, which random numbers would mispredict; more are fewer.
    above += usize::from(above <= last && cdf[above] <= target);
    while above <= last && cdf[above] <= target {
        above += 1;
    }
    let below = above.saturating_sub(1);
    let (base, reached) = if above == 0 { (0.0, 0.0) } else { (above as f64 - 0.5, cdf[below]) };
    Found { base, density: [density(below), density(above.min(last))], rest: target - reached }
}

impl Found {
    /// The position.
    #[inline(always)]
    fn position(&self) -> f64 {
        let Self { base, density: [a, b], rest } = *self;
        // a·t + (b − a)·t²/2 = rest, in the form that does not cancel.
        let root = greatest(a * a + 2.0 * (b - a) * rest, 0.0).sqrt();
        base + if a + root > 0.0 { least(2.0 * rest / (a + root), 1.0) } else { 0.0 }
    }
}

/// Integral of such a density up to a position.
fn cumulated(density: impl Fn(usize) -> f64, cdf: &[f64], position: f64) -> f64 {
    let last = cdf.len() - 1;
    let from_first = position - 0.5;
    if from_first <= 0.0 {
        return position.max(0.0) * density(0);
    }
    let k = (from_first as usize).min(last);
    let t = from_first - k as f64;
    let next = density((k + 1).min(last));
    cdf[k] + t * (density(k) + 0.5 * t * (next - density(k)))
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
    let (total, cells) = (density.iter().sum::<f64>(), cdf.len());
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

/// Values and sampling densities of every cell.
fn cells(table: &Table) -> Vec<Values> {
    let axis = &table.meta.exit_axis;
    let mut cells = Vec::with_capacity(table.interior.value.len());
    for (i, summary) in table.meta.per_incidence.iter().enumerate() {
        let theta_i = summary.theta_i_deg.to_radians();
        let measure = measures(axis, theta_i, summary.azimuth_width_deg.to_radians());
        let of_incidence = i * axis.cells()..(i + 1) * axis.cells();
        cells.extend(of_incidence.zip(measure).map(|(k, measure)| {
            let (interior, rehit) = (table.interior.value[k], table.rehit.value[k]);
            let density = |value: f32| (f64::from(value) * measure) as f32;
            [interior, rehit, density(interior), density(rehit)]
        }));
    }
    cells
}

/// The spans of a table.
fn spans(table: &Table) -> Vec<Span> {
    let theta = table.theta_i();
    let width = |node: usize| table.meta.per_incidence[node].azimuth_width_deg.to_radians();
    let span = |from: f64, to: f64, node: usize, next: usize| Span {
        from,
        inverse: 1.0 / (to - from),
        node,
        next,
        width: width(node) as f32,
        widening: (width(next) - width(node)) as f32,
    };
    let last = theta.len() - 1;
    let mut spans = Vec::with_capacity(theta.len() + 1);
    if theta[0] > 0.0 {
        spans.push(span(0.0, theta[0], 0, 0));
    }
    spans.extend((0..last).map(|k| span(theta[k], theta[k + 1], k, k + 1)));
    if theta[last] < FRAC_PI_2 {
        spans.push(span(theta[last], FRAC_PI_2, last, last));
    }
    spans
}

impl Sampling {
    fn new(table: &Table, cells: &[Values], component: usize) -> Self {
        let axis = &table.meta.exit_axis;
        let mut this = Self {
            cdf: Vec::with_capacity(cells.len()),
            guide: Vec::with_capacity(cells.len()),
            row_guide: Vec::new(),
            row_total: Vec::new(),
            row_cdf: Vec::new(),
        };
        for of_incidence in cells.chunks(axis.cells()) {
            let first_row = this.row_total.len();
            for row in of_incidence.chunks(axis.columns()) {
                let density: Vec<f64> =
                    row.iter().map(|values| f64::from(values[DENSITIES + component])).collect();
                let start = this.cdf.len();
                this.row_total.push(density.iter().sum());
                cumulate(&density, &mut this.cdf);
                guide(&density, &this.cdf[start..], &mut this.guide);
            }
            let totals = &this.row_total[first_row..];
            cumulate(totals, &mut this.row_cdf);
            guide(totals, &this.row_cdf[first_row..], &mut this.row_guide);
        }
        this
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specimen;

    #[test]
    fn a_component_without_light_has_no_exits() {
        let incidences: Vec<f64> = (0..=18).map(|i| 5.0 * f64::from(i)).collect();
        for mut table in [specimen::plane(&incidences, 48), specimen::space(&incidences, 32, 24)] {
            table.rehit.value.fill(0.0);
            let tabulated = Tabulated::new(&Interpolant::new(table));
            for k in 0..1000 {
                let [select, u, v] = [0.618, 0.755, 0.570].map(|step| (f64::from(k) * step).fract());
                let incidence = tabulated.incidence(&Polar::at(FRAC_PI_2 * (f64::from(k) + 0.5) / 1000.0));
                let [lit, dark] = [0, 1].map(|part| tabulated.sample(part, &incidence, select, u, v));
                let length2 = |exit: &Exit| exit.cos.hypot(exit.sin) * exit.azimuth.0.hypot(exit.azimuth.1);
                assert!((length2(&lit) - 1.0).abs() < 1e-6, "{lit:?}");
                assert!(length2(&dark).is_nan(), "{dark:?}");
            }
        }
    }
}
