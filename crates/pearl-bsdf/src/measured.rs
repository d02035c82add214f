//! The pearl in the adaptive parameterisation of Dupuy and Jakob (2018): what Mitsuba's `measured` and pbrt-v4 read.
//!
//! A pair of directions becomes wi and the half vector m; the unit square of m, (u(θ), u(φ)) = (√(2θ/π), (φ + π)/2π), is
//! warped by the density `vndf` of each stored incidence, and `rgb` or `spectra` hold f·cos θo·4σ/D at equal steps of the
//! warped square. All three factors of the format are free: D (`ndf`) and 4σ (`sigma`) are 1, so that no quotient of a
//! narrow facet density has to be interpolated; `vndf` is a power of the light, which puts nodes where light is and
//! leaves some to the tails; `luminance` is what sampling by `vndf` leaves. Read back here as Mitsuba does, so that the
//! error of a file is known from the file.
//!
//! wi looks at the surface and light arrives from wo: [`PearlBsdf::eval_seen`].

use crate::{Direction, PearlBsdf};
use lut_io::Flaw;
use lut_io::tensor_file::{Field, Values};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Incidences: every 2° up to 60°, from there to 89.9° with cos θ in equal ratios. In half vectors the width of a lobe across
/// the plane of incidence goes with 1/cos θ: steps of 1° miss 5 % at 85.5°.
const STEEP_DEG: f64 = 60.0;
const STEEP_STEPS: usize = 30;
const GRAZING_STEPS: usize = 70;
/// Stands in for 90°, where no light arrives.
const GRAZING_DEG: f64 = 89.9;
/// Nodes of `vndf` over φ and θ.
const VNDF_NODES: [usize; 2] = [128, 96];
/// Nodes on either side of the warped square.
const RGB_NODES: usize = 64;
const SPECTRAL_NODES: usize = 48;
/// `vndf` is this power of the light per area of the unit square: 1 leaves the tails without nodes (0.55 % at normal
/// incidence against 0.14 %).
const POWER: f64 = 0.35;
/// Share of `vndf` that covers all half vectors alike, so that none is out of reach.
const FLOOR: f64 = 0.05;

/// What the values of a file are.
#[derive(Clone, Debug, PartialEq)]
pub enum Channels {
    /// Linear sRGB, for RGB renderers.
    Rgb,
    /// f·cos θ at wavelengths in nm, for spectral renderers.
    Spectral(Vec<f64>),
}

impl Channels {
    fn count(&self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Spectral(wavelengths) => wavelengths.len(),
        }
    }

    fn nodes(&self) -> usize {
        match self {
            Self::Rgb => RGB_NODES,
            Self::Spectral(_) => SPECTRAL_NODES,
        }
    }

    /// f·cos θo of every channel.
    fn of(&self, bsdf: &PearlBsdf, wi: Direction, wo: Direction) -> Vec<f64> {
        match self {
            Self::Rgb => bsdf.eval_seen(wi, wo).rgb().to_vec(),
            Self::Spectral(nm) => nm.iter().map(|nm| bsdf.eval_seen_at(wi, wo, *nm).iter().sum()).collect(),
        }
    }
}

/// The fields of a `.bsdf` file of this BSDF.
#[must_use]
pub fn fields(bsdf: &PearlBsdf, channels: &Channels, description: &str) -> Vec<Field> {
    let nodes = channels.nodes();
    let theta_i = incidences();
    let slices: Vec<Slice> =
        theta_i.par_iter().map(|theta| Slice::new(bsdf, channels, *theta, nodes)).collect();
    let gather = |part: fn(&Slice) -> &Vec<f32>| -> Vec<f32> {
        slices.iter().flat_map(|slice| part(slice).iter().copied()).collect()
    };
    let [rows, columns] = VNDF_NODES;
    let (count, slices) = (channels.count(), theta_i.len());
    let mut fields = vec![
        Field::u8("description", description.as_bytes()),
        Field::u8("jacobian", &[1]),
        Field::f32("phi_i", &[1], vec![0.0]),
        Field::f32("theta_i", &[slices], theta_i.iter().map(|theta| *theta as f32).collect()),
        Field::f32("ndf", &[2, 2], vec![1.0; 4]),
        Field::f32("sigma", &[2, 2], vec![0.25; 4]),
        Field::f32("vndf", &[1, slices, rows, columns], gather(|slice| &slice.vndf)),
        Field::f32("luminance", &[1, slices, nodes, nodes], gather(|slice| &slice.luminance)),
    ];
    let values = gather(|slice| &slice.values);
    match channels {
        Channels::Rgb => fields.push(Field::f32("rgb", &[1, slices, count, nodes, nodes], values)),
        Channels::Spectral(nm) => {
            fields.push(Field::f32("spectra", &[1, slices, count, nodes, nodes], values));
            fields.push(Field::f32("wavelengths", &[count], nm.iter().map(|nm| *nm as f32).collect()));
        }
    }
    fields
}

