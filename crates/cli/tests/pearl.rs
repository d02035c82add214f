//! `pearl` as its users meet it: what it takes for a component list, and what it says of bad input.

mod built;

use built::{pearl, table};
use std::fs;

#[test]
fn all_components_may_be_named_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let said = |list: &[&str]| pearl(&[&["furnace", path.to_str().unwrap(), "--json"], list].concat());
    let whole = said(&[]);
    assert_eq!(whole.status.code(), Some(0));
    for list in ["all", "diffuse,incoherent,mirror,blur", "diffuse, incoherent, mirror, blur"] {
        assert!(said(&["--components", list]).stdout == whole.stdout, "{list}");
    }
    assert!(said(&["--components", "diffuse"]).stdout != whole.stdout);
}

#[test]
fn bad_input_is_refused_in_one_line_and_harms_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let whole = fs::read(&path).unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let half = file("half.exr", &whole[..whole.len() / 2]);
    let no_vector = file("no_vector.jsonl", br#"{"wi":[0,0,0],"wo":[0,0,1]}"#);
    let half_a_pair = file("half.jsonl", br#"{"wi":[0,0,1]}"#);
    let here = folder.path().to_str().unwrap();
    let table = path.to_str().unwrap();
    let cases: [(&[&str], &str); 18] = [
        (&["furnace", "absent.exr"], "`bake-brdf RECIPE -o absent.exr` bakes it"),
        (&["eval", "absent.exr", "--input", "-"], "`bake-brdf RECIPE -o absent.exr` bakes it"),
        (&["furnace", here], "directory"),
        (&["furnace", &half], "truncated"),
        (&["furnace", table, "--depth", "-0.1"], "depth: -0.1 is not valid; expected a number from 0 to 1"),
        (&["furnace", table, "--brightness", "nan"], "brightness: NaN is not valid"),
        (&["furnace", table, "--coherence", "1"], "bake-brdf RECIPE --effects all"),
        (&["furnace", table, "--depth", "1"], "bake-brdf RECIPE --effects all"),
        (&["furnace", table, "--tint-rgb", "-1,0,0"], "tint_rgb[0]: -1 is not valid"),
        (&["furnace", table, "--body-rgb", "0.5,0.5"], "three finite numbers"),
        (
            &["furnace", table, "--components", "all,blur"],
            "\"all,blur\" is neither all alone nor a list of diffuse",
        ),
        (
            &["furnace", table, "--components", "shine"],
            "\"shine\" is neither all alone nor a list of diffuse",
        ),
        (&["sample", table, "--wi", "0,0,0"], "not all 0"),
        (&["eval", table, "--input", here], "directory"),
        (&["eval", table, "--input", "absent.jsonl"], "absent.jsonl"),
        (&["eval", table, "--input", &no_vector], "line 1: wi is [0.0, 0.0, 0.0]"),
        (&["eval", table, "--input", &half_a_pair], "line 1: missing field `wo`"),
        (&["eval", table, "--input", "-", "--wavelengths-nm", "5"], "not a wavelength"),
    ];
    for (args, words) in cases {
        let output = pearl(args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.lines().count() == 1 && stderr.contains(words), "{args:?}: {stderr}");
        assert!(output.stdout.is_empty(), "{args:?}");
    }
    assert!(fs::read(&path).unwrap() == whole);
}

#[test]
fn one_picture_alone_is_that_of_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let drawn = |name: &str, more: &[&str]| {
        let pictures = folder.path().join(name);
        let args = ["preview", path.to_str().unwrap(), "--size", "24", "-o", pictures.to_str().unwrap()];
        (pearl(&[&args, more].concat()), pictures)
    };
    let (all, whole) = drawn("all", &[]);
    assert_eq!(all.status.code(), Some(0));
    assert_eq!(fs::read_dir(&whole).unwrap().count(), 16);
    for name in ["sphere-distant-sum", "swatch-sky-lobes"] {
        let (said, one) = drawn(name, &["--only", name]);
        assert_eq!(said.status.code(), Some(0));
        let files: Vec<_> = fs::read_dir(&one).unwrap().map(|file| file.unwrap().file_name()).collect();
        let file = format!("{name}.png");
        assert_eq!(files, [file.as_str()]);
        assert!(fs::read(one.join(&file)).unwrap() == fs::read(whole.join(&file)).unwrap(), "{name}");
    }
    let (said, _) = drawn("none", &["--only", "cube-sky-sum"]);
    assert_eq!(said.status.code(), Some(2));
    assert!(String::from_utf8(said.stderr).unwrap().contains("sphere-sky-sum"));
}
