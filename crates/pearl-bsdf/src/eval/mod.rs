//! The BSDF itself: values and densities of pairs of directions.

mod albedo;
mod colours;
pub(crate) mod many;

use crate::Direction;
use crate::controls::{BsdfError, Components, Controls};
use crate::facets::Half;
use crate::lobes::{Incidence, Light};
use crate::numerics::angles::{Polar, half_azimuth2};
use crate::numerics::curve::{Place, Quads};
use crate::prepare::channels::Kind;
use crate::prepare::{Band, Prepared};
pub(crate) use colours::Viewer;
use colours::{Angles, Channels, Colours, three};
use lut_io::table::Table;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::FRAC_1_PI;
use std::sync::{Arc, OnceLock};

/// f·cos θo of each component, linear sRGB (or three bands), 1/sr.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// Diffuse light of the body.
    pub diffuse: [f64; 3],
    /// Incoherent interference.
    pub incoherent: [f64; 3],
    /// Reflection by the outermost interface.
    pub mirror: [f64; 3],
    /// Light that came back from the interior.
    pub blur: [f64; 3],
}

impl Evaluation {
    /// The components in the order of [`Components::NAMES`].
    #[must_use]
    pub const fn parts(&self) -> [[f64; 3]; 4] {
        [self.diffuse, self.incoherent, self.mirror, self.blur]
    }

    /// Sum of the components.
    #[must_use]
    pub fn rgb(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.diffuse[c] + self.incoherent[c] + self.mirror[c] + self.blur[c])
    }
}

/// A prepared table with controls.
#[derive(Clone, Debug)]
pub struct PearlBsdf {
    pub(crate) prepared: Arc<Prepared>,
    controls: Controls,
    /// Centres of the bands of the interference colours at this thickness, nm; one for a table without them.
    wavelengths_nm: Vec<f64>,
    /// Linear sRGB of each band.
    rgb: Vec<Colours>,
    /// Channels of each band in groups of three, once they were asked for.
    spectral: OnceLock<Vec<Vec<Colours>>>,
    /// Over θi: probability of sampling interior, rehit, surface, base.
    chances: Quads,
}

/// The pearl at one wavelength of its lobes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AtBand<'a> {
    pub(crate) band: &'a Band,
    rgb: &'a Colours,
    components: Components,
}

/// A pair of directions above the horizon, with what all bands need of it.
#[derive(Clone, Copy)]
pub(crate) struct Pair {
    half: Half,
    i: Polar,
    o: Polar,
    /// sin²(φ/2).
    y2: f64,
    at_i: Place,
    at_o: Place,
    /// θd.
    at_d: Place,
}

/// What both eval and pdf need of a pair of directions at one wavelength of the lobes.
pub(crate) struct Geometry {
    pair: Pair,
    /// [`crate::facets::Facets::facing`].
    facing: f64,
    light: Light,
}

impl Pair {
    #[inline(always)]
    fn new(wi: Direction, wo: Direction) -> Option<Self> {
        Some(Self::of(wi, wo, Self::polar(wi, wo)?))
    }

    /// Polar forms of directions above the horizon.
    #[inline(always)]
    fn polar(wi: Direction, wo: Direction) -> Option<[Polar; 2]> {
        if !(above_horizon(wi) && above_horizon(wo)) {
            return None;
        }
        Some(Polar::of([wi, wo]))
    }

    /// With their polar form.
    #[inline(always)]
    pub(crate) fn of(wi: Direction, wo: Direction, [i, o]: [Polar; 2]) -> Self {
        let y2 = half_azimuth2(i.azimuth, o.azimuth);
        let half = Half::new(wi, wo);
        let [at_i, at_o, at_d] = Place::of_cosines([wi[2], wo[2], half.cos]);
        Self { half, i, o, y2, at_i, at_o, at_d }
    }
}

