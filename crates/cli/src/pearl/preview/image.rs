//! From linear radiance to PNG.

use nacre_cli::preview::tone::tone_map;
use std::path::Path;
use terminal::{Outcome, Stop};

/// A square picture of linear sRGB radiance, row by row from the top.
pub(super) struct Picture {
    pub(super) size: u32,
    pub(super) pixels: Vec<[f64; 3]>,
}

impl Picture {
    /// Writes an 8-bit sRGB PNG; the file appears whole or not at all.
    pub(super) fn write(&self, path: &Path) -> Outcome {
        let failure = |error: &dyn std::fmt::Display| Stop::failure(format!("{}: {error}", path.display()));
        let bytes: Vec<u8> =
            self.pixels.iter().enumerate().flat_map(|(i, rgb)| encode(*rgb, self.dither(i))).collect();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.size, self.size);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        // Noise does not shrink for more work.
        encoder.set_compression(png::Compression::Fast);
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        let mut writer = encoder.write_header().map_err(|error| failure(&error))?;
        writer.write_image_data(&bytes).map_err(|error| failure(&error))?;
        writer.finish().map_err(|error| failure(&error))?;
        nacre_cli::write_file(path, &file)
    }

    /// Interleaved gradient noise in [−½, ½) (Jimenez 2014): smooth backgrounds show no bands.
    fn dither(&self, index: usize) -> f64 {
        let (x, y) = ((index as u32 % self.size) as f64, (index as u32 / self.size) as f64);
        (52.982_918_9 * (0.067_110_56 * x + 0.005_837_15 * y).fract()).fract() - 0.5
    }
}

fn encode(radiance: [f64; 3], dither: f64) -> [u8; 3] {
    tone_map(radiance).map(|c| (255.0 * srgb(c) + 0.5 + dither).clamp(0.0, 255.0) as u8)
}

/// IEC 61966-2-1.
fn srgb(c: f64) -> f64 {
    if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}
