//! What must hold of a table, tried on the table itself.

use crate::error::FieldError;
use crate::model::axis::ExitAxis;
use crate::model::both_sides::{BothSides, Passage};
use crate::model::measure;
use crate::model::solver::Solver;
use crate::model::spectra::Spectra;
use crate::model::table::{Accuracy, Component, IncidenceSummary, Normals, Table};
use crate::ops::explain::{self, Light};
use crate::ops::moments::Moments;
use crate::read::lobe::Interpolant;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF as _, Normal};

/// Largest |reflected + transmitted + absorbed + truncated − 1|.
pub const ENERGY_TOLERANCE: f64 = 1e-12;
/// Largest relative difference between a lobe's hemispherical integral and its albedo.
pub const INTEGRAL_TOLERANCE: f64 = 1e-3;
/// Largest difference between two azimuths at θi = 0, as a share of the peak: the bake makes them equal, what is
/// left is the rounding of f32.
pub const AZIMUTH_TOLERANCE: f64 = 1e-6;

/// Largest relative difference of a stored error from the binomial one of its count: both are f32.
pub const ERROR_BAR_TOLERANCE: f64 = 1e-5;
/// Largest defect of reciprocity of visible normals in space: noise-free tables, read between cells, reach 2 %;
/// unweighted ones 9 %.
pub const RECIPROCITY_TOLERANCE: f64 = 0.05;
/// Largest defect of a table that was made reciprocal: what reading in double precision leaves is far below.
pub const RECIPROCAL_TABLE_TOLERANCE: f64 = 1e-5;
/// Beyond this angle facets shadow each other, which no facet model here knows: reciprocity ends.
const RECIPROCAL_BELOW_DEG: f64 = 80.0;
/// Largest step of a cell off the cubic through its four neighbours, beyond six standard errors, as a share of the
/// largest of the five (or a thousandth of the peak of all light). Noise-free lobes reach 0.13 in space at 90°, 0.03 elsewhere; a cell that is half again as high as it should be is past it.
pub const SMOOTHNESS_TOLERANCE: f64 = 0.25;
/// Smallest p of the variance of standardised differences that passes for honest: missed by chance once in 3,000.
pub const HONESTY_SIGNIFICANCE: f64 = 3e-4;
/// Share of the reflected light below which a doubling states no error of a component.
const UNSTATED: f64 = 1e-9;
/// Largest relative difference of a stored error of a doubling from what the accuracy states: f32, and sums of other quadratures.
const STATED_ERROR_TOLERANCE: f64 = 0.05;
/// Largest departure of the moments from those of the cells, beyond six standard errors of where in its cell a path is: of the mean and
/// of the standard deviation as a share of that, and of the skewness. Noise-free tables of 1 %
/// leave 0.003, 0.006 and 0.05.
const MOMENT_TOLERANCES: [f64; 3] = [0.01, 0.012, 0.075];
/// What taking the density for linear within cells may leave beyond that, times the fourth power of what the deviation within a cell is
/// to that of the lobe. Tables of 20 % leave up to half of it.
const CELL_MOMENTS: [f64; 3] = [20.0, 12.0, 20.0];
/// Cells of a doubling below this share of the peak may be the ringing of a truncated series: moments are tried with and without.
const RINGING: f64 = 1e-4;
/// Largest relative difference of numbers that follow from others of the file.
const ROUNDING: f64 = 1e-9;
/// Largest departure of colours from what holds of all colours, of seven digits and of those of compact files.
const COLOUR_TOLERANCE: f64 = 1e-5;
const COMPACT_COLOUR_TOLERANCE: f64 = 1e-2;
/// Largest total variation between the single reflection of a doubling and its closed form, as a share of its light: cells of few
/// points leave 8e-4.
const SINGLE_TOLERANCE: f64 = 2e-3;
/// Fewest paths that two tables together need in a cell that enters the test of honesty.
const FEWEST_TOGETHER: f32 = 50.0;

/// One property tried at every incidence; `worst` is the largest departure found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the property.
    pub check: &'static str,
    /// What was compared.
    pub what: &'static str,
    /// Whether the table has the property; `None` for what is measured for information only.
    pub pass: Option<bool>,
    /// Largest departure.
    pub worst: f64,
    /// Incidence where it was found, degrees.
    pub worst_theta_i_deg: f64,
    /// Wavelength of the lobe where it was found, nm.
    pub wavelength_nm: f64,
    /// Largest departure that passes; `None` for information.
    pub tolerance: Option<f64>,
}

/// Departures at several incidences, of which the largest counts.
#[derive(Debug)]
pub struct Worst {
    departure: f64,
    theta_i_deg: f64,
    wavelength_nm: f64,
}

impl Worst {
    /// None yet of a table.
    #[must_use]
    pub const fn of(table: &Table) -> Self {
        Self { departure: 0.0, theta_i_deg: 0.0, wavelength_nm: table.meta().wavelength_nm }
    }

    /// Takes a departure into account.
    pub const fn note(&mut self, departure: f64, theta_i_deg: f64) {
        // A NaN is the worst of all, and stays.
        if departure > self.departure || departure.is_nan() {
            self.departure = departure;
            self.theta_i_deg = theta_i_deg;
        }
    }

