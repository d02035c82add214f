//! Colour of both terms, three channels at a time: RGB is one group, wavelength bands are as many as needed.

use crate::controls::Controls;
use crate::curve::{self, NODES, Place, Quads};
use crate::quadrature::Spline;
use lut_io::lobe::Interpolant;
use lut_io::monotone::Monotone;
use lut_io::reciprocal;
use lut_io::spectra::Spectra;
use lut_io::table::Component;
use std::f64::consts::PI;

/// Incidences at which the half-vector angles of the lobes are tallied: every eighth node of [`curve`], at most a degree apart and
/// closer towards the horizon, where lobes change faster.
pub(crate) const TALLIES: usize = curve::STEPS / STEPS_PER_TALLY + 1;
pub(crate) const STEPS_PER_TALLY: usize = 8;

/// Below this what the lobes leave is rounding.
const NOTHING_LEFT: f64 = 1e-12;

/// Three channels over an angle.
pub(crate) type Curves = Box<[[f64; 3]; NODES]>;

/// Where the lobes' light has its half-vector angles: per tallied incidence, for interior, surface and rehit, a
/// histogram over the nodes of [`curve`] whose sum is 1 (or 0 without light).
pub(crate) type HalfAngles = Vec<[Box<[f64; NODES]>; 3]>;

/// Three colour channels, ready to evaluate.
#[derive(Clone, Debug)]
pub(crate) struct Colours {
    /// brightness·[(1 − γ) + γ·tint·M] over θd.
    factor: Quads,
    /// limit(θi) of the first term, and whether there is an angle at which it is not 1.
    limit: Quads,
    limited: bool,
    /// 1 − A, limit included.
    rest: Quads,
    /// tint·Ê over θo.
    emission: Quads,
    /// Whether there is an angle at which the base would send out more than it receives.
    overflows: bool,
    /// 1/(π(1 − A_avg)).
    base: Channels,
    /// ρ.
    body: Channels,
    depth: f64,
    /// Albedo of the first term by component, limit included: interior, surface, rehit.
    shares: [Curves; 3],
    /// Mean of ρ(1 − depth) and of ρ·depth·Ê, limit included, over what the base sends out.
    sent: [[f64; 3]; 2],
}

/// What the three channels are.
pub(crate) struct Palette {
    pub(crate) modulation: [Monotone; 3],
    pub(crate) emission: [Monotone; 3],
    pub(crate) body: [f64; 3],
    pub(crate) tint: [f64; 3],
}

impl Palette {
    /// Without interference colours, or in the RGB of those that there are.
    pub(crate) fn rgb(spectra: Option<&Spectra>, controls: &Controls) -> Self {
        let coherent = spectra.and_then(|s| s.coherent.as_ref());
        let emission = spectra.and_then(|s| s.emission.as_ref());
        Self {
            modulation: [0, 1, 2]
                .map(|c| angle_curve(coherent.map(|s| (&s.theta_deg, &s.modulation_rgb)), |row| row[c])),
            emission: [0, 1, 2]
                .map(|c| angle_curve(emission.map(|s| (&s.theta_deg, &s.radiance_rgb)), |row| row[c])),
            body: controls.body_rgb,
            tint: controls.tint_rgb,
        }
    }

    /// Bands 3g, 3g + 1, 3g + 2; the last band stands in for those beyond it.
    pub(crate) fn bands(spectra: &Spectra, controls: &Controls, group: usize) -> Self {
        let band = |c: usize| (3 * group + c).min(spectra.wavelength_nm.len() - 1);
        let (coherent, emission) = (spectra.coherent.as_ref(), spectra.emission.as_ref());
        let at = |rgb: [f64; 3], c: usize| reflectance(rgb, spectra.wavelength_nm[band(c)]);
        Self {
            modulation: [0, 1, 2]
                .map(|c| angle_curve(coherent.map(|s| (&s.theta_deg, &s.modulation)), |row| row[band(c)])),
            emission: [0, 1, 2]
                .map(|c| angle_curve(emission.map(|s| (&s.theta_deg, &s.radiance)), |row| row[band(c)])),
            body: [0, 1, 2].map(|c| at(controls.body_rgb, c)),
            tint: [0, 1, 2].map(|c| at(controls.tint_rgb, c)),
        }
    }
}

/// One channel over the stored angles; 1 where the table has no such colour.
fn angle_curve<R>(stored: Option<(&Vec<f64>, &Vec<R>)>, channel: impl Fn(&R) -> f64) -> Monotone {
    let Some((theta_deg, rows)) = stored else { return Monotone::new(vec![0.0], vec![1.0]) };
    Monotone::new(
        theta_deg.iter().map(|theta| theta.to_radians()).collect(),
        rows.iter().map(channel).collect(),
    )
}

