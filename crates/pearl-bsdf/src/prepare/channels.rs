//! Colours of the lobes and of the base, channel by channel: linear sRGB, and the bands of the interference colours.

use super::{Band, Prepared};
use crate::facets::{Facets, Rules};
use crate::lobes::Lobes;
use crate::lobes::integral::{self, COARSE};
use crate::numerics::curve::{self, Curve, NODES, Place, STEPS};
use crate::numerics::quadrature::Spline;
use lut_io::lobe::Interpolant;
use lut_io::monotone::Monotone;
use lut_io::reciprocal::Reciprocal;
use lut_io::spectra::Spectra;
use lut_io::table::Component;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::f64::consts::FRAC_PI_2;

/// Incidences at which the half-vector angles of the lobes are tallied: every eighth node of [`curve`], at most a degree apart and
/// closer towards the horizon, where lobes change faster.
const TALLIES: usize = STEPS / STEPS_PER_TALLY + 1;
const STEPS_PER_TALLY: usize = 8;
/// Channels that are summed side by side.
const BLOCK: usize = 8;

/// Channels of one kind, of all bands.
#[derive(Clone, Debug)]
pub(crate) struct Channels {
    /// Wavelengths, nm, ascending; empty for linear sRGB.
    pub(crate) wavelength_nm: Vec<f64>,
    /// What makes the reflectance of a channel from a colour in linear sRGB: the scalar product with these.
    pub(crate) reflectance: Vec<[f64; 3]>,
    /// Ê over the viewing angle.
    pub(crate) emission: Vec<Curve>,
}

/// One channel of the lobes of a band.
#[derive(Clone, Debug)]
pub(crate) struct Coloured {
    /// M over θd.
    pub(crate) modulation: Curve,
    /// Light over θi where M is the colour of the lobes.
    pub(crate) light: Light,
}

/// What becomes of the light over θi.
#[derive(Clone, Debug)]
pub(crate) struct Light {
    /// Albedos of interior, rehit and the single reflection.
    pub(crate) albedo: [Curve; 3],
    /// 1 less their sum, which may be negative.
    pub(crate) rest: Curve,
}

/// What the channels are.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Kind {
    Rgb,
    Spectral,
}

impl Channels {
    /// Those of a table; one for all wavelengths where it has no interference colours.
    pub(super) fn new(kind: Kind, spectra: Option<&Spectra>, own_nm: f64) -> Self {
        let (wavelength_nm, reflectance) = match (kind, spectra) {
            (Kind::Rgb, _) => (Vec::new(), vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            (Kind::Spectral, None) => (vec![own_nm], vec![[1.0 / 3.0; 3]]),
            (Kind::Spectral, Some(spectra)) => {
                let nm = &spectra.wavelength_nm;
                (nm.clone(), nm.iter().map(|nm| reflectance(*nm)).collect())
            }
        };
        let emission = spectra.and_then(|spectra| spectra.emission.as_ref()).map(|emission| match kind {
            Kind::Rgb => over_nodes(&emission.theta_deg, &emission.radiance_rgb),
            Kind::Spectral => over_nodes(&emission.theta_deg, &emission.radiance),
        });
        let one = || vec![vec![1.0; NODES]; reflectance.len()];
        let emission =
            emission.unwrap_or_else(one).iter().map(|values| curve::curve(|k| values[k])).collect();
        Self { wavelength_nm, reflectance, emission }
    }

    /// How many there are.
    pub(crate) const fn count(&self) -> usize {
        self.reflectance.len()
    }
}

/// Spectral reflectance of the primaries of linear sRGB: red above 580 nm, green 490 to 580 nm, blue below, joined by
/// ramps of 30 nm. Grey is flat, and nothing leaves the range of the channels, which is what energy needs.
pub(crate) fn reflectance(nm: f64) -> [f64; 3] {
    let ramp = |centre: f64| ((nm - centre) / 30.0 + 0.5).clamp(0.0, 1.0);
    let (green_on, red_on) = (ramp(490.0), ramp(580.0));
    [red_on, green_on - red_on, 1.0 - green_on]
}

/// Every channel of stored rows of colours at the nodes of [`curve`].
pub(super) fn over_nodes<R: AsRef<[f64]>>(theta_deg: &[f64], rows: &[R]) -> Vec<Vec<f64>> {
    let theta: Vec<f64> = theta_deg.iter().map(|theta| theta.to_radians()).collect();
    let nodes: Vec<f64> = (0..NODES).map(curve::theta_at).collect();
    let channel = |c: usize| {
        let stored = Monotone::new(theta.clone(), rows.iter().map(|row| row.as_ref()[c]).collect());
        nodes.iter().map(|node| stored.at(*node)).collect()
    };
    (0..rows[0].as_ref().len()).map(channel).collect()
}

/// What the lobes of a band do to the light of every colour.
pub(super) struct Means {
    /// Albedos over the nodes: interior, rehit, single reflection.
    albedo: [Vec<f64>; 3],
    /// Where the lobes' light has its half-vector angles: per tallied incidence, for each of the three, a histogram over the nodes of
    /// [`curve`] whose sum is 1 (or 0 without light).
    half_angles: Vec<[Tally; 3]>,
}

/// A histogram over the nodes of [`curve`]: the first that has any mass, and the masses from there to the last.
struct Tally {
    first: usize,
    mass: Vec<f64>,
}

impl Tally {
    /// With a sum of 1.
    fn new(mass: &[f64]) -> Self {
        let total: f64 = mass.iter().sum();
        let first = mass.iter().position(|mass| *mass > 0.0).unwrap_or(0);
        let end = mass.iter().rposition(|mass| *mass > 0.0).map_or(0, |last| last + 1);
        Self { first, mass: mass[first..end].iter().map(|mass| mass / total).collect() }
    }
}

/// Means of several colours over a histogram.
struct Mean<'t, const N: usize> {
    tally: &'t Tally,
    by_node: &'t [[f64; N]],
}

