//! The task: passes to its program what it is asked, and carries out what the program says.

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, VecDeque},
    future::poll_fn,
    rc::Rc,
    sync::Arc,
    task::Poll,
    time::Duration,
};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use ctos::{
    message::{CommandInfo, Message, RawReplier, Shape},
    reactor,
    survey::AtReport,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Handover, Phase, StopReason},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::sync::{Notify, oneshot};

use crate::{
    args::{self, Args},
    encode::encoded,
    frames::{Frames, base64},
    hello,
    lines::{Asked, Hello, Level, Said, Told, VERSION},
    process::{Event, Events, Listening, Plan, Program},
    types::Shown,
};

ctos::command! {
    /// Asks the service object that the program is, by EXEC.
    #[derive(Debug, Clone, PartialEq)]
    pub struct AskObject {
        /// Text (`TMSG`).
        pub text: String,
        /// Floats (`FMSG`).
        pub floats: Vec<f64>,
        /// Whole numbers (`IMSG`).
        pub ints: Vec<i64>,
    } => ObjectAnswer, 0xfe00, "ask_object"
}

/// What the object answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectAnswer {
    /// Text.
    pub text: String,
    /// Floats.
    pub floats: Vec<f64>,
    /// Whole numbers.
    pub ints: Vec<i64>,
}

/// In virtual time the host waits so long for the end of a step, by its own clock.
const STEP: Duration = Duration::from_secs(60);
/// The longest data of a message or a reply, bytes of JSON.
const LONGEST: usize = 256 << 20;
/// So many lines are taken before others of the processor have their turn.
const AT_ONCE: u64 = 16;
/// So many of its own questions may be under way.
const MOST_ASKING: usize = 256;
/// Of a wrong line, so much is shown.
const SHOWN: usize = 120;

/// A command with its types.
#[derive(Clone)]
struct Known {
    info: CommandInfo,
    request: Shape,
    reply: Shape,
}

impl Known {
    fn of(info: CommandInfo) -> Result<Self, String> {
        let unknown = || format!("the types of `{}` cannot be told to a program", info.name);
        Ok(Self {
            info,
            request: info.request.shape().ok_or_else(unknown)?,
            reply: info.reply.shape().ok_or_else(unknown)?,
        })
    }
}

/// A message that the program has not answered.
struct Open {
    known: Rc<Known>,
    reply: RawReplier,
    done: oneshot::Sender<()>,
}

/// Where the events of a program come from.
enum Source {
    Pipe(Listening),
    /// From the steps that are made.
    Steps(Rc<Shared>),
    /// From the record.
    Record,
}

impl Source {
    async fn next(&mut self) -> Event {
        match self {
            Self::Pipe(pipe) => pipe.next().await,
            Self::Steps(shared) => loop {
                let event = shared.queue.borrow_mut().pop_front();
                match event {
                    Some(event) => return event,
                    None => shared.came.notified().await,
                }
            },
            Self::Record => std::future::pending().await,
        }
    }
}

struct Shared {
    args: Args,
    commands: BTreeMap<u16, Rc<Known>>,
    program: RefCell<Option<Program>>,
    frames: RefCell<Option<Arc<Frames>>>,
    /// Whether the program takes frames.
    framed: Cell<bool>,
    /// In virtual time, what the program writes.
    events: RefCell<Option<Receiver<Event>>>,
    queue: RefCell<VecDeque<Event>>,
    came: Notify,
    steps: Cell<u64>,
    open: RefCell<BTreeMap<u64, Open>>,
    /// The next message's number.
    next: Cell<u64>,
    /// Its own questions that are under way.
    asking: Cell<usize>,
    asked: RefCell<BTreeMap<(String, String), Rc<Known>>>,
    kept: RefCell<Option<Value>>,
    /// The trace of the message at hand.
    trace: Cell<u64>,
    stopping: Cell<bool>,
    over: Cell<bool>,
    ended: Notify,
}

/// The event handler.
pub(crate) struct Programmed {
    shared: Rc<Shared>,
}

