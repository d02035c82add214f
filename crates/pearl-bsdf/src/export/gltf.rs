//! A pearl as glTF: a sphere with the nearest material of `KHR_materials_iridescence`, `clearcoat`, `ior` and `specular`.
//!
//! The material is that of the specification (glTF 2.0, appendix B, and the extensions' own pages). Viewers take Fresnel's
//! factor of the film at the normal for that at the half vector, which is the same where a lobe is narrow. Sheen has no part: it
//! sends light back to where it came from, a pearl does not.

use super::layered::{Facing, Fitted, Parameter, at_normal, film, index_of, mix, number, schlick, times};
use crate::{Direction, PearlBsdf};
use serde_json::json;
use std::f64::consts::{FRAC_1_PI, PI};

const NUMBERS: usize = 14;
const PARAMETERS: [Parameter; NUMBERS] = [
    number("red", [0.0, 1.0], 0.7),
    number("green", [0.0, 1.0], 0.7),
    number("blue", [0.0, 1.0], 0.7),
    Parameter { name: "metallic", range: [0.0, 1.0], starts: [0.2, 0.5, 0.1, 0.4, 0.6] },
    Parameter { name: "roughness", range: [0.05, 1.0], starts: [0.35, 0.5, 0.3, 0.4, 0.55] },
    number("ior", [1.0, 2.5], 1.6),
    number("specular_red", [0.0, 1.0], 0.9),
    number("specular_green", [0.0, 1.0], 0.9),
    number("specular_blue", [0.0, 1.0], 0.9),
    Parameter { name: "iridescence", range: [0.0, 1.0], starts: [0.3, 0.3, 0.3, 0.3, 0.0] },
    number("iridescence_ior", [1.0, 2.5], 1.4),
    Parameter {
        name: "iridescence_thickness_nm",
        range: [50.0, 1500.0],
        starts: [200.0, 400.0, 600.0, 900.0, 300.0],
    },
    number("clearcoat", [0.0, 1.0], 0.5),
    number("clearcoat_roughness", [0.05, 1.0], 0.2),
];
/// XYZ to linear sRGB, as the extension's sample code has it.
const RGB_OF_XYZ: [[f64; 3]; 3] = [
    [3.240_454_2, -1.537_138_5, -0.498_531_4],
    [-0.969_266_0, 1.876_010_8, 0.041_556_0],
    [0.055_643_4, -0.204_025_9, 1.057_225_2],
];
/// Rings and sectors of the sphere.
const RINGS: usize = 64;
const SECTORS: usize = 128;

/// The numbers by what they are.
struct Material {
    colour: [f64; 3],
    metallic: f64,
    roughness: f64,
    ior: f64,
    tint: [f64; 3],
    film: f64,
    film_ior: f64,
    film_nm: f64,
    coat: f64,
    coat_roughness: f64,
}

impl From<[f64; NUMBERS]> for Material {
    fn from(numbers: [f64; NUMBERS]) -> Self {
        let [
            red,
            green,
            blue,
            metallic,
            roughness,
            ior,
            tint_red,
            tint_green,
            tint_blue,
            film,
            film_ior,
            film_nm,
            coat,
            coat_roughness,
        ] = numbers;
        let (colour, tint) = ([red, green, blue], [tint_red, tint_green, tint_blue]);
        Self { colour, metallic, roughness, ior, tint, film, film_ior, film_nm, coat, coat_roughness }
    }
}

/// The nearest material.
#[derive(Clone, Debug)]
pub(super) struct Gltf(Fitted<NUMBERS>);

impl Gltf {
    pub(super) fn new(bsdf: &PearlBsdf) -> Self {
        Self(Fitted::new(bsdf, &PARAMETERS, model))
    }

    pub(super) const fn fitted(&self) -> &Fitted<NUMBERS> {
        &self.0
    }

    /// The binary file.
    pub(super) fn encode(&self, name: &str) -> Vec<u8> {
        let material = Material::from(self.0.values);
        let [red, green, blue] = material.colour;
        let (positions, indices) = sphere();
        let bytes: Vec<u8> = positions
            .iter()
            .flatten()
            .flat_map(|x| x.to_le_bytes())
            .chain(indices.iter().flat_map(|i| i.to_le_bytes()))
            .collect();
        let (vertices, length) = (positions.len(), positions.len() * 12);
        let scene = json!({
            "asset": { "version": "2.0", "generator": "nacre" },
            "extensionsUsed": ["KHR_materials_clearcoat", "KHR_materials_ior", "KHR_materials_iridescence", "KHR_materials_specular"],
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "name": name, "mesh": 0 }],
            "meshes": [{ "name": name, "primitives": [
                { "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 2, "material": 0 }] }],
            "materials": [{
                "name": name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [red, green, blue, 1.0],
                    "metallicFactor": material.metallic,
                    "roughnessFactor": material.roughness,
                },
                "extensions": {
                    "KHR_materials_clearcoat": {
                        "clearcoatFactor": material.coat,
                        "clearcoatRoughnessFactor": material.coat_roughness,
                    },
                    "KHR_materials_ior": { "ior": material.ior },
                    "KHR_materials_iridescence": {
                        "iridescenceFactor": material.film,
                        "iridescenceIor": material.film_ior,
                        "iridescenceThicknessMaximum": material.film_nm,
                    },
                    "KHR_materials_specular": { "specularColorFactor": material.tint },
                },
            }],
            // A unit sphere's normals are its points.
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3",
                  "min": [-1.0, -1.0, -1.0], "max": [1.0, 1.0, 1.0] },
                { "bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3" },
                { "bufferView": 1, "componentType": 5123, "count": indices.len(), "type": "SCALAR" },
            ],
            "bufferViews": [
                { "buffer": 0, "byteOffset": 0, "byteLength": length, "byteStride": 12, "target": 34962 },
                { "buffer": 0, "byteOffset": length, "byteLength": bytes.len() - length, "target": 34963 },
            ],
            "buffers": [{ "byteLength": bytes.len() }],
        });
        binary(scene.to_string().into_bytes(), bytes)
    }
}

