//! Exit-angle axes that follow a lobe: cells are narrow around the mirror direction and widen away from it.
//!
//! One coordinate is x = c ± w·sinh(t·asinh(r/w)), t ∈ [0, 1], on each side of a centre c, with r the room on
//! that side: equal steps in t are steps of about w·t near the centre and of constant *relative* size far
//! from it, so one axis serves lobes from 0.01° to 60° wide. Both sides have the same number of cells.
//! Rows at different incidences line up at the same cell index: the centre, the horizon and everything
//! between, which is what makes interpolation between rows follow the lobe.

use super::limits::MAX_AXIS_CELLS;
use crate::error::{FieldError, check, ensure};
use std::f64::consts::{FRAC_PI_2, PI};

/// Largest stretch width w, radians: wider lobes need no refinement.
pub const MAX_WIDTH: f64 = PI / 6.0;
/// Smallest stretch width w, radians.
pub const MIN_WIDTH: f64 = 1e-7;

/// A stretched interval: `cells` cells between `lo` and `hi`, finest around `centre`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretched {
    /// Lower end, radians.
    pub lo: f64,
    /// Where cells are finest, lo ≤ centre < hi (centre = lo makes a one-sided axis).
    pub centre: f64,
    /// Upper end, radians.
    pub hi: f64,
    /// Stretch width w > 0, radians.
    pub width: f64,
    /// Number of cells; even for a two-sided axis.
    pub cells: usize,
}

/// What both sides of a centre have in common, and where they end.
struct Sides {
    /// Cells a side; a one-sided axis has all of them above its centre.
    cells: f64,
    /// Sides below the centre.
    first: f64,
    /// The centre.
    start: f64,
    /// asinh(room/width) of either side.
    below: f64,
    above: f64,
}

impl Stretched {
    fn one_sided(&self) -> bool {
        self.centre <= self.lo
    }

    fn sides(&self) -> Sides {
        let Self { lo, centre, hi, .. } = *self;
        let range = |room: f64| (room / self.width).asinh();
        let cells = self.cells as f64;
        if self.one_sided() {
            return Sides { cells, first: 0.0, start: lo, below: 0.0, above: range(hi - lo) };
        }
        Sides {
            cells: 0.5 * cells,
            first: 1.0,
            start: centre,
            below: range(centre - lo),
            above: range(hi - centre),
        }
    }

    /// Position of x in units of cells, 0 at `lo` and `cells` at `hi`; x is clamped to the interval.
    #[must_use]
    pub fn position(&self, x: f64) -> f64 {
        let x = x.clamp(self.lo, self.hi);
        let cells = self.cells as f64;
        let side = |offset: f64, room: f64| (offset / self.width).asinh() / (room / self.width).asinh();
        if self.one_sided() {
            return cells * side(x - self.lo, self.hi - self.lo);
        }
        let half = 0.5 * cells;
        if x >= self.centre {
            half * (1.0 + side(x - self.centre, self.hi - self.centre))
        } else {
            half * (1.0 - side(self.centre - x, self.centre - self.lo))
        }
    }

    /// The coordinate at a position in units of cells; inverse of [`Self::position`].
    #[must_use]
    pub fn at(&self, position: f64) -> f64 {
        self.with_slope()(position).0
    }

    /// dx/dposition at a position in units of cells.
    #[must_use]
    pub fn slope(&self, position: f64) -> f64 {
        self.with_slope()(position).1
    }

    /// [`Self::at`] and [`Self::slope`] as one function of the position, for many positions.
    pub(crate) fn with_slope(&self) -> impl Fn(f64) -> (f64, f64) + use<> {
        let Self { lo, hi, width, .. } = *self;
        let Sides { cells, first, start, below, above } = self.sides();
        move |position| {
            let t = position / cells - first;
            let range = if t >= 0.0 { above } else { below };
            let sinh = (t * range).sinh();
            // dsinh = cosh, and cosh² = 1 + sinh².
            ((start + width * sinh).clamp(lo, hi), width * range * (1.0 + sinh * sinh).sqrt() / cells)
        }
    }

