//! A chassis: the tasks of one process, where their messages go, and what they share.
//!
//! Delivery is decided here and nowhere else: a task of this chassis gets a pointer, a task of
//! another one gets a frame over the link. The sender waits the same way for both.

use std::{
    any::Any,
    collections::BTreeMap,
    rc::Rc,
    sync::{
        Arc, Mutex, OnceLock, PoisonError, RwLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::{
    call::{Answer, Fault, Promise, ReplySlot, Waiting, lock},
    config::{App, ProcessorConfig},
    directory::TaskDirectory,
    link::{BODY_LIMIT, Counts, Frame, Full, Link, NO_DEADLINE},
    mailbox::{Acceptance, Mailbox},
    message::{Command, Data, Flags, Header, Message, Tid},
    processor::{Processor, ProcessorHandle},
    realtime::RealtimeGrant,
    record::{Asked, Tap},
    registry::Registry,
    semaphore::{SemaphoreView, Store},
    statistics::TaskStatistics,
    sync::{CyclicStatistics, Directory, Schedule, ScheduleSettings, ScheduleView},
    system,
    time::{Clock, Instant},
    waits::Waits,
    watch::Watch,
};

/// The name of the chassis that boots the others; its number is 0.
pub const BOOT_CHASSIS: &str = "boot";

struct Pending {
    promise: Arc<Promise>,
    peer: u8,
}

#[derive(Default)]
struct Links {
    up: BTreeMap<u8, Arc<dyn Link>>,
    /// What this chassis asked others and has no answer to yet.
    pending: BTreeMap<u64, Pending>,
    next_call: u64,
    /// What others asked this chassis, by chassis and its number for the call: the flag is set when
    /// nobody waits for the answer any more.
    inbound: BTreeMap<(u8, u64), Arc<AtomicBool>>,
}

/// A request that came over a link and waits for its answer.
#[derive(Clone)]
pub(crate) struct Inbound {
    header: Header,
    call: u64,
    trace: u64,
    recorded: u64,
    abandoned: Arc<AtomicBool>,
}

impl Inbound {
    /// Whether the caller, or its chassis, is gone.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.abandoned.load(Ordering::Acquire)
    }
}

/// A request that went over a link and waits for its answer.
pub(crate) struct Outbound {
    chassis: Arc<Chassis>,
    header: Header,
    call: u64,
    trace: u64,
}

impl Outbound {
    /// The sender waits no longer: the receiver need not begin, if it has not.
    pub(crate) fn abandon(self) {
        let peer = self.header.to.chassis();
        let link = {
            let mut links = lock(&self.chassis.links);
            if links.pending.remove(&self.call).is_none() {
                return;
            }
            links.up.get(&peer).cloned()
        };
        if let Some(link) = link {
            // What is not a request is never refused.
            let _ = link.post(Frame {
                header: Header {
                    flags: Flags::ABANDONED,
                    size: 0,
                    ..self.header
                },
                call: self.call,
                trace: self.trace,
                left_ns: NO_DEADLINE,
                body: Vec::new(),
            });
        }
    }

    /// The sender never waited; the message goes its way.
    pub(crate) fn forget(self) {}
}

type OnExit = Box<dyn FnOnce(i32) + Send>;

/// Sees each message that a task of the chassis begins to handle.
pub(crate) type OnDelivery = Box<dyn Fn(&TaskRecord, &Message) + Send + Sync>;

/// A task of this chassis, as the others see it.
pub(crate) struct TaskRecord {
    pub(crate) name: Arc<str>,
    pub(crate) tid: Tid,
    pub(crate) mailbox: Arc<Mailbox>,
    pub(crate) statistics: Arc<TaskStatistics>,
    pub(crate) waits: Waits,
}

/// One process's share of an app. Shared by its threads.
pub struct Chassis {
    index: u8,
    names: Vec<Arc<str>>,
    pub(crate) clock: Clock,
    pub(crate) app: Arc<App>,
    pub(crate) registry: Arc<Registry>,
    /// Processor 0 belongs to the runtime; the configured ones follow.
    pub(crate) processors: Vec<(String, Arc<ProcessorHandle>)>,
    tasks: RwLock<BTreeMap<Tid, Arc<TaskRecord>>>,
    links: Mutex<Links>,
    shared: Mutex<BTreeMap<String, Arc<dyn Any + Send + Sync>>>,
    pub(crate) directory: TaskDirectory,
    on_exit: Mutex<Option<OnExit>>,
    on_delivery: OnceLock<OnDelivery>,
    /// Set by the first order to stop: from then on a chassis that goes is no news.
    stopping: AtomicBool,
    next_trace: AtomicU64,
    cyclics: Arc<Directory>,
    realtime: Mutex<Vec<RealtimeGrant>>,
    /// Its semaphores and barriers.
    pub(crate) blocking: Store,
    /// What looks on: a recorder, a replay, nobody.
    pub(crate) tap: Tap,
    /// What it has seen of itself.
    pub(crate) watch: Watch,
    /// How many callers, and requests of tools, were refused so far.
    pub(crate) refused: AtomicU64,
}

/// What the sender of a message waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WaitFor {
    /// The reply.
    Reply,
    /// That the receiver's queue has taken the message.
    Acceptance,
}

