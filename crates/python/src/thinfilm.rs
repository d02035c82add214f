//! Waves in stacks: the functions behind `nacre.thinfilm`, which checks shapes and gives results their names.
//!
//! A batch is `n` of [stack, layers + 2, wavelength] and `d` of [stack, layer]; either may have one entry for all along any index but that
//! of the layers. Layers with the same indices at all wavelengths are one material.

use crate::convert::{array, row, whole};
use crate::errors::{field, input};
use num_complex::Complex64;
use numpy::{PyArrayDyn, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyAny;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::HashMap;
use thinfilm::dense::Spectra;
use thinfilm::ensemble::{self, Members};
use thinfilm::stack::Indices;
use thinfilm::{
    Dispersion, Gain, Incidence, Material, Multilayer, Polarisation, Stack, StackError, StackLayer, StackRun,
    WaveError, dense,
};

/// Arrays of s and p.
type Pair<'py, T> = [Bound<'py, PyArrayDyn<T>>; 2];

/// A batch of stacks.
struct Batch {
    stacks: usize,
    layers: usize,
    /// [stack, layers + 2, wavelength], each of one or of as many as there are.
    n: Vec<Complex64>,
    n_shape: [usize; 3],
    /// [stack, layer], m.
    d: Vec<f64>,
    d_stacks: usize,
    /// m.
    wavelengths: Vec<f64>,
    gain: Gain,
}

/// One stack of a batch: materials by number, with their indices at every wavelength.
struct One {
    stack: Stack,
    indices: Vec<Indices>,
}

impl Batch {
    fn new(
        n: &PyReadonlyArray3<'_, Complex64>,
        d_nm: &PyReadonlyArray2<'_, f64>,
        wavelengths_nm: &Bound<'_, PyAny>,
        gain: bool,
    ) -> PyResult<Self> {
        let (n, d) = (n.as_array(), d_nm.as_array());
        let n_shape = [n.shape()[0], n.shape()[1], n.shape()[2]];
        let last = n_shape[1] - 1;
        if let Some(((stack, medium, _), bad)) =
            n.indexed_iter().find(|(_, n)| !(n.re.is_finite() && n.re > 0.0 && n.im.is_finite()))
        {
            let why = format!("medium {medium} of stack {stack} is {bad}, expected n > 0, both parts finite");
            return Err(field("n", why));
        }
        let gains = |medium: usize| !gain && medium > 0 && medium < last;
        if let Some(((stack, medium, _), bad)) =
            n.indexed_iter().find(|((_, medium, _), n)| n.im < 0.0 && gains(*medium))
        {
            let why = format!(
                "medium {medium} of stack {stack} has k = {}: it amplifies, expected gain=True",
                bad.im
            );
            return Err(field("n", why));
        }
        Ok(Self {
            stacks: if n_shape[0] == 1 { d.shape()[0] } else { n_shape[0] },
            layers: d.shape()[1],
            n: n.iter().copied().collect(),
            n_shape,
            d: d.iter().map(|nm| nm * 1e-9).collect(),
            d_stacks: d.shape()[0],
            wavelengths: row("wavelengths_nm", wavelengths_nm)?.iter().map(|nm| nm * 1e-9).collect(),
            gain: if gain { Gain::Allowed } else { Gain::Refused },
        })
    }

    /// n of a medium (0: the ambient) over the wavelengths; one entry where it is the same at all.
    fn index(&self, stack: usize, medium: usize) -> &[Complex64] {
        let [stacks, media, wavelengths] = self.n_shape;
        let stack = if stacks == 1 { 0 } else { stack };
        let start = (stack * media + medium) * wavelengths;
        &self.n[start..start + wavelengths]
    }

    fn thickness(&self, stack: usize) -> &[f64] {
        let stack = if self.d_stacks == 1 { 0 } else { stack };
        &self.d[stack * self.layers..(stack + 1) * self.layers]
    }

