//! Who may ask for what: checked before a body is read.

use hyper::header::{CONTENT_LENGTH, HOST, HeaderMap, ORIGIN};
use hyper::{Method, StatusCode};

/// Most bytes of a body.
pub(crate) const MOST_BYTES: usize = 1 << 20;
const TOKEN: &str = "x-nacre-token";

/// A request that is not answered: its status, and one line.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub(crate) status: StatusCode,
    pub(crate) line: String,
}

impl Refusal {
    pub(crate) fn new(status: StatusCode, line: impl Into<String>) -> Self {
        Self { status, line: line.into() }
    }

    pub(crate) fn bad(line: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, line)
    }
}

/// What a server is called, and what it wants to hear.
#[derive(Debug)]
pub(crate) struct Guard {
    port: u16,
    token: String,
}

impl Guard {
    /// With a fresh token.
    pub(crate) fn new(port: u16) -> Result<Self, getrandom::Error> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes)?;
        Ok(Self { port, token: bytes.iter().map(|byte| format!("{byte:02x}")).collect() })
    }

    pub(crate) fn url(&self) -> String {
        format!("http://127.0.0.1:{}/#token={}", self.port, self.token)
    }

    /// Whether a request may go on to its path. A page of another site that found our address (DNS rebinding) names its own host; one that
    /// asks across origins names its origin; neither knows the token.
    pub(crate) fn check(&self, method: &Method, path: &str, headers: &HeaderMap) -> Result<(), Refusal> {
        let forbidden = |line: &str| Err(Refusal::new(StatusCode::FORBIDDEN, line));
        let ours = [format!("127.0.0.1:{}", self.port), format!("localhost:{}", self.port)];
        let only = |name| {
            let mut values = headers.get_all(name).iter();
            let first = values.next().map(|value| value.to_str().unwrap_or_default());
            (first, values.next().is_some())
        };
        match only(HOST) {
            (Some(host), false) if ours.iter().any(|name| name == host) => {}
            _ => return forbidden("Host: is not this server"),
        }
        match only(ORIGIN) {
            (None, _) => {}
            (Some(origin), false) if ours.iter().any(|name| origin.strip_prefix("http://") == Some(name)) => {
            }
            _ => return forbidden("Origin: is another one"),
        }
        let posts = matches!(path, "/api/bake" | "/api/export");
        let right = if posts { Method::POST } else { Method::GET };
        if *method != right {
            return Err(Refusal::new(StatusCode::METHOD_NOT_ALLOWED, format!("{path}: expected {right}")));
        }
        if path.starts_with("/api/") {
            let given = headers.get(TOKEN).map(|value| value.as_bytes()).unwrap_or_default();
            if !same(given, self.token.as_bytes()) {
                return forbidden("X-Nacre-Token: is not that of this server; open the URL that it printed");
            }
        }
        let length = headers.get(CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
        if length.is_some_and(|length| length > MOST_BYTES as u64) {
            return Err(too_large());
        }
        Ok(())
    }
}

pub(crate) fn too_large() -> Refusal {
    Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, format!("the body is longer than {MOST_BYTES} bytes"))
}

/// In a time that does not tell how much is alike.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |off, (a, b)| off | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use hyper::header::{HeaderName, HeaderValue};

    fn asked(guard: &Guard, method: Method, path: &str, headers: &[(&'static str, &str)]) -> u16 {
        let map = headers
            .iter()
            .map(|(name, value)| (HeaderName::from_static(name), HeaderValue::from_str(value).unwrap()));
        guard.check(&method, path, &map.collect()).err().map_or(200, |refusal| refusal.status.as_u16())
    }

    #[test]
    fn only_our_own_page_with_the_token_is_let_in() {
        let guard = Guard::new(80).unwrap();
        let (host, token) = (("host", "127.0.0.1:80"), ("x-nacre-token", guard.token.as_str()));
        let get = |path, headers: &[_]| asked(&guard, Method::GET, path, headers);
        assert_eq!(get("/", &[host]), 200);
        assert_eq!(get("/", &[("host", "localhost:80"), ("origin", "http://127.0.0.1:80")]), 200);
        assert_eq!(get("/", &[]), 403);
        for host in ["127.0.0.1", "127.0.0.1:81", "pearl.example:80", "127.0.0.1:80.pearl.example", ""] {
            assert_eq!(get("/", &[("host", host)]), 403, "{host}");
        }
        for origin in ["null", "http://pearl.example", "https://127.0.0.1:80", "http://127.0.0.1:81"] {
            assert_eq!(get("/", &[host, ("origin", origin)]), 403, "{origin}");
        }
        assert_eq!(get("/api/state", &[host]), 403);
        assert_eq!(get("/api/state", &[host, ("x-nacre-token", "0")]), 403);
        assert_eq!(get("/api/state", &[host, token]), 200);
        assert_eq!(get("/api/bake", &[host, token]), 405);
        assert_eq!(
            asked(&guard, Method::POST, "/api/bake", &[host, token, ("content-length", "1048577")]),
            413
        );
        assert_eq!(asked(&guard, Method::DELETE, "/", &[host]), 405);
    }

    #[test]
    fn every_server_has_its_own_token() {
        assert_ne!(Guard::new(1).unwrap().token, Guard::new(1).unwrap().token);
    }
}
