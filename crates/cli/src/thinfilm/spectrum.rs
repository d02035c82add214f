//! `thinfilm spectrum`: R, T and A over wavelengths and angles.

use bake_brdf::recipe::Recipe;
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::path::PathBuf;
use terminal::{Outcome, Stop};
use thinfilm::ensemble::{self, Members};
use thinfilm::line::{self, Line, Shape};
use thinfilm::{Incidence, Polarisation, Stack, StackError, intensity};

use crate::input;

/// Arguments of `thinfilm spectrum`.
#[derive(Args, Debug)]
pub(crate) struct SpectrumArgs {
    /// Recipe: a file (JSON, - for stdin) or the name of a built-in one, such as akoya. Waves go through its mean thicknesses unless --members or --accuracy calls for an ensemble.
    recipe: PathBuf,
    /// Angles of incidence in degrees: numbers and FROM:TO:STEP, separated by commas.
    #[arg(long, value_name = "LIST", default_value = "0")]
    angles_deg: String,
    /// Vacuum wavelengths in nm: from A to B in N samples, both ends included.
    #[arg(long, value_name = "A:B:N", default_value = "380:780:401")]
    wavelengths_nm: String,
    /// Polarisation: s, p or unpolarised.
    #[arg(long, value_enum, default_value = "u")]
    pol: Pol,
    /// Mean over N stacks drawn with the recipe's irregular thicknesses, with its standard error.
    #[arg(long, value_name = "N", conflicts_with_all = ["line_width_nm", "incoherent_above_nm"])]
    members: Option<u64>,
    /// Largest root mean square standard error of R in an ensemble (its size follows), or largest error of R and T in the mean over a
    /// line [default: 1e-5; lorentzian: 1e-4]. Whether it is reached is `converged` in the JSON.
    #[arg(long, value_name = "R", conflicts_with_all = ["members", "incoherent_above_nm"])]
    accuracy: Option<f64>,
    /// Seed of the drawn stacks.
    #[arg(long, default_value_t = 1, conflicts_with_all = ["line_width_nm", "incoherent_above_nm"])]
    seed: u64,
    /// Mean over a spectral line of this full width at half maximum in nm.
    #[arg(long, value_name = "NM")]
    line_width_nm: Option<f64>,
    /// Shape of the line.
    #[arg(long, value_enum, default_value = "gaussian", requires = "line_width_nm")]
    line_shape: LineShape,
    /// Layers thicker than this (nm) add intensities, not amplitudes.
    #[arg(long, value_name = "NM", conflicts_with = "line_width_nm")]
    incoherent_above_nm: Option<f64>,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Pol {
    S,
    P,
    U,
}

impl Pol {
    const fn name(self) -> &'static str {
        match self {
            Self::S => "s",
            Self::P => "p",
            Self::U => "u",
        }
    }

