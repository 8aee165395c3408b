//! The results of an object as they are made, for subscribers (demand streams: SORMA technical
//! report, section 1.9.2).
//!
//! Each subscriber has a bounded queue of its own. So a slow or dead one costs the object no more than
//! putting a result where it is not fetched. This module knows one process; [`crate::stream`] goes on from
//! here to other daemons.

use crate::raise;
use crate::report::{Report, code};
use crate::transport::Transport;
use ctos::time::Instant;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::future::poll_fn;
use std::sync::{Arc, Weak};
use std::task::{Poll, Waker};

/// No subscriber may have more results kept than this.
pub const MOST_KEPT: usize = 10_000;

/// How many results are kept for a subscriber that does not fetch them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Keep {
    /// Only the latest one.
    Latest,
    /// Every one, up to so many; then the oldest make room. At least 1, at most [`MOST_KEPT`].
    Every(usize),
}

impl Keep {
    /// How many results it holds.
    #[must_use]
    pub fn capacity(self) -> usize {
        match self {
            Self::Latest => 1,
            Self::Every(count) => count.clamp(1, MOST_KEPT),
        }
    }

    /// Whether so many can be kept.
    ///
    /// # Errors
    /// How many can.
    pub(crate) fn check(self) -> Result<(), Report> {
        match self {
            Self::Every(count) if !(1..=MOST_KEPT).contains(&count) => Err(raise!(
                code::VALUE,
                "1 to {MOST_KEPT} results can be kept, not {count}"
            )),
            _ => Ok(()),
        }
    }
}

/// One result of an object, as a subscriber gets it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Counts the results of the object from when it was first subscribed to; the first is 1.
    pub number: u64,
    /// When it was made, of the app's time in the object's process.
    pub time: Instant,
    /// How many results just before it this subscriber did not get.
    pub missed: u64,
    /// Whether the stream was interrupted before it, so that nobody knows what was missed.
    pub resumed: bool,
    /// What the object answered: data, code and reports.
    pub body: Transport,
}

/// Where an object's results go.
#[derive(Default)]
pub(crate) struct Results {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The number of the latest result.
    number: u64,
    taps: Vec<Weak<Shared>>,
}

/// What a subscriber and the object share.
type Shared = Mutex<Kept>;

struct Kept {
    capacity: usize,
    /// The oldest first.
    samples: VecDeque<Arc<Sample>>,
    waker: Option<Waker>,
}

impl Results {
    /// Gives every subscriber a copy. Waits for nobody: a subscriber holds its lock only to look.
    pub(crate) fn publish(&self, now: Instant, body: &Transport) {
        let mut state = self.state.lock();
        state.number += 1;
        let number = state.number;
        let mut sample: Option<Arc<Sample>> = None;
        state.taps.retain(|tap| {
            let Some(tap) = tap.upgrade() else {
                return false;
            };
            let sample = sample.get_or_insert_with(|| {
                Arc::new(Sample {
                    number,
                    time: now,
                    missed: 0,
                    resumed: false,
                    body: body.clone(),
                })
            });
            put(&tap, Arc::clone(sample));
            true
        });
    }

    /// A new subscriber, for results from now on.
    pub(crate) fn subscribe(&self, keep: Keep) -> Tap {
        let shared = Arc::new(Mutex::new(Kept {
            capacity: keep.capacity(),
            samples: VecDeque::new(),
            waker: None,
        }));
        let mut state = self.state.lock();
        state.taps.retain(|tap| tap.strong_count() > 0);
        state.taps.push(Arc::downgrade(&shared));
        Tap {
            shared,
            begun: state.number,
        }
    }

    /// How many subscribe.
    pub(crate) fn subscribers(&self) -> usize {
        let state = self.state.lock();
        let alive = state.taps.iter().filter(|tap| tap.strong_count() > 0);
        alive.count()
    }
}

