//! The lobe in the plane of incidence: one incidence with its parts (Fig. 6), many incidences (Fig. 7).

use super::{BLACK, BLUE, ORANGE, styled};
use kuva::plot::{ColorMap, LegendPosition, LinePlot};
use kuva::render::annotations::ReferenceLine;
use kuva::render::figure::Figure;
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use kuva::render::render::{Scene, render_multiple};
use lut_io::lobe::Interpolant;
use lut_io::profile::{Profile, Quantity};
use lut_io::table::Component;

/// Incidences of the paper's Fig. 7, degrees.
const INCIDENCES_DEG: [f64; 10] = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0];
/// Half-width of the error bands in standard errors.
const BAND: f64 = 2.0;
/// Points a standard deviation of the lobe: cells are averaged to that.
const POINTS_PER_SD: f64 = 12.0;
/// Where the curves are said to end: share of their highest peak.
const END: f64 = 2e-3;

/// Fig. 6: one incidence; all reflected light, the interior and the surface, with error bands.
pub(super) fn one(lobe: &Interpolant, theta_i_deg: f64) -> Scene {
    let profile = profile(lobe, theta_i_deg);
    let part = |component: Component| {
        (profile.value[component as usize].clone(), profile.std_error[component as usize].clone())
    };
    let curves = [
        ("all reflected light", BLACK, profile.reflected()),
        ("interior (blur)", BLUE, part(Component::Interior)),
        ("surface (interface 0)", ORANGE, part(Component::Surface)),
    ];
    let plots: Vec<Plot> = curves
        .into_iter()
        .map(|(name, color, (value, error))| {
            curve(&profile.exit_deg, &value, color, name).with_band_around(&value, &error).into()
        })
        .collect();
    let top = highest(&profile.reflected().0);
    let layout = styled(axes(&plots, profile.quantity, first_light(&[&profile], top), 1.08 * top))
        .with_width(640.0)
        .with_height(420.0)
        .with_title(format!("Light reflected at θi = {theta_i_deg}°"))
        .with_legend_position(LegendPosition::InsideTopLeft)
        .with_reference_line(mirror_direction(theta_i_deg));
    render_multiple(plots, layout)
}

/// Fig. 7: 0° to 90° by 10°. Left on a common linear scale up to 80°, right all of them on a logarithmic one.
pub(super) fn many(lobe: &Interpolant) -> Scene {
    let profiles: Vec<Profile> = incidences(lobe).into_iter().map(|theta_i| profile(lobe, theta_i)).collect();
    let quantity = profiles[0].quantity;
    let tops: Vec<f64> = profiles.iter().map(|profile| highest(&profile.reflected().0)).collect();
    // The peak at grazing is ten times the others: on their scale it would hide them.
    let moderate = |top: f64| top <= 4.0 * tops.iter().copied().fold(f64::INFINITY, f64::min);
    let top = highest(&tops.iter().copied().filter(|top| moderate(*top)).collect::<Vec<f64>>());
    let floor = END * top;
    let start = first_light(&profiles.iter().collect::<Vec<_>>(), top);
    let curves = |log: bool| -> Vec<Plot> {
        let shown = profiles.iter().zip(&tops).filter(|(_, top)| log || moderate(**top));
        shown
            .map(|(profile, _)| {
                let (value, error) = profile.reflected();
                let (color, name) = (shade(profile.theta_i_deg), format!("{:.0}°", profile.theta_i_deg));
                if log {
                    // A logarithmic scale has no place for empty cells.
                    let points = profile.exit_deg.iter().copied().zip(value).filter(|(_, v)| *v >= floor);
                    let (x, y): (Vec<f64>, Vec<f64>) = points.unzip();
                    return curve(&x, &y, &color, &name).into();
                }
                curve(&profile.exit_deg, &value, &color, &name).with_band_around(&value, &error).into()
            })
            .collect()
    };
    let (linear, log) = (curves(false), curves(true));
    let left = styled(axes(&linear, quantity, start, 1.08 * top)).with_title("Linear scale");
    let right = styled(axes(&log, quantity, start, 1.5 * highest(&tops)))
        .with_log_y()
        .with_y_axis_min(floor)
        .with_title("Logarithmic scale")
        .with_legend_title("θi")
        .with_legend_position(LegendPosition::OutsideRightTop);
    Figure::new(1, 2)
        .with_plots(vec![linear.into_iter().map(without_legend).collect(), log])
        .with_layouts(vec![left, right])
        .with_labels_lowercase()
        .with_cell_size(500.0, 420.0)
        .with_keep_panel_legends()
        .render()
}

