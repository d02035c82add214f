//! Amplitudes of one stack at one wavelength and angle, in a form that survives every case.
//!
//! The admittance vector (B, C) = (ψ, q-weighted derivative of ψ) is carried from the substrate up to the
//! ambient. One layer of phase δ = k₀·kz·d and attenuation b = Im δ multiplies it by
//!
//! ```text
//! e^b · | e^-b cos δ       −i e^-b sin δ / q |
//!       | −i e^-b q sin δ   e^-b cos δ       |
//! ```
//!
//! whose scaled entries never exceed 1 in size (times q); e^b goes into a binary exponent. sin δ/q and q sin δ are formed
//! from sin δ/δ, so that a layer at its own critical angle (q = 0) is nothing special. Runs of many periods are
//! doubled as scattering matrices (`crate::scattering`), O(log N).

use num_complex::Complex64;

use crate::material::nanometres;
use crate::precise::{Precise, PreciseComplex};
use crate::scaled::{Scaled, exp_parts, exponent_of, times_power_of_two};
use crate::scattering::Scattering;

/// Which of the two linear polarisations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Polarisation {
    /// E perpendicular to the plane of incidence (TE).
    S,
    /// E in the plane of incidence (TM).
    P,
}

/// Direction of the incident wave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Incidence {
    /// Angle from the normal in the ambient, radians, 0 to π/2.
    Angle(f64),
    /// In-plane wavenumber over k₀, kₓ = n₀ sin θ, from 0 to n₀.
    InPlane(f64),
}

/// A homogeneous layer at one wavelength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Complex index n + ik.
    pub index: Complex64,
    /// Thickness in metres.
    pub thickness: f64,
}

/// A unit of layers, from the ambient side down, that stands `repeat` times in a row.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// The layers of one period.
    pub unit: Vec<Layer>,
    /// How often the unit stands there; 0 means not at all.
    pub repeat: u64,
}

/// A stack at one wavelength: complex indices and thicknesses only.
#[derive(Clone, Debug, PartialEq)]
pub struct Multilayer {
    /// Complex index of the half space that the light comes from.
    pub ambient: Complex64,
    /// Runs of layers from the ambient side down.
    pub runs: Vec<Run>,
    /// Complex index of the half space behind the layers.
    pub substrate: Complex64,
}

/// What one wave does at a stack; signs and meanings as in the [crate's conventions](crate#conventions).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Amplitude reflectance r.
    pub r: Complex64,
    /// Amplitude transmittance t (ratio of E), 0 where it underflows.
    pub t: Complex64,
    /// ln |t|, also where t underflows.
    pub ln_abs_t: f64,
    /// Reflectance R.
    pub reflectance: f64,
    /// Transmittance T, 0 where it underflows.
    pub transmittance: f64,
    /// ln T, also where T underflows; −∞ where T is exactly 0.
    pub ln_transmittance: f64,
    /// 1 − R − T; exactly 0 for layers without absorption, negative only with gain (or in an absorbing ambient, where R and T do
    /// not add up). Where it is small, [`crate::field`] has its digits.
    pub absorptance: f64,
}

