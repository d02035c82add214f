//! The page: files that are embedded, served one by one, or put together as one.

use crate::{StudioError, errors};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lut_io::table::Table;
use pearl_bsdf::export::npz::{self, Form};
use pearl_bsdf::{Array, Prepared};
use serde_json::{Map, Value};
use sha2::{Digest as _, Sha256};
use std::sync::Arc;

/// Names, with `/` between folders, and contents.
const FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// All of them, with the evaluator that other pages have as well.
fn files() -> impl Iterator<Item = (&'static str, &'static [u8])> {
    let evaluator = pearl_bsdf::web::MODULES.iter().map(|(name, text)| (*name, text.as_bytes()));
    FILES.iter().copied().chain(evaluator)
}

const IMPORT_MAP: &str = "<!-- importmap -->";
const STYLE: &str = "<!-- style -->";
const TITLE: &str = "<title>Nacre</title>";
const BODY_END: &str = "</body>";
/// A page of its own asks nobody for anything.
const ALONE: &str = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data: blob:; \
                     connect-src data: blob:; worker-src data: blob:; base-uri 'none'; form-action 'none'";

/// A file of the page, and what it is.
pub(crate) fn file(name: &str) -> Option<(&'static [u8], &'static str)> {
    let kind = match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        _ => "image/svg+xml",
    };
    files().find(|(known, _)| *known == name).map(|(_, bytes)| (bytes, kind))
}

/// `index.html` as it is served.
pub(crate) fn served() -> Option<String> {
    let map = import_map(|name, _| format!("/page/{name}"));
    let style = r#"<link rel="stylesheet" href="/page/style.css">"#;
    Some(index()?.replace(IMPORT_MAP, &map).replace(STYLE, style))
}

/// The content-security policy of a page that is served: its own files, its inline scripts, its server.
pub(crate) fn policy(html: &str) -> String {
    let scripts: String = inline_scripts(html)
        .map(|script| format!(" 'sha256-{}'", STANDARD.encode(Sha256::digest(script.as_bytes()))))
        .collect();
    format!(
        "default-src 'none'; script-src 'self'{scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; \
         connect-src 'self' data: blob:; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// The page as one file that needs no server, with a table and what was prepared of it in it: curves of colours in half precision, without what only an evaluation at
/// single wavelengths reads.
///
/// # Errors
/// A build without the page.
pub fn alone(table: &Arc<Table>, prepared: &Prepared) -> Result<String, StudioError> {
    let html = index().ok_or(StudioError::NoPage)?;
    let module = |_: &str, bytes: &[u8]| format!("data:text/javascript;base64,{}", STANDARD.encode(bytes));
    let style = file("style.css").map_or("", |(bytes, _)| std::str::from_utf8(bytes).unwrap_or_default());
    let read = |array: &Array| !matches!(array.name, "albedo_spectral" | "rest_spectral");
    let arrays: Vec<Array> =
        prepared.arrays().into_iter().filter(read).chain(errors::arrays(table)).collect();
    let data = npz::encode(&arrays, Form::Small).map_err(|why| StudioError::Arrays(why.to_string()))?;
    let data = STANDARD.encode(data);
    let data = format!(r#"<script id="nacre-data" type="application/octet-stream;base64">{data}</script>"#);
    let policy = format!(r#"<meta http-equiv="Content-Security-Policy" content="{ALONE}">"#);
    let head = format!("{policy}\n{}", import_map(module));
    let html = html.replace(IMPORT_MAP, &head).replace(STYLE, &format!("<style>\n{style}</style>"));
    let html = match table.meta().recipe_name() {
        Some(name) if !name.is_empty() => html.replace(TITLE, &format!("<title>{}</title>", escaped(name))),
        _ => html,
    };
    Ok(match html.rfind(BODY_END) {
        Some(at) => format!("{}{data}\n{}", &html[..at], &html[at..]),
        None => format!("{html}{data}\n"),
    })
}

fn index() -> Option<&'static str> {
    std::str::from_utf8(file("index.html")?.0).ok()
}

/// A name as text of a page.
fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Bare names of the page's modules, `nacre/NAME`, by where each is.
fn import_map(place: impl Fn(&str, &[u8]) -> String) -> String {
    let modules = files().filter(|(name, _)| name.ends_with(".js"));
    let imports: Map<String, Value> =
        modules.map(|(name, bytes)| (format!("nacre/{name}"), Value::from(place(name, bytes)))).collect();
    format!(r#"<script type="importmap">{}</script>"#, serde_json::json!({ "imports": imports }))
}

/// Texts of the scripts that stand in a page itself.
fn inline_scripts(html: &str) -> impl Iterator<Item = &str> {
    html.split("<script").skip(1).filter_map(|script| {
        let (attributes, rest) = script.split_once('>')?;
        (!attributes.contains("src=")).then(|| rest.split_once("</script>").map(|(text, _)| text))?
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_a_title_that_its_recipe_names_and_no_markup_of_it() {
        assert!(index().is_some_and(|html| html.contains(TITLE)));
        assert_eq!(escaped("</title><script>&"), "&lt;/title&gt;&lt;script&gt;&amp;");
    }

    #[test]
    fn inline_scripts_are_allowed_by_their_hashes_and_no_others() {
        let html = r#"<script type="importmap">{}</script><script src="a.js"></script><script type="module">x</script>"#;
        assert_eq!(inline_scripts(html).collect::<Vec<_>>(), ["{}", "x"]);
        // SHA-256 of "x", by another program.
        assert!(
            policy(html).contains("'sha256-LXEWQrcmsEQBYnyp+6wy9chTD7GQPMTbAiWHF5IaSIE='"),
            "{}",
            policy(html)
        );
        assert!(!policy(html).split(';').any(|part| part.contains("script-src") && part.contains("unsafe")));
    }
}
