//! The kernels: what a sweep is compiled for, and which sweeps there are.

use super::draws::Normal;
use super::drive::{Draws, Lanes};
use super::event::Problem;
use super::real::Real;
use super::simd::SimdLevel;

/// The geometry of a walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    Space,
    /// Tilts are halved so many times before their sine is taken: see [`tilt_sin_cos`](super::draws::tilt_sin_cos).
    Plane {
        halvings: u8,
    },
}

/// Small tilts, without halvings: σ up to 2.3°.
pub(crate) const SMALL: Shape = Shape::Plane { halvings: 0 };
/// σ up to 9.2°.
pub(crate) const MIDDLE: Shape = Shape::Plane { halvings: 2 };
/// σ up to 74°.
pub(crate) const WIDE: Shape = Shape::Plane { halvings: 5 };

/// How the layers repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layers {
    /// Two layers alternate, and the substrate continues them.
    Periodic,
    /// Two layers alternate above any substrate.
    Alternating,
    /// All layers are alike, above any substrate: those between coherent sheets.
    Uniform,
    /// Any list of layers: looked up.
    Explicit,
}

/// Everything that a kernel is compiled for. What is chosen here costs a crossing nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Modes {
    /// Light is s or p all the way (plane only); else unpolarised at every event.
    pub(crate) tracked: bool,
    /// Inner interfaces are coherent sheets.
    pub(crate) sheets: bool,
    pub(crate) shape: Shape,
    pub(crate) layers: Layers,
    /// Facets are weighted by their projected area.
    pub(crate) visible: bool,
    /// Some layer absorbs.
    pub(crate) absorbs: bool,
    /// Some index is complex: faces are looked up, and absorb in total reflection.
    pub(crate) complex: bool,
}

impl Modes {
    pub(crate) const fn is_space(self) -> bool {
        matches!(self.shape, Shape::Space)
    }

    pub(crate) const fn is_explicit(self) -> bool {
        matches!(self.layers, Layers::Explicit)
    }
}

/// A kernel: its floating-point type and its modes, known when it is compiled.
pub(crate) trait Kernel {
    type Real: Real;
    const MODES: Modes;
}

/// Moves every path of the first lanes on by one event (two in the plane); the blocks of lanes in which a path ended: see
/// [`Lanes::ended`].
pub(crate) type Sweep<R> = fn(&mut Lanes<R>, &Problem<R>, usize) -> u32;

/// Returns the sweep of the modes looked for, if they are in the product of the lists.
macro_rules! find {
    ($what:tt $(tracked $tracked:literal, sheets $sheets:literal, complex $complex:literal: $shapes:tt $layers:tt $absorbs:tt;)*) => {
        $( find!(@shapes $what [$tracked, $sheets, $complex] $shapes $layers $absorbs); )*
    };
    (@shapes $what:tt $light:tt [$($shape:expr),*] $layers:tt $absorbs:tt) => {
        $( find!(@layers $what $light ($shape) $layers $absorbs); )*
    };
    (@layers $what:tt $light:tt $shape:tt [$($layers:ident),*] $absorbs:tt) => {
        $( find!(@switches $what $light $shape $layers $absorbs); )*
    };
    (@switches $what:tt $light:tt $shape:tt $layers:ident [$($absorbs:literal),*]) => {
        $(
            find!(@kernel $what $light $shape $layers $absorbs false);
            find!(@kernel $what $light $shape $layers $absorbs true);
        )*
    };
    (@kernel ($modes:ident, $real:ty, $compiled:ident($level:ident))
     [$tracked:literal, $sheets:literal, $complex:literal] $shape:tt $layers:ident $absorbs:literal $visible:literal) => {{
        const MODES: Modes = Modes {
            tracked: $tracked,
            sheets: $sheets,
            shape: $shape,
            layers: Layers::$layers,
            visible: $visible,
            absorbs: $absorbs,
            complex: $complex,
        };
        if $modes == MODES {
            struct Found;
            impl Kernel for Found {
                type Real = $real;
                const MODES: Modes = MODES;
            }
            return Some($compiled::<Found>($level));
        }
    }};
}

