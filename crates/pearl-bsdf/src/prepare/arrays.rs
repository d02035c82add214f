//! The arrays by name.

use super::channels::{Channels, Coloured, Kind, Light};
use super::thickness::{Scaled, Scales};
use super::{Band, Prepared};
use crate::lobes::distribution::Distribution;
use crate::numerics::curve::{Curve, NODES};
use std::f64::consts::FRAC_PI_2;

/// A named array, last index fastest.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Array {
    /// Name, as in `docs/ARRAYS.md`.
    pub name: &'static str,
    /// Number of entries along each index; empty of a single number.
    pub shape: Vec<usize>,
    /// As many as the product of the shape.
    pub values: Vec<f32>,
}

/// Of the arrays' meaning: another number, another evaluation.
const VERSION: f64 = 1.0;

impl Array {
    /// An array; as many values as the product of the shape.
    pub fn new(name: &'static str, shape: &[usize], values: impl IntoIterator<Item = f32>) -> Self {
        let values: Vec<f32> = values.into_iter().collect();
        debug_assert_eq!(values.len(), shape.iter().product::<usize>(), "{name}");
        Self { name, shape: shape.to_vec(), values }
    }

    fn number(name: &'static str, value: f64) -> Self {
        Self::new(name, &[], [value as f32])
    }
}

impl Prepared {
    /// All arrays, in the order of `docs/ARRAYS.md`, which says what each of them means.
    #[must_use]
    pub fn arrays(&self) -> Vec<Array> {
        let lobes = &self.bands[0].lobes;
        let flag = |is: bool| f64::from(u8::from(is));
        let mut arrays = vec![
            Array::number("version", VERSION),
            Array::number("space", flag(!lobes.signed())),
            Array::number("reciprocal", flag(lobes.reciprocal)),
            Array::number("visible", flag(self.bands[0].facets.visible)),
            Array::number("cell_width", lobes.cell_width),
            Array::number("cap_radius", lobes.cap.radius),
        ];
        arrays.extend(self.of_bands());
        arrays.extend(self.of_lobes());
        arrays.extend(self.of_distributions());
        let (bands, curve) = (self.bands.len(), NODES);
        let light = |of: fn(&Light) -> &[Curve]| {
            over(&self.bands, |band| flat(of(&band.plain).iter().map(|c| &c[..])))
        };
        arrays.extend([
            Array::new("mean_weight", &[curve], self.mean_weights.iter().copied()),
            Array::new("mirror", &[bands, curve], over(&self.bands, |band| band.mirror.to_vec())),
            Array::new("albedo_plain", &[bands, 3, curve], light(|light| &light.albedo)),
            Array::new("rest_plain", &[bands, curve], light(|light| std::slice::from_ref(&light.rest))),
        ]);
        arrays.extend(self.of_channels(Kind::Rgb, RGB));
        arrays.extend(self.of_channels(Kind::Spectral, SPECTRAL));
        arrays.extend(self.of_scales());
        let look = self.look();
        arrays.extend([
            Array::number("depth", look.depth),
            Array::number("brightness", look.brightness),
            Array::number("coherence", look.coherence),
            Array::new("body_rgb", &[3], look.body_rgb.map(|channel| channel as f32)),
        ]);
        arrays
    }

    fn of_bands(&self) -> [Array; 4] {
        let count = self.bands.len();
        let of = |name, number: fn(&Band) -> f64| {
            Array::new(name, &[count], self.bands.iter().map(|band| number(band) as f32))
        };
        [
            of("wavelength_nm", |band| band.wavelength_nm),
            Array::new("rgb_weights", &[count, 3], self.rgb_weights.iter().flatten().map(|w| *w as f32)),
            of("slope_sd", |band| band.facets.slope_sd()),
            of("index_ratio", |band| f64::from(band.facets.index_ratio)),
        ]
    }

    fn of_lobes(&self) -> [Array; 5] {
        let (bands, lobes) = (self.bands.len(), &self.bands[0].lobes);
        let (spans, incidences) = (lobes.spans.len(), lobes.totals.len());
        let starts = lobes.spans.iter().map(|span| span.from as f32).chain([FRAC_PI_2 as f32]);
        let nodes = lobes.spans.iter().flat_map(|span| [span.node as f32, span.next as f32]);
        let widths = over(&self.bands, |band| {
            band.lobes.spans.iter().flat_map(|span| [span.width, span.width + span.widening]).collect()
        });
        let curves = over(&self.bands, |band| band.lobes.span_curves.concat());
        let cells = over(&self.bands, |band| band.lobes.cells.concat());
        [
            Array::new("span_start", &[spans + 1], starts),
            Array::new("span_node", &[spans, 2], nodes),
            Array::new("azimuth_width", &[bands, spans, 2], widths),
            Array::new("span_curves", &[bands, spans, lobes.span_steps + 1, 4], curves),
            Array::new("cells", &[bands, incidences, lobes.rows, lobes.columns, 4], cells),
        ]
    }

