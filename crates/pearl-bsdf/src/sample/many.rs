//! Samples of many incidences at a call, as [`crate::eval`] does many pairs.

use super::lobes::{Exit, OUTSIDE, side_of};
use super::{BASE, SURFACE, Sample, choose, cosine_hemisphere, direction};
use crate::Direction;
use crate::eval::many::assert_of_one_length;
use crate::eval::{AtBand, Evaluation, PearlBsdf, Viewer, above_horizon};
use crate::facets::many::Ranges;
use crate::lobes::Lobes;
use crate::lobes::azimuth::Forward;
use crate::lobes::distribution::Found;
use crate::lobes::many::Incidences;
use crate::numerics::angles::{INVERSE_TAU, turned};
use crate::numerics::lanes::{Directions, LANES, Lane, Single, each, put};
use pulp::{Arch, Simd, WithSimd};

/// What a sample is filled in over.
const BLANK: Sample = Sample {
    wo: [0.0; 3],
    pdf: 0.0,
    value: Evaluation { diffuse: [0.0; 3], incoherent: [0.0; 3], mirror: [0.0; 3], blur: [0.0; 3] },
};

/// [`PearlBsdf::sample_many`].
struct Sampled<'a> {
    pearl: &'a PearlBsdf,
    wi: &'a [Direction],
    numbers: &'a [[f64; 3]],
    viewer: Viewer,
    out: &'a mut [Option<Sample>],
}

impl WithSimd for Sampled<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let packets = self.wi.chunks(LANES).zip(self.numbers.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((wi, numbers), out) in packets {
            self.pearl.sample_packet(wi, numbers, self.viewer, out);
        }
    }
}

impl PearlBsdf {
    /// [`Self::sample`] of every incidence with its three random numbers, as [`Self::eval_many`] is [`Self::eval`].
    ///
    /// # Panics
    /// If the slices are not of one length.
    pub fn sample_many(&self, wi: &[Direction], numbers: &[[f64; 3]], out: &mut [Option<Sample>]) {
        self.sample_for(wi, numbers, Viewer::AtExit, out);
    }

    /// As [`Self::sample_many`], with the value that [`Self::eval_seen`] has of each pair: wi looks at the surface.
    ///
    /// # Panics
    /// If the slices are not of one length.
    pub fn sample_seen_many(&self, wi: &[Direction], numbers: &[[f64; 3]], out: &mut [Option<Sample>]) {
        self.sample_for(wi, numbers, Viewer::AtIncidence, out);
    }

    fn sample_for(&self, wi: &[Direction], numbers: &[[f64; 3]], viewer: Viewer, out: &mut [Option<Sample>]) {
        assert_of_one_length(wi.len(), numbers.len(), out.len());
        Arch::new().dispatch(Sampled { pearl: self, wi, numbers, viewer, out });
    }

    #[inline(always)]
    fn sample_packet(
        &self,
        wi: &[Direction],
        numbers: &[[f64; 3]],
        viewer: Viewer,
        out: &mut [Option<Sample>],
    ) {
        let mut valid = [false; LANES];
        for (valid, wi) in valid.iter_mut().zip(wi) {
            *valid = above_horizon(*wi);
        }
        let i = Directions::new(wi, &valid);
        let own = self.own();
        let at = own.band.lobes.incidences(&i);
        let across = own.band.facets.ranges_across(&i);
        let chances = self.chances_of(&i);
        let wo = own.draws(&i, &at, &chances, &across, numbers);
        for (valid, wo) in valid.iter_mut().zip(&wo) {
            *valid &= above_horizon(*wo);
        }
        let pairs = own.pairs_of(valid, i, Directions::new(&wo, &valid));
        let (values, lobes) = own.band.lobes.lights_of(&at, &pairs.i, &pairs.o, &pairs.y2);
        let shades = own.shades(&pairs, &values);
        let densities = own.density_packet(&pairs, &chances, &across, &lobes);
        for (k, out) in out.iter_mut().enumerate().take(LANES) {
            let (wo, pdf) = (wo[k], densities[k]);
            *out = None;
            if valid[k] && pdf > 0.0 && pdf.is_finite() {
                // Filled where it lies: a copy would wait for what was written a moment ago.
                let sample = out.insert(BLANK);
                (sample.wo, sample.pdf) = (wo, pdf);
                if self.is_dispersed() {
                    // The lobe at the table's own wavelength is what is sampled.
                    sample.value = match viewer {
                        Viewer::AtExit => self.eval(wi[k], wo),
                        Viewer::AtIncidence => self.eval_seen(wi[k], wo),
                    };
                } else {
                    own.colour_lane(&pairs, &shades, k, viewer, &mut sample.value);
                }
            }
        }
    }
}

impl AtBand<'_> {
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
        let exits = self.band.lobes.exits(at, &part, &u);
        let [x, y, z] = each!(part = part, along = azimuth[0], across = azimuth[1], u2 = u[1], u3 = u[2],
            cos = exits[0], sin = exits[1], cos_phi = exits[2], sin_phi = exits[3] => {
            let (base, tabulated) = (cosine_hemisphere(u2, u3), Exit { cos, sin, azimuth: (cos_phi, sin_phi) });
            direction((along, across), if part == BASE { &base } else { &tabulated })
        });
        let facets = self.band.facets.samples(i, across, &u[1], &u[2]);
        let [x, y, z] = each!(part = part, x = x, y = y, z = z, fx = facets[0], fy = facets[1], fz = facets[2] => {
            if part == SURFACE { [fx, fy, fz] } else { [x, y, z] }
        });
        let mut wo = [[0.0; 3]; LANES];
        for (k, wo) in wo.iter_mut().enumerate() {
            *wo = [x[k], y[k], z[k]];
        }
        wo
    }
}

