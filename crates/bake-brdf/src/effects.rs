//! The effects of the model, and which of them a table is to hold.
//!
//! An [`EffectSet`] is decided once, by the recipe and (where there is one) the scene, and goes with the bake from there:
//! the transport problem that is solved, the kernels that solve it and the parts of the file follow from it.
//! [`Decisions`] is the same with a reason for each effect.

use crate::recipe::{AzimuthMode, Look, Recipe};
use serde::{Deserialize, Serialize};
use std::fmt;
use thinfilm::Dispersion;

/// One effect of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Effect {
    /// Reflection by the outermost interface.
    Surface,
    /// Light that entered the stack and came back.
    Blur,
    /// How that light leaves the plane of incidence: by decay or by the space walk.
    Azimuth,
    /// s and p tracked through the walk, in place of unpolarised light at every event.
    Polarisation,
    /// Absorption in the layers.
    Absorption,
    /// Indices that differ over the bands: a lobe per band.
    Dispersion,
    /// Coherent interference colour of the lobes.
    Coherent,
    /// Each conchiolin sheet one scatterer with its coherent film reflectance, inside the walk.
    CoherentSheets,
    /// Incoherent interference: light scattered in the stack, coloured by the viewing angle.
    Emission,
    /// Thicknesses that differ from layer to layer.
    Irregularity,
    /// Diffuse light of the body under the nacre.
    Body,
    /// Textures, bumps and normals on the surface.
    Texture,
    /// Interference colours over a range of scales of all thicknesses, so that thickness is a control.
    Thickness,
}

impl Effect {
    /// Every effect, in the model's order.
    pub const ALL: [Self; 13] = [
        Self::Surface,
        Self::Blur,
        Self::Azimuth,
        Self::Polarisation,
        Self::Absorption,
        Self::Dispersion,
        Self::Coherent,
        Self::CoherentSheets,
        Self::Emission,
        Self::Irregularity,
        Self::Body,
        Self::Texture,
        Self::Thickness,
    ];

    /// The effect's name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Surface => "surface",
            Self::Blur => "blur",
            Self::Azimuth => "azimuth",
            Self::Polarisation => "polarisation",
            Self::Absorption => "absorption",
            Self::Dispersion => "dispersion",
            Self::Coherent => "coherent",
            Self::CoherentSheets => "coherent_sheets",
            Self::Emission => "emission",
            Self::Irregularity => "irregularity",
            Self::Body => "body",
            Self::Texture => "texture",
            Self::Thickness => "thickness",
        }
    }

    /// The effect of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|effect| effect.name() == name)
    }

    const fn bit(self) -> u16 {
        1 << self as u16
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A set of effects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "Vec<Effect>", from = "Vec<Effect>")]
pub struct EffectSet(u16);

impl EffectSet {
    /// Nothing.
    pub const NONE: Self = Self(0);

    /// Whether an effect is in the set.
    #[must_use]
    pub const fn contains(self, effect: Effect) -> bool {
        self.0 & effect.bit() != 0
    }

    /// The set and one effect more.
    #[must_use]
    pub const fn with(self, effect: Effect) -> Self {
        Self(self.0 | effect.bit())
    }

    /// The set without an effect.
    #[must_use]
    pub const fn without(self, effect: Effect) -> Self {
        Self(self.0 & !effect.bit())
    }

    /// Effects that are in either set.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The effects, in the model's order.
    pub fn iter(self) -> impl Iterator<Item = Effect> {
        Effect::ALL.into_iter().filter(move |effect| self.contains(*effect))
    }

    /// What a recipe's own look calls for.
    #[must_use]
    pub fn by_look(recipe: &Recipe) -> Self {
        Decisions::by_view(recipe, &View::of_look(&recipe.look)).set()
    }

    /// The names, in the model's order: the `effects` of a table's metadata.
    #[must_use]
    pub fn names(self) -> Vec<String> {
        self.iter().map(|effect| effect.name().to_owned()).collect()
    }

