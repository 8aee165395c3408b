//! Several threads send to one queue as fast as they can, while its task takes, pauses, is about to move, and
//! dies. Nothing is lost, doubled or reordered, and waiting senders are told.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::{Mutex, atomic::AtomicUsize},
};

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use super::*;
use crate::envelope::Envelope;
use ctos_time::lock::lock;

const SENDERS: u32 = 3;
const EACH: u32 = 1500;

/// Long enough for any machine: nothing here waits for the time to pass.
const LIMIT: Duration = Duration::from_secs(600);

/// Which message: of which sender, of which priority, and its number among all of that sender.
type Label = (u32, bool, u32);

/// How a message was sent.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    /// Only if there is a credit.
    Try,
    /// Its sender waits for a credit.
    Send,
    /// Its sender waits for the reply.
    Call,
}

type Outcomes = BTreeMap<Label, (Way, Result<(), Fault>)>;

fn labelled(label: Label) -> Message {
    let flags = if label.1 {
        Flags::HIGH_PRIORITY
    } else {
        Flags::NONE
    };
    Message::request(Tid::from_bits(1), Tid::from_bits(2), 1, label).flagged(flags)
}

/// The answer to a call of `processor`.
async fn answered(processor: &Processor, key: CallKey) -> Result<(), Fault> {
    poll_fn(|cx| match processor.poll_call(key, cx) {
        Looked::Ended(answer) => Poll::Ready(answer.map(drop).map_err(|fault| *fault)),
        Looked::Waiting | Looked::Long => Poll::Pending,
        Looked::Late(_) => panic!("somebody was never told"),
    })
    .await
}

