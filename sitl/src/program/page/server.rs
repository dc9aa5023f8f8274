//! The page's server: HTTP on a thread of its own, for readers on this machine.
//!
//! | path | what it gives |
//! |---|---|
//! | `/` | the page |
//! | `/events` | the feed as server-sent events, from its beginning or from `Last-Event-ID` on |
//! | `/flight.json` | all lines so far |
//! | `POST /control` | asks the vehicle for something, where the program was started with `--control` |
//!
//! A page of another site can make a browser ask this server, under a name that it points here (DNS rebinding):
//! every request must name this server as its host, and an origin, where one is told, must be this server. Steering
//! needs the token that the program has printed.

use std::convert::Infallible;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result};
use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::stream;
use serde::Deserialize;
use tokio::net::TcpListener;
use tokio::sync::{oneshot, watch};
use tokio::time::timeout;

use super::control::{PageControl, VehicleAction};
use super::document;
use super::feed::{Feed, FeedLine};
use crate::program::priority;

/// Bytes of lines that a reader is given at once.
const CHUNK: usize = 64 << 10;

/// Readers at once.
const READERS: usize = 32;

/// Silence after which a reader gets a comment, which tells either side that the other is there.
const PULSE: Duration = Duration::from_secs(10);

/// How long a reader is not woken again: what is told meanwhile comes at once, 20 times a second.
const BATCH: Duration = Duration::from_millis(50);

/// How long the last readers may take for the last lines.
const FAREWELL: Duration = Duration::from_secs(2);

/// Bytes of a request to steer.
const REQUEST: usize = 4 << 10;

/// Scripts and styles are inside the page; nothing comes from elsewhere, and no other page shows this one.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: \
                      blob:; font-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// A server that ends with this.