impl PearlBsdf {
    /// A prepared table with a look of its own; takes less than a millisecond, so that changing controls is cheap.
    ///
    /// # Errors
    /// A control out of range, or one that asks for colours that the table does not have.
    pub fn new(prepared: Arc<Prepared>, controls: Controls) -> Result<Self, BsdfError> {
        prepared.check(&controls)?;
        let colours = |band: &Band| Colours::new(&prepared, Kind::Rgb, band, 0, &controls);
        let rgb: Vec<Colours> = prepared.bands.iter().map(colours).collect();
        // Samples are those of the recipe's own thickness.
        let own = Controls { thickness: 1.0, ..controls };
        let chances = if controls.thickness == 1.0 {
            rgb[0].chances(&prepared.bands[0], &controls)
        } else {
            Colours::new(&prepared, Kind::Rgb, &prepared.bands[0], 0, &own).chances(&prepared.bands[0], &own)
        };
        let wavelengths_nm =
            prepared.spectral.wavelength_nm.iter().map(|nm| controls.thickness * nm).collect();
        Ok(Self { prepared, controls, wavelengths_nm, rgb, spectral: OnceLock::new(), chances })
    }

    /// [`Prepared::new`] and [`Self::new`] in one, for a table that gets one look.
    ///
    /// # Errors
    /// A control out of range, a table that is not valid or lacks what the controls ask for.
    pub fn from_table(table: impl Into<Arc<Table>>, controls: Controls) -> Result<Self, BsdfError> {
        controls.check()?;
        Self::new(Arc::new(Prepared::new(table)?), controls)
    }

    /// The controls.
    #[must_use]
    pub const fn controls(&self) -> &Controls {
        &self.controls
    }

    /// The table that it reads.
    #[must_use]
    pub const fn prepared(&self) -> &Arc<Prepared> {
        &self.prepared
    }

    /// Centres of the bands of the interference colours at the pearl's thickness, nm; one for a table without them.
    #[must_use]
    pub fn wavelengths_nm(&self) -> &[f64] {
        &self.wavelengths_nm
    }

    /// Standard deviation of the slopes of interface 0, radians.
    pub(crate) fn slope_sd(&self) -> f64 {
        self.prepared.bands[0].facets.slope_sd()
    }

    /// f·cos θo of each shown component in linear sRGB, 1/sr.
    #[must_use]
    pub fn eval(&self, wi: Direction, wo: Direction) -> Evaluation {
        self.evaluate(wi, wo, Viewer::AtExit)
    }

    /// What a viewer at `view` sees of unit radiance from `light`: f(light → view)·cos θ of the light, linear sRGB, 1/sr.
    ///
    /// This is what an image is integrated from. The lobes are [`Self::eval`] with the view as incidence (as
    /// renderers that trace paths from the camera call it), so that a white surrounding never shows brighter than 1;
    /// the emission is read at the viewing angle. [`Self::sample`] and [`Self::pdf`] with wi = view fit.
    #[must_use]
    pub fn eval_seen(&self, view: Direction, light: Direction) -> Evaluation {
        self.evaluate(view, light, Viewer::AtIncidence)
    }

    fn evaluate(&self, wi: Direction, wo: Direction, viewer: Viewer) -> Evaluation {
        if self.is_dispersed() {
            let Some(pair) = Pair::new(wi, wo) else { return Evaluation::default() };
            return self.dispersed(&pair, viewer);
        }
        Arch::new().dispatch(Evaluated { pearl: self.own(), wi: &wi, wo: &wo, viewer })
    }

    /// Linear sRGB of all bands: each channel takes its share of each lobe.
    fn dispersed(&self, pair: &Pair, viewer: Viewer) -> Evaluation {
        light_of(self.mixed(|band| band.eval(pair, viewer).parts()))
    }

    /// The four components of linear sRGB, each channel with its shares of the bands.
    fn mixed(&self, parts: impl Fn(AtBand<'_>) -> [[f64; 3]; 4]) -> [[f64; 3]; 4] {
        let mut sum = [[0.0; 3]; 4];
        for (k, weight) in self.prepared.rgb_weights.iter().enumerate() {
            add_weighted(&mut sum, weight, &parts(self.band(k)));
        }
        sum
    }

    /// Whether the lobe depends on the wavelength.
    #[inline(always)]
    pub(crate) fn is_dispersed(&self) -> bool {
        self.rgb.len() > 1
    }

    /// The pearl in one band.
    #[inline(always)]
    fn band(&self, k: usize) -> AtBand<'_> {
        AtBand { band: &self.prepared.bands[k], rgb: &self.rgb[k], components: self.controls.components }
    }