    /// Whether any light is walked: without a lobe there is no transport problem.
    #[must_use]
    pub const fn has_lobe(self) -> bool {
        self.contains(Effect::Surface) || self.contains(Effect::Blur)
    }
}

impl FromIterator<Effect> for EffectSet {
    fn from_iter<I: IntoIterator<Item = Effect>>(effects: I) -> Self {
        effects.into_iter().fold(Self::NONE, Self::with)
    }
}

impl From<Vec<Effect>> for EffectSet {
    fn from(effects: Vec<Effect>) -> Self {
        effects.into_iter().collect()
    }
}

impl From<EffectSet> for Vec<Effect> {
    fn from(set: EffectSet) -> Self {
        set.iter().collect()
    }
}

/// Why a list of effects cannot be baked; one line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EffectError {
    /// No effect of that name.
    #[error("effects: {0:?} is no effect; expected all alone, or a list of {names}", names = Effect::ALL.map(Effect::name).join(", "))]
    Unknown(String),
    /// An azimuth mode other than decay and space.
    #[error("effects: azimuth:{0} is no azimuth; expected azimuth:decay or azimuth:space")]
    AzimuthMode(String),
    /// An effect that this version does not simulate for this recipe.
    #[error("effects: {effect} is not simulated: {why}")]
    NotSimulated {
        /// The effect.
        effect: Effect,
        /// What stands in the way, and what would do.
        why: String,
    },
}

/// Which effects a table is to hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Effects {
    /// Those that the look, or the scene, calls for.
    #[default]
    Look,
    /// All that the recipe has matter for, whatever the look.
    All,
    /// These, whatever the look; one that this stack cannot have is an error.
    Listed(EffectSet),
}

impl Effects {
    /// Parses `surface,blur,azimuth:space` or `all`; `azimuth` may carry its mode, which is the second value.
    ///
    /// # Errors
    /// A name that is no effect.
    pub fn parse(list: &str) -> Result<(Self, Option<AzimuthMode>), EffectError> {
        if list.trim() == "all" {
            return Ok((Self::All, None));
        }
        let (mut set, mut azimuth) = (EffectSet::NONE, None);
        for item in list.split(',').map(str::trim) {
            let name = match item.split_once(':') {
                Some(("azimuth", mode)) => {
                    let unknown = || EffectError::AzimuthMode(mode.to_owned());
                    azimuth = Some(AzimuthMode::from_name(mode).ok_or_else(unknown)?);
                    "azimuth"
                }
                _ => item,
            };
            set = set.with(Effect::from_name(name).ok_or_else(|| EffectError::Unknown(item.to_owned()))?);
        }
        Ok((Self::Listed(set), azimuth))
    }
}

/// A value and where it was set, for the reasons that a plan gives: `recipe` or `scene.xml:12`.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting<T> {
    /// The value.
    pub value: T,
    /// Where it was set.
    pub from: String,
}

impl<T> Setting<T> {
    /// A value with its source.
    pub fn new(value: T, from: impl Into<String>) -> Self {
        Self { value, from: from.into() }
    }
}

/// What a renderer shows of colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ColourMode {
    /// One channel.
    Mono,
    /// Linear sRGB.
    #[default]
    Rgb,
    /// Wavelengths.
    Spectral,
}

/// Which components of the BSDF are shown (`docs/MODEL.md`, the BSDF). Hiding one leaves the others as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown {
    /// Diffuse light of the body.
    pub diffuse: bool,
    /// Incoherent interference.
    pub incoherent: bool,
    /// Reflection by the outermost interface.
    pub mirror: bool,
    /// Light that came back from the interior.
    pub blur: bool,
}

impl Shown {
    /// Everything.
    pub const ALL: Self = Self { diffuse: true, incoherent: true, mirror: true, blur: true };