/// Stored angles of incidence, radians.
fn incidences() -> Vec<f64> {
    let (steep, grazing) = (STEEP_DEG.to_radians(), GRAZING_DEG.to_radians());
    let ratio = (grazing.cos() / steep.cos()).powf(1.0 / GRAZING_STEPS as f64);
    let lower = (0..STEEP_STEPS).map(|i| steep * i as f64 / STEEP_STEPS as f64);
    lower.chain((0..=GRAZING_STEPS).map(|i| (steep.cos() * ratio.powi(i as i32)).acos())).collect()
}

/// What one incidence contributes.
struct Slice {
    vndf: Vec<f32>,
    luminance: Vec<f32>,
    values: Vec<f32>,
}

impl Slice {
    fn new(bsdf: &PearlBsdf, channels: &Channels, theta_i: f64, nodes: usize) -> Self {
        let wi = [theta_i.sin(), 0.0, theta_i.cos()];
        let mean = |m: Direction| {
            let rgb = bsdf.eval_seen(wi, reflect(wi, m)).rgb();
            rgb.iter().sum::<f64>() / 3.0 * 4.0 * dot(wi, m).max(0.0)
        };
        let [rows, columns] = VNDF_NODES;
        let (mut lobe, mut floor) = (vec![0.0; rows * columns], vec![0.0; rows * columns]);
        for row in 0..rows {
            for column in 0..columns {
                let (u, v) = (node(column, columns), node(row, rows));
                let m = half_vector(u, v);
                lobe[row * columns + column] = (mean(m) * area(u)).powf(POWER);
                floor[row * columns + column] = area(u);
            }
        }
        // The column θm = 0 has no area; a little keeps the warp invertible there.
        let (most_lobe, most_floor) = (sum(&lobe), sum(&floor));
        let least = 1e-4 / (rows * columns) as f64;
        let vndf: Vec<f32> = (lobe.iter().zip(&floor))
            .map(|(l, f)| {
                let lobe = if most_lobe > 0.0 { l / most_lobe } else { 0.0 };
                (((1.0 - FLOOR) * lobe + FLOOR * f / most_floor + least) * (rows * columns) as f64) as f32
            })
            .collect();
        let warp = Warp::new(&vndf, rows, columns);
        let mut luminance = Vec::with_capacity(nodes * nodes);
        let mut values = vec![0.0; channels.count() * nodes * nodes];
        for row in 0..nodes {
            for column in 0..nodes {
                let ([u, v], density) = warp.sample(node(column, nodes), node(row, nodes));
                let m = half_vector(u, v);
                let wo = above_horizon(reflect(wi, m), m);
                luminance.push(((mean(m) * area(u) / density).max(0.0) + 1e-4) as f32);
                for (channel, value) in channels.of(bsdf, wi, wo).into_iter().enumerate() {
                    values[(channel * nodes + row) * nodes + column] = value as f32;
                }
            }
        }
        Self { vndf, luminance, values }
    }
}

/// What Mitsuba's `measured` makes of the fields of an isotropic file.
#[derive(Debug)]
pub struct Reader {
    theta_i: Vec<f64>,
    ndf: Vec<f64>,
    sigma: Vec<f64>,
    warps: Vec<Warp>,
    channels: usize,
    nodes: usize,
    values: Vec<f32>,
    /// Wavelengths of the channels, nm; empty for RGB.
    pub wavelengths_nm: Vec<f64>,
}

