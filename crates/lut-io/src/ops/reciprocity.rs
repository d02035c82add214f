//! How far a table is from reciprocal: F(θi → θo) against F(θo → θi), F = f·cos θi·cos θo.
//!
//! Of a table F is v·cos θi, v the stored f·cos θo. Facets that are met unweighted, the azimuth postulate with its width by θi, and
//! reading between cells all leave F(a → b) and F(b → a) different.

use crate::model::table::Component;
use crate::read::lobe::Interpolant;
use serde::Serialize;

/// The defect of reciprocity over pairs of angles in the plane of incidence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DefectMap {
    /// The angles, degrees: rows and columns of `defect`.
    pub theta_deg: Vec<f64>,
    /// Azimuth between mirror direction and exit, degrees.
    pub phi_deg: f64,
    /// |F(a → b) − F(b → a)| over the mean of the largest F of the two rows, F = f·cos θi·cos θo; symmetric.
    pub defect: Vec<Vec<f64>>,
    /// Σ|F(a → b) − F(b → a)| / Σ(F(a → b) + F(b → a)) over all pairs.
    pub total: f64,
}

/// Tries a table at every pair of some angles (radians, below π/2).
#[must_use]
pub fn defect(lobe: &Interpolant, angles: &[f64], phi: f64) -> DefectMap {
    let forth: Vec<Vec<f64>> = angles
        .iter()
        .map(|&a| {
            let row = lobe.row(a);
            let parts = [Component::Interior, Component::Surface];
            angles
                .iter()
                .map(|&b| parts.iter().map(|part| row.eval(*part, b, phi)).sum::<f64>() * a.cos())
                .collect()
        })
        .collect();
    let peak: Vec<f64> = forth.iter().map(|row| row.iter().copied().fold(0.0, f64::max)).collect();
    let (mut difference, mut sum) = (0.0, 0.0);
    let defect = (0..angles.len())
        .map(|a| {
            (0..angles.len())
                .map(|b| {
                    let (there, back) = (forth[a][b], forth[b][a]);
                    difference += (there - back).abs();
                    sum += there + back;
                    let scale = 0.5 * (peak[a] + peak[b]);
                    if scale > 0.0 { (there - back).abs() / scale } else { 0.0 }
                })
                .collect()
        })
        .collect();
    DefectMap {
        theta_deg: angles.iter().map(|a| a.to_degrees()).collect(),
        phi_deg: phi.to_degrees(),
        defect,
        total: if sum > 0.0 { difference / sum } else { 0.0 },
    }
}
