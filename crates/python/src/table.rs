//! Tables.

use crate::convert::{shape_text, to_python, whole};
use crate::errors::{failure, field, input, of_file};
use lut_io::both_sides::Passage;
use lut_io::lobe::Interpolant;
use lut_io::table::{Component, Lobe};
use lut_io::{Table as Ours, dispersion, exr_file};
use numpy::ndarray::{ArrayViewD, IxDyn};
use numpy::{IntoPyArray as _, PyArray1, PyArrayDyn};
use pearl_bsdf::Prepared;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyBytes};
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

#[doc = stub!("Table")]
#[pyclass(frozen, module = "nacre")]
pub(crate) struct Table {
    inner: Arc<Ours>,
    /// Made ready for the first pearl that asks for it, and shared by all.
    prepared: OnceLock<Arc<Prepared>>,
}

impl From<Ours> for Table {
    fn from(table: Ours) -> Self {
        Self { inner: Arc::new(table), prepared: OnceLock::new() }
    }
}

impl Table {
    /// The table made ready; the caller lets go of the interpreter's lock.
    pub(crate) fn prepared(&self) -> Result<Arc<Prepared>, pearl_bsdf::BsdfError> {
        if let Some(prepared) = self.prepared.get() {
            return Ok(Arc::clone(prepared));
        }
        let made = Arc::new(Prepared::new(Arc::clone(&self.inner))?);
        Ok(Arc::clone(self.prepared.get_or_init(|| made)))
    }

    /// The name of its pearl.
    pub(crate) fn name(&self) -> &str {
        self.inner.meta().recipe_name().unwrap_or("pearl")
    }

    /// The table as it is read between nodes.
    pub(crate) fn interpolant(&self) -> Interpolant {
        Interpolant::new(Arc::clone(&self.inner))
    }
}

#[pymethods]
impl Table {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| exr_file::read(&path)).map(Self::from).map_err(of_file)
    }

    #[doc = stub!("Table.from_bytes")]
    #[staticmethod]
    fn from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        py.detach(|| exr_file::decode(data)).map(Self::from).map_err(input)
    }

    #[doc = stub!("Table.to_bytes")]
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach(|| exr_file::encode(&self.inner)).map_err(input)?;
        Ok(PyBytes::new(py, &bytes))
    }

    #[doc = stub!("Table.save")]
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| exr_file::write(&self.inner, &path)).map_err(of_file)
    }

    #[doc = stub!("Table.meta")]
    #[getter]
    fn meta<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, self.inner.meta())
    }

    #[doc = stub!("Table.theta_i")]
    #[getter]
    fn theta_i<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.inner.theta_i().into_pyarray(py)
    }

    #[doc = stub!("Table.channels")]
    #[getter]
    fn channels(&self) -> Vec<String> {
        self.named().map(|(name, _)| name).collect()
    }

    #[doc = stub!("Table.channel")]
    fn channel<'py>(this: &Bound<'py, Self>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let table = this.get();
        let Some((_, values)) = table.named().find(|(given, _)| given == name) else {
            let names = table.channels().join(", ");
            return Err(field("channel", format_args!("{name:?} is not one of {names}")));
        };
        let shape = table.shape();
        let view = ArrayViewD::from_shape(IxDyn(&shape), values).map_err(failure)?;
        // SAFETY: the memory is that of the table behind `this`, which the array keeps alive as its base. Nothing moves or changes it:
        // `Table` is frozen, has no method that takes it apart, and its `Arc` is never handed out for writing. The flag below keeps
        // NumPy from writing to it. What it gains: a space table has 10 to 100 MB that would be copied at every look.
        #[allow(unsafe_code)]
        let array = unsafe { PyArrayDyn::borrow_from_array(&view, this.clone().into_any()) };
        array.call_method1("setflags", (false,))?;
        Ok(array)
    }

    #[doc = stub!("Table.edges")]
    #[allow(clippy::type_complexity)] // two arrays
    fn edges<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::incidence)] incidence: usize,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Option<Bound<'py, PyArray1<f64>>>)> {
        let theta_i = self.inner.theta_i();
        let Some(theta_i) = theta_i.get(incidence) else {
            let most = theta_i.len() - 1;
            return Err(field("incidence", format_args!("{incidence} is not one of 0 to {most}")));
        };
        let axis = &self.inner.meta().exit_axis;
        let azimuths = axis.phi_at(*theta_i).map(|phi| phi.edges().into_pyarray(py));
        Ok((axis.columns_at(*theta_i).edges().into_pyarray(py), azimuths))
    }

    fn __repr__(&self) -> String {
        let meta = self.inner.meta();
        let name = meta.recipe_name().unwrap_or("without a name");
        let shape = shape_text(&self.shape());
        let word = |value: Result<serde_json::Value, _>| match value {
            Ok(serde_json::Value::String(word)) => word,
            _ => String::new(),
        };
        let azimuth = word(serde_json::to_value(meta.azimuth));
        let solver = word(serde_json::to_value(meta.solver));
        format!("<nacre.Table {name:?}, {azimuth} by {solver}, {shape}>")
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }
}

impl Table {
    fn shape(&self) -> Vec<usize> {
        let axis = &self.inner.meta().exit_axis;
        let (incidences, columns) = (self.inner.meta().per_incidence.len(), axis.columns());
        match axis.cells() / columns {
            1 => vec![incidences, columns],
            rows => vec![incidences, rows, columns],
        }
    }

    /// Every channel under the name it has in the file.
    fn named(&self) -> impl Iterator<Item = (String, &[f32])> {
        let own = Component::ALL
            .into_iter()
            .map(|component| (component.name().to_owned(), self.inner.lobe(component)));
        let bands = self.inner.bands().iter().enumerate().flat_map(|(band, lobes)| {
            let name = move |component: Component| dispersion::channel_name(component.name(), band);
            Component::ALL.into_iter().zip(lobes).map(move |(component, lobe)| (name(component), lobe))
        });
        let passages = Passage::ALL
            .into_iter()
            .filter_map(|passage| Some((passage.name().to_owned(), self.inner.passage(passage)?)));
        own.chain(bands).flat_map(|(name, lobe)| parts(&name, lobe)).chain(passages)
    }
}

fn parts<'l>(name: &str, lobe: &'l Lobe) -> [(String, &'l [f32]); 3] {
    [
        (name.to_owned(), &lobe.value[..]),
        (format!("{name}_std_error"), &lobe.std_error[..]),
        (format!("{name}_count"), &lobe.count[..]),
    ]
}
