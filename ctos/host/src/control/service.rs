//! Where a client is served: its requests are read one after the other, and only what its role permits
//! is answered.

mod requests;

use std::{
    collections::BTreeSet,
    io,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use serde_json::Value;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader, ReadHalf, WriteHalf};

use crate::{
    control::{
        LogStore,
        news::{Ticker, ended},
        protocol::{Answer, Ask, ErrorCode, ErrorView, REQUEST_LIMIT, Request, VERSION, too_long},
        recording::Recordings,
    },
    doors,
    text::Gone,
};
use ctos_bootstrap::refusals::Refusals;
use ctos_core::chassis::Chassis;
use ctos_link::{security::Role, transport::Stream};
use ctos_message::Tid;

/// Where a client is read, and where it is answered.
pub(super) type Reader = BufReader<ReadHalf<Stream>>;
pub(super) type Writer = WriteHalf<Stream>;

/// A client, as far as it has proved who it is.
pub(super) struct Client {
    pub(super) who: String,
    pub(super) role: Role,
}

/// There are too many clients.
pub(super) fn busy() -> Answer {
    error(ErrorCode::Busy, "too many clients at once")
}

pub(super) fn error(code: ErrorCode, message: impl Into<String>) -> Answer {
    Answer::Error(ErrorView::new(code, message))
}

pub(super) async fn tell(writer: &mut Writer, answer: &Answer) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    writer.write_all(&line).await?;
    writer.flush().await
}

/// What clients are served from.
pub(super) struct Service {
    pub(super) chassis: Arc<Chassis>,
    logs: Arc<LogStore>,
    pub(super) ticker: Ticker,
    pub(super) recordings: Arc<Recordings>,
    /// Counts the clients, so that no two have the same name.
    speakers: AtomicU64,
}

/// A client, as the tasks know it that it says lines to.
pub(super) struct Speaker {
    name: String,
    /// Those that it has spoken to.
    heard: BTreeSet<Tid>,
}

impl Service {
    /// Serves the clients of the app whose boot is `chassis`.
    pub(super) fn new(chassis: &Arc<Chassis>, logs: &Arc<LogStore>, ticker: &Ticker) -> Self {
        Self {
            chassis: chassis.clone(),
            logs: logs.clone(),
            ticker: ticker.clone(),
            recordings: Arc::default(),
            speakers: AtomicU64::new(0),
        }
    }

    /// Logs and counts that somebody was refused.
    pub(super) fn refuse(&self, who: &str, reason: &str) {
        let chassis = &self.chassis;
        Refusals::of(chassis).note(&chassis.clock, who, reason);
    }

    /// What a client may not have, if it may not have it.
    fn not_allowed(&self, client: &Client, request: &Request) -> Option<Answer> {
        let needed = request.role();
        if client.role >= needed {
            return None;
        }
        let reason = format!("`{}` takes the role `{needed}`", request.word());
        self.refuse(&client.who, &reason);
        let text = format!(
            "{} has the role `{}`, and {reason}",
            client.who, client.role
        );
        Some(error(ErrorCode::NotAllowed, text))
    }

    /// Serves one client until it goes, and tells so whom it has spoken to.
    pub(super) async fn client(
        &self,
        client: &Client,
        reader: Reader,
        writer: Writer,
    ) -> io::Result<()> {
        let number = self.speakers.fetch_add(1, Ordering::Relaxed) + 1;
        let mut speaker = Speaker {
            name: format!("{}-{number}@boot", client.who.replace(' ', "-")),
            heard: BTreeSet::new(),
        };
        let served = self.serve(client, &mut speaker, reader, writer).await;
        for task in speaker.heard {
            let who = speaker.name.clone();
            self.chassis.post_system(task, Gone { who });
        }
        served
    }

