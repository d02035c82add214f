//! The production walk: many paths at once, in lanes that the compiler turns into SIMD vectors.
//!
//! See `docs/WALK.md` for the method. Everything here is made of operations that IEEE 754 rounds correctly, and a
//! path's numbers come from its own generator, so that the exits are the same bits for any instruction set, any
//! split of the path numbers, and any number of threads.

mod draws;
mod drive;
mod event;
mod kernel;
mod real;
mod simd;

use std::ops::Range;

use self::draws::{Normal, Stream, TILT_REACH};
use self::drive::Job;
use self::event::{CROSSING, ComplexFace, Constants, Film, Problem};
use self::kernel::{Layers, MIDDLE, Modes, SMALL, Shape, Sweep, WIDE};
use self::real::Real;
pub use self::simd::SimdLevel;
use super::Exit;
use crate::{Geometry, Light, Normals, Sheets, Transport};

/// The floating-point type that geometry is computed in. Random numbers are the same in both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32 bits where that is harmless, else 64: see [`Precision::resolve`].
    Auto,
    /// 32 bits.
    F32,
    /// 64 bits: half as fast.
    F64,
}

/// Slope deviation below which 32-bit directions are too coarse (radians): rounding moves a ray by about 10⁻⁷ an
/// event, some 10⁻⁶ over a walk, which must stay far below σ.
const F32_SLOPE_MIN: f64 = 3.5e-4;
/// Index contrast |n1/n2 − 1| below which 32-bit cosines are too coarse: their difference carries r_s, with a
/// relative rounding of about 10⁻⁷ over the contrast.
const F32_CONTRAST_MIN: f64 = 1e-3;

impl Precision {
    /// F32 or F64 for a stack: F64 if 0.02° > σ, if an interface has an index contrast in (0, 10⁻³) or if an index is complex.
    #[must_use]
    pub fn resolve(self, transport: &Transport) -> Self {
        if self != Self::Auto {
            return self;
        }
        let faint = |pair: &[f64]| pair[0] != pair[1] && (pair[0] / pair[1] - 1.0).abs() < F32_CONTRAST_MIN;
        let fine = transport.facets.slope_sd < F32_SLOPE_MIN || transport.indices.windows(2).any(faint);
        if fine || transport.has_complex_faces() {
            return Self::F64;
        }
        Self::F32
    }
}

/// Why a stack cannot be walked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WalkError {
    /// The media and layers do not match.
    #[error(
        "{indices} indices for {layers} layers: there must be one for each, the ambient and the substrate"
    )]
    Media {
        /// How many indices there are.
        indices: usize,
        /// How many layers there are.
        layers: usize,
    },
    /// An index that is not a positive number.
    #[error("index of medium {medium} is {value}: it must be positive and finite")]
    Index {
        /// Which medium.
        medium: usize,
        /// Its index.
        value: f64,
    },
    /// An extinction coefficient that is negative or not a number.
    #[error("extinction coefficient of medium {medium} is {value}: it must be finite and not negative")]
    Extinction {
        /// Which medium.
        medium: usize,
        /// Its extinction coefficient.
        value: f64,
    },
    /// A negative or undefined optical depth.
    #[error("optical depth of layer {layer} is {value}: it must not be negative")]
    Depth {
        /// Which layer, from 1.
        layer: usize,
        /// Its optical depth.
        value: f64,
    },
    /// A slope deviation out of range.
    #[error("slope deviation is {0} rad: it must lie in [0, 0.96] (0 to 55 degrees)")]
    SlopeSd(f64),
    /// Tracked polarisation out of the plane of incidence.
    #[error("s and p are tracked in the plane of incidence only: in space they turn into each other")]
    TrackedInSpace,
    /// Sheets that are no thin films between media of one index.
    #[error("{0}")]
    Sheets(String),
    /// An instruction set that this processor lacks.
    #[error("this processor has no {0}")]
    Simd(SimdLevel),
}

/// Largest slope deviation (radians): the tilts drawn must stay within the reach of their sine and cosine.
const SLOPE_SD_MAX: f64 = 0.96;

/// A stack made ready to be walked.
#[derive(Clone, Debug)]
pub struct Walker {
    prepared: Prepared,
    light: Light,
    absorbs: bool,
    level: SimdLevel,
}

