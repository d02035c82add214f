//! What the recipe of a table implies without a bake: interface 0 and its single reflection, the colours, the name.

use super::cells::CellRule;
use super::{BakeError, NEVER, Request, assemble, reproduce};
use crate::options::SolverChoice;
use crate::spectra;
use lut_io::axis::ExitAxis;
use lut_io::check::{self, Finding, Worst};
use lut_io::lobe::Interpolant;
use lut_io::solver::Solver;
use lut_io::spectra::Spectra;
use lut_io::table::{AzimuthMode, Meta, SurfaceModel, Table};
use transport::Geometry;
use transport::doubling::SingleReflection;

/// Largest relative difference of numbers that follow from the recipe: they are written with all their digits.
const TOLERANCE: f64 = 1e-9;
/// Largest difference of colours, in shares of the largest of their kind: seven digits; of compact tables fewer.
const COLOUR_TOLERANCE: f64 = 1e-5;
const COMPACT_COLOUR_TOLERANCE: f64 = 1e-2;

/// All checks of a table: of what it says of itself, and against its recipe; why the latter was not read, if no bake of this version
/// could have written it. Takes as long as the colours of the recipe: a second, some for irregular stacks.
#[must_use]
pub fn whole(lobe: &Interpolant) -> (Vec<Finding>, Option<String>) {
    let mut findings = check::check(lobe);
    match check(lobe.table()) {
        Ok(implied) => {
            findings.extend(implied);
            (findings, None)
        }
        Err(why) => (findings, Some(why.to_string())),
    }
}

/// Compares a table with what its recipe implies.
fn check(table: &Table) -> Result<Vec<Finding>, BakeError> {
    let own = reproduce::request(table.meta())?;
    let mut findings = Vec::new();
    let further = table.further_bands().map_err(super::invalid)?;
    for table in std::iter::once(table).chain(&further) {
        let request = own.at_wavelength(table.meta().wavelength_nm);
        let mut of_band = vec![recipe(&request, table)?];
        of_band.extend(single_reflection(&request, table)?);
        findings = check::worse(findings, of_band);
    }
    let mut wavelength = Worst::of(table);
    wavelength.note((table.meta().wavelength_nm / own.recipe.light.wavelength_nm - 1.0).abs(), 0.0);
    let what = "wavelength of the lobe against that of the recipe, relative";
    findings.push(wavelength.judged("wavelength", what, TOLERANCE));
    findings.push(colours(&own, table)?);
    findings.extend(name(&own, table));
    Ok(findings)
}

/// Interface 0, azimuth and media, at the wavelength of a band.
fn recipe(request: &Request, table: &Table) -> Result<Finding, BakeError> {
    let meta = table.meta();
    let transport = request.transport()?;
    let mut worst = Worst::of(table);
    let mut same =
        |found: f64, implied: f64| worst.note((found - implied).abs() / implied.abs().max(1e-9), 0.0);
    let mode = |meta: &Meta| matches!(meta.azimuth, AzimuthMode::Space);
    same(f64::from(u8::from(mode(meta))), f64::from(u8::from(request.geometry() == Geometry::Space)));
    let (found, implied) = (&meta.surface_model, assemble::surface_model(&transport));
    let SurfaceModel { n_ambient, n_first, slope_sd, normals } = implied;
    same(found.n_ambient, n_ambient);
    same(found.n_first, n_first);
    same(found.slope_sd, slope_sd);
    same(f64::from(u8::from(found.normals != normals)), 0.0);
    if let Some(sides) = &meta.both_sides {
        same(sides.n_ambient, transport.indices[0]);
        same(sides.n_substrate, transport.indices[transport.indices.len() - 1]);
    }
    // The width of a reciprocal table is the mean of all incidences; of compact ones it is rounded.
    if matches!(meta.exit_axis, ExitAxis::Plane { .. }) && meta.reciprocal.is_none() && meta.compact.is_none()
    {
        for at in &meta.per_incidence {
            let implied = request.recipe.azimuth.decay_width_deg(at.sd_theta_o_deg);
            worst.note((at.azimuth_width_deg / implied - 1.0).abs(), at.theta_i_deg);
        }
    }
    let what = "interface 0, media, azimuth and its width against those of the recipe, relative";
    Ok(worst.judged("recipe", what, TOLERANCE))
}

