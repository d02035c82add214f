//! Many pairs at a call, a packet of [`LANES`] at a time.
//!
//! The arithmetic is that of the calls for one pair, so are the bits, at every SIMD level (no operation is fused or reordered).

use super::colours::{Angles, Viewer};
use super::{AtBand, Evaluation, PearlBsdf, above_horizon, add_weighted, density_of, light_of};
use crate::Direction;
use crate::facets::many::Ranges;
use crate::facets::{Half, OPPOSITE};
use crate::numerics::angles::half_azimuth2;
use crate::numerics::lanes::{Directions, LANES, Lane, Steps, each, put};
use pulp::{Arch, Simd, WithSimd};

/// Pairs above the horizon, with what their lobes need.
pub(crate) struct Pairs {
    pub(crate) valid: [bool; LANES],
    pub(crate) i: Directions,
    pub(crate) o: Directions,
    pub(crate) y2: Lane,
    halves: Halves,
    /// As in [`super::Geometry`].
    facing: Lane,
}

/// [`Half`] of every lane.
struct Halves {
    h: [Lane; 3],
    slope2: Lane,
    steep: Lane,
    inverse_z: Lane,
    cos: Lane,
}

impl Halves {
    #[inline(always)]
    fn new(i: &Directions, o: &Directions) -> Self {
        let [ix, iy, iz] = &i.w;
        let [ox, oy, oz] = &o.w;
        let [x, y, z, slope2, steep, inverse_z, cos, length2] = each!(ix = ix, iy = iy, iz = iz, ox = ox, oy = oy, oz = oz => {
            let (half, length2) = Half::of_apart([ix, iy, iz], [ox, oy, oz]);
            let Half { h: [x, y, z], slope2, steep, inverse_z, cos } = half;
            [x, y, z, slope2, steep, inverse_z, cos, length2]
        });
        let mut this = Self { h: [x, y, z], slope2, steep, inverse_z, cos };
        if length2.iter().any(|length2| *length2 < OPPOSITE) {
            for (k, length2) in length2.iter().enumerate() {
                if *length2 < OPPOSITE {
                    this.put(k, &Half::new(i.direction(k), o.direction(k)));
                }
            }
        }
        this
    }

    #[cold]
    fn put(&mut self, lane: usize, half: &Half) {
        for (lanes, x) in self.h.iter_mut().zip(half.h) {
            lanes[lane] = x;
        }
        (self.slope2[lane], self.steep[lane]) = (half.slope2, half.steep);
        (self.inverse_z[lane], self.cos[lane]) = (half.inverse_z, half.cos);
    }

    #[inline(always)]
    fn half(&self, lane: usize) -> Half {
        Half {
            h: self.h.each_ref().map(|x| x[lane]),
            slope2: self.slope2[lane],
            steep: self.steep[lane],
            inverse_z: self.inverse_z[lane],
            cos: self.cos[lane],
        }
    }
}

/// Light of every pair short of its colour, and where the colour is read.
pub(crate) struct Shades {
    mirror: Lane,
    blur: Lane,
    half: Steps,
}

/// [`PearlBsdf::eval_many`] of one band.
pub(crate) struct Evaluated<'a> {
    pub(crate) pearl: AtBand<'a>,
    pub(crate) wi: &'a [Direction],
    pub(crate) wo: &'a [Direction],
    pub(crate) viewer: Viewer,
    pub(crate) out: &'a mut [Evaluation],
}

impl WithSimd for Evaluated<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let packets = self.wi.chunks(LANES).zip(self.wo.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((wi, wo), out) in packets {
            self.pearl.eval_packet(wi, wo, self.viewer, out);
        }
    }
}

/// [`PearlBsdf::pdf_many`].
pub(crate) struct Densities<'a> {
    pub(crate) pearl: &'a PearlBsdf,
    pub(crate) wi: &'a [Direction],
    pub(crate) wo: &'a [Direction],
    pub(crate) out: &'a mut [f64],
}

impl WithSimd for Densities<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let packets = self.wi.chunks(LANES).zip(self.wo.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((wi, wo), out) in packets {
            self.pearl.pdf_packet(wi, wo, out);
        }
    }
}

