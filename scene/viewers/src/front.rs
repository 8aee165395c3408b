//! Who may come to the server of viewers, which tells nobody off itself: a caller that may look on is passed on to it.

use std::{io, net::SocketAddr, sync::Arc};

use axum::{
    Router,
    body::Body,
    extract::{Query, Request, State},
    http::{
        HeaderMap, HeaderValue, StatusCode,
        header::{HOST, ORIGIN},
    },
    response::{IntoResponse, Response},
};
use cli_common::page::{self, Door};
use ctos::doors::Pages;
use hyper_util::rt::TokioIo;
use serde::Deserialize;
use tokio::{io::copy_bidirectional, net::TcpStream, sync::oneshot};

struct Service {
    door: Door,
    behind: SocketAddr,
}

#[derive(Deserialize)]
struct Shown {
    token: Option<String>,
}

/// Passes those on to the server `behind` who may look on, until `stop`.
pub(crate) async fn serve(
    pages: Pages,
    door: Door,
    behind: SocketAddr,
    stop: oneshot::Receiver<()>,
) -> io::Result<()> {
    let service = Arc::new(Service { door, behind });
    let router = Router::new().fallback(admit).with_state(service);
    page::serve(pages, router, stop).await
}

async fn admit(
    State(service): State<Arc<Service>>,
    Query(shown): Query<Shown>,
    request: Request,
) -> Response {
    let token = shown.token.unwrap_or_default();
    let of_another = is_of_another_site(request.headers());
    if of_another && !service.door.knows(token.as_bytes()) {
        let text = "a page of another site must show the token, as `?token=`: the log names the file that has it";
        return service.door.refuse(text);
    }
    if service.door.right(token.as_bytes()).is_none() {
        let text = "connect with `?token=`, by the address in the file that the log names";
        return service.door.refuse(text);
    }
    match pass_on(request, service.behind).await {
        Ok(answer) => answer,
        Err(error) => {
            let text = format!("the server of viewers does not answer: {error}\n");
            (StatusCode::BAD_GATEWAY, text).into_response()
        }
    }
}

/// Whether a request comes from a page of another site. A viewer that is installed has no origin, or one that is no site; a page
/// can hide its own behind `null`.
fn is_of_another_site(headers: &HeaderMap) -> bool {
    let text = |name| {
        headers
            .get(name)
            .and_then(|value: &HeaderValue| value.to_str().ok())
    };
    let Some(origin) = text(ORIGIN) else {
        return headers.contains_key(ORIGIN);
    };
    let mut schemes = ["http://", "https://"].into_iter();
    let is_own = schemes.any(|scheme| {
        origin
            .strip_prefix(scheme)
            .is_some_and(|at| Some(at) == text(HOST))
    });
    (origin.starts_with("http") || origin == "null") && !is_own
}

/// Puts a request to the server behind. When both agree on another protocol, bytes go both ways from then on.
async fn pass_on(mut request: Request, behind: SocketAddr) -> io::Result<Response> {
    let caller = hyper::upgrade::on(&mut request);
    let stream = TokioIo::new(TcpStream::connect(behind).await?);
    let met = hyper::client::conn::http1::handshake(stream).await;
    let (mut sender, connection) = met.map_err(io::Error::other)?;
    tokio::spawn(connection.with_upgrades());
    let answer = sender.send_request(request).await;
    let mut answer = answer.map_err(io::Error::other)?;
    if answer.status() == StatusCode::SWITCHING_PROTOCOLS {
        let server = hyper::upgrade::on(&mut answer);
        tokio::spawn(async move {
            if let (Ok(caller), Ok(server)) = tokio::join!(caller, server) {
                // The end of a connection is nobody's failure.
                let _ =
                    copy_bidirectional(&mut TokioIo::new(caller), &mut TokioIo::new(server)).await;
            }
        });
    }
    Ok(answer.map(Body::new))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_of_other_sites_are_told_from_installed_viewers_and_programs() {
        let of_another = |origin: Option<&'static str>| {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, HeaderValue::from_static("127.0.0.1:8765"));
            if let Some(origin) = origin {
                headers.insert(ORIGIN, HeaderValue::from_static(origin));
            }
            is_of_another_site(&headers)
        };
        for none in [None, Some("file://"), Some("app://lichtblick")] {
            assert!(!of_another(none), "{none:?}");
        }
        for own in ["http://127.0.0.1:8765", "https://127.0.0.1:8765"] {
            assert!(!of_another(Some(own)), "{own}");
        }
        for other in [
            "https://viewer.example",
            "http://127.0.0.1:80",
            "http://127.0.0.1",
            "null",
        ] {
            assert!(of_another(Some(other)), "{other}");
        }
    }
}
