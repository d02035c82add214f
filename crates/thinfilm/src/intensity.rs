//! Adding intensities instead of amplitudes: what a stack reflects when its interfaces (or sheets) are mutually
//! incoherent. This is what the facet walk tends to for facets without tilt.
//!
//! Every quantity is a sum of positive terms: 1 − R′R is formed as (T + A)′ + R′(T + A), so nothing cancels and T is
//! right down to the end of f64.

use crate::stack::{Stack, StackError};
use crate::wave::{InPlaneWave, Incidence, Layer, Multilayer, Polarisation, Run, WaveError};
use num_complex::Complex64;

/// Light as the intensities see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// One polarisation all the way.
    Polarised(Polarisation),
    /// Unpolarised at every interface anew: the mean of s and p is taken interface by interface, as in a walk whose facets
    /// turn the plane of incidence.
    Unpolarised,
}

/// Shares of power that a slab or an interface reflects, transmits and absorbs; `_back` for light from below.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intensity {
    /// Reflectance from above.
    pub reflectance: f64,
    /// Reflectance from below.
    pub reflectance_back: f64,
    /// Transmittance, the same both ways.
    pub transmittance: f64,
    /// Absorptance from above.
    pub absorptance: f64,
    /// Absorptance from below.
    pub absorptance_back: f64,
}

impl Intensity {
    /// Nothing there.
    pub const CLEAR: Self = Self {
        reflectance: 0.0,
        reflectance_back: 0.0,
        transmittance: 1.0,
        absorptance: 0.0,
        absorptance_back: 0.0,
    };

    /// A layer crossed without interference, of absorptance 1 − e^(−x).
    #[must_use]
    pub fn crossing(optical_depth: f64) -> Self {
        let absorptance = -(-optical_depth).exp_m1();
        Self {
            transmittance: (-optical_depth).exp(),
            absorptance,
            absorptance_back: absorptance,
            ..Self::CLEAR
        }
    }

    /// An interface between two media of real admittance, unit weight to s and p or one of them.
    fn lossless(reflectance: f64, transmittance: f64) -> Self {
        Self { reflectance, reflectance_back: reflectance, transmittance, ..Self::CLEAR }
    }

    /// `self` above `below`: all orders of multiple reflection.
    #[must_use]
    pub fn star(&self, below: &Self) -> Self {
        let lost_back = self.transmittance + self.absorptance_back;
        let lost_below = below.transmittance + below.absorptance;
        let inner = lost_back + self.reflectance_back * lost_below;
        if inner <= 0.0 {
            // Two perfect mirrors face each other: no light comes in between them.
            return Self { transmittance: 0.0, reflectance_back: below.reflectance_back, ..*self };
        }
        let (t_1, t_2) = (self.transmittance, below.transmittance);
        Self {
            reflectance: self.reflectance + t_1 * t_1 * below.reflectance / inner,
            reflectance_back: below.reflectance_back + t_2 * t_2 * self.reflectance_back / inner,
            transmittance: t_1 * t_2 / inner,
            absorptance: self.absorptance
                + t_1 * (below.absorptance + below.reflectance * self.absorptance_back) / inner,
            absorptance_back: below.absorptance_back
                + t_2 * (self.absorptance_back + self.reflectance_back * below.absorptance) / inner,
        }
    }
}

/// Fresnel reflectance and transmittance of one interface; total reflection gives (1, 0).
///
/// # Errors
/// Angle or index out of range.
pub fn fresnel(
    upper: Complex64,
    lower: Complex64,
    theta: f64,
    light: Light,
) -> Result<(f64, f64), WaveError> {
    let stack = Multilayer { ambient: upper, runs: Vec::new(), substrate: lower };
    mean(light, |polarisation| {
        let response = stack.solve(500e-9, Incidence::Angle(theta), polarisation)?;
        Ok((response.reflectance, response.transmittance))
    })
}

/// Coherent reflectance and transmittance of one sheet between two half spaces: the scatterer of `coherent_sheets`. θ in
/// the medium above.
///
/// # Errors
/// As [`Multilayer::solve`].
pub fn sheet(
    upper: Complex64,
    sheet: Layer,
    lower: Complex64,
    wavelength: f64,
    theta: f64,
    light: Light,
) -> Result<(f64, f64), WaveError> {
    let stack =
        Multilayer { ambient: upper, runs: vec![Run { unit: vec![sheet], repeat: 1 }], substrate: lower };
    mean(light, |polarisation| {
        let response = stack.solve(wavelength, Incidence::Angle(theta), polarisation)?;
        Ok((response.reflectance, response.transmittance))
    })
}

