//! The MERL database's `.binary`: an isotropic BRDF over half and difference angles (Matusik et al. 2003).
//!
//! Three i32 (90, 90, 180), then f64 `[channel][θh][θd][φd]`. θh = (π/2)·(i/90)², θd = (π/2)·j/90, φd = π·k/180, values
//! at the middle of each bin, divided by (1, 1.15, 1.66)/1500. The format knows φd only up to π: it assumes reciprocity.
//! Bins below the horizon are negative.

use crate::error::{FieldError, LutError, READING};
use std::f64::consts::{FRAC_PI_2, PI};
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

/// Bins of θh, θd and φd.
pub const BINS: [usize; 3] = [90, 90, 180];
/// What stored values of red, green and blue are multiplied by.
pub const SCALE: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];
/// Stored where one of the two directions is below the horizon.
const BELOW: f64 = -1.0;
/// Bytes before the values: the numbers of bins.
const HEADER: usize = 12;

/// A BRDF in the bins of the format.
#[derive(Clone, Debug, PartialEq)]
pub struct Merl {
    /// Numbers of bins of θh, θd and φd: [`BINS`] in every file of the database.
    extents: [usize; 3],
    /// Linear RGB in 1/sr without the cosine, `[θh][θd][φd]`; `None` below the horizon.
    bins: Vec<Option<[f64; 3]>>,
}

/// Unit vectors wi and wo in the local frame.
type Pair = [[f64; 3]; 2];

impl Merl {
    /// From a BRDF (1/sr, no cosine) evaluated at the middle of every bin; both directions are above the horizon.
    pub fn tabulate(brdf: impl Fn([f64; 3], [f64; 3]) -> [f64; 3]) -> Self {
        Self::tabulate_bins(BINS, brdf)
    }

    /// [`Merl::tabulate`] in other numbers of bins, which no other program reads: small enough for a test.
    pub fn tabulate_bins(extents: [usize; 3], brdf: impl Fn([f64; 3], [f64; 3]) -> [f64; 3]) -> Self {
        let [n_h, n_d, n_p] = extents;
        let bin = |place| {
            let [wi, wo] = middle(extents, place);
            (wi[2] > 0.0 && wo[2] > 0.0).then(|| brdf(wi, wo))
        };
        let places = (0..n_h).flat_map(|h| (0..n_d).flat_map(move |d| (0..n_p).map(move |p| [h, d, p])));
        Self { extents, bins: places.map(bin).collect() }
    }

    /// The BRDF of the bin that a pair of directions falls into, 1/sr.
    #[must_use]
    pub fn eval(&self, wi: [f64; 3], wo: [f64; 3]) -> Option<[f64; 3]> {
        if !(wi[2] > 0.0 && wo[2] > 0.0) {
            return None;
        }
        let [h, d, p] = bin_of(self.extents, wi, wo);
        self.bins[(h * self.extents[1] + d) * self.extents[2] + p]
    }

    /// The bytes of the file.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.extents.iter().flat_map(|n| (*n as i32).to_le_bytes()).collect();
        for (channel, scale) in SCALE.iter().enumerate() {
            let stored = self.bins.iter().map(|bin| bin.map_or(BELOW, |rgb| rgb[channel] / scale));
            bytes.extend(stored.flat_map(f64::to_le_bytes));
        }
        bytes
    }

    /// Reads a file. No more of it than one with a right header can have is looked at.
    ///
    /// # Errors
    /// As [`Merl::decode`], or the operating system refuses.
    pub fn read(path: &Path) -> Result<Self, LutError> {
        let io = |source| LutError::io(path, READING, source);
        let invalid = |error| LutError::invalid(path, error);
        let mut file = File::open(path).map_err(io)?;
        let mut bytes = Vec::new();
        (&mut file).take(HEADER as u64).read_to_end(&mut bytes).map_err(io)?;
        check_header(&bytes, BINS).map_err(invalid)?;
        // One byte more than it needs gives away a file that is too long.
        file.take(body_bytes(BINS) as u64 + 1).read_to_end(&mut bytes).map_err(io)?;
        Self::decode(&bytes).map_err(invalid)
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// Other bins, a wrong length, a number that is not finite.
    pub fn decode(bytes: &[u8]) -> Result<Self, FieldError> {
        Self::decode_bins(BINS, bytes)
    }

    /// [`Merl::decode`] for a file of [`Merl::tabulate_bins`].
    ///
    /// # Errors
    /// As [`Merl::decode`].
    pub fn decode_bins(extents: [usize; 3], bytes: &[u8]) -> Result<Self, FieldError> {
        let body = check_header(bytes, extents)?;
        let expected = body_bytes(extents);
        if body.len() != expected {
            let length = if body.len() > expected { "longer" } else { "cut short" };
            let problem = format!("is {length}: {} bytes follow the header, expected {expected}", body.len());
            return Err(FieldError::new("file", problem));
        }
        let numbers = body.as_chunks().0;
        let number = |at: usize| f64::from_le_bytes(numbers[at]);
        if let Some(at) = (0..numbers.len()).find(|at| !number(*at).is_finite()) {
            let problem = format!("is {}, expected a finite number", number(at));
            return Err(FieldError::new(format!("value {at}"), problem));
        }
        let count = numbers.len() / 3;
        let bin = |i: usize| {
            let rgb = [0, 1, 2].map(|c| number(c * count + i) * SCALE[c]);
            rgb.iter().all(|x| *x >= 0.0).then_some(rgb)
        };
        Ok(Self { extents, bins: (0..count).map(bin).collect() })
    }
}

