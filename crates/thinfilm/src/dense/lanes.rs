//! A fixed number of floats side by side. Every operation is one loop that the compiler turns into vector instructions;
//! all of it inlines into functions compiled for one instruction set, so results are the same bits on all of them.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Wavelengths of a tile.
pub(crate) const LANES: usize = 16;

/// One number a lane: of a tile, or of the `W` lanes of it that go through the layers together.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Lanes<const W: usize = LANES, T = f64>(pub(crate) [T; W]);

/// What a lane holds: `f64`, or `f32` where noise hides its rounding.
pub(crate) trait Real:
    Copy
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// A field is scaled down from this energy on: a layer seldom makes it grow by more than the ratio of two indices squared, so
    /// that between two looks it stays far from the end of the range.
    const RESCALE_ABOVE: Self;
    /// What a rotation adds to the error, measured: it keeps its norm.
    const ROTATION_ROUNDING: f64;
    const ZERO: Self;
    const ONE: Self;

    fn of(x: f64) -> Self;
    fn to_f64(self) -> f64;
    /// self · b + c with one rounding.
    fn fma(self, b: Self, c: Self) -> Self;
    /// The power of two that brings a field of this energy to about 1.
    fn power_that_scales(self) -> Self;
    /// (sin πr/2, cos πr/2) for |r| ≤ ½; `few`: ≤ [`FEW_HALF_TURNS`].
    fn sin_cos<const W: usize>(r: Lanes<W, Self>, few: bool) -> (Lanes<W, Self>, Lanes<W, Self>);
}

macro_rules! real {
    ($float:ident, $rescale:expr, $rounding:expr, $exponents:expr, $of_half_turns:expr, $of_few:expr) => {
        impl Real for $float {
            const RESCALE_ABOVE: Self = $rescale;
            const ROTATION_ROUNDING: f64 = $rounding;
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline(always)]
            fn of(x: f64) -> Self {
                x as Self
            }

            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }

            #[inline(always)]
            fn fma(self, b: Self, c: Self) -> Self {
                self.mul_add(b, c)
            }

            #[inline(always)]
            fn power_that_scales(self) -> Self {
                let [one_twice, all] = $exponents;
                Self::from_bits(one_twice - (self.sqrt().to_bits() & all))
            }

            #[inline(always)]
            fn sin_cos<const W: usize>(r: Lanes<W, Self>, few: bool) -> (Lanes<W, Self>, Lanes<W, Self>) {
                let z = r * r;
                let (sin, cos) = if few {
                    z.two_polynomials($of_few[0], $of_few[1])
                } else {
                    z.two_polynomials($of_half_turns[0], $of_half_turns[1])
                };
                (sin * r, cos)
            }
        }
    };
}

// 2^100 and 2^-56, 2^40 and 2^-27; twice the exponent of 1, and the bits of exponents.
real!(
    f64,
    1.267_650_600_228_229_4e30,
    1.387_778_780_781_445_7e-17,
    [2046 << 52, 0x7ff << 52],
    [&SIN, &COS],
    [&SIN_OF_FEW, &COS_OF_FEW]
);
real!(
    f32,
    1.099_511_6e12,
    7.450_580_596_923_828e-9,
    [254 << 23, 0xff << 23],
    [&SIN_SINGLE, &COS_SINGLE],
    [&SIN_SINGLE, &COS_SINGLE]
);

impl<T: Real> Lanes<LANES, T> {
    /// The lanes from `first` on.
    #[inline(always)]
    pub(crate) fn part<const W: usize, U: Real>(&self, first: usize) -> Lanes<W, U> {
        let mut out = [U::ZERO; W];
        for (out, x) in out.iter_mut().zip(&self.0[first..first + W]) {
            *out = U::of(x.to_f64());
        }
        Lanes(out)
    }

    /// Sets the lanes from `first` on.
    #[inline(always)]
    pub(crate) fn set_part<const W: usize, U: Real>(&mut self, first: usize, part: Lanes<W, U>) {
        for (x, part) in self.0[first..first + W].iter_mut().zip(part.0) {
            *x = T::of(part.to_f64());
        }
    }
}

impl<const W: usize, T: Real> Lanes<W, T> {
    #[inline(always)]
    pub(crate) const fn splat(x: T) -> Self {
        Self([x; W])
    }

    #[inline(always)]
    pub(crate) fn map(self, f: impl Fn(T) -> T) -> Self {
        let mut out = self;
        for x in &mut out.0 {
            *x = f(*x);
        }
        out
    }