impl Lobes {
    /// [`Self::sample`] of every lane whose technique is one of the tabulated lobes: cos θo, sin θo, cos φ, sin φ.
    #[inline(always)]
    fn exits(&self, at: &Incidences, lobe: &[usize; LANES], [select, u, v]: &[Lane; 3]) -> [Lane; 4] {
        // The lanes that look something up come first: no branch for the others.
        let (mut wanted, mut count) = ([0; LANES], 0);
        for (k, lobe) in lobe.iter().enumerate() {
            wanted[count] = k;
            count += usize::from(*lobe < 2);
        }
        let wanted = &wanted[..count];
        let (mut node, mut left) = ([0; LANES], [0.0; LANES]);
        for &k in wanted {
            (node[k], left[k]) = self.choose_node(lobe[k], at.between[k], select[k]);
        }
        if self.signed() {
            let s = self.at_columns(at, &self.columns_of(wanted, lobe, &node, u));
            self.exits_of_plane(&at.azimuth, &s, &left, v)
        } else {
            let [side, v] = each!(v = v => {
                let (side, v) = side_of(v);
                [side, v]
            });
            let mut found = [[0.0; LANES]; 4];
            for &k in wanted {
                put(&mut found, k, self.find_row(lobe[k], node[k], v[k]).parts());
            }
            let around = positions(&found);
            let mut row = [0; LANES];
            for &k in wanted {
                (row[k], left[k]) = self.choose_row(lobe[k], node[k], around[k], left[k]);
            }
            let column = self.columns_of(wanted, lobe, &row, u);
            let mut area = [OUTSIDE; LANES];
            let mut cap_edge = [0.0; LANES];
            for (k, edge) in cap_edge.iter_mut().enumerate() {
                *edge = self.cap_edge(&self.columns_in(at, k));
            }
            for &k in wanted {
                if column[k] < cap_edge[k] {
                    area[k] = self.cap_area(lobe[k], row[k], cap_edge[k], u[k]);
                }
            }
            let [around] = each!(side = side, around = around => [side * around]);
            self.exits_of_space(&at.azimuth, &self.at_columns(at, &column), &around, &left, &area)
        }
    }

    /// Positions at which uniform numbers fall in rows.
    #[inline(always)]
    fn columns_of(&self, wanted: &[usize], lobe: &[usize; LANES], row: &[usize; LANES], u: &Lane) -> Lane {
        let mut found = [[0.0; LANES]; 4];
        for &k in wanted {
            put(&mut found, k, self.find(lobe[k], row[k], u[k]).parts());
        }
        positions(&found)
    }

    /// Angles at positions in the columns.
    #[inline(always)]
    fn at_columns(&self, at: &Incidences, column: &Lane) -> Lane {
        let mut x = [0.0; LANES];
        for (k, x) in x.iter_mut().enumerate() {
            *x = self.columns_in(at, k).at(column[k]);
        }
        x
    }

    #[inline(always)]
    fn exits_of_plane(&self, azimuth: &Single, s: &Lane, left: &Lane, v: &Lane) -> [Lane; 4] {
        let [cos, sin] = each!(s = s, left = left => {
            let (cos, sin) = turned(self.theta_of_plane(s, left) * INVERSE_TAU);
            [cos, sin]
        });
        let [narrow, k, tanh_k] = each!(azimuth = azimuth, s = s, sin = sin => {
            let Forward { narrow, k, tanh_k } = Forward::new(self.concentration_at(azimuth, s, sin));
            [narrow, k, tanh_k]
        });
        let [cos_phi, sin_phi] = each!(narrow = narrow, k = k, tanh_k = tanh_k, v = v => {
            let (cos, sin) = Forward { narrow, k, tanh_k }.sample(v);
            [cos, sin]
        });
        [cos, sin, cos_phi, sin_phi]
    }

    #[inline(always)]
    fn exits_of_space(
        &self,
        azimuth: &Single,
        theta: &Lane,
        around: &Lane,
        left: &Lane,
        area: &Lane,
    ) -> [Lane; 4] {
        let [turn] = each!(azimuth = azimuth, around = around, left = left, area = area => {
            [self.turn_of_space(azimuth, around, left, area)]
        });
        let [cos, sin] = each!(theta = theta, area = area => {
            let (cos, sin) = turned(self.theta_of_space(theta, area) * INVERSE_TAU);
            [cos, sin]
        });
        let [cos_phi, sin_phi] = each!(turn = turn => {
            let (cos, sin) = turned(turn);
            [cos, sin]
        });
        [cos, sin, cos_phi, sin_phi]
    }
}

/// [`Found::position`] of every lane.
#[inline(always)]
fn positions([base, a, b, rest]: &[Lane; 4]) -> Lane {
    let [position] = each!(base = base, a = a, b = b, rest = rest => {
        [Found { base, density: [a, b], rest }.position()]
    });
    position
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Controls;
    use crate::eval::many::{Densities, Evaluated};
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
        run(level, Evaluated { pearl: pearl.own(), wi, wo, viewer, out: &mut values })?;
        run(level, Densities { pearl, wi, wo, out: &mut densities })?;
        run(level, Sampled { pearl, wi, numbers: &numbers, viewer: Viewer::AtExit, out: &mut samples })?;
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
