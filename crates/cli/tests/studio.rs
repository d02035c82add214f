//! `pearl studio` and `pearl page` as their users meet them; what the server refuses is tested in `crates/studio`.
#![cfg(unix)]

mod built;

use built::{pearl, table};
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

struct Studio {
    child: Child,
    url: String,
}

impl Studio {
    fn open(start: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_pearl"))
            .args(["studio", "--no-browser"])
            .arg(start)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        Self { child, url: url.trim_end().to_owned() }
    }

    fn address(&self) -> &str {
        self.url.trim_start_matches("http://").split('/').next().unwrap()
    }

    /// The answer to a question with the token.
    fn get(&self, path: &str) -> Vec<u8> {
        let (address, token) = (self.address(), self.url.split_once("#token=").unwrap().1);
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nX-Nacre-Token: {token}\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_first_line_is_the_url_and_an_interruption_ends_it_well() {
    let folder = tempfile::tempdir().unwrap();
    let (mut of_table, of_recipe) = (Studio::open(&table(folder.path())), Studio::open(Path::new("akoya")));
    assert_ne!(of_table.address(), of_recipe.address());
    assert!(of_table.url.starts_with("http://127.0.0.1:"), "{}", of_table.url);
    let arrays = of_table.get("/api/initial");
    assert!(arrays.starts_with(b"HTTP/1.1 200") && arrays.windows(4).any(|four| four == b"PK\x03\x04"));
    let state = String::from_utf8(of_recipe.get("/api/state")).unwrap();
    assert!(state.contains(r#""name":"akoya""#), "{state}");
    let taken =
        pearl(&["studio", "--no-browser", "--port", of_table.address().split(':').next_back().unwrap()]);
    let why = String::from_utf8(taken.stderr).unwrap();
    assert!(
        taken.status.code() == Some(1) && why.starts_with("pearl: --port ") && why.lines().count() == 1,
        "{why}"
    );
    let kill = Command::new("kill").args(["-INT", &of_table.child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    assert_eq!(of_table.child.wait().unwrap().code(), Some(0));
}

#[test]
fn what_it_cannot_open_is_refused_in_one_line() {
    for (start, expected) in
        [("absent.exr", "bakes it"), ("absent.json", "absent.json"), ("--port=0", "--port")]
    {
        let said = pearl(&["studio", "--no-browser", start]);
        let why = String::from_utf8(said.stderr).unwrap();
        assert!(said.status.code() != Some(0) && said.stdout.is_empty(), "{start}");
        assert!(why.contains(expected) && why.lines().count() == 1, "{start}: {why}");
    }
}

#[test]
fn a_page_is_one_small_file_that_asks_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let (table, page) = (table(folder.path()), folder.path().join("page.html"));
    let said = pearl(&["page", table.to_str().unwrap(), "-o", page.to_str().unwrap()]);
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    let html = fs::read_to_string(&page).unwrap();
    assert!(html.len() < 3_000_000, "{} bytes", html.len());
    assert!(html.contains(r#"<script id="nacre-data" type="application/octet-stream;base64">UEsDB"#));
    assert!(
        html.contains("default-src 'none'")
            && html.contains(r#""nacre/npz.js":"data:text/javascript;base64,"#)
    );
    for elsewhere in ["<!-- importmap -->", "<!-- style -->", "src=\"http", "href=\"http", "\"/page/"] {
        assert!(!html.contains(elsewhere), "{elsewhere}");
    }
}