    fn of(self, value: impl Fn(Polarisation) -> Result<Rta, StackError>) -> Result<Rta, StackError> {
        match self {
            Self::S => value(Polarisation::S),
            Self::P => value(Polarisation::P),
            Self::U => Ok(Rta::mean(value(Polarisation::S)?, value(Polarisation::P)?)),
        }
    }
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum LineShape {
    Gaussian,
    Lorentzian,
}

/// Accuracy of a mean over a line by default. The tails of a Lorentzian take many waves.
const fn line_accuracy(shape: Shape) -> f64 {
    match shape {
        Shape::Gaussian => 1e-5,
        Shape::Lorentzian => 1e-4,
    }
}

/// Shares reflected, transmitted, absorbed.
#[derive(Clone, Copy, Debug)]
struct Rta {
    r: f64,
    t: f64,
    a: f64,
}

impl Rta {
    fn mean(s: Self, p: Self) -> Self {
        Self { r: 0.5 * (s.r + p.r), t: 0.5 * (s.t + p.t), a: 0.5 * (s.a + p.a) }
    }
}

/// Rows of angles, each over the wavelengths; `extra` goes into the JSON as it is, `warning` to the reader.
struct Table {
    rows: Vec<Vec<Rta>>,
    extra: Vec<(&'static str, Value)>,
    warning: Option<String>,
}

struct Grid<'a> {
    stack: &'a Stack,
    gain: bool,
    wavelengths: Vec<f64>,
    angles: Vec<f64>,
    pol: Pol,
}

pub(crate) fn spectrum(args: &SpectrumArgs, as_json: bool, quiet: bool) -> Outcome {
    let recipe = nacre_cli::read_recipe(&args.recipe)?;
    let wavelengths_nm = input::samples("--wavelengths-nm", "nm", &args.wavelengths_nm)?;
    let angles_deg = input::angles_deg(&args.angles_deg)?;
    check(args)?;
    let stack = recipe.film_stack();
    let grid = Grid {
        stack: &stack,
        gain: recipe.stack.gain,
        wavelengths: wavelengths_nm.iter().map(|nm| nm * 1e-9).collect(),
        angles: angles_deg.iter().map(|deg| deg.to_radians()).collect(),
        pol: args.pol,
    };
    let table =
        grid.table(args).map_err(|why| Stop::BadInput(format!("{}: {why}", args.recipe.display())))?;
    if let Some(warning) = table.warning.as_ref().filter(|_| !quiet) {
        crate::note(warning);
    }
    if as_json {
        return terminal::print_json(&to_json(&recipe, args.pol, &angles_deg, &wavelengths_nm, &table));
    }
    let mut text = "wavelength_nm,angle_deg,R,T,A\n".to_owned();
    for (i, nm) in wavelengths_nm.iter().enumerate() {
        for (angle, row) in angles_deg.iter().zip(&table.rows) {
            let Rta { r, t, a } = row[i];
            text.push_str(&format!("{nm},{angle},{r},{t},{a}\n"));
        }
    }
    terminal::print(&text)
}

fn check(args: &SpectrumArgs) -> Outcome {
    if let Some(members) = args.members {
        input::members(members)?;
    }
    let positive = |flag: &str, value: Option<f64>, what: &str| match value {
        Some(x) if !(x.is_finite() && x > 0.0) => {
            Err(Stop::BadInput(format!("{flag}: {x} is not {what}; expected a finite number above 0")))
        }
        _ => Ok(()),
    };
    positive("--accuracy", args.accuracy, "an error of R")?;
    positive("--line-width-nm", args.line_width_nm, "a width in nm")?;
    positive("--incoherent-above-nm", args.incoherent_above_nm, "a thickness in nm")
}

impl Grid<'_> {
    fn table(&self, args: &SpectrumArgs) -> Result<Table, StackError> {
        if let Some(nm) = args.line_width_nm {
            let shape = match args.line_shape {
                LineShape::Gaussian => Shape::Gaussian,
                LineShape::Lorentzian => Shape::Lorentzian,
            };
            let accuracy = args.accuracy.unwrap_or_else(|| line_accuracy(shape));
            return self.over_a_line(Line { shape, width: nm * 1e-9 }, accuracy);
        }
        if let Some(nm) = args.incoherent_above_nm {
            return self.mixed(nm * 1e-9);
        }
        let members = args.members.map(Members::Count).or(args.accuracy.map(Members::ToAccuracy));
        members.map_or_else(|| self.coherent(), |members| self.ensemble(args.seed, members))
    }

    fn coherent(&self) -> Result<Table, StackError> {
        self.by_wavelength(|wavelength| {
            let film = self.stack.at(wavelength)?;
            let one = |theta: &f64| {
                self.pol.of(|pol| {
                    let incidence = Incidence::Angle(*theta);
                    let response = if self.gain {
                        film.solve_with_gain(wavelength, incidence, pol)
                    } else {
                        film.solve(wavelength, incidence, pol)
                    }?;
                    Ok(Rta { r: response.reflectance, t: response.transmittance, a: response.absorptance })
                })
            };
            self.angles.iter().map(one).collect()
        })
    }

    fn mixed(&self, coherent_to: f64) -> Result<Table, StackError> {
        let thick = |layer: &thinfilm::StackLayer| layer.thickness > coherent_to;
        self.by_wavelength(|wavelength| {
            let one = |theta: &f64| {
                self.pol.of(|pol| {
                    let whole = intensity::mixed(self.stack, thick, wavelength, *theta, pol)?;
                    Ok(Rta { r: whole.reflectance, t: whole.transmittance, a: whole.absorptance })
                })
            };
            self.angles.iter().map(one).collect()
        })
    }

