//! Each test runs with senders on the task's own processor and with senders on another one.

use std::{
    cell::Cell,
    future::{Future, poll_fn},
    rc::Rc,
    task::Poll,
    time::Duration,
};

use proptest::prelude::*;

use super::{queue::TaskQueue, *};
use crate::{
    exchange::Looked,
    reply::{Answer, CallKey, ReplySlot},
    system::StopTask,
    task_record::TaskRecord,
};
use ctos_message::{Command, Data, Flags, SYSTEM_COMMANDS, Tid};
use ctos_time::{Clock, Instant};

mod storm;

fn message(number: u32, flags: Flags) -> Message {
    Message::request(Tid::from_bits(1), Tid::from_bits(2), 1, number).flagged(flags)
}

/// Where the senders are, seen from the task.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Senders {
    Here,
    Afar,
}

const BOTH: [Senders; 2] = [Senders::Here, Senders::Afar];

struct Bench {
    /// The task's.
    processor: Rc<Processor>,
    /// The senders'.
    caller: Rc<Processor>,
    task: Arc<TaskRecord>,
    queue: Rc<TaskQueue>,
}

/// A sender that waits for its message to be taken.
struct Waiter {
    caller: Rc<Processor>,
    key: CallKey,
}

impl Waiter {
    fn answer(&self) -> Option<Answer> {
        let cx = std::task::Context::from_waker(std::task::Waker::noop());
        match self.caller.poll_call(self.key, &cx) {
            Looked::Waiting => None,
            Looked::Ended(Ok(envelope)) => Some(Ok(envelope.data)),
            Looked::Ended(Err(fault)) => Some(Err(*fault)),
            Looked::Long | Looked::Late(..) => panic!("no time passes here"),
        }
    }
}

impl Bench {
    fn new(capacity: usize, senders: Senders) -> Self {
        let clock = Clock::virtual_clock();
        let processor = Processor::new(Arc::default(), clock.clone());
        let caller = match senders {
            Senders::Here => processor.clone(),
            Senders::Afar => Processor::new(Arc::default(), clock),
        };
        let task = TaskRecord::with_capacity(capacity, processor.handle.clone(), 0);
        let queue = TaskQueue::open(task.clone());
        processor.add_queue(0, queue.clone());
        caller.enter();
        Self {
            processor,
            caller,
            task,
            queue,
        }
    }

    /// What was brought is taken in.
    fn settle(&self) {
        self.processor.run_jobs();
        self.caller.run_jobs();
        self.caller.enter();
    }

    fn send(&self, message: Message) {
        self.task.mailbox.put(message);
    }

    fn waiting_send(&self, mut message: Message) -> Waiter {
        let ticket = self
            .caller
            .begin_call(Instant::START, Duration::from_secs(1));
        let key = ticket.key();
        message.envelope.reply = Some(ReplySlot::call(ticket));
        self.task.mailbox.put(message);
        let caller = self.caller.clone();
        Waiter { caller, key }
    }

    fn try_send(&self, message: Message) -> Result<(), Fault> {
        match self.task.mailbox.offer(message) {
            Ok(()) => Ok(()),
            Err(NotTaken::Full(_)) => Err(self.task.mailbox.full()),
            Err(NotTaken::Closed(_)) => Err(Fault::Stopping),
        }
    }

    fn take(&self) -> Option<u32> {
        self.settle();
        let mut message = None;
        let Poll::Ready(()) = self.queue.poll_next(&mut message) else {
            return None;
        };
        let message = message?;
        self.settle();
        Some(message.envelope.data.take().unwrap())
    }

    fn take_all(&self) -> Vec<u32> {
        std::iter::from_fn(|| self.take()).collect()
    }
}

#[test]
fn high_priority_overtakes_and_each_lane_keeps_its_order() {
    for senders in BOTH {
        let bench = Bench::new(8, senders);
        for (number, flags) in [
            (1, Flags::NONE),
            (2, Flags::HIGH_PRIORITY),
            (3, Flags::NONE),
            (4, Flags::HIGH_PRIORITY),
        ] {
            bench.send(message(number, flags));
        }
        assert_eq!(bench.take_all(), [2, 4, 1, 3]);
    }
}

