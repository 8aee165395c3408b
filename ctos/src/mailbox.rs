//! A task's bounded queue: a high-priority lane and a normal one, and senders that wait for room.
//!
//! First in, first out per lane, so also per pair of sender and receiver. Each lane has its own room
//! and its own line of waiting senders: a flood of normal messages cannot keep an urgent one out.
//! Messages of the runtime itself (phases, stop, a dead chassis) travel in the high-priority lane and
//! are never refused.

use std::{
    collections::{BTreeSet, VecDeque},
    future::poll_fn,
    sync::{Arc, Mutex, MutexGuard},
    task::{Poll, Waker},
};

use crate::{
    call::{Fault, Promise, lock},
    chassis::{Chassis, Inbound},
    message::{Command, Data, Flags, Message, SYSTEM_COMMANDS},
    survey::QueueReport,
    system::{Broke, StopTask, interrupts},
};

/// How many senders may wait for room, as a multiple of the capacity.
const WAITING_FACTOR: usize = 16;

/// Whom to tell that a one-way message has been taken.
pub(crate) enum Acceptance {
    /// Nobody: the sender waits for the reply instead.
    Silent,
    /// A sender of this chassis.
    Local(Arc<Promise>),
    /// A sender behind a link.
    Remote {
        chassis: Arc<Chassis>,
        request: Inbound,
    },
}

impl Acceptance {
    pub(crate) fn tell(self, result: Result<(), Fault>) {
        let answer = result.map(|()| Data::Bytes(Vec::new()));
        match self {
            Self::Silent => {}
            Self::Local(promise) => promise.fulfil(answer),
            Self::Remote { chassis, request } => chassis.post_reply(&request, answer),
        }
    }

    /// Whether the sender has been told already that its message was not taken.
    pub(crate) fn is_abandoned(&self) -> bool {
        match self {
            Self::Silent => false,
            Self::Local(promise) => promise.is_abandoned(),
            Self::Remote { request, .. } => request.is_abandoned(),
        }
    }
}

#[derive(Default)]
struct Lane {
    queue: VecDeque<Message>,
    /// Never holds anybody while the queue has room.
    waiting: VecDeque<(Message, Acceptance)>,
}

/// A message that its task takes, and what that means for those who wait for room.
struct Taken {
    message: Message,
    /// Has its message in the queue now.
    admitted: Acceptance,
    /// Gave up before there was room.
    given_up: Vec<(Message, Acceptance)>,
}

impl Lane {
    /// Takes the first message and moves the first sender that still waits into its room.
    fn take(&mut self, capacity: usize) -> Option<Taken> {
        let mut taken = Taken {
            message: self.queue.pop_front()?,
            admitted: Acceptance::Silent,
            given_up: Vec::new(),
        };
        while self.queue.len() < capacity {
            let Some((message, acceptance)) = self.waiting.pop_front() else {
                break;
            };
            if acceptance.is_abandoned() {
                taken.given_up.push((message, acceptance));
                continue;
            }
            self.queue.push_back(message);
            taken.admitted = acceptance;
            break;
        }
        Some(taken)
    }
}

/// What the task's loop wants to be woken for.
enum Receiver {
    /// The next message.
    Idle(Waker),
    /// An order to stop; its handler is at work.
    Busy(Waker),
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
}

#[derive(Default)]
struct Lanes {
    urgent: Lane,
    normal: Lane,
    receiver: Option<Receiver>,
    /// Nothing more is taken into the queues: the task is about to leave, or has left.
    held: bool,
    gate: Option<Gate>,
    closed: bool,
}

impl Lanes {
    fn lane_of(&mut self, message: &Message) -> &mut Lane {
        if message.header.flags.contains(Flags::HIGH_PRIORITY) {
            &mut self.urgent
        } else {
            &mut self.normal
        }
    }

    /// Whom to wake for a message of `command`.
    fn wakes(&mut self, command: u16) -> Option<Waker> {
        match self.receiver.take() {
            Some(Receiver::Busy(waker)) if !interrupts(command) => {
                self.receiver = Some(Receiver::Busy(waker));
                None
            }
            Some(Receiver::Idle(waker) | Receiver::Busy(waker)) => Some(waker),
            None => None,
        }
    }

