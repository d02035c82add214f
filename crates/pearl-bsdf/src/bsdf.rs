//! The BSDF itself.

mod many;

use crate::Direction;
use crate::angles::{Polar, half_azimuth2, least, turned};
use crate::colour::{self, Angles, Channels, Colours, HalfAngles, Palette, STEPS_PER_TALLY, TALLIES, Viewer};
use crate::controls::{BsdfError, Components, Controls};
use crate::curve::{self, NODES, Place, Quads};
use crate::facets::{Facets, Half, Rules};
use crate::quadrature::gauss_legendre;
use crate::tabulated::{Exit, Incidence, Light, Tabulated};
use lut_io::axis::Stretched;
use lut_io::dispersion::Dispersion;
use lut_io::lobe::Interpolant;
use lut_io::reciprocal;
use lut_io::spectra::Spectra;
use lut_io::table::Table;
use std::f64::consts::{FRAC_1_PI, FRAC_PI_2, PI};

/// What is sampled, in the order of the probabilities: interior, rehit, facets of interface 0, base.
const INTERIOR: usize = 0;
const REHIT: usize = 1;
const SURFACE: usize = 2;
const BASE: usize = 3;

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

/// A sampled exit direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Exit direction.
    pub wo: Direction,
    /// Its probability density, 1/sr: what [`PearlBsdf::pdf`] says.
    pub pdf: f64,
    /// f·cos θo: what [`PearlBsdf::eval`] says.
    pub value: Evaluation,
}

/// A pearl table with controls.
#[derive(Clone, Debug)]
pub struct PearlBsdf {
    controls: Controls,
    facets: Facets,
    tabulated: Tabulated,
    /// Over θi: factor of the closed-form reflection that gives it its share of the light.
    mirror_scale: Box<[f64; NODES]>,
    /// Of reciprocal tables, over θ: the closed form is multiplied by this at θi, by this at θo, and by cos θo.
    mirror_ends: Option<Box<[f64; NODES]>>,
    rgb: Colours,
    wavelength_nm: Vec<f64>,
    bands: Vec<Colours>,
    /// Over θi: probability of sampling interior, rehit, surface, base.
    chances: Quads,
    /// The pearl at further wavelengths, where the table's lobe depends on them.
    dispersed: Option<Box<Dispersed>>,
}

/// A lobe that depends on the wavelength: what differs from the pearl at the table's own wavelength.
#[derive(Clone, Debug)]
struct Dispersed {
    /// Wavelengths of all bands, ascending, nm.
    wavelength_nm: Vec<f64>,
    /// Their places in `weights`: 0 is the table's own.
    place: Vec<usize>,
    /// Share of each band in the channels of linear sRGB, the table's own first.
    weights: Vec<[f64; 3]>,
    /// The pearl in each of the bands but the table's own.
    further: Vec<PearlBsdf>,
}

/// What both eval and pdf need of a pair of directions.
struct Geometry {
    half: Half,
    /// [`Facets::facing`].
    facing: f64,
    light: Light,
    at_i: Place,
    at_o: Place,
    polar_i: Polar,
    polar_o: Polar,
}

impl PearlBsdf {
    /// A BSDF of a table; takes tens of milliseconds (space tables more).
    ///
    /// # Errors
    /// A control out of range, a table that is not valid or lacks what the controls ask for.
    pub fn from_table(table: Table, controls: Controls) -> Result<Self, BsdfError> {
        controls.check()?;
        table.validate()?;
        let dispersed = Dispersed::of(&table, controls)?.map(Box::new);
        let spectra = Spectra::of(&table.meta)?;
        controls.check_against(&table.meta, spectra.as_ref())?;
        let light = reciprocal::section(&table.meta)?;
        let facets = Facets::new(&table.meta.surface_model);
        let lobe = Interpolant::new(table);
        let tabulated = Tabulated::new(&lobe);
        let rules = Rules::new();
        let mirror_ends = tabulated.is_reciprocal().then(|| mirror_ends(&lobe, &facets, &rules));
        let ends = mirror_ends.as_deref();
        let half_angles = (0..TALLIES)
            .map(|tally| tally_half_angles(&facets, &rules, &tabulated, ends, tally * STEPS_PER_TALLY));
        let half_angles: HalfAngles = half_angles.collect();
        let palette = Palette::rgb(spectra.as_ref(), &controls);
        let rgb = Colours::new(&palette, &controls, &lobe, &half_angles, light.as_ref());
        let wavelength_nm = spectra.as_ref().map_or_else(Vec::new, |s| s.wavelength_nm.clone());
        let bands = spectra.iter().flat_map(|spectra| {
            (0..spectra.wavelength_nm.len().div_ceil(3)).map(|group| {
                let palette = Palette::bands(spectra, &controls, group);
                Colours::new(&palette, &controls, &lobe, &half_angles, light.as_ref())
            })
        });
        let bands = bands.collect();
        let chances = chances(&rgb, &controls);
        let mirror_scale = mirror_scale(&lobe, &facets, &rules);
        Ok(Self {
            controls,
            facets,
            tabulated,
            mirror_scale,
            mirror_ends,
            rgb,
            wavelength_nm,
            bands,
            chances,
            dispersed,
        })
    }

