//! Interference colours of a recipe for rendering: which stack, angles and wavelengths M(λ, θ) and Ê(λ, θ) take
//! ([`thinfilm::modulation`] computes them), each only where it is [`Wanted`].
//!
//! Values are means over bands of 5 nm from 380 to 780 nm of as many wavelengths as the work allows, so that fringes
//! (0.84 nm wide for 500 layers) do not alias; RGB is summed over the single wavelengths. A stack with irregular
//! thicknesses is the mean over an ensemble drawn from a fixed seed.
//!
//! R_incoherent is what the walk tends to for σ → 0 at its wavelength. So lobe·M never reflects more than it receives, and for
//! σ → 0 it is R_coherent.

use crate::effects::{Effect, EffectSet};
use crate::prices;
use crate::recipe::{Recipe, RecipeError};
use lut_io::spectra::{Coherent, Emission, Missing, Spectra};
use rayon::prelude::*;
use thinfilm::emission::SourceProfile;
use thinfilm::modulation::{self, Banded, Sampling};
use thinfilm::{Dispersion, Material, Stack, StackError, StackRun, colour, intensity};
use transport::{Light, Transport};

/// Bands over the visible range of [`colour::VISIBLE`]: 5 nm each.
const BANDS: usize = 80;
/// Steps between angles, degrees: the stop bands of a regular stack move by up to 3 nm a degree.
const FINE_STEP_DEG: usize = 1;
/// Ê, and M of irregular stacks, are smoother.
const STEP_DEG: usize = 3;
/// Stands in for 90°, where no power arrives and radiance has no meaning.
const GRAZING_DEG: f64 = 89.9;
/// Most wavelengths a band: 0.25 nm resolve fringes of 0.84 nm; finer ones (thicker stacks) are sampled at these points.
const FINEST: f64 = 20.0;
/// Layers × wavelengths × angles × polarisations × members that one quantity may have: what a forecast prices are the waves that this
/// comes to.
const REFLECTANCE_WORK: f64 = 3e9;
const IRREGULAR_WORK: f64 = 5e7;
const FIELD_WORK: f64 = 7e8;
const SLOW_FIELD_WORK: f64 = 2e7;
/// Members of an ensemble of irregular stacks: at least, and as many as bring the hue to ΔE00 ≈ 0.5.
const FEWEST_MEMBERS: f64 = 2.0;
const MEMBERS: f64 = 64.0;
/// Wavelengths a band that come before more members.
const FIRST_PER_BAND: f64 = 2.0;
/// What a wave costs beside its layers, in layers.
const OVERHEAD: usize = 300;
/// Deepest part of a stack, in layers, that waves are followed in one layer at a time.
const DEEPEST: usize = 16_384;
/// Names the ensemble.
const SEED: u64 = 0x70_6561_726c;

/// Why a recipe has no colours.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SpectraError {
    /// The recipe itself.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// The stack, or a wave in it.
    #[error("interference colours: {0}")]
    Stack(#[from] StackError),
    /// An effect that was listed by name.
    #[error("effects: {effect} cannot be had: {source}")]
    Required {
        /// The effect.
        effect: Effect,
        /// Why it cannot be had.
        source: Box<SpectraError>,
    },
}

/// How much an interference colour is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Want {
    /// Not at all: it costs nothing.
    #[default]
    No,
    /// By the recipe's look; a stack whose waves cannot be followed bakes without it, and the table says why.
    IfPossible,
    /// By name: a stack whose waves cannot be followed is an error.
    Required,
}

/// Which interference colours a bake is to compute, and of what stack.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// M(λ, θ), effect `coherent`.
    pub coherent: Want,
    /// Ê(λ, θ), effect `emission`.
    pub emission: Want,
    /// Whether thicknesses vary (effect `irregularity`); without, every layer has its mean thickness.
    pub irregularity: bool,
    /// Whether layers absorb (effect `absorption`).
    pub absorption: bool,
    /// Whether the lobe's walk tracks s and p (effect `polarisation`), which changes what it reflects.
    pub polarisation: bool,
    /// Whether the lobe's walk meets coherent sheets (effect `coherent_sheets`).
    pub coherent_sheets: bool,
}

