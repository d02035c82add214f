//! The pearl as a material of Blender: a Python file that builds it of native nodes.
//!
//! What a viewer at an angle sees is a sum of reflections that Cycles has: four anisotropic Beckmann lobes whose normals are
//! tilted in the plane of incidence, two pairs of them that are turned out of it to either side, a diffuse one, and seven ramps
//! about the normal (toon shading: light that falls linearly between two angles). The ramps carry what of the base depends on the
//! direction of the light, and the wide part of the lobes. Weights are [P·(1 − γ) + γ·tint·M]·brightness with
//! P and M read over the viewing angle, M over the thickness as well, so that the controls stay sockets.
//!
//! [`Curves::eval`] is the arithmetic of `blender/pearl.py` once more: the printed error is that of the file.

use super::microfacet::{self, Beckmann, Point, bounded, in_plane};
use super::nonnegative;
use crate::round_trip::point;
use crate::{BsdfError, Components, Controls, Direction, PearlBsdf};
use base64::Engine as _;
use flate2::write::ZlibEncoder;
use lut_io::FieldError;
use rayon::prelude::*;
use rmpfit::{MPConfig, MPFitter, MPPar, MPResult};
use serde_json::json;
use std::f64::consts::{FRAC_1_PI, FRAC_PI_2, PI};
use std::io::{Cursor, Write as _};
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{DateTime, ZipWriter};

/// The file without its pearl, the line of the pearl in it, and what an add-on says of itself.
const SCRIPT: &str = include_str!("../../blender/pearl.py");
const EMPTY: &str = "PEARL = r\"\"\"{}\"\"\"";
const MANIFEST: &str = include_str!("../../blender/blender_manifest.toml");

/// Beckmann lobes, of which the last are pairs, and numbers of each: logarithms of both roughnesses, tilt, turn.
const LOBES: usize = SINGLE + PAIRS;
const SINGLE: usize = 4;
const PAIRS: usize = 2;
const NUMBERS: usize = 4;
/// Ends of the ramps about the normal, degrees.
const EDGES_DEG: [f64; RAMPS + 1] = [0.0, 18.0, 32.0, 45.0, 57.0, 68.0, 79.0, 90.0];
const RAMPS: usize = 7;
/// Reflections in all: lobes, diffuse, ramps.
const BASIS: usize = LOBES + 1 + RAMPS;
/// Viewing angles of the image, 0° to 90°.
const COLUMNS: usize = 181;
/// Viewing angles that lobes are fitted at, degrees: from, to and step.
const FITTED_DEG: [[f64; 3]; 2] = [[0.0, 75.0, 5.0], [75.0, 90.0, 1.5]];
/// Directions that lobes are fitted at, and that they are weighted at.
const FITTED: u32 = 400;
const WEIGHTED: u32 = 2048;
/// As for the three lobes: differences count over the root of the lobe plus this share of its peak.
const FLOOR: f64 = 0.01;
/// Roughnesses to start from, over that of interface 0.
const STARTS: [[f64; LOBES]; 3] =
    [[1.0, 1.0, 2.5, 5.0, 2.5, 5.0], [1.0, 1.0, 1.5, 2.5, 1.5, 2.5], [1.0, 1.5, 2.5, 5.0, 1.5, 3.0]];
/// Tilts to start from, over that roughness: two lobes share the peak, each with its colour.
const START_TILTS: [f64; LOBES] = [0.4, -0.4, 0.0, 0.0, 0.0, 0.0];
/// Lobes are no narrower than this share of interface 0's, so that none hides between the directions compared.
const LEAST_ROUGHNESS: f64 = 0.7;
const MOST_TILT: f64 = 1.2;
/// Turns to start from, and the largest.
const START_TURNS: [f64; LOBES] = [0.0, 0.0, 0.0, 0.0, 0.1, 0.25];
const MOST_TURN: f64 = 0.8;
/// How much numbers that hardly matter are pulled to where they start, so that they do not wander from angle to angle.
const PULL: f64 = 3e-3;
/// A reflection that sends less than this share of its light above the horizon has no weight: a renderer would look for that light
/// in vain most of the time, and find sparks.
const LEAST_LIGHT: f64 = 0.25;
/// A correction of the albedo is never more than this.
const MOST_CORRECTION: f64 = 1.1;
const CONFIG: MPConfig = MPConfig { ftol: 1e-7, xtol: 1e-6, epsfcn: 1e-10, max_iter: 40, ..MPConfig::new() };

