//! The server of the page: its files, and a websocket for each browser.

use std::{io, sync::Arc, time::Duration};

use axum::{
    Router,
    extract::{
        Path, Query, State,
        ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code},
    },
    http::StatusCode,
    response::{IntoResponse, Response},
    routing::get,
};
use ctos::doors::Pages;
use serde::Deserialize;
use tokio::{
    sync::{Semaphore, broadcast::error::RecvError, mpsc, oneshot},
    task::JoinSet,
};

use super::{
    assets,
    hub::Hub,
    wire::{Asked, Told},
};
use cli_common::page::{self, Door, Right};

/// The longest message of a browser, bytes.
const LONGEST: usize = 16 * 1024;

/// What a browser may wait for at a time: a command may take hours, and is not all that it asks for.
const MOST_ASKED: usize = 64;

/// How long a browser may take to read what it is sent.
const WRITE_DEADLINE: Duration = Duration::from_secs(60);

/// How often a browser is asked whether it is there, and how often in vain before it counts as gone.
const BEAT: Duration = Duration::from_secs(20);
const BEATS: u32 = 3;

/// What a browser asks for, on its way to the task, and where the answer goes.
pub(crate) type Asking = (Asked, oneshot::Sender<String>);

/// What all connections share.
pub(crate) struct Service {
    pub(crate) hub: Arc<Hub>,
    /// Who may do what.
    pub(crate) door: Door,
    pub(crate) viewers: usize,
    /// Permits for those who look on, and for those who intervene: none keeps the other out.
    pub(crate) permits: [Semaphore; 2],
    pub(crate) orders: mpsc::Sender<Asking>,
}

/// Permits for `viewers` of either kind.
pub(crate) fn permits(viewers: usize) -> [Semaphore; 2] {
    [viewers, viewers].map(Semaphore::new)
}

/// Serves until `stop`.
pub(crate) async fn serve(
    pages: Pages,
    service: Service,
    stop: oneshot::Receiver<()>,
) -> io::Result<()> {
    let router = Router::new()
        .route("/", get(index))
        .route("/ws", get(socket))
        .route("/{name}", get(file))
        .with_state(Arc::new(service));
    page::serve(pages, router, stop).await
}

async fn index() -> Response {
    asset("")
}

async fn file(Path(name): Path<String>) -> Response {
    asset(&name)
}

fn asset(name: &str) -> Response {
    match assets::asset(name) {
        Some((_, kind, text)) => page::file(kind, text),
        None => (StatusCode::NOT_FOUND, "there is no such file\n").into_response(),
    }
}

#[derive(Deserialize)]
struct Shown {
    token: Option<String>,
}

async fn socket(
    State(service): State<Arc<Service>>,
    Query(shown): Query<Shown>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let shown = shown.token.unwrap_or_default();
    let Some(right) = service.door.right(shown.as_bytes()) else {
        let text = "open the page by the file that its log names, which has the token";
        return service.door.refuse(text);
    };
    let control = right == Right::Control;
    upgrade
        .max_message_size(LONGEST)
        .max_frame_size(LONGEST)
        .on_upgrade(move |socket| async move {
            // The end of a connection is nobody's failure.
            let _ = attend(socket, service, control).await;
        })
}

/// Sends a text, unless it is not read for too long.
async fn say(socket: &mut WebSocket, text: &str) -> Result<(), axum::Error> {
    let sent = socket.send(Message::Text(text.into()));
    let sent = tokio::time::timeout(WRITE_DEADLINE, sent).await;
    sent.unwrap_or_else(|late| Err(axum::Error::new(late)))
}

async fn attend(
    mut socket: WebSocket,
    service: Arc<Service>,
    control: bool,
) -> Result<(), axum::Error> {
    let [looking, controlling] = &service.permits;
    let permits = if control { controlling } else { looking };
    let Ok(_permit) = permits.try_acquire() else {
        let reason = format!("{} look on already", service.viewers);
        return close(socket, close_code::AGAIN, &reason).await;
    };
    let (told, mut news) = service.hub.join(control);
    for text in told {
        say(&mut socket, &text).await?;
    }
    let mut beat = tokio::time::interval(BEAT);
    // Its first is at once otherwise.
    beat.reset();
    let mut unanswered = 0;
    let mut answers: JoinSet<String> = JoinSet::new();
    loop {
        tokio::select! {
            Some(answer) = answers.join_next() => {
                if let Ok(answer) = answer {
                    say(&mut socket, &answer).await?;
                }
            }
            _ = beat.tick() => {
                if unanswered == BEATS {
                    return Ok(());
                }
                unanswered += 1;
                let asked = socket.send(Message::Ping(Vec::new().into()));
                let asked = tokio::time::timeout(WRITE_DEADLINE, asked).await;
                asked.unwrap_or_else(|late| Err(axum::Error::new(late)))?;
            }
            new = news.recv() => match new {
                Ok(text) => say(&mut socket, &text).await?,
                // It was too slow: what it was told does not count any more.
                Err(RecvError::Lagged(_)) => {
                    let (told, anew) = service.hub.join(control);
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
                    if answers.len() >= MOST_ASKED {
                        let text = format!("{MOST_ASKED} answers are waited for already");
                        say(&mut socket, &refused(asked.id, &text)).await?;
                        continue;
                    }
                    let service = Arc::clone(&service);
                    answers.spawn(async move { ask(&service, asked, control).await });
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

fn refused(id: u64, text: &str) -> String {
    let (ok, text) = (false, text.to_owned());
    Told::Answer { id, ok, text }.text()
}

/// What becomes of what a browser asks.
async fn ask(service: &Service, asked: Asked, control: bool) -> String {
    let id = asked.id;
    let refused = |text: &str| refused(id, text);
    if !["task", "follow"].contains(&asked.kind.as_str()) && !control {
        return refused(service.door.why_only_look());
    }
    let (sender, answer) = oneshot::channel();
    if service.orders.send((asked, sender)).await.is_err() {
        return refused("there is nobody to ask: the app has ended, or this is a record");
    }
    match answer.await {
        Ok(answer) => answer,
        Err(_) => refused("the app is ending"),
    }
}

#[cfg(test)]
mod tests;
