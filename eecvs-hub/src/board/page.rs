//! The board over HTTP: a page, its data, pictures, and metrics.
//!
//! ```text
//! GET /                      the page, with its script
//! GET /sensors.json          an Overview; ?see=NAME&see=NAME names the pictures being looked at
//! GET /picture/NAME.png      a sensor's latest window
//! GET /metrics               OpenMetrics
//! ```
//!
//! There is no password: anyone who can connect can read everything, and nobody can change anything. Foreign pages in
//! a reader's browser cannot read it: no other origin is admitted, and requests addressed to a host name other than
//! localhost are refused, since a foreign page's host name may resolve to this address.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use axum::Router;
use axum::body::Bytes;
use axum::extract::{Path, RawQuery, Request, State};
use axum::http::header::{self, HeaderValue};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use usb_bridge::stop::Stop;

use super::Board;
use super::connections::Bounded;
use crate::key::Name;

/// The page, without its script.
const PAGE: &str = include_str!("page.html");

/// The script, which is inserted into the page; it fetches only figures and pictures.
const SCRIPT: &str = include_str!("page.js");

/// Placeholder in [`PAGE`] for the script.
const SCRIPT_HERE: &str = "{script}";

/// Placeholder in [`PAGE`] for the nonce.
const NONCE: &str = "{nonce}";

/// How long a generated answer is reused, for all clients.
const FRESH: Duration = Duration::from_millis(500);

/// Maximum number of pictures that one page looks at.
const SEEN_MAX: usize = 256;

/// Interval at which the stop request is checked.
const LOOK: Duration = Duration::from_millis(50);

/// State shared by requests.
struct Shared {
    board: Arc<Board>,
    overview: Mutex<Option<(Instant, Bytes)>>,
    metrics: Mutex<Option<(Instant, Bytes)>>,
}

/// Serves the board's page until a stop is requested.
///
/// # Errors
/// The listener cannot be used. Failing connections are not errors.
pub fn serve(board: Arc<Board>, listener: std::net::TcpListener, stop: Stop) -> Result<()> {
    listener
        .set_nonblocking(true)
        .context("starting the page's listener")?;
    // Pictures are decoded in a separate thread, one at a time: a page full of them uses at most one core.
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .max_blocking_threads(1)
        .build()
        .context("starting the page's runtime")?;
    let served = runtime.block_on(async move {
        let listener =
            tokio::net::TcpListener::from_std(listener).context("starting the page's listener")?;
        let router = router(board);
        tokio::spawn(async move {
            // The server never ends, and so returns no error.
            let _ = axum::serve(Bounded::new(listener), router).await;
        });
        while !stop.is_asked() {
            tokio::time::sleep(LOOK).await;
        }
        Ok(())
    });
    // Do not wait for a picture that is being decoded.
    runtime.shutdown_background();
    served
}

fn router(board: Arc<Board>) -> Router {
    let shared = Arc::new(Shared {
        board,
        overview: Mutex::default(),
        metrics: Mutex::default(),
    });
    Router::new()
        .route("/", get(page))
        .route("/sensors.json", get(sensors))
        .route("/metrics", get(metrics))
        .route("/picture/{*name}", get(picture))
        .with_state(shared)
        .layer(middleware::from_fn(guard))
}

/// Returns whether a request is addressed to an IP address or localhost, and not to a name that happens to resolve
/// to this computer.
fn is_own(headers: &HeaderMap, uri: &Uri) -> bool {
    let host = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok());
    let is_own = |host: &str| {
        let port = host.rfind(':').filter(|_| !host.ends_with(']'));
        // A bare IPv6 address has no brackets: its colons do not separate a port.
        let is_bare = host.parse::<IpAddr>().is_ok();
        let name = host.get(..port.filter(|_| !is_bare).unwrap_or(host.len()));
        let name = name.unwrap_or_default();
        let bare = name
            .strip_prefix('[')
            .and_then(|name| name.strip_suffix(']'));
        name.eq_ignore_ascii_case("localhost") || bare.unwrap_or(name).parse::<IpAddr>().is_ok()
    };
    host.is_some_and(is_own) && uri.host().is_none_or(is_own)
}

async fn guard(request: Request, next: Next) -> Response {
    let mut response = if is_own(request.headers(), request.uri()) {
        next.run(request).await
    } else {
        let text = "use an IP address or localhost to open this page\n";
        (StatusCode::MISDIRECTED_REQUEST, text).into_response()
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "no-store"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    let policy = headers.entry(header::CONTENT_SECURITY_POLICY);
    policy.or_insert(HeaderValue::from_static(
        "default-src 'none'; frame-ancestors 'none'",
    ));
    response
}

/// Returns an unpredictable number: the standard library seeds its hashers with the system's random numbers.
fn nonce() -> String {
    let random = || RandomState::new().build_hasher().finish();
    format!("{:016x}{:016x}", random(), random())
}

async fn page() -> Response {
    let nonce = nonce();
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src 'self' data:; \
         connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8".to_owned()),
        (header::CONTENT_SECURITY_POLICY, policy),
    ];
    let page = PAGE.replace(SCRIPT_HERE, SCRIPT).replace(NONCE, &nonce);
    (headers, page).into_response()
}

/// Returns the recent answer, or makes a new one: any number of readers costs as much as one.
fn fresh(kept: &Mutex<Option<(Instant, Bytes)>>, make: impl FnOnce() -> Vec<u8>) -> Bytes {
    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    match &*kept {
        Some((made, bytes)) if made.elapsed() < FRESH => bytes.clone(),
        _ => {
            let bytes = Bytes::from(make());
            *kept = Some((Instant::now(), bytes.clone()));
            bytes
        }
    }
}

async fn sensors(State(shared): State<Arc<Shared>>, RawQuery(query): RawQuery) -> Response {
    let query = query.unwrap_or_default();
    let seen = query
        .split('&')
        .filter_map(|part| part.strip_prefix("see="));
    for name in seen.take(SEEN_MAX).filter_map(|name| name.parse().ok()) {
        shared.board.want(&name);
    }
    // Numbers, names and texts can always be represented in JSON.
    let make = || serde_json::to_vec(&shared.board.overview()).unwrap_or_default();
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (kind, fresh(&shared.overview, make)).into_response()
}

async fn metrics(State(shared): State<Arc<Shared>>) -> Response {
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    let make = || shared.board.metrics().into_bytes();
    let kind = [(header::CONTENT_TYPE, kind)];
    (kind, fresh(&shared.metrics, make)).into_response()
}

async fn picture(State(shared): State<Arc<Shared>>, Path(path): Path<String>) -> Response {
    let name = path.strip_suffix(".png");
    let Some(name) = name.and_then(|name| name.parse::<Name>().ok()) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let decoded = tokio::task::spawn_blocking(move || shared.board.picture(&name)).await;
    match decoded.ok().flatten() {
        Some(png) => ([(header::CONTENT_TYPE, "image/png")], png).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}