/// The paper's incidences as far as the table covers them; else the table's own, at most ten.
fn incidences(lobe: &Interpolant) -> Vec<f64> {
    let known: Vec<f64> = lobe.table().meta().per_incidence.iter().map(|s| s.theta_i_deg).collect();
    let range = known[0]..=known[known.len() - 1];
    let covered: Vec<f64> = INCIDENCES_DEG.into_iter().filter(|theta_i| range.contains(theta_i)).collect();
    if covered.len() > 1 {
        return covered;
    }
    known.iter().copied().step_by(known.len().div_ceil(INCIDENCES_DEG.len())).collect()
}

/// A profile as it is drawn: in per cent, at the resolution of a figure.
fn profile(lobe: &Interpolant, theta_i_deg: f64) -> Profile {
    let per_incidence = &lobe.table().meta().per_incidence;
    let nearest = per_incidence
        .iter()
        .min_by(|a, b| (a.theta_i_deg - theta_i_deg).abs().total_cmp(&(b.theta_i_deg - theta_i_deg).abs()));
    let sd_deg = nearest.map_or(0.0, |summary| summary.sd_theta_o_deg);
    let mut profile = Profile::new(lobe, theta_i_deg).merged(sd_deg / POINTS_PER_SD);
    if profile.quantity == Quantity::PerDegree {
        for number in profile.value.iter_mut().chain(&mut profile.std_error).flatten() {
            *number *= 100.0;
        }
    }
    profile
}

/// The multiple of 30° from which on there is light to show.
fn first_light(profiles: &[&Profile], top: f64) -> f64 {
    let lit = |profile: &&Profile| {
        let (value, _) = profile.reflected();
        value.iter().position(|v| *v > END * top).map(|k| profile.exit_deg[k])
    };
    let first = profiles.iter().filter_map(lit).fold(90.0, f64::min);
    (30.0 * (first / 30.0).floor()).clamp(-90.0, 60.0)
}

fn axes(plots: &[Plot], quantity: Quantity, start: f64, top: f64) -> Layout {
    let label = match quantity {
        Quantity::PerDegree => "reflected light (% of the incident, per degree)",
        Quantity::PerSteradian => "f·cos θo in the plane of incidence (1/sr)",
    };
    Layout::auto_from_plots(plots)
        .with_x_label("signed exit angle s (°)")
        .with_y_label(label)
        .with_x_axis_min(start)
        .with_x_axis_max(90.0)
        .with_x_tick_step(if start < -30.0 { 30.0 } else { 15.0 })
        .with_y_axis_min(0.0)
        .with_y_axis_max(top)
}

fn mirror_direction(theta_i_deg: f64) -> ReferenceLine {
    ReferenceLine::vertical(theta_i_deg).with_color("#808080").with_dasharray("4 3").with_label("mirror")
}

fn curve(x: &[f64], y: &[f64], color: &str, name: &str) -> LinePlot {
    LinePlot::new()
        .with_data(x.iter().copied().zip(y.iter().copied()))
        .with_color(color)
        .with_stroke_width(1.4)
        .with_legend(name)
}

trait Band {
    fn with_band_around(self, value: &[f64], error: &[f64]) -> Self;
}

impl Band for LinePlot {
    fn with_band_around(self, value: &[f64], error: &[f64]) -> Self {
        let lower = value.iter().zip(error).map(|(v, e)| (v - BAND * e).max(0.0));
        let upper = value.iter().zip(error).map(|(v, e)| v + BAND * e);
        self.with_band(lower, upper)
    }
}

fn without_legend(plot: Plot) -> Plot {
    match plot {
        Plot::Line(mut line) => {
            line.legend_label = None;
            Plot::Line(line)
        }
        other => other,
    }
}

/// From dark to light with the incidence, short of the yellow that white paper swallows.
fn shade(theta_i_deg: f64) -> String {
    ColorMap::Viridis.map(0.9 * theta_i_deg / 90.0)
}

fn highest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::MIN_POSITIVE, f64::max)
}
