//! The pearl in the adaptive parameterisation of Dupuy and Jakob (2018): what Mitsuba's `measured` and pbrt-v4 read.
//!
//! A pair of directions becomes wi and the half vector m; the unit square of m, (u(θ), u(φ)) = (√(2θ/π), (φ + π)/2π), is
//! warped by the density `vndf` of each stored incidence, and `rgb` or `spectra` hold f·cos θo·4σ/D at equal steps of the
//! warped square. The three factors of the format are free. What is chosen here, each for an error that it takes away:
//! - D (`ndf`) is the facet density of interface 0 on a pedestal, finely resolved: its narrow peak need not be interpolated.
//! - `vndf` is a power of the light, which puts nodes where light is and leaves some to the tails. It goes on below the
//!   horizon, and is averaged over neighbouring incidences: readers mix the warps of two incidences, and a horizon or
//!   a lobe that moves from one to the next would tear the mixture.
//! - Half vectors whose exit is below the horizon hold the value at the horizon next to them, so that interpolation there
//!   does not see an edge.
//! - Linear interpolation lies above a convex function; nodes are lowered by what makes every cell right on average.
//! - σ (`sigma`) is ¼; `luminance` is what sampling by `vndf` leaves.
//!
//! Read back here as Mitsuba does, so that the error of a file is known from the file.
//!
//! pbrt-v4 (by its source, 0205b86; not run): it wants `spectra`, so only spectral files; shapes and types are those it checks
//! for. Its `Sample_f` reads a file as Mitsuba does, keyed by the viewing direction; its `f` keys by the light's and divides
//! by the light's cosine all the same, which fits neither a reciprocal file nor this one: pictures that sample lights
//! will differ there, whatever the file.
//!
//! wi looks at the surface and light arrives from wo: [`PearlBsdf::eval_seen`].

use crate::{Direction, PearlBsdf};
use lut_io::FieldError;
use lut_io::tensor_file::{Field, Values};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Incidences: from, to and step in degrees. In half vectors the width of a lobe across the plane of incidence goes with
/// 1/cos θ: steps of 1° miss 5 % at 85.5°. The last stands in for 90°, where no light arrives.
const INCIDENCES_DEG: [[f64; 3]; 6] = [
    [60.0, 76.0, 1.0],
    [76.0, 84.0, 0.5],
    [84.0, 88.0, 0.25],
    [88.0, 89.5, 0.125],
    [89.5, 89.9, 0.1],
    [89.9, 89.95, 0.05],
];
/// Step up to 60°. A stop band of one wavelength sweeps through angles faster than the lobe changes.
const RGB_STEP_DEG: f64 = 2.0;
const SPECTRAL_STEP_DEG: f64 = 1.0;
/// Nodes of `vndf` over φ and θ.
const VNDF_NODES: [usize; 2] = [128, 96];
/// Nodes of `ndf` over θ: facets of 0.01° are still resolved.
const NDF_NODES: usize = 2048;
/// Nodes on either side of the warped square, for few channels and for many: a file of 80 wavelengths has 170 MB at 64.
const NODES: usize = 128;
const NODES_OF_MANY: usize = 64;
const MANY: usize = 16;
/// `vndf` is this power of the light per area of the unit square: 1 leaves the tails without nodes.
const POWER: f64 = 0.35;
/// Share of `vndf` that covers all half vectors alike, so that none is out of reach.
const FLOOR: f64 = 0.05;
/// How fast `vndf` falls below the horizon, per cos θo below it over sin θm (and the offset).
const FALL: f64 = 1.0;
const FALL_OFFSET: f64 = 0.1;
/// Rows of `vndf` on either side that a row's weight is averaged over, and that its distribution over θm is. Where rows next to
/// each other have distributions that differ, the warped square is sheared and interpolation across rows meets the wrong θm.
const WEIGHT_ROWS: usize = 4;
const SHAPE_ROWS: usize = 10;
/// Least weight of a row, as a share of the largest.
const ROW_FLOOR: f64 = 0.05;
/// Incidences on either side that `vndf` is averaged over, with weights that fall linearly.
const NEIGHBOURS: usize = 5;
/// Pedestal of `ndf`, as a share of its peak: about what the interior is to the surface at 85°.
const PEDESTAL: f64 = 0.02;
/// A band of the table is left out of a spectral file where neighbours miss it by less than this share of the spectrum's mean, at the
/// worst of all directions. A tenth of it makes files a quarter larger and their error no more than 0.04 % of the light smaller.
const BAND_TOLERANCE: f64 = 1e-2;
/// What is seen of bands that go beyond it.
const VISIBLE_NM: std::ops::Range<f64> = 380.0..780.0;
/// Wavelengths of a spectral file of a table without interference colours, nm.
const PLAIN_NM: [f64; 2] = [360.0, 830.0];
/// Smallest cos θo that is asked for.
const LEAST_COS: f64 = 1e-4;