/// Who sends what to whom.
pub(crate) struct Envelope {
    pub(crate) to: Tid,
    pub(crate) from: Tid,
    pub(crate) command: u16,
    pub(crate) flags: Flags,
    pub(crate) data: Data,
    /// 0 when nothing led to it: it then begins a trace of its own.
    pub(crate) trace: u64,
    /// When the sender stops waiting.
    pub(crate) deadline: Option<Instant>,
}

impl Envelope {
    fn header(&self, flags: Flags, size: usize) -> Header {
        Header {
            to: self.to,
            from: self.from,
            command: self.command,
            flags: self.flags.with(flags).with(Flags::OWNED),
            size: u32::try_from(size).unwrap_or(u32::MAX),
        }
    }
}

impl Chassis {
    /// Chassis number `index` of `app`; its processors' threads are started elsewhere.
    pub(crate) fn new(
        index: u8,
        app: Arc<App>,
        registry: Arc<Registry>,
        clock: Clock,
    ) -> Arc<Self> {
        let mut names: Vec<Arc<str>> = vec![BOOT_CHASSIS.into()];
        names.extend(
            app.chassis
                .iter()
                .map(|chassis| chassis.name.as_str().into()),
        );
        let configured = usize::from(index)
            .checked_sub(1)
            .and_then(|place| app.chassis.get(place));
        let mut processors = vec![("system".to_owned(), Arc::default())];
        if let Some(configured) = configured {
            for processor in &configured.processors {
                processors.push((processor.name.clone(), Arc::default()));
            }
        }
        Arc::new(Self {
            index,
            names,
            blocking: Store::new(clock.clone()),
            clock,
            app,
            registry,
            processors,
            tasks: RwLock::default(),
            links: Mutex::default(),
            shared: Mutex::default(),
            directory: TaskDirectory::default(),
            on_exit: Mutex::default(),
            on_delivery: OnceLock::new(),
            stopping: AtomicBool::new(false),
            next_trace: AtomicU64::new(1),
            cyclics: Arc::default(),
            realtime: Mutex::default(),
            tap: Tap::new(index),
            watch: Watch::default(),
            refused: AtomicU64::new(0),
        })
    }

    /// Its number; 0 is the chassis that booted the app.
    #[must_use]
    pub fn index(&self) -> u8 {
        self.index
    }

    /// The app's time, as this chassis sees it.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Its name in the configuration.
    #[must_use]
    pub fn name(&self) -> &str {
        self.name_of(self.index)
    }

    /// The name of chassis number `index`.
    #[must_use]
    pub fn name_of(&self, index: u8) -> &str {
        self.names
            .get(usize::from(index))
            .map_or("unknown", AsRef::as_ref)
    }