    /// The controls.
    #[must_use]
    pub const fn controls(&self) -> &Controls {
        &self.controls
    }

    /// Standard deviation of the slopes of interface 0, radians.
    pub(crate) const fn slope_sd(&self) -> f64 {
        self.facets.slope_sd()
    }

    /// Centres of the bands of the interference colours, nm; empty without them.
    #[must_use]
    pub fn band_centres_nm(&self) -> &[f64] {
        &self.wavelength_nm
    }

    /// f·cos θo of each shown component in linear sRGB, 1/sr.
    #[must_use]
    pub fn eval(&self, wi: Direction, wo: Direction) -> Evaluation {
        self.over_bands(|pearl| pearl.eval_own(wi, wo, Viewer::AtExit))
    }

    /// What a viewer at `view` sees of unit radiance from `light`: f(light → view)·cos θ of the light, linear sRGB, 1/sr.
    ///
    /// This is what an image is integrated from. The lobes are [`Self::eval`] with the view as incidence (as
    /// renderers that trace paths from the camera call it), so that a white surrounding never shows brighter than 1;
    /// the emission is read at the viewing angle. [`Self::sample`] and [`Self::pdf`] with wi = view fit.
    #[must_use]
    pub fn eval_seen(&self, view: Direction, light: Direction) -> Evaluation {
        self.over_bands(|pearl| pearl.eval_own(view, light, Viewer::AtIncidence))
    }

    /// Linear sRGB with the lobe at the table's own wavelength.
    #[inline(always)]
    fn eval_own(&self, wi: Direction, wo: Direction, viewer: Viewer) -> Evaluation {
        let Some(geometry) = self.geometry(wi, wo) else { return Evaluation::default() };
        self.shade(&self.rgb, &geometry, self.lobes(&geometry), viewer)
    }

    /// Linear sRGB of all bands: each channel takes its share of each lobe.
    fn over_bands(&self, own: impl Fn(&Self) -> Evaluation) -> Evaluation {
        let Some(dispersed) = &self.dispersed else { return own(self) };
        light_of(dispersed.mixed(self, |pearl| own(pearl).parts()))
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
        if self.dispersed.is_some() {
            let at = |nm: &f64| self.eval_seen_at(view, light, *nm).iter().sum();
            return wavelengths_nm.iter().map(at).collect();
        }
        let Some(geometry) = self.geometry(view, light) else { return vec![0.0; wavelengths_nm.len()] };
        let lobes = self.lobes(&geometry);
        let shade = |colours: &Colours| self.shade(colours, &geometry, lobes, Viewer::AtIncidence).rgb();
        if self.bands.is_empty() {
            let mean = shade(&self.rgb).iter().sum::<f64>() / 3.0;
            return vec![mean; wavelengths_nm.len()];
        }
        // The last group repeats the last band.
        let bands: Vec<f64> = self.bands.iter().flat_map(shade).take(self.wavelength_nm.len()).collect();
        wavelengths_nm.iter().map(|nm| at_wavelength(&self.wavelength_nm, &bands, *nm)).collect()
    }

    fn shade_at(&self, wi: Direction, wo: Direction, wavelength_nm: f64, viewer: Viewer) -> [f64; 4] {
        let Some(dispersed) = &self.dispersed else {
            return self.shade_own_at(wi, wo, wavelength_nm, viewer);
        };
        let (lo, hi, share) = around_wavelength(&dispersed.wavelength_nm, wavelength_nm);
        let band = |index: usize| {
            dispersed.pearl(self, dispersed.place[index]).shade_own_at(wi, wo, wavelength_nm, viewer)
        };
        let (a, b) = (band(lo), band(hi));
        std::array::from_fn(|part| a[part] + share * (b[part] - a[part]))
    }