impl<const N: usize> WithSimd for Mean<'_, N> {
    type Output = [f64; N];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; N] {
        let Tally { first, mass } = self.tally;
        let mut sums = [0.0; N];
        for (mass, colours) in mass.iter().zip(&self.by_node[*first..]) {
            for (sum, colour) in sums.iter_mut().zip(colours) {
                *sum += mass * colour;
            }
        }
        sums
    }
}

impl Means {
    pub(super) fn new(
        lobe: &Interpolant,
        light: Option<&Reciprocal>,
        lobes: &Lobes,
        facets: &Facets,
        mirror: &Curve,
    ) -> Self {
        let rules = Rules::new();
        let tally = |tally: usize| half_angles(facets, &rules, lobes, mirror, tally * STEPS_PER_TALLY);
        let over_theta = |albedo: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..NODES).map(|node| albedo(curve::theta_at(node)).max(0.0)).collect()
        };
        let gain = |theta: f64| light.map_or([0.0; 2], |section| section.gain(theta));
        Self {
            albedo: [
                over_theta(&|theta| lobe.albedo(Component::Interior, theta) + gain(theta)[0]),
                over_theta(&|theta| lobe.albedo(Component::Rehit, theta) + gain(theta)[1]),
                over_theta(&|theta| single_reflection_share(lobe, theta)),
            ],
            half_angles: (0..TALLIES).into_par_iter().map(tally).collect(),
        }
    }

    /// Light where the colour of the lobes is this one over θd.
    pub(super) fn light(&self, colour: &[f64]) -> Light {
        self.lights([colour]).swap_remove(0)
    }

    /// Light of several colours, which share the passes over the histograms.
    pub(super) fn lights<const N: usize>(&self, colours: [&[f64]; N]) -> Vec<Light> {
        let by_node: Vec<[f64; N]> = (0..NODES).map(|node| colours.map(|colour| colour[node])).collect();
        let mut means: [[Vec<f64>; 3]; N] = std::array::from_fn(|_| <[Vec<f64>; 3]>::default());
        for tally in &self.half_angles {
            for (part, tally) in tally.iter().enumerate() {
                let sums = Arch::new().dispatch(Mean { tally, by_node: &by_node });
                means.iter_mut().zip(sums).for_each(|(means, sum)| means[part].push(sum));
            }
        }
        means.into_iter().map(|means| self.light_of(means)).collect()
    }

    /// Light by the means of a colour over where the three have their half-vector angles, at the tallied incidences.
    fn light_of(&self, means: [Vec<f64>; 3]) -> Light {
        let mut albedo = means.into_iter().zip(&self.albedo).map(|(means, albedo)| {
            let spline = Spline::new(means);
            let at = |(node, albedo): (usize, &f64)| {
                albedo * spline.at(node as f64 / STEPS_PER_TALLY as f64).max(0.0)
            };
            albedo.iter().enumerate().map(at).collect::<Vec<f64>>()
        });
        let albedo: [Vec<f64>; 3] = std::array::from_fn(|_| albedo.next().unwrap_or_default());
        let [interior, rehit, single] = &albedo;
        let rest = curve::curve(|node| 1.0 - (interior[node] + rehit[node] + single[node]));
        Light { albedo: albedo.each_ref().map(|albedo| curve::curve(|node| albedo[node])), rest }
    }

    /// Light without colour.
    pub(super) fn plain(&self) -> Light {
        self.light(&[1.0; NODES])
    }

    /// Every channel of the band, whose light without colour is known.
    pub(super) fn coloured(
        &self,
        kind: Kind,
        spectra: Option<&Spectra>,
        plain: &Light,
        count: usize,
    ) -> Vec<Coloured> {
        let modulation = spectra.and_then(|spectra| spectra.coherent.as_ref()).map(|coherent| match kind {
            Kind::Rgb => over_nodes(&coherent.theta_deg, &coherent.modulation_rgb),
            Kind::Spectral => over_nodes(&coherent.theta_deg, &coherent.modulation),
        });
        let Some(modulation) = modulation else {
            return vec![Coloured { modulation: curve::curve(|_| 1.0), light: plain.clone() }; count];
        };
        let block = |m: &[Vec<f64>]| {
            let last = m.len() - 1;
            let lights = self.lights::<BLOCK>(std::array::from_fn(|c| &m[c.min(last)][..]));
            let of =
                |(m, light): (&Vec<f64>, Light)| Coloured { modulation: curve::curve(|node| m[node]), light };
            m.iter().zip(lights).map(of).collect::<Vec<_>>()
        };
        modulation.par_chunks(BLOCK).flat_map_iter(block).collect()
    }
}

