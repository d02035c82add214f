//! A lossless periodic stack, and what a facet makes of unpolarised or polarised light in it.

use std::hint::select_unpredictable as choose;

use transport::Transport;
use transport::walk::{Exit, Fate};

use super::draws::{Normal, weight};
use super::lanes::{CROSSING, ENTERED, Ray};

#[derive(Clone, Copy)]
pub(crate) struct Stack {
    pub(crate) last: i32,
    odd: f32,
    even: f32,
    enter: f32,
    leave: f32,
    pub(crate) normal: Normal,
}

impl Stack {
    /// Out of line: else the compiler chooses between indices of 64 bits and rounds the choice, at every crossing.
    #[inline(never)]
    pub(crate) fn new(transport: &Transport) -> Self {
        let n = &transport.indices;
        let ratio = |from: usize, to: usize| (n[from] / n[to]) as f32;
        Self {
            last: transport.layers() as i32,
            odd: ratio(1, 2),
            even: ratio(2, 1),
            enter: ratio(0, 1),
            leave: ratio(1, 0),
            normal: Normal::new(transport.facets.slope_sd),
        }
    }

    /// n1/n2 at the interface ahead.
    #[inline(always)]
    pub(crate) fn ratio<const N: usize>(&self, ray: &Ray<N>) -> f32 {
        let inner = choose(leaves_odd(ray), self.odd, self.even);
        choose(ray.interface == 0, choose(ray.step < 0, self.leave, self.enter), inner)
    }

    #[inline(always)]
    pub(crate) fn is_out<const N: usize>(&self, ray: &Ray<N>) -> bool {
        ray.interface as u32 > self.last as u32
    }

    /// How a path ended that nothing absorbs.
    #[inline(always)]
    pub(crate) fn exit<const N: usize>(&self, ray: &Ray<N>, direction: [f32; 3]) -> Exit {
        let fate = if ray.interface < 0 {
            match ray.met {
                CROSSING => Fate::Single,
                met if met & ENTERED == 0 => Fate::Rehit,
                _ => Fate::Interior,
            }
        } else if ray.interface > self.last {
            Fate::Transmitted
        } else {
            Fate::Truncated
        };
        Exit { direction, weight: 1.0, fate }
    }
}

/// Whether a ray is in an odd layer.
#[inline(always)]
fn leaves_odd<const N: usize>(ray: &Ray<N>) -> bool {
    (ray.step < 0) ^ (ray.interface & 1 != 0)
}

/// Optical depths of odd and even layers.
#[derive(Clone, Copy)]
pub(crate) struct Depths {
    odd: f32,
    even: f32,
}

impl Depths {
    #[inline(never)]
    pub(crate) fn new(transport: &Transport) -> Self {
        Self { odd: transport.optical_depths[0] as f32, even: transport.optical_depths[1] as f32 }
    }

    /// The optical depth of a path after an event that took it from `ray` to `next`, across a layer or not; |cos θ| is now `cos`.
    #[inline(always)]
    pub(crate) fn after<const N: usize>(
        &self,
        stack: &Stack,
        depth: f32,
        ray: &Ray<N>,
        (next, crosses): &(Ray<N>, bool),
        cos: f32,
        reflects: bool,
    ) -> f32 {
        let odd = leaves_odd(ray);
        let (here, beyond) = (choose(odd, self.odd, self.even), choose(odd, self.even, self.odd));
        let layer = choose(reflects, here, beyond);
        // A ray along a layer that does not absorb: not 0/0.
        let absorbs = *crosses & (layer > 0.0) & !stack.is_out(next);
        choose(absorbs, depth + layer / cos, depth)
    }

    /// What is left of a path that ended, and whether it ended inside.
    #[inline(always)]
    pub(crate) fn exit(exit: Exit, depth: f32, limit: f32) -> Exit {
        let fate = if exit.fate == Fate::Truncated && depth > limit { Fate::Absorbed } else { exit.fate };
        Exit { weight: weight(depth), fate, ..exit }
    }
}

/// Fresnel's r_s = `s/both` and r_p = `p/both`, of a facet normal as long as `a` is too large.
#[derive(Clone, Copy)]
pub(crate) struct Fresnel {
    /// cos θ1; 0 for a facet that is not met.
    pub(crate) a: f32,
    both: f32,
    s: f32,
    p: f32,
    /// n1/n2·cos θ1 − cos θ2.
    pub(crate) bend: f32,
}

impl Fresnel {
    /// Of cos θ1 = `a`, n1/n2 = `ratio`, and 1 − (n1/n2)² = `contrast`.
    #[inline(always)]
    pub(crate) fn new(a: f32, ratio: f32, contrast: f32) -> Self {
        let scaled = a * ratio;
        let square = scaled.mul_add(scaled, contrast);
        let b = choose(square > 0.0, square, 0.0).sqrt();
        let (sd, sn) = (scaled + b, scaled - b);
        let (pd, pn) = (ratio.mul_add(b, a), (-ratio).mul_add(b, a));
        Self { a, both: sd * pd, s: sn * pd, p: pn * sd, bend: sn }
    }

    #[inline(always)]
    pub(crate) fn reflects_unpolarised(&self, choice: f32) -> bool {
        choice * self.both * self.both <= 1_073_742_080.0 * self.s.mul_add(self.s, self.p * self.p)
    }

    #[inline(always)]
    pub(crate) fn reflects(&self, choice: f32, is_s: bool) -> bool {
        let r = choose(is_s, self.s, self.p);
        choice * self.both * self.both <= 2_147_484_160.0 * (r * r)
    }
}

impl<const N: usize> Ray<N> {
    /// The ray after an event that leaves it the `numbers`, and whether it crosses a layer; `z` still has the sign of an
    /// unmirrored one.
    #[inline(always)]
    pub(crate) fn after(self, numbers: [f32; N], z: f32, faces: bool, reflects: bool) -> (Self, bool) {
        let turns = faces & (z <= 0.0);
        let step = choose(turns, -self.step, self.step);
        let met = self.met + choose(faces, CROSSING, 0);
        let crosses = reflects == turns;
        let after = Self {
            numbers,
            interface: choose(crosses, self.interface + step, self.interface),
            step,
            met: choose(reflects, met, met | ENTERED),
        };
        (after, crosses)
    }
}