/// Why a wave has no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WaveError {
    /// The angle of incidence is outside 0 to 90°.
    #[error("the angle of incidence is {theta_deg} deg; it must lie between 0 and 90 deg")]
    Angle {
        /// Angle in degrees.
        theta_deg: f64,
    },
    /// The in-plane wavenumber is beyond grazing incidence.
    #[error("the in-plane wavenumber is {kx}; it must lie between 0 and the ambient index {ambient}")]
    InPlane {
        /// kₓ/k₀.
        kx: f64,
        /// Real index of the ambient.
        ambient: f64,
    },
    /// The wavelength is not a positive length.
    #[error("the wavelength is {wavelength_nm} nm; it must be positive and finite")]
    Wavelength {
        /// Wavelength in nm.
        wavelength_nm: f64,
    },
    /// An index is not usable.
    #[error("{medium} has the index {index}; n and k must be finite, n >= 0 and not both 0")]
    Index {
        /// Which medium.
        medium: String,
        /// The index.
        index: Complex64,
    },
    /// Negative k without permission.
    #[error("{medium} has k = {k}: a negative k is gain, which a stack has to allow; k >= 0 absorbs")]
    Gain {
        /// Which medium.
        medium: String,
        /// The extinction coefficient.
        k: f64,
    },
    /// A half-space that amplifies: it has no steady state, and no wave in it is the outgoing one.
    #[error("{medium} has k = {k}: only layers can amplify, a half-space needs k >= 0")]
    HalfSpaceGain {
        /// Which medium.
        medium: String,
        /// The extinction coefficient.
        k: f64,
    },
    /// Light that arrives through an absorbing ambient has no one in-plane wavenumber: it decays along the interface.
    #[error(
        "the ambient has k = {k}: light arrives through it, which away from normal incidence takes k = 0"
    )]
    AbsorbingAmbient {
        /// The extinction coefficient.
        k: f64,
    },
    /// A thickness is not a length.
    #[error("layer {layer} is {thickness_nm} nm thick; a thickness must be finite and not negative")]
    Thickness {
        /// Number of the layer in its run, from 1.
        layer: usize,
        /// Thickness in nm.
        thickness_nm: f64,
    },
    /// A layer holds so many wavelengths that f64 does not know its phase.
    #[error("layer {layer} has a phase of {phase:e} rad; beyond 1e15 rad f64 does not know it")]
    Phase {
        /// Number of the layer in its run, from 1.
        layer: usize,
        /// |δ|.
        phase: f64,
    },
    /// With gain: the stack lases, or the amplitude is beyond f64.
    #[error("the reflected amplitude is not finite: the stack is at its lasing threshold or beyond f64")]
    Unbounded,
    /// More layers than can be taken one by one.
    #[error("{layers} layers are too many to list one by one (at most {most})")]
    TooManyLayers {
        /// Number of layers.
        layers: u128,
        /// The limit.
        most: u64,
    },
    /// The stack has none of what the request needs.
    #[error("{0}")]
    Unsuitable(String),
}

impl Polarisation {
    /// Both, s first.
    pub const BOTH: [Self; 2] = [Self::S, Self::P];
}

/// What 1 − R − T can truly be, whatever rounding makes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PowerBalance {
    /// Nothing absorbs: 0.
    Lossless,
    /// Layers absorb, none amplifies: 0 or more.
    Absorbing,
    /// A layer amplifies, or the ambient absorbs, where R and T do not add up: any number.
    Any,
}

impl PowerBalance {
    pub(crate) fn of(ambient: Complex64, mut layers: impl Iterator<Item = Complex64> + Clone) -> Self {
        if ambient.im != 0.0 || layers.clone().any(|index| !has_real_eps(index) && index.im < 0.0) {
            Self::Any
        } else if layers.all(has_real_eps) {
            Self::Lossless
        } else {
            Self::Absorbing
        }
    }

    /// 1 − R − T.
    pub(crate) fn absorptance(self, reflectance: f64, transmittance: f64) -> f64 {
        match self {
            Self::Lossless => 0.0,
            Self::Absorbing => (1.0 - reflectance - transmittance).max(0.0),
            Self::Any => 1.0 - reflectance - transmittance,
        }
    }
}

/// √w on the branch Im ≥ 0, Re ≥ 0 where Im = 0, each component to full relative accuracy.
pub(crate) fn sqrt_upper(w: Complex64) -> Complex64 {
    if w.im == 0.0 {
        let root = w.re.abs().sqrt();
        return if w.re >= 0.0 { Complex64::new(root, 0.0) } else { Complex64::new(0.0, root) };
    }
    let size = w.re.abs().max(w.im.abs());
    let Some(exponent) = exponent_of(size) else {
        return if size == 0.0 { Complex64::new(0.0, 0.0) } else { w.sqrt() };
    };
    // Scaled by an even power of two, so that neither tiny nor huge w leaves the range of f64.
    let even = exponent & !1;
    let w = times_power_of_two(w, -even);
    let larger = ((w.norm() + w.re.abs()) / 2.0).sqrt();
    let smaller = w.im / (2.0 * larger);
    let root = if w.re >= 0.0 { Complex64::new(larger, smaller) } else { Complex64::new(smaller, larger) };
    let root = if root.im < 0.0 { -root } else { root };
    times_power_of_two(Complex64::new(root.re + 0.0, root.im + 0.0), even / 2)
}