/// Chunks of a .glb: JSON and numbers, each padded to four bytes.
fn binary(mut json: Vec<u8>, mut numbers: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    numbers.resize(numbers.len().next_multiple_of(4), 0);
    let size = |bytes: usize| (bytes as u32).to_le_bytes();
    let total = 12 + 8 + json.len() + 8 + numbers.len();
    [
        &b"glTF"[..],
        &2u32.to_le_bytes(),
        &size(total),
        &size(json.len()),
        b"JSON",
        &json,
        &size(numbers.len()),
        b"BIN\0",
        &numbers,
    ]
    .concat()
}

/// Points of a unit sphere, y up, and its triangles.
fn sphere() -> (Vec<[f32; 3]>, Vec<u16>) {
    let point = |ring: usize, sector: usize| -> [f32; 3] {
        let (theta, phi) = (PI * ring as f64 / RINGS as f64, 2.0 * PI * sector as f64 / SECTORS as f64);
        let [x, y, z] = [theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()];
        // What is a zero or a one is not nearly so.
        [x, y, z].map(|x| (x * 1e7).round() as f32 / 1e7)
    };
    let points = (0..=RINGS).flat_map(|ring| (0..SECTORS).map(move |sector| point(ring, sector))).collect();
    let at = |ring: usize, sector: usize| (ring * SECTORS + sector % SECTORS) as u16;
    let mut triangles = Vec::new();
    for ring in 0..RINGS {
        for sector in 0..SECTORS {
            let [a, b, c, d] = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(r, s)| at(ring + r, sector + s));
            // At a pole two corners of four are the same point.
            if ring > 0 {
                triangles.extend([a, b, c]);
            }
            if ring < RINGS - 1 {
                triangles.extend([a, c, d]);
            }
        }
    }
    (points, triangles)
}

fn model(numbers: &[f64; NUMBERS], wi: Direction, wo: Direction) -> [f64; 3] {
    let Material { colour, metallic, roughness, ior, tint, film, film_ior, film_nm, coat, coat_roughness } =
        Material::from(*numbers);
    let facing = Facing::new(wi, wo);
    let cos = facing.cos_difference;
    let specular = facing.ggx(roughness * roughness);
    let normal = tint.map(|tint| (at_normal(ior) * tint).min(1.0));
    let over_diffuse = |fresnel: [f64; 3]| -> [f64; 3] {
        let most = fresnel.iter().copied().fold(0.0, f64::max);
        std::array::from_fn(|c| (1.0 - most) * colour[c] * facing.cos_o * FRAC_1_PI + fresnel[c] * specular)
    };
    let plain = over_diffuse(normal.map(|f0| schlick(f0, 1.0, cos)));
    let filmed = over_diffuse(iridescent(film_ior, film_nm, normal, cos));
    let metal = colour.map(|f0| schlick(f0, 1.0, cos) * specular);
    let filmed_metal = iridescent(film_ior, film_nm, colour, cos).map(|f| f * specular);
    let coated = coat * schlick(0.04, 1.0, facing.cos_i);
    let gloss = facing.ggx(coat_roughness * coat_roughness);
    std::array::from_fn(|c| {
        let without = mix(plain[c], metal[c], metallic);
        let with = mix(filmed[c], filmed_metal[c], metallic);
        mix(mix(without, with, film), gloss, coated)
    })
}

/// Fresnel's factor of a film on a base of such a reflectance at normal incidence.
fn iridescent(ior: f64, thickness_nm: f64, base: [f64; 3], cos: f64) -> [f64; 3] {
    let cos2 = 1.0 - (1.0 - cos * cos) / (ior * ior);
    if cos2 < 0.0 {
        return [1.0; 3];
    }
    let inside = cos2.sqrt();
    let index = base.map(|f0| index_of(f0.clamp(0.0, 0.9999)));
    let second = index.map(|index| schlick(at_normal(index / ior), 1.0, inside));
    let shift = index.map(|index| if index < ior { 2.0 * PI } else { PI });
    let (mean, waves) =
        film(schlick(at_normal(ior), 1.0, cos), second, 2.0 * ior * inside * thickness_nm * 1e-9, shift);
    let waves = times(&RGB_OF_XYZ, waves);
    std::array::from_fn(|c| (mean[c] + waves[c]).max(0.0))
}