    /// [`Self::with_slope`] at the positions (k + offset)·step of a number k: what depends on the offsets is worked out once. The centre lies
    /// at no position between k·step and (k + 1)·step.
    pub fn by_steps<const N: usize>(
        &self,
        step: f64,
        offsets: [f64; N],
    ) -> impl Fn(usize) -> [(f64, f64); N] + use<N> {
        let Self { lo, hi, width, .. } = *self;
        let Sides { cells, first, start, below, above } = self.sides();
        let side = |range: f64| {
            let within = offsets.map(|offset| offset * step / cells * range);
            (range, within.map(f64::sinh), within.map(f64::cosh))
        };
        let (below, above) = (side(below), side(above));
        move |k| {
            let k = k as f64;
            let (range, sinh, cosh) = if (k + 0.5) * step >= first * cells { above } else { below };
            // Sums of arguments: sinh(a + b) = sinh a cosh b + cosh a sinh b.
            let grown = ((k * step / cells - first) * range).exp();
            let (sinh_a, cosh_a) = (0.5 * (grown - 1.0 / grown), 0.5 * (grown + 1.0 / grown));
            let slope = width * range / cells;
            std::array::from_fn(|j| {
                let x = start + width * (sinh_a * cosh[j] + cosh_a * sinh[j]);
                (x.clamp(lo, hi), slope * (cosh_a * cosh[j] + sinh_a * sinh[j]))
            })
        }
    }

    /// The `cells + 1` cell edges, ascending, the ends exact.
    #[must_use]
    pub fn edges(&self) -> Vec<f64> {
        let at = self.with_slope();
        let mut edges: Vec<f64> = (0..=self.cells).map(|i| at(i as f64).0).collect();
        edges[0] = self.lo;
        edges[self.cells] = self.hi;
        edges
    }

    /// The coordinate of each cell's centre (half-way in position, not in angle).
    #[must_use]
    pub fn centres(&self) -> Vec<f64> {
        let at = self.with_slope();
        (0..self.cells).map(|i| at(i as f64 + 0.5).0).collect()
    }
}

/// The exit cells of a table: which directions the cells of the row at θi cover.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum ExitAxis {
    /// Decay tables: one image row per θi, columns over the signed exit angle s ∈ (−90°, 90°).
    Plane {
        /// Number of cells (columns), even.
        cells: usize,
        /// Stretch width w, radians.
        width: f64,
    },
    /// Space tables: `phi_cells` image rows per θi (φ ascending from 0 to 180°), columns over θo ∈ [0°, 90°].
    Space {
        /// Number of θo cells (columns), even.
        theta_cells: usize,
        /// Number of φ cells (image rows per incidence).
        phi_cells: usize,
        /// Stretch width w, radians.
        width: f64,
    },
}

impl ExitAxis {
    /// Checks that a table can have these cells.
    ///
    /// # Errors
    /// The field that is out of range.
    pub fn validate(&self) -> Result<(), FieldError> {
        let width = self.width();
        check("exit_axis.width", width, (MIN_WIDTH..=MAX_WIDTH).contains(&width), "1e-7 to π/6 radians")?;
        let columns = self.columns();
        ensure(
            "exit_axis cells",
            (2..=MAX_AXIS_CELLS).contains(&columns) && columns.is_multiple_of(2),
            || format!("is {columns}, expected an even number from 2 to {MAX_AXIS_CELLS}"),
        )?;
        match self {
            Self::Plane { .. } => Ok(()),
            Self::Space { phi_cells, .. } => {
                ensure("exit_axis.phi_cells", (2..=MAX_AXIS_CELLS).contains(phi_cells), || {
                    format!("is {phi_cells}, expected 2 to {MAX_AXIS_CELLS}")
                })
            }
        }
    }

    /// Stretch width w, radians.
    #[must_use]
    pub const fn width(&self) -> f64 {
        match self {
            Self::Plane { width, .. } | Self::Space { width, .. } => *width,
        }
    }

    /// Number of image columns.
    #[must_use]
    pub const fn columns(&self) -> usize {
        match self {
            Self::Plane { cells, .. } => *cells,
            Self::Space { theta_cells, .. } => *theta_cells,
        }
    }

    /// Number of image rows per incidence.
    #[must_use]
    pub const fn rows_per_incidence(&self) -> usize {
        match self {
            Self::Plane { .. } => 1,
            Self::Space { phi_cells, .. } => *phi_cells,
        }
    }

    /// Cells per incidence.
    #[must_use]
    pub const fn cells(&self) -> usize {
        self.columns() * self.rows_per_incidence()
    }

