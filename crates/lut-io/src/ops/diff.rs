//! How far two tables are apart, and whether their stored errors explain it.
//!
//! Lobes that both tables store on the same cells, and lobes of a walk that the other table knows without noise, are tested by their
//! counts; all lobes are held against the accuracies that both tables state, component by component. What is no lobe and has no
//! error (interface 0, colours) must be the same.

use crate::model::axis::{ExitAxis, Stretched};
use crate::model::both_sides::Passage;
use crate::model::measure;
use crate::model::solver::Solver;
use crate::model::spectra::Spectra;
use crate::model::table::{Component, IncidenceSummary, Table};
use crate::ops::explain::{self, Light, Verdict};
use crate::read::lobe::{Interpolant, Row};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF as _, Normal};
use std::f64::consts::PI;

/// Family-wise significance: tables from the same walk with other seeds are called different once in a thousand.
pub const SIGNIFICANCE: f64 = 1e-3;
/// What rounding may add to the total variation of a lobe, as a share of its scale, and to any number.
const ROUNDING: f64 = 1e-6;
/// Largest difference of colours, in shares of the largest of their kind: of seven digits, and of those that compact files keep.
const COLOUR_TOLERANCE: f64 = 1e-5;
const COMPACT_COLOUR_TOLERANCE: f64 = 1e-2;
/// Paths of which as many as expected may be missing in a lobe that was read between incidences or cells.
const UNSEEN: f64 = 10.0;
/// Fewest reflected paths whose mean and standard deviation are nearly normal.
const FEWEST_PATHS: f64 = 300.0;

/// Two tables compared at the incidences of one that lie within those of the other.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Whether every number that a reader uses is the same.
    pub identical: bool,
    /// Whether there is more than errors explain: in the smallest p ([`SIGNIFICANCE`], all tests together), or in `beyond`.
    pub significant: bool,
    /// Number of tests with noise.
    pub tests: usize,
    /// Smallest p of them; `None` without tests.
    pub smallest_p: Option<f64>,
    /// What is further apart than both tables state, or has no error and is not the same; a line each.
    pub beyond: Vec<String>,
    /// What one of the tables alone has, or on other cells, and was not compared; a line each.
    pub not_compared: Vec<String>,
    /// The least change that would have been called significant with a probability of 99 % in any component at any incidence: total
    /// variation, per cent of √(all reflected light · the component's own).
    pub smallest_change_percent: f64,
    /// Largest total variation, per cent of the reflected light, and its incidence.
    pub worst_total_variation_percent: f64,
    /// Incidence of the largest total variation, degrees.
    pub worst_theta_i_deg: f64,
    /// One entry an incidence; the table's own wavelength first.
    pub per_incidence: Vec<IncidenceDifference>,
    /// What passes and what comes from below, one entry an incidence and lobe.
    pub passages: Vec<PassageDifference>,
}

/// Two tables at one incidence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IncidenceDifference {
    /// Wavelength of the lobe, nm.
    pub wavelength_nm: f64,
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// Half the integral of |f cos θo − f' cos θo| over the hemisphere, per cent of the reflected light.
    pub total_variation_percent: f64,
    /// Difference of the summaries, first minus second.
    pub shares: Vec<ShareDifference>,
    /// The components of the lobe.
    pub lobes: Vec<LobeDifference>,
}

/// One number of the summaries compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShareDifference {
    /// Field of the summary.
    pub field: &'static str,
    /// First minus second.
    pub difference: f64,
    /// What the tables state that they may be off by, without noise.
    pub allowed: f64,
    /// What is beyond that, in standard errors; `None` without noise, or where too few paths are expected.
    pub z: Option<f64>,
    /// Probability of more by noise alone.
    pub p: Option<f64>,
}

/// The cells of one component compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LobeDifference {
    /// Name of the component.
    pub component: &'static str,
    /// Half the integral of |difference|, per cent of √(all reflected light · the component's own).
    pub total_variation_percent: f64,
    /// Sum of what both tables state of it, noise with it; infinite where counts are tested, which say more.
    pub allowed_percent: f64,
    /// chi² over groups of cells, beyond what is stated without noise; `None` where counts are not compared.
    pub chi2: Option<f64>,
    /// Number of those groups.
    pub cells: usize,
    /// Probability of a larger chi² by noise alone.
    pub p: Option<f64>,
    /// The least change that would have been found with a probability of 99 %, in the same per cent.
    pub smallest_change_percent: f64,
    #[serde(skip)]
    verdict: Option<(Verdict, f64)>,
}