/// What the values of a file are.
#[derive(Clone, Debug, PartialEq)]
pub enum Channels {
    /// Linear sRGB, for RGB renderers.
    Rgb,
    /// f·cos θ at wavelengths in nm, for spectral renderers.
    Spectral(Vec<f64>),
}

impl Channels {
    const fn count(&self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Spectral(wavelengths) => wavelengths.len(),
        }
    }

    const fn nodes(&self) -> usize {
        if self.count() < MANY { NODES } else { NODES_OF_MANY }
    }

    const fn step_deg(&self) -> f64 {
        match self {
            Self::Rgb => RGB_STEP_DEG,
            Self::Spectral(_) => SPECTRAL_STEP_DEG,
        }
    }

    /// f·cos θo of every channel.
    fn of(&self, bsdf: &PearlBsdf, wi: Direction, wo: Direction) -> Vec<f64> {
        match self {
            Self::Rgb => bsdf.eval_seen(wi, wo).rgb().to_vec(),
            Self::Spectral(nm) => bsdf.eval_seen_spectrum(wi, wo, nm),
        }
    }
}

/// Wavelengths, nm, between which the spectra of this BSDF are linear to a hundredth of their mean: of the table's bands,
/// those that are needed. A stop band is narrower than two bands, so that a look with coherence needs nearly all.
#[must_use]
pub fn wavelengths_nm(bsdf: &PearlBsdf) -> Vec<f64> {
    let bands: Vec<f64> =
        bsdf.wavelengths_nm().iter().copied().filter(|nm| VISIBLE_NM.contains(nm)).collect();
    let bands = &bands[..];
    let Some(last) = bands.len().checked_sub(1).filter(|last| *last > 0) else { return PLAIN_NM.to_vec() };
    // Mirror direction, the flank of the lobe, and the base alone, every 5°.
    let pairs = (0..18).flat_map(|i| [0.0, 8.0, 40.0].map(|off| (5.0 * f64::from(i), off)));
    let spectra: Vec<Vec<f64>> = pairs
        .map(|(theta_deg, off_deg): (f64, f64)| {
            let (theta_i, theta_o) = (theta_deg.to_radians(), (theta_deg - off_deg).to_radians());
            let (wi, wo) = ([theta_i.sin(), 0.0, theta_i.cos()], [-theta_o.sin(), 0.0, theta_o.cos()]);
            let spectrum = bsdf.eval_seen_spectrum(wi, wo, bands);
            let mean = sum(&spectrum) / spectrum.len() as f64;
            spectrum.into_iter().map(|x| if mean > 0.0 { x / mean } else { x }).collect()
        })
        .collect();
    let mut kept = vec![0, last];
    while let Some((missed, at)) = worst_band(bands, &spectra, &kept)
        && missed > BAND_TOLERANCE
    {
        kept.push(at);
        kept.sort_unstable();
    }
    kept.into_iter().map(|band| bands[band]).collect()
}

