//! A request: a recipe, what of it is baked, and how well.

use super::{BakeError, Grid, NEVER, exit_axis};
use crate::effects::{Effect, EffectSet, Effects, View};
use crate::options::{Options, Sides, SolverChoice};
use crate::recipe::{AzimuthMode, Recipe};
use crate::spectra::{self, Colours, Wanted};
use lut_io::axis::ExitAxis;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use transport::doubling::{Checked, Settings};
use transport::{Geometry, Light, Transport};

/// Bounds of the colour difference ΔE00 that colours are baked to.
const COLOUR_ACCURACY: [f64; 2] = [0.3, 5.0];

/// What is baked.
#[derive(Clone, Debug)]
pub struct Request {
    /// The pearl, with the azimuth mode that is baked.
    pub recipe: Recipe,
    /// The effects that [`Options::effects`] came to.
    pub effects: EffectSet,
    /// How well.
    pub options: Options,
    /// Rows and cells.
    pub grid: Grid,
    /// The stacks that were solved to place them: kept, so that they need not be solved again.
    pub(crate) placed_by: Vec<Arc<Checked>>,
    /// Seconds by the clock that placing rows and cells took; 0 where they are read from a file.
    pub placing_seconds: f64,
}

impl Request {
    /// The request for a recipe under its own look.
    ///
    /// # Errors
    /// A listed effect that this version does not simulate, or a bad request.
    pub fn new(recipe: Recipe, options: Options) -> Result<Self, BakeError> {
        let view = View::of_look(&recipe.look);
        let (recipe, decisions) = options.decide(recipe, &view)?;
        Self::of(recipe, decisions.set(), options)
    }

    /// The request for effects that are decided: places its grid.
    ///
    /// # Errors
    /// A bad request.
    pub fn of(recipe: Recipe, effects: EffectSet, options: Options) -> Result<Self, BakeError> {
        Self::of_unless(&NEVER, recipe, effects, options)
    }

    /// [`Self::of`], which stops soon after `stop` is set, from anywhere.
    ///
    /// # Errors
    /// As [`Self::of`]; [`BakeError::Interrupted`].
    pub fn of_unless(
        stop: &AtomicBool,
        recipe: Recipe,
        effects: EffectSet,
        options: Options,
    ) -> Result<Self, BakeError> {
        let width = recipe.facets.slope_sd_deg.to_radians();
        let geometry = geometry_of(&recipe);
        let mut request = Self {
            recipe,
            effects,
            options,
            grid: Grid {
                incident_deg: Vec::new(),
                axis: exit_axis(geometry, width),
                refinements: 0,
                raised: 0,
            },
            placed_by: Vec::new(),
            placing_seconds: 0.0,
        };
        let started = Instant::now();
        (request.grid, request.placed_by) = Grid::of(stop, &request)?;
        request.placing_seconds = started.elapsed().as_secs_f64();
        Ok(request)
    }

    /// Who is to solve: the options' choice, else the recipe's; both sides are for doubling alone.
    #[must_use]
    pub fn wanted_solver(&self) -> SolverChoice {
        let of_recipe = match self.options.sides {
            Sides::Above => self.recipe.solver,
            Sides::Both => SolverChoice::Doubling,
        };
        self.options.solver.unwrap_or(of_recipe)
    }

    /// A stack as it was solved to place rows and cells, at these settings.
    pub(super) fn solved_before(&self, transport: &Transport, settings: &Settings) -> Option<&Checked> {
        let is_it = |stack: &&Checked| stack.is_of(transport, self.geometry(), settings);
        self.placed_by.iter().map(Arc::as_ref).find(is_it)
    }

    /// Plane or space, as the recipe's azimuth mode needs.
    #[must_use]
    pub fn geometry(&self) -> Geometry {
        geometry_of(&self.recipe)
    }

    /// The exit cells of the table.
    #[must_use]
    pub fn exit_axis(&self) -> ExitAxis {
        self.grid.axis
    }

