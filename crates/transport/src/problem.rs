//! The transport problem both solvers answer: one stack of interfaces, at one wavelength.

use num_complex::Complex64;
use thinfilm::intensity::fresnel_complex;

/// Whether facet tilts stay in the plane of incidence (the paper) or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Geometry {
    /// One signed tilt α ~ N(0, σ) in the plane of incidence; the exit angle s ∈ (−90°, 90°) is signed.
    Plane,
    /// Two slopes ~ N(0, σ²); the exit direction is (θo, φ).
    Space,
}

/// How facets are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Normals {
    /// From the slope density, redrawn while facing away (the paper).
    Unweighted,
    /// Also weighted by projected area max(0, −d·m)/m_z.
    Visible,
}

/// Facet statistics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facets {
    /// σ: standard deviation of the tilt (plane) or of each slope (space), radians. 0 is allowed.
    pub slope_sd: f64,
    /// Weighting of the facets a ray meets.
    pub normals: Normals,
}

/// The polarisation of the light that the interfaces meet. In the plane of incidence s stays s and p stays p.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Light {
    /// Unpolarised at every event, whatever came before (the paper).
    #[default]
    Unpolarised,
    /// Unpolarised light arrives; half of it is s and half p all the way (plane only).
    Tracked,
    /// s, perpendicular to the plane of incidence (plane only).
    S,
    /// p, in the plane of incidence (plane only).
    P,
}

/// An interface as light from the first of two media meets it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Face {
    /// n₁/n₂ of the real indices.
    pub(crate) eta: f64,
    /// Both indices, where one of them is complex.
    complex: Option<[Complex64; 2]>,
}

impl Face {
    pub(crate) fn new(first: Complex64, second: Complex64) -> Self {
        let is_complex = first.im != 0.0 || second.im != 0.0;
        Self { eta: first.re / second.re, complex: is_complex.then_some([first, second]) }
    }

    /// Reflectance at a cosine of the angle of incidence, and the cosine of the angle of refraction, 0 past the critical angle. What is
    /// not reflected there is absorbed ([`fresnel_complex`]).
    pub(crate) fn meet(&self, cos_i: f64, light: Light) -> (f64, f64) {
        let eta = self.eta;
        // 1 − η²(1 − c²) = (1 − η)(1 + η) + η²c² keeps its digits when η → 1.
        let squared = (1.0 - eta) * (1.0 + eta) + eta * eta * cos_i * cos_i;
        let cos_t = squared.max(0.0).sqrt();
        let (s, p) = match self.complex {
            Some([first, second]) => fresnel_complex(first, cos_i, second),
            None if cos_t == 0.0 => (1.0, 1.0),
            None => {
                let s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
                let p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
                (s * s, p * p)
            }
        };
        (light.of_both(s, p), cos_t)
    }
}

impl Light {
    /// What this light meets where s and p meet so much each.
    pub(crate) fn of_both(self, s: f64, p: f64) -> f64 {
        match self {
            Self::S => s,
            Self::P => p,
            Self::Unpolarised | Self::Tracked => 0.5 * (s + p),
        }
    }
}

/// Thin sheets in place of interfaces: each reflects as a coherent film and lets the rest pass undeviated.
///
/// Interfaces 1 to `last` are sheets; the media on both sides of each have the same index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheets {
    /// Index of the sheets, lossless.
    pub index: f64,
    /// 2πd/λ: thickness over vacuum wavelength, times 2π. `index · phase` is at most π/2: a quarter of a wave.
    pub phase: f64,
    /// Index of the last interface that is a sheet.
    pub last: usize,
}

