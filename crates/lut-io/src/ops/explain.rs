//! Whether the light of two lobes differs by more than noise and stated errors explain.
//!
//! One rule for every pair. A lobe may be off by noise, whose variance each cell knows, and by an error without a law, of which only
//! the total variation is stated. Of all such errors the one is taken that leaves the least; what is left must be noise. Without
//! stated errors that is the chi² test of two walks; without noise it is the total variation against the sum of both statements.

use crate::model::axis::ExitAxis;
use crate::model::measure;
use crate::model::table::{Component, Table};
use statrs::distribution::{ChiSquared, ContinuousCDF as _, Normal};

/// Fewest paths expected in a group of cells: from here on chi² has its law down to p = 1e-4 nearly (with 10 paths,
/// two p of a thousand were below 1e-3).
const FEWEST: f64 = 25.0;
/// Share of the changes of the size that a test names as its power that it finds.
const POWER: f64 = 0.99;

/// Light of one lobe by cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Light {
    /// Share of the incident light.
    pub(crate) share: Vec<f64>,
    /// Variance of it by noise.
    pub(crate) variance: Vec<f64>,
    /// Variance for a unit of light in cells that have none; 0 of light without noise.
    pub(crate) unit: f64,
}

/// What a test of two lobes found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Verdict {
    /// chi² of what no stated error takes up.
    pub(crate) chi2: f64,
    /// Groups of cells that it is summed over.
    pub(crate) groups: usize,
    /// Probability of more by noise alone.
    pub(crate) p: f64,
    /// Sum over the groups of the variance of their difference.
    noise: f64,
}

impl Light {
    /// A lobe of a table as it was counted: the cells of one stored incidence, those that differ by an azimuth at θi = 0 as one.
    pub(crate) fn stored(table: &Table, component: Component, i: usize) -> Self {
        let errors = table.at_incidence(&table.lobe(component).std_error, i);
        let (share, scale) = (Self::by_cell(table, component, i), scales(table, component, i));
        let error: Vec<f64> =
            errors.iter().zip(scale).map(|(error, scale)| f64::from(*error) * scale).collect();
        let theta_i = table.meta().per_incidence[i].theta_i_deg.to_radians();
        let axis = &table.meta().exit_axis;
        // Cells that hold their common mean have one error, each its part.
        let variance: Vec<f64> = folded(axis, theta_i, &error).iter().map(|error| error * error).collect();
        let share = folded(axis, theta_i, &share);
        let [light, noise] = [&share, &variance].map(|all| all.iter().sum::<f64>());
        let paths = table.meta().per_incidence[i].paths.max(1) as f64;
        Self { unit: if noise > 0.0 { noise / light } else { 1.0 / paths }, share, variance }
    }

    /// Share of the incident light in every cell.
    pub(crate) fn by_cell(table: &Table, component: Component, i: usize) -> Vec<f64> {
        let values = table.at_incidence(&table.lobe(component).value, i);
        values
            .iter()
            .zip(scales(table, component, i))
            .map(|(value, scale)| f64::from(*value) * scale)
            .collect()
    }

    /// Light that is known without noise, by cell of an incidence.
    pub(crate) fn exact(axis: &ExitAxis, theta_i: f64, share: &[f64]) -> Self {
        let share = folded(axis, theta_i, share);
        Self { variance: vec![0.0; share.len()], share, unit: 0.0 }
    }

    /// A single share with its standard error; `unit` as in [`Light`].
    pub(crate) fn one(share: f64, std_error: f64, unit: f64) -> Self {
        Self { share: vec![share], variance: vec![std_error * std_error], unit }
    }
}

/// What turns values of one incidence into shares of the light: they are densities, scaled so that they are read right.
fn scales(table: &Table, component: Component, i: usize) -> Vec<f64> {
    let axis = &table.meta().exit_axis;
    let summary = &table.meta().per_incidence[i];
    let theta_i = summary.theta_i_deg.to_radians();
    let values = table.at_incidence(&table.lobe(component).value, i);
    let weights = measure::reading_weights(axis, theta_i, summary.azimuth_width_deg.to_radians());
    let extents = measure::cell_extents(axis, theta_i);
    let sum = |by: &[f64]| values.iter().zip(by).map(|(v, x)| f64::from(*v) * x).sum::<f64>();
    let (read, counted) = (sum(&weights), sum(&extents));
    let scale = if counted > 0.0 { read / counted } else { 0.0 };
    extents.iter().map(|extent| extent * scale).collect()
}