    fn shade_own_at(&self, wi: Direction, wo: Direction, wavelength_nm: f64, viewer: Viewer) -> [f64; 4] {
        let Some(geometry) = self.geometry(wi, wo) else { return [0.0; 4] };
        let lobes = self.lobes(&geometry);
        if self.bands.is_empty() {
            let parts = self.shade(&self.rgb, &geometry, lobes, viewer).parts();
            return parts.map(|rgb| rgb.iter().sum::<f64>() / 3.0);
        }
        let (lo, hi, share) = around_wavelength(&self.wavelength_nm, wavelength_nm);
        let band = |index: usize| {
            self.shade(&self.bands[index / 3], &geometry, lobes, viewer)
                .parts()
                .map(|channels| channels[index % 3])
        };
        let (a, b) = (band(lo), band(hi));
        std::array::from_fn(|part| a[part] + share * (b[part] - a[part]))
    }

    /// Density with which [`Self::sample`] finds wo, 1/sr.
    #[must_use]
    pub fn pdf(&self, wi: Direction, wo: Direction) -> f64 {
        self.geometry(wi, wo).map_or(0.0, |geometry| self.density(&geometry))
    }

    /// [`Self::eval`] and [`Self::pdf`] for little more than the price of one.
    #[must_use]
    pub fn eval_pdf(&self, wi: Direction, wo: Direction) -> (Evaluation, f64) {
        let Some(geometry) = self.geometry(wi, wo) else { return (Evaluation::default(), 0.0) };
        self.value_and_density(&geometry, wi, wo)
    }

    #[inline]
    fn value_and_density(&self, geometry: &Geometry, wi: Direction, wo: Direction) -> (Evaluation, f64) {
        if self.dispersed.is_some() {
            // The lobe at the table's own wavelength is what is sampled.
            return (self.eval(wi, wo), self.density(geometry));
        }
        (self.shade(&self.rgb, geometry, self.lobes(geometry), Viewer::AtExit), self.density(geometry))
    }

    /// An exit direction from three uniform numbers in [0, 1); `None` where nothing is reflected, or where the
    /// random numbers find no direction above the horizon (rarer than 1e-3).
    #[must_use]
    pub fn sample(&self, wi: Direction, u1: f64, u2: f64, u3: f64) -> Option<Sample> {
        if !above_horizon(wi) {
            return None;
        }
        let at_i = Place::of_cos(wi[2]);
        let (part, select) = choose(&self.chances(at_i), u1);
        let [polar] = Polar::of([wi]);
        let incidence = self.tabulated.incidence(&polar);
        let wo = match part {
            SURFACE => self.facets.sample(wi, &polar, u2, u3),
            BASE => direction(polar.azimuth, &cosine_hemisphere(u2, u3)),
            _ => direction(polar.azimuth, &self.tabulated.sample(part, &incidence, select, u2, u3)),
        };
        if !above_horizon(wo) {
            return None;
        }
        let ([polar_o], at_o) = (Polar::of([wo]), Place::of_cos(wo[2]));
        let geometry = self.geometry_at(wi, wo, (polar, at_i), (polar_o, at_o), incidence);
        let (value, pdf) = self.value_and_density(&geometry, wi, wo);
        (pdf > 0.0 && pdf.is_finite()).then_some(Sample { wo, pdf, value })
    }

    /// Directional albedo at θi (radians, below π/2) of each component, shown or not, linear sRGB, in the order of
    /// [`Components::NAMES`]: the integral of [`Self::eval`] over the exit hemisphere, by quadrature.
    #[must_use]
    pub fn directional_albedo(&self, theta_i: f64) -> [[f64; 3]; 4] {
        self.albedo(theta_i, Viewer::AtExit)
    }

    /// What a viewer at θ (radians, below π/2) sees of a white surrounding, component by component like
    /// [`Self::directional_albedo`]: the integral of [`Self::eval_seen`] over the light. The lobes are the same.
    #[must_use]
    pub fn directional_albedo_seen(&self, theta: f64) -> [[f64; 3]; 4] {
        self.albedo(theta, Viewer::AtIncidence)
    }