/// What shapes are fitted to at once.
const TARGETS: usize = 4;

type Shapes = [f64; LOBES * NUMBERS];
type Rgb = [f64; 3];

/// All that the image holds, and where.
#[derive(Clone, Debug)]
pub(super) struct Curves {
    /// First row of each curve.
    rows: Rows,
    /// [`COLUMNS`] pixels a row, from the first row on.
    pixels: Vec<[f32; 3]>,
    scales: Vec<f64>,
    has_coherent: bool,
    has_emission: bool,
    controls: Controls,
    /// Light of the base over its directions, at these controls: diffuse and ramps, of all of it.
    base: [Rgb; 1 + RAMPS],
}

/// First rows. Curves that depend on the thickness have a row a scale.
#[derive(Clone, Copy, Debug, Default)]
struct Rows {
    shape: usize,
    turn: usize,
    plain: usize,
    plain_albedo: usize,
    modulated: usize,
    modulated_albedo: usize,
    emission: usize,
    count: usize,
}

impl Curves {
    /// Fits the pearl at every viewing angle, in seconds.
    pub(super) fn new(bsdf: &PearlBsdf) -> Result<Self, FieldError> {
        let plain = microfacet::plain_lobes(bsdf)?;
        let prepared = bsdf.prepared();
        let has = |controls: Controls| prepared.check(&controls).is_ok();
        let none = Controls { depth: 0.0, coherence: 0.0, ..Controls::default() };
        let has_coherent = has(Controls { coherence: 1.0, ..none });
        let has_emission = has(Controls { depth: 1.0, ..none });
        if !has_coherent && !has_emission {
            return Err(FieldError::new(
                "spectra",
                "are missing, expected interference colours; bake the recipe with effects coherent or emission",
            ));
        }
        let scales = prepared.scales.as_ref().map_or(vec![1.0], |scales| scales.scale.clone());
        let lobes = Components { mirror: true, blur: true, ..Components::NONE };
        let modulated = |scale: &f64| {
            let (coherence, depth) = (f64::from(u8::from(has_coherent)), f64::from(u8::from(has_emission)));
            let whole =
                Controls { brightness: 1.0, tint_rgb: [1.0; 3], body_rgb: [1.0; 3], ..*bsdf.controls() };
            let controls = Controls { coherence, depth, thickness: *scale, components: lobes, ..whole };
            PearlBsdf::new(prepared.clone(), controls)
        };
        let modulated: Vec<PearlBsdf> = scales
            .iter()
            .map(modulated)
            .collect::<Result<_, BsdfError>>()
            .map_err(|why| FieldError::new("look", why.to_string()))?;
        let own = scales.iter().position(|scale| *scale == 1.0).unwrap_or(0);
        let shapes = shapes(&plain, &modulated[own], bsdf.slope_sd());
        let columns: Vec<Column> = (0..COLUMNS)
            .into_par_iter()
            .map(|column| Column::new(column, &shapes, &plain, &modulated))
            .collect();
        let mut curves = Self {
            rows: Rows::default(),
            pixels: Vec::new(),
            scales,
            has_coherent,
            has_emission,
            controls: *bsdf.controls(),
            base: [[0.0; 3]; 1 + RAMPS],
        };
        curves.fill(&columns);
        curves.base = curves.base();
        Ok(curves)
    }

    fn fill(&mut self, columns: &[Column]) {
        let count = self.scales.len();
        let rows = &mut self.rows;
        rows.turn = LOBES;
        rows.plain = rows.turn + 1;
        rows.plain_albedo = rows.plain + BASIS;
        rows.modulated = rows.plain_albedo + 1;
        rows.modulated_albedo = rows.modulated + BASIS * count;
        rows.emission = rows.modulated_albedo + count;
        rows.count = rows.emission + count;
        let mut put = |of: &dyn Fn(&Column) -> Rgb| {
            self.pixels.extend(columns.iter().map(|column| of(column).map(|x| x as f32)));
        };
        (0..LOBES).for_each(|k| put(&|column| to_sockets(&column.shapes[k * NUMBERS..][..NUMBERS])));
        put(&|column| {
            [0, 1, 2].map(|k| if k < PAIRS { column.shapes[(SINGLE + k) * NUMBERS + 3] } else { 0.0 })
        });
        (0..BASIS).for_each(|b| put(&|column| column.plain.weights[b]));
        put(&|column| column.plain.albedo);
        for b in 0..BASIS {
            (0..count).for_each(|s| put(&|column| column.modulated[s].weights[b]));
        }
        (0..count).for_each(|s| put(&|column| column.modulated[s].albedo));
        (0..count).for_each(|s| put(&|column| column.emission[s]));
    }