    fn one(&self, stack: usize) -> One {
        let mut numbers: HashMap<Vec<[u64; 2]>, usize> = HashMap::new();
        let mut materials: Vec<&[Complex64]> = Vec::new();
        let layer = |(layer, thickness): (usize, &f64)| {
            let index = self.index(stack, layer + 1);
            let bits = index.iter().map(|n| [n.re.to_bits(), n.im.to_bits()]).collect();
            let material = *numbers.entry(bits).or_insert_with(|| {
                materials.push(index);
                materials.len() - 1
            });
            StackLayer { material, thickness: *thickness, thickness_sd: 0.0 }
        };
        let unit = self.thickness(stack).iter().enumerate().map(layer).collect();
        let at = |index: &[Complex64], wavelength: usize| *index.get(wavelength).unwrap_or(&index[0]);
        let (ambient, substrate) = (self.index(stack, 0), self.index(stack, self.layers + 1));
        let indices = (0..self.wavelengths.len()).map(|wavelength| Indices {
            ambient: at(ambient, wavelength),
            materials: materials.iter().map(|index| at(index, wavelength)).collect(),
            substrate: at(substrate, wavelength),
        });
        let indices = indices.collect();
        let material = |index: &[Complex64]| self.material(index);
        One {
            stack: Stack {
                ambient: material(ambient),
                materials: materials.iter().map(|index| material(index)).collect(),
                runs: vec![StackRun { unit, repeat: 1 }],
                substrate: material(substrate),
                gain: self.gain,
            },
            indices,
        }
    }

    /// A material with these indices, linear between the wavelengths, which come in any order.
    fn material(&self, index: &[Complex64]) -> Material {
        if let [one] = index {
            return Material { n: Dispersion::Constant(one.re), k: one.im };
        }
        let rows = self.wavelengths.iter().zip(index).map(|(wavelength, n)| [wavelength * 1e9, n.re, n.im]);
        let mut rows: Vec<[f64; 3]> = rows.collect();
        rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
        rows.dedup();
        Material { n: Dispersion::Table(rows), k: 0.0 }
    }

    /// What goes before a message about one of several stacks.
    fn named(&self, stack: usize, error: &StackError) -> PyErr {
        if self.stacks == 1 { input(error) } else { input(format_args!("stack {stack}: {error}")) }
    }
}

fn radians(angles_deg: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let angles = row("angles_deg", angles_deg)?;
    if let Some(angle) = angles.iter().find(|angle| !(0.0..=90.0).contains(*angle)) {
        return Err(field(
            "angles_deg",
            format_args!("{angle} is not an angle of incidence, expected 0 to 90 degrees"),
        ));
    }
    Ok(angles.iter().map(|angle| angle.to_radians()).collect())
}

/// R and T: [stack, angle, wavelength] of s and p.
#[pyfunction]
pub(crate) fn film_spectrum<'py>(
    py: Python<'py>,
    n: PyReadonlyArray3<'py, Complex64>,
    d_nm: PyReadonlyArray2<'py, f64>,
    wavelengths_nm: &Bound<'py, PyAny>,
    angles_deg: &Bound<'py, PyAny>,
    gain: bool,
) -> PyResult<(Pair<'py, f64>, Pair<'py, f64>, Pair<'py, f64>)> {
    let batch = Batch::new(&n, &d_nm, wavelengths_nm, gain)?;
    let angles = radians(angles_deg)?;
    let solve = |stack: usize| {
        let One { stack: films, indices } = batch.one(stack);
        dense::spectra_of(&films, &batch.wavelengths, indices, &angles).map_err(|error| (stack, error))
    };
    let spectra: Vec<Spectra> = py
        .detach(|| match batch.stacks {
            // Waking a thread takes longer.
            1 => Ok(vec![solve(0)?]),
            stacks => (0..stacks).into_par_iter().map(solve).collect(),
        })
        .map_err(|(stack, error)| batch.named(stack, &error))?;
    let shape = [batch.stacks, angles.len(), batch.wavelengths.len()];
    let pair = |row: fn(&Spectra, usize, Polarisation) -> Cow<'_, [f64]>| {
        let values = |pol| {
            let mut values = Vec::with_capacity(shape.iter().product());
            for spectra in &spectra {
                (0..angles.len()).for_each(|angle| values.extend_from_slice(&row(spectra, angle, pol)));
            }
            array(py, &shape, values)
        };
        Ok::<_, PyErr>([values(Polarisation::S)?, values(Polarisation::P)?])
    };
    Ok((
        pair(|spectra, angle, pol| spectra.reflectance(angle, pol).into())?,
        pair(|spectra, angle, pol| spectra.transmittance(angle, pol).into())?,
        pair(|spectra, angle, pol| spectra.absorptance(angle, pol).into())?,
    ))
}

