//! The arrays of [`Lobes`] from a table.

use crate::lobes::distribution::{Distribution, cumulative_at};
use crate::lobes::{Cap, DENSITIES, GUIDES, Lobes, Span, SpanCurves, Values};
use crate::numerics::angles::least;
use crate::numerics::warp::Warp;
use lut_io::axis::ExitAxis;
use lut_io::decay;
use lut_io::lobe::Interpolant;
use lut_io::table::{Component, Table};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Largest radius of the cap around the normal, radians.
const LARGEST_CAP: f64 = 0.1;
/// Most that is read for an albedo.
const DARKEST: f64 = 1e30;
/// How far within a span its ends are, in lengths of it.
const INSIDE: f64 = 1e-6;

impl Lobes {
    pub(crate) fn new(lobe: &Interpolant) -> Self {
        let table = lobe.table();
        let axis = table.meta().exit_axis;
        let cells = cells(table);
        let distributions = [0, 1].map(|lobe| Distribution::new(&axis, &cells, lobe));
        let spans = spans(table);
        let at_or_before = |step: usize| {
            let start = FRAC_PI_2 * (step as f64 - 1e-6) / GUIDES as f64;
            let span = spans.partition_point(|span| span.from <= start).saturating_sub(1);
            u16::try_from(span).unwrap_or(u16::MAX)
        };
        let sum = |values: &Values, lobe: usize| f64::from(values[DENSITIES + lobe]);
        let total =
            |cells: &[Values]| [0, 1].map(|lobe| cells.iter().map(|v| sum(v, lobe)).sum::<f64>() as f32);
        let mut this = Self {
            axis,
            reciprocal: table.meta().reciprocal.is_some(),
            guide: (0..=GUIDES).map(at_or_before).collect(),
            starts: spans.iter().map(|span| span.from).chain([f64::INFINITY]).collect(),
            span_steps: span_steps(&spans, axis.width()),
            spans,
            columns: axis.columns(),
            rows: axis.rows_per_incidence(),
            cell_width: axis.width(),
            inverse_width: 1.0 / axis.width(),
            totals: cells.chunks(axis.cells()).map(total).collect(),
            cells,
            distributions,
            span_curves: Vec::new(),
            cap: Cap::new(axis.width().min(LARGEST_CAP)),
            some_columns: Warp::new(&axis.columns_at(0.25 * PI)),
        };
        this.span_curves = this.over_spans(lobe);
        this
    }

    fn over_spans(&self, lobe: &Interpolant) -> Vec<SpanCurves> {
        let at = |theta_i: f64| {
            let row = lobe.row(theta_i);
            let [interior, rehit] = [Component::Interior, Component::Rehit]
                .map(|component| least(1.0 / row.correction(component), DARKEST));
            let cap = self.cap_shares(theta_i);
            [interior, rehit, cap[0], cap[1]].map(|known| known as f32)
        };
        let steps = self.spans.iter().flat_map(|span| {
            // Where a lobe goes out at an end, what it tends to counts, not 0/0.
            let share = |k: usize| (k as f64 / self.span_steps as f64).clamp(INSIDE, 1.0 - INSIDE);
            (0..=self.span_steps).map(move |k| span.from + share(k) / span.inverse)
        });
        steps.map(at).collect()
    }

    /// Share of what is sampled at θi that falls into the cap around the normal.
    fn cap_shares(&self, theta_i: f64) -> [f64; 2] {
        let (_, between) = self.between(theta_i);
        let columns = Warp::new(&self.axis.columns_at(theta_i));
        let position = |s: f64| f64::from(columns.position(s).0);
        let from = if self.signed() { position(-self.cap.radius) } else { 0.0 };
        let to = position(self.cap.radius);
        let totals = self.mixed_totals(between);
        [0, 1].map(|lobe| {
            let cumulative = &self.distributions[lobe].cumulative;
            let inside = |node: usize| -> f64 {
                let rows = (0..self.rows).map(|row| {
                    let range = self.range(node, row);
                    let density = |k: usize| f64::from(self.cells[range.start + k][DENSITIES + lobe]);
                    let up_to = |x: f64| cumulative_at(density, &cumulative[range.clone()], x);
                    up_to(to) - up_to(from)
                });
                rows.sum()
            };
            let fraction = f64::from(between.fraction);
            let mixed = (1.0 - fraction) * inside(between.node) + fraction * inside(between.next);
            if totals[lobe] > 0.0 { (mixed / totals[lobe]).clamp(0.0, 1.0) } else { 0.0 }
        })
    }
}

/// Steps of every span at which [`SpanCurves`] is known; the Mitsuba plugin has the same. Sixteen miss its curvature at grazing incidence by
/// 2e-4; where rows are many widths of their facets apart it grows with that number, and would be missed by half a per cent.
fn span_steps(spans: &[Span], width: f64) -> usize {
    let longest = spans.iter().map(|span| 1.0 / span.inverse).fold(0.0, f64::max);
    // Short of whole numbers by more than rounding.
    let finer = ((longest / width).sqrt().log2() - 1e-6).ceil().clamp(0.0, 4.0);
    128 << finer as u32
}

/// Values and sampling densities of every cell.
fn cells(table: &Table) -> Vec<Values> {
    let axis = &table.meta().exit_axis;
    let [interiors, rehits] =
        [Component::Interior, Component::Rehit].map(|component| &table.lobe(component).value);
    let mut cells = Vec::with_capacity(interiors.len());
    for (i, summary) in table.meta().per_incidence.iter().enumerate() {
        let theta_i = summary.theta_i_deg.to_radians();
        let measure = measures(axis, theta_i, summary.azimuth_width_deg.to_radians());
        let of_incidence = i * axis.cells()..(i + 1) * axis.cells();
        cells.extend(of_incidence.zip(measure).map(|(k, measure)| {
            let (interior, rehit) = (interiors[k], rehits[k]);
            let density = |value: f32| (f64::from(value) * measure) as f32;
            [interior, rehit, density(interior), density(rehit)]
        }));
    }
    cells
}

/// The spans of a table.
fn spans(table: &Table) -> Vec<Span> {
    let theta = table.theta_i();
    let width = |node: usize| table.meta().per_incidence[node].azimuth_width_deg.to_radians();
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