#[derive(Clone, Debug)]
enum Prepared {
    F32(Problem<f32>, Sweep<f32>),
    F64(Problem<f64>, Sweep<f64>),
}

impl Walker {
    /// Prepares a stack. `level` forces an instruction set; `None` takes the best of this processor.
    ///
    /// # Errors
    /// Values out of range, or an instruction set that the processor lacks.
    pub fn new(
        transport: &Transport,
        geometry: Geometry,
        precision: Precision,
        level: Option<SimdLevel>,
    ) -> Result<Self, WalkError> {
        check(transport)?;
        Self::of_layers(transport, layers(transport), geometry, precision, level)
    }

    /// [`Self::new`] of values that are in range, by the kernels for a kind of layers.
    fn of_layers(
        transport: &Transport,
        layers: Layers,
        geometry: Geometry,
        precision: Precision,
        level: Option<SimdLevel>,
    ) -> Result<Self, WalkError> {
        let level = level.unwrap_or_else(SimdLevel::detect);
        if !level.is_supported() {
            return Err(WalkError::Simd(level));
        }
        if transport.light != Light::Unpolarised && geometry == Geometry::Space {
            return Err(WalkError::TrackedInSpace);
        }
        let sheets = transport.sheets.is_some();
        let complex = transport.has_complex_faces();
        let precision = if sheets || complex { Precision::F64 } else { precision.resolve(transport) };
        let sd = transport.facets.slope_sd;
        let most = sd * Normal::MAX;
        let modes = Modes {
            tracked: transport.light != Light::Unpolarised,
            sheets,
            shape: match geometry {
                Geometry::Space => Shape::Space,
                Geometry::Plane if precision == Precision::F64 || most > 4.0 * TILT_REACH => WIDE,
                Geometry::Plane if most > TILT_REACH => MIDDLE,
                Geometry::Plane => SMALL,
            },
            layers: if complex { Layers::Explicit } else { layers },
            // A flat interface has one facet only.
            visible: transport.facets.normals == Normals::Visible && sd > 0.0,
            absorbs: transport.absorbs(),
            complex,
        };
        let modes = kernel::shared(modes, level);
        let prepared = match precision {
            Precision::F64 => kernel::wide(modes, level)
                .map(|sweep| Prepared::F64(Problem::new(transport, modes.layers, geometry), sweep)),
            _ => kernel::narrow(modes, level)
                .map(|sweep| Prepared::F32(Problem::new(transport, modes.layers, geometry), sweep)),
        };
        let unlike = || WalkError::Sheets("coherent sheets must lie in layers that are all alike".to_owned());
        let prepared = prepared.ok_or_else(unlike)?;
        Ok(Self { prepared, light: transport.light, absorbs: transport.absorbs(), level })
    }

    /// The precision in use: F32 or F64.
    #[must_use]
    pub fn precision(&self) -> Precision {
        match self.prepared {
            Prepared::F32(..) => Precision::F32,
            Prepared::F64(..) => Precision::F64,
        }
    }

    /// The instruction set in use.
    #[must_use]
    pub fn level(&self) -> SimdLevel {
        self.level
    }

    /// Walks the numbered `paths` of incidence `theta_i` (radians, 0 to π/2), writes their exits to `out` in path
    /// order, and returns the number of crossings (facets met) in all.
    ///
    /// A path that has not ended after `event_cap` crossings is [`Truncated`](super::Fate::Truncated). The exits
    /// depend on (stack, precision, `theta_i`, `seed`, path number, `event_cap`) alone. The last paths of a call run
    /// in lanes that empty, so calls of many thousand paths are cheapest.
    ///
    /// # Panics
    /// If `out` is not as long as `paths`.
    pub fn run(&self, theta_i: f64, seed: u64, paths: Range<u64>, event_cap: u32, out: &mut [Exit]) -> u64 {
        let count = usize::try_from(paths.end.saturating_sub(paths.start)).expect("paths fit in memory");
        assert_eq!(out.len(), count, "one exit a path");
        let theta_i = theta_i.clamp(0.0, std::f64::consts::FRAC_PI_2);
        let job = Job {
            sin_i: libm::sin(theta_i),
            cos_i: libm::cos(theta_i),
            stream: Stream::new(seed, theta_i),
            paths,
            event_cap: event_cap.clamp(1, u32::MAX / CROSSING - 1),
            light: self.light,
            absorbs: self.absorbs,
        };
        match &self.prepared {
            Prepared::F32(problem, sweep) => drive::walk(problem, *sweep, &job, out),
            Prepared::F64(problem, sweep) => drive::walk(problem, *sweep, &job, out),
        }
    }
}

