//! Dispersion: the wavelengths at which a lobe is solved, as many as the accuracy calls for.
//!
//! A cheap solution of the lobe is looked at every 20 nm of the visible range. From either side of the recipe's own
//! wavelength the bands are as far apart as reading between them, linearly in wavelength, stays within the accuracy asked for.
//! The cheap solution is plane doubling of unpolarised light at four incidences; where that is out of reach (coherent
//! sheets, facets too smooth for its grid, too many different layers) it is the reflectance of the smooth stack. Only the choice
//! of bands rests on it: every band is then solved as a bake of that wavelength alone would be.

use super::cells::{cell_shares, exit_axis};
use super::{BakeError, COARSEST_DOUBLING, NEVER, Request, go_on};
use crate::effects::Effect;
use crate::prices;
use crate::recipe::Recipe;
use crate::spectra;
use rayon::prelude::*;
use std::sync::atomic::AtomicBool;
use thinfilm::{Dispersion, colour};
use transport::doubling::{self, Settings};
use transport::{Geometry, Light, Transport};

/// Distance of the wavelengths looked at, nm.
const STEP_NM: f64 = 20.0;
/// Incidences looked at, degrees.
const ANGLES_DEG: [f64; 4] = [0.0, 30.0, 60.0, 80.0];
/// The cheap solution is this much more accurate than what it decides, within bounds.
const FINER: f64 = 0.25;
const CHEAP_SHARES: [f64; 2] = [1e-4, 5e-3];
/// Seconds of one core that one cheap solution may take.
const AFFORDABLE: f64 = 0.1;
/// Wavelengths over which the shares of sRGB's channels are summed.
const COLOUR_SAMPLES: usize = 801;

/// The wavelengths at which a lobe is solved.
#[derive(Clone, Debug, PartialEq)]
pub struct Bands {
    /// The recipe's own wavelength, nm.
    pub own_nm: f64,
    /// Further ones, ascending, nm; none without dispersion.
    pub further_nm: Vec<f64>,
    /// What reading between them adds to the error: total variation, per cent of the reflected light.
    pub interpolation_percent: f64,
}

/// Shares of the incident light by incidence and cell.
type Lobes = Vec<Vec<f64>>;

impl Bands {
    /// The recipe's wavelength alone.
    #[must_use]
    pub const fn own(recipe: &Recipe) -> Self {
        Self { own_nm: recipe.light.wavelength_nm, further_nm: Vec::new(), interpolation_percent: 0.0 }
    }

    /// All wavelengths, the recipe's own first, nm.
    pub fn all_nm(&self) -> impl Iterator<Item = f64> {
        std::iter::once(self.own_nm).chain(self.further_nm.iter().copied())
    }

    /// The transport problem of a request at each of [`Self::all_nm`].
    pub(super) fn transports(&self, request: &Request) -> Result<Vec<Transport>, BakeError> {
        self.all_nm().map(|nm| request.at_wavelength(nm).transport()).collect()
    }

    /// How a value at a wavelength (nm) is read: the bands of [`Self::all_nm`] around it, and their shares.
    #[must_use]
    pub fn shares(&self, nm: f64) -> [(usize, f64); 2] {
        let mut order: Vec<(f64, usize)> = self.all_nm().zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let above = order.partition_point(|(band, _)| *band <= nm);
        let (lo, hi) = (order[above.saturating_sub(1)], order[above.min(order.len() - 1)]);
        let t = if hi.0 > lo.0 { ((nm - lo.0) / (hi.0 - lo.0)).clamp(0.0, 1.0) } else { 0.0 };
        [(lo.1, 1.0 - t), (hi.1, t)]
    }

    /// Share of each band's lobe in the channels of linear sRGB, in the order of [`Self::all_nm`]: the colour of its share
    /// of the spectrum, relative to that of the constant spectrum.
    #[must_use]
    pub fn rgb_weights(&self) -> Vec<[f64; 3]> {
        let wavelengths = colour::wavelengths(COLOUR_SAMPLES);
        let white = colour::linear_srgb(colour::xyz(&vec![1.0; COLOUR_SAMPLES]));
        let weight = |band: usize| {
            let share = |metres: &f64| -> f64 {
                self.shares(1e9 * metres).iter().filter(|(i, _)| *i == band).map(|(_, share)| share).sum()
            };
            let spectrum: Vec<f64> = wavelengths.iter().map(share).collect();
            let rgb = colour::linear_srgb(colour::xyz(&spectrum));
            [0, 1, 2].map(|c| rgb[c] / white[c])
        };
        (0..=self.further_nm.len()).map(weight).collect()
    }
}

