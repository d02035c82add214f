//! A scene's files as one tree of elements: includes put in place, `$name` replaced.

use super::SceneError;
use std::collections::HashMap;
use std::io::Read as _;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Longest scene file, bytes; the same for all of a scene together.
const MAX_BYTES: usize = 64 << 20;
/// Most includes of a scene, and how deep they may nest (Mitsuba's own bound is 15).
const MAX_INCLUDES: usize = 256;
const MAX_INCLUDE_DEPTH: usize = 15;
/// Deepest nesting of elements.
const MAX_DEPTH: usize = 100;
/// Most elements and attributes of all files together.
const MAX_NODES: u32 = 1_000_000;
/// Longest value, `$name` replaced or not, bytes; all replaced values together have the bound of the files.
const MAX_VALUE: usize = 1 << 20;
/// Most attributes of an element: the parser compares each with all before it.
const MAX_ATTRIBUTES: usize = 1000;
/// Most names of values: each `$` is compared with all of them.
const MAX_DEFAULTS: usize = 10_000;
/// Longest line of an error, characters; what is longer loses its middle.
const MAX_LINE: usize = 600;

/// The files of a scene, the scene itself first; a file included twice is there twice.
#[derive(Clone, Debug, Default)]
pub(super) struct Files {
    list: Vec<File>,
    /// Folders to look for files in.
    folders: Vec<PathBuf>,
    /// Values of `$name`.
    pub(super) defaults: HashMap<String, String>,
    pub(super) inclusions: Vec<Inclusion>,
}

#[derive(Clone, Debug)]
pub(super) struct File {
    /// As a message names it.
    name: String,
    pub(super) text: String,
    /// Byte offsets at which lines start.
    lines: Vec<usize>,
}

/// An `<include>` and what it stands for.
#[derive(Clone, Debug)]
pub(super) struct Inclusion {
    /// File and bytes of the element.
    pub(super) at: (usize, Range<usize>),
    /// File and bytes of what is included.
    pub(super) of: (usize, Range<usize>),
}

/// Names an element: its file and first byte.
pub(super) type Key = (usize, usize);

/// One element; the elements of includes are children like others.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) tag: String,
    pub(super) attributes: Vec<Attribute>,
    pub(super) children: Vec<Element>,
    pub(super) file: usize,
    /// Its bytes in the file, tags included.
    pub(super) range: Range<usize>,
}

#[derive(Clone, Debug)]
pub(super) struct Attribute {
    pub(super) name: String,
    /// `$name` replaced.
    pub(super) value: String,
    /// The bytes of the value in the file, without quotes.
    pub(super) range: Range<usize>,
}

impl Element {
    pub(super) const fn key(&self) -> Key {
        (self.file, self.range.start)
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|a| a.name == name).map(|a| a.value.as_str())
    }

    pub(super) fn is_pearl(&self) -> bool {
        self.tag == "bsdf" && self.attribute("type") == Some("pearl")
    }

    /// The element and all below it, in the order of the scene.
    pub(super) fn descendants(&self) -> impl Iterator<Item = &Self> {
        let mut left = vec![self];
        std::iter::from_fn(move || {
            let next = left.pop()?;
            left.extend(next.children.iter().rev());
            Some(next)
        })
    }
}

impl Files {
    pub(super) fn text(&self, file: usize) -> &str {
        &self.list[file].text
    }

    /// `file:line` of an element.
    pub(super) fn place(&self, element: &Element) -> String {
        self.place_of(element.key())
    }

    fn place_of(&self, (file, byte): Key) -> String {
        let File { name, lines, .. } = &self.list[file];
        format!("{name}:{}", lines.partition_point(|start| *start <= byte))
    }

    /// An error at an element.
    pub(super) fn refuse(&self, element: &Element, problem: impl std::fmt::Display) -> SceneError {
        SceneError(shortened(&format!("{}: {problem}", self.place(element))))
    }

    /// A file that a scene names: relative names start from the scene's folder, then its `<path>`s.
    pub(super) fn find(&self, name: &str) -> Option<PathBuf> {
        self.folders.iter().map(|folder| folder.join(name)).find(|path| path.is_file())
    }
}

