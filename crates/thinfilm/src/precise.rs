//! Numbers of twice the digits of f64 (T. J. Dekker, 1971; D. E. Knuth), for what is done to one period and repeated a thousand times:
//! N equal periods add N equal roundings.

use num_complex::Complex64;

/// hi + lo, lo at most half a unit in the last place of hi: about 31 digits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Precise {
    pub(crate) hi: f64,
    lo: f64,
}

/// π to 32 digits.
const PI: Precise = Precise { hi: std::f64::consts::PI, lo: 1.224_646_799_147_353_2e-16 };

/// a + b and its rounding error, |a| ≥ |b|.
fn sum_of_ordered(a: f64, b: f64) -> Precise {
    let hi = a + b;
    Precise { hi, lo: b - (hi - a) }
}

fn sum(a: f64, b: f64) -> Precise {
    let hi = a + b;
    let rounded_b = hi - a;
    Precise { hi, lo: (a - (hi - rounded_b)) + (b - rounded_b) }
}

impl From<f64> for Precise {
    fn from(x: f64) -> Self {
        Self { hi: x, lo: 0.0 }
    }
}

impl std::ops::Add for Precise {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (high, low) = (sum(self.hi, other.hi), sum(self.lo, other.lo));
        let high = sum_of_ordered(high.hi, high.lo + low.hi);
        sum_of_ordered(high.hi, high.lo + low.lo)
    }
}

impl std::ops::Neg for Precise {
    type Output = Self;
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl std::ops::Sub for Precise {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl std::ops::Mul for Precise {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let hi = self.hi * other.hi;
        let lo = self.hi.mul_add(other.hi, -hi);
        sum_of_ordered(hi, self.hi.mul_add(other.lo, self.lo.mul_add(other.hi, lo)))
    }
}

impl std::ops::Div for Precise {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        // Two digits of a long division in base 2⁵³, and a third for the last bits.
        let first = self.hi / other.hi;
        let rest = self - other * Self::from(first);
        let second = rest.hi / other.hi;
        let rest = rest - other * Self::from(second);
        sum_of_ordered(first, second) + Self::from(rest.hi / other.hi)
    }
}

impl Precise {
    fn scaled(self, power_of_two: f64) -> Self {
        Self { hi: self.hi * power_of_two, lo: self.lo * power_of_two }
    }

    /// (sin πx, cos πx), |x| ≤ ½.
    pub(crate) fn sin_cos_of_half_turns(x: f64) -> (Self, Self) {
        let quarters = (2.0 * x).round_ties_even();
        let angle = PI * Self::from(x - 0.5 * quarters);
        let (z, one) = (angle * angle, Self::from(1.0));
        // Taylor's series on |angle| ≤ π/4: 13 terms leave 1e-32.
        let (mut sin, mut cos) = (one, one);
        for term in (1..14u32).rev() {
            let n = f64::from(2 * term);
            sin = one - z * sin / Self::from(n * (n + 1.0));
            cos = one - z * cos / Self::from(n * (n - 1.0));
        }
        let sin = angle * sin;
        match quarters {
            1.0 => (cos, -sin),
            -1.0 => (-cos, sin),
            _ => (sin, cos),
        }
    }
}

/// A complex number of such parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PreciseComplex {
    pub(crate) re: Precise,
    pub(crate) im: Precise,
}

impl From<Complex64> for PreciseComplex {
    fn from(z: Complex64) -> Self {
        Self { re: z.re.into(), im: z.im.into() }
    }
}

impl From<PreciseComplex> for Complex64 {
    fn from(z: PreciseComplex) -> Self {
        Self::new(z.re.hi, z.im.hi)
    }
}

impl std::ops::Add for PreciseComplex {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }
}

impl std::ops::Sub for PreciseComplex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }
}

impl std::ops::Mul for PreciseComplex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { re: self.re * other.re - self.im * other.im, im: self.re * other.im + self.im * other.re }
    }
}

impl std::ops::Div for PreciseComplex {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let norm = other.re * other.re + other.im * other.im;
        let product = self * Self { re: other.re, im: -other.im };
        Self { re: product.re / norm, im: product.im / norm }
    }
}

impl PreciseComplex {
    pub(crate) fn times_i(self) -> Self {
        Self { re: -self.im, im: self.re }
    }

    pub(crate) fn scaled(self, power_of_two: f64) -> Self {
        Self { re: self.re.scaled(power_of_two), im: self.im.scaled(power_of_two) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing, to 29 digits.
    fn is_small(x: Precise) -> bool {
        x.hi.abs() < 1e-29
    }

    #[test]
    fn twice_the_digits_survive_products_and_quotients() {
        let third = Precise::from(1.0) / Precise::from(3.0);
        assert!(is_small(third * Precise::from(3.0) - Precise::from(1.0)));
        assert!(third.lo != 0.0);
        let z = PreciseComplex { re: third, im: Precise::from(0.7) - third };
        let w = PreciseComplex { re: third * third, im: -third };
        let back = z * w / w - z;
        assert!(is_small(back.re) && is_small(back.im));
        assert_eq!(z.times_i().times_i() + z, Complex64::new(0.0, 0.0).into());
    }

    /// sin π/6 = ½, sin² + cos² = 1, and sin 2x = 2 sin x cos x, none of which f64 knows to 30 digits.
    #[test]
    fn sine_and_cosine_have_twice_the_digits() {
        for i in -500..=500 {
            let x = f64::from(i) * 1e-3;
            let (sin, cos) = Precise::sin_cos_of_half_turns(x);
            assert!((sin.hi - (std::f64::consts::PI * x).sin()).abs() < 4e-16, "{x}");
            assert!((cos.hi - (std::f64::consts::PI * x).cos()).abs() < 4e-16, "{x}");
            assert!(is_small(sin * sin + cos * cos - Precise::from(1.0)), "{x}");
            let (half, its_cos) = Precise::sin_cos_of_half_turns(0.5 * x);
            let twice = half * its_cos + half * its_cos;
            assert!(is_small(twice - sin), "{x}");
        }
    }
}