    /// A pixel between columns.
    fn read(&self, row: usize, theta: f64) -> Rgb {
        let position = (theta / FRAC_PI_2).clamp(0.0, 1.0) * (COLUMNS - 1) as f64;
        let column = (position as usize).min(COLUMNS - 2);
        let share = position - column as f64;
        let [a, b] = [0, 1].map(|next| self.pixels[row * COLUMNS + column + next].map(f64::from));
        std::array::from_fn(|c| a[c] + share * (b[c] - a[c]))
    }

    /// The same of a curve that depends on the thickness.
    fn read_scaled(&self, first: usize, theta: f64) -> Rgb {
        let position = position_of_scale(&self.scales, self.controls.thickness);
        let below = (position as usize).min(self.scales.len().saturating_sub(2));
        let share = position - below as f64;
        let a = self.read(first + below, theta);
        let b = if share > 0.0 { self.read(first + below + 1, theta) } else { a };
        std::array::from_fn(|c| a[c] + share * (b[c] - a[c]))
    }

    /// brightness·mix(plain, tint·modulated, γ).
    fn shown(&self, plain: usize, modulated: usize, theta: f64) -> Rgb {
        let Controls { brightness, coherence, tint_rgb, .. } = self.controls;
        let (plain, modulated) = (self.read(plain, theta), self.read_scaled(modulated, theta));
        std::array::from_fn(|c| brightness * (plain[c] + coherence * (tint_rgb[c] * modulated[c] - plain[c])))
    }

    fn left(&self, theta: f64) -> Rgb {
        let albedo = self.shown(self.rows.plain_albedo, self.rows.modulated_albedo, theta);
        albedo.map(|albedo| (1.0 - albedo).max(0.0))
    }

    /// (1 − A(θo))·cos θo as so much diffuse light and so much of every ramp, of a sum of 1.
    fn base(&self) -> [Rgb; 1 + RAMPS] {
        let cosines: [f64; RAMPS + 1] =
            std::array::from_fn(|j| if j < RAMPS { EDGES_DEG[j].to_radians().cos() } else { 0.0 });
        let left: [Rgb; RAMPS] = std::array::from_fn(|j| self.left(EDGES_DEG[j].to_radians()));
        let mut base = [[0.0; 3]; 1 + RAMPS];
        for c in 0..3 {
            let light: [f64; RAMPS + 1] =
                std::array::from_fn(|j| if j < RAMPS { left[j][c] * cosines[j] } else { 0.0 });
            let drop = |j: usize| cosines[j] - cosines[j + 1];
            let slopes: [f64; RAMPS] = std::array::from_fn(|j| (light[j] - light[j + 1]) / drop(j));
            // As much diffuse light as leaves no ramp negative.
            let diffuse = slopes.iter().fold(f64::INFINITY, |least, slope| least.min(*slope)).max(0.0);
            base[0][c] = PI * diffuse;
            for j in 0..RAMPS {
                base[1 + j][c] = (slopes[j] - diffuse).max(0.0) * drop(j) * ramp_light(j);
            }
            let sum: f64 = base.iter().map(|rgb| rgb[c]).sum();
            base.iter_mut().for_each(|rgb| rgb[c] /= sum.max(1e-6));
        }
        base
    }

