//! What gives the closed-form reflection of [`Facets`] its share of the light.

use super::channels::single_reflection_share;
use crate::facets::{Facets, Rules};
use crate::numerics::curve::{self, Curve, NODES, Place};
use lut_io::lobe::Interpolant;
use rayon::prelude::*;

/// Over θi: the factor that gives the closed form the single reflection's share.
pub(super) fn scale(lobe: &Interpolant, facets: &Facets) -> Curve {
    let rules = Rules::without_fringes();
    let factor = |node: usize| {
        let mut integral = 0.0;
        facets.integrate(&rules, curve::cos_at(node), |mass, _, _| integral += mass);
        if integral > 0.0 { single_reflection_share(lobe, curve::theta_at(node)) / integral } else { 0.0 }
    };
    let factors: Vec<f64> = (0..NODES).into_par_iter().map(factor).collect();
    curve::curve(|node| factors[node])
}

/// The curve r for which r(θi)·r(θo)·cos θo·[`Facets::reflection`] has the single reflection's share at every θi: the closed form
/// made reciprocal (symmetric scaling, as in [`lut_io::symmetrise`]).
pub(super) fn ends(lobe: &Interpolant, facets: &Facets, rules: &Rules) -> Curve {
    const ROUNDS: usize = 200;
    const SCALED: f64 = 1e-9;
    let pieces: Vec<Vec<(f64, Place)>> = (0..NODES)
        .map(|node| {
            let mut pieces = Vec::new();
            facets.integrate(rules, curve::cos_at(node), |mass, _, cos_o| {
                if mass > 0.0 && cos_o > 0.0 {
                    pieces.push((mass * cos_o, Place::of_cos(cos_o)));
                }
            });
            pieces
        })
        .collect();
    let share: Vec<f64> =
        (0..NODES).map(|node| single_reflection_share(lobe, curve::theta_at(node))).collect();
    let mut ends = vec![1.0; NODES];
    for _ in 0..ROUNDS {
        let mut worst = 0f64;
        let factor: Vec<f64> = pieces
            .iter()
            .zip(&share)
            .enumerate()
            .map(|(node, (pieces, share))| {
                let light = pieces.iter().map(|(mass, at)| mass * at.mix(&ends)).sum::<f64>() * ends[node];
                if light <= 0.0 || *share <= 0.0 {
                    return 0.0;
                }
                worst = worst.max((share / light - 1.0).abs());
                (share / light).sqrt()
            })
            .collect();
        ends.iter_mut().zip(factor).for_each(|(end, factor)| *end *= factor);
        if worst < SCALED {
            break;
        }
    }
    curve::curve(|node| ends[node])
}