    const fn base(self) -> bool {
        self.diffuse || self.incoherent
    }
}

/// How a pearl is looked at: what decides, beside its recipe, which effects can be seen.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Share of incoherent interference in the base.
    pub depth: Setting<f64>,
    /// Strength of the lobes.
    pub brightness: Setting<f64>,
    /// Degree of coherence.
    pub coherence: Setting<f64>,
    /// Body colour; `None` where a texture gives it.
    pub body: Setting<Option<[f64; 3]>>,
    /// Components shown.
    pub shown: Setting<Shown>,
    /// Colour and polarisation of the renderer's variant.
    pub colour: Setting<ColourMode>,
    /// Whether the renderer tracks polarisation.
    pub polarised: Setting<bool>,
    /// A texture, bump or normal map, named with its place; `None` for a plain surface.
    pub texture: Option<Setting<String>>,
    /// What asks for other thicknesses than the recipe's, named with its place; `None` where nothing does.
    pub thickness: Option<Setting<String>>,
}

impl View {
    /// The recipe's own look in an RGB renderer.
    #[must_use]
    pub fn of_look(look: &Look) -> Self {
        let recipe = || "recipe".to_owned();
        let texture = (look.grain > 0.0).then(|| Setting::new(format!("grain {}", look.grain), recipe()));
        let thickness = look
            .thickness
            .map(|range| Setting::new(format!("thickness from {} to {}", range.min, range.max), recipe()));
        Self {
            depth: Setting::new(look.depth, recipe()),
            brightness: Setting::new(look.brightness, recipe()),
            coherence: Setting::new(look.coherence, recipe()),
            body: Setting::new(Some(look.body_rgb), recipe()),
            shown: Setting::new(Shown::ALL, "default"),
            colour: Setting::new(ColourMode::Rgb, "default"),
            polarised: Setting::new(false, "default"),
            texture,
            thickness,
        }
    }
}

/// One effect, on or off, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Decision {
    /// The effect.
    pub effect: Effect,
    /// Whether the table holds it.
    pub on: bool,
    /// What called for it, or what made it needless.
    pub why: String,
}

/// A decision for every effect, in the model's order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decisions(Vec<Decision>);

impl Decisions {
    /// The decisions for a recipe that is looked at in a certain way.
    ///
    /// # Errors
    /// A listed effect that this version does not simulate.
    pub fn of(recipe: &Recipe, view: &View, effects: Effects) -> Result<Self, EffectError> {
        match effects {
            Effects::Look => Ok(Self::by_view(recipe, view)),
            Effects::All => Ok(Self::of_all(recipe, view)),
            Effects::Listed(set) => Self::of_list(recipe, set),
        }
    }

    /// What the view calls for.
    #[must_use]
    pub fn by_view(recipe: &Recipe, view: &View) -> Self {
        Self(Effect::ALL.into_iter().map(|effect| decide(effect, recipe, view)).collect())
    }

    /// `blur` brings `surface` (its light passes the surface) and `azimuth`.
    fn of_list(recipe: &Recipe, list: EffectSet) -> Result<Self, EffectError> {
        for effect in list.iter() {
            if let Err(why) = simulated(effect, recipe) {
                return Err(EffectError::NotSimulated { effect, why });
            }
        }
        let decision = |effect: Effect| {
            let listed = list.contains(effect);
            let needed = list.contains(Effect::Blur) && matches!(effect, Effect::Surface | Effect::Azimuth);
            let mut why = match (listed, needed) {
                (true, _) => "listed".to_owned(),
                (_, true) => "blur is listed and needs it".to_owned(),
                _ => "not listed".to_owned(),
            };
            if matches!((effect, listed), (Effect::Polarisation | Effect::CoherentSheets, true))
                && !list.contains(Effect::Blur)
            {
                why = format!("{why}, though it acts on blur alone, which is not");
            }
            let colours = list.contains(Effect::Coherent) || list.contains(Effect::Emission);
            if effect == Effect::Thickness && listed && !colours {
                why = format!("{why}, though it acts on coherent and emission alone, which are not");
            }
            if effect == Effect::Azimuth && (listed || needed) {
                why = format!("{}; {why}", mode_text(recipe.azimuth.mode));
            }
            if let (true, Err(lack)) = (listed, matter(effect, recipe)) {
                why = format!("{why}, though {lack}");
            }
            Decision { effect, on: listed || needed, why }
        };
        Ok(Self(Effect::ALL.into_iter().map(decision).collect()))
    }

