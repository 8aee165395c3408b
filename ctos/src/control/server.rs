//! The boot's end of the control socket.

use std::{
    collections::BTreeSet,
    io,
    os::unix::fs::PermissionsExt,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use tokio::{
    io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, BufReader},
    net::UnixListener,
    sync::{Semaphore, broadcast},
    task::{JoinHandle, JoinSet},
};

use crate::{
    boot::{BootEvent, End, Observer, Outcome},
    call::Fault,
    chassis::Chassis,
    control::{
        LogStore, gate,
        logs::LogLine,
        moves::Moving,
        place,
        protocol::{
            Answer, Ask, EndView, ErrorCode, ErrorView, LogRequest, ProcessLog, REQUEST_LIMIT,
            RecordRequest, Request, SayRequest, StatusView, VERSION,
        },
        recording::{Recording, Recordings},
        view,
    },
    link::transport::Listener,
    message::Tid,
    security::Role,
    system::{self, Interrupt, RestartChassis, RestartTask},
    text::{Gone, Say},
};

/// Where a client is read, and where it is answered.
pub(super) type Reader = Box<dyn AsyncRead + Send + Unpin>;
pub(super) type Writer = Box<dyn AsyncWrite + Send + Unpin>;

/// A client, as far as it has proved who it is.
pub(super) struct Client {
    pub(super) who: String,
    pub(super) role: Role,
}

/// How many clients are served at a time.
const CLIENTS: usize = 64;
/// How many events a client may be behind before it loses some.
const BEHIND: usize = 1024;
/// How long clients may take to hear how the app ended.
const FAREWELL: Duration = Duration::from_secs(1);
/// How long the answer to a line of text is waited for, unless the request says otherwise.
const SAY_LIMIT: Duration = Duration::from_secs(600);
/// The longest that a request may have its answer waited for, s.
const MOST_SAY_LIMIT_S: f64 = 86_400.0;
/// How many of its last lines the status of a chassis shows of each process.
const STATUS_LINES: usize = 10;

/// What happens to an app, for its clients.
#[derive(Debug, Clone)]
enum News {
    Event(BootEvent),
    Ended(EndView),
}

/// What happens to an app, for whoever subscribes.
#[derive(Debug, Clone)]
pub(crate) struct Ticker(broadcast::Sender<News>);

impl Ticker {
    /// An observer that tells `observer` and the clients.
    pub(crate) fn observe(observer: &Observer) -> (Self, Observer) {
        let ticker = Self(broadcast::channel(BEHIND).0);
        let (news, observer) = (ticker.0.clone(), observer.clone());
        let both: Observer = Arc::new(move |event: &BootEvent| {
            // Progress and log lines are asked for in other ways.
            if !matches!(event, BootEvent::Log { .. } | BootEvent::Progress { .. }) {
                // Nobody may be listening.
                let _ = news.send(News::Event(event.clone()));
            }
            observer(event);
        });
        (ticker, both)
    }
}

/// Serves clients until it is told how the app ended. Dropped without that, it takes its socket away.
pub(crate) struct Server {
    path: Option<PathBuf>,
    ticker: Ticker,
    serving: Vec<JoinHandle<()>>,
    clients: Arc<Semaphore>,
}

impl Server {
    /// Serves in the user's folder of sockets, and tools of other hosts at `listener`. An app that can
    /// have no socket there runs without.
    pub(crate) fn start(
        chassis: &Arc<Chassis>,
        logs: &Arc<LogStore>,
        ticker: Ticker,
        listener: Option<Listener>,
    ) -> Self {
        let clients = Arc::new(Semaphore::new(CLIENTS));
        let desk = Arc::new(Desk {
            chassis: chassis.clone(),
            logs: logs.clone(),
            ticker: ticker.clone(),
            recordings: Arc::default(),
            speakers: AtomicU64::new(0),
        });
        let mut serving = Vec::new();
        if let Some(listener) = listener {
            let served = gate::serve(listener, desk.clone(), clients.clone());
            serving.push(tokio::spawn(served));
        }
        let path = match Self::socket(chassis) {
            Ok((listener, path)) => {
                serving.push(tokio::spawn(serve(listener, desk, clients.clone())));
                Some(path)
            }
            Err(error) => {
                tracing::warn!(error = %error, "no control socket: `ctos ps` and the like do not see this app");
                None
            }
        };
        Self {
            path,
            ticker,
            serving,
            clients,
        }
    }