    /// The numbers of all chassis of the app but this one.
    pub(crate) fn others(&self) -> impl Iterator<Item = u8> + '_ {
        (0..self.names.len())
            .filter_map(|index| u8::try_from(index).ok())
            .filter(|index| *index != self.index)
    }

    /// What the configuration says of processor `index`; nothing of the runtime's own, 0.
    pub(crate) fn processor_config(&self, index: usize) -> Option<&ProcessorConfig> {
        let chassis = usize::from(self.index).checked_sub(1)?;
        let processors = &self.app.chassis.get(chassis)?.processors;
        processors.get(index.checked_sub(1)?)
    }

    /// Processor `index`, to be run by the calling thread.
    pub(crate) fn processor(&self, index: usize) -> Option<Rc<Processor>> {
        let (name, handle) = self.processors.get(index)?;
        let mut settings = ScheduleSettings {
            processor: format!("{}/{name}", self.name()),
            ..ScheduleSettings::default()
        };
        if let Some(config) = self.processor_config(index) {
            settings.period = config.period;
            settings.overrun = config.overrun;
            settings.spin = config.spin;
        }
        let schedule = Schedule::new(settings, self.clock.clone());
        let schedule = schedule.shown_in(self.cyclics.clone());
        Some(Processor::with_schedule(
            handle.clone(),
            self.clock.clone(),
            schedule,
        ))
    }

    /// The synchronous functions that run here, by `task.function`, with what is known of each.
    #[must_use]
    pub fn cyclics(&self) -> Vec<(String, Arc<CyclicStatistics>)> {
        self.cyclics.functions()
    }

    /// The schedules of the processors here that have synchronous functions.
    #[must_use]
    pub fn schedules(&self) -> Vec<ScheduleView> {
        self.cyclics.schedules()
    }

    /// What the system granted to each configured processor; nothing in virtual time.
    #[must_use]
    pub fn realtime(&self) -> Vec<RealtimeGrant> {
        lock(&self.realtime).clone()
    }

    pub(crate) fn set_realtime(&self, grants: Vec<RealtimeGrant>) {
        *lock(&self.realtime) = grants;
    }

    /// The semaphores that are kept here, who holds them and who waits: those of the chassis and, on the
    /// one that boots, those of the app.
    #[must_use]
    pub fn semaphores(&self) -> Vec<SemaphoreView> {
        self.blocking.views()
    }

    /// Puts `value` where the other tasks of this chassis find it.
    pub fn share<T: Send + Sync + 'static>(&self, key: &str, value: Arc<T>) {
        self.tap.used(|| format!("shared memory `{key}`"));
        lock(&self.shared).insert(key.to_owned(), value);
    }

    /// What was shared under `key`, if it is a `T`.
    #[must_use]
    pub fn shared<T: Send + Sync + 'static>(&self, key: &str) -> Option<Arc<T>> {
        self.tap.used(|| format!("shared memory `{key}`"));
        lock(&self.shared).get(key)?.clone().downcast::<T>().ok()
    }

    pub(crate) fn add_task(&self, task: Arc<TaskRecord>) {
        self.tasks
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(task.tid, task);
    }

    /// Takes a task out; what is in its mailbox is answered.
    pub(crate) fn remove_task(self: &Arc<Self>, tid: Tid) {
        self.blocking.task_ended(self, tid);
        let entry = self
            .tasks
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .remove(&tid);
        if let Some(task) = entry {
            task.mailbox.close();
        }
    }

    pub(crate) fn task(&self, tid: Tid) -> Option<Arc<TaskRecord>> {
        self.tasks
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .get(&tid)
            .cloned()
    }

    /// The tasks of this chassis, by id.
    pub(crate) fn tasks(&self) -> Vec<Arc<TaskRecord>> {
        let tasks = self.tasks.read().unwrap_or_else(PoisonError::into_inner);
        tasks.values().cloned().collect()
    }

    /// A trace id that no other message of the run has.
    pub(crate) fn fresh_trace(&self) -> u64 {
        // The high byte keeps the chassis apart; 2^56 messages of one chassis do not come about.
        (u64::from(self.index) << 56) | self.next_trace.fetch_add(1, Ordering::Relaxed)
    }

    /// Sends; the returned future ends with what `wait` names, or with a fault.
    pub(crate) fn dispatch(self: &Arc<Self>, mut envelope: Envelope, wait: WaitFor) -> Waiting {
        if envelope.trace == 0 {
            envelope.trace = self.fresh_trace();
        }
        // A fence goes to the old place itself.
        if envelope.command != system::Fence::CODE {
            envelope.to = self.directory.current(envelope.to);
        }
        if let Some(replay) = self.tap.replay() {
            return replay.dispatch(&envelope, wait, self.clock.now());
        }
        let recorded = self.tap.sent(&envelope, Some(wait));
        let promise = Arc::new(Promise::default());
        let waiting = if envelope.to.chassis() == self.index {
            self.dispatch_here(envelope, wait, recorded, &promise);
            Waiting::here(promise)
        } else {
            match self.dispatch_there(envelope, wait, &promise) {
                Ok(outbound) => Waiting::there(promise, outbound),
                Err(fault) => {
                    promise.fulfil(Err(fault));
                    Waiting::here(promise)
                }
            }
        };
        waiting.recorded_as(recorded)
    }

    fn dispatch_here(
        &self,
        envelope: Envelope,
        wait: WaitFor,
        recorded: u64,
        promise: &Arc<Promise>,
    ) {
        let Some(task) = self.task(envelope.to) else {
            return promise.fulfil(Err(Fault::UnknownTask));
        };
        let (flag, reply, acceptance) = match wait {
            WaitFor::Reply => (
                Flags::REPLY_WAIT,
                Some(ReplySlot::local(promise.clone())),
                Acceptance::Silent,
            ),
            WaitFor::Acceptance => (Flags::ACCEPT_WAIT, None, Acceptance::Local(promise.clone())),
        };
        let message = Message {
            header: envelope.header(flag, 0),
            trace: envelope.trace,
            deadline: envelope.deadline,
            recorded,
            data: envelope.data,
            reply,
        };
        task.mailbox.put(message, acceptance);
    }

    fn dispatch_there(
        self: &Arc<Self>,
        mut envelope: Envelope,
        wait: WaitFor,
        promise: &Arc<Promise>,
    ) -> Result<Outbound, Fault> {
        let flag = match wait {
            WaitFor::Reply => Flags::REPLY_WAIT,
            WaitFor::Acceptance => Flags::ACCEPT_WAIT,
        };
        let data = std::mem::replace(&mut envelope.data, Data::Bytes(Vec::new()));
        let body = body_of(data)?;
        let header = envelope.header(flag, body.len());
        let peer = envelope.to.chassis();
        let mut links = lock(&self.links);
        let Some(link) = links.up.get(&peer).cloned() else {
            return Err(self.peer_down_fault(peer));
        };
        links.next_call += 1;
        let call = links.next_call;
        links.pending.insert(
            call,
            Pending {
                promise: promise.clone(),
                peer,
            },
        );
        drop(links);
        let posted = link.post(Frame {
            header,
            call,
            trace: envelope.trace,
            left_ns: self.left_ns(envelope.deadline),
            body,
        });
        if let Err(Full { bytes }) = posted {
            lock(&self.links).pending.remove(&call);
            return Err(Fault::LinkFull { bytes });
        }
        Ok(Outbound {
            chassis: self.clone(),
            header,
            call,
            trace: envelope.trace,
        })
    }

    /// Sends only if the receiver is on this chassis and has room now.
    pub(crate) fn try_dispatch_here(&self, mut envelope: Envelope) -> Result<(), Fault> {
        envelope.to = self.directory.current(envelope.to);
        let there = envelope.to.chassis();
        if there != self.index {
            let chassis = self.name_of(there).to_owned();
            return Err(Fault::Elsewhere { chassis });
        }
        if envelope.trace == 0 {
            envelope.trace = self.fresh_trace();
        }
        if let Some(replay) = self.tap.replay() {
            return replay.try_dispatch(&envelope, self.clock.now());
        }
        let asked = Asked::of(&envelope);
        let recorded = self.tap.sent(&envelope, None);
        let put = self.task(envelope.to).ok_or(Fault::UnknownTask);
        let put = put.and_then(|task| {
            task.mailbox.try_put(Message {
                header: envelope.header(Flags::NONE, 0),
                trace: envelope.trace,
                deadline: None,
                recorded,
                data: envelope.data,
                reply: None,
            })
        });
        if let Err(fault) = &put {
            self.tap.answered(recorded, &asked, &Err(fault.clone()));
        }
        put
    }

    /// How long it is until `deadline`, for the wire.
    fn left_ns(&self, deadline: Option<Instant>) -> u64 {
        deadline.map_or(NO_DEADLINE, |deadline| {
            let left = deadline.since(self.clock.now()).as_nanos();
            u64::try_from(left).map_or(NO_DEADLINE - 1, |left| left.min(NO_DEADLINE - 1))
        })
    }

    /// Sends a message of the runtime without waiting for anything. It is lost only with its
    /// receiver.
    pub(crate) fn post_system<C: Command>(self: &Arc<Self>, to: Tid, request: C) {
        let envelope = Envelope {
            to,
            from: system::agent_tid(self.index),
            command: C::CODE,
            flags: Flags::HIGH_PRIORITY,
            data: Data::of(request),
            trace: 0,
            deadline: None,
        };
        self.dispatch(envelope, WaitFor::Acceptance).forget();
    }

    /// Sends an answer back over the link that the request came by, if anybody waits for it.
    pub(crate) fn post_reply(&self, inbound: &Inbound, answer: Answer) {
        let Inbound {
            header: request,
            call,
            trace,
            ..
        } = inbound;
        let peer = request.from.chassis();
        let link = {
            let mut links = lock(&self.links);
            if links.inbound.remove(&(peer, *call)).is_none() {
                return;
            }
            links.up.get(&peer).cloned()
        };
        let Some(link) = link else {
            return;
        };
        self.tap
            .replied(inbound.recorded, request, *trace, answer.as_ref());
        let (flags, body) = match answer.and_then(body_of) {
            Ok(body) => (Flags::REPLY, body),
            Err(fault) => (
                Flags::REPLY.with(Flags::FAULT),
                // A fault is plain data; should it fail to encode, the empty body is read as one.
                postcard::to_stdvec(&fault).unwrap_or_default(),
            ),
        };
        // What is not a request is never refused.
        let _ = link.post(Frame {
            header: Header {
                to: request.from,
                from: request.to,
                command: request.command,
                flags,
                size: u32::try_from(body.len()).unwrap_or(u32::MAX),
            },
            call: *call,
            trace: *trace,
            left_ns: NO_DEADLINE,
            body,
        });
    }

    /// Takes a frame that came from chassis `peer`.
    pub(crate) fn receive(self: &Arc<Self>, peer: u8, frame: Frame) {
        let Frame {
            header,
            call,
            trace,
            left_ns,
            body,
        } = frame;
        if header.flags.contains(Flags::REPLY) {
            return self.receive_reply(peer, call, header.flags, body);
        }
        if header.from.chassis() != peer || header.to.chassis() != self.index {
            tracing::error!(
                peer = self.name_of(peer),
                from = %header.from,
                to = %header.to,
                "a frame on the wrong link"
            );
            return;
        }
        if header.flags.contains(Flags::ABANDONED) {
            let abandoned = lock(&self.links).inbound.remove(&(peer, call));
            if let Some(abandoned) = abandoned {
                abandoned.store(true, Ordering::Release);
            }
            return;
        }
        let deadline =
            (left_ns != NO_DEADLINE).then(|| self.clock.now() + Duration::from_nanos(left_ns));
        let recorded = self.tap.arrived(&header, trace, deadline, &body);
        let request = Inbound {
            header,
            call,
            trace,
            recorded,
            abandoned: Arc::default(),
        };
        lock(&self.links)
            .inbound
            .insert((peer, call), request.abandoned.clone());
        let Some(task) = self.task(header.to) else {
            return self.post_reply(&request, Err(Fault::UnknownTask));
        };
        // Every request between chassis waits for one or the other, so that none is lost unseen.
        let (reply, acceptance) = if header.flags.contains(Flags::REPLY_WAIT) {
            let slot = ReplySlot::remote(self.clone(), request);
            (Some(slot), Acceptance::Silent)
        } else {
            let chassis = self.clone();
            (None, Acceptance::Remote { chassis, request })
        };
        let message = Message {
            header,
            trace,
            deadline,
            recorded,
            data: Data::Bytes(body),
            reply,
        };
        task.mailbox.put(message, acceptance);
    }

    fn receive_reply(&self, peer: u8, call: u64, flags: Flags, body: Vec<u8>) {
        let pending = {
            let mut links = lock(&self.links);
            // A reply counts only when it comes from the chassis that was asked.
            match links.pending.get(&call) {
                Some(pending) if pending.peer == peer => links.pending.remove(&call),
                _ => None,
            }
        };
        let Some(pending) = pending else {
            return;
        };
        pending.promise.fulfil(if flags.contains(Flags::FAULT) {
            Err(postcard::from_bytes(&body).unwrap_or(Fault::NoReply))
        } else {
            Ok(Data::Bytes(body))
        });
    }

    /// Connects chassis `peer`.
    pub(crate) fn link_up(&self, peer: u8, link: Arc<dyn Link>) {
        lock(&self.links).up.insert(peer, link);
    }

    /// The app is being taken down.
    pub(crate) fn set_stopping(&self) {
        self.stopping.store(true, Ordering::Release);
    }

    /// Whether the app is being taken down.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    /// Gives up all links without telling anybody, so that their writers end.
    pub(crate) fn drop_links(&self) {
        lock(&self.links).up.clear();
    }

    /// Whether chassis `peer` is connected.
    pub(crate) fn is_linked(&self, peer: u8) -> bool {
        lock(&self.links).up.contains_key(&peer)
    }

    /// What went over its links so far, by the name of the chassis at the other end.
    #[must_use]
    pub fn link_counts(&self) -> Vec<(String, Counts)> {
        let up: Vec<_> = {
            let links = lock(&self.links);
            let up = links.up.iter();
            up.map(|(peer, link)| (*peer, link.clone())).collect()
        };
        up.into_iter()
            .map(|(peer, link)| (self.name_of(peer).to_owned(), link.counts()))
            .collect()
    }

    /// Chassis `peer` is gone: every call that waits for it ends, what it asked and nobody has begun is
    /// dropped, and every task here is told.
    pub(crate) fn link_down(self: &Arc<Self>, peer: u8) {
        let ended: Vec<Arc<Promise>> = {
            let mut links = lock(&self.links);
            if links.up.remove(&peer).is_none() {
                return;
            }
            links.inbound.retain(|(from, _), abandoned| {
                if *from == peer {
                    abandoned.store(true, Ordering::Release);
                }
                *from != peer
            });
            let of_peer: Vec<u64> = links
                .pending
                .iter()
                .filter(|(_, pending)| pending.peer == peer)
                .map(|(call, _)| *call)
                .collect();
            of_peer
                .into_iter()
                .filter_map(|call| links.pending.remove(&call))
                .map(|pending| pending.promise)
                .collect()
        };
        for promise in ended {
            promise.fulfil(Err(self.peer_down_fault(peer)));
        }
        self.directory.forget_chassis(peer);
        if self.stopping.load(Ordering::Acquire) && peer != 0 {
            return;
        }
        let chassis = self.name_of(peer).to_owned();
        tracing::debug!(chassis = %chassis, "link down");
        for task in self.tasks() {
            self.post_system(
                task.tid,
                system::ChassisDown {
                    chassis: chassis.clone(),
                },
            );
        }
    }

    fn peer_down_fault(&self, peer: u8) -> Fault {
        Fault::PeerDown {
            chassis: self.name_of(peer).to_owned(),
        }
    }

    /// Whom to show each message that a task begins to handle. The first one counts.
    pub(crate) fn on_delivery(&self, on_delivery: OnDelivery) {
        let _ = self.on_delivery.set(on_delivery);
    }

    /// `task` begins to handle `message`.
    pub(crate) fn delivered(&self, task: &TaskRecord, message: &Message) {
        if let Some(on_delivery) = self.on_delivery.get() {
            on_delivery(task, message);
        }
    }

    /// The name of one of its tasks.
    pub(crate) fn task_name(&self, tid: Tid) -> Option<Arc<str>> {
        self.task(tid).map(|task| task.name.clone())
    }

    /// What to do when the chassis shall end.
    pub(crate) fn set_on_exit(&self, on_exit: impl FnOnce(i32) + Send + 'static) {
        *lock(&self.on_exit) = Some(Box::new(on_exit));
    }

    /// Ends the chassis with an exit code. The first call counts.
    pub(crate) fn exit(&self, code: i32) {
        let on_exit = lock(&self.on_exit).take();
        if let Some(on_exit) = on_exit {
            on_exit(code);
        }
    }

    /// Forgets all tasks and links. What waits in the queues is answered; what waits for others is told
    /// that they are gone. Without it a chassis that ends inside a process that goes on would keep
    /// itself alive through its messages.
    pub(crate) fn close(&self) {
        let tasks =
            std::mem::take(&mut *self.tasks.write().unwrap_or_else(PoisonError::into_inner));
        for task in tasks.values() {
            task.mailbox.close();
        }
        let links = std::mem::take(&mut *lock(&self.links));
        for pending in links.pending.into_values() {
            let fault = self.peer_down_fault(pending.peer);
            pending.promise.fulfil(Err(fault));
        }
        lock(&self.shared).clear();
        self.blocking.close();
    }

    /// Stops the threads of its processors.
    pub(crate) fn stop_processors(&self) {
        for (_, handle) in &self.processors {
            handle.stop();
        }
    }
}

/// The data of a frame.
fn body_of(data: Data) -> Result<Vec<u8>, Fault> {
    let body = data.into_bytes().map_err(|error| Fault::BadPayload {
        text: error.to_string(),
    })?;
    if body.len() > BODY_LIMIT {
        let text = format!(
            "{} bytes of data; a message between chassis holds at most {BODY_LIMIT}",
            body.len()
        );
        return Err(Fault::BadPayload { text });
    }
    Ok(body)
}

impl std::fmt::Debug for Chassis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Chassis({} `{}`)", self.index, self.name())
    }
}
