//! [`Stretched`] axes prepared for one incidence, for evaluation in few operations.

use crate::angles::{asinh, ln};
use lut_io::axis::Stretched;

/// The axis x = c ± w·sinh(·) with its constants worked out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    centre: f64,
    width: f64,
    inverse_width: f64,
    /// Position of the centre.
    middle: f64,
    /// Positions per asinh on either side.
    gain_lo: f64,
    gain_hi: f64,
}

impl Warp {
    #[inline]
    pub(crate) fn new(axis: &Stretched) -> Self {
        let Stretched { lo, centre, hi, width, cells } = *axis;
        if centre <= lo {
            return Self::one_sided(lo, hi, width, 1.0 / width, cells);
        }
        Self::two_sided(lo, centre, hi, width, 1.0 / width, cells)
    }

    /// Around a centre above the lower end.
    #[inline]
    pub(crate) fn two_sided(
        lo: f64,
        centre: f64,
        hi: f64,
        width: f64,
        inverse_width: f64,
        cells: usize,
    ) -> Self {
        let half = 0.5 * cells as f64;
        let gain_hi = half / asinh((hi - centre) * inverse_width);
        let gain_lo = half / asinh((centre - lo) * inverse_width);
        Self { centre, width, inverse_width, middle: half, gain_lo, gain_hi }
    }

    /// Finest at the lower end.
    #[inline]
    pub(crate) fn one_sided(lo: f64, hi: f64, width: f64, inverse_width: f64, cells: usize) -> Self {
        let gain_hi = cells as f64 / asinh((hi - lo) * inverse_width);
        Self { centre: lo, width, inverse_width, middle: 0.0, gain_lo: 0.0, gain_hi }
    }

    /// Position of x in cells, and dx/dposition there.
    #[inline]
    pub(crate) fn position_and_slope(&self, x: f64) -> (f64, f64) {
        let offset = (x - self.centre) * self.inverse_width;
        let size = offset.abs();
        let root = (1.0 + size * size).sqrt();
        let gain = if offset >= 0.0 { self.gain_hi } else { self.gain_lo };
        (self.middle + (gain * ln(size + root)).copysign(offset), self.width * root / gain)
    }

    /// The coordinate at a position.
    #[inline]
    pub(crate) fn at(&self, position: f64) -> f64 {
        let d = position - self.middle;
        let gain = if d >= 0.0 { self.gain_hi } else { self.gain_lo };
        // sinh to an absolute error of rounding.
        let e = (d / gain).exp();
        self.centre + self.width * (0.5 * (e - 1.0 / e))
    }
}

/// A position between two cell centres: the cell at or before it, and how far (0..1) it is towards the next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) index: usize,
    pub(crate) fraction: f64,
}

impl Cell {
    #[inline]
    pub(crate) fn new(position: f64, cells: usize) -> Self {
        // `max` first: it turns a NaN into 0.
        let from_first = (position - 0.5).max(0.0).min((cells - 1) as f64);
        let index = (from_first as usize).min(cells - 2);
        Self { index, fraction: from_first - index as f64 }
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
                        let (position, slope) = warp.position_and_slope(x);
                        assert!((position - axis.position(x)).abs() < 1e-9, "{axis:?} {x}");
                        assert!((slope / axis.slope(position) - 1.0).abs() < 1e-6, "{axis:?} {x}");
                        assert!((warp.at(position) - x).abs() < 1e-8, "{axis:?} {x}");
                    }
                }
            }
        }
    }
}
