//! Connections: bounded in number, in time and in what they may send.

use crate::api::{self, Studio};
use crate::guard::{Guard, MOST_BYTES, Refusal, too_large};
use crate::{Settings, StudioError};
use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    CACHE_CONTROL, CONNECTION, HeaderName, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

/// Connections at a time; more wait for their turn.
const CONNECTIONS: usize = 64;
/// Longest waits for a head, for a body, and for all of a connection: the longest bake and its download.
const HEAD: Duration = Duration::from_secs(5);
const BODY: Duration = Duration::from_secs(10);
const ALL: Duration = Duration::from_secs(180);
/// Between two looks at whether to end.
const LOOK: Duration = Duration::from_millis(50);
/// Most bytes of a head.
const HEAD_BYTES: usize = 16 << 10;
/// Errors of `accept` pass: no descriptor is free, a peer is gone.
const PAUSE: Duration = Duration::from_millis(20);

/// The simulator, listening.
pub struct Server {
    listener: std::net::TcpListener,
    guard: Arc<Guard>,
    studio: Arc<Studio>,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("listener", &self.listener).finish_non_exhaustive()
    }
}

impl Server {
    /// Listens on the loopback interface; from now on its URL can be asked for.
    ///
    /// # Errors
    /// A port that is taken.
    pub fn bind(settings: Settings) -> Result<Self, StudioError> {
        let Settings { start, port, threads } = settings;
        let port = port.unwrap_or(0);
        let failed = |source| StudioError::Port { port, source };
        let listener = std::net::TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let port = listener.local_addr().map_err(failed)?.port();
        let guard = Arc::new(Guard::new(port).map_err(StudioError::Random)?);
        Ok(Self { listener, guard, studio: Arc::new(Studio::new(start, threads)?) })
    }

    /// Where the page is, with the token.
    #[must_use]
    pub fn url(&self) -> String {
        self.guard.url()
    }

    /// Answers until the flag is set.
    ///
    /// # Errors
    /// The system fails.
    pub fn run(self, stop: &AtomicBool) -> Result<(), StudioError> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().max_blocking_threads(2).build()?;
        runtime.block_on(self.serve(stop))?;
        // An export that is under way ends by itself.
        runtime.shutdown_background();
        Ok(())
    }

    async fn serve(self, stop: &AtomicBool) -> Result<(), StudioError> {
        let listener = TcpListener::from_std(self.listener)?;
        let places = Arc::new(Semaphore::new(CONNECTIONS));
        while !stop.load(Ordering::Relaxed) {
            let Ok(Ok(place)) = timeout(LOOK, Arc::clone(&places).acquire_owned()).await else { continue };
            let stream = match timeout(LOOK, listener.accept()).await {
                Ok(Ok((stream, _))) => stream,
                Ok(Err(_)) => {
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
                Err(_) => continue,
            };
            let (guard, studio) = (Arc::clone(&self.guard), Arc::clone(&self.studio));
            tokio::spawn(async move {
                // What goes wrong is the peer's: it left, or was too slow.
                let _ = timeout(ALL, connection(stream, &guard, &studio)).await;
                drop(place);
            });
        }
        Ok(())
    }
}

async fn connection(stream: TcpStream, guard: &Guard, studio: &Studio) -> hyper::Result<()> {
    let service = service_fn(|request| async { Ok::<_, Infallible>(respond(request, guard, studio).await) });
    http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .max_buf_size(HEAD_BYTES)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service)
        .await
}

async fn respond(request: Request<Incoming>, guard: &Guard, studio: &Studio) -> Response<Full<Bytes>> {
    let answer = answer(request, guard, studio).await;
    let mut response = answer.unwrap_or_else(|refusal| api::refused(&refusal));
    let headers = response.headers_mut();
    for (name, value) in [
        (CACHE_CONTROL, "no-store"),
        (CONNECTION, "close"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn answer(
    request: Request<Incoming>,
    guard: &Guard,
    studio: &Studio,
) -> Result<Response<Full<Bytes>>, Refusal> {
    let (head, body) = request.into_parts();
    let path = head.uri.path();
    guard.check(&head.method, path, &head.headers)?;
    let slow = |_| Refusal::new(StatusCode::REQUEST_TIMEOUT, "the body does not come");
    let body = timeout(BODY, Limited::new(body, MOST_BYTES).collect()).await.map_err(slow)?;
    let body = body.map_err(|_| too_large())?.to_bytes();
    studio.answer(path, &body).await
}
