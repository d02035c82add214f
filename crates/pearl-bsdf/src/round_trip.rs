//! How far an exported file is from the BSDF that it came from.

use crate::{Direction, PearlBsdf};
use rayon::prelude::*;

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

/// Roberts' R₃ sequence: multiples of the inverse powers of the root of x⁴ = x + 1.
pub(crate) fn point(n: u32) -> [f64; 3] {
    const ROOT: f64 = 1.220_744_084_605_759_5;
    let step = [1.0 / ROOT, 1.0 / (ROOT * ROOT), 1.0 / (ROOT * ROOT * ROOT)];
    step.map(|step| (0.5 + step * f64::from(n)).fract())
}