    /// A socket in the user's folder.
    fn socket(chassis: &Arc<Chassis>) -> io::Result<(UnixListener, PathBuf)> {
        let folder = place::folder();
        place::prepare(&folder)?;
        // Removes those of apps that were killed.
        place::sockets(&folder);
        let socket = place::socket(&folder, &chassis.app.name, std::process::id());
        // One of a process of the same number, before the last start of the machine.
        let _ = std::fs::remove_file(&socket.path);
        let listener = UnixListener::bind(&socket.path)?;
        std::fs::set_permissions(&socket.path, std::fs::Permissions::from_mode(0o600))?;
        Ok((listener, socket.path))
    }

    /// Tells the clients how the app ended, and goes.
    pub(crate) async fn finish(self, outcome: &Outcome) {
        let ended = EndView {
            ok: matches!(&outcome.end, End::Finished(result) if result.ok),
            reason: match &outcome.end {
                End::Finished(result) if !result.ok => result.text.clone(),
                end => end.reason().to_string(),
            },
            casualties: outcome.casualties.clone(),
        };
        // Nobody may be listening.
        let _ = self.ticker.0.send(News::Ended(ended));
        let count = u32::try_from(CLIENTS).unwrap_or(u32::MAX);
        let all_gone = self.clients.acquire_many(count);
        // One that does not read is not waited for.
        let _ = tokio::time::timeout(FAREWELL, all_gone).await;
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        for serving in &self.serving {
            serving.abort();
        }
        if let Some(path) = &self.path {
            // Nobody else removes it but for good reasons.
            let _ = std::fs::remove_file(path);
        }
    }
}

async fn serve(listener: UnixListener, desk: Arc<Desk>, clients: Arc<Semaphore>) {
    let mut serving = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => {
                    let own = stream.peer_cred().is_ok_and(|peer| {
                        peer.uid() == place::uid() || peer.uid() == 0
                    });
                    if !own {
                        desk.refuse("a client of another user", "the socket is its user's own");
                        continue;
                    }
                    let place = clients.clone().try_acquire_owned();
                    let desk = desk.clone();
                    serving.spawn(async move {
                        let (reader, writer) = stream.into_split();
                        let mut writer: Writer = Box::new(writer);
                        match place {
                            Ok(_place) => {
                                // The user may do what he likes with what is his.
                                let client = Client { who: "its user".to_owned(), role: Role::Boot };
                                desk.client(&client, Box::new(reader), writer).await
                            }
                            Err(_) => tell(&mut writer, &busy()).await,
                        }
                    });
                }
                Err(error) => {
                    tracing::warn!(error = %error, "a client was lost");
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
            },
            Some(_) = serving.join_next() => {}
        }
    }
}

/// There are too many clients.
pub(super) fn busy() -> Answer {
    error(ErrorCode::Busy, "too many clients at once")
}

pub(super) fn error(code: ErrorCode, message: impl Into<String>) -> Answer {
    Answer::Error(ErrorView {
        code,
        message: message.into(),
        known: Vec::new(),
    })
}

fn failed(fault: &Fault) -> Answer {
    match fault {
        Fault::Refused { text } => error(ErrorCode::Failed, text),
        Fault::Deadline { after } => error(
            ErrorCode::TimedOut,
            format!("no answer within {:.1} s", after.as_secs_f64()),
        ),
        Fault::PeerDown { chassis } => {
            error(ErrorCode::Failed, format!("chassis `{chassis}` is gone"))
        }
        other => error(ErrorCode::Failed, format!("{other:?}")),
    }
}

pub(super) async fn tell(writer: &mut Writer, answer: &Answer) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    writer.write_all(&line).await?;
    writer.flush().await
}

/// What clients are served from.
pub(super) struct Desk {
    chassis: Arc<Chassis>,
    logs: Arc<LogStore>,
    ticker: Ticker,
    recordings: Arc<Recordings>,
    /// Counts the clients, so that no two have the same name.
    speakers: AtomicU64,
}

