//! Many pairs at a call, a packet of [`LANES`] at a time.
//!
//! The arithmetic is that of the calls for one pair, so are the bits, at every SIMD level (no operation is fused or reordered).

use super::{Angles, Dispersed, Evaluation, PearlBsdf, Sample, Viewer};
use super::{
    BASE, INTERIOR, REHIT, SURFACE, above_horizon, add_weighted, choose, cosine_hemisphere, density_of,
    direction, light_of,
};
use crate::Direction;
use crate::angles::half_azimuth2;
use crate::facets::many::Ranges;
use crate::facets::{Half, OPPOSITE};
use crate::lanes::{Directions, LANES, Lane, Steps, each, put};
use crate::tabulated::Exit;
use crate::tabulated::many::Incidences;
use pulp::{Arch, Simd, WithSimd};

/// What a sample is filled in over.
const BLANK: Sample = Sample {
    wo: [0.0; 3],
    pdf: 0.0,
    value: Evaluation { diffuse: [0.0; 3], incoherent: [0.0; 3], mirror: [0.0; 3], blur: [0.0; 3] },
};

/// Pairs above the horizon, with what their lobes need.
struct Pairs {
    valid: [bool; LANES],
    i: Directions,
    o: Directions,
    y2: Lane,
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
struct Shades {
    mirror: Lane,
    blur: Lane,
    half: Steps,
}

/// [`PearlBsdf::eval_many`] of the table's own wavelength.
struct Evaluated<'a> {
    pearl: &'a PearlBsdf,
    wi: &'a [Direction],
    wo: &'a [Direction],
    viewer: Viewer,
    out: &'a mut [Evaluation],
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
struct Densities<'a> {
    pearl: &'a PearlBsdf,
    wi: &'a [Direction],
    wo: &'a [Direction],
    out: &'a mut [f64],
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

/// [`PearlBsdf::sample_many`].
struct Sampled<'a> {
    pearl: &'a PearlBsdf,
    wi: &'a [Direction],
    numbers: &'a [[f64; 3]],
    out: &'a mut [Option<Sample>],
}