    /// The pearl at the table's own wavelength: what is sampled.
    #[inline(always)]
    pub(crate) fn own(&self) -> AtBand<'_> {
        self.band(0)
    }

    /// f·cos θo of each shown component at one wavelength (nm), 1/sr, in the order of [`Components::NAMES`].
    ///
    /// Between band centres the values of the two bands are mixed, beyond the ends the last band is used. A table
    /// without interference colours has the mean of its RGB channels at every wavelength. Body colour and tint are
    /// turned into reflectances that are flat within a channel's part of the spectrum.
    #[must_use]
    pub fn eval_at(&self, wi: Direction, wo: Direction, wavelength_nm: f64) -> [f64; 4] {
        self.shade_at(wi, wo, wavelength_nm, Viewer::AtExit)
    }

    /// [`Self::eval_seen`] at one wavelength (nm), as [`Self::eval_at`] is [`Self::eval`].
    #[must_use]
    pub fn eval_seen_at(&self, view: Direction, light: Direction, wavelength_nm: f64) -> [f64; 4] {
        self.shade_at(view, light, wavelength_nm, Viewer::AtIncidence)
    }

    /// The sum of [`Self::eval_seen_at`] at many wavelengths (nm), for little more than the price of a few.
    #[must_use]
    pub fn eval_seen_spectrum(&self, view: Direction, light: Direction, wavelengths_nm: &[f64]) -> Vec<f64> {
        if self.is_dispersed() {
            let at = |nm: &f64| self.eval_seen_at(view, light, *nm).iter().sum();
            return wavelengths_nm.iter().map(at).collect();
        }
        let (own, nodes) = (self.own(), self.wavelengths_nm());
        let Some(geometry) = own.geometry_of(view, light) else { return vec![0.0; wavelengths_nm.len()] };
        let lobes = own.lobes(&geometry);
        let shade = |colours: &Colours| own.shade(colours, &geometry, lobes, Viewer::AtIncidence).rgb();
        // The last group repeats the last channel.
        let channels: Vec<f64> = self.spectral()[0].iter().flat_map(shade).take(nodes.len()).collect();
        wavelengths_nm.iter().map(|nm| at_wavelength(nodes, &channels, *nm)).collect()
    }

    /// Channels of each band in groups of three.
    fn spectral(&self) -> &[Vec<Colours>] {
        let prepared = &self.prepared;
        let groups = |band: &Band| {
            let firsts = (0..prepared.spectral.count()).step_by(3);
            firsts.map(|first| Colours::new(prepared, Kind::Spectral, band, first, &self.controls)).collect()
        };
        self.spectral.get_or_init(|| prepared.bands.iter().map(groups).collect())
    }

    fn shade_at(&self, wi: Direction, wo: Direction, wavelength_nm: f64, viewer: Viewer) -> [f64; 4] {
        let (bands_nm, places) = &self.prepared.by_wavelength;
        let Some(pair) = Pair::new(wi, wo) else { return [0.0; 4] };
        between_nodes(bands_nm, wavelength_nm, |k| {
            let band = self.band(places[k]);
            let geometry = band.geometry(&pair);
            let lobes = band.lobes(&geometry);
            between_nodes(self.wavelengths_nm(), wavelength_nm, |channel| {
                let colours = &self.spectral()[places[k]][channel / 3];
                band.shade(colours, &geometry, lobes, viewer).parts().map(|channels| channels[channel % 3])
            })
        })
    }

    /// Density with which [`Self::sample`] finds wo, 1/sr.
    #[must_use]
    pub fn pdf(&self, wi: Direction, wo: Direction) -> f64 {
        Arch::new().dispatch(Density { pearl: self, wi: &wi, wo: &wo })
    }

    /// [`Self::eval`] and [`Self::pdf`] for little more than the price of one.
    #[must_use]
    pub fn eval_pdf(&self, wi: Direction, wo: Direction) -> (Evaluation, f64) {
        let Some(geometry) = self.own().geometry_of(wi, wo) else { return (Evaluation::default(), 0.0) };
        (self.value(&geometry, Viewer::AtExit), self.density(&geometry))
    }

    /// Linear sRGB from the geometry in the table's own band.
    #[inline(always)]
    pub(crate) fn value(&self, geometry: &Geometry, viewer: Viewer) -> Evaluation {
        let own = self.own();
        if self.is_dispersed() {
            // The lobe at the table's own wavelength is what is sampled.
            self.dispersed(&geometry.pair, viewer)
        } else {
            own.shade(own.rgb, geometry, own.lobes(geometry), viewer)
        }
    }

    #[inline(always)]
    pub(crate) fn density(&self, Geometry { pair, facing, light }: &Geometry) -> f64 {
        let facets = self.own().band.facets.pdf(&pair.i, &pair.half, *facing);
        density_of(&self.chances(pair.at_i), pair.o.cos, light.densities, facets)
    }

    #[inline(always)]
    pub(crate) fn chances(&self, at_i: Place) -> [f64; 4] {
        at_i.read4(&self.chances).map(f64::from)
    }
}

