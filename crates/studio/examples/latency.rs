//! Milliseconds from an order to its arrays, and their parts: least and median of many.
//! `cargo run --release -p nacre-studio --example latency [RECIPE] [coarse|fine] [TIMES]`

use bake_brdf::recipe::Recipe;
use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use studio::{Server, Settings, Start};

#[allow(clippy::print_stdout)] // an example speaks
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let given = |n: usize, default: &str| std::env::args().nth(n).unwrap_or_else(|| default.to_owned());
    let (recipe, quality, times) = (given(1, "paper"), given(2, "coarse"), given(3, "20").parse::<usize>()?);
    let server = Server::bind(Settings::new(Start::Recipe(Recipe::default())))?;
    let url = server.url();
    let (address, token) = url.trim_start_matches("http://").split_once("/#token=").ok_or("no token")?;
    let stop = Arc::<AtomicBool>::default();
    let flag = Arc::clone(&stop);
    let thread = std::thread::spawn(move || server.run(&flag));
    let mut parts: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for _ in 0..times {
        let body = format!(r#"{{"recipe": "{recipe}", "quality": "{quality}"}}"#);
        let started = Instant::now();
        let mut stream = TcpStream::connect(address)?;
        write!(
            stream,
            "POST /api/bake HTTP/1.1\r\nHost: {address}\r\nX-Nacre-Token: {token}\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        )?;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer)?;
        parts.entry("all".to_owned()).or_default().push(1e3 * started.elapsed().as_secs_f64());
        let text = String::from_utf8_lossy(&answer[..answer.len().min(2000)]).into_owned();
        let timing =
            text.lines().find_map(|line| line.strip_prefix("server-timing: ")).ok_or(text.clone())?;
        for part in timing.split(", ") {
            let (name, milliseconds) = part.split_once(";dur=").ok_or("no duration")?;
            parts.entry(name.to_owned()).or_default().push(milliseconds.parse()?);
        }
    }
    for (name, mut all) in parts {
        all.sort_by(f64::total_cmp);
        println!("{name:8} least {:7.1} ms, median {:7.1} ms", all[0], all[all.len() / 2]);
    }
    stop.store(true, Ordering::Relaxed);
    thread.join().map_err(|_| "the server failed")??;
    Ok(())
}