fn check(transport: &Transport) -> Result<(), WalkError> {
    let (indices, layers) = (transport.indices.len(), transport.layers());
    if indices != layers + 2 || i32::try_from(indices).is_err() {
        return Err(WalkError::Media { indices, layers });
    }
    let bad_index = |n: &f64| !(n.is_finite() && *n > 0.0);
    if let Some(medium) = transport.indices.iter().position(bad_index) {
        return Err(WalkError::Index { medium, value: transport.indices[medium] });
    }
    if let Some(layer) = transport.optical_depths.iter().position(|depth| depth.is_nan() || *depth < 0.0) {
        return Err(WalkError::Depth { layer: layer + 1, value: transport.optical_depths[layer] });
    }
    if ![0, indices].contains(&transport.extinctions.len()) {
        return Err(WalkError::Media { indices: transport.extinctions.len(), layers });
    }
    let bad_extinction = |k: &f64| !(k.is_finite() && *k >= 0.0);
    if let Some(medium) = transport.extinctions.iter().position(bad_extinction) {
        return Err(WalkError::Extinction { medium, value: transport.extinctions[medium] });
    }
    if !(0.0..=SLOPE_SD_MAX).contains(&transport.facets.slope_sd) {
        return Err(WalkError::SlopeSd(transport.facets.slope_sd));
    }
    transport.sheets.as_ref().map_or(Ok(()), |sheets| check_sheets(transport, sheets))
}

fn check_sheets(transport: &Transport, sheets: &Sheets) -> Result<(), WalkError> {
    let Sheets { index, phase, last } = *sheets;
    let refuse = |problem: String| Err(WalkError::Sheets(problem));
    if !(index > 0.0 && index.is_finite() && phase >= 0.0 && index * phase <= std::f64::consts::FRAC_PI_2) {
        return refuse(format!(
            "coherent sheets of index {index} and 2πd/λ = {phase}: their optical thickness must be at most a quarter of a wave"
        ));
    }
    if last > transport.layers() {
        return refuse(format!("sheet {last} lies below the last interface {}", transport.layers()));
    }
    match (1..=last).find(|&i| transport.indices[i] != transport.indices[i + 1]) {
        Some(i) => refuse(format!(
            "coherent sheet {i} lies between indices {} and {}: they must be equal",
            transport.indices[i],
            transport.indices[i + 1]
        )),
        None => Ok(()),
    }
}

/// How the layers repeat.
fn layers(transport: &Transport) -> Layers {
    let repeat = |period: usize| {
        (1..=transport.layers()).skip(period).all(|layer| {
            transport.indices[layer] == transport.indices[layer - period]
                && transport.optical_depths[layer - 1] == transport.optical_depths[layer - 1 - period]
        })
    };
    match transport.layers() {
        _ if transport.sheets.is_some() && repeat(1) => Layers::Uniform,
        _ if transport.sheets.is_some() || !repeat(2) => Layers::Explicit,
        count if count >= 2 && transport.indices[count + 1] == transport.indices[count - 1] => {
            Layers::Periodic
        }
        _ => Layers::Alternating,
    }
}

