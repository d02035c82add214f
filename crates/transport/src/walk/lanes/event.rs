//! One event of one path, in the mirrored frame.

use std::hint::select_unpredictable as choose;

use super::draws::{Normal, tilt_sin_cos};
use super::kernel::{Kernel, Layers, Shape};
use super::real::Real;

/// The constants of a walk.
#[derive(Clone, Debug)]
pub(crate) struct Problem<R> {
    pub(crate) constants: Constants<R>,
    /// Explicit stacks: n1/n2 by 2·interface + (1 if heading up).
    pub(crate) ratios: Vec<R>,
    /// Explicit stacks: optical depth by medium (0 in the ambient and the substrate).
    pub(crate) depths: Vec<R>,
    /// Stacks with complex indices: faces, as ratios.
    pub(crate) faces: Vec<ComplexFace<R>>,
}

/// An interface between media of complex index, in units of the first one's real index n₁: with kₓ = sin θ₁, kz² of the first medium is
/// cos²θ₁ − κ² + 2iκ and that of the second larger by the contrast.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ComplexFace<R> {
    /// κ = k₁/n₁.
    pub(crate) kappa: R,
    /// (N₂² − N₁²)/n₁².
    pub(crate) contrast: [R; 2],
    /// Im N₂²/n₁²: exactly 0 in a clear medium.
    pub(crate) below: R,
}

impl<R: Real> ComplexFace<R> {
    pub(crate) const NONE: Self = Self { kappa: R::ZERO, contrast: [R::ZERO; 2], below: R::ZERO };

    /// Reflectance for s and for p at cos² of the local angle, as [`thinfilm::intensity::fresnel_complex`].
    #[inline(always)]
    fn reflectance<const FUSED: bool>(&self, cos2: R) -> (R, R) {
        let Self { kappa, contrast, below } = *self;
        let re = (-kappa).fma::<FUSED>(kappa, cos2);
        let (a, b) = (root::<R, FUSED>(re, kappa + kappa), root::<R, FUSED>(re + contrast[0], below));
        let sum = [a[0] + b[0], a[1] + b[1]];
        let norm = |z: [R; 2]| z[0].fma::<FUSED>(z[0], z[1] * z[1]);
        let product = [a[0].fma::<FUSED>(b[0], -(a[1] * b[1])), a[0].fma::<FUSED>(b[1], a[1] * b[0])];
        let sin2 = R::ONE - cos2;
        let whole = norm(sum);
        let s = norm(contrast) / (whole * whole);
        let turned = norm([product[0] - sin2, product[1]]) / norm([product[0] + sin2, product[1]]);
        let most = |x: R| choose(x < R::ONE, x, R::ONE);
        (most(s), most(s * turned))
    }
}

/// √(re + i im) for im ≥ 0, in the upper half plane.
#[inline(always)]
fn root<R: Real, const FUSED: bool>(re: R, im: R) -> [R; 2] {
    let norm = re.fma::<FUSED>(re, im * im).sqrt();
    let large = (R::from_f64(0.5) * (norm + re.abs())).sqrt();
    let small = choose(large > R::ZERO, im / (large + large), R::ZERO);
    let forward = re >= R::ZERO;
    [choose(forward, large, small), choose(forward, small, large)]
}

/// The constants of an event. Copied before the loop over lanes: a choice between two fields behind a reference
/// would become a gather.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Constants<R> {
    /// L: index of the last interface.
    pub(crate) last: i32,
    /// n1/n2 of interfaces between layers, leaving an odd and leaving an even medium.
    pub(crate) odd: R,
    pub(crate) even: R,
    /// n1/n2 at interface 0, downwards and upwards.
    pub(crate) enter: R,
    pub(crate) leave: R,
    /// n1/n2 at interface L, downwards and upwards.
    pub(crate) out: R,
    pub(crate) back: R,
    /// Optical depths of odd and even layers.
    pub(crate) depth_odd: R,
    pub(crate) depth_even: R,
    /// Facet tilts.
    pub(crate) normal: Normal,
    /// Visible normals: the largest |slope|, and in the plane the largest |tilt|.
    pub(crate) slope_max: R,
    pub(crate) tilt_max: f32,
    /// Coherent sheets.
    pub(crate) film: Film<R>,
}

