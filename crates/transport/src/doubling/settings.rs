//! How finely the solver works, what that costs, and what it refuses.

use std::collections::HashSet;
use std::f64::consts::FRAC_PI_2;

use super::facets::Sampling;
use super::grid::Grid;
use super::key;
use super::stack::{elements, runs};
use crate::{Geometry, Transport};

/// Memory that the solver may plan for, bytes.
const LARGEST_PLAN: f64 = 6.0 * (1u64 << 30) as f64;

/// Longest time that the solver may plan for, seconds of one core: beyond it the walk has long been through.
const LONGEST_PLAN: f64 = 120.0;

/// What [`Cost::counts`] counts, and [`prices`] prices.
pub const OPERATIONS: [&str; 5] =
    ["multiply-add of a facet", "facet", "product", "incidence", "grazing incidence"];

/// Seconds of one AVX-512 core that each of [`OPERATIONS`] takes, fitted to whole bakes (as
/// `cargo run --release -p bake-brdf --example prices` does).
#[must_use]
pub const fn prices(geometry: Geometry) -> [f64; OPERATIONS.len()] {
    match geometry {
        Geometry::Plane => [2e-10, 3.4e-7, 6.2e-11, 0.0, 2.6e-4],
        Geometry::Space => [1.2e-11, 3e-7, 5e-11, 3.9e-4, 5.5e-4],
    }
}

/// Nodes below which products and solves fall behind the machine's rate: they take 1 + this/N times as long, and are
/// counted so often.
const SMALL: f64 = 80.0;

/// Resolution of the solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// N: nodes a hemisphere and medium.
    pub nodes: usize,
    /// Azimuthal modes of the interior (space; the plane always has its two parities).
    pub modes: usize,
    /// Facets beyond this many σ are left out.
    pub reach: f64,
    /// Density of the facet quadrature; 1 resolves every basis function in full.
    pub density: f64,
    /// Whether to solve for light from below, too ([`super::Solution::from_below`]).
    pub both_sides: bool,
}

/// What a solution will cost: orders of magnitude, from operation counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Peak memory, bytes.
    pub bytes: f64,
    /// Time of one core, seconds: the counts at their [`prices`].
    pub seconds: f64,
    /// How often each of [`OPERATIONS`] is done.
    pub counts: [f64; OPERATIONS.len()],
}

/// Why the solver does not answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DoublingError {
    /// A number outside its range.
    #[error("{field} = {value}: {expected}")]
    Domain {
        /// What the number is.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// The stack's lists do not fit together.
    #[error("{layers} optical depths want {} indices (ambient, layers, substrate), found {indices}", layers + 2)]
    Shape {
        /// Optical depths found.
        layers: usize,
        /// Indices found.
        indices: usize,
    },
    /// The resolution that the problem needs is out of reach.
    #[error(
        "slope_sd = {slope_sd_deg}°: lobes this narrow need {nodes} nodes and {modes} modes, about {gibibytes:.1} GiB \
         and {seconds:.0} s of one core (at most 6 GiB and 120 s are planned for); use the walk, the plane (azimuth \
         decay), a lower accuracy or a wider slope_sd"
    )]
    TooCostly {
        /// σ in degrees.
        slope_sd_deg: f64,
        /// Nodes a hemisphere.
        nodes: usize,
        /// Azimuthal modes.
        modes: usize,
        /// Predicted memory.
        gibibytes: f64,
        /// Predicted time.
        seconds: f64,
    },
    /// A problem that doubling does not solve as it stands.
    #[error("{0}")]
    WalkOnly(&'static str),
    /// Whoever asked wants it no more.
    #[error("stopped")]
    Stopped,
    /// The error estimate stayed above what was asked.
    #[error(
        "total variation {asked:e} asked, {reached:.1e} reached with {nodes} nodes: ask for less, or use the walk"
    )]
    NotReached {
        /// Total variation asked for.
        asked: f64,
        /// Total variation estimated.
        reached: f64,
        /// Nodes of the last attempt.
        nodes: usize,
    },
}

impl Settings {
    /// Settings that reach `total_variation` (½∫|p − p_true| as a share of the reflected light) at the worst
    /// incidence, from fits to 500-layer stacks, σ = 1…25°. [`super::solve_to`] checks them on the problem at hand.
    #[must_use]
    pub fn for_accuracy(transport: &Transport, geometry: Geometry, total_variation: f64) -> Self {
        let settings = Self::for_lobe(transport, geometry, total_variation);
        Self {
            modes: settings.modes.max(Self::trapped_modes(transport, geometry, total_variation)),
            ..settings
        }
    }