impl Reader {
    /// From the fields of a file with one φi.
    ///
    /// # Errors
    /// A field that is missing or of another shape.
    pub fn new(fields: &[Field]) -> Result<Self, Flaw> {
        let field = |name: &str, dimensions: usize| {
            let found = fields.iter().find(|field| field.name == name);
            let field = found.ok_or_else(|| Flaw::new(name, "is missing"))?;
            match &field.values {
                Values::F32(values) if field.shape.len() == dimensions && !values.is_empty() => {
                    Ok((field.shape.as_slice(), values))
                }
                _ => Err(Flaw::new(
                    name,
                    format!("has the shape {:?}, expected {dimensions} dimensions of f32", field.shape),
                )),
            }
        };
        let doubles = |values: &[f32]| values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
        let (phi_i, _) = field("phi_i", 1)?;
        if phi_i != [1] {
            return Err(Flaw::new(
                "phi_i",
                format!("has {phi_i:?} entries, expected 1: an isotropic material"),
            ));
        }
        let (_, theta_i) = field("theta_i", 1)?;
        let wavelengths_nm = match fields.iter().any(|field| field.name == "wavelengths") {
            true => doubles(field("wavelengths", 1)?.1),
            false => Vec::new(),
        };
        let (shape, values) = field(if wavelengths_nm.is_empty() { "rgb" } else { "spectra" }, 5)?;
        let (vndf_shape, vndf) = field("vndf", 4)?;
        let first_row = |name: &str| -> Result<Vec<f64>, Flaw> {
            let (shape, values) = field(name, 2)?;
            Ok(doubles(&values[..shape[1]]))
        };
        let fits = shape[0] == 1
            && vndf_shape[0] == 1
            && shape[1] == theta_i.len()
            && vndf_shape[1] == theta_i.len()
            && shape[3] == shape[4]
            && shape[3] >= 2
            && vndf_shape[2].min(vndf_shape[3]) >= 2;
        if !fits {
            let problem =
                format!("{vndf_shape:?} and values of {shape:?} do not fit {} incidences", theta_i.len());
            return Err(Flaw::new("vndf", problem));
        }
        let [rows, columns] = [vndf_shape[2], vndf_shape[3]];
        let warps = vndf.chunks(rows * columns).map(|slice| Warp::new(slice, rows, columns)).collect();
        Ok(Self {
            theta_i: doubles(theta_i),
            ndf: first_row("ndf")?,
            sigma: first_row("sigma")?,
            warps,
            channels: shape[2],
            nodes: shape[3],
            values: values.clone(),
            wavelengths_nm,
        })
    }

    /// f·cos θo of every channel, 1/sr.
    #[must_use]
    pub fn eval(&self, wi: Direction, wo: Direction) -> Vec<f64> {
        if !(wi[2] > 0.0 && wo[2] > 0.0) {
            return vec![0.0; self.channels];
        }
        let sum: Direction = std::array::from_fn(|i| wi[i] + wo[i]);
        let m = sum.map(|x| x / dot(sum, sum).sqrt());
        let u_m = u_of(m[2].min(1.0).acos());
        let phi = m[1].atan2(m[0]) - wi[1].atan2(wi[0]);
        let v = ((phi + PI) / TAU).rem_euclid(1.0);
        let theta = wi[2].min(1.0).acos();
        let last = self.theta_i.len() - 1;
        let above = self.theta_i.partition_point(|node| *node <= theta).clamp(1, last.max(1));
        let (lo, hi) = ((above - 1).min(last), above.min(last));
        let span = self.theta_i[hi] - self.theta_i[lo];
        let t = if span > 0.0 { ((theta - self.theta_i[lo]) / span).clamp(0.0, 1.0) } else { 0.0 };
        let s = Warp::invert_between(&self.warps[lo], &self.warps[hi], t, u_m, v);
        let factor = linear(&self.ndf, u_m) / (4.0 * linear(&self.sigma, u_of(theta)));
        (0..self.channels)
            .map(|channel| {
                let at = |slice: usize| self.read(slice, channel, s);
                factor * ((1.0 - t) * at(lo) + t * at(hi))
            })
            .collect()
    }