    /// All that the recipe has matter for, but the choices of another walk (polarisation, coherent sheets) and controls, which are the
    /// view's.
    fn of_all(recipe: &Recipe, view: &View) -> Self {
        let decision = |effect: Effect| {
            if matches!(
                effect,
                Effect::Polarisation | Effect::CoherentSheets | Effect::Texture | Effect::Thickness
            ) {
                return decide(effect, recipe, view);
            }
            match matter(effect, recipe).and_then(|what| simulated(effect, recipe).map(|()| what)) {
                Ok(what) => Decision { effect, on: true, why: format!("all are listed; {what}") },
                Err(lack) => Decision { effect, on: false, why: lack },
            }
        };
        Self(Effect::ALL.into_iter().map(decision).collect())
    }

    /// The effects that are on.
    #[must_use]
    pub fn set(&self) -> EffectSet {
        self.0.iter().filter(|decision| decision.on).map(|decision| decision.effect).collect()
    }

    /// The decisions, in the model's order.
    #[must_use]
    pub fn all(&self) -> &[Decision] {
        &self.0
    }

    /// The decision on one effect.
    #[must_use]
    pub fn get(&self, effect: Effect) -> &Decision {
        // Every constructor goes through Effect::ALL.
        &self.0[effect as usize]
    }
}

const fn mode_text(mode: AzimuthMode) -> &'static str {
    match mode {
        AzimuthMode::Decay => "decay: the plane walk, spread by the postulate",
        AzimuthMode::Space => "space: transport in space gives the azimuth",
    }
}

/// What in a recipe an effect would act on; `Err` says what is missing.
fn matter(effect: Effect, recipe: &Recipe) -> Result<String, String> {
    match effect {
        Effect::Surface => Ok("every pearl has a surface".to_owned()),
        Effect::Azimuth => matter(Effect::Blur, recipe).map(|_| mode_text(recipe.azimuth.mode).to_owned()),
        Effect::Blur => blur_matter(recipe),
        Effect::Absorption => absorbing(recipe)
            .or_else(|| absorbing_elsewhere(recipe))
            .ok_or_else(|| "nothing absorbs (every k is 0)".to_owned()),
        Effect::Dispersion => {
            dispersive(recipe).ok_or_else(|| "every index is the same at all wavelengths".to_owned())
        }
        Effect::Coherent => Ok("layers interfere".to_owned()),
        Effect::CoherentSheets => match &recipe.stack.explicit {
            None if recipe.stack.layer_count() >= 2 => Ok("conchiolin sheets between aragonite".to_owned()),
            _ => Err("the stack has no conchiolin sheets".to_owned()),
        },
        Effect::Emission => Ok("light scattered in the layers".to_owned()),
        Effect::Irregularity => irregular(recipe).ok_or_else(|| "every thickness_sd_nm is 0".to_owned()),
        Effect::Polarisation => Ok("s and p differ at every interface".to_owned()),
        Effect::Body => Ok("a body under the nacre".to_owned()),
        Effect::Texture => Err("no texture, bump or normal map".to_owned()),
        Effect::Thickness => Ok("interference colours depend on the thickness".to_owned()),
    }
}

