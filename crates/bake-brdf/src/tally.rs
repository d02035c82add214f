//! Sums over the exits of paths, exact enough that no order of adding can be seen in the result.
//!
//! Within one chunk of [`CHUNK`] consecutive path numbers sums run in path order in f64; at its end they are
//! rounded to fixed-point integers. Integers add associatively, so tallies of chunks give the same bits for any
//! number of threads, order of chunks, resume or shard. Angles come from the `libm` crate, not from the system, whose
//! last bits differ from machine to machine.

use lut_io::axis::{ExitAxis, Stretched};
use lut_io::table::{Component, IncidenceSummary, SummaryErrors};
use serde::{Deserialize, Serialize};
use transport::Geometry;
use transport::walk::{Exit, Fate};

/// Paths whose sums are rounded together.
pub const CHUNK: u64 = 4096;
/// Most paths of a tally: fixed-point sums have room for 1.7·10¹⁰.
pub const MAX_PATHS: u64 = 10_000_000_000;

/// Weights are summed in units of 2⁻³⁰: exact for weight 1, and room for 1.7·10¹⁰ paths in 64 bits.
const WEIGHT_ONE: f64 = (1_u64 << 30) as f64;
/// Power sums of angles are summed in units of 2⁻⁸⁰: π⁶·10⁹ paths still fit in 128 bits.
const MOMENT_ONE: f64 = (1_u128 << 80) as f64;

/// Spread that exits cannot show (radians): their directions are f32, good to 6e-8.
const UNRESOLVED: f64 = 1e-8;

/// Components of the light that leaves the top, in the order of the cell arrays.
const SINGLE: usize = 0;
const REHIT: usize = 1;
const INTERIOR: usize = 2;
const COMPONENTS: usize = 3;

/// Sums of weights and squared weights of the paths that met one fate, in units of 2⁻³⁰.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Share {
    count: u64,
    weight: u64,
    weight_squared: u64,
}

impl Share {
    fn add_path(&mut self, weight: f64) {
        self.count += 1;
        self.weight += (weight * WEIGHT_ONE).round() as u64;
        self.weight_squared += (weight * weight * WEIGHT_ONE).round() as u64;
    }

    const fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.weight += other.weight;
        self.weight_squared += other.weight_squared;
    }

    /// Mean weight per incident path and its standard error.
    fn mean(&self, paths: u64) -> (f64, f64) {
        let n = paths as f64;
        let mean = self.weight as f64 / WEIGHT_ONE / n;
        (mean, standard_error(mean, self.weight_squared as f64 / WEIGHT_ONE / n, n))
    }
}

fn standard_error(mean: f64, mean_square: f64, n: f64) -> f64 {
    ((mean_square - mean * mean).max(0.0) / n).sqrt()
}

/// What became of the paths of one incidence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Paths walked.
    pub paths: u64,
    /// Facets met that faced the ray, over all paths.
    pub crossings: u64,
    fates: [Share; 6],
    /// Σ w·x^k, k = 0…3, x = exit angle − θi in radians, over all that leaves the top (units of 2⁻⁸⁰).
    weighted_powers: [i128; 4],
    /// Σ w²·x^k, k = 0…6: the covariances of the former.
    squared_powers: [i128; 7],
    /// Per component and cell.
    cells: Vec<Share>,
}

/// The geometry of one incidence: which cell an exit falls in.
#[derive(Clone, Copy, Debug)]
pub struct Cells {
    theta_i: f64,
    geometry: Geometry,
    columns: Stretched,
    phi: Option<Stretched>,
}

impl Cells {
    /// The cells of `axis` at incidence `theta_i` (radians).
    #[must_use]
    pub fn new(axis: &ExitAxis, theta_i: f64) -> Self {
        let phi = axis.phi_at(theta_i);
        let geometry = if phi.is_some() { Geometry::Space } else { Geometry::Plane };
        Self { theta_i, geometry, columns: axis.columns_at(theta_i), phi }
    }

    /// Number of cells.
    #[must_use]
    pub fn count(&self) -> usize {
        self.columns.cells * self.phi.map_or(1, |phi| phi.cells)
    }

