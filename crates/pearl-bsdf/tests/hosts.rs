//! Files for other renderers say what the BSDF says, to the error that each prints.

mod made_up;

use made_up::with_spectra;
use pearl_bsdf::export::{Content, Export, Format};
use pearl_bsdf::round_trip::RoundTrip;
use pearl_bsdf::{Controls, PearlBsdf};
use std::f64::consts::PI;

fn bsdf() -> PearlBsdf {
    let incidences: Vec<f64> = (0..=45).map(|i| 2.0 * f64::from(i)).collect();
    let controls = Controls { depth: 0.0, coherence: 0.0, ..Controls::default() };
    PearlBsdf::from_table(specimen::plane(&incidences, 96), controls).unwrap()
}

fn exported(bsdf: &PearlBsdf, name: &str, format: Format) -> (String, Vec<RoundTrip>) {
    let export = Export::new(bsdf, name, format).unwrap();
    let Content::Approximation(errors, _) = export.content else { panic!("an approximation") };
    (String::from_utf8(export.bytes).unwrap(), errors)
}

#[test]
fn radiances_tree_keeps_the_albedo_to_a_hundredth_and_is_xml_of_three_trees() {
    let (text, errors) = exported(&bsdf(), "a <b> & c", Format::Radiance);
    for RoundTrip { theta_i_deg, error_percent, bias_percent } in errors {
        // Leaves are read without interpolation; at grazing they are as thick as the light changes.
        let most = if theta_i_deg <= 64.7 { 5.0 } else { 60.0 };
        let surplus = if theta_i_deg <= 80.0 { 1.0 } else { 3.0 };
        assert!(
            error_percent < most && bias_percent.abs() < surplus,
            "{theta_i_deg}: {error_percent} {bias_percent}"
        );
    }
    assert!(text.contains("<Name>a &lt;b> &amp; c</Name>"), "{}", &text[..600]);
    let trees: Vec<&str> = text
        .split("<ScatteringData>")
        .skip(1)
        .map(|rest| rest.split("</ScatteringData>").next().unwrap())
        .collect();
    assert_eq!(trees.len(), 3);
    for tree in &trees {
        // The same leaves in all three: Radiance decodes colours leaf by leaf.
        assert_eq!(shape(tree), shape(trees[0]));
        let leaves = tree.split(|c: char| "{} \n".contains(c)).filter(|leaf| !leaf.is_empty());
        assert!(leaves.map(|leaf| leaf.parse::<f64>().unwrap()).all(|x| x.is_finite() && x >= 0.0));
    }
}

/// A tree without its numbers.
fn shape(tree: &str) -> String {
    let mut shape = String::new();
    for c in tree.chars() {
        match c {
            '{' | '}' => shape.push(c),
            ' ' => shape.push(','),
            _ => {}
        }
    }
    shape
}

#[test]
fn a_name_that_xml_cannot_hold_is_refused() {
    let error = Export::new(&bsdf(), "a\u{1}b", Format::Radiance).unwrap_err();
    assert!(error.to_string().contains("control character"), "{error}");
}

#[test]
fn three_microfacet_lobes_follow_the_lobe_and_keep_its_albedo() {
    let (text, errors) = exported(&bsdf(), "specimen", Format::Microfacet);
    for RoundTrip { theta_i_deg, bias_percent, .. } in errors {
        assert!(
            bias_percent.abs() < if theta_i_deg <= 80.0 { 0.5 } else { 5.0 },
            "{theta_i_deg}: {bias_percent}"
        );
    }
    let file: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&file["schema"], &file["name"]), (&"pearl-microfacet/1".into(), &"specimen".into()));
    let nodes = file["per_incidence"].as_array().unwrap();
    assert_eq!(nodes.first().unwrap()["theta_i_deg"], 0.0);
    for node in nodes {
        let number = |name: &str| node[name].as_f64().unwrap();
        // The lobes of the specimen are Gaussian in angle, which is nearly Beckmann.
        if number("theta_i_deg") <= 70.0 {
            assert!(number("total_variation_percent") < 6.0, "{node}");
        }
        assert!(node["lobes"].as_array().unwrap().len() == 3 && number("albedo") > 0.0, "{node}");
    }
}

