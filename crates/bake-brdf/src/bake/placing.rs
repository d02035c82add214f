//! Where the rows of a table go, and into how many cells each is divided: as few as reading to an accuracy takes.
//!
//! Linear mixing of two rows h apart misses the lobe half-way by κh²/4, κ a property of the incidence: it is found from lobes solved at
//! some forty incidences, rows go where every interval gets an equal share of ∫√κ, and lobes solved half-way between them say what was
//! reached. Reading between cells misses a share that falls with the square of their number.

use super::reading::{self, Look, Missed, Sample, interval};
use super::{BakeError, go_on};
use crate::recipe::Azimuth;
use lut_io::axis::ExitAxis;
use rayon::prelude::*;
use std::collections::HashMap;
use std::f64::consts::FRAC_PI_2;
use std::sync::atomic::AtomicBool;
use transport::doubling::{Operator, Solution, component_scale};

/// Incidences from which the bend of the lobes is known.
const SCOUTS: usize = 40;
/// Rounds of placing rows, and of choosing cells.
const ROUNDS: usize = 6;
/// So many intervals, or an eighth of them, may be halved by themselves.
const SPLIT: usize = 3;
/// Rows and cells aim at these shares of what they may miss; fewer cells than this share of those there are are not looked for.
const ROWS_AIM: f64 = 0.9;
const CELLS_AIM: f64 = 0.97;
/// Rows are too many where they miss less than this share of what they may miss; cells are few enough at this.
const FEW: f64 = 0.7;
const ENOUGH: f64 = 0.9;
/// In so many rounds of choosing cells their dimensions are balanced; there are no fewer.
const BALANCED: usize = 2;
/// Fewest and most rows.
const ROWS: std::ops::RangeInclusive<usize> = 3..=2001;
/// Incidences at which cells are chosen, and judged; and some so far from the horizon, in widths: there re-hits vanish, and their shape is as
/// narrow as what is left of them is faint.
const SPREAD_PROBES: usize = 10;
const GRAZING_PROBES: [f64; 3] = [0.1, 0.03, 0.012];
/// There cells may take as much more of the accuracy: what the solver leaves of re-hits is nothing.
const GRAZING_ALLOWANCE: f64 = 1.8;
/// Cells from which the choice starts, and fewest and most of a dimension.
const FIRST_CELLS: usize = 32;
const FEWEST_CELLS: usize = 12;
const MOST_CELLS: usize = 4096;

/// An incidence at which cells are chosen.
#[derive(Clone, Copy)]
pub(super) struct Probe {
    pub(super) theta_i: f64,
    /// How much more than elsewhere reading between cells may miss there.
    allowance: f64,
}

/// Incidences at which cells are chosen, ascending.
pub(super) fn probes(axis: &ExitAxis) -> Vec<Probe> {
    let spread = spread_out(SPREAD_PROBES, axis.width());
    let spread = spread.into_iter().map(|theta_i| Probe { theta_i, allowance: 1.0 });
    let grazing = GRAZING_PROBES.map(|widths| FRAC_PI_2 - widths * axis.width());
    let grazing = grazing.into_iter().map(|theta_i| Probe { theta_i, allowance: GRAZING_ALLOWANCE });
    let mut probes: Vec<Probe> = spread.chain(grazing).collect();
    probes.sort_by(|a, b| a.theta_i.total_cmp(&b.theta_i));
    probes
}

/// By how much an error of all light counts less than as much of the interior, which renderers read beside it.
pub(super) fn faintest(solution: &Solution) -> f64 {
    // What rounding leaves of a stack that sends nothing back is nothing to resolve.
    const NOTHING: f64 = 1e-9;
    let interiors = solution.lobes.iter().map(|lobe| (lobe.albedo - lobe.surface, lobe.albedo));
    let shares = interiors.filter(|(own, all)| *own > NOTHING * all);
    shares.map(|(own, all)| component_scale(own, all) / all).fold(1.0, f64::min)
}