    /// Exit angle (signed in the plane, polar in space; radians) and cell of a direction leaving the top.
    #[must_use]
    pub fn locate(&self, direction: [f32; 3]) -> (f64, usize) {
        let [x, y, z] = direction.map(f64::from);
        let index = |axis: &Stretched, value: f64| (axis.position(value) as usize).min(axis.cells - 1);
        match (self.geometry, &self.phi) {
            (Geometry::Space, Some(phi_axis)) => {
                let theta = libm::atan2(libm::hypot(x, y), z);
                let phi = libm::atan2(y.abs(), x);
                (theta, index(phi_axis, phi) * self.columns.cells + index(&self.columns, theta))
            }
            _ => {
                let s = libm::atan2(x, z);
                (s, index(&self.columns, s))
            }
        }
    }
}

impl Tally {
    /// An empty tally for `cells` cells per incidence.
    #[must_use]
    pub fn new(cells: usize) -> Self {
        Self {
            paths: 0,
            crossings: 0,
            fates: [Share::default(); 6],
            weighted_powers: [0; 4],
            squared_powers: [0; 7],
            cells: vec![Share::default(); COMPONENTS * cells],
        }
    }

    /// Cells per component.
    #[must_use]
    pub const fn cells(&self) -> usize {
        self.cells.len() / COMPONENTS
    }

    /// Adds one chunk: the exits of at most [`CHUNK`] consecutive paths, in path order.
    pub fn add_chunk(&mut self, cells: &Cells, exits: &[Exit]) {
        debug_assert!(exits.len() as u64 <= CHUNK);
        let count = self.cells();
        let mut weighted = [0.0_f64; 4];
        let mut squared = [0.0_f64; 7];
        for exit in exits {
            let weight = f64::from(exit.weight);
            self.fates[exit.fate as usize].add_path(weight);
            let component = match exit.fate {
                Fate::Single => SINGLE,
                Fate::Rehit => REHIT,
                Fate::Interior => INTERIOR,
                Fate::Transmitted | Fate::Absorbed | Fate::Truncated => continue,
            };
            let (angle, cell) = cells.locate(exit.direction);
            self.cells[component * count + cell].add_path(weight);
            let x = angle - cells.theta_i;
            let mut power = 1.0;
            for (k, sum) in squared.iter_mut().enumerate() {
                if let Some(sum) = weighted.get_mut(k) {
                    *sum += weight * power;
                }
                *sum += weight * weight * power;
                power *= x;
            }
        }
        self.paths += exits.len() as u64;
        for (sum, value) in self.weighted_powers.iter_mut().zip(weighted) {
            *sum += (value * MOMENT_ONE).round() as i128;
        }
        for (sum, value) in self.squared_powers.iter_mut().zip(squared) {
            *sum += (value * MOMENT_ONE).round() as i128;
        }
    }

    /// Adds another tally of the same incidence and cells.
    pub fn add(&mut self, other: &Self) {
        debug_assert_eq!(self.cells.len(), other.cells.len());
        self.paths += other.paths;
        self.crossings += other.crossings;
        for (a, b) in self.fates.iter_mut().zip(&other.fates) {
            a.add(b);
        }
        for (a, b) in self.weighted_powers.iter_mut().zip(other.weighted_powers) {
            *a += b;
        }
        for (a, b) in self.squared_powers.iter_mut().zip(other.squared_powers) {
            *a += b;
        }
        for (a, b) in self.cells.iter_mut().zip(&other.cells) {
            a.add(b);
        }
    }