/// Loads a scene; `defaults` are values of `$name` that go before those in the files.
pub(super) fn load(path: &Path, defaults: &[(String, String)]) -> Result<(Files, Element), SceneError> {
    let mut loader =
        Loader { files: Files::default(), open: Vec::new(), bytes: 0, replaced: 0, nodes: MAX_NODES };
    loader.files.defaults.extend(defaults.iter().cloned());
    loader.files.folders.push(lut_io::atomic::folder_of(path).to_owned());
    let file = loader.open(path, path.display().to_string()).map_err(SceneError)?;
    let (root, _) = loader.parse(file)?;
    if root.tag != "scene" {
        let problem = format!("the root is <{}>; a Mitsuba scene starts with <scene>", root.tag);
        return Err(loader.files.refuse(&root, problem));
    }
    Ok((loader.files, root))
}

/// Char of XML 1.0, §2.2.
const fn is_xml_character(c: char) -> bool {
    matches!(c, '\t' | '\n' | '\r' | ' '..='\u{d7ff}' | '\u{e000}'..='\u{fffd}' | '\u{10000}'..)
}

struct Loader {
    files: Files,
    /// Canonical paths of the files that are being read, outermost first.
    open: Vec<(PathBuf, usize)>,
    bytes: usize,
    /// Bytes of values with a `$name` replaced.
    replaced: usize,
    nodes: u32,
}

impl Loader {
    /// Reads a file; the problem as text.
    fn open(&mut self, path: &Path, name: String) -> Result<usize, String> {
        let left = (MAX_BYTES - self.bytes) as u64;
        let named = |why: String| format!("{}: {why}", path.display());
        let file = std::fs::File::open(path).map_err(|error| named(error.to_string()))?;
        let mut bytes = Vec::new();
        file.take(left + 1).read_to_end(&mut bytes).map_err(|error| named(error.to_string()))?;
        if bytes.len() as u64 > left {
            return Err(named(format!("the files of the scene are longer than {MAX_BYTES} bytes together")));
        }
        let text = decoded(bytes).map_err(named)?;
        self.bytes += text.len();
        let canonical = path.canonicalize().map_err(|error| named(error.to_string()))?;
        let lines = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        let index = self.files.list.len();
        self.open.push((canonical, index));
        self.files.list.push(File { name, text, lines });
        Ok(index)
    }

    /// The tree of a file, and the bytes inside its root element.
    fn parse(&mut self, file: usize) -> Result<(Element, Range<usize>), SceneError> {
        let text = self.files.list[file].text.clone();
        if let Some(byte) = crowded(&text) {
            let problem = format!("an element has more than {MAX_ATTRIBUTES} attributes");
            return Err(SceneError(format!("{}: {problem}", self.files.place_of((file, byte)))));
        }
        let options =
            roxmltree::ParsingOptions { allow_dtd: false, nodes_limit: self.nodes, ..Default::default() };
        let document = roxmltree::Document::parse_with_options(&text, options).map_err(|error| {
            let name = &self.files.list[file].name;
            SceneError(shortened(&format!("{name}:{}: {}", error.pos().row, xml_problem(&error))))
        })?;
        if let Some(reference) = bad_reference(&text) {
            let place = self.files.place_of((file, reference.start));
            let problem = format!("{place}: {} is no character of XML", &text[reference]);
            return Err(SceneError(shortened(&problem)));
        }
        self.nodes = self.nodes.saturating_sub(document.root().descendants().count() as u32).max(1);
        let root = document.root_element();
        let inner = match (root.first_child(), root.last_child()) {
            (Some(first), Some(last)) => first.range().start..last.range().end,
            _ => root.range().end..root.range().end,
        };
        let element = self.element(root, file, 0)?;
        self.open.pop();
        Ok((element, inner))
    }

