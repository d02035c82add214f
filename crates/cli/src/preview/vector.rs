//! Three numbers: points, directions, linear colours.

pub(super) type Vector = [f64; 3];

pub(super) fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn scale(a: Vector, s: f64) -> Vector {
    a.map(|x| x * s)
}

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn normalize(a: Vector) -> Vector {
    scale(a, 1.0 / dot(a, a).sqrt())
}

/// From `a` at t = 0 to `b` at t = 1.
pub(super) fn mix(a: Vector, b: Vector, t: f64) -> Vector {
    add(scale(a, 1.0 - t), scale(b, t))
}

/// Smooth step from 0 below `lo` to 1 above `hi`.
pub(super) fn smooth(lo: f64, hi: f64, x: f64) -> f64 {
    let t = ((x - lo) / (hi - lo)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A right-handed frame whose third axis is a unit vector (Duff et al. 2017).
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) x: Vector,
    pub(super) y: Vector,
    pub(super) z: Vector,
}

impl Frame {
    pub(super) fn new(z: Vector) -> Self {
        let sign = 1f64.copysign(z[2]);
        let a = -1.0 / (sign + z[2]);
        let b = z[0] * z[1] * a;
        Self {
            x: [1.0 + sign * z[0] * z[0] * a, sign * b, -sign * z[0]],
            y: [b, sign + z[1] * z[1] * a, -z[1]],
            z,
        }
    }

    pub(super) fn to_local(self, v: Vector) -> Vector {
        [dot(v, self.x), dot(v, self.y), dot(v, self.z)]
    }

    pub(super) fn to_world(self, v: Vector) -> Vector {
        add(add(scale(self.x, v[0]), scale(self.y, v[1])), scale(self.z, v[2]))
    }
}