/// A lobe of the other side compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassageDifference {
    /// Name of the lobe.
    pub lobe: &'static str,
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// Half the integral of |difference|, per cent of the lobe's light (of a thousandth of the incident light, if that is more).
    pub total_variation_percent: f64,
    /// Sum of what both tables state of it.
    pub allowed_percent: f64,
}

/// Compares two valid tables.
#[must_use]
pub fn diff(a: &Interpolant, b: &Interpolant) -> Difference {
    let mut found = Findings { per_incidence: band(a, b), ..Findings::default() };
    found.further_bands(a.table(), b.table());
    found.passages(a.table(), b.table());
    found.exact(a.table(), b.table());
    found.judged(same_numbers(a.table(), b.table()))
}

/// What was found so far.
#[derive(Default)]
struct Findings {
    per_incidence: Vec<IncidenceDifference>,
    passages: Vec<PassageDifference>,
    beyond: Vec<String>,
    not_compared: Vec<String>,
}

impl Findings {
    /// The lobes at further wavelengths, each as a table of its own.
    fn further_bands(&mut self, a: &Table, b: &Table) {
        // Bands that make no table were refused by the reader.
        let bands = |table: &Table| table.further_bands().unwrap_or_default();
        let (mut left, right) = (bands(b), bands(a));
        for table in right {
            let nm = table.meta().wavelength_nm;
            match left.iter().position(|other| other.meta().wavelength_nm == nm) {
                Some(k) => {
                    let other = left.remove(k);
                    self.surface_model(&table, &other);
                    self.per_incidence.extend(band(&Interpolant::new(table), &Interpolant::new(other)));
                }
                None => self.not_compared.push(format!("the band of {nm} nm, which the first alone has")),
            }
        }
        for table in left {
            let nm = table.meta().wavelength_nm;
            self.not_compared.push(format!("the band of {nm} nm, which the second alone has"));
        }
    }

    fn passages(&mut self, a: &Table, b: &Table) {
        let (Some(first), Some(second)) = (&a.meta().both_sides, &b.meta().both_sides) else {
            if a.meta().both_sides.is_some() != b.meta().both_sides.is_some() {
                self.not_compared.push("both_sides, which one of them alone has".to_owned());
            }
            return;
        };
        if a.meta().exit_axis != b.meta().exit_axis || a.theta_i() != b.theta_i() {
            self.not_compared.push("both_sides: other cells or incidences".to_owned());
            return;
        }
        for passage in Passage::ALL {
            let weights = first.weights(passage, &a.meta().exit_axis);
            let (Some(x), Some(y)) = (a.passage(passage), b.passage(passage)) else { continue };
            for (i, (one, other)) in first.from_below.iter().zip(&second.from_below).enumerate() {
                let [w, x, y] = [&weights[..], x, y].map(|samples| a.at_incidence(samples, i));
                let sum = |of: &dyn Fn(usize) -> f32| -> f64 {
                    w.iter().enumerate().map(|(k, weight)| 0.5 * f64::from(*weight) * f64::from(of(k))).sum()
                };
                let light = sum(&|k| x[k] + y[k]).max(FAINT);
                self.passages.push(PassageDifference {
                    lobe: passage.name(),
                    theta_i_deg: one.theta_i_deg,
                    total_variation_percent: 100.0 * sum(&|k| (x[k] - y[k]).abs()) / light,
                    allowed_percent: one.accuracy_percent.of(passage)
                        + other.accuracy_percent.of(passage)
                        + 100.0 * ROUNDING,
                });
            }
        }
    }

    /// What has no error.
    fn exact(&mut self, a: &Table, b: &Table) {
        self.surface_model(a, b);
        if let (Some(first), Some(second)) = (&a.meta().spectra, &b.meta().spectra) {
            let compact = a.meta().compact.is_some() || b.meta().compact.is_some();
            let tolerance = if compact { COMPACT_COLOUR_TOLERANCE } else { COLOUR_TOLERANCE };
            self.colours(first, second, tolerance);
        } else if a.meta().spectra.is_some() != b.meta().spectra.is_some() {
            self.not_compared.push("spectra, which one of them alone has".to_owned());
        }
    }