    async fn serve(
        &self,
        client: &Client,
        speaker: &mut Speaker,
        mut reader: Reader,
        mut writer: Writer,
    ) -> io::Result<()> {
        let mut news = self.ticker.subscribe();
        loop {
            let mut line = Vec::new();
            let mut limited = (&mut reader).take(REQUEST_LIMIT as u64);
            tokio::select! {
                read = limited.read_until(b'\n', &mut line) => {
                    if read? == 0 {
                        return Ok(());
                    }
                }
                // The service must not wait for a client that asks for nothing when the app has ended.
                () = ended(&mut news) => return Ok(()),
            }
            // A client that sends anything but a request is not a tool: the service obeys nothing else of it.
            let ask = match read_ask(&line) {
                Ok(ask) => ask,
                Err(unreadable) => return self.hang_up(client, &mut writer, unreadable).await,
            };
            match ask {
                Ok(ask) if ask.version > VERSION => {
                    let text = format!(
                        "this app speaks version {VERSION} of the protocol, not {}",
                        ask.version
                    );
                    tell(&mut writer, &error(ErrorCode::BadRequest, text)).await?;
                }
                Ok(ask) if let Some(refused) = self.not_allowed(client, &ask.request) => {
                    tell(&mut writer, &refused).await?;
                }
                Ok(ask) => {
                    let answered = std::pin::pin!(self.answer(ask.request, speaker, &mut writer));
                    tokio::select! {
                        biased;
                        answered = answered => answered?,
                        () = closed(&mut reader) => return Ok(()),
                    }
                }
                Err(reason) => {
                    let text = format!("cannot read the request: {reason}");
                    tell(&mut writer, &error(ErrorCode::BadRequest, text)).await?;
                }
            }
        }
    }

    /// Says why the connection ends.
    async fn hang_up(
        &self,
        client: &Client,
        writer: &mut Writer,
        unreadable: Unreadable,
    ) -> io::Result<()> {
        let text = unreadable.to_string();
        self.refuse(&client.who, &text);
        match unreadable {
            Unreadable::Http => {
                writer.write_all(doors::NO_PAGE.as_bytes()).await?;
                writer.flush().await
            }
            _ => tell(writer, &error(ErrorCode::BadRequest, text)).await,
        }
    }

    async fn answer(
        &self,
        request: Request,
        speaker: &mut Speaker,
        writer: &mut Writer,
    ) -> io::Result<()> {
        let answered = match request {
            Request::Logs(request) => self.logs(&request, writer).await,
            Request::Stop { now } => self.stop(now, writer).await,
            Request::Record(request) => self.record(request, writer).await,
            Request::Restart { name } => self.restart(&name, writer).await,
            Request::Move { task, to } => self.move_task(task, &to, writer).await,
            Request::Say(request) => self.say(request, speaker).await,
            Request::Ps {} => self.app().await.map(Answer::App).map_err(Failed::from),
            Request::Status { name } => self.status(&name).await,
            Request::RecordStop { key } if self.recordings.stop(key) => Ok(Answer::Done {}),
            Request::RecordStop { key } => {
                let text = format!("there is no record {key}");
                Err(ErrorView::new(ErrorCode::NoSuchName, text).into())
            }
            Request::Call {
                task,
                command,
                data,
                within_s,
            } => self.call(&task, &command, &data, within_s).await,
        };
        match answered {
            Ok(answer) => tell(writer, &answer).await,
            Err(Failed::Refused(wrong)) => tell(writer, &Answer::Error(wrong)).await,
            Err(Failed::Io(error)) => Err(error),
        }
    }
}

/// The last answer to a request; those before it have been told.
pub(super) type Answered = Result<Answer, Failed>;

/// Why a request has no answer.
#[derive(Debug, thiserror::Error)]
pub(super) enum Failed {
    #[error("the client is gone: {0}")]
    Io(#[from] io::Error),
    #[error(transparent)]
    Refused(#[from] ErrorView),
}

/// A line that is not a request of any version.
#[derive(Debug, thiserror::Error)]
enum Unreadable {
    #[error("it speaks HTTP, and this is no page")]
    Http,
    #[error("{}", too_long(None))]
    TooLong,
    #[error("the request is cut off: it has no end of line")]
    Cut,
    #[error("cannot read the request: {0}")]
    Rubbish(serde_json::Error),
}

/// Reads a line: a request, or why this version does not know it.
fn read_ask(line: &[u8]) -> Result<Result<Ask, serde_json::Error>, Unreadable> {
    if doors::is_http(line) {
        return Err(Unreadable::Http);
    }
    if line.last() != Some(&b'\n') {
        let is_long = line.len() >= REQUEST_LIMIT;
        return Err(if is_long {
            Unreadable::TooLong
        } else {
            Unreadable::Cut
        });
    }
    let said: Value = serde_json::from_slice(line).map_err(Unreadable::Rubbish)?;
    // What every request of every version has.
    let is_ask = said["version"].is_u64() && said["request"]["kind"].is_string();
    match serde_json::from_value(said) {
        Err(reason) if !is_ask => Err(Unreadable::Rubbish(reason)),
        read => Ok(read),
    }
}

/// Ends when the client has closed its end, also while it is being answered.
async fn closed(reader: &mut Reader) {
    match reader.fill_buf().await {
        Ok([]) | Err(_) => {}
        // Its next request, which is read after this one.
        Ok(_) => std::future::pending().await,
    }
}