/// All 32-bit kernels that a recipe can ask for: small slopes have kernels of their own.
macro_rules! find_narrow {
    ($what:tt $layers:tt $absorbs:tt) => {
        find! { $what
            tracked false, sheets false, complex false: [Shape::Space, SMALL, MIDDLE, WIDE] $layers $absorbs;
            tracked true, sheets false, complex false: [SMALL, MIDDLE, WIDE] $layers $absorbs;
        }
    };
}

/// All 64-bit kernels that a recipe can ask for: all layers between coherent sheets are alike.
macro_rules! find_wide {
    ($what:tt $layers:tt $absorbs:tt) => {
        find! { $what
            tracked false, sheets false, complex false: [Shape::Space, WIDE] $layers $absorbs;
            tracked true, sheets false, complex false: [WIDE] $layers $absorbs;
            tracked false, sheets true, complex false: [Shape::Space, WIDE] [Uniform] $absorbs;
            tracked true, sheets true, complex false: [WIDE] [Uniform] $absorbs;
            tracked false, sheets false, complex true: [Shape::Space, WIDE] [Explicit] [true];
            tracked true, sheets false, complex true: [WIDE] [Explicit] [true];
            tracked false, sheets true, complex true: [Shape::Space, WIDE] [Explicit] [true];
            tracked true, sheets true, complex true: [WIDE] [Explicit] [true];
        }
    };
}

/// Whether the portable level computes fused multiply-adds in steps. That takes most of its time, so that fewer kernels
/// do: layers are looked up, and absorption is always added up.
const FEW_PORTABLE: bool = cfg!(target_arch = "x86_64");

/// The modes of the kernel that walks as `modes` ask at a level.
pub(crate) fn shared(modes: Modes, level: SimdLevel) -> Modes {
    if !FEW_PORTABLE || level != SimdLevel::Portable {
        return modes;
    }
    let layers = if modes.sheets { modes.layers } else { Layers::Explicit };
    Modes { layers, absorbs: true, ..modes }
}

/// The sweep in 32 bits; `None` where no recipe can ask for its modes.
#[cfg(target_arch = "x86_64")]
pub(crate) fn narrow(modes: Modes, level: SimdLevel) -> Option<Sweep<f32>> {
    if level == SimdLevel::Portable {
        find_narrow! { (modes, f32, portable(level)) [Explicit] [true] }
    } else {
        find_narrow! { (modes, f32, vector(level)) [Periodic, Alternating, Explicit] [false, true] }
    }
    None
}

/// The sweep in 64 bits; `None` where no recipe can ask for its modes.
#[cfg(target_arch = "x86_64")]
pub(crate) fn wide(modes: Modes, level: SimdLevel) -> Option<Sweep<f64>> {
    if level == SimdLevel::Portable {
        find_wide! { (modes, f64, portable(level)) [Explicit] [true] }
    } else {
        find_wide! { (modes, f64, vector(level)) [Periodic, Alternating, Explicit] [false, true] }
    }
    None
}

/// The sweep in 32 bits; `None` where no recipe can ask for its modes.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn narrow(modes: Modes, level: SimdLevel) -> Option<Sweep<f32>> {
    find_narrow! { (modes, f32, portable(level)) [Periodic, Alternating, Explicit] [false, true] }
    None
}

/// The sweep in 64 bits; `None` where no recipe can ask for its modes.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn wide(modes: Modes, level: SimdLevel) -> Option<Sweep<f64>> {
    find_wide! { (modes, f64, portable(level)) [Periodic, Alternating, Explicit] [false, true] }
    None
}

/// A kernel compiled for what the build's target guarantees.
fn portable<K: Kernel>(_: SimdLevel) -> Sweep<K::Real> {
    portable::sweep::<K>
}