    /// Modes that light needs which enters a first layer of lower index than the ambient near its critical angle, runs along
    /// the horizon between total reflections, and leaves in a lobe narrow in azimuth (none in other stacks): its error is 11 % with
    /// 234/σ° modes and halves with every 31/σ° (fit to n = 0.9 over 0.8, σ = 2°; 0.95 over 0.9 and 0.98 over 0.97 need no more).
    fn trapped_modes(transport: &Transport, geometry: Geometry, total_variation: f64) -> usize {
        let first = transport.indices.get(1).copied().unwrap_or(f64::INFINITY);
        if geometry == Geometry::Plane || transport.indices[0] <= first {
            return 0;
        }
        let sigma = transport.facets.slope_sd.to_degrees().max(1e-6);
        let halvings = (0.11 / total_variation.clamp(1e-6, 0.11)).log2();
        ((234.0 + 31.0 * halvings) / sigma).ceil() as usize
    }

    /// Settings that resolve what a stack makes of its narrowest lobe.
    pub(super) fn for_lobe(transport: &Transport, geometry: Geometry, total_variation: f64) -> Self {
        let digits = -total_variation.clamp(1e-10, 0.1).log10();
        let sigma = transport.facets.slope_sd.to_degrees().max(1e-6);
        // A single reflection in the first layer, refracted out, is the narrowest lobe there is: a low index
        // there narrows it.
        let narrowing =
            transport.indices.get(1).map_or(1.0, |first| (1.3 * transport.indices[0] / first).max(1.0));
        let more = (digits - 3.0).max(-2.0);
        let nodes = narrowing * (186.0 + 25.0 * more) / sigma + 4.0 + 0.75 * more.max(0.0).powi(3);
        let modes = narrowing * (69.0 + 13.0 * more) / sigma + 5.0 + 2.0 * more.max(0.0);
        let floor = if geometry == Geometry::Plane { 28.0 } else { 16.0 };
        // The plane's lobes have kinks that the azimuth smooths out in space.
        let nodes = if geometry == Geometry::Plane { (1.15 - 0.03 * more) * nodes } else { nodes };
        Self {
            nodes: nodes.max(floor).ceil() as usize,
            modes: if geometry == Geometry::Plane { 2 } else { modes.max(8.0).ceil() as usize },
            reach: (2.0 * digits * std::f64::consts::LN_10 + 20.0).sqrt().clamp(5.0, 8.0),
            density: (0.7 + 0.1 * more).clamp(0.65, 1.0),
            both_sides: false,
        }
    }

    /// Modes that light needs which enters the stack near the critical angle of its first interface, runs along the horizon and
    /// falls back (none where the first layer is no thinner a medium): its error halves with every 42/σ° modes, and
    /// is 11 % with 88/σ° (fit to R′ of the paper's pearl, σ = 2°).
    pub(super) fn grazing_modes(transport: &Transport, total_variation: f64) -> usize {
        if transport.indices[0] <= transport.indices[1] {
            return 0;
        }
        let sigma = transport.facets.slope_sd.to_degrees().max(1e-6);
        let halvings = (0.11 / total_variation.clamp(1e-6, 0.11)).log2();
        ((88.0 + 42.0 * halvings) / sigma).ceil() as usize
    }

    /// The next coarser resolution, for an error estimate.
    #[must_use]
    pub fn coarser(&self) -> Self {
        Self {
            nodes: (0.8 * self.nodes as f64).floor().max(4.0) as usize,
            modes: (0.8 * self.modes as f64).floor().max(2.0) as usize, // the plane keeps its two
            reach: 0.93 * self.reach,
            density: 0.95 * self.density,
            both_sides: self.both_sides,
        }
    }

    /// The next finer resolution.
    #[must_use]
    pub fn finer(&self) -> Self {
        Self {
            nodes: (1.25 * self.nodes as f64).ceil() as usize,
            modes: if self.modes <= 2 { self.modes } else { (1.25 * self.modes as f64).ceil() as usize },
            reach: (1.1 * self.reach).min(8.0),
            density: 1.2 * self.density,
            both_sides: self.both_sides,
        }
    }

