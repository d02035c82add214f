//! Least squares with unknowns that may not be negative (Lawson & Hanson 1974, chapter 23).

/// The x ≥ 0 with the least |A·x − b|², from AᵀA and Aᵀb.
pub(super) fn solve<const N: usize>(gram: &[[f64; N]; N], moments: &[f64; N]) -> [f64; N] {
    let (mut x, mut free) = ([0.0; N], [false; N]);
    let scale = moments.iter().fold(0.0, |most: f64, m| most.max(m.abs()));
    // Each round frees one; more rounds than these only shuffle rounding.
    for _ in 0..3 * N {
        let pull = |j: usize| moments[j] - (0..N).map(|k| gram[j][k] * x[k]).sum::<f64>();
        let held = (0..N).filter(|j| !free[*j]).map(|j| (j, pull(j)));
        let Some((next, strongest)) = held.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        if strongest <= 1e-10 * scale {
            break;
        }
        free[next] = true;
        loop {
            let wanted = unconstrained(gram, moments, &free);
            // As far as the first that would turn negative, which is held from then on.
            let share = |j: usize| x[j] / (x[j] - wanted[j]).max(f64::MIN_POSITIVE);
            let turning = (0..N).filter(|j| free[*j] && wanted[*j] <= 0.0).map(|j| (j, share(j)));
            let Some((first, share)) = turning.min_by(|a, b| a.1.total_cmp(&b.1)) else {
                x = wanted;
                break;
            };
            for j in 0..N {
                x[j] = (x[j] + share * (wanted[j] - x[j])).max(0.0);
            }
            (free[first], x[first]) = (false, 0.0);
        }
    }
    x
}

/// The solution among those that are free, 0 for the others, by Cholesky's factors.
fn unconstrained<const N: usize>(gram: &[[f64; N]; N], moments: &[f64; N], free: &[bool; N]) -> [f64; N] {
    let chosen: Vec<usize> = (0..N).filter(|j| free[*j]).collect();
    let (mut factor, mut y) = ([[0.0; N]; N], [0.0; N]);
    for (i, a) in chosen.iter().enumerate() {
        for (j, b) in chosen.iter().enumerate().take(i + 1) {
            let sum: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            factor[i][j] = if i == j {
                // Columns that are nearly alike share what they explain.
                (gram[*a][*a] * (1.0 + 1e-9) - sum).max(1e-12 * gram[*a][*a]).sqrt().max(1e-150)
            } else {
                (gram[*a][*b] - sum) / factor[j][j]
            };
        }
        y[i] = (moments[*a] - (0..i).map(|k| factor[i][k] * y[k]).sum::<f64>()) / factor[i][i];
    }
    let mut x = [0.0; N];
    for i in (0..chosen.len()).rev() {
        let later: f64 = (i + 1..chosen.len()).map(|k| factor[k][i] * x[chosen[k]]).sum();
        x[chosen[i]] = (y[i] - later) / factor[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_unknown_is_negative_and_no_step_makes_the_squares_less() {
        // A fixed sequence of matrices of 12 rows and 5 columns.
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        let mut held = 0;
        for _ in 0..200 {
            let a: Vec<[f64; 5]> = (0..12).map(|_| std::array::from_fn(|_| random())).collect();
            let b: Vec<f64> = (0..12).map(|_| random()).collect();
            let gram = std::array::from_fn(|i| {
                std::array::from_fn(|j| a.iter().map(|row| row[i] * row[j]).sum::<f64>())
            });
            let moments = std::array::from_fn(|i| a.iter().zip(&b).map(|(row, b)| row[i] * b).sum::<f64>());
            let x = solve::<5>(&gram, &moments);
            // Karush, Kuhn and Tucker: no pull on what is free, none upwards on what is held.
            for j in 0..5 {
                let pull = moments[j] - (0..5).map(|k| gram[j][k] * x[k]).sum::<f64>();
                assert!(x[j] >= 0.0 && pull < 1e-7 && (x[j] == 0.0 || pull > -1e-7), "{j} {x:?} {pull}");
                held += usize::from(x[j] == 0.0);
            }
        }
        assert!(held > 100, "{held}");
    }
}
