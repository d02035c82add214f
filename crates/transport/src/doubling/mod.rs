//! The deterministic solver: adding and doubling of interface operators (`docs/DOUBLING.md`).
//!
//! The same Markov chain as the walk's, solved in a spectral basis. Per azimuthal mode the *value functions* on a
//! hemisphere (what a ray of direction ω will have earned when it is gone) are polynomials on Gauss–Legendre nodes;
//! an interface maps them back by a quadrature over its facets (`kernel`), so that energy closes to rounding.
//! Interfaces are joined by the adding equations, periodic parts by doubling (`star`, `stack`). The first
//! interface is kept apart: its single reflection has a closed form (`surface`) and needs no modes at all. Smooth
//! interfaces (σ = 0) need no basis at all: [`mod@smooth`].

mod facets;
mod grid;
mod kernel;
mod lu;
mod matrix;
mod product;
mod rehit;
mod settings;
mod smooth;
mod solution;
mod stack;
mod star;
mod surface;

use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

use num_complex::Complex64;
use rayon::prelude::*;

pub use self::matrix::Matrix;
pub use self::settings::{Cost, DoublingError, OPERATIONS, Settings, prices};
pub use self::smooth::smooth;
pub use self::solution::{Basis, Cells, ErrorEstimate, FAINT, Lobe, Solution, component_scale};
pub use self::surface::{Azimuth, SingleReflection};

use self::facets::{Fate, Interface};
use self::grid::Grid;
use self::kernel::{Column, columns};
use self::solution::ModeResult;
use self::stack::{Element, Run, elements, runs};
use self::star::{Mirror, Resolved, Resolvent, Slab};
use crate::problem::Face;
use crate::{Geometry, Light, Transport};

/// Resolutions that [`solve_to`] tries, and of the light from below, whose accuracy is not promised.
const ATTEMPTS: usize = 6;
const ATTEMPTS_BELOW: usize = 3;

/// Of what nobody stops.
static NEVER: AtomicBool = AtomicBool::new(false);

/// Columns of one interface at the grid's nodes: from the side of the medium named first, and from the other.
struct Sides {
    first: Complex64,
    near: Vec<Column>,
    far: Vec<Column>,
}

/// The bits of an index.
type Bits = (u64, u64);

fn bits(index: Complex64) -> Bits {
    (index.re.to_bits(), index.im.to_bits())
}

/// One interface's key: its two indices, the smaller first.
fn key(a: Complex64, b: Complex64) -> (Bits, Bits) {
    let (a, b) = (bits(a), bits(b));
    (a.min(b), a.max(b))
}

/// Solves `transport` for each incidence `theta_i` (radians, in \[0, π/2\]), and, with [`Settings::both_sides`], for light
/// from below at the same angles, measured in the substrate.
///
/// # Errors
/// [`DoublingError`] when the settings cannot represent the problem; the message says what would.
pub fn solve(
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    settings: &Settings,
) -> Result<Solution, DoublingError> {
    solve_unless(&NEVER, transport, geometry, theta_i, settings)
}

fn solve_unless(
    stop: &AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    settings: &Settings,
) -> Result<Solution, DoublingError> {
    let mut solution = solve_side(stop, transport, geometry, theta_i, settings)?;
    if settings.both_sides {
        let turned = solve_side(stop, &transport.upside_down(), geometry, theta_i, settings)?;
        solution.from_below = Some(Box::new(turned));
    }
    Ok(solution)
}

fn solve_side(
    stop: &AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    settings: &Settings,
) -> Result<Solution, DoublingError> {
    settings.check(transport, geometry, theta_i)?;
    let plan = Plan::new(stop, transport, geometry, settings)?;
    let incident = plan.incident(theta_i);
    // A mode's matrices go as soon as it is solved.
    let modes = 0..settings.modes_in(geometry);
    let results = modes.into_par_iter().map(|mode| Ok(plan.mode(stop, mode)?.solve(&incident, mode)));
    let results = results.collect::<Result<_, DoublingError>>()?;
    Ok(Solution::assemble(transport, theta_i, *settings, plan.grid, &incident, results))
}