/// Whether what enters is worth following: an interface inside that reflects, or a layer that absorbs.
fn blur_matter(recipe: &Recipe) -> Result<String, String> {
    let count = recipe.stack.layer_count();
    let Ok(transport) = recipe.transport(recipe.wavelength()) else {
        // The bake itself says what is wrong with the recipe.
        return Ok(format!("{count} layers"));
    };
    // Layers that absorb are walked for what they absorb.
    if transport.indices[1..].windows(2).all(|pair| pair[0] == pair[1]) && !transport.absorbs() {
        return Err(format!(
            "no interface under the surface reflects: every index there is {}",
            transport.indices[1]
        ));
    }
    Ok(format!("light comes back from {count} layers"))
}

fn absorbing(recipe: &Recipe) -> Option<String> {
    let transport = recipe.transport(recipe.wavelength()).ok()?;
    let nm = recipe.light.wavelength_nm;
    let medium = transport.extinctions.iter().position(|k| *k > 0.0)?;
    let name =
        if medium > transport.layers() { "the substrate".to_owned() } else { format!("layer {medium}") };
    Some(format!("{name} absorbs at {nm} nm"))
}

/// A layer that absorbs at some wavelength, if not at that of the walk.
fn absorbing_elsewhere(recipe: &Recipe) -> Option<String> {
    let absorbs = |n: &Option<Dispersion>, k: f64| match n {
        Some(Dispersion::Table(rows)) => k > 0.0 || rows.iter().any(|row| row[2] > 0.0),
        _ => k > 0.0,
    };
    let layer = |layer: &crate::recipe::Layer| absorbs(&layer.n, layer.k);
    let stack = &recipe.stack;
    let any = match &stack.explicit {
        Some(layers) => layers.iter().any(layer),
        None => layer(&stack.aragonite) || (stack.layer_count() > 1 && layer(&stack.conchiolin)),
    };
    let any = any || absorbs(&stack.substrate.n, stack.substrate.k);
    any.then(|| format!("the stack absorbs, though not at the walk's {} nm", recipe.light.wavelength_nm))
}

/// Absorption acts on the blur at the walk's wavelength, and on interference colours at all.
fn absorption(recipe: &Recipe, view: &View) -> Verdict {
    let blur = needs_blur(recipe, view);
    let colours = coherent(view).is_ok() || emission(view).is_ok();
    match (blur, absorbing(recipe)) {
        (Ok(()), Some(what)) => Ok(what),
        (Err(blur), _) if !colours => Err(format!("{blur}, and no interference is shown")),
        _ if colours => matter(Effect::Absorption, recipe),
        _ => Err(format!("nothing absorbs at {} nm", recipe.light.wavelength_nm)),
    }
}

fn dispersive(recipe: &Recipe) -> Option<String> {
    let varies = |n: &Dispersion| match n {
        Dispersion::Constant(_) => false,
        Dispersion::Cauchy(coefficients) => coefficients[1..].iter().any(|c| *c != 0.0),
        Dispersion::Sellmeier { b, .. } => b.iter().any(|b| *b != 0.0),
        Dispersion::Table(rows) => rows.windows(2).any(|pair| pair[0][1..] != pair[1][1..]),
    };
    let (medium, _) = recipe.stack.dispersions().into_iter().find(|(_, n)| varies(n))?;
    Some(format!("the optical constants of {medium} depend on the wavelength"))
}

fn irregular(recipe: &Recipe) -> Option<String> {
    let stack = &recipe.stack;
    if let Some(layers) = &stack.explicit {
        let layer = layers.iter().position(|layer| layer.thickness_sd_nm > 0.0)?;
        return Some(format!("stack.explicit[{layer}].thickness_sd_nm is {}", layers[layer].thickness_sd_nm));
    }
    let both = [("aragonite", &stack.aragonite), ("conchiolin", &stack.conchiolin)];
    let (name, layer) = both.into_iter().find(|(_, layer)| layer.thickness_sd_nm > 0.0)?;
    Some(format!("stack.{name}.thickness_sd_nm is {}", layer.thickness_sd_nm))
}