    #[inline(always)]
    pub(crate) fn zip(self, other: Self, f: impl Fn(T, T) -> T) -> Self {
        let mut out = self;
        for i in 0..W {
            out.0[i] = f(self.0[i], other.0[i]);
        }
        out
    }

    /// self · b + c with one rounding.
    #[inline(always)]
    pub(crate) fn fma(self, b: Self, c: Self) -> Self {
        let mut out = self;
        for i in 0..W {
            out.0[i] = self.0[i].fma(b.0[i], c.0[i]);
        }
        out
    }

    /// c − self · b with one rounding.
    #[inline(always)]
    pub(crate) fn fnma(self, b: Self, c: Self) -> Self {
        let mut out = self;
        for i in 0..W {
            out.0[i] = (-self.0[i]).fma(b.0[i], c.0[i]);
        }
        out
    }

    #[inline(always)]
    pub(crate) fn scale(self, factor: T) -> Self {
        self.map(|x| x * factor)
    }

    /// The same numbers, rounded or in full.
    #[inline(always)]
    pub(crate) fn cast<U: Real>(self) -> Lanes<W, U> {
        let mut out = [U::ZERO; W];
        for (out, x) in out.iter_mut().zip(self.0) {
            *out = U::of(x.to_f64());
        }
        Lanes(out)
    }

    /// Polynomial in `self`, coefficients from the constant up (Horner).
    #[inline(always)]
    pub(crate) fn polynomial<const N: usize>(self, coefficients: &[T; N]) -> Self {
        let mut sum = Self::splat(coefficients[N - 1]);
        let mut i = N - 1;
        while i > 0 {
            i -= 1;
            sum = sum.fma(self, Self::splat(coefficients[i]));
        }
        sum
    }

    /// Two polynomials in `self` step by step: neither waits for the other.
    #[inline(always)]
    fn two_polynomials<const N: usize>(self, a: &[T; N], b: &[T; N]) -> (Self, Self) {
        let (mut x, mut y) = (Self::splat(a[N - 1]), Self::splat(b[N - 1]));
        let mut i = N - 1;
        while i > 0 {
            i -= 1;
            x = x.fma(self, Self::splat(a[i]));
            y = y.fma(self, Self::splat(b[i]));
        }
        (x, y)
    }

    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    pub(crate) fn any_above(self, bound: T) -> bool {
        self.0.iter().fold(false, |any, x| any | (*x > bound))
    }
}

impl<const W: usize> Lanes<W> {
    #[inline(always)]
    pub(crate) fn round(self) -> Self {
        self.map(f64::round_ties_even)
    }
}