/// The coarsest axis of which reading between cells misses at most `share` at the [`probes`] that were solved, as far as there is one,
/// and what it misses.
pub(super) fn cells(
    stop: &AtomicBool,
    first: &ExitAxis,
    azimuth: Azimuth,
    share: f64,
    probed: &Solution,
) -> Result<(ExitAxis, f64), BakeError> {
    let probes = probes(first);
    let missed = |axis: &ExitAxis| -> Result<f64, BakeError> {
        let at = |(i, probe): (usize, &Probe)| {
            go_on(stop)?;
            Ok(reading::between_cells(axis, azimuth, probed, i).worst() / probe.allowance)
        };
        probes.par_iter().enumerate().map(at).try_reduce(|| 0.0, |a, b| Ok(a.max(b)))
    };
    let even = |cells: f64| (2 * (0.5 * cells).ceil() as usize).clamp(FEWEST_CELLS, MOST_CELLS);
    let width = first.width();
    let plane = matches!(first, ExitAxis::Plane { .. });
    let axis = |[theta, phi]: [f64; 2]| {
        if plane {
            return ExitAxis::Plane { cells: even(theta), width };
        }
        ExitAxis::Space { theta_cells: even(theta), phi_cells: even(phi), width }
    };
    // What either dimension gives: halve it, and three quarters of its part come on top. Cells are fewest where both are equal.
    let balanced = |[theta, phi]: [f64; 2], found: f64| -> Result<[f64; 2], BakeError> {
        if plane {
            return Ok([theta, phi]);
        }
        let part = |halved| missed(&axis(halved)).map(|halved| (halved - found).max(0.0));
        let parts = [part([0.5 * theta, phi])?, part([theta, 0.5 * phi])?];
        let sum = (parts[0] + parts[1]).max(f64::MIN_POSITIVE);
        let [of_theta, of_phi] = parts.map(|part| (2.0 * part / sum).sqrt().clamp(0.5, 2.0));
        Ok([theta * of_theta, phi * of_phi])
    };
    let mut cells = [FIRST_CELLS as f64, 0.5 * FIRST_CELLS as f64];
    let mut found = missed(&axis(cells))?;
    for round in 0..ROUNDS {
        // Errors of linear reading fall with the square of the cells.
        let scale = (found / (CELLS_AIM * share)).sqrt().clamp(0.25, 8.0);
        if round >= BALANCED && found <= share && scale > ENOUGH {
            break;
        }
        if round < BALANCED {
            cells = balanced(cells, found)?;
        }
        cells = cells.map(|cells| cells * scale);
        found = missed(&axis(cells))?;
    }
    Ok((axis(cells), found))
}

