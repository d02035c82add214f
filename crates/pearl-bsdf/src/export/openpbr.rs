//! A pearl as MaterialX: the nearest OpenPBR surface.
//!
//! The surface is that of the nodes in MaterialX 1.39.5 (`open_pbr_surface.mtlx`) with its closures in GLSL: metal and dielectric
//! under a thin film, and a coat that does not darken. Fuzz has no part: it sends light back to where it came from, a pearl does not.

use super::layered::{Facing, Fitted, Parameter, at_normal, index_of, mix, number, sensitivity, times};
use crate::{Direction, PearlBsdf};
use lut_io::FieldError;
use std::f64::consts::{FRAC_1_PI, PI};
use thinfilm::intensity;

const NUMBERS: usize = 15;
const PARAMETERS: [Parameter; NUMBERS] = [
    number("base_red", [0.0, 1.0], 0.7),
    number("base_green", [0.0, 1.0], 0.7),
    number("base_blue", [0.0, 1.0], 0.7),
    Parameter { name: "base_metalness", range: [0.0, 1.0], starts: [0.2, 0.5, 0.1, 0.4, 0.6] },
    Parameter { name: "specular_roughness", range: [0.05, 1.0], starts: [0.35, 0.5, 0.3, 0.4, 0.55] },
    number("specular_ior", [1.01, 2.5], 1.6),
    number("specular_red", [0.0, 1.0], 0.9),
    number("specular_green", [0.0, 1.0], 0.9),
    number("specular_blue", [0.0, 1.0], 0.9),
    Parameter { name: "thin_film_weight", range: [0.0, 1.0], starts: [0.3, 0.3, 0.3, 0.3, 0.0] },
    Parameter { name: "thin_film_thickness", range: [0.05, 1.5], starts: [0.2, 0.4, 0.6, 0.9, 0.3] },
    number("thin_film_ior", [1.01, 2.5], 1.4),
    number("coat_weight", [0.0, 1.0], 0.5),
    number("coat_roughness", [0.05, 1.0], 0.2),
    number("coat_ior", [1.01, 2.5], 1.5),
];
/// XYZ to RGB as MaterialX's thin films have it.
const RGB_OF_XYZ: [[f64; 3]; 3] = [
    [2.370_674_3, -0.900_040_5, -0.470_633_8],
    [-0.513_885_0, 1.425_303_6, 0.088_581_4],
    [0.005_298_2, -0.014_694_9, 1.009_396_8],
];

/// The numbers by what they are.
struct Surface {
    colour: [f64; 3],
    metalness: f64,
    roughness: f64,
    ior: f64,
    tint: [f64; 3],
    film: f64,
    film_um: f64,
    film_ior: f64,
    coat: f64,
    coat_roughness: f64,
    coat_ior: f64,
}

impl From<[f64; NUMBERS]> for Surface {
    fn from(numbers: [f64; NUMBERS]) -> Self {
        let [
            red,
            green,
            blue,
            metalness,
            roughness,
            ior,
            tint_red,
            tint_green,
            tint_blue,
            film,
            film_um,
            film_ior,
            coat,
            coat_roughness,
            coat_ior,
        ] = numbers;
        let (colour, tint) = ([red, green, blue], [tint_red, tint_green, tint_blue]);
        Self {
            colour,
            metalness,
            roughness,
            ior,
            tint,
            film,
            film_um,
            film_ior,
            coat,
            coat_roughness,
            coat_ior,
        }
    }
}

/// The nearest surface.
#[derive(Clone, Debug)]
pub(super) struct OpenPbr(Fitted<NUMBERS>);

impl OpenPbr {
    pub(super) fn new(bsdf: &PearlBsdf) -> Self {
        Self(Fitted::new(bsdf, &PARAMETERS, model))
    }

    pub(super) const fn fitted(&self) -> &Fitted<NUMBERS> {
        &self.0
    }

    /// The document.
    pub(super) fn encode(&self, name: &str) -> Result<Vec<u8>, FieldError> {
        super::check_xml(name)?;
        let surface = Surface::from(self.0.values);
        let doc = super::xml_text(name).replace('"', "&quot;");
        let colour = |name: &str, [r, g, b]: [f64; 3]| {
            format!("    <input name=\"{name}\" type=\"color3\" value=\"{r}, {g}, {b}\" />\n")
        };
        let number =
            |name: &str, x: f64| format!("    <input name=\"{name}\" type=\"float\" value=\"{x}\" />\n");
        let inputs: String = [
            colour("base_color", surface.colour),
            number("base_weight", 1.0),
            number("base_metalness", surface.metalness),
            number("specular_weight", 1.0),
            colour("specular_color", surface.tint),
            number("specular_roughness", surface.roughness),
            number("specular_ior", surface.ior),
            number("thin_film_weight", surface.film),
            number("thin_film_thickness", surface.film_um),
            number("thin_film_ior", surface.film_ior),
            number("coat_weight", surface.coat),
            number("coat_roughness", surface.coat_roughness),
            number("coat_ior", surface.coat_ior),
            number("coat_darkening", 0.0),
        ]
        .concat();
        Ok(format!(
            r#"<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
  <open_pbr_surface name="pearl_surface" type="surfaceshader" doc="{doc}, by nacre">
{inputs}  </open_pbr_surface>
  <surfacematerial name="pearl" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="pearl_surface" />
  </surfacematerial>
</materialx>
"#
        )
        .into_bytes())
    }
}

