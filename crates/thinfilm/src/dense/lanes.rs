//! A fixed number of f64 side by side. Every operation is one loop that the compiler turns into vector instructions;
//! all of it inlines into functions compiled for one instruction set, so results are the same bits on all of them.

/// Wavelengths handled together.
pub(crate) const LANES: usize = 16;

/// One number a lane.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Lanes(pub(crate) [f64; LANES]);

impl Lanes {
    #[inline(always)]
    pub(crate) const fn splat(x: f64) -> Self {
        Self([x; LANES])
    }

    #[inline(always)]
    pub(crate) fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let mut out = self;
        for x in &mut out.0 {
            *x = f(*x);
        }
        out
    }

    #[inline(always)]
    pub(crate) fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let mut out = self;
        for i in 0..LANES {
            out.0[i] = f(self.0[i], other.0[i]);
        }
        out
    }

    /// self · b + c with one rounding.
    #[inline(always)]
    pub(crate) fn fma(self, b: Self, c: Self) -> Self {
        let mut out = self;
        for i in 0..LANES {
            out.0[i] = self.0[i].mul_add(b.0[i], c.0[i]);
        }
        out
    }

    /// c − self · b with one rounding.
    #[inline(always)]
    pub(crate) fn fnma(self, b: Self, c: Self) -> Self {
        let mut out = self;
        for i in 0..LANES {
            out.0[i] = (-self.0[i]).mul_add(b.0[i], c.0[i]);
        }
        out
    }

    #[inline(always)]
    pub(crate) fn scale(self, factor: f64) -> Self {
        self.map(|x| x * factor)
    }

    #[inline(always)]
    pub(crate) fn round(self) -> Self {
        self.map(f64::round_ties_even)
    }

    /// Polynomial in `self`, coefficients from the constant up (Horner).
    #[inline(always)]
    pub(crate) fn polynomial<const N: usize>(self, coefficients: &[f64; N]) -> Self {
        let mut sum = Self::splat(coefficients[N - 1]);
        let mut i = N - 1;
        while i > 0 {
            i -= 1;
            sum = sum.fma(self, Self::splat(coefficients[i]));
        }
        sum
    }

    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    pub(crate) fn any_above(self, bound: f64) -> bool {
        self.0.iter().fold(false, |any, x| any | (*x > bound))
    }
}

impl std::ops::Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl std::ops::Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl std::ops::Mul for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl std::ops::Div for Lanes {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl std::ops::Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|x| -x)
    }
}

/// sin(πr/2)/r as a polynomial in r², |r| ≤ ½: Chebyshev fit in 60 digits, error 5e-18.
const SIN: [f64; 7] = [
    std::f64::consts::FRAC_PI_2,
    -0.6459640975062443,
    0.07969262624604301,
    -0.004681754132340976,
    0.0001604411507421909,
    -3.59864335298231e-06,
    5.633933781537854e-08,
];

/// cos(πr/2) as a polynomial in r², |r| ≤ ½, its constant exactly 1: a bias in sin² + cos² would grow with every layer.
const COS: [f64; 8] = [
    1.0,
    -1.2337005501361697,
    0.2536695079010478,
    -0.020863480763340773,
    0.0009192602745468447,
    -2.5202039028029178e-05,
    4.710678405505227e-07,
    -6.329396344967424e-09,
];

/// Up to here a layer's phase needs no reduction, and shorter polynomials do.
pub(crate) const FEW_HALF_TURNS: f64 = 0.22;

/// As [`SIN`] for |r| ≤ 0.22: error 4e-19.
const SIN_OF_FEW: [f64; 6] = [
    std::f64::consts::FRAC_PI_2,
    -0.6459640975062457,
    0.07969262624603914,
    -0.004681754124042321,
    0.00016044073539079573,
    -3.5905870070422152e-06,
];

/// As [`COS`] for |r| ≤ 0.22: error 1.2e-17.
const COS_OF_FEW: [f64; 6] = [
    1.0,
    -1.2337005501361695,
    0.25366950790079595,
    -0.020863480721689927,
    0.0009192578642140542,
    -2.5145101526610416e-05,
];

/// 2^-f, |f| ≤ ½: error 3e-18.
const EXP2_NEG: [f64; 12] = [
    1.0,
    -std::f64::consts::LN_2,
    0.24022650695910158,
    -0.055504108664821625,
    0.009618129107587256,
    -0.001333355814640647,
    0.00015403530463724353,
    -1.5252733841556773e-05,
    1.3215432535912375e-06,
    -1.0178057087733941e-07,
    7.074194297288521e-09,
    -4.4558179083360645e-10,
];

