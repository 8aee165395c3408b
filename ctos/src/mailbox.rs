//! A task's bounded queue: a high-priority lane and a normal one, and senders that wait for room.
//!
//! First in, first out per lane, so also per pair of sender and receiver. Each lane has its own room
//! and its own line of waiting senders: a flood of normal messages cannot keep an urgent one out.
//! Messages of the runtime itself (phases, stop, a dead chassis) travel in the high-priority lane and
//! are never refused.
//!
//! The queue itself ([`TaskQueue`]) belongs to the task's processor and needs no lock. What everybody
//! else sees of it is the [`Mailbox`]: how much room there is, and the processor to bring messages to.
//! A sender on another thread claims its place before it brings the message; senders of several
//! threads at the same moment may together claim a few places more than there are, never fewer.

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeSet, VecDeque},
    future::poll_fn,
    rc::Rc,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    task::Poll,
};

use crate::{
    call::{Fault, ReplySlot, lock},
    message::{Command, Data, Flags, Message, SYSTEM_COMMANDS},
    processor::{FutureId, Processor, ProcessorHandle},
    room::{Room, most_waiting},
    survey::QueueReport,
    system::{Broke, StopTask, interrupts},
};

/// Whom to tell that a one-way message has been taken.
pub(crate) enum Acceptance {
    /// Nobody: the sender waits for the reply instead, or for nothing.
    Silent,
    /// Who waits for it.
    Told(ReplySlot),
}

impl Acceptance {
    pub(crate) fn tell(self, result: Result<(), Fault>) {
        if let Self::Told(slot) = self {
            slot.answer(result.map(|()| Data::Bytes(Vec::new())));
        }
    }

    /// Whether the sender has been told already that its message was not taken.
    pub(crate) fn is_abandoned(&self) -> bool {
        match self {
            Self::Silent => false,
            Self::Told(slot) => slot.is_abandoned(),
        }
    }
}

/// What became of a message that does not wait for room.
pub(crate) enum Offered {
    /// It is in the queue.
    Taken,
    /// There is no room now.
    NoRoom(Message),
    /// The task takes nothing more.
    Closed(Message),
}

/// A message from another thread.
pub(crate) struct Delivery {
    message: Message,
    place: Place,
}

/// Where a message from another thread goes.
enum Place {
    /// To the place in the queue that its sender claimed.
    Claimed,
    /// To the queue, whether there is room or not.
    Always,
    /// To the queue, or to the line of those who wait for room there.
    Waits(Acceptance),
}

impl Delivery {
    /// Tells the sender that the task takes nothing more.
    pub(crate) fn refuse(self) {
        let acceptance = match self.place {
            Place::Waits(acceptance) => acceptance,
            Place::Claimed | Place::Always => Acceptance::Silent,
        };
        refuse(self.message, acceptance, &Fault::Stopping);
    }
}

/// The queue of one task, for everybody.
pub(crate) struct Mailbox {
    capacity: usize,
    home: Arc<ProcessorHandle>,
    slot: u16,
    closed: AtomicBool,
    urgent: Room,
    normal: Room,
    /// The gates that the queue begins with; taken by it.
    gates: Mutex<BTreeSet<u8>>,
}

/// Whether a message goes to the high-priority lane, and whether it is one of the runtime's.
fn is_urgent(message: &Message) -> (bool, bool) {
    let system = message.header.command >= SYSTEM_COMMANDS;
    let flagged = message.header.flags.contains(Flags::HIGH_PRIORITY);
    (system || flagged, system)
}

impl Mailbox {
    /// The queue of the task in `slot` of the processor `home`, with room for `capacity` messages of
    /// each priority.
    pub(crate) fn new(capacity: usize, home: Arc<ProcessorHandle>, slot: u16) -> Arc<Self> {
        Arc::new(Self {
            capacity: capacity.max(1),
            home,
            slot,
            closed: AtomicBool::new(false),
            urgent: Room::default(),
            normal: Room::default(),
            gates: Mutex::default(),
        })
    }

    /// Whether the task takes nothing more.
    #[inline]
    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    #[inline]
    fn room(&self, urgent: bool) -> &Room {
        if urgent { &self.urgent } else { &self.normal }
    }

    /// How much is in it, as senders on other threads see it.
    pub(crate) fn lengths(&self) -> QueueReport {
        let length = |room: &Room| room.len().saturating_sub(room.waiting()) as u64;
        QueueReport {
            urgent: length(&self.urgent),
            normal: length(&self.normal),
            waiting: (self.urgent.waiting() + self.normal.waiting()) as u64,
            capacity: self.capacity as u64,
        }
    }