    fn albedo(&self, theta_i: f64, viewer: Viewer) -> [[f64; 3]; 4] {
        match &self.dispersed {
            None => self.albedo_own(theta_i, viewer),
            Some(dispersed) => dispersed.mixed(self, |pearl| pearl.albedo_own(theta_i, viewer)),
        }
    }

    fn albedo_own(&self, theta_i: f64, viewer: Viewer) -> [[f64; 3]; 4] {
        let cos_i = theta_i.cos();
        let at_i = Place::of_cos(cos_i);
        let (mut mirror, mut blur) = ([0.0; 3], [0.0; 3]);
        let add = |sum: &mut [f64; 3], mass: f64, cos_d: f64| {
            let factor = self.rgb.lobe_factor(at_i, Place::of_cos(cos_d));
            (0..3).for_each(|c| sum[c] += mass * factor[c]);
        };
        self.facets.integrate_exits(&Rules::new(), cos_i, |mass, cos_d, cos_o| {
            let scale = self.mirror_factor(at_i, Place::of_cos(cos_o), cos_o);
            add(&mut mirror, mass * scale, cos_d);
        });
        tabulated_light(&self.tabulated, theta_i, FINE, |cos_d, [interior, rehit]| {
            add(&mut mirror, rehit, cos_d);
            add(&mut blur, interior, cos_d);
        });
        let [diffuse, incoherent] = match viewer {
            Viewer::AtExit => self.rgb.base_albedo(at_i),
            Viewer::AtIncidence => self.rgb.base_albedo_seen(at_i),
        };
        [diffuse, incoherent, mirror, blur]
    }

    #[inline(always)]
    fn geometry(&self, wi: Direction, wo: Direction) -> Option<Geometry> {
        if !(above_horizon(wi) && above_horizon(wo)) {
            return None;
        }
        let [polar_i, polar_o] = Polar::of([wi, wo]);
        let [at_i, at_o] = Place::of_cosines([wi[2], wo[2]]);
        Some(self.geometry_at(wi, wo, (polar_i, at_i), (polar_o, at_o), self.tabulated.incidence(&polar_i)))
    }

    /// The geometry of an incidence that is known.
    #[inline(always)]
    fn geometry_at(
        &self,
        wi: Direction,
        wo: Direction,
        (polar_i, at_i): (Polar, Place),
        (polar_o, at_o): (Polar, Place),
        incidence: Incidence,
    ) -> Geometry {
        let y2 = half_azimuth2(polar_i.azimuth, polar_o.azimuth);
        let light = self.tabulated.light(&incidence, &polar_i, &polar_o, y2);
        let half = Half::new(wi, wo);
        let facing = self.facets.facing(&half);
        Geometry { half, facing, light, at_i, at_o, polar_i, polar_o }
    }

    /// f·cos θo of the lobes short of their colour: mirror and blur.
    #[inline(always)]
    fn lobes(&self, geometry: &Geometry) -> [f64; 2] {
        let Geometry { half, facing, light, at_i, at_o, polar_o, .. } = geometry;
        let [interior, rehit] = light.values;
        let scale = self.mirror_factor(*at_i, *at_o, polar_o.cos);
        [rehit + self.facets.reflection(half, *facing) * scale, interior]
    }

    /// Factor of the closed-form reflection.
    #[inline(always)]
    fn mirror_factor(&self, at_i: Place, at_o: Place, cos_o: f64) -> f64 {
        let Some(ends) = &self.mirror_ends else { return at_i.read(&self.mirror_scale) };
        at_i.read(ends) * at_o.read(ends) * cos_o
    }

    #[inline(always)]
    fn shade(&self, colours: &Colours, geometry: &Geometry, lobes: [f64; 2], viewer: Viewer) -> Evaluation {
        let half = Place::of_cos(geometry.half.cos);
        let angles = Angles { incidence: geometry.at_i, exit: geometry.at_o, half };
        self.coloured(colours, angles, geometry.polar_o.cos, lobes, viewer)
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
        let components = self.controls.components;
        let terms = colours.terms(angles, cos_o, viewer);
        let shown = |show: bool, rgb: Channels| if show { colour::three(rgb) } else { [0.0; 3] };
        Evaluation {
            diffuse: shown(components.diffuse, terms.diffuse),
            incoherent: shown(components.incoherent, terms.incoherent),
            mirror: shown(components.mirror, terms.lobe.map(|factor| factor * mirror)),
            blur: shown(components.blur, terms.lobe.map(|factor| factor * blur)),
        }
    }

