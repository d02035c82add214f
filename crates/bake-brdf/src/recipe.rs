//! The recipe: what a pearl is made of, as strict JSON (`pearl-recipe/1`).
//!
//! Every key is optional and has the paper's value as its default, but for `solver`, whose default is the cheaper one; unknown keys
//! are refused. A parsed
//! [`Recipe`] is always valid: [`Recipe::from_json`] checks ranges and names the field that is wrong.

use crate::options::SolverChoice;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use thinfilm::emission::SourceProfile;
use thinfilm::{Dispersion, Material, nanometres};
use transport::{Facets, Normals, Sheets, Transport};

/// Largest k/n of the first and of any other layer, and why; a substrate may have any.
const MOST_ABSORBING: [(f64, &str); 2] = [
    (0.02, "renderers have the mirror of the first layer in closed form, from its n"),
    (0.2, "rays have no direction in a medium that absorbs within a wavelength"),
];

/// Schema name of the recipes that this version reads.
pub const SCHEMA: &str = "pearl-recipe/1";
/// Most layers a recipe may ask for.
pub const MAX_LAYERS: usize = 1_000_000;
/// Longest recipe text that is parsed, bytes.
pub const MAX_BYTES: u64 = 16 << 20;
/// Largest facet slope standard deviation, degrees.
pub const MAX_SLOPE_SD_DEG: f64 = 45.0;

/// The recipes that have a name: it may stand wherever a recipe's file may.
pub const BUILT_IN: [(&str, &str); 13] = [
    ("abalone", include_str!("../recipes/abalone.json")),
    ("akoya", include_str!("../recipes/akoya.json")),
    ("akoya-g", include_str!("../recipes/akoya-g.json")),
    ("akoya-r", include_str!("../recipes/akoya-r.json")),
    ("akoya-rg", include_str!("../recipes/akoya-rg.json")),
    ("cosmetic-flake", include_str!("../recipes/cosmetic-flake.json")),
    ("freshwater", include_str!("../recipes/freshwater.json")),
    ("golden", include_str!("../recipes/golden.json")),
    ("mother-of-pearl", include_str!("../recipes/mother-of-pearl.json")),
    ("paper", include_str!("../recipes/paper.json")),
    ("south-sea", include_str!("../recipes/south-sea.json")),
    ("tahitian", include_str!("../recipes/tahitian.json")),
    ("varnish", include_str!("../recipes/varnish.json")),
];

/// The JSON of a built-in recipe.
#[must_use]
pub fn built_in(name: &str) -> Option<&'static str> {
    BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Reads a recipe: a built-in one by its name, else of the text that `read` finds. Whoever calls says what its errors are.
///
/// # Errors
/// Those of `read`; else one line with the path, by `refuse`.
pub fn named<E>(
    path: &Path,
    read: impl FnOnce(&Path) -> Result<String, E>,
    refuse: impl Fn(String) -> E,
) -> Result<Recipe, E> {
    let refuse = |why: &dyn std::fmt::Display| refuse(format!("{}: {why}", path.display()));
    if let Some(why) = unknown(path) {
        return Err(refuse(&why));
    }
    let text = match path.to_str().and_then(built_in) {
        Some(text) => text.to_owned(),
        None => read(path)?,
    };
    Recipe::from_json(&text).map_err(|why| refuse(&why))
}

/// Why a name stands for no recipe, where there is neither such a file nor such a built-in recipe.
#[must_use]
pub fn unknown(path: &Path) -> Option<String> {
    let known = path.as_os_str() == "-"
        || path.exists()
        || path.to_str().is_some_and(|name| built_in(name).is_some());
    let names = BUILT_IN.map(|(name, _)| name).join(", ");
    (!known).then(|| format!("there is no such file, and the built-in recipes are {names}"))
}

/// What a pearl is made of, and how it should look.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Recipe {
    /// Always "pearl-recipe/1".
    pub schema: String,
    /// Name of the pearl.
    pub name: String,
    /// Where the values come from: field name → citation. Not used in any computation.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub sources: BTreeMap<String, String>,
    /// Layers and what surrounds them.
    pub stack: Stack,
    /// Facet statistics of every interface.
    pub facets: FacetStatistics,
    /// How light leaves the plane of incidence.
    pub azimuth: Azimuth,
    /// The artist's controls.
    pub look: Look,
    /// The light that the transport problem is solved for.
    pub light: Light,
    /// Who solves it, where a bake is not told otherwise.
    #[serde(default = "cheapest")]
    pub solver: SolverChoice,
}

const fn cheapest() -> SolverChoice {
    SolverChoice::Auto
}

/// Layers and what surrounds them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Stack {
    /// Number of layers (or of pairs, see `count`); 500 unless `explicit` is given, which replaces it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 1_000_000))]
    pub layers: Option<usize>,
    /// Whether `layers` counts layers or aragonite/conchiolin pairs.
    pub count: Count,
    /// The medium outside.
    pub ambient: Medium,
    /// Odd layers, counted from the outside.
    pub aragonite: Layer,
    /// Even layers.
    pub conchiolin: Layer,
    /// What lies under the last layer.
    pub substrate: Medium,
    /// An explicit list of layers, outermost first, in place of `layers`, `aragonite` and `conchiolin`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub explicit: Option<Vec<Layer>>,
    /// Allows k < 0 (gain) in layers in `thinfilm`; a bake refuses it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub gain: bool,
    /// Where the emission, the light of incoherent interference, comes from.
    #[serde(skip_serializing_if = "EmissionSources::is_default")]
    pub emission_sources: EmissionSources,
}