impl Wanted {
    /// What a set of effects calls for; effects that were listed by name are [`Want::Required`].
    #[must_use]
    pub const fn by_effects(effects: EffectSet, listed: bool) -> Self {
        const fn want(is_on: bool, listed: bool) -> Want {
            match (is_on, listed) {
                (false, _) => Want::No,
                (true, false) => Want::IfPossible,
                (true, true) => Want::Required,
            }
        }
        Self {
            coherent: want(effects.contains(Effect::Coherent), listed),
            emission: want(effects.contains(Effect::Emission), listed),
            irregularity: effects.contains(Effect::Irregularity),
            absorption: effects.contains(Effect::Absorption),
            polarisation: effects.contains(Effect::Polarisation),
            coherent_sheets: effects.contains(Effect::CoherentSheets),
        }
    }
}

/// The interference colours of a recipe, and which of those wanted it cannot have.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Colours {
    /// The section for the table.
    pub spectra: Spectra,
    /// Effects that are missing, with the reason.
    pub missing: Vec<(Effect, String)>,
}

impl Colours {
    /// The effects that are there.
    #[must_use]
    pub fn effects(&self) -> EffectSet {
        let coherent = self.spectra.coherent.as_ref().map(|_| Effect::Coherent);
        coherent.into_iter().chain(self.spectra.emission.as_ref().map(|_| Effect::Emission)).collect()
    }

    /// The section of the table that holds them, if there are any.
    pub(crate) fn section(&self) -> Option<Spectra> {
        (self.effects() != EffectSet::NONE).then(|| self.spectra.rounded())
    }

    /// The section of the table that says why some are missing, if any are.
    pub(crate) fn missing_section(&self) -> Option<Missing> {
        let why =
            |effect| self.missing.iter().find(|(missing, _)| *missing == effect).map(|(_, why)| why.clone());
        let missing = Missing { coherent: why(Effect::Coherent), emission: why(Effect::Emission) };
        (!self.missing.is_empty()).then_some(missing)
    }
}

/// The colours of a recipe that are wanted: a fraction of a second for a regular stack, seconds for an irregular one.
///
/// # Errors
/// A recipe that the transport problem refuses; a [`Want::Required`] colour of a stack whose waves cannot be followed.
pub fn of(recipe: &Recipe, wanted: Wanted) -> Result<Colours, SpectraError> {
    let mut colours = Colours {
        spectra: Spectra { wavelength_nm: band_centres_nm(), ..Spectra::default() },
        missing: Vec::new(),
    };
    let mut attempt = |effect, want, compute: &dyn Fn() -> Result<_, SpectraError>| {
        if want == Want::No {
            return Ok(None);
        }
        match compute() {
            Ok(part) => Ok(Some(part)),
            Err(SpectraError::Stack(why)) if want == Want::IfPossible => {
                colours.missing.push((effect, why.to_string()));
                Ok(None)
            }
            Err(why) => Err(SpectraError::Required { effect, source: Box::new(why) }),
        }
    };
    let coherent =
        attempt(Effect::Coherent, wanted.coherent, &|| coherent(recipe, wanted).map(Part::Coherent))?;
    let emission =
        attempt(Effect::Emission, wanted.emission, &|| emission(recipe, wanted).map(Part::Emission))?;
    for part in coherent.into_iter().chain(emission) {
        match part {
            Part::Coherent(part) => colours.spectra.coherent = Some(part),
            Part::Emission(part) => colours.spectra.emission = Some(part),
        }
    }
    Ok(colours)
}

enum Part {
    Coherent(Coherent),
    Emission(Emission),
}

/// The walk at a wavelength (metres) whose lobe the coherent colours multiply.
fn walked(recipe: &Recipe, wanted: Wanted, wavelength: f64) -> Result<Transport, RecipeError> {
    let mut transport = if wanted.coherent_sheets {
        recipe.sheet_transport(wavelength)
    } else {
        recipe.transport(wavelength)
    }?;
    if !wanted.absorption {
        transport.optical_depths.fill(0.0);
    }
    if wanted.polarisation {
        transport.light = Light::Tracked;
    }
    Ok(transport)
}

/// R_incoherent of the walk at a wavelength (nm), at the angles that colours are stored for.
pub(crate) fn incoherent(
    recipe: &Recipe,
    wanted: Wanted,
    nm: f64,
    theta_deg: &[f64],
) -> Result<Vec<f64>, RecipeError> {
    let transport = walked(recipe, wanted, 1e-9 * nm)?;
    Ok(radians(theta_deg).iter().map(|theta| incoherent_reflectance(&transport, *theta)).collect())
}

