//! Directional albedos, by quadrature.

use super::colours::Viewer;
use super::{AtBand, Pair, PearlBsdf};
use crate::facets::Rules;
use crate::lobes::integral::{self, COARSE, FINE};
use crate::numerics::curve::{Curve, Place};

impl PearlBsdf {
    /// Directional albedo at θi (radians, below π/2) of each component, shown or not (what mixing of bands takes below 0 is cut where it
    /// is shown), linear sRGB, in the order of
    /// [`crate::Components::NAMES`]: the integral of [`Self::eval`] over the exit hemisphere, by quadrature.
    #[must_use]
    pub fn directional_albedo(&self, theta_i: f64) -> [[f64; 3]; 4] {
        self.albedo(theta_i, Viewer::AtExit)
    }

    /// What a viewer at θ (radians, below π/2) sees of a white surrounding, component by component like
    /// [`Self::directional_albedo`]: the integral of [`Self::eval_seen`] over the light. The lobes are the same.
    #[must_use]
    pub fn directional_albedo_seen(&self, theta: f64) -> [[f64; 3]; 4] {
        self.albedo(theta, Viewer::AtIncidence)
    }

    /// Share of the light that the lobes leave to the base at an incidence, and tint·Ê at it as a viewing angle; linear sRGB.
    pub(crate) fn left_and_emission(&self, cos: f64) -> [[f64; 3]; 2] {
        let at = Place::of_cos(cos);
        let of = |band: AtBand<'_>| [band.rgb.rest(at), band.rgb.emission(at), [0.0; 3], [0.0; 3]];
        let [rest, emission, ..] = if self.is_dispersed() { self.mixed(of) } else { of(self.own()) };
        [rest, emission]
    }

    fn albedo(&self, theta_i: f64, viewer: Viewer) -> [[f64; 3]; 4] {
        let of = |band: AtBand<'_>| band.albedo(theta_i, viewer, &self.prepared.mean_weights);
        if !self.is_dispersed() {
            return of(self.own());
        }
        let mut albedo = self.mixed(of);
        for (albedo, cut) in albedo.iter_mut().flatten().zip(self.cut_off(theta_i, viewer).as_flattened()) {
            *albedo += cut;
        }
        albedo
    }

    /// The light below 0 that mixing of bands leaves in single directions, and that an evaluation cuts off.
    fn cut_off(&self, theta_i: f64, viewer: Viewer) -> [[f64; 3]; 4] {
        let (sin_i, cos_i) = theta_i.sin_cos();
        let mut cut = [[0.0; 3]; 4];
        integral::directions(&self.own().band.lobes, theta_i, COARSE, |o, phi, weight| {
            let wo = [-o.sin * phi.cos(), -o.sin * phi.sin(), o.cos];
            let Some(pair) = Pair::new([sin_i, 0.0, cos_i], wo) else { return };
            let parts = self.mixed(|band| band.eval(&pair, viewer).parts());
            for (cut, part) in cut.iter_mut().flatten().zip(parts.as_flattened()) {
                *cut += weight * (-part).max(0.0);
            }
        });
        cut
    }
}

impl AtBand<'_> {
    fn albedo(&self, theta_i: f64, viewer: Viewer, mean_weights: &Curve) -> [[f64; 3]; 4] {
        let cos_i = theta_i.cos();
        let at_i = Place::of_cos(cos_i);
        let (mut mirror, mut blur) = ([0.0; 3], [0.0; 3]);
        let add = |sum: &mut [f64; 3], mass: f64, at_d: Place| {
            let factor = self.rgb.lobe_factor(at_i, at_d);
            (0..3).for_each(|c| sum[c] += mass * factor[c]);
        };
        self.band.facets.integrate(&Rules::new(), cos_i, |mass, cos_d, cos_o| {
            let scale = self.mirror_factor(at_i, Place::of_cos(cos_o), cos_o);
            add(&mut mirror, mass * scale, Place::of_cos(cos_d));
        });
        integral::integrate(&self.band.lobes, theta_i, FINE, |at_d, [interior, rehit]| {
            add(&mut mirror, rehit, at_d);
            add(&mut blur, interior, at_d);
        });
        let [diffuse, incoherent] = match viewer {
            Viewer::AtExit => self.rgb.base_albedo(at_i, mean_weights),
            Viewer::AtIncidence => self.rgb.base_albedo_seen(at_i),
        };
        [diffuse, incoherent, mirror, blur]
    }
}
