//! How far an exported file is from the BSDF that it came from.

use crate::{Direction, PearlBsdf};
use rayon::prelude::*;
use thinfilm::colour;

/// Angles of incidence of the comparison, degrees: every 10°, on the nodes of a file and between them, and towards grazing.
pub const THETA_I_DEG: [f64; 15] =
    [0.0, 10.0, 20.0, 30.0, 40.0, 45.3, 50.0, 60.0, 64.7, 70.0, 80.0, 82.7, 85.5, 87.4, 88.5];
/// Exit directions an incidence.
const DIRECTIONS: u32 = 4096;

/// Error at one angle of incidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundTrip {
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// ∫|f_file − f| cos θo dω / ∫ f cos θo dω over all channels, per cent.
    pub error_percent: f64,
    /// ∫ (f_file − f) cos θo dω / ∫ f cos θo dω: the light that is too much, per cent.
    pub bias_percent: f64,
}

/// Compares f·cos θo of a file with that of the BSDF (both all channels, 1/sr) over exit directions that the BSDF samples:
/// a fixed sequence, so that the figure repeats.
pub fn measure(
    bsdf: &PearlBsdf,
    truth: impl Fn(Direction, Direction) -> Vec<f64> + Sync,
    file: impl Fn(Direction, Direction) -> Vec<f64> + Sync,
) -> Vec<RoundTrip> {
    THETA_I_DEG
        .par_iter()
        .map(|&theta_i_deg| {
            let theta = theta_i_deg.to_radians();
            // Some azimuth: an isotropic file must not care.
            let wi = [theta.sin() * 0.6, theta.sin() * 0.8, theta.cos()];
            let (mut apart, mut surplus, mut light) = (0.0, 0.0, 0.0);
            for n in 0..DIRECTIONS {
                let [u, v, w] = point(n);
                let Some(sample) = bsdf.sample(wi, u, v, w) else { continue };
                for (truth, file) in truth(wi, sample.wo).into_iter().zip(file(wi, sample.wo)) {
                    apart += (file - truth).abs() / sample.pdf;
                    surplus += (file - truth) / sample.pdf;
                    light += truth / sample.pdf;
                }
            }
            let percent = |x: f64| if light > 0.0 { 100.0 * x / light } else { 0.0 };
            RoundTrip { theta_i_deg, error_percent: percent(apart), bias_percent: percent(surplus) }
        })
        .collect()
}

/// Pixels across the sphere of a preview, and directions of light a pixel.
const SIZE: u32 = 24;
const LIGHTS: u32 = 512;

/// Colours of a small picture, of a file against those of the BSDF: ΔE00 with the brightest hundredth of its values at white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preview {
    /// Mean of the pixels.
    pub mean: f64,
    /// 95 of 100 pixels are no farther.
    pub most: f64,
}

/// A sphere under a sky with two lamps (those of tools/compare), of both, f·cos of the light in linear sRGB.
pub fn preview(
    bsdf: &PearlBsdf,
    truth: impl Fn(Direction, Direction) -> [f64; 3] + Sync,
    file: impl Fn(Direction, Direction) -> [f64; 3] + Sync,
) -> Preview {
    let pixel = |place: u32| {
        let [x, y] = [place % SIZE, place / SIZE].map(|i| (2.0 * f64::from(i) + 1.0) / f64::from(SIZE) - 1.0);
        let sin = x.hypot(y);
        let cos = (1.0 - sin * sin).max(0.0).sqrt();
        // The view is along z of the world, and in the plane of x and z of the surface.
        let (wi, [a, b]) = ([sin, 0.0, cos], if sin > 0.0 { [x / sin, y / sin] } else { [1.0, 0.0] });
        let mut seen = [[0.0; 3]; 2];
        for n in 0..if cos > 0.0 { LIGHTS } else { 0 } {
            let [u, v, w] = point(n);
            let Some(sample) = bsdf.sample(wi, u, v, w) else { continue };
            let [along, across, up] = sample.wo;
            // Away from the axis, and along it.
            let (out, z) = (up * sin - along * cos, up * cos + along * sin);
            let light = sky([out * a - across * b, out * b + across * a, z]) / sample.pdf;
            for (seen, rgb) in seen.iter_mut().zip([truth(wi, sample.wo), file(wi, sample.wo)]) {
                (0..3).for_each(|c| seen[c] += light * rgb[c] / f64::from(LIGHTS));
            }
        }
        (cos > 0.0).then_some(seen)
    };
    let pixels: Vec<[[f64; 3]; 2]> = (0..SIZE * SIZE).into_par_iter().filter_map(pixel).collect();
    let mut values: Vec<f64> = pixels.iter().flat_map(|[truth, _]| *truth).collect();
    let white = nearly_all(&mut values, 0.99).max(f64::MIN_POSITIVE);
    let lab = |rgb: [f64; 3]| colour::lab(colour::xyz_of_linear_srgb(rgb.map(|x| x / white)));
    let mut apart: Vec<f64> =
        pixels.iter().map(|[truth, file]| colour::delta_e_2000(lab(*truth), lab(*file))).collect();
    let mean = apart.iter().sum::<f64>() / apart.len().max(1) as f64;
    Preview { mean, most: nearly_all(&mut apart, 0.95) }
}

/// The value that this share is below.
fn nearly_all(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len() as f64) as usize;
    values.get(place.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

/// Radiance from a direction; the camera is at z.
fn sky(d: Direction) -> f64 {
    let lamp = |[x, y, z]: Direction, sharpness: f64| {
        let length = (x * x + y * y + z * z).sqrt();
        (sharpness * ((x * d[0] + y * d[1] + z * d[2]) / length - 1.0)).exp()
    };
    0.35 + 0.25 * d[1] + 5.0 * lamp([-1.0, 1.0, 1.0], 30.0) + 2.0 * lamp([1.5, 0.6, 0.5], 60.0)
}

/// Roberts' R₃ sequence: multiples of the inverse powers of the root of x⁴ = x + 1.
pub(crate) fn point(n: u32) -> [f64; 3] {
    const ROOT: f64 = 1.220_744_084_605_759_5;
    let step = [1.0 / ROOT, 1.0 / (ROOT * ROOT), 1.0 / (ROOT * ROOT * ROOT)];
    step.map(|step| (0.5 + step * f64::from(n)).fract())
}