/// Bytes of three channels of f64.
fn body_bytes(extents: [usize; 3]) -> usize {
    3 * 8 * extents.iter().product::<usize>()
}

/// What follows a header of these bins.
fn check_header(bytes: &[u8], extents: [usize; 3]) -> Result<&[u8], FieldError> {
    let (header, body) =
        bytes.split_first_chunk::<HEADER>().ok_or_else(|| FieldError::new("file", "is cut short"))?;
    let found: Vec<i32> = header.as_chunks().0.iter().map(|chunk| i32::from_le_bytes(*chunk)).collect();
    if found.iter().zip(extents).any(|(found, expected)| i64::from(*found) != expected as i64) {
        return Err(FieldError::new("bins", format!("are {found:?}, expected {extents:?}")));
    }
    Ok(body)
}

/// The directions in the middle of a bin.
fn middle(extents: [usize; 3], place: [usize; 3]) -> Pair {
    let [h, d, p]: [f64; 3] = std::array::from_fn(|k| (place[k] as f64 + 0.5) / extents[k] as f64);
    let (theta_h, theta_d, phi_d) = (FRAC_PI_2 * h.powi(2), FRAC_PI_2 * d, PI * p);
    // In the frame of the half vector, which leans towards +x.
    let ((sin_h, cos_h), (sin_d, cos_d), (sin_p, cos_p)) =
        (theta_h.sin_cos(), theta_d.sin_cos(), phi_d.sin_cos());
    let in_frame = |x: f64, y: f64, z: f64| [cos_h * x + sin_h * z, y, cos_h * z - sin_h * x];
    let (x, y) = (sin_d * cos_p, sin_d * sin_p);
    [in_frame(x, y, cos_d), in_frame(-x, -y, cos_d)]
}

fn bin_of(extents: [usize; 3], wi: [f64; 3], wo: [f64; 3]) -> [usize; 3] {
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
    let [n_h, n_d, n_p] = extents;
    [bin((theta_h / FRAC_PI_2).sqrt(), n_h), bin(theta_d / FRAC_PI_2, n_d), bin(phi_d / PI, n_p)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_every_bin_is_in_it_with_either_direction_first() {
        for place in [[0, 0, 0], [3, 80, 179], [45, 10, 90], [60, 2, 17], [89, 0, 100], [20, 44, 3]] {
            let [wi, wo] = middle(BINS, place);
            assert_eq!(bin_of(BINS, wi, wo), place);
            assert_eq!(bin_of(BINS, wo, wi), place);
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
        let [wi, wo] = middle(BINS, [10, 20, 30]);
        assert!((merl.eval(wi, wo).unwrap()[0] - wi[2]).abs() < 1e-15);
    }

    #[test]
    fn damaged_files_are_refused() {
        let bins = [3, 2, 4];
        let bytes = Merl::tabulate_bins(bins, |_, _| [0.5; 3]).encode();
        let refusal = |bytes: &[u8]| Merl::decode_bins(bins, bytes).unwrap_err().field;
        assert_eq!(refusal(&bytes[..bytes.len() - 1]), "file");
        assert_eq!(refusal(&bytes[..5]), "file");
        assert_eq!(refusal(&[bytes.as_slice(), &[0]].concat()), "file");
        let mut other = bytes.clone();
        other[0] = 91;
        assert_eq!(refusal(&other), "bins");
        other[..4].copy_from_slice(&i32::MIN.to_le_bytes());
        assert_eq!(refusal(&other), "bins");
        let mut nan = bytes;
        nan[12..20].copy_from_slice(&f64::NAN.to_le_bytes());
        assert_eq!(refusal(&nan), "value 0");
    }

    #[test]
    fn a_file_is_judged_by_its_header_before_the_rest_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pearl.binary");
        let merl = Merl::tabulate(|wi, wo| [wi[2], wo[2], 0.25]);
        std::fs::write(&path, merl.encode()).unwrap();
        assert_eq!(Merl::read(&path).unwrap().bins.len(), merl.bins.len());
        // A terabyte that is not there: as a whole it could not be read.
        let claim = |header: [i32; 3]| {
            std::fs::write(&path, header.map(i32::to_le_bytes).concat()).unwrap();
            File::options().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
            Merl::read(&path).unwrap_err().to_string()
        };
        assert!(claim([i32::MAX; 3]).contains("bins: are [2147483647, 2147483647, 2147483647], expected"));
        assert!(claim([90, 90, 180]).contains("file: is longer"));
        std::fs::write(&path, b"short").unwrap();
        assert!(Merl::read(&path).unwrap_err().to_string().contains("pearl.binary: file: is cut short"));
    }
}
