//! The queue of one task, on its processor. It needs no lock.

use std::{
    cell::{Cell, RefCell, RefMut},
    collections::{BTreeSet, VecDeque},
    future::poll_fn,
    rc::Rc,
    sync::{Arc, atomic::Ordering},
    task::Poll,
};

use super::{Acceptance, Delivery, Offered, Place, gate::Gate, is_urgent, refuse};
use crate::{
    call::Fault,
    chassis::TaskRecord,
    message::{Command, Message, SYSTEM_COMMANDS},
    processor::{FutureId, Processor, Turn},
    room::{Room, most_waiting},
    runner::Resting,
    system::{Broke, StopTask, interrupts},
    watch::TaskMeter,
};

#[derive(Default)]
pub(super) struct Lane {
    pub(super) queue: VecDeque<Message>,
    /// Whoever comes while it holds anybody waits, too: nobody is overtaken. While the queue has room it holds
    /// somebody only as [`TaskQueue::lets_wait`] says.
    pub(super) waiting: VecDeque<(Message, Acceptance)>,
    /// Messages in the queue that still count as being on their way.
    arrived: usize,
}

/// Who is told when messages have been taken.
#[derive(Default)]
struct Admitted {
    /// Have their messages in the queue now.
    admitted: Vec<Acceptance>,
    /// Gave up before there was room.
    given_up: Vec<(Message, Acceptance)>,
}

impl Admitted {
    /// Where no cell is borrowed: what is dropped and told here may run code of others. To wake threads takes
    /// longer than many brief handlers, and is no turn of any task.
    fn tell(self) {
        if self.admitted.is_empty() && self.given_up.is_empty() {
            return;
        }
        let tell = || {
            drop(self.given_up);
            for acceptance in self.admitted {
                acceptance.tell(Ok(()));
            }
        };
        match Processor::here() {
            Some(here) => here.beside_turns(tell),
            None => tell(),
        }
    }
}

impl Lane {
    /// Moves the senders that still wait into the room of messages that were taken.
    fn admit(&mut self, capacity: usize, room: &Room, result: &mut Admitted) {
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
            result.admitted.push(acceptance);
        }
    }

    /// Whether a message that comes now has to wait.
    #[inline]
    pub(super) fn is_full(&self, capacity: usize) -> bool {
        self.queue.len() >= capacity || !self.waiting.is_empty()
    }

    #[inline]
    fn push(&mut self, message: Message, room: &Room) {
        self.queue.push_back(message);
        room.set_held(self.queue.len() - self.arrived);
    }

    /// Counts what has arrived as being in the queue.
    fn tell_arrived(&mut self, room: &Room) {
        if self.arrived > 0 {
            room.arrived(std::mem::take(&mut self.arrived), self.queue.len());
        }
    }
}

/// What the task's loop wants to be woken for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum WaitsFor {
    /// Nothing: it runs, or has not begun.
    Nothing,
    /// The next message.
    Message,
    /// A message that interrupts its handler, which is at work.
    Interruption,
}

#[derive(Default)]
pub(super) struct Lanes {
    pub(super) urgent: Lane,
    pub(super) normal: Lane,
    /// Nothing more is taken into the queues: the task is about to leave, or has left.
    pub(super) held: bool,
    pub(super) gate: Option<Box<Gate>>,
    /// Have waited for room, and are told at the end of the batch that their messages are in the queue: whoever goes
    /// on before the others have left the line finds that it must not overtake them, and waits again.
    told_later: Vec<Acceptance>,
}

impl Lanes {
    /// Whether there is nothing in them that is to be kept.
    fn are_unused(&self) -> bool {
        let in_lane = |lane: &Lane| lane.queue.len() + lane.waiting.len() + lane.arrived;
        let kept = in_lane(&self.urgent) + in_lane(&self.normal) + self.told_later.len();
        kept == 0 && !self.held && self.gate.is_none()
    }

    pub(super) fn lane(&mut self, urgent: bool) -> &mut Lane {
        if urgent {
            &mut self.urgent
        } else {
            &mut self.normal
        }
    }
}

