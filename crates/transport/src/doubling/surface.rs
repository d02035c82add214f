//! The single reflection at interface 0 in closed form: facet density × Fresnel reflectance.

use std::f64::consts::{FRAC_PI_2, PI};

use super::grid::segment_rule;
use crate::problem::Face;
use crate::{Facets, Geometry, Light, Normals, Transport};

/// Facet tilts that the plane's visible normals may have, at most, as the walk draws them.
pub(super) fn steepest_visible_tilt(sigma: f64) -> f64 {
    (6.5 * sigma).min(80_f64.to_radians())
}

/// Light of one incidence reflected by interface 0 at its first facet.
///
/// Plane: p(α)·F(θi + α)/(2Z) per radian of s, α = (s − θi)/2. Space: p(x, q)·F/(4 cos i·m_z³·Z) per steradian of
/// exit, m the half vector; this is f·cos θo. Z is the facets' total weight, the facing ones only.
#[derive(Clone, Copy, Debug)]
pub struct SingleReflection {
    geometry: Geometry,
    facets: Facets,
    light: Light,
    face: Face,
    sine: f64,
    cosine: f64,
    theta_i: f64,
    norm: f64,
}

/// An azimuth by the sines of it and of half of it, for many exits.
#[derive(Clone, Copy, Debug)]
pub struct Azimuth {
    half_sine: f64,
    sine: f64,
}

impl Azimuth {
    /// The azimuth φ, radians.
    #[must_use]
    pub fn new(phi: f64) -> Self {
        Self { half_sine: (0.5 * phi).sin(), sine: phi.sin() }
    }
}

impl SingleReflection {
    /// The lobe of one incidence (radians).
    #[must_use]
    pub fn new(transport: &Transport, geometry: Geometry, theta_i: f64) -> Self {
        let facets = transport.facets;
        let (sine, cosine) = theta_i.sin_cos();
        let mut lobe = Self {
            geometry,
            facets,
            light: transport.light,
            face: Face::new(transport.index(0), transport.index(1)),
            sine,
            cosine,
            theta_i,
            norm: 1.0,
        };
        lobe.norm = 1.0 / lobe.total();
        lobe
    }

    /// Z·√(2π)σ (plane) or Z·2πσ² (space).
    fn total(&self) -> f64 {
        let sigma = self.facets.slope_sd;
        let far = 9.0 * sigma;
        let (mut low, mut high) = (-far, far);
        match self.geometry {
            Geometry::Plane => {
                if self.facets.normals == Normals::Visible {
                    high = steepest_visible_tilt(sigma);
                    low = -high;
                }
                low = low.max(-FRAC_PI_2 - self.theta_i);
                high = high.min(FRAC_PI_2 - self.theta_i);
            }
            Geometry::Space => high = high.min(self.cosine / self.sine.max(1e-300)),
        }
        let rule = segment_rule(80);
        let half = 0.5 * (high - low);
        let along: f64 = rule
            .nodes
            .iter()
            .zip(&rule.weights)
            .map(|(t, w)| {
                let x = low + half * (t + 1.0);
                w * half * (-0.5 * (x / sigma).powi(2)).exp() * self.visibility(x)
            })
            .sum();
        match self.geometry {
            Geometry::Plane => along,
            Geometry::Space => along * (2.0 * PI).sqrt() * sigma,
        }
    }

    /// max(0, −d·m)/m_z where facets are weighted by it; x is the tilt (plane) or the slope (space).
    fn visibility(&self, x: f64) -> f64 {
        match (self.facets.normals, self.geometry) {
            (Normals::Unweighted, _) => 1.0,
            (Normals::Visible, Geometry::Plane) => (self.theta_i + x).cos() / x.cos(),
            (Normals::Visible, Geometry::Space) => self.cosine - x * self.sine,
        }
    }