/// A ray on its way to an interface, mirrored so that it always travels towards +z.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray<R> {
    pub(crate) x: R,
    pub(crate) y: R,
    /// |cos θ|.
    pub(crate) z: R,
    /// Index of the interface ahead: −1 when it has left the top, L + 1 when it has left the bottom.
    pub(crate) interface: i32,
    /// +1 heading down, −1 heading up.
    pub(crate) step: i32,
    /// Four times the crossings so far, and [`ENTERED`].
    pub(crate) met: u32,
    /// Optical depth so far.
    pub(crate) depth: R,
}

/// The constants of a coherent sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Film<R> {
    /// Index of the last interface that is a sheet; 0 without sheets.
    pub(crate) last: i32,
    /// n₁² and n₂², of the media around the sheet and of the sheet.
    pub(crate) outer: R,
    pub(crate) inner: R,
    /// (2πd/λ)².
    pub(crate) phase2: R,
}

/// 2·(−4)ʲ/(2j + 2)!: sin²√t/t = Σ cⱼ tʲ. Twelve terms leave 1e-15 for |t| up to (π/2)².
const SINC2: [f64; 12] = {
    let mut terms = [0.0; 12];
    let (mut term, mut j) = (1.0, 0);
    while j < 12 {
        terms[j] = term;
        let next = 2.0 * j as f64 + 3.0;
        term *= -4.0 / (next * (next + 1.0));
        j += 1;
    }
    terms
};

impl<R: Real> Film<R> {
    /// Reflectance for s and for p at cos² of the local angle: F/(1 + F) with F = 4r²/(1 − r²)²·sin²δ, which is analytic
    /// through the critical angle when written in cos²θ₂ (negative past it).
    #[inline(always)]
    fn reflectance<const FUSED: bool>(&self, cos2: R) -> (R, R) {
        let q1 = self.outer * cos2;
        let q2 = q1 + (self.inner - self.outer);
        let t = self.phase2 * q2;
        let mut series = R::from_f64(SINC2[11]);
        for term in SINC2[..11].iter().rev() {
            series = series.fma::<FUSED>(t, R::from_f64(*term));
        }
        let strength = self.phase2 * series;
        let four = R::from_f64(4.0);
        let gap = self.outer - self.inner;
        let s = gap * gap * strength;
        // (cos²θ₁/n₁² − q₂/n₂⁴)²·n₂⁴, over 4cos²θ₁/n₁².
        let p1 = cos2 / self.outer;
        let difference = p1 * self.inner - q2 / self.inner;
        let p = difference * difference * strength;
        (s / (s + four * q1), p / (p + four * p1))
    }
}

/// One crossing in [`Ray::met`].
pub(crate) const CROSSING: u32 = 4;
/// Flag in [`Ray::met`]: the path has been refracted, so it has entered the stack.
pub(crate) const ENTERED: u32 = 2;

/// A facet, its normal (x, y, −z) not normalised.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet<R> {
    pub(crate) x: R,
    pub(crate) y: R,
    pub(crate) z: R,
    /// Squared length of the normal.
    pub(crate) square: R,
}

impl<R: Real> Facet<R> {
    /// From two slopes.
    #[inline(always)]
    pub(crate) fn sloped<const FUSED: bool>(p: f32, q: f32) -> Self {
        let (x, y) = (R::from_f32(p), R::from_f32(q));
        Self { x, y, z: R::ONE, square: x.fma::<FUSED>(x, y.fma::<FUSED>(y, R::ONE)) }
    }

    /// From a tilt in the plane of incidence.
    #[inline(always)]
    pub(crate) fn tilted<K: Kernel, const FUSED: bool>(alpha: f32) -> Self {
        let halvings = match K::MODES.shape {
            Shape::Plane { halvings } => halvings,
            Shape::Space => 0,
        };
        let (x, z) = tilt_sin_cos::<R, FUSED>(R::from_f32(alpha), halvings);
        Self { x, y: R::ZERO, z, square: R::ONE }
    }
}

