//! The counters of a task for displays and metrics: cheap to count, readable from any thread.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use serde::{Deserialize, Serialize};

use ctos_message::CommandInfo;

/// Upper bounds of the buckets of handler times, ns: powers of four of a microsecond.
const BUCKETS: usize = 12;

/// The upper bound of a bucket, s.
pub fn bound_s(bucket: usize) -> f64 {
    1e-6 * 4_f64.powi(i32::try_from(bucket).unwrap_or(i32::MAX))
}

/// Adds to a counter that has one writer, the loop of its task: no other addition can come between.
#[inline]
pub(crate) fn add(counter: &AtomicU64, more: u64) {
    let before = counter.load(Ordering::Relaxed);
    counter.store(before.wrapping_add(more), Ordering::Relaxed);
}

/// How many messages of a command ended well, and how many otherwise.
#[derive(Debug, Default)]
struct Count {
    command: u16,
    ok: AtomicU64,
    failed: AtomicU64,
}

/// The meter of one task.
#[derive(Debug, Default)]
pub struct TaskMeter {
    counted: Arc<[CommandInfo]>,
    /// One more than [`BUCKETS`]: the last counts what is longer than all bounds.
    durations: [AtomicU64; BUCKETS + 1],
    /// By command, in the order of the commands that are counted.
    commands: Box<[Count]>,
    /// Messages of other commands, those of the runtime.
    other: Count,
    /// Odd while the handler keeps its processor.
    polls: AtomicU64,
}

/// Messages of one command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandCount {
    pub command: String,
    pub ok: u64,
    pub failed: u64,
}

/// The bucket of a duration: 0 for up to 1 us, then one more for every factor of four.
#[inline]
fn bucket_of(nanos: u64) -> usize {
    // Most of those that are many are brief.
    if nanos <= 1000 {
        return 0;
    }
    let micros = (nanos - 1) / 1000;
    (u64::BITS - micros.leading_zeros()).div_ceil(2) as usize
}

impl Count {
    fn of(command: u16) -> Self {
        Self {
            command,
            ..Self::default()
        }
    }
}

impl TaskMeter {
    /// Counts these commands one by one.
    pub(crate) fn of(counted: Arc<[CommandInfo]>) -> Self {
        Self {
            commands: counted.iter().map(|info| Count::of(info.code)).collect(),
            counted,
            ..Self::default()
        }
    }

    /// A handler has returned from a message of `command` after `nanos`.
    #[inline]
    pub(crate) fn ended(&self, command: u16, ok: bool, nanos: u64) {
        let bucket = bucket_of(nanos);
        if let Some(bucket) = self.durations.get(bucket.min(BUCKETS)) {
            add(bucket, 1);
        }
        let known = self.commands.iter().find(|count| count.command == command);
        let count = known.unwrap_or(&self.other);
        add(if ok { &count.ok } else { &count.failed }, 1);
    }

    /// How many messages took at most the bound of each bucket, and longer than all.
    pub(crate) fn durations(&self) -> Vec<u64> {
        let read = |bucket: &AtomicU64| bucket.load(Ordering::Relaxed);
        self.durations.iter().map(read).collect()
    }

    /// Messages by command.
    pub(crate) fn commands(&self) -> Vec<CommandCount> {
        let read = |command: &str, count: &Count| CommandCount {
            command: command.to_owned(),
            ok: count.ok.load(Ordering::Relaxed),
            failed: count.failed.load(Ordering::Relaxed),
        };
        let known = self.counted.iter().zip(&self.commands);
        let mut all: Vec<_> = known.map(|(info, count)| read(info.name, count)).collect();
        all.push(read("runtime", &self.other));
        all
    }

    /// The poll of the handler that is under way, if one is.
    pub(crate) fn poll(&self) -> Option<u64> {
        let poll = self.polls.load(Ordering::Acquire);
        (poll % 2 == 1).then_some(poll)
    }

    /// Polls the handler. The code does not panic.
    #[inline(always)]
    pub(crate) fn in_poll<T>(&self, code: impl FnOnce() -> T) -> T {
        self.step();
        let result = code();
        self.step();
        result
    }

    /// Runs code of others within a poll of the handler, which waits for it.
    pub(crate) fn while_it_waits<T>(&self, code: impl FnOnce() -> T) -> T {
        let in_poll = self.poll().is_some();
        if in_poll {
            self.step();
        }
        let result = code();
        if in_poll {
            self.step();
        }
        result
    }

    #[inline]
    fn step(&self) {
        let before = self.polls.load(Ordering::Relaxed);
        self.polls.store(before.wrapping_add(1), Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_is_counted_in_the_first_bucket_whose_bound_it_does_not_exceed() {
        for (nanos, bucket) in [
            (0, 0),
            (1_000, 0),
            (1_001, 1),
            (4_000, 1),
            (4_001, 2),
            (16_000, 2),
            (1_048_576_000, 10),
            (4_194_304_000, 11),
            (4_194_304_001, 12),
            (u64::MAX, 12),
        ] {
            let meter = TaskMeter::default();
            meter.ended(1, true, nanos);
            let counted = meter.durations().iter().position(|count| *count == 1);
            assert_eq!(counted, Some(bucket), "{nanos} ns");
            if bucket < BUCKETS {
                assert!(nanos as f64 * 1e-9 <= bound_s(bucket) * (1.0 + 1e-12));
            }
        }
    }

    #[test]
    fn a_poll_is_seen_while_it_lasts() {
        let meter = TaskMeter::default();
        assert_eq!(meter.poll(), None);
        assert!(meter.in_poll(|| meter.poll()).is_some());
        let waiting = meter.in_poll(|| (meter.while_it_waits(|| meter.poll()), meter.poll()));
        assert!(waiting.0.is_none() && waiting.1.is_some());
        assert_eq!(meter.while_it_waits(|| meter.poll()), None);
        assert_eq!(meter.poll(), None);
    }
}