impl Request {
    /// The wavelengths at which the lobe is solved: the recipe's alone, or with effect `dispersion` as many as the accuracy
    /// calls for. A function of the request alone.
    ///
    /// # Errors
    /// A bad request.
    pub fn bands(&self) -> Result<Bands, BakeError> {
        self.bands_unless(&NEVER)
    }

    /// [`Self::bands`], which stops soon after `stop` is set, from anywhere.
    ///
    /// # Errors
    /// As [`Self::bands`]; [`BakeError::Interrupted`].
    pub fn bands_unless(&self, stop: &AtomicBool) -> Result<Bands, BakeError> {
        self.options.check()?;
        if !self.is_dispersed() {
            return Ok(Bands::own(&self.recipe));
        }
        let share = self.options.target.share();
        let settings = cheap_settings(&self.transport()?, share);
        match chosen(stop, self, share, settings.as_ref()) {
            Err(BakeError::Doubling(_)) => chosen(stop, self, share, None),
            bands => bands,
        }
    }

    /// Whether the lobe may be solved at more than one wavelength.
    fn is_dispersed(&self) -> bool {
        self.effects.contains(Effect::Dispersion) && self.effects.has_lobe()
    }
}

/// Seconds of one core that [`Request::bands`] takes.
pub(super) fn seconds_to_choose(request: &Request) -> Result<f64, BakeError> {
    if !request.is_dispersed() {
        return Ok(0.0);
    }
    let transport = request.transport()?;
    let each = match cheap_settings(&transport, request.options.target.share()) {
        Some(settings) => {
            prices::BAND_SOLVED + settings.cost(&transport, Geometry::Plane, ANGLES_DEG.len()).seconds
        }
        None => prices::BAND_SMOOTH * (ANGLES_DEG.len() * transport.layers()) as f64,
    };
    let (problems, _) = problems(request, &looked_at(request))?;
    Ok(each * problems.len() as f64)
}

/// Settings of the cheap doubling, or none where the smooth stack has to do.
fn cheap_settings(transport: &Transport, share: f64) -> Option<Settings> {
    if transport.sheets.is_some() || transport.facets.slope_sd == 0.0 {
        return None;
    }
    let share = (FINER * share).clamp(CHEAP_SHARES[0], CHEAP_SHARES[1].min(COARSEST_DOUBLING));
    let settings = Settings::for_accuracy(transport, Geometry::Plane, share);
    let cheap = settings.cost(transport, Geometry::Plane, ANGLES_DEG.len()).seconds < AFFORDABLE;
    (cheap && settings.check(transport, Geometry::Plane, &angles()).is_ok()).then_some(settings)
}

fn angles() -> Vec<f64> {
    ANGLES_DEG.iter().map(|degrees| degrees.to_radians()).collect()
}

fn chosen(
    stop: &AtomicBool,
    request: &Request,
    share: f64,
    settings: Option<&Settings>,
) -> Result<Bands, BakeError> {
    let own = request.recipe.light.wavelength_nm;
    let nodes = looked_at(request);
    let (problems, problem_at) = problems(request, &nodes)?;
    let at = |problem: &Transport| go_on(stop).and_then(|()| lobes(problem, settings));
    let solved = problems.par_iter().map(at).collect::<Result<Vec<Lobes>, BakeError>>()?;
    let solved: Vec<&Lobes> = problem_at.into_iter().map(|problem| &solved[problem]).collect();
    let (further_nm, worst) = choose(&nodes, &solved, own, share);
    // Three digits are more than it is good for, and hide in which order a machine's matrix products add.
    let interpolation_percent = crate::three_digits(100.0 * worst);
    Ok(Bands { own_nm: own, further_nm, interpolation_percent })
}

/// The shortest and the longest wavelength at which the lobe of a request may be solved beside its own, nm.
pub(super) fn ends(request: &Request) -> Vec<f64> {
    if !request.is_dispersed() {
        return Vec::new();
    }
    let nodes = looked_at(request);
    let ends = [nodes.first(), nodes.last()].into_iter().flatten();
    ends.copied().filter(|nm| *nm != request.recipe.light.wavelength_nm).collect()
}