    /// Whether the sums can be those of paths: each path has one fate and at most weight 1, cells add up to the fates
    /// they are parts of, and powers of angles stay below what π allows. A tally from a file need not be.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        let possible = |share: &Share| {
            // Weights are at most 1, and the square of a weight at most the weight.
            u128::from(share.weight) <= u128::from(share.count) << 30 && share.weight_squared <= share.weight
        };
        let count: u128 = self.fates.iter().map(|share| u128::from(share.count)).sum();
        let parts = [Fate::Single, Fate::Rehit, Fate::Interior].into_iter().enumerate();
        let cells_add_up = self.cells() > 0
            && parts.into_iter().all(|(component, fate)| {
                let cells = &self.cells[component * self.cells()..(component + 1) * self.cells()];
                let sum =
                    |part: fn(&Share) -> u64| cells.iter().map(|share| u128::from(part(share))).sum::<u128>();
                let fate = self.fate(fate);
                sum(|share| share.count) == u128::from(fate.count)
                    && sum(|share| share.weight) == u128::from(fate.weight)
                    && sum(|share| share.weight_squared) == u128::from(fate.weight_squared)
            });
        // 4 > π bounds |x|, and a path's share of a sum.
        let bounded = |sums: &[i128]| {
            sums.iter().zip(0..).all(|(sum, power)| {
                let most = (u128::from(self.paths) << (2 * power + 1)).checked_shl(79).unwrap_or(u128::MAX);
                sum.unsigned_abs() <= most
            })
        };
        self.cells.len().is_multiple_of(COMPONENTS)
            && self.paths <= MAX_PATHS
            && count == u128::from(self.paths)
            && self.crossings <= self.paths.saturating_mul(u64::from(u32::MAX))
            && self.fates.iter().chain(&self.cells).all(possible)
            && cells_add_up
            && bounded(&self.weighted_powers)
            && bounded(&self.squared_powers)
    }

    fn fate(&self, fate: Fate) -> Share {
        self.fates[fate as usize]
    }

    fn surface_share(&self) -> Share {
        let mut surface = self.fate(Fate::Single);
        surface.add(&self.fate(Fate::Rehit));
        surface
    }

    fn reflected_share(&self) -> Share {
        let mut reflected = self.surface_share();
        reflected.add(&self.fate(Fate::Interior));
        reflected
    }

    /// Shares, moments and their standard errors; the accuracy is left at 0. The four ledger entries add up to 1 by construction:
    /// absorbed is what the others leave of the incident weight.
    #[must_use]
    pub fn summary(&self, theta_i_deg: f64) -> IncidenceSummary {
        let reflected = self.reflected_share();
        let (albedo, albedo_error) = reflected.mean(self.paths);
        let (transmitted, transmitted_error) = self.fate(Fate::Transmitted).mean(self.paths);
        let (truncated, truncated_error) = self.fate(Fate::Truncated).mean(self.paths);
        let (surface, surface_error) = self.surface_share().mean(self.paths);
        let (rehit, _) = self.fate(Fate::Rehit).mean(self.paths);
        let (absorbed, absorbed_error) = self.absorbed();
        let moments = self.moments(theta_i_deg.to_radians());
        IncidenceSummary {
            theta_i_deg,
            albedo,
            transmitted,
            absorbed,
            truncated,
            surface,
            rehit,
            mean_theta_o_deg: moments.mean.to_degrees(),
            sd_theta_o_deg: moments.sd.to_degrees(),
            skew_theta_o: moments.skew,
            std_error: SummaryErrors {
                albedo: albedo_error,
                transmitted: transmitted_error,
                absorbed: absorbed_error,
                truncated: truncated_error,
                surface: surface_error,
                mean_theta_o_deg: moments.mean_error.to_degrees(),
                sd_theta_o_deg: moments.sd_error.to_degrees(),
                skew_theta_o: moments.skew_error,
            },
            paths: self.paths,
            azimuth_width_deg: 0.0,
            accuracy_percent: 0.0,
        }
    }

    /// Absorbed share and its standard error: each path loses 1 − w, or all if it died.
    fn absorbed(&self) -> (f64, f64) {
        let mut out = self.reflected_share();
        out.add(&self.fate(Fate::Transmitted));
        out.add(&self.fate(Fate::Truncated));
        let n = self.paths as f64;
        let incident = u128::from(self.paths) << 30;
        let mean = (incident - u128::from(out.weight)) as f64 / WEIGHT_ONE / n;
        let died = self.fate(Fate::Absorbed).count as f64;
        let square =
            died + out.count as f64 + (out.weight_squared as f64 - 2.0 * out.weight as f64) / WEIGHT_ONE;
        (mean, standard_error(mean, square / n, n))
    }

    /// Mean, standard deviation and skewness of the exit angle of all that leaves the top, with standard errors
    /// by the delta method on the means of w·x^k.
    #[must_use]
    pub fn moments(&self, theta_i: f64) -> Moments {
        let n = self.paths as f64;
        let m: [f64; 4] = self.weighted_powers.map(|sum| sum as f64 / MOMENT_ONE / n);
        if m[0] <= 0.0 {
            return Moments::default();
        }
        let [mean, second, third] = [m[1] / m[0], m[2] / m[0], m[3] / m[0]];
        let variance = second - mean * mean;
        // Light in one direction (smooth interfaces) leaves rounding only, which is no lobe and has no skewness.
        let variance = if variance > UNRESOLVED * UNRESOLVED { variance } else { 0.0 };
        let sd = variance.sqrt();
        let central3 = third - 3.0 * mean * second + 2.0 * mean.powi(3);
        let skew = if sd > 0.0 { central3 / sd.powi(3) } else { 0.0 };
        // Influence of one path with weight w and angle x on each estimate is w·(a polynomial in x)/m0.
        let by_mean = [-mean, 1.0, 0.0, 0.0];
        // (x − mean)² − variance
        let by_variance = [mean * mean - variance, -2.0 * mean, 1.0, 0.0];
        // (x − mean)³ − central3 − 3·variance·(x − mean)
        let by_central3 = [
            -mean.powi(3) - central3 + 3.0 * variance * mean,
            3.0 * mean * mean - 3.0 * variance,
            -3.0 * mean,
            1.0,
        ];
        let error = |p: [f64; 4]| {
            let mut square = 0.0;
            for (i, a) in p.iter().enumerate() {
                for (j, b) in p.iter().enumerate() {
                    square += a * b * (self.squared_powers[i + j] as f64 / MOMENT_ONE / n);
                }
            }
            (square.max(0.0) / n).sqrt() / m[0]
        };
        let by_skew: [f64; 4] = std::array::from_fn(|k| {
            (by_central3[k] - 1.5 * central3 / variance * by_variance[k]) / sd.powi(3)
        });
        Moments {
            mean: theta_i + mean,
            sd,
            skew,
            mean_error: error(by_mean),
            sd_error: if sd > 0.0 { error(by_variance) / (2.0 * sd) } else { 0.0 },
            skew_error: if sd > 0.0 { error(by_skew) } else { 0.0 },
        }
    }

    /// Expected total variation between the lobe of this tally and the true one, as a share of the reflected
    /// light: ½ Σ E|estimate − truth| over the cells.
    ///
    /// `spread` is the solid angle that a unit of each cell's extent stands for, in any unit: light counts by where
    /// it is read on the hemisphere.
    #[must_use]
    pub fn total_variation_error(&self, spread: &[f64]) -> f64 {
        self.total_variation(spread).mean.min(1.0)
    }

    /// A bound that the total variations of `lobes` such tallies *all* stay below with 99.9 % probability.
    #[must_use]
    pub fn total_variation_bound(&self, spread: &[f64], lobes: usize) -> f64 {
        self.total_variation_quantile(spread, lobes).min(1.0)
    }

    /// The bound by what can be extrapolated to more paths: of a few paths it may exceed 1.
    pub(crate) fn total_variation_quantile(&self, spread: &[f64], lobes: usize) -> f64 {
        self.total_variation(spread).quantile(BROKEN / lobes.max(1) as f64)
    }

    /// Paths that left the top.
    pub(crate) fn reflected_paths(&self) -> u64 {
        self.reflected_share().count
    }

    /// What the total variation is like: half a sum of |normal deviates|, one a cell.
    fn total_variation(&self, spread: &[f64]) -> TotalVariation {
        let count = self.cells();
        let (mut total, mut mean, mut powers) = (0.0, 0.0, [0.0; 3]);
        for (cell, spread) in spread.iter().enumerate() {
            let mut all = self.cells[SINGLE * count + cell];
            all.add(&self.cells[REHIT * count + cell]);
            all.add(&self.cells[INTERIOR * count + cell]);
            if all.count == 0 {
                continue;
            }
            // Kish's effective number of equal weights.
            let (w, w2) = (all.weight as f64, all.weight_squared as f64 * WEIGHT_ONE);
            let effective = w * w / w2.max(1.0);
            let read = w * spread;
            total += read;
            mean += mean_deviation(effective) * read / effective;
            let sd = read / effective.sqrt();
            for (sum, power) in powers.iter_mut().zip(2..) {
                *sum += sd.powi(power);
            }
        }
        if total == 0.0 {
            return TotalVariation { mean: 1.0, cumulants: [0.0; 3] };
        }
        let scale = 0.5 / total;
        let cumulant = |k: usize| HALF_NORMAL[k] * scale.powi(k as i32 + 2) * powers[k];
        TotalVariation { mean: scale * mean, cumulants: std::array::from_fn(cumulant) }
    }

    /// Share of the incident light that left the top through each cell, all components.
    #[must_use]
    pub fn reflected_shares(&self) -> Vec<f64> {
        let count = self.cells();
        let weight = |cell: usize| (0..COMPONENTS).map(|c| self.cells[c * count + cell].weight).sum::<u64>();
        (0..count).map(|cell| weight(cell) as f64 / WEIGHT_ONE / self.paths as f64).collect()
    }

    /// Share of the incident light, its standard error and count per cell of one component.
    #[must_use]
    pub fn component(&self, component: Component) -> CellShares {
        let count = self.cells();
        let mut shares = CellShares::default();
        for cell in 0..count {
            let mut share = Share::default();
            for &part in parts(component) {
                share.add(&self.cells[part * count + cell]);
            }
            let (mean, error) = share.mean(self.paths);
            shares.share.push(mean);
            shares.std_error.push(error);
            shares.count.push(share.count);
        }
        shares
    }
}

