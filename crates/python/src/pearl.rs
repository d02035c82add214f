//! Pearls: a table with the artist's controls, asked for many directions at a call.

use crate::convert::{Numbers, array, numbers, shape_text, to_python};
use crate::errors::{field, input};
use crate::table::Table;
use numpy::PyArrayDyn;
use pearl_bsdf::{Components, Controls, Direction, Evaluation, PearlBsdf, Sample};
use pyo3::prelude::*;
use pyo3::types::PyAny;
use rayon::prelude::*;

/// Directions that a thread takes at a time: what belongs to them stays in its cache.
const PIECE: usize = 512;
/// |v|² − 1 of a vector that needs no normalising: a few roundings.
const UNIT: f64 = 1e-15;

#[doc = stub!("Pearl")]
#[pyclass(frozen, module = "nacre")]
pub(crate) struct Pearl {
    bsdf: PearlBsdf,
}

/// Directions of an argument, not normalised yet, with the shape that answers have: all indices but the last.
struct Directions<'py> {
    name: &'static str,
    shape: Vec<usize>,
    numbers: Numbers<'py>,
}

/// Vectors of an argument; a single one stands for all.
#[derive(Clone, Copy)]
struct Vectors<'a> {
    name: &'static str,
    vectors: &'a [[f64; 3]],
}

/// A vector that is no direction.
struct NoDirection {
    name: &'static str,
    at: usize,
    vector: [f64; 3],
}

#[pymethods]
impl Pearl {
    #[new]
    #[pyo3(signature = (table, *, depth=None, brightness=None, coherence=None, body_color=None, tint=None, thickness=None, components=None))]
    fn new(
        py: Python<'_>,
        table: &Bound<'_, PyAny>,
        depth: Option<f64>,
        brightness: Option<f64>,
        coherence: Option<f64>,
        body_color: Option<&Bound<'_, PyAny>>,
        tint: Option<&Bound<'_, PyAny>>,
        thickness: Option<f64>,
        components: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let table = table_of(table)?;
        let table = table.get();
        let prepared = py.detach(|| table.prepared()).map_err(input)?;
        let mut controls = prepared.look();
        let numbers = [
            (&mut controls.depth, depth),
            (&mut controls.brightness, brightness),
            (&mut controls.coherence, coherence),
            (&mut controls.thickness, thickness),
        ];
        for (control, given) in numbers {
            *control = given.unwrap_or(*control);
        }
        let colours =
            [("body_color", &mut controls.body_rgb, body_color), ("tint", &mut controls.tint_rgb, tint)];
        for (name, control, given) in colours {
            if let Some(given) = given {
                *control = rgb(name, given)?;
            }
        }
        if let Some(names) = components {
            controls.components = shown(names)?;
        }
        let bsdf = py.detach(|| PearlBsdf::new(prepared, controls)).map_err(input)?;
        Ok(Self { bsdf })
    }

