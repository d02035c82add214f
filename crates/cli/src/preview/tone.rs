//! From linear radiance to displayed colour, and how far two displayed pictures are apart.

use lut_io::compact::DeltaE;
use thinfilm::colour;

/// Brightest ray that enters a pixel: a rare direction must not leave a white dot.
pub(super) fn without_fireflies(radiance: [f64; 3]) -> [f64; 3] {
    const MOST: f64 = 20.0;
    let peak = radiance.iter().copied().fold(0.0, f64::max);
    if peak <= MOST { radiance } else { radiance.map(|c| c * MOST / peak) }
}

/// Khronos PBR Neutral: colours below 0.76 stay, highlights roll off towards white without turning hue
/// (Khronos Group 2024, specification of the neutral tone mapper; its black offset for dielectrics left out).
#[must_use]
pub fn tone_map(rgb: [f64; 3]) -> [f64; 3] {
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

/// ΔE00 between two pictures of linear sRGB radiance as they are displayed, over the pixels that `counted` names.
#[must_use]
pub fn delta_e(a: &[[f64; 3]], b: &[[f64; 3]], counted: &[bool]) -> Vec<f64> {
    let lab = |radiance: [f64; 3]| colour::lab(xyz(tone_map(radiance)));
    let pixels = a.iter().zip(b).zip(counted).filter(|(_, counted)| **counted);
    pixels.map(|((a, b), _)| colour::delta_e_2000(lab(*a), lab(*b))).collect()
}

/// Mean, 99th percentile and largest of some colour differences; `None` of none.
#[must_use]
pub fn summary(mut differences: Vec<f64>) -> Option<DeltaE> {
    differences.sort_by(f64::total_cmp);
    let largest = *differences.last()?;
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    let percentile_99 = differences[(differences.len() - 1) * 99 / 100];
    Some(DeltaE { mean, percentile_99, largest })
}

/// XYZ of linear sRGB (IEC 61966-2-1), Y = 1 for white.
fn xyz([r, g, b]: [f64; 3]) -> [f64; 3] {
    [
        0.412_390_8 * r + 0.357_584_3 * g + 0.180_480_8 * b,
        0.212_639 * r + 0.715_168_7 * g + 0.072_192_3 * b,
        0.019_330_8 * r + 0.119_194_8 * g + 0.950_532_2 * b,
    ]
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

    #[test]
    fn a_just_noticeable_difference_is_about_one() {
        // Mid grey, one step in L*: Y = 0.1842 is L* = 50, 0.1926 is L* = 51; ΔE00 at L* near 50 is ΔL*.
        let found = delta_e(&[[0.184_2; 3]; 2], &[[0.192_6; 3], [0.5; 3]], &[true, false]);
        assert_eq!(found.len(), 1);
        assert!((found[0] - 1.0).abs() < 0.02, "{found:?}");
        let all = summary(vec![0.1, 0.3, 0.2]).unwrap();
        assert!((all.mean - 0.2).abs() < 1e-12 && all.largest == 0.3);
        assert_eq!(summary(Vec::new()), None);
    }
}