    fn surface_model(&mut self, a: &Table, b: &Table) {
        let (x, y, nm) = (&a.meta().surface_model, &b.meta().surface_model, a.meta().wavelength_nm);
        let numbers = [
            ("n_ambient", x.n_ambient, y.n_ambient),
            ("n_first", x.n_first, y.n_first),
            ("slope_sd", x.slope_sd, y.slope_sd),
        ];
        for (name, x, y) in numbers {
            if (x - y).abs() > 1e-12 * x.abs().max(y.abs()) {
                self.beyond.push(format!("surface_model.{name} at {nm} nm: {x} and {y}"));
            }
        }
        if x.normals != y.normals {
            self.beyond.push("surface_model.normals".to_owned());
        }
    }

    fn colours(&mut self, a: &Spectra, b: &Spectra, tolerance: f64) {
        type Rows<'t> = (Vec<&'t [f64]>, Vec<&'t [f64]>);
        fn rows<const N: usize>(of: &[[f64; N]]) -> Vec<&[f64]> {
            of.iter().map(|row| &row[..]).collect()
        }
        fn lists(of: &[Vec<f64>]) -> Vec<&[f64]> {
            of.iter().map(|row| &row[..]).collect()
        }
        fn all(of: &[Vec<[f64; 3]>]) -> Vec<&[f64]> {
            of.iter().flat_map(|of| rows(of)).collect()
        }
        let mut pairs: Vec<(&str, Rows<'_>)> = Vec::new();
        let before = self.not_compared.len();
        match (&a.coherent, &b.coherent) {
            (Some(x), Some(y)) if x.theta_deg == y.theta_deg && a.wavelength_nm == b.wavelength_nm => {
                pairs.push(("coherent.modulation", (lists(&x.modulation), lists(&y.modulation))));
                pairs.push(("coherent.modulation_rgb", (rows(&x.modulation_rgb), rows(&y.modulation_rgb))));
                pairs.push(("coherent.incoherent", (vec![&x.incoherent], vec![&y.incoherent])));
            }
            (None, None) => {}
            _ => self.not_compared.push("spectra.coherent: other angles, or in one of them alone".to_owned()),
        }
        match (&a.emission, &b.emission) {
            (Some(x), Some(y)) if x.theta_deg == y.theta_deg && a.wavelength_nm == b.wavelength_nm => {
                pairs.push(("emission.radiance", (lists(&x.radiance), lists(&y.radiance))));
                pairs.push(("emission.radiance_rgb", (rows(&x.radiance_rgb), rows(&y.radiance_rgb))));
            }
            (None, None) => {}
            _ => self.not_compared.push("spectra.emission: other angles, or in one of them alone".to_owned()),
        }
        let both_compared = self.not_compared.len() == before;
        match (&a.thickness, &b.thickness) {
            (Some(x), Some(y)) if x.scale == y.scale && both_compared => {
                pairs.push(("thickness.modulation_rgb", (all(&x.modulation_rgb), all(&y.modulation_rgb))));
                pairs.push(("thickness.radiance_rgb", (all(&x.radiance_rgb), all(&y.radiance_rgb))));
            }
            (None, None) => {}
            _ => {
                self.not_compared.push("spectra.thickness: other scales, or in one of them alone".to_owned())
            }
        }
        for (name, (x, y)) in pairs {
            let largest = x.iter().copied().flatten().fold(0.0, |most: f64, value| most.max(value.abs()));
            let values = x.iter().copied().flatten().zip(y.iter().copied().flatten());
            let apart = values.map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
            if apart > tolerance * largest {
                self.beyond.push(format!("spectra.{name}: up to {apart:.3e} apart, of {largest:.3e}"));
            }
        }
    }

    fn judged(mut self, identical: bool) -> Difference {
        let shares = || self.per_incidence.iter().flat_map(|at| &at.shares);
        let lobes = || self.per_incidence.iter().flat_map(|at| &at.lobes);
        let tests: Vec<f64> = shares().filter_map(|s| s.p).chain(lobes().filter_map(|l| l.p)).collect();
        let smallest_p = tests.iter().copied().reduce(f64::min);
        let significance = SIGNIFICANCE / tests.len().max(1) as f64;
        let mut beyond = std::mem::take(&mut self.beyond);
        for at in &self.per_incidence {
            let place = format!("{}°, {} nm", at.theta_i_deg, at.wavelength_nm);
            for ShareDifference { field, difference, allowed, p, .. } in &at.shares {
                if p.is_none() && difference.abs() > *allowed && allowed.is_finite() {
                    beyond.push(format!("{field} at {place}: {difference:+.2e} apart, {allowed:.1e} stated"));
                }
            }
            for LobeDifference {
                component, total_variation_percent: apart, allowed_percent: stated, ..
            } in &at.lobes
            {
                if apart > stated {
                    beyond.push(format!("{component} at {place}: {apart:.3} % apart, {stated:.3} % stated"));
                }
            }
        }
        for PassageDifference {
            lobe,
            theta_i_deg,
            total_variation_percent: apart,
            allowed_percent: stated,
        } in &self.passages
        {
            if apart > stated {
                beyond.push(format!("{lobe} at {theta_i_deg}°: {apart:.3} % apart, {stated:.3} % stated"));
            }
        }
        for lobe in self.per_incidence.iter_mut().flat_map(|at| &mut at.lobes) {
            // What counts do not find is found where it exceeds what is stated.
            let by_counts = lobe.verdict.map(|(verdict, unit)| unit * verdict.smallest_change(significance));
            lobe.smallest_change_percent += by_counts.unwrap_or_default();
        }
        let changes = self.per_incidence.iter().flat_map(|at| &at.lobes).map(|l| l.smallest_change_percent);
        let smallest_change_percent = changes.fold(0.0, f64::max);
        let worst = self
            .per_incidence
            .iter()
            .max_by(|x, y| x.total_variation_percent.total_cmp(&y.total_variation_percent));
        // Bonferroni: the smallest of n p-values against SIGNIFICANCE/n.
        let unexplained = !beyond.is_empty() || smallest_p.is_some_and(|p| p < significance);
        Difference {
            identical,
            significant: !identical && unexplained,
            tests: tests.len(),
            smallest_p,
            beyond,
            not_compared: self.not_compared,
            smallest_change_percent,
            worst_total_variation_percent: worst.map_or(0.0, |w| w.total_variation_percent),
            worst_theta_i_deg: worst.map_or(0.0, |w| w.theta_i_deg),
            per_incidence: self.per_incidence,
            passages: self.passages,
        }
    }
}

/// Light of a passage below which its accuracy is a share of this.
const FAINT: f64 = 1e-3;

/// The lobes at one wavelength.
fn band(a: &Interpolant, b: &Interpolant) -> Vec<IncidenceDifference> {
    // Counts are tested on the cells that hold them.
    let on_first = is_noisy(a.table()) || !is_noisy(b.table());
    let (grid, other) = if on_first { (a, b) } else { (b, a) };
    let (first, last) = range(other.table());
    let mut found = Vec::new();
    for (i, summary) in grid.table().meta().per_incidence.iter().enumerate() {
        if (first..=last).contains(&summary.theta_i_deg) {
            found.push(Pair::new(grid, other, i).compared(on_first));
        }
    }
    found
}

fn range(table: &Table) -> (f64, f64) {
    let per_incidence = &table.meta().per_incidence;
    (per_incidence[0].theta_i_deg, per_incidence[per_incidence.len() - 1].theta_i_deg)
}

fn same_numbers(a: &Table, b: &Table) -> bool {
    let (x, y) = (a.meta(), b.meta());
    x.exit_axis == y.exit_axis
        && x.per_incidence == y.per_incidence
        && x.surface_model == y.surface_model
        && x.both_sides == y.both_sides
        && x.dispersion == y.dispersion
        && x.reciprocal == y.reciprocal
        && x.spectra == y.spectra
        && Component::ALL.into_iter().all(|component| a.lobe(component) == b.lobe(component))
        && a.bands() == b.bands()
        && Passage::ALL.into_iter().all(|passage| a.passage(passage) == b.passage(passage))
}

/// Whether the cells hold what paths counted. Of compact and of reciprocal tables the noise is not known any more.
fn is_noisy(table: &Table) -> bool {
    let meta = table.meta();
    meta.solver == Solver::Walk && meta.compact.is_none() && meta.reciprocal.is_none()
}

/// Light of one component in both tables.
#[derive(Clone, Copy, Debug, Default)]
struct Apart {
    /// Half the integral of |difference|.
    difference: f64,
    /// Mean of both.
    own: f64,
}

/// Two tables at an incidence of the first.
struct Pair<'t> {
    grid: &'t Interpolant,
    other: &'t Interpolant,
    row: Row<'t>,
    row_other: Row<'t>,
    i: usize,
    /// The incidence of the other table, if it stores it.
    j: Option<usize>,
    /// Whether the other table stores the same cells too.
    same_cells: bool,
}