    /// The finding, held against what passes.
    #[must_use]
    pub fn judged(self, check: &'static str, what: &'static str, tolerance: f64) -> Finding {
        let pass = Some(self.departure <= tolerance);
        Finding { pass, tolerance: Some(tolerance), ..self.told(check, what) }
    }

    fn told(self, check: &'static str, what: &'static str) -> Finding {
        let Self { departure: worst, theta_i_deg: worst_theta_i_deg, wavelength_nm } = self;
        Finding { check, what, pass: None, worst, worst_theta_i_deg, wavelength_nm, tolerance: None }
    }
}

/// Tries everything on a valid table, the lobes at further wavelengths too: of each property the worst of all is told.
#[must_use]
pub fn check(lobe: &Interpolant) -> Vec<Finding> {
    let mut findings = of_one_wavelength(lobe);
    // Bands that make no table were refused by the reader.
    for table in lobe.table().further_bands().unwrap_or_default() {
        findings = worse(findings, of_one_wavelength(&Interpolant::new(table)));
    }
    if let Some(sides) = &lobe.table().meta().both_sides {
        findings.extend([
            energy_from_below(lobe.table(), sides),
            integral_of_passages(lobe.table(), sides),
            both_sides(lobe.table(), sides),
        ]);
    }
    findings
}

/// Of every property the worse of two findings.
#[must_use]
pub fn worse(findings: Vec<Finding>, others: Vec<Finding>) -> Vec<Finding> {
    let badness = |finding: &Finding| (finding.pass == Some(false), finding.worst);
    let mut all = findings;
    for other in others {
        match all.iter_mut().find(|finding| finding.check == other.check) {
            Some(finding) if badness(finding) < badness(&other) => *finding = other,
            Some(_) => {}
            None => all.push(other),
        }
    }
    all
}

fn of_one_wavelength(lobe: &Interpolant) -> Vec<Finding> {
    let table = lobe.table();
    let mut findings = vec![energy(table), ledger(table), positivity(table), integral_at_nodes(table)];
    findings.push(integral_between_nodes(lobe));
    findings.extend(counts(table));
    findings.extend(error_bars(table));
    findings.push(moments(table));
    findings.extend(accuracy(table));
    findings.extend(table.meta().spectra.as_ref().map(|spectra| colours(table, spectra)));
    findings.push(smoothness(table));
    findings.extend(azimuth_at_normal_incidence(table));
    findings.push(reciprocity(lobe));
    findings.push(roughness(table));
    findings
}

fn energy_from_below(table: &Table, sides: &BothSides) -> Finding {
    let mut worst = Worst::of(table);
    for below in &sides.from_below {
        worst.note((below.reflected + below.transmitted + below.absorbed - 1.0).abs(), below.theta_i_deg);
    }
    worst.judged(
        "energy_from_below",
        "|reflected + transmitted + absorbed - 1| of light from below",
        ENERGY_TOLERANCE,
    )
}

fn integral_of_passages(table: &Table, sides: &BothSides) -> Finding {
    let mut worst = Worst::of(table);
    for passage in Passage::ALL {
        let weights = sides.weights(passage, &table.meta().exit_axis);
        let Some(values) = table.passage(passage) else { continue };
        for (i, (s, below)) in table.meta().per_incidence.iter().zip(&sides.from_below).enumerate() {
            let cells = table.at_incidence(&weights, i).iter().zip(table.at_incidence(values, i));
            let integral: f64 = cells.map(|(w, v)| f64::from(*w) * f64::from(*v)).sum();
            let share = match passage {
                Passage::Transmitted => s.transmitted,
                Passage::BelowReflected => below.reflected,
                Passage::BelowTransmitted => below.transmitted,
            };
            worst.note(relative(integral, share, 1.0, 1e-9), s.theta_i_deg);
        }
    }
    let what = "hemispherical integral of what passes and of what comes from below against its share";
    worst.judged("integral_of_passages", what, INTEGRAL_TOLERANCE)
}

/// The accuracy asked for is that of light from above that comes back: the other lobes have their own.
fn both_sides(table: &Table, sides: &BothSides) -> Finding {
    let mut worst = Worst::of(table);
    for below in &sides.from_below {
        for passage in Passage::ALL {
            worst.note(below.accuracy_percent.of(passage) / 100.0, below.theta_i_deg);
        }
    }
    worst.told(
        "both_sides",
        "estimated total variation of the worst of what passes and of what comes from below",
    )
}

fn energy(table: &Table) -> Finding {
    let mut worst = Worst::of(table);
    for s in &table.meta().per_incidence {
        let sum = s.albedo + s.transmitted + s.absorbed + s.truncated;
        worst.note((sum - 1.0).abs(), s.theta_i_deg);
    }
    worst.judged("energy", "|albedo + transmitted + absorbed + truncated - 1|", ENERGY_TOLERANCE)
}