    /// From values at all angles, a wavelength (metres) at a time.
    fn by_wavelength(
        &self,
        column: impl Fn(f64) -> Result<Vec<Rta>, StackError> + Sync,
    ) -> Result<Table, StackError> {
        let columns: Vec<Vec<Rta>> =
            self.wavelengths.par_iter().map(|wavelength| column(*wavelength)).collect::<Result<_, _>>()?;
        let row = |angle: usize| columns.iter().map(|column| column[angle]).collect();
        let rows = (0..self.angles.len()).map(row).collect();
        Ok(Table { rows, extra: Vec::new(), warning: None })
    }

    fn ensemble(&self, seed: u64, members: Members) -> Result<Table, StackError> {
        let polarisation = match self.pol {
            Pol::S => Some(Polarisation::S),
            Pol::P => Some(Polarisation::P),
            Pol::U => None,
        };
        let mean =
            ensemble::mean_of(self.stack, seed, members, &self.wavelengths, &self.angles, polarisation)?;
        let rows = rows(&mean.reflectance, &mean.transmittance, &mean.absorptance);
        let mut extra = vec![
            ("members", json!(mean.members)),
            ("seed", json!(seed)),
            ("R_std_error", json!(mean.reflectance_error)),
            ("T_std_error", json!(mean.transmittance_error)),
        ];
        if let Members::ToAccuracy(accuracy) = members {
            extra.extend([("accuracy", json!(accuracy)), ("converged", json!(mean.converged))]);
        }
        let warning = (!mean.converged).then(|| {
            format!("{} stacks, the most that are drawn, do not reach the accuracy asked for", mean.members)
        });
        Ok(Table { rows, extra, warning })
    }

    fn over_a_line(&self, line: Line, accuracy: f64) -> Result<Table, StackError> {
        let mean = line::mean(self.stack, line, &self.wavelengths, &self.angles, accuracy)?;
        let of = |pol: usize| rows(&mean.reflectance[pol], &mean.transmittance[pol], &mean.absorptance[pol]);
        let [s, p] = [of(0), of(1)];
        let rows = match self.pol {
            Pol::S => s,
            Pol::P => p,
            Pol::U => {
                let average = |(s, p): (Vec<Rta>, Vec<Rta>)| {
                    s.into_iter().zip(p).map(|(s, p)| Rta::mean(s, p)).collect()
                };
                s.into_iter().zip(p).map(average).collect()
            }
        };
        let shape = if line.shape == Shape::Gaussian { "gaussian" } else { "lorentzian" };
        let extra = vec![
            ("line", json!({ "shape": shape, "fwhm_nm": thinfilm::nanometres(line.width) })),
            ("accuracy", json!(accuracy)),
            ("error", json!(mean.error)),
            ("converged", json!(mean.error <= accuracy)),
        ];
        let reached =
            if mean.error.is_finite() { format!("{:.1e}", mean.error) } else { "unknown".to_owned() };
        let warning = (mean.error > accuracy).then(|| {
            format!(
                "the error of the mean over the line is {reached}, more than the accuracy of {accuracy:e}"
            )
        });
        Ok(Table { rows, extra, warning })
    }
}

fn rows(reflectance: &[Vec<f64>], transmittance: &[Vec<f64>], absorptance: &[Vec<f64>]) -> Vec<Vec<Rta>> {
    let row = |((r, t), a): ((&Vec<f64>, &Vec<f64>), &Vec<f64>)| {
        r.iter().zip(t).zip(a).map(|((&r, &t), &a)| Rta { r, t, a }).collect()
    };
    reflectance.iter().zip(transmittance).zip(absorptance).map(row).collect()
}

fn to_json(recipe: &Recipe, pol: Pol, angles_deg: &[f64], wavelengths_nm: &[f64], table: &Table) -> Value {
    // One array an angle, one number a wavelength.
    let by_angle = |of: fn(&Rta) -> f64| -> Vec<Vec<f64>> {
        table.rows.iter().map(|row| row.iter().map(of).collect()).collect()
    };
    let mut json = json!({
        "schema": "thinfilm-spectrum/1",
        "recipe": recipe.name,
        "pol": pol.name(),
        "angles_deg": angles_deg,
        "wavelengths_nm": wavelengths_nm,
        "R": by_angle(|x| x.r),
        "T": by_angle(|x| x.t),
        "A": by_angle(|x| x.a),
    });
    for (key, value) in &table.extra {
        json[*key] = value.clone();
    }
    json
}
