//! What a browser, and who else finds the port, gets from the server.

use bake_brdf::recipe::Recipe;
use serde_json::{Value, json};
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use studio::{Server, Settings, Start};

/// A server that ends with its test.
struct Running {
    port: u16,
    token: String,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Running {
    fn start() -> Self {
        let recipe = Recipe::from_json(r#"{"name": "thin", "stack": {"layers": 8}}"#).unwrap();
        let server = Server::bind(Settings::new(Start::Recipe(recipe))).unwrap();
        let url = server.url();
        let (place, token) = url.split_once("/#token=").unwrap();
        let port = place.rsplit_once(':').unwrap().1.parse().unwrap();
        let stop = Arc::<AtomicBool>::default();
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || server.run(&flag).unwrap());
        Self { port, token: token.to_owned(), stop, thread: Some(thread) }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        stream
    }

    /// Status, head and body of what is answered to a text.
    fn raw(&self, text: &[u8]) -> (u16, String, Vec<u8>) {
        let mut stream = self.connect();
        // A server that has heard enough may close before all is sent.
        let _ = stream.write_all(text);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap_or(answer.len());
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
        (status, head, answer.get(end + 4..).unwrap_or_default().to_vec())
    }

    fn head(&self, method: &str, path: &str, headers: &str) -> String {
        let (port, token) = (self.port, &self.token);
        format!(
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nX-Nacre-Token: {token}\r\n{headers}\r\n"
        )
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        self.raw(self.head("GET", path, "").as_bytes())
    }

    fn post(&self, path: &str, body: &[u8]) -> (u16, String, Vec<u8>) {
        let head = self.head("POST", path, &format!("Content-Length: {}\r\n", body.len()));
        self.raw(&[head.as_bytes(), body].concat())
    }

    fn order(&self, path: &str, body: &Value) -> (u16, String, Vec<u8>) {
        self.post(path, body.to_string().as_bytes())
    }

    fn is_alive(&self) -> bool {
        self.get("/api/state").0 == 200
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(std::thread::JoinHandle::join);
        assert!(ended.is_some_and(|ended| ended.is_ok()) || std::thread::panicking());
    }
}

/// The line of an error.
fn line(body: &[u8]) -> String {
    let body: Value = serde_json::from_slice(body).unwrap();
    let line = body["error"].as_str().unwrap().to_owned();
    assert!(!line.contains(char::is_control) && !line.is_empty(), "{line:?}");
    line
}

#[test]
fn it_bakes_and_hands_out() {
    let server = Running::start();
    let (status, head, state) = server.get("/api/state");
    let state: Value = serde_json::from_slice(&state).unwrap();
    assert_eq!(
        (status, &state["name"], &state["recipe"]["stack"]["layers"]),
        (200, &json!("thin"), &json!(8))
    );
    assert_eq!(state["recipes"].as_array().unwrap().len(), bake_brdf::recipe::BUILT_IN.len());
    assert!(head.contains("x-content-type-options: nosniff"), "{head}");
    let (status, head, arrays) = server.get("/api/initial");
    assert!(status == 200 && head.contains("x-nacre-seconds: ") && arrays.starts_with(b"PK"), "{head}");
    for quality in ["coarse", "fine"] {
        let recipe = json!({"name": "ten", "stack": {"layers": 10}});
        let order = json!({"recipe": recipe, "quality": quality, "request": 1});
        let (status, _, arrays) = server.order("/api/bake", &order);
        assert!(status == 200 && arrays.starts_with(b"PK"), "{status} {}", String::from_utf8_lossy(&arrays));
    }
    let state: Value = serde_json::from_slice(&server.get("/api/state").2).unwrap();
    assert_eq!(state["recipe"]["stack"]["layers"], 10);
    let (status, head, table) = server.order("/api/export", &json!({"format": "table"}));
    assert!(status == 200 && head.contains("attachment; filename=\"ten.exr\""), "{head}");
    assert_eq!(lut_io::exr_file::decode(&table).unwrap().meta().recipe["stack"]["layers"], 10);
    let (status, _, recipe) = server.order("/api/export", &json!({"recipe": "akoya", "format": "recipe"}));
    let recipe: Value = serde_json::from_slice(&recipe).unwrap();
    assert_eq!((status, recipe["name"].as_str()), (200, Some("akoya")));
    let (status, _, npz) = server.order("/api/export", &json!({"recipe": "current", "format": "arrays"}));
    assert!(status == 200 && npz.starts_with(b"PK"));
}

#[test]
fn who_is_not_our_page_is_refused_in_one_line() {
    let server = Running::start();
    let (port, token) = (server.port, format!("X-Nacre-Token: {}\r\n", server.token));
    let state = |headers: &str| {
        let (status, _, body) = server.raw(format!("GET /api/state HTTP/1.1\r\n{headers}\r\n").as_bytes());
        (status, line(&body))
    };
    assert_eq!(state(&format!("Host: pearl.example:{port}\r\n{token}")).0, 403);
    assert_eq!(state(&format!("Host: 127.0.0.1:{port}\r\nHost: pearl.example\r\n{token}")).0, 403);
    assert_eq!(state(&format!("Host: 127.0.0.1:{port}\r\nOrigin: http://pearl.example\r\n{token}")).0, 403);
    let (status, why) = state(&format!("Host: 127.0.0.1:{port}\r\n"));
    assert!(status == 403 && why.contains("open the URL"), "{why}");
    let (status, _, body) = server.raw(server.head("PUT", "/api/bake", "").as_bytes());
    assert_eq!((status, line(&body)), (405, "/api/bake: expected POST".to_owned()));
    assert!(server.is_alive());
}

#[test]
fn no_path_leads_to_the_file_system() {
    let server = Running::start();
    for path in [
        "/../Cargo.toml",
        "/page/../Cargo.toml",
        "/page/%2e%2e/Cargo.toml",
        "/page//etc/passwd",
        "/page/",
        "/page/..%2f..%2fCargo.toml",
        "//",
        "/etc/passwd",
        "/page/\\..\\Cargo.toml",
    ] {
        let (status, _, body) = server.get(path);
        // What is no path at all is refused by the HTTP library.
        assert!(status == 400 || status == 404 && line(&body) == "no such page", "{path}: {status}");
    }
    for recipe in ["../paper.json", "/etc/passwd", "", "paper.json"] {
        let (status, _, body) = server.order("/api/bake", &json!({"recipe": recipe, "quality": "coarse"}));
        assert!(status == 400 && line(&body).contains("is none; expected an object or one of"));
    }
}

#[test]
fn bad_orders_are_refused_in_one_line() {
    let server = Running::start();
    let slow = json!({
        "stack": {"layers": 100_000}, "facets": {"slope_sd_deg": 0.05}, "azimuth": {"mode": "space"},
    });
    for (body, expected) in [
        (json!({"quality": "coarse"}), "missing field `recipe`"),
        (json!({"recipe": {}, "quality": "best"}), "unknown variant `best`"),
        (json!({"recipe": {"stack": {"layers": 0}}, "quality": "coarse"}), "recipe: stack.layers: "),
        (json!({"recipe": {"look": {"depth": 2}}, "quality": "fine"}), "recipe: look.depth: 2 is not valid"),
        (json!({"recipe": {"stakc": {}}, "quality": "fine"}), "unknown field `stakc`"),
        (json!({"recipe": [], "quality": "fine"}), "recipe: [] is none; expected an object"),
        (json!({"recipe": slow, "quality": "fine"}), "recipe: "),
    ] {
        let (status, _, answer) = server.order("/api/bake", &body);
        assert!(status == 400 && line(&answer).contains(expected), "{body}: {status} {}", line(&answer));
    }
    let (status, _, body) = server.order("/api/export", &json!({"format": "../x"}));
    assert!(
        status == 400 && line(&body).starts_with("format: \"../x\" is none; expected table, recipe, arrays")
    );
    let nested = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let (status, _, body) = server.post("/api/bake", nested.as_bytes());
    assert_eq!((status, line(&body).is_empty()), (400, false));
    let (status, _, body) = server.post("/api/bake", b"\xff\xfe\n\"");
    assert_eq!((status, line(&body).is_empty()), (400, false));
    assert!(server.is_alive());
}

/// Resident memory of this process, MB: the server's and the test's.
#[cfg(target_os = "linux")]
fn resident_mb() -> f64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
    pages.split(' ').nth(1).unwrap().parse::<f64>().unwrap() * 4096.0 / 1e6
}