    fn of_distributions(&self) -> [Array; 6] {
        let (bands, lobes) = (self.bands.len(), &self.bands[0].lobes);
        let (incidences, rows, columns) = (lobes.totals.len(), lobes.rows, lobes.columns);
        let totals = over(&self.bands, |band| {
            [0, 1].iter().flat_map(|lobe| band.lobes.totals.iter().map(|total| total[*lobe])).collect()
        });
        let of = |part: fn(&Distribution) -> Vec<f32>| {
            over(&self.bands, |band| band.lobes.distributions.iter().flat_map(part).collect())
        };
        let cells = [bands, 2, incidences, rows, columns];
        [
            Array::new("total", &cells[..3], totals),
            Array::new("row_total", &cells[..4], of(|d| d.row_total.clone())),
            Array::new("row_cumulative", &cells[..4], of(|d| d.row_cumulative.clone())),
            Array::new("row_guide", &cells[..4], of(|d| numbers(&d.row_guide))),
            Array::new("cumulative", &cells, of(|d| d.cumulative.clone())),
            Array::new("guide", &cells, of(|d| numbers(&d.guide))),
        ]
    }

    fn of_channels(&self, kind: Kind, names: [&'static str; 5]) -> Vec<Array> {
        let Channels { wavelength_nm, reflectance, emission } = self.kind(kind);
        let (bands, channels) = (self.bands.len(), reflectance.len());
        let of = |part: fn(&Coloured) -> Vec<f32>| {
            over(&self.bands, |band| band.channels(kind).iter().map(part).collect::<Vec<_>>().concat())
        };
        let [reflectances, emissions, modulations, albedos, rests] = names;
        let mut arrays = Vec::new();
        if matches!(kind, Kind::Spectral) {
            arrays.push(Array::new("channel_nm", &[channels], wavelength_nm.iter().map(|nm| *nm as f32)));
        }
        arrays.extend([
            Array::new(reflectances, &[channels, 3], reflectance.iter().flatten().map(|x| *x as f32)),
            Array::new(emissions, &[channels, NODES], flat(emission.iter().map(|c| &c[..]))),
            Array::new(modulations, &[bands, channels, NODES], of(|c| c.modulation.to_vec())),
            Array::new(
                albedos,
                &[bands, channels, 3, NODES],
                of(|c| flat(c.light.albedo.iter().map(|c| &c[..]))),
            ),
            Array::new(rests, &[bands, channels, NODES], of(|c| c.light.rest.to_vec())),
        ]);
        arrays
    }
}

impl Prepared {
    /// Nothing of a table of one thickness.
    fn of_scales(&self) -> Vec<Array> {
        let Some(Scales { scale, emission, emission_mean }) = &self.scales else { return Vec::new() };
        let (bands, scales) = (self.bands.len(), scale.len());
        let of = |part: fn(&Scaled) -> &[Curve; 3]| -> Vec<f32> {
            let scaled = (0..scales).flat_map(|k| self.bands.iter().map(move |band| &band.scaled[k]));
            flat(scaled.flat_map(|scaled| part(scaled).iter().map(|c| &c[..])))
        };
        let shape = [scales, bands, 3, NODES];
        vec![
            Array::new("scale", &[scales], scale.iter().map(|s| *s as f32)),
            Array::new(
                "emission_rgb_scaled",
                &[scales, 3, NODES],
                flat(emission.iter().flatten().map(|c| &c[..])),
            ),
            Array::new("emission_mean_scaled", &[scales, NODES], flat(emission_mean.iter().map(|c| &c[..]))),
            Array::new("modulation_rgb_scaled", &shape, of(|scaled| &scaled.modulation)),
            Array::new("rest_rgb_scaled", &shape, of(|scaled| &scaled.rest)),
        ]
    }
}

const RGB: [&str; 5] = ["reflectance_rgb", "emission_rgb", "modulation_rgb", "albedo_rgb", "rest_rgb"];
const SPECTRAL: [&str; 5] =
    ["reflectance_spectral", "emission_spectral", "modulation_spectral", "albedo_spectral", "rest_spectral"];

/// What each band has, one behind the other.
fn over(bands: &[Band], of: impl Fn(&Band) -> Vec<f32>) -> Vec<f32> {
    bands.iter().map(of).collect::<Vec<_>>().concat()
}

fn flat<'a>(parts: impl Iterator<Item = &'a [f32]>) -> Vec<f32> {
    parts.collect::<Vec<_>>().concat()
}

fn numbers(whole: &[u16]) -> Vec<f32> {
    whole.iter().map(|number| f32::from(*number)).collect()
}
