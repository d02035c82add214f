//! A table made ready for every renderer: all that depends neither on the pair of directions nor on the controls.
//!
//! Computed once, in double precision, and kept in single. [`Prepared::arrays`] gives all of it by name; `docs/ARRAYS.md` says
//! what each array means, and evaluates the pearl from them in a page of arithmetic.

mod arrays;
pub(crate) mod channels;
mod lobes;
mod mirror;
pub(crate) mod thickness;

use crate::controls::{BsdfError, Controls};
use crate::facets::{Facets, Rules};
use crate::lobes::Lobes;
use crate::numerics::curve::{self, Curve};
pub use arrays::Array;
use channels::{Channels, Coloured, Kind, Light, Means};
use lut_io::lobe::Interpolant;
use lut_io::table::Table;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use thickness::{Scaled, Scales};

/// A table prepared for evaluation and sampling; shared by all pearls that look different because of their [`Controls`] alone.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The lobe at each of its wavelengths; the first is the table's own, which is what is sampled.
    pub(crate) bands: Vec<Band>,
    /// Share of each band in the channels of linear sRGB.
    pub(crate) rgb_weights: Vec<[f64; 3]>,
    /// Wavelengths of the bands, nm, ascending, and their places among them.
    pub(crate) by_wavelength: (Vec<f64>, Vec<usize>),
    pub(crate) rgb: Channels,
    pub(crate) spectral: Channels,
    /// [`curve::mean_weights`].
    pub(crate) mean_weights: Curve,
    look: Controls,
    /// Scales of the thicknesses, of a table that has their colours.
    pub(crate) scales: Option<Scales>,
    /// Effects whose colours the table does not have, and why, if it says so.
    missing: Vec<(&'static str, String)>,
}

/// For what nobody stops.
static NEVER: AtomicBool = AtomicBool::new(false);

/// The pearl at one wavelength of the lobes.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    pub(crate) wavelength_nm: f64,
    pub(crate) lobes: Lobes,
    pub(crate) facets: Facets,
    /// Over θ: the closed-form reflection is multiplied by this at θi; of reciprocal tables also by this at θo and by cos θo.
    pub(crate) mirror: Curve,
    /// Light without colour.
    pub(crate) plain: Light,
    pub(crate) rgb: Vec<Coloured>,
    pub(crate) spectral: Vec<Coloured>,
    /// RGB at each of [`Scales::scale`].
    pub(crate) scaled: Vec<Scaled>,
}

impl Prepared {
    /// Prepares a table; takes tens of milliseconds a band (space tables more).
    ///
    /// # Errors
    /// [`BsdfError::Table`] if a further band is not valid.
    pub fn new(table: impl Into<Arc<Table>>) -> Result<Self, BsdfError> {
        Self::unless(&NEVER, table, true)
    }