impl Prepared {
    /// The channels of one kind.
    pub(crate) const fn kind(&self, kind: Kind) -> &Channels {
        match kind {
            Kind::Rgb => &self.rgb,
            Kind::Spectral => &self.spectral,
        }
    }
}

impl Band {
    /// What the lobes have of the channels of one kind.
    pub(crate) fn channels(&self, kind: Kind) -> &[Coloured] {
        match kind {
            Kind::Rgb => &self.rgb,
            Kind::Spectral => &self.spectral,
        }
    }
}

/// Share of the light that interface 0 reflects at first meeting.
pub(super) fn single_reflection_share(lobe: &Interpolant, theta: f64) -> f64 {
    (lobe.albedo(Component::Surface, theta) - lobe.albedo(Component::Rehit, theta)).max(0.0)
}

/// Where the light of the lobes has its half-vector angles, at an incidence that is a node of [`curve`].
fn half_angles(facets: &Facets, rules: &Rules, lobes: &Lobes, mirror: &Curve, node: usize) -> [Tally; 3] {
    // At 90° no light arrives; its limit is what counts.
    let theta_i = curve::theta_at(node).min(FRAC_PI_2 - 1e-6);
    let mut single = vec![0.0; NODES];
    let mut tabulated = vec![[0.0; 2]; NODES];
    facets.integrate(rules, theta_i.cos(), |mass, cos, cos_o| {
        let seen = if lobes.reciprocal { Place::of_cos(cos_o).read(mirror) * cos_o } else { 1.0 };
        Place::of_cos(cos).deposit(mass * seen, &mut single);
    });
    integral::integrate(lobes, theta_i, COARSE, |at, masses| at.deposit_each(masses, &mut tabulated));
    let [interior, rehit] =
        [0, 1].map(|lobe: usize| tabulated.iter().map(|masses| masses[lobe]).collect::<Vec<f64>>());
    [&interior, &rehit, &single].map(|mass| Tally::new(mass))
}