impl<'t> Pair<'t> {
    fn new(grid: &'t Interpolant, other: &'t Interpolant, i: usize) -> Self {
        let theta_i_deg = grid.table().meta().per_incidence[i].theta_i_deg;
        let (x, y) = (grid.table().meta(), other.table().meta());
        let j = y.per_incidence.iter().position(|s| s.theta_i_deg == theta_i_deg);
        let theta_i = theta_i_deg.to_radians();
        Self {
            grid,
            other,
            row: grid.row(theta_i),
            row_other: other.row(theta_i),
            i,
            j,
            same_cells: x.exit_axis == y.exit_axis,
        }
    }

    fn summary(&self) -> &'t IncidenceSummary {
        &self.grid.table().meta().per_incidence[self.i]
    }

    fn compared(&self, on_first: bool) -> IncidenceDifference {
        let [all, parts @ ..] = self.apart();
        let percent = |part: f64, of: f64| if of > 0.0 { 100.0 * part / of } else { 0.0 };
        let lobes = Component::ALL.into_iter().zip(parts).filter(|(_, part)| part.own > 0.0);
        let mut shares = self.shares(all.own);
        if !on_first {
            shares.iter_mut().for_each(|share| share.difference = -share.difference);
        }
        IncidenceDifference {
            wavelength_nm: self.grid.table().meta().wavelength_nm,
            theta_i_deg: self.summary().theta_i_deg,
            total_variation_percent: percent(all.difference, all.own),
            shares,
            lobes: lobes.map(|(component, part)| self.lobe(component, part, all.own)).collect(),
        }
    }

    fn lobe(&self, component: Component, part: Apart, all: f64) -> LobeDifference {
        let scale = measure::component_scale(part.own, all);
        let at = [(self.grid, Some(self.i)), (self.other, self.j.filter(|_| self.same_cells))];
        let sum = |of: &dyn Fn(&Table, Option<usize>) -> f64| -> f64 {
            at.iter().map(|(lobe, stored)| of(lobe.table(), *stored)).sum()
        };
        let rounding = ROUNDING * scale;
        let without_noise = rounding + sum(&|table, stored| stated(table, component, stored, scale));
        let theta_i_deg = self.summary().theta_i_deg;
        let allowed = without_noise + sum(&|table, _| noise(table, component, theta_i_deg));
        let counts = self.counts(component);
        let allowed = if counts.is_some() { f64::INFINITY } else { allowed };
        let verdict = counts.and_then(|[a, b]| explain::explained(&a, &b, without_noise));
        let percent = 100.0 / scale;
        LobeDifference {
            component: component.name(),
            total_variation_percent: percent * part.difference,
            allowed_percent: percent * allowed,
            chi2: verdict.map(|verdict| verdict.chi2),
            cells: verdict.map_or(0, |verdict| verdict.groups),
            p: verdict.map(|verdict| verdict.p),
            smallest_change_percent: percent * if allowed.is_finite() { allowed } else { without_noise },
            verdict: verdict.map(|verdict| (verdict, percent)),
        }
    }

    /// Light by cell of both, where one of them at least was counted there and the other is known on these cells.
    fn counts(&self, component: Component) -> Option<[Light; 2]> {
        let (x, y) = (self.grid.table(), self.other.table());
        if !is_noisy(x) {
            return None;
        }
        let own = Light::stored(x, component, self.i);
        match self.j.filter(|_| self.same_cells) {
            Some(j) if y.meta().reciprocal.is_none() => Some([own, Light::stored(y, component, j)]),
            _ if is_noisy(y) || y.meta().reciprocal.is_some() => None,
            _ => {
                let same_kind = x.meta().azimuth == y.meta().azimuth;
                let read = || {
                    let cells = self.read_over_cells(component);
                    Light::exact(&x.meta().exit_axis, self.row.theta_i(), &cells)
                };
                same_kind.then(|| [own, read()])
            }
        }
    }

    /// Light of the other table, as it is read, in every cell of the first.
    fn read_over_cells(&self, component: Component) -> Vec<f64> {
        let along = rule(self.row.columns());
        let around = self.row.phi().map_or_else(|| vec![(0.0, 0.5); POINTS.len()], rule);
        let eval = |s: f64, phi: f64| {
            let phi = if s < 0.0 { PI } else { phi };
            self.row_other.eval(component, s.abs(), phi)
        };
        let signed = self.row.phi().is_none();
        let mut share = Vec::new();
        for sector in around.chunks_exact(POINTS.len()) {
            for points in along.chunks_exact(POINTS.len()) {
                let light = |phi: f64| -> f64 {
                    points.iter().map(|(s, w)| w * if signed { 1.0 } else { s.sin() } * eval(*s, phi)).sum()
                };
                share.push(if signed {
                    light(0.0)
                } else {
                    sector.iter().map(|(phi, w)| 2.0 * w * light(*phi)).sum()
                });
            }
        }
        if signed {
            // A density over s alone; its scale is the albedo.
            let all: f64 = share.iter().sum();
            let albedo = self.other.albedo(component, self.row.theta_i());
            share.iter_mut().for_each(|light| *light *= if all > 0.0 { albedo / all } else { 0.0 });
        }
        share
    }

    fn shares(&self, all: f64) -> Vec<ShareDifference> {
        let (first, theta_i) = (self.summary(), self.row.theta_i());
        let Some(j) = self.j else {
            let albedo = [Component::Interior, Component::Surface]
                .map(|component| self.other.albedo(component, theta_i))
                .iter()
                .sum::<f64>();
            // Between incidences it is known as well as the lobe is.
            let allowed = f64::INFINITY;
            let difference = first.albedo - albedo;
            return vec![ShareDifference { field: "albedo", difference, allowed, z: None, p: None }];
        };
        let second = &self.other.table().meta().per_incidence[j];
        let numbers = |table: &Table, k: usize| Numbers::of(table, k, all);
        let (x, y) = (numbers(self.grid.table(), self.i), numbers(self.other.table(), j));
        let mut found: Vec<ShareDifference> =
            x.shares.iter().zip(&y.shares).filter_map(|(x, y)| x.against(y)).collect();
        let known = |table: &Table| table.meta().reciprocal.is_none() && table.meta().compact.is_none();
        // Of a doubling no moments are promised: the ringing far from a narrow lobe counts much in them.
        let noisy = is_noisy(self.grid.table()) && is_noisy(self.other.table());
        let many = x.reflected.min(y.reflected) >= FEWEST_PATHS;
        if noisy && many && known(self.grid.table()) && known(self.other.table()) {
            found.extend(x.moments.iter().zip(&y.moments).filter_map(|(x, y)| x.moment_against(y)));
        }
        // A width that is the lobe's standard deviation is tested by that.
        let own = |s: &IncidenceSummary| (s.azimuth_width_deg / s.sd_theta_o_deg - 1.0).abs() < 1e-9;
        let postulate = first.azimuth_width_deg.max(second.azimuth_width_deg) > 0.0;
        if postulate && known(self.grid.table()) && known(self.other.table()) && !(own(first) && own(second))
        {
            let difference = first.azimuth_width_deg - second.azimuth_width_deg;
            let allowed = ROUNDING * first.azimuth_width_deg;
            found.push(ShareDifference { field: "azimuth_width_deg", difference, allowed, z: None, p: None });
        }
        found
    }

    /// All light and each component, by the cells and weights of a space table if there is one, which know φ, else by those of the first.
    fn apart(&self) -> [Apart; 4] {
        let space = |lobe: &Interpolant| matches!(lobe.table().meta().exit_axis, ExitAxis::Space { .. });
        let (grid, row) = if !space(self.grid) && space(self.other) {
            (self.other, &self.row_other)
        } else {
            (self.grid, &self.row)
        };
        let weights =
            measure::reading_weights(&grid.table().meta().exit_axis, row.theta_i(), row.azimuth_width());
        let columns = row.columns().centres();
        let azimuths = row.phi().map_or_else(|| vec![0.0], |phi| phi.centres());
        let mut found = [Apart::default(); 4];
        for (k, weight) in weights.iter().enumerate() {
            let (s, phi) = (columns[k % columns.len()], azimuths[k / columns.len()]);
            let phi = if s < 0.0 { PI } else { phi };
            let [i, surface, rehit] = self.row.eval_all(s.abs(), phi);
            let [j, other_surface, other_rehit] = self.row_other.eval_all(s.abs(), phi);
            let pairs =
                [(i + surface, j + other_surface), (i, j), (surface, other_surface), (rehit, other_rehit)];
            for (apart, (x, y)) in found.iter_mut().zip(pairs) {
                apart.difference += 0.5 * weight * (x - y).abs();
                apart.own += 0.5 * weight * (x + y);
            }
        }
        found
    }
}

