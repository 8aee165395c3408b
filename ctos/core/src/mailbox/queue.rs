//! The queue of one task, on its processor. It needs no lock.

use std::{
    cell::{Cell, RefCell, RefMut},
    collections::{BTreeSet, VecDeque},
    future::poll_fn,
    rc::Rc,
    sync::{Arc, atomic::Ordering},
    task::Poll,
};

use super::gate::Gate;
use crate::{
    credits::most_waiting,
    delivery::{Delivery, NotTaken, is_urgent},
    envelope::Message,
    processor::{Inlet, Processor, wake::FutureId},
    reply::ReplySlot,
    system::{Broke, StopTask, interrupts},
    task_record::TaskRecord,
};
use ctos_message::{ChassisNumber, Command, fault::Fault};

#[derive(Default)]
pub(super) struct Lane {
    pub(super) queue: VecDeque<Message>,
    /// While a message waits here, later ones wait, too: none is overtaken.
    pub(super) waiting: VecDeque<Message>,
    /// Credits of messages that were taken out, to be given back together: senders on other cores use the same
    /// memory. None while the queue is empty.
    owed: usize,
}

impl Lane {
    /// The credits of all messages that are or were in the queue, to be given back.
    pub(super) fn all_credits(&mut self) -> usize {
        self.queue.len() + std::mem::take(&mut self.owed)
    }
}

/// This part of the capacity is owed at most.
const OWED_PART: usize = 4;

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
}

impl Lanes {
    pub(super) fn lane(&mut self, urgent: bool) -> &mut Lane {
        if urgent {
            &mut self.urgent
        } else {
            &mut self.normal
        }
    }

    /// Whether a message came before its gate was opened.
    fn keeps(&self, message: &Message) -> bool {
        self.gate.as_ref().is_some_and(|gate| gate.keeps(message))
    }
}

/// The queue of one task, on its processor.
pub(crate) struct TaskQueue {
    lanes: RefCell<Lanes>,
    /// Whose it is.
    pub(super) task: Arc<TaskRecord>,
    /// The future that is the task's loop, once it has begun.
    runner: Cell<Option<FutureId>>,
    pub(super) waits_for: Cell<WaitsFor>,
    /// Messages in the queue that interrupt a handler at work.
    pub(super) interruptions: Cell<u32>,
}