    /// f·cos θ of the light, linear sRGB.
    pub(super) fn eval(&self, view: Direction, light: Direction) -> Rgb {
        let theta = view[2].clamp(-1.0, 1.0).acos();
        let mut shapes = [0.0; LOBES * NUMBERS];
        let turns = self.read(self.rows.turn, theta);
        for (k, shape) in shapes.chunks_mut(NUMBERS).enumerate() {
            shape[..3].copy_from_slice(&from_sockets(self.read(self.rows.shape + k, theta)));
            shape[3] = if k < SINGLE { 0.0 } else { turns[k - SINGLE] };
        }
        let wo = in_plane(view, light);
        let Controls { depth, body_rgb, tint_rgb, .. } = self.controls;
        let emission = self.read_scaled(self.rows.emission, theta);
        let left = self.left(theta);
        let seen: Rgb = std::array::from_fn(|c| {
            left[c] * (body_rgb[c] * ((1.0 - depth) + depth * tint_rgb[c] * emission[c])).min(1.0)
        });
        let mut sum = [0.0; 3];
        for (b, reflection) in Reflection::all(&shapes, theta).into_iter().enumerate() {
            let count = self.scales.len();
            let weight = self.shown(self.rows.plain + b, self.rows.modulated + b * count, theta);
            for c in 0..3 {
                let base = if b < LOBES {
                    0.0
                } else {
                    // Of a ramp's own light.
                    let own =
                        if b == LOBES { 1.0 } else { ramp_light(b - LOBES - 1) * ramp_peak(b - LOBES - 1) };
                    seen[c] * self.base[b - LOBES][c] / own
                };
                sum[c] += (weight[c] + base) * reflection.towards(wo);
            }
        }
        sum
    }

    /// The file.
    pub(super) fn script(&self, name: &str) -> Result<Vec<u8>, FieldError> {
        let mut pixels = ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        let written = self.pixels.iter().flatten().try_for_each(|x| pixels.write_all(&x.to_le_bytes()));
        let pixels = written
            .and_then(|()| pixels.finish())
            .map_err(|why| FieldError::new("pixels", why.to_string()))?;
        let Controls { depth, brightness, coherence, body_rgb, tint_rgb, thickness, .. } = self.controls;
        let Rows { shape, turn, plain, plain_albedo, modulated, modulated_albedo, emission, count } =
            self.rows;
        let pearl = json!({
            "schema": "pearl-blender/1",
            "name": name,
            "width": COLUMNS,
            "height": count,
            "lobes": LOBES,
            "pairs": PAIRS,
            "edges_deg": EDGES_DEG,
            "scales": self.scales,
            "coherent": self.has_coherent,
            "emission": self.has_emission,
            "rows": {
                "shape": shape, "turn": turn, "plain": plain, "plain_albedo": plain_albedo, "modulated": modulated,
                "modulated_albedo": modulated_albedo, "emission": emission,
            },
            "look": {
                "depth": depth, "brightness": brightness, "coherence": coherence, "body_rgb": body_rgb,
                "tint_rgb": tint_rgb, "thickness": thickness,
            },
            "pixels": base64::engine::general_purpose::STANDARD.encode(pixels),
        });
        Ok(SCRIPT.replace(EMPTY, &format!("PEARL = r\"\"\"{pearl}\"\"\"")).into_bytes())
    }
}

/// An add-on that holds the file.
pub(super) fn add_on(script: &[u8]) -> ZipResult<Vec<u8>> {
    let options = SimpleFileOptions::default().last_modified_time(DateTime::default());
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let manifest = MANIFEST.replace("VERSION", env!("CARGO_PKG_VERSION"));
    for (name, bytes) in [("__init__.py", script), ("blender_manifest.toml", manifest.as_bytes())] {
        archive.start_file(name, options)?;
        archive.write_all(bytes)?;
    }
    Ok(archive.finish()?.into_inner())
}

/// Place of a scale among those stored; ratios are equal below 1 and above it.
fn position_of_scale(scales: &[f64], scale: f64) -> f64 {
    let one = scales.iter().position(|s| *s == 1.0).unwrap_or(0) as f64;
    let [first, last] = [scales[0], scales[scales.len() - 1]].map(f64::ln);
    let log = scale.ln();
    let below = if first < 0.0 { one * log.clamp(first, 0.0) / -first } else { 0.0 };
    let steps = scales.len() as f64 - 1.0 - one;
    let above = if last > 0.0 { steps * log.clamp(0.0, last) / last } else { 0.0 };
    one + below + above
}

/// f·cos θo of a ramp of colour 1 at its top, as Cycles has it.
fn ramp_peak(j: usize) -> f64 {
    0.5 * FRAC_1_PI / (1.0 - EDGES_DEG[j + 1].to_radians().cos())
}