/// What a ray finds ahead of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ahead<R> {
    /// n1/n2 of the next interface.
    pub(crate) ratio: R,
    /// Optical depth of the layer that the ray is in.
    pub(crate) here: R,
    /// Optical depth of the layer behind the interface.
    pub(crate) beyond: R,
    /// The next interface, where indices are complex.
    pub(crate) face: ComplexFace<R>,
}

/// Half the scale of [`uniform`](super::draws::uniform), a part in 10⁷ above it so that rounding can never refract
/// light past the critical angle.
const HALF_SCALE: f64 = 1_073_742_080.0;

impl<R: Real> Problem<R> {
    /// The interface ahead, in any stack.
    #[inline(always)]
    pub(crate) fn explicit<const COMPLEX: bool>(&self, interface: i32, step: i32) -> Ahead<R> {
        let up = usize::from(step < 0);
        // Rays that have left are looked up too, without being moved: any entry will do.
        let interface = interface.clamp(0, self.constants.last) as usize;
        Ahead {
            ratio: self.ratios[2 * interface + up],
            here: self.depths[interface + up],
            beyond: self.depths[interface + 1 - up],
            face: if COMPLEX { self.faces[2 * interface + up] } else { ComplexFace::NONE },
        }
    }
}

impl<R: Real> Constants<R> {
    /// The interface ahead, in a stack whose layers repeat.
    #[inline(always)]
    pub(crate) fn repeating<K: Kernel>(&self, interface: i32, step: i32) -> Ahead<R> {
        let up = step < 0;
        let first = choose(up, self.leave, self.enter);
        let last = choose(up, self.back, self.out);
        if matches!(K::MODES.layers, Layers::Uniform) {
            let below = choose(interface == self.last, last, R::ONE);
            let ratio = choose(interface == 0, first, below);
            return Ahead { ratio, here: self.depth_odd, beyond: self.depth_odd, face: ComplexFace::NONE };
        }
        let odd = up ^ (interface & 1 != 0);
        let inner = choose(odd, self.odd, self.even);
        let below = match K::MODES.layers {
            Layers::Periodic => inner,
            _ => choose(interface == self.last, last, inner),
        };
        Ahead {
            ratio: choose(interface == 0, first, below),
            here: choose(odd, self.depth_odd, self.depth_even),
            beyond: choose(odd, self.depth_even, self.depth_odd),
            face: ComplexFace::NONE,
        }
    }

    /// Whether a facet is taken, by its projected area per plane area, −d·m/m_z; `draw` is uniform.
    #[inline(always)]
    pub(crate) fn sees<K: Kernel>(&self, ray: &Ray<R>, facet: Facet<R>, tilt: f32, a: R, draw: f32) -> bool {
        let bound = (ray.z + self.slope_max) * R::from_f32(draw * (1.0 / 2_147_483_648.0));
        (bound * facet.z <= a) & (K::MODES.is_space() || tilt.abs() <= self.tilt_max)
    }