impl TaskQueue {
    /// The queue behind the mailbox of `task`, which keeps what comes straight from the chassis `closed` until their gates
    /// are opened.
    pub(crate) fn gated(task: Arc<TaskRecord>, closed: BTreeSet<ChassisNumber>) -> Rc<Self> {
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
            task,
            runner: Cell::new(None),
            waits_for: Cell::new(WaitsFor::Nothing),
            interruptions: Cell::new(0),
        })
    }

    pub(super) fn lanes(&self) -> RefMut<'_, Lanes> {
        self.lanes.borrow_mut()
    }

    /// Names the future that takes the messages: it is woken when there are some.
    pub(crate) fn set_runner(&self, runner: FutureId) {
        self.runner.set(Some(runner));
    }

    /// Something is there that the loop of the task looks for, though not in the queue.
    pub(super) fn wake_idle(&self, processor: &Processor) {
        if self.waits_for.get() == WaitsFor::Message {
            self.wake(processor);
        }
    }

    /// A message of `command` is in the queue now: wakes whom it concerns.
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
        if wakes {
            self.wake(processor);
        }
    }

    fn wake(&self, processor: &Processor) {
        self.waits_for.set(WaitsFor::Nothing);
        if let Some(runner) = self.runner.get() {
            processor.wake(runner);
        }
    }

    /// Keeps a message until its gate is opened.
    fn keep(&self, mut lanes: RefMut<'_, Lanes>, message: Message) {
        let most = most_waiting(self.task.mailbox.capacity());
        match lanes.gate.as_mut().filter(|gate| gate.held.len() < most) {
            Some(gate) => gate.held.push(message),
            None => {
                drop(lanes);
                message.refuse(self.task.mailbox.full());
            }
        }
    }

    /// The next message, high priority first.
    pub(crate) fn take(&self) -> Option<Message> {
        let mut lanes = self.lanes();
        let urgent = !lanes.urgent.queue.is_empty();
        let lane = lanes.lane(urgent);
        let message = lane.queue.pop_front()?;
        let others_wait = !lane.waiting.is_empty();
        lane.owed += 1;
        let mailbox = &self.task.mailbox;
        let is_time = lane.queue.is_empty() || lane.owed * OWED_PART >= mailbox.capacity();
        if others_wait || is_time {
            mailbox.credits(urgent).give(std::mem::take(&mut lane.owed));
        }
        drop(lanes);
        if others_wait {
            self.admit();
        }
        if interrupts(message.command()) {
            self.interruptions
                .set(self.interruptions.get().saturating_sub(1));
        }
        Some(message)
    }

    /// Gives back the credits of messages that were taken out: whether there were any.
    fn give_owed(&self, urgent: bool) -> bool {
        let owed = std::mem::take(&mut self.lanes().lane(urgent).owed);
        self.task.mailbox.credits(urgent).give(owed);
        owed > 0
    }

    /// Gives the credits there are to those who wait, and tells them.
    pub(super) fn admit(&self) {
        // Dropped and told where no cell is borrowed: that may run code of others.
        let (mut given_up, mut admitted) = (Vec::new(), Vec::new());
        let mailbox = &self.task.mailbox;
        let mut lanes = self.lanes();
        if lanes.held {
            return;
        }
        for urgent in [true, false] {
            let credits = mailbox.credits(urgent);
            let lane = lanes.lane(urgent);
            while let Some(mut message) = lane.waiting.pop_front() {
                if message.is_abandoned() {
                    given_up.push(message);
                } else if credits.take_past_others(mailbox.capacity()) {
                    admitted.extend(message.take_acceptance());
                    lane.queue.push_back(message);
                } else {
                    lane.waiting.push_front(message);
                    break;
                }
                credits.leave_line();
            }
        }
        drop(lanes);
        drop(given_up);
        admitted.into_iter().for_each(ReplySlot::accept);
    }

    /// Puts the next message, high priority first, into `next`; none once the queue is closed. For the loop
    /// of the task, which is woken when there is one, and polled by nobody else.
    pub(crate) fn poll_next(&self, next: &mut Option<Message>) -> Poll<()> {
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
        self.waits_for.set(WaitsFor::Interruption);
        Ok(None)
    }

    /// Whether the handler at work is to make way; then, whether that is because a part of it broke, and
    /// no order. If not, the task's loop is woken when it is.
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

    /// Takes in a message that has a credit.
    fn take_in(&self, processor: &Processor, message: Message) {
        let mailbox = &self.task.mailbox;
        if mailbox.is_closed() {
            return message.refuse(Fault::Stopping);
        }
        let (urgent, _) = is_urgent(&message);
        let command = message.command();
        let mut lanes = self.lanes();
        if lanes.keeps(&message) {
            mailbox.credits(urgent).give(1);
            return self.keep(lanes, message);
        }
        lanes.lane(urgent).queue.push_back(message);
        drop(lanes);
        self.has_come(processor, command);
    }

    /// Takes in a message, or lets it wait for a credit.
    fn line_up(&self, processor: &Processor, mut message: Message) {
        let mailbox = &self.task.mailbox;
        if mailbox.is_closed() {
            return message.refuse(Fault::Stopping);
        }
        let (urgent, _) = is_urgent(&message);
        let command = message.command();
        let credits = mailbox.credits(urgent);
        let mut lanes = self.lanes();
        if lanes.keeps(&message) {
            credits.leave_line();
            return self.keep(lanes, message);
        }
        let held = lanes.held;
        let lane = lanes.lane(urgent);
        credits.give(std::mem::take(&mut lane.owed));
        let may = !held && lane.waiting.is_empty();
        if !may || !credits.take_past_others(mailbox.capacity()) {
            lane.waiting.push_back(message);
            drop(lanes);
            if held {
                self.wake_idle(processor);
            }
            return;
        }
        credits.leave_line();
        let sender = message.take_acceptance();
        lane.queue.push_back(message);
        drop(lanes);
        self.has_come(processor, command);
        sender.into_iter().for_each(ReplySlot::accept);
    }
}

impl Inlet for TaskQueue {
    fn offer(&self, processor: &Processor, message: Message) -> Result<(), NotTaken> {
        let mailbox = &self.task.mailbox;
        let taken = match mailbox.take_credit(message) {
            Err(NotTaken::Full(message)) if self.give_owed(is_urgent(&message).0) => {
                mailbox.take_credit(message)
            }
            taken => taken,
        };
        self.take_in(processor, taken?);
        Ok(())
    }

    fn accept(&self, processor: &Processor, delivery: Delivery) {
        match delivery {
            Delivery::Message(message) => self.take_in(processor, message),
            Delivery::Waits(message) => self.line_up(processor, message),
            Delivery::OpenGate(chassis) => self.open_gate(processor, chassis),
            Delivery::ForgetGate(chassis) => {
                let mut lanes = self.lanes();
                let gone = lanes.gate.as_mut().map(|gate| gate.take_out(chassis));
                drop(lanes);
                drop(gone);
            }
        }
    }

    fn close(&self, processor: &Processor) {
        self.task.mailbox.closed.store(true, Ordering::Release);
        let Lanes {
            urgent,
            normal,
            gate,
            ..
        } = self.lanes.take();
        let held = gate.into_iter().flat_map(|gate| gate.held);
        let in_lanes = [urgent, normal].into_iter();
        let in_lanes = in_lanes.flat_map(|lane| lane.queue.into_iter().chain(lane.waiting));
        for message in held.chain(in_lanes) {
            message.refuse(Fault::Stopping);
        }
        if let Some(runner) = self.runner.get() {
            processor.wake(runner);
        }
    }
}