    /// Whom to wake for a message that is not in a queue yet.
    fn idle(&mut self) -> Option<Waker> {
        match self.receiver.take() {
            Some(Receiver::Idle(waker)) => Some(waker),
            other => {
                self.receiver = other;
                None
            }
        }
    }
}

/// The queue of one task.
pub(crate) struct Mailbox {
    lanes: Mutex<Lanes>,
    capacity: usize,
}

impl Mailbox {
    /// A queue with room for `capacity` messages of each priority.
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            lanes: Mutex::new(Lanes::default()),
            capacity: capacity.max(1),
        }
    }

    /// Puts a message in, or lets it wait for room; `acceptance` is told when it is in, or why not.
    /// A refused message that waits for a reply is answered with the reason.
    pub(crate) fn put(&self, message: Message, acceptance: Acceptance) {
        let mut lanes = lock(&self.lanes);
        if lanes.closed {
            drop(lanes);
            return refuse(message, acceptance, &Fault::Stopping);
        }
        let most = self.capacity.saturating_mul(WAITING_FACTOR);
        if let Some(gate) = lanes.gate.as_mut().filter(|gate| gate.keeps(&message)) {
            if gate.held.len() < most {
                gate.held.push((message, acceptance));
                return;
            }
            drop(lanes);
            return refuse(message, acceptance, &self.full());
        }
        let system = message.header.command >= SYSTEM_COMMANDS;
        let held = lanes.held;
        let lane = if system {
            &mut lanes.urgent
        } else {
            lanes.lane_of(&message)
        };
        if system || (lane.queue.len() < self.capacity && !held) {
            Self::accepted(lanes, message, system);
            acceptance.tell(Ok(()));
        } else if lane.waiting.len() < most {
            lane.waiting.push_back((message, acceptance));
            let waker = if held { lanes.idle() } else { None };
            drop(lanes);
            if let Some(waker) = waker {
                waker.wake();
            }
        } else {
            drop(lanes);
            refuse(message, acceptance, &self.full());
        }
    }

    /// Puts a message in only if there is room now.
    pub(crate) fn try_put(&self, message: Message) -> Result<(), Fault> {
        let mut lanes = lock(&self.lanes);
        if lanes.closed {
            return Err(Fault::Stopping);
        }
        let gated = lanes.gate.as_ref().is_some_and(|gate| gate.keeps(&message));
        if gated || lanes.held || lanes.lane_of(&message).queue.len() >= self.capacity {
            return Err(self.full());
        }
        Self::accepted(lanes, message, false);
        Ok(())
    }

    /// How much is in it.
    pub(crate) fn lengths(&self) -> QueueReport {
        let lanes = lock(&self.lanes);
        let length = |lane: &Lane| lane.queue.len() as u64;
        let waiting = lanes.urgent.waiting.len() + lanes.normal.waiting.len();
        QueueReport {
            urgent: length(&lanes.urgent),
            normal: length(&lanes.normal),
            waiting: waiting as u64,
            capacity: self.capacity as u64,
        }
    }

    fn full(&self) -> Fault {
        Fault::Full {
            capacity: self.capacity,
        }
    }

    fn accepted(mut lanes: MutexGuard<'_, Lanes>, message: Message, system: bool) {
        let waker = lanes.wakes(message.header.command);
        if system {
            lanes.urgent.queue.push_back(message);
        } else {
            lanes.lane_of(&message).queue.push_back(message);
        }
        drop(lanes);
        if let Some(waker) = waker {
            waker.wake();
        }
    }

    /// How many messages are in it or wait for room, and how many of each priority it holds.
    pub(crate) fn depth(&self) -> (usize, usize) {
        let lanes = lock(&self.lanes);
        let depth = |lane: &Lane| lane.queue.len() + lane.waiting.len();
        (depth(&lanes.urgent) + depth(&lanes.normal), self.capacity)
    }

    /// The next message, high priority first; `None` once the mailbox is closed.
    pub(crate) async fn next(&self) -> Option<Message> {
        poll_fn(|cx| {
            let mut lanes = lock(&self.lanes);
            if lanes.closed {
                return Poll::Ready(None);
            }
            let taken = match lanes.urgent.take(self.capacity) {
                Some(taken) => Some(taken),
                None => lanes.normal.take(self.capacity),
            };
            let Some(Taken {
                message,
                admitted,
                given_up,
            }) = taken
            else {
                lanes.receiver = Some(Receiver::Idle(cx.waker().clone()));
                return Poll::Pending;
            };
            drop(lanes);
            // Outside the lock: what is dropped and told here may run code of others.
            drop(given_up);
            admitted.tell(Ok(()));
            Poll::Ready(Some(message))
        })
        .await
    }

    /// Ends when a [`StopTask`] waits in the queue. For the loop of the task, while its handler runs.
    pub(crate) async fn stop_waits(&self) {
        self.waits_for(|command| command == StopTask::CODE).await;
    }

    /// Ends when a message waits in the queue that ends whatever the handler is doing; true when that is
    /// no order to stop or to begin anew, but the news that a part of the handler broke.
    pub(crate) async fn interruption_waits(&self) -> bool {
        let command = self.waits_for(interrupts).await;
        command.is_some_and(|command| command == Broke::CODE)
    }

    async fn waits_for(&self, wanted: fn(u16) -> bool) -> Option<u16> {
        poll_fn(|cx| {
            let mut lanes = lock(&self.lanes);
            let mut commands = lanes.urgent.queue.iter().map(Message::command);
            let found = commands.find(|command| wanted(*command));
            if lanes.closed || found.is_some() {
                return Poll::Ready(found);
            }
            lanes.receiver = Some(Receiver::Busy(cx.waker().clone()));
            Poll::Pending
        })
        .await
    }

    /// Drops the news that parts of the handler broke: it is gone altogether.
    pub(crate) fn forget_broken(&self) {
        let mut lanes = lock(&self.lanes);
        let queue = std::mem::take(&mut lanes.urgent.queue);
        let is_news = |message: &Message| message.command() == Broke::CODE;
        let (news, kept): (VecDeque<_>, VecDeque<_>) = queue.into_iter().partition(is_news);
        lanes.urgent.queue = kept;
        drop(lanes);
        drop(news);
    }

    /// From now on messages of tasks wait and are not taken; those of the runtime are.
    pub(crate) fn hold(&self) {
        lock(&self.lanes).held = true;
    }

    /// Takes messages again: first `before`, which were taken out of the queue, then those that waited.
    pub(crate) fn release(&self, before: Vec<Message>) {
        let mut lanes = lock(&self.lanes);
        lanes.held = false;
        for message in before.into_iter().rev() {
            lanes.lane_of(&message).queue.push_front(message);
        }
        let mut admitted = Vec::new();
        let mut given_up = Vec::new();
        let Lanes { urgent, normal, .. } = &mut *lanes;
        for lane in [urgent, normal] {
            while lane.queue.len() < self.capacity
                && let Some((message, acceptance)) = lane.waiting.pop_front()
            {
                if acceptance.is_abandoned() {
                    given_up.push((message, acceptance));
                    continue;
                }
                lane.queue.push_back(message);
                admitted.push(acceptance);
            }
        }
        drop(lanes);
        drop(given_up);
        for acceptance in admitted {
            acceptance.tell(Ok(()));
        }
    }

    /// Takes out of the queue what tasks sent: the messages that have been accepted.
    pub(crate) fn take_accepted(&self) -> Vec<Message> {
        let mut lanes = lock(&self.lanes);
        let of_runtime = |message: &Message| message.header.command >= SYSTEM_COMMANDS;
        let urgent = std::mem::take(&mut lanes.urgent.queue);
        let (kept, taken): (VecDeque<_>, VecDeque<_>) = urgent.into_iter().partition(of_runtime);
        lanes.urgent.queue = kept;
        let mut taken = Vec::from(taken);
        taken.extend(std::mem::take(&mut lanes.normal.queue));
        taken
    }

    /// Everything that came while the queue was held: `None` once the mailbox is closed.
    pub(crate) async fn next_held(&self) -> Option<Vec<(Message, Acceptance)>> {
        poll_fn(|cx| {
            let mut lanes = lock(&self.lanes);
            if lanes.closed {
                return Poll::Ready(None);
            }
            let mut all = Vec::new();
            let Lanes { urgent, normal, .. } = &mut *lanes;
            for lane in [urgent, normal] {
                let queued = lane.queue.drain(..);
                all.extend(queued.map(|message| (message, Acceptance::Silent)));
                all.extend(lane.waiting.drain(..));
            }
            if all.is_empty() {
                lanes.receiver = Some(Receiver::Idle(cx.waker().clone()));
                return Poll::Pending;
            }
            Poll::Ready(Some(all))
        })
        .await
    }

    /// Keeps what comes straight from `chassis` until its gate is opened.
    pub(crate) fn close_gates(&self, chassis: BTreeSet<u8>) {
        lock(&self.lanes).gate = Some(Gate {
            closed: chassis,
            held: Vec::new(),
        });
    }

    /// Drops what came straight from `chassis`, which is gone: nobody was told that it was taken.
    pub(crate) fn forget_gate(&self, chassis: u8) {
        let mut lanes = lock(&self.lanes);
        let Some(gate) = lanes.gate.as_mut() else {
            return;
        };
        gate.closed.remove(&chassis);
        let of_chassis =
            |(message, _): &(Message, Acceptance)| message.header.from.chassis() == chassis;
        let (gone, held): (Vec<_>, Vec<_>) = std::mem::take(&mut gate.held)
            .into_iter()
            .partition(of_chassis);
        gate.held = held;
        drop(lanes);
        drop(gone);
    }

    /// Lets in what came straight from `chassis`, in its order, and whatever comes from there later.
    pub(crate) fn open_gate(&self, chassis: u8) {
        let mut lanes = lock(&self.lanes);
        let Some(gate) = lanes.gate.as_mut() else {
            return;
        };
        gate.closed.remove(&chassis);
        let of_chassis =
            |(message, _): &(Message, Acceptance)| message.header.from.chassis() == chassis;
        let (free, held): (Vec<_>, Vec<_>) = std::mem::take(&mut gate.held)
            .into_iter()
            .partition(of_chassis);
        gate.held = held;
        if gate.closed.is_empty() {
            lanes.gate = None;
        }
        let mut admitted = Vec::new();
        let mut given_up = Vec::new();
        for (message, acceptance) in free {
            if acceptance.is_abandoned() {
                given_up.push((message, acceptance));
                continue;
            }
            let lane = lanes.lane_of(&message);
            // Those beyond the room wait. They are bounded already: the gate holds no more than may wait.
            if lane.queue.len() < self.capacity {
                lane.queue.push_back(message);
                admitted.push(acceptance);
            } else {
                lane.waiting.push_back((message, acceptance));
            }
        }
        let waker = lanes.idle();
        drop(lanes);
        drop(given_up);
        for acceptance in admitted {
            acceptance.tell(Ok(()));
        }
        if let Some(waker) = waker {
            waker.wake();
        }
    }

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(&self) {
        let mut lanes = lock(&self.lanes);
        lanes.closed = true;
        let urgent = std::mem::take(&mut lanes.urgent);
        let normal = std::mem::take(&mut lanes.normal);
        let receiver = lanes.receiver.take();
        let gate = lanes.gate.take();
        drop(lanes);
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
        if let Some(Receiver::Idle(waker) | Receiver::Busy(waker)) = receiver {
            waker.wake();
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
mod tests {
    use std::{
        future::Future,
        sync::atomic::{AtomicUsize, Ordering},
    };

    use futures_util::FutureExt;
    use proptest::prelude::*;

    use super::*;
    use crate::{
        call::Waiting,
        message::{Header, Tid},
    };

    fn message(number: u32, flags: Flags) -> Message {
        Message {
            trace: 1,
            deadline: None,
            recorded: 0,
            header: Header {
                to: Tid::from_bits(1),
                from: Tid::from_bits(2),
                command: 1,
                flags,
                size: 0,
            },
            data: Data::of(number),
            reply: None,
        }
    }

    fn take(mailbox: &Mailbox) -> Option<u32> {
        let message = mailbox.next().now_or_never()??;
        Some(message.data.take().unwrap())
    }

    #[test]
    fn high_priority_overtakes_and_each_lane_keeps_its_order() {
        let mailbox = Mailbox::new(8);
        for (number, flags) in [
            (1, Flags::NONE),
            (2, Flags::HIGH_PRIORITY),
            (3, Flags::NONE),
            (4, Flags::HIGH_PRIORITY),
        ] {
            mailbox.put(message(number, flags), Acceptance::Silent);
        }
        let order: Vec<_> = std::iter::from_fn(|| take(&mailbox)).collect();
        assert_eq!(order, [2, 4, 1, 3]);
    }

    #[test]
    fn a_full_queue_is_an_error_for_those_who_do_not_wait() {
        let mailbox = Mailbox::new(1);
        mailbox.try_put(message(1, Flags::NONE)).unwrap();
        let fault = mailbox.try_put(message(2, Flags::NONE)).unwrap_err();
        assert_eq!(fault, Fault::Full { capacity: 1 });
    }

    #[test]
    fn closing_answers_everyone_who_waits() {
        let mailbox = Mailbox::new(1);
        mailbox.put(message(1, Flags::NONE), Acceptance::Silent);
        let promise = Arc::new(Promise::default());
        mailbox.put(message(2, Flags::NONE), Acceptance::Local(promise.clone()));
        mailbox.close();
        let answer = Waiting::here(promise).now_or_never().unwrap();
        assert_eq!(answer.unwrap_err(), Fault::Stopping);
        assert!(mailbox.next().now_or_never().unwrap().is_none());
    }

    #[test]
    fn a_flood_of_normal_messages_keeps_no_urgent_one_out() {
        let mailbox = Mailbox::new(2);
        for number in 0..34 {
            mailbox.put(message(number, Flags::NONE), Acceptance::Silent);
        }
        let fault = mailbox.try_put(message(90, Flags::NONE)).unwrap_err();
        assert_eq!(fault, Fault::Full { capacity: 2 });
        mailbox.try_put(message(99, Flags::HIGH_PRIORITY)).unwrap();
        let order: Vec<_> = std::iter::from_fn(|| take(&mailbox)).collect();
        let expected: Vec<u32> = std::iter::once(99).chain(0..34).collect();
        assert_eq!(order, expected);
    }

    #[test]
    fn a_message_whose_sender_gave_up_waiting_is_never_delivered() {
        let mailbox = Mailbox::new(1);
        mailbox.put(message(1, Flags::NONE), Acceptance::Silent);
        let promise = Arc::new(Promise::default());
        mailbox.put(message(2, Flags::NONE), Acceptance::Local(promise.clone()));
        mailbox.put(message(3, Flags::NONE), Acceptance::Silent);
        drop(Waiting::here(promise));
        let order: Vec<_> = std::iter::from_fn(|| take(&mailbox)).collect();
        assert_eq!(order, [1, 3]);
    }

    #[test]
    fn a_busy_task_is_woken_by_an_order_to_stop_only() {
        let mailbox = Mailbox::new(4);
        let woken = Arc::new(Count::default());
        let waker = Waker::from(woken.clone());
        let mut stop = Box::pin(mailbox.stop_waits());
        let mut poll = || {
            stop.as_mut()
                .poll(&mut std::task::Context::from_waker(&waker))
        };
        assert!(poll().is_pending());
        mailbox.put(message(1, Flags::NONE), Acceptance::Silent);
        mailbox.put(message(2, Flags::HIGH_PRIORITY), Acceptance::Silent);
        assert_eq!(woken.0.load(Ordering::Relaxed), 0);
        let mut order = message(3, Flags::HIGH_PRIORITY);
        order.header.command = StopTask::CODE;
        mailbox.put(order, Acceptance::Silent);
        assert_eq!(woken.0.load(Ordering::Relaxed), 1);
        assert!(poll().is_ready());
    }

    fn from(chassis: u8, number: u32, flags: Flags) -> Message {
        let mut message = message(number, flags);
        message.header.from = Tid::new(chassis, 1, 1);
        message
    }

    #[test]
    fn what_comes_straight_waits_at_the_gate_for_what_comes_by_the_old_place() {
        let mailbox = Mailbox::new(2);
        mailbox.close_gates([1, 2].into());
        for number in [4, 5, 6] {
            mailbox.put(from(1, number, Flags::NONE), Acceptance::Silent);
        }
        mailbox.put(from(2, 7, Flags::HIGH_PRIORITY), Acceptance::Silent);
        for number in [1, 2, 3] {
            mailbox.put(from(1, number, Flags::FORWARDED), Acceptance::Silent);
        }
        let room = mailbox.try_put(from(1, 9, Flags::NONE));
        assert_eq!(room.unwrap_err(), Fault::Full { capacity: 2 });
        assert_eq!(take(&mailbox), Some(1));
        mailbox.open_gate(1);
        mailbox.put(from(1, 8, Flags::NONE), Acceptance::Silent);
        let order: Vec<_> = std::iter::from_fn(|| take(&mailbox)).collect();
        assert_eq!(order, [2, 3, 4, 5, 6, 8]);
        // Its chassis is gone before its gate was opened: nobody was told that it was taken.
        mailbox.forget_gate(2);
        assert_eq!(take(&mailbox), None);
    }

    #[test]
    fn a_held_queue_tells_nobody_that_a_message_was_taken_and_keeps_all_in_order() {
        let mailbox = Mailbox::new(2);
        mailbox.put(message(1, Flags::NONE), Acceptance::Silent);
        mailbox.hold();
        let accepted = mailbox.take_accepted();
        let promise = Arc::new(Promise::default());
        mailbox.put(message(2, Flags::NONE), Acceptance::Local(promise.clone()));
        mailbox.put(message(3, Flags::NONE), Acceptance::Silent);
        assert!(mailbox.try_put(message(9, Flags::NONE)).is_err());
        let mut waiting = Waiting::here(promise);
        assert!((&mut waiting).now_or_never().is_none());
        mailbox.release(accepted);
        assert!((&mut waiting).now_or_never().unwrap().is_ok());
        let order: Vec<_> = std::iter::from_fn(|| take(&mailbox)).collect();
        assert_eq!(order, [1, 2, 3]);
    }

    #[test]
    fn what_came_while_the_queue_was_held_is_had_at_once_and_wakes_who_waits_for_it() {
        let mailbox = Mailbox::new(2);
        mailbox.hold();
        let woken = Arc::new(Count::default());
        let waker = Waker::from(woken.clone());
        let mut next = Box::pin(mailbox.next_held());
        let mut poll = || {
            next.as_mut()
                .poll(&mut std::task::Context::from_waker(&waker))
        };
        assert!(poll().is_pending());
        mailbox.put(message(1, Flags::NONE), Acceptance::Silent);
        assert_eq!(woken.0.load(Ordering::Relaxed), 1);
        mailbox.put(message(2, Flags::HIGH_PRIORITY), Acceptance::Silent);
        let Poll::Ready(Some(all)) = poll() else {
            panic!("nothing came");
        };
        assert_eq!(all.len(), 2);
    }

    #[derive(Default)]
    struct Count(AtomicUsize);

    impl std::task::Wake for Count {
        fn wake(self: Arc<Self>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    proptest! {
        #[test]
        fn nothing_is_lost_or_reordered_whatever_the_capacity(
            capacity in 1_usize..8, count in 0_u32..64, takes in proptest::collection::vec(any::<bool>(), 0..64)
        ) {
            let mailbox = Mailbox::new(capacity);
            let mut accepted = Vec::new();
            let mut received = Vec::new();
            let mut takes = takes.into_iter();
            for number in 0..count {
                let promise = Arc::new(Promise::default());
                mailbox.put(message(number, Flags::NONE), Acceptance::Local(promise.clone()));
                accepted.push(Waiting::here(promise));
                if takes.next().unwrap_or(false) {
                    received.extend(take(&mailbox));
                }
            }
            received.extend(std::iter::from_fn(|| take(&mailbox)));
            let refused = accepted
                .into_iter()
                .filter_map(FutureExt::now_or_never)
                .filter(|answer| matches!(answer, Err(Fault::Full { .. })))
                .count();
            prop_assert!(received.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert_eq!(received.len() + refused, count as usize);
        }
    }
}