#[cfg(target_os = "linux")]
#[test]
fn floods_end_and_take_no_memory() {
    let server = Running::start();
    assert!(server.is_alive());
    let before = resident_mb();
    // A body of 100 MB: said, and not said but sent in chunks.
    let said = server.head("POST", "/api/bake", "Content-Length: 100000000\r\n");
    let (status, _, body) = server.raw(said.as_bytes());
    assert!(status == 413 && line(&body).contains("longer than"), "{status}");
    let mut stream = server.connect();
    stream.write_all(server.head("POST", "/api/bake", "Transfer-Encoding: chunked\r\n").as_bytes()).unwrap();
    let chunk = [b"10000\r\n".to_vec(), vec![b' '; 0x10000], b"\r\n".to_vec()].concat();
    let sent = (0..1600).take_while(|_| stream.write_all(&chunk).is_ok()).count();
    assert!(sent < 1600, "all of 100 MB was taken");
    // A head without an end.
    let (status, _, _) = server.raw(&[b"GET / HTTP/1.1\r\nX: ".to_vec(), vec![b'x'; 1 << 20]].concat());
    assert!(matches!(status, 0 | 431), "{status}");
    // A thousand requests at once.
    let answers: Vec<u16> = std::thread::scope(|scope| {
        let ask = || (0..50).map(|_| server.get("/api/state").0).collect::<Vec<_>>();
        let threads: Vec<_> = (0..20).map(|_| scope.spawn(ask)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(answers, [200; 1000]);
    assert!(server.is_alive());
    let grown = resident_mb() - before;
    assert!(grown < 100.0, "{grown} MB more");
}

#[test]
fn sockets_left_open_lose_their_places() {
    let server = Running::start();
    // More than there are places: silent, half a head, half a body.
    let body = server.head("POST", "/api/bake", "Content-Length: 100\r\n") + "{";
    let open: Vec<TcpStream> = (0..90)
        .map(|k| {
            let mut stream = server.connect();
            stream.write_all(["", "GET /api/state HT", &body][k % 3].as_bytes()).unwrap();
            stream
        })
        .collect();
    let started = Instant::now();
    assert!(server.is_alive());
    assert!(started.elapsed() < Duration::from_secs(30), "{:?}", started.elapsed());
    drop(open);
}

#[test]
fn a_later_bake_overtakes_an_earlier_one() {
    let server = Running::start();
    let order =
        |n: u64, recipe: Value, quality: &str| json!({"recipe": recipe, "quality": quality, "request": n});
    // Seconds of work, were it not overtaken.
    let slow = json!({"stack": {"layers": 500}, "facets": {"slope_sd_deg": 1}, "azimuth": {"mode": "space"}});
    std::thread::scope(|scope| {
        let earlier = scope.spawn(|| server.order("/api/bake", &order(1, slow, "fine")));
        std::thread::sleep(Duration::from_millis(200));
        let (status, _, _) = server.order("/api/bake", &order(2, json!({"stack": {"layers": 6}}), "coarse"));
        assert_eq!(status, 200);
        let (status, _, body) = earlier.join().unwrap();
        assert_eq!((status, line(&body)), (409, "request 1: a later one came".to_owned()));
    });
}

#[test]
fn two_servers_take_two_ports_and_a_port_that_is_taken_is_refused() {
    let (a, b) = (Running::start(), Running::start());
    assert_ne!((a.port, &a.token), (b.port, &b.token));
    let settings = Settings { port: Some(a.port), ..Settings::new(Start::Recipe(Recipe::default())) };
    let error = Server::bind(settings).unwrap_err().to_string();
    assert!(error.starts_with(&format!("port {}: ", a.port)) && !error.contains('\n'), "{error}");
}
