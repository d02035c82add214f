//! The facets of many pairs at once.

use super::{Ends, FAR, Facets, facet_between, limits, reflected};
use crate::numerics::lanes::{Directions, LANES, Lane, each};

/// [`Ends`] of every lane, with the probabilities of more than them.
pub(crate) struct Ranges {
    near: Lane,
    far: Lane,
    unit: Lane,
    tails: [Lane; 2],
}

impl Facets {
    /// [`Self::pdf`] of every lane, q the slope of its facet across the plane of incidence.
    #[inline(always)]
    pub(crate) fn pdfs(&self, i: &Directions, across: &Ranges, q: &Lane, facing: &Lane) -> Lane {
        let kept_across = across.kept();
        let kept_along = self.ranges_along(i, q).kept();
        let [pdf] = each!(facing = facing, across = kept_across, along = kept_along => [facet_between(facing, across * along)]);
        pdf
    }

    /// [`Self::sample`] of every lane.
    #[inline(always)]
    pub(crate) fn samples(&self, i: &Directions, across: &Ranges, u: &Lane, v: &Lane) -> [Lane; 3] {
        let q = across.slopes(u);
        let p = self.ranges_along(i, &q).slopes(v);
        each!(x = i.w[0], y = i.w[1], z = i.w[2], along = i.azimuth[0], across = i.azimuth[1], p = p, q = q => {
            reflected([x, y, z], (along, across), (p, q))
        })
    }

    /// Where q may be at every incidence.
    #[inline(always)]
    pub(crate) fn ranges_across(&self, i: &Directions) -> Ranges {
        let [lo, hi] = each!(cos = i.cos() => [-1.0 / cos, 1.0 / cos]);
        self.ranges(&lo, &hi)
    }

    #[inline(always)]
    fn ranges_along(&self, i: &Directions, q: &Lane) -> Ranges {
        let [lo, hi] = each!(cos = i.cos(), sin = i.sin, q = q => {
            let limits = limits(cos, sin, q * q);
            [limits.lo, limits.hi]
        });
        self.ranges(&lo, &hi)
    }

    #[inline(always)]
    fn ranges(&self, lo: &Lane, hi: &Lane) -> Ranges {
        let [near, far, unit] = each!(lo = lo, hi = hi => {
            let Ends { near, far, unit } = self.ends(lo, hi);
            [near, far, unit]
        });
        // Far from the horizon neither tail is asked for in any lane.
        let mut wanted = [false; 2];
        for k in 0..LANES {
            let ends = Ends { near: near[k], far: far[k], unit: 0.0 };
            wanted[0] |= near[k] > -FAR;
            wanted[1] |= !ends.nothing_beyond();
        }
        let mut tails = [[1.0; LANES], [0.0; LANES]];
        if wanted[0] {
            [tails[0]] = each!(near = near, far = far => [Ends { near, far, unit: 0.0 }.tail_of_near()]);
        }
        if wanted[1] {
            [tails[1]] = each!(near = near, far = far => [Ends { near, far, unit: 0.0 }.tail_of_far()]);
        }
        Ranges { near, far, unit, tails }
    }
}

impl Ranges {
    /// Probability of a slope within the range.
    #[inline(always)]
    fn kept(&self) -> Lane {
        let [kept] = each!(near = self.tails[0], far = self.tails[1] => [near - far]);
        kept
    }

    /// [`Ends::slope`] of every lane.
    #[inline(always)]
    fn slopes(&self, u: &Lane) -> Lane {
        let [tail] =
            each!(near = self.tails[0], far = self.tails[1], u = u => [Ends::tail_at([near, far], u)]);
        let [slope] = each!(near = self.near, far = self.far, unit = self.unit, tail = tail => {
            [Ends { near, far, unit }.slope(tail)]
        });
        slope
    }
}