/// Where the emission comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EmissionSources {
    /// Everywhere in the layers alike.
    #[default]
    Uniform,
    /// Falling as e^(−z/depth) from the first interface, given the depth in nm.
    DepthNm(f64),
    /// In the substrate.
    Substrate,
}

impl EmissionSources {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// What `layers` counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Count {
    /// Layers in total.
    #[default]
    Layers,
    /// Pairs of one aragonite and one conchiolin layer.
    Pairs,
}

/// A half-space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Medium {
    /// Real index, 0.05 to 20, or a dispersion.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub n: Option<Dispersion>,
    /// Extinction coefficient; 0 or more, unless the stack has `gain`.
    #[serde(default)]
    pub k: f64,
}

/// One layer, or one of the two materials of the alternating stack.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Real index, 0.05 to 20, or a dispersion.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub n: Option<Dispersion>,
    /// Extinction coefficient; 0 or more, unless the stack has `gain`.
    #[serde(default)]
    pub k: f64,
    /// Mean thickness, nm.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schemars(range(min = 0))]
    pub thickness_nm: Option<f64>,
    /// Standard deviation of the thickness, nm.
    #[serde(default)]
    #[schemars(range(min = 0))]
    pub thickness_sd_nm: f64,
}

/// Facet statistics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FacetStatistics {
    /// σ: standard deviation of the tilt (plane) or of each slope (space), degrees.
    #[schemars(range(min = 0, max = 45))]
    pub slope_sd_deg: f64,
    /// Weighting of the facets that a ray meets.
    #[schemars(schema_with = "normals_schema")]
    pub normals: Normals,
}

fn normals_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    schemars::json_schema!({ "oneOf": [
        { "const": "unweighted", "description": "From the slope density, redrawn while facing away (the paper)." },
        { "const": "visible", "description": "Also weighted by projected area." },
    ] })
}

/// How light leaves the plane of incidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Azimuth {
    /// `decay`: the paper's postulate on the plane walk; `space`: transport in space.
    pub mode: AzimuthMode,
    /// Width w of the decay, degrees; null: the standard deviation of the plane lobe at each θi.
    #[schemars(range(min = 1e-6, max = 1e4))]
    pub width_deg: Option<f64>,
}

/// Azimuth mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AzimuthMode {
    /// The paper's postulate on the plane walk.
    #[default]
    Decay,
    /// Transport in space: no postulate.
    Space,
}

impl AzimuthMode {
    /// The mode of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "decay" => Some(Self::Decay),
            "space" => Some(Self::Space),
            _ => None,
        }
    }
}

impl Azimuth {
    /// w of the decay postulate, degrees: the recipe's, or the standard deviation of the plane lobe at this θi.
    pub(crate) fn decay_width_deg(self, sd_theta_o_deg: f64) -> f64 {
        // A lobe without spread (σ = 0, or no light at all) still needs a width to divide by.
        const NARROWEST_DEG: f64 = 1e-4;
        self.width_deg.unwrap_or(sd_theta_o_deg).max(NARROWEST_DEG)
    }
}

/// The artist's controls (stored with the table; they do not change the walk).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Look {
    /// Share of incoherent interference in the base, 0 to 1.
    #[schemars(range(min = 0, max = 1))]
    pub depth: f64,
    /// Strength of the lobes, 0 to 1.
    #[schemars(range(min = 0, max = 1))]
    pub brightness: f64,
    /// Degree of coherence γ, 0 to 1.
    #[schemars(range(min = 0, max = 1))]
    pub coherence: f64,
    /// Strength of the bump or normal texture, 0 to 1.
    #[schemars(range(min = 0, max = 1))]
    pub grain: f64,
    /// Body colour ρ, linear sRGB.
    #[schemars(inner(range(min = 0, max = 1)))]
    pub body_rgb: [f64; 3],
    /// Scales of all thicknesses that the colours of the table are to serve, so that thickness is a control (effect `thickness`); none by
    /// default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thickness: Option<ThicknessRange>,
}

/// Scales of all thicknesses and of their spreads.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ThicknessRange {
    /// Smallest scale, 0.5 to 1.
    #[schemars(range(min = 0.5, max = 1))]
    pub min: f64,
    /// Largest scale, 1 to 2.
    #[schemars(range(min = 1, max = 2))]
    pub max: f64,
}

/// The light that the transport problem is solved for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Light {
    /// Vacuum wavelength at which indices and absorption are taken, nm.
    #[schemars(range(min = 1))]
    pub wavelength_nm: f64,
}