fn ledger(table: &Table) -> Finding {
    let mut worst = Worst::of(table);
    for s in &table.meta().per_incidence {
        worst.note((s.surface - s.albedo).max(s.rehit - s.surface).max(0.0), s.theta_i_deg);
    }
    worst.judged("ledger", "excess of rehit over surface, or of surface over albedo", ENERGY_TOLERANCE)
}

fn positivity(table: &Table) -> Finding {
    let mut worst = Worst::of(table);
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        for component in Component::ALL {
            let lobe = table.lobe(component);
            for samples in [&lobe.value, &lobe.std_error, &lobe.count] {
                for sample in table.at_incidence(samples, i) {
                    worst.note(f64::from(-*sample), s.theta_i_deg);
                }
            }
        }
    }
    worst.judged("positivity", "most negative value, standard error or count", 0.0)
}

fn integral_at_nodes(table: &Table) -> Finding {
    // Rows are made to hold their shares, however little light that is, but for those that are rounding.
    let faintest =
        |share: f64| if table.meta().compact.is_some() || share < ROUNDED { FAINTEST_AS_READ } else { 1e-9 };
    let axis = &table.meta().exit_axis;
    let mut worst = Worst::of(table);
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        let theta_i = s.theta_i_deg.to_radians();
        let weights = measure::reading_weights(axis, theta_i, s.azimuth_width_deg.to_radians());
        for component in Component::ALL {
            let values = table.at_incidence(&table.lobe(component).value, i);
            let integral: f64 = weights.iter().zip(values).map(|(w, v)| w * f64::from(*v)).sum();
            let share = s.share(component);
            worst.note(relative(integral, share, s.albedo, faintest(share)), s.theta_i_deg);
        }
    }
    worst.judged("integral", "hemispherical integral of a stored lobe against its albedo", INTEGRAL_TOLERANCE)
}

fn integral_between_nodes(lobe: &Interpolant) -> Finding {
    let mut worst = Worst::of(lobe.table());
    for pair in lobe.table().meta().per_incidence.windows(2) {
        // Not a simple fraction: corrections are known at quarters, and must hold between them too.
        let theta_deg = pair[0].theta_i_deg + 0.437 * (pair[1].theta_i_deg - pair[0].theta_i_deg);
        let theta_i = theta_deg.to_radians();
        let integrals = lobe.row(theta_i).integrals();
        let [interior, surface, rehit] = Component::ALL.map(|component| lobe.albedo(component, theta_i));
        for (integral, share) in integrals.into_iter().zip([interior, surface, rehit]) {
            worst.note(relative(integral, share, interior + surface, FAINTEST_AS_READ), theta_deg);
        }
    }
    worst.judged(
        "integral_between",
        "the same between incidences, as read, against the interpolated albedo",
        INTEGRAL_TOLERANCE,
    )
}

/// Share of the reflected light below which a part as it is read is measured against that: nobody sees it, and the truncated series
/// of the doubling solver rings there.
const FAINTEST_AS_READ: f64 = 1e-4;

/// Share of the incident light below which the share of a part is the rounding of the others.
const ROUNDED: f64 = 1e-12;

/// |integral/share − 1|; of a part below the `faintest` share of the reflected light in units of that.
fn relative(integral: f64, share: f64, albedo: f64, faintest: f64) -> f64 {
    (integral - share).abs() / share.max(faintest * albedo).max(1e-12)
}

/// Light that never entered the stack, and all light where nothing absorbs, has weight 1 a path: its share is counted paths over paths.
/// What was absorbed in part was counted whole.
fn counts(table: &Table) -> Option<Finding> {
    if table.meta().solver != Solver::Walk || table.meta().compact.is_some() {
        return None;
    }
    let mut worst = Worst::of(table);
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        let paths = s.paths.max(1) as f64;
        let mut all = 0.0;
        for component in Component::ALL {
            let counts = table.at_incidence(&table.lobe(component).count, i);
            let counted = counts.iter().map(|count| f64::from(*count)).sum::<f64>() / paths;
            let share = s.share(component);
            let weighted = component == Component::Interior && s.absorbed > 0.0;
            worst.note(if weighted { share - counted } else { (share - counted).abs() }, s.theta_i_deg);
            all += if component == Component::Rehit { 0.0 } else { counted };
        }
        worst.note(all - 1.0, s.theta_i_deg);
    }
    // f32 counts above 2^24 are rounded by 6e-8 each.
    Some(worst.judged(
        "counts",
        "paths counted in cells against the shares that they are, share of the paths",
        1e-6,
    ))
}

fn azimuth_at_normal_incidence(table: &Table) -> Option<Finding> {
    let at = table.meta().per_incidence.iter().position(|s| s.theta_i_deg == 0.0)?;
    let mut worst = Worst::of(table);
    for component in Component::ALL {
        let values = table.at_incidence(&table.lobe(component).value, at);
        let peak = values.iter().copied().fold(0.0, f32::max);
        let against: Vec<f32> = match table.meta().exit_axis {
            ExitAxis::Plane { .. } => values.iter().rev().copied().collect(),
            ExitAxis::Space { theta_cells, .. } => {
                values[..theta_cells].iter().copied().cycle().take(values.len()).collect()
            }
        };
        for (value, other) in values.iter().zip(against) {
            if peak > 0.0 {
                worst.note(f64::from((value - other).abs()) / f64::from(peak), 0.0);
            }
        }
    }
    Some(worst.judged(
        "azimuth",
        "difference between azimuths at normal incidence, share of the peak",
        AZIMUTH_TOLERANCE,
    ))
}