/// What the robust form says of every wave of a batch, s and p: by case of [stack, angle, wavelength].
fn by_wave<T: Send>(
    py: Python<'_>,
    batch: &Batch,
    angles: &[f64],
    solve: impl Fn(&Multilayer, f64, Incidence, Polarisation) -> Result<T, WaveError> + Sync,
) -> PyResult<Vec<[T; 2]>> {
    let waves = batch.wavelengths.len();
    let solved = py.detach(|| {
        let ones: Vec<One> = (0..batch.stacks).into_par_iter().map(|stack| batch.one(stack)).collect();
        let case = |case: usize| {
            let (row, wave) = (case / waves, case % waves);
            let (stack, angle) = (row / angles.len(), row % angles.len());
            let One { stack: films, indices } = &ones[stack];
            let of = || -> Result<[T; 2], StackError> {
                films.check_indices(&indices[wave])?;
                let film = films.with_indices(&indices[wave]);
                let of = |pol| solve(&film, batch.wavelengths[wave], Incidence::Angle(angles[angle]), pol);
                Ok([of(Polarisation::S)?, of(Polarisation::P)?])
            };
            of().map_err(|error| (stack, error))
        };
        (0..batch.stacks * angles.len() * waves).into_par_iter().map(case).collect::<Result<_, _>>()
    });
    solved.map_err(|(stack, error)| batch.named(stack, &error))
}

/// Amplitudes r and t: [stack, angle, wavelength] of s and p.
#[pyfunction]
pub(crate) fn film_amplitudes<'py>(
    py: Python<'py>,
    n: PyReadonlyArray3<'py, Complex64>,
    d_nm: PyReadonlyArray2<'py, f64>,
    wavelengths_nm: &Bound<'py, PyAny>,
    angles_deg: &Bound<'py, PyAny>,
    gain: bool,
) -> PyResult<(Pair<'py, Complex64>, Pair<'py, Complex64>)> {
    let batch = Batch::new(&n, &d_nm, wavelengths_nm, gain)?;
    let angles = radians(angles_deg)?;
    let solved = by_wave(py, &batch, &angles, |film, wavelength, incidence, pol| {
        film.solve_with_gain(wavelength, incidence, pol).map(|response| [response.r, response.t])
    })?;
    let shape = [batch.stacks, angles.len(), batch.wavelengths.len()];
    let of = |amplitude: usize, pol: usize| {
        array(py, &shape, solved.iter().map(|both| both[pol][amplitude]).collect())
    };
    Ok(([of(0, 0)?, of(0, 1)?], [of(1, 0)?, of(1, 1)?]))
}