    /// How many messages are in it, on their way to it or wait for room, and how many of each priority
    /// it holds.
    pub(crate) fn depth(&self) -> (usize, usize) {
        (self.urgent.len() + self.normal.len(), self.capacity)
    }

    /// Why a message finds no place.
    pub(crate) fn full(&self) -> Fault {
        Fault::Full {
            capacity: self.capacity,
        }
    }

    /// Puts a message in if there is room now.
    pub(crate) fn offer(&self, message: Message) -> Offered {
        match Processor::here_if(&self.home) {
            Some(processor) => match processor.queue(self.slot) {
                Some(queue) => queue.offer(&processor, message),
                None => Offered::Closed(message),
            },
            None => self.offer_from_afar(message),
        }
    }

    /// [`Self::offer`] from another thread than the task's.
    pub(crate) fn offer_from_afar(&self, message: Message) -> Offered {
        if self.is_closed() {
            return Offered::Closed(message);
        }
        let (urgent, system) = is_urgent(&message);
        let place = if system {
            Place::Always
        } else if self.room(urgent).claim(self.capacity) {
            Place::Claimed
        } else {
            return Offered::NoRoom(message);
        };
        match self
            .home
            .bring_message(self.slot, Delivery { message, place })
        {
            Ok(()) => Offered::Taken,
            Err(delivery) => Offered::Closed(delivery.message),
        }
    }

    /// Puts a message in or lets it wait for room; `acceptance` is told when it is in, or why not. A
    /// refused message that waits for a reply is answered with the reason.
    pub(crate) fn put(&self, message: Message, acceptance: Acceptance) {
        match self.offer(message) {
            Offered::Taken => acceptance.tell(Ok(())),
            Offered::NoRoom(message) => self.line_up(message, acceptance),
            Offered::Closed(message) => refuse(message, acceptance, &Fault::Stopping),
        }
    }

    /// Lets a message for which there was no room wait for some.
    pub(crate) fn line_up(&self, message: Message, acceptance: Acceptance) {
        let (urgent, _) = is_urgent(&message);
        if !self.room(urgent).line_up(self.capacity) {
            return refuse(message, acceptance, &self.full());
        }
        let delivery = Delivery {
            message,
            place: Place::Waits(acceptance),
        };
        let local = Processor::here_if(&self.home);
        match local.and_then(|here| here.queue(self.slot).map(|queue| (here, queue))) {
            Some((processor, queue)) => queue.take_in(&processor, delivery),
            None => {
                if let Err(delivery) = self.home.bring_message(self.slot, delivery) {
                    delivery.refuse();
                }
            }
        }
    }

    fn shut(&self, shut: bool) {
        self.urgent.shut(shut);
        self.normal.shut(shut);
    }

    /// Keeps what comes straight from `chassis` until their gates are opened. For a queue that is about to
    /// be made.
    pub(crate) fn close_gates(&self, chassis: BTreeSet<u8>) {
        self.shut(true);
        *lock(&self.gates) = chassis;
    }

    /// Lets in what came straight from `chassis`, in its order, and whatever comes from there later.
    pub(crate) fn open_gate(&self, chassis: u8) {
        self.order(Order::OpenGate(chassis));
    }

    /// Drops what came straight from `chassis`, which is gone: nobody was told that it was taken.
    pub(crate) fn forget_gate(&self, chassis: u8) {
        self.order(Order::ForgetGate(chassis));
    }

    /// Brings an order to the queue, behind the messages that were brought before it.
    fn order(&self, order: Order) {
        match Processor::here_if(&self.home) {
            Some(processor) => {
                if let Some(queue) = processor.queue(self.slot) {
                    queue.obey(&processor, order);
                }
            }
            None => self.home.bring_order(self.slot, order),
        }
    }

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        match Processor::here_if(&self.home) {
            Some(processor) => processor.close_queue(self.slot),
            None => self.home.bring_close(self.slot),
        }
    }
}

#[derive(Default)]
struct Lane {
    queue: VecDeque<Message>,
    /// Never holds anybody while the queue has room.
    waiting: VecDeque<(Message, Acceptance)>,
    /// Messages in the queue that still count as being on their way.
    arrived: usize,
}