    fn read(&self, slice: usize, channel: usize, [x, y]: [f64; 2]) -> f64 {
        let n = self.nodes;
        let start = (slice * self.channels + channel) * n * n;
        let (column, tx) = cell(x, n);
        let (row, ty) = cell(y, n);
        let at = |row: usize, column: usize| f64::from(self.values[start + row * n + column]);
        let lerp = |row: usize| (1.0 - tx) * at(row, column) + tx * at(row, column + 1);
        (1.0 - ty) * lerp(row) + ty * lerp(row + 1)
    }
}

/// The continuous bilinear warp of one slice: marginal over rows (φ), conditional over columns (θ).
#[derive(Debug)]
struct Warp {
    rows: usize,
    columns: usize,
    /// Density on the unit square.
    density: Vec<f64>,
    /// Integral of each row up to each node, in units of a cell.
    conditional: Vec<f64>,
    /// Integral over the rows up to each.
    marginal: Vec<f64>,
}

impl Warp {
    fn new(values: &[f32], rows: usize, columns: usize) -> Self {
        let mut density: Vec<f64> = values.iter().map(|x| f64::from(*x)).collect();
        let cells = ((rows - 1) * (columns - 1)) as f64;
        let integrals = |density: &[f64]| -> (Vec<f64>, Vec<f64>) {
            let conditional: Vec<f64> = density.chunks(columns).flat_map(cumulate).collect();
            let totals: Vec<f64> = conditional.chunks(columns).map(|row| row[columns - 1]).collect();
            (conditional, cumulate(&totals))
        };
        let total = integrals(&density).1[rows - 1];
        density.iter_mut().for_each(|x| *x *= cells / total);
        let (conditional, marginal) = integrals(&density);
        let scaled = |values: Vec<f64>| values.into_iter().map(|x| x / cells).collect();
        Self { rows, columns, density, conditional: scaled(conditional), marginal: scaled(marginal) }
    }

    /// The point (θ, φ coordinate) at (x, y) of the warped square, and the density there.
    fn sample(&self, x: f64, y: f64) -> ([f64; 2], f64) {
        let last = self.columns - 1;
        let row = self.marginal.partition_point(|m| *m <= y).clamp(1, self.rows - 1) - 1;
        let total = |row: usize| self.conditional[row * self.columns + last];
        let ty = invert_linear(total(row), total(row + 1), y - self.marginal[row]);
        let mix = |values: &[f64], column: usize| {
            let at = |row: usize| values[row * self.columns + column];
            (1.0 - ty) * at(row) + ty * at(row + 1)
        };
        let target = x * mix(&self.conditional, last);
        let column = (1..last).find(|c| mix(&self.conditional, *c) > target).unwrap_or(last) - 1;
        let cells = ((self.rows - 1) * last) as f64;
        let (a, b) = (mix(&self.density, column), mix(&self.density, column + 1));
        let tx = invert_linear(a / cells, b / cells, target - mix(&self.conditional, column));
        let density = (1.0 - tx) * a + tx * b;
        ([(column as f64 + tx) / last as f64, (row as f64 + ty) / (self.rows - 1) as f64], density)
    }

    /// The place in the warped square of a point, of the mixture (1 − t, t) of two slices.
    fn invert_between(a: &Self, b: &Self, t: f64, u: f64, v: f64) -> [f64; 2] {
        let (columns, last) = (a.columns, a.columns - 1);
        let ((column, tx), (row, ty)) = (cell(u, columns), cell(v, a.rows));
        let cells = ((a.rows - 1) * last) as f64;
        let mix = |part: fn(&Self) -> &Vec<f64>, at: usize| (1.0 - t) * part(a)[at] + t * part(b)[at];
        let across = |part: fn(&Self) -> &Vec<f64>, column: usize| {
            let at = |row: usize| mix(part, row * columns + column);
            (1.0 - ty) * at(row) + ty * at(row + 1)
        };
        let (c0, c1) = (across(|w| &w.density, column) / cells, across(|w| &w.density, column + 1) / cells);
        let x = across(|w| &w.conditional, column) + tx * (c0 + 0.5 * tx * (c1 - c0));
        let total = |row: usize| mix(|w| &w.conditional, row * columns + last);
        let (r0, r1) = (total(row), total(row + 1));
        let y = mix(|w| &w.marginal, row) + ty * (r0 + 0.5 * ty * (r1 - r0));
        let whole = (1.0 - ty) * r0 + ty * r1;
        [(x / whole).clamp(0.0, 1.0), y.clamp(0.0, 1.0)]
    }
}