/// |z|, the same bits as `norm`, whose library call costs as much as a layer and is needed only off the axes.
fn modulus(z: Complex64) -> f64 {
    if z.im == 0.0 {
        z.re.abs()
    } else if z.re == 0.0 {
        z.im.abs()
    } else {
        z.norm()
    }
}

/// The plane wave's in-plane part, in the two forms that lose no digits. kₓ is real.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InPlaneWave {
    /// kₓ/k₀.
    pub(crate) kx: f64,
    /// (N₀, N₀² cos²θ) beyond 45°: kz loses no digits towards grazing incidence. Up to 45°, from kₓ, it loses none where |N| is small.
    shallow: Option<(f64, f64)>,
}

impl InPlaneWave {
    pub(crate) fn new(ambient: Complex64, incidence: Incidence) -> Result<Self, WaveError> {
        match incidence {
            Incidence::Angle(theta) => {
                if !(0.0..=std::f64::consts::FRAC_PI_2).contains(&theta) {
                    return Err(WaveError::Angle { theta_deg: theta.to_degrees() });
                }
                if theta > 0.0 && ambient.im != 0.0 {
                    return Err(WaveError::AbsorbingAmbient { k: ambient.im });
                }
                let is_steep = theta <= std::f64::consts::FRAC_PI_4;
                let q = ambient.re * theta.cos();
                Ok(Self { kx: ambient.re * theta.sin(), shallow: (!is_steep).then_some((ambient.re, q * q)) })
            }
            Incidence::InPlane(kx) => {
                if !(0.0..=ambient.re).contains(&kx) {
                    return Err(WaveError::InPlane { kx, ambient: ambient.re });
                }
                Ok(Self { kx, shallow: None })
            }
        }
    }

    /// (kz/k₀)² in a medium.
    pub(crate) fn kz2(&self, index: Complex64) -> Complex64 {
        match self.shallow {
            Some((ambient, cos2)) => (index - ambient) * (index + ambient) + cos2,
            None => (index - self.kx) * (index + self.kx),
        }
    }

    /// Admittance q of the wave that goes down in a medium: away from the interface it decays or, where a layer amplifies and light
    /// travels in it, grows.
    pub(crate) fn admittance(&self, index: Complex64, polarisation: Polarisation) -> Complex64 {
        let kz2 = self.kz2(index);
        let kz = sqrt_upper(kz2);
        let is_backward = kz.re < 0.0 && kz2.re > 0.0;
        admittance_of(if is_backward { -kz } else { kz }, index * index, polarisation)
    }
}

/// Admittance q of a medium, given its kz/k₀ and N².
fn admittance_of(kz: Complex64, eps: Complex64, polarisation: Polarisation) -> Complex64 {
    match polarisation {
        Polarisation::S => kz,
        Polarisation::P => kz / eps,
    }
}

/// One layer's matrix without its growth: true entries are these · 2^exponent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LayerMatrix {
    pub(crate) cos: Complex64,
    pub(crate) sin_over_q: Complex64,
    pub(crate) q_sin: Complex64,
    pub(crate) exponent: i64,
    /// δ = k₀ kz d.
    pub(crate) delta: Phase,
    /// The admittance, rounded as everywhere.
    q: Complex64,
    /// What of the growth is not in the exponent.
    growth: f64,
}

