//! From linear radiance to PNG.

use std::path::Path;
use terminal::Stop;

/// A square picture of linear sRGB radiance, row by row from the top.
pub(super) struct Picture {
    pub(super) size: u32,
    pub(super) pixels: Vec<[f64; 3]>,
}

impl Picture {
    /// Writes an 8-bit sRGB PNG; the file appears whole or not at all.
    pub(super) fn write(&self, path: &Path) -> Result<(), Stop> {
        let failure = |error: &dyn std::fmt::Display| Stop::failure(format!("{}: {error}", path.display()));
        let bytes: Vec<u8> =
            self.pixels.iter().enumerate().flat_map(|(i, rgb)| encode(*rgb, self.dither(i))).collect();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.size, self.size);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        let mut writer = encoder.write_header().map_err(|error| failure(&error))?;
        writer.write_image_data(&bytes).map_err(|error| failure(&error))?;
        writer.finish().map_err(|error| failure(&error))?;
        lut_io::atomic::write(path, &file).map_err(|error| failure(&error))
    }

    /// Interleaved gradient noise in [−½, ½) (Jimenez 2014): smooth backgrounds show no bands.
    fn dither(&self, index: usize) -> f64 {
        let (x, y) = ((index as u32 % self.size) as f64, (index as u32 / self.size) as f64);
        (52.982_918_9 * (0.067_110_56 * x + 0.005_837_15 * y).fract()).fract() - 0.5
    }
}

/// Brightest sample that enters a mean: a rare direction must not leave a white dot.
pub(super) fn without_fireflies(radiance: [f64; 3]) -> [f64; 3] {
    const MOST: f64 = 20.0;
    let peak = radiance.iter().copied().fold(0.0, f64::max);
    if peak <= MOST { radiance } else { radiance.map(|c| c * MOST / peak) }
}

fn encode(radiance: [f64; 3], dither: f64) -> [u8; 3] {
    tone_map(radiance).map(|c| (255.0 * srgb(c) + 0.5 + dither).clamp(0.0, 255.0) as u8)
}

/// Khronos PBR Neutral: colours below 0.76 stay, highlights roll off towards white without turning hue
/// (Khronos Group 2024, specification of the neutral tone mapper; its black offset for dielectrics left out).
fn tone_map(rgb: [f64; 3]) -> [f64; 3] {
    const START: f64 = 0.76;
    const DESATURATION: f64 = 0.15;
    let peak = rgb.iter().copied().fold(0.0, f64::max);
    if peak < START {
        return rgb;
    }
    let room = 1.0 - START;
    let mapped = 1.0 - room * room / (peak + room - START);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - mapped) + 1.0);
    rgb.map(|c| (c * mapped / peak) * (1.0 - white) + mapped * white)
}

/// IEC 61966-2-1.
fn srgb(c: f64) -> f64 {
    if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tone_curve_is_continuous_and_never_passes_white() {
        let mut before = 0.0;
        for i in 0..4000 {
            let y = tone_map([0.01 * f64::from(i); 3])[0];
            assert!(y <= 1.0 && y >= before && y - before < 0.011, "{i}: {y}");
            before = y;
        }
    }
}