/// Chance that the total variation of any lobe of a table exceeds the bound that is promised.
const BROKEN: f64 = 1e-3;

/// Second, third and fourth cumulant of |x|, x standard normal.
const HALF_NORMAL: [f64; 3] = [0.363_380_227_6, 0.218_013_614_1, 0.114_770_700_0];

/// The law of a total variation that noise alone makes.
#[derive(Clone, Copy, Debug)]
struct TotalVariation {
    mean: f64,
    /// The second to the fourth.
    cumulants: [f64; 3],
}

impl TotalVariation {
    /// What is exceeded with a probability of `chance`: the expansion of Cornish and Fisher.
    ///
    /// Where a few cells hold most of the light the sum is as skewed as they are, and three of its standard deviations are
    /// exceeded once in a hundred times. The expansion is within 4 % of the quantile for a single cell down to a chance of
    /// 10⁻⁵, and better for more.
    fn quantile(&self, chance: f64) -> f64 {
        let [variance, third, fourth] = self.cumulants;
        if variance == 0.0 {
            return self.mean;
        }
        let sd = variance.sqrt();
        let (skewness, excess) = (third / sd.powi(3), fourth / variance.powi(2));
        let z = exceeded_with(chance);
        let deviates = z + (z * z - 1.0) * skewness / 6.0 + z * (z * z - 3.0) * excess / 24.0
            - z * (2.0 * z * z - 5.0) * skewness * skewness / 36.0;
        self.mean + sd * deviates
    }
}