impl LayerMatrix {
    pub(crate) fn new(wave: &InPlaneWave, layer: Layer, wavelength: f64, polarisation: Polarisation) -> Self {
        let k0 = std::f64::consts::TAU / wavelength;
        let k0_d = k0 * layer.thickness;
        let kz2 = wave.kz2(layer.index);
        let kz = sqrt_upper(kz2);
        let delta =
            Phase { half_turns: half_turns_per_metre(k0, kz.re) * layer.thickness, decay: kz.im * k0_d };
        let (cos, sinc) = cos_and_sinc(delta);
        let (growth, exponent) = exp_parts(delta.decay);
        let (cos, sinc) = (cos * growth, sinc * (growth * k0_d));
        let eps = layer.index * layer.index;
        let (sin_over_q, q_sin) = match polarisation {
            Polarisation::S => (sinc, kz2 * sinc),
            Polarisation::P => (eps * sinc, kz2 / eps * sinc),
        };
        let q = admittance_of(kz, eps, polarisation);
        Self { cos, sin_over_q, q_sin, exponent, delta, q, growth }
    }

    /// cos, sin/q and q sin with twice the digits that δ and q leave room for.
    pub(crate) fn precise(&self) -> [PreciseComplex; 3] {
        let Phase { half_turns, decay } = self.delta;
        // The thinnest layers and those at their own critical angle: there sin δ/q has no digits to gain from sin δ and q.
        if (half_turns * std::f64::consts::PI).abs().max(decay.abs()) < SMALL_PHASE {
            let [cos, sin_over_q, q_sin] = [self.cos, self.sin_over_q, self.q_sin].map(PreciseComplex::from);
            // But cos δ must fit them: a determinant off 1 by one rounding is a gain or loss in each of N periods. One step of Newton's.
            let one = PreciseComplex::from(Complex64::new(1.0, 0.0));
            let cos = cos + (one - cos * cos - sin_over_q * q_sin) / (cos + cos);
            return [cos, sin_over_q, q_sin];
        }
        let whole = half_turns.round_ties_even();
        let (sin, cos) = Precise::sin_cos_of_half_turns(half_turns - whole);
        let sign = if whole % 2.0 == 0.0 { self.growth } else { -self.growth };
        let less = Precise::from(sign * (-(-2.0 * decay).exp_m1() / 2.0)); // (1 − e^-2b)/2
        let more = Precise::from(sign) - less; //                             (1 + e^-2b)/2
        let cosine = PreciseComplex { re: cos * more, im: -(sin * less) };
        let sine = PreciseComplex { re: sin * more, im: cos * less };
        let q = PreciseComplex::from(self.q);
        [cosine, sine / q, sine * q]
    }
}

/// δ = π·half_turns + i·decay. Counted in half turns, the range reduction is exact, and the same here and in
/// [`crate::dense`]: a rounding that N equal layers share would show N times otherwise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Phase {
    pub(crate) half_turns: f64,
    pub(crate) decay: f64,
}

/// k₀ Re kz/π, rounded the same way everywhere.
pub(crate) fn half_turns_per_metre(k0: f64, kz_re: f64) -> f64 {
    k0 * kz_re * std::f64::consts::FRAC_1_PI
}

impl Phase {
    pub(crate) fn value(self) -> Complex64 {
        Complex64::new(self.half_turns * std::f64::consts::PI, self.decay)
    }

    /// (sin, cos) of the real part.
    pub(crate) fn sin_cos(self) -> (f64, f64) {
        let whole = self.half_turns.round_ties_even();
        let (sin, cos) = ((self.half_turns - whole) * std::f64::consts::PI).sin_cos();
        if whole % 2.0 == 0.0 { (sin, cos) } else { (-sin, -cos) }
    }
}

/// Below, four terms of the series of sin δ/δ leave 1e-19; above, sin δ loses no digits.
const SMALL_PHASE: f64 = 1e-2;