    /// One event: the ray meets `facet`; `choice`, uniform on (0, 2³¹], decides between reflection and refraction.
    /// A facet that faces away, or that `takes` refuses, changes nothing.
    /// Tracked light is s or p (`is_s`).
    #[inline(always)]
    pub(crate) fn meet<K: Kernel, const FUSED: bool>(
        &self,
        ray: Ray<R>,
        facet: Facet<R>,
        ahead: Ahead<R>,
        choice: f32,
        is_s: bool,
        takes: impl Fn(R) -> bool,
    ) -> Ray<R> {
        let space = K::MODES.is_space();
        let ratio = ahead.ratio;
        let contrast = (-ratio).fma::<FUSED>(ratio, R::ONE);
        // a = |N| cos θ1, b = |N| cos θ2 (0 past the critical angle).
        let a = if space {
            (-ray.x).fma::<FUSED>(facet.x, (-ray.y).fma::<FUSED>(facet.y, ray.z))
        } else {
            (-ray.x).fma::<FUSED>(facet.x, ray.z * facet.z)
        };
        // A facet that is refused becomes a grazing one: it reflects, and adds twice nothing to the direction.
        let a = choose((a > R::ZERO) & takes(a), a, R::ZERO);
        let faces = a > R::ZERO;
        let scaled = a * ratio;
        let square = scaled.fma::<FUSED>(scaled, if space { facet.square * contrast } else { contrast });
        let b = choose(square > R::ZERO, square, R::ZERO).sqrt();
        // r_s = sn/sd and r_p = pn/pd; u ≤ (r_s² + r_p²)/2 without a division.
        let (sd, sn) = (scaled + b, scaled - b);
        let (pd, pn) = (ratio.fma::<FUSED>(b, a), (-ratio).fma::<FUSED>(b, a));
        let (both, s, p) = (sd * pd, sn * pd, pn * sd);
        let needed = R::from_f32(choice) * both * both;
        let mut reflects = if K::MODES.tracked {
            let kept = choose(is_s, s, p);
            needed <= R::from_f64(2.0 * HALF_SCALE) * (kept * kept)
        } else {
            needed <= R::from_f64(HALF_SCALE) * s.fma::<FUSED>(s, p * p)
        };
        // Total reflection that absorbs: no ray goes on.
        let mut swallowed = false;
        if K::MODES.complex {
            let cos2 = if space { a * a / facet.square } else { a * a };
            let (s, p) = ahead.face.reflectance::<FUSED>(cos2);
            let face = if K::MODES.tracked { choose(is_s, s, p) } else { R::from_f64(0.5) * (s + p) };
            // A facet that faces away counts as one that reflects.
            let reflected = !faces | (R::from_f32(choice) <= R::from_f64(2.0 * HALF_SCALE) * face);
            let total = square <= R::ZERO;
            swallowed = !reflected & total;
            reflects = reflected | total;
        }
        if K::MODES.sheets {
            let cos2 = if space { a * a / facet.square } else { a * a };
            let (s, p) = self.film.reflectance::<FUSED>(cos2);
            let film = if K::MODES.tracked { choose(is_s, s, p) } else { R::from_f64(0.5) * (s + p) };
            // A facet that faces away counts as one that reflects.
            let reflected = !faces | (R::from_f32(choice) <= R::from_f64(2.0 * HALF_SCALE) * film);
            let is_sheet = (ray.interface > 0) & (ray.interface <= self.film.last);
            reflects = choose(is_sheet, reflected, reflects);
            swallowed &= !is_sheet;
        }
        let along = choose(reflects, R::ONE, ratio);
        let normal = choose(reflects, a + a, sn);
        let normal = if space { normal / facet.square } else { normal };
        let z = ray.z.fma::<FUSED>(along, -(if space { normal } else { normal * facet.z }));
        let turns = faces & (z <= R::ZERO);
        // Reflected upwards or refracted onwards, the ray crosses a layer; else it meets the same interface again.
        let crosses = (reflects == turns) & !swallowed;
        let step = choose(turns, -ray.step, ray.step);
        let met = ray.met + choose(faces, CROSSING, 0);
        let mut next = Ray {
            x: ray.x.fma::<FUSED>(along, normal * facet.x),
            y: if space { ray.y.fma::<FUSED>(along, normal * facet.y) } else { ray.y },
            z: z.abs(),
            interface: choose(crosses, ray.interface + step, ray.interface),
            step,
            met: choose(reflects, met, met | ENTERED),
            depth: ray.depth,
        };
        if K::MODES.absorbs {
            let layer = choose(reflects, ahead.here, ahead.beyond);
            let absorbs = crosses & (layer > R::ZERO) & !self.is_out(&next);
            next.depth = choose(absorbs, ray.depth + layer / next.z, ray.depth);
            next.depth = choose(swallowed, R::from_f64(f64::INFINITY), next.depth);
        }
        next
    }

    /// Whether a ray has left the stack.
    #[inline(always)]
    pub(crate) fn is_out(&self, ray: &Ray<R>) -> bool {
        ray.interface as u32 > self.last as u32
    }
}
