//! The lobe out of the plane of incidence (Fig. 10): a map of the hemisphere and cuts at several azimuths.

use super::styled;
use kuva::plot::{ColorMap, ContourPlot, LegendPosition, LinePlot};
use kuva::render::figure::Figure;
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use kuva::render::render::Scene;
use lut_io::lobe::{Interpolant, Row};
use lut_io::table::Component;
use std::sync::Arc;

/// Azimuths of the cuts, degrees from the mirror direction.
const AZIMUTHS_DEG: [f64; 7] = [0.0, 10.0, 20.0, 30.0, 60.0, 90.0, 180.0];
/// Points of the map along each side.
const MAP_POINTS: usize = 121;
/// Least distance of two points of a cut, degrees.
const CUT_STEP_DEG: f64 = 0.4;
/// Contours of the map, shares of the peak.
const LEVELS: [f64; 7] = [0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9];

/// Fig. 10: left f·cos θo over the direction cosines of the exit, right along θo at several azimuths.
pub(super) fn map_and_cuts(lobe: &Interpolant, theta_i_deg: f64) -> Scene {
    let row = lobe.row(theta_i_deg.to_radians());
    let (map, cuts) = (map(&row), cuts(&row));
    let left = styled(Layout::auto_from_plots(&map))
        .with_title(format!("θi = {theta_i_deg}°, map of the hemisphere"))
        .with_x_label("sin θo cos φ (forward > 0)")
        .with_y_label("sin θo sin φ")
        .with_x_axis_min(-1.05)
        .with_x_axis_max(1.05)
        .with_y_axis_min(-1.05)
        .with_y_axis_max(1.05)
        .with_x_tick_step(0.5)
        .with_y_tick_step(0.5)
        .with_equal_aspect();
    let right = styled(Layout::auto_from_plots(&cuts))
        .with_title(format!("θi = {theta_i_deg}°, cuts at azimuth φ"))
        .with_x_label("exit angle θo (°)")
        .with_y_label("f·cos θo (1/sr)")
        .with_x_axis_min(0.0)
        .with_x_axis_max(90.0)
        .with_x_tick_step(15.0)
        .with_y_axis_min(0.0)
        .with_legend_title("φ")
        .with_legend_position(LegendPosition::InsideTopRight);
    Figure::new(1, 2)
        .with_plots(vec![map, cuts])
        .with_layouts(vec![left, right])
        .with_labels_lowercase()
        .with_cell_size(500.0, 450.0)
        .with_keep_panel_legends()
        .render()
}

fn reflected(row: &Row<'_>, theta_o: f64, phi: f64) -> f64 {
    row.eval(Component::Interior, theta_o, phi) + row.eval(Component::Surface, theta_o, phi)
}

fn map(row: &Row<'_>) -> Vec<Plot> {
    let side: Vec<f64> = (0..MAP_POINTS).map(|i| -1.0 + 2.0 * i as f64 / (MAP_POINTS - 1) as f64).collect();
    let at = |x: f64, y: f64| {
        let sine = x.hypot(y);
        // Outside the disc of directions there is nothing.
        if sine > 1.0 { 0.0 } else { reflected(row, sine.asin(), y.atan2(x)) }
    };
    let values: Vec<Vec<f64>> = side.iter().map(|y| side.iter().map(|x| at(*x, *y)).collect()).collect();
    let peak = values.iter().flatten().copied().fold(f64::MIN_POSITIVE, f64::max);
    let contour = ContourPlot::new()
        .with_grid(values, side.clone(), side)
        .with_levels(&LEVELS.map(|share| share * peak))
        .with_filled()
        .with_colormap(ColorMap::Custom(Arc::new(dark_to_white)))
        .with_legend("f·cos θo (1/sr)");
    let horizon = (0..=180).map(|k| (2.0 * f64::from(k)).to_radians()).map(|a| (a.cos(), a.sin()));
    let horizon = LinePlot::new().with_data(horizon).with_color("#606060").with_stroke_width(1.0);
    vec![contour.into(), horizon.into()]
}

/// Paper white where there is no light, darker with more of it.
fn dark_to_white(share: f64) -> String {
    if share < 0.01 { "#ffffff".to_owned() } else { ColorMap::YellowGreenBlue.map(share) }
}

fn cuts(row: &Row<'_>) -> Vec<Plot> {
    // Every half cell of the table, thinned to what a figure shows.
    let axis = row.columns();
    let mut exits: Vec<f64> =
        (0..=2 * axis.cells).map(|k| axis.at(0.5 * k as f64)).filter(|s| *s >= 0.0).collect();
    exits.dedup_by(|next, kept| (*next - *kept).to_degrees() < CUT_STEP_DEG);
    let cut = |(index, phi_deg): (usize, f64)| {
        let points = exits
            .iter()
            .map(|theta_o| (theta_o.to_degrees(), reflected(row, *theta_o, phi_deg.to_radians())));
        LinePlot::new()
            .with_data(points)
            .with_color(ColorMap::Viridis.map(0.9 * index as f64 / (AZIMUTHS_DEG.len() - 1) as f64))
            .with_stroke_width(1.4)
            .with_legend(format!("{phi_deg:.0}°"))
            .into()
    };
    AZIMUTHS_DEG.into_iter().enumerate().map(cut).collect()
}