/// (e^-b cos δ, e^-b sin δ/δ), b = Im δ ≥ 0.
pub(crate) fn cos_and_sinc(phase: Phase) -> (Complex64, Complex64) {
    let delta = phase.value();
    let (a, b) = (delta.re, delta.im);
    let (sin, cos) = phase.sin_cos();
    if b == 0.0 && a.abs() >= SMALL_PHASE {
        return (Complex64::new(cos, 0.0), Complex64::new(sin / a, 0.0));
    }
    let less = -(-2.0 * b).exp_m1() / 2.0; // (1 − e^-2b)/2
    let more = 1.0 - less; //                  (1 + e^-2b)/2
    let cosine = Complex64::new(cos * more, -sin * less);
    let sinc = if a.abs().max(b.abs()) < SMALL_PHASE {
        let z = delta * delta;
        (1.0 - z / 6.0 * (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0)))) * (-b).exp()
    } else {
        Complex64::new(sin * more, cos * less) / delta
    };
    (cosine, sinc)
}

/// The admittance vector at a plane: ψ = b·2^exponent, and its partner c·2^exponent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Admittance {
    pub(crate) b: Complex64,
    pub(crate) c: Complex64,
    pub(crate) exponent: i64,
    /// The medium right below, while nothing but it has been met: there (B, C) is exactly proportional to (1, q), and a
    /// layer of that same index only adds phase.
    pristine: Option<Complex64>,
}

impl Admittance {
    /// The outgoing wave of unit ψ in the substrate.
    pub(crate) fn outgoing(substrate: Complex64, q: Complex64) -> Self {
        // In a medium that amplifies, δ is that of the other wave.
        let pristine = (substrate.im >= 0.0).then_some(substrate);
        Self { b: Complex64::new(1.0, 0.0), c: q, exponent: 0, pristine }
    }

    pub(crate) fn through(self, layer: Layer, matrix: &LayerMatrix) -> Self {
        if layer.thickness == 0.0 {
            return self;
        }
        if self.pristine == Some(layer.index) {
            let (growth, exponent) = exp_parts(matrix.delta.decay);
            let (sin, cos) = matrix.delta.sin_cos();
            let phase = Complex64::new(growth * cos, -growth * sin);
            return Self { b: self.b * phase, c: self.c * phase, exponent: self.exponent + exponent, ..self };
        }
        let i = Complex64::i();
        let b = matrix.cos * self.b - i * matrix.sin_over_q * self.c;
        let c = matrix.cos * self.c - i * matrix.q_sin * self.b;
        Self { b, c, exponent: self.exponent + matrix.exponent, pristine: None }.normalised()
    }

    /// r, for a wave that comes in a medium of admittance q₀; `None` at grazing incidence on a substrate equal to the ambient, where
    /// the wave meets nothing.
    pub(crate) fn reflected(&self, q_0: Complex64) -> Option<Complex64> {
        let denominator = q_0 * self.b + self.c;
        (denominator.norm() != 0.0).then(|| (q_0 * self.b - self.c) / denominator)
    }

    /// R = |r|², T = `flux`/|q₀B + C|² and ln T.
    pub(crate) fn powers(&self, q_0: Complex64, flux: f64, balance: PowerBalance) -> [f64; 3] {
        let denominator = q_0 * self.b + self.c;
        let reflected = ((q_0 * self.b - self.c) / denominator).norm_sqr();
        let inverse = Scaled::new(1.0 / denominator, -self.exponent);
        let power =
            Scaled::new(Complex64::new(flux * inverse.mantissa.norm_sqr(), 0.0), 2 * inverse.exponent);
        if balance == PowerBalance::Lossless {
            // Flux conservation says |q₀B + C|² = |q₀B − C|² + 4 q₀ Re q_sub. Dividing by the right-hand side keeps
            // R + T = 1 to the last digit, R where it is small and T where it is small.
            let whole = reflected + power.value().re;
            [reflected / whole, power.value().re / whole, power.ln_abs() - whole.ln()]
        } else {
            [reflected, power.value().re, power.ln_abs()]
        }
    }

    fn normalised(self) -> Self {
        let part = |z: Complex64| z.re.abs().max(z.im.abs());
        let Some(shift) = exponent_of(part(self.b).max(part(self.c))) else { return self };
        if shift.abs() < 64 {
            return self;
        }
        Self {
            b: times_power_of_two(self.b, -shift),
            c: times_power_of_two(self.c, -shift),
            exponent: self.exponent + shift,
            ..self
        }
    }

