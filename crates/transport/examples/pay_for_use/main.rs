//! Does the walk pay for effects that are off? Walks paths by the library's kernel, or by one written without any effect.
//!
//! `pay_for_use --kernel walk|lean --dim 2|3 --paths N [--effect absorption|visible|explicit|polarisation|sheets|f64, several by +] [--level portable|avx2]`
//! walks, and prints the crossings; `tools/pay_for_use.py` counts the instructions. The lean kernel is written for the plane and no
//! effect. `pay_for_use --compare` says whether it gives the library's exits, bit by bit: exit code 3 if not.

#![allow(clippy::print_stdout)] // Its line of output is what it is for.

mod lean;

use std::error::Error;
use std::process::ExitCode;

use lean::Lean;
use transport::walk::lanes::{Precision, SimdLevel, Walker};
use transport::walk::{Exit, Fate};
use transport::{Geometry, Light, Normals, Sheets, Transport};

const THETA_I: f64 = std::f64::consts::FRAC_PI_6;
const SEED: u64 = 1;

struct Options {
    lean: bool,
    plane: bool,
    paths: u64,
    effects: Option<String>,
    level: SimdLevel,
}

impl Options {
    /// The plane with all effects off. AVX2 where there is one: callgrind knows no AVX-512.
    fn new(paths: u64, lean: bool) -> Self {
        let level = if SimdLevel::Avx2.is_supported() { SimdLevel::Avx2 } else { SimdLevel::Portable };
        Self { lean, plane: true, paths, effects: None, level }
    }

    fn from_arguments() -> Result<Self, Box<dyn Error>> {
        let mut options = Self::new(10_000, false);
        let mut arguments = std::env::args().skip(1);
        while let Some(name) = arguments.next() {
            let value = arguments.next().ok_or(format!("{name} needs a value"))?;
            match name.as_str() {
                "--kernel" => options.lean = value == "lean",
                "--dim" => options.plane = value == "2",
                "--paths" => options.paths = value.parse()?,
                "--effect" => options.effects = Some(value),
                "--level" => {
                    options.level =
                        SimdLevel::ALL.into_iter().find(|l| l.to_string() == value).ok_or("no such level")?;
                }
                _ => return Err(format!("unknown option {name}").into()),
            }
        }
        Ok(options)
    }
}

/// The paper's pearl with more effects, `+` between them.
fn problem(effects: Option<&str>) -> Result<(Transport, Precision), Box<dyn Error>> {
    let mut transport = Transport::paper();
    let mut precision = Precision::F32;
    let mut absorbs = false;
    for effect in effects.into_iter().flat_map(|list| list.split('+')) {
        match effect {
            "absorption" => absorbs = true,
            "visible" => transport.facets.normals = Normals::Visible,
            "explicit" => transport.indices[250] = 1.44,
            "polarisation" => transport.light = Light::Tracked,
            "f64" => precision = Precision::F64,
            "sheets" => {
                let phase = std::f64::consts::TAU * 25.0 / 550.0;
                transport = Transport {
                    indices: [&[1.0][..], &[1.53; 251]].concat(),
                    optical_depths: vec![0.0; 250],
                    sheets: Some(Sheets { index: 1.43, phase, last: 250 }),
                    ..transport
                };
                precision = Precision::F64;
            }
            other => return Err(format!("unknown effect {other}").into()),
        }
    }
    if absorbs {
        transport.optical_depths.fill(1e-5);
    }
    Ok((transport, precision))
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn lean_avx2(kernel: &Lean, out: &mut [Exit]) -> u64 {
    lean::walk(kernel, THETA_I, SEED, out)
}

/// Walks by the kernel of this example, with the library's instruction set.
#[allow(unsafe_code)] // A call of a function compiled for an instruction set.
fn walked_lean(o: &Options, transport: &Transport, out: &mut [Exit]) -> Result<u64, Box<dyn Error>> {
    if !o.plane || o.effects.is_some() {
        return Err("the lean kernel is written for the plane and no effect".into());
    }
    let kernel = Lean::new(transport);
    match o.level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if SimdLevel::Avx2.is_supported() => {
            // SAFETY: the processor has both features: asked in the line above.
            Ok(unsafe { lean_avx2(&kernel, out) })
        }
        SimdLevel::Portable => Ok(lean::walk(&kernel, THETA_I, SEED, out)),
        other => Err(format!("the lean kernel is not compiled for {other}").into()),
    }
}

fn walked(o: &Options) -> Result<(u64, Vec<Exit>), Box<dyn Error>> {
    let (transport, precision) = problem(o.effects.as_deref())?;
    let nothing = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
    let mut out = vec![nothing; o.paths as usize];
    let crossings = if o.lean {
        walked_lean(o, &transport, &mut out)?
    } else {
        let geometry = if o.plane { Geometry::Plane } else { Geometry::Space };
        let walker = Walker::new(&transport, geometry, precision, Some(o.level))?;
        walker.run(THETA_I, SEED, 0..o.paths, u32::MAX, &mut out)
    };
    Ok((crossings, out))
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    if std::env::args().nth(1).is_some_and(|first| first == "--compare") {
        let same = walked(&Options::new(5000, false))? == walked(&Options::new(5000, true))?;
        println!("plane, no effect: {}", if same { "same bits" } else { "they differ" });
        return Ok(if same { ExitCode::SUCCESS } else { ExitCode::from(3) });
    }
    let options = Options::from_arguments()?;
    let (crossings, _) = walked(&options)?;
    println!("{}", serde_json::json!({ "crossings": crossings, "level": options.level.to_string() }));
    Ok(ExitCode::SUCCESS)
}