fn coherent(recipe: &Recipe, wanted: Wanted) -> Result<Coherent, SpectraError> {
    let transport = walked(recipe, wanted, recipe.wavelength())?;
    let stack = wave_stack(recipe, wanted);
    let (theta_deg, effort) = coherent_effort(&stack);
    let angles = radians(&theta_deg);
    let incoherent: Vec<f64> =
        angles.par_iter().map(|theta| incoherent_reflectance(&transport, *theta)).collect();
    let (modulation, modulation_rgb) =
        columns(modulation::modulation(&stack, &incoherent, &angles, effort.sampling())?);
    Ok(Coherent { theta_deg, modulation, modulation_rgb, incoherent })
}

fn emission(recipe: &Recipe, wanted: Wanted) -> Result<Emission, SpectraError> {
    // Refuses what the bake refuses, with its words.
    recipe.transport(recipe.wavelength())?;
    let stack = emission_stack(recipe, wanted);
    let (theta_deg, effort) = emission_effort(&stack);
    let (radiance, radiance_rgb) = columns(modulation::emission(
        &stack,
        recipe.source_profile(),
        &radians(&theta_deg),
        effort.sampling(),
    )?);
    Ok(Emission { theta_deg, radiance, radiance_rgb })
}

fn columns(rows: Vec<Banded>) -> (Vec<Vec<f64>>, Vec<[f64; 3]>) {
    rows.into_iter().map(|row| (row.bands, row.rgb)).unzip()
}

/// Angles of M, and how finely it is sampled.
fn coherent_effort(stack: &Stack) -> (Vec<f64>, Effort) {
    let irregular = stack.is_irregular();
    let theta_deg = angles_deg(if irregular { STEP_DEG } else { FINE_STEP_DEG });
    // Repeated units of a long stack are doubled.
    let layers = (stack.layer_count() as usize).min(DEEPEST);
    let work = if irregular { IRREGULAR_WORK } else { REFLECTANCE_WORK };
    let effort = Effort::new(work, layers, theta_deg.len(), irregular);
    (theta_deg, effort)
}

/// Angles of Ê, and how finely it is sampled.
fn emission_effort(stack: &Stack) -> (Vec<f64>, Effort) {
    let irregular = stack.is_irregular();
    let theta_deg = angles_deg(STEP_DEG);
    let work = if has_slow_fields(stack) { SLOW_FIELD_WORK } else { FIELD_WORK };
    let layers = (stack.layer_count() as usize).min(DEEPEST);
    let effort = Effort::new(work, layers, theta_deg.len(), irregular);
    (theta_deg, effort)
}

/// Whether fields are followed as if they needed the slow form: in irregular stacks and in those that absorb.
fn has_slow_fields(stack: &Stack) -> bool {
    stack.is_irregular() || absorbs(stack)
}

fn absorbs(stack: &Stack) -> bool {
    stack.materials.iter().any(|material| {
        let in_table = matches!(&material.n, Dispersion::Table(rows) if rows.iter().any(|row| row[2] != 0.0));
        material.k != 0.0 || in_table
    })
}

/// Waves that M and Ê take, and layers that those pass; 0 where a colour is not wanted.
#[must_use]
pub fn counts(recipe: &Recipe, wanted: Wanted) -> [[f64; 2]; 2] {
    let count = |stack: &Stack, effort: &Effort| [effort.waves, effort.waves * stack.layer_count() as f64];
    let stack = wave_stack(recipe, wanted);
    let coherent = || count(&stack, &coherent_effort(&stack).1);
    let emission = || {
        let stack = emission_stack(recipe, wanted);
        count(&stack, &emission_effort(&stack).1)
    };
    [
        if wanted.coherent == Want::No { [0.0; 2] } else { coherent() },
        if wanted.emission == Want::No { [0.0; 2] } else { emission() },
    ]
}