impl Default for Recipe {
    /// The paper's pearl.
    fn default() -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            name: "paper".to_owned(),
            sources: BTreeMap::new(),
            stack: Stack::default(),
            facets: FacetStatistics::default(),
            azimuth: Azimuth::default(),
            look: Look::default(),
            light: Light::default(),
            // The method of the paper.
            solver: SolverChoice::Walk,
        }
    }
}

impl Default for Stack {
    fn default() -> Self {
        let layer = |n, thickness_nm| Layer {
            n: Some(Dispersion::Constant(n)),
            k: 0.0,
            thickness_nm: Some(thickness_nm),
            thickness_sd_nm: 0.0,
        };
        let medium = |n| Medium { n: Some(Dispersion::Constant(n)), k: 0.0 };
        Self {
            layers: None,
            count: Count::Layers,
            ambient: medium(1.0),
            aragonite: layer(1.53, 450.0),
            conchiolin: layer(1.43, 25.0),
            substrate: medium(1.53),
            explicit: None,
            gain: false,
            emission_sources: EmissionSources::default(),
        }
    }
}

impl Default for FacetStatistics {
    fn default() -> Self {
        Self { slope_sd_deg: 2.0, normals: Normals::Unweighted }
    }
}

impl Default for Look {
    fn default() -> Self {
        let body_rgb = [0.8, 0.78, 0.75];
        Self { depth: 0.5, brightness: 1.0, coherence: 0.5, grain: 0.0, body_rgb, thickness: None }
    }
}

impl Default for ThicknessRange {
    /// An octave about the recipe's own thickness.
    fn default() -> Self {
        Self { min: 0.7, max: 1.4 }
    }
}

impl Default for Light {
    fn default() -> Self {
        Self { wavelength_nm: 550.0 }
    }
}

/// What is wrong with a recipe, in one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RecipeError {
    /// Not JSON, a wrong type, or an unknown key.
    #[error("{field}{message}")]
    Syntax {
        /// Path of the field followed by `: `, or empty.
        field: String,
        /// What the parser says.
        message: String,
    },
    /// A value out of its range.
    #[error("{field}: {value} is not valid; {expected}")]
    Value {
        /// Path of the field.
        field: String,
        /// The value found.
        value: String,
        /// What would be right.
        expected: String,
    },
}

/// A layer of the expanded stack with every default filled in.
#[derive(Clone)]
struct ResolvedLayer {
    material: Material,
    /// Mean thickness, metres.
    thickness: f64,
    /// Standard deviation of the thickness, metres.
    thickness_sd: f64,
}

impl Recipe {
    /// Parses and checks a recipe.
    ///
    /// # Errors
    /// One line that names the field, the value and what would be right.
    pub fn from_json(text: &str) -> Result<Self, RecipeError> {
        let mut deserializer = serde_json::Deserializer::from_str(text);
        let mut recipe: Self =
            serde_path_to_error::deserialize(&mut deserializer).map_err(|error| RecipeError::Syntax {
                field: match error.path().to_string() {
                    path if path == "." => String::new(),
                    path => format!("{path}: "),
                },
                message: in_json(&error.inner().to_string()),
            })?;
        deserializer
            .end()
            .map_err(|error| RecipeError::Syntax { field: String::new(), message: error.to_string() })?;
        recipe.stack.fill_defaults();
        recipe.check()?;
        let given = serde_json::from_str(text)
            .map_err(|error| RecipeError::Syntax { field: String::new(), message: error.to_string() })?;
        refuse_lists("recipe", &given, &recipe.to_json())?;
        Ok(recipe)
    }