#[derive(Debug)]
pub struct WatchServer {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

#[derive(Debug)]
struct WatchSite {
    feed: Feed,
    page: Bytes,
    address: SocketAddr,
    control: Option<PageControl>,
    readers: AtomicUsize,
    /// What was made last; readers at the same place share it.
    chunk: Mutex<EventChunk>,
    /// Whether the server is about to end: readers get what there is, and no more.
    closing: watch::Receiver<bool>,
}

/// Lines as server-sent events.
#[derive(Debug, Clone, Default)]
struct EventChunk {
    /// Number of the first line.
    from: u64,
    /// Number of the line after them; `from` where there is none.
    next: u64,
    bytes: Bytes,
}

impl WatchSite {
    /// The lines from `from` on that a reader is given at once; `None` if there is none yet.
    fn chunk(&self, from: u64) -> Option<EventChunk> {
        // A chunk is there as a whole when somebody panics.
        let mut chunk = self.chunk.lock().unwrap_or_else(PoisonError::into_inner);
        if chunk.from != from || chunk.next == from {
            let lines = self.feed.from(from, CHUNK);
            let next = lines.last()?.number + 1;
            *chunk = EventChunk { from, next, bytes: events_of(&lines) };
        }
        Some(chunk.clone())
    }
}

impl WatchServer {
    /// Serves `feed` at `address`; port 0 is a free one.
    ///
    /// # Errors
    /// The address is taken, or none of this machine's.
    pub fn start(address: SocketAddr, feed: Feed, control: Option<PageControl>) -> Result<Self> {
        let listener = std::net::TcpListener::bind(address).with_context(|| format!("--watch {address}"))?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (stop, stopped) = oneshot::channel();
        let (close, closing) = watch::channel(false);
        let page = document::page().into();
        let (readers, chunk) = (AtomicUsize::new(0), Mutex::default());
        let site = Arc::new(WatchSite { feed, page, address, control, readers, chunk, closing });
        let work = async move {
            let Ok(listener) = TcpListener::from_std(listener) else { return };
            let router = router(&site);
            let serve = axum::serve(listener, router).with_graceful_shutdown(async move {
                // A sender that is gone stops the server too.
                let _ = stopped.await;
                close.send_replace(true);
            });
            // Nothing can be told to anybody.
            let _ = serve.await;
        };
        let thread = std::thread::Builder::new().name("watch".into()).spawn(move || {
            priority::give_way();
            runtime.block_on(work);
        })?;
        Ok(Self { address, stop: Some(stop), thread: Some(thread) })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Ends it when all readers have what there is, and soon at the latest.
    pub fn stop(&mut self) {
        drop(self.stop.take());
        let Some(thread) = self.thread.take() else { return };
        let step = Duration::from_millis(5);
        let steps = FAREWELL.as_millis() / step.as_millis();
        for _ in 0..steps {
            if thread.is_finished() {
                // It has not panicked, or there is nobody to tell.
                let _ = thread.join();
                return;
            }
            std::thread::sleep(step);
        }
    }
}

impl Drop for WatchServer {
    fn drop(&mut self) {
        self.stop();
    }
}

fn router(site: &Arc<WatchSite>) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/events", get(events))
        .route("/flight.json", get(lines))
        .route("/control", post(steer))
        .layer(middleware::from_fn_with_state(site.clone(), guard))
        .with_state(site.clone())
}

/// Refuses requests that another site's page has made.
async fn guard(State(site): State<Arc<WatchSite>>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let text = |name| headers.get(name).map(|value: &HeaderValue| value.to_str().unwrap_or(""));
    let host = text(HOST).unwrap_or("");
    let origin = text(ORIGIN);
    let is_ours = is_this_server(host, site.address)
        && origin.is_none_or(|origin| origin.strip_prefix("http://") == Some(host));
    if !is_ours {
        return (StatusCode::FORBIDDEN, "this server answers to its own address alone\n").into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert("x-content-type-options", HeaderValue::from_static("nosniff"));
    headers.insert("referrer-policy", HeaderValue::from_static("no-referrer"));
    response
}

/// Whether a Host header names the server at `address`: an address of the machine and no name that somebody else
/// can point at it.
fn is_this_server(host: &str, address: SocketAddr) -> bool {
    let Some((name, port)) = host.rsplit_once(':') else { return false };
    let name = name.strip_prefix('[').and_then(|n| n.strip_suffix(']')).unwrap_or(name);
    if port.parse() != Ok(address.port()) {
        return false;
    }
    match name.parse::<IpAddr>() {
        Ok(ip) => ip == address.ip() || ip.is_loopback() || address.ip().is_unspecified(),
        Err(_) => name == "localhost",
    }
}

fn typed(content: &'static str, body: impl Into<Body>) -> Response {
    ([(CONTENT_TYPE, content)], body.into()).into_response()
}

async fn page(State(site): State<Arc<WatchSite>>) -> Response {
    typed("text/html; charset=utf-8", site.page.clone())
}

async fn lines(State(site): State<Arc<WatchSite>>) -> Response {
    let text: Vec<_> = site.feed.all().iter().map(|line| line.text.to_string()).collect();
    typed("application/json", format!("[{}]", text.join(",\n")))
}

/// One more reader, for as long as this lives.
struct EventReader(Arc<WatchSite>);

impl EventReader {
    fn admit(site: Arc<WatchSite>) -> Option<Self> {
        if site.readers.fetch_add(1, Ordering::Relaxed) < READERS {
            return Some(Self(site));
        }
        site.readers.fetch_sub(1, Ordering::Relaxed);
        None
    }
}

impl Drop for EventReader {
    fn drop(&mut self) {
        self.0.readers.fetch_sub(1, Ordering::Relaxed);
    }
}

async fn events(State(site): State<Arc<WatchSite>>, headers: HeaderMap) -> Response {
    let Some(reader) = EventReader::admit(site) else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many readers\n").into_response();
    };
    let last = headers.get("last-event-id").and_then(|id| id.to_str().ok()?.parse::<u64>().ok());
    let from = last.map_or(0, |last| last.saturating_add(1));
    let chunks = stream::unfold((reader, from), |(reader, from)| async move {
        let (bytes, next) = next_chunk(&reader.0, from).await?;
        Some((Ok::<_, Infallible>(bytes), (reader, next)))
    });
    typed("text/event-stream", Body::from_stream(chunks))
}

/// What a reader who has everything before `from` is given next; `None` at the end.
async fn next_chunk(site: &WatchSite, from: u64) -> Option<(Bytes, u64)> {
    let (mut news, mut closing) = (site.feed.news(), site.closing.clone());
    loop {
        if let Some(chunk) = site.chunk(from) {
            return Some((chunk.bytes, chunk.next));
        }
        if *closing.borrow() {
            return None;
        }
        let woken = async {
            tokio::select! {
                _ = news.wait_for(|next| *next > from) => {}
                _ = closing.wait_for(|closing| *closing) => {}
            }
        };
        if timeout(PULSE, woken).await.is_err() {
            return Some((Bytes::from_static(b": nothing new\n\n"), from));
        }
        // The end of the server is no reason to wait.
        let _ = timeout(BATCH, closing.wait_for(|closing| *closing)).await;
    }
}

fn events_of(lines: &[FeedLine]) -> Bytes {
    let mut text = String::new();
    for line in lines {
        text += &format!("id: {}\ndata: {}\n\n", line.number, line.text);
    }
    text.into()
}

/// What a page asks for.
#[derive(Debug, Deserialize)]
struct SteerRequest {
    token: String,
    vehicle: u32,
    action: VehicleAction,
}

async fn steer(State(site): State<Arc<WatchSite>>, request: Request) -> Response {
    let answer = |status: StatusCode, ok: bool, text: &str| {
        let body = serde_json::json!({ "ok": ok, "text": text }).to_string();
        (status, typed("application/json", body)).into_response()
    };
    let Some(control) = &site.control else {
        return answer(StatusCode::FORBIDDEN, false, "this page only watches: start with --control");
    };
    let Ok(body) = axum::body::to_bytes(request.into_body(), REQUEST).await else {
        return answer(StatusCode::PAYLOAD_TOO_LARGE, false, "the request is too long");
    };
    let asked: SteerRequest = match serde_json::from_slice(&body) {
        Ok(asked) => asked,
        Err(error) => return answer(StatusCode::BAD_REQUEST, false, &error.to_string()),
    };
    if !control.is_token(&asked.token) {
        return answer(StatusCode::FORBIDDEN, false, "wrong token: it is in the address that was printed");
    }
    match control.ask(asked.vehicle, asked.action).await {
        Ok(text) => answer(StatusCode::OK, true, &text),
        Err(why) => answer(StatusCode::OK, false, &why),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readers_at_one_place_share_what_they_are_given() {
        let feed = Feed::default();
        let site = WatchSite {
            feed: feed.clone(),
            page: Bytes::new(),
            address: "127.0.0.1:8080".parse().unwrap(),
            control: None,
            readers: AtomicUsize::new(0),
            chunk: Mutex::default(),
            closing: watch::channel(false).1,
        };
        assert!(site.chunk(0).is_none());
        feed.log("info", 0.0, "a");
        let chunks = [0, 0].map(|from| site.chunk(from).unwrap());
        assert_eq!(chunks[0].bytes.as_ptr(), chunks[1].bytes.as_ptr());
        assert!(chunks[0].bytes.starts_with(b"id: 0\ndata: {") && site.chunk(1).is_none());
        feed.log("info", 0.0, "b");
        assert!(site.chunk(1).unwrap().bytes.starts_with(b"id: 1\n") && site.chunk(0).unwrap().next == 2);
    }

    #[test]
    fn only_this_machines_addresses_are_this_server() {
        let here: SocketAddr = "127.0.0.1:8080".parse().unwrap();
        for host in ["127.0.0.1:8080", "localhost:8080", "[::1]:8080"] {
            assert!(is_this_server(host, here), "{host}");
        }
        let others =
            ["127.0.0.1", "127.0.0.1:80", "evil.example:8080", "192.0.2.1:8080", "", "localhost.evil:8080"];
        for host in others {
            assert!(!is_this_server(host, here), "{host}");
        }
        let all: SocketAddr = "0.0.0.0:8080".parse().unwrap();
        assert!(is_this_server("192.0.2.1:8080", all) && !is_this_server("evil.example:8080", all));
    }
}
