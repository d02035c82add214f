//! Milliseconds from an order to its arrays, and their parts; of a coarse order that overtakes a fine one, too: least, median and most of
//! many.
//! `cargo run --release -p nacre-studio --example latency [RECIPE] [coarse|fine] [TIMES]`

use bake_brdf::recipe::Recipe;
use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
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
    let order = |quality: &str| -> std::io::Result<TcpStream> {
        let body = format!(r#"{{"recipe": "{recipe}", "quality": "{quality}"}}"#);
        let mut stream = TcpStream::connect(address)?;
        write!(
            stream,
            "POST /api/bake HTTP/1.1\r\nHost: {address}\r\nX-Nacre-Token: {token}\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        )?;
        Ok(stream)
    };
    let mut longest = Duration::ZERO;
    for _ in 0..times {
        let started = Instant::now();
        let mut answer = Vec::new();
        order(&quality)?.read_to_end(&mut answer)?;
        longest = longest.max(started.elapsed());
        parts.entry("all".to_owned()).or_default().push(1e3 * started.elapsed().as_secs_f64());
        let text = String::from_utf8_lossy(&answer[..answer.len().min(2000)]).into_owned();
        let timing =
            text.lines().find_map(|line| line.strip_prefix("server-timing: ")).ok_or(text.clone())?;
        for part in timing.split(", ") {
            let (name, milliseconds) = part.split_once(";dur=").ok_or("no duration")?;
            parts.entry(name.to_owned()).or_default().push(milliseconds.parse()?);
        }
    }
    // Overtaken early and late.
    for k in 0..times {
        let overtaken = order("fine")?;
        std::thread::sleep(longest.mul_f64(k as f64 / times as f64));
        let started = Instant::now();
        order("coarse")?.read_to_end(&mut Vec::new())?;
        parts.entry("coarse, overtaking".to_owned()).or_default().push(1e3 * started.elapsed().as_secs_f64());
        drop(overtaken);
    }
    for (name, mut all) in parts {
        all.sort_by(f64::total_cmp);
        let [least, median, most] = [0, all.len() / 2, all.len() - 1].map(|at| all[at]);
        println!("{name:18} least {least:7.1} ms, median {median:7.1} ms, most {most:7.1} ms");
    }
    stop.store(true, Ordering::Relaxed);
    thread.join().map_err(|_| "the server failed")??;
    Ok(())
}
