//! Both solvers through the built `bake-brdf`: smooth interfaces, light from below, and the choice between them.

mod built;

use built::tool;
use lut_io::Table;
use lut_io::both_sides::Passage;
use lut_io::exr_file;
use lut_io::solver::Solver;
use lut_io::table::Component;

/// Bakes a recipe text; the table and what was said on stderr.
fn bake(recipe: &str, args: &[&str]) -> (Table, String) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("recipe.json"), recipe).unwrap();
    // No colours: they have tests of their own.
    let all = [&["recipe.json", "-o", "pearl.exr", "--effects", "surface,blur,absorption"], args].concat();
    let output = tool(folder.path(), &all);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{recipe} {args:?}: {said}");
    (exr_file::read(&folder.path().join("pearl.exr")).unwrap(), said)
}

const SMOOTH: [&str; 2] = [
    r#"{"stack":{"layers":40,"substrate":{"n":1.33}},"facets":{"slope_sd_deg":0}}"#,
    r#"{"stack":{"layers":9,"aragonite":{"k":0.02},"conchiolin":{"k":0.1}},"facets":{"slope_sd_deg":0}}"#,
];

#[test]
fn smooth_interfaces_are_solved_in_closed_form_as_they_are_walked() {
    for recipe in SMOOTH {
        for azimuth in ["decay", "space"] {
            let common = ["--azimuth", azimuth, "--incident-deg", "0,30,60,85,90"];
            let (solved, _) = bake(recipe, &[&common[..], &["--solver", "doubling"]].concat());
            let (walked, _) = bake(recipe, &[&common[..], &["--paths", "40000"]].concat());
            for (k, (a, b)) in
                solved.meta().per_incidence.iter().zip(&walked.meta().per_incidence).enumerate()
            {
                // 20 shares a recipe and azimuth: 4.5 standard errors have p = 7e-6 each. The seed is fixed.
                for (x, y, error) in [
                    (a.albedo, b.albedo, b.std_error.albedo),
                    (a.transmitted, b.transmitted, b.std_error.transmitted),
                    (a.absorbed, b.absorbed, b.std_error.absorbed),
                    (a.surface, b.surface, b.std_error.surface),
                ] {
                    assert!((x - y).abs() <= 4.5 * error + 1e-9, "{recipe} {azimuth}: {a:?} {b:?}");
                }
                // f32 directions of the walk: 1e-5 degrees.
                assert!((a.mean_theta_o_deg - b.mean_theta_o_deg).abs() < 1e-4 && a.sd_theta_o_deg == 0.0);
                assert!(b.sd_theta_o_deg < 1e-4 && b.skew_theta_o == 0.0, "{b:?}");
                let cells = solved.meta().exit_axis.cells();
                let lit = |table: &Table| {
                    let cells = &table.lobe(Component::Interior).value[k * cells..(k + 1) * cells];
                    cells.iter().position(|value| *value > 0.0)
                };
                let apart = lit(&solved).zip(lit(&walked)).map(|(a, b)| a.abs_diff(b));
                // The mirror direction may fall on either side of a cell's edge in f32.
                assert!(apart.is_none_or(|cells| cells <= 1), "{recipe} {azimuth} {k}: {apart:?}");
            }
        }
    }
}

/// Past the critical angle next to nothing gets through, and what the sums of the solver leave of it may be below 0.
#[test]
fn total_reflection_by_rough_facets_leaves_no_negative_share() {
    let recipe = r#"{"stack":{"layers":40,"ambient":{"n":1.46},"aragonite":{"n":1.3,"thickness_nm":350},
        "conchiolin":{"n":1.25,"thickness_nm":60},"substrate":{"n":1.3}},"facets":{"slope_sd_deg":4}}"#;
    let (table, _) = bake(recipe, &["--solver", "doubling", "--accuracy", "2", "--incident-deg", "0:90:2"]);
    let last = table.meta().per_incidence.last().unwrap();
    assert!(last.albedo > 1.0 - 1e-6 && (0.0..1e-6).contains(&last.transmitted), "{last:?}");
}

/// Σ value·weight of every stored lobe is the share that the metadata give it, and energy from below closes.
#[test]
fn both_sides_are_stored_whole() {
    let recipe = r#"{"stack":{"layers":30,"substrate":{"n":1.4}},"facets":{"slope_sd_deg":5}}"#;
    let absorbing = r#"{"stack":{"layers":31,"aragonite":{"k":0.002}},"facets":{"slope_sd_deg":5}}"#;
    for (recipe, azimuth) in
        [(recipe, "decay"), (recipe, "space"), (absorbing, "decay"), (SMOOTH[0], "space")]
    {
        let args = [
            "--solver",
            "doubling",
            "--accuracy",
            "5",
            "--both-sides",
            "--azimuth",
            azimuth,
            "--incident-deg",
            "0,40,80",
        ];
        let (table, _) = bake(recipe, &args);
        let section = table.meta().both_sides.as_ref().expect("the section was asked for");
        let cells = table.meta().exit_axis.cells();
        for (i, below) in section.from_below.iter().enumerate() {
            let sum = below.reflected + below.transmitted + below.absorbed;
            assert!((sum - 1.0).abs() < 1e-12, "{recipe} {azimuth}: {below:?}");
            assert_eq!(below.absorbed > 0.0, recipe == absorbing);
            let above = table.meta().per_incidence[i].transmitted;
            for (passage, light) in Passage::ALL.iter().zip([above, below.reflected, below.transmitted]) {
                let weights = section.weights(*passage, &table.meta().exit_axis);
                let values = table.at_incidence(table.passage(*passage).unwrap(), i);
                let read: f64 = values
                    .iter()
                    .zip(&weights[i * cells..])
                    .map(|(v, w)| f64::from(*v) * f64::from(*w))
                    .sum();
                // Values and weights are f32.
                assert!(
                    (read - light).abs() < 1e-6,
                    "{recipe} {azimuth} {passage:?} {i}: {read} for {light}"
                );
            }
        }
    }
}

