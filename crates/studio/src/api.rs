//! What a request is answered.

use crate::bakery::{self, Baked, Bakery, Clock, Order, Quality, Unbaked};
use crate::guard::Refusal;
use crate::{Start, StudioError, errors, page};
use bake_brdf::recipe::{BUILT_IN, Recipe, built_in};
use http_body_util::Full;
use hyper::body::Bytes;
use hyper::header::{CONTENT_DISPOSITION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, HeaderValue};
use hyper::{Response, StatusCode};
use lut_io::exr_file;
use lut_io::table::Table;
use pearl_bsdf::export::npz::{self, Form};
use pearl_bsdf::export::{Export as Exported, Format};
use pearl_bsdf::{Array, PearlBsdf, Prepared};
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use thinfilm::library::{self, Entry};

const BYTES: &str = "application/octet-stream";
const JSON: &str = "application/json";
const SECONDS: HeaderName = HeaderName::from_static("x-nacre-seconds");
/// Milliseconds of the parts; browsers show them beside the request.
const TIMING: HeaderName = HeaderName::from_static("server-timing");
/// Wavelength at which the indices of materials are shown, nm: the default of a recipe's lobe.
const SHOWN_NM: f64 = 550.0;
/// Longest name of a file that is handed out, characters.
const LONGEST_NAME: usize = 60;

type Answer = Result<Response<Full<Bytes>>, Refusal>;

