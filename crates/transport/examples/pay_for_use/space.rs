//! Space walks that know one thing each: unpolarised light in a periodic stack, and at most one effect.
//!
//! Nothing here can be switched: what a kernel does not name it does not have.

use std::hint::select_unpredictable as choose;

use transport::Transport;
use transport::walk::Exit;

use super::draws::{Generator, absorption_limit, left_over, next, uniform};
use super::lanes::{Kernel, Ray};
use super::stack::{Depths, Fresnel, Stack};

/// cos θ1 on a facet, times the length of its normal (p, q, −1).
#[inline(always)]
fn cosine([x, y, z]: [f32; 3], [p, q]: [f32; 2]) -> f32 {
    (-x).mul_add(p, (-y).mul_add(q, z))
}

/// Squared length of a facet's normal.
#[inline(always)]
fn length2([p, q]: [f32; 2]) -> f32 {
    p.mul_add(p, q.mul_add(q, 1.0))
}

#[inline(always)]
fn fresnel(a: f32, ratio: f32, length2: f32) -> Fresnel {
    let contrast = (-ratio).mul_add(ratio, 1.0);
    Fresnel::new(a, ratio, length2 * contrast)
}

/// The direction after an event, z with its sign.
#[inline(always)]
fn bent(
    [x, y, z]: [f32; 3],
    [p, q]: [f32; 2],
    ratio: f32,
    length2: f32,
    fresnel: &Fresnel,
    reflects: bool,
) -> [f32; 3] {
    let along = choose(reflects, 1.0, ratio);
    let normal = choose(reflects, fresnel.a + fresnel.a, fresnel.bend) / length2;
    [x.mul_add(along, normal * p), y.mul_add(along, normal * q), z.mul_add(along, -normal)]
}

/// Two slopes, a choice.
#[inline(always)]
fn draw(stack: &Stack, generator: &mut Generator) -> [f32; 3] {
    let (radius, angle) = (next(generator), next(generator));
    let (first, second) = stack.normal.deviates(radius, angle);
    [first, second, left_over(radius, angle)]
}

/// No effect: x, y, z.
#[derive(Clone, Copy)]
pub(crate) struct Plain(Stack);

impl Plain {
    pub(crate) fn new(transport: &Transport) -> Self {
        Self(Stack::new(transport))
    }
}

impl Kernel<3, 3> for Plain {
    const EVENTS: usize = 1;
    const RESTING: [f32; 3] = [0.0, 0.0, 1.0];

    fn stack(&self) -> &Stack {
        &self.0
    }

    #[inline(always)]
    fn start([sin, cos]: [f32; 2], _: u64, _: u32) -> [f32; 3] {
        [sin, 0.0, cos]
    }

    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 3] {
        draw(&self.0, generator)
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<3>, &[p, q, choice]: &[f32; 3], _: usize, _: bool) -> Ray<3> {
        let length2 = length2([p, q]);
        let ratio = self.0.ratio(&ray);
        let a = cosine(ray.numbers, [p, q]);
        let a = choose(a > 0.0, a, 0.0);
        let fresnel = fresnel(a, ratio, length2);
        let reflects = fresnel.reflects_unpolarised(choice);
        let [x, y, z] = bent(ray.numbers, [p, q], ratio, length2, &fresnel, reflects);
        ray.after([x, y, z.abs()], z, a > 0.0, reflects).0
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<3>) -> Exit {
        self.0.exit(ray, ray.numbers)
    }
}

/// Absorption: x, y, z, optical depth so far, and the most of it.
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

impl Kernel<5, 3> for Absorbing {
    const EVENTS: usize = 1;
    const RESTING: [f32; 5] = [0.0, 0.0, 1.0, 0.0, f32::INFINITY];

    fn stack(&self) -> &Stack {
        &self.stack
    }

    #[inline(always)]
    fn start([sin, cos]: [f32; 2], _: u64, spare: u32) -> [f32; 5] {
        [sin, 0.0, cos, 0.0, absorption_limit(spare)]
    }

    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 3] {
        draw(&self.stack, generator)
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<5>, &[p, q, choice]: &[f32; 3], _: usize, _: bool) -> Ray<5> {
        let [x, y, z, depth, limit] = ray.numbers;
        let length2 = length2([p, q]);
        let ratio = self.stack.ratio(&ray);
        let a = cosine([x, y, z], [p, q]);
        let a = choose(a > 0.0, a, 0.0);
        let fresnel = fresnel(a, ratio, length2);
        let reflects = fresnel.reflects_unpolarised(choice);
        let [x, y, z] = bent([x, y, z], [p, q], ratio, length2, &fresnel, reflects);
        let after = ray.after([x, y, z.abs(), depth, limit], z, a > 0.0, reflects);
        let depth = self.depths.after(&self.stack, depth, &ray, &after, z.abs(), reflects);
        let mut ray = after.0;
        ray.numbers[3] = depth;
        ray
    }

    #[inline(always)]
    fn has_ended(&self, ray: &Ray<5>) -> bool {
        self.stack.is_out(ray) | (ray.numbers[3] > ray.numbers[4])
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<5>) -> Exit {
        let [x, y, z, depth, limit] = ray.numbers;
        Depths::exit(self.stack.exit(ray, [x, y, z]), depth, limit)
    }
}

/// Visible normals: x, y, z.
#[derive(Clone, Copy)]
pub(crate) struct Visible {
    stack: Stack,
    slope_max: f32,
}

impl Visible {
    pub(crate) fn new(transport: &Transport) -> Self {
        // The longest deviate.
        Self { stack: Stack::new(transport), slope_max: (6.67 * transport.facets.slope_sd) as f32 }
    }
}

impl Kernel<3, 4> for Visible {
    const EVENTS: usize = 1;
    const RESTING: [f32; 3] = [0.0, 0.0, 1.0];

    fn stack(&self) -> &Stack {
        &self.stack
    }

    #[inline(always)]
    fn start([sin, cos]: [f32; 2], _: u64, _: u32) -> [f32; 3] {
        [sin, 0.0, cos]
    }

    /// Two slopes, a choice, and a uniform for the projected area.
    #[inline(always)]
    fn draw(&self, generator: &mut Generator) -> [f32; 4] {
        let [p, q, choice] = draw(&self.stack, generator);
        [p, q, choice, uniform(next(generator))]
    }

    #[inline(always)]
    fn meet(&self, ray: Ray<3>, &[p, q, choice, weight]: &[f32; 4], _: usize, _: bool) -> Ray<3> {
        let length2 = length2([p, q]);
        let ratio = self.stack.ratio(&ray);
        let a = cosine(ray.numbers, [p, q]);
        let bound = (ray.numbers[2] + self.slope_max) * (weight * (1.0 / 2_147_483_648.0));
        let a = choose((a > 0.0) & (bound <= a), a, 0.0);
        let fresnel = fresnel(a, ratio, length2);
        let reflects = fresnel.reflects_unpolarised(choice);
        let [x, y, z] = bent(ray.numbers, [p, q], ratio, length2, &fresnel, reflects);
        ray.after([x, y, z.abs()], z, a > 0.0, reflects).0
    }

    #[inline(always)]
    fn exit(&self, ray: &Ray<3>) -> Exit {
        self.stack.exit(ray, ray.numbers)
    }
}
