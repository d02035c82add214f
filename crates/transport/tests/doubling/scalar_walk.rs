//! A walk written from MODEL.md alone, as plainly as possible: the tests' independent witness.

use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use transport::{Geometry, Normals, Transport};

/// How a path ended.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Exit {
    /// Left the top without having passed interface 0, after this many hits.
    Surface {
        hits: u32,
    },
    /// Entered and left the top: signed angle (plane), or θo and |φ| (space).
    Interior {
        theta: f64,
        phi: f64,
    },
    Transmitted,
    Absorbed,
}

/// A facet normal for a ray along d (d.z < 0), redrawn until it faces the ray.
fn facet(transport: &Transport, geometry: Geometry, d: [f64; 3], rng: &mut impl Rng) -> [f64; 3] {
    let sigma = transport.facets.slope_sd;
    loop {
        let mut normal = || -> f64 { sigma * rng.sample::<f64, _>(StandardNormal) };
        let m = match geometry {
            Geometry::Plane => {
                let alpha = normal();
                let steep = alpha.abs() > (6.5 * sigma).min(80_f64.to_radians());
                if transport.facets.normals == Normals::Visible && steep {
                    continue;
                }
                [alpha.sin(), 0.0, alpha.cos()]
            }
            Geometry::Space => {
                let (p, q) = (normal(), normal());
                let length = (1.0 + p * p + q * q).sqrt();
                [-p / length, -q / length, 1.0 / length]
            }
        };
        let facing = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2]);
        if facing <= 0.0 {
            continue;
        }
        if transport.facets.normals == Normals::Visible {
            // Rejection against the largest projected area within 9σ (space) or within the tilt limit (plane).
            let steepest = match geometry {
                Geometry::Plane => (6.5 * sigma).min(80_f64.to_radians()).tan(),
                Geometry::Space => 9.0 * sigma,
            };
            let bound = -d[2] + steepest * d[0].hypot(d[1]);
            if rng.random::<f64>() * bound > facing / m[2] {
                continue;
            }
        }
        return m;
    }
}

/// One path from the top at incidence `theta`.
pub(crate) fn walk(transport: &Transport, geometry: Geometry, theta: f64, rng: &mut impl Rng) -> Exit {
    // Seen from the side that the ray is on: z away from the interface, d.z < 0 towards it.
    let mut d = [theta.sin(), 0.0, -theta.cos()];
    let (mut interface, mut from_above) = (0_usize, true);
    let (mut entered, mut hits) = (false, 0);
    loop {
        let (upper, lower) = (transport.indices[interface], transport.indices[interface + 1]);
        let eta = if from_above { upper / lower } else { lower / upper };
        let m = facet(transport, geometry, d, rng);
        hits += 1;
        let cos_i = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2]);
        let sin_t_squared = eta * eta * (1.0 - cos_i * cos_i);
        let mut reflectance = 1.0;
        let mut cos_t = 0.0;
        if sin_t_squared < 1.0 {
            cos_t = (1.0 - sin_t_squared).sqrt();
            let s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
            let p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
            reflectance = 0.5 * (s * s + p * p);
        }
        let reflected = rng.random::<f64>() < reflectance;
        for k in 0..3 {
            d[k] =
                if reflected { d[k] + 2.0 * cos_i * m[k] } else { eta * d[k] + (eta * cos_i - cos_t) * m[k] };
        }
        if !reflected {
            entered = true;
            if d[2] >= 0.0 {
                // On the far side but heading back: the same interface, from there.
                d[2] = -d[2];
                from_above = !from_above;
                continue;
            }
        } else if d[2] <= 0.0 {
            continue;
        }
        // Off to the next interface: which way?
        let upwards = reflected == from_above;
        if upwards && interface == 0 {
            if !entered {
                return Exit::Surface { hits };
            }
            let across = d[0].hypot(d[1]);
            return match geometry {
                Geometry::Plane => Exit::Interior { theta: d[0].atan2(d[2].abs()), phi: 0.0 },
                Geometry::Space => {
                    Exit::Interior { theta: across.atan2(d[2].abs()), phi: d[1].abs().atan2(d[0]) }
                }
            };
        }
        if !upwards && interface == transport.layers() {
            return Exit::Transmitted;
        }
        // Layer k lies between interfaces k and k + 1, counted from 0.
        let layer = if upwards { interface - 1 } else { interface };
        if rng.random::<f64>() > (-transport.optical_depths[layer] / d[2].abs()).exp() {
            return Exit::Absorbed;
        }
        interface = if upwards { interface - 1 } else { interface + 1 };
        from_above = !upwards;
        d[2] = -d[2].abs();
    }
}