/// What a standard normal deviate exceeds with a probability of `chance`, below one half. By bisection: `libm` has the same bits
/// on every machine, and path counts depend on them.
fn exceeded_with(chance: f64) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let beyond = 0.5 * libm::erfc(middle * std::f64::consts::FRAC_1_SQRT_2);
        if beyond > chance { low = middle } else { high = middle }
    }
    high
}

/// Mean absolute deviation of a Poisson count from its mean, as a function of the count found.
///
/// √(2n/π) is right for large counts. A count of 1 or 2 stands as often for a smaller mean, whose deviation per
/// count is up to 2, and empty cells are not counted at all: the second factor makes up for both, so that the
/// expected estimate is within 23 % of the truth for every mean above 0.03 and within 5 % above 4 (minimax fit,
/// see the test).
fn mean_deviation(count: f64) -> f64 {
    (count * std::f64::consts::FRAC_2_PI).sqrt() * (1.0 + 14.9 * (-2.77 * count).exp())
}

const fn parts(component: Component) -> &'static [usize] {
    match component {
        Component::Interior => &[INTERIOR],
        Component::Surface => &[SINGLE, REHIT],
        Component::Rehit => &[REHIT],
    }
}

/// Per cell: share of the incident light, its standard error, number of paths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellShares {
    /// Share of the incident light in the cell.
    pub share: Vec<f64>,
    /// Standard error of `share`.
    pub std_error: Vec<f64>,
    /// Paths in the cell.
    pub count: Vec<u64>,
}

