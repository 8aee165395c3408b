//! The server of a panel: its files, and one address at which the page asks.

use std::{
    io,
    net::{SocketAddr, TcpListener},
    sync::Arc,
};

use axum::{
    Router,
    body::{Bytes, to_bytes},
    extract::{Query, Request, State},
    http::{
        HeaderMap, HeaderValue, StatusCode,
        header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, ORIGIN},
    },
    response::{IntoResponse, Response},
    routing::{get, post},
};
use serde::Deserialize;
use serde_json::Value;

use super::desk::{Desk, Right};

/// The longest line that a page may ask, bytes.
const LONGEST: usize = 64 * 1024;
/// What the page may load: what is served here, and nothing else.
const POLICY: &str =
    "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
/// In which header a page shows that it was opened by whoever started the panel. A page of another site cannot send it.
const TOKEN: &str = "x-scott-token";

struct Served {
    desk: Desk,
    address: SocketAddr,
}

/// Serves until `stop` is over.
pub(super) async fn serve(
    listener: TcpListener,
    desk: Desk,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let address = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let router = Router::new()
        .route("/", get(page))
        .route("/panel.css", get(style))
        .route("/panel.js", get(script))
        .route("/panel.json", get(panel))
        .route("/ask", post(ask))
        .with_state(Arc::new(Served { desk, address }));
    tokio::select! {
        served = async { axum::serve(listener, router).await } => served,
        () = stop => Ok(()),
    }
}

async fn page(State(served): State<Arc<Served>>, headers: HeaderMap) -> Response {
    asset(
        &served,
        &headers,
        "text/html; charset=utf-8",
        include_str!("page/index.html"),
    )
}

async fn style(State(served): State<Arc<Served>>, headers: HeaderMap) -> Response {
    asset(
        &served,
        &headers,
        "text/css",
        include_str!("page/panel.css"),
    )
}

async fn script(State(served): State<Arc<Served>>, headers: HeaderMap) -> Response {
    asset(
        &served,
        &headers,
        "text/javascript",
        include_str!("page/panel.js"),
    )
}

fn asset(served: &Served, headers: &HeaderMap, kind: &'static str, text: &'static str) -> Response {
    match meant(served.address, headers) {
        Ok(()) => good(kind, text.into()),
        Err(reason) => refused(reason),
    }
}

fn good(kind: &'static str, bytes: Bytes) -> Response {
    let headers = [
        (CONTENT_TYPE, kind),
        (CONTENT_SECURITY_POLICY, POLICY),
        // Another version of the program has other files under the same names.
        (CACHE_CONTROL, "no-store"),
    ];
    (headers, bytes).into_response()
}

fn refused(reason: &str) -> Response {
    tracing::warn!(reason, "a page was refused");
    (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response()
}

#[derive(Deserialize)]
struct Which {
    /// Its number, from 0.
    #[serde(default)]
    n: usize,
}

async fn panel(
    State(served): State<Arc<Served>>,
    Query(which): Query<Which>,
    headers: HeaderMap,
) -> Response {
    let right = match right(&served, &headers) {
        Ok(right) => right,
        Err(reason) => return refused(reason),
    };
    match served.desk.described(which.n, right).await {
        Some(described) => answered(&described),
        None => (StatusCode::NOT_FOUND, "there is no such panel\n").into_response(),
    }
}

async fn ask(State(served): State<Arc<Served>>, request: Request) -> Response {
    let right = match right(&served, request.headers()) {
        Ok(right) => right,
        Err(reason) => return refused(reason),
    };
    let Ok(bytes) = to_bytes(request.into_body(), LONGEST).await else {
        let text = format!("a line has at most {LONGEST} bytes\n");
        return (StatusCode::PAYLOAD_TOO_LARGE, text).into_response();
    };
    let Ok(line) = String::from_utf8(bytes.into()) else {
        return (StatusCode::BAD_REQUEST, "a line is UTF-8\n").into_response();
    };
    if right == Right::Look && !served.desk.is_look(&line) {
        return refused(served.desk.door.why_only_look());
    }
    answered(&served.desk.ask(&line).await)
}

fn answered(value: &Value) -> Response {
    good("application/json", value.to_string().into())
}

/// What whoever sends a request may do.
fn right(served: &Served, headers: &HeaderMap) -> Result<Right, &'static str> {
    meant(served.address, headers)?;
    let shown = headers.get(TOKEN).map_or(&b""[..], HeaderValue::as_bytes);
    let right = served.desk.door.right(shown);
    right.ok_or("open the panel by the address that was printed when it was started")
}

/// Whether a request was meant for this server: a page of another site, or a name that only seems to be
/// this host's, must not reach it.
fn meant(address: SocketAddr, headers: &HeaderMap) -> Result<(), &'static str> {
    let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or("?"));
    let host = text(HOST).ok_or("a request without a host")?;
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    if address.ip().is_loopback() && !["localhost", "127.0.0.1", "[::1]"].contains(&name) {
        return Err("this panel is served on the loopback only, by the name localhost");
    }
    match text(ORIGIN) {
        // No browser sends none with what changes anything; programs may.
        None => Ok(()),
        Some(origin) if origin == format!("http://{host}") => Ok(()),
        Some(origin) if origin == format!("https://{host}") => Ok(()),
        Some(_) => Err("a page of another site may not use this panel"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.insert(*name, value.parse().unwrap());
        }
        headers
    }

    #[test]
    fn pages_of_other_sites_and_names_of_other_hosts_are_refused() {
        let address: SocketAddr = "127.0.0.1:7412".parse().unwrap();
        let meant = |pairs: &[(&'static str, &str)]| meant(address, &headers(pairs)).is_ok();
        assert!(meant(&[("host", "127.0.0.1:7412")]));
        assert!(meant(&[
            ("host", "localhost:7412"),
            ("origin", "http://localhost:7412")
        ]));
        assert!(!meant(&[]));
        assert!(!meant(&[("host", "evil.example")]));
        assert!(!meant(&[
            ("host", "localhost:7412"),
            ("origin", "http://evil.example")
        ]));
        assert!(!meant(&[("host", "localhost:7412"), ("origin", "null")]));
    }
}