    /// Without the colours of single wavelengths, which take most of the time: at a wavelength the pearl has no interference colour.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_rgb(table: impl Into<Arc<Table>>) -> Result<Self, BsdfError> {
        Self::unless(&NEVER, table, false)
    }

    /// [`Self::new`], or [`Self::of_rgb`] where single wavelengths are not wanted, that stops soon after `stop` is set, from anywhere.
    ///
    /// # Errors
    /// As [`Self::new`]; [`BsdfError::Stopped`].
    pub fn unless(
        stop: &AtomicBool,
        table: impl Into<Arc<Table>>,
        spectral: bool,
    ) -> Result<Self, BsdfError> {
        let table = table.into();
        let meta = table.meta();
        let look = Controls::of(meta);
        let rgb_weights =
            meta.dispersion.as_ref().map_or(vec![[1.0; 3]], |section| section.rgb_weights.clone());
        let further = table.further_bands()?;
        let spectra = meta.spectra.as_ref();
        let of_kind = |kind| {
            let shown = spectra.filter(|_| spectral || matches!(kind, Kind::Rgb));
            Channels::new(kind, shown, meta.wavelength_nm)
        };
        let [rgb, spectral] = [Kind::Rgb, Kind::Spectral].map(of_kind);
        let reasons = meta.spectra_missing.clone().unwrap_or_default();
        let has_coherent = spectra.is_some_and(|spectra| spectra.coherent.is_some());
        let has_emission = spectra.is_some_and(|spectra| spectra.emission.is_some());
        let missing =
            [("coherent", has_coherent, reasons.coherent), ("emission", has_emission, reasons.emission)]
                .into_iter()
                .filter(|(_, has, _)| !has)
                .map(|(effect, _, reason)| (effect, reason.unwrap_or_default()))
                .collect();
        let scales = spectra.and_then(Scales::new);
        let tables: Vec<Arc<Table>> =
            std::iter::once(table).chain(further.into_iter().map(Arc::new)).collect();
        let bands: Vec<Band> = tables
            .into_par_iter()
            .map(|table| Band::new(stop, table, spectral.count()))
            .collect::<Result<_, _>>()?;
        let mut places: Vec<usize> = (0..bands.len()).collect();
        places.sort_by(|a, b| bands[*a].wavelength_nm.total_cmp(&bands[*b].wavelength_nm));
        let wavelengths = places.iter().map(|place| bands[*place].wavelength_nm).collect();
        Ok(Self {
            bands,
            rgb_weights,
            by_wavelength: (wavelengths, places),
            rgb,
            spectral,
            mean_weights: curve::mean_weights(),
            look,
            scales,
            missing,
        })
    }

    /// The look of the recipe in the table; what the table has no colours for is 0.
    #[must_use]
    pub const fn look(&self) -> Controls {
        self.look
    }

    /// The smallest and the largest scale of all thicknesses that the table has colours of; 1 and 1 where it has those of one thickness
    /// alone.
    #[must_use]
    pub fn thickness_range(&self) -> [f64; 2] {
        self.scales.as_ref().map_or([1.0; 2], Scales::range)
    }

    /// Whether f(a → b) = f(b → a).
    #[must_use]
    pub fn is_reciprocal(&self) -> bool {
        self.bands[0].lobes.reciprocal
    }

    /// Checks the ranges of the controls, and that there are the colours that they ask for.
    ///
    /// # Errors
    /// The first control that cannot be met.
    pub fn check(&self, controls: &Controls) -> Result<(), BsdfError> {
        controls.check()?;
        let (value, range) = (controls.thickness, self.thickness_range());
        if !(range[0]..=range[1]).contains(&value) {
            return Err(BsdfError::Thickness { value, range });
        }
        for (control, value, needed) in
            [("depth", controls.depth, "emission"), ("coherence", controls.coherence, "coherent")]
        {
            let missing = self.missing.iter().find(|(effect, _)| value > 0.0 && *effect == needed);
            if let Some((effect, reason)) = missing {
                return Err(BsdfError::NoSpectra { control, value, effect, reason: reason.clone() });
            }
        }
        Ok(())
    }
}

impl Band {
    /// Of a table's own wavelength; so many channels has a table without interference colours.
    fn new(stop: &AtomicBool, table: Arc<Table>, channels: usize) -> Result<Self, BsdfError> {
        let go_on = || if stop.load(Ordering::Relaxed) { Err(BsdfError::Stopped) } else { Ok(()) };
        go_on()?;
        let lobe = Interpolant::new(table);
        go_on()?;
        let meta = lobe.table().meta();
        let (spectra, wavelength_nm) = (meta.spectra.as_ref(), meta.wavelength_nm);
        let facets = Facets::new(&meta.surface_model);
        let lobes = Lobes::new(&lobe);
        let mirror = if lobes.reciprocal {
            mirror::ends(&lobe, &facets, &Rules::new())
        } else {
            mirror::scale(&lobe, &facets)
        };
        go_on()?;
        let means = Means::new(&lobe, meta.reciprocal.as_ref(), &lobes, &facets, &mirror);
        go_on()?;
        let plain = means.plain();
        let rgb = means.coloured(Kind::Rgb, spectra, &plain, 3);
        let many = spectra.filter(|spectra| channels == spectra.wavelength_nm.len());
        let spectral = means.coloured(Kind::Spectral, many, &plain, channels);
        let scaled = means.scaled(spectra);
        Ok(Self { wavelength_nm, lobes, facets, mirror, plain, rgb, spectral, scaled })
    }
}