impl WithSimd for Sampled<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let packets = self.wi.chunks(LANES).zip(self.numbers.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((wi, numbers), out) in packets {
            self.pearl.sample_packet(wi, numbers, out);
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
        let Some(dispersed) = &self.dispersed else {
            return Arch::new().dispatch(Evaluated { pearl: self, wi, wo, viewer, out });
        };
        for ((wi, wo), out) in wi.chunks(LANES).zip(wo.chunks(LANES)).zip(out.chunks_mut(LANES)) {
            dispersed.eval_packet(self, wi, wo, viewer, out);
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

    /// [`Self::sample`] of every incidence with its three random numbers, as [`Self::eval_many`] is [`Self::eval`].
    ///
    /// # Panics
    /// If the slices are not of one length.
    pub fn sample_many(&self, wi: &[Direction], numbers: &[[f64; 3]], out: &mut [Option<Sample>]) {
        assert_of_one_length(wi.len(), numbers.len(), out.len());
        Arch::new().dispatch(Sampled { pearl: self, wi, numbers, out });
    }

    #[inline(always)]
    fn eval_packet(&self, wi: &[Direction], wo: &[Direction], viewer: Viewer, out: &mut [Evaluation]) {
        let pairs = self.pairs(wi, wo);
        let at = self.tabulated.incidences(&pairs.i);
        let values = self.tabulated.values_of(&at, &pairs.i, &pairs.o, &pairs.y2);
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
    fn pdf_packet(&self, wi: &[Direction], wo: &[Direction], out: &mut [f64]) {
        let pairs = self.pairs(wi, wo);
        let at = self.tabulated.incidences(&pairs.i);
        let lobes = self.tabulated.densities_of(&at, &pairs.o, &pairs.y2);
        let (chances, across) = (self.chances_of(&pairs.i), self.facets.ranges_across(&pairs.i));
        let densities = self.density_packet(&pairs, &chances, &across, &lobes);
        out.copy_from_slice(&densities[..out.len()]);
    }

    #[inline(always)]
    fn sample_packet(&self, wi: &[Direction], numbers: &[[f64; 3]], out: &mut [Option<Sample>]) {
        let mut valid = [false; LANES];
        for (valid, wi) in valid.iter_mut().zip(wi) {
            *valid = above_horizon(*wi);
        }
        let i = Directions::new(wi, &valid);
        let at = self.tabulated.incidences(&i);
        let across = self.facets.ranges_across(&i);
        let chances = self.chances_of(&i);
        let wo = self.draws(&i, &at, &chances, &across, numbers);
        for (valid, wo) in valid.iter_mut().zip(&wo) {
            *valid &= above_horizon(*wo);
        }
        let pairs = self.pairs_of(valid, i, Directions::new(&wo, &valid));
        let (values, lobes) = self.tabulated.lights_of(&at, &pairs.i, &pairs.o, &pairs.y2);
        let shades = self.shades(&pairs, &values);
        let densities = self.density_packet(&pairs, &chances, &across, &lobes);
        for (k, out) in out.iter_mut().enumerate().take(LANES) {
            let (wo, pdf) = (wo[k], densities[k]);
            *out = None;
            if valid[k] && pdf > 0.0 && pdf.is_finite() {
                // Filled where it lies: a copy would wait for what was written a moment ago.
                let sample = out.insert(BLANK);
                (sample.wo, sample.pdf) = (wo, pdf);
                if self.dispersed.is_some() {
                    // The lobe at the table's own wavelength is what is sampled.
                    sample.value = self.eval(wi[k], wo);
                } else {
                    self.colour_lane(&pairs, &shades, k, Viewer::AtExit, &mut sample.value);
                }
            }
        }
    }

    /// An exit direction of every lane, or what is none. Every technique makes one in every lane, which is less work than to
    /// take the lanes apart; only what is looked up in the table is left out where it is not wanted.
    #[inline(always)]
    fn draws(
        &self,
        i: &Directions,
        at: &Incidences,
        chances: &[Lane; 4],
        across: &Ranges,
        numbers: &[[f64; 3]],
    ) -> [Direction; LANES] {
        let mut u = [[0.0; LANES]; 3];
        for (k, numbers) in numbers.iter().enumerate().take(LANES) {
            put(&mut u, k, *numbers);
        }
        let mut part = [0; LANES];
        for k in 0..LANES {
            let chances = [chances[0][k], chances[1][k], chances[2][k], chances[3][k]];
            (part[k], u[0][k]) = choose(&chances, u[0][k]);
        }
        let azimuth = &i.azimuth;
        let exits = self.tabulated.exits(at, &part, &u);
        let [x, y, z] = each!(part = part, along = azimuth[0], across = azimuth[1], u2 = u[1], u3 = u[2],
            cos = exits[0], sin = exits[1], cos_phi = exits[2], sin_phi = exits[3] => {
            let (base, tabulated) = (cosine_hemisphere(u2, u3), Exit { cos, sin, azimuth: (cos_phi, sin_phi) });
            direction((along, across), if part == BASE { &base } else { &tabulated })
        });
        let facets = self.facets.samples(i, across, &u[1], &u[2]);
        let [x, y, z] = each!(part = part, x = x, y = y, z = z, fx = facets[0], fy = facets[1], fz = facets[2] => {
            if part == SURFACE { [fx, fy, fz] } else { [x, y, z] }
        });
        let mut wo = [[0.0; 3]; LANES];
        for (k, wo) in wo.iter_mut().enumerate() {
            *wo = [x[k], y[k], z[k]];
        }
        wo
    }

    /// [`PearlBsdf::chances`] of every lane.
    #[inline(always)]
    fn chances_of(&self, i: &Directions) -> [Lane; 4] {
        let mut chances = [[0.0; LANES]; 4];
        for k in 0..LANES {
            put(&mut chances, k, self.chances(i.place.place(k)));
        }
        chances
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
    fn pairs_of(&self, valid: [bool; LANES], i: Directions, o: Directions) -> Pairs {
        let [y2] = each!(a = i.azimuth[0], b = i.azimuth[1], c = o.azimuth[0], d = o.azimuth[1] => {
            [half_azimuth2((a, b), (c, d))]
        });
        let halves = Halves::new(&i, &o);
        let mut facing = [0.0; LANES];
        for (k, facing) in facing.iter_mut().enumerate() {
            *facing = self.facets.facing(&halves.half(k));
        }
        Pairs { valid, i, o, y2, halves, facing }
    }

    /// What colours multiply, from what the tabulated lobes have of every pair.
    #[inline(always)]
    fn shades(&self, pairs: &Pairs, [interior, rehit]: &[Lane; 2]) -> Shades {
        let Pairs { i, o, halves, facing, .. } = pairs;
        let mut mirror = [0.0; LANES];
        for (k, mirror) in mirror.iter_mut().enumerate() {
            *mirror = self.facets.reflection(&halves.half(k), facing[k]);
        }
        for (k, mirror) in mirror.iter_mut().enumerate() {
            let scale = self.mirror_factor(i.place.place(k), o.place.place(k), o.cos()[k]);
            *mirror = rehit[k] + *mirror * scale;
        }
        Shades { mirror, blur: *interior, half: Steps::of_cosines(&halves.cos) }
    }

    /// f·cos θo of one pair.
    #[inline(always)]
    fn colour_lane(&self, pairs: &Pairs, shades: &Shades, k: usize, viewer: Viewer, out: &mut Evaluation) {
        let Pairs { i, o, .. } = pairs;
        let (incidence, exit) = (i.place.place(k), o.place.place(k));
        let angles = Angles { incidence, exit, half: shades.half.place(k) };
        *out = self.coloured(&self.rgb, angles, o.cos()[k], [shades.mirror[k], shades.blur[k]], viewer);
    }

    /// Density of every pair from those of the tabulated lobes; 0 where a direction is below the horizon.
    #[inline(always)]
    fn density_packet(&self, pairs: &Pairs, chances: &[Lane; 4], across: &Ranges, lobes: &[Lane; 2]) -> Lane {
        let Pairs { valid, i, o, halves, facing, .. } = pairs;
        let mut q = [0.0; LANES];
        for (k, q) in q.iter_mut().enumerate() {
            *q = halves.half(k).slope_across((i.azimuth[0][k], i.azimuth[1][k]));
        }
        let facets = self.facets.pdfs(i, across, &q, facing);
        let [densities] = each!(valid = valid, interior = chances[INTERIOR], rehit = chances[REHIT], surface = chances[SURFACE],
            base = chances[BASE], cos_o = o.cos(), a = lobes[0], b = lobes[1], facets = facets => {
            let density = density_of(&[interior, rehit, surface, base], cos_o, [a, b], facets);
            [if valid { density } else { 0.0 }]
        });
        densities
    }
}

impl Dispersed {
    /// A packet of all bands: each channel takes its share of each lobe.
    fn eval_packet(
        &self,
        own: &PearlBsdf,
        wi: &[Direction],
        wo: &[Direction],
        viewer: Viewer,
        out: &mut [Evaluation],
    ) {
        let mut sums = [[[0.0; 3]; 4]; LANES];
        for (band, weight) in self.weights.iter().enumerate() {
            let pearl = self.pearl(own, band);
            Arch::new().dispatch(Evaluated { pearl, wi, wo, viewer, out: &mut *out });
            for (sum, value) in sums.iter_mut().zip(out.iter()) {
                add_weighted(sum, weight, &value.parts());
            }
        }
        for (out, sum) in out.iter_mut().zip(sums) {
            *out = light_of(sum);
        }
    }
}

fn assert_of_one_length(a: usize, b: usize, c: usize) {
    assert!(a == b && b == c, "slices of {a}, {b} and {c} do not go together");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Controls, specimen};
    use pulp::Scalar;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    /// Instruction sets, the narrowest first.
    const LEVELS: usize = 3;

    /// Runs an operation with the instructions of one set; does nothing where this processor lacks them.
    fn run(level: usize, operation: impl WithSimd<Output = ()>) -> Option<()> {
        #[cfg(target_arch = "x86_64")]
        match level {
            0 => Scalar.vectorize(operation),
            1 => Simd::vectorize(pulp::x86::V3::try_new()?, operation),
            _ => Simd::vectorize(pulp::x86::V4::try_new()?, operation),
        }
        #[cfg(not(target_arch = "x86_64"))]
        match level {
            0 => Scalar.vectorize(operation),
            _ => Arch::new().dispatch(operation),
        }
        Some(())
    }

    fn direction(random: &mut StdRng) -> Direction {
        let (theta, phi): (f64, f64) = (1.6 * random.random::<f64>(), 6.3 * random.random::<f64>());
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
    }

    type Found = (Vec<Evaluation>, Vec<f64>, Vec<Option<Sample>>);

    fn found(pearl: &PearlBsdf, level: usize) -> Option<Found> {
        let mut random = StdRng::seed_from_u64(41);
        let (wi, wo): (Vec<_>, Vec<_>) =
            (0..1000).map(|_| (direction(&mut random), direction(&mut random))).unzip();
        let numbers: Vec<[f64; 3]> = (0..1000).map(|_| random.random()).collect();
        let (mut values, mut densities, mut samples) =
            (vec![Evaluation::default(); 1000], vec![0.0; 1000], vec![None; 1000]);
        let (wi, wo, viewer) = (&wi, &wo, Viewer::AtExit);
        run(level, Evaluated { pearl, wi, wo, viewer, out: &mut values })?;
        run(level, Densities { pearl, wi, wo, out: &mut densities })?;
        run(level, Sampled { pearl, wi, numbers: &numbers, out: &mut samples })?;
        Some((values, densities, samples))
    }

    #[test]
    #[allow(clippy::print_stderr)] // what is skipped is said
    fn every_instruction_set_gives_the_same_numbers() {
        let incidences: Vec<f64> = (0..=18).map(|i| 5.0 * f64::from(i)).collect();
        let controls = Controls { depth: 0.0, coherence: 0.0, ..Controls::default() };
        for table in [specimen::plane(&incidences, 96), specimen::space(&incidences, 48, 32)] {
            let pearl = PearlBsdf::from_table(table, controls).unwrap();
            let narrowest = found(&pearl, 0).unwrap();
            assert!(narrowest.2.iter().flatten().count() > 900, "the pearl is sampled");
            for level in 1..LEVELS {
                let Some(wider) = found(&pearl, level) else {
                    eprintln!("skipped: this processor lacks the instructions of level {level}");
                    continue;
                };
                assert!(wider == narrowest, "level {level}");
            }
        }
    }
}
