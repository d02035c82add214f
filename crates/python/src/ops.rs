//! What is done with tables, and plans.

use crate::convert::{array, to_python};
use crate::errors::{field, input};
use crate::pearl::table_of;
use crate::recipe::Recipe;
use bake_brdf::bake::implied;
use bake_brdf::options::Options;
use bake_brdf::plan::Plan;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::json;

/// All that an evaluation reads, by name (docs/ARRAYS.md): single numbers and f32 arrays.
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

/// How two tables differ, and whether more than their errors explain: what `lut diff --json` prints.
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

/// Whether what a table says of itself holds: what `lut check --json` prints of it.
#[pyfunction]
pub(crate) fn check<'py>(py: Python<'py>, table: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let table = table_of(table)?;
    let table = table.get();
    let (findings, no_recipe) = py.detach(|| {
        let mut findings = lut_io::check::check(&table.interpolant());
        // A recipe that no bake of this version reads says nothing of the table.
        let no_recipe = match implied::check(table.inner()) {
            Ok(implied) => {
                findings.extend(implied);
                None
            }
            Err(why) => Some(why.to_string()),
        };
        (findings, no_recipe)
    });
    let pass = findings.iter().all(|finding| finding.pass != Some(false));
    to_python(py, &json!({ "pass": pass, "checks": findings, "recipe_not_read": no_recipe }))
}

/// Which effects a recipe's look calls for, why, and what they cost: what `bake-brdf plan --json` prints.
#[pyfunction]
pub(crate) fn plan<'py>(py: Python<'py>, recipe: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let recipe = Recipe::of(recipe)?.inner;
    let plan = py.detach(|| {
        let name = recipe.name.clone();
        Plan::of_recipe(recipe, &name, &Options::default())
    });
    to_python(py, &plan.map_err(input)?.report())
}
