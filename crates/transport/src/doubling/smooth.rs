//! σ = 0: smooth faces, where every ray stays on the specular direction and the star product is one of numbers.

use super::settings::{DoublingError, check_stack};
use super::solution::Lobe;
use crate::problem::Face;
use crate::{Light, Transport};

/// What a stack of smooth interfaces does to light of each incidence `theta_i` (radians): exact, whatever the facets of
/// `transport` say of their slope.
///
/// All that is reflected leaves at θo = θi, φ = 0; what is transmitted follows Snell's law. Light that went round
/// between interfaces is added in intensity (the walk knows no phase).
///
/// # Errors
/// [`DoublingError`] for a stack or an incidence out of range.
pub fn smooth(transport: &Transport, theta_i: &[f64]) -> Result<Vec<Lobe>, DoublingError> {
    check_stack(transport, theta_i)?;
    if transport.sheets.is_some() || transport.light == Light::Tracked {
        return Err(DoublingError::WalkOnly(
            "coherent sheets and tracked light are walked only: use the walk",
        ));
    }
    Ok(theta_i.iter().map(|&theta| lobe(transport, theta)).collect())
}

fn lobe(transport: &Transport, theta_i: f64) -> Lobe {
    let faces = Faces::new(transport, theta_i);
    let (albedo, transmitted) =
        if transport.absorbs() { added(transport, &faces) } else { pile_of_plates(&faces) };
    Lobe {
        theta_i,
        albedo,
        transmitted,
        absorbed: if transport.absorbs() { 1.0 - albedo - transmitted } else { 0.0 },
        surface: faces.reflectance(0).0,
        rehit: 0.0,
        mean: theta_i,
        sd: 0.0,
        skew: 0.0,
    }
}

/// One ray in a stack.
struct Faces<'a> {
    transport: &'a Transport,
    /// Its cosine in every medium, 0 past a critical angle.
    cosines: Vec<f64>,
}

impl<'a> Faces<'a> {
    fn new(transport: &'a Transport, theta_i: f64) -> Self {
        let indices = transport.indices.as_slice();
        let cosine = theta_i.cos();
        let cosines = indices
            .iter()
            .map(|n| {
                // 1 − (n₀ sin θ/n)², written so that cos θ keeps its digits where the indices are nearly equal.
                let ratio = indices[0] / n;
                ((1.0 - ratio) * (1.0 + ratio) + (ratio * cosine).powi(2)).max(0.0).sqrt()
            })
            .collect();
        Self { transport, cosines }
    }

    /// Fresnel reflectance of interface `i` for the problem's light, and what goes on; the same from both sides where light travels on
    /// both.
    fn reflectance(&self, i: usize) -> (f64, f64) {
        let (first, second) = (self.transport.index(i), self.transport.index(i + 1));
        let (c1, c2) = (self.cosines[i], self.cosines[i + 1]);
        if first == second {
            return (0.0, 1.0);
        }
        if c1 == 0.0 {
            return (1.0, 0.0); // grazing, or nothing arrives
        }
        if first.im == 0.0 && second.im == 0.0 {
            if c2 == 0.0 {
                return (1.0, 0.0); // total
            }
            // From cosines of the incident ray: no error adds up from face to face.
            let (n1, n2) = (first.re, second.re);
            let s = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2);
            let p = (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2);
            let r = self.transport.light.of_both(s * s, p * p);
            return (r, 1.0 - r);
        }
        let (r, _) = Face::new(first, second).meet(c1, self.transport.light);
        (r, if c2 == 0.0 { 0.0 } else { 1.0 - r })
    }

    fn count(&self) -> usize {
        self.cosines.len() - 1
    }
}

/// Lossless: R/T of a stack is the sum of R/T of its faces (Stokes 1862, "On the intensity of the light reflected from
/// or transmitted through a pile of plates"), which keeps R + T = 1 to rounding for any number of them.
fn pile_of_plates(faces: &Faces<'_>) -> (f64, f64) {
    let ratio: f64 = (0..faces.count())
        .map(|i| {
            let (r, t) = faces.reflectance(i);
            r / t
        })
        .sum();
    if ratio.is_infinite() {
        return (1.0, 0.0);
    }
    (ratio / (1.0 + ratio), 1.0 / (1.0 + ratio))
}

