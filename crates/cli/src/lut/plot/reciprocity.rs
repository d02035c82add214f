//! The defect of reciprocity as a map over both angles.

use super::styled;
use kuva::plot::{ColorMap, Heatmap};
use kuva::render::figure::Figure;
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use kuva::render::render::Scene;
use lut_io::lobe::Interpolant;
use lut_io::reciprocity::{self, DefectMap};
use std::path::Path;
use terminal::{Outcome, Stop};

/// Angles along each side of the map: half-way between whole even degrees, so that most lie between a table's incidences.
const ANGLES: usize = 45;

/// The map in the plane of incidence, forward half.
pub(super) fn map(lobe: &Interpolant) -> DefectMap {
    let angles: Vec<f64> = (0..ANGLES).map(|k| (2.0 * k as f64 + 0.9).to_radians()).collect();
    reciprocity::defect(lobe, &angles, 0.0)
}

/// The map drawn in per cent of the peak.
pub(super) fn scene(map: &DefectMap) -> Scene {
    let percent = |row: &Vec<f64>| row.iter().map(|defect| 100.0 * defect).collect();
    let rows: Vec<Vec<f64>> = map.defect.iter().map(percent).collect();
    let heat = Heatmap::new()
        .with_data(rows)
        .with_x_range(0.0, 90.0)
        .with_y_range(0.0, 90.0)
        .with_cell_size(1.0)
        .with_color_map(ColorMap::Viridis)
        .with_legend("% of the peak");
    let plots = vec![Plot::Heatmap(heat)];
    let layout = styled(Layout::auto_from_plots(&plots))
        // The colour bar bears no label of its own.
        .with_title(format!(
            "defect of reciprocity: colour in % of the peak; {:.2} % of the light",
            100.0 * map.total
        ))
        .with_x_label("exit angle θo (°)")
        .with_y_label("angle of incidence θi (°)")
        .with_x_axis_min(0.0)
        .with_x_axis_max(90.0)
        .with_y_axis_min(0.0)
        .with_y_axis_max(90.0)
        .with_x_tick_step(15.0)
        .with_y_tick_step(15.0);
    Figure::new(1, 1).with_plots(vec![plots]).with_layouts(vec![layout]).with_cell_size(620.0, 520.0).render()
}

/// Writes the numbers of the map.
pub(super) fn write(map: &DefectMap, path: &Path) -> Outcome {
    let mut object = serde_json::to_value(map).map_err(Stop::failure)?;
    object["schema"] = "lut-reciprocity/1".into();
    let text = serde_json::to_string(&object).map_err(Stop::failure)? + "\n";
    nacre_cli::write_file(path, text.as_bytes())
}