    #[inline(always)]
    fn density(&self, geometry: &Geometry) -> f64 {
        let Geometry { at_i, polar_i, polar_o, half, facing, light, .. } = geometry;
        let facets = self.facets.pdf(polar_i, half, *facing);
        density_of(&self.chances(*at_i), polar_o.cos, light.densities, facets)
    }

    #[inline(always)]
    fn chances(&self, at_i: Place) -> [f64; 4] {
        at_i.read4(&self.chances).map(f64::from)
    }
}

impl Dispersed {
    /// The pearl of each further band of a table; `None` for a table of one wavelength.
    fn of(table: &Table, controls: Controls) -> Result<Option<Self>, BsdfError> {
        let Some(section) = Dispersion::of(&table.meta)? else { return Ok(None) };
        let mut order = vec![(table.meta.wavelength_nm, 0)];
        order.extend(section.bands.iter().map(|band| band.wavelength_nm).zip(1..));
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let further = table.further_bands()?.into_iter().map(|band| PearlBsdf::from_table(band, controls));
        let further = further.collect::<Result<_, _>>()?;
        let (wavelength_nm, place) = order.into_iter().unzip();
        Ok(Some(Self { wavelength_nm, place, weights: section.rgb_weights, further }))
    }

    /// The pearl of a band; 0 is the table's own.
    fn pearl<'a>(&'a self, own: &'a PearlBsdf, band: usize) -> &'a PearlBsdf {
        if band == 0 { own } else { &self.further[band - 1] }
    }