/// Who is told when a message has been taken.
struct Admitted {
    /// Has its message in the queue now.
    admitted: Acceptance,
    /// Gave up before there was room.
    given_up: Vec<(Message, Acceptance)>,
}

impl Lane {
    /// Moves the first sender that still waits into the room of a message that was taken.
    fn admit(&mut self, capacity: usize, room: &Room) -> Admitted {
        let mut result = Admitted {
            admitted: Acceptance::Silent,
            given_up: Vec::new(),
        };
        while self.queue.len() < capacity {
            let Some((message, acceptance)) = self.waiting.pop_front() else {
                break;
            };
            room.leave_line();
            if acceptance.is_abandoned() {
                result.given_up.push((message, acceptance));
                continue;
            }
            self.queue.push_back(message);
            result.admitted = acceptance;
            break;
        }
        result
    }

    #[inline]
    fn push(&mut self, message: Message, room: &Room) {
        self.queue.push_back(message);
        room.set_held(self.queue.len() - self.arrived);
    }

    /// Counts what has arrived as being in the queue.
    fn tell_arrived(&mut self, room: &Room) {
        if self.arrived > 0 {
            // In this order, so that nothing is missed by who claims a place meanwhile.
            room.set_held(self.queue.len());
            room.arrived(std::mem::take(&mut self.arrived));
        }
    }
}

/// What the task's loop wants to be woken for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum WaitsFor {
    /// Nothing: it runs, or has not begun.
    Nothing,
    /// The next message.
    Message,
    /// A message that interrupts its handler, which is at work.
    Interruption,
}

/// What a queue is told from elsewhere.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Order {
    /// See [`Mailbox::open_gate`].
    OpenGate(u8),
    /// See [`Mailbox::forget_gate`].
    ForgetGate(u8),
}

/// Messages that came straight to a task's new place before everything that their chassis had sent to
/// the old one.
struct Gate {
    closed: BTreeSet<u8>,
    held: Vec<(Message, Acceptance)>,
}

impl Gate {
    fn keeps(&self, message: &Message) -> bool {
        let header = message.header();
        header.command < SYSTEM_COMMANDS
            && !header.flags.contains(Flags::FORWARDED)
            && self.closed.contains(&header.from.chassis())
    }

    /// Takes out what came from `chassis`, whose gate is open now.
    fn take_out(&mut self, chassis: u8) -> Vec<(Message, Acceptance)> {
        self.closed.remove(&chassis);
        let of_chassis =
            |(message, _): &(Message, Acceptance)| message.header.from.chassis() == chassis;
        let (out, held) = std::mem::take(&mut self.held)
            .into_iter()
            .partition(of_chassis);
        self.held = held;
        out
    }
}

#[derive(Default)]
struct Lanes {
    urgent: Lane,
    normal: Lane,
    /// Nothing more is taken into the queues: the task is about to leave, or has left.
    held: bool,
    gate: Option<Gate>,
}

impl Lanes {
    fn lane(&mut self, urgent: bool) -> &mut Lane {
        if urgent {
            &mut self.urgent
        } else {
            &mut self.normal
        }
    }
}

/// The queue of one task, on its processor.
pub(crate) struct TaskQueue {
    lanes: RefCell<Lanes>,
    mailbox: Arc<Mailbox>,
    /// The future that is the task's loop.
    runner: Cell<Option<FutureId>>,
    waits_for: Cell<WaitsFor>,
    /// Messages in the queue that interrupt a handler at work.
    interruptions: Cell<usize>,
}

impl TaskQueue {
    /// The queue behind `mailbox`.
    pub(crate) fn new(mailbox: Arc<Mailbox>) -> Rc<Self> {
        let closed = std::mem::take(&mut *lock(&mailbox.gates));
        let gate = (!closed.is_empty()).then(|| Gate {
            closed,
            held: Vec::new(),
        });
        Rc::new(Self {
            lanes: RefCell::new(Lanes {
                gate,
                ..Lanes::default()
            }),
            mailbox,
            runner: Cell::new(None),
            waits_for: Cell::new(WaitsFor::Nothing),
            interruptions: Cell::new(0),
        })
    }

    /// Names the future that takes the messages: it is woken when there are some.
    pub(crate) fn set_runner(&self, runner: FutureId) {
        self.runner.set(Some(runner));
    }

