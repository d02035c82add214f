//! What the controls make of the prepared colours, three channels at a time: RGB is one group, wavelengths are as many as needed.

use crate::controls::{Components, Controls};
use crate::numerics::curve::{self, Curve, Place, Quads};
use crate::prepare::channels::{self, Kind};
use crate::prepare::{Band, Prepared};
use std::f64::consts::PI;

/// Below this what the lobes leave is rounding.
const NOTHING_LEFT: f64 = 1e-12;

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
    tint: Channels,
    depth: f64,
}

/// Prepared curves of three channels, as they are at a scale of the thicknesses.
struct Curves<'p> {
    reflectance: [[f64; 3]; 3],
    modulation: [Between<'p>; 3],
    rest: [Between<'p>; 3],
    emission: [Between<'p>; 3],
    /// Ê is in units of this.
    emission_mean: Option<Between<'p>>,
}

/// A curve, or what is read between two.
enum Between<'p> {
    One(&'p Curve),
    Two([&'p Curve; 2], f64),
}

impl Between<'_> {
    fn at(&self, node: usize) -> f64 {
        match self {
            Self::One(curve) => f64::from(curve[node]),
            Self::Two([a, b], t) => (1.0 - t) * f64::from(a[node]) + t * f64::from(b[node]),
        }
    }
}

impl<'p> Curves<'p> {
    fn new(prepared: &'p Prepared, kind: Kind, band: &'p Band, first: usize, thickness: f64) -> Self {
        let (channels, coloured) = (prepared.kind(kind), band.channels(kind));
        let at = [0, 1, 2].map(|c| (first + c).min(coloured.len() - 1));
        let own = Self {
            reflectance: at.map(|c| channels.reflectance[c]),
            modulation: at.map(|c| Between::One(&coloured[c].modulation)),
            rest: at.map(|c| Between::One(&coloured[c].light.rest)),
            emission: at.map(|c| Between::One(&channels.emission[c])),
            emission_mean: None,
        };
        let Some(scales) = prepared.scales.as_ref().filter(|_| thickness != 1.0) else { return own };
        let (k, t) = scales.place(thickness);
        match kind {
            Kind::Rgb => {
                let (a, b) = (&band.scaled[k], &band.scaled[k + 1]);
                let rgb = [0, 1, 2];
                Self {
                    modulation: rgb.map(|c| Between::Two([&a.modulation[c], &b.modulation[c]], t)),
                    rest: rgb.map(|c| Between::Two([&a.rest[c], &b.rest[c]], t)),
                    emission: rgb
                        .map(|c| Between::Two([&scales.emission[k][c], &scales.emission[k + 1][c]], t)),
                    ..own
                }
            }
            // The channel stands for another wavelength.
            Kind::Spectral => Self {
                reflectance: at.map(|c| channels::reflectance(thickness * channels.wavelength_nm[c])),
                emission_mean: Some(Between::Two(
                    [&scales.emission_mean[k], &scales.emission_mean[k + 1]],
                    t,
                )),
                ..own
            },
        }
    }

    fn modulation(&self, node: usize, c: usize) -> f64 {
        self.modulation[c].at(node)
    }

    fn rest(&self, node: usize, c: usize) -> f64 {
        self.rest[c].at(node)
    }

    fn emission(&self, node: usize, c: usize) -> f64 {
        let emission = self.emission[c].at(node);
        self.emission_mean.as_ref().map_or(emission, |mean| emission / mean.at(node))
    }
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
    /// Channels `first` to `first` + 2 of a band; the last one stands in for those beyond it. At the thickness of the controls.
    pub(crate) fn new(
        prepared: &Prepared,
        kind: Kind,
        band: &Band,
        first: usize,
        controls: &Controls,
    ) -> Self {
        let read = Curves::new(prepared, kind, band, first, controls.thickness);
        let reflectance = |rgb: [f64; 3]| {
            padded(read.reflectance.map(|shares| shares.iter().zip(rgb).map(|(share, x)| share * x).sum()))
        };
        let (body, tint) = (reflectance(controls.body_rgb), reflectance(controls.tint_rgb));
        let (brightness, gamma, depth) = (controls.brightness, controls.coherence, controls.depth);
        // What a colour factor of 1 and one of tint·M leave of the light, mixed as the factors are.
        let left = |node: usize, c: usize| {
            let plain = f64::from(band.plain.rest[node]);
            let modulated = (1.0 - tint[c]) + tint[c] * read.rest(node, c);
            (1.0 - brightness) + brightness * ((1.0 - gamma) * plain + gamma * modulated)
        };
        let mut limits = curve::triples(|node, c| 1.0 / (1.0 - left(node, c)).max(1.0));
        if prepared.is_reciprocal() {
            // What is the same both ways must stay so: one limit for all incidences.
            let least = limits.iter().fold([1.0; 3], |a, b| [0, 1, 2].map(|c| f64::min(a[c], b[c])));
            limits.fill(least);
        }
        let rest = quads(|node, c| (1.0 - (1.0 - left(node, c)) * limits[node][c]).max(0.0));
        let emission = quads(|node, c| tint[c] * read.emission(node, c));
        let mean_left = |c: usize| -> f64 {
            let weighted = |(weight, rest): (&f32, &[f32; 4])| f64::from(*weight) * f64::from(rest[c]);
            prepared.mean_weights.iter().zip(rest.iter()).map(weighted).sum()
        };
        let base = |c: usize| {
            let left = mean_left(c);
            if left > NOTHING_LEFT { 1.0 / (PI * left) } else { 0.0 }
        };
        let over_one = |colour: &[f32; 4]| {
            (0..3).any(|c| body[c] * ((1.0 - depth) + depth * f64::from(colour[c])) > 1.0)
        };
        Self {
            factor: quads(|node, c| {
                brightness * ((1.0 - gamma) + gamma * (tint[c] * read.modulation(node, c)))
            }),
            limited: limits.iter().flatten().any(|limit| *limit < 1.0),
            limit: quads(|node, c| limits[node][c]),
            base: padded([0, 1, 2].map(base)),
            overflows: emission.iter().any(over_one),
            rest,
            emission,
            body,
            tint,
            depth,
        }
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

    /// 1 − A at an incidence.
    pub(crate) fn rest(&self, at_i: Place) -> [f64; 3] {
        three(channels(at_i.read4(&self.rest)))
    }

    /// tint·Ê at a viewing angle.
    pub(crate) fn emission(&self, view: Place) -> [f64; 3] {
        three(channels(view.read4(&self.emission)))
    }

    /// Directional albedo of the base, viewed from the exits: diffuse and incoherent part.
    pub(crate) fn base_albedo(&self, at_i: Place, mean_weights: &Curve) -> [[f64; 3]; 2] {
        // Colour and 1 − A are read linearly one by one; their product at the nodes misses the curvature of
        // the product only, 1e-6 of it at these steps.
        let mut sent = [[0.0; 3]; 2];
        for ((weight, rest), emission) in mean_weights.iter().zip(self.rest.iter()).zip(self.emission.iter())
        {
            let parts = self.base_colour(channels(*emission));
            for (sent, part) in sent.iter_mut().zip(parts) {
                (0..3).for_each(|c| sent[c] += f64::from(*weight) * f64::from(rest[c]) * part[c]);
            }
        }
        let rest = channels(at_i.read4(&self.rest));
        sent.map(|sent| [0, 1, 2].map(|c| rest[c] * sent[c] * PI * self.base[c]))
    }

    /// The same, viewed from the incidence.
    pub(crate) fn base_albedo_seen(&self, at_i: Place) -> [[f64; 3]; 2] {
        self.sent(channels(at_i.read4(&self.rest)), channels(at_i.read4(&self.emission)))
    }

    fn sent(&self, rest: Channels, emission: Channels) -> [[f64; 3]; 2] {
        let lit = |c: usize| if self.base[c] > 0.0 { rest[c] } else { 0.0 };
        self.base_colour(emission).map(|part| [0, 1, 2].map(|c| lit(c) * part[c]))
    }

    /// Probabilities over θi of sampling interior, rehit, single reflection and base: the albedos as seen, mean of the channels, of what is
    /// shown. Of linear sRGB.
    pub(crate) fn chances(&self, band: &Band, controls: &Controls) -> Quads {
        let Components { diffuse, incoherent, mirror, blur } = controls.components;
        let mean = |channels: [f64; 3]| channels.iter().sum::<f64>() / 3.0;
        let shown = |show: bool, albedo: f64| if show { albedo } else { 0.0 };
        let gamma = controls.coherence;
        curve::quads(|node| {
            let lobe = |part: usize| {
                let plain = (1.0 - gamma) * f64::from(band.plain.albedo[part][node]);
                mean([0, 1, 2].map(|c| {
                    let modulated = f64::from(band.rgb[c].light.albedo[part][node]);
                    let albedo = controls.brightness * (plain + gamma * self.tint[c] * modulated);
                    albedo * f64::from(self.limit[node][c])
                }))
            };
            let base = self.sent(channels(self.rest[node]), channels(self.emission[node])).map(mean);
            let chance = [
                shown(blur, lobe(0)),
                shown(mirror, lobe(1)),
                shown(mirror, lobe(2)),
                shown(diffuse, base[0]) + shown(incoherent, base[1]),
            ];
            let total: f64 = chance.iter().sum();
            if total > 0.0 { chance.map(|c| c / total) } else { chance }
        })
    }
}

fn quads(at: impl Fn(usize, usize) -> f64) -> Quads {
    curve::quads(|node| padded([0, 1, 2].map(|c| at(node, c))))
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
