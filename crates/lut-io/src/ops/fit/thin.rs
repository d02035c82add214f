//! Fewer cells and fewer incidences, chosen where the lobe allows it.

use crate::error::FieldError;
use crate::model::axis::ExitAxis;
use crate::model::measure;
use crate::model::table::{Component, IncidenceSummary, Lobe, Parts, Table};
use crate::ops::diff;
use crate::read::lobe::Interpolant;

/// Cells that a coarser axis has along one of its axes, in eighths of the table's.
const EIGHTHS: [usize; 6] = [2, 3, 4, 5, 6, 7];
/// Share of the permitted error that coarser cells may use up; the rest is left to fewer incidences.
const SHARE_OF_CELLS: f64 = 0.5;
/// Fewest cells along an axis of a coarser table.
const FEWEST_CELLS: usize = 4;

/// The table on fewer cells and incidences, within a total variation of the whole (per cent of the reflected light, at the
/// table's own incidences).
///
/// Cells first: the coarsest axis that uses up at most half of the permitted error. Then incidences: starting from the first
/// and the last, the worst one between two is added until all are within it; so they end up dense where the lobe turns fast.
///
/// # Errors
/// A table that holds light from below, or lobes at further wavelengths.
pub fn thinned(lobe: &Interpolant, percent: f64) -> Result<Table, FieldError> {
    let table = lobe.table();
    table.meta().check_single_lobe()?;
    let axis = coarsest(lobe, SHARE_OF_CELLS * percent)?;
    let incidences = sparsest(lobe, &axis, percent)?;
    let thin = resampled(lobe, &axis, &incidences)?;
    Ok(
        if thin.meta().exit_axis == table.meta().exit_axis
            && incidences.len() == table.meta().per_incidence.len()
        {
            table.clone()
        } else {
            thin
        },
    )
}

/// The table on the given cells and on some of its incidences (by their index, ascending), as read; every lobe keeps its share of
/// the light.
///
/// # Errors
/// No table: cells that an axis cannot have, no incidences, or light from below or at further wavelengths, which is not resampled.
pub fn resampled(lobe: &Interpolant, axis: &ExitAxis, incidences: &[usize]) -> Result<Table, FieldError> {
    let table = lobe.table();
    let mut meta = table.meta().clone();
    meta.compact = None;
    meta.exit_axis = *axis;
    meta.per_incidence = incidences.iter().map(|i| table.meta().per_incidence[*i].clone()).collect();
    let same_cells = *axis == table.meta().exit_axis;
    let cells = table.meta().exit_axis.cells();
    let lobes = Component::ALL.map(|component| {
        let samples = &table.lobe(component).value;
        let mut value = Vec::with_capacity(incidences.len() * axis.cells());
        for &i in incidences {
            if same_cells {
                value.extend_from_slice(&samples[i * cells..(i + 1) * cells]);
            } else {
                value.extend(on_cells(lobe, component, axis, &table.meta().per_incidence[i]));
            }
        }
        Lobe { std_error: vec![0.0; value.len()], count: vec![0.0; value.len()], value }
    });
    Table::new(Parts { meta, lobes, passages: None, bands: Vec::new() })
}