    /// Puts a message in if there is room now.
    #[inline]
    pub(crate) fn offer(&self, processor: &Processor, message: Message) -> Offered {
        if self.mailbox.is_closed() {
            return Offered::Closed(message);
        }
        let (urgent, system) = is_urgent(&message);
        let room = self.mailbox.room(urgent);
        let command = message.header.command;
        {
            let mut lanes = self.lanes.borrow_mut();
            let gated = lanes.gate.as_ref().is_some_and(|gate| gate.keeps(&message));
            let kept = gated || (lanes.held && !system);
            let lane = lanes.lane(urgent);
            if kept || (!system && lane.queue.len() >= self.mailbox.capacity) {
                return Offered::NoRoom(message);
            }
            lane.push(message, room);
        }
        self.has_come(processor, command);
        Offered::Taken
    }

    /// Takes in a message from another thread, or one that waits for room.
    pub(crate) fn take_in(&self, processor: &Processor, delivery: Delivery) {
        let Delivery { message, place } = delivery;
        let (urgent, _) = is_urgent(&message);
        let room = self.mailbox.room(urgent);
        let command = message.header.command;
        let mut lanes = self.lanes.borrow_mut();
        let Lanes { held, gate, .. } = &mut *lanes;
        let held = *held;
        if let Some(gate) = gate.as_mut().filter(|gate| gate.keeps(&message)) {
            let acceptance = match place {
                Place::Claimed => {
                    room.arrived(1);
                    Acceptance::Silent
                }
                Place::Always => Acceptance::Silent,
                Place::Waits(acceptance) => {
                    room.leave_line();
                    acceptance
                }
            };
            if gate.held.len() < most_waiting(self.mailbox.capacity) {
                return gate.held.push((message, acceptance));
            }
            drop(lanes);
            return refuse(message, acceptance, &self.mailbox.full());
        }
        let lane = lanes.lane(urgent);
        match place {
            Place::Waits(acceptance) if held || lane.queue.len() >= self.mailbox.capacity => {
                lane.waiting.push_back((message, acceptance));
                drop(lanes);
                if held {
                    self.wake_idle(processor);
                }
            }
            Place::Waits(acceptance) => {
                // Out of the line before it is in the queue, and no claim comes between.
                lane.push(message, room);
                drop(lanes);
                room.leave_line();
                acceptance.tell(Ok(()));
                self.has_come(processor, command);
            }
            Place::Always => {
                lane.push(message, room);
                drop(lanes);
                self.has_come(processor, command);
            }
            Place::Claimed => {
                lane.queue.push_back(message);
                lane.arrived += 1;
                drop(lanes);
                self.has_come(processor, command);
            }
        }
    }

    /// All messages of one batch have been taken in.
    pub(crate) fn end_batch(&self) {
        let mut lanes = self.lanes.borrow_mut();
        for urgent in [true, false] {
            lanes
                .lane(urgent)
                .tell_arrived(self.mailbox.room(urgent));
        }
    }

    /// Something is there that the loop of the task looks for, though not in the queue.
    fn wake_idle(&self, processor: &Processor) {
        if self.waits_for.get() == WaitsFor::Message
            && let Some(runner) = self.runner.get()
        {
            self.waits_for.set(WaitsFor::Nothing);
            processor.wake(runner);
        }
    }

    /// A message of `command` is in the queue now: wakes whom it concerns.
    #[inline]
    fn has_come(&self, processor: &Processor, command: u16) {
        let interruption = interrupts(command);
        if interruption {
            self.interruptions.set(self.interruptions.get() + 1);
        }
        let wakes = match self.waits_for.get() {
            WaitsFor::Nothing => false,
            WaitsFor::Message => true,
            WaitsFor::Interruption => interruption,
        };
        if wakes && let Some(runner) = self.runner.get() {
            self.waits_for.set(WaitsFor::Nothing);
            processor.wake(runner);
        }
    }

    /// The next message, high priority first.
    #[inline(always)]
    pub(crate) fn take(&self) -> Option<Message> {
        let mut lanes = self.lanes.borrow_mut();
        let urgent = !lanes.urgent.queue.is_empty();
        let room = self.mailbox.room(urgent);
        let lane = lanes.lane(urgent);
        let message = lane.queue.pop_front()?;
        let admitted = (!lane.waiting.is_empty()).then(|| lane.admit(self.mailbox.capacity, room));
        room.took(lane.queue.len().saturating_sub(lane.arrived), self.mailbox.capacity);
        drop(lanes);
        if interrupts(message.header.command) {
            self.interruptions
                .set(self.interruptions.get().saturating_sub(1));
        }
        if let Some(Admitted { admitted, given_up }) = admitted {
            // Outside the borrow: what is dropped and told here may run code of others.
            drop(given_up);
            admitted.tell(Ok(()));
        }
        Some(message)
    }