/// ∫ of a ramp from 1 down to 0 over the hemisphere.
fn ramp_light(j: usize) -> f64 {
    let [a, b] = [EDGES_DEG[j], EDGES_DEG[j + 1]].map(f64::to_radians);
    // 2π[∫₀ᵃ sin θ dθ + ∫ₐᵇ (b − θ)/(b − a)·sin θ dθ].
    2.0 * PI * (1.0 - (b.sin() - a.sin()) / (b - a))
}

/// What every reflection sends back at colour 1, of a view in the plane of x and z.
#[derive(Clone, Copy, Debug)]
enum Reflection {
    Lobe(Beckmann),
    Pair([Beckmann; 2]),
    Diffuse,
    /// Its light at the top, where it begins to fall and where it ends, radians.
    Ramp(f64, [f64; 2]),
}

impl Reflection {
    fn all(shapes: &Shapes, theta: f64) -> [Self; BASIS] {
        std::array::from_fn(|b| Self::new(b, shapes, theta))
    }

    fn new(b: usize, shapes: &Shapes, theta: f64) -> Self {
        if let Some(shape) = shapes.get(b * NUMBERS..(b + 1) * NUMBERS) {
            let wi = [theta.sin(), 0.0, theta.cos()];
            let about = |turn: f64| Beckmann::new(wi, [shape[0].exp(), shape[1].exp()], [shape[2], turn]);
            let turn = shape[3];
            return if b < SINGLE { Self::Lobe(about(0.0)) } else { Self::Pair([turn, -turn].map(about)) };
        }
        let Some(j) = b.checked_sub(LOBES + 1) else { return Self::Diffuse };
        Self::Ramp(ramp_peak(j), [EDGES_DEG[j], EDGES_DEG[j + 1]].map(f64::to_radians))
    }

    /// f·cos θo.
    fn towards(&self, wo: Direction) -> f64 {
        if wo[2] <= 0.0 {
            return 0.0;
        }
        match self {
            Self::Lobe(lobe) => lobe.towards(wo),
            Self::Pair(lobes) => 0.5 * lobes.iter().map(|lobe| lobe.towards(wo)).sum::<f64>(),
            Self::Diffuse => wo[2] * FRAC_1_PI,
            Self::Ramp(peak, [from, to]) => {
                peak * ((to - wo[2].min(1.0).acos()) / (to - from)).clamp(0.0, 1.0)
            }
        }
    }
}

/// Roughness and anisotropy of Blender's sockets, and the tilt.
fn to_sockets(shape: &[f64]) -> Rgb {
    // The roughnesses of the closure are r²·(1 − a) and r²/(1 − a), or r²/(1 + a) and r²·(1 + a) for a < 0.
    let ratio = (0.5 * (shape[0] - shape[1])).exp();
    let anisotropy = if ratio < 1.0 { 1.0 - ratio } else { 1.0 / ratio - 1.0 };
    [(0.25 * (shape[0] + shape[1])).exp(), anisotropy, shape[2]]
}

fn from_sockets([roughness, anisotropy, tilt]: Rgb) -> [f64; 3] {
    let log = 2.0 * roughness.max(1e-6).ln();
    let ratio = if anisotropy < 0.0 { -(1.0 + anisotropy).ln() } else { (1.0 - anisotropy).ln() };
    [log + ratio, log - ratio, tilt]
}

/// One viewing angle.
#[derive(Clone, Debug)]
struct Column {
    shapes: Shapes,
    plain: Weighted,
    /// By scale.
    modulated: Vec<Weighted>,
    emission: Vec<Rgb>,
}

/// Weights of all reflections, and the albedo that they make up.
#[derive(Clone, Copy, Debug)]
struct Weighted {
    weights: [Rgb; BASIS],
    albedo: Rgb,
}