#[test]
fn a_full_queue_is_an_error_for_those_who_do_not_wait() {
    for senders in BOTH {
        let bench = Bench::new(1, senders);
        bench.try_send(message(1, Flags::NONE)).unwrap();
        let fault = bench.try_send(message(2, Flags::NONE)).unwrap_err();
        assert_eq!(fault, Fault::Full { capacity: 1 });
        bench.settle();
        assert!(bench.try_send(message(3, Flags::NONE)).is_err());
        assert_eq!(bench.take(), Some(1));
        bench.try_send(message(4, Flags::NONE)).unwrap();
        assert_eq!(bench.take_all(), [4]);
    }
}

#[test]
fn senders_wait_for_room_and_are_told_in_order() {
    for senders in BOTH {
        let bench = Bench::new(1, senders);
        bench.send(message(1, Flags::NONE));
        let waiters = [2, 3].map(|number| bench.waiting_send(message(number, Flags::NONE)));
        bench.settle();
        assert!(waiters.iter().all(|waiter| waiter.answer().is_none()));
        assert_eq!(bench.take(), Some(1));
        assert!(waiters[0].answer().is_some_and(|answer| answer.is_ok()));
        assert!(waiters[1].answer().is_none());
        assert_eq!(bench.take_all(), [2, 3]);
        assert!(waiters[1].answer().is_some_and(|answer| answer.is_ok()));
    }
}

#[test]
fn more_than_may_wait_is_refused() {
    for senders in BOTH {
        let bench = Bench::new(1, senders);
        bench.send(message(0, Flags::NONE));
        let waiters: Vec<Waiter> = (1..=17)
            .map(|number| bench.waiting_send(message(number, Flags::NONE)))
            .collect();
        bench.settle();
        let answers: Vec<_> = waiters.iter().map(Waiter::answer).collect();
        assert!(answers[..16].iter().all(Option::is_none));
        let full = Fault::Full { capacity: 1 };
        assert_eq!(answers[16].as_ref().unwrap().as_ref().err(), Some(&full));
    }
}

#[test]
fn messages_of_the_runtime_are_never_refused() {
    for senders in BOTH {
        let bench = Bench::new(1, senders);
        for number in 0..100 {
            let mut one = message(number, Flags::NONE);
            one.envelope.header.command = SYSTEM_COMMANDS;
            bench.try_send(one).unwrap();
        }
        assert_eq!(bench.take_all(), Vec::from_iter(0..100));
    }
}

#[test]
fn whatever_waits_when_the_task_ends_is_answered() {
    for senders in BOTH {
        let bench = Bench::new(1, senders);
        bench.send(message(1, Flags::NONE));
        let waiter = bench.waiting_send(message(2, Flags::NONE));
        let call = bench
            .caller
            .begin_call(Instant::START, Duration::from_secs(1));
        let asked = Waiter {
            caller: bench.caller.clone(),
            key: call.key(),
        };
        let mut question = message(3, Flags::HIGH_PRIORITY | Flags::REPLY_WAIT);
        question.envelope.reply = Some(ReplySlot::call(call));
        bench.send(question);
        bench.task.mailbox.close();
        bench.settle();
        bench.settle();
        assert_eq!(waiter.answer().unwrap().unwrap_err(), Fault::Stopping);
        assert_eq!(asked.answer().unwrap().unwrap_err(), Fault::Stopping);
        let mut next = None;
        assert!(bench.queue.poll_next(&mut next).is_ready());
        assert!(next.is_none());
        assert_eq!(
            bench.try_send(message(4, Flags::NONE)),
            Err(Fault::Stopping)
        );
    }
}