/// A pearl with all colours.
fn coloured() -> PearlBsdf {
    let incidences: Vec<f64> = (0..=30).map(|i| 3.0 * f64::from(i)).collect();
    PearlBsdf::from_table(with_spectra(specimen::plane(&incidences, 96)), Controls::default()).unwrap()
}

#[test]
fn blenders_reflections_follow_the_table_and_an_add_on_holds_the_same_script() {
    let bsdf = coloured();
    let name = "a \"b\" \\ \u{2c6}";
    let script = Export::new(&bsdf, name, Format::Blender).unwrap();
    let Content::Approximation(errors, Some(preview)) = &script.content else { panic!("an approximation") };
    for RoundTrip { theta_i_deg, error_percent, bias_percent } in errors {
        // Narrow lobes at the horizon change between the angles of the picture.
        let most = if *theta_i_deg <= 80.0 { 6.0 } else { 30.0 };
        assert!(*error_percent < most, "{theta_i_deg}: {error_percent}");
        assert!(*theta_i_deg > 80.0 || bias_percent.abs() < 1.5, "{theta_i_deg}: {bias_percent}");
    }
    assert!(preview.mean > 0.0 && preview.mean < 1.0 && preview.most < 3.0, "{preview:?}");

    let text = String::from_utf8(script.bytes.clone()).unwrap();
    let data = text.split("\nPEARL = r\"\"\"").nth(1).and_then(|rest| rest.split("\"\"\"\n").next()).unwrap();
    let pearl: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!((&pearl["schema"], &pearl["name"]), (&"pearl-blender/1".into(), &name.into()));
    let number = |value: &serde_json::Value| value.as_u64().unwrap() as usize;
    let (lobes, ramps) = (number(&pearl["lobes"]), pearl["edges_deg"].as_array().unwrap().len() - 1);
    // Shapes, turns, weights and albedo without and with interference, emission.
    assert_eq!(number(&pearl["height"]), lobes + 1 + 2 * (lobes + 1 + ramps + 1) + 1);

    let add_on = Export::new(&bsdf, name, Format::BlenderAddOn).unwrap();
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(add_on.bytes)).unwrap();
    let mut stored = |name: &str| std::io::read_to_string(archive.by_name(name).unwrap()).unwrap();
    assert!(stored("__init__.py") == text);
    assert!(stored("blender_manifest.toml").contains(concat!(
        "version = \"",
        env!("CARGO_PKG_VERSION"),
        "\""
    )));
}

#[test]
fn the_material_for_three_is_one_module_with_the_arrays_in_it() {
    let export = Export::new(&bsdf(), "a */ name", Format::Three).unwrap();
    let text = String::from_utf8(export.bytes).unwrap();
    let Content::Arrays(arrays) = export.content else { panic!("arrays") };
    assert!(arrays.iter().any(|array| array.name == "cells"));
    assert!(arrays.iter().all(|array| !array.name.ends_with("_spectral")));
    let found = |start: &str| text.lines().filter(|line| line.starts_with(start)).collect::<Vec<_>>();
    assert_eq!(found("import "), ["import * as THREE from \"three\";"]);
    assert_eq!(found("export "), ["export async function pearlMaterial(look = {}) {"]);
    // A comment ends where it should, and the archive is one.
    assert!(text.starts_with("/**\n * The pearl \"a  / name\""), "{}", &text[..60]);
    assert!(text.contains("\nconst DATA = \"UEsDB"), "no ZIP archive");
}

