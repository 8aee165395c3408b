//! The server of a panel: its files, and one address at which the page asks.

use std::{io, sync::Arc, time::Duration};

use axum::{
    Router,
    body::to_bytes,
    extract::{Query, Request, State},
    http::{HeaderMap, HeaderValue, StatusCode},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use ctos::doors::Pages;
use serde::Deserialize;
use serde_json::Value;

use super::service::Service;
use cli_common::page::{self, Right};

/// The longest line that a page may ask, bytes.
const LONGEST: usize = 64 * 1024;
/// How long a line may take to come.
const LINE_DEADLINE: Duration = Duration::from_secs(5);
/// The header in which a page shows that the user who started the panel opened it. A page of another site cannot send
/// it.
const TOKEN: &str = "x-scott-token";

/// Serves until `stop` is over.
pub(super) async fn serve(pages: Pages, service: Service, stop: impl Future) -> io::Result<()> {
    let router = Router::new()
        .route("/", get(index))
        .route("/panel.css", get(style))
        .route("/panel.js", get(|| script(include_str!("page/panel.js"))))
        .route("/base.js", get(|| script(include_str!("page/base.js"))))
        .route("/plot.js", get(|| script(include_str!("page/plot.js"))))
        .route(
            "/pendant.js",
            get(|| script(include_str!("page/pendant.js"))),
        )
        .route("/panel.json", get(panel))
        .route("/follows.json", get(follows))
        .route("/ask", post(ask))
        .with_state(Arc::new(service));
    page::serve(pages, router, stop).await
}

async fn index() -> Response {
    page::file("text/html; charset=utf-8", include_str!("page/index.html"))
}

async fn style() -> Response {
    page::file("text/css", include_str!("page/panel.css"))
}

async fn script(text: &'static str) -> Response {
    page::file("text/javascript", text)
}

#[derive(Deserialize)]
struct Which {
    /// Its number, from 0.
    #[serde(default)]
    n: usize,
}

async fn panel(
    State(service): State<Arc<Service>>,
    Query(which): Query<Which>,
    headers: HeaderMap,
) -> Response {
    let right = match right(&service, &headers) {
        Ok(right) => right,
        Err(reason) => return service.door.refuse(reason),
    };
    match service.described(which.n, right).await {
        Some(described) => answered(&described),
        None => (StatusCode::NOT_FOUND, "there is no such panel\n").into_response(),
    }
}

async fn follows(
    State(service): State<Arc<Service>>,
    Query(which): Query<Which>,
    headers: HeaderMap,
) -> Response {
    if let Err(reason) = right(&service, &headers) {
        return service.door.refuse(reason);
    }
    match service.follows(which.n).await {
        Some(follows) => answered(&follows),
        None => (StatusCode::NOT_FOUND, "there is no such panel\n").into_response(),
    }
}

async fn ask(State(service): State<Arc<Service>>, request: Request) -> Response {
    let right = match right(&service, request.headers()) {
        Ok(right) => right,
        Err(reason) => return service.door.refuse(reason),
    };
    let line = tokio::time::timeout(LINE_DEADLINE, to_bytes(request.into_body(), LONGEST));
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
    if right == Right::Look && !service.is_look(&line) {
        return service.door.refuse(service.door.why_only_look());
    }
    answered(&service.ask(&line).await)
}

fn answered(value: &Value) -> Response {
    page::file("application/json", value.to_string())
}

/// What the sender of a request may do.
fn right(service: &Service, headers: &HeaderMap) -> Result<Right, &'static str> {
    let shown = headers.get(TOKEN).map_or(&b""[..], HeaderValue::as_bytes);
    let right = service.door.right(shown);
    right.ok_or("open the panel by the address that was printed when it was started")
}
