//! Exit directions of the tabulated lobes.

use crate::lobes::azimuth::Forward;
use crate::lobes::distribution::{Distribution, Found, cumulative_at, find};
use crate::lobes::{Between, DENSITIES, Incidence, Lobes};
use crate::numerics::angles::{INVERSE_TAU, greatest, least, turned};
use crate::numerics::warp::{Cell, Warp};
use std::f64::consts::{FRAC_PI_2, PI};

/// Area of what is outside the cap.
pub(super) const OUTSIDE: f64 = -1.0;

/// An exit direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exit {
    pub(crate) cos: f64,
    pub(crate) sin: f64,
    /// cos and sin of φ.
    pub(crate) azimuth: (f64, f64),
}

impl Lobes {
    /// An exit direction of one lobe (0 interior, 1 rehit) from three uniform numbers; no direction of a lobe without light.
    #[inline(always)]
    pub(crate) fn sample(&self, lobe: usize, at: &Incidence, select: f64, u: f64, v: f64) -> Exit {
        let (node, left) = self.choose_node(lobe, at.between, select);
        if self.signed() {
            let s = at.columns.at(self.find(lobe, node, u).position());
            // Neither what chose the node nor v has said anything yet: they place what falls into the cap.
            let (cos, sin) = turned(self.theta_of_plane(s, left) * INVERSE_TAU);
            let around = Forward::new(self.concentration_at(at.azimuth, s, sin));
            return Exit { cos, sin, azimuth: around.sample(v) };
        }
        let (side, v) = side_of(v);
        let around = self.find_row(lobe, node, v).position();
        let (row, left) = self.choose_row(lobe, node, around, left);
        let column = self.find(lobe, row, u).position();
        let cap_edge = self.cap_edge(&at.columns);
        let area = if column < cap_edge { self.cap_area(lobe, row, cap_edge, u) } else { OUTSIDE };
        let (cos, sin) = turned(self.theta_of_space(at.columns.at(column), area) * INVERSE_TAU);
        Exit { cos, sin, azimuth: turned(self.turn_of_space(at.azimuth, side * around, left, area)) }
    }

    /// One of two incidences by a uniform number, and what is left of it; NaN where the lobe has no light.
    #[inline(always)]
    pub(super) fn choose_node(&self, lobe: usize, between: Between, select: f64) -> (usize, f64) {
        let Between { node, next, fraction } = between;
        let fraction = f64::from(fraction);
        let near = (1.0 - fraction) * f64::from(self.totals[node][lobe]);
        let far = fraction * f64::from(self.totals[next][lobe]);
        split(select, near / (near + far), node, next)
    }

    /// Where a uniform number falls among the φ rows of an incidence of a space table.
    #[inline(always)]
    pub(super) fn find_row(&self, lobe: usize, node: usize, v: f64) -> Found {
        let Distribution { row_cumulative, row_guide, row_total, .. } = &self.distributions[lobe];
        let rows = node * self.rows..(node + 1) * self.rows;
        let totals = &row_total[rows.clone()];
        let density = |k: usize| f64::from(totals[k]);
        find(density, &row_cumulative[rows.clone()], &row_guide[rows], self.totals[node][lobe], v)
    }

    /// One of the two rows around a position (the number among those of all incidences) by a uniform number, and what is left of it.
    #[inline(always)]
    pub(super) fn choose_row(&self, lobe: usize, node: usize, position: f64, select: f64) -> (usize, f64) {
        let cell = Cell::new(position as f32, self.rows);
        let (first, fraction) = (node * self.rows + cell.index, f64::from(cell.fraction));
        let [near, far] = [first, first + 1].map(|row| f64::from(self.distributions[lobe].row_total[row]));
        let (near, far) = ((1.0 - fraction) * near, fraction * far);
        split(select, near / (near + far), first, first + 1)
    }

    /// Where a uniform number falls in a row.
    #[inline(always)]
    pub(super) fn find(&self, lobe: usize, row: usize, u: f64) -> Found {
        let Distribution { cumulative, guide, row_total, .. } = &self.distributions[lobe];
        let range = row * self.columns..(row + 1) * self.columns;
        let cells = &self.cells[range.clone()];
        let density = |k: usize| f64::from(cells[k][DENSITIES + lobe]);
        find(density, &cumulative[range.clone()], &guide[range], row_total[row], u)
    }