/// A stack at one resolution, solved for light from any direction above: further incidences cost a few products each.
pub struct Operator {
    plan: Plan,
    modes: Vec<Mode>,
}

impl fmt::Debug for Operator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Operator").field("settings", &self.plan.settings).finish_non_exhaustive()
    }
}

impl Operator {
    /// Solves the stack, and stops soon after `stop` is set, from anywhere; [`Settings::both_sides`] does not matter.
    ///
    /// # Errors
    /// As [`solve`]; [`DoublingError::Stopped`].
    pub fn new_unless(
        stop: &AtomicBool,
        transport: &Transport,
        geometry: Geometry,
        settings: &Settings,
    ) -> Result<Self, DoublingError> {
        settings.check(transport, geometry, &[])?;
        let plan = Plan::new(stop, transport, geometry, settings)?;
        let modes = (0..settings.modes_in(geometry)).into_par_iter().map(|mode| plan.mode(stop, mode));
        let modes = modes.collect::<Result<_, _>>()?;
        Ok(Self { plan, modes })
    }

    fn bytes(&self) -> f64 {
        let Plan { transport, settings, grid, .. } = &self.plan;
        settings.cost(transport, grid.geometry, 0).bytes
    }

    /// The lobes of some incidences, radians: to the bit what [`solve`] finds. Stops soon after `stop` is set, from anywhere.
    ///
    /// # Errors
    /// An incidence beyond \[0, π/2\]; [`DoublingError::Stopped`].
    pub fn solve_unless(&self, stop: &AtomicBool, theta_i: &[f64]) -> Result<Solution, DoublingError> {
        let Plan { transport, settings, grid, .. } = &self.plan;
        settings::check_stack(transport, theta_i)?;
        let incident = self.plan.incident(theta_i);
        let modes = self.modes.par_iter().enumerate();
        let solved = modes.map(|(k, mode)| go_on(stop).map(|()| mode.solve(&incident, k)));
        let results = solved.collect::<Result<_, DoublingError>>()?;
        Ok(Solution::assemble(transport, theta_i, *settings, grid.clone(), &incident, results))
    }
}

/// A stack at a resolution and at the coarser one that tells its error.
#[derive(Debug)]
pub struct Checked {
    fine: Operator,
    coarse: Operator,
}

impl Checked {
    /// An operator, and with it a coarser one.
    ///
    /// # Errors
    /// As [`Operator::new_unless`].
    pub fn new_unless(stop: &AtomicBool, fine: Operator) -> Result<Self, DoublingError> {
        let Plan { transport, settings, grid, .. } = &fine.plan;
        let coarse = Operator::new_unless(stop, transport, grid.geometry, &settings.coarser())?;
        Ok(Self { fine, coarse })
    }

    /// The same stack at a finer resolution: what was fine is coarse now.
    #[must_use]
    pub fn raised(self, finer: Operator) -> Self {
        Self { fine: finer, coarse: self.fine }
    }

    /// The finer of the two.
    #[must_use]
    pub const fn operator(&self) -> &Operator {
        &self.fine
    }

    /// About what it takes of memory, bytes.
    #[must_use]
    pub fn bytes(&self) -> f64 {
        self.fine.bytes() + self.coarse.bytes()
    }

    /// Whether it is that of such a problem at such a resolution.
    #[must_use]
    pub fn is_of(&self, transport: &Transport, geometry: Geometry, settings: &Settings) -> bool {
        let Plan { transport: of, settings: at, grid, .. } = &self.fine.plan;
        (of, grid.geometry, at) == (transport, geometry, settings)
    }

    /// [`Operator::solve_unless`], with its error.
    ///
    /// # Errors
    /// As [`Operator::solve_unless`].
    pub fn solve_unless(&self, stop: &AtomicBool, theta_i: &[f64]) -> Result<Solution, DoublingError> {
        let coarse = self.coarse.solve_unless(stop, theta_i)?;
        let mut solution = self.fine.solve_unless(stop, theta_i)?;
        solution.compare(&coarse);
        Ok(solution)
    }
}