impl PearlBsdf {
    /// [`Self::eval`] of every pair, the same bits, in less time a pair: a packet of pairs shares vector instructions.
    ///
    /// For renderers that shade many points at once (wavefronts, packets of rays). The processor is asked at run time what
    /// instructions it has.
    ///
    /// # Panics
    /// If the slices are not of one length.
    pub fn eval_many(&self, wi: &[Direction], wo: &[Direction], out: &mut [Evaluation]) {
        self.evaluate_many(wi, wo, Viewer::AtExit, out);
    }

    /// [`Self::eval_seen`] of every pair, as [`Self::eval_many`] is [`Self::eval`].
    ///
    /// # Panics
    /// If the slices are not of one length.
    pub fn eval_seen_many(&self, view: &[Direction], light: &[Direction], out: &mut [Evaluation]) {
        self.evaluate_many(view, light, Viewer::AtIncidence, out);
    }

    fn evaluate_many(&self, wi: &[Direction], wo: &[Direction], viewer: Viewer, out: &mut [Evaluation]) {
        assert_of_one_length(wi.len(), wo.len(), out.len());
        if !self.is_dispersed() {
            return Arch::new().dispatch(Evaluated { pearl: self.own(), wi, wo, viewer, out });
        }
        for ((wi, wo), out) in wi.chunks(LANES).zip(wo.chunks(LANES)).zip(out.chunks_mut(LANES)) {
            self.eval_bands(wi, wo, viewer, out);
        }
    }

    /// A packet of all bands: each channel takes its share of each lobe.
    fn eval_bands(&self, wi: &[Direction], wo: &[Direction], viewer: Viewer, out: &mut [Evaluation]) {
        let mut sums = [[[0.0; 3]; 4]; LANES];
        for (k, weight) in self.prepared.rgb_weights.iter().enumerate() {
            Arch::new().dispatch(Evaluated { pearl: self.band(k), wi, wo, viewer, out: &mut *out });
            for (sum, value) in sums.iter_mut().zip(out.iter()) {
                add_weighted(sum, weight, &value.parts());
            }
        }
        for (out, sum) in out.iter_mut().zip(sums) {
            *out = light_of(sum);
        }
    }

    /// [`Self::pdf`] of every pair, as [`Self::eval_many`] is [`Self::eval`].
    ///
    /// # Panics
    /// If the slices are not of one length.
    pub fn pdf_many(&self, wi: &[Direction], wo: &[Direction], out: &mut [f64]) {
        assert_of_one_length(wi.len(), wo.len(), out.len());
        Arch::new().dispatch(Densities { pearl: self, wi, wo, out });
    }

    #[inline(always)]
    fn pdf_packet(&self, wi: &[Direction], wo: &[Direction], out: &mut [f64]) {
        let own = self.own();
        let pairs = own.pairs(wi, wo);
        let at = own.band.lobes.incidences(&pairs.i);
        let lobes = own.band.lobes.densities_of(&at, &pairs.o, &pairs.y2);
        let (chances, across) = (self.chances_of(&pairs.i), own.band.facets.ranges_across(&pairs.i));
        let densities = own.density_packet(&pairs, &chances, &across, &lobes);
        out.copy_from_slice(&densities[..out.len()]);
    }

    /// [`PearlBsdf::chances`] of every lane.
    #[inline(always)]
    pub(crate) fn chances_of(&self, i: &Directions) -> [Lane; 4] {
        let mut chances = [[0.0; LANES]; 4];
        for k in 0..LANES {
            put(&mut chances, k, self.chances(i.place.place(k)));
        }
        chances
    }
}

