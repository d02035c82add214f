//! Colours in linear sRGB at scales of all thicknesses: section `spectra.thickness` of a table (effect `thickness`).
//!
//! At a scale s the channels at wavelengths need nothing stored but the mean of Ê: at λ they are those of λ/s.

use super::channels::{Means, over_nodes};
use crate::numerics::curve::{self, Curve};
use lut_io::spectra::Spectra;
use rayon::prelude::*;

/// What all bands have in common.
#[derive(Clone, Debug)]
pub(crate) struct Scales {
    /// Ascending, 1 among them.
    pub(crate) scale: Vec<f64>,
    /// Ê over the viewing angle, and the mean of the stored one at wavelengths that it is in units of.
    pub(crate) emission: Vec<[Curve; 3]>,
    pub(crate) emission_mean: Vec<Curve>,
}

/// Lobes of a band at a scale, by channel.
#[derive(Clone, Debug)]
pub(crate) struct Scaled {
    /// M over θd.
    pub(crate) modulation: [Curve; 3],
    /// 1 less the albedo over θi where M is the colour of the lobes.
    pub(crate) rest: [Curve; 3],
}

impl Scales {
    pub(super) fn new(spectra: &Spectra) -> Option<Self> {
        let thickness = spectra.thickness.as_ref()?;
        let one = || curve::curve(|_| 1.0);
        let count = thickness.scale.len();
        let (emission, emission_mean) = match &spectra.emission {
            None => {
                ((0..count).map(|_| [one(), one(), one()]).collect(), (0..count).map(|_| one()).collect())
            }
            Some(part) => {
                let rgb = thickness.radiance_rgb.iter().map(|rows| rgb(&part.theta_deg, rows)).collect();
                let mean = |row: &Vec<f64>| {
                    let rows: Vec<[f64; 1]> = row.iter().map(|mean| [*mean]).collect();
                    let [mean] = &over_nodes(&part.theta_deg, &rows)[..] else { return one() };
                    curve::curve(|node| mean[node])
                };
                (rgb, thickness.radiance_mean.iter().map(mean).collect())
            }
        };
        Some(Self { scale: thickness.scale.clone(), emission, emission_mean })
    }

    /// The scale at or before s, and how far s is towards the next, in ln s; for s from the first scale to the last.
    pub(crate) fn place(&self, s: f64) -> (usize, f64) {
        let k = self.scale.partition_point(|scale| *scale <= s).clamp(1, self.scale.len() - 1) - 1;
        let (from, to) = (self.scale[k], self.scale[k + 1]);
        (k, (s / from).ln() / (to / from).ln())
    }

    /// The smallest and the largest scale.
    pub(crate) fn range(&self) -> [f64; 2] {
        [self.scale[0], self.scale[self.scale.len() - 1]]
    }
}

impl Means {
    /// The lobes at every scale of a table that has colours of them.
    pub(super) fn scaled(&self, spectra: Option<&Spectra>) -> Vec<Scaled> {
        let Some((spectra, thickness)) = spectra.and_then(|all| Some((all, all.thickness.as_ref()?))) else {
            return Vec::new();
        };
        let Some(coherent) = &spectra.coherent else {
            let [one, rest] = [curve::curve(|_| 1.0), self.plain().rest];
            let plain =
                Scaled { modulation: [0; 3].map(|_| one.clone()), rest: [0; 3].map(|_| rest.clone()) };
            return vec![plain; thickness.scale.len()];
        };
        let at = |rows: &Vec<[f64; 3]>| {
            let modulation = rgb(&coherent.theta_deg, rows);
            let wide = modulation.each_ref().map(|m| m.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>());
            let mut lights = self.lights(wide.each_ref().map(Vec::as_slice)).into_iter();
            let rest = [0; 3].map(|_| lights.next().map_or_else(|| self.plain().rest, |light| light.rest));
            Scaled { modulation, rest }
        };
        thickness.modulation_rgb.par_iter().map(at).collect()
    }
}

/// Three channels of stored rows at the nodes of [`curve`].
fn rgb(theta_deg: &[f64], rows: &[[f64; 3]]) -> [Curve; 3] {
    let channels = over_nodes(theta_deg, rows);
    [0, 1, 2].map(|c| curve::curve(|node| channels[c][node]))
}