/// What the modes of a stack are solved from.
struct Plan {
    transport: Transport,
    settings: Settings,
    grid: Grid,
    elements: Vec<Element>,
    runs: Vec<Run>,
    sides: HashMap<(Bits, Bits), Sides>,
}

/// Refuses to go on where the solution is not wanted any more: asked at every interface and layer.
fn go_on(stop: &AtomicBool) -> Result<(), DoublingError> {
    if stop.load(Ordering::Relaxed) { Err(DoublingError::Stopped) } else { Ok(()) }
}

impl Plan {
    fn new(
        stop: &AtomicBool,
        transport: &Transport,
        geometry: Geometry,
        settings: &Settings,
    ) -> Result<Self, DoublingError> {
        if transport.sheets.is_some() {
            return Err(DoublingError::WalkOnly("coherent sheets are walked only: use the walk"));
        }
        match (transport.light, geometry) {
            (Light::Unpolarised, _) | (Light::S | Light::P, Geometry::Plane) => {}
            (Light::Tracked, _) => {
                return Err(DoublingError::WalkOnly("s and p have a solution each: solve both"));
            }
            (_, Geometry::Space) => {
                let why =
                    "s and p are tracked in the plane of incidence only: in space they turn into each other";
                return Err(DoublingError::WalkOnly(why));
            }
        }
        let elements = elements(transport);
        let mut plan = Self {
            transport: transport.clone(),
            settings: *settings,
            grid: Grid::new(geometry, settings.nodes),
            runs: runs(&elements),
            elements,
            sides: HashMap::new(),
        };
        let modes = settings.modes_in(geometry);
        let top = (transport.index(0), transport.index(1));
        let cells = plan.runs.iter().flat_map(|run| &plan.elements[run.start..run.start + run.period]);
        let pairs: Vec<(Complex64, Complex64)> =
            std::iter::once(top).chain(cells.map(|e| (e.above, e.below))).collect();
        for (above, below) in pairs {
            go_on(stop)?;
            let known = plan.sides.contains_key(&key(above, below));
            if !known && (above != below || (above, below) == top) {
                let side = |from: Complex64, to: Complex64| {
                    columns(&plan.interface(from, to), &plan.grid, modes, &plan.grid.theta)
                };
                let sides = Sides { first: above, near: side(above, below), far: side(below, above) };
                plan.sides.insert(key(above, below), sides);
            }
        }
        Ok(plan)
    }

    fn interface(&self, from: Complex64, to: Complex64) -> Interface {
        let Transport { facets, light, .. } = self.transport;
        Interface { face: Face::new(from, to), facets, light, sampling: self.settings.sampling(&self.grid) }
    }

    /// Light that arrives at these incidences, as it leaves the first facet.
    fn incident(&self, theta_i: &[f64]) -> Vec<Column> {
        let [ambient, first] = [self.transport.index(0), self.transport.index(1)];
        let modes = self.settings.modes_in(self.grid.geometry);
        columns(&self.interface(ambient, first), &self.grid, modes, theta_i)
    }

    /// One mode of the whole stack.
    fn mode(&self, stop: &AtomicBool, mode: usize) -> Result<Mode, DoublingError> {
        let top = self.resolved(self.transport.index(0), self.transport.index(1), mode);
        let Slab { r_below, t_below, .. } = top.slab();
        let Slab { r: body_r, t: body_t, .. } = self.body(stop, mode)?;
        let between = Resolvent::new(r_below.times(&body_r));
        Ok(Mode { top, t_below, body_r, body_t, between })
    }

    fn resolved(&self, above: Complex64, below: Complex64, mode: usize) -> Resolved {
        let sides = &self.sides[&key(above, below)];
        if sides.first == above {
            Resolved::new(&sides.near, &sides.far, mode)
        } else {
            Resolved::new(&sides.far, &sides.near, mode)
        }
    }