/// Seconds of one core that M and Ê take, each 0 where it is not wanted.
#[must_use]
pub fn forecast(recipe: &Recipe, wanted: Wanted) -> [f64; 2] {
    let stack = wave_stack(recipe, wanted);
    let absorbs = absorbs(&stack);
    let repeats = !stack.is_irregular() && stack.runs.iter().any(|run| run.repeat > 1);
    let deep = stack.layer_count() > DEEPEST as u128;
    let wave = if deep { prices::DOUBLED } else { prices::reflectance(repeats, absorbs) };
    let is_below = recipe.source_profile() == SourceProfile::Substrate;
    let field = if is_below { wave } else { prices::field(absorbs) };
    let [coherent, emission] = counts(recipe, wanted);
    [prices::sum(&coherent, &wave), prices::sum(&emission, &field)]
}

/// How finely a quantity is sampled.
struct Effort {
    /// Wavelengths a band.
    per_band: usize,
    /// Members of an ensemble.
    members: u64,
    /// Wavelengths × angles × polarisations × members.
    waves: f64,
}

impl Effort {
    fn new(work: f64, layers: usize, angles: usize, irregular: bool) -> Self {
        // Both polarisations.
        let a_wavelength_a_band = (2 * BANDS * (layers + OVERHEAD) * angles) as f64;
        let affordable = work / a_wavelength_a_band;
        let members = if irregular {
            (affordable / FIRST_PER_BAND).clamp(FEWEST_MEMBERS, MEMBERS).floor()
        } else {
            1.0
        };
        let per_band = (affordable / members).clamp(1.0, FINEST);
        let per_band = per_band.floor();
        Self {
            per_band: per_band as usize,
            members: members as u64,
            waves: (2 * BANDS * angles) as f64 * per_band * members,
        }
    }

    const fn sampling(&self) -> Sampling {
        Sampling { bands: BANDS, per_band: self.per_band, members: self.members, seed: SEED }
    }
}

fn angles_deg(step: usize) -> Vec<f64> {
    (0..=90).step_by(step).map(|degrees| degrees as f64).collect()
}

fn radians(theta_deg: &[f64]) -> Vec<f64> {
    theta_deg.iter().map(|degrees| degrees.min(GRAZING_DEG).to_radians()).collect()
}

fn band_centres_nm() -> Vec<f64> {
    let edge = |band: f64| {
        1e9 * (colour::VISIBLE[0] + (colour::VISIBLE[1] - colour::VISIBLE[0]) * band / BANDS as f64)
    };
    (0..BANDS).map(|band| edge(band as f64 + 0.5)).collect()
}

/// The recipe's stack for waves over the visible range: a tabulated index stays constant beyond its table, and of an
/// irregular or explicit stack only the uppermost layers are followed.
fn wave_stack(recipe: &Recipe, wanted: Wanted) -> Stack {
    let mut stack = recipe.film_stack();
    if !wanted.absorption {
        stack.materials.iter_mut().for_each(make_clear);
    }
    if !wanted.irregularity {
        stack.runs.iter_mut().flat_map(|run| &mut run.unit).for_each(|layer| layer.thickness_sd = 0.0);
    }
    let media = stack.materials.iter_mut().chain([&mut stack.ambient, &mut stack.substrate]);
    media.for_each(hold_constant);
    let periodic = stack.runs.iter().any(|run| run.repeat > 1);
    if stack.is_irregular() || !periodic { shortened(stack, DEEPEST) } else { stack }
}

/// Fields are followed through the uppermost layers only; light from below the stack needs none.
fn emission_stack(recipe: &Recipe, wanted: Wanted) -> Stack {
    let stack = wave_stack(recipe, wanted);
    if recipe.source_profile() == SourceProfile::Substrate { stack } else { shortened(stack, DEEPEST) }
}

fn make_clear(material: &mut Material) {
    material.k = 0.0;
    if let Dispersion::Table(rows) = &mut material.n {
        rows.iter_mut().for_each(|row| row[2] = 0.0);
    }
}

/// Extends a tabulated index to the visible range.
fn hold_constant(material: &mut Material) {
    let Dispersion::Table(rows) = &mut material.n else { return };
    let [first_nm, last_nm] = colour::VISIBLE.map(|metres| metres * 1e9);
    if let Some(&[nm, n, k]) = rows.first()
        && nm > first_nm
    {
        rows.insert(0, [first_nm, n, k]);
    }
    if let Some(&[nm, n, k]) = rows.last()
        && nm < last_nm
    {
        rows.push([last_nm, n, k]);
    }
}