fn material(bsdf: &PearlBsdf, name: &str, format: Format) -> (Vec<u8>, Vec<RoundTrip>, serde_json::Value) {
    let export = Export::new(bsdf, name, format).unwrap();
    let report = export.report(std::path::Path::new("out"));
    let Content::Material(errors, Some(preview), _) = export.content else { panic!("a material") };
    assert!(preview.mean > 0.0 && preview.mean < 5.0 && preview.most > preview.mean, "{preview:?}");
    for RoundTrip { theta_i_deg, error_percent, .. } in &errors {
        assert!(*theta_i_deg > 60.0 || *error_percent < 20.0, "{theta_i_deg}: {error_percent}");
    }
    (export.bytes, errors, report["material"].clone())
}

#[test]
fn a_glb_is_a_sphere_with_the_fitted_numbers() {
    let (bytes, _, numbers) = material(&bsdf(), "a \"name\"", Format::Gltf);
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let json = word(12);
    let scene: serde_json::Value = serde_json::from_slice(&bytes[20..20 + json]).unwrap();
    let length = word(20 + json);
    assert_eq!((&bytes[24 + json..28 + json], 28 + json + length), (&b"BIN\0"[..], bytes.len()));
    assert_eq!(scene["materials"][0]["name"], "a \"name\"");
    let film = &scene["materials"][0]["extensions"]["KHR_materials_iridescence"];
    assert_eq!(film["iridescenceThicknessMaximum"], numbers["iridescence_thickness_nm"]);
    let points = scene["accessors"][0]["count"].as_u64().unwrap() as usize;
    let number = |at: usize| f32::from_bits(word(28 + json + 4 * at) as u32);
    for point in 0..points {
        let length = (0..3).map(|k| number(3 * point + k).powi(2)).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-5, "{point}: {length}");
    }
}

#[test]
fn an_openpbr_surface_is_xml_with_the_fitted_numbers() {
    let (bytes, _, numbers) = material(&bsdf(), "a <b> \"c\"", Format::OpenPbr);
    let text = String::from_utf8(bytes).unwrap();
    assert!(text.contains("doc=\"a &lt;b> &quot;c&quot;, by nacre\""), "{text}");
    let written = format!("<input name=\"coat_ior\" type=\"float\" value=\"{}\" />", numbers["coat_ior"]);
    assert!(text.contains(&written), "{written} in {text}");
    assert!(Export::new(&bsdf(), "a\u{1}b", Format::OpenPbr).is_err());
}

/// Albedo of light that arrives at an incidence.
fn albedo(bsdf: &PearlBsdf, theta_deg: f64) -> [f64; 3] {
    let parts = bsdf.directional_albedo(theta_deg.to_radians());
    std::array::from_fn(|c| parts.iter().map(|rgb| rgb[c]).sum())
}

#[test]
fn lines_of_a_measured_brdf_add_up_to_the_albedo() {
    let bsdf = bsdf();
    let (text, errors) = exported(&bsdf, "specimen", Format::Csv);
    assert!(errors[3].error_percent < 1.0, "{errors:?}");
    let (header, rest) = text.split_once('\n').unwrap();
    assert_eq!(header, "theta_i_deg,theta_o_deg,phi_deg,solid_angle_sr,red,green,blue");
    let rows: Vec<Vec<f64>> =
        rest.lines().map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    for theta in [0.0, 30.0, 60.0, 80.0] {
        let (mut sum, mut around) = (0.0, 0.0);
        for row in rows.iter().filter(|row| row[0] == theta) {
            sum += row[5] * row[1].to_radians().cos() * row[3];
            around += row[3];
        }
        let expected = albedo(&bsdf, theta)[1];
        assert!((sum / expected - 1.0).abs() < 0.01, "{theta}: {sum} {expected}");
        assert!((around - 2.0 * PI).abs() < 1e-3, "{around}");
    }
    // The same values as ASTM has them, in radians and XYZ.
    let (astm, _) = exported(&bsdf, "specimen", Format::Astm);
    let mut lines = astm.lines().skip(1);
    assert_eq!(lines.next(), Some(&*format!("NUM_POINTS {}", rows.len())));
    assert_eq!(lines.next(), Some("VARS theta_i,phi_i,theta_s,phi_s,X,Y,Z"));
    let astm: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    assert_eq!(astm.len(), rows.len());
    let brightest = |of: &dyn Fn(usize) -> f64, at: &dyn Fn(usize) -> bool| {
        (0..rows.len()).filter(|k| at(*k)).max_by(|a, b| of(*a).total_cmp(&of(*b))).unwrap()
    };
    // Light from φ = 0 is mirrored to φ = π.
    let peak = brightest(&|k| astm[k][5], &|k| (astm[k][0] - 30f64.to_radians()).abs() < 1e-5);
    assert!(
        (astm[peak][3] - PI).abs() < 1e-5 && (astm[peak][2] - astm[peak][0]).abs() < 0.05,
        "{:?}",
        astm[peak]
    );
    assert!(rows[peak][2] == 0.0 && rows[peak][0] == 30.0, "{:?}", rows[peak]);
}