/// The wavelengths looked at, ascending, the recipe's own among them: the visible range as far as the optical constants
/// reach without a gap, be it that a table ends there or that a formula gives no index.
fn looked_at(request: &Request) -> Vec<f64> {
    let recipe = &request.recipe;
    let [mut from, mut to] = colour::VISIBLE.map(|metres| 1e9 * metres);
    for (_, n) in recipe.stack.dispersions() {
        if let Dispersion::Table(rows) = n
            && let (Some(first), Some(last)) = (rows.first(), rows.last())
        {
            (from, to) = (from.max(first[0]), to.min(last[0]));
        }
    }
    let steps = ((to - from) / STEP_NM).ceil().max(1.0);
    let own = recipe.light.wavelength_nm;
    let mut nodes = vec![own];
    if from < to {
        // Tenths of a nanometre, so that names of bands are short.
        let at = |step: usize| (10.0 * (from + (to - from) * step as f64 / steps)).round() / 10.0;
        nodes.extend((0..=steps as usize).map(at).map(|nm| nm.clamp(from, to)));
    }
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    let at_own = nodes.iter().position(|nm| *nm == own).unwrap_or(0);
    let known = |nm: &f64| request.at_wavelength(*nm).transport().is_ok();
    let below = nodes[..at_own].iter().rev().take_while(|nm| known(nm)).count();
    let above = nodes[at_own..].iter().take_while(|nm| known(nm)).count();
    nodes[at_own - below..at_own + above].to_vec()
}

/// The problems at some wavelengths, and which of them each wavelength has: where no index depends on it they are one.
fn problems(request: &Request, nodes: &[f64]) -> Result<(Vec<Transport>, Vec<usize>), BakeError> {
    let mut problems = Vec::new();
    let mut problem_at = Vec::with_capacity(nodes.len());
    for nm in nodes {
        let transport = request.at_wavelength(*nm).transport()?;
        let known = problems.iter().position(|problem| *problem == transport);
        problem_at.push(known.unwrap_or(problems.len()));
        if known.is_none() {
            problems.push(transport);
        }
    }
    Ok((problems, problem_at))
}

/// A cheap solution of the lobe.
fn lobes(transport: &Transport, settings: Option<&Settings>) -> Result<Lobes, BakeError> {
    let Some(settings) = settings else {
        let smooth = |theta: &f64| vec![spectra::incoherent_reflectance(transport, *theta)];
        return Ok(angles().iter().map(smooth).collect());
    };
    let transport = Transport { light: Light::Unpolarised, ..transport.clone() };
    let solution = doubling::solve(&transport, Geometry::Plane, &angles(), settings)?;
    let axis = exit_axis(Geometry::Plane, transport.facets.slope_sd);
    let lobe = |incidence: usize| {
        let [interior, surface, _] = cell_shares(&axis, &solution, incidence);
        interior.iter().zip(&surface).map(|(a, b)| a + b).collect()
    };
    Ok((0..ANGLES_DEG.len()).map(lobe).collect())
}

/// The further bands among the wavelengths looked at, and the largest error of reading between bands (a share).
fn choose(nodes: &[f64], lobes: &[&Lobes], own: f64, share: f64) -> (Vec<f64>, f64) {
    let at_own = nodes.iter().position(|nm| *nm == own).unwrap_or(0);
    let change =
        lobes.iter().map(|other| missed(lobes[at_own], lobes[at_own], 0.0, other)).fold(0.0, f64::max);
    if change <= share {
        return (Vec::new(), change);
    }
    // The error of taking `lo` and `hi` as bands, at what lies between.
    let between = |lo: usize, hi: usize| {
        let inner = lo + 1..hi;
        let t = |i: usize| (nodes[i] - nodes[lo]) / (nodes[hi] - nodes[lo]);
        inner.map(|i| missed(lobes[lo], lobes[hi], t(i), lobes[i])).fold(0.0, f64::max)
    };
    let mut bands = vec![at_own];
    let mut lo = at_own;
    while lo + 1 < nodes.len() {
        lo = (lo + 1..nodes.len()).rev().find(|hi| between(lo, *hi) <= share).unwrap_or(lo + 1);
        bands.push(lo);
    }
    let mut hi = at_own;
    while hi > 0 {
        hi = (0..hi).find(|lo| between(*lo, hi) <= share).unwrap_or(hi - 1);
        bands.insert(0, hi);
    }
    let read = bands.windows(2).map(|pair| between(pair[0], pair[1])).fold(0.0, f64::max);
    // Between wavelengths looked at, a quarter of what their neighbours miss each of them by.
    let finest = (1..nodes.len() - 1)
        .map(|i| {
            let t = (nodes[i] - nodes[i - 1]) / (nodes[i + 1] - nodes[i - 1]);
            0.25 * missed(lobes[i - 1], lobes[i + 1], t, lobes[i])
        })
        .fold(0.0, f64::max);
    (bands.into_iter().filter(|i| *i != at_own).map(|i| nodes[i]).collect(), read.max(finest))
}