    /// The four components of linear sRGB, each channel with its shares of the bands.
    fn mixed(&self, own: &PearlBsdf, parts: impl Fn(&PearlBsdf) -> [[f64; 3]; 4]) -> [[f64; 3]; 4] {
        let mut sum = [[0.0; 3]; 4];
        for (band, weight) in self.weights.iter().enumerate() {
            add_weighted(&mut sum, weight, &parts(self.pearl(own, band)));
        }
        sum
    }
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

/// A spectrum known at nodes, read linearly between them and constant beyond the ends.
pub(crate) fn at_wavelength(nodes: &[f64], values: &[f64], nm: f64) -> f64 {
    let (lo, hi, share) = around_wavelength(nodes, nm);
    values[lo] + share * (values[hi] - values[lo])
}

/// Whether a vector is a direction, and above the horizon. Rounding may have left its length; a tenth off is a mistake.
#[inline(always)]
fn above_horizon([x, y, z]: Direction) -> bool {
    // False for NaN and infinities.
    z > 0.0 && (0.81..1.21).contains(&(x * x + y * y + z * z))
}

/// The direction of an exit; its φ counts from the mirror direction of wi, whose own azimuth is given.
#[inline(always)]
fn direction((along, across): (f64, f64), exit: &Exit) -> Direction {
    let Exit { cos, sin, azimuth: (cos_phi, sin_phi) } = *exit;
    [sin * (-cos_phi * along - sin_phi * across), sin * (-cos_phi * across + sin_phi * along), cos]
}

#[inline(always)]
fn cosine_hemisphere(u: f64, v: f64) -> Exit {
    Exit { cos: (1.0 - u).sqrt(), sin: u.sqrt(), azimuth: turned(v) }
}

/// Density of all techniques together.
#[inline(always)]
fn density_of(chances: &[f64; 4], cos_o: f64, lobes: [f64; 2], facets: f64) -> f64 {
    chances[BASE] * cos_o * FRAC_1_PI
        + (chances[INTERIOR] * lobes[INTERIOR] + chances[REHIT] * lobes[REHIT])
        + chances[SURFACE] * facets
}

/// The part that u falls on, and what is left of the random number; of no chances at all, [`BASE`].
#[inline(always)]
fn choose(chances: &[f64; 4], u: f64) -> (usize, f64) {
    // Sums and no branches, which random numbers would mispredict. A part of no chance begins where the next one does.
    let from_rehit = chances[0];
    let from_surface = from_rehit + chances[1];
    let from_base = from_surface + chances[2];
    let at = u * (from_base + chances[3]);
    let (part, from, chance) = (INTERIOR, 0.0, chances[0]);
    let (part, from, chance) =
        if at >= from_rehit { (REHIT, from_rehit, chances[1]) } else { (part, from, chance) };
    let (part, from, chance) =
        if at >= from_surface { (SURFACE, from_surface, chances[2]) } else { (part, from, chance) };
    let (part, from, chance) =
        if at >= from_base { (BASE, from_base, chances[3]) } else { (part, from, chance) };
    (part, least((at - from) / chance, 1.0 - f64::EPSILON))
}

/// Where the light of the lobes has its half-vector angles, at an incidence that is a node of [`curve`].
fn tally_half_angles(
    facets: &Facets,
    rules: &Rules,
    tabulated: &Tabulated,
    mirror_ends: Option<&[f64; NODES]>,
    node: usize,
) -> [Box<[f64; NODES]>; 3] {
    // At 90° no light arrives; its limit is what counts.
    let theta_i = curve::theta_at(node).min(FRAC_PI_2 - 1e-6);
    let empty = || Box::new([0.0; NODES]);
    let (mut interior, mut surface, mut rehit) = (empty(), empty(), empty());
    facets.integrate_exits(rules, theta_i.cos(), |mass, cos, cos_o| {
        let seen = mirror_ends.map_or(1.0, |ends| Place::of_cos(cos_o).read(ends) * cos_o);
        Place::of_cos(cos).deposit(mass * seen, &mut surface);
    });
    tabulated_light(tabulated, theta_i, COARSE, |cos, [a, b]| {
        Place::of_cos(cos).deposit(a, &mut interior);
        Place::of_cos(cos).deposit(b, &mut rehit);
    });
    let mut tallies = [interior, surface, rehit];
    for tally in &mut tallies {
        let total: f64 = tally.iter().sum();
        if total > 0.0 {
            tally.iter_mut().for_each(|mass| *mass /= total);
        }
    }
    tallies
}

/// Fewest Gauss–Legendre points on every smooth piece of an integral over the tabulated lobes, in θo and in φ.
#[derive(Clone, Copy)]
struct Points {
    exit: usize,
    azimuth: usize,
}

/// For the shape of a distribution.
const COARSE: Points = Points { exit: 1, azimuth: 1 };
/// For its mass.
const FINE: Points = Points { exit: 3, azimuth: 2 };
/// A point for so much of a piece, radians, and the most points a piece: within a long one θd runs through waves of the
/// interference, of which one point in all missed 2e-4 of the light.
const REACH: f64 = PI / 180.0;
const MOST_POINTS: usize = 4;

/// Hands out the light of the tabulated lobes piece by piece: cos θd and the masses of interior and rehit.
fn tabulated_light(
    tabulated: &Tabulated,
    theta_i: f64,
    points: Points,
    mut visit: impl FnMut(f64, [f64; 2]),
) {
    let i = Polar::at(theta_i);
    let (sin_i, cos_i) = (i.sin, i.cos);
    let incidence = tabulated.incidence(&i);
    let axis = tabulated.axis();
    let rules: Vec<_> = (1..=MOST_POINTS).map(gauss_legendre).collect();
    // |s| covers the plane's cells of both signs with one set of exits.
    let mut exits = kinks(&axis.columns_at(theta_i));
    exits.iter_mut().for_each(|s| *s = s.abs());
    exits.push(0.0);
    let walked = axis.phi_at(theta_i).map(|phi| rule_between(kinks(&phi), &rules, points.azimuth));
    for (theta_o, weight_o) in rule_between(exits, &rules, points.exit) {
        let o = Polar::at(theta_o);
        let (sin_o, cos_o) = (o.sin, o.cos);
        let decayed = walked.is_none().then(|| {
            let width = tabulated.decay_width(&incidence, sin_o);
            let around = Stretched { lo: 0.0, centre: 0.0, hi: PI, width, cells: 14 };
            rule_between(kinks(&around), &rules, points.azimuth)
        });
        for &(phi, weight_phi) in walked.iter().chain(&decayed).flatten() {
            let y2 = (0.5 * phi).sin().powi(2);
            let light = tabulated.light(&incidence, &i, &o, y2).values;
            // Both sides of the plane of incidence.
            let weight = 2.0 * weight_o * weight_phi * sin_o;
            // wi·wo = cos θi cos θo − sin θi sin θo cos φ.
            let dot = cos_i * cos_o - sin_i * sin_o * (1.0 - 2.0 * y2);
            visit((0.5 * (1.0 + dot)).max(0.0).sqrt(), light.map(|l| l * weight));
        }
    }
}

/// Edges and centres of the cells: what is read between them is smooth.
fn kinks(axis: &Stretched) -> Vec<f64> {
    (0..=2 * axis.cells).map(|half| axis.at(0.5 * half as f64)).collect()
}

/// Coordinates with weights: a Gauss–Legendre rule between every two of the nodes.
fn rule_between(mut nodes: Vec<f64>, rules: &[Vec<(f64, f64)>], least: usize) -> Vec<(f64, f64)> {
    nodes.sort_by(f64::total_cmp);
    let pieces = nodes.windows(2).flat_map(|ends| {
        let (middle, half) = (0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0]));
        let points = ((2.0 * half / REACH).ceil() as usize).clamp(least, MOST_POINTS);
        rules[points - 1].iter().map(move |(x, w)| (middle + half * x, half * w))
    });
    pieces.filter(|(_, weight)| *weight > 0.0).collect()
}