/// (sin πr/2, cos πr/2), r what u lacks of a whole number: |r| ≤ ½.
#[inline(always)]
fn sin_cos_of_remainder(u: Lanes) -> (Lanes, Lanes) {
    let r = u - u.round();
    let z = r * r;
    (z.polynomial(&SIN) * r, z.polynomial(&COS))
}

/// (tan δ/2, −sin δ) for δ = πu less whole half turns, which change the sign of a matrix and no power: |tan δ/2| ≤ 1.
#[inline(always)]
pub(crate) fn shears_of_half_turns(u: Lanes) -> (Lanes, Lanes) {
    shears(sin_cos_of_remainder(u))
}

/// The same for 0 ≤ u ≤ [`FEW_HALF_TURNS`].
#[inline(always)]
pub(crate) fn shears_of_few_half_turns(u: Lanes) -> (Lanes, Lanes) {
    let z = u * u;
    shears((z.polynomial(&SIN_OF_FEW) * u, z.polynomial(&COS_OF_FEW)))
}

/// From sine and cosine of half the angle. The division costs next to nothing: it runs beside the polynomials.
#[inline(always)]
fn shears((sin, cos): (Lanes, Lanes)) -> (Lanes, Lanes) {
    (sin / cos, -((sin + sin) * cos))
}

/// (cos 2πu, sin 2πu).
#[inline(always)]
pub(crate) fn cos_sin_turns(u: Lanes) -> (Lanes, Lanes) {
    // Doubled twice: (c, s) to (1 − 2s², 2sc). The first doubling may lack a sign.
    let (s, c) = sin_cos_of_remainder(u);
    let twice = s + s;
    let (c, s) = (twice.fnma(s, Lanes::splat(1.0)), twice * c);
    let twice = s + s;
    (twice.fnma(s, Lanes::splat(1.0)), twice * c)
}

/// 2^-y for 0 ≤ y; below 2^-1000 it stays there.
#[inline(always)]
pub(crate) fn exp2_neg(y: Lanes) -> Lanes {
    let y = y.map(|y| if y < 1000.0 { y } else { 1000.0 });
    let n = y.round();
    let mantissa = (y - n).polynomial(&EXP2_NEG);
    // n + 1.5·2^52 holds n in its low bits; shifted, it is subtracted from the exponent field.
    mantissa.zip(n, |m, n| {
        let bits = (n + 6_755_399_441_055_744.0).to_bits() << 52;
        f64::from_bits(m.to_bits().wrapping_sub(bits))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shears_are_tangent_of_half_and_sine() {
        for i in 0..4000 {
            let u = f64::from(i) * 0.000_7;
            let r = u - u.round_ties_even();
            let (half, whole) = (std::f64::consts::FRAC_PI_2 * r, std::f64::consts::PI * r);
            let near = |a: f64, b: f64| (a - b).abs() <= 4.0 * f64::EPSILON * b.abs();
            let (tan, minus_sin) = shears_of_half_turns(Lanes::splat(u));
            assert!(near(tan.0[1], half.tan()) && near(minus_sin.0[1], -whole.sin()), "{u}");
            if u <= FEW_HALF_TURNS {
                let (tan, minus_sin) = shears_of_few_half_turns(Lanes::splat(u));
                assert!(near(tan.0[1], half.tan()) && near(minus_sin.0[1], -whole.sin()), "{u}");
            }
        }
    }

    #[test]
    fn polynomials_match_the_library_functions() {
        for i in -4000..4000 {
            let u = f64::from(i) * 0.001_234_5;
            let (c, s) = cos_sin_turns(Lanes::splat(u));
            let x = u * std::f64::consts::TAU;
            // The reduction u − round(u) is exact; x itself is rounded to 1e-16·|x|. Doubling twice leaves 8 half-ulps.
            let tolerance = 8.0 * 2f64.powi(-53) + 2e-16 * x.abs();
            assert!(
                (c.0[0] - x.cos()).abs() < tolerance && (s.0[0] - x.sin()).abs() < tolerance,
                "{u}: {:e} {:e}",
                c.0[0] - x.cos(),
                s.0[0] - x.sin()
            );
            let y = u.abs() * 100.0;
            assert!((exp2_neg(Lanes::splat(y)).0[3] / (-y).exp2() - 1.0).abs() < 1e-15, "{y}");
        }
    }
}