/// The uppermost `most` layers of a stack, or a few less to end with a whole period.
fn shortened(mut stack: Stack, most: usize) -> Stack {
    let mut room = most;
    let cut = |run: StackRun| {
        let length = run.unit.len();
        let repeat = run.repeat.min((room / length.max(1)) as u64);
        let unit = if repeat == 0 { run.unit[..room.min(length)].to_vec() } else { run.unit };
        let repeat = repeat.max(1);
        room -= unit.len() * repeat as usize;
        StackRun { unit, repeat }
    };
    stack.runs = stack.runs.into_iter().map(cut).filter(|run| !run.unit.is_empty()).collect();
    stack
}

/// R_incoherent: the walk with flat interfaces, in the walk's light and at its sheets.
pub(crate) fn incoherent_reflectance(transport: &Transport, theta: f64) -> f64 {
    let Transport { indices, optical_depths, sheets, .. } = transport;
    let sheet = |interface: usize, cosine: f64| {
        let sheets = sheets.filter(|sheets| (1..=sheets.last).contains(&interface))?;
        Some(sheets.reflectance(indices[interface], cosine))
    };
    let of =
        |share_of_s| intensity::incoherent(indices, optical_depths, theta, share_of_s, sheet).reflectance;
    let reflectance = match transport.light {
        Light::Unpolarised => of(0.5),
        Light::Tracked => 0.5 * (of(1.0) + of(0.0)),
        Light::S => of(1.0),
        Light::P => of(0.0),
    };
    // A stack that matches the ambient reflects nothing coherently either; the floor keeps the quotient finite.
    reflectance.max(1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::{self, Observer, Request};
    use crate::options::{Options, Target};

    const BOTH: Wanted = Wanted {
        coherent: Want::Required,
        emission: Want::Required,
        irregularity: true,
        absorption: true,
        polarisation: false,
        coherent_sheets: false,
    };

    fn recipe(text: &str) -> Recipe {
        Recipe::from_json(text).unwrap()
    }

    fn both(text: &str) -> (Coherent, Emission) {
        let spectra = of(&recipe(text), BOTH).unwrap().spectra;
        spectra.validate().unwrap();
        (spectra.coherent.unwrap(), spectra.emission.unwrap())
    }

    #[test]
    fn the_papers_incoherent_reflectance_is_the_albedo_of_its_flat_walk() {
        // Two-stream sum of 500 inner interfaces of reflectance ((1.53 − 1.43)/(1.53 + 1.43))² under one of 1.53.
        let r = (0.1f64 / 2.96).powi(2);
        let inner = 500.0 * r / (1.0 + 499.0 * r);
        let outer = (0.53f64 / 2.53).powi(2);
        let expected = outer + (1.0 - outer).powi(2) * inner / (1.0 - outer * inner);
        let found = incoherent_reflectance(&Transport::paper(), 0.0);
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn a_short_regular_stack_has_valid_colours_bounded_by_its_energy() {
        let (coherent, emission) = both(r#"{"stack": {"layers": 7}}"#);
        for (i, row) in coherent.modulation.iter().enumerate() {
            let most = 1.0 / coherent.incoherent[i];
            assert!(row.iter().chain(&coherent.modulation_rgb[i]).all(|m| *m <= most + 1e-12));
        }
        for row in &emission.radiance {
            let mean = row.iter().sum::<f64>() / BANDS as f64;
            assert!((mean - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_band_is_the_mean_reflectance_of_the_stack_in_it() {
        // One film, solved wave by wave with the general solver, far more finely than a band.
        let recipe = recipe(r#"{"stack": {"layers": 3}}"#);
        let (coherent, _) = both(r#"{"stack": {"layers": 3}}"#);
        let (band, degrees) = (33, 40);
        let waves = 500;
        let mean: f64 = (0..waves)
            .map(|i| {
                let nm = 380.0 + 5.0 * (band as f64 + (f64::from(i) + 0.5) / f64::from(waves));
                let stack = recipe.film_stack().at(nm * 1e-9).unwrap();
                let angle = thinfilm::Incidence::Angle((degrees as f64).to_radians());
                let r = |pol| stack.solve(nm * 1e-9, angle, pol).unwrap().reflectance;
                thinfilm::Polarisation::BOTH.map(r).iter().sum::<f64>() / 2.0
            })
            .sum::<f64>()
            / f64::from(waves);
        let found = coherent.modulation[degrees][band] * coherent.incoherent[degrees];
        assert!((found - mean).abs() < 1e-5 * mean, "{found} {mean}");
    }

    #[test]
    fn a_stack_of_one_index_has_no_hue_but_that_of_its_surface() {
        // One thick layer of the substrate's own material: a single interface, coherent = incoherent.
        let (coherent, emission) =
            both(r#"{"stack": {"explicit": [{"n": 1.5, "thickness_nm": 1000}], "substrate": {"n": 1.5}}}"#);
        for row in &coherent.modulation[..coherent.modulation.len() - 1] {
            assert!(row.iter().all(|m| (m - 1.0).abs() < 1e-9), "{row:?}");
        }
        for rgb in emission.radiance_rgb {
            assert!(rgb.iter().all(|c| (c - 1.0).abs() < 1e-6), "{rgb:?}");
        }
    }

    #[test]
    fn the_incoherent_reflectance_is_that_of_the_walk_that_is_baked() {
        let smooth = recipe(r#"{"stack":{"layers":60},"facets":{"slope_sd_deg":0}}"#);
        let effects = [Effect::Surface, Effect::Blur, Effect::Azimuth];
        for extra in [vec![], vec![Effect::Polarisation], vec![Effect::CoherentSheets, Effect::Polarisation]]
        {
            let set: EffectSet = effects.into_iter().chain(extra).collect();
            let options = Options {
                incident_deg: Some(vec![60.0]),
                target: Target::Paths(200_000),
                seed: 2,
                event_cap: 1_000_000,
                ..Options::default()
            };
            let request = Request::of(smooth.clone(), set, options).unwrap();
            let table = bake::walk(&request, &request.bands().unwrap(), &Observer::idle(), None).unwrap();
            let walk = walked(&smooth, Wanted::by_effects(set, false), smooth.wavelength()).unwrap();
            let expected = incoherent_reflectance(&walk, 60_f64.to_radians());
            // Five standard errors of 200,000 paths.
            let error = (expected * (1.0 - expected) / 200_000.0).sqrt();
            let found = table.meta().per_incidence[0].albedo;
            assert!((found - expected).abs() < 5.0 * error, "{set:?}: {found} {expected}");
        }
    }

    #[test]
    fn a_tabulated_index_that_ends_inside_the_visible_is_held_constant() {
        let table = |rows: &str| {
            format!(r#"{{"stack": {{"explicit": [{{"n": {{"table": {rows}}}, "thickness_nm": 300}}]}}}}"#)
        };
        let (short, _) = both(&table("[[540, 1.5, 0], [560, 1.6, 0]]"));
        let (long, _) = both(&table("[[300, 1.5, 0], [540, 1.5, 0], [560, 1.6, 0], [800, 1.6, 0]]"));
        assert_eq!(short, long);
    }

    #[test]
    fn irregular_stacks_are_reproducible_on_any_number_of_threads() {
        let irregular = recipe(r#"{"stack": {"layers": 6, "aragonite": {"thickness_sd_nm": 20}}}"#);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| of(&irregular, BOTH).unwrap())
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn only_what_is_wanted_is_there() {
        let recipe = recipe(r#"{"stack": {"layers": 4}, "look": {"depth": 0, "coherence": 0.3}}"#);
        let held = |effects: &[Effect]| {
            let wanted = Wanted::by_effects(effects.iter().copied().collect(), false);
            of(&recipe, wanted).unwrap().effects().iter().collect::<Vec<_>>()
        };
        assert_eq!(held(&[Effect::Coherent, Effect::Blur]), [Effect::Coherent]);
        assert_eq!(held(&[Effect::Emission]), [Effect::Emission]);
        assert_eq!(held(&[Effect::Surface, Effect::Irregularity]), []);
    }

    #[test]
    fn absorption_and_irregularity_change_the_colours_only_where_they_are_wanted() {
        let plain = both(r#"{"stack": {"layers": 4}}"#);
        let text = r#"{"stack": {"layers": 4, "aragonite": {"k": 0.01, "thickness_sd_nm": 30}}}"#;
        let of_text = |wanted| {
            let spectra = of(&recipe(text), wanted).unwrap().spectra;
            (spectra.coherent.unwrap(), spectra.emission.unwrap())
        };
        assert_eq!(of_text(Wanted { irregularity: false, absorption: false, ..BOTH }), plain);
        let absorbing = of_text(Wanted { irregularity: false, ..BOTH });
        let irregular = of_text(Wanted { absorption: false, ..BOTH });
        for (coherent, emission) in [absorbing, irregular] {
            assert_ne!(coherent.modulation[0], plain.0.modulation[0]);
            assert_ne!(emission.radiance, plain.1.radiance);
        }
    }

    #[test]
    fn a_stack_without_an_index_somewhere_bakes_without_colour_unless_it_was_listed_by_name() {
        // n = 3.153 − 0.5 µm²/λ² is 1.5 at 550 nm, where the walk is, and negative at 380 nm.
        let violet = recipe(
            r#"{"stack": {"layers": 4, "aragonite": {"n": {"cauchy": [3.153, -0.5]}, "thickness_nm": 450}}}"#,
        );
        let effects: EffectSet = [Effect::Coherent, Effect::Emission].into_iter().collect();
        let colours = of(&violet, Wanted::by_effects(effects, false)).unwrap();
        assert_eq!(colours.effects(), EffectSet::NONE);
        assert_eq!(colours.missing.len(), 2);
        assert!(colours.missing[0].1.contains("n = -0."), "{:?}", colours.missing);
        let error = of(&violet, Wanted::by_effects(effects, true)).unwrap_err().to_string();
        assert!(error.starts_with("effects: coherent cannot be had: ") && !error.contains('\n'), "{error}");
    }

    #[test]
    fn colours_of_more_layers_are_predicted_to_take_longer_and_absorbing_ones_longest() {
        // Few enough layers that neither members nor wavelengths are spared.
        let stack = |layers: u32, k: f64, sd: f64| {
            recipe(&format!(
                r#"{{"stack": {{"layers": {layers}, "aragonite": {{"k": {k}, "thickness_sd_nm": {sd}}}}}}}"#
            ))
        };
        for sd in [0.0, 20.0] {
            let [few, more, absorbing] =
                [(10, 0.0), (40, 0.0), (40, 1e-3)].map(|(layers, k)| forecast(&stack(layers, k, sd), BOTH));
            for colour in 0..2 {
                assert!(0.0 < few[colour] && few[colour] < more[colour], "{sd}: {few:?} {more:?}");
                assert!(more[colour] < absorbing[colour], "{sd}: {more:?} {absorbing:?}");
            }
        }
        // Ê of a clear irregular stack goes through the fast lanes.
        assert!(forecast(&stack(40, 0.0, 20.0), BOTH)[1] < 0.1 * forecast(&stack(40, 1e-3, 20.0), BOTH)[1]);
        assert_eq!(forecast(&stack(40, 0.0, 0.0), Wanted::default()), [0.0; 2]);
    }

    #[test]
    fn the_emission_is_that_of_the_sources_that_the_recipe_names() {
        let of_sources = |sources: &str| {
            both(&format!(r#"{{"stack": {{"layers": 40, "emission_sources": {sources}}}}}"#)).1.radiance
        };
        let [uniform, substrate] = [r#""uniform""#, r#""substrate""#].map(of_sources);
        let deepest = of_sources(r#"{"depth_nm": 1e9}"#);
        for (a, b) in uniform.iter().flatten().zip(deepest.iter().flatten()) {
            // The stack is 1e-5 of that depth.
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
        // Light from below is what the stack lets through: most where it reflects least.
        let (coherent, _) = both(r#"{"stack": {"layers": 40}}"#);
        let of_band =
            |band: usize| (coherent.modulation[30][band] * coherent.incoherent[30], substrate[10][band]);
        for band in 1..BANDS {
            let ((r_0, e_0), (r_1, e_1)) = (of_band(0), of_band(band));
            assert!((e_1 / e_0 - (1.0 - r_1) / (1.0 - r_0)).abs() < 1e-3, "{band}");
        }
    }

    #[test]
    fn a_deep_stack_is_cut_to_the_layers_that_are_followed() {
        let stack = recipe(r#"{"stack": {"layers": 99999}}"#).film_stack();
        assert_eq!(shortened(stack.clone(), 16_384).layer_count(), 16_384);
        assert_eq!(shortened(stack.clone(), 100_000), stack);
        let explicit =
            Stack { runs: vec![StackRun { unit: stack.layers().take(7).collect(), repeat: 1 }], ..stack };
        assert_eq!(shortened(explicit, 5).layer_count(), 5);
    }
}
