//! Files for other renderers say what the BSDF says, to the error that each prints.

mod made_up;

use made_up::with_spectra;
use pearl_bsdf::export::{Content, Export, Format};
use pearl_bsdf::round_trip::RoundTrip;
use pearl_bsdf::{Controls, PearlBsdf};

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