impl<R: Real> Problem<R> {
    fn new(transport: &Transport, kind: Layers, geometry: Geometry) -> Self {
        let n = &transport.indices;
        let layers = transport.layers();
        let ratio = |from: usize, to: usize| R::from_f64(n[from] / n[to]);
        // With fewer than two layers no interface lies between layers.
        let inner = |from: usize, to: usize| if layers >= 2 { ratio(from, to) } else { R::ONE };
        let depth =
            |layer: usize| transport.optical_depths.get(layer - 1).map_or(R::ZERO, |&d| R::from_f64(d));
        let sd = transport.facets.slope_sd;
        let tilt_max = (6.5 * sd).min(80_f64.to_radians());
        let slope_max = match geometry {
            Geometry::Plane => tilt_max.tan(),
            Geometry::Space => Normal::MAX * sd,
        };
        let constants = Constants {
            last: layers as i32,
            odd: inner(1, 2),
            even: inner(2, 1),
            enter: ratio(0, 1),
            leave: ratio(1, 0),
            out: ratio(layers, layers + 1),
            back: ratio(layers + 1, layers),
            depth_odd: depth(1),
            depth_even: depth(2),
            normal: Normal::new(sd),
            slope_max: R::from_f64(slope_max),
            tilt_max: tilt_max as f32,
            film: film(transport),
        };
        if kind != Layers::Explicit {
            return Self { constants, ratios: Vec::new(), depths: Vec::new(), faces: Vec::new() };
        }
        let ratios = (0..=layers).flat_map(|upper| [ratio(upper, upper + 1), ratio(upper + 1, upper)]);
        let depths = (0..layers + 2).map(|medium| if medium == 0 { R::ZERO } else { depth(medium) });
        let complex = transport.has_complex_faces();
        let face = |from: usize, to: usize| {
            let (first, second) = (transport.index(from), transport.index(to));
            let unit = first.re * first.re;
            let contrast = (second - first) * (second + first) / unit;
            ComplexFace {
                kappa: R::from_f64(first.im / first.re),
                contrast: [R::from_f64(contrast.re), R::from_f64(contrast.im)],
                below: R::from_f64(2.0 * second.re * second.im / unit),
            }
        };
        let faces = (0..=layers).filter(|_| complex);
        let faces = faces.flat_map(|upper| [face(upper, upper + 1), face(upper + 1, upper)]);
        Self { constants, ratios: ratios.collect(), depths: depths.collect(), faces: faces.collect() }
    }
}

fn film<R: Real>(transport: &Transport) -> Film<R> {
    let number = R::from_f64;
    let Some(Sheets { index, phase, last }) = transport.sheets else {
        return Film { last: 0, outer: R::ONE, inner: R::ONE, phase2: R::ZERO };
    };
    let outer = transport.indices[1];
    Film {
        last: last as i32,
        outer: number(outer * outer),
        inner: number(index * index),
        phase2: number(phase * phase),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walk::Fate;

    /// Exits of a stack whose layers repeat, by its own kernel and by the one that looks every layer up.
    fn exits(transport: &Transport, geometry: Geometry, precision: Precision) -> [(u64, Vec<Exit>); 2] {
        let own = layers(transport);
        assert_ne!(own, Layers::Explicit);
        [own, Layers::Explicit].map(|layers| {
            let walker = Walker::of_layers(transport, layers, geometry, precision, None).unwrap();
            let mut out = vec![Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated }; 500];
            (walker.run(0.7, 5, 0..500, 100_000, &mut out), out)
        })
    }

    #[test]
    fn layers_that_repeat_walk_as_when_looked_up_one_by_one() {
        let stacks = [
            Transport::alternating(40, 1.53, 1.43, 1.53, 0.03),
            Transport::alternating(41, 1.53, 1.43, 1.6, 0.1),
            Transport::alternating(40, 1.53, 1.43, 1.6, 0.3),
        ];
        let geometries = [(Geometry::Plane, Light::Unpolarised), (Geometry::Plane, Light::Tracked)];
        for (geometry, light) in geometries.into_iter().chain([(Geometry::Space, Light::Unpolarised)]) {
            for (stack, effects) in
                stacks.iter().flat_map(|stack| (0..8).map(move |effects| (stack, effects)))
            {
                let mut transport = Transport { light, ..stack.clone() };
                if effects & 1 != 0 {
                    transport.facets.normals = Normals::Visible;
                }
                if effects & 2 != 0 {
                    transport.optical_depths = (0..stack.layers()).map(|i| [0.02, 0.05][i % 2]).collect();
                }
                let precision = if effects & 4 != 0 { Precision::F64 } else { Precision::F32 };
                let [repeating, looked_up] = exits(&transport, geometry, precision);
                assert!(repeating == looked_up, "{geometry:?}, {precision:?}, {transport:?}");
            }
        }
    }
}
