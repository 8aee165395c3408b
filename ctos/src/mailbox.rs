//! A task's bounded queue: a high-priority lane and a normal one, and senders that wait for room.
//!
//! First in, first out per lane, so also per pair of sender and receiver. Messages of the runtime
//! itself (phases, stop, a dead chassis) travel in the high-priority lane and are never refused.

use std::{
    collections::VecDeque,
    future::poll_fn,
    sync::{Arc, Mutex},
    task::{Poll, Waker},
};

use crate::{
    call::{Fault, Promise, lock},
    chassis::Chassis,
    message::{Command, Data, Flags, Header, Message, SYSTEM_COMMANDS},
    system::StopTask,
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
        request: Header,
        call: u64,
    },
}

impl Acceptance {
    pub(crate) fn tell(self, result: Result<(), Fault>) {
        let answer = result.map(|()| Data::Bytes(Vec::new()));
        match self {
            Self::Silent => {}
            Self::Local(promise) => promise.fulfil(answer),
            Self::Remote {
                chassis,
                request,
                call,
            } => chassis.post_reply(&request, call, answer),
        }
    }
}

#[derive(Default)]
struct Lanes {
    urgent: VecDeque<Message>,
    normal: VecDeque<Message>,
    waiting: VecDeque<(Message, Acceptance)>,
    receiver: Option<Waker>,
    closed: bool,
}

/// The queue of one task.
pub(crate) struct Mailbox {
    lanes: Mutex<Lanes>,
    capacity: usize,
}

impl Mailbox {
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
        let refusal = if lanes.closed {
            Some(Fault::Stopping)
        } else if message.header.command >= SYSTEM_COMMANDS {
            lanes.urgent.push_back(message);
            return Self::accepted(lanes, acceptance);
        } else if lanes.urgent.len() + lanes.normal.len() < self.capacity
            && lanes.waiting.is_empty()
        {
            if message.header.flags.contains(Flags::HIGH_PRIORITY) {
                lanes.urgent.push_back(message);
            } else {
                lanes.normal.push_back(message);
            }
            return Self::accepted(lanes, acceptance);
        } else if lanes.waiting.len() < self.capacity.saturating_mul(WAITING_FACTOR) {
            lanes.waiting.push_back((message, acceptance));
            return;
        } else {
            Some(Fault::Full {
                capacity: self.capacity,
            })
        };
        drop(lanes);
        refuse(message, acceptance, refusal.unwrap_or(Fault::NoReply));
    }

    /// Puts a message in only if there is room now.
    pub(crate) fn try_put(&self, message: Message) -> Result<(), Fault> {
        {
            let lanes = lock(&self.lanes);
            if lanes.closed {
                return Err(Fault::Stopping);
            }
            if lanes.urgent.len() + lanes.normal.len() >= self.capacity || !lanes.waiting.is_empty()
            {
                return Err(Fault::Full {
                    capacity: self.capacity,
                });
            }
        }
        self.put(message, Acceptance::Silent);
        Ok(())
    }

    fn accepted(mut lanes: std::sync::MutexGuard<'_, Lanes>, acceptance: Acceptance) {
        let receiver = lanes.receiver.take();
        drop(lanes);
        if let Some(receiver) = receiver {
            receiver.wake();
        }
        acceptance.tell(Ok(()));
    }

    /// The next message, high priority first; `None` once the mailbox is closed.
    pub(crate) async fn next(&self) -> Option<Message> {
        poll_fn(|cx| {
            let mut lanes = lock(&self.lanes);
            if lanes.closed {
                return Poll::Ready(None);
            }
            let message = lanes
                .urgent
                .pop_front()
                .or_else(|| lanes.normal.pop_front());
            let Some(message) = message else {
                lanes.receiver = Some(cx.waker().clone());
                return Poll::Pending;
            };
            let moved = self.admit_one(&mut lanes);
            drop(lanes);
            if let Some(acceptance) = moved {
                acceptance.tell(Ok(()));
            }
            Poll::Ready(Some(message))
        })
        .await
    }

    /// Ends when a [`StopTask`] waits in the queue. For the loop of the task, while its handler runs.
    pub(crate) async fn stop_waits(&self) {
        poll_fn(|cx| {
            let mut lanes = lock(&self.lanes);
            let stop = |message: &Message| message.header.command == StopTask::CODE;
            if lanes.closed || lanes.urgent.iter().any(stop) {
                return Poll::Ready(());
            }
            lanes.receiver = Some(cx.waker().clone());
            Poll::Pending
        })
        .await;
    }

    /// Moves the first waiting message into the room that a taken one left.
    fn admit_one(&self, lanes: &mut Lanes) -> Option<Acceptance> {
        if lanes.urgent.len() + lanes.normal.len() >= self.capacity {
            return None;
        }
        let (message, acceptance) = lanes.waiting.pop_front()?;
        if message.header.flags.contains(Flags::HIGH_PRIORITY) {
            lanes.urgent.push_back(message);
        } else {
            lanes.normal.push_back(message);
        }
        Some(acceptance)
    }

    /// Takes nothing more; everything inside is answered with [`Fault::Stopping`].
    pub(crate) fn close(&self) {
        let mut lanes = lock(&self.lanes);
        lanes.closed = true;
        let urgent = std::mem::take(&mut lanes.urgent);
        let normal = std::mem::take(&mut lanes.normal);
        let waiting = std::mem::take(&mut lanes.waiting);
        let receiver = lanes.receiver.take();
        drop(lanes);
        for message in urgent.into_iter().chain(normal) {
            refuse(message, Acceptance::Silent, Fault::Stopping);
        }
        for (message, acceptance) in waiting {
            refuse(message, acceptance, Fault::Stopping);
        }
        if let Some(receiver) = receiver {
            receiver.wake();
        }
    }
}

fn refuse(message: Message, acceptance: Acceptance, fault: Fault) {
    if let Some(slot) = message.reply {
        slot.answer(Err(fault.clone()));
    }
    acceptance.tell(Err(fault));
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt;
    use proptest::prelude::*;

    use super::*;
    use crate::{call::Waiting, message::Tid};

    fn message(number: u32, flags: Flags) -> Message {
        Message {
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
        let answer = Waiting(promise).now_or_never().unwrap();
        assert_eq!(answer.unwrap_err(), Fault::Stopping);
        assert!(mailbox.next().now_or_never().unwrap().is_none());
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
                accepted.push(Waiting(promise));
                if takes.next().unwrap_or(false) {
                    received.extend(take(&mailbox));
                }
            }
            received.extend(std::iter::from_fn(|| take(&mailbox)));
            let refused = accepted
                .into_iter()
                .filter(|waiting| matches!(
                    Waiting(waiting.0.clone()).now_or_never(),
                    Some(Err(Fault::Full { .. }))
                ))
                .count();
            prop_assert!(received.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert_eq!(received.len() + refused, count as usize);
        }
    }
}