/// Whether a recipe has matter for an effect and this version simulates it there.
///
/// # Errors
/// What is missing, as a line of text.
pub fn available(effect: Effect, recipe: &Recipe) -> Result<(), String> {
    matter(effect, recipe)?;
    simulated(effect, recipe)
}

/// Whether this version simulates an effect; `Err` says what it does in its place.
fn simulated(effect: Effect, recipe: &Recipe) -> Result<(), String> {
    match effect {
        Effect::Polarisation if recipe.azimuth.mode == AzimuthMode::Space => Err(
            "s and p are tracked in the plane of incidence only: azimuth decay has it, azimuth space has not"
                .to_owned(),
        ),
        Effect::CoherentSheets => {
            recipe.sheet_transport(recipe.wavelength()).map(|_| ()).map_err(|why| why.to_string())
        }
        _ => Ok(()),
    }
}

/// One decision, of the recipe and the view. `Ok`: on, and why; `Err`: off, and why.
fn decide(effect: Effect, recipe: &Recipe, view: &View) -> Decision {
    let verdict = match effect {
        Effect::Surface => lobe_is_seen(view, view.shown.value.mirror, "mirror"),
        Effect::Blur => lobe_is_seen(view, view.shown.value.blur, "blur")
            .and_then(|seen| blur_matter(recipe).map(|what| format!("{what}; {seen}"))),
        Effect::Azimuth => needs_blur(recipe, view).and_then(|()| matter(effect, recipe)),
        Effect::Absorption => absorption(recipe, view),
        Effect::Polarisation => polarisation(recipe, view),
        Effect::Dispersion => needs_blur(recipe, view).and_then(|()| dispersion(recipe, view)),
        Effect::Coherent => coherent(view),
        Effect::CoherentSheets => Err("only where it is listed".to_owned()),
        Effect::Emission => emission(view),
        Effect::Irregularity => irregularity(recipe, view),
        Effect::Body => body(view),
        Effect::Texture => match &view.texture {
            Some(texture) => Ok(format!("{} ({})", texture.value, texture.from)),
            None => matter(effect, recipe),
        },
        Effect::Thickness => thickness(view),
    };
    let verdict = verdict.and_then(|why| match simulated(effect, recipe) {
        Ok(()) => Ok(why),
        Err(lack) => Err(format!("{why}; not simulated: {lack}")),
    });
    let on = verdict.is_ok();
    let (Ok(why) | Err(why)) = verdict;
    Decision { effect, on, why }
}

type Verdict = Result<String, String>;

fn setting(name: &str, setting: &Setting<f64>) -> String {
    format!("{name} {} ({})", setting.value, setting.from)
}

/// A lobe is needed where it is shown, and where the base is: the base takes the light that the lobes leave.
fn lobe_is_seen(view: &View, shown: bool, component: &str) -> Verdict {
    let brightness = setting("brightness", &view.brightness);
    if view.brightness.value == 0.0 {
        return Err(brightness);
    }
    if shown {
        return Ok(brightness);
    }
    let hidden = format!("{component} is not among the components ({})", view.shown.from);
    if view.shown.value.base() && base_is_lit(view) {
        return Ok(format!("{hidden}, but the body gets only the light that it leaves"));
    }
    Err(hidden)
}

fn base_is_lit(view: &View) -> bool {
    view.body.value.is_none_or(|rgb| rgb.iter().any(|channel| *channel > 0.0))
}

fn needs_blur(recipe: &Recipe, view: &View) -> Result<(), String> {
    match decide(Effect::Blur, recipe, view) {
        Decision { on: true, .. } => Ok(()),
        Decision { why, .. } => Err(format!("no blur: {why}")),
    }
}

