//! The transport problem both solvers answer: one stack of interfaces, at one wavelength.

/// Whether facet tilts stay in the plane of incidence (the paper) or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Geometry {
    /// One signed tilt α ~ N(0, σ) in the plane of incidence; the exit angle s ∈ (−90°, 90°) is signed.
    Plane,
    /// Two slopes ~ N(0, σ²); the exit direction is (θo, φ).
    Space,
}

/// How facets are drawn.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
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

/// One stack of L layers between ambient and substrate at one wavelength, met from the ambient side.
///
/// Medium 0 is the ambient, media 1…L the layers, medium L + 1 the substrate; interface i (0…L) lies
/// between media i and i + 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Transport {
    /// Real indices of media 0…L + 1 (length L + 2).
    pub indices: Vec<f64>,
    /// Absorption optical depth 4πk·d/λ of each layer for a perpendicular crossing (length L, ≥ 0).
    pub optical_depths: Vec<f64>,
    /// Facet statistics, the same at every interface.
    pub facets: Facets,
}

impl Transport {
    /// L, the number of layers.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.optical_depths.len()
    }

    /// Whether any layer absorbs.
    #[must_use]
    pub fn absorbs(&self) -> bool {
        self.optical_depths.iter().any(|&depth| depth > 0.0)
    }

    /// The same stack seen from the substrate.
    #[must_use]
    pub fn upside_down(&self) -> Self {
        let mut turned = self.clone();
        turned.indices.reverse();
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
            optical_depths: vec![0.0; layers],
            facets: Facets { slope_sd, normals: Normals::Unweighted },
        }
    }

    /// The paper's pearl: 500 layers in total of 1.53/1.43 on 1.53, σ = 2°.
    #[must_use]
    pub fn paper() -> Self {
        Self::alternating(500, 1.53, 1.43, 1.53, 2.0_f64.to_radians())
    }
}