impl AtBand<'_> {
    #[inline(always)]
    fn eval_packet(&self, wi: &[Direction], wo: &[Direction], viewer: Viewer, out: &mut [Evaluation]) {
        let pairs = self.pairs(wi, wo);
        let at = self.band.lobes.incidences(&pairs.i);
        let values = self.band.lobes.values_of(&at, &pairs.i, &pairs.o, &pairs.y2);
        let shades = self.shades(&pairs, &values);
        for (k, out) in out.iter_mut().enumerate().take(LANES) {
            if pairs.valid[k] {
                self.colour_lane(&pairs, &shades, k, viewer, out);
            } else {
                *out = Evaluation::default();
            }
        }
    }

    #[inline(always)]
    fn pairs(&self, wi: &[Direction], wo: &[Direction]) -> Pairs {
        let mut valid = [false; LANES];
        for ((valid, wi), wo) in valid.iter_mut().zip(wi).zip(wo) {
            *valid = above_horizon(*wi) && above_horizon(*wo);
        }
        self.pairs_of(valid, Directions::new(wi, &valid), Directions::new(wo, &valid))
    }

    #[inline(always)]
    pub(crate) fn pairs_of(&self, valid: [bool; LANES], i: Directions, o: Directions) -> Pairs {
        let [y2] = each!(a = i.azimuth[0], b = i.azimuth[1], c = o.azimuth[0], d = o.azimuth[1] => {
            [half_azimuth2((a, b), (c, d))]
        });
        let halves = Halves::new(&i, &o);
        let mut facing = [0.0; LANES];
        for (k, facing) in facing.iter_mut().enumerate() {
            *facing = self.band.facets.facing(&halves.half(k));
        }
        Pairs { valid, i, o, y2, halves, facing }
    }

    /// What colours multiply, from what the tabulated lobes have of every pair.
    #[inline(always)]
    pub(crate) fn shades(&self, pairs: &Pairs, [interior, rehit]: &[Lane; 2]) -> Shades {
        let Pairs { i, o, halves, facing, .. } = pairs;
        let mut mirror = [0.0; LANES];
        for (k, mirror) in mirror.iter_mut().enumerate() {
            *mirror = self.band.facets.reflection(&halves.half(k), facing[k]);
        }
        for (k, mirror) in mirror.iter_mut().enumerate() {
            let scale = self.mirror_factor(i.place.place(k), o.place.place(k), o.cos()[k]);
            *mirror = rehit[k] + *mirror * scale;
        }
        Shades { mirror, blur: *interior, half: Steps::of_cosines(&halves.cos) }
    }

    /// f·cos θo of one pair.
    #[inline(always)]
    pub(crate) fn colour_lane(
        &self,
        pairs: &Pairs,
        shades: &Shades,
        k: usize,
        viewer: Viewer,
        out: &mut Evaluation,
    ) {
        let Pairs { i, o, .. } = pairs;
        let (incidence, exit) = (i.place.place(k), o.place.place(k));
        let angles = Angles { incidence, exit, half: shades.half.place(k) };
        *out = self.coloured(self.rgb, angles, o.cos()[k], [shades.mirror[k], shades.blur[k]], viewer);
    }

    /// Density of every pair from those of the tabulated lobes; 0 where a direction is below the horizon.
    #[inline(always)]
    pub(crate) fn density_packet(
        &self,
        pairs: &Pairs,
        chances: &[Lane; 4],
        across: &Ranges,
        lobes: &[Lane; 2],
    ) -> Lane {
        let Pairs { valid, i, o, halves, facing, .. } = pairs;
        let mut q = [0.0; LANES];
        for (k, q) in q.iter_mut().enumerate() {
            *q = halves.half(k).slope_across((i.azimuth[0][k], i.azimuth[1][k]));
        }
        let facets = self.band.facets.pdfs(i, across, &q, facing);
        let [interior, rehit, surface, base] = chances;
        let [densities] = each!(valid = valid, interior = interior, rehit = rehit, surface = surface, base = base, cos_o = o.cos(), a = lobes[0], b = lobes[1], facets = facets => {
            let density = density_of(&[interior, rehit, surface, base], cos_o, [a, b], facets);
            [if valid { density } else { 0.0 }]
        });
        densities
    }
}

pub(crate) fn assert_of_one_length(a: usize, b: usize, c: usize) {
    assert!(a == b && b == c, "slices of {a}, {b} and {c} do not go together");
}