/// A kernel compiled for AVX-512 or AVX2.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)] // Run-time dispatch makes the walk several times as fast as the build's own target allows.
fn vector<K: Kernel>(level: SimdLevel) -> Sweep<K::Real> {
    if level == SimdLevel::Avx512 {
        // SAFETY: `Walker::new` alone asks for sweeps, of levels that `is_supported` grants: it has asked the processor for
        // every feature that the function is compiled for.
        |lanes, problem, count| unsafe { avx512::sweep::<K>(lanes, problem, count) }
    } else {
        // SAFETY: as above.
        |lanes, problem, count| unsafe { avx2::sweep::<K>(lanes, problem, count) }
    }
}

/// Sweeps of a level. Only the events themselves know all modes: kernels share the rest.
macro_rules! level {
    ($name:ident, fused: $fused:expr $(, #[$features:meta])?) => {
        mod $name {
            use super::{Draws, Kernel, Lanes, Normal, Problem, Real};

            const FUSED: bool = $fused;

            $(#[$features])?
            pub(super) fn sweep<K: Kernel>(
                lanes: &mut Lanes<K::Real>,
                problem: &Problem<K::Real>,
                count: usize,
            ) -> u32 {
                let normal = &problem.constants.normal;
                match (K::MODES.is_space(), K::MODES.visible) {
                    (false, false) => draw::<false, false>(&mut lanes.draws, normal, count),
                    (false, true) => draw::<false, true>(&mut lanes.draws, normal, count),
                    (true, false) => draw::<true, false>(&mut lanes.draws, normal, count),
                    (true, true) => draw::<true, true>(&mut lanes.draws, normal, count),
                }
                let any = match (K::MODES.is_explicit(), K::MODES.is_space()) {
                    (false, true) => lanes.meet::<K, FUSED, 0, 1>(problem, count),
                    (false, false) => lanes.meet::<K, FUSED, 0, 2>(problem, count),
                    (true, true) => {
                        look_ahead::<K>(lanes, problem, count);
                        lanes.meet::<K, FUSED, 0, 1>(problem, count)
                    }
                    (true, false) => {
                        look_ahead::<K>(lanes, problem, count);
                        lanes.meet::<K, FUSED, 0, 1>(problem, count);
                        look_ahead::<K>(lanes, problem, count);
                        lanes.meet::<K, FUSED, 1, 2>(problem, count)
                    }
                };
                if any { ended(lanes, count) } else { 0 }
            }

            $(#[$features])?
            #[inline(never)]
            fn draw<const SPACE: bool, const VISIBLE: bool>(draws: &mut Draws, normal: &Normal, count: usize) {
                draws.draw::<SPACE, VISIBLE, FUSED>(*normal, count);
            }

            $(#[$features])?
            fn look_ahead<K: Kernel>(lanes: &mut Lanes<K::Real>, problem: &Problem<K::Real>, count: usize) {
                match (K::MODES.absorbs, K::MODES.complex) {
                    (_, true) => look_up::<_, true, true>(lanes, problem, count),
                    (true, false) => look_up::<_, true, false>(lanes, problem, count),
                    (false, false) => look_up::<_, false, false>(lanes, problem, count),
                }
            }

            $(#[$features])?
            #[inline(never)]
            fn look_up<R: Real, const ABSORBS: bool, const COMPLEX: bool>(
                lanes: &mut Lanes<R>,
                problem: &Problem<R>,
                count: usize,
            ) {
                lanes.look_ahead::<ABSORBS, COMPLEX>(problem, count);
            }

            $(#[$features])?
            #[inline(never)]
            fn ended<R: Real>(lanes: &Lanes<R>, count: usize) -> u32 {
                lanes.ended(count)
            }
        }
    };
}

level!(portable, fused: cfg!(any(target_feature = "fma", target_arch = "aarch64")));
#[cfg(target_arch = "x86_64")]
level!(avx2, fused: true, #[target_feature(enable = "avx2,fma")]);
#[cfg(target_arch = "x86_64")]
level!(avx512, fused: true, #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]);
