//! The MERL database's `.binary`: an isotropic BRDF over half and difference angles (Matusik et al. 2003).
//!
//! Three i32 (90, 90, 180), then f64 `[channel][θh][θd][φd]`. θh = (π/2)·(i/90)², θd = (π/2)·j/90, φd = π·k/180, values
//! at the middle of each bin, divided by (1, 1.15, 1.66)/1500. The format knows φd only up to π: it assumes reciprocity.
//! Bins below the horizon are negative.

use crate::error::Flaw;
use std::f64::consts::{FRAC_PI_2, PI};

/// Bins of θh, θd and φd.
pub const BINS: [usize; 3] = [90, 90, 180];
/// What stored values of red, green and blue are multiplied by.
pub const SCALE: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];
/// Stored where one of the two directions is below the horizon.
const BELOW: f64 = -1.0;

/// A BRDF in the bins of the format.
#[derive(Clone, Debug, PartialEq)]
pub struct Merl {
    /// Linear RGB in 1/sr without the cosine, `[θh][θd][φd]`; `None` below the horizon.
    bins: Vec<Option<[f64; 3]>>,
}

/// Unit vectors wi and wo in the local frame.
type Pair = [[f64; 3]; 2];

impl Merl {
    /// From a BRDF (1/sr, no cosine) evaluated at the middle of every bin; both directions are above the horizon.
    pub fn tabulate(brdf: impl Fn([f64; 3], [f64; 3]) -> [f64; 3]) -> Self {
        let [n_h, n_d, n_p] = BINS;
        let bin = |h: usize, d: usize, p: usize| {
            let [wi, wo] = middle(h, d, p);
            (wi[2] > 0.0 && wo[2] > 0.0).then(|| brdf(wi, wo))
        };
        let bins = (0..n_h).flat_map(|h| (0..n_d).flat_map(move |d| (0..n_p).map(move |p| (h, d, p))));
        Self { bins: bins.map(|(h, d, p)| bin(h, d, p)).collect() }
    }

    /// The BRDF of the bin that a pair of directions falls into, 1/sr.
    #[must_use]
    pub fn eval(&self, wi: [f64; 3], wo: [f64; 3]) -> Option<[f64; 3]> {
        if !(wi[2] > 0.0 && wo[2] > 0.0) {
            return None;
        }
        let [h, d, p] = bin_of(wi, wo);
        self.bins[(h * BINS[1] + d) * BINS[2] + p]
    }

    /// The bytes of the file.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = BINS.iter().flat_map(|n| (*n as i32).to_le_bytes()).collect();
        for (channel, scale) in SCALE.iter().enumerate() {
            let stored = self.bins.iter().map(|bin| bin.map_or(BELOW, |rgb| rgb[channel] / scale));
            bytes.extend(stored.flat_map(f64::to_le_bytes));
        }
        bytes
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// Other bins, a wrong length, a number that is not finite.
    pub fn decode(bytes: &[u8]) -> Result<Self, Flaw> {
        let (header, body) =
            bytes.split_first_chunk::<12>().ok_or_else(|| Flaw::new("file", "is cut short"))?;
        let found: Vec<i32> = header.as_chunks().0.iter().map(|chunk| i32::from_le_bytes(*chunk)).collect();
        if !found.iter().zip(BINS).all(|(found, expected)| i64::from(*found) == expected as i64) {
            return Err(Flaw::new("bins", format!("are {found:?}, expected {BINS:?}")));
        }
        let count: usize = BINS.iter().product();
        if body.len() != 3 * 8 * count {
            let problem = format!("is {} bytes long, expected {}", bytes.len(), 12 + 24 * count);
            return Err(Flaw::new("file", problem));
        }
        let numbers: Vec<f64> = body.as_chunks().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
        if let Some(at) = numbers.iter().position(|x| !x.is_finite()) {
            return Err(Flaw::new(
                format!("value {at}"),
                format!("is {}, expected a finite number", numbers[at]),
            ));
        }
        let bin = |i: usize| {
            let rgb = [0, 1, 2].map(|c| numbers[c * count + i] * SCALE[c]);
            rgb.iter().all(|x| *x >= 0.0).then_some(rgb)
        };
        Ok(Self { bins: (0..count).map(bin).collect() })
    }
}

