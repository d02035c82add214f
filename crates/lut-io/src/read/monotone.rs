//! A smooth curve through points that never overshoots them: albedos read between angles of incidence stay
//! between those of the neighbours. Slopes of the parabola through three points, cut back to three times the
//! smaller secant, which is enough for monotonicity (de Boor & Swartz 1977; Hyman 1983).

/// Piecewise cubic Hermite interpolant, constant beyond its ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Monotone {
    x: Vec<f64>,
    y: Vec<f64>,
    slope: Vec<f64>,
}

impl Monotone {
    /// Through the points (x, y), at least one; x strictly ascending. Flat at x = 0 when the first x is 0: all
    /// that it interpolates is even in the angle of incidence.
    #[must_use]
    pub fn new(x: Vec<f64>, y: Vec<f64>) -> Self {
        assert!(!x.is_empty() && x.len() == y.len(), "one value a point, and at least one point");
        let last = x.len() - 1;
        let secant: Vec<f64> = (0..last).map(|i| (y[i + 1] - y[i]) / (x[i + 1] - x[i])).collect();
        let mut slope = vec![0.0; x.len()];
        for i in 1..last {
            let (before, after) = (secant[i - 1], secant[i]);
            if before * after > 0.0 {
                let (h0, h1) = (x[i] - x[i - 1], x[i + 1] - x[i]);
                let parabola = (h1 * before + h0 * after) / (h0 + h1);
                let limit = 3.0 * before.abs().min(after.abs());
                slope[i] = parabola.clamp(-limit, limit);
            }
        }
        if last == 1 {
            slope = vec![secant[0]; 2];
        } else if last > 1 {
            slope[0] = end_slope(x[1] - x[0], x[2] - x[1], secant[0], secant[1]);
            let n = last;
            slope[n] = end_slope(x[n] - x[n - 1], x[n - 1] - x[n - 2], secant[n - 1], secant[n - 2]);
        }
        if x[0] == 0.0 {
            slope[0] = 0.0;
        }
        Self { x, y, slope }
    }

    /// The value at x.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        let last = self.x.len() - 1;
        if last == 0 || x <= self.x[0] {
            return self.y[0];
        }
        if x >= self.x[last] {
            return self.y[last];
        }
        let i = self.x.partition_point(|node| *node <= x) - 1;
        let h = self.x[i + 1] - self.x[i];
        let t = (x - self.x[i]) / h;
        let u = 1.0 - t;
        u * u * ((1.0 + 2.0 * t) * self.y[i] + t * h * self.slope[i])
            + t * t * ((3.0 - 2.0 * t) * self.y[i + 1] - u * h * self.slope[i + 1])
    }
}

/// Three-point slope at an end, cut back where it would overshoot (Moler, *Numerical Computing with MATLAB* §3.6).
fn end_slope(h0: f64, h1: f64, secant0: f64, secant1: f64) -> f64 {
    let slope = ((2.0 * h0 + h1) * secant0 - h0 * secant1) / (h0 + h1);
    if slope * secant0 <= 0.0 {
        return 0.0;
    }
    let limit = 3.0 * secant0.abs();
    slope.clamp(-limit, limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_smooth_curve_is_followed_to_third_order() {
        let x: Vec<f64> = (0..19).map(|i| f64::from(i) * 5f64.to_radians()).collect();
        let curve = Monotone::new(x.clone(), x.iter().map(|x| 1.0 - x.cos()).collect());
        let worst = (0..900)
            .map(|i| f64::from(i) * 1e-3)
            .map(|x| (curve.at(x) - (1.0 - x.cos())).abs())
            .fold(0.0, f64::max);
        // A chord of a 5° step misses by h²/8 = 1e-3; the cubic's h³-order slopes leave under 5e-5.
        assert!(worst < 5e-5, "{worst}");
    }

    #[test]
    fn one_point_is_a_constant() {
        let curve = Monotone::new(vec![0.5], vec![0.3]);
        assert_eq!([curve.at(0.0), curve.at(0.5), curve.at(2.0)], [0.3; 3]);
    }

    proptest! {
        #[test]
        fn it_stays_between_its_neighbours(
            steps in prop::collection::vec((0.01f64..1.0, 0.0f64..1.0), 1..12), start in 0.0f64..0.2, t in 0.0f64..1.0
        ) {
            let mut x = vec![start];
            for (step, _) in &steps[1..] {
                x.push(x[x.len() - 1] + step);
            }
            let y: Vec<f64> = steps.iter().map(|s| s.1).collect();
            let curve = Monotone::new(x.clone(), y.clone());
            for i in 1..x.len() {
                let v = curve.at(x[i - 1] + t * (x[i] - x[i - 1]));
                let (lo, hi) = (y[i - 1].min(y[i]), y[i - 1].max(y[i]));
                prop_assert!(v >= lo - 1e-12 && v <= hi + 1e-12);
            }
        }
    }
}