/// Moments of the exit angle (radians) with standard errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(missing_docs)] // the names say it
pub struct Moments {
    pub mean: f64,
    pub sd: f64,
    pub skew: f64,
    pub mean_error: f64,
    pub sd_error: f64,
    pub skew_error: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_distr::{Distribution as _, StandardNormal};

    const AXIS: ExitAxis = ExitAxis::Plane { cells: 64, width: 0.1 };

    /// Exits with a skewed angle distribution and weights, some paths lost.
    fn exits(seed: u64, n: usize, weighted: bool) -> Vec<Exit> {
        let mut rng = rand::rngs::StdRng::seed_from_u64(seed);
        (0..n)
            .map(|_| {
                let (u, v): (f64, f64) = (rng.random(), rng.random());
                let s = 0.5 - 0.2 * (1.0 - u).ln().abs().min(4.0) * v;
                let fate = if v < 0.4 {
                    Fate::Interior
                } else if v < 0.5 {
                    Fate::Single
                } else {
                    Fate::Transmitted
                };
                let weight = if weighted { 0.2 + 0.8 * u as f32 } else { 1.0 };
                Exit { direction: [s.sin() as f32, 0.0, s.cos() as f32], weight, fate }
            })
            .collect()
    }

    fn tally(exits: &[Exit], order: impl Iterator<Item = usize>) -> Tally {
        let cells = Cells::new(&AXIS, 0.5);
        let chunks: Vec<&[Exit]> = exits.chunks(CHUNK as usize).collect();
        let mut total = Tally::new(AXIS.cells());
        for i in order {
            let mut one = Tally::new(AXIS.cells());
            one.add_chunk(&cells, chunks[i]);
            total.add(&one);
        }
        total
    }

    #[test]
    fn the_order_of_chunks_cannot_be_seen() {
        let exits = exits(1, 20 * CHUNK as usize, true);
        assert_eq!(tally(&exits, 0..20), tally(&exits, (0..20).rev()));
    }

    #[test]
    fn the_ledger_closes_exactly() {
        for weighted in [false, true] {
            let s = tally(&exits(2, 5000, weighted), 0..2).summary(28.6);
            assert!((s.albedo + s.transmitted + s.absorbed + s.truncated - 1.0).abs() < 1e-15);
            assert_eq!(s.absorbed == 0.0, !weighted);
        }
    }