/// Spectral reflectance of a linear sRGB colour: red above 580 nm, green 490 to 580 nm, blue below, joined by
/// ramps of 30 nm. Grey is flat, and nothing leaves the range of the channels, which is what energy needs.
fn reflectance(rgb: [f64; 3], nm: f64) -> f64 {
    let ramp = |centre: f64| ((nm - centre) / 30.0 + 0.5).clamp(0.0, 1.0);
    let (green_on, red_on) = (ramp(490.0), ramp(580.0));
    rgb[2] * (1.0 - green_on) + rgb[1] * (green_on - red_on) + rgb[0] * red_on
}

/// The angles that colours depend on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Angles {
    pub(crate) incidence: Place,
    pub(crate) exit: Place,
    /// θd.
    pub(crate) half: Place,
}

/// Which of the two directions the viewer is at: the emission is read there.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Viewer {
    AtExit,
    AtIncidence,
}

/// Three channels with a 0 behind them: four numbers are handled in as many instructions, without shuffling.
pub(crate) type Channels = [f64; 4];

/// Light of the four components.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terms {
    pub(crate) diffuse: Channels,
    pub(crate) incoherent: Channels,
    /// Colour of the first term: multiplies the lobe.
    pub(crate) lobe: Channels,
}

impl Colours {
    pub(crate) fn new(
        palette: &Palette,
        controls: &Controls,
        lobe: &Interpolant,
        half_angles: &HalfAngles,
        light: Option<&reciprocal::Section>,
    ) -> Self {
        let gamma = controls.coherence;
        let factor = tabulate(|node, c| {
            let modulation = palette.tint[c] * palette.modulation[c].at(curve::theta_at(node));
            controls.brightness * ((1.0 - gamma) + gamma * modulation)
        });
        let emission = tabulate(|node, c| palette.tint[c] * palette.emission[c].at(curve::theta_at(node)));
        let mut shares = mean_factors(&factor, half_angles);
        for (share, component) in
            shares.iter_mut().zip([Component::Interior, Component::Surface, Component::Rehit])
        {
            for (node, channels) in share.iter_mut().enumerate() {
                let theta = curve::theta_at(node);
                let [interior, rehit] = light.map_or([0.0; 2], |section| section.gain(theta));
                let albedo = match component {
                    Component::Interior => (lobe.albedo(component, theta) + interior).max(0.0),
                    Component::Surface => single_reflection_share(lobe, theta),
                    Component::Rehit => (lobe.albedo(component, theta) + rehit).max(0.0),
                };
                *channels = channels.map(|mean| mean.max(0.0) * albedo);
            }
        }
        let unlimited = |node: usize, c: usize| shares[0][node][c] + shares[1][node][c] + shares[2][node][c];
        let mut limit = tabulate(|node, c| 1.0 / unlimited(node, c).max(1.0));
        if light.is_some() {
            // What is the same both ways must stay so: one limit for all incidences.
            let least =
                limit.iter().copied().fold([1.0; 3], |a, b| std::array::from_fn(|c| f64::min(a[c], b[c])));
            limit.fill(least);
        }
        let rest = tabulate(|node, c| (1.0 - unlimited(node, c) * limit[node][c]).max(0.0));
        for share in &mut shares {
            for (channels, limit) in share.iter_mut().zip(limit.iter()) {
                *channels = std::array::from_fn(|c| channels[c] * limit[c]);
            }
        }
        let depth = controls.depth;
        let left = [0, 1, 2].map(|c| curve::hemispherical_mean(|node| rest[node][c]));
        let base = padded(left.map(|left| if left > NOTHING_LEFT { 1.0 / (PI * left) } else { 0.0 }));
        let body = padded(palette.body);
        let overflows =
            emission.iter().any(|colour| (0..3).any(|c| body[c] * ((1.0 - depth) + depth * colour[c]) > 1.0));
        let mut this = Self {
            factor: read_together(&factor),
            limited: limit.iter().flatten().any(|limit| *limit < 1.0),
            limit: read_together(&limit),
            rest: read_together(&rest),
            emission: read_together(&emission),
            overflows,
            base,
            body,
            depth,
            shares,
            sent: [[0.0; 3]; 2],
        };
        this.sent = [0, 1].map(|part| {
            // Colour and 1 − A are read linearly one by one; their product at the nodes misses the curvature of
            // the product only, 1e-6 of it at these steps.
            let sent =
                |node: usize, c: usize| rest[node][c] * this.base_colour(padded(emission[node]))[part][c];
            [0, 1, 2].map(|c| curve::hemispherical_mean(|node| sent(node, c)) / left[c].max(NOTHING_LEFT))
        });
        this
    }

    /// What the base makes of the light at a viewing angle: ρ(1 − depth) and ρ·depth·Ê, lowered together where they would
    /// send out more than they receive. By angle: what a viewer sees of a white surrounding must not exceed it either.
    #[inline(always)]
    fn base_colour(&self, emission: Channels) -> [Channels; 2] {
        let (mut diffuse, mut incoherent) = ([0.0; 4], [0.0; 4]);
        for c in 0..4 {
            let (plain, coloured) = (1.0 - self.depth, self.depth * emission[c]);
            let body = if self.overflows {
                self.body[c] / (self.body[c] * (plain + coloured)).max(1.0)
            } else {
                self.body[c]
            };
            diffuse[c] = body * plain;
            incoherent[c] = body * coloured;
        }
        [diffuse, incoherent]
    }

