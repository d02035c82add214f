//! Error bars of the page's lobe.

use lut_io::lobe::Interpolant;
use lut_io::table::{Component, Table};
use pearl_bsdf::Array;
use std::f64::consts::PI;
use std::sync::Arc;

/// Exit angles in the plane of incidence, degrees from the normal towards the mirror direction: from −90 to 90 in equal steps.
const STEP_DEG: i32 = 5;

/// Standard error of the interior lobe in the plane of incidence as a share of the lobe, `error_lobe` \[incidence, exit angle\], at the
/// incidences `error_incidence`, radians.
pub(crate) fn arrays(table: &Arc<Table>) -> [Array; 2] {
    let lobe = Interpolant::new(Arc::clone(table));
    let exits: Vec<i32> = (-90..=90).step_by(STEP_DEG as usize).collect();
    let theta_i = table.theta_i();
    let shares = theta_i.iter().flat_map(|theta_i| {
        let row = lobe.row(*theta_i);
        exits.iter().map(move |degrees| {
            let (theta_o, phi) = (f64::from(degrees.abs()).to_radians(), if *degrees < 0 { PI } else { 0.0 });
            let value = row.eval(Component::Interior, theta_o, phi);
            let error = row.std_error(Component::Interior, theta_o, phi);
            if value > 0.0 { (error / value) as f32 } else { 0.0 }
        })
    });
    [
        Array::new("error_incidence", &[theta_i.len()], theta_i.iter().map(|theta| *theta as f32)),
        Array::new("error_lobe", &[theta_i.len(), exits.len()], shares),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use bake_brdf::bake::{self, Observer, Request};
    use bake_brdf::options::{Options, SolverChoice, Target};
    use bake_brdf::recipe::Recipe;

    #[test]
    fn the_errors_of_a_walk_are_shares_of_its_lobe_and_fall_with_its_paths() {
        let walked = |paths| {
            let options = Options {
                solver: Some(SolverChoice::Walk),
                target: Target::Paths(paths),
                incident_deg: Some(vec![0.0, 40.0]),
                cells: Some([24, 1]),
                ..Options::default()
            };
            let recipe = Recipe::from_json(r#"{"stack":{"layers":9},"facets":{"slope_sd_deg":5}}"#).unwrap();
            let request = Request::new(recipe, options).unwrap();
            Arc::new(bake::bake(&request, &Observer::idle()).unwrap())
        };
        let at_mirror = |table: &Arc<Table>| {
            let [incidence, errors] = arrays(table);
            assert_eq!((incidence.values.len(), &errors.shape[..]), (2, &[2, 37][..]));
            // 40° towards the mirror direction, at 40°.
            errors.values[37 + (90 + 40) / 5]
        };
        let [few, many] = [walked(4096), walked(65_536)];
        let table = Interpolant::new(Arc::clone(&few));
        let (row, theta) = (table.row(f64::to_radians(40.0)), f64::to_radians(40.0));
        let share =
            row.std_error(Component::Interior, theta, 0.0) / row.eval(Component::Interior, theta, 0.0);
        let [few, many] = [at_mirror(&few), at_mirror(&many)];
        assert!((f64::from(few) / share - 1.0).abs() < 1e-5 && few > 0.0, "{few} {share}");
        // Sixteen times the paths.
        assert!((few / many / 4.0 - 1.0).abs() < 0.3, "{few} {many}");
    }
}
