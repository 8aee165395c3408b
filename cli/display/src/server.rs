//! The server of the page: its files, and a websocket for each browser.

use std::{io, sync::Arc, time::Duration};

use axum::{
    Router,
    extract::{
        Path, Query, State,
        ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code},
    },
    http::{
        StatusCode,
        header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE},
    },
    response::{IntoResponse, Response},
    routing::get,
};
use ctos::doors::Pages;
use hyper_util::service::TowerToHyperService;
use serde::Deserialize;
use tokio::sync::{Semaphore, broadcast::error::RecvError, mpsc, oneshot};

use super::{
    assets,
    hub::{Hub, News},
    wire::{Asked, Told},
};
use cli_common::page::{Door, Right};

/// The longest message of a browser, bytes.
const LONGEST: usize = 16 * 1024;

/// How long a browser may take to read what it is sent.
const WRITE_LIMIT: Duration = Duration::from_secs(60);

/// How often a browser is asked whether it is there, and how often in vain before it counts as gone.
const BEAT: Duration = Duration::from_secs(20);
const BEATS: u32 = 3;

/// What a browser asks for, on its way to the task, and where the answer goes.
pub(crate) type Asking = (Asked, oneshot::Sender<String>);

/// What all connections share.
pub(crate) struct Desk {
    pub(crate) hub: Arc<Hub>,
    /// Who may do what.
    pub(crate) door: Door,
    pub(crate) viewers: usize,
    /// Places for those who look on, and for those who intervene: none keeps the other out.
    pub(crate) rooms: [Semaphore; 2],
    pub(crate) orders: mpsc::Sender<Asking>,
}

/// Places for `viewers` of either kind.
pub(crate) fn rooms(viewers: usize) -> [Semaphore; 2] {
    [viewers, viewers].map(Semaphore::new)
}

/// Serves until `stop`.
pub(crate) async fn serve(pages: Pages, desk: Desk, stop: oneshot::Receiver<()>) -> io::Result<()> {
    let router = Router::new()
        .route("/", get(page))
        .route("/ws", get(socket))
        .route("/{name}", get(file))
        .with_state(Arc::new(desk));
    tokio::select! {
        served = pages.serve(TowerToHyperService::new(router)) => served.map(|never| match never {}),
        _ = stop => Ok(()),
    }
}

async fn page() -> Response {
    asset("")
}

async fn file(Path(name): Path<String>) -> Response {
    asset(&name)
}

fn asset(name: &str) -> Response {
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
    Query(shown): Query<Shown>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let shown = shown.token.unwrap_or_default();
    let Some(right) = desk.door.right(shown.as_bytes()) else {
        let text = "open the page by the file that its log names, which has the token";
        desk.door.refuse(text);
        return (StatusCode::FORBIDDEN, format!("{text}\n")).into_response();
    };
    let control = right == Right::Control;
    upgrade
        .max_message_size(LONGEST)
        .max_frame_size(LONGEST)
        .on_upgrade(move |socket| async move {
            // The end of a connection is nobody's failure.
            let _ = attend(socket, &desk, control).await;
        })
}

/// Sends a text, unless it is not read for too long.
async fn say(socket: &mut WebSocket, text: &str) -> Result<(), axum::Error> {
    let sent = socket.send(Message::Text(text.into()));
    let sent = tokio::time::timeout(WRITE_LIMIT, sent).await;
    sent.unwrap_or_else(|late| Err(axum::Error::new(late)))
}

async fn attend(mut socket: WebSocket, desk: &Desk, control: bool) -> Result<(), axum::Error> {
    let [looking, controlling] = &desk.rooms;
    let room = if control { controlling } else { looking };
    let Ok(_place) = room.try_acquire() else {
        let reason = format!("{} look on already", desk.viewers);
        return close(socket, close_code::AGAIN, &reason).await;
    };
    let (told, mut news) = desk.hub.join(control);
    for text in told {
        say(&mut socket, &text).await?;
    }
    let mut beat = tokio::time::interval(BEAT);
    // Its first is at once otherwise.
    beat.reset();
    let mut unanswered = 0;
    loop {
        tokio::select! {
            _ = beat.tick() => {
                if unanswered == BEATS {
                    return Ok(());
                }
                unanswered += 1;
                let asked = socket.send(Message::Ping(Vec::new().into()));
                let asked = tokio::time::timeout(WRITE_LIMIT, asked).await;
                asked.unwrap_or_else(|late| Err(axum::Error::new(late)))?;
            }
            new = news.recv() => match new {
                Ok(News::Told(text)) => say(&mut socket, &text).await?,
                // It was too slow, or there are other nets now.
                Ok(News::Anew) | Err(RecvError::Lagged(_)) => {
                    let (told, anew) = desk.hub.join(control);
                    news = anew;
                    for text in told {
                        say(&mut socket, &text).await?;
                    }
                }
                Err(RecvError::Closed) => return Ok(()),
            },
            message = socket.recv() => match message {
                None | Some(Ok(Message::Close(_))) => return Ok(()),
                Some(Ok(Message::Text(text))) => {
                    unanswered = 0;
                    let asked = match serde_json::from_str::<Asked>(&text) {
                        Ok(asked) => asked,
                        Err(error) => {
                            let reason = format!("a message cannot be read: {error}");
                            return close(socket, close_code::POLICY, &reason).await;
                        }
                    };
                    let answer = ask(desk, asked, control).await;
                    say(&mut socket, &answer).await?;
                }
                Some(Ok(Message::Binary(_))) => {
                    return close(socket, close_code::UNSUPPORTED, "messages are text").await;
                }
                // The answer to a beat, mostly.
                Some(Ok(_)) => unanswered = 0,
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
        return refused(desk.door.why_only_look());
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
