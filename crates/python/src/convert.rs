//! Python's values and ours.

use crate::errors::{failure, field, input};
use numpy::ndarray::ArrayD;
use numpy::{AllowTypeChange, Element, IntoPyArray as _, PyArrayDyn, PyArrayLikeDyn};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict as _, PyAny, PyCFunction, PyDict, PyString, PyTuple};
use serde::Serialize;

/// Anything that serialises, as Python's dict, list, str, int, float, bool or None.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(failure)?;
    py.import("json")?.call_method1("loads", (text,))
}

/// JSON text of a recipe, NumPy's numbers and arrays in it as Python's own. What is not finite its reader refuses by the field.
pub(crate) fn to_json(value: &Bound<'_, PyAny>) -> PyResult<String> {
    let py = value.py();
    let plain = |args: &Bound<'_, PyTuple>, _: Option<&Bound<'_, PyDict>>| {
        let value = args.get_item(0)?;
        let kind = value.get_type().name()?;
        let other = || field("recipe", format_args!("has a {kind} in it, expected what JSON can say"));
        value.call_method0("tolist").map(Bound::unbind).map_err(|_| other())
    };
    let options = [("default", PyCFunction::new_closure(py, None, None, plain)?)].into_py_dict(py)?;
    match py.import("json")?.call_method("dumps", (value,), Some(&options)) {
        Ok(text) => Ok(text.cast::<PyString>().map_err(failure)?.to_string()),
        Err(why) => Err(input(why.value(py))),
    }
}

/// Numbers as NumPy reads them (a number, a list, an array of any numeric type), in f64, rows first.
pub(crate) struct Numbers<'py> {
    pub(crate) shape: Vec<usize>,
    array: PyArrayLikeDyn<'py, f64, AllowTypeChange>,
    /// Where the array lies in memory in another order.
    copy: Option<Vec<f64>>,
}

impl Numbers<'_> {
    pub(crate) fn values(&self) -> &[f64] {
        match &self.copy {
            Some(copy) => copy,
            // Without a copy the array is in order.
            None => self.array.as_slice().unwrap_or_default(),
        }
    }
}

/// Reads an argument.
pub(crate) fn numbers<'py>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Numbers<'py>> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> =
        value.extract().map_err(|_| field(name, "is not an array of real numbers"))?;
    let view = array.as_array();
    let copy = (!view.is_standard_layout()).then(|| view.iter().copied().collect());
    Ok(Numbers { shape: view.shape().to_vec(), array, copy })
}

/// Reads a number or a row of numbers.
pub(crate) fn row(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let numbers = numbers(name, value)?;
    if numbers.shape.len() > 1 {
        let shape = shape_text(&numbers.shape);
        return Err(field(name, format_args!("has shape {shape}, expected one row of numbers")));
    }
    Ok(numbers.values().to_vec())
}

/// Whole numbers of arguments, by the names of these: what does not fit is refused like any other value.
pub(crate) mod whole {
    use crate::errors::field;
    use pyo3::exceptions::PyOverflowError;
    use pyo3::prelude::*;
    use pyo3::types::PyAny;

    macro_rules! arguments {
        ($($name:ident: $kind:ty,)*) => {$(
            pub(crate) fn $name<'a, 'py, T: FromPyObject<'a, 'py>>(value: &'a Bound<'py, PyAny>) -> PyResult<T> {
                value.extract::<T>().map_err(|why| {
                    let (why, most): (PyErr, _) = (why.into(), <$kind>::MAX);
                    if !why.is_instance_of::<PyOverflowError>(value.py()) {
                        return why;
                    }
                    field(stringify!($name), format_args!("{value} is not valid, expected 0 to {most}"))
                })
            }
        )*};
    }

    arguments! {
        cells: usize, count: u32, incidence: usize, index: u32, members: u64, paths: u64, seed: u64, threads: usize,
    }
}

/// A list of names, or one text of them with commas.
pub(crate) fn names(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    match value.extract::<String>() {
        Ok(text) => Ok(text.split(',').map(str::to_owned).collect()),
        Err(_) => value.extract().map_err(|_| field(name, "is not a list of names")),
    }
}

/// An array as NumPy's own, without a copy.
pub(crate) fn array<'py, T: Element>(
    py: Python<'py>,
    shape: &[usize],
    values: Vec<T>,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    Ok(ArrayD::from_shape_vec(shape, values).map_err(failure)?.into_pyarray(py))
}

/// As Python writes a shape.
pub(crate) fn shape_text(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}