    /// Puts the next message, high priority first, into `next`; none once the queue is closed. For the loop
    /// of the task, which is woken when there is one, and polled by nobody else.
    #[inline(always)]
    pub(crate) fn poll_next(&self, next: &mut Option<Message>) -> Poll<()> {
        if self.mailbox.is_closed() {
            return Poll::Ready(());
        }
        *next = self.take();
        if next.is_some() {
            return Poll::Ready(());
        }
        self.waits_for.set(WaitsFor::Message);
        Poll::Pending
    }

    /// The first message in the queue whose command is `wanted`, among those that interrupt a handler. If
    /// there is none, the task's loop is woken when there is one of those. `Err` when the queue is closed.
    #[inline]
    fn look_for(&self, wanted: fn(u16) -> bool) -> Result<Option<u16>, ()> {
        if self.mailbox.is_closed() {
            return Err(());
        }
        if self.interruptions.get() > 0 {
            let lanes = self.lanes.borrow();
            let mut commands = lanes.urgent.queue.iter().map(Message::command);
            if let Some(found) = commands.find(|command| wanted(*command)) {
                return Ok(Some(found));
            }
        }
        self.waits_for.set(WaitsFor::Interruption);
        Ok(None)
    }

    /// Whether the handler at work is to make way; then, whether that is because a part of it broke, and
    /// no order. If not, the task's loop is woken when it is.
    #[inline]
    pub(crate) fn interruption(&self) -> Option<bool> {
        match self.look_for(interrupts) {
            Ok(None) => None,
            Ok(Some(command)) => Some(command == Broke::CODE),
            Err(()) => Some(false),
        }
    }

    /// Ends when a [`StopTask`] waits in the queue. For the loop of the task, and awaited by nobody else.
    pub(crate) async fn stop_waits(&self) {
        poll_fn(
            |_| match self.look_for(|command| command == StopTask::CODE) {
                Ok(None) => Poll::Pending,
                Ok(Some(_)) | Err(()) => Poll::Ready(()),
            },
        )
        .await;
    }

    /// Drops the news that parts of the handler broke: it is gone altogether.
    pub(crate) fn forget_broken(&self) {
        let mut lanes = self.lanes.borrow_mut();
        let queue = std::mem::take(&mut lanes.urgent.queue);
        let is_news = |message: &Message| message.command() == Broke::CODE;
        let (news, kept): (VecDeque<_>, VecDeque<_>) = queue.into_iter().partition(is_news);
        lanes.urgent.queue = kept;
        self.recount(&lanes);
        drop(lanes);
        drop(news);
    }

    /// The lanes were changed otherwise than by putting in or taking out one message.
    fn recount(&self, lanes: &Lanes) {
        let interrupting = lanes.urgent.queue.iter().map(Message::command);
        let interrupting = interrupting.filter(|command| interrupts(*command));
        self.interruptions.set(interrupting.count());
        self.mailbox.urgent.set_held(lanes.urgent.queue.len());
        self.mailbox.normal.set_held(lanes.normal.queue.len());
    }

    /// From now on messages of tasks wait and are not taken; those of the runtime are.
    pub(crate) fn hold(&self) {
        self.mailbox.shut(true);
        self.lanes.borrow_mut().held = true;
    }

    /// Takes messages again: first `before`, which were taken out of the queue, then those that waited.
    pub(crate) fn release(&self, before: Vec<Message>) {
        let mut lanes = self.lanes.borrow_mut();
        lanes.held = false;
        for message in before.into_iter().rev() {
            let (urgent, _) = is_urgent(&message);
            lanes.lane(urgent).queue.push_front(message);
        }
        let mut admitted = Vec::new();
        let mut given_up = Vec::new();
        for urgent in [true, false] {
            let room = self.mailbox.room(urgent);
            let lane = lanes.lane(urgent);
            while lane.queue.len() < self.mailbox.capacity
                && let Some((message, acceptance)) = lane.waiting.pop_front()
            {
                room.leave_line();
                if acceptance.is_abandoned() {
                    given_up.push((message, acceptance));
                    continue;
                }
                lane.queue.push_back(message);
                admitted.push(acceptance);
            }
        }
        self.recount(&lanes);
        drop(lanes);
        self.mailbox.shut(false);
        drop(given_up);
        for acceptance in admitted {
            acceptance.tell(Ok(()));
        }
    }

