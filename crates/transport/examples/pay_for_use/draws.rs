//! Random numbers and facet tilts of the lean kernels: what `docs/WALK.md` describes, written down once more.

/// What all paths of one incidence share.
#[derive(Clone, Copy)]
pub(crate) struct Stream([u64; 2]);

/// State of xoshiro128+.
pub(crate) type Generator = [u32; 4];

/// Optical depth up to which absorption is a weight.
const WEIGHT_DEPTH: f64 = 6.0;

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
const STREAMS: u64 = 0x243f_6a88_85a3_08d3;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Stream {
    pub(crate) fn new(seed: u64, theta_i: f64) -> Self {
        let first =
            mix(mix((seed ^ STREAMS).wrapping_add(GOLDEN)) ^ mix(theta_i.to_bits().wrapping_add(GOLDEN)));
        Self([first, mix(first.wrapping_add(GOLDEN))])
    }

    /// The generator of a path, and 32 bits beside it.
    #[inline(always)]
    pub(crate) fn path(self, path: u64) -> (Generator, u32) {
        let counter = mix(path.wrapping_mul(GOLDEN).wrapping_add(self.0[0]));
        let low = mix(counter ^ self.0[1]);
        let high = mix(low.wrapping_add(GOLDEN).wrapping_add(counter));
        let generator = [low as u32, (low >> 32) as u32, high as u32, (high >> 32) as u32 | 1];
        (generator, (counter >> 32) as u32)
    }
}

/// Optical depth at which a path ends whose 32 bits are `spare`: beyond [`WEIGHT_DEPTH`] it survives with probability
/// exp(−(τ − τ0)).
#[inline(always)]
pub(crate) fn absorption_limit(spare: u32) -> f32 {
    (WEIGHT_DEPTH - libm::log((f64::from(spare) + 0.5) / 4_294_967_296.0)) as f32
}

/// Weight of a path of an optical depth.
#[inline(always)]
pub(crate) fn weight(depth: f32) -> f32 {
    libm::exp(-f64::from(depth).min(WEIGHT_DEPTH)) as f32
}

#[inline(always)]
pub(crate) fn next(state: &mut Generator) -> u32 {
    let [s0, s1, s2, s3] = *state;
    let (t2, t3) = (s2 ^ s0, s3 ^ s1);
    *state = [s0 ^ t3, s1 ^ t2, t2 ^ (s1 << 9), t3.rotate_left(11)];
    s0.wrapping_add(s3)
}

#[inline(always)]
fn odd(word: u32) -> f32 {
    (word | 1) as i32 as f32
}

/// A uniform on (0, 2³¹].
#[inline(always)]
pub(crate) fn uniform(word: u32) -> f32 {
    odd(word & 0x7fff_ffff)
}

/// The uniform that two words of deviates leave over.
#[inline(always)]
pub(crate) fn left_over(radius: u32, angle: u32) -> f32 {
    uniform((angle & 0xffff_0000) | (radius & 0xffff))
}

/// Two normal deviates of a standard deviation.
#[derive(Clone, Copy)]
pub(crate) struct Normal {
    octave: f32,
    log: [f32; 8],
}

impl Normal {
    pub(crate) fn new(sd: f64) -> Self {
        const LOG: [f64; 8] = [
            -2.249_635_396_0,
            4.944_890_813_8,
            -5.194_534_754_2,
            4.007_387_706_0,
            -2.069_058_603_1,
            0.677_963_540_35,
            -0.127_497_211_51,
            0.010_484_096_913,
        ];
        let scale = -2.0 * sd * sd;
        Self { octave: (scale * std::f64::consts::LN_2) as f32, log: LOG.map(|c| (scale * c) as f32) }
    }

    #[inline(always)]
    pub(crate) fn deviates(&self, radius: u32, angle: u32) -> (f32, f32) {
        const SIN: [f32; 4] = [1.570_791_011_1, -0.645_892_849_55, 0.079_434_344_612, -0.004_333_095_289_8];
        const COS: [f32; 5] =
            [0.999_999_995_35, -1.233_698_214_7, 0.253_650_744_64, -0.020_810_627_519, 0.000_858_190_619_53];
        let uniform = odd(radius);
        let bits = uniform.abs().to_bits();
        let e = (bits.wrapping_sub((127 + 31) << 23) as i32 >> 23) as f32;
        let v = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
        let [constant, linear @ ..] = self.log;
        let square = polynomial(&linear, v).mul_add(v, e.mul_add(self.octave, constant));
        let radius = std::hint::select_unpredictable(square > 0.0, square, 0.0).sqrt().copysign(uniform);
        let t = ((angle << 16) as i32) as f32 * (1.0 / 2_147_483_648.0);
        let z = t * t;
        (radius * polynomial(&COS, z), radius * t * polynomial(&SIN, z))
    }
}

#[inline(always)]
pub(crate) fn polynomial<const N: usize>(coefficients: &[f32; N], x: f32) -> f32 {
    let mut sum = coefficients[N - 1];
    for k in (0..N - 1).rev() {
        sum = sum.mul_add(x, coefficients[k]);
    }
    sum
}
