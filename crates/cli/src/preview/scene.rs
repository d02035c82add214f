//! The two shapes, and the camera that looks at them.

use super::vector::{Vector, add, cross, dot, normalize, scale};
use std::f64::consts::{FRAC_1_PI, PI};

/// What is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A unit sphere on the ground z = −1.
    Sphere,
    /// A sheet with folds.
    Swatch,
}

/// A ray: origin and unit direction.
pub(super) type Ray = (Vector, Vector);

/// What a ray meets.
pub(super) enum Surface {
    Pearl(Hit),
    /// The ground, or the backdrop where `None`.
    Ground(Option<Vector>),
}

/// A point of a pearl.
pub(super) struct Hit {
    pub(super) point: Vector,
    /// Unit normal on the viewer's side.
    pub(super) normal: Vector,
    /// Unit vector to the viewer.
    pub(super) view: Vector,
    /// What it is a point of.
    pub(super) shape: Shape,
}

impl Hit {
    /// Whether something stands between the point and the light in a direction.
    pub(super) fn shades(&self, direction: Vector) -> bool {
        match self.shape {
            // A convex shape does not shade itself.
            Shape::Sphere => false,
            Shape::Swatch => swatch_shades(self.point, direction),
        }
    }
}

/// A pinhole camera.
pub(super) struct Camera {
    origin: Vector,
    right: Vector,
    up: Vector,
    forward: Vector,
}

impl Camera {
    fn new(origin: Vector, target: Vector, half_width: f64) -> Self {
        let forward = normalize(add(target, scale(origin, -1.0)));
        let right = normalize(cross(forward, [0.0, 0.0, 1.0]));
        let up = cross(right, forward);
        Self { origin, right: scale(right, half_width), up: scale(up, half_width), forward }
    }

    /// The ray through a point of the image, x to the right and y up, both from −1 to 1.
    pub(super) fn ray(&self, x: f64, y: f64) -> Ray {
        (self.origin, normalize(add(self.forward, add(scale(self.right, x), scale(self.up, y)))))
    }
}

impl Shape {
    /// All there are.
    pub const ALL: [Self; 2] = [Self::Sphere, Self::Swatch];

    /// Name in file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::Swatch => "swatch",
        }
    }

    pub(super) fn camera(self) -> Camera {
        match self {
            Self::Sphere => Camera::new([0.0, -7.0, 1.5], [0.0, 0.0, -0.06], 0.19),
            Self::Swatch => Camera::new([0.0, -4.6, 4.4], [0.0, 0.06, 0.0], 0.235),
        }
    }

    pub(super) fn hit(self, ray: Ray) -> Surface {
        match self {
            Self::Sphere => sphere_or_ground(ray),
            Self::Swatch => swatch(ray),
        }
    }
}

/// Distance along a ray to the unit sphere at the origin.
pub(super) fn sphere_distance((origin, direction): Ray) -> Option<f64> {
    let (b, c) = (dot(origin, direction), dot(origin, origin) - 1.0);
    let discriminant = b * b - c;
    let t = -b - discriminant.max(0.0).sqrt();
    (discriminant > 0.0 && t > 1e-9).then_some(t)
}

fn sphere_or_ground(ray: Ray) -> Surface {
    let (origin, direction) = ray;
    if let Some(t) = sphere_distance(ray) {
        let point = add(origin, scale(direction, t));
        return Surface::Pearl(Hit {
            point,
            normal: point,
            view: scale(direction, -1.0),
            shape: Shape::Sphere,
        });
    }
    let t = (-1.0 - origin[2]) / direction[2];
    Surface::Ground((t > 0.0).then(|| add(origin, scale(direction, t))))
}

/// Height of the sheet, and the slopes along x and y.
fn sheet(x: f64, y: f64) -> (f64, [f64; 2]) {
    let (bend, bend_slope) = (1.7 * y + 0.4).sin_cos();
    let (fold, fold_slope) = (2.6 * x + 1.4 * bend).sin_cos();
    let (twist, twist_slope) = (2.0 * x).sin_cos();
    let (cross, cross_slope) = (3.6 * y - 1.3 * x + twist).sin_cos();
    let (ripple, ripple_slope) = (6.1 * x + 4.6 * y).sin_cos();
    let height = 0.16 * fold + 0.1 * cross + 0.03 * ripple;
    let along_x =
        0.16 * 2.6 * fold_slope + 0.1 * (2.0 * twist_slope - 1.3) * cross_slope + 0.03 * 6.1 * ripple_slope;
    let along_y =
        0.16 * 1.4 * 1.7 * bend_slope * fold_slope + 0.1 * 3.6 * cross_slope + 0.03 * 4.6 * ripple_slope;
    (height, [along_x, along_y])
}

/// The height alone, of which rays ask often.
fn height(x: f64, y: f64) -> f64 {
    let (bend, twist) = (sine(1.7 * y + 0.4), sine(2.0 * x));
    let (fold, cross) = (sine(2.6 * x + 1.4 * bend), sine(3.6 * y - 1.3 * x + twist));
    let ripple = sine(6.1 * x + 4.6 * y);
    0.16 * fold + 0.1 * cross + 0.03 * ripple
}