impl Column {
    fn new(column: usize, fitted: &Fitted, plain: &PearlBsdf, modulated: &[PearlBsdf]) -> Self {
        let theta = (column as f64 / (COLUMNS - 1) as f64 * FRAC_PI_2).min(FRAC_PI_2 - 2e-3);
        let shapes = fitted.at(theta);
        let points = directions(plain, theta, WEIGHTED);
        let columns = Columns::new(&points, &shapes, theta);
        let wi = [theta.sin(), 0.0, theta.cos()];
        let of = |bsdf: &PearlBsdf| {
            let [left, _] = bsdf.left_and_emission(theta.cos());
            let values: Vec<Rgb> = points.iter().map(|point| bsdf.eval_seen(wi, point.wo).rgb()).collect();
            columns.weighted(&points, &values, left.map(|left| 1.0 - left))
        };
        Self {
            shapes,
            plain: of(plain),
            modulated: modulated.iter().map(of).collect(),
            emission: modulated.iter().map(|bsdf| bsdf.left_and_emission(theta.cos())[1]).collect(),
        }
    }
}

/// The reflections at the points of a viewing angle, ready for least squares.
#[derive(Clone, Debug)]
struct Columns {
    shapes: Shapes,
    values: Vec<[f64; BASIS]>,
    scales: Vec<f64>,
    solid_angles: Vec<f64>,
    /// What each sends above the horizon at weight 1.
    light: [f64; BASIS],
    gram: [[f64; BASIS]; BASIS],
}

impl Columns {
    fn new(points: &[Point], shapes: &Shapes, theta: f64) -> Self {
        let peak = points.iter().map(|point| point.value).fold(f64::MIN_POSITIVE, f64::max);
        let reflections = Reflection::all(shapes, theta);
        let towards = |point: &Point| reflections.map(|reflection| reflection.towards(point.wo));
        let values: Vec<[f64; BASIS]> = points.iter().map(towards).collect();
        let scales: Vec<f64> =
            points.iter().map(|point| point.solid_angle / (point.value + FLOOR * peak)).collect();
        let solid_angles = points.iter().map(|point| point.solid_angle).collect();
        let (light, gram) = ([0.0; BASIS], [[0.0; BASIS]; BASIS]);
        let mut columns = Self { shapes: *shapes, values, scales, solid_angles, light, gram };
        (0..BASIS).for_each(|b| columns.multiply(b));
        columns
    }

    /// Light of a reflection, and its products with all.
    fn multiply(&mut self, b: usize) {
        let mut products = [0.0; BASIS];
        for (row, scale) in self.values.iter().zip(&self.scales) {
            let scaled = scale * row[b];
            products.iter_mut().zip(row).for_each(|(product, value)| *product += scaled * value);
        }
        self.light[b] =
            self.values.iter().zip(&self.solid_angles).map(|(row, solid_angle)| solid_angle * row[b]).sum();
        for (j, product) in products.into_iter().enumerate() {
            (self.gram[b][j], self.gram[j][b]) = (product, product);
        }
    }

    /// With other shapes, of which most are as before.
    fn reshape(&mut self, points: &[Point], shapes: &Shapes, theta: f64) {
        for b in 0..LOBES {
            let numbers = b * NUMBERS..(b + 1) * NUMBERS;
            if self.shapes[numbers.clone()] != shapes[numbers] {
                let reflection = Reflection::new(b, shapes, theta);
                for (row, point) in self.values.iter_mut().zip(points) {
                    row[b] = reflection.towards(point.wo);
                }
                self.multiply(b);
            }
        }
        self.shapes = *shapes;
    }

    /// Weights that come nearest to values at the points.
    fn weights(&self, target: impl Fn(usize) -> f64) -> [f64; BASIS] {
        let mut moments = [0.0; BASIS];
        for (k, (row, scale)) in self.values.iter().zip(&self.scales).enumerate() {
            let scaled = scale * target(k);
            moments.iter_mut().zip(row).for_each(|(moment, value)| *moment += scaled * value);
        }
        // What nothing pulls up is held at 0.
        for (moment, light) in moments.iter_mut().zip(self.light) {
            *moment = if light < LEAST_LIGHT { 0.0 } else { *moment };
        }
        nonnegative::solve(&self.gram, &moments)
    }