    fn element(
        &mut self,
        node: roxmltree::Node<'_, '_>,
        file: usize,
        depth: usize,
    ) -> Result<Element, SceneError> {
        let mut element = Element {
            tag: node.tag_name().name().to_owned(),
            attributes: Vec::new(),
            children: Vec::new(),
            file,
            range: node.range(),
        };
        if depth > MAX_DEPTH {
            return Err(self.files.refuse(&element, format!("elements nest deeper than {MAX_DEPTH}")));
        }
        for attribute in node.attributes() {
            let value =
                self.substitute(attribute.value()).map_err(|problem| self.files.refuse(&element, problem))?;
            let range = attribute.range_value();
            element.attributes.push(Attribute { name: attribute.name().to_owned(), value, range });
        }
        for child in node.children().filter(roxmltree::Node::is_element) {
            let child = self.element(child, file, depth + 1)?;
            match child.tag.as_str() {
                "default" => self.default(&child)?,
                "path" => {
                    let value = self.required(&child, "value")?;
                    let path = self.files.folders[0].join(value);
                    self.files.folders.push(path);
                }
                "include" => {
                    let included = self.include(&child)?;
                    element.children.extend(included);
                    continue;
                }
                _ => {}
            }
            element.children.push(child);
        }
        Ok(element)
    }

    fn required<'e>(&self, element: &'e Element, name: &str) -> Result<&'e str, SceneError> {
        element.attribute(name).ok_or_else(|| {
            self.files.refuse(element, format!("<{}> needs the attribute {name}", element.tag))
        })
    }

    /// The first value of a name holds.
    fn default(&mut self, element: &Element) -> Result<(), SceneError> {
        if self.files.defaults.len() >= MAX_DEFAULTS {
            return Err(self
                .files
                .refuse(element, format!("the scene has more than {MAX_DEFAULTS} defaults")));
        }
        let (name, value) = (self.required(element, "name")?, self.required(element, "value")?);
        self.files.defaults.entry(name.to_owned()).or_insert_with(|| value.to_owned());
        Ok(())
    }

    /// Replaces `$name` by its value, the longest name that fits.
    fn substitute(&mut self, value: &str) -> Result<String, String> {
        if value.len() > MAX_VALUE {
            return Err(format!("a value has {} bytes, expected at most {MAX_VALUE}", value.len()));
        }
        let mut out = String::new();
        let mut rest = value;
        while let Some(at) = rest.find('$') {
            out.push_str(&rest[..at]);
            rest = &rest[at + 1..];
            let fits = self.files.defaults.iter().filter(|(name, _)| rest.starts_with(name.as_str()));
            let Some((name, value)) = fits.max_by_key(|(name, _)| name.len()) else {
                let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
                let name = &rest[..end];
                return Err(format!(
                    "${name} has no value; give it one with <default name=\"{name}\" value=…/>"
                ));
            };
            out.push_str(value);
            rest = &rest[name.len()..];
            if out.len() > MAX_VALUE {
                return Err(format!(
                    "a value grows longer than {MAX_VALUE} bytes when its $names are replaced"
                ));
            }
        }
        if rest.len() < value.len() {
            self.replaced += out.len() + rest.len();
            if self.replaced > MAX_BYTES {
                return Err(format!(
                    "the scene's values are longer than {MAX_BYTES} bytes together when their $names are replaced"
                ));
            }
        }
        out.push_str(rest);
        Ok(out)
    }

    /// The elements that an include stands for.
    fn include(&mut self, element: &Element) -> Result<Vec<Element>, SceneError> {
        let refuse = |files: &Files, problem: String| Err(files.refuse(element, problem));
        let name = self.required(element, "filename")?.to_owned();
        let Some(path) = self.files.find(&name) else {
            return refuse(&self.files, format!("include: {name:?} is no file"));
        };
        if let Ok(canonical) = path.canonicalize()
            && let Some(start) = self.open.iter().position(|(open, _)| *open == canonical)
        {
            let ring: Vec<&str> =
                self.open[start..].iter().map(|(_, file)| self.files.list[*file].name.as_str()).collect();
            let ring = format!("{} → {name}", ring.join(" → "));
            return refuse(&self.files, format!("includes go round in a circle: {ring}"));
        }
        if self.files.inclusions.len() >= MAX_INCLUDES || self.open.len() > MAX_INCLUDE_DEPTH {
            let problem = format!(
                "include {name:?}: a scene has at most {MAX_INCLUDES} includes, {MAX_INCLUDE_DEPTH} deep"
            );
            return refuse(&self.files, problem);
        }
        let file = match self.open(&path, name) {
            Ok(file) => file,
            Err(problem) => return refuse(&self.files, format!("include: {problem}")),
        };
        let (root, inner) = self.parse(file)?;
        let at = (element.file, element.range.clone());
        if root.tag == "scene" {
            self.files.inclusions.push(Inclusion { at, of: (file, inner) });
            return Ok(root.children);
        }
        self.files.inclusions.push(Inclusion { at, of: (file, root.range.clone()) });
        Ok(vec![root])
    }
}