/// Σ|f(a→b) − f(b→a)|·cos·cos / Σ(…) in the plane of incidence over pairs of the table's incidences, less what the
/// stored errors explain. It must vanish for visible normals in space, away from grazing; unweighted facets are not
/// reciprocal, nor is the azimuth postulate: there it is told, not judged.
fn reciprocity(lobe: &Interpolant) -> Finding {
    let table = lobe.table();
    let made_so = table.meta().reciprocal.is_some();
    let walked = table.meta().solver == Solver::Walk;
    let below = if made_so { 90.0 } else { RECIPROCAL_BELOW_DEG };
    let angles: Vec<f64> =
        table.theta_i().into_iter().filter(|theta| *theta < f64::to_radians(below)).collect();
    let rows: Vec<_> = angles.iter().map(|&theta| lobe.row(theta)).collect();
    let at = |i: usize, o: usize| {
        let parts = [Component::Interior, Component::Surface];
        let cos = angles[i].cos();
        let value: f64 = parts.iter().map(|&part| rows[i].eval(part, angles[o], 0.0)).sum();
        let variance: f64 = parts.iter().map(|&part| rows[i].std_error(part, angles[o], 0.0).powi(2)).sum();
        (value * cos, variance * cos * cos)
    };
    let mut worst = Worst::of(table);
    for (a, theta_i) in angles.iter().enumerate() {
        let (mut difference, mut sum) = (0.0, 0.0);
        for b in 0..angles.len() {
            let ((forth, variance), (back, other)) = (at(a, b), at(b, a));
            // Of a direction that no path took a walk knows neither value nor error.
            if walked && !made_so && (variance == 0.0 || other == 0.0) {
                continue;
            }
            // E|x| of a normal deviate is √(2/π) standard deviations.
            let noise = (std::f64::consts::FRAC_2_PI * (variance + other)).sqrt();
            // Reading is the same both ways in a table that was made so, whatever its noise.
            difference += (forth - back).abs() - if made_so { 0.0 } else { noise };
            sum += forth + back;
        }
        if sum > 0.0 {
            worst.note(difference.max(0.0) / sum, theta_i.to_degrees());
        }
    }
    let what = "defect in the plane of incidence below 80°, beyond noise, share of the light";
    if made_so {
        let what = "defect in the plane of incidence, share of the light";
        return worst.judged("reciprocity", what, RECIPROCAL_TABLE_TOLERANCE);
    }
    let space = matches!(table.meta().exit_axis, ExitAxis::Space { .. });
    if space && table.meta().surface_model.normals == Normals::Visible {
        // At both angles lobes are read between cells, in the plane of incidence, where those of tables in space change most.
        let between_cells = table.meta().accuracy.cells_percent.unwrap_or(0.0) / 100.0;
        return worst.judged("reciprocity", what, RECIPROCITY_TOLERANCE + 10.0 * between_cells);
    }
    worst.told("reciprocity", what)
}

/// Median of |second difference| over its standard error, worst incidence: about 0.67 for pure noise, large where
/// cells are too coarse for the lobe.
fn roughness(table: &Table) -> Finding {
    let columns = table.meta().exit_axis.columns();
    let mut worst = Worst::of(table);
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        let values = table.at_incidence(&table.lobe(Component::Interior).value, i);
        let errors = table.at_incidence(&table.lobe(Component::Interior).std_error, i);
        let mut scores = Vec::new();
        for (v, e) in values.chunks_exact(columns).zip(errors.chunks_exact(columns)) {
            for (v, e) in v.windows(3).zip(e.windows(3)) {
                let bend = f64::from(v[0]) - 2.0 * f64::from(v[1]) + f64::from(v[2]);
                let error =
                    (f64::from(e[0]).powi(2) + 4.0 * f64::from(e[1]).powi(2) + f64::from(e[2]).powi(2))
                        .sqrt();
                if error > 0.0 {
                    scores.push((bend / error).abs());
                }
            }
        }
        scores.sort_by(f64::total_cmp);
        worst.note(scores.get(scores.len() / 2).copied().unwrap_or(0.0), s.theta_i_deg);
    }
    worst.told("roughness", "median |second difference| of the interior in standard errors (0.67 is noise)")
}

/// What the errors must be: those of a walk's counts, or what a doubling's accuracy comes to. Compact tables hold none.
fn error_bars(table: &Table) -> Option<Finding> {
    match (table.meta().solver, &table.meta().compact) {
        (_, Some(_)) => None,
        (Solver::Walk, None) => Some(counted_errors(table)),
        (Solver::Doubling, None) => Some(stated_errors(table)),
    }
}