    /// Density at a signed exit angle s, per radian (plane).
    #[must_use]
    pub fn plane(&self, s: f64) -> f64 {
        let sigma = self.facets.slope_sd;
        let alpha = 0.5 * (s - self.theta_i);
        let cos_i = (self.theta_i + alpha).cos();
        let too_steep = self.facets.normals == Normals::Visible && alpha.abs() > steepest_visible_tilt(sigma);
        if cos_i <= 0.0 || too_steep {
            return 0.0;
        }
        let weight = (-0.5 * (alpha / sigma).powi(2)).exp() * self.visibility(alpha);
        0.5 * weight * self.face.meet(cos_i, self.light).0 * self.norm
    }

    /// Standard deviation of φ at the exit angle θo (space), radians, to first order in the slope across the plane of incidence: at
    /// grazing incidence a ridge towards the horizon.
    #[must_use]
    pub fn azimuth_sd(&self, theta_o: f64) -> f64 {
        let (sine, cosine) = theta_o.sin_cos();
        // The slopes of the half vector: p² + q² = (sin²θi + sin²θo − 2 sin θi sin θo cos φ)/(cos θi + cos θo)².
        self.facets.slope_sd * (self.cosine + cosine) / (self.sine * sine).sqrt().max(f64::MIN_POSITIVE)
    }

    /// The slope, in standard deviations, of the flattest facet that reflects to an exit (sin θo, cos θo), at any φ (space).
    #[must_use]
    pub fn slope(&self, (sine, cosine): (f64, f64)) -> f64 {
        (sine - self.sine).abs() / ((cosine + self.cosine).max(f64::MIN_POSITIVE) * self.facets.slope_sd)
    }

    /// f·cos θo at the exit direction (θo, φ), 1/sr (space).
    #[must_use]
    pub fn space(&self, theta_o: f64, phi: f64) -> f64 {
        self.towards(theta_o.sin_cos(), Azimuth::new(phi))
    }

    /// [`SingleReflection::space`] for any exit direction (s cos φ, s sin φ, c) by its s and c; c < 0 heads for the interface again.
    #[must_use]
    pub fn towards(&self, (s, c): (f64, f64), Azimuth { half_sine, sine }: Azimuth) -> f64 {
        // The half vector (d' − d)/2; sin²(φ/2) keeps its digits at small φ.
        let x = s - self.sine - 2.0 * s * half_sine * half_sine;
        let y = s * sine;
        let z = c + self.cosine;
        if z <= 0.0 {
            return 0.0;
        }
        let square = x * x + y * y + z * z;
        let (slope_x, slope_y) = (x / z, y / z);
        let sigma = self.facets.slope_sd;
        let cos_i = 0.5 * square.sqrt();
        let cosine_cubed = z * z * z / (square * square.sqrt());
        let weight = (-0.5 * (slope_x * slope_x + slope_y * slope_y) / (sigma * sigma)).exp()
            * self.visibility(slope_x);
        weight * self.face.meet(cos_i, self.light).0 * self.norm / (4.0 * cos_i * cosine_cubed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn integral(lobe: &SingleReflection) -> f64 {
        let rule = segment_rule(160);
        let mut sum = 0.0;
        for (t, w) in rule.nodes.iter().zip(&rule.weights) {
            let theta = 0.25 * PI * (t + 1.0);
            for (u, v) in rule.nodes.iter().zip(&rule.weights) {
                let phi = 0.5 * PI * (u + 1.0);
                sum += 0.25 * PI * w * PI * v * theta.sin() * lobe.space(theta, phi);
            }
        }
        sum
    }

    #[test]
    fn without_fresnel_loss_the_lobe_holds_all_light_of_a_wide_open_incidence() {
        for normals in [Normals::Unweighted, Normals::Visible] {
            let mut transport = Transport::alternating(1, 1e6, 1.0, 1.0, 8_f64.to_radians());
            transport.facets.normals = normals;
            let lobe = SingleReflection::new(&transport, Geometry::Space, 0.4);
            let sum = integral(&lobe);
            // n = 1e6 reflects all but 4e-6; nothing is facing away or sent below the horizon at 23° (8σ).
            assert!((sum - 1.0).abs() < 1e-5, "{normals:?}: {sum}");
        }
    }
}
