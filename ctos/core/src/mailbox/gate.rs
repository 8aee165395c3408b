//! What happens to a queue otherwise than message by message: its task leaves for another place or comes
//! from one, or gets a new handler.

use std::{
    collections::{BTreeSet, VecDeque},
    future::poll_fn,
    task::Poll,
};

use super::queue::{Lanes, TaskQueue, WaitsFor};
use crate::{
    delivery::is_urgent,
    envelope::Message,
    processor::Processor,
    system::{Broke, interrupts},
};
use ctos_message::{ChassisNumber, Command, Flags, SYSTEM_COMMANDS};

/// Messages that came straight to a task's new place before everything that their chassis had sent to
/// the old one.
pub(super) struct Gate {
    pub(super) closed: BTreeSet<ChassisNumber>,
    pub(super) held: Vec<Message>,
}

impl Gate {
    pub(super) fn keeps(&self, message: &Message) -> bool {
        let header = message.header();
        header.command < SYSTEM_COMMANDS
            && !header.flags.contains(Flags::FORWARDED)
            && self.closed.contains(&header.from.chassis())
    }

    /// Takes out what came from `chassis`, whose gate is open now.
    pub(super) fn take_out(&mut self, chassis: ChassisNumber) -> Vec<Message> {
        self.closed.remove(&chassis);
        let of_chassis = |message: &mut Message| message.from().chassis() == chassis;
        self.held.extract_if(.., of_chassis).collect()
    }
}

impl TaskQueue {
    /// Drops the news that parts of the handler broke: it is gone altogether.
    pub(crate) fn forget_broken(&self) {
        let mut lanes = self.lanes();
        let credits = lanes.urgent.all_credits();
        let queue = std::mem::take(&mut lanes.urgent.queue);
        let is_news = |message: &Message| message.command() == Broke::CODE;
        let (news, kept): (VecDeque<_>, VecDeque<_>) = queue.into_iter().partition(is_news);
        let kept_count = kept.len();
        lanes.urgent.queue = kept;
        self.count_interruptions(&lanes);
        drop(lanes);
        self.task.mailbox.credits(true).give(credits - kept_count);
        drop(news);
        // The credits they had are for those who wait.
        self.admit();
    }

    /// The urgent lane was changed otherwise than by putting in or taking out one message.
    fn count_interruptions(&self, lanes: &Lanes) {
        let interrupting = lanes.urgent.queue.iter().map(Message::command);
        let interrupting = interrupting.filter(|command| interrupts(*command));
        self.interruptions
            .set(u32::try_from(interrupting.count()).unwrap_or(u32::MAX));
    }

    /// From now on messages of tasks wait and are not taken; those of the runtime are.
    pub(crate) fn hold(&self) {
        self.task.mailbox.shut(true);
        self.lanes().held = true;
    }

    /// Takes messages again: first `before`, which were taken out of the queue, then those that waited.
    pub(crate) fn release(&self, before: Vec<Message>) {
        let mut lanes = self.lanes();
        lanes.held = false;
        for message in before.into_iter().rev() {
            let (urgent, _) = is_urgent(&message);
            self.task.mailbox.credits(urgent).take_always();
            lanes.lane(urgent).queue.push_front(message);
        }
        self.count_interruptions(&lanes);
        drop(lanes);
        self.admit();
        self.task.mailbox.shut(false);
    }

    /// Takes out of the queue what tasks sent: the messages that have been accepted.
    pub(crate) fn take_accepted(&self) -> Vec<Message> {
        let mut lanes = self.lanes();
        let of_runtime = |message: &Message| message.command() >= SYSTEM_COMMANDS;
        let (in_urgent, in_normal) = (lanes.urgent.all_credits(), lanes.normal.all_credits());
        let urgent = std::mem::take(&mut lanes.urgent.queue);
        let (kept, taken): (VecDeque<_>, VecDeque<_>) = urgent.into_iter().partition(of_runtime);
        let mailbox = &self.task.mailbox;
        mailbox.credits(true).give(in_urgent - kept.len());
        mailbox.credits(false).give(in_normal);
        lanes.urgent.queue = kept;
        let normal = std::mem::take(&mut lanes.normal.queue);
        self.count_interruptions(&lanes);
        taken.into_iter().chain(normal).collect()
    }

    /// Everything that came while the queue was held: `None` once the queue is closed. For the loop of the
    /// task, and awaited by nobody else.
    pub(crate) async fn next_held(&self) -> Option<Vec<Message>> {
        poll_fn(|_| {
            if self.task.mailbox.is_closed() {
                return Poll::Ready(None);
            }
            let mut lanes = self.lanes();
            let mut all = Vec::new();
            for urgent in [true, false] {
                let credits = self.task.mailbox.credits(urgent);
                let lane = lanes.lane(urgent);
                credits.give(lane.all_credits());
                all.extend(lane.queue.drain(..));
                for waiting in lane.waiting.drain(..) {
                    credits.leave_line();
                    all.push(waiting);
                }
            }
            self.count_interruptions(&lanes);
            if all.is_empty() {
                self.waits_for.set(WaitsFor::Message);
                return Poll::Pending;
            }
            Poll::Ready(Some(all))
        })
        .await
    }

    /// What came from `chassis` waits for credits now. It is bounded: the gate holds no more than may wait.
    pub(super) fn open_gate(&self, processor: &Processor, chassis: ChassisNumber) {
        let mut lanes = self.lanes();
        let Some(gate) = lanes.gate.as_mut() else {
            return;
        };
        let free = gate.take_out(chassis);
        let all_open = gate.closed.is_empty();
        if all_open {
            lanes.gate = None;
        }
        for message in free {
            let (urgent, _) = is_urgent(&message);
            self.task.mailbox.credits(urgent).join_line();
            lanes.lane(urgent).waiting.push_back(message);
        }
        let held = lanes.held;
        drop(lanes);
        self.admit();
        if all_open && !held {
            self.task.mailbox.shut(false);
        }
        self.wake_idle(processor);
    }
}
