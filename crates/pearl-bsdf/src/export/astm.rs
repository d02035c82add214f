//! A measured BRDF in the data format of ASTM E1392: keywords, then lines of angles in radians and values.
//!
//! By the reader in libbsdf (Kimura, `AstmReader.cpp`): `NUM_POINTS` with a count, `VARS` with the names of the columns, of which
//! the first four are angles and three more may be X, Y and Z. Azimuths are those of the directions themselves: light from φi = 0
//! is mirrored to φs = π.

use super::goniometer::Measured;
use std::fmt::Write as _;
use thinfilm::colour::xyz_of_linear_srgb;

/// The file.
pub(super) fn encode(measured: &Measured, name: &str) -> Vec<u8> {
    let name: String = name.chars().filter(|c| !c.is_control()).collect();
    let mut text = format!(
        "TITLE {name}\nNUM_POINTS {}\nVARS theta_i,phi_i,theta_s,phi_s,X,Y,Z\n",
        measured.rows().count()
    );
    for row in measured.rows() {
        let [x, y, z] = xyz_of_linear_srgb(row.rgb);
        let [theta_i, theta_s, phi_s] = [row.theta_i, row.theta_o, 180.0 - row.phi].map(f64::to_radians);
        // Writing to a string does not fail.
        let _ = writeln!(text, "{theta_i:.6},0,{theta_s:.6},{phi_s:.6},{x:.4e},{y:.4e},{z:.4e}");
    }
    text.into_bytes()
}