    /// Through a scattering matrix referred to the real admittance η on both sides.
    fn through_scattering(self, s: &Scattering) -> Self {
        let eta = s.reference;
        let below = self.b + self.c / eta; // 2 × downward amplitude
        let load = (self.b - self.c / eta) / below;
        let inner = 1.0 / (1.0 - s.r_back() * load);
        let t = s.t();
        let reflected = s.r() + t.mantissa * t.mantissa * times_power_of_two(load * inner, 2 * t.exponent);
        // Upwards the field grows by 1/t: keep it as an exponent.
        let scale = below / (2.0 * t.mantissa * inner);
        Self {
            b: (1.0 + reflected) * scale,
            c: (1.0 - reflected) * scale * eta,
            exponent: self.exponent - t.exponent,
            pristine: None,
        }
        .normalised()
    }
}

/// From this many repeats on, a run is doubled; below, taking the layers one by one is as fast.
const DOUBLING_FROM: u64 = 16;

/// A phase that f64 knows to 0.1 rad: beyond, an answer would be noise.
const LARGEST_PHASE: f64 = 1e15;

impl Multilayer {
    /// Number of layers, repeats counted.
    #[must_use]
    pub fn layer_count(&self) -> u128 {
        self.runs.iter().map(|run| run.unit.len() as u128 * u128::from(run.repeat)).sum()
    }