    /// exp(−τ/|cos θ|) at the nodes.
    fn keep(&self, depth: f64) -> Option<Vec<f64>> {
        (depth > 0.0).then(|| self.grid.theta.iter().map(|theta| (-depth / theta.cos()).exp()).collect())
    }

    /// The layers and interfaces below interface 0 in one mode.
    fn body(&self, stop: &AtomicBool, mode: usize) -> Result<Slab, DoublingError> {
        let mut interfaces: HashMap<(Bits, Bits), Slab> = HashMap::new();
        let mut body: Option<Slab> = None;
        for run in self.runs.iter().rev() {
            let top = self.run(stop, run, mode, &mut interfaces)?;
            body = Some(match body {
                None => top,
                Some(lower) => top.above(&lower),
            });
        }
        Ok(body.unwrap_or_else(|| Slab::nothing(self.grid.len())))
    }

    fn interface_slab(
        &self,
        above: Complex64,
        below: Complex64,
        mode: usize,
        known: &mut HashMap<(Bits, Bits), Slab>,
    ) -> Slab {
        if above == below {
            return Slab::nothing(self.grid.len()); // no index step: facets change nothing
        }
        let id = (bits(above), bits(below));
        if let Some(slab) = known.get(&id) {
            return slab.clone();
        }
        let slab = self.resolved(above, below, mode).slab();
        known.insert((id.1, id.0), slab.flipped());
        known.insert(id, slab.clone());
        slab
    }

    fn element(&self, element: &Element, mode: usize, known: &mut HashMap<(Bits, Bits), Slab>) -> Slab {
        let slab = self.interface_slab(element.above, element.below, mode, known);
        match self.keep(element.depth) {
            Some(keep) => slab.attenuated_above(&keep),
            None => slab,
        }
    }

    fn run(
        &self,
        stop: &AtomicBool,
        run: &Run,
        mode: usize,
        known: &mut HashMap<(Bits, Bits), Slab>,
    ) -> Result<Slab, DoublingError> {
        go_on(stop)?;
        let cell = &self.elements[run.start..run.start + run.period];
        if run.period == 2 && run.count > 1 {
            return Ok(self.pairs(cell[0], cell[1], run.count, mode, known));
        }
        let mut slab = self.element(&cell[run.period - 1], mode, known);
        for element in cell[..run.period - 1].iter().rev() {
            go_on(stop)?;
            slab = self.element(element, mode, known).above(&slab);
        }
        let lossless = mode == 0 && cell.iter().all(|element| element.depth == 0.0);
        Ok(slab.power(run.count, lossless))
    }

    /// `count` pairs of layers a, c. With half of a's absorption on either side the cell ½a·I(a|c)·c·I(c|a)·½a is
    /// its own mirror image, and doubling needs R and T only.
    fn pairs(
        &self,
        a: Element,
        c: Element,
        count: usize,
        mode: usize,
        known: &mut HashMap<(Bits, Bits), Slab>,
    ) -> Slab {
        let upper = self.interface_slab(a.above, a.below, mode, known);
        let lower = self.element(&c, mode, known);
        let pair = upper.above(&lower);
        let Some(half) = self.keep(0.5 * a.depth) else {
            return Slab::from(Mirror { r: pair.r, t: pair.t }.power(count, mode == 0 && c.depth == 0.0));
        };
        let half_above = pair.attenuated_above(&half);
        let cell = half_above.clone().flipped().attenuated_above(&half);
        let cells = Slab::from(Mirror { r: cell.r, t: cell.t }.power(count - 1, false));
        cells.above(&half_above).attenuated_above(&half)
    }
}

/// One azimuthal mode of a stack: interface 0, and what is below it.
struct Mode {
    top: Resolved,
    t_below: Matrix,
    body_r: Matrix,
    body_t: Matrix,
    /// Light that goes to and fro between the two.
    between: Resolvent,
}

