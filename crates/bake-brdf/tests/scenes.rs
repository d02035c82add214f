//! Scenes, end to end: plans, bakes, copies, refusals.

mod built;

use built::tool;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

fn json(folder: &Path, args: &[&str]) -> Value {
    let output = tool(folder, &[args, &["--json"]].concat());
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn scene(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/scenes").join(name);
    path.canonicalize().expect("the scene is there").display().to_string()
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Expected effects by scene and pearl, `unused` for a pearl that no shape shows.
fn expected() -> BTreeMap<String, BTreeMap<String, String>> {
    let text = fs::read_to_string(scene("plans.json")).expect("plans.json reads");
    serde_json::from_str(&text).expect("plans.json holds scenes of pearls")
}

/// Coarse and quick: what is tested is not the lobe.
const COARSE: [&str; 6] = ["--solver", "auto", "--accuracy", "20", "--incident-deg", "0:90:15"];

fn on(effects: &Value) -> String {
    let effects = effects.as_object().expect("an object");
    assert_eq!(effects.len(), 12, "every effect is named");
    let mut names: Vec<&str> =
        effects.iter().filter(|(_, effect)| effect["on"] == true).map(|(name, _)| name.as_str()).collect();
    let order = "surface blur azimuth polarisation absorption dispersion coherent coherent_sheets emission irregularity body texture";
    names.sort_by_key(|name| order.split(' ').position(|known| known == *name));
    names.join(" ")
}

#[test]
fn every_scene_has_the_plan_written_for_it() {
    let folder = folder();
    let expected = expected();
    assert_eq!(expected.len(), 8);
    for (name, pearls) in expected {
        let plan = json(
            folder.path(),
            &[&["plan", "--scene", &scene(&format!("{name}.xml"))], &COARSE[..]].concat(),
        );
        assert_eq!(plan["schema"], "bake-plan/1");
        let mut found = BTreeMap::new();
        for pearl in plan["pearls"].as_array().expect("a list") {
            for (effect, decision) in pearl["effects"].as_object().expect("an object") {
                assert!(!decision["why"].as_str().expect("a reason").is_empty(), "{name} {effect}");
                let (seconds, bytes) = (decision["seconds"].as_f64(), decision["bytes"].as_u64());
                let free = seconds == Some(0.0) && bytes == Some(0);
                assert!(decision["on"] == true || free, "{name}: {effect} is off and costs {decision}");
            }
            let used = pearl["used"].as_bool().expect("used is said");
            let effects = if used { on(&pearl["effects"]) } else { "unused".to_owned() };
            found.insert(pearl["id"].as_str().expect("an id").to_owned(), effects);
        }
        assert_eq!(found, pearls, "{name}");
    }
}

#[test]
fn a_reason_names_the_line_of_the_scene() {
    let folder = folder();
    let path = scene("grey-pearl.xml");
    let plan = json(folder.path(), &[&["plan", "--scene", &path], &COARSE[..]].concat());
    let line = 1 + fs::read_to_string(&path)
        .expect("reads")
        .lines()
        .position(|l| l.contains("\"depth\""))
        .expect("set");
    let why = plan["pearls"][0]["effects"]["emission"]["why"].as_str().expect("a reason");
    assert!(why.starts_with("depth 0 (") && why.ends_with(&format!("grey-pearl.xml:{line})")), "{why}");
    let text = tool(folder.path(), &[&["plan", "--scene", &path], &COARSE[..]].concat()).stdout;
    assert!(String::from_utf8_lossy(&text).contains(why), "the table says the same");
}

#[test]
fn every_scene_bakes_its_tables_once_and_a_copy_that_points_at_them() {
    for (name, pearls) in expected() {
        let folder = folder();
        let path = scene(&format!("{name}.xml"));
        let args = [&["--scene", &path, "-o", "."], &COARSE[..]].concat();
        let report = json(folder.path(), &args);
        let baked = report["baked"].as_array().expect("a list");
        let shown = pearls.values().filter(|effects| *effects != "unused").count();
        let copy = folder.path().join(format!("{name}-baked.xml"));
        if shown == 0 {
            assert_eq!(fs::read_dir(folder.path()).expect("reads").count(), 0, "{name}: nothing is baked");
            let said = tool(folder.path(), &args).stdout;
            assert!(String::from_utf8_lossy(&said).contains("no pearl: nothing baked"), "{name}");
            continue;
        }
        let text = fs::read_to_string(&copy).expect("the copy reads");
        assert!(!text.contains("name=\"recipe\"") && !text.contains("<include"), "{name}: {text}");
        for table in baked {
            assert_eq!(table["reused"], false, "{name}");
            let file = table["file"].as_str().expect("a name");
            assert!(text.contains(&format!("name=\"filename\" value=\"{file}\"")), "{name}: {text}");
            let meta =
                lut_io::exr_file::read(&folder.path().join(file)).expect("the table reads").into_parts().meta;
            let planned: Vec<&str> =
                table["effects"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
            assert_eq!(meta.effects, planned, "{name}");
        }
        let before = fs::read(folder.path().join(baked[0]["file"].as_str().expect("a name"))).expect("reads");
        let again = json(folder.path(), &args);
        let again = again["baked"].as_array().expect("a list");
        assert!(again.iter().all(|table| table["reused"] == true), "{name}: {again:?}");
        let after = fs::read(folder.path().join(baked[0]["file"].as_str().expect("a name"))).expect("reads");
        assert_eq!(before, after, "{name}");
        let other = json(folder.path(), &[&args[..], &["--seed", "2", "--effects", "surface"]].concat());
        assert_eq!(other["baked"][0]["reused"], false, "{name}: other contents are another table");
    }
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, text).expect("writes");
    path
}

/// A scene with one pearl on a sphere; `inner` are its parameters.
fn one_pearl(inner: &str) -> String {
    format!(
        "<scene version=\"3.0.0\">\n<bsdf type=\"pearl\" id=\"p\">\n{inner}\n</bsdf>\n<shape type=\"sphere\"><ref id=\"p\"/></shape>\n</scene>"
    )
}

#[test]
fn a_copy_in_another_folder_finds_its_files_and_drops_what_has_no_data() {
    let folder = folder();
    fs::create_dir(folder.path().join("scenes")).expect("a folder");
    fs::create_dir(folder.path().join("out")).expect("a folder");
    write(folder.path(), "scenes/skin.png", "not looked into");
    let dull = "<float name=\"brightness\" value=\"0\"/>\n<float name=\"coherence\" value=\"0.5\"/>\n\
                <texture type=\"bitmap\" name=\"body_color\"><string name=\"filename\" value=\"skin.png\"/></texture>";
    let text = one_pearl(dull).replace(
        "<shape",
        "<bsdf type=\"pearl\" id=\"spare\"/>\n<bsdf type=\"pearl\" name=\"x\" id=\"b&amp;c\"/><shape",
    );
    write(folder.path(), "scenes/s.xml", &text);
    json(folder.path(), &[&["--scene", "scenes/s.xml", "-o", "out/copy.xml"], &COARSE[..]].concat());
    let copy = fs::read_to_string(folder.path().join("out/copy.xml")).expect("the copy reads");
    let skin = folder.path().join("scenes/skin.png").canonicalize().expect("is there");
    assert!(copy.contains(&format!("name=\"filename\" value=\"{}\"", skin.display())), "{copy}");
    assert!(copy.contains("name=\"coherence\" value=\"0\""), "no lobe, no coherent colours: {copy}");
    assert!(copy.contains("<bsdf type=\"diffuse\" id=\"spare\"/>"), "{copy}");
    assert!(copy.contains("<bsdf type=\"diffuse\" id=\"b&amp;c\" name=\"x\"/>"), "{copy}");
    assert_eq!(copy.matches("type=\"pearl\"").count(), 1, "{copy}");
    let plan = json(folder.path(), &[&["plan", "--scene", "out/copy.xml"], &COARSE[..]].concat());
    assert_eq!(
        plan["pearls"][0]["recipe"]["name"], "paper",
        "the copy is a scene whose table names its recipe"
    );
}

#[test]
fn variants_decide_what_can_be_seen() {
    let folder = folder();
    write(folder.path(), "s.xml", &one_pearl(""));
    let why = |variant: &str| {
        let plan =
            json(folder.path(), &[&["plan", "--scene", "s.xml", "--variant", variant], &COARSE[..]].concat());
        plan["pearls"][0]["effects"]["polarisation"]["why"].as_str().expect("a reason").to_owned()
    };
    assert_eq!(why("llvm_ad_spectral_polarized"), "the variant is polarised (--variant)");
    assert_eq!(why("scalar_rgb"), "the variant is not polarised (--variant)");
}

#[test]
fn bad_scenes_are_refused_in_one_line_that_names_the_place() {
    let folder = folder();
    write(
        folder.path(),
        "ring-a.xml",
        "<scene version=\"3.0.0\">\n<include filename=\"ring-b.xml\"/></scene>",
    );
    write(folder.path(), "ring-b.xml", "<scene version=\"3.0.0\"><include filename=\"ring-a.xml\"/></scene>");
    write(folder.path(), "bad.json", "{\"stack\": {\"layers\": 0}}");
    write(folder.path(), "fake.exr", "no table");
    let lines = "\n".repeat(2);
    let deep =
        format!("<scene version=\"3.0.0\">{}{}</scene>", "<a>".repeat(100_000), "</a>".repeat(100_000));
    let bomb = "<!DOCTYPE lolz [<!ENTITY a \"lol\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;\">]><scene version=\"3.0.0\">&b;</scene>";
    let growing: String =
        (1..40).map(|i| format!("<default name=\"x{i}x\" value=\"$x{0}x$x{0}x\"/>", i - 1)).collect();
    let growing = format!("<scene><default name=\"x0x\" value=\"ab\"/>{growing}</scene>");
    let wide = "<scene><include filename=\"leaf.xml\"/></scene>".to_owned();
    write(
        folder.path(),
        "leaf.xml",
        &format!("<scene>{}</scene>", "<include filename=\"empty.xml\"/>".repeat(1000)),
    );
    write(folder.path(), "empty.xml", "<scene/>");
    for (text, said) in [
        ("not xml".to_owned(), "s.xml:1: not XML"),
        (String::new(), "s.xml:1: not XML"),
        ("<scene>\n<shape></scene>".to_owned(), "s.xml:2: not XML"),
        ("<mesh/>".to_owned(), "s.xml:1: the root is <mesh>"),
        (format!("{lines}<scene><include filename=\"gone.xml\"/></scene>"), "s.xml:3: include: \"gone.xml\" is no file"),
        ("<scene><include filename=\"ring-a.xml\"/></scene>".to_owned(), "ring-b.xml:1: includes go round in a circle: ring-a.xml → ring-b.xml → ring-a.xml"),
        ("<scene><include filename=\"s.xml\"/></scene>".to_owned(), "s.xml:1: includes go round in a circle"),
        (wide, "a scene has at most 256 includes"),
        (one_pearl("<float name=\"shine\" value=\"1\"/>"), "s.xml:3: pearl: \"shine\" is no parameter; expected one of filename"),
        (one_pearl("<float name=\"depth\" value=\"1.5\"/>"), "s.xml:3: pearl: depth \"1.5\" is not valid; expected a number from 0 to 1"),
        (one_pearl("<float name=\"coherence\" value=\"NaN\"/>"), "s.xml:3: pearl: coherence \"NaN\""),
        (one_pearl("<string name=\"id\" value=\"&#x110000;\"/>"), "s.xml:3: &#x110000; is no character of XML"),
        (one_pearl("<string name=\"id\"\nvalue=\"a&#65;&#xD800;\"/>"), "s.xml:4: &#xD800; is no character of XML"),
        (one_pearl("<string name=\"id\" value=\"&#0;\"/>"), "s.xml:3: not XML"),
        (one_pearl("text &#x110000;"), "s.xml:3: &#x110000; is no character of XML"),
        (one_pearl("&#xD800;<![CDATA[x]]>"), "s.xml:3: &#xD800; is no character of XML"),
        (one_pearl("<![CDATA[&#0;]]>\n<!-- &#1; --><?x &#2;?>&#65;\n<![CDATA[x]]>&#x110001;"), "s.xml:5: &#x110001; is no character of XML"),
        (one_pearl("<string name=\"depth\" value=\"0.5\"/>"), "s.xml:3: pearl: depth is a <string>; expected <float>"),
        (one_pearl("<float name=\"depth\"/>"), "s.xml:3: pearl: depth needs the attribute value"),
        (one_pearl("<float name=\"depth\" value=\"$d\"/>"), "s.xml:3: $d has no value; give it one with <default name=\"d\""),
        (one_pearl("<float name=\"depth\" value=\"0\"/>\n<float name=\"depth\" value=\"1\"/>"), "s.xml:4: pearl: depth is given twice"),
        (one_pearl("<rgb name=\"body_color\" value=\"0.1 2 0.3\"/>"), "s.xml:3: pearl: body_color \"0.1 2 0.3\""),
        (one_pearl("<rgb name=\"tint\" value=\"#12345\"/>"), "s.xml:3: pearl: tint \"#12345\""),
        (one_pearl("<string name=\"components\" value=\"blur, glow\"/>"), "s.xml:3: pearl: components: \"glow\" is none"),
        (one_pearl("<string name=\"recipe\" value=\"gone.json\"/>"), "s.xml:3: pearl: recipe \"gone.json\": no such file"),
        (one_pearl("<string name=\"recipe\" value=\"bad.json\"/>"), "s.xml:3: pearl: recipe \"bad.json\": stack.layers"),
        (one_pearl("<string name=\"filename\" value=\"fake.exr\"/>"), "s.xml:2: pearl: table ./fake.exr"),
        (one_pearl("").replace("ref id=\"p\"", "ref id=\"q\""), "s.xml:5: ref: no object has the id \"q\""),
        (one_pearl("").replace("<shape", "<bsdf type=\"diffuse\" id=\"p\"/><shape"), "s.xml:5: id \"p\" again; it is at s.xml:2"),
        (
            "<scene><bsdf type=\"twosided\" id=\"a\"><ref id=\"b\"/></bsdf><bsdf type=\"twosided\" id=\"b\"><ref id=\"a\"/></bsdf><shape type=\"sphere\"><ref id=\"a\"/></shape></scene>".to_owned(),
            "references go round in a circle: a → b → a",
        ),
        (bomb.to_owned(), "s.xml:1: a document type is refused"),
        (deep, "elements nest deeper than"),
        (growing, "grows longer than"),
    ] {
        let before = fs::read_dir(folder.path()).expect("reads").count();
        write(folder.path(), "s.xml", &text);
        for args in [&["plan", "--scene", "s.xml"][..], &["--scene", "s.xml"]] {
            let output = tool(folder.path(), args);
            let line = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{said}: {line}");
            assert!(line.contains(said) && line.trim_end().lines().count() == 1, "expected {said:?}: {line}");
            assert!(output.stdout.is_empty(), "{said}");
        }
        assert!(fs::read_dir(folder.path()).expect("reads").count() <= before + 1, "{said}: nothing else is written");
    }
    for (args, said) in [
        (&["--scene", "gone.xml"][..], "gone.xml: No such file"),
        (
            &["plan", "--scene", "s.xml", "--variant", "cmyk"],
            "--variant: variant \"cmyk\" is none; expected mono, rgb",
        ),
        (&["plan", "--scene", "s.xml", "recipe.json"], "cannot be used with"),
    ] {
        let output = tool(folder.path(), args);
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
        assert!(line.contains(said) && line.trim_end().lines().count() == 1, "{args:?}: {line}");
    }
}

#[test]
fn scenes_in_another_encoding_than_utf_8_are_refused_with_its_name() {
    let text = "<?xml version=\"1.0\"?>\n<scene version=\"3.0.0\"/>";
    let utf16 = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
    let little: Vec<u8> = [&[0xff, 0xfe], &utf16(u16::to_le_bytes)[..]].concat();
    let big: Vec<u8> = [&[0xfe, 0xff], &utf16(u16::to_be_bytes)[..]].concat();
    let utf32: Vec<u8> = text.chars().flat_map(|c| u32::from(c).to_le_bytes()).collect();
    for (bytes, said) in [
        (little, "s.xml: the encoding is UTF-16, expected UTF-8"),
        (big, "s.xml: the encoding is UTF-16, expected UTF-8"),
        (utf16(u16::to_le_bytes), "s.xml: the encoding is UTF-16, expected UTF-8"),
        (utf16(u16::to_be_bytes), "s.xml: the encoding is UTF-16, expected UTF-8"),
        ([&[0xff, 0xfe, 0, 0], &utf32[..]].concat(), "s.xml: the encoding is UTF-32, expected UTF-8"),
        (utf32, "s.xml: the encoding is UTF-32, expected UTF-8"),
        (b"<scene>\n<!-- perl\xe9 --></scene>".to_vec(), "s.xml: line 2 is not encoded in UTF-8"),
    ] {
        let folder = folder();
        fs::write(folder.path().join("s.xml"), bytes).expect("writes");
        write(folder.path(), "including.xml", "<scene>\n<include filename=\"s.xml\"/></scene>");
        for scene in ["s.xml", "including.xml"] {
            let output = tool(folder.path(), &["plan", "--scene", scene]);
            let line = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{line}");
            assert!(line.contains(said) && line.trim_end().lines().count() == 1, "expected {said:?}: {line}");
        }
    }
    let marked = format!("\u{feff}{}", one_pearl(""));
    let folder = folder();
    write(folder.path(), "s.xml", &marked);
    assert!(tool(folder.path(), &["plan", "--scene", "s.xml"]).status.success(), "UTF-8 may have its mark");
}

/// Scenes made to eat memory or time, in 600 MB of address space.
#[cfg(unix)]
#[test]
fn scenes_that_would_grow_without_bound_are_refused_within_bounded_memory() {
    let folder = folder();
    let numbered = |count: usize| (0..count).map(|i| format!(" a{i}=\"1\"")).collect::<String>();
    let thousand = "z".repeat(1000);
    let long = "x".repeat(30_000_000);
    let repeated = "<string name=\"b\" value=\"$a\"/>".repeat(200_000);
    for (text, said) in [
        (format!("<scene><bsdf{}/></scene>", numbered(400_000)), "more than 1000 attributes"),
        (
            format!("<scene><default name=\"a\" value=\"{thousand}\"/>{repeated}</scene>"),
            "when their $names are replaced",
        ),
        (format!("<scene><bsdf type=\"pearl\" id=\"{long}\"/></scene>"), "a value has 30000000 bytes"),
        (one_pearl(&format!("<string name=\"recipe\" value=\"{}\"/>", "y".repeat(900_000))), "no such file"),
        (
            format!(
                "<scene>{}</scene>",
                (0..20_000).map(|i| format!("<default name=\"d{i}\" value=\"1\"/>")).collect::<String>()
            ),
            "more than 10000 defaults",
        ),
        ("<scene><include filename=\"/dev/zero\"/></scene>".to_owned(), "\"/dev/zero\" is no file"),
        (
            format!("<scene>{}{}</scene>", "<a>".repeat(200_000), "</a>".repeat(200_000)),
            "nest deeper than 100",
        ),
        (format!("<scene>{}</scene>", "<a/>".repeat(1_100_000)), "more than 1000000 elements"),
    ] {
        write(folder.path(), "s.xml", &text);
        let command = "ulimit -v 600000 && exec \"$0\" plan --threads 1 --scene s.xml";
        let output = std::process::Command::new("sh")
            .args(["-c", command, env!("CARGO_BIN_EXE_bake-brdf")])
            .current_dir(folder.path())
            .output()
            .expect("a shell");
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}: {line}");
        assert!(line.contains(said) && line.trim_end().lines().count() == 1, "expected {said:?}: {line}");
        assert!(line.chars().count() < 1000, "{said}: a line of {} characters", line.chars().count());
    }
    // Comments are no elements, whatever is in them.
    let ruler = format!("<!-- it's {} -->{}", "=".repeat(3000), one_pearl(""));
    write(folder.path(), "s.xml", &ruler);
    assert!(tool(folder.path(), &["plan", "--scene", "s.xml"]).status.success());
}