/// Yields to everything else of the processor.
async fn step_back() {
    let mut went = false;
    poll_fn(|cx| {
        if std::mem::replace(&mut went, true) {
            return Poll::Ready(());
        }
        cx.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// Takes what comes, and answers it, until the queue is closed.
async fn take_all(queue: Rc<TaskQueue>, seed: u64, taken: Arc<Mutex<Vec<Label>>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut next = None;
    loop {
        poll_fn(|_| queue.poll_next(&mut next)).await;
        let Some(message) = next.take() else {
            return;
        };
        let Envelope { data, reply, .. } = *message.envelope;
        lock(&taken).push(data.take().unwrap());
        if let Some(reply) = reply {
            reply.answer(Ok(Data::of(())));
        }
        match rng.random_range(0..200) {
            0..10 => step_back().await,
            // As before a move that comes to nothing.
            10 => {
                queue.hold();
                let accepted = queue.take_accepted();
                for _ in 0..3 {
                    step_back().await;
                }
                queue.release(accepted);
            }
            _ => {}
        }
    }
}

/// Sends all messages of one sender in all ways; what became of each.
async fn send_all(here: Rc<Processor>, task: Arc<TaskRecord>, sender: u32, seed: u64) -> Outcomes {
    let mut rng = ChaCha8Rng::seed_from_u64(seed * 1000 + u64::from(sender));
    let mut outcomes = Outcomes::new();
    let mut under_way = VecDeque::new();
    for number in 0..EACH {
        let label = (sender, rng.random_bool(0.2), number);
        let mut message = labelled(label);
        let way = [Way::Try, Way::Send, Way::Call][rng.random_range(0..3)];
        if way == Way::Try {
            let result = match task.mailbox.offer(message) {
                Ok(()) => Ok(()),
                Err(NotTaken::Full(_)) => Err(task.mailbox.full()),
                Err(NotTaken::Closed(_)) => Err(Fault::Stopping),
            };
            outcomes.insert(label, (way, result));
            continue;
        }
        let ticket = here.begin_call(here.now(), LIMIT);
        let key = ticket.key();
        message.envelope.reply = Some(ReplySlot::call(ticket));
        if way == Way::Call {
            let header = &mut message.envelope.header;
            header.flags |= Flags::REPLY_WAIT;
        }
        task.mailbox.put(message);
        under_way.push_back((label, way, key));
        if under_way.len() > rng.random_range(0..6) {
            while let Some((label, way, key)) = under_way.pop_front() {
                outcomes.insert(label, (way, answered(&here, key).await));
            }
        }
    }
    for (label, way, key) in under_way {
        outcomes.insert(label, (way, answered(&here, key).await));
    }
    outcomes
}

/// What a queue of `capacity` took, and what became of each message; the task dies once it has taken
/// `dies_after`, or when all is sent.
fn storm(seed: u64, capacity: usize, dies_after: Option<usize>) -> (Vec<Label>, Outcomes) {
    let home = Arc::new(ProcessorHandle::default());
    let task = TaskRecord::with_capacity(capacity, home.clone(), 0);
    let taken: Arc<Mutex<Vec<Label>>> = Arc::default();
    let outcomes: Arc<Mutex<Outcomes>> = Arc::default();
    let (at_work, log, its) = (home.clone(), taken.clone(), task.clone());
    let receiver = std::thread::spawn(move || {
        let processor = Processor::new(at_work, Clock::real());
        let queue = TaskQueue::open(its);
        processor.add_queue(0, queue.clone());
        let runner = processor.spawn(take_all(queue.clone(), seed, log), None);
        queue.set_runner(runner);
        processor.run();
    });
    let left = Arc::new(AtomicUsize::new(SENDERS as usize));
    let senders = (0..SENDERS).map(|sender| {
        let (task, outcomes, left) = (task.clone(), outcomes.clone(), left.clone());
        std::thread::spawn(move || {
            let handle = Arc::new(ProcessorHandle::default());
            let processor = Processor::new(handle.clone(), Clock::real());
            let here = processor.clone();
            let work = async move {
                let all = send_all(here, task, sender, seed).await;
                lock(&outcomes).extend(all);
                left.fetch_sub(1, Ordering::AcqRel);
                handle.stop();
            };
            processor.spawn(work, None);
            processor.run();
        })
    });
    let senders: Vec<_> = senders.collect();
    if let Some(dies_after) = dies_after {
        while lock(&taken).len() < dies_after && left.load(Ordering::Acquire) > 0 {
            std::thread::yield_now();
        }
        task.mailbox.close();
    }
    for sender in senders {
        sender.join().unwrap();
    }
    // A message that was taken, and for which no sender waits, is in the queue at the latest now.
    let (empty, done) = std::sync::mpsc::channel::<()>();
    let all_taken = task.clone();
    home.inject(move |_| drop(empty));
    assert!(done.recv().is_err());
    while dies_after.is_none() && all_taken.mailbox.depth().0 > 0 {
        std::thread::yield_now();
    }
    task.mailbox.close();
    home.stop();
    receiver.join().unwrap();
    let taken = std::mem::take(&mut *lock(&taken));
    let outcomes = std::mem::take(&mut *lock(&outcomes));
    (taken, outcomes)
}

/// Of each sender and priority, in the order in which they were sent, and none twice.
fn in_order(taken: &[Label]) {
    let mut last: BTreeMap<(u32, bool), u32> = BTreeMap::new();
    for (sender, urgent, number) in taken {
        let before = last.insert((*sender, *urgent), *number);
        assert!(
            before.is_none_or(|before| before < *number),
            "{number} of sender {sender} came after {before:?}"
        );
    }
}

#[test]
fn many_threads_send_and_all_that_is_taken_comes_once_and_in_order() {
    for (seed, capacity) in [(1, 1), (2, 3), (3, 64), (4, 1024)] {
        let (taken, outcomes) = storm(seed, capacity, None);
        in_order(&taken);
        assert_eq!(outcomes.len(), (SENDERS * EACH) as usize);
        let told: BTreeSet<Label> = outcomes
            .iter()
            .filter(|(_, (_, result))| result.is_ok())
            .map(|(label, _)| *label)
            .collect();
        let taken: BTreeSet<Label> = taken.into_iter().collect();
        assert!(taken == told, "capacity {capacity}");
        let refused = outcomes
            .values()
            .filter_map(|(_, told)| told.as_ref().err());
        for fault in refused {
            assert_eq!(*fault, Fault::Full { capacity });
        }
    }
}

#[test]
fn a_task_that_dies_under_load_leaves_nobody_waiting_and_nothing_half_taken() {
    for (seed, capacity) in [(5, 1), (6, 3), (7, 64), (8, 1024)] {
        let (taken, outcomes) = storm(seed, capacity, Some(EACH as usize));
        in_order(&taken);
        assert_eq!(outcomes.len(), (SENDERS * EACH) as usize);
        let taken: BTreeSet<Label> = taken.into_iter().collect();
        for (label, (way, result)) in outcomes {
            match (way, result) {
                // The taker of a call replies, and nobody else.
                (Way::Call, result) => assert_eq!(taken.contains(&label), result.is_ok()),
                // What the queue had taken when it was closed is gone with it.
                (Way::Try | Way::Send, Ok(())) => {}
                (Way::Try | Way::Send, Err(_)) => assert!(!taken.contains(&label)),
            }
        }
    }
}