impl Mode {
    fn solve(&self, incident: &[Column], mode: usize) -> ModeResult {
        let n = self.body_r.rows();
        let gather = |fate: Fate| {
            Matrix::from_fn(n, incident.len(), |j, i| {
                incident[i].deposit(fate).map_or(0.0, |deposit| deposit[(j, mode)])
            })
        };
        let back_above = gather(Fate::ReflectedBack);
        let back_below = gather(Fate::RefractedBack);
        let back = Matrix::from_fn(2 * n, incident.len(), |j, i| match j.checked_sub(n) {
            None => back_above[(j, i)],
            Some(j) => back_below[(j, i)],
        });
        let finished = self.top.finish(&back);
        let rehit = self.top.finish_above(&back_above);
        let all = 0..incident.len();
        let mut entered = gather(Fate::Refracted);
        entered += &finished.part(n..2 * n, all.clone());

        let down = self.between.times(&entered);
        let up = self.body_r.times(&down);
        let mut interior = finished.part(0..n, all).with(&rehit, |finished, rehit| finished - rehit);
        interior += &self.t_below.times(&up);
        let transmitted = self.body_t.times(&down);
        ModeResult { interior, rehit, transmitted }
    }
}

/// Solves to a total variation asked for, with the error estimated from a second, coarser resolution.
///
/// The promise is about the light that comes from above and is reflected. With `both_sides` what is transmitted is solved at
/// no less than the resolution that keeps it, and light from below by a resolution of its own: refracted along the horizon
/// it falls back in a lobe that is narrow in azimuth, at and beyond the critical angle of the last interface, which
/// takes two to three times the modes. All say by themselves how near they are ([`ErrorEstimate`]); light from below stays
/// further off than asked where more modes cannot be paid for.
///
/// # Errors
/// As [`solve`]; [`DoublingError::NotReached`] when further refinements do not bring the estimate below
/// `total_variation`.
pub fn solve_to(
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    total_variation: f64,
    both_sides: bool,
) -> Result<Solution, DoublingError> {
    solve_to_unless(&NEVER, transport, geometry, theta_i, Wanted::of(total_variation), both_sides, None)
}

/// A total variation that is wanted: the resolution is chosen for `aim`, and one whose estimate is within `most` will do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// What the settings are chosen for.
    pub aim: f64,
    /// What the estimate may come to.
    pub most: f64,
    /// How often the resolution for `aim` is known to be too coarse.
    pub raised: u32,
}

impl Wanted {
    /// The same for both.
    #[must_use]
    pub const fn of(total_variation: f64) -> Self {
        Self { aim: total_variation, most: total_variation, raised: 0 }
    }

    /// The resolution that is tried first.
    #[must_use]
    pub fn settings(&self, transport: &Transport, geometry: Geometry) -> Settings {
        let first = Settings::for_accuracy(transport, geometry, self.aim);
        (0..self.raised).fold(first, |settings, _| settings.finer())
    }

    /// The one that it is compared with: where it was raised, the one before.
    fn coarser(&self, transport: &Transport, geometry: Geometry) -> Settings {
        match self.raised.checked_sub(1) {
            Some(raised) => Self { raised, ..*self }.settings(transport, geometry),
            None => self.settings(transport, geometry).coarser(),
        }
    }
}