/// Light that a table states a component to be off by without noise, at a stored incidence or as it is read; `scale` is its
/// [`measure::component_scale`].
fn stated(table: &Table, component: Component, stored: Option<usize>, scale: f64) -> f64 {
    let meta = table.meta();
    let accuracy = &meta.accuracy;
    let Some(i) = stored else {
        if is_noisy(table) {
            return 0.01 * (accuracy.rows_percent + accuracy.cells_percent.unwrap_or(0.0)) * scale;
        }
        let own = accuracy.components.map(|components| match component {
            Component::Interior => components.interior_percent,
            Component::Surface => components.surface_percent,
            Component::Rehit => components.rehit_percent,
        });
        // Making it compact is counted in the whole alone.
        let lost = meta.compact.as_ref().map_or(0.0, |section| section.error.total_variation_percent);
        return 0.01 * own.map_or(accuracy.reached_percent, |own| own + lost) * scale;
    };
    if is_noisy(table) {
        return 0.0;
    }
    // The errors of the cells are the component's total variation, twice; the accuracy holds for each component too.
    let own = if meta.solver == Solver::Doubling { 0.5 * errors(table, component, i) } else { 0.0 };
    own.max(0.01 * meta.per_incidence[i].accuracy_percent * scale)
}

/// Light that noise may move, at the worse of the incidences around: two and a half times what it moves on average, and some paths that no
/// cell has caught.
fn noise(table: &Table, component: Component, theta_i_deg: f64) -> f64 {
    if !is_noisy(table) {
        return 0.0;
    }
    let rows = &table.meta().per_incidence;
    let after = rows.partition_point(|row| row.theta_i_deg < theta_i_deg).min(rows.len() - 1);
    let before = if rows[after].theta_i_deg == theta_i_deg { after } else { after.saturating_sub(1) };
    let of = |i: usize| errors(table, component, i) + UNSEEN / rows[i].paths.max(1) as f64;
    (before..=after).map(of).fold(0.0, f64::max)
}

