//! Tabular BSDF of Zemax OpticStudio, the BSDF Data Interchange format of Radiant Imaging.
//!
//! By Zemax's article "Zemax Tabular BSDF data file format" (support.zemax.com, 1500005486801) and the reader in libbsdf (Kimura,
//! `ZemaxBsdfReader.cpp`): text with a header of keywords, and for each of X, Y and Z, at every incidence, the total integrated
//! scatter (TIS) and a line of the BRDF for each azimuth. Scattered directions are given from the mirror direction:
//! `ScatterRadial` is the angle from it, `ScatterAzimuth` 0 points from it towards the normal.

use super::goniometer::{direction, place, steps};
use crate::{Direction, PearlBsdf};
use rayon::prelude::*;
use std::fmt::Write as _;
use thinfilm::colour::{linear_srgb, xyz_of_linear_srgb};

/// Angles, degrees: from, to (not included) and step.
const INCIDENCE_DEG: [[f64; 3]; 3] = [[0.0, 60.0, 5.0], [60.0, 75.0, 2.5], [75.0, 90.0, 1.0]];
const RADIAL_DEG: [[f64; 3]; 5] =
    [[0.0, 2.0, 0.25], [2.0, 8.0, 0.5], [8.0, 30.0, 1.0], [30.0, 60.0, 2.0], [60.0, 185.0, 5.0]];
const AZIMUTH_DEG: [[f64; 3]; 1] = [[0.0, 185.0, 7.5]];

/// A scattered BRDF about the mirror direction.
#[derive(Clone, Debug)]
pub(super) struct Scatter {
    incidence: Vec<f64>,
    azimuth: Vec<f64>,
    radial: Vec<f64>,
    /// Albedo by incidence, and f in 1/sr by incidence, azimuth and radius, XYZ.
    albedo: Vec<[f64; 3]>,
    values: Vec<[f64; 3]>,
}

impl Scatter {
    pub(super) fn new(bsdf: &PearlBsdf) -> Self {
        let [incidence, azimuth, radial] = [steps(&INCIDENCE_DEG), steps(&AZIMUTH_DEG), steps(&RADIAL_DEG)];
        let at = |theta: &f64| -> Vec<[f64; 3]> {
            let wi = direction(*theta, 180.0);
            let pairs =
                azimuth.iter().flat_map(|azimuth| radial.iter().map(move |radial| (*azimuth, *radial)));
            pairs
                .map(|(azimuth, radial)| {
                    let wo = turned(direction(radial, azimuth), *theta);
                    // Nothing is scattered below the horizon.
                    if wo[2] > 1e-4 {
                        xyz_of_linear_srgb(bsdf.eval(wi, wo).rgb().map(|x| x / wo[2]))
                    } else {
                        [0.0; 3]
                    }
                })
                .collect()
        };
        let values: Vec<[f64; 3]> = incidence.par_iter().flat_map_iter(at).collect();
        let albedo = |theta: &f64| {
            let parts = bsdf.directional_albedo(theta.to_radians());
            xyz_of_linear_srgb(std::array::from_fn(|c| parts.iter().map(|rgb| rgb[c]).sum()))
        };
        let albedo = incidence.par_iter().map(albedo).collect();
        Self { incidence, azimuth, radial, albedo, values }
    }

    /// f·cos θo, linear sRGB, read linearly in the incidence and in both angles from the mirror direction.
    pub(super) fn eval(&self, wi: Direction, wo: Direction) -> [f64; 3] {
        let theta = wi[2].clamp(-1.0, 1.0).acos().to_degrees();
        let across = wi[0].hypot(wi[1]);
        let [x, y] = if across > 0.0 { [-wi[0] / across, -wi[1] / across] } else { [1.0, 0.0] };
        // The mirror direction as the pole: the same turn leads there and back.
        let seen = turned([wo[0] * x + wo[1] * y, wo[1] * x - wo[0] * y, wo[2]], theta);
        let radial = seen[2].clamp(-1.0, 1.0).acos().to_degrees();
        let azimuth = seen[1].abs().atan2(seen[0]).to_degrees();
        let places =
            [place(&self.incidence, theta), place(&self.azimuth, azimuth), place(&self.radial, radial)];
        let mut sum = [0.0; 3];
        for corner in 0..8 {
            let [i, a, r] = [0, 1, 2].map(|axis| {
                let (node, share) = places[axis];
                if corner >> axis & 1 == 1 { (node + 1, share) } else { (node, 1.0 - share) }
            });
            let value = self.values[(i.0 * self.azimuth.len() + a.0) * self.radial.len() + r.0];
            (0..3).for_each(|c| sum[c] += i.1 * a.1 * r.1 * value[c]);
        }
        linear_srgb(sum).map(|f| f * wo[2])
    }

    /// The file.
    pub(super) fn encode(&self, name: &str) -> Vec<u8> {
        let name: String = name.chars().filter(|c| !c.is_control()).collect();
        let mut text = format!(
            "# {name}, by nacre\nSource  Measured\nSymmetry  PlaneSymmetrical\nSpectralContent  XYZ\nScatterType  BRDF\n\
             SampleRotation  1\n0\n"
        );
        let axes = [
            ("AngleOfIncidence", &self.incidence),
            ("ScatterAzimuth", &self.azimuth),
            ("ScatterRadial", &self.radial),
        ];
        for (axis, angles) in axes {
            let listed: Vec<String> = angles.iter().map(f64::to_string).collect();
            text.push_str(&format!("{axis}  {}\n{}\n", angles.len(), listed.join("\t")));
        }
        text.push('\n');
        for (c, channel) in ["X", "Y", "Z"].into_iter().enumerate() {
            text.push_str(&format!("Tristimulus{channel}\nDataBegin\n"));
            let blocks = self.values.chunks(self.azimuth.len() * self.radial.len());
            for (block, albedo) in blocks.zip(&self.albedo) {
                text.push_str(&format!("TIS {:.6}\n", albedo[c]));
                for line in block.chunks(self.radial.len()) {
                    for value in line {
                        // Writing to a string does not fail.
                        let _ = write!(text, "{:.4e}\t", value[c]);
                    }
                    text.push('\n');
                }
            }
            text.push_str("DataEnd\n");
        }
        text.into_bytes()
    }
}

/// A direction about the mirror direction at an incidence, in the frame of the surface, where the mirror direction has x > 0:
/// azimuth 0 is towards the normal.
fn turned(d: Direction, theta: f64) -> Direction {
    let (sin, cos) = theta.to_radians().sin_cos();
    let towards = -d[0];
    [towards * cos + d[2] * sin, d[1], d[2] * cos - towards * sin]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuth_0_is_towards_the_normal_and_the_turn_leads_back() {
        let down = turned(direction(10.0, 0.0), 30.0);
        assert!((down[0] - 20f64.to_radians().sin()).abs() < 1e-12 && down[1] == 0.0, "{down:?}");
        let d = direction(25.0, 70.0);
        let back = turned(turned(d, 40.0), 40.0);
        assert!((0..3).all(|k| (back[k] - d[k]).abs() < 1e-12), "{back:?}");
    }
}