/// What the server knows between requests.
pub(crate) struct Studio {
    bakery: Bakery,
    start: Arc<Start>,
    /// What the server was started with, once it was asked for.
    initial: tokio::sync::OnceCell<Result<Baked, String>>,
    /// The last bake that was finished, and its recipe.
    last: Mutex<Option<(Recipe, Baked)>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bake {
    recipe: Value,
    quality: Quality,
    #[serde(default)]
    request: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Export {
    /// An object or a name; `"current"` or nothing: what was baked last.
    #[serde(default)]
    recipe: Value,
    format: String,
}

impl Studio {
    pub(crate) fn new(start: Start, threads: Option<rayon::ThreadPool>) -> Result<Self, StudioError> {
        Ok(Self {
            bakery: Bakery::open(threads)?,
            start: Arc::new(start),
            initial: tokio::sync::OnceCell::new(),
            last: Mutex::default(),
        })
    }

    /// Of a request that the guard let in.
    pub(crate) async fn answer(&self, path: &str, body: &[u8]) -> Answer {
        match path {
            "/" => served_page(),
            "/api/state" => Ok(with(JSON, self.state().to_string())),
            "/api/initial" => self.initial().await,
            "/api/bake" => self.bake(body).await,
            "/api/export" => self.export(body).await,
            _ => {
                let file = path.strip_prefix("/page/").and_then(page::file);
                let (bytes, kind) =
                    file.ok_or_else(|| Refusal::new(StatusCode::NOT_FOUND, "no such page"))?;
                Ok(with(kind, bytes))
            }
        }
    }

    fn state(&self) -> Value {
        let recipe = match (&*self.last(), &*self.start) {
            (Some((recipe, _)), _) | (None, Start::Recipe(recipe)) => recipe.to_json(),
            (None, Start::Table(table)) => table.meta().recipe.clone(),
        };
        let recipes = BUILT_IN.iter().filter_map(|(name, text)| {
            let recipe = Recipe::from_json(text).ok()?;
            Some(json!({ "name": name, "recipe": recipe.to_json() }))
        });
        json!({
            "name": recipe["name"],
            "recipes": recipes.collect::<Vec<_>>(),
            "materials": library::entries().iter().map(material).collect::<Vec<_>>(),
            "formats": Format::ALL.map(|format| {
                json!({ "name": format.name(), "ending": format.ending(), "description": format.description() })
            }),
            "version": env!("CARGO_PKG_VERSION"),
            "recipe": recipe,
        })
    }

    async fn initial(&self) -> Answer {
        let start = Arc::clone(&self.start);
        let baked = self.initial.get_or_init(|| async {
            let made = tokio::task::spawn_blocking(move || initial(&start)).await;
            made.unwrap_or_else(|_| Err("the bake failed".to_owned()))
        });
        arrays(baked.await.as_ref().map_err(Refusal::bad)?)
    }

    async fn bake(&self, body: &[u8]) -> Answer {
        let Bake { recipe, quality, request } = parse(body)?;
        let recipe = recipe_of(&recipe)?;
        let baked = self.baked(&Order { recipe: recipe.clone(), quality }, request).await?;
        let answer = arrays(&baked)?;
        *self.last() = Some((recipe, baked));
        Ok(answer)
    }

    async fn baked(&self, order: &Order, request: u64) -> Result<Baked, Refusal> {
        match self.bakery.order(order.clone()).await {
            Ok(Ok(baked)) => Ok(baked),
            Ok(Err(Unbaked::Refused(line))) => Err(Refusal::bad(line)),
            Ok(Err(Unbaked::Overtaken)) => {
                Err(Refusal::new(StatusCode::CONFLICT, format!("request {request}: a later one came")))
            }
            Err(_) => Err(Refusal::new(StatusCode::INTERNAL_SERVER_ERROR, "the bake failed")),
        }
    }

    async fn export(&self, body: &[u8]) -> Answer {
        let Export { mut recipe, format } = parse(body)?;
        if recipe == "current" {
            recipe = Value::Null;
        }
        let name = |recipe: &Value| file_name(recipe["name"].as_str().unwrap_or_default());
        if format == "recipe" && recipe.is_object() {
            let recipe = recipe_of(&recipe)?.to_json();
            return Ok(file(&name(&recipe), "json", serde_json::to_vec_pretty(&recipe).unwrap_or_default()));
        }
        let table = if recipe.is_null() {
            self.last_table().await?
        } else {
            let order = Order { recipe: recipe_of(&recipe)?, quality: Quality::Fine };
            self.baked(&order, 0).await?.table
        };
        let stem = name(&table.meta().recipe);
        if format == "recipe" {
            let bytes = serde_json::to_vec_pretty(&table.meta().recipe).unwrap_or_default();
            return Ok(file(&stem, "json", bytes));
        }
        let made = tokio::task::spawn_blocking(move || exported(&table, &format));
        let made = made.await.unwrap_or_else(|_| Err("the export failed".to_owned()));
        let (ending, bytes) = made.map_err(Refusal::bad)?;
        Ok(file(&stem, ending, bytes))
    }

    /// Of the last bake, else of what the server was started with.
    async fn last_table(&self) -> Result<Arc<Table>, Refusal> {
        if let Some((_, baked)) = &*self.last() {
            return Ok(Arc::clone(&baked.table));
        }
        self.initial().await?;
        match self.initial.get() {
            Some(Ok(baked)) => Ok(Arc::clone(&baked.table)),
            _ => Err(Refusal::bad("nothing was baked yet")),
        }
    }

    /// Each change of it is whole.
    fn last(&self) -> MutexGuard<'_, Option<(Recipe, Baked)>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A material of the library: its index as recipes have it once they are read, and n and k at [`SHOWN_NM`].
fn material(entry: &Entry) -> Value {
    let index = entry.n.at(1e-9 * SHOWN_NM).ok();
    json!({
        "name": entry.name, "n": entry.n, "source": entry.source,
        "from_nm": entry.from_nm, "to_nm": entry.to_nm, "index": index,
    })
}

/// What the server was started with, as soon as it can be had.
fn initial(start: &Start) -> Result<Baked, String> {
    match start {
        Start::Recipe(recipe) => {
            let order = Order { recipe: recipe.clone(), quality: Quality::Coarse };
            bakery::bake(&order, &AtomicBool::new(false)).map_err(|why| match why {
                Unbaked::Refused(line) => line,
                Unbaked::Overtaken => "the server ends".to_owned(),
            })
        }
        Start::Table(table) => {
            let mut clock = Clock::start();
            let table = Arc::new(table.clone());
            let prepared = Prepared::new(Arc::clone(&table)).map_err(|why| why.to_string())?;
            clock.stop("prepare");
            let errors = errors::arrays(&table).into();
            Ok(Baked { table, prepared: Arc::new(prepared), errors, parts: clock.parts })
        }
    }
}

/// How a file in a format ends, and its bytes.
fn exported(table: &Arc<Table>, format: &str) -> Result<(&'static str, Vec<u8>), String> {
    let line = |why: &dyn std::fmt::Display| why.to_string();
    if format == "table" {
        return exr_file::encode(table).map(|bytes| ("exr", bytes)).map_err(|why| line(&why));
    }
    let known = || Format::ALL.map(Format::name).join(", ");
    let format = Format::ALL
        .into_iter()
        .find(|known| known.name() == format)
        .ok_or_else(|| format!("format: {format:?} is none; expected table, recipe, {}", known()))?;
    let prepared = Arc::new(Prepared::new(Arc::clone(table)).map_err(|why| line(&why))?);
    let look = prepared.look();
    let bsdf = PearlBsdf::new(prepared, look).map_err(|why| line(&why))?;
    let name = table.meta().recipe_name().unwrap_or("pearl");
    let export = Exported::new(&bsdf, name, format).map_err(|why| line(&why))?;
    Ok((format.ending(), export.bytes))
}

fn parse<T: serde::de::DeserializeOwned>(body: &[u8]) -> Result<T, Refusal> {
    serde_json::from_slice(body).map_err(|why| Refusal::bad(format!("the body: {why}")))
}

/// A recipe that a browser sent: an object, or the name of a built-in one. Never the name of a file.
fn recipe_of(value: &Value) -> Result<Recipe, Refusal> {
    let text = match value {
        Value::Object(_) => value.to_string(),
        Value::String(name) if built_in(name).is_some() => built_in(name).unwrap_or_default().to_owned(),
        other => {
            let known = BUILT_IN.map(|(known, _)| known).join(", ");
            return Err(Refusal::bad(format!(
                "recipe: {other} is none; expected an object or one of {known}"
            )));
        }
    };
    Recipe::from_json(&text).map_err(|why| Refusal::bad(format!("recipe: {why}")))
}

fn served_page() -> Answer {
    let html =
        page::served().ok_or_else(|| Refusal::new(StatusCode::NOT_FOUND, StudioError::NoPage.to_string()))?;
    let policy = page::policy(&html);
    let mut response = with("text/html; charset=utf-8", html);
    // Hashes and words of ours.
    if let Ok(policy) = HeaderValue::from_str(&policy) {
        response.headers_mut().insert(CONTENT_SECURITY_POLICY, policy);
    }
    Ok(response)
}

fn arrays(baked: &Baked) -> Answer {
    let mut clock = Clock::start();
    let arrays: Vec<Array> =
        baked.prepared.arrays().into_iter().chain(baked.errors.iter().cloned()).collect();
    let bytes = npz::encode(&arrays, Form::Whole);
    let bytes = bytes.map_err(|why| Refusal::new(StatusCode::INTERNAL_SERVER_ERROR, why.to_string()))?;
    clock.stop("arrays");
    let mut response = with(BYTES, bytes);
    let parts: Vec<_> = baked.parts.iter().chain(&clock.parts).collect();
    let all: f64 = parts.iter().map(|(_, seconds)| seconds).sum();
    let listed: Vec<String> =
        parts.iter().map(|(part, seconds)| format!("{part};dur={:.2}", 1e3 * seconds)).collect();
    for (name, text) in [(SECONDS, format!("{all:.4}")), (TIMING, listed.join(", "))] {
        if let Ok(value) = HeaderValue::from_str(&text) {
            response.headers_mut().insert(name, value);
        }
    }
    Ok(response)
}

fn file(stem: &str, ending: &str, bytes: Vec<u8>) -> Response<Full<Bytes>> {
    let mut response = with(BYTES, bytes);
    if let Ok(value) = HeaderValue::from_str(&format!("attachment; filename=\"{stem}.{ending}\"")) {
        response.headers_mut().insert(CONTENT_DISPOSITION, value);
    }
    response
}

/// A recipe's name as that of a file: letters, digits, - and _.
fn file_name(name: &str) -> String {
    let kept = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    let name: String = name.chars().take(LONGEST_NAME).map(kept).collect();
    if name.is_empty() { "pearl".to_owned() } else { name }
}

fn with(kind: &'static str, body: impl Into<Bytes>) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(body.into()));
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

/// A refusal as it is sent.
pub(crate) fn refused(refusal: &Refusal) -> Response<Full<Bytes>> {
    let line: String = refusal.line.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let mut response = with(JSON, json!({ "error": line }).to_string());
    *response.status_mut() = refusal.status;
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_of_a_recipe_is_a_path() {
        assert_eq!(file_name("../../etc/passwd"), "------etc-passwd");
        assert_eq!(file_name("\"\r\nSet-Cookie: x"), "---Set-Cookie--x");
        assert_eq!(file_name(""), "pearl");
        let refusal = recipe_of(&json!("../paper")).unwrap_err();
        assert!(refusal.line.starts_with("recipe: \"../paper\" is none; expected an object or one of "));
    }
}
