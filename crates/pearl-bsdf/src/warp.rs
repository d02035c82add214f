//! [`Stretched`] axes prepared for one incidence, for evaluation in few operations.

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
        let inverse_width = 1.0 / axis.width;
        let cells = axis.cells as f64;
        let hi = asinh((axis.hi - axis.centre) * inverse_width);
        let (middle, gain_lo, gain_hi) = if axis.centre <= axis.lo {
            (0.0, 0.0, cells / hi)
        } else {
            let lo = asinh((axis.centre - axis.lo) * inverse_width);
            (0.5 * cells, 0.5 * cells / lo, 0.5 * cells / hi)
        };
        Self { centre: axis.centre, width: axis.width, inverse_width, middle, gain_lo, gain_hi }
    }

    /// Position of x in cells, and dx/dposition there.
    #[inline]
    pub(crate) fn position_and_slope(&self, x: f64) -> (f64, f64) {
        let offset = (x - self.centre) * self.inverse_width;
        let size = offset.abs();
        let root = (1.0 + size * size).sqrt();
        let stretched = (size + root).ln();
        if offset >= 0.0 {
            (self.middle + self.gain_hi * stretched, self.width * root / self.gain_hi)
        } else {
            (self.middle - self.gain_lo * stretched, self.width * root / self.gain_lo)
        }
    }

    /// The coordinate at a position.
    #[inline]
    pub(crate) fn at(&self, position: f64) -> f64 {
        let d = position - self.middle;
        let gain = if d >= 0.0 { self.gain_hi } else { self.gain_lo };
        self.centre + self.width * (d / gain).sinh()
    }
}

/// asinh of x ≥ 0 to an absolute error of rounding, which is all that a position needs.
#[inline]
fn asinh(x: f64) -> f64 {
    (x + (1.0 + x * x).sqrt()).ln()
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
