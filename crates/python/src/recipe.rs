//! Recipes.

use crate::convert::{array, row, to_json, to_python};
use crate::errors::{field, input};
use bake_brdf::recipe::{self, Recipe as Ours};
use num_complex::Complex64;
use numpy::{IntoPyArray as _, PyArray1, PyArrayDyn};
use pyo3::exceptions::PyUnicodeDecodeError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict as _, PyAny, PyDict};
use std::path::{Path, PathBuf};

#[doc = stub!("Recipe")]
#[pyclass(frozen, module = "nacre", from_py_object)]
#[derive(Clone)]
pub(crate) struct Recipe {
    pub(crate) inner: Ours,
}

#[doc = stub!("recipes")]
#[pyfunction]
pub(crate) fn recipes() -> Vec<&'static str> {
    recipe::BUILT_IN.iter().map(|(name, _)| *name).collect()
}

#[pymethods]
impl Recipe {
    #[new]
    fn new(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        Self::of(source)
    }

    #[doc = stub!("Recipe.name")]
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    #[doc = stub!("Recipe.to_dict")]
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.inner.to_json())
    }

    #[doc = stub!("Recipe.films")]
    #[allow(clippy::type_complexity)] // three arrays
    fn films<'py>(
        &self,
        py: Python<'py>,
        wavelengths_nm: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<Complex64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)>
    {
        let wavelengths = row("wavelengths_nm", wavelengths_nm)?;
        let stack = self.inner.film_stack();
        let most = thinfilm::field::MOST_LISTED_LAYERS;
        if stack.layer_count() > u128::from(most) {
            return Err(input(format_args!(
                "the stack has {} layers, expected at most {most}",
                stack.layer_count()
            )));
        }
        let indices = wavelengths.iter().map(|nm| stack.indices(nm * 1e-9)).collect::<Result<Vec<_>, _>>();
        let indices = indices.map_err(input)?;
        let layers: Vec<thinfilm::StackLayer> = stack.layers().collect();
        let mut n = Vec::with_capacity((layers.len() + 2) * wavelengths.len());
        n.extend(indices.iter().map(|at| at.ambient));
        for layer in &layers {
            n.extend(indices.iter().map(|at| at.materials[layer.material]));
        }
        n.extend(indices.iter().map(|at| at.substrate));
        let lengths = |of: fn(&thinfilm::StackLayer) -> f64| {
            let nm: Vec<f64> = layers.iter().map(|layer| of(layer) * 1e9).collect();
            nm.into_pyarray(py)
        };
        let n = array(py, &[layers.len() + 2, wavelengths.len()], n)?;
        Ok((n, lengths(|layer| layer.thickness), lengths(|layer| layer.thickness_sd)))
    }

    fn __repr__(&self) -> String {
        format!("nacre.Recipe({:?})", self.inner.name)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }
}

impl Recipe {
    /// A recipe itself, a built-in name, a path, or a dict.
    pub(crate) fn of(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(recipe) = source.extract::<Self>() {
            return Ok(recipe);
        }
        if source.is_instance_of::<PyDict>() {
            let text = to_json(source)?;
            return Ok(Self { inner: Ours::from_json(&text).map_err(input)? });
        }
        let Ok(path) = source.extract::<PathBuf>() else {
            let kind = source.get_type().name()?;
            return Err(field(
                "recipe",
                format_args!("is a {kind}, expected a built-in name, a path or a dict"),
            ));
        };
        if let Some(text) = path.to_str().and_then(recipe::built_in) {
            return Ok(Self { inner: Ours::from_json(text).map_err(input)? });
        }
        let text = text(source.py(), &path)?;
        let inner = Ours::from_json(&text).map_err(|why| field(&path.display().to_string(), why))?;
        Ok(Self { inner })
    }
}

/// The text of a file as Python reads it: UTF-8 with or without a byte-order mark, no more than a recipe may be long.
fn text(py: Python<'_>, path: &Path) -> PyResult<String> {
    if let Some(why) = recipe::unknown(path) {
        return Err(field(&path.display().to_string(), why));
    }
    let (mode, encoding) = (("mode", "r"), ("encoding", "utf-8-sig"));
    let file = py.import("io")?.call_method("open", (path,), Some(&[mode, encoding].into_py_dict(py)?))?;
    let text = file.call_method1("read", (recipe::MAX_BYTES + 1,));
    file.call_method0("close")?;
    let text: String = text
        .map_err(|error| match error.is_instance_of::<PyUnicodeDecodeError>(py) {
            true => field(&path.display().to_string(), "is not encoded in UTF-8"),
            false => error,
        })?
        .extract()?;
    if text.len() as u64 > recipe::MAX_BYTES {
        let why = format!("is longer than {} bytes", recipe::MAX_BYTES);
        return Err(field(&path.display().to_string(), why));
    }
    Ok(text)
}