    /// The recipe as JSON, every default filled in.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mut whole = self.clone();
        whole.stack.fill_defaults();
        // Serialising plain structs of numbers and strings cannot fail.
        serde_json::to_value(whole).unwrap_or_default()
    }

    /// The JSON Schema of a recipe.
    #[must_use]
    pub fn json_schema() -> Value {
        let mut schema = schemars::schema_for!(Recipe).to_value();
        if let Some(properties) = schema.get_mut("properties").and_then(|p| p.get_mut("schema")) {
            *properties =
                serde_json::json!({ "const": SCHEMA, "description": "Version of the recipe format." });
        }
        schema
    }

    /// Checks every range; [`Recipe::from_json`] calls it.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn check(&self) -> Result<(), RecipeError> {
        if self.schema != SCHEMA {
            return Err(wrong(
                "schema",
                format!("{:?}", self.schema),
                format!("this version reads {SCHEMA:?}"),
            ));
        }
        self.stack.check()?;
        let sigma = self.facets.slope_sd_deg;
        within("facets.slope_sd_deg", sigma, 0.0, MAX_SLOPE_SD_DEG, "degrees")?;
        if let Some(width) = self.azimuth.width_deg {
            within("azimuth.width_deg", width, 1e-6, 1e4, "degrees")?;
        }
        let look = &self.look;
        for (field, value) in [
            ("look.depth", look.depth),
            ("look.brightness", look.brightness),
            ("look.coherence", look.coherence),
            ("look.grain", look.grain),
        ] {
            within(field, value, 0.0, 1.0, "")?;
        }
        for (i, &channel) in look.body_rgb.iter().enumerate() {
            within(&format!("look.body_rgb[{i}]"), channel, 0.0, 1.0, "(linear sRGB)")?;
        }
        if let Some(ThicknessRange { min, max }) = look.thickness {
            within("look.thickness.min", min, 0.5, 1.0, "")?;
            within("look.thickness.max", max, 1.0, 2.0, "")?;
            if min == max {
                return Err(wrong("look.thickness.max", max, format!("expected more than min, {min}")));
            }
        }
        within("light.wavelength_nm", self.light.wavelength_nm, 1.0, 1e7, "nm")
    }

    /// Vacuum wavelength of the transport problem, metres.
    #[must_use]
    pub fn wavelength(&self) -> f64 {
        self.light.wavelength_nm * 1e-9
    }

    /// The stack of layers for wave optics, with mean thicknesses and their spread; an alternating stack stays
    /// periodic, so that its cost does not grow with its layers.
    #[must_use]
    pub fn film_stack(&self) -> thinfilm::Stack {
        let stack = &self.stack;
        let (ambient, substrate) = (stack.ambient.material(), stack.substrate.material());
        let Some(explicit) = &stack.explicit else {
            let part = |layer: &Layer| {
                let ResolvedLayer { material, thickness, thickness_sd } = layer.resolved();
                (material, thickness, thickness_sd)
            };
            let layers = stack.layer_count() as u64;
            return self.with_gain(thinfilm::Stack::alternating(
                ambient,
                part(&stack.aragonite),
                part(&stack.conchiolin),
                layers,
                substrate,
            ));
        };
        let resolved: Vec<ResolvedLayer> = explicit.iter().map(Layer::resolved).collect();
        let unit = resolved.iter().enumerate().map(|(material, layer)| thinfilm::StackLayer {
            material,
            thickness: layer.thickness,
            thickness_sd: layer.thickness_sd,
        });
        self.with_gain(thinfilm::Stack {
            ambient,
            runs: vec![thinfilm::StackRun { unit: unit.collect(), repeat: 1 }],
            materials: resolved.into_iter().map(|layer| layer.material).collect(),
            substrate,
            gain: thinfilm::Gain::Refused,
        })
    }

    /// Gain, where the recipe allows it and a medium has any: fast waves know none.
    fn with_gain(&self, mut film: thinfilm::Stack) -> thinfilm::Stack {
        let amplifies = |material: &Material| {
            let table = |rows: &[[f64; 3]]| rows.iter().any(|row| row[2] < 0.0);
            material.k < 0.0 || matches!(&material.n, Dispersion::Table(rows) if table(rows))
        };
        if self.stack.gain && film.materials.iter().chain([&film.ambient, &film.substrate]).any(amplifies) {
            film.gain = thinfilm::Gain::Allowed;
        }
        film
    }

    /// Where the emission comes from.
    #[must_use]
    pub fn source_profile(&self) -> SourceProfile {
        match self.stack.emission_sources {
            EmissionSources::Uniform => SourceProfile::Uniform,
            EmissionSources::DepthNm(depth) => SourceProfile::Exponential { depth: depth * 1e-9 },
            EmissionSources::Substrate => SourceProfile::Substrate,
        }
    }

    /// The transport problem at a vacuum wavelength in metres.
    ///
    /// # Errors
    /// A dispersion table that does not cover the wavelength, gain, or an absorbing ambient.
    pub fn transport(&self, wavelength: f64) -> Result<Transport, RecipeError> {
        let index = |field: &str, material: &Material| {
            let index = material.index(wavelength).map_err(|error| RecipeError::Syntax {
                field: format!("{field}.n: "),
                message: error.to_string(),
            })?;
            if index.im < 0.0 {
                return Err(wrong(&format!("{field}.k"), index.im, "a bake needs k >= 0 (no gain)"));
            }
            Ok(index)
        };
        let stack = &self.stack;
        let ambient = index("stack.ambient", &stack.ambient.material())?;
        if ambient.im > 0.0 {
            return Err(wrong(
                "stack.ambient.k",
                ambient.im,
                "light arrives through the ambient: k must be 0",
            ));
        }
        let mut indices = vec![ambient.re];
        let mut extinctions = vec![0.0];
        let mut optical_depths = Vec::with_capacity(stack.layer_count());
        let mut push = |field: &str, layer: &ResolvedLayer| {
            let index = index(field, &layer.material)?;
            let (most, why) = if optical_depths.is_empty() { MOST_ABSORBING[0] } else { MOST_ABSORBING[1] };
            if index.im > most * index.re {
                let expected = format!("at most {most} n ({:.4} here): {why}", most * index.re);
                return Err(wrong(&format!("{field}.k"), index.im, expected));
            }
            indices.push(index.re);
            extinctions.push(index.im);
            optical_depths.push(4.0 * std::f64::consts::PI * index.im * layer.thickness / wavelength);
            Ok(())
        };
        for (i, (field, layer)) in stack.expanded().iter().enumerate() {
            push(&field.replace("{i}", &i.to_string()), layer)?;
        }
        let substrate = index("stack.substrate", &stack.substrate.material())?;
        indices.push(substrate.re);
        extinctions.push(substrate.im);
        if extinctions.iter().all(|k| *k == 0.0) {
            extinctions.clear();
        }
        Ok(Transport {
            indices,
            extinctions,
            optical_depths,
            facets: Facets { slope_sd: self.facets.slope_sd_deg.to_radians(), normals: self.facets.normals },
            light: transport::Light::Unpolarised,
            sheets: None,
        })
    }
}

