//! An ES module with a material for three.js: the evaluator in GLSL, and the prepared arrays that it gathers from.

use super::npz::{self, Form};
use crate::web::MODULES;
use crate::{Array, PearlBsdf};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lut_io::FieldError;

const MATERIAL: &str = include_str!("../../web/three.js");
/// What stands in it for the pearl's name.
const NAME: &str = "@name@";

/// The module, and the arrays in it: all but those over the wavelength, which no colour in red, green and blue reads.
pub(super) fn encode(bsdf: &PearlBsdf, name: &str) -> Result<(Vec<u8>, Vec<Array>), FieldError> {
    let read = |array: &Array| !array.name.ends_with("_spectral") && array.name != "channel_nm";
    let arrays: Vec<Array> = bsdf.prepared().arrays().into_iter().filter(read).collect();
    let packed =
        npz::encode(&arrays, Form::Small).map_err(|why| FieldError::new("arrays", why.to_string()))?;
    // Nothing that would end the comment that it stands in.
    let name: String = name.chars().map(|c| if c.is_control() || c == '*' { ' ' } else { c }).collect();
    let mut text: String = lines(&MATERIAL.replace(NAME, &name));
    for (_, module) in MODULES {
        text.push('\n');
        text.extend(
            lines(module).split_inclusive('\n').map(|line| line.strip_prefix("export ").unwrap_or(line)),
        );
    }
    text.push_str(&format!("\nconst DATA = \"{}\";\n", STANDARD.encode(packed)));
    Ok((text.into_bytes(), arrays))
}

/// The lines of a module but those that import another of ours, which stands in the same file.
fn lines(module: &str) -> String {
    let ours = |line: &str| line.starts_with("import ") && line.contains("\"nacre/");
    module.split_inclusive('\n').filter(|line| !ours(line)).collect()
}