/// The standard error of a share s of n paths is √(s(1 − s)/n) where every path has weight 1. Of c paths that absorption left less of
/// it is at most that, and at least what c equal weights would have.
fn counted_errors(table: &Table) -> Finding {
    let mut worst = Worst::of(table);
    // Values were moved, each with its error; moments and shares of light by cell are others.
    let moved = table.meta().reciprocal.is_some();
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        let paths = s.paths as f64;
        let binomial = |share: f64| (share * (1.0 - share) / paths).sqrt();
        let absorbs = s.absorbed > 0.0;
        let mut summary = |found: f64, expected: f64, exact: bool| {
            let over = if expected > 0.0 { found / expected - 1.0 } else { found };
            worst.note(if exact { over.abs() } else { over }, s.theta_i_deg);
        };
        summary(s.std_error.surface, binomial(s.surface), true);
        summary(s.std_error.albedo, binomial(s.albedo), !absorbs);
        summary(s.std_error.transmitted, binomial(s.transmitted), !absorbs);
        if !absorbs && !moved && s.sd_theta_o_deg > 0.0 {
            summary(s.std_error.mean_theta_o_deg, s.sd_theta_o_deg / (s.albedo * paths).sqrt(), true);
        }
        // At normal incidence values and errors are means over cells, counts are each cell's own.
        if s.theta_i_deg == 0.0 {
            continue;
        }
        for component in Component::ALL {
            let weighted = component == Component::Interior && absorbs;
            let shares = Light::stored(table, component, i).share;
            let lobe = table.lobe(component);
            let cells = table.at_incidence(&lobe.value, i).iter().zip(table.at_incidence(&lobe.std_error, i));
            let counts = table.at_incidence(&lobe.count, i);
            for (((value, error), count), share) in cells.zip(counts).zip(shares) {
                let (value, error) = (f64::from(*value), f64::from(*error));
                // In a cell of all paths there is no spread that rounding could show.
                let spread = 1.0 / f64::from(*count) - 1.0 / paths;
                if *count == 0.0 || spread <= 1e-6 / paths {
                    continue;
                }
                let least = value * spread.sqrt();
                if !weighted {
                    worst.note((error / least - 1.0).abs(), s.theta_i_deg);
                } else if value > 0.0 {
                    worst.note(1.0 - error / least, s.theta_i_deg);
                    if !moved {
                        let most = value * ((1.0 / share - 1.0) / paths).max(0.0).sqrt();
                        worst.note(error / most - 1.0, s.theta_i_deg);
                    }
                }
            }
        }
    }
    let what = "stored standard errors against those that counts and shares leave room for, relative";
    worst.judged("error_bars", what, ERROR_BAR_TOLERANCE)
}

/// The error of a doubling is one share of each component's cells; what they come to together is the accuracy of the incidence, give
/// or take that of the re-hits.
fn stated_errors(table: &Table) -> Finding {
    let mut worst = Worst::of(table);
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        if s.theta_i_deg == 0.0 {
            continue;
        }
        let width = s.azimuth_width_deg.to_radians();
        let weights = measure::reading_weights(&table.meta().exit_axis, s.theta_i_deg.to_radians(), width);
        let mut light = |component: Component| {
            let lobe = table.lobe(component);
            let (values, errors) =
                (table.at_incidence(&lobe.value, i), table.at_incidence(&lobe.std_error, i));
            let sum = |samples: &[f32]| -> f64 {
                weights.iter().zip(samples).map(|(weight, sample)| weight * f64::from(*sample)).sum()
            };
            let (own, error) = (sum(values), sum(errors));
            let share = if own > 0.0 { error / own } else { 0.0 };
            let largest = values.iter().copied().fold(0.0, f32::max);
            for (value, error) in values.iter().zip(errors) {
                let apart = (f64::from(*error) - share * f64::from(*value)).abs();
                if error > &0.0 && apart > 0.0 {
                    worst.note(
                        apart / (share * f64::from(*value).max(1e-6 * f64::from(largest))),
                        s.theta_i_deg,
                    );
                }
            }
            0.5 * error
        };
        let [interior, _, rehit] = Component::ALL.map(&mut light);
        let all = 0.01 * s.accuracy_percent * s.albedo;
        let apart = (interior - all).abs() - rehit;
        // Of an interior that is rounding no error is stated.
        if apart > 0.0 && s.share(Component::Interior) > UNSTATED * s.albedo {
            worst.note(apart / all.max(f64::MIN_POSITIVE), s.theta_i_deg);
        }
    }
    let what = "stored errors against each other and against the accuracy of their incidence, relative";
    worst.judged("error_bars", what, STATED_ERROR_TOLERANCE)
}