/// Σ error·weight of a component at an incidence.
fn errors(table: &Table, component: Component, i: usize) -> f64 {
    let summary = &table.meta().per_incidence[i];
    let width = summary.azimuth_width_deg.to_radians();
    let weights = measure::reading_weights(&table.meta().exit_axis, summary.theta_i_deg.to_radians(), width);
    let errors = table.at_incidence(&table.lobe(component).std_error, i);
    weights.iter().zip(errors).map(|(weight, error)| weight * f64::from(*error)).sum()
}

/// A number of a summary with what is known of its error.
struct Number {
    field: &'static str,
    value: f64,
    /// By noise; none of a number without.
    std_error: Option<f64>,
    /// Without a law.
    stated: f64,
    /// Variance for a unit of light.
    unit: f64,
}

/// The numbers of one stored incidence.
struct Numbers {
    shares: [Number; 6],
    moments: [Number; 2],
    /// Paths that left the top.
    reflected: f64,
}

impl Numbers {
    /// `all` is the reflected light.
    fn of(table: &Table, i: usize, all: f64) -> Self {
        let meta = table.meta();
        let (s, walked) = (&meta.per_incidence[i], meta.solver == Solver::Walk);
        let e = &s.std_error;
        // Shares of the surface that met interface 0 alone are counted, path by path.
        let rehit_error = (s.rehit * (1.0 - s.rehit) / s.paths.max(1) as f64).sqrt();
        // A lobe that may be off by a total variation may hold twice as much more light.
        let of_lobe = 0.02 * s.accuracy_percent * all;
        let of_surface =
            |component: Component, own: f64| 2.0 * stated(table, component, Some(i), (all * own).sqrt());
        let unit = 1.0 / s.paths.max(1) as f64;
        let number = |field, value: f64, error: f64, lobe: f64| {
            // Compact tables keep two digits of an error and seven of a share.
            let digits = if meta.compact.is_some() { 1e-6 * value } else { 0.0 };
            let rounding = ROUNDING * value.max(1e-3) + digits;
            if walked {
                Number { field, value, std_error: Some(error), stated: rounding, unit }
            } else {
                Number { field, value, std_error: None, stated: error.max(lobe) + rounding, unit: 0.0 }
            }
        };
        Self {
            shares: [
                number("albedo", s.albedo, e.albedo, of_lobe),
                number("transmitted", s.transmitted, e.transmitted, of_lobe),
                number("absorbed", s.absorbed, e.absorbed, of_lobe),
                number("truncated", s.truncated, e.truncated, 0.0),
                number("surface", s.surface, e.surface, of_surface(Component::Surface, s.surface)),
                number(
                    "rehit",
                    s.rehit,
                    if walked { rehit_error } else { 0.0 },
                    of_surface(Component::Rehit, s.rehit),
                ),
            ],
            moments: [
                number("mean_theta_o_deg", s.mean_theta_o_deg, e.mean_theta_o_deg, 0.0),
                number("sd_theta_o_deg", s.sd_theta_o_deg, e.sd_theta_o_deg, 0.0),
            ],
            reflected: if walked { s.albedo * s.paths as f64 } else { f64::INFINITY },
        }
    }
}