fn model(numbers: &[f64; NUMBERS], wi: Direction, wo: Direction) -> [f64; 3] {
    let Surface {
        colour,
        metalness,
        roughness,
        ior,
        tint,
        film,
        film_um,
        film_ior,
        coat,
        coat_roughness,
        coat_ior,
    } = Surface::from(*numbers);
    let facing = Facing::new(wi, wo);
    let cos = facing.cos_difference;
    // The coat roughens what is below it, and is what is outside of it.
    let coated = (2.0 * coat_roughness.powi(4) + roughness.powi(4)).min(1.0).powf(0.25);
    let alpha = mix(roughness, coated, coat).powi(2);
    let ratio = (ior / coat_ior).max(coat_ior / ior);
    let index = mix(ior, ratio, coat);
    let specular = facing.ggx(alpha);
    let whole = albedo(facing.cos_i, alpha, 1.0, 1.0);
    let compensation = |fresnel: f64| 1.0 + fresnel * (1.0 - whole) / whole;

    let film = if film > 0.0 { film } else { 0.0 };
    let filmed = film_on(film_ior, film_um, Base::Dielectric(index), cos);
    let plain = dielectric(cos, index);
    let below = albedo(facing.cos_i, alpha, at_normal(index), 1.0);
    let metal = |c: usize| schlick82(cos, colour[c], tint[c]);
    let filmed_metal = film_on(film_ior, film_um, Base::Metal(colour, tint), cos);

    let coat_alpha = coat_roughness * coat_roughness;
    let coat_whole = albedo(facing.cos_i, coat_alpha, 1.0, 1.0);
    let coat_fresnel = dielectric(cos, coat_ior);
    let coat_compensation = 1.0 + coat_fresnel * (1.0 - coat_whole) / coat_whole;
    let gloss = coat * coat_fresnel * facing.ggx(coat_alpha) * coat_compensation;
    let through_coat =
        1.0 - coat * coat_compensation * albedo(facing.cos_i, coat_alpha, at_normal(coat_ior), 1.0);
    std::array::from_fn(|c| {
        let lobe = |fresnel: f64| fresnel * specular * compensation(fresnel);
        let through = |fresnel: f64| 1.0 - below * compensation(fresnel);
        let diffuse = colour[c] * facing.cos_o * FRAC_1_PI;
        let reflected = tint[c] * mix(lobe(plain), lobe(filmed[c]), film)
            + diffuse * mix(through(plain), through(filmed[c]), film);
        let metallic = mix(lobe(metal(c)), lobe(filmed_metal[c]), film);
        gloss + through_coat * mix(reflected, metallic, metalness)
    })
}

/// MaterialX's fit of the directional albedo of GGX.
fn albedo(cos: f64, alpha: f64, normal: f64, grazing: f64) -> f64 {
    const TERMS: [[f64; 4]; 9] = [
        [0.1003, 0.9345, 1.0, 1.0],
        [-0.6303, -2.323, -1.765, 0.2281],
        [9.748, 2.229, 8.263, 15.94],
        [-2.038, -3.748, 11.53, -55.83],
        [29.34, 1.424, 28.96, 13.08],
        [-8.245, -0.7684, -7.507, 41.26],
        [-26.44, 1.436, -36.11, 54.9],
        [19.99, 0.2913, 15.86, 300.2],
        [-5.448, 0.6286, 33.37, -285.1],
    ];
    let (x, y) = (cos, alpha);
    let powers = [1.0, x, y, x * y, x * x, y * y, x * x * y, x * y * y, x * x * y * y];
    let sum = |k: usize| TERMS.iter().zip(powers).map(|(term, power)| term[k] * power).sum::<f64>();
    let [a, b] = [sum(0) / sum(2), sum(1) / sum(3)].map(|share| share.clamp(0.0, 1.0));
    normal * a + grazing * b
}

/// Fresnel's factor of an index.
fn dielectric(cos: f64, index: f64) -> f64 {
    let [p, s] = polarised(cos, index);
    0.5 * (p + s)
}