/// The cells of an incidence; at θi = 0 those that differ by an azimuth alone, which hold their common mean, added up.
fn folded(axis: &ExitAxis, theta_i: f64, cells: &[f64]) -> Vec<f64> {
    if theta_i > 0.0 {
        return cells.to_vec();
    }
    let columns = axis.columns();
    let signed = axis.rows_per_incidence() == 1;
    let mut groups = vec![0.0; if signed { columns / 2 } else { columns }];
    for (k, cell) in cells.iter().enumerate() {
        let column = k % columns;
        groups[if signed { column.min(columns - 1 - column) } else { column }] += cell;
    }
    groups
}

/// Light of a group of cells in one of two lobes.
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    share: f64,
    variance: f64,
}

/// Cells of both lobes that are tested as one.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    /// How far both are apart, in such a measure that noise is normal where few paths are expected too: of a large count the difference
    /// of the light.
    difference: f64,
    variance: f64,
}

impl Group {
    /// Of two parts and the variances for a unit of light that stand in where a part has no light; none where so few paths are
    /// expected that it says nothing.
    fn of(parts: [Part; 2], units: [f64; 2]) -> Option<Self> {
        let unit = |k: usize| {
            let Part { share, variance } = parts[k];
            if share > 0.0 && variance > 0.0 { variance / share } else { units[k] }
        };
        let noise = [unit(0), unit(1)];
        // If both are the same light: the mean, each by its paths; that of the noise-free one is the truth.
        let expected = match noise {
            [0.0, 0.0] => return None,
            [0.0, _] => parts[0].share,
            [_, 0.0] => parts[1].share,
            [a, b] => (parts[0].share / a + parts[1].share / b) / (1.0 / a + 1.0 / b),
        };
        let paths = expected / f64::max(noise[0], noise[1]);
        (paths >= FEWEST).then(|| {
            let variance = expected * (noise[0] + noise[1]);
            let count = |k: usize, of: usize| parts[k].share / noise[of];
            let deviates = match noise {
                [_, 0.0] => square_root(count(0, 0)) - square_root(count(1, 0)),
                [0.0, _] => square_root(count(1, 1)) - square_root(count(0, 1)),
                [a, b] => arc_sine(count(0, 0), count(1, 1), b / (a + b)),
            };
            Self { difference: deviates.abs() * variance.sqrt(), variance }
        })
    }
}

/// Tests whether two lobes, cell by cell, are the same but for their noise and errors of a total variation of at most `stated`, as a
/// share of the incident light. None where there is no noise to test by, or too little light.
pub(crate) fn explained(a: &Light, b: &Light, stated: f64) -> Option<Verdict> {
    let groups = groups(a, b);
    if groups.is_empty() {
        return None;
    }
    let chi2 = least_chi2(&groups, 2.0 * stated);
    let count = groups.len() as f64;
    let p = ChiSquared::new(count).map_or(1.0, |law| law.sf(chi2));
    let noise = groups.iter().map(|group| group.variance).sum();
    Some(Verdict { chi2, groups: groups.len(), p, noise })
}

/// A Poisson count in a measure where its variance is 1 and its law nearly normal (Anscombe 1948).
fn square_root(count: f64) -> f64 {
    2.0 * (count + 0.375).sqrt()
}

/// How far two Poisson counts are from sharing their sum as `first` to its rest, in standard deviations (Anscombe 1948: what a share of
/// a sum is, is binomial).
fn arc_sine(a: f64, b: f64, first: f64) -> f64 {
    let sum = a + b;
    2.0 * (sum + 0.5).sqrt() * (((a + 0.375) / (sum + 0.75)).sqrt().asin() - first.sqrt().asin())
}

/// Neighbouring cells together until enough paths are expected in them; what is left at the end joins the last.
fn groups(a: &Light, b: &Light) -> Vec<Group> {
    let units = [a.unit, b.unit];
    let mut found: Vec<([Part; 2], Group)> = Vec::new();
    let mut open = [Part::default(); 2];
    let join = |parts: &mut [Part; 2], more: [Part; 2]| {
        for (part, more) in parts.iter_mut().zip(more) {
            part.share += more.share;
            part.variance += more.variance;
        }
    };
    for k in 0..a.share.len().min(b.share.len()) {
        join(&mut open, [a, b].map(|light| Part { share: light.share[k], variance: light.variance[k] }));
        if let Some(group) = Group::of(open, units) {
            found.push((std::mem::take(&mut open), group));
        }
    }
    if let Some((parts, group)) = found.last_mut() {
        join(parts, open);
        *group = Group::of(*parts, units).unwrap_or(*group);
    }
    found.into_iter().map(|(_, group)| group).filter(|group| group.variance > 0.0).collect()
}

