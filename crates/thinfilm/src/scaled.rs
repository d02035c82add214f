//! Complex numbers with a binary exponent of their own: products over thousands of opaque layers neither
//! overflow nor underflow.

use num_complex::Complex64;

/// `mantissa · 2^exponent`, the mantissa's larger component in [1, 2) unless it is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scaled {
    pub(crate) mantissa: Complex64,
    pub(crate) exponent: i64,
}

impl Scaled {
    pub(crate) fn new(mantissa: Complex64, exponent: i64) -> Self {
        Self { mantissa, exponent }.normalised()
    }

    /// Brings the mantissa's larger component into [1, 2).
    fn normalised(self) -> Self {
        let size = self.mantissa.re.abs().max(self.mantissa.im.abs());
        let Some(shift) = exponent_of(size) else { return Self { exponent: 0, ..self } };
        Self { mantissa: times_power_of_two(self.mantissa, -shift), exponent: self.exponent + shift }
    }

    /// The plain complex number; 0 where it underflows.
    pub(crate) fn value(self) -> Complex64 {
        times_power_of_two(self.mantissa, self.exponent)
    }

    /// ln |z|; −∞ for 0.
    pub(crate) fn ln_abs(self) -> f64 {
        let z = self.normalised();
        z.mantissa.norm().ln() + z.exponent as f64 * std::f64::consts::LN_2
    }
}

impl std::ops::Mul for Scaled {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { mantissa: self.mantissa * other.mantissa, exponent: self.exponent + other.exponent }
            .normalised()
    }
}

/// floor(log2 |x|) of a normal number, `None` for 0, subnormal, infinite or NaN.
pub(crate) fn exponent_of(x: f64) -> Option<i64> {
    x.is_normal().then(|| ((x.to_bits() >> 52) & 0x7ff) as i64 - 1023)
}

/// z · 2^power, exactly unless it over- or underflows.
pub(crate) fn times_power_of_two(z: Complex64, power: i64) -> Complex64 {
    // Two steps reach from the smallest to the largest exponent without an intermediate overflow.
    let half = (power / 2).clamp(-1022, 1022);
    let rest = (power - half).clamp(-1022, 1022);
    z * power_of_two(half) * power_of_two(rest)
}

fn power_of_two(power: i64) -> f64 {
    debug_assert!((-1022..=1022).contains(&power));
    f64::from_bits(((power + 1023) as u64) << 52)
}

/// e^x as (mantissa in [1/√2, √2], exponent): no overflow up to |x| ~ 1e18.
pub(crate) fn exp_parts(x: f64) -> (f64, i64) {
    if x == 0.0 {
        return (1.0, 0); // what most layers do
    }
    // ln 2 in two parts, the first with trailing zeros, so that n·LN2_HI is exact (Cody and Waite).
    const LN2_HI: f64 = 6.931_471_803_691_238_164_9e-1;
    const LN2_LO: f64 = 1.908_214_929_270_587_700_02e-10;
    let n = (x * std::f64::consts::LOG2_E).round_ties_even();
    let rest = n.mul_add(-LN2_LO, n.mul_add(-LN2_HI, x));
    (rest.exp(), n as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_beyond_f64_survive_a_product_and_its_logarithm() {
        let small = Scaled::new(Complex64::new(1e-200, -1e-200), 0);
        let product = small * small * small;
        assert_eq!(product.value().norm(), 0.0);
        // |z| = sqrt(2)·1e-200; three rounded multiplications and one logarithm of size 1e3.
        let expected = 3.0 * (2f64.sqrt().ln() - 200.0 * std::f64::consts::LN_10);
        assert!((product.ln_abs() / expected - 1.0).abs() < 1e-14);
    }

    #[test]
    fn the_exponential_splits_without_losing_digits() {
        for x in [-1.0e5, -700.5, -1e-3, 0.0, 0.3, 650.0] {
            let (mantissa, exponent) = exp_parts(x);
            let ln = mantissa.ln() + exponent as f64 * std::f64::consts::LN_2;
            assert!((ln - x).abs() <= 4e-16 * x.abs().max(1.0), "{x}: {ln}");
        }
    }
}