    #[doc = stub!("Pearl.controls")]
    #[getter]
    fn controls<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Controls { depth, brightness, coherence, body_rgb, tint_rgb, thickness, components } =
            *self.bsdf.controls();
        let on = [components.diffuse, components.incoherent, components.mirror, components.blur];
        let names: Vec<&str> =
            Components::NAMES.into_iter().zip(on).filter_map(|(name, on)| on.then_some(name)).collect();
        let controls = serde_json::json!({
            "depth": depth, "brightness": brightness, "coherence": coherence,
            "body_color": body_rgb, "tint": tint_rgb, "thickness": thickness, "components": names,
        });
        to_python(py, &controls)
    }

    #[doc = stub!("Pearl.eval")]
    fn eval<'py>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        wo: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        self.evaluate(py, wi, wo, &[3], Evaluation::rgb)
    }

    #[doc = stub!("Pearl.eval_components")]
    fn eval_components<'py>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        wo: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        self.evaluate(py, wi, wo, &[4, 3], |value| {
            let mut numbers = [0.0; 12];
            numbers.copy_from_slice(value.parts().as_flattened());
            numbers
        })
    }

    #[doc = stub!("Pearl.eval_spectrum")]
    fn eval_spectrum<'py>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        wo: &Bound<'py, PyAny>,
        wavelengths_nm: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (shape, wi, wo) = pairs(wi, wo)?;
        let wavelengths = crate::convert::row("wavelengths_nm", wavelengths_nm)?;
        if let Some(nm) = wavelengths.iter().find(|nm| !(nm.is_finite() && **nm > 0.0)) {
            return Err(field(
                "wavelengths_nm",
                format_args!("{nm} is not a wavelength, expected more than 0"),
            ));
        }
        let (wi, wo) = (wi.vectors(), wo.vectors());
        let count = wavelengths.len();
        let mut out = vec![0.0; count * shape.iter().product::<usize>()];
        let spectra = |(): &mut (), wi: &[Direction], wo: &[Direction], out: &mut [f64]| {
            for ((wi, wo), out) in wi.iter().zip(wo).zip(out.chunks_mut(count)) {
                out.copy_from_slice(&self.bsdf.eval_seen_spectrum(*wi, *wo, &wavelengths));
            }
        };
        if count > 0 {
            py.detach(|| by_pieces(wi, wo, &mut out, count, spectra)).map_err(refuse)?;
        }
        array(py, &with(&shape, &[wavelengths.len()]), out)
    }

    #[doc = stub!("Pearl.pdf")]
    fn pdf<'py>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        wo: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (shape, wi, wo) = pairs(wi, wo)?;
        let (wi, wo) = (wi.vectors(), wo.vectors());
        let mut out = vec![0.0; shape.iter().product()];
        let densities = |(): &mut (), wi: &[Direction], wo: &[Direction], out: &mut [f64]| {
            self.bsdf.pdf_many(wi, wo, out);
        };
        py.detach(|| by_pieces(wi, wo, &mut out, 1, densities)).map_err(refuse)?;
        array(py, &shape, out)
    }

    #[doc = stub!("Pearl.sample")]
    #[allow(clippy::type_complexity)] // three arrays
    fn sample<'py>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>)>
    {
        let uniform = directions("u", u)?;
        if let Some(x) = uniform.numbers.values().iter().find(|x| !(0.0..1.0).contains(*x)) {
            return Err(field(
                "u",
                format_args!("{x} is not a random number, expected 0 or more and less than 1"),
            ));
        }
        let shape = &uniform.shape;
        let wi = directions("wi", wi)?;
        wi.expect(shape, "u")?;
        let (wi, uniform) = (wi.vectors(), uniform.vectors().vectors);
        let count = uniform.len();
        let (mut wo, mut pdf, mut value) = (vec![0.0; 3 * count], vec![0.0; count], vec![0.0; 3 * count]);
        py.detach(|| {
            let out = wo.as_chunks_mut::<3>().0.par_chunks_mut(PIECE).zip(pdf.par_chunks_mut(PIECE));
            let out = out.zip(value.as_chunks_mut::<3>().0.par_chunks_mut(PIECE));
            let pieces = uniform.par_chunks(PIECE).zip(out).enumerate();
            pieces.try_for_each_init(
                || (Vec::with_capacity(PIECE), vec![None; PIECE]),
                |(unit, samples), (piece, (u, ((wo, pdf), value)))| {
                    let unit = wi.directions(piece * PIECE, u.len(), unit)?;
                    let samples: &mut [Option<Sample>] = &mut samples[..u.len()];
                    self.bsdf.sample_seen_many(unit, u, samples);
                    for (k, sample) in samples.iter().enumerate() {
                        if let Some(sample) = sample {
                            (wo[k], pdf[k], value[k]) = (sample.wo, sample.pdf, sample.value.rgb());
                        }
                    }
                    Ok(())
                },
            )
        })
        .map_err(refuse)?;
        Ok((
            array(py, &with(shape, &[3]), wo)?,
            array(py, shape, pdf)?,
            array(py, &with(shape, &[3]), value)?,
        ))
    }

    #[doc = stub!("Pearl.albedo")]
    fn albedo<'py>(
        &self,
        py: Python<'py>,
        theta_i_deg: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let angles = numbers("theta_i_deg", theta_i_deg)?;
        let (shape, values) = (&angles.shape, angles.values());
        if let Some(angle) = values.iter().find(|angle| !(0.0..90.0).contains(*angle)) {
            return Err(field(
                "theta_i_deg",
                format_args!("{angle} is not an angle, expected 0 or more and less than 90"),
            ));
        }
        let out: Vec<f64> = py.detach(|| {
            let angles = values.par_iter();
            angles
                .flat_map_iter(|angle| self.bsdf.directional_albedo(angle.to_radians()).into_iter().flatten())
                .collect()
        });
        array(py, &with(shape, &[4, 3]), out)
    }

    /// Names of the components, in their order.
    #[classattr]
    #[allow(non_snake_case)] // Python's name for a constant
    fn COMPONENTS() -> (&'static str, &'static str, &'static str, &'static str) {
        let [a, b, c, d] = Components::NAMES;
        (a, b, c, d)
    }
}