/// The least Σ (Δ − e)²/variance of all errors with Σ|e| ≤ `allowed`: they take up what exceeds a multiple of the variance.
fn least_chi2(groups: &[Group], allowed: f64) -> f64 {
    let left =
        |multiple: f64| groups.iter().map(move |group| group.difference.min(multiple * group.variance));
    let all: f64 = groups.iter().map(|group| group.difference).sum();
    if all <= allowed {
        return 0.0;
    }
    let mut multiple = groups.iter().map(|group| group.difference / group.variance).fold(0.0, f64::max);
    if allowed > 0.0 {
        let (mut low, mut high) = (0.0, multiple);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if all - left(middle).sum::<f64>() > allowed { low = middle } else { high = middle }
        }
        multiple = high;
    }
    left(multiple).zip(groups).map(|(left, group)| left * left / group.variance).sum()
}

impl Verdict {
    /// The least total variation, as a share of the incident light and beyond what is stated, that this test calls a change with
    /// probability [`POWER`] at this significance, wherever it lies.
    pub(crate) fn smallest_change(&self, significance: f64) -> f64 {
        let groups = self.groups as f64;
        let variance = 2.0 * groups;
        // Wilson and Hilferty: the cube root of chi² is nearly normal.
        let spread = 2.0 / (9.0 * groups);
        let deviate = Normal::standard().inverse_cdf(1.0 - significance);
        let threshold = groups * (1.0 - spread + deviate * spread.sqrt()).powi(3);
        // Of a change with noncentrality λ, chi² has the mean groups + λ and the variance 2·groups + 4λ: solved for λ.
        let miss = Normal::standard().inverse_cdf(POWER);
        let root = 2.0 * miss + (4.0 * miss * miss + variance + 4.0 * (threshold - groups)).sqrt();
        let noncentrality = 0.25 * (root * root - variance);
        // Σ|Δ| ≤ √(λ·Σ variance): the change that is hardest to find is spread as the noise is.
        0.5 * (noncentrality * self.noise).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noisy(share: &[f64], paths: f64) -> Light {
        let variance = share.iter().map(|s| s * (1.0 - s) / paths).collect();
        Light { share: share.to_vec(), variance, unit: 1.0 / paths }
    }

    #[test]
    fn an_error_that_is_stated_takes_up_what_it_can_and_no_more() {
        let groups =
            [(3.0, 1.0), (0.5, 2.0), (4.0, 4.0)].map(|(difference, variance)| Group { difference, variance });
        assert!((least_chi2(&groups, 0.0) - (9.0 + 0.125 + 4.0)).abs() < 1e-12);
        assert_eq!(least_chi2(&groups, 7.5), 0.0);
        // By hand: a multiple of 0.9 leaves 0.9, 0.5 and 3.6, and takes up 2.1 + 0.4.
        assert!((least_chi2(&groups, 2.5) - (0.81 + 0.125 + 3.24)).abs() < 1e-9);
        // A brute search over where the error may go finds nothing less.
        let least = least_chi2(&groups, 1.7);
        for i in 0..=170 {
            for j in 0..=(170 - i) {
                let e = [i, j, 170 - i - j].map(|part| f64::from(part) / 100.0);
                let chi2: f64 =
                    groups.iter().zip(e).map(|(g, e)| (g.difference - e).powi(2) / g.variance).sum();
                assert!(chi2 > least - 1e-9, "{e:?}");
            }
        }
    }

    #[test]
    fn cells_of_few_paths_are_tested_together() {
        // 8, 9, 10 and 100 expected paths: the first three make a group.
        let truth = Light { share: vec![8e-4, 9e-4, 1e-3, 1e-2], variance: vec![0.0; 4], unit: 0.0 };
        let walk = noisy(&[0.0, 1.7e-3, 1e-3, 1e-2], 1e4);
        let found = explained(&walk, &truth, 0.0).unwrap();
        assert_eq!((found.groups, found.chi2 < 1e-9), (2, true));
        // A lobe that is elsewhere is found, though no cell has paths in both.
        let elsewhere = noisy(&[0.0, 0.0, 1e-2, 2.7e-3], 1e4);
        assert!(explained(&elsewhere, &truth, 0.0).unwrap().p < 1e-9);
        assert!(explained(&truth, &truth, 0.0).is_none());
    }

    #[test]
    fn the_power_is_that_of_a_single_normal_number() {
        // One cell of 10⁴ paths: 1 % of it is a standard error. p < 1e-3 on both sides needs 3.29 of them, 99 % of the time 2.33 more.
        let verdict = explained(&Light::one(0.1, 1e-3, 1e-5), &Light::one(0.1, 0.0, 0.0), 0.0).unwrap();
        // The normal law in place of the noncentral chi² is on the safe side of that, by an eighth at a single number.
        let standard_errors = 2.0 * verdict.smallest_change(1e-3) / 1e-3;
        assert!((5.62..6.32).contains(&standard_errors), "{standard_errors}");
    }
}