/// [`solve_to`], which stops soon after `stop` is set, from anywhere. Where the stack is `known` at the resolution that is called for,
/// and at the coarser one, it is not solved again: the solution is the same to the bit.
///
/// # Errors
/// As [`solve_to`]; [`DoublingError::Stopped`].
pub fn solve_to_unless(
    stop: &AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    wanted: Wanted,
    both_sides: bool,
    known: Option<&Checked>,
) -> Result<Solution, DoublingError> {
    let Wanted { aim, most: total_variation, .. } = wanted;
    for value in [aim, total_variation] {
        if !(1e-9..=0.5).contains(&value) {
            let expected = "from 1e-9 to 0.5";
            return Err(DoublingError::Domain { field: "total_variation", value, expected });
        }
    }
    let mut settings = wanted.settings(transport, geometry);
    // Attempts that each could be paid for can be too dear together.
    let mut spent = settings.check_first_attempt(transport, geometry, theta_i)?;
    let solve = |settings: &Settings| solve_unless(stop, transport, geometry, theta_i, settings);
    let compared = |coarse: &Solution, settings: &Settings| -> Result<Solution, DoublingError> {
        let mut solution = solve(settings)?;
        solution.compare(coarse);
        Ok(solution)
    };
    let mut solution = match known.filter(|known| known.is_of(transport, geometry, &settings)) {
        Some(known) => known.solve_unless(stop, theta_i)?,
        None => compared(&solve(&wanted.coarser(transport, geometry))?, &settings)?,
    };
    let mut reached = f64::INFINITY;
    for attempt in 1..=ATTEMPTS {
        reached = solution.error.as_ref().map_or(reached, ErrorEstimate::worst);
        if reached <= total_variation && both_sides {
            return solve_both(stop, transport, geometry, theta_i, &settings, total_variation);
        }
        if reached <= total_variation {
            return Ok(solution);
        }
        if attempt < ATTEMPTS {
            settings = settings.finer();
            spent = settings.check_price(transport, geometry, theta_i.len(), spent)?;
            solution = compared(&solution, &settings)?;
        }
    }
    Err(DoublingError::NotReached { asked: total_variation, reached, nodes: settings.nodes })
}

/// Both sides: from above refined from `settings` until what is transmitted keeps `total_variation` as well, or until more cannot be
/// paid for; from below as finely as the stack upside down asks for.
fn solve_both(
    stop: &AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    settings: &Settings,
    total_variation: f64,
) -> Result<Solution, DoublingError> {
    let settings = Settings { both_sides: true, ..*settings };
    let mut solution = refined(stop, transport, geometry, theta_i, settings, total_variation)?;
    let turned = transport.upside_down();
    solution.from_below =
        Some(Box::new(solve_below(stop, &turned, geometry, theta_i, &solution.settings, total_variation)?));
    Ok(solution)
}

/// One side of several lobes, refined from `settings` until all keep `total_variation` or until more cannot be paid for.
fn refined(
    stop: &AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    mut settings: Settings,
    total_variation: f64,
) -> Result<Solution, DoublingError> {
    let mut coarse = solve_side(stop, transport, geometry, theta_i, &settings.coarser())?;
    let mut attempts = 0;
    loop {
        let mut solution = solve_side(stop, transport, geometry, theta_i, &settings)?;
        solution.compare(&coarse);
        attempts += 1;
        let kept = solution.error.as_ref().is_some_and(|error| {
            error.transmitted.iter().fold(error.worst(), |worst, tv| worst.max(*tv)) <= total_variation
        });
        let finer = settings.finer();
        if kept || attempts == ATTEMPTS_BELOW || finer.check(transport, geometry, theta_i).is_err() {
            return Ok(solution);
        }
        settings = finer;
        coarse = solution;
    }
}

