//! Does the walk pay for effects that are off? Walks paths by the library's kernel or by one written without those effects.
//!
//! `pay_for_use --kernel walk|lean --dim 2|3 --paths N [--effect absorption|visible|explicit|polarisation|sheets|f64, several by +] [--level portable|avx2]`
//! walks, and prints the crossings; `tools/pay_for_use.py` counts the instructions. Lean kernels are written for no effect, and for each
//! of absorption, visible and polarisation (plane) alone. `pay_for_use --compare` says whether each of them gives the exits of the
//! library's, bit by bit: exit code 3 if not.

#![allow(clippy::print_stdout)] // Its line of output is what it is for.

mod draws;
mod lanes;
mod plane;
mod space;
mod stack;

use std::error::Error;
use std::process::ExitCode;

use lanes::Kernel;
use transport::walk::lanes::{Precision, SimdLevel, Walker};
use transport::walk::{Exit, Fate};
use transport::{Geometry, Light, Normals, Sheets, Transport};

const THETA_I: f64 = std::f64::consts::FRAC_PI_6;
const SEED: u64 = 1;

struct Options {
    lean: bool,
    plane: bool,
    paths: u64,
    effect: Option<String>,
    level: SimdLevel,
}

/// AVX2 where there is one: callgrind knows no AVX-512.
fn best() -> SimdLevel {
    if SimdLevel::Avx2.is_supported() { SimdLevel::Avx2 } else { SimdLevel::Portable }
}

fn options() -> Result<Options, Box<dyn Error>> {
    let mut options = Options { lean: false, plane: true, paths: 10_000, effect: None, level: best() };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or(format!("{name} needs a value"))?;
        match name.as_str() {
            "--kernel" => options.lean = value == "lean",
            "--dim" => options.plane = value == "2",
            "--paths" => options.paths = value.parse()?,
            "--effect" => options.effect = Some(value),
            "--level" => {
                options.level =
                    SimdLevel::ALL.into_iter().find(|l| l.to_string() == value).ok_or("no such level")?;
            }
            _ => return Err(format!("unknown option {name}").into()),
        }
    }
    Ok(options)
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

/// What the kernels of this example can do: effects by geometry, plane first.
const LEAN: [(bool, &[Option<&str>]); 2] = [
    (true, &[None, Some("absorption"), Some("visible"), Some("polarisation")]),
    (false, &[None, Some("absorption"), Some("visible")]),
];

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn lean_avx2<K: Kernel<N, M>, const N: usize, const M: usize>(
    kernel: &K,
    paths: u64,
    out: &mut [Exit],
) -> u64 {
    lanes::walk(kernel, THETA_I, SEED, 0..paths, out)
}

/// Walks by a kernel, with the library's instruction set.
#[allow(unsafe_code)] // A call of a function compiled for an instruction set.
fn lean<K: Kernel<N, M>, const N: usize, const M: usize>(
    o: &Options,
    kernel: &K,
    out: &mut [Exit],
) -> Result<u64, Box<dyn Error>> {
    match o.level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if SimdLevel::Avx2.is_supported() => {
            // SAFETY: the processor has both features: asked in the line above.
            Ok(unsafe { lean_avx2(kernel, o.paths, out) })
        }
        SimdLevel::Portable => Ok(lanes::walk(kernel, THETA_I, SEED, 0..o.paths, out)),
        other => Err(format!("the kernels of this example are not compiled for {other}").into()),
    }
}

/// Walks by the kernels of this example.
fn walked_lean(o: &Options, transport: &Transport, out: &mut [Exit]) -> Result<u64, Box<dyn Error>> {
    match (o.plane, o.effect.as_deref()) {
        (true, None) => lean(o, &plane::Plain::new(transport), out),
        (true, Some("absorption")) => lean(o, &plane::Absorbing::new(transport), out),
        (true, Some("visible")) => lean(o, &plane::Visible::new(transport), out),
        (true, Some("polarisation")) => lean(o, &plane::Polarised::new(transport), out),
        (false, None) => lean(o, &space::Plain::new(transport), out),
        (false, Some("absorption")) => lean(o, &space::Absorbing::new(transport), out),
        (false, Some("visible")) => lean(o, &space::Visible::new(transport), out),
        (_, Some(effect)) => Err(format!("no kernel is written for {effect} alone").into()),
    }
}

fn walked(o: &Options) -> Result<(u64, Vec<Exit>), Box<dyn Error>> {
    let (transport, precision) = problem(o.effect.as_deref())?;
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

/// Whether every kernel of this example gives the library's exits.
fn same() -> Result<bool, Box<dyn Error>> {
    let mut all = true;
    for (plane, effects) in LEAN {
        for effect in effects {
            let effect = effect.map(str::to_owned);
            let options = |lean| Options { lean, plane, paths: 5000, effect: effect.clone(), level: best() };
            let ((a, exits), (b, others)) = (walked(&options(false))?, walked(&options(true))?);
            let same = a == b && exits == others;
            println!(
                "{}, {}: {}",
                if plane { "plane" } else { "space" },
                effect.as_deref().unwrap_or("no effect"),
                if same { "same bits" } else { "they differ" }
            );
            all &= same;
        }
    }
    Ok(all)
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    if std::env::args().nth(1).is_some_and(|first| first == "--compare") {
        return Ok(if same()? { ExitCode::SUCCESS } else { ExitCode::from(3) });
    }
    let options = options()?;
    let (crossings, _) = walked(&options)?;
    println!("{}", serde_json::json!({ "crossings": crossings, "level": options.level.to_string() }));
    Ok(ExitCode::SUCCESS)
}
