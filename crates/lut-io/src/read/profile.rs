//! The lobe in the plane of incidence over the signed exit angle: what the paper's Figs. 6 and 7 draw.

use crate::model::measure;
use crate::model::table::Component;
use crate::read::lobe::{Interpolant, Row};

/// What a profile's numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Share of the incident light per degree of signed exit angle: the plane walk's density (decay tables).
    PerDegree,
    /// f·cos θo in 1/sr in the plane of incidence (space tables, whose light also leaves the plane).
    PerSteradian,
}

/// The lobe along the plane of incidence at one θi.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// What `value` and `std_error` are.
    pub quantity: Quantity,
    /// Signed exit angle, degrees, ascending.
    pub exit_deg: Vec<f64>,
    /// How many degrees each value stands for.
    pub extent_deg: Vec<f64>,
    /// Value of each component (in the order of [`Component::ALL`]) at each exit angle.
    pub value: [Vec<f64>; 3],
    /// Standard error of `value`.
    pub std_error: [Vec<f64>; 3],
}

impl Profile {
    /// The profile at θi in degrees.
    #[must_use]
    pub fn new(lobe: &Interpolant, theta_i_deg: f64) -> Self {
        let row = lobe.row(theta_i_deg.to_radians());
        match row.phi() {
            None => plane_density(lobe, &row, theta_i_deg),
            Some(phi) => {
                let first = 0;
                let last = phi.cells - 1;
                plane_cut(lobe, &row, theta_i_deg, last, first)
            }
        }
    }

    /// The same with neighbouring cells averaged (by their extent) until each spans at least `least_deg`: cells near
    /// the mirror direction are far narrower than what a figure shows, and noisier.
    #[must_use]
    pub fn merged(&self, least_deg: f64) -> Self {
        let mut groups: Vec<std::ops::Range<usize>> = Vec::new();
        let (mut start, mut extent) = (0, 0.0);
        for (k, width) in self.extent_deg.iter().enumerate() {
            extent += width;
            if extent >= least_deg || k + 1 == self.extent_deg.len() {
                groups.push(start..k + 1);
                (start, extent) = (k + 1, 0.0);
            }
        }
        let total = |group: &std::ops::Range<usize>| self.extent_deg[group.clone()].iter().sum::<f64>();
        let mean = |values: &[f64]| -> Vec<f64> {
            let sum = |group: &std::ops::Range<usize>| -> f64 {
                group.clone().map(|k| values[k] * self.extent_deg[k]).sum()
            };
            groups.iter().map(|group| sum(group) / total(group)).collect()
        };
        // Cells hold different paths: their errors are independent.
        let mean_error = |errors: &[f64]| -> Vec<f64> {
            let sum = |group: &std::ops::Range<usize>| -> f64 {
                group.clone().map(|k| (errors[k] * self.extent_deg[k]).powi(2)).sum()
            };
            groups.iter().map(|group| sum(group).sqrt() / total(group)).collect()
        };
        Self {
            exit_deg: mean(&self.exit_deg),
            extent_deg: groups.iter().map(total).collect(),
            value: self.value.each_ref().map(|values| mean(values)),
            std_error: self.std_error.each_ref().map(|errors| mean_error(errors)),
            ..*self
        }
    }

    /// Interior and surface together: value and standard error (they are independent).
    #[must_use]
    pub fn reflected(&self) -> (Vec<f64>, Vec<f64>) {
        let [interior, surface, _] = &self.value;
        let [interior_error, surface_error, _] = &self.std_error;
        let value = interior.iter().zip(surface).map(|(a, b)| a + b).collect();
        let error = interior_error.iter().zip(surface_error).map(|(a, b)| a.hypot(*b)).collect();
        (value, error)
    }
}

/// The plane density of the walk: the stored values are it times A/∫g dω, and its integral over s is A.
fn plane_density(lobe: &Interpolant, row: &Row<'_>, theta_i_deg: f64) -> Profile {
    let extents = measure::cell_extents(&lobe.table().meta().exit_axis, row.theta_i());
    let mut profile = empty(theta_i_deg, Quantity::PerDegree);
    profile.exit_deg = row.columns().centres().iter().map(|s| s.to_degrees()).collect();
    profile.extent_deg = extents.iter().map(|extent| extent.to_degrees()).collect();
    for component in Component::ALL {
        let samples = lobe.table().lobe(component);
        let cells = |channel: &[f32]| -> Vec<f64> {
            (0..extents.len()).map(|column| row.cell(channel, 0, column)).collect()
        };
        let values = cells(&samples.value);
        let integral: f64 = values.iter().zip(&extents).map(|(v, ds)| v * ds).sum();
        let albedo = lobe.albedo(component, row.theta_i());
        let per_degree = if integral > 0.0 { (albedo / integral).to_radians() } else { 0.0 };
        let scaled = |values: Vec<f64>| values.into_iter().map(|v| v * per_degree).collect();
        profile.value[component as usize] = scaled(values);
        profile.std_error[component as usize] = scaled(cells(&samples.std_error));
    }
    profile
}

/// f·cos θo through the φ cells next to 180° (turned round, s < 0) and next to 0°.
fn plane_cut(lobe: &Interpolant, row: &Row<'_>, theta_i_deg: f64, back: usize, forward: usize) -> Profile {
    let mut profile = empty(theta_i_deg, Quantity::PerSteradian);
    let centres: Vec<f64> = row.columns().centres().iter().map(|theta_o| theta_o.to_degrees()).collect();
    profile.exit_deg = centres.iter().rev().map(|theta_o| -theta_o).chain(centres.iter().copied()).collect();
    let extents: Vec<f64> =
        row.columns().edges().windows(2).map(|edge| (edge[1] - edge[0]).to_degrees()).collect();
    profile.extent_deg = extents.iter().rev().chain(&extents).copied().collect();
    for component in Component::ALL {
        let samples = lobe.table().lobe(component);
        let correction = row.correction(component);
        let cells = |channel: &[f32]| -> Vec<f64> {
            let back = (0..centres.len()).rev().map(|column| (back, column));
            let forward = (0..centres.len()).map(|column| (forward, column));
            back.chain(forward).map(|(phi, column)| correction * row.cell(channel, phi, column)).collect()
        };
        profile.value[component as usize] = cells(&samples.value);
        profile.std_error[component as usize] = cells(&samples.std_error);
    }
    profile
}

fn empty(theta_i_deg: f64, quantity: Quantity) -> Profile {
    Profile {
        theta_i_deg,
        quantity,
        exit_deg: Vec::new(),
        extent_deg: Vec::new(),
        value: Default::default(),
        std_error: Default::default(),
    }
}