/// [`PearlBsdf::eval`].
struct Evaluated<'a> {
    pearl: AtBand<'a>,
    wi: &'a Direction,
    wo: &'a Direction,
    viewer: Viewer,
}

impl WithSimd for Evaluated<'_> {
    type Output = Evaluation;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Evaluation {
        let Self { pearl, wi, wo, viewer } = self;
        let Some(geometry) = pearl.geometry_of(*wi, *wo) else { return Evaluation::default() };
        pearl.shade(pearl.rgb, &geometry, pearl.lobes(&geometry), viewer)
    }
}

/// [`PearlBsdf::pdf`].
struct Density<'a> {
    pearl: &'a PearlBsdf,
    wi: &'a Direction,
    wo: &'a Direction,
}

impl WithSimd for Density<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Self { pearl, wi, wo } = self;
        let Some(geometry) = pearl.own().geometry_of(*wi, *wo) else { return 0.0 };
        pearl.density(&geometry)
    }
}

/// [`AtBand::eval`].
struct OfBand<'a> {
    pearl: AtBand<'a>,
    pair: &'a Pair,
    viewer: Viewer,
}

impl WithSimd for OfBand<'_> {
    type Output = Evaluation;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Evaluation {
        let Self { pearl, pair, viewer } = self;
        let geometry = pearl.geometry(pair);
        pearl.shade(pearl.rgb, &geometry, pearl.lobes(&geometry), viewer)
    }
}

impl AtBand<'_> {
    /// Linear sRGB of this band alone.
    #[inline(always)]
    fn eval(&self, pair: &Pair, viewer: Viewer) -> Evaluation {
        Arch::new().dispatch(OfBand { pearl: *self, pair, viewer })
    }

    /// The geometry of two directions above the horizon.
    #[inline(always)]
    fn geometry_of(&self, wi: Direction, wo: Direction) -> Option<Geometry> {
        let polar = Pair::polar(wi, wo)?;
        // First: what is read in the table waits for it.
        let incidence = self.band.lobes.incidence(&polar[0]);
        Some(self.geometry_at(&Pair::of(wi, wo, polar), &incidence))
    }

    #[inline(always)]
    fn geometry(&self, pair: &Pair) -> Geometry {
        self.geometry_at(pair, &self.band.lobes.incidence(&pair.i))
    }

    /// The geometry of an incidence that is known.
    #[inline(always)]
    pub(crate) fn geometry_at(&self, pair: &Pair, incidence: &Incidence) -> Geometry {
        let light = self.band.lobes.light(incidence, &pair.i, &pair.o, pair.y2);
        Geometry { pair: *pair, facing: self.band.facets.facing(&pair.half), light }
    }

    /// f·cos θo of the lobes short of their colour: mirror and blur.
    #[inline(always)]
    fn lobes(&self, geometry: &Geometry) -> [f64; 2] {
        let Geometry { pair, facing, light } = geometry;
        let [interior, rehit] = light.values;
        let scale = self.mirror_factor(pair.at_i, pair.at_o, pair.o.cos);
        [rehit + self.band.facets.reflection(&pair.half, *facing) * scale, interior]
    }

    /// Factor of the closed-form reflection.
    #[inline(always)]
    fn mirror_factor(&self, at_i: Place, at_o: Place, cos_o: f64) -> f64 {
        let Band { mirror, lobes, .. } = self.band;
        if lobes.reciprocal { at_i.read(mirror) * at_o.read(mirror) * cos_o } else { at_i.read(mirror) }
    }

    #[inline(always)]
    fn shade(&self, colours: &Colours, geometry: &Geometry, lobes: [f64; 2], viewer: Viewer) -> Evaluation {
        let Pair { at_i, at_o, at_d, o, .. } = geometry.pair;
        let angles = Angles { incidence: at_i, exit: at_o, half: at_d };
        self.coloured(colours, angles, o.cos, lobes, viewer)
    }

    /// The shown components, from mirror and blur short of their colour.
    #[inline(always)]
    fn coloured(
        &self,
        colours: &Colours,
        angles: Angles,
        cos_o: f64,
        [mirror, blur]: [f64; 2],
        viewer: Viewer,
    ) -> Evaluation {
        let components = self.components;
        let terms = colours.terms(angles, cos_o, viewer);
        let shown = |show: bool, rgb: Channels| if show { three(rgb) } else { [0.0; 3] };
        Evaluation {
            diffuse: shown(components.diffuse, terms.diffuse),
            incoherent: shown(components.incoherent, terms.incoherent),
            mirror: shown(components.mirror, terms.lobe.map(|factor| factor * mirror)),
            blur: shown(components.blur, terms.lobe.map(|factor| factor * blur)),
        }
    }
}