/// Total variation between a lobe and a mix of two others, as a share of its light, worst incidence.
fn missed(a: &Lobes, b: &Lobes, t: f64, lobe: &Lobes) -> f64 {
    let incidences = a.iter().zip(b).zip(lobe).map(|((a, b), lobe)| {
        let cells = a.iter().zip(b).zip(lobe);
        let difference: f64 = cells.map(|((a, b), x)| ((1.0 - t) * a + t * b - x).abs()).sum();
        0.5 * difference / lobe.iter().sum::<f64>().max(f64::MIN_POSITIVE)
    });
    incidences.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::effort;
    use crate::effects::Effects;
    use crate::options::{Options, Target};
    use crate::recipe::AzimuthMode;

    fn request(text: &str, percent: f64) -> Request {
        let effects =
            [Effect::Surface, Effect::Blur, Effect::Azimuth, Effect::Absorption, Effect::Dispersion];
        let options = Options {
            effects: Effects::Listed(effects.into_iter().collect()),
            target: Target::AccuracyPercent(percent),
            ..Options::default()
        };
        Request::new(Recipe::from_json(text).unwrap(), options).unwrap()
    }

    const GLASSY: &str = r#"{"stack":{"layers":40,"aragonite":{"n":{"cauchy":[1.52,0.02]}},"conchiolin":{"n":{"cauchy":[1.43,0.002]}}}}"#;

    #[test]
    fn without_the_effect_there_is_one_band() {
        let mut request = request(GLASSY, 1.0);
        request.effects = request.effects.without(Effect::Dispersion);
        assert_eq!(request.bands().unwrap(), Bands::own(&request.recipe));
    }

    #[test]
    fn the_effort_of_a_walk_is_that_of_one_band() {
        let dispersed = request(GLASSY, 1.0);
        assert!(!dispersed.bands().unwrap().further_nm.is_empty());
        let own = Request { effects: dispersed.effects.without(Effect::Dispersion), ..dispersed.clone() };
        let effort = |request: &Request| effort::scout(request, 0.01, 16, |_| false).unwrap();
        assert_eq!(effort(&dispersed), effort(&own));
    }

    #[test]
    fn constant_indices_need_no_further_band() {
        let bands = request(r#"{"stack":{"layers":40}}"#, 1.0).bands().unwrap();
        assert!(bands.further_nm.is_empty(), "{bands:?}");
    }

    #[test]
    fn more_accuracy_takes_more_bands_and_keeps_to_it() {
        let mut counts = Vec::new();
        for percent in [20.0, 5.0, 1.0, 0.2] {
            let bands = request(GLASSY, percent).bands().unwrap();
            assert!(bands.interpolation_percent <= percent, "{percent}: {bands:?}");
            counts.push(bands.further_nm.len());
        }
        assert!(counts.is_sorted() && counts[0] < counts[3], "{counts:?}");
    }

    #[test]
    fn what_is_read_between_bands_is_as_near_as_claimed_at_wavelengths_never_looked_at() {
        let request = request(GLASSY, 1.0);
        let bands = request.bands().unwrap();
        let settings = cheap_settings(&request.transport().unwrap(), 0.01);
        let at = |nm: f64| lobes(&request.at_wavelength(nm).transport().unwrap(), settings.as_ref()).unwrap();
        let all: Vec<f64> = bands.all_nm().collect();
        for nm in [391.0, 433.0, 487.0, 611.0, 693.0, 771.0] {
            let [(a, _), (b, t)] = bands.shares(nm);
            let error = 100.0 * missed(&at(all[a]), &at(all[b]), t, &at(nm));
            assert!(error <= 1.05 * bands.interpolation_percent, "{nm} nm: {error} %, {bands:?}");
        }
    }

    #[test]
    fn shares_of_the_bands_add_up_in_every_channel() {
        let bands =
            Bands { own_nm: 550.0, further_nm: vec![380.0, 620.0, 780.0], interpolation_percent: 0.0 };
        let weights = bands.rgb_weights();
        for c in 0..3 {
            let sum: f64 = weights.iter().map(|w| w[c]).sum();
            assert!((sum - 1.0).abs() < 1e-12, "{weights:?}");
        }
        // Blue is seen at short wavelengths, red at long ones.
        assert!(weights[1][2] > 0.5 && weights[2][0] > 0.5, "{weights:?}");
        assert_eq!(bands.shares(700.0), [(2, 0.5), (3, 0.5)]);
        assert_eq!(bands.shares(300.0), [(1, 1.0), (1, 0.0)]);
    }

    #[test]
    fn bands_are_the_same_in_the_plane_and_in_space() {
        let plane = request(GLASSY, 5.0);
        let mut space = plane.clone();
        space.recipe.azimuth.mode = AzimuthMode::Space;
        assert_eq!(plane.bands().unwrap(), space.bands().unwrap());
    }
}