    /// The transport problem at the recipe's wavelength, of the effects that are baked.
    ///
    /// # Errors
    /// As [`Recipe::transport`].
    pub fn transport(&self) -> Result<Transport, BakeError> {
        let wavelength = self.recipe.wavelength();
        let has = |effect| self.effects.contains(effect);
        let mut transport = if has(Effect::CoherentSheets) && has(Effect::Blur) {
            self.recipe.sheet_transport(wavelength)?
        } else {
            self.recipe.transport(wavelength)?
        };
        if has(Effect::Polarisation) && has(Effect::Blur) {
            transport.light = Light::Tracked;
        }
        if !has(Effect::Absorption) {
            transport.make_clear();
        }
        if !has(Effect::Blur) {
            // The surface alone: what passes it goes on into more of the same, where nothing reflects.
            let [ambient, first] = [transport.indices[0], transport.indices[1]];
            transport.indices = vec![ambient, first, first];
            transport.optical_depths = vec![0.0];
            transport.extinctions.clear();
        }
        Ok(transport)
    }

    /// The same request at a wavelength, nm.
    #[must_use]
    pub fn at_wavelength(&self, nm: f64) -> Self {
        let mut request = self.clone();
        request.recipe.light.wavelength_nm = nm;
        request
    }

    /// The same request at other angles of incidence, degrees.
    #[must_use]
    pub(super) fn at_incidences(&self, incident_deg: Vec<f64>) -> Self {
        let mut request = self.clone();
        request.grid.incident_deg = incident_deg;
        request
    }

    /// Angles of incidence, radians.
    #[must_use]
    pub fn theta_i(&self) -> Vec<f64> {
        self.grid.incident_deg.iter().map(|angle| angle.to_radians()).collect()
    }

    /// The interference colours that the effects call for.
    pub(super) fn colours(&self, stop: &AtomicBool) -> Result<Colours, BakeError> {
        Ok(spectra::of(stop, &self.recipe, self.wanted_colours(), self.colour_accuracy())?)
    }

    /// The colour difference ΔE00 to which colours are wanted: a unit for each per cent of the lobe's accuracy, within bounds.
    #[must_use]
    pub fn colour_accuracy(&self) -> f64 {
        let [least, most] = COLOUR_ACCURACY;
        (100.0 * self.options.target.share()).clamp(least, most)
    }

    /// Which interference colours the effects call for: a listed one that this stack cannot have is an error.
    pub(super) fn wanted_colours(&self) -> Wanted {
        Wanted::by_effects(self.effects, matches!(self.options.effects, Effects::Listed(_)))
    }

    /// Names what a bake of this request by this solver holds: equal for equal tables (`content_hash` of the metadata).
    ///
    /// SHA-256 over the version, the recipe and all that the numbers depend on, in hexadecimal; both sides are named behind it.
    #[must_use]
    pub fn content_hash(&self, solver: SolverChoice) -> String {
        use sha2::Digest as _;
        let options = &self.options;
        // Without a lobe neither incidences nor seed matter.
        let lobe = self.effects.has_lobe().then(|| {
            // 32 bits asked for or chosen are the same bits.
            let precision = self.transport().map(|transport| options.precision.resolve(&transport)).ok();
            let walk = (options.seed, options.event_cap, precision);
            let walk = (solver != SolverChoice::Doubling).then_some(walk);
            let mut grid = self.grid.clone();
            if solver != SolverChoice::Doubling {
                // A walk is no finer for it.
                (grid.refinements, grid.raised) = (0, 0);
            }
            (solver, grid, options.target, walk)
        });
        // Who is preferred says nothing of what is solved.
        let recipe = Recipe { solver, ..self.recipe.clone() };
        let content = serde_json::json!({
            "writer": concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")),
            "recipe": recipe.to_json(),
            "effects": self.effects,
            "colours": self.colour_accuracy(),
            "lobe": lobe,
        });
        let digest = sha2::Sha256::digest(content.to_string().as_bytes());
        let hash = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        match options.sides {
            Sides::Above => hash,
            Sides::Both => hash + "-both-sides",
        }
    }
}

const fn geometry_of(recipe: &Recipe) -> Geometry {
    match recipe.azimuth.mode {
        AzimuthMode::Decay => Geometry::Plane,
        AzimuthMode::Space => Geometry::Space,
    }
}