/// The moments of the exit angle against those of the cells, in their tolerances.
fn moments(table: &Table) -> Finding {
    let mut worst = Worst::of(table);
    let signed = table.meta().exit_axis.rows_per_incidence() == 1;
    let rings = table.meta().solver == Solver::Doubling;
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        if !is_resolved(table, i) {
            continue;
        }
        // With all cells, and without those that ring: the truth is between.
        let [Some(whole), Some(core)] =
            [0.0, if rings { RINGING } else { 0.0 }].map(|least| Moments::of_cells(table, i, least))
        else {
            continue;
        };
        let sd = s.sd_theta_o_deg.to_radians();
        let stored = [s.mean_theta_o_deg.to_radians(), sd, s.skew_theta_o];
        let noise = if s.paths > 0 {
            whole.noise.map(|x| 6.0 * x / (s.albedo * s.paths as f64).sqrt())
        } else {
            [0.0; 3]
        };
        let scales = [sd, sd, 1.0];
        let within = [0, 1, 1].map(|k: usize| (whole.noise[k] / whole.moments[1]).powi(4));
        for k in 0..3 {
            // At θi = 0 both sides hold their common mean, which has neither mean nor skewness.
            if signed && s.theta_i_deg == 0.0 && k != 1 {
                continue;
            }
            let (low, high) = (whole.moments[k].min(core.moments[k]), whole.moments[k].max(core.moments[k]));
            let apart = (low - stored[k]).max(stored[k] - high).max(0.0);
            let beyond = (apart - noise[k]).max(0.0) / scales[k];
            worst.note(beyond / (MOMENT_TOLERANCES[k] + CELL_MOMENTS[k] * within[k]), s.theta_i_deg);
        }
    }
    let what = "mean, standard deviation and skewness against those of the cells, in 1 % and 1.2 % of the deviation and 0.075, more where cells are few";
    // Of a compact table they are those of the table that it was made from.
    if table.meta().compact.is_some() {
        worst.told("moments", what)
    } else {
        worst.judged("moments", what, 1.0)
    }
}

/// The accuracy of the table against its parts. Of a compact table it is theirs and what was lost.
fn accuracy(table: &Table) -> Option<Finding> {
    let meta = table.meta();
    if meta.compact.is_some() {
        return None;
    }
    let mut worst = Worst::of(table);
    let Accuracy { reached_percent, worst_theta_i_deg, solver_percent, rows_percent, cells_percent, .. } =
        meta.accuracy;
    let largest = meta.per_incidence.iter().map(|s| s.accuracy_percent).fold(0.0, f64::max);
    let at = |s: &&IncidenceSummary| s.theta_i_deg == worst_theta_i_deg;
    let named = meta.per_incidence.iter().find(at).map_or(f64::NAN, |s| s.accuracy_percent);
    let cells = cells_percent.unwrap_or(0.0);
    let read = match meta.solver {
        Solver::Doubling => solver_percent + rows_percent + cells,
        Solver::Walk => f64::max(
            solver_percent.hypot(cells),
            (solver_percent / std::f64::consts::SQRT_2).hypot(rows_percent + cells),
        ),
    };
    for (found, expected) in [(solver_percent, largest), (named, largest), (reached_percent, read)] {
        worst.note((found - expected).abs() / expected.max(1e-9), worst_theta_i_deg);
    }
    Some(worst.judged(
        "accuracy",
        "accuracy of the table against that of its incidences and parts, relative",
        ROUNDING,
    ))
}

/// What holds of all colours: M is at most 1/R_incoherent, the mean of Ê over the visible bands is 1.
fn colours(table: &Table, spectra: &Spectra) -> Finding {
    let mut worst = Worst::of(table);
    if let Some(coherent) = &spectra.coherent {
        for (k, theta) in coherent.theta_deg.iter().enumerate() {
            let rows = coherent.modulation[k].iter().chain(&coherent.modulation_rgb[k]);
            let largest = rows.copied().fold(0.0, f64::max);
            let scales = spectra.thickness.iter().flat_map(|thickness| &thickness.modulation_rgb);
            let largest = scales.flat_map(|rows| rows[k]).fold(largest, f64::max);
            worst.note(largest * coherent.incoherent[k] - 1.0, *theta);
        }
    }
    if let Some(emission) = &spectra.emission {
        let visible = spectra.visible();
        for (theta, row) in emission.theta_deg.iter().zip(&emission.radiance) {
            let row = &row[visible.clone()];
            worst.note((row.iter().sum::<f64>() / row.len() as f64 - 1.0).abs(), *theta);
        }
    }
    let compact = table.meta().compact.is_some();
    let tolerance = if compact { COMPACT_COLOUR_TOLERANCE } else { COLOUR_TOLERANCE };
    worst.judged("colours", "reflectance M·R_incoherent beyond 1, or mean of the emission off 1", tolerance)
}