impl<const W: usize, T: Real> Add for Lanes<W, T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl<const W: usize, T: Real> Sub for Lanes<W, T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl<const W: usize, T: Real> Mul for Lanes<W, T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl<const W: usize, T: Real> Div for Lanes<W, T> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl<const W: usize, T: Real> Neg for Lanes<W, T> {
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

/// cos(πr/2) as a polynomial in r², |r| ≤ ½, its constant exactly 1: error 5.2e-17.
const COS: [f64; 7] = [
    1.0,
    -1.233700550136157,
    0.25366950790005294,
    -0.020863480737573933,
    0.0009192599677597649,
    -2.520019241970396e-05,
    4.656003838635755e-07,
];

/// As [`SIN`] and [`COS`] in single precision: errors 5e-9 and 2.8e-8.
const SIN_SINGLE: [f32; 4] = [std::f32::consts::FRAC_PI_2, -0.645_963_5, 0.079_680_22, -0.004_602_149];
const COS_SINGLE: [f32; 4] = [1.0, -1.233_697, 0.253_598_57, -0.020_408_158];

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

/// Up to here a decay needs no whole powers of two, and a shorter polynomial does.
pub(crate) const LITTLE_DECAY: f64 = 0.0625;

/// As [`EXP2_NEG`] for 0 ≤ f ≤ 1/16: error 7.6e-18.
const EXP2_NEG_OF_LITTLE: [f64; 7] = [
    1.0,
    -0.6931471805599378,
    0.24022650695677752,
    -0.05550410842475651,
    0.009618117691376537,
    -0.0013330810111922755,
    0.0001507740610150313,
];

/// (sin πr/2, cos πr/2), r what u lacks of a whole number: |r| ≤ ½. Whole half turns change the sign of a matrix and no power.
#[inline(always)]
pub(crate) fn sin_cos_of_half_turns<const W: usize, T: Real>(u: Lanes<W>) -> (Lanes<W, T>, Lanes<W, T>) {
    T::sin_cos((u - u.round()).cast(), false)
}

/// The same for 0 ≤ u ≤ [`FEW_HALF_TURNS`].
#[inline(always)]
pub(crate) fn sin_cos_of_few_half_turns<const W: usize, T: Real>(u: Lanes<W>) -> (Lanes<W, T>, Lanes<W, T>) {
    T::sin_cos(u.cast(), true)
}

/// n + this holds n in its low bits.
const INTEGER: f64 = 6_755_399_441_055_744.0; // 1.5·2^52

/// (cos πu/2, sin πu/2) for |u| < 2^51.
#[inline(always)]
pub(crate) fn cos_sin_quarter_turns<const W: usize>(u: Lanes<W>) -> (Lanes<W>, Lanes<W>) {
    let (sin, cos) = sin_cos_of_half_turns::<W, f64>(u);
    let quarters = u + Lanes::splat(INTEGER);
    let mut turned = (cos, sin);
    for i in 0..W {
        let n = quarters.0[i].to_bits();
        let (cos, sin) = if n & 1 == 0 { (cos.0[i], sin.0[i]) } else { (sin.0[i], cos.0[i]) };
        // The cosine is negative in the second and third quarter, the sine in the third and fourth.
        let (minus_cos, minus_sin) = ((n.wrapping_add(1) & 2) << 62, (n & 2) << 62);
        turned.0.0[i] = f64::from_bits(cos.to_bits() ^ minus_cos);
        turned.1.0[i] = f64::from_bits(sin.to_bits() ^ minus_sin);
    }
    turned
}

/// 2^-y for 0 ≤ y ≤ [`LITTLE_DECAY`].
#[inline(always)]
pub(crate) fn exp2_neg_of_little<const W: usize>(y: Lanes<W>) -> Lanes<W> {
    y.polynomial(&EXP2_NEG_OF_LITTLE)
}

/// 2^-y for 0 ≤ y; below 2^-1000 it stays there.
#[inline(always)]
pub(crate) fn exp2_neg<const W: usize>(y: Lanes<W>) -> Lanes<W> {
    let y = y.map(|y| if y < 1000.0 { y } else { 1000.0 });
    let n = y.round();
    let mantissa = (y - n).polynomial(&EXP2_NEG);
    // Shifted, n is subtracted from the exponent field.
    mantissa.zip(n, |m, n| {
        let bits = (n + INTEGER).to_bits() << 52;
        f64::from_bits(m.to_bits().wrapping_sub(bits))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_of_half_turns_are_those_of_the_library() {
        for i in 0..4000 {
            let u = f64::from(i) * 0.000_7;
            let half = std::f64::consts::FRAC_PI_2 * (u - u.round_ties_even());
            let near = |a: f64, b: f64| (a - b).abs() <= 2.0 * f64::EPSILON * b.abs();
            let (sin, cos) = sin_cos_of_half_turns::<LANES, f64>(Lanes::splat(u));
            assert!(near(sin.0[1], half.sin()) && near(cos.0[1], half.cos()), "{u}");
            if u <= FEW_HALF_TURNS {
                let (sin, cos) = sin_cos_of_few_half_turns::<LANES, f64>(Lanes::splat(u));
                assert!(near(sin.0[1], half.sin()) && near(cos.0[1], half.cos()), "{u}");
            }
        }
    }

    #[test]
    fn polynomials_match_the_library_functions() {
        for i in -4000..4000 {
            let u = f64::from(i) * 0.001_234_5;
            let (c, s) = cos_sin_quarter_turns::<LANES>(Lanes::splat(u));
            let x = u * std::f64::consts::FRAC_PI_2;
            // The reduction u − round(u) is exact; x itself is rounded to 1e-16·|x|.
            let tolerance = 3.0 * 2f64.powi(-53) + 2e-16 * x.abs();
            assert!(
                (c.0[0] - x.cos()).abs() < tolerance && (s.0[0] - x.sin()).abs() < tolerance,
                "{u}: {:e} {:e}",
                c.0[0] - x.cos(),
                s.0[0] - x.sin()
            );
            let y = u.abs() * 100.0;
            assert!((exp2_neg::<LANES>(Lanes::splat(y)).0[3] / (-y).exp2() - 1.0).abs() < 1e-15, "{y}");
            let little = u.abs() * (LITTLE_DECAY / 5.0);
            let found = exp2_neg_of_little::<LANES>(Lanes::splat(little)).0[3];
            assert!((found / (-little).exp2() - 1.0).abs() < 5e-16, "{little}");
        }
    }
}