fn polarisation(recipe: &Recipe, view: &View) -> Verdict {
    if !view.polarised.value {
        return Err(format!("the variant is not polarised ({})", view.polarised.from));
    }
    needs_blur(recipe, view)?;
    Ok(format!("the variant is polarised ({})", view.polarised.from))
}

fn dispersion(recipe: &Recipe, view: &View) -> Verdict {
    let what = matter(Effect::Dispersion, recipe)?;
    if view.colour.value == ColourMode::Mono {
        return Err(format!("the variant has one band ({})", view.colour.from));
    }
    Ok(what)
}

fn coherent(view: &View) -> Verdict {
    if view.coherence.value == 0.0 {
        return Err(setting("coherence", &view.coherence));
    }
    let shown = view.shown.value;
    lobe_is_seen(view, shown.mirror || shown.blur, "no lobe")?;
    Ok(setting("coherence", &view.coherence))
}

fn thickness(view: &View) -> Verdict {
    let Some(asked) = &view.thickness else { return Err("thickness is no control here".to_owned()) };
    if coherent(view).is_err() && emission(view).is_err() {
        return Err(format!("{} ({}), but no interference is shown", asked.value, asked.from));
    }
    Ok(format!("{} ({})", asked.value, asked.from))
}

fn emission(view: &View) -> Verdict {
    if view.depth.value == 0.0 {
        return Err(setting("depth", &view.depth));
    }
    body(view)?;
    Ok(setting("depth", &view.depth))
}

fn body(view: &View) -> Verdict {
    if !base_is_lit(view) {
        return Err(format!("body_color is black ({})", view.body.from));
    }
    if !view.shown.value.base() {
        return Err(format!("neither diffuse nor incoherent is among the components ({})", view.shown.from));
    }
    match view.body.value {
        None => Ok(format!("body_color is a texture ({})", view.body.from)),
        Some([r, g, b]) => Ok(format!("body_color {r} {g} {b} ({})", view.body.from)),
    }
}