impl Number {
    /// A share of the light against another's.
    fn against(&self, other: &Self) -> Option<ShareDifference> {
        let difference = self.value - other.value;
        let allowed = self.stated + other.stated;
        if self.std_error.is_none() && other.std_error.is_none() {
            let known = self.value > 0.0 || other.value > 0.0;
            return known.then_some(ShareDifference {
                field: self.field,
                difference,
                allowed,
                z: None,
                p: None,
            });
        }
        // Half of it: of a single number all may be off in one direction.
        let light = |number: &Self| Light::one(number.value, number.std_error.unwrap_or(0.0), number.unit);
        let [a, b] = [light(self), light(other)];
        let verdict = explain::explained(&a, &b, 0.5 * allowed)?;
        let z = Some(verdict.chi2.sqrt().copysign(difference));
        Some(ShareDifference { field: self.field, difference, allowed, z, p: Some(verdict.p) })
    }

    fn moment_against(&self, other: &Self) -> Option<ShareDifference> {
        let error = self.std_error.unwrap_or(0.0).hypot(other.std_error.unwrap_or(0.0));
        let (difference, allowed) = (self.value - other.value, self.stated + other.stated);
        (error > 0.0).then(|| {
            let z = (difference.abs() - allowed).max(0.0) / error;
            let p = Some(2.0 * Normal::standard().sf(z));
            ShareDifference { field: self.field, difference, allowed, z: Some(z.copysign(difference)), p }
        })
    }
}

/// Gauss–Legendre rule on [0, 1].
const POINTS: [(f64, f64); 3] =
    [(0.112_701_665_379_258_31, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];

/// Coordinates and weights of the rule in every cell.
fn rule(axis: &Stretched) -> Vec<(f64, f64)> {
    let at = axis.with_slope();
    let points = (0..axis.cells).flat_map(|cell| POINTS.map(|(t, weight)| (cell as f64 + t, weight)));
    points
        .map(|(position, weight)| {
            let (x, slope) = at(position);
            (x, weight * slope)
        })
        .collect()
}
