//! What one writes first, and the closed forms that show what it costs.

use lut_io::lobe::{Interpolant, Row};
use lut_io::table::Component;
use rand::SeedableRng as _;
use rand::rngs::SmallRng;
use std::f64::consts::PI;
use transport::walk::Fate;
use transport::walk::reference::{Estimator, Reference};
use transport::{Geometry, Transport};

/// Closed form for σ = 0: albedo, transmitted and absorbed share by the star product of intensities, from the last
/// interface up. Unpolarised at each interface, as the model has it.
pub(crate) fn star(transport: &Transport, theta_i: f64) -> [f64; 3] {
    let n = &transport.indices;
    let transverse = n[0] * theta_i.sin();
    // cos θ in medium m; `None` past total reflection.
    let cosine = |m: usize| {
        if m == 0 {
            return Some(theta_i.cos());
        }
        let square = 1.0 - (transverse / n[m]).powi(2);
        (square > 0.0).then(|| square.sqrt())
    };
    let interface = |i: usize| match (cosine(i), cosine(i + 1)) {
        (Some(a), Some(b)) => fresnel(n[i], n[i + 1], a, b),
        _ => 1.0,
    };
    let last = transport.layers();
    let mut reflected = interface(last);
    let mut transmitted = 1.0 - reflected;
    for i in (0..last).rev() {
        let pass = cosine(i + 1).map_or(0.0, |cos| (-transport.optical_depths[i] / cos).exp());
        let r = interface(i);
        let below = pass * pass * reflected;
        let entered = (1.0 - r) / (1.0 - r * below);
        transmitted *= if r < 1.0 { entered * pass } else { 0.0 };
        reflected = if r < 1.0 { r + (1.0 - r) * entered * below } else { 1.0 };
    }
    [reflected, transmitted, absorbed(transport, theta_i).unwrap_or(1.0 - reflected - transmitted)]
}

/// The absorbed share of a single layer, without cancellation.
fn absorbed(transport: &Transport, theta_i: f64) -> Option<f64> {
    let [depth] = transport.optical_depths[..] else { return None };
    let n = &transport.indices;
    let cosine = |m: usize| (1.0 - (n[0] * theta_i.sin() / n[m]).powi(2)).sqrt();
    let [a, b, c] = [0, 1, 2].map(cosine);
    let (first, last) = (fresnel(n[0], n[1], a, b), fresnel(n[1], n[2], b, c));
    let (pass, lost) = ((-depth / b).exp(), -(-depth / b).exp_m1());
    // Once down and, where reflected, once up, as often as the light goes round.
    Some((1.0 - first) * lost * (1.0 + pass * last) / (1.0 - first * last * pass * pass))
}

fn fresnel(n1: f64, n2: f64, cos1: f64, cos2: f64) -> f64 {
    let s = (n1 * cos1 - n2 * cos2) / (n1 * cos1 + n2 * cos2);
    let p = (n2 * cos1 - n1 * cos2) / (n2 * cos1 + n1 * cos2);
    0.5 * (s * s + p * p)
}

/// The same in 32 bits, with angles: sin(a − b)/sin(a + b) and tan(a − b)/tan(a + b).
pub(crate) fn star_by_angles_in_f32(transport: &Transport, theta_i: f64) -> f64 {
    let n: Vec<f32> = transport.indices.iter().map(|n| *n as f32).collect();
    // A renderer has directions, not angles.
    let theta_i = f64::from((theta_i.cos() as f32).acos());
    let angle = |m: usize| (n[0] * (theta_i as f32).sin() / n[m]).asin();
    let reflectance = |i: usize| {
        let (a, b) = (angle(i), angle(i + 1));
        let (s, p) = ((a - b).sin() / (a + b).sin(), (a - b).tan() / (a + b).tan());
        0.5 * (s * s + p * p)
    };
    let last = transport.layers();
    let mut reflected = reflectance(last);
    for i in (0..last).rev() {
        let r = reflectance(i);
        reflected = r + (1.0 - r) * (1.0 - r) * reflected / (1.0 - r * reflected);
    }
    f64::from(reflected)
}

/// Every interface's reflectance, as if light came back from each but once.
pub(crate) fn each_interface_once(transport: &Transport, theta_i: f64) -> f64 {
    let n = &transport.indices;
    let cosine = |m: usize| (1.0 - (n[0] * theta_i.sin() / n[m]).powi(2)).max(0.0).sqrt();
    (0..=transport.layers()).map(|i| fresnel(n[i], n[i + 1], cosine(i), cosine(i + 1))).sum()
}

fn mean_reflected(reference: &Reference<'_>, theta_i: f64) -> f64 {
    let mut random = SmallRng::seed_from_u64(1);
    let paths = 4000;
    let reflected = |_| {
        let end = reference.path(theta_i, &mut random);
        if matches!(end.fate, Fate::Single | Fate::Rehit | Fate::Interior) { end.weight } else { 0.0 }
    };
    (0..paths).map(reflected).sum::<f64>() / f64::from(paths)
}

/// The paper's rules read literally: choose by R and multiply by R.
pub(crate) fn literal_walk(transport: &Transport, theta_i: f64) -> f64 {
    let reference =
        Reference { estimator: Estimator::PaperLiteral, ..Reference::new(transport, Geometry::Plane) };
    mean_reflected(&reference, theta_i)
}

