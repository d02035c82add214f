//! [`Stretched`] axes prepared for one incidence, for evaluation in few operations.

use crate::numerics::angles::{greatest, least};
use crate::numerics::single::{asinh, asinh_and_root, exp, of_sign, step_of, whole};
use lut_io::axis::Stretched;

/// The axis x = c ± w·sinh(·) with its constants worked out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    centre: f64,
    width: f64,
    inverse_width: f64,
    /// Position of the centre.
    middle: f32,
    /// Positions per asinh on either side.
    gain_lo: f32,
    gain_hi: f32,
}

impl Warp {
    #[inline(always)]
    pub(crate) fn new(axis: &Stretched) -> Self {
        let Stretched { lo, centre, hi, width, cells } = *axis;
        if centre <= lo {
            return Self::one_sided(lo, hi, width, 1.0 / width, cells);
        }
        Self::two_sided(lo, centre, hi, width, 1.0 / width, cells)
    }

    /// Around a centre above the lower end.
    #[inline(always)]
    pub(crate) fn two_sided(
        lo: f64,
        centre: f64,
        hi: f64,
        width: f64,
        inverse_width: f64,
        cells: usize,
    ) -> Self {
        let [above, below] =
            asinh([((hi - centre) * inverse_width) as f32, ((centre - lo) * inverse_width) as f32]);
        let half = 0.5 * whole(cells);
        Self { centre, width, inverse_width, middle: half, gain_lo: half / below, gain_hi: half / above }
    }

    /// Position of an offset from the centre in widths, and dposition/dx there, by asinh and √(1 + x²) of it.
    #[inline(always)]
    fn place(&self, offset: f32, root: f32, arc: f32) -> (f32, f32) {
        let gain = of_sign(offset, [self.gain_hi, self.gain_lo]);
        (self.middle + (gain * arc).copysign(offset), gain * self.inverse_width as f32 / root)
    }

    /// Finest at the lower end.
    #[inline(always)]
    pub(crate) fn one_sided(lo: f64, hi: f64, width: f64, inverse_width: f64, cells: usize) -> Self {
        let gain_hi = whole(cells) / asinh([((hi - lo) * inverse_width) as f32])[0];
        Self { centre: lo, width, inverse_width, middle: 0.0, gain_lo: 0.0, gain_hi }
    }

    /// Positions of coordinates in cells, and dposition/dx there.
    #[inline(always)]
    pub(crate) fn positions<const N: usize>(&self, x: [f64; N]) -> [(f32, f32); N] {
        let offset = x.map(|x| ((x - self.centre) * self.inverse_width) as f32);
        let (arc, root) = asinh_and_root(offset);
        let mut found = [(0.0, 0.0); N];
        for (k, found) in found.iter_mut().enumerate() {
            *found = self.place(offset[k], root[k], arc[k]);
        }
        found
    }

    /// This axis around another centre, with its gains on either side.
    #[inline(always)]
    pub(crate) fn recentred(&self, centre: f64, [gain_lo, gain_hi]: [f32; 2]) -> Self {
        Self { centre, gain_lo, gain_hi, ..*self }
    }

    /// What [`Self::recentred`] takes.
    #[inline(always)]
    pub(crate) fn centre_and_gains(&self) -> (f64, [f32; 2]) {
        (self.centre, [self.gain_lo, self.gain_hi])
    }

    /// Position of one coordinate, and dposition/dx there.
    #[inline(always)]
    pub(crate) fn position(&self, x: f64) -> (f32, f32) {
        let [one] = self.positions([x]);
        one
    }

    /// The coordinate at a position.
    #[inline(always)]
    pub(crate) fn at(&self, position: f64) -> f64 {
        let d = (position - f64::from(self.middle)) as f32;
        let gain = of_sign(d, [self.gain_hi, self.gain_lo]);
        // sinh to an absolute error of rounding.
        let e = exp(-(d / gain).abs());
        self.centre + self.width * f64::from((0.5 * (1.0 / e - e)).copysign(d))
    }
}

/// A position between two cell centres: the cell at or before it, and how far (0..1) it is towards the next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) index: usize,
    pub(crate) fraction: f32,
}

impl Cell {
    #[inline(always)]
    pub(crate) fn new(position: f32, cells: usize) -> Self {
        // `greatest` first: it turns a NaN into 0.
        let from_first = least(greatest(position - 0.5, 0.0), whole(cells - 1));
        let (index, fraction) = step_of(from_first, whole(cells - 2));
        Self { index, fraction }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lut_io::axis::ExitAxis;

    #[test]
    fn positions_are_those_of_the_table_axis() {
        for width in [1e-6, 0.03, 0.3] {
            let plane = ExitAxis::Plane { cells: 96, width };
            let space = ExitAxis::Space { theta_cells: 64, phi_cells: 24, width };
            for theta_i in [0.0, 0.4, 1.3, 1.57] {
                for axis in
                    [plane.columns_at(theta_i), space.columns_at(theta_i), space.phi_at(theta_i).unwrap()]
                {
                    let warp = Warp::new(&axis);
                    for i in 0..=40 {
                        let x = axis.lo + (axis.hi - axis.lo) * f64::from(i) / 40.0;
                        let (position, density) = warp.position(x);
                        let [position, density] = [position, density].map(f64::from);
                        // What a value misses is this share of what it gains from one cell to the next.
                        assert!((position - axis.position(x)).abs() < 4e-5, "{axis:?} {x}");
                        assert!((density * axis.slope(axis.position(x)) - 1.0).abs() < 1e-5, "{axis:?} {x}");
                        assert!((warp.at(axis.position(x)) - x).abs() * density < 4e-5, "{axis:?} {x}");
                    }
                }
            }
        }
    }
}