impl Pearl {
    /// N numbers of every pair, in an array that ends with their shape.
    fn evaluate<'py, const N: usize>(
        &self,
        py: Python<'py>,
        wi: &Bound<'py, PyAny>,
        wo: &Bound<'py, PyAny>,
        last: &[usize],
        numbers: impl Fn(&Evaluation) -> [f64; N] + Sync,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (shape, wi, wo) = pairs(wi, wo)?;
        let (wi, wo) = (wi.vectors(), wo.vectors());
        let mut out = vec![0.0; N * shape.iter().product::<usize>()];
        let places = out.as_chunks_mut::<N>().0;
        let ask = |values: &mut Vec<Evaluation>, wi: &[Direction], wo: &[Direction], out: &mut [[f64; N]]| {
            values.resize(wi.len(), Evaluation::default());
            self.bsdf.eval_seen_many(wi, wo, values);
            out.iter_mut().zip(values.iter()).for_each(|(out, value)| *out = numbers(value));
        };
        py.detach(|| by_pieces(wi, wo, places, 1, ask)).map_err(refuse)?;
        array(py, &with(&shape, last), out)
    }
}

/// Asks for pairs in pieces, over the threads; each has so many places in `out`. What a thread needs beside it keeps for all its pieces.
fn by_pieces<T: Send, S: Default>(
    wi: Vectors<'_>,
    wo: Vectors<'_>,
    out: &mut [T],
    places: usize,
    ask: impl Fn(&mut S, &[Direction], &[Direction], &mut [T]) + Sync,
) -> Result<(), NoDirection> {
    let work = |(own, unit_i, unit_o): &mut (S, Vec<_>, Vec<_>), (piece, out): (usize, &mut [T])| {
        let (first, count) = (piece * PIECE, out.len() / places);
        let wi = wi.directions(first, count, unit_i)?;
        let wo = wo.directions(first, count, unit_o)?;
        ask(own, wi, wo, out);
        Ok(())
    };
    if out.len() <= PIECE * places {
        // Waking a thread takes longer.
        return if out.is_empty() { Ok(()) } else { work(&mut Default::default(), (0, out)) };
    }
    out.par_chunks_mut(PIECE * places).enumerate().try_for_each_init(Default::default, work)
}

impl<'a> Vectors<'a> {
    /// The directions of a piece: the vectors themselves where none needs normalising, else in `unit`.
    fn directions<'u>(
        self,
        first: usize,
        count: usize,
        unit: &'u mut Vec<Direction>,
    ) -> Result<&'u [Direction], NoDirection>
    where
        'a: 'u,
    {
        let (first, piece) = match self.vectors {
            [one] => (0, std::slice::from_ref(one)),
            all => (first, &all[first..first + count]),
        };
        let is_unit = |v: &[f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0).abs() <= UNIT;
        // Without an early end: several at a time.
        let all_are = piece.iter().fold(true, |all, v| all & is_unit(v));
        if all_are && piece.len() == count {
            return Ok(piece);
        }
        unit.clear();
        for (at, v) in piece.iter().enumerate() {
            let bad = || NoDirection { name: self.name, at: first + at, vector: *v };
            unit.push(if is_unit(v) { *v } else { pearl_bsdf::unit(*v).ok_or_else(bad)? });
        }
        unit.resize(count, unit[0]);
        Ok(unit)
    }
}

