//! A measured BRDF as lines of numbers.

use super::goniometer::Measured;
use std::fmt::Write as _;

/// What stands in the columns.
const HEADER: &str = "theta_i_deg,theta_o_deg,phi_deg,solid_angle_sr,red,green,blue\n";

/// The file.
pub(super) fn encode(measured: &Measured) -> Vec<u8> {
    let mut text = String::from(HEADER);
    for row in measured.rows() {
        let [r, g, b] = row.rgb;
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{},{},{},{:.5e},{r:.4e},{g:.4e},{b:.4e}",
            row.theta_i, row.theta_o, row.phi, row.solid_angle
        );
    }
    text.into_bytes()
}
