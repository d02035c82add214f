//! Integrals over the tabulated lobes.

use super::Lobes;
use crate::numerics::angles::{Polar, greatest};
use crate::numerics::curve::{Place, STEPS};
use crate::numerics::lanes::{LANES, Lane, Steps, each};
use crate::numerics::quadrature::gauss_legendre;
use lut_io::axis::Stretched;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Fewest Gauss–Legendre points on every smooth piece of an integral over the tabulated lobes, in θo and in φ.
#[derive(Clone, Copy)]
pub(crate) struct Points {
    exit: usize,
    azimuth: usize,
}

/// For the shape of a distribution.
pub(crate) const COARSE: Points = Points { exit: 1, azimuth: 1 };
/// For its mass.
pub(crate) const FINE: Points = Points { exit: 3, azimuth: 2 };
/// A point for so much of a piece, radians, and the most points a piece: within a long one θd runs through waves of the
/// interference, of which one point in all missed 2e-4 of the light.
const REACH: f64 = PI / 180.0;
const MOST_POINTS: usize = 4;

/// Cells around the mirror direction that resolve the decay.
const DECAY_CELLS: usize = 14;
/// Widths of the decay for which there are rules: this many an octave, down from 1.
const RULES_AN_OCTAVE: f64 = 2.0;

/// Azimuths of which some lanes have no weight.
struct Packet {
    phi: Lane,
    /// sin²(φ/2).
    y2: Lane,
    weight: Lane,
}

/// Azimuths in [0, π] with weights.
type Azimuths = Vec<Packet>;

/// Gauss–Legendre rules of 1 to [`MOST_POINTS`] points.
static RULES: LazyLock<Vec<Vec<(f64, f64)>>> =
    LazyLock::new(|| (1..=MOST_POINTS).map(gauss_legendre).collect());

/// Azimuths that resolve decays of ever smaller width, for [`COARSE`] and for [`FINE`].
static DECAYED: LazyLock<[Vec<Azimuths>; 2]> = LazyLock::new(|| {
    [COARSE, FINE].map(|points| {
        let of_width = |step: usize| {
            let width = (-(step as f64) / RULES_AN_OCTAVE).exp2();
            azimuths(&Stretched { lo: 0.0, centre: 0.0, hi: PI, width, cells: DECAY_CELLS }, points)
        };
        (0..=decay_step(Lobes::LEAST_DECAY_WIDTH)).map(of_width).collect()
    })
});

/// The rule of [`DECAYED`] for a width.
fn decay_step(width: f64) -> usize {
    (-RULES_AN_OCTAVE * width.log2()).round() as usize
}

/// Hands out the light of the tabulated lobes piece by piece: the place of θd, and the masses of interior and rehit.
pub(crate) fn integrate(lobes: &Lobes, theta_i: f64, points: Points, visit: impl FnMut(Place, [f64; 2])) {
    Arch::new().dispatch(Integral { lobes, directions: Directions::new(lobes, theta_i, points), visit });
}

/// Hands out exit directions that resolve the tabulated lobes: the polar angle, φ in [0, π], and the solid angle on both sides of
/// the plane of incidence.
pub(crate) fn directions(
    lobes: &Lobes,
    theta_i: f64,
    points: Points,
    mut visit: impl FnMut(&Polar, f64, f64),
) {
    let directions = Directions::new(lobes, theta_i, points);
    for (o, weight) in &directions.exits {
        for packet in directions.around(lobes, o) {
            let lanes = packet.phi.iter().zip(&packet.weight).filter(|(_, share)| **share > 0.0);
            lanes.for_each(|(phi, share)| visit(o, *phi, weight * share));
        }
    }
}

/// Exit directions that resolve the tabulated lobes at an incidence.
struct Directions {
    i: Polar,
    incidence: super::Incidence,
    points: Points,
    /// Polar angles, each with the solid angle of both sides of the plane of incidence over that in φ.
    exits: Vec<(Polar, f64)>,
    /// Of space tables, the same for all exits.
    tabulated: Option<Azimuths>,
}