/// One row read at the centres of other cells, scaled to its share of the light.
fn on_cells(
    lobe: &Interpolant,
    component: Component,
    axis: &ExitAxis,
    summary: &IncidenceSummary,
) -> Vec<f32> {
    let theta_i = summary.theta_i_deg.to_radians();
    let row = lobe.row(theta_i);
    let columns = axis.columns_at(theta_i);
    let samples = &lobe.table().lobe(component).value;
    let fine = lobe.table().meta().exit_axis;
    let centre = |k: usize, coarse: usize, fine: usize| (k as f64 + 0.5) / coarse as f64 * fine as f64;
    let values: Vec<f64> = (0..axis.rows_per_incidence())
        .flat_map(|r| (0..columns.cells).map(move |c| (r, c)))
        .map(|(r, c)| {
            // The two axes are one formula: equal shares of the cells are equal angles.
            let along = centre(c, columns.cells, fine.columns());
            let across = centre(r, axis.rows_per_incidence(), fine.rows_per_incidence());
            row.at_position(samples, across, along)
        })
        .collect();
    let weights = measure::reading_weights(axis, theta_i, summary.azimuth_width_deg.to_radians());
    let integral: f64 = weights.iter().zip(&values).map(|(w, v)| w * v).sum();
    let scale = if integral > 0.0 { summary.share(component) / integral } else { 1.0 };
    values.into_iter().map(|v| (v * scale) as f32).collect()
}

/// The axis with the fewest cells within a total variation (per cent).
fn coarsest(lobe: &Interpolant, percent: f64) -> Result<ExitAxis, FieldError> {
    let table = lobe.table();
    let all: Vec<usize> = (0..table.meta().per_incidence.len()).collect();
    let fine = table.meta().exit_axis;
    // Cells are judged at some incidences: all would only cost time.
    let mut some: Vec<usize> =
        all.iter().copied().step_by(all.len().div_ceil(16)).chain(all.last().copied()).collect();
    some.dedup();
    let judged = Interpolant::new(resampled(lobe, &fine, &some)?);
    let mut candidates: Vec<ExitAxis> = match fine {
        ExitAxis::Plane { cells, width } => EIGHTHS
            .iter()
            .filter_map(|e| eighths(cells, *e))
            .map(|cells| ExitAxis::Plane { cells, width })
            .collect(),
        ExitAxis::Space { theta_cells, phi_cells, width } => EIGHTHS
            .iter()
            .chain(&[8])
            .filter_map(|e| eighths(theta_cells, *e))
            .flat_map(|theta_cells| {
                EIGHTHS
                    .iter()
                    .chain(&[8])
                    .filter_map(move |e| eighths(phi_cells, *e))
                    .map(move |phi_cells| ExitAxis::Space { theta_cells, phi_cells, width })
            })
            .collect(),
    };
    candidates.sort_by_key(ExitAxis::cells);
    for axis in candidates {
        let coarse = Interpolant::new(resampled(lobe, &axis, &some)?);
        if diff::diff(&judged, &coarse).worst_total_variation_percent <= percent {
            return Ok(axis);
        }
    }
    Ok(fine)
}

/// So many eighths of a number of cells, even; `None` below [`FEWEST_CELLS`].
fn eighths(cells: usize, eighths: usize) -> Option<usize> {
    let coarse = cells * eighths / 16 * 2;
    (coarse >= FEWEST_CELLS).then_some(coarse)
}

/// The incidences that reading between them needs, by their index in the table.
fn sparsest(lobe: &Interpolant, axis: &ExitAxis, percent: f64) -> Result<Vec<usize>, FieldError> {
    let all = lobe.table().meta().per_incidence.len();
    let mut kept: Vec<usize> = if all > 1 { vec![0, all - 1] } else { vec![0] };
    while kept.len() < all {
        let thin = Interpolant::new(resampled(lobe, axis, &kept)?);
        let errors: Vec<f64> =
            diff::diff(lobe, &thin).per_incidence.iter().map(|at| at.total_variation_percent).collect();
        let worst_between = |pair: &[usize]| {
            let worst = (pair[0] + 1..pair[1]).max_by(|a, b| errors[*a].total_cmp(&errors[*b]))?;
            // Halving an interval serves reading better than cutting off its worst end.
            (errors[worst] > percent).then_some(usize::midpoint(pair[0], pair[1]))
        };
        let added: Vec<usize> = kept.windows(2).filter_map(worst_between).collect();
        if added.is_empty() {
            break;
        }
        kept.extend(added);
        kept.sort_unstable();
    }
    Ok(kept)
}