fn single_reflection(request: &Request, table: &Table) -> Result<Option<Finding>, BakeError> {
    let transport = request.transport()?;
    if !request.effects.has_lobe() || transport.facets.slope_sd == 0.0 {
        return Ok(None);
    }
    let axis = &table.meta().exit_axis;
    let cells = |theta_i: &f64| {
        let lobe = SingleReflection::new(&transport, request.geometry(), *theta_i);
        CellRule::new(axis, *theta_i).single_shares(&lobe)
    };
    let expected: Vec<Vec<f64>> = table.theta_i().iter().map(cells).collect();
    Ok(check::single_reflection(table, &expected))
}

/// Colours of the recipe against those of the table, and R_incoherent of further bands.
fn colours(request: &Request, table: &Table) -> Result<Finding, BakeError> {
    let meta = table.meta();
    let implied = request.colours(&NEVER)?.section();
    let mut worst = Worst::of(table);
    let mut same = |found: &[f64], implied: &[f64]| {
        let largest = implied.iter().fold(f64::MIN_POSITIVE, |most: f64, x| most.max(x.abs()));
        let apart = found.iter().zip(implied).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        worst.note(if found.len() == implied.len() { apart / largest } else { f64::INFINITY }, 0.0);
    };
    let lists = |spectra: &Option<Spectra>| -> Vec<Vec<f64>> {
        let Some(Spectra { wavelength_nm, coherent, emission, thickness }) = spectra else {
            return Vec::new();
        };
        let coherent = coherent.iter().flat_map(|part| {
            [
                part.theta_deg.clone(),
                part.modulation.concat(),
                part.modulation_rgb.concat(),
                part.incoherent.clone(),
            ]
        });
        let emission = emission
            .iter()
            .flat_map(|part| [part.theta_deg.clone(), part.radiance.concat(), part.radiance_rgb.concat()]);
        let thickness = thickness.iter().flat_map(|part| {
            let rgb = [&part.modulation_rgb, &part.radiance_rgb].map(|scales| scales.concat().concat());
            rgb.into_iter().chain([part.scale.clone(), part.radiance_mean.concat()])
        });
        std::iter::once(wavelength_nm.clone()).chain(coherent).chain(emission).chain(thickness).collect()
    };
    let (found, lists) = (lists(&meta.spectra), lists(&implied));
    same(&[found.len() as f64], &[lists.len() as f64]);
    for (found, implied) in found.iter().zip(&lists) {
        same(found, implied);
    }
    if let (Some(section), Some(coherent)) =
        (&meta.dispersion, meta.spectra.as_ref().and_then(|s| s.coherent.as_ref()))
    {
        for band in &section.bands {
            let wanted = request.wanted_colours();
            let implied =
                spectra::incoherent(&request.recipe, wanted, band.wavelength_nm, &coherent.theta_deg)?;
            same(band.incoherent.as_deref().unwrap_or_default(), &implied);
        }
    }
    let tolerance = if meta.compact.is_some() { COMPACT_COLOUR_TOLERANCE } else { COLOUR_TOLERANCE };
    Ok(worst.judged(
        "spectra",
        "colours against those of the recipe, in shares of the largest of their kind",
        tolerance,
    ))
}

/// The name that a bake of this version would give. None of tables of other versions, nor of compact ones, whose cells are others.
fn name(request: &Request, table: &Table) -> Option<Finding> {
    let meta = table.meta();
    let found =
        meta.content_hash.as_ref().filter(|_| meta.writer == assemble::WRITER && meta.compact.is_none())?;
    let choice = match meta.solver {
        Solver::Walk => SolverChoice::Walk,
        Solver::Doubling => SolverChoice::Doubling,
    };
    let reciprocal = if meta.reciprocal.is_some() { "-reciprocal" } else { "" };
    let implied = request.content_hash(choice) + reciprocal;
    let mut worst = Worst::of(table);
    worst.note(f64::from(u8::from(*found != implied)), 0.0);
    Some(worst.judged("content_hash", "1 where it is not that of recipe, options, incidences and cells", 0.0))
}
