//! The server of a panel: its files, and one address at which the page asks.

use std::{io, sync::Arc, time::Duration};

use axum::{
    Router,
    body::{Bytes, to_bytes},
    extract::{Query, Request, State},
    http::{
        HeaderMap, HeaderValue, StatusCode,
        header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE},
    },
    response::{IntoResponse, Response},
    routing::{get, post},
};
use ctos::doors::Pages;
use hyper_util::service::TowerToHyperService;
use serde::Deserialize;
use serde_json::Value;

use super::desk::Desk;
use cli_common::page::Right;

/// The longest line that a page may ask, bytes.
const LONGEST: usize = 64 * 1024;
/// How long a line may take to come.
const LINE_LIMIT: Duration = Duration::from_secs(5);
/// What the page may load: what is served here, and nothing else.
const POLICY: &str =
    "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
/// In which header a page shows that it was opened by whoever started the panel. A page of another site cannot send it.
const TOKEN: &str = "x-scott-token";

/// Serves until `stop` is over.
pub(super) async fn serve(
    pages: Pages,
    desk: Desk,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let router = Router::new()
        .route("/", get(page))
        .route("/panel.css", get(style))
        .route("/panel.js", get(script))
        .route("/panel.json", get(panel))
        .route("/ask", post(ask))
        .with_state(Arc::new(desk));
    tokio::select! {
        served = pages.serve(TowerToHyperService::new(router)) => served.map(|never| match never {}),
        () = stop => Ok(()),
    }
}

async fn page() -> Response {
    let text = include_str!("page/index.html");
    good("text/html; charset=utf-8", text.into())
}

async fn style() -> Response {
    good("text/css", include_str!("page/panel.css").into())
}

async fn script() -> Response {
    good("text/javascript", include_str!("page/panel.js").into())
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

fn refused(desk: &Desk, reason: &str) -> Response {
    desk.door.refuse(reason);
    (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response()
}

#[derive(Deserialize)]
struct Which {
    /// Its number, from 0.
    #[serde(default)]
    n: usize,
}

async fn panel(
    State(desk): State<Arc<Desk>>,
    Query(which): Query<Which>,
    headers: HeaderMap,
) -> Response {
    let right = match right(&desk, &headers) {
        Ok(right) => right,
        Err(reason) => return refused(&desk, reason),
    };
    match desk.described(which.n, right).await {
        Some(described) => answered(&described),
        None => (StatusCode::NOT_FOUND, "there is no such panel\n").into_response(),
    }
}

async fn ask(State(desk): State<Arc<Desk>>, request: Request) -> Response {
    let right = match right(&desk, request.headers()) {
        Ok(right) => right,
        Err(reason) => return refused(&desk, reason),
    };
    let line = tokio::time::timeout(LINE_LIMIT, to_bytes(request.into_body(), LONGEST));
    let Ok(read) = line.await else {
        return (StatusCode::REQUEST_TIMEOUT, "the line did not come\n").into_response();
    };
    let Ok(bytes) = read else {
        let text = format!("a line has at most {LONGEST} bytes\n");
        return (StatusCode::PAYLOAD_TOO_LARGE, text).into_response();
    };
    let Ok(line) = String::from_utf8(bytes.into()) else {
        return (StatusCode::BAD_REQUEST, "a line is UTF-8\n").into_response();
    };
    if right == Right::Look && !desk.is_look(&line) {
        return refused(&desk, desk.door.why_only_look());
    }
    answered(&desk.ask(&line).await)
}

fn answered(value: &Value) -> Response {
    good("application/json", value.to_string().into())
}

/// What whoever sends a request may do.
fn right(desk: &Desk, headers: &HeaderMap) -> Result<Right, &'static str> {
    let shown = headers.get(TOKEN).map_or(&b""[..], HeaderValue::as_bytes);
    let right = desk.door.right(shown);
    right.ok_or("open the panel by the address that was printed when it was started")
}