/// Density of all techniques together, by the chance and the density of each.
#[inline(always)]
fn density_of(
    [interior, rehit, surface, base]: &[f64; 4],
    cos_o: f64,
    [of_interior, of_rehit]: [f64; 2],
    facets: f64,
) -> f64 {
    base * cos_o * FRAC_1_PI + (interior * of_interior + rehit * of_rehit) + surface * facets
}

/// Adds a band's components to a sum, each channel with its share.
#[inline(always)]
fn add_weighted(sum: &mut [[f64; 3]; 4], weight: &[f64; 3], parts: &[[f64; 3]; 4]) {
    for (sum, part) in sum.iter_mut().zip(parts) {
        (0..3).for_each(|c| sum[c] += weight[c] * part[c]);
    }
}

/// Components mixed of bands: shares of sRGB's channels may be negative; light may not.
fn light_of(mixed: [[f64; 3]; 4]) -> Evaluation {
    let [diffuse, incoherent, mirror, blur] = mixed.map(|rgb| rgb.map(|channel| channel.max(0.0)));
    Evaluation { diffuse, incoherent, mirror, blur }
}

/// The two nodes around a wavelength, and how far (0..1) it is from the first to the second; the end nodes beyond the ends.
fn around_wavelength(nodes: &[f64], nm: f64) -> (usize, usize, f64) {
    let above = nodes.partition_point(|node| *node <= nm);
    let (lo, hi) = (above.saturating_sub(1), above.min(nodes.len() - 1));
    (lo, hi, if hi > lo { (nm - nodes[lo]) / (nodes[hi] - nodes[lo]) } else { 0.0 })
}

/// What is known at nodes, read linearly between them and constant beyond the ends.
fn between_nodes(nodes: &[f64], nm: f64, of: impl Fn(usize) -> [f64; 4]) -> [f64; 4] {
    let (lo, hi, share) = around_wavelength(nodes, nm);
    let a = of(lo);
    if hi == lo {
        return a;
    }
    let b = of(hi);
    std::array::from_fn(|part| a[part] + share * (b[part] - a[part]))
}

/// A spectrum known at nodes, read linearly between them and constant beyond the ends.
pub(crate) fn at_wavelength(nodes: &[f64], values: &[f64], nm: f64) -> f64 {
    let (lo, hi, share) = around_wavelength(nodes, nm);
    values[lo] + share * (values[hi] - values[lo])
}

/// Whether a vector is a direction, and above the horizon. Rounding may have left its length; a tenth off is a mistake.
#[inline(always)]
pub(crate) fn above_horizon([x, y, z]: Direction) -> bool {
    // False for NaN and infinities.
    z > 0.0 && (0.81..1.21).contains(&(x * x + y * y + z * z))
}