impl Sheets {
    /// Reflectance (s, p) of a sheet between media of index `n` met at `cosine` of the angle from its normal: Airy's
    /// formula (Born & Wolf, Principles of Optics, §7.6), and frustrated total reflection past the critical angle.
    #[must_use]
    pub fn reflectance(&self, n: f64, cosine: f64) -> (f64, f64) {
        let inside = 1.0 - (n / self.index).powi(2) * (1.0 - cosine * cosine);
        let depth = self.phase * self.index * inside.abs().sqrt();
        let (q1, q2) =
            ([n * cosine, cosine / n], [self.index, 1.0 / self.index].map(|q| q * inside.abs().sqrt()));
        let one = |i: usize| {
            if inside > 0.0 {
                let r2 = ((q1[i] - q2[i]) / (q1[i] + q2[i])).powi(2);
                let sine2 = 4.0 * r2 * depth.sin().powi(2);
                return sine2 / ((1.0 - r2).powi(2) + sine2);
            }
            // |r| = 1 with the phase φ: sinh²δ / (sinh²δ + sin²φ), φ = 2 atan(q2/q1).
            let turned = (2.0 * (q2[i] / q1[i]).atan()).sin().powi(2);
            let sinh2 = depth.sinh().powi(2);
            if sinh2 > 0.0 { sinh2 / (sinh2 + turned) } else { 0.0 }
        };
        (one(0), one(1))
    }
}

/// One stack of L layers between ambient and substrate at one wavelength, met from the ambient side.
///
/// Medium 0 is the ambient, media 1…L the layers, medium L + 1 the substrate; interface i (0…L) lies
/// between media i and i + 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Transport {
    /// Real indices of media 0…L + 1 (length L + 2): they give the directions of rays.
    pub indices: Vec<f64>,
    /// Extinction coefficients k of the same media, or none where all are clear: with the indices they give what faces reflect.
    pub extinctions: Vec<f64>,
    /// Absorption optical depth 4πk·d/λ of each layer for a perpendicular crossing (length L, ≥ 0).
    pub optical_depths: Vec<f64>,
    /// Facet statistics, the same at every interface.
    pub facets: Facets,
    /// Polarisation of the light.
    pub light: Light,
    /// Coherent sheets in place of inner interfaces.
    pub sheets: Option<Sheets>,
}

impl Transport {
    /// L, the number of layers.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.optical_depths.len()
    }

    /// Whether any layer, or any face, absorbs.
    #[must_use]
    pub fn absorbs(&self) -> bool {
        self.optical_depths.iter().any(|&depth| depth > 0.0) || self.has_complex_faces()
    }

    /// Whether any index is complex.
    #[must_use]
    pub fn has_complex_faces(&self) -> bool {
        self.extinctions.iter().any(|&k| k != 0.0)
    }

    /// n + ik of a medium.
    #[must_use]
    pub fn index(&self, medium: usize) -> Complex64 {
        Complex64::new(self.indices[medium], self.extinctions.get(medium).copied().unwrap_or(0.0))
    }

    /// Takes all absorption away.
    pub fn make_clear(&mut self) {
        self.optical_depths.fill(0.0);
        self.extinctions.clear();
    }

    /// The same stack seen from the substrate.
    #[must_use]
    pub fn upside_down(&self) -> Self {
        let mut turned = self.clone();
        turned.indices.reverse();
        turned.extinctions.reverse();
        turned.optical_depths.reverse();
        turned
    }

    /// A lossless alternating stack: ambient 1, `layers` layers of `odd`, `even`, `odd`, …, substrate.
    #[must_use]
    pub fn alternating(layers: usize, odd: f64, even: f64, substrate: f64, slope_sd: f64) -> Self {
        let mut indices = vec![1.0];
        indices.extend((0..layers).map(|i| if i % 2 == 0 { odd } else { even }));
        indices.push(substrate);
        Self {
            indices,
            extinctions: Vec::new(),
            optical_depths: vec![0.0; layers],
            facets: Facets { slope_sd, normals: Normals::Unweighted },
            light: Light::Unpolarised,
            sheets: None,
        }
    }

    /// The paper's pearl: 500 layers in total of 1.53/1.43 on 1.53, σ = 2°.
    #[must_use]
    pub fn paper() -> Self {
        Self::alternating(500, 1.53, 1.43, 1.53, 2.0_f64.to_radians())
    }
}