    /// Cost of `incidences` columns of this problem at these settings.
    #[must_use]
    pub fn cost(&self, transport: &Transport, geometry: Geometry, incidences: usize) -> Cost {
        let elements = elements(transport);
        let runs = runs(&elements);
        let cells = runs.iter().flat_map(|run| &elements[run.start..run.start + run.period]);
        let pairs: HashSet<_> = cells.map(|e| key(e.above, e.below)).collect();
        let products: usize = runs.iter().map(super::stack::Run::products).sum();
        let (n, modes) = (self.nodes as f64, self.modes_in(geometry) as f64);
        let sigma = transport.facets.slope_sd;
        // Steeper facets face away from most rays.
        let reach = (self.reach * sigma).min(2.3);
        let line = 2.0 * reach * (3.5 * n * self.density) / 6.3 + 0.3 * self.reach * self.reach + 8.0;
        let facets = if geometry == Geometry::Plane { line } else { 0.4 * line * line };
        let columns = 2.0 * n * (pairs.len() + 1) as f64 + incidences as f64;
        let incidences = incidences as f64;
        // One multiply-add each for reflected and refracted light, and the facets' own arithmetic.
        let multiply_adds = match geometry {
            Geometry::Plane => 4.0 * columns * facets * n,
            Geometry::Space => 1.6 * columns * facets * n * (modes + 12.0),
        };
        let adding = 10.0 * (pairs.len() + 1) as f64 + 6.0 * products as f64;
        let adding = (1.0 + SMALL / n) * modes * n * n * n * adding;
        // The single reflection of an incidence near enough to the horizon for facets to throw it over is integrated at length;
        // lobes that fill the hemisphere take no longer.
        let grazing = (6.0 * sigma / FRAC_PI_2).min(0.4) * incidences;
        let counts = [multiply_adds, columns * facets, adding, incidences, grazing];
        Cost {
            bytes: 8.0 * n * modes * (2.5 * columns + 3.0 * incidences) + 200.0 * n * n * 8.0,
            seconds: counts.iter().zip(prices(geometry)).map(|(count, price)| count * price).sum(),
            counts,
        }
    }

    /// Refuses what cannot be right or cannot be paid for: what [`super::solve`] checks first.
    ///
    /// # Errors
    /// As [`super::solve`].
    pub fn check(
        &self,
        transport: &Transport,
        geometry: Geometry,
        theta_i: &[f64],
    ) -> Result<(), DoublingError> {
        check_problem(transport, theta_i)?;
        // Too many of them are too costly, which says why there are so many.
        domain("nodes", self.nodes as f64, self.nodes >= 4, "at least 4")?;
        domain("modes", self.modes as f64, self.modes >= 1, "at least 1")?;
        domain("reach", self.reach, (3.0..=12.0).contains(&self.reach), "from 3 to 12 standard deviations")?;
        domain("density", self.density, (0.3..=8.0).contains(&self.density), "from 0.3 to 8")?;
        self.check_price(transport, geometry, theta_i.len(), 0.0).map(drop)
    }

    /// Refuses what cannot be paid for once `spent` seconds of one core have been; else what is spent with it.
    ///
    /// # Errors
    /// [`DoublingError::TooCostly`] with the price of all.
    pub(super) fn check_price(
        &self,
        transport: &Transport,
        geometry: Geometry,
        incidences: usize,
        spent: f64,
    ) -> Result<f64, DoublingError> {
        let cost = self.cost(transport, geometry, incidences);
        let seconds = spent + cost.seconds;
        if cost.bytes <= LARGEST_PLAN && seconds <= LONGEST_PLAN {
            return Ok(seconds);
        }
        Err(DoublingError::TooCostly {
            slope_sd_deg: transport.facets.slope_sd.to_degrees(),
            nodes: self.nodes,
            modes: self.modes_in(geometry),
            gibibytes: cost.bytes / (1u64 << 30) as f64,
            seconds,
        })
    }

    /// Refuses to begin on a total variation whose first attempt (these settings and the coarser ones that it is compared
    /// with) cannot be right or cannot be paid for; else its price in seconds of one core.
    ///
    /// # Errors
    /// As [`super::solve`].
    pub fn check_first_attempt(
        &self,
        transport: &Transport,
        geometry: Geometry,
        theta_i: &[f64],
    ) -> Result<f64, DoublingError> {
        self.check(transport, geometry, theta_i)?;
        let coarse = self.coarser().cost(transport, geometry, theta_i.len()).seconds;
        self.check_price(transport, geometry, theta_i.len(), coarse)
    }

    pub(super) fn modes_in(&self, geometry: Geometry) -> usize {
        match geometry {
            Geometry::Plane => 2,
            Geometry::Space => self.modes,
        }
    }