/// A client, as the tasks know it that it says lines to.
struct Speaker {
    name: String,
    /// Those that it has spoken to.
    heard: BTreeSet<Tid>,
}

impl Desk {
    /// Logs and counts that somebody was refused.
    pub(super) fn refuse(&self, who: &str, reason: &str) {
        let refused = self.chassis.refused.fetch_add(1, Ordering::Relaxed) + 1;
        tracing::warn!(who, reason, refused, "a client was refused");
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
        reader: Reader,
        mut writer: Writer,
    ) -> io::Result<()> {
        let mut reader = BufReader::new(reader);
        let mut news = self.ticker.0.subscribe();
        loop {
            let mut line = Vec::new();
            let mut limited = (&mut reader).take(REQUEST_LIMIT);
            tokio::select! {
                read = limited.read_until(b'\n', &mut line) => {
                    if read? == 0 {
                        return Ok(());
                    }
                }
                // A client that asks for nothing must not be waited for when the app has ended.
                () = ended(&mut news) => return Ok(()),
            }
            if line.last() != Some(&b'\n') {
                let long = error(
                    ErrorCode::BadRequest,
                    "a request is one line of at most 64 KiB",
                );
                return tell(&mut writer, &long).await;
            }
            match serde_json::from_slice::<Ask>(&line) {
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

    async fn answer(
        &self,
        request: Request,
        speaker: &mut Speaker,
        writer: &mut Writer,
    ) -> io::Result<()> {
        match request {
            Request::Say(request) => {
                let answer = self.say(request, speaker).await;
                tell(writer, &answer).await
            }
            Request::Ps {} => {
                let answer = view::app(&self.chassis, &self.logs).await;
                let answer = answer.map_or_else(|fault| failed(&fault), Answer::App);
                tell(writer, &answer).await
            }
            Request::Status { name } => {
                let answer = self.status(&name).await;
                tell(writer, &answer).await
            }
            Request::Logs(request) => self.logs(&request, writer).await,
            Request::Stop { now } => self.stop(now, writer).await,
            Request::Restart { name } => {
                let answer = self.restart(&name).await;
                tell(writer, &answer).await
            }
            Request::Record(request) => self.record(request, writer).await,
            Request::RecordStop { key } => {
                let answer = if self.recordings.stop(key) {
                    Answer::Done {}
                } else {
                    error(ErrorCode::NoSuchName, format!("there is no record {key}"))
                };
                tell(writer, &answer).await
            }
            Request::Move { task, to } => {
                let mut moving = Moving::new(&self.chassis, &self.logs, task, to);
                while let Some(answer) = moving.next().await {
                    tell(writer, &answer).await?;
                }
                Ok(())
            }
        }
    }

    fn no_such_name(&self, name: &str) -> Answer {
        let app = &self.chassis.app;
        let tasks = app.tasks.iter().map(|task| task.name.clone());
        let chassis = app.chassis.iter().map(|chassis| chassis.name.clone());
        Answer::Error(ErrorView {
            code: ErrorCode::NoSuchName,
            message: format!("no task or chassis of `{}` is called `{name}`", app.name),
            known: tasks.chain(chassis).collect(),
        })
    }

    async fn status(&self, name: &str) -> Answer {
        let app = match view::app(&self.chassis, &self.logs).await {
            Ok(app) => app,
            Err(fault) => return failed(&fault),
        };
        let task = app.tasks.iter().find(|task| task.name == name).cloned();
        let home = task.as_ref().map_or(name, |task| task.chassis.as_str());
        let Some(chassis) = app.chassis.iter().find(|one| one.name == home).cloned() else {
            return self.no_such_name(name);
        };
        let is_task = task.is_some();
        let tasks = match task {
            Some(task) => vec![task],
            None => app
                .tasks
                .into_iter()
                .filter(|task| task.chassis == chassis.name)
                .collect(),
        };
        Answer::Status(Box::new(StatusView {
            app: app.app,
            up_s: app.up_s,
            logs: self.process_logs(&chassis.name, is_task.then_some(name)),
            chassis,
            tasks,
            is_task,
        }))
    }

    /// The last lines of a chassis's processes; of the present one those about `task`, if one is named.
    fn process_logs(&self, chassis: &str, task: Option<&str>) -> Vec<ProcessLog> {
        let mut logs: Vec<ProcessLog> = self
            .logs
            .processes(chassis)
            .into_iter()
            .map(|(incarnation, pid)| ProcessLog {
                incarnation,
                pid,
                lines: Vec::new(),
            })
            .collect();
        let present = logs.last().map_or(0, |log| log.incarnation);
        for line in self.logs.lines() {
            let wanted = line.chassis == chassis
                && (line.incarnation != present || task.is_none_or(|task| line.is_about(task)));
            let log = logs
                .iter_mut()
                .find(|log| log.incarnation == line.incarnation);
            if let Some(log) = log.filter(|_| wanted) {
                if log.lines.len() == STATUS_LINES {
                    log.lines.remove(0);
                }
                log.lines.push(line);
            }
        }
        logs
    }

    async fn logs(&self, request: &LogRequest, writer: &mut Writer) -> io::Result<()> {
        let app = &self.chassis.app;
        if let Some(name) = &request.name {
            let chassis = app.chassis.iter().any(|chassis| chassis.name == *name);
            if !chassis && app.task(name).is_none() {
                return tell(writer, &self.no_such_name(name)).await;
            }
        }
        let mut news = self.ticker.0.subscribe();
        let (lines, mut following) = self.logs.follow();
        let last_at = lines.last().map_or(f64::NEG_INFINITY, |line| line.at_s);
        let chosen: Vec<LogLine> = lines
            .into_iter()
            .filter(|line| self.is_wanted(line, request))
            .collect();
        let skipped = request
            .last
            .map_or(0, |last| chosen.len().saturating_sub(last));
        for line in chosen.into_iter().skip(skipped) {
            tell(writer, &Answer::Log(line)).await?;
        }
        let mut is_over = false;
        while request.follow && !is_over {
            tokio::select! {
                biased;
                line = following.recv() => match line {
                    Ok(line) if line.at_s > last_at && self.is_wanted(&line, request) => {
                        tell(writer, &Answer::Log(line)).await?;
                    }
                    Ok(_) => {}
                    Err(broadcast::error::RecvError::Lagged(lines)) => {
                        tell(writer, &Answer::Lost { lines }).await?;
                    }
                    Err(broadcast::error::RecvError::Closed) => is_over = true,
                },
                () = ended(&mut news) => is_over = true,
            }
        }
        tell(writer, &Answer::Done {}).await
    }

    fn is_wanted(&self, line: &LogLine, request: &LogRequest) -> bool {
        let level = request.level.is_none_or(|level| line.level >= level);
        let since = request.since_s.is_none_or(|since| line.at_s >= since);
        let name = request.name.as_ref().is_none_or(|name| {
            let declared = self.chassis.app.task(name);
            let here = declared.is_some_and(|task| task.chassis == line.chassis);
            // A task that has moved is known by its field alone elsewhere.
            line.chassis == *name
                || declared.is_some() && line.is_of(name)
                || here && line.is_about(name)
        });
        level && since && name
    }

    /// Says a line to a task, in the name of a client.
    async fn say(&self, request: SayRequest, speaker: &mut Speaker) -> Answer {
        let limit = match request.limit_s {
            None => SAY_LIMIT,
            Some(limit) if (0.0..=MOST_SAY_LIMIT_S).contains(&limit) => {
                Duration::from_secs_f64(limit)
            }
            Some(limit) => {
                let text = format!("`limit_s` is 0 to {MOST_SAY_LIMIT_S} s, not {limit}");
                return error(ErrorCode::BadRequest, text);
            }
        };
        let query = system::QueryTid {
            name: request.task.clone(),
        };
        let found = view::ask(&self.chassis, system::TID_SERVER, query, SAY_LIMIT).await;
        let task = match found {
            Ok(Ok(task)) => task,
            Ok(Err(_)) if self.chassis.app.task(&request.task).is_some() => {
                let text = format!(
                    "task `{}` is not there just now: its chassis is being started again, or it has ended",
                    request.task
                );
                return error(ErrorCode::Failed, text);
            }
            Ok(Err(_)) => return self.no_such_name(&request.task),
            Err(fault) => return failed(&fault),
        };
        speaker.heard.insert(task);
        let say = Say {
            line: request.line,
            from: speaker.name.clone(),
            trace: request.trace,
        };
        match view::ask(&self.chassis, task, say, limit).await {
            Ok(line) => Answer::Said { line },
            Err(Fault::UnknownCommand { takes }) => {
                let text = format!(
                    "task `{}` takes no lines of text; it takes {}",
                    request.task,
                    takes.join(", ")
                );
                error(ErrorCode::Failed, text)
            }
            Err(fault) => failed(&fault),
        }
    }

    async fn stop(&self, now: bool, writer: &mut Writer) -> io::Result<()> {
        let mut news = self.ticker.0.subscribe();
        self.chassis.post_system(system::BOOTSTRAP, Interrupt {});
        loop {
            match news.recv().await {
                Ok(News::Event(what)) => {
                    if now && matches!(what, BootEvent::Stopping { .. } | BootEvent::Stopped { .. })
                    {
                        self.chassis.post_system(system::BOOTSTRAP, Interrupt {});
                    }
                    tell(writer, &Answer::Event { what }).await?;
                }
                Ok(News::Ended(ended)) => return tell(writer, &Answer::Ended(ended)).await,
                Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => return Ok(()),
            }
        }
    }

    async fn record(&self, request: RecordRequest, writer: &mut Writer) -> io::Result<()> {
        let mut news = self.ticker.0.subscribe();
        let begun = Recording::begin(&self.chassis, &self.recordings, request).await;
        let mut recording = match begun {
            Ok(recording) => recording,
            Err(wrong) => return tell(writer, &Answer::Error(wrong)).await,
        };
        tell(writer, &Answer::Recording(recording.view())).await?;
        while let Some(answer) = recording.next(restarted(&mut news)).await {
            tell(writer, &answer).await?;
        }
        Ok(())
    }

    async fn restart(&self, name: &str) -> Answer {
        let app = &self.chassis.app;
        // Every phase and every rung of the ladder may take its time.
        let limit = app.phase_timeout.saturating_mul(4) + app.stop_timeout.saturating_mul(4);
        let chassis = (1..).zip(&app.chassis).find(|(_, one)| one.name == name);
        let restarted = if let Some((chassis, _)) = chassis {
            view::ask(
                &self.chassis,
                system::BOOTSTRAP,
                RestartChassis { chassis },
                limit,
            )
            .await
        } else {
            let overview = view::app(&self.chassis, &self.logs).await;
            if let Err(fault) = overview {
                return failed(&fault);
            }
            let query = system::QueryTid {
                name: name.to_owned(),
            };
            match view::ask(&self.chassis, system::TID_SERVER, query, limit).await {
                Ok(Ok(tid)) => view::ask(&self.chassis, tid, RestartTask {}, limit).await,
                Ok(Err(_)) => return self.no_such_name(name),
                Err(fault) => Err(fault),
            }
        };
        match restarted {
            Ok(()) => Answer::Done {},
            Err(fault) => failed(&fault),
        }
    }
}

/// The next chassis that is started again; `None` when the app has ended.
async fn restarted(news: &mut broadcast::Receiver<News>) -> Option<String> {
    loop {
        match news.recv().await {
            Ok(News::Event(BootEvent::Restarted { chassis, .. })) => return Some(chassis),
            Ok(News::Ended(_)) | Err(broadcast::error::RecvError::Closed) => return None,
            Ok(News::Event(_)) | Err(broadcast::error::RecvError::Lagged(_)) => {}
        }
    }
}

/// Ends when the app has.
async fn ended(news: &mut broadcast::Receiver<News>) {
    loop {
        match news.recv().await {
            Ok(News::Ended(_)) | Err(broadcast::error::RecvError::Closed) => return,
            Ok(News::Event(_)) | Err(broadcast::error::RecvError::Lagged(_)) => {}
        }
    }
}

/// Ends when the client has closed its end, also while it is being answered.
async fn closed(reader: &mut BufReader<Reader>) {
    match reader.fill_buf().await {
        Ok([]) | Err(_) => {}
        // Its next request, which is read in its turn.
        Ok(_) => std::future::pending().await,
    }
}