    /// 400 independent tallies: the spread of each estimate must be what the standard errors say. With 400
    /// repeats the ratio of the two has a standard error of 3.5 %; 15 % is more than four of those.
    #[test]
    fn standard_errors_are_the_spread_of_repeats() {
        for weighted in [false, true] {
            let repeats: Vec<IncidenceSummary> =
                (0..400).map(|seed| tally(&exits(seed, 2000, weighted), 0..1).summary(28.6)).collect();
            let check = |name: &str, of: fn(&IncidenceSummary) -> (f64, f64)| {
                let n = repeats.len() as f64;
                let mean = repeats.iter().map(|r| of(r).0).sum::<f64>() / n;
                let spread =
                    (repeats.iter().map(|r| (of(r).0 - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
                let stated = (repeats.iter().map(|r| of(r).1.powi(2)).sum::<f64>() / n).sqrt();
                assert!((spread / stated - 1.0).abs() < 0.15, "{name} {weighted}: {spread} against {stated}");
            };
            check("albedo", |r| (r.albedo, r.std_error.albedo));
            check("transmitted", |r| (r.transmitted, r.std_error.transmitted));
            check("mean", |r| (r.mean_theta_o_deg, r.std_error.mean_theta_o_deg));
            check("sd", |r| (r.sd_theta_o_deg, r.std_error.sd_theta_o_deg));
            check("skew", |r| (r.skew_theta_o, r.std_error.skew_theta_o));
            if weighted {
                check("absorbed", |r| (r.absorbed, r.std_error.absorbed));
            }
        }
    }

    #[test]
    fn the_deviation_estimate_is_nearly_unbiased_for_every_poisson_mean() {
        for mean in [0.03_f64, 0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.5, 7.0, 20.0, 80.0] {
            let (mut p, mut truth, mut estimate) = ((-mean).exp(), 0.0, 0.0);
            for n in 0..400 {
                let n = f64::from(n);
                truth += p * (n - mean).abs();
                estimate += if n > 0.0 { p * mean_deviation(n) } else { 0.0 };
                p *= mean / (n + 1.0);
            }
            let bound = if mean > 4.0 { 0.05 } else { 0.23 };
            assert!((estimate / truth - 1.0).abs() < bound, "{mean}: {estimate} against {truth}");
        }
    }

    /// Half a sum of |normal deviates| of given standard deviations, drawn `draws` times, exceeds its quantile as often as said:
    /// the count of exceedances is within four of its standard deviations, and 30 % of it for what the expansion leaves out.
    #[test]
    fn a_total_variation_exceeds_its_quantile_as_often_as_it_should() {
        let mut rng = rand::rngs::StdRng::seed_from_u64(3);
        let lobes: [Vec<f64>; 4] =
            [vec![1.0], vec![1.0, 0.2, 0.1], vec![0.3; 12], (1..60).map(|k| 1.0 / f64::from(k)).collect()];
        for cells in lobes {
            let powers: [f64; 3] = std::array::from_fn(|k| {
                HALF_NORMAL[k] * cells.iter().map(|sd| (0.5 * sd).powi(k as i32 + 2)).sum::<f64>()
            });
            let mean = 0.5 * std::f64::consts::FRAC_2_PI.sqrt() * cells.iter().sum::<f64>();
            let variation = TotalVariation { mean, cumulants: powers };
            let draws = 100_000;
            let mut drawn = || {
                let deviate = |sd: &f64| sd * f64::abs(StandardNormal.sample(&mut rng));
                0.5 * cells.iter().map(deviate).sum::<f64>()
            };
            let values: Vec<f64> = (0..draws).map(|_| drawn()).collect();
            for chance in [1e-2, 1e-3] {
                let bound = variation.quantile(chance);
                let found = values.iter().filter(|value| **value > bound).count() as f64;
                let expected = chance * f64::from(draws);
                let allowed = 4.0 * expected.sqrt() + 0.3 * expected;
                assert!((found - expected).abs() < allowed, "{cells:?}, {chance}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn moments_of_a_narrow_lobe_keep_their_digits() {
        // Two directions 1e-4 rad apart: sd and skew follow from their weights alone.
        let exit = |s: f64| Exit {
            direction: [s.sin() as f32, 0.0, s.cos() as f32],
            weight: 1.0,
            fate: Fate::Interior,
        };
        let (a, b) = (exit(1e-5), exit(1.1e-4));
        let axis = ExitAxis::Plane { cells: 64, width: 1e-4 };
        let mut tally = Tally::new(64);
        tally.add_chunk(&Cells::new(&axis, 0.0), &[a, a, a, b]);
        let m = tally.moments(0.0);
        assert!((m.sd / (1e-4 * (3.0_f64 / 16.0).sqrt()) - 1.0).abs() < 1e-6);
        assert!((m.skew - 2.0 / 3.0_f64.sqrt()).abs() < 1e-6);
    }
}