/// Schlick's factor from one colour at normal incidence to white, lowered towards another near 82° (Hoffman 2023).
fn schlick82(cos: f64, normal: f64, tint: f64) -> f64 {
    const AT: f64 = 1.0 / 7.0;
    let x = cos.clamp(0.0, 1.0);
    let schlick = |x: f64| mix(normal, 1.0, (1.0 - x).powi(5));
    let lowered = schlick(AT) * (1.0 - tint) / (AT * (1.0 - AT).powi(6));
    schlick(x) - lowered * x * (1.0 - x).powi(6)
}

/// What is below a film: an index, or a metal's colours.
enum Base {
    Dielectric(f64),
    Metal([f64; 3], [f64; 3]),
}

/// Fresnel's factor of a film, p and s apart.
fn film_on(film_ior: f64, thickness_um: f64, base: Base, cos: f64) -> [f64; 3] {
    let inside = (1.0 - (1.0 - cos * cos) / (film_ior * film_ior)).max(0.0).sqrt();
    let first = polarised(cos, film_ior);
    // Each of p and s, of each channel: reflectance and phase of the second interface.
    let (second, phase): ([[f64; 3]; 2], [[f64; 3]; 2]) = match base {
        Base::Dielectric(index) => {
            let ratio = index / film_ior;
            let turned = phases(inside, film_ior, index);
            (polarised(inside, ratio).map(|r| [r; 3]), turned.map(|turn| [turn; 3]))
        }
        Base::Metal(colour, tint) => {
            let half = std::array::from_fn(|c| 0.5 * schlick82(inside, colour[c], tint[c]));
            let index = colour.map(|f0| index_of(f0.clamp(0.01, 0.99)));
            let turned = index.map(|index| if index < film_ior { PI } else { 0.0 });
            ([half; 2], [turned; 2])
        }
    };
    let brewster = film_ior.atan().cos();
    let outer = [if cos < brewster { 0.0 } else { PI }, PI];
    let path = 2.0 * film_ior * inside * thickness_um * 1e-6;
    let mut xyz = [0.0; 3];
    for way in 0..2 {
        let (first, through) = (first[way], 1.0 - first[way]);
        let shift = phase[way].map(|phase| phase + outer[way]);
        let waves = [1.0, 2.0].map(|order| sensitivity(order * path, shift.map(|shift| order * shift)));
        for c in 0..3 {
            let second = second[way][c];
            let after = through * through * second / (1.0 - first * second);
            let both = (first * second).max(0.0).sqrt();
            let orders = both * 2.0 * waves[0][c] + both * both * 2.0 * waves[1][c];
            xyz[c] += 0.5 * (first + after + (after - through) * orders);
        }
    }
    times(&RGB_OF_XYZ, xyz).map(|x| x.clamp(0.0, 1.0))
}

/// Reflectances of p and s of an index over that before it.
fn polarised(cos: f64, ratio: f64) -> [f64; 2] {
    let cos = cos.clamp(0.0, 1.0);
    let inside = (1.0 - (1.0 - cos * cos) / (ratio * ratio)).max(0.0).sqrt();
    let (s, p) = intensity::fresnel(1.0, cos, ratio, inside);
    [p, s]
}

/// Phases of p and s at an interface from one index to another.
fn phases(cos: f64, from: f64, to: f64) -> [f64; 2] {
    let a = to * to - from * from * (1.0 - cos * cos);
    let u2 = a.max(0.0);
    let v = (-a).max(0.0).sqrt();
    let s = (2.0 * from * v * cos).atan2(u2 + v * v - (from * cos).powi(2));
    let p = (-2.0 * from * to * to * cos * v).atan2((to * to * cos).powi(2) - from * from * (u2 + v * v));
    [p, s]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresnels_factor_is_that_of_materialx() {
        // Its closed form (mx_fresnel_dielectric).
        let closed = |cos: f64, index: f64| {
            let g = (index * index + cos * cos - 1.0).sqrt();
            let (s, p) = ((g - cos) / (g + cos), ((g + cos) * cos - 1.0) / ((g - cos) * cos + 1.0));
            0.5 * s * s * (1.0 + p * p)
        };
        for cos in [0.05, 0.3, 0.7, 1.0] {
            assert!((closed(cos, 1.6) - dielectric(cos, 1.6)).abs() < 1e-12, "{cos}");
        }
        // Total reflection.
        assert_eq!(dielectric(0.1, 0.6), 1.0);
    }

    #[test]
    fn metals_are_their_colours_at_normal_incidence_and_white_at_grazing() {
        assert!(
            (schlick82(1.0, 0.4, 0.7) - 0.4).abs() < 1e-12 && (schlick82(0.0, 0.4, 0.7) - 1.0).abs() < 1e-12
        );
        // At 82° the tint is what Schlick's factor is multiplied by.
        let there = schlick82(1.0 / 7.0, 0.4, 1.0);
        assert!((schlick82(1.0 / 7.0, 0.4, 0.7) - 0.7 * there).abs() < 1e-12);
    }
}
