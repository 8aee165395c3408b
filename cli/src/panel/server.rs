//! The server of a panel: its files, and one address at which the page asks.

use std::{
    fmt::Write as _,
    io,
    net::{SocketAddr, TcpListener},
    sync::Arc,
};

use axum::{
    Router,
    body::{Bytes, to_bytes},
    extract::{Request, State},
    http::{
        HeaderMap, StatusCode,
        header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, ORIGIN},
    },
    response::{IntoResponse, Response},
    routing::{get, post},
};
use serde_json::Value;
use tokio::signal;

use super::Desk;
use crate::show;

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
    token: String,
}

/// Serves until Ctrl-C.
pub(super) fn serve(listener: TcpListener, desk: Desk) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let address = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    let served = Arc::new(Served {
        desk,
        address,
        token: fresh_token()?,
    });
    show::say(&format!(
        "the panel is at http://{address}/#{}   (Ctrl-C ends it)",
        served.token
    ));
    let router = Router::new()
        .route("/", get(page))
        .route("/panel.css", get(style))
        .route("/panel.js", get(script))
        .route("/panel.json", get(panel))
        .route("/ask", post(ask))
        .with_state(served);
    runtime.block_on(async move {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        tokio::select! {
            served = async { axum::serve(listener, router).await } => served,
            ended = signal::ctrl_c() => ended,
        }
    })
}

fn fresh_token() -> io::Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    let mut token = String::new();
    for byte in bytes {
        // Writing to a `String` cannot fail.
        let _ = write!(token, "{byte:02x}");
    }
    Ok(token)
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

async fn panel(State(served): State<Arc<Served>>, headers: HeaderMap) -> Response {
    if let Err(reason) = permitted(&served, &headers) {
        return refused(reason);
    }
    let described = tokio::task::spawn_blocking(move || served.desk.described());
    answered(described.await.unwrap_or_default())
}

async fn ask(State(served): State<Arc<Served>>, request: Request) -> Response {
    if let Err(reason) = permitted(&served, request.headers()) {
        return refused(reason);
    }
    let Ok(bytes) = to_bytes(request.into_body(), LONGEST).await else {
        let text = format!("a line has at most {LONGEST} bytes\n");
        return (StatusCode::PAYLOAD_TOO_LARGE, text).into_response();
    };
    let Ok(line) = String::from_utf8(bytes.into()) else {
        return (StatusCode::BAD_REQUEST, "a line is UTF-8\n").into_response();
    };
    // An object may take its time, and the others go on.
    let told = tokio::task::spawn_blocking(move || served.desk.ask(&line));
    answered(told.await.unwrap_or_default())
}

fn answered(value: Value) -> Response {
    good("application/json", value.to_string().into())
}

/// Whether a request comes from a page that was opened with the token.
fn permitted(served: &Served, headers: &HeaderMap) -> Result<(), &'static str> {
    meant(served.address, headers)?;
    let shown = headers
        .get(TOKEN)
        .map_or(&b""[..], |value| value.as_bytes());
    // Looked at to its end, wherever it differs.
    let differs = shown
        .iter()
        .zip(served.token.as_bytes())
        .fold(shown.len() ^ served.token.len(), |differs, (a, b)| {
            differs | usize::from(a ^ b)
        });
    match differs {
        0 => Ok(()),
        _ => Err("open the panel by the address that was printed when it was started"),
    }
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
