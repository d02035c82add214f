//! |E(z)|² inside a stack, its integral per layer, and the absorption that follows from it.

use std::sync::LazyLock;

use num_complex::Complex64;

use crate::quadrature::{Rule, gauss_legendre};
use crate::scaled::{exp_parts, times_power_of_two};
use crate::wave::{
    Admittance, InPlaneWave, Incidence, Layer, LayerMatrix, Multilayer, Phase, Polarisation, WaveError,
    cos_and_sinc, half_turns_per_metre,
};

/// Layers that [`Multilayer::field`] lists at most: some 200 bytes each.
pub const MOST_LISTED_LAYERS: u64 = 4_000_000;

/// The field of a unit incident wave (|E| = 1 in the ambient) in every layer.
#[derive(Clone, Debug)]
pub struct Field {
    layers: Vec<LayerField>,
    k0: f64,
    /// n cos θ of the ambient: the incident power per area.
    incident_power: f64,
}

/// The field in one layer.
#[derive(Clone, Copy, Debug)]
struct LayerField {
    layer: Layer,
    /// Depth of its upper face, m.
    top: f64,
    kz: Complex64,
    kz2: Complex64,
    /// (B, C) at its lower face and at its upper face.
    lower: [Complex64; 2],
    upper: [Complex64; 2],
    /// |E|² = weight_b |B|² + weight_c |C|².
    weight_b: f64,
    weight_c: f64,
    /// q sin δ/(kz² sin δ/kz): the factor between C and dψ/dz.
    slope: Complex64,
}

impl Multilayer {
    /// The field in every layer.
    ///
    /// # Errors
    /// As [`Multilayer::solve_with_gain`]; more than [`MOST_LISTED_LAYERS`] layers.
    pub fn field(
        &self,
        wavelength: f64,
        incidence: Incidence,
        polarisation: Polarisation,
    ) -> Result<Field, WaveError> {
        self.check(wavelength)?;
        let count = self.layer_count();
        if count > u128::from(MOST_LISTED_LAYERS) {
            return Err(WaveError::TooManyLayers { layers: count, most: MOST_LISTED_LAYERS });
        }
        let wave = InPlaneWave::new(self.ambient, incidence)?;
        self.check_phases(&wave, wavelength)?;
        let q_0 = wave.admittance(self.ambient, polarisation);
        let mut vector = Admittance::outgoing(self.substrate, wave.admittance(self.substrate, polarisation));
        let mut faces = vec![vector];
        for layer in self.layers().rev() {
            vector = vector.through(layer, &LayerMatrix::new(&wave, layer, wavelength, polarisation));
            faces.push(vector);
        }
        faces.reverse();
        let top = vector;
        let denominator = q_0 * top.b + top.c;
        // |E| = 1 means |H| = |N₀| for p.
        let unit = match polarisation {
            Polarisation::S => 1.0,
            Polarisation::P => self.ambient.norm(),
        };
        let incident = if denominator.norm() == 0.0 {
            Complex64::new(unit, 0.0)
        } else {
            2.0 * q_0 / denominator * unit
        };
        let at_face = |face: &Admittance| {
            let power = face.exponent - top.exponent;
            [times_power_of_two(face.b * incident, power), times_power_of_two(face.c * incident, power)]
        };
        let mut depth = 0.0;
        let layers = self.layers().zip(faces.windows(2)).map(|(layer, faces)| {
            let eps = layer.index * layer.index;
            let (weight_b, weight_c, slope) = match polarisation {
                Polarisation::S => (1.0, 0.0, Complex64::new(1.0, 0.0)),
                Polarisation::P => ((wave.kx / eps).norm_sqr(), 1.0, 1.0 / eps),
            };
            let kz2 = wave.kz2(layer.index);
            let top = depth;
            depth += layer.thickness;
            LayerField {
                layer,
                top,
                kz: crate::wave::sqrt_upper(kz2),
                kz2,
                upper: at_face(&faces[0]),
                lower: at_face(&faces[1]),
                weight_b,
                weight_c,
                slope,
            }
        });
        let field = Field {
            layers: layers.collect(),
            k0: std::f64::consts::TAU / wavelength,
            incident_power: (wave.kz2(self.ambient).sqrt()).re,
        };
        let finite = field.layers.iter().all(|l| l.upper.iter().chain(&l.lower).all(|z| z.is_finite()));
        finite.then_some(field).ok_or(WaveError::Unbounded)
    }
}

impl Field {
    /// ∫|E|² dz over each layer, metres.
    #[must_use]
    pub fn integrals(&self) -> Vec<f64> {
        self.layers.iter().map(|layer| layer.integral(self.k0)).collect()
    }

