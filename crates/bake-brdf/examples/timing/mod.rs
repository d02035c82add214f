//! Requests, and the clock that they are timed by: what the examples `choice` and `prices` share.

use bake_brdf::bake::Request;
use bake_brdf::effects::{Effect, Effects};
use bake_brdf::options::{Options, Target};
use bake_brdf::recipe::{AzimuthMode, Recipe};
use std::error::Error;
use std::time::Instant;

pub(crate) type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Layers, σ in degrees, indices of the odd and even layers and of the substrate.
pub(crate) type Stack = (usize, f64, [f64; 3]);

pub(crate) const PEARL: [f64; 3] = [1.53, 1.43, 1.53];

/// Longest walk that is walked, and half the longest doubling that is fitted, seconds.
pub(crate) const PATIENCE: f64 = 1.0;
/// Short work is repeated until it has taken so many seconds, or so often.
const LONG_ENOUGH: f64 = 0.1;
const MOST_REPEATS: f64 = 100.0;

/// Seconds on some clock.
pub(crate) type Clock = fn() -> f64;

pub(crate) fn wall_seconds() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

/// Of this thread, where the system says.
pub(crate) fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().next().and_then(|text| text.parse::<f64>().ok());
    nanoseconds.map_or_else(wall_seconds, |nanoseconds| 1e-9 * nanoseconds)
}

/// What work gives, and how long it takes: the mean of as many repeats as the clock's ticks (4 ms) call for.
pub(crate) fn timed<T>(clock: Clock, mut work: impl FnMut() -> T) -> (T, f64) {
    let started = clock();
    let mut repeats = 1.0;
    let mut result = work();
    while clock() - started < LONG_ENOUGH && repeats < MOST_REPEATS {
        result = work();
        repeats += 1.0;
    }
    (result, (clock() - started) / repeats)
}

pub(crate) fn incidences() -> [Vec<f64>; 3] {
    [vec![30.0], vec![0.0, 30.0, 60.0, 85.0], (0..=90).map(f64::from).collect()]
}

/// A request for the lobe alone: colours take either solver the same time.
pub(crate) fn request(
    stack: Stack,
    azimuth: AzimuthMode,
    incident_deg: &[f64],
    percent: f64,
) -> Result<Request> {
    let (layers, sigma_deg, [odd, even, substrate]) = stack;
    let text = format!(
        r#"{{"schema": "pearl-recipe/1", "stack": {{"layers": {layers}, "aragonite": {{"n": {odd}}}, "conchiolin": {{"n": {even}}},
        "substrate": {{"n": {substrate}}}}}, "facets": {{"slope_sd_deg": {sigma_deg}}}}}"#
    );
    let mut recipe = Recipe::from_json(&text)?;
    recipe.azimuth.mode = azimuth;
    let options = Options {
        effects: Effects::Listed([Effect::Surface, Effect::Blur, Effect::Azimuth].into_iter().collect()),
        incident_deg: Some(incident_deg.to_vec()),
        target: Target::AccuracyPercent(percent),
        ..Options::default()
    };
    Ok(Request::new(recipe, options)?)
}