    pub(super) fn sampling(&self, grid: &Grid) -> Sampling {
        let mode = self.modes as f64;
        Sampling {
            reach: self.reach,
            degree: grid.polynomials() as f64,
            modes: [mode, mode],
            density: self.density,
        }
    }
}

fn domain(field: &'static str, value: f64, ok: bool, expected: &'static str) -> Result<(), DoublingError> {
    if ok { Ok(()) } else { Err(DoublingError::Domain { field, value, expected }) }
}

/// What every stack and incidence must be, rough or smooth.
pub(super) fn check_stack(transport: &Transport, theta_i: &[f64]) -> Result<(), DoublingError> {
    if transport.indices.len() != transport.layers() + 2 {
        return Err(DoublingError::Shape { layers: transport.layers(), indices: transport.indices.len() });
    }
    for &index in &transport.indices {
        domain("index", index, index.is_finite() && index > 0.0, "finite and > 0")?;
    }
    let clear_or_each = [0, transport.indices.len()].contains(&transport.extinctions.len());
    domain("extinctions", transport.extinctions.len() as f64, clear_or_each, "none, or one for each index")?;
    for &k in &transport.extinctions {
        domain("extinction", k, k.is_finite() && k >= 0.0, "finite and ≥ 0")?;
    }
    for &depth in &transport.optical_depths {
        domain("optical_depth", depth, depth >= 0.0, "≥ 0")?;
    }
    for &theta in theta_i {
        domain("theta_i", theta, (0.0..=FRAC_PI_2).contains(&theta), "from 0 to π/2")?;
    }
    Ok(())
}

fn check_problem(transport: &Transport, theta_i: &[f64]) -> Result<(), DoublingError> {
    check_stack(transport, theta_i)?;
    let sigma = transport.facets.slope_sd;
    domain("slope_sd", sigma, sigma > 0.0, "> 0 (smooth interfaces have no lobe to resolve: see `smooth`)")?;
    domain("slope_sd", sigma, sigma <= 0.61, "at most 0.61 rad (35°); the walk goes to 55°")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stack whose first attempt at 1e-3 can be paid for at `sigma_deg`.
    fn low_index(sigma_deg: f64) -> Transport {
        Transport::alternating(500, 0.9, 0.8, 1.53, sigma_deg.to_radians())
    }

    #[test]
    fn what_was_spent_before_counts_in_the_price() {
        let (transport, theta_i) = (low_index(2.0), [0.0, 1.0]);
        let settings = Settings::for_accuracy(&transport, Geometry::Space, 1e-2);
        let own = settings.cost(&transport, Geometry::Space, 2).seconds;
        assert!(settings.check(&transport, Geometry::Space, &theta_i).is_ok());
        let spent = LONGEST_PLAN - own;
        assert!(settings.check_price(&transport, Geometry::Space, 2, 0.99 * spent).is_ok());
        let refusal = settings.check_price(&transport, Geometry::Space, 2, 1.01 * spent).unwrap_err();
        let expected = 1.01 * spent + own;
        assert!(
            matches!(refusal, DoublingError::TooCostly { seconds, .. } if seconds == expected),
            "{refusal}"
        );
    }

    /// Fine and coarse settings that only together are too dear.
    #[test]
    fn a_first_attempt_is_priced_with_the_coarser_one_it_is_compared_with() {
        let transport = low_index(2.0);
        let price = |settings: &Settings| settings.cost(&transport, Geometry::Space, 1).seconds;
        let mut settings = Settings::for_accuracy(&transport, Geometry::Space, 1e-2);
        while price(&settings) + price(&settings.coarser()) <= LONGEST_PLAN {
            settings.nodes += 1;
        }
        assert!(settings.check(&transport, Geometry::Space, &[0.5]).is_ok(), "{settings:?}");
        let refusal = settings.check_first_attempt(&transport, Geometry::Space, &[0.5]).unwrap_err();
        assert!(matches!(refusal, DoublingError::TooCostly { .. }), "{refusal}");
    }

    #[test]
    fn a_first_layer_of_low_index_takes_modes_for_light_along_the_horizon() {
        let modes = |transport: &Transport, geometry| Settings::for_accuracy(transport, geometry, 1e-2).modes;
        // 1 %: log₂ 11 halvings of 11 %.
        assert_eq!(modes(&low_index(2.0), Geometry::Space), 171);
        assert_eq!(modes(&low_index(2.0), Geometry::Plane), 2);
        assert!(modes(&Transport::paper(), Geometry::Space) < 40);
    }
}
