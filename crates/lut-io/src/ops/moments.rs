//! Moments of the exit angle, from the cells of one incidence.

use crate::model::table::{Component, Table};
use crate::ops::explain::Light;

/// Moments of all reflected light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moments {
    /// Mean and standard deviation of the exit angle, radians (signed in decay tables, polar in space tables), and its skewness.
    pub(crate) moments: [f64; 3],
    /// Standard deviation of each by where in its cell a single path is.
    pub(crate) noise: [f64; 3],
}

impl Moments {
    /// Of the cells whose density over the exit angle is at least this share of the largest; `None` without light.
    ///
    /// Within a cell the density is taken to be linear, with the slope between its neighbours.
    pub(crate) fn of_cells(table: &Table, i: usize, least: f64) -> Option<Self> {
        let axis = &table.meta().exit_axis;
        let theta_i = table.meta().per_incidence[i].theta_i_deg.to_radians();
        let columns = axis.columns();
        let mut share = vec![0.0; columns];
        for component in [Component::Interior, Component::Surface] {
            for (k, light) in Light::by_cell(table, component, i).iter().enumerate() {
                share[k % columns] += light;
            }
        }
        let edges = axis.columns_at(theta_i).edges();
        let size: Vec<f64> = edges.windows(2).map(|edge| edge[1] - edge[0]).collect();
        let middle: Vec<f64> = edges.windows(2).map(|edge| 0.5 * (edge[0] + edge[1])).collect();
        let mut density: Vec<f64> = share.iter().zip(&size).map(|(share, size)| share / size).collect();
        let floor = least * density.iter().copied().fold(0.0, f64::max);
        for (share, density) in share.iter_mut().zip(&mut density) {
            if *density < floor {
                (*share, *density) = (0.0, 0.0);
            }
        }
        let all: f64 = share.iter().sum();
        if all <= 0.0 {
            return None;
        }
        let slope = |k: usize| {
            if k == 0 || k + 1 == columns {
                return 0.0;
            }
            let slope = (density[k + 1] - density[k - 1]) / (middle[k + 1] - middle[k - 1]);
            // Not below zero within the cell.
            let most = 2.0 * density[k] / size[k];
            slope.clamp(-most, most)
        };
        let slopes: Vec<f64> = (0..columns).map(slope).collect();
        let sum = |of: &dyn Fn(usize) -> f64| (0..columns).map(of).sum::<f64>() / all;
        // ∫ x·slope·(x − middle) dx is slope·size³/12.
        let tilt = |k: usize| slopes[k] * size[k].powi(3) / 12.0;
        let mean = sum(&|k| share[k] * middle[k] + tilt(k));
        let x = |k: usize| middle[k] - mean;
        let spread2 = |k: usize| size[k] * size[k] / 12.0;
        let second = sum(&|k| share[k] * (x(k).powi(2) + spread2(k)) + 2.0 * x(k) * tilt(k));
        let third = sum(&|k| {
            share[k] * x(k) * (x(k).powi(2) + 3.0 * spread2(k))
                + tilt(k) * (3.0 * x(k).powi(2) + 0.15 * size[k] * size[k])
        });
        let sd = second.sqrt();
        let noise = |power: i32| sum(&|k| share[k] * x(k).powi(2 * power) * spread2(k)).sqrt();
        Some(Self {
            moments: [mean, sd, third / sd.powi(3)],
            noise: [noise(0), noise(1) / sd, 3.0 * noise(2) / sd.powi(3) + 3.0 * noise(0) / sd],
        })
    }
}