/// Integral up to each node by trapezia, cells of width 1.
fn cumulate(values: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let steps = values.windows(2).map(|pair| {
        sum += 0.5 * (pair[0] + pair[1]);
        sum
    });
    std::iter::once(0.0).chain(steps).collect()
}

/// Where the integral of a + (b − a)t from 0 reaches `area`.
fn invert_linear(a: f64, b: f64, area: f64) -> f64 {
    // In the form that does not cancel.
    let root = (a * a + 2.0 * (b - a) * area).max(0.0).sqrt();
    if a + root > 0.0 { (2.0 * area / (a + root)).clamp(0.0, 1.0) } else { 0.0 }
}

/// Cell and place in it of a coordinate on [0, 1] with nodes at both ends.
fn cell(x: f64, nodes: usize) -> (usize, f64) {
    let position = x.clamp(0.0, 1.0) * (nodes - 1) as f64;
    let index = (position as usize).min(nodes - 2);
    (index, position - index as f64)
}

fn linear(values: &[f64], u: f64) -> f64 {
    let (index, t) = cell(u, values.len());
    (1.0 - t) * values[index] + t * values[index + 1]
}

fn node(index: usize, count: usize) -> f64 {
    index as f64 / (count - 1) as f64
}

fn u_of(theta: f64) -> f64 {
    (theta / FRAC_PI_2).sqrt()
}

fn theta_of(u: f64) -> f64 {
    u * u * FRAC_PI_2
}

/// Solid angle of half vectors per area of the unit square: 2π²·u·sin θ.
fn area(u: f64) -> f64 {
    2.0 * PI * PI * u * theta_of(u).sin()
}

fn half_vector(u: f64, v: f64) -> Direction {
    let ((sin, cos), (sin_phi, cos_phi)) = (theta_of(u).sin_cos(), (TAU * v - PI).sin_cos());
    [sin * cos_phi, sin * sin_phi, cos]
}

fn reflect(w: Direction, m: Direction) -> Direction {
    let twice = 2.0 * dot(w, m);
    std::array::from_fn(|i| twice * m[i] - w[i])
}

/// A direction below the horizon moved to just above it: what is read next to the horizon is between the two.
fn above_horizon(w: Direction, m: Direction) -> Direction {
    const LEAST: f64 = 1e-4;
    if w[2] >= LEAST {
        return w;
    }
    // Straight down has no azimuth of its own.
    let [x, y] = if w[0].abs() + w[1].abs() > 1e-6 { [w[0], w[1]] } else { [m[0], m[1]] };
    let scale = (1.0 - LEAST * LEAST).sqrt() / (x * x + y * y).sqrt();
    [x * scale, y * scale, LEAST]
}

fn dot(a: Direction, b: Direction) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn sum(values: &[f64]) -> f64 {
    values.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_warp_and_its_inverse_undo_each_other() {
        let (rows, columns) = (9, 7);
        let values: Vec<f32> = (0..rows * columns).map(|i| 0.1 + ((i * 7919) % 13) as f32).collect();
        let warp = Warp::new(&values, rows, columns);
        for i in 0..20 {
            for j in 0..20 {
                let (x, y) = ((f64::from(i) + 0.5) / 20.0, (f64::from(j) + 0.5) / 20.0);
                let ([u, v], density) = warp.sample(x, y);
                let back = Warp::invert_between(&warp, &warp, 0.3, u, v);
                assert!((back[0] - x).abs() < 1e-9 && (back[1] - y).abs() < 1e-9, "{x} {y} {back:?}");
                assert!(density > 0.0);
            }
        }
    }

    #[test]
    fn incidences_ascend_from_the_normal_to_grazing() {
        let theta = incidences();
        assert!(theta.windows(2).all(|pair| pair[1] > pair[0]));
        assert_eq!(theta[0], 0.0);
        assert!((theta[theta.len() - 1].to_degrees() - GRAZING_DEG).abs() < 1e-9);
    }
}