/// By how much the spectra, read between the bands that are kept, miss a band at most, and which.
fn worst_band(bands: &[f64], spectra: &[Vec<f64>], kept: &[usize]) -> Option<(f64, usize)> {
    let nodes: Vec<f64> = kept.iter().map(|band| bands[*band]).collect();
    let missed = |spectrum: &Vec<f64>| -> Vec<f64> {
        let values: Vec<f64> = kept.iter().map(|band| spectrum[*band]).collect();
        let read = |nm: &f64| crate::eval::at_wavelength(&nodes, &values, *nm);
        bands.iter().zip(spectrum).map(|(nm, truth)| (read(nm) - truth).abs()).collect()
    };
    let all: Vec<Vec<f64>> = spectra.iter().map(missed).collect();
    let band = |at: usize| (all.iter().map(|missed| missed[at]).fold(0.0, f64::max), at);
    (0..bands.len()).map(band).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// The fields of a `.bsdf` file of this BSDF.
#[must_use]
pub fn fields(bsdf: &PearlBsdf, channels: &Channels, description: &str) -> Vec<Field> {
    let nodes = channels.nodes();
    let theta_i = incidences(channels.step_deg());
    let warps: Vec<Vec<f64>> = theta_i.par_iter().map(|theta| warp_density(bsdf, *theta)).collect();
    let sampled = |(i, theta): (usize, &f64)| {
        Slice::new(bsdf, channels, *theta, around(&warps, i).into_iter().map(|x| x as f32).collect())
    };
    let mut slices: Vec<Slice> = theta_i.par_iter().enumerate().map(sampled).collect();
    right_on_average(&theta_i, nodes, &mut slices);
    let gather = |part: fn(&Slice) -> &Vec<f32>| -> Vec<f32> {
        slices.iter().flat_map(|slice| part(slice).iter().copied()).collect()
    };
    let ndf: Vec<f32> =
        (0..NDF_NODES).map(|i| facet_density(bsdf.slope_sd(), node(i, NDF_NODES)) as f32).collect();
    let [rows, columns] = VNDF_NODES;
    let (count, slices) = (channels.count(), theta_i.len());
    let mut fields = vec![
        Field::u8("description", description.as_bytes()),
        Field::u8("jacobian", &[1]),
        Field::f32("phi_i", &[1], vec![0.0]),
        Field::f32("theta_i", &[slices], theta_i.iter().map(|theta| *theta as f32).collect()),
        Field::f32("ndf", &[2, NDF_NODES], ndf.repeat(2)),
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

/// Stored angles of incidence, radians; `step_deg` up to where they become finer.
fn incidences(step_deg: f64) -> Vec<f64> {
    let ranges = std::iter::once([0.0, INCIDENCES_DEG[0][0], step_deg]).chain(INCIDENCES_DEG);
    let steps = ranges.flat_map(|[from, to, step]| {
        let count = ((to - from) / step).round() as usize;
        (0..count).map(move |i| from + step * i as f64)
    });
    steps.chain(std::iter::once(INCIDENCES_DEG[5][1])).map(f64::to_radians).collect()
}

/// D at a coordinate u(θm): the slope density of the facets over its peak, on the pedestal.
fn facet_density(slope_sd: f64, u: f64) -> f64 {
    let (sin, cos) = theta_of(u).sin_cos();
    let slope = sin / (cos.max(1e-9) * slope_sd);
    (-0.5 * slope * slope).exp() / cos.max(1e-3).powi(3) + PEDESTAL
}

/// Mean of the channels of f·cos θo per area of the unit square, 4 wi·m being dωo/dωm.
fn light(bsdf: &PearlBsdf, wi: Direction, wo: Direction, u: f64) -> f64 {
    let rgb = bsdf.eval_seen(wi, wo).rgb();
    let cos_d = (0.5 * (1.0 + dot(wi, wo))).max(0.0).sqrt();
    rgb.iter().sum::<f64>() / 3.0 * 4.0 * cos_d * area(u)
}

/// Density on the unit square by which one incidence would be warped, mean 1.
fn warp_density(bsdf: &PearlBsdf, theta_i: f64) -> Vec<f64> {
    let wi = [theta_i.sin(), 0.0, theta_i.cos()];
    let [rows, columns] = VNDF_NODES;
    // Over θm: the light, carried on below the horizon. Over φm: the light above it.
    let (mut lobe, mut weights) = (Vec::with_capacity(rows * columns), Vec::with_capacity(rows));
    for row in 0..rows {
        let v = node(row, rows);
        let mut seen = 0.0;
        for u in (0..columns).map(|column| node(column, columns)) {
            let wo = reflect(wi, half_vector(u, v));
            let fall = (-FALL * (-wo[2]).max(0.0) / (FALL_OFFSET + theta_of(u).sin())).exp();
            lobe.push(fall * light(bsdf, wi, at_or_above_horizon(theta_i, u, v), u).powf(POWER));
            seen += light(bsdf, wi, wo, u).powf(POWER);
        }
        weights.push(seen);
    }
    let most = weights.iter().copied().fold(0.0, f64::max);
    for (row, cells) in lobe.chunks_mut(columns).enumerate() {
        let near: f64 = (0..=2 * WEIGHT_ROWS).map(|k| weights[(row + rows + k - WEIGHT_ROWS) % rows]).sum();
        let weight = near / (2 * WEIGHT_ROWS + 1) as f64 + ROW_FLOOR * most;
        let total = sum(cells).max(f64::MIN_POSITIVE);
        cells.iter_mut().for_each(|cell| *cell *= weight / total);
    }
    let lobe = smooth_over_rows(&lobe, columns);
    let floor: Vec<f64> = (0..lobe.len()).map(|k| area(node(k % columns, columns))).collect();
    let (most_lobe, most_floor) = (sum(&lobe), sum(&floor));
    let mixed = lobe.iter().zip(&floor).map(|(lobe, floor)| {
        let lobe = if most_lobe > 0.0 { lobe / most_lobe } else { 0.0 };
        // The column θm = 0 has no area; a little keeps the warp invertible there.
        ((1.0 - FLOOR) * lobe + FLOOR * floor / most_floor) * (rows * columns) as f64 + 1e-4
    });
    mixed.collect()
}

/// Rows averaged with their neighbours, with weights that fall linearly; φm is periodic.
fn smooth_over_rows(values: &[f64], columns: usize) -> Vec<f64> {
    let rows = values.len() / columns;
    let cell = |k: usize| {
        let (row, column) = (k / columns, k % columns);
        let mean = |(sum, total): (f64, f64), j: usize| {
            let weight = (SHAPE_ROWS + 1 - j.abs_diff(SHAPE_ROWS)) as f64;
            let neighbour = (row + rows + j - SHAPE_ROWS) % rows;
            (sum + weight * values[neighbour * columns + column], total + weight)
        };
        let (sum, total) = (0..=2 * SHAPE_ROWS).fold((0.0, 0.0), mean);
        sum / total
    };
    (0..values.len()).map(cell).collect()
}

/// The mean of one incidence and its neighbours.
fn around(warps: &[Vec<f64>], at: usize) -> Vec<f64> {
    let near = at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(warps.len());
    let weight = |i: usize| 1.0 - i.abs_diff(at) as f64 / (NEIGHBOURS + 1) as f64;
    let total: f64 = near.clone().map(weight).sum();
    (0..warps[at].len()).map(|k| near.clone().map(|i| weight(i) * warps[i][k]).sum::<f64>() / total).collect()
}

/// What one incidence contributes.
struct Slice {
    vndf: Vec<f32>,
    luminance: Vec<f32>,
    values: Vec<f32>,
}

impl Slice {
    fn new(bsdf: &PearlBsdf, channels: &Channels, theta_i: f64, vndf: Vec<f32>) -> Self {
        let wi = [theta_i.sin(), 0.0, theta_i.cos()];
        let [rows, columns] = VNDF_NODES;
        let nodes = channels.nodes();
        let warp = Warp::new(&vndf, rows, columns);
        let mut luminance = Vec::with_capacity(nodes * nodes);
        let mut values = vec![0.0; channels.count() * nodes * nodes];
        for row in 0..nodes {
            for column in 0..nodes {
                let ([u, v], density) = warp.sample(node(column, nodes), node(row, nodes));
                let seen = reflect(wi, half_vector(u, v));
                luminance.push((light(bsdf, wi, seen, u) / density + 1e-4) as f32);
                let wo = at_or_above_horizon(theta_i, u, v);
                let ndf = facet_density(bsdf.slope_sd(), u);
                for (channel, value) in channels.of(bsdf, wi, wo).into_iter().enumerate() {
                    values[(channel * nodes + row) * nodes + column] = (value / ndf) as f32;
                }
            }
        }
        Self { vndf, luminance, values }
    }
}

/// Lowers every node by h²/12 of the second derivative along both sides of the square and along θi: the mean by which
/// linear interpolation lies above the function. (This is the L² projection onto linear splines to fourth order.)
fn right_on_average(theta_i: &[f64], nodes: usize, slices: &mut [Slice]) {
    // Where a narrow feature is not resolved the second difference is no derivative: half the value at most.
    let lowered = |value: f32, by: f64| value - (by as f32).clamp(-0.5 * value, 0.5 * value);
    let sampled: Vec<Vec<f32>> = slices.iter().map(|slice| slice.values.clone()).collect();
    slices.par_iter_mut().enumerate().for_each(|(i, slice)| {
        if i > 0 && i + 1 < theta_i.len() {
            let (h, k) = (theta_i[i] - theta_i[i - 1], theta_i[i + 1] - theta_i[i]);
            let gain = (h * h * h + k * k * k) / (h + k) / 12.0;
            for ((value, before), after) in slice.values.iter_mut().zip(&sampled[i - 1]).zip(&sampled[i + 1])
            {
                let (a, b, c) = (f64::from(*before), f64::from(*value), f64::from(*after));
                let second = 2.0 * ((c - b) / k - (b - a) / h) / (h + k);
                *value = lowered(*value, gain * second);
            }
        }
        for channel in slice.values.chunks_mut(nodes * nodes) {
            for (step, line) in [(1, nodes), (nodes, 1)] {
                let before = channel.to_vec();
                for k in (0..nodes).flat_map(|n| (1..nodes - 1).map(move |j| n * line + j * step)) {
                    let second = before[k - step] - 2.0 * before[k] + before[k + step];
                    channel[k] = lowered(before[k], f64::from(second) / 12.0);
                }
            }
        }
    });
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
    pub fn new(fields: &[Field]) -> Result<Self, FieldError> {
        let field = |name: &str, dimensions: usize| {
            let found = fields.iter().find(|field| field.name == name);
            let field = found.ok_or_else(|| FieldError::new(name, "is missing"))?;
            match &field.values {
                Values::F32(values) if field.shape.len() == dimensions && !values.is_empty() => {
                    Ok((field.shape.as_slice(), values))
                }
                _ => Err(FieldError::new(
                    name,
                    format!("has the shape {:?}, expected {dimensions} dimensions of f32", field.shape),
                )),
            }
        };
        let doubles = |values: &[f32]| values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
        let (phi_i, _) = field("phi_i", 1)?;
        if phi_i != [1] {
            return Err(FieldError::new(
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
        let first_row = |name: &str| -> Result<Vec<f64>, FieldError> {
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
            return Err(FieldError::new("vndf", problem));
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

    /// f·cos θo at wavelengths in nm, 1/sr: linear between those of the file, constant beyond.
    #[must_use]
    pub fn eval_spectrum(&self, wi: Direction, wo: Direction, wavelengths_nm: &[f64]) -> Vec<f64> {
        let values = self.eval(wi, wo);
        wavelengths_nm
            .iter()
            .map(|nm| crate::eval::at_wavelength(&self.wavelengths_nm, &values, *nm))
            .collect()
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

/// The exit direction of the half vector at (u, v), or where that is below the horizon, of the half vector of the same
/// θm next to it that is above.
fn at_or_above_horizon(theta_i: f64, u: f64, v: f64) -> Direction {
    let wi = [theta_i.sin(), 0.0, theta_i.cos()];
    let wo = reflect(wi, half_vector(u, v));
    if wo[2] >= LEAST_COS {
        return wo;
    }
    // wo·z = 2(wi·m)cos θm − cos θi: even at φm = 0 not above the horizon beyond this θm.
    let theta_m = theta_of(u).min(0.5 * (FRAC_PI_2 + theta_i) - LEAST_COS);
    let (sin, cos) = theta_m.sin_cos();
    let horizon = ((LEAST_COS + wi[2]) / (2.0 * cos) - wi[2] * cos) / (wi[0] * sin).max(1e-9);
    let (sin_phi, cos_phi) = (TAU * v - PI).sin_cos();
    let cos_phi = horizon.max(cos_phi).min(1.0);
    let sin_phi = (1.0 - cos_phi * cos_phi).sqrt().copysign(sin_phi);
    let [x, y, z] = reflect(wi, [sin * cos_phi, sin * sin_phi, cos]);
    if z > 0.0 {
        return [x, y, z];
    }
    let length = (x * x + y * y).sqrt();
    [x / length, y / length, LEAST_COS]
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
        for (step, count) in [(RGB_STEP_DEG, 96), (SPECTRAL_STEP_DEG, 126)] {
            let theta = incidences(step);
            assert!(theta.windows(2).all(|pair| pair[1] > pair[0]));
            assert_eq!((theta[0], theta.len()), (0.0, count));
            assert!((theta[theta.len() - 1].to_degrees() - 89.95).abs() < 1e-9);
        }
    }

    #[test]
    fn below_the_horizon_the_nearest_exit_above_is_asked_for() {
        for theta_i in [0.0, 0.3, 1.2, 1.569] {
            let wi = [f64::sin(theta_i), 0.0, f64::cos(theta_i)];
            for (row, column) in (0..40).flat_map(|row| (0..40).map(move |column| (row, column))) {
                let (u, v) = (node(column, 40), node(row, 40));
                let (asked, mirrored) = (at_or_above_horizon(theta_i, u, v), reflect(wi, half_vector(u, v)));
                assert!(asked[2] >= 0.9 * LEAST_COS && (dot(asked, asked) - 1.0).abs() < 1e-6, "{asked:?}");
                if mirrored[2] >= LEAST_COS {
                    assert_eq!(asked, mirrored);
                } else {
                    assert!(asked[2] < 2.0 * LEAST_COS, "{theta_i} {u} {v}: {asked:?}");
                }
            }
        }
    }

    #[test]
    fn nodes_are_lowered_by_what_linear_interpolation_lies_above() {
        // x², y² and θ² on steps of 1: their mean over a cell is 1/6 below the mean of the corners.
        let n = 5;
        let mut slices: Vec<Slice> = (0..5)
            .map(|i| {
                let value = |k: usize| (100 + i * i + (k % n).pow(2) + (k / n).pow(2)) as f32;
                Slice { vndf: vec![], luminance: vec![], values: (0..n * n).map(value).collect() }
            })
            .collect();
        right_on_average(&[0.0, 1.0, 2.0, 3.0, 4.0], n, &mut slices);
        let middle = slices[2].values[2 * n + 2];
        assert!((middle - (112.0 - 3.0 / 6.0)).abs() < 1e-4, "{middle}");
    }
}