    /// Colours at an incidence, an exit and a half-vector angle; the base includes cos θo.
    #[inline(always)]
    pub(crate) fn terms(&self, at: Angles, cos_o: f64, viewer: Viewer) -> Terms {
        let Angles { incidence: at_i, exit: at_o, half: at_d } = at;
        let view = if matches!(viewer, Viewer::AtExit) { at_o } else { at_i };
        let (rest_i, rest_o) = (at_i.read4(&self.rest), at_o.read4(&self.rest));
        let [diffuse, incoherent] = self.base_colour(channels(view.read4(&self.emission)));
        let mut terms = Terms { diffuse, incoherent, lobe: self.lobe_factor(at_i, at_d) };
        for c in 0..4 {
            let base = self.base[c] * cos_o * f64::from(rest_i[c] * rest_o[c]);
            terms.diffuse[c] *= base;
            terms.incoherent[c] *= base;
        }
        terms
    }

    /// Colour of the first term: multiplies the lobe.
    #[inline(always)]
    pub(crate) fn lobe_factor(&self, at_i: Place, at_d: Place) -> Channels {
        let mut factor = at_d.read4(&self.factor);
        if self.limited {
            let limit = at_i.read4(&self.limit);
            for (factor, limit) in factor.iter_mut().zip(limit) {
                *factor *= limit;
            }
        }
        channels(factor)
    }

    /// Directional albedo of the base, viewed from the exits: diffuse and incoherent part.
    pub(crate) fn base_albedo(&self, at_i: Place) -> [[f64; 3]; 2] {
        self.sent_of(channels(at_i.read4(&self.rest)), self.sent)
    }

    /// The same, viewed from the incidence.
    pub(crate) fn base_albedo_seen(&self, at_i: Place) -> [[f64; 3]; 2] {
        let emission = channels(at_i.read4(&self.emission));
        self.sent_of(channels(at_i.read4(&self.rest)), self.base_colour(emission).map(three))
    }

    fn sent_of(&self, rest: Channels, parts: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
        let lit = |c: usize| if self.base[c] > 0.0 { rest[c] } else { 0.0 };
        parts.map(|part| std::array::from_fn(|c| lit(c) * part[c]))
    }

    /// Directional albedo as seen at a node, mean of the channels: interior, rehit, surface, diffuse, incoherent.
    pub(crate) fn mean_albedos(&self, node: usize) -> [f64; 5] {
        let mean = |rgb: [f64; 3]| rgb.iter().sum::<f64>() / 3.0;
        let (rest, emission) = (channels(self.rest[node]), channels(self.emission[node]));
        let [diffuse, incoherent] = self.sent_of(rest, self.base_colour(emission).map(three));
        [
            mean(self.shares[0][node]),
            mean(self.shares[2][node]),
            mean(self.shares[1][node]),
            mean(diffuse),
            mean(incoherent),
        ]
    }
}

fn read_together(curves: &Curves) -> Quads {
    curve::quads(|node| [curves[node][0], curves[node][1], curves[node][2], 0.0])
}

/// The channels of what was read.
#[inline(always)]
fn channels(read: [f32; 4]) -> Channels {
    read.map(f64::from)
}

fn padded([r, g, b]: [f64; 3]) -> Channels {
    [r, g, b, 0.0]
}

/// The three channels alone.
#[inline(always)]
pub(crate) fn three([r, g, b, _]: Channels) -> [f64; 3] {
    [r, g, b]
}

/// Share of the light that interface 0 reflects at first meeting.
pub(crate) fn single_reflection_share(lobe: &Interpolant, theta: f64) -> f64 {
    (lobe.albedo(Component::Surface, theta) - lobe.albedo(Component::Rehit, theta)).max(0.0)
}

/// Mean of the colour factor over each component's light, at every node of θi.
fn mean_factors(factor: &Curves, half_angles: &HalfAngles) -> [Curves; 3] {
    [0, 1, 2].map(|component| {
        let mean = |tally: &[Box<[f64; NODES]>; 3], c: usize| -> f64 {
            tally[component].iter().zip(factor.iter()).map(|(mass, factor)| mass * factor[c]).sum()
        };
        let splines =
            [0, 1, 2].map(|c| Spline::new(half_angles.iter().map(|tally| mean(tally, c)).collect()));
        tabulate(|node, c| splines[c].at(node as f64 / STEPS_PER_TALLY as f64))
    })
}

fn tabulate(value: impl Fn(usize, usize) -> f64) -> Curves {
    let mut curves = Box::new([[0.0; 3]; NODES]);
    for (node, channels) in curves.iter_mut().enumerate() {
        *channels = [0, 1, 2].map(|c| value(node, c));
    }
    curves
}
