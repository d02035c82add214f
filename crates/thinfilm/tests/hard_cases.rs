//! The 83 hard cases with 40-digit references, and 87 of our own (`tools/peers/hard_cases.py`).

use thinfilm::reference_case::{Case, CaseFile};
use thinfilm::{Gain, Material, Polarisation, Stack, StackLayer, StackRun, dense};

/// The cases given, then ours.
fn cases() -> Vec<Case> {
    [
        include_str!("../../../tests/data/hard_cases.json"),
        include_str!("../../../tests/data/hard_cases_own.json"),
    ]
    .into_iter()
    .flat_map(|text| serde_json::from_str::<CaseFile>(text).unwrap().cases)
    .collect()
}

#[test]
fn every_hard_case_is_within_its_own_tolerance() {
    let cases = cases();
    assert_eq!(cases.len(), 83 + 87);
    let mut misses = Vec::new();
    for case in &cases {
        let verdict = case.verify().unwrap();
        if !verdict.pass {
            misses.push(format!("{}: {verdict:?}", case.id));
        }
    }
    assert!(misses.is_empty(), "{} of {} miss:\n{}", misses.len(), cases.len(), misses.join("\n"));
}

/// A reference off by a millionth is a miss, whichever of the four it is.
#[test]
fn each_wrong_reference_is_a_miss() {
    let cases = cases();
    let case = cases.iter().find(|case| case.id == "normal_incidence_sp_s").unwrap();
    let wrong = |text: &str| format!("{:e}", text.parse::<f64>().unwrap() * (1.0 + 1e-6));
    let passes = |change: &dyn Fn(&mut Case)| {
        let mut case = case.clone();
        change(&mut case);
        case.verify().unwrap().pass
    };
    assert!(passes(&|_| ()));
    assert!(!passes(&|case| case.reference.r[0] = wrong(&case.reference.r[0])));
    assert!(!passes(&|case| case.reference.t[1] = wrong(&case.reference.t[1])));
    assert!(!passes(&|case| case.reference.reflectance = wrong(&case.reference.reflectance)));
    assert!(!passes(&|case| case.reference.transmittance = wrong(&case.reference.transmittance)));
}

fn stack(case: &Case) -> Stack {
    let material = |[n, k]: [f64; 2]| Material { k, ..Material::constant(n) };
    let run = |block: &thinfilm::reference_case::CaseBlock| StackRun {
        unit: block
            .unit
            .iter()
            .map(|&(material, nm)| StackLayer { material, thickness: nm * 1e-9, thickness_sd: 0.0 })
            .collect(),
        repeat: block.repeat,
    };
    Stack {
        ambient: material(case.n_in),
        materials: case.materials.iter().copied().map(material).collect(),
        runs: case.stack.iter().map(run).collect(),
        substrate: material(case.n_sub),
        gain: Gain::Refused,
    }
}

/// The dense path as it is used, fast lanes and lanes handed on, and how many were fast: some must be.
#[test]
fn the_fast_path_answers_as_the_robust_form_to_1e_12() {
    let (mut fast, mut all) = (0, 0);
    for case in cases() {
        // The dense path takes angles (the sine of one cannot hit a given kx to the last bit), at least one layer, and materials
        // of n > 0.
        let Some(theta) = case.theta_rad else { continue };
        if stack(&case).layer_count() == 0
            || case.n_sub[0] == 0.0
            || case.materials.iter().any(|[n, _]| *n == 0.0)
        {
            continue;
        }
        let wavelength = case.lambda_nm * 1e-9;
        let spectra = dense::spectra(&stack(&case), &[wavelength], &[theta]).unwrap();
        let (film, incidence, _) = case.wave().unwrap();
        for pol in Polarisation::BOTH {
            let robust = film.solve(wavelength, incidence, pol).unwrap();
            let (r, t) = (spectra.reflectance(0, pol)[0], spectra.transmittance(0, pol)[0]);
            assert!(
                (r - robust.reflectance).abs() <= 1e-12 && (t - robust.transmittance).abs() <= 1e-12,
                "{} {pol:?}: R {r} {}, T {t} {}",
                case.id,
                robust.reflectance,
                robust.transmittance
            );
        }
        all += 1;
        fast += 1 - spectra.robust_lanes();
    }
    assert!(all >= 40 && fast >= 10, "{fast} of {all} cases were fast");
}