/// The queue of one task, on its processor.
pub(crate) struct TaskQueue {
    /// Made for the first message: of very many tasks most may be idle.
    lanes: RefCell<Option<Box<Lanes>>>,
    /// Whether anything may be in them, or is kept by them: one word to look at in each call.
    in_use: Cell<bool>,
    /// The message that an idle task has its turn for at once, from before that until it takes it.
    handed: Cell<Option<Message>>,
    /// Whose it is.
    pub(super) task: Arc<TaskRecord>,
    /// The future that is the task's loop; none while the task rests.
    runner: Cell<Option<FutureId>>,
    /// What is left of the task while it rests. Here and not behind a pointer: a chassis may have very many tasks.
    resting: Cell<Option<Resting>>,
    pub(super) waits_for: Cell<WaitsFor>,
    /// Messages in the queue that interrupt a handler at work.
    pub(super) interruptions: Cell<u32>,
    /// Whether senders wait though there is room. To wake a sender costs as much as many brief handlers, so
    /// while handlers are brief they are let in together once a sixteenth of a long queue is free: those that
    /// are woken then find room for many messages, and not for one.
    lets_wait: Cell<bool>,
}

impl TaskQueue {
    /// The queue behind the mailbox of `task`, which keeps what comes straight from the chassis `closed` until their gates
    /// are opened.
    pub(crate) fn gated(task: Arc<TaskRecord>, closed: BTreeSet<u8>) -> Rc<Self> {
        let gate = Gate {
            closed,
            held: Vec::new(),
        };
        let queue = Self::open(task);
        queue.lanes().gate = Some(Box::new(gate));
        queue
    }

    /// The queue behind the mailbox of `task`, which takes in what comes.
    pub(crate) fn open(task: Arc<TaskRecord>) -> Rc<Self> {
        Rc::new(Self {
            lanes: RefCell::default(),
            in_use: Cell::new(false),
            handed: Cell::new(None),
            task,
            runner: Cell::new(None),
            resting: Cell::new(None),
            waits_for: Cell::new(WaitsFor::Nothing),
            interruptions: Cell::new(0),
            lets_wait: Cell::new(false),
        })
    }