/// The single reflection that a table holds, `surface` less `rehit`, against its closed form: `expected`, its share in every cell of every
/// incidence, from one who knows interface 0. `None` for tables whose cells are no more those of a solver.
#[must_use]
pub fn single_reflection(table: &Table, expected: &[Vec<f64>]) -> Option<Finding> {
    let meta = table.meta();
    if meta.compact.is_some() || meta.reciprocal.is_some() {
        return None;
    }
    let mut worst = Worst::of(table);
    let mut tests = 0.0;
    for (i, (s, cells)) in meta.per_incidence.iter().zip(expected).enumerate() {
        let [surface, rehit] =
            [Component::Surface, Component::Rehit].map(|part| Light::stored(table, part, i));
        let less = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).max(0.0)).collect();
        let single = Light {
            share: less(&surface.share, &rehit.share),
            variance: less(&surface.variance, &rehit.variance),
            unit: surface.unit,
        };
        let exact = Light::exact(&meta.exit_axis, s.theta_i_deg.to_radians(), cells);
        let light: f64 = exact.share.iter().sum();
        if meta.solver == Solver::Walk {
            let Some(verdict) = explain::explained(&single, &exact, SINGLE_TOLERANCE * light) else {
                continue;
            };
            tests += 1.0;
            worst.note(-verdict.p.max(f64::MIN_POSITIVE).log10(), s.theta_i_deg);
        } else if light > 0.0 {
            let apart: f64 = single.share.iter().zip(&exact.share).map(|(a, b)| (a - b).abs()).sum();
            worst.note(0.5 * apart / light, s.theta_i_deg);
        }
    }
    Some(if meta.solver == Solver::Walk {
        let what = "single reflection against its closed form: decimal digits of the chance that noise is as far off";
        worst.judged("single_reflection", what, -(HONESTY_SIGNIFICANCE / f64::max(tests, 1.0)).log10())
    } else {
        let what = "total variation between the single reflection and its closed form, share of it";
        worst.judged("single_reflection", what, SINGLE_TOLERANCE)
    })
}

/// A lobe narrower than this many of its narrowest cells has no shape that cells could show: smooth interfaces, or
/// nearly.
const FEWEST_CELLS: f64 = 2.0;

/// Whether the lobe of incidence i is wide enough to have a shape in the cells.
fn is_resolved(table: &Table, i: usize) -> bool {
    let summary = &table.meta().per_incidence[i];
    let edges = table.meta().exit_axis.columns_at(summary.theta_i_deg.to_radians()).edges();
    let narrowest = edges.windows(2).map(|edge| edge[1] - edge[0]).fold(f64::INFINITY, f64::min);
    summary.sd_theta_o_deg.to_radians() >= FEWEST_CELLS * narrowest
}

/// The largest value of all light of incidence i, per steradian.
fn peak(table: &Table, i: usize) -> f64 {
    let [interior, surface] = [Component::Interior, Component::Surface]
        .map(|component| table.at_incidence(&table.lobe(component).value, i));
    interior.iter().zip(surface).map(|(a, b)| f64::from(a + b)).fold(0.0, f64::max)
}

/// A cell that sticks out of its neighbours by more than noise can.
fn smoothness(table: &Table) -> Finding {
    const NOISE: f64 = 6.0;
    // The single reflection's ridge towards the horizon is narrower than cells.
    const RIDGE: f64 = 10.0;
    let columns = table.meta().exit_axis.columns();
    let mut worst = Worst::of(table);
    let between_cells = table.meta().accuracy.cells_percent.unwrap_or(0.0) / 100.0;
    // Where there is a thousandth of the peak, truncated series ring; as much as the worst says that it is off, if that is more. Below what
    // reading misses between cells, they are too few to tell a step.
    let ringing = match table.meta().solver {
        Solver::Walk => between_cells.max(1e-3),
        Solver::Doubling => {
            let solved = table.meta().per_incidence.iter().map(|s| s.accuracy_percent / 100.0);
            solved.fold(between_cells.max(1e-3), f64::max)
        }
    };
    let space = table.meta().exit_axis.rows_per_incidence() > 1;
    let narrow = if space { RIDGE * between_cells } else { 0.0 };
    for (i, s) in table.meta().per_incidence.iter().enumerate() {
        if !is_resolved(table, i) {
            continue;
        }
        for (component, faintest) in
            [(Component::Interior, ringing), (Component::Surface, ringing.max(narrow))]
        {
            let (lobe, faintest) = (table.lobe(component), faintest * peak(table, i));
            let (values, errors) =
                (table.at_incidence(&lobe.value, i), table.at_incidence(&lobe.std_error, i));
            for (v, e) in values.chunks_exact(columns).zip(errors.chunks_exact(columns)) {
                for (v, e) in v.windows(5).zip(e.windows(5)) {
                    let v: [f64; 5] = std::array::from_fn(|k| f64::from(v[k]));
                    let e: [f64; 5] = std::array::from_fn(|k| f64::from(e[k]));
                    let step = v[2] - (4.0 * (v[1] + v[3]) - v[0] - v[4]) / 6.0;
                    let around = (16.0 * (e[1].powi(2) + e[3].powi(2)) + e[0].powi(2) + e[4].powi(2)) / 36.0;
                    let noise = (around + e[2].powi(2)).sqrt();
                    let largest = v.into_iter().fold(faintest, f64::max);
                    if largest > 0.0 {
                        worst.note((step.abs() - NOISE * noise).max(0.0) / largest, s.theta_i_deg);
                    }
                }
            }
        }
    }
    let what =
        "step of a cell off the cubic through its neighbours, beyond 6 standard errors, share of the largest";
    if table.meta().solver == Solver::Walk && table.meta().compact.is_some() {
        // What was noise is not known any more.
        return worst.told("smoothness", what);
    }
    worst.judged("smoothness", what, SMOOTHNESS_TOLERANCE)
}