/// ∫|E|² dz over each layer (nm) and the share of the light that it absorbs: [stack, layer, angle, wavelength] of s and p.
#[pyfunction]
pub(crate) fn film_field<'py>(
    py: Python<'py>,
    n: PyReadonlyArray3<'py, Complex64>,
    d_nm: PyReadonlyArray2<'py, f64>,
    wavelengths_nm: &Bound<'py, PyAny>,
    angles_deg: &Bound<'py, PyAny>,
    gain: bool,
) -> PyResult<(Pair<'py, f64>, Pair<'py, f64>)> {
    let batch = Batch::new(&n, &d_nm, wavelengths_nm, gain)?;
    let angles = radians(angles_deg)?;
    let solved = by_wave(py, &batch, &angles, |film, wavelength, incidence, pol| {
        let field = film.field(wavelength, incidence, pol)?;
        Ok([field.integrals().iter().map(|m| m * 1e9).collect(), field.absorptances()])
    })?;
    let (layers, cases) = (batch.layers, angles.len() * batch.wavelengths.len());
    let of = |quantity: usize, pol: usize| {
        let values = (0..batch.stacks).flat_map(|stack| {
            let of_stack: &[[[Vec<f64>; 2]; 2]] = &solved[stack * cases..(stack + 1) * cases];
            (0..layers).flat_map(move |layer| of_stack.iter().map(move |both| both[pol][quantity][layer]))
        });
        array(py, &[batch.stacks, layers, angles.len(), batch.wavelengths.len()], values.collect())
    };
    Ok(([of(0, 0)?, of(0, 1)?], [of(1, 0)?, of(1, 1)?]))
}

/// |E|² of a unit incident wave at depths below the first interface of one stack: [angle, wavelength, depth] of s and p.
#[pyfunction]
pub(crate) fn film_intensity<'py>(
    py: Python<'py>,
    n: PyReadonlyArray3<'py, Complex64>,
    d_nm: PyReadonlyArray2<'py, f64>,
    wavelengths_nm: &Bound<'py, PyAny>,
    angles_deg: &Bound<'py, PyAny>,
    depths_nm: &Bound<'py, PyAny>,
    gain: bool,
) -> PyResult<Pair<'py, f64>> {
    let batch = Batch::new(&n, &d_nm, wavelengths_nm, gain)?;
    let (angles, depths) = (radians(angles_deg)?, row("depths_nm", depths_nm)?);
    let whole: f64 = batch.d.iter().sum::<f64>() * 1e9;
    let outside = format!("is outside of the layers, expected 0 to {whole}");
    let fields = by_wave(py, &batch, &angles, Multilayer::field)?;
    let mut out = [Vec::new(), Vec::new()];
    for both in fields {
        for (wave, out) in both.iter().zip(&mut out) {
            for nm in &depths {
                let squared = wave.intensity(nm * 1e-9);
                out.push(squared.ok_or_else(|| field("depths_nm", format_args!("{nm} {outside}")))?);
            }
        }
    }
    let shape = [angles.len(), batch.wavelengths.len(), depths.len()];
    let [s, p] = out;
    Ok([array(py, &shape, s)?, array(py, &shape, p)?])
}

/// Means over stacks with drawn thicknesses: R, T, A, standard errors of R and T ([angle, wavelength]; `None`: unknown), members,
/// whether the accuracy is reached.
#[pyfunction]
#[allow(clippy::type_complexity)] // what the mean has
pub(crate) fn film_ensemble<'py>(
    py: Python<'py>,
    n: PyReadonlyArray3<'py, Complex64>,
    d_nm: PyReadonlyArray2<'py, f64>,
    sd_nm: PyReadonlyArray2<'py, f64>,
    wavelengths_nm: &Bound<'py, PyAny>,
    angles_deg: &Bound<'py, PyAny>,
    pol: Option<&str>,
    #[pyo3(from_py_with = whole::members)] members: Option<u64>,
    accuracy: Option<f64>,
    #[pyo3(from_py_with = whole::seed)] seed: u64,
) -> PyResult<([Bound<'py, PyArrayDyn<f64>>; 3], [Option<Bound<'py, PyArrayDyn<f64>>>; 2], u64, bool)> {
    let batch = Batch::new(&n, &d_nm, wavelengths_nm, false)?;
    let angles = radians(angles_deg)?;
    let stack = irregular(&batch, &sd_nm);
    let pol = match pol {
        None => None,
        Some("s") => Some(Polarisation::S),
        Some("p") => Some(Polarisation::P),
        Some(other) => return Err(field("pol", format_args!("{other:?} is not s, p or None"))),
    };
    let most = ensemble::MOST_MEMBERS;
    let members = match (members, accuracy) {
        (Some(count), None) if (1..=most).contains(&count) => Members::Count(count),
        (Some(count), None) => {
            return Err(field("members", format_args!("{count} stacks, expected 1 to {most}")));
        }
        (None, Some(accuracy)) if accuracy.is_finite() && accuracy > 0.0 => Members::ToAccuracy(accuracy),
        (None, Some(accuracy)) => {
            return Err(field(
                "accuracy",
                format_args!("{accuracy} is not an error of R, expected more than 0"),
            ));
        }
        _ => return Err(input("members, accuracy: expected one of the two")),
    };
    let mean = py.detach(|| ensemble::mean_of(&stack, seed, members, &batch.wavelengths, &angles, pol));
    let mean = mean.map_err(input)?;
    let shape = [angles.len(), batch.wavelengths.len()];
    let rows = |rows: Vec<Vec<f64>>| array(py, &shape, rows.concat());
    Ok((
        [rows(mean.reflectance)?, rows(mean.transmittance)?, rows(mean.absorptance)?],
        [mean.reflectance_error.map(rows).transpose()?, mean.transmittance_error.map(rows).transpose()?],
        mean.members,
        mean.converged,
    ))
}