/// The stack upside down, refined until it keeps `total_variation` or until more cannot be paid for.
fn solve_below(
    stop: &AtomicBool,
    turned: &Transport,
    geometry: Geometry,
    theta_i: &[f64],
    above: &Settings,
    total_variation: f64,
) -> Result<Solution, DoublingError> {
    let wanted = Settings::for_lobe(turned, geometry, total_variation);
    let affordable = |settings: &Settings| settings.check(turned, geometry, theta_i).is_ok();
    let mut settings =
        Settings { nodes: above.nodes.max(wanted.nodes), modes: above.modes.max(wanted.modes), ..*above };
    let grazing =
        Settings { modes: settings.modes.max(Settings::grazing_modes(turned, total_variation)), ..settings };
    if geometry == Geometry::Space && affordable(&grazing) {
        settings = grazing;
    }
    refined(stop, turned, geometry, theta_i, settings, total_variation)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// R′ and T′ of the slab's own star product, column by column, against the stack solved upside down.
    #[test]
    fn light_from_below_is_light_from_above_of_the_stack_upside_down() {
        let mut transport = Transport::alternating(4, 1.6, 1.3, 1.5, 0.1);
        transport.indices = vec![1.0, 1.6, 1.3, 1.6, 1.45, 1.5];
        transport.optical_depths = vec![0.1, 0.0, 0.02, 0.3];
        let settings = Settings { nodes: 24, modes: 4, reach: 6.0, density: 0.75, both_sides: true };
        for geometry in [Geometry::Plane, Geometry::Space] {
            let grid = Grid::new(geometry, settings.nodes);
            let solution = solve(&transport, geometry, &grid.theta, &settings).unwrap();
            let slab = whole_slab(&transport, geometry, &settings);
            let below = solution.from_below.unwrap();
            for (k, lobe) in below.lobes.iter().enumerate() {
                let sums = [&slab.r_below, &slab.t_below].map(|part| part.column(k).iter().sum::<f64>());
                // Two orders of the same products: rounding.
                assert!((lobe.albedo - sums[0]).abs() < 1e-11, "{geometry:?} {k}: {lobe:?} {sums:?}");
                assert!((lobe.transmitted - sums[1]).abs() < 1e-11, "{geometry:?} {k}: {lobe:?} {sums:?}");
            }
        }
    }

    /// What layers that hardly absorb leave to ring far from a narrow lobe does not widen it: the lobe is that of the clear stack.
    #[test]
    fn the_width_of_a_faint_narrow_lobe_does_not_ring() {
        let mut clear = Transport::alternating(13, 1.3918, 1.3714, 2.0151, 0.633_f64.to_radians());
        clear.indices[0] = 1.52;
        let mut absorbing = clear.clone();
        absorbing.optical_depths = (0..13).map(|layer| if layer % 2 == 0 { 2e-5 } else { 8e-7 }).collect();
        let incidences: Vec<f64> = (0..6).map(|k| (8.3 + 0.07 * f64::from(k)).to_radians()).collect();
        let solve = |transport| solve_to(transport, Geometry::Plane, &incidences, 1e-3, false).unwrap().lobes;
        for (clear, absorbing) in solve(&clear).iter().zip(solve(&absorbing)) {
            let apart = absorbing.sd / clear.sd - 1.0;
            assert!(apart.abs() < 1e-3, "{apart:e} at {}°", clear.theta_i.to_degrees());
        }
    }

    /// Mode 0 of all interfaces, joined.
    fn whole_slab(transport: &Transport, geometry: Geometry, settings: &Settings) -> Slab {
        let plan = Plan::new(&NEVER, transport, geometry, settings).unwrap();
        plan.resolved(transport.index(0), transport.index(1), 0).slab().above(&plan.body(&NEVER, 0).unwrap())
    }

    #[test]
    fn a_stop_is_heard_before_and_between_interfaces_and_modes() {
        // Layers that never repeat: no run has more than one.
        let mut transport = Transport::alternating(6, 1.6, 1.3, 1.5, 0.1);
        transport.indices = vec![1.0, 1.6, 1.3, 1.55, 1.35, 1.5, 1.45, 1.4];
        let stop = AtomicBool::new(false);
        let settings = Settings { nodes: 12, modes: 4, reach: 6.0, density: 0.75, both_sides: false };
        let plan = Plan::new(&stop, &transport, Geometry::Space, &settings).unwrap();
        assert!(plan.mode(&stop, 0).is_ok());
        stop.store(true, Ordering::Relaxed);
        assert_eq!(plan.mode(&stop, 1).err(), Some(DoublingError::Stopped));
        let operator = Operator::new_unless(&stop, &transport, Geometry::Space, &settings);
        assert_eq!(operator.err(), Some(DoublingError::Stopped));
        let again = Plan::new(&stop, &transport, Geometry::Space, &settings);
        assert_eq!(again.err(), Some(DoublingError::Stopped));
        for both_sides in [false, true] {
            let solved = solve_to_unless(
                &stop,
                &transport,
                Geometry::Plane,
                &[0.5],
                Wanted::of(0.05),
                both_sides,
                None,
            );
            assert_eq!(solved.err(), Some(DoublingError::Stopped));
        }
    }
}
