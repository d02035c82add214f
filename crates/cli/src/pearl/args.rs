//! Arguments of `pearl`.

use clap::{Args, Parser, Subcommand};
use nacre_cli::preview::{Lighting, Shape, VIEWS};
use pearl_bsdf::{BsdfError, Components, Controls, PearlBsdf};
use std::path::PathBuf;
use terminal::Stop;

/// Asks a pearl table as a renderer would: values, samples, furnace, pictures; and shows it in a browser.
#[derive(Debug, Parser)]
#[command(name = "pearl", version)]
#[command(after_help = "Examples:
  pearl preview pearl.exr -o pictures         sphere and swatch, one picture a component, and the sum
  pearl preview pearl.exr -o . --only sphere-sky-sum
  pearl eval pearl.exr --input dirs.jsonl     {\"wi\":[0,0,1],\"wo\":[0.1,0,0.995]} a line, - for stdin
  pearl sample pearl.exr --wi 0.5,0,0.866 -n 1000 --seed 7
  pearl furnace pearl.exr --json              a white surrounding as it is seen; exit 3 if it exceeds 1 + 1e-4
  pearl preview pearl.exr --coherence 1 --depth 0.8 --body-rgb 0.1,0.1,0.12 -o black
  pearl studio akoya                          the simulator in the browser, until Ctrl-C
  pearl page pearl.exr -o page.html           the same with this table as one file: no server, no network")]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    #[command(flatten)]
    pub(crate) manners: terminal::Manners,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Evaluate pairs of directions: JSON lines in, JSON lines out, in the same order.
    Eval(EvalArgs),
    /// Draw exit directions for one wi: JSON lines.
    Sample(SampleArgs),
    /// What a viewer sees of a white surrounding (the integral of what `eval` prints), and what leaves of light that arrives, over the
    /// angle; exit 3 if a channel of either exceeds 1 + 1e-4.
    Furnace(FurnaceArgs),
    /// Pictures of a sphere and a swatch under a distant light and a sky, as PNG.
    Preview(PreviewArgs),
    /// The pearl simulator in the browser, with the physics live. Prints its URL, and serves it on this machine alone until Ctrl-C.
    Studio(StudioArgs),
    /// The simulator with a table in it as one HTML file, for mails, papers and galleries.
    Page(PageArgs),
    /// Print a shell completion script.
    Completions {
        /// bash, elvish, fish, powershell or zsh.
        shell: terminal::Shell,
    },
    /// Print the manual page (roff).
    Man,
}

#[derive(Args, Debug)]
pub(crate) struct EvalArgs {
    #[command(flatten)]
    pub(crate) pearl: Pearl,
    /// JSON lines `{"wi":[x,y,z],"wo":[x,y,z]}`, directions of any length but 0; - reads stdin. Mitsuba's convention:
    /// wi looks at the surface, light arrives from wo.
    #[arg(long, value_name = "FILE")]
    pub(crate) input: PathBuf,
    /// Also print f·cos θ at these wavelengths, nm, as a list `spectral`.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = wavelength)]
    pub(crate) wavelengths_nm: Vec<f64>,
}

#[derive(Args, Debug)]
pub(crate) struct SampleArgs {
    #[command(flatten)]
    pub(crate) pearl: Pearl,
    /// Direction that looks at the surface, of any length but 0.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    pub(crate) wi: Triple,
    /// How many.
    #[arg(short = 'n', value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    pub(crate) count: u64,
    /// The same seed gives the same samples.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
}

#[derive(Args, Debug)]
pub(crate) struct FurnaceArgs {
    #[command(flatten)]
    pub(crate) pearl: Pearl,
    /// Steps in the angle from 0 to 90 degrees.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=900))]
    pub(crate) steps: u16,
}

#[derive(Args, Debug)]
pub(crate) struct PreviewArgs {
    #[command(flatten)]
    pub(crate) pearl: Pearl,
    /// Folder for the pictures; made if it is not there.
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Width and height of each picture in pixels.
    #[arg(long, default_value_t = 480, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub(crate) size: u32,
    /// Draw one picture alone, by its name, as sphere-sky-sum: `sphere` or `swatch`; `distant` or `sky`; `diffuse`, `incoherent`, `lobes`
    /// or `sum`.
    #[arg(long, value_name = "NAME", value_parser = PictureName::parse)]
    pub(crate) only: Option<PictureName>,
    /// Samples a pixel under the sky.
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub(crate) samples: u32,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
}

/// Which of the pictures.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PictureName {
    pub(crate) shape: Shape,
    pub(crate) lighting: Lighting,
    /// Number in [`VIEWS`].
    pub(crate) view: usize,
}

impl PictureName {
    /// All there are, in the order in which they are written.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let lights = Shape::ALL.into_iter().flat_map(|shape| Lighting::ALL.map(|lighting| (shape, lighting)));
        lights.flat_map(|(shape, lighting)| (0..VIEWS.len()).map(move |view| Self { shape, lighting, view }))
    }

    fn parse(text: &str) -> Result<Self, String> {
        Self::all().find(|name| name.to_string() == text).ok_or_else(|| {
            let names: Vec<String> = Self::all().map(|name| name.to_string()).collect();
            format!("not a picture; they are {}", names.join(", "))
        })
    }
}