    /// The column axis of the row at incidence `theta_i` (radians): signed s in the plane, θo in space.
    ///
    /// Cells are finest at the mirror direction, less a smooth withdrawal h(a) = √(a² + w²) − a from an end of the
    /// interval at distance a, so that both sides keep room: about w at grazing incidence, w²/2a away from it. (A
    /// plain clamp has a corner, at which rows cannot be read between.)
    #[must_use]
    pub fn columns_at(&self, theta_i: f64) -> Stretched {
        let width = self.width();
        let withdrawal = |room: f64| room.hypot(width) - room;
        let below_horizon = withdrawal(FRAC_PI_2 - theta_i);
        let (lo, cells, from_lo) = match *self {
            Self::Plane { cells, .. } => (-FRAC_PI_2, cells, withdrawal(FRAC_PI_2 + theta_i)),
            Self::Space { theta_cells, .. } => (0.0, theta_cells, withdrawal(theta_i)),
        };
        Stretched { lo, centre: theta_i - below_horizon + from_lo, hi: FRAC_PI_2, width, cells }
    }

    /// The φ axis at incidence `theta_i` (radians), one-sided over [0, π]; `None` for plane tables.
    ///
    /// Its width is w·cot(centre): facets tilted out of the plane of incidence by w turn a mirror reflection by that
    /// much, less and less towards grazing incidence.
    #[must_use]
    pub fn phi_at(&self, theta_i: f64) -> Option<Stretched> {
        match *self {
            Self::Plane { .. } => None,
            Self::Space { phi_cells, width, .. } => {
                let centre = self.columns_at(theta_i).centre;
                Some(Stretched {
                    lo: 0.0,
                    centre: 0.0,
                    hi: PI,
                    width: width / centre.tan(),
                    cells: phi_cells,
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes() -> Vec<Stretched> {
        let mut axes = Vec::new();
        for width in [1e-7, 1e-4, 0.07, MAX_WIDTH] {
            for theta_i in [0.0, 1e-9, 0.5, 1.2, 1.5706, FRAC_PI_2] {
                axes.push(ExitAxis::Plane { cells: 96, width }.columns_at(theta_i));
                let space = ExitAxis::Space { theta_cells: 64, phi_cells: 24, width };
                axes.push(space.columns_at(theta_i));
                axes.push(space.phi_at(theta_i).unwrap());
            }
        }
        axes
    }

    #[test]
    fn edges_ascend_strictly_and_reach_both_ends() {
        for axis in axes() {
            let edges = axis.edges();
            assert!(edges.windows(2).all(|e| e[0] < e[1]), "{axis:?}");
            assert_eq!((edges[0], edges[axis.cells]), (axis.lo, axis.hi));
        }
    }

    #[test]
    fn position_and_coordinate_are_inverses() {
        for axis in axes() {
            for i in 0..=4 * axis.cells {
                let position = 0.25 * i as f64;
                let back = axis.position(axis.at(position));
                // Near the centre x = c + δ loses δ's last digits to the rounding of c.
                let lost = 1e-14 / axis.slope(position);
                assert!((back - position).abs() < 1e-9 + lost, "{axis:?} {position} {back}");
            }
        }
    }

    #[test]
    fn positions_by_steps_are_those_one_by_one() {
        for axis in axes() {
            let at = axis.with_slope();
            for (step, count) in [(0.5, 2 * axis.cells), (1.0, axis.cells)] {
                let offsets = [0.03, 0.5, 0.97];
                let by_steps = axis.by_steps(step, offsets);
                for k in 0..count {
                    for ((x, slope), offset) in by_steps(k).into_iter().zip(offsets) {
                        let (true_x, true_slope) = at((k as f64 + offset) * step);
                        // The exponent of the distance from the centre is rounded, at up to 17, and so is x.
                        let rounding = 1e-14 * ((true_x - axis.centre).abs() + axis.width + true_x.abs());
                        assert!((x - true_x).abs() < rounding, "{axis:?} {k} {offset}: {x} {true_x}");
                        assert!((slope / true_slope - 1.0).abs() < 1e-13, "{axis:?} {k} {offset}");
                    }
                }
            }
        }
    }

    #[test]
    fn slope_is_the_derivative() {
        let axis = ExitAxis::Plane { cells: 96, width: 0.07 }.columns_at(0.8);
        for position in [3.3, 47.2, 60.9, 90.1] {
            let difference = (axis.at(position + 1e-5) - axis.at(position - 1e-5)) / 2e-5;
            assert!((difference / axis.slope(position) - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn the_axis_at_normal_incidence_is_symmetric() {
        let centres = ExitAxis::Plane { cells: 96, width: 0.07 }.columns_at(0.0).centres();
        for (a, b) in centres.iter().zip(centres.iter().rev()) {
            assert!((a + b).abs() < 1e-15);
        }
    }
}
