//! Plane walks that know one thing each: light in a periodic stack, and at most one effect. Tilts are small.
//!
//! Nothing here can be switched: what a kernel does not name it does not have.

use std::hint::select_unpredictable as choose;

use transport::Transport;
use transport::walk::Exit;

use super::draws::{Generator, absorption_limit, left_over, next, polynomial, uniform};
use super::lanes::{Kernel, Ray};
use super::stack::{Depths, Fresnel, Stack};

/// Sine and cosine of a tilt.
#[inline(always)]
fn facet(alpha: f32) -> [f32; 2] {
    const SIN: [f32; 3] = [9.999_999_916_104e-1, -1.666_657_457_094e-1, 8.308_054_673_418e-3];
    const COS: [f32; 3] = [9.999_999_832_286e-1, -4.999_958_571_152e-1, 4.151_503_033_840e-2];
    let square = alpha * alpha;
    [alpha * polynomial(&SIN, square), polynomial(&COS, square)]
}

/// cos θ1 on a facet.
#[inline(always)]
fn cosine([x, z]: [f32; 2], [facet_x, facet_z]: [f32; 2]) -> f32 {
    (-x).mul_add(facet_x, z * facet_z)
}

#[inline(always)]
fn fresnel(a: f32, ratio: f32) -> Fresnel {
    Fresnel::new(a, ratio, (-ratio).mul_add(ratio, 1.0))
}

/// The direction after an event, z with its sign.
#[inline(always)]
fn bent([x, z]: [f32; 2], facet: [f32; 2], ratio: f32, fresnel: &Fresnel, reflects: bool) -> [f32; 2] {
    let along = choose(reflects, 1.0, ratio);
    let normal = choose(reflects, fresnel.a + fresnel.a, fresnel.bend);
    [x.mul_add(along, normal * facet[0]), z.mul_add(along, -(normal * facet[1]))]
}

/// Two tilts, two choices.
#[inline(always)]
fn draw(stack: &Stack, generator: &mut Generator) -> [f32; 4] {
    let (radius, angle) = (next(generator), next(generator));
    let (first, second) = stack.normal.deviates(radius, angle);
    [first, second, left_over(radius, angle), uniform(next(generator))]
}

/// No effect: x, z.
#[derive(Clone, Copy)]
pub(crate) struct Plain(Stack);

impl Plain {
    pub(crate) fn new(transport: &Transport) -> Self {
        Self(Stack::new(transport))
    }
}

impl Kernel<2, 4> for Plain {
    const EVENTS: usize = 2;
    const RESTING: [f32; 2] = [0.0, 1.0];

    fn stack(&self) -> &Stack {
        &self.0
    }

    #[inline(always)]
    fn start(incidence: [f32; 2], _: u64, _: u32) -> [f32; 2] {
        incidence
    }

    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 4] {
        draw(&self.0, generator)
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<2>, drawn: &[f32; 4], event: usize, rests: bool) -> Ray<2> {
        let facet = facet(drawn[event]);
        let ratio = self.0.ratio(&ray);
        let a = cosine(ray.numbers, facet);
        let a = choose((a > 0.0) & !rests, a, 0.0);
        let fresnel = fresnel(a, ratio);
        let reflects = fresnel.reflects_unpolarised(drawn[2 + event]);
        let [x, z] = bent(ray.numbers, facet, ratio, &fresnel, reflects);
        ray.after([x, z.abs()], z, a > 0.0, reflects).0
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<2>) -> Exit {
        let [x, z] = ray.numbers;
        self.0.exit(ray, [x, 0.0, z])
    }
}

/// Absorption: x, z, optical depth so far, and the most of it.
#[derive(Clone, Copy)]
pub(crate) struct Absorbing {
    stack: Stack,
    depths: Depths,
}

impl Absorbing {
    pub(crate) fn new(transport: &Transport) -> Self {
        Self { stack: Stack::new(transport), depths: Depths::new(transport) }
    }
}

impl Kernel<4, 4> for Absorbing {
    const EVENTS: usize = 2;
    const RESTING: [f32; 4] = [0.0, 1.0, 0.0, f32::INFINITY];

    fn stack(&self) -> &Stack {
        &self.stack
    }