#[test]
fn zemaxs_table_says_the_albedo_and_has_its_peak_in_the_mirror_direction() {
    let bsdf = bsdf();
    let (text, errors) = exported(&bsdf, "specimen", Format::Zemax);
    assert!(errors[3].error_percent < 1.0, "{errors:?}");
    let lines: Vec<&str> = text.lines().collect();
    let after = |name: &str| {
        let at = lines.iter().position(|line| line.starts_with(name)).unwrap();
        let count: usize = lines[at].split_whitespace().nth(1).unwrap().parse().unwrap();
        let angles: Vec<f64> = lines[at + 1].split_whitespace().map(|x| x.parse().unwrap()).collect();
        assert_eq!(angles.len(), count);
        angles
    };
    let [incidences, azimuths, radii] = ["AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"].map(after);
    assert_eq!((azimuths[0], *azimuths.last().unwrap(), radii[0]), (0.0, 180.0, 0.0));
    let luminance = lines.iter().position(|line| *line == "TristimulusY").unwrap();
    assert_eq!(lines[luminance + 1], "DataBegin");
    let block = |incidence: usize| luminance + 2 + incidence * (1 + azimuths.len());
    for (k, theta) in incidences.iter().enumerate().step_by(5) {
        let [r, g, b] = albedo(&bsdf, *theta);
        let tis: f64 = lines[block(k)].strip_prefix("TIS ").unwrap().parse().unwrap();
        assert!((tis - (0.2127 * r + 0.7152 * g + 0.0722 * b)).abs() < 1e-3, "{theta}: {tis}");
        let values: Vec<Vec<f64>> = (1..=azimuths.len())
            .map(|a| lines[block(k) + a].split_whitespace().map(|x| x.parse().unwrap()).collect())
            .collect();
        assert!(values.iter().all(|line| line.len() == radii.len()));
        // All azimuths of the mirror direction are the mirror direction.
        assert!(values.iter().all(|line| line[0] == values[0][0]));
        // Integrated over the sphere about it, f·cos θo is the TIS: azimuth 0 is towards the normal.
        let mut sum = 0.0;
        for (a, line) in values.iter().enumerate() {
            for (r, value) in line.iter().enumerate() {
                let half = |k: usize| {
                    let low = if k == 0 { radii[0] } else { 0.5 * (radii[k - 1] + radii[k]) };
                    (low, radii.get(k + 1).map_or(180.0, |next| 0.5 * (radii[k] + next)))
                };
                let (low, high) = half(r);
                let ring = low.to_radians().cos() - high.to_radians().cos();
                let share = if a == 0 || a + 1 == azimuths.len() { 0.5 } else { 1.0 } * 2.0 * PI
                    / (azimuths.len() - 1) as f64;
                let (radial, azimuth, theta) =
                    (radii[r].to_radians(), azimuths[a].to_radians(), theta.to_radians());
                let cos = radial.cos() * theta.cos() + radial.sin() * azimuth.cos() * theta.sin();
                sum += value * cos.max(0.0) * ring * share;
            }
        }
        assert!(*theta > 75.0 || (sum / tis - 1.0).abs() < 0.02, "{theta}: {sum} {tis}");
    }
    assert_eq!(text.matches("DataEnd").count(), 3);
}