    /// The layers one by one, from the ambient side down.
    pub fn layers(&self) -> impl DoubleEndedIterator<Item = Layer> + '_ {
        self.runs.iter().flat_map(|run| (0..run.repeat).flat_map(move |_| run.unit.iter().copied()))
    }

    /// Whether no layer and not the ambient absorbs or amplifies.
    #[must_use]
    pub fn is_lossless(&self) -> bool {
        self.balance() == PowerBalance::Lossless
    }

    pub(crate) fn balance(&self) -> PowerBalance {
        let layers = self.runs.iter().filter(|run| run.repeat > 0).flat_map(|run| &run.unit);
        PowerBalance::of(self.ambient, layers.map(|layer| layer.index))
    }

    /// Response to a wave of one polarisation.
    ///
    /// # Errors
    /// Angle, wavelength, index or thickness out of range; an absorbing ambient away from normal incidence; negative k (of layers:
    /// use [`Multilayer::solve_with_gain`]).
    ///
    /// ```
    /// use num_complex::Complex64;
    /// use thinfilm::{Incidence, Layer, Multilayer, Polarisation, Run};
    /// let glass = Complex64::new(1.5, 0.0);
    /// let coating = Layer { index: Complex64::new(1.5f64.sqrt(), 0.0), thickness: 550e-9 / 4.0 / 1.5f64.sqrt() };
    /// let stack = Multilayer {
    ///     ambient: Complex64::new(1.0, 0.0),
    ///     runs: vec![Run { unit: vec![coating], repeat: 1 }],
    ///     substrate: glass,
    /// };
    /// let response = stack.solve(550e-9, Incidence::Angle(0.0), Polarisation::S)?;
    /// assert!(response.reflectance < 1e-30); // an ideal quarter-wave coating
    /// # Ok::<(), thinfilm::WaveError>(())
    /// ```
    pub fn solve(
        &self,
        wavelength: f64,
        incidence: Incidence,
        polarisation: Polarisation,
    ) -> Result<Response, WaveError> {
        self.check_absorbing()?;
        self.solve_with_gain(wavelength, incidence, polarisation)
    }

    /// As [`Multilayer::solve`], where the k of layers may be negative (gain). Above a lasing threshold, which no steady light
    /// reaches, this is still what Maxwell's equations say at one frequency.
    ///
    /// # Errors
    /// As [`Multilayer::solve`] except for gain; [`WaveError::Unbounded`] at a lasing threshold.
    pub fn solve_with_gain(
        &self,
        wavelength: f64,
        incidence: Incidence,
        polarisation: Polarisation,
    ) -> Result<Response, WaveError> {
        self.check(wavelength)?;
        let wave = InPlaneWave::new(self.ambient, incidence)?;
        self.check_phases(&wave, wavelength)?;
        let top = self.top_admittance(&wave, wavelength, polarisation);
        self.response(&wave, polarisation, top)
    }

    /// (B, C) at the first interface of the wave that leaves into the substrate.
    pub(crate) fn top_admittance(
        &self,
        wave: &InPlaneWave,
        wavelength: f64,
        polarisation: Polarisation,
    ) -> Admittance {
        let q_sub = wave.admittance(self.substrate, polarisation);
        let mut vector = Admittance::outgoing(self.substrate, q_sub);
        for run in self.runs.iter().rev() {
            vector = through_run(vector, run, wave, wavelength, polarisation);
        }
        vector
    }

    fn response(
        &self,
        wave: &InPlaneWave,
        polarisation: Polarisation,
        top: Admittance,
    ) -> Result<Response, WaveError> {
        let q_0 = wave.admittance(self.ambient, polarisation);
        let q_sub = wave.admittance(self.substrate, polarisation);
        let Some(r) = top.reflected(q_0) else {
            return Ok(Response::passed());
        };
        let t_psi = Scaled::new(2.0 * q_0 / (q_0 * top.b + top.c), -top.exponent);
        let t = match polarisation {
            Polarisation::S => t_psi,
            Polarisation::P => Scaled::new(t_psi.mantissa * self.ambient / self.substrate, t_psi.exponent),
        };
        // |t_ψ|² Re q_sub/Re q_0, without dividing by a vanishing Re q_0 where q_0 is real.
        let in_flux = if q_0.im == 0.0 { 4.0 * q_0.re } else { 4.0 * q_0.norm_sqr() / q_0.re };
        let balance = self.balance();
        let [reflectance, transmittance, ln_transmittance] = top.powers(q_0, in_flux * q_sub.re, balance);
        let response = Response {
            r,
            t: t.value(),
            ln_abs_t: t.ln_abs(),
            reflectance,
            transmittance,
            ln_transmittance,
            absorptance: balance.absorptance(reflectance, transmittance),
        };
        response.is_finite().then_some(response).ok_or(WaveError::Unbounded)
    }

    /// # Errors
    /// [`WaveError::Gain`] where the k of a layer is negative.
    pub(crate) fn check_absorbing(&self) -> Result<(), WaveError> {
        for (name, index) in self.media().skip(2) {
            if index.im < 0.0 {
                return Err(WaveError::Gain { medium: name.to_string(), k: index.im });
            }
        }
        Ok(())
    }

    pub(crate) fn check(&self, wavelength: f64) -> Result<(), WaveError> {
        check_wavelength(wavelength)?;
        for (name, index) in self.media() {
            // Squares must not leave f64: no material comes near these bounds.
            let size = modulus(index);
            if !(index.is_finite() && index.re >= 0.0 && (1e-60..1e60).contains(&size)) {
                return Err(WaveError::Index { medium: name.to_string(), index });
            }
        }
        check_half_spaces(self.ambient, self.substrate)?;
        let layers = self.runs.iter().flat_map(|run| run.unit.iter().enumerate());
        for (at, layer) in layers {
            if !(layer.thickness.is_finite() && layer.thickness >= 0.0) {
                return Err(WaveError::Thickness {
                    layer: at + 1,
                    thickness_nm: nanometres(layer.thickness),
                });
            }
        }
        Ok(())
    }

    pub(crate) fn check_phases(&self, wave: &InPlaneWave, wavelength: f64) -> Result<(), WaveError> {
        for run in &self.runs {
            for (at, layer) in run.unit.iter().enumerate() {
                let k0_d = std::f64::consts::TAU / wavelength * layer.thickness;
                let phase = modulus(sqrt_upper(wave.kz2(layer.index))) * k0_d;
                let total = phase * run.repeat as f64;
                if !(phase <= LARGEST_PHASE && k0_d <= LARGEST_PHASE && total <= LARGEST_PHASE * 1e3) {
                    return Err(WaveError::Phase { layer: at + 1, phase: phase.max(k0_d) });
                }
            }
        }
        Ok(())
    }

    fn media(&self) -> impl Iterator<Item = (MediumName, Complex64)> + '_ {
        let named = |(at, layer): (usize, &Layer)| (MediumName::Layer(at + 1), layer.index);
        [(MediumName::Ambient, self.ambient), (MediumName::Substrate, self.substrate)]
            .into_iter()
            .chain(self.runs.iter().flat_map(move |run| run.unit.iter().enumerate().map(named)))
    }
}

