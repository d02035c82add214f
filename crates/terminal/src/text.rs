//! Text files as tools read them: UTF-8, with or without a byte-order mark; `-` is standard input.

use crate::Stop;
use std::fmt::Display;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::Path;

/// Opens a text file behind its byte-order mark.
///
/// # Errors
/// What cannot be read, or begins as text in UTF-16 or UTF-32 does, is bad input.
pub fn open_text(path: &Path) -> Result<impl BufRead + use<>, Stop> {
    let source: Box<dyn Read> = if path.as_os_str() == "-" {
        Box::new(std::io::stdin())
    } else {
        Box::new(File::open(path).map_err(|error| refuse(path, error))?)
    };
    let mut source = BufReader::new(source);
    let mut start = Vec::new();
    (&mut source).take(4).read_to_end(&mut start).map_err(|error| refuse(path, error))?;
    if let Some(encoding) = foreign_encoding(&start) {
        return Err(refuse(path, format!("the encoding is {encoding}, expected UTF-8")));
    }
    let marked = start.starts_with("\u{feff}".as_bytes());
    let start = start.split_off(if marked { 3 } else { 0 });
    Ok(Cursor::new(start).chain(source))
}

/// Reads a text file of at most `most` bytes.
///
/// # Errors
/// As [`open_text`]; a longer file, and one that is not UTF-8, are bad input.
pub fn read_text(path: &Path, most: u64) -> Result<String, Stop> {
    let mut bytes = Vec::new();
    open_text(path)?.take(most + 1).read_to_end(&mut bytes).map_err(|error| refuse(path, error))?;
    if bytes.len() as u64 > most {
        return Err(refuse(path, format!("is longer than {most} bytes")));
    }
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        refuse(path, format!("line {line} is not encoded in UTF-8"))
    })
}

fn refuse(path: &Path, why: impl Display) -> Stop {
    Stop::bad_input(format!("{}: {why}", path.display()))
}

/// The encoding of a text whose first characters are a byte-order mark or ASCII (RFC 4627 §3), if it is not UTF-8.
fn foreign_encoding(start: &[u8]) -> Option<&'static str> {
    match start {
        [0, 0, 0, 0] => None,
        [0xff, 0xfe, 0, 0] | [0, 0, 0xfe, 0xff] | [_, 0, 0, 0] | [0, 0, 0, _] => Some("UTF-32"),
        [0, 0, ..] => None,
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [_, 0, ..] | [0, _, ..] => Some("UTF-16"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<String, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        std::fs::write(&path, bytes).unwrap();
        read_text(&path, 40).map_err(|stop| match stop {
            Stop::BadInput(line) => line.strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned(),
            other => panic!("{other:?}"),
        })
    }

    #[test]
    fn a_byte_order_mark_is_no_text() {
        for text in ["", "{", "{}", "{\"name\": \"π\"}"] {
            assert_eq!(read(text.as_bytes()).unwrap(), text);
            assert_eq!(read(format!("\u{feff}{text}").as_bytes()).unwrap(), text);
        }
        // A second one is a character that belongs to the text.
        assert_eq!(read("\u{feff}\u{feff}a".as_bytes()).unwrap(), "\u{feff}a");
    }

    #[test]
    fn other_encodings_are_refused_by_name() {
        let wide = |mark: &str, bytes: fn(u32) -> Vec<u8>| -> Vec<u8> {
            format!("{mark}{{}}\n").chars().flat_map(|c| bytes(u32::from(c))).collect()
        };
        for mark in ["", "\u{feff}"] {
            for (name, bytes) in [
                ("UTF-16", (|c| (c as u16).to_le_bytes().to_vec()) as fn(u32) -> Vec<u8>),
                ("UTF-16", |c| (c as u16).to_be_bytes().to_vec()),
                ("UTF-32", |c| c.to_le_bytes().to_vec()),
                ("UTF-32", |c| c.to_be_bytes().to_vec()),
            ] {
                let expected = format!("the encoding is {name}, expected UTF-8");
                assert_eq!(read(&wide(mark, bytes)).unwrap_err(), expected);
            }
        }
        assert_eq!(read(b"{\n\"name\": \"na\xefve\"}").unwrap_err(), "line 2 is not encoded in UTF-8");
    }

    #[test]
    fn the_longest_text_is_read_and_a_longer_one_is_not() {
        assert_eq!(read(&[b'a'; 40]).unwrap().len(), 40);
        assert_eq!(read(&[b'a'; 41]).unwrap_err(), "is longer than 40 bytes");
    }
}