/// The text of a scene file, or why there is none.
fn decoded(bytes: Vec<u8>) -> Result<String, String> {
    let other = match bytes[..] {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] | [b'<', 0, 0, 0, ..] | [0, 0, 0, b'<', ..] => {
            Some("UTF-32")
        }
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [b'<', 0, ..] | [0, b'<', ..] => Some("UTF-16"),
        _ => None,
    };
    if let Some(encoding) = other {
        return Err(format!("the encoding is {encoding}, expected UTF-8"));
    }
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        format!("line {line} is not encoded in UTF-8, as scenes must be")
    })
}

/// Where what starts at a byte ends, if it is a comment, character data or a processing instruction: in them `&`, `=` and quotes
/// mean themselves.
fn end_of_literal(text: &str, start: usize) -> Option<usize> {
    let literals = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
    let (open, close) = literals.into_iter().find(|(open, _)| text[start..].starts_with(open))?;
    let inside = start + open.len();
    Some(text[inside..].find(close).map_or(text.len(), |end| inside + end + close.len()))
}

/// The first `&#…;` of a document that names no XML character: the parser reads some of them as U+FFFD.
fn bad_reference(text: &str) -> Option<Range<usize>> {
    let mut at = 0;
    while let Some(start) = text[at..].find(['<', '&']).map(|found| at + found) {
        at = end_of_literal(text, start).unwrap_or(start + 1);
        let Some(number) = text[start..].strip_prefix("&#") else { continue };
        let digits = number.split(';').next().unwrap_or_default();
        let code = match digits.strip_prefix('x') {
            Some(digits) => u32::from_str_radix(digits, 16),
            None => digits.parse(),
        };
        if !code.ok().and_then(char::from_u32).is_some_and(is_xml_character) {
            return Some(start..start + "&#;".len() + digits.len());
        }
    }
    None
}

/// The first element with more than [`MAX_ATTRIBUTES`], by its first byte.
fn crowded(text: &str) -> Option<usize> {
    let bytes = text.as_bytes();
    let mut at = 0;
    while let Some(start) = text[at..].find('<').map(|found| at + found) {
        if let Some(end) = end_of_literal(text, start) {
            at = end;
            continue;
        }
        let (mut quote, mut count) = (None, 0);
        at = start + 1;
        while at < bytes.len() {
            match (quote, bytes[at]) {
                (Some(open), byte) if byte == open => quote = None,
                (Some(_), _) => {}
                (None, byte @ (b'"' | b'\'')) => quote = Some(byte),
                (None, b'>') => break,
                (None, b'=') => count += 1,
                _ => {}
            }
            if count > MAX_ATTRIBUTES {
                return Some(start);
            }
            at += 1;
        }
        // Past an ASCII byte, or at the end: a boundary of characters.
        at = (at + 1).min(text.len());
    }
    None
}

/// A line that names a value of the scene, short enough to be read.
fn shortened(line: &str) -> String {
    let characters = line.chars().count();
    if characters <= MAX_LINE {
        return line.to_owned();
    }
    let half = MAX_LINE / 2;
    let head: String = line.chars().take(half).collect();
    let tail: String = line.chars().skip(characters - half).collect();
    format!("{head}…{tail}")
}

/// What the parser found, without the position, which the message names already.
fn xml_problem(error: &roxmltree::Error) -> String {
    match error {
        roxmltree::Error::DtdDetected => {
            "a document type is refused (entities could grow without bound)".to_owned()
        }
        roxmltree::Error::NodesLimitReached => format!("the scene has more than {MAX_NODES} elements"),
        other => {
            let text = other.to_string();
            let text = text.rsplit_once(" at ").map_or(text.as_str(), |(text, _)| text).to_owned();
            format!("not XML: {text}")
        }
    }
}