fn refuse(bad: NoDirection) -> PyErr {
    let NoDirection { name, at, vector } = bad;
    let why = format!("direction {at} is {vector:?}, expected three finite numbers that are not all 0");
    field(name, why)
}

/// A table, or the file of one.
pub(crate) fn table_of<'py>(source: &Bound<'py, PyAny>) -> PyResult<Bound<'py, Table>> {
    if let Ok(table) = source.cast::<Table>() {
        return Ok(table.clone());
    }
    Ok(source.py().get_type::<Table>().call1((source,))?.cast_into::<Table>()?)
}

/// A colour, or a grey by one number.
pub(crate) fn rgb(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let numbers = numbers(name, value)?;
    let rgb = match (&numbers.shape[..], numbers.values()) {
        ([], [grey]) => [*grey; 3],
        ([3], [r, g, b]) => [*r, *g, *b],
        (shape, _) => {
            let why = format_args!("has shape {}, expected one number or three", shape_text(shape));
            return Err(field(name, why));
        }
    };
    match rgb.iter().position(|channel| !(0.0..=1.0).contains(channel)) {
        None => Ok(rgb),
        Some(c) => {
            let why = format_args!("{} is not valid; expected a number from 0 to 1", rgb[c]);
            Err(field(&format!("{name}[{c}]"), why))
        }
    }
}

pub(crate) fn shown(names: &Bound<'_, PyAny>) -> PyResult<Components> {
    let list = crate::convert::names("components", names)?;
    Components::from_names(list.iter().map(String::as_str)).ok_or_else(|| {
        let names = Components::NAMES.join(", ");
        field("components", format_args!("{} is not all or a list of {names}", list.join(",")))
    })
}

/// Pairs of directions, one of which may be a single one for all of the other, and the shape of their answers.
fn pairs<'py>(
    wi: &Bound<'py, PyAny>,
    wo: &Bound<'py, PyAny>,
) -> PyResult<(Vec<usize>, Directions<'py>, Directions<'py>)> {
    let (wi, wo) = (directions("wi", wi)?, directions("wo", wo)?);
    let shape = if wi.shape.is_empty() { wo.shape.clone() } else { wi.shape.clone() };
    wo.expect(&shape, "wi")?;
    Ok((shape, wi, wo))
}

fn directions<'py>(name: &'static str, value: &Bound<'py, PyAny>) -> PyResult<Directions<'py>> {
    let numbers = numbers(name, value)?;
    match numbers.shape.split_last() {
        Some((3, shape)) => Ok(Directions { name, shape: shape.to_vec(), numbers }),
        _ => Err(field(name, format_args!("has shape {}, expected (…, 3)", shape_text(&numbers.shape)))),
    }
}

impl Directions<'_> {
    /// Refuses another number of directions than a shape has, or than one for all.
    fn expect(&self, shape: &[usize], other: &str) -> PyResult<()> {
        if self.shape.is_empty() || self.shape == shape {
            return Ok(());
        }
        let text = |shape: &[usize]| shape_text(&with(shape, &[3]));
        let why =
            format!("has shape {}, expected {} as {other} has, or (3,)", text(&self.shape), text(shape));
        Err(field(self.name, why))
    }

    fn vectors(&self) -> Vectors<'_> {
        Vectors { name: self.name, vectors: self.numbers.values().as_chunks::<3>().0 }
    }
}

fn with(shape: &[usize], last: &[usize]) -> Vec<usize> {
    [shape, last].concat()
}