impl Recipe {
    /// The transport problem with each conchiolin sheet one coherent scatterer (effect `coherent_sheets`): what is left of
    /// the layers is the aragonite. Sheets have their mean thickness.
    ///
    /// # Errors
    /// As [`Recipe::transport`]; a stack without sheets, absorbing sheets, sheets thicker than a quarter of a wave, or a last
    /// sheet on a substrate of another index than aragonite's.
    pub fn sheet_transport(&self, wavelength: f64) -> Result<Transport, RecipeError> {
        let stack = &self.stack;
        let whole = self.transport(wavelength)?;
        let layers = stack.layer_count();
        if stack.explicit.is_some() || layers < 2 {
            let found =
                if stack.explicit.is_some() { "an explicit list".to_owned() } else { layers.to_string() };
            let expected = "coherent_sheets needs a stack of aragonite and conchiolin, at least 2 layers";
            return Err(wrong("stack.layers", found, expected));
        }
        if whole.optical_depths[1] > 0.0 {
            let found = format!("absorbs at {} nm", nanometres(wavelength));
            return Err(wrong(
                "stack.conchiolin.k",
                found,
                "coherent_sheets needs sheets that do not absorb",
            ));
        }
        let [ambient, aragonite, conchiolin] = [whole.indices[0], whole.indices[1], whole.indices[2]];
        let substrate = whole.indices[layers + 1];
        let ends_on_sheet = layers.is_multiple_of(2);
        if ends_on_sheet && substrate != aragonite {
            let expected = format!(
                "coherent_sheets needs aragonite ({aragonite}) on both sides of a sheet: give the substrate that index, or an odd number of layers"
            );
            return Err(wrong("stack.substrate.n", substrate, expected));
        }
        let thickness = stack.conchiolin.resolved().thickness;
        let phase = 2.0 * std::f64::consts::PI * thickness / wavelength;
        if conchiolin * phase > std::f64::consts::FRAC_PI_2 {
            let most = 0.25e9 * wavelength / conchiolin;
            let expected = format!("coherent_sheets needs at most a quarter of a wave, {most:.1} nm here");
            return Err(wrong("stack.conchiolin.thickness_nm", nanometres(thickness), expected));
        }
        let count = layers.div_ceil(2);
        let mut indices = vec![ambient];
        indices.resize(count + 1, aragonite);
        indices.push(substrate);
        let mut extinctions = Vec::new();
        if whole.has_complex_faces() {
            extinctions.push(0.0);
            extinctions.resize(count + 1, whole.index(1).im);
            extinctions.push(whole.index(layers + 1).im);
        }
        Ok(Transport {
            indices,
            extinctions,
            optical_depths: vec![whole.optical_depths[0]; count],
            sheets: Some(Sheets {
                index: conchiolin,
                phase,
                last: if ends_on_sheet { count } else { count - 1 },
            }),
            ..whole
        })
    }
}

impl Stack {
    /// L, the number of layers.
    #[must_use]
    pub fn layer_count(&self) -> usize {
        match (&self.explicit, self.count) {
            (Some(layers), _) => layers.len(),
            (None, Count::Layers) => self.layers.unwrap_or(500),
            (None, Count::Pairs) => self.layers.unwrap_or(500).saturating_mul(2),
        }
    }

    /// The indices of all media, each with a name for it.
    pub(crate) fn dispersions(&self) -> Vec<(&'static str, &Dispersion)> {
        let layers: Vec<(&str, Option<&Dispersion>)> = match &self.explicit {
            Some(layers) => layers.iter().map(|layer| ("an explicit layer", layer.n.as_ref())).collect(),
            None => {
                vec![("aragonite", self.aragonite.n.as_ref()), ("conchiolin", self.conchiolin.n.as_ref())]
            }
        };
        let media = [("the ambient", self.ambient.n.as_ref()), ("the substrate", self.substrate.n.as_ref())];
        layers.into_iter().chain(media).filter_map(|(name, n)| Some((name, n?))).collect()
    }

    /// Every layer from the outside in, with the recipe field that each comes from (`{i}` stands for the layer number).
    fn expanded(&self) -> Vec<(&'static str, ResolvedLayer)> {
        if let Some(layers) = &self.explicit {
            return layers.iter().map(|layer| ("stack.explicit[{i}]", layer.resolved())).collect();
        }
        let odd = ("stack.aragonite", self.aragonite.resolved());
        let even = ("stack.conchiolin", self.conchiolin.resolved());
        (0..self.layer_count()).map(|i| if i % 2 == 0 { odd.clone() } else { even.clone() }).collect()
    }