/// The directions in the middle of a bin.
fn middle(h: usize, d: usize, p: usize) -> Pair {
    let theta_h = FRAC_PI_2 * ((h as f64 + 0.5) / BINS[0] as f64).powi(2);
    let theta_d = FRAC_PI_2 * (d as f64 + 0.5) / BINS[1] as f64;
    let phi_d = PI * (p as f64 + 0.5) / BINS[2] as f64;
    // In the frame of the half vector, which leans towards +x.
    let ((sin_h, cos_h), (sin_d, cos_d), (sin_p, cos_p)) =
        (theta_h.sin_cos(), theta_d.sin_cos(), phi_d.sin_cos());
    let in_frame = |x: f64, y: f64, z: f64| [cos_h * x + sin_h * z, y, cos_h * z - sin_h * x];
    let (x, y) = (sin_d * cos_p, sin_d * sin_p);
    [in_frame(x, y, cos_d), in_frame(-x, -y, cos_d)]
}

fn bin_of(wi: [f64; 3], wo: [f64; 3]) -> [usize; 3] {
    let sum: [f64; 3] = std::array::from_fn(|i| wi[i] + wo[i]);
    let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
    let half = sum.map(|x| x / length);
    let theta_h = half[2].min(1.0).acos();
    let cos_d: f64 = half.iter().zip(wi).map(|(h, w)| h * w).sum();
    let theta_d = cos_d.min(1.0).acos();
    // Azimuth of wi about the half vector, from the plane of half vector and normal.
    let sin_h = (half[0] * half[0] + half[1] * half[1]).sqrt();
    let (along, across) = if sin_h > 1e-12 { (half[0] / sin_h, half[1] / sin_h) } else { (1.0, 0.0) };
    let x = half[2] * (along * wi[0] + across * wi[1]) - sin_h * wi[2];
    let y = along * wi[1] - across * wi[0];
    let phi_d = y.atan2(x).rem_euclid(PI);
    let bin = |position: f64, count: usize| ((position * count as f64) as usize).min(count - 1);
    [bin((theta_h / FRAC_PI_2).sqrt(), BINS[0]), bin(theta_d / FRAC_PI_2, BINS[1]), bin(phi_d / PI, BINS[2])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_every_bin_is_in_it_with_either_direction_first() {
        for (h, d, p) in [(0, 0, 0), (3, 80, 179), (45, 10, 90), (60, 2, 17), (89, 0, 100), (20, 44, 3)] {
            let [wi, wo] = middle(h, d, p);
            assert_eq!(bin_of(wi, wo), [h, d, p]);
            assert_eq!(bin_of(wo, wi), [h, d, p]);
        }
    }

    #[test]
    fn a_file_comes_back_as_it_was_written() {
        let merl = Merl::tabulate(|wi, wo| [wi[2], wo[2], 0.25 + wi[0] * wo[0]].map(|x| x.max(0.0)));
        let back = Merl::decode(&merl.encode()).unwrap();
        for (a, b) in merl.bins.iter().zip(&back.bins) {
            match (a, b) {
                (Some(a), Some(b)) => assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-15 * a)),
                (a, b) => assert_eq!(a, b),
            }
        }
        let [wi, wo] = middle(10, 20, 30);
        assert!((merl.eval(wi, wo).unwrap()[0] - wi[2]).abs() < 1e-15);
    }

    #[test]
    fn damaged_files_are_refused() {
        let bytes = Merl::tabulate(|_, _| [0.5; 3]).encode();
        assert!(Merl::decode(&bytes[..bytes.len() - 1]).is_err());
        assert!(Merl::decode(&bytes[..5]).is_err());
        let mut other = bytes.clone();
        other[0] = 91;
        assert_eq!(Merl::decode(&other).unwrap_err().field, "bins");
        let mut nan = bytes;
        nan[12..20].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(Merl::decode(&nan).is_err());
    }
}