impl Directions {
    fn new(lobes: &Lobes, theta_i: f64, points: Points) -> Self {
        let i = Polar::at(theta_i);
        // |s| covers the plane's cells of both signs with one set of exits.
        let mut exits = kinks(&lobes.axis.columns_at(theta_i));
        exits.iter_mut().for_each(|s| *s = s.abs());
        exits.push(0.0);
        let exit = |(theta_o, weight): (f64, f64)| {
            let o = Polar::at(theta_o);
            (o, 2.0 * weight * o.sin)
        };
        Self {
            incidence: lobes.incidence(&i),
            i,
            points,
            exits: rule_between(exits, points.exit).map(exit).collect(),
            tabulated: lobes.axis.phi_at(theta_i).map(|phi| azimuths(&phi, points)),
        }
    }

    fn around(&self, lobes: &Lobes, o: &Polar) -> &[Packet] {
        self.tabulated.as_deref().unwrap_or_else(|| {
            let step = decay_step(lobes.decay_width(&self.incidence, o.sin));
            &DECAYED[self.points.azimuth - 1][step]
        })
    }
}

/// [`integrate`].
struct Integral<'l, V> {
    lobes: &'l Lobes,
    directions: Directions,
    visit: V,
}

impl<V: FnMut(Place, [f64; 2])> WithSimd for Integral<'_, V> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        let Directions { i, incidence, exits, .. } = &self.directions;
        for (o, weight) in exits {
            let ring = self.lobes.ring(incidence, i, o);
            let (plane, up) = (i.sin * o.sin, i.cos * o.cos);
            for packet in self.directions.around(self.lobes, o) {
                // wi·wo = cos θi cos θo − sin θi sin θo cos φ.
                let [steps] = each!(y2 = packet.y2 => {
                    let cos2 = 0.5 * (1.0 + (up - plane * (1.0 - 2.0 * y2)));
                    [Place::steps_of_cos(greatest(cos2, 0.0).sqrt())]
                });
                let places = Steps::of(&steps, (STEPS - 1) as f32);
                let values = self.lobes.values_around(&ring, &packet.y2);
                for k in 0..LANES {
                    let mass = weight * packet.weight[k];
                    (self.visit)(places.place(k), [values[0][k] * mass, values[1][k] * mass]);
                }
            }
        }
    }
}

/// Azimuths that resolve an axis.
fn azimuths(axis: &Stretched, points: Points) -> Azimuths {
    let rule: Vec<(f64, f64)> = rule_between(kinks(axis), points.azimuth).collect();
    let packet = |rule: &[(f64, f64)]| {
        let mut packet = Packet { phi: [0.0; LANES], y2: [0.0; LANES], weight: [0.0; LANES] };
        for (k, (phi, weight)) in rule.iter().enumerate() {
            (packet.phi[k], packet.y2[k], packet.weight[k]) = (*phi, (0.5 * phi).sin().powi(2), *weight);
        }
        packet
    };
    rule.chunks(LANES).map(packet).collect()
}

/// Edges and centres of the cells: what is read between them is smooth.
fn kinks(axis: &Stretched) -> Vec<f64> {
    (0..=2 * axis.cells).map(|half| axis.at(0.5 * half as f64)).collect()
}

/// Coordinates with weights: a Gauss–Legendre rule between every two of the nodes.
fn rule_between(mut nodes: Vec<f64>, least: usize) -> impl Iterator<Item = (f64, f64)> {
    nodes.sort_by(f64::total_cmp);
    let pieces = (1..nodes.len()).flat_map(move |k| {
        let (middle, half) = (0.5 * (nodes[k - 1] + nodes[k]), 0.5 * (nodes[k] - nodes[k - 1]));
        let points = ((2.0 * half / REACH).ceil() as usize).clamp(least, MOST_POINTS);
        RULES[points - 1].iter().map(move |(x, w)| (middle + half * x, half * w))
    });
    pieces.filter(|(_, weight)| *weight > 0.0)
}