impl Programmed {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let commands = args::commands(cx);
        let known = commands
            .iter()
            .map(|info| Ok((info.code, Rc::new(Known::of(*info)?))));
        let shared = Shared {
            args: cx.args()?,
            commands: known.collect::<Result<_, String>>()?,
            program: RefCell::default(),
            frames: RefCell::default(),
            framed: Cell::default(),
            events: RefCell::default(),
            queue: RefCell::default(),
            came: Notify::new(),
            steps: Cell::default(),
            open: RefCell::default(),
            next: Cell::new(1),
            asking: Cell::default(),
            asked: RefCell::default(),
            kept: RefCell::default(),
            trace: Cell::default(),
            stopping: Cell::default(),
            over: Cell::default(),
            ended: Notify::new(),
        };
        Ok(Self {
            shared: Rc::new(shared),
        })
    }

    /// Starts the program, and waits for its hello.
    async fn begin(&self, cx: &Context) -> Handled {
        let shared = &self.shared;
        let mut source = shared.start(cx)?;
        shared.hello(cx)?;
        let limit = Duration::from_secs_f64(shared.args.start_s);
        let first = cx.outside_wait("what its program says", source.next());
        let first = cx.timeout(limit, first).await.map_err(|_| {
            let after = shared.args.start_s;
            HandlerError::new(format!("its program did not say hello within {after} s"))
        })?;
        let hello = match first {
            Event::Line(line) => match serde_json::from_str(&line) {
                Ok(Said::Hello(hello)) => hello,
                _ => {
                    let line = shown(&line);
                    let text = format!("its program said no hello at first, but `{line}`");
                    return Err(HandlerError::new(text));
                }
            },
            Event::Ended(why) | Event::Wrong(why) => return Err(HandlerError::new(why)),
        };
        shared.greets(cx, &hello)?;
        let (child, shared) = (cx.clone(), Rc::clone(shared));
        cx.spawn(async move { hear(&child, &shared, source).await });
        Ok(())
    }
}

fn is_virtual(cx: &Context) -> bool {
    cx.chassis().clock().origin_ns().is_none()
}

fn shown(line: &str) -> String {
    let mut text: String = line.trim_end().chars().take(SHOWN).collect();
    if text.len() < line.trim_end().len() {
        text.push_str("...");
    }
    text
}