impl std::fmt::Display for PictureName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-{}-{}", self.shape.name(), self.lighting.name(), VIEWS[self.view])
    }
}

#[derive(Args, Debug)]
#[command(after_help = "Examples:
  pearl studio                                the paper's pearl
  pearl studio akoya --no-browser             a built-in recipe; open the URL that is printed
  pearl studio recipe.json --port 8123
  pearl studio pearl.exr                      a table, and its recipe")]
pub(crate) struct StudioArgs {
    /// A recipe (a file, a built-in name, or - for stdin) or a table (.exr).
    #[arg(value_name = "RECIPE|LUT", default_value = "paper")]
    pub(crate) start: PathBuf,
    /// Port to listen on [default: any that is free].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) port: Option<u16>,
    /// Open no browser.
    #[arg(long)]
    pub(crate) no_browser: bool,
}

#[derive(Args, Debug)]
#[command(after_help = "Examples:
  pearl page pearl.exr -o page.html           open it from anywhere, also without a network
  bake-brdf recipe.json -o pearl.exr          with \"look\": {\"thickness\": {}} in the recipe, thickness moves in the page, too")]
pub(crate) struct PageArgs {
    /// Table (EXR) that bake-brdf wrote.
    #[arg(value_name = "LUT")]
    pub(crate) table: PathBuf,
    /// The file to write.
    #[arg(short, long, value_name = "HTML")]
    pub(crate) output: PathBuf,
}

/// A table and its controls; what is not given is as in the recipe in the table.
#[derive(Args, Debug)]
pub(crate) struct Pearl {
    /// Table (EXR) that bake-brdf wrote.
    #[arg(value_name = "LUT")]
    pub(crate) table: PathBuf,
    /// Share of incoherent interference in the base, 0 to 1.
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    depth: Option<f64>,
    /// Strength of the lobes, 0 to 1.
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    brightness: Option<f64>,
    /// Degree of coherence, 0 to 1.
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    coherence: Option<f64>,
    /// Body colour, linear sRGB, each 0 to 1.
    #[arg(long, value_name = "R,G,B", value_parser = triple, allow_hyphen_values = true)]
    body_rgb: Option<Triple>,
    /// Factor of the interference colours, linear sRGB, each 0 to 1.
    #[arg(long, value_name = "R,G,B", value_parser = triple, allow_hyphen_values = true)]
    tint_rgb: Option<Triple>,
    /// Scale of all thicknesses, of a table baked for it (look.thickness) [default: 1].
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    thickness: Option<f64>,
    /// What to show: all, or a list of diffuse, incoherent, mirror, blur [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    components: Option<Vec<String>>,
}

/// Parses a wavelength in nm.
fn wavelength(text: &str) -> Result<f64, String> {
    let nm = text.trim().parse::<f64>().ok().filter(|nm| (100.0..=10_000.0).contains(nm));
    nm.ok_or_else(|| format!("{text:?} is not a wavelength from 100 to 10000 nm"))
}

/// Three numbers.
pub(crate) type Triple = [f64; 3];

/// Parses `a,b,c`.
fn triple(text: &str) -> Result<Triple, String> {
    let wrong = || format!("{text:?} is not three finite numbers separated by commas");
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|x| x.trim().parse::<f64>()).collect();
    let triple: Triple = numbers.map_err(|_| wrong())?.try_into().map_err(|_| wrong())?;
    if triple.iter().all(|x| x.is_finite()) { Ok(triple) } else { Err(wrong()) }
}

impl Pearl {
    /// Reads the table and makes the BSDF.
    pub(crate) fn bsdf(&self) -> Result<PearlBsdf, Stop> {
        self.bsdf_with(|_| {})
    }

    /// The same with the controls changed last.
    pub(crate) fn bsdf_with(&self, change: impl FnOnce(&mut Controls)) -> Result<PearlBsdf, Stop> {
        let table = nacre_cli::read_table(&self.table)?;
        let mut controls = Controls::of(table.meta());
        controls.depth = self.depth.unwrap_or(controls.depth);
        controls.brightness = self.brightness.unwrap_or(controls.brightness);
        controls.coherence = self.coherence.unwrap_or(controls.coherence);
        controls.body_rgb = self.body_rgb.unwrap_or(controls.body_rgb);
        controls.tint_rgb = self.tint_rgb.unwrap_or(controls.tint_rgb);
        controls.thickness = self.thickness.unwrap_or(controls.thickness);
        if let Some(names) = &self.components {
            controls.components =
                Components::from_names(names.iter().map(String::as_str)).ok_or_else(|| {
                    let known = Components::NAMES.join(", ");
                    Stop::bad_input(format!(
                        "--components: {:?} is neither all alone nor a list of {known}",
                        names.join(",")
                    ))
                })?;
        }
        change(&mut controls);
        PearlBsdf::from_table(table, controls).map_err(|error| {
            let advice = match &error {
                BsdfError::NoSpectra { control, .. } => {
                    format!("; `bake-brdf RECIPE --effects all -o FILE` bakes them, or pass --{control} 0")
                }
                _ => String::new(),
            };
            Stop::bad_input(format!("{}: {error}{advice}", self.table.display()))
        })
    }
}