fn mean(
    light: Light,
    of: impl Fn(Polarisation) -> Result<(f64, f64), WaveError>,
) -> Result<(f64, f64), WaveError> {
    match light {
        Light::Polarised(polarisation) => of(polarisation),
        Light::Unpolarised => {
            let ((r_s, t_s), (r_p, t_p)) = (of(Polarisation::S)?, of(Polarisation::P)?);
            Ok((0.5 * (r_s + r_p), 0.5 * (t_s + t_p)))
        }
    }
}

/// A stack whose interfaces are all mutually incoherent, with absorption along the refracted path.
///
/// # Errors
/// As [`Stack::at`] and [`fresnel`].
pub fn incoherent(stack: &Stack, wavelength: f64, theta: f64, light: Light) -> Result<Intensity, StackError> {
    let multilayer = stack.at(wavelength)?;
    multilayer.check_absorbing()?;
    let wave = InPlaneWave::new(multilayer.ambient, Incidence::Angle(theta))?;
    let k0 = std::f64::consts::TAU / wavelength;
    let mut whole = Intensity::CLEAR;
    let mut above = multilayer.ambient;
    for layer in multilayer.layers() {
        whole = whole.star(&interface(&wave, above, layer.index, light));
        let kz = crate::wave::sqrt_upper(wave.kz2(layer.index));
        whole = whole.star(&Intensity::crossing(2.0 * k0 * kz.im * layer.thickness));
        above = layer.index;
    }
    Ok(whole.star(&interface(&wave, above, multilayer.substrate, light)))
}

fn interface(wave: &InPlaneWave, upper: Complex64, lower: Complex64, light: Light) -> Intensity {
    let of = |polarisation| {
        let (a, b) = (wave.admittance(upper, polarisation), wave.admittance(lower, polarisation));
        if a == b {
            return (0.0, 1.0);
        }
        let sum = (a + b).norm_sqr();
        let reflected = (a - b).norm_sqr() / sum;
        // Between media without loss 4 Re a Re b/|a + b|²; in absorbing ones the mixed term is booked as transmitted.
        let transmitted = if a.im == 0.0 { 4.0 * a.re * b.re / sum } else { 1.0 - reflected };
        (reflected, transmitted.max(0.0))
    };
    let (r, t) = match light {
        Light::Polarised(polarisation) => of(polarisation),
        Light::Unpolarised => {
            let ((r_s, t_s), (r_p, t_p)) = (of(Polarisation::S), of(Polarisation::P));
            (0.5 * (r_s + r_p), 0.5 * (t_s + t_p))
        }
    };
    Intensity::lossless(r, t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;

    #[test]
    fn transmittance_of_many_incoherent_plates_is_right_far_below_1e_30() {
        // A slab of optical depth x between equal media, N times: T = e^(−Nx).
        let slab = Intensity::crossing(2.3);
        let whole = (0..100).fold(Intensity::CLEAR, |sum, _| sum.star(&slab));
        assert!((whole.transmittance.ln() + 230.0).abs() < 1e-10);
        // Mirrors: R/T adds up, so T of N mirrors of R/T = x is 1/(1 + N x).
        let mirror = Intensity::lossless(0.9, 0.1);
        let whole = (0..1000).fold(Intensity::CLEAR, |sum, _| sum.star(&mirror));
        assert!((whole.transmittance * (1.0 + 9000.0) - 1.0).abs() < 1e-12);
        assert!((whole.reflectance + whole.transmittance - 1.0).abs() < 1e-12);
    }

    #[test]
    fn power_is_conserved_whatever_absorbs() {
        let material = |n, k| Material { k, ..Material::constant(n) };
        let stack = Stack::alternating(
            Material::constant(1.0),
            (material(1.53, 1e-4), 450e-9, 0.0),
            (material(1.43, 1e-3), 25e-9, 0.0),
            500,
            Material::constant(1.53),
        );
        for theta in [0.0, 0.7, 1.4] {
            let whole = incoherent(&stack, 550e-9, theta, Light::Unpolarised).unwrap();
            let sum = whole.reflectance + whole.transmittance + whole.absorptance;
            // Each interface between slightly absorbing media loses |Im|² ~ 1e-7 of flux to the mixed term.
            assert!((sum - 1.0).abs() < 1e-5, "{whole:?}");
        }
    }
}
