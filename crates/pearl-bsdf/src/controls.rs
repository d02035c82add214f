//! What an artist sets.

use lut_io::table::Meta;

/// The artist's controls; colours are linear sRGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controls {
    /// Share of incoherent interference in the base, 0 to 1.
    pub depth: f64,
    /// Strength of the lobes, 0 to 1; what they do not reflect feeds the base.
    pub brightness: f64,
    /// Degree of coherence γ, 0 to 1: how much of the coherent interference colours the lobes show.
    pub coherence: f64,
    /// Body colour ρ, each channel 0 to 1.
    pub body_rgb: [f64; 3],
    /// Factor of the interference colours M and Ê for art direction, each channel 0 to 1.
    pub tint_rgb: [f64; 3],
    /// Scale of all thicknesses of the stack, and of their spreads: 1 is the recipe's.
    pub thickness: f64,
    /// What is shown. Hiding a component leaves the others as they are.
    pub components: Components,
}

/// Which components are evaluated and sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Components {
    /// Diffuse light of the body.
    pub diffuse: bool,
    /// Incoherent interference: light scattered inside, coloured by the viewing angle.
    pub incoherent: bool,
    /// Reflection by the outermost interface, with its coherent colour.
    pub mirror: bool,
    /// Light that entered the stack and came back, with its coherent colour.
    pub blur: bool,
}

impl Components {
    /// Everything.
    pub const ALL: Self = Self { diffuse: true, incoherent: true, mirror: true, blur: true };
    /// Nothing; to switch on what is wanted.
    pub const NONE: Self = Self { diffuse: false, incoherent: false, mirror: false, blur: false };
    /// Names in the order of [`crate::Evaluation::parts`].
    pub const NAMES: [&'static str; 4] = ["diffuse", "incoherent", "mirror", "blur"];

    /// From a list of names, or of `all` alone; `None` for an unknown one.
    #[must_use]
    pub fn from_names<'n>(names: impl IntoIterator<Item = &'n str>) -> Option<Self> {
        let mut names = names.into_iter().map(str::trim).peekable();
        if names.peek() == Some(&"all") {
            return (names.count() == 1).then_some(Self::ALL);
        }
        let mut shown = Self::NONE;
        for name in names {
            match name {
                "diffuse" => shown.diffuse = true,
                "incoherent" => shown.incoherent = true,
                "mirror" => shown.mirror = true,
                "blur" => shown.blur = true,
                _ => return None,
            }
        }
        Some(shown)
    }
}

impl Default for Controls {
    /// The recipe's defaults.
    fn default() -> Self {
        Self {
            depth: 0.5,
            brightness: 1.0,
            coherence: 0.5,
            body_rgb: [0.8, 0.78, 0.75],
            tint_rgb: [1.0; 3],
            thickness: 1.0,
            components: Components::ALL,
        }
    }
}

/// Why a table and controls do not make a BSDF.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BsdfError {
    /// A control is out of its range.
    #[error("{field}: {value} is not valid; expected a number from 0 to 1")]
    Control {
        /// Name of the control.
        field: String,
        /// Value found.
        value: f64,
    },
    /// A control asks for a part that the table does not have.
    #[error("{control}: is {value}, expected 0: the table has no {effect} colours{}", in_brackets(reason))]
    NoSpectra {
        /// Name of the control.
        control: &'static str,
        /// Value found.
        value: f64,
        /// Effect that was not baked: `coherent` or `emission`.
        effect: &'static str,
        /// Why the bake left it out; empty if the table does not say.
        reason: String,
    },
    /// A thickness that the table has no colours of.
    #[error("thickness: is {value}, expected {}", of_thickness(range))]
    Thickness {
        /// Value found.
        value: f64,
        /// Scales that there are: 1 and 1 of a table of one thickness.
        range: [f64; 2],
    },
    /// It is not wanted any more.
    #[error("stopped")]
    Stopped,
    /// The table itself is not valid.
    #[error(transparent)]
    Table(#[from] lut_io::FieldError),
}

fn in_brackets(reason: &str) -> String {
    if reason.is_empty() { String::new() } else { format!(" ({reason})") }
}

fn of_thickness([from, to]: &[f64; 2]) -> String {
    if from < to {
        return format!("a number from {from} to {to}");
    }
    "1: the table has the colours of one thickness; bake the recipe with \"look\": {\"thickness\": {}} for more".to_owned()
}

impl Controls {
    /// The controls of the recipe in the table, defaults where it says nothing. Depth is 0 for a table
    /// without emission colours, coherence for one without coherent ones (section `spectra`).
    #[must_use]
    pub fn of(meta: &Meta) -> Self {
        let look = &meta.recipe["look"];
        let mut controls = Self::default();
        let number = |name: &str, default: f64| look[name].as_f64().unwrap_or(default);
        controls.depth = number("depth", controls.depth);
        controls.brightness = number("brightness", controls.brightness);
        controls.coherence = number("coherence", controls.coherence);
        for (c, channel) in controls.body_rgb.iter_mut().enumerate() {
            *channel = look["body_rgb"][c].as_f64().unwrap_or(*channel);
        }
        let spectra = meta.spectra.as_ref();
        if spectra.is_none_or(|s| s.emission.is_none()) {
            controls.depth = 0.0;
        }
        if spectra.is_none_or(|s| s.coherent.is_none()) {
            controls.coherence = 0.0;
        }
        controls
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first control out of 0 to 1.
    pub fn check(&self) -> Result<(), BsdfError> {
        let scalars = [("depth", self.depth), ("brightness", self.brightness), ("coherence", self.coherence)];
        let colours = [("body_rgb", self.body_rgb), ("tint_rgb", self.tint_rgb)];
        let channels =
            colours.into_iter().flat_map(|(name, rgb)| (0..3).map(move |c| (format!("{name}[{c}]"), rgb[c])));
        for (field, value) in
            scalars.map(|(name, value)| (name.to_owned(), value)).into_iter().chain(channels)
        {
            if !(0.0..=1.0).contains(&value) {
                return Err(BsdfError::Control { field, value });
            }
        }
        Ok(())
    }
}