/// Places rows, degrees, so that what reading between them misses is at most `share` where that is possible, for the problem
/// whose lobes bend most; and what is missed.
pub(super) fn rows<'o>(
    stop: &AtomicBool,
    axis: &ExitAxis,
    azimuth: Azimuth,
    share: f64,
    problems: impl Iterator<Item = &'o Operator>,
) -> Result<(Vec<f64>, f64), BakeError> {
    let sampled = |operator: &Operator, theta_i: &[f64]| -> Result<Vec<Sample>, BakeError> {
        let solution = operator.solve_unless(stop, theta_i)?;
        let sample = |i| go_on(stop).map(|()| Sample::new(axis, azimuth, &solution, i));
        (0..theta_i.len()).into_par_iter().map(sample).collect()
    };
    let scouts = spread_out(SCOUTS, axis.width());
    let mut most: Option<(&'o Operator, Vec<Sample>, Bend)> = None;
    for operator in problems {
        let samples = sampled(operator, &scouts)?;
        let bend = Bend::of(axis, &samples);
        if most.as_ref().is_none_or(|(_, _, least)| bend.total() > least.total()) {
            most = Some((operator, samples, bend));
        }
    }
    let Some((operator, scouts, bend)) = most else { return Ok((Vec::new(), f64::INFINITY)) };
    let mut best: Option<(Vec<f64>, f64)> = None;
    let mut seen = Vec::new();
    // What was solved is solved once.
    let mut known: HashMap<u64, Sample> = HashMap::new();
    let mut incident_deg = bend.place(ROWS_AIM * share);
    for _ in 0..ROUNDS {
        let theta_i: Vec<f64> = incident_deg.iter().map(|degrees| degrees.to_radians()).collect();
        let wanted = reading::with_middles(&theta_i);
        let mut new: Vec<f64> =
            wanted.iter().copied().filter(|theta| !known.contains_key(&theta.to_bits())).collect();
        new.dedup();
        known.extend(sampled(operator, &new)?.into_iter().map(|sample| (sample.theta_i.to_bits(), sample)));
        let samples: Vec<&Sample> =
            wanted.iter().filter_map(|theta| known.get(&theta.to_bits())).chain(&scouts).collect();
        let (nodes, others) = samples.split_at(theta_i.len());
        let looks = reading::between_rows(axis, nodes, others);
        let worst = looks.iter().map(|look| look.missed.worst()).fold(0.0, f64::max);
        let better = best.as_ref().is_none_or(|(rows, missed)| match (*missed <= share, worst <= share) {
            (true, true) => incident_deg.len() < rows.len(),
            (kept, keeps) => keeps || (!kept && worst < *missed),
        });
        if better {
            best = Some((incident_deg.clone(), worst));
        }
        if (FEW * share..=share).contains(&worst) {
            break;
        }
        let wide = too_wide(&theta_i, &looks, share);
        let bend = Bend::seen(&mut seen, looks, ROWS_AIM * share);
        // Where a few intervals miss too much they are halved; else, or where rows are too many, all are placed anew.
        incident_deg = if wide.is_empty() || wide.len() > SPLIT.max(theta_i.len() / 8) {
            bend.place(ROWS_AIM * share)
        } else {
            halved(&theta_i, &wide)
        };
    }
    Ok(best.unwrap_or((Vec::new(), f64::INFINITY)))
}

/// The intervals between rows, by their lower row, in which more than `share` is missed.
fn too_wide(theta_i: &[f64], looks: &[Look], share: f64) -> Vec<usize> {
    let missing = looks.iter().filter(|look| look.missed.worst() > share);
    let mut wide: Vec<usize> = missing.map(|look| interval(theta_i, look.theta_i)).collect();
    wide.sort_unstable();
    wide.dedup();
    wide
}

/// Rows, degrees, with one more in the middle of some intervals.
fn halved(theta_i: &[f64], wide: &[usize]) -> Vec<f64> {
    let middles = wide.iter().map(|&i| 0.5 * (theta_i[i] + theta_i[i + 1]));
    let mut rows: Vec<f64> = theta_i.iter().copied().chain(middles).collect();
    rows.sort_by(f64::total_cmp);
    rounded(&rows)
}

/// What reading a table misses between its rows and between its cells, at worst, from a solution of its incidences and of the middles
/// between them.
pub(super) fn missed(axis: &ExitAxis, azimuth: Azimuth, solution: &Solution, rows: usize) -> [Missed; 2] {
    let samples = 0..solution.lobes.len();
    let samples: Vec<Sample> =
        samples.into_par_iter().map(|i| Sample::new(axis, azimuth, solution, i)).collect();
    let samples: Vec<&Sample> = samples.iter().collect();
    let (nodes, middles) = samples.split_at(rows);
    let between_rows = reading::between_rows(axis, nodes, middles)
        .iter()
        .map(|look| look.missed)
        .fold(Missed::default(), Missed::max);
    let off = |i: &usize, probe: f64| (solution.lobes[*i].theta_i - probe).abs();
    let nearest = |probe: f64| (0..rows).min_by(|a, b| off(a, probe).total_cmp(&off(b, probe)));
    let mut judged: Vec<usize> = probes(axis).iter().filter_map(|probe| nearest(probe.theta_i)).collect();
    judged.dedup();
    let between_cells = judged
        .into_par_iter()
        .map(|i| reading::between_cells(axis, azimuth, solution, i))
        .reduce(Missed::default, Missed::max);
    [between_rows.rounded(), between_cells.rounded()]
}

/// Incidences from 0 to 90°, dense near 90° on the scale of a width.
fn spread_out(count: usize, width: f64) -> Vec<f64> {
    let range = (FRAC_PI_2 / width).asinh();
    let at = |k: usize| FRAC_PI_2 - width * (range * (1.0 - k as f64 / (count - 1) as f64)).sinh();
    (0..count).map(|k| if k == 0 { 0.0 } else { at(k).max(0.0) }).collect()
}

/// κ over the incidences: linear mixing over h misses κh²/4 half-way.
struct Bend {
    theta: Vec<f64>,
    kappa: Vec<f64>,
}

impl Bend {
    fn of(axis: &ExitAxis, samples: &[Sample]) -> Self {
        let threes: Vec<&[Sample]> = samples.windows(3).collect();
        let inner: Vec<f64> = threes
            .into_par_iter()
            .map(|three| {
                let [a, b, c] = [0, 1, 2].map(|i: usize| three[i].theta_i);
                three[1].missed_by(axis, &three[0], &three[2], three[1].shares).worst() / ((b - a) * (c - b))
            })
            .collect();
        let (first, last) = (inner[0], inner[inner.len() - 1]);
        let kappa = std::iter::once(first).chain(inner).chain(std::iter::once(last)).collect();
        Self { theta: samples.iter().map(|sample| sample.theta_i).collect(), kappa }
    }

    /// ∫√κ dθ, to which the number of rows is proportional.
    fn total(&self) -> f64 {
        let pieces = self.theta.windows(2).zip(self.kappa.windows(2));
        pieces.map(|(theta, kappa)| 0.5 * (theta[1] - theta[0]) * (kappa[0].sqrt() + kappa[1].sqrt())).sum()
    }

    /// Rows between which every interval misses about `share`.
    fn place(&self, share: f64) -> Vec<f64> {
        let density: Vec<f64> = self.kappa.iter().map(|kappa| (kappa / (4.0 * share)).sqrt()).collect();
        let mut sum = vec![0.0];
        for (theta, density) in self.theta.windows(2).zip(density.windows(2)) {
            let last = sum[sum.len() - 1];
            sum.push(last + 0.5 * (theta[1] - theta[0]) * (density[0] + density[1]));
        }
        let total = sum[sum.len() - 1];
        let intervals = (total.ceil() as usize).clamp(ROWS.start() - 1, ROWS.end() - 1);
        let at = |k: usize| {
            let wanted = total * k as f64 / intervals as f64;
            let i = sum.partition_point(|sum| *sum <= wanted).clamp(1, sum.len() - 1);
            let (a, b) = (density[i - 1], density[i]);
            // Within a piece the density is linear: solve a quadratic.
            let (length, part) = (self.theta[i] - self.theta[i - 1], wanted - sum[i - 1]);
            let slope = (b - a) / length;
            let step = 2.0 * part / (a + (a * a + 2.0 * slope * part).max(0.0).sqrt()).max(f64::MIN_POSITIVE);
            self.theta[i - 1] + step.clamp(0.0, length)
        };
        let mut rows: Vec<f64> = (0..=intervals).map(at).collect();
        rows[0] = 0.0;
        rows[intervals] = FRAC_PI_2;
        rounded(&rows)
    }

    /// What was found between rows, now and before. Close to a row next to nothing is learnt, unless more than `share` is missed.
    fn seen(before: &mut Vec<Look>, now: Vec<Look>, share: f64) -> Self {
        let within = |look: &Look| look.theta_i > 0.0 && look.theta_i < FRAC_PI_2;
        before.retain(|look| now.iter().all(|other| other.theta_i != look.theta_i));
        before.extend(
            now.into_iter().filter(|look| within(look) && (look.central || look.missed.worst() > share)),
        );
        before.sort_by(|a, b| a.theta_i.total_cmp(&b.theta_i));
        let (mut theta, mut kappa): (Vec<f64>, Vec<f64>) =
            before.iter().map(|look| (look.theta_i, look.kappa)).unzip();
        let (first, last) = (kappa[0], kappa[kappa.len() - 1]);
        theta.insert(0, 0.0);
        kappa.insert(0, first);
        theta.push(FRAC_PI_2);
        kappa.push(last);
        Self { theta, kappa }
    }
}

/// Rows at round numbers of degrees, at most a fiftieth of an interval away.
fn rounded(rows: &[f64]) -> Vec<f64> {
    let degrees: Vec<f64> = rows.iter().map(|theta| theta.to_degrees()).collect();
    let mut rounded: Vec<f64> = (0..rows.len())
        .map(|i| {
            let before = if i > 0 { degrees[i] - degrees[i - 1] } else { f64::INFINITY };
            let after = degrees.get(i + 1).map_or(f64::INFINITY, |next| next - degrees[i]);
            let digits = 10_f64.powf((-(0.04 * before.min(after)).log10()).ceil());
            (degrees[i] * digits).round() / digits
        })
        .collect();
    let last = rounded.len() - 1;
    rounded[last] = 90.0;
    rounded.dedup();
    rounded
}

#[cfg(test)]
mod tests {
    use super::super::request::Request;
    use super::*;
    use crate::options::{Options, Target};
    use crate::recipe::Recipe;
    use transport::doubling;

    /// Of facets so steep that a ray meets several of them.
    #[test]
    fn cells_hold_the_accuracy_of_re_hits_beside_the_horizon() {
        let recipe = r#"{"stack":{"layers":50},"facets":{"slope_sd_deg":14},"azimuth":{"mode":"space"}}"#;
        let recipe = Recipe::from_json(recipe).unwrap();
        let accuracy = 2e-3;
        let options = Options { target: Target::AccuracyPercent(100.0 * accuracy), ..Options::default() };
        let request = Request::new(recipe, options).unwrap();
        let theta_i = [88.0_f64, 89.3, 89.65, 89.9].map(f64::to_radians);
        let (transport, azimuth) = (request.transport().unwrap(), request.recipe.azimuth);
        let solution =
            doubling::solve_to(&transport, request.geometry(), &theta_i, 0.1 * accuracy, false).unwrap();
        for (i, theta_i) in theta_i.iter().enumerate() {
            let missed = reading::between_cells(&request.exit_axis(), azimuth, &solution, i).worst();
            assert!(missed < accuracy, "{theta_i}: {missed}");
        }
    }
}
