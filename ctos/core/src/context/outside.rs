//! What a task takes from elsewhere than its messages. A recorder is shown it, and a replay gives it again.
//!
//! A record says which part of the task was polled, its loop or one of its children. It need not where that is seen from
//! what the part did first: it began a message, or took up an answer.

use std::{
    fmt::Display,
    future::{Future, poll_fn},
    pin::pin,
    rc::Rc,
    task::Poll,
};

use serde::{Serialize, de::DeserializeOwned};

use super::core::{Context, Inner};
use crate::tap::{Came, Observer, PartPolled};
use ctos_time::Instant;

impl Inner {
    /// Polls part `part` of the task whenever it is woken; in a replay, when it was polled.
    pub(crate) fn polled_as(
        self: Rc<Self>,
        part: u64,
        future: impl Future<Output = ()>,
    ) -> impl Future<Output = ()> {
        // Boxed: it would stand twice in an asynchronous function.
        let mut future = Box::pin(future);
        poll_fn(move |poll| {
            let tap = &self.chassis.tap;
            let Some(observer) = tap.observer().filter(|_| self.config.is_some()) else {
                return future.as_mut().poll(poll);
            };
            if observer.replays() && !observer.is_poll_of(self.record.tid, part) {
                return Poll::Pending;
            }
            let outer = self.polled.replace(PartPolled::Of(part));
            // By a panic too: the poll around it goes on.
            let _ends = scopeguard::guard(outer, |outer| {
                self.note_poll();
                self.polled.set(outer);
            });
            future.as_mut().poll(poll)
        })
    }

    /// Calls `build`, which makes the handler, as a poll of its own.
    pub(crate) fn building_polled<T>(&self, build: impl FnOnce() -> T) -> T {
        self.polled.set(PartPolled::Noted);
        let built = build();
        self.polled.set(PartPolled::No);
        built
    }

    /// What follows in the record belongs to the present poll.
    pub(crate) fn note_poll(&self) {
        if let PartPolled::Of(part) = self.polled.get() {
            self.polled.set(PartPolled::Noted);
            if let Some(recorder) = self.chassis.tap.recorder() {
                recorder.polled(self.record.tid, part);
            }
        }
    }

    /// The present poll begins with something that tells whose it is.
    pub(crate) fn poll_is_told(&self) -> bool {
        let told = matches!(self.polled.get(), PartPolled::Of(_));
        if told {
            self.polled.set(PartPolled::Noted);
        }
        told
    }

    /// When the answer of a call came.
    pub(super) fn came(&self, at_once: bool) -> Came {
        match at_once {
            true => Came::AtOnce,
            false if self.poll_is_told() => Came::First,
            false => Came::Later,
        }
    }

    /// Who is shown what is read now: nobody outside of polls, where only the runtime reads.
    pub(super) fn reader(&self) -> Option<&dyn Observer> {
        let observer = self.chassis.tap.observer();
        observer.filter(|_| self.polled.get() != PartPolled::No)
    }

    /// Notes a value that was read.
    fn note(&self, observer: &dyn Observer, what: &dyn Display, value: &impl Serialize) {
        self.note_poll();
        let write = |buffer: &mut Vec<u8>| ctos_message::append(value, buffer).is_ok();
        observer.read(self.record.tid, what, Some(&write));
    }

    fn again<T: DeserializeOwned>(&self, observer: &dyn Observer, what: &dyn Display) -> Option<T> {
        let value = observer.read_again(self.record.tid, what)?;
        postcard::from_bytes(&value).ok()
    }
}

impl Context {
    /// Reads something that no message brings: a file, a device, a setting of the host. `what` names it. A record holds
    /// the value, and in a replay it is taken from there, so that the task does the same again.
    pub fn outside<T: Serialize + DeserializeOwned>(
        &self,
        what: impl Display,
        read: impl FnOnce() -> T,
    ) -> T {
        let inner = &self.inner;
        let Some(observer) = inner.reader() else {
            return read();
        };
        if observer.replays() {
            return inner.again(observer, &what).unwrap_or_else(|| {
                observer.read(self.tid(), &what, None);
                read()
            });
        }
        let value = read();
        inner.note(observer, &what, &value);
        value
    }

    /// [`Self::outside`] for what takes its time: another thread, a device. In a replay `read` is not polled, and this
    /// ends where it ended in the record.
    pub async fn outside_wait<T: Serialize + DeserializeOwned>(
        &self,
        what: impl Display,
        read: impl Future<Output = T>,
    ) -> T {
        let mut read = pin!(read);
        poll_fn(|poll| {
            let inner = &self.inner;
            let observer = inner.reader();
            if let Some(observer) = observer.filter(|observer| observer.replays()) {
                return inner
                    .again(observer, &what)
                    .map_or(Poll::Pending, Poll::Ready);
            }
            let value = read.as_mut().poll(poll);
            if let (Poll::Ready(value), Some(observer)) = (&value, observer) {
                inner.note(observer, &what, value);
            }
            value
        })
        .await
    }

    /// The moment of the host's clock at which the app was started, ns; 0 in virtual time. No other run of it has the same.
    #[must_use]
    pub fn started_ns(&self) -> u64 {
        let clock = &self.inner.chassis.clock;
        self.outside("start of the app", || clock.origin_ns().unwrap_or(0))
    }

    /// Whether this is the replay of a record, in which nothing outside is to be opened, written or told.
    #[must_use]
    pub fn is_replay(&self) -> bool {
        self.inner.chassis.tap.replay().is_some()
    }

    /// Says that this task uses `what`, which no record can hold: memory that it shares with others, a socket, a device
    /// without [`Self::outside`]. A replay of the task is refused with that reason.
    pub fn reads_unrecorded(&self, what: impl Display) {
        if let Some(recorder) = self.inner.chassis.tap.recorder() {
            recorder.read(self.tid(), &what, None);
        }
    }

    /// Ends at `deadline`.
    pub(crate) async fn sleep_until(&self, deadline: Instant) {
        let sleep = self.inner.processor.sleep_until(deadline);
        let what = format_args!("sleep until {} ns", deadline.as_nanos());
        self.outside_wait(what, sleep).await;
    }

    /// The present moment. A real clock goes on while a task computes, a virtual one does not.
    #[must_use]
    pub fn now(&self) -> Instant {
        let clock = || self.inner.processor.now();
        let real = self.inner.chassis.clock.origin_ns().is_some();
        match self.inner.reader() {
            Some(observer) if real || observer.replays() => {
                Instant::from_nanos(self.outside("clock", || clock().as_nanos()))
            }
            _ => clock(),
        }
    }
}