fn mirror_scale(lobe: &Interpolant, facets: &Facets, rules: &Rules) -> Box<[f64; NODES]> {
    let mut scale = Box::new([0.0; NODES]);
    for (node, scale) in scale.iter_mut().enumerate() {
        let mut integral = 0.0;
        facets.integrate(rules, curve::cos_at(node), |mass, _| integral += mass);
        if integral > 0.0 {
            *scale = colour::single_reflection_share(lobe, curve::theta_at(node)) / integral;
        }
    }
    scale
}

/// The curve r for which r(θi)·r(θo)·cos θo·[`Facets::reflection`] has the single reflection's share at every θi: the closed form
/// made reciprocal (symmetric scaling, as in [`lut_io::reciprocal`]).
fn mirror_ends(lobe: &Interpolant, facets: &Facets, rules: &Rules) -> Box<[f64; NODES]> {
    const ROUNDS: usize = 200;
    const SCALED: f64 = 1e-9;
    let pieces: Vec<Vec<(f64, Place)>> = (0..NODES)
        .map(|node| {
            let mut pieces = Vec::new();
            facets.integrate_exits(rules, curve::cos_at(node), |mass, _, cos_o| {
                if mass > 0.0 && cos_o > 0.0 {
                    pieces.push((mass * cos_o, Place::of_cos(cos_o)));
                }
            });
            pieces
        })
        .collect();
    let share: Vec<f64> =
        (0..NODES).map(|node| colour::single_reflection_share(lobe, curve::theta_at(node))).collect();
    let mut ends = Box::new([1.0; NODES]);
    for _ in 0..ROUNDS {
        let mut worst = 0f64;
        let factor: Vec<f64> = pieces
            .iter()
            .zip(&share)
            .enumerate()
            .map(|(node, (pieces, share))| {
                let light: f64 =
                    pieces.iter().map(|(mass, at)| mass * at.read(&ends)).sum::<f64>() * ends[node];
                if light <= 0.0 || *share <= 0.0 {
                    return 0.0;
                }
                worst = worst.max((share / light - 1.0).abs());
                (share / light).sqrt()
            })
            .collect();
        ends.iter_mut().zip(factor).for_each(|(end, factor)| *end *= factor);
        if worst < SCALED {
            break;
        }
    }
    ends
}

/// Probabilities of the four techniques: the albedos of what is shown.
fn chances(rgb: &Colours, controls: &Controls) -> Quads {
    let Components { diffuse, incoherent, mirror, blur } = controls.components;
    curve::quads(|node| {
        let [a_interior, a_rehit, a_surface, a_diffuse, a_incoherent] = rgb.mean_albedos(node);
        let shown = |show: bool, albedo: f64| if show { albedo } else { 0.0 };
        let chance = [
            shown(blur, a_interior),
            shown(mirror, a_rehit),
            shown(mirror, a_surface),
            shown(diffuse, a_diffuse) + shown(incoherent, a_incoherent),
        ];
        let total: f64 = chance.iter().sum();
        if total > 0.0 { chance.map(|c| c / total) } else { chance }
    })
}
