//! The two shapes, and the camera that looks at them.

use super::vector::{Vector, add, cross, dot, normalize, scale};

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

    /// Whether something stands between a point and the light in a direction.
    pub(super) fn shades(self, point: Vector, direction: Vector) -> bool {
        match self {
            // A convex shape does not shade itself.
            Self::Sphere => false,
            Self::Swatch => swatch_shades(point, direction),
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
        return Surface::Pearl(Hit { point, normal: point, view: scale(direction, -1.0) });
    }
    let t = (-1.0 - origin[2]) / direction[2];
    Surface::Ground((t > 0.0).then(|| add(origin, scale(direction, t))))
}

/// Height of the sheet.
fn height(x: f64, y: f64) -> f64 {
    let fold = (2.6 * x + 1.4 * (1.7 * y + 0.4).sin()).sin();
    let cross = (3.6 * y - 1.3 * x + 1.0 * (2.0 * x).sin()).sin();
    0.16 * fold + 0.1 * cross + 0.03 * (6.1 * x + 4.6 * y).sin()
}

/// Largest height of the sheet.
const CREST: f64 = 0.16 + 0.1 + 0.03;
/// Bound of its slope: the sum of amplitude times wavenumber of its terms.
const STEEPEST: f64 = 0.16 * 3.9 + 0.1 * 5.4 + 0.03 * 7.7;

fn swatch((origin, direction): Ray) -> Surface {
    // The camera looks down: every ray passes the slab that holds the sheet.
    let enter = (CREST - origin[2]) / direction[2];
    let leave = (-CREST - origin[2]) / direction[2];
    let at = |t: f64| add(origin, scale(direction, t));
    let above = |p: Vector| p[2] - height(p[0], p[1]);
    // The sheet is nowhere steeper than STEEPEST: this much of the height is free of it.
    let free = 1.0 / (1.0 + STEEPEST);
    let mut t = enter;
    for _ in 0..80 {
        let step = above(at(t)) * free;
        t = (t + step).min(leave);
        if step < 1e-5 {
            break;
        }
    }
    let hi = t;
    let point = at(hi);
    let e = 1e-4;
    let slope_x = (height(point[0] + e, point[1]) - height(point[0] - e, point[1])) / (2.0 * e);
    let slope_y = (height(point[0], point[1] + e) - height(point[0], point[1] - e)) / (2.0 * e);
    Surface::Pearl(Hit { point, normal: normalize([-slope_x, -slope_y, 1.0]), view: scale(direction, -1.0) })
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