/// The adding equations from the substrate up.
fn added(transport: &Transport, faces: &Faces<'_>) -> (f64, f64) {
    let (mut below, mut through) = (0.0, 1.0);
    for i in (0..faces.count()).rev() {
        if i < transport.layers() {
            // The layer above interface i + 1, crossed once on the way down and once on the way up.
            let keep = keep(transport.optical_depths[i], faces.cosines[i + 1]);
            through *= keep;
            below *= keep * keep;
        }
        let (r, t) = faces.reflectance(i);
        let round = 1.0 - r * below;
        if t == 0.0 || round <= 0.0 {
            (below, through) = (r, 0.0);
            continue;
        }
        (below, through) = (r + t * t * below / round, t * through / round);
    }
    (below, through)
}

/// exp(−τ/cos θ); a layer without absorption takes nothing even along the horizon.
fn keep(depth: f64, cosine: f64) -> f64 {
    if depth > 0.0 { (-depth / cosine).exp() } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(transport: &Transport, degrees: f64) -> Lobe {
        smooth(transport, &[degrees.to_radians()]).unwrap()[0]
    }

    #[test]
    fn a_pile_of_plates_and_the_adding_equations_agree() {
        let stack = Transport::alternating(137, 1.53, 1.43, 1.7, 0.0);
        for degrees in [0.0, 20.0, 56.8, 80.0, 89.99] {
            let faces = Faces::new(&stack, f64::to_radians(degrees));
            let (closed, recursive) = (pile_of_plates(&faces), added(&stack, &faces));
            // 138 steps of rounding.
            assert!(
                (closed.0 - recursive.0).abs() < 1e-13 && (closed.1 - recursive.1).abs() < 1e-13,
                "{degrees}"
            );
        }
    }

    #[test]
    fn the_papers_stack_at_normal_incidence_is_the_closed_form() {
        // 500 faces of r = (0.1/2.96)², one of R₀ = (0.53/2.53)²; R/T adds.
        let (r, r0) = ((0.1_f64 / 2.96).powi(2), (0.53_f64 / 2.53).powi(2));
        let ratio = 500.0 * r / (1.0 - r) + r0 / (1.0 - r0);
        let lobe = at(&Transport::alternating(500, 1.53, 1.43, 1.53, 0.0), 0.0);
        assert!((lobe.albedo - ratio / (1.0 + ratio)).abs() < 1e-14, "{lobe:?}");
        assert!((lobe.surface - r0).abs() < 1e-15);
    }

    #[test]
    fn energy_closes_for_thick_faint_and_totally_reflecting_stacks() {
        for (layers, odd, even, substrate) in [
            (0, 1.0, 1.0, 1.5),
            (1, 1.5, 1.0, 1.0),
            (100_000, 1.53, 1.43, 1.0),
            (500, 1.53, 1.529_999, 1.53),
            (7, 0.6, 1.4, 1.0),
        ] {
            let stack = Transport::alternating(layers, odd, even, substrate, 0.0);
            for degrees in [0.0, 30.0, 45.0, 89.99, 90.0] {
                let lobe = at(&stack, degrees);
                let balance = lobe.albedo + lobe.transmitted - 1.0;
                assert!(balance.abs() < 1e-15, "{layers} {odd} {degrees}: {balance:e}");
                assert!((0.0..=1.0).contains(&lobe.albedo) && lobe.surface <= lobe.albedo + 1e-15);
            }
        }
        // sin 45° > 0.6: nothing enters.
        assert_eq!(at(&Transport::alternating(7, 0.6, 1.4, 1.0, 0.0), 45.0).albedo, 1.0);
    }

    #[test]
    fn a_layer_without_index_step_obeys_beers_law() {
        let mut stack = Transport::alternating(1, 1.0, 1.0, 1.0, 0.0);
        stack.optical_depths = vec![0.7];
        let lobe = at(&stack, 60.0);
        assert!((lobe.transmitted - (-1.4_f64).exp()).abs() < 1e-14 && lobe.albedo == 0.0, "{lobe:?}");
    }
}