    fn fill_defaults(&mut self) {
        let default = Self::default();
        if self.explicit.is_none() {
            self.layers = self.layers.or(Some(500));
        }
        for (medium, default) in
            [(&mut self.ambient, &default.ambient), (&mut self.substrate, &default.substrate)]
        {
            if medium.n.is_none() {
                medium.n.clone_from(&default.n);
            }
        }
        self.aragonite.fill_from(&default.aragonite);
        self.conchiolin.fill_from(&default.conchiolin);
    }

    fn check(&self) -> Result<(), RecipeError> {
        if let (Some(layers), Some(_)) = (self.layers, &self.explicit) {
            return Err(wrong("stack.layers", layers, "give either layers or explicit, not both"));
        }
        if let Some(layers) = self.layers
            && !(1..=MAX_LAYERS).contains(&self.layer_count())
        {
            return Err(wrong("stack.layers", layers, format!("a stack has 1 to {MAX_LAYERS} layers")));
        }
        if let EmissionSources::DepthNm(depth) = self.emission_sources {
            within("stack.emission_sources.depth_nm", depth, 1.0, 1e9, "nm")?;
        }
        self.ambient.check("stack.ambient", self.gain)?;
        self.substrate.check("stack.substrate", self.gain)?;
        self.aragonite.check("stack.aragonite", self.gain)?;
        self.conchiolin.check("stack.conchiolin", self.gain)?;
        let Some(explicit) = &self.explicit else { return Ok(()) };
        if !(1..=MAX_LAYERS).contains(&explicit.len()) {
            let found = format!("a list of {}", explicit.len());
            return Err(wrong("stack.explicit", found, format!("a stack has 1 to {MAX_LAYERS} layers")));
        }
        for (i, layer) in explicit.iter().enumerate() {
            let field = format!("stack.explicit[{i}]");
            if layer.n.is_none() {
                return Err(wrong(&format!("{field}.n"), "missing", "an explicit layer needs n"));
            }
            if layer.thickness_nm.is_none() {
                return Err(wrong(
                    &format!("{field}.thickness_nm"),
                    "missing",
                    "an explicit layer needs a thickness",
                ));
            }
            layer.check(&field, self.gain)?;
        }
        Ok(())
    }
}

impl Medium {
    /// Optical constants.
    #[must_use]
    pub fn material(&self) -> Material {
        Material { n: self.n.clone().unwrap_or(Dispersion::Constant(1.0)), k: self.k }
    }

    fn check(&self, field: &str, gain: bool) -> Result<(), RecipeError> {
        check_constants(field, self.n.as_ref(), self.k, gain)
    }
}

impl Layer {
    fn fill_from(&mut self, default: &Self) {
        if self.n.is_none() {
            self.n.clone_from(&default.n);
        }
        self.thickness_nm = self.thickness_nm.or(default.thickness_nm);
    }

    fn resolved(&self) -> ResolvedLayer {
        ResolvedLayer {
            material: Material { n: self.n.clone().unwrap_or(Dispersion::Constant(1.0)), k: self.k },
            thickness: self.thickness_nm.unwrap_or(0.0) * 1e-9,
            thickness_sd: self.thickness_sd_nm * 1e-9,
        }
    }

    fn check(&self, field: &str, gain: bool) -> Result<(), RecipeError> {
        check_constants(field, self.n.as_ref(), self.k, gain)?;
        let thickness = self.thickness_nm.unwrap_or(0.0);
        within(&format!("{field}.thickness_nm"), thickness, 0.0, 1e9, "nm")?;
        within(
            &format!("{field}.thickness_sd_nm"),
            self.thickness_sd_nm,
            0.0,
            thickness,
            "nm (its thickness)",
        )
    }
}

fn check_constants(field: &str, n: Option<&Dispersion>, k: f64, gain: bool) -> Result<(), RecipeError> {
    if let Some(Dispersion::Constant(n)) = n {
        within(&format!("{field}.n"), *n, 0.05, 20.0, "")?;
    }
    if let Some(Dispersion::Table(rows)) = n
        && let Some(row) = rows.iter().find(|row| row[2] < 0.0 && !gain)
    {
        return Err(wrong(&format!("{field}.n.table"), format!("k = {}", row[2]), "k must be >= 0"));
    }
    if k < 0.0 && !gain {
        return Err(wrong(
            &format!("{field}.k"),
            k,
            "k must be >= 0 (absorption); \"gain\": true in the stack allows less",
        ));
    }
    within(&format!("{field}.k"), k, -1e3, 1e3, "")
}

/// What the deserializer says, without Rust's types.
fn in_json(message: &str) -> String {
    let message = message
        .replace("expected usize", "expected a whole number, 1 or more")
        .replace("expected f64", "expected a number");
    match message.split_once("expected struct ") {
        Some((head, tail)) => {
            format!("{head}expected an object{}", tail.trim_start_matches(char::is_alphanumeric))
        }
        None => message,
    }
}

