//! The facets of many pairs at once.

use super::{Ends, FAR, Facets, Rules, SUMMED, facet_between, limits, reflected};
use crate::numerics::angles::{greatest, least};
use crate::numerics::lanes::{Directions, LANES, Lane, each};
use pulp::{Simd, WithSimd};

/// [`Facets::integrate`].
pub(super) struct Integral<'f, V> {
    pub(super) facets: &'f Facets,
    pub(super) rules: &'f Rules,
    pub(super) cos_i: f64,
    pub(super) visit: V,
}

impl<V: FnMut(f64, f64, f64)> WithSimd for Integral<'_, V> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { facets: &facets, rules, cos_i, mut visit } = self;
        let sin_i = (1.0 - cos_i * cos_i).max(0.0).sqrt();
        let reach = SUMMED * facets.sigma;
        let q_end = reach.min(1.0 / cos_i.max(1e-300));
        let mut points = Vec::new();
        for &(x, weight) in &rules.across {
            // Even in q: one half of it, twice.
            let q = 0.5 * q_end * (1.0 + x);
            let q2 = q * q;
            let across = weight * q_end * facets.slope_density(q);
            let limits = limits(cos_i, sin_i, q2);
            let (lo, hi) = (limits.lo.max(-reach), limits.hi.min(reach));
            if lo >= hi {
                continue;
            }
            points.clear();
            facets.along(rules, cos_i, sin_i, q2, (lo, hi), |p, weight| points.push((p, across * weight)));
            for points in points.chunks(LANES) {
                let mut at = [[0.0; LANES]; 2];
                for (k, (p, weight)) in points.iter().enumerate() {
                    (at[0][k], at[1][k]) = (*p, *weight);
                }
                let [mass, cos, cos_o] = each!(p = at[0], weight = at[1] => {
                    let slant = 1.0 + p * p + q2;
                    let projected = cos_i - p * sin_i;
                    let cos = least(greatest(projected / slant.sqrt(), 0.0), 1.0);
                    let seen = if facets.visible { projected } else { 1.0 };
                    let mass = weight * facets.slope_density(p) * seen;
                    // wo = 2(wi·m)m − wi.
                    [mass * facets.fresnel(cos), cos, greatest(2.0 * projected / slant - cos_i, 0.0)]
                });
                for k in 0..points.len() {
                    visit(mass[k], cos[k], cos_o[k]);
                }
            }
        }
    }
}

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