/// The first stack of a batch, with spreads of its thicknesses.
fn irregular(batch: &Batch, sd_nm: &PyReadonlyArray2<'_, f64>) -> Stack {
    let One { mut stack, .. } = batch.one(0);
    for (layer, sd) in stack.runs[0].unit.iter_mut().zip(sd_nm.as_array()) {
        layer.thickness_sd = sd * 1e-9;
    }
    stack
}

/// Colours in reflection of one stack under D65, by angle: XYZ, linear sRGB, L*a*b* ([angle, 3]), the change by half as many wavelengths
/// and the standard error of an ensemble, ΔE00 (NaN: unknown).
#[pyfunction]
#[allow(clippy::type_complexity)] // what a colour has
pub(crate) fn film_colours<'py>(
    py: Python<'py>,
    n: PyReadonlyArray3<'py, Complex64>,
    d_nm: PyReadonlyArray2<'py, f64>,
    sd_nm: PyReadonlyArray2<'py, f64>,
    wavelengths_nm: &Bound<'py, PyAny>,
    angles_deg: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = whole::members)] members: u64,
    accuracy: f64,
    #[pyo3(from_py_with = whole::seed)] seed: u64,
) -> PyResult<([Bound<'py, PyArrayDyn<f64>>; 3], [Bound<'py, PyArrayDyn<f64>>; 2])> {
    let batch = Batch::new(&n, &d_nm, wavelengths_nm, false)?;
    let angles = radians(angles_deg)?;
    let stack = irregular(&batch, &sd_nm);
    if !(1..=ensemble::MOST_MEMBERS).contains(&members) {
        let most = ensemble::MOST_MEMBERS;
        return Err(field("members", format_args!("{members} stacks, expected 1 to {most}")));
    }
    if !(accuracy.is_finite() && accuracy > 0.0) {
        return Err(field(
            "accuracy",
            format_args!("{accuracy} is not a colour difference, expected more than 0"),
        ));
    }
    let colours = py.detach(|| thinfilm::colour::of_stack(&stack, seed, members, &angles, accuracy));
    let colours = colours.map_err(input)?;
    let triples = |of: fn(&thinfilm::colour::StackColour) -> [f64; 3]| {
        array(py, &[angles.len(), 3], colours.iter().flat_map(of).collect())
    };
    let numbers = |of: fn(&thinfilm::colour::StackColour) -> f64| {
        array(py, &[angles.len()], colours.iter().map(of).collect())
    };
    Ok((
        [triples(|colour| colour.xyz)?, triples(|colour| colour.linear_srgb)?, triples(|colour| colour.lab)?],
        [numbers(|colour| colour.change)?, numbers(|colour| colour.ensemble_error.unwrap_or(f64::NAN))?],
    ))
}