    /// Share of the incident power that each layer absorbs: k₀ Im ε ∫|E|² dz / Re(N₀ cos θ).
    #[must_use]
    pub fn absorptances(&self) -> Vec<f64> {
        let share = |layer: &LayerField| {
            let loss = 2.0 * layer.layer.index.re * layer.layer.index.im;
            if loss == 0.0 || self.incident_power == 0.0 {
                return 0.0;
            }
            self.k0 * loss * layer.integral(self.k0) / self.incident_power
        };
        self.layers.iter().map(share).collect()
    }

    /// |E|² at a depth below the first interface, metres; `None` outside the layers. On an interface the upper
    /// layer's side counts (E_z jumps there for p).
    #[must_use]
    pub fn intensity(&self, depth: f64) -> Option<f64> {
        let below = self.layers.partition_point(|layer| layer.top < depth).max(1) - 1;
        let layer = self.layers.get(below)?;
        let inside = depth - layer.top;
        // A sum of thicknesses is known to a rounding error of each term.
        let slack = 1e-12 * (layer.top + layer.layer.thickness);
        if !(inside >= 0.0 && inside <= layer.layer.thickness + slack) {
            return None;
        }
        Some(layer.intensity(self.k0, (layer.layer.thickness - inside).max(0.0)))
    }
}

impl LayerField {
    fn delta(&self, k0: f64) -> Complex64 {
        self.kz * (k0 * self.layer.thickness)
    }

    /// Amplitudes (of ψ) of the downward wave at the upper face and of the upward wave at the lower face: the two
    /// decay away from there, so that nothing grows.
    fn waves(&self) -> (Complex64, Complex64) {
        let q = self.kz * self.slope;
        ((self.upper[0] + self.upper[1] / q) / 2.0, (self.lower[0] - self.lower[1] / q) / 2.0)
    }

    /// Thin layers are taken from their lower face, where q may be 0.
    fn is_thin(&self, k0: f64) -> bool {
        self.delta(k0).norm() < 1.0
    }

    /// |E|² at a height above the lower face.
    fn intensity(&self, k0: f64, height: f64) -> f64 {
        let i = Complex64::i();
        let (b, c) = if self.is_thin(k0) {
            let x = k0 * height;
            let phase =
                Phase { half_turns: half_turns_per_metre(k0, self.kz.re) * height, decay: self.kz.im * x };
            let (cos, sinc) = cos_and_sinc(phase);
            let growth = (self.kz.im * x).exp();
            let (cos, sinc) = (cos * growth, sinc * (x * growth));
            (
                cos * self.lower[0] - i * sinc / self.slope * self.lower[1],
                cos * self.lower[1] - i * self.kz2 * self.slope * sinc * self.lower[0],
            )
        } else {
            let (down, up) = self.waves();
            let down = down * (i * self.kz * (k0 * (self.layer.thickness - height))).exp();
            let up = up * (i * self.kz * (k0 * height)).exp();
            (down + up, (down - up) * self.kz * self.slope)
        };
        self.weight_b * b.norm_sqr() + self.weight_c * c.norm_sqr()
    }

    fn integral(&self, k0: f64) -> f64 {
        let d = self.layer.thickness;
        if self.is_thin(k0) {
            let Rule { nodes, weights } = &*THIN_LAYER_RULE;
            let value = |(x, w): (&f64, &f64)| w * self.intensity(k0, 0.5 * (1.0 + x) * d);
            return 0.5 * d * nodes.iter().zip(weights).map(value).sum::<f64>();
        }
        let (down, up) = self.waves();
        let delta = self.delta(k0);
        let mean_decay = if delta.im == 0.0 { 1.0 } else { -(-2.0 * delta.im).exp_m1() / (2.0 * delta.im) };
        let sinc = if delta.re == 0.0 { 1.0 } else { delta.re.sin() / delta.re };
        let (decay, power) = exp_parts(-delta.im);
        let standing =
            2.0 * (down * up.conj()).re * sinc * times_power_of_two(Complex64::new(decay, 0.0), power).re;
        let running = (down.norm_sqr() + up.norm_sqr()) * mean_decay;
        let q2 = (self.kz * self.slope).norm_sqr();
        d * (self.weight_b * (running + standing) + self.weight_c * q2 * (running - standing))
    }
}

/// For a phase below 1 rad the error of the 8-point rule is below 1e-15.
static THIN_LAYER_RULE: LazyLock<Rule> = LazyLock::new(|| gauss_legendre(8));