/// sin x of |x| < 1e4, error 1e-11.
#[inline]
fn sine(x: f64) -> f64 {
    /// 1.5·2^52: added to a smaller number, rounds it to a whole one.
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
    /// One over 3!, 5! to 15!.
    const INVERSE_FACTORIALS: [f64; 7] = {
        let (mut inverse, mut factorial, mut k) = ([0.0; 7], 1.0, 0);
        while k < inverse.len() {
            factorial *= ((2 * k + 2) * (2 * k + 3)) as f64;
            inverse[k] = 1.0 / factorial;
            k += 1;
        }
        inverse
    };
    let halves = x * FRAC_1_PI + ROUNDER;
    let r = x - (halves - ROUNDER) * PI;
    // Taylor's series, |r| ≤ π/2.
    let (z, z2) = (r * r, r * r * r * r);
    let low = (1.0 - z * INVERSE_FACTORIALS[0]) + (INVERSE_FACTORIALS[1] - z * INVERSE_FACTORIALS[2]) * z2;
    let high = (INVERSE_FACTORIALS[3] - z * INVERSE_FACTORIALS[4])
        + (INVERSE_FACTORIALS[5] - z * INVERSE_FACTORIALS[6]) * z2;
    let series = low + high * (z2 * z2);
    if halves.to_bits() & 1 == 1 { -r * series } else { r * series }
}

/// Largest height of the sheet.
const CREST: f64 = 0.16 + 0.1 + 0.03;
/// Height over the sheet below which it is straight enough for the secant's method.
const NEAR: f64 = 0.004;
/// Bound of its slope: the sum of amplitude times wavenumber of its terms.
const STEEPEST: f64 = 0.16 * 3.9 + 0.1 * 5.4 + 0.03 * 7.7;

fn swatch((origin, direction): Ray) -> Surface {
    // The camera looks down: every ray passes the slab that holds the sheet.
    let enter = (CREST - origin[2]) / direction[2];
    let leave = (-CREST - origin[2]) / direction[2];
    let at = |t: f64| add(origin, scale(direction, t));
    let above = |p: Vector| p[2] - height(p[0], p[1]);
    // The sheet is nowhere steeper than STEEPEST: so far the ray is free of it for every unit of height above it.
    let along = (direction[0] * direction[0] + direction[1] * direction[1]).sqrt();
    let free = 1.0 / (STEEPEST * along - direction[2]);
    let mut before = (enter, above(at(enter)));
    let mut t = enter;
    for _ in 0..80 {
        t = (before.0 + before.1 * free).min(leave);
        let clear = above(at(t));
        if clear < NEAR {
            t = secant(before, (t, clear), |t| above(at(t))).clamp(enter, leave);
            break;
        }
        before = (t, clear);
    }
    let point = at(t);
    let (_, [slope_x, slope_y]) = sheet(point[0], point[1]);
    let normal = normalize([-slope_x, -slope_y, 1.0]);
    Surface::Pearl(Hit { point, normal, view: scale(direction, -1.0), shape: Shape::Swatch })
}

/// Where a function falls to zero that is all but straight, from two of its points.
fn secant(mut before: (f64, f64), mut now: (f64, f64), f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..10 {
        let fall = (before.1 - now.1) / (now.0 - before.0);
        if now.1.abs() < 1e-9 || !fall.is_finite() || fall <= 0.0 {
            break;
        }
        let t = now.0 + now.1 / fall;
        (before, now) = (now, (t, f(t)));
    }
    now.0
}

fn swatch_shades(point: Vector, direction: Vector) -> bool {
    if direction[2] <= 0.0 {
        return true;
    }
    let leave = (CREST - point[2]) / direction[2];
    let steps = 10;
    (1..=steps).any(|i| {
        let p = add(point, scale(direction, 0.01 + leave * f64::from(i) / f64::from(steps)));
        p[2] < height(p[0], p[1])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_height_alone_is_that_of_the_sheet() {
        for k in 0..10_000 {
            let (x, y) = (0.013 * f64::from(k % 100) - 0.6, 0.017 * f64::from(k / 100) - 0.9);
            assert!((height(x, y) - sheet(x, y).0).abs() < 1e-11, "{x} {y}");
        }
        assert!((sine(1e3) - 1e3_f64.sin()).abs() < 1e-11 && sine(-0.3) == -sine(0.3));
    }

    #[test]
    fn rays_end_on_the_sheet_and_its_slopes_are_those_of_its_height() {
        let camera = Shape::Swatch.camera();
        for k in 0..400 {
            let (u, v) = (f64::from(k % 20) / 10.0 - 0.95, f64::from(k / 20) / 10.0 - 0.95);
            let (origin, direction) = camera.ray(u, v);
            let Surface::Pearl(hit) = Shape::Swatch.hit((origin, direction)) else {
                panic!("the sheet fills the picture")
            };
            let [x, y, z] = hit.point;
            assert!((z - height(x, y)).abs() < 1e-7, "{u} {v}: {}", z - height(x, y));
            // Nothing of the sheet stands before it.
            let reached = dot(add(hit.point, scale(origin, -1.0)), direction);
            let clear = |part: f64| {
                let [x, y, z] = add(origin, scale(direction, part * reached));
                z - height(x, y)
            };
            assert!((1..1000).all(|k| clear(f64::from(k) / 1000.0) > -1e-9), "{u} {v}");
            let (_, slopes) = sheet(x, y);
            let e = 1e-5;
            let differences = [
                (height(x + e, y) - height(x - e, y)) / (2.0 * e),
                (height(x, y + e) - height(x, y - e)) / (2.0 * e),
            ];
            for (slope, difference) in slopes.iter().zip(differences) {
                assert!((slope - difference).abs() < 1e-8, "{slope} {difference}");
            }
        }
    }
}