    #[inline]
    pub(super) fn lanes(&self) -> RefMut<'_, Lanes> {
        self.in_use.set(true);
        RefMut::map(self.lanes.borrow_mut(), |lanes| {
            &mut **lanes.get_or_insert_default()
        })
    }

    /// Whose it is.
    pub(crate) fn task(&self) -> &Arc<TaskRecord> {
        &self.task
    }

    /// Names the future that takes the messages: it is woken when there are some.
    pub(crate) fn set_runner(&self, runner: FutureId) {
        self.runner.set(Some(runner));
    }

    /// There is no loop until something comes, which then begins one. For a queue without messages.
    pub(crate) fn rest(&self, resting: Resting) {
        let mut lanes = self.lanes.borrow_mut();
        // What waits at a gate, or came while the queue is held, stays.
        let unused = lanes.take_if(|lanes| lanes.are_unused());
        drop(lanes);
        drop(unused);
        self.runner.set(None);
        self.waits_for.set(WaitsFor::Message);
        self.resting.set(Some(resting));
    }

    /// Takes out what is left of a task that rests.
    pub(crate) fn take_resting(&self) -> Option<Resting> {
        self.resting.take()
    }

    /// Whether the task rests.
    #[cfg(test)]
    pub(crate) fn is_resting(&self) -> bool {
        let resting = self.resting.take();
        let rests = resting.is_some();
        self.resting.set(resting);
        rests
    }

    /// Begins the loop of the task, if that rests.
    #[cold]
    fn end_rest(self: &Rc<Self>) {
        if let Some(resting) = self.resting.take() {
            self.waits_for.set(WaitsFor::Nothing);
            // The future is ready from the beginning.
            let runner = resting.begin(self, None);
            self.runner.set(Some(runner));
        }
    }

    /// Puts a message in if there is room now.
    #[inline]
    pub(crate) fn offer(self: &Rc<Self>, processor: &Processor, message: Message) -> Offered {
        match self.put_in(message) {
            Ok(command) => {
                self.has_come(processor, command);
                Offered::Taken
            }
            Err(offered) => offered,
        }
    }

    /// [`Self::offer`] of a call: an idle task has its turn at once where that may be, and `meter`, its
    /// caller's, stands still meanwhile.
    #[inline]
    pub(crate) fn offer_call(
        self: &Rc<Self>,
        processor: &Processor,
        message: Message,
        meter: &TaskMeter,
    ) -> Offered {
        let left = match self.turn_at_once(processor) {
            Some(turn) => self.hand_over(processor, turn, message, meter),
            None => Some(message),
        };
        match left {
            None => Offered::Taken,
            Some(message) => self.offer(processor, message),
        }
    }

    /// The turn that the loop of the task may have at once, if it is idle.
    #[inline]
    pub(crate) fn turn_at_once(&self, processor: &Processor) -> Option<Turn> {
        let idle = self.waits_for.get() == WaitsFor::Message && !self.task.mailbox.is_closed();
        let runner = self.runner.get().filter(|_| idle && self.is_unused())?;
        processor.turn_at_once(runner)
    }

    /// Gives a message to the loop of the task, which has its turn at once. The message, when the loop had to end
    /// in it: the task is to have it in the usual way.
    #[inline]
    pub(crate) fn hand_over(
        &self,
        processor: &Processor,
        turn: Turn,
        message: Message,
        meter: &TaskMeter,
    ) -> Option<Message> {
        self.waits_for.set(WaitsFor::Nothing);
        self.handed.set(Some(message));
        processor.hand_over(turn, meter);
        self.handed.take()
    }

    /// Whether nothing is in it, and nothing would be kept from its task.
    #[inline]
    fn is_unused(&self) -> bool {
        !self.in_use.get() || self.is_unused_again()
    }

    #[inline(never)]
    fn is_unused_again(&self) -> bool {
        let lanes = self.lanes.borrow();
        let is_unused = lanes.as_deref().is_none_or(Lanes::are_unused);
        self.in_use.set(!is_unused);
        is_unused
    }

    /// Puts a message in if there is room now; its command.
    #[inline]
    fn put_in(&self, message: Message) -> Result<u16, Offered> {
        if self.task.mailbox.is_closed() {
            return Err(Offered::Closed(message));
        }
        let (urgent, system) = is_urgent(&message);
        let room = self.task.mailbox.room(urgent);
        let command = message.command();
        let mut lanes = self.lanes();
        let gated = lanes.gate.as_ref().is_some_and(|gate| gate.keeps(&message));
        let kept = gated || (lanes.held && !system);
        let lane = lanes.lane(urgent);
        if kept || (!system && lane.is_full(self.task.mailbox.capacity())) {
            return Err(Offered::NoRoom(message));
        }
        lane.push(message, room);
        Ok(command)
    }

    /// Takes in a message from another thread, or one that waits for room. [`Self::end_batch`] must follow.
    pub(crate) fn take_in(self: &Rc<Self>, processor: &Processor, delivery: Delivery) {
        if self.task.mailbox.is_closed() {
            return delivery.refuse();
        }
        let Delivery { message, place } = delivery;
        message.letter.glance();
        let (urgent, _) = is_urgent(&message);
        let room = self.task.mailbox.room(urgent);
        let command = message.command();
        let mut lanes = self.lanes();
        let Lanes { held, gate, .. } = &mut *lanes;
        let held = *held;
        if let Some(gate) = gate.as_mut().filter(|gate| gate.keeps(&message)) {
            let acceptance = match place {
                Place::Claimed => {
                    room.arrived_elsewhere();
                    Acceptance::Silent
                }
                Place::Always => Acceptance::Silent,
                Place::Waits(acceptance) => {
                    room.leave_line();
                    *acceptance
                }
            };
            if gate.held.len() < most_waiting(self.task.mailbox.capacity()) {
                return gate.held.push((message, acceptance));
            }
            drop(lanes);
            return refuse(message, acceptance, &self.task.mailbox.full());
        }
        let lane = lanes.lane(urgent);
        match place {
            Place::Waits(acceptance) if held || lane.is_full(self.task.mailbox.capacity()) => {
                lane.waiting.push_back((message, *acceptance));
                drop(lanes);
                if held {
                    self.wake_idle(processor);
                }
            }
            Place::Waits(acceptance) => {
                // Out of the line before it is in the queue, and no claim comes between.
                lane.push(message, room);
                room.leave_line();
                if let told @ Acceptance::Told(_) = *acceptance {
                    lanes.told_later.push(told);
                }
                drop(lanes);
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
        let mut lanes = self.lanes();
        for urgent in [true, false] {
            lanes
                .lane(urgent)
                .tell_arrived(self.task.mailbox.room(urgent));
        }
        let admitted = Admitted {
            admitted: std::mem::take(&mut lanes.told_later),
            given_up: Vec::new(),
        };
        drop(lanes);
        admitted.tell();
    }

    /// Something is there that the loop of the task looks for, though not in the queue.
    pub(super) fn wake_idle(self: &Rc<Self>, processor: &Processor) {
        if self.waits_for.get() == WaitsFor::Message
            && let Some(runner) = self.wakes()
        {
            processor.wake(runner);
        }
    }

    /// A message of `command` is in the queue now: wakes whom it concerns.
    #[inline]
    fn has_come(self: &Rc<Self>, processor: &Processor, command: u16) {
        if let Some(runner) = self.concerns(command) {
            processor.wake(runner);
        }
    }

    /// A message of `command` is in the queue now: the task's loop, if that waits for it. One that only
    /// begins for it is ready anyway.
    #[inline]
    fn concerns(self: &Rc<Self>, command: u16) -> Option<FutureId> {
        let interruption = interrupts(command);
        if interruption {
            self.interruptions.set(self.interruptions.get() + 1);
        }
        let wakes = match self.waits_for.get() {
            WaitsFor::Nothing => false,
            WaitsFor::Message => true,
            WaitsFor::Interruption => interruption,
        };
        if wakes { self.wakes() } else { None }
    }

    /// The task's loop, which does not wait any more. One that only begins now is ready anyway.
    #[inline]
    fn wakes(self: &Rc<Self>) -> Option<FutureId> {
        let runner = self.runner.get();
        match runner {
            Some(_) => self.waits_for.set(WaitsFor::Nothing),
            None => self.end_rest(),
        }
        runner
    }

    /// The next message, high priority first.
    #[inline(always)]
    pub(crate) fn take(&self) -> Option<Message> {
        if !self.in_use.get() {
            return None;
        }
        let mut all = self.lanes.borrow_mut();
        let lanes = all.as_deref_mut()?;
        let urgent = !lanes.urgent.queue.is_empty();
        let room = self.task.mailbox.room(urgent);
        let lane = lanes.lane(urgent);
        let message = lane.queue.pop_front()?;
        let others_wait = !lane.waiting.is_empty();
        if !others_wait {
            let left = lane.queue.len().saturating_sub(lane.arrived);
            room.took(left, self.task.mailbox.capacity());
        }
        drop(all);
        if interrupts(message.command()) {
            self.interruptions
                .set(self.interruptions.get().saturating_sub(1));
        }
        if others_wait || self.lets_wait.get() {
            self.took_from_full(message.command());
        }
        Some(message)
    }

    /// A message of `command` was taken out of a queue for which others wait, or did.
    #[cold]
    fn took_from_full(&self, command: u16) {
        let brief = || Processor::here().is_some_and(|here| here.turns_are_brief());
        let lets_wait = {
            let lanes = self.lanes();
            let Lanes { urgent, normal, .. } = &*lanes;
            let capacity = self.task.mailbox.capacity();
            let is_nearly_full = |lane: &Lane| {
                let free = capacity.saturating_sub(lane.queue.len());
                lane.waiting.is_empty() || free < capacity / 16
            };
            command < SYSTEM_COMMANDS && is_nearly_full(urgent) && is_nearly_full(normal) && brief()
        };
        self.lets_wait.set(lets_wait);
        if !lets_wait {
            self.admit();
        }
    }

    /// Lets those who wait have the room there is, and tells them.
    pub(super) fn admit(&self) {
        self.lets_wait.set(false);
        let mut admitted = Admitted::default();
        let mut lanes = self.lanes();
        let may = !lanes.held;
        for urgent in [true, false] {
            let room = self.task.mailbox.room(urgent);
            let lane = lanes.lane(urgent);
            if may {
                lane.admit(self.task.mailbox.capacity(), room, &mut admitted);
            }
            room.set_held(lane.queue.len().saturating_sub(lane.arrived));
        }
        drop(lanes);
        admitted.tell();
    }

    /// Puts the next message, high priority first, into `next`; none once the queue is closed. For the loop
    /// of the task, which is woken when there is one, and polled by nobody else.
    #[inline(always)]
    pub(crate) fn poll_next(&self, next: &mut Option<Message>) -> Poll<()> {
        // That the mailbox is open was seen when it was handed over.
        if let Some(handed) = self.handed.take() {
            *next = Some(handed);
            return Poll::Ready(());
        }
        if self.task.mailbox.is_closed() {
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
        if self.task.mailbox.is_closed() {
            return Err(());
        }
        if self.interruptions.get() > 0 {
            let lanes = self.lanes();
            let mut commands = lanes.urgent.queue.iter().map(Message::command);
            if let Some(found) = commands.find(|command| wanted(*command)) {
                return Ok(Some(found));
            }
        }
        if self.lets_wait.get() {
            // The handler may be at work for long.
            self.admit();
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

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(self: &Rc<Self>, processor: &Processor) {
        self.task.mailbox.closed.store(true, Ordering::Release);
        let lanes = self.lanes.take().map(|lanes| *lanes);
        let Lanes {
            urgent,
            normal,
            gate,
            told_later,
            ..
        } = lanes.unwrap_or_default();
        for acceptance in told_later {
            acceptance.tell(Ok(()));
        }
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
        match self.runner.get() {
            Some(runner) => processor.wake(runner),
            None => self.end_rest(),
        }
    }
}