    #[inline(always)]
    fn start([sin, cos]: [f32; 2], _: u64, spare: u32) -> [f32; 4] {
        [sin, cos, 0.0, absorption_limit(spare)]
    }

    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 4] {
        draw(&self.stack, generator)
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<4>, drawn: &[f32; 4], event: usize, rests: bool) -> Ray<4> {
        let [x, z, depth, limit] = ray.numbers;
        let facet = facet(drawn[event]);
        let ratio = self.stack.ratio(&ray);
        let a = cosine([x, z], facet);
        let a = choose((a > 0.0) & !rests, a, 0.0);
        let fresnel = fresnel(a, ratio);
        let reflects = fresnel.reflects_unpolarised(drawn[2 + event]);
        let [x, z] = bent([x, z], facet, ratio, &fresnel, reflects);
        let after = ray.after([x, z.abs(), depth, limit], z, a > 0.0, reflects);
        let depth = self.depths.after(&self.stack, depth, &ray, &after, z.abs(), reflects);
        let mut ray = after.0;
        ray.numbers[2] = depth;
        ray
    }

    #[inline(always)]
    fn has_ended(&self, ray: &Ray<4>) -> bool {
        self.stack.is_out(ray) | (ray.numbers[2] > ray.numbers[3])
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<4>) -> Exit {
        let [x, z, depth, limit] = ray.numbers;
        Depths::exit(self.stack.exit(ray, [x, 0.0, z]), depth, limit)
    }
}

/// Polarisation tracked: x, z, and −1 for s, 1 for p.
#[derive(Clone, Copy)]
pub(crate) struct Polarised(Stack);

impl Polarised {
    pub(crate) fn new(transport: &Transport) -> Self {
        Self(Stack::new(transport))
    }
}

impl Kernel<3, 4> for Polarised {
    const EVENTS: usize = 2;
    const RESTING: [f32; 3] = [0.0, 1.0, 1.0];

    fn stack(&self) -> &Stack {
        &self.0
    }

    #[inline(always)]
    fn start([sin, cos]: [f32; 2], path: u64, _: u32) -> [f32; 3] {
        [sin, cos, if path.is_multiple_of(2) { -1.0 } else { 1.0 }]
    }

    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 4] {
        draw(&self.0, generator)
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<3>, drawn: &[f32; 4], event: usize, rests: bool) -> Ray<3> {
        let [x, z, polarisation] = ray.numbers;
        let facet = facet(drawn[event]);
        let ratio = self.0.ratio(&ray);
        let a = cosine([x, z], facet);
        let a = choose((a > 0.0) & !rests, a, 0.0);
        let fresnel = fresnel(a, ratio);
        let reflects = fresnel.reflects(drawn[2 + event], polarisation.is_sign_negative());
        let [x, z] = bent([x, z], facet, ratio, &fresnel, reflects);
        ray.after([x, z.abs(), polarisation], z, a > 0.0, reflects).0
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<3>) -> Exit {
        let [x, z, _] = ray.numbers;
        self.0.exit(ray, [x, 0.0, z])
    }
}

/// Visible normals: x, z.
#[derive(Clone, Copy)]
pub(crate) struct Visible {
    stack: Stack,
    slope_max: f32,
    tilt_max: f32,
}

impl Visible {
    pub(crate) fn new(transport: &Transport) -> Self {
        let tilt_max = (6.5 * transport.facets.slope_sd).min(80_f64.to_radians());
        Self { stack: Stack::new(transport), slope_max: tilt_max.tan() as f32, tilt_max: tilt_max as f32 }
    }
}

impl Kernel<2, 6> for Visible {
    const EVENTS: usize = 2;
    const RESTING: [f32; 2] = [0.0, 1.0];

    fn stack(&self) -> &Stack {
        &self.stack
    }

    #[inline(always)]
    fn start(incidence: [f32; 2], _: u64, _: u32) -> [f32; 2] {
        incidence
    }

    /// Two tilts, two choices, and two uniforms for the projected areas.
    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 6] {
        let (radius, angle) = (next(generator), next(generator));
        let (first, second) = self.stack.normal.deviates(radius, angle);
        let [weight, choice, other] = [next(generator), next(generator), next(generator)].map(uniform);
        [first, second, left_over(radius, angle), choice, weight, other]
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<2>, drawn: &[f32; 6], event: usize, rests: bool) -> Ray<2> {
        let tilt = drawn[event];
        let facet = facet(tilt);
        let ratio = self.stack.ratio(&ray);
        let a = cosine(ray.numbers, facet);
        let bound = (ray.numbers[1] + self.slope_max) * (drawn[4 + event] * (1.0 / 2_147_483_648.0));
        let seen = (bound * facet[1] <= a) & (tilt.abs() <= self.tilt_max);
        let a = choose((a > 0.0) & seen & !rests, a, 0.0);
        let fresnel = fresnel(a, ratio);
        let reflects = fresnel.reflects_unpolarised(drawn[2 + event]);
        let [x, z] = bent(ray.numbers, facet, ratio, &fresnel, reflects);
        ray.after([x, z.abs()], z, a > 0.0, reflects).0
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<2>) -> Exit {
        let [x, z] = ray.numbers;
        self.stack.exit(ray, [x, 0.0, z])
    }
}