/// Energy that a walk accounts for if it drops paths longer than `cap` events.
pub(crate) fn walk_that_forgets_long_paths(transport: &Transport, theta_i: f64, cap: u32) -> f64 {
    let reference = Reference { event_cap: cap, ..Reference::new(transport, Geometry::Plane) };
    let mut random = SmallRng::seed_from_u64(1);
    let paths = 4000;
    let kept = (0..paths).filter(|_| reference.path(theta_i, &mut random).fate != Fate::Truncated);
    kept.count() as f64 / f64::from(paths)
}

/// A sum of equal 32-bit terms, one after the other, as long as it moves.
pub(crate) fn f32_sum(term: f32, count: u64) -> f64 {
    let mut sum = 0.0_f32;
    for _ in 0..count {
        let next = sum + term;
        if next == sum {
            break;
        }
        sum = next;
    }
    f64::from(sum)
}

/// A number kept in 16 bits (11 of precision).
pub(crate) fn half(value: f32) -> f64 {
    f64::from(f32::from_bits((value.to_bits() + 0x1000) & !0x1fff))
}

/// f·cos θo of the interior in the plane of incidence at a signed exit angle.
pub(crate) fn in_plane(row: &Row<'_>, s: f64) -> f64 {
    row.eval(Component::Interior, s.abs(), if s < 0.0 { PI } else { 0.0 })
}

/// The integral over the hemisphere of two neighbouring rows mixed at equal θo and φ.
pub(crate) fn integral_of_rows_mixed_at_equal_angle(lobe: &Interpolant, theta_i_deg: f64) -> f64 {
    let low = (theta_i_deg / 5.0).floor().min(17.0);
    let t = theta_i_deg / 5.0 - low;
    let [near, far] = [low, low + 1.0].map(|node| lobe.row((5.0 * node).to_radians()));
    let (rows, columns) = (90, 360);
    let mut integral = 0.0;
    for i in 0..rows {
        // A 1° grid of θo and φ, each cell's centre for all of it.
        let theta_o = (f64::from(i) + 0.5).to_radians();
        for j in 0..columns {
            let phi = (f64::from(j) + 0.5).to_radians();
            let value = |row: &Row<'_>| row.eval(Component::Interior, theta_o, phi);
            integral += ((1.0 - t) * value(&near) + t * value(&far)) * theta_o.sin();
        }
    }
    integral * 1_f64.to_radians().powi(2)
}

/// cos φ as one derives it from the cosine rule, with angles from acos.
pub(crate) fn cosine_of_azimuth(wi: [f64; 3], wo: [f64; 3]) -> f64 {
    let dot: f64 = wi.iter().zip(wo).map(|(a, b)| a * b).sum();
    let (theta_i, theta_o) = (wi[2].acos(), wo[2].acos());
    (dot - theta_i.cos() * theta_o.cos()) / (theta_i.sin() * theta_o.sin()) / wi[2]
}

/// Length of a facet normal from Box–Muller slopes, divided by itself.
pub(crate) fn box_muller_length(u1: f64, u2: f64) -> f64 {
    let radius = (-2.0 * u1.ln()).sqrt();
    let normal = [radius * (2.0 * PI * u2).cos(), radius * (2.0 * PI * u2).sin(), 1.0];
    let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
    normal.map(|v| v / length).iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// A stack of so many layers as whole pairs hold, as one doubles.
pub(crate) fn whole_pairs(transport: &Transport, theta_i: f64) -> f64 {
    let layers = transport.layers().next_multiple_of(2);
    let (odd, even) = (transport.indices[1], 1.43);
    let substrate = transport.indices[transport.layers() + 1];
    star(&Transport::alternating(layers, odd, even, substrate, 0.0), theta_i)[0]
}

/// Standard deviation (radians) of a mirror lobe of 2σ on a grid of half degrees, each ray shared by its two nodes.
pub(crate) fn lobe_on_a_grid(sigma: f64, theta_i: f64) -> f64 {
    let step = 0.5_f64.to_radians();
    let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
    for k in -30..=30 {
        let slope = f64::from(k) / 5.0;
        let weight = (-0.5 * slope * slope).exp();
        // Between two nodes, as most angles are.
        let place = (theta_i + 2.0 * sigma * slope) / step + 0.37;
        for (node, share) in [(place.floor(), 1.0 - place.fract()), (place.floor() + 1.0, place.fract())] {
            let x = (node - place.floor()) * step;
            sum += weight * share;
            first += weight * share * x;
            second += weight * share * x * x;
        }
    }
    (second / sum - (first / sum).powi(2)).sqrt()
}

/// Skewness from sums of powers in 32 bits, term by term.
pub(crate) fn skewness_in_f32(angles: &[f64]) -> f64 {
    let mut sums = [0.0_f32; 3];
    for angle in angles {
        let degrees = angle.to_degrees() as f32;
        for (sum, power) in sums.iter_mut().zip([degrees, degrees * degrees, degrees * degrees * degrees]) {
            *sum += power;
        }
    }
    let [mean, second, third] = sums.map(|sum| sum / angles.len() as f32);
    let variance = second - mean * mean;
    f64::from((third - 3.0 * mean * second + 2.0 * mean * mean * mean) / variance.powf(1.5))
}

/// θ by acos in 32 bits.
pub(crate) fn angle_in_f32(w: [f64; 3]) -> f64 {
    f64::from((w[2] as f32).acos())
}

/// A number kept in 16 bits.
pub(crate) fn half_float(value: f64) -> f64 {
    half(value as f32)
}