/// What comes from below is what the stack upside down does from above.
#[test]
fn light_from_below_meets_the_stack_upside_down() {
    let sides =
        ["--solver", "doubling", "--incident-deg", "0,40,80", "--azimuth", "space", "--cells", "64x16"];
    let stack = |ambient: f64, substrate: f64, first: f64, last: f64| {
        format!(
            r#"{{"stack":{{"layers":2,"ambient":{{"n":{ambient}}},"aragonite":{{"n":{first}}},"conchiolin":{{"n":{last}}},
            "substrate":{{"n":{substrate}}}}},"facets":{{"slope_sd_deg":10}}}}"#
        )
    };
    let (both, _) = bake(&stack(1.0, 1.3, 1.6, 1.4), &[&sides[..], &["--both-sides"]].concat());
    let (turned, _) = bake(&stack(1.3, 1.0, 1.4, 1.6), &sides);
    let section = both.meta().both_sides.as_ref().unwrap();
    for (below, above) in section.from_below.iter().zip(&turned.meta().per_incidence) {
        // Two resolutions, both far finer than the totals need.
        assert!((below.reflected - above.albedo).abs() < 1e-6, "{below:?} {above:?}");
        assert!((below.transmitted - above.transmitted).abs() < 1e-6, "{below:?} {above:?}");
    }
}

#[test]
fn both_sides_need_doubling() {
    let folder = tempfile::tempdir().unwrap();
    for args in
        [&["--both-sides", "--solver", "walk"][..], &["--both-sides", "--solver", "doubling", "--paths", "5"]]
    {
        let output = tool(folder.path(), args);
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!((output.status.code(), line.lines().count()), (Some(2), 1), "{args:?}: {line}");
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
}

/// The first line of `--solver auto`, which names the solver and why.
fn chosen(recipe: &str, args: &[&str]) -> (Solver, String) {
    let (table, said) = bake(recipe, &[&["--solver", "auto"], args].concat());
    (table.meta().solver, said.lines().next().unwrap_or_default().to_owned())
}

#[test]
fn auto_chooses_by_the_request_and_says_why() {
    let one = ["--incident-deg", "30", "--accuracy", "10"];
    let narrow = r#"{"stack":{"layers":1},"facets":{"slope_sd_deg":0.05}}"#;
    for (recipe, args, expected) in [
        ("{}", &["--accuracy", "0.5"][..], Solver::Doubling),
        (r#"{"facets":{"slope_sd_deg":0}}"#, &one, Solver::Doubling),
        // Lobes too narrow for doubling in space, and nothing to walk through.
        (narrow, &["--azimuth", "space", "--incident-deg", "30", "--accuracy", "10"], Solver::Walk),
        ("{}", &["--paths", "5000", "--incident-deg", "30"], Solver::Walk),
    ] {
        let (solver, reason) = chosen(recipe, args);
        assert_eq!(solver, expected, "{recipe} {args:?}: {reason}");
        let name = if solver == Solver::Walk { "walk" } else { "doubling" };
        assert!(reason.starts_with(&format!("bake-brdf: solver {name}: ")), "{reason}");
        // The figures in the reason are counts: the same to the last digit for any number of threads.
        for threads in ["1", "3"] {
            let again = chosen(recipe, &[args, &["--threads", threads]].concat());
            assert_eq!(again, (solver, reason.clone()), "{recipe} {args:?} on {threads} threads");
        }
    }
}

#[test]
fn what_is_stated_stays_within_what_was_asked_at_every_band_and_where_lobes_ring() {
    // Indices that cross between the bands: the own one bends least. An ambient near the first layer's index: light enters hardly
    // deflected, and coarse lobes ring.
    let bands = r#"{"stack":{"layers":60,"aragonite":{"n":{"cauchy":[1.44,0.02]}},"conchiolin":{"n":1.5}}}"#;
    let rings = r#"{"stack":{"layers":30,"ambient":{"n":1.4078}},"facets":{"slope_sd_deg":4}}"#;
    for (recipe, effects, further) in [(bands, "surface,blur,dispersion", 3), (rings, "surface,blur", 0)] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("recipe.json"), recipe).unwrap();
        let asked = ["recipe.json", "-o", "pearl.exr", "--solver", "doubling", "--accuracy", "1"];
        let output = tool(folder.path(), &[&asked[..], &["--effects", effects]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let table = exr_file::read(&folder.path().join("pearl.exr")).unwrap();
        let meta = table.meta();
        let dispersed = meta.dispersion.iter().flat_map(|dispersion| &dispersion.bands);
        let stated: Vec<_> =
            std::iter::once(&meta.accuracy).chain(dispersed.map(|band| &band.accuracy)).collect();
        assert!(stated.len() > further, "{} bands", stated.len());
        for accuracy in stated {
            let components = accuracy.components.unwrap();
            let worst =
                accuracy.reached_percent.max(components.interior_percent).max(components.rehit_percent);
            assert!(worst <= 1.0, "{recipe}: {accuracy:?}");
        }
    }
}
