//! Metadata of compact forms: numbers rounded to what they are worth.

use crate::model::table::Meta;

/// Significant digits of standard errors.
const ERROR_DIGITS: usize = 2;
/// Significant digits of shares and moments.
const SHARE_DIGITS: usize = 7;

/// Metadata with what they say of each incidence rounded, and the interference colours to `band_digits` significant digits.
///
/// The ledger still closes: what is transmitted takes up the rounding.
pub(super) fn rounded(mut meta: Meta, band_digits: usize) -> Meta {
    let share = |x: f64| to_digits(x, SHARE_DIGITS);
    for s in &mut meta.per_incidence {
        for field in [&mut s.albedo, &mut s.absorbed, &mut s.truncated, &mut s.surface, &mut s.rehit] {
            *field = share(*field);
        }
        for field in [&mut s.mean_theta_o_deg, &mut s.sd_theta_o_deg, &mut s.skew_theta_o] {
            *field = to_digits(*field, SHARE_DIGITS);
        }
        s.azimuth_width_deg = share(s.azimuth_width_deg);
        s.surface = s.surface.min(s.albedo);
        s.rehit = s.rehit.min(s.surface);
        // Ten decimals: shorter than the difference's own digits, and far below the ledger's tolerance.
        let rest = 1.0 - s.albedo - s.absorbed - s.truncated;
        s.transmitted = ((rest * 1e13).round() / 1e13).max(0.0);
        let e = &mut s.std_error;
        for field in [
            &mut e.albedo,
            &mut e.transmitted,
            &mut e.absorbed,
            &mut e.truncated,
            &mut e.surface,
            &mut e.mean_theta_o_deg,
            &mut e.sd_theta_o_deg,
            &mut e.skew_theta_o,
            &mut s.accuracy_percent,
        ] {
            *field = to_digits(*field, ERROR_DIGITS);
        }
    }
    let Some(spectra) = &mut meta.spectra else { return meta };
    let band = |x: &mut f64| *x = to_digits(*x, band_digits);
    // Colours in RGB are few, and what most pictures are made of.
    let rgb = |x: &mut f64| *x = to_digits(*x, band_digits + 1);
    if let Some(coherent) = &mut spectra.coherent {
        coherent.modulation.iter_mut().flatten().for_each(band);
        coherent.modulation_rgb.iter_mut().flatten().for_each(rgb);
        coherent.incoherent.iter_mut().for_each(rgb);
    }
    if let Some(emission) = &mut spectra.emission {
        emission.radiance.iter_mut().flatten().for_each(band);
        emission.radiance_rgb.iter_mut().flatten().for_each(rgb);
    }
    if let Some(thickness) = &mut spectra.thickness {
        let scales = thickness.modulation_rgb.iter_mut().chain(&mut thickness.radiance_rgb);
        scales.flatten().flatten().for_each(rgb);
        thickness.radiance_mean.iter_mut().flatten().for_each(rgb);
    }
    *spectra = spectra.rounded();
    meta
}

/// The number with so many significant decimal digits.
fn to_digits(x: f64, digits: usize) -> f64 {
    format!("{x:.*e}", digits.saturating_sub(1)).parse().unwrap_or(x)
}
