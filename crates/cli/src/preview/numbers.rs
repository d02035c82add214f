//! Random numbers: Sobol's sequence in three dimensions with Owen's nested scramble, in another order for every choice of a pixel
//! (Burley 2020, "Practical hash-based Owen scrambling"): a function of seed, pixel and sample number only.

/// What the numbers choose.
#[derive(Clone, Copy)]
pub(super) enum Choice {
    /// A point of the pixel.
    Film,
    /// A point of a light.
    Light,
    /// Where the lobes point.
    Lobes,
}

/// The first points of Sobol's sequence, binary digits in reverse.
pub(super) struct Sobol(Vec<[u32; 3]>);

impl Sobol {
    /// So many points at least: a power of two of them.
    pub(super) fn new(points: u32) -> Self {
        // Direction numbers of no polynomial, x + 1 and x² + x + 1 (Joe & Kuo 2008).
        let mut directions = [[1_u32; 3]; 32];
        directions[1] = [1, 3, 3];
        for k in 2..32 {
            let ([_, a, b], [_, _, before]) = (directions[k - 1], directions[k - 2]);
            directions[k] = [1, (a << 1) ^ a, (b << 1) ^ (before << 2) ^ before];
        }
        let point = |index: u32| {
            let mut point = [0; 3];
            for (k, direction) in directions.iter().enumerate().filter(|(k, _)| (index >> k) & 1 == 1) {
                for (x, m) in point.iter_mut().zip(direction) {
                    *x ^= (m << (31 - k)).reverse_bits();
                }
            }
            point
        };
        Self((0..points.next_power_of_two()).map(point).collect())
    }
}

/// The numbers of one pixel.
#[derive(Clone, Copy)]
pub(super) struct Numbers(u64);

impl Numbers {
    pub(super) fn new(seed: u64, pixel: u32) -> Self {
        Self(mix64(seed ^ mix64(u64::from(pixel))))
    }

    /// Three numbers in [0, 1) of one of the pixel's samples.
    pub(super) fn at(self, Sobol(points): &Sobol, choice: Choice, sample: u32) -> [f64; 3] {
        let hash = mix64(self.0 ^ (choice as u64 + 1));
        let [order, scramble] = [hash as u32, (hash >> 32) as u32];
        // The order is scrambled as the numbers are, the highest digit first.
        let digits = points.len().trailing_zeros();
        let reversed = |index: u32| if digits == 0 { 0 } else { index.reverse_bits() >> (32 - digits) };
        let index = reversed(scrambled(reversed(sample), order) & (points.len() as u32 - 1));
        let mut numbers = [0.0; 3];
        for (d, (number, x)) in (1..).zip(numbers.iter_mut().zip(points[index as usize])) {
            let x = scrambled(x, scramble.wrapping_mul(2 * d + 1)).reverse_bits();
            *number = f64::from(x) / 4_294_967_296.0;
        }
        numbers
    }
}

/// Flips digits by a hash of those below them (Laine & Karras 2011, constants of Vegdahl 2021).
const fn scrambled(x: u32, seed: u32) -> u32 {
    let mut x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^ x.wrapping_mul(0x8d22_f6e6)
}

/// Finaliser of splitmix64 (Steele et al. 2014).
const fn mix64(x: u64) -> u64 {
    let mut z = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every elementary interval of a net has its share of the points; and the samples of one ray are a net of their own.
    #[test]
    fn any_two_numbers_fill_every_box_of_a_net_once() {
        let sobol = Sobol::new(64);
        for pixel in 0..50 {
            let numbers = Numbers::new(7, pixel);
            for (from, digits) in [(0, 6), (16, 4), (32, 5)] {
                let points: Vec<[f64; 3]> =
                    (from..from + (1 << digits)).map(|k| numbers.at(&sobol, Choice::Light, k)).collect();
                for across in 0..=digits {
                    let mut boxes = vec![0; 1 << digits];
                    for [x, y, _] in &points {
                        let column = (x * f64::from(1 << across)) as usize;
                        let row = (y * f64::from(1 << (digits - across))) as usize;
                        boxes[(column << (digits - across)) + row] += 1;
                    }
                    assert!(boxes.iter().all(|count| *count == 1), "{pixel} {across}: {boxes:?}");
                }
                let mut thirds = points.iter().map(|[_, _, z]| (z * f64::from(1 << digits)) as usize);
                assert_eq!(thirds.by_ref().fold(0_u64, |seen, k| seen | 1 << k).count_ones(), 1 << digits);
            }
        }
    }

    #[test]
    fn choices_and_pixels_are_independent() {
        let sobol = Sobol::new(16);
        let n = 4000;
        let pair = |pixel: u32| {
            let numbers = Numbers::new(1, pixel);
            let [x, ..] = numbers.at(&sobol, Choice::Light, 3);
            let [y, ..] = numbers.at(&sobol, Choice::Lobes, 3);
            (x - 0.5, y - 0.5)
        };
        let (mut mean, mut product) = (0.0, 0.0);
        for pixel in 0..n {
            let (x, y) = pair(pixel);
            mean += (x + y) / f64::from(n);
            product += 12.0 * x * y / f64::from(n);
        }
        // Four standard deviations of independent numbers.
        assert!(mean.abs() < 0.026 && product.abs() < 0.064, "{mean} {product}");
    }
}
