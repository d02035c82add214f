//! What is done with tables, and plans.

use crate::bake::{parse_solver, watched};
use crate::convert::{array, to_python};
use crate::errors::{field, input, of_io};
use crate::look::{RECIPE, view};
use crate::pearl::table_of;
use crate::recipe::Recipe;
use crate::why_not;
use bake_brdf::bake::{BakeError, implied};
use bake_brdf::effects::Setting;
use bake_brdf::options::{Options, Target};
use bake_brdf::plan::{Plan, PlanError, ScenePearl};
use lut_io::atomic;
use pearl_bsdf::PearlBsdf;
use pearl_bsdf::export::{Export, Format};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::json;
use std::collections::HashMap;
use std::io;
use std::path::PathBuf;

#[doc = stub!("arrays")]
#[pyfunction]
pub(crate) fn arrays<'py>(py: Python<'py>, table: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyDict>> {
    let table = table_of(table)?;
    let table = table.get();
    let arrays = py.detach(|| table.prepared().map(|prepared| prepared.arrays())).map_err(input)?;
    let dict = PyDict::new(py);
    for pearl_bsdf::Array { name, shape, values, .. } in arrays {
        dict.set_item(name, array(py, &shape, values)?)?;
    }
    Ok(dict)
}

#[doc = stub!("export")]
#[pyfunction]
pub(crate) fn export<'py>(
    py: Python<'py>,
    table: &Bound<'py, PyAny>,
    format: &str,
    path: PathBuf,
) -> PyResult<Bound<'py, PyAny>> {
    let Some(format) = Format::ALL.into_iter().find(|known| known.name() == format) else {
        let names = Format::ALL.map(Format::name).join(", ");
        return Err(field("format", format_args!("{format:?} is not one of {names}")));
    };
    let table = table_of(table)?;
    let table = table.get();
    let written = |error: io::Error| of_io(&path, &error);
    // Before the work.
    atomic::check(&path).map_err(written)?;
    let export = py.detach(|| {
        let prepared = table.prepared().map_err(input)?;
        let look = prepared.look();
        let bsdf = PearlBsdf::new(prepared, look).map_err(input)?;
        Export::new(&bsdf, table.name(), format).map_err(input)
    })?;
    py.detach(|| atomic::write(&path, &export.bytes)).map_err(written)?;
    to_python(py, &export.report(&path))
}

#[doc = stub!("diff")]
#[pyfunction]
pub(crate) fn diff<'py>(
    py: Python<'py>,
    a: &Bound<'py, PyAny>,
    b: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let (a, b) = (table_of(a)?, table_of(b)?);
    let (a, b) = (a.get(), b.get());
    let difference = py.detach(|| lut_io::diff::diff(&a.interpolant(), &b.interpolant()));
    if difference.per_incidence.is_empty() {
        return Err(field("per_incidence", "the first table has no angle within those of the second"));
    }
    to_python(py, &difference)
}

#[doc = stub!("check")]
#[pyfunction]
pub(crate) fn check<'py>(py: Python<'py>, table: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let table = table_of(table)?;
    let table = table.get();
    let (findings, no_recipe) = py.detach(|| implied::whole(&table.interpolant()));
    let pass = findings.iter().all(|finding| finding.pass != Some(false));
    to_python(py, &json!({ "pass": pass, "checks": findings, "recipe_not_read": no_recipe }))
}

/// A pearl to be planned.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Planned<'py> {
    id: String,
    place: String,
    shapes: Vec<String>,
    used: bool,
    recipe: Recipe,
    look: Bound<'py, PyDict>,
    places: HashMap<String, String>,
}

/// Which effects pearls call for, why, and what the tables that hold them cost.
#[pyfunction]
#[pyo3(signature = (pearls, *, solver=None, accuracy=None, why_not=false))]
pub(crate) fn plan_pearls<'py>(
    py: Python<'py>,
    pearls: Vec<Planned<'py>>,
    solver: Option<&str>,
    accuracy: Option<f64>,
    why_not: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let default = Options::default();
    let options = Options {
        solver: solver.map(parse_solver).transpose()?,
        target: accuracy.map_or(default.target, Target::AccuracyPercent),
        ..default
    };
    let pearl = |pearl: Planned<'_>| {
        let Planned { id, place, shapes, used, recipe, look, places } = pearl;
        let view = view(&recipe.inner, Some(&look), &places)?;
        let from = places.get(RECIPE).unwrap_or(&place).clone();
        Ok(ScenePearl { id, place, shapes, used, recipe: Setting::new(recipe.inner, from), view })
    };
    let pearls = pearls.into_iter().map(pearl).collect::<PyResult<Vec<_>>>()?;
    let report = watched(py, None, move |observer| {
        let plan = Plan::of_pearls(pearls, &options)
            .map_err(|PlanError { place, why }| BakeError::Input(format!("{place}{why}")))?;
        let mut report = plan.report();
        if why_not {
            report["why_not"] = why_not::report(&plan, observer)?;
        }
        Ok(report)
    });
    to_python(py, &report?)
}