    fn weighted(&self, points: &[Point], values: &[Rgb], albedo: Rgb) -> Weighted {
        let mut weights = [[0.0; 3]; BASIS];
        for c in 0..3 {
            let fitted = self.weights(|k| values[k][c]);
            let (mut light, mut found) = (0.0, 0.0);
            for ((point, value), row) in points.iter().zip(values).zip(&self.values) {
                light += point.solid_angle * value[c];
                found += point.solid_angle * row.iter().zip(&fitted).map(|(a, b)| a * b).sum::<f64>();
            }
            let correction = if found > 0.0 { light / found } else { 1.0 };
            let correction = correction.clamp(1.0 / MOST_CORRECTION, MOST_CORRECTION);
            (0..BASIS).for_each(|b| weights[b][c] = correction * fitted[b]);
        }
        Weighted { weights, albedo }
    }
}

/// Directions that the table's lobes are drawn from, and every fourth from the whole hemisphere: what is dark counts, too.
fn directions(plain: &PearlBsdf, theta: f64, count: u32) -> Vec<Point> {
    let wi = [theta.sin(), 0.0, theta.cos()];
    let of = |n: u32| {
        let [u, v, w] = point(n);
        let wo = if n.is_multiple_of(4) {
            let ((sin, cos), radius) = ((2.0 * PI * v).sin_cos(), u.sqrt());
            [radius * cos, radius * sin, (1.0 - u).sqrt()]
        } else {
            plain.sample(wi, u, v, w)?.wo
        };
        let density = 0.75 * plain.pdf(wi, wo) + 0.25 * wo[2] * FRAC_1_PI;
        let value = plain.eval_seen(wi, wo).rgb()[1];
        Some(Point { wo, value, solid_angle: 1.0 / (density * f64::from(count)) })
    };
    (0..count).filter_map(of).collect()
}

/// Shapes of the lobes at viewing angles.
struct Fitted(Vec<(f64, Shapes)>);

impl Fitted {
    fn at(&self, theta: f64) -> Shapes {
        let above = self.0.partition_point(|(node, _)| *node <= theta);
        let [a, b] = [above.saturating_sub(1), above.min(self.0.len() - 1)].map(|i| &self.0[i]);
        let share = if b.0 > a.0 { (theta - a.0) / (b.0 - a.0) } else { 0.0 };
        std::array::from_fn(|i| a.1[i] + share * (b.1[i] - a.1[i]))
    }
}

/// Each angle starts from the fit of the angle before, so that shapes are smooth from one to the next. Of several starts at normal
/// incidence the one is taken that comes nearest over all angles.
fn shapes(plain: &PearlBsdf, modulated: &PearlBsdf, slope_sd: f64) -> Fitted {
    let points = |theta: f64| {
        let points = directions(plain, theta, FITTED);
        let wi = [theta.sin(), 0.0, theta.cos()];
        let coloured = |point: &Point| {
            let [red, green, blue] = modulated.eval_seen(wi, point.wo).rgb();
            [point.value, red, green, blue]
        };
        let values = points.iter().map(coloured).collect();
        (theta, points, values)
    };
    let angles = FITTED_DEG.iter().flat_map(|[from, to, step]| {
        (0..((to - from) / step).round() as usize).map(move |i| (from + step * i as f64).to_radians())
    });
    let problems: Vec<(f64, Vec<Point>, Vec<[f64; TARGETS]>)> =
        angles.collect::<Vec<_>>().into_par_iter().map(points).collect();
    let fits: Vec<Fit> = problems
        .into_iter()
        .map(|(theta, points, values)| Fit::new(theta, points, values, slope_sd))
        .collect();
    let chains = STARTS.par_iter().map(|roughnesses| {
        let (mut last, mut pull, mut left) = (started(roughnesses, slope_sd), 0.0, 0.0);
        let along = fits.iter().map(|fit| {
            let (squares, shapes) = fit.from(last, pull);
            (last, pull) = (shapes, PULL);
            left += squares / fit.light();
            (fit.theta, shapes)
        });
        let along: Vec<(f64, Shapes)> = along.collect();
        (left, along)
    });
    let best = chains.min_by(|a, b| a.0.total_cmp(&b.0));
    Fitted(best.map(|(_, fitted)| fitted).unwrap_or_default())
}

/// Lobes to start from at normal incidence.
fn started(roughnesses: &[f64; LOBES], slope_sd: f64) -> Shapes {
    let mut start = [0.0; LOBES * NUMBERS];
    for (k, (shape, roughness)) in start.chunks_mut(NUMBERS).zip(roughnesses).enumerate() {
        let log = log_roughness(*roughness, slope_sd);
        shape.copy_from_slice(&[log, log, START_TILTS[k] * log.exp(), START_TURNS[k]]);
    }
    start
}