#[test]
fn a_flood_of_normal_messages_keeps_no_urgent_one_out() {
    for senders in BOTH {
        let bench = Bench::new(2, senders);
        for number in 0..34 {
            bench.send(message(number, Flags::NONE));
        }
        let fault = bench.try_send(message(90, Flags::NONE)).unwrap_err();
        assert_eq!(fault, Fault::Full { capacity: 2 });
        bench.try_send(message(99, Flags::HIGH_PRIORITY)).unwrap();
        let expected: Vec<u32> = std::iter::once(99).chain(0..34).collect();
        assert_eq!(bench.take_all(), expected);
    }
}

#[test]
fn a_message_whose_sender_gave_up_waiting_is_never_delivered() {
    for senders in BOTH {
        let bench = Bench::new(1, senders);
        bench.send(message(1, Flags::NONE));
        let gives_up = bench.waiting_send(message(2, Flags::NONE));
        bench.send(message(3, Flags::NONE));
        bench.caller.give_up_call(gives_up.key);
        assert_eq!(bench.take_all(), [1, 3]);
    }
}

#[test]
fn a_sender_whose_message_waits_is_not_overtaken_by_its_next_one() {
    // The credit of the taken message belongs to the one that waits, though that one has not
    // been taken in yet.
    let bench = Bench::new(2, Senders::Afar);
    bench.send(message(1, Flags::NONE));
    bench.send(message(2, Flags::NONE));
    bench.settle();
    bench.send(message(3, Flags::NONE));
    assert!(bench.queue.take().is_some());
    bench.send(message(4, Flags::NONE));
    assert_eq!(bench.take_all(), [2, 3, 4]);
}

#[test]
fn a_busy_task_is_woken_by_an_order_to_stop_only() {
    for senders in BOTH {
        let bench = Bench::new(4, senders);
        let queue = bench.queue.clone();
        let polls = Rc::new(Cell::new(0));
        let count = polls.clone();
        let runner = bench.processor.spawn(
            async move {
                let stop = queue.stop_waits();
                let mut stop = std::pin::pin!(stop);
                poll_fn(|cx| {
                    count.set(count.get() + 1);
                    stop.as_mut().poll(cx)
                })
                .await;
            },
            None,
        );
        bench.queue.set_runner(runner);
        let poll_all = || {
            bench.settle();
            while bench.processor.poll_ready(0) {}
            bench.caller.enter();
        };
        poll_all();
        bench.send(message(1, Flags::NONE));
        bench.send(message(2, Flags::HIGH_PRIORITY));
        poll_all();
        assert_eq!(polls.get(), 1);
        let mut order = message(3, Flags::HIGH_PRIORITY);
        order.envelope.header.command = StopTask::CODE;
        bench.send(order);
        poll_all();
        assert_eq!(polls.get(), 2);
    }
}

proptest! {
    #[test]
    fn nothing_is_lost_or_reordered_whatever_the_capacity(
        afar: bool,
        capacity in prop_oneof![1_usize..8, 16_usize..40],
        count in 0_u32..128,
        takes in proptest::collection::vec(any::<(bool, bool)>(), 0..128)
    ) {
        let senders = if afar { Senders::Afar } else { Senders::Here };
        let bench = Bench::new(capacity, senders);
        let mut accepted = Vec::new();
        let mut received = Vec::new();
        let mut takes = takes.into_iter();
        for number in 0..count {
            accepted.push(bench.waiting_send(message(number, Flags::NONE)));
            let (takes, settles) = takes.next().unwrap_or_default();
            if settles {
                bench.settle();
            }
            // Without settling: what was brought meanwhile is still on its way.
            if takes && let Some(message) = bench.queue.take() {
                received.push(message.envelope.data.take::<u32>().unwrap());
            }
        }
        received.extend(bench.take_all());
        let refused = accepted
            .iter()
            .filter_map(Waiter::answer)
            .filter(|answer| matches!(answer, Err(Fault::Full { .. })))
            .count();
        prop_assert!(received.windows(2).all(|pair| pair[0] < pair[1]));
        prop_assert_eq!(received.len() + refused, count as usize);
        prop_assert_eq!(bench.task.mailbox.depth().0, 0);
    }
}