fn put(shared: &Shared, sample: Arc<Sample>) {
    let mut kept = shared.lock();
    if kept.samples.len() >= kept.capacity {
        kept.samples.pop_front();
    }
    kept.samples.push_back(sample);
    let waker = kept.waker.take();
    drop(kept);
    if let Some(waker) = waker {
        waker.wake();
    }
}

/// A subscriber's own copy of what an object has answered and the subscriber has not yet fetched.
pub(crate) struct Tap {
    shared: Arc<Shared>,
    begun: u64,
}

impl Tap {
    /// The number of the last result before the subscription.
    pub(crate) fn begun(&self) -> u64 {
        self.begun
    }

    /// The results after number `after`, the oldest first, at most `most` of them. Those up to `after`
    /// are thrown away, the others stay until they are said to have arrived.
    pub(crate) fn after(&self, after: u64, most: usize) -> Vec<Arc<Sample>> {
        let mut kept = self.shared.lock();
        while kept
            .samples
            .front()
            .is_some_and(|sample| sample.number <= after)
        {
            kept.samples.pop_front();
        }
        kept.samples.iter().take(most).cloned().collect()
    }

    /// How many results are kept.
    #[cfg(test)]
    fn waiting(&self) -> usize {
        self.shared.lock().samples.len()
    }

    /// Waits until there is a result after number `after`. One waits at a time; who waited before is
    /// woken no more.
    pub(crate) async fn wait(&self, after: u64) {
        poll_fn(|cx| {
            let mut kept = self.shared.lock();
            let is_later = |sample: &Arc<Sample>| sample.number > after;
            if kept.samples.back().is_some_and(is_later) {
                return Poll::Ready(());
            }
            kept.waker = Some(cx.waker().clone());
            Poll::Pending
        })
        .await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt as _;
    use proptest::prelude::*;

    fn publish(results: &Results, count: u64) {
        for _ in 0..count {
            results.publish(Instant::START, &Transport::default());
        }
    }

    fn numbers(tap: &Tap, after: u64) -> Vec<u64> {
        let samples = tap.after(after, MOST_KEPT);
        samples.iter().map(|sample| sample.number).collect()
    }

    #[test]
    fn a_subscriber_gets_what_comes_after_it_and_one_that_is_gone_nothing() {
        let results = Results::default();
        publish(&results, 2);
        let early = results.subscribe(Keep::Every(10));
        let latest = results.subscribe(Keep::Latest);
        publish(&results, 3);
        assert_eq!(numbers(&early, early.begun()), [3, 4, 5]);
        assert_eq!(numbers(&latest, latest.begun()), [5]);
        drop(latest);
        publish(&results, 1);
        assert_eq!(results.subscribers(), 1);
        assert_eq!(numbers(&early, 4), [5, 6]);
    }

    #[test]
    fn who_waits_is_woken_by_the_next_result() {
        let results = Results::default();
        let tap = results.subscribe(Keep::Latest);
        assert!(tap.wait(0).now_or_never().is_none());
        publish(&results, 1);
        assert!(tap.wait(0).now_or_never().is_some());
        assert!(tap.wait(1).now_or_never().is_none());
    }

    proptest! {
        /// Whatever is fetched when: numbers rise, none comes twice, and never more than the bound is kept.
        #[test]
        fn copies_are_bounded_in_order_and_never_twice(
            capacity in 1_usize..8, steps in prop::collection::vec((0_u64..5, 0_usize..6), 1..40)
        ) {
            let results = Results::default();
            let tap = results.subscribe(Keep::Every(capacity));
            let (mut last, mut published) = (0, 0);
            for (puts, most) in steps {
                publish(&results, puts);
                published += puts;
                prop_assert!(tap.waiting() <= capacity);
                let got = tap.after(last, most);
                prop_assert!(got.len() <= most);
                for sample in got {
                    prop_assert!(sample.number > last && sample.number <= published);
                    last = sample.number;
                }
            }
            let rest = numbers(&tap, last);
            let due = published - last;
            prop_assert_eq!(rest.len() as u64, due.min(capacity as u64));
        }
    }
}