/// Whether two walks of one recipe differ as their stored errors say: the variance of the standardised differences.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Honesty {
    /// `interior`, `surface`, or `summaries` (albedo and mean exit angle).
    pub of: &'static str,
    /// Number of differences.
    pub count: usize,
    /// Mean square of (a − b)/√(σa² + σb²): 1 if the errors are honest, above if they are too small.
    pub variance: f64,
    /// Probability of a variance as far from 1, on either side, if the errors are honest.
    pub p: f64,
    /// Departure of the variance from 1 in its own standard deviations √(2/count).
    pub departure: f64,
}

/// Compares two walks of the same recipe with different seeds.
///
/// Cells count if they hold at least 50 paths in both tables together. For two walks of equally many unweighted
/// paths the expectation is exactly 1 at any count: given n paths in both, each table has n/2 ± √n/2.
///
/// # Errors
/// Tables that say nothing about each other's errors; the error names what differs (or does not).
pub fn honesty(a: &Table, b: &Table) -> Result<Vec<Honesty>, FieldError> {
    comparable(a, b)?;
    let mut found = Vec::new();
    for component in [Component::Interior, Component::Surface] {
        let (x, y) = (a.lobe(component), b.lobe(component));
        let mut squares = Vec::new();
        for i in 0..a.meta().per_incidence.len() {
            let [va, ea, na] = [&x.value, &x.std_error, &x.count].map(|samples| a.at_incidence(samples, i));
            let [vb, eb, nb] = [&y.value, &y.std_error, &y.count].map(|samples| b.at_incidence(samples, i));
            for k in independent_cells(a, i) {
                if na[k] + nb[k] >= FEWEST_TOGETHER {
                    squares.extend(square(va[k].into(), vb[k].into(), ea[k].into(), eb[k].into()));
                }
            }
        }
        found.extend(Honesty::of(component.name(), &squares));
    }
    let mut squares = Vec::new();
    for (s, t) in a.meta().per_incidence.iter().zip(&b.meta().per_incidence) {
        let (e, f) = (&s.std_error, &t.std_error);
        squares.extend(square(s.albedo, t.albedo, e.albedo, f.albedo));
        squares.extend(square(
            s.mean_theta_o_deg,
            t.mean_theta_o_deg,
            e.mean_theta_o_deg,
            f.mean_theta_o_deg,
        ));
    }
    found.extend(Honesty::of("summaries", &squares));
    Ok(found)
}

/// The square of a standardised difference; none where there is no error to measure it by.
fn square(a: f64, b: f64, error_a: f64, error_b: f64) -> Option<f64> {
    let variance = error_a.powi(2) + error_b.powi(2);
    (variance > 0.0).then(|| (a - b).powi(2) / variance)
}

impl Honesty {
    fn of(of: &'static str, squares: &[f64]) -> Option<Self> {
        let count = squares.len();
        if count == 0 {
            return None;
        }
        let variance = squares.iter().sum::<f64>() / count as f64;
        let departure = (variance - 1.0) / (2.0 / count as f64).sqrt();
        // Wilson and Hilferty: the cube root of chi²/n is normal enough from a handful of terms on.
        let spread = 2.0 / (9.0 * count as f64);
        let normal = (variance.cbrt() - (1.0 - spread)) / spread.sqrt();
        let p = 2.0 * Normal::standard().sf(normal.abs());
        Some(Self { of, count, variance, p, departure })
    }
}

fn comparable(a: &Table, b: &Table) -> Result<(), FieldError> {
    let refuse = |field: &str, problem: &str| Err(FieldError::new(field, problem));
    let incidences =
        |table: &Table| table.meta().per_incidence.iter().map(|s| s.theta_i_deg).collect::<Vec<f64>>();
    if a.meta().solver != Solver::Walk || b.meta().solver != Solver::Walk {
        return refuse("solver", "is doubling, which has no statistical errors; expected two walks");
    }
    if a.meta().recipe != b.meta().recipe {
        return refuse("recipe", "differs; expected two walks of one recipe");
    }
    if a.meta().seed == b.meta().seed {
        return refuse("seed", "is the same; expected two walks with different seeds");
    }
    if a.meta().exit_axis != b.meta().exit_axis || incidences(a) != incidences(b) {
        return refuse("per_incidence", "has other incidences or cells; expected the same in both");
    }
    Ok(())
}

/// Cells that carry their own counts: at θi = 0 the bake stores each side (or each azimuth) as their common mean.
fn independent_cells(table: &Table, i: usize) -> std::ops::Range<usize> {
    let cells = table.meta().exit_axis.cells();
    if table.meta().per_incidence[i].theta_i_deg != 0.0 {
        return 0..cells;
    }
    match table.meta().exit_axis {
        ExitAxis::Plane { cells, .. } => 0..cells / 2,
        ExitAxis::Space { theta_cells, .. } => {
            let values = table.at_incidence(&table.lobe(Component::Interior).value, i);
            let repeated = values.chunks_exact(theta_cells).all(|row| row == &values[..theta_cells]);
            if repeated { 0..theta_cells } else { 0..cells }
        }
    }
}