    /// Takes out of the queue what tasks sent: the messages that have been accepted.
    pub(crate) fn take_accepted(&self) -> Vec<Message> {
        let mut lanes = self.lanes.borrow_mut();
        let of_runtime = |message: &Message| message.header.command >= SYSTEM_COMMANDS;
        let urgent = std::mem::take(&mut lanes.urgent.queue);
        let (kept, taken): (VecDeque<_>, VecDeque<_>) = urgent.into_iter().partition(of_runtime);
        lanes.urgent.queue = kept;
        let mut taken = Vec::from(taken);
        taken.extend(std::mem::take(&mut lanes.normal.queue));
        self.recount(&lanes);
        taken
    }

    /// Everything that came while the queue was held: `None` once the queue is closed. For the loop of the
    /// task, and awaited by nobody else.
    pub(crate) async fn next_held(&self) -> Option<Vec<(Message, Acceptance)>> {
        poll_fn(|_| {
            if self.mailbox.is_closed() {
                return Poll::Ready(None);
            }
            let mut lanes = self.lanes.borrow_mut();
            let mut all = Vec::new();
            for urgent in [true, false] {
                let room = self.mailbox.room(urgent);
                let lane = lanes.lane(urgent);
                let queued = lane.queue.drain(..);
                all.extend(queued.map(|message| (message, Acceptance::Silent)));
                for waiting in lane.waiting.drain(..) {
                    room.leave_line();
                    all.push(waiting);
                }
            }
            self.recount(&lanes);
            if all.is_empty() {
                self.waits_for.set(WaitsFor::Message);
                return Poll::Pending;
            }
            Poll::Ready(Some(all))
        })
        .await
    }

    /// Does what it is told from elsewhere.
    pub(crate) fn obey(&self, processor: &Processor, order: Order) {
        match order {
            Order::OpenGate(chassis) => self.open_gate(processor, chassis),
            Order::ForgetGate(chassis) => {
                let mut lanes = self.lanes.borrow_mut();
                let gone = lanes.gate.as_mut().map(|gate| gate.take_out(chassis));
                drop(lanes);
                drop(gone);
            }
        }
    }

    fn open_gate(&self, processor: &Processor, chassis: u8) {
        let mut lanes = self.lanes.borrow_mut();
        let Some(gate) = lanes.gate.as_mut() else {
            return;
        };
        let free = gate.take_out(chassis);
        let all_open = gate.closed.is_empty();
        if all_open {
            lanes.gate = None;
        }
        let mut admitted = Vec::new();
        let mut given_up = Vec::new();
        for (message, acceptance) in free {
            if acceptance.is_abandoned() {
                given_up.push((message, acceptance));
                continue;
            }
            let (urgent, _) = is_urgent(&message);
            let lane = lanes.lane(urgent);
            // Those beyond the room wait. They are bounded already: the gate holds no more than may wait.
            if lane.queue.len() < self.mailbox.capacity {
                lane.queue.push_back(message);
                admitted.push(acceptance);
            } else {
                self.mailbox.room(urgent).join_line();
                lane.waiting.push_back((message, acceptance));
            }
        }
        self.recount(&lanes);
        let held = lanes.held;
        drop(lanes);
        if all_open && !held {
            self.mailbox.shut(false);
        }
        drop(given_up);
        for acceptance in admitted {
            acceptance.tell(Ok(()));
        }
        self.wake_idle(processor);
    }

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(&self, processor: &Processor) {
        self.mailbox.closed.store(true, Ordering::Release);
        let Lanes {
            urgent,
            normal,
            gate,
            ..
        } = std::mem::take(&mut *self.lanes.borrow_mut());
        for (message, acceptance) in gate.into_iter().flat_map(|gate| gate.held) {
            refuse(message, acceptance, &Fault::Stopping);
        }
        for lane in [urgent, normal] {
            for message in lane.queue {
                refuse(message, Acceptance::Silent, &Fault::Stopping);
            }
            for (message, acceptance) in lane.waiting {
                refuse(message, acceptance, &Fault::Stopping);
            }
        }
        if let Some(runner) = self.runner.get() {
            processor.wake(runner);
        }
    }
}

fn refuse(message: Message, acceptance: Acceptance, fault: &Fault) {
    if let Some(slot) = message.reply {
        slot.answer(Err(fault.clone()));
    }
    acceptance.tell(Err(fault.clone()));
}

#[cfg(test)]
mod tests;