/// Refuses what is no length.
pub(crate) fn check_wavelength(wavelength: f64) -> Result<(), WaveError> {
    if wavelength.is_finite() && wavelength > 0.0 && (1.0 / wavelength).is_finite() {
        return Ok(());
    }
    Err(WaveError::Wavelength { wavelength_nm: nanometres(wavelength) })
}

/// # Errors
/// [`WaveError::HalfSpaceGain`].
pub(crate) fn check_half_spaces(ambient: Complex64, substrate: Complex64) -> Result<(), WaveError> {
    for (name, index) in [(MediumName::Ambient, ambient), (MediumName::Substrate, substrate)] {
        if index.im < 0.0 {
            return Err(WaveError::HalfSpaceGain { medium: name.to_string(), k: index.im });
        }
    }
    Ok(())
}

/// A medium as an error names it.
#[derive(Clone, Copy)]
enum MediumName {
    Ambient,
    Substrate,
    /// Number in its run, from 1.
    Layer(usize),
}

impl std::fmt::Display for MediumName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Ambient => f.write_str("the ambient"),
            Self::Substrate => f.write_str("the substrate"),
            Self::Layer(number) => write!(f, "layer {number}"),
        }
    }
}

fn through_run(
    vector: Admittance,
    run: &Run,
    wave: &InPlaneWave,
    wavelength: f64,
    polarisation: Polarisation,
) -> Admittance {
    let matrix = |layer: &Layer| LayerMatrix::new(wave, *layer, wavelength, polarisation);
    if run.repeat == 1 {
        return run.unit.iter().rev().fold(vector, |v, layer| v.through(*layer, &matrix(layer)));
    }
    let matrices: Vec<LayerMatrix> = run.unit.iter().map(matrix).collect();
    let only_substrate = run.unit.iter().all(|layer| vector.pristine == Some(layer.index));
    if run.repeat < DOUBLING_FROM || only_substrate {
        let once = |vector: Admittance| {
            run.unit.iter().zip(&matrices).rev().fold(vector, |v, (layer, matrix)| v.through(*layer, matrix))
        };
        // A run of the substrate's own material is one thick layer of it.
        if only_substrate && run.repeat >= DOUBLING_FROM {
            return run.unit.iter().rev().fold(vector, |v, layer| {
                let thick = Layer { thickness: layer.thickness * run.repeat as f64, ..*layer };
                v.through(thick, &matrix(&thick))
            });
        }
        return (0..run.repeat).fold(vector, |v, _| once(v));
    }
    match Scattering::of_run(&matrices, run.repeat) {
        Some(scattering) => vector.through_scattering(&scattering),
        None => vector,
    }
}

fn has_real_eps(index: Complex64) -> bool {
    index.im == 0.0 || index.re == 0.0
}

impl Response {
    fn passed() -> Self {
        let (zero, one) = (Complex64::new(0.0, 0.0), Complex64::new(1.0, 0.0));
        Self {
            r: zero,
            t: one,
            ln_abs_t: 0.0,
            reflectance: 0.0,
            transmittance: 1.0,
            ln_transmittance: 0.0,
            absorptance: 0.0,
        }
    }

    fn is_finite(&self) -> bool {
        self.r.is_finite()
            && self.t.is_finite()
            && self.reflectance.is_finite()
            && self.transmittance.is_finite()
            && !self.ln_transmittance.is_nan()
            && !self.ln_abs_t.is_nan()
    }
}