fn irregularity(recipe: &Recipe, view: &View) -> Verdict {
    let what = matter(Effect::Irregularity, recipe)?;
    match (coherent(view), emission(view)) {
        (Err(coherent), Err(emission)) => Err(format!("no interference is shown: {coherent}, {emission}")),
        _ => Ok(what),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(text: &str) -> Recipe {
        Recipe::from_json(text).unwrap()
    }

    fn on(recipe: &Recipe, view: &View) -> String {
        Decisions::by_view(recipe, view).set().names().join(" ")
    }

    fn paper() -> (Recipe, View) {
        let recipe = Recipe::default();
        let view = View::of_look(&recipe.look);
        (recipe, view)
    }

    #[test]
    fn names_are_the_models_and_survive_a_round_trip() {
        let names = "surface blur azimuth polarisation absorption dispersion coherent coherent_sheets emission \
                     irregularity body texture thickness";
        assert_eq!(Effect::ALL.map(Effect::name).join(" "), names);
        for effect in Effect::ALL {
            assert_eq!(Effect::from_name(effect.name()), Some(effect));
            assert_eq!(serde_json::to_value(effect).unwrap(), effect.name());
            assert_eq!(Effect::ALL[effect as usize], effect);
        }
        let set: EffectSet = [Effect::Texture, Effect::Blur].into_iter().collect();
        assert_eq!(serde_json::to_string(&set).unwrap(), r#"["blur","texture"]"#);
        assert_eq!(serde_json::from_str::<EffectSet>(r#"["texture","blur"]"#).unwrap(), set);
    }

    #[test]
    fn the_papers_pearl_calls_for_its_lobes_colours_and_body() {
        let (recipe, view) = paper();
        assert_eq!(on(&recipe, &view), "surface blur azimuth coherent emission body");
    }

    #[test]
    fn each_control_at_zero_leaves_out_what_it_stands_for() {
        let (recipe, view) = paper();
        let zero = || Setting::new(0.0, "scene.xml:3");
        let without_depth = View { depth: zero(), ..view.clone() };
        assert_eq!(on(&recipe, &without_depth), "surface blur azimuth coherent body");
        let incoherent = View { coherence: zero(), ..view.clone() };
        assert_eq!(on(&recipe, &incoherent), "surface blur azimuth emission body");
        let dull = View { brightness: zero(), ..view.clone() };
        assert_eq!(on(&recipe, &dull), "emission body");
        let why = &Decisions::by_view(&recipe, &dull).get(Effect::Blur).why.clone();
        assert_eq!(why, "brightness 0 (scene.xml:3)");
        let black = View { body: Setting::new(Some([0.0; 3]), "scene.xml:4"), ..view };
        assert_eq!(on(&recipe, &black), "surface blur azimuth coherent");
    }

    #[test]
    fn a_hidden_lobe_is_needed_only_by_a_body() {
        let (recipe, view) = paper();
        let shown = |shown| View { shown: Setting::new(shown, "s:1"), ..view.clone() };
        let mirror = Shown { diffuse: false, incoherent: false, mirror: true, blur: false };
        assert_eq!(on(&recipe, &shown(mirror)), "surface coherent");
        assert_eq!(on(&recipe, &shown(Shown { blur: false, ..Shown::ALL })), on(&recipe, &view));
    }

    #[test]
    fn matter_in_the_recipe_switches_its_effects_on() {
        let text = r#"{"stack":{"aragonite":{"n":{"cauchy":[1.5,0.01]},"thickness_sd_nm":9},"conchiolin":{"k":0.001}}}"#;
        let recipe = recipe(text);
        let view = View::of_look(&recipe.look);
        let all = "surface blur azimuth absorption dispersion coherent emission irregularity body";
        assert_eq!(on(&recipe, &view), all);
        let why = |view: &View, effect| Decisions::by_view(&recipe, view).get(effect).why.clone();
        assert_eq!(
            why(&view, Effect::Dispersion),
            "the optical constants of aragonite depend on the wavelength"
        );
        let mono = View { colour: Setting::new(ColourMode::Mono, "s:1"), ..view.clone() };
        assert_eq!(why(&mono, Effect::Dispersion), "the variant has one band (s:1)");
        let polarised = View { polarised: Setting::new(true, "s:1"), ..view.clone() };
        assert_eq!(why(&polarised, Effect::Polarisation), "the variant is polarised (s:1)");
        let mut space = recipe.clone();
        space.azimuth.mode = AzimuthMode::Space;
        let decision = Decisions::by_view(&space, &polarised).get(Effect::Polarisation).clone();
        assert!(!decision.on && decision.why.contains("azimuth decay has it"), "{decision:?}");
        assert!(why(&view, Effect::Polarisation).starts_with("the variant is not polarised"));
    }

    #[test]
    fn a_varnish_of_one_index_has_no_blur() {
        let recipe = recipe(r#"{"stack":{"layers":1},"look":{"depth":0,"coherence":0}}"#);
        assert_eq!(on(&recipe, &View::of_look(&recipe.look)), "surface body");
    }

    #[test]
    fn lists_are_taken_at_their_word() {
        let (recipe, view) = paper();
        let set = |list: &str| {
            let (effects, _) = Effects::parse(list).unwrap();
            Decisions::of(&recipe, &view, effects).unwrap().set().names().join(" ")
        };
        assert_eq!(set("body"), "body");
        assert_eq!(set("absorption,blur"), "surface blur azimuth absorption");
        assert_eq!(set("all"), "surface blur azimuth coherent emission body");
        assert_eq!(Effects::parse("azimuth:space").unwrap().1, Some(AzimuthMode::Space));
        for list in ["", "glitter", "surface,,blur", "azimuth:flat", "Surface"] {
            let line = Effects::parse(list).unwrap_err().to_string();
            assert!(line.starts_with("effects: ") && !line.contains('\n'), "{line}");
        }
    }
}