/// Lets the other tasks of the processor go on, who would wait for one that writes without end.
async fn others_first() {
    let mut waited = false;
    poll_fn(|poll| {
        if std::mem::replace(&mut waited, true) {
            return Poll::Ready(());
        }
        poll.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// Takes what the program says, one line after the other.
async fn hear(cx: &Context, shared: &Rc<Shared>, mut source: Source) {
    for number in 1_u64.. {
        if number.is_multiple_of(AT_ONCE) {
            others_first().await;
        }
        let event = cx
            .outside_wait("what its program says", source.next())
            .await;
        let wrong = match event {
            Event::Line(line) => match serde_json::from_str::<Said>(&line) {
                Ok(said) => shared.take(cx, said).err(),
                Err(error) => {
                    let line = shown(&line);
                    Some(format!(
                        "its program wrote what is no line of the protocol ({error}): `{line}`"
                    ))
                }
            },
            Event::Ended(why) | Event::Wrong(why) => Some(why),
        };
        if let Some(why) = wrong {
            return shared.end(cx, &why);
        }
    }
}

impl Shared {
    /// Starts the program; in a replay its lines come out of the record.
    fn start(self: &Rc<Self>, cx: &Context) -> Result<Source, HandlerError> {
        if cx.is_replay() {
            return Ok(Source::Record);
        }
        let (args, real) = (&self.args, !is_virtual(cx));
        let command = hello::command(args, cx.app()).map_err(HandlerError::new)?;
        let frames = Frames::new(LONGEST).map(Arc::new);
        let plan = Plan {
            task: cx.name(),
            command: &command,
            folder: hello::folder(cx.app()),
            environment: hello::environment(args, cx.name()),
            line: usize::try_from(args.line_mib).unwrap_or(1) << 20,
            logs: real,
            frames: frames.clone(),
        };
        let reactor = match real {
            true => {
                let shared = cx.chassis().shared(reactor::SHARED);
                Some(shared.ok_or("its chassis has no reactor that could read its program")?)
            }
            false => None,
        };
        let (program, events) = Program::start(&plan, reactor).map_err(HandlerError::new)?;
        self.frames.replace(frames);
        if real {
            let text = format!("its program is process {}", program.id());
            cx.is_at(Some(AtReport { text, until: None }));
        }
        self.program.replace(Some(program));
        Ok(match events {
            Events::Pipe(pipe) => Source::Pipe(pipe),
            Events::Thread(events) => {
                self.events.replace(Some(events));
                Source::Steps(Rc::clone(self))
            }
        })
    }

    fn hello(&self, cx: &Context) -> Handled {
        let frames = self.frames.borrow().clone();
        let hello = Told::Hello {
            protocol: VERSION,
            task: cx.name(),
            app: cx.app().name.as_str(),
            args: &self.args.args,
            seed: cx.app().seed,
            virtual_time: is_virtual(cx),
            state: self.kept.borrow().clone(),
            frames: frames.as_deref().map(Frames::folder),
            declare: false,
        };
        self.tell(hello.line()).map_err(HandlerError::new)
    }

    /// Appends a value to a line.
    fn json(&self, shape: &Shape, bytes: &[u8], line: &mut Vec<u8>) -> Option<()> {
        let frames = self.frames.borrow();
        let frames = frames.as_ref().filter(|_| self.framed.get());
        shape.tell(bytes, line, LONGEST, &mut |bytes, line| match frames {
            Some(frames) => frames.write(bytes, line),
            None => base64(bytes, line),
        })
    }

    /// Whether it is the program that the configuration tells of.
    fn greets(&self, cx: &Context, hello: &Hello) -> Handled {
        let refuse = |text: String| Err(HandlerError::new(text));
        if hello.protocol != VERSION {
            let protocol = hello.protocol;
            return refuse(format!(
                "its program speaks version {protocol} of the protocol, this is version {VERSION}"
            ));
        }
        if is_virtual(cx) && !hello.deterministic {
            return refuse(
                "its program says that it is not deterministic, so this run could not be repeated: run it in real time"
                    .to_owned(),
            );
        }
        self.framed.set(hello.frames);
        for offered in &hello.commands {
            let name = &offered.name;
            let mut known = self.commands.values();
            let Some(known) = known.find(|known| known.info.name == *name) else {
                return refuse(format!(
                    "its program says that it takes `{name}`, which nobody was told: declare it in the TOML file beside the program"
                ));
            };
            for (what, said, declared) in [
                ("request", &offered.request, &known.request),
                ("reply", &offered.reply, &known.reply),
            ] {
                let Some(said) = said else { continue };
                if said.0 != *declared {
                    let (said, declared) = (Shown(&said.0), Shown(declared));
                    return refuse(format!(
                        "its program says that the {what} of `{name}` is {said}; declared is {declared}"
                    ));
                }
            }
        }
        Ok(())
    }

    /// Writes a line to the program. In virtual time the clock stands still until it has done all that follows from it.
    ///
    /// # Errors
    /// It does not read.
    fn tell(&self, line: Vec<u8>) -> Result<(), String> {
        let program = self.program.borrow();
        let Some(program) = program.as_ref().filter(|_| !self.over.get()) else {
            return Ok(());
        };
        program.write(line)?;
        if let Some(events) = &*self.events.borrow() {
            self.steps.set(self.steps.get() + 1);
            let id = self.steps.get();
            program.write(Told::Step { id }.line())?;
            self.settle(events, Some(id), STEP);
        }
        Ok(())
    }

    /// Takes lines until the step `id` is done, or the program has ended.
    fn settle(&self, events: &Receiver<Event>, id: Option<u64>, limit: Duration) -> bool {
        let ended = loop {
            let event = match events.recv_timeout(limit) {
                Ok(event) => event,
                Err(RecvTimeoutError::Disconnected) => break true,
                Err(RecvTimeoutError::Timeout) => {
                    let limit = limit.as_secs();
                    let text = format!(
                        "its program did not end its step within {limit} s of the host's clock"
                    );
                    self.queue
                        .borrow_mut()
                        .extend(id.map(|_| Event::Wrong(text)));
                    break false;
                }
            };
            if let (Event::Line(line), Some(id)) = (&event, id)
                && line.contains("\"step\"")
                && let Ok(Said::Step { id: done }) = serde_json::from_str(line)
                && done == id
            {
                break true;
            }
            let last = !matches!(event, Event::Line(_));
            self.queue.borrow_mut().push_back(event);
            if last {
                break true;
            }
        };
        self.came.notify_one();
        ended
    }

    /// Carries out a line.
    ///
    /// # Errors
    /// It is one that ends the program.
    fn take(self: &Rc<Self>, cx: &Context, said: Said) -> Result<(), String> {
        match said {
            Said::Hello(_) => return Err("its program said hello twice".to_owned()),
            Said::Reply { id, data } => self.answer(cx, id, Ok(&data))?,
            Said::Error { id, text } => self.answer(cx, id, Err(text))?,
            Said::Call(asked) => self.ask(cx, asked, true)?,
            Said::Send(asked) => self.ask(cx, asked, false)?,
            Said::Log { level, text } => log(cx, level, &text),
            Said::Keep { state } => drop(self.kept.replace(Some(state))),
            Said::At { text } => cx.is_at(Some(AtReport { text, until: None })),
            Said::Finish { ok, text } => {
                let json = json!({"ok": ok, "text": text}).to_string();
                cx.finish(AppResult { ok, text, json });
            }
            Said::Step { .. } => {}
        }
        Ok(())
    }

    fn answer(&self, cx: &Context, id: u64, answer: Result<&Value, String>) -> Result<(), String> {
        let Some(open) = self.open.borrow_mut().remove(&id) else {
            if id >= self.next.get() {
                return Err(format!(
                    "its program answered message {id}, which it was never told"
                ));
            }
            tracing::warn!(
                task = cx.name(),
                id,
                "its program answered twice, or too late"
            );
            return Ok(());
        };
        let Open { known, reply, done } = open;
        let name = known.info.name;
        let bytes = answer.and_then(|data| {
            encoded(&known.reply, data)
                .map_err(|why| format!("the answer of its program to `{name}` does not fit: {why}"))
        });
        match bytes {
            Ok(bytes) => reply.ok(bytes),
            Err(text) => {
                if !reply.is_wanted() {
                    tracing::warn!(task = cx.name(), command = name, "{text}");
                }
                reply.fail(text);
            }
        }
        // Who handles it may have been interrupted.
        let _ = done.send(());
        Ok(())
    }

    /// Asks another task what the program asks.
    ///
    /// # Errors
    /// The program does not read that it asks too much.
    fn ask(self: &Rc<Self>, cx: &Context, asked: Asked, replies: bool) -> Result<(), String> {
        if self.asking.get() >= MOST_ASKING {
            let (id, text) = (
                asked.id,
                format!("too many questions are under way: {MOST_ASKING}"),
            );
            return self.tell(Told::Error { id, text: &text }.line());
        }
        let (shared, child) = (Rc::clone(self), cx.within(self.trace.get()));
        self.asking.update(|asking| asking + 1);
        cx.spawn(async move {
            let answer = shared.carry(&child, &asked, replies).await;
            shared.asking.update(|asking| asking - 1);
            let id = asked.id;
            let line = match answer {
                Ok(None) => return,
                Ok(Some(line)) => line,
                Err(text) => Told::Error { id, text: &text }.line(),
            };
            if let Err(why) = shared.tell(line) {
                shared.end(&child, &why);
            }
        });
        Ok(())
    }

    /// The line of the answer.
    async fn carry(
        &self,
        cx: &Context,
        asked: &Asked,
        replies: bool,
    ) -> Result<Option<Vec<u8>>, String> {
        let Asked {
            id, task, command, ..
        } = asked;
        if !self.args.asks.contains(task) {
            return Err(format!(
                "`{}` may not ask `{task}`: name it in `asks` of its arguments",
                cx.name()
            ));
        }
        let known = self.known(cx, task, command)?;
        let data = encoded(&known.request, &asked.data)
            .map_err(|why| format!("the data of `{task}.{command}` does not fit: {why}"))?;
        let found = cx.task(task).await.map_err(|error| error.to_string())?;
        if !replies {
            let sent = cx.send_raw(&found, known.info, data).await;
            return sent.map(|()| None).map_err(|error| error.to_string());
        }
        let own = cx.config().and_then(|config| config.call_deadline);
        let deadline = match asked.deadline_s {
            Some(seconds) => Duration::try_from_secs_f64(seconds).unwrap_or_default(),
            None => own.unwrap_or(ctos::DEFAULT_DEADLINE),
        };
        let reply = cx.call_raw(&found, known.info, data, deadline).await;
        let reply = reply.map_err(|error| error.to_string())?;
        let mut line = format!("{{\"reply\":{{\"id\":{id},\"data\":").into_bytes();
        let told = self.json(&known.reply, &reply, &mut line);
        told.ok_or_else(|| format!("the reply of `{task}` to `{command}` cannot be told"))?;
        line.extend_from_slice(b"}}\n");
        Ok(Some(line))
    }

    fn known(&self, cx: &Context, task: &str, command: &str) -> Result<Rc<Known>, String> {
        let key = (task.to_owned(), command.to_owned());
        if let Some(known) = self.asked.borrow().get(&key) {
            return Ok(Rc::clone(known));
        }
        let info = cx.registry().command_of(cx.app(), task, command);
        let info = info.map_err(|finding| finding.to_string())?;
        let known = Rc::new(Known::of(info)?);
        self.asked.borrow_mut().insert(key, Rc::clone(&known));
        Ok(known)
    }

    /// The program has ended, or is ended: nothing more comes of it.
    fn end(&self, cx: &Context, why: &str) {
        if self.over.replace(true) {
            return;
        }
        if let Some(program) = &*self.program.borrow() {
            program.kill();
        }
        for (_, Open { reply, done, .. }) in std::mem::take(&mut *self.open.borrow_mut()) {
            reply.fail(why);
            let _ = done.send(());
        }
        self.ended.notify_one();
        if !self.stopping.get() {
            cx.broke(why);
        }
    }
}

fn log(cx: &Context, level: Level, text: &str) {
    let task = cx.name();
    match level {
        Level::Debug => tracing::debug!(task, "{text}"),
        Level::Info => tracing::info!(task, "{text}"),
        Level::Warning => tracing::warn!(task, "{text}"),
        Level::Error => tracing::error!(task, "{text}"),
    }
}

impl EventHandler for Programmed {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let shared = &self.shared;
        let Some(known) = shared.commands.get(&message.command()) else {
            return cx.default_processing(message);
        };
        shared.trace.set(message.trace());
        let left = message.deadline().map(|deadline| deadline.since(cx.now()));
        let (bytes, reply) = message.open_raw()?;
        let (id, name) = (shared.next.get(), known.info.name);
        let left = left.map_or_else(String::new, |left| {
            format!("\"left_s\":{},", left.as_secs_f64())
        });
        let mut line =
            format!("{{\"message\":{{\"id\":{id},\"command\":\"{name}\",{left}\"data\":")
                .into_bytes();
        if shared.json(&known.request, &bytes, &mut line).is_none() {
            reply.fail(format!(
                "the data of `{name}` cannot be told to the program"
            ));
            return Ok(());
        }
        line.extend_from_slice(b"}}\n");
        shared.next.set(id + 1);
        let (done, ends) = oneshot::channel();
        let known = Rc::clone(known);
        shared
            .open
            .borrow_mut()
            .insert(id, Open { known, reply, done });
        if let Err(why) = shared.tell(line) {
            shared.end(cx, &why);
        }
        match shared.args.answer_s {
            None => drop(ends.await),
            Some(limit) => {
                if cx
                    .timeout(Duration::from_secs_f64(limit), ends)
                    .await
                    .is_err()
                {
                    shared.end(
                        cx,
                        &format!("its program did not answer `{name}` within {limit} s"),
                    );
                }
            }
        }
        Ok(())
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        match phase {
            Phase::Create => self.begin(cx).await?,
            Phase::Run => self.shared.tell(Told::Run {}.line())?,
            Phase::Connect => {}
        }
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        let shared = &self.shared;
        shared.stopping.set(true);
        if shared.over.get() || cx.is_replay() {
            return Ok(());
        }
        let grace = Duration::from_secs_f64(shared.args.grace_s);
        let reason = reason.to_string();
        // One that does not read is killed below.
        let _ = shared.tell(Told::Stop { reason: &reason }.line());
        if let Some(program) = &*shared.program.borrow() {
            program.close();
        }
        let in_time = match &*shared.events.borrow() {
            Some(events) => shared.settle(events, None, grace),
            None => true,
        };
        let in_time = in_time && cx.timeout(grace, shared.ended.notified()).await.is_ok();
        if !in_time {
            let grace = shared.args.grace_s;
            tracing::warn!(
                task = cx.name(),
                "its program did not stop within {grace} s: killed"
            );
            shared.end(cx, "it is being stopped");
        }
        Ok(())
    }
}

impl Handover for Programmed {
    /// What the program keeps, as JSON.
    type State = Option<String>;

    const AFTER_PANIC: bool = true;

    fn hand_over(&mut self) -> Result<Self::State, HandlerError> {
        let shared = &self.shared;
        if shared.asking.get() > 0 && !shared.over.get() {
            return Err("its program waits for the answer of another task".into());
        }
        shared.stopping.set(true);
        Ok(shared.kept.borrow().as_ref().map(Value::to_string))
    }

    fn take_over(&mut self, _: &Context, state: Self::State) -> Handled {
        let state = state
            .map(|state| serde_json::from_str(&state))
            .transpose()?;
        self.shared.kept.replace(state);
        Ok(())
    }
}