/// The logarithm of so many times the roughness of interface 0.
fn log_roughness(times: f64, slope_sd: f64) -> f64 {
    // Slopes of standard deviation σ have Beckmann's α = √2·σ.
    (times * 2f64.sqrt() * slope_sd.max(1e-3)).ln().min(-1e-3)
}

/// Lobes at one viewing angle, and what their numbers are kept to.
struct Fit {
    theta: f64,
    points: Vec<Point>,
    /// The lobe without colours, and each channel of it with those of full coherence.
    values: Vec<[f64; TARGETS]>,
    limits: Vec<MPPar>,
}

impl Fit {
    fn new(theta: f64, points: Vec<Point>, values: Vec<[f64; TARGETS]>, slope_sd: f64) -> Self {
        let roughness = [log_roughness(LEAST_ROUGHNESS, slope_sd), 0.0];
        // The view stays above the horizon of a tilted lobe.
        let most = (0.8 * (FRAC_PI_2 - theta)).min(MOST_TILT);
        let limits = [roughness, roughness, [-MOST_TILT, most], [0.0, MOST_TURN]].map(bounded);
        let of = |k: usize| {
            limits.iter().enumerate().map(move |(n, limit)| {
                let fixed = k < SINGLE && n == 3;
                MPPar { fixed, ..*limit }
            })
        };
        Self { theta, points, values, limits: (0..LOBES).flat_map(of).collect() }
    }

    /// The squares of the lobe without colours: what those that are left count against.
    fn light(&self) -> f64 {
        let columns = Columns::new(&self.points, &[0.0; LOBES * NUMBERS], self.theta);
        let squares =
            self.values.iter().zip(&columns.scales).map(|(values, scale)| scale * values[0] * values[0]);
        squares.sum::<f64>().max(f64::MIN_POSITIVE)
    }

    /// The fit from a start, and how much of the squares is left; the start itself where there is none.
    fn from(&self, start: Shapes, pull: f64) -> (f64, Shapes) {
        let mut shapes = start;
        for (shape, limit) in shapes.iter_mut().zip(&self.limits) {
            *shape = shape.clamp(limit.limit_low, limit.limit_up);
        }
        let start = shapes;
        let columns = Columns::new(&self.points, &start, self.theta);
        match (Sought { fit: self, columns, start, pull }).mpfit(&mut shapes) {
            Ok(status) if shapes.iter().all(|x| x.is_finite()) => (status.best_norm, shapes),
            _ => (f64::INFINITY, start),
        }
    }
}

/// A fit as the library asks for it: shapes are what is sought, weights follow from them.
struct Sought<'a> {
    fit: &'a Fit,
    columns: Columns,
    start: Shapes,
    pull: f64,
}

impl MPFitter for Sought<'_> {
    fn eval(&mut self, parameters: &[f64], deviates: &mut [f64]) -> MPResult<()> {
        let Fit { theta, points, values, .. } = self.fit;
        let shapes: Shapes = std::array::from_fn(|i| parameters[i]);
        self.columns.reshape(points, &shapes, *theta);
        let columns = &self.columns;
        let (apart, pulled) = deviates.split_at_mut(TARGETS * points.len());
        for (target, apart) in apart.chunks_mut(points.len()).enumerate() {
            let weights = columns.weights(|k| values[k][target]);
            for (k, deviate) in apart.iter_mut().enumerate() {
                let found: f64 = columns.values[k].iter().zip(&weights).map(|(a, b)| a * b).sum();
                *deviate = (found - values[k][target]) * columns.scales[k].sqrt();
            }
        }
        for (deviate, (now, start)) in pulled.iter_mut().zip(shapes.iter().zip(&self.start)) {
            *deviate = self.pull * (now - start);
        }
        Ok(())
    }

    fn number_of_points(&self) -> usize {
        TARGETS * self.fit.points.len() + LOBES * NUMBERS
    }

    fn parameters(&self) -> &[MPPar] {
        &self.fit.limits
    }

    fn config(&self) -> &MPConfig {
        static SETTLED: MPConfig = CONFIG;
        &SETTLED
    }
}
