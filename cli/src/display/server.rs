//! The server of the page: its files, and a websocket for each browser.

use std::{io, net::SocketAddr, sync::Arc};

use axum::{
    Router,
    extract::{
        Path, Query, State,
        ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code},
    },
    http::{
        HeaderMap, StatusCode,
        header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, ORIGIN},
    },
    response::{IntoResponse, Response},
    routing::get,
};
use serde::Deserialize;
use tokio::sync::{Semaphore, broadcast::error::RecvError, mpsc, oneshot};

use super::{
    assets,
    hub::{Hub, News},
    wire::{Asked, Told},
};

/// The longest message of a browser, bytes.
const LONGEST: usize = 16 * 1024;

/// What a browser asks for, on its way to the task, and where the answer goes.
pub(crate) type Asking = (Asked, oneshot::Sender<String>);

/// What all connections share.
pub(crate) struct Desk {
    pub(crate) hub: Arc<Hub>,
    /// Where the page is served.
    pub(crate) address: SocketAddr,
    /// What a page must show to intervene; nobody may when there is none.
    pub(crate) token: Option<String>,
    pub(crate) viewers: usize,
    pub(crate) room: Arc<Semaphore>,
    pub(crate) orders: mpsc::Sender<Asking>,
}

/// Serves until `stop`.
pub(crate) async fn serve(
    listener: std::net::TcpListener,
    desk: Desk,
    stop: oneshot::Receiver<()>,
) -> io::Result<()> {
    listener.set_nonblocking(true)?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let router = Router::new()
        .route("/", get(page))
        .route("/ws", get(socket))
        .route("/{name}", get(file))
        .with_state(Arc::new(desk));
    tokio::select! {
        served = async { axum::serve(listener, router).await } => served,
        _ = stop => Ok(()),
    }
}

async fn page(State(desk): State<Arc<Desk>>, headers: HeaderMap) -> Response {
    asset(&desk, &headers, "")
}

async fn file(
    State(desk): State<Arc<Desk>>,
    headers: HeaderMap,
    Path(name): Path<String>,
) -> Response {
    asset(&desk, &headers, &name)
}

fn asset(desk: &Desk, headers: &HeaderMap, name: &str) -> Response {
    if let Err(reason) = meant(desk, headers) {
        return (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response();
    }
    match assets::asset(name) {
        Some((_, kind, text)) => {
            let headers = [
                (CONTENT_TYPE, kind),
                (CONTENT_SECURITY_POLICY, assets::POLICY),
                // Another version of the program has other files under the same names.
                (CACHE_CONTROL, "no-store"),
            ];
            (headers, text).into_response()
        }
        None => (StatusCode::NOT_FOUND, "there is no such file\n").into_response(),
    }
}

#[derive(Deserialize)]
struct Shown {
    token: Option<String>,
}

async fn socket(
    State(desk): State<Arc<Desk>>,
    headers: HeaderMap,
    Query(shown): Query<Shown>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(reason) = meant(&desk, &headers) {
        tracing::warn!(reason, "a page was refused");
        return (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response();
    }
    let control = match (&desk.token, &shown.token) {
        (Some(token), Some(shown)) => same(token, shown),
        _ => false,
    };
    upgrade
        .max_message_size(LONGEST)
        .max_frame_size(LONGEST)
        .on_upgrade(move |socket| async move {
            // The end of a connection is nobody's failure.
            let _ = attend(socket, &desk, control).await;
        })
}

/// Whether a request was meant for this server: a page of another site, or a name that only seems to be
/// this host's, must not reach it.
fn meant(desk: &Desk, headers: &HeaderMap) -> Result<(), &'static str> {
    let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or("?"));
    let host = text(HOST).ok_or("a request without a host")?;
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    let here = ["localhost", "127.0.0.1", "[::1]"].contains(&name);
    if desk.address.ip().is_loopback() && !here {
        return Err("this page is served on the loopback only, by the name localhost");
    }
    match text(ORIGIN) {
        // No browser sends none; programs may.
        None => Ok(()),
        Some(origin) if origin == format!("http://{host}") => Ok(()),
        Some(origin) if origin == format!("https://{host}") => Ok(()),
        Some(_) => Err("a page of another origin may not look on"),
    }
}

/// Compares in a time that does not tell where two texts begin to differ.
fn same(a: &str, b: &str) -> bool {
    let differ = a
        .bytes()
        .zip(b.bytes())
        .fold(0, |all, (a, b)| all | (a ^ b));
    a.len() == b.len() && differ == 0
}

async fn attend(mut socket: WebSocket, desk: &Desk, control: bool) -> Result<(), axum::Error> {
    let Ok(_place) = desk.room.try_acquire() else {
        let reason = format!("{} look on already", desk.viewers);
        return close(socket, close_code::AGAIN, &reason).await;
    };
    let (told, mut news) = desk.hub.join(control);
    for text in told {
        socket.send(Message::Text(text.into())).await?;
    }
    loop {
        tokio::select! {
            new = news.recv() => match new {
                Ok(News::Told(text)) => socket.send(Message::Text((&*text).into())).await?,
                // It was too slow, or there are other nets now.
                Ok(News::Anew) | Err(RecvError::Lagged(_)) => {
                    let (told, anew) = desk.hub.join(control);
                    news = anew;
                    for text in told {
                        socket.send(Message::Text(text.into())).await?;
                    }
                }
                Err(RecvError::Closed) => return Ok(()),
            },
            message = socket.recv() => match message {
                None | Some(Ok(Message::Close(_))) => return Ok(()),
                Some(Ok(Message::Text(text))) => {
                    let asked = match serde_json::from_str::<Asked>(&text) {
                        Ok(asked) => asked,
                        Err(error) => {
                            let reason = format!("a message cannot be read: {error}");
                            return close(socket, close_code::POLICY, &reason).await;
                        }
                    };
                    let answer = ask(desk, asked, control).await;
                    socket.send(Message::Text(answer.into())).await?;
                }
                Some(Ok(Message::Binary(_))) => {
                    return close(socket, close_code::UNSUPPORTED, "messages are text").await;
                }
                Some(Ok(_)) => {}
                // Too long, or not as the protocol says.
                Some(Err(error)) => {
                    tracing::debug!(error = %error, "a browser was let go");
                    let reason = error.to_string();
                    let code = if reason.contains("too long") {
                        close_code::SIZE
                    } else {
                        close_code::PROTOCOL
                    };
                    return close(socket, code, &reason).await;
                }
            },
        }
    }
}

async fn close(mut socket: WebSocket, code: u16, reason: &str) -> Result<(), axum::Error> {
    // The protocol leaves 123 bytes for it.
    let short: String = reason.chars().take(100).collect();
    let frame = CloseFrame {
        code,
        reason: short.into(),
    };
    socket.send(Message::Close(Some(frame))).await
}

/// What becomes of what a browser asks.
async fn ask(desk: &Desk, asked: Asked, control: bool) -> String {
    let id = asked.id;
    let refused = |text: &str| {
        Told::Answer {
            id,
            ok: false,
            text: text.to_owned(),
        }
        .text()
    };
    if asked.kind != "task" && !control {
        return refused(if desk.token.is_some() {
            "this page may only look on: open it by the address with the token"
        } else {
            "this display may only look on: set `allow_control = true` for it"
        });
    }
    let (sender, answer) = oneshot::channel();
    if desk.orders.send((asked, sender)).await.is_err() {
        return refused("there is nobody to ask: the app has ended, or this is a record");
    }
    match answer.await {
        Ok(answer) => answer,
        Err(_) => refused("the app is ending"),
    }
}

#[cfg(test)]
mod tests;