/// The deserializer takes a list for an object whose values it holds in order; a recipe does not.
fn refuse_lists(field: &str, given: &Value, read: &Value) -> Result<(), RecipeError> {
    match (given, read) {
        (Value::Array(_), Value::Object(_)) => Err(wrong(field, "a list", "expected an object")),
        (Value::Array(given), Value::Array(read)) => {
            let mut pairs = given.iter().zip(read).enumerate();
            pairs.try_for_each(|(i, (given, read))| refuse_lists(&format!("{field}[{i}]"), given, read))
        }
        (Value::Object(given), Value::Object(read)) => given.iter().try_for_each(|(key, given)| {
            let path = if field == "recipe" { key.clone() } else { format!("{field}.{key}") };
            read.get(key).map_or(Ok(()), |read| refuse_lists(&path, given, read))
        }),
        _ => Ok(()),
    }
}

fn wrong(field: &str, value: impl ToString, expected: impl Into<String>) -> RecipeError {
    RecipeError::Value { field: field.to_owned(), value: value.to_string(), expected: expected.into() }
}

fn within(field: &str, value: f64, lo: f64, hi: f64, unit: &str) -> Result<(), RecipeError> {
    if value.is_finite() && (lo..=hi).contains(&value) {
        return Ok(());
    }
    let expected = format!("expected a number from {lo} to {hi} {unit}");
    Err(wrong(field, value, expected.trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_recipes_are_valid_and_bear_their_names() {
        for (name, text) in BUILT_IN {
            assert_eq!(Recipe::from_json(text).unwrap().name, name);
            assert_eq!(built_in(name), Some(text));
        }
        assert_eq!(built_in("paper.json"), None);
        let why = |name: &str| unknown(Path::new(name));
        assert_eq!([why("paper"), why("-"), why("Cargo.toml")], [None, None, None]);
        assert!(why("akoja").is_some_and(|why| why.contains("abalone, akoya, akoya-g")));
    }

    #[test]
    fn sources_name_fields_of_their_recipe() {
        for (name, text) in BUILT_IN {
            let recipe = Recipe::from_json(text).unwrap();
            let whole = recipe.to_json();
            for field in recipe.sources.keys() {
                let pointer = format!("/{}", field.replace('.', "/"));
                assert!(whole.pointer(&pointer).is_some(), "{name}: {field}");
            }
        }
    }

    #[test]
    fn an_empty_recipe_is_the_papers_pearl() {
        let recipe = Recipe::from_json("{}").unwrap();
        assert_eq!(recipe.transport(550e-9).unwrap(), Transport::paper());
    }

    #[test]
    fn a_recipe_survives_its_own_json() {
        let text = r#"{"stack":{"layers":7,"count":"pairs","aragonite":{"n":{"cauchy":[1.5,0.01]},"k":1e-4},"emission_sources":{"depth_nm":5000}}}"#;
        let recipe = Recipe::from_json(text).unwrap();
        assert_eq!(
            recipe.stack.aragonite.thickness_nm,
            Some(450.0),
            "a key left out keeps the paper's value"
        );
        let bare = Recipe::from_json(r#"{"stack":{"substrate":{"k":0.1}}}"#).unwrap();
        assert_eq!(bare.stack.substrate.n, Some(Dispersion::Constant(1.53)));
        let again = Recipe::from_json(&recipe.to_json().to_string()).unwrap();
        assert_eq!(recipe, again);
        assert_eq!(again.transport(550e-9).unwrap().layers(), 14);
        assert_eq!(again.source_profile(), SourceProfile::Exponential { depth: 5000.0 * 1e-9 });
    }

    #[test]
    fn optical_depth_is_four_pi_k_d_over_lambda() {
        let text = r#"{"stack":{"layers":1,"aragonite":{"k":0.01,"thickness_nm":550}}}"#;
        let transport = Recipe::from_json(text).unwrap().transport(550e-9).unwrap();
        assert!((transport.optical_depths[0] - 4.0 * std::f64::consts::PI * 0.01).abs() < 1e-12);
    }

    #[test]
    fn sheets_take_the_place_of_conchiolin() {
        let sheets = |text: &str| Recipe::from_json(text).unwrap().sheet_transport(550e-9);
        let even = sheets("{}").unwrap();
        assert_eq!((even.layers(), even.indices.len(), even.sheets.unwrap().last), (250, 252, 250));
        assert!(even.indices[1..].iter().all(|n| *n == 1.53));
        let odd = sheets(r#"{"stack":{"layers":7,"substrate":{"n":1.6}}}"#).unwrap();
        assert_eq!((odd.layers(), odd.indices[5], odd.sheets.unwrap().last), (4, 1.6, 3));
        for (text, said) in [
            (r#"{"stack":{"layers":1}}"#, "stack.layers: 1 is not valid; coherent_sheets"),
            (r#"{"stack":{"explicit":[{"n":1.5,"thickness_nm":9}]}}"#, "stack.layers: an explicit list"),
            (r#"{"stack":{"conchiolin":{"k":0.1}}}"#, "stack.conchiolin.k: absorbs at 550 nm"),
            (r#"{"stack":{"substrate":{"n":1.6}}}"#, "stack.substrate.n: 1.6"),
            (r#"{"stack":{"conchiolin":{"thickness_nm":97}}}"#, "stack.conchiolin.thickness_nm: 97"),
        ] {
            let line = sheets(text).unwrap_err().to_string();
            assert!(line.contains(said) && !line.contains('\n'), "{line}");
        }
    }

    #[test]
    fn nonsense_is_refused_in_one_line_that_names_the_field() {
        for (text, field) in [
            (r#"{"stak":{}}"#, "stak"),
            (r#"{"stack":{"layers":0}}"#, "stack.layers"),
            (r#"{"stack":{"layers":2.5}}"#, "stack.layers"),
            (r#"{"stack":{"layers":-3}}"#, "stack.layers"),
            (r#"{"stack":{"aragonite":{"thickness_nm":-450}}}"#, "stack.aragonite.thickness_nm"),
            (r#"{"stack":{"aragonite":{"n":0}}}"#, "stack.aragonite.n"),
            (r#"{"stack":{"substrate":{"n":"glass"}}}"#, "stack.substrate.n"),
            (r#"{"stack":{"conchiolin":{"k":-1}}}"#, "stack.conchiolin.k"),
            (r#"{"stack":{"emission_sources":{"depth_nm":0}}}"#, "stack.emission_sources.depth_nm"),
            (r#"{"stack":{"emission_sources":"above"}}"#, "stack.emission_sources"),
            (
                r#"{"stack":{"layers":-1}}"#,
                "stack.layers: invalid value: integer `-1`, expected a whole number",
            ),
            (r#"{"stack":{"explicit":[]}}"#, "stack.explicit"),
            (r#"{"stack":{"explicit":[{"n":1.5}]}}"#, "stack.explicit[0].thickness_nm"),
            (r#"{"stack":{"layers":3,"explicit":[{"n":1.5,"thickness_nm":10}]}}"#, "stack.layers"),
            (
                r#"{"stack":{"explicit":[{"n":1.5,"thickness_nm":10}],"conchiolin":{"n":99}}}"#,
                "stack.conchiolin.n",
            ),
            ("[]", "recipe: a list is not valid; expected an object"),
            (r#"{"stack":[3]}"#, "stack: a list"),
            (
                r#"{"stack":{"explicit":[{"n":1.5,"thickness_nm":10},[1.5,0,10,0]]}}"#,
                "stack.explicit[1]: a list",
            ),
            (r#"{"look":{"thickness":[0.8,1.2]}}"#, "look.thickness: a list"),
            (r#"{"look":{"depth":"0.5"}}"#, "look.depth: invalid type: string \"0.5\", expected a number at"),
            (r#"{"azimuth":"space"}"#, "azimuth: invalid type: string \"space\", expected an object at"),
            (r#"{"facets":{"slope_sd_deg":90}}"#, "facets.slope_sd_deg"),
            (r#"{"facets":{"slope_sd_deg":-1}}"#, "facets.slope_sd_deg"),
            (r#"{"facets":{"slope_sd_deg":NaN}}"#, ""),
            (r#"{"facets":{"normals":"blinn"}}"#, "facets.normals"),
            (r#"{"look":{"depth":1.5}}"#, "look.depth"),
            (r#"{"look":{"body_rgb":[1,1]}}"#, "look.body_rgb"),
            (r#"{"look":{"thickness":{"min":0.2}}}"#, "look.thickness.min"),
            (r#"{"look":{"thickness":{"min":1,"max":1}}}"#, "look.thickness.max"),
            (r#"{"look":{"thickness":1.2}}"#, "look.thickness"),
            (r#"{"schema":"pearl-recipe/2"}"#, "schema"),
            (r#"{"light":{"wavelength_nm":0}}"#, "light.wavelength_nm"),
            ("{} {}", ""),
            ("", ""),
        ] {
            let line = Recipe::from_json(text).expect_err(text).to_string();
            assert!(line.contains(field) && !line.contains('\n'), "{text}: {line}");
        }
    }

    #[test]
    fn gain_is_allowed_where_there_is_any() {
        let gain = |stack: &str| {
            Recipe::from_json(&format!(r#"{{"stack":{{"gain":true,{stack}}}}}"#)).unwrap().film_stack().gain
        };
        use thinfilm::Gain::{Allowed, Refused};
        assert_eq!([gain(r#""layers":2"#), gain(r#""conchiolin":{"k":-0.1}"#)], [Refused, Allowed]);
        assert_eq!(
            gain(r#""explicit":[{"n":{"table":[[400,1.5,0],[700,1.5,-0.01]]},"thickness_nm":9}]"#),
            Allowed
        );
    }

    #[test]
    fn a_table_that_misses_the_wavelength_is_named() {
        let text = r#"{"stack":{"aragonite":{"n":{"table":[[400,1.6,0],[500,1.6,0]]}}}}"#;
        let line = Recipe::from_json(text).unwrap().transport(550e-9).unwrap_err().to_string();
        assert!(line.contains("stack.aragonite.n") && line.contains("400 to 500 nm"), "{line}");
    }

    #[test]
    fn the_schema_names_every_key_of_the_default_recipe() {
        let schema = Recipe::json_schema().to_string();
        for key in [
            "slope_sd_deg",
            "thickness_sd_nm",
            "width_deg",
            "body_rgb",
            "wavelength_nm",
            "explicit",
            "visible",
        ] {
            assert!(schema.contains(key), "{key}");
        }
    }
}