    /// Column at the edge of the cap in space tables.
    #[inline(always)]
    pub(super) fn cap_edge(&self, columns: &Warp) -> f64 {
        f64::from(columns.position(self.cap.radius).0)
    }

    /// Share of the cap's area up to a number that falls into it, in a row of a space table.
    #[inline(always)]
    pub(super) fn cap_area(&self, lobe: usize, row: usize, cap_edge: f64, u: f64) -> f64 {
        let Distribution { cumulative, row_total, .. } = &self.distributions[lobe];
        let range = row * self.columns..(row + 1) * self.columns;
        let cells = &self.cells[range.clone()];
        let density = |k: usize| f64::from(cells[k][DENSITIES + lobe]);
        least(u * f64::from(row_total[row]) / cumulative_at(density, &cumulative[range], cap_edge), 1.0)
    }

    /// θo at a signed exit angle of decay tables; NaN where nothing is left.
    #[inline(always)]
    pub(super) fn theta_of_plane(&self, s: f64, left: f64) -> f64 {
        let theta = if self.is_capped(s) { self.cap.theta(left) } else { least(s.abs(), FRAC_PI_2) };
        if left.is_nan() { left } else { theta }
    }

    /// Concentration of the sampled azimuths there: 0, at which all are equal, in the cap and behind.
    #[inline(always)]
    pub(super) fn concentration_at(&self, azimuth: f32, s: f64, sin_o: f64) -> f32 {
        if self.is_capped(s) | (s < 0.0) { 0.0 } else { azimuth * sin_o as f32 }
    }

    #[inline(always)]
    fn is_capped(&self, s: f64) -> bool {
        s.abs() < self.cap.radius
    }

    /// θo at a column's angle of space tables.
    #[inline(always)]
    pub(super) fn theta_of_space(&self, theta: f64, area: f64) -> f64 {
        if area >= 0.0 { self.cap.theta(area) } else { least(greatest(theta, 0.0), FRAC_PI_2) }
    }

    /// φ in turns, of space tables; NaN where nothing is left.
    #[inline(always)]
    pub(super) fn turn_of_space(&self, azimuth: f32, around: f64, left: f64, area: f64) -> f64 {
        let phi = least(self.around(azimuth).at(around.abs()), PI).copysign(around);
        let turn = if area >= 0.0 { left - 0.5 } else { phi * INVERSE_TAU };
        if left.is_nan() { left } else { turn }
    }
}

/// A side of the plane of incidence by one half of a uniform number, and what is left of it.
#[inline(always)]
pub(super) fn side_of(v: f64) -> (f64, f64) {
    if v < 0.5 { (1.0, 2.0 * v) } else { (-1.0, 2.0 * v - 1.0) }
}

/// Chooses between two with the probability of the first, and what is left of the random number.
#[inline(always)]
fn split(u: f64, first: f64, a: usize, b: usize) -> (usize, f64) {
    // Without a branch, which random numbers would mispredict.
    let is_first = u < first;
    let (from, length) = if is_first { (0.0, first) } else { (first, 1.0 - first) };
    (if is_first { a } else { b }, (u - from) / greatest(length, f64::MIN_POSITIVE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::angles::Polar;
    use lut_io::lobe::Interpolant;
    use lut_io::table::Component;

    #[test]
    fn a_lobe_without_light_has_no_exits() {
        let incidences: Vec<f64> = (0..=18).map(|i| 5.0 * f64::from(i)).collect();
        for table in [specimen::plane(&incidences, 48), specimen::space(&incidences, 32, 24)] {
            let dark =
                specimen::changed(&table, |parts| parts.lobes[Component::Rehit as usize].value.fill(0.0));
            let lobes = Lobes::new(&Interpolant::new(dark));
            for k in 0..1000 {
                let [select, u, v] = [0.618, 0.755, 0.570].map(|step| (f64::from(k) * step).fract());
                let incidence = lobes.incidence(&Polar::at(FRAC_PI_2 * (f64::from(k) + 0.5) / 1000.0));
                let [lit, dark] = [0, 1].map(|part| lobes.sample(part, &incidence, select, u, v));
                let length2 = |exit: &Exit| exit.cos.hypot(exit.sin) * exit.azimuth.0.hypot(exit.azimuth.1);
                assert!((length2(&lit) - 1.0).abs() < 1e-6, "{lit:?}");
                assert!(length2(&dark).is_nan(), "{dark:?}");
            }
        }
    }
}
