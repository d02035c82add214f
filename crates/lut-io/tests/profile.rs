//! Profiles in the plane of incidence.

use lut_io::lobe::Interpolant;
use lut_io::profile::{Profile, Quantity};
use lut_io::slice::Slice;
use lut_io::table::Component;

fn light(profile: &Profile) -> f64 {
    let (value, _) = profile.reflected();
    value.iter().zip(&profile.extent_deg).map(|(v, d)| v * d).sum()
}

#[test]
fn a_plane_profile_holds_all_the_reflected_light_at_nodes_and_between() {
    let lobe = Interpolant::new(specimen::plane(&[0.0, 20.0, 40.0, 60.0], 64));
    for theta_i_deg in [0.0, 20.0, 33.0, 60.0f64] {
        let profile = Profile::new(&lobe, theta_i_deg);
        let theta_i = theta_i_deg.to_radians();
        let albedo = lobe.albedo(Component::Interior, theta_i) + lobe.albedo(Component::Surface, theta_i);
        assert_eq!(profile.quantity, Quantity::PerDegree);
        assert!((light(&profile) / albedo - 1.0).abs() < 1e-12);
    }
}

#[test]
fn merging_cells_keeps_the_light_and_shrinks_the_error() {
    let lobe = Interpolant::new(specimen::plane(&[30.0], 128));
    let profile = Profile::new(&lobe, 30.0);
    let merged = profile.merged(2.0);
    assert!(merged.exit_deg.len() < profile.exit_deg.len());
    // The last group may be a remainder.
    let whole = &merged.extent_deg[..merged.extent_deg.len() - 1];
    assert!(whole.iter().all(|extent| *extent >= 2.0));
    assert!((light(&merged) / light(&profile) - 1.0).abs() < 1e-12);
    let largest = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
    assert!(largest(&merged.std_error[0]) < 0.6 * largest(&profile.std_error[0]));
}

#[test]
fn the_forward_half_of_a_space_profile_is_the_slice_next_to_the_plane() {
    let lobe = Interpolant::new(specimen::space(&[0.0, 45.0], 32, 16));
    let profile = Profile::new(&lobe, 45.0);
    let phi = lobe.row(45f64.to_radians()).phi().unwrap().at(0.5).to_degrees();
    let slice = Slice::new(&lobe, 45.0, phi);
    assert!(slice.stored);
    assert_eq!(profile.exit_deg[32..], slice.theta_o_deg);
    for (a, b) in profile.value[0][32..].iter().zip(&slice.component(Component::Interior).value) {
        // The profile has the correction, which is the rounding of f32 here.
        assert!((a - b).abs() <= 1e-7 * b);
    }
}
